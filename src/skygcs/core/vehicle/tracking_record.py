"""How well a vehicle was seen to follow moving references, and how late setpoints reach it: what margins are made of.

    tracking error   distance from the reference every 0.2 s under control; p99 while the reference moves, or p99 while
                     it stands and the vehicle has come to it, whichever is larger: a height that wanders in hover by
                     more than a moving vehicle is off must not be averaged away
    delay            p99 of the round trips of pings less half of the shortest: what a setpoint takes at most, if uplink
                     and downlink of the quickest ping took alike long

The last half hour to hour of it counts. Until enough was measured there is no answer, and defaults hold. Pure.
"""

from __future__ import annotations

import math

from skygcs.core.quantile import QuantileSketch
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.offboard_controller import OffboardController

SAMPLE_S = 0.2
"""From one distance to the next. Errors change over a second or two, so more of them would say nothing new."""

EARLY_S = 0.01
"""A tick that comes so little before its time counts: at 10 Hz every second one is due."""

LEAST_ERRORS = 300
"""A minute of moving references: three of them are above the 99th percentile."""

LEAST_TRIPS = 100
"""The 99th percentile of a hundred is the second largest."""

ARRIVED_M = 0.5
"""So near to a reference that stands, a vehicle has come to it; from then on its distance is an error and no way."""

SAME_PLACE_M = 0.01
"""A reference that stands and is farther from where it was is another place."""

WINDOW = 9_000
"""Distances: half an hour. Round trips come once a second or five times."""

PERCENTILE = 0.99


class TrackingRecord:
    """Of one vehicle."""

    def __init__(self) -> None:
        self._moving_m = QuantileSketch(0.001, 100.0, WINDOW)
        self._standing_m = QuantileSketch(0.001, 100.0, WINDOW)
        self._stands_at: Vector | None = None
        """The place of a reference that stands, if the vehicle has come to it."""
        self._trips_s = QuantileSketch(0.0001, 10.0, WINDOW)
        self._next_at = -math.inf

    def observe(self, controller: OffboardController, now: float) -> None:
        """In every tick of control: the distance from the reference, if one is due."""
        if EARLY_S < self._next_at - now <= SAMPLE_S:
            return
        self._next_at = now + SAMPLE_S
        reference, here = controller.reference, controller.here(now)
        if reference is None or here is None or reference.velocity_only:
            self._stands_at = None
            return
        place, off_m = reference.pos_enu_m, math.dist(reference.pos_enu_m, here)
        if reference.moves:
            self._stands_at = None
            self._moving_m.add(off_m)
            return
        if self._stands_at is None or math.dist(place, self._stands_at) > SAME_PLACE_M:
            self._stands_at = (place[0], place[1], place[2]) if off_m <= ARRIVED_M else None
        if self._stands_at is not None:
            self._standing_m.add(off_m)

    def on_round_trip(self, trip_s: float) -> None:
        self._trips_s.add(trip_s)

    @property
    def tracking_error_m(self) -> float | None:
        """p99; None before it was measured for a minute of moving references."""
        if len(self._moving_m) < LEAST_ERRORS:
            return None
        moving_m, standing_m = self._moving_m.at_most(PERCENTILE), None
        if len(self._standing_m) >= LEAST_ERRORS:
            standing_m = self._standing_m.at_most(PERCENTILE)
        assert moving_m is not None
        return max(moving_m, standing_m or 0.0)

    @property
    def measured_s(self) -> float:
        """Over how long the tracking error was measured."""
        return (len(self._moving_m) + len(self._standing_m)) * SAMPLE_S

    @property
    def delay_s(self) -> float | None:
        """p99; None before a hundred round trips."""
        if len(self._trips_s) < LEAST_TRIPS:
            return None
        longest, shortest = self._trips_s.at_most(PERCENTILE), self._trips_s.at_least()
        assert longest is not None and shortest is not None
        return longest - 0.5 * shortest

    @property
    def round_trips(self) -> int:
        """How many the delay comes from."""
        return len(self._trips_s)
