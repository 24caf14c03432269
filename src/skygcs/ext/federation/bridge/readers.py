"""Reads what other sites publish: batches, events, and answers to the pings that compare the clocks.

Only the newest batch of each site waits to be read: a slow station reads fewer batches, not older ones. Of a site that
floods the hub one batch is read per LEAST_APART_S, and EVENTS_PER_S events. A site is pinged at its first batch, then
each QUICK_S until QUICK_PINGS are answered, since the quickest answer is the best, and then each PING_EVERY_S.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import structlog
from pydantic_core import from_json, to_json

from skygcs.core.alarms import with_severity
from skygcs.core.token_bucket import TokenBucket
from skygcs.errors import BusError
from skygcs.ext.federation.bridge.bus import Bus, Message
from skygcs.ext.federation.bridge.site_clock import SiteClock
from skygcs.ext.federation.protocol.order_messages import MAX_SEQ
from skygcs.ext.federation.protocol.received_json import cleaned
from skygcs.ext.federation.protocol.remote_sites import FORGET_AFTER_S, MAX_SITES, RemoteSites
from skygcs.ext.federation.protocol.site_names import SITE_NAME
from skygcs.ext.federation.protocol.state_batch import decode_batch
from skygcs.spelling import is_number

FAST_HZ = 10
"""``subscribe_hz`` from which a station reads the fast batches."""

LEAST_APART_S = 0.03
"""Least time between two batches of a site that are read. At the highest rate they are 50 ms apart."""

EVENTS_PER_S, EVENT_BURST = 50.0, 500.0
"""Events of a site, in the long run and at once; further ones are dropped and counted. The takeoff of a whole fleet has
a few hundred at once."""

PING_EVERY_S = 2.0
QUICK_S = 0.25
QUICK_PINGS = 8
PING_WITHIN_S = 1.0
"""Time limit of the answer to a ping."""

MAX_EVENT_BYTES = 16_384
"""Longest event; longer ones are dropped and counted."""

MAX_UNIX_S = 1e11
"""Latest time of an event, the year 5138: a time beyond it cannot be shown."""

MAX_EVENTS = 500
"""Events of other sites that are kept for events.recent."""

MAX_SENDERS = 2 * MAX_SITES
"""Names under which batches or events are taken, also those that no batch could be read of."""

_log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Sender:
    event_rate: TokenBucket
    heard_at: float = -math.inf
    """When its last message came."""
    read_at: float = -math.inf
    """When a batch of it was last read."""
    event_run: str | None = None
    event_seq: int = 0
    """Sequence number of its last event."""


class Readers:
    """A part of the bridge. Run `run` in a task."""

    def __init__(
        self,
        bus: Bus,
        sites: RemoteSites,
        clock: SiteClock,
        *,
        own_site: str | None,
        subscribe_hz: float = 10.0,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self.recent: deque[dict[str, Any]] = deque(maxlen=MAX_EVENTS)
        """Events of other sites, with ``site``."""
        self._bus = bus
        self._sites = sites
        self._clock = clock
        self._own_site = own_site
        self._series = "fast" if subscribe_hz >= FAST_HZ else "slow"
        self.on_batch: list[Callable[[str], None]] = []
        """Called with the site's name after each new batch."""
        self.on_event: list[Callable[[str, Mapping[str, Any]], None]] = []
        """Called with the site's name and the event."""
        self._waiting: dict[str, bytes] = {}
        self._senders: dict[str, _Sender] = {}
        self._pinged_at: dict[str, float] = {}
        self._answered: Counter[str] = Counter()
        """Number of answered pings by site."""
        self._pings: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Read until it is cancelled."""
        async with contextlib.AsyncExitStack() as stack:
            for subject, read in ((f"state.*.{self._series}", self._on_state), ("event.*", self._on_event)):
                stack.push_async_callback((await self._bus.subscribe(subject, read)).close)
            while True:
                await asyncio.sleep(QUICK_S)
                self._ping_sites()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {"series": self._series, "sites": len(self._sites.names), **self.counters, **self._sites.counters}

    # -- states

    def _on_state(self, message: Message) -> None:
        """Keep the newest batch of the site, and read it at the end of this turn of the loop, or LEAST_APART_S after
        the last one."""
        site = _site_of(message.subject)
        now = self._clock.now_s()
        sender = None if site is None else self._sender(site, now)
        if site is None or sender is None:
            self.counters["batches_bad"] += 1
            return
        if site in self._waiting:
            self.counters["batches_skipped"] += 1
            self._waiting[site] = message.data
            return
        self._waiting[site] = message.data
        wait_s = sender.read_at + LEAST_APART_S - now
        asyncio.get_running_loop().call_later(max(0.0, wait_s), self._read, site, sender)

    def _read(self, site: str, sender: _Sender) -> None:
        data, now = self._waiting.pop(site), self._clock.now_s()
        sender.read_at = now
        try:
            batch = decode_batch(data)
            if batch.site != site:
                raise ValueError(f"it names the site {batch.site}")
        except ValueError as error:
            self.counters["batches_bad"] += 1
            _log.debug("bad batch", site=site, reason=str(error))
            return
        new = site not in self._sites
        if not self._sites.take(batch, now):
            return
        self.counters["batches"] += 1
        if new:
            _log.info("site heard", site=site, vehicles=len(batch.vehicles))
            self._ping_sites()
        for observe in self.on_batch:
            observe(site)

    # -- events

    def _on_event(self, message: Message) -> None:
        site = _site_of(message.subject)
        if site is None or site == self._own_site:
            return
        now = self._clock.now_s()
        sender = self._sender(site, now)
        if sender is None or not sender.event_rate.take(now):
            self.counters["events_beyond_rate"] += 1
            return
        try:
            if len(message.data) > MAX_EVENT_BYTES:
                raise ValueError("too long")
            found = cleaned(from_json(message.data, allow_inf_nan=False))
            run, seq, event = found["run"], found["seq"], found["event"]
            if found["site"] != site or not isinstance(run, str) or not isinstance(seq, int) or not 0 <= seq <= MAX_SEQ:
                raise ValueError("no event")
            if not _is_event(event):
                raise ValueError("no event")
        except (ValueError, KeyError, TypeError):
            self.counters["events_bad"] += 1
            return
        if sender.event_run == run and seq > sender.event_seq + 1:
            self.counters["events_lost"] += seq - sender.event_seq - 1
        sender.event_run, sender.event_seq = run, seq
        event = with_severity(event)
        self.recent.append({**event, "site": site})
        for observe in self.on_event:
            observe(site, event)

    def _sender(self, site: str, now: float) -> _Sender | None:
        """Return what is kept of a site that is heard now; None: all MAX_SENDERS places are taken by sites that were
        heard within FORGET_AFTER_S."""
        sender = self._senders.get(site)
        if sender is None:
            if len(self._senders) >= MAX_SENDERS:
                longest_silent = min(self._senders, key=lambda other: self._senders[other].heard_at)
                if now - self._senders[longest_silent].heard_at < FORGET_AFTER_S:
                    return None
                del self._senders[longest_silent]
                self.counters["senders_forgotten"] += 1
            sender = self._senders[site] = _Sender(TokenBucket(EVENTS_PER_S, EVENT_BURST, now))
        sender.heard_at = now
        return sender

    # -- the offset of clocks

    def _ping_sites(self) -> None:
        now = self._clock.now_s()
        for site in self._sites.names:
            known = self._sites.clock(site, now) is not None and self._answered[site] >= QUICK_PINGS
            every_s = PING_EVERY_S if known else QUICK_S
            if now - self._pinged_at.get(site, float("-inf")) >= every_s and len(self._pings) < 2 * MAX_SITES:
                self._pinged_at[site] = now
                task = asyncio.get_running_loop().create_task(self._ping(site), name=f"ping {site}")
                self._pings.add(task)
                task.add_done_callback(self._pings.discard)
        for site in [site for site in self._pinged_at if site not in self._sites]:
            del self._pinged_at[site]
            self._answered.pop(site, None)

    async def _ping(self, site: str) -> None:
        sent = self._clock.now_s()
        try:
            data = await self._bus.request(f"here.{site}", to_json({"t0_s": sent}), PING_WITHIN_S)
        except BusError:  # the site's age stays unknown, and is shown as unknown
            self.counters["pings_unanswered"] += 1
            return
        received = self._clock.now_s()
        try:
            answer = from_json(data, allow_inf_nan=False)
            t0_s, site_s, run = answer["t0_s"], answer["site_s"], answer["run"]
        except (ValueError, KeyError, TypeError):
            t0_s = site_s = run = None
        if t0_s != sent or not isinstance(run, str) or not is_number(site_s):
            self.counters["pings_bad"] += 1
            return
        if self._sites.compare_clock(site, run, sent, received, site_s, unix_received=time.time()):
            self.counters["pings"] += 1
            self._answered[site] += 1


def _site_of(subject: str) -> str | None:
    """The second token of a subject; None if it is not the name of a site."""
    tokens = subject.split(".")
    return tokens[1] if len(tokens) > 1 and SITE_NAME.fullmatch(tokens[1]) else None


def _is_event(event: object) -> bool:
    """True for what clients of the daemon expect of an event."""
    return (
        isinstance(event, dict)
        and isinstance(event.get("text"), str)
        and isinstance(event.get("kind"), str)
        and isinstance(event.get("vehicle"), str | None)
        and is_number(at_unix_s := event.get("time_unix_s"))
        and 0 <= at_unix_s <= MAX_UNIX_S
    )
