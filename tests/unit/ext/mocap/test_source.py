"""The capture process's sources: a package with the API of motioncapture 1.1, and recordings."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.ext.mocap import source as sources
from skygcs.ext.mocap.recording import frame_lines
from skygcs.ext.mocap.source import CaptureError, RecordedSource, SystemSource, bodies_of, only
from support.table import each


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
