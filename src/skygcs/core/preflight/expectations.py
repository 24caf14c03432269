"""The conditions that one vehicle must meet before it flies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from skygcs.core.preflight.rules import Rule

ControlMode = Literal["raw", "attitude", "velocity", "position"]
"""The control mode with which skygcs will fly the vehicle."""

FIXES = ("no_gps", "no_fix", "2d", "3d", "dgps", "rtk_float", "rtk_fixed")
"""GPS fixes in ascending quality, named as in `core.vehicle.decoding`; "static" and "ppp" are the best."""


@dataclass(frozen=True, slots=True)
class Expectations:
    """Limits of the checks; the defaults pass a healthy PX4 and ArduCopter as their firmware ships them.

    A limit of 0 turns its check off.
    """

    params: Mapping[str, Rule] = field(default_factory=dict)
    """By name, that of ArduPilot 4.6 or of 4.7."""
    battery_min_percent: float = 30.0
    """Half of the charge above this is for the flight, the rest for a second approach. The guard holds at 20."""
    gps_fix_min: str = "3d"
    """One of `FIXES`; "no_gps" switches the check off, for indoor fleets."""
    satellites_min: int = 6
    """EKF2_REQ_NSATS (PX4) and ArduPilot's own pre-arm check."""
    hdop_max: float = 2.0
    """PX4 wants a PDOP of 2.5, ArduPilot an HDOP of 1.4 or 2.0 by its board."""
    delegated: bool = False
    """True if other ground stations may command it, too."""
    mocap: bool = False
    """True if it flies by poses of motion capture, without GPS."""
    estimator: bool = True
    prearm: bool = True
    """True if the autopilot's own arming checks must be passed as well."""
    sensors_required: tuple[str, ...] = ()
    """Names of sensors that must be present, enabled and healthy. Every enabled sensor must be healthy in any case."""
    sensors_ignored: tuple[str, ...] = ()
    home_max_m: float = 50.0
    """A home farther away than this belongs to another place or another flight."""
    clock_max_s: float = 5.0
    """More than a bad radio delays a message. With a larger difference logs cannot be compared."""
    firmware_min: str | None = None
    firmware: tuple[str, ...] = ()
    """Exactly one of these versions."""
    loss_max_percent: float = 20.0
    """Recent loss of its frames; the protocols are designed for 20 % each way."""
    radio_margin_min_db: float = 10.0
    """Signal above noise at both ends of a radio: the minimum with which SiK radios keep their loss low."""
    rtl_height_m: tuple[float, float] = (0.0, 120.0)
    """Above home; 120 m is the ceiling for open flights in Europe and, as 400 ft, in Canada and the USA."""
    geofence_required: bool = False
    transmitter: bool | None = None
    """True if a pilot's transmitter belongs to it; None: not specified."""
    control: ControlMode | None = None
    """None: it will not be flown by setpoints."""
    setpoint_hz: float = 5.0
    """The rate of the slowest control mode in use: control falls back from attitude to position."""

    @property
    def by_attitude(self) -> bool:
        """True if it will get attitudes and thrusts; raw flight may send them, too."""
        return self.control in ("attitude", "raw")
