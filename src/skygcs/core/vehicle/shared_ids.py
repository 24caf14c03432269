"""Other senders with a vehicle's ids: a component of its system, or another vehicle. Pure.

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
from skygcs.core.vehicle.boot import BootClock

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
