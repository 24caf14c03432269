"""Entry, exit, ticks, pings and trace of one vehicle's control, against a commander that does what a test says."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Hashable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.control import ControlSettings
from skygcs.config.models import VehicleConfig
from skygcs.core.control.analysis import bearable_delay_s
from skygcs.core.control.guard import CONTROL_MODES, ControlMode
from skygcs.core.control.trace import decode
from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.protocols.command import Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.trajectory.timing import hover
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.flight_lock import OriginChange
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.gate import Clearance
from skygcs.core.vehicle.offboard_controller import OffboardState
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, common_clock
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.stream_requester import StreamRequester
from support.services import KnownLinks, services
from support.vehicles import HOME, PX4, PX4_LOITER, PX4_RTL, Voice, flight_dialect

pytestmark = pytest.mark.looptime

OFFBOARD = 6 << 16
ORIGIN = Origin(*HOME)
SETPOINTS = {
    "SET_ATTITUDE_TARGET": ControlMode.ATTITUDE,
    "SET_POSITION_TARGET_LOCAL_NED": ControlMode.VELOCITY,
    "SET_POSITION_TARGET_GLOBAL_INT": ControlMode.POSITION,
}


def place(x_m: float, y_m: float, up_m: float) -> GeodeticPosition:
    return GeodeticPosition(*geodetic_from_enu(x_m, y_m, up_m, ORIGIN))


class FakeCommander:
    """Takes messages; a TIMESYNC is answered after ``rtt_s``, unless that is None."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, str, Mapping[str, Any], Priority, Hashable | None]] = []
        self.rtt_s: float | None = 0.01
        self.fails: Exception | None = None
        self.on_timesync: Callable[[int], None] = lambda ts1: None

    def transmit(
        self,
        message: str,
        values: Mapping[str, Any],
        priority: Priority = Priority.COMMAND,
        key: Hashable | None = None,
        clearance: Clearance | None = None,
    ) -> bool:
        if self.fails is not None and message in SETPOINTS:
            raise self.fails
        loop = asyncio.get_running_loop()
        self.sent.append((loop.time(), message, values, priority, key))
        if message == "TIMESYNC" and self.rtt_s is not None:
            loop.call_later(self.rtt_s, self.on_timesync, values["ts1"])
        return True

    async def until(self, met: Callable[[], bool], timeout_s: float) -> bool:
        ends = asyncio.get_running_loop().time() + timeout_s
        while not met() and asyncio.get_running_loop().time() < ends:  # noqa: ASYNC110 - a fake may look again and again
            await asyncio.sleep(0.05)
        return met()


class Field:
    """One PX4 in the air that tells its position 50 times a second, and its flight control.

    ``enters``: it takes the mode; ``orders`` are the plans that were carried out.
    """

    def __init__(self, log_dir: Path, **settings: Any) -> None:
        self.loop = asyncio.get_running_loop()
        self.voice = Voice(1)
        self.vehicle = Vehicle(1, 1, flight_dialect(), name="alpha", decoder=Decoder(flight_dialect()))
        self.vehicle.origin = ORIGIN
        self.commands = FakeCommander()
        self.commands.on_timesync = self.pong
        self.orders: list[Plan] = []
        self.events: list[Event] = []
        self.enters = True
        self.unheard = False
        self.hover_thrust: float | None = None
        self.mode = PX4_LOITER
        self.position_enu_m = (0.0, 0.0, 10.0)
        self.telling = True
        self.links = KnownLinks()
        commands: Any = self.commands  # all that is used of one
        shared = services(flight_dialect(), None, self.loop, self.events.append, links=self.links, log_dir=log_dir)
        self.locks = shared.locks
        precedence = SimpleNamespace(
            asked=lambda: None,
            late=self.never_late,
            hands=lambda: None,
            pilot_since=lambda order, before: None,  # tests/integration/test_control_handed_over.py
            taken_by_pilot=lambda asked: None,  # tests/integration/test_orders_as_they_come.py
        )
        runner: Any = SimpleNamespace(attempt_in_control=self.attempt, precedence=precedence)
        self.runner = runner
        self.offboard = OffboardEngagement(
            self.vehicle,
            VehicleConfig(
                name="alpha", sysid=1, control=ControlSettings(**settings), streams={"GLOBAL_POSITION_INT": 2.0}
            ),
            commands,
            runner,
            StreamRequester(self.vehicle, commands, flight_dialect(), {}),
            shared,
        )
        self.beat()
        self.vehicle.on_frame(self.voice.landed(2), self.loop.time())
        self._task = self.loop.create_task(self._tell())

    async def _tell(self) -> None:
        while True:
            if self.telling:
                here = place(*self.position_enu_m)
                frame = self.voice.position(here.lat_deg, here.lon_deg, here.alt_amsl_m, 10.0)
                self.vehicle.on_frame(frame, self.loop.time())
                self.beat()
                self.vehicle.on_frame(self.voice.landed(2), self.loop.time())
            await asyncio.sleep(0.02)

    async def close(self) -> None:
        self.offboard.close("the test ends")
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    def beat(self) -> None:
        self.vehicle.on_frame(self.voice.beat(PX4, self.mode, armed=True, status=4), self.loop.time())

    def pong(self, ts1: int) -> None:
        frame = self.voice.say(mav.MAVLink_timesync_message(123456789, ts1))
        self.offboard.on_timesync(frame, self.loop.time())

    async def never_late(self, order: str) -> str | None:
        return None

    async def attempt(self, planner: Callable[[float], Plan]) -> Outcome:
        try:
            return await self.execute(planner(self.loop.time()))
        except RefusedError as error:
            return Outcome(False, "refused", str(error))

    async def execute(self, plan: Plan) -> Outcome:
        self.orders.append(plan)
        await asyncio.sleep(0.05)
        if self.unheard:
            return Outcome(False, "timeout", "timeout")
        if plan.order == "control":
            if not self.enters:
                return Outcome(False, "denied", "denied: no")
            self.mode = OFFBOARD
            self.beat()
        if plan.order == "parameters" and self.hover_thrust is not None:
            told = mav.MAVLink_param_value_message(b"MPC_THR_HOVER", self.hover_thrust, 9, 1, 0)
            self.vehicle.on_frame(self.voice.say(told), self.loop.time())
        return Outcome(True, "accepted", plan.done)

    def ways(self, since: float = 0.0) -> list[ControlMode]:
        return [SETPOINTS[name] for at, name, *_ in self.commands.sent if name in SETPOINTS and at >= since]

    def texts(self) -> str:
        return " | ".join(event.text for event in self.events)


@asynccontextmanager
async def field(log_dir: Path, **settings: Any) -> AsyncIterator[Field]:
    made = Field(log_dir, **settings)
    await asyncio.sleep(0.1)
    try:
        yield made
    finally:
        await made.close()


@pytest.fixture
async def f(tmp_path: Path) -> AsyncIterator[Field]:
    async with field(tmp_path) as made:
        yield made


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
async def test_it_streams_before_the_mode_and_flies_after_it(f: Field, control_mode: ControlMode) -> None:
    began = f.loop.time()
    outcome = await f.offboard.engage(control_mode)
    assert outcome.ok and outcome.message == f"flown by {control_mode.value} setpoints", outcome
    assert [plan.order for plan in f.orders][-1] == "control"
    streamed = f.commands.sent[0][0] - began
    assert f.offboard.flying and outcome.elapsed_s > 1.0 + streamed
    since = f.loop.time()
    await asyncio.sleep(2.0)
    sent = f.ways(since)
    assert set(sent) == {control_mode}
    assert len(sent) == pytest.approx({"attitude": 100, "velocity": 20, "position": 10}[control_mode], abs=2)
    setpoints = [s for s in f.commands.sent if s[1] in SETPOINTS]
    assert {(s[3], s[4]) for s in setpoints} == {(Priority.SETPOINT, ("setpoint", 1, 1))}


async def test_position_is_asked_for_faster_and_given_back(f: Field) -> None:
    await f.offboard.engage(ControlMode.VELOCITY)
    f.offboard.release("land was ordered")
    await asyncio.sleep(0.2)
    rates = [1e6 / plan.steps[0].command.params[1] for plan in f.orders if plan.order == "interval"]  # type: ignore[union-attr,operator]  # both are given
    assert rates == pytest.approx([10.0, 2.0])
    assert "control ended: land was ordered" in f.texts()


async def test_tilt_and_throttle_are_asked_for_by_attitude_and_given_back(f: Field) -> None:
    assert (await f.offboard.engage(ControlMode.VELOCITY)).ok
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    await asyncio.sleep(0.5)
    f.offboard.release("land was ordered")
    await asyncio.sleep(0.5)
    asked = [plan.steps[0].command.params for plan in f.orders if plan.order == "interval"]  # type: ignore[union-attr]
    intervals = {msgid: [params[1] for params in asked if params[0] == msgid] for msgid in (30.0, 74.0)}
    assert intervals[30.0][0] == 1e5 and intervals[74.0][0] == 2e5
    assert [len(times) for times in intervals.values()] == [2, 2], "once, and given back once"


async def test_rates_that_were_given_back_unheard_are_when_the_vehicle_is_heard_again(f: Field) -> None:
    """They stayed raised, up to 50 positions a second, for as long as the vehicle was on the air."""
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    heard, f.unheard = f.unheard, True
    f.offboard.release("the link was cut")
    await asyncio.sleep(0.5)
    f.unheard, asked = heard, len(f.orders)
    f.offboard.rate_set("ATTITUDE")  # by a person: it stays
    for _ in range(2):
        f.offboard.heard_again()
        await asyncio.sleep(0.5)
    given_back = [plan.steps[0].command.params for plan in f.orders[asked:]]  # type: ignore[union-attr]
    assert given_back == [(33.0, 5e5), (74.0, 0.0)], "once each"


async def test_a_vehicle_that_does_not_take_the_mode_is_sent_nothing_more(f: Field) -> None:
    f.enters = False
    outcome = await f.offboard.engage(ControlMode.POSITION)
    assert not outcome.ok and "not switched over: denied: no" in outcome.message
    assert f.offboard.controller.state is OffboardState.OFF and not f.offboard.clock.running
    since = f.loop.time()
    await asyncio.sleep(5)
    assert f.ways(since) == []


async def test_without_an_origin_or_outside_the_fence_nothing_begins(f: Field) -> None:
    f.position_enu_m = (60.0, 0.0, 10.0)
    await asyncio.sleep(0.1)
    assert "at x 60.0 m" in (await f.offboard.engage(ControlMode.POSITION)).message
    f.vehicle.origin = None
    assert "no origin" in (await f.offboard.engage(ControlMode.POSITION)).message
    assert f.commands.sent == [] and f.orders == []


async def test_without_pongs_attitude_is_not_flown(f: Field) -> None:
    f.commands.rtt_s = None
    outcome = await f.offboard.engage(ControlMode.ATTITUDE)
    assert outcome.ok and "flown by velocity setpoints and not by attitude: the round trip" in outcome.message
    assert ControlMode.ATTITUDE not in f.ways()


async def test_the_links_budget_sets_the_pace(f: Field) -> None:
    f.links.bytes_per_s = 1440.0
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    since = f.loop.time()
    await asyncio.sleep(5)
    assert len(f.ways(since)) == pytest.approx(5 * 25.5, abs=2), "1440 B/s, and 140 of them for pings"
    assert set(f.ways(since)) == {ControlMode.ATTITUDE}
    f.links.bytes_per_s = 720.0
    f.offboard.refresh_budget()
    await asyncio.sleep(0.2)
    since = f.loop.time()
    await asyncio.sleep(1)
    assert set(f.ways(since)) == {ControlMode.VELOCITY} and "14.1" in f.texts()


@pytest.mark.parametrize(("bytes_per_s", "pings_per_s", "setpoints_per_s"), [(1200.0, 5, 20.8), (1100.0, 1, 21.6)])
async def test_fast_pings_come_out_of_the_setpoints_share_where_enough_is_left(
    f: Field, bytes_per_s: float, pings_per_s: float, setpoints_per_s: float
) -> None:
    f.links.bytes_per_s = bytes_per_s
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    await asyncio.sleep(1)
    since = f.loop.time()
    await asyncio.sleep(5)
    pings = [at for at, name, *_ in f.commands.sent if name == "TIMESYNC" and at >= since]
    assert len(pings) == pytest.approx(5 * pings_per_s, abs=2)
    assert len(f.ways(since)) == pytest.approx(5 * setpoints_per_s, abs=2)


async def test_attitude_is_flown_with_no_more_delay_than_the_gains_bear_on_this_vehicle(f: Field) -> None:
    f.hover_thrust = 0.3
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    limit_s = f.offboard.controller.config.guard.attitude_delay_s
    assert limit_s == bearable_delay_s(f.offboard.controller.config.law) and limit_s < 0.07
    assert f"attitude is flown with up to {limit_s:g} s of delay instead of 0.1 s" in f.texts()
    f.commands.rtt_s = 0.09
    await asyncio.sleep(5)
    assert f.offboard.controller.control_mode is ControlMode.VELOCITY and "(limit for attitude 0.06" in f.texts()
    slower = {"vel_p": 0.1, "pos_p_per_s": 0.5, "vel_i": 0.005}
    assert (await f.offboard.change_gains({"z": slower})).ok
    assert f.offboard.controller.config.guard.attitude_delay_s == 0.1, "these bear it, and more is not allowed"


async def test_gains_that_bear_no_link_on_this_vehicle_are_refused_at_entry_unless_forced(f: Field) -> None:
    f.hover_thrust = 0.15
    outcome = await f.offboard.engage(ControlMode.ATTITUDE)
    assert outcome.result == "refused" and "z: these gains are unstable from 0.0" in outcome.message
    assert "force" in outcome.message and f.offboard.controller.state is OffboardState.OFF
    assert (await f.offboard.engage(ControlMode.POSITION)).ok
    outcome = await f.offboard.engage(ControlMode.ATTITUDE)
    assert outcome.result == "refused" and f.offboard.controller.wanted is ControlMode.POSITION
    assert (await f.offboard.engage(ControlMode.ATTITUDE, force=True)).ok
    assert f.offboard.controller.config.guard.attitude_delay_s == 0.1


async def test_the_vehicles_hover_thrust_counts_for_attitude_after_position(f: Field) -> None:
    assert (await f.offboard.engage(ControlMode.POSITION)).ok
    assert f.offboard.gains()["hover_thrust"] == 0.45, "it was not asked"
    f.hover_thrust = 0.3
    assert (await f.offboard.engage(ControlMode.ATTITUDE)).ok
    assert f.offboard.gains()["hover_thrust"] == pytest.approx(0.3)
    assert f.offboard.controller.config.guard.attitude_delay_s < 0.07
    assert (await f.offboard.engage(ControlMode.RAW)).ok
    assert f.offboard.controller.config.guard.attitude_delay_s == 0.1, "its controller is not this law"


async def test_a_hover_thrust_that_cannot_be_flown_is_refused(f: Field) -> None:
    f.hover_thrust = 0.95
    outcome = await f.offboard.engage(ControlMode.ATTITUDE)
    assert outcome.result == "refused" and "hover thrust is 0.95" in outcome.message
    assert f.offboard.controller.state is OffboardState.OFF


async def test_a_newer_order_during_the_entry_takes_its_place(f: Field) -> None:
    entering = asyncio.create_task(f.offboard.engage(ControlMode.VELOCITY))
    await asyncio.sleep(0.8)
    assert f.offboard.controller.state is OffboardState.ENGAGING
    f.offboard.release("land was ordered")
    outcome = await entering
    assert not outcome.ok and "control" not in [plan.order for plan in f.orders]
    since = f.loop.time()
    await asyncio.sleep(2)
    assert f.ways(since) == []


async def test_a_vehicle_somebody_takes_away_is_given_no_order(f: Field) -> None:
    await f.offboard.engage(ControlMode.VELOCITY)
    await asyncio.sleep(0)  # what it does when this station dies is read beside
    f.mode = PX4_RTL
    orders = len(f.orders)
    await asyncio.sleep(1)
    assert f.offboard.controller.state is OffboardState.OFF and not f.offboard.clock.running
    assert [plan.order for plan in f.orders[orders:]] == ["interval"]  # the picture's rate again, and nothing else
    assert "took over" in f.texts()
    last = max(at for at, name, *_ in f.commands.sent if name in SETPOINTS)
    assert last <= f.runner.sent_before_at <= last + 0.15, "a goto waits until the last setpoint has arrived"


async def test_a_vehicle_that_goes_silent_is_held_once(f: Field) -> None:
    await f.offboard.engage(ControlMode.VELOCITY)
    f.telling = False
    await asyncio.sleep(4)
    assert f.offboard.controller.state is OffboardState.HELD
    assert [plan.order for plan in f.orders].count("hold") == 1
    refused = await f.offboard.fly_to(place(1, 1, 10), None)
    assert refused.result == "refused" and "it is held: state is" in refused.message


async def test_a_fault_of_ours_ends_control_and_holds(f: Field) -> None:
    await f.offboard.engage(ControlMode.VELOCITY)
    f.commands.fails = ValueError("a bug")
    await asyncio.sleep(0.5)
    assert f.offboard.controller.state is OffboardState.OFF and not f.offboard.clock.running
    assert [plan.order for plan in f.orders].count("hold") == 1
    assert [e.kind for e in f.events].count("fault") == 1 and "ValueError('a bug')" in f.texts()


async def test_places_and_setpoints_are_taken_only_while_it_flies_and_within_the_fence(f: Field) -> None:
    stream = Setpoint(place(1, 2, 10))
    for refused in ((await f.offboard.fly_to(place(1, 1, 10), None)), f.offboard.follow(stream, 0.5)):
        assert not refused.ok and "control set alpha position" in refused.message
    await f.offboard.engage(ControlMode.VELOCITY)
    assert (await f.offboard.fly_to(place(10, -10, 12), 0.0)).ok
    assert "the fence less 2 m" in (await f.offboard.fly_to(place(49, 0, 12), None)).message
    assert f.offboard.follow(stream, 0.5).ok
    assert "valid_s 60" in f.offboard.follow(stream, 60.0).message
    assert "x 80.0" in f.offboard.follow(Setpoint(place(80, 0, 10)), 0.5).message
    climb = Setpoint(place(5, 0, 0), (0.0, 0.0, 0.5), free_z=True)
    assert f.offboard.follow(climb, 0.5).ok  # a height it does not have is not held against it
    assert "up 40.0" in f.offboard.follow(Setpoint(place(0, 0, 40), free_xy=True), 0.5).message


async def test_it_holds_the_lock_of_what_it_was_entered_with_until_it_ends(f: Field) -> None:
    other = OriginChange(replace(ORIGIN, x_heading_deg=270.0))
    assert f.locks.refusal(other) is None
    await f.offboard.engage(ControlMode.VELOCITY)
    assert f.locks.refusal(other) is not None and f.locks.refusal(OriginChange(ORIGIN)) is None
    f.vehicle.origin = other.origin  # whatever the fleet's is by now: its fence and its trajectories do not turn
    lock = f.offboard.lock
    assert lock is not None and lock.origin == ORIGIN and lock.members[0].fence.origin == ORIGIN
    straight = LoadedTrajectory(hover((3.0, 0.0, 10.0), 2.0))
    assert "it is 3.0 m from the first point" in str(f.offboard.trajectory_refusal(straight, 1.0, lock))
    clock = common_clock([straight], 1.0, 1.0)
    clock.start(f.loop.time(), f.loop.time())
    flight = f.offboard.follow_trajectory(straight, clock, lock)
    assert flight.reference(f.loop.time(), 0.0).pos_enu_m == pytest.approx((3.0, 0.0, 0.0), abs=0.01)
    f.offboard.release("the test")
    assert f.locks.refusal(other) is None and f.locks.held() == []


async def test_a_trace_is_a_file_per_flight_with_a_row_per_tick(tmp_path: Path) -> None:
    async with field(tmp_path / "logs") as f:
        assert await f.offboard.record(True) is None  # nothing to trace yet
        await f.offboard.engage(ControlMode.ATTITUDE)
        path = f.offboard.recording
        assert path is not None and f.offboard.status(f.loop.time())["recording"] == str(path)
        await asyncio.sleep(1.0)
        ticks = f.offboard.clock.ticks
        f.offboard.release("land was ordered")
        assert f.offboard.recording is None
        with path.open(encoding="ascii", newline="") as lines:
            rows = [entry.row for entry in decode(lines)]
        assert len(rows) == ticks and {row.control_mode for row in rows} >= {"attitude"}
        assert [row.following for row in rows].index(True) > 10


async def test_a_full_disk_ends_the_trace_and_not_the_flight(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("no folder")
    async with field(tmp_path / "logs") as f:
        await f.offboard.record(True)
        assert (await f.offboard.engage(ControlMode.VELOCITY)).ok
        await asyncio.sleep(1)
        assert f.offboard.flying and f.offboard.recording is None and "trace has ended" in f.texts()
        assert f.texts().count("trace has ended") == 1


async def test_somebody_elses_timesync_is_no_pong(f: Field) -> None:
    request = f.voice.say(mav.MAVLink_timesync_message(0, 5))
    f.offboard.on_timesync(request, f.loop.time())
    assert f.offboard.controller.delay.strange == 0
    f.offboard.on_timesync(f.voice.say(mav.MAVLink_timesync_message(7, 5)), f.loop.time())
    assert f.offboard.controller.delay.strange == 1 and f.offboard.controller.delay.rtt_p95_s is None
