"""Two sites that want the same leases at the same moment: the bridges' own parts, over a real hub."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

from skygcs.config.files import boot_s
from skygcs.events import Event
from skygcs.ext.federation.authority import Authority
from skygcs.ext.federation.bridge.leases import Leases
from skygcs.ext.federation.config import SharedVehicle
from skygcs.ext.federation.protocol.lease import NEW_HUB_S, State
from support.hub import Hub, until

RACERS = ("north", "south")
USERS = {name: {"role": "site", "orders": ["*"]} for name in (*RACERS, "east")}
"""The vehicles' home is not there: it would take what is free."""

OF_EAST = SharedVehicle(home="east", without_hub="stop")
Clock = Callable[[], float]


class GateLink:
    """A real gate in place of the connection to a daemon."""

    def __init__(self, site: str, vehicles: Iterable[str], clock: Callable[[], float]) -> None:
        self.gate = Authority(site, {name: i for i, name in enumerate(vehicles)})
        self.client: object | None = None
        self.control: dict[str, str] | None = {"state": "flying"}
        """State of control of each vehicle. A site that flies one by setpoints does not hand it over."""
        self._clock = clock
        self._observers: list[Callable[[], None]] = []

    def on_change(self, observer: Callable[[], None]) -> None:
        self._observers.append(observer)

    async def run(self) -> None:
        self.client = object()
        for observer in self._observers:
            observer()
        await asyncio.Event().wait()

    async def call(self, method: str, **params: Any) -> Any:
        gate, now = self.gate, self._clock()
        match method:
            case "authority.status":
                states = {name: gate.status_of(sysid, now) for name, sysid in gate.vehicles.items()}
                return {"site": gate.site, "run": f"run of {gate.site}", "now_s": now, "vehicles": states}
            case "authority.grant":
                until = params["sent_s"] + params["valid_for_s"]
                result = gate.grant(params["vehicle"], until, now, token=params["token"], hub=params["hub"])
                return {"result": result}
            case "authority.revoke":
                gate.revoke(params["vehicle"], token=params["token"], hub=params["hub"], commander=params["commander"])
                return {}
            case "vehicles.get":
                return {"control": self.control}
        raise AssertionError(method)

    def held(self) -> set[str]:
        now = self._clock()
        return {name for name, sysid in self.gate.vehicles.items() if self.gate.refusal(sysid, now) is None}


class Racer:
    """A site's part that holds leases."""

    def __init__(
        self, site: str, bus: Any, vehicles: Iterable[str], shared: SharedVehicle = OF_EAST, clock: Clock = boot_s
    ) -> None:
        """``bus``: a `Bus`, or one that is played."""
        self.link = GateLink(site, vehicles, clock)
        self.methods: dict[str, Any] = {}
        self.reported = Reported()
        config = SimpleNamespace(vehicles=dict.fromkeys(vehicles, shared))
        station: Any = SimpleNamespace(bus=bus, name=site, config=config, methods=self.methods, report=self.reported)
        self.leases = Leases(station, self.link, clock)  # type: ignore[arg-type]

    async def call(self, method: str, vehicle: str, **params: Any) -> Any:
        return await self.methods[method]({"vehicle": vehicle, **params})

    def has_hub(self) -> bool:
        """Whether its leases may be taken."""
        leases = self.leases._leases.values()
        return bool(leases) and all(lease._connected for lease in leases)

    def states(self) -> Counter[str]:
        return Counter(lease["state"] for lease in self.leases.status()["leases"])


class Reported:
    """In the place of `station.Reports`."""

    def __init__(self) -> None:
        self.recent: list[Event] = []

    def __call__(self, event: Event) -> None:
        self.recent.append(event)
        del self.recent[:-200]


async def race(hub: Hub, rounds: int, vehicles: int) -> dict[str, Any]:
    """Both take all vehicles at once, for so many rounds; before each, the winners release them."""
    names = [f"v{i}" for i in range(vehicles)]
    winners: Counter[str] = Counter()
    won: Counter[str] = Counter()
    async with hub.bus("north") as north_bus, hub.bus("south") as south_bus:
        racers = [Racer(site, bus, names) for site, bus in zip(RACERS, (north_bus, south_bus), strict=True)]
        running = [asyncio.create_task(racer.leases.run()) for racer in racers]
        try:
            await until(lambda: all(r.states().total() == vehicles and r.has_hub() for r in racers), "the parts run")
            for number in range(rounds):
                await _all(racers, "federation.release", names)
                if number == 0:
                    await asyncio.sleep(NEW_HUB_S)
                await _released(racers)
                taking = asyncio.create_task(_all(racers, "federation.take", names))
                await until(lambda: len(racers[0].link.held() | racers[1].link.held()) == vehicles, "all are held")
                held = [racer.link.held() for racer in racers]
                await asyncio.sleep(0.3)  # for a second winner, who comes later
                both = set.intersection(*held) | set.intersection(*(racer.link.held() for racer in racers))
                for name in names:
                    winners["2" if name in both else str(sum(name in of for of in held))] += 1
                won.update({racer.link.gate.site: len(of) for racer, of in zip(racers, held, strict=True)})
                taking.cancel()
                await asyncio.gather(taking, return_exceptions=True)
        finally:
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)
    return {"races": rounds * vehicles, "winners": dict(winners), "won": dict(won)}


async def _all(racers: list[Racer], method: str, names: list[str]) -> None:
    """The same of every vehicle at both sites; a refusal is an outcome like any other."""
    calls = [racer.call(method, name) for name in names for racer in racers]
    await asyncio.gather(*calls, return_exceptions=True)


async def _released(racers: list[Racer]) -> None:
    def free() -> bool:
        return all(set(r.states()) <= {str(State.OBSERVED)} for r in racers) and not any(r.link.held() for r in racers)

    await until(free, "all are released")
