from __future__ import annotations

import contextlib
import io
import json
import math
import zipfile
from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.geo import Origin, geodetic_from_enu
from skygcs.core.plan import file_reading, skyc
from skygcs.core.plan.crazyswarm import HEADER, read_crazyswarm, write_crazyswarm
from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, TimedPlan
from skygcs.core.plan.plan_files import read_plan
from skygcs.core.plan.plan_json import read_plan_json, write_plan_json
from skygcs.core.plan.skyc import read_skyc, write_skyc
from skygcs.core.plan.trajectory_csv import read_log_csv, read_trajectory_csv
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory, motion_peaks
from skygcs.errors import PlanFileError, TrajectoryError
from support.examples import examples
from support.table import each

LIMITS = MotionLimits()
ORIGIN = Origin(47.4, 8.5, 400.0)
CORNERS = ((-50.0, -50.0), (50.0, -50.0), (0.0, 0.0), (50.0, 50.0))
SPACE = FlightSpace(CORNERS, 0.0, 40.0, (((1.0, 2.0, 0.0), (3.0, 4.0, 5.0)),), {"p": (9.0, 9.0, 0.0)})

coefficient = st.floats(-50, 50).map(lambda c: round(c, 6))
octuple = st.lists(coefficient, min_size=8, max_size=8).map(tuple)
pieces = st.builds(Piece, st.floats(0.05, 2.0), octuple, octuple, octuple, octuple)
trajectories = st.lists(pieces, min_size=1, max_size=4).map(Trajectory)


def near(one: Trajectory, other: Trajectory, tolerance: float = 1e-6) -> None:
    assert other.duration_s == pytest.approx(one.duration_s)
    for i in range(21):
        t = i / 20 * one.duration_s * (1 - 1e-9)
        assert math.dist(one.at(t).pos_enu_m, other.at(t).pos_enu_m) < tolerance


# --- vehicle,t,x,y,z,yaw ----------------------------------------------------------------------------------------------


def test_timed_rows_are_joined_by_straight_lines_and_vehicles_may_take_turns() -> None:
    text = (
        "vehicle,t,x,y,z,yaw\n# a comment\nalpha,0,0,0,5,90\nbravo,0,10,0,5,\nalpha,10,20,0,5,90\n\nbravo,4,10,8,5,\n"
    )
    found = read_trajectory_csv("f.csv", text.encode(), LIMITS)
    assert list(found) == ["alpha", "bravo"]
    assert found["alpha"].at(5.0).pos_enu_m == pytest.approx((10.0, 0.0, 5.0))
    assert found["alpha"].at(5.0).yaw_rad == pytest.approx(math.pi / 2)
    assert found["bravo"].at(2.0).vel_enu_mps == pytest.approx((0.0, 2.0, 0.0))
    assert found["bravo"].at(2.0).yaw_rad is None


def test_rows_without_times_are_timed_within_the_limits() -> None:
    found = read_trajectory_csv("f.csv", b"vehicle,x,y,z\nalpha,0,0,5\nalpha,50,0,5\nalpha,50,20,5\n", LIMITS)
    assert motion_peaks(found["alpha"]).speed_mps.at_most <= LIMITS.speed_mps * (1 + 1e-6)
    assert found["alpha"].end_enu_m == pytest.approx((50.0, 20.0, 5.0))


@each(
    ("text", "words"),
    [
        ("", "it is empty"),
        ("vehicle,x,y,z\n", "it names no vehicle"),
        ("vehicle,x,y\nalpha,0,0\n", "line 1: the columns are"),
        ("vehicle,x,y,z,speed\nalpha,0,0,0,1\n", "line 1: the columns are"),
        ("vehicle,x,y,z,x\nalpha,0,0,0,1\n", "line 1: a column is there twice"),
        ("vehicle,x,y,z\nalpha,0,0,nan\n", "line 2: z of nan is not within"),
        ("vehicle,x,y,z\nalpha,0,0,1e9\n", "line 2: z of 1e+09 is not within"),
        ("vehicle,x,y,z\nalpha,0,,1\n", "line 2: y is missing"),
        ("vehicle,x,y,z\nalpha,0,b,1\n", "line 2: y is not a number: 'b'"),
        ("vehicle,x,y,z\nalpha,0,0,1,7\n", "line 2: 5 cells"),
        ("vehicle,x,y,z\n,0,0,1\n", "line 2: vehicle is missing"),
        ('vehicle,x,y,z\n"alpha,0,0,1\n', "line 2: not CSV"),
        ("vehicle,t,x,y,z\na,0,0,0,1\na,,1,0,1\n", "either every row has a time t or none"),
        ("vehicle,x,y,z,yaw\na,0,0,1,0\na,1,0,1,\n", "vehicle a: either every row has a yaw or none"),
        ("vehicle,t,x,y,z\na,0,0,0,1\na,0,1,0,1\n", "vehicle a, lines 2 to 3: piece 1: from 0 s to 0 s"),
        ("vehicle,t,x,y,z\na,5,0,0,1\na,3,1,0,1\n", "vehicle a, lines 2 to 3: piece 1: from 5 s to 3 s"),
        ("vehicle,t,x,y,z\na,-1,0,0,1\na,3,1,0,1\n", "vehicle a, lines 2 to 3: the first time is -1 s"),
    ],
)
def test_a_csv_that_cannot_be_flown_is_refused_with_its_line(text: str, words: str) -> None:
    with pytest.raises(PlanFileError) as refused:
        read_trajectory_csv("f.csv", text.encode(), LIMITS)
    assert str(refused.value).startswith(f"f.csv: {words}")


# --- logs -------------------------------------------------------------------------------------------------------------


def log_rows(integers: bool) -> str:
    lines = ["time,mode,lat,lon,alt,vx,vy,vz,roll,pitch,yaw"]
    for i in range(4):
        lat, lon, amsl = geodetic_from_enu(10.0 * i, 5.0, 20.0, ORIGIN)
        alt = amsl - ORIGIN.alt_amsl_m
        scaled = f"{round(lat * 1e7)},{round(lon * 1e7)},{round(alt * 1e3)}"
        place = scaled if integers else f"{lat:.9f},{lon:.9f},{alt:.4f}"
        lines.append(f"{1700000000 + 2 * i},GUIDED,{place},0,0,0,0,0,0")
    return "\n".join(lines) + "\n"


@each("integers", [False, True])
def test_a_log_is_flown_again_in_degrees_or_in_the_integers_of_mavlink(integers: bool) -> None:
    found = read_log_csv("log.csv", log_rows(integers).encode(), ORIGIN, "alpha")["alpha"]
    assert found.duration_s == pytest.approx(6.0)
    assert found.at(3.0).pos_enu_m == pytest.approx((15.0, 5.0, 20.0), abs=0.02)


def test_a_log_may_have_clock_times() -> None:
    text = "time,lat,lon,alt_amsl\n2021-05-01 12:59:58.5,47.4,8.5,410\n2021-05-01 13:00:01,47.4001,8.5,410\n"
    found = read_log_csv("log.csv", text.encode(), ORIGIN, "alpha")["alpha"]
    assert found.duration_s == pytest.approx(2.5)
    assert found.start_enu_m == pytest.approx((0.0, 0.0, 10.0), abs=1e-3)


@each(
    ("row", "words"),
    [
        ("0,95,8.5,0", "95, 8.5 is not a place on earth"),
        ("0,47.4,9.99,0", "from the origin"),
        ("soon,47.4,8.5,0", "time is not a number"),
        ("0,47.4,8.5,", "alt is not a number"),
    ],
)
def test_a_log_row_that_is_no_place_is_refused(row: str, words: str) -> None:
    with pytest.raises(PlanFileError, match=words):
        read_log_csv("log.csv", f"time,lat,lon,alt\n{row}\n".encode(), ORIGIN, "alpha")


# --- Crazyswarm -------------------------------------------------------------------------------------------------------


@given(trajectories)
def test_crazyswarm_is_read_as_it_was_written(trajectory: Trajectory) -> None:
    assert read_crazyswarm("f.csv", write_crazyswarm(trajectory).encode()) == trajectory


def test_crazyswarm_with_a_trailing_comma_and_without_a_header() -> None:
    row = ",".join(["1.05", *("0",) * 4, "0.830443", "-0.276140", "-0.384219", "0.180493", *("0",) * 24])
    for text in (f"{row},\n", f"# {HEADER}\n{row}", f"{HEADER},\n{row},"):
        (piece,) = read_crazyswarm("figure8.csv", text.encode()).pieces
        assert (piece.duration_s, piece.east[4], piece.yaw) == (1.05, 0.830443, (0.0,) * 8)


def test_crazyswarm_that_is_none_is_refused() -> None:
    with pytest.raises(PlanFileError, match=r"f\.csv: line 1: 34 numbers; a piece has 33"):
        read_crazyswarm("f.csv", ",".join(["1"] * 34).encode())
    with pytest.raises(PlanFileError, match=r"piece 1: a duration of 0 s"):
        read_crazyswarm("f.csv", ",".join(["0"] * 33).encode())
    with pytest.raises(TrajectoryError, match="piece 1, north: the degree is above 7"):
        write_crazyswarm(Trajectory([Piece(1.0, (0.0,), (0.0,) * 8 + (1.0,), (0.0,))]))


# --- shows ------------------------------------------------------------------------------------------------------------


@settings(max_examples=examples(30))
@given(st.lists(trajectories, min_size=1, max_size=3))
def test_a_show_is_read_as_it_was_written(fleet: list[Trajectory]) -> None:
    """Where a trajectory jumps between its pieces a show cannot: it begins each piece where the last one ended."""
    smooth = {f"drone {i}": _joined(trajectory) for i, trajectory in enumerate(fleet)}
    found = read_skyc("show.skyc", write_skyc(smooth))
    assert list(found) == list(smooth)
    for name, trajectory in smooth.items():
        near(trajectory, found[name], 1e-5)


def _joined(trajectory: Trajectory) -> Trajectory:
    found: list[Piece] = []
    end = trajectory.start_enu_m
    for piece in trajectory.pieces:
        axes = [(place, *c[1:]) for place, (_, c) in zip(end, piece.axes()[:3], strict=True)]
        found.append(Piece(piece.duration_s, *axes))
        end = Trajectory([found[-1]]).end_enu_m
    return Trajectory(found)


def show_of(trajectory: object, **settings: object) -> bytes:
    file = io.BytesIO()
    show = {"version": 1, "swarm": {"drones": [{"settings": {"name": "a", "trajectory": trajectory, **settings}}]}}
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("show.json", json.dumps(show))
    return file.getvalue()


def test_a_bezier_segment_of_a_show_is_the_curve_it_draws() -> None:
    points = [[0, [0, 0, 0], []], [2, [0, 0, 4], [[0, 0, 0], [0, 0, 4]]], [3, [1, 0, 4], []]]
    found = read_skyc("s.skyc", show_of({"version": 1, "takeoffTime": 5, "points": points}))["a"]
    assert found.duration_s == pytest.approx(8.0)
    assert found.at(4.0).vel_enu_mps == (0.0, 0.0, 0.0)
    assert found.at(6.0).pos_enu_m == pytest.approx((0.0, 0.0, 2.0))  # smoothstep at its middle
    assert found.at(6.0).vel_enu_mps == pytest.approx((0.0, 0.0, 3.0))
    assert found.at(7.5).pos_enu_m == pytest.approx((0.5, 0.0, 4.0))


@each(
    ("trajectory", "words"),
    [
        ({"version": 2, "points": [[0, [0, 0, 0], []]]}, "version 2; only 1 is known"),
        ({"points": [[0, [0, 0, 0], []]]}, "version None"),
        ({"version": 1, "points": []}, "0 points"),
        ({"version": 1, "points": [[0, [0, 0], []]]}, "point 1: a place has three numbers"),
        ({"version": 1, "points": [[0, [0, 0, 0], []], [0, [1, 0, 0], []]]}, "a segment of 0 s"),
        ({"version": 1, "points": [[0, [0, 0, 0], []], [1, [1, 0, 0], [[0, 0, 0]] * 15]]}, "15 control points"),
        ({"version": 1, "points": [[0, [0, 0, 0], [[0, 0, 0]]]]}, "the first point has no control points"),
        ({"version": 1, "points": [[0, [0, 0, 1e9], []]]}, "a coordinate of 1e+09"),
        ({"version": 1, "points": [[0, [0, 0, "x"], []]]}, "a coordinate is not a number"),
        ({"version": 1, "points": [[0, [0, 0, 0], []], [1, [0, 0, 0, 1], []]]}, "either all points have a yaw or none"),
        ({"$ref": "./nowhere.json#"}, "there is no 'nowhere.json' in the zip"),
        ([], "there is no trajectory"),
    ],
)
def test_a_show_that_cannot_be_flown_is_refused(trajectory: object, words: str) -> None:
    with pytest.raises(PlanFileError) as refused:
        read_skyc("s.skyc", show_of(trajectory))
    assert words in str(refused.value)


LEVEL = {"version": 1, "takeoffTime": 0, "points": [[0, [0, 0, 5], []], [10, [20, 0, 5], [[5, 0, 5], [15, 0, 5]]]]}


def test_the_yaw_of_a_show_is_clockwise_from_its_x_axis() -> None:
    """As Skybrush Studio samples it: Blender's rotation about z (counter-clockwise) of 0, 90, 90 and 450 degrees at
    these times is exported with its sign changed, not wrapped."""
    control = {"version": 1, "setpoints": [[0, 0], [4, -90], [6, -90], [10, -450]]}
    found = read_skyc("s.skyc", show_of(LEVEL, yawControl=control))["a"]
    plain = read_skyc("s.skyc", show_of(LEVEL))["a"]
    assert not plain.has_yaw and found.has_yaw
    near(plain, found, 1e-9)
    yaws = [math.degrees(found.at(t).yaw_rad or 0.0) for t in (0.0, 2.0, 4.0, 5.0, 8.0, 10.0, 20.0)]
    assert yaws == pytest.approx([0.0, 45.0, 90.0, 90.0, 270.0, 450.0, 450.0])
    assert found.at(7.0).yaw_rate_radps == pytest.approx(math.radians(90.0))
    # before the first setpoint and after the last it stays; times are the show's, also of one that begins later
    short = {"version": 1, "setpoints": [[8, 10], [9, 20]]}
    late = read_skyc("s.skyc", show_of(LEVEL | {"takeoffTime": 5}, yawControl=short))["a"]
    yaws = [math.degrees(late.at(t).yaw_rad or 0.0) for t in (0.0, 8.0, 8.5, 9.0, 15.0)]
    assert yaws == pytest.approx([-10.0, -10.0, -15.0, -20.0, -20.0])


@each("seed", range(10))
def test_a_yaw_is_written_within_a_tenth_of_a_degree(seed: int) -> None:
    """Curves of degree 3 with a jump between pieces, which takes 2 ms."""
    rng = Random(seed)
    curves = [tuple(rng.uniform(-2.0, 2.0) for _ in range(4)) for _ in range(3)]
    flown = Trajectory([Piece(rng.uniform(0.3, 3.0), (0.0,), (0.0,), (5.0,), curve) for curve in curves])
    found = read_skyc("s.skyc", write_skyc({"a": flown}))["a"]
    for begin_s, piece in zip(flown.begins_s, flown.pieces, strict=True):
        for k in range(1, 100):
            t = begin_s + 0.003 + k / 100 * (piece.duration_s - 0.004)
            off = math.remainder((found.at(t).yaw_rad or 0.0) - (flown.at(t).yaw_rad or 0.0), math.tau)
            assert abs(off) <= math.radians(0.1001)


@each(
    ("control", "words"),
    [
        ({"version": 2, "setpoints": []}, "yawControl of version 2; only 1 is known"),
        ({"version": 1}, "yawControl has no list setpoints"),
        ({"version": 1, "setpoints": [[0]]}, "yaw setpoint 1: a setpoint is [time, degrees]"),
        ({"version": 1, "setpoints": [[0, "x"]]}, "yaw setpoint 1: yaw is not a number"),
        ({"version": 1, "setpoints": [[0, 1e9]]}, "yaw setpoint 1: yaw of 1e+09"),
        ({"version": 1, "setpoints": [[5, 0], [5, 90]]}, "the times of its yaw do not ascend"),
        ({"version": 1, "setpoints": [[0, 0]] * 10_001}, "10000 at most"),
        ([], "there is no yawControl"),
        ({"$ref": "./nowhere.json#"}, "there is no 'nowhere.json' in the zip"),
        ({"$ref": 5}, "there is no $ref"),
    ],
)
def test_a_yaw_that_is_none_is_refused(control: object, words: str) -> None:
    with pytest.raises(PlanFileError) as refused:
        read_skyc("s.skyc", show_of(LEVEL, yawControl=control))
    assert words in str(refused.value)


def test_a_yaw_in_two_places_is_refused_and_one_without_setpoints_is_none() -> None:
    points = [[0, [0, 0, 0, 0.5], []], [1, [1, 0, 0, 0.5], []]]
    control = {"version": 1, "setpoints": [[0, 0]]}
    with pytest.raises(PlanFileError, match="it has a yaw in its points, and yawControl"):
        read_skyc("s.skyc", show_of({"version": 1, "points": points}, yawControl=control))
    assert not read_skyc("s.skyc", show_of(LEVEL, yawControl={"version": 1, "setpoints": []}))["a"].has_yaw


def test_a_zip_bomb_is_not_unpacked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(skyc, "MAX_UNPACKED_BYTES", 1 << 20)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("show.json", b" " * (8 << 20))
    assert len(file.getvalue()) < 20_000
    with pytest.raises(PlanFileError, match=r"show\.json: unpacks to more than 1 MiB"):
        read_skyc("bomb.skyc", file.getvalue())


def test_two_drones_of_one_name_and_too_many_files_are_refused() -> None:
    line = {"version": 1, "points": [[0, [0, 0, 0], []], [1, [1, 0, 0], []]]}
    drone = {"settings": {"name": "a", "trajectory": line}}
    for drones, files, words in (([drone, drone], 0, "a is there twice"), ([drone], 5000, "5001 files in the zip")):
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("show.json", json.dumps({"version": 1, "swarm": {"drones": drones}}))
            for i in range(files):
                archive.writestr(f"{i}", b"")
        with pytest.raises(PlanFileError, match=words):
            read_skyc("s.skyc", file.getvalue())


# --- our own ----------------------------------------------------------------------------------------------------------


@settings(max_examples=examples(30))
@given(st.lists(trajectories, min_size=1, max_size=3))
def test_a_timed_plan_is_read_as_it_was_written(fleet: list[Trajectory]) -> None:
    plan = TimedPlan({f"v{i}": trajectory for i, trajectory in enumerate(fleet)})
    assert read_plan_json("p.json", write_plan_json(plan, SPACE, {"certified": True}).encode()) == (plan, SPACE)


def test_a_phased_plan_is_read_as_it_was_written() -> None:
    plan = PhasedPlan(
        {"a": (0.0, 0.0, 1.0), "b": (5.0, 0.0, 1.0)},
        (Phase("climb", {"a": (0.0, 0.0, 9.0)}), Phase("cross", {"a": (5.0, 5.0, 9.0), "b": (0.0, 0.0, 1.0)})),
    )
    assert read_plan_json("p.json", write_plan_json(plan, FlightSpace()).encode()) == (plan, FlightSpace())
    assert plan.legs()[1] == (
        "cross",
        {"a": ((0.0, 0.0, 9.0), (5.0, 5.0, 9.0)), "b": ((5.0, 0.0, 1.0), (0.0, 0.0, 1.0))},
    )
    flown = plan.trajectories(LIMITS)
    assert flown["a"].duration_s == pytest.approx(flown["b"].duration_s)
    assert flown["b"].end_enu_m == pytest.approx((0.0, 0.0, 1.0))


GOOD = {"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": {"a": [[1.0, [0], [0], [5], None]]}}


@each(
    ("change", "words"),
    [
        ({"format": "x"}, "not a plan of skygcs"),
        ({"version": 2}, "version: 2; only 1 is known"),
        ({"kind": "x"}, "kind: has to be timed or phased"),
        ({"vehicles": {}}, "it names no vehicle"),
        ({"vehicles": {"a": [[0.0, [0], [0], [5], None]]}}, "vehicle a: piece 1: a duration of 0 s"),
        ({"vehicles": {"a": [[1.0, [0], [], [5], None]]}}, "vehicle a, piece 1, north: has 1 to 16 coefficients"),
        ({"vehicles": {"a": [[1.0, [0], [True], [5], None]]}}, "coefficient 0 is not a number"),
        ({"space": {"obstacles": []}}, "'obstacles' is unknown"),
        ({"space": {"fence": [[0, 0], [1, 1]]}}, "a fence has three corners at least"),
        ({"space": {"boxes": [[[1, 0, 0], [0, 1, 1]]]}}, "the least corner is above the greatest"),
        ({"space": {"standing": {"p": [0, 0]}}}, "a place is"),
        ({"space": {"standing": {"a": [9, 9, 5]}}}, "space, standing: a takes part in the plan"),
        ({"kind": "phased"}, "starts: has to be an object"),
        ({"kind": "phased", "starts": {"a": [0, 0, 0]}}, "phases: has 1 to 1000 phases"),
        (
            {"kind": "phased", "starts": {"a": [0, 0, 0]}, "phases": [{"name": "x", "goals": {"b": [0, 0, 0]}}]},
            "phase 1: b has no start",
        ),
    ],
)
def test_a_plan_that_is_none_is_refused(change: dict[str, object], words: str) -> None:
    read_plan_json("p.json", json.dumps(GOOD).encode())
    with pytest.raises(PlanFileError) as refused:
        read_plan_json("p.json", json.dumps(GOOD | change).encode())
    assert words in str(refused.value)


def test_a_fleet_has_a_bounded_number_of_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_reading, "MAX_FLEET_PIECES", 5)
    pieces = [[1.0, [0], [0], [5], None]] * 3
    points = [[t, [t, 0, 0], []] for t in range(4)]
    drones = [{"settings": {"name": n, "trajectory": {"version": 1, "points": points}}} for n in "ab"]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("show.json", json.dumps({"version": 1, "swarm": {"drones": drones}}))
    rows = "".join(f"{n},{i},0,5\n" for n in "ab" for i in range(3))
    for name, data in (
        ("p.json", json.dumps(GOOD | {"vehicles": {"a": pieces, "b": pieces}}).encode()),
        ("p.skyc", file.getvalue()),
        ("p.csv", f"vehicle,x,y,z\n{rows}".encode()),
        ("log.csv", log_rows(False).replace("\n", "\n#\n").encode() + b"1e9,G,47.4,8.5,5\n" * 2),
    ):
        with pytest.raises(PlanFileError, match="more than 5 pieces of all vehicles together"):
            read_plan(name, data, LIMITS, ORIGIN)


@each(
    ("text", "words"),
    [
        (b'{"format": "skygcs-plan", "vehicles": {"a": 1, "a": 2}}', "'a' is there twice"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"format": NaN}', "NaN is not a number"),
        (b"\xff\xfe", "not UTF-8"),
        (b"", "not JSON"),
        (b'{"version": ' + b"9" * 5000 + b"}", "not JSON"),
    ],
)
def test_json_that_is_none_is_refused(text: bytes, words: str) -> None:
    with pytest.raises(PlanFileError, match=words):
        read_plan_json("p.json", text)


# --- whatever the bytes -----------------------------------------------------------------------------------------------

READERS: dict[str, Callable[[bytes], object]] = {
    suffix: lambda data, suffix=suffix: read_plan(f"plan.{suffix}", data, LIMITS, ORIGIN)
    for suffix in ("csv", "json", "skyc")
} | {
    "log": lambda data: read_log_csv("log.csv", data, ORIGIN, "a"),
    "crazyswarm": lambda data: read_crazyswarm("c.csv", data),
}

ODD = ["", "0", "1", "-1", "nan", "inf", "1e308", "1e-320", "9" * 400, "a", '"', "#", "12:59:60", "\x00", "٣"]
HEADERS = ["vehicle,t,x,y,z,yaw", "vehicle,x,y,z", "time,lat,lon,alt", "time,vehicle,lat,lon,alt_amsl", HEADER, "", ","]
cells = st.sampled_from(ODD) | st.floats().map(str)
csv_texts = st.builds(
    lambda header, body: (header + "\n" + "\n".join(",".join(row) for row in body)).encode(),
    st.sampled_from(HEADERS),
    st.lists(st.lists(cells, max_size=34), max_size=6),
)
scalars = st.one_of(st.none(), st.booleans(), st.integers(-(10**20), 10**20), st.floats(), st.text(max_size=5))
KEYS = st.sampled_from(["version", "points", "name", "goals", "fence", "standing", "a"])
json_values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=5) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=12
)


@settings(max_examples=examples(150))
@given(st.sampled_from(sorted(READERS)), st.one_of(st.binary(max_size=200), csv_texts))
def test_only_our_error_leaves_a_reader(reader: str, data: bytes) -> None:
    with contextlib.suppress(PlanFileError):
        READERS[reader](data)


@settings(max_examples=examples(150))
@given(st.sampled_from(["version", "kind", "vehicles", "space", "starts", "phases"]), json_values, st.booleans())
def test_only_our_error_leaves_the_reader_of_plans(key: str, value: object, phased: bool) -> None:
    in_phases = {"kind": "phased", "starts": {"a": [0, 0, 0]}, "phases": [{"name": "x", "goals": {}}]}
    content = GOOD | (in_phases if phased else {})
    for change in ({key: value}, {"vehicles": {"a": value}}, {"space": {"fence": value}}):
        with contextlib.suppress(PlanFileError):
            READERS["json"](json.dumps(content | change).encode())


@settings(max_examples=examples(150))
@given(json_values, json_values, st.integers(0, 400), st.binary(min_size=1, max_size=4))
def test_only_our_error_leaves_the_reader_of_shows(trajectory: object, point: object, at: int, noise: bytes) -> None:
    points = {"version": 1, "points": [[0, [0, 0, 0], []], point]}
    for data in (show_of(trajectory), show_of(points), show_of(points, name=trajectory)):
        for damaged in (data, data[:at], data[:at] + noise + data[at + len(noise) :]):
            with contextlib.suppress(PlanFileError):
                READERS["skyc"](damaged)
