"""Contents of a certificate: certified or refused, the pair that comes closest, and every term of its margin."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from skygcs.core.plan.margins import OFF_REFERENCE, TRACKING
from skygcs.core.trajectory.piecewise import Vector


@dataclass(frozen=True, slots=True)
class Approach:
    """Two vehicles where their clearance is least."""

    vehicles: tuple[str, str]
    distance_m: float
    """In the downwash metric."""
    distance_at_least_m: float
    """Proven: it is never less than this."""
    margin_m: float
    terms: dict[str, dict[str, float]]
    """By vehicle: what it adds to the margin."""
    places_m: tuple[Vector, Vector]
    t_s: float | None = None
    phase: str | None = None
    sources: dict[str, dict[str, str]] = field(default_factory=dict)
    """By vehicle: where each of its terms comes from."""

    @property
    def clearance_m(self) -> float:
        return self.distance_m - self.margin_m

    @property
    def flown_at_least_m(self) -> float | None:
        """So far apart stay two vehicles, by their own positions, that are off their references by no more than their
        terms allow; None where a margin was given in place of terms."""
        if any(TRACKING not in of_vehicle for of_vehicle in self.terms.values()):
            return None
        used_m = math.fsum(
            term_m for of_vehicle in self.terms.values() for name, term_m in of_vehicle.items() if name in OFF_REFERENCE
        )
        return self.distance_at_least_m - used_m

    def text(self) -> str:
        one, other = self.vehicles
        when = f"at {self.t_s:.2f} s" if self.t_s is not None else f"in phase {self.phase}"
        places = " and ".join("(" + ", ".join(f"{v:.2f}" for v in place) + ")" for place in self.places_m)
        return (
            f"{one} and {other} come within {self.distance_m:.3f} m {when}, at {places}; margin {self.margin_m:.3f} m"
        )

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {
            "clearance_m": self.clearance_m,
            "flown_at_least_m": self.flown_at_least_m,
            "text": self.text(),
        }


@dataclass(frozen=True, slots=True)
class SpaceProblem:
    """A vehicle that leaves where it may be."""

    vehicle: str
    what: str
    """The fence, the ceiling, the floor, or box 3."""
    distance_m: float
    """From it; below 0: beyond it."""
    margin_m: float
    place_m: Vector
    t_s: float | None = None
    phase: str | None = None

    def text(self) -> str:
        when = f"at {self.t_s:.2f} s" if self.t_s is not None else f"in phase {self.phase}"
        place = ", ".join(f"{v:.2f}" for v in self.place_m)
        beyond = f"{-self.distance_m:.2f} m beyond" if self.distance_m < 0.0 else f"{self.distance_m:.2f} m from"
        return f"{self.vehicle} is {beyond} {self.what} {when}, at ({place}); margin {self.margin_m:.2f} m"


@dataclass(frozen=True, slots=True)
class Certificate:
    """The judgement of a plan. ``closest`` is None where there is one vehicle and nothing else."""

    certified: bool
    kind: str
    """timed, phased, or free: phased without barriers."""
    vehicles: int
    downwash_ratio: float
    closest: Approach | None
    too_close: tuple[Approach, ...] = ()
    """Where refused: the worst pair and others found beside it, not necessarily all."""
    space: tuple[SpaceProblem, ...] = ()
    duration_s: float | None = None
    motion: tuple[str, ...] = ()
    """Vehicles that exceed the limits of motion, if these were to be checked."""

    def reasons(self) -> list[str]:
        """Why it is refused, a line each."""
        return (
            [approach.text() for approach in self.too_close]
            + [problem.text() for problem in self.space]
            + list(self.motion)
        )

    def as_dict(self) -> dict[str, Any]:
        found = asdict(self)
        found["closest"] = None if self.closest is None else self.closest.as_dict()
        found["too_close"] = [approach.as_dict() for approach in self.too_close]
        found["space"] = [asdict(problem) | {"text": problem.text()} for problem in self.space]
        found["reasons"] = self.reasons()
        return found
