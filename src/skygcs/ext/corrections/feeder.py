"""Keeps one source of corrections going: begin, take its bytes to the vehicles, end, back off, begin again.

connecting ──► waiting ──a message──► streaming ──lost──► down ──back-off──► waiting ──► ...
     │            └──another's go──► held_off ──a message──► streaming
     └──────could not connect─────────────────────────────► down

What it takes goes to the daemon's `CorrectionFeed`, as the pieces of any client of the socket do.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable
from typing import Any, Literal, Protocol

from skygcs.back_off import BackOff
from skygcs.core.radio_link.corrections import MAX_TYPES
from skygcs.core.token_bucket import TokenBucket
from skygcs.errors import LinkError, RefusedError
from skygcs.events import Event
from skygcs.ext.corrections.correction_feed import RATE_S, CorrectionFeed
from skygcs.ext.corrections.ntrip import RefusedByCaster
from skygcs.links.base import STABLE_AFTER_S
from skygcs.runtime.loop_clock import PAUSED

FIRST_BACK_OFF_S = 1.0
LONGEST_BACK_OFF_S = 30.0
"""A public caster bars whoever calls it every second."""

REFUSED_AGAIN_S = 60.0
"""A refusal stays until somebody changes something."""

NO_MESSAGE_S = 30.0
"""Bytes without a whole message in them for so long are something else."""

BYTES_PER_S, BURST_BYTES = 100_000.0, 1_000_000.0
"""A source is read from no faster on the average: a network station of all constellations at 10 Hz sends 30 kB/s, and
each kilobyte takes 0.1 to 0.3 ms of the loop, of a stream without messages 1 ms. TCP or USB holds up one that floods;
its stream then ages, as it would in a radio."""

MAX_PIECES = 1024
"""Kept for the rate."""

MAX_NAME_CHARS = 64

FeederState = Literal["connecting", "waiting", "streaming", "held_off", "down"]


def flow_of(now: float) -> TokenBucket:
    """Bytes that may be read from a source: `spend` those that were, and read again at `ready_at`."""
    return TokenBucket(BYTES_PER_S, BURST_BYTES, now)


class Source(Protocol):
    """Where corrections come from."""

    name: str
    """Its name for a person; never with a password."""

    @property
    def kind(self) -> Literal["ntrip", "receiver"]: ...

    async def run(self, feeder: Feeder) -> None:
        """Connect, call `Feeder.connected`, and give what comes to `Feeder.take`, until it ends or fails. Raises
        LinkError with the reason and what to do."""
        ...

    def status(self, now: float) -> dict[str, Any]:
        """Its part of the status: ``gga`` and ``survey``."""
        ...


class Feeder:
    """One source's life and counts. ``since`` is the time of its state; ``text`` the latest trouble, "" without one."""

    def __init__(
        self,
        source: Source,
        feed: CorrectionFeed,
        clock: Callable[[], float],
        publish: Callable[[Event], None],
        asleep: Callable[[], bool] = lambda: False,
    ) -> None:
        """``asleep``: `SleepWatch.check`."""
        self.source = source
        self.state: FeederState = "connecting"
        self.since = clock()
        self.text = ""
        self.failures = 0
        """Attempts since it was up last."""
        self.connected_count = 0
        self._feed = feed
        self._clock = clock
        self._publish = publish
        self._name = f"[corrections] {source.name}"[:MAX_NAME_CHARS]
        self._bytes = self._messages = 0
        self._last_at: float | None = None
        """Time of the last message."""
        self._pieces: deque[tuple[float, int]] = deque(maxlen=MAX_PIECES)
        self._types: dict[str, int] = {}
        self._sending = False
        """The feed has taken a piece of this connection."""
        self._told_down = False
        self._asleep = asleep
        self._woke: str | None = None
        """Why what this connection still brings is of before a sleep or a standstill; None: it is not."""

    async def run(self) -> None:
        """Until cancelled. Nothing that a source does ends it."""
        back_off = BackOff(FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S, STABLE_AFTER_S)
        try:
            while True:
                reason, pause_s = await self._one_life(back_off)
                self._went_down(reason)
                await asyncio.sleep(pause_s)
        finally:
            self._end_stream()

    def connected(self) -> None:
        """The source answers; messages have not come yet."""
        self.connected_count += 1
        self._enter("waiting")

    def woke(self, why: str) -> None:
        """After a sleep or a standstill: the connection ends with the next bytes that it brings, unread, and is made
        anew. A caster's backlog and a port's buffer may be of hours ago, and RTCM does not say when it was made."""
        if self.state in ("waiting", "streaming", "held_off"):
            self._woke = why

    def take(self, data: bytes) -> None:
        """Bytes of the source: RTCM 3 in any pieces. Raises LinkError if there is no message in them for
        `NO_MESSAGE_S`, and if they may be of before a sleep or a standstill."""
        if self._asleep() and self._woke is None:
            self._woke = PAUSED
        if self._woke is not None:
            raise LinkError(f"{self._woke}: what has waited is not sent, it is connected anew")
        now = self._clock()
        self._bytes += len(data)
        self._pieces.append((now, len(data)))
        try:
            taken = self._feed.send(self._name, data)
        except RefusedError as refusal:
            self._hold_off(str(refusal))
            return
        self._sending = True
        if self.state == "held_off":  # its turn has come: it has to bring messages as at its begin
            self._enter("waiting")
        for type_, count in taken["types"].items():
            if type_ in self._types or len(self._types) < MAX_TYPES:
                self._types[type_] = self._types.get(type_, 0) + count
        came = taken["messages"] + taken["refused"] + taken["too_long"]
        if came:
            self._messages += came
            self._last_at = now
            self._streams()
        else:
            self.check_messages()

    def check_messages(self) -> None:
        """Raise LinkError if bytes came for `NO_MESSAGE_S` and no message."""
        last = self.since if self.state == "waiting" or self._last_at is None else self._last_at
        if self.state in ("waiting", "streaming") and self._clock() - last > NO_MESSAGE_S:
            raise LinkError(
                f"bytes come, and no RTCM 3 message in them for {NO_MESSAGE_S:g} s: does it send RTCM 2, or raw data?"
            )

    def report(self, change: str, text: str, **data: Any) -> None:
        """Publish an event about the source."""
        told = {"source": self.source.name, "change": change, **data}
        self._publish(Event("corrections", None, None, text, told))

    def status(self) -> dict[str, Any]:
        """JSON-able, for corrections.status and daemon.info."""
        now = self._clock()
        while self._pieces and self._pieces[0][0] < now - RATE_S:
            self._pieces.popleft()
        return {
            "kind": self.source.kind,
            "name": self.source.name,
            "state": self.state,
            "text": self.text,
            "since_s": round(now - self.since, 1),
            "connected": self.connected_count,
            "failures": self.failures,
            "bytes": self._bytes,
            "bytes_per_s": round(sum(size for _, size in self._pieces) / RATE_S, 1),
            "messages": self._messages,
            "age_s": None if self._last_at is None else round(now - self._last_at, 2),
            "types": dict(sorted(self._types.items(), key=lambda item: int(item[0]))),
            **self.source.status(now),
        }

    # -- the inside

    async def _one_life(self, back_off: BackOff) -> tuple[str, float]:
        """Connect and wait for the end; its reason, and how long to pause."""
        refused, self._woke = False, None
        try:
            await self.source.run(self)
            reason = "it ended"
        except RefusedByCaster as error:
            reason, refused = str(error), True
        except LinkError as error:
            reason = str(error)
        except Exception as error:  # a fault of ours stays here, and without its text, which may hold what was sent
            reason = f"unexpected {type(error).__name__}"
        up_s = self._clock() - self.since if self.state in ("streaming", "held_off") else 0.0
        pause_s = back_off.after(up_s)
        return reason, REFUSED_AGAIN_S if refused else pause_s

    def _streams(self) -> None:
        if self.state == "streaming":
            self.text = ""
            return
        self._enter("streaming")
        self.text = ""
        self.failures = 0
        again = " again" if self._told_down else ""
        self._told_down = False
        self.report("up", f"corrections of {self.source.name} come{again}")

    def _hold_off(self, reason: str) -> None:
        """Another program's corrections go to the vehicles: ours are not wanted as long as they come."""
        self.text = reason
        self._sending = False
        if self.state != "held_off":
            self._enter("held_off")
            self.report("held_off", f"corrections of {self.source.name} are not sent: {reason}")

    def _went_down(self, reason: str) -> None:
        self._end_stream()
        self._enter("down")
        self.text = reason
        self.failures += 1
        if not self._told_down:
            self._told_down = True
            self.report("down", f"no corrections of {self.source.name}: {reason}", reason=reason)

    def _end_stream(self) -> None:
        """Let another program's corrections follow at once, and forget a message of which only a part came."""
        if self._sending:
            self._sending = False
            with contextlib.suppress(RefusedError):  # another one's go since it was silent
                self._feed.send(self._name, b"", end=True)

    def _enter(self, state: FeederState) -> None:
        if state != self.state:
            self.state = state
            self.since = self._clock()
