"""The offset of another computer's clocks against ours, from requests that it answers with what its clocks show.

NTP's four time stamps (RFC 5905, section 8); the two of the answering side are one here, as it answers at once:

    offset = remote - (sent + received) / 2          |error| <= (received - sent) / 2

The bound holds however the round trip divides into its two ways. It grows with the age of the sample by DRIFT; the
sample with the smallest bound of the last WINDOW_S counts. A new sample that contradicts an older one, beyond the
bounds of both, shows that a clock was set or stood still, as of a paused virtual machine: the older one is dropped.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

WINDOW_S = 60.0

DRIFT = 6e-4
"""Seconds per second by which two clocks may move apart: Linux slews CLOCK_MONOTONIC by up to 500 ppm while NTP
corrects it (adjtimex(2)), and two crystals differ by up to 100 ppm."""

ROUNDING_S = 1e-3
"""Smaller contradictions are ignored: unix seconds as floats are rounded, and the loop's clock counts milliseconds."""

MAX_CLOCK_S = 1e11
"""No clock shows more: unix seconds of the year 5138. What a remote sends may be any number, also one that no float can
hold."""

MAX_SAMPLES = 128
"""Samples that are kept, all within the last minute; one is taken every 2 s."""


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Add ``offset_s`` to a time of our clock to get the remote's, within ``error_s``. ``wall_offset_s``: the same for
    the two wall clocks. ``age_s`` of the sample, and its round trip."""

    offset_s: float
    wall_offset_s: float
    error_s: float
    round_trip_s: float
    age_s: float


@dataclass(frozen=True, slots=True)
class _Sample:
    at: float
    offset_s: float
    wall_offset_s: float
    round_trip_s: float

    def error_s(self, now: float) -> float:
        return self.round_trip_s / 2 + (now - self.at) * DRIFT

    def agrees(self, older: _Sample) -> bool:
        """True if one offset of the clocks explains both."""
        errors_s = self.error_s(self.at) + older.error_s(self.at)
        return abs(self.offset_s - older.offset_s) <= errors_s + ROUNDING_S


class ClockComparison:
    """The samples of the last minute. One object per connection: a remote that restarted has another clock."""

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque(maxlen=MAX_SAMPLES)

    def add(self, sent: float, received: float, remote: float, *, wall_received: float, remote_wall: float) -> bool:
        """One answered request: our clock when it was sent and when the answer came, the remote's between, and both
        wall clocks (ours when the answer came). False, and nothing is kept, if the times cannot be."""
        round_trip_s = received - sent
        possible = all(abs(clock_s) <= MAX_CLOCK_S for clock_s in (remote, remote_wall))  # False for NaN
        if not 0.0 <= round_trip_s <= WINDOW_S or not possible:
            return False
        wall_offset_s = remote_wall - (wall_received - round_trip_s / 2)
        sample = _Sample(received, remote - (sent + received) / 2, wall_offset_s, round_trip_s)
        agreeing = [older for older in self._samples if sample.agrees(older)]
        self._samples = deque([*agreeing, sample], maxlen=MAX_SAMPLES)
        return True

    def best(self, now: float) -> ClockOffset | None:
        """The best estimate now; None without a sample in the last minute."""
        while self._samples and now - self._samples[0].at > WINDOW_S:
            self._samples.popleft()
        if not self._samples:
            return None
        best = min(self._samples, key=lambda sample: sample.error_s(now))
        return ClockOffset(best.offset_s, best.wall_offset_s, best.error_s(now), best.round_trip_s, now - best.at)
