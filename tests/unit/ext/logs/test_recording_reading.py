"""A log as one sequence of entries: times that never run backwards, faults told with their byte."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from skygcs.tlog.format import LogEntry, LogKind, encode_record
from skygcs.tlog.reading import LogReader
from skygcs.tlog.timeline import LONGEST_GAP_S, REORDERED_S, Pace, Timeline
from support.examples import thinned
from support.flight_log import T0_US, FlightLog
from support.frames import dialect, frame, heartbeat, noise, offline, unknown_frame
from support.public_data import CAPTURE, capture, captures, own_capture
from support.table import each


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
    assert [pace.due_s(t) for t in (5.0, 6.0, 6.0, 1006.0, 1008.0)] == [
        *(0.0, 0.5, 0.5),
        *(0.5 + LONGEST_GAP_S / 2, 1.5 + LONGEST_GAP_S / 2),
    ]
    at_once = Pace(0.0)
    assert [at_once.due_s(t) for t in (0.0, 100.0)] == [0.0, 0.0]


def test_megabytes_of_noise_are_one_fault() -> None:
    entries, reader = read(noise(300_000, 2))
    assert entries == [] and len(reader.faults.lines()) == 1
    assert read(b"", "raw")[0] == [] and dialect().messages
