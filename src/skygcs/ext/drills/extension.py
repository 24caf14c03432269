"""Drills in the daemon: begins and ends faults in simulated vehicles, and shows which last.

A fault is put into the model of a vehicle on a link of type `simulated`, and nowhere else: nothing of it is sent, so no
vehicle on any other link can have it. One that is heard on another link is refused, also with the system id of a
simulated one: the daemon takes both for one vehicle, and would show a real one as under a drill.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from skygcs.config.tables import Model, Problem
from skygcs.core.protocols.command import Outcome
from skygcs.events import Event
from skygcs.ext.drills.methods import METHODS
from skygcs.extension import Extension, StateGroup
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.sim.drills import FAULTS, ActiveFault, FaultName, VehicleDrill
from skygcs.sim.vehicle import SimVehicle
from skygcs.spelling import rounded

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.rpc.context import Services
    from skygcs.runtime.vehicle_actor import VehicleActor

KIND = "drill"


class DrillsConfig(Model):
    """[drills]: its presence adds the drill methods. It makes no fault by itself."""


class Drills(Extension[DrillsConfig]):
    """The faults that last, of all simulated vehicles."""

    Config = DrillsConfig
    own_methods = METHODS

    def __init__(self, core: Services, config: DrillsConfig) -> None:
        super().__init__(core, config)
        self._drills: dict[int, VehicleDrill] = {}
        """By system id; the vehicle may be another one after its link was removed and added."""

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        if any(link.type == "simulated" for link in fleet.links.values()):
            return []
        text = "needs a link of type simulated: no other vehicle can be given a fault; remove the table"
        return [Problem(("drills",), text)]

    @classmethod
    def fleet_notes(cls, config: Any, fleet: FleetConfig) -> list[str]:
        real = [name for name, link in fleet.links.items() if link.type != "simulated" and link.enabled]
        if not real:
            return []
        return [f"beside {', '.join(real)}: give simulated vehicles system ids that no real one has (first_sysid)"]

    def state_groups(self) -> Mapping[str, StateGroup]:
        return {"drills": self._state_of}

    def info(self) -> dict[str, Any]:
        return {"active": sum(len(drill.active) for drill in self._current().values())}

    def announcement(self) -> str:
        return "faults of simulated vehicles can be begun (drills.begin)"

    def close(self) -> None:
        for drill in self._current().values():
            for fault in list(drill.active):
                drill.end(fault)

    # -- what the methods do

    def begin(self, actors: Iterable[VehicleActor], fault: FaultName, value: float | None) -> dict[str, Outcome]:
        """Begin a fault in each of these; the outcomes by name."""
        return {actor.name: self._begin(actor, fault, value) for actor in actors}

    def end(self, actors: Iterable[VehicleActor], fault: FaultName | None) -> dict[str, Outcome]:
        """End a fault of each of these, or all of them."""
        return {actor.name: self._end(actor, fault) for actor in actors}

    def status(self) -> dict[str, Any]:
        """Status as drills.status answers it."""
        names = {actor.sysid: actor.name for actor in self.core.fleet.vehicles.values()}
        current = self._current()
        simulated = self._simulated()
        return {
            "simulated": [name for sysid, name in names.items() if sysid in simulated],
            "faults": [
                {"fault": name, "text": kind.text, "unit": kind.unit, "default": kind.default}
                | {"least": kind.least, "most": kind.most}
                for name, kind in FAULTS.items()
            ],
            "active": [
                {"vehicle": names[sysid], **self._described(active)}
                for sysid, drill in sorted(current.items())
                for active in drill.active.values()
                if sysid in names
            ],
        }

    # -- internal

    def _simulated(self) -> dict[int, SimVehicle]:
        """The vehicles that this daemon simulates and hears on no other link, by system id."""
        elsewhere = {actor.sysid for actor in self.core.fleet.vehicles.values() if self._other_links(actor)}
        found = {vehicle.sysid: vehicle for link in self._links() for vehicle in link.vehicles}
        return {sysid: vehicle for sysid, vehicle in found.items() if sysid not in elsewhere}

    def _other_links(self, actor: VehicleActor) -> list[str]:
        """The links beside those of simulated vehicles that it is heard on."""
        simulated = {link.name for link in self._links()}
        return [name for name in self.core.hub.statistics.link_quality(actor.vehicle.key) if name not in simulated]

    def _links(self) -> Iterator[SimulatedVehiclesLink]:
        for name in self.core.links.configs:
            link = self.core.links.link(name)
            if isinstance(link, SimulatedVehiclesLink):
                yield link

    def _current(self) -> dict[int, VehicleDrill]:
        """The drills of vehicles that are there; those of others are ended and forgotten."""
        present = self._simulated()
        for sysid, drill in list(self._drills.items()):
            if present.get(sysid) is not drill.vehicle:
                del self._drills[sysid]
                for fault in list(drill.active):
                    drill.end(fault)
        return self._drills

    def _begin(self, actor: VehicleActor, fault: FaultName, value: float | None) -> Outcome:
        vehicle = self._simulated().get(actor.sysid)
        if vehicle is None:
            others = ", ".join(self._other_links(actor))
            heard = f"; it is heard on {others}, so it may be a real one" if others else ""
            return Outcome.refused(f"it is not simulated by this daemon: no fault can be made in it{heard}")
        drill = self._current().setdefault(actor.sysid, VehicleDrill(vehicle))
        try:
            begun = drill.begin(fault, value, self.core.now())
        except ValueError as error:
            return Outcome.refused(str(error))
        self._report(actor, f"drill: {_text(begun)} begins", begun, active=True)
        return Outcome(True, "accepted", f"{_text(begun)}, until it is ended")

    def _end(self, actor: VehicleActor, fault: FaultName | None) -> Outcome:
        drill = self._current().get(actor.sysid)
        wanted = [] if drill is None else [drill.active[f] for f in drill.active if fault in (None, f)]
        if drill is None or not wanted:
            what = "no fault" if fault is None else FAULTS[fault].text
            return Outcome.refused(f"{what} of a drill lasts in it")
        for active in wanted:
            drill.end(active.fault)
            self._report(actor, f"drill: {_text(active)} has ended", active, active=False)
        return Outcome(True, "accepted", f"ended: {', '.join(map(_text, wanted))}")

    def _state_of(self, actor: VehicleActor, now: float) -> dict[str, Any] | None:
        drill = self._drills.get(actor.sysid)
        if drill is None or not drill.active or self._other_links(actor):
            return None
        return {"faults": [self._described(active) for active in drill.active.values()]}

    def _described(self, active: ActiveFault) -> dict[str, Any]:
        lasts_s = round(self.core.now() - active.begun_at, 1)
        return {"fault": active.fault, "text": _text(active), "value": active.value, "lasts_s": lasts_s}

    def _report(self, actor: VehicleActor, text: str, fault: ActiveFault, *, active: bool) -> None:
        data = {"fault": fault.fault, "value": fault.value, "active": active}
        self.core.event_log.publish(Event(KIND, actor.name, actor.sysid, text, data))


def _text(active: ActiveFault) -> str:
    """A fault for people: "wind, 8 m/s"."""
    kind = FAULTS[active.fault]
    return kind.text if active.value is None else f"{kind.text}, {rounded(active.value)} {kind.unit}"
