"""`tlog plot`: what is in the picture and in the page; every public log has one."""

from __future__ import annotations

import math
import re
import sys
import xml.etree.ElementTree as ElementTree
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import numpy
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.logs.flight_plot import _looks, flight_figure, read_flight
from skygcs.ext.logs.trace_figures import p95, trace_figures
from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogReader
from skygcs.tlog.selection import Selection
from support.command_line import ran
from support.examples import thinned
from support.flight_log import T0_US, FlightLog
from support.frames import dialect, frame, heartbeat, offline
from support.public_data import CAPTURE, captures, public_file, vehicles_of
from support.table import each

COSTS = "matplotlib draws"

DONE, FAILED, USAGE = 0, 1, 2


run = partial(ran, "tlog", "plot")


def words(svg: str) -> str:
    return "\n".join(ElementTree.fromstring(svg).itertext())


@pytest.fixture(scope="module")
def nine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine vehicles of which the fourth is silent for 40 s."""
    data = FlightLog(9, 2.0).content(120.0, lose=0.01)
    kept = b""
    for record in LogReader(data, dialect()):
        if not (record.raw[5] == 4 and 40 < record.at_s < 80):
            kept += data[record.offset : record.offset + 8 + len(record.raw)]
    path = tmp_path_factory.mktemp("plot") / "nine.tlog"
    path.write_bytes(kept)
    return path


def test_nine_vehicles_are_all_in_the_picture(nine: Path, tmp_path: Path) -> None:
    out = tmp_path / "nine.svg"
    assert run(nine, "-o", out).stdout == f"{out}: 9 vehicles, 119.5 s\n"
    text = out.read_text()
    found = words(text)
    for word in (
        *("nine.tlog: 9 vehicles", "east, m", "north, m", "height, m", "battery, %", "battery, V", "modes", "link"),
        *("GUIDED", "LAND", "STABILIZE", "armed", "no loss", "silent for 3 s and more", "41 s", "farthest"),
        *("seconds since 2026-05-28 20:26:40 UTC", "ardupilot quadrotor", *(f"vehicle {n}" for n in range(1, 10))),
    ):
        assert word in found, word
    for n in range(1, 10):
        for what in ("track", "height", "battery", "mode", "loss"):
            assert f'id="v{n}.1-{what}"' in text, (n, what)
    assert [n for n in range(1, 10) if f'id="v{n}.1-silent"' in text] == [4]


def test_a_part_of_it_and_another_origin(nine: Path, tmp_path: Path) -> None:
    out = tmp_path / "part.svg"
    args = ("--vehicle", "2-3", "--from", "60", "--to", "1:30", "--origin", "43.7806,-79.4653")
    assert run(nine, "-o", out, *args).stdout == f"{out}: 2 vehicles, 29.5 s\n"
    found = words(out.read_text())
    assert "+ is 43.780600, -79.465300" in found
    assert "vehicle 3" in found and "vehicle 1" not in found
    assert "GUIDED" in found and "STABILIZE" not in found


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href") or name.endswith(":href")]

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_needs_nothing_else_and_shows_texts_as_text(tmp_path: Path) -> None:
    log, out = tmp_path / "<b>$\\frac{$.tlog", tmp_path / "out.html"
    evil = frame("STATUSTEXT", {"severity": 2, "text": "<script>alert(1)</script> $x$"})
    pieces = [heartbeat(1, autopilot=3, custom_mode=4), evil, heartbeat(1, autopilot=3, custom_mode=9)]
    content = b"".join(encode_record(T0_US + n * 1_000_000, raw) for n, raw in enumerate(pieces))
    log.write_bytes(content + b"cut")
    run(log, "-o", out)
    page = _Page()
    page.feed(out.read_text())
    assert page.tags.count("svg") == 1 and page.tags.count("script") == 1
    assert all(link.startswith("#") for link in page.links)
    assert not re.search(r"(src|href)=.https?://", out.read_text())
    for word in (
        *("<script>alert(1)</script> $x$", "critical", "GUIDED"),
        *("LAND", "<b>$\\frac{$.tlog", "3 bytes belong to no record"),
    ):
        assert word in page.text, word
    assert page.tags.count("input") == 1
    first = out.read_bytes()
    run(log, "-o", out)
    assert out.read_bytes() == first


@pytest.mark.deep  # draws
@each("name", thinned(captures("tlog") + captures("raw"), 2, turn=4))
def test_every_log_has_a_picture(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out.svg"
    run(public_file(f"tlog/{name}"), "-o", out)
    found = words(out.read_text())
    vehicles = len(vehicles_of(name))
    assert f"{name}: {vehicles} vehicle{'s' * (vehicles > 1)}, " in found and "modes" in found and "link" in found


def test_more_modes_than_colours_still_look_different(tmp_path: Path) -> None:
    modes = [f"MODE {n}" for n in range(96)]
    assert len(set(_looks(modes).values())) == 96
    log = tmp_path / "modes.tlog"
    copter = [0, 1, 2, 3, 4, 5, 6, 7, 9, 11, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27]
    log.write_bytes(
        b"".join(
            encode_record(T0_US + n * 1_000_000, heartbeat(1, seq=n, autopilot=3, base_mode=0x81, custom_mode=mode))
            for n, mode in enumerate(copter)
        )
    )
    flight, _ = read_flight(log, Selection(), None, offline())
    panel = flight_figure(flight, "modes").axes[-2]
    legend = panel.get_legend()
    assert legend is not None
    words = [text.get_text() for text in legend.get_texts()]
    assert words[0] == "STABILIZE" and words[-2:] == ["and 1 more", "armed"] and len(words) == 26
    run(log, "-o", tmp_path / "modes.html")
    assert "AUTO_RTL" in (tmp_path / "modes.html").read_text()


@pytest.mark.deep  # draws
def test_the_default_is_a_png_beside_the_log(tmp_path: Path) -> None:
    from matplotlib.image import imread

    log = tmp_path / "flight.tlog"
    log.write_bytes(CAPTURE.read_bytes()[:40_000])
    assert "5 vehicles, 8." in run(log).stdout
    picture = imread(tmp_path / "flight.png")
    assert picture.shape[1] == 1560 and picture.std() > 0.05


def test_what_can_not_be_drawn_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "gcs.tlog"
    log.write_bytes(encode_record(T0_US, heartbeat(255, 190, type=6, autopilot=8)))
    assert "no vehicle in the selection" in run(log, code=FAILED).stderr
    assert "does not end in" in run(log, "-o", "x.pdf", code=USAGE).output
    assert "--origin" in run(log, "--origin", "1", code=USAGE).output
    assert "--origin" in run(log, "--origin", "91,0", code=USAGE).output
    crowd = tmp_path / "crowd.tlog"
    crowd.write_bytes(b"".join(encode_record(T0_US + n, heartbeat(n)) for n in range(1, 60)))
    assert "59 vehicles; choose up to 36 with --vehicle" in " ".join(run(crowd, code=FAILED).stderr.split())
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "pip install 'skygcs[plot]'" in " ".join(run(crowd, code=FAILED).stderr.split())


# -- Figures of a trace against numpy's, and what they mean.


distances = st.lists(st.one_of(st.floats(0, 1e3), st.just(math.nan)), max_size=60)


@given(distances, distances)
def test_figures_are_numpys_and_nan_is_nothing(errors_m: list[float], ages_ms: list[float]) -> None:
    measured = trace_figures(len(errors_m), 1.0, errors_m, ages_ms, None)
    known = numpy.array([error for error in errors_m if not math.isnan(error)])
    if not len(known):
        assert math.isnan(measured.rms_error_m) and math.isnan(measured.p95_error_m)
        assert math.isnan(measured.largest_error_m)
        return
    assert measured.rms_error_m == pytest.approx(numpy.sqrt(numpy.mean(known**2)))
    assert measured.largest_error_m == known.max()
    assert measured.p95_error_m in known
    assert numpy.mean(known <= measured.p95_error_m) >= 0.95


def test_p95_of_a_hundred_is_the_96th() -> None:
    assert p95([float(n) for n in range(100)]) == 95.0
    assert math.isnan(p95([]))
