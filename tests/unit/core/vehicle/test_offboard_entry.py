"""Who may be taken over, on what terms, and how it is given back."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle import offboard_entry
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.order_plan import ParamKnown
from skygcs.core.vehicle.vehicle import Vehicle
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, PX4_LOITER, PX4_POSCTL, PX4_TAKEOFF, Voice, flight_dialect

DECODER = Decoder(flight_dialect())
RECEIVER = 1 << 16
"""MAV_SYS_STATUS_SENSOR_RC_RECEIVER."""

NOW = 100.0
PX4_OFFBOARD = 6 << 16
STABILIZE, AUTO, GUIDED, BRAKE = 0, 3, 4, 17
INT32, REAL32 = 6, 9


def flying(autopilot: int, mode: int | None = None, *, kind: int = 2, **beat: int) -> tuple[Vehicle, Voice]:
    vehicle, voice = Vehicle(1, 1, flight_dialect(), decoder=DECODER), Voice(1)
    here = (PX4_LOITER if autopilot == PX4 else GUIDED) if mode is None else mode
    for frame in (
        voice.beat(autopilot, here, armed=True, kind=kind, **{"status": 4, **beat}),
        voice.landed(2),
        voice.position(alt_amsl_m=HOME[2] + 20, rel_m=20.0),
    ):
        vehicle.on_frame(frame, NOW)
    return vehicle, voice


def param(voice: Voice, name: str, value: float, kind: int = REAL32) -> Frame:
    """As ArduPilot tells it: whatever its type, the number itself."""
    return voice.say(mav.MAVLink_param_value_message(name.encode(), value, kind, 1, 0))


def bytewise(voice: Voice, name: str, value: int) -> Frame:
    """As PX4 tells an integer."""
    return param(voice, name, struct.unpack("<f", struct.pack("<i", value))[0], INT32)


@each(("autopilot", "mode"), [(PX4, PX4_OFFBOARD), (ARDUPILOT, GUIDED)])
def test_it_follows_in_one_mode_only(autopilot: int, mode: int) -> None:
    vehicle, voice = flying(autopilot, mode)
    assert offboard_entry.guided_mode(vehicle) == mode and offboard_entry.is_following(vehicle)
    vehicle.on_frame(voice.beat(autopilot, PX4_POSCTL if autopilot == PX4 else 5, armed=True, status=4), NOW)
    assert not offboard_entry.is_following(vehicle)


def test_a_plane_knows_guided_by_another_number_and_a_stranger_none() -> None:
    plane, _ = flying(ARDUPILOT, 15, kind=1)
    assert offboard_entry.is_following(plane)
    stranger, _ = flying(0, GUIDED)
    assert not offboard_entry.is_following(stranger)
    assert "PX4 and ArduPilot" in str(offboard_entry.entry_refusal(stranger, NOW))


@each("autopilot", [PX4, ARDUPILOT])
def test_one_that_flies_and_knows_where_may_be_taken_over_also_from_a_pilot(autopilot: int) -> None:
    assert offboard_entry.entry_refusal(flying(autopilot)[0], NOW) is None
    assert (
        offboard_entry.entry_refusal(flying(autopilot, PX4_POSCTL if autopilot == PX4 else STABILIZE)[0], NOW) is None
    )


def test_who_may_not_be_taken_over_is_told_why() -> None:
    vehicle, voice = flying(PX4)
    assert "position is not known" in str(offboard_entry.entry_refusal(vehicle, NOW + 20))
    vehicle.ids.others = {vehicle.key: "on udp (10.0.0.5:14550) and on radio"}
    assert "two vehicles" in str(offboard_entry.entry_refusal(vehicle, NOW))
    vehicle.ids.others, vehicle.replayed = {}, True
    assert "recording" in str(offboard_entry.entry_refusal(vehicle, NOW))
    vehicle.replayed = False
    vehicle.on_frame(voice.beat(PX4, PX4_LOITER, armed=True, status=5), NOW)
    assert "failsafe" in str(offboard_entry.entry_refusal(vehicle, NOW))
    vehicle.on_frame(voice.beat(PX4, PX4_LOITER, armed=False), NOW)
    assert "disarmed" in str(offboard_entry.entry_refusal(vehicle, NOW))
    vehicle.tick(NOW + 30)
    assert "lost" in str(offboard_entry.entry_refusal(vehicle, NOW + 30))
    ground, voice = flying(ARDUPILOT)
    ground.on_frame(voice.landed(1), NOW)
    ground.on_frame(voice.position(), NOW)
    assert "on the ground" in str(offboard_entry.entry_refusal(ground, NOW))
    assert "it is a plane" in str(offboard_entry.entry_refusal(flying(ARDUPILOT, 15, kind=1)[0], NOW))


@each(("options", "said"), [(0, "set bit 3 (GUID_OPTIONS to 8)"), (5, "GUID_OPTIONS to 13"), (8, None), (13, None)])
def test_arducopter_is_sent_attitude_only_if_thrust_is_thrust(options: int, said: str | None) -> None:
    vehicle, voice = flying(ARDUPILOT)
    assert "not known" in str(offboard_entry.attitude_refusal(vehicle))
    vehicle.on_frame(param(voice, "GUID_OPTIONS", options, INT32), NOW)
    refusal = offboard_entry.attitude_refusal(vehicle)
    assert (refusal is None) if said is None else said in str(refusal)


@each("kind", [0, 20, 29])
def test_px4_of_a_type_whose_thrust_it_drops_is_sent_no_attitude(kind: int) -> None:
    """generic, tailsitter, dodecarotor: fill_thrust leaves their thrust at 0, or it is none of a multirotor."""
    assert offboard_entry.attitude_refusal(flying(PX4, kind=2)[0]) is None
    assert "MAV_TYPE" in str(offboard_entry.attitude_refusal(flying(PX4, kind=kind)[0]))


@each(
    ("autopilot", "name", "timeout_s", "refused"),
    [
        (ARDUPILOT, "GUID_TIMEOUT", 3.0, True),
        (ARDUPILOT, "GUID_TIMEOUT", 1.0, False),
        (PX4, "COM_OF_LOSS_T", 5.0, True),
        (PX4, "COM_OF_LOSS_T", 0.5, False),
    ],
)
def test_who_leans_on_for_long_after_the_last_setpoint_is_flown_by_attitude_only_if_insisted(
    autopilot: int, name: str, timeout_s: float, refused: bool
) -> None:
    vehicle, voice = flying(autopilot)
    assert offboard_entry.loss_refusal(vehicle) is None, "what was not told is no reason"
    vehicle.on_frame(param(voice, name, timeout_s), NOW)
    refusal = offboard_entry.loss_refusal(vehicle)
    assert (refusal is not None) is refused
    assert not refused or (f"{name} is {timeout_s:g} s" in str(refusal) and "force" in str(refusal))


def test_an_operator_is_told_what_a_vehicle_left_alone_would_do() -> None:
    px4, voice = flying(PX4)
    assert offboard_entry.loss_note(px4, NOW) is None and "is not known" in offboard_entry.loss_text(px4, NOW)
    px4.on_frame(bytewise(voice, "COM_OBL_RC_ACT", 0), NOW)
    note = str(offboard_entry.loss_note(px4, NOW))
    assert "Position mode" in note and "whether a pilot's sticks reach it is not known" in note
    assert offboard_entry.loss_text(px4, NOW) == note
    px4.on_frame(bytewise(voice, "COM_OBL_RC_ACT", 5), NOW)
    assert offboard_entry.loss_note(px4, NOW) is None and "it holds" in offboard_entry.loss_text(px4, NOW)
    px4.on_frame(bytewise(voice, "COM_OBL_RC_ACT", 6), NOW)
    assert "ends its flight (Terminate) and falls" in str(offboard_entry.loss_note(px4, NOW))
    copter, voice = flying(ARDUPILOT)
    copter.on_frame(param(voice, "FS_GCS_ENABLE", 0), NOW)
    assert "FS_GCS_ENABLE is 0" in str(offboard_entry.loss_note(copter, NOW))
    copter.on_frame(param(voice, "FS_GCS_ENABLE", 5), NOW)
    assert offboard_entry.loss_note(copter, NOW) is None
    assert "FS_GCS_ENABLE 5" in offboard_entry.loss_text(copter, NOW)


@each(
    ("health", "throttle_us", "said"),
    [(0, 1500, "no sticks are seen"), (RECEIVER, 1500, ""), (RECEIVER, 1000, "the throttle of its sticks is down")],
)
def test_sticks_that_are_seen_decide_whether_a_mode_of_sticks_is_dangerous(
    health: int, throttle_us: int, said: str
) -> None:
    """A PX4 without a transmitter sank from 12.4 to 4.5 m in Position mode after the daemon was killed."""
    px4, voice = flying(PX4)
    px4.on_frame(bytewise(voice, "COM_OBL_RC_ACT", 0), NOW)
    px4.on_frame(voice.say(mav.MAVLink_sys_status_message(RECEIVER, RECEIVER, health, *[0] * 10)), NOW)
    channels = [1500, 1500, throttle_us, *[1500] * 5, *[65535] * 10]
    px4.on_frame(voice.say(mav.MAVLink_rc_channels_message(0, 8, *channels, 255)), NOW)
    note = offboard_entry.loss_note(px4, NOW)
    assert said in str(note) if said else note is None


@each(
    ("text", "refuses"),
    [
        ("SET_POSITION_TARGET_GLOBAL_INT invalid coordinate frame 99", True),  # both as PX4 1.16 said them
        ("SET_POSITION_TARGET_LOCAL_NED coordinate frame 99 unsupported", True),
        ("Takeoff detected", False),
        ("Failsafe activated: no offboard signal", False),
    ],
)
def test_a_setpoint_thrown_away_is_known_by_the_message_it_names(text: str, refuses: bool) -> None:
    assert offboard_entry.refuses_setpoint(text) is refuses


def test_parameters_are_read_by_each_autopilots_own_encoding_and_forgotten_by_a_reboot() -> None:
    px4, voice = flying(PX4)
    px4.on_frame(bytewise(voice, "COM_RC_IN_MODE", 4), NOW)
    px4.on_frame(bytewise(voice, "COM_OBL_RC_ACT", -1), NOW)
    px4.on_frame(param(voice, "MPC_THR_HOVER", 0.5), NOW)
    px4.on_frame(param(voice, "COM_OF_LOSS_T", float("nan")), NOW)
    px4.on_frame(param(voice, "SYS_AUTOSTART", 1.0), NOW)
    names = ("COM_RC_IN_MODE", "COM_OBL_RC_ACT", "MPC_THR_HOVER", "COM_OF_LOSS_T", "SYS_AUTOSTART")
    assert [px4.param(name) for name in names] == [4, -1, 0.5, None, None]
    assert offboard_entry.reported_hover_thrust(px4) == 0.5
    px4.on_frame(voice.system_time(500_000), NOW)
    px4.on_frame(voice.system_time(1_000), NOW + 5)
    assert px4.param("MPC_THR_HOVER") is None


def test_arducopter_boosts_thrust_unless_told_not_to() -> None:
    copter, voice = flying(ARDUPILOT)
    assert offboard_entry.boosts_thrust(copter), "its default"
    copter.on_frame(param(voice, "ATC_ANGLE_BOOST", 0, 2), NOW)
    assert not offboard_entry.boosts_thrust(copter)
    assert not offboard_entry.boosts_thrust(flying(PX4)[0])


def test_what_attitude_needs_is_asked_by_name_and_anew() -> None:
    copter, voice = flying(ARDUPILOT)
    copter.on_frame(param(voice, "GUID_OPTIONS", 8, INT32), NOW)
    plan = offboard_entry.ask_parameters(copter, NOW + 1)
    step = plan.steps[0]
    assert step.message == ("PARAM_REQUEST_READ", {"param_id": "GUID_OPTIONS", "param_index": -1})
    assert not step.optional and all(s.optional for s in plan.steps[1:])
    assert step.expect == ParamKnown("GUID_OPTIONS", NOW + 1)
    assert not step.expect.met(copter, NOW + 1), "told a second ago: somebody may have changed it since"
    copter.on_frame(param(voice, "GUID_OPTIONS", 0, INT32), NOW + 2)
    assert step.expect.met(copter, NOW + 2)


@each(("autopilot", "following", "params"), [(PX4, PX4_OFFBOARD, (1, 6, 0)), (ARDUPILOT, GUIDED, (1, 4, 0))])
def test_entering_is_one_mode_switch_and_none_if_it_follows(
    autopilot: int, following: int, params: tuple[float, ...]
) -> None:
    vehicle, voice = flying(autopilot, PX4_POSCTL if autopilot == PX4 else STABILIZE)
    (step,) = offboard_entry.enter(vehicle).steps
    assert step.command is not None and step.command.params == params
    assert step.skip_if_met and step.expect is not None and not step.expect.met(vehicle, NOW)
    vehicle.on_frame(voice.beat(autopilot, following, armed=True, status=4), NOW)
    assert step.expect.met(vehicle, NOW)


PAUSE = (-1, 1, 0, math.nan, math.nan, math.nan, math.nan)
"""Of DO_REPOSITION: PX4's Navigator stops where it is."""


@each(
    ("autopilot", "was", "then"),
    [
        (PX4, PX4_LOITER, (1, 4, 3)),
        (PX4, 4 << 16 | 4 << 24, (1, 4, 4)),
        (PX4, PX4_POSCTL, PAUSE),
        (PX4, PX4_TAKEOFF, PAUSE),
        (PX4, None, PAUSE),
        (ARDUPILOT, AUTO, (1, AUTO, 0)),
        (ARDUPILOT, STABILIZE, (1, GUIDED, 0)),
        (ARDUPILOT, GUIDED, (1, GUIDED, 0)),
    ],
)
def test_it_is_given_back_to_a_mode_that_flies_by_itself_and_holds_otherwise(
    autopilot: int, was: int | None, then: tuple[float, ...]
) -> None:
    vehicle, _ = flying(autopilot, PX4_OFFBOARD if autopilot == PX4 else GUIDED)
    *before, step = offboard_entry.leave(vehicle, was, 0.0).steps
    assert step.command is not None and step.command.params == pytest.approx(then, nan_ok=True)
    # GUIDED does nothing in a copter that is in it already: it stops first
    assert [s.command.params for s in before if s.command] == ([(1, BRAKE, 0)] if then == (1, GUIDED, 0) else [])


def test_one_that_somebody_took_out_of_it_is_left_alone() -> None:
    vehicle, _ = flying(PX4, PX4_POSCTL)
    assert offboard_entry.leave(vehicle, PX4_LOITER, 0.0).steps == ()
