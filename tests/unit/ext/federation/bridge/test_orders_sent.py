"""Orders to other sites: sent once, answered within a second or unknown, followed to their outcome."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest

from skygcs.errors import RefusedError, TargetError
from skygcs.ext.federation.bridge.orders_sent import FIRST_ANSWER_S, OrdersSent, RemoteVehicle
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from support.memory_hub import MemoryBus, MemoryHub

pytestmark = pytest.mark.looptime

AHEAD_S = 700.0
"""Of the clock of south."""

ALPHA = RemoteVehicle("south", "alpha")
DONE = {"ok": True, "result": "accepted", "message": "landing", "attempts": 1, "elapsed_s": 0.1, "status_texts": []}


class South:
    """A site whose answers the test gives. ``answers``: by what comes, "order" or "outcome"."""

    def __init__(self, role: str = "operator") -> None:
        self.loop = asyncio.get_running_loop()
        self.hub = MemoryHub(1)
        self.bus = MemoryBus(self.hub, self.loop)
        self.came: list[dict[str, Any]] = []
        self.asked_at: list[float] = []
        self.on_order: Callable[[dict[str, Any]], dict[str, Any] | None] = lambda _: {"status": "done", "outcome": DONE}
        self.on_question = self.on_order
        self.silent_clock = False
        self.bus.serve("*.south*", self._answer)
        self.station = MemoryBus(self.hub, self.loop)
        self.slept_s = 0.0
        """The loop's clock of this computer stood still for so long, and no other one."""
        sites = RemoteSites("north", "run")
        self.sent = OrdersSent("north", role, self.station, sites, self.loop, clock=self.station_s)

    def station_s(self) -> float:
        return self.loop.time() + self.slept_s

    def site_s(self) -> float:
        return self.station_s() + AHEAD_S

    async def _answer(self, subject: str, payload: bytes) -> bytes:
        message = json.loads(payload)
        if subject == "here.south":
            if self.silent_clock:
                await asyncio.Event().wait()
            return json.dumps({"t0_s": 0, "site_s": self.site_s(), "run": "a"}).encode()
        if subject == "cmd.south.outcome":
            self.asked_at.append(self.loop.time())
            answer = self.on_question(message)
        else:
            self.came.append({**message, "subject": subject})
            answer = self.on_order(message)
        if answer is None:
            await asyncio.Event().wait()
        return json.dumps({"id": message["id"], "outcome": None, "text": "", **(answer or {})}).encode()

    async def land(self) -> dict[str, Any]:
        return (await self.sent.order("vehicles.land", {}, [ALPHA], "mia"))["south/alpha"]


@pytest.fixture
async def south() -> South:
    return South()


async def test_an_order_has_its_deadline_on_the_sites_clock_and_who_gave_it(south: South) -> None:
    outcome = await south.land()
    assert {**DONE, "id": outcome["id"]} == outcome
    (came,) = south.came
    assert came["subject"] == "cmd.south.alpha" and came["by"] == "mia@north" and came["role"] == "operator"
    assert came["deadline_s"] == pytest.approx(AHEAD_S + FIRST_ANSWER_S, abs=0.02)
    assert outcome["id"] == f"south/{came['id']}"
    await south.land()
    assert [c["seq"] for c in south.came] == [1, 2] and south.came[0]["id"] != south.came[1]["id"]


async def test_without_an_answer_it_is_unknown_after_its_deadline_and_not_sent_again(south: South) -> None:
    south.on_order = lambda _: None
    outcome = await south.land()
    assert outcome["result"] == "unknown" and south.loop.time() == pytest.approx(FIRST_ANSWER_S, abs=0.02)
    assert south.asked_at == [] and len(south.came) == 1
    south.on_question = lambda _: {"status": "never came"}
    settled = await south.sent.outcome(outcome["id"])
    assert (settled["status"], settled["vehicle"], settled["answered"]) == ("never came", "south/alpha", True)
    south.bus.reset()
    settled = await south.sent.outcome(outcome["id"].removeprefix("south/"))
    assert (settled["status"], settled["answered"]) == ("never came", False)  # what was known
    assert len(south.came) == 1


async def test_a_site_that_answers_no_ping_gets_no_order_but_a_stop(south: South) -> None:
    south.silent_clock = True
    outcome = await south.land()
    assert outcome["result"] == "refused" and "nothing was sent" in outcome["message"] and south.came == []
    stopped = await south.sent.order("vehicles.stop", {"action": "hold"}, [ALPHA], "mia")
    assert stopped["south/alpha"]["ok"] and len(south.came) == 1
    # the clock as it was compared before is used
    south.silent_clock = False
    await south.land()
    south.silent_clock = True
    await asyncio.sleep(5.0)
    began = south.loop.time()
    await south.sent.order("vehicles.stop", {"action": "hold"}, [ALPHA], "mia")
    assert south.came[-1]["deadline_s"] == pytest.approx(began + AHEAD_S + FIRST_ANSWER_S, abs=0.02)


@pytest.mark.parametrize("silent", [False, True])
async def test_after_this_computer_has_slept_no_order_is_late(south: South, silent: bool) -> None:
    await south.land()
    south.slept_s += 30.0
    south.silent_clock = silent
    began_s = south.site_s()
    await south.sent.order("vehicles.stop", {"action": "hold"}, [ALPHA], "mia")
    assert south.came[-1]["deadline_s"] == pytest.approx(began_s + FIRST_ANSWER_S, abs=0.05)
    south.silent_clock = False
    began_s = south.site_s()
    await south.land()
    assert south.came[-1]["deadline_s"] == pytest.approx(began_s + FIRST_ANSWER_S, abs=0.05)


async def test_what_runs_is_asked_for_until_it_has_ended(south: South) -> None:
    south.on_order = lambda _: {"status": "running"}
    south.on_question = lambda _: (
        {"status": "done", "outcome": DONE} if south.loop.time() > 5.0 else {"status": "running"}
    )
    assert (await south.land())["ok"] and 5.0 < south.loop.time() < 6.0


async def test_what_runs_at_a_site_that_is_not_heard_any_more_is_unknown(south: South) -> None:
    south.on_order = lambda _: {"status": "running"}
    south.on_question = lambda _: None
    outcome = await south.land()
    assert outcome["result"] == "unknown" and "carries it out" in outcome["message"] and south.loop.time() < 5.0
    assert len(south.came) == 1


async def test_hundreds_of_orders_do_not_flood_the_site_with_questions(south: South) -> None:
    south.on_order = lambda _: {"status": "running"}
    south.on_question = lambda _: (
        {"status": "done", "outcome": DONE} if south.loop.time() > 20.0 else {"status": "running"}
    )
    vehicles = [RemoteVehicle("south", f"v{number}") for number in range(400)]
    outcomes = await south.sent.order("vehicles.hold", {}, vehicles, "mia")
    assert all(outcome["ok"] for outcome in outcomes.values()) and len(outcomes) == 400
    assert len(south.asked_at) / 20.0 < 400


async def test_answers_that_cannot_be_read_are_unknown(south: South) -> None:
    for answer in ({"status": "fine"}, {"status": "done", "outcome": {"ok": 1}}, {"status": "done", "id": "0" * 32}):
        south.on_order = lambda _, answer=answer: answer  # type: ignore[misc]
        assert (await south.land())["result"] == "unknown"


async def test_what_an_observer_may_not_and_ids_that_are_none() -> None:
    south = South("observer")
    with pytest.raises(RefusedError, match="observer"):
        await south.land()
    for text in ("", "south", "south/abc", "0" * 32, f"*/{'0' * 32}", f"south.x/{'0' * 32}"):
        with pytest.raises(TargetError):
            await south.sent.outcome(text)
    assert south.came == []


@pytest.mark.parametrize("site_s", ["1" + 400 * "0", "1e999", "-1e300", "true", '"noon"', "[1]"])
async def test_a_site_whose_clock_is_nonsense_keeps_no_stop_from_the_others(south: South, site_s: str) -> None:
    liar = MemoryBus(south.hub, south.loop)

    async def answer(subject: str, payload: bytes) -> bytes:
        return b'{"t0_s": 0, "run": "a", "site_s": %s}' % site_s.encode()

    liar.serve("*.east*", answer)
    both = [RemoteVehicle("east", "bravo"), ALPHA]
    params = {"action": "kill", "confirm": "kill-2"}
    stopped = await south.sent.order("vehicles.stop", params, both, "mia")
    assert stopped["south/alpha"]["ok"] and len(south.came) == 1
    assert not stopped["east/bravo"]["ok"]


async def test_what_another_site_writes_cannot_move_the_cursor_of_a_terminal(south: South) -> None:
    hostile = {**DONE, "message": "\x1b[2Jfine", "status_texts": ["\x1b]0;x\x07"] * 30}
    south.on_order = lambda _: {"status": "done", "outcome": hostile}
    outcome = await south.land()
    assert outcome["message"] == "?[2Jfine" and outcome["status_texts"] == ["?]0;x?"] * 8
    south.on_order = lambda _: {"status": "refused", "text": "\x9b2Jno"}
    assert (await south.land())["message"] == "refused: ?2Jno"
    for wrong in ({"elapsed_s": 10**400}, {"attempts": -(10**400)}, {"status_texts": [{}]}):
        south.on_order = lambda _, wrong=wrong: {"status": "done", "outcome": {**DONE, **wrong}}  # type: ignore[misc]
        assert (await south.land())["result"] == "unknown"
