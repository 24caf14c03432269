"""Attitude and thrust for a rigid body, from what the autopilot's own controllers want.

    setpoint ─> trajectory within the limits (`kinematics`) ──pos, vel, acc──> P ─> PI ─> attitude, thrust
    target of SET_POSITION_TARGET_* ─> `position_control` ──acc──> attitude, thrust

The trajectory of a goto, a take-off or a landing is shaped first and tracked then (PX4's position smoothing,
ArduPilot's input shaping), so that a far goto neither saturates nor overshoots. It waits for a body that cannot
keep up.
"""

from __future__ import annotations

from math import atan2, cos, hypot, inf, radians, sin, tan

from skygcs.core.geo import quaternion_from_euler, quaternion_product
from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, AttitudeSetpoint, Body, Quaternion, turned_by
from skygcs.sim.kinematics import Limits, Motion, Setpoint
from skygcs.sim.position_control import bounded_length

POSITION_XY_PER_S = 1.0
POSITION_Z_PER_S = 1.5
"""Velocity per metre behind the trajectory (PX4's MPC_XY_P 0.95 and MPC_Z_P 1.0, ArduCopter's PSC_POSZ_P 1.0)."""

VELOCITY_XY_PER_S = 2.0
VELOCITY_Z_PER_S = 4.0
"""Acceleration per m/s behind (ArduCopter's PSC_VELXY_P 2.0, PX4's MPC_Z_VEL_P_ACC 4.0)."""

INTEGRAL_XY_PER_S2 = 1.0
INTEGRAL_Z_PER_S2 = 2.0
"""ArduCopter's PSC_VELXY_I 1.0, PX4's MPC_Z_VEL_I_ACC 2.0."""

INTEGRAL_HOVER_PER_S = 2.0
"""ArduCopter's PSC_ACCZ_I 1.0 over a hover thrust of 0.45; PX4's estimator is about as fast."""

INTEGRAL_MAX_MPS2 = 5.0
"""Drag at 12 m/s of wind; vertically a battery at half its nominal thrust."""

WIND_AVERAGE_S = 2.0
"""Over which the push of a position target's controller is averaged: longer than a turn, shorter than the wind."""

TILT_MAX_RAD = radians(35)
"""ArduCopter's ANGLE_MAX is 30 to 45 degrees, PX4's MPC_TILTMAX_AIR 45."""

LEASH_XY_M = 2.0
LEASH_Z_M = 1.0
"""The trajectory runs no farther ahead of the body than this."""

IDLE_THRUST = 0.08
"""Propellers turn, nothing lifts."""

LEAST_THRUST = 0.12
"""In the air: below it the attitude loop has no authority (PX4's MPC_THR_MIN)."""

MOST_THRUST = 1.0

LEAST_UPRIGHT = 0.5
"""Thrust makes up for a lean up to 60 degrees (ArduPilot's get_throttle_boosted)."""


class Steering:
    """State that the autopilot remembers from tick to tick: where its trajectory is, and the integrals (ENU, m/s²)."""

    __slots__ = ("_asked", "_attitude_lag_s", "_hover_thrust", "_integral", "_trajectory", "_turned")

    def __init__(self, hover_thrust: float, attitude_lag_s: float = 0.0) -> None:
        self._hover_thrust = hover_thrust
        self._attitude_lag_s = attitude_lag_s
        self._trajectory: Motion | None = None
        self._asked: AttitudeSetpoint | None = None
        self._turned: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self._integral = [0.0, 0.0, 0.0]

    def restart(self) -> None:
        """Forget everything: the motors stopped."""
        self._trajectory = None
        self._integral = [0.0, 0.0, 0.0]

    def step(
        self, body: Body, dt_s: float, setpoint: Setpoint | AttitudeSetpoint | AccelerationSetpoint, limits: Limits
    ) -> tuple[Quaternion, float]:
        """Attitude (NED/FRD) and thrust for the next ``dt_s``."""
        if isinstance(setpoint, AccelerationSetpoint):
            return self._accelerate(body, dt_s, setpoint)
        level = quaternion_from_euler(0.0, 0.0, body.yaw_rad)
        if isinstance(setpoint, AttitudeSetpoint):
            attitude = self._attitude(setpoint, dt_s) or level
            if setpoint.thrust is None:
                return attitude, self._climb(body, dt_s, setpoint.climb_mps, limits)
            self._trajectory = None
            return attitude, setpoint.thrust
        path = self._go_on(body, dt_s, setpoint, limits)
        if path is None:
            return level, IDLE_THRUST
        east, _, up = setpoint.pos_enu_m
        if east is None:
            path.east_m, path.north_m = body.east_m, body.north_m
        if up is None:
            path.up_m = body.up_m
        lift = GRAVITY_MPS2 + self._vertical(body, path, dt_s)
        accel_e, accel_n = self._horizontal(body, path, lift, dt_s)
        return self._lean(accel_e, accel_n, lift, path.yaw_rad)

    def _attitude(self, setpoint: AttitudeSetpoint, dt_s: float) -> Quaternion | None:
        """Attitude extrapolated with its rates by the lag of the body (feed-forward)."""
        rates, attitude = setpoint.rates_frd_radps, setpoint.attitude_ned_frd
        if rates is None or attitude is None:
            return attitude
        roll, pitch, yaw = rates
        spin = (roll or 0.0, pitch or 0.0, yaw or 0.0)
        if setpoint.turns_on:
            before = attitude if setpoint is not self._asked else self._turned
            attitude = self._turned = quaternion_product(before, turned_by(spin, dt_s))
            self._asked = setpoint
        return quaternion_product(attitude, turned_by(spin, self._attitude_lag_s))

    def _accelerate(self, body: Body, dt_s: float, setpoint: AccelerationSetpoint) -> tuple[Quaternion, float]:
        """The lean is that of the push at hover, whatever the climb, and the thrust makes up for it (PX4's
        MPC_ACC_DECOUPLE 1; ArduPilot's accel_to_angle and angle boost). The integral learns the hover thrust that
        the battery leaves (PX4's hover thrust estimator, the I of ArduCopter's PSC_ACCZ)."""
        self._trajectory = None
        east, north, up = setpoint.acc_enu_mps2
        if body.on_ground and up <= 0.0:
            self.restart()
            return quaternion_from_euler(0.0, 0.0, body.yaw_rad), IDLE_THRUST
        lead_rad = setpoint.yaw_rate_radps * max(self._attitude_lag_s, dt_s)
        yaw = (body.yaw_rad if setpoint.yaw_rad is None else setpoint.yaw_rad) + lead_rad
        attitude, _ = self._lean(east, north, GRAVITY_MPS2, yaw)
        held = self._integral
        missing = up - body.accel_enu_mps2[2]
        if LEAST_THRUST < self._hover_thrust * (GRAVITY_MPS2 + up + held[2]) / GRAVITY_MPS2 < MOST_THRUST:
            held[2] += INTEGRAL_HOVER_PER_S * missing * dt_s
            held[2] = max(-INTEGRAL_MAX_MPS2, min(INTEGRAL_MAX_MPS2, held[2]))
        # what holds it against the wind on the average, for the trajectory that may follow
        share = dt_s / (dt_s + WIND_AVERAGE_S)
        mean_e, mean_n = held[0] + (east - held[0]) * share, held[1] + (north - held[1]) * share
        held[0], held[1] = bounded_length(mean_e, mean_n, INTEGRAL_MAX_MPS2)
        push = GRAVITY_MPS2 + up + held[2]
        boost = hypot(east, north, GRAVITY_MPS2) / GRAVITY_MPS2
        return attitude, _bounded(self._hover_thrust * push * boost / GRAVITY_MPS2)

    def _go_on(self, body: Body, dt_s: float, setpoint: Setpoint, limits: Limits) -> Motion | None:
        """The trajectory one step on; None while the ground carries a body that is not to rise."""
        if self._trajectory is None:
            self._trajectory = _begin(body)
        path = self._trajectory
        path.advance(dt_s, setpoint, limits)
        if body.on_ground and path.vel_u_mps <= 0.0:
            self.restart()
            return None
        return path

    def _climb(self, body: Body, dt_s: float, climb_mps: float, limits: Limits) -> float:
        """The thrust that climbs like this, however the body leans."""
        path = self._go_on(body, dt_s, Setpoint((None, None, None), (None, None, climb_mps)), limits)
        if path is None:
            return IDLE_THRUST
        lift = GRAVITY_MPS2 + self._vertical(body, path, dt_s)
        # all but the height goes where the attitude takes it; the trajectory follows, for when it leads again
        path.east_m, path.north_m = body.east_m, body.north_m
        path.vel_e_mps, path.vel_n_mps = body.vel_e_mps, body.vel_n_mps
        path.yaw_rad = body.yaw_rad
        upright = max(LEAST_UPRIGHT, cos(body.roll_rad) * cos(body.pitch_rad))
        return _bounded(self._hover_thrust * lift / GRAVITY_MPS2 / upright)

    def _vertical(self, body: Body, path: Motion, dt_s: float) -> float:
        behind = path.up_m - body.up_m
        if abs(behind) > LEASH_Z_M:
            behind = LEASH_Z_M if behind > 0.0 else -LEASH_Z_M
            path.up_m = body.up_m + behind
        error = path.vel_u_mps + POSITION_Z_PER_S * behind - body.vel_u_mps
        held = self._integral[2] + INTEGRAL_Z_PER_S2 * error * dt_s
        self._integral[2] = max(-INTEGRAL_MAX_MPS2, min(INTEGRAL_MAX_MPS2, held))
        accel = path.accel_enu_mps2[2] + VELOCITY_Z_PER_S * error + self._integral[2]
        return max(-0.7 * GRAVITY_MPS2, min(GRAVITY_MPS2, accel))

    def _horizontal(self, body: Body, path: Motion, lift_mps2: float, dt_s: float) -> tuple[float, float]:
        behind_e, behind_n = path.east_m - body.east_m, path.north_m - body.north_m
        behind = hypot(behind_e, behind_n)
        if behind > LEASH_XY_M:
            behind_e, behind_n = behind_e * LEASH_XY_M / behind, behind_n * LEASH_XY_M / behind
            path.east_m, path.north_m = body.east_m + behind_e, body.north_m + behind_n
        error_e = path.vel_e_mps + POSITION_XY_PER_S * behind_e - body.vel_e_mps
        error_n = path.vel_n_mps + POSITION_XY_PER_S * behind_n - body.vel_n_mps
        held = self._integral
        accel_e = path.accel_enu_mps2[0] + VELOCITY_XY_PER_S * error_e + held[0]
        accel_n = path.accel_enu_mps2[1] + VELOCITY_XY_PER_S * error_n + held[1]
        asked, most = hypot(accel_e, accel_n), lift_mps2 * tan(TILT_MAX_RAD)
        if asked > most:  # and no integration into the limit
            return accel_e * most / asked, accel_n * most / asked
        held[0] += INTEGRAL_XY_PER_S2 * error_e * dt_s
        held[1] += INTEGRAL_XY_PER_S2 * error_n * dt_s
        held[0], held[1] = bounded_length(held[0], held[1], INTEGRAL_MAX_MPS2)
        return accel_e, accel_n

    def _lean(self, accel_e: float, accel_n: float, lift_mps2: float, yaw_rad: float) -> tuple[Quaternion, float]:
        """The attitude whose up axis lies along this push, the nose at the yaw, and the thrust that makes it."""
        ahead = accel_n * cos(yaw_rad) + accel_e * sin(yaw_rad)
        right = accel_e * cos(yaw_rad) - accel_n * sin(yaw_rad)
        pitch = atan2(-ahead, lift_mps2)
        roll = atan2(right, hypot(ahead, lift_mps2))
        push = hypot(ahead, right, lift_mps2)
        return quaternion_from_euler(roll, pitch, yaw_rad), _bounded(self._hover_thrust * push / GRAVITY_MPS2)


def _bounded(thrust: float) -> float:
    return max(LEAST_THRUST, min(MOST_THRUST, thrust))


def _begin(body: Body) -> Motion:
    """A trajectory that goes on as the body moves."""
    path = Motion(body.yaw_rad)
    path.floor_m = -inf  # the body meets the ground, not the trajectory
    path.copy(body)
    return path
