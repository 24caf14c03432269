"""The part of a bridge that holds leases, in virtual time, over a hub that is played: what it does at each site, and
that no two sites ever send."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from fnmatch import fnmatchcase
from types import SimpleNamespace
from typing import Any

import nats.errors
import nats.js.errors
import pytest
from pydantic_core import from_json, to_json

from skygcs.errors import DaemonUnreachable, HubAway, NobodyThere, RpcError
from skygcs.ext.federation.bridge.bus import Message, OnRequest
from skygcs.ext.federation.bridge.leases import DAEMON_SILENT_S, RELEASE_WITHIN_S, TAKE_WITHIN_S
from skygcs.ext.federation.config import SharedVehicle
from skygcs.ext.federation.protocol.lease import NEW_HUB_S, TTL_S, VALID_S, decode_entry
from skygcs.rpc import error_codes
from support.lease_races import Racer
from support.table import each

pytestmark = pytest.mark.looptime

STOPS, GOES_ON = SharedVehicle(home="north", without_hub="stop"), SharedVehicle(home="north")


class PlayedHub:
    """Requests between sites, and the store of leases as JetStream keeps it."""

    def __init__(self) -> None:
        self.created, self.revision, self.max_age = "first", 0, TTL_S
        self.entries: dict[str, tuple[int, bytes, float]] = {}
        self.buses: list[PlayedBus] = []

    def make_again(self) -> None:
        self.created, self.revision = f"after {self.created}", 0
        self.entries.clear()

    def found(self, key: str) -> tuple[int, bytes, float] | None:
        entry = self.entries.get(key)
        return entry if entry is not None and asyncio.get_running_loop().time() < entry[2] + TTL_S else None

    def holder(self, key: str = "north.alpha") -> str | None:
        entry = self.found(key)
        return None if entry is None else decode_entry(entry[1], entry[0]).holder

    def since(self) -> Any:
        found = self.found("north.alpha")
        return None if found is None else from_json(found[1])["since_s"]


class PlayedBus:
    """One site's connection to the hub, in the place of `Bus`; also its store."""

    def __init__(self, hub: PlayedHub) -> None:
        self.hub = hub
        self.connected = True
        self.counters = SimpleNamespace(connections=1)
        self.server_info = {"server_id": "hub"}
        self.served: dict[str, OnRequest] = {}
        self.writes = self.inspections = 0
        self._observers: list[Callable[[], None]] = []
        hub.buses.append(self)

    def set_connected(self, connected: bool) -> None:
        self.connected = connected
        self.counters.connections += connected
        for observer in self._observers:
            observer()

    def on_change(self, observer: Callable[[], None]) -> None:
        self._observers.append(observer)

    async def serve(self, subject: str, on_request: OnRequest) -> Any:
        self.served[subject] = on_request

        async def close() -> None:
            del self.served[subject]

        return SimpleNamespace(close=close)

    async def request(self, subject: str, data: bytes, timeout_s: float) -> bytes:
        if not self.connected:
            raise HubAway(subject, "no connection to the hub")
        for bus in self.hub.buses:
            for pattern, on_request in list(bus.served.items()) if bus.connected else ():
                if fnmatchcase(subject, pattern) and (answer := await on_request(Message(subject, data))) is not None:
                    return answer
        raise NobodyThere(subject, "nobody takes messages of this subject now")

    async def key_value(self, name: str) -> PlayedBus:
        await self._way()
        return self

    def jetstream(self) -> PlayedBus:
        return self

    async def stream_info(self, name: str) -> Any:
        await self._way()
        self.inspections += 1
        return SimpleNamespace(
            config=SimpleNamespace(max_age=self.hub.max_age),
            created=self.hub.created,
            state=SimpleNamespace(last_seq=self.hub.revision),
        )

    async def get(self, key: str) -> Any:
        await self._way()
        if (entry := self.hub.found(key)) is None:
            raise nats.js.errors.KeyNotFoundError
        return SimpleNamespace(revision=entry[0], value=entry[1])

    async def update(self, key: str, value: bytes, last: int) -> int:
        await self._way()
        if last != (self.hub.found(key) or (0,))[0]:
            raise nats.js.errors.KeyWrongLastSequenceError
        self.hub.revision += 1
        self.writes += 1
        self.hub.entries[key] = self.hub.revision, value, asyncio.get_running_loop().time()
        return self.hub.revision

    async def _way(self) -> None:
        await asyncio.sleep(0.01)
        if not self.connected:
            raise nats.errors.TimeoutError


class Site(Racer):
    """A site with alpha, whose home is north, and the faults of its daemon."""

    def __init__(self, name: str, hub: PlayedHub, shared: SharedVehicle = STOPS) -> None:
        self.bus = PlayedBus(hub)
        super().__init__(name, self.bus, ["alpha"], shared, asyncio.get_running_loop().time)
        self.link.control = None
        self.answers: dict[str, Callable[[], Awaitable[Any]]] = {}
        """By method, in place of the gate's answer."""
        self.asked: list[str] = []
        self._gate_call = self.link.call
        self.link.call = self._call  # type: ignore[method-assign]
        self.begin()

    async def _call(self, method: str, **params: Any) -> Any:
        self.asked.append(method)
        return await (self.answers[method]() if method in self.answers else self._gate_call(method, **params))

    def begin(self) -> None:
        self.running = asyncio.create_task(self.leases.run())

    async def end(self) -> None:
        self.running.cancel()
        await asyncio.gather(self.running, return_exceptions=True)

    @property
    def sends(self) -> bool:
        return bool(self.link.held())

    def texts(self) -> str:
        return "; ".join(f"{event.kind}: {event.text}" for event in self.reported.recent)

    def lease(self) -> dict[str, Any]:
        (lease,) = self.leases.status()["leases"]
        return dict(lease)

    async def until(self, reached: Callable[[], bool], within_s: float = 10.0) -> float:
        """How long it took."""
        loop = asyncio.get_running_loop()
        begun = loop.time()
        async with asyncio.timeout(within_s):
            while not reached():  # noqa: ASYNC110 - it signals nothing
                await asyncio.sleep(0.02)
        return loop.time() - begun


@contextlib.asynccontextmanager
async def sites(shared: SharedVehicle = STOPS) -> AsyncIterator[tuple[Site, Site, PlayedHub]]:
    """north, which holds alpha, its vehicle, and south."""
    hub = PlayedHub()
    north, south = Site("north", hub, shared), Site("south", hub, shared)

    async def watch() -> None:
        while True:
            assert not (north.sends and south.sends), "two sites send"
            await asyncio.sleep(0.01)

    watching = asyncio.create_task(watch())
    try:
        await north.until(lambda: north.sends and south.lease()["holder"] == "north")
        yield north, south, hub
    finally:
        await north.end()
        await south.end()
        watching.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await watching
        assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("leases: ")]


# -- who holds it


async def test_the_home_holds_it_first_and_who_asks_gets_it_and_gives_it_back() -> None:
    async with sites() as (north, south, hub):
        assert asyncio.get_running_loop().time() > NEW_HUB_S, "a hub that is new may have had another holder"
        assert south.leases.not_held("alpha") == "alpha is not commanded by south now; it is commanded by north"
        assert north.leases.not_held("alpha") is south.leases.not_held("other") is None
        row = north.leases.lease_of("alpha")
        assert row is not None and (row.holder, row.revision) == ("north", hub.revision)
        assert 0.0 < row.remaining_s <= VALID_S
        assert south.leases.lease_of("alpha").holder == "north" and north.leases.lease_of("other") is None
        taken = await south.call("federation.take", "alpha", without_hub=False)
        assert (taken["holder"], taken["held"], south.sends, north.sends) == ("south", True, True, False)
        assert "federation: alpha goes to south, which asked for it" in north.texts()
        assert await south.methods["federation.leases"]({}) == [south.lease()]
        assert (await south.call("federation.take", "alpha"))["held"], "it has it already"
        writes, inspections, since = south.bus.writes, south.bus.inspections, hub.since()
        await asyncio.sleep(10.0)  # renewed, and nobody takes it back
        assert south.sends and 8 <= south.bus.writes - writes <= 12
        assert (south.bus.inspections, hub.since()) == (inspections, since), "renewed as it was taken"
        assert north.asked.count("authority.revoke") <= 2, "what its daemon has confirmed is not repeated"
        assert "does not answer" not in north.texts() + south.texts()
        given = await south.call("federation.release", "north/alpha")
        assert (given["held"], south.sends, hub.holder()) == (False, False, None)
        await north.until(lambda: north.sends)  # its home


async def test_who_flies_it_keeps_it_unless_it_is_forced() -> None:
    async with sites() as (north, south, _):
        north.link.control = {"state": "flying"}
        with pytest.raises(RpcError, match=r"alpha was not taken: .*flown by setpoints of north; `--force`"):
            await south.call("federation.take", "alpha")
        assert north.sends and "authority.revoke" not in north.asked
        assert (await south.call("federation.take", "alpha", force=True))["held"]


async def test_a_bridge_that_ends_gives_it_back_at_once() -> None:
    async with sites() as (north, south, hub):
        await north.end()
        assert not north.sends and hub.holder() is None and north.bus.served == {}
        await south.until(lambda: south.lease()["holder"] is None, TTL_S - 1.0)
        assert (await south.call("federation.take", "alpha"))["held"]


async def test_a_bridge_that_ends_without_the_hub_waits_a_second_for_it_and_sends_no_more() -> None:
    async with sites(GOES_ON) as (north, _, hub):
        north.bus.set_connected(False)
        await asyncio.sleep(2 * TTL_S)
        begun = asyncio.get_running_loop().time()
        await north.end()
        assert asyncio.get_running_loop().time() - begun <= RELEASE_WITHIN_S + 0.2
        assert not north.sends and north.bus.served == {} and hub.holder() is None


async def test_a_holder_that_answers_nobody_keeps_it_and_is_named() -> None:
    async with sites() as (north, south, hub):
        await asyncio.sleep(30.0)
        south.reported.recent.clear()
        served = dict(north.bus.served)
        north.bus.served.clear()
        begun = asyncio.get_running_loop().time()
        with pytest.raises(RpcError, match=r"^alpha was not taken: ") as refused:
            await south.call("federation.take", "alpha")
        assert asyncio.get_running_loop().time() - begun <= TAKE_WITHIN_S + 0.2
        assert "north" in str(refused.value) and "--force" not in str(refused.value)
        assert north.sends and hub.holder() == "north"
        north.bus.served.update(served)


async def test_a_store_on_another_server_is_another_store() -> None:
    async with sites() as (north, south, hub):
        before = north.leases._known.name
        for site in (north, south):
            site.bus.server_info["server_id"] = "second hub"
            site.bus.set_connected(False)
        hub.entries.clear()
        for site in (north, south):
            site.bus.set_connected(True)
        await asyncio.sleep(2 * NEW_HUB_S)
        assert north.sends and before != north.leases._known.name == south.leases._known.name


async def test_a_bridge_that_is_killed_goes_on_with_what_its_daemon_has() -> None:
    async with sites() as (north, south, hub):
        with contextlib.suppress(AttributeError):
            north.leases._leases = {}  # it gives nothing back
        await north.end()
        assert north.sends and hub.holder() == "north"
        second = Site("north", hub)
        second.link.gate = north.link.gate
        await second.until(lambda: second.leases.not_held("alpha") is None, 0.5)
        await asyncio.sleep(2 * TTL_S)
        assert second.sends and not south.sends and hub.holder() == "north"
        await second.end()


async def test_a_bridge_that_comes_again_knows_by_its_daemon_that_the_hub_is_not_new() -> None:
    async with sites() as (north, _, hub):
        await north.end()
        second = Site("north", hub)
        second.link.gate = north.link.gate
        assert await second.until(lambda: second.sends) < NEW_HUB_S - 1.0
        await second.end()


# -- the hub


@each(("shared", "alone"), [(STOPS, False), (GOES_ON, True)])
async def test_without_the_hub_its_home_goes_on_alone_or_it_runs_out(shared: SharedVehicle, alone: bool) -> None:
    async with sites(shared) as (north, south, _):
        for site in (north, south):
            site.bus.set_connected(False)
        await asyncio.sleep(2 * TTL_S)
        assert north.sends is alone and not south.sends
        assert ("goes on alone" in north.texts()) is alone
        assert (north.leases.not_held("alpha") is None) is alone
        with pytest.raises(RpcError, match="alpha: the hub is away"):
            await south.call("federation.take", "alpha")
        for site in (north, south):
            site.bus.set_connected(True)
        assert (await north.until(lambda: north.sends and north.lease()["state"] == "held")) < 2 * NEW_HUB_S


async def test_a_store_that_keeps_keys_for_another_time_is_not_used() -> None:
    hub = PlayedHub()
    hub.max_age = 1.0
    north = Site("north", hub)
    await asyncio.sleep(2 * NEW_HUB_S)
    assert "keeps keys for 1 s, not 3 s: remove it there" in str(north.leases.problem) and not north.sends
    assert "not commanded by north now" in str(north.leases.not_held("alpha"))
    hub.max_age = TTL_S
    await north.until(lambda: north.sends)
    assert north.leases.status()["problem"] is None
    hub.max_age = 1.0
    hub.make_again()  # found by its next question
    await north.until(lambda: not north.sends)
    assert "keeps keys for 1 s" in str(north.leases.problem)
    await north.end()


async def test_a_store_that_is_made_again_is_another_one_and_its_keys_are_nobodys() -> None:
    async with sites() as (north, south, hub):
        await asyncio.sleep(5.0)
        before = north.leases._known.name
        hub.make_again()
        await asyncio.sleep(2 * NEW_HUB_S)
        assert north.sends and hub.holder() == "north"
        assert before != north.leases._known.name == south.leases._known.name
        assert (await south.call("federation.take", "alpha"))["held"]


async def test_a_fault_of_the_store_is_reported_and_the_others_go_on() -> None:
    async with sites() as (north, _, hub):
        hub.entries["north.alpha"] = (*hub.entries["north.alpha"][:2], None)  # type: ignore[assignment]
        await north.until(lambda: "fault: leases: " in north.texts())
        assert "of alpha failed: TypeError" in north.texts()


# -- the daemon


async def test_a_daemon_that_hangs_renews_nothing_and_another_site_takes_over() -> None:
    async with sites() as (north, south, hub):
        goes_on = asyncio.Event()
        north.answers["authority.grant"] = goes_on.wait
        await north.until(lambda: north.leases.status()["daemon_silent"])
        assert "warning: the daemon does not answer: its leases run out" in north.texts()
        took_s = await north.until(lambda: hub.holder() is None)
        assert TTL_S - DAEMON_SILENT_S < took_s <= TTL_S and not north.sends
        assert (await south.call("federation.take", "alpha"))["held"]
        del north.answers["authority.grant"]
        north.answers["authority.grant"] = lambda: _result("late")
        goes_on.set()
        await asyncio.sleep(TTL_S)
        assert south.sends and not north.leases.status()["daemon_silent"]


async def test_a_daemon_that_has_had_a_newer_token_refuses_and_one_that_fails_is_named() -> None:
    async with sites() as (north, _, __):
        north.answers["authority.grant"] = lambda: _result("fenced")
        await north.until(lambda: north.leases.problem is not None)
        assert north.leases.problem == "the daemon refused a grant for alpha: a newer token came before"
        north.answers["authority.grant"] = lambda: _error(RpcError(error_codes.REFUSED, "no"))
        await north.until(lambda: north.leases.problem == "the daemon: no")


async def test_a_part_that_fails_ends_the_whole_and_with_it_the_grants() -> None:
    async with sites() as (north, _, __):
        north.answers["authority.grant"] = lambda: _error(ValueError("broken"))
        await north.until(north.running.done)
        assert isinstance(north.running.exception(), ValueError)
        await asyncio.sleep(VALID_S)
        assert not north.sends


async def test_a_new_run_of_the_daemon_counts_as_another_holder_until_the_old_lease_has_ended() -> None:
    async with sites() as (north, south, hub):
        north.link.client = None
        for observer in north.link._observers:
            observer()
        assert north.leases.not_held("alpha") == "alpha is not commanded by north now: its daemon is away"
        assert north.leases.status()["leases"] == [] and north.leases.lease_of("alpha") is None
        with pytest.raises(RpcError, match="alpha: the daemon of this site is away"):
            await north.call("federation.take", "alpha")
        await south.end()  # it would take what becomes free
        again = Site("north", hub)
        again.answers["authority.status"] = _status
        took_s = await again.until(lambda: again.sends)
        assert took_s > VALID_S and not north.sends
        await again.end()


@each(
    ("answer", "problem"),
    [
        (lambda: _error(RpcError(error_codes.REFUSED, "no")), "the daemon: no"),
        (lambda: _status(site="west"), "another fleet file: it does not know alpha as a vehicle of north"),
        (lambda: _status(vehicles={}), "another fleet file: it does not know alpha as a vehicle of north"),
    ],
)
async def test_a_daemon_that_does_not_know_the_vehicle_is_granted_nothing(
    answer: Callable[[], Awaitable[Any]], problem: str
) -> None:
    hub = PlayedHub()
    north = Site("north", hub)
    north.answers["authority.status"] = answer
    north.bus.set_connected(False)  # else a hub that answers ends the problem
    await asyncio.sleep(2 * NEW_HUB_S)
    assert problem in str(north.leases.problem) and not north.sends
    assert problem in str(north.leases.not_held("alpha"))
    await north.end()


async def _result(result: str) -> Any:
    return {"result": result}


async def _status(site: str = "north", vehicles: dict[str, Any] | None = None) -> Any:
    known = {"alpha": {"held": False, "remaining_s": 0.0, "token": 0, "hub": ""}}
    return {"site": site, "run": "run", "now_s": 0.0, "vehicles": known if vehicles is None else vehicles}


# -- what it answers to others


async def _state(control: str | None) -> Any:
    return {"control": None if control is None else {"state": control}}


async def _error(error: Exception) -> Any:
    raise error


async def _silent() -> Any:
    await asyncio.Event().wait()


UNANSWERED = "the daemon of north does not say what it does with it; `--force` takes it all the same"


async def asked(bus: PlayedBus, message: bytes, subject: str = "lease.north.alpha.request") -> Any:
    """The refusal to a site that asks; no answer at all: "silence"."""
    answer = await bus.served["lease.north.*.request"](Message(subject, message))
    return "silence" if answer is None else from_json(answer)["refusal"]


def question(**changed: Any) -> bytes:
    return to_json({"v": 1, "by": "south", "to": "north", "force": False} | changed)


@each(
    ("state", "refusal"),
    [
        (lambda: _state("flying"), "it is flown by setpoints of north; `--force` takes it all the same"),
        (lambda: _state("ended"), None),
        (lambda: _state(None), None),
        (lambda: _error(RpcError(error_codes.TARGET_ERROR, "no vehicle alpha")), None),
        (_silent, UNANSWERED),
        (lambda: _error(DaemonUnreachable("socket", "it has ended")), UNANSWERED),
        (lambda: _error(RpcError(error_codes.LIMIT_EXCEEDED, "too many requests")), UNANSWERED),
    ],
)
async def test_a_vehicle_that_may_be_flown_is_not_given_away_without_force(
    state: Callable[[], Awaitable[Any]], refusal: str | None
) -> None:
    async with sites() as (north, _, __):
        north.answers["vehicles.get"] = state
        assert await asked(north.bus, question()) == refusal
        assert (north.leases.not_held("alpha") is None) == (refusal is not None)
        assert await asked(north.bus, question(force=True)) is None
        assert north.leases.not_held("alpha") is not None


async def test_only_the_holder_answers_and_only_to_what_is_a_request() -> None:
    async with sites() as (north, _, __):
        for message in (
            b"",
            b"[]",
            b"{}",
            question(to="south"),
            question(by=7),
            question(by=""),
            question(by="x" * 17),
        ):
            assert await asked(north.bus, message) == "silence", message
        for subject in ("lease.west.alpha.request", "lease.north.other.request", "lease.alpha.request"):
            assert await asked(north.bus, question(), subject) == "silence", subject
        assert await asked(north.bus, question(force=1)) is None  # idle: given without force
        await north.until(lambda: not north.sends)
        await north.until(lambda: north.sends)  # nobody took it
        north.link.control = {"state": "engaging"}
        assert "`--force`" in await asked(north.bus, question(force=1)), "only true forces it"
        assert await asked(north.bus, question(by="x" * 16, force=True)) is None


@each("method", ["federation.take", "federation.release"])
async def test_a_vehicle_is_named_as_it_is_here_or_with_its_home(method: str) -> None:
    async with sites() as (north, _, __):
        for name in ("beta", "south/alpha", "north/beta", 7, None):
            with pytest.raises(RpcError, match=rf"\[federation.vehicles\] does not name {name}; it names: alpha"):
                await north.methods[method]({"vehicle": name})
        assert (await north.call(method, "north/alpha"))["vehicle"] == "alpha"
    # it stands by: the part does not run any more
    with pytest.raises(RpcError, match="alpha: the daemon of this site is away"):
        north.leases._leases = {}
        await north.call(method, "alpha")
    north.leases.why_standby = lambda: "another bridge of north leads"
    with pytest.raises(RpcError, match="alpha: another bridge of north leads"):
        await north.call(method, "alpha")
