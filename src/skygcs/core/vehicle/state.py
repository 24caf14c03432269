"""The state of a vehicle as RPC returns it: JSON-able, SI units, degrees, ENU, None for unknown values.

`core.vehicle.snapshot` builds it. A telemetry group is None until a message of it has come, and has ``age_s``, the time
since then; check the age before using a group. `core.vehicle.decoding` decodes the groups. The docstrings of the keys
are their descriptions in `rpc.discover`.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict  # typing's is not described by pydantic before Python 3.12

SYSTEM_STATUS = (
    "uninit",
    "boot",
    "calibrating",
    "standby",
    "active",
    "critical",
    "emergency",
    "poweroff",
    "flight_termination",
)
"""MAV_STATE."""

STANDBY, ACTIVE = 3, 4
FAILSAFE_STATUS = frozenset({5, 6, 8})
"""ArduPilot and PX4 report critical in a failsafe, emergency after a crash, termination after a flight termination."""

LANDED = ("undefined", "on_ground", "in_air", "takeoff", "landing")
"""MAV_LANDED_STATE."""

AIRBORNE = frozenset({"in_air", "takeoff", "landing"})

SEVERITY = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""MAV_SEVERITY."""


def name_of(names: tuple[str, ...], value: int) -> str:
    """Name of an enum value; its number if the table does not have it."""
    return names[value] if 0 <= value < len(names) else str(value)


Vec3 = tuple[float, float, float]

Part = dict[str, Any]
"""One telemetry group; see `core.vehicle.decoding` for its keys, plus ``age_s``."""


class Aged(TypedDict):
    age_s: float


class GpsPart(Aged):
    fix: str
    fix_type: int
    satellites: int | None
    hdop: float | None
    vdop: float | None
    lat_deg: float | None
    lon_deg: float | None
    alt_amsl_m: float | None
    time_usec: int


class PositionPart(Aged):
    lat_deg: float | None
    lon_deg: float | None
    alt_amsl_m: float | None
    alt_rel_m: float | None
    """Above home."""
    heading_deg: float | None
    """Clockwise from true north."""
    vel_enu_mps: Vec3 | None
    """True east, north, up."""
    time_boot_s: float
    takeoff_alt_amsl_m: float | None
    """The ground it took off from; null if it was not seen there."""
    alt_takeoff_m: float | None
    """Height above it."""
    enu_m: Vec3 | None
    """In the fleet's frame, as all that follow; null without an origin."""
    vel_world_mps: Vec3 | None
    yaw_world_deg: float | None
    """Counter-clockwise from the frame's x axis."""
    origin_generation: int | None


class AttitudePart(Aged):
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    """Clockwise from north."""
    rates_dps: list[float | None]
    quaternion: list[float | None]
    """w, x, y, z"""
    time_boot_s: float


class BatteryPart(Aged):
    volts: float | None
    amps: float | None
    percent: int | None
    consumed_mah: int | None
    temperature_degc: float | None
    remaining_s: int | None


class HomePart(Aged):
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float | None


class VfrPart(Aged):
    airspeed_mps: float | None
    groundspeed_mps: float | None
    heading_deg: int
    throttle_percent: int
    alt_m: float | None
    climb_mps: float | None


class MissionPart(Aged):
    item: int | None
    """The current one, from 1; 0: an ArduPilot's home."""
    seq: int | None
    """That on the wire."""
    count: int | None
    last_ack: str | None
    """The answer of the last transfer."""


class UplinkPart(Aged):
    """``age_s``: since its last answer."""

    heard: bool
    """True if it answers our requests."""
    unanswered: int
    """Number of requests since its last answer."""
    rtt_s: float | None


class SeparationPart(TypedDict("Other", {"with": str})):
    """Its most urgent conflict with another vehicle. It has no age_s: it is of the last evaluation."""

    level: Literal["notice", "warning", "action"]
    distance_m: NotRequired[float]
    """This and what follows only while a conflict is predicted; a level falls some seconds after that."""
    closest_m: NotRequired[float]
    closest_in_s: NotRequired[float]
    enters_in_s: NotRequired[float]
    margin_m: NotRequired[float]


class CompanionPart(TypedDict):
    name: str | None
    link: Literal["connecting", "up", "down"] | None
    """Null: the fleet file gives it no `rpc`."""
    since_s: float | None
    error: str | None
    """Why it is not up."""
    version: str | None
    age_s: float | None
    """Since MAVLink of an onboard computer came; null: never."""


class LinkPart(Aged):
    frames: int
    bytes: int
    lost: int
    loss_ratio: float | None
    frames_per_s: float
    bytes_per_s: float
    chosen: NotRequired[bool]
    """True for the one in use, of a vehicle that is heard on several."""


class StatusTextEntry(TypedDict):
    """A STATUSTEXT of one component of the system."""

    severity: str
    level: int
    text: str
    compid: int
    """The component that sent it."""
    age_s: float


class ComponentEntry(TypedDict):
    """One component of a system."""

    compid: int
    name: str | None
    """The purpose of its component id (MAV_COMPONENT), such as ONBOARD_COMPUTER."""
    type: str | None
    """Its MAV_TYPE, from its heartbeat; null without a heartbeat."""
    autopilot: bool
    """True for a vehicle's autopilot, which has a state of its own."""
    age_s: float
    """Age of its newest message."""
    messages: int
    """Number of messages received from it."""


class MessageRate(TypedDict):
    """Rate and count of a message."""

    rate_hz: float
    age_s: float
    count: int


class VehicleState(TypedDict):
    """The state of one vehicle at one moment; null: not known. SI units, degrees, ENU. Groups have age_s."""

    name: str
    sysid: int
    compid: int
    autopilot: str
    type: str
    firmware: str | None
    groups: list[str]
    gcs_sysid: int | None
    """System id whose heartbeats its GCS failsafe watches, once that parameter was read."""
    connected: bool
    duplicate_sysid: bool
    """True if two vehicles send with this system id: the state may be a mixture of both."""
    replayed: bool
    """True if it exists only in a recording: orders to it are refused."""
    last_heartbeat_age_s: float | None
    uptime_s: float | None
    clock_offset_s: float | None
    armed: bool
    mode: str
    system_status: str
    landed: str
    failsafe: bool
    authority: Part | None
    """Authority over a vehicle of [federation.vehicles]: held (this site may command it now), commander (the site that
    does, null: not known), remaining_s (of the lease's grant), token, hub, blocked_frames (that were not sent to it);
    null: any other vehicle"""
    control: Part | None
    """Control by setpoints, as in control.status; null: skygcs does not control it."""
    uplink: UplinkPart | None
    separation: SeparationPart | None
    calibration: Part | None
    """The calibration that runs: sensor, percent, pose (level, left, right, nose_down, nose_up, upside_down), confirm
    (it waits for vehicles.calibrate_confirm), pending (poses a PX4 still wants), text; null: none runs"""
    companion: CompanionPart | None
    """The computer on the vehicle; null: none is known."""
    gps: GpsPart | None
    position: PositionPart | None
    local: Part | None
    """The autopilot's own frame, rotated to ENU: pos_enu_m, vel_enu_mps, time_boot_s"""
    attitude: AttitudePart | None
    battery: BatteryPart | None
    home: HomePart | None
    """The autopilot's home."""
    ekf_origin: Part | None
    """The autopilot's local origin: lat_deg, lon_deg, alt_amsl_m"""
    estimator: Part | None
    """flags, ok (good enough to navigate by), names, ratios, accuracy_m"""
    sensors: Part | None
    """present, enabled, health, unhealthy: lists of names; load_percent"""
    vfr: VfrPart | None
    rc: Part | None
    """channels, rssi"""
    imu: Part | None
    """accel_mps2, gyro_radps, mag_gauss, pressure_hpa, temperature_degc"""
    servos: Part | None
    """pwm_us"""
    mission: MissionPart | None
    target_global: Part | None
    """The autopilot's target: lat_deg, lon_deg, alt_m and more"""
    target_local: Part | None
    """The same in its local frame: pos_enu_m, vel_enu_mps, yaw_deg"""
    target_attitude: Part | None
    """quaternion, thrust, type_mask"""
    time: Part | None
    """unix_s, boot_s"""
    high_latency: Part | None
    """HIGH_LATENCY2: position, battery, failures in one message"""
    last_ack: Part | None
    """The last COMMAND_ACK"""
    status_texts: list[StatusTextEntry]
    components: list[ComponentEntry]
    """All components heard of its system, its autopilot among them."""
    messages: dict[str, MessageRate]
    """Rate and count by message name."""
    links: dict[str, LinkPart]
    """By link."""
