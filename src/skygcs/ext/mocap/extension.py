"""Motion capture in the daemon: poses for the vehicles of [mocap], and how they fare in each vehicle's state."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from skygcs.config.tables import Problem
from skygcs.ext.mocap.config import MocapConfig, mocap_problems
from skygcs.ext.mocap.feed import TICK_S, MocapFeed
from skygcs.ext.mocap.methods import METHODS
from skygcs.ext.mocap.source import SYSTEMS
from skygcs.extension import Clock, Extension, StateGroup

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.core.vehicle.order_plan import Plan
    from skygcs.core.vehicle.vehicle import Vehicle
    from skygcs.rpc.context import Services


class Mocap(Extension[MocapConfig]):
    """Feeds poses from the opening of the links to the end."""

    Config = MocapConfig
    own_methods = METHODS

    def __init__(self, core: Services, config: MocapConfig) -> None:
        super().__init__(core, config)
        assert core.config.origin is not None  # `problems` has seen to it
        self.feed = MocapFeed(core, config, core.config.origin)
        core.event_log.on("reboot", self.feed.on_reboot)
        core.event_log.on("vehicle_discovered", lambda event: self.feed.refresh())  # it may share a link with others

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return mocap_problems(config, fleet)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        if config.type in SYSTEMS and find_spec("motioncapture") is None:
            return ["motioncapture is not installed here: pip install 'skygcs[mocap]'"]
        if config.file is not None and not os.path.isfile(config.file):
            return [f"the recording {config.file} (file) does not exist now"]
        return []

    def state_groups(self) -> Mapping[str, StateGroup]:
        return {"mocap": lambda vehicle, now: self.feed.status_of(vehicle.sysid, now)}

    def clocks(self) -> Iterable[Clock]:
        yield Clock("motion capture tick", TICK_S, lambda: self.feed.tick(self.core.now()))

    async def run(self) -> None:
        """Read the system."""
        await self.feed.run()

    def bytes_per_s(self, channel_id: int) -> float:
        return self.feed.bytes_per_s(channel_id)

    def order_refusal(self, vehicle: Vehicle, plan: Plan, now: float) -> str | None:
        return self.feed.order_refusal(vehicle, plan)

    def close(self) -> None:
        self.feed.close()
