"""Pieces of a trajectory cut at times: the same motion in more pieces."""

from __future__ import annotations

from collections.abc import Sequence

from skygcs.core.trajectory.piecewise import MIN_PIECE_S, Coefficients, Piece, Trajectory


def split_at(trajectory: Trajectory, times_s: Sequence[float]) -> list[Piece]:
    """The pieces, cut at these ascending times, except within `MIN_PIECE_S` of another cut or of an end."""
    found: list[Piece] = []
    cuts = iter(times_s)
    cut = next(cuts, None)
    for begin_s, piece in zip(trajectory.begins_s, trajectory.pieces, strict=True):
        since_s = 0.0
        while cut is not None and cut <= begin_s + piece.duration_s:
            at_s = cut - begin_s
            if at_s - since_s >= MIN_PIECE_S and piece.duration_s - at_s >= MIN_PIECE_S:
                found.append(_part(piece, since_s, at_s))
                since_s = at_s
            cut = next(cuts, None)
        found.append(_part(piece, since_s, piece.duration_s))
    return found


def _part(piece: Piece, from_s: float, to_s: float) -> Piece:
    if from_s == 0.0:
        return Piece(to_s, piece.east, piece.north, piece.up, piece.yaw)
    east, north, up = (shifted(axis, from_s) for axis in (piece.east, piece.north, piece.up))
    return Piece(to_s - from_s, east, north, up, None if piece.yaw is None else shifted(piece.yaw, from_s))


def shifted(coefficients: Coefficients, by_s: float) -> Coefficients:
    """The same polynomial with its time counted from ``by_s`` (Taylor's shift, by repeated synthetic division)."""
    c = list(coefficients)
    for low in range(len(c) - 1):
        for k in range(len(c) - 2, low - 1, -1):
            c[k] += by_s * c[k + 1]
    return tuple(c)
