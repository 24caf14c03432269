"""The cameras of a simulated motion capture system: true poses become frames, with all that real ones do wrong."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

from skygcs.core.geo import Origin, enu_from_geodetic, quaternion_from_euler, quaternion_product
from skygcs.ext.mocap.pose import CaptureFrame, Pose, ned_frd
from skygcs.ext.mocap.recording import CaptureFrameData
from skygcs.sim.rng import Rng

if TYPE_CHECKING:  # as in simulated_capture.py
    from skygcs.sim.vehicle_state import VehicleState

MAX_LATE = 1024
"""Frames that are on their way: two seconds at 500 Hz."""

JUMP_M = (1.0, 3.0)
"""How far away a pose is whose markers are taken for another body's."""


@dataclass(slots=True)
class CameraErrors:
    """Errors of the cameras; may be changed at any time. Shares of frames, 0..1."""

    noise_m: float = 0.0005
    noise_rad: float = 0.002
    latency_s: float = 0.01
    occluded: float = 0.0
    repeated: float = 0.0
    jumps: float = 0.0


class CaptureCameras:
    """``vehicles`` by the name of their rigid body. `capture` at each frame's time, then `due` for what has arrived."""

    def __init__(
        self, vehicles: Mapping[str, VehicleState], frame: CaptureFrame, origin: Origin, errors: CameraErrors, seed: int
    ) -> None:
        self.errors = errors
        self.hidden: set[str] = set()
        """Bodies that are covered: they are not seen until they are taken out of here."""
        self._vehicles = vehicles
        self._frame = frame
        self._origin = origin
        self._rng = Rng(seed)
        self._late: deque[tuple[float, CaptureFrameData]] = deque(maxlen=MAX_LATE)
        self._last: dict[str, Pose] = {}

    def capture(self, now: float) -> None:
        """Expose a frame."""
        seen = {name: self._body(name, vehicle, now) for name, vehicle in self._vehicles.items()}
        self._late.append((now + self.errors.latency_s, CaptureFrameData(now, seen)))

    def due(self, now: float) -> list[CaptureFrameData]:
        """The frames that have arrived by now."""
        found = []
        while self._late and self._late[0][0] <= now + 1e-9:
            found.append(self._late.popleft()[1])
        return found

    def _body(self, name: str, vehicle: VehicleState, now: float) -> Pose | None:
        errors, rng = self.errors, self._rng
        if name in self.hidden or rng.random() < errors.occluded:
            return None
        if name in self._last and rng.random() < errors.repeated:
            last = self._last[name]
            return Pose(now, last.pos_m, last.q)
        x, y, z = true_pose(vehicle, self._origin, now).pos_m
        if rng.random() < errors.jumps:
            away_m, angle = rng.uniform(*JUMP_M), rng.uniform(0.0, pi)
            x += away_m * (1.0 if angle > pi / 2 else -1.0)
        n = errors.noise_m
        turned = quaternion_from_euler(*(errors.noise_rad * rng.gauss() for _ in range(3)))
        q = quaternion_product(true_pose(vehicle, self._origin, now).q, turned)
        pose = Pose(now, (x + n * rng.gauss(), y + n * rng.gauss(), z + n * rng.gauss()), q)
        seen = self._last[name] = self._frame.from_enu(pose, self._origin)
        return seen


def true_pose(vehicle: VehicleState, origin: Origin, now: float) -> Pose:
    """Where a simulated vehicle truly is, in ENU about the origin, its body FLU."""
    plain = Origin(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m)
    body = vehicle.motion
    frd = quaternion_from_euler(body.roll_rad, body.pitch_rad, body.yaw_rad)
    # the two half turns of `ned_frd` are their own inverses, so it leads back as well
    q = ned_frd(Pose(now, (0.0, 0.0, 0.0), frd)).q
    return Pose(now, enu_from_geodetic(*vehicle.true_position(), plain), q)
