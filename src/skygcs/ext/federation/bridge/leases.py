"""Holds the leases of the vehicles that several sites may command, and grants the daemon the right to send to them.

    ext.federation.protocol.lease      decides, for each vehicle
    the hub's store            is read and written as decided; no key is watched, the hub permits that to no station
    authority.grant / revoke   pass the result to the daemon, which compares its own clock before each frame

While a grant has waited for the daemon's answer longer than DAEMON_SILENT_S the leases are not renewed, so that another
site can take over from a daemon that hangs; its grants end by themselves. Each run of the daemon gets new `Lease`
objects, so that a lease of an earlier run counts as another site's.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

import nats.js.errors
from pydantic_core import from_json, to_json

from skygcs.cancellation import carried_through
from skygcs.config.files import boot_s
from skygcs.errors import BusError, RpcError
from skygcs.events import Event
from skygcs.ext.federation.bridge.bus import Message, store_errors
from skygcs.ext.federation.bridge.hub_config import LEASES
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
    State,
    Write,
    decode_entry,
    encode_entry,
)
from skygcs.ext.federation.protocol.lease_store import LeaseStore
from skygcs.ext.federation.protocol.received_json import printable
from skygcs.ext.federation.protocol.state_batch import RowLease
from skygcs.rpc import error_codes

if TYPE_CHECKING:
    from nats.js.kv import KeyValue

    from skygcs.ext.federation.bridge.daemon_link import DaemonLink
    from skygcs.ext.federation.bridge.station import Station

TICK_S = 0.1
"""Period of `Lease.tick`."""

STORE_RETRY_S = 0.25
"""Pause between attempts to open the hub's store."""

ASK_WITHIN_S = 1.0
"""Time limit for the holder's answer to a request for its lease."""

BUSY_WITHIN_S = 0.5
"""Time limit for the daemon's answer to what it does with a vehicle."""

DAEMON_SILENT_S = 1.5
"""A daemon that has not answered a grant for this time is stopped, or its loop hangs."""

TAKE_WITHIN_S = 12.0
"""Time limit for the result of a person's request: the wait at a new hub, an expiry and some retries."""

RELEASE_WITHIN_S = 1.0
"""Time limit for releasing the leases when the bridge ends."""

FLYING = frozenset({"engaging", "flying"})
"""States of control in which a vehicle is not given away without force."""


class Leases:
    """A part of the bridge. Run `run` in a task. Other parts ask `lease_of` and `not_held`."""

    def __init__(self, station: Station, link: DaemonLink, clock: Callable[[], float] = boot_s) -> None:
        """``link``: used by this part only, and run here."""
        # collaborators
        self._station = station
        self._bus = station.bus
        self._link = link
        self._clock = clock
        self._configs = station.config.vehicles
        # leases, and their store in the hub
        self._leases: dict[str, Lease] = {}
        """By vehicle; empty while the daemon is away."""
        self._since_s: dict[str, float] = {}
        """By vehicle, unix seconds since this site holds or wants the lease."""
        self._store: KeyValue | None = None
        self._known = LeaseStore()
        self._inspecting = False
        self._looking: set[str] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        # messages to the daemon
        self._to_daemon: dict[str, Grant | Revoke] = {}
        """By vehicle, the newest grant or revocation that is not sent to the daemon yet."""
        self._confirmed: dict[str, Grant | Revoke] = {}
        """By vehicle, the last one that the daemon has confirmed."""
        self._for_daemon = asyncio.Event()
        self._changed = asyncio.Event()
        self._daemon_silent = False
        # status
        self.problem: str | None = None
        self.why_standby: Callable[[], str | None] = lambda: None
        """Which bridge of this site to ask instead of this one."""
        # subscriptions and methods
        link.on_change(self._on_daemon)
        self._bus.on_change(self._on_hub)
        station.methods["federation.take"] = self._take
        station.methods["federation.release"] = self._release
        station.methods["federation.leases"] = self._status_of_all

    # -- for other parts

    def lease_of(self, vehicle: str) -> RowLease | None:
        """The lease of an own vehicle, for the state batches; None if no holder is known."""
        lease = self._leases.get(vehicle)
        if lease is None or (holder := lease.holder) is None:
            return None
        status = lease.status(self._clock())
        return RowLease(holder, int(status["revision"]), float(status["remaining_s"]))

    def not_held(self, vehicle: str) -> str | None:
        """Why this site does not command a vehicle; None if it does, or the vehicle needs no lease."""
        if vehicle not in self._configs:
            return None
        lease = self._leases.get(vehicle)
        if lease is None:
            return f"{vehicle} is not commanded by {self._station.name} now: {self.problem or 'its daemon is away'}"
        if lease.state in VALID and self._clock() < lease.valid_until:
            return None
        by = "" if lease.holder is None else f"; it is commanded by {lease.holder}"
        return f"{vehicle} is not commanded by {self._station.name} now{by}"

    def status(self) -> dict[str, Any]:
        """Status for federation.status, JSON-able."""
        now = self._clock()
        return {
            "problem": self.problem,
            "daemon_silent": self._daemon_silent,
            "leases": [lease.status(now) for lease in self._leases.values()],
        }

    # -- life

    async def run(self) -> None:
        """Hold the leases until it is cancelled; they are released then."""
        homes = sorted({config.home for config in self._configs.values()})
        served = [await self._bus.serve(f"lease.{home}.*.request", self._on_request) for home in homes]
        running = [
            asyncio.create_task(work, name=f"leases: {name}")
            for name, work in (("daemon", self._link.run()), ("grants", self._grant()), ("hub", self._keep_store()))
        ]
        try:
            while True:
                now = self._clock()
                for name, lease in self._leases.items() if not self._daemon_silent else ():
                    self._carry_out(name, lease, lease.tick(now))
                self._changed.set()
                self._changed = asyncio.Event()
                for task in running:
                    if task.done():
                        task.result()
                await asyncio.sleep(TICK_S)
        finally:
            await carried_through(self._give_back())  # else another site waits until they run out
            for task in (*running, *self._tasks):
                task.cancel()
            await asyncio.gather(*running, *self._tasks, return_exceptions=True)
            for subscription in served:
                await subscription.close()

    async def _give_back(self) -> None:
        """Release all leases in order: the daemon stops sending first, then the store shows the release."""
        for name, lease in self._leases.items():
            self._carry_out(name, lease, lease.release(self._clock()))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(RELEASE_WITHIN_S):
                while any(lease.state is State.RELEASING for lease in self._leases.values()):
                    for name, lease in self._leases.items():
                        self._carry_out(name, lease, lease.tick(self._clock()))
                    await asyncio.sleep(TICK_S / 2)

    # -- the hub

    def _on_hub(self) -> None:
        if not self._bus.connected:
            self._lose_store()

    def _lose_store(self) -> None:
        self._store = None
        for name, lease in self._leases.items():
            self._carry_out(name, lease, lease.hub_down(self._clock()))

    async def _keep_store(self) -> None:
        """Open the store after each new connection to the hub."""
        while True:
            if self._bus.connected and self._store is None:
                try:
                    await self._open_store()
                    self.problem = None
                except BusError as error:
                    self.problem = str(error)
            await asyncio.sleep(STORE_RETRY_S)

    async def _open_store(self) -> None:
        connections = self._bus.counters.connections
        store = await self._bus.key_value(LEASES)
        await self._inspect()
        if not self._bus.connected or connections != self._bus.counters.connections:
            return  # another connection meanwhile
        self._store = store
        self._hub_up()

    def _hub_up(self) -> None:
        for name, lease in self._leases.items():
            self._carry_out(name, lease, lease.hub_up(self._known.name, self._clock()))

    async def _inspect(self) -> bool:
        """Ask the store about itself. True if it is another one than before. Raises BusError."""
        question = self._known.question()
        with store_errors(LEASES):
            info = await self._bus.jetstream().stream_info(f"KV_{LEASES}")
        if info.config.max_age != TTL_S:  # a shorter one gives a lease away while its holder still sends
            text = f"the hub's store {LEASES} keeps keys for {info.config.max_age or 0:g} s, not {TTL_S:g} s"
            raise BusError(LEASES, f"{text}: remove it there, and make it with `skygcs federation stores`")
        identity = f"{info.created} {self._bus.server_info.get('server_id')}"
        return self._known.found(question, identity, info.state.last_seq, self._clock())

    async def _inspected(self) -> bool:
        """True if the open store is the one that it was. If it is not, the leases begin anew there; without an answer
        the store is opened again."""
        store = self._store
        try:
            changed = await self._inspect()
        except BusError:
            if store is not None and store is self._store:
                self._lose_store()  # to open it again says why it cannot be used
            return False
        if changed and store is not None and store is self._store:
            self._hub_up()
        return not changed and store is self._store

    async def _inspect_once(self) -> None:
        """Ask once for all readings: any number of vehicles share one question."""
        self._inspecting = True
        try:
            await self._inspected()
        finally:
            self._inspecting = False

    # -- the daemon

    def _on_daemon(self) -> None:
        self._leases, self._daemon_silent = {}, False
        self._to_daemon.clear()
        self._confirmed.clear()
        if self._link.client is not None:
            self._start(self._meet_daemon(), "what the daemon holds")

    async def _meet_daemon(self) -> None:
        """Make the leases for this run of the daemon, and continue grants that it has from an earlier bridge."""
        try:
            found = await self._link.call("authority.status")
        except RpcError as error:
            self.problem = f"the daemon: {error}"
            return
        site, run = self._station.name, str(found["run"])
        made: dict[str, Lease] = {}
        for name, config in self._configs.items():
            held = found["vehicles"].get(name)
            if held is None or found["site"] != site:
                self.problem = f"the daemon runs another fleet file: it does not know {name} as a vehicle of {site}"
                continue
            lease = Lease(LeaseConfig(name, config.home, site, run, config.without_hub == "continue"))
            if held["hub"]:
                lease.remember(held["hub"])
                self._known.note(held["token"], held["hub"])
            if held["held"]:
                lease.adopt(found["now_s"] + held["remaining_s"], held["token"], held["hub"])
            made[name] = lease
        self._leases = made
        if self._store is not None and await self._inspected():  # its tokens may be above the store's revisions
            self._hub_up()

    async def _grant(self) -> None:
        """Pass the newest grant or revocation of each vehicle on to the daemon."""
        while True:
            await self._for_daemon.wait()
            self._for_daemon.clear()
            while self._to_daemon:
                name, action = next(iter(self._to_daemon.items()))
                del self._to_daemon[name]
                await self._send_to_daemon(name, action)

    async def _send_to_daemon(self, name: str, action: Grant | Revoke) -> None:
        """Send one grant or revocation, and wait for the daemon's answer."""
        lease = self._leases.get(name)
        common = {"vehicle": name, "token": action.token, "hub": action.hub}
        asked: Awaitable[Any]
        if isinstance(action, Grant):
            asked = self._link.call("authority.grant", **common, sent_s=action.sent_s, valid_for_s=VALID_S)
        else:
            asked = self._link.call("authority.revoke", **common, commander=action.commander)
        call = asyncio.ensure_future(asked)
        try:
            await asyncio.wait({call}, timeout=DAEMON_SILENT_S)
            self._daemon_silent = not call.done()
            if self._daemon_silent:
                self._report("warning", name, "the daemon does not answer: its leases run out")
            answer = await call
        except RpcError as error:
            self.problem = f"the daemon: {error}"
            return
        finally:
            self._daemon_silent = False
            call.cancel()
        if isinstance(action, Revoke) or answer["result"] == "granted":
            self._confirmed[name] = action
        elif answer["result"] == "fenced":
            self.problem = f"the daemon refused a grant for {name}: a newer token came before"
        if isinstance(action, Revoke) and lease is not None and lease is self._leases.get(name):
            lease.revoked(action.number)

    # -- the actions of the leases

    def _carry_out(self, name: str, lease: Lease, actions: Actions) -> None:
        for action in actions:
            match action:
                case Write():
                    self._start(self._write(name, lease, action), f"write the lease of {name}")
                case Look():
                    if name not in self._looking:
                        self._start(self._look(name, lease), f"read the lease of {name}")
                case Inspect():
                    if not self._inspecting:
                        self._start(self._inspect_once(), "ask the store of leases")
                case Ask():
                    self._start(self._ask(name, lease, action), f"ask for {name}")
                case LeaseReport():
                    self._report("federation", name, action.text)
                case Grant() | Revoke():
                    self._queue(name, lease, action)

    def _queue(self, name: str, lease: Lease, action: Grant | Revoke) -> None:
        """Queue a grant or revocation for the daemon; a revocation that it has confirmed is not repeated."""
        confirmed = name not in self._to_daemon and self._confirmed.get(name) == action
        if confirmed and isinstance(action, Revoke) and lease.state is not State.RELEASING:
            return
        self._to_daemon[name] = action
        self._for_daemon.set()

    async def _write(self, name: str, lease: Lease, write: Write) -> None:
        if write.holder is None or lease.state not in VALID:
            self._since_s[name] = time.time()
        value = encode_entry(write.holder, write.run, self._since_s.setdefault(name, time.time()), write.wanted_by)
        answer: Answer = "failed"
        store, renews = self._store, lease.state in VALID and write.revision is not None
        if store is not None and (renews or await self._inspected()) and store is self._store:
            question = self._known.question()
            try:
                with store_errors(LEASES):
                    answer = await store.update(self._key(name), value, last=write.revision or 0)
                if self._known.written(question, answer, self._clock()):
                    self._hub_up()
            except nats.js.errors.KeyWrongLastSequenceError:
                answer = "conflict"
            except BusError:
                answer = "failed"
        self._carry_out(
            name, lease, self._if_current(name, lease, lambda: lease.answered(write.number, answer, self._clock()))
        )

    async def _look(self, name: str, lease: Lease) -> None:
        self._looking.add(name)
        store = self._store
        try:
            if store is None:
                return
            entry: Entry | None = None
            known_as = self._known.name
            try:
                with store_errors(LEASES):
                    found = await store.get(self._key(name))
                entry = decode_entry(found.value or b"", found.revision or 0)
                self._known.note(entry.revision, known_as)
            except nats.js.errors.KeyNotFoundError:
                entry = None
            except BusError:
                return
        finally:
            self._looking.discard(name)
        if store is self._store and known_as == self._known.name:
            self._carry_out(name, lease, self._if_current(name, lease, lambda: lease.seen(entry, self._clock())))

    def _if_current(self, name: str, lease: Lease, call: Callable[[], Actions]) -> Actions:
        """The actions of ``call``; none if the daemon has been restarted, and with it the lease replaced."""
        return call() if self._leases.get(name) is lease else []

    def _key(self, name: str) -> str:
        return f"{self._configs[name].home}.{name}"

    # -- take-over on request

    async def _ask(self, name: str, lease: Lease, ask: Ask) -> None:
        subject = f"lease.{self._key(name)}.request"
        message = {"v": 1, "by": self._station.name, "to": ask.holder, "force": ask.force}
        try:
            answer = from_json(await self._bus.request(subject, to_json(message), ASK_WITHIN_S))
        except (BusError, ValueError):
            return  # asked again; the key expires if the holder is gone
        refusal = answer.get("refusal") if isinstance(answer, dict) else None
        text = None if refusal is None else printable(str(refusal), 200)
        self._carry_out(name, lease, self._if_current(name, lease, lambda: lease.asked(text, self._clock())))

    async def _on_request(self, message: Message) -> bytes | None:
        """Another site asks for a vehicle. Only the holder answers; None: this site does not."""
        try:
            asked = from_json(message.data)
            _, home, name, _ = message.subject.split(".")
            by, to, force = asked["by"], asked["to"], asked.get("force", False)
        except (ValueError, KeyError, TypeError):
            return None
        lease, config = self._leases.get(name), self._configs.get(name)
        if lease is None or config is None or config.home != home or to != self._station.name:
            return None
        if not isinstance(by, str) or not 1 <= len(by) <= 16:
            return None
        busy = await self._busy(name)
        refusal, actions = lease.requested(printable(by), self._clock(), busy=busy, force=force is True)
        self._carry_out(name, lease, self._if_current(name, lease, lambda: actions))
        return to_json({"refusal": refusal})

    async def _busy(self, name: str) -> str | None:
        """Return what this site does with a vehicle now; None for nothing. A daemon that does not answer may be flying
        it."""
        try:
            async with asyncio.timeout(BUSY_WITHIN_S):
                state = await self._link.call("vehicles.get", target=name)
        except (TimeoutError, RpcError) as error:
            if isinstance(error, RpcError) and error.code == error_codes.TARGET_ERROR:
                return None  # it has not been heard
            return f"the daemon of {self._station.name} does not say what it does with it"
        control = state.get("control") or {}
        return f"it is flown by setpoints of {self._station.name}" if control.get("state") in FLYING else None

    # -- methods of the station socket

    async def _take(self, params: dict[str, Any]) -> dict[str, Any]:
        """Command a vehicle from this site: its holder is asked for the lease. Answered once that is decided."""
        name, lease = self._named(params)
        force, without_hub = params.get("force") is True, params.get("without_hub") is True
        refusal = lease.take(self._clock(), force=force, without_hub=without_hub)
        if refusal is not None:
            raise RpcError(error_codes.REFUSED, f"{name}: {refusal}")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(TAKE_WITHIN_S):
                while lease.state is State.WANTED or (
                    lease.state in VALID and not isinstance(self._confirmed.get(name), Grant)
                ):
                    await self._changed.wait()
        if lease.state not in VALID:
            holder = f"{lease.holder} has it" if lease.holder else "nobody has it"
            home = lease.config.home
            alone = f"; its home {home} may go on without the hub: --force" if lease.config.goes_on_alone else ""
            last = next((e.text for e in reversed(self._station.report.recent) if e.vehicle == name), holder)
            raise RpcError(error_codes.REFUSED, f"{name} was not taken: {last}" + (alone if not lease.holder else ""))
        return lease.status(self._clock())

    async def _release(self, params: dict[str, Any]) -> dict[str, Any]:
        """Give a vehicle's lease up, for another site to take; control by setpoints ends without an order."""
        name, lease = self._named(params)
        self._carry_out(name, lease, lease.release(self._clock()))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(TAKE_WITHIN_S):
                while lease.state is State.RELEASING:
                    await self._changed.wait()
        return lease.status(self._clock())

    async def _status_of_all(self, _: dict[str, Any]) -> list[dict[str, Any]]:
        """The leases of the vehicles in [federation.vehicles]."""
        now = self._clock()
        return [lease.status(now) for lease in self._leases.values()]

    def _named(self, params: dict[str, Any]) -> tuple[str, Lease]:
        """The vehicle that a request names, and its lease. Raises RpcError."""
        name = params.get("vehicle")
        if isinstance(name, str) and "/" in name:  # the form for vehicles of other sites: home/alpha
            home, _, rest = name.partition("/")
            name = rest if rest in self._configs and self._configs[rest].home == home else name
        if not isinstance(name, str) or name not in self._configs:
            known = ", ".join(sorted(self._configs)) or "none"
            raise RpcError(error_codes.REFUSED, f"[federation.vehicles] does not name {name}; it names: {known}")
        lease = self._leases.get(name)
        if lease is None:
            why = self.why_standby() or self.problem or "the daemon of this site is away"
            raise RpcError(error_codes.REFUSED, f"{name}: {why}")
        return name, lease

    # -- private

    def _start(self, work: Any, name: str) -> None:
        task = asyncio.create_task(work, name=f"leases: {name}")
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._report("fault", None, f"{task.get_name()} failed: {error!r}")

    def _report(self, kind: str, vehicle: str | None, text: str) -> None:
        self._station.report(Event(kind, vehicle, None, text, {}))
