"""The fleet file as data: frozen, unknown keys refused. How it is read is `loader`."""

from __future__ import annotations

import ipaddress
import json
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args

from pydantic import (
    AfterValidator,
    Field,
    GetCoreSchemaHandler,
    SerializeAsAny,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticKnownError, core_schema

from skygcs.config.control import ControlSettings
from skygcs.config.radio import EmulatedRadio, Profile, RadioKeys, RateHz, Share
from skygcs.config.signing import SigningSettings
from skygcs.config.tables import Model
from skygcs.config.vehicle_tables import MonitorConfig, PreflightSettings, SeparationSettings
from skygcs.core.geo import EAST_DEG, NOWHERE, is_nowhere
from skygcs.core.mavlink.heartbeat import DEFAULT_LOST_S
from skygcs.core.radio_link.stream_rates import DEFAULT_RATES_HZ

Sysid = Annotated[int, Field(ge=1, le=255)]
Compid = Annotated[int, Field(ge=1, le=255)]
Port = Annotated[int, Field(ge=0, le=65535)]
Role = Literal["peer", "gcs", "vehicle", "radio"]
Autopilot = Literal["px4", "ardupilot"]
Baud = Annotated[int, Field(ge=50, le=20_000_000)]
SourceId = Annotated[int, Field(ge=0, le=255)]
BytesPerS = Annotated[float, Field(ge=1, le=1e9)]
TimeoutS = Annotated[float, Field(ge=0.1, le=86400)]
Percent = Annotated[float, Field(ge=0, le=100)]


def _network(text: str) -> str:
    """The network in its usual spelling. Raises ValueError in a person's words."""
    try:
        return str(ipaddress.ip_network(text))
    except ValueError:
        pass
    try:
        near = ipaddress.ip_network(text, strict=False)
    except ValueError:
        raise ValueError(f'"{text}" is not a network: write 10.0.0.0/24, fd00::/8, or one address') from None
    raise ValueError(f"{text} is an address within a network; did you mean {near}, or {text.partition('/')[0]} alone?")


Networks = Annotated[tuple[Annotated[str, AfterValidator(_network)], ...], Field(min_length=1)]
"""IPv4 and IPv6 networks, or single addresses."""
MessageName = str | int
"""A message of the dialect, by name or id."""


LEAST_SPEED, MAX_SPEED = 0.01, 1000.0
"""Speed of a replay, times as fast as recorded. Slower, the longest pause would take over 17 minutes; faster is 0: as
fast as possible."""


def speed_problem(speed: float) -> str | None:
    """Why a speed of a replay is not allowed; None: it is."""
    if speed == 0 or LEAST_SPEED <= speed <= MAX_SPEED:
        return None
    return f"must be 0 (as fast as possible) or {LEAST_SPEED:g} to {MAX_SPEED:g}, not {speed:g}"


def _speed(speed: float) -> float:
    if (problem := speed_problem(speed)) is not None:
        raise ValueError(problem)
    return speed


OWN_SYSID = 255
"""ArduPilot counts only heartbeats of MAV_GCS_SYSID (default 255) for its GCS failsafe."""

OWN_COMPID = 25
"""MAV_COMP_ID_USER1: 190 (QGC, Mission Planner), 230 (MAVProxy), 240 (mavlink-server) and 0 (pymavlink) are taken."""


class DaemonConfig(Model):
    """[daemon]: our MAVLink ids, sockets, logs and limits."""

    sysid: Sysid = OWN_SYSID
    compid: Compid = OWN_COMPID
    heartbeat: bool = True
    """Send a GCS heartbeat at 1 Hz on every link (a radio needs it to report RADIO_STATUS)."""
    socket: Path | None = None
    """JSON-RPC Unix socket; default: $XDG_RUNTIME_DIR/skygcs.sock, else /tmp/skygcs-UID/skygcs.sock."""
    tcp_port: Port | None = None
    """JSON-RPC on 127.0.0.1 as well; needs ``token_file``."""
    token_file: Path | None = None
    log_dir: Path = Path("logs")
    """tlogs go here; relative to the fleet file."""
    keep_vehicles: bool = True
    """Keep the state of vehicles and take orders for them; without, a router and nothing else."""
    record: bool = True
    record_max_mb: Annotated[float, Field(ge=0.01, le=1e6)] = 100.0
    """A new tlog is begun at this size ..."""
    record_max_minutes: Annotated[float, Field(ge=0.01, le=1e6)] = 60.0
    """... or at this age."""
    vehicle_timeout_s: Annotated[float, Field(ge=1, le=3600)] = DEFAULT_LOST_S
    """Without a heartbeat for this long a vehicle is lost."""
    route_timeout_s: TimeoutS = 60.0
    goto_limit_m: Annotated[float, Field(gt=0)] = 1000.0
    """A goto farther than this from the vehicle is refused."""
    operator_timeout_s: Annotated[float, Field(ge=2, le=3600)] | None = None
    """When for so long no ground station's heartbeat and no client's request came, vehicles flown by setpoints ..."""
    operator_lost: Literal["hold", "land", "rtl"] = "hold"
    """... get this order. Default: never."""
    require_preflight: bool = False
    """Arm and take off only vehicles that have passed preflight since they started ..."""
    preflight_valid_minutes: Annotated[float, Field(gt=0, le=1440)] = 30.0
    """... and not longer ago than this."""
    bad_crc: Literal["drop", "pass"] = "drop"
    """Treatment of a known message with a wrong CRC from a source that was verified before."""


class RateLimits(Model):
    """Upper rates of what is forwarded *to* a link. Per source: ten vehicles keep ten times the rate."""

    messages: dict[str, RateHz] = Field(default_factory=dict)
    """Hz per message name or id ("ATTITUDE" = 2.0); 0 stops it; "*" for all not named."""
    bytes_per_s: BytesPerS | None = None
    """Upper rate of broadcast traffic to each channel of this link; targeted frames and heartbeats always pass."""


class LinkCommon(Model):
    """Keys of every link. The twelve filter keys are mavlink-router's, in lower case."""

    name: str = ""
    """Set from the table's name."""
    enabled: bool = True
    role: Role = "peer"
    group: str | None = None
    """Links of one group are parallel links to the same systems: nothing is forwarded between them."""
    cost: Annotated[int, Field(ge=0, le=1000)] | None = None
    """The link of lower cost is used where two good ones lead to a vehicle; default: 10, for a radio, serial port or
    XBee 20."""
    forward_unknown: bool | None = None
    """Send frames of unknown id to this link; default: yes, but not to a radio."""
    allow_msg_id_in: tuple[MessageName, ...] = ()
    block_msg_id_in: tuple[MessageName, ...] = ()
    allow_msg_id_out: tuple[MessageName, ...] = ()
    block_msg_id_out: tuple[MessageName, ...] = ()
    allow_src_sys_in: tuple[SourceId, ...] = ()
    block_src_sys_in: tuple[SourceId, ...] = ()
    allow_src_sys_out: tuple[SourceId, ...] = ()
    block_src_sys_out: tuple[SourceId, ...] = ()
    allow_src_comp_in: tuple[SourceId, ...] = ()
    block_src_comp_in: tuple[SourceId, ...] = ()
    allow_src_comp_out: tuple[SourceId, ...] = ()
    block_src_comp_out: tuple[SourceId, ...] = ()
    rate_in: RateLimits = RateLimits()
    rate_out: RateLimits = RateLimits()
    signing: SigningSettings | None = None
    """Check the signature of what comes and sign what is ours."""
    vehicles: tuple[str | int, ...] = ()
    """Names or system ids of the only vehicles that the program behind this link can see and address ("bound")."""
    translated_sysid: Sysid | None = None
    """The system id that its one vehicle has behind this link."""


class SerialLinkConfig(RadioKeys, LinkCommon):
    """A serial port: a radio, a telemetry cable, a pty."""

    type: Literal["serial"] = "serial"
    device: Annotated[str, Field(min_length=1)]
    baud: Baud | Annotated[tuple[Baud, ...], Field(min_length=1)] = 57600
    """One rate, or several to try in turn until frames come."""
    rtscts: bool = False
    low_latency: bool = True


XBeeAddress = Annotated[str, Field(pattern="^[0-9A-Fa-f]{16}$")]
"""64-bit address of an XBee module: SH and SL, the 16 digits on its label."""


class XBeeLinkConfig(LinkCommon):
    """One Digi XBee module in API mode at a serial port: every node of its network is a channel of its own."""

    type: Literal["xbee"] = "xbee"
    role: Role = "vehicle"
    """The role of all nodes; "vehicle": what one of them sends is not sent to the others."""
    device: Annotated[str, Field(min_length=1)]
    baud: Baud = 115200
    """The module's BD."""
    rtscts: bool = True
    """The module holds us up while its buffers are full (its D7 = 1, as it is delivered)."""
    api_mode: Literal[1, 2] = 2
    """The module's AP: 1 without, 2 with escaped bytes, which finds the next frame at once after bytes were lost."""
    rf_kbps: Annotated[float, Field(ge=1, le=1000)] = 200.0
    """The module's rate on air (its BR): the streams and setpoints that the network is to carry follow from it."""
    downlink_share: Share = 0.5
    """Share of the network's capacity that the planned streams of all vehicles may fill."""
    stream_profile: Profile = "custom"
    """Streams of every vehicle behind it if they fit; custom: its own ``streams``."""
    nodes: tuple[XBeeAddress, ...] = ()
    """The only nodes that count, by address; (): all of the network, ..."""
    max_nodes: Annotated[int, Field(ge=1, le=64)] = 32
    """... at most so many at a time."""
    node_timeout_s: TimeoutS = 60.0
    broadcast: bool = False
    """Send our heartbeat and corrections to all nodes at once instead of to one after the other."""


class UdpCommon(LinkCommon):
    """Keys of every UDP link."""

    whole_datagrams: bool = True
    """Frames that came in one datagram and all go here are sent in one, too; false: each in its own, for receivers that
    read only the first frame of a datagram (mavp2p 1.3)."""


class UdpServerLinkConfig(UdpCommon):
    """Listens; every peer that sends a good frame becomes a channel of its own."""

    type: Literal["udp_server"] = "udp_server"
    host: str = "0.0.0.0"
    port: Port
    peer_timeout_s: TimeoutS = 60.0
    max_peers: Annotated[int, Field(ge=1, le=4096)] = 256
    allow_from: Networks | None = None
    """Networks from which datagrams are taken; None: from everywhere."""


class UdpClientLinkConfig(UdpCommon):
    """Sends to one address (a QGroundControl on port 14550, for instance) and hears its answers."""

    type: Literal["udp_client"] = "udp_client"
    host: str
    port: Port
    local_port: Port = 0


class UdpBroadcastLinkConfig(UdpCommon):
    """Broadcasts until a peer answers, then sends to that one; broadcasts again after 5 s of silence."""

    type: Literal["udp_broadcast"] = "udp_broadcast"
    host: str = "255.255.255.255"
    port: Port
    local_port: Port = 0


class TcpServerLinkConfig(LinkCommon):
    type: Literal["tcp_server"] = "tcp_server"
    host: str = "127.0.0.1"
    port: Port
    max_clients: Annotated[int, Field(ge=1, le=1024)] = 32
    allow_from: Networks | None = None
    """Networks from which connections are taken; None: from everywhere."""


class TcpClientLinkConfig(LinkCommon):
    type: Literal["tcp_client"] = "tcp_client"
    host: str
    port: Port


class ReplayLinkConfig(LinkCommon):
    """A tlog or raw capture, played as if it came from a link. Ends when the file ends."""

    type: Literal["replay"] = "replay"
    file: Path
    speed: Annotated[float, AfterValidator(_speed)] = 1.0
    """1 = as recorded, 10 = ten times as fast (0.01 to 1000), 0 = as fast as possible."""
    loop: bool = False
    raw_bytes_per_s: BytesPerS = 5760.0
    """A raw capture has no times; it is played at this rate (57600 baud)."""


class MemoryLinkConfig(LinkCommon):
    """A link for tests: the other end is a Python object; a bad network on request."""

    type: Literal["memory"] = "memory"
    loss: Annotated[float, Field(ge=0, le=1)] = 0.0
    duplicate: Annotated[float, Field(ge=0, le=1)] = 0.0
    delay_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    jitter_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    split: bool = False
    """One byte at a time."""
    seed: int = 1


class SimulatedLinkConfig(RadioKeys, LinkCommon):
    """Simulated vehicles inside the daemon: no sockets, the same bytes."""

    type: Literal["simulated"] = "simulated"
    px4: Annotated[int, Field(ge=0, le=250)] = 0
    ardupilot: Annotated[int, Field(ge=0, le=250)] = 0
    px4_plane: Annotated[int, Field(ge=0, le=250)] = 0
    ardupilot_plane: Annotated[int, Field(ge=0, le=250)] = 0
    rover: Annotated[int, Field(ge=0, le=250)] = 0
    """How many vehicles of each kind: copters of both firmwares, planes of both, ArduPilot's rover, in this order."""
    first_sysid: Sysid = 1
    lat_deg: Annotated[float, Field(gt=-90, lt=90)] = 43.7806
    lon_deg: Annotated[float, Field(ge=-180, le=180)] = -79.4653
    alt_amsl_m: Annotated[float, Field(ge=-500, le=9000)] = 180.0
    seed: int = 1
    dynamics: Literal["rigid", "kinematic"] = "rigid"
    """Rigid bodies take attitude setpoints and feel the wind; kinematic ones are exact and cost two thirds."""
    airframe: Literal["f450", "ideal", "sih"] = "f450"
    attitude_lag_s: Annotated[float, Field(ge=0, le=2)] | None = None
    """None: the airframe's own, 0.15 s for the F450."""
    wind_mps: Annotated[float, Field(ge=0, le=30)] = 0.0
    wind_from_deg: Annotated[float, Field(ge=-360, le=360)] = 270.0
    gust_mps: Annotated[float, Field(ge=0, le=10)] = 0.0
    gps_noise_m: Annotated[float, Field(ge=0, le=10)] = 0.0
    attitude_noise_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    sensor_latency_s: Annotated[float, Field(ge=0, le=2)] = 0.0
    params: Path | None = None
    """A parameter file, taken in by the vehicles of its firmware when they are powered up."""
    radio: EmulatedRadio | None = None
    """Radios between the daemon and the vehicles; None: a wire without end. Paced while the role is "radio"."""

    @model_validator(mode="after")
    def _somewhere(self) -> SimulatedLinkConfig:
        if is_nowhere(self.lat_deg, self.lon_deg):
            raise ValueError(f"lat_deg and lon_deg: {NOWHERE}")
        return self

    @property
    def counts(self) -> dict[str, int]:
        """How many vehicles of each kind, in the order of their system ids."""
        kinds = ("px4", "ardupilot", "px4_plane", "ardupilot_plane", "rover")
        return {kind: getattr(self, kind) for kind in kinds}

    @property
    def vehicle_count(self) -> int:
        """How many there are."""
        return sum(self.counts.values())


LinkConfig = (
    SerialLinkConfig
    | XBeeLinkConfig
    | UdpServerLinkConfig
    | UdpClientLinkConfig
    | UdpBroadcastLinkConfig
    | TcpServerLinkConfig
    | TcpClientLinkConfig
    | ReplayLinkConfig
    | MemoryLinkConfig
    | SimulatedLinkConfig
)
LINK_TYPES: dict[str, type[LinkCommon]] = {model.model_fields["type"].default: model for model in get_args(LinkConfig)}
"""The model of each value of the key "type"."""


def validated_link(table: Any, info: ValidationInfo) -> LinkConfig:
    """One link by the model of its type; strict if it is JSON. Raises ValidationError, PydanticKnownError."""
    if isinstance(table, LinkCommon):
        return cast("LinkConfig", table)
    if not isinstance(table, dict):
        raise PydanticKnownError("model_type", {"class_name": "Link"})
    if "type" not in table:
        raise PydanticKnownError("union_tag_not_found", {"discriminator": "'type'"})
    model = LINK_TYPES.get(str(table["type"]))
    if model is None:
        tags = ", ".join(map(repr, LINK_TYPES))
        raise PydanticKnownError(
            "union_tag_invalid", {"discriminator": "'type'", "tag": str(table["type"]), "expected_tags": tags}
        )
    if info.mode == "json":
        return cast("LinkConfig", model.model_validate_json(json.dumps(table), strict=True))
    return cast("LinkConfig", model.model_validate(table))


class _ByType:
    """Has pydantic call `validated_link` instead of making the validators of all types together (1 MB, 15 ms): a model
    makes its own for its first link."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(validated_link)


AnyLink = Annotated[LinkConfig, _ByType()]


PLAIN_KEYS = (
    *("autopilot", "takeoff_height_m", "goto_limit_m", "streams", "require_preflight"),
    *("flight_time_min", "battery_reserve_percent"),
)
"""Keys of a vehicle of which the highest level counts as a whole."""


class VehicleSettings(Model):
    """Settings of [defaults] and [types.NAME]; None: not set at this level."""

    autopilot: Autopilot | None = None
    group: str | tuple[str, ...] | None = None
    takeoff_height_m: Annotated[float, Field(gt=0, le=500)] | None = None
    goto_limit_m: Annotated[float, Field(gt=0)] | None = None
    streams: dict[str, Annotated[RateHz, Field(le=400)]] | None = None
    """Hz per message to request from the vehicle if it does not send it by itself; {} requests nothing."""
    control: ControlSettings | None = None
    """Gains, limits, fence and guard of flight control; laid over the lower levels' key by key."""
    preflight: PreflightSettings | None = None
    """Expectations before a flight; laid over the lower levels' key by key."""
    require_preflight: bool | None = None
    """The same as in [daemon], for these vehicles."""
    separation: SeparationSettings | None = None
    """The space it needs and its priority; laid over the lower levels' key by key."""
    flight_time_min: Annotated[float, Field(gt=0, le=600)] | None = None
    """How long a full battery lasts in flight, for plans; what was measured in flight counts before it."""
    battery_reserve_percent: Annotated[float, Field(ge=0, le=90)] | None = None
    """Charge that a plan has to leave."""


class VehicleEntry(VehicleSettings):
    """[vehicles.NAME]"""

    sysid: Sysid
    type: str | None = None


class VehicleConfig(Model):
    """One vehicle after defaults < type < vehicle were laid over each other."""

    name: str
    sysid: Sysid
    groups: tuple[str, ...] = ()
    autopilot: Autopilot | None = None
    takeoff_height_m: float = 2.5
    """The take-off height of the UTIAS outdoor experiment."""
    goto_limit_m: float = 1000.0
    streams: dict[str, float] = Field(default_factory=lambda: dict(DEFAULT_RATES_HZ))
    control: ControlSettings = ControlSettings()
    control_planned: bool = False
    """True if any level has a control table: it is to be flown by setpoints."""
    preflight: PreflightSettings = PreflightSettings()
    require_preflight: bool = False
    separation: SeparationSettings = SeparationSettings()
    flight_time_min: float | None = None
    battery_reserve_percent: float | None = None
    named: bool = False
    """True if it is in the fleet file."""
    delegated: bool = False
    """True if other ground stations may command it, too."""


class AlarmsConfig(Model):
    """[alarms]: from when on a value is an alarm."""

    battery_low_percent: Percent = 25.0
    """A battery's charge from which it is a warning, in percent."""
    battery_critical_percent: Percent = 12.0
    """A battery's charge from which it is an alarm while the vehicle is armed, in percent."""

    @model_validator(mode="after")
    def _in_order(self) -> AlarmsConfig:
        if self.battery_critical_percent > self.battery_low_percent:
            raise ValueError(
                f"battery_critical_percent {self.battery_critical_percent:g} is above battery_low_percent "
                f"{self.battery_low_percent:g}"
            )
        return self


class OriginConfig(Model):
    """[origin]: the fleet's world frame. ENU positions are shown only when it is set here or at run time.

    The keys are the fields of `core.geo.Origin`.
    """

    lat_deg: Annotated[float, Field(ge=-90, le=90)]
    lon_deg: Annotated[float, Field(ge=-180, le=180)]
    alt_amsl_m: float
    x_heading_deg: Annotated[float, Field(ge=-360, le=360)] = EAST_DEG

    @model_validator(mode="after")
    def _somewhere(self) -> OriginConfig:
        if self.lat_deg == 0 or self.lon_deg == 0:
            raise ValueError("lat_deg and lon_deg: a coordinate of exactly 0 is most likely one never filled in")
        return self


NO_TABLES = frozenset({"extensions", "aboard", "delegated"})
"""Fields of `FleetConfig` that no file has: the loader and extensions fill them in."""


class FleetConfig(Model):
    """A whole fleet file."""

    daemon: DaemonConfig = DaemonConfig()
    monitor: MonitorConfig = MonitorConfig()
    alarms: AlarmsConfig = AlarmsConfig()
    dialect: str | tuple[str, ...] = ("ardupilotmega", "px4-extras")
    origin: OriginConfig | None = None
    links: dict[str, AnyLink] = Field(default_factory=dict)
    defaults: VehicleSettings = VehicleSettings()
    types: dict[str, VehicleSettings] = Field(default_factory=dict)
    vehicles: dict[str, VehicleEntry] = Field(default_factory=dict)
    extensions: dict[str, SerializeAsAny[Model]] = Field(default_factory=dict)
    """Tables of extensions, by their names (`config.extension_tables`)."""
    aboard: str | None = None
    """The vehicle on whose computer the daemon runs, under the system id of its autopilot; None: a ground station."""
    delegated: frozenset[str] = frozenset()
    """Names of vehicles that other ground stations may command, too."""

    @field_validator("links")
    @classmethod
    def _name_links(cls, links: dict[str, LinkConfig]) -> dict[str, LinkConfig]:
        return {name: link.model_copy(update={"name": name}) for name, link in links.items()}

    @model_validator(mode="after")
    def _tcp_needs_token(self) -> FleetConfig:
        if self.daemon.tcp_port is not None and self.daemon.token_file is None:
            raise ValueError("daemon.tcp_port needs daemon.token_file: anyone on this machine could fly the fleet")
        return self

    def vehicle_configs(self) -> tuple[VehicleConfig, ...]:
        """Every vehicle with defaults < type < vehicle applied."""
        named = {"named": True}
        return tuple(self._resolved(n, entry).model_copy(update=named) for n, entry in self.vehicles.items())

    def bound_sysids(self, link: LinkConfig) -> dict[str | int, int | None]:
        """The system id of each of the link's ``vehicles``; None: neither a name nor an id from 1 to 255."""
        return {vehicle: self._sysid_of(vehicle) for vehicle in link.vehicles}

    def _sysid_of(self, vehicle: str | int) -> int | None:
        entry = self.vehicles.get(vehicle) if isinstance(vehicle, str) else None
        if entry is not None:
            return entry.sysid
        digits = vehicle.removeprefix("v") if isinstance(vehicle, str) else str(vehicle)
        number = int(digits) if digits.isdecimal() and digits.isascii() else 0
        return number if 1 <= number <= 255 else None

    def default_vehicle(self, sysid: int) -> VehicleConfig:
        """Settings of a vehicle that is not in the file."""
        return self._resolved(f"v{sysid}", VehicleEntry(sysid=sysid))

    def _resolved(self, name: str, entry: VehicleEntry) -> VehicleConfig:
        layers = [self.defaults, self.types.get(entry.type or "", VehicleSettings()), entry]
        merged: dict[str, Any] = {
            "goto_limit_m": self.daemon.goto_limit_m,
            "require_preflight": self.daemon.require_preflight,
        }
        groups: list[str] = []
        for layer in layers:
            for key in PLAIN_KEYS:
                value = getattr(layer, key)
                if value is not None:
                    merged[key] = value
            if layer.control is not None:
                merged["control"] = layer.control.over(merged.get("control", ControlSettings()))
                merged["control_planned"] = True
            if layer.preflight is not None:
                merged["preflight"] = layer.preflight.over(merged.get("preflight", PreflightSettings()))
            if layer.separation is not None:
                merged["separation"] = layer.separation.over(merged.get("separation", SeparationSettings()))
            if layer.group is not None:
                groups = [layer.group] if isinstance(layer.group, str) else list(layer.group)
        merged["delegated"] = name in self.delegated
        return VehicleConfig(name=name, sysid=entry.sysid, groups=tuple(groups), **merged)
