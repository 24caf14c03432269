"""Records in and out: exact counts on every public tlog, and anything damaged."""

from __future__ import annotations

import io
import random
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.dialect import Dialect
from skygcs.tlog.format import CLOCK_STEP_US, LogEntry, encode_record, sniff
from skygcs.tlog.reading import LogReader
from skygcs.tlog.selection import Selection
from support.examples import examples, thinned
from support.frames import dialect, frame, heartbeat, noise, offline, unknown_frame
from support.public_data import CAPTURE, capture, captures, public_file
from support.table import each

T0 = 1_700_000_000_000_000
"""Some time in 2023, in microseconds."""


def read(data: bytes, table: Dialect | None = None) -> tuple[list[LogEntry], int]:
    reader = LogReader(data, table or dialect())
    return list(reader), reader.faults.skipped_bytes


def log(*frames: bytes, start: int = T0, step: int = 100_000) -> bytes:
    return b"".join(encode_record(start + n * step, raw) for n, raw in enumerate(frames))


def verdicts(records: list[LogEntry]) -> list[str]:
    return [r.verdict for r in records]


@each("name", thinned(captures("tlog"), 6, turn=0))
def test_counts_of_a_tlog_are_exact(name: str) -> None:
    data, expected = capture(name)
    status = expected["status"]
    records, skipped = read(data, offline())
    found = Counter(verdicts(records))
    counts = (found["ok"], found["bad_crc"], found["unknown"], skipped)
    assert counts == tuple(status.get(key, 0) for key in ("ok", "badcrc", "unknown", "skipped_bytes"))
    assert len(records) == expected["frames"]
    good = [r.frame for r in records if r.verdict == "ok" and r.frame is not None]
    assert Counter(f"{f.sysid}/{f.compid}" for f in good) == expected["sources"]
    types = Counter(f.name for f in good)
    for record in records:  # expected.json counts types of records whatever their CRC
        if record.frame is not None and record.frame.info is None:
            types[record.frame.name] += 1
        elif record.frame is None:
            msgid = record.raw[5] if record.raw[0] == 0xFE else int.from_bytes(record.raw[7:10], "little")
            types[offline().messages[msgid].name] += 1
    assert types == expected["types"]
    assert round(records[-1].at_s, 1) == expected["duration_s"]
    assert Counter("v1" if r.raw[0] == 0xFE else "v2" for r in records) == expected["versions"]
    assert sum(f.signed for f in good) == expected["signed"]
    assert sum(8 + len(r.raw) for r in records) + skipped == len(data)


def test_own_capture_is_read_whole() -> None:
    records, skipped = read(CAPTURE.read_bytes())
    assert (Counter(verdicts(records)), skipped) == ({"ok": 8144}, 0)


def test_a_record_is_the_time_big_endian_and_the_frame_as_it_was() -> None:
    raw = heartbeat(3, version=1)
    assert encode_record(0x0102030405060708, raw) == bytes(range(1, 9)) + raw
    with pytest.raises(OverflowError):
        encode_record(-1, raw)


@given(st.lists(st.tuples(st.integers(0, (1 << 64) - 1), st.integers(1, 255), st.booleans()), max_size=40))
def test_what_is_written_is_read_again(entries: list[tuple[int, int, bool]]) -> None:
    frames = [heartbeat(s, seq=n, version=1 if v1 else 2) for n, (_, s, v1) in enumerate(entries)]
    data = b"".join(encode_record(t, raw) for (t, _, _), raw in zip(entries, frames, strict=True))
    records, skipped = read(data)
    assert [(r.unix_us, r.raw) for r in records] == [(t, f) for (t, _, _), f in zip(entries, frames, strict=True)]
    assert skipped == 0
    assert [r.offset for r in records] == [data.index(encode_record(r.unix_us, r.raw), r.offset) for r in records]


def test_times_with_their_lowest_byte_first_are_read_so_and_a_damaged_one_turns_no_file() -> None:
    us = 1_350_000_000_000_000
    bad, lost = bytearray(heartbeat(2)), b"\xfd" * 3
    bad[-1] ^= 1
    raws = [heartbeat(1), heartbeat(1), bytes(bad), heartbeat(1)]
    old = b"".join((us + n).to_bytes(8, "little") + raw + lost * (n == 1) for n, raw in enumerate(raws))
    records, skipped = read(old)
    assert [(r.unix_us, r.verdict) for r in records] == [(us + n, "bad_crc" if n == 2 else "ok") for n in range(4)]
    assert skipped == 3 and records[-1].at_s == pytest.approx(3e-6)
    damaged = us.to_bytes(8, "little") + heartbeat(1) + log(heartbeat(1), heartbeat(1))
    assert [r.unix_us for r in read(damaged)[0]][1:] == [r.unix_us for r in read(log(heartbeat(1), heartbeat(1)))[0]]


def test_a_truncated_last_record_is_skipped_wherever_it_is_cut() -> None:
    whole = log(*[frame("STATUSTEXT", {"text": f"number {n}"}, seq=n) for n in range(3)])
    last = read(whole)[0][-1].offset
    for cut in range(last, len(whole)):
        records, skipped = read(whole[:cut])
        assert len(records) == 2
        assert skipped == cut - last


def test_a_bad_record_before_a_truncated_one_still_counts() -> None:
    bad = bytearray(heartbeat(2))
    bad[-1] ^= 1
    data = log(heartbeat(1), bytes(bad), heartbeat(3))
    for cut in range(len(data) - len(heartbeat(3)) + 1 - 8, len(data)):
        records, _ = read(data[:cut])
        assert verdicts(records)[:2] == ["ok", "bad_crc"], cut


def test_well_framed_records_are_bad_or_unknown_and_not_noise() -> None:
    bad = bytearray(frame("ATTITUDE", {"roll": 1.0}))
    bad[12] ^= 1
    data = log(heartbeat(1), bytes(bad), unknown_frame(crc_extra=None), heartbeat(2), bytes(bad))
    records, skipped = read(data)
    assert verdicts(records) == ["ok", "bad_crc", "unknown", "ok", "bad_crc"]
    assert skipped == 0
    assert records[1].frame is None and records[1].raw == bytes(bad)
    assert records[2].frame is not None and records[2].frame.info is None


def test_a_record_whose_length_is_damaged_costs_only_itself() -> None:
    good = [heartbeat(n) for n in range(1, 8)]
    bad = bytearray(good[3])
    for length in range(256):
        if length == good[3][1]:
            continue
        bad[1] = length
        data = log(*good[:3], bytes(bad), *good[4:])
        records, skipped = read(data)
        assert [r.raw for r in records if r.verdict == "ok"] == good[:3] + good[4:], length
        assert skipped + sum(8 + len(r.raw) for r in records) == len(data)


def test_garbage_in_front_and_between_is_skipped() -> None:
    for seed in range(20):
        garbage = noise(500, seed)
        records, skipped = read(garbage + log(heartbeat(1), heartbeat(2)) + garbage + log(heartbeat(3)))
        assert [r.raw for r in records if r.verdict == "ok"] == [heartbeat(1), heartbeat(2), heartbeat(3)], seed
        assert skipped == 1000


def test_megabytes_of_noise_hold_no_record() -> None:
    data = noise(3_000_000, 5)
    assert read(data) == ([], len(data))
    assert read(b"\xfd" * 100_000) == ([], 100_000)
    assert read(b"\xfe" * 100_000) == ([], 100_000)


def test_times_may_go_backwards_and_such_records_count_as_simultaneous() -> None:
    data = encode_record(T0 + 5_000_000, heartbeat(1)) + log(heartbeat(2), heartbeat(3), start=T0 + 3_000_000)
    records, skipped = read(data)
    assert (verdicts(records), skipped) == (["ok"] * 3, 0)
    assert [r.unix_us - T0 for r in records if r.unix_us] == [5_000_000, 3_000_000, 3_100_000]
    assert [r.at_s for r in records] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("bit", [23, 33, 36, 60])
def test_a_clock_that_is_set_or_a_damaged_time_is_no_part_of_the_duration(bit: int) -> None:
    boot = log(heartbeat(1), heartbeat(2), start=3_000_000)
    after = log(heartbeat(3), heartbeat(4), start=T0)
    damaged = encode_record(T0 ^ 1 << bit, heartbeat(5))
    later = log(heartbeat(6), start=T0 + 200_000) + log(heartbeat(7), start=T0 + 300_000 + CLOCK_STEP_US)
    records, _ = read(boot + after + damaged + later)
    assert [round(r.at_s, 3) for r in records] == [0.0, 0.1, 0.1, 0.2, 0.2, 0.3, 0.3]
    assert [r.dated_us != r.unix_us for r in records].index(True) == 4
    assert records[4].unix_ns() == records[3].unix_ns()


def test_records_of_a_second_program_with_another_clock_are_dated_by_the_first_one_s() -> None:
    both = [encode_record(T0 + n * 100_000 - n % 2 * 60_000_000, heartbeat(n)) for n in range(7)]
    records, _ = read(b"".join(both))
    assert [round(r.at_s, 3) for r in records] == [0.0, 0.0, 0.2, 0.2, 0.4, 0.4, 0.6]
    assert [r.unix_ns() for r in records] == [1000 * (T0 + n // 2 * 200_000) for n in range(7)]
    assert all(map(Selection(begin=T0).takes, records))


def test_empty_and_tiny_files_hold_nothing() -> None:
    for data in (b"", b"\x00", b"\x00" * 8, b"\x00" * 9, b"\xfd" * 9, bytes(8) + b"\xfe"):
        assert read(data) == ([], len(data))
        assert sniff(data, dialect()) is None


def test_records_whose_crc_is_wrong_and_years_apart_are_read_one_after_the_other() -> None:
    v1 = bytes.fromhex("fe04891101360102030400ff")
    v2 = bytes.fromhex("fd0400008a11013600000102030400ff")
    data = encode_record(1_410_491_717_000_037, v1) + encode_record(1_442_027_717_000_064, v2)
    records, skipped = read(data)
    assert [(r.raw, r.verdict, r.unix_us // 31_536_000_000_000) for r in records] == [
        (v1, "bad_crc", 44),
        (v2, "bad_crc", 45),
    ]
    assert skipped == 0


def test_framing_vector_with_years_between_its_records() -> None:
    """Both CRCs are wrong on purpose; the records are one after the other all the same."""
    import json

    vector = json.loads(public_file("vectors/wire_vectors.json").read_text())["tlog"]
    for entry in vector if isinstance(vector, list) else [vector]:
        data = bytes.fromhex(entry["bytes"])
        records, skipped = read(data)
        assert len(records) == len(entry["expect"])
        assert skipped == 0


@settings(max_examples=examples(300), deadline=None)
@given(st.lists(st.binary(max_size=80) | st.sampled_from([log(heartbeat(1)), log(unknown_frame()), heartbeat(2)])))
def test_nothing_raises_and_every_byte_is_accounted_for(pieces: list[bytes]) -> None:
    data = b"".join(pieces)
    records, skipped = read(data)
    assert sum(8 + len(r.raw) for r in records) + skipped == len(data)
    assert [r.offset for r in records] == sorted(r.offset for r in records)


class Window:
    """A file read piecewise, as the replay link reads it."""

    def __init__(self, data: bytes) -> None:
        self._file = io.BytesIO(data)
        self._size = len(data)

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, index: int | slice) -> int | bytes:
        if isinstance(index, slice):
            start, stop, _ = index.indices(self._size)
            self._file.seek(start)
            return self._file.read(stop - start)
        self._file.seek(index)
        return self._file.read(1)[0]


def test_a_file_need_not_be_in_memory() -> None:
    data = noise(100, 1) + log(*[heartbeat(n) for n in range(1, 50)]) + noise(100, 2)
    reader = LogReader(Window(data), dialect())  # type: ignore[arg-type]
    assert [r.raw for r in reader] == [heartbeat(n) for n in range(1, 50)]
    assert reader.faults.skipped_bytes == 200


# -- what kind of file


@each("name", thinned(captures("tlog") + captures("raw"), 6, turn=1))
def test_captures_are_told_apart_without_their_names(name: str) -> None:
    data, expected = capture(name)
    assert sniff(data, offline()) == expected["kind"]


@each("lead", [b"", noise(30, 1), noise(200_000, 2)])
def test_few_records_and_frames_behind_garbage_are_told_apart(lead: bytes) -> None:
    rng = random.Random(1)
    frames = [heartbeat(rng.randint(1, 9), seq=n) for n in range(300)]
    assert sniff(lead + log(*frames), dialect()) == "tlog"
    assert sniff(lead + b"".join(frames), dialect()) == "raw"


def test_one_record_is_a_tlog_and_one_frame_is_raw() -> None:
    assert sniff(log(heartbeat(1)), dialect()) == "tlog"
    assert sniff(heartbeat(1), dialect()) == "raw"


def test_other_files_are_neither() -> None:
    assert sniff(noise(2_000_000, 3), dialect()) is None
    assert sniff(b"[links.radio]\n" * 1000, dialect()) is None
