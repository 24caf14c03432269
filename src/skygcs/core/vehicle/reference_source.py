"""Where the reference of flight control comes from: a place to hold, or a stream of setpoints. Pure.

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
"""

from __future__ import annotations

import math
from dataclasses import replace

from skygcs.core.control.cascade import ZERO, Reference, Vector
from skygcs.core.vehicle.estimate_view import EstimateView
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.trajectory_flight import TrajectoryFlight

MOST_AHEAD_M = 2.0
"""Largest lead of a position that is integrated from a velocity, ahead of the vehicle that follows it. The distance
that the vehicle needs to reach that speed is added. Wind and an estimator that wanders make about 1 m."""

MOST_AHEAD_RAD = math.radians(60.0)
"""The same of a yaw that turns with a rate alone: from half a turn on the vehicle would turn the other way."""


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
