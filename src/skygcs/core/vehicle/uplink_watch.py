"""Finds a dead uplink by probes that the vehicle answers: an uplink can be dead while all of its telemetry arrives.

A probe is a TIMESYNC request, which both autopilots answer; COMMAND_ACKs to us count as answers, too. While probes are
answered, one is sent per base period. When an answer is overdue (1.5 round trips), the vehicle is in doubt: probes are
sent quickly until one is answered, or until so many in a row were not answered that loss does not explain it.

    base period    armed 0.5 s, on a radio 2 s; disarmed 5 s, on a radio 10 s (30 bytes each way)
    in doubt       armed every 0.2 s, on a radio every 0.35 s or half a round trip; disarmed every 1 s, on a radio 2 s
    crowded        never more than `PROBE_SHARE` of the vehicle's share of a radio, in doubt `DOUBT_SHARE`
    dead           after N probes without an answer, with p^N below FALSE_RUN: 5 to 18 probes
    silent         when nothing comes for twice the longest of its last gaps: probes of a silence do not count

p, the share of unanswered probes, is measured over the last 50 of them, beginning with 0.2. A run of N
begins with a base probe, at most 7,200 an hour: with p known exactly 7,200 * 2e-7 is one false alarm in 700 hours of
flight. 20 % loss one way (p = 0.2) needs N = 10, 20 % each way (p = 0.36) needs 16, a good link (p below 0.04) 5.
Simulated: none in 200 hours at 20 % each way, none at 20 % one way; a dead uplink is reported after 1.5 s on average
(1.8 s at most), at 20 % loss one way 2.6 s, each way 3.3 s, with a round trip of 0.05 s; on a radio with one of 0.4 s
after 3.8 s, 6.0 s and 7.5 s.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Literal

ARMED_S, DISARMED_S = 0.5, 5.0
THIN_ARMED_S, THIN_DISARMED_S = 2.0, 10.0
"""Period while probes are answered; thin: on a radio, whose airtime is scarce."""

DOUBT_S, THIN_DOUBT_S = 0.2, 0.35
"""Period while they are not answered."""

PROBE_BYTES = 30
PROBE_SHARE, DOUBT_SHARE = 0.1, 0.3
"""Shares of what a slow link leaves a vehicle. Without them 14 vehicles behind a radio of 64 kbit/s filled it: what
waits behind probes is answered late, which brings vehicles in doubt, which sends more probes. No parameter was read
within 126 s."""

EARLY_S = 0.02
"""Tolerance, so that a caller with a period of 0.2 s does not miss a probe by rounding."""

LOST_S = 1.0
"""Period while the uplink is known to be dead."""

FALSE_RUN = 2e-7
FEWEST, MOST = 5, 18

PROBES_KEPT = 50
"""Number of probes over which p is measured."""

GAPS_KEPT, GAPS = 50, 2.0
"""A vehicle is silent when nothing has come for so many times the longest of its last gaps between frames."""

FIRST_TRIP_S, LONGEST_TRIP_S = 0.4, 1.5
TRIPS = 1.5
"""A probe is overdue after this many round trips."""

MAX_WAITING = 32
"""Probes remembered until their answers."""

TOKEN_BASE = 0x7570_6C69 << 16
"""TIMESYNC.ts1 of a probe: different from any clock, and from the pings of flight control."""

Change = Literal["lost", "back"]


class UplinkWatch:
    """The uplink of one vehicle. Call `due` as time passes, `sent` when a probe was sent, `answered` for each TIMESYNC
    answer, `heard` for other proof that it hears us, and `verdict` for the change to report."""

    def __init__(self, first: int = 0) -> None:
        """``first``: number of the first probe, different for each program, so that answers are not confused."""
        self.lost = False
        self.trip_s: float | None = None
        self.unanswered = 0
        """Probes since the last answer."""
        self.answered_at: float | None = None
        """When it last showed that it hears us; None: never since its first frame or its reboot."""
        self._sent_at = -math.inf
        self._in_doubt_since: float | None = None
        self._needed = FEWEST
        self._waiting: dict[int, float] = {}
        self._number = first & 0xFFFF
        self._outcomes: deque[bool] = deque(maxlen=PROBES_KEPT)
        self._frame_at = -math.inf
        self._gap_s = 0.0
        """Longest time since its last frame at which a probe was sent."""
        self._gaps_s: deque[float] = deque(maxlen=GAPS_KEPT)
        """The same of the frames before."""

    def due(self, now: float, *, armed: bool, share_bytes_per_s: float = math.inf) -> bool:
        """True if a probe is to be sent now; ``share_bytes_per_s``: what a slow link leaves this vehicle."""
        thin = share_bytes_per_s < math.inf
        in_doubt = bool(self.unanswered) or self.lost
        least_s = PROBE_BYTES / (max(share_bytes_per_s, 1.0) * (DOUBT_SHARE if in_doubt else PROBE_SHARE))
        return now - self._sent_at >= max(self._period_s(armed=armed, thin=thin), least_s) - EARLY_S

    def token(self) -> int:
        """ts1 of the next probe."""
        self._number = self._number + 1 & 0xFFFF
        return TOKEN_BASE | self._number

    def sent(self, token: int, now: float, last_frame_at: float) -> None:
        """The probe was handed to a link. That a vehicle which is silent does not answer says nothing of its uplink:
        the probes since its last frame do not count."""
        self._measure_gap(now, last_frame_at)
        if self._is_silent(now, last_frame_at):
            self._drop_since(last_frame_at)
            self._sent_at = now
            return
        if not self.unanswered:
            self._in_doubt_since = now
            self._needed = self._run_length()
        self.unanswered += 1
        self._sent_at = now
        self._waiting[token] = now
        while len(self._waiting) > MAX_WAITING:
            del self._waiting[next(iter(self._waiting))]

    def answered(self, token: int, now: float) -> tuple[bool, Change | None]:
        """A TIMESYNC answer: True if it answers a probe of ours; and the change to report."""
        sent_at = self._waiting.pop(token, None)
        if sent_at is None:
            return token >> 16 == TOKEN_BASE >> 16, None
        self._outcomes.append(True)
        trip_s = now - sent_at
        self.trip_s = trip_s if self.trip_s is None else self.trip_s + (trip_s - self.trip_s) / 4
        return True, self.heard(now)

    def heard(self, now: float) -> Change | None:
        """Note other proof that it hears us; returns the change to report."""
        before = len(self._waiting)
        self._waiting = {token: at for token, at in self._waiting.items() if now - at < self.answer_timeout_s}
        if not self.lost:  # losses of a dead uplink do not count for the loss rate of a live one
            self._outcomes.extend([False] * (before - len(self._waiting)))
        self.answered_at, self.unanswered, self._in_doubt_since = now, 0, None
        was, self.lost = self.lost, False
        return "back" if was else None

    def verdict(self, now: float, last_frame_at: float) -> Change | None:
        """ "lost" once, if it answered before and enough probes in a row were not answered. Only while its own frames
        still come: otherwise the vehicle is lost, not the uplink."""
        since = self._in_doubt_since
        if self.lost or self.answered_at is None or since is None or self.unanswered < self._needed:
            return None
        if sum(at >= since and now - at >= self.answer_timeout_s for at in self._waiting.values()) < self._needed:
            return None
        if last_frame_at < since or self._is_silent(now, last_frame_at):
            return None
        self.lost = True
        return "lost"

    def _measure_gap(self, now: float, last_frame_at: float) -> None:
        if last_frame_at != self._frame_at:
            if self._frame_at > -math.inf:
                self._gaps_s.append(self._gap_s)
            self._frame_at = last_frame_at
        self._gap_s = max(0.0, now - last_frame_at)

    def _is_silent(self, now: float, last_frame_at: float) -> bool:
        """True if nothing comes for longer than its telemetry explains, which may be sparse or lose frames."""
        rhythm_s = GAPS * max(self._gaps_s, default=0.0)
        return now - last_frame_at > max(LOST_S + self.answer_timeout_s, rhythm_s)

    def _drop_since(self, last_frame_at: float) -> None:
        kept = {token: at for token, at in self._waiting.items() if at <= last_frame_at}
        self.unanswered = max(0, self.unanswered - (len(self._waiting) - len(kept)))
        self._waiting = kept
        if not self.unanswered:
            self._in_doubt_since = None

    def forget(self) -> None:
        """Forget earlier answers: it rebooted or is lost."""
        self.lost, self.unanswered, self.answered_at = False, 0, None
        self._in_doubt_since = None
        self._waiting.clear()
        self._gaps_s.clear()
        self._gap_s = 0.0

    def moved(self) -> None:
        """Another link is used: earlier answers do not count. Its uplink is dead until the vehicle answers over it, if
        the one before was."""
        lost = self.lost
        self.forget()
        self.lost = lost

    @property
    def answer_timeout_s(self) -> float:
        """Time to wait for an answer."""
        trip_s = FIRST_TRIP_S if self.trip_s is None else self.trip_s
        return max(DOUBT_S, TRIPS * min(trip_s, LONGEST_TRIP_S))

    def _period_s(self, *, armed: bool, thin: bool) -> float:
        base_s = (THIN_ARMED_S if armed else THIN_DISARMED_S) if thin else (ARMED_S if armed else DISARMED_S)
        if self.lost:
            return 2 * LOST_S if thin else LOST_S
        if self.answered_at is None:
            return THIN_DISARMED_S if thin else DISARMED_S  # perhaps it never answers: no hurry
        if not self.unanswered:
            return base_s
        if self.unanswered == 1:
            return min(self.answer_timeout_s, base_s)
        if not armed:
            return base_s / 5
        return max(THIN_DOUBT_S, self.answer_timeout_s / 2) if thin else DOUBT_S

    def _run_length(self) -> int:
        failures = self._outcomes.count(False)
        p = min((failures + 2) / (len(self._outcomes) + 10), 0.9)
        return min(max(FEWEST, math.ceil(math.log(FALSE_RUN) / math.log(p))), MOST)
