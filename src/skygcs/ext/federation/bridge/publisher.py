"""Publishes this site: a batch of its vehicles' states each period, its events, and answers to requests.

state.<site>.fast           after each round of the daemon's states (rate_hz), or after LATE_PERIODS without one, then
                            with growing ages
state.<site>.slow           the same bytes, once in SLOW_S
state.<site>.full.<vehicle> request-reply: the daemon's whole state of one vehicle
here.<site>                 request-reply: the site's clock, for the comparison of clocks
event.<site>                the daemon's events, each with a sequence number

the daemon                  the site
--------------------------  ------------------------------------------------------------------------------------------
sends rounds                sends a batch after each
is stopped                  sends batches with growing ages
ends                        the same, with "daemon": false; connects again after a pause
is back                     drops the old states and sends those of the new daemon
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import structlog
from pydantic_core import from_json, to_json

from skygcs.cancellation import together
from skygcs.errors import RpcError
from skygcs.ext.federation.bridge.bus import Bus, Message
from skygcs.ext.federation.bridge.daemon_link import DaemonLink
from skygcs.ext.federation.bridge.own_origin import OwnOrigin
from skygcs.ext.federation.bridge.site_clock import SiteClock
from skygcs.ext.federation.protocol.own_states import LeaseOf, OwnStates, no_lease
from skygcs.ext.federation.protocol.site_names import name_of_token
from skygcs.ext.federation.protocol.state_batch import STATE_GROUPS, encode_batch
from skygcs.rpc.client import Client
from skygcs.spelling import is_number

SLOW_S = 0.5
"""Period of the slow batches: 2 Hz."""

LATE_PERIODS = 2.0
"""Periods without a round after which a batch is sent without one."""

REFUSED_PAUSE_S = 1.0
"""Pause before a daemon that refused a subscription is asked again."""

STOOD_STILL_S = 0.4
"""Least silence of the daemon after which the next states may be old ones from the socket (`_catch_up`)."""

MAX_FULL_AT_ONCE = 8
"""Whole states that are requested from the daemon at the same time; further requests are refused."""

FULL_WITHIN_S = 0.8
"""Time limit of the daemon's answer; the asking station waits for 1 s."""

_log = structlog.get_logger(__name__)


class Publisher:
    """A part of the bridge. Run `run` in a task. ``lease_of`` may be set by the part that holds the leases."""

    def __init__(self, bus: Bus, link: DaemonLink, clock: SiteClock, states: OwnStates, rate_hz: float) -> None:
        """``link``: used by this part only, and run here."""
        self.counters: Counter[str] = Counter()
        self.last_bytes = 0
        self.lease_of: LeaseOf = no_lease
        self._bus = bus
        self._link = link
        self._clock = clock
        self._states = states
        self._site = states.site
        self._period_s = 1.0 / rate_hz
        self._own = OwnOrigin(link)
        self._changed = asyncio.Event()
        self._round_over = asyncio.Event()
        self._slow_at = -math.inf
        self._came_at = 0.0
        """Time of the daemon's last states."""
        self._waited_s = 0.0
        """How much older than their ages the states may be that are received now."""
        self._event_seq = 0
        self._full = asyncio.Semaphore(MAX_FULL_AT_ONCE)
        link.on_change(self._changed.set)

    async def run(self) -> None:
        """Publish and answer until it is cancelled."""
        async with contextlib.AsyncExitStack() as stack:
            for subject, answer in ((f"here.{self._site}", self._ping), (f"state.{self._site}.full.*", self._whole)):
                stack.push_async_callback((await self._bus.serve(subject, answer)).close)
            async with asyncio.TaskGroup() as group:
                group.create_task(self._link.run(), name="daemon of the publisher")
                group.create_task(self._follow_daemon(), name="states of the daemon")
                group.create_task(self._send_batches(), name="batches")

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        names = self._states.names
        return {
            "daemon": self._link.client is not None,
            "vehicles": len(names),
            "shared": sum(self._states.shares(name) for name in names),
            "seq": self._states.seq,
            "bytes": self.last_bytes,
            **self.counters,
            **self._states.counters,
        }

    # -- batches

    async def _send_batches(self) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LATE_PERIODS * self._period_s):
                    await self._round_over.wait()
            self._round_over.clear()
            await self._send_batch()

    async def _send_batch(self) -> None:
        now = self._clock.now_s()
        there = self._link.client is not None
        batch = self._states.batch(now, self._clock.site_s(), self._own.origin, daemon=there, lease_of=self.lease_of)
        data = encode_batch(batch)
        self.last_bytes = len(data)
        slow = now - self._slow_at >= SLOW_S - 0.5 * self._period_s
        if slow:
            self._slow_at = now
        for series in ("fast", "slow") if slow else ("fast",):
            sent = await self._bus.publish(f"state.{self._site}.{series}", data)
            self.counters[f"batches_{series}" if sent else "batches_dropped"] += 1

    # -- the daemon

    async def _follow_daemon(self) -> None:
        while True:
            self._changed.clear()
            client = self._link.client
            if client is None:
                await self._changed.wait()
                continue
            self._states.begin_anew(self._clock.now_s())
            try:
                await together(
                    rounds=self._take_rounds(client), events=self._send_events(client), origin=self._own.follow()
                )
            except RpcError as error:
                _log.warning("daemon lost", site=self._site, reason=str(error))
            if self._link.client is client:  # it refused a subscription: pause before the next attempt
                await asyncio.sleep(REFUSED_PAUSE_S)

    async def _take_rounds(self, client: Client) -> None:
        self._came_at = self._clock.now_s()
        self._waited_s = 0.0
        asking: asyncio.Task[None] | None = None
        try:
            async for update in client.encoded_telemetry("all", rate_hz=1.0 / self._period_s, groups=STATE_GROUPS):
                now = self._clock.now_s()
                silence_s, self._came_at = now - self._came_at, now
                if silence_s > max(STOOD_STILL_S, LATE_PERIODS * self._period_s):
                    self._waited_s += silence_s
                    if asking is None or asking.done():
                        asking = asyncio.get_running_loop().create_task(self._catch_up(client), name="catch up")
                self._take_round(update, now)
        finally:
            if asking is not None:
                asking.cancel()

    def _take_round(self, update: dict[str, Any], now: float) -> None:
        for state in update["states"].values():
            self._states.put(from_json(state), now - self._waited_s)
        if update["complete"]:
            self._states.end_round(now - self._waited_s)
            self._round_over.set()

    async def _catch_up(self, client: Client) -> None:
        """After a silence this process may have been stopped, with older states waiting in the socket; states have no
        time of their own. They count as older by the silence until the daemon has answered a request: states after that
        answer are new."""
        with contextlib.suppress(RpcError):
            await client.call("daemon.info")
            self._waited_s = 0.0

    async def _send_events(self, client: Client) -> None:
        async for event in client.events():
            if event.get("vehicle") and not self._states.shares(str(event["vehicle"])):
                continue
            await self.send_event(event)

    async def send_event(self, event: Mapping[str, Any]) -> None:
        """Publish an event of the daemon or of this bridge to all stations."""
        self._event_seq += 1
        sent = {"v": 1, "site": self._site, "run": self._states.run, "seq": self._event_seq, "event": event}
        if not await self._bus.publish(f"event.{self._site}", to_json(sent, inf_nan_mode="null")):
            self.counters["events_dropped"] += 1

    # -- answers

    async def _ping(self, message: Message) -> bytes:
        site_s = self._clock.site_s()
        try:
            asked = from_json(message.data, allow_inf_nan=False)
        except ValueError:
            asked = None
        t0_s = asked.get("t0_s") if isinstance(asked, dict) else None
        if not is_number(t0_s):
            self.counters["pings_bad"] += 1
            return to_json({"v": 1, "error": "a ping has t0_s, a number"})
        return to_json({"t0_s": t0_s, "site_s": site_s, "run": self._states.run})

    async def _whole(self, message: Message) -> bytes:
        """The whole state of one vehicle, or an error, as JSON."""
        if self._full.locked():
            self.counters["full_refused"] += 1
            return to_json({"v": 1, "error": f"{self._site} is answering {MAX_FULL_AT_ONCE} such requests already"})
        async with self._full:
            try:
                name = name_of_token(message.subject.rpartition(".")[2])
                if not self._states.shares(name):
                    raise ValueError(f"{self._site} shares no vehicle {name!r}")
                async with asyncio.timeout(FULL_WITHIN_S):
                    state = await self._link.relay("vehicles.get", {"target": name})
            except (ValueError, RpcError) as error:
                return to_json({"v": 1, "error": str(error)})
            except TimeoutError:
                return to_json({"v": 1, "error": f"the daemon of {self._site} does not answer"})
        head = {"v": 1, "run": self._states.run, "sent_s": self._clock.site_s()}
        return to_json(head)[:-1] + b',"state":' + state + b"}"
