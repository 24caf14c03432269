"""Timed references: piecewise polynomial trajectories, their limits, their timing, and the clock that drives them."""

from skygcs.core.trajectory.motion_limits import (
    MotionLimits,
    MotionPeaks,
    Peak,
    least_limits,
    motion_peaks,
    require_within,
    within_at_speed,
)
from skygcs.core.trajectory.piecewise import (
    Joint,
    Piece,
    Trajectory,
    TrajectoryPoint,
    joints,
    require_continuous,
)
from skygcs.core.trajectory.trajectory_clock import ClockState, ClockTime, TrajectoryClock

__all__ = [
    "ClockState",
    "ClockTime",
    "Joint",
    "MotionLimits",
    "MotionPeaks",
    "Peak",
    "Piece",
    "Trajectory",
    "TrajectoryClock",
    "TrajectoryPoint",
    "joints",
    "least_limits",
    "motion_peaks",
    "require_continuous",
    "require_within",
    "within_at_speed",
]
