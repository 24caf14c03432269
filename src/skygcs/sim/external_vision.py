"""Fusion of motion-capture poses by a simulated autopilot: does its estimator have a position from them? Pure.

    what                          PX4                                        ArduCopter
    ---------------------------   ----------------------------------------   -----------------------------------------
    flies by poses                EKF2_EV_CTRL bit 0, and no GPS             VISO_TYPE 1, EK3_SRC1_POSXY 6
    ODOMETRY                      any frame; here LOCAL_NED                  LOCAL_FRD with BODY_FRD only
                                  of a visual estimator: one of MOCAP       (GCS_Common.cpp, handle_odometry)
                                  is for other estimators than EKF2
    kept after the last pose      0.4 s (ev_control.cpp, 2 EV_MAX_INTERVAL)  0.3 s (AP_VISUALODOM_TIMEOUT_MS)
    begins with                   two within 0.2 s                           the same here

A pose that is not where the vehicle is, by more than GATE_M or GATE_RAD, is not fused, as by an estimator's innovation
gate: wrong frames show as a vehicle without a position. The estimate itself stays the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import dist, isfinite
from typing import Any

from skygcs.sim import protocol as m
from skygcs.sim.body import wrap_pi

GATE_M = 0.8
"""EKF2_EVP_GATE 5 times EKF2_EVP_NOISE 0.1 and its own uncertainty; VISO_POS_M_NSE 0.2."""

GATE_RAD = 0.3
INTERVAL_S = 0.2

KEPT_S = {m.MAV_AUTOPILOT_PX4: 0.4, m.MAV_AUTOPILOT_ARDUPILOTMEGA: 0.3}

LOCAL_FRD, BODY_FRD = 20, 12
"""MAV_FRAME."""

VISUAL = frozenset({0, 1, 2, 3})
"""MAV_ESTIMATOR_TYPE that PX4 publishes as vehicle_visual_odometry, which EKF2 reads (mavlink_receiver.cpp)."""


class ExternalVision:
    """The poses of one vehicle since it started."""

    __slots__ = ("_autopilot", "_began", "count", "last_at", "rejected", "reset_counter", "resets", "usec")

    def __init__(self, autopilot: int) -> None:
        self._autopilot = autopilot
        self._began = False
        self.count = 0
        self.rejected = 0
        self.resets = 0
        self.reset_counter = 0
        self.last_at: float | None = None
        self.usec: list[int] = []
        """Time stamps of the last poses."""

    def usable(self, now: float) -> bool:
        """True if the estimator has a position by poses."""
        return self._began and self.last_at is not None and now - self.last_at <= KEPT_S[self._autopilot]

    def takes(self, name: str, fields: Mapping[str, Any]) -> bool:
        """True if the firmware reads this message at all."""
        if name != "ODOMETRY":
            return True
        if self._autopilot == m.MAV_AUTOPILOT_PX4:
            return int(fields["estimator_type"]) in VISUAL
        return (int(fields["frame_id"]), int(fields["child_frame_id"])) == (LOCAL_FRD, BODY_FRD)

    def on_pose(
        self,
        pos_ned_m: tuple[float, float, float],
        yaw_rad: float,
        true_ned_m: tuple[float, float, float],
        true_yaw_rad: float,
        now: float,
    ) -> None:
        """A pose in its local frame, beside what is true."""
        self.count += 1
        near = all(map(isfinite, (*pos_ned_m, yaw_rad))) and dist(pos_ned_m, true_ned_m) <= GATE_M
        if not near or abs(wrap_pi(yaw_rad - true_yaw_rad)) > GATE_RAD:
            self.rejected += 1
            return
        together = self.last_at is not None and now - self.last_at <= INTERVAL_S
        self._began = together or (self._began and self.usable(now))
        self.last_at = now

    def stamp(self, usec: int, reset_counter: int) -> None:
        """Note the time and the reset counter that came with a pose."""
        if reset_counter != self.reset_counter:
            self.resets += 1
            self.reset_counter = reset_counter
        self.usec = [*self.usec[-99:], usec]
