"""How many bytes a second may go up into a radio: from what its serial port, its air and its own reports say.

A radio without reports is paced by its rates alone. One that reports RADIO_STATUS says how much of its transmit buffer
is free (txbuf, percent FREE), and so how fast it really empties it.

ArduPilot and PX4 turn their rate up and down by fixed steps while the buffer is emptier or fuller than some marks. Rate
and buffer are then two integrators in a row, which swing. Here the rate at which the radio empties its buffer is
estimated from two reports and what was sent between them, and the rate is that, corrected by what the buffer holds too
much or too little: one integrator with its proportion, which settles.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from skygcs.core.radio_link.capacity import RadioRates

BUFFER_BYTES = 1850
"""Size of an SiK radio's transmit buffer (ArduPilot/SiK serial.c; 1024 on its Si1030 boards, RFD900x unknown). A
smaller one makes the correction stronger than meant, by less than it bears (see the tests)."""

TARGET_FREE = 0.7
"""Part of the buffer. What arrives between two slots fills some of it, and nothing overtakes what is in there."""

SETTLE_S = 6.0
"""In which a wrong level is corrected. Reports come every second: with the level smoothed, as it is, the loop's gain is
far below that at which it would swing."""

SMOOTHING = 0.15
LEVEL_SMOOTHING = 0.3
"""Weights of the newest estimate of how fast the buffer empties, and of its newest level: a radio with a turn every
0.9 s and reports every second shows each time another part of its sawtooth."""

LOW_FREE, LOW_FACTOR = 0.35, 0.85
FULL_FREE, FULL_FACTOR = 0.12, 0.6
"""With less than this free, bytes are lost, or were before the slot that the report follows, and what became of them is
no measure: the estimate is cut by the factor at each report. Far from where it settles."""

RISE_PER_S = 0.05
"""By this share of the base the estimate rises while the buffer is empty: all that is known then is that it could be
more."""

LEAST_SHARE = 0.05
"""Part of the base rate: our heartbeats go out whatever a radio reports; without them it reports nothing."""

STALE_AFTER_S = 5.0
"""Reports come once a second. Without them it is paced by its rates."""

TOGETHER_S = 0.3
"""RADIO and RADIO_STATUS of one report come within this, with one sequence number."""

HISTORY = 300
"""Reports kept: five minutes."""

BURST_S = 0.25
LEAST_BURST_BYTES = 256
"""The budget's burst: a quarter of a second, and no less than one full packet of the air."""


@dataclass(frozen=True, slots=True)
class RadioReport:
    """RADIO_STATUS or RADIO. ``txbuf_free`` is 0..1; signal and noise are the firmware's numbers."""

    at: float
    txbuf_free: float
    rssi: int
    remrssi: int
    noise: int
    remnoise: int
    rxerrors: int
    fixed: int

    def as_dict(self, now: float) -> dict[str, Any]:
        return {
            "age_s": round(now - self.at, 1),
            "txbuf_percent": round(self.txbuf_free * 100),
            "rssi": self.rssi,
            "remrssi": self.remrssi,
            "noise": self.noise,
            "remnoise": self.remnoise,
            "rxerrors": self.rxerrors,
            "fixed": self.fixed,
        }


def report_of(fields: dict[str, Any], now: float) -> RadioReport:
    """The report in the fields of a RADIO_STATUS or RADIO, which are alike. A txbuf above 100 % is 100 %."""
    return RadioReport(
        now,
        min(int(fields["txbuf"]), 100) / 100,
        *(int(fields[name]) for name in ("rssi", "remrssi", "noise", "remnoise", "rxerrors", "fixed")),
    )


class Pacer:
    """The present rate up into one radio. `on_report` for each of its reports, `rate` whenever it is wanted."""

    def __init__(self, rates: RadioRates) -> None:
        self.rates = rates
        self.vehicles = 0
        """Number of vehicles behind this radio; set by the air planner."""
        self.history: deque[RadioReport] = deque(maxlen=HISTORY)
        self._drain: float | None = None
        """Estimated bytes/s at which the radio empties its buffer; None: nothing says that it is below the base."""
        self._sent_bytes = 0
        self._level = 1.0
        """Smoothed txbuf."""

    @property
    def base(self) -> float:
        """Bytes/s up without any report."""
        return self.rates.base_bytes_per_s(self.vehicles)

    @property
    def last(self) -> RadioReport | None:
        return self.history[-1] if self.history else None

    def fresh(self, now: float) -> bool:
        """True if the radio reports."""
        return self.last is not None and now - self.last.at <= STALE_AFTER_S

    def on_report(self, report: RadioReport, sent_bytes: int) -> bool:
        """A report came; ``sent_bytes`` is all that was ever written to the radio. False for the twin of the last."""
        last = self.last
        if last is not None and report.at - last.at < TOGETHER_S:
            return False
        if last is not None and report.at - last.at <= STALE_AFTER_S:
            self._learn(last, report, sent_bytes - self._sent_bytes)
            self._level += LEVEL_SMOOTHING * (report.txbuf_free - self._level)
        else:
            self._drain = None
            self._level = report.txbuf_free
        self.history.append(report)
        self._sent_bytes = sent_bytes
        return True

    def rate(self, now: float) -> float:
        """Bytes/s that may go up now."""
        base = self.base
        if self._drain is None or not self.fresh(now):
            return base
        correction = (self._level - TARGET_FREE) * BUFFER_BYTES / SETTLE_S
        return min(base, max(self._drain + correction, LEAST_SHARE * base))

    def burst_bytes(self) -> float:
        """The burst of the budget."""
        return max(LEAST_BURST_BYTES, BURST_S * self.base, min(self.rates.slot_bytes, self.base))

    def status(self, now: float) -> dict[str, Any]:
        round_s = self.rates.round_s(self.vehicles)
        return {
            "base_bytes_per_s": round(self.base, 1),
            "bytes_per_s": round(self.rate(now), 1),
            "paced_by": "reports" if self.fresh(now) and self._drain is not None else "rates",
            "round_s": None if round_s is None else round(round_s, 3),
            "timing": None if (timing := self.rates.timing) is None else timing.source,
            "radio": None if self.last is None else self.last.as_dict(now),
        }

    def _learn(self, last: RadioReport, report: RadioReport, sent: int) -> None:
        """From what was sent between two reports, and by how much the buffer became fuller, to what went on air."""
        past_s = report.at - last.at
        held = (last.txbuf_free - report.txbuf_free) * BUFFER_BYTES
        drained = max(0.0, (sent - held) / past_s)
        base = self.base
        if report.txbuf_free < LOW_FREE:  # bytes may have been lost, and look as if they had gone on air
            factor = FULL_FACTOR if report.txbuf_free < FULL_FREE else LOW_FACTOR
            self._drain = factor * min(base, drained if self._drain is None else self._drain)
            return
        busy = min(last.txbuf_free, report.txbuf_free) < (1 + TARGET_FREE) / 2
        if busy:  # it had something to send all the time: this is what it can
            before = min(base, drained) if self._drain is None else self._drain
            self._drain = min(base, before + SMOOTHING * (drained - before))
        elif self._drain is not None:  # it was empty for a part of the time: it can this, or more
            self._drain = max(self._drain + RISE_PER_S * base * past_s, min(drained, base))
            if self._drain >= base:
                self._drain = None
