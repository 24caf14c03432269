"""Actions of one vehicle against a daemon of the test: races of cancel, replacement and loss, limits, hostile bytes."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.core.ros.action_goals import ABORTED, CANCELED, CANCELING, EXECUTING, SUCCEEDED
from skygcs.errors import DaemonUnreachable
from skygcs.ext.ros.action_server import MOST_WAITING
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.graph import SharedTopics
from skygcs.ext.ros.vehicle_actions import VehicleActions
from skygcs.ext.ros.vehicle_topics import VehicleTopics
from support.ros_bridge import Goal, soon
from support.ros_node import KeptNode

pytestmark = pytest.mark.looptime

PLACE = {"position": {"x": 30.0, "y": 0.0, "z": 10.0}}


class Daemon:
    """Orders wait for `answer`."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any], asyncio.Future[dict[str, Any]]]] = []

    async def call(self, method: str, **params: Any) -> Any:
        future: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self.asked.append((method, params, future))
        return {"outcomes": {"alpha": await future}}

    async def answer(self, method: str, ok: bool = True, message: str = "done") -> None:
        await soon(lambda: any(asked[0] == f"vehicles.{method}" for asked in self.asked))
        index = next(i for i, asked in enumerate(self.asked) if asked[0] == f"vehicles.{method}")
        self.asked.pop(index)[2].set_result({"ok": ok, "message": message})
        for _ in range(5):
            await asyncio.sleep(0)

    def die(self) -> None:
        for _, _, future in self.asked:
            future.set_exception(DaemonUnreachable("s", "it has ended"))


class Rig:
    def __init__(self) -> None:
        self.node, self.orders, self.now = KeptNode(), 0, 100.0
        self.daemon: Daemon | None = Daemon()
        self.vehicle = VehicleTopics(SharedTopics(self.node), RosConfig(), self.state(), 0)
        self.actions = VehicleActions(
            self.node,
            self.vehicle,
            lambda: self.daemon,  # type: ignore[arg-type, return-value]
            lambda: 2.5,
            self.on_order,
            lambda: self.now,
            lambda: round(self.now * 1e9),
        )
        for publication in self.node.publications.values():
            publication.readers = 1

    def on_order(self) -> None:
        self.orders += 1

    def state(self, x_m: float = 0.0, mode: str = "AUTO.LOITER", **more: Any) -> dict[str, Any]:
        position = {"enu_m": [x_m, 0.0, 10.0], "alt_rel_m": 10.0, "age_s": 0.0, "vel_enu_mps": [0.0, 0.0, 0.0]}
        plain = {"name": "alpha", "sysid": 1, "connected": True, "armed": True, "mode": mode, "landed": "in_air"}
        return {**plain, "position": position, **more}

    async def begin(self, action: str = "goto") -> Goal:
        assert self.daemon is not None
        sent = Goal(self.node, f"/alpha/skygcs/{action}")
        task = asyncio.create_task(
            sent.service("send_goal").call(goal_id=sent.id, goal=PLACE if action == "goto" else {})
        )
        await self.daemon.answer(action)
        sent.accepted = (await task)["accepted"]
        return sent

    def outcome(self, order: str) -> None:
        self.actions.on_event({"kind": "command", "vehicle": "alpha", "data": {"order": order, "ok": True}})

    @property
    def table(self) -> Any:
        return self.actions.servers["goto"].table


@pytest.fixture
async def rig() -> Rig:
    return Rig()


async def test_a_goal_is_accepted_when_the_daemon_has_accepted_it(rig: Rig) -> None:
    assert rig.daemon is not None
    goal = Goal(rig.node, "/alpha/skygcs/goto")
    task = asyncio.create_task(goal.service("send_goal").call(goal_id=goal.id, goal=PLACE))
    await asyncio.sleep(0.1)
    assert not task.done() and goal.status() == 0
    assert rig.daemon.asked[0][1] == {"targets": "alpha", "enu_m": [30.0, 0.0, 10.0]}
    await rig.daemon.answer("goto", ok=False, message="refused: too far")
    assert (await task)["accepted"] is False
    assert rig.node.last("/rosout")["msg"] == "goto: goal refused: refused: too far"
    assert rig.orders == 0 and rig.table.refused == 1
    assert (await rig.begin()).status() == EXECUTING and rig.orders == 1


async def test_the_client_of_a_service_that_is_gone_leaves_no_goal(rig: Rig) -> None:
    goal = Goal(rig.node, "/alpha/skygcs/goto")
    task = asyncio.create_task(goal.service("send_goal").call(goal_id=goal.id, goal=PLACE))
    await asyncio.sleep(0.1)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert rig.daemon is not None
    rig.daemon.asked.clear()
    assert (await rig.begin()).accepted


async def test_results_wait_within_their_own_limit(rig: Rig) -> None:
    goal = await rig.begin()
    waiting = [asyncio.create_task(goal.result()) for _ in range(MOST_WAITING + 10)]
    await asyncio.sleep(0.1)
    assert goal.service("get_result").overflown == 10
    assert (await goal.cancel())["return_code"] == 0  # other services of the action answer
    assert rig.daemon is not None
    await rig.daemon.answer("hold")
    results = await asyncio.gather(*waiting, return_exceptions=True)
    assert sum(isinstance(result, TimeoutError) for result in results) == 10
    assert {r["status"] for r in results if isinstance(r, dict)} == {CANCELED}
    assert rig.actions.counters()["result_requests_dropped"] == 10
    assert not rig.actions.servers["goto"]._ended


async def test_a_cancel_holds_once_and_ends_by_the_hold_alone(rig: Rig) -> None:
    assert rig.daemon is not None
    goal = await rig.begin()
    rig.outcome("goto")
    for _ in range(3):
        answer = await goal.cancel()
        assert answer["return_code"] == 0 and len(answer["goals_canceling"]) == 1
    await asyncio.sleep(0)
    assert [asked[0] for asked in rig.daemon.asked] == ["vehicles.hold"] and goal.status() == CANCELING
    rig.outcome("hold")  # its own
    rig.actions.on_state(rig.state(mode="BRAKE"))
    assert goal.status() == CANCELING
    await rig.daemon.answer("hold", message="holding")
    assert (await goal.result())["result"]["reason"] == "cancelled: holding" and goal.status() == CANCELED


async def test_a_hold_that_is_refused_aborts(rig: Rig) -> None:
    assert rig.daemon is not None
    goal = await rig.begin()
    await goal.cancel()
    await rig.daemon.answer("hold", ok=False, message="refused: no position")
    result = await goal.result()
    assert result["status"] == ABORTED and "not held: refused: no position" in result["result"]["reason"]


async def test_a_goal_that_is_cancelled_before_it_is_accepted_is_held_at_once(rig: Rig) -> None:
    assert rig.daemon is not None
    goal = Goal(rig.node, "/alpha/skygcs/goto")
    task = asyncio.create_task(goal.service("send_goal").call(goal_id=goal.id, goal=PLACE))
    await asyncio.sleep(0.1)
    assert (await goal.cancel())["return_code"] == 0
    await rig.daemon.answer("goto")
    assert (await task)["accepted"] and goal.status() == CANCELING
    await rig.daemon.answer("hold")
    assert goal.status() == CANCELED


async def test_a_goal_of_another_action_replaces_even_one_that_is_canceling(rig: Rig) -> None:
    assert rig.daemon is not None
    first = await rig.begin()
    await first.cancel()
    second = await rig.begin("land")
    assert first.status() == ABORTED and second.status() == EXECUTING
    await rig.daemon.answer("hold", ok=False, message="superseded")  # of the first
    assert second.status() == EXECUTING
    third = await rig.begin()
    assert (second.status(), third.status()) == (ABORTED, EXECUTING)
    await third.cancel()
    await rig.daemon.answer("hold")
    assert third.status() == CANCELED
    assert rig.actions.counters()["goals_aborted"] == 2


async def test_the_loss_of_the_daemon_ends_everything_at_once(rig: Rig) -> None:
    daemon = rig.daemon
    assert daemon is not None
    goal = await rig.begin()
    landing = Goal(rig.node, "/alpha/skygcs/land")
    asked = asyncio.create_task(landing.service("send_goal").call(goal_id=landing.id, goal={}))
    await goal.cancel()
    await asyncio.sleep(0)
    rig.daemon = None
    daemon.die()
    rig.actions.lost()
    assert goal.status() == ABORTED  # at once, without a turn of the loop
    assert "connection to the daemon is lost" in (await goal.result())["result"]["reason"]
    assert (await asked)["accepted"] is False
    other = Goal(rig.node, "/alpha/skygcs/goto")
    assert not (await other.service("send_goal").call(goal_id=other.id, goal=PLACE))["accepted"]
    rig.daemon = Daemon()
    assert (await rig.begin()).accepted


async def test_feedback_goes_out_with_each_state_and_ends_with_the_goal(rig: Rig) -> None:
    goal = await rig.begin()
    for x_m in (0.0, 10.0, 20.0, 29.5, 29.5):
        rig.now += 1.0
        rig.actions.on_state(rig.state(x_m))
    assert [feedback["distance_m"] for feedback in goal.feedback()] == [30.0, 20.0, 10.0, 0.5]
    assert (await goal.result())["status"] == SUCCEEDED and rig.actions.status() == ""
    rig.now += 1e6
    rig.actions.step()
    assert goal.status() == 0 and not rig.table.goals


async def test_silence_of_the_daemon_ends_a_goal(rig: Rig) -> None:
    goal = await rig.begin()
    rig.now += 2.9
    rig.actions.step()
    assert goal.status() == EXECUTING and rig.actions.status() == "goto nan m left"
    rig.now += 0.2
    rig.actions.step()
    assert goal.status() == ABORTED


async def test_goals_without_end_are_refused_and_remembered_within_bounds(rig: Rig) -> None:
    for _ in range(100):
        await rig.begin()
    assert len(rig.table.goals) == 65 and len(rig.table.under_way) == 1
    assert rig.actions.counters()["results_forgotten"] == 35
    assert not rig.actions._asked and not rig.actions._holds


async def test_a_cancel_of_an_older_goal_sends_nothing_where_a_newer_order_was_sent(rig: Rig) -> None:
    assert rig.daemon is not None
    old, landing = await rig.begin(), Goal(rig.node, "/alpha/skygcs/land")
    sent = asyncio.create_task(landing.service("send_goal").call(goal_id=landing.id, goal={}))
    await soon(lambda: rig.daemon is not None and bool(rig.daemon.asked))
    for _ in range(2):
        assert (await old.cancel())["return_code"] == 0
    await asyncio.sleep(0.1)
    assert [asked[0] for asked in rig.daemon.asked] == ["vehicles.land"]
    await rig.daemon.answer("land")
    assert (await sent)["accepted"] and landing.status() == EXECUTING
    result = await old.result()
    assert result["status"] == ABORTED and result["result"]["reason"] == "replaced: land was ordered"
    await asyncio.sleep(0.1)
    assert rig.daemon.asked == [] and landing.status() == EXECUTING


async def test_a_cancel_holds_once_the_newer_order_was_refused(rig: Rig) -> None:
    assert rig.daemon is not None
    old, landing = await rig.begin(), Goal(rig.node, "/alpha/skygcs/land")
    sent = asyncio.create_task(landing.service("send_goal").call(goal_id=landing.id, goal={}))
    await soon(lambda: rig.daemon is not None and bool(rig.daemon.asked))
    await old.cancel()
    await rig.daemon.answer("land", ok=False, message="refused: not yours")
    assert not (await sent)["accepted"]
    await rig.daemon.answer("hold", message="holding")
    assert old.status() == CANCELED and rig.daemon.asked == []
