"""Curves, tracks and loss of any length stay small and still show what matters."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.logs.curves import FIRST_TOLERANCE_M, GAP_S, Curve, LossCurve, Track


@given(st.lists(st.tuples(st.floats(0, 2.0), st.floats(-1e3, 1e3)), min_size=1, max_size=400), st.integers(4, 40))
def test_a_curve_is_bounded_ordered_and_keeps_its_extremes(steps: list[tuple[float, float]], most: int) -> None:
    curve = Curve(most)
    now = 0.0
    for step_s, value in steps:
        now += step_s
        curve.add(now, value)
    times, values = curve.points()
    shown = [v for v in values if not math.isnan(v)]
    assert len(shown) <= 4 * most
    assert times == sorted(times)
    assert (min(shown), max(shown)) == (min(v for _, v in steps), max(v for _, v in steps)) == curve.extremes()
    assert times[-1] == now


def test_a_single_spike_in_a_day_of_telemetry_is_seen() -> None:
    curve = Curve()
    for n in range(200_000):
        curve.add(n * 0.4, 1000.0 if n == 123_456 else float(n % 7))
    times, values = curve.points()
    assert len(times) <= 6001
    assert abs(times[values.index(1000.0)] - 123_456 * 0.4) < 1e-6


def test_a_pause_breaks_the_line_until_it_is_finer_than_a_bucket() -> None:
    curve = Curve(100)
    for t_s in (0.0, 1.0, 1.0 + GAP_S + 0.1, 2.0 + GAP_S):
        curve.add(t_s, 1.0)
    values = curve.points()[1]
    assert [math.isnan(v) for v in values] == [False, False, True, False, False]
    for n in range(2000):
        curve.add(100.0 + n * (GAP_S + 1), 2.0)
    assert len(curve.points()[0]) <= 500


def test_what_is_not_finite_is_no_part_of_a_curve() -> None:
    curve = Curve()
    curve.add(0.0, math.nan)
    curve.add(0.0, math.inf)
    assert not curve and curve.extremes() is None and curve.points() == ([], [])


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=300), st.integers(5, 60))
def test_every_place_is_near_the_drawn_track(places: list[tuple[float, float]], most: int) -> None:
    track = Track(most)
    for n, (x, y) in enumerate(places):
        track.add(n * 0.1, x, y)
    assert len(track.points) <= most
    drawn = list(zip(*track.line(), strict=True))
    # a place is left out for being near a kept one, which a coarser pass may leave out in turn: twice the tolerance
    assert all(min(math.dist(place, point) for point in drawn) <= 2 * track.tolerance_m for place in places)
    assert track.ends == (places[0], places[-1])


def test_a_track_of_hours_keeps_its_shape() -> None:
    track = Track()
    for n in range(100_000):
        track.add(n * 0.2, 500 * math.cos(n / 3000), 500 * math.sin(n / 3000))
    xs, ys = track.line()
    assert len(xs) <= 4001 and track.tolerance_m <= 128 * FIRST_TOLERANCE_M
    assert all(abs(math.hypot(x, y) - 500) < 0.01 for x, y in zip(xs, ys, strict=True))


def test_a_pause_breaks_the_track_and_stays_when_it_is_thinned() -> None:
    track = Track(10)
    track.add(0.0, 0.0, 0.0)
    track.add(100.0, 1.0, 0.0)
    assert math.isnan(track.line()[0][1])
    for n in range(100):
        track.add(100.0 + 0.1 * n, 1.0 + n, 0.0)
    assert any(math.isnan(x) for x in track.line()[0])


def test_a_shifted_track_is_the_same_about_another_origin() -> None:
    track = Track()
    track.add(0.0, 1.0, 2.0)
    track.add(0.1, 1.001, 2.0)
    track.shift(-1.0, 3.0)
    ends = track.ends
    assert ends is not None and ends[0] == (0.0, 5.0) and math.isclose(ends[1][0], 0.001, abs_tol=1e-9)
    assert Track().ends is None


@given(st.lists(st.tuples(st.floats(0, 40.0), st.integers(0, 5)), max_size=300))
def test_loss_is_counted_exactly_however_coarse_its_pieces(frames: list[tuple[float, int]]) -> None:
    curve = LossCurve(most=16)
    now = 0.0
    for step_s, lost in frames:
        now += step_s
        curve.add(now, lost)
    whole = curve.ratios(max(now, 1.0) + curve.width_s)
    lost, received = sum(lost for _, lost in frames), len(frames)
    assert whole == ([lost / (lost + received)] if frames else [])
    assert len(curve.ratios(0.0)) <= 16


def test_a_piece_without_frames_has_no_loss_to_tell() -> None:
    curve = LossCurve()
    curve.add(0.5, 0)
    curve.add(3.5, 1)
    curve.add(3.6, -1)
    assert curve.ratios(1.0) == [0.0, None, None, 0.0]
    assert curve.ratios(2.0) == [0.0, 0.0] and curve.pieces(2.0) == 2
