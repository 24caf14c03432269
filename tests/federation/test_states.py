"""States of several sites over a real hub: what one site's daemon has, every station shows, with its total age."""

from __future__ import annotations

import asyncio
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.core.geo import Origin, enu_from_geodetic
from skygcs.errors import RpcError
from skygcs.ext.federation.protocol.state_batch import StateBatch, decode_batch, encode_batch
from skygcs.rpc.client import Client
from skygcs.web.daemon_connection import DaemonConnection
from skygcs.web.state_batches import LatestStates
from support.fake_daemon import FakeDaemon
from support.federated import site
from support.hub import Hub, until


async def shown(gcs: Client, *names: str) -> dict[str, dict[str, Any]]:
    """All states as soon as these vehicles are shown as connected."""
    for _ in range(1000):
        states = {state["name"]: state for state in await gcs.vehicles("*/all")}
        if all(name in states and states[name]["connected"] for name in names):
            return states
        await asyncio.sleep(0.02)
    raise AssertionError(f"not shown: {names}; there are {list(states)}")


async def test_two_sites_see_each_other_and_an_observer_without_a_daemon_sees_both(hub: Hub, tmp_path: Path) -> None:
    north, south = FakeDaemon(2), FakeDaemon(3)
    north.fleet.origin = Origin(43.70, -79.40, 100.0)
    south.fleet.origin = Origin(43.78, -79.46, 180.0)
    south.vehicle("bravo").armed = True
    async with (
        site(hub, "north", tmp_path, daemon=north) as a,
        site(hub, "south", tmp_path, daemon=south) as b,
        site(hub, "visitor", tmp_path, role="observer") as c,
        a.client() as at_north,
        b.client() as at_south,
        c.client() as visitor,
    ):
        states = await shown(at_north, "south/alpha", "south/bravo", "south/carol")
        assert set(states) == {"alpha", "bravo", "south/alpha", "south/bravo", "south/carol"}
        bravo = states["south/bravo"]
        assert (bravo["site"], bravo["armed"], bravo["landed"], bravo["mode"]) == (
            "south",
            True,
            "in_air",
            "AUTO.LOITER",
        )
        assert 0.4 <= bravo["age_s"] < 2.0
        await until(lambda: a.process.parts["station socket"].origin, "the own origin is known")  # type: ignore[attr-defined]
        place = (await shown(at_north, "south/bravo"))["south/bravo"]["position"]
        there = enu_from_geodetic(place["lat_deg"], place["lon_deg"], place["alt_amsl_m"], north.fleet.origin)
        assert place["enu_m"] == pytest.approx(there, abs=1e-3)

        assert set(await shown(at_south, "north/alpha", "north/bravo")) >= {"alpha", "bravo", "carol"}
        everything = await shown(visitor, "north/alpha", "north/bravo", "south/carol")
        assert all("/" in name for name in everything) and len(everything) == 5
        assert [s["name"] for s in await at_north.vehicles("south/red")] == ["south/alpha", "south/carol"]
        assert [s["name"] for s in await at_north.vehicles("north/alpha,south/2-3")] == [
            "alpha",
            "south/bravo",
            "south/carol",
        ]
        assert [s["name"] for s in await at_north.vehicles("all")] == ["alpha", "bravo"]  # as at the daemon

        sites = await visitor.call("federation.sites")
        assert (sites["site"], sites["role"], sites["hub"]["connected"]) == (None, "observer", True)
        assert [(s["site"], s["silent"], s["daemon"], s["vehicles"]["count"]) for s in sites["sites"]] == [
            ("north", False, True, 2),
            ("south", False, True, 3),
        ]
        assert sites["sites"][0]["clock"]["error_s"] < 1.0 and sites["sites"][0]["origin"]["lat_deg"] == 43.70


async def test_a_site_that_falls_silent_turns_grey_with_its_age_and_comes_back(hub: Hub, tmp_path: Path) -> None:
    async with site(hub, "north", tmp_path, daemon=FakeDaemon(1)) as a, a.client() as gcs:
        async with site(hub, "south", tmp_path, daemon=FakeDaemon(1)):
            fresh = (await shown(gcs, "south/alpha"))["south/alpha"]
        for _ in range(1000):
            (state,) = await gcs.vehicles("south/alpha")
            if not state["connected"]:
                break
            await asyncio.sleep(0.02)
        assert not state["connected"] and state["age_s"] > 1.0 and state["mode"] == fresh["mode"]
        (described,) = (await gcs.call("federation.sites"))["sites"]
        assert described["silent"] and described["vehicles"]["heard"] == 0
        async with site(hub, "south", tmp_path, daemon=FakeDaemon(1)):
            assert (await shown(gcs, "south/alpha"))["south/alpha"]["age_s"] < 2.0
            assert (await gcs.call("federation.sites"))["sites"][0]["restarts"] == 1


async def test_a_daemon_that_ends_leaves_its_site_there_and_its_vehicles_old(hub: Hub, tmp_path: Path) -> None:
    async with (
        site(hub, "north", tmp_path, role="site", daemon=FakeDaemon(1)) as a,
        site(hub, "south", tmp_path, daemon=FakeDaemon(1)) as b,
        a.client() as gcs,
    ):
        await shown(gcs, "south/alpha")
        assert b.server is not None
        await b.server.close()
        for _ in range(1000):
            (described,) = (await gcs.call("federation.sites"))["sites"]
            if not described["daemon"]:
                break
            await asyncio.sleep(0.02)
        assert not described["daemon"] and not described["silent"] and described["vehicles"]["count"] == 1
        before = described["vehicles"]["oldest_age_s"]
        for _ in range(1000):  # it grows; how fast, its clock decides, which is known better and better
            (described,) = (await gcs.call("federation.sites"))["sites"]
            if described["vehicles"]["oldest_age_s"] >= before + 0.4:
                break
            await asyncio.sleep(0.02)
        assert described["vehicles"]["oldest_age_s"] >= before + 0.4


async def test_a_subscription_to_every_site_has_own_and_other_vehicles(hub: Hub, tmp_path: Path) -> None:
    north, south = FakeDaemon(1), FakeDaemon(2)
    async with (
        site(hub, "north", tmp_path, daemon=north) as a,
        site(hub, "south", tmp_path, daemon=south),
        a.client() as gcs,
    ):
        await shown(gcs, "south/alpha")
        seen: dict[str, int] = {}
        async for state in gcs.telemetry("*/all", rate_hz=10, groups=["position", "connected"]):
            seen[state["name"]] = seen.get(state["name"], 0) + 1
            if state["name"] != "alpha":
                assert set(state) == {"name", "sysid", "site", "age_s", "position", "connected"}
            if len(seen) == 3 and min(seen.values()) >= 3:
                break
        events = gcs.events("*/all")
        await gcs.call("daemon.info")  # what was sent before is subscribed by now
        south.emit("statustext", "bravo", "bravo: low battery")
        async for event in events:
            if event["text"] == "bravo: low battery":
                break
        assert (event["site"], event["vehicle"]) == ("south", "south/bravo")
        north.emit("statustext", "alpha", "alpha: all well")
        async for event in events:
            if event["text"] == "alpha: all well":
                break
        assert "site" not in event


async def test_the_whole_state_of_one_vehicle_comes_on_request(hub: Hub, tmp_path: Path) -> None:
    south = FakeDaemon(3)
    async with (
        site(hub, "visitor", tmp_path, role="observer") as a,
        site(hub, "south", tmp_path, daemon=south, share=["1-2"]),
        a.client() as gcs,
    ):
        await shown(gcs, "south/alpha", "south/bravo")
        state = await gcs.vehicle("south/alpha")
        assert state["name"] == "south/alpha" and state["firmware"] == "1.14.3" and "status_texts" in state
        assert 0.4 <= state["age_s"] < 2.0 and 0.2 <= state["gps"]["age_s"] < 2.0
        assert state["gps"]["vdop"] is None and math.isfinite(state["gps"]["hdop"])
        with pytest.raises(RpcError, match="no vehicle 'carol'"):  # not shared
            await gcs.vehicle("south/carol")
        with pytest.raises(RpcError, match="no site 'west'"):
            await gcs.vehicle("west/alpha")
        with pytest.raises(RpcError, match="this station has no daemon"):
            await gcs.arm("alpha")


async def test_bad_batches_are_counted_and_change_nothing(hub: Hub, tmp_path: Path) -> None:
    async with (
        site(hub, "north", tmp_path, daemon=FakeDaemon(1)) as a,
        hub.bus("south") as rogue,
        a.client() as gcs,
    ):
        readers = a.process.parts["readers"]
        await rogue.publish("state.south.fast", b'{"v":1,"site":"south"}')
        await until(lambda: readers.status().get("batches_bad") == 1, "a bad batch is counted")
        await rogue.publish("state.south.fast", encode_batch(StateBatch("east", "r", 1, 0.0, 0.1, True, None, ())))
        await until(lambda: readers.status().get("batches_bad") == 2, "a batch in another's name is counted")
        assert (await gcs.call("federation.sites"))["sites"] == []


async def test_the_slow_series_has_the_same_bytes_twice_a_second(hub: Hub, tmp_path: Path) -> None:
    async with (
        hub.bus("visitor") as bus,
        site(hub, "south", tmp_path, daemon=FakeDaemon(2)),
        site(hub, "north", tmp_path, daemon=FakeDaemon(1), subscribe_hz=2) as a,
        a.client() as gcs,
    ):
        series: dict[str, list[bytes]] = {"fast": [], "slow": []}
        for name, seen in series.items():
            await bus.subscribe(f"state.south.{name}", lambda message, seen=seen: seen.append(message.data))
        await until(lambda: len(series["slow"]) >= 5, "the slow series comes")
        assert set(series["slow"][1:-1]) <= set(series["fast"])
        apart_s = [b - a for a, b in pairwise(decode_batch(data).sent_s for data in series["slow"])]
        assert min(apart_s) >= 0.44
        assert (await shown(gcs, "south/alpha"))["south/alpha"]["age_s"] < 5.0
        batches = (await gcs.call("federation.sites"))["sites"][0]["batches"]
        assert batches["lost"] > batches["taken"] / 2  # those between are not for it


async def test_a_hub_that_ends_turns_other_sites_grey_and_heals_without_a_hand(hub: Hub, tmp_path: Path) -> None:
    async with (
        site(hub, "north", tmp_path, daemon=FakeDaemon(1)) as a,
        site(hub, "south", tmp_path, daemon=FakeDaemon(1)),
        a.client() as gcs,
    ):
        await shown(gcs, "south/alpha")
        hub.kill()
        for _ in range(1000):
            states = {state["name"]: state["connected"] for state in await gcs.vehicles("*/all")}
            if not states["south/alpha"]:
                break
            await asyncio.sleep(0.02)
        assert states == {"alpha": True, "south/alpha": False}
        assert not (await gcs.call("federation.sites"))["hub"]["connected"]
        await hub.start()
        assert (await shown(gcs, "south/alpha"))["south/alpha"]["age_s"] < 2.0
        assert (await gcs.call("federation.sites"))["sites"][0]["restarts"] == 0


async def test_the_page_is_fed_through_the_station_socket(hub: Hub, tmp_path: Path) -> None:
    """The real connection of `skygcs web`, at a site, and at an observer's station without a daemon."""
    async with (
        site(hub, "south", tmp_path, daemon=FakeDaemon(2)),
        site(hub, "north", tmp_path, daemon=FakeDaemon(1)),
        site(hub, "visitor", tmp_path, role="observer"),
    ):
        others = {"south/alpha", "south/bravo"}
        for name, wanted in (("north", {"alpha", *others}), ("visitor", {"north/alpha", *others})):
            states = LatestStates()
            connection = DaemonConnection(str(tmp_path / f"{name}.sock"), None, states)
            pages = Pages()
            task = asyncio.create_task(connection.run(pages))
            try:
                await until(lambda: len(states) == len(wanted), "all vehicles are on the page")  # noqa: B023
                await until(lambda: states.complete, "the round is known to be complete")  # noqa: B023
                assert {name for name, *_ in states.since(-1)[0]} == wanted
                assert connection.connected
                answer = await connection.call("vehicles.get", {"target": "south/bravo"})
                assert json.loads(answer)["name"] == "south/bravo"
            finally:
                connection.stopping = True
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


class Pages:
    """One page that wants states ten times a second."""

    def __init__(self) -> None:
        self.wanted = asyncio.Event()

    def on_states(self) -> None: ...
    def on_event(self, event: dict[str, Any]) -> None: ...
    def on_daemon(self) -> None: ...
    def notify(self, method: str, params: Any, *, keep: bool = False) -> None: ...
    def wake_all(self) -> None: ...

    def rate_hz(self) -> float | None:
        return 10.0


async def test_a_site_that_floods_the_hub_is_read_no_more_often_than_it_may_send(hub: Hub, tmp_path: Path) -> None:
    async with site(hub, "north", tmp_path, daemon=FakeDaemon(1)) as a, hub.bus("south") as rogue, a.client() as gcs:
        readers = a.process.parts["readers"]
        for seq in range(1, 501):
            batch = StateBatch("south", "r", seq, 0.0, 0.1, True, None, ())
            assert await rogue.publish("state.south.fast", encode_batch(batch))
            event = {"v": 1, "site": "south", "run": "r", "seq": seq, "event": {"kind": "armed", "text": "noise"}}
            for _ in range(2):
                await rogue.publish("event.south", json.dumps(event).encode())
        await until(lambda: readers.status().get("events_beyond_rate"), "events beyond the rate are counted")
        for seq in range(501, 511):  # a batch that is read shows how many were not
            await rogue.publish(
                "state.south.fast", encode_batch(StateBatch("south", "r", seq, 0.0, 0.1, True, None, ()))
            )
            await asyncio.sleep(0.1)
        await until(
            lambda: (sites := a.process.parts["readers"]._sites.sites(0.0)) and sites[0]["batches"]["lost"] > 100,  # type: ignore[attr-defined]
            "batches are skipped",
        )
        taken = (await gcs.call("federation.sites"))["sites"][0]["batches"]["taken"]
        assert taken < 300 and readers.status()["batches_skipped"] > 100
        assert (await gcs.vehicles("all"))[0]["name"] == "alpha"


async def command(*args: str, code: int = 0) -> str:
    """What skygcs-cli prints."""
    result = await asyncio.to_thread(CliRunner().invoke, app, args)
    assert result.exit_code == code, result.output + repr(result.exception)
    return result.output


async def test_status_and_watch_show_all_sites_where_a_bridge_runs(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", "restored after the test")
    north = ("--socket", str(tmp_path / "north.sock"))
    async with site(hub, "south", tmp_path, daemon=FakeDaemon(2)) as b:
        async with site(hub, "north", tmp_path, daemon=FakeDaemon(1)) as a:
            async with a.client() as gcs:
                await shown(gcs, "south/alpha", "south/bravo")
            lines = (await command(*north, "status")).splitlines()
            assert lines[0].split()[:3] == ["name", "site", "id"]
            assert [line.split()[0] for line in lines[1:]] == ["alpha", "south/alpha", "south/bravo"]
            assert " south " in lines[2] and lines[2].rstrip().endswith(" s")
            assert [s["name"] for s in json.loads(await command(*north, "status", "south/2", "--json"))] == [
                "south/bravo"
            ]
            assert "south/bravo" not in await command(*north, "status", "alpha")
            watched = await command(*north, "watch", "--count", "6", "--rate", "10")
            assert {line.split()[0] for line in watched.splitlines()} == {"alpha", "south/alpha", "south/bravo"}
            watched = await command(
                *north, "watch", "south/all", "--count", "4", "--fields", "position.alt_amsl_m,age_s"
            )
            assert all(
                line.startswith("south/") and "position.alt_amsl_m=182.5" in line for line in watched.splitlines()
            )
            assert "no site 'west'" in await command(*north, "status", "west/alpha", code=1)

            assert a.server is not None
            await a.server.close()  # the bridge alone
            without = await command("--socket", a.socket, "status")
            assert "south/alpha" in without and "the daemon of north does not answer" in without
        grey = json.loads(await command("--socket", b.socket, "status", "all sites", "--json"))
        assert {state["name"] for state in grey} == {"alpha", "bravo", "north/alpha"}


async def test_a_bridge_that_has_ended_leaves_the_own_vehicles_to_be_shown(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", "restored after the test")
    async with site(hub, "north", tmp_path, daemon=FakeDaemon(1)) as a:
        a.process.stop()
        left = tmp_path / "north.sock.federation"
        await until(lambda: not left.exists(), "the bridge has ended")
        left.touch()  # as one that was killed leaves it
        output = await command("--socket", str(tmp_path / "north.sock"), "status")
        assert "other sites are not shown" in output and "alpha" in output
        left.unlink()
