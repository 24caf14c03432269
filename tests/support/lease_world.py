"""Sites, their daemons' gates, a hub and a bad network between them, in a true time that none of their clocks shows."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

from skygcs.ext.federation.authority import Authority
from skygcs.ext.federation.protocol.lease import (
    TTL_S,
    VALID,
    VALID_S,
    Actions,
    Answer,
    Ask,
    Entry,
    Grant,
    Inspect,
    Lease,
    LeaseConfig,
    LeaseReport,
    Look,
    Revoke,
    Write,
)
from skygcs.ext.federation.protocol.lease_store import LeaseStore, StoreQuestion

VEHICLE, SYSID = "alpha", 7
STEP_S = 0.02
TICK_S = 0.1
BUSY_S = 0.8
"""The longest that a daemon which runs takes to read a request."""

NOTICED_S = 2.0
"""A cut is noticed by the connection's pings after so long."""


@dataclass
class FakeHub:
    """The key-value store: one key, its TTL, and revisions that increase."""

    name: str = "hub-0"
    alive: bool = True
    created: int = 0
    revision: int = 0
    entry: Entry | None = None
    written_at: float = 0.0

    @property
    def identity(self) -> str:
        return f"{self.created} {self.name}"

    def read(self, now: float) -> Entry | None:
        if self.entry is not None and now >= self.written_at + TTL_S:
            self.entry = None
        return self.entry

    def write(self, write: Write, now: float) -> Answer:
        before = self.read(now)
        if write.revision != (None if before is None else before.revision):
            return "conflict"
        self.revision += 1
        self.entry = Entry(self.revision, write.holder, write.run, write.wanted_by)
        self.written_at = now
        return self.revision


@dataclass
class Site:
    """One machine: bridge (the lease) and daemon (the gate), each of which can be stopped, on one clock."""

    world: World
    name: str
    home: str
    goes_on_alone: bool
    rate: float
    offset_s: float
    runs: itertools.count[int] = field(default_factory=lambda: itertools.count(1))
    cut: bool = False
    connected_to: str | None = None
    bridge_stopped: bool = False
    daemon_stopped: bool = False
    bridge_inbox: list[Callable[[], None]] = field(default_factory=list)
    daemon_inbox: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    reports: list[str] = field(default_factory=list)
    next_tick: float = 0.0
    silent_since: float | None = None

    def __post_init__(self) -> None:
        self.restart_daemon()

    def now(self) -> float:
        return self.offset_s + self.world.now * self.rate

    def restart_daemon(self) -> None:
        """Both processes anew: the daemon's grants are gone, and its run has another name."""
        self.gate = Authority(self.name, {VEHICLE: SYSID})
        self.run = f"{self.name}-{next(self.runs)}"
        self.daemon_inbox.clear()
        self.restart_bridge()

    def restart_bridge(self) -> None:
        """The bridge anew: it goes on with what the daemon has."""
        self.lease = Lease(LeaseConfig(VEHICLE, self.home, self.name, self.run, self.goes_on_alone))
        self.store = LeaseStore()
        self.bridge_inbox.clear()
        self.connected_to = None
        status = self.gate.status_of(SYSID, self.now())
        assert status is not None
        if status["hub"]:
            self.lease.remember(status["hub"])
            self.store.note(status["token"], status["hub"])
        if status["held"]:
            self.lease.adopt(self.now() + status["remaining_s"], status["token"], status["hub"])

    @property
    def sends(self) -> bool:
        """Whether a frame of its daemon would reach the vehicle now. A stopped daemon sends nothing."""
        return not self.daemon_stopped and self.gate.refusal(SYSID, self.now()) is None

    # -- the bridge's side

    def carry_out(self, actions: Actions) -> None:
        for action in actions:
            match action:
                case Write():
                    self._write(action)
                case Look():
                    self.world.to_hub(self, self._looked)
                case Grant():
                    self.to_daemon(lambda g=action: self._granted(g))
                case Revoke():
                    self.to_daemon(lambda r=action: self._revoke(r))
                case Inspect():
                    self._inspect(lambda same: None)
                case Ask():
                    self.world.ask(self, action)
                case LeaseReport():
                    self.reports.append(action.text)

    def _write(self, write: Write) -> None:
        """A renewal at once; any other write after the store was asked whether it is the same."""
        lease = self.lease
        if lease.state in VALID and write.revision is not None:
            self.world.to_hub(self, lambda hub: self._stored(hub, write, self.store.question()))
            return

        def inspected(same: bool) -> None:
            question = self.store.question()
            if same:
                self.world.to_hub(self, lambda hub: self._stored(hub, write, question))
            elif lease is self.lease:
                self.carry_out(lease.answered(write.number, "failed", self.now()))

        self._inspect(inspected)

    def _inspect(self, then: Callable[[bool], None]) -> None:
        question, lease, connected_to = self.store.question(), self.lease, self.connected_to

        def answer(hub: FakeHub) -> None:
            identity, revision = hub.identity, hub.revision

            def came() -> None:
                if lease is not self.lease or connected_to != self.connected_to:
                    return
                changed = self.store.found(question, identity, revision, self.now())
                if changed:
                    self.carry_out(self.lease.hub_up(self.store.name, self.now()))
                then(not changed)

            self.world.back(self, came)

        self.world.to_hub(self, answer)

    def _stored(self, hub: FakeHub, write: Write, question: StoreQuestion) -> None:
        answer = hub.write(write, self.world.now)
        lease, store = self.lease, self.store

        def came() -> None:
            if isinstance(answer, int) and store.written(question, answer, self.now()):
                self._to(lease, lambda: lease.hub_up(store.name, self.now()))
            self._to(lease, lambda: lease.answered(write.number, answer, self.now()))

        self.world.back(self, came)

    def _looked(self, hub: FakeHub) -> None:
        entry, lease, known_as = hub.read(self.world.now), self.lease, self.store.name

        def came() -> None:
            if known_as != self.store.name:
                return
            if entry is not None and lease is self.lease:
                self.store.note(entry.revision)
            self._to(lease, lambda: lease.seen(entry, self.now()))

        self.world.back(self, came)

    def _to(self, lease: Lease, call: Callable[[], Actions]) -> None:
        """Only if the bridge is still the one that asked."""
        if lease is self.lease:
            self.carry_out(call())

    def to_bridge(self, call: Callable[[], None]) -> None:
        if self.bridge_stopped:
            self.bridge_inbox.append(call)
        else:
            call()

    def to_daemon(self, call: Callable[[], None]) -> None:
        """Over a local socket: in order, and late where the machine is busy; a stopped daemon sends before it reads."""
        after = self.daemon_inbox[-1][0] if self.daemon_inbox else self.world.now
        busy_s = self.world.random.uniform(0.0, BUSY_S) if self.world.delay_s else 0.0
        self.daemon_inbox.append((max(after, self.world.now + busy_s), call))

    def read_daemon_inbox(self) -> None:
        if self.daemon_stopped:
            self.daemon_inbox = [(max(due, self.world.now + self.busy_s), call) for due, call in self.daemon_inbox]
            return
        while self.daemon_inbox and self.daemon_inbox[0][0] <= self.world.now:
            self.daemon_inbox.pop(0)[1]()

    @property
    def busy_s(self) -> float:
        return BUSY_S if self.world.delay_s else 0.0

    def _granted(self, grant: Grant) -> None:
        until = grant.sent_s + VALID_S
        self.gate.grant(VEHICLE, until, self.now(), token=grant.token, hub=grant.hub)

    def _revoke(self, revoke: Revoke) -> None:
        self.gate.revoke(VEHICLE, token=revoke.token, hub=revoke.hub, commander=revoke.commander)
        lease = self.lease
        self.to_bridge(lambda: lease.revoked(revoke.number) if lease is self.lease else None)

    def tick(self) -> None:
        if self.bridge_stopped or self.world.now < self.next_tick:
            return
        self.next_tick = self.world.now + TICK_S
        self._notice()
        self.carry_out(self.lease.tick(self.now()))

    def _notice(self) -> None:
        hub = self.world.hub
        reachable = hub.alive and not self.cut
        if self.connected_to is None:
            if reachable:
                self.connected_to = hub.name
                self.store.found(self.store.question(), hub.identity, hub.revision, self.now())
                self.carry_out(self.lease.hub_up(self.store.name, self.now()))
            return
        if reachable and self.connected_to == hub.name:
            self.silent_since = None
            return
        self.silent_since = self.world.now if self.silent_since is None else self.silent_since
        dead = not hub.alive or self.connected_to != hub.name  # the machine at the other end says so
        if dead or self.world.now >= self.silent_since + NOTICED_S:
            self.connected_to, self.silent_since = None, None
            self.carry_out(self.lease.hub_down(self.now()))


class World:
    """`advance` moves the true time; ``holders`` are those that could send at one moment."""

    def __init__(
        self, names: tuple[str, ...], seed: int, *, goes_on_alone: bool, loss: float = 0.1, delay_s: float = 0.3
    ) -> None:
        self.now = 1000.0
        self.random = Random(seed)
        self.loss, self.delay_s = loss, delay_s
        self.hub = FakeHub()
        self._hubs = itertools.count(1)
        self._flight: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        rates = [0.99, 1.01, 1.0]
        self.sites = {
            name: Site(self, name, names[0], goes_on_alone, rates[i % 3], self.random.uniform(0, 1e6))
            for i, name in enumerate(names)
        }
        self.both: list[tuple[float, list[str]]] = []

    def later(self, call: Callable[[], None]) -> None:
        delay = self.random.expovariate(1 / self.delay_s) if self.delay_s else 0.0
        heapq.heappush(self._flight, (self.now + 0.005 + delay, next(self._order), call))

    def to_hub(self, site: Site, call: Callable[[FakeHub], None]) -> None:
        """A request, if it is not lost; the connection it goes over must be to this hub, then too."""
        to = site.connected_to
        if to is None or self.random.random() < self.loss:
            return

        def arrive() -> None:
            if self.hub.alive and not site.cut and self.hub.name == to:
                call(self.hub)

        self.later(arrive)

    def back(self, site: Site, call: Callable[[], None]) -> None:
        """The answer, if it is not lost."""
        if self.random.random() >= self.loss:
            self.later(lambda: site.to_bridge(call) if not site.cut else None)

    def ask(self, site: Site, ask: Ask) -> None:
        holder = self.sites.get(ask.holder)
        if holder is None:
            return

        def arrive(_: FakeHub) -> None:
            if not holder.cut:
                holder.to_bridge(answer)

        def answer() -> None:
            why, actions = holder.lease.requested(site.name, holder.now(), busy=None, force=ask.force)
            holder.carry_out(actions)
            lease = site.lease
            self.back(site, lambda: site._to(lease, lambda: lease.asked(why, site.now())))

        self.to_hub(site, arrive)

    def replace_hub(self) -> None:
        """Another hub that knows nothing."""
        self.hub = FakeHub(f"hub-{next(self._hubs)}")

    def recreate_bucket(self) -> None:
        """Deleted and created again, while the sites are connected."""
        self.hub.created += 1
        self.hub.revision, self.hub.entry = 0, None

    def restore_bucket(self) -> None:
        """From a snapshot older than what any site has seen, while they are connected: the creation is the same."""
        self.hub.revision, self.hub.entry = max(0, min(1, self.hub.revision - 1)), None

    def cut_power(self, revision: int) -> None:
        """The hub starts again at once without its last writes; keys that it still has would have to expire again."""
        hub = self.hub
        lost = max(0, hub.revision - revision)
        self.hub = FakeHub(f"hub-{next(self._hubs)}", created=hub.created, revision=lost)

    @property
    def holders(self) -> list[str]:
        return [site.name for site in self.sites.values() if site.sends]

    def advance(self, for_s: float) -> None:
        end = self.now + for_s
        while self.now < end:
            self.now += STEP_S
            while self._flight and self._flight[0][0] <= self.now:
                heapq.heappop(self._flight)[2]()
            for site in self.sites.values():
                site.tick()
                site.read_daemon_inbox()
            if len(self.holders) > 1:
                self.both.append((self.now, self.holders))

    def advance_until(self, met: Callable[[], bool], within_s: float) -> float:
        """How long it took; fails if it did not come."""
        began = self.now
        while not met():
            assert self.now < began + within_s, f"not within {within_s} s: {self.describe()}"
            self.advance(STEP_S)
        return self.now - began

    def describe(self) -> str:
        return "; ".join(f"{s.name} {s.lease.state} sends={s.sends} {s.reports[-3:]}" for s in self.sites.values())
