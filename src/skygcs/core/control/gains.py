"""Gains and limits of the cascade. The defaults are the UTIAS experiment's (docs/explanation/control-law.md).

Thrust here is normalised: 0 is none, 1 is all the vehicle has, `hover_thrust` carries its weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from skygcs.errors import ConfigError

GRAVITY_MPS2 = 9.81
"""The value every figure of docs/explanation/control-law.md was computed with."""

LARGEST_GAIN = 100.0
"""Far above any gain that flies (largest default 1.0); keeps every product of the law finite."""

LARGEST_TILT_RAD = math.radians(80.0)
"""Beyond it the tangent, and with it the horizontal limit, is no limit any more."""


@dataclass(frozen=True, slots=True)
class AxisGains:
    """Gains of one axis: position to velocity, then velocity error to normalised thrust."""

    pos_p_per_s: float
    """Asked velocity (m/s) per metre of position error."""
    vel_p: float
    """Thrust per m/s of velocity error."""
    vel_i: float
    """Thrust per metre of integrated velocity error."""
    vel_d: float = 0.0
    """Thrust per m/s² of filtered change of the velocity error."""


UTIAS_HOVER_THRUST = 0.45
"""Normalised hover thrust of the UTIAS experiment's F450: from its configuration, its report does not print it."""

UTIAS_XY = AxisGains(pos_p_per_s=0.95, vel_p=0.08, vel_i=0.02)
UTIAS_Z = AxisGains(pos_p_per_s=1.0, vel_p=0.3, vel_i=0.02)


class _Derived:
    """Values that follow from a config and are wanted in every step; no fields, so that configs compare and print as
    given."""

    __slots__ = ("dt_max_s", "dt_min_s", "integral_xy_max", "near_xy_squared", "near_z_mps", "tilt_max_tan")

    dt_min_s: float
    """Shortest step the law believes: 10 ms at 50 Hz."""
    dt_max_s: float
    """Longest step the law believes: 30 ms at 50 Hz, and in proportion at slower rates."""
    integral_xy_max: float
    """Norm of the horizontal integral: what full tilt gives at hover. More could never be flown."""
    tilt_max_tan: float
    near_xy_squared: float
    """Square of the speed (m²/s²) up to which ``acc_xy_max_mps2`` does not limit the position loop; infinite without
    one."""
    near_z_mps: float


@dataclass(frozen=True, slots=True)
class ControlConfig(_Derived):
    """All that `step` needs to know of one vehicle. Raises ConfigError, with every problem at once.

    Replace it between two steps to change gains in flight: the integral is kept in units of thrust, so a new gain
    makes no jump in what has already been integrated.
    """

    xy: AxisGains = UTIAS_XY
    z: AxisGains = UTIAS_Z
    hover_thrust: float = UTIAS_HOVER_THRUST
    thrust_min: float = 0.1
    """Least vertical part of the thrust; never zero in the air, so that the attitude keeps a direction."""
    thrust_max: float = 0.9
    """Largest norm of the whole thrust vector, and the bound of the vertical integral."""
    tilt_max_rad: float = math.radians(35.0)
    vel_xy_max_mps: float = 10.0
    """Per axis, not of the norm, as in the law this follows."""
    vel_z_max_mps: float = 10.0
    acc_xy_max_mps2: float | None = None
    """How fast the velocity towards a far reference builds up and what it brakes with before that, of the norm; None:
    at once, as in the law this follows. Vehicles fly with one (`velocity_loop`)."""
    acc_z_max_mps2: float | None = None
    derivative_cutoff_hz: float = 5.0
    period_s: float = 0.02
    """Configured period of the loop; a measured step outside [0.5, 1.5] of it is clamped."""

    def __post_init__(self) -> None:
        problems = [*_gain_problems("xy", self.xy), *_gain_problems("z", self.z), *_limit_problems(self)]
        if problems:
            raise ConfigError("control", problems)
        assign = object.__setattr__  # frozen, and made of nothing but the fields
        tilt_max_tan = math.tan(self.tilt_max_rad)
        assign(self, "dt_min_s", 0.5 * self.period_s)
        assign(self, "dt_max_s", 1.5 * self.period_s)
        assign(self, "tilt_max_tan", tilt_max_tan)
        assign(self, "integral_xy_max", self.hover_thrust * tilt_max_tan)
        near_xy_mps = _near(self.acc_xy_max_mps2, self.xy)
        assign(self, "near_xy_squared", near_xy_mps * near_xy_mps)  # `** 2` raises where this is infinite
        assign(self, "near_z_mps", _near(self.acc_z_max_mps2, self.z))


def _near(acc_mps2: float | None, gains: AxisGains) -> float:
    return math.inf if acc_mps2 is None or gains.pos_p_per_s == 0.0 else acc_mps2 / gains.pos_p_per_s


def _gain_problems(axis: str, gains: AxisGains) -> list[str]:
    problems = []
    for name in ("pos_p_per_s", "vel_i", "vel_d"):
        value = getattr(gains, name)
        if not 0.0 <= value <= LARGEST_GAIN:
            problems.append(f"{axis}.{name}: {value} is not in 0..{LARGEST_GAIN:g}")
    if not 1e-3 <= gains.vel_p <= LARGEST_GAIN:  # the anti-windup of xy divides by it
        problems.append(f"{axis}.vel_p: {gains.vel_p} is not in 0.001..{LARGEST_GAIN:g}")
    return problems


def _limit_problems(config: ControlConfig) -> list[str]:
    problems = []
    if not 0.0 <= config.thrust_min < config.hover_thrust < config.thrust_max <= 1.0:
        problems.append(
            "thrust_min, hover_thrust, thrust_max: "
            f"{config.thrust_min}, {config.hover_thrust}, {config.thrust_max} do not rise within 0..1"
        )
    if not 0.0 < config.tilt_max_rad <= LARGEST_TILT_RAD:
        problems.append(f"tilt_max_rad: {config.tilt_max_rad} is not in 0..{LARGEST_TILT_RAD:.4f} (80 degrees)")
    return problems + out_of_range(
        config,
        ("vel_xy_max_mps", 0.01, 100.0),
        ("vel_z_max_mps", 0.01, 100.0),
        ("acc_xy_max_mps2", 0.1, 100.0),
        ("acc_z_max_mps2", 0.1, 100.0),
        ("derivative_cutoff_hz", 0.01, 1000.0),
        ("period_s", 0.001, 1.0),
    )


def out_of_range(config: object, *ranges: tuple[str, float, float]) -> list[str]:
    """A text for each field, by name, that is outside its least and its largest value, NaN included. One that is None
    is not set."""
    found = []
    for name, low, high in ranges:
        value = getattr(config, name)
        if value is not None and not low <= value <= high:
            found.append(f"{name}: {value} is not in {low:g}..{high:g}")
    return found
