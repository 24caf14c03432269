"""Two bridges under one site name at a real hub: one acts, the other stands by and says so."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import signal
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RpcError
from skygcs.ext.federation.bridge.process import ONE_BRIDGE
from skygcs.ext.federation.protocol import bridge_election
from skygcs.rpc.client import Client
from support.fake_daemon import FakeDaemon
from support.federated import Site, site
from support.hanging import HANG_S
from support.hub import Hub, until
from support.process import DaemonProcess, wait_until


def state(station: Site) -> str:
    return str(station.process.parts[ONE_BRIDGE].status()["state"])


def other(station: Site) -> Any:
    return station.process.parts[ONE_BRIDGE].status()["other"]


async def hears(gcs: Client, name: str) -> None:
    """Until the station knows this vehicle of another site."""
    while name not in {found["name"] for found in await gcs.vehicles("*/all")}:  # noqa: ASYNC110 - it signals nothing
        await asyncio.sleep(0.05)


def warned(station: Site) -> list[str]:
    """What was said of bridges."""
    return [event.text for event in station.process.report.recent if event.data.get("change") == "bridge"]


@contextlib.asynccontextmanager
async def two(hub: Hub, folder: Path) -> AsyncIterator[tuple[Site, Site, FakeDaemon, FakeDaemon]]:
    """South, and the same once more on another computer."""
    south, twin = FakeDaemon(1), FakeDaemon(1)
    (folder / "twin").mkdir()
    async with site(hub, "south", folder, daemon=south) as first:
        await until(lambda: state(first) == "active", "the first one acts")
        async with site(hub, "south", folder / "twin", daemon=twin) as second:
            await until(lambda: state(second) == "standby", "the second one stands by")
            await until(lambda: (other(first) or {}).get("state") == "standby", "the first one knows it")
            yield first, second, south, twin


def given(daemon: FakeDaemon, name: str) -> list[str]:
    return [method for method, _ in daemon.vehicle(name).orders]


async def test_the_second_bridge_of_a_site_stands_by_and_both_say_so(hub: Hub, tmp_path: Path) -> None:
    async with two(hub, tmp_path) as (first, second, south, twin):
        (text,) = warned(second)
        assert "another bridge (host " in text and "acts as south, so this one stands by: end one of the two" in text
        (text,) = warned(first)
        assert "was started as south, too, and stands by: end it" in text
        async with first.client() as a, second.client() as b:
            assert (await a.call("federation.sites"))["bridge"]["other"]["state"] == "standby"
            assert (await b.call("federation.sites"))["bridge"]["state"] == "standby"
        async with site(hub, "boss", tmp_path, role="operator") as c, c.client() as boss:
            await hears(boss, "south/alpha")
            assert (await boss.land("south/alpha"))["south/alpha"]["ok"]
            await boss.call("vehicles.stop", targets="south/alpha", action="land")
            sites = (await boss.call("federation.sites"))["sites"]
            assert [(found["site"], found["contested"], found["restarts"]) for found in sites] == [("south", False, 0)]
        assert len(given(south, "alpha")) == 2 and given(twin, "alpha") == []


async def test_a_bridge_that_stands_by_says_which_one_to_ask_for_a_vehicle(hub: Hub, tmp_path: Path) -> None:
    shared = {"vehicles": {"alpha": {"home": "south"}}}
    (tmp_path / "twin").mkdir()
    async with site(hub, "south", tmp_path, daemon=FakeDaemon(1), **shared) as first:
        await until(lambda: state(first) == "active", "the first one acts")
        async with site(hub, "south", tmp_path / "twin", daemon=FakeDaemon(1), **shared) as second:
            await until(lambda: state(second) == "standby" and other(second), "the second one stands by")
            async with second.client() as gcs:
                which = rf"alpha: another bridge of south \(host .+, process {os.getpid()}\) leads"
                with pytest.raises(RpcError, match=which):
                    await gcs.call("federation.take", vehicle="alpha")


async def test_a_bridge_that_was_killed_is_back_although_another_stands_by(
    hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is back before the other one would take over, however long a busy machine takes to start it."""
    monkeypatch.setattr(bridge_election, "TAKE_OVER_S", HANG_S)
    table = f'[federation]\nsite = "south"\nservers = ["{hub.url}"]\nnkey = "{hub.key_file("south")}"\n'
    (tmp_path / "first").mkdir()
    with DaemonProcess(tmp_path / "first", table) as first:

        def bridge() -> Any:
            answer = first.cli("federation", "sites", "--json")
            return json.loads(answer.stdout)["bridge"] if answer.returncode == 0 else {"state": answer.stderr}

        await asyncio.to_thread(wait_until, lambda: bridge()["state"] == "active", "the first one acts")
        pid = first.call("daemon.info")["federation"]["pid"]  # none before the bridge is started
        async with site(hub, "south", tmp_path, daemon=FakeDaemon(1)) as second:
            await until(lambda: state(second) == "standby", "the second one stands by")
            os.kill(pid, signal.SIGKILL)
            await asyncio.to_thread(wait_until, lambda: bridge()["state"] == "active", "it is back and acts")
            assert first.call("daemon.info")["federation"]["restarts"] == 1
            assert state(second) == "standby" and len(warned(second)) <= 2, warned(second)


async def test_one_goes_on_after_both_acted_at_two_hubs(hub: Hub, tmp_path: Path) -> None:
    """As two sides of a network that was cut: each has a hub of its own, and then the same one."""
    (tmp_path / "other").mkdir()
    for name in hub.users:
        shutil.copy(hub.key_file(name), tmp_path / "other")
    other_hub = Hub(tmp_path / "other")
    await other_hub.start()
    async with site(hub, "south", tmp_path, daemon=FakeDaemon(1)) as first:
        try:
            await until(lambda: state(first) == "active", "the first one acts")
            servers = [other_hub.url, hub.url]
            twin = site(other_hub, "south", tmp_path / "other", daemon=FakeDaemon(1), servers=servers)
            async with twin as second:
                await until(lambda: state(second) == "active", "so does the second one, elsewhere")
                await other_hub.stop()
                await until(lambda: state(second) == "standby", "it finds the first one and stands by")
                await until(lambda: other(first), "which has heard it")
                assert state(first) == "active"
        finally:
            await other_hub.stop()
