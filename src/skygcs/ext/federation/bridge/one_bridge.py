"""Lets one bridge at a time act under the site's name: `ext.federation.protocol.bridge_election` over the hub."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Protocol

from skygcs.events import Event
from skygcs.ext.federation.bridge.bus import Message, OnMessage
from skygcs.ext.federation.protocol.bridge_election import BridgeClaim, BridgeElection, BridgeState, decode_claim

WHAT_TO_DO = (
    "end one of the two, or give its computer a site name and key of its own ([federation] site, nkey). "
    "This one goes on by itself 10 s after the other one has ended"
)


class ClaimBus(Protocol):
    """Interface needed of the hub's `Bus`."""

    connected: bool

    async def publish(self, subject: str, data: bytes) -> bool: ...

    async def subscribe(self, subject: str, on_message: OnMessage) -> Any: ...

    def on_change(self, observer: Callable[[], None]) -> None: ...


class OneBridge:
    """A part of the bridge: `run` in a task. ``on_change`` is called after each change of the state."""

    def __init__(
        self,
        bus: ClaimBus,
        site: str,
        election: BridgeElection,
        clock: Callable[[], float],
        report: Callable[[Event], None],
        unix_clock: Callable[[], float] = time.time,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self.on_change: Callable[[], None] = _nothing
        self._bus = bus
        self._site = site
        self._election = election
        self._clock = clock
        self._unix_clock = unix_clock
        self._report = report
        self._wake = asyncio.Event()
        self._answer = False
        self._reported: tuple[BridgeState, str] | None = None
        """State and run of the other bridge that were reported last."""
        bus.on_change(self._wake.set)

    @property
    def state(self) -> BridgeState:
        return self._election.state

    @property
    def stood_by(self) -> bool:
        """Another bridge has acted as this site since this one began."""
        return self._election.stood_by

    def why_standby(self) -> str | None:
        """Which bridge to ask instead of this one; None unless this one stands by."""
        if self.state is not BridgeState.STANDBY:
            return None
        other = self._election.other(self._clock())
        which = "" if other is None else f" (host {other.host}, process {other.pid})"
        return f"another bridge of {self._site}{which} leads and this one stands by: ask there"

    async def run(self) -> None:
        """Claim until it is cancelled."""
        subject = f"bridge.{self._site}"
        subscription = await self._bus.subscribe(subject, self._on_claim)
        try:
            while True:
                # an answer is no step of the election: those are counted, and come in time
                claim = self._answer or self._election.tick(
                    self._clock(), self._unix_clock(), connected=self._bus.connected
                )
                self._answer = False
                self._changed()
                if claim:
                    await self._bus.publish(subject, self._election.claim.encoded())
                await self._wait(self._election.next_tick_s)
        finally:
            await subscription.close()

    def status(self) -> dict[str, Any]:
        """JSON-able. ``other``: another bridge of this site that is heard."""
        other = self._election.other(self._clock())
        described = None if other is None else {"state": other.state, "host": other.host, "pid": other.pid}
        return {"state": self.state, "other": described, **self.counters}

    async def _wait(self, seconds: float) -> None:
        """Wait for the next claim; a change of the connection, or another bridge's question, ends it."""
        self._wake.clear()
        if self._answer:
            return
        try:
            async with asyncio.timeout(seconds):
                await self._wake.wait()
        except TimeoutError:
            return

    def _on_claim(self, message: Message) -> None:
        try:
            claim = decode_claim(message.data)
        except ValueError:
            self.counters["claims_bad"] += 1
            return
        before = self.state
        if self._election.heard(claim, self._clock()):
            self._answer = True
            self._wake.set()
        if self.state is not before:
            self._changed()

    def _changed(self) -> None:
        """Report a change once; two bridges that stay are one."""
        other = self._election.other(self._clock())
        now = (self.state, "" if other is None else other.run)
        before, self._reported = self._reported, now
        if before == now:
            return
        if (text := self._text(other)) is not None:
            data = {"change": "bridge", "state": str(self.state)}
            self._report(Event("federation" if other is None else "warning", None, None, text, data))
        if before is None or before[0] is not self.state:
            self.on_change()

    def _text(self, other: BridgeClaim | None) -> str | None:
        if other is None:
            again = self.stood_by and self.state is BridgeState.ACTIVE
            return f"federation: the other bridge is gone; this one acts as {self._site}" if again else None
        who = f"another bridge (host {other.host}, process {other.pid})"
        if self.state is BridgeState.ACTIVE:
            return f"federation: {who} was started as {self._site}, too, and stands by: end it"
        if self.state is BridgeState.STANDBY:
            return f"federation: {who} acts as {self._site}, so this one stands by: {WHAT_TO_DO}"
        return None


def _nothing() -> None:
    """Until somebody wants to know."""
