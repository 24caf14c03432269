"""Which messages a vehicle is asked for: what the operator's picture needs and does not come by itself.

ArduPilot sends little more than heartbeats on a port until somebody asks; PX4 streams by its port's profile. So each
wanted message that is not coming is asked for, one at a time, with growing pauses, and again after a reboot. Nothing
that comes already is slowed down or turned off here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

DEFAULT_RATES_HZ: Mapping[str, float] = {
    "GLOBAL_POSITION_INT": 2.0,
    "ATTITUDE": 1.0,
    "SYS_STATUS": 0.5,
    "GPS_RAW_INT": 0.5,
    "EXTENDED_SYS_STATE": 0.5,
    "SYSTEM_TIME": 0.2,
    "EKF_STATUS_REPORT": 0.2,
    "MISSION_CURRENT": 0.5,
}
"""The nav profile of field-notes 10.2 (200 B/s per vehicle: fourteen on half of 57600 baud), the landed state and the
clock (11 B/s more), and of ArduPilot the estimator (7 B/s more) and the current item of its mission (9 B/s more)."""

ARDUPILOT_ONLY = frozenset({"EKF_STATUS_REPORT", "MISSION_CURRENT"})
"""PX4 tells of its estimator by ESTIMATOR_STATUS and streams MISSION_CURRENT, both by itself."""

STREAM_GROUPS: Mapping[str, int] = {
    "GLOBAL_POSITION_INT": 6,
    "ATTITUDE": 10,
    "SYS_STATUS": 2,
    "GPS_RAW_INT": 2,
    "SYSTEM_TIME": 12,
    "EKF_STATUS_REPORT": 12,
    "MISSION_CURRENT": 2,
}
"""MAV_DATA_STREAM of each message on ArduPilot (GCS_MAVLink stream tables): for firmware that knows no
SET_MESSAGE_INTERVAL."""

LEAST_RATE_HZ = 0.001
"""One in 17 minutes. A positive rate below it has a period that is longer than any flight, or no number at all."""

MAX_RATE_HZ = 1000.0
"""Faster than any autopilot streams."""

GRACE_S = 2.0
"""After a vehicle is met its own streams have this long to show themselves."""

MISSING_AFTER_PERIODS = 3.0
"""A message is missing after this many of its periods (at least MISSING_AFTER_S): two may be lost on a radio."""

MISSING_AFTER_S = 3.0

FIRST_PAUSE_S = 4.0
LONGEST_PAUSE_S = 60.0
"""A message that does not come although it was asked for is asked for ever more rarely: the vehicle may not have it."""

STEP_S = 0.25
"""Between two requests to one vehicle: the shared radio has others to serve."""


def rate_problem(rate_hz: float, most_hz: float = MAX_RATE_HZ) -> str | None:
    """What is wrong with a rate, in words; None: it is 0 (off) or one that a message may have."""
    if rate_hz == 0 or LEAST_RATE_HZ <= rate_hz <= most_hz:
        return None
    return f"must be 0 (off) or {LEAST_RATE_HZ:g} to {most_hz:g} Hz, not {rate_hz:g}"


class StreamRequests:
    """What to ask one vehicle for, and when. ``rates_hz`` by message name; an empty mapping asks for nothing."""

    __slots__ = ("_asked_at", "_met_at", "_pause_s", "_refused", "_stepped_at", "rates_hz")

    def __init__(self, rates_hz: Mapping[str, float]) -> None:
        self.rates_hz = dict(rates_hz)
        self._met_at: float | None = None
        self._stepped_at = float("-inf")
        self._asked_at: dict[str, float] = {}
        self._pause_s: dict[str, float] = {}
        self._refused: set[str] = set()

    def restart(self) -> None:
        """The vehicle rebooted or came back: what it was asked for is forgotten there too."""
        self._met_at = None
        self._asked_at.clear()
        self._pause_s.clear()
        self._refused.clear()

    def refuse(self, name: str) -> None:
        """The vehicle does not know this message, or a person took its rate in hand: it is not asked for again."""
        self._refused.add(name)

    def is_refused(self, name: str) -> bool:
        """See `refuse`."""
        return name in self._refused

    def due(
        self, now: float, last_at: Callable[[str], float | None], *, ardupilot: bool = True
    ) -> tuple[str, float] | None:
        """(message, rate in Hz) to ask for now, or None. ``last_at(name)``: when it last came, None if never.

        ``ardupilot``: whether it is one; what only ArduPilot has is not asked of others.
        """
        if self._met_at is None:
            self._met_at = now
        if now < self._met_at + GRACE_S or now < self._stepped_at + STEP_S:
            return None
        for name, rate_hz in self.rates_hz.items():
            if name in self._refused or (name in ARDUPILOT_ONLY and not ardupilot):
                continue
            if not self._is_missing(name, rate_hz, now, last_at(name)):
                continue
            asked_at = self._asked_at.get(name)
            pause_s = self._pause_s.get(name, FIRST_PAUSE_S)
            if asked_at is not None:
                if now < asked_at + pause_s:
                    continue
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
            self._asked_at[name] = now
            self._pause_s[name] = pause_s
            self._stepped_at = now
            return name, rate_hz
        return None

    def _is_missing(self, name: str, rate_hz: float, now: float, last_at: float | None) -> bool:
        if rate_hz <= 0:
            return False
        limit_s = max(MISSING_AFTER_S, MISSING_AFTER_PERIODS / rate_hz)
        if last_at is not None and now - last_at <= limit_s:
            self._asked_at.pop(name, None)
            self._pause_s.pop(name, None)
            return False
        return True
