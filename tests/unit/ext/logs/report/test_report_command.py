"""`skygcs-cli report`: what a folder holds and lacks, what is written and what is not overwritten."""

from __future__ import annotations

import csv
import json
import os
import random
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.ext.logs.report.gathering import END_US
from skygcs.tlog.format import encode_record
from support.command_line import ran
from support.examples import examples, thinned
from support.flight_log import T0_US, FlightLog
from support.flown_trace import flown_trace
from support.frames import frame, heartbeat
from support.public_data import CAPTURE, captures, own_capture, public_file, vehicles_of
from support.pymav_log import records
from support.table import each

COSTS = "a page and ten tables are written for each folder"

DONE, FAILED, USAGE = 0, 1, 2

VOID = {"meta", "line", "path", "circle", "rect"}
TABLES = ("summary", "flights", "tracking", "delays", "losses", "radios", "approaches", "events", "alarms", "files")
SVG_LEAVES = VOID - {"meta"}


class Page(HTMLParser):
    """Reads a page strictly: every tag is closed in its order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href") or name.startswith("on")]
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in SVG_LEAVES
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


run = partial(ran, "report")


def page_of(folder: Path, *args: str | Path, code: int = DONE) -> Page:
    out = folder.parent / f"{folder.name}.html"
    run(folder, "-o", out, *args, code=code)
    return Page(out.read_text(encoding="utf-8"))


def table(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@cache
def two_minutes() -> bytes:
    return FlightLog(2, 2.0).content(60.0)


@cache
def four_seconds() -> str:
    return flown_trace(4.0)


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """Two vehicles of two minutes, with a trace of the first."""
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "20260528T202640Z-0001.tlog").write_bytes(two_minutes())
    (folder / "control-v1-20260528-202700.csv").write_text(four_seconds())
    return folder


# -- what is in it


def test_the_day_is_in_page_and_tables(day: Path, tmp_path: Path) -> None:
    out, tables = tmp_path / "day.html", tmp_path / "csv"
    said = run(day, "-o", out, "--csv", tables).stdout
    assert said == f"{out}: 2 vehicles, 2 flights of 2026-05-28; 10 tables in {tables}\n"
    page = Page(out.read_text())
    for word in ("Field day 2026-05-28", "vehicle 1", "vehicle 2", "battery, charge", "height above home"):
        assert word in page.text, word
    assert sorted(path.stem for path in tables.iterdir()) == sorted(TABLES)
    assert page.tags.count("svg") == 1 + 2 * 4
    flights = table(tables, "flights")
    assert [row["vehicle"] for row in flights] == ["vehicle 1", "vehicle 2"]
    assert float(flights[0]["highest_m"]) == pytest.approx(7.0, abs=0.01)
    assert f"{float(flights[0]['highest_m']):g} m" in page.text
    (tracking,) = table(tables, "tracking")
    assert (tracking["file"], tracking["rows"]) == ("control-v1-20260528-202700.csv", "200")
    first = out.read_bytes()
    run(day, "-o", out, "--csv", tables)
    assert out.read_bytes() == first


def test_the_page_needs_nothing_else(day: Path) -> None:
    page = page_of(day)
    assert all(link.startswith("#") for link in page.links)
    assert not {"script", "link", "img", "iframe", "object", "form"} & set(page.tags)


def test_names_and_margins_come_from_the_fleet_file(day: Path, tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(
        '[links.u]\ntype = "udp_server"\nport = 14550\n[vehicles.alpha]\nsysid = 1\n'
        "[vehicles.alpha.separation]\nwingspan_m = 6.7\n[vehicles.bravo]\nsysid = 2\n"
    )
    page_of(day, "--fleet", fleet, "--csv", tmp_path / "csv")
    assert [row["vehicle"] for row in table(tmp_path / "csv", "summary")] == ["alpha", "bravo"]
    (pair,) = table(tmp_path / "csv", "approaches")
    assert (pair["first"], pair["second"], float(pair["margin_m"])) == ("alpha", "bravo", pytest.approx(5.5))
    broken = tmp_path / "broken.toml"
    broken.write_text("[")
    assert "broken.toml" in run(day, "-o", tmp_path / "x.html", "--fleet", broken, code=FAILED).stderr


def test_the_plan_is_over_or_beside_what_was_flown(day: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.csv"
    plan.write_text("vehicle,t,x,y,z,yaw\nv1,0,0,0,5,0\nv1,20,30,0,5,0\nv9,0,0,9,5,0\nv9,20,30,9,5,0\n")
    beside = page_of(day, "--plan", plan)
    assert beside.tags.count("svg") == 1 + 1 + 2 * 4
    assert "the place of the plan's origin is not known" in beside.text
    assert "the plan's paths of v9" in beside.text
    over = page_of(day, "--plan", plan, "--origin", "43.7806,-79.4653,180")
    assert over.tags.count("svg") == 1 + 2 * 4
    assert "plan.csv" in over.text and "is not known" not in over.text
    assert "no such" in run(day, "-o", tmp_path / "x.html", "--plan", tmp_path / "none.csv", code=FAILED).stderr.lower()
    assert not (tmp_path / "x.html").exists()


def test_alarms_of_the_daemon_are_shown_and_a_broken_list_is_named(day: Path) -> None:
    alarm = {
        **{"number": 1, "kind": "battery", "vehicle": "alpha", "other": None, "severity": "alarm"},
        "text": "<b>low</b>",
        **{"raised_unix_s": T0_US / 1e6 + 5, "changed_unix_s": T0_US / 1e6 + 6, "active": False, "count": 3},
        **{"consequences": {}, "acknowledged_by": None, "acknowledged_unix_s": None},
    }
    (day / "alarms.json").write_text(json.dumps({"format": 1, "last": 1, "alarms": [alarm]}))
    assert "<b>low</b>" in page_of(day).text
    for broken in ("{", "[]", '{"format": 1}', "[" * 5000, json.dumps({"format": 1, "last": 1, "alarms": [{}]})):
        (day / "alarms.json").write_text(broken)
        page_of(day, code=FAILED)


# -- bad input


def test_a_folder_without_logs_has_a_page_that_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    page = page_of(folder, code=FAILED)
    assert "Nothing recorded" in page.text and "no vehicle" in page.text


def test_what_is_no_folder_is_one_line(tmp_path: Path, day: Path) -> None:
    out = tmp_path / "x.html"
    assert "No such file" in run(tmp_path / "none", "-o", out, code=FAILED).stderr
    assert "Not a directory" in run(day / "20260528T202640Z-0001.tlog", "-o", out, code=FAILED).stderr
    assert "--output" in run(day, "-o", tmp_path / "x.pdf", code=USAGE).stderr
    assert "--day" in run(day, "-o", out, "--day", "yesterday", code=USAGE).stderr
    assert "--origin" in run(day, "-o", out, "--origin", "1,2", code=USAGE).stderr
    assert "--origin" in run(day, "-o", out, "--origin", "100,2,3", code=USAGE).stderr
    assert not out.exists()


def test_every_bad_file_is_named_with_what_is_missing(day: Path, tmp_path: Path) -> None:
    good = (day / "20260528T202640Z-0001.tlog").read_bytes()
    later = int(3600e6)
    (day / "cut.tlog").write_bytes(shifted(good, later)[:-7])
    (day / "empty.tlog").write_bytes(b"")
    (day / "noise.tlog").write_bytes(random.Random(1).randbytes(5000))
    (day / "capture.raw").write_bytes(b"".join(record[8:] for record in split(good)))
    (day / "notes.txt").write_text("hello")
    (day / "control-v2-20260528-202700.csv").write_text("# format = 7\n")
    (day / "cut.csv").write_text(flown_trace(1.0)[:-9])
    (day / "gone.tlog").symlink_to(tmp_path / "nowhere")
    (day / "inside.tlog").mkdir()
    os.mkfifo(day / "pipe.tlog")
    (day / "undo").mkdir()
    (day / "undo" / "one.json").write_text("{}")
    (day / "site").mkdir()
    (day / "site" / "a.tlog").write_bytes(good)
    page_of(day, "--csv", tmp_path / "csv", code=FAILED)
    files = {row["file"]: (row["state"], row["about"]) for row in table(tmp_path / "csv", "files")}
    states = {name: state for name, (state, _) in files.items()}
    assert states == {
        "20260528T202640Z-0001.tlog": "read",
        "capture.raw": "left out",
        "control-v1-20260528-202700.csv": "read",
        "control-v2-20260528-202700.csv": "cannot be read",
        "cut.csv": "read, with faults",
        "cut.tlog": "read, with faults",
        "empty.tlog": "cannot be read",
        "gone.tlog": "cannot be read",
        "inside.tlog": "cannot be read",
        "noise.tlog": "cannot be read",
        "notes.txt": "left out",
        "pipe.tlog": "cannot be read",
        "site/": "left out",
        "undo/": "left out",
    }
    assert "to the end of the file" in files["cut.tlog"][1]
    assert "not undone" in files["undo/"][1]
    assert len(table(tmp_path / "csv", "flights")) == 4


def test_times_that_no_clock_shows_are_passed_over(day: Path, tmp_path: Path) -> None:
    beat = heartbeat(9)
    late, never, zero = (1 << 64) - 1, (1 << 63) + 5, 0
    (day / "never.tlog").write_bytes(never.to_bytes(8, "big") + beat + late.to_bytes(8, "big") + beat)
    begin = T0_US + 300_000_000
    (day / "once.tlog").write_bytes(late.to_bytes(8, "big") + beat + begin.to_bytes(8, "big") + beat)
    (day / "zero.tlog").write_bytes(zero.to_bytes(8, "big") + beat)
    page_of(day, "--csv", tmp_path / "csv", code=FAILED)
    states = {row["file"]: row["state"] for row in table(tmp_path / "csv", "files")}
    assert (states["never.tlog"], states["zero.tlog"]) == ("cannot be read", "another day")
    assert states["once.tlog"].startswith("read")


@each("place", [{"x": 1e18}, {"x": 3e38, "y": -3e38}, {"z": -1e18}])
def test_a_place_that_is_nowhere_on_earth_is_no_part_of_a_flight(place: dict[str, float], tmp_path: Path) -> None:
    folder = make(tmp_path / "logs")
    armed, disarmed = (heartbeat(9, autopilot=3, base_mode=mode) for mode in (0x81, 0x01))
    here, there = (frame("LOCAL_POSITION_NED", values, sysid=9) for values in ({"x": 3.0, "z": -2.0}, place))
    for name, frames in (("alone", [there]), ("first", [there, here]), ("last", [here, there])):
        recorded = (disarmed, armed, *frames, armed, disarmed)
        (folder / "a.tlog").write_bytes(
            b"".join(encode_record(T0_US + n * 1_000_000, raw) for n, raw in enumerate(recorded))
        )
        run(folder, "-o", tmp_path / f"{name}.html", "--csv", tmp_path / name)
        (flight,) = table(tmp_path / name, "flights")
        expected = ("", "") if name == "alone" else ("0.0", "2.0")
        assert (flight["distance_m"], flight["highest_m"]) == expected


def test_no_time_of_a_report_is_after_its_last_year(tmp_path: Path) -> None:
    """A clock that steps by less than a day counts as one that ran, and comes to any year."""
    folder = make(tmp_path / "logs")
    begin_us = END_US - 1_000_000
    stamps = [begin_us + n * 23 * 3600 * 1_000_000 for n in range(10)] + [begin_us]
    (folder / "a.tlog").write_bytes(b"".join(encode_record(stamp, heartbeat(9)) for stamp in stamps))
    assert "2099-12-31 to 2100-01-01" in page_of(folder).text


def split(content: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(content):
        size = 8 + 12 + content[at + 9]
        yield content[at : at + size]
        at += size


def shifted(content: bytes, by_us: int) -> bytes:
    """The same records so much later."""
    return b"".join(
        (int.from_bytes(record[:8], "big") + by_us).to_bytes(8, "big") + record[8:] for record in split(content)
    )


def test_two_recordings_of_one_time_are_not_counted_twice(day: Path, tmp_path: Path) -> None:
    content = (day / "20260528T202640Z-0001.tlog").read_bytes()
    (day / "another-station.tlog").write_bytes(shifted(content, 5_000_000) + shifted(content, 70_000_000))
    page_of(day, "--csv", tmp_path / "csv")
    files = {row["file"]: row["state"] for row in table(tmp_path / "csv", "files")}
    assert files["another-station.tlog"] == "left out"
    assert len(table(tmp_path / "csv", "flights")) == 2


def test_files_of_one_recorder_are_one_recording(day: Path, tmp_path: Path) -> None:
    """Cut as the daemon cuts: no flight ends where a file does."""
    pieces = list(split((day / "20260528T202640Z-0001.tlog").read_bytes()))
    third = len(pieces) // 3
    for n in range(3):
        part = pieces[n * third : (n + 1) * third if n < 2 else None]
        (day / f"20260528T202640Z-{n + 1:04}.tlog").write_bytes(b"".join(part))
    page_of(day, "--csv", tmp_path / "csv")
    flights = table(tmp_path / "csv", "flights")
    assert [(row["flight"], row["whole"]) for row in flights] == [("1", "True"), ("1", "True")]
    assert [row["lost"] for row in table(tmp_path / "csv", "losses")] == ["0", "0", ""]


def test_the_newest_day_is_reported_and_others_are_offered(day: Path) -> None:
    content = (day / "20260528T202640Z-0001.tlog").read_bytes()
    (day / "next.tlog").write_bytes(shifted(content, int(24 * 3600e6)))
    newest = page_of(day)
    assert "Field day 2026-05-29" in newest.text
    assert "of 2026-05-28: --day 2026-05-28 reports it" in newest.text
    assert "Field day 2026-05-28" in page_of(day, "--day", "2026-05-28").text
    out = day.parent / "all.html"
    assert "4 flights of 2026-05-28 to 2026-05-29" in run(day, "-o", out, "--day", "all").stdout
    assert "no tlog was read" in run(day, "-o", out, "--day", "2001-01-01", code=FAILED).stderr


# -- what is written


def test_only_a_report_is_overwritten(day: Path, tmp_path: Path) -> None:
    out, tables = tmp_path / "day.html", tmp_path / "csv"
    out.write_text("<html>mine</html>")
    assert "exists and is not a report; --force" in run(day, "-o", out, code=FAILED).stderr
    assert out.read_text() == "<html>mine</html>"
    run(day, "-o", out, "--force")
    run(day, "-o", out, "--csv", tables)
    (tables / "events.csv").write_text("mine")
    before = out.read_bytes()
    (day / "more.tlog").write_bytes(shifted((day / "20260528T202640Z-0001.tlog").read_bytes(), int(600e6)))
    assert "events.csv: exists and is not a report" in run(day, "-o", out, "--csv", tables, code=FAILED).stderr
    assert (out.read_bytes(), (tables / "events.csv").read_text()) == (before, "mine")
    run(day, "-o", out, "--csv", tables, "--force")
    assert table(tables, "events") and out.read_bytes() != before
    assert "is a folder" in run(day, "-o", make(tmp_path / "folder.html"), "--force", code=FAILED).stderr
    assert "No such file" in run(day, "-o", tmp_path / "none" / "x.html", code=FAILED).stderr
    assert [path.name for path in tmp_path.rglob("*.part")] == []


def make(folder: Path) -> Path:
    folder.mkdir()
    return folder


def test_texts_of_vehicles_are_text(day: Path, tmp_path: Path) -> None:
    evil = "</td><script>alert(1)</script>"
    raw = [heartbeat(7), *(frame("STATUSTEXT", {"severity": n, "text": evil}, sysid=7, seq=n) for n in range(8))]
    raw.append(frame("STATUSTEXT", {"severity": 2, "text": "=HYPERLINK(1)"}, sysid=7, seq=9))
    start = T0_US + 300_000_000
    (day / "<img src=x>\u202e.tlog").write_bytes(
        b"".join((start + n).to_bytes(8, "big") + one for n, one in enumerate(raw))
    )
    fleet = tmp_path / "fleet.toml"
    fleet.write_text('[links.u]\ntype = "udp_server"\nport = 14550\n[vehicles.a_7]\nsysid = 7\n')
    page = page_of(day, "--csv", tmp_path / "csv", "--fleet", fleet)
    assert not {"script", "img"} & set(page.tags)
    assert "</td><script>alert(1)</script>" in page.text and "\u202e" not in page.text
    assert "<img src=x>\\u202e.tlog" in page.text
    texts = [row["text"] for row in table(tmp_path / "csv", "events") if row["vehicle"] == "a_7"]
    assert evil in texts and "'=HYPERLINK(1)" in texts  # no formula in a spreadsheet


@each("name", thinned(captures("tlog"), 3, turn=3))
def test_every_log_has_a_report(name: str, tmp_path: Path) -> None:
    folder = make(tmp_path / "logs")
    (folder / name).symlink_to(public_file(f"tlog/{name}"))
    page = tmp_path / "x.html"
    result = CliRunner().invoke(app, ["report", str(folder), "-o", str(page), "--csv", str(tmp_path / "csv")])
    assert "Traceback" not in result.output and page.exists()
    Page(page.read_text(encoding="utf-8"))
    left_out = "its times span" in table(tmp_path / "csv", "files")[0]["about"]
    assert result.exit_code == (FAILED if left_out else DONE), result.output
    if not left_out:
        found = {row["system"] for row in table(tmp_path / "csv", "summary")}
        assert found == vehicles_of(name).keys()


def test_status_texts_and_records_of_our_capture_against_pymavlink(tmp_path: Path) -> None:
    folder = make(tmp_path / "logs")
    (folder / "a.tlog").write_bytes(CAPTURE.read_bytes())
    page_of(folder, "--csv", tmp_path / "csv")
    read = list(records(own_capture("sitl-3ardupilot-2px4")))
    (file,) = table(tmp_path / "csv", "files")
    assert f"{len(read):,} records" in file["about"]
    by_source = {row["source"]: int(row["frames"]) for row in table(tmp_path / "csv", "losses")}
    assert sum(by_source.values()) == len(read)


@contextmanager
def folder_with(content: bytes) -> Iterator[Path]:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = make(Path(name) / "logs")
        (folder / "a.tlog").write_bytes(content)
        yield folder


SHORT = FlightLog(2, 1.0).content(12.0)


@settings(max_examples=examples(100), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.integers(0, len(SHORT) - 1), st.binary(max_size=12)), max_size=8), st.integers(0, 3000))
def test_whatever_is_in_a_tlog_there_is_a_page(damage: list[tuple[int, bytes]], cut: int) -> None:
    content = bytearray(SHORT)
    for at, junk in damage:
        content[at : at + len(junk)] = junk
    with folder_with(bytes(content[: len(content) - cut])) as folder:
        out = folder.parent / "x.html"
        result = CliRunner().invoke(app, ["report", str(folder), "-o", str(out)])
        assert result.exit_code in (DONE, FAILED), result.output + repr(result.exception)
        Page(out.read_text(encoding="utf-8"))
