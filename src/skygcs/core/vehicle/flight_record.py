"""Measurements of a vehicle's battery in flight, for the next plan. Pure."""

from __future__ import annotations

LEAST_DROP_PERCENT = 5.0
LEAST_FLIGHT_S = 120.0
"""Least drop and duration of a flight before its consumption is believed: charges are whole percents, and sag at the
take-off."""


class FlightRecord:
    """Record of one vehicle; a restart takes it from the journal."""

    def __init__(self, flown_s: float = 0.0, dropped_percent: float = 0.0) -> None:
        self._flown_s = flown_s
        self._dropped_percent = dropped_percent
        self._last: tuple[float, float] | None = None

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
    def consumption(self) -> tuple[float, float]:
        """Seconds in flight, and the percents of charge that they took."""
        return self._flown_s, self._dropped_percent

    @property
    def flight_time_s(self) -> float | None:
        """How long a full battery lasts by what was consumed in flight; None: too little was flown."""
        if self._flown_s < LEAST_FLIGHT_S or self._dropped_percent < LEAST_DROP_PERCENT:
            return None
        return 100.0 * self._flown_s / self._dropped_percent
