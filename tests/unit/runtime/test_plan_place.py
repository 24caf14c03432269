"""The gate to the extension that keeps the plan: whatever it raises stays its own fault."""

from __future__ import annotations

import asyncio
from typing import Any

from skygcs.config.models import FleetConfig
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.plan_place import FAULT, PlanPlace
from support.services import KnownLinks
from support.vehicles import flight_dialect


class Broken:
    """Fails wherever it is asked, from when it is told to."""

    def __init__(self) -> None:
        self.broken = True

    def _answer(self, value: Any) -> Any:
        if self.broken:
            raise KeyError("v7")
        return value

    @property
    def moving(self) -> bool:
        return bool(self._answer(True))

    def status(self) -> dict[str, Any]:
        found: dict[str, Any] = self._answer({"plan": "1", "state": "flying", "reason": ""})
        return found

    def tick(self) -> None:
        self._answer(None)

    async def wind_down(self) -> None:
        self._answer(None)


async def test_each_fault_is_reported_and_the_last_status_stands() -> None:
    faults, paused, keeper = list[Exception](), list[bool](), Broken()
    place = PlanPlace(lambda: 1.0, faults.append, lambda: paused.append(True))
    place.keeper = keeper
    keeper.broken = False
    place.tick()
    assert place.status()["state"] == "flying" and (faults, paused) == ([], [])
    keeper.broken = True
    status = place.status()
    assert (status["plan"], status["state"], status["reason"]) == ("1", "flying", FAULT)
    assert place.moving and len(faults) == 2 and not paused
    place.tick()
    await place.wind_down()
    assert len(faults) == 4 and paused == [True, True]


async def test_the_fleet_does_all_of_its_tick_though_the_keeper_fails(monkeypatch: Any) -> None:
    events: list[Event] = []
    fleet = Fleet(
        FleetConfig(),
        flight_dialect(),
        lambda *_, **__: True,
        asyncio.get_running_loop(),
        events.append,
        links=KnownLinks(),
    )
    noted: list[float] = []
    monkeypatch.setattr(fleet.notes, "note_flights", noted.append)
    fleet.plans.keeper = Broken()
    for now in (1.0, 1.1):
        fleet.tick(now)
    assert noted == [1.0, 1.1]
    assert [event.kind for event in events] == ["fault", "fault"]
