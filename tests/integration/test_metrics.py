"""A whole daemon's metrics: equal to what its own status says, parsed by Prometheus's library, bounded by the fleet."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from skygcs.config.control import ControlSettings
from skygcs.config.metrics import MetricsConfig
from skygcs.config.models import MemoryLinkConfig, VehicleSettings
from skygcs.daemon import Daemon
from skygcs.ext.metrics import Metrics
from skygcs.ext.metrics.collector import MetricsCollector
from skygcs.ext.metrics.table import METRICS
from skygcs.rpc.client import connect
from support.daemons import made_daemon, memory_link, started
from support.hosts import until
from support.routed import heartbeat

PER_VEHICLE = 11
"""Series of a vehicle that is not flown by setpoints, at most: see `Scrape.of`."""


class Scrape:
    """One answer, by name and labels."""

    def __init__(self, text: str) -> None:
        self.samples: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {}
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                key = sample.name, tuple(sorted(sample.labels.items()))
                assert key not in self.samples, f"{key} is there twice"
                self.samples[key] = sample.value

    def __call__(self, name: str, **labels: str) -> float:
        return self.samples[f"skygcs_{name}", tuple(sorted(labels.items()))]

    def of(self, name: str) -> list[dict[str, str]]:
        return [dict(labels) for n, labels in self.samples if n == f"skygcs_{name}"]


@contextlib.asynccontextmanager
async def running(tmp_path: Path, **keys: Any) -> AsyncIterator[Daemon]:
    daemon = made_daemon(
        tmp_path,
        daemon={"record": True},
        extensions={"metrics": MetricsConfig(port=0)},
        links={"radio": MemoryLinkConfig(name="radio", role="vehicle")},
        **keys,
    )
    async with started(daemon):
        yield daemon


async def scrape(daemon: Daemon) -> Scrape:
    """Over HTTP, and anew: not the answer of this second."""
    metrics = daemon.extensions["metrics"]
    assert isinstance(metrics, Metrics) and metrics.endpoint.address is not None
    metrics.endpoint._answered_at = float("-inf")
    reader, writer = await asyncio.open_connection(*metrics.endpoint.address)
    host, port = metrics.endpoint.address[:2]
    writer.write(f"GET /metrics HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    answer = await reader.read()
    writer.close()
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200"), answer[:500]
    return Scrape(body.decode())


def peer_of(daemon: Daemon) -> Any:
    return memory_link(daemon, "radio").peer


async def test_the_numbers_are_those_of_the_daemon(tmp_path: Path) -> None:
    async with running(tmp_path) as daemon, connect(tmp_path / "s") as gcs:
        peer = peer_of(daemon)
        for seq in (0, 1, 4):  # two are lost
            peer.send(heartbeat(7, seq=seq))
        peer.send(heartbeat(8)[:-1] + b"\x00")
        await until(lambda: 7 << 8 | 1 in daemon.fleet.vehicles)
        await gcs.call("vehicles.mode", targets="v7", mode="NO SUCH MODE")
        got = await scrape(daemon)
        (row,) = await gcs.call("links.list")
        (channel,) = row["channels"]
        assert got("link_up", link="radio") == 1
        assert got("link_received_frames_total", link="radio") == channel["rx_frames"] == 3
        assert got("link_crc_errors_total", link="radio") == channel["bad_crc"] == 1
        assert got("vehicle_received_frames_total", vehicle="v7", link="radio") == 3
        assert got("vehicle_lost_frames_total", vehicle="v7", link="radio") == 2
        assert got("vehicle_connected", vehicle="v7") == got("vehicles_connected") == 1
        assert got("orders_total", order="mode", result="refused") == 1
        assert got("rpc_requests_total") >= 1
        assert got("recorder_up") == 1
        assert got("internal_faults_total") == 0
        named = {name for name, _ in got.samples if name.startswith("skygcs_")}
        assert named <= METRICS.keys(), named - METRICS.keys()
        assert ("process_resident_memory_bytes", ()) in got.samples


async def test_counters_of_a_link_survive_its_channels(tmp_path: Path) -> None:
    async with running(tmp_path) as daemon:
        peer_of(daemon).send(heartbeat(7))
        await until(lambda: daemon.hub.statistics.link_totals("radio")["rx_frames"] == 1)
        before = await scrape(daemon)
        await daemon.links.change("radio", {"role": "gcs"})
        await until(lambda: daemon.links.status()[0]["state"] == "up")
        peer_of(daemon).send(heartbeat(7))
        await until(lambda: daemon.hub.statistics.link_totals("radio")["rx_frames"] == 2)
        after = await scrape(daemon)
        for name in ("link_received_frames_total", "link_received_bytes_total", "link_sent_frames_total"):
            assert after(name, link="radio") >= before(name, link="radio"), name
        assert after("link_received_frames_total", link="radio") == 2


@pytest.mark.deep
async def test_series_of_250_vehicles_are_bounded_and_each_turn_of_the_loop_is_short(tmp_path: Path) -> None:
    async with running(tmp_path) as daemon:
        peer = peer_of(daemon)
        empty = len((await scrape(daemon)).samples)
        for sysid in range(1, 251):
            peer.send(heartbeat(sysid))
        await until(lambda: len(daemon.fleet.vehicles) == 250)
        got = await scrape(daemon)
        assert len(got.samples) <= empty + 250 * PER_VEHICLE + 20
        assert got("series_dropped") == 0
        assert got("series") == sum(name.startswith("skygcs_") for name, _ in got.samples)
        metrics = daemon.extensions["metrics"]
        assert isinstance(metrics, Metrics) and isinstance(metrics.endpoint._collector, MetricsCollector)
        turns = sum(1 for _ in metrics.endpoint._collector._turns())
        assert turns > 250 / 10 + len(got.samples) / 50  # it yields after each slice


async def test_vehicles_planned_for_control_have_its_counters_from_the_start(tmp_path: Path) -> None:
    async with running(tmp_path, defaults=VehicleSettings(control=ControlSettings())) as daemon:
        peer_of(daemon).send(heartbeat(7))
        await until(lambda: 7 << 8 | 1 in daemon.fleet.vehicles)
        got = await scrape(daemon)
        falls = got.of("guard_falls_total")
        assert {row["to"] for row in falls} == {"velocity", "position", "hold", "release"}
        assert got("control_ticks_total", vehicle="v7") == 0


async def test_names_that_others_make_up_are_no_series(tmp_path: Path) -> None:
    """Sources that are no vehicles, and vehicles that come and go."""
    async with running(tmp_path) as daemon:
        before = len((await scrape(daemon)).samples)
        peer = peer_of(daemon)
        for compid in range(2, 200):
            peer.send(heartbeat(9, compid, gcs=True))
        await until(lambda: daemon.hub.statistics.link_totals("radio")["rx_frames"] >= 198)
        assert len((await scrape(daemon)).samples) <= before + 5
