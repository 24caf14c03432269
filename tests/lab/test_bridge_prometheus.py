"""A real Prometheus scrapes a bridge: it has the bridge's numbers, and the alert rules of the federation are loaded."""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import subprocess
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from lab.test_prometheus import printed
from skygcs.errors import SkygcsError
from skygcs.ext.federation.server_program import find_server
from support.fake_daemon import FakeDaemon
from support.federated import site
from support.hanging import HANG_S
from support.hub import Hub, until
from support.needed import needs
from support.process import free_port

INTERVAL = "1s"
CONFIG = """
global: {{scrape_interval: {interval}, scrape_timeout: {interval}, evaluation_interval: {interval}}}
rule_files: [rules.yml]
scrape_configs:
  - job_name: skygcs-federation
    static_configs: [{{targets: ["127.0.0.1:{port}"]}}]
"""


class Prometheus:
    """The server, in a folder of its own."""

    def __init__(self, folder: Path, port: int) -> None:
        self.web = free_port(socket.SOCK_STREAM)
        folder.mkdir()
        (folder / "prometheus.yml").write_text(CONFIG.format(interval=INTERVAL, port=port))
        (folder / "rules.yml").write_bytes(printed("rules"))
        words = [
            needs("test-lab", "prometheus"),
            "--config.file=prometheus.yml",
            "--storage.tsdb.path=data",
            f"--web.listen-address=127.0.0.1:{self.web}",
        ]
        with (folder / "prometheus.log").open("wb") as log:
            self.process = subprocess.Popen(words, stdout=log, stderr=log, cwd=folder)

    async def ask(self, path: str, **query: str) -> Any:
        url = f"http://127.0.0.1:{self.web}/api/v1/{path}?{urllib.parse.urlencode(query)}"
        return await asyncio.to_thread(_data, url)

    async def value(self, expression: str) -> float | None:
        """Of the one series that it gives; None: there is none yet, or no server."""
        try:
            found = (await self.ask("query", query=expression))["result"]
        except OSError:
            return None
        return float(found[0]["value"][1]) if len(found) == 1 else None

    async def becomes(self, expression: str, wanted: float) -> None:
        """Return when it has this value."""
        async with asyncio.timeout(HANG_S):
            while await self.value(expression) != wanted:  # noqa: ASYNC110 - it signals nothing
                await asyncio.sleep(0.2)


def _data(url: str) -> Any:
    with urllib.request.urlopen(url, timeout=HANG_S) as answer:
        return json.load(answer)["data"]


async def test_prometheus_has_the_numbers_of_a_bridge_and_the_alerts(tmp_path: Path) -> None:
    try:
        find_server()
    except SkygcsError as error:
        pytest.skip(str(error))
    needs("test-lab", "prometheus")
    hub = Hub(tmp_path)
    await hub.start()
    south = FakeDaemon(3)
    south.vehicle("bravo").armed = True
    port = free_port(socket.SOCK_STREAM)
    name = "skygcs_federation_"
    try:
        async with (
            site(hub, "north", tmp_path, daemon=FakeDaemon(1), metrics={"port": port}) as north,
            site(hub, "south", tmp_path, daemon=south),
            north.client() as gcs,
        ):
            await until(lambda: north.process.parts["metrics"].status()["address"], "the address is there")
            prometheus = Prometheus(tmp_path / "prometheus", port)
            try:
                await prometheus.becomes(name + 'site_vehicles_heard{site="south"}', 3.0)
                assert (await gcs.land("south/alpha"))["south/alpha"]["ok"]
                await prometheus.becomes(name + 'orders_sent_total{status="done"}', 1.0)
                # what the bridge shows does not change any more
                (seen,) = (await gcs.call("federation.sites"))["sites"]
                for metric, key in (
                    ("vehicles", "count"),
                    ("vehicles_armed", "armed"),
                    ("vehicles_in_air", "in_the_air"),
                ):
                    assert await prometheus.value(f"{name}site_{metric}") == seen["vehicles"][key], metric
                assert await prometheus.value(name + "site_silent") == 0.0
                assert await prometheus.value(name + "hub_connected") == 1.0
                assert await prometheus.value(name + "shared_vehicles") == 1.0
                (target,) = (await prometheus.ask("targets"))["activeTargets"]
                assert (target["health"], target["lastError"]) == ("up", "")
                rules = [rule for group in (await prometheus.ask("rules"))["groups"] for rule in group["rules"]]
                ours = {rule["name"]: rule for rule in rules if "federation" in rule["query"]}
                assert len(ours) == 6 and {rule["type"] for rule in ours.values()} == {"alerting"}
                await prometheus.becomes('count(ALERTS{alertstate="firing"}) or vector(0)', 0.0)
                # the hub goes: the alert that names it is pending or fires
                hub.kill()
                await prometheus.becomes(name + "hub_connected", 0.0)
                query = 'count(ALERTS{alertname="%s"})'
                (away,) = [n for n, rule in ours.items() if "hub_connected" in rule["query"]]
                await prometheus.becomes(query % away, 1.0)
                rules = [rule for group in (await prometheus.ask("rules"))["groups"] for rule in group["rules"]]
                assert {r["health"] for r in rules} == {"ok"}, [r.get("lastError") for r in rules]
            finally:
                prometheus.process.send_signal(signal.SIGTERM)
                await asyncio.to_thread(prometheus.process.wait, 30)
    finally:
        hub.kill()
