"""Everything that is expected of one vehicle before it flies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from skygcs.core.preflight.rules import Rule

ControlMode = Literal["attitude", "velocity", "position"]
"""How skygcs is to fly it by setpoints."""

FIXES = ("no_gps", "no_fix", "2d", "3d", "dgps", "rtk_float", "rtk_fixed")
"""GPS fixes by what they are worth, as `vehicle.fold` names them; "static" and "ppp" are above all of them."""


@dataclass(frozen=True, slots=True)
class Expectations:
    """Limits of the checks; the defaults pass a healthy PX4 and ArduCopter as their firmware ships them.

    A limit of 0 turns its check off.
    """

    params: Mapping[str, Rule] = field(default_factory=dict)
    """By name; of two generations' names either."""
    battery_min_percent: float = 30.0
    """Half of what is above it is the flight, the rest a second approach. The guard holds a vehicle at 20."""
    gps_fix_min: str = "3d"
    """One of `FIXES`; "no_gps": off, as for a fleet indoors."""
    satellites_min: int = 6
    """EKF2_REQ_NSATS (PX4) and ArduPilot's own pre-arm check."""
    hdop_max: float = 2.0
    """PX4 wants a PDOP of 2.5, ArduPilot an HDOP of 1.4 or 2.0 by its board."""
    estimator: bool = True
    prearm: bool = True
    """Whether the autopilot's own arming checks must be passed as well."""
    sensors_required: tuple[str, ...] = ()
    """Names of sensors that must be there, enabled and healthy; what is enabled must be healthy anyhow."""
    sensors_ignored: tuple[str, ...] = ()
    home_max_m: float = 50.0
    """A home farther from where it stands is another place's, or another flight's."""
    clock_max_s: float = 5.0
    """More than a bad radio delays a message: logs of two clocks cannot be laid over each other."""
    firmware_min: str | None = None
    firmware: tuple[str, ...] = ()
    """Any of these versions, exactly."""
    loss_max_percent: float = 20.0
    """Of its frames, lately; exchanges are made for 20 % each way."""
    radio_margin_min_db: float = 10.0
    """Signal above noise at either end of a radio: the least with which SiK radios keep their loss low."""
    rtl_height_m: tuple[float, float] = (0.0, 120.0)
    """Above home; 120 m is the ceiling for open flights in Europe and, as 400 ft, in Canada and the USA."""
    geofence_required: bool = False
    transmitter: bool | None = None
    """Whether a pilot's transmitter belongs to it; None: not said."""
    control: ControlMode | None = None
    """None: it is not to be flown by setpoints."""
    setpoint_hz: float = 5.0
    """Of the slowest way of control in use, which falls back from attitude to position."""
