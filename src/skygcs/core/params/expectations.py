"""The conditions that one vehicle must meet before it flies: rules for its parameters, and limits of what it shows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from skygcs.core.mavlink.param_encoding import Value, equal, value_text

ControlMode = Literal["raw", "attitude", "velocity", "position"]
"""The control mode with which skygcs will fly the vehicle."""

FIXES = ("no_gps", "no_fix", "2d", "3d", "dgps", "rtk_float", "rtk_fixed")
"""GPS fixes in ascending quality, named as in `core.vehicle.decoding`; "static" and "ppp" are the best."""


@dataclass(frozen=True, slots=True)
class Rule:
    """The rule for a parameter's value: all comparisons must hold. An empty rule accepts any value: it removes the rule
    of a lower level.

    ``one_of``: any of these values. ``least``, ``most``: bounds that belong to it. ``bits``, ``no_bits``: a mask of
    bits that must be set, or clear (whole numbers only). ``set_to``: what makes it right where the rule itself does not
    say enough. ``why`` is reported with a failure. ``optional``: a vehicle without such a parameter passes.
    """

    one_of: tuple[Value, ...] = ()
    least: Value | None = None
    most: Value | None = None
    bits: int = 0
    no_bits: int = 0
    set_to: Value | None = None
    why: str = ""
    optional: bool = False

    @property
    def empty(self) -> bool:
        return not (self.one_of or self.bits or self.no_bits) and self.least is None and self.most is None

    def holds(self, value: Value) -> bool:
        """True if a value that a vehicle holds satisfies the rule; a 32-bit float may differ in its last digit."""
        if self.one_of and not any(equal(value, wanted) for wanted in self.one_of):
            return False
        if self.least is not None and value < self.least and not equal(value, self.least):
            return False
        if self.most is not None and value > self.most and not equal(value, self.most):
            return False
        if not (self.bits or self.no_bits):
            return True
        return value == int(value) and int(value) & self.bits == self.bits and not int(value) & self.no_bits

    def fix(self, value: Value) -> Value | None:
        """The value to set, as near to the present one as the rule allows; None if the rule gives no single value."""
        if self.set_to is not None:
            wanted: Value | None = self.set_to
        elif self.one_of:
            wanted = next((v for v in self.one_of if self.holds(v)), None)
        else:
            wanted = value
            if self.bits or self.no_bits:
                wanted = (int(value) | self.bits) & ~self.no_bits
            if self.least is not None:
                wanted = max(wanted, self.least)
            if self.most is not None:
                wanted = min(wanted, self.most)
        return wanted if wanted is not None and self.holds(wanted) else None

    def __str__(self) -> str:
        """The rule as text that follows "must be": "0 or 2", "5 to 30", "at most 3000"."""
        parts = []
        if self.one_of:
            parts.append(" or ".join(map(value_text, self.one_of)))
        if self.least is not None and self.most is not None:
            parts.append(f"{value_text(self.least)} to {value_text(self.most)}")
        elif self.least is not None:
            parts.append(f"at least {value_text(self.least)}")
        elif self.most is not None:
            parts.append(f"at most {value_text(self.most)}")
        if self.bits:
            parts.append(f"with {_bit_list(self.bits)} set")
        if self.no_bits:
            parts.append(f"with {_bit_list(self.no_bits)} clear")
        return ", ".join(parts) or "anything"


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


def _bit_list(mask: int) -> str:
    numbers = [str(n) for n in range(mask.bit_length()) if mask >> n & 1]
    return f"bit{'s' if len(numbers) > 1 else ''} {' and '.join(numbers)}"


_VERSION = re.compile(r"(\d+)\.(\d+)(?:\.(\d+))?(?:-(dev|alpha|beta|rc)(\d*))?")
_STAGES = ("dev", "alpha", "beta", "rc")


def version_problem(text: str) -> str | None:
    """Why a version cannot be compared; None if it can."""
    return None if _VERSION.fullmatch(text) else f"{text!r} is not a version such as 1.16.0 or 4.6.2-beta1"


def version_of(text: str) -> tuple[int, ...]:
    """The version as numbers that can be compared; a development stage comes before its release."""
    match = _VERSION.match(text)
    if match is None:
        return (0,)
    stage = len(_STAGES) if match[4] is None else _STAGES.index(match[4])
    return (int(match[1]), int(match[2]), int(match[3] or 0), stage, int(match[5] or 0))
