"""One cell of the table: so many vehicles, so fast an air, and a ground station that paces itself or does not.

The whole daemon in virtual time, with an emulated radio in its simulated link. Both columns use the same daemon, its
retries of commands too: what "plain" does not do is pace its writes, plan the streams, and leave the parameters alone.
"""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path
from typing import Any

from bench.commanded_daemon import MEASURE_S, PARAMETERS, SETTLE_S, Column, CommandedDaemon, Measured, furnish
from bench.results import in_virtual_time
from skygcs.core.mavlink.frame import encode
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.daemon import Daemon
from skygcs.runtime.vehicle_actor import VehicleActor
from support.daemons import first_heard, made_daemon, simulated_link, started

PACKET_LOSS = 0.01
"""On air, of every packet between the ground and a vehicle."""

USABLE_AGE_S = 2.5
USABLE_S = 5.0
"""All vehicles are usable when for so long no position was older."""


def measure(
    column: Column, vehicles: int, air_kbps: float, *, settle_s: float = SETTLE_S, measure_s: float = MEASURE_S
) -> Measured:
    """Run one cell; takes a few seconds of real time."""
    return in_virtual_time(lambda folder: _cell(Measured(column, vehicles, air_kbps), folder, settle_s, measure_s))


async def _cell(told: Measured, folder: Path, settle_s: float, measure_s: float) -> Measured:
    plain = told.column == "plain"
    link: dict[str, Any] = {
        **{"type": "simulated", "role": "peer" if plain else "radio", "dynamics": "kinematic"},
        **{"px4": told.vehicles // 2, "ardupilot": told.vehicles - told.vehicles // 2},
        "radio": {"air_kbps": told.air_kbps, "loss": PACKET_LOSS},
    }
    if not plain:  # nobody is slowed down: what others send fills whatever is left
        link["third_party"] = {"bytes_per_s": 100_000, "rates": {"PARAM_REQUEST_READ": 1000}}
    daemon = made_daemon(folder, links={"air": link}, defaults={"streams": {}} if plain else {})
    if plain:
        daemon.event_log.subscribe(lambda event: _download_parameters(daemon, event))
    async with started(daemon):
        await asyncio.sleep(0.01)  # the link opens
        radio = simulated_link(daemon, "air").radio
        assert radio is not None
        commanded = CommandedDaemon(daemon, radio.fleet.vehicles, told)
        told.round_s = radio.network.config.round_s
        for sim in commanded.sims:
            furnish(sim, daemon.now())
        watching = asyncio.create_task(_watch_usable(commanded, daemon.now()))
        await asyncio.sleep(settle_s)
        before = _counts(daemon)
        await commanded.measure(measure_s)
        frames, lost = (b - a for a, b in zip(before, _counts(daemon), strict=True))
        told.loss = lost / max(1, lost + frames)
        watching.cancel()
        await _emergency(commanded)
    return told


def _download_parameters(daemon: Daemon, event: Any) -> None:
    """The UTIAS lab's ground station downloaded the parameters of whomever it meets."""
    if event["kind"] == "vehicle_discovered":
        values = {"target_system": event["sysid"], "target_component": 1}
        info = daemon.dialect.by_name["PARAM_REQUEST_LIST"]
        daemon.hub.send(info, values, event["sysid"], 1, Priority.PROTOCOL)


def _counts(daemon: Daemon) -> tuple[int, int]:
    """Frames and lost frames of all vehicles."""
    (channel,) = simulated_link(daemon, "air").channels
    stats = [s for key, s in channel.sources.items() if key & 0xFF == 1]
    return sum(s.frames for s in stats), sum(s.lost for s in stats)


async def _watch_usable(commanded: CommandedDaemon, started_at: float) -> None:
    since: float | None = None
    while commanded.told.usable_s is None:
        await asyncio.sleep(0.2)
        now = commanded.daemon.now()
        fresh = max(commanded.ages()) <= USABLE_AGE_S
        since = (now if since is None else since) if fresh else None
        if since is not None and now - since >= USABLE_S:
            commanded.told.usable_s = round(since - started_at, 1)


async def _emergency(commanded: CommandedDaemon) -> None:
    """A stop for all while a ground station floods the link."""
    daemon, heard = commanded.daemon, first_heard(commanded.sims, 21, 176)
    flood = asyncio.create_task(_flood(commanded))
    await asyncio.sleep(10)
    ordered = daemon.now()
    stop = asyncio.create_task(daemon.fleet.orders.command_all("all", VehicleActor.stop, action="land"))
    await asyncio.sleep(20)
    stop.cancel()
    flood.cancel()
    await asyncio.gather(stop, flood, return_exceptions=True)
    commanded.told.emergency_s = [at - ordered for at in heard.values() if at >= ordered]


async def _flood(commanded: CommandedDaemon) -> None:
    """As much as the port takes, of what somebody else sends to the vehicles."""
    (channel,) = simulated_link(commanded.daemon, "air").channels
    info = commanded.daemon.dialect.by_name["PARAM_REQUEST_READ"]
    for index in itertools.count():
        for sim in commanded.sims:
            values = {"target_system": sim.sysid, "target_component": 1, "param_index": index % PARAMETERS}
            channel.send(encode(info, values, sysid=250, compid=190, seq=0), Priority.FORWARDED)
        await asyncio.sleep(0.1)
