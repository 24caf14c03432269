"""A dead uplink is reported within seconds, and loss alone is not reported as one."""

from __future__ import annotations

import math
import random

from skygcs.core.vehicle.uplink_watch import DOUBT_SHARE, PROBE_BYTES, PROBE_SHARE, UplinkWatch
from support.examples import seeds
from support.table import each

TICK_S = 0.2
ROOMY = 1_000.0
"""Bytes per second of a radio with one vehicle."""


class Air:
    """A vehicle that answers after a round trip, on a link that loses some of it. ``gap_s``: between its frames, which
    are lost like its answers; 0: it was always heard just now."""

    def __init__(
        self,
        *,
        up: float = 0.0,
        down: float = 0.0,
        trip_s: float = 0.05,
        thin: bool = False,
        seed: int = 1,
        gap_s: float = 0.0,
    ):
        self.watch = UplinkWatch(first=seed)
        self.rng = random.Random(seed)
        self.up, self.down, self.trip_s, self.thin = up, down, trip_s, thin
        self.now = 100.0
        self.heard_at = -1.0
        self.gap_s, self.frame_at = gap_s, 100.0
        self.answers: list[tuple[float, int]] = []
        self.sent = 0
        self.changes: list[tuple[float, str]] = []

    def run(self, for_s: float, *, armed: bool = True, dead: bool = False, silent: bool = False) -> None:
        end = self.now + for_s
        while self.now < end:
            self.now = round(self.now + TICK_S, 3)
            if not silent:
                self._hear()
            last_frame_at = self.heard_at
            for at, token in [a for a in self.answers if a[0] <= self.now]:
                self.answers.remove((at, token))
                self.heard_at = max(self.heard_at, at)
                ours, change = self.watch.answered(token, at)
                assert ours
                if change:
                    self.changes.append((self.now, change))
            if (verdict := self.watch.verdict(self.now, last_frame_at)) is not None:
                self.changes.append((self.now, verdict))
            if self.watch.due(self.now, armed=armed, share_bytes_per_s=ROOMY if self.thin else math.inf):
                token = self.watch.token()
                self.watch.sent(token, self.now, last_frame_at)
                self.sent += 1
                if not dead and self.rng.random() >= self.up and self.rng.random() >= self.down:
                    self.answers.append((self.now + self.trip_s, token))

    def _hear(self) -> None:
        if not self.gap_s:
            self.heard_at = self.now - 0.3
            return
        while self.frame_at <= self.now:
            if self.rng.random() >= self.down:
                self.heard_at = max(self.heard_at, self.frame_at)
            self.frame_at += self.gap_s


@each(
    ("up", "down", "trip_s", "thin", "within_s"),
    [
        (0.0, 0.0, 0.05, False, 2.2),
        (0.2, 0.0, 0.05, False, 3.2),
        (0.2, 0.2, 0.05, False, 4.4),
        (0.0, 0.0, 0.4, True, 5.0),
        (0.2, 0.0, 0.4, True, 6.6),
    ],
)
def test_a_dead_uplink_is_reported_soon(up: float, down: float, trip_s: float, thin: bool, within_s: float) -> None:
    delays = []
    for seed in range(16):
        air = Air(up=up, down=down, trip_s=trip_s, thin=thin, seed=seed)
        air.run(120 + seed * 0.07)
        assert air.changes == []
        died = air.now
        air.run(20, dead=True)
        assert [change for _, change in air.changes] == ["lost"]
        delays.append(air.changes[0][0] - died)
        air.run(10)
        assert [change for _, change in air.changes] == ["lost", "back"] and not air.watch.lost
    assert sum(delays) / len(delays) <= within_s, delays


@each(
    ("gap_s", "loss", "thin", "within_s"),
    [
        (1.5, 0.0, True, 5.5),
        (2.0, 0.0, False, 5.0),
        (2.0, 0.0, True, 7.5),
        (2.5, 0.0, False, 5.5),
        (2.5, 0.0, True, 9.0),
        (1.0, 0.4, False, 8.0),
        (1.0, 0.4, True, 16.0),
    ],
)
def test_a_dead_uplink_is_reported_with_sparse_telemetry(
    gap_s: float, loss: float, thin: bool, within_s: float
) -> None:
    """With 40 % loss one of 150 runs has a false alarm before, and one of 30 is later."""
    false_alarms, delays = 0, []
    for seed in range(16):
        air = Air(up=loss / 4, down=loss, trip_s=0.4 if thin else 0.05, thin=thin, seed=seed, gap_s=gap_s)
        air.run(60 + seed * 0.2)
        if air.changes:
            false_alarms += 1
            continue
        died = air.now
        air.run(30, dead=True)
        assert [change for _, change in air.changes] in (["lost"], [] if loss else ["lost"])
        delays.append(air.changes[0][0] - died if air.changes else math.inf)
    assert false_alarms <= (2 if loss else 0)
    assert sorted(delays)[-5 if loss else -1] <= within_s, delays


@each(("up", "down"), [(0.2, 0.0), (0.2, 0.2)])
@each(("thin", "trip_s"), [(False, 0.05), (True, 0.4)])
def test_loss_is_no_dead_uplink(up: float, down: float, thin: bool, trip_s: float) -> None:
    """Ten hours in the air: 0.1 alarms are expected of all of it at most, so that three are no chance."""
    alarms = []
    for seed in seeds(10):
        air = Air(up=up, down=down, trip_s=trip_s, thin=thin, seed=seed)
        air.run(3600)
        alarms += [at for at, change in air.changes if change == "lost"]
    assert len(alarms) < 3


def test_what_it_costs() -> None:
    for thin, armed, most in ((False, True, 2.1), (False, False, 0.3), (True, True, 0.6), (True, False, 0.15)):
        air = Air(thin=thin, trip_s=0.4 if thin else 0.05)
        air.run(60, armed=armed)
        air.sent = 0
        air.run(600, armed=armed)
        assert air.sent / 600 <= most


@each("share_bytes_per_s", [1.0, 10.0, 40.0, 134.0])
def test_on_a_crowded_radio_probes_keep_to_their_share_also_in_doubt(share_bytes_per_s: float) -> None:
    watch, sent = UplinkWatch(), {True: 0, False: 0}
    for dead in (False, True):
        for n in range(round(1200 / TICK_S)):
            now = 2000.0 * dead + n * TICK_S
            if watch.due(now, armed=True, share_bytes_per_s=share_bytes_per_s):
                token = watch.token()
                watch.sent(token, now, now)
                sent[dead] += 1
                if not dead:
                    watch.answered(token, now + 0.1)
    assert PROBE_BYTES * (sent[False] - 1) <= 1200 * PROBE_SHARE * share_bytes_per_s
    assert PROBE_BYTES * (sent[True] - 1) <= 1200 * DOUBT_SHARE * share_bytes_per_s


def test_one_that_never_answers_and_one_that_is_not_heard_are_not_said_to_be_deaf() -> None:
    air = Air()
    air.run(600, dead=True)
    assert air.changes == [] and air.sent < 130
    air = Air()
    air.run(60)
    air.run(60, dead=True, silent=True)
    assert air.changes == [], "it is lost, which is reported as that"
    # nor is one that was switched off and on, and is heard again before it answers
    air = Air()
    air.run(60)
    air.run(4, dead=True, silent=True)
    air.run(0.6, dead=True)
    air.run(60)
    assert air.changes == []


def test_other_proof_counts_and_a_reboot_begins_anew() -> None:
    air = Air()
    air.run(30)
    air.run(20, dead=True)
    assert air.watch.lost
    assert air.watch.heard(air.now) == "back" and air.watch.heard(air.now) is None
    air.watch.forget()
    assert air.watch.answered_at is None and not air.watch.lost


def test_on_another_link_a_dead_uplink_is_dead_until_it_answers_there() -> None:
    air = Air()
    air.run(30)
    air.run(20, dead=True)
    air.watch.moved()
    assert air.watch.lost and air.watch.answered_at is None
    before = air.sent
    air.run(3, dead=True)
    assert air.sent - before >= 2, "it is asked every second"
    air.run(3)
    assert not air.watch.lost and air.changes[-1][1] == "back"
    air.watch.moved()
    assert not air.watch.lost


def test_answers_to_others_are_none_of_ours() -> None:
    watch = UplinkWatch()
    for token in (0, -1, 5, 2**63 - 1, -(2**63)):
        assert watch.answered(token, 1.0) == (False, None)
    for number in range(1000):
        watch.sent(watch.token(), float(number), float(number))
    assert watch.answered_at is None
