"""Crazyswarm's polynomial CSV: one vehicle per file, one piece per line.

    duration,x^0,…,x^7,y^0,…,y^7,z^0,…,z^7,yaw^0,…,yaw^7        a header line, with or without #, may be missing
    1.05,0,0,0,0,0.830443,-0.276140,-0.384219,0.180493,0,…      33 numbers, ascending powers; a trailing comma occurs

Seconds, metres, radians. Sources: crazyswarm's and cflib's trajectory files, whoenig/uav_trajectories.
"""

from __future__ import annotations

from skygcs.core.plan.file_reading import number_of, refused, rows, text_of
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DURATION_S, MAX_PIECES, MAX_TERM, Coefficients
from skygcs.errors import PlanFileError, TrajectoryError

DEGREE = 7
NUMBERS = 1 + 4 * (DEGREE + 1)

HEADER = ",".join(["duration", *(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(DEGREE + 1))])


def read_crazyswarm(source: str, data: bytes) -> Trajectory:
    """The one trajectory of the file. Raises PlanFileError."""
    pieces: list[Piece] = []
    for number, found in rows(source, text_of(source, data)):
        cells = found
        where = f"line {number}"
        if not pieces and cells[0].lower() == "duration":
            continue
        if len(cells) == NUMBERS + 1 and not cells[-1]:
            cells = cells[:-1]
        if len(cells) != NUMBERS:
            raise PlanFileError(source, where, f"{len(cells)} numbers; a piece has {NUMBERS}")
        values = [
            number_of(source, where, f"number {i}", cell, MAX_DURATION_S if i == 1 else MAX_TERM)
            for i, cell in enumerate(cells, 1)
        ]
        pieces.append(Piece(values[0], *(tuple(values[i : i + 8]) for i in range(1, NUMBERS, 8))))
        if len(pieces) > MAX_PIECES:
            raise PlanFileError(source, where, f"more than {MAX_PIECES} pieces")
    try:
        return Trajectory(pieces)
    except TrajectoryError as error:
        raise refused(source, "", error) from None


def write_crazyswarm(trajectory: Trajectory) -> str:
    """The text of the file; a trajectory without yaw gets yaw 0. Raises TrajectoryError above degree 7."""
    lines = [HEADER]
    for number, piece in enumerate(trajectory.pieces, 1):
        values = [piece.duration_s]
        for axis, coefficients in (*piece.axes()[:3], ("yaw", piece.yaw or (0.0,))):
            values += _padded(number, axis, coefficients)
        lines.append(",".join(map(repr, values)))
    return "\n".join(lines) + "\n"


def _padded(number: int, axis: str, coefficients: Coefficients) -> Coefficients:
    if any(coefficients[DEGREE + 1 :]):
        raise TrajectoryError(f"the degree is above {DEGREE}, the most of this format", piece=number, axis=axis)
    return (*coefficients[: DEGREE + 1], *(0.0,) * (DEGREE + 1 - len(coefficients)))
