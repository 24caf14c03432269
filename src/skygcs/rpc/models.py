"""Parameters and results of every method: the one place from which checks, `rpc.discover` and the docs come.

Parameters are strict (no "5" for 5), frozen and refuse unknown names. Results are described here for clients; they are
not validated when they are sent.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator, WithJsonSchema, model_validator

from skygcs.core.radio_link.stream_rates import LEAST_RATE_HZ, MAX_RATE_HZ, rate_problem

MAX_TELEMETRY_HZ = 20.0
"""Telemetry goes out on a 50 ms grid; autopilots send position at 4 to 10 Hz, over a radio slower still."""


_RANGE = re.compile(r"([0-9]{1,3})\s*-\s*([0-9]{1,3})")


def _targets(value: Any) -> str | list[str]:
    items = value if isinstance(value, list) else [value]
    if not items or not all(isinstance(i, str | int) and not isinstance(i, bool) and str(i).strip() for i in items):
        raise ValueError('give a system id, a name, a group, "1,3", "2-5", "all", or a list of these')
    for part in ",".join(map(str, items)).split(","):
        ends = _RANGE.fullmatch(part.strip())
        if ends is not None and int(ends[1]) > int(ends[2]):
            raise ValueError(f"range {part.strip()!r} runs backwards; did you mean {ends[2]}-{ends[1]}?")
    return [str(i) for i in items] if isinstance(value, list) else str(value)


def _target(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int) or not str(value).strip():
        raise ValueError("give one vehicle: its system id or its name")
    return str(value)


def _name_or_id(value: Any) -> str | int:
    if isinstance(value, bool) or not isinstance(value, str | int) or value == "":
        raise ValueError("give a name or a number")
    return value


def _rate_or_off(rate_hz: float) -> float:
    problem = rate_problem(rate_hz)
    if problem is not None:
        raise ValueError(problem)
    return rate_hz


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
MessageName = Annotated[NameOrId, Field(description="A message of the dialect, by name (any case) or id.")]
Lat = Annotated[float, Field(ge=-90, le=90, description="Latitude in degrees (WGS84).")]
Lon = Annotated[float, Field(ge=-180, le=180, description="Longitude in degrees (WGS84).")]
Enu = Annotated[
    list[float],
    Field(min_length=3, max_length=3, description="[x, y, up] in metres from the fleet's origin (east, north, up)."),
]
LinkName = Annotated[str, Field(min_length=1, max_length=64, description="The link's name.")]


def _new_link_name(name: str) -> str:
    if not re.fullmatch(r"[\w.:-]+", name, re.ASCII):
        raise ValueError("a link's name is made of letters, digits, _ - . and :")
    return name


class Params(BaseModel):
    # deferred: a hundred validators, of which a start needs none and a session a few
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


class NoParams(Params):
    """No parameters."""


class ListParams(Params):
    targets: Targets = "all"


class TargetParams(Params):
    target: Target


class TargetsParams(Params):
    targets: Targets


class ArmParams(TargetsParams):
    force: bool = Field(
        False,
        description="Arm although the autopilot's checks fail (magic number 21196), or a required preflight is not "
        "passed.",
    )
    wait_s: float = Field(
        0.0, ge=0, le=600, description="Keep trying this long while the autopilot is not ready to arm yet."
    )


class DisarmParams(TargetsParams):
    force: bool = Field(False, description="Disarm in flight as well: the vehicle falls.")
    confirm: str | None = Field(
        None,
        max_length=100,
        description='Only while two vehicles send with one system id, and both would get it: "disarm-" and the number '
        'of vehicles, as "disarm-2"; without it the refusal names their links and the word.',
    )


class ModeParams(TargetsParams):
    mode: str = Field(min_length=1, description='Flight mode by name, e.g. "AUTO.LOITER" (PX4), "GUIDED" (ArduCopter).')


class TakeoffParams(TargetsParams):
    height_m: float | None = Field(
        None, gt=0, le=500, description="Metres above the ground it stands on; null: the fleet file's."
    )
    arm: bool = Field(True, description="Arm first if it is not armed.")
    wait_s: float = Field(
        0.0, ge=0, le=600, description="Keep trying this long while the autopilot is not ready to fly yet."
    )
    force: bool = Field(
        False, description="Although preflight is required and not passed; the autopilot's own checks remain."
    )


class StopParams(TargetsParams):
    action: Literal["hold", "land", "kill"] = Field(
        "hold", description="hold where it is, land there, or kill: stop the motors, and what flies falls."
    )
    confirm: str | None = Field(
        None,
        max_length=100,
        description='kill only: "kill-" and the number of vehicles it is for, as "kill-3"; without it the refusal names'
        " them and the word. Two vehicles that send with one system id count twice.",
    )


class GotoParams(TargetsParams):
    lat_deg: Lat | None = None
    lon_deg: Lon | None = None
    height_m: float | None = Field(None, description="Metres above home; null: as high as it is now.")
    enu_m: Enu | None = None
    yaw_deg: float | None = Field(None, description="Heading, clockwise from north; null: the autopilot's choice.")
    force: bool = Field(False, description="Go although it is farther than the configured limit.")
    same_place: bool = Field(
        False, description="Several vehicles: all to the very point, instead of keeping their places to each other."
    )

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        geodetic = self.lat_deg is not None or self.lon_deg is not None
        if self.enu_m is not None and (geodetic or self.height_m is not None):
            raise ValueError("give either enu_m, or lat_deg, lon_deg and height_m, not both")
        if self.enu_m is None and (self.lat_deg is None or self.lon_deg is None):
            raise ValueError("give lat_deg and lon_deg, or enu_m")
        return self


class RebootParams(TargetsParams):
    force: bool = Field(False, description="Reboot although it is armed.")


class ForgetParams(TargetsParams):
    force: bool = Field(False, description="Although it is heard, or was lost armed in the last half hour.")


class RenumberParams(TargetParams):
    sysid: int = Field(ge=1, le=250, description="The new system id; 251 to 255 are ground stations'.")
    force: bool = Field(False, description="Although the fleet file gives it to a vehicle that is not heard.")


class SetHomeParams(TargetsParams):
    lat_deg: Lat | None = None
    lon_deg: Lon | None = None
    alt_amsl_m: float | None = Field(
        None, description="Altitude above mean sea level in metres; null: that of the home it has."
    )
    force: bool = Field(False, description="Also in the air, and farther away than the configured limit.")

    @model_validator(mode="after")
    def _place_or_none(self) -> Self:
        given = [self.lat_deg is not None, self.lon_deg is not None]
        if not all(given) and (any(given) or self.alt_amsl_m is not None):
            raise ValueError("give lat_deg and lon_deg, or nothing (home is where it stands)")
        return self


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
    command: NameOrId = Field(description='A MAV_CMD by number or name, e.g. "MAV_CMD_DO_SET_SERVO" or "DO_SET_SERVO".')
    params: list[float | None] = Field(
        default_factory=list, max_length=7, description="param1 to param7; null is NaN (unset), missing ones are 0."
    )
    int_frame: NameOrId | None = Field(None, description="Send COMMAND_INT with this MAV_FRAME, by name or number.")
    x: int | None = Field(None, description="COMMAND_INT's x as on the wire (latitude in 1e-7 degrees).")
    y: int | None = Field(None, description="COMMAND_INT's y as on the wire (longitude in 1e-7 degrees).")
    z: float | None = Field(None, description="COMMAND_INT's z (altitude in metres).")
    force: bool = Field(
        False, description="Although it would fly a vehicle or stop its motors past the checks of an order."
    )

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


class SendParams(Params):
    name: MessageName
    fields: dict[str, Any] = Field(
        default_factory=dict, description="Field values by name; missing fields are 0, null is NaN."
    )
    target: Targets | None = Field(
        None, description='Vehicles or components to send it to, each with its ids filled in; "all": everyone.'
    )
    link: str | None = Field(None, description="Send on this link only, to all that is there.")
    force: bool = Field(
        False, description="Although it would fly a vehicle or stop its motors past the checks of an order."
    )


class LinkParams(Params):
    name: LinkName
    link: dict[str, Any] = Field(description="The link's table as in the fleet file, with its type.")


class LinkAddParams(LinkParams):
    name: Annotated[LinkName, AfterValidator(_new_link_name)]


class LinkNameParams(Params):
    name: LinkName


class RecentParams(Params):
    limit: int = Field(100, ge=1, le=10000, description="At most so many, the newest ones.")


class SubscribeParams(Params):
    topic: Literal["telemetry", "events", "messages"] = Field(
        description='The notifications are called "telemetry", "event", "message": one of them each time.'
    )
    targets: Annotated[
        Targets, Field(description='Vehicles; for messages and events also components: "7/191", "all/100".')
    ] = "all"
    rate_hz: float | None = Field(
        None,
        ge=LEAST_RATE_HZ,
        le=MAX_RATE_HZ,
        description="telemetry: updates per second and vehicle, default 2, at most 20. "
        "messages: at most so many per second of each name and source; null: every one.",
    )
    names: Annotated[list[NameOrId], Field(min_length=1, max_length=64)] | None = Field(
        None,
        description="telemetry: sections of the state. events: kinds. messages: names or ids. null: all of them.",
    )

    @model_validator(mode="after")
    def _rate(self) -> Self:
        if self.topic == "telemetry" and self.rate_hz is not None and self.rate_hz > MAX_TELEMETRY_HZ:
            raise ValueError(f"telemetry has at most {MAX_TELEMETRY_HZ:g} updates a second")
        if self.topic == "events" and self.rate_hz is not None:
            raise ValueError("events have no rate_hz: every one is sent")
        return self


class UnsubscribeParams(Params):
    subscription: int = Field(description="What `subscribe` answered.")


class Result(BaseModel):
    """Base of described results; more keys may come with later versions."""

    model_config = ConfigDict(extra="allow", defer_build=True)


class Outcome(Result):
    """What became of one order on one vehicle."""

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


class Outcomes(Result):
    outcomes: dict[str, Outcome] = Field(description="By vehicle name.")


Part = dict[str, Any] | None
"""A section of the state; null until a message has told of it. ``age_s`` is the time since then."""


class StatusText(Result):
    severity: str
    level: int
    text: str
    compid: int = Field(description="Which component of the system said it.")
    age_s: float


class Component(Result):
    """One component of a system."""

    compid: int
    name: str | None = Field(description="What its id is meant for (MAV_COMPONENT), as ONBOARD_COMPUTER.")
    type: str | None = Field(description="What its heartbeat says it is (MAV_TYPE); null: it has sent none.")
    autopilot: bool = Field(description="It is a vehicle's autopilot, with a state of its own.")
    age_s: float = Field(description="Since its newest message.")
    messages: int = Field(description="How many were heard of it.")


class SystemComponent(Component):
    """One component, and whose."""

    sysid: int
    vehicle: str | None = Field(description="The vehicle to whose system it belongs; null: no autopilot was heard.")


class VehicleState(Result):
    """Everything known of one vehicle. null where unknown; every section has age_s. SI units, degrees, ENU."""

    name: str
    sysid: int
    compid: int
    autopilot: str
    type: str | None
    firmware: str | None
    groups: list[str]
    gcs_sysid: int | None = Field(description="Whose heartbeats its failsafe watches, once that parameter was read.")
    connected: bool
    duplicate_sysid: bool = Field(description="Two vehicles speak under this id: all that is told is a mixture.")
    replayed: bool = Field(description="It is heard in a recording only: orders to it are refused.")
    last_heartbeat_age_s: float | None
    uptime_s: float | None
    clock_offset_s: float | None
    armed: bool | None
    mode: str | None
    system_status: str | None
    landed: str | None
    failsafe: bool | None
    control: dict[str, Any] | None = Field(
        description="How skygcs flies it by setpoints, as control.status tells; null: it does not."
    )
    uplink: Part = Field(
        None,
        description="heard (whether it answers what we ask), unanswered (questions since), rtt_s; age_s is the time "
        "since it last did; null: not known",
    )
    gps: Part = Field(description="fix, fix_type, satellites, hdop, vdop, lat_deg, lon_deg, alt_amsl_m, time_usec")
    position: Part = Field(
        description="lat_deg, lon_deg, alt_amsl_m, alt_rel_m, heading_deg, vel_enu_mps (true east, north, up), "
        "time_boot_s; takeoff_alt_amsl_m and alt_takeoff_m (the ground it took off from and the height above it; null "
        "if nobody saw it stand there); in the fleet's frame: enu_m, vel_world_mps, yaw_world_deg, origin_generation"
    )
    local: Part = Field(description="The autopilot's own frame, turned to ENU: pos_enu_m, vel_enu_mps, time_boot_s")
    attitude: Part = Field(
        description="roll_deg, pitch_deg, yaw_deg (clockwise from north), rates_dps, quaternion (w, x, y, z)"
    )
    battery: Part = Field(description="volts, amps, percent, consumed_mah, temperature_degc, remaining_s")
    home: Part = Field(description="The autopilot's home: lat_deg, lon_deg, alt_amsl_m")
    ekf_origin: Part = Field(description="The autopilot's local origin: lat_deg, lon_deg, alt_amsl_m")
    estimator: Part = Field(description="flags, ok (good enough to navigate by), names, ratios, accuracy_m")
    sensors: Part = Field(description="present, enabled, health, unhealthy: lists of names; load_percent")
    vfr: Part = Field(description="airspeed_mps, groundspeed_mps, heading_deg, throttle_percent, alt_m, climb_mps")
    rc: Part = Field(description="channels, rssi")
    imu: Part = Field(description="accel_mps2, gyro_radps, mag_gauss, pressure_hpa, temperature_degc")
    servos: Part = Field(description="pwm_us")
    mission: Part = Field(description="seq, count, last_ack (of the last transfer)")
    target_global: Part = Field(description="Where the autopilot says it goes: lat_deg, lon_deg, alt_m and more")
    target_local: Part = Field(description="The same in its local frame: pos_enu_m, vel_enu_mps, yaw_deg")
    target_attitude: Part = Field(description="quaternion, thrust, type_mask")
    time: Part = Field(description="unix_s, boot_s")
    high_latency: Part = Field(description="HIGH_LATENCY2: position, battery, failures in one message")
    last_ack: Part = Field(description="The last COMMAND_ACK")
    status_texts: list[StatusText]
    components: list[Component] = Field(description="All that was heard of its system, its autopilot among them.")
    messages: dict[str, Any] = Field(description="By message name: rate_hz, age_s, count.")
    links: dict[str, Any] = Field(
        description="By link: frames, bytes, lost, loss_ratio, frames_per_s, bytes_per_s, age_s."
    )


class Subscription(Result):
    subscription: int = Field(description="Comes with every notification; needed to unsubscribe.")


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


class Event(Result):
    time_unix_s: float
    kind: str
    vehicle: str | None
    sysid: int | None
    text: str
    data: dict[str, Any]
