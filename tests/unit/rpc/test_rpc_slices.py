"""Long answers in slices."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
from collections.abc import Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import pytest

from skygcs.core.mission.plan import MissionPlan
from skygcs.core.protocols.command import Outcome
from skygcs.ext.params import methods as params
from skygcs.rpc import slices
from skygcs.rpc.sessions import Turns
from skygcs.rpc.slices import AHEAD_S, LOOK_S, MOST_REST_S, ORDER_S, PAUSE_S, PUT_OFF_S, Slices
from skygcs.runtime import onboard_orders
from skygcs.runtime.task_set import OneATurn
from support.table import each


@each("at_once", [1, 2, 7, 100])
@each("number", [0, 1, 2, 7, 8])
async def test_a_list_is_the_same_in_any_slices(number: int, at_once: int) -> None:
    values = [{"n": n, "text": ",[]", "list": []} for n in range(number)]
    assert json.loads(await Slices(asyncio.get_running_loop()).encoded_list(values, at_once)) == values


async def test_what_json_lacks_is_null() -> None:
    assert (
        await Slices(asyncio.get_running_loop()).encoded_list([float("nan"), float("inf"), 1.5], 2)
        == b"[null,null,1.5]"
    )


async def test_the_loop_has_its_turn_between_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slices, "SLICE_S", -1.0)  # each look at the clock ends a slice
    taken: list[int] = []
    seen: list[int] = []

    async def look() -> None:
        while True:
            seen.append(len(taken))
            await asyncio.sleep(0)

    def numbers() -> Iterator[int]:
        for n in range(6):
            taken.append(n)
            yield n

    looking = asyncio.create_task(look())
    await asyncio.sleep(0)
    assert json.loads(await Slices(asyncio.get_running_loop()).encoded_list(numbers(), 2)) == [0, 1, 2, 3, 4, 5]
    looking.cancel()
    assert {2, 4, 6} <= set(seen)


@pytest.mark.looptime
async def test_a_slice_is_followed_by_a_pause_only_while_an_order_is_on_its_way() -> None:
    pauses = Slices(asyncio.get_running_loop())
    assert pauses.pause_s() == 0.0
    pauses.order_came()
    await asyncio.sleep(ORDER_S / 2)
    assert pauses.pause_s() == PAUSE_S
    await asyncio.sleep(ORDER_S)
    assert pauses.pause_s() == 0.0


@pytest.mark.looptime
@each("due_s", [0.0, math.inf])
async def test_requests_have_half_of_the_time_while_control_ticks_are_due(due_s: float) -> None:
    """And no more of it for a client that sends the next one when it has the answer."""
    loop, begun = asyncio.get_running_loop(), list[float]()
    pauses = Slices(loop, lambda: due_s)
    pauses.now = lambda: loop.time() + 0.006 * len(begun)  # each takes 6 ms of the loop
    turns = Turns(loop, pauses)

    def work() -> bool:
        begun.append(loop.time())
        return len(begun) < 3  # then one at a time

    session = Mock(work=work, restricted=False)
    while len(begun) < 5:
        turns.add(session)
        await asyncio.sleep(0.001)
    paused = [after - before for before, after in itertools.pairwise(begun)]
    assert paused == pytest.approx([0.006 if due_s == 0.0 else 0.0] * 4, abs=0.0011)


@pytest.mark.looptime
async def test_a_client_whose_lines_take_long_waits_and_the_others_do_not() -> None:
    loop, begun = asyncio.get_running_loop(), {"long": list[float](), "short": list[float]()}
    pauses = Slices(loop, lambda: 0.0)
    pauses.now = lambda: loop.time() + 0.04 * len(begun["long"])
    turns = Turns(loop, pauses)
    sessions = {name: Mock(restricted=False) for name in begun}
    sessions["long"].work = lambda: begun["long"].append(loop.time()) or True  # type: ignore[func-returns-value]
    sessions["short"].work = lambda: begun["short"].append(loop.time())
    turns.add(sessions["long"])
    while loop.time() < 1.0:
        turns.add(sessions["short"])
        turns.add(sessions["long"])  # more of it comes
        await asyncio.sleep(0.001)
    paused = {name: [after - before for before, after in itertools.pairwise(times)] for name, times in begun.items()}
    assert min(paused["long"]) >= 0.12 and len(begun["long"]) >= 7
    assert max(paused["short"]) <= MOST_REST_S + 0.002


class Ticks:
    """Control ticks at these times of the loop; one that has passed is gone, unless nobody carries it out."""

    def __init__(self, *due_s: float, carried_out: bool = True) -> None:
        self.due_s = due_s
        self.carried_out = carried_out
        self.loop = asyncio.get_running_loop()

    def next(self) -> float:
        now = self.loop.time()
        return min((due for due in self.due_s if due > now or not self.carried_out), default=math.inf)

    def slices(self) -> Slices:
        return Slices(self.loop, self.next)


async def began_at(tested: Slices) -> float:
    """When the first slice of a list begins."""
    loop = asyncio.get_running_loop()
    at: list[float] = []
    await tested.encoded_list(at.append(loop.time()) for _ in range(1))
    return at[0]


@pytest.mark.looptime
async def test_a_slice_begins_at_once_if_it_ends_before_the_next_control_tick() -> None:
    assert await began_at(Ticks(AHEAD_S * 1.01).slices()) == 0.0
    assert await began_at(Ticks().slices()) == 0.0


@pytest.mark.looptime
async def test_a_slice_that_would_meet_control_ticks_begins_after_them() -> None:
    ticks = Ticks(AHEAD_S / 2, AHEAD_S, AHEAD_S * 2.5)
    assert AHEAD_S <= await began_at(ticks.slices()) < AHEAD_S * 1.5


@pytest.mark.looptime
async def test_a_control_tick_that_is_late_comes_before_a_slice() -> None:
    ticks = Ticks(0.0, carried_out=False)
    tested = ticks.slices()
    by = tested.begins_by()
    assert tested.wait_s(by) == LOOK_S
    ticks.carried_out = True
    assert tested.wait_s(by) is None


@pytest.mark.looptime
async def test_dense_control_ticks_put_no_slice_off_for_long() -> None:
    ticks = Ticks(*(n * AHEAD_S / 2 for n in range(100)))
    assert PUT_OFF_S <= await began_at(ticks.slices()) < PUT_OFF_S + AHEAD_S


@pytest.mark.looptime
async def test_a_slice_after_a_pause_has_its_whole_time() -> None:
    tested = Ticks(0.0, carried_out=False).slices()
    by = tested.begins_by(PAUSE_S)
    await asyncio.sleep(PUT_OFF_S)
    assert tested.wait_s(by) == LOOK_S
    await asyncio.sleep(PAUSE_S)
    assert tested.wait_s(by) is None


async def test_what_reads_much_for_each_of_many_vehicles_does_so_one_a_turn() -> None:
    """Limits of 250 parameters and items of 700 were looked at for 60 vehicles at once: 20 s, and 1 s."""
    turns, looks = 0, []

    def look(*_: object, **__: object) -> Any:
        looks.append(turns)
        return {}

    async def bring(*_: object, **__: object) -> Outcome:
        look()
        return Outcome(True, "accepted", "")

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    metadata = SimpleNamespace(refusals=look, notes=lambda values: {})
    setting = SimpleNamespace(set=lambda *_, **__: asyncio.sleep(0, {}))
    vehicles = [SimpleNamespace(name=f"v{n}", metadata=metadata, params=setting) for n in range(9)]
    fleet = SimpleNamespace(resolve=lambda targets: vehicles)
    context = cast(Any, SimpleNamespace(services=SimpleNamespace(fleet=fleet), reports=None))
    counting = asyncio.create_task(count())
    await params._each(context, params.ParamSetParams(targets="all", params={"A": 1.0}), _looked)
    services = SimpleNamespace(locks=SimpleNamespace(refusal=lambda write: None), one_a_turn=OneATurn())
    missions, config = SimpleNamespace(bring=bring), SimpleNamespace(goto_limit_m=1.0)
    actor = cast(Any, SimpleNamespace(services=services, missions=missions, config=config))
    actor.vehicle, actor.outcomes = (
        SimpleNamespace(key=1),
        SimpleNamespace(tracked=lambda order: nullcontext(lambda outcome: outcome)),
    )
    await asyncio.gather(*(onboard_orders.upload_plan(actor, plan=MissionPlan(), kinds=()) for _ in range(9)))
    counting.cancel()
    assert len(looks) == len(set(looks)) == 18


async def _looked(vehicle: Any) -> dict[str, Any]:
    return cast(dict[str, Any], vehicle.metadata.refusals())
