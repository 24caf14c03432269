"""Parameters and results that several groups of methods share: the checks, `rpc.discover` and the docs come from them.

Parameters are strict (no "5" for 5), frozen and refuse unknown names. Results are described for clients; they are not
validated when they are sent.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, WithJsonSchema, model_validator

from skygcs.core.mavlink.param_encoding import NAME_CHARS, is_name
from skygcs.core.radio_link.stream_rates import LEAST_RATE_HZ, MAX_RATE_HZ
from skygcs.core.vehicle.targets import size_problem

MAX_TELEMETRY_HZ = 20.0
"""Telemetry goes out on a 50 ms grid; autopilots send position at 4 to 10 Hz, over a radio slower still."""


MAX_TEXT_CHARS = 1000
"""Longest text in a request, unless its own bound is another: names, kinds, addresses, paths. The daemon repeats it in
outcomes and events, which it keeps."""

MAX_NAME_CHARS = 256
"""Longest name of a message or a command."""

_RANGE = re.compile(r"([0-9]{1,3})\s*-\s*([0-9]{1,3})")


def _targets(value: Any) -> str | list[str]:
    items = value if isinstance(value, list) else [value]
    if (problem := size_problem(items)) is not None:
        raise ValueError(problem)
    if not items or not all(isinstance(i, str | int) and not isinstance(i, bool) and str(i).strip() for i in items):
        raise ValueError('give a system id, a name, a group, "1,3", "2-5", "all", or a list of these')
    for part in ",".join(map(str, items)).split(","):
        ends = _RANGE.fullmatch(part.strip())
        if ends is not None and int(ends[1]) > int(ends[2]):
            raise ValueError(f"range {part.strip()!r} runs backwards; did you mean {ends[2]}-{ends[1]}?")
    return [str(i) for i in items] if isinstance(value, list) else str(value)


def _target(value: Any) -> str:
    if (problem := size_problem([value])) is not None:
        raise ValueError(problem)
    if isinstance(value, bool) or not isinstance(value, str | int) or not str(value).strip():
        raise ValueError("give one vehicle: its system id or its name")
    return str(value)


def _name_or_id(value: Any) -> str | int:
    if isinstance(value, bool) or not isinstance(value, str | int) or value == "":
        raise ValueError("give a name or a number")
    if isinstance(value, str) and len(value) > MAX_NAME_CHARS:
        raise ValueError(f"has {len(value)} characters; a name has at most {MAX_NAME_CHARS}")
    return value


_SCALAR = [{"type": "string"}, {"type": "integer"}]


Targets = Annotated[
    Any,
    PlainValidator(_targets),
    WithJsonSchema({"anyOf": [*_SCALAR, {"type": "array", "items": {"anyOf": _SCALAR}, "minItems": 1}]}),
    Field(description='Vehicles: system id, name, group, "1,3", "2-5", "all", or a list of these.'),
]


Target = Annotated[
    Any,
    PlainValidator(_target),
    WithJsonSchema({"anyOf": _SCALAR}),
    Field(description="One vehicle: its system id or its name."),
]


OrderTargets = Annotated[Targets, Field(description='Vehicles, or components: "7/191", "alpha/191", "all/100".')]


NameOrId = Annotated[Any, PlainValidator(_name_or_id), WithJsonSchema({"anyOf": _SCALAR})]


MessageName = Annotated[NameOrId, Field(description="By name (any case) or id.")]


Lat = Annotated[float, Field(ge=-90, le=90, description="Latitude (WGS84).")]


Lon = Annotated[float, Field(ge=-180, le=180, description="Longitude (WGS84).")]


Enu = Annotated[
    list[float],
    Field(min_length=3, max_length=3, description="[x, y, up] in metres from the fleet's origin (east, north, up)."),
]


class MethodParams(BaseModel):
    # deferred: a hundred validators, of which a start needs none and a session a few
    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        str_max_length=MAX_TEXT_CHARS,
        defer_build=True,
    )


class NoParams(MethodParams):
    """No parameters."""


class ListParams(MethodParams):
    targets: Targets = "all"


class TargetParams(MethodParams):
    target: Target


class TargetsParams(MethodParams):
    targets: Targets

    def arguments(self) -> dict[str, Any]:
        """The arguments of an order to the targets."""
        return self.model_dump(exclude={"targets"})


class SubscribeParams(MethodParams):
    topic: Literal["telemetry", "events", "messages", "plan"] = Field(
        description='Their notifications are "telemetry", "event", "message", "plan".'
    )
    targets: Annotated[
        Targets, Field(description='Vehicles; for messages and events also components: "7/191", "all/100".')
    ] = "all"
    rate_hz: float | None = Field(
        None,
        ge=LEAST_RATE_HZ,
        le=MAX_RATE_HZ,
        description="telemetry, plan in flight: Hz, default 2, at most 20. messages: at most so many Hz per name "
        "and source; null: all.",
    )
    names: Annotated[list[NameOrId], Field(min_length=1, max_length=64)] | None = Field(
        None,
        description="telemetry: groups of the state. events: kinds. messages: names or ids. null: all.",
    )

    @model_validator(mode="after")
    def _rate(self) -> Self:
        if self.topic in ("telemetry", "plan") and self.rate_hz is not None and self.rate_hz > MAX_TELEMETRY_HZ:
            raise ValueError(f"{self.topic} has at most {MAX_TELEMETRY_HZ:g} updates a second")
        if self.topic == "events" and self.rate_hz is not None:
            raise ValueError("events have no rate_hz: each event is sent")
        return self


class Result(BaseModel):
    """Base of described results; more keys may come with later versions."""

    model_config = ConfigDict(extra="allow", defer_build=True)


class OutcomeResult(Result):
    """Outcome of one order on one vehicle."""

    ok: bool
    result: Literal[
        "accepted",
        "temporarily_rejected",
        "denied",
        "unsupported",
        "failed",
        "in_progress",
        "cancelled",
        "timeout",
        "refused",
        "lost",
    ] = Field(description="The autopilot's answer in words; refused: by skygcs itself; lost: the vehicle went silent.")
    message: str = Field(description="One line for a person.")
    attempts: int = Field(description="Transmissions of the most repeated step; with wait_s, of all tries together.")
    elapsed_s: float
    status_texts: list[str] = Field(description="Status texts of the vehicle while the order ran.")
    order_number: int | None = Field(
        None,
        description="Of an order that moves the vehicle and was sent: its number, for vehicles.hold; else left out. "
        "Numbers of another run of skygcs name no order.",
    )
    taken: bool = Field(
        False,
        description="true: a setpoint was refused as the vehicle follows another client, or an order, instead; else "
        "left out.",
    )


class Outcomes(Result):
    outcomes: dict[str, OutcomeResult] = Field(description="By vehicle name.")


def _param_name(text: str) -> str:
    if not is_name(text):
        raise ValueError(f"a parameter's name has letters, digits and _, at most {NAME_CHARS}")
    return text


ParamName = Annotated[str, AfterValidator(_param_name)]


class ParamResult(Result):
    """How getting or setting one parameter ended."""

    ok: bool
    result: str = Field(
        description="accepted, denied (the vehicle kept its value), changed (it took another one), unknown, timeout, "
        "cancelled, lost or refused (by skygcs)."
    )
    message: str
    name: str = Field(description="The vehicle's own name for it; another one than asked for in two generations.")
    value: float | None = Field(description="The value that the vehicle reports; null: none reported, or no number.")
    type: str | None = Field(description="MAV_PARAM_TYPE: REAL32, INT32, …")
    before: float | None
    attempts: int
    elapsed_s: float
