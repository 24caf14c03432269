"""Every method of the socket: one function each, and one table of them all at the end.

A function's docstring is the method's description in `rpc.discover` and docs/reference/rpc.md.
"""

from __future__ import annotations

import difflib
import functools
import re
from itertools import islice
from typing import Any

from skygcs.core.mavlink.dialect import Dialect, FieldInfo, MessageInfo
from skygcs.rpc import (
    air,
    control,
    corrections,
    dispatch,
    fence,
    missions,
    openrpc,
    origin,
    params,
    preflight,
    signing,
    undo,
)
from skygcs.rpc import models as m
from skygcs.rpc.context import Context, one_vehicle, order, outcomes
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.ports import JsonObject, resolve, state_of
from skygcs.rpc.subscriptions import find_message
from skygcs.runtime.vehicle_actor import VehicleActor

COMMAND_PREFIX = "MAV_CMD_"
_INTEGER = re.compile(r"(u?)int(8|16|32|64)_t")


def daemon_info(context: Context, _: m.NoParams) -> JsonObject:
    """Version, process id, uptime, own MAVLink ids, dialect, fleet file."""
    return context.daemon.info()


def vehicles_list(context: Context, params: m.ListParams) -> list[JsonObject]:
    """The state of some or all vehicles, by system id."""
    daemon = context.daemon
    return [state_of(daemon, vehicle) for vehicle in resolve(daemon, params.targets)]


def vehicles_get(context: Context, params: m.TargetParams) -> JsonObject:
    """The state of one vehicle."""
    return state_of(context.daemon, one_vehicle(context.daemon, params.target))


async def vehicles_arm(context: Context, params: m.ArmParams) -> JsonObject:
    """Arm."""
    return await order(context, VehicleActor.arm, params)


async def vehicles_disarm(context: Context, params: m.DisarmParams) -> JsonObject:
    """Disarm; in flight only with force."""
    return await order(context, VehicleActor.disarm, params)


async def vehicles_mode(context: Context, params: m.ModeParams) -> JsonObject:
    """Set the flight mode by the autopilot's own name for it."""
    return await outcomes(context, params.targets, VehicleActor.set_mode, name=params.mode)


async def vehicles_takeoff(context: Context, params: m.TakeoffParams) -> JsonObject:
    """Take off to a height above the ground it stands on."""
    return await order(context, VehicleActor.takeoff, params)


async def vehicles_land(context: Context, params: m.TargetsParams) -> JsonObject:
    """Land where it is."""
    return await order(context, VehicleActor.land, params)


async def vehicles_rtl(context: Context, params: m.TargetsParams) -> JsonObject:
    """Return to launch and land there."""
    return await order(context, VehicleActor.rtl, params)


async def vehicles_hold(context: Context, params: m.TargetsParams) -> JsonObject:
    """Stop and hold position."""
    return await order(context, VehicleActor.hold, params)


async def vehicles_stop(context: Context, params: m.StopParams) -> JsonObject:
    """Emergency stop: sent over every link and repeated for up to 30 s until the vehicle shows it or refuses it, also
    to vehicles that are lost."""
    return await order(context, VehicleActor.stop, params)


async def vehicles_goto(context: Context, params: m.GotoParams) -> JsonObject:
    """Fly to a place, given in degrees and height above home or in metres about the fleet's origin."""
    return await order(context, VehicleActor.goto, params)


async def vehicles_reboot(context: Context, params: m.RebootParams) -> JsonObject:
    """Reboot the autopilot; armed only with force."""
    return await order(context, VehicleActor.reboot, params)


def vehicles_forget(context: Context, params: m.ForgetParams) -> JsonObject:
    """Forget vehicles that are gone, so that "all" no longer means them. One that is heard again is met anew."""
    told = context.daemon.fleet.forget(params.targets, force=params.force)
    return {"outcomes": {name: outcome.as_dict() for name, outcome in told.items()}}


async def vehicles_renumber(context: Context, params: m.RenumberParams) -> JsonObject:
    """Give a vehicle another system id: set the parameter, restart it, find it under the new id, read it back there.

    Refused while it is not surely disarmed, and for an id that is taken. It keeps its name until the daemon ends.
    """
    told = await context.daemon.renumbering.run(params.target, params.sysid, force=params.force)
    return {"outcomes": {name: outcome.as_dict() for name, outcome in told.items()}}


async def vehicles_set_home(context: Context, params: m.SetHomeParams) -> JsonObject:
    """Set the autopilot's home: a place, or (without one) where it stands."""
    return await order(context, VehicleActor.set_home, params)


async def vehicles_interval(context: Context, params: m.IntervalParams) -> JsonObject:
    """Ask for one message at a rate (SET_MESSAGE_INTERVAL)."""
    find_message(context.daemon.dialect, params.message, "message")
    return await order(context, VehicleActor.set_message_interval, params)


async def vehicles_request(context: Context, params: m.RequestParams) -> JsonObject:
    """Ask for one message once; it is there (messages.latest) when the outcome is good."""
    find_message(context.daemon.dialect, params.message, "message")
    return await order(context, VehicleActor.request_message, params)


async def vehicles_stream(context: Context, params: m.StreamParams) -> JsonObject:
    """Ask for a group of messages at a rate (REQUEST_DATA_STREAM)."""
    _check_entry(context.daemon.dialect, "MAV_DATA_STREAM", params.stream, "stream")
    return await order(context, VehicleActor.request_stream, params)


async def vehicles_command(context: Context, params: m.CommandParams) -> JsonObject:
    """Send any MAV_CMD and wait for its acknowledgement. What does the same as an order without its checks is refused
    for a vehicle that is not known to be disarmed, arming and motor tests for every vehicle, unless forced."""
    _check_command(context.daemon.dialect, params.command)
    if params.int_frame is not None:
        _check_entry(context.daemon.dialect, "MAV_FRAME", params.int_frame, "int_frame")
    return await order(context, VehicleActor.command, params)


def messages_latest(context: Context, params: m.LatestParams) -> JsonObject | None:
    """The last message of one name from one vehicle, or null if none came yet.

    For a vehicle: its autopilot's, or, if that has sent none, the newest one of its system's other components, which
    compid names. "7/191" or "alpha/191" is one component.
    """
    info = find_message(context.daemon.dialect, params.name, "name")
    return context.daemon.fleet.latest(params.target, info.name)


def messages_send(context: Context, params: m.SendParams) -> JsonObject:
    """Send any message of the dialect, checked field by field.

    A message with a target field (COMMAND_LONG, MANUAL_CONTROL, …) needs target, link or that field; "all", or 0 in the
    field, is everyone. Others go to everyone unless told otherwise. Setpoints, and whatever else does what an order
    does without its checks, are refused for vehicles that are not known to be disarmed, unless forced.
    """
    info = find_message(context.daemon.dialect, params.name, "name")
    fields = _checked_fields(context.daemon.dialect, info, params.fields)
    if params.target is not None and params.link is not None:
        raise InvalidParams(("link", "give target or link, not both: a target is sent to where it is heard"))
    field = next((f.name for f in info.fields if f.offset == info.target_system_offset), None)
    if field is not None and field not in fields and params.target is None and params.link is None:
        raise InvalidParams(
            ("target", f'{info.name} is addressed: give target ("all": everyone), link, or the field {field}')
        )
    return context.daemon.send_message(info.name, fields, params.target, params.link, force=params.force)


def messages_list(context: Context, _: m.NoParams) -> list[JsonObject]:
    """Every message of the dialect with its fields, by id."""
    messages = context.daemon.dialect.messages
    return [_describe(messages[msgid]) for msgid in sorted(messages)]


def commands_list(context: Context, _: m.NoParams) -> list[JsonObject]:
    """Every MAV_CMD of the dialect, by number."""
    names = context.daemon.dialect.enums.get("MAV_CMD", {})
    return [{"id": number, "name": names[number].removeprefix(COMMAND_PREFIX)} for number in sorted(names)]


def components_list(context: Context, _: m.NoParams) -> list[JsonObject]:
    """Every component that was heard, by system: autopilots, companions, cameras, gimbals, ground stations.

    Also those of systems without a vehicle. At most 32 of a system are kept and 1024 in all.
    """
    return context.daemon.fleet.components_status()


def links_list(context: Context, _: m.NoParams) -> list[JsonObject]:
    """Every link: its kind, state, vehicles if it is bound to some, channels, and counters per channel and source."""
    return context.daemon.links_status()


async def links_add(context: Context, params: m.LinkAddParams) -> list[JsonObject]:
    """Add a link at run time (until the daemon ends; the fleet file is not changed)."""
    await context.daemon.add_link(params.name, params.link)
    return context.daemon.links_status()


async def links_change(context: Context, params: m.LinkParams) -> list[JsonObject]:
    """Close a link and open it again with a new configuration."""
    await context.daemon.change_link(params.name, params.link)
    return context.daemon.links_status()


async def links_remove(context: Context, params: m.LinkNameParams) -> list[JsonObject]:
    """Close a link and forget it."""
    await context.daemon.remove_link(params.name)
    return context.daemon.links_status()


def router_stats(context: Context, _: m.NoParams) -> JsonObject:
    """Routes, and counters of what was forwarded, filtered and dropped."""
    return context.daemon.router_stats()


def events_recent(context: Context, params: m.RecentParams) -> list[JsonObject]:
    """The newest events, oldest of them first."""
    events = context.daemon.events
    return [dict(e) for e in islice(events, max(0, len(events) - params.limit), None)]


def recorder_status(context: Context, _: m.NoParams) -> JsonObject:
    """What is recorded where, and what could not be."""
    return context.daemon.recorder_status()


def subscribe(context: Context, params: m.SubscribeParams) -> JsonObject:
    """Be told from now on, by notifications: "telemetry", "event" or "message".

    Each carries the subscription's number and a state, an event or a message. A client that reads slowly gets fewer,
    fresher telemetry updates; events and messages that did not fit are counted in "dropped".
    """
    return {"subscription": context.subscribe(params)}


def unsubscribe(context: Context, params: m.UnsubscribeParams) -> JsonObject:
    """End a subscription of this connection."""
    context.unsubscribe(params.subscription)
    return {"subscription": params.subscription}


def rpc_discover(context: Context, _: m.NoParams) -> JsonObject:
    """This interface as an OpenRPC document."""
    return _document()


@functools.cache
def _document() -> JsonObject:
    """Made once, on the first question: it takes 15 ms."""
    return openrpc.document(METHODS.values())


def _check_command(dialect: Dialect, command: str | int) -> None:
    """Raises InvalidParams for a name that is none, once instead of for each vehicle; any number may be sent."""
    if isinstance(command, int) or command.isdigit():
        return
    known = [name.removeprefix(COMMAND_PREFIX) for name in dialect.enums.get("MAV_CMD", {}).values()]
    wanted = command.upper().removeprefix(COMMAND_PREFIX)
    if wanted in known:
        return
    words = [word for word in wanted.split("_") if len(word) > 2]
    near = difflib.get_close_matches(wanted[: dispatch.MAX_ECHO_CHARS], known, n=5)
    near += sorted((n for n in known if any(w in n for w in words)), key=lambda n: -sum(w in n for w in words))
    hint = f"; did you mean {', '.join(list(dict.fromkeys(near))[:5])}?" if near else ""
    text = f"dialect {dialect.name} has no command {command[: dispatch.MAX_ECHO_CHARS]!r}{hint}"
    raise InvalidParams(
        ("command", f"{text} commands.list lists them" if near else f"{text}; commands.list lists them")
    )


def _check_entry(dialect: Dialect, enum: str, given: str | int, param: str) -> None:
    """Raises InvalidParams for a name that is no entry of ``enum``, with or without its prefix; any number may be."""
    if isinstance(given, int) or given.isdigit():
        return
    known = [name.removeprefix(f"{enum}_") for name in dialect.enums.get(enum, {}).values()]
    if given.upper().removeprefix(f"{enum}_") not in known:
        echo = given[: dispatch.MAX_ECHO_CHARS]
        raise InvalidParams((param, f"{enum} has no entry {echo!r}; it has: {', '.join(known)}"))


def _checked_fields(dialect: Dialect, info: MessageInfo, fields: JsonObject) -> JsonObject:
    """Fields as the dialect packs them; every wrong one is told, not only the first."""
    by_name = {f.name: f for f in info.fields}
    problems: list[tuple[str, str]] = []
    result: JsonObject = {}
    for name, value in fields.items():
        field = by_name.get(name)
        try:
            result[name] = value if field is None else _field_value(dialect, field, value)
            info.pack({name: result[name]})
        except ValueError as error:
            problems.append((f"fields.{name}"[:100], str(error)))
    if problems:
        raise InvalidParams(*problems)
    return result


def _field_value(dialect: Dialect, field: FieldInfo, value: object) -> object:
    """JSON's null as NaN, digits as text where the field is text, enum entries ("A" or "A|B") by their value."""
    if field.array_length and field.type != "char":
        if not isinstance(value, list):
            raise ValueError(f"is {field.type}[{field.array_length}]: give a list of numbers, not {_echo(value)}")
        return [_number_value(dialect, field, v) for v in value]
    return _number_value(dialect, field, value)


def _number_value(dialect: Dialect, field: FieldInfo, value: object) -> object:
    if field.type in ("float", "double") and value is None:
        return float("nan")
    if field.type == "char":
        return str(value) if isinstance(value, int) and not isinstance(value, bool) else value
    if isinstance(value, str) and field.enum:
        return sum(_entry(dialect, field.enum, part.strip()) for part in set(value.split("|")))
    if isinstance(value, str):
        raise ValueError(f"is {field.type}, not {_echo(value)}")
    if isinstance(value, int) and (match := _INTEGER.fullmatch(field.type)) is not None:
        bits = int(match[2])
        least, most = (0, 2**bits - 1) if match[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        if not least <= value <= most:
            raise ValueError(f"is {field.type}: {least} to {most}, not {_echo(value)}")
    return value


def _entry(dialect: Dialect, enum: str, name: str) -> int:
    """The value of an enum's entry. Raises ValueError that names close ones: a name often lacks only its prefix."""
    try:
        return dialect.enum_value(enum, name)
    except KeyError as error:
        known = list(dialect.enums.get(enum, {}).values())
        close = [entry for entry in known if entry.endswith(f"_{name.upper()}")]
        close = close or difflib.get_close_matches(name.upper()[: dispatch.MAX_ECHO_CHARS], known, n=3)
        raise ValueError(error.args[0] + (f"; did you mean {', '.join(close)}?" if close else "")) from None


def _echo(value: object) -> str:
    return repr(value)[: dispatch.MAX_ECHO_CHARS]


def _describe(info: MessageInfo) -> JsonObject:
    fields = []
    for f in info.fields:
        kind = f"{f.type}[{f.array_length}]" if f.array_length else f.type
        fields.append({"name": f.name, "type": kind, "units": f.units, "enum": f.enum})
    return {"id": info.msgid, "name": info.name, "fields": fields}


_ORDER = (dispatch.TARGET_ERROR,)
_STOP = (*_ORDER, dispatch.REFUSED)
_LINK = (dispatch.LINK_ERROR, dispatch.REFUSED)

METHODS: dict[str, Method[Context]] = {
    method.name: method
    for method in (
        Method("daemon.info", m.NoParams, daemon_info),
        Method("vehicles.list", m.ListParams, vehicles_list, list[m.VehicleState], _ORDER),
        Method("vehicles.get", m.TargetParams, vehicles_get, m.VehicleState, _ORDER),
        Method("vehicles.arm", m.ArmParams, vehicles_arm, m.Outcomes, _ORDER),
        Method("vehicles.disarm", m.DisarmParams, vehicles_disarm, m.Outcomes, _ORDER, outlives_client=True),
        Method("vehicles.mode", m.ModeParams, vehicles_mode, m.Outcomes, _ORDER),
        Method("vehicles.takeoff", m.TakeoffParams, vehicles_takeoff, m.Outcomes, _ORDER),
        Method("vehicles.land", m.TargetsParams, vehicles_land, m.Outcomes, _ORDER, outlives_client=True),
        Method("vehicles.rtl", m.TargetsParams, vehicles_rtl, m.Outcomes, _ORDER, outlives_client=True),
        Method("vehicles.hold", m.TargetsParams, vehicles_hold, m.Outcomes, _ORDER, outlives_client=True),
        Method("vehicles.stop", m.StopParams, vehicles_stop, m.Outcomes, _STOP, outlives_client=True),
        Method("vehicles.goto", m.GotoParams, vehicles_goto, m.Outcomes, _ORDER),
        Method("vehicles.reboot", m.RebootParams, vehicles_reboot, m.Outcomes, _ORDER),
        Method("vehicles.forget", m.ForgetParams, vehicles_forget, m.Outcomes, _ORDER),
        Method("vehicles.renumber", m.RenumberParams, vehicles_renumber, m.Outcomes, _ORDER, outlives_client=True),
        Method("vehicles.set_home", m.SetHomeParams, vehicles_set_home, m.Outcomes, _ORDER),
        Method("vehicles.interval", m.IntervalParams, vehicles_interval, m.Outcomes, _ORDER),
        Method("vehicles.request", m.RequestParams, vehicles_request, m.Outcomes, _ORDER),
        Method("vehicles.stream", m.StreamParams, vehicles_stream, m.Outcomes, _ORDER),
        Method("vehicles.command", m.CommandParams, vehicles_command, m.Outcomes, _ORDER),
        Method("components.list", m.NoParams, components_list, list[m.SystemComponent]),
        Method("messages.latest", m.LatestParams, messages_latest, m.MessageReading | None, _ORDER),
        Method(
            "messages.send",
            m.SendParams,
            messages_send,
            dict[str, Any],
            (*_ORDER, dispatch.REFUSED, dispatch.LINK_ERROR),
        ),
        Method("messages.list", m.NoParams, messages_list, list[m.MessageType]),
        Method("commands.list", m.NoParams, commands_list, list[m.CommandType]),
        Method("links.list", m.NoParams, links_list, list[dict[str, Any]]),
        Method("links.add", m.LinkAddParams, links_add, list[dict[str, Any]], _LINK),
        Method("links.change", m.LinkParams, links_change, list[dict[str, Any]], _LINK),
        Method("links.remove", m.LinkNameParams, links_remove, list[dict[str, Any]], _LINK),
        Method("router.stats", m.NoParams, router_stats),
        Method("events.recent", m.RecentParams, events_recent, list[m.Event]),
        Method("recorder.status", m.NoParams, recorder_status),
        Method("subscribe", m.SubscribeParams, subscribe, m.Subscription, (*_ORDER, dispatch.LIMIT_EXCEEDED)),
        Method("unsubscribe", m.UnsubscribeParams, unsubscribe, m.Subscription),
        *origin.METHODS,
        *params.METHODS,
        *control.METHODS,
        *missions.METHODS,
        *air.METHODS,
        *corrections.METHODS,
        *fence.METHODS,
        *signing.METHODS,
        *preflight.METHODS,
        *undo.METHODS,
        Method("rpc.discover", m.NoParams, rpc_discover),
    )
}
"""By name, in the order in which they are documented."""
