"""Which lines of a capture process are taken when more wait than the loop has time for."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from skygcs.ext.mocap.capture_process import LEAST_FRAMES, TAKEN_BYTES, newest_frames
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
