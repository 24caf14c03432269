"""How a simulated multirotor moves: it follows a setpoint within limits of speed and acceleration.

No forces, no wind: position, velocity and yaw are what a ground station sees, and they move as a well-tuned
autopilot makes them move. ENU metres about the point where the vehicle was first powered; the ground is flat, up 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import atan2, copysign, cos, hypot, inf, pi, radians, remainder, sin, sqrt

from skygcs.sim.body import GRAVITY_MPS2, AccelerationSetpoint, AttitudeSetpoint, Body, Vector, wrap_pi

POSITION_GAIN_PER_S = 1.0
"""Speed per metre of distance close to the target (PX4's MPC_XY_P 0.95, ArduCopter's PSC_POSXY_P 1.0)."""

TOP_SPEED_MPS = 30.0
SLOWEST = 0.05
"""m/s, m/s², rad/s: what a parameter of 0 comes to."""

TERMINAL_MPS = 40.0
"""A quadrotor that falls with its motors off."""

EARTH_A_M = 6378137.0
EARTH_E2 = 6.69437999014e-3
"""WGS84 (NIMA TR8350.2): semi-major axis and first eccentricity squared."""


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East and north about a point, by its radii of curvature: 8 cm off at 1 km, as the autopilots' own frames are."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float

    def to_geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """(lat_deg, lon_deg)."""
        per_east, per_north = _metres_per_degree(self.lat_deg, self.alt_amsl_m)
        return self.lat_deg + north_m / per_north, self.lon_deg + east_m / per_east

    def to_local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """(east_m, north_m)."""
        per_east, per_north = _metres_per_degree(self.lat_deg, self.alt_amsl_m)
        return remainder(lon_deg - self.lon_deg, 360) * per_east, (lat_deg - self.lat_deg) * per_north


@lru_cache(maxsize=256)
def _metres_per_degree(lat_deg: float, alt_amsl_m: float) -> tuple[float, float]:
    """Lengths of one degree of longitude and of one degree of latitude there."""
    lat = radians(lat_deg)
    w2 = 1 - EARTH_E2 * sin(lat) ** 2
    east = EARTH_A_M / sqrt(w2) + alt_amsl_m
    north = EARTH_A_M * (1 - EARTH_E2) / w2**1.5 + alt_amsl_m
    return radians(east) * max(cos(lat), 1e-6), radians(north)


@dataclass(frozen=True, slots=True)
class Home:
    """Position of the last arming, or one that a ground station has set."""

    east_m: float
    north_m: float
    up_m: float

    @property
    def pos_enu_m(self) -> Vector:
        return self.east_m, self.north_m, self.up_m


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits that the vehicle's parameters set, as far as the airframe does (`bounded_limits`)."""

    speed_mps: float
    accel_mps2: float
    climb_mps: float
    descent_mps: float
    yaw_rate_radps: float = radians(60)
    climb_accel_mps2: float = 2.5
    jerk_mps3: float = inf
    """Change of the acceleration with which it slows down towards a position; infinite: at once."""


@lru_cache(maxsize=256)
def bounded_limits(
    speed_mps: float,
    accel_mps2: float,
    climb_mps: float,
    descent_mps: float,
    yaw_rate_radps: float = radians(60),
    climb_accel_mps2: float = 2.5,
    jerk_mps3: float = inf,
) -> Limits:
    """No parameter makes it faster than the airframe, nor unable to move. A vehicle asks with each tick, for minutes
    with the same values."""
    return Limits(
        min(max(speed_mps, SLOWEST), TOP_SPEED_MPS),
        min(max(accel_mps2, SLOWEST), GRAVITY_MPS2),
        min(max(climb_mps, SLOWEST), TOP_SPEED_MPS),
        min(max(descent_mps, SLOWEST), TOP_SPEED_MPS),
        min(max(yaw_rate_radps, SLOWEST), pi),
        min(max(climb_accel_mps2, SLOWEST), GRAVITY_MPS2),
        max(jerk_mps3, SLOWEST),
    )


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Position (``pos_enu_m``) and its velocity (``vel_enu_mps``). On an axis without a position (None) the velocity
    alone is followed; without a velocity as well the vehicle stops.

    East and north go together: both have a position or neither has. ``yaw_rad`` is ENU-independent compass yaw
    (0 north, clockwise); None keeps it, or turns with ``yaw_rate_radps``.
    """

    pos_enu_m: tuple[float | None, float | None, float | None]
    vel_enu_mps: tuple[float | None, float | None, float | None] = (None, None, None)
    yaw_rad: float | None = None
    yaw_rate_radps: float = 0.0


@dataclass(frozen=True, slots=True)
class CourseSetpoint(Setpoint):
    """Course of a vehicle that moves only along its nose. Without an east and north position: straight on, by
    ``yaw_rad``."""

    circle_m: float = 0.0
    """Radius of a circle about the place, positive clockwise; 0: straight to it."""
    stops: bool = False
    """To a stop within ``reached_m``; else past it."""
    reached_m: float = 0.0
    lands: bool = False
    """Down to the ground there."""


def approach_speed(distance_m: float, accel_mps2: float, top_mps: float, jerk_mps3: float = inf) -> float:
    """The speed from which one can still stop at the target with ``accel_mps2``, which itself changes with
    ``jerk_mps3``; proportional when close."""
    near = accel_mps2 / POSITION_GAIN_PER_S**2
    most = POSITION_GAIN_PER_S * distance_m
    if distance_m > near:
        most = sqrt(2 * accel_mps2 * (distance_m - near / 2))
    if jerk_mps3 < inf:
        # PX4's TrajectoryConstraints: computeMaxSpeedFromDistance
        b = 4 * accel_mps2 * accel_mps2 / jerk_mps3
        most = min(most, 0.5 * (sqrt(b * b + 8 * accel_mps2 * distance_m) - b))
    return min(most, top_mps)


def stopping_distance(speed_mps: float, accel_mps2: float, jerk_mps3: float, lag_s: float) -> float:
    """Stopping distance: the deceleration grows with the jerk up to its limit, and the body lags behind."""
    if speed_mps * jerk_mps3 < accel_mps2**2:  # the most is not reached
        slowing = speed_mps * sqrt(speed_mps / jerk_mps3)
    else:
        slowing = speed_mps / 2 * (speed_mps / accel_mps2 + accel_mps2 / jerk_mps3)
    return slowing + lag_s * speed_mps


class Motion(Body):
    """A vehicle that moves like this. It has no attitude to command: an `AttitudeSetpoint` lets it stop and climb."""

    __slots__ = ("floor_m",)

    def __init__(self, yaw_rad: float = 0.0) -> None:
        super().__init__(yaw_rad)
        self.floor_m = 0.0

    def step(
        self, dt_s: float, setpoint: Setpoint | AttitudeSetpoint | AccelerationSetpoint | None, limits: Limits
    ) -> None:
        """Move on by ``dt_s``. Without a setpoint the motors give no lift: it stays on the ground, or falls."""
        if self.advance(dt_s, setpoint, limits):
            self._tilt(dt_s)

    def advance(
        self, dt_s: float, setpoint: Setpoint | AttitudeSetpoint | AccelerationSetpoint | None, limits: Limits
    ) -> bool:
        """`step` without the lean, which a trajectory does not have. False: it lies on the ground."""
        # only the climb rate of an attitude counts
        if isinstance(setpoint, AttitudeSetpoint):
            setpoint = Setpoint((None, None, None), (None, None, setpoint.climb_mps))
        before = (self.vel_e_mps, self.vel_n_mps, self.vel_u_mps)
        # velocity: falling without a setpoint, else steered
        if setpoint is None or self.crashed:
            self.yaw_rate_radps = 0.0
            if self.on_ground:
                self.rest()
                return False
            self.vel_u_mps = max(self.vel_u_mps - GRAVITY_MPS2 * dt_s, -TERMINAL_MPS)
        else:
            if isinstance(setpoint, AccelerationSetpoint):
                self._accelerate(dt_s, setpoint)
            else:
                self._steer(dt_s, setpoint, limits)
            self._turn(dt_s, setpoint, limits)
        # height, down to the ground
        self.up_m += self.vel_u_mps * dt_s
        if self.up_m <= self.floor_m:
            self.up_m = self.floor_m
            if self.vel_u_mps <= 0.0:
                self.touch()
                return False
        # place and acceleration
        self.east_m += self.vel_e_mps * dt_s
        self.north_m += self.vel_n_mps * dt_s
        self.accel_enu_mps2 = (
            (self.vel_e_mps - before[0]) / dt_s,
            (self.vel_n_mps - before[1]) / dt_s,
            (self.vel_u_mps - before[2]) / dt_s,
        )
        return True

    def _steer(self, dt_s: float, setpoint: Setpoint, limits: Limits) -> None:
        east, north, up = setpoint.pos_enu_m
        want_e, want_n, want_u = (v or 0.0 for v in setpoint.vel_enu_mps)
        if east is not None and north is not None:
            de, dn = east - self.east_m, north - self.north_m
            distance = hypot(de, dn)
            speed = approach_speed(distance, limits.accel_mps2, limits.speed_mps, limits.jerk_mps3)
            if distance > 1e-9:
                want_e, want_n = want_e + de / distance * speed, want_n + dn / distance * speed
        too_fast = hypot(want_e, want_n) / limits.speed_mps
        if too_fast > 1.0:
            want_e, want_n = want_e / too_fast, want_n / too_fast
        if up is not None:
            du = up - self.up_m
            top = limits.climb_mps if du > 0 else limits.descent_mps
            want_u += copysign(approach_speed(abs(du), limits.climb_accel_mps2, top), du)
        want_u = max(-limits.descent_mps, min(limits.climb_mps, want_u))
        dve, dvn = want_e - self.vel_e_mps, want_n - self.vel_n_mps
        change, most = hypot(dve, dvn), limits.accel_mps2 * dt_s
        if change > most:
            dve, dvn = dve * most / change, dvn * most / change
        self.vel_e_mps += dve
        self.vel_n_mps += dvn
        most = limits.climb_accel_mps2 * dt_s
        self.vel_u_mps += max(-most, min(most, want_u - self.vel_u_mps))

    def _accelerate(self, dt_s: float, setpoint: AccelerationSetpoint) -> None:
        east, north, up = setpoint.acc_enu_mps2
        self.vel_e_mps += east * dt_s
        self.vel_n_mps += north * dt_s
        self.vel_u_mps += up * dt_s
        too_fast = hypot(self.vel_e_mps, self.vel_n_mps) / TOP_SPEED_MPS
        if too_fast > 1.0:
            self.vel_e_mps, self.vel_n_mps = self.vel_e_mps / too_fast, self.vel_n_mps / too_fast
        self.vel_u_mps = max(-TERMINAL_MPS, min(TOP_SPEED_MPS, self.vel_u_mps))

    def _turn(self, dt_s: float, setpoint: Setpoint | AccelerationSetpoint, limits: Limits) -> None:
        if setpoint.yaw_rad is not None:
            error = wrap_pi(setpoint.yaw_rad - self.yaw_rad)
            turn = max(-limits.yaw_rate_radps * dt_s, min(limits.yaw_rate_radps * dt_s, error))
        else:
            rate = max(-limits.yaw_rate_radps, min(limits.yaw_rate_radps, setpoint.yaw_rate_radps))
            turn = rate * dt_s
        self.yaw_rad = wrap_pi(self.yaw_rad + turn)
        self.yaw_rate_radps = turn / dt_s

    def _tilt(self, dt_s: float) -> None:
        """A multirotor leans into its acceleration; body axes FRD, so forward acceleration is nose down."""
        east, north, _ = self.accel_enu_mps2
        forward = north * cos(self.yaw_rad) + east * sin(self.yaw_rad)
        right = -north * sin(self.yaw_rad) + east * cos(self.yaw_rad)
        blend = min(1.0, dt_s / 0.15)  # attitude follows within some 0.15 s
        self.pitch_rad += (atan2(-forward, GRAVITY_MPS2) - self.pitch_rad) * blend
        self.roll_rad += (atan2(right, GRAVITY_MPS2) - self.roll_rad) * blend
