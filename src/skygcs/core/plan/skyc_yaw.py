"""`yawControl` of Skybrush's shows: the yaw of a drone, beside its trajectory.

    {"version": 1, "setpoints": [[seconds of the show, degrees], …]}    joined by straight lines, the last one stays

Degrees count clockwise seen from above, from the show's x axis; not wrapped, so that 0 → 720 is two turns. Sources:
Skybrush Studio for Blender, `model/yaw.py` ("CW", linear, times of the show) and `plugin/utils/sampling.py` (the
negative of Blender's rotation about z); libskybrush, `yaw_control.c`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

from skygcs.core.plan.file_reading import number_of
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.piecewise import (
    MAX_DURATION_S,
    MAX_PIECES,
    MIN_PIECE_S,
    Coefficients,
    derivative,
    from_power,
)
from skygcs.core.trajectory.splitting import split_at
from skygcs.errors import PlanFileError

MAX_YAW_DEG = 36_000.0
"""A hundred turns."""

YAW_ERROR_RAD = math.radians(0.1)
"""Largest error of the straight lines that are written in place of a curve: a tenth of a compass's accuracy."""

JUMP_S = 2.0 * MIN_PIECE_S
"""From one setpoint to the next, where a yaw jumps: pieces may be as short."""

MOST_LINES = 1000
"""Most lines for a piece."""


def with_yaw(source: str, where: str, trajectory: Trajectory, control: Mapping[str, Any]) -> Trajectory:
    """The trajectory, with the yaw that ``control`` has for it. Raises PlanFileError, TrajectoryError."""
    version, setpoints = control.get("version"), control.get("setpoints")
    if version != 1 or isinstance(version, bool):
        raise PlanFileError(source, where, f"yawControl of version {str(version)[:20]}; only 1 is known")
    if not isinstance(setpoints, list) or len(setpoints) > MAX_PIECES:
        raise PlanFileError(source, where, f"yawControl has no list setpoints of {MAX_PIECES} at most")
    times, yaws = [], []
    for number, setpoint in enumerate(setpoints, 1):
        here = f"{where}, yaw setpoint {number}"
        if not isinstance(setpoint, list) or len(setpoint) != 2:
            raise PlanFileError(source, here, "a setpoint is [time, degrees]")
        times.append(number_of(source, here, "time", setpoint[0], MAX_DURATION_S))
        yaws.append(-math.radians(number_of(source, here, "yaw", setpoint[1], MAX_YAW_DEG)))
    if any(later <= earlier for earlier, later in pairwise(times)):
        raise PlanFileError(source, where, "the times of its yaw do not ascend")
    if not times:
        return trajectory
    if trajectory.has_yaw:
        raise PlanFileError(source, where, "it has a yaw in its points, and yawControl")
    pieces: list[Piece] = []
    begin_s = 0.0
    for piece in split_at(trajectory, times):
        end_s = begin_s + piece.duration_s
        first, last = _yaw_at(times, yaws, begin_s), _yaw_at(times, yaws, end_s)
        pieces.append(replace(piece, yaw=(first, (last - first) / piece.duration_s)))
        begin_s = end_s
    return Trajectory(pieces)


def _yaw_at(times: list[float], yaws: list[float], t_s: float) -> float:
    after = bisect_right(times, t_s)
    if after in (0, len(times)):
        return yaws[max(after - 1, 0)]
    share = (t_s - times[after - 1]) / (times[after] - times[after - 1])
    return yaws[after - 1] + share * (yaws[after] - yaws[after - 1])


def yaw_control(trajectory: Trajectory) -> dict[str, Any] | None:
    """Return what `with_yaw` reads, within `YAW_ERROR_RAD`; None: the trajectory has no yaw. A full turn between two
    pieces is left out, any other jump takes `JUMP_S`."""
    if not trajectory.has_yaw:
        return None
    found: list[tuple[float, float]] = []
    for begin_s, piece in zip(trajectory.begins_s, trajectory.pieces, strict=True):
        yaw, duration_s = piece.yaw or (0.0,), piece.duration_s
        lines = _lines(yaw, duration_s)
        first, turns = _value(yaw, 0.0), 0.0
        if found:
            turns = math.tau * round((found[-1][1] - first) / math.tau)
            jumps = abs(found[-1][1] - first - turns) > 1e-9
            if jumps and duration_s / lines >= 2.0 * JUMP_S:
                found.append((begin_s + JUMP_S, _value(yaw, JUMP_S) + turns))
        else:
            found.append((0.0, first))
        found += [
            (begin_s + duration_s * k / lines, _value(yaw, duration_s * k / lines) + turns) for k in range(1, lines + 1)
        ]
    return {"version": 1, "setpoints": [[t_s, -math.degrees(yaw_rad)] for t_s, yaw_rad in found]}


def _lines(yaw: Coefficients, duration_s: float) -> int:
    """How many straight lines keep to a curve: each is off by at most its length² |yaw''| / 8."""
    if len(yaw) < 3:
        return 1
    curve = derivative(derivative(from_power(yaw, duration_s), duration_s), duration_s)
    wanted = duration_s * math.sqrt(max(map(abs, curve)) / (8.0 * YAW_ERROR_RAD))
    most = max(1, min(MOST_LINES, int(duration_s / JUMP_S)))
    return max(1, min(math.ceil(wanted), most))


def _value(coefficients: Coefficients, t_s: float) -> float:
    total = 0.0
    for c in reversed(coefficients):
        total = total * t_s + c
    return total
