"""The radio benchmark measures what it says, on a small cell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench.commanded_daemon import Column, Measured, percentile
from bench.radio import report
from bench.radio.cell import measure
from support.table import each


def test_a_planned_cell_is_measured_whole() -> None:
    told = measure("skygcs", 2, 64.0, settle_s=12.0, measure_s=10.0).as_dict()
    assert told["heard"] == told["emergency_reached"] == 2
    assert 0 < told["age_p50_s"] <= told["age_p95_s"] < 2.5
    assert 1.0 < told["positions_per_vehicle_per_s"] < 2.5
    assert told["commands"] == 4 and told["lost_commands"] == 0
    assert told["usable_s"] < 10 and told["emergency_max_s"] < 1.0


@pytest.mark.deep  # seconds of a whole cell; make test measures the planned one
def test_a_plain_cell_leaves_the_streams_as_they_are_and_downloads_parameters() -> None:
    told = measure("plain", 2, 64.0, settle_s=5.0, measure_s=5.0).as_dict()
    assert told["positions_per_vehicle_per_s"] > 2.2, "an ArduCopter's four a second"


def test_percentiles_of_nothing_are_none_and_of_one_are_that_one() -> None:
    assert percentile([], 0.5) is None
    assert percentile([3.0], 0.95) == 3.0
    assert percentile([1.0, 2.0, 3.0, 4.0], 0.5) == 3.0


def cell(column: Column, vehicles: int, air_kbps: float, **figures: Any) -> dict[str, Any]:
    """One that meets every target, but for ``figures``."""
    good = {"round_s": 0.9, "ages_s": [1.0], "acks_s": [1.0], "commands": 5, "emergency_s": [0.5] * vehicles}
    return Measured(column, vehicles, air_kbps, heard=vehicles, **{**good, **figures}).as_dict()


def test_every_target_is_judged_on_every_cell_that_is_to_be_carried() -> None:
    rows = [cell("skygcs", n, air) for air in (64.0, 125.0) for n in (2, 10, 15)]
    told = report.verdicts(rows)
    assert len(told) == 4 * 5 and all(v.met for v in told)
    assert not any("15 vehicles at 64" in v.where for v in told)
    summary = report.summary(told).splitlines()
    assert summary[0].startswith("20 of 20 targets")
    assert {line.split(": ")[0] for line in summary[1:]} == {
        "met     10 vehicles at 64 kbit/s",
        "met     15 vehicles at 125 kbit/s",
    }


@each(
    ("figures", "said"),
    [
        ({"ages_s": [3.0]}, "position age p95 <= 2.5 s: 3.00 s"),
        ({"acks_s": [2.4]}, "command ACK p95 <= 2.30 s (two rounds + 0.5 s): 2.40 s"),
        ({"acks_s": []}, "command ACK p95 <= 2.30 s (two rounds + 0.5 s): - s"),
        ({"lost_commands": 1}, "no command lost after its repeats: 1 of 5"),
        ({"emergency_s": [0.5] * 9}, "9 of 10, the last after 0.50 s"),
        ({"emergency_s": [0.5] * 9 + [2.4]}, "10 of 10, the last after 2.40 s"),
    ],
)
def test_what_misses_its_target_is_named_with_the_figures_and_the_arithmetic(
    figures: dict[str, Any], said: str
) -> None:
    (missed,) = [v.line() for v in report.verdicts([cell("skygcs", 10, 64.0, **figures)]) if not v.met]
    assert missed.startswith("MISSED  10 vehicles at 64 kbit/s")
    assert said in missed
    assert missed in report.summary(report.verdicts([cell("skygcs", 10, 64.0, **figures), cell("skygcs", 10, 64.0)]))
    assert "a round takes 0.90 s" in missed and "a vehicle's slot 200 of 553 B/s" in missed


def test_a_plain_column_that_does_not_collapse_is_told() -> None:
    rows = [cell("plain", 4, 64.0, ages_s=[9.0]), cell("plain", 8, 64.0, ages_s=[9.0]), cell("plain", 10, 64.0)]
    assert [(v.where, v.met) for v in report.collapse(rows)] == [
        ("8 vehicles at 64 kbit/s", True),
        ("10 vehicles at 64 kbit/s", False),
    ]


def test_the_table_has_both_columns_of_each_number_side_by_side() -> None:
    rows = [cell("plain", 4, 64.0, ages_s=[9.0], acks_s=[]), cell("skygcs", 4, 64.0, usable_s=5.04)]
    lines = {line[:28].strip(): line[28:].split() for line in report.table(rows).splitlines()}
    assert lines["64 kbit/s"] == ["4", "vehicles"]
    assert lines[""] in ([], ["plain", "skygcs"])
    assert lines["position age p95 (s)"] == ["9.00", "1.00"]
    assert lines["command ACK p95 (s)"] == ["-", "1.00"]
    assert lines["all usable after (s)"] == ["never", "5.0"]


@pytest.mark.deep  # matplotlib draws
def test_the_picture_is_drawn_of_cells_with_gaps(tmp_path: Path) -> None:
    rows = [cell(column, n, air) for air in (64.0, 125.0) for n in (4, 10) for column in ("plain", "skygcs")]
    rows[0] |= {"age_p95_s": None, "emergency_max_s": None}
    rows[1]["usable_s"] = 4.0
    report.picture(rows, tmp_path / "radio.png")
    assert (tmp_path / "radio.png").read_bytes().startswith(b"\x89PNG")
