"""A pose as VISION_POSITION_ESTIMATE or ODOMETRY, and how many of them fit a link. Pure.

    what              PX4 (1.16)                                     ArduPilot (4.6)
    ---------------   --------------------------------------------   ---------------------------------------------------
    frame of the      NED (mavlink_receiver.cpp); ODOMETRY:          NED; ODOMETRY: only LOCAL_FRD with BODY_FRD
    position          LOCAL_NED is absolute, LOCAL_FRD has its own   (GCS_Common.cpp, handle_odometry), taken as NED
                      yaw, so NED is sent
    time stamp        its clock by its TIMESYNC requests, after 500  JitterCorrection: any steady clock; the least delay
                      answers within 10 ms (lib/timesync); before,   of late is taken for none
                      the time of arrival
    covariance        first one NaN: EKF2_EVP_NOISE, EKF2_EVA_NOISE  first one NaN: VISO_POS_M_NSE, VISO_YAW_M_NSE
    velocity NaN      unknown                                        left out (NavEKF3, writeExtNavVelData)
    estimator_type    MOCAP goes to vehicle_mocap_odometry, which EKF2     not looked at
                      does not read; VISION is sent
    reset_counter     changed: the estimate is reset to the pose     changed: the same

So the time stamp is the moment of the capture by our own clock for both, and PX4's TIMESYNC requests are answered by
that clock. Neither message has a target: every vehicle that hears it takes it for its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from skygcs.core.geo import euler_from_quaternion
from skygcs.ext.mocap.pose import Pose, ned_frd

PoseMessage = Literal["vision_position_estimate", "odometry"]

LOCAL_NED, LOCAL_FRD, BODY_FRD = 1, 20, 12
"""MAV_FRAME."""

VISION = 2
"""MAV_ESTIMATOR_TYPE. Not MOCAP (6): PX4's estimator does not use what came with that (vehicle_mocap_odometry)."""

NAN = math.nan

UNKNOWN_COVARIANCE = (NAN,) + (0.0,) * 20

WIRE_BYTES: Mapping[PoseMessage, int] = {"vision_position_estimate": 129, "odometry": 245}
"""MAVLink 2, unsigned: 12 bytes around 117 and 233 of payload. With reset_counter 0 trailing zeros are cut; after the
first drop-out they are not."""

LINK_SHARE = 0.5
"""Part of a radio's uplink for poses; the other half is for orders, setpoints and heartbeats."""

LEAST_HZ = 10.0
"""Below this a link does not feed an estimator: PX4 drops external vision 0.2 s after a pose (EV_MAX_INTERVAL),
ArduPilot calls it unhealthy after 0.3 s (AP_VISUALODOM_TIMEOUT_MS), and one in ten may be lost."""


def message_of(
    kind: PoseMessage, pose: Pose, family: str, reset_counter: int, latency_s: float
) -> tuple[str, dict[str, Any]]:
    """Name and fields of the message for a pose in ENU. ``latency_s``: of the capture system, by which the
    exposure was earlier."""
    pose = ned_frd(pose)
    usec = max(1, round((pose.at - latency_s) * 1e6))
    x, y, z = pose.pos_m
    if kind == "vision_position_estimate":
        roll, pitch, yaw = euler_from_quaternion(*pose.q)
        return "VISION_POSITION_ESTIMATE", {
            **{"usec": usec, "x": x, "y": y, "z": z, "roll": roll, "pitch": pitch, "yaw": yaw},
            "covariance": list(UNKNOWN_COVARIANCE),
            "reset_counter": reset_counter,
        }
    return "ODOMETRY", {
        **{"time_usec": usec, "x": x, "y": y, "z": z, "q": list(pose.q)},
        **dict.fromkeys(("vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed"), NAN),
        "frame_id": LOCAL_FRD if family == "ardupilot" else LOCAL_NED,
        "child_frame_id": BODY_FRD,
        "pose_covariance": list(UNKNOWN_COVARIANCE),
        "velocity_covariance": list(UNKNOWN_COVARIANCE),
        "reset_counter": reset_counter,
        "estimator_type": VISION,
        "quality": 0,
    }


def rate_that_fits(kind: PoseMessage, wanted_hz: float, uplink_bytes_per_s: float | None, *, signed: bool) -> float:
    """The rate to send at over a link whose uplink carries so much; None: as much as one likes."""
    if uplink_bytes_per_s is None:
        return wanted_hz
    return min(wanted_hz, LINK_SHARE * uplink_bytes_per_s / (WIRE_BYTES[kind] + 13 * signed))
