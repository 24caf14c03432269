"""Bumpless transfer: the thrust that control begins with, and the attitude in which it hands over. Pure.

**Begin** (`SteadyThrust`). A vehicle that hovers in the wind leans into it; its throttle is its true hover thrust. With
an integral of 0 it would drift with the wind, and sink or climb by the error of its hover thrust. So the mean thrust
vector of the last seconds, less what accelerated the vehicle meanwhile, becomes the integral: entry and each return to
attitude are bumpless.

    tilt        ATTITUDE, as it comes; nothing older than FRESH_S counts
    throttle    ATTITUDE_TARGET.thrust where it comes; ArduCopter shows it before its angle boost, which divides it by
                the cosine of the tilt (GCS_MAVLINK_Copter::send_attitude_target: get_throttle_in)
                else VFR_HUD.throttle, in whole percent and cut off by both (ArduCopter: after the boost)
                else the hover thrust of the law: the tilt alone is used, and the vertical integral begins at 0

**End** (`handover_attitude`). The position controller of an ArduCopter that gets control back takes the lean it finds
for the one that holds it against the wind, and begins its integral with it (AC_PosControl::init_xy_controller, 4.6.3).
With PSC_VELXY_P 2 and PSC_VELXY_I 1 a wrong lean of a decays as dv = a t exp(-t): a vehicle that leans into a step by 2
m/s² gets 0.7 m/s faster and 2 m farther before it begins to stop, one at 35 degrees 2.5 m/s and 7 m. So for HANDOVER_S
it is given the lean that its law had found against the wind, and against its motion what brakes it: the integral then
begins with braking.

A PX4 begins with no integral (1.16: resetIntegral while it flies an attitude), but changes its controllers with its
status alone, twice a second (Commander.cpp: run, updateControlMode): for up to 0.5 s it flies the last attitude on. So
that is the same lean, sent for LAST_ATTITUDE_S.

Nothing is closed over the link meanwhile: the attitude is worked out once. If nothing reaches the vehicle after it, it
keeps that lean for GUID_TIMEOUT and levels; the lean brakes to a standstill in that time at most.
"""

from __future__ import annotations

import math
from collections import deque

from skygcs.core.control.cascade import Estimate, Memory, Quaternion, Vector, attitude_from_thrust, ned_frd_from_enu_flu
from skygcs.core.control.gains import GRAVITY_MPS2, ControlConfig
from skygcs.core.control.velocity_loop import clip, within
from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.offboard_entry import boosts_thrust
from skygcs.core.vehicle.setpoint import LEAST_BOOST_COSINE
from skygcs.core.vehicle.vehicle import Vehicle

# --- steady thrust ----------------------------------------------------------------------------------------------------

WINDOW_S = 2.0
"""Over which the thrust is averaged: some swings of an autopilot's own position loop, little of a changing wind."""

FRESH_S = 1.0
"""The newest attitude must not be older: 1 Hz is what the nav profile streams."""

THROTTLE_FRESH_S = 2.0
"""Nor the throttle, which changes less than the tilt."""

LEAST_SPAN_S = 0.4
"""Between the first and the last velocity, to distinguish an acceleration from their steps of 1 cm/s."""

MAX_SAMPLES = 200
"""2 s at 100 Hz."""

LARGEST_TILT_COSINE = 0.5
"""60 degrees: no hover, and not averaged."""

THROTTLES = (0.05, 1.0)
"""Range of the throttle of a vehicle in the air; a value outside it is no throttle."""


class SteadyThrust:
    """Steady thrust of one vehicle. `observe` in every tick that does not fly by attitude."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._attitude: Frame | None = None
        self._samples: deque[tuple[float, Vector, Vector]] = deque(maxlen=MAX_SAMPLES)
        """When, thrust and velocity (ENU)."""

    def forget(self) -> None:
        """Begin anew."""
        self._samples.clear()

    def observe(self, law: ControlConfig, estimate: Estimate | None, now: float) -> None:
        """A tick; counts if an attitude came since the last."""
        slot = self._vehicle.slot("ATTITUDE")
        if slot is None or slot.frame is self._attitude or estimate is None or not estimate.usable:
            return
        self._attitude = slot.frame
        roll, pitch, yaw = self._vehicle.message_cache.values(slot)[1:4] or (math.nan,) * 3
        cosine = math.cos(roll) * math.cos(pitch) if math.isfinite(roll + pitch + yaw) else 0.0
        if now - slot.at > FRESH_S or cosine < LARGEST_TILT_COSINE:
            return
        thrust = self._collective(cosine, now) or law.hover_thrust / cosine
        north = -(math.cos(roll) * math.sin(pitch) * math.cos(yaw) + math.sin(roll) * math.sin(yaw))
        east = -(math.cos(roll) * math.sin(pitch) * math.sin(yaw) - math.sin(roll) * math.cos(yaw))
        while self._samples and not 0.0 <= now - self._samples[0][0] <= WINDOW_S:
            self._samples.popleft()
        self._samples.append((now, (thrust * east, thrust * north, thrust * cosine), estimate.vel_enu_mps))

    def memory(self, law: ControlConfig, now: float) -> Memory:
        """Return what the law shall begin with, within its limits; nothing remembered where nothing fresh is known."""
        samples = [sample for sample in self._samples if 0.0 <= now - sample[0] <= WINDOW_S]
        if not samples or now - samples[-1][0] > FRESH_S:
            return Memory()
        (first_at, _, first), (last_at, _, last) = samples[0], samples[-1]
        span_s = last_at - first_at
        weight = law.hover_thrust / GRAVITY_MPS2 / span_s if span_s >= LEAST_SPAN_S else 0.0
        east, north, up = (
            sum(thrust[axis] for _, thrust, _ in samples) / len(samples) - weight * (last[axis] - first[axis])
            for axis in range(3)
        )
        size, bound = math.hypot(east, north), law.integral_xy_max
        scale = bound / size if size > bound else 1.0
        return Memory((east * scale, north * scale, clip(up - law.hover_thrust, law.thrust_max)))

    def _collective(self, cosine: float, now: float) -> float | None:
        """Thrust along the body's axis, as the vehicle reports it; None if it does not."""
        target, hud = self._vehicle.slot("ATTITUDE_TARGET"), self._vehicle.slot("VFR_HUD")
        values = self._vehicle.message_cache.values
        thrust = math.nan
        if target is not None and now - target.at <= THROTTLE_FRESH_S:
            thrust = (values(target) or (math.nan,))[-1]
            if boosts_thrust(self._vehicle):
                thrust /= max(LEAST_BOOST_COSINE, cosine)
        elif hud is not None and now - hud.at <= THROTTLE_FRESH_S:
            thrust = (values(hud)[3:4] or (math.nan,))[0] / 100.0 + 0.005
        return thrust if THROTTLES[0] <= thrust <= THROTTLES[1] else None


# --- handover attitude ------------------------------------------------------------------------------------------------


HANDOVER_S = 0.3
"""The attitude follows with 0.15 s: 86 % of the way."""

LAST_ATTITUDE_S = 0.05
"""One message, or two."""

BRAKING_MPS2 = 2.5
"""Deceleration, the same with which ArduCopter itself brakes (WPNAV_ACCEL): a lean of 14 degrees."""

LEAST_TIME_S = 0.5
"""In which a lean may brake to a standstill, if GUID_TIMEOUT is shorter."""


def handover_s(vehicle: Vehicle) -> float:
    """How long the handover's attitude is sent."""
    return LAST_ATTITUDE_S if vehicle.family == "px4" else HANDOVER_S


def handover_attitude(
    law: ControlConfig, integral_enu: Vector, vel_enu_mps: Vector, yaw_enu_rad: float, loss_timeout_s: float
) -> tuple[Quaternion, float]:
    """Attitude (FRD body in NED world) and collective thrust: the steady ones of the law's integral, and a lean against
    the horizontal velocity."""
    vx, vy, _ = vel_enu_mps
    weight = law.hover_thrust / GRAVITY_MPS2
    # per m/s of velocity
    braking = weight * min(1.0 / max(loss_timeout_s, LEAST_TIME_S), BRAKING_MPS2 / max(math.hypot(vx, vy), 1e-9))
    up = within(law.hover_thrust + integral_enu[2], law.thrust_min, law.thrust_max)
    east, north = integral_enu[0] - braking * vx, integral_enu[1] - braking * vy
    most, size = up * law.tilt_max_tan, math.hypot(east, north)
    if size > most:
        east, north = east * most / size, north * most / size
    thrust = (east, north, up)
    attitude, _, _ = attitude_from_thrust(thrust, yaw_enu_rad)
    return ned_frd_from_enu_flu(attitude), min(math.hypot(*thrust), law.thrust_max)
