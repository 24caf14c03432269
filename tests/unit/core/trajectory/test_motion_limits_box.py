"""The box about a trajectory: nothing lies outside, and its sides are touched."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.motion_limits import BOX_TOLERANCE_M, bounding_box

coefficients = st.lists(st.floats(-20, 20), min_size=1, max_size=8).map(tuple)
pieces = st.builds(Piece, st.floats(0.1, 5.0), coefficients, coefficients, coefficients)


@given(st.lists(pieces, min_size=1, max_size=4))
def test_no_point_is_outside_and_each_side_is_nearly_reached(given_: list[Piece]) -> None:
    try:
        trajectory = Trajectory(given_)
    except Exception:
        return
    box = bounding_box(trajectory)
    samples = []
    for begin, piece in zip(trajectory.begins_s, given_, strict=True):
        samples += [trajectory.at(begin + piece.duration_s * i / 400).pos_enu_m for i in range(400)]
        samples += [tuple(sum(c * piece.duration_s**k for k, c in enumerate(axis)) for _, axis in piece.axes())]
    for axis in range(3):
        values = [sample[axis] for sample in samples]
        assert box.least_m[axis] <= min(values) + 1e-6 and box.most_m[axis] >= max(values) - 1e-6
        span = max(values) - min(values)
        assert box.most_m[axis] - max(values) <= BOX_TOLERANCE_M + 0.02 * span + 1e-6
        assert min(values) - box.least_m[axis] <= BOX_TOLERANCE_M + 0.02 * span + 1e-6


def test_a_peak_between_samples_is_found() -> None:
    """What is 0 at every tenth of a second and 1 between two of them would pass a sampled check."""
    spike = Piece(0.1, (0.0, 40.0, -400.0), (0.0,), (5.0,))
    box = bounding_box(Trajectory([Piece(1.0, (0.0,), (0.0,), (5.0,)), spike]))
    assert box.most_m == pytest.approx((1.0, 0.0, 5.0), abs=2e-3) and box.most_m[0] >= 1.0
    assert len(set(box.corners())) == 4
