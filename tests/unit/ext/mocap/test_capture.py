"""Motion capture: its table, its process, its sources and recordings."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.loader import load_fleet
from skygcs.config.models import FleetConfig, OriginConfig
from skygcs.errors import ConfigError
from skygcs.ext.mocap import source as sources
from skygcs.ext.mocap.capture_process import (
    FLOOD_BYTES,
    LEAST_FRAMES,
    TAKEN_BYTES,
    CaptureProcess,
    arguments,
    newest_frames,
)
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.feed import MAX_SEEN, MocapFeed
from skygcs.ext.mocap.lost_body import MOST_M, LostBody
from skygcs.ext.mocap.pose import Pose, Vector, about_up
from skygcs.ext.mocap.recording import (
    MAX_LINE_BYTES,
    Body,
    CaptureFrameData,
    CaptureState,
    frame_lines,
    frames_of,
    parse_line,
    state_line,
)
from skygcs.ext.mocap.source import CaptureError, RecordedSource, SystemSource, bodies_of, only
from support.table import each

# -- The capture process's sources: a package with the API of motioncapture 1.1, and recordings.


class FakeSystem:
    """What `motioncapture.connect` of 1.1 returns: each frame has the bodies of the next entry."""

    def __init__(self, frames: list[dict[str, Any]]) -> None:
        self._frames = iter(frames)
        self.rigidBodies: dict[str, Any] = {}

    def waitForNextFrame(self) -> None:
        try:
            self.rigidBodies = next(self._frames)
        except StopIteration:
            raise RuntimeError("connection closed") from None


class FakePackage:
    def __init__(self, frames: list[dict[str, Any]] | None = None) -> None:
        self.connected: list[tuple[str, dict[str, str]]] = []
        self._frames = frames

    def connect(self, kind: str, config: dict[str, str], /) -> FakeSystem:
        self.connected.append((kind, config))
        if self._frames is None:
            raise RuntimeError("Error connecting QTM on address: 10.0.0.5:22222")
        return FakeSystem(self._frames)


def body(x: float, y: float, z: float) -> SimpleNamespace:
    return SimpleNamespace(name="a", position=[x, y, z], rotation=SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0))


def ticking() -> Iterator[float]:
    return iter(itertools.count(10.0, 0.5))


def test_frames_of_a_system_have_the_time_of_their_arrival() -> None:
    package = FakePackage([{"a": body(1, 2, 3)}, {}])
    clock = ticking()
    source = SystemSource("vicon", "10.0.0.5", clock=lambda: next(clock), package=package)
    frames = source.frames()
    assert next(frames) == (10.0, {"a": ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))})
    assert next(frames) == (10.5, {})
    with pytest.raises(CaptureError, match=r"vicon at 10\.0\.0\.5: connection closed"):
        next(frames)
    assert package.connected == [("vicon", {"hostname": "10.0.0.5"})]


@each(("kind", "key"), [("qualisys", "port"), ("optitrack", "port_command")])
def test_a_port_has_the_key_of_its_system(kind: str, key: str) -> None:
    package = FakePackage([])
    with pytest.raises(CaptureError):
        next(SystemSource(kind, "h", 1234, package=package).frames())
    assert package.connected == [(kind, {"hostname": "h", key: "1234"})]


def test_a_system_that_does_not_answer_is_named() -> None:
    with pytest.raises(CaptureError, match=r"qualisys at 10\.0\.0\.5: Error connecting QTM"):
        next(SystemSource("qualisys", "10.0.0.5", package=FakePackage()).frames())


def test_a_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "motioncapture", None)
    with pytest.raises(CaptureError, match=r"pip install 'skygcs\[mocap\]'"):
        next(SystemSource("vicon", "h").frames())


def test_bodies_that_cannot_be_read_are_not_seen() -> None:
    odd = {"short": SimpleNamespace(position=[1], rotation=None), "x" * 200: body(1, 2, 3), "good": body(1, 2, 3)}
    assert bodies_of(odd) == {"short": None, "good": ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))}
    assert only(bodies_of(odd), {"good"}).keys() == {"good"}
    assert only(bodies_of(odd), ()).keys() == {"short", "good"}


class Time:
    def __init__(self) -> None:
        self.now = 100.0

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def play(file: Path, *, loop: bool = False, most: int = 100) -> list[float]:
    time = Time()
    source = RecordedSource(file, loop, clock=lambda: time.now, sleep=time.sleep)
    return [at for at, _ in itertools.islice(source.frames(), most)]


def test_a_recording_is_played_at_its_own_pace(tmp_path: Path) -> None:
    file = tmp_path / "r.jsonl"
    file.write_bytes(b"".join(frame_lines(7.0 + 0.25 * n, {})[0] for n in range(3)))
    assert play(file) == [100.0, 100.25, 100.5]
    assert play(file, loop=True, most=6) == [100.0, 100.25, 100.5, 100.5, 100.75, 101.0]


@each(
    ("content", "words"),
    [
        (b"", "has no frames"),
        (b"nonsense\n", "line 1 is not a frame"),
        (b"x" * 100_000, "line 1"),
        (None, "No such file"),
    ],
)
def test_a_recording_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None, words: str) -> None:
    file = tmp_path / "r.jsonl"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(CaptureError, match=words):
        play(file)


def test_the_types_of_the_fleet_file_are_those_of_the_source() -> None:
    from skygcs.ext.mocap import config as mocap

    assert sources.SYSTEMS == mocap.SYSTEMS
    assert set(sources.PORT_KEYS) == set(mocap.WITH_PORT)


# -- Frames of more bodies than are listed.


LEVEL = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.looptime
async def test_the_bodies_of_all_vehicles_count_as_others_and_the_rest_is_bounded() -> None:
    """The 65th vehicle's body was no other body: one that had taken its markers was believed."""
    names = [f"v{n}" for n in range(1, MAX_SEEN + 7)]
    vehicles = {name: SimpleNamespace(sysid=number) for number, name in enumerate(names, start=1)}
    core = cast(
        Any,
        SimpleNamespace(
            hub=SimpleNamespace(dialect=SimpleNamespace(by_name={})),
            fleet=None,
            event_log=SimpleNamespace(publish=None),
            config=SimpleNamespace(vehicles=vehicles),
        ),
    )
    config = MocapConfig.model_validate({"type": "vicon", "host": "h", "bodies": {name: name for name in names}})
    feed = MocapFeed(core, config, OriginConfig(lat_deg=43.0, lon_deg=-79.0, alt_amsl_m=100.0))
    now = asyncio.get_running_loop().time()
    for n, name in enumerate([*(f"stranger{n}" for n in range(10 * MAX_SEEN)), *names]):
        feed.on_frame(CaptureFrameData(now, {name: Pose(now, (1.0 + n, 0.0, 1.0), LEVEL)}), now)
    assert len(feed._others("v1", now)) == len(feed._last_seen) - 1 == MAX_SEEN + len(names) - 1


# -- Where a body may be that the cameras have lost: the rows of the table.


DT = 0.01
MARGIN_M = 0.3


def pose(at: float, *pos_m: float) -> Pose:
    x, y, z = pos_m
    return Pose(at, (x, y, z), about_up(0.0))


def flown(velocity: Vector = (0.0, 0.0, 0.0), own: bool = False) -> LostBody:
    """Seen for a second until t = 1, when it was at the origin. ``own``: its vehicle's estimate is 7 m beside."""
    body = LostBody()
    for n in range(101):
        t = n * DT
        here = (velocity[0] * (t - 1), velocity[1] * (t - 1), velocity[2] * (t - 1))
        body.seen(pose(t, *here), ((here[0] + 7.0, here[1], here[2]), t) if own else None)
    return body


@each(
    ("velocity", "after_s", "at_m", "is_it"),
    [
        # at rest: what it can have reached by a manoeuvre
        ((0.0, 0.0, 0.0), 0.3, (0.2, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), 0.3, (2.4, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), 3.0, (3.2, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), 3.0, (6.2, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), 60.0, (MOST_M + 0.4, 0.0, 0.0), False),
        # on its way: as far as it would have come, or less if it was stopped; not as far the other way
        ((2.0, 0.0, 0.0), 0.5, (1.0, 0.0, 0.0), True),
        ((2.0, 0.0, 0.0), 0.5, (0.1, 0.0, 0.0), True),
        ((2.0, 0.0, 0.0), 0.5, (-1.0, 0.0, 0.0), False),
        ((2.0, 0.0, 0.0), 0.5, (0.5, 1.0, 0.0), False),
    ],
)
def test_it_is_expected_on_its_way(velocity: Vector, after_s: float, at_m: Vector, is_it: bool) -> None:
    assert flown(velocity).may_be(pose(1.0 + after_s, *at_m), None, (), MARGIN_M) is is_it


@each(("at_m", "is_it"), [((5.0, 0.5, 0.0), True), ((0.0, 0.0, 0.0), False)])
def test_the_estimate_of_its_vehicle_counts_more(at_m: Vector, is_it: bool) -> None:
    """In 3 s without poses it flew on by 5 m, and says so in a frame that lies beside."""
    body, now = flown(own=True), ((12.0, 0.0, 0.0), 3.9)
    assert body.may_be(pose(4.0, *at_m), now, (), MARGIN_M) is is_it
    stale = ((12.0, 0.0, 0.0), 1.5)
    assert not body.may_be(pose(4.0, 5.0, 0.0, 0.0), stale, (), MARGIN_M), "old: its own velocity counts"


def test_a_place_nearer_to_another_body_is_that_one() -> None:
    body = flown()
    found = pose(1.5, 0.5, 0.0, 0.0)
    assert body.may_be(found, None, [(1.6, 0.0, 0.0)], MARGIN_M)
    assert not body.may_be(found, None, [(0.6, 0.0, 0.0)], MARGIN_M)


def test_a_body_that_was_never_seen_may_be_anywhere() -> None:
    assert LostBody().may_be(pose(1.0, 50.0, 0.0, 0.0), None, [(50.0, 0.0, 0.0)], MARGIN_M)


# -- [mocap] of the fleet file: what it takes, and what is wrong with it, with its key.


REST = """
[origin]
lat_deg = 43.78
lon_deg = -79.46
alt_amsl_m = 180
[vehicles.alpha]
sysid = 1
[vehicles.bravo]
sysid = 2
"""

VICON = 'type = "vicon"\nhost = "10.0.0.5"\nbodies = { alpha = "quad1" }\n'


def load(tmp_path: Path, mocap: str, rest: str = REST) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    path.write_text(f"[mocap]\n{mocap}{rest}")
    return load_fleet(path)


def test_a_system_and_its_bodies(tmp_path: Path) -> None:
    config = load(tmp_path, VICON)
    mocap = config.extensions["mocap"]
    assert isinstance(mocap, MocapConfig) and mocap.bodies == {"alpha": "quad1"}
    assert arguments(mocap) == ["--system", "vicon", "--host", "10.0.0.5", "--body=quad1"]


def test_a_recording_is_found_beside_the_fleet_file(tmp_path: Path) -> None:
    config = load(tmp_path, 'type = "recorded"\nfile = "flight.jsonl"\nloop = true\nbodies = { alpha = "-a" }\n')
    mocap = config.extensions["mocap"]
    assert isinstance(mocap, MocapConfig)
    assert arguments(mocap) == ["--file", str(tmp_path / "flight.jsonl"), "--loop", "--body=-a"]


@each(
    ("mocap", "rest", "words"),
    [
        ('type = "vicom"\nbodies = { alpha = "a" }\n', REST, ("mocap.type", "did you mean vicon")),
        ('type = "vicon"\nbodies = { alpha = "a" }\n', REST, ("mocap", "host", "is missing")),
        ('type = "vrpn"\nhost = "h"\nport = 3883\nbodies = { alpha = "a" }\n', REST, ("port", "has no meaning")),
        ('type = "recorded"\nbodies = { alpha = "a" }\n', REST, ("file", "recorded")),
        ('type = "simulated"\nbodies = { alpha = "a" }\n', REST, ("mocap.type", "no link of type")),
        (
            VICON.replace("alpha", "alfa"),
            REST,
            ("mocap.bodies.alfa", "not a vehicle of this file; vehicles: alpha, bravo"),
        ),
        (
            'type = "vicon"\nhost = "h"\nbodies = { alpha = "a", bravo = "a" }\n',
            REST,
            ("mocap.bodies.bravo", "that of alpha already"),
        ),
        (VICON, "[vehicles.alpha]\nsysid = 1\n", ("mocap", "needs a table [origin]")),
        (VICON, REST + "[daemon]\nkeep_vehicles = false\n", ("mocap", "keep_vehicles = true")),
        (VICON + "rate_hz = 5\n", REST, ("mocap.rate_hz", "at least 10")),
        (VICON + "max_jump = 1\n", REST, ("mocap.max_jump", "unknown key; did you mean max_jump_m")),
        ('type = "vicon"\nhost = "h"\nbodies = {}\n', REST, ("mocap.bodies",)),
        (VICON + "[mocap.simulated]\nnoise_m = 0.1\n", REST, ("simulated", 'is for type "simulated"')),
    ],
)
def test_what_is_wrong_is_named_with_its_key(tmp_path: Path, mocap: str, rest: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, mocap, rest)
    text = "\n".join(caught.value.problems)
    assert all(word in text for word in words), text


# -- Lines of poses: written, read, and what is none.


BODY = ((1.0, -2.5, 0.25), (1.0, 0.0, 0.0, 0.0))


def test_a_frame_is_read_as_it_was_written() -> None:
    (line,) = frame_lines(12.5, {'a "quad"': BODY, "gone": None, "nan": ((math.nan, 0, 0), BODY[1])})
    frame = parse_line(line)
    assert isinstance(frame, CaptureFrameData)
    assert frame.at == 12.5
    assert frame.bodies["gone"] is None and frame.bodies["nan"] is None
    seen = frame.bodies['a "quad"']
    assert seen is not None and (seen.at, seen.pos_m, seen.q) == (12.5, *BODY)


def test_many_bodies_are_several_lines_none_too_long() -> None:
    bodies = {f"body number {n}": BODY for n in range(255)}
    lines = frame_lines(1.0, bodies)
    assert max(map(len, lines)) <= MAX_LINE_BYTES
    frames = [parse_line(line) for line in lines]
    assert {name for f in frames if isinstance(f, CaptureFrameData) for name in f.bodies} == set(bodies)


def test_a_frame_without_bodies_is_a_frame() -> None:
    assert parse_line(frame_lines(1.0, {})[0]) == CaptureFrameData(1.0, {})


def test_a_state_is_read_as_it_was_written() -> None:
    assert parse_line(state_line("failed", "no host")) == CaptureState("failed", "no host")


@each(
    "line",
    [
        b"",
        b"\xff\xfe",
        b"[1, 2]",
        b'{"t": 1}',
        b'{"t": "1", "bodies": {}}',
        b'{"t": NaN, "bodies": {}}',
        b'{"t": 1e999, "bodies": {}}',
        b'{"t": 1, "bodies": []}',
        b'{"state": "dancing", "text": ""}',
        b'{"state": ["connected"], "text": ""}',
        b'{"state": "failed", "text": 7}',
        b"[" * 4000,
        b'{"t": 1, "bodies": {"a": "' + b"x" * MAX_LINE_BYTES + b'"}}',
    ],
)
def test_what_is_no_line_of_poses_is_none(line: bytes) -> None:
    assert parse_line(line) is None


@each("body", ["null", "[1, 2, 3]", '[1, 2, 3, 1, 0, 0, "0"]', "[1, 2, 3, true, 0, 0, 0]", "{}"])
def test_a_body_that_is_no_pose_is_not_seen(body: str) -> None:
    assert parse_line(f'{{"t": 1, "bodies": {{"a": {body}}}}}'.encode()) == CaptureFrameData(1.0, {"a": None})


def test_a_number_beyond_floats_is_no_pose() -> None:
    line = b'{"t": 1, "bodies": {"a": [' + b"9" * 400 + b", 0, 0, 1, 0, 0, 0]}}"
    assert parse_line(line) == CaptureFrameData(1.0, {"a": None})


@given(st.binary(max_size=300))
def test_no_bytes_raise(line: bytes) -> None:
    parse_line(line)


def test_a_recording_names_the_line_that_is_wrong() -> None:
    good = frame_lines(1.0, {"a": BODY})[0]
    assert [f.at for f in frames_of([good, b"\n", state_line("connected", ""), frame_lines(2.0, {})[0]])] == [1.0, 2.0]
    with pytest.raises(ValueError, match="line 2 is not a frame"):
        list(frames_of([good, b"x"]))
    with pytest.raises(ValueError, match=r"line 2: its time 0\.5 is before"):
        list(frames_of([good, frame_lines(0.5, {})[0]]))


# -- Which lines of a capture process are taken when more wait than the loop has time for.


CAPTURED: Body = ((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))


def frames(count: int, bodies: int) -> list[bytes]:
    """Lines of so many frames, 10 ms apart."""
    shown = {f"b{number}": CAPTURED for number in range(bodies)}
    return [line.rstrip() for n in range(count) for line in frame_lines(5.0 + n / 100, shown)]


def times(lines: list[bytes]) -> list[float]:
    return [frame.at for frame in map(parse_line, lines) if isinstance(frame, CaptureFrameData)]


@pytest.mark.parametrize(("count", "bodies"), [(100, 2), (10, 30), (1, 250), (2, 250)])
def test_what_takes_little_time_is_taken_whole(count: int, bodies: int) -> None:
    lines = frames(count, bodies)
    assert newest_frames(lines) == lines


@pytest.mark.parametrize("bodies", [1, 2, 35, 120, 250])
def test_of_a_flood_the_newest_frames_are_taken_in_their_order(bodies: int) -> None:
    lines = frames(1000, bodies)
    taken = newest_frames(lines)
    assert taken == lines[-len(taken) :] and len(taken) < len(lines)
    per_frame = len(frames(1, bodies))
    assert len(taken) % per_frame == 0
    assert len(taken) == LEAST_FRAMES * per_frame or sum(map(len, taken)) <= TAKEN_BYTES


@pytest.mark.parametrize("place", [lambda n: 0, lambda n: n // 2, lambda n: n])
def test_what_the_process_says_of_itself_is_never_passed_over(place: Callable[[int], int]) -> None:
    lines = frames(1000, 2)
    said = state_line("failed", "vicon at 10.0.0.5: gone").rstrip()
    lines.insert(place(len(lines)), said)
    assert said in newest_frames(lines)
    assert times(newest_frames(lines))[-1] == times(lines)[-1]


class Capture:
    """A capture process of which only the pipe is there."""

    def __init__(self) -> None:
        config = MocapConfig.model_validate({"bodies": {"alpha": "a"}, "type": "vicon", "host": "h"})
        self.taken: list[float] = []
        self.pipe = asyncio.StreamReader()
        self.made = CaptureProcess(
            config, asyncio.get_running_loop(), lambda frame, now: self.taken.append(frame.at), lambda event: None
        )
        process: Any = SimpleNamespace(stdout=self.pipe)
        self.reading = asyncio.create_task(self.made._read(process))

    async def end(self) -> None:
        self.pipe.feed_eof()
        assert await self.reading


async def test_an_ordinary_system_that_was_late_once_loses_no_more_frames() -> None:
    """With 30 bodies at 240 Hz the pause after a late read was so long that each later read lost frames."""
    rate_hz = 240.0
    body: Body = ((1.23456789, 2.3456789, 0.56789012), (0.98765432, 0.0123456, 0.0345678, 0.1456789))
    bodies = {f"quad{number}": body for number in range(30)}
    lines = [line for n in range(500) for line in frame_lines(5.0 + n / rate_hz, bodies)]
    late = next(n for n in range(500) if sum(map(len, lines[:n])) > TAKEN_BYTES)
    assert sum(map(len, lines[:late])) < FLOOD_BYTES
    capture = Capture()
    capture.pipe.feed_data(b"".join(lines[:late]))
    for line in lines[late:]:
        await asyncio.sleep(1.0 / rate_hz)
        capture.pipe.feed_data(line)
        before = len(capture.taken)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert len(capture.taken) == before + 1
    await capture.end()
    assert capture.made.skipped == 1


async def test_after_a_flood_the_next_read_is_later() -> None:
    capture = Capture()
    flood = [line + b"\n" for line in frames(1000, 2)]
    capture.pipe.feed_data(b"".join(flood[:500]))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert len(capture.taken) <= 2, "the loop has its turn between frames"
    for _ in range(500):
        await asyncio.sleep(0)
    taken, skipped = len(capture.taken), capture.made.skipped
    assert taken + skipped == 500 and skipped
    capture.pipe.feed_data(b"".join(flood[500:]))
    await asyncio.sleep(0.001)
    assert len(capture.taken) == taken
    await asyncio.sleep(0.1)
    assert len(capture.taken) + capture.made.skipped == 1000
    await capture.end()
