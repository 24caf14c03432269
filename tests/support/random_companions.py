"""Random flights by a companion: ground and companion are lost, begin again, or both; a radio leads to the vehicle."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from support.companion_pair import Pair, companion_pair
from support.random_flights import Deeds, Judged, watch
from support.truth_monitor import TruthMonitor

FLIGHT_S = 35.0


@dataclass
class PairFlight(Deeds):
    """One flight of a vehicle with its companion."""

    rng: random.Random
    pair: Pair
    monitor: TruthMonitor
    lost: set[str] = field(default_factory=set)
    """Of "ground" and "companion", those that do not run."""

    def order(self, method: str, **params: Any) -> None:
        if "ground" not in self.lost:
            self.start(self.pair(method, **params))


async def engage(f: PairFlight) -> None:
    f.order("control.set", targets="v1", mode=f.rng.choice(["attitude", "attitude", "velocity", "position", "off"]))


async def orders(f: PairFlight) -> None:
    f.order(f.rng.choice(["vehicles.hold", "missions.start", "vehicles.land"]), targets="v1")


async def goto(f: PairFlight) -> None:
    f.order("vehicles.goto", targets="v1", enu_m=[f.rng.uniform(-9, 9), f.rng.uniform(-9, 9), 10.0])


async def calls(f: PairFlight) -> None:
    """The RPC connection is away for a while."""
    f.pair.calls.up = False
    await asyncio.sleep(f.rng.choice([0.5, 3.0, 7.0]))
    f.pair.calls.up = "companion" not in f.lost


async def pilot(f: PairFlight) -> None:
    px4 = f.pair.pi.sim().autopilot == mav.MAV_AUTOPILOT_PX4
    f.pair.pi.other_sets_mode(*((4, 3) if px4 else (int(CopterMode.LOITER), 0)))


async def lose(f: PairFlight) -> None:
    """One of them dies, or both, and begins again after a while."""
    which = f.rng.choice([("companion",), ("ground",), ("companion", "ground")])
    away_s = f.rng.choice([0.5, 2.0, 6.0, 12.0])
    f.done[-1] += f" {'+'.join(which)} for {away_s}"
    f.monitor.daemon_died(f.pair.now)
    for name in which:
        f.lost.add(name)
        if name == "companion":
            f.pair.calls.up = False
            await f.pair.pi.die()
        else:
            await f.pair.lose_ground()
    await asyncio.sleep(away_s)
    if len(f.lost) == 2:
        f.monitor.daemon_began()
    f.monitor.begun_again()
    for name in which:
        if name == "companion":
            await f.pair.companion_begins_again()
        else:
            await f.pair.ground_begins_again()
        f.lost.discard(name)
    f.pair.calls.up = True


DEEDS: tuple[tuple[Callable[[PairFlight], Awaitable[None]], int], ...] = (
    (engage, 6),
    (orders, 2),
    (goto, 2),
    (calls, 2),
    (pilot, 1),
    (lose, 4),
)


async def fly_by_companion(tmp_path: Path, seed: int) -> Judged:
    """One flight of this seed."""
    rng = random.Random(seed)
    kind = rng.choice([{"px4": 1}, {"px4": 0, "ardupilot": 1}])
    conditions = conditions_of(wind_mps=rng.uniform(0.0, 8.0), wind_from_deg=rng.uniform(0.0, 360.0))
    flying = {"radio": True, "conditions": conditions, "in_air": True, "setpoints_end": False}
    async with companion_pair(tmp_path, **flying, **kind) as pair:
        ids = pair.ground.fleet._services.own
        flight: PairFlight
        monitor = TruthMonitor(pair.pi.sims, ids, lambda sysid: len(flight.lost) < 2)
        flight = PairFlight(rng, pair, monitor)
        looking = asyncio.create_task(watch(monitor, pair.pi, lambda _: len(flight.lost) < 2), name="the monitor")
        began = pair.now
        flight.order("control.set", targets="v1", mode="attitude")
        deeds, weights = zip(*DEEDS, strict=True)
        while pair.now < began + FLIGHT_S:
            await asyncio.sleep(rng.choice([0.5, 1.0, 3.0, 5.0]))
            (deed,) = rng.choices(deeds, weights)
            flight.done.append(f"{pair.now:.2f} {deed.__name__}")
            await deed(flight)
        await asyncio.sleep(8.0)
        for task in [*flight.under_way, looking]:
            task.cancel()
        await asyncio.gather(*flight.under_way, looking, return_exceptions=True)
        flight.require_nothing_raised()
        holds = sum(t.kind == "unattended" for t in [*pair.told, *pair.pi.told])
        return Judged(
            seed, tuple(monitor.breaches), (), monitor.looked, monitor.attended_again, holds, tuple(flight.done)
        )
