"""[companions] in a daemon on the ground: a connection to each companion, the flights that they make, and mDNS."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from skygcs.config.tables import Problem
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.ext.companions import methods
from skygcs.ext.companions.companion_control import CompanionCalls, CompanionControl
from skygcs.ext.companions.companion_link import CompanionClient, CompanionLink, Dial
from skygcs.ext.companions.companion_links import CompanionLinks
from skygcs.ext.companions.companions_table import CompanionsConfig, companions_problems, servers_of
from skygcs.ext.companions.ground_finder import GroundAnnouncement
from skygcs.ext.companions.pinned_client import connect_pinned
from skygcs.ext.companions.tls import PIN_LOOK_S, Identity, read_certificate
from skygcs.extension import Clock, Extension, StateGroup, repeated
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig, VehicleConfig
    from skygcs.core.vehicle.vehicle import Vehicle
    from skygcs.rpc.context import Services
    from skygcs.runtime.vehicle_services import VehicleServices


class Companions(Extension[CompanionsConfig]):
    """The ground's side of companions."""

    Config = CompanionsConfig
    names = ("companion",)
    control_at = "companion"
    own_methods = (methods.STATUS,)

    def __init__(self, core: Services, config: CompanionsConfig) -> None:
        super().__init__(core, config)
        publish = core.event_log.publish
        sleep = core.fleet.sleep
        self._pins: dict[str, tuple[object, bytes | None]] = {}
        """By companion: `Identity.changed` at the last look, and what was pinned when the connection was begun."""
        self.links = CompanionLinks(config, self._dial_to, asyncio.get_running_loop(), publish, sleep.check)
        self.by_vehicle: dict[str, CompanionCalls] = {**self.links.by_vehicle()}
        """The connections, by the vehicle that the companion is on."""
        for link in self.links.by_vehicle().values():
            link.on_events(partial(self._on_event, link))
        self._announcement: GroundAnnouncement | None = None
        if config.advertise:
            announced = config.link or servers_of(core.config)[0]  # `problems` has found that there is one
            self._announcement = GroundAnnouncement(announced, config.interfaces, core.links, publish, name=config.name)

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return companions_problems(config, fleet)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        if find_spec("asyncssh") is None:
            return ["asyncssh is not installed here: pip install 'skygcs[companions]'"]
        return []

    def state_groups(self) -> Mapping[str, StateGroup]:
        return {"companion": self._companion_of}

    def new_flight(self, vehicle: Vehicle, config: VehicleConfig, services: VehicleServices) -> CompanionControl:
        heard_at = self.core.fleet.components.onboard_computer_heard_at
        return CompanionControl(vehicle, config, services, self.by_vehicle, heard_at)

    def clocks(self) -> Iterable[Clock]:
        yield Clock("pins of companions", PIN_LOOK_S, self._look_at_pins)

    async def run(self) -> None:
        """Keep all companions connected, and announce this ground station."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self.links.run(), name="connections to companions")
            if self._announcement is not None:
                announcing = repeated(self._announcement.run, self.core.hub.fault)  # its fault ends no connection
                group.create_task(announcing, name="ground announcement")

    def woke(self, why: str) -> None:
        self.links.woke(why)

    def status(self) -> dict[str, Any]:
        """JSON-able, for companions.status."""
        announcement = self._announcement
        return {
            "companions": self.links.status(),
            "announced": None if announcement is None else announcement.announced,
            "problem": None if announcement is None else announcement.problem,
            "companion": None,
        }

    def _companion_of(self, vehicle: VehicleActor, now: float) -> dict[str, Any] | None:
        """The computer on a vehicle, as `VehicleState.companion`: from the fleet file, or heard by MAVLink."""
        heard = self.core.fleet.companion_of(vehicle)
        name = self.config.of_vehicle(vehicle.name)
        if name is None:
            return heard
        link = self.by_vehicle.get(vehicle.name)
        unknown = dict.fromkeys(("link", "since_s", "error", "version"))
        age_s = None if heard is None else heard["age_s"]
        return {"name": name, **(unknown if link is None else link.summary()), "age_s": age_s}

    def _dial_to(self, companion: str, host: str, port: int) -> Dial:
        """The way to connect to a companion; the files are read each time, so that a new pin counts at once."""
        identity = Identity.of_ground(self.config.key_dir, companion)

        async def dial() -> CompanionClient:
            self._pins[companion] = identity.changed(), _pin_of(identity)
            return await connect_pinned(host, port, identity)

        return dial

    def _on_event(self, link: CompanionLink, event: Mapping[str, Any]) -> None:
        """An event at a companion. Those of its keys are events here, too: it is mended by a person on the ground."""
        data = event.get("data")
        change = data.get("change") if isinstance(data, dict) else None
        if event.get("kind") == "companion" and change in ("keys_kept", "keys_read"):
            text, told = f"companion {link.name}: {event.get('text')}"[:500], {"companion": link.name, "change": change}
            self.core.event_log.publish(Event("companion", link.vehicle, None, text, told))

    def _look_at_pins(self) -> None:
        """Connect anew where the pinned certificate is another one, or none: a companion whose certificate was removed
        gets nothing more. Nothing else ends a connection in flight: neither the same certificate written again, one
        that is half written, nor a new identity of ours, which the companion may not have pinned yet."""
        for name, (seen, pin) in self._pins.items():
            identity, link = Identity.of_ground(self.config.key_dir, name), self.links.get(name)
            if link is None or (changed := identity.changed()) == seen:
                continue
            if (found := _pin_of(identity)) == pin:
                self._pins[name] = changed, pin
            elif found is not None or identity.is_unpinned():
                link.woke("the pinned certificate was replaced or removed")


def _pin_of(identity: Identity) -> bytes | None:
    """The pinned certificate; None if it cannot be read."""
    try:
        return read_certificate(identity.pinned)
    except LinkError:
        return None
