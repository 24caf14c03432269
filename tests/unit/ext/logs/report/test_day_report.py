"""The report of a day: what is read, what was planned, what is drawn."""

from __future__ import annotations

import functools
import itertools
import math
import re
import statistics
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.geo import EnuFrame
from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, TimedPlan
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.timing import path_within
from skygcs.ext.logs.report.day_figures import DayReport, EventKind, VehicleDay
from skygcs.ext.logs.report.day_reader import MOST_DRAWN, DayReader
from skygcs.ext.logs.report.flight_book import MOST_FLIGHTS
from skygcs.ext.logs.report.planned import add_plan, planned_paths, system_of
from skygcs.ext.logs.report.svg_drawing import MAP_HEIGHT, WIDTH, Drawn, curves, ground_map, ticks
from skygcs.tlog.format import encode_record
from skygcs.tlog.reading import LogReader
from support.examples import examples
from support.flight_log import ARMED, DISARMED, ORIGIN, T0_US, FlightLog
from support.frames import frame, heartbeat, offline, unknown_frame
from support.public_data import CAPTURE, own_capture, present, public_file
from support.pymav_log import records
from support.table import each

# -- Figures of a day against what was flown, and against pymavlink's reading of real flights.


ARDUPILOT, PX4 = 3, 12
ON_GROUND, IN_AIR, TAKEOFF, LANDING = 1, 2, 3, 4
RADIO_IDS = frozenset({109, 166})
POSITION_IDS = frozenset({33})
EVENT_IDS = frozenset({0, 245, 253})
COMMAND_IDS = frozenset({75, 76, 77})
RADIO_LOGS = ["copter-radio-flight.tlog", "dronekit-v1-sik.tlog", "eagle-c2-v2-sik-mp-mavproxy.tlog"]


def report_of(*recordings: bytes) -> DayReport:
    """Each recording begins when its first record says."""
    reader = DayReader(offline(), ORIGIN)
    for data in recordings:
        begin_s = int.from_bytes(data[:8], "big") / 1e6
        for entry in LogReader(data, offline()):
            entry.at_s += begin_s
            reader.add(entry)
        reader.end_recording()
    return reader.finish("test")


@functools.cache
def own_report(name: str) -> DayReport:
    return report_of(own_capture(name))


def log(records: Iterable[tuple[float, bytes]]) -> bytes:
    return b"".join(encode_record(T0_US + round(t_s * 1e6), raw) for t_s, raw in sorted(records, key=lambda r: r[0]))


def vehicle(report: DayReport, sysid: int) -> VehicleDay:
    (found,) = [day for day in report.vehicles if day.key == (sysid, 1)]
    return found


def beat(sysid: int, seq: int, *, armed: bool, status: int = 4) -> bytes:
    base = ARMED if armed else DISARMED
    return heartbeat(sysid, seq=seq & 255, autopilot=ARDUPILOT, base_mode=base, custom_mode=4, system_status=status)


# -- flights


def test_flights_are_what_was_flown() -> None:
    made = FlightLog(2, 2.0)
    report = report_of(made.content(120.0))
    for sysid in (1, 2):
        (flight,) = vehicle(report, sysid).flights
        steps = [made.place(sysid, t / 100) for t in range(800, 11500, 5)]
        flown_m = sum(math.dist(a, b) for a, b in itertools.pairwise(steps))
        assert flight.whole
        assert flight.begin_s - T0_US / 1e6 == pytest.approx(8.0, abs=0.1)
        assert flight.air_s == pytest.approx(107.0, abs=1.1)
        assert flight.distance_m == pytest.approx(flown_m, rel=0.02)
        assert flight.highest_m == pytest.approx(5.0 + 2 * sysid, abs=0.01)
        assert flight.used_percent == pytest.approx(60 * 107 / 120, abs=2)
        assert flight.drawing is not None
        xs, ys = flight.drawing.track
        assert (xs[-1], ys[-1]) == pytest.approx(made.place(sysid, 114.5)[:2], abs=0.1)


def test_a_recording_that_begins_in_flight_with_the_vehicles_own_frame_counts_no_jump() -> None:
    """Its first places are metres of its own; the first on earth is far from them, and nothing flew there."""
    local = {"x": 200.0, "y": 300.0, "z": -40.0}
    home = {"lat": 437806000, "lon": -794653000, "alt": 200000, "relative_alt": 10000}
    records = [(float(n), beat(1, n, armed=True)) for n in range(60)]
    records += [(n + 0.2, frame("EXTENDED_SYS_STATE", {"landed_state": IN_AIR}, seq=n)) for n in range(60)]
    records += [(n + 0.3, frame("LOCAL_POSITION_NED", local, seq=n)) for n in range(60)]
    records += [(n + 0.4, frame("GLOBAL_POSITION_INT", home, seq=n)) for n in range(5, 60)]
    (flight,) = vehicle(report_of(log(records)), 1).flights
    assert flight.distance_m < 1 and flight.highest_m == pytest.approx(10.0)
    assert flight.drawing is not None
    xs, ys = flight.drawing.track
    assert max(map(abs, [*xs, *ys])) < 1


def test_armed_on_the_ground_is_no_flight_and_the_landed_state_decides() -> None:
    records = []
    for n in range(60):
        records.append((float(n), beat(1, 2 * n, armed=5 <= n < 50)))
        state = TAKEOFF if n == 10 else IN_AIR if 10 < n < 40 else LANDING if n == 40 else ON_GROUND
        records.append((n + 0.5, frame("EXTENDED_SYS_STATE", {"landed_state": state}, seq=2 * n + 1 & 255)))
        records.append((float(n), beat(2, n, armed=5 <= n < 50, status=3)))  # an ArduPilot that stands by
    report = report_of(log(records))
    (flight,) = vehicle(report, 1).flights
    assert (flight.begin_s - T0_US / 1e6, flight.end_s - T0_US / 1e6) == pytest.approx((5.0, 49.5), abs=0.01)
    assert flight.air_s == pytest.approx(31.0, abs=0.51)
    assert vehicle(report, 2).flights == []


def test_the_air_time_of_px4_is_that_of_its_landed_states() -> None:
    """Oracle: EXTENDED_SYS_STATE as pymavlink reads it."""
    report = own_report("sitl-3ardupilot-2px4")
    flew: dict[int, list[float]] = defaultdict(list)
    for t_s, sysid, _, message in records(CAPTURE.read_bytes(), EVENT_IDS):
        if message.get_type() == "EXTENDED_SYS_STATE" and message.landed_state in (IN_AIR, TAKEOFF, LANDING):
            flew[sysid].append(t_s)
    for sysid in (4, 5):
        (flight,) = vehicle(report, sysid).flights
        assert flight.air_s == pytest.approx(flew[sysid][-1] - flew[sysid][0], abs=2.1)


def test_height_and_battery_are_the_greatest_and_least_that_pymavlink_reads() -> None:
    report = own_report("sitl-3ardupilot-2px4")
    heights: dict[int, list[float]] = defaultdict(list)
    for _, sysid, _, message in records(CAPTURE.read_bytes(), POSITION_IDS):
        if message.get_type() == "GLOBAL_POSITION_INT":
            heights[sysid].append(message.relative_alt / 1000)
    assert {day.key[0]: day.highest_m for day in report.vehicles} == {n: max(h) for n, h in heights.items()}


def test_a_recording_that_ends_in_the_air_is_a_flight_in_part_and_nothing_lasts_into_the_next() -> None:
    first = log((float(n), beat(1, n, armed=True)) for n in range(20))
    later = log((300.0 + n, beat(1, 100 + n, armed=n < 10)) for n in range(20))
    day = vehicle(report_of(first, later), 1)
    assert [(round(f.air_s), f.whole) for f in day.flights] == [(19, False), (9, False)]
    assert [e for e in day.events if e.kind is EventKind.SILENT] == []
    assert day.sources[0].lost == 0


@each("armed", [True, False])
def test_after_a_long_silence_a_flight_begins_with_a_heartbeat_that_says_so(armed: bool) -> None:
    """It landed unheard; what came before its first heartbeat counted as a second flight."""
    records = [(float(n), beat(1, n, armed=True)) for n in range(20)]
    records += [(200.0 + n / 4, frame("ATTITUDE", {}, seq=20 + n)) for n in range(4)]
    records += [(201.0 + n, beat(1, 24 + n, armed=armed)) for n in range(5)]
    flights = vehicle(report_of(log(records)), 1).flights
    assert [flight.begin_s - T0_US / 1e6 for flight in flights] == pytest.approx([0.0, 201.0] if armed else [0.0])


def test_flights_are_bounded() -> None:
    records = [(n * 1.0, beat(1, n, armed=n % 4 in (1, 2))) for n in range(4 * MOST_FLIGHTS + 40)]
    report = report_of(log(records))
    day = vehicle(report, 1)
    assert (len(day.flights), day.flights_left_out) == (MOST_FLIGHTS, 10)


def test_every_vehicle_has_its_share_of_the_drawings() -> None:
    records = [(n * 1.0, beat(sysid, n, armed=n % 4 in (1, 2))) for n in range(800) for sysid in (1, 2)]
    report = report_of(log(records))
    for sysid in (1, 2):
        drawn = [flight.drawing is not None for flight in vehicle(report, sysid).flights]
        assert drawn == [True] * (MOST_DRAWN // 2) + [False] * (200 - MOST_DRAWN // 2)
    assert any("drawings of 100 flights" in line for line in report.missing)


# -- events


def test_texts_are_those_that_pymavlink_reads() -> None:
    known: set[int] = set()
    texts: dict[int, list[tuple[int, str]]] = defaultdict(list)
    for _, sysid, _, message in records(CAPTURE.read_bytes(), EVENT_IDS):
        if message.get_type() == "HEARTBEAT":
            known.add(sysid)
        elif message.get_type() == "STATUSTEXT" and sysid in known:
            texts[sysid].append((message.severity, message.text.strip()))
    report = own_report("sitl-3ardupilot-2px4")
    found = {
        day.key[0]: [(e.severity, e.text) for e in day.events if e.kind is EventKind.TEXT] for day in report.vehicles
    }
    assert sum(map(len, found.values())) > 20
    assert found == {sysid: texts[sysid] for sysid in found}


def test_a_failsafe_and_a_silence_in_the_air_are_worse_than_a_warning() -> None:
    warning = frame("STATUSTEXT", {"severity": 4, "text": "EKF variance"}, seq=200)
    records = [(n * 1.0, beat(1, n, armed=True, status=5 if 5 <= n < 8 else 4)) for n in range(20) if not 9 < n < 15]
    day = vehicle(report_of(log([*records, (2.5, warning)])), 1)
    worst = day.worst
    assert worst is not None and worst.kind is EventKind.FAILSAFE and worst.duration_s == pytest.approx(3.0)
    (silence,) = [e for e in day.events if e.kind is EventKind.SILENT]
    assert silence.in_air and silence.duration_s == pytest.approx(6.0)
    kinds = [e.kind for e in day.events]
    assert EventKind.ARMED in kinds and EventKind.MODE in kinds
    on_ground = vehicle(report_of(log((float(n), beat(3, n, armed=False, status=5)) for n in range(5))), 3).worst
    assert on_ground is not None and on_ground.rank > silence.rank
    before = [(0.0, beat(2, 0, armed=False)), (1.0, frame("STATUSTEXT", {"severity": 2, "text": "PreArm: x"}, sysid=2))]
    waiting = vehicle(report_of(log(before)), 2).worst
    assert waiting is not None and waiting.rank > worst.rank and waiting.rank > silence.rank


# -- how near they came


def crossing(closest_m: float, speed_mps: float = 5.0) -> list[tuple[float, bytes]]:
    """Two vehicles on crossing ways; the first flies east, the second north, and they are nearest at 20 s."""
    frame_enu = EnuFrame(ORIGIN)
    half = closest_m / math.sqrt(2)
    records = []
    for tenth in range(400):
        t_s = tenth / 10
        for sysid in (1, 2):
            at_s = t_s + 0.03 * sysid
            along = speed_mps * (at_s - 20.0)
            place = (along + half, -half, 30.0) if sysid == 1 else (0.0, along, 30.0)
            lat, lon, alt = frame_enu.to_geodetic(*place)
            values = {"time_boot_ms": round(1000 * at_s), "lat": round(lat * 1e7), "lon": round(lon * 1e7)}
            values |= {"alt": round(alt * 1000), "relative_alt": 30_000}
            values |= {"vx": 0, "vy": 500} if sysid == 1 else {"vx": 500, "vy": 0}
            records.append((at_s, frame("GLOBAL_POSITION_INT", values, sysid=sysid, seq=tenth & 255)))
            if tenth % 10 == 0:
                records.append((at_s - 0.01, beat(sysid, tenth, armed=True)))
    return records


@each("closest_m", [1.0, 6.0])
def test_the_closest_approach_is_that_of_the_geometry(closest_m: float) -> None:
    """Oracle: the ways themselves, every millisecond."""
    half = closest_m / math.sqrt(2)
    ways = [((5 * t / 1000 + half) ** 2 + (-half - 5 * t / 1000) ** 2, t / 1000) for t in range(-20_000, 20_000)]
    least_m, at_s = math.sqrt(min(ways)[0]), min(ways)[1] + 20.0
    report = report_of(log(crossing(closest_m)))
    (approach,) = report.approaches
    assert (approach.first, approach.second) == ((1, 1), (2, 1))
    assert approach.distance_m == pytest.approx(least_m, abs=0.3)
    assert approach.at_s - T0_US / 1e6 == pytest.approx(at_s, abs=0.11)
    assert approach.used == pytest.approx(approach.separation_m / 2.5)


def test_vehicles_on_the_ground_come_not_near() -> None:
    records = [(t, raw if raw[7] else beat(raw[5], raw[4], armed=raw[5] == 1)) for t, raw in crossing(1.0)]
    assert report_of(log(records)).approaches == []


LAT_RAD = math.radians(47.398)
"""Of the flight below."""

NORTH_M_PER_DEG = 111_132.92 - 559.82 * math.cos(2 * LAT_RAD) + 1.175 * math.cos(4 * LAT_RAD)
EAST_M_PER_DEG = 111_412.84 * math.cos(LAT_RAD) - 93.5 * math.cos(3 * LAT_RAD)
"""Lengths of a degree on WGS84, as maps have them (series of the NGA)."""


def test_pairs_of_a_real_flight_against_positions_between_those_of_pymavlink() -> None:
    """Oracle: straight lines between the positions, every 20 ms while both are off the ground, on a plane."""
    rows: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for t_s, sysid, _, message in records(CAPTURE.read_bytes(), POSITION_IDS):
        east, north = 1e-7 * message.lon * EAST_M_PER_DEG, 1e-7 * message.lat * NORTH_M_PER_DEG
        rows[sysid].append((t_s, east, north, message.alt / 1000, message.relative_alt / 1000))
    grid = numpy.arange(min(r[0][0] for r in rows.values()), max(r[-1][0] for r in rows.values()), 0.02)
    ways = {}
    for sysid, found in rows.items():
        table = numpy.array(found)
        ways[sysid] = numpy.array([numpy.interp(grid, table[:, 0], table[:, n]) for n in range(1, 5)])
    approaches = own_report("sitl-3ardupilot-2px4").approaches
    assert len(approaches) == 10
    for approach in approaches:
        first, second = ways[approach.first[0]], ways[approach.second[0]]
        distances = numpy.linalg.norm(first[:3] - second[:3], axis=0)
        nearest = distances[(first[3] > 0.3) & (second[3] > 0.3)].min()
        assert approach.distance_m == pytest.approx(nearest, rel=0.002, abs=0.2)


# -- links


def independent_delays(content: bytes) -> dict[tuple[int, int], list[float]]:
    """Delays by system and command, in ms: a plain pairing, one waiting command of a kind at a time."""
    waiting: dict[tuple[int, int], float] = {}
    found: dict[tuple[int, int], list[float]] = defaultdict(list)
    for t_s, sysid, _, message in records(content, COMMAND_IDS):
        if message.get_type() in ("COMMAND_LONG", "COMMAND_INT") and message.target_system:
            waiting.setdefault((message.target_system, message.command), t_s)
        elif message.get_type() == "COMMAND_ACK":
            key = sysid, message.command
            if key in waiting:
                found[key].append(1000 * (t_s - waiting.pop(key)))
    return found


@each("name", ["sitl-3ardupilot-2px4", "copter-radio-flight", "px4-mission-flight"])
def test_delays_are_those_of_an_independent_pairing(name: str) -> None:
    content = own_capture(name)
    oracle = independent_delays(content)
    names = offline().enums["MAV_CMD"]
    by_name = {(sysid, names.get(n, str(n)).removeprefix("MAV_CMD_")): times for (sysid, n), times in oracle.items()}
    answered = 0
    for day in own_report(name).vehicles:
        for delay in day.delays:
            times = by_name.get((day.key[0], delay.command), [])
            answered += delay.answered
            assert delay.answered == len(times)
            if times:
                assert delay.median_ms == pytest.approx(statistics.median(times), abs=0.01)
                assert delay.largest_ms == pytest.approx(max(times), abs=0.01)
                assert sorted(times)[0] - 0.01 <= delay.p95_ms <= max(times) + 0.01
    assert answered == sum(map(len, oracle.values())) > 0


def test_a_repeated_command_counts_once_and_from_its_first_sending() -> None:
    def command(seq: int) -> bytes:
        return frame("COMMAND_LONG", {"target_system": 1, "command": 400}, sysid=255, compid=190, seq=seq)

    ack = frame("COMMAND_ACK", {"command": 400, "target_system": 255}, seq=1)
    other = frame("COMMAND_ACK", {"command": 400, "target_system": 254}, seq=1)
    records = [(0.0, beat(1, 0, armed=False)), (1.0, command(0)), (2.0, command(1)), (2.2, other), (2.5, ack)]
    records += [(3.0, ack), (10.0, command(2)), (40.0, ack)]
    (delay,) = vehicle(report_of(log(records)), 1).delays
    assert (delay.asked, delay.answered, delay.repeats) == (2, 1, 1)
    assert delay.median_ms == pytest.approx(1500.0)


@pytest.mark.deep
@each("name", present("tlog", RADIO_LOGS))
def test_radios_are_what_pymavlink_reads(name: str) -> None:
    content = public_file(f"tlog/{name}").read_bytes()
    values: dict[str, list[int]] = defaultdict(list)
    for _, _, _, message in records(content, RADIO_IDS):
        if message.get_type() in ("RADIO", "RADIO_STATUS"):
            for signal in ("rssi", "remrssi", "noise", "remnoise", "txbuf"):
                values[signal].append(getattr(message, signal))
    (radio,) = report_of(content).radios
    assert (radio.sysid, radio.compid, radio.reports) == (51, 68, len(values["rssi"]))
    for signal, found in (
        *(("rssi", radio.rssi), ("remrssi", radio.remote_rssi)),
        *(("noise", radio.noise), ("remnoise", radio.remote_noise)),
    ):
        known = [value for value in values[signal] if value != 255]
        assert found == (min(known), statistics.median(known), max(known))
    assert radio.least_txbuf_percent == min(values["txbuf"])
    assert radio.median_txbuf_percent == statistics.median(values["txbuf"])


def test_losses_per_source_are_the_frames_that_were_left_out() -> None:
    made = FlightLog(2, 2.0)
    whole, thinned = (report_of(made.content(100.0, lose=lose)) for lose in (0.0, 0.05))
    for day in thinned.vehicles:
        (source,), (before,) = day.sources, vehicle(whole, day.key[0]).sources
        assert source.lost == pytest.approx(before.frames - source.frames, abs=5)
        assert before.lost == 0
    assert [(s.sysid, s.compid, s.lost) for s in whole.other_sources] == [(255, 190, None)]


def test_frames_of_unknown_messages_alone_are_no_source() -> None:
    known = [heartbeat(seq=seq) for seq in range(2)]
    noise = [unknown_frame(sysid=173), unknown_frame(sysid=1, seq=2)]
    content = b"".join(encode_record(T0_US + n * 100_000, raw) for n, raw in enumerate((*noise, *known)))
    assert sources_of(report_of(content)) == {"1/1": 2}


def sources_of(report: DayReport) -> dict[str, int]:
    every: Sequence[Any] = [*(s for day in report.vehicles for s in day.sources), *report.other_sources]
    return {f"{s.sysid}/{s.compid}": s.frames for s in every}


@each("name", ["sitl-3ardupilot-2px4", "copter-companion", "px4-late-frames"])
def test_frames_per_source_are_those_that_pymavlink_reads(name: str) -> None:
    counts: dict[str, int] = defaultdict(int)
    for record in records(own_capture(name)):
        counts[f"{record.sysid}/{record.compid}"] += 1
    assert sources_of(own_report(name)) == counts


# -- The paths of plans, and whose they are.


def report(*systems: int) -> DayReport:
    return DayReport("x", vehicles=[VehicleDay((n, 1), f"vehicle {n}") for n in systems])


def test_a_phased_plan_flies_from_corner_to_corner() -> None:
    phases = (Phase("up", {"a": (0.0, 0.0, 9.0)}), Phase("out", {"a": (5.0, 0.0, 9.0), "b": (1.0, 1.0, 3.0)}))
    paths = planned_paths(PhasedPlan({"a": (0.0, 0.0, 0.0), "b": (1.0, 1.0, 0.0)}, phases))
    assert paths == {"a": [(0.0, 0.0, 0.0), (0.0, 0.0, 9.0), (5.0, 0.0, 9.0)], "b": [(1.0, 1.0, 0.0), (1.0, 1.0, 3.0)]}


def test_a_timed_plan_is_sampled_from_begin_to_end() -> None:
    way = path_within([(0.0, 0.0, 5.0), (30.0, 0.0, 5.0), (30.0, 40.0, 15.0)], MotionLimits())
    (points,) = planned_paths(TimedPlan({"a": way})).values()
    assert points[0] == pytest.approx((0.0, 0.0, 5.0)) and points[-1] == pytest.approx((30.0, 40.0, 15.0))
    assert len(points) > 400
    assert all(-1.0 <= x <= 31.0 and -1.0 <= y <= 41.0 and 4.0 <= up <= 16.0 for x, y, up in points)


def test_a_path_goes_to_the_vehicle_of_its_name() -> None:
    assert [system_of(name, {"alpha": 7, "v3": 9}) for name in ("alpha", "v3", "V4", "vehicle 5", "6", "beta")] == [
        *(7, 9, 4, 5, 6),
        None,
    ]
    made = report(7, 8)
    add_plan(made, {"alpha": [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)], "beta": [(0.0, 0.0, 0.0)]}, {"alpha": 7})
    assert made.vehicles[0].plan == ([1.0, 4.0], [2.0, 5.0])
    assert made.vehicles[0].plan_heights_m == (3.0, 6.0)
    assert made.vehicles[1].plan is None
    assert made.missing == [
        "the plan's paths of beta: no tlog has a vehicle of that name; --fleet FILE gives system ids names"
    ]


def test_the_only_path_goes_to_the_only_vehicle() -> None:
    made = report(3)
    add_plan(made, {"survey": [(1.0, 2.0, 3.0)]}, {})
    assert made.vehicles[0].plan == ([1.0], [2.0]) and made.missing == []


# -- Curves and maps: round ticks, one scale on both axes, gaps that stay gaps.


finite = st.floats(-1e6, 1e6)
maybe = st.one_of(finite, st.just(math.nan))


def paths(svg: str) -> list[list[tuple[str, float, float]]]:
    """Commands with their places, of each path."""
    root = ElementTree.fromstring(svg)
    found = []
    for path in root.iter("path"):
        pieces = re.findall(r"([ML])(-?[\d.]+) (-?[\d.]+)", path.attrib["d"])
        found.append([(command, float(x), float(y)) for command, x, y in pieces])
    return found


@settings(max_examples=examples(200))
@given(finite, st.floats(1e-3, 1e6), st.integers(1, 8))
def test_ticks_are_round_and_few_and_within(low: float, span: float, most: int) -> None:
    found = ticks(low, low + span, most)
    assert len(found) <= most + 1
    assert all(low - 1e-6 * span <= tick <= low + span * (1 + 1e-6) for tick in found)
    steps = {round((b - a) / span, 6) for a, b in itertools.pairwise(found)}
    assert len(steps) <= 1


@settings(max_examples=examples(200))
@given(st.lists(st.tuples(maybe, maybe), min_size=1, max_size=20))
def test_a_map_has_one_scale_and_everything_is_on_it(places: list[tuple[float, float]]) -> None:
    xs, ys = [x for x, _ in places], [y for _, y in places]
    drawing = ground_map("map", [Drawn("flown", (xs, ys))])
    known = [(x, y) for x, y in places if math.isfinite(x) and math.isfinite(y)]
    if not known:
        assert "<path" not in drawing
        return
    (drawn,) = paths(drawing)
    assert all(0 <= x <= WIDTH and 0 <= y <= MAP_HEIGHT for _, x, y in drawn)
    assert len(drawn) == len(known)
    for (_, x0, y0), (_, x1, y1), a, b in zip(drawn, drawn[1:], known, known[1:], strict=False):
        wide, high = b[0] - a[0], b[1] - a[1]
        if abs(wide) > 1 and abs(high) > 1 and min(abs(x1 - x0), abs(y1 - y0)) > 20:
            assert (x1 - x0) / wide == pytest.approx(-(y1 - y0) / high, rel=0.02)


def test_a_gap_is_not_drawn_over_and_a_single_value_is_seen() -> None:
    line = [0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 2.0, math.nan, 3.0, 4.0]
    (drawn,) = paths(curves("height", [Drawn("flown", line)], " m"))
    assert [command for command, _, _ in drawn] == ["M", "L", "M", "L"]
    assert "h0.1" in curves("height", [Drawn("flown", ([5.0], [1.0]))], " m")
    assert curves("height", [Drawn("flown", ([], []))], " m") == ""
    assert curves("height", [Drawn("flown", ([1.0], [math.nan]))], " m") == ""


def test_labels_are_escaped_and_times_are_of_the_day() -> None:
    noon = 1_780_056_000.0  # 2026-05-29 12:00:00
    svg = curves('<&">', [Drawn("flown", ([noon, noon + 3600], [0.0, 10.0]))], " <m>")
    words = [text.text for text in ElementTree.fromstring(svg).iter("text")]
    assert "12:00" in words and "12:15" in words and "5 <m>" in words
