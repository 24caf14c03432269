"""The radio benchmark measures what it says, on a small cell."""

from __future__ import annotations

from bench.radio.__main__ import _missed
from bench.radio.cell import Measured, measure, percentile


def test_a_planned_cell_is_measured_whole() -> None:
    told = measure("skygcs", 2, 64.0, settle_s=12.0, measure_s=10.0).as_dict()
    assert told["heard"] == told["emergency_reached"] == 2
    assert 0 < told["age_p50_s"] <= told["age_p95_s"] < 2.5
    assert 1.0 < told["positions_per_vehicle_per_s"] < 2.5
    assert told["commands"] == 20 and told["lost_commands"] == 0
    assert told["usable_s"] < 10 and told["emergency_max_s"] < 1.0


def test_a_plain_cell_leaves_the_streams_as_they_are_and_downloads_parameters() -> None:
    told = measure("plain", 2, 64.0, settle_s=5.0, measure_s=5.0).as_dict()
    assert told["positions_per_vehicle_per_s"] > 2.2, "an ArduCopter's four a second"


def test_percentiles_of_nothing_are_none_and_of_one_are_that_one() -> None:
    assert percentile([], 0.5) is None
    assert percentile([3.0], 0.95) == 3.0
    assert percentile([1.0, 2.0, 3.0, 4.0], 0.5) == 3.0


def test_what_misses_its_target_is_named_with_the_figures() -> None:
    bad = Measured("skygcs", 10, 64.0, round_s=0.9, ages_s=[3.0], acks_s=[1.0], commands=5, lost_commands=1)
    missed = _missed([bad.as_dict()])
    assert any("position age p95 3.0 (target 2.50)" in text for text in missed)
    assert any("lost commands 1" in text for text in missed)
    assert any("reached 0 of them" in text for text in missed)
    beyond = Measured("skygcs", 15, 64.0, round_s=1.3, ages_s=[9.0])
    assert _missed([beyond.as_dict(), Measured("plain", 10, 64.0).as_dict()]) == []
