"""Orders between sites while the network, the hub, the bridge or the daemon fails: what is promised, and how quickly.

Seeded schedules of faults are checked against a model of what may be shown and carried out (`support.order_faults`):
most over a hub in memory in virtual time, the others over a real nats-server. Then the hub and a site are taken away on
purpose, and orders are timed.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections import Counter
from pathlib import Path

import structlog

from bench.results import Found, in_virtual_time
from skygcs.rpc.client import Client
from support.fake_daemon import FakeDaemon
from support.federated import site
from support.hub import Hub
from support.hub_proxy import HubProxy
from support.order_schedules import memory_schedules
from support.order_schedules_real import real_schedules

MEMORY_SCHEDULES = 180
REAL_SCHEDULES = 24
AT_ONCE = 8
"""Real schedules that share a server and a loop."""

REAL_SLACK_S = 2.0
"""For the processor's time that eight schedules at once, and a server that is started, take from each other; the timed
orders below have none."""

ROUNDS = 5
FAILS_WITHIN_S, HEALED_WITHIN_S = 1.0, 2.0


def measure_faults(_: float) -> Found:
    """``schedules``: contradictions and what happened; ``times``: seconds of each order and of each healing."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    with tempfile.TemporaryDirectory(prefix="skygcs-faults-") as name:
        real, times = asyncio.run(_real(Path(name))), asyncio.run(_times(Path(name)))
    return {"memory": in_virtual_time(_memory), "real": real, "times": times}


def check_faults(found: Found) -> list[tuple[str, bool]]:
    lines = []
    for kind in ("memory", "real"):
        part = found[kind]
        shown = sum(count for what, count in part["happened"].items() if what.startswith("shown"))
        text = (
            f"{part['schedules']} schedules ({kind}): {shown} orders, {part['happened']['executions']} carried out, "
            f"{len(part['wrong'])} contradictions"
        )
        lines.append((text, not part["wrong"] and part["happened"]["executions"] > 0))
        lines += [(f"  {text}", False) for text in part["wrong"][:5]]
    total = found["memory"]["schedules"] + found["real"]["schedules"]
    lines.append((f"{total} schedules, at least 200, of them at least 20 over a real hub", total >= 200))
    for what, times in found["times"].items():
        most = HEALED_WITHIN_S if what.startswith("healed") else FAILS_WITHIN_S
        lines.append((f"{what}: at most {max(times):.2f} s of {len(times)}, promised {most:g} s", max(times) <= most))
    return lines


async def _memory(folder: Path) -> Found:
    wrong, happened = await memory_schedules(range(MEMORY_SCHEDULES), folder)
    return {"schedules": MEMORY_SCHEDULES, "wrong": wrong, "happened": dict(happened)}


async def _real(folder: Path) -> Found:
    wrong: list[str] = []
    happened: Counter[str] = Counter()
    for first in range(0, REAL_SCHEDULES, AT_ONCE):
        own = folder / f"real-{first}"
        own.mkdir()
        contradictions, counted = await real_schedules(range(first, first + AT_ONCE), own, time_slack_s=REAL_SLACK_S)
        wrong += contradictions
        happened += counted
    return {"schedules": REAL_SCHEDULES, "wrong": wrong, "happened": dict(happened)}


async def _times(folder: Path) -> dict[str, list[float]]:
    """Seconds, by what was taken away."""
    own = folder / "times"
    own.mkdir()
    hub = Hub(own)
    await hub.start()
    times: dict[str, list[float]] = {}

    def note(what: str, seconds: float) -> None:
        times.setdefault(what, []).append(round(seconds, 3))

    async with HubProxy(hub.port, 1) as before_south, HubProxy(hub.port, 2) as before_boss:
        south_servers, boss_servers = [before_south.url], [before_boss.url]
        async with (
            site(hub, "south", own, daemon=FakeDaemon(1), servers=south_servers),
            site(hub, "boss", own, role="operator", servers=boss_servers) as boss,
            boss.client() as gcs,
        ):
            await _healed(gcs)
            for _ in range(ROUNDS):
                hub.kill()
                note("an order at the moment of the hub's death", await _fails(gcs))
                await asyncio.sleep(0.5)
                note("an order without the hub", await _fails(gcs))
                note("healed after the hub's restart", await _restarted(hub, gcs, replaced=False))
                hub.kill()
                note("healed after the hub was replaced", await _restarted(hub, gcs, replaced=True))
                before_boss.cut(3.0)
                note("an order over a network that is cut here", await _fails(gcs))
                await asyncio.sleep(before_boss.cut_left_s())
                note("healed after the cut", await _healed(gcs))
                before_south.cut(3.0)
                note("an order to a site that is cut off", await _fails(gcs))
                await asyncio.sleep(before_south.cut_left_s())
                note("healed after the site's cut", await _healed(gcs))
    await hub.stop()
    return times


async def _fails(gcs: Client) -> float:
    """How long an order took to fail. Raises AssertionError if it was carried out."""
    began = time.monotonic()
    outcomes = await gcs.hold("south/alpha")
    assert not outcomes["south/alpha"]["ok"], outcomes
    return time.monotonic() - began


async def _restarted(hub: Hub, gcs: Client, *, replaced: bool) -> float:
    """How long after the server takes connections an order is carried out."""
    if replaced:
        hub.prepare_replacement()
    hub.process.start()
    await asyncio.to_thread(hub.process.wait)
    return await _healed(gcs)


async def _healed(gcs: Client) -> float:
    """How long until an order is carried out."""
    began = time.monotonic()
    while time.monotonic() - began < 30.0:
        try:
            outcomes = await gcs.hold("south/alpha")
            if outcomes["south/alpha"]["ok"]:
                return time.monotonic() - began
        except Exception as error:
            if "no site" not in str(error) and "no vehicle" not in str(error):
                raise
        await asyncio.sleep(0.02)
    raise AssertionError("not healed within 30 s")
