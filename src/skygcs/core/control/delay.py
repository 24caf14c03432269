"""How old what the law sees is, and how long what it says takes to arrive: the delay the guard judges attitude by.

    tick    age of the newest state     ─> window of 3 s                     ┐
    ping    token, remembered           ─> at most 8 under way               ├─> delay p95 = p95(ages) + share · rtt p95
    pong    now - sent, once per token  ─> the last 21, none for 5 s: none   ┘
    else    a token nobody sent, a second pong, one older than 5 s, a clock that ran backwards: counted or dropped

Round trips are measured by TIMESYNC or PING: five in the first second, then one a second (two messages of 28 B,
1 % of a 57600 baud radio). With 21 of them the 95th percentile is the second largest: one late pong is an accident,
two are the link, which is noticed after two seconds.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from statistics import median

WINDOW_S = 3.0
"""Of the ages. 5 % of it is 0.15 s: one lost state at 10 Hz passes, a gap of 0.3 s does not."""

MAX_TICKS = 512
"""Ages kept: 3 s at 170 Hz. A faster loop looks back less far."""

ROUND_TRIPS = 21
"""The least number of which one outlier does not move the 95th percentile (0.95 · 20 = 19, the second largest)."""

ROUND_TRIP_VALID_S = 5.0
"""Without a pong for so long nothing is known of the link. Five lost in a row: at 10 % loss each way once an hour."""

UNDER_WAY = 8
"""Pings waiting for their pong; more than ROUND_TRIP_VALID_S of them, and all of the burst."""

BURST, BURST_PERIOD_S, PERIOD_S = 5, 0.2, 1.0
"""Pings at the start, their distance, and the distance afterwards."""


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

    0.5, the way up, if ages count from when the vehicle *measured* (its clock known by TIMESYNC). 1 if they count from
    when the state was *received*: then they lack the way down, and the loop has both.
    """

    __slots__ = (
        *("_ages_at", "_ages_s", "_last_ping", "_last_pong", "_sent", "_token", "_trips"),
        *("pings", "rtt_p95_s", "share", "strange"),
    )

    def __init__(self, *, share: float = 0.5) -> None:
        self.share = share
        self.pings = 0
        self.strange = 0
        """Pongs nobody waited for: of another station, twice, too late, or before their ping."""
        self.rtt_p95_s: float | None = None
        """None: not measured yet, or not any more (as of the last tick)."""
        self._ages_at: deque[float] = deque(maxlen=MAX_TICKS)
        self._ages_s: deque[float] = deque(maxlen=MAX_TICKS)
        """Of the tick at the same place in ``_ages_at``; apart from it so that they can be sorted as they are."""
        self._trips: deque[float] = deque(maxlen=ROUND_TRIPS)
        self._sent: dict[int, float] = {}
        self._token = 0
        self._last_ping: float | None = None
        self._last_pong = 0.0

    def on_tick(self, state_age_s: float | None, now: float) -> None:
        """To be called in every tick of the loop. No state, or an age that is NaN, is one infinitely old."""
        ages_at, ages_s = self._ages_at, self._ages_s
        if ages_at and now < ages_at[-1]:  # the clock ran backwards: what is remembered cannot be dated
            ages_at.clear()
            ages_s.clear()
        if state_age_s is None or math.isnan(state_age_s):
            state_age_s = math.inf
        ages_at.append(now)
        ages_s.append(state_age_s if state_age_s > 0.0 else 0.0)
        while now - ages_at[0] > WINDOW_S:
            ages_at.popleft()
            ages_s.popleft()
        if self._trips and not 0 <= now - self._last_pong <= ROUND_TRIP_VALID_S:
            self._trips.clear()
            self.rtt_p95_s = None

    def due_ping(self, now: float) -> bool:
        """Whether to send a ping now."""
        if self._last_ping is None or now < self._last_ping:
            return True
        return now - self._last_ping >= (BURST_PERIOD_S if self.pings < BURST else PERIOD_S)

    def ping(self, now: float) -> int:
        """A ping goes out: its token, which the pong brings back.

        Above 0, rising, in nanoseconds: as TIMESYNC's ts1 it collides with no other station's by accident.
        """
        self._token = max(self._token + 1, int(now * 1e9))
        self.pings += 1
        self._last_ping = now
        if len(self._sent) >= UNDER_WAY:
            del self._sent[next(iter(self._sent))]
        self._sent[self._token] = now
        return self._token

    def on_pong(self, token: int, now: float) -> None:
        """A pong came in, whoever's."""
        sent = self._sent.pop(token, None)
        if sent is None or not 0 <= now - sent <= ROUND_TRIP_VALID_S:
            self.strange += 1
            return
        self._trips.append(now - sent)
        self._last_pong = now
        self.rtt_p95_s = p95(self._trips)

    @property
    def uplink_s(self) -> float | None:
        """How long a message takes to the vehicle: half of the median round trip, since the two ways cannot be told
        apart. For leading a moving reference; the guard judges by `rtt_p95_s`. None without a round trip."""
        return 0.5 * median(self._trips) if self._trips else None

    @property
    def delay_p95_s(self) -> float | None:
        """None without a round trip or a tick."""
        rtt_s, age_s = self.rtt_p95_s, p95(self._ages_s)
        return None if rtt_s is None or age_s is None else age_s + self.share * rtt_s
