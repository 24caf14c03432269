"""What is drawn of a flight, against what was flown; what is played of it, against what is dangerous."""

from __future__ import annotations

import math

import pytest

from skygcs.core.geo import Origin
from skygcs.ext.logs.flight import RecordedFlight
from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogReader
from skygcs.tlog.selection import ReportFilter
from support.examples import thinned
from support.flight_log import ORIGIN, T0_US, FlightLog
from support.frames import dialect, frame, heartbeat, offline, unknown_frame
from support.public_data import CAPTURE, capture, captures, own_capture, vehicles_of
from support.table import each


def flown(data: bytes, origin: Origin | None = None, kind: str = "tlog") -> RecordedFlight:
    flight = RecordedFlight(offline(), origin)
    for entry in LogReader(data, offline(), "raw" if kind == "raw" else "tlog"):
        flight.add(entry)
    flight.finish()
    return flight


def log(*records: tuple[float, bytes]) -> bytes:
    return b"".join(encode_record(T0_US + round(t_s * 1e6), raw) for t_s, raw in records)


def test_nine_vehicles_are_drawn_where_they_flew() -> None:
    made = FlightLog(9)
    flight = flown(made.content(120.0), ORIGIN)
    assert sorted(flight.vehicles) == [(n, 1) for n in range(1, 10)]
    for (sysid, _), vehicle in flight.vehicles.items():
        ends = vehicle.track.ends
        assert ends is not None
        assert ends[0] == pytest.approx(made.place(sysid, 0.0)[:2], abs=0.02)
        assert ends[1] == pytest.approx(made.place(sysid, 119.8)[:2], abs=0.02)
        assert vehicle.altitude.extremes() == pytest.approx((0.0, 5.0 + 2 * sysid), abs=0.01)
        assert vehicle.farthest_m == pytest.approx(30.0, abs=0.2)
        assert list(dict.fromkeys(span.mode for span in vehicle.modes)) == ["STABILIZE", "GUIDED", "LAND"]
        assert vehicle.armed_s == pytest.approx(107.0, abs=0.1)
        assert (vehicle.loss_ratio, vehicle.silences, vehicle.left_out) == (0.0, [], 0)
        low, high = vehicle.percent.extremes() or (0, 0)
        assert (low, high) == (100 - int(60 * 119 / 120) - sysid, 100 - sysid)


def test_without_an_origin_the_first_place_is_zero() -> None:
    flight = flown(FlightLog(2).content(30.0))
    ends = flight.vehicles[1, 1].track.ends
    assert ends is not None and ends[0] == (0.0, 0.0)
    assert flight.origin is not None
    x_m, y_m, _ = FlightLog(2).place(1, 0.0)
    assert math.dist((flight.origin.lat_deg, flight.origin.lon_deg), (ORIGIN.lat_deg, ORIGIN.lon_deg)) < 1e-3
    assert flown(FlightLog(2).content(30.0), ORIGIN).vehicles[1, 1].track.ends is not None and (x_m, y_m) != (0, 0)


def test_lost_frames_are_those_that_were_left_out() -> None:
    made = FlightLog(3)
    whole, thinned = (flown(made.content(100.0, lose=lose)) for lose in (0.0, 0.05))
    for key, vehicle in thinned.vehicles.items():
        missing = whole.vehicles[key].frames - vehicle.frames
        assert vehicle.stats.lost == pytest.approx(missing, abs=5)
        assert missing > 30
        ratios = [ratio for ratio in vehicle.loss.ratios(1e9) if ratio is not None]
        assert ratios == [pytest.approx(vehicle.loss_ratio, abs=0.001)]


@each("name", ["px4-late-frames", "second-heartbeat-1hz"])
def test_no_loss_is_drawn_where_frames_came_late_or_from_another_program(name: str) -> None:
    """It was a band of 25 % and more."""
    flight = flown(own_capture(name))
    assert {key: vehicle.loss_ratio for key, vehicle in flight.vehicles.items()} == dict.fromkeys(flight.vehicles, 0.0)
    for vehicle in flight.vehicles.values():
        assert set(vehicle.loss.ratios(1.0)) <= {0.0, None}


def test_messages_the_dialect_does_not_have_are_no_loss() -> None:
    frames = [heartbeat(1, seq=0), *(unknown_frame(sysid=1, seq=n) for n in range(1, 9)), heartbeat(1, seq=9)]
    (vehicle,) = flown(log(*((n / 10, raw) for n, raw in enumerate(frames)))).vehicles.values()
    assert (vehicle.frames, vehicle.stats.lost) == (10, 0)


def test_the_jump_of_a_reboot_is_taken_back_where_it_was_drawn() -> None:
    def position(boot_ms: int, seq: int) -> bytes:
        return frame("GLOBAL_POSITION_INT", {"time_boot_ms": boot_ms}, sysid=1, seq=seq)

    before = [(0.1 * n, heartbeat(1, seq=n)) for n in range(5)] + [(0.5, position(90_000, 5))]
    after = [(5.0, heartbeat(1, seq=30)), (5.1, heartbeat(1, seq=31)), (5.2, position(2_000, 32))]
    (vehicle,) = flown(log(*before, *after)).vehicles.values()
    assert (vehicle.reboots, vehicle.stats.lost) == (1, 0)
    assert set(vehicle.loss.ratios(1.0)) <= {0.0, None}


def test_a_silence_is_told_also_at_the_end() -> None:
    heartbeats = [(float(n), heartbeat(1, seq=n)) for n in (*range(10), *range(20, 25))]
    other = [(float(n), heartbeat(2, seq=n)) for n in range(40)]
    flight = flown(log(*sorted(heartbeats + other)))
    assert flight.vehicles[1, 1].silences == [(9.0, 20.0), (24.0, 39.0)]
    assert flight.vehicles[2, 1].silences == []


def test_a_raw_capture_has_no_clock_to_tell_a_silence_by() -> None:
    times = [0, 1000, 60_000]
    data = heartbeat(1) + b"".join(frame("ATTITUDE", {"time_boot_ms": t}, sysid=1, seq=n) for n, t in enumerate(times))
    vehicle = flown(data, kind="raw").vehicles[1, 1]
    assert (vehicle.frames, vehicle.silences, vehicle.last_s) == (4, [], 60.0)


def test_indoors_the_track_is_about_the_vehicles_own_origin() -> None:
    def local(n: int) -> bytes:
        return frame("LOCAL_POSITION_NED", {"x": 2.0 * n, "y": 1.0 * n, "z": -0.5 * n})

    vehicle = flown(log((0, heartbeat(1)), *((1.0 + n, local(n)) for n in range(5)))).vehicles[1, 1]
    assert vehicle.place == "LOCAL_POSITION_NED"
    assert vehicle.track.ends == ((0.0, 0.0), (4.0, 8.0))
    assert vehicle.altitude.extremes() == (0.0, 2.0)


def test_a_receiver_without_a_fix_places_nothing_and_a_better_message_replaces_it() -> None:
    def gps(fix: int, lat: int) -> bytes:
        return frame("GPS_RAW_INT", {"fix_type": fix, "lat": lat, "lon": -794653000, "alt": 180_000})

    fused = frame("GLOBAL_POSITION_INT", {"lat": 437806000, "lon": -794653000, "alt": 180_000, "relative_alt": 0})
    assert flown(log((0, heartbeat(1)), (1, gps(2, 437000000)))).vehicles[1, 1].place == ""
    records = [(0, heartbeat(1)), (1, gps(3, 437000000)), (2, fused), (3, gps(3, 437000000)), (4, fused)]
    vehicle = flown(log(*records)).vehicles[1, 1]
    assert (vehicle.place, vehicle.track.ends, vehicle.farthest_m) == ("GLOBAL_POSITION_INT", ((0, 0), (0, 0)), 0)


def test_texts_are_put_together_and_bounded() -> None:
    def part(text: str, seq: int) -> bytes:
        return frame("STATUSTEXT", {"severity": 3, "text": text, "id": 7, "chunk_seq": seq})

    single = frame("STATUSTEXT", {"severity": 6, "text": "hello"})
    data = log((0, heartbeat(1)), (1, part("a" * 50, 0)), (1, part("b", 1)), *((2, single) for _ in range(2500)))
    vehicle = flown(data).vehicles[1, 1]
    assert [(t.severity, t.text) for t in vehicle.texts[:2]] == [(3, "a" * 50 + "b"), (6, "hello")]
    assert (len(vehicle.texts), vehicle.left_out) == (2000, 501)


def test_our_own_capture_has_five_flights() -> None:
    flight = flown(CAPTURE.read_bytes())
    assert [(v.autopilot, v.kind) for _, v in sorted(flight.vehicles.items())] == [
        *[("ardupilot", "quadrotor")] * 3,
        *[("px4", "quadrotor")] * 2,
    ]
    wanted = [12, 14, 16, 19, 20]
    assert [round((v.altitude.extremes() or (0, 0))[1]) for _, v in sorted(flight.vehicles.items())] == wanted


@each("name", thinned(captures("tlog") + captures("raw"), 6, turn=6))
def test_every_log_gives_its_vehicles_and_bounded_figures(name: str) -> None:
    data, expected = capture(name)
    flight = flown(data, kind=expected["kind"])
    assert {f"{sysid}/{compid}" for sysid, compid in flight.vehicles} == vehicles_of(name).keys()
    for (sysid, compid), vehicle in flight.vehicles.items():
        assert 0 < vehicle.frames <= expected["sources"][f"{sysid}/{compid}"] + expected["status"].get("unknown", 0)
        assert 0 <= vehicle.loss_ratio < 1
        assert vehicle.last_s <= flight.end_s
        assert len(vehicle.track.points) <= 4000


def played(*frames: bytes) -> list[bool]:
    reported = ReportFilter()
    return [reported.passes(entry) for entry in LogReader(log(*((0, raw) for raw in frames)), dialect(), "tlog")]


def test_no_order_is_played_whoever_gave_it() -> None:
    order = {"target_system": 1, "target_component": 1, "command": 400, "param1": 1.0}
    ack = {"command": 400, "target_system": 255, "target_component": 190}
    assert played(
        *(frame("ATTITUDE"), heartbeat(1), frame("ATTITUDE"), heartbeat(255, 190, type=6, autopilot=8)),
        *(frame("COMMAND_LONG", order, sysid=255, compid=190), frame("COMMAND_LONG", order, sysid=1, compid=190)),
        *(frame("COMMAND_ACK", ack), frame("RADIO_STATUS", sysid=51, compid=68), unknown_frame(sysid=1)),
        frame("COMMAND_LONG", {**order, "target_system": 0}, sysid=255, compid=190),
    ) == [False, True, True, False, False, False, True, True, False, False]
