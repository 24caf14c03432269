"""A simulated ArduCopter in a mode for sticks that nobody holds does what Copter::get_pilot_desired_climb_rate and
Mode::get_pilot_desired_throttle of 4.6 and 4.7 say: it falls, sinks, drifts or stays."""

from __future__ import annotations

from math import hypot

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.conditions import Conditions
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.vehicle_group import make_vehicles
from support.sim_pilot import FIELD, Pilot, copter, sim_dialect
from support.table import each

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
