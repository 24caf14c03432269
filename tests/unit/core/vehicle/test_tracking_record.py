"""The tracking error that margins are made of: of moving references and of standing ones, each by itself."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.core.vehicle.offboard_controller import OffboardController
from skygcs.core.vehicle.tracking_record import LEAST_S, SAMPLE_S, TrackingRecord
from support.table import each

MINUTE = round(LEAST_S / SAMPLE_S) + 2
"""Samples."""


class Flight:
    """A vehicle that is so far off its reference, sample by sample."""

    def __init__(self) -> None:
        self.record = TrackingRecord()
        self.now = 0.0

    def fly(self, samples: int, off_m: float, *, moves: bool, at_m: float = 0.0, velocity_only: bool = False) -> None:
        for _ in range(samples):
            self.now += SAMPLE_S
            reference: Any = SimpleNamespace(pos_enu_m=(at_m, 0.0, 10.0), moves=moves, velocity_only=velocity_only)
            here, now = (at_m, 0.0, 10.0 + off_m), self.now
            controller = SimpleNamespace(reference=reference, measured=lambda here=here, now=now: (here, now))
            self.record.observe(cast("OffboardController", controller), self.now)


def test_a_height_that_wanders_in_hover_is_not_averaged_away() -> None:
    flight = Flight()
    flight.fly(MINUTE, 0.2, moves=True)
    assert flight.record.tracking_error_m == pytest.approx(0.2, rel=0.06)
    flight.fly(1, 0.1, moves=False)
    flight.fly(40 * MINUTE, 0.1, moves=False)
    flight.fly(MINUTE, 0.8, moves=False)
    assert flight.record.tracking_error_m == pytest.approx(0.8, rel=0.06)
    assert flight.record.measured_s == pytest.approx((42 * MINUTE + 1) * SAMPLE_S, rel=0.5)


def test_a_calm_hover_does_not_lower_the_error_of_moving_references() -> None:
    flight = Flight()
    flight.fly(MINUTE, 0.6, moves=True)
    flight.fly(100 * MINUTE, 0.02, moves=False)
    assert flight.record.tracking_error_m == pytest.approx(0.6, rel=0.06)


def test_the_way_to_a_place_that_was_set_is_no_error() -> None:
    flight = Flight()
    flight.fly(MINUTE, 0.3, moves=True)
    flight.fly(2 * MINUTE, 30.0, moves=False)
    assert flight.record.tracking_error_m == pytest.approx(0.3, rel=0.06)
    # there, and then set elsewhere: on its way again
    flight.fly(MINUTE, 0.1, moves=False)
    flight.fly(2 * MINUTE, 30.0, moves=False, at_m=5.0)
    assert flight.record.tracking_error_m == pytest.approx(0.3, rel=0.06)


def test_without_a_minute_of_moving_references_there_is_no_answer() -> None:
    flight = Flight()
    flight.fly(10 * MINUTE, 0.1, moves=False)
    flight.fly(10 * MINUTE, 0.1, moves=True, velocity_only=True)
    assert flight.record.tracking_error_m is None


@each("delay_s", [0.0, 0.3])
def test_a_position_is_compared_with_the_reference_of_its_own_time(delay_s: float) -> None:
    """Two a second, and each comes late; ticks at 50 Hz; 2 m/s, and always 0.3 m beside the reference."""
    record, speed_mps = TrackingRecord(), 2.0
    for tick in range(50 * 70):
        now = tick / 50
        reference: Any = SimpleNamespace(pos_enu_m=(speed_mps * now, 0.0, 10.0), moves=True, velocity_only=False)
        at = max(0.0, math.floor(2.0 * (now - delay_s)) / 2.0)
        here = (speed_mps * at, 0.3, 10.0)
        record.observe(cast("Any", SimpleNamespace(reference=reference, measured=lambda m=(here, at): m)), now)
    assert record.tracking_error_m == pytest.approx(0.3, rel=0.06)
    assert record.measured_s == pytest.approx(70.0, rel=0.05)


def test_a_position_from_before_the_references_that_are_known_does_not_count() -> None:
    record = TrackingRecord()
    for tick in range(50 * 70):
        now = tick / 50
        reference: Any = SimpleNamespace(pos_enu_m=(2.0 * now, 0.0, 10.0), moves=True, velocity_only=False)
        record.observe(
            cast("Any", SimpleNamespace(reference=reference, measured=lambda t=now: ((0.0, 0.0, 0.0), t - 9))), now
        )
    assert record.tracking_error_m is None and record.measured_s == 0.0
