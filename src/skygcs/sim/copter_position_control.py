"""ArduCopter's position controller as GUIDED uses it: a path within jerk and acceleration is shaped towards the target,
and followed with feed-forward.

    target ──shape──> desired pos, vel, acc ──> P ──> PID ──> acceleration       (AC_PosControl, AP_Math/control.cpp)
      └── moves on by its own velocity and acceleration until the next message (input_pos_vel_accel_xy)

Which controllers run is the sub-mode: Pos (position alone), PosVelAccel, VelAccel or Accel (mode_guided.cpp).
"""

from __future__ import annotations

from enum import Enum, auto
from math import atan2, copysign, hypot, sqrt

from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, Body
from skygcs.sim.kinematics import Limits
from skygcs.sim.position_control import (
    ControlGains,
    PositionControl,
    PositionTarget,
    bounded_length,
    filter_share,
    leaning_acceleration,
)

ERROR_HZ = 5.0
"""PSC_VELXY_FLTE, PSC_VELXY_FLTD and PSC_VELZ_FLTE: low-pass of the velocity error and of its derivative."""

INTEGRAL_MAX_MPS2 = 10.0
"""PSC_VELXY_IMAX."""

VERTICAL_ACCEL_MAX_MPS2 = 7.5
"""AC_PosControl::input_pos_vel_accel_z: downwards no more than this."""

OVERSPEED_GAIN = 2.0
"""POSCONTROL_OVERSPEED_GAIN_Z: above its climb rate it may change its speed so much faster."""

CORNER_RATIO = 1.0 / sqrt(2.0)
"""CORNER_ACCELERATION_RATIO: share of the acceleration that is kept for the way across the velocity."""

TURNS_ABOVE = 0.05
"""AC_PosControl::calculate_yaw_and_rate_yaw: faster than this share of its top speed it looks where it flies."""


class SubMode(Enum):
    """ModeGuided::SubMode, those of position targets."""

    POS = auto()
    POS_VEL_ACCEL = auto()
    VEL_ACCEL = auto()
    ACCEL = auto()


def sub_mode_of(target: PositionTarget) -> SubMode:
    """Which of them follows this target; its groups are whole."""
    if target.pos_enu_m[0] is not None:
        return SubMode.POS if target.vel_enu_mps[0] is None else SubMode.POS_VEL_ACCEL
    return SubMode.ACCEL if target.vel_enu_mps[0] is None else SubMode.VEL_ACCEL


class CopterPositionControl(PositionControl):
    """See the module. East, north, up in lists of three."""

    def __init__(self, gains: ControlGains) -> None:
        super().__init__(gains)
        self._sub_mode: SubMode | None = SubMode.POS
        self.restart()

    def restart(self, *, by_attitude: bool = False) -> None:
        if self._sub_mode is not None:
            self._forget()

    def _forget(self) -> None:
        self._sub_mode = None
        self._target: PositionTarget | None = None
        self._pos, self._vel, self._acc = [0.0] * 3, [0.0] * 3, [0.0] * 3
        """The desired path: where it is on it now."""
        self._pos_to, self._vel_to, self._acc_to = [0.0] * 3, [0.0] * 3, [0.0] * 3
        """The target, moving on between messages."""
        self._error, self._slope = [0.0] * 3, [0.0, 0.0]
        self._error_is_new = True
        self._integral = [0.0, 0.0]
        self._limit = (0.0, 0.0)
        """The requested acceleration (east, north) where it exceeded the lean's limit, else zero; the path does not run
        away into it."""
        self._behind = (0.0, 0.0)
        self._ceased = False
        self._yaw_rad: float | None = None
        self._yaw_rate_radps = 0.0
        self._looks_ahead = True

    def cease(self) -> None:
        """Nobody has renewed the target for GUID_TIMEOUT: stop where it has come to, and stop turning."""
        if not self._ceased:
            self._ceased = True
            self._vel_to, self._acc_to = [0.0] * 3, [0.0] * 3
            if not self._looks_ahead:
                self._yaw_rad, self._yaw_rate_radps = None, 0.0

    def step(self, body: Body, dt_s: float, target: PositionTarget, limits: Limits) -> AccelerationSetpoint:
        sub_mode = sub_mode_of(target)
        if sub_mode is not self._sub_mode:
            self._begin(body, sub_mode)
        if target is not self._target:
            self._take(target)
        self._shape_horizontal(dt_s, limits)
        self._shape_vertical(dt_s, limits)
        if sub_mode is not SubMode.POS:
            self._move_target(dt_s)
        east, north = self._horizontal(body, dt_s, limits)
        yaw, rate = self._heading(dt_s, limits)
        return AccelerationSetpoint((east, north, self._vertical(body, dt_s, limits)), yaw, rate)

    def _begin(self, body: Body, sub_mode: SubMode) -> None:
        """ModeGuided::pva_control_start: from where it is and as it moves, with the integral that its lean shows."""
        self._forget()
        self._sub_mode = sub_mode
        self._pos = [body.east_m, body.north_m, body.up_m]
        self._vel = [body.vel_e_mps, body.vel_n_mps, body.vel_u_mps]
        self._integral = list(leaning_acceleration(body))

    def _take(self, target: PositionTarget) -> None:
        self._target, self._ceased = target, False
        self._pos_to = [value or 0.0 for value in target.pos_enu_m]
        self._vel_to = [value or 0.0 for value in target.vel_enu_mps]
        self._acc_to = [value or 0.0 for value in target.acc_enu_mps2]
        self._yaw_rad, self._yaw_rate_radps = target.yaw_rad, target.yaw_rate_radps or 0.0
        self._looks_ahead = target.yaw_rad is None and target.yaw_rate_radps is None

    # -- the path

    def _shape_horizontal(self, dt_s: float, limits: Limits) -> None:
        """Move on along the path, and bend it towards the target."""
        # steps of position and velocity
        pos, vel, acc, limit = self._pos, self._vel, self._acc, self._limit
        step_e, step_n = vel[0] * dt_s + acc[0] * dt_s**2 / 2, vel[1] * dt_s + acc[1] * dt_s**2 / 2
        gain_e, gain_n = acc[0] * dt_s, acc[1] * dt_s
        # at the lean's limit the path does not move on in the limited direction
        if limit != (0.0, 0.0):
            le, ln = limit
            if step_e * le + step_n * ln > 0.0 and self._behind[0] * le + self._behind[1] * ln > 0.0:
                step_e = step_n = 0.0
            error = self._error[0] * le + self._error[1] * ln
            if gain_e * le + gain_n * ln > 0.0 and error > 0.0 and vel[0] * le + vel[1] * ln >= 0.0:
                gain_e = gain_n = 0.0
        # move on
        pos[0] += step_e
        pos[1] += step_n
        vel[0] += gain_e
        vel[1] += gain_n
        # wanted acceleration: towards the target position and velocity
        jerk, most = self.gains.jerk_xy_mps3, limits.accel_mps2
        want = (self._acc_to[0], self._acc_to[1])
        if self._sub_mode is not SubMode.ACCEL or self._ceased:
            vel_e, vel_n = self._vel_to[0], self._vel_to[1]
            if self._sub_mode in (SubMode.POS, SubMode.POS_VEL_ACCEL):
                to_e, to_n = self._pos_to[0] - pos[0], self._pos_to[1] - pos[1]
                distance = hypot(to_e, to_n)
                if distance > 0.0:
                    speed = approach(distance, 0.5 * jerk / most, 0.5 * most, dt_s)
                    speed = min(speed, self._top_speed(limits))
                    vel_e, vel_n = vel_e + to_e * speed / distance, vel_n + to_n * speed / distance
            want = _corrected((vel_e, vel_n), (vel[0], vel[1]), most, jerk, dt_s)
            want = want[0] + self._acc_to[0], want[1] + self._acc_to[1]
        # approach it with limited jerk
        delta_e, delta_n = bounded_length(want[0] - acc[0], want[1] - acc[1], jerk * dt_s)
        acc[0] += delta_e
        acc[1] += delta_n

    def _top_speed(self, limits: Limits) -> float:
        """On the straight way to a position alone, neither part faster than its own limit (kinematic_limit)."""
        if self._sub_mode is not SubMode.POS:
            return limits.speed_mps
        return self._straight(limits)[0]

    def _straight(self, limits: Limits) -> tuple[float, float]:
        """(across, up or down) m/s on the straight way to the position."""
        across = hypot(self._pos_to[0] - self._pos[0], self._pos_to[1] - self._pos[1])
        rise = self._pos_to[2] - self._pos[2]
        way = hypot(across, rise)
        if way <= 0.0:
            return 0.0, 0.0
        vertical = limits.climb_mps if rise > 0.0 else limits.descent_mps
        speed = min(
            limits.speed_mps * way / across if across > 0.0 else vertical,
            vertical * way / abs(rise) if rise != 0.0 else limits.speed_mps,
        )
        return speed * across / way, speed * abs(rise) / way

    def _shape_vertical(self, dt_s: float, limits: Limits) -> None:
        pos, vel, acc, jerk = self._pos, self._vel, self._acc, self.gains.jerk_z_mps3
        pos[2] += vel[2] * dt_s + acc[2] * dt_s**2 / 2
        vel[2] += acc[2] * dt_s
        top = limits.climb_mps if vel[2] > 0.0 else limits.descent_mps
        over = max(1.0, OVERSPEED_GAIN * abs(vel[2]) / top) if abs(vel[2]) > top else 1.0
        most, jerk = limits.climb_accel_mps2 * over, jerk * over
        down_most = min(most, VERTICAL_ACCEL_MAX_MPS2)
        want = self._acc_to[2]
        if self._sub_mode is not SubMode.ACCEL or self._ceased:
            speed = self._vel_to[2]
            if self._sub_mode in (SubMode.POS, SubMode.POS_VEL_ACCEL):
                to_go = self._pos_to[2] - pos[2]
                braking = down_most if to_go > 0.0 else most
                rise = copysign(approach(abs(to_go), 0.5 * jerk / braking, 0.5 * braking, dt_s), to_go)
                fastest = (limits.climb_mps, limits.descent_mps)
                if self._sub_mode is SubMode.POS:
                    fastest = (self._straight(limits)[1],) * 2
                speed += max(-fastest[1], min(fastest[0], rise))
            error = speed - vel[2]
            change = copysign(approach(abs(error), jerk / (most if error > 0.0 else down_most), jerk, dt_s), error)
            want += max(-down_most, min(most, change))
        acc[2] += max(-jerk * dt_s, min(jerk * dt_s, want - acc[2]))

    def _move_target(self, dt_s: float) -> None:
        for i in range(3):
            self._pos_to[i] += self._vel_to[i] * dt_s + self._acc_to[i] * dt_s**2 / 2
            if self._sub_mode is not SubMode.ACCEL:
                self._vel_to[i] += self._acc_to[i] * dt_s

    # -- the controllers

    def _horizontal(self, body: Body, dt_s: float, limits: Limits) -> tuple[float, float]:
        """AC_PosControl::update_xy_controller."""
        gains, pos, vel = self.gains, self._pos, self._vel
        here, there = (body.east_m, body.north_m), (body.vel_e_mps, body.vel_n_mps)
        behind = bounded_length(pos[0] - here[0], pos[1] - here[1], _leash(limits, gains))
        self._pos[0], self._pos[1] = here[0] + behind[0], here[1] + behind[1]
        self._behind = behind
        distance = hypot(*behind)
        faster = approach(distance, gains.xy_p, limits.accel_mps2) / distance if distance > 0.0 else 0.0
        want = (vel[0] + behind[0] * faster, vel[1] + behind[1] * faster)
        self._filter(0, want[0] - there[0], dt_s)
        self._filter(1, want[1] - there[1], dt_s)
        self._integrate(dt_s)
        accel = [
            self._acc[i] + gains.xy_vel_p * self._error[i] + self._integral[i] + gains.xy_vel_d * self._slope[i]
            for i in range(2)
        ]
        east, north = across_first((vel[0], vel[1]), (accel[0], accel[1]), gains.accel_max_mps2)
        limited = hypot(accel[0], accel[1]) > gains.accel_max_mps2
        self._limit = (accel[0], accel[1]) if limited else (0.0, 0.0)
        return east, north

    def _filter(self, axis: int, error: float, dt_s: float) -> None:
        """AC_PID_2D::update_all: the error and its derivative, low-passed."""
        if self._error_is_new:
            self._error[axis] = error
            self._error_is_new = axis == 0  # both axes begin with what they see first
            return
        share = filter_share(dt_s, ERROR_HZ)
        before = self._error[axis]
        self._error[axis] += (error - before) * share
        self._slope[axis] += ((self._error[axis] - before) / dt_s - self._slope[axis]) * share

    def _integrate(self, dt_s: float) -> None:
        """AC_PID_2D::update_i: no longer in the direction of a limit."""
        before = hypot(*self._integral)
        gain = self.gains.xy_vel_i * dt_s
        add_e, add_n = self._error[0] * gain, self._error[1] * gain
        east, north = self._integral[0] + add_e, self._integral[1] + add_n
        if add_e * self._limit[0] + add_n * self._limit[1] > 0.0:
            east, north = bounded_length(east, north, before)
        self._integral = list(bounded_length(east, north, INTEGRAL_MAX_MPS2))

    def _vertical(self, body: Body, dt_s: float, limits: Limits) -> float:
        """AC_PosControl::update_z_controller, down to the acceleration that its last loop controls."""
        gains = self.gains
        behind = self._pos[2] - body.up_m
        want = self._vel[2] + copysign(approach(abs(behind), gains.z_p, limits.climb_accel_mps2), behind)
        error = want - body.vel_u_mps
        self._error[2] += (error - self._error[2]) * filter_share(dt_s, ERROR_HZ)
        accel = self._acc[2] + gains.z_vel_p * self._error[2]
        return max(-GRAVITY_MPS2, min(GRAVITY_MPS2, accel))

    def _heading(self, dt_s: float, limits: Limits) -> tuple[float | None, float]:
        """Mode::AutoYaw: the angle that was asked for turns on with the rate; without either it looks ahead."""
        if not self._looks_ahead:
            if self._yaw_rad is not None:
                self._yaw_rad += self._yaw_rate_radps * dt_s
            return self._yaw_rad, self._yaw_rate_radps
        (east, north, _), (acc_e, acc_n, _) = self._vel, self._acc
        speed = hypot(east, north)
        if speed <= TURNS_ABOVE * limits.speed_mps:
            return None, 0.0
        return atan2(east, north), (acc_e * north - acc_n * east) / (speed * speed)


def approach(error: float, p: float, accel: float, dt_s: float = 0.0) -> float:
    """sqrt_controller of an error >= 0: P close by, farther away what can still be braked with ``accel``."""
    near = accel / (p * p)
    rate = sqrt(2.0 * accel * (error - near / 2.0)) if error > near else error * p
    return min(rate, error / dt_s) if dt_s > 0.0 else rate


def _leash(limits: Limits, gains: ControlGains) -> float:
    """AC_P_2D::set_limits: inv_sqrt_controller of the top speed; the path runs no farther ahead."""
    p, accel, speed = gains.xy_p, limits.accel_mps2, limits.speed_mps
    return speed / p if speed < accel / p else accel / (p * p) / 2.0 + speed * speed / (2.0 * accel)


def _corrected(
    wanted: tuple[float, float], vel: tuple[float, float], most: float, jerk: float, dt_s: float
) -> tuple[float, float]:
    """shape_vel_accel_xy: the acceleration towards a velocity, with a share kept for the way across it."""
    east, north = wanted[0] - vel[0], wanted[1] - vel[1]
    error = hypot(east, north)
    if error <= 0.0:
        return 0.0, 0.0
    size = approach(error, jerk / most, jerk, dt_s)
    east, north = east * size / error, north * size / error
    speed = hypot(*wanted)
    if speed <= 0.0:
        return bounded_length(east, north, most)
    unit_e, unit_n = wanted[0] / speed, wanted[1] / speed
    along = east * unit_e + north * unit_n
    across = (east - unit_e * along, north - unit_n * along)
    if along * along <= across[0] ** 2 + across[1] ** 2:
        return bounded_length(east, north, most)
    across = bounded_length(*across, CORNER_RATIO * most)
    left = sqrt(most * most - across[0] ** 2 - across[1] ** 2)
    along = max(-left, min(left, along))
    return across[0] + unit_e * along, across[1] + unit_n * along


def across_first(vel: tuple[float, float], accel: tuple[float, float], most: float) -> tuple[float, float]:
    """limit_accel_xy: at most so much, and rather across the velocity than along it."""
    speed = hypot(*vel)
    if hypot(*accel) <= most or speed <= 0.0:
        return bounded_length(*accel, most)
    unit_e, unit_n = vel[0] / speed, vel[1] / speed
    along = accel[0] * unit_e + accel[1] * unit_n
    across = (accel[0] - unit_e * along, accel[1] - unit_n * along)
    if hypot(*across) >= most:
        return bounded_length(*across, most)
    left = sqrt(most * most - across[0] ** 2 - across[1] ** 2)
    along = max(-left, min(left, along))
    return across[0] + unit_e * along, across[1] + unit_n * along
