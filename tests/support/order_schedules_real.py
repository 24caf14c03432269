"""The schedules of faults of `support.order_faults` over a real nats-server, several at a time, in real time.

Each schedule has a home site and a station of its own, with a proxy before each; the hub is one for all, and is killed,
started again and replaced for all of them.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pydantic_core import to_json

from skygcs.ext.federation.bridge.bus import Bus, BusOptions, Message
from skygcs.ext.federation.bridge.orders_sent import OrdersSent
from skygcs.ext.federation.bridge.site_clock import SiteClock
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from support.hub import Hub, until
from support.hub_proxy import HubProxy
from support.memory_hub import Faults
from support.order_faults import LENGTH_S, HomeBridge, ModelDaemon, count, run_schedule, verdicts

LATE_COPIES_S = 8.0
"""After the healing, for copies that are still on their way: a stop may be 5 s late."""

HUB_FAULTS = ("kill", "replace", "kill")


def users_of(seeds: Sequence[int]) -> dict[str, dict[str, object]]:
    """A site and an operator for each schedule."""
    users: dict[str, dict[str, object]] = {}
    for seed in seeds:
        users[f"home{seed}"] = {"role": "site"}
        users[f"boss{seed}"] = {"role": "operator", "orders": [f"home{seed}"]}
    return users


async def real_schedules(
    seeds: Sequence[int], folder: Path, *, time_slack_s: float = float("inf")
) -> tuple[list[str], Counter[str]]:
    """What contradicts the model in these schedules, and what happened."""
    hub = Hub(folder, users_of(seeds))
    await hub.start()
    happened: Counter[str] = Counter()
    try:
        schedules = [_Schedule(hub, seed, folder, happened, time_slack_s) for seed in seeds]
        failing = asyncio.create_task(_fail(hub, happened), name="faults of the hub")
        wrong = await asyncio.gather(*(schedule.run(failing) for schedule in schedules))
        await failing
    finally:
        await hub.stop()
    return [text for found in wrong for text in found], happened


async def _fail(hub: Hub, happened: Counter[str]) -> None:
    """Take the hub away a few times while the orders are given; it is there at the end."""
    await asyncio.sleep(2.0)
    for kind in HUB_FAULTS:
        happened[f"fault: hub {kind}"] += 1
        if kind == "replace":
            await hub.replace()
        else:
            hub.kill()
            await asyncio.sleep(0.7)
            await hub.start()
        await asyncio.sleep(0.2 * LENGTH_S)


class _Schedule:
    """One schedule: its two stations, their proxies and its daemon."""

    def __init__(self, hub: Hub, seed: int, folder: Path, happened: Counter[str], time_slack_s: float) -> None:
        self.home_name, self.boss_name = f"home{seed}", f"boss{seed}"
        self.seed = seed
        self.hub = hub
        self.happened = happened
        self.time_slack_s = time_slack_s
        self.loop = asyncio.get_running_loop()
        self.rng = random.Random(seed)
        self.clock = SiteClock()
        self.daemon = ModelDaemon(random.Random(seed + 1), self.loop)
        self.home = HomeBridge(self.home_name, self.daemon, folder, self.clock.site_s)
        self.proxies = {name: HubProxy(hub.port, seed) for name in (self.home_name, self.boss_name)}
        self._home_bus: asyncio.Task[None] | None = None

    async def run(self, hub_faults: asyncio.Task[None]) -> list[str]:
        async with self.proxies[self.home_name], self.proxies[self.boss_name]:
            await self._start_home()
            bus = self._bus(self.boss_name)
            running = asyncio.create_task(bus.run(), name=self.boss_name)
            try:
                await until(lambda: bus.connected, f"{self.boss_name} is connected")
                sent = OrdersSent(
                    self.boss_name, "operator", bus, RemoteSites(None, "run"), self.loop, clock=self.loop.time
                )

                async def heal() -> None:
                    for proxy in self.proxies.values():
                        proxy.faults = Faults(delay_s=0.0)
                    await asyncio.wait({hub_faults})
                    await until(lambda: bus.connected and self.bus.connected, "both are connected")

                given = await run_schedule(sent, self.home_name, self.rng, self._fault, heal)
                wrong = verdicts(given, self.daemon, self.home, time_slack_s=self.time_slack_s)
                await asyncio.sleep(LATE_COPIES_S)
                late = verdicts(given, self.daemon, self.home, time_slack_s=self.time_slack_s)
            finally:
                running.cancel()
                await asyncio.gather(running, return_exceptions=True)
                await self._stop_home()
        count(given, self.daemon, self.happened)
        return [f"seed {self.seed}: {text}" for text in (*wrong, *(text for text in late if text not in wrong))]

    async def _fault(self, _: float) -> None:
        kind = self.rng.choice(("cut", "cut", "reset", "bad", "bad", "daemon", "stall", "bridge"))
        self.happened[f"fault: {kind}"] += 1
        proxy = self.proxies[self.rng.choice((self.home_name, self.boss_name))]
        pause_s = self.rng.choice((0.05, 0.3, 1.5, 3.0))
        match kind:
            case "cut":
                proxy.cut(pause_s)
            case "reset":
                proxy.reset()
            case "bad":
                delay_s = self.rng.choice((0.0, 0.05, 0.3))
                proxy.faults = Faults(delay_s, double=self.rng.random(), reorder=0.5 * self.rng.random())
            case "daemon":
                self.daemon.stop()
                await asyncio.sleep(pause_s)
                self.daemon.start()
            case "stall":
                self.daemon.stalled_until = self.loop.time() + pause_s
            case "bridge":
                await self._stop_home()
                await asyncio.sleep(pause_s)
                await self._start_home()

    def _bus(self, name: str) -> Bus:
        key = self.hub.keys[name]
        options = BusOptions((self.proxies[name].url,), key.seed, key.public_key, name=name)
        return Bus(options, self.loop, lambda _: None)

    async def _start_home(self) -> None:
        self.bus = bus = self._bus(self.home_name)
        taken = self.home.start(lambda subject, data: None)
        run = f"run{self.home.starts}"

        async def here(_: Message) -> bytes:
            return to_json({"t0_s": 0.0, "site_s": self.clock.site_s(), "run": run})

        async def answer(message: Message) -> bytes:
            return await taken.answer(message.subject, message.data)

        await bus.serve(f"here.{self.home_name}", here)
        await bus.serve(f"cmd.{self.home_name}.*", answer)
        self._home_bus = asyncio.create_task(bus.run(), name=self.home_name)

    async def _stop_home(self) -> None:
        task, self._home_bus = self._home_bus, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            await self.home.stop()
