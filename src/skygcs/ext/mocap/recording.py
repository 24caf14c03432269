"""Poses as lines of JSON, one frame of the capture system a line: what the capture process writes, and a recording.

    {"t": 12.345, "bodies": {"quad1": [x, y, z, qw, qx, qy, qz], "quad2": null}}
    {"state": "connected", "text": "vicon at 10.0.0.5"}

``t`` is seconds of a monotonic clock at which the frame arrived from the system; positions are metres and quaternions
Hamilton, in the capture frame. A body that the system reports as not seen is null; one that it does not report is not
there. Numbers that JSON does not have (NaN) make the body null. A recording has frames only.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.ext.mocap.pose import Pose, Quaternion, Vector
from skygcs.spelling import is_number

MAX_LINE_BYTES = 4096
"""PIPE_BUF of Linux: a write of so much into a pipe is whole or not at all, so a line is never torn. Some 35 bodies."""

MAX_BODIES = 255
"""System ids there are."""

MAX_NAME = 128
"""Characters of a rigid body's name; longer ones are not taken."""

BODIES = b', "bodies": {'
"""Between the time of a frame and its bodies, in each line of it."""

STATES = ("connecting", "connected", "failed", "ended")

Body = tuple[Vector, Quaternion]


@dataclass(frozen=True, slots=True)
class CaptureFrameData:
    """One frame: bodies by name; None: reported as not seen."""

    at: float
    bodies: Mapping[str, Pose | None]


@dataclass(frozen=True, slots=True)
class CaptureState:
    """State of the capture process: one of `STATES`, and why."""

    state: str
    text: str


def frame_lines(at: float, bodies: Mapping[str, Body | None]) -> list[bytes]:
    """A frame as lines of at most MAX_LINE_BYTES each, with their line ends; several for many bodies."""
    lines: list[bytes] = []
    head = f'{{"t": {at:.6f}'.encode() + BODIES
    parts: list[bytes] = []
    size = 0
    for name, body in bodies.items():
        part = f"{json.dumps(name)}: {_numbers(body)}".encode()
        if parts and len(head) + size + len(part) + 2 * len(parts) + 3 > MAX_LINE_BYTES:
            lines.append(head + b", ".join(parts) + b"}}\n")
            parts, size = [], 0
        parts.append(part)
        size += len(part)
    lines.append(head + b", ".join(parts) + b"}}\n")
    return lines


def state_line(state: str, text: str) -> bytes:
    """Return what the capture process does, as a line."""
    return json.dumps({"state": state, "text": text[:500]}).encode() + b"\n"


def parse_line(line: bytes) -> CaptureFrameData | CaptureState | None:
    """Return what a line says; None for anything else. Never raises."""
    if len(line) > MAX_LINE_BYTES:
        return None
    try:
        value = json.loads(line, parse_constant=lambda name: None)
    except (ValueError, RecursionError):
        return None
    if not isinstance(value, dict):
        return None
    if "state" in value:
        state, text = value["state"], value.get("text", "")
        return CaptureState(state, text) if state in STATES and isinstance(text, str) else None
    at, bodies = _number(value.get("t")), value.get("bodies")
    if at is None or not isinstance(bodies, dict) or len(bodies) > MAX_BODIES:
        return None
    return CaptureFrameData(at, {name: _pose(at, body) for name, body in bodies.items() if len(name) <= MAX_NAME})


def frames_of(lines: Iterable[bytes]) -> Iterable[CaptureFrameData]:
    """The frames of a recording, in order. Raises ValueError with the number of the first invalid line."""
    before = -math.inf
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        frame = parse_line(line)
        if isinstance(frame, CaptureState):
            continue
        if frame is None:
            raise ValueError(
                f'line {number} is not a frame of poses: {{"t": seconds, "bodies": {{"name": [7 numbers]}}}}'
            )
        if frame.at < before:
            raise ValueError(f"line {number}: its time {frame.at:g} is before that of the frame above")
        before = frame.at
        yield frame


def _numbers(body: Body | None) -> str:
    if body is None:
        return "null"
    (x, y, z), (qw, qx, qy, qz) = body
    values = (x, y, z, qw, qx, qy, qz)
    return json.dumps([round(value, 9) for value in values]) if all(map(math.isfinite, values)) else "null"


def _pose(at: float, body: Any) -> Pose | None:
    if not isinstance(body, list) or len(body) != 7:
        return None
    numbers = [_number(value) for value in body]
    if any(number is None for number in numbers):
        return None
    x, y, z, qw, qx, qy, qz = (float(number or 0.0) for number in numbers)
    return Pose(at, (x, y, z), (qw, qx, qy, qz))


def _number(value: Any) -> float | None:
    return float(value) if is_number(value) else None
