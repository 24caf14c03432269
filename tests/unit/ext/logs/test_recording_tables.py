"""Rows from entries: a message's fields, and the UTIAS scripts' table of a flight."""

from __future__ import annotations

from typing import Any

import pytest

from skygcs.ext.logs.tables import FLIGHT_COLUMNS, STALE_S, FlightTables, MessageColumns
from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogReader
from support.flight_log import ORIGIN, T0_US, FlightLog
from support.frames import dialect, frame, heartbeat


def rows(*records: tuple[float, bytes], raw: bool = False) -> list[tuple[tuple[int, int], dict[str, Any]]]:
    data = b"".join(piece if raw else encode_record(T0_US + round(t_s * 1e6), piece) for t_s, piece in records)
    tables = FlightTables(dialect())
    made = [tables.row(entry) for entry in LogReader(data, dialect(), "raw" if raw else "tlog")]
    names = [name for name, _ in FLIGHT_COLUMNS]
    return [(found[0], dict(zip(names, found[1], strict=True))) for found in made if found is not None]


def position(sysid: int = 1, boot_ms: int = 0, **more: int) -> bytes:
    place = {"lat": 437806000, "lon": -794653000, "relative_alt": 12_340, "vx": 150, "vy": -250, "vz": 35}
    return frame("GLOBAL_POSITION_INT", {"time_boot_ms": boot_ms, **place, **more}, sysid=sysid)


def attitude(sysid: int = 1) -> bytes:
    return frame("ATTITUDE", {"roll": 0.5, "pitch": -0.25, "yaw": 3.0}, sysid=sysid)


def test_the_columns_are_the_seeds() -> None:
    names = ["time", "mode", "lat", "lon", "alt", "vx", "vy", "vz", "roll", "pitch", "yaw"]
    assert [name for name, _ in FLIGHT_COLUMNS] == names


def test_a_row_has_degrees_metres_and_the_axes_of_the_message() -> None:
    found = rows((0, heartbeat(1, autopilot=3, custom_mode=4)), (1, attitude()), (1.5, position()))
    assert found == [
        ((1, 1), {"time": T0_US + 1_000_000, "mode": "GUIDED", **dict.fromkeys(("lat", "lon", "alt")),
                  **dict.fromkeys(("vx", "vy", "vz")), "roll": 28.65, "pitch": -14.32, "yaw": 171.89}),
        ((1, 1), {"time": T0_US + 1_500_000, "mode": "GUIDED", "lat": 43.7806, "lon": -79.4653, "alt": 12.34,
                  "vx": 1.5, "vy": -2.5, "vz": 0.35, "roll": 28.65, "pitch": -14.32, "yaw": 171.89}),
    ]  # fmt: skip


def test_positions_make_the_rows_and_attitudes_only_where_none_comes() -> None:
    found = rows(
        *((0, heartbeat(1)), (1, position()), (2, attitude()), (3, attitude()), (4, position())),
        *((4 + STALE_S, attitude()), (4.1 + STALE_S, attitude()), (20, position())),
    )
    assert [(row["time"] - T0_US) / 1e6 for _, row in found] == [1.0, 4.0, 4.1 + STALE_S, 20.0]
    assert [row["lat"] is None for _, row in found] == [False, False, True, False]
    assert [row["yaw"] is None for _, row in found] == [True, False, False, True]


def test_only_vehicles_have_rows_and_each_its_own() -> None:
    gcs = frame("ATTITUDE", {}, sysid=255, compid=190)
    found = rows(
        *((0, position(1)), (1, heartbeat(1)), (1, heartbeat(2)), (1, heartbeat(255, 190, type=6, autopilot=8))),
        *((2, position(2)), (2, gcs), (3, position(1)), (3, position(3))),
    )
    assert [key for key, _ in found] == [(2, 1), (1, 1)]


def test_a_place_that_is_not_known_is_an_empty_cell() -> None:
    ((_, row),) = rows((0, heartbeat(1)), (1, position(lat=0, lon=0)))
    assert (row["lat"], row["lon"], row["vx"]) == (None, None, 1.5)
    standing = rows((0, heartbeat(1)), (1, position(vx=0, vy=0, vz=0)))[0][1]
    assert [str(standing[axis]) for axis in ("vx", "vy", "vz")] == ["0.0", "0.0", "0.0"]


def test_in_a_raw_capture_the_time_counts_from_its_beginning() -> None:
    found = rows((0, heartbeat(1)), (0, position(boot_ms=60_000)), (0, position(boot_ms=61_500)), raw=True)
    assert [row["time"] for _, row in found] == [0, 1_500_000]


def test_a_flight_of_nine_is_where_it_was_flown() -> None:
    flight = FlightLog(9, 2.0)
    tables = FlightTables(dialect())
    seen = set()
    for entry in LogReader(flight.content(30.0), dialect(), "tlog"):
        made = tables.row(entry)
        if made is not None:
            (sysid, _), row = made
            seen.add(sysid)
            t_s = (row[0] - T0_US) / 1e6 - sysid * 1e-3
            assert row[4] == pytest.approx(flight.place(sysid, t_s)[2], abs=0.001)
            assert abs(row[2] - ORIGIN.lat_deg) < 0.002
    assert seen == set(range(1, 10))


def table(name: str, values: dict[str, Any]) -> dict[str, Any]:
    columns = MessageColumns(dialect().find(name))
    (entry,) = LogReader(encode_record(T0_US, frame(name, values, sysid=7)), dialect(), "tlog")
    assert entry.frame is not None
    row = columns.row(entry, entry.frame)
    return dict(zip([n for n, _ in columns.columns], row, strict=True))


def test_fields_are_columns_arrays_element_by_element() -> None:
    row = table("BATTERY_STATUS", {"id": 1, "voltages": [4100, 4090], "battery_remaining": -1})
    assert list(row)[:4] == ["time", "sysid", "compid", "id"]
    assert (row["time"], row["sysid"], row["compid"], row["id"]) == (T0_US, 7, 1, 1)
    assert [row[f"voltages_{n}"] for n in range(3)] == [4100, 4090, 0]
    assert row["battery_remaining"] == -1
    assert table("STATUSTEXT", {"text": "äh, \"so\"\n"})["text"] == "äh, \"so\"\n"  # fmt: skip


def test_data_is_one_cell_in_hexadecimal() -> None:
    row = table("FILE_TRANSFER_PROTOCOL", {"payload": [1, 2, 255]})
    assert row["payload"] == "0102ff" + "00" * 248


def test_every_message_of_the_dialect_makes_a_table_with_different_names() -> None:
    for info in dialect().messages.values():
        columns = MessageColumns(info)
        names = [name for name, _ in columns.columns]
        assert len(set(names)) == len(names), info.name
        (entry,) = LogReader(encode_record(T0_US, frame(info.name)), dialect(), "tlog")
        assert entry.frame is not None
        assert len(columns.row(entry, entry.frame)) == len(names), info.name
