"""Where the reference of flight control comes from, and how control begins and ends without a bump. Pure.

The reference is a place to hold, or a stream of setpoints:

source    reference                                   what ends it
-------   -----------------------------------------   ---------------------------------------------------------
hold      a point on earth, at rest                   `follow` -> stream
stream    the newest setpoint of a client, moved on   its deadline, `stop` -> hold where the vehicle comes to rest;
          by its velocity and acceleration since it   `hold_at` -> hold there
          came
trajectory the point of its clock's time               its end, `stop` -> hold there; `hold_at`, `follow`

An axis that follows a velocity alone has a position all the same: where that velocity has led since it began. Nothing
but `position` setpoints use it, which thereby close no loop on the ground. It is kept near enough to the vehicle that
one which cannot fly so fast has no distance to make up for afterwards.

Bumpless transfer: the thrust that control begins with, and the attitude in which it hands over.

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
from dataclasses import replace

from skygcs.core.control.cascade import (
    ZERO,
    Estimate,
    Memory,
    Quaternion,
    Reference,
    Vector,
    attitude_from_thrust,
    ned_frd_from_enu_flu,
)
from skygcs.core.control.gains import GRAVITY_MPS2, ControlConfig
from skygcs.core.control.velocity_loop import clip, within
from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle.estimate_view import EstimateView
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_entry import boosts_thrust
from skygcs.core.vehicle.setpoint import LEAST_BOOST_COSINE
from skygcs.core.vehicle.trajectory_flight import TrajectoryFlight
from skygcs.core.vehicle.vehicle import Vehicle

MOST_AHEAD_M = 2.0
"""Largest lead of a position that is integrated from a velocity, ahead of the vehicle that follows it. The distance
that the vehicle needs to reach that speed is added. Wind and an estimator that wanders make about 1 m."""

MOST_AHEAD_RAD = math.radians(60.0)
"""Largest lead of a yaw that turns with a rate alone: from half a turn on the vehicle would turn the other way."""


class ReferenceSource:
    """The reference of one vehicle, in the local frame of its `EstimateView`; times are the loop's."""

    def __init__(self, estimate_view: EstimateView) -> None:
        self.reference = Reference()
        """Reference of the last `advance`, `follow` or end of a stream."""
        self._estimate_view = estimate_view
        self._newest = self.reference
        """Reference at the time ``_at``."""
        self._at = 0.0
        self._until: float | None = None
        self.flight: TrajectoryFlight | None = None
        """The trajectory that leads it; None: none does."""

    @property
    def streaming(self) -> bool:
        """True if a stream of setpoints moves the reference now."""
        return self._until is not None

    @property
    def velocity_only(self) -> bool:
        """True if at least one axis follows a velocity and has no position."""
        return self.reference.velocity_only

    def hold_at(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> None:
        """Hold a point on earth; None keeps the yaw."""
        yaw = self._yaw_rad() if yaw_enu_rad is None else yaw_enu_rad
        self._hold(self._estimate_view.in_local_frame(place), yaw)

    def reference_of(self, setpoint: Setpoint, now: float) -> Reference:
        """The reference of a new setpoint of a stream."""
        before = self.advance(now)
        rate = setpoint.yaw_rate_enu_radps or 0.0
        yaw = setpoint.yaw_enu_rad
        turning = yaw is None and rate != 0.0
        if yaw is None:
            yaw = before.yaw_rad if before.yaw_rate_only and turning else self._yaw_rad()
        return Reference(
            self._position(setpoint, before, now),
            yaw,
            setpoint.vel_enu_mps or ZERO,
            setpoint.acc_enu_mps2 or ZERO,
            velocity_only_xy=setpoint.free_xy,
            velocity_only_z=setpoint.free_z,
            yaw_rate_radps=rate,
            yaw_rate_only=turning,
        )

    def follow(self, reference: Reference, now: float, until: float) -> None:
        """The newest reference of a stream, valid ``until`` then."""
        self.reference = self._newest = reference
        self._at, self._until, self.flight = now, until, None

    def follow_trajectory(self, flight: TrajectoryFlight, now: float) -> None:
        """Follow a trajectory from now on."""
        self._until, self.flight = None, flight
        self.reference = self._newest = flight.reference(now, self._yaw_rad())

    def advance(self, now: float) -> Reference:
        """Move the reference of a stream or a trajectory on to ``now``, at most to its end. The reference."""
        if self.flight is not None:
            self.reference = self._newest = self.flight.reference(now, self.reference.yaw_rad)
            if self.flight.over(now):
                self._hold(self.reference.pos_enu_m, self.reference.yaw_rad)
            return self.reference
        if self._until is None:
            return self.reference
        at = min(now, self._until)
        if at > self._at and (self._newest.moves or self._newest.yaw_rate_radps):
            self.reference = self._near(self._newest.ahead(at - self._at), now)
            if self.reference.velocity_only or self.reference.yaw_rate_only:
                self._newest, self._at = self.reference, at  # what was cut off in front of the vehicle is gone
        return self.reference

    def stop(self, now: float, yaw_rad: float | None = None) -> None:
        """Hold where the vehicle comes to rest if it brakes now; None keeps the yaw."""
        position = self._estimate_view.stopping_place(now)
        yaw = self._yaw_rad() if yaw_rad is None else yaw_rad
        self._hold(self.reference.pos_enu_m if position is None else position, yaw)

    def end_stream(self) -> None:
        """End the stream; the reference, at rest, remains in the status."""
        self._hold(self.reference.pos_enu_m, self.reference.yaw_rad)

    def expire(self, now: float) -> bool:
        """End a stream whose deadline has passed, as `stop` does. True in the tick in which that happens."""
        if self._until is None or now <= self._until:
            return False
        self.stop(now)
        return True

    def _hold(self, position: Vector, yaw_rad: float) -> None:
        self.reference = self._newest = Reference(position, yaw_rad)
        self._until = self.flight = None

    def _yaw_rad(self) -> float:
        """The yaw to keep: of a vehicle that turned by a rate alone the one it has, else the reference's."""
        return self._estimate_view.yaw_rad() if self.reference.yaw_rate_only else self.reference.yaw_rad

    def _position(self, setpoint: Setpoint, before: Reference, now: float) -> Vector:
        """Position of a new setpoint: its place, and for an axis without one where velocities have led so far. They
        begin where the vehicle is."""
        given = before.pos_enu_m if setpoint.place is None else self._estimate_view.in_local_frame(setpoint.place)
        if not (setpoint.free_xy or setpoint.free_z):
            return given
        here = self._estimate_view.place_at_arrival(now) or before.pos_enu_m
        x, y, z = given
        if setpoint.free_xy:
            x, y, _ = before.pos_enu_m if before.velocity_only_xy and self.streaming else here
        if setpoint.free_z:
            z = before.pos_enu_m[2] if before.velocity_only_z and self.streaming else here[2]
        return x, y, z

    def _near(self, reference: Reference, now: float) -> Reference:
        """The reference, kept near the vehicle where it follows a velocity or a rate alone."""
        if reference.yaw_rate_only:
            yaw = self._estimate_view.yaw_rad()
            off = math.remainder(reference.yaw_rad - yaw, math.tau)
            reference = replace(reference, yaw_rad=yaw + max(-MOST_AHEAD_RAD, min(off, MOST_AHEAD_RAD)))
        here = self._estimate_view.place_at_arrival(now)
        if here is None or not reference.velocity_only:
            return reference
        x, y, z = reference.pos_enu_m
        dx, dy, dz = (abs(d) for d in self._estimate_view.braking_offset(reference.vel_enu_mps, now))
        if reference.velocity_only_xy:
            most, off = MOST_AHEAD_M + math.hypot(dx, dy), math.hypot(x - here[0], y - here[1])
            if off > most:
                x, y = here[0] + (x - here[0]) * most / off, here[1] + (y - here[1]) * most / off
        if reference.velocity_only_z:
            most = MOST_AHEAD_M + dz
            z = max(here[2] - most, min(z, here[2] + most))
        return replace(reference, pos_enu_m=(x, y, z))


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
        """The memory with which the law begins, within its limits; an empty one without a fresh attitude."""
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
