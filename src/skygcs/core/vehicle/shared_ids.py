"""Reboots by the vehicle's time_boot_ms, and other senders with its ids: a component of its system, or another vehicle.
Pure.

time_boot_ms ...                                            interpretation
--------------------------------------------------------    ------------------------------------------------
goes back by less than JITTER_MS                            frames out of order
goes back at the 32-bit wrap                                nothing
goes back after a silence of SILENCE_S or more              a reboot: a start takes seconds
goes back just after the old clock was heard, and the       a reboot, reported CONFIRM_S later
old clock is not heard again
... and the old clock is heard again                        two vehicles with one system id: no reboot
is shorter than the silence before it, and behind the       a reboot, reported CONFIRM_S later: it was started
old clock by more than JITTER_MS, and goes on at the        during the silence
rate of time
... and it comes up with the old clock                      frames that a radio had kept: no reboot

heard with its ids                                    then
---------------------------------------------------   ------------------------------------------------------------
a heartbeat of a component (`HeartbeatCheck`)         it is ignored, and reported once a minute
a heartbeat that contradicts the vehicle's own, or    it is ignored, and reported once a minute; most orders are
a second clock (`BootClock`)                          refused
neither for BESIDE_OVER_S                             that is over, and reported
another vehicle on another channel                    most orders are refused while the fleet's table has it
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from skygcs.core.mavlink.heartbeat import HeartbeatCheck, HeartbeatOrigin

JITTER_MS = 3000
"""Frames of one vehicle over two links, or queued in a radio, arrive up to this much out of order."""

WRAP_MS = 1 << 32
WRAP_MARGIN_MS = 600_000
"""time_boot_ms has 32 bits: it wraps to 0 after 49.7 days."""

SILENCE_S = 2.5
"""No autopilot restarts faster (ArduPilot and PX4 take 3 s and more until they send again); with two vehicles frames
come more often."""

CONFIRM_S = 2.5
"""How long a clock that went back without a silence must be the only one heard to count as a reboot."""

STEADY_MS = 1250
"""How exactly a clock that may have begun in a silence must go on at the rate of time, for CONFIRM_S: frames that were
kept come faster than they were sent, at more than 1.5 times the rate."""

TWO_CLOCKS_S = 10.0
"""When only one of two clocks was heard for this time, there is one vehicle again."""


class BootClock:
    """`on_boot_ms` takes each time_boot_ms that is read and returns whether the vehicle has restarted since the
    last."""

    __slots__ = ("_at", "_before", "_boot_ms", "_two_at", "_young", "went_back_at")

    def __init__(self) -> None:
        self._boot_ms: int | None = None
        self._at = 0.0
        self._before: tuple[int, float] | None = None
        """The clock as it was before it went back, and when that was heard last."""
        self._young: tuple[int, float] | None = None
        """A clock that may have begun in the silence after `_before`: a value, and when it came."""
        self._two_at = float("-inf")
        self.went_back_at: float | None = None
        """Since when there may be a second clock; None: there is one clock. While set, every clock must be read."""

    def on_boot_ms(self, boot_ms: int, now: float) -> bool:
        if self._young is not None:
            return self._is_steady(boot_ms, now, self._young)
        if self._before is not None and self._is_the_one_before(boot_ms, now):
            self._two_at = now
            self._before = self.went_back_at = None
            self._boot_ms, self._at = boot_ms, now
            return False
        last, silent_s = self._boot_ms, now - self._at
        if last is not None and self._began_in_silence(boot_ms, silent_s):
            self._before, self._young, self.went_back_at = (last, self._at), (boot_ms, now), now
            self._boot_ms, self._at = boot_ms, now
            return False
        if last is None or boot_ms >= last:
            self._boot_ms, self._at = boot_ms, now
            return self._confirmed(now) if silent_s < SILENCE_S else self._found_alone(now)
        if last - boot_ms <= JITTER_MS:
            return self._confirmed(now)
        wrapped = last > WRAP_MS - WRAP_MARGIN_MS and boot_ms < WRAP_MARGIN_MS
        before, self._boot_ms, self._at = (last, self._at), boot_ms, now
        if wrapped:
            return False
        if now - before[1] >= SILENCE_S:
            self._before = self.went_back_at = None
            return True
        self._before, self.went_back_at = before, now
        return False

    def _began_in_silence(self, boot_ms: int, silent_s: float) -> bool:
        """True if its clock began during the silence before this value."""
        silent_ms, last = 1000 * silent_s, self._boot_ms
        if last is None or silent_s < SILENCE_S or last > WRAP_MS - WRAP_MARGIN_MS:
            return False
        return last - JITTER_MS <= boot_ms <= silent_ms and boot_ms < last + silent_ms - JITTER_MS

    def _is_steady(self, boot_ms: int, now: float, young: tuple[int, float]) -> bool:
        """True if the clock that may have begun in a silence has; while that is not decided, and if not, False."""
        assert self._before is not None
        self._boot_ms, self._at = boot_ms, now
        if abs(_ahead_ms(boot_ms, now, self._before)) <= JITTER_MS:
            self._young = self._before = self.went_back_at = None
            return False
        if now - young[1] < CONFIRM_S:
            return False
        if abs(_ahead_ms(boot_ms, now, young)) > STEADY_MS:
            self._young = boot_ms, now
            return False
        self._young = self._before = self.went_back_at = None
        return True

    def _is_the_one_before(self, boot_ms: int, now: float) -> bool:
        """True if this value continues the old clock rather than the new one."""
        assert self._before is not None and self._boot_ms is not None
        ahead_ms = _ahead_ms(boot_ms, now, self._before)
        return abs(ahead_ms) < abs(_ahead_ms(boot_ms, now, (self._boot_ms, self._at)))

    def _confirmed(self, now: float) -> bool:
        if self.went_back_at is None or now - self.went_back_at < CONFIRM_S:
            return False
        return self._found_alone(now)

    def _found_alone(self, now: float) -> bool:
        """The clock that went back is the only one. True if that is a reboot, not the remaining one of two vehicles."""
        went_back = self.went_back_at is not None and not self.two_clocks(now)
        self._before = self.went_back_at = None
        return went_back

    def two_clocks(self, now: float) -> bool:
        """True if the clocks show two vehicles with this id."""
        return now - self._two_at < TWO_CLOCKS_S

    def forget(self) -> None:
        """A boot text reported the reboot: the next time_boot_ms starts a new clock and is not a second reboot."""
        self._boot_ms = None
        self._before = self._young = self.went_back_at = None

    def uptime_s(self, now: float) -> float | None:
        return None if self._boot_ms is None else self._boot_ms / 1000 + (now - self._at)


def _ahead_ms(boot_ms: int, now: float, clock: tuple[int, float]) -> float:
    """How far a value is ahead of a clock that had another one at another time, ms."""
    return boot_ms - clock[0] - 1000 * (now - clock[1])


REPORT_AGAIN_S = 60.0
"""Period of the reports while others send heartbeats with its ids."""

BESIDE_OVER_S = 5.0
"""Heartbeats come at 1 Hz: after this time without a contradicting heartbeat or a second clock, only one sender is left
on the vehicle's channel."""

Finding = tuple[str, str, dict[str, Any]]
"""Kind, text and data of an event."""


class SharedIds:
    """Other senders with the ids of one vehicle. Its methods return what is to be reported; None: nothing new."""

    beside = False
    """Two vehicles send with these ids on one channel: the vehicle's state mixes both."""

    def __init__(self, sysid: int, compid: int) -> None:
        self.others: Mapping[int, str] = {}
        """The fleet's table by sysid << 8 | compid: where another vehicle sends with these ids, and where this one
        does."""
        self._sysid, self._compid = sysid, compid
        self._heard: dict[str, tuple[int, float]] = {}
        """Number of others' heartbeats, and when that was reported."""

    @property
    def elsewhere(self) -> str | None:
        """Where another vehicle sends with these ids on another channel; None: nowhere."""
        return self.others.get(self._sysid << 8 | self._compid)

    @property
    def where(self) -> str | None:
        """Where the two vehicles with one system id send; None: there is only one."""
        return self.elsewhere or ("on one link" if self.beside else None)

    def on_heartbeat(
        self, origin: HeartbeatOrigin, kind: str, autopilot: str, arming: str, known: str, now: float
    ) -> Finding | None:
        """A heartbeat that is not the vehicle's own, with its MAV_TYPE, MAV_AUTOPILOT and arming state. ``known``: mode
        and arming state of the vehicle."""
        count, reported_at = self._heard.get(origin, (0, -math.inf))
        count += 1
        if now - reported_at < REPORT_AGAIN_S:
            self._heard[origin] = count, reported_at
            return None if origin == "other" else self._set_beside(True)
        self._heard[origin] = count, now
        shown = f"HEARTBEAT of type {kind}, autopilot {autopilot}, {arming}"
        data = {"sysid": self._sysid, "compid": self._compid, "type": kind, "autopilot": autopilot, "count": count}
        if origin == "other":
            text = (
                f"another component sends with the ids {self._sysid}/{self._compid} of the autopilot: {shown}; it is "
                "ignored; give that component an id of its own (an onboard computer is 191)"
            )
            return "conflict", text, {**data, "change": "other_heartbeat"}
        text = (
            f"{self._two_on_one_link}: {shown} contradicts {known}, and is ignored; switch one off and give it another "
            "id"
        )
        self.beside = True
        return "duplicate", text, {**data, "change": "duplicate"}

    def on_clock(self, boot: BootClock, now: float) -> Finding | None:
        """The vehicle's clock was read."""
        if self.beside or not boot.two_clocks(now):
            return None
        self.beside = True
        text = f"{self._two_on_one_link}: their clocks (time_boot_ms) differ; switch one off and give it another id"
        return "duplicate", text, {"change": "duplicate", "sysid": self._sysid}

    def tick(self, heartbeats: HeartbeatCheck, boot: BootClock, now: float) -> Finding | None:
        """Find that there is only one vehicle on its channel any more."""
        contradicted = now - heartbeats.contradicted_at <= BESIDE_OVER_S
        if contradicted or heartbeats.alternating or boot.two_clocks(now):
            return None
        return self._set_beside(False)

    def _set_beside(self, beside: bool) -> Finding | None:
        if beside == self.beside:
            return None
        self.beside = beside
        if beside:
            return "duplicate", self._two_on_one_link, {"change": "duplicate"}
        text = f"only one vehicle with system id {self._sysid} sends on its link any more"
        return "duplicate", text, {"change": "duplicate_over"}

    @property
    def _two_on_one_link(self) -> str:
        return f"two vehicles with system id {self._sysid} send on one link"
