"""A whole daemon with simulated vehicles behind an emulated radio, in virtual time."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

from skygcs.daemon import Daemon
from skygcs.links.base import Channel
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.vehicle import SimVehicle
from support.daemons import made_daemon, simulated_link, started

FIELD = {"lat_deg": 43.7806, "lon_deg": -79.4653, "alt_amsl_m": 180.0}


class OnAir:
    """The daemon, its one link "air", and the vehicles' side of it."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon

    @property
    def link(self) -> SimulatedVehiclesLink:
        return simulated_link(self.daemon, "air")

    @property
    def radio(self) -> RadioFleet:
        assert self.link.radio is not None
        return self.link.radio

    @property
    def channel(self) -> Channel:
        (channel,) = self.link.channels
        return channel

    def sim(self, sysid: int) -> SimVehicle:
        return next(s for s in self.link.vehicles if s.sysid == sysid)

    def air(self) -> dict[str, Any]:
        """What link.status reports of the radio."""
        (status,) = self.daemon.air.status(self.daemon.now())
        return status

    def vehicle(self, sysid: int) -> dict[str, Any]:
        return next(v for v in self.air()["vehicles"] if v["sysid"] == sysid)

    def rates(self, sysid: int) -> dict[str, float]:
        """Hz that a vehicle really streams, its heartbeat left out."""
        streams = self.sim(sysid).streams
        names = [name for name in self.sim(sysid).builders if streams.interval(name) < float("inf")]
        return {n: round(1 / streams.interval(n), 3) for n in names if n != "HEARTBEAT"}

    def events(self, *kinds: str) -> list[str]:
        return [e["text"] for e in self.daemon.event_log.recent if e["kind"] in kinds]

    async def until(self, condition: Callable[[], object], timeout_s: float = 60.0) -> float:
        """Wait for it; when it was."""
        end = self.daemon.now() + timeout_s
        while not condition():
            assert self.daemon.now() < end, "it never happened"
            await asyncio.sleep(0.1)
        return self.daemon.now()

    async def settled(self, vehicles: int, timeout_s: float = 60.0) -> float:
        """All are planned and follow."""
        return await self.until(
            lambda: (
                self.daemon.air.status(self.daemon.now())
                and len(self.air()["vehicles"]) == vehicles
                and all(v["settled"] for v in self.air()["vehicles"])
            ),
            timeout_s,
        )


@contextlib.asynccontextmanager
async def on_air(
    tmp_path: Path,
    *,
    px4: int = 1,
    ardupilot: int = 1,
    radio: Mapping[str, Any] | None = None,
    link: Mapping[str, Any] | None = None,
    defaults: Mapping[str, Any] | None = None,
    stations: int = 0,
    tables: Mapping[str, Any] | None = None,
) -> AsyncIterator[OnAir]:
    """From the moment at which the link is open; nobody has been heard yet. ``stations``: memory links "gcs0" and so on
    for as many ground stations. ``tables``: further tables of the fleet file."""
    air = {"type": "simulated", "role": "radio", "px4": px4, "ardupilot": ardupilot, "dynamics": "kinematic"}
    links = {
        "air": {**air, "radio": dict(radio or {}), **(link or {})},
        **{f"gcs{number}": {"type": "memory", "role": "gcs"} for number in range(stations)},
    }
    own = {"origin": FIELD, "links": links, "defaults": dict(defaults or {})}
    daemon = made_daemon(tmp_path, **{**own, **(tables or {})})
    async with started(daemon):
        air_ = OnAir(daemon)
        await air_.until(lambda: air_.link.channels)
        yield air_
        assert not air_.events("fault")
