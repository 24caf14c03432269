"""Bodies that go only where their noses point: a fixed wing and a rover. Kinematic, without wind.

    wing     an airspeed within limits, turns with a limited bank, a climb within limits. It cannot stop in the air: it
             flies past a place, or round it. Stall is not modelled: below the stall speed it
             only sinks or rolls.
    rover    planar; its turns are limited by its smallest circle and by the acceleration to the side. It stops.

ENU metres about the point where the vehicle was first powered; the ground is flat, up 0.
"""

from __future__ import annotations

from math import atan, atan2, copysign, cos, hypot, pi, radians, sin, tan

from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, AttitudeSetpoint, Body, wrap_pi
from skygcs.sim.kinematics import CourseSetpoint, Limits, Setpoint, approach_speed

SPEED_UP_MPS2 = 3.0
"""A foam plane on its wheels: 15 m/s after 5 s."""
ROLL_OUT_MPS2 = 3.0

LIFT_SPEED_SHARE = 0.75
"""Share of its cruise at which it leaves the ground (ArduPlane: AIRSPEED_MIN 9 of 12 m/s)."""

CLIMB_GAIN_PER_S = 0.5
CLIMB_MPS2 = 2.0
COURSE_GAIN_PER_S = 1.5
FIELD_GAIN = 3.0
"""Gain of the turn onto a circle: atan(gain · distance from it / radius), a vector field (Nelson et al., 2007)."""

GLIDE_SINK_MPS = 1.5
"""Without its motor: a foam plane glides 1:8 at 12 m/s."""

TOUCH_SINK_MPS = 0.5
GLIDE_SLOPE = 0.12
"""Height over distance of a landing: ArduPlane's and PX4's are 5 to 7 degrees."""

BANK_LAG_S = 0.4


def turn_limit_radps(speed_mps: float, bank_rad: float) -> float:
    """The fastest level turn at a speed with this bank."""
    return GRAVITY_MPS2 * tan(bank_rad) / max(1.0, speed_mps)


class Wing(Body):
    """A fixed wing. ``Limits.speed_mps`` is its airspeed, ``yaw_rate_radps`` its fastest turn."""

    __slots__ = ()

    def step(
        self, dt_s: float, setpoint: Setpoint | AttitudeSetpoint | AccelerationSetpoint | None, limits: Limits
    ) -> None:
        """Move on by ``dt_s``; without a setpoint its motor stands still."""
        before = (self.vel_e_mps, self.vel_n_mps, self.vel_u_mps)
        speed, grounded = self.groundspeed_mps, self.on_ground
        # how fast, where to, how high
        if not isinstance(setpoint, CourseSetpoint) or self.crashed:
            if grounded:
                self._roll_out(dt_s)
                return
            speed, turn, climb = max(speed, LIFT_SPEED_SHARE * limits.speed_mps), 0.0, -GLIDE_SINK_MPS
        else:
            if grounded and setpoint.lands:
                self._roll_out(dt_s)
                return
            speed = min(limits.speed_mps, speed + SPEED_UP_MPS2 * dt_s)
            lifts = speed >= LIFT_SPEED_SHARE * limits.speed_mps
            turn = 0.0 if grounded else self._turn(setpoint, limits, speed)
            climb = self._climb(setpoint, limits, speed) if lifts else 0.0
        most = CLIMB_MPS2 * dt_s
        self.vel_u_mps += max(-most, min(most, climb - self.vel_u_mps))
        # where that leads
        self.yaw_rate_radps = turn
        self.yaw_rad = wrap_pi(self.yaw_rad + turn * dt_s)
        self.vel_e_mps, self.vel_n_mps = speed * sin(self.yaw_rad), speed * cos(self.yaw_rad)
        self.east_m += self.vel_e_mps * dt_s
        self.north_m += self.vel_n_mps * dt_s
        self.up_m += self.vel_u_mps * dt_s
        if self.up_m <= 0.0:
            self.up_m, self.vel_u_mps = 0.0, max(0.0, self.vel_u_mps)
        after = (self.vel_e_mps, self.vel_n_mps, self.vel_u_mps)
        east, north, up = ((b - a) / dt_s for a, b in zip(before, after, strict=True))
        self.accel_enu_mps2 = (east, north, up)
        blend = min(1.0, dt_s / BANK_LAG_S)
        bank = atan(speed * turn / GRAVITY_MPS2) if self.up_m > 0.0 else 0.0
        self.roll_rad += (bank - self.roll_rad) * blend
        self.pitch_rad += (atan2(self.vel_u_mps, max(1.0, speed)) - self.pitch_rad) * blend

    def _roll_out(self, dt_s: float) -> None:
        speed = max(0.0, self.groundspeed_mps - ROLL_OUT_MPS2 * dt_s)
        if speed == 0.0:
            self.yaw_rate_radps = 0.0
            self.rest()
            return
        self.vel_e_mps, self.vel_n_mps, self.vel_u_mps = speed * sin(self.yaw_rad), speed * cos(self.yaw_rad), 0.0
        self.east_m += self.vel_e_mps * dt_s
        self.north_m += self.vel_n_mps * dt_s

    def _turn(self, setpoint: CourseSetpoint, limits: Limits, speed: float) -> float:
        """The turn to the course that the setpoint wants (compass, positive clockwise)."""
        most, ahead = limits.yaw_rate_radps, 0.0
        east, north, _ = setpoint.pos_enu_m
        if east is None or north is None:
            course = self.yaw_rad if setpoint.yaw_rad is None else setpoint.yaw_rad
        elif setpoint.circle_m:
            radius, side = abs(setpoint.circle_m), copysign(1.0, setpoint.circle_m)
            from_middle_e, from_middle_n = self.east_m - east, self.north_m - north
            off = hypot(from_middle_e, from_middle_n) - radius
            outward = atan2(from_middle_e, from_middle_n)
            course = outward + side * (pi / 2 + atan(FIELD_GAIN * off / radius))
            ahead = side * speed / radius if abs(off) < radius / 2 else 0.0
        else:
            course = atan2(east - self.east_m, north - self.north_m)
        return max(-most, min(most, ahead + COURSE_GAIN_PER_S * wrap_pi(course - self.yaw_rad)))

    def _climb(self, setpoint: CourseSetpoint, limits: Limits, speed: float) -> float:
        east, north, up = setpoint.pos_enu_m
        if setpoint.lands and east is not None and north is not None:
            left_m = hypot(east - self.east_m, north - self.north_m)
            wanted = CLIMB_GAIN_PER_S * (left_m * GLIDE_SLOPE - self.up_m) - speed * GLIDE_SLOPE
            return max(-limits.descent_mps, min(-TOUCH_SINK_MPS, wanted)) if left_m * GLIDE_SLOPE < self.up_m else 0.0
        if up is None:
            return 0.0
        return max(-limits.descent_mps, min(limits.climb_mps, CLIMB_GAIN_PER_S * (up - self.up_m)))


SMALLEST_CIRCLE_M = 0.9
"""TURN_RADIUS (Rover/Parameters.cpp)."""

SIDE_MPS2 = 0.6 * GRAVITY_MPS2
"""ATC_TURN_MAX_G (libraries/APM_Control/AR_AttitudeControl.cpp)."""

NOWHERE = (None, None, None)

CREEP_MPS = 0.5
STEER_GAIN_PER_S = 2.0
STANDS_MPS = 0.01


class Rover(Body):
    """Wheels with a steering axle."""

    __slots__ = ()

    def step(
        self, dt_s: float, setpoint: Setpoint | AttitudeSetpoint | AccelerationSetpoint | None, limits: Limits
    ) -> None:
        """Move on by ``dt_s``; without a place to go to it brakes, as in HOLD (Rover/mode_hold.cpp)."""
        speed, most = self.groundspeed_mps, limits.accel_mps2 * dt_s
        wanted, turn = 0.0, 0.0
        east, north, _ = setpoint.pos_enu_m if isinstance(setpoint, Setpoint) else NOWHERE
        if isinstance(setpoint, Setpoint) and east is not None and north is not None:
            de, dn = east - self.east_m, north - self.north_m
            left_m, error = hypot(de, dn), wrap_pi(atan2(de, dn) - self.yaw_rad)
            wanted = self._speed(setpoint, limits, left_m, error)
            bound = min(speed / SMALLEST_CIRCLE_M, SIDE_MPS2 / max(speed, CREEP_MPS))
            turn = max(-bound, min(bound, STEER_GAIN_PER_S * error))
        changed = max(-most, min(most, wanted - speed))
        if wanted == 0.0 and speed + changed < STANDS_MPS:
            self.yaw_rate_radps = 0.0
            self.rest()
            return
        speed += changed
        before = (self.vel_e_mps, self.vel_n_mps)
        self.yaw_rate_radps, self.yaw_rad = turn, wrap_pi(self.yaw_rad + turn * dt_s)
        self.vel_e_mps, self.vel_n_mps = speed * sin(self.yaw_rad), speed * cos(self.yaw_rad)
        self.accel_enu_mps2 = ((self.vel_e_mps - before[0]) / dt_s, (self.vel_n_mps - before[1]) / dt_s, 0.0)
        self.east_m += self.vel_e_mps * dt_s
        self.north_m += self.vel_n_mps * dt_s

    @staticmethod
    def _speed(setpoint: Setpoint, limits: Limits, left_m: float, error: float) -> float:
        """Speed towards the place: reduced in a sharp turn, zero at the place."""
        reached_m = setpoint.reached_m if isinstance(setpoint, CourseSetpoint) else 0.0
        stops = not isinstance(setpoint, CourseSetpoint) or setpoint.stops
        if stops and left_m <= max(reached_m, STANDS_MPS):
            return 0.0
        turning = max(CREEP_MPS, limits.speed_mps * (1.0 - 0.5 * min(1.0, abs(error) / radians(90))))
        if not stops:
            return min(limits.speed_mps, turning)
        return max(CREEP_MPS, min(turning, approach_speed(left_m - reached_m, limits.accel_mps2, limits.speed_mps)))
