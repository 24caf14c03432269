"""Vehicles of two sites that come near each other: both sites and an observer hear of it, over a real hub."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from skygcs.rpc.client_connection import Subscription
from support.fake_daemon import FakeDaemon
from support.federated import site
from support.hanging import HANG_S
from support.hub import Hub

ONE_PLACE = {"vehicles": {"bravo": {"home": "north"}}}
"""Both sites hear bravo: it is one vehicle."""


async def conflicts_of(events: Subscription) -> AsyncIterator[dict[str, Any]]:
    async for event in events:
        if event["kind"] == "separation" and "site" in event["data"]:
            yield event


async def test_a_conflict_across_sites_is_an_event_everywhere_and_in_the_list_of_sites(
    hub: Hub, tmp_path: Path
) -> None:
    north, south = FakeDaemon(2), FakeDaemon(2)
    for daemon in (north, south):  # vehicles of one number are at one place
        daemon.vehicle("alpha").armed = daemon.vehicle("bravo").armed = True
    async with (
        site(hub, "visitor", tmp_path, role="observer") as c,
        c.client() as visitor,
        site(hub, "north", tmp_path, daemon=north) as a,
        a.client() as at_north,
    ):
        # both listen before the other site comes: it is an event once
        listening = [asyncio.create_task(anext(conflicts_of(gcs.events("*/all")))) for gcs in (visitor, at_north)]
        await asyncio.sleep(0.5)
        async with site(hub, "south", tmp_path, daemon=south) as b, b.client() as at_south, asyncio.timeout(HANG_S):
            seen, at_home = await asyncio.gather(*listening)
            assert seen["site"] in ("north", "south")
            found: set[tuple[str, ...]] = set()
            while len(found) < 2:
                sites = await at_south.call("federation.sites")
                found = {tuple(conflict["vehicles"]) for conflict in sites["conflicts"]}
                await asyncio.sleep(0.05)
            status = a.process.status()["parts"]["conflicts"]
        assert set(seen["data"]["vehicles"]) < {"alpha", "bravo", "north/alpha", "north/bravo", "south/alpha"} | {
            "south/bravo"
        }
        assert at_home["data"]["level"] in ("notice", "warning") and len(at_home["data"]["ages_s"]) == 2
        assert found == {("alpha", "north/alpha"), ("bravo", "north/bravo")}
        conflict = sites["conflicts"][0]
        assert conflict["level"] == "warning" and conflict["closest_m"] < conflict["margin_m"]
        assert status["conflicts"] == 2 and status["watched"] == 2


async def test_a_vehicle_that_two_sites_hear_is_in_no_conflict_with_itself(hub: Hub, tmp_path: Path) -> None:
    """Named in [federation.vehicles] of one of them it is one vehicle there; another of the same name is not."""
    from skygcs.config.models import FleetConfig
    from skygcs.ext.federation.bridge.conflict_watch import ConflictWatch
    from skygcs.ext.federation.config import FederationConfig
    from skygcs.ext.federation.extension import Federation

    north, south = FakeDaemon(2), FakeDaemon(2)
    for daemon in (north, south):
        daemon.vehicle("alpha").armed = daemon.vehicle("bravo").armed = True
    async with site(hub, "north", tmp_path, daemon=north) as a, site(hub, "south", tmp_path, daemon=south):
        watch = a.process.parts["conflicts"]
        assert isinstance(watch, ConflictWatch)
        table = {"servers": [hub.url], "nkey": "n.nk", "site": "north", **ONE_PLACE}
        vehicles = {"alpha": {"sysid": 1}, "bravo": {"sysid": 2}}
        fleet = FleetConfig.model_validate({"vehicles": vehicles})
        fleet = Federation.applied(FederationConfig.model_validate(table), fleet)
        again = ConflictWatch(fleet, watch._own, watch._sites, watch._clock, watch._send)
        async with asyncio.timeout(HANG_S):
            while not again.described():
                await again.evaluate()
                await asyncio.sleep(0.2)
        assert [conflict["vehicles"] for conflict in again.described()] == [["alpha", "south/alpha"]]
