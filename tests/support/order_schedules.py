"""Schedules of faults for orders between two sites over a hub in memory, in virtual time."""

from __future__ import annotations

import asyncio
import json
import random
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from skygcs.ext.federation.bridge.orders_sent import OrdersSent
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from support.memory_hub import Faults, MemoryBus, MemoryHub
from support.order_faults import HomeBridge, ModelDaemon, count, run_schedule, verdicts

HOME = "north"
CLOCK_AHEAD_S = 12345.0
"""Of the home site's clock."""


async def memory_schedules(seeds: Iterable[int], folder: Path) -> tuple[list[str], Counter[str]]:
    """What contradicts the model in these schedules, and what happened: orders as shown and settled, faults by kind."""
    wrong: list[str] = []
    happened: Counter[str] = Counter()
    for seed in seeds:
        own = folder / f"memory-{seed}"
        own.mkdir()
        wrong += await _schedule(seed, own, happened)
    return wrong, happened


async def _schedule(seed: int, folder: Path, happened: Counter[str]) -> list[str]:
    loop = asyncio.get_running_loop()
    rng = random.Random(seed)
    hub = MemoryHub(seed)
    daemon = ModelDaemon(random.Random(seed + 1), loop)
    home = HomeBridge(HOME, daemon, folder, lambda: loop.time() + CLOCK_AHEAD_S)
    station = MemoryBus(hub, loop)
    buses = {"station": station, "home": _start(home, hub, loop)}
    await asyncio.sleep(0.2)
    numbers = iter(range(10**6))
    sent = OrdersSent(
        "south",
        "site",
        station,
        RemoteSites("south", "run"),
        loop,
        clock=loop.time,
        new_key=lambda: f"{seed:016x}{next(numbers):016x}",
    )

    async def fault(_: float) -> None:
        kind = rng.choice(("cut", "cut", "reset", "hub", "bad", "bad", "daemon", "stall", "bridge"))
        happened[f"fault: {kind}"] += 1
        bus = buses[rng.choice(("station", "home"))]
        pause_s = rng.choice((0.05, 0.3, 1.5, 4.0))
        match kind:
            case "cut":
                bus.cut(pause_s)
            case "reset":
                bus.reset()
            case "hub":
                hub.stop()
                await asyncio.sleep(pause_s)
                hub.start()
            case "bad":
                bus.faults = Faults(rng.choice((0.002, 0.1, 0.6)), double=rng.random(), reorder=rng.random())
            case "daemon":
                daemon.stop()
                await asyncio.sleep(pause_s)
                daemon.start()
            case "stall":
                daemon.stalled_until = loop.time() + pause_s
            case "bridge":
                buses["home"].close()
                await home.stop()
                await asyncio.sleep(pause_s)
                buses["home"] = _start(home, hub, loop)

    async def heal() -> None:
        for bus in buses.values():
            bus.faults = Faults()

    given = await run_schedule(sent, HOME, rng, fault, heal)
    wrong = verdicts(given, daemon, home)
    await asyncio.sleep(20.0)  # for copies that are still on their way
    wrong += [text for text in verdicts(given, daemon, home) if text not in wrong]
    await home.stop()
    count(given, daemon, happened)
    return [f"seed {seed}: {text}" for text in wrong]


def _start(home: HomeBridge, hub: MemoryHub, loop: asyncio.AbstractEventLoop) -> MemoryBus:
    bus = MemoryBus(hub, loop)
    taken = home.start(bus.publish)
    run = f"run{home.starts}"

    async def answer(subject: str, payload: bytes) -> bytes:
        if subject.startswith("here."):
            return json.dumps({"t0_s": 0, "site_s": loop.time() + CLOCK_AHEAD_S, "run": run}).encode()
        return await taken.answer(subject, payload)

    bus.serve(f"*.{HOME}*", answer)
    return bus
