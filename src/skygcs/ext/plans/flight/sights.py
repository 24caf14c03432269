"""Sights of a flight's vehicles: where each was measured, how far off it may be, and which pairs are near."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from skygcs.core.separation import separation_m
from skygcs.core.trajectory.piecewise import Vector

NEAR = 3.0
"""Pairs are named that are within so many margins of each other when one is in trouble: it may fly on for as far as the
stop of the others takes."""

MAX_PAIRS = 5

PROGRESS = 32
"""Ticks that are remembered: at five a second longer than `POSITION_SILENT_S`."""


class DepartureCause(StrEnum):
    """Why a vehicle does not follow any more."""

    LOST = "lost"
    PILOT = "pilot"
    GUARD = "guard"
    ORDER = "order"


class Departure(NamedTuple):
    why: DepartureCause
    text: str


class Measurement(NamedTuple):
    """A vehicle as it was measured, in the frame of the plan; the place is carried on to now."""

    place_m: Vector | None
    age_s: float = 0.0
    speed_mps: float = 0.0
    armed: bool = True
    on_ground: bool = False
    takeoff: str | None = None
    """climbs, reached, or what disturbed it; None: no take-off of this plan."""
    left: Departure | None = None
    """Set where it should follow and does not."""
    reported_m: Vector | None = None
    """The newest place as it was reported, and ``before_s``, how long ago it was there: what is compared with the
    way. A place that is carried on through a gap of the link flies past every corner."""
    before_s: float = 0.0
    holds: bool = False
    """Its autopilot holds it where it is, and needs nobody for that."""
    forgotten: bool = False
    """The fleet has it no more: no order reaches it, and no outcome comes."""
    unexpected_mode: str | None = None
    """The mode in which it is, if no order of a plan leads to that one and it is not under control: its pilot's, or of
    another program. It is never ordered to hold."""
    by_failsafe: bool = False
    """That mode may be of its own failsafe, as nobody is seen to have sticks: it is landed all the same."""

    def taken(self, left: Departure | None) -> bool:
        """True for one that was taken out of our hands, unless its autopilot holds it by now: a failsafe ends so, too,
        and leaves a vehicle that waits for an order until its battery is empty. ``left``: its departure."""
        return left is not None and left.why is DepartureCause.PILOT and not self.holds

    def piloted(self, left: Departure | None = None) -> bool:
        """True if somebody else flies it, and it is not to be landed. Of one that was under control its departure
        shows that, of another one its mode; a failsafe is nobody."""
        return (self.unexpected_mode is not None or self.taken(left)) and not self.by_failsafe


class Pair(NamedTuple):
    """Two vehicles near each other; the distance is in the downwash metric."""

    vehicles: tuple[str, str]
    distance_m: float
    margin_m: float


@dataclass(frozen=True, slots=True)
class Tubes:
    """By vehicle: ``half_m``, its part of each margin, and ``tube_m``, how far it may be from its reference in a timed
    step and from its way else."""

    half_m: Mapping[str, float]
    timed_m: Mapping[str, float]
    free_m: Mapping[str, float]
    downwash_ratio: float

    def tube_m(self, name: str, *, timed: bool) -> float:
        return (self.timed_m if timed else self.free_m)[name]

    def apart_m(self, a: Vector, b: Vector) -> float:
        """The distance of two places in the metric of the margins."""
        return separation_m(a[0] - b[0], a[1] - b[1], a[2] - b[2], self.downwash_ratio)


class ClockProgress:
    """Trajectory time at the last ticks of a step."""

    def __init__(self) -> None:
        self._ticks: deque[tuple[float, float]] = deque(maxlen=PROGRESS)

    def note(self, now: float, trajectory_s: float) -> None:
        """One tick."""
        self._ticks.append((now, trajectory_s))

    def clear(self) -> None:
        """Another step begins."""
        self._ticks.clear()

    def trajectory_s_at(self, then: float, now: float, trajectory_s: float) -> float:
        """The trajectory time at an earlier time, between the ticks around it; the oldest one known if it is older."""
        later, later_s = now, trajectory_s
        for at, s in reversed(self._ticks):
            if at <= then:
                return s if later <= at else s + (later_s - s) * (then - at) / (later - at)
            later, later_s = at, s
        return later_s


def pairs_near(name: str, sights: Mapping[str, Measurement], tubes: Tubes) -> tuple[Pair, ...]:
    """The pairs of this vehicle with those near it, the nearest first; as they were measured."""
    here = sights[name].place_m
    if here is None:
        return ()
    found = []
    for other, sight in sights.items():
        there = sight.place_m
        if other == name or there is None:
            continue
        distance_m = tubes.apart_m(here, there)
        margin_m = tubes.half_m[name] + tubes.half_m[other]
        if distance_m <= NEAR * margin_m:
            found.append(Pair((name, other), distance_m, margin_m))
    return tuple(sorted(found, key=lambda pair: pair.distance_m - pair.margin_m)[:MAX_PAIRS])


def pairs_text(pairs: Sequence[Pair]) -> str:
    """Which of these are too near each other, or the nearest, for people; empty for none."""
    if not pairs:
        return ""
    near = [pair for pair in pairs if pair.distance_m < pair.margin_m]
    found = ", ".join(
        f"{pair.vehicles[0]} and {pair.vehicles[1]} ({pair.distance_m:.1f} m, margin {pair.margin_m:.1f} m)"
        for pair in near or pairs[:1]
    )
    return f"; {'too near each other' if near else 'the nearest to each other'}: {found}"
