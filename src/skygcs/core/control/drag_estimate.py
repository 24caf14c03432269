"""Drag of a vehicle on a moving reference, learned from how far it stays behind. Pure.

PX4 in OFFBOARD (mc_pos_control, PositionControl.cpp, 1.16) makes of a position, a velocity and an acceleration

    v_sp = v_ff + MPC_XY_P · (p_sp − p)
    a_sp = a_ff + MPC_XY_VEL_P · (v_sp − v) + ∫ MPC_XY_VEL_I · (v_sp − v) dt − MPC_XY_VEL_D · dv/dt

and nothing for drag. Drag of k·v turns with the velocity; an integral in the frame of the earth cannot follow it, and
on a circle of angular rate ω the vehicle stays k·v / (|P + I/jω| · MPC_XY_P) away: 1.0 m for the circle of 5 m at 2 m/s
with PX4's gains (1.8, 0.4, 0.95) and the k of its SIH simulator (SIH_KDV / SIH_MASS = 1 /s), of 1.09 m measured there.

So the part of the acceleration that goes with the velocity is learned: per second, along the velocity and across it (to
the left). A coefficient holds at any speed, and needs no change when the way turns.

On a straight way at a constant speed that integral takes all of the drag within seconds, whatever is added to it; the
distance that is left is one of timing, and says nothing of the drag. So an error teaches by the part of the velocity
that the integral has not followed yet, its high-pass with the time constant of the integral (`BALANCED_S`). Learned
from the whole velocity, the coefficient would fall to its bound on each long way, and vehicles would pass its end by
0.28 s of their speed. Timing that is known is taken off: setpoints are sent ahead by the autopilot's response, which is
right where the way turns, and on a straight way the vehicle is ahead by it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

Vector = tuple[float, float, float]

GAIN = 0.12
"""Change of a coefficient in 1/s, per metre of error and second. With the drag of SIH the error is 0.13 m in the second
lap of that circle, with delays of 0.1 to 0.6 s alike; with four times the gain it begins to swing (model of the loop
above, 2 positions a second)."""

LEAST, MOST, ACROSS = -0.3, 1.5, 0.75
"""Bounds of the coefficients in 1/s. SIH has 1; less than no drag is an error of the model."""

MOST_MPS2 = 3.0
"""Largest acceleration that is added: MPC_ACC_HOR."""

BALANCED_S = 5.0
"""Time constant with which PX4's integral takes over a lasting acceleration: the slowest root of its loop,
s³ + 1.8 s² + (0.4 + 1.8 · 0.95) s + 0.4 · 0.95, is -0.21 /s. With 3 to 8 s the errors are the same within a tenth."""

TURNS_S = 8.0
"""Inverse of the turn rate at which half of the response counts: 0.02 of it on that circle, all of it on a straight."""

LEARNS_MPS = 0.5
"""Slower references teach nothing: the error there is wind and noise."""

MOST_ERROR_M = 1.0
"""More is a gust, or a vehicle on its way to its reference."""

LONGEST_S = 1.0
"""A position teaches for the time since the last one, at most so much."""

NOTE_S, NOTES = 0.04, 64
"""References that are kept, 2.5 s of them, to compare a position with that of the time at which it was measured."""


@dataclass(frozen=True, slots=True)
class DragEstimate:
    """Acceleration per velocity, in 1/s."""

    along_per_s: float = 0.0
    across_per_s: float = 0.0

    def learned(
        self, error_m: Sequence[float], unbalanced_mps: Sequence[float], speed_mps: float, for_s: float
    ) -> DragEstimate:
        """After an error (reference − position, east and north) in a flight with this speed, of whose velocity the
        autopilot's integral has left so much unbalanced."""
        if speed_mps < LEARNS_MPS:
            return self
        (x, y), (u, v) = error_m[:2], unbalanced_mps
        scale = min(1.0, MOST_ERROR_M / max(1e-9, math.hypot(x, y))) * GAIN * min(for_s, LONGEST_S) / speed_mps
        along = self.along_per_s + scale * (x * u + y * v)
        across = self.across_per_s + scale * (y * u - x * v)
        return DragEstimate(min(MOST, max(LEAST, along)), min(ACROSS, max(-ACROSS, across)))

    def acceleration_mps2(self, velocity_mps: Sequence[float]) -> Vector:
        """The acceleration that keeps this velocity against the drag; level."""
        u, v = velocity_mps[0], velocity_mps[1]
        east = self.along_per_s * u - self.across_per_s * v
        north = self.along_per_s * v + self.across_per_s * u
        share = min(1.0, MOST_MPS2 / max(1e-9, math.hypot(east, north)))
        return east * share, north * share, 0.0


class _Note(NamedTuple):
    at: float
    place_m: Vector
    """Place at which the vehicle is expected."""
    velocity_mps: Vector
    balanced_mps: tuple[float, float]
    """The part of the velocity, east and north, whose drag the autopilot's integral has taken over."""


class DragObserver:
    """Compares positions with the reference of their time; ``estimate`` is what was learned.

    ``response_s``: the part of the lead of setpoints that makes up for the autopilot's response."""

    def __init__(self, response_s: float = 0.0) -> None:
        self.estimate = DragEstimate()
        self._response_s = response_s
        self._notes: deque[_Note] = deque(maxlen=NOTES)
        self._measured_at = -math.inf
        self._balanced_mps = (0.0, 0.0)
        self._balanced_at = 0.0

    def pause(self) -> None:
        """The reference stands, or jumps: what was learned stays."""
        self._notes.clear()

    def note(self, place_m: Vector, velocity_mps: Vector, now: float) -> None:
        """The reference as it is now."""
        last = self._notes[-1] if self._notes else None
        if last is not None and now - last.at < NOTE_S:
            return
        # what the integral has followed: the velocity, or its going back during a pause, in which the vehicle stood
        lasting = (0.0, 0.0) if last is None else velocity_mps[:2]
        share = -math.expm1(-max(0.0, now - self._balanced_at) / BALANCED_S)
        east, north = self._balanced_mps
        self._balanced_mps = east + (lasting[0] - east) * share, north + (lasting[1] - north) * share
        self._balanced_at = now
        # where the vehicle is to be expected: ahead by the response, less where the way turns
        turn_radps = 0.0 if last is None else _turned_rad(last.velocity_mps, velocity_mps) / (now - last.at)
        ahead_s = self._response_s / (1.0 + (TURNS_S * turn_radps) ** 2)
        (x, y, z), (u, v, w) = place_m, velocity_mps
        expected_m = x + u * ahead_s, y + v * ahead_s, z + w * ahead_s
        self._notes.append(_Note(now, expected_m, velocity_mps, self._balanced_mps))

    def observe(self, place_m: Sequence[float], measured_at: float) -> None:
        """A position, with the time at which it was measured; one that was seen already teaches nothing."""
        if measured_at <= self._measured_at or not self._notes or measured_at < self._notes[0].at:
            return
        then = next(note for note in reversed(self._notes) if note.at <= measured_at)
        ahead_s = measured_at - then.at
        error_m = [p + v * ahead_s - q for p, v, q in zip(then.place_m, then.velocity_mps, place_m, strict=True)]
        since_s = measured_at - max(self._measured_at, self._notes[0].at)
        (east, north, _), (by_east, by_north) = then.velocity_mps, then.balanced_mps
        speed_mps = max(math.hypot(east, north), math.hypot(by_east, by_north))
        self.estimate = self.estimate.learned(error_m, (east - by_east, north - by_north), speed_mps, since_s)
        self._measured_at = measured_at


def _turned_rad(before: Vector, after: Vector) -> float:
    """Angle between two level velocities, to the left; 0 where one of them is none."""
    cross, dot = before[0] * after[1] - before[1] * after[0], before[0] * after[0] + before[1] * after[1]
    return math.atan2(cross, dot)
