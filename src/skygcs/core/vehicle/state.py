"""The state of a vehicle as programs and people see it: JSON-able, SI units, degrees, ENU, None for what is not known.

`Vehicle.snapshot` makes it. A section is None until a message has told of it, and carries ``age_s``, the time since it
came; whoever acts on a section looks at its age first. The sections' contents are made in `fold`.
"""

from __future__ import annotations

from typing import Any, TypedDict

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
"""ArduPilot and PX4 say critical in a failsafe, emergency after a crash, termination after a flight termination."""

LANDED = ("undefined", "on_ground", "in_air", "takeoff", "landing")
"""MAV_LANDED_STATE."""

AIRBORNE = frozenset({"in_air", "takeoff", "landing"})

SEVERITY = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
"""MAV_SEVERITY."""


def name_of(names: tuple[str, ...], value: int) -> str:
    """Name of an enum value; one that the table does not have shows its number."""
    return names[value] if 0 <= value < len(names) else str(value)


Part = dict[str, Any]
"""One section; see `fold` for its keys, plus ``age_s``."""


class StatusTextEntry(TypedDict):
    severity: str
    level: int
    text: str
    compid: int
    age_s: float


class MessageRate(TypedDict):
    rate_hz: float
    age_s: float
    count: int


class VehicleState(TypedDict):
    """Everything known of one vehicle at one moment."""

    name: str
    sysid: int
    compid: int
    autopilot: str
    type: str
    firmware: str | None
    groups: list[str]
    gcs_sysid: int | None
    connected: bool
    duplicate_sysid: bool
    replayed: bool
    last_heartbeat_age_s: float | None
    uptime_s: float | None
    clock_offset_s: float | None
    armed: bool
    mode: str
    system_status: str
    landed: str
    failsafe: bool
    control: Part | None
    """How skygcs flies it by setpoints (`worldview.shown`); None: it does not."""
    uplink: Part | None
    """Whether it hears us (`uplink_watch`); None: not known."""
    gps: Part | None
    position: Part | None
    local: Part | None
    attitude: Part | None
    battery: Part | None
    home: Part | None
    ekf_origin: Part | None
    estimator: Part | None
    sensors: Part | None
    vfr: Part | None
    rc: Part | None
    imu: Part | None
    servos: Part | None
    mission: Part | None
    target_global: Part | None
    target_local: Part | None
    target_attitude: Part | None
    time: Part | None
    high_latency: Part | None
    last_ack: Part | None
    status_texts: list[StatusTextEntry]
    components: list[dict[str, Any]]
    messages: dict[str, MessageRate]
    links: dict[str, Any]
