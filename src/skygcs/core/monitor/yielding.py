"""Which vehicle of a pair holds, and whether that helps.

Only a hold is ever ordered: it changes no height, it is what a person would order first, and it can be taken back. The
vehicle of lower priority holds, if that keeps the two apart; else the other one; else both. Where no hold helps (the
other flies at one that stands still, or falls onto it) nothing is ordered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from skygcs.core.monitor.approach import Piece, Vector, closest_on_paths
from skygcs.core.monitor.tracks import Track
from skygcs.core.vehicle.vehicle import Vehicle

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

COMING_HOME = LANDING | {"AUTO.RTL", "AUTO.RTGS", "RTL", "SMART_RTL", "AUTO_RTL"}


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
    for tracks, separation_m in choices:
        if separation_m >= radius_m:
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
