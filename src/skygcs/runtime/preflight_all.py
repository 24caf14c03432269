"""Preflight of a fleet: vehicles that are heard, and those of the fleet file that are not."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skygcs.config.models import VehicleConfig
from skygcs.core.preflight.report import Report, Severity, failed
from skygcs.core.vehicle import targets
from skygcs.runtime.preflight_run import result
from skygcs.runtime.vehicle_actor import VehicleActor

AT_ONCE = 3
"""Vehicles examined at the same time: their questions share a radio, and each has some fifteen."""

Expression = str | int | Sequence[str | int]


@dataclass(frozen=True, slots=True)
class Unheard:
    """A vehicle of the fleet file from which nothing has come since the daemon started."""

    config: VehicleConfig
    compid: int = 1

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def sysid(self) -> int:
        return self.config.sysid

    @property
    def groups(self) -> tuple[str, ...]:
        return self.config.groups

    def result(self) -> dict[str, Any]:
        text = "it is in the fleet file and has not been heard"
        todo = "switch it on; check its radio and the link; or take it out of the file"
        finding = failed(text, todo).named("link", Severity.FAULT)
        report = Report((finding,))
        return {"sysid": self.sysid, "autopilot": "", "in_air": None, **report.as_dict(), "fixed": {}, "unfixed": ""}


def meant(
    expression: Expression, heard: Iterable[VehicleActor], configured: Iterable[VehicleConfig]
) -> list[VehicleActor | Unheard]:
    """By system id. Raises TargetError."""
    actors = list(heard)
    sysids = {actor.sysid for actor in actors}
    unheard = [Unheard(config) for config in configured if config.sysid not in sysids]
    return targets.select(expression, [*actors, *unheard])


async def examine_all(
    vehicles: Sequence[VehicleActor | Unheard],
    *,
    fix: bool = False,
    confirmed: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[str, Any]:
    """JSON-able, each by its name; see `Preflight.run`. ``confirmed``: by vehicle's name, then by parameter's."""
    slots = asyncio.Semaphore(AT_ONCE)

    async def one(vehicle: VehicleActor | Unheard) -> dict[str, Any]:
        if isinstance(vehicle, Unheard):
            return vehicle.result()
        agreed = None if confirmed is None else confirmed.get(vehicle.name, {})
        async with slots:
            return result(await vehicle.preflight.run(fix=fix, confirmed=agreed), vehicle.vehicle)

    async with asyncio.TaskGroup() as group:
        tasks = {v.name: group.create_task(one(v), name=f"preflight of {v.name}") for v in vehicles}
    return {name: task.result() for name, task in tasks.items()}
