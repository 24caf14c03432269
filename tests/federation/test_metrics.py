"""The bridge's numbers at a real address: equal to what federation.sites says, in Prometheus's own words."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from skygcs.ext.federation.bridge.metrics import METRICS
from support.fake_daemon import FakeDaemon
from support.federated import Site, site
from support.hub import Hub, until


async def scraped(station: Site) -> dict[tuple[str, str | None], float]:
    """Values by name, and by the label that a site or a status is."""
    await until(lambda: station.process.parts["metrics"].status()["address"], "the address is there")
    host, port = station.process.parts["metrics"].status()["address"][:2]
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(f"GET /metrics HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    assert head.startswith(b"HTTP/1.1 200")
    found = {}
    for family in text_string_to_metric_families(body.decode()):
        for sample in family.samples:
            if sample.name.startswith("skygcs_"):
                assert sample.name in METRICS and set(sample.labels) == set(METRICS[sample.name].labels)
                found[sample.name, next(iter(sample.labels.values()), None)] = sample.value
    return found


def heard(view: Any) -> int:
    return sum(site["vehicles"]["heard"] for site in view._sites.sites(view._clock.now_s()) if site["site"] == "south")


async def test_a_station_s_numbers_are_those_of_its_sites_hub_and_orders(hub: Hub, tmp_path: Path) -> None:
    south = FakeDaemon(3)
    south.vehicle("bravo").armed = True
    async with (
        site(hub, "north", tmp_path, daemon=FakeDaemon(1), metrics={"port": 0}) as a,
        site(hub, "south", tmp_path, daemon=south),
        site(hub, "visitor", tmp_path, role="observer", metrics={"port": 0}) as visitor,
        a.client() as gcs,
    ):
        for station in (a, visitor):  # each knows the site's clock by then, and so the age of its states
            await until(lambda view=station.process.parts["station socket"]: heard(view) == 3, "the site is heard")
        ok = False
        while not ok:  # an order has a deadline, which a busy computer may miss
            (outcome,) = (await gcs.call("vehicles.land", targets="south/alpha"))["outcomes"].values()
            ok = outcome["ok"]
        found = await scraped(a)
        name = "skygcs_federation_"
        assert found[name + "hub_connected", None] == 1 and found[name + "daemon_connected", None] == 1
        assert found[name + "site_vehicles", "south"] == found[name + "site_vehicles_heard", "south"] == 3
        assert found[name + "site_vehicles_armed", "south"] == 1 and found[name + "site_silent", "south"] == 0
        assert 0 <= found[name + "site_age_seconds", "south"] < 5
        assert found[name + "orders_sent_total", "done"] == 1
        assert found[name + "batches_sent_total", "fast"] > 0 and found[name + "shared_vehicles", None] == 1
        other = await scraped(visitor)
        assert other[name + "sites", None] == 2 and (name + "daemon_connected", None) not in other
