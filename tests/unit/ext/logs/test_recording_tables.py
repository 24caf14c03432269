"""Rows from entries: a message's fields, and the UTIAS scripts' table of a flight."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.logs.curves import FIRST_TOLERANCE_M, GAP_S, Curve, LossCurve, Track
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


# -- Curves, tracks and loss of any length stay small and still show what matters.


@given(st.lists(st.tuples(st.floats(0, 2.0), st.floats(-1e3, 1e3)), min_size=1, max_size=400), st.integers(4, 40))
def test_a_curve_is_bounded_ordered_and_keeps_its_extremes(steps: list[tuple[float, float]], most: int) -> None:
    curve = Curve(most)
    now = 0.0
    for step_s, value in steps:
        now += step_s
        curve.add(now, value)
    times, values = curve.points()
    shown = [v for v in values if not math.isnan(v)]
    assert len(shown) <= 4 * most
    assert times == sorted(times)
    assert (min(shown), max(shown)) == (min(v for _, v in steps), max(v for _, v in steps)) == curve.extremes()
    assert times[-1] == now


def test_a_single_spike_in_a_day_of_telemetry_is_seen() -> None:
    curve = Curve()
    for n in range(200_000):
        curve.add(n * 0.4, 1000.0 if n == 123_456 else float(n % 7))
    times, values = curve.points()
    assert len(times) <= 6001
    assert abs(times[values.index(1000.0)] - 123_456 * 0.4) < 1e-6


def test_a_pause_breaks_the_line_until_it_is_finer_than_a_bucket() -> None:
    curve = Curve(100)
    for t_s in (0.0, 1.0, 1.0 + GAP_S + 0.1, 2.0 + GAP_S):
        curve.add(t_s, 1.0)
    values = curve.points()[1]
    assert [math.isnan(v) for v in values] == [False, False, True, False, False]
    for n in range(2000):
        curve.add(100.0 + n * (GAP_S + 1), 2.0)
    assert len(curve.points()[0]) <= 500


def test_what_is_not_finite_is_no_part_of_a_curve() -> None:
    curve = Curve()
    curve.add(0.0, math.nan)
    curve.add(0.0, math.inf)
    assert not curve and curve.extremes() is None and curve.points() == ([], [])


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=300), st.integers(5, 60))
def test_every_place_is_near_the_drawn_track(places: list[tuple[float, float]], most: int) -> None:
    track = Track(most)
    for n, (x, y) in enumerate(places):
        track.add(n * 0.1, x, y)
    assert len(track.points) <= most
    drawn = list(zip(*track.line(), strict=True))
    # a place is left out for being near a kept one, which a coarser pass may leave out in turn: twice the tolerance
    assert all(min(math.dist(place, point) for point in drawn) <= 2 * track.tolerance_m for place in places)
    assert track.ends == (places[0], places[-1])


def test_a_track_of_hours_keeps_its_shape() -> None:
    track = Track()
    for n in range(100_000):
        track.add(n * 0.2, 500 * math.cos(n / 3000), 500 * math.sin(n / 3000))
    xs, ys = track.line()
    assert len(xs) <= 4001 and track.tolerance_m <= 128 * FIRST_TOLERANCE_M
    assert all(abs(math.hypot(x, y) - 500) < 0.01 for x, y in zip(xs, ys, strict=True))


def test_a_pause_breaks_the_track_and_stays_when_it_is_thinned() -> None:
    track = Track(10)
    track.add(0.0, 0.0, 0.0)
    track.add(100.0, 1.0, 0.0)
    assert math.isnan(track.line()[0][1])
    for n in range(100):
        track.add(100.0 + 0.1 * n, 1.0 + n, 0.0)
    assert any(math.isnan(x) for x in track.line()[0])


def test_a_shifted_track_is_the_same_about_another_origin() -> None:
    track = Track()
    track.add(0.0, 1.0, 2.0)
    track.add(0.1, 1.001, 2.0)
    track.shift(-1.0, 3.0)
    ends = track.ends
    assert ends is not None and ends[0] == (0.0, 5.0) and math.isclose(ends[1][0], 0.001, abs_tol=1e-9)
    assert Track().ends is None


@given(st.lists(st.tuples(st.floats(0, 40.0), st.integers(0, 5)), max_size=300))
def test_loss_is_counted_exactly_however_coarse_its_pieces(frames: list[tuple[float, int]]) -> None:
    curve = LossCurve(most=16)
    now = 0.0
    for step_s, lost in frames:
        now += step_s
        curve.add(now, lost)
    whole = curve.ratios(max(now, 1.0) + curve.width_s)
    lost, received = sum(lost for _, lost in frames), len(frames)
    assert whole == ([lost / (lost + received)] if frames else [])
    assert len(curve.ratios(0.0)) <= 16


def test_a_piece_without_frames_has_no_loss_to_tell() -> None:
    curve = LossCurve()
    curve.add(0.5, 0)
    curve.add(3.5, 1)
    curve.add(3.6, -1)
    assert curve.ratios(1.0) == [0.0, None, None, 0.0]
    assert curve.ratios(2.0) == [0.0, 0.0] and curve.pieces(2.0) == 2
