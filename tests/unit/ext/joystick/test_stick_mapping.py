"""The device's events, and what the sticks ask for."""

from __future__ import annotations

import math
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.joystick.commands import JSIOCGNAME_128
from skygcs.ext.joystick.device_events import AXIS, BUTTON, EventReader, JoystickEvent
from skygcs.ext.joystick.stick_mapping import (
    AxisChoice,
    StickAxes,
    StickDemand,
    StickLimits,
    approach,
    demand,
    off_centre,
    shaped,
    turned,
)

AXES = StickAxes()
LIMITS = StickLimits()


def raw(value: int, kind: int, number: int) -> bytes:
    return struct.pack("<IhBB", 12345, value, kind, number)


def test_events_are_read_however_the_bytes_come() -> None:
    data = raw(-32768, 0x82, 4) + raw(1, 0x81, 5) + raw(16384, 2, 0) + raw(0, 1, 5) + raw(1, 7, 0)
    wanted = [(AXIS, 4, -1.0), (BUTTON, 5, 1.0), (AXIS, 0, 16384 / 32767), (BUTTON, 5, 0.0)]
    for size in (1, 3, 8, len(data)):
        reader = EventReader()
        parts = [data[i : i + size] for i in range(0, len(data), size)]
        events = [event for part in parts for event in reader.feed(part)]
        assert events == [JoystickEvent(*w) for w in wanted]
        assert reader.unknown == 1


@given(st.lists(st.binary(max_size=100), max_size=20))
def test_no_bytes_break_the_reader(parts: list[bytes]) -> None:
    reader = EventReader()
    events = [event for part in parts for event in reader.feed(part)]
    assert len(events) + reader.unknown == sum(map(len, parts)) // 8
    assert all(-1.0 <= event.value <= 1.0 for event in events)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler called cc")
def test_the_request_for_the_name_is_the_kernels(tmp_path: Path) -> None:
    source = tmp_path / "name.c"
    source.write_text(
        "#include <linux/joystick.h>\n#include <stdio.h>\n"
        'int main(void) { printf("%lu %zu", (unsigned long)JSIOCGNAME(128), sizeof(struct js_event)); }\n'
    )
    subprocess.run(["cc", str(source), "-o", str(tmp_path / "name")], check=True)
    printed = subprocess.run([str(tmp_path / "name")], capture_output=True, text=True, check=True).stdout
    assert printed.split() == [str(JSIOCGNAME_128), "8"]


def test_each_stick_goes_where_it_is_pushed() -> None:
    assert demand(AXES, LIMITS, {4: -1.0}).vel_mps == pytest.approx((2.0, 0.0, 0.0))
    assert demand(AXES, LIMITS, {3: 1.0}).vel_mps == pytest.approx((0.0, -2.0, 0.0)), "right is not left"
    assert demand(AXES, LIMITS, {1: -1.0}).vel_mps == pytest.approx((0.0, 0.0, 1.0))
    assert demand(AXES, LIMITS, {0: 1.0}).yaw_rate_dps == pytest.approx(-45.0), "to the right is clockwise"
    assert demand(StickAxes(forward=AxisChoice(7)), LIMITS, {7: 1.0}).vel_mps[0] == pytest.approx(2.0)


@given(st.dictionaries(st.integers(0, 8), st.floats(-1, 1)))
def test_nothing_exceeds_the_limits(values: dict[int, float]) -> None:
    asked = demand(AXES, LIMITS, values)
    assert math.hypot(*asked.vel_mps[:2]) <= LIMITS.speed_mps + 1e-9, "a corner is no faster than an edge"
    assert abs(asked.vel_mps[2]) <= LIMITS.climb_mps + 1e-9
    assert abs(asked.yaw_rate_dps) <= LIMITS.yaw_rate_dps + 1e-9


@given(st.floats(-1, 1), st.floats(0, 0.5), st.floats(0, 1))
def test_the_curve_is_odd_and_begins_at_the_dead_zone(x: float, dead_zone: float, expo: float) -> None:
    limits = StickLimits(dead_zone=dead_zone, expo=expo)
    assert shaped(x, limits) == -shaped(-x, limits)
    assert (shaped(x, limits) == 0.0) or abs(x) > dead_zone
    assert shaped(1.0, limits) == pytest.approx(1.0)


def test_a_bent_curve_is_finer_in_the_middle() -> None:
    assert shaped(0.5, StickLimits(expo=0.8)) < shaped(0.5, StickLimits(expo=0.0))


def test_a_deflection_takes_effect_at_the_acceleration() -> None:
    full = StickDemand((2.0, 0.0, 0.0), 10.0)
    assert approach((0.0, 0.0, 0.0), full, LIMITS, 0.05) == StickDemand((0.1, 0.0, 0.0), 10.0)
    assert approach((1.95, 0.0, 0.0), full, LIMITS, 0.05) == full


def test_forward_is_where_the_nose_is() -> None:
    assert turned((1.0, 0.0, 0.5), math.pi / 2) == pytest.approx((0.0, 1.0, 0.5))
    assert turned((0.0, 1.0, 0.0), math.pi / 2) == pytest.approx((-1.0, 0.0, 0.0))


def test_sticks_off_their_centre_are_named() -> None:
    assert off_centre(AXES, {0: 0.1, 1: -1.0, 3: 0.0, 4: 0.2, 9: 1.0}) == [
        "axis 1 (up) at -100%",
        "axis 4 (forward) at 20%",
    ]
