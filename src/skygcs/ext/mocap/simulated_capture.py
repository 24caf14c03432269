"""The frames of type "simulated": cameras on the simulated vehicles of the daemon's own links."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, cast

from skygcs.core.geo import Origin
from skygcs.ext.mocap.cameras import CameraErrors, CaptureCameras
from skygcs.ext.mocap.capture_process import OnFrame
from skygcs.ext.mocap.config import MocapConfig, SimulatedMocapConfig
from skygcs.runtime.linktable import LinkTable

if TYPE_CHECKING:  # a daemon with real cameras does not load the simulator
    from skygcs.links.simulated import SimulatedVehiclesLink
    from skygcs.sim.vehicle_state import VehicleState

LOOK_S = 0.1
"""Until the simulated vehicles are there."""


class SimulatedCapture:
    """Run `run` in a task. ``cameras`` is None until all vehicles of ``bodies`` (body by system id) are there."""

    def __init__(
        self,
        config: MocapConfig,
        bodies: dict[int, str],
        origin: Origin,
        links: LinkTable,
        loop: asyncio.AbstractEventLoop,
        on_frame: OnFrame,
    ) -> None:
        self.cameras: CaptureCameras | None = None
        self._config = config
        self._own = config.simulated or SimulatedMocapConfig()
        self._bodies = bodies
        self._origin = origin
        self._links = links
        self._loop = loop
        self._on_frame = on_frame

    async def run(self) -> None:
        """Until the task is cancelled."""
        found = self._vehicles()
        while len(found) < len(self._bodies):
            await asyncio.sleep(LOOK_S)
            found = self._vehicles()
        own = self._own
        errors = CameraErrors(own.noise_m, own.noise_rad, own.latency_s, own.occluded, own.repeated, own.jumps)
        cameras = self.cameras = CaptureCameras(found, self._config.frame(), self._origin, errors, own.seed)
        period_s, at = 1.0 / own.frames_hz, self._loop.time()
        while True:
            now = self._loop.time()
            cameras.capture(now)
            for frame in cameras.due(now):
                self._on_frame(frame, now)
            at = max(at + period_s, now)
            await asyncio.sleep(max(0.0, at - self._loop.time()))

    def tick(self, now: float) -> None:
        """Nothing to watch."""

    def close(self) -> None:
        """Nothing to end."""

    def status(self) -> dict[str, Any]:
        """JSON-able; as that of the capture process."""
        state = "connecting" if self.cameras is None else "connected"
        return {
            "state": state,
            "text": "simulated cameras",
            "pid": None,
            "restarts": 0,
            "bad_lines": 0,
            "skipped_lines": 0,
        }

    def _vehicles(self) -> dict[str, VehicleState]:
        links = [s.link for s in self._links.supervisors().values() if s.link.config.type == "simulated"]
        vehicles = [v for link in links for v in cast("SimulatedVehiclesLink", link).vehicles]
        return {self._bodies[v.sysid]: v for v in vehicles if v.sysid in self._bodies}
