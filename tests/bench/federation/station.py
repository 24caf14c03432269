"""A process of the bench: one site's publisher, or one station's readers, as `skygcs federation run` has them.

python -m bench.federation.station publisher|reader URL SEED_FILE NAME [VEHICLES RATE_HZ | SITES]

It prints "ready" when it sends, or has the clocks of all SITES; reads three times of CLOCK_BOOTTIME from its input; at
the last one it prints as JSON what it did between the first two.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import secrets
import sys
import time
from pathlib import Path
from typing import Any

import structlog

from bench.federation.synthetic import SyntheticLink, age_of
from skygcs.cli.process import run_loop
from skygcs.ext.federation.bridge.bus import Bus, BusOptions
from skygcs.ext.federation.bridge.nkeys_files import read_seed
from skygcs.ext.federation.bridge.publisher import Publisher
from skygcs.ext.federation.bridge.readers import Readers
from skygcs.ext.federation.bridge.site_clock import SiteClock
from skygcs.ext.federation.protocol.own_states import OwnStates
from skygcs.ext.federation.protocol.remote_sites import RemoteSites

GOOD_CLOCK_S = 0.02
"""A comparison of clocks with a smaller bound is there soon on a busy machine, too."""


PERIOD_S = 0.1
READY_WITHIN_S = 120.0


class Seen:
    """What a reader got within the time of the measurement."""

    def __init__(self, sites: RemoteSites, clock: SiteClock) -> None:
        self.ages_s: list[float] = []
        """True age of each batch's states when they were taken."""
        self.oldest_s: list[float] = []
        """True age of what was shown just before."""
        self.errors_s: list[float] = []
        """Total age as it is shown, less the true one."""
        self.batches: dict[str, int] = {}
        self.states = 0
        self.fresh_at_s: float | None = None
        """First time after the end that a batch of the last two periods came."""
        self._sites = sites
        self._clock = clock
        self.begin_s = self.end_s = float("inf")
        self._last_lat: dict[str, float] = {}

    def on_batch(self, site: str) -> None:
        now = self._clock.now_s()
        row = self._sites.rows(site)[0]
        assert row.lat_deg is not None
        last = self._last_lat.get(site)
        self._last_lat[site] = row.lat_deg
        if now >= self.end_s and self.fresh_at_s is None and age_of(row.lat_deg, now) < 2 * PERIOD_S:
            self.fresh_at_s = now
        if not self.begin_s <= now < self.end_s:
            return
        self.batches[site] = self.batches.get(site, 0) + 1
        self.states += len(self._sites.rows(site))
        true_s = age_of(row.lat_deg, now)
        self.ages_s.append(round(true_s, 5))
        if last is not None:
            self.oldest_s.append(round(age_of(last, now), 5))
        state = self._sites.state(site, row.name, now, None)
        if state is not None and state["position"]["age_s"] is not None:
            self.errors_s.append(round(state["position"]["age_s"] - true_s, 5))


async def station(kind: str, url: str, seed_file: str, name: str, *more: str) -> int:
    clock, loop, key = SiteClock(), asyncio.get_running_loop(), read_seed(Path(seed_file))
    bus = Bus(BusOptions((url,), key.seed, key.public_key, name=name), loop, lambda event: None)
    run = secrets.token_hex(8)
    sites = RemoteSites(None, run)
    seen = Seen(sites, clock)
    part: Publisher | Readers
    if kind == "publisher":
        vehicles, rate_hz = int(more[0]), float(more[1])
        link: Any = SyntheticLink(vehicles, clock.now_s)
        part = publisher = Publisher(bus, link, clock, OwnStates(name, run, 1.0 / rate_hz), rate_hz)

        def ready() -> bool:
            return publisher.last_bytes > 0
    else:
        part = Readers(bus, sites, clock, own_site=None)
        part.on_batch.append(seen.on_batch)

        def ready() -> bool:
            return len(sites.names) == int(more[0]) and all(_good(sites, site, clock) for site in sites.names)

    tasks = [asyncio.create_task(bus.run()), asyncio.create_task(part.run())]
    async with asyncio.timeout(READY_WITHIN_S):  # the bench may have been ended
        while not (bus.connected and ready()):  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    gc.collect()
    gc.freeze()  # as `skygcs federation run`
    print("ready", flush=True)
    begin_s, end_s, last_s = map(float, (await loop.run_in_executor(None, sys.stdin.readline)).split())
    seen.begin_s, seen.end_s = begin_s, end_s
    await asyncio.sleep(max(0.0, begin_s - clock.now_s()))
    cpu_s, before = time.process_time(), dict(part.status())
    await asyncio.sleep(max(0.0, end_s - clock.now_s()))
    took_s, after = time.process_time() - cpu_s, part.status()
    await asyncio.sleep(max(0.0, last_s - clock.now_s()))
    found: dict[str, Any] = {
        "name": name,
        "cpu_share": round(took_s / (end_s - begin_s), 4),
        "status": {
            key: value - before.get(key, 0) if isinstance(value, int) and not isinstance(value, bool) else value
            for key, value in after.items()
        },
        "connections": bus.counters.connections,
        "dropped": bus.counters.dropped,
        "text": bus.text,
    }
    if kind == "reader":
        found |= {"batches": seen.batches, "states": seen.states}
        found["fresh_after_s"] = None if seen.fresh_at_s is None else round(seen.fresh_at_s - end_s, 3)
        found |= {"ages_s": seen.ages_s, "oldest_s": seen.oldest_s, "errors_s": seen.errors_s}
        found["lost"] = {site["site"]: site["batches"] for site in sites.sites(clock.now_s())}
    else:
        found["bytes"] = after["bytes"]
    for task in tasks:
        task.cancel()
    with contextlib.suppress(Exception):
        await asyncio.gather(*tasks, return_exceptions=True)
    print(json.dumps(found), flush=True)
    return 0


def _good(sites: RemoteSites, site: str, clock: SiteClock) -> bool:
    offset = sites.clock(site, clock.now_s())
    return offset is not None and offset.error_s < GOOD_CLOCK_S


if __name__ == "__main__":
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    sys.exit(run_loop(station(*sys.argv[1:])))
