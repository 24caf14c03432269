"""Measured tracking error and setpoint delay of a vehicle: terms of margins.

    tracking error   distance of each reported position, at most every 0.2 s under control, from the reference of the
                     time at which it was measured: its reception less the downlink's delay. p99 while the reference
                     moves, or p99 while it stands and the vehicle has come to it, whichever is larger: a height that
                     wanders in hover by more than a moving vehicle is off must not be averaged away
    delay            p99 of the round trips of pings less half of the shortest: what a setpoint takes at most, if uplink
                     and downlink of the quickest ping took alike long

Compared with the present reference, positions of 2 Hz would count 0.3 to 0.4 m on a circle on which the vehicle is 0.22
m off (simulated).

The last half hour to hour of it counts. Until enough was measured there is no answer, and defaults hold. Pure.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from skygcs.core.quantile import QuantileSketch
from skygcs.core.trajectory.piecewise import Vector
from skygcs.core.vehicle.offboard_controller import OffboardController

SAMPLE_S = 0.2
"""From one distance to the next. Errors change over a second or two, so more of them would say nothing new."""

EARLY_S = 0.01
"""A position that comes so little before its time counts."""

LEAST_S = 60.0
LEAST_ERRORS = 100
"""A minute of moving references, and so many distances: the 99th percentile of a hundred is the second largest."""

LEAST_TRIPS = 100
"""The 99th percentile of a hundred is the second largest."""

ARRIVED_M = 0.5
"""So near to a reference that stands, a vehicle has come to it; from then on its distance is an error and no way."""

SAME_PLACE_M = 0.01
"""A reference that stands and is farther from where it was is another place."""

WINDOW = 9_000
"""Distances: half an hour at five a second. Round trips come once a second or five times."""

PERCENTILE = 0.99

NOTE_S, NOTES = 0.04, 64
"""References that are kept, 2.5 s of them: a position is older only if its link is too slow for control. Between two of
them a circle of 5 m at 2 m/s bends by 0.2 mm, and by 4 mm between those of 5 Hz."""


class _Note(NamedTuple):
    """The reference at one time."""

    at: float
    place: Vector
    moves: bool


class TrackingRecord:
    """Tracking record of one vehicle."""

    def __init__(self) -> None:
        self._moving_m = QuantileSketch(0.001, 100.0, WINDOW)
        self._standing_m = QuantileSketch(0.001, 100.0, WINDOW)
        self._stands_at: Vector | None = None
        """The place of a reference that stands, if the vehicle has come to it."""
        self._trips_s = QuantileSketch(0.0001, 10.0, WINDOW)
        self._notes: deque[_Note] = deque(maxlen=NOTES)
        self._measured_at = -math.inf
        """When the position was measured that counted last."""
        self._moving_s = 0.0
        self._counted, self._counted_s = 0, 0.0
        """Distances, and the time between them."""

    def observe(self, controller: OffboardController, now: float) -> None:
        """Note, in every tick of control, the reference, and the distance of a new position if one is due."""
        reference = controller.reference
        if reference is None or reference.velocity_only:
            self._notes.clear()
            self._stands_at = None
            return
        if not self._notes or now - self._notes[-1].at >= NOTE_S:
            x, y, z = reference.pos_enu_m
            self._notes.append(_Note(now, (x, y, z), reference.moves))
        measured = controller.measured()
        if measured is None or measured[1] - self._measured_at < SAMPLE_S - EARLY_S:
            return
        here, at = measured
        then = self._reference_at(at)
        if then is not None:
            since_s = min(at - self._measured_at, 1.0)
            self._measured_at = at
            self._count(here, then, since_s)

    def _reference_at(self, at: float) -> _Note | None:
        """The reference at an earlier time, between the two notes around it; None if that is not known."""
        later: _Note | None = None
        for note in reversed(self._notes):
            if note.at <= at:
                if later is None or later.at <= note.at:
                    return note
                part = (at - note.at) / (later.at - note.at)
                (x, y, z), (u, v, w) = note.place, later.place
                place = (x + (u - x) * part, y + (v - y) * part, z + (w - z) * part)
                return _Note(at, place if later.moves or note.moves else note.place, note.moves or later.moves)
            later = note
        return None

    def _count(self, here: Vector, reference: _Note, since_s: float) -> None:
        off_m = math.dist(reference.place, here)
        if reference.moves:
            self._stands_at = None
            self._moving_s += since_s
            self._moving_m.add(off_m)
        else:
            if self._stands_at is None or math.dist(reference.place, self._stands_at) > SAME_PLACE_M:
                self._stands_at = reference.place if off_m <= ARRIVED_M else None
            if self._stands_at is None:
                return
            self._standing_m.add(off_m)
        self._counted += 1
        self._counted_s += since_s

    def on_round_trip(self, trip_s: float) -> None:
        self._trips_s.add(trip_s)

    @property
    def tracking_error_m(self) -> float | None:
        """99th percentile of the tracking error; None before it was measured for a minute of moving references."""
        if self._moving_s < LEAST_S or len(self._moving_m) < LEAST_ERRORS:
            return None
        moving_m, standing_m = self._moving_m.at_most(PERCENTILE), None
        if len(self._standing_m) >= LEAST_ERRORS:
            standing_m = self._standing_m.at_most(PERCENTILE)
        assert moving_m is not None
        return max(moving_m, standing_m or 0.0)

    @property
    def measured_s(self) -> float:
        """Time over which the tracking error that counts was measured."""
        counting = len(self._moving_m) + len(self._standing_m)
        return 0.0 if not self._counted else counting * self._counted_s / self._counted

    @property
    def delay_s(self) -> float | None:
        """99th percentile of the delay; None before a hundred round trips."""
        if len(self._trips_s) < LEAST_TRIPS:
            return None
        longest, shortest = self._trips_s.at_most(PERCENTILE), self._trips_s.at_least()
        assert longest is not None and shortest is not None
        return longest - 0.5 * shortest

    @property
    def round_trips(self) -> int:
        """Number of round trips from which the delay was measured."""
        return len(self._trips_s)
