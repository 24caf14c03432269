"""Conflicts of pairs of vehicles: their level, which vehicle of a pair holds, and whether that helps. Pure.

    level     when (of two vehicles that fly straight on)
    -------   ---------------------------------------------------------------------------------------------------------
    notice    they come nearer than the margin and both balls within `HORIZON_S`; or only the balls of what is silent
              make that possible, while they themselves do not approach
    warning   they do so within `WARNING_S`
    action    they do so before a hold that is ordered now would have stopped the faster one (`action_s`)

A conflict counts once it was predicted without a break for `CONFIRM_S`, or `CONFIRM_DEEP_S` if they come within half
the margin soon: gusts and the turns of a formation make some tenths of a m/s, which ten seconds carry far. For the same
reason the first `NOISE_MPS` of a relative velocity are not believed, and two velocities that came at different times
are compared at the same time as well. A level rises at once and falls after `CLEAR_S`, measured with a margin larger by
a tenth.

Only a hold is ever ordered: it changes no height, it is what a person would order first, and it can be taken back. The
vehicle of lower priority holds, if that keeps the two apart; else the other one; else both. Where no hold helps (the
other flies at one that stands still, or falls onto it) nothing is ordered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from skygcs.core.monitor.approach import Approach, Piece, Vector, closest_approach, closest_on_paths
from skygcs.core.monitor.tracks import Track, path_of
from skygcs.core.separation import Margin, pair_margin, separation_m
from skygcs.core.vehicle.vehicle import Vehicle

# --- who holds --------------------------------------------------------------------------------------------------------

REACT_S = 1.5
"""From the decision to the first braking: a round of a busy radio each way, and the change of mode."""

YIELDER_SILENT_S = 2.0
"""A vehicle that was not heard for so long is not counted on: the order may not reach it."""

HELPS_M = 0.25
"""A hold that gains less is not worth stopping a vehicle."""

YIELDING_MODES = frozenset(
    {
        *("OFFBOARD", "AUTO.LOITER", "AUTO.MISSION", "AUTO.TAKEOFF", "AUTO.FOLLOW_TARGET"),
        *("GUIDED", "AUTO", "CIRCLE", "FOLLOW", "BRAKE"),
    }
)
"""Modes of PX4 and ArduCopter in which a program or the autopilot flies it somewhere. In all others it is flown by its
pilot, or comes down or home, which nobody may stop."""

LANDING = frozenset({"AUTO.LAND", "AUTO.PRECLAND", "LAND", "TERMINATION"})
"""Modes in which it comes down where it is."""

RETURNING = frozenset({"AUTO.RTL", "RTL"})
"""Modes of an order to return: in them it changes nothing. In the other ones of `COMING_HOME` it changes the way."""

COMING_HOME = LANDING | RETURNING | {"AUTO.RTGS", "SMART_RTL", "AUTO_RTL"}

LANDING_ORDERS = frozenset({"land", "stop"})
"""Orders that may bring it down where it is, from the moment they are sent."""

HOMING_ORDERS = LANDING_ORDERS | {"rtl"}
"""Orders that bring it home, or down."""


def why_not_yield(track: Track, now: float) -> str | None:
    """Why this vehicle is not ordered to hold; None if it may be."""
    vehicle = track.vehicle
    if track.parked:
        return "it is on the ground"
    if not vehicle.connected or now - track.at > YIELDER_SILENT_S:
        return "it is silent"
    if vehicle.duplicate:
        return "two vehicles have its system id"
    if vehicle.failsafe:
        return "its failsafe is active"
    if not vehicle.abilities.brake_mps2:
        return f"a {vehicle.kind} cannot be counted on to stop"
    if vehicle.mode in COMING_HOME:
        return f"it is in {vehicle.mode}"
    if vehicle.mode not in YIELDING_MODES:
        return f"its pilot flies it ({vehicle.mode})"
    if vehicle.landed(now) == "landing":
        return "it is landing"
    return None


def is_ranked_above(a: Vehicle, b: Vehicle, priority_a: int, priority_b: int) -> bool:
    """True if ``a`` has the right of way: the higher priority, else the earlier name."""
    return (-priority_a, a.name, a.key) < (-priority_b, b.name, b.key)


def stopping(velocity_mps: Vector, brake_mps2: float) -> tuple[Piece, Piece]:
    """The path of a vehicle that is ordered to hold: on for `REACT_S`, then half as fast until it stands."""
    u, v, w = velocity_mps
    return Piece(REACT_S, velocity_mps), Piece(math.hypot(u, v, w) / brake_mps2, (u / 2, v / 2, w / 2))


def who_holds(
    upper: Track, lower: Track, may_hold: tuple[bool, bool], radius_m: float, ratio: float, horizon_s: float
) -> tuple[Track, ...]:
    """The vehicles that should hold, of two that are about to meet; ``upper`` has the right of way. Empty: it would not
    help, or none of them may (``may_hold``, in their order)."""
    # both ways in the metric of the margin: going on, and stopping
    offset = scaled(
        (
            lower.place_m[0] - upper.place_m[0],
            lower.place_m[1] - upper.place_m[1],
            lower.place_m[2] - upper.place_m[2],
        ),
        ratio,
    )
    goes_on = [scaled_pieces(track.path, ratio) for track in (upper, lower)]
    stops = [scaled_pieces(stopping(track.velocity_mps, track.brake_mps2), ratio) for track in (upper, lower)]

    def least_m(first: Sequence[Piece], second: Sequence[Piece]) -> float:
        return closest_on_paths(offset, first, second, radius_m, horizon_s).separation_m

    # what each choice leaves between them: the lower vehicle holds, the upper, or both
    choices: list[tuple[tuple[Track, ...], float]] = []
    if may_hold[1]:
        choices.append(((lower,), least_m(goes_on[0], stops[1])))
    if may_hold[0]:
        choices.append(((upper,), least_m(stops[0], goes_on[1])))
    if all(may_hold):
        choices.append(((lower, upper), least_m(stops[0], stops[1])))
    for tracks, nearest_m in choices:
        if nearest_m >= radius_m:
            return tracks
    # none is enough: the best, if it is better than not to hold
    unheld_m = least_m(goes_on[0], goes_on[1])
    best: tuple[tuple[Track, ...], float] = max(choices, key=lambda choice: choice[1], default=((), 0.0))
    return best[0] if best[1] >= unheld_m + HELPS_M else ()


def scaled(vector: Vector, ratio: float) -> Vector:
    """In the metric of the margin."""
    return (vector[0], vector[1], vector[2] / ratio)


def scaled_pieces(pieces: Sequence[Piece], ratio: float) -> tuple[Piece, ...]:
    return tuple(Piece(piece.duration_s, scaled(piece.velocity_mps, ratio)) for piece in pieces)


# --- levels -----------------------------------------------------------------------------------------------------------


HORIZON_S = 10.0
"""How far ahead: straight flight is no prediction for longer."""

WARNING_S = 8.0
"""A person needs 5 s to look and act; the rest is for the confirmation of a conflict that begins late."""

CONFIRM_S = 2.0
CONFIRM_DEEP_S = 0.5
DEEP_S = 4.0
"""Time in which a deep conflict comes within half of the margin."""

NOISE_MPS = 0.2
"""Noise of a relative velocity at rest: two estimators with 0.1 m/s each in gusts."""

SAME_TIME_S = 0.05
OLD_S = 1.0
"""Velocities whose times differ by less are of one time; those whose times differ by more are not compared at one time,
because that would be to ignore what the newer one says."""

NEARER_M = 0.1
"""Two that come nearer by less are not approaching each other."""

CLEAR_S = 3.0
HYSTERESIS = 1.1

LEAST_ACTION_S = 3.0
"""Even a slow pair: time for the order, and for the one that holds to be seen standing."""


class Level(IntEnum):
    """Level of a pair, in the order of urgency."""

    NONE = 0
    NOTICE = 1
    WARNING = 2
    ACTION = 3


@dataclass(frozen=True, slots=True)
class Conflict:
    """Prediction for a pair now."""

    level: Level
    distance_m: float
    """Now, in the metric of the margin."""
    closest_m: float
    closest_in_s: float
    enters_s: float
    """Until the margin (and the balls) are lost; 0: they are."""
    margin: Margin
    balls_m: float
    deep: bool
    closing: bool

    def as_dict(self) -> dict[str, Any]:
        """Description for people and programs."""
        return {
            "distance_m": round(self.distance_m, 2),
            "closest_m": round(self.closest_m, 2),
            "closest_in_s": round(self.closest_in_s, 1),
            "enters_in_s": round(self.enters_s, 1),
            "margin_m": round(self.margin.total_m + self.balls_m, 2),
            "wingspans_m": round(self.margin.wingspans_m, 2),
            "position_errors_m": round(self.margin.position_errors_m, 2),
            "balls_m": round(self.balls_m, 2),
        }


def rank(a: Track, b: Track, widened: float = 1.0) -> tuple[float, float] | None:
    """(time until the margin is lost, closest distance) of what may be a conflict, for a choice among many: a part of
    `find_conflict`, which may find no conflict after all; None if they cannot."""
    if a.has_goal or b.has_goal:
        return _rank_with_goals(a, b, widened)
    # as pair_margin, without making one
    p, q, r, s = a.place_m, b.place_m, a.footprint, b.footprint
    ratio = max(r.downwash_ratio, s.downwash_ratio)
    margin_m = (r.wingspan_m + s.wingspan_m) / 2 + r.position_error_m + s.position_error_m
    offset = (q[0] - p[0], q[1] - p[1], (q[2] - p[2]) / ratio)
    velocity = believed_velocity(a.velocity_mps, b.velocity_mps, ratio)
    approach = closest_approach(offset, velocity, margin_m * widened + a.ball_m + b.ball_m, HORIZON_S)
    return None if approach.enters_s == math.inf else (approach.enters_s, approach.separation_m)


def _rank_with_goals(a: Track, b: Track, widened: float) -> tuple[float, float] | None:
    margin = pair_margin(a.footprint, b.footprint)
    ratio, p, q = margin.downwash_ratio, a.place_m, b.place_m
    radius_m = margin.total_m * widened + a.ball_m + b.ball_m
    offset = scaled((q[0] - p[0], q[1] - p[1], q[2] - p[2]), ratio)
    paths = scaled_pieces(a.path, ratio), scaled_pieces(b.path, ratio)
    approach = closest_on_paths(offset, *paths, radius_m, HORIZON_S, NOISE_MPS)
    if approach.enters_s == math.inf and not (a.planned or b.planned):
        velocity = believed_velocity(a.velocity_mps, b.velocity_mps, ratio)
        approach = closest_approach(offset, velocity, radius_m, HORIZON_S)
    return None if approach.enters_s == math.inf else (approach.enters_s, approach.separation_m)


def find_conflict(a: Track, b: Track, widened: float = 1.0) -> Conflict | None:
    """The conflict that two vehicles head for; None: none within `HORIZON_S`. ``widened``: factor of the margin."""
    margin = pair_margin(a.footprint, b.footprint)
    ratio = margin.downwash_ratio
    certain_m = margin.total_m * widened
    radius_m = certain_m + a.ball_m + b.ball_m
    p, q = a.place_m, b.place_m
    offset = scaled((q[0] - p[0], q[1] - p[1], q[2] - p[2]), ratio)
    velocity = believed_velocity(a.velocity_mps, b.velocity_mps, ratio)
    approach = closest_approach(offset, velocity, radius_m, HORIZON_S)
    if a.has_goal or b.has_goal:
        conflict = _with_goals(a, b, offset, margin, certain_m)
        if conflict is None and not (a.planned or b.planned):  # what follows a trajectory does not fly straight on
            conflict = _overshoot(a, b, approach, offset, margin)
        return conflict
    if math.isinf(approach.enters_s):
        return None
    # states of different age: the later entry of now and of the earlier of both
    difference_s = abs(a.at - b.at)
    if SAME_TIME_S < difference_s <= OLD_S and not (a.parked or b.parked):
        at = min(a.at, b.at)
        earlier = believed_velocity(a.velocity_at(at), b.velocity_at(at), ratio)
        then = closest_approach(offset, earlier, radius_m, HORIZON_S)
        if then.enters_s > approach.enters_s:
            approach, velocity = then, earlier
    if math.isinf(approach.enters_s):
        return None
    # how certain and how soon
    certain = closest_approach(offset, velocity, certain_m, HORIZON_S)
    soon = closest_approach(offset, velocity, certain_m, DEEP_S)
    return _conflict(a, b, (approach, certain, soon), separation_m(*offset, 1.0), margin, certain_m)


def _with_goals(a: Track, b: Track, offset: Vector, margin: Margin, certain_m: float) -> Conflict | None:
    """`find_conflict` for two of which at least one flies to where it was sent, and stays there."""
    ratio = margin.downwash_ratio
    radius_m = certain_m + a.ball_m + b.ball_m
    paths = scaled_pieces(a.path, ratio), scaled_pieces(b.path, ratio)
    approach = closest_on_paths(offset, *paths, radius_m, HORIZON_S, NOISE_MPS)
    if SAME_TIME_S < abs(a.at - b.at) <= OLD_S and not math.isinf(approach.enters_s):
        at = min(a.at, b.at)
        earlier = scaled_pieces(_path_at(a, at), ratio), scaled_pieces(_path_at(b, at), ratio)
        then = closest_on_paths(offset, *earlier, radius_m, HORIZON_S, NOISE_MPS)
        if then.enters_s > approach.enters_s:
            approach, paths = then, earlier
    if math.isinf(approach.enters_s):
        return None
    certain = closest_on_paths(offset, *paths, certain_m, HORIZON_S, NOISE_MPS)
    soon = closest_on_paths(offset, *paths, certain_m, DEEP_S, NOISE_MPS)
    return _conflict(a, b, (approach, certain, soon), separation_m(*offset, 1.0), margin, certain_m)


def _path_at(track: Track, at: float) -> tuple[Piece, ...]:
    """Its path with its velocity of an earlier time."""
    return track.path if track.planned or track.parked else path_of(track, track.velocity_at(at))[0]


def _overshoot(a: Track, b: Track, approach: Approach, offset: Vector, margin: Margin) -> Conflict | None:
    """Only if they flew on past their goals: no more than a notice, as they are seen to fly there."""
    if math.isinf(approach.enters_s):
        return None
    distance_m, balls_m = separation_m(*offset, 1.0), a.ball_m + b.ball_m
    return Conflict(Level.NOTICE, distance_m, *approach, margin, balls_m, deep=False, closing=False)


def _conflict(
    a: Track,
    b: Track,
    approaches: tuple[Approach, Approach, Approach],
    distance_m: float,
    margin: Margin,
    certain_m: float,
) -> Conflict:
    """``approaches``: to the margin and the balls, to the margin alone, and to that within `DEEP_S`."""
    approach, certain, soon = approaches
    closing = approach.separation_m < distance_m - NEARER_M
    # inside the balls of what is silent the time until the margin itself is lost counts, if it will be at all
    enters_s = certain.enters_s if approach.enters_s == 0.0 else approach.enters_s
    if math.isinf(enters_s):
        level = Level.NOTICE
    elif closing and enters_s <= action_s(a, b):
        level = Level.ACTION
    elif enters_s <= WARNING_S:
        level = Level.WARNING
    else:
        level = Level.NOTICE
    balls_m = a.ball_m + b.ball_m
    return Conflict(level, distance_m, *approach, margin, balls_m, soon.separation_m < certain_m / 2, closing)


def action_s(a: Track, b: Track) -> float:
    """How long before the margin is lost a hold has to be ordered: the reaction, and the braking of the faster one."""
    speed = max(math.hypot(*a.velocity_mps), math.hypot(*b.velocity_mps))
    return max(LEAST_ACTION_S, REACT_S + 0.5 + speed / min(a.brake_mps2, b.brake_mps2) * 1.5)


def believed_velocity(a: Vector, b: Vector, ratio: float) -> Vector:
    """The velocity of the second against the first in the metric of the margin, less what may be noise."""
    u, v, w = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    speed = math.hypot(u, v, w)
    if speed <= NOISE_MPS:
        return (0.0, 0.0, 0.0)
    share = 1.0 - NOISE_MPS / speed
    return (u * share, v * share, w * share / ratio)


@dataclass(slots=True)
class Pair:
    """One pair while something is predicted of it, and for a while after."""

    a: Track
    b: Track
    """In the order of the right of way."""
    predicted_at: float
    """Since when, without a break."""
    level: Level = Level.NONE
    conflict: Conflict | None = None
    """The newest prediction; None: nothing is predicted at present."""
    below_since: float | None = None
    """Since when a lower level than ``level`` is predicted."""

    def advance(self, conflict: Conflict | None, now: float) -> bool:
        """Take in the newest prediction; True if the level changed."""
        if conflict is not None and self.conflict is None:
            self.predicted_at = now
        self.conflict = conflict
        reached = Level.NONE
        if conflict is not None:
            confirm_s = CONFIRM_DEEP_S if conflict.deep else CONFIRM_S
            if self.level is not Level.NONE or now - self.predicted_at >= confirm_s:
                reached = conflict.level
        if reached > self.level:
            self.level, self.below_since = reached, None
            return True
        if reached == self.level:
            self.below_since = None
            return False
        if self.below_since is None:
            self.below_since = now
        if now - self.below_since < CLEAR_S:
            return False
        self.level, self.below_since = reached, None
        return True

    @property
    def over(self) -> bool:
        """Nothing is predicted, and nothing is left to be taken back."""
        return self.conflict is None and self.level is Level.NONE

    def describe(self) -> dict[str, Any]:
        """Description for people and programs."""
        predicted: Mapping[str, Any] = {} if self.conflict is None else self.conflict.as_dict()
        return {"vehicles": [self.a.name, self.b.name], "level": self.level.name.lower(), **predicted}
