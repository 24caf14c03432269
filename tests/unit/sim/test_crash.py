"""A vehicle that meets the ground too fast lies on its side and stays there; what each firmware makes of it."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.vehicle.orders import todo_for
from skygcs.sim.conditions import Conditions, Dynamics
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle import SimVehicle
from support.sim_pilot import FIELD, Pilot, copter, px4, sim_dialect

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
