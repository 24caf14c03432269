"""Setpoints of the user's own controller: attitude and thrust, body rates and thrust, or an acceleration. Pure.

    kind           message                                    what the firmwares do with it
    ------------   ----------------------------------------   ------------------------------------------------------
    attitude       SET_ATTITUDE_TARGET, rates ignored         both: attitude loop; thrust as it is
    rates          SET_ATTITUDE_TARGET, attitude ignored      PX4: rate loop. ArduCopter: it moves an attitude of its
                                                              own at these rates, and stabilises that
    acceleration   SET_POSITION_TARGET_LOCAL_NED,             PX4: thrust vector at once. ArduCopter: integrates it to
                   position and velocity ignored              a velocity and a position, which it tracks as well,
                                                              unless GUID_OPTIONS has bits 4 and 5

Read in PX4 1.16.1 (mavlink_receiver.cpp, PositionControl.cpp) and ArduCopter 4.6.3 (GCS_Mavlink.cpp, mode_guided.cpp).

A setpoint that exceeds a limit is refused, never clipped: a controller whose output is clipped unnoticed winds up. The
setpoint before it stays in force until its own deadline.

Body rates and thrust bound neither tilt nor speed, so both are watched by what the vehicle reports: the speed by
`OffboardController` (the control fence looks ahead), the tilt by `RawSource`. It must not exceed tilt_max_deg by more
than TILT_SLACK_DEG, and for body rates it must be reported. Either makes the vehicle hold its position by position
setpoints (the guard's ``raw_refused``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from skygcs.core.control.cascade import Quaternion, Vector, ned_frd_from_enu_flu
from skygcs.core.control.gains import out_of_range
from skygcs.core.geo import Origin, enu_from_world, quaternion_from_euler
from skygcs.core.vehicle.frames import yaw_enu_rad
from skygcs.core.vehicle.setpoint import UNIT_TOLERANCE
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import ConfigError, RefusedError

Kind = Literal["attitude", "rates", "acceleration"]

ROUNDING = 1e-9
"""By which a figure that was computed for the limit itself may exceed it."""

TILT_SLACK_DEG = 10.0
"""An attitude loop overshoots: by some 5 degrees in a step of 35 (both firmwares in simulation)."""

TILT_FRESH_S = 0.5
"""An older attitude does not show what body rates have made of it: 90 degrees at 180 degrees/s."""


@dataclass(frozen=True, slots=True)
class RawLimits:
    """Limits of what an own controller may ask for. Raises ConfigError with every problem."""

    tilt_max_deg: float = 35.0
    """Largest tilt of an attitude setpoint, the same as the law's own limit; the vehicle's reported tilt may be
    TILT_SLACK_DEG more."""
    rate_max_deg_s: float = 180.0
    """Largest body rate on each axis: PX4's MC_YAWRATE_MAX is 200, and roll and pitch of 220 are its acrobatic
    limits."""
    thrust_min: float = 0.1
    """With less the propellers give the attitude loop no authority."""
    thrust_max: float = 0.9
    acc_max_mps2: float = 5.0
    """Length of an acceleration setpoint: a tilt of 27 degrees."""

    def __post_init__(self) -> None:
        problems = out_of_range(
            self,
            ("tilt_max_deg", 1.0, 80.0),
            ("rate_max_deg_s", 1.0, 1000.0),
            ("thrust_min", 0.0, 1.0),
            ("thrust_max", 0.0, 1.0),
            ("acc_max_mps2", 0.1, 30.0),
        )
        if not self.thrust_min < self.thrust_max:
            problems.append(f"thrust_min, thrust_max: {self.thrust_min}, {self.thrust_max} do not rise")
        if problems:
            raise ConfigError("control.raw", problems)


@dataclass(frozen=True, slots=True)
class RawSetpoint:
    """One setpoint of an own controller; what its ``kind`` does not have is None."""

    kind: Kind
    thrust: float | None = None
    attitude_ned_frd: Quaternion | None = None
    rates_frd_radps: Vector | None = None
    acc_enu_mps2: Vector | None = None
    yaw_enu_rad: float | None = None
    """Only beside an acceleration; None: the autopilot keeps its heading."""

    def refusal(self, limits: RawLimits) -> str | None:
        """Which limit it exceeds; None if it may be flown."""
        if self.attitude_ned_frd is not None:
            tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, up_part(self.attitude_ned_frd)))))
            if not tilt_deg <= limits.tilt_max_deg + 1e-6:
                return _over("a tilt", tilt_deg, limits.tilt_max_deg, "degrees", "tilt_max_deg")
        for axis, rate in zip(("roll", "pitch", "yaw"), self.rates_frd_radps or (), strict=False):
            rate_deg_s = abs(math.degrees(rate))
            if not rate_deg_s <= limits.rate_max_deg_s * (1.0 + ROUNDING):
                return _over(f"a {axis} rate", rate_deg_s, limits.rate_max_deg_s, "degrees/s", "rate_max_deg_s")
        if self.acc_enu_mps2 is not None:
            size = math.hypot(*self.acc_enu_mps2)
            if not size <= limits.acc_max_mps2 * (1.0 + ROUNDING):
                return _over("an acceleration", size, limits.acc_max_mps2, "m/s²", "acc_max_mps2")
        if self.thrust is not None and not limits.thrust_min <= self.thrust <= limits.thrust_max:
            span = f"{limits.thrust_min:g}..{limits.thrust_max:g} (control.raw.thrust_min, thrust_max)"
            return f"a thrust of {self.thrust:g} is not in {span}"
        return None


def _over(what: str, value: float, limit: float, unit: str, key: str) -> str:
    return f"{what} of {value:.3g} {unit} is above {limit:g} (control.raw.{key})"


def up_part(attitude: Quaternion) -> float:
    """Cosine of the tilt: how much of the body's vertical axis is vertical."""
    _, x, y, _ = attitude
    return 1.0 - 2.0 * (x * x + y * y)


def raw_from_world(
    origin: Origin,
    *,
    attitude: Sequence[float] | None = None,
    roll_deg: float | None = None,
    pitch_deg: float | None = None,
    yaw_deg: float | None = None,
    body_rates_deg_s: Sequence[float] | None = None,
    thrust: float | None = None,
    acc_enu_mps2: Sequence[float] | None = None,
) -> RawSetpoint:
    """A raw setpoint as programs give it, about the world's axes. Raises RefusedError for what cannot be meant.

    ``attitude``: quaternion (w, x, y, z) that turns vectors of the body (x forward, y left, z up) into the world's
    (x, y, up). ``roll_deg`` is positive with the right side down, ``pitch_deg`` with the nose up, ``yaw_deg``
    counter-clockwise from the world's x axis; each of ``body_rates_deg_s`` is positive in the direction in which, in
    level flight, that angle grows.
    """
    # exactly one kind of setpoint
    kinds = {
        "an attitude": attitude is not None or roll_deg is not None or pitch_deg is not None,
        "body rates": body_rates_deg_s is not None,
        "an acceleration": acc_enu_mps2 is not None,
    }
    given = [kind for kind, there in kinds.items() if there]
    if len(given) != 1:
        raise RefusedError(f"a raw setpoint is one of {', '.join(kinds)}, not {' and '.join(given) or 'nothing'}")
    # acceleration: the autopilot chooses the thrust
    if acc_enu_mps2 is not None:
        if thrust is not None:
            raise RefusedError("an acceleration has no thrust beside it: the autopilot chooses the thrust")
        yaw = None if yaw_deg is None else yaw_enu_rad(yaw_deg, origin)
        acc = _three("acc_enu_mps2", acc_enu_mps2)
        return RawSetpoint("acceleration", acc_enu_mps2=enu_from_world(acc, origin), yaw_enu_rad=yaw)
    # the other kinds need a thrust
    if thrust is None or not math.isfinite(thrust):
        raise RefusedError(f"{given[0]} needs a thrust")
    if body_rates_deg_s is not None:
        if yaw_deg is not None:
            raise RefusedError("body rates have no yaw_deg beside them: the third is the yaw rate")
        roll, pitch, yaw_rate = (math.radians(rate) for rate in _three("body_rates_deg_s", body_rates_deg_s))
        return RawSetpoint("rates", thrust, rates_frd_radps=(roll, pitch, -yaw_rate))
    # attitude, by quaternion or by angles, in the fleet's frame
    if attitude is not None:
        if roll_deg is not None or pitch_deg is not None or yaw_deg is not None:
            raise RefusedError("give the attitude as a quaternion or as roll, pitch and yaw, not both")
        world = _unit(attitude)
    else:
        if roll_deg is None or pitch_deg is None or yaw_deg is None:
            raise RefusedError("an attitude by angles needs roll_deg, pitch_deg and yaw_deg")
        roll, pitch, yaw = map(math.radians, _three("roll, pitch and yaw", (roll_deg, pitch_deg, yaw_deg)))
        world = quaternion_from_euler(roll, -pitch, yaw)  # nose up is against the y axis of an FLU body
    # turn it into the vehicle's local frame
    east, north, _ = enu_from_world((1.0, 0.0, 0.0), origin)
    enu = _turned_up(world, math.atan2(north, east))
    return RawSetpoint("attitude", thrust, attitude_ned_frd=ned_frd_from_enu_flu(enu))


def _three(what: str, values: Sequence[float]) -> Vector:
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise RefusedError(f"{what}: three numbers are needed")
    x, y, z = values
    return float(x), float(y), float(z)


def _unit(quaternion: Sequence[float]) -> Quaternion:
    if len(quaternion) != 4 or not all(math.isfinite(value) for value in quaternion):
        raise RefusedError("attitude: a quaternion of four numbers (w, x, y, z) is needed")
    norm = math.hypot(*quaternion)
    if not abs(norm - 1.0) <= UNIT_TOLERANCE:
        raise RefusedError(f"attitude quaternion has norm {norm:.4g}; it must be 1 ± {UNIT_TOLERANCE:g}")
    w, x, y, z = (value / norm for value in quaternion)
    return w, x, y, z


def _turned_up(attitude: Quaternion, angle_rad: float) -> Quaternion:
    """The attitude, then a turn about the vertical, counter-clockwise from above."""
    cos, sin = math.cos(angle_rad / 2.0), math.sin(angle_rad / 2.0)
    w, x, y, z = attitude
    return cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w


class RawSource:
    """Raw setpoints of one vehicle: the newest, and the tilt that ends it. Times are the loop's."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.setpoint: RawSetpoint | None = None
        """The one in force."""
        self._until = -math.inf
        self._vehicle = vehicle

    def follow(self, setpoint: RawSetpoint, until: float) -> None:
        """The newest setpoint, in force ``until`` then."""
        self.setpoint, self._until = setpoint, until

    def end(self) -> None:
        """No setpoint is in force."""
        self.setpoint = None

    def expire(self, now: float) -> bool:
        """End a setpoint whose deadline has passed. True in the tick in which that happens."""
        if self.setpoint is None or now <= self._until:
            return False
        self.setpoint = None
        return True

    def tilt_cosine(self, now: float) -> float | None:
        """Cosine of the tilt the vehicle reports; None if that is too old or not known."""
        attitude, at = self._vehicle.message_cache.telemetry("attitude")
        if attitude is None or now - at > TILT_FRESH_S:
            return None
        return math.cos(math.radians(attitude["roll_deg"])) * math.cos(math.radians(attitude["pitch_deg"]))

    def tilt_refusal(self, limits: RawLimits, now: float) -> str | None:
        """Why the tilt forbids the setpoint in force; None if it does not."""
        if self.setpoint is None:
            return None
        cosine = self.tilt_cosine(now)
        if cosine is None:
            if self.setpoint.kind != "rates":
                return None
            return f"body rates need the vehicle's attitude, and none has come for {TILT_FRESH_S:g} s"
        most_deg = limits.tilt_max_deg + TILT_SLACK_DEG
        tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        if tilt_deg <= most_deg:
            return None
        limit = f"limit {most_deg:g}°: control.raw.tilt_max_deg and {TILT_SLACK_DEG:g}°"
        return f"the vehicle tilts by {tilt_deg:.0f}° ({limit})"
