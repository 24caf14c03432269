"""A control trace of a flight that never was: the law on a point mass whose thrust follows with a lag.

To look at one: python -m support.flown_trace FILE
"""

from __future__ import annotations

import math
import sys
from collections import deque
from pathlib import Path

from skygcs.core.control import AxisGains, ControlConfig, Estimate, Memory, Reference, step, velocity_step
from skygcs.core.control.gains import GRAVITY_MPS2
from skygcs.core.control.trace import TraceHead, TraceRow, TraceWriter

PERIOD_S = 0.02
LAG_S = 0.15
"""Of the thrust vector: about what an attitude loop takes."""

WIND_MPS2 = (0.4, -0.2, 0.0)
HEAD = TraceHead("alpha", 43.7806, -79.4653, 180.0)


def flown_trace(duration_s: float = 40.0) -> str:
    """Steps of 3 m and 8 m, a circle, gains changed at half time, four seconds of `velocity`, two of nothing."""
    config, memory = ControlConfig(), Memory()
    writer = TraceWriter(HEAD)
    position, velocity, thrust = [0.0, 0.0, 5.0], [0.0, 0.0, 0.0], [0.0, 0.0, config.hover_thrust]
    seen = deque([(0.0, Estimate((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)))] * 3, maxlen=3)
    text = ""
    for n in range(round(duration_s / PERIOD_S)):
        t = n * PERIOD_S
        if n == round(duration_s / 2 / PERIOD_S):
            config = ControlConfig(xy=AxisGains(0.95, 0.1, 0.03), hover_thrust=0.45)
        if n % 5 == 0:  # telemetry at 10 Hz, and 40 ms old
            noise = 0.02 * math.sin(7.3 * t)
            x, y, z = position
            vx, vy, vz = velocity
            seen.append((t, Estimate((x + noise, y - noise, z), (vx, vy, vz))))
        at, estimate = seen[1]
        reference = _reference(t, duration_s)
        way = _way(t, duration_s)
        row = TraceRow(t, PERIOD_S + 0.002 * math.sin(n), way, way is not None, reference, estimate, t - at)
        after = memory
        if way == "attitude":
            output, after = step(config, memory, estimate, reference, row.dt_s, following=True)
            assert output is not None
            row = row.with_output(output, after)
            wanted = output.thrust_enu
        elif way == "velocity":
            wanted_velocity, after = velocity_step(config, memory, estimate, reference, row.dt_s)
            assert wanted_velocity is not None
            row = row.with_velocity(wanted_velocity)
            asked = [0.1 * (w - v) for w, v in zip(wanted_velocity, velocity, strict=True)]
            wanted = (asked[0], asked[1], asked[2] + config.hover_thrust)
        else:
            wanted = (-0.05 * velocity[0], -0.05 * velocity[1], config.hover_thrust)
        text += writer.lines(row, config, memory, after)
        memory = after
        for axis in range(3):
            thrust[axis] += (wanted[axis] - thrust[axis]) * PERIOD_S / LAG_S
            push = thrust[axis] * GRAVITY_MPS2 / config.hover_thrust - (GRAVITY_MPS2 if axis == 2 else 0.0)
            velocity[axis] += (push + WIND_MPS2[axis] - 0.1 * velocity[axis]) * PERIOD_S
            position[axis] += velocity[axis] * PERIOD_S
    return text


def _way(t: float, duration_s: float) -> str | None:
    if 0.4 * duration_s <= t < 0.5 * duration_s:
        return "velocity"
    return None if 0.7 * duration_s <= t < 0.75 * duration_s else "attitude"


def _reference(t: float, duration_s: float) -> Reference:
    if t < 1.0:
        return Reference((0.0, 0.0, 5.0))
    if t < 0.25 * duration_s:
        return Reference((3.0, 0.0, 5.0))
    if t < 0.5 * duration_s:
        return Reference((3.0, -8.0, 9.0), yaw_rad=1.0)
    turn = 0.6 * (t - 0.5 * duration_s)
    circle = (3.0 + 3.0 * math.sin(turn), -8.0 + 3.0 - 3.0 * math.cos(turn), 9.0)
    return Reference(circle, vel_enu_mps=(1.8 * math.cos(turn), 1.8 * math.sin(turn), 0.0))


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(flown_trace(), encoding="utf-8")
