from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from skygcs.core.geo import Origin, distance_m
from skygcs.core.vehicle import orders
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.orders import LASTING_REASONS, todo_for, todo_in_mode
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, PX4_LOITER, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
NOW = 100.0
LIMIT_M = 500.0


def flying(autopilot: int, *, origin: bool = True) -> Vehicle:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    mode = PX4_LOITER if autopilot == PX4 else 4
    frames = (
        voice.beat(autopilot, mode, armed=True, status=4),
        voice.landed(2),
        voice.position(alt_amsl_m=HOME[2] + 20, rel_m=20.0),
    )
    for frame in frames:
        vehicle.on_frame(frame, NOW)
    if origin:
        vehicle.origin = Origin(*HOME)
    return vehicle


any_float = st.floats() | st.sampled_from([0.0, -0.0, 90.0, -90.0, 180.0, 1e-9, 1e300])
near = st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))


def place_of(plan: Plan) -> tuple[float, float, float, int]:
    spec = plan.steps[0].command
    assert spec is not None and spec.location is not None
    return spec.location.x / 1e7, spec.location.y / 1e7, spec.location.z, spec.location.frame


@given(
    st.sampled_from([PX4, ARDUPILOT]), any_float, any_float, st.none() | any_float, st.none() | any_float, st.booleans()
)
def test_whatever_numbers_come_a_goto_is_a_place_within_reach_or_a_refusal(
    autopilot: int, lat: float, lon: float, height: float | None, yaw: float | None, force: bool
) -> None:
    vehicle = flying(autopilot)
    try:
        plan = orders.goto(
            vehicle, NOW, lat_deg=lat, lon_deg=lon, height_m=height, yaw_deg=yaw, limit_m=LIMIT_M, force=force
        )
    except RefusedError as error:
        assert str(error)
        return
    there = place_of(plan)
    assert abs(there[0]) <= 90 and abs(there[1]) <= 180 and math.isfinite(there[2])
    assert lat != 0 and lon != 0
    assert force or distance_m(HOME[0], HOME[1], there[0], there[1]) <= LIMIT_M + 1
    for step in plan.steps:
        if step.command is not None:
            info = flight_dialect().by_name[step.command.message]
            info.pack(step.command.values(1, 1, 0))


@given(st.sampled_from([PX4, ARDUPILOT]), st.lists(any_float, max_size=4), st.booleans())
def test_whatever_numbers_come_in_enu_it_is_a_place_or_a_refusal(autopilot: int, enu: list[float], force: bool) -> None:
    vehicle = flying(autopilot)
    try:
        plan = orders.goto(vehicle, NOW, enu_m=enu, limit_m=LIMIT_M, force=force)
    except RefusedError:
        return
    there = place_of(plan)
    assert distance_m(HOME[0], HOME[1], there[0], there[1]) <= (150_000 if force else LIMIT_M + 1)


def test_a_goto_is_answered_in_the_units_it_was_given_in() -> None:
    enu = orders.goto(flying(PX4), NOW, enu_m=[20.0, -5.0, 15.0], limit_m=LIMIT_M)
    assert enu.done == "going to x 20.0, y -5.0, up 15.0 m"
    degrees = orders.goto(flying(PX4), NOW, lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], height_m=9.0, limit_m=LIMIT_M)
    assert degrees.done.startswith("going to 4") and degrees.done.endswith("9.0 m")


@given(near, st.floats(1, 200))
def test_both_autopilots_are_sent_to_the_same_point_in_space(offset: tuple[float, float], height: float) -> None:
    lat, lon = HOME[0] + offset[0] / 10, HOME[1] + offset[1] / 10
    px4 = place_of(orders.goto(flying(PX4), NOW, lat_deg=lat, lon_deg=lon, height_m=height, limit_m=LIMIT_M))
    copter = place_of(orders.goto(flying(ARDUPILOT), NOW, lat_deg=lat, lon_deg=lon, height_m=height, limit_m=LIMIT_M))
    assert px4[:2] == copter[:2]
    assert (px4[3], copter[3]) == (0, 3)
    assert px4[2] - HOME[2] == pytest.approx(copter[2], abs=1e-6)


@each("autopilot", [PX4, ARDUPILOT])
def test_a_goto_to_the_ground_is_refused_unless_insisted_on(autopilot: int) -> None:
    vehicle = flying(autopilot)
    for place in ({"lat_deg": HOME[0], "lon_deg": HOME[1], "height_m": 0.0}, {"enu_m": [5.0, 5.0, 0.0]}):
        with pytest.raises(RefusedError, match="use land, or insist"):
            orders.goto(vehicle, NOW, **place, limit_m=LIMIT_M)  # type: ignore[arg-type]
        assert orders.goto(vehicle, NOW, **place, limit_m=LIMIT_M, force=True)  # type: ignore[arg-type]


@given(near)
def test_the_limit_is_the_limit(offset: tuple[float, float]) -> None:
    lat, lon = HOME[0] + offset[0], HOME[1] + offset[1]
    away = distance_m(HOME[0], HOME[1], lat, lon)
    assume(abs(away - LIMIT_M) > 2)
    try:
        orders.goto(flying(PX4), NOW, lat_deg=lat, lon_deg=lon, limit_m=LIMIT_M)
    except RefusedError as error:
        assert away > LIMIT_M
        assert "limit is 500 m" in str(error)
    else:
        assert away < LIMIT_M


@given(any_float)
def test_a_takeoff_height_is_above_nothing_and_at_most_500_m(height: float) -> None:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(PX4), NOW)
    vehicle.on_frame(voice.position(), NOW)
    try:
        plan = orders.takeoff(vehicle, NOW, height)
    except RefusedError:
        assert not 0 < height <= 500
    else:
        late = plan.steps[-1].late
        assert late is not None
        assert late.command(vehicle, NOW).params[6] == pytest.approx(HOME[2] + height)
        assert 0 < height <= 500


def test_nothing_takes_off_without_knowing_the_ground_it_stands_on() -> None:
    for autopilot in (PX4, ARDUPILOT):
        vehicle = Vehicle(1, 1, flight_dialect(), decoder=DECODER)
        vehicle.on_frame(Voice(1).beat(autopilot, 0), NOW)
        with pytest.raises(RefusedError, match="position is not known yet"):
            orders.takeoff(vehicle, NOW, 5)


def test_a_position_that_is_too_old_is_none() -> None:
    vehicle = flying(PX4)
    vehicle.on_frame(Voice(1).beat(PX4, armed=True, status=4), NOW + 11)
    vehicle.on_frame(Voice(1).landed(2), NOW + 11)
    with pytest.raises(RefusedError, match="position is not known"):
        orders.goto(vehicle, NOW + 11, lat_deg=HOME[0], lon_deg=HOME[1], limit_m=LIMIT_M)


ROVER = 10
SUB = 12


def test_a_rover_goes_somewhere_without_being_in_the_air() -> None:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(ARDUPILOT, 15, armed=True, status=3, kind=ROVER), NOW)
    vehicle.on_frame(voice.position(rel_m=-0.4), NOW)
    plan = orders.goto(vehicle, NOW, lat_deg=HOME[0] + 1e-4, lon_deg=HOME[1], limit_m=LIMIT_M)
    assert place_of(plan)[3] == 3
    with pytest.raises(RefusedError, match="rover of ArduPilot does not take off"):
        orders.takeoff(vehicle, NOW, 5)
    assert orders.hold(vehicle, NOW).done == "holding in HOLD"


def test_an_autopilot_skygcs_does_not_know_is_armed_and_landed_but_not_guessed_at() -> None:
    vehicle = Vehicle(1, 1, flight_dialect(), decoder=DECODER)
    vehicle.on_frame(Voice(1).beat(9), NOW)
    vehicle.on_frame(Voice(1).position(), NOW)
    assert orders.arm(vehicle, NOW) and orders.land(vehicle, NOW) and orders.rtl(vehicle, NOW)
    for refused in (orders.hold, lambda v, n: orders.takeoff(v, n, 5.0), lambda v, n: orders.set_mode(v, n, "AUTO")):
        with pytest.raises(RefusedError):
            refused(vehicle, NOW)


@each("order", ["arm", "disarm", "land", "rtl", "hold", "reboot", "set_home"])
def test_nothing_but_a_forced_disarm_is_sent_to_a_lost_vehicle(order: str) -> None:
    vehicle = Vehicle(1, 1, flight_dialect(), decoder=DECODER)
    make: Any = getattr(orders, order)
    with pytest.raises(RefusedError, match="no heartbeat yet"):
        make(vehicle, NOW)
    vehicle.on_frame(Voice(1).beat(), NOW)
    assert make(vehicle, NOW)
    vehicle.tick(NOW + 6)
    with pytest.raises(RefusedError, match="no heartbeat for 7 s"):
        make(vehicle, NOW + 7)
    assert orders.disarm(vehicle, NOW + 7, force=True).emergency


@each(
    ("wrong", "hint"),
    [
        ("NOSUCHCMD", "give a name of MAV_CMD, as NAV_LAND, or a number"),
        ("SERVO", "DO_SET_SERVO"),
        ("TAKE_OFF", "NAV_TAKEOFF"),
        ("MAV_CMD_HOME_SET", "DO_SET_HOME"),
    ],
)
def test_a_command_that_does_not_exist_is_answered_with_near_ones(wrong: str, hint: str) -> None:
    with pytest.raises(RefusedError) as caught:
        orders.find_command(flight_dialect(), wrong)
    assert f"no command {wrong!r}; " in str(caught.value)
    assert hint in str(caught.value)
    assert str(caught.value).count(",") <= 5


def test_streams_frames_commands_and_messages_are_found_by_name_or_number() -> None:
    dialect = flight_dialect()
    assert orders.stream_number(dialect, "POSITION") == orders.stream_number(dialect, "mav_data_stream_position") == 6
    assert orders.stream_number(dialect, "10") == orders.stream_number(dialect, 10) == 10
    assert orders.find_command(dialect, "NAV_TAKEOFF") == orders.find_command(dialect, 22) == (22, "NAV_TAKEOFF")
    assert orders.find_command(dialect, 65000)[0] == 65000
    assert orders.find_message(dialect, "attitude") == (30, "ATTITUDE")
    assert orders.find_message(dialect, 16_000_000) == (16_000_000, "message 16000000")
    named = orders.command_plan(dialect, 192, [], int_frame="GLOBAL_RELATIVE_ALT", x=1, y=2, z=3.0)
    assert place_of(named) == (1e-7, 2e-7, 3.0, 3)
    for bad in (lambda: orders.stream_number(dialect, 999), lambda: orders.find_command(dialect, 70000)):
        with pytest.raises(RefusedError):
            bad()
    with pytest.raises(RefusedError, match="no frame 'NOWHERE'"):
        orders.command_plan(dialect, 192, [], int_frame="NOWHERE")


@each("mode", [4 << 16 | 4 << 24, 4 << 16 | 2 << 24])
def test_a_px4_that_would_take_off_when_armed_is_not_armed_by_itself(mode: int) -> None:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(PX4, mode), NOW)
    with pytest.raises(RefusedError, match="may take off at once"):
        orders.arm(vehicle, NOW)
    assert orders.arm(vehicle, NOW, force=True).steps
    vehicle.on_frame(voice.beat(PX4, PX4_LOITER), NOW)
    assert orders.arm(vehicle, NOW).steps


@each(
    ("kind", "mode", "instead", "moves"),
    [
        (1, 10, 12, "take off"),  # AUTO, LOITER
        (1, 13, 12, "take off"),  # TAKEOFF
        (ROVER, 10, 4, "drive on"),  # AUTO, HOLD
        (ROVER, 9, 4, "drive on"),  # CIRCLE: at 4 m/s after 4 s (Rover 4.6.3)
        (ROVER, 15, 4, "drive on"),  # GUIDED: to the place of its last goto, if it has one
    ],
)
def test_an_arming_sets_no_plane_and_no_rover_off_by_itself(kind: int, mode: int, instead: int, moves: str) -> None:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(ARDUPILOT, mode, kind=kind), NOW)
    with pytest.raises(RefusedError, match=f"may {moves} at once; set another mode first .(LOITER|HOLD)."):
        orders.arm(vehicle, NOW)
    assert orders.arm(vehicle, NOW, force=True).steps
    vehicle.on_frame(voice.beat(ARDUPILOT, instead, kind=kind), NOW)
    assert orders.arm(vehicle, NOW).steps


@each(("autopilot", "kind", "turns"), [(ARDUPILOT, 2, True), (ARDUPILOT, ROVER, False), (ARDUPILOT, 1, False)])
def test_a_heading_is_not_ordered_of_what_takes_none(autopilot: int, kind: int, turns: bool) -> None:
    """It drove off, and "FAIL yaw: unsupported" said that it did not: CONDITION_YAW follows the DO_REPOSITION."""
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(autopilot, 4, armed=True, status=4, kind=kind), NOW)
    vehicle.on_frame(voice.position(alt_amsl_m=HOME[2] + 20, rel_m=20.0), NOW)

    def to(yaw_deg: float | None) -> Plan:
        return orders.goto(vehicle, NOW, height_m=20.0, yaw_deg=yaw_deg, limit_m=LIMIT_M)

    assert to(None).steps
    if turns:
        assert len(to(90.0).steps) == 2
    else:
        with pytest.raises(RefusedError, match="of ArduPilot takes no heading; leave it out"):
            to(90.0)


@each("force", [False, True])
def test_a_place_beyond_every_reach_is_not_insisted_on(force: bool) -> None:
    """goto with swapped coordinates: "15435938 m away ... insist with force", which was then accepted."""

    def sent(lat_deg: float, lon_deg: float) -> object:
        vehicle = flying(PX4)
        return orders.goto(vehicle, NOW, lat_deg=lat_deg, lon_deg=lon_deg, height_m=10.0, limit_m=500.0, force=force)

    with pytest.raises(
        RefusedError, match="beyond what any vehicle can reach; did you swap latitude and longitude"
    ) as e:
        sent(HOME[1], HOME[0])
    assert "insist" not in str(e.value)
    with pytest.raises(RefusedError, match="beyond what any vehicle can reach"):
        orders.set_home(flying(PX4), NOW, lat_deg=HOME[1], lon_deg=HOME[0], limit_m=500.0, force=True)
    if force:
        assert sent(HOME[0] + 0.05, HOME[1])
    else:
        with pytest.raises(RefusedError, match="limit is 500 m; insist"):
            sent(HOME[0] + 0.05, HOME[1])


@each("autopilot", [PX4, ARDUPILOT])
def test_one_that_is_down_already_is_not_sent_into_a_landing(autopilot: int) -> None:
    """ "ok landing" of a PX4 on the ground, which then stayed in AUTO.LAND and did not arm."""
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(autopilot, 0), NOW)
    for order in (orders.land, orders.rtl):
        assert order(vehicle, NOW).steps, "whether it is on the ground is not known"
    vehicle.on_frame(voice.landed(1), NOW)
    vehicle.on_frame(voice.position(), NOW)
    for order in (orders.land, orders.rtl):
        plan = order(vehicle, NOW + 1.0)
        assert plan.steps == () and "on the ground and disarmed already" in plan.done
    vehicle.on_frame(voice.landed(2), NOW + 1.0)
    assert orders.land(vehicle, NOW + 1.0).steps


@each(("kind", "land"), [(1, True), (20, True), (ROVER, False), (SUB, True)])
def test_what_stands_disarmed_is_not_said_to_return(kind: int, land: bool) -> None:
    """ "ok returning to launch; it stops and stays armed" of a Rover that stood disarmed, and then did not arm."""
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    vehicle.on_frame(voice.beat(ARDUPILOT, 0, kind=kind), NOW)
    done = "it is disarmed and stays where it is; nothing was sent: arm it first"
    if kind not in (ROVER, SUB):
        assert orders.rtl(vehicle, NOW).steps, "whether it is on the ground is not known"
        vehicle.on_frame(voice.landed(1), NOW)
        done = "it is on the ground and disarmed already; nothing was sent"
    if kind != SUB:
        plan = orders.rtl(vehicle, NOW + 1.0)
        assert (plan.steps, plan.done) == ((), done)
    if land:
        plan = orders.land(vehicle, NOW + 1.0)
        assert (plan.steps, plan.done) == ((), done)
    else:
        with pytest.raises(RefusedError, match="does not land"):
            orders.land(vehicle, NOW + 1.0)
    vehicle.on_frame(voice.beat(ARDUPILOT, 4 if kind == ROVER else 12, armed=True, kind=kind), NOW + 1.0)
    assert (orders.land if kind == SUB else orders.rtl)(vehicle, NOW + 1.0).steps


@each("autopilot", [PX4, ARDUPILOT])
def test_a_goto_above_its_own_fence_is_refused_unless_insisted_on(autopilot: int) -> None:
    """The autopilot would return or land there. It flies at 20 m."""
    vehicle = flying(autopilot)
    fence = (
        {"GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 30.0, "GF_ACTION": 3.0}
        if autopilot == PX4
        else {"FENCE_RADIUS": 0.0, "FENCE_ALT_MAX": 30.0, "FENCE_ACTION": 1.0, "FENCE_TYPE": 1.0, "FENCE_ENABLE": 1.0}
    )

    def to(height_m: float, *, force: bool = False) -> Plan:
        return orders.goto(vehicle, NOW, height_m=height_m, limit_m=LIMIT_M, force=force)

    assert to(31.0), "its fence is not known"
    for name, value in fence.items():
        vehicle.parameters.note(name.encode(), value, 9, NOW, bytewise=False)
    with pytest.raises(RefusedError, match=r"its own fence acts above 30 m: choose a lower height.*or insist"):
        to(31.0)
    assert to(30.0) and to(31.0, force=True)
    for name, value in (("GF_MAX_VER_DIST", 10.0), ("FENCE_ALT_MAX", 10.0)):
        vehicle.parameters.note(name.encode(), value, 9, NOW, bytewise=False)
    assert to(15.0), "the way back below it"
    for name, value in (("GF_ACTION", 1.0), ("FENCE_ENABLE", 0.0)):
        vehicle.parameters.note(name.encode(), value, 9, NOW, bytewise=False)
    assert to(31.0), "it acts by nothing"


@each("noise_m", [-3.0, 3.0])
def test_a_takeoff_as_high_as_its_own_fence_is_not_refused_for_the_noise_of_its_position(noise_m: float) -> None:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    for frame in (
        voice.beat(PX4, PX4_LOITER),
        voice.landed(1),
        voice.position(alt_amsl_m=HOME[2] + noise_m, rel_m=noise_m),
    ):
        vehicle.on_frame(frame, NOW)
    vehicle.origin = Origin(*HOME)
    for name, value in {"GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 30.0, "GF_ACTION": 3.0}.items():
        vehicle.parameters.note(name.encode(), value, 9, NOW, bytewise=False)
    assert orders.takeoff(vehicle, NOW, 30.0)
    with pytest.raises(RefusedError, match="its own fence acts above 30 m"):
        orders.takeoff(vehicle, NOW, 30.5)
    assert orders.takeoff(vehicle, NOW, 30.5, force=True)


@each(
    ("text", "todo"),
    [
        ("PreArm: Hardware safety switch", "safety switch"),
        ("PreArm: 3D Accel calibration needed", "calibrate"),
        ("PreArm: Compass not calibrated", "calibrate"),
        ("Preflight Fail: Gyro 0 uncalibrated", "calibrate"),
        ("PreArm: Compass calibrated requires reboot", "skygcs-cli reboot alpha"),
        ("Preflight Fail: Kill switch engaged", "kill switch"),
        ("Arm: Leaning", "set it up"),
        ("Preflight Fail: Attitude failure (roll)", "skygcs-cli reboot alpha"),
        ("PreArm: Battery 1 below minimum arming voltage", "battery"),
    ],
)
def test_a_lasting_reason_names_what_cures_it(text: str, todo: str) -> None:
    reported = todo_for(["AHRS: waiting for home", text], "alpha")
    assert reported is not None and todo in reported


@each(("stop_mode", "mode"), [("BRAKE", "GUIDED"), ("LOITER", "GUIDED"), ("HOLD", "HOLD"), ("", "GUIDED")])
def test_a_vehicle_is_to_arm_in_a_mode_of_its_class(stop_mode: str, mode: str) -> None:
    for text in ("Arm: LAND mode not armable", "Arm: Mode not armable"):
        assert todo_for([text], "alpha", stop_mode) == f"set another mode first: skygcs-cli mode alpha {mode}"


@each(
    "text",
    [
        "Arm: Need Position Estimate",
        "PreArm: AHRS not healthy",
        "PreArm: EKF3 waiting for GPS config data",
        "PreArm: Gyros not calibrated",
        "PreArm: Gyros inconsistent",
        "PreArm: GPS 1: Bad fix",
        "Preflight Fail: heading estimate not stable",
        "Preflight Fail: No valid data from Accel 0",
        "Arming denied: calibrating",
        "",
    ],
)
def test_what_time_may_cure_is_waited_for(text: str) -> None:
    assert todo_for([text], "alpha") is None


def test_every_advice_is_complete_for_any_name() -> None:
    for _, todo in LASTING_REASONS:
        assert "{" not in todo.format(name="alpha", arms_in="GUIDED")


@each(
    ("mode", "why"),
    [("AUTO.LAND", "it does not arm in AUTO.LAND"), ("OFFBOARD", "while setpoints come"), ("POSCTL", "with sticks")],
)
def test_a_px4_is_said_to_refuse_for_its_mode_since_its_text_does_not_say_it(mode: str, why: str) -> None:
    assert why in (todo_in_mode("px4", mode, "alpha") or "")
    assert todo_in_mode("ardupilot", mode, "alpha") is todo_in_mode("px4", "AUTO.LOITER", "alpha") is None
