"""Orders between sites over a real hub: real bridges, daemons with fake vehicles, a station without a daemon."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.ext.federation.protocol.order_messages import OrderRequest, OutcomeQuestion, decode_reply
from skygcs.rpc.client import Client
from support.fake_daemon import FakeDaemon
from support.federated import Site, site
from support.hub import Hub, until


async def hears(gcs: Client, *names: str) -> None:
    """Until the station knows these vehicles."""
    known: set[str] = set()
    for _ in range(1000):
        known = {state["name"] for state in await gcs.vehicles("*/all")}
        if known >= set(names):
            return
        await asyncio.sleep(0.02)
    raise AssertionError(f"not heard: {set(names) - known}")


def given(daemon: FakeDaemon, name: str) -> list[str]:
    """The orders that a vehicle got."""
    return [order for order, _ in daemon.vehicle(name).orders]


def records(of: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (of / "federation-orders.jsonl").read_bytes().splitlines()]


async def test_orders_reach_vehicles_of_other_sites_and_are_recorded(hub: Hub, tmp_path: Path) -> None:
    north, south = FakeDaemon(2), FakeDaemon(3)
    async with (
        site(hub, "north", tmp_path, daemon=north) as a,
        site(hub, "south", tmp_path, daemon=south),
        site(hub, "boss", tmp_path, role="operator") as c,
        a.client() as at_north,
        c.client() as boss,
        hub.bus("visitor") as visitor,
    ):
        audit: list[dict[str, Any]] = []
        await visitor.subscribe("audit.*", lambda message: audit.append(json.loads(message.data)))
        await hears(boss, "north/alpha", "south/carol")
        await hears(at_north, "south/carol")

        outcomes = await boss.arm("south/alpha")
        assert list(outcomes) == ["south/alpha"] and outcomes["south/alpha"]["ok"], outcomes
        assert given(south, "alpha") == ["arm"] and given(south, "bravo") == given(north, "alpha") == []
        # several sites at once, the own one among them
        outcomes = await at_north.hold("*/all")
        assert sorted(outcomes) == ["alpha", "bravo", "south/alpha", "south/bravo", "south/carol"]
        assert all(outcome["ok"] for outcome in outcomes.values())
        assert given(south, "carol") == given(north, "bravo") == ["hold"]
        # ranges and groups as the home site has them
        assert sorted(await boss.land("south/2-3,north/1")) == ["north/alpha", "south/bravo", "south/carol"]
        await boss.goto("south/bravo", 43.7, -79.4, 10)
        assert south.vehicle("bravo").orders[-1][1]["lat_deg"] == 43.7

        (begun, ended) = [r for r in records(tmp_path / "logs-south") if r["method"] == "vehicles.arm"]
        assert (begun["status"], ended["status"], begun["vehicle"]) == ("running", "done", "alpha")
        assert begun["by"].endswith("@" + c.process.station.name) and begun["role"] == "operator"
        await until(lambda: ended in audit, "the record is on the bus")


async def test_what_does_not_travel_is_refused_before_anything_is_sent(hub: Hub, tmp_path: Path) -> None:
    north, south = FakeDaemon(2), FakeDaemon(2)
    async with (
        site(hub, "north", tmp_path, daemon=north) as a,
        site(hub, "south", tmp_path, daemon=south),
        site(hub, "visitor", tmp_path, role="observer") as c,
        a.client() as at_north,
        c.client() as visitor,
    ):
        await hears(at_north, "south/bravo")
        await hears(visitor, "south/bravo", "north/alpha")

        async def refused(gcs: Client, method: str, text: str, **params: Any) -> None:
            with pytest.raises(RpcError, match=text):
                await gcs.call(method, **params)

        await refused(visitor, "vehicles.land", "observer", targets="south/alpha")
        await refused(at_north, "vehicles.arm", "--wait", targets="south/alpha", wait_s=5.0)
        await refused(at_north, "vehicles.goto", "--enu", targets="south/alpha", enu_m=[0, 0, 5])
        place = {"lat_deg": 43.7, "lon_deg": -79.4}
        await refused(at_north, "vehicles.goto", "formation", targets="south/all", **place)
        await refused(at_north, "vehicles.goto", "formation", targets="alpha,south/alpha", **place)
        await refused(at_north, "vehicles.reboot", "does not go to other sites", targets="south/alpha")
        # one word for the vehicles of all sites, and none of them is stopped without it
        await refused(at_north, "vehicles.stop", "kill-4", targets="*/all", action="kill")
        await refused(at_north, "vehicles.stop", "kill-4", targets="*/all", action="kill", confirm="kill-2")
        await refused(at_north, "vehicles.stop", "kill-1", targets="south/alpha", action="kill")
        assert [vehicle.orders for daemon in (north, south) for vehicle in daemon.fleet.vehicles.values()] == [[]] * 4
        killed = await at_north.call("vehicles.stop", targets="*/all", action="kill", confirm="kill-4")
        assert all(outcome["ok"] for outcome in killed["outcomes"].values()) and len(killed["outcomes"]) == 4


async def test_a_copy_of_an_order_is_answered_and_not_carried_out(hub: Hub, tmp_path: Path) -> None:
    """Also after the bridge has restarted; and what was asked for before it came never is."""
    south = FakeDaemon(1)
    async with hub.bus("boss") as bus:
        async with site(hub, "south", tmp_path, daemon=south):
            deadline_s = await _deadline(bus, 9.0)
            land = OrderRequest("a" * 32, "alpha", "vehicles.land", {}, deadline_s, "mia@boss", "operator")
            first = decode_reply(land.key, await bus.request("cmd.south.alpha", land.encoded(), 5.0))
            assert first is not None and first.status == "done"
            assert decode_reply(land.key, await bus.request("cmd.south.alpha", land.encoded(), 5.0)) == first
            asked = OrderRequest("b" * 32, "alpha", "vehicles.rtl", {}, deadline_s, "mia@boss", "operator")
            answer = await bus.request("cmd.south.outcome", OutcomeQuestion(asked.key).encoded(), 5.0)
            assert json.loads(answer)["status"] == "never came"
            assert json.loads(await bus.request("cmd.south.alpha", asked.encoded(), 5.0))["status"] == "refused"
            for subject in ("cmd.south.all", "cmd.south.1"):
                group = OrderRequest(
                    "c" * 31 + subject[-1].replace("l", "d"), "x", "vehicles.rtl", {}, deadline_s, "", "site"
                )
                assert json.loads(await bus.request(subject, group.encoded(), 5.0))["status"] == "refused"
            assert json.loads(await bus.request("cmd.south.alpha", b"{}", 5.0))["status"] == "refused"
        async with site(hub, "south", tmp_path, daemon=south):
            await _deadline(bus, 0.0)
            again = json.loads(await bus.request("cmd.south.alpha", land.encoded(), 5.0))
            assert again["status"] == "done"
    assert given(south, "alpha") == ["land"]


async def _deadline(bus: Any, ahead_s: float) -> float:
    """This long from now, on the clock of south."""
    while True:
        try:
            return float(json.loads(await bus.request("here.south", b'{"t0_s": 0}', 1.0))["site_s"]) + ahead_s
        except Exception:
            await asyncio.sleep(0.05)


async def test_without_the_hub_orders_fail_and_the_outcome_of_one_under_way_is_found_later(
    hub: Hub, tmp_path: Path
) -> None:
    south = FakeDaemon(1)
    async with (
        site(hub, "south", tmp_path, daemon=south),
        site(hub, "boss", tmp_path, role="operator") as c,
        c.client() as boss,
    ):
        await hears(boss, "south/alpha")
        south.vehicle("alpha").delay_s = 2.0
        under_way = asyncio.create_task(boss.land("south/alpha"))
        await until(lambda: given(south, "alpha") == ["land"], "it is being carried out")
        hub.kill()
        await until(lambda: not c.process.bus.connected, "the hub is gone")
        refused = (await boss.rtl("south/alpha"))["south/alpha"]
        assert refused["result"] == "refused" and "nothing was sent" in refused["message"]
        outcome = (await under_way)["south/alpha"]
        assert outcome["result"] == "unknown" and "federation outcome south/" in outcome["message"]
        await hub.start()
        await until(lambda: c.process.bus.connected, "the hub is back")
        settled = await _settled(boss, outcome["id"])
        assert settled["status"] == "done" and settled["vehicle"] == "south/alpha"
        deadline_s = asyncio.get_running_loop().time() + 30  # a page asks as it orders
        assert json.loads(await boss.relay("federation.outcome", {"id": outcome["id"]}, deadline_s)) == settled
    assert given(south, "alpha") == ["land"]


async def _settled(boss: Client, ident: str) -> dict[str, Any]:
    """The outcome, once the site answers."""
    answer: dict[str, Any] = {}
    for _ in range(500):
        answer = await boss.call("federation.outcome", id=ident)
        if answer["answered"] and answer["status"] != "running":
            return answer
        await asyncio.sleep(0.05)
    raise AssertionError(f"not settled: {answer}")


async def test_a_site_whose_daemon_is_away_says_so(hub: Hub, tmp_path: Path) -> None:
    south = FakeDaemon(1)
    async with (
        site(hub, "south", tmp_path, daemon=south) as b,
        site(hub, "boss", tmp_path, role="operator") as c,
        c.client() as boss,
    ):
        await hears(boss, "south/alpha")
        assert b.server is not None
        await b.server.close()
        outcome = (await boss.land("south/alpha"))["south/alpha"]
        assert outcome["result"] == "refused" and "daemon" in outcome["message"]
        assert given(south, "alpha") == []


async def test_the_command_line_gives_orders_to_other_sites(hub: Hub, tmp_path: Path) -> None:
    south = FakeDaemon(2)
    async with (
        site(hub, "south", tmp_path, daemon=south),
        site(hub, "boss", tmp_path, role="operator") as c,
        c.client() as boss,
    ):
        await hears(boss, "south/bravo")
        code, text = await typed(c, "takeoff", "south/alpha", "5")
        assert (code, text.split()[:2]) == (0, ["ok", "south/alpha"]), text
        assert south.vehicle("alpha").orders[-1][1]["height_m"] == 5.0
        code, text = await typed(c, "stop", "south/all", "kill")
        assert code == 1 and "kill-2" in text
        code, text = await typed(c, "stop", "*/all", "kill", "--confirm", "kill-2")
        assert code == 0 and "south/bravo" in text, text
        code, text = await typed(c, "federation", "outcome", f"south/{'0' * 32}")
        assert code == 1 and "never came" in text


async def typed(station: Site, *words: str) -> tuple[int, str]:
    """Exit code and output of skygcs-cli with the daemon's socket, beside which the station's is."""
    socket = station.socket.removesuffix(".federation")
    code = "import sys; from skygcs.cli.main import main; sys.argv[0] = 'skygcs-cli'; main()"
    line = [sys.executable, "-c", code, "--socket", socket, *words]
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*line, stdin=asyncio.subprocess.DEVNULL, stdout=pipe, stderr=pipe)
    out, err = await process.communicate()
    return process.returncode or 0, (out + err).decode()
