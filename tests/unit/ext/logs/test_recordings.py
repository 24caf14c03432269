"""Recordings: found, chosen and read."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from skygcs.errors import RefusedError
from skygcs.ext.logs import recordings
from skygcs.ext.logs.recordings import Found, recording_of, recordings_in
from skygcs.tlog.format import LogEntry, LogKind, encode_record
from skygcs.tlog.reading import LogReader
from skygcs.tlog.selection import Selection
from skygcs.tlog.timeline import LONGEST_GAP_S, REORDERED_S, Pace, Timeline
from support.examples import thinned
from support.flight_log import T0_US, FlightLog
from support.frames import dialect, frame, heartbeat, noise, offline, unknown_frame
from support.public_data import CAPTURE, capture, captures, own_capture
from support.table import each

# -- Recordings of a folder: which are listed, and that no name leads out of it.


def put(folder: Path, name: str, changed: float = 1e9, content: bytes = b"x") -> Path:
    path = folder / name
    path.write_bytes(content)
    os.utime(path, (changed, changed))
    return path


def test_the_newest_come_first_and_only_recordings_are_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for n in range(5):
        put(tmp_path, f"20261128T18000{n}Z-000{n}.tlog", 1e9 + n, b"x" * n)
    put(tmp_path, "events.jsonl")
    put(tmp_path, "day.tlog.part")
    (tmp_path / "folder.tlog").mkdir()
    (tmp_path / "link.tlog").symlink_to(tmp_path / "events.jsonl")
    found, more = recordings_in(tmp_path)
    assert [f.name[-6] for f in found] == ["4", "3", "2", "1", "0"] and more == 0
    assert found[0].size_bytes == 4
    monkeypatch.setattr(recordings, "MAX_LISTED", 2)
    found, more = recordings_in(tmp_path)
    assert len(found) == 2 and more == 3
    assert recordings_in(tmp_path / "not there") == ([], 0)


def test_the_begin_is_that_of_the_name() -> None:
    begun = Found("20261128T181512Z-0001.tlog", 1, 2.0).begun_unix_s
    assert begun == datetime(2026, 11, 28, 18, 15, 12, tzinfo=UTC).timestamp()
    assert Found("00000000T000000Z-0001.tlog", 1, 2.0).begun_unix_s is None
    assert Found("flight.tlog", 1, 2.0).begun_unix_s is None


@each(
    "name",
    [
        "../secret.tlog",
        "/etc/passwd",
        "a/b.tlog",
        "..tlog",
        ".hidden.tlog",
        "a.tlog\n",
        "a.tlog/",
        "",
        "x" * 200 + ".tlog",
    ],
)
def test_a_name_that_is_none_of_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "logs").mkdir()
    put(tmp_path, "secret.tlog")
    with pytest.raises(RefusedError, match="is not the name of a recording"):
        recording_of(tmp_path / "logs", name)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings, and others outside of it that a name could lead to."""
    above = tmp_path_factory.mktemp("station")
    folder = above / "logs"
    (folder / "sub").mkdir(parents=True)
    for place in (folder, folder / "sub", above):
        put(place, "a.tlog")
        put(place, "secret.tlog" if place != folder else "b.tlog")
    (folder / "link.tlog").symlink_to(above / "secret.tlog")
    return folder


PARTS = ["..", ".", "/", "\\", "a", "b", "sub", "link", "logs", "secret", ".tlog", "\0", "\n", "%2e%2e", "~"]


@given(st.lists(st.sampled_from(PARTS), max_size=8).map("".join) | st.text(max_size=40))
@example("../secret.tlog")
@example("sub/a.tlog")
@example("./a.tlog")
@example("link.tlog")
@example("../logs/a.tlog")
@example("a.tlog")
def test_no_text_leads_out_of_the_folder(logs: Path, name: str) -> None:
    for text in (name, f"{name}.tlog", f"{logs.parent}/{name}", f"../{name}"):
        try:
            found = recording_of(logs, text)
        except RefusedError:
            assert text not in ("a.tlog", "b.tlog")
        else:
            assert found in (logs / "a.tlog", logs / "b.tlog") and text == found.name


def test_a_link_or_a_folder_is_no_recording(tmp_path: Path) -> None:
    target = put(tmp_path, "there.tlog")
    (tmp_path / "link.tlog").symlink_to(target)
    (tmp_path / "folder.tlog").mkdir()
    assert recording_of(tmp_path, "there.tlog") == target
    for name in ("link.tlog", "folder.tlog"):
        with pytest.raises(RefusedError, match="not a regular file"):
            recording_of(tmp_path, name)
    with pytest.raises(RefusedError, match="No such file"):
        recording_of(tmp_path, "gone.tlog")


# -- A log as one sequence of entries: times that never run backwards, faults told with their byte.


def read(data: bytes, kind: LogKind = "tlog") -> tuple[list[LogEntry], LogReader]:
    reader = LogReader(data, offline(), kind)
    return list(reader), reader


def log(*records: tuple[float, bytes]) -> bytes:
    return b"".join(encode_record(T0_US + round(t_s * 1e6), raw) for t_s, raw in records)


@each("name", thinned(captures("tlog"), 6, turn=3))
def test_faults_of_a_tlog_are_those_that_an_independent_walker_found(name: str) -> None:
    data, expected = capture(name)
    entries, reader = read(data)
    status, faults = expected["status"], reader.faults
    assert (faults.bad_crc.count, faults.unknown.count, faults.skipped_bytes) == tuple(
        status.get(key, 0) for key in ("badcrc", "unknown", "skipped_bytes")
    )
    assert faults.out_of_order + faults.clock_steps.count == expected["ts_backwards"]
    assert Counter(entry.verdict for entry in entries)["ok"] == status["ok"]
    times = [entry.at_s for entry in entries]
    assert times == sorted(times)
    assert round(times[-1], 1) == expected["duration_s"]


def test_a_sound_log_has_nothing_to_tell() -> None:
    entries, reader = read(CAPTURE.read_bytes())
    assert len(entries) == 8144
    assert reader.faults.lines() == []


def test_each_fault_is_told_with_its_byte() -> None:
    bad = bytearray(heartbeat(2))
    bad[-1] ^= 1
    whole = log((0, heartbeat(1)), (1, bytes(bad)), (2, unknown_frame(msgid=54321)), (1.75, heartbeat(1)))
    at_bad, at_unknown = 8 + len(heartbeat(1)), 2 * (8 + len(heartbeat(1)))
    at_last = at_unknown + 8 + len(unknown_frame())
    garbage = noise(100, 3)
    cut = log((3, heartbeat(1)))[:-3]
    later = log((400 * 86_400, heartbeat(1)))
    lines = read(whole + garbage + later + cut)[1].faults.lines()
    assert lines == [
        f"1 record with a wrong CRC, not decoded: at byte {at_bad}",
        f"1 record of messages the dialect does not have (id 54321 ×1): at byte {at_unknown}",
        f"{100 + len(cut)} bytes belong to no record: at byte {len(whole)} (100 bytes), "
        f"{len(whole) + 100 + len(later)} ({len(cut)} to the end of the file)",
        f"the time goes backwards once: at byte {at_last} (by 0.250000 s)",
        f"the clock steps by more than a day once: at byte {len(whole) + 100} (by +400.0 days)",
    ]


def test_a_record_a_few_milliseconds_older_is_counted_and_no_fault() -> None:
    data = log((0, heartbeat(1)), (1, heartbeat(1)), (0.9901, heartbeat(1)), (2, heartbeat(1)), (1.98, heartbeat(1)))
    faults = read(data)[1].faults
    assert (faults.out_of_order, faults.most_backwards_us, faults.backwards.count) == (2, 20_000, 1)
    assert faults.lines() == ["the time goes backwards once: at byte 116 (by 0.020000 s)"]


@each("name", ["px4-late-frames", "forged-heartbeat-50hz", "second-heartbeat-1hz"])
def test_own_recordings_of_before_one_clock_are_not_complained_of(name: str) -> None:
    """Two ways of recording stamped by two clocks: up to 3.3 ms backwards."""
    faults = read(own_capture(name))[1].faults
    assert faults.out_of_order > 70
    assert faults.lines() == []


def test_many_faults_are_all_counted_and_a_few_named() -> None:
    bad = bytearray(heartbeat(2))
    bad[-1] ^= 1
    size = 8 + len(bad)
    unknown = [unknown_frame(msgid=9_000_000 + n) for n in range(20)]
    data = log((0, heartbeat(1)), *((n, bytes(bad)) for n in range(1500)), *((2000, raw) for raw in unknown))
    crc, ids = read(data)[1].faults.lines()
    assert crc == f"1,500 records with a wrong CRC, not decoded: at byte {size}, {2 * size}, {3 * size} …"
    assert ids.startswith("20 records of messages") and ids.count("×") == 8


@given(st.integers(0, 2000))
def test_a_log_cut_anywhere_loses_its_last_record_and_says_so(cut: int) -> None:
    data = FlightLog(1, 2.0).content(4.0)
    entries, reader = read(data[: min(cut, len(data))])
    end = sum(8 + len(entry.raw) for entry in entries)
    assert data[:end] == b"".join(encode_record(entry.unix_us or 0, entry.raw) for entry in entries)
    assert reader.faults.skipped_bytes == min(cut, len(data)) - end
    assert bool(reader.faults.lines()) == (end != min(cut, len(data)))


def test_a_raw_capture_has_no_times_but_those_of_its_senders() -> None:
    flight = FlightLog(3, 5.0)
    records, _ = read(flight.content(20.0))
    raw, reader = read(b"".join(entry.raw for entry in records), "raw")
    assert [entry.raw for entry in raw] == [entry.raw for entry in records]
    assert reader.faults.lines() == []
    assert {entry.unix_us for entry in raw} == {None}
    for own, stamped in zip(raw, records, strict=True):
        assert stamped.at_s - 0.4 <= own.at_s <= stamped.at_s + 0.001


def test_faults_of_a_raw_capture_are_told_to_within_4_kb() -> None:
    bad = bytearray(heartbeat(1))
    bad[-1] ^= 1
    data = (
        heartbeat(1) * 300
        + bytes(bad) * 3
        + noise(50, 1).replace(b"\xfd", b"").replace(b"\xfe", b"")
        + heartbeat(1) * 9
    )
    lines = read(data, "raw")[1].faults.lines()
    assert all(line.count("4096") == 1 and "in the 4 kB from byte 4096" in line for line in lines) and len(lines) == 2


def own_times(*boots_s: float, sysid: int = 1) -> list[float]:
    frames = [frame("ATTITUDE", {"time_boot_ms": round(1000 * b)}, sysid=sysid) for b in boots_s]
    return [entry.at_s for entry in read(b"".join(frames), "raw")[0]]


def test_a_senders_reboot_or_wild_clock_does_not_move_the_time() -> None:
    assert own_times(100.0, 101.0, 2.0, 3.0) == [0.0, 1.0, 1.0, 2.0]
    assert own_times(100.0, 4_000_000.0, 4_000_001.0) == [0.0, 0.0, 1.0]
    assert own_times(100.0, 101.0, 100.5, 101.5) == [0.0, 1.0, 1.0, 1.5]


def test_two_senders_clocks_run_side_by_side() -> None:
    pieces = [
        frame("ATTITUDE", {"time_boot_ms": boot_ms}, sysid=sysid)
        for sysid, boot_ms in ((1, 900_000), (1, 901_000), (2, 5_000), (1, 902_000), (2, 6_000), (2, 7_000))
    ]
    assert [entry.at_s for entry in read(b"".join(pieces), "raw")[0]] == [0.0, 1.0, 1.0, 2.0, 2.0, 3.0]


@given(st.lists(st.integers(0, 1 << 40), min_size=1))
def test_the_timeline_never_runs_backwards(times_us: list[int]) -> None:
    timeline = Timeline()
    times = [timeline.at_s(t) for t in times_us]
    assert times == sorted(times)


def test_records_out_of_order_are_simultaneous_and_a_clock_set_back_takes_no_time() -> None:
    timeline = Timeline()
    steps = (0.0, 10.0, 10.0 - REORDERED_S, 11.0, 1.0, 2.0)
    assert [timeline.at_s(round(t * 1e6)) for t in steps] == [0.0, 10.0, 10.0, 11.0, 11.0, 12.0]
    assert timeline.set_back == 1


def test_the_pace_keeps_the_recordings_time_and_cuts_long_pauses() -> None:
    pace = Pace(2.0)
    wanted = [*(0.0, 0.5, 0.5), *(0.5 + LONGEST_GAP_S / 2, 1.5 + LONGEST_GAP_S / 2)]
    assert [pace.due_s(t) for t in (5.0, 6.0, 6.0, 1006.0, 1008.0)] == wanted
    at_once = Pace(0.0)
    assert [at_once.due_s(t) for t in (0.0, 100.0)] == [0.0, 0.0]


def test_megabytes_of_noise_are_one_fault() -> None:
    entries, reader = read(noise(300_000, 2))
    assert entries == [] and len(reader.faults.lines()) == 1
    assert read(b"", "raw")[0] == [] and dialect().messages


# -- Which entries are taken: by time, sender, addressee and message.


ATTITUDE = 30


def entries() -> list[LogEntry]:
    """Nine entries, one a second."""
    bad = bytearray(heartbeat(1))
    bad[-1] ^= 1
    frames = [
        *(heartbeat(1), heartbeat(2), heartbeat(1, compid=190), frame("ATTITUDE", sysid=1), bytes(bad)),
        frame("COMMAND_LONG", {"target_system": 1, "target_component": 1, "command": 400}, sysid=255, compid=190),
        frame("COMMAND_LONG", {"target_system": 2, "target_component": 1, "command": 400}, sysid=255, compid=190),
        *(unknown_frame(sysid=2), heartbeat(1)),
    ]
    data = b"".join(encode_record(T0_US + n * 1_000_000, raw) for n, raw in enumerate(frames))
    return list(LogReader(data, dialect(), "tlog"))


def taken(**wanted: object) -> list[int]:
    selection = Selection(**wanted)  # type: ignore[arg-type]
    return [n for n, entry in enumerate(entries()) if selection.takes(entry)]


@each(
    ("wanted", "found"),
    [
        ({}, [0, 1, 2, 3, 4, 5, 6, 7, 8]),
        ({"begin": 2.0, "end": 4.0}, [2, 3, 4]),
        ({"begin": T0_US + 2_000_000, "end": T0_US + 4_000_000}, [2, 3, 4]),
        ({"begin": T0_US + 2_000_001}, [3, 4, 5, 6, 7, 8]),
        ({"sources": frozenset({(1, None)})}, [0, 2, 3, 8]),
        ({"sources": frozenset({(1, 1)})}, [0, 3, 8]),
        ({"sources": frozenset({(2, None)})}, [1, 7]),
        ({"sources": frozenset({(1, None)}), "addressed": True}, [0, 2, 3, 5, 8]),
        ({"sources": frozenset({(1, 190)}), "addressed": True}, [2]),
        ({"messages": frozenset({ATTITUDE})}, [3]),
        ({"messages": frozenset({54321})}, [7]),
        ({"without": frozenset({0})}, [3, 4, 5, 6, 7]),
        ({"sources": frozenset({(1, None)}), "messages": frozenset({0}), "end": 5.0}, [0, 2]),
    ],
)
def test_everything_that_is_asked_for_must_hold(wanted: dict[str, object], found: list[int]) -> None:
    assert taken(**wanted) == found


def test_without_a_time_of_day_none_can_be_asked_for() -> None:
    raw = list(LogReader(heartbeat(1), dialect(), "raw"))
    assert [Selection(begin=T0_US).takes(entry) for entry in raw] == [False]
    assert [Selection(begin=0.0).takes(entry) for entry in raw] == [True]
    assert Selection(end=T0_US).absolute and not Selection(end=1.0).absolute


def test_a_source_is_a_system_or_one_component_of_it() -> None:
    selection = Selection(sources=frozenset({(1, None), (2, 5)}))
    asked = {(s, c) for s, c in itertools.product((1, 2, 3), (1, 5)) if selection.has(s, c)}
    assert asked == {(1, 1), (1, 5), (2, 5)}
    assert Selection().has(77, 1)
