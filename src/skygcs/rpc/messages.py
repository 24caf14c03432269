"""The methods that name messages and commands of the dialect. `METHODS` is their part of the table."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.radio_link.stream_rates import LEAST_RATE_HZ, MAX_RATE_HZ, rate_problem
from skygcs.rpc import dispatch, error_codes
from skygcs.rpc.context import Context, JsonObject, command
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.models import (
    MessageName,
    NameOrId,
    NoParams,
    OrderTargets,
    Outcomes,
    Result,
    Target,
    TargetParams,
    TargetsParams,
)
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.spelling import near_names


def _rate_or_off(rate_hz: float) -> float:
    problem = rate_problem(rate_hz)
    if problem is not None:
        raise ValueError(problem)
    return rate_hz


class IntervalParams(TargetsParams):
    targets: OrderTargets
    message: MessageName
    rate_hz: Annotated[float, AfterValidator(_rate_or_off)] | None = Field(
        ge=0,
        le=MAX_RATE_HZ,
        description=f"Messages per second: 0 stops it, else {LEAST_RATE_HZ:g} to {MAX_RATE_HZ:g}; "
        "null is the autopilot's own rate.",
    )


class RequestParams(TargetsParams):
    targets: OrderTargets
    message: MessageName


class StreamParams(TargetsParams):
    targets: OrderTargets
    stream: NameOrId = Field(description='A MAV_DATA_STREAM by number or name, e.g. "POSITION".')
    rate_hz: float = Field(
        ge=0, le=MAX_RATE_HZ, description=f"Messages per second: 0 stops the stream, else 1 to {MAX_RATE_HZ:g}."
    )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if 0 < self.rate_hz < 1:
            raise ValueError(f"rate_hz must be 0 (off) or 1 to {MAX_RATE_HZ:g}, not {self.rate_hz:g}")
        return self


class CommandParams(TargetsParams):
    targets: OrderTargets
    command: NameOrId = Field(description='A MAV_CMD by number or name, as "DO_SET_SERVO".')
    params: list[float | None] = Field(
        default_factory=list, max_length=7, description="param1 to param7; null is NaN (unset), missing ones are 0."
    )
    int_frame: NameOrId | None = Field(None, description="Send COMMAND_INT with this MAV_FRAME, by name or number.")
    x: int | None = Field(None, description="Its x: latitude in 1e-7 degrees.")
    y: int | None = Field(None, description="Its y: longitude in 1e-7 degrees.")
    z: float | None = Field(None, description="Its z: altitude in metres.")
    force: bool = Field(False, description="Send it without the checks of an order.")

    @model_validator(mode="after")
    def _whole_place(self) -> Self:
        if (self.x is None) != (self.y is None):
            raise ValueError("give both x and y, or neither")
        if self.int_frame is None and (self.x is not None or self.z is not None):
            raise ValueError("x, y and z are for COMMAND_INT: give int_frame, too")
        return self


class LatestParams(TargetParams):
    target: Annotated[Target, Field(description='One vehicle, or one component: "7/191", "alpha/191".')]
    name: MessageName


class MessageReading(Result):
    """The last message of one name."""

    name: str
    sysid: int
    compid: int = Field(description="The component that sent it.")
    fields: dict[str, Any]
    age_s: float
    rate_hz: float
    count: int


class MessageType(Result):
    """One message of the dialect."""

    id: int
    name: str
    fields: list[dict[str, Any]] = Field(description="name, type, units, enum of each field.")


class CommandType(Result):
    """One MAV_CMD of the dialect."""

    id: int
    name: str = Field(description="Without MAV_CMD_.")


COMMAND_PREFIX = "MAV_CMD_"


async def vehicles_interval(context: Context, params: IntervalParams) -> JsonObject:
    """Request one message at a rate (SET_MESSAGE_INTERVAL)."""
    find_message(context.services.dialect, params.message, "message")
    return await command(context, params.targets, VehicleActor.set_message_interval, **params.arguments())


async def vehicles_request(context: Context, params: RequestParams) -> JsonObject:
    """Request one message once; when the outcome is ok, messages.latest has it."""
    find_message(context.services.dialect, params.message, "message")
    return await command(context, params.targets, VehicleActor.request_message, **params.arguments())


async def vehicles_stream(context: Context, params: StreamParams) -> JsonObject:
    """Request a group of messages at a rate (REQUEST_DATA_STREAM)."""
    _check_entry(context.services.dialect, "MAV_DATA_STREAM", params.stream, "stream")
    return await command(context, params.targets, VehicleActor.request_stream, **params.arguments())


async def vehicles_command(context: Context, params: CommandParams) -> JsonObject:
    """Send any MAV_CMD and wait for its acknowledgement.

    Without force the outgoing gate decides (docs/reference/gate.md).
    """
    _check_command(context.services.dialect, params.command)
    if params.int_frame is not None:
        _check_entry(context.services.dialect, "MAV_FRAME", params.int_frame, "int_frame")
    return await command(context, params.targets, VehicleActor.command, **params.arguments())


def messages_latest(context: Context, params: LatestParams) -> JsonObject | None:
    """The last message of one name from one vehicle, or null.

    The autopilot's, else the newest of its system's other components (compid).
    """
    info = find_message(context.services.dialect, params.name, "name")
    return context.services.fleet.latest(params.target, info.name)


def messages_list(context: Context, _: NoParams) -> list[JsonObject]:
    """Every message of the dialect with its fields, by id."""
    messages = context.services.dialect.messages
    return [_describe(messages[msgid]) for msgid in sorted(messages)]


def commands_list(context: Context, _: NoParams) -> list[JsonObject]:
    """Every MAV_CMD of the dialect, by number."""
    names = context.services.dialect.enums.get("MAV_CMD", {})
    return [{"id": number, "name": names[number].removeprefix(COMMAND_PREFIX)} for number in sorted(names)]


def find_message(dialect: Dialect, name: str | int, param: str) -> MessageInfo:
    """The message of that name or id. Raises InvalidParams for ``param``."""
    try:
        return dialect.find(name)
    except KeyError as error:
        text: str = error.args[0]
        raise InvalidParams((param, text if text.endswith("?") else f"{text}; messages.list lists them")) from None


def _check_command(dialect: Dialect, command: str | int) -> None:
    """Raises InvalidParams for an unknown name, once instead of for each vehicle; any number may be sent."""
    if isinstance(command, int) or command.isdigit():
        return
    known = [name.removeprefix(COMMAND_PREFIX) for name in dialect.enums.get("MAV_CMD", {}).values()]
    wanted = command.upper().removeprefix(COMMAND_PREFIX)
    if wanted in known:
        return
    words = [word for word in wanted.split("_") if len(word) > 2]
    near = near_names(wanted, known, n=5)
    near += sorted((n for n in known if any(w in n for w in words)), key=lambda n: -sum(w in n for w in words))
    hint = f"; did you mean {', '.join(list(dict.fromkeys(near))[:5])}?" if near else ""
    text = f"dialect {dialect.name} has no command {command[: dispatch.MAX_ECHO_CHARS]!r}{hint}"
    raise InvalidParams(
        ("command", f"{text} commands.list lists them" if near else f"{text}; commands.list lists them")
    )


def _check_entry(dialect: Dialect, enum: str, given: str | int, param: str) -> None:
    """Raises InvalidParams for a name that is no entry of ``enum``, with or without its prefix; any number is right."""
    if isinstance(given, int) or given.isdigit():
        return
    known = [name.removeprefix(f"{enum}_") for name in dialect.enums.get(enum, {}).values()]
    if given.upper().removeprefix(f"{enum}_") not in known:
        echo = given[: dispatch.MAX_ECHO_CHARS]
        raise InvalidParams((param, f"{enum} has no entry {echo!r}; it has: {', '.join(known)}"))


def _describe(info: MessageInfo) -> JsonObject:
    fields = []
    for f in info.fields:
        kind = f"{f.type}[{f.array_length}]" if f.array_length else f.type
        fields.append({"name": f.name, "type": kind, "units": f.units, "enum": f.enum})
    return {"id": info.msgid, "name": info.name, "fields": fields}


_TARGET = (error_codes.TARGET_ERROR,)

ORDERS: tuple[Method[Context], ...] = (
    Method("vehicles.interval", IntervalParams, vehicles_interval, Outcomes, _TARGET),
    Method("vehicles.request", RequestParams, vehicles_request, Outcomes, _TARGET),
    Method("vehicles.stream", StreamParams, vehicles_stream, Outcomes, _TARGET),
    Method("vehicles.command", CommandParams, vehicles_command, Outcomes, _TARGET),
)

METHODS: tuple[Method[Context], ...] = (
    Method("messages.latest", LatestParams, messages_latest, MessageReading | None, _TARGET, while_stopping=True),
    Method("messages.list", NoParams, messages_list, list[MessageType]),
    Method("commands.list", NoParams, commands_list, list[CommandType]),
)
