"""Setpoints of MAVROS' topics as parameters of control.setpoint.

MAVROS' local frame is the vehicle's own: ENU from the origin of its estimator. The fleet's frame has another origin and
perhaps turned axes; `LocalFrame` has both. A message that is not finite, out of range or in another frame raises
SetpointError: nothing of it is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from skygcs.core.geo import (
    EAST_DEG,
    Origin,
    Quaternion,
    Vector,
    enu_from_geodetic,
    rotated,
    world_from_enu,
    wrap_deg_180,
)
from skygcs.core.ros.fleet_origin import FleetOrigin
from skygcs.core.ros.rotations import quaternion_of, vector_of, yaw_of
from skygcs.core.ros.topics import Topic

Fields = Mapping[str, Any]

ControlMode = Literal["position", "velocity", "raw"]

FARTHEST_M = 100_000.0
FASTEST_MPS = 200.0
STRONGEST_MPS2 = 100.0
FASTEST_TURN_DPS = 360.0
"""Beyond these a number is no setpoint of a vehicle here; the daemon's own limits are far narrower."""

IGNORE_XYZ = (2, 1, 4)
IGNORE_VXYZ = (16, 8, 32)
IGNORE_AXYZ = (128, 64, 256)
FORCE, IGNORE_YAW, IGNORE_YAW_RATE = 512, 1024, 2048
"""POSITION_TARGET_TYPEMASK; of vectors the bits of east, north, up. Its bits are of MAVLink's axes, north first: MAVROS
turns the values of a message into NED and passes the mask on (local_cb of its plugin setpoint_raw), so bit 1 ignores
the y of a message in ENU."""

IGNORE_BODY_VXY = (8, 16)
"""The same of a velocity in the body's frame, forward and left: its axes are not exchanged."""

IGNORE_RATES, IGNORE_THRUST, IGNORE_ATTITUDE = 7, 64, 128
"""ATTITUDE_TARGET_TYPEMASK."""

LOCAL_NED, GLOBAL_INT, GLOBAL_REL_ALT, BODY_NED = 1, 5, 6, 8
"""MAV_FRAME."""

THRUST_FRESH_S = 0.2
"""An attitude of setpoint_attitude goes with a thrust that is no older: at 50 Hz each, ten of them."""


ATTITUDE_FRESH_S = 0.5
"""A demand in the body's frame is turned by an attitude that was measured no longer ago. A setpoint is good for so
long, and a vehicle that turns with 90 deg/s has turned by 45 deg then: with an older one it would fly elsewhere."""

ATTITUDE_HZ = 5.0
"""Attitude that is requested while such demands come and it is not fresh: one may be lost, and come late by 0.1 s."""


class SetpointError(ValueError):
    """Why a message is no setpoint, for the log."""


class AttitudeError(SetpointError):
    """A demand in the body's frame while the vehicle's attitude is not known."""


class Demand(NamedTuple):
    """Demand on a vehicle: the control mode that it needs, and the parameters of control.setpoint."""

    mode: ControlMode
    params: dict[str, Any]
    climbs_m: float | None = None
    """Height above the vehicle's local origin that is asked for; None: none is."""
    by_attitude: bool = False
    """True if it was turned by the vehicle's attitude."""


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Where a vehicle's local frame lies. ``ekf_origin``: (lat_deg, lon_deg, alt_amsl_m); None: it has not said."""

    origin: Origin | None
    ekf_origin: Vector | None
    home_alt_amsl_m: float | None
    yaw_enu_rad: float | None
    """Yaw of the vehicle's nose, from east, measured in the last ATTITUDE_FRESH_S; None: it is not known."""

    def place(self, local_m: Vector) -> list[float]:
        """A place of the local frame in the fleet's. Raises SetpointError."""
        if self.origin is None:
            raise SetpointError("the fleet has no origin: set [origin], or skygcs-cli origin from the vehicle")
        if self.ekf_origin is None:
            raise SetpointError("the vehicle has not reported the origin of its local frame (GPS_GLOBAL_ORIGIN)")
        x, y, up = self.turned(local_m)
        x0, y0, up0 = enu_from_geodetic(*self.ekf_origin, self.origin)
        return [x0 + x, y0 + y, up0 + up]

    def turned(self, enu: Vector) -> Vector:
        """A vector of true ENU along the fleet's axes."""
        return enu if self.origin is None else world_from_enu(enu, self.origin)

    def yaw_deg(self, yaw_enu_rad: float) -> float:
        """A yaw from east as one from the fleet's x axis."""
        return wrap_deg_180(math.degrees(yaw_enu_rad) + self.turn_deg)

    @property
    def turn_deg(self) -> float:
        """Yaw of true east from the fleet's x axis."""
        return 0.0 if self.origin is None else self.origin.x_heading_deg - EAST_DEG


def origin_of(known: FleetOrigin | None, position: Fields | None) -> Origin | None:
    """The origin by which a vehicle is led whose state has this ``position``. Raises SetpointError while it is not
    known, or not the one by which the daemon has the vehicle."""
    if known is None:
        raise SetpointError("the fleet's origin has not been read yet: send on")
    if not known.is_of(position):
        raise SetpointError("the fleet's origin has just been changed, and is read anew: send on")
    return known.origin


def pose_local(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_position/local: place and yaw."""
    local = _bounded(vector_of(fields["pose"]["position"]), FARTHEST_M, "position")
    yaw = _yaw(quaternion_of(fields["pose"]["orientation"]))
    return Demand("position", {"pos_enu_m": frame.place(local), "yaw_deg": frame.yaw_deg(yaw)}, local[2])


def pose_global(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_position/global: a place on earth, its altitude above mean sea level as MAVROS passes it on."""
    position = fields["pose"]["position"]
    place = _on_earth(position["latitude"], position["longitude"], position["altitude"], frame)
    yaw = _yaw(quaternion_of(fields["pose"]["orientation"]))
    return Demand("position", {"pos_enu_m": place, "yaw_deg": frame.yaw_deg(yaw)})


def twist_stamped(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_velocity/cmd_vel."""
    return twist(fields["twist"], frame)


def twist(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_velocity/cmd_vel_unstamped: velocity in the local frame, and yaw rate."""
    velocity = _bounded(vector_of(fields["linear"]), FASTEST_MPS, "velocity")
    rate_dps = _yaw_rate_dps(fields["angular"]["z"])
    return Demand("velocity", {"vel_enu_mps": list(frame.turned(velocity)), "yaw_rate_dps": rate_dps})


def acceleration(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_accel/accel."""
    acc = _bounded(vector_of(fields["vector"]), STRONGEST_MPS2, "acceleration")
    return Demand("raw", {"acc_enu_mps2": list(frame.turned(acc))})


def raw_local(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_raw/local: what its mask does not ignore; in the body's frame velocities alone."""
    mask, kind = fields["type_mask"], fields["coordinate_frame"]
    has_place, has_velocity, has_acc = (not _ignored(mask, bits) for bits in (IGNORE_XYZ, IGNORE_VXYZ, IGNORE_AXYZ))
    if mask & FORCE:
        raise SetpointError("forces (type_mask 512) are not supported")
    is_body = kind == BODY_NED and not has_place and not has_acc
    if is_body:
        fields, mask = _of_body(fields, mask, frame)
        if not mask & IGNORE_YAW:
            raise SetpointError("a yaw in the body's frame is not supported: give a yaw rate")
    elif kind != LOCAL_NED:
        raise SetpointError(f"coordinate_frame {kind}: only LOCAL_NED (1), and BODY_NED (8) for velocities")
    params: dict[str, Any] = {}
    climbs_m = None
    if has_place:
        local = _of_axes(fields["position"], mask, IGNORE_XYZ, FARTHEST_M, "position")
        place = frame.place(local)
        params["pos_enu_m"] = _only(place, mask, IGNORE_XYZ, frame)
        climbs_m = None if mask & IGNORE_XYZ[2] else local[2]
    if has_velocity:
        velocity = _of_axes(fields["velocity"], mask, IGNORE_VXYZ, FASTEST_MPS, "velocity")
        params["vel_enu_mps"] = _only(list(frame.turned(velocity)), mask, IGNORE_VXYZ, frame)
    return _with_rest(params, fields, mask, has_acc, frame)._replace(climbs_m=climbs_m, by_attitude=is_body)


def _of_body(fields: Fields, mask: int, frame: LocalFrame) -> tuple[Fields, int]:
    """A velocity of the body's frame turned by the vehicle's yaw, and its mask. Of one that gives forward or left
    alone the other is 0. Raises AttitudeError."""
    if frame.yaw_enu_rad is None:
        raise AttitudeError(
            f"no attitude of the last {ATTITUDE_FRESH_S} s is known, by which a velocity of the body's frame "
            "is turned; it is requested: send on, or use LOCAL_NED (1)"
        )
    velocity = _of_axes(fields["velocity"], mask, (*IGNORE_BODY_VXY, IGNORE_VXYZ[2]), FASTEST_MPS, "velocity")
    nose = (math.cos(frame.yaw_enu_rad / 2), 0.0, 0.0, math.sin(frame.yaw_enu_rad / 2))
    if not _ignored(mask, IGNORE_BODY_VXY):
        mask &= ~sum(IGNORE_BODY_VXY)
    return {**fields, "velocity": dict(zip("xyz", rotated(nose, velocity), strict=True))}, mask


def raw_global(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_raw/global: a place on earth, above mean sea level or above home."""
    mask, kind = fields["type_mask"], fields["coordinate_frame"]
    if kind not in (GLOBAL_INT, GLOBAL_REL_ALT):
        raise SetpointError(f"coordinate_frame {kind}: only GLOBAL_INT (5) and GLOBAL_REL_ALT (6)")
    if mask & (sum(IGNORE_XYZ) | FORCE):
        if _ignored(mask, IGNORE_XYZ) and not mask & FORCE and not _ignored(mask, IGNORE_VXYZ):
            return raw_local({**fields, "coordinate_frame": LOCAL_NED, "position": {"x": 0, "y": 0, "z": 0}}, frame)
        raise SetpointError("latitude, longitude and altitude must be given together")
    altitude = fields["altitude"]
    if kind == GLOBAL_REL_ALT:
        if frame.home_alt_amsl_m is None:
            raise SetpointError("the vehicle has not reported its home, from which this altitude counts")
        altitude += frame.home_alt_amsl_m
    params: dict[str, Any] = {"pos_enu_m": _on_earth(fields["latitude"], fields["longitude"], altitude, frame)}
    if not _ignored(mask, IGNORE_VXYZ):
        velocity = _of_axes(fields["velocity"], mask, IGNORE_VXYZ, FASTEST_MPS, "velocity")
        params["vel_enu_mps"] = _only(list(frame.turned(velocity)), mask, IGNORE_VXYZ, frame)
    return _with_rest(params, fields, mask, not _ignored(mask, IGNORE_AXYZ), frame)


def _with_rest(params: dict[str, Any], fields: Fields, mask: int, has_acc: bool, frame: LocalFrame) -> Demand:
    """Acceleration and yaw, and the control mode that all of it needs."""
    if has_acc:
        acc = _of_axes(fields["acceleration_or_force"], mask, IGNORE_AXYZ, STRONGEST_MPS2, "acceleration")
        params["acc_enu_mps2"] = list(frame.turned(acc))
    if not params:
        raise SetpointError("type_mask ignores position, velocity and acceleration")
    if not mask & IGNORE_YAW:
        params["yaw_deg"] = frame.yaw_deg(_finite(fields["yaw"], "yaw"))
    if not mask & IGNORE_YAW_RATE:
        params["yaw_rate_dps"] = _yaw_rate_dps(fields["yaw_rate"])
    if "pos_enu_m" in params:
        return Demand("position", params)
    return Demand("velocity" if "vel_enu_mps" in params else "raw", params)


def raw_attitude(fields: Fields, frame: LocalFrame) -> Demand:
    """setpoint_raw/attitude: an attitude or body rates, with a thrust."""
    mask = fields["type_mask"]
    if mask & IGNORE_THRUST:
        raise SetpointError("type_mask ignores the thrust: an attitude alone is not a setpoint")
    if not mask & IGNORE_ATTITUDE:
        return attitude(quaternion_of(fields["orientation"]), fields["thrust"], frame)
    if mask & IGNORE_RATES:
        raise SetpointError("type_mask ignores the attitude and body rates")
    return body_rates(vector_of(fields["body_rate"]), fields["thrust"])


def attitude(q: Quaternion, thrust: float, frame: LocalFrame) -> Demand:
    """An attitude (FLU to ENU) with a thrust of 0 to 1. Another thrust is refused, where MAVROS scales and clamps it:
    its parameter thrust_scaling is not known here, and a node that relied on it would send full thrust."""
    half = math.radians(frame.turn_deg) / 2
    w0, z0 = math.cos(half), math.sin(half)  # a turn about up, before the attitude
    w, x, y, z = _unit(q)
    turned = [w0 * w - z0 * z, w0 * x - z0 * y, w0 * y + z0 * x, w0 * z + z0 * w]
    return Demand("raw", {"attitude": turned, "thrust": _thrust(thrust)})


def body_rates(rates_flu: Vector, thrust: float) -> Demand:
    """Rates about x forward, y left, z up with a thrust: roll right side down, pitch nose up, yaw to the left."""
    roll, pitch, yaw = (math.degrees(rate) for rate in _bounded(rates_flu, 100.0, "body_rate"))
    return Demand("raw", {"body_rates_deg_s": [roll, -pitch, yaw], "thrust": _thrust(thrust)})


SETPOINTS: dict[str, tuple[Topic, Callable[[Fields, LocalFrame], Demand]]] = {
    "setpoint_position/local": (Topic("geometry_msgs/msg/PoseStamped"), pose_local),
    "setpoint_position/global": (Topic("geographic_msgs/msg/GeoPoseStamped"), pose_global),
    "setpoint_velocity/cmd_vel": (Topic("geometry_msgs/msg/TwistStamped"), twist_stamped),
    "setpoint_velocity/cmd_vel_unstamped": (Topic("geometry_msgs/msg/Twist"), twist),
    "setpoint_accel/accel": (Topic("geometry_msgs/msg/Vector3Stamped"), acceleration),
    "setpoint_raw/local": (Topic("mavros_msgs/msg/PositionTarget"), raw_local),
    "setpoint_raw/global": (Topic("mavros_msgs/msg/GlobalPositionTarget"), raw_global),
    "setpoint_raw/attitude": (Topic("mavros_msgs/msg/AttitudeTarget"), raw_attitude),
}
"""Topics that are setpoints by themselves; those of setpoint_attitude come in pairs (`AttitudePair`)."""


class AttitudePair:
    """setpoint_attitude/attitude or cmd_vel with the newest thrust."""

    def __init__(self) -> None:
        self._thrust = 0.0
        self._at = -math.inf

    def on_thrust(self, fields: Fields, now: float) -> None:
        """setpoint_attitude/thrust."""
        self._thrust, self._at = fields["thrust"], now

    def on_pose(self, fields: Fields, frame: LocalFrame, now: float) -> Demand:
        """setpoint_attitude/attitude. Raises SetpointError."""
        return attitude(quaternion_of(fields["pose"]["orientation"]), self._fresh(now), frame)

    def on_twist(self, fields: Fields, now: float) -> Demand:
        """setpoint_attitude/cmd_vel. Raises SetpointError. Its rates are about right, forward, up: MAVROS turns them as
        if they were a vector of ENU (send_attitude_ang_velocity of its plugin setpoint_attitude), and nodes that
        were written for it send them so. Those of setpoint_raw/attitude are about forward, left, up."""
        x, y, z = vector_of(fields["twist"]["angular"])
        return body_rates((y, -x, z), self._fresh(now))

    def _fresh(self, now: float) -> float:
        if now - self._at > THRUST_FRESH_S:
            raise SetpointError("no thrust came with it (setpoint_attitude/thrust)")
        return self._thrust


def _on_earth(lat_deg: float, lon_deg: float, alt_amsl_m: float, frame: LocalFrame) -> list[float]:
    if frame.origin is None:
        raise SetpointError("the fleet has no origin: set [origin], or skygcs-cli origin from the vehicle")
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180 and abs(alt_amsl_m) <= FARTHEST_M):
        raise SetpointError("a place that is not on earth")
    return list(enu_from_geodetic(lat_deg, lon_deg, alt_amsl_m, frame.origin))


def _ignored(mask: int, bits: tuple[int, ...]) -> bool:
    return all(mask & bit for bit in bits)


def _of_axes(fields: Fields, mask: int, bits: tuple[int, ...], most: float, what: str) -> Vector:
    """The vector with 0 for the axes that the mask ignores, which may be NaN."""
    x, y, z = (0.0 if mask & bit else value for bit, value in zip(bits, vector_of(fields), strict=True))
    return _bounded((x, y, z), most, what)


def _only(values: list[float], mask: int, bits: tuple[int, ...], frame: LocalFrame) -> list[float | None]:
    """Null for the axes that the mask ignores."""
    if frame.turn_deg and bool(mask & bits[0]) != bool(mask & bits[1]):
        raise SetpointError("the fleet's axes are turned: give x and y together")
    return [None if mask & bit else value for bit, value in zip(bits, values, strict=True)]


def _bounded(vector: Vector, most: float, what: str) -> Vector:
    if not all(abs(value) <= most for value in vector):  # false for NaN
        raise SetpointError(f"{what} {vector}: not finite, or beyond {most:g}")
    return vector


def _finite(value: float, what: str) -> float:
    if not math.isfinite(value) or abs(value) > 1000:
        raise SetpointError(f"{what} {value}: not finite")
    return value


def _yaw_rate_dps(rate_radps: float) -> float:
    rate_dps = math.degrees(_finite(rate_radps, "yaw rate"))
    if abs(rate_dps) > FASTEST_TURN_DPS:
        raise SetpointError(f"a yaw rate of {rate_dps:.0f} degrees a second")
    return rate_dps


def _thrust(thrust: float) -> float:
    if not 0 <= thrust <= 1:
        raise SetpointError(f"thrust {thrust}: it must be from 0 to 1")
    return thrust


def _yaw(q: Quaternion) -> float:
    """The yaw of a pose; of one whose orientation was left at zeros, as ROS 1's messages begin, east, as in MAVROS."""
    return 0.0 if q == (0.0, 0.0, 0.0, 0.0) else yaw_of(_unit(q))


def _unit(q: Quaternion) -> Quaternion:
    norm = math.sqrt(sum(value * value for value in q))
    if not 0.9 <= norm <= 1.1:  # false for NaN
        raise SetpointError(f"an orientation of length {norm:.3g}; a unit quaternion is needed")
    w, x, y, z = q
    return w / norm, x / norm, y / norm, z / norm
