"""Compares our vehicles with those of other sites once a second, and reports changes.

    what changes                 goes to
    --------------------------   ------------------------------------------------------------------------------------
    a conflict's level           our log, the clients of the station socket, and `event.<site>` for all other stations
    conflicts now                federation.sites

Each site watches its own vehicles against the others', so two sites report a conflict of theirs, each with the age that
the other's data have there. A station without vehicles reads those events.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import Any

from skygcs.config.models import FleetConfig
from skygcs.core.alarms import VehicleFacts, event_record
from skygcs.core.separation import Footprint
from skygcs.events import Event
from skygcs.ext.federation.protocol.own_states import OwnStates
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.ext.federation.protocol.site_conflicts import SiteConflicts, SiteVehicle
from skygcs.ext.federation.protocol.site_names import qualified
from skygcs.ext.federation.protocol.state_batch import VehicleRow

EVERY_S = 1.0

ON_GROUND = "on_ground"


class ConflictWatch:
    """A part of the bridge: `run` in a task."""

    def __init__(
        self,
        fleet: FleetConfig,
        own: OwnStates,
        sites: RemoteSites,
        clock: Callable[[], float],
        send: Callable[[Event, Mapping[str, Any]], Awaitable[None]],
    ) -> None:
        """``clock``: the one of ``sites`` and ``own``. ``send`` gets each event, and the same as clients read it."""
        self.conflicts = SiteConflicts()
        self.took_s = 0.0
        """CPU time of the last evaluation."""
        self._fleet = fleet
        self._own = own
        self._sites = sites
        self._clock = clock
        self._send = send
        self._shared = fleet.delegated
        self._footprints = {vehicle.name: vehicle.separation.footprint() for vehicle in fleet.vehicle_configs()}
        self._footprint = fleet.default_vehicle(1).separation.footprint()
        """Footprint of vehicles that no fleet file of this site describes."""

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            await asyncio.sleep(EVERY_S)
            await self.evaluate()

    async def evaluate(self) -> None:
        """Evaluate all pairs once, in slices between which the loop runs, and send the events."""
        now = self._clock()
        took_s, begun = 0.0, time.thread_time()
        turns = self.conflicts.evaluate(list(self._ours(now)), list(self._others(now)), now)
        for _ in turns:
            took_s += time.thread_time() - begun
            await asyncio.sleep(0)
            begun = time.thread_time()
        self.took_s = took_s + time.thread_time() - begun
        events, self.conflicts.events = self.conflicts.events, []
        for event in events:
            await self._send(event, event_record(event, time.time(), VehicleFacts()))

    def described(self) -> list[dict[str, Any]]:
        """The conflicts now, the most urgent first; for federation.sites."""
        return [conflict.describe() for conflict in self.conflicts.conflicts()]

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        counters = self.conflicts.counters
        return {
            "watched": self.conflicts.watched,
            "conflicts": len(self.conflicts.conflicts()),
            "evaluation_s": round(self.took_s, 6),
            **{name: getattr(counters, name) for name in counters.__slots__},
        }

    def _ours(self, now: float) -> Iterator[SiteVehicle]:
        for row in self._own.rows(now):
            yield self._vehicle(row, row.name, row.position_age_s, self._footprints.get(row.name, self._footprint))

    def _others(self, now: float) -> Iterator[SiteVehicle]:
        for site in self._sites.names:
            batch_age_s = self._sites.batch_age_s(site, now)
            for row in self._sites.rows(site):
                unknown = batch_age_s is None or row.position_age_s is None
                age_s = None if unknown else (row.position_age_s or 0.0) + (batch_age_s or 0.0)
                yield self._vehicle(row, qualified(site, row.name), age_s, self._footprint)

    def _vehicle(self, row: VehicleRow, name: str, age_s: float | None, footprint: Footprint) -> SiteVehicle:
        return SiteVehicle(
            name=name,
            lat_deg=row.lat_deg,
            lon_deg=row.lon_deg,
            alt_amsl_m=row.alt_amsl_m,
            vel_enu_mps=row.vel_enu_mps,
            age_s=math.inf if age_s is None else age_s,
            flying=row.armed and row.landed != ON_GROUND,
            footprint=footprint,
            shared=row.name in self._shared,
        )
