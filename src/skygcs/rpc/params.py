"""The methods of parameters: `METHODS` is their part of the table."""

from __future__ import annotations

import asyncio
import math
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from skygcs.core.mavlink.param_encoding import NAME_CHARS, is_name
from skygcs.core.protocols.parameter_list import BYTES_PER_S
from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import Method
from skygcs.rpc.ports import JsonObject, Vehicle

MAX_NAMES = 2000
"""In one request: more than any autopilot has."""

AT_ONCE = 8
"""Parameters of one vehicle asked for at the same time: 8 x 45 B are 65 ms of 57600 baud."""

MAX_WITH_VALUES = 40
"""Vehicles whose values fit into one answer: each takes some 100 kB, and a client's unread output is bounded."""


def _name(text: str) -> str:
    if not is_name(text):
        raise ValueError(f"a parameter's name has letters, digits and _, at most {NAME_CHARS}")
    return text


Name = Annotated[str, AfterValidator(_name)]


class ParamGetParams(m.TargetsParams):
    names: list[Name] = Field(min_length=1, max_length=MAX_NAMES, description="Names of parameters.")


class ParamSetParams(m.TargetsParams):
    params: dict[Name, float] = Field(
        min_length=1, max_length=MAX_NAMES, description="Values by name; set in this order, each read back."
    )
    settle: bool = Field(
        True,
        description="Read what was changed once more half a second after the last: a PX4 changes some parameters "
        "itself after it took them. Their outcome is changed then.",
    )


class ParamListParams(m.TargetsParams):
    refresh: bool = Field(False, description="Read all, although the vehicle vouches for what is known.")
    burst: bool = Field(
        False, description="Have the vehicle send all at once, then fill gaps: quicker, but it drowns a shared radio."
    )
    bytes_per_s: float | None = Field(
        BYTES_PER_S,
        ge=100,
        le=1e8,
        description="What answers may take of the link, per vehicle; null: as fast as it goes.",
    )
    values: bool = Field(True, description="Whether the answer has the values, or only how it went.")


class ParamOutcome(m.Result):
    """How getting or setting one parameter ended."""

    ok: bool
    result: str = Field(
        description="accepted, denied (the vehicle kept its value), changed (it took another one), unknown, timeout, "
        "cancelled, lost or refused (by skygcs)."
    )
    message: str
    name: str = Field(description="The vehicle's own name for it; another one than asked for in two generations.")
    value: float | None = Field(description="What the vehicle says it holds; null: it did not say, or no number.")
    type: str | None = Field(description="MAV_PARAM_TYPE: REAL32, INT32, …")
    before: float | None
    attempts: int
    elapsed_s: float


class ParamOutcomes(m.Result):
    outcomes: dict[str, dict[str, ParamOutcome]] = Field(description="By vehicle's name, then by name asked for.")


class ParamEntry(m.Result):
    name: str
    value: float | None = Field(description="null: no finite number.")
    type: str


class ParamsOfVehicle(m.Result):
    """All parameters of one vehicle."""

    ok: bool
    result: str = Field(description="accepted, incomplete, timeout, changing, cancelled, lost or refused.")
    message: str
    source: str = Field(description='"vehicle", or "cache": nothing was transferred but what vouches for it.')
    vouched: str = Field(
        description='How sure it is: "read" (and changes since were heard), "hash" (over all values), or "count": only '
        "their number and the firmware are what they were in an earlier run (ArduPilot)."
    )
    count: int | None
    sent: int = Field(description="Messages it took.")
    elapsed_s: float
    sysid: int
    compid: int
    autopilot: str
    params: list[ParamEntry] | None = Field(description="In the vehicle's order; null unless values were asked for.")


class ParamLists(m.Result):
    lists: dict[str, ParamsOfVehicle] = Field(description="By vehicle's name.")


class ParamStatus(m.Result):
    """What is known of a vehicle's parameters, and what is going on."""

    known: int
    complete: bool
    hash: int | None = Field(description="PX4's over all values, as far as the vehicle has vouched for what is known.")
    loading: dict[str, Any] | None = Field(description="received, count, percent, elapsed_s, remaining_s of a list.")
    under_way: int = Field(description="Requests that are not answered yet.")


async def params_get(context: Context, params: ParamGetParams) -> JsonObject:
    """Read parameters by name."""

    async def read(vehicle: Vehicle) -> JsonObject:
        slots = asyncio.Semaphore(AT_ONCE)

        async def one(name: str) -> JsonObject:
            async with slots:
                return (await vehicle.params.get(name)).as_dict()

        names = list(dict.fromkeys(params.names))
        return dict(zip(names, await asyncio.gather(*map(one, names)), strict=True))

    return {"outcomes": await _each(context, params, read)}


async def params_set(context: Context, params: ParamSetParams) -> JsonObject:
    """Set parameters one after another, each read back; every one has an outcome, also when it was cancelled."""
    values = {name: int(v) if v.is_integer() else v for name, v in params.params.items()}

    async def write(vehicle: Vehicle) -> JsonObject:
        told = await vehicle.params.set(values, settle=params.settle)
        return {name: outcome.as_dict() for name, outcome in told.items()}

    return {"outcomes": await _each(context, params, write)}


async def params_list(context: Context, params: ParamListParams) -> JsonObject:
    """All parameters; one vehicle after another, so that they do not share a radio. Progress comes as events "params".

    What was read before is not read again while the vehicle vouches for it: PX4 by a hash over all values, ArduPilot
    only by its firmware and their number.
    """
    lists = {}
    vehicles = context.daemon.fleet.resolve(params.targets)
    if params.values and len(vehicles) > MAX_WITH_VALUES:
        text = (
            f"{len(vehicles)} vehicles' values are too much for one answer; ask for at most {MAX_WITH_VALUES} at once"
        )
        raise dispatch.InvalidParams(("targets", text))
    for vehicle in vehicles:
        lists[vehicle.name] = await _list(context, vehicle, params)
    return {"lists": lists}


async def _list(context: Context, vehicle: Vehicle, params: ParamListParams) -> JsonObject:
    loaded = await vehicle.params.load(refresh=params.refresh, burst=params.burst, bytes_per_s=params.bytes_per_s)
    entries = [
        {"name": p.name, "value": p.value if math.isfinite(p.value) else None, "type": p.type.name}
        for p in (loaded.params if params.values else ())
    ]
    return {
        "ok": loaded.ok,
        "result": loaded.result,
        "message": loaded.message,
        "source": loaded.source,
        "vouched": loaded.vouched,
        "count": loaded.count,
        "sent": loaded.sent,
        "elapsed_s": round(loaded.elapsed_s, 3),
        "sysid": vehicle.sysid,
        "compid": vehicle.compid,
        "autopilot": vehicle.state(context.daemon.now())["autopilot"],
        "params": entries if params.values else None,
    }


def params_status(context: Context, params: m.TargetsParams) -> JsonObject:
    """What is known of vehicles' parameters without asking them, and how far a list is."""
    return {v.name: v.params.status() for v in context.daemon.fleet.resolve(params.targets)}


def params_cancel(context: Context, params: m.TargetsParams) -> JsonObject:
    """Stop reading and setting parameters; what a vehicle has taken already it keeps.

    The answer is how many requests were under way, by vehicle.
    """
    return {v.name: v.params.cancel() for v in context.daemon.fleet.resolve(params.targets)}


async def _each(context: Context, params: m.TargetsParams, work: Any) -> JsonObject:
    """The same for all vehicles at once."""
    vehicles = context.daemon.fleet.resolve(params.targets)
    async with asyncio.TaskGroup() as group:
        tasks = {v.name: group.create_task(work(v), name=f"parameters of {v.name}") for v in vehicles}
    return {name: task.result() for name, task in tasks.items()}


_ORDER = (dispatch.TARGET_ERROR,)

METHODS: tuple[Method[Context], ...] = (
    Method("params.get", ParamGetParams, params_get, ParamOutcomes, _ORDER),
    Method("params.set", ParamSetParams, params_set, ParamOutcomes, _ORDER),
    Method("params.list", ParamListParams, params_list, ParamLists, _ORDER),
    Method("params.status", m.TargetsParams, params_status, dict[str, ParamStatus], _ORDER),
    Method("params.cancel", m.TargetsParams, params_cancel, dict[str, int], _ORDER),
)
