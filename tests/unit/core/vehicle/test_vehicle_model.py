"""The model of a vehicle: its class by all evidence, what it is known to do, and whether its sticks are seen."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.vehicle_class import ON_ROTORS, TABLE, ReturnEnd, VehicleClass
from skygcs.core.mission.item import MissionType
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.vehicle import fence_params, mission_orders, offboard_entry, orders
from skygcs.core.vehicle.flight_evidence import may_fly
from skygcs.core.vehicle.gate import clear_undo
from skygcs.core.vehicle.message_cache import WATCHED
from skygcs.core.vehicle.order_plan import ModeIn, Plan
from skygcs.core.vehicle.stick_modes import hazard, without_sticks
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import Sticks, model_of
from skygcs.errors import NotReadyError, RefusedError
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, Voice, flight_dialect

NOW = 100.0
RECEIVER = mav.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
PLANE, QUADROTOR, ROVER, BOAT, SUB, VTOL, BLIMP, TRACKER = 1, 2, 10, 11, 12, 20, 7, 5


class Shown:
    """A vehicle in the air that shows this type and mode, and what else it has said."""

    def __init__(self, autopilot: int, kind: int, mode: int = 0, banner: str = "", **params: float) -> None:
        self.vehicle, self.voice = Vehicle(1, 1, flight_dialect()), Voice(1)
        beat = mav.MAVLink_heartbeat_message(kind, autopilot, 0x81, mode, 4, 3)
        self.hear(beat)
        if banner:
            self.hear(mav.MAVLink_statustext_message(6, banner.encode()))
        for name, value in params.items():
            self.hear(mav.MAVLink_param_value_message(name.encode(), value, 9, 900, 1))
        self.hear(mav.MAVLink_extended_sys_state_message(0, 2))
        self.vehicle.on_frame(self.voice.position(alt_amsl_m=HOME[2] + 20, rel_m=20.0), NOW)

    def hear(self, message: mav.MAVLink_message) -> None:
        self.vehicle.on_frame(self.voice.say(message), NOW)

    def sticks(self, present: int, health: int, channels: tuple[int, ...] = ()) -> Sticks:
        self.hear(mav.MAVLink_sys_status_message(present, present, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
        if channels:
            self.hear(mav.MAVLink_rc_channels_message(1, len(channels), *channels, *[0] * (18 - len(channels)), 255))
        return model_of(self.vehicle, NOW).sticks


def test_banner_and_parameters_decide_the_class_before_the_type_that_is_shown() -> None:
    copter, plane, vtol = VehicleClass.COPTER, VehicleClass.PLANE, VehicleClass.VTOL
    table: list[tuple[Shown, VehicleClass, str]] = [
        (Shown(ARDUPILOT, QUADROTOR, 17), copter, "BRAKE"),
        (Shown(ARDUPILOT, QUADROTOR, 17, "ArduCopter V4.6.3 (1234abcd)"), copter, "BRAKE"),
        (Shown(ARDUPILOT, QUADROTOR, 17, "ArduPlane V4.6.3 (1234abcd)"), vtol, "QSTABILIZE"),  # Q_MAV_TYPE = 2
        (Shown(ARDUPILOT, QUADROTOR, 5, Q_ENABLE=1.0), vtol, "FBWA"),
        (Shown(ARDUPILOT, PLANE, 5), plane, "FBWA"),
        (Shown(ARDUPILOT, PLANE, 5, Q_ENABLE=0.0), plane, "FBWA"),
        (Shown(ARDUPILOT, PLANE, 5, Q_ENABLE=1.0), vtol, "FBWA"),
        (Shown(ARDUPILOT, PLANE, 18), vtol, "QHOVER"),
        (Shown(ARDUPILOT, VTOL, 5), vtol, "FBWA"),
        (Shown(ARDUPILOT, ROVER, 4), VehicleClass.ROVER, "HOLD"),
        (Shown(ARDUPILOT, BOAT, 4, "ArduRover V4.6.3 (1234abcd)"), VehicleClass.BOAT, "HOLD"),
        (Shown(ARDUPILOT, 0, 17, "ArduCopter V4.6.3 (1234abcd)"), copter, "BRAKE"),  # a frame of its own
        (Shown(ARDUPILOT, SUB, 16), VehicleClass.SUB, "POSHOLD"),
        (Shown(PX4, QUADROTOR, 3 << 16, "ArduPlane V4.6.3 (1234abcd)"), copter, "POSCTL"),
        (Shown(PX4, VTOL, 3 << 16), vtol, "POSCTL"),
    ]
    shown = [(of.vehicle.kind, of.vehicle.mode) for of, _, _ in table]
    assert shown == [(kind, mode) for _, kind, mode in table]


def said(order: Callable[[], Plan]) -> str:
    """The first command of an order and its first parameters, or why it is refused."""
    try:
        plan = order()
    except RefusedError as error:
        return str(error)
    spec = plan.steps[0].command
    assert spec is not None
    return f"{spec.command} {spec.params[1]:g}" if spec.command == mav.MAV_CMD_DO_SET_MODE else f"{spec.command}"


def test_each_class_gets_its_own_hold_stop_landing_and_return_and_no_copters() -> None:
    """DO_SET_MODE is 176, with the number of a mode; modes by ArduPilot's mode.h of each program."""
    q_loiter, q_land, q_rtl, loiter = "176 19", "176 20", "176 21", "176 12"
    land, rtl, pause, land_start = "21", "20", "192", "189"
    table: list[tuple[Shown, tuple[str, str, str, str, str]]] = [
        # hold, stop, stop with landing, land, rtl
        (Shown(ARDUPILOT, PLANE, 18), (q_loiter, q_loiter, q_land, q_land, q_rtl)),  # QHOVER
        (Shown(ARDUPILOT, PLANE, 19), (q_loiter, q_loiter, q_land, q_land, q_rtl)),  # QLOITER
        (Shown(ARDUPILOT, QUADROTOR, 17, "ArduPlane V4.6.3"), (q_loiter, q_loiter, q_land, q_land, q_rtl)),
        (Shown(ARDUPILOT, PLANE, 10, Q_ENABLE=1.0), (loiter, loiter, q_land, q_land, rtl)),  # AUTO, on its wing
        (Shown(ARDUPILOT, PLANE, 10), (loiter, loiter, land_start, land_start, rtl)),
        (Shown(ARDUPILOT, ROVER, 10), ("176 4", "176 4", "176 4", "does not land", rtl)),
        (Shown(ARDUPILOT, BOAT, 10), ("176 5", "176 4", "176 4", "does not land", rtl)),
        (Shown(ARDUPILOT, SUB, 3), ("176 16", "176 16", land, land, "does not return")),
        (Shown(ARDUPILOT, BLIMP, 5), ("176 3", "176 3", "176 0", "176 0", "176 4")),
        (Shown(ARDUPILOT, TRACKER, 10), ("176 1", "176 1", "176 1", "does not land", "does not return")),
        (Shown(ARDUPILOT, QUADROTOR, 3), ("176 17", "176 17", land, land, rtl)),
        (Shown(PX4, VTOL, 4 << 16 | 4 << 24), (pause, pause, land, land, rtl)),
        (Shown(PX4, ROVER, 4 << 16 | 4 << 24), (pause, pause, pause, "does not land", rtl)),
    ]
    for of, wanted in table:
        vehicle = of.vehicle
        got = [
            said(lambda: orders.hold(vehicle, NOW)),  # noqa: B023 - called at once
            said(lambda: orders.stop(vehicle, NOW, "hold")),  # noqa: B023
            said(lambda: orders.stop(vehicle, NOW, "land")),  # noqa: B023
            said(lambda: orders.land(vehicle, NOW)),  # noqa: B023
            said(lambda: orders.rtl(vehicle, NOW)),  # noqa: B023
        ]
        for text, want in zip(got, wanted, strict=True):
            assert text == want or (not want[0].isdigit() and want in text), (vehicle.kind, vehicle.mode, got)


def on_the_ground(autopilot: int, kind: int, mode: int, **params: float) -> Shown:
    """Armed by nobody, and standing."""
    shown = Shown(autopilot, kind, mode, **params)
    shown.hear(mav.MAVLink_heartbeat_message(kind, autopilot, 0x01, mode, 3, 3))
    shown.hear(mav.MAVLink_extended_sys_state_message(0, 1))
    shown.vehicle.on_frame(shown.voice.position(alt_amsl_m=HOME[2], rel_m=0.0), NOW)
    return shown


def test_no_class_but_what_has_one_takes_off_by_an_order() -> None:
    for kind, mode, why in (
        (ROVER, 10, "a rover of ArduPilot does not take off; goto or mission start moves it"),
        (BOAT, 10, "a boat of ArduPilot does not take off; goto or mission start moves it"),
        (SUB, 3, "a sub of ArduPilot does not take off"),
        (0, 4, "does not know how a generic of ArduPilot is to take off; use a raw command"),
    ):
        with pytest.raises(RefusedError, match=re.escape(why)):
            orders.takeoff(on_the_ground(ARDUPILOT, kind, mode).vehicle, NOW, 5.0)


def commands(plan: Plan) -> list[tuple[int, float]]:
    """The commands of a plan, with their second parameter, which is the mode of DO_SET_MODE."""
    found = []
    for step in plan.steps:
        assert step.command is not None
        found.append((step.command.command, step.command.params[1] if len(step.command.params) > 1 else 0.0))
    return found


def test_an_arduplane_takes_off_in_its_takeoff_mode_to_its_own_height_only() -> None:
    """TAKEOFF is mode 13 (ArduPlane/mode.h), TKOFF_ALT its height (mode_takeoff.cpp)."""
    with pytest.raises(NotReadyError, match="TKOFF_ALT"):
        orders.takeoff(on_the_ground(ARDUPILOT, PLANE, 5, Q_ENABLE=0.0).vehicle, NOW, 50.0)
    plane = on_the_ground(ARDUPILOT, PLANE, 5, TKOFF_ALT=50.0, Q_ENABLE=0.0).vehicle
    with pytest.raises(RefusedError, match=re.escape("takes off to its TKOFF_ALT (50 m), not to 30 m")):
        orders.takeoff(plane, NOW, 30.0)
    plan = orders.takeoff(plane, NOW, 50.0)
    assert commands(plan)[:2] == [(mav.MAV_CMD_DO_SET_MODE, 13.0), (mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)]
    undo = plan.steps[0].undo
    assert undo is not None and undo.command is not None and undo.command.params[1] == 12.0  # LOITER, not FBWA


def test_a_plane_is_sent_off_along_the_ground_once_it_has_shown_that_it_is_no_quadplane() -> None:
    """A build without QuadPlanes has no Q_ENABLE, and answers no request for it: it never became ready. Its vtol_state
    is undefined, as that of a QuadPlane never is (GCS_MAVLINK_Plane::vtol_state)."""
    vehicle, voice = Vehicle(1, 1, flight_dialect()), Voice(1)

    def hear(message: mav.MAVLink_message) -> None:
        vehicle.on_frame(voice.say(message), NOW)

    hear(mav.MAVLink_heartbeat_message(PLANE, ARDUPILOT, 0x01, 5, 3, 3))
    hear(mav.MAVLink_param_value_message(b"TKOFF_ALT", 50.0, 9, 900, 1))
    vehicle.on_frame(voice.position(alt_amsl_m=HOME[2], rel_m=0.0), NOW)
    with pytest.raises(NotReadyError, match="neither Q_ENABLE nor EXTENDED_SYS_STATE"):
        orders.takeoff(vehicle, NOW, 50.0)
    hear(mav.MAVLink_extended_sys_state_message(0, 1))
    plan = orders.takeoff(vehicle, NOW, 50.0)
    assert commands(plan)[:2] == [(mav.MAV_CMD_DO_SET_MODE, 13.0), (mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)]
    hear(mav.MAVLink_extended_sys_state_message(3, 1))  # a QuadPlane whose Q_ENABLE was lost
    assert commands(orders.takeoff(vehicle, NOW, 50.0))[-1] == (mav.MAV_CMD_NAV_TAKEOFF, 0.0)


NAV_LAND, RETURN_PATH, LAND_START = 21, 188, 189


@each(
    ("rotors", "landing", "marker", "end"),
    [
        # ArduPlane/mode_rtl.cpp. Q_RTL_MODE 0: navigate comes to RTL_AUTOLAND
        (0, 0, None, ReturnEnd.CIRCLES),
        (0, 1, LAND_START, ReturnEnd.CIRCLES),
        (0, 2, LAND_START, ReturnEnd.CIRCLES),
        (0, 3, None, ReturnEnd.CIRCLES),  # OnlyForGoAround
        (0, 4, RETURN_PATH, ReturnEnd.CIRCLES),
        # 1: switch_QRTL is asked 1 s after the mode change, and near its home; 2 and 4 jump before
        (1, 0, None, ReturnEnd.LANDS_ON_ROTORS),
        (1, 1, None, ReturnEnd.LANDS_ON_ROTORS),
        (1, 2, LAND_START, ReturnEnd.LANDS_ON_ROTORS),
        (1, 4, RETURN_PATH, ReturnEnd.LANDS_ON_ROTORS),
        # 2 and 3: navigate returns before it, or the mode is QRTL
        *((rotors, landing, None, ReturnEnd.LANDS_ON_ROTORS) for rotors in (2, 3) for landing in range(5)),
    ],
)
def test_a_quadplanes_return_ends_by_its_parameters_and_its_mission(
    rotors: int, landing: int, marker: int | None, end: ReturnEnd
) -> None:
    """The end is that without a landing in its mission, and with the marker of the other firmware option."""
    params = {"Q_ENABLE": 1.0, "Q_RTL_MODE": float(rotors), "RTL_AUTOLAND": float(landing)}
    winged = Shown(ARDUPILOT, PLANE, 12, **params)
    rule = winged.vehicle.return_rule(NOW)
    assert rule.end is end and rule.markers == ({marker} if marker else set())
    assert rule.with_mission({16, 20, NAV_LAND}) is end
    for other in (RETURN_PATH, LAND_START):
        wanted = ReturnEnd.BY_MISSION if other == marker else end
        assert rule.with_mission({16, 20, other, NAV_LAND}) is wanted
    if marker:
        assert rule.with_mission({16, 20, marker}) is ReturnEnd.NOT_KNOWN, "no landing follows"
    assert orders.rtl(winged.vehicle, NOW).done == f"returning to launch; {rule}"
    hovering = Shown(ARDUPILOT, PLANE, 19, **params)
    assert orders.rtl(hovering.vehicle, NOW).done == "returning in QRTL"  # which lands, whatever they are


@each("mode", [0, 10, 17, 19])
def test_the_return_of_a_mission_ends_as_its_class_does_however_it_stands_now(mode: int) -> None:
    """On the ground in QLOITER it counted as landing at the end of a mission that circles."""
    vehicle = Shown(ARDUPILOT, PLANE, mode, Q_ENABLE=1.0, Q_RTL_MODE=0.0, RTL_AUTOLAND=0.0, WP_LOITER_RAD=80.0).vehicle
    assert vehicle.mission_return_rule.with_mission({16, 20}) is ReturnEnd.CIRCLES
    assert vehicle.mission_reach_m == vehicle.return_reach_m == 100.0


def test_a_fixed_wing_that_has_kept_the_parameters_of_a_quadplane_circles() -> None:
    vehicle = Shown(ARDUPILOT, PLANE, 10, Q_ENABLE=0.0, Q_RTL_MODE=1.0, RTL_AUTOLAND=0.0).vehicle
    assert vehicle.return_rule(NOW).end is ReturnEnd.CIRCLES


@each(
    ("kind", "rtl_type", "delay_s", "end", "with_landing"),
    [
        # init.d/rc.fw_defaults; navigator/rtl.cpp: findRtlDestination; rtl_direct.cpp: _updateRtlState
        (PLANE, 1, -1, ReturnEnd.CIRCLES, ReturnEnd.BY_MISSION),
        (PLANE, 1, 0, ReturnEnd.LANDS_AS_PLANE, ReturnEnd.BY_MISSION),
        (PLANE, 0, -1, ReturnEnd.CIRCLES, ReturnEnd.CIRCLES),
        (PLANE, 0, 30, ReturnEnd.LANDS_AS_PLANE, ReturnEnd.LANDS_AS_PLANE),
        (QUADROTOR, 0, 0, ReturnEnd.LANDS, ReturnEnd.LANDS),
        (QUADROTOR, 0, 30, ReturnEnd.LANDS, ReturnEnd.LANDS),
        (QUADROTOR, 0, -1, ReturnEnd.HOLDS, ReturnEnd.HOLDS),
        (QUADROTOR, 1, -1, ReturnEnd.HOLDS, ReturnEnd.BY_MISSION),
        *((kind, by, -1, *[ReturnEnd.NOT_KNOWN] * 2) for kind in (PLANE, QUADROTOR) for by in (2, 3, 4)),
    ],
)
def test_a_px4s_return_ends_by_its_parameters_and_its_mission(
    kind: int, rtl_type: int, delay_s: int, end: ReturnEnd, with_landing: ReturnEnd
) -> None:
    vehicle = Shown(PX4, kind, 4 << 16, RTL_TYPE=float(rtl_type), RTL_LAND_DELAY=float(delay_s)).vehicle
    assert vehicle.return_rule(NOW).end is end
    assert vehicle.mission_return_rule.with_mission({16, 20}) is end
    assert vehicle.mission_return_rule.with_mission({16, 20, NAV_LAND}) is with_landing


@each(("firmware", "known"), [(PX4, {"RTL_TYPE": 1.0}), (ARDUPILOT, {"Q_ENABLE": 0.0})])
def test_a_missions_return_is_not_known_while_a_parameter_is_not(firmware: int, known: dict[str, float]) -> None:
    vehicle = Shown(firmware, PLANE, 10, **known).vehicle
    assert vehicle.mission_return_rule.with_mission({16, 20}) is ReturnEnd.NOT_KNOWN


def test_the_circle_at_home_has_a_radius_of_its_own() -> None:
    plane = {"Q_ENABLE": 0.0, "WP_LOITER_RAD": 60.0}
    assert Shown(ARDUPILOT, PLANE, 10, **plane, RTL_RADIUS=0.0).vehicle.return_reach_m == 75.0
    own = Shown(ARDUPILOT, PLANE, 10, **plane, RTL_RADIUS=-200.0).vehicle
    assert (own.return_reach_m, own.mission_reach_m, own.hold_radius_m(NOW)) == (250.0, 250.0, 60.0)
    px4 = Shown(PX4, PLANE, 4 << 16, NAV_LOITER_RAD=80.0, RTL_LOITER_RAD=40.0).vehicle
    assert (px4.return_reach_m, px4.mission_reach_m) == (50.0, 100.0)
    assert Shown(ARDUPILOT, QUADROTOR, 5).vehicle.mission_reach_m == 0.0


def test_what_a_return_does_is_in_the_answer_of_what_does_not_land() -> None:
    assert orders.rtl(Shown(ARDUPILOT, QUADROTOR, 5).vehicle, NOW).done == "returning to launch"
    assert orders.rtl(Shown(PX4, VTOL, 4 << 16).vehicle, NOW).done == "returning to launch"
    assert orders.rtl(Shown(PX4, QUADROTOR, 4 << 16).vehicle, NOW).done == "returning to launch"
    holds = Shown(PX4, QUADROTOR, 4 << 16, RTL_TYPE=0.0, RTL_LAND_DELAY=-1.0).vehicle
    assert orders.rtl(holds, NOW).done == "returning to launch; it holds above its home"
    assert orders.rtl(Shown(PX4, PLANE, 4 << 16).vehicle, NOW).done.endswith("; without one it circles above its home")
    assert orders.rtl(Shown(ARDUPILOT, ROVER, 15).vehicle, NOW).done.endswith("; it stops and stays armed")
    landing = Shown(ARDUPILOT, PLANE, 12, Q_ENABLE=0.0, RTL_AUTOLAND=2.0).vehicle
    assert "it lands by the landing of its mission" in orders.rtl(landing, NOW).done


def test_every_parameter_that_a_class_declares_is_kept() -> None:
    for able in (*TABLE.values(), *ON_ROTORS.values()):
        assert set(able.asked_params) <= WATCHED
        assert {name for height in (*able.return_heights, able.return_climb) for name, _ in height} <= WATCHED


def test_no_undo_ends_in_a_mode_flown_by_sticks() -> None:
    """Whatever mode it was in: what moves off all the same would fly in it."""
    undos = 0
    for autopilot, kind in itertools.product((ARDUPILOT, PX4), (PLANE, QUADROTOR, ROVER, BOAT, SUB, VTOL, BLIMP)):
        for mode in (0, 1 << 16) if autopilot == PX4 else (0, 5, 17):
            shown = on_the_ground(autopilot, kind, mode, TKOFF_ALT=50.0, Q_ENABLE=float(kind == VTOL))
            for planner in (mission_orders.start, lambda v, now: orders.takeoff(v, now, 50.0)):
                try:
                    plan = planner(shown.vehicle, NOW)
                except RefusedError:
                    continue
                model = model_of(shown.vehicle, NOW)
                for step in plan.steps:
                    if step.undo is not None and isinstance(step.undo.expect, ModeIn):
                        undos += 1
                        (number,) = step.undo.expect.custom_modes
                        assert without_sticks(model, number) is None, (autopilot, kind, step.undo.name)
                        clear_undo(model, plan.order, step.undo)
    assert undos > 20


def test_a_quadplane_rises_on_its_rotors_by_a_height_above_where_it_stands() -> None:
    """GUIDED is mode 15; param7 becomes a relative height (convert_MAV_CMD_NAV_TAKEOFF_to_COMMAND_INT)."""
    plan = orders.takeoff(on_the_ground(ARDUPILOT, PLANE, 19, Q_ENABLE=1.0).vehicle, NOW, 12.0)
    assert commands(plan) == [(176, 15.0), (400, 0.0), (mav.MAV_CMD_NAV_TAKEOFF, 0.0)]
    last = plan.steps[2].command
    assert last is not None and last.params[6] == 12.0 and last.message == "COMMAND_LONG"


def test_a_quadplane_whose_parameters_have_not_come_is_known_by_its_vtol_state() -> None:
    """MAV_VTOL_STATE_MC is 3, FW 4; without QuadPlane it is undefined (GCS_MAVLINK_Plane::vtol_state)."""
    shown = Shown(ARDUPILOT, PLANE, 10)  # AUTO
    for state, kind, held in (
        (mav.MAV_VTOL_STATE_UNDEFINED, VehicleClass.PLANE, "176 12"),
        (mav.MAV_VTOL_STATE_MC, VehicleClass.VTOL, "176 19"),  # QLOITER: LOITER would fly off ahead
        (mav.MAV_VTOL_STATE_TRANSITION_TO_MC, VehicleClass.VTOL, "176 19"),
        (mav.MAV_VTOL_STATE_FW, VehicleClass.VTOL, "176 12"),
    ):
        shown.hear(mav.MAVLink_extended_sys_state_message(state, 2))
        assert shown.vehicle.kind is kind
        assert said(lambda: orders.stop(shown.vehicle, NOW, "hold")) == held
    grounded = on_the_ground(ARDUPILOT, PLANE, 0, TKOFF_ALT=12.0)
    grounded.hear(mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_MC, 1))
    assert commands(orders.takeoff(grounded.vehicle, NOW, 12.0))[0] == (176, 15.0)  # GUIDED, by its rotors
    copter = Shown(ARDUPILOT, QUADROTOR, 4)
    copter.hear(mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_MC, 2))  # as each ArduCopter does
    assert copter.vehicle.kind is VehicleClass.COPTER


def test_a_px4_plane_takes_off_as_a_multirotor_does() -> None:
    plan = orders.takeoff(on_the_ground(PX4, PLANE, 3 << 16).vehicle, NOW, 40.0)
    assert [step.name for step in plan.steps] == ["mode AUTO.LOITER", "arm", "takeoff"]


def test_a_rover_is_never_in_the_air_whatever_status_it_shows() -> None:
    """Rover shows MAV_STATE_ACTIVE in each mode but HOLD, and no landed state (GCS_MAVLINK_Rover)."""
    rover = Shown(ARDUPILOT, ROVER, 15)
    assert rover.vehicle.armed and rover.vehicle.in_air(NOW) is False
    assert orders.disarm(rover.vehicle, NOW).order == "disarm"
    assert orders.set_home(rover.vehicle, NOW).order == "home"
    where = {"lat_deg": HOME[0], "lon_deg": HOME[1] + 0.001, "height_m": 0.0}
    assert orders.goto(rover.vehicle, NOW, limit_m=500.0, **where).order == "goto"  # type: ignore[misc]
    assert model_of(rover.vehicle, NOW).may_fly  # its modes for sticks need sticks while it is armed


@each("kind", [QUADROTOR, PLANE, ROVER, BOAT])
@each("landed", [0, 1, 2, 3, 4])
@each("armed", [True, False])
def test_all_rules_agree_who_is_under_way(kind: int, landed: int, armed: bool) -> None:
    shown = on_the_ground(PX4, kind, 4 << 16)
    shown.hear(mav.MAVLink_heartbeat_message(kind, PX4, 0x81 if armed else 0x01, 4 << 16, 4 if armed else 3, 3))
    shown.hear(mav.MAVLink_extended_sys_state_message(0, landed))
    flies = kind in (QUADROTOR, PLANE)
    wanted = armed and (not flies or landed != mav.MAV_LANDED_STATE_ON_GROUND)
    assert shown.vehicle.under_way(NOW) is wanted
    assert may_fly(shown.vehicle, NOW) is wanted
    if armed:
        assert is_flying(shown.vehicle, NOW) is model_of(shown.vehicle, NOW).may_fly is wanted
    assert (shown.vehicle.in_air(NOW) is True) <= flies, "what drives does not fall"


def test_a_fence_is_not_changed_around_what_drives_unless_somebody_insists() -> None:
    rover = Shown(ARDUPILOT, ROVER, 10).vehicle  # armed, in AUTO
    with pytest.raises(RefusedError, match="under way and would be without its fence"):
        mission_orders.require_clearable(rover, NOW, (MissionType.FENCE,), force=False)
    mission_orders.require_clearable(rover, NOW, (MissionType.FENCE,), force=True)
    stands = on_the_ground(ARDUPILOT, ROVER, 10).vehicle
    mission_orders.require_clearable(stands, NOW, (MissionType.FENCE,), force=False)
    driving = Shown(PX4, ROVER, 4 << 16).vehicle
    fence = fence_params.FenceSettings(True, "hold", 20.0, None, follows_list=False)
    with pytest.raises(RefusedError, match="is not known"):
        fence_params.require_inside(driving, NOW, fence)
    fence_params.require_inside(on_the_ground(PX4, ROVER, 4 << 16).vehicle, NOW + 5.0, fence)  # disarmed long ago


def test_a_thing_of_an_unknown_type_gets_only_what_all_firmware_shares() -> None:
    """MAV_TYPE 8, a free balloon, of which no ArduPilot has modes: pymavlink has none either."""
    balloon = Shown(ARDUPILOT, 8, 4).vehicle
    assert mavutil.mode_mapping_bynumber(8) is None and balloon.mode == "UNKNOWN(4)"
    for order, why in (
        (lambda: orders.hold(balloon, NOW), "hold its position"),
        (lambda: orders.land(balloon, NOW), "land"),
        (lambda: orders.set_mode(balloon, NOW, "GUIDED"), "DO_SET_MODE"),
    ):
        with pytest.raises(RefusedError, match=why):
            order()
    where = {"lat_deg": HOME[0], "lon_deg": HOME[1], "height_m": 20.0}
    with pytest.raises(RefusedError, match="free balloon of ArduPilot is to go to a place; use a raw command"):
        orders.goto(balloon, NOW, limit_m=500.0, **where)  # type: ignore[arg-type]
    assert said(lambda: orders.rtl(balloon, NOW)) == "20"
    assert said(lambda: orders.stop(balloon, NOW, "land")) == "21"  # worth an attempt
    on_px4 = Shown(PX4, 8, 4 << 16 | 4 << 24).vehicle
    assert said(lambda: orders.hold(on_px4, NOW)) == "192"


DRIVES = frozenset({5, 10, 11, 12})
"""MAV_TYPE of an antenna tracker, a rover, a boat and a submarine."""


@each("autopilot", [PX4, ARDUPILOT, mav.MAV_AUTOPILOT_OPENPILOT])
def test_what_can_be_stopped_is_stopped_whatever_type_it_shows(autopilot: int) -> None:
    """PX4 pauses in AUTO.LOITER and lands by NAV_LAND (navigator_main.cpp, Commander.cpp), whichever MAV_TYPE it was
    given; an ArduPilot of a type that pymavlink has modes for has one that stops. A landing that is not known to be
    missing is worth an attempt."""
    taken = set()
    for kind in range(52):
        vehicle = Shown(autopilot, kind, 4 << 16 if autopilot == PX4 else 0).vehicle
        if vehicle.autopilot != autopilot:  # the heartbeat of a ground station, a gimbal, a camera
            continue
        taken.add(kind)
        hold = said(lambda: orders.stop(vehicle, NOW, "hold"))  # noqa: B023
        land = said(lambda: orders.stop(vehicle, NOW, "land"))  # noqa: B023
        if autopilot == PX4:
            assert hold == "192", kind
            assert land == ("192" if kind in DRIVES - {5} else "21"), kind
            assert said(lambda: orders.hold(vehicle, NOW)) == "192", kind  # noqa: B023
            if kind not in DRIVES:
                assert said(lambda: orders.land(vehicle, NOW)) == "21", kind  # noqa: B023
        elif autopilot == ARDUPILOT:
            assert land[0].isdigit(), (kind, land)
            assert hold[0].isdigit() or mavutil.mode_mapping_bynumber(kind) is None, (kind, hold)
        else:
            assert land == "21", (autopilot, kind, land)
    assert taken >= {*range(18), *range(19, 26), 28, 29} - {mav.MAV_TYPE_GCS}


def test_only_copters_fly_setpoints_and_the_refusal_names_the_class() -> None:
    for autopilot, kind, mode in ((ARDUPILOT, PLANE, 15), (PX4, VTOL, 4 << 16), (ARDUPILOT, ROVER, 15), (PX4, 8, 0)):
        vehicle = Shown(autopilot, kind, mode).vehicle
        why = offboard_entry.entry_refusal(vehicle, NOW)
        assert why is not None and "only copters hover at setpoints" in why
        assert vehicle.kind is VehicleClass.OTHER or f"a {vehicle.kind}," in why
    assert offboard_entry.entry_refusal(Shown(ARDUPILOT, QUADROTOR, 4).vehicle, NOW) is None


def test_what_cannot_stop_says_how_wide_it_circles() -> None:
    assert orders.hold(Shown(ARDUPILOT, PLANE, 10).vehicle, NOW).done == "circling in LOITER, 60 m about where it was"
    narrow = Shown(ARDUPILOT, PLANE, 10, WP_LOITER_RAD=-40.0).vehicle  # to the left
    assert narrow.hold_radius_m(NOW) == 40.0
    assert Shown(ARDUPILOT, PLANE, 10, WP_LOITER_RAD=1.0).vehicle.hold_radius_m(NOW) == 60.0  # Plane::update_loiter
    assert Shown(PX4, PLANE, 4 << 16 | 4 << 24).vehicle.hold_radius_m(NOW) == 80.0
    assert Shown(ARDUPILOT, PLANE, 19).vehicle.hold_radius_m(NOW) == 0.0  # on its rotors
    standing = {kind: Shown(ARDUPILOT, kind, 5) for kind in (PLANE, VTOL)}
    for shown in standing.values():
        shown.hear(mav.MAVLink_extended_sys_state_message(0, 1))
        assert orders.hold(shown.vehicle, NOW).done == "holding in LOITER"  # and not circling
    assert standing[PLANE].vehicle.hold_radius_m(NOW) == 60.0  # it takes off into a circle
    assert standing[VTOL].vehicle.hold_radius_m(NOW) == 0.0  # it rises on its rotors
    assert Shown(ARDUPILOT, QUADROTOR, 4).vehicle.hold_radius_m(NOW) == 0.0


def test_the_hold_of_a_hovering_quadplane_says_that_it_sinks_without_sticks() -> None:
    """QuadPlane::get_pilot_desired_climb_rate_cms: without valid input 50 cm/s downwards."""
    hovering = Shown(ARDUPILOT, PLANE, 19, Q_ENABLE=1.0)
    for order in (lambda: orders.hold(hovering.vehicle, NOW), lambda: orders.stop(hovering.vehicle, NOW, "hold")):
        hovering.sticks(0, 0)
        assert order().done == (
            "stopped; QLOITER is flown by sticks, and no sticks are seen in its telemetry: it would sink; land or rtl "
            "needs no sticks"
        )
        hovering.sticks(RECEIVER, RECEIVER, (1500, 1500, 1500, 1500))
        assert order().done == "holding in QLOITER"
    hovers, modes_of = model_of(hovering.vehicle, NOW), mavutil.mode_mapping_bynumber(PLANE)
    for stop_mode in (12, 19):  # LOITER circles by itself, QLOITER does not
        assert (hazard(replace(hovers, sticks=Sticks.ABSENT), stop_mode) is None) == (modes_of[stop_mode] == "LOITER")


def test_a_quadplane_that_stays_on_its_rotors_in_guided_holds_there() -> None:
    """It was put into QLOITER, and sank to the ground from 10 m (ArduPlane 4.6.3, with the throttle stick down)."""
    numbers = {name: number for number, name in mavutil.mode_mapping_bynumber(PLANE).items()}
    held = orders.hold(Shown(ARDUPILOT, PLANE, 19, Q_GUIDED_MODE=1.0).vehicle, NOW)
    asked = [step.command.params[1] for step in held.steps if step.command is not None]
    assert asked == [numbers["QLOITER"], numbers["GUIDED"]] and held.done == "holding in GUIDED"
    assert len(orders.hold(Shown(ARDUPILOT, PLANE, 19).vehicle, NOW).steps) == 1, "it would fly on as a plane"
    on_wing = orders.hold(Shown(ARDUPILOT, PLANE, 10, Q_ENABLE=1.0, Q_GUIDED_MODE=1.0).vehicle, NOW)
    assert on_wing.done == "circling in LOITER, 60 m about where it was"
    stopped = orders.stop(Shown(ARDUPILOT, PLANE, 19, Q_GUIDED_MODE=1.0).vehicle, NOW, "hold")
    assert len(stopped.steps) == 1, "a stop ignores setpoints"
    for stays, done in ((1.0, "holding in GUIDED"), (0.0, on_wing.done)):
        sent_off = Shown(ARDUPILOT, PLANE, numbers["GUIDED"], Q_ENABLE=1.0, Q_GUIDED_MODE=stays)
        sent_off.hear(mav.MAVLink_extended_sys_state_message(mav.MAV_VTOL_STATE_TRANSITION_TO_FW, 2))
        assert orders.hold(sent_off.vehicle, NOW).done == done, "a hold after a goto made it a plane, 15 m up"


def test_a_quadplane_that_hovers_goes_nowhere_as_a_plane_unless_somebody_insists() -> None:
    where = {"lat_deg": HOME[0], "lon_deg": HOME[1], "height_m": 20.0}
    hovering = Shown(ARDUPILOT, PLANE, 19)
    with pytest.raises(RefusedError, match="Q_GUIDED_MODE"):
        orders.goto(hovering.vehicle, NOW, limit_m=500.0, **where)  # type: ignore[misc]
    assert orders.goto(hovering.vehicle, NOW, limit_m=500.0, force=True, **where).order == "goto"  # type: ignore[misc]
    stays = Shown(ARDUPILOT, PLANE, 19, Q_GUIDED_MODE=1.0)
    assert orders.goto(stays.vehicle, NOW, limit_m=500.0, **where).order == "goto"  # type: ignore[misc]


def test_sticks_are_seen_by_the_telemetry_and_ruled_out_by_the_fleet_file() -> None:
    copter = Shown(ARDUPILOT, QUADROTOR)
    assert model_of(copter.vehicle, NOW).sticks is Sticks.UNKNOWN
    assert copter.sticks(0, 0) is Sticks.ABSENT
    assert copter.sticks(RECEIVER, 0) is Sticks.ABSENT  # its radio failsafe
    assert copter.sticks(RECEIVER, RECEIVER) is Sticks.SEEN
    assert copter.sticks(RECEIVER, RECEIVER, (1500, 1500, 1000, 1500)) is Sticks.LOW
    assert copter.sticks(RECEIVER, RECEIVER, (1500, 1500, 1500, 1500)) is Sticks.READY
    assert model_of(copter.vehicle, NOW + 20.0).sticks is Sticks.UNKNOWN
    copter.vehicle.transmitter = True
    assert copter.sticks(0, 0) is Sticks.ABSENT  # a transmitter in the bag flies nothing
    copter.vehicle.transmitter = False
    assert copter.sticks(RECEIVER, RECEIVER) is Sticks.ABSENT


def test_the_answers_to_commands_are_kept_until_it_restarts_and_are_bounded() -> None:
    copter = Shown(ARDUPILOT, QUADROTOR)
    for command in range(200):
        copter.vehicle.on_frame(copter.voice.ack(command, 3), NOW)
    copter.vehicle.on_frame(copter.voice.ack(199, 5), NOW)  # in progress is no answer yet
    answers = model_of(copter.vehicle, NOW).answers
    assert (len(answers), answers[199], 0 in answers) == (64, 3, False)
    copter.vehicle.restart(NOW, "rebooted")
    assert model_of(copter.vehicle, NOW).answers == {}
