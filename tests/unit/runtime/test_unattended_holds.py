"""The watch over a vehicle that nobody flies, between orders, flights elsewhere and messages of other stations."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.unattended import GRACE_S, HEARTBEAT_SILENT_S, OURS, REPEAT_S, STREAM_S
from skygcs.events import Event
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.unattended_holds import UnattendedHolds
from support.frames import dialect, frame
from support.table import each

pytestmark = pytest.mark.looptime

ELSEWHERE = "the program at the companion"
SILENT_AFTER_S = 2.0


class OurControl(OffboardEngagement):
    def __init__(self) -> None:
        self.controller: Any = SimpleNamespace(active=False)


class Rig:
    """A copter in GUIDED in the air. ``outcomes``: of the next orders to hold; then each is accepted."""

    def __init__(self, *, elsewhere: bool = False, flown_before: str | None = None) -> None:
        loop = asyncio.get_running_loop()
        self.now = loop.time
        self.silent_s = 0.0
        self.flown_by: str | None = None
        self.vehicle: Any = SimpleNamespace(
            name="v1",
            sysid=1,
            connected=True,
            mode="GUIDED",
            family="ardupilot",
            abilities=SimpleNamespace(setpoints=True),
            silence_s=lambda now: self.silent_s,
            under_way=lambda now: True,
        )
        self.elsewhere: Any = SimpleNamespace(
            flown_by=lambda now: self.flown_by, reported=False, silent_after_s=SILENT_AFTER_S
        )
        self.ours = OurControl()
        self.ordered: list[str] = []
        self.outcomes: list[Outcome] = []
        self.orders: Any = SimpleNamespace(
            ledger=SimpleNamespace(in_progress=0),
            attempt=self._attempt("attempt"),
            attempt_in_control=self._attempt("in control"),
        )
        self.events: list[Event] = []
        self.holds = UnattendedHolds(
            self.vehicle,
            self.elsewhere if elsewhere else self.ours,
            self.orders,
            lambda now: None,  # type: ignore[arg-type, return-value]
            loop,
            self.events.append,
            flown_before=flown_before,
        )

    def _attempt(self, way: str) -> Callable[[Any], Awaitable[Outcome]]:
        async def attempt(planner: Any) -> Outcome:
            self.ordered.append(way)
            return self.outcomes.pop(0) if self.outcomes else Outcome(True, "accepted", "holding")

        return attempt

    async def run(self, seconds: float, site: str | None = None) -> list[str]:
        """The orders to hold meanwhile."""
        before, end = len(self.ordered), self.now() + seconds
        while self.now() < end:
            self.holds.tick(self.now(), site)
            await asyncio.sleep(0.2)
        return self.ordered[before:]

    async def flown(self) -> None:
        self.ours.controller.active, self.flown_by = True, ELSEWHERE
        assert await self.run(1.0) == []
        self.ours.controller.active, self.flown_by = False, None

    def texts(self) -> list[str]:
        return [event.text for event in self.events]


@each(("elsewhere", "way", "who"), [(False, "in control", OURS), (True, "attempt", ELSEWHERE)])
async def test_one_that_nobody_flies_any_more_is_ordered_to_hold_once(elsewhere: bool, way: str, who: str) -> None:
    rig = Rig(elsewhere=elsewhere)
    await rig.flown()
    assert await rig.run(10.0) == [way]
    assert rig.texts() == [f"nobody flies it in GUIDED ({who} did): it is ordered to hold", "nobody flew it: holding"]
    assert [event.data for event in rig.events] == [{"flown_before": who}, {"hold": True}]


@each(
    ("changed", "held"),
    [
        ({"site": "south"}, False),
        ({"moving": 1}, False),
        ({"plane": True}, False),
        ({"silent_s": HEARTBEAT_SILENT_S}, True),
        ({"silent_s": HEARTBEAT_SILENT_S + 0.1}, False),
        ({"lost": True}, False),
        ({"mode": "LOITER"}, False),
    ],
)
async def test_who_may_fly_it_or_what_is_not_known_leaves_it_alone(changed: dict[str, Any], held: bool) -> None:
    rig = Rig()
    await rig.flown()
    rig.orders.ledger.in_progress = changed.get("moving", 0)
    rig.silent_s = changed.get("silent_s", 0.0)
    rig.vehicle.connected = "lost" not in changed
    rig.vehicle.mode = changed.get("mode", "GUIDED")
    rig.vehicle.abilities.setpoints = "plane" not in changed
    assert bool(await rig.run(3.0, changed.get("site"))) is held


async def test_a_hold_that_is_denied_is_given_again_and_reported_once() -> None:
    rig = Rig()
    await rig.flown()
    rig.outcomes = [Outcome(False, "denied", "denied")] * 3 + [Outcome(False, "cancelled", "a newer order")]
    assert len(await rig.run(GRACE_S + 3 * REPEAT_S + 0.4)) == 4
    said = rig.texts()
    assert said[1:] == ["nobody flew it: denied; it is ordered again while nobody flies it, or land it: vehicles.land"]
    await rig.run(REPEAT_S)
    assert rig.texts()[2:] == ["nobody flew it: holding"]


async def test_a_hold_that_was_not_answered_is_reported_when_its_mode_shows_it() -> None:
    rig = Rig()
    await rig.flown()
    rig.outcomes = [Outcome(False, "timeout", "no answer")]
    assert len(await rig.run(1.0)) == 1
    assert rig.texts()[1:] == ["nobody flew it: no answer"]
    rig.vehicle.mode = "BRAKE"
    assert await rig.run(1.0) == []
    assert rig.texts()[2:] == ["it holds in BRAKE, as it was ordered while it was not heard"]
    assert rig.events[-1].data == {"hold": True}


async def test_what_its_autopilot_carries_out_and_control_that_ends_between_two_looks() -> None:
    rig = Rig()
    await rig.flown()
    rig.orders.on_carried_out(SimpleNamespace(order="goto"))
    assert await rig.run(5.0) == []
    rig.orders.on_carried_out(SimpleNamespace(order="arm"))
    rig.holds.on_begin()
    assert await rig.run(1.0) == ["in control"]
    rig.holds.on_begin()
    rig.holds.on_hold(Outcome(True, "accepted", "holding"))
    assert await rig.run(5.0) == []


@each(
    ("flown_before", "reported", "after_s"),
    [(ELSEWHERE, False, SILENT_AFTER_S), (ELSEWHERE, True, 0.0), (None, False, None)],
)
async def test_a_program_that_flew_it_before_a_restart_has_its_time_to_answer(
    flown_before: str | None, reported: bool, after_s: float | None
) -> None:
    rig = Rig(elsewhere=True, flown_before=flown_before)
    rig.elsewhere.reported = reported
    rig.vehicle.connected = False
    assert await rig.run(5.0) == []
    rig.vehicle.connected = True
    if after_s is None:
        assert await rig.run(10.0) == []
    else:
        assert await rig.run(after_s) == []
        assert await rig.run(GRACE_S + 0.6) == ["attempt"]


@each(
    ("message", "fields", "flies", "stays"),
    [
        ("SET_ATTITUDE_TARGET", {}, True, False),
        ("SET_POSITION_TARGET_LOCAL_NED", {"type_mask": 0b111}, True, False),
        ("SET_POSITION_TARGET_LOCAL_NED", {"type_mask": 0b111000}, False, True),
        ("SET_POSITION_TARGET_GLOBAL_INT", {"type_mask": 0b1}, True, False),
        ("SET_MODE", {"custom_mode": 4}, False, True),
        ("COMMAND_LONG", {"command": mav_cmd.DO_REPOSITION}, False, True),
        ("COMMAND_INT", {"command": mav_cmd.NAV_TAKEOFF}, False, True),
        ("COMMAND_LONG", {"command": 511}, False, False),
    ],
)
async def test_messages_of_another_station_show_whether_it_flies_it(
    message: str, fields: dict[str, Any], flies: bool, stays: bool
) -> None:
    rig = Rig()
    await rig.flown()
    raw = frame(message, {"target_system": 1, **fields}, sysid=250, compid=190)
    rig.holds.on_station(received(raw), rig.now())
    assert bool(await rig.run(STREAM_S - 0.2)) is (not flies and not stays)
    assert bool(await rig.run(5.0)) is flies
    if flies:
        assert "(250/190 did)" in rig.texts()[0]


def received(raw: bytes) -> Any:
    (one,) = FrameParser(dialect()).feed_datagram(raw)
    return one
