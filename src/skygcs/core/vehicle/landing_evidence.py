"""Evidence against a landing: a vehicle that is on the ground and disarmed may have crashed, or have fallen. Pure.

Every firmware reports itself on the ground once it is disarmed, wherever that was (ArduCopter: AP_Arming_Copter::disarm
sets land_complete; PX4: MulticopterLandDetector takes a disarmed vehicle as landed). So neither is a landing by itself:

    it has not landed if                                                         as shown by
    --------------------------------------------------------------------------   ---------------------------------------
    its autopilot says that it has crashed, or has been switched off             STATUSTEXT (`NOT_LANDED_TEXTS`)
    it leans by more than `LEANS_DEG` where it lies (a VTOL may stand so)        ATTITUDE, since it was disarmed
    it was `FELL_M` higher when it was last seen armed                           GLOBAL_POSITION_INT

A text may be lost, and a crash may end upright: each of them alone is enough.
"""

from __future__ import annotations

import math
from collections import deque

from skygcs.core.mavlink.vehicle_class import VehicleClass
from skygcs.core.vehicle.vehicle import Vehicle

NOT_LANDED_TEXTS = (
    "crash: ",  # ArduCopter/crash_check.cpp and Rover/crash_check.cpp: "Crash: Disarming", "Crash: Going to HOLD"
    "crash detected",  # ArduPlane/is_flying.cpp
    "hard landing detected",  # the same, near the place of the landing
    "parachute: released",  # AP_Parachute.cpp
    "disarmed by kill-switch",  # PX4, Commander.cpp: arm_disarm_reason_str
    "disarmed by lockdown",
    "disarmed by failure detector",
)
"""Beginnings of texts, in lower case."""

LEANS_DEG = 45.0
"""No vehicle that has landed leans so far: a copter on its arm or a plane on its wing tip is below 30 degrees."""

FELL_M = 4.0
"""More than what a landing sinks between the position that came last and the touch-down, with the drift of a barometer
(2 m): the last metres are flown with at most 0.7 m/s (LAND_SPEED, MPC_LAND_SPEED), and both firmwares disarm one second
and more after the touch-down."""

LOOKED_BACK_S = 2.0
"""Before it was last seen armed: a heartbeat comes each second and may be late, and then it was disarmed before."""

SETTLED_S = 3.0
"""From when it was last seen armed: texts, attitude and landed state, of which the slowest is sent each two seconds,
have come by then."""


class LandingWatch:
    """One flight's end: `look` some times a second from its start on, then `why_not` and `settled`."""

    def __init__(self, now: float) -> None:
        self._began_at = now
        self._heights: deque[tuple[float, float]] = deque()
        """Times and heights (m, above home) of the last positions while it was armed, of `LOOKED_BACK_S`."""

    def look(self, vehicle: Vehicle) -> None:
        """Note its height while it is armed."""
        position, at = vehicle.timed_telemetry("position")
        if not vehicle.armed or position is None or at is None:
            return
        if not self._heights or at > self._heights[-1][0]:
            self._heights.append((at, position["alt_rel_m"]))
        while len(self._heights) > 1 and self._heights[0][0] < self._heights[-1][0] - LOOKED_BACK_S:
            self._heights.popleft()

    def settled(self, vehicle: Vehicle, now: float) -> bool:
        """True if it has been disarmed long enough for what shows a crash to have come."""
        return not vehicle.armed and now - vehicle.armed_at >= SETTLED_S

    def why_not(self, vehicle: Vehicle) -> str | None:
        """Why it has not landed, although it may be on the ground and disarmed; None: nothing shows that."""
        for text in vehicle.texts:
            if text.at >= self._began_at and text.text.lower().startswith(NOT_LANDED_TEXTS):
                return f"its autopilot reports {text.text!r}"
        if vehicle.armed:
            return None
        attitude, at = vehicle.timed_telemetry("attitude")
        stands_level = vehicle.kind is not VehicleClass.VTOL  # a tail-sitter's pitch may be given either way
        if stands_level and attitude is not None and at is not None and at > vehicle.armed_at:
            upright = math.cos(math.radians(attitude["roll_deg"])) * math.cos(math.radians(attitude["pitch_deg"]))
            if (lean_deg := math.degrees(math.acos(upright))) > LEANS_DEG:
                return f"it lies on its side (it leans by {lean_deg:.0f} degrees)"
        position, at = vehicle.timed_telemetry("position")
        if position is not None and at is not None and at > vehicle.armed_at and self._heights:
            fell_m = max(height_m for _, height_m in self._heights) - position["alt_rel_m"]
            if fell_m > FELL_M:
                return f"it was {fell_m:.0f} m higher when it was last seen armed"
        return None
