"""Where a body may be that the cameras have lost: whether one that is seen again is the same. Pure.

known of the time without poses              it may be
------------------------------------------   ------------------------------------------------------------------
its vehicle's own estimate, which goes on    where that has moved, and `DRIFT_MPS2` of drift
by inertial sensors, newer than the loss
nothing                                      on its way on with its own velocity for `COAST_S` at most, and
                                             `MANOEUVRE_MPS2` beside it, `MOST_M` at most
another body is seen                         never nearer to that one than to where it is expected
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from skygcs.ext.mocap.pose import Pose, Vector

VELOCITY_S = 0.1
"""A velocity is measured over so long: with noise of a millimetre it is good to 2 cm/s."""

MAX_KEPT = 64
"""Poses of VELOCITY_S at 240 Hz, and some room."""

COAST_S = 1.0
"""A vehicle that loses its position levels and is stopped by its drag, or by its controller before that."""

MANOEUVRE_MPS2 = 4.0
"""Acceleration of a vehicle in a capture volume: MPC_ACC_HOR is 3 m/s², WPNAV_ACCEL 2.5 m/s²."""

MOST_M = 3.0
"""ArduCopter 4.6.3 in SITL had drifted by 3 m when its failsafe had put it on the ground, 13 s after the last pose."""

DRIFT_MPS2 = 0.5
"""Drift of inertial navigation: an attitude that is wrong by 3 degrees lets gravity in."""

FRESH_S = 1.0
"""A vehicle's own position that is older is not compared."""

SPEED_MPS = 5.0
"""Largest speed of a vehicle in a capture volume."""

OwnEstimate = tuple[Vector, float]
"""A vehicle's own position, east, north, up of the same origin, and when it came."""


class LostBody:
    """Loss of one body: `seen` for each good pose, `may_be` for one that is seen after a loss."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=MAX_KEPT)
        self._own: OwnEstimate | None = None
        """The vehicle's own estimate at the last good pose."""

    def seen(self, pose: Pose, own: OwnEstimate | None, *, again: bool = False) -> None:
        """A good pose. ``again``: the first one after a loss, from which no velocity follows."""
        poses = self._poses
        if again:
            poses.clear()
        poses.append(pose)
        while len(poses) > 2 and pose.at - poses[1].at >= VELOCITY_S:
            poses.popleft()
        self._own = own

    def velocity_mps(self) -> Vector:
        """Its velocity at the last good pose; zero if it is not known."""
        first, last = (self._poses[0], self._poses[-1]) if self._poses else (None, None)
        if first is None or last is None or last.at <= first.at:
            return (0.0, 0.0, 0.0)
        x, y, z = ((b - a) / (last.at - first.at) for a, b in zip(first.pos_m, last.pos_m, strict=True))
        too_fast = math.hypot(x, y, z) / SPEED_MPS
        return (x, y, z) if too_fast <= 1.0 else (x / too_fast, y / too_fast, z / too_fast)

    def may_be(self, pose: Pose, own: OwnEstimate | None, others: Iterable[Vector], margin_m: float) -> bool:
        """True if this pose, the first after a loss, can be of the same body. ``own``: the vehicle's own estimate now;
        ``others``: the places of the other bodies; ``margin_m`` is added to what is expected."""
        if not self._poses:
            return True
        expected_m, reach_m = self._expected(pose, own)
        away_m = math.dist(pose.pos_m, expected_m)
        if any(math.dist(pose.pos_m, other) < away_m for other in others):
            return False
        return away_m <= margin_m + reach_m

    def _expected(self, pose: Pose, own: OwnEstimate | None) -> tuple[Vector, float]:
        """The place where it is expected at the time of a pose, and how far from it it may be."""
        last = self._poses[-1]
        gap_s = max(0.0, pose.at - last.at)
        before = self._own
        if own is not None and before is not None and own[1] > last.at and pose.at - own[1] <= FRESH_S:
            x, y, z = (p + b - a for p, a, b in zip(last.pos_m, before[0], own[0], strict=True))
            age_s = max(0.0, pose.at - own[1]) + max(0.0, last.at - before[1])
            speed_mps = min(SPEED_MPS, math.hypot(*self.velocity_mps()) + MANOEUVRE_MPS2 * min(gap_s, COAST_S))
            return (x, y, z), 0.5 * DRIFT_MPS2 * gap_s**2 + speed_mps * age_s
        # on its way on, as far as is nearest to the pose
        velocity = self.velocity_mps()
        way_s = min(gap_s, COAST_S)
        speed2 = sum(v * v for v in velocity)
        along = sum((q - p) * v for p, q, v in zip(last.pos_m, pose.pos_m, velocity, strict=True))
        on_s = 0.0 if speed2 == 0.0 else min(max(along / speed2, 0.0), way_s)
        x, y, z = (p + v * on_s for p, v in zip(last.pos_m, velocity, strict=True))
        return (x, y, z), min(0.5 * MANOEUVRE_MPS2 * gap_s**2, MOST_M)
