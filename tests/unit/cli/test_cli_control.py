"""`skygcs-cli control` and `track`: what they ask, show and how they exit."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli import render
from skygcs.cli.control import TRACK_COLUMNS, track_cells, track_line, track_table
from skygcs.cli.main import app
from skygcs.core.control.trace import COLUMNS
from support.controlled import FLYING, OFF, Commanded
from support.fake_daemon import FakeOutcome
from support.flown_trace import flown_trace
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as fleet:
        yield fleet


@pytest.mark.parametrize("mode", ["off", "position", "velocity", "attitude"])
def test_control_is_set_by_one_word(fleet: Commanded, mode: str) -> None:
    assert "ok" in fleet.run("control", "set", "alpha", mode)
    assert fleet.vehicles["alpha"].orders == [("control", {"mode": mode, "force": False})]


def test_a_vehicle_that_is_not_taken_says_why(fleet: Commanded) -> None:
    fleet.vehicles["bravo"].outcome = FakeOutcome(False, "refused", "refused: not armed")
    text = fleet.run("control", "set", "all", "attitude", code=FAILED)
    assert "FAIL bravo" in text and "not armed" in text
    fleet.run("control", "set", "all", "sideways", code=USAGE)


def test_gains_without_options_are_a_table_of_all(fleet: Commanded) -> None:
    lines = fleet.run("control", "gains").splitlines()
    assert lines[0].split() == ["gain", "alpha", "bravo", "carol"]
    assert ["xy.vel_p", "0.08", "0.08", "0.08"] in [line.split() for line in lines]
    assert ["hover_thrust", "0.45"] in [line.split() for line in fleet.run("control", "gains", "bravo").splitlines()]
    assert fleet.json("control", "gains", "alpha")["gains"]["alpha"]["z"]["vel_p"] == 0.3


def test_changed_gains_are_reported_old_and_new(fleet: Commanded) -> None:
    text = fleet.run("control", "gains", "1,2", "--xy-vel-p", "0.1", "--z-pos-p", "1.2", "--hover", "0.5", "--force")
    assert "alpha: xy.vel_p 0.08 -> 0.1, z.pos_p_per_s 1 -> 1.2, hover_thrust 0.45 -> 0.5" in text
    changes = {"xy": {"vel_p": 0.1}, "z": {"pos_p_per_s": 1.2}, "hover_thrust": 0.5}
    assert fleet.vehicles["bravo"].orders == [("change_gains", {"changes": changes, "force": True})]
    answer = fleet.json("control", "gains", "alpha", "--xy-vel-i", "0")
    assert (answer["before"]["alpha"]["xy"]["vel_i"], answer["after"]["alpha"]["xy"]["vel_i"]) == (0.02, 0)


def test_gains_that_are_refused_change_nothing_and_exit_1(fleet: Commanded) -> None:
    fleet.vehicles["alpha"].outcome = FakeOutcome(False, "refused", "refused: the delay leaves no margin")
    text = fleet.run("control", "gains", "alpha", "--xy-vel-p", "5", code=FAILED)
    assert "no margin" in text and "->" not in text
    fleet.run("control", "gains", "alpha", "--xy-vel-p", "nan", code=USAGE)
    fleet.run("control", "gains", "alpha", "--xy-vel-p", "1000", code=USAGE)


def test_recording_prints_the_files(fleet: Commanded) -> None:
    wanted = ["alpha: /logs/alpha.csv", "bravo: /logs/bravo.csv"]
    assert fleet.run("control", "record", "1,2", "on").splitlines() == wanted
    assert fleet.run("control", "record", "alpha", "off") == "alpha: nothing was being recorded\n"
    assert fleet.json("control", "record", "alpha", "off") == {"files": {"alpha": None}}


def test_status_and_track_once_show_the_same_table(fleet: Commanded) -> None:
    fleet.vehicles["alpha"].control_told = FLYING
    shown = fleet.run("control", "status")
    assert shown == fleet.run("track", "--once")
    assert "0.3 -0.4" in shown.replace("0.30", "0.3").replace("-0.40", "-0.4") and "91 ms" in shown
    assert [s["vehicle"] for s in fleet.json("control", "status", "1,2")] == ["alpha", "bravo"]
    lines = fleet.run("track", "--once", "--json").splitlines()
    assert [json.loads(line)["control"]["state"] for line in lines] == ["flying", "off", "off"]


def test_track_on_a_pipe_is_a_line_for_each_update(fleet: Commanded) -> None:
    fleet.vehicles["alpha"].control_told = {
        **FLYING,
        "control_mode": "velocity",
        "reasons": ["delay 0.2 s (limit 0.1 s)"],
        "stream": {"client": "client 3 (python)", "left_s": 0.4},
    }
    (line,) = fleet.run("track", "alpha", "--count", "1").splitlines()
    assert line.startswith("alpha  attitude  velocity  error 0.50 m")
    assert line.endswith("limits tilt  (delay 0.2 s (limit 0.1 s); follows the setpoints of client 3 (python))")
    (line,) = fleet.run("track", "alpha", "--count", "1", "--json").splitlines()
    assert json.loads(line)["control"]["ticks"] == 12345


def state(name: str = "alpha", **control: Any) -> dict[str, Any]:
    return {"name": name, "sysid": 1, "control": {**FLYING, **control}}


def text_of(renderable: Any, width: int) -> str:
    from rich.console import Console

    screen = Console(width=width, highlight=False)
    with screen.capture() as capture:
        screen.print(renderable)
    return capture.get()


def test_each_column_has_a_cell_of_its_own() -> None:
    cells = dict(zip(TRACK_COLUMNS, track_cells(state()), strict=True))
    assert cells == {
        "name": "alpha",
        "mode": "attitude",
        "control_mode": "attitude",
        "error": "0.50 m",
        "x y z error": " 0.30 -0.40  0.00",
        "age": "85 ms",
        "delay p95": "91 ms",
        "rtt": "12 ms",
        "rate": "50 Hz",
        "ticks": "12345",
        "late": "2",
        "skipped": "1",
        "thrust": "0.46",
        "roll pitch": "   1°   -3°",
        "limits": "tilt",
    }


@each("control", [None, {}, OFF])
def test_a_vehicle_that_is_not_controlled_is_off(control: Any) -> None:
    cells = track_cells({"name": "alpha", "control": control})
    assert cells[:2] == ("alpha", "off") and not any(cells[2:])
    assert track_line({"name": "alpha", "control": control}) == "alpha  off"


def test_a_held_vehicle_says_so_and_why_below_the_table() -> None:
    shown = text_of(
        track_table([state(state="held", control_mode=None, reasons=["state is 0.62 s old (limit 0.5 s)"])]), 200
    )
    assert "held" in shown
    assert "alpha: state is 0.62 s old (limit 0.5 s)" in shown.splitlines()[-1]


@each("width", [60, 80, 120])
def test_a_narrow_terminal_keeps_whole_what_counts(width: int) -> None:
    lines = text_of(track_table([state(), state("bravo", state="off")], width), width).splitlines()
    assert len(lines) == 3 and all(len(line) <= width for line in lines)
    for word in ("alpha", "attitude", "0.50 m", "85 ms", "91 ms"):
        assert word in lines[1]


def test_no_vehicle_is_reported() -> None:
    assert "no vehicle heard yet" in text_of(track_table([]), render.PIPE_WIDTH)


# --- replay ----------------------------------------------------------------------------------------------------------


def replayed(path: Path, *args: str, code: int = DONE) -> str:
    result = CliRunner().invoke(app, ["control", "replay", str(path), *args])
    assert result.exit_code == code, result.output + repr(result.exception)
    return result.output


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    path = tmp_path / "alpha.csv"
    path.write_text(flown_trace(30.0), encoding="utf-8")
    return path


def test_a_trace_is_replayed_without_a_daemon(trace: Path) -> None:
    assert replayed(trace) == "alpha: 1,425 steps, all bit-identical\n"
    wanted = {"vehicle": "alpha", "steps": 1425, "mismatches": 0, "first": [], "cut_line": None}
    assert json.loads(replayed(trace, "--json")) == wanted


def test_a_difference_is_reported_by_line_and_column_and_exits_1(trace: Path) -> None:
    lines = trace.read_text().splitlines(keepends=True)
    cells = lines[99].split(",")
    cells[COLUMNS.index("thrust")] = "0.45000000000000007"
    lines[99] = ",".join(cells)
    trace.write_text("".join(lines))
    text = replayed(trace, code=FAILED)
    assert f"{trace}:100: thrust is 0.45000000000000007, the law gives 0." in text
    assert "1 cells differ" not in text and "1 cell differs" in text


def test_only_the_first_differences_are_reported(trace: Path) -> None:
    text = trace.read_text().replace('"vel_i": 0.02', '"vel_i": 0.021', 1)
    trace.write_text(text)
    lines = replayed(trace, code=FAILED).splitlines()
    assert len(lines) == 12 and lines[10].startswith("… and ")


def test_a_cut_line_is_reported_and_left_out(trace: Path) -> None:
    trace.write_text(trace.read_text()[:-20])
    text = replayed(trace)
    assert text.startswith("line 1507 is incomplete") and "1,424 steps, all bit-identical" in text


@each(("content", "word"), [(b"", "no line of columns"), (b"\xff\x00" * 9000, "longer than 16384"), (b"a,b\n", ":1: ")])
def test_what_is_no_trace_is_one_line(tmp_path: Path, content: bytes, word: str) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    text = replayed(path, code=FAILED)
    assert word in text and str(path) in text and text.count("\n") == 1
    assert "No such file" in replayed(tmp_path / "none.csv", code=FAILED)
