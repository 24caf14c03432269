"""The methods of parameters, and the extension that has them: it is made when one of them is first called."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

from pydantic import Field

from skygcs.core.mavlink.param_encoding import Param, Value, value_text
from skygcs.core.params.metadata import ParamMetadata
from skygcs.core.protocols.parameter import ParamOutcome
from skygcs.core.protocols.parameter_list import BYTES_PER_S
from skygcs.extension import Extension, NoTable
from skygcs.rpc import dispatch, error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Encoded, Method
from skygcs.rpc.models import ParamName, ParamResult, Result, TargetsParams
from skygcs.rpc.replies import encode
from skygcs.runtime.param_metadata import VehicleMetadata
from skygcs.runtime.task_set import OneATurn
from skygcs.runtime.vehicle_actor import VehicleActor

MAX_NAMES = 2000
"""In one request: more than any autopilot has."""


AT_ONCE = 8
"""Parameters of one vehicle asked for at the same time: 8 x 45 B are 65 ms of 57600 baud."""


MAX_WITH_VALUES = 40
"""Vehicles whose values fit into one answer: each takes some 100 kB, and a client's unread output is bounded."""


PARAMS_AT_ONCE = 50
"""Encoded between two looks at the clock: .1 ms."""


class ParamGetParams(TargetsParams):
    names: list[ParamName] = Field(min_length=1, max_length=MAX_NAMES, description="Names of parameters.")


class ParamSetParams(TargetsParams):
    params: dict[ParamName, float] = Field(
        min_length=1, max_length=MAX_NAMES, description="Values by name; set in this order, each read back."
    )
    settle: bool = Field(
        True,
        description="Read changed values again half a second later: a PX4 changes some.",
    )
    force: bool = Field(
        False,
        description="Values outside their range; in flight also gains, limits and unknown parameters, but nothing"
        " that the flight was certified with.",
    )


class ParamMetadataParams(TargetsParams):
    names: list[ParamName] = Field(min_length=1, max_length=MAX_NAMES, description="Names of parameters.")
    read: bool = Field(
        False,
        description="Read the vehicle's file (some 70 kB) over a slow link, too.",
    )


class ParamListParams(TargetsParams):
    refresh: bool = Field(False, description="Read all, although the vehicle confirms what is known.")
    burst: bool = Field(
        False,
        description="All at once, then gaps are filled: quicker, but it saturates a shared radio.",
    )
    bytes_per_s: float | None = Field(
        BYTES_PER_S,
        ge=100,
        le=1e8,
        description="Bandwidth for the answers, per vehicle; null: no limit.",
    )
    values: bool = Field(True, description="The answer has the values, not only the outcome.")


class ParamResults(Result):
    outcomes: dict[str, dict[str, ParamResult]] = Field(description="By vehicle's name, then by name asked for.")


class ParamDescription(Result):
    """Metadata of one parameter."""

    unit: str
    least: float | None = Field(description="Of its range; null: no bound is named.")
    greatest: float | None
    range: str = Field(description="The range as text, with the unit; empty without one.")
    reboot: bool = Field(description="A change takes effect after a reboot.")
    values: dict[str, str] = Field(description="Meanings by value.")
    bits: dict[str, str] = Field(description="Meanings of the bits of a mask, by index.")
    description: str


class ParamMetadataOfVehicle(Result):
    own: bool = Field(description="It is the vehicle's own; else it is what skygcs ships for its firmware.")
    source: str = Field(description="Where the metadata come from; empty: there are none for this firmware.")
    why_not_own: str = Field(description="Why the vehicle's own file is not used; empty if it is.")
    parameters: dict[str, ParamDescription] = Field(description="By name; a parameter without metadata is missing.")


class ParamMetadataResults(Result):
    vehicles: dict[str, ParamMetadataOfVehicle] = Field(description="By vehicle's name.")


class ParamEntry(Result):
    name: str
    value: float | None = Field(description="null: no finite number.")
    type: str


class ParamsOfVehicle(Result):
    """All parameters of one vehicle."""

    ok: bool
    result: str = Field(description="accepted, incomplete, timeout, changing, cancelled, lost or refused.")
    message: str
    source: str = Field(description='"vehicle", or "cache": nothing was transferred but the proof that it is current.')
    vouched: str = Field(
        description='How it was confirmed: "read" (and later changes were heard), "hash" (over all values) or "count": '
        "only their number and the firmware are those of an earlier run (ArduPilot)."
    )
    count: int | None
    sent: int = Field(description="Messages it took.")
    elapsed_s: float
    sysid: int
    compid: int
    autopilot: str
    params: list[ParamEntry] | None = Field(description="In the vehicle's order; null unless values were asked for.")


class ParamListResults(Result):
    lists: dict[str, ParamsOfVehicle] = Field(description="By vehicle's name.")


class ParamLoading(Result):
    """A list that is on its way."""

    received: int
    count: int | None
    percent: int | None
    elapsed_s: float
    remaining_s: float | None


class ParamStatus(Result):
    """State of a vehicle's parameters: what is known, and what is in progress."""

    known: int
    complete: bool
    hash: int | None = Field(description="PX4's hash over all values, if the vehicle has confirmed what is known.")
    loading: ParamLoading | None
    in_progress: int = Field(description="Requests that are not answered yet.")


async def params_get(context: Context, params: ParamGetParams) -> JsonObject:
    """Read parameters by name."""

    async def read(vehicle: VehicleActor) -> JsonObject:
        slots = asyncio.Semaphore(AT_ONCE)

        async def one(name: str) -> JsonObject:
            async with slots:
                return (await vehicle.params.get(name)).as_dict()

        names = list(dict.fromkeys(params.names))
        return dict(zip(names, await asyncio.gather(*map(one, names)), strict=True))

    return {"outcomes": await _each(context, params, read)}


async def params_set(context: Context, params: ParamSetParams) -> JsonObject:
    """Set parameters one after another; each has an outcome, also when it was cancelled."""
    values: dict[str, Value] = {name: int(v) if v.is_integer() else v for name, v in params.params.items()}

    async def write(vehicle: VehicleActor) -> JsonObject:
        metadata = vehicle.part(VehicleMetadata)
        refused = {} if params.force else metadata.refusals(values)
        sent = {name: value for name, value in values.items() if name not in refused}
        outcomes = {name: ParamOutcome(False, "refused", why, name) for name, why in refused.items()}
        if sent:
            outcomes |= await vehicle.params.set(sent, settle=params.settle, force=params.force)
        notes = metadata.notes(sent)
        for name, outcome in outcomes.items():
            if outcome.ok and name in notes and outcome.param != outcome.before:
                outcomes[name] = replace(outcome, message=f"{outcome.message}; {notes[name]}")
        return {name: outcomes[name].as_dict() for name in values}

    return {"outcomes": await _each(context, params, write)}


async def params_metadata(context: Context, params: ParamMetadataParams) -> JsonObject:
    """Unit, range, meanings and description of parameters.

    From the vehicle's own file where it has one (PX4), else from the tables that skygcs ships.
    """

    async def look_up(vehicle: VehicleActor) -> JsonObject:
        metadata = vehicle.part(VehicleMetadata)
        source = await metadata.read(insist=params.read)
        known = metadata.of(params.names)
        return source | {"parameters": {name: _description(entry) for name, entry in known.items()}}

    return {"vehicles": await _each(context, params, look_up)}


def _description(known: ParamMetadata) -> JsonObject:
    """Convert to `ParamDescription`."""
    return {
        "unit": known.unit,
        "least": known.least,
        "greatest": known.greatest,
        "range": known.range_text(),
        "reboot": known.reboot,
        "values": {value_text(value): text for value, text in known.values.items()},
        "bits": {str(bit): text for bit, text in known.bits.items()},
        "description": known.description,
    }


async def params_list(context: Context, params: ParamListParams) -> Encoded:
    """All parameters, one vehicle after another. Progress comes as events "params".

    Known values are not read again if the vehicle confirms them: PX4 by a hash over all, ArduPilot by firmware and
    number. A request meanwhile gets the same list.
    """
    vehicles = context.services.fleet.resolve(params.targets)
    if params.values and len(vehicles) > MAX_WITH_VALUES:
        text = (
            f"{len(vehicles)} vehicles' values are too much for one answer; ask for at most {MAX_WITH_VALUES} at once"
        )
        raise dispatch.InvalidParams(("targets", text))
    lists = [encode(vehicle.name) + b":" + await _list(context, vehicle, params) for vehicle in vehicles]
    return Encoded(b'{"lists":{' + b",".join(lists) + b"}}")


async def _list(context: Context, vehicle: VehicleActor, params: ParamListParams) -> bytes:
    """The answer for one vehicle, as `ParamsOfVehicle`."""
    loaded = await vehicle.params.load(refresh=params.refresh, burst=params.burst, bytes_per_s=params.bytes_per_s)
    entries = b"null"
    if params.values:
        entries = await context.slices.encoded_list(map(_entry, loaded.params), PARAMS_AT_ONCE)
    head = {
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
        "autopilot": vehicle.state(context.services.now(), frozenset({"autopilot"}))["autopilot"],
    }
    return encode(head)[:-1] + b',"params":' + entries + b"}"


def _entry(param: Param) -> JsonObject:
    return {"name": param.name, "value": param.value, "type": param.type.name}


def params_status(context: Context, params: TargetsParams) -> JsonObject:
    """Parameters that are known, and the progress of a list."""
    return {v.name: v.params.status() for v in context.services.fleet.resolve(params.targets)}


def params_cancel(context: Context, params: TargetsParams) -> JsonObject:
    """Stop reading and setting parameters; what was taken stays. Result: pending requests by vehicle."""
    return {v.name: v.params.cancel() for v in context.services.fleet.resolve(params.targets)}


async def _each(
    context: Context, params: TargetsParams, work: Callable[[VehicleActor], Coroutine[Any, Any, JsonObject]]
) -> JsonObject:
    """The same for all vehicles at once; each one's outcomes are reported when all of them are there."""
    turn = OneATurn()
    vehicles = context.services.fleet.resolve(params.targets)
    reports = context.reports

    async def reported(vehicle: VehicleActor) -> JsonObject:
        await turn.wait()
        outcomes = await work(vehicle)
        if reports is not None:
            reports.ended_with(vehicle.name, outcomes)
        return outcomes

    if reports is not None:
        reports.begun(v.name for v in vehicles)
    async with asyncio.TaskGroup() as group:
        tasks = {v.name: group.create_task(reported(v), name=f"parameters of {v.name}") for v in vehicles}
    return {name: task.result() for name, task in tasks.items()}


_TARGET = (error_codes.TARGET_ERROR,)


METHODS: tuple[Method[Context], ...] = (
    Method("params.get", ParamGetParams, params_get, ParamResults, _TARGET),
    Method("params.set", ParamSetParams, params_set, ParamResults, _TARGET),
    Method("params.metadata", ParamMetadataParams, params_metadata, ParamMetadataResults, _TARGET),
    Method("params.list", ParamListParams, params_list, ParamListResults, _TARGET),
    Method("params.status", TargetsParams, params_status, dict[str, ParamStatus], _TARGET),
    Method("params.cancel", TargetsParams, params_cancel, dict[str, int], _TARGET),
)


class Params(Extension[NoTable]):
    own_methods = METHODS
