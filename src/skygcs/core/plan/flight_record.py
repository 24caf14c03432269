"""What is measured of a vehicle in flight for the next plan: tracking errors, the delay of its link, its consumption.
Pure."""

from __future__ import annotations

import math
from collections import deque

MAX_ERRORS = 3000
"""Ten minutes at five a second."""

LEAST_ERRORS = 200
"""Of fewer the 99th percentile is one of the two largest."""

LEAST_DROP_PERCENT = 5.0
LEAST_FLIGHT_S = 120.0
"""Of a flight, before its consumption is believed: charges are whole percents, and sag at the take-off."""


class FlightRecord:
    """Of one vehicle, as long as the daemon runs."""

    def __init__(self) -> None:
        self.delay_s: float | None = None
        """95th percentile of the newest round trips: the delay of one direction is longer in less than one of 100
        cases, where both are alike."""
        self._errors_m: deque[float] = deque(maxlen=MAX_ERRORS)
        self._flown_s = 0.0
        self._dropped_percent = 0.0
        self._last: tuple[float, float] | None = None

    def tracked(self, error_m: float) -> None:
        """One tracking error on the way."""
        if math.isfinite(error_m):
            self._errors_m.append(error_m)

    @property
    def tracking_error_m(self) -> float | None:
        """p99; None with too few."""
        if len(self._errors_m) < LEAST_ERRORS:
            return None
        return sorted(self._errors_m)[math.ceil(0.99 * len(self._errors_m)) - 1]

    def charge(self, now: float, percent: float | None, *, in_air: bool) -> None:
        """The charge as reported now; a rise (another battery) begins anew."""
        if percent is None or not in_air:
            self._last = None
            return
        if self._last is not None:
            then, before = self._last
            if percent > before:
                self._flown_s = self._dropped_percent = 0.0
            else:
                self._flown_s += now - then
                self._dropped_percent += before - percent
        self._last = (now, percent)

    @property
    def flight_time_s(self) -> float | None:
        """How long a full battery lasts by what was consumed in flight; None: too little was flown."""
        if self._flown_s < LEAST_FLIGHT_S or self._dropped_percent < LEAST_DROP_PERCENT:
            return None
        return 100.0 * self._flown_s / self._dropped_percent
