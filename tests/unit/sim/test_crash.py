"""A vehicle that meets the ground too fast lies on its side and stays there; what each firmware makes of it."""

from __future__ import annotations

from math import hypot

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.vehicle.orders import todo_for
from skygcs.sim.conditions import Conditions, Dynamics
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import make_vehicles
from support.sim_pilot import FIELD, Pilot, copter, px4, sim_dialect
from support.table import each

FORCE = 21196
BOTH = pytest.mark.parametrize("make", [px4, copter])
NO_THRUST = mav.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0.0)


def falling(vehicle: SimVehicle, seconds: float) -> Pilot:
    """From 14 m, armed, under setpoints without thrust."""
    vehicle.params.set("GUID_OPTIONS", 8)
    pilot = Pilot(vehicle)
    pilot.hovering(14.0)
    pilot.send(NO_THRUST)
    pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, *((6, 0) if vehicle.autopilot == mav.MAV_AUTOPILOT_PX4 else (4, 0)))
    for _ in range(round(seconds / 0.1)):
        pilot.send(NO_THRUST)
        pilot.run(0.1)
    return pilot


@BOTH
def test_killed_at_14_m_it_crashes_and_neither_arms_nor_lifts_again(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.hovering(14.0)
    vehicle = pilot.vehicles[0]
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, FORCE) == mav.MAV_RESULT_ACCEPTED
    pilot.run(8)
    assert vehicle.motion.on_ground and vehicle.motion.crashed and vehicle.landed
    assert not pilot.last("HEARTBEAT").base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED
    assert pilot.last("EXTENDED_SYS_STATE").landed_state == mav.MAV_LANDED_STATE_ON_GROUND
    assert abs(pilot.last("ATTITUDE").roll) == pytest.approx(1.57, abs=0.01)
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) != mav.MAV_RESULT_ACCEPTED
    assert ("Preflight Fail: Attitude failure (roll)" if make is px4 else "Arm: Leaning") in pilot.texts()
    if make is copter:  # by force it arms: nothing lifts it
        assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, FORCE) == mav.MAV_RESULT_ACCEPTED
        pilot.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10)
        pilot.run(6)
    assert vehicle.motion.up_m == 0.0


def test_an_arducopter_that_has_crashed_disarms_itself_after_two_seconds() -> None:
    """crash_check.cpp: lean over 15 degrees, 30 degrees from what it wants, less than 3 m/s2, for 2 s."""
    vehicle = copter()
    pilot = falling(vehicle, 1.0)
    hit = pilot.now
    while not vehicle.motion.crashed:
        assert pilot.now < hit + 3
        pilot.send(NO_THRUST)
        pilot.run(0.1)
    hit = pilot.now
    pilot.run(1.7)
    assert vehicle.armed and not vehicle.landed
    pilot.run(0.6)
    assert not vehicle.armed and vehicle.landed
    (text,) = [t for t in pilot.texts() if t.startswith("Crash")]
    assert text.startswith("Crash: Disarming: AngErr=90>30")


def test_a_px4_that_has_crashed_takes_it_for_a_landing() -> None:
    """failsafe.cpp with CBRK_FLIGHTTERM 121212: its failure detector warns; the land detector looks at no attitude."""
    vehicle = px4()
    pilot = falling(vehicle, 3.5)
    assert vehicle.motion.crashed and vehicle.armed
    pilot.run(10)
    assert not vehicle.armed and "Disarmed by landing" in pilot.texts()
    assert vehicle.motion.up_m == 0.0


@BOTH
def test_a_landing_is_no_crash(make: type[SimVehicle]) -> None:
    pilot = Pilot(make())
    pilot.hovering(14.0)
    pilot.command(mav.MAV_CMD_NAV_LAND)
    pilot.run(50)
    vehicle = pilot.vehicles[0]
    assert not vehicle.armed and vehicle.landed and not vehicle.motion.crashed
    assert vehicle.motion.lean_deg == pytest.approx(0.0, abs=0.1)


def test_without_forces_it_crashes_too() -> None:
    vehicle = type(px4())(sim_dialect(), 1, FIELD, rng=Rng(1), conditions=Conditions(dynamics=Dynamics.KINEMATIC))
    pilot = Pilot(vehicle)
    pilot.hovering(14.0)
    pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, FORCE)
    pilot.run(6)
    assert vehicle.motion.on_ground and vehicle.motion.crashed


@BOTH
def test_one_that_has_crashed_is_set_up_by_a_restart_and_flies_again(make: type[SimVehicle]) -> None:
    """It said "Arm: Leaning" for ever, and nothing cured it."""
    vehicle = make()
    pilot = falling(vehicle, 3.5)
    pilot.run(10)
    assert vehicle.motion.crashed and not vehicle.armed
    assert pilot.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) != mav.MAV_RESULT_ACCEPTED
    todo = todo_for(pilot.texts(), "alpha")
    assert todo is not None and "skygcs-cli reboot alpha" in todo
    assert pilot.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == mav.MAV_RESULT_ACCEPTED
    assert not vehicle.motion.crashed
    pilot.run(40)
    pilot.hovering(14.0)
    assert vehicle.armed and vehicle.motion.up_m > 10.0


# -- A simulated ArduCopter in a mode for sticks that nobody holds does what Copter::get_pilot_desired_climb_rate and
# Mode::get_pilot_desired_throttle of 4.6 and 4.7 say: it falls, sinks, drifts or stays.


HEIGHT_M = 20.0


def flown(mode: CopterMode, *, throttle_down: bool, seconds: float) -> tuple[float, float]:
    """How far it sank, and drifted with 5 m/s of wind."""
    (vehicle,) = make_vehicles(
        sim_dialect(),
        px4=0,
        ardupilot=1,
        first_sysid=1,
        home=FIELD,
        conditions=Conditions(wind_enu_mps=(5.0, 0.0, 0.0)),
    )
    pilot = Pilot(vehicle)
    pilot.hovering(HEIGHT_M)
    pilot.run(10)
    vehicle.faults.throttle_down = throttle_down
    began = vehicle.motion.pos_enu_m
    assert pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, mode) == mav.MAV_RESULT_ACCEPTED
    pilot.run(seconds)
    now = vehicle.motion.pos_enu_m
    return began[2] - now[2], hypot(now[0] - began[0], now[1] - began[1])


@each(
    ("mode", "throttle_down", "sinks_m", "drifts"),
    [
        (CopterMode.STABILIZE, False, (8.0, HEIGHT_M), False),
        (CopterMode.ACRO, True, (8.0, HEIGHT_M), False),
        (CopterMode.ALT_HOLD, False, (-0.5, 0.5), True),
        (CopterMode.ALT_HOLD, True, (4.0, 8.5), True),
        (CopterMode.GUIDED_NOGPS, True, (-0.5, 0.5), True),
        (CopterMode.LOITER, False, (-0.5, 0.5), False),
        (CopterMode.LOITER, True, (4.0, 8.5), False),
    ],
)
def test_without_hands_on_the_sticks(
    mode: CopterMode, throttle_down: bool, sinks_m: tuple[float, float], drifts: bool
) -> None:
    sank_m, drifted_m = flown(mode, throttle_down=throttle_down, seconds=3.0)
    assert sinks_m[0] <= sank_m <= sinks_m[1], (sank_m, drifted_m)
    if mode not in (CopterMode.STABILIZE, CopterMode.ACRO):  # a falling one drifts as it likes
        assert (drifted_m > 1.0) is drifts, (sank_m, drifted_m)


def test_on_the_ground_nothing_moves() -> None:
    vehicle = copter()
    pilot = Pilot(vehicle)
    pilot.get_ready()
    for mode in (CopterMode.ALT_HOLD, CopterMode.STABILIZE):
        pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, mode)
        pilot.run(1)
        assert abs(vehicle.motion.up_m) < 0.1
