"""Evidence that a disarmed vehicle flies, or has not landed: its heartbeat and its landed state alone show neither.

The armed bit of one heartbeat may be forged, or come from another vehicle. A disarmed autopilot reports itself on the
ground within two seconds (EXTENDED_SYS_STATE of ArduCopter and PX4), stands still and does not turn its motors. If
telemetry contradicts that, control by setpoints orders a hold before it ends, and orders that would be dangerous in the
air need `force`.

Nor is a disarmed vehicle on the ground one that has landed: every firmware reports itself there once it is disarmed,
wherever that was (ArduCopter: AP_Arming_Copter::disarm sets land_complete; PX4: MulticopterLandDetector).

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
from skygcs.core.vehicle.state import AIRBORNE
from skygcs.core.vehicle.vehicle import Vehicle

FRESH_S = 3.0
"""Older telemetry is not used: the slowest stream profile sends 0.5 Hz, and one message may be lost."""

HEIGHT_M = 5.0
"""Height over home that a vehicle on the ground never shows: barometers drift by 1 or 2 m."""

CLIMB_MPS = 1.0
SPEED_MPS = 3.0
"""Faster than a vehicle is carried by hand, and than GPS noise of a standing one."""

THROTTLE_PERCENT = 10

RECENTLY_ARMED_S = 3.0
"""Three heartbeats: by then the landed state has followed as well."""


def flight_evidence(vehicle: Vehicle, now: float) -> str | None:
    """Telemetry that shows the vehicle flying, whatever its armed bit says; None if there is none, or if its class does
    not fly."""
    if not vehicle.abilities.flies:
        return None
    state, at = vehicle.landed_state()
    if state in AIRBORNE and now - at <= FRESH_S:
        return f"it reports itself {'in the air' if state == 'in_air' else 'in ' + state}"
    position, position_at = vehicle.timed_telemetry("position")
    if position is not None and position_at is not None and now - position_at <= FRESH_S:
        east, north, up = position["vel_enu_mps"]
        speed = math.hypot(east, north)
        if position["alt_rel_m"] > HEIGHT_M and position["lat_deg"] is not None:
            return f"it is {position['alt_rel_m']:.0f} m above its home"
        if abs(up) > CLIMB_MPS:
            return f"it {'climbs' if up > 0 else 'sinks'} at {abs(up):.1f} m/s"
        if speed > SPEED_MPS:
            return f"it moves at {speed:.1f} m/s"
    vfr, vfr_at = vehicle.timed_telemetry("vfr")
    turning = vfr is not None and vehicle.abilities.hovers and vfr["throttle_percent"] >= THROTTLE_PERCENT
    if vfr is not None and turning and vfr_at is not None and now - vfr_at <= FRESH_S:
        return f"its throttle is at {vfr['throttle_percent']} %"
    return None


def contradiction(vehicle: Vehicle, now: float) -> str | None:
    """Why it may be flying although its heartbeat shows it disarmed; None if it is armed, or certainly disarmed."""
    if vehicle.armed:
        return None
    if vehicle.duplicate_beside:
        return "two vehicles send with its ids on one link"
    return flight_evidence(vehicle, now)


def why_maybe_flying(vehicle: Vehicle, now: float) -> str | None:
    """Why a heartbeat that shows the vehicle disarmed is doubted; None if it is not."""
    if (evidence := contradiction(vehicle, now)) is not None:
        return f"its heartbeat shows it disarmed, but {evidence}"
    if vehicle.duplicate_elsewhere is not None:
        return f"two vehicles have its system id ({vehicle.duplicate_elsewhere})"
    return None


def why_not_idle(vehicle: Vehicle, now: float) -> str | None:
    """Why the vehicle must be treated as armed, and orders dangerous in the air be refused; None: it is idle."""
    if vehicle.armed:
        return "it is armed"
    if (why := why_maybe_flying(vehicle, now)) is not None:
        return why
    state, at = vehicle.landed_state()
    seen_on_ground = state == "on_ground" and at > vehicle.armed_at
    if 0.0 <= now - vehicle.armed_at <= RECENTLY_ARMED_S and not seen_on_ground:
        return f"it was armed {now - vehicle.armed_at:.1f} s ago: wait until it is seen on the ground"
    return None


# -- landings


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
