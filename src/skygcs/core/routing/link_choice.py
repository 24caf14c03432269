"""Which of several links to one vehicle is used: each link's health, and the choice among them, with hysteresis.

The *chosen* link supplies the vehicle's state and gets its orders; the others are on *standby*. Each link has a health
of its own:

    health   what is seen                                              next     effect
    ------   -------------------------------------------------------   ------   ------------------------------------
    GOOD     silent for longer than its limit                          DOWN     its next trial is longer
    GOOD     loss or delay above the upper mark for POOR_FOR_S         POOR     the same
    GOOD     deaf: the vehicle does not hear us over it                POOR     the same
    POOR     silent for longer than its limit                          DOWN
    POOR     loss and delay below the lower marks, and not deaf        TRIAL
    TRIAL    silent for longer than its limit                          DOWN
    TRIAL    loss or delay above the upper mark, or deaf               POOR
    TRIAL    the trial is over, loss and delay below the lower marks   GOOD
    DOWN     heard                                                     TRIAL    the trial begins, its losses from 0

    the chosen one is   another one that is shown to be of the same vehicle       then
    -----------------   -------------------------------------------------------   -----------------------------------
    DOWN                is not DOWN: GOOD before TRIAL before POOR, then by cost  is chosen at once
    POOR or TRIAL       is GOOD                                                   is chosen at once
    POOR, being deaf    is not DOWN and not deaf: as for DOWN                     is chosen at once
    POOR                is POOR or TRIAL and loses BETTER_BY less                 is chosen, if CHANGE_S have passed
    GOOD                is GOOD and costs less                                    is chosen
    any                 is in no row above                                        stays on standby

So a link that flaps is left once and taken again only after a trial without a fault, which becomes longer each time: a
link that is cut for 3 s every 6 s is never taken while that lasts. A link is deaf from when the uplink's probes say so
(`core.vehicle.uplink_watch`) until an answer to a question comes over it. A link costs what its configuration says;
without it, a link whose bytes are scarce costs more than one whose bytes are not.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import NamedTuple

from skygcs.core.token_bucket import TokenBucket

DEFAULT_COST, SCARCE_COST = 10, 20
"""Cost of a network, and of a radio or a serial port, whose bytes all vehicles share."""

SILENT_LEAST_S, SILENT_MOST_S = 1.0, 2.5
"""Bounds of a link's limit of silence. A Wi-Fi station that changes its access point or saves power is silent for some
tenths of a second, and an ArduCopter was seen to pause for 0.6 s. Of a heartbeat a second two may be lost."""

USUAL_GAPS = 3.0
"""The limit of silence is so many times the longest usual gap: a multipoint radio of 0.9 s a round may lose a turn."""

GAP_WINDOW_S = 10.0
"""The longest gap is that of this time, or of up to twice as much."""

GAP_LEARN_S = 5.0
"""A link that is known for less time has no usual gap yet."""

POOR_LOSS, FAIR_LOSS = 0.15, 0.05
"""Marks of loss, as those of a radio's plan (`core.radio_link.stream_rates`)."""

POOR_LAG_S, FAIR_LAG_S = 1.0, 0.5
"""Marks of how much later the vehicle's messages come than over its fastest link. A round of a nine-node radio is 0.75
s, which is no fault; a queue that grows in a router is."""

POOR_FOR_S = 2.0
"""Two thirds of the losses' window: one burst does not condemn a link."""

LOSS_WINDOW_S, LOSS_LONGEST_S = 3.0, 30.0
LEAST_FRAMES = 20
"""Losses are those of the last 3 s, or of longer until so many frames were sent: on standby a link carries two frames
a second, 20 of them in 10 s. With fewer one lost frame would be more than 5 %."""

MARK_S = 0.5
"""Between two samples of a link's counters."""

TRIAL_S, TRIAL_MOST_S = 10.0, 60.0
"""A trial: three windows of loss at the least. Every fault that follows within FORGIVEN_S of GOOD doubles it."""

FORGIVEN_S = 120.0

BETTER_BY, CHANGE_S = 0.15, 30.0
COMPARED_S, COMPARED_FRAMES = 25.0, 40
"""Between two poor links, over a longer time: 20 frames of a link that loses 20 % show 20 ± 9 %, 500 show 20 ± 2 %."""

DOUBT_SHARE = 0.25
"""Silence of this share of its limit puts the chosen link in doubt: 0.25 s on one with many frames. PX4 leaves OFFBOARD
1 s after the last setpoint (COM_OF_LOSS_T), which is as long as it takes until another link is chosen."""

RISK_LOSS = 0.08
"""A link that loses more, or is silent for half of its limit, may be left soon. One that loses 2 % shows 8 % in 3 s of
20 frames a second once in 6 minutes."""

DEAF_PROBE_S = 2.0
"""Between two questions over a deaf link, 30 bytes each."""

RISK_S = 15.0
"""A link is at risk for so long after the last sign: what is restored on the other link is not taken back at once."""


REPORTS, REPORT_S = 6, 20.0
"""Changes of the choice that are reported at once, and the time after which one more may be. By the tables a link that
flaps brings two an outage; more is a radio that jumps between being heard and not, or somebody's play."""


class Health(StrEnum):
    """See the first table."""

    GOOD = "good"
    POOR = "poor"
    DOWN = "down"
    TRIAL = "trial"


_RANK = {Health.GOOD: 0, Health.TRIAL: 1, Health.POOR: 2, Health.DOWN: 3}


class LinkHealth:
    """One link to one vehicle. Call `heard` for each of its frames, and `sample`, then `assess`, some times a
    second."""

    __slots__ = (
        "_bad_since",
        "_faults",
        "_gap_before_s",
        "_gap_from",
        "_gap_s",
        "_good_at",
        "_marks",
        "_met_at",
        "_probed_at",
        "_risky_at",
        "cost",
        "deaf",
        "health",
        "heard_at",
        "high_latency_factor",
        "lag_s",
        "since",
    )

    def __init__(self, now: float, *, cost: int = DEFAULT_COST, known_good: bool = False) -> None:
        """``known_good``: it was the only link to the vehicle until now, and needs no trial."""
        self.cost = cost
        self.health = Health.GOOD if known_good else Health.TRIAL
        self.since = now
        self.heard_at = now
        self.lag_s: float | None = None
        """How much later messages come than over the fastest link; None: not known. Set it before `assess`."""
        self.high_latency_factor = 1
        """Factor on the limit of silence: above 1 for a satellite link."""
        self.deaf = False
        """The vehicle does not hear us over it, though we hear the vehicle. Set it before `assess`."""
        self._probed_at = -math.inf
        self._met_at = self._gap_from = now
        self._gap_s = self._gap_before_s = 0.0
        self._good_at = now
        self._bad_since: float | None = None
        self._faults = 0
        self._risky_at = -math.inf
        self._marks: deque[tuple[float, int, int]] = deque(maxlen=int(LOSS_LONGEST_S / MARK_S) + 1)

    def heard(self, now: float) -> None:
        """Count a frame that came."""
        gap_s = now - self.heard_at
        if gap_s <= self.silent_limit_s:  # a longer one is an outage
            self._gap_s = max(self._gap_s, gap_s)
        self.heard_at = now
        if now - self._gap_from >= GAP_WINDOW_S:
            self._gap_from, self._gap_before_s, self._gap_s = now, self._gap_s, 0.0

    def sample(self, frames: int, lost: int, now: float) -> None:
        """The link's counters of frames received and lost, which may restart at any time."""
        if self._marks and frames < self._marks[-1][1]:
            self._marks.clear()
        if not self._marks or now - self._marks[-1][0] >= MARK_S:
            self._marks.append((now, frames, lost))

    @property
    def silent_limit_s(self) -> float:
        """Silence after which the link is down."""
        usual_s = max(self._gap_s, self._gap_before_s)
        known = self.heard_at - self._met_at >= GAP_LEARN_S
        least_s = USUAL_GAPS * usual_s if known else SILENT_MOST_S
        return min(max(least_s, SILENT_LEAST_S), SILENT_MOST_S) * self.high_latency_factor

    @property
    def loss(self) -> float | None:
        """Share of frames lost lately, 0..1; None if too few were sent for a figure."""
        return self.loss_over(LOSS_WINDOW_S, LEAST_FRAMES)

    def loss_over(self, least_s: float, least_frames: int) -> float | None:
        """Share of frames lost in the shortest time up to now that is as long and had as many frames."""
        if not self._marks:
            return None
        last_at, frames, lost = self._marks[-1]
        for at, frames_then, lost_then in reversed(self._marks):
            received, gone = frames - frames_then, max(0, lost - lost_then)
            if last_at - at >= least_s and received + gone >= least_frames:
                return gone / (received + gone)
        return None

    def assess(self, now: float) -> Health:
        """Its health now; a change is made here only."""
        health = self._next(now)
        if health is not self.health:
            self._enter(health, now)
        if self._is_risky(now):
            self._risky_at = now
        return self.health

    def at_risk(self, now: float) -> bool:
        """True if it may be left soon: what another link would need then is restored there now."""
        return self.health is not Health.GOOD or now - self._risky_at < RISK_S or self._is_risky(now)

    def in_doubt(self, now: float) -> bool:
        """True if it may be down: what must not pause goes over another link as well until that is known."""
        return now - self.heard_at > DOUBT_SHARE * self.silent_limit_s

    def probe_due(self, now: float) -> bool:
        """True if a question is to be sent over it, whose answer ends its being deaf; true once per `DEAF_PROBE_S`."""
        due = self.deaf and self.health is not Health.DOWN and now - self._probed_at >= DEAF_PROBE_S
        if due:
            self._probed_at = now
        return due

    def trial_s(self) -> float:
        """How long its next trial is, or the present one."""
        return float(min(TRIAL_S * 2 ** max(0, self._faults - 1), TRIAL_MOST_S))

    # -- the inside

    def _is_risky(self, now: float) -> bool:
        loss = self.loss
        return now - self.heard_at > self.silent_limit_s / 2 or (loss is not None and loss >= RISK_LOSS)

    def _next(self, now: float) -> Health:
        loss, lag_s = self.loss or 0.0, self.lag_s or 0.0
        bad = loss >= POOR_LOSS or lag_s >= POOR_LAG_S
        fair = loss <= FAIR_LOSS and lag_s <= FAIR_LAG_S and not self.deaf
        self._bad_since = None if not bad else now if self._bad_since is None else self._bad_since
        silent = now - self.heard_at > self.silent_limit_s
        match self.health:
            case Health.DOWN:
                return Health.DOWN if silent else Health.TRIAL
            case _ if silent:
                return Health.DOWN
            case Health.GOOD:
                poor = self.deaf or (self._bad_since is not None and now - self._bad_since >= POOR_FOR_S)
                return Health.POOR if poor else Health.GOOD
            case Health.POOR:
                return Health.TRIAL if fair else Health.POOR
            case _:
                if bad or self.deaf:
                    return Health.POOR
                return Health.GOOD if fair and now - self.since >= self.trial_s() else Health.TRIAL

    def _enter(self, health: Health, now: float) -> None:
        if self.health is Health.GOOD:
            self._faults = 1 if now - self._good_at >= FORGIVEN_S else self._faults + 1
        if self.health is Health.DOWN:
            self._marks.clear()  # what was lost in the outage says nothing of what comes now
        if health is Health.GOOD:
            self._good_at = now
        self.health, self.since = health, now


class Choice(NamedTuple):
    """A change of the link: the new channel, and why, in words about the old one."""

    channel_id: int
    why: str


class LinkChoice:
    """The choice for one vehicle: `decide` a few times a second, and when a frame came over a standby link."""

    __slots__ = ("_reports", "changed_at", "changes", "unreported")

    def __init__(self) -> None:
        self.changes = 0
        self.changed_at = -math.inf
        self.unreported = 0
        """Changes since the last one that was to be reported."""
        self._reports = TokenBucket(1 / REPORT_S, REPORTS)

    def changed(self, now: float) -> bool:
        """Another link is used from now on; whether to report it. `unreported` is to be reported with it."""
        self.changes += 1
        self.changed_at = now
        if self._reports.take(now):
            return True
        self.unreported += 1
        return False

    def decide(
        self, chosen: LinkHealth, standby: Mapping[int, LinkHealth], is_same: Callable[[int], bool], now: float
    ) -> Choice | None:
        """The link to use instead of the chosen one; None: stay. ``standby``: by channel; ``is_same``: whether what is
        heard on that channel is shown to be the same vehicle. All have been assessed."""
        match chosen.health:
            case Health.DOWN:
                able = {i: link for i, link in standby.items() if link.health is not Health.DOWN}
                why = f"silent for {now - chosen.heard_at:.1f} s"
            case Health.POOR if chosen.deaf:
                able = {i: link for i, link in standby.items() if link.health is not Health.DOWN and not link.deaf}
                why = _fault_of(chosen)
            case Health.POOR | Health.TRIAL:
                able = {i: link for i, link in standby.items() if link.health is Health.GOOD}
                why = _fault_of(chosen)
                if not able and chosen.health is Health.POOR and now - self.changed_at >= CHANGE_S:
                    able = {i: link for i, link in standby.items() if _loses_less(link, chosen)}
            case _:
                able = {
                    i: link for i, link in standby.items() if link.health is Health.GOOD and link.cost < chosen.cost
                }
                why = "the other link costs less and is good"
        for channel_id in sorted(able, key=lambda i: _order(able[i])):
            if is_same(channel_id):
                return Choice(channel_id, why)
        return None


def best_standby(standby: Mapping[int, LinkHealth], is_same: Callable[[int], bool]) -> int | None:
    """The link that would be chosen if the chosen one were down; None if there is none over which it hears us."""
    able = [i for i, link in standby.items() if link.health is not Health.DOWN and not link.deaf and is_same(i)]
    return min(able, key=lambda i: _order(standby[i]), default=None)


def _order(link: LinkHealth) -> tuple[int, bool, int, float]:
    return _RANK[link.health], link.deaf, link.cost, link.loss or 0.0


def _loses_less(link: LinkHealth, chosen: LinkHealth) -> bool:
    loss, theirs = (each.loss_over(COMPARED_S, COMPARED_FRAMES) for each in (link, chosen))
    heard = link.health is not Health.DOWN and not link.deaf
    return heard and loss is not None and theirs is not None and loss + BETTER_BY <= theirs


def _fault_of(link: LinkHealth) -> str:
    """Return what is wrong with a link that is not silent."""
    if link.deaf:
        return "the vehicle does not hear us over it"
    if link.loss is not None and link.loss > FAIR_LOSS:
        return f"{link.loss:.0%} of its frames are lost"
    if link.lag_s is not None and link.lag_s > FAIR_LAG_S:
        return f"it is {link.lag_s:.1f} s behind"
    return "it is on trial after a fault"
