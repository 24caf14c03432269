"""Timing-free certificate (a): climb to layers, cross in rounds, descend; a barrier between the phases. numpy.

    climb      each vehicle vertically above its start, to the height of its layer
    cross r    the vehicles of round r fly straight and level above their goals, the others stand at either end
    descend    each vehicle vertically to its goal

Vehicles in different layers are a margin apart in height (times the downwash ratio), wherever they are. Vehicles in one
layer must be a margin apart by their corridors:

    in one round           the corridors are apart
    i in an earlier round  i's corridor is apart from j's start, and j's corridor from i's goal

Each vehicle gets the first (round, layer) that suits all before it; the order is by how constrained they are (DSATUR).
One round is tried first with all layers below the ceiling, then two, and so on. What comes out is certified by
`certify`, which knows nothing of layers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan
from skygcs.core.plan.segment_distance import SLACK_M, Array, point_segment, segment_segment
from skygcs.core.trajectory.piecewise import Vector

Flags = NDArray[np.bool_]

LIFT_M = 1.5
"""A plan is flown at least so high above the ground: take-offs end 0.8 m below their height (NAV_MC_ALT_RAD), and a
vehicle under control must not touch the ground."""

MAX_LAYERS = 255
MAX_ROUNDS = 64

GAP_M = 10 * SLACK_M
"""Added to every distance here, so that the certificate does not fail by rounding."""


class Layers(NamedTuple):
    """Where each vehicle crosses, by its index."""

    layer: list[int]
    round: list[int]
    heights_m: list[float]


class _Conflicts(NamedTuple):
    same_round: Flags
    """[i, j]: their corridors are too near."""
    order: Flags
    """[i, j]: i must not cross before j, because of j's start or i's goal."""
    layer: Flags
    """[i, layer]: too near to a standing vehicle, or too high."""


def layered(
    names: Sequence[str],
    starts: Sequence[Vector],
    goals: Sequence[Vector],
    half_margins_m: Sequence[float],
    downwash_ratio: float,
    space: FlightSpace,
    standing_half_m: float,
) -> tuple[PhasedPlan, Layers] | str:
    """Phases for all vehicles; the reason where no place was found for one in the layers below the ceiling. Another
    assignment may have one: each vehicle takes the first that is free, and none is moved afterwards."""
    s, g, half = np.asarray(starts, dtype=float), np.asarray(goals, dtype=float), np.asarray(half_margins_m)
    spacing = 2.0 * float(half.max()) * downwash_ratio + GAP_M * downwash_ratio
    base = min(float(s[:, 2].min()), float(g[:, 2].min()))
    if space.floor_m is not None and base <= space.floor_m:  # nobody crosses on the ground
        lowest_goal_m = float(g[:, 2].min())
        base = lowest_goal_m if lowest_goal_m >= space.floor_m + LIFT_M else space.floor_m + spacing
    count = MAX_LAYERS
    if space.ceiling_m is not None:
        count = math.floor((space.ceiling_m - float(half.max()) - base) / spacing + 1e-9) + 1
    if count < 1:
        return f"there is no layer between {base:g} m and the ceiling at {space.ceiling_m:g} m"
    heights = [base + spacing * layer for layer in range(min(count, MAX_LAYERS))]
    conflicts = _conflicts(s, g, half, heights, downwash_ratio, space, standing_half_m)
    stuck = 0
    for rounds in range(1, min(MAX_ROUNDS, len(names)) + 1):
        found = _assign(conflicts, rounds)
        if not isinstance(found, int):
            layers = Layers(found[0], found[1], heights)
            return _phases(names, starts, goals, layers), layers
        stuck = found
    rounds = min(MAX_ROUNDS, len(names))
    tried = f"{layers_text(len(heights))} {spacing:.2f} m apart and up to {rounds} round{'s' if rounds > 1 else ''}"
    return f"{names[stuck]} found no place in {tried}; each vehicle took the first that was free"


def layers_text(count: int) -> str:
    """ "1 layer", "2 layers"."""
    return f"{count} layer" + ("" if count == 1 else "s")


def _conflicts(
    s: Array,
    g: Array,
    half: Array,
    heights: Sequence[float],
    downwash_ratio: float,
    space: FlightSpace,
    standing_half_m: float,
) -> _Conflicts:
    count = len(s)
    level_s, level_g = s * (1.0, 1.0, 0.0), g * (1.0, 1.0, 0.0)
    margin = half[:, None] + half[None] + GAP_M
    i, j = np.triu_indices(count, 1)
    near = np.zeros((count, count), dtype=bool)
    distance, _, _ = segment_segment(level_s[i], level_g[i], level_s[j], level_g[j])
    near[i, j] = near[j, i] = distance < margin[i, j]
    # [i, j]: distance of j's start from i's corridor, and of i's goal from j's corridor
    start_j = point_segment(level_s[None], level_s[:, None], level_g[:, None])[0]
    goal_i = point_segment(level_g[:, None], level_s[None], level_g[None])[0]
    order = (start_j < margin) | (goal_i < margin)
    blocked = np.zeros((count, len(heights)), dtype=bool)
    for place in space.standing.values():
        point = np.array([place[0], place[1], 0.0])
        across, _ = point_segment(point, level_s, level_g)
        up = (np.asarray(heights) - place[2]) / downwash_ratio
        blocked |= np.hypot(across[:, None], up[None]) < half[:, None] + standing_half_m + GAP_M
    return _Conflicts(near, order, blocked)


def _assign(conflicts: _Conflicts, rounds: int) -> tuple[list[int], list[int]] | int:
    """Layer and round of each vehicle, the most constrained first; or the vehicle that fits into no layer."""
    count = len(conflicts.same_round)
    degree = conflicts.same_round.sum(axis=1)
    free = np.repeat(~conflicts.layer[:, None, :], rounds, axis=1)  # [vehicle, round, layer]
    layer, turn = np.full(count, -1), np.full(count, -1)
    waiting = np.ones(count, dtype=bool)
    for _ in range(count):
        slots = free.sum(axis=(1, 2))
        key = np.where(waiting, slots * (count + 1) - degree, np.iinfo(np.int64).max)
        chosen = int(np.argmin(key))
        possible = np.argwhere(free[chosen])
        if not len(possible):
            return chosen
        turn[chosen], layer[chosen] = possible[0]
        waiting[chosen] = False
        r, place = int(turn[chosen]), int(layer[chosen])
        free[:, r, place] &= ~conflicts.same_round[chosen]
        free[:, :r, place] &= ~conflicts.order[:, chosen][:, None]  # others before it
        free[:, r + 1 :, place] &= ~conflicts.order[chosen][:, None]
    return [int(v) for v in layer], [int(v) for v in turn]


def _phases(names: Sequence[str], starts: Sequence[Vector], goals: Sequence[Vector], layers: Layers) -> PhasedPlan:
    heights = [layers.heights_m[layer] for layer in layers.layer]
    above_start = {
        name: (start[0], start[1], height) for name, start, height in zip(names, starts, heights, strict=True)
    }
    above_goal = {name: (goal[0], goal[1], height) for name, goal, height in zip(names, goals, heights, strict=True)}
    phases = [Phase("climb", above_start)]
    used = sorted(set(layers.round))
    for number, turn in enumerate(used, 1):
        crossing = {name: above_goal[name] for name, own in zip(names, layers.round, strict=True) if own == turn}
        phases.append(Phase("cross" if len(used) == 1 else f"cross {number}", crossing))
    phases.append(Phase("descend", dict(zip(names, goals, strict=True))))
    return PhasedPlan(dict(zip(names, starts, strict=True)), tuple(phases))
