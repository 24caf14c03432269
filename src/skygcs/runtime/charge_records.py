"""The consumption of all vehicles' batteries in flight, for whoever plans the next one."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

from skygcs.core.vehicle.flight_note import FlightRecord
from skygcs.runtime.vehicle_actor import VehicleActor

CHARGE_S = 5.0
"""Between two looks at the charges of all vehicles."""


class ChargeRecords:
    """A `FlightRecord` of each vehicle. ``everybody`` returns the vehicles that are known."""

    def __init__(self, everybody: Callable[[], Collection[VehicleActor]]) -> None:
        self.recalled: dict[int, FlightRecord] = {}
        """By key, records of the daemon before, of vehicles that were not heard yet."""
        self._everybody = everybody
        self._records: dict[int, FlightRecord] = {}
        self._charged_at = -math.inf

    def record(self, actor: VehicleActor) -> FlightRecord:
        """Return what is measured of this vehicle's battery in flight."""
        key = actor.vehicle.key
        if key not in self._records:
            self._records[key] = self.recalled.pop(key, FlightRecord())
        return self._records[key]

    def tick(self, now: float) -> None:
        """Note the charges every `CHARGE_S`."""
        if now - self._charged_at < CHARGE_S:
            return
        self._charged_at = now
        there = self._everybody()
        for actor in there:
            battery = actor.vehicle.telemetry("battery")
            percent = None if battery is None else battery["percent"]
            self.record(actor).charge(now, percent, in_air=actor.vehicle.armed and actor.vehicle.in_air(now) is True)
        if len(self._records) > len(there):
            keys = {actor.vehicle.key for actor in there}
            self._records = {key: record for key, record in self._records.items() if key in keys}
