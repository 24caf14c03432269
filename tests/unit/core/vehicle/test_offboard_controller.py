"""Every row of the pilot's table, and that no sequence of frames, orders and times makes it send what it must not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.control.cascade import Memory
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.gains import AxisGains, ControlConfig
from skygcs.core.control.guard import CONTROL_MODES, ControlMode, GuardConfig
from skygcs.core.geo import Origin
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.estimate_view import JUDGE_S
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_controller import OLD_S, OffboardConfig, OffboardController, OffboardState
from skygcs.core.vehicle.reference_source import LAST_ATTITUDE_S
from skygcs.core.vehicle.setpoint_generator import Tick
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from support.examples import examples
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, PX4_LOITER, PX4_RTL, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
OFFBOARD = 6 << 16
COPTER_GUIDED = 4
FENCE = Fence(Origin(*HOME))
START = 100.0

MESSAGES = {
    ControlMode.ATTITUDE: "SET_ATTITUDE_TARGET",
    ControlMode.VELOCITY: "SET_POSITION_TARGET_LOCAL_NED",
    ControlMode.POSITION: "SET_POSITION_TARGET_GLOBAL_INT",
}


def place(east_m: float, north_m: float, up_m: float) -> GeodeticPosition:
    """A point about HOME, worked out by pymap3d."""
    return GeodeticPosition(*(float(v) for v in pymap3d.enu2geodetic(east_m, north_m, up_m, *HOME)))


class Flight:
    """A vehicle that says what a test lets it say, its pilot, and a clock."""

    def __init__(self, autopilot: int = PX4, config: OffboardConfig | None = None, *, up_m: float = 10.0) -> None:
        self.now = START
        self.autopilot = autopilot
        self.vehicle = Vehicle(1, 1, flight_dialect(), name="alpha", decoder=DECODER)
        self.voice = Voice(1)
        self.pilot = OffboardController(self.vehicle, config or OffboardConfig(ControlConfig(), GuardConfig()))
        self.beat()
        self.landed(2)
        self.at(0.0, 0.0, up_m)
        if autopilot == ARDUPILOT:
            self.guid_options(8)

    @property
    def obeying(self) -> int:
        return OFFBOARD if self.autopilot == PX4 else COPTER_GUIDED

    def beat(self, mode: int | None = None, *, armed: bool = True) -> None:
        here = (PX4_LOITER if self.autopilot == PX4 else 5) if mode is None else mode
        self.vehicle.on_frame(self.voice.beat(self.autopilot, here, armed=armed, status=4), self.now)

    def landed(self, state: int) -> None:
        self.vehicle.on_frame(self.voice.landed(state), self.now)

    def guid_options(self, bits: int) -> None:
        told = mav.MAVLink_param_value_message(b"GUID_OPTIONS", bits, 6, 1, 0)
        self.vehicle.on_frame(self.voice.say(told), self.now)

    def at(self, east_m: float, north_m: float, up_m: float, heading_cdeg: int = 0) -> None:
        here = place(east_m, north_m, up_m)
        frame = self.voice.position(here.lat_deg, here.lon_deg, here.alt_amsl_m, up_m, heading=heading_cdeg)
        self.vehicle.on_frame(frame, self.now)

    def pinged(self, rtt_s: float = 0.004) -> None:
        """Answers to a burst of pings."""
        for _ in range(5):
            self.pilot.delay.on_pong(self.pilot.delay.ping(self.now - rtt_s), self.now)

    def tick(self, dt_s: float = 0.02, *, fresh: bool = True) -> Tick:
        """The next tick; ``fresh``: after the same position again."""
        self.now += dt_s
        if fresh and (slot := self.vehicle.slot("GLOBAL_POSITION_INT")) is not None and slot.frame is not None:
            self.vehicle.on_frame(slot.frame, self.now)
        return self.pilot.tick(self.now)

    def fly(self, control_mode: ControlMode = ControlMode.ATTITUDE, fence: Fence | None = FENCE) -> Flight:
        """Up to the state "flying" by this way."""
        self.pilot.engage(control_mode, fence)
        self.tick()
        self.pinged()
        self.tick(0.15)
        self.beat(self.obeying)
        self.pilot.entered()
        self.tick()
        assert (self.pilot.state, self.pilot.control_mode) == (OffboardState.FLYING, control_mode)
        return self

    def reference_enu_m(self) -> tuple[float, ...]:
        assert self.pilot.reference is not None
        return self.pilot.reference.pos_enu_m


def texts(tick: Tick) -> str:
    return " | ".join(event.text for event in tick.events)


# --- the table, row by row


def test_off_sends_nothing_and_has_nothing_to_release() -> None:
    flight = Flight()
    assert flight.pilot.state is OffboardState.OFF and not flight.pilot.active
    assert flight.tick() == Tick() and flight.pilot.release("why not") == Tick()
    assert flight.pilot.status(flight.now)["mode"] is None


def test_without_a_position_it_is_not_taken_over() -> None:
    flight = Flight()
    flight.vehicle.on_frame(flight.voice.position(0.0, 0.0), flight.now)  # what autopilots send before they know
    with pytest.raises(RefusedError, match="position is not known"):
        flight.pilot.engage(ControlMode.POSITION, FENCE)
    assert flight.pilot.state is OffboardState.OFF


@each("control_mode", CONTROL_MODES)
def test_engaging_streams_stay_where_you_are_wherever_that_is(control_mode: ControlMode) -> None:
    flight = Flight()
    flight.pilot.engage(control_mode, FENCE)
    flight.tick()
    flight.pinged()
    flight.at(3.0, -2.0, 11.0)
    tick = [flight.tick(0.02) for _ in range(10)][-1]
    assert tick.message is not None and tick.message[0] == MESSAGES[control_mode]
    values = tick.message[1]
    if control_mode is ControlMode.VELOCITY:
        assert [values[k] for k in ("vx", "vy", "vz")] == pytest.approx([0.0, 0.0, 0.0])
    elif control_mode is ControlMode.POSITION:
        there = place(3.0, -2.0, 11.0)
        assert (values["lat_int"], values["lon_int"]) == (round(there.lat_deg * 1e7), round(there.lon_deg * 1e7))
        assert values["alt"] == pytest.approx(there.alt_amsl_m, abs=2e-3)
    else:
        assert values["thrust"] == pytest.approx(ControlConfig().hover_thrust)
    assert flight.pilot.state is OffboardState.ENGAGING and not tick.events and not tick.hold


def test_while_engaging_nothing_is_integrated() -> None:
    flight = Flight()
    flight.pilot.engage(ControlMode.ATTITUDE, FENCE)
    flight.tick()
    flight.pinged()
    for _ in range(20):
        flight.vehicle.on_frame(flight.voice.position(*HOME[:2], HOME[2] + 10, 10, velocity=(100, 0, 0)), flight.now)
        flight.tick(fresh=False)
    assert flight.pilot.control_mode is ControlMode.ATTITUDE
    assert flight.pilot.memory.integral_enu == (0.0, 0.0, 0.0)


def test_entered_flies_and_from_then_on_the_reference_stays() -> None:
    flight = Flight().fly(ControlMode.POSITION)
    flight.at(4.0, 0.0, 10.0)
    flight.tick()
    assert flight.reference_enu_m() == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_entered_means_something_only_while_engaging() -> None:
    flight = Flight()
    flight.pilot.entered()
    assert flight.pilot.state is OffboardState.OFF
    flight.fly(ControlMode.POSITION)
    memory = flight.pilot.memory
    flight.pilot.entered()
    assert flight.pilot.memory is memory


@each("engaging", [True, False])
def test_release_ends_it_at_once_and_says_why_once(engaging: bool) -> None:
    flight = Flight()
    if engaging:
        flight.pilot.engage(ControlMode.VELOCITY, FENCE)
    else:
        flight.fly(ControlMode.VELOCITY)
    ended = flight.pilot.release("land was ordered")
    assert texts(ended) == "control ended: land was ordered" and not ended.hold and ended.message is None
    assert ended.events[0].data == {"state": "off", "control_mode": None, "reasons": ["land was ordered"]}
    assert flight.pilot.state is OffboardState.OFF and flight.tick() == Tick()
    assert flight.pilot.release("again") == Tick()


RELEASES: dict[str, tuple[Callable[[Flight], object], str]] = {
    "disarmed": (lambda f: (f.landed(0), f.at(0.0, 0.0, 0.0), f.beat(f.obeying, armed=False)), "not armed"),
    "mode": (lambda f: f.beat(PX4_RTL), "took over"),
    "landed": (lambda f: f.landed(1), "on the ground"),
    "lost": (lambda f: f.vehicle.tick(f.now + 60), "no heartbeat"),
}


@each("what", RELEASES)
def test_what_is_not_ours_any_more_is_released_and_given_no_order(what: str) -> None:
    flight = Flight().fly(ControlMode.ATTITUDE)
    happen, why = RELEASES[what]
    happen(flight)
    tick = flight.tick()
    assert tick.message is None and not tick.hold and why in texts(tick)
    assert flight.pilot.state is OffboardState.OFF and flight.tick() == Tick()
    assert flight.pilot.guard_falls == {"release": 1}


HOLDS: dict[str, tuple[Callable[[Flight], object], str]] = {
    "fence": (lambda f: f.at(60.0, 0.0, 10.0), "the vehicle is at x 60.0 m"),
    "no fix": (
        lambda f: (
            f.vehicle.on_frame(
                f.voice.say(mav.MAVLink_gps_raw_int_message(0, 1, 0, 0, 0, 65535, 65535, 0, 0, 4)), f.now
            )
            and None
        ),
        "fix",
    ),
    "nan": (
        lambda f: (
            f.vehicle.on_frame(f.voice.say(mav.MAVLink_attitude_message(0, math.nan, 0, 0, 0, 0, 0)), f.now) and None
        ),
        "NaN",
    ),
    "battery": (
        lambda f: (
            f.vehicle.on_frame(
                f.voice.say(mav.MAVLink_sys_status_message(0, 0, 0, 0, 14000, 100, 5, 0, 0, 0, 0, 0, 0)), f.now
            )
            and None
        ),
        "battery",
    ),
    "refusing": (lambda f: setattr(f.pilot, "refusing", "it said no"), "it said no"),
    "disarmed in the air": (lambda f: f.beat(f.obeying, armed=False), "it reports itself in the air"),
    "two senders": (lambda f: f.vehicle.on_frame(f.voice.beat(0 if f.vehicle.autopilot else 3, kind=2), f.now), "two"),
}


@each("what", HOLDS)
def test_what_is_unsafe_is_held_once_and_then_left_alone(what: str) -> None:
    flight = Flight().fly(ControlMode.ATTITUDE)
    happen, why = HOLDS[what]
    happen(flight)
    tick = flight.tick(2 * JUDGE_S)
    assert tick.hold and tick.message is None and why in texts(tick), texts(tick)
    assert flight.pilot.state is OffboardState.HELD and not flight.pilot.active
    assert why in " ".join(flight.pilot.reasons)
    assert flight.tick() == Tick()  # the order is given once
    assert flight.pilot.guard_falls == {"hold": 1}


@each("what", HOLDS)
def test_what_would_be_a_hold_only_ends_an_attempt_to_take_it_over(what: str) -> None:
    flight = Flight()
    flight.pilot.engage(ControlMode.POSITION, FENCE)
    flight.tick()
    HOLDS[what][0](flight)
    tick = flight.tick(2 * JUDGE_S)
    assert not tick.hold and tick.message is None and flight.pilot.state is OffboardState.OFF


def test_a_silent_vehicle_is_held() -> None:
    flight = Flight().fly(ControlMode.POSITION)
    assert flight.tick(1.9, fresh=False).message is not None
    tick = flight.tick(0.2, fresh=False)
    assert tick.hold and "old" in texts(tick)


def test_what_is_held_may_be_engaged_again_or_released() -> None:
    flight = Flight().fly(ControlMode.VELOCITY)
    flight.pilot.refusing = "no"
    flight.tick()
    flight.pilot.refusing = None
    assert flight.pilot.state is OffboardState.HELD
    assert texts(flight.pilot.release("switched off")) == "control ended: switched off"
    flight.fly(ControlMode.VELOCITY)
    assert flight.pilot.reasons == ()


# --- ways


@each("autopilot", [PX4, ARDUPILOT])
@each("control_mode", CONTROL_MODES)
def test_the_message_is_that_of_the_way_and_the_pace_too(control_mode: ControlMode, autopilot: int) -> None:
    flight = Flight(autopilot).fly(control_mode)
    tick = flight.tick()
    assert tick.message is not None and tick.message[0] == MESSAGES[control_mode]
    assert flight.pilot.period_s == pytest.approx({"attitude": 0.02, "velocity": 0.1, "position": 0.2}[control_mode])


@pytest.fixture
def flight() -> Flight:
    return Flight().fly(ControlMode.ATTITUDE)


def test_a_worse_way_is_taken_at_once_told_once_and_its_reason_shown(flight: Flight) -> None:
    told = flight.tick(0.51, fresh=False)
    assert told.message is not None and told.message[0] == MESSAGES[ControlMode.ATTITUDE] and flight.pilot.handing_over
    assert "flown by position setpoints" in texts(told) and "0.5" in texts(told)
    assert told.events[0].data["control_mode"] == "position"
    tick = flight.tick(LAST_ATTITUDE_S)
    assert tick.message is not None and tick.message[0] == MESSAGES[ControlMode.POSITION] and not tick.events
    assert flight.pilot.status(flight.now)["reasons"]


def test_that_a_better_way_is_possible_again_is_shown_though_not_told() -> None:
    flight = Flight().fly(ControlMode.VELOCITY)
    flight.tick(0.51, fresh=False)
    assert flight.pilot.control_mode is ControlMode.POSITION
    for _ in range(30):
        assert not flight.tick(0.2).events
    assert any("order velocity again" in reason for reason in flight.pilot.reasons), flight.pilot.reasons


def test_the_wanted_way_is_tried_again_when_it_is_ordered_again() -> None:
    flight = Flight().fly(ControlMode.VELOCITY)
    flight.tick(0.6, fresh=False)
    for _ in range(20):
        flight.tick(0.2)
    assert flight.pilot.control_mode is ControlMode.POSITION
    assert flight.pilot.guard_falls == {"position": 1}
    flight.pilot.want(ControlMode.VELOCITY)
    assert flight.pilot.reasons == ()
    tick = flight.tick()
    assert tick.message is not None and tick.message[0] == MESSAGES[ControlMode.VELOCITY]
    assert flight.pilot.guard_falls == {"position": 1}, "a rise is no fall"


def test_the_memory_is_forgotten_on_a_change_of_way_and_only_then(flight: Flight) -> None:
    flight.pilot.fly_to(place(1.0, 1.0, 10.5), None)
    for _ in range(20):
        flight.tick()
    kept = flight.pilot.memory
    assert kept.integral_enu[0] > 0 and kept.vel_error_enu_mps is not None
    flight.pilot.change_law(replace(flight.pilot.config.law, xy=AxisGains(0.5, 0.05, 0.01)))
    assert flight.pilot.memory is kept  # what was integrated is thrust, whatever the gains
    flight.pilot.want(ControlMode.VELOCITY)
    flight.tick()
    flight.tick(LAST_ATTITUDE_S)
    memory = flight.pilot.memory
    assert memory.vel_setpoint_enu_mps is not None  # of the velocity just sent
    assert replace(memory, vel_setpoint_enu_mps=None) == Memory()
    flight.pilot.want(ControlMode.ATTITUDE)
    flight.tick()
    assert flight.pilot.memory.integral_enu != kept.integral_enu
    assert abs(flight.pilot.memory.integral_enu[0]) < kept.integral_enu[0] / 5


def test_the_link_bounds_the_pace_of_attitude_but_never_below_what_can_be_flown() -> None:
    flight = Flight()
    for allowed, period_s in ((math.inf, 1 / 50), (28.0, 1 / 28), (5.0, 1 / 20)):
        flight.pilot.attitude_hz_allowed = allowed
        flight.pilot.wanted = ControlMode.ATTITUDE
        assert flight.pilot.period_s == pytest.approx(period_s)


def test_with_fewer_setpoints_than_attitude_takes_it_flies_by_velocity(flight: Flight) -> None:
    flight.pilot.attitude_hz_allowed = 14.1
    assert "14" in texts(flight.tick())
    tick = flight.tick(LAST_ATTITUDE_S)
    assert tick.message is not None and tick.message[0] == MESSAGES[ControlMode.VELOCITY]


# --- time


def test_the_step_is_measured_and_not_assumed(flight: Flight) -> None:
    flight.pilot.tracing = True
    for dt_s in (0.02, 0.013, 0.031):
        row = flight.tick(dt_s).row
        assert row is not None and row.dt_s == pytest.approx(dt_s)
    flight.now -= 1.0  # a clock that goes back makes no negative step
    row = flight.tick(0.0).row
    assert row is not None and row.dt_s == 0.0


def test_the_first_step_after_a_pause_is_no_step_of_that_pause(flight: Flight) -> None:
    flight.pilot.release("land was ordered")
    flight.now += 500.0
    flight.beat()
    flight.landed(2)
    flight.at(0.0, 0.0, 10.0)
    flight.pilot.tracing = True
    flight.pilot.engage(ControlMode.POSITION, FENCE)
    row = flight.tick().row
    assert row is not None and row.dt_s == ControlConfig().period_s


# --- references


@given(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-20, 100), st.floats(-10, 10) | st.none())
def test_a_place_is_flown_to_exactly_and_a_yaw_kept_unless_given(
    east_m: float, north_m: float, up_m: float, yaw_rad: float | None
) -> None:
    flight = Flight().fly(ControlMode.POSITION)
    assert flight.pilot.reference is not None
    before = flight.pilot.reference.yaw_rad
    there = place(east_m, north_m, up_m)
    flight.pilot.fly_to(there, yaw_rad)
    anchor = flight.pilot.frame
    assert anchor is not None
    o = anchor.origin
    wanted = pymap3d.geodetic2enu(there.lat_deg, there.lon_deg, there.alt_amsl_m, o.lat_deg, o.lon_deg, o.alt_amsl_m)
    assert flight.reference_enu_m() == pytest.approx([float(v) for v in wanted], abs=1e-4)
    assert flight.pilot.reference.yaw_rad == (before if yaw_rad is None else yaw_rad)


def test_what_is_sent_for_a_place_is_that_place() -> None:
    flight = Flight(ARDUPILOT).fly(ControlMode.POSITION)
    there = place(12.0, -7.0, 15.0)
    flight.pilot.fly_to(there, math.pi / 2)
    tick = flight.tick()
    assert tick.message is not None
    values = tick.message[1]
    assert abs(values["lat_int"] - there.lat_deg * 1e7) < 1 and abs(values["lon_int"] - there.lon_deg * 1e7) < 1
    assert values["alt"] == pytest.approx(there.alt_amsl_m, abs=1e-3)
    assert values["yaw"] == pytest.approx(0.0)  # true ENU north is compass 0


def test_the_heading_at_the_beginning_is_kept() -> None:
    flight = Flight()
    flight.at(0.0, 0.0, 10.0, heading_cdeg=9000)
    flight.fly(ControlMode.POSITION)
    assert flight.pilot.reference is not None
    assert flight.pilot.reference.yaw_rad == pytest.approx(0.0, abs=1e-6)


def test_a_stream_leads_it_until_its_deadline_and_then_it_stays_where_it_is() -> None:
    flight = Flight().fly(ControlMode.VELOCITY)
    flight.pilot.follow(
        Setpoint(place(20.0, 0.0, 10.0), (1.0, 2.0, 0.0), yaw_enu_rad=0.3), flight.now, flight.now + 0.5
    )
    assert flight.pilot.streaming
    tick = flight.tick(0.4)
    assert tick.message is not None and not tick.events
    law = flight.pilot.config.law
    # north, the reference is as far ahead as its own velocity brought it in 0.4 s
    assert tick.message[1]["vx"] == pytest.approx(min(2.0 + 0.95 * 0.8, law.vel_xy_max_mps), abs=0.02)
    assert tick.message[1]["vy"] == pytest.approx(min(1.0 + 0.95 * 20, law.vel_xy_max_mps), abs=0.02)
    flight.at(6.0, 0.0, 10.0)
    ended = flight.tick(0.2)
    assert "setpoints ended" in texts(ended) and not flight.pilot.streaming
    assert flight.reference_enu_m() == pytest.approx((6.0, 0.0, 0.0), abs=0.02)
    assert flight.pilot.reference is not None and flight.pilot.reference.yaw_rad == 0.3
    assert ended.message is not None and ended.message[1]["vy"] == pytest.approx(0.0, abs=0.02)


@each("control_mode", [ControlMode.VELOCITY, ControlMode.POSITION])
def test_axes_without_a_position_are_flown_by_velocity_also_where_the_way_is_position(
    control_mode: ControlMode,
) -> None:
    flight = Flight().fly(control_mode)
    flight.pilot.follow(Setpoint(None, (1.0, 0.0, -0.5), free_xy=True, free_z=True), flight.now, flight.now + 1)
    tick = flight.tick()
    assert tick.message is not None and tick.message[0] == MESSAGES[ControlMode.VELOCITY]
    assert (tick.message[1]["vy"], tick.message[1]["vz"]) == pytest.approx((1.0, 0.5))


def test_what_a_place_says_of_a_free_axis_does_not_matter() -> None:
    high = Fence(Origin(*HOME), up_m=(5.0, 20.0))
    flight = Flight().fly(ControlMode.VELOCITY, high)
    flight.pilot.follow(Setpoint(place(5.0, 0.0, 0.0), (0.0, 0.0, 0.5), free_z=True), flight.now, flight.now + 1)
    tick = flight.tick()
    assert not tick.hold and tick.message is not None
    assert tick.message[1]["vz"] == pytest.approx(-0.5) and tick.message[1]["vy"] == pytest.approx(4.75, abs=0.02)
    assert flight.pilot.status(flight.now)["error_enu_m"] == pytest.approx([5.0, 0.0, 0.0], abs=0.02)
    flight.pilot.follow(Setpoint(place(0.0, 0.0, 300.0), free_xy=True), flight.now, flight.now + 1)
    assert (
        "z" not in texts(flight.tick()) and flight.pilot.state is OffboardState.HELD
    )  # but what it says of the other does


def test_a_reference_outside_the_fence_is_held() -> None:
    flight = Flight().fly(ControlMode.VELOCITY)
    flight.pilot.fly_to(place(70.0, 0.0, 10.0), None)
    tick = flight.tick()
    assert tick.hold and "target position" in texts(tick)


def test_the_fence_stands_on_earth_and_not_about_the_vehicle() -> None:
    flight = Flight()
    flight.at(45.0, 0.0, 10.0)
    flight.fly(ControlMode.VELOCITY)
    flight.at(51.0, 0.0, 10.0)
    assert flight.tick().hold


# --- what is shown and traced


def test_the_state_tells_what_is_flown(flight: Flight) -> None:
    flight.pilot.fly_to(place(3.0, -4.0, 10.0), None)
    flight.tick()
    status = flight.pilot.status(flight.now)
    assert (status["mode"], status["control_mode"], status["state"]) == ("attitude", "attitude", "flying")
    assert status["error_enu_m"] == pytest.approx([3.0, -4.0, 0.0], abs=0.02)
    assert status["error_m"] == pytest.approx(5.0, abs=0.02)
    assert status["rate_hz"] == pytest.approx(50) and status["rtt_s"] == pytest.approx(0.004)
    assert 0.1 <= status["thrust"] <= 0.9 and status["pitch_deg"] != 0.0
    flight.pilot.release("over")
    off = flight.pilot.status(flight.now)
    assert off["rate_hz"] is None and off["thrust"] is None and off["reference"] is None and off["mode"] is None


def test_rows_are_made_only_while_somebody_traces(flight: Flight) -> None:
    assert flight.tick().row is None
    flight.pilot.tracing = True
    tick = flight.tick()
    assert tick.row is not None and tick.row.thrust == flight.pilot.status(flight.now)["thrust"]
    assert tick.before is not None and tick.after == flight.pilot.memory


# --- whatever happens


@dataclass(frozen=True)
class Happening:
    """One thing that may happen to a flight, with a name for Hypothesis to print."""

    name: str
    do: Callable[[Flight], object]


def _engage(control_mode: ControlMode) -> Happening:
    def do(flight: Flight) -> None:
        try:
            flight.pilot.engage(control_mode, FENCE)
        except RefusedError:
            return

    return Happening(f"engage {control_mode}", do)


def _follow(flight: Flight, wanted: Setpoint) -> None:
    if flight.pilot.state is OffboardState.FLYING:
        flight.pilot.follow(wanted, flight.now, flight.now + 0.5)


def _go(flight: Flight, there: GeodeticPosition) -> None:
    if flight.pilot.state is OffboardState.FLYING:
        flight.pilot.fly_to(there, None)


numbers = st.floats(-100, 100)
vectors = st.tuples(numbers, numbers, numbers)
happenings = st.one_of(
    st.sampled_from([_engage(control_mode) for control_mode in ControlMode]),
    st.just(Happening("entered", lambda f: f.pilot.entered())),
    st.sampled_from(
        [
            Happening(f"want {control_mode}", lambda f, control_mode=control_mode: f.pilot.want(control_mode))
            for control_mode in ControlMode
        ]
    ),
    st.just(Happening("release", lambda f: f.pilot.release("asked"))),
    st.just(Happening("obeys", lambda f: f.beat(f.obeying))),
    st.sampled_from([PX4_LOITER, PX4_RTL]).map(lambda mode: Happening(f"mode {mode}", lambda f: f.beat(mode))),
    st.just(Happening("disarmed", lambda f: f.beat(armed=False))),
    st.sampled_from(range(5)).map(lambda s: Happening(f"landed {s}", lambda f: f.landed(s))),
    st.tuples(numbers, numbers, numbers).map(lambda p: Happening(f"at {p}", lambda f: f.at(*p))),
    st.tuples(st.floats(-90, 90), st.floats(-180, 179.9), st.floats(-2e6, 2e6), st.integers(0, 65535)).map(
        lambda p: Happening(
            f"anywhere {p}", lambda f: f.vehicle.on_frame(f.voice.position(*p[:3], rel_m=0.0, heading=p[3]), f.now)
        )
    ),
    st.just(Happening("no position", lambda f: f.vehicle.on_frame(f.voice.position(0.0, 0.0), f.now))),
    st.tuples(st.floats(width=32), st.floats(width=32), st.floats(width=32)).map(
        lambda a: Happening(
            f"attitude {a}",
            lambda f: f.vehicle.on_frame(f.voice.say(mav.MAVLink_attitude_message(0, *a, 0, 0, 0)), f.now),
        )
    ),
    st.tuples(vectors, vectors, st.booleans(), st.booleans()).map(
        lambda s: Happening(
            f"follow {s}", lambda f: _follow(f, Setpoint(place(*s[0]), s[1], s[1], 1.0, free_xy=s[2], free_z=s[3]))
        )
    ),
    vectors.map(lambda p: Happening(f"fly to {p}", lambda f: _go(f, place(*p)))),
    st.just(Happening("pongs", lambda f: f.pinged())),
    st.floats(0, 60).map(lambda hz: Happening(f"allowed {hz}", lambda f: setattr(f.pilot, "attitude_hz_allowed", hz))),
    st.sampled_from([0.0, 0.005, 0.02, 0.2, 0.6, 3.0, 30.0, -1.0]).map(
        lambda s: Happening(f"{s} s", lambda f: (setattr(f, "now", f.now + s), f.vehicle.tick(f.now)))
    ),
)


@settings(max_examples=examples(150))
@given(st.sampled_from([PX4, ARDUPILOT]), st.booleans(), st.lists(happenings, max_size=30))
def test_whatever_happens_it_never_raises_and_never_sends_what_it_must_not(
    autopilot: int, fly: bool, happening: list[Happening]
) -> None:
    flight = Flight(autopilot)
    pilot = flight.pilot
    pilot.tracing = True
    if fly:
        flight.fly(ControlMode.ATTITUDE)
    for event in happening:
        event.do(flight)
        for _ in range(2):
            sending = pilot.active
            tick = flight.tick(fresh=False)
            if not sending:
                assert tick == Tick()
            if tick.message is None:
                continue
            assert not tick.hold and pilot.active and flight.vehicle.armed and flight.vehicle.connected
            assert pilot.control_mode is not None
            mixed = pilot.reference is not None and (
                pilot.reference.velocity_only_xy or pilot.reference.velocity_only_z
            )
            control_mode = (
                ControlMode.VELOCITY if mixed and pilot.control_mode is ControlMode.POSITION else pilot.control_mode
            )
            name, values = tick.message
            assert name == MESSAGES[ControlMode.ATTITUDE if pilot.handing_over else control_mode]
            info = flight_dialect().by_name[name]
            info.pack(values)  # raises for what does not fit
            if name == "SET_ATTITUDE_TARGET":
                assert 0.0 <= values["thrust"] <= 1.0
                assert math.hypot(*values["q"]) == pytest.approx(1.0, abs=1e-3)
            if pilot.state is OffboardState.FLYING:
                assert flight.vehicle.custom_mode == flight.obeying
        pilot.status(flight.now)


@each(("lat_deg", "lon_deg"), [(0.0, 8.5), (47.4, 0.0)])
@each("control_mode", CONTROL_MODES)
def test_the_equator_and_the_first_meridian_are_places_like_any_other(
    lat_deg: float, lon_deg: float, control_mode: ControlMode
) -> None:
    flight = Flight()
    here = Origin(lat_deg, lon_deg, 100.0)
    frame = flight.voice.position(lat_deg, lon_deg, 110.0, 10.0)
    flight.vehicle.on_frame(frame, flight.now)
    flight.fly(control_mode, Fence(here))
    tick = flight.tick()
    assert tick.message is not None and tick.message[0] == MESSAGES[control_mode]


def test_a_new_hover_thrust_makes_no_step_in_the_thrust(flight: Flight) -> None:
    before = flight.tick().message
    flight.pilot.change_law(replace(flight.pilot.config.law, hover_thrust=0.55))
    after = flight.tick().message
    assert before is not None and after is not None
    assert after[1]["thrust"] == pytest.approx(before[1]["thrust"], abs=1e-6)


@each("control_mode", [ControlMode.VELOCITY, ControlMode.ATTITUDE])
def test_an_old_state_is_compared_with_where_the_reference_was_then(control_mode: ControlMode) -> None:
    """The reference moves on by 2 m/s while no state comes: it must not pull ever more."""
    flight = Flight().fly(control_mode)
    pilot = flight.pilot
    pilot.tracing = True
    assert pilot.follow(Setpoint(place(0.0, 0.0, 10.0), (2.0, 0.0, 0.0)), flight.now, flight.now + 2.0) is None
    seen = []
    for _ in range(24):
        tick = flight.tick(fresh=False)
        assert tick.row is not None and tick.row.reference is not None and tick.row.state_age_s is not None
        seen.append((tick.row.state_age_s, tick.row.reference.pos_enu_m[0]))
    assert seen[-1][0] > 0.4
    for age_s, east_m in seen:
        assert east_m == pytest.approx(2.0 * min(age_s, OLD_S), abs=0.05)
