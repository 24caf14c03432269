"""Memory of the converters: what they keep of one vehicle between its messages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from skygcs.core.geo import EnuFrame, Quaternion, Vector
from skygcs.core.ros.rotations import yaw_of
from skygcs.core.ros.stamps import VehicleClock

STATUS_NO_FIX, STATUS_FIX = -1, 0
SERVICE_GPS = 1
COVARIANCE_UNKNOWN, COVARIANCE_APPROXIMATED, COVARIANCE_DIAGONAL = 0, 1, 2
"""sensor_msgs' NavSatStatus.status and .service, NavSatFix.position_covariance_type."""

UNKNOWN_COVARIANCE = (-1.0, *(0.0,) * 8)
"""sensor_msgs' sign of a covariance of 3 by 3 that is not known."""


class Sample(NamedTuple):
    """One message: its topic below the namespace of MAVROS ("imu/data"), and its fields."""

    topic: str
    fields: dict[str, Any]


@dataclass(slots=True)
class FrameNames:
    """Frames in the headers; MAVROS' own by default."""

    map: str = "map"
    base_link: str = "base_link"
    earth: str = "earth"


@dataclass(slots=True)
class VehicleMemory:
    """Memory of one vehicle, from its first message on."""

    frames: FrameNames = field(default_factory=FrameNames)
    geoid_m: float | None = None
    """Height of the geoid above the ellipsoid, as it is set; None: as the receiver reports it, else 0."""
    clock: VehicleClock = field(default_factory=VehicleClock)
    autopilot: int = 0
    mav_type: int = 0
    # attitude and inertial measurement
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """FLU to ENU; before the first attitude as MAVROS' message has it."""
    orientation_ns: int | None = None
    """When it was measured, in nanoseconds since 1970; None: it was not, since the connection came up."""
    angular_flu: Vector = (0.0, 0.0, 0.0)
    accel_flu: Vector = (0.0, 0.0, 0.0)
    has_accel: bool = False
    has_highres_imu: bool = False
    has_scaled_imu: bool = False
    has_attitude_quaternion: bool = False
    # position
    fix_status: int = STATUS_NO_FIX
    fix_service: int = SERVICE_GPS
    fix_covariance: tuple[float, ...] = UNKNOWN_COVARIANCE
    fix_covariance_type: int = COVARIANCE_UNKNOWN
    """Values of the newest GPS_RAW_INT; before the first one as MAVROS begins (Data::Data, lib/uas_data.cpp)."""
    receiver_geoid_m: float | None = None
    map_frame: EnuFrame | None = None
    has_local: bool = False
    has_local_cov: bool = False
    # the rest
    has_battery0: bool = False
    has_rc_channels: bool = False
    rc_in: list[int] = field(default_factory=list)
    rc_out: list[int] = field(default_factory=list)

    def after_loss(self) -> VehicleMemory:
        """Memory after the connection was lost: what MAVROS' plugins imu, sys_status and rc_io forget then
        (connection_cb) is gone. The rest stays: the origin of global_position/local does not move in a pause of the
        radio. The orientation stays for MAVROS' messages, and was measured at no known time."""
        return replace(
            self,
            orientation_ns=None,
            has_highres_imu=False,
            has_scaled_imu=False,
            has_attitude_quaternion=False,
            has_battery0=False,
            has_rc_channels=False,
            rc_in=[],
            rc_out=[],
        )

    def yaw_enu_rad(self, now_ns: int, fresh_ns: int) -> float | None:
        """Yaw from east if it was measured in the last ``fresh_ns``; None: it was not, or is not finite. After a step
        of this computer's clock it is not known until the next attitude."""
        if self.orientation_ns is None or abs(now_ns - self.orientation_ns) > fresh_ns:
            return None
        yaw_rad = yaw_of(self.orientation)
        return yaw_rad if math.isfinite(yaw_rad) else None

    @property
    def undulation_m(self) -> float:
        """Return what is added to a height above mean sea level, so that it counts from the ellipsoid."""
        if self.geoid_m is not None:
            return self.geoid_m
        return 0.0 if self.receiver_geoid_m is None else self.receiver_geoid_m


def number(value: Any) -> Any:
    """NaN for None, which is NaN in JSON, also in arrays: covariances begin with NaN when they are unknown, and an
    ArduPilot's home has no orientation."""
    if isinstance(value, (list, tuple)):
        return [math.nan if one is None else one for one in value]
    return math.nan if value is None else value
