"""Failsafes of both simulated firmwares: each goes off once, does what its parameter says, and nothing without it."""

from __future__ import annotations

from math import hypot

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.conditions import Conditions, Dynamics
from skygcs.sim.failsafe_timers import ConditionTimer
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.rng import Rng
from support.examples import thinned
from support.sim_pilot import FIELD, Pilot, copter, px4, px4_mode, sim_dialect
from support.table import each

VELOCITY_ONLY = 0xDC7


def set_param(pilot: Pilot, name: str, value: float) -> None:
    found = pilot.vehicles[0].params.find(name)
    assert found is not None, name
    found[1].value = value


def beat(pilot: Pilot, seconds: float, sysid: int = 255) -> None:
    packer = mav.MAVLink(None, sysid, 190)
    for _ in range(round(seconds)):
        for frame in pilot.uplink.feed(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(packer)):
            pilot.vehicles[0].on_frame(frame, pilot.now)
        pilot.run(1.0)


def set_mode(pilot: Pilot, main: int, sub: int = 0) -> int | None:
    return pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, main, sub)


def northward(pilot: Pilot, speed_mps: float, seconds: float) -> None:
    """By velocity setpoints, ten a second."""
    values = [0.0, 0.0, 0.0, speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    message = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, VELOCITY_ONLY, *values)
    for _ in range(round(seconds * 10)):
        pilot.send(message)
        pilot.run(0.1)


def test_an_alarm_goes_off_once_after_its_time_and_again_after_an_end() -> None:
    alarm = ConditionTimer()
    assert [alarm.check(bad, now, 2.0) for now, bad in enumerate([1, 1, 1, 1, 0, 1, 1, 1])] == [
        *(False, False, True, False, False, False, False, True),
    ]


# -- ground station


@each(
    ("action", "mode"),
    thinned([(0, Px4Mode.LOITER), (1, Px4Mode.LOITER), (2, Px4Mode.RTL), (3, Px4Mode.LAND)], 2, turn=0),
)
def test_px4_misses_any_ground_station_after_com_dl_loss_t(action: int, mode: Px4Mode) -> None:
    pilot = Pilot(px4())
    set_param(pilot, "NAV_DLL_ACT", action)
    pilot.hovering()
    pilot.run(30)
    assert not pilot.vehicles[0].failsafes.gcs.raised, "who never had one does not miss it"
    beat(pilot, 3, sysid=17)
    pilot.run(8.5)
    assert "Failsafe activated" not in " ".join(pilot.texts())
    pilot.run(2)
    assert px4_mode(pilot) == Px4Mode.LOITER
    pilot.run(5)
    assert px4_mode(pilot) == mode, "COM_FAIL_ACT_T: it holds for 5 s before it returns or lands"
    told = [text for text in pilot.texts() if "GCS lost" in text]
    assert len(told) == (1 if action else 0)


def test_copter_misses_only_its_own_ground_station() -> None:
    pilot = Pilot(copter())
    set_param(pilot, "FS_GCS_ENABLE", 1)
    pilot.hovering()
    beat(pilot, 8, sysid=254)
    assert pilot.vehicles[0].mode == CopterMode.GUIDED, "SYSID_MYGCS is 255"
    beat(pilot, 8)
    assert pilot.vehicles[0].mode == CopterMode.GUIDED
    beat(pilot, 3, sysid=254)
    assert pilot.vehicles[0].mode == CopterMode.GUIDED
    beat(pilot, 3, sysid=254)
    assert pilot.vehicles[0].mode == CopterMode.RTL
    beat(pilot, 2)
    assert pilot.texts()[-2:] == ["GCS Failsafe", "GCS Failsafe Cleared"]
    assert pilot.vehicles[0].mode == CopterMode.RTL, "and it does not go back by itself"


# -- fence


@each(
    ("action", "mode"),
    thinned([(1, Px4Mode.OFFBOARD), (2, Px4Mode.LOITER), (3, Px4Mode.RTL), (5, Px4Mode.LAND)], 2, turn=1),
)
def test_px4_stops_at_its_fence(action: int, mode: Px4Mode) -> None:
    pilot = Pilot(px4())
    set_param(pilot, "GF_ACTION", action)
    set_param(pilot, "GF_MAX_HOR_DIST", 15.0)
    pilot.hovering()
    northward(pilot, 3.0, 1.5)
    assert set_mode(pilot, 6) == 0
    northward(pilot, 3.0, 4.0)
    assert px4_mode(pilot) == Px4Mode.OFFBOARD
    northward(pilot, 3.0, 3.5)
    assert px4_mode(pilot) == (Px4Mode.OFFBOARD if action == 1 else Px4Mode.LOITER)
    northward(pilot, 3.0, 5.0)
    assert px4_mode(pilot) == mode, "COM_FAIL_ACT_T"
    assert "fence distance" in " ".join(pilot.texts())
    if mode == Px4Mode.LOITER:
        northward(pilot, 3.0, 10.0)
        assert 15.0 < pilot.vehicles[0].motion.north_m < 20.0


def test_copter_returns_from_its_fence_and_takes_no_target_beyond_it() -> None:
    pilot = Pilot(copter())
    set_param(pilot, "FENCE_ENABLE", 1)
    set_param(pilot, "FENCE_RADIUS", 15.0)
    set_param(pilot, "FENCE_ALT_MAX", 20.0)
    set_param(pilot, "AVOID_ENABLE", 0)  # else a velocity stops before the fence
    pilot.hovering()
    far = [25.0, 0.0, -10.0] + [0.0] * 8
    pilot.send(mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0xDF8, *far))
    lat, lon = FIELD.to_geodetic(0.0, 25.0)
    refused = pilot.command_int(mav.MAV_CMD_DO_REPOSITION, -1, 0, 0, 0, x=round(lat * 1e7), y=round(lon * 1e7), z=190.0)
    assert refused == mav.MAV_RESULT_FAILED
    pilot.run(10)
    assert hypot(*pilot.vehicles[0].motion.pos_enu_m[:2]) < 0.5
    northward(pilot, 3.0, 10.0)
    assert pilot.vehicles[0].mode == CopterMode.RTL
    assert "Circle fence breached" in pilot.texts()
    pilot.run(60)
    assert not pilot.vehicles[0].armed and pilot.vehicles[0].motion.distance_m(0, 0, 0) < 0.5


def test_the_heights_fence_too() -> None:
    pilot = Pilot(px4())
    set_param(pilot, "GF_ACTION", 3)
    set_param(pilot, "GF_MAX_VER_DIST", 12.0)
    pilot.hovering(10.0)
    pilot.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, float("nan"), float("nan"), float("nan"), 200.0)
    pilot.run(10)
    assert "Reposition is outside geofence" in pilot.texts() and pilot.vehicles[0].motion.up_m < 10.5
    velocity_only = 0b0000_1101_1100_0111
    climb = mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, velocity_only, *[0.0] * 5, -1.0, *[0.0] * 5)
    pilot.send(climb)
    assert set_mode(pilot, 6) == 0
    for _ in range(80):
        pilot.send(climb)
        pilot.run(0.1)
    assert px4_mode(pilot) == Px4Mode.RTL


# -- battery


@each(
    ("action", "critical", "emergency"),
    [(0, Px4Mode.LOITER, Px4Mode.LOITER), (2, Px4Mode.LAND, Px4Mode.LAND), (3, Px4Mode.RTL, Px4Mode.LAND)],
)
def test_px4_acts_on_its_battery_in_steps(action: int, critical: Px4Mode, emergency: Px4Mode) -> None:
    pilot = Pilot(px4())
    set_param(pilot, "COM_LOW_BAT_ACT", action)
    pilot.hovering()
    for percent, mode in ((14, Px4Mode.LOITER), (6, critical), (4, emergency)):
        pilot.vehicles[0].battery.set_percent(percent)
        pilot.run(6)
        assert px4_mode(pilot) == mode, "COM_FAIL_ACT_T"
    assert pilot.texts().count("Low battery level, return advised") == 1


@each(("action", "mode"), [(0, CopterMode.GUIDED), (1, CopterMode.LAND), (2, CopterMode.RTL)])
def test_copter_acts_on_its_battery(action: int, mode: CopterMode) -> None:
    pilot = Pilot(copter())
    set_param(pilot, "BATT_FS_LOW_ACT", action)
    pilot.hovering()
    pilot.vehicles[0].battery.set_percent(19)
    pilot.run(1)
    assert pilot.vehicles[0].mode == mode
    assert sum(text.startswith("Battery 1 is low") for text in pilot.texts()) == 1


def test_a_drained_battery_lasts_shorter_and_lifts_less() -> None:
    pilot = Pilot(px4())
    pilot.hovering()
    pilot.vehicles[0].faults.battery_drain = 20.0
    pilot.run(30)
    assert pilot.vehicles[0].battery.percent < 60
    assert pilot.vehicles[0].motion.up_m == pytest.approx(10.0, abs=0.1), "its height controller makes up for it"


def test_a_milder_failsafe_does_not_stop_what_a_graver_one_began() -> None:
    pilot = Pilot(px4())
    set_param(pilot, "COM_LOW_BAT_ACT", 3)
    set_param(pilot, "NAV_DLL_ACT", 1)
    pilot.hovering()
    beat(pilot, 3)
    pilot.vehicles[0].battery.set_percent(7)
    pilot.run(6)
    assert px4_mode(pilot) == Px4Mode.RTL
    pilot.run(5)
    assert "Failsafe activated: GCS lost, holding" in pilot.texts()
    assert px4_mode(pilot) == Px4Mode.RTL


def test_px4_that_lands_does_not_miss_its_ground_station() -> None:
    """failsafe.cpp: dll_loss_ignored_land."""
    pilot = Pilot(px4())
    set_param(pilot, "NAV_DLL_ACT", 2)
    set_param(pilot, "MPC_LAND_SPEED", 0.3)
    pilot.hovering()
    beat(pilot, 3)
    set_mode(pilot, 4, 6)
    pilot.run(14)
    assert px4_mode(pilot) == Px4Mode.LAND and "GCS lost" not in " ".join(pilot.texts())


# -- offboard, position, power


@each(
    ("action", "mode"),
    thinned(
        [
            (0, Px4Mode.POSCTL),
            (1, Px4Mode.ALTCTL),
            (2, Px4Mode.STABILIZED),
            (3, Px4Mode.RTL),
            (4, Px4Mode.LAND),
            (5, Px4Mode.LOITER),
        ],
        3,
    ),
)
def test_px4_answers_the_loss_of_offboard_as_com_obl_rc_act_says(action: int, mode: Px4Mode) -> None:
    pilot = Pilot(px4())
    set_param(pilot, "COM_OBL_RC_ACT", action)
    pilot.hovering()
    northward(pilot, 1.0, 1.5)
    set_mode(pilot, 6)
    pilot.run(1.5)
    assert px4_mode(pilot) == mode and pilot.last("HEARTBEAT").system_status == mav.MAV_STATE_CRITICAL


def test_disarming_by_failsafe_lets_it_fall() -> None:
    pilot = Pilot(px4())
    set_param(pilot, "COM_OBL_RC_ACT", 7)
    pilot.hovering(20.0)
    northward(pilot, 1.0, 1.5)
    set_mode(pilot, 6)
    pilot.run(2.2)
    assert not pilot.vehicles[0].armed and pilot.vehicles[0].motion.vel_u_mps < -8
    pilot.run(10)
    assert pilot.vehicles[0].motion.up_m == 0.0 and pilot.vehicles[0].landed


def windy_px4(dynamics: Dynamics = Dynamics.RIGID) -> Px4Vehicle:
    conditions = Conditions(dynamics=dynamics, wind_enu_mps=(4.0, 0.0, 0.0))
    return Px4Vehicle(sim_dialect(), 1, FIELD, rng=Rng(1), conditions=conditions)


@each("dynamics", list(Dynamics))
def test_without_gps_it_comes_down_and_drifts_with_the_wind(dynamics: Dynamics) -> None:
    pilot = Pilot(windy_px4(dynamics))
    pilot.hovering()
    vehicle = pilot.vehicles[0]
    vehicle.faults.gps_lost = True
    pilot.run(4.8)
    assert px4_mode(pilot) == Px4Mode.LOITER
    pilot.run(0.5)
    assert px4_mode(pilot) == Px4Mode.LAND
    pilot.run(30)
    assert not vehicle.armed and vehicle.motion.on_ground
    assert vehicle.motion.east_m > 5.0 or dynamics is Dynamics.KINEMATIC


def test_px4_under_attitudes_needs_no_position_until_they_end() -> None:
    pilot = Pilot(px4())
    pilot.hovering()
    level = mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.42)
    pilot.vehicles[0].faults.gps_lost = True
    for i in range(80):
        pilot.send(level)
        if i == 15:
            set_mode(pilot, 6)
        pilot.run(0.1)
    assert px4_mode(pilot) == Px4Mode.OFFBOARD
    pilot.run(1.5)
    assert px4_mode(pilot) == Px4Mode.LAND, "it cannot hold without a position"


@each("vehicle", [px4(), copter()])
def test_a_reboot_in_flight_stops_the_motors_and_it_falls_on(vehicle: Px4Vehicle) -> None:
    pilot = Pilot(vehicle)
    pilot.hovering()
    vehicle.motion.up_m = 80.0
    vehicle.faults.reboot = True
    pilot.run(1.5)
    assert vehicle.motion.vel_u_mps < -9, "while the autopilot boots, too"
    assert not vehicle.armed and not vehicle.faults.reboot
    assert vehicle.boot_ms == 0
    pilot.run(0.7)
    assert vehicle.landed and vehicle.motion.up_m > 10, "disarmed, it takes itself for landed, as both firmwares do"
    pilot.run(15)
    assert vehicle.landed and vehicle.motion.on_ground and vehicle.motion.crashed
    assert vehicle.home is not None


@each("vehicle", [px4(), copter()])
def test_refused_modes_and_a_cut_link(vehicle: Px4Vehicle) -> None:
    pilot = Pilot(vehicle)
    pilot.hovering()
    vehicle.faults.refuse_mode = "out of order"
    before = vehicle.mode
    mode = (4, 5) if vehicle.autopilot == 12 else (CopterMode.LOITER, 0)
    assert set_mode(pilot, *mode) != 0
    assert vehicle.mode == before
    assert "out of order" in "".join(pilot.texts())
    vehicle.faults.refuse_mode = ""
    vehicle.faults.deaf = True
    assert set_mode(pilot, *mode) is None
    vehicle.faults.mute = True
    assert pilot.run(5) == []


def test_nan_attitude_is_told_in_both_messages() -> None:
    pilot = Pilot(px4())
    pilot.vehicles[0].faults.nan_attitude = True
    pilot.run(3)
    assert pilot.last("ATTITUDE").roll != pilot.last("ATTITUDE").roll
    pilot.command(mav.MAV_CMD_REQUEST_MESSAGE, 31)
    assert pilot.last("ATTITUDE_QUATERNION").q1 != pilot.last("ATTITUDE_QUATERNION").q1
