"""The terms of the margin and the metric it is measured in."""

from __future__ import annotations

import math

import pytest

from skygcs.core.separation import Footprint, pair_margin, separation_m


def test_defaults_make_the_margin_of_the_benches() -> None:
    assert pair_margin(Footprint(), Footprint()).total_m == pytest.approx(2.5)


def test_each_vehicle_brings_its_own_terms() -> None:
    large, small = Footprint(3.0, 0.5, 3.0), Footprint(0.5, 0.1, 1.5)
    margin = pair_margin(large, small)
    assert (margin.wingspans_m, margin.position_errors_m, margin.downwash_ratio) == (1.75, 0.6, 3.0)
    assert margin == pair_margin(small, large)


def test_two_above_each_other_need_the_ratio_more() -> None:
    assert separation_m(3.0, 4.0, 0.0, 2.0) == pytest.approx(5.0)
    assert separation_m(0.0, 0.0, -5.0, 2.0) == pytest.approx(2.5)
    assert separation_m(2.0, 3.0, 12.0, 2.0) == pytest.approx(7.0)


def test_the_ball_grows_with_the_square_of_the_age() -> None:
    assert Footprint(acceleration_mps2=2.0).ball_m(3.0) == pytest.approx(9.0)
    assert Footprint().ball_m(0.0) == 0.0
    assert math.isinf(Footprint().ball_m(math.inf))
