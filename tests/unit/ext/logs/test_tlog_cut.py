"""`tlog filter`, `merge` and `split`: which records are in which file, and not one byte of them changed."""

from __future__ import annotations

import signal
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.tlog.files import Outputs
from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogReader
from support.command_line import ran
from support.examples import thinned
from support.flight_log import T0_US, FlightLog
from support.frames import dialect, frame, heartbeat, offline, unknown_frame
from support.public_data import CAPTURE, PUBLIC, captures, public_file
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2


run = partial(ran, "tlog")


def words(output: str) -> str:
    """Without the box that a usage error stands in."""
    return " ".join(output.replace("│", " ").split())


def records(path: Path) -> list[tuple[int, bytes]]:
    reader = LogReader(path.read_bytes(), offline())
    found = [(r.unix_us, r.raw) for r in reader]
    assert reader.faults.skipped_bytes == 0
    return found


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    path = tmp_path / "flight.tlog"
    path.write_bytes(FlightLog(3, 2.0).content(30.0))
    return path


def test_a_filter_takes_time_vehicle_and_message(flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tlog"
    reported = run(
        "filter", flight, out, "--vehicle", "2", "--message", "attitude,SYS_STATUS", "--from", "10", "--to", "0:20"
    )
    found = records(out)
    assert reported.stdout == f"{out}: {len(found)} of {len(records(flight))} records\n"
    assert set(found) < set(records(flight))
    for unix_us, raw in found:
        assert 10.0 <= (unix_us - T0_US) / 1e6 <= 20.01
        assert raw[5] == 2 and int.from_bytes(raw[7:10], "little") in (1, 30)
    assert len(found) == 20 + 10  # ATTITUDE at 2 Hz, SYS_STATUS at 1 Hz


def test_a_time_of_day_is_utc(flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tlog"
    run("filter", flight, out, "--from", "2026-05-28T20:26:50", "--to", "2026-05-28T22:26:52+02:00")
    assert T0_US == 1_780_000_000_000_000
    assert {(us - T0_US) // 1_000_000 for us, _ in records(out)} == {10, 11, 12}
    assert max(us for us, _ in records(out)) == T0_US + 12_000_000


def test_names_come_from_the_fleet_file(flight: Path, tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text("[vehicles.bravo]\nsysid = 2\n[vehicles.charlie]\nsysid = 3\n")
    out = tmp_path / "out.tlog"
    run("filter", flight, out, "--vehicle", "bravo,1", "--fleet", fleet)
    assert {raw[5] for _, raw in records(out)} == {1, 2}
    reported = run("filter", flight, out, "--vehicle", "bravo", "--force", code=USAGE).output
    assert "names need --fleet" in words(reported)
    reported = run("filter", flight, out, "--vehicle", "delta", "--fleet", fleet, "--force", code=USAGE).output
    assert "the fleet file has bravo, charlie" in words(reported)


@each(
    ("options", "complaint"),
    [
        (["--vehicle", "300"], "not an id"),
        (["--vehicle", "5-2"], "not a system id"),
        (["--vehicle", ""], "not a system id"),
        (["--message", "NOPE"], "has no message 'NOPE'"),
        (["--from", "soon"], "neither seconds"),
        (["--from", "-1"], "not a number of seconds"),
        (["--from", "nan"], "not a number of seconds"),
        (["--from", "20", "--to", "10"], "must be later"),
    ],
)
def test_a_wrong_option_is_a_usage_error_that_says_which(
    flight: Path, tmp_path: Path, options: list[str], complaint: str
) -> None:
    assert complaint in words(run("filter", flight, tmp_path / "out.tlog", *options, code=USAGE).output)
    assert not (tmp_path / "out.tlog").exists()


def test_nothing_is_overwritten_unasked_and_nothing_half_written_stays(flight: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tlog"
    out.write_text("mine")
    assert "exists; --force overwrites it" in run("filter", flight, out, code=FAILED).stderr
    assert out.read_text() == "mine"
    assert "no record matches" in run("filter", flight, out, "--vehicle", "9", "--force", code=FAILED).stderr
    assert out.read_text() == "mine"
    run("filter", flight, out, "--force")
    assert out.read_bytes() == flight.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight.tlog", "out.tlog"]
    run("filter", flight, flight, "--vehicle", "1", "--force")
    assert {raw[5] for _, raw in records(flight)} == {1}
    assert "No such file" in run("filter", flight, tmp_path / "no" / "out.tlog", code=FAILED).stderr


def test_what_nobody_vouches_for_stays_unless_a_sender_is_asked_for(tmp_path: Path) -> None:
    bad = bytearray(heartbeat(1))
    bad[-1] ^= 1
    pieces = [heartbeat(1), bytes(bad), unknown_frame(sysid=1), unknown_frame(sysid=2), heartbeat(1)]
    log, out = tmp_path / "in.tlog", tmp_path / "out.tlog"
    log.write_bytes(b"".join(encode_record(T0_US + n, raw) for n, raw in enumerate(pieces)) + b"\0\0cut")
    reported = run("filter", log, out)
    assert [raw for _, raw in records(out)] == pieces
    assert "5 bytes belong to no record: at byte" in reported.stderr
    reported = run("filter", log, out, "--vehicle", "1", "--force")
    assert [raw for _, raw in records(out)] == [pieces[0], pieces[2], pieces[4]]
    assert "1 of the records left out have a wrong CRC" in reported.stderr


def test_two_autopilots_of_one_system_are_two_vehicles(tmp_path: Path) -> None:
    def order(system: int, component: int) -> bytes:
        fields = {"target_system": system, "target_component": component, "command": 400}
        return frame("COMMAND_LONG", fields, sysid=255, compid=190)

    first = [heartbeat(1), order(1, 1), order(1, 0), heartbeat(1, compid=100, type=30, autopilot=8)]
    second, rest = [heartbeat(1, compid=2), order(1, 2)], [order(0, 2), heartbeat(255, compid=190, type=6, autopilot=8)]
    log = tmp_path / "in.tlog"
    log.write_bytes(b"".join(encode_record(T0_US + n, raw) for n, raw in enumerate(second + first + rest)))
    assert run("split", log).stdout == "".join(
        f"{tmp_path / f'in-{part}.tlog'}: {count} records\n" for part, count in (("1", 4), ("1.2", 2), ("rest", 2))
    )
    for part, pieces in (("1", first), ("1.2", second), ("rest", rest)):
        assert [raw for _, raw in records(tmp_path / f"in-{part}.tlog")] == pieces


def test_a_log_of_thousands_of_vehicles_opens_no_thousands_of_files(tmp_path: Path) -> None:
    log = tmp_path / "in.tlog"
    ids = [(1 + n % 250, 1 + n // 250) for n in range(300)]
    log.write_bytes(b"".join(encode_record(T0_US + n, heartbeat(*key)) for n, key in enumerate(ids)))
    assert "300 vehicles; at most 255 can be split" in run("split", log, code=FAILED).stderr
    assert list(tmp_path.iterdir()) == [log]


def test_what_is_cut_from_a_raw_capture_is_no_tlog(tmp_path: Path) -> None:
    log, out = tmp_path / "flight.raw", tmp_path / "out.tlog"
    log.write_bytes(b"".join(heartbeat(n % 2 + 1, seq=n // 2) for n in range(40)))
    reported = run("filter", log, out, code=FAILED).stderr
    assert "flight.raw is a raw capture, whose frames have no times" in reported and "name it out.raw" in reported
    assert not out.exists()
    misnamed = log.rename(tmp_path / "flight.tlog")
    run("split", misnamed)
    assert sorted(p.name for p in tmp_path.glob("flight-*")) == ["flight-1.raw", "flight-2.raw"]


def test_a_raw_capture_stays_one_and_has_no_time_of_day(tmp_path: Path) -> None:
    log, out = tmp_path / "in.raw", tmp_path / "out.raw"
    log.write_bytes(b"".join(heartbeat(n % 2 + 1, seq=n // 2) for n in range(40)))
    assert run("filter", log, out, "--vehicle", "1").stdout == f"{out}: 20 of 40 frames\n"
    assert out.read_bytes() == b"".join(heartbeat(1, seq=n) for n in range(20))
    assert "no time of day" in run("filter", log, out, "--from", "2026-01-01", "--force", code=FAILED).stderr
    assert "has no times, so it cannot be merged" in run("merge", log, "-o", tmp_path / "m.tlog", code=FAILED).stderr


def test_a_merge_is_by_time_and_stable(tmp_path: Path) -> None:
    def log(name: str, *times_us: int, sysid: int) -> Path:
        path = tmp_path / name
        path.write_bytes(b"".join(encode_record(T0_US + t, heartbeat(sysid, seq=n)) for n, t in enumerate(times_us)))
        return path

    a = log("a.tlog", 0, 10, 5, 20, sysid=1)  # its time goes backwards once
    b = log("b.tlog", 0, 6, 20, sysid=2)
    out = tmp_path / "out.tlog"
    assert run("merge", a, b, "-o", out).stdout == f"{out}: 7 records of 2 files\n"
    found = [(raw[5], raw[4], us - T0_US) for us, raw in records(out)]
    assert found == [(1, 0, 0), (2, 0, 0), (2, 1, 6), (1, 1, 10), (1, 2, 5), (1, 3, 20), (2, 2, 20)]

    # a damaged time moves nothing behind all other files; a clock that was set does
    day = 86_400_000_000
    c, d = log("c.tlog", 0, 1 << 62, 7, -T0_US, 9, sysid=1), log("d.tlog", 1 << 62, 3, 8, 2 * day, 2 * day + 1, sysid=2)
    assert run("merge", c, d, "-o", out, "--force").stdout == f"{out}: 10 records of 2 files\n"
    found = [(raw[5], raw[4]) for _, raw in records(out)]
    assert found == [(1, 0), (1, 1), (2, 0), (2, 1), (1, 2), (1, 3), (2, 2), (1, 4), (2, 3), (2, 4)]

    hour = 3_600_000_000
    g, h = log("g.tlog", 0, hour, 7, sysid=1), log("h.tlog", 3, 8, sysid=2)
    run("merge", g, h, "-o", out, "--force")
    assert [(raw[5], raw[4]) for _, raw in records(out)] == [(1, 0), (1, 1), (2, 0), (1, 2), (2, 1)]

    # days without a record are no damage
    e, f = log("e.tlog", 0, 2 * day, 4 * day, 4 * day + 1, sysid=1), log("f.tlog", day, 3 * day, 5 * day, sysid=2)
    run("merge", e, f, "-o", out, "--force")
    assert [(raw[5], raw[4]) for _, raw in records(out)] == [(1, 0), (2, 0), (1, 1), (2, 1), (1, 2), (1, 3), (2, 2)]


def test_a_split_loses_nothing_and_a_merge_puts_it_together_again(tmp_path: Path) -> None:
    run("split", CAPTURE, "-o", tmp_path / "parts")
    parts = sorted((tmp_path / "parts").iterdir())
    assert [path.name for path in parts] == [f"{CAPTURE.stem}-{n}.tlog" for n in (1, 2, 3, 4, 5, "rest")]
    for path in parts[:5]:
        sysid = int(path.stem[-1])
        for _, raw in records(path):
            info = offline().messages[int.from_bytes(raw[7:10], "little")]
            assert raw[5] == sysid or raw[10 + info.target_system_offset] == sysid
    whole = tmp_path / "whole.tlog"
    run("merge", *parts, "-o", whole)
    assert sorted(records(whole)) == sorted(records(CAPTURE))
    assert [us for us, _ in records(whole)] == [us for us, _ in records(CAPTURE)]


def test_orders_are_in_the_log_of_the_vehicle_they_were_for(tmp_path: Path) -> None:
    def order(target: int) -> bytes:
        return frame("COMMAND_LONG", {"target_system": target, "command": 400}, sysid=255, compid=190)

    bad = bytearray(heartbeat(1))
    bad[-1] ^= 1
    pieces = [heartbeat(1), heartbeat(2), order(1), order(2), order(0), order(9), bytes(bad)]
    pieces.append(heartbeat(1, compid=100, type=30, autopilot=8))
    log = tmp_path / "in.tlog"
    log.write_bytes(b"".join(encode_record(T0_US + n, raw) for n, raw in enumerate(pieces)))
    reported = run("split", log)
    assert [line.rsplit(": ")[1] for line in reported.stdout.splitlines()] == ["3 records", "2 records", "3 records"]
    assert [raw for _, raw in records(tmp_path / "in-1.tlog")] == [pieces[0], pieces[2], pieces[7]]
    assert [raw for _, raw in records(tmp_path / "in-2.tlog")] == [pieces[1], pieces[3]]
    assert "no vehicle in it" in run("split", tmp_path / "in-rest.tlog", code=FAILED).stderr


@each("name", thinned(captures("tlog"), 6, turn=5))
def test_every_log_is_split_and_merged_whole(name: str, tmp_path: Path) -> None:
    path = public_file(f"tlog/{name}")
    run("split", path, "-o", tmp_path)
    out = tmp_path / "again"
    run("merge", *sorted(tmp_path.glob("*.tlog")), "-o", out)
    original = [(r.unix_us, r.raw) for r in LogReader(path.read_bytes(), offline())]
    # records that no CRC vouches for need a neighbour to be believed, and have others now
    good = {raw for _, raw in original}
    assert len(records_of(out) & good) >= 0.99 * len(good)


def records_of(path: Path) -> set[bytes]:
    return {r.raw for r in LogReader(path.read_bytes(), offline())}


def test_help_names_every_tool() -> None:
    reported = CliRunner().invoke(app, ["tlog", "--help"]).output
    for word in ("info", "filter", "merge", "split", "csv", "plot", "play"):
        assert word in reported
    assert PUBLIC and dialect()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_the_program_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """A closed terminal left a part of gigabytes."""
    before = signal.signal(number, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit) as ended, Outputs(force=False) as outputs:
            outputs.open_bytes(tmp_path / "out.tlog").write(b"half")
            close = (file := outputs.open_bytes(tmp_path / "other.tlog")).close
            monkeypatch.setattr(file, "close", lambda: (close(), signal.raise_signal(number)))  # one more at its end
            if signal.getsignal(number) is not signal.SIG_DFL:  # else it would end the tests
                signal.raise_signal(number)
        assert ended.value.code == 128 + number and list(tmp_path.iterdir()) == []
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
