"""The station socket between clients and a fake daemon's real socket; other sites are a table of this test."""

from __future__ import annotations

import asyncio
import json
import sys
import tempfile
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.config.models import FleetConfig
from skygcs.errors import DaemonUnreachable, RefusedError, RpcError
from skygcs.ext.federation.bridge import station_client, station_socket
from skygcs.ext.federation.bridge.nkeys_files import write_new_seed
from skygcs.ext.federation.bridge.process import FederationOptions, FederationProcess
from skygcs.ext.federation.bridge.remote_feed import RemoteFeed
from skygcs.ext.federation.bridge.station_methods import DESCRIBED, station_methods
from skygcs.ext.federation.bridge.station_socket import StationSocket
from skygcs.ext.federation.config import FederationConfig
from skygcs.ext.federation.protocol.remote_sites import RemoteSites
from skygcs.ext.federation.protocol.site_names import SiteTargets
from skygcs.ext.federation.protocol.state_batch import StateBatch, row_from_state
from skygcs.rpc import client_peer
from skygcs.rpc.client import Client, connect
from skygcs.rpc.json_lines import OrderReports
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon
from support.hub import until
from support.rpc_reference import reference

OK = {"ok": True, "result": "accepted", "message": "done there", "attempts": 1, "elapsed_s": 0.1, "status_texts": []}


class Orders:
    """Takes arm and land to other sites; remembers them."""

    methods = frozenset({"vehicles.arm", "vehicles.land"})

    def __init__(self) -> None:
        self.given: list[tuple[str, dict[str, Any], dict[str, Any]]] = []
        self.fails: Exception | None = None
        self.finished = 0
        self.answers = asyncio.Event()
        self.answers.set()

    def check(self, method: str, params: Any, targets: Any, own: Sequence[str] = ()) -> None:
        pass

    async def give(
        self,
        method: str,
        params: Mapping[str, Any],
        targets: Mapping[str, Sequence[str]],
        by: str,
        own: int = 0,
        reports: OrderReports | None = None,
    ) -> dict[str, dict[str, Any]]:
        self.given.append((method, dict(params), {site: tuple(parts) for site, parts in targets.items()}))
        await self.answers.wait()
        if self.fails is not None:
            raise self.fails
        self.finished += 1
        return {f"{site}/{part}": OK for site, parts in targets.items() for part in parts}


class Services:
    """What a station socket needs: one other site, south, with alpha and bravo."""

    site = "north"
    daemon_token = None

    def __init__(self, daemon_address: str | None) -> None:
        self.daemon_address = daemon_address
        self.sites = RemoteSites("north", "mine")
        self.seq = 0
        self.orders: Orders | None = Orders()
        self.feed = RemoteFeed(self.sites, self.now_s, lambda: None)
        self.hear("alpha", "bravo")
        now = self.now_s()
        self.sites.compare_clock("south", "r", now, now, now, unix_received=now)

    def now_s(self) -> float:
        return asyncio.get_running_loop().time()

    def hear(self, *names: str) -> None:
        """A batch of south comes."""
        states = [{"name": name, "sysid": i, "compid": 1, "connected": True} for i, name in enumerate(names, 1)]
        rows = tuple(row for state in states if (row := row_from_state(state | {"last_heartbeat_age_s": 0.0})))
        self.seq += 1
        now = self.now_s()
        self.sites.take(StateBatch("south", "r", self.seq, now, 0.1, True, None, rows), now)
        self.feed.on_batch("south")

    def site_names(self) -> Sequence[str]:
        return self.sites.names

    def hub_problem(self) -> str | None:
        return None

    def states(self, targets: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
        return [state for site in targets for state in self.sites.states(site, self.now_s(), None)]

    async def full_state(self, site: str, target: str) -> dict[str, Any]:
        return {"name": f"{site}/{target}", "whole": True}

    def info(self) -> dict[str, Any]:
        return {"version": "0", "now_s": 1.0}

    def recent_events(self) -> list[dict[str, Any]]:
        return [{"kind": "armed", "site": "south"}]


async def answer_ping(_: dict[str, Any]) -> dict[str, Any]:
    """Answer."""
    return {"pong": True}


class Station:
    def __init__(self, socket: StationSocket, services: Services, daemon: FakeDaemon | None, server: RpcServer | None):
        self.socket, self.services, self.daemon, self.server = socket, services, daemon, server
        self.orders = services.orders
        self.path = str(socket.path)


@asynccontextmanager
async def station(folder: Path, *, daemon: FakeDaemon | None = None) -> AsyncIterator[Station]:
    path = folder / "d.sock"
    server = None if daemon is None else RpcServer(daemon, path)  # type: ignore[arg-type]
    if server is not None:
        await server.start()
    services = Services(None if daemon is None else str(path))
    socket = StationSocket(folder / "d.sock.federation", services)  # type: ignore[arg-type]
    await socket.start(station_methods({"federation.ping": answer_ping}))
    try:
        yield Station(socket, services, daemon, server)
    finally:
        services.feed.close()
        await socket.close()
        if server is not None:
            await server.close()


class Lines:
    """A client that writes and reads lines as they are."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def ask(self, line: str | bytes) -> Any:
        self.writer.write((line if isinstance(line, bytes) else line.encode()) + b"\n")
        return await self.next()

    async def next(self) -> Any:
        async with asyncio.timeout(30):
            return json.loads(await self.reader.readline())


@asynccontextmanager
async def lines(to: Station) -> AsyncIterator[Lines]:
    reader, writer = await asyncio.open_unix_connection(to.path, limit=1 << 25)
    try:
        yield Lines(reader, writer)
    finally:
        writer.close()


def request(method: str, /, **params: Any) -> str:
    return json.dumps({"jsonrpc": "2.0", "id": 7, "method": method, "params": params})


async def test_the_socket_is_its_users_only_and_gone_at_the_end(tmp_path: Path) -> None:
    async with station(tmp_path) as here:
        assert here.socket.path.stat().st_mode & 0o777 == 0o600
    assert not (tmp_path / "d.sock.federation").exists()


async def test_what_concerns_own_vehicles_is_answered_by_the_daemon_as_it_is(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon()) as here, connect(here.path) as gcs:
        assert [s["name"] for s in await gcs.vehicles("all")] == ["alpha", "bravo", "carol"]
        assert (await gcs.arm("bravo"))["bravo"]["ok"]
        assert (await gcs.arm("north/carol"))["carol"]["ok"]  # its name among sites
        assert (await gcs.vehicle("north/alpha"))["name"] == "alpha"
        with pytest.raises(RpcError, match="no vehicle 'zulu'"):
            await gcs.arm("zulu")
        assert here.orders is not None and here.orders.given == []
        async with lines(here) as raw:
            assert (await raw.ask("not json /"))["error"]["code"] == -32700
            batch = await raw.ask(f"[{request('vehicles.get', target='alpha')},{request('daemon.info')}]")
            assert [answer["result"].get("name") for answer in batch] == ["alpha", None]


async def test_lists_and_orders_of_several_sites_are_one_answer(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon()) as here, connect(here.path) as gcs:
        names = [s["name"] for s in await gcs.vehicles("*/all")]
        assert names == ["alpha", "bravo", "carol", "south/alpha", "south/bravo"]
        assert await gcs.vehicle("south/alpha") == {"name": "south/alpha", "whole": True}
        outcomes = await gcs.arm("bravo,south/alpha", force=True)
        assert {name: outcome["ok"] for name, outcome in outcomes.items()} == {"bravo": True, "south/alpha": True}
        assert here.orders is not None and here.daemon is not None
        assert here.orders.given[0] == ("vehicles.arm", {"force": True, "wait_s": 0.0}, {"south": ("alpha",)})
        assert here.daemon.vehicle("bravo").orders == [("arm", {"force": True, "wait_s": 0.0})]
        with pytest.raises(RpcError, match=r"params\.get does not go to other sites"):
            await gcs.call("params.get", target="south/alpha", names=["X"])
        with pytest.raises(RpcError, match="a batch cannot name other sites"):
            async with lines(here) as raw:
                error = (await raw.ask(f"[{request('vehicles.get', target='south/alpha')}]"))["error"]
                raise RpcError(error["code"], error["message"])


async def test_an_error_of_one_part_is_the_outcome_of_its_targets(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon()) as here, connect(here.path) as gcs:
        assert here.orders is not None
        here.orders.fails = RefusedError("not yours")
        outcomes = await gcs.land("bravo,south/alpha")
        assert outcomes["bravo"]["ok"] and outcomes["south/alpha"]["message"] == "not yours"
        with pytest.raises(RpcError, match="not yours"):
            await gcs.land("south/alpha")
        here.orders.fails = None
        outcomes = await gcs.land("zulu,south/alpha")
        assert outcomes["south/alpha"]["ok"] and "no vehicle 'zulu'" in outcomes["zulu"]["message"]


async def test_an_order_that_ends_a_flight_goes_on_without_its_client_at_all_sites(tmp_path: Path) -> None:
    daemon = FakeDaemon(1)
    async with station(tmp_path, daemon=daemon) as here:
        assert here.orders is not None
        here.orders.answers.clear()
        daemon.vehicle("alpha").delay_s = 0.2
        for method in ("vehicles.land", "vehicles.arm"):
            async with lines(here) as raw:  # it sends and is gone, perhaps before the daemon was reached
                raw.writer.write(request(method, targets="alpha,south/alpha").encode() + b"\n")
        await until(lambda: daemon.vehicle("alpha").finished == ["land"], "it lands here")
        await until(lambda: not here.socket.clients, "the clients are gone")
        here.orders.answers.set()
        await until(lambda: here.orders and here.orders.finished == 1, "it lands there")
        await until(lambda: not here.socket.lasting, "nothing is left")
        assert [order for order, _ in daemon.vehicle("alpha").orders] in (["land"], ["land", "arm"])


async def test_a_daemon_that_is_not_there_is_an_outcome_of_a_stop_for_everyone(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon(1)) as here:
        assert here.server is not None
        await here.server.close()
        async with connect(here.path) as gcs:
            outcomes = await gcs.land("*/all")
        assert outcomes["south/all"]["ok"]
        assert not outcomes["all"]["ok"] and "reaches no daemon" in outcomes["all"]["message"]


async def test_a_half_closed_client_waits_for_the_other_sites_too(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon(1)) as here, lines(here) as raw:
        assert here.orders is not None
        here.orders.answers.clear()
        raw.writer.write(request("vehicles.land", targets="alpha,south/alpha").encode() + b"\n")
        raw.writer.write_eof()
        await until(lambda: here.orders and here.orders.given, "it is on its way")
        await asyncio.sleep(0.1)
        here.orders.answers.set()
        assert set((await raw.next())["result"]["outcomes"]) == {"alpha", "south/alpha"}


async def test_a_slash_that_is_written_otherwise_is_the_same_slash(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon()) as here, lines(here) as raw:
        answer = await raw.ask(request("vehicles.get", target="south/alpha").replace("/", "\\u002f"))
        assert answer["result"]["whole"]


async def test_one_subscription_has_own_and_other_vehicles_until_it_is_ended(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon(1)) as here, connect(here.path) as gcs:
        updates = gcs.telemetry("*/all", rate_hz=20)
        seen = set()
        async for state in updates:
            seen.add(state["name"])
            here.services.hear("alpha", "bravo", "delta")
            if len(seen) == 4:
                break
        assert seen == {"alpha", "south/alpha", "south/bravo", "south/delta"}
        updates.close()
        assert len(here.socket.clients) == 1
        (client,) = here.socket.clients
        await gcs.call("daemon.info")
        assert client._subscriptions == {}
        async with lines(here) as raw:
            first = await raw.ask(request("subscribe", topic="telemetry", targets="south/bravo", rate_hz=20))
            number = first["result"]["subscription"]
            assert number >= station_client.OWN_NUMBERS
            state = await raw.next()
            assert state["params"]["state"]["name"] == "south/bravo" and state["params"]["last"] is True
            raw.writer.write(request("unsubscribe", subscription=number).encode() + b"\n")
            while "result" not in (answer := await raw.next()):
                pass
            assert answer["result"] == {"subscription": number}


async def test_a_station_without_a_daemon_answers_what_a_page_and_status_ask(tmp_path: Path) -> None:
    async with station(tmp_path) as here, connect(here.path) as gcs:
        assert await gcs.vehicles("all") == []
        assert [s["name"] for s in await gcs.vehicles("*/all")] == ["south/alpha", "south/bravo"]
        assert (await gcs.call("daemon.info"))["now_s"] == 1.0
        assert await gcs.call("operator.relay") == {"ok": True}
        assert await gcs.call("events.recent") == [{"kind": "armed", "site": "south"}]
        assert (await gcs.call("subscribe", topic="plan"))["subscription"] >= station_client.OWN_NUMBERS
        assert await gcs.arm("*/all") == {"south/all": OK}
        for targets in ("alpha", "alpha,south/bravo"):
            with pytest.raises(RpcError, match="this station has no daemon"):
                await gcs.arm(targets)
        methods = [method["name"] for method in (await gcs.call("rpc.discover"))["methods"]]
        assert methods == ["federation.ping"]
        assert await gcs.call("federation.ping") == {"pong": True}
        with pytest.raises(RpcError, match=r"did you mean federation\.ping"):
            await gcs.call("federation.pong")


async def test_discover_describes_both(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon(1)) as here, connect(here.path) as gcs:
        names = [method["name"] for method in (await gcs.call("rpc.discover"))["methods"]]
        assert {"vehicles.arm", "federation.ping"} <= set(names)


async def test_clients_are_closed_with_their_daemon_and_find_the_next(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon(1)) as here:
        async with connect(here.path) as gcs:
            await gcs.vehicles()
            assert here.server is not None
            await here.server.close()
            with pytest.raises(DaemonUnreachable):
                await wait_closed(gcs)
        async with connect(here.path) as gcs:
            assert [s["name"] for s in await gcs.vehicles("*/all")] == ["south/alpha", "south/bravo"]
            with pytest.raises(RpcError, match="reaches no daemon"):
                await gcs.arm("alpha")
        await until(lambda: not here.socket.clients, "all clients are gone")


async def wait_closed(gcs: Client) -> None:
    async for _ in gcs.events():
        pass


async def test_a_client_that_only_shuts_its_sending_side_gets_its_answers(tmp_path: Path) -> None:
    for daemon in (None, FakeDaemon(1)):
        async with station(tmp_path, daemon=daemon) as here, lines(here) as raw:
            raw.writer.write(request("vehicles.list", targets="*/all").encode() + b"\n")
            raw.writer.write(request("vehicles.list").encode())  # without the end of the line
            raw.writer.write_eof()
            answers = [json.loads(line) for line in (await raw.reader.read()).splitlines()]
            assert sorted(len(answer["result"]) for answer in answers) == ([0, 2] if daemon is None else [1, 3])


async def test_when_all_places_are_taken_flights_can_be_ended_and_an_idle_client_makes_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station_socket, "MAX_CLIENTS", 2)
    monkeypatch.setattr(station_socket, "MAX_RESERVE", 1)
    async with station(tmp_path, daemon=FakeDaemon()) as here, lines(here) as first, lines(here) as second:
        await first.ask(request("daemon.info"))
        await second.ask(request("daemon.info"))
        async with lines(here) as third, lines(here) as fourth:
            assert "places" in (await third.ask(request("vehicles.arm", targets="alpha")))["error"]["message"]
            assert (await third.ask(request("vehicles.land", targets="alpha,south/bravo")))["result"][
                "outcomes"
            ].keys() == {"alpha", "south/bravo"}
            assert "places" in (await fourth.next())["error"]["message"]
        await until(lambda: len(here.socket.clients) == 2, "those beyond are gone")
        oldest = next(iter(here.socket.clients))
        oldest.used_at -= station_socket.IDLE_S
        async with lines(here) as fifth:
            assert "result" in await fifth.ask(request("vehicles.arm", targets="alpha"))
        assert "closed: idle" in (await first.next())["error"]["message"]


async def test_what_is_too_long_or_not_read_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_peer, "MAX_OUTPUT_BYTES", 200_000)
    async with station(tmp_path, daemon=FakeDaemon(1)) as here, lines(here) as raw, lines(here) as idle:
        assert "bytes" in (await raw.ask(b"x" * (station_client.MAX_LINE_BYTES + 2)))["error"]["message"]
        assert len((await raw.ask(request("vehicles.list")))["result"]) == 1
        monkeypatch.setattr(client_peer, "HIGH_WATER_BYTES", 1000)
        here.services.hear(*(f"n{i}" for i in range(250)))
        for _ in range(40):
            idle.writer.write(request("vehicles.list", targets="south/all").encode() + b"\n")
        await until(lambda: here.socket.counters["closed_unread"] == 1, "the one that does not read is closed")
        assert len((await raw.ask(request("vehicles.list")))["result"]) == 1


async def test_a_client_that_does_not_read_gets_no_states_meanwhile_and_the_newest_then(tmp_path: Path) -> None:
    async with station(tmp_path) as here, lines(here) as raw:
        await raw.ask(request("subscribe", topic="telemetry", targets="*/all", rate_hz=20))
        await raw.next()
        (client,) = here.socket.clients
        client.pause_writing()
        for _ in range(50):
            here.services.hear("alpha")
        here.services.hear("newest")
        client.resume_writing()
        names = []
        while "south/newest" not in names:
            names.append((await raw.next())["params"]["state"]["name"])
        assert len(names) <= 3


async def test_a_subscription_gets_as_many_updates_as_it_asked_for(tmp_path: Path) -> None:
    """Batches come at 20 Hz; it wants 5."""
    async with station(tmp_path) as here:
        now = [100.0]
        written: list[bytes] = []
        reader = SimpleNamespace(writable=True, write=written.append)
        here.services.feed._clock = lambda: now[0]
        targets = SiteTargets((), {"south": ("all",)}, False, True)
        subscription = here.services.feed.checked(reader, {"topic": "telemetry", "rate_hz": 5.0}, targets)
        here.services.feed.add(subscription)
        for tick in range(200):
            now[0] = 100.0 + tick / 20 + 0.004 * (tick % 3)
            here.services.feed.on_batch("south")
        assert 49 <= len(written) <= 52


async def test_groups_that_only_other_sites_have_can_be_asked_for_everywhere(tmp_path: Path) -> None:
    async with station(tmp_path, daemon=FakeDaemon(1)) as here, connect(here.path) as gcs:
        seen = {}
        async for state in gcs.telemetry("*/all", rate_hz=20, groups=["age_s", "site"]):
            seen[state["name"]] = set(state)
            if len(seen) == 3:
                break
        assert seen["alpha"] == {"name", "sysid", "connected"}
        assert seen["south/alpha"] == {"name", "sysid", "site", "age_s"}


# -- docs/reference/rpc.md says what the methods of the station socket say.


PAGE = Path(__file__).parents[5] / "docs" / "reference" / "rpc.md"


async def described(folder: Path) -> str:
    """Of a site that has everything."""
    write_new_seed(folder / "north.nk")
    table = {"site": "north", "servers": ["nats://127.0.0.1:4222"], "nkey": str(folder / "north.nk")}
    found = FederationConfig.model_validate({**table, "vehicles": {"alpha": {"home": "north"}}})
    fleet = FleetConfig(extensions={"federation": found})
    process = FederationProcess(fleet, FederationOptions(str(folder / "d.sock")))
    assert DESCRIBED.keys() <= process.station.methods.keys()
    return reference(station_methods(process.station.methods).values())


async def test_every_method_of_the_station_is_described_as_it_is(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert await described(tmp_path) in text
    assert f"| clients of the station socket | {station_socket.MAX_CLIENTS} |" in text


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        sys.stdout.write(asyncio.run(described(Path(made))))
