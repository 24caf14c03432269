"""Leases over a real hub, real daemons and bridges: what arrives at one vehicle that two sites hear."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from bench.federation.leases import killed, stopped, without_hub
from skygcs.errors import RpcError
from skygcs.ext.federation.bridge.hub_config import LEASES
from skygcs.ext.federation.protocol.lease import TTL_S
from support.hub import Hub, RawClient, until
from support.lease_races import USERS, Racer, race
from support.process import DaemonProcess
from support.sharing_sites import Flight, home_with_flight, sharing_sites


async def test_two_sites_that_want_a_lease_at_once_never_both_get_it(tmp_path: Path) -> None:
    hub = Hub(tmp_path, USERS)
    await hub.start()
    try:
        found = await race(hub, 2, 30)
    finally:
        hub.process.stop()
    assert found["winners"] == {"1": 60}


async def test_a_store_that_forgets_keys_while_their_holders_send_is_not_used(hub: Hub) -> None:
    async with hub.raw(hub.witness) as admin, hub.bus("north") as bus:
        await admin.jetstream().delete_stream(f"KV_{LEASES}")
        await admin.jetstream().create_key_value(bucket=LEASES, ttl=1.0)
        north = Racer("north", bus, ["alpha"])
        running = asyncio.create_task(north.leases.run())
        try:
            await until(lambda: north.leases.problem is not None, "the store is looked at")
            assert "keeps keys for 1 s, not 3 s" in str(north.leases.problem)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)


async def test_a_store_that_is_made_again_under_live_connections_takes_nothing_from_who_holds_it(
    tmp_path: Path,
) -> None:
    hub = Hub(tmp_path, USERS)
    await hub.start()
    try:
        async with hub.raw(hub.witness) as admin, hub.bus("north") as north_bus, hub.bus("south") as south_bus:
            await made_again(admin, Racer("north", north_bus, ["alpha"]), Racer("south", south_bus, ["alpha"]))
    finally:
        hub.process.stop()


async def made_again(admin: RawClient, north: Racer, south: Racer) -> None:
    running = [asyncio.create_task(racer.leases.run()) for racer in (north, south)]
    try:
        await until(lambda: north.has_hub() and south.has_hub(), "the parts run, and know the hub")
        await north.call("federation.take", "alpha")
        before = north.link.gate.status_of(0, 0.0)
        await admin.jetstream().delete_stream(f"KV_{LEASES}")
        await admin.jetstream().create_key_value(bucket=LEASES, ttl=TTL_S)
        taking = asyncio.create_task(south.call("federation.take", "alpha"))
        held = set()
        while not taking.done():
            held.add((bool(north.link.held()), bool(south.link.held())))
            await asyncio.sleep(0.01)
        with pytest.raises(RpcError, match="flown by setpoints of north"):
            await taking
        after = north.link.gate.status_of(0, 0.0)
        assert before is not None and after is not None
        assert (held, after["hub"] != before["hub"]) == ({(True, False)}, True)
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


async def test_the_holder_is_killed_and_the_other_site_takes_over(hub: Hub, tmp_path: Path) -> None:
    def fly() -> None:
        with sharing_sites(hub, tmp_path) as sites:
            assert not sites.sends("south"), "it hears the vehicle and its client orders it, but it does not hold it"
            assert killed(sites)["frames_after_ttl"] == 0
            assert sites.sends("north")[-1].at_s < sites.sends("south")[0].at_s

    await asyncio.to_thread(fly)


@pytest.mark.parametrize("part", ["daemon", "bridge", "both"])
async def test_what_was_stopped_past_the_ttl_sends_nothing_when_it_goes_on(part: str, hub: Hub, tmp_path: Path) -> None:
    def fly() -> None:
        with sharing_sites(hub, tmp_path) as sites:
            found = stopped(sites, part)
            assert found["frames_after_ttl"] == 0
            assert found["frames_of_south_after"] > 0
            assert sites.holder() == "south"

    await asyncio.to_thread(fly)


async def test_the_home_flies_on_while_its_hub_dies_restarts_and_is_replaced(hub: Hub, tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, home_with_flight(hub), name="north") as north:
        flight = Flight(north)
        await asyncio.to_thread(flight.begin)
        found = await without_hub(hub, flight, each_s=4.0)
    assert found["dead"]["lease"] == "alone"
