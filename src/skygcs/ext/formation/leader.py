"""The leader of a formation: a point with a heading and a scale, and the places of the members about it.

    demand      the virtual leader                                         ended by
    --------    -------------------------------------------------------    ------------------------------------
    stay        brakes and stands                                          -
    go to       flies straight to a place and stands there                 its arrival -> stay
    fly         flies with a velocity                                      ``until`` -> stay

A leader may be a vehicle instead: then its place and velocity are that vehicle's, as they are measured, and only
heading and scale are demanded. All changes are ramps: the leader's acceleration is half of the members', and it turns
and scales no faster than the outermost member can fly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from skygcs.core.plan.formations import middle_of
from skygcs.ext.formation.evasion import straight_to
from skygcs.ext.formation.separation_filter import RESPONSE_S, REST, MotionBounds, Moving, Vector, minus

ACCELERATION_SHARE = 0.5
"""The leader accelerates with this share of what members may: the rest is for keeping their places."""

SPEED_SHARE = 0.75
"""The leader flies with this share of the members' speed: a member that is behind its place can catch up."""

SWING_SHARE = 0.6
"""Turns and changes of scale move the outermost place with at most this share of the leader's largest speed."""

TURN_RADPS = math.radians(30.0)
"""A formation about its middle turns no faster than this, however small it is."""

SCALE_PER_S = 0.2

ARRIVED_M = 0.05

RESTS_MPS = 0.1


@dataclass(frozen=True, slots=True)
class Stay:
    """Brake and stand."""


@dataclass(frozen=True, slots=True)
class GoTo:
    """Fly straight to a place of the fleet's frame."""

    place_enu_m: Vector
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Fly:
    """Fly with a velocity along the fleet's axes until then."""

    vel_enu_mps: Vector
    until: float


Demand = Stay | GoTo | Fly


@dataclass(slots=True)
class Leader:
    """`step` once per period; then `places`. ``offsets_m``: of the members at scale 1 and heading 0 (along the x axis),
    x ahead, y to the left, up."""

    moving: Moving
    yaw_rad: float
    bounds: MotionBounds
    """Those of the members."""
    offsets_m: Mapping[str, Vector]
    scale: float = 1.0
    demand: Demand = field(default_factory=Stay)
    wanted_yaw_rad: float = 0.0
    wanted_scale: float = 1.0
    yaw_rate_radps: float = 0.0
    scale_per_s: float = 0.0

    def __post_init__(self) -> None:
        self.wanted_yaw_rad, self.wanted_scale = self.yaw_rad, self.scale

    @property
    def own_bounds(self) -> MotionBounds:
        """The limits of the leader's own motion."""
        bounds = self.bounds
        return replace(
            bounds,
            speed_mps=SPEED_SHARE * bounds.speed_mps,
            climb_mps=SPEED_SHARE * bounds.climb_mps,
            acc_xy_mps2=ACCELERATION_SHARE * bounds.acc_xy_mps2,
            acc_z_mps2=ACCELERATION_SHARE * bounds.acc_z_mps2,
        )

    @property
    def rests(self) -> bool:
        """True if it neither moves, turns nor scales, and has nowhere to go."""
        return (
            isinstance(self.demand, Stay)
            and math.hypot(*self.moving.vel_enu_mps) < RESTS_MPS
            and abs(math.remainder(self.wanted_yaw_rad - self.yaw_rad, math.tau)) < math.radians(1.0)
            and abs(self.wanted_scale - self.scale) < 0.01
        )

    def step(self, dt_s: float, now: float) -> None:
        """Advance a virtual leader by ``dt_s``."""
        self._turn_and_scale(dt_s)
        bounds = self.own_bounds
        if isinstance(self.demand, Fly) and now >= self.demand.until:
            self.demand = Stay()
        match self.demand:
            case Stay():
                wanted = REST
            case Fly(vel_enu_mps):
                wanted = bounds.limited_velocity(vel_enu_mps)
            case GoTo(place, speed_mps):
                slow = replace(bounds, speed_mps=min(bounds.speed_mps, speed_mps))
                wanted = straight_to(self.moving, Moving(place), slow)
                if (
                    math.dist(self.moving.pos_enu_m, place) < ARRIVED_M
                    and math.hypot(*self.moving.vel_enu_mps) < RESTS_MPS
                ):
                    self.demand = Stay()
        u, v, w = self.moving.vel_enu_mps
        a, b, c = bounds.limited_acceleration(
            ((wanted[0] - u) / RESPONSE_S, (wanted[1] - v) / RESPONSE_S, (wanted[2] - w) / RESPONSE_S)
        )
        x, y, z = self.moving.pos_enu_m
        self.moving = Moving(
            (x + (u + a * dt_s / 2) * dt_s, y + (v + b * dt_s / 2) * dt_s, z + (w + c * dt_s / 2) * dt_s),
            (u + a * dt_s, v + b * dt_s, w + c * dt_s),
        )

    def follow(self, measured: Moving, dt_s: float) -> None:
        """Take the place and velocity of the vehicle that leads."""
        self._turn_and_scale(dt_s)
        self.moving = Moving(measured.pos_enu_m, self.own_bounds.limited_velocity(measured.vel_enu_mps))

    def places(self) -> dict[str, Moving]:
        """Where each member is to be now, and how its place moves."""
        return {name: self._place(offset) for name, offset in self.offsets_m.items()}

    def places_at(self, middle_enu_m: Vector, yaw_rad: float, scale: float) -> dict[str, Vector]:
        """Where each member is to be once the leader is there."""
        at = replace(self, moving=Moving(middle_enu_m), yaw_rad=yaw_rad, scale=scale, yaw_rate_radps=0.0)
        return {name: moving.pos_enu_m for name, moving in at.places().items()}

    def _place(self, offset: Vector) -> Moving:
        scale = self.scale
        east, north, z = turned((scale * offset[0], scale * offset[1], scale * offset[2]), self.yaw_rad)
        (px, py, pz), (u, v, w) = self.moving
        rate, growth = self.yaw_rate_radps, self.scale_per_s / scale
        return Moving(
            (px + east, py + north, pz + z),
            (u - rate * north + growth * east, v + rate * east + growth * north, w + growth * z),
        )

    def _turn_and_scale(self, dt_s: float) -> None:
        """Go towards the wanted heading and scale by ramps, as fast as the outermost member can fly."""
        out_m = max((math.hypot(*offset[:2]) for offset in self.offsets_m.values()), default=0.0)
        swing_mps = SWING_SHARE * self.own_bounds.speed_mps
        most = min(TURN_RADPS, swing_mps / max(out_m * self.scale, 0.1))
        left = math.remainder(self.wanted_yaw_rad - self.yaw_rad, math.tau)
        self.yaw_rate_radps = _ramped(self.yaw_rate_radps, left, most, dt_s)
        self.yaw_rad = math.remainder(self.yaw_rad + self.yaw_rate_radps * dt_s, math.tau)
        outer_m = max((math.hypot(*offset) for offset in self.offsets_m.values()), default=0.0)
        most = min(SCALE_PER_S, swing_mps / max(outer_m, 0.1))
        self.scale_per_s = _ramped(self.scale_per_s, self.wanted_scale - self.scale, most, dt_s)
        self.scale += self.scale_per_s * dt_s


def standing(places: Mapping[str, Vector], yaw_rad: float, bounds: MotionBounds) -> Leader:
    """A leader in the middle of places, which stay as they are."""
    middle = middle_of(list(places.values()))
    offsets = {name: turned(minus(place, middle), -yaw_rad) for name, place in places.items()}
    return Leader(Moving(middle), yaw_rad, bounds, offsets)


def turned(vector: Vector, yaw_rad: float) -> Vector:
    """A vector turned about up, counter-clockwise."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return vector[0] * cos - vector[1] * sin, vector[0] * sin + vector[1] * cos, vector[2]


def _ramped(rate: float, left: float, most: float, dt_s: float) -> float:
    """The next rate towards what is left: it builds up within two seconds, and comes down as fast."""
    change = most / 2.0
    wanted = math.copysign(min(most, math.sqrt(2.0 * 0.8 * change * abs(left)), abs(left) / dt_s / 2.0), left)
    return rate + max(-change * dt_s, min(change * dt_s, wanted - rate))
