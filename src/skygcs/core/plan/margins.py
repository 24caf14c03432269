"""The distance that two vehicles must keep, term by term.

    term                    per vehicle                                         in
    ─────────────────────────────────────────────────────────────────────────────────────────
    wingspan                half of it: tip to tip, propellers included         every plan
    position error          how far the estimate is from the truth              every plan
    tracking error          p99 of the distance from the reference              every plan
    timing                  speed × (p99 delay + clock error)                   timed plans
    velocity jumps          Δv²/2a of the largest jump: a corner is not flown   timed plans
                            as it is drawn; and the largest jump of position

The margin of a pair is the sum over both. Distances are compared in the downwash metric: a vertical distance counts
1/downwash_ratio of it, so that the region a vehicle claims is an ellipsoid that is taller than wide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from skygcs.core.separation import DOWNWASH_RATIO, POSITION_ERROR_M, WINGSPAN_M
from skygcs.errors import RefusedError

MAX_MARGIN_M = 1000.0

DEFAULT = "default"
GIVEN = "given"
"""Sources of a term that was not measured."""

TRACKING = "tracking error p99"
TIMING = "speed × (delay p99 + clock error)"
JUMPS = "velocity jumps"

OFF_REFERENCE = frozenset({TRACKING, TIMING, JUMPS})
"""Terms that a vehicle may use up: how far it is from its reference. The others are its size and what it does not know
of its position."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Uncertainty of one vehicle; the defaults are for a multirotor of the 450 class with GPS, without a daemon."""

    wingspan_m: float = WINGSPAN_M
    position_error_m: float = POSITION_ERROR_M
    tracking_error_m: float = 0.4
    """p99 along a reference with its velocity fed forward (docs/explanation/flight-control.md)."""
    delay_s: float = 0.3
    """p99 of a setpoint's uplink delay over a radio with few vehicles."""
    clock_error_s: float = 0.02
    """Between the start of one vehicle and another: a tick of the control loop."""
    acceleration_mps2: float = 2.0
    """With which a vehicle follows a jump of the reference's velocity."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """By name of a field above: where its value comes from, for people. Those left out are defaults."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if name == "sources":
                continue
            value = getattr(self, name)
            if not 0.0 <= value <= 100.0 or (name == "acceleration_mps2" and value < 0.01):  # also for NaN
                raise RefusedError(f"{name} of {value:g} is not between 0 and 100")


@dataclass(frozen=True, slots=True)
class MarginRule:
    """How margins are made; ``fixed_m`` is a margin per pair that replaces all terms."""

    uncertainty: Uncertainty = Uncertainty()
    by_vehicle: Mapping[str, Uncertainty] = field(default_factory=dict)
    downwash_ratio: float = DOWNWASH_RATIO
    """Vertical distance per horizontal distance that is as safe."""
    fixed_m: float | None = None

    def __post_init__(self) -> None:
        if not 1.0 <= self.downwash_ratio <= 20.0:  # also for NaN
            raise RefusedError(f"a downwash ratio of {self.downwash_ratio:g} is not between 1 and 20")
        if self.fixed_m is not None and not 0.01 <= self.fixed_m <= MAX_MARGIN_M:
            raise RefusedError(f"a margin of {self.fixed_m:g} m is not between 0.01 and {MAX_MARGIN_M:g} m")

    def terms(self, name: str, motion: Motion | None = None) -> dict[str, float]:
        """Return what this vehicle adds to the margin of each of its pairs, in metres; ``motion`` in timed plans."""
        if self.fixed_m is not None:
            return {"given": self.fixed_m / 2.0}
        u = self.by_vehicle.get(name, self.uncertainty)
        found = {
            "half wingspan": u.wingspan_m / 2.0,
            "position error": u.position_error_m,
            TRACKING: u.tracking_error_m,
        }
        if motion is not None:
            found[TIMING] = motion.speed_mps * (u.delay_s + u.clock_error_s)
            found[JUMPS] = motion.jump_mps**2 / (2.0 * u.acceleration_mps2) + motion.jump_m
        return found

    def sources(self, name: str) -> dict[str, str]:
        """Source of each of its `terms`: measured over what, given, of the fleet file, or a default."""
        if self.fixed_m is not None:
            return {"given": GIVEN}
        found = self.by_vehicle.get(name, self.uncertainty).sources
        delay, clock = found.get("delay_s", DEFAULT), found.get("clock_error_s", DEFAULT)
        return {
            "half wingspan": found.get("wingspan_m", DEFAULT),
            "position error": found.get("position_error_m", DEFAULT),
            TRACKING: found.get("tracking_error_m", DEFAULT),
            TIMING: delay if delay == clock else f"delay {delay}, clock {clock}",
            JUMPS: found.get("acceleration_mps2", DEFAULT),
        }

    def half_m(self, name: str, motion: Motion | None = None) -> float:
        """The vehicle's part of the margin of each of its pairs."""
        return math.fsum(self.terms(name, motion).values())


@dataclass(frozen=True, slots=True)
class Motion:
    """Largest speed, largest jump of the velocity (from and to standing included), largest jump of the position."""

    speed_mps: float = 0.0
    jump_mps: float = 0.0
    jump_m: float = 0.0
