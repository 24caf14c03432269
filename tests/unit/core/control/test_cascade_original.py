"""The law before its repairs, written down a second time, as the reference that `step` agrees with where they are idle.

Transcribed from the published description, with the single-precision limits of the original where they decide a case.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import AxisGains, ControlConfig, Estimate, Memory, Reference, step
from support.table import each

DT_S = 0.02


@dataclass
class OriginalLaw:
    """The px4_command cascade of branch multi-f450, faults included. Everything ENU, thrust normalised."""

    kp: tuple[float, float, float] = (0.95, 0.95, 1.0)
    kv: tuple[float, float, float] = (0.08, 0.08, 0.3)
    ki: tuple[float, float, float] = (0.02, 0.02, 0.02)
    kd: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hover: float = 0.45
    integral: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    error_before: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    slope: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def thrust(self, position_error, velocity, acc_ref=(0.0, 0.0, 0.0), dt_s=DT_S, mode="OFFBOARD", sub_mode=0):
        error = []
        for i in range(3):
            position_loop = not (sub_mode & (0b01 if i == 2 else 0b10))
            wanted = self.kp[i] * position_error[i] if position_loop else 0.0
            error.append(min(max(wanted, -10.0), 10.0) - velocity[i])
        b = 2 * math.pi * 5.0 * dt_s
        for i in range(3):
            change = (error[i] - self.error_before[i]) / dt_s
            self.slope[i] = b / (1 + b) * change + 1 / (1 + b) * self.slope[i]
        self.error_before = error
        pid = [acc_ref[i] + self.kv[i] * error[i] + self.integral[i] + self.kd[i] * self.slope[i] for i in range(3)]

        asked_z = pid[2] + self.hover
        if not ((asked_z >= 0.9 and error[2] >= 0) or (asked_z <= 0.1 and error[2] <= 0)):
            self.integral[2] = min(max(self.integral[2] + self.ki[2] * error[2] * dt_s, -0.9), 0.9)
        z = min(max(asked_z, 0.1), 0.9)

        # float * float rounds to below the exact square of the same float: at the upper limit the radicand is negative
        top = np.float32(0.9)
        radicand = float(top * top) - float(np.float32(z)) ** 2 if z == 0.9 else 0.81 - z * z
        by_tilt = abs(z) * math.tan(math.radians(35))
        root = math.sqrt(radicand) if radicand >= 0 else math.nan
        limit = root if root < by_tilt else by_tilt  # NaN is not less
        norm = math.hypot(pid[0], pid[1])
        scale = limit / norm if norm > limit else 1.0
        x, y = pid[0] * scale, pid[1] * scale
        for i, given_thrust in enumerate((x, y)):
            self.integral[i] += self.ki[i] * (error[i] - (pid[i] - given_thrust) * 2 / self.kv[i]) * dt_s
        if mode != "OFFBOARD":
            self.integral = [0.0, 0.0, 0.0]
        return x, y, z


def tilt_deg(thrust) -> float:
    return math.degrees(math.atan2(math.hypot(thrust[0], thrust[1]), thrust[2]))


ORIGINAL_VECTORS = [
    ((0, 0, 0), (0, 0, 0), (0, 0, 0.45), 0.45, 0.0, (0, 0, 0)),
    ((1, 0, 0), (0, 0, 0), (0.076, 0, 0.45), 0.456373, 9.586, (3.8e-4, 0, 0)),
    ((0, 0, 1), (0, 0, 0), (0, 0, 0.75), 0.75, 0.0, (0, 0, 4e-4)),
    ((0, 0, -1), (0, 0, 0), (0, 0, 0.15), 0.15, 0.0, (0, 0, -4e-4)),
    ((0, 5, 0), (0, 0, 0), (0, 0.315093, 0.45), 0.549349, 35.0, (0, 1.251e-3, 0)),
    ((1, 0, -3), (0, 0, 0), (0.070021, 0, 0.1), 0.122077, 35.0, (3.202e-4, 0, 0)),
    ((0, 0, 0), (1, 0, 0), (-0.08, 0, 0.45), 0.457056, 10.081, (-4e-4, 0, 0)),
    ((20, 0, 10), (0, 0, 0), (0.630187, 0, 0.9), 1.098697, 35.0, (2.302e-3, 0, 0)),
]


@each(("position_error", "velocity", "thrust", "norm", "tilt", "integral"), ORIGINAL_VECTORS)
def test_the_original_gives_its_golden_vectors(position_error, velocity, thrust, norm, tilt, integral):
    law = OriginalLaw()
    given_thrust = law.thrust(position_error, velocity)
    assert given_thrust == pytest.approx(thrust, abs=6e-7)
    assert math.hypot(*given_thrust) == pytest.approx(norm, abs=6e-7)
    assert tilt_deg(given_thrust) == pytest.approx(tilt, abs=6e-4)
    assert law.integral == pytest.approx(integral, abs=6e-7)


NEAR = st.floats(-3.0, 3.0)
VECTORS = st.tuples(NEAR, NEAR, st.floats(-0.7, 0.7))  # up: mostly short of full thrust, where the two part


@given(
    flight=st.lists(st.tuples(VECTORS, VECTORS, st.sampled_from([0.01, 0.015, 0.02, 0.03])), min_size=1, max_size=25),
    kd=st.sampled_from([0.0, 0.01]),
    sub_mode=st.integers(0, 3),
)
def test_where_no_repair_has_anything_to_do_the_law_is_the_original(flight, kd, sub_mode):
    config = ControlConfig(xy=AxisGains(0.95, 0.08, 0.02, kd), z=AxisGains(1.0, 0.3, 0.02, kd))
    original, memory = OriginalLaw(kd=(kd, kd, kd)), Memory()
    for number, (position_error, velocity, dt_s) in enumerate(flight):
        reference = Reference(
            position_error, velocity_only_xy=bool(sub_mode & 0b10), velocity_only_z=bool(sub_mode & 0b01)
        )
        if number == 0:  # the original's first slope is its kick: give it the error it compares with
            first, _ = step(config, memory, Estimate((0, 0, 0), velocity), reference, dt_s, following=True)
            assert first is not None
            original.error_before = [w - v for w, v in zip(first.vel_setpoint_enu_mps, velocity, strict=True)]
        expected = original.thrust(position_error, velocity, dt_s=dt_s, sub_mode=sub_mode)
        output, memory = step(config, memory, Estimate((0, 0, 0), velocity), reference, dt_s, following=True)
        assert output is not None
        if expected[2] == 0.9:  # where the original's root is NaN
            return
        assert output.thrust_enu == pytest.approx(expected, abs=1e-12)
        assert memory.integral_enu == pytest.approx(original.integral, abs=1e-12)
