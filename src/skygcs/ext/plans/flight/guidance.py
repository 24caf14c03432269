"""The way in which the vehicles of a plan are guided along it, and the choice between the ways. Pure.

    way         sent to a vehicle                               plans     the ground is lost
    ---------   ---------------------------------------------   -------   ----------------------------------------------
    goto        one order for each leg; its autopilot flies     phased    it rests at the end of its leg, which is
                its own straight way                                      certified as a place to stay
    setpoints   a stream of positions, velocities or attitudes  all       its autopilot holds where the stream ends
    onboard     the trajectories, to its companion              all       its companion goes on
    mission     all its legs at once, as a mission; nobody      phased,   its autopilot goes on
                waits for anybody                               free

``auto`` takes companions where every vehicle has one, else setpoints where every link carries them, else goto for a
phased plan. ``onboard`` takes missions where no vehicle has a companion. Free: certified without barriers.
`GOTO_TUBE_M` is how far an autopilot's own way was from the straight leg.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from skygcs.core.plan.fleet_plan import Phase, PhasedPlan
from skygcs.core.plan.margins import MarginRule, Uncertainty
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.trajectory.timing import SAME_PLACE_M
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight import remedies
from skygcs.spelling import enumerated


class Guidance(StrEnum):
    """Value of ``by``."""

    GOTO = "goto"
    SETPOINTS = "setpoints"
    ONBOARD = "onboard"
    MISSION = "mission"

    @property
    def own_way(self) -> bool:
        """True if autopilots fly the legs by themselves, without a clock: these are level or vertical."""
        return self in (Guidance.GOTO, Guidance.MISSION)


AUTO = "auto"
"""The value of ``by`` that leaves the choice to `choose`."""

LEVEL_M = 0.3
"""A leg that climbs and moves level by more than this in both is flown as two: neither firmware promises a straight way
in space. PX4 limits the level and the vertical speed each by itself (PositionSmoothing), ArduCopter shapes both by
themselves (AC_PosControl, input_pos_NED). Below it the difference is within the tube."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A way, and why it was taken, for people."""

    by: Guidance
    reason: str


def choose(by: str, *, timed: bool, own_companion: Mapping[str, bool], not_streamed: Mapping[str, str]) -> Choice:
    """The way for a plan. ``own_companion``: by vehicle, whether its companion makes its setpoints; ``not_streamed``:
    the vehicles whose links do not carry setpoints, and why. Raises RefusedError, with the command that helps, where
    the asked way cannot be flown at all."""
    # the way that somebody asked for
    without = [name for name, has in own_companion.items() if not has]
    if by == Guidance.ONBOARD and len(without) < len(own_companion):
        if without:
            raise RefusedError(
                f"{enumerated(without)} {'has' if len(without) == 1 else 'have'} no companion that flies it "
                f'(control.at = "companion"): `{(remedies.by_setpoints() if timed else remedies.by_goto()).command}`'
            )
        return Choice(Guidance.ONBOARD, "as asked for; the companions have the trajectories")
    if by in (Guidance.GOTO, Guidance.ONBOARD, Guidance.MISSION):
        if timed:
            if by == Guidance.ONBOARD:
                raise RefusedError(
                    "no vehicle has a companion that flies it, and missions, which have no times, do not fly a timed "
                    f"plan: `{remedies.by_setpoints().command}`"
                )
            what = "goto, which has no times" if by == Guidance.GOTO else "missions, which have no times"
            raise RefusedError(f"a timed plan is not flown by {what}: `{remedies.make_phased().command}`")
        if by == Guidance.GOTO:
            return Choice(Guidance.GOTO, "as asked for")
        return Choice(Guidance.MISSION, "as asked for; the autopilots have the whole way as their mission")
    if by == Guidance.SETPOINTS:
        return Choice(Guidance.SETPOINTS, "as asked for")
    # none was asked for: companions, else setpoints where every link carries them, else goto
    if own_companion and not without:
        return Choice(Guidance.ONBOARD, "every vehicle has a companion that flies it")
    if not not_streamed:
        return Choice(Guidance.SETPOINTS, "every link carries them")
    name, why = next(iter(not_streamed.items()))
    if timed:
        return Choice(Guidance.SETPOINTS, f"a timed plan has no other way, although {name}: {why}")
    if len(without) < len(own_companion):
        return Choice(Guidance.SETPOINTS, f"some are flown by their companions, although {name}: {why}")
    return Choice(Guidance.GOTO, f"{name}: {why}")


# --- margins of legs that an autopilot flies by itself ----------------------------------------------------------------


GOTO_TUBE_M: Mapping[str, float] = {"px4": 1.2, "ardupilot": 0.6}
"""By firmware: how far it may be from a straight level or vertical leg that it flies by itself from rest to rest, by
its own position, heights divided by the downwash ratio."""

GOTO_SOURCE = "the autopilot's own way, measured (docs/explanation/plans.md)"


def by_goto(rule: MarginRule, families: Mapping[str, str]) -> MarginRule:
    """The rule for legs that autopilots fly by themselves: their measured tube in place of the tracking error, unless
    that is known to be larger. ``families``: px4 or ardupilot, by vehicle; of any other the larger tube is taken."""

    def wider(name: str) -> Uncertainty:
        u = rule.by_vehicle.get(name, rule.uncertainty)
        tube_m = GOTO_TUBE_M.get(families[name], max(GOTO_TUBE_M.values()))
        if u.tracking_error_m >= tube_m:
            return u
        return replace(u, tracking_error_m=tube_m, sources={**u.sources, "tracking_error_m": GOTO_SOURCE})

    return replace(rule, by_vehicle={**rule.by_vehicle, **{name: wider(name) for name in families}})


# --- legs -------------------------------------------------------------------------------------------------------------


def level_or_vertical(plan: PhasedPlan) -> PhasedPlan:
    """The plan with each slanted leg as two: up and level, or level and down. Phases without one stay as they are."""
    phases: list[Phase] = []
    for (name, legs), phase in zip(plan.legs(), plan.phases, strict=True):
        if not any(_slanted(*leg) for leg in legs.values()):
            phases.append(phase)
            continue
        moved = {v: leg for v, leg in legs.items() if math.dist(*leg) > SAME_PLACE_M}
        up = {v: (a[0], a[1], b[2]) for v, (a, b) in moved.items() if b[2] > a[2]}
        level = {v: (b[0], b[1], max(a[2], b[2])) for v, (a, b) in moved.items()}
        down = {v: b for v, (a, b) in moved.items() if b[2] < a[2]}
        parts = ((f"{name}: up", up), (f"{name}: level", level), (f"{name}: down", down))
        phases += [Phase(part, goals) for part, goals in parts if goals]
    return PhasedPlan(plan.starts, tuple(phases))


def _slanted(begin: Vector, end: Vector) -> bool:
    return math.dist(begin[:2], end[:2]) > LEVEL_M and abs(end[2] - begin[2]) > LEVEL_M
