"""`skygcs-cli plot`: a figure of a control trace."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from functools import partial
from pathlib import Path

import pytest

from skygcs.core.control import ControlConfig, Estimate, Memory, Reference
from skygcs.core.control.trace import TraceRow, TraceWriter
from support.command_line import said
from support.flown_trace import HEAD, flown_trace

COSTS = "matplotlib draws"

DONE, FAILED, USAGE = 0, 1, 2


run = partial(said, "plot")


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plot") / "alpha.csv"
    path.write_text(flown_trace(20.0), encoding="utf-8")
    return path


def words(svg: Path) -> str:
    root = ElementTree.parse(svg).getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    return "\n".join(root.itertext())


def test_everything_an_engineer_asks_is_in_the_figure(trace: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.svg"
    text = run(trace, "-o", file)
    assert text.startswith(f"{file}: 1,000 rows, 20.0 s; error ")
    found = words(file)
    for word in (
        *("alpha: 1,000 rows", "estimate", "reference", "x, m", "y, m", "z, m", "error, m", "rms"),
        *("thrust, 0..1", "tilt, °", "hover", "new gains", "age of the state", "time between steps", "time, s"),
        *("attitude: all loops here", "velocity: position loop here", "nothing sent", "limits reached (|): "),
    ):
        assert word in found, word
    assert "position: no loop here" not in found


def test_the_default_is_a_png_beside_the_trace(trace: Path) -> None:
    from matplotlib.image import imread

    assert str(trace.with_suffix(".png")) in run(trace)
    picture = imread(trace.with_suffix(".png"))
    blue = (abs(picture[..., :3] - (0, 0x72 / 255, 0xB2 / 255)) < 0.02).all(axis=2)
    assert picture.shape[0] > 1000 and blue.sum() > 2000


def test_a_span_of_it(trace: Path, tmp_path: Path) -> None:
    text = run(trace, "-o", tmp_path / "a.svg", "--from", "5", "--to", "7.005")
    assert "101 rows, 2.0 s" in text
    assert "no row between" in run(trace, "-o", tmp_path / "b.svg", "--from", "500", code=FAILED)
    assert not (tmp_path / "b.svg").exists()


def row(t_s: float, way: str | None, reference: Reference | None, estimate: Estimate | None) -> TraceRow:
    return TraceRow(t_s, 0.02, way, True, reference, estimate, None)


def file_of(folder: Path, *rows: TraceRow) -> Path:
    writer = TraceWriter(HEAD)
    path = folder / "x.csv"
    path.write_text("".join(writer.lines(r, ControlConfig(), Memory(), Memory()) for r in rows))
    return path


@pytest.mark.deep  # draws twice
def test_rows_without_reference_or_estimate_are_drawn_as_gaps_and_each_time_alike(tmp_path: Path) -> None:
    path = file_of(tmp_path, row(7.0, None, None, None), row(7.02, "position", None, None))
    for name in ("x.svg", "again.svg"):
        assert "2 rows, 0.0 s" in run(path, "-o", tmp_path / name)
    assert "position: no loop here" in words(tmp_path / "x.svg")
    assert (tmp_path / "x.svg").read_bytes() == (tmp_path / "again.svg").read_bytes()


@pytest.mark.deep  # draws
def test_an_axis_that_follows_a_velocity_has_no_error(tmp_path: Path) -> None:
    here = Estimate((3.0, 4.0, 5.0), (0.0, 0.0, 0.0))
    level = Reference((0.0, 0.0, 4.0), velocity_only_xy=True)
    path = file_of(tmp_path, *(row(n * 0.02, "velocity", level, here) for n in range(3)))
    assert "error 1.00 m rms, 1.00 m at most" in run(path, "-o", tmp_path / "x.svg")


@pytest.mark.deep  # draws
def test_a_pause_breaks_the_curves_and_counts_no_row(tmp_path: Path) -> None:
    here, there = Estimate((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)), Reference((1.0, 0.0, 5.0))
    path = file_of(tmp_path, *(row(t, "position", there, here) for t in (0.0, 0.02, 60.0, 60.02)))
    assert "4 rows, 60.0 s; error 1.00 m rms" in run(path, "-o", tmp_path / "x.svg")
    assert "nothing sent" in words(tmp_path / "x.svg")


def test_what_cannot_be_drawn_is_one_line(trace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "--output" in run(trace, "-o", tmp_path / "x.pdf", code=USAGE)
    run(trace, "--from", "3", "--to", "2", code=USAGE)
    assert "No such file" in run(tmp_path / "none.csv", code=FAILED)
    assert "No such file" in run(trace, "-o", tmp_path / "none" / "x.png", code=FAILED)
    (tmp_path / "empty.csv").write_text("".join(flown_trace(0.1).splitlines(keepends=True)[:4]))
    assert "no row in it" in run(tmp_path / "empty.csv", code=FAILED)
    cut = tmp_path / "cut.csv"
    cut.write_text(flown_trace(1.0)[:-9])
    assert "was cut off and is left out" in run(cut, "-o", tmp_path / "cut.svg")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "pip install 'skygcs[plot]'" in run(trace, "-o", tmp_path / "y.png", code=FAILED)
    assert not (tmp_path / "y.png").exists()
