"""One vehicle on a trajectory: the reference at each time, and what must be true before it begins. Pure.

The trajectory is given along the axes of the origin that its flight's lock holds, and stands on earth from the start
on. Its clock may drive other vehicles as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from skygcs.core.control.cascade import Reference, Vector
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.gains import out_of_range
from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.separation import separation_m
from skygcs.core.trajectory import ClockState, MotionPeaks, Trajectory, TrajectoryClock, motion_peaks
from skygcs.core.trajectory.motion_limits import SLACK, Box, bounding_box
from skygcs.core.trajectory.piecewise import joints, require_continuous
from skygcs.core.trajectory.trajectory_clock import AT_REST_MPS, ReplicatedClock, rate_limit
from skygcs.errors import ConfigError, RefusedError

BASE_M = 1000.0
"""Length over which the directions of one frame are measured in another."""

OVER = frozenset({ClockState.ABORTED, ClockState.FINISHED})


@dataclass(frozen=True, slots=True)
class TrajectoryLimits:
    """Limits of what a vehicle may be sent along. Raises ConfigError with every problem."""

    start_within_m: float = 1.0
    """Distance from the first point at which it may begin."""
    speed_mps: float = 5.0
    acceleration_mps2: float = 3.0
    """PX4's MPC_ACC_HOR; ArduCopter's WPNAV_ACCEL is 2.5."""
    climb_mps: float = 2.5
    descent_mps: float = 1.5
    """The firmwares' default speeds (ArduCopter WPNAV_SPEED_UP and _DN 2.5 and 1.5, PX4 3 and 1.5)."""
    jerk_mps3: float | None = None
    """Not limited unless it is set: setpoints of neither autopilot carry jerk."""
    velocity_jump_mps: float = 0.5
    """Where pieces meet, and at the start and the end: a path of straight lines turns by jumps."""
    brake_mps2: float = 1.0
    """Acceleration that a pause, an abort or a change of speed adds at most."""

    def __post_init__(self) -> None:
        problems = out_of_range(
            self,
            ("start_within_m", 0.1, 100.0),
            ("speed_mps", 0.01, 100.0),
            ("acceleration_mps2", 0.01, 30.0),
            ("climb_mps", 0.01, 100.0),
            ("descent_mps", 0.01, 100.0),
            ("jerk_mps3", 0.01, 1000.0),
            ("velocity_jump_mps", 0.0, 100.0),
            ("brake_mps2", 0.05, 30.0),
        )
        if problems:
            raise ConfigError("control.trajectory", problems)


class LoadedTrajectory:
    """A trajectory with its exact bounds, which take 1.5 ms for each piece of degree 7. Raises TrajectoryError
    where its position or yaw jumps."""

    def __init__(self, trajectory: Trajectory, name: str = "trajectory") -> None:
        require_continuous(trajectory)
        self.trajectory = trajectory
        self.name = name
        self.peaks: MotionPeaks = motion_peaks(trajectory)
        self.box: Box = bounding_box(trajectory)
        found = list(joints(trajectory))
        self.velocity_jump_mps = max(joint.velocity_mps for joint in found[1:-1]) if len(found) > 2 else 0.0
        self.first_speed_mps = found[0].velocity_mps
        self.last_speed_mps = found[-1].velocity_mps

    def why_not(self, limits: TrajectoryLimits, speed_factor: float) -> str | None:
        """Which limit it exceeds at this speed; None if none."""
        f, peaks = speed_factor, self.peaks
        for what, value, limit, unit in (
            ("speed", peaks.speed_mps.at_most * f, limits.speed_mps, "m/s"),
            ("climb rate", peaks.climb_mps.at_most * f, limits.climb_mps, "m/s"),
            ("descent rate", peaks.descent_mps.at_most * f, limits.descent_mps, "m/s"),
            ("acceleration", peaks.acceleration_mps2.at_most * f * f, limits.acceleration_mps2, "m/s²"),
            ("jerk", peaks.jerk_mps3.at_most * f * f * f, limits.jerk_mps3, "m/s³"),
            ("jump of velocity between pieces", self.velocity_jump_mps * f, limits.velocity_jump_mps, "m/s"),
        ):
            if limit is not None and not value <= limit * (1.0 + SLACK):  # also for NaN
                return f"its {what} of {value:.3g} {unit} is above {limit:g}"
        return None

    def outside(self, origin: Origin, fence: Fence) -> str | None:
        """Why it is not wholly within the fence less its margin; None if it is."""
        world = EnuFrame(origin)
        for corner in self.box.corners():
            what = "a corner of the box about the trajectory"
            why = fence.why_not(*world.to_geodetic(*corner), reference=True, what=what)
            if why is not None:
                return why
        return None


def common_clock(
    loaded: list[LoadedTrajectory], brake_mps2: float, speed_factor: float, lead_s: float = 0.0
) -> TrajectoryClock:
    """One clock for several vehicles. ``lead_s``: of its orders, where some of them run a replica of it elsewhere; it
    is a `ReplicatedClock` then. Raises TrajectoryError, RefusedError."""
    limit = rate_limit(max(one.peaks.speed_mps.at_most for one in loaded), brake_mps2)
    duration_s = max(one.trajectory.duration_s for one in loaded)
    rests_at_start = all(one.first_speed_mps <= AT_REST_MPS for one in loaded)
    rests_at_end = all(one.last_speed_mps <= AT_REST_MPS for one in loaded)
    rests = {"rests_at_start": rests_at_start, "rests_at_end": rests_at_end}
    if lead_s > 0.0:
        return ReplicatedClock(duration_s, limit, speed_factor=speed_factor, **rests, lead_s=lead_s)
    return TrajectoryClock(duration_s, limit, speed_factor=speed_factor, **rests)


class TrajectoryFlight:
    """One vehicle on a loaded trajectory. ``frame``: the vehicle's local frame, in which references are."""

    def __init__(self, loaded: LoadedTrajectory, clock: TrajectoryClock, origin: Origin, frame: EnuFrame) -> None:
        self.loaded = loaded
        self.clock = clock
        self._to_local, self._turned = _transform(EnuFrame(origin), frame)
        east, north, _ = self._turned((1.0, 0.0, 0.0))
        self._turn_rad = math.atan2(north, east)

    @property
    def duration_s(self) -> float:
        """Duration of the vehicle's own trajectory."""
        return self.loaded.trajectory.duration_s

    def reference(self, now: float, yaw_rad: float) -> Reference:
        """Where it shall be at ``now``; ``yaw_rad``: to keep, if the trajectory has no yaw."""
        time = self.clock.at(now)
        point = self.loaded.trajectory.at(time.trajectory_s, time.rate, time.rate_change_per_s)
        return Reference(
            self._to_local(point.pos_enu_m),
            yaw_rad if point.yaw_rad is None else point.yaw_rad + self._turn_rad,
            self._turned(point.vel_enu_mps),
            self._turned(point.acc_enu_mps2),
            yaw_rate_radps=point.yaw_rate_radps,
        )

    def ahead(self, now: float, step_s: float, steps: int) -> list[Vector]:
        """Where it shall be now and after each of so many steps, if its clock goes on as fast as it does now."""
        time = self.clock.at(now)
        last_s = self.duration_s
        at_s = (min(time.trajectory_s + i * step_s * time.rate, last_s) for i in range(steps + 1))
        return [self.place(s) for s in at_s]

    def foreseen(self, at: float) -> Vector:
        """Where it shall be at a later time if its clock gets no order until then."""
        return self.place(self.clock.foreseen_s(at))

    def place(self, trajectory_s: float) -> Vector:
        """Where it shall be at a time of its trajectory."""
        return self._to_local(self.loaded.trajectory.at(trajectory_s).pos_enu_m)

    def over(self, now: float) -> bool:
        """True if its clock has come to an end: it stands there from now on."""
        return self.clock.at(now).state in OVER

    def status(self, now: float) -> dict[str, Any]:
        """Status for people and programs."""
        time = self.clock.at(now)
        finishes_at_s = self.clock.finishes_at_s(now)
        return {
            "name": self.loaded.name,
            "state": time.state.value,
            "trajectory_s": time.trajectory_s,
            "duration_s": self.duration_s,
            "speed_factor": self.clock.speed_factor,
            "rate": time.rate,
            "finishes_in_s": None if finishes_at_s is None else max(0.0, finishes_at_s - now),
        }


Mapped = Callable[[Vector], Vector]


def _transform(world: EnuFrame, local: EnuFrame) -> tuple[Mapped, Mapped]:
    """Positions and directions of one frame in the other: both stand still on earth, so it is a rotation and an
    offset."""

    def moved(point: Vector) -> Vector:
        return local.from_geodetic(*world.to_geodetic(*point))

    ox, oy, oz = moved((0.0, 0.0, 0.0))
    columns = []
    for axis in ((BASE_M, 0.0, 0.0), (0.0, BASE_M, 0.0), (0.0, 0.0, BASE_M)):
        x, y, z = moved(axis)
        columns.append(((x - ox) / BASE_M, (y - oy) / BASE_M, (z - oz) / BASE_M))
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = columns

    def turned(v: Vector) -> Vector:
        x, y, z = v
        return xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z

    def to_local(v: Vector) -> Vector:
        x, y, z = turned(v)
        return ox + x, oy + y, oz + z

    return to_local, turned


class StartTube(NamedTuple):
    """How far from the first point a vehicle of a certified flight may begin: ``radius_m`` in the metric of the
    certificate, which divides heights by ``downwash_ratio``."""

    radius_m: float
    downwash_ratio: float


def distance_refusal(
    here: Vector | None, first: Vector, limits: TrajectoryLimits, tube: StartTube | None = None
) -> str | None:
    """Why it may not begin from here; None if it may. In one frame. ``tube``: in place of the limit."""
    if here is None:
        return "its position is not known"
    if tube is not None:
        away_m = separation_m(here[0] - first[0], here[1] - first[1], here[2] - first[2], tube.downwash_ratio)
        if away_m <= tube.radius_m:
            return None
        return f"it is {away_m:.1f} m from where the step begins; {tube.radius_m:.1f} m are allowed"
    away_m = math.dist(here, first)
    if away_m <= limits.start_within_m:
        return None
    return (
        f"it is {away_m:.1f} m from the first point (limit {limits.start_within_m:g} m, control.trajectory."
        "start_within_m): send it there with goto first"
    )


def require_speed(flights: list[TrajectoryFlight], limits: list[TrajectoryLimits], speed_factor: float) -> None:
    """Raise RefusedError where one of them could not be flown at this factor."""
    for flight, of_vehicle in zip(flights, limits, strict=True):
        why = flight.loaded.why_not(of_vehicle, speed_factor)
        if why is not None:
            raise RefusedError(f"at a speed factor of {speed_factor:g} {why}")
