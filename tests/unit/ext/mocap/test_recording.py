"""Lines of poses: written, read, and what is none."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.mocap.recording import (
    MAX_LINE_BYTES,
    CaptureFrameData,
    CaptureState,
    frame_lines,
    frames_of,
    parse_line,
    state_line,
)
from support.table import each

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
