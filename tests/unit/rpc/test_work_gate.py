"""Calls that go to vehicles pass one gate: counted by their targets, and their room is free again however they end."""

from __future__ import annotations

import asyncio
import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.errors import RefusedError, TargetError
from skygcs.rpc.dispatch import LimitExceeded, Method
from skygcs.rpc.models import NoParams, TargetsParams
from skygcs.rpc.work_gate import MAX_ITEMS_OF_A_CLIENT, WorkGate
from support.extension_parts import ALL_METHODS

pytestmark = pytest.mark.looptime

FLEET = [SimpleNamespace(name=f"v{number}") for number in range(250)]
COROUTINES = [method for method in ALL_METHODS.values() if method.waits]
COUNTED = [method for method in COROUTINES if method.goes_to != "nothing" and (method.ends_flight or not method.always)]


def resolve(targets: str) -> list[SimpleNamespace]:
    if targets == "nobody":
        raise TargetError("there is no nobody")
    return FLEET if targets == "all" else FLEET[:1]


class Client:
    def __init__(self) -> None:
        self.reports: object | None = None

    @property
    def client(self) -> object:
        return self


class Work:
    """Handler that is carried out when the test says so."""

    def __init__(self) -> None:
        self.begun = 0
        self.end = asyncio.Event()
        self.error: BaseException | None = None

    async def __call__(self, context: Client, params: Any) -> dict[str, int]:
        self.begun += 1
        number = self.begun
        await self.end.wait()
        if self.error is not None:
            raise self.error
        return {"call": number}


def method(work: Work, *, ends_flight: bool = False) -> Method[Any]:
    return Method("vehicles.do", TargetsParams, work, always=ends_flight, outlives_client=ends_flight)


async def carried_out(gate: WorkGate, called: Method[Any], client: Any, params: Any) -> Any:
    async with gate.room(called, client, params) as outcome:
        if not outcome.done():
            outcome.set_result(await called.handler(client, params))
    return outcome.result()


async def begun(gate: WorkGate, called: Method[Any], client: Client, targets: str = "all") -> asyncio.Task[Any]:
    task = asyncio.ensure_future(carried_out(gate, called, client, TargetsParams(targets=targets)))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return task


@pytest.mark.parametrize("name", [method.name for method in COUNTED])
async def test_every_method_of_the_table_that_waits_for_vehicles_is_counted(name: str) -> None:
    gate, work = WorkGate(resolve), Work()
    called = dataclasses.replace(ALL_METHODS[name], handler=work, reached=None)  # these: the next test
    params = called.params.model_construct(targets="all", target="all")
    task = asyncio.ensure_future(carried_out(gate, called, Client(), params))
    await asyncio.sleep(0)
    assert work.begun == 1 and gate.bound.items == gate.stats()["vehicle_orders"] == len(FLEET)
    work.end.set()
    await task
    assert gate.bound.items == 0


@pytest.mark.parametrize(
    ("name", "params", "items"),
    [
        ("plan.check", {"vehicles": {"a": "v1", "b": "v7", "c": "v9"}}, 3),
        ("plan.run", {"vehicles": {"a": "v1", "b": "nobody"}}, 1),
        ("plan.check", {}, 2),
        ("plan.resume", {}, 1),
    ],
)
async def test_a_plan_is_counted_by_the_vehicles_that_fly_it(name: str, params: dict[str, Any], items: int) -> None:
    """With 240 vehicles two checks of a plan for three took all the room of a web process' browsers."""
    by_name = {actor.name: actor for actor in FLEET}

    def resolve_one(target: str) -> list[SimpleNamespace]:
        if target not in by_name:
            raise TargetError(f"there is no {target}")
        return [by_name[target]]

    gate, work = WorkGate(resolve_one), Work()
    starts = {"v3": (0.0, 0.0, 0.0), "v4": (5.0, 0.0, 0.0)}
    runner = SimpleNamespace(
        kept=SimpleNamespace(plan=SimpleNamespace(starts=starts)), flight=SimpleNamespace(actors={"v3": None})
    )
    services = SimpleNamespace(extensions={"plan": SimpleNamespace(runner=runner)})
    client: Any = SimpleNamespace(client=1, reports=None, services=services)
    called = dataclasses.replace(ALL_METHODS[name], handler=work)
    task = asyncio.ensure_future(carried_out(gate, called, client, called.params(**params)))
    await asyncio.sleep(0)
    assert work.begun == 1 and gate.bound.items == items
    work.end.set()
    await task


async def test_a_method_that_declares_nothing_is_counted_as_the_whole_fleet() -> None:
    gate, work = WorkGate(resolve), Work()
    undeclared = Method("beacon.clear", NoParams, work)
    task = asyncio.ensure_future(carried_out(gate, undeclared, Client(), NoParams()))
    await asyncio.sleep(0)
    assert gate.bound.items == len(FLEET)
    work.end.set()
    await task
    assert gate.bound.items == 0
    local = dataclasses.replace(undeclared, reach="nothing")
    task = asyncio.ensure_future(carried_out(gate, local, Client(), NoParams()))
    await asyncio.sleep(0)
    assert gate.bound.items == 0
    await task


def test_a_method_without_targets_declares_what_it_reaches() -> None:
    undeclared = [m.name for m in COROUTINES if m.reach is None and m.goes_to == "fleet"]
    assert undeclared == []


def test_the_table_has_what_a_fleet_is_asked() -> None:
    names = {method.name for method in COUNTED}
    assert names >= {"vehicles.hold", "vehicles.mode", "preflight.run", "params.list", "missions.upload", "logs.list"}
    assert names >= {"plan.run", "plan.check", "plan.resume", "formation.start", "drills.begin", "undo.run"}
    assert {method.name for method in COUNTED if method.ends_flight} == {
        f"vehicles.{order}" for order in ("land", "rtl", "hold", "stop", "disarm")
    }


@pytest.mark.parametrize("ends_flight", [False, True])
@pytest.mark.parametrize("error", [RefusedError("no"), ZeroDivisionError(), asyncio.CancelledError()])
async def test_the_room_is_free_again_after_a_failure(error: BaseException, ends_flight: bool) -> None:
    gate, work, client = WorkGate(resolve), Work(), Client()
    work.error = error
    called = method(work, ends_flight=ends_flight)
    if ends_flight and isinstance(error, asyncio.CancelledError):
        client.reports = object()
    tasks = [await begun(gate, called, client) for _ in range(2)]
    assert gate.bound.items in (len(FLEET), 2 * len(FLEET))
    work.end.set()
    results = await asyncio.gather(*tasks, return_exceptions=True)
    assert [type(result) for result in results] == [type(error)] * 2
    assert gate.bound.items == 0


@pytest.mark.parametrize("ends_flight", [False, True])
async def test_the_room_is_free_again_after_a_cancellation(ends_flight: bool) -> None:
    gate, work, client = WorkGate(resolve), Work(), Client()
    called = method(work, ends_flight=ends_flight)
    first, second = [await begun(gate, called, client) for _ in range(2)]
    second.cancel()  # one that has joined takes the one that is carried out not with it
    await asyncio.wait({second})
    assert second.cancelled() and gate.bound.items == len(FLEET)
    first.cancel()
    await asyncio.wait({first})
    assert gate.bound.items == 0


async def test_a_task_that_never_began_takes_no_room() -> None:
    gate = WorkGate(resolve)
    task = asyncio.ensure_future(carried_out(gate, method(Work()), Client(), TargetsParams(targets="all")))
    task.cancel()
    await asyncio.wait({task})
    assert gate.bound.items == 0


async def test_a_greedy_client_is_refused_and_another_is_not() -> None:
    gate, work, greedy = WorkGate(resolve), Work(), Client()
    called = method(work)
    tasks = [await begun(gate, called, greedy) for _ in range(64)]
    refused = [task for task in tasks if task.done()]
    assert len(refused) == 61 and gate.bound.items == 3 * len(FLEET) <= MAX_ITEMS_OF_A_CLIENT + len(FLEET)
    assert isinstance(refused[0].exception(), LimitExceeded)
    assert gate.stats()["vehicle_orders"] == 750 and gate.stats()["vehicle_orders_refused"] == 61
    assert not (await begun(gate, called, Client())).done()
    ending = await begun(gate, method(Work(), ends_flight=True), greedy)
    assert not ending.done()
    work.end.set()
    await asyncio.gather(*tasks, return_exceptions=True)
    assert gate.bound.items == 2 * len(FLEET) - len(FLEET)


async def test_the_same_hold_at_once_is_one_with_the_same_outcome() -> None:
    gate, work, client = WorkGate(resolve), Work(), Client()
    called = method(work, ends_flight=True)
    tasks = [await begun(gate, called, client) for _ in range(64)]
    other_vehicles = await begun(gate, called, client, "v0")
    assert work.begun == 2 and gate.stats()["vehicle_orders_joined"] == 63
    work.end.set()
    assert await asyncio.gather(*tasks) == [{"call": 1}] * 64
    assert await other_vehicles == {"call": 2}


async def test_one_that_joined_is_carried_out_itself_if_the_other_is_cancelled() -> None:
    """The order of a client that left, for example."""
    gate, work = WorkGate(resolve), Work()
    called = method(work, ends_flight=True)
    first, second = [await begun(gate, called, Client()) for _ in range(2)]
    assert work.begun == 1
    first.cancel()
    await asyncio.wait({first})
    await asyncio.sleep(0)
    assert work.begun == 2 and gate.bound.items == len(FLEET)
    work.end.set()
    assert await second == {"call": 2}


async def test_a_hold_after_any_other_call_or_with_reports_is_carried_out_anew() -> None:
    gate, work = WorkGate(resolve), Work()
    called = method(work, ends_flight=True)
    await begun(gate, called, Client())
    gate.asked(ALL_METHODS["alarms.list"])  # only shows
    await begun(gate, called, Client())
    assert work.begun == 1
    gate.asked(ALL_METHODS["control.setpoint"])
    await begun(gate, called, Client())
    assert work.begun == 2
    reported = Client()
    reported.reports = object()
    await begun(gate, called, reported)
    assert work.begun == 3
    await asyncio.sleep(1.0)
    await begun(gate, called, Client())
    assert work.begun == 4
    work.end.set()


async def test_a_flood_of_holds_between_other_calls_is_one_each_half_second_and_the_last_is_in_force() -> None:
    gate, work, client = WorkGate(resolve), Work(), Client()
    called = method(work, ends_flight=True)
    tasks = []
    for _ in range(60):
        gate.asked(ALL_METHODS["control.setpoint"])
        tasks.append(await begun(gate, called, client))
    assert work.begun == 2 and gate.stats()["vehicle_orders_delayed"] == 58
    await asyncio.sleep(1.0)
    assert work.begun == 3, "one for all that waited, after the last setpoint"
    work.end.set()
    assert [result["call"] for result in await asyncio.gather(*tasks)] == [1, 2, *[3] * 58]
    assert gate.bound.items == 0


async def test_targets_that_name_nobody_are_left_to_the_method() -> None:
    gate, work = WorkGate(resolve), Work()
    work.error = TargetError("there is no nobody")
    task = await begun(gate, method(work), Client(), "nobody")
    assert gate.bound.items == 1
    work.end.set()
    await asyncio.wait({task})
    assert isinstance(task.exception(), TargetError) and gate.bound.items == 0
