"""The delay by which the guard judges attitude: age of the state, and the setpoint's way to the vehicle.

    tick    age of the newest state     ─> window of 3 s                     ┐
    ping    token, remembered           ─> at most 64 under way              ├─> delay p95 = p95(ages) + share · rtt
    pong    now - sent, once per token  ─> those of 21 s, none for 5 s: none ┘   rtt = max(p95(trips), bound)
    else    a token nobody sent, a second pong, one older than 5 s, a clock that ran backwards: counted or dropped

Round trips are measured by TIMESYNC or PING: five in the first second, then one a second, or five a second while `fast`
is set (attitude is flown and the link bears it: two messages of 28 B, 140 B/s each way). The last 21 count, or five
times as many. Of 21 the 95th percentile is the second largest: one late pong is an accident, two are the link; of 101
it is the sixth.

A missing pong means a lost ping or a slow link; one ping alone does not show which. When the oldest ping since the last
answer is overdue (20 ms later than p95), probes go out 20 times a second, and the age of the seventh ping without an
answer is a lower bound of the round trip. Links keep their order, so a pong proves that the pings before its own were
lost. Probes count for the bound only, not among the trips: they are sent just when the link is slow, and would make one
pause of it look like many.

    noticed    uplink from 0.01 to 0.585 s, worst phase: the next ping after 0.2 s, overdue 0.04 s later, the seventh
               after 0.25 s more, unanswered for 0.08 s: 0.57 s (limit 0.1 s, states at 50 Hz), and two ticks
    false      seven in a row lost, the first of which is one of 3000 regular pings in 10 minutes: 3000 · p^7, where p
               is the share of pings without a pong. Loss each way 2 %: 5e-7; 5 %: 2.5e-4, once in 660 h of attitude;
               10 %: 0.027, once in 6 h. With five it would be 0.026 at 5 %. Where the pong of an eighth ping can be
               back before the seventh is too old (round trips below 30 ms), the exponent is 8: 2.4e-5 at 5 %
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from itertools import islice

from skygcs.core.quantile import median

WINDOW_S = 3.0
"""Span of the ages that are kept. 5 % of it is 0.15 s: one lost state at 10 Hz passes, a gap of 0.3 s does not."""

MAX_TICKS = 512
"""Ages kept: 3 s at 170 Hz. A faster loop looks back less far."""

ROUND_TRIPS = 21
"""The least number of which one outlier does not move the 95th percentile (0.95 · 20 = 19, the second largest)."""

RECENT_TRIPS = 5
"""Number of the newest round trips that show the present round-trip time: three of five pongs settle it."""

FAST_ROUND_TRIPS = 101
"""While `fast`: about the same 21 s (0.95 · 100 = 95, the sixth largest). A computer that is late
now and then is late for five times as many pongs."""

ROUND_TRIP_VALID_S = 5.0
"""Without a pong for so long nothing is known of the link. Five lost in a row: at 10 % loss each way once an hour."""

UNDER_WAY = 64
"""Pings waiting for their pong: 3 s of probes."""

BURST, BURST_PERIOD_S, PERIOD_S = 5, 0.2, 1.0
"""Pings at the start, their distance, and the distance afterwards."""

FAST_PERIOD_S = 0.2
"""While attitude is flown."""

PROBE_PERIOD_S = 0.05
"""While a ping is overdue and attitude is flown."""

OVERDUE_S = 0.02
"""A ping is overdue so long after the 95th percentile of the round trips: a tick at 50 Hz."""

UNANSWERED = 7
"""Pings in a row without a pong, after which their age counts as a lower bound of the round trip (see above)."""

EARLY_S, PROBE_EARLY_S = 0.005, 0.015
"""Pings go out in ticks: one that is due so much later goes now. Else at 50 Hz 20 probes a second became 17."""

PING_BYTES = 28
"""TIMESYNC on the wire: 16 and 12."""


def p95(values: Iterable[float]) -> float | None:
    """95th percentile, linear between the two nearest as numpy's; None of nothing. Infinite values are allowed."""
    ordered = sorted(values)
    if not ordered:
        return None
    place = 0.95 * (len(ordered) - 1)
    below = math.floor(place)
    share = place - below
    if share == 0.0 or ordered[below] == ordered[below + 1]:  # also inf and inf, whose difference is NaN
        return ordered[below]
    return ordered[below] + share * (ordered[below + 1] - ordered[below])


class DelayMeter:
    """One per vehicle. ``share`` of the round trip is added to the ages.

    0.5, the uplink, if ages count from when the vehicle *measured* (its clock known by TIMESYNC). 1 if they count from
    when the state was *received*: then they lack the downlink, and the loop has both.
    """

    __slots__ = (
        *("_ages_at", "_ages_s", "_last_ping", "_last_pong", "_regular_at", "_sent", "_token", "_trips", "_unanswered"),
        *("bound_s", "fast", "pings", "rtt_p95_s", "share", "strange", "uplink_s"),
    )

    def __init__(self, *, share: float = 0.5) -> None:
        self.share = share
        self.fast = False
        """True if to ping five times a second, and more often while a ping is overdue; may be set at any time."""
        self.pings = 0
        self.strange = 0
        """Pongs nobody waited for: of another station, twice, too late, or before their ping."""
        self.rtt_p95_s: float | None = None
        """None: not measured yet, or not any more (as of the last tick)."""
        self.uplink_s: float | None = None
        """How long a message takes to the vehicle: half of the median round trip, since uplink and downlink cannot be
        distinguished. For leading a moving reference; the guard judges by `rtt_p95_s`. None without a round trip."""
        self.bound_s = 0.0
        """The round trip takes at least so long, by pings that are not answered (as of the last tick). 0: no news."""
        self._ages_at: deque[float] = deque(maxlen=MAX_TICKS)
        self._ages_s: deque[float] = deque(maxlen=MAX_TICKS)
        """Age at the tick of the same index in ``_ages_at``; a deque of its own, so that the ages can be sorted
        directly."""
        self._trips: deque[float] = deque(maxlen=FAST_ROUND_TRIPS)
        self._sent: dict[int, tuple[float, bool]] = {}
        """By token: when, and whether it was a regular ping or a probe."""
        self._unanswered: deque[tuple[int, float]] = deque(maxlen=UNDER_WAY)
        """Token and time of the pings since the last that was answered, the oldest first."""
        self._token = 0
        self._last_ping: float | None = None
        self._regular_at = -math.inf
        """When the last regular ping was due."""
        self._last_pong = 0.0

    def restart(self) -> None:
        """Messages go over another link from now on: what was measured over the one before is forgotten, and the burst
        of the start is repeated. Pongs of earlier pings count as strange."""
        self.pings = 0
        self.bound_s = 0.0
        self.rtt_p95_s = self.uplink_s = None
        self._trips.clear()
        self._sent.clear()
        self._unanswered.clear()
        self._last_ping = None
        self._regular_at = -math.inf

    def on_tick(self, state_age_s: float | None, now: float) -> None:
        """Count one tick; call this in every tick. No state, or an age of NaN, counts as infinitely old."""
        ages_at, ages_s = self._ages_at, self._ages_s
        if ages_at and now < ages_at[-1]:  # the clock ran backwards: what is remembered cannot be dated
            ages_at.clear()
            ages_s.clear()
            self._unanswered.clear()
        if state_age_s is None or math.isnan(state_age_s):
            state_age_s = math.inf
        ages_at.append(now)
        ages_s.append(state_age_s if state_age_s > 0.0 else 0.0)
        while now - ages_at[0] > WINDOW_S:
            ages_at.popleft()
            ages_s.popleft()
        if self._trips and not 0 <= now - self._last_pong <= ROUND_TRIP_VALID_S:
            self._trips.clear()
            self.rtt_p95_s = self.uplink_s = None
        elif not self.fast and len(self._trips) > ROUND_TRIPS:
            self._keep(ROUND_TRIPS)
        waiting = self._unanswered
        self.bound_s = 0.0 if len(waiting) < UNANSWERED else max(now - waiting[UNANSWERED - 1][1], 0.0)

    def due_ping(self, now: float) -> bool:
        """True if to send a ping now."""
        if self._last_ping is None or now < self._last_ping:
            return True
        if now - self._regular_at >= self._period_s() - EARLY_S:
            return True
        since_s = now - self._last_ping
        return self.fast and since_s >= PROBE_PERIOD_S - PROBE_EARLY_S and self._overdue(now)

    def _period_s(self) -> float:
        """From one regular ping to the next."""
        if self.pings < BURST:
            return BURST_PERIOD_S
        return FAST_PERIOD_S if self.fast else PERIOD_S

    def _overdue(self, now: float) -> bool:
        """True if the oldest ping since the last answer takes longer than round trips do."""
        if self.rtt_p95_s is None or not self._unanswered:
            return False
        return now - self._unanswered[0][1] >= self.rtt_p95_s + OVERDUE_S

    def ping(self, now: float) -> int:
        """A ping goes out: its token, which the pong brings back.

        Above 0, rising, in nanoseconds: as TIMESYNC's ts1 it collides with no other station's by accident.
        """
        self._token = max(self._token + 1, int(now * 1e9))
        late_s = now - self._regular_at - self._period_s()
        regular = late_s >= -EARLY_S or now < self._regular_at
        if regular:  # in ticks of any length they keep their rate: the next is due by when this one was
            self._regular_at = now - late_s if late_s < 0.5 * self._period_s() and now >= self._regular_at else now
        self.pings += 1
        self._last_ping = now
        if len(self._sent) >= UNDER_WAY:
            del self._sent[next(iter(self._sent))]
        self._sent[self._token] = (now, regular)
        self._unanswered.append((self._token, now))
        return self._token

    def on_pong(self, token: int, now: float) -> float | None:
        """Note a pong, of any sender. The round trip of a regular ping; None for a probe's or a strange one."""
        sent, regular = self._sent.pop(token, (math.inf, False))
        if not 0 <= now - sent <= ROUND_TRIP_VALID_S:
            self.strange += 1
            return None
        while self._unanswered and self._unanswered[0][0] <= token:
            self._unanswered.popleft()
        self._last_pong = now
        if not regular:
            return None
        self._trips.append(now - sent)
        self._keep(FAST_ROUND_TRIPS if self.fast else ROUND_TRIPS)
        return now - sent

    def _keep(self, number: int) -> None:
        """Keep the newest ``number`` round trips, and take their figures."""
        while len(self._trips) > number:
            self._trips.popleft()
        self.rtt_p95_s = p95(self._trips)
        # Every tick reads it several times: a median each time would be sorted anew.
        self.uplink_s = 0.5 * median(islice(reversed(self._trips), ROUND_TRIPS))

    @property
    def overdue(self) -> bool:
        """True if pings that are not answered decide, and not the round trips measured (as of the last tick)."""
        return self.rtt_p95_s is not None and self.bound_s > self.rtt_p95_s

    @property
    def recent_rtt_s(self) -> float | None:
        """Median of the newest RECENT_TRIPS round trips: two late pongs do not move it, a link that changed does. None
        without a round trip."""
        return median(list(self._trips)[-RECENT_TRIPS:]) if self._trips else None

    @property
    def delay_p95_s(self) -> float | None:
        """None without a round trip or a tick."""
        rtt_s, age_s = self.rtt_p95_s, p95(self._ages_s)
        return None if rtt_s is None or age_s is None else age_s + self.share * max(rtt_s, self.bound_s)
