"""Races for leases, take-overs, processes that are stopped, and a hub that goes while its home flies: all of it real.

Races: bridges' own lease parts over a real nats-server, both wanting every vehicle at once. Take-overs: two daemons
with their bridges and one vehicle that both hear over UDP; clients order it without end at both, and its log says what
arrived, from whom, when.
"""

from __future__ import annotations

import asyncio
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import structlog

from bench.results import Found
from skygcs.ext.federation.protocol.lease import TTL_S
from support.heard_vehicle import boot_s
from support.hub import Hub
from support.lease_races import USERS, race
from support.process import DaemonProcess, wait_until
from support.sharing_sites import Flight, Sites, home_with_flight, sharing_sites

RACES = 1000
AT_ONCE = 100
KILLS = 3
TAKEN_WITHIN_S = TTL_S + 1.0
HEALED_WITHIN_S = 2.0
AFTER_S = 4.0
"""How long a site that goes on is listened to."""


def measure_races(_: float) -> Found:
    """``winners``: how many races had so many holders."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))

    async def run() -> Found:
        with tempfile.TemporaryDirectory(prefix="skygcs-races-") as folder:
            hub = Hub(Path(folder), USERS)
            await hub.start()
            try:
                return await race(hub, RACES // AT_ONCE, AT_ONCE)
            finally:
                hub.process.stop()

    return asyncio.run(run())


def check_races(found: Found) -> list[tuple[str, bool]]:
    winners = found["winners"]
    both = " and ".join(f"{count} by {name}" for name, count in sorted(found["won"].items()))
    text = f"{found['races']} races for leases: {winners.get('1', 0)} had exactly one winner ({both})"
    return [(text, winners == {"1": found["races"]} and found["races"] >= RACES)]


def measure_takeover(_: float) -> Found:
    """``kills``, ``stops``: what the vehicle's log shows; ``hub``: the home's flight without its hub."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    kills = [_shared(lambda sites: killed(sites)) for _ in range(KILLS)]
    stops = {part: _shared(lambda sites, p=part: stopped(sites, p)) for part in ("daemon", "bridge", "both")}
    return {"kills": kills, "stops": stops, "hub": asyncio.run(_without_hub())}


def check_takeover(found: Found) -> list[tuple[str, bool]]:
    took_s = [kill["took_s"] for kill in found["kills"]]
    late = sum(kill["frames_after_ttl"] for kill in found["kills"])
    lines = [
        (
            f"holder killed with -9, {len(took_s)} times: the other site's first frame after at most "
            f"{max(took_s):.2f} s (TTL + 1 s is {TAKEN_WITHIN_S:g} s)",
            max(took_s) <= TAKEN_WITHIN_S,
        ),
        (f"frames of the killed site in the vehicle's log after the TTL: {late}", late == 0),
    ]
    for part, stop in found["stops"].items():
        text = (
            f"{part} stopped for {stop['stopped_s']:.1f} s and continued: {stop['frames_after_ttl']} frames of it after"
        )
        lines.append(
            (f"{text} the TTL, the other site took over after {stop['took_s']:.2f} s", not stop["frames_after_ttl"])
        )
    hub = found["hub"]
    for what in ("dead", "restarted", "replaced"):
        share = hub[what]["ticks_per_s"] / hub["before"]["ticks_per_s"]
        lines.append((f"hub {what}: {100 * share:.1f} % of the control ticks before", abs(share - 1) <= 0.05))
    for what in ("restarted", "replaced"):
        healed_s = hub[what]["healed_s"]
        lines.append((f"hub {what}: the lease is held at it after {healed_s:.2f} s", healed_s <= HEALED_WITHIN_S))
    return lines


def killed(sites: Sites) -> Found:
    """The home's processes are killed."""
    pids = sites.pids("north", "both")
    killed_s = boot_s()
    sites.signal(pids, signal.SIGKILL)
    wait_until(lambda: sites.sends("south", killed_s), "frames of south arrive")
    time.sleep(1.0)
    first = sites.sends("south", killed_s)[0]
    return {"took_s": first.at_s - killed_s, "frames_after_ttl": len(sites.sends("north", killed_s + TTL_S))}


def stopped(sites: Sites, part: str) -> Found:
    """A part of the home is stopped until the other site has taken over, and a second longer; then it goes on."""
    pids = sites.pids("north", part)
    stopped_s = boot_s()
    sites.signal(pids, signal.SIGSTOP)
    try:
        wait_until(lambda: sites.sends("south", stopped_s), "frames of south arrive")
        time.sleep(max(1.0, stopped_s + TTL_S + 1.0 - boot_s()))
    finally:
        continued_s = boot_s()
        sites.signal(pids, signal.SIGCONT)
    time.sleep(AFTER_S)
    return {
        "stopped_s": continued_s - stopped_s,
        "took_s": sites.sends("south", stopped_s)[0].at_s - stopped_s,
        "frames_after_ttl": len(sites.sends("north", stopped_s + TTL_S)),
        "frames_of_south_after": len(sites.sends("south", continued_s)),
    }


def _shared(fly: Callable[[Sites], Found]) -> Found:
    async def run() -> Found:
        with tempfile.TemporaryDirectory(prefix="skygcs-leases-") as folder:
            hub = Hub(Path(folder))
            await hub.start()

            def flown() -> Found:
                with sharing_sites(hub, Path(folder)) as sites:
                    return fly(sites)

            try:
                return await asyncio.to_thread(flown)
            finally:
                hub.process.stop()

    return asyncio.run(run())


async def _without_hub() -> Found:
    with tempfile.TemporaryDirectory(prefix="skygcs-home-") as folder:
        hub = Hub(Path(folder))
        await hub.start()
        try:
            with DaemonProcess(Path(folder), home_with_flight(hub), name="north") as north:
                flight = Flight(north)
                await asyncio.to_thread(flight.begin)
                return await without_hub(hub, flight)
        finally:
            hub.process.stop()


async def without_hub(hub: Hub, flight: Flight, each_s: float = 6.0) -> Found:
    """The hub is killed, started again, killed and replaced while the home flies its vehicle."""
    found: Found = {"before": {"ticks_per_s": await _ticks(flight, each_s)}}
    hub.kill()
    found["dead"] = {"ticks_per_s": await _ticks(flight, each_s), "lease": await asyncio.to_thread(flight.lease)}
    await hub.start()
    healed_s = await _healed(flight)
    found["restarted"] = {"healed_s": healed_s, "ticks_per_s": await _ticks(flight, each_s)}
    await hub.replace()
    healed_s = await _healed(flight)
    found["replaced"] = {"healed_s": healed_s, "ticks_per_s": await _ticks(flight, each_s)}
    return found


async def _healed(flight: Flight) -> float:
    """Until the lease is held at the hub again, from when it has its stores."""
    began = time.monotonic()
    await asyncio.to_thread(lambda: wait_until(lambda: flight.lease() == "held", "the lease is held"))
    return time.monotonic() - began


async def _ticks(flight: Flight, for_s: float) -> float:
    """Control ticks a second; the vehicle must be flown all the time."""
    before, began = await asyncio.to_thread(flight.ticks), time.monotonic()
    while (left_s := began + for_s - time.monotonic()) > 0:
        await asyncio.sleep(min(0.5, left_s))
        await asyncio.to_thread(flight.ticks)
    after, ended = await asyncio.to_thread(flight.ticks), time.monotonic()
    return (after - before) / (ended - began)
