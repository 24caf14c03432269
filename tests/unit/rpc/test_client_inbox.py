"""What each kind of inbox keeps for a slow reader."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.rpc.client_inbox import MAX_WAITING, Encoded, Inbox, Latest, Newest, Queue


def state(name: str, alt_m: int) -> dict[str, Any]:
    return {"state": {"name": name, "alt_m": alt_m}}


async def taken(inbox: Inbox) -> list[dict[str, Any]]:
    """All that is there now."""
    return [await inbox.get() for _ in iter(lambda: bool(inbox), False)]


async def test_of_states_the_newest_of_each_vehicle_is_kept_and_who_waits_longest_comes_first() -> None:
    inbox = Latest()
    for update in (state("a", 1), state("b", 1), state("a", 2)):
        inbox.put(update)
    assert await taken(inbox) == [{"name": "a", "alt_m": 2}, {"name": "b", "alt_m": 1}]


async def test_encoded_states_come_together_with_the_newest_of_each_vehicle() -> None:
    inbox = Encoded()
    inbox.put_encoded(b'{"name":"a","alt_m":1}', False)
    inbox.put_encoded(b'{"alt_m":2,"name":"a"}', False)
    inbox.put(state("b", 3) | {"last": True})
    (update,) = await taken(inbox)
    assert update["complete"]
    assert {name: json.loads(text)["alt_m"] for name, text in update["states"].items()} == {"a": 2, "b": 3}


async def test_of_plans_only_the_newest_is_kept() -> None:
    inbox = Newest("plan")
    inbox.put({"plan": {"state": "ready"}})
    inbox.put({"plan": {"state": "flying"}})
    assert await taken(inbox) == [{"state": "flying"}]


async def test_a_queue_drops_the_oldest_and_counts_them_with_those_that_the_daemon_dropped() -> None:
    inbox = Queue("event")
    inbox.put({"event": {"n": 0}, "dropped": 5})
    for n in range(1, MAX_WAITING + 2):
        inbox.put({"event": {"n": n}})
    events = await taken(inbox)
    assert len(events) == MAX_WAITING
    assert events[0] == {"n": 2, "dropped": 7}
    assert events[1] == {"n": 3}


async def test_what_came_before_the_end_is_still_read_and_then_the_error_comes() -> None:
    inbox = Queue("event")
    waiting = asyncio.ensure_future(inbox.get())
    await asyncio.sleep(0)
    inbox.put({"event": {"n": 1}})
    inbox.put({"event": {"n": 2}})
    inbox.fail(RpcError(-1, "gone"))
    assert await waiting == {"n": 1}
    assert await inbox.get() == {"n": 2}
    with pytest.raises(RpcError, match="gone"):
        await inbox.get()
