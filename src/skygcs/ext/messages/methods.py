"""messages.send, and the extension that has it."""

from __future__ import annotations

import re
from typing import Any, cast

from pydantic import Field

from skygcs.core.mavlink.dialect import Dialect, FieldInfo, MessageInfo
from skygcs.ext.messages.message_sender import MessageSender
from skygcs.extension import Extension, NoTable
from skygcs.rpc import dispatch, error_codes
from skygcs.rpc.context import Context, JsonObject, Services
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.messages import find_message
from skygcs.rpc.models import MessageName, MethodParams, Targets
from skygcs.spelling import near_names

MAX_FIELDS = 255
"""No message has more fields: each takes a byte of its payload at least."""

MAX_VALUE_CHARS = 4096
"""Longest text in the place of a field's value: all entries of the largest bit mask have 3,000 characters."""


_INTEGER = re.compile(r"(u?)int(8|16|32|64)_t")


class SendParams(MethodParams):
    name: MessageName
    fields: dict[str, Any] = Field(
        default_factory=dict,
        max_length=MAX_FIELDS,
        description="Values by name; missing ones are 0, null is NaN.",
    )
    target: Targets | None = Field(
        None, description='Vehicles or components, each with its ids filled in; "all": everyone.'
    )
    link: str | None = Field(None, description="On this link only, to all that is there.")
    force: bool = Field(False, description="Send it without the checks of an order.")


def messages_send(context: Context, params: SendParams) -> JsonObject:
    """Send any message of the dialect, checked field by field.

    A message with a target field needs target, link or that field ("all" or 0: everyone); others go to everyone
    unless a target or link is given. Without force the outgoing gate decides (docs/reference/gate.md).
    """
    info = find_message(context.services.dialect, params.name, "name")
    fields = _checked_fields(context.services.dialect, info, params.fields)
    if params.target is not None and params.link is not None:
        raise InvalidParams(("link", "give target or link, not both: a target is sent to where it is heard"))
    field = next((f.name for f in info.fields if f.offset == info.target_system_offset), None)
    if field is not None and field not in fields and params.target is None and params.link is None:
        raise InvalidParams(
            ("target", f'{info.name} is addressed: give target ("all": everyone), link, or the field {field}')
        )
    sender = cast("MessageSending", context.services.extensions["messages.send"]).sender
    return sender.send(info.name, fields, params.target, params.link, force=params.force)


def _checked_fields(dialect: Dialect, info: MessageInfo, fields: JsonObject) -> JsonObject:
    """Fields as the dialect packs them. InvalidParams names every wrong one, not only the first."""
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
        if len(value) > field.array_length:
            raise ValueError(f"is {field.type}[{field.array_length}]: {len(value)} values do not fit in it")
        return [_number_value(dialect, field, v) for v in value]
    return _number_value(dialect, field, value)


def _number_value(dialect: Dialect, field: FieldInfo, value: object) -> object:
    if field.type in ("float", "double") and value is None:
        return float("nan")
    if isinstance(value, str) and len(value) > MAX_VALUE_CHARS:
        raise ValueError(f"is {field.type}; a text of {len(value)} characters is too long for any field")
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
        close = close or near_names(name, known, n=3)
        raise ValueError(error.args[0] + (f"; did you mean {', '.join(close)}?" if close else "")) from None


def _echo(value: object) -> str:
    return repr(value)[: dispatch.MAX_ECHO_CHARS]


_SEND = (error_codes.TARGET_ERROR, error_codes.REFUSED, error_codes.LINK_ERROR)


METHODS: tuple[Method[Context], ...] = (Method("messages.send", SendParams, messages_send, dict[str, Any], _SEND),)


class MessageSending(Extension[NoTable]):
    own_methods = METHODS

    def __init__(self, core: Services, config: NoTable) -> None:
        super().__init__(core, config)
        self.sender = MessageSender(core.hub, core.fleet, core.links, core.now)
