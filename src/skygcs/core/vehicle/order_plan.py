"""An order as data: its steps, and the state of the vehicle that confirms each step.

`autopilot` makes plans, the vehicle's actor runs them. A step is one command (or a message without acknowledgement);
the next one begins when the step was accepted and, if ``expect_s`` is not 0, its expectation is met.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from skygcs.core.geo import distance_m
from skygcs.core.protocols.command import CommandSpec
from skygcs.core.vehicle.flight_evidence import contradiction
from skygcs.core.vehicle.vehicle import Vehicle

FORCE_HINT = "insist with force (--force)"

VERIFY_S = 3.0
"""A change shows in the next heartbeat, within a second; two heartbeats may be lost."""


class Expectation(Protocol):
    """A state of the vehicle that shows that an order has worked."""

    def met(self, vehicle: Vehicle, now: float) -> bool: ...

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        """The actual state, for the user: "still in POSCTL"."""
        ...


class LateCommand(Protocol):
    """A command that is made when its step begins, from the state that the steps before it have led to."""

    def command(self, vehicle: Vehicle, now: float) -> CommandSpec:
        """Raises RefusedError if it cannot be made: the step is refused, and what was done is undone."""
        ...


@dataclass(frozen=True, slots=True)
class ArmedIs:
    armed: bool

    def met(self, vehicle: Vehicle, now: float) -> bool:
        return vehicle.armed is self.armed

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return "still armed" if vehicle.armed else "still disarmed"


@dataclass(frozen=True, slots=True)
class ModeIn:
    """Expectation of one of these modes. ``or_disarmed``: also met when disarmed; on the ground a vehicle may leave the
    mode at once."""

    custom_modes: frozenset[int]
    or_disarmed: bool = False

    def met(self, vehicle: Vehicle, now: float) -> bool:
        if vehicle.custom_mode in self.custom_modes:
            return True
        return self.or_disarmed and not vehicle.armed and contradiction(vehicle, now) is None

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return f"it is in {vehicle.mode}"


LIFT_OFF_S = 8.0
"""PX4 spools up for one to three seconds, ArduCopter for two; the landed state comes every two seconds."""

RUN_S = 40.0
"""A plane runs along the ground first, or waits for the hand that throws it."""

CLIMBED_M = 0.5


@dataclass(frozen=True, slots=True)
class LiftedOff:
    """Armed, and off the ground by its landed state or by its height over ``from_amsl_m``."""

    from_amsl_m: float | None

    def met(self, vehicle: Vehicle, now: float) -> bool:
        if not vehicle.armed:
            return False
        position = vehicle.telemetry("position")
        alt_amsl_m = None if position is None else position["alt_amsl_m"]
        if alt_amsl_m is not None and self.from_amsl_m is not None and alt_amsl_m > self.from_amsl_m + CLIMBED_M:
            return True
        return vehicle.in_air(now) is True

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return "still on the ground" if vehicle.armed else "it is disarmed and on the ground"


POSITION = 1 << 3 | 1 << 4 | 1 << 8 | 1 << 9
"""Bits of EKF_STATUS_REPORT (EKF_STATUS_FLAGS): horizontal position, relative or absolute, now or predicted for when it
is armed. While disarmed the estimator may still assume a standing vehicle (1 << 7); position_ok() allows that."""

ESTIMATE_FRESH_S = 6.0
"""On a radio the message comes every five seconds."""


@dataclass(frozen=True, slots=True)
class HasPosition:
    """Its estimator has a position, or will have one when armed: ArduCopter's position_ok(), which GUIDED requires
    (system.cpp)."""

    def met(self, vehicle: Vehicle, now: float) -> bool:
        estimate, at = vehicle.telemetry("estimator"), vehicle.telemetry_at("estimator")
        if estimate is None or at is None or now - at > ESTIMATE_FRESH_S:
            return False
        return bool(int(estimate["flags"]) & POSITION)

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return (
            f"its estimator has no position yet, and no takeoff could follow in {vehicle.mode}; wait for GPS, or arm "
            "without --wait to fly it by hand"
        )


@dataclass(frozen=True, slots=True)
class MessageAfter:
    """The message came after the order; ``count``: how often it had come before."""

    message: str
    count: int

    def met(self, vehicle: Vehicle, now: float) -> bool:
        return vehicle.count(self.message) > self.count

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return f"no {self.message} came"


@dataclass(frozen=True, slots=True)
class ParamKnown:
    """A parameter of `message_cache.WATCHED` was reported at or after that time, whichever program requested it."""

    name: str
    after: float

    def met(self, vehicle: Vehicle, now: float) -> bool:
        reported_at = vehicle.parameters.reported_at(self.name)
        return reported_at is not None and reported_at >= self.after

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return f"it does not report its parameter {self.name}"


TARGET_TOLERANCE_M = 2.0
"""POSITION_TARGET_GLOBAL_INT repeats the target but for rounding; a difference of metres is another target."""

NEARER_M = 1.0
"""More than the position of a vehicle that stands changes in seconds."""

ALTITUDE_FRAMES = (0, 5)
"""MAV_FRAME_GLOBAL and GLOBAL_INT, in which an altitude is one above mean sea level."""


@dataclass(frozen=True, slots=True)
class GoesThere:
    """Since a time it has reported (POSITION_TARGET_GLOBAL_INT) that it flies to this place, or is there, or has come
    nearer than ``from_m``."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    since: float
    from_m: float

    def met(self, vehicle: Vehicle, now: float) -> bool:
        target, at = vehicle.telemetry("target_global"), vehicle.telemetry_at("target_global")
        if target is not None and at is not None and at > self.since and target["lat_deg"] is not None:
            alt_m = target["alt_m"] if target["frame"] in ALTITUDE_FRAMES else None
            return self._off_m(target["lat_deg"], target["lon_deg"], alt_m) <= TARGET_TOLERANCE_M
        left_m = self._left_m(vehicle)
        return left_m is not None and left_m <= max(TARGET_TOLERANCE_M, self.from_m - NEARER_M)

    def unmet(self, vehicle: Vehicle, now: float) -> str:
        return "it does not report that it flies there, and does not come nearer"

    def _left_m(self, vehicle: Vehicle) -> float | None:
        """Its distance from the place by a position that came since the time; None: no such position."""
        position, at = vehicle.telemetry("position"), vehicle.telemetry_at("position")
        if position is None or at is None or at <= self.since or position["lat_deg"] is None:
            return None
        return self._off_m(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])

    def _off_m(self, lat_deg: float, lon_deg: float, alt_amsl_m: float | None) -> float:
        up_m = 0.0 if alt_amsl_m is None else alt_amsl_m - self.alt_amsl_m
        return math.hypot(distance_m(self.lat_deg, self.lon_deg, lat_deg, lon_deg), up_m)


@dataclass(frozen=True, slots=True)
class TargetProof:
    """A place that a vehicle accepted as its target, and the request for the message that shows whether it still is.

    An ArduCopter forgets it as soon as it gets another target or enters GUIDED from another mode (ModeGuided::init,
    set_velaccel, set_pos_vel_accel): a setpoint, or the repeat of an order, that was sent before it and arrives after
    it (over a slower link, or because the link has become faster) leaves the vehicle where it is. While it flies to a
    place it reports it; with any other target it answers the request with nothing (ModeGuided::get_wp).
    """

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    custom_mode: int
    """The mode in which it does what it accepted: out of another one, which is its pilot's, it is never taken back."""
    request: CommandSpec
    again: CommandSpec | None = None
    """In place of the step's command when it is repeated: one that a vehicle in another mode denies."""

    def begin(self, vehicle: Vehicle, now: float) -> GoesThere:
        """The expectation that it has to meet from now on."""
        there = GoesThere(self.lat_deg, self.lon_deg, self.alt_amsl_m, now, math.inf)
        position = vehicle.telemetry("position")
        if position is None or position["lat_deg"] is None:
            return replace(there, from_m=0.0)
        here = (position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
        return replace(there, from_m=there._off_m(*here))


@dataclass(frozen=True, slots=True)
class Step:
    """One command, acknowledged and repeated, or one ``message``: sent once, or repeated until an expectation is met.
    Exactly one of the two is given. With ``late`` the command is made by it when the step begins; ``command`` is then
    what it would be at the time of the order.

    ``expect_s``: how long to wait for the expectation; with 0 it is only used to explain a lost ACK.
    ``skip_if_met``: send nothing if the expectation is met already. ``undo`` is carried out if a later step fails.
    ``instead`` replaces the step if the vehicle answers that it does not support the command. ``refused`` explains a
    refusal, beside the vehicle's own reason if it gives one. An ``optional`` step may fail: the plan goes on.
    ``with_repeats`` is a message sent right after each repeat of the command, for a vehicle that receives us while its
    answers are lost, so that the next step never begins. With a ``proof`` the vehicle is asked after the step whether
    it still does what it accepted, and the step is repeated if not.
    """

    name: str
    command: CommandSpec | None = None
    late: LateCommand | None = None
    message: tuple[str, Mapping[str, Any]] | None = None
    expect: Expectation | None = None
    expect_s: float = VERIFY_S
    skip_if_met: bool = False
    undo: Step | None = None
    instead: tuple[Step, ...] = ()
    refused: str = ""
    optional: bool = False
    with_repeats: tuple[str, Mapping[str, Any]] | None = None
    proof: TargetProof | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """``done`` is the outcome's message when all steps have worked.

    ``emergency``: sent over every link, before anything else, also to vehicles that take no plain orders. For
    ``persist_s`` its steps are repeated until the vehicle shows their effect or refuses. ``final``: no newer order
    replaces it. ``despite_duplicate``: safe, or confirmed, for two vehicles with one system id. ``force``: somebody
    insists on what the outgoing gate would refuse. ``spares``: modes in which the vehicle is not, or no longer, sent
    this.
    """

    order: str
    steps: tuple[Step, ...]
    done: str
    emergency: bool = False
    persist_s: float = 0.0
    final: bool = False
    despite_duplicate: bool = False
    force: bool = False
    spares: frozenset[str] = frozenset()
