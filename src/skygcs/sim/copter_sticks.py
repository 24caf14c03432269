"""ArduCopter's modes for sticks, of a vehicle whose sticks nobody holds.

    modes                              no receiver was ever seen     a transmitter lies there with its throttle down
    --------------------------------   ---------------------------   -----------------------------------------------
    STABILIZE, ACRO, DRIFT             motors at idle: it falls      the same
    ALT_HOLD, SPORT, GUIDED_NOGPS      level, height kept            level, sinks at PILOT_SPEED_UP (GUIDED_NOGPS: kept)
    LOITER, POSHOLD, ZIGZAG            stays                         stays over ground, sinks at PILOT_SPEED_UP

ArduCopter 4.6 and 4.7: Copter::get_pilot_desired_climb_rate is 0 in the radio failsafe and before any input was seen,
else that of the stick, down to PILOT_SPEED_DN (0: PILOT_SPEED_UP, 2.5 m/s); Mode::get_pilot_desired_throttle takes the
stick as it is, 0 before any input; ModeStabilize::run idles the motors at throttle 0. SITL's simulated receiver is the
right column.
"""

from __future__ import annotations

from skygcs.sim.body import AttitudeSetpoint
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.legs import Follow, GoTo, Land
from skygcs.sim.steering import IDLE_THRUST
from skygcs.sim.vehicle_state import VehicleState

FALLS = frozenset({CopterMode.STABILIZE, CopterMode.ACRO, CopterMode.DRIFT})
LEVEL = frozenset({CopterMode.ALT_HOLD, CopterMode.SPORT, CopterMode.GUIDED_NOGPS})
STAYS = frozenset({CopterMode.LOITER, CopterMode.POSHOLD, CopterMode.ZIGZAG})

PILOT_SPEED_MPS = 2.5
"""ArduCopter/config.h: PILOT_VELZ_MAX, the default of PILOT_SPEED_UP."""

ANY_HEIGHT_M = 1e9


def descent_mps(mode: int) -> float | None:
    """Fastest descent in a mode in which the stick commands a climb rate; None: other modes."""
    return PILOT_SPEED_MPS if mode in LEVEL or mode in STAYS else None


def begin(v: VehicleState, mode: CopterMode) -> bool:
    """Begin what a flying vehicle does in this mode; False if the table does not have it."""
    sinks = v.faults.throttle_down and mode != CopterMode.GUIDED_NOGPS
    if mode in FALLS:
        v.plan.fly(Follow(AttitudeSetpoint(None, thrust=IDLE_THRUST)))
    elif mode in LEVEL:
        v.plan.fly(Follow(AttitudeSetpoint(None, climb_mps=-PILOT_SPEED_MPS if sinks else 0.0)))
    elif mode in STAYS and sinks:
        v.hold_here()
        leg = v.plan.leg
        assert isinstance(leg, GoTo)
        speed = PILOT_SPEED_MPS
        v.plan.fly(Land(leg.east_m, leg.north_m, speed, fast_above_m=ANY_HEIGHT_M, slow_below_m=-ANY_HEIGHT_M))
    else:
        return False
    return True
