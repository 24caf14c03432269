"""`link plan`: what it prints, and its exit code."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.core.params.names import SORTS
from skygcs.core.radio_link.capacity import PROFILES, SETPOINTS
from support.command_line import said
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2


run = partial(said, "link", "plan")


def test_what_fits_is_shown_with_its_shares() -> None:
    said = run("10")
    assert "a round of 11 nodes: 912 ms" in said
    assert "down, ground serial          2,005     5,760     2,880     35%" in said
    assert "each vehicle gets (Hz): HEARTBEAT 1, SYS_STATUS 0.5, GPS_RAW_INT 0.5, GLOBAL_POSITION_INT 2" in said
    assert "vehicles that fit with these options: 14" in said


def test_what_does_not_fit_is_reported_with_figures_and_a_proposal() -> None:
    said = run("10", "--setpoints", "position", "--setpoint-rate", "2", code=FAILED)
    assert "does not fit: up, the ground's slot carries 553 B/s, of which 259 may be planned with; 1,321 are wa" in said
    for proposal in ("one goto per vehicle", "4 vehicles instead of 10", "air speed 125 kbit/s for up to 5 vehicles"):
        assert f"would fit: {proposal}" in said


def test_json_holds_the_same() -> None:
    answer = json.loads(run("10", "--profile", "control-10", "--json", code=FAILED))
    assert (answer["fits"], answer["most_vehicles"]) == (False, 5)
    assert [one["fits"] for one in answer["directions"]] == [False, True, False, True]
    assert answer["rates_hz"]["GLOBAL_POSITION_INT"] < 10


def test_a_profile_of_ones_own_is_the_sum_of_its_messages() -> None:
    answer = json.loads(run("1", "--profile", "custom", "--rate", "attitude=5", "--air-speed", "none", "--json"))
    assert answer["down_per_vehicle_bytes_per_s"] == 21 + 5 * 40
    assert [one["name"] for one in answer["directions"]] == ["down, ground serial", "up, ground serial"]


@each(
    "args",
    [
        ("0",),
        ("3", "--profile", "racing"),
        ("3", "--rate", "ATTITUDE"),
        ("3", "--rate", "SPEED=1"),
        ("3", "--rate", "ATTITUDE=nan"),
        ("3", "--air-speed", "fast"),
        ("3", "--setpoints", "thrust"),
        ("3", "--setpoints", "position", "--setpoint-rate", "0"),
        ("3", "--fill", "2"),
    ],
)
def test_what_makes_no_sense_is_a_usage_error(args: tuple[str, ...]) -> None:
    run(*args, code=USAGE)


def test_the_help_names_what_there_is() -> None:
    """The lists themselves are imported only by the commands that need them."""
    shown = " ".join(CliRunner().invoke(app, ["link", "plan", "--help"], env={"COLUMNS": "200"}).output.split())
    assert f"{', '.join(PROFILES)}, or custom" in shown
    assert ", ".join(SETPOINTS) in shown
    shown = " ".join(CliRunner().invoke(app, ["param", "diff", "--help"], env={"COLUMNS": "200"}).output.split())
    assert f"{', '.join(SORTS[1:])}, or all" in shown


TIMING = """
kind = "radio timing"
version = 1
[[measurement]]
date = "2026-11-28T10:00:00+00:00"
banner = "RFD SiK 3.00MP"
multipoint = true
air_speed_kbps = 64
slot_s = 0.2
sync_s = 0.1
slot_bytes = 400.0
[[measurement]]
date = "2026-11-29T10:00:00+00:00"
banner = "RFD SiK 3.00MP"
multipoint = true
air_speed_kbps = 125
slot_s = 0.02
sync_s = 0.01
slot_bytes = 400.0
"""


def test_measured_timeslots_take_the_place_of_assumed_ones(tmp_path: Path) -> None:
    """Eleven slots of 0.2 s and a sync slot of 0.1 s are 2.3 s; 400 bytes a slot are 173.9 B/s."""
    file = tmp_path / "timing.toml"
    file.write_text(TIMING)
    answer = json.loads(run("10", "--timing", str(file), "--json", code=FAILED))
    assert answer["round_s"] == pytest.approx(2.3)
    assert answer["directions"][2]["capacity"] == pytest.approx(400 / 2.3)
    assert answer["timing"] == "measured on 2026-11-28 with RFD SiK 3.00MP"
    # a proposal for 125 kbit/s has what was measured there, where a round is 0.23 s
    assert any("air speed 125 kbit/s" in text for text in answer["proposals"])
    said = run("10", "--timing", str(file), "--air-speed", "125")
    assert "a round of 11 nodes: 230 ms (measured on 2026-11-29 with RFD SiK 3.00MP)" in said
    assert "(assumed, as open SiK multipoint)" in run("10")


def test_a_timing_file_that_does_not_go_with_the_options_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "timing.toml"
    said = run("10", "--timing", str(file), code=FAILED)
    assert "cannot be read: No such file" in " ".join(said.split())
    file.write_text(TIMING)
    said = " ".join(run("10", "--timing", str(file), "--air-speed", "250", code=FAILED).split())
    assert "was measured at AIR_SPEED 64, 125, and --air-speed is 250" in said
    assert "needs --air-speed" in run("10", "--timing", str(file), "--air-speed", "none", code=FAILED)
