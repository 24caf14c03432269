"""How late control ticks come with and without the monitor, in turn within one run: real time, one process, uvloop.

A fleet hears every vehicle four times a second, spread over time; a clock of 50 Hz measures how late it is woken, as
the control clocks are.
"""

from __future__ import annotations

import asyncio
import gc
import statistics
import time
from collections.abc import Iterator
from typing import Any

import uvloop

from bench.monitor.cost import _motion
from skygcs.config.models import FleetConfig
from skygcs.runtime.fleet import Fleet
from support.services import KnownLinks
from support.vehicles import flight_dialect
from support.watched_fleet import VehicleOfFleet

FLEETS = (50, 250)
LAYOUTS = ("grid", "crossing")
TICK_S = 0.02
SLICE_S = 5.0
SLICES = 6
"""Without and with the monitor, three times each."""

HEARD_HZ = 4.0


def lateness_rows() -> Iterator[dict[str, Any]]:
    for vehicles in FLEETS:
        for layout in LAYOUTS:
            yield uvloop.run(_measure(vehicles, layout))


async def _measure(count: int, layout: str) -> dict[str, Any]:
    loop = asyncio.get_running_loop()
    config = FleetConfig.model_validate({"monitor": {"mode": "advisory"}})
    fleet = Fleet(config, flight_dialect(), lambda *_, **__: True, loop, lambda event: None, links=KnownLinks())
    vehicles = [VehicleOfFleet(i + 1, fleet) for i in range(count)]
    feeding = asyncio.create_task(_feed(vehicles, layout), name="frames")
    await asyncio.sleep(2.0)
    gc.collect()
    gc.freeze()
    late: dict[bool, list[float]] = {False: [], True: []}
    for n in range(SLICES):
        on = n % 2 == 1
        watch = asyncio.create_task(fleet.monitor.run(), name="monitor") if on else None
        late[on] += await _ticks()
        if watch is not None:
            watch.cancel()
    feeding.cancel()
    took_ms, turn_ms = 1000 * fleet.monitor.took_s, 1000 * fleet.monitor.longest_turn_s
    fleet.close()
    without, with_it = (_p99_ms(late[on]) for on in (False, True))
    return {
        "vehicles": count,
        "layout": layout,
        "p99_without_ms": round(without, 3),
        "p99_with_ms": round(with_it, 3),
        "ratio": round(with_it / without, 2),
        "most_without_ms": round(1000 * max(late[False]), 2),
        "most_with_ms": round(1000 * max(late[True]), 2),
        "evaluation_ms": round(took_ms, 1),
        "longest_turn_ms": round(turn_ms, 2),
    }


async def _feed(vehicles: list[VehicleOfFleet], layout: str) -> None:
    """Each `HEARD_HZ` times a second, one after the other."""
    pause_s, n, begun = 1.0 / (HEARD_HZ * len(vehicles)), 0, time.monotonic()
    loop = asyncio.get_running_loop()
    while True:
        while n * pause_s < time.monotonic() - begun:
            i = n % len(vehicles)
            now = loop.time()
            if n // len(vehicles) % 4 == 0:  # once a second
                vehicles[i].heartbeat(now)
            vehicles[i].position(now, *_motion(i, layout, (time.monotonic() - begun) % 20.0))
            n += 1
            if n % 4 == 0:
                break
        await asyncio.sleep(pause_s)


async def _ticks() -> list[float]:
    """How late each tick of a slice was."""
    loop, late = asyncio.get_running_loop(), []
    due, end = loop.time() + TICK_S, loop.time() + SLICE_S
    while due < end:
        woken: asyncio.Future[None] = loop.create_future()
        loop.call_at(due, woken.set_result, None)
        await woken
        late.append(max(0.0, loop.time() - due))
        due += TICK_S
    return late


def _p99_ms(late: list[float]) -> float:
    return 1000 * statistics.quantiles(late, n=100)[98]
