"""`tlog csv`: against pymavlink's decoding, value by value; the UTIAS scripts' table; Parquet."""

from __future__ import annotations

import csv
import io
import math
import struct
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as pymavlink_all

from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogReader
from support.command_line import ran
from support.examples import thinned
from support.flight_log import T0_US, FlightLog
from support.frames import frame, heartbeat, offline
from support.public_data import captures, expected, present, public_file, vehicles_of
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2


run = partial(ran, "tlog", "csv")


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


DECODED = ["made-v1-v2-mixed.tlog", "made-retrimmed.tlog", "binus-hexa-5src-mixed.tlog", "px4-v2-2020.tlog"]


@each("name", present("tlog", DECODED))
def test_every_value_is_the_one_that_pymavlink_decodes(name: str, tmp_path: Path) -> None:
    """An independent reader of the same file: its records by the times and lengths, its fields by pymavlink."""
    path = public_file(f"tlog/{name}")
    run(path, "--all", "-o", tmp_path)
    tables = {file.stem.removeprefix(f"{path.stem}-"): iter(table(file)) for file in tmp_path.iterdir()}
    decoder = pymavlink_all.MAVLink(None)
    decoder.robust_parsing = True
    compared = values = 0
    for record in LogReader(path.read_bytes(), offline()):
        if record.verdict != "ok":
            continue
        message = decoder.decode(bytearray(record.raw))
        row = next(tables[message.get_type()])
        assert row["time"] == f"{record.unix_us / 1e6:.6f}"
        assert (int(row["sysid"]), int(row["compid"])) == (message.get_srcSystem(), message.get_srcComponent())
        compared += 1
        for field in message.get_fieldnames():
            value = getattr(message, field)
            for cell, wanted in cells(row, field, value):
                values += 1
                assert same(cell, wanted), (message.get_type(), field, cell, wanted)
    assert compared == expected()[name]["status"]["ok"] and values > 10 * compared / 2
    assert all(next(rest, None) is None for rest in tables.values())


def cells(row: dict[str, str], field: str, value: Any) -> list[tuple[str, Any]]:
    if field not in row:
        return [(row[f"{field}_{n}"], item) for n, item in enumerate(value)]
    if isinstance(value, list):
        return [(row[field], bytes(value).hex())]
    return [(row[field + "_" if field in ("time", "sysid", "compid") else field], value)]


def same(cell: str, wanted: Any) -> bool:
    if isinstance(wanted, float):
        if math.isnan(wanted):
            return cell == "nan"
        if math.isinf(wanted):
            return float(cell) == wanted
        return float(cell) == wanted or struct.pack("<f", float(cell)) == struct.pack("<f", wanted)
    return cell == str(wanted)


@each("name", thinned(captures("tlog") + captures("raw"), 3, turn=2))
def test_every_log_makes_flights_and_tables_of_the_counts_expected(name: str, tmp_path: Path) -> None:
    path = public_file(f"tlog/{name}")
    reported = run(path, "-o", tmp_path)
    files = sorted(tmp_path.iterdir(), key=lambda file: int(file.stem.rsplit("-", 1)[1]))
    assert [file.name for file in files] == [
        f"{path.stem}-{sysid}.csv" for sysid in sorted(int(key.partition("/")[0]) for key in vehicles_of(name))
    ]
    assert reported.stdout.splitlines() == [f"{file}: {len(table(file)):,} rows" for file in files]
    for file in files:
        rows = table(file)
        assert list(rows[0]) == ["time", "mode", "lat", "lon", "alt", "vx", "vy", "vz", "roll", "pitch", "yaw"]
        times = [float(row["time"]) for row in rows]
        steps_back = expected()[name].get("ts_backwards", 0)
        assert sum(b < a for a, b in pairwise(times)) <= (steps_back or 0)
        for row in rows:
            assert row["lat"] == "" or (-90 <= float(row["lat"]) <= 90 and float(row["lat"]) != 0)
            assert row["yaw"] == "" or -180 <= float(row["yaw"]) < 180
    if expected()[name]["kind"] == "tlog":
        whole = tmp_path / "all"
        run(path, "--all", "-o", whole)
        counts = {file.stem.removeprefix(f"{path.stem}-"): len(table(file)) for file in whole.iterdir()}
        assert sum(counts.values()) == expected()[name]["status"]["ok"]
        assert all(count <= expected()[name]["types"][kind] for kind, count in counts.items())


def test_one_table_may_go_to_stdout(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(FlightLog(2, 2.0).content(10.0))
    rows = list(csv.DictReader(io.StringIO(run(log, "-o", "-", "--vehicle", "2").stdout)))
    assert len(rows) == 20
    assert rows[0]["time"] == "1780000000.002000" and rows[0]["mode"] == "STABILIZE"
    assert "more than one table (1, 2)" in " ".join(run(log, "-o", "-", code=FAILED).stderr.split())
    part = run(log, "-o", "-", "--message", "SYS_STATUS", "--vehicle", "1", "--from", "2", "--to", "4")
    assert [row["time"] for row in csv.DictReader(io.StringIO(part.stdout))] == [
        f"{1780000000 + n}.001000" for n in (2, 3)
    ] or len(part.stdout.splitlines()) == 4


def test_the_mode_of_a_part_is_known_from_before_it(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(FlightLog(1, 2.0).content(10.0))
    rows = list(csv.DictReader(io.StringIO(run(log, "-o", "-", "--from", "4.2", "--to", "4.9").stdout)))
    assert [row["mode"] for row in rows] == ["STABILIZE"]


def test_nothing_to_show_is_no_table(tmp_path: Path) -> None:
    log = tmp_path / "gcs.tlog"
    log.write_bytes(encode_record(T0_US, heartbeat(255, 190, type=6, autopilot=8)))
    assert "no row in it" in run(log, code=FAILED).stderr
    assert "no row in it" in run(log, "--message", "ATTITUDE", code=FAILED).stderr
    assert [path.name for path in tmp_path.iterdir()] == ["gcs.tlog"]


def test_text_with_commas_and_quotes_comes_back(tmp_path: Path) -> None:
    log = tmp_path / "in.tlog"
    texts = ['a, "b"', "x\ny", "é€", "", "1=1"]
    log.write_bytes(b"".join(encode_record(T0_US + n, frame("STATUSTEXT", {"text": t})) for n, t in enumerate(texts)))
    run(log, "--message", "STATUSTEXT")
    assert [row["text"] for row in table(tmp_path / "in-STATUSTEXT.csv")] == texts


def test_a_text_does_nothing_to_a_spreadsheet_or_a_terminal(tmp_path: Path) -> None:
    log = tmp_path / "in.tlog"
    texts = {
        "=1+1": "'=1+1",
        "@SUM(1)": "'@SUM(1)",
        "-2": "'-2",
        "a\rb": "a\\rb",
        "\x1b]0;x\x07\u202e": "\\x1b]0;x\\x07\\u202e",
    }
    log.write_bytes(b"".join(encode_record(T0_US + n, frame("STATUSTEXT", {"text": t})) for n, t in enumerate(texts)))
    run(log, "--message", "STATUSTEXT")
    assert [row["text"] for row in table(tmp_path / "in-STATUSTEXT.csv")] == list(texts.values())
    assert "\x1b" not in run(log, "--message", "STATUSTEXT", "-o", "-").output


def test_a_damaged_time_costs_parquet_that_time_alone(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    log = tmp_path / "in.tlog"
    log.write_bytes(b"".join(encode_record(us, frame("STATUSTEXT")) for us in (T0_US, 1 << 63, (1 << 64) - 1, T0_US)))
    run(log, "--all", "--parquet")
    times = parquet.read_table(tmp_path / "in-STATUSTEXT.parquet").column("time")
    assert [time.value for time in times] == [T0_US, None, None, T0_US]


def test_parquet_holds_the_same_with_types(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    log = tmp_path / "flight.tlog"
    log.write_bytes(FlightLog(2, 5.0).content(20.0))
    run(log, "--all", "-o", tmp_path / "csv")
    run(log, "--all", "--parquet", "-o", tmp_path / "parquet")
    run(log, "--parquet", "-o", tmp_path / "parquet")
    assert len(list((tmp_path / "parquet").iterdir())) == len(list((tmp_path / "csv").iterdir())) + 2
    for file in (tmp_path / "csv").iterdir():
        read = parquet.read_table(tmp_path / "parquet" / f"{file.stem}.parquet")
        rows = table(file)
        assert read.num_rows == len(rows) and read.column_names == list(rows[0])
        assert str(read.schema.field("time").type) == "timestamp[us, tz=UTC]"
        for row, values in zip(rows, read.to_pylist(), strict=True):
            assert float(row["time"]) == pytest.approx(values["time"].timestamp(), abs=1e-6)
            for name, value in values.items():
                assert name == "time" or same(row[name], value), (file.stem, name)
    attitude = parquet.read_table(tmp_path / "parquet" / "flight-ATTITUDE.parquet").schema
    assert [str(attitude.field(n).type) for n in ("sysid", "time_boot_ms", "roll")] == ["uint8", "uint32", "float"]


def test_parquet_without_pyarrow_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    log = tmp_path / "flight.tlog"
    log.write_bytes(FlightLog(1).content(2.0))
    reported = " ".join(run(log, "--parquet", "-o", tmp_path / "out", code=FAILED).stderr.split())
    assert "pip install 'skygcs[parquet]'" in reported
    assert list((tmp_path / "out").iterdir()) == []
    assert "--parquet does not go to stdout" in run(log, "--parquet", "-o", "-", code=USAGE).output


def test_a_parquet_of_many_row_groups_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    monkeypatch.setattr("skygcs.ext.logs.table_files.CELLS_PER_GROUP", 100)
    log = tmp_path / "flight.tlog"
    log.write_bytes(FlightLog(1).content(20.0))
    run(log, "--message", "ATTITUDE", "--parquet")
    file = parquet.ParquetFile(tmp_path / "flight-ATTITUDE.parquet")
    assert file.metadata.num_rows == 100 and file.metadata.num_row_groups > 5
