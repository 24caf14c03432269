"""Plans of a fleet: trajectories on one clock, or phases of straight legs with a barrier between them.

timed    every vehicle follows its trajectory by the fleet's clock
phased   every vehicle flies its leg of the phase at any speed; the next phase begins when all have arrived
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory.piecewise import MIN_PIECE_S, Vector
from skygcs.core.trajectory.timing import hover, path_within

MAX_PHASES = 1000


@dataclass(frozen=True, slots=True)
class Phase:
    """A vehicle without a goal in ``goals`` stays where it is."""

    name: str
    goals: Mapping[str, Vector]


@dataclass(frozen=True, slots=True)
class PhasedPlan:
    """From ``starts``, phase by phase."""

    starts: Mapping[str, Vector]
    phases: tuple[Phase, ...]

    def legs(self) -> list[tuple[str, dict[str, tuple[Vector, Vector]]]]:
        """(name of the phase, leg of each vehicle): of those that stay, a leg of no length."""
        places = dict(self.starts)
        found = []
        for phase in self.phases:
            goals = {name: phase.goals.get(name, place) for name, place in places.items()}
            found.append((phase.name, {name: (places[name], goals[name]) for name in places}))
            places = goals
        return found

    def trajectories(self, limits: MotionLimits) -> dict[str, Trajectory]:
        """The plan as it is flown where nothing is late: each phase as long as its longest leg takes."""
        flown: dict[str, list[Trajectory]] = {name: [] for name in self.starts}
        for _, legs in self.legs():
            parts = {name: path_within(leg, limits) for name, leg in legs.items() if leg[0] != leg[1]}
            took = max((part.duration_s for part in parts.values()), default=1.0)
            for name, (start, goal) in legs.items():
                flown[name] += _filled(parts.get(name), start, goal, took)
        return {name: Trajectory([p for part in parts for p in part.pieces]) for name, parts in flown.items()}


def _filled(part: Trajectory | None, start: Vector, goal: Vector, took: float) -> list[Trajectory]:
    """The leg, and standing at its end until all have arrived."""
    if part is None:
        return [hover(start, took)]
    rest = took - part.duration_s
    return [part, hover(goal, rest)] if rest >= MIN_PIECE_S else [part]


@dataclass(frozen=True, slots=True)
class TimedPlan:
    """Trajectories on one clock that begins at 0; a vehicle whose trajectory has ended stands."""

    trajectories: Mapping[str, Trajectory]


Plan = TimedPlan | PhasedPlan


@dataclass(frozen=True, slots=True)
class FlightSpace:
    """Where the fleet may be, in the world frame. Obstacles are standing vehicles and boxes; there are no others."""

    fence: tuple[tuple[float, float], ...] = ()
    """Corners of a polygon, which may be concave; none: no fence."""
    floor_m: float | None = None
    ceiling_m: float | None = None
    boxes: tuple[tuple[Vector, Vector], ...] = ()
    """(least corner, greatest corner)."""
    standing: Mapping[str, Vector] = field(default_factory=dict)
    """Vehicles that are parked, have failed or take no part: nobody may come within the margin of them."""

    @property
    def has_walls(self) -> bool:
        """True if anything but standing vehicles bounds it."""
        return bool(self.fence or self.boxes) or self.floor_m is not None or self.ceiling_m is not None

    def joined(self, added: FlightSpace) -> FlightSpace:
        """This one, and what ``added`` adds to it or replaces."""
        return FlightSpace(
            added.fence or self.fence,
            self.floor_m if added.floor_m is None else added.floor_m,
            self.ceiling_m if added.ceiling_m is None else added.ceiling_m,
            self.boxes + added.boxes,
            {**self.standing, **added.standing},
        )
