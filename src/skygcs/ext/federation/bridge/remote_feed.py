"""Notifications about vehicles of other sites for the clients of the station socket: states and events.

    a batch of a site arrives     its states are sent to each subscription that names it, at most rate_hz times a second
    a site is silent              its states are sent once in RESEND_S, with growing ages: a screen shows them grey
    a client does not read        it is sent nothing, and the newest states when it reads again; missed events are
                                  counted

States are encoded once for all subscriptions that ask for the same keys.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from skygcs.core.geo import Origin
from skygcs.errors import TargetError
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.ext.federation.protocol.site_names import SiteTargets, qualified, select_at
from skygcs.rpc.json_lines import EVENT_START, TELEMETRY_START
from skygcs.rpc.models import SubscribeParams
from skygcs.rpc.replies import encode

DEFAULT_RATE_HZ = 2.0
"""Default rate, the same as the daemon's."""

RESEND_S = 1.0
"""Period of repeated states. A page removes vehicles without a state for 3 s."""

EARLY = 0.5
"""Fraction of a period by which states may be sent early; the next ones are due later by as much. Batches jitter, and
leaving one out would cost a whole period of age."""

SHARED_S = 0.02
"""How long encoded states are used again; their ages are those of the encoding."""

MAX_ENCODED = 256
"""Encoded sites that are kept, one for each set of keys; beyond, all are dropped."""

ALWAYS = frozenset({"name", "sysid", "site", "age_s"})
"""Keys that every state has."""


class Reader(Protocol):
    """The part of a client that the feed uses."""

    writable: bool

    def write(self, data: bytes) -> None: ...


class RemoteSubscription:
    """The part of a subscription about other sites. ``number`` is set before `RemoteFeed.add`."""

    def __init__(self, reader: Reader, params: SubscribeParams, targets: SiteTargets) -> None:
        self.reader = reader
        self.number = 0
        self.topic = params.topic
        self.period_s = 1.0 / (params.rate_hz or DEFAULT_RATE_HZ)
        self.names = frozenset(str(name) for name in params.names or ())
        self.dropped = 0
        """Events that the client did not read."""
        self.sent_at: dict[str, float] = {}
        self.due_at: dict[str, float] = {}
        self._parts = targets.others
        self._every = targets.every

    def parts_at(self, site: str) -> Sequence[str]:
        """The targets of this subscription at a site; () for none."""
        return ("all",) if self._every else self._parts.get(site, ())

    def wants(self, site: str, event: Mapping[str, Any], vehicle: str | None) -> bool:
        """True if the subscription includes an event of a site. ``vehicle``: the vehicle's name there."""
        if not self.parts_at(site) or (self.names and event.get("kind") not in self.names):
            return False
        return "all" in self.parts_at(site) or vehicle in self.parts_at(site)


class RemoteFeed:
    """The notifications about other sites. Call `on_batch` and `on_event` after each, and `close` at the end."""

    def __init__(self, sites: RemoteSites, clock: Callable[[], float], ours: Callable[[], Origin | None]) -> None:
        """``clock``: the clock of ``sites``, in seconds. ``ours``: returns the present origin of the own world
        frame."""
        self._sites = sites
        self._clock = clock
        self._ours = ours
        self._subscriptions: dict[RemoteSubscription, None] = {}
        self._encoded: dict[tuple[str, frozenset[str]], tuple[float, dict[str, bytes]]] = {}
        self._timer: asyncio.TimerHandle | None = None

    def checked(self, reader: Reader, params: Mapping[str, Any], targets: SiteTargets) -> RemoteSubscription:
        """The subscription of these parameters. Raises ValidationError."""
        return RemoteSubscription(reader, SubscribeParams.model_validate(dict(params)), targets)

    def add(self, subscription: RemoteSubscription) -> None:
        """Begin a subscription with the newest state of each vehicle."""
        self._subscriptions[subscription] = None
        self.resume(subscription)
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(RESEND_S, self._resend)

    def remove(self, subscription: RemoteSubscription) -> None:
        self._subscriptions.pop(subscription, None)
        if not self._subscriptions:
            self.close()

    def close(self) -> None:
        self._subscriptions.clear()
        self._encoded.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def resume(self, subscription: RemoteSubscription) -> None:
        """The client reads again: send the newest states."""
        for site in self._sites.names:
            self._send(subscription, site)

    def on_batch(self, site: str) -> None:
        """A newer batch of this site has been taken in: send its states."""
        for names in {subscription.names for subscription in self._subscriptions}:
            self._encoded.pop((site, names), None)
        for subscription in list(self._subscriptions):
            self._send(subscription, site)

    def on_event(self, site: str, event: Mapping[str, Any]) -> None:
        """Send an event of another site. ``event``: as its daemon wrote it."""
        vehicle = event.get("vehicle")
        vehicle = vehicle if isinstance(vehicle, str) else None
        named = {**event, "site": site, "vehicle": None if vehicle is None else qualified(site, vehicle)}
        body = b""
        for subscription in list(self._subscriptions):
            if subscription.topic != "events" or not subscription.wants(site, event, vehicle):
                continue
            if not subscription.reader.writable:
                subscription.dropped += 1
                continue
            body = body or EVENT_START + encode(named)
            dropped, subscription.dropped = subscription.dropped, 0
            lost = b',"dropped":%d' % dropped if dropped else b""
            subscription.reader.write(b'%b,"subscription":%d%b}}\n' % (body, subscription.number, lost))

    # -- private

    def _resend(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(RESEND_S, self._resend)
        for subscription in list(self._subscriptions):
            for site in self._sites.names:
                if self._clock() - subscription.sent_at.get(site, 0.0) >= RESEND_S - SHARED_S:
                    self._send(subscription, site)

    def _send(self, subscription: RemoteSubscription, site: str) -> None:
        """Send a site's states if they are due and the client reads."""
        now = self._clock()
        due_at, early_s = subscription.due_at.get(site, now), EARLY * subscription.period_s
        if subscription.topic != "telemetry" or not subscription.reader.writable or now < due_at - early_s:
            return
        parts = subscription.parts_at(site)
        if not parts:
            return
        states = self._states(site, subscription.names, now)
        if "all" not in parts:
            try:
                chosen = select_at(site, parts, self._sites.rows(site))
            except TargetError:
                return  # it is not heard any more
            states = {row.name: states[row.name] for row in chosen}
        subscription.sent_at[site] = now
        subscription.due_at[site] = max(due_at + subscription.period_s, now + early_s)
        if states:
            tail = b',"subscription":%d}}\n' % subscription.number
            last_tail = b',"subscription":%d,"last":true}}\n' % subscription.number
            subscription.reader.write(tail.join(states.values()) + last_tail)

    def _states(self, site: str, names: frozenset[str], now: float) -> dict[str, bytes]:
        """The notification of each vehicle without its end, by the vehicle's name at the site."""
        found = self._encoded.get((site, names))
        if found is not None and now - found[0] < SHARED_S:
            return found[1]
        wanted = names | ALWAYS
        made: dict[str, bytes] = {}
        states = self._sites.states(site, now, self._ours())
        for row, state in zip(self._sites.rows(site), states, strict=True):
            shown = {key: value for key, value in state.items() if key in wanted} if names else state
            made[row.name] = TELEMETRY_START + encode(shown)
        if len(self._encoded) >= MAX_ENCODED:
            self._encoded.clear()
        self._encoded[site, names] = (now, made)
        return made
