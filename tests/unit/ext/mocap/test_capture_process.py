"""Which lines of a capture process are taken when more wait than the loop has time for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.ext.mocap.capture_process import FLOOD_BYTES, LEAST_FRAMES, TAKEN_BYTES, CaptureProcess, newest_frames
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.recording import Body, CaptureFrameData, frame_lines, parse_line, state_line

BODY: Body = ((1.0, 2.0, 0.5), (1.0, 0.0, 0.0, 0.0))


def frames(count: int, bodies: int) -> list[bytes]:
    """Lines of so many frames, 10 ms apart."""
    shown = {f"b{number}": BODY for number in range(bodies)}
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
