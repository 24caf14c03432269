"""The state of a vehicle as RPC returns it: JSON-able, SI units, degrees, ENU, None for unknown values.

`core.vehicle.snapshot` builds it. A telemetry group is None until a message of it has come, and has ``age_s``, the time
since then; check the age before using a group. `core.vehicle.decoding` decodes the groups. The docstrings of the keys
are their descriptions in `rpc.discover`.
"""

from __future__ import annotations

from typing import Any

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


Part = dict[str, Any]
"""One telemetry group; see `core.vehicle.decoding` for its keys, plus ``age_s``."""


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
    uplink: Part | None
    """heard (true if it answers our requests), unanswered (number of requests since its last answer), rtt_s, age_s
    (time since its last answer); null: not known"""
    separation: Part | None
    """Its most urgent conflict with another vehicle, as in monitor.status: level, with, distance_m, closest_m,
    closest_in_s, enters_in_s, margin_m; null: none. It has no age_s: it is of the last evaluation"""
    calibration: Part | None
    """The calibration that runs: sensor, percent, pose (level, left, right, nose_down, nose_up, upside_down), confirm
    (it waits for vehicles.calibrate_confirm), pending (poses a PX4 still wants), text; null: none runs"""
    companion: Part | None
    """The computer on the vehicle: name, link (connecting, up, down; null: the fleet file gives it no `rpc`), since_s,
    error (why it is not up), version, age_s (since MAVLink of an onboard computer came; null: never); null: none is
    known"""
    gps: Part | None
    """fix, fix_type, satellites, hdop, vdop, lat_deg, lon_deg, alt_amsl_m, time_usec"""
    position: Part | None
    """lat_deg, lon_deg, alt_amsl_m, alt_rel_m, heading_deg, vel_enu_mps (true east, north, up), time_boot_s;
    takeoff_alt_amsl_m and alt_takeoff_m (the ground it took off from and the height above it; null if it was not seen
    on the ground); in the fleet's frame: enu_m, vel_world_mps, yaw_world_deg, origin_generation"""
    local: Part | None
    """The autopilot's own frame, rotated to ENU: pos_enu_m, vel_enu_mps, time_boot_s"""
    attitude: Part | None
    """roll_deg, pitch_deg, yaw_deg (clockwise from north), rates_dps, quaternion (w, x, y, z)"""
    battery: Part | None
    """volts, amps, percent, consumed_mah, temperature_degc, remaining_s"""
    home: Part | None
    """The autopilot's home: lat_deg, lon_deg, alt_amsl_m"""
    ekf_origin: Part | None
    """The autopilot's local origin: lat_deg, lon_deg, alt_amsl_m"""
    estimator: Part | None
    """flags, ok (good enough to navigate by), names, ratios, accuracy_m"""
    sensors: Part | None
    """present, enabled, health, unhealthy: lists of names; load_percent"""
    vfr: Part | None
    """airspeed_mps, groundspeed_mps, heading_deg, throttle_percent, alt_m, climb_mps"""
    rc: Part | None
    """channels, rssi"""
    imu: Part | None
    """accel_mps2, gyro_radps, mag_gauss, pressure_hpa, temperature_degc"""
    servos: Part | None
    """pwm_us"""
    mission: Part | None
    """item (the current one, from 1; 0: an ArduPilot's home), seq (that on the wire), count, last_ack (of the last
    transfer)"""
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
    links: dict[str, Any]
    """By link: frames, bytes, lost, loss_ratio, frames_per_s, bytes_per_s, age_s."""
