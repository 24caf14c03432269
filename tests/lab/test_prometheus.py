"""A real Prometheus: promtool checks metrics, rules and queries, and the server scrapes a real daemon."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.hanging import HANG_S
from support.needed import needs
from support.process import free_port, wait_until

SCRAPES = int(os.environ.get("LAB_SCRAPES", "4"))
"""Before anything is asked: a rate needs two, and every rule is evaluated in between."""

INTERVAL = "5s"
"""A scrape has as long: it takes 10 ms, but a busy machine gives the daemon no CPU for seconds."""

FLEET = """
[daemon]
socket = "s"
token_file = "token"
[metrics]
port = {port}
token_file = "token"
[links.sim]
type = "simulated"
px4 = 2
ardupilot = 2
role = "radio"
dynamics = "kinematic"
[links.sim.radio]
air_kbps = 64
[links.gcs]
type = "udp_server"
host = "127.0.0.1"
port = {udp}
role = "gcs"
[defaults.control]
"""

PROMETHEUS = """
global: {{scrape_interval: {interval}, scrape_timeout: {interval}, evaluation_interval: {interval}}}
rule_files: [rules.yml]
scrape_configs:
  - job_name: skygcs
    authorization: {{credentials_file: token}}
    static_configs: [{{targets: ["127.0.0.1:{port}"]}}]
"""


class Lab:
    """A daemon with four simulated vehicles, and a Prometheus that scrapes it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port(socket.SOCK_STREAM)
        self.web = free_port(socket.SOCK_STREAM)
        token = folder / "token"
        token.write_text("0123456789abcdef0123\n")
        token.chmod(0o600)
        (folder / "fleet.toml").write_text(FLEET.format(port=self.port, udp=free_port()))
        (folder / "prometheus.yml").write_text(PROMETHEUS.format(interval=INTERVAL, port=self.port))
        (folder / "rules.yml").write_bytes(printed("rules"))
        with (folder / "daemon.log").open("wb") as log:
            words = [sys.executable, "-m", "skygcs", "run", str(folder / "fleet.toml")]
            self.daemon = subprocess.Popen(words, stdout=log, stderr=log, cwd=folder)
        self.prometheus: subprocess.Popen[bytes] | None = None

    def scrape(self) -> str:
        request = urllib.request.Request(
            f"http://127.0.0.1:{self.port}/metrics", headers={"Authorization": "Bearer 0123456789abcdef0123"}
        )
        with urllib.request.urlopen(request, timeout=HANG_S) as answer:
            return str(answer.read().decode())

    def start_prometheus(self) -> None:
        words = [
            needs("test-lab", "prometheus"),
            "--config.file=prometheus.yml",
            "--storage.tsdb.path=data",
            f"--web.listen-address=127.0.0.1:{self.web}",
        ]
        with (self.folder / "prometheus.log").open("wb") as log:
            self.prometheus = subprocess.Popen(words, stdout=log, stderr=log, cwd=self.folder)

    def ask(self, path: str, **query: str) -> Any:
        url = f"http://127.0.0.1:{self.web}/api/v1/{path}?{urllib.parse.urlencode(query)}"
        with urllib.request.urlopen(url, timeout=HANG_S) as answer:
            body = json.load(answer)
        assert body["status"] == "success", body
        return body["data"]

    def query(self, expression: str) -> list[Any]:
        found = self.ask("query", query=expression)["result"]
        assert isinstance(found, list)
        return found

    def close(self) -> None:
        for process in (self.prometheus, self.daemon):
            if process is not None:
                process.send_signal(signal.SIGTERM)
        for process in (self.prometheus, self.daemon):
            if process is not None:
                process.wait(30)


def printed(what: str) -> bytes:
    """As a user gets it."""
    return subprocess.run([sys.executable, "-m", "skygcs", "metrics", what], check=True, capture_output=True).stdout


def answers(lab: Lab) -> bool:
    try:
        return "skygcs_vehicles 4.0" in lab.scrape()
    except OSError:
        return False


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    needs("test-lab", "promtool")
    lab = Lab(tmp_path_factory.mktemp("prometheus"))
    try:
        wait_until(lambda: answers(lab), "the daemon shows four vehicles")
        yield lab
    finally:
        lab.close()


def test_promtool_accepts_the_metrics(lab: Lab) -> None:
    text = lab.scrape()
    check = subprocess.run(
        [needs("test-lab", "promtool"), "check", "metrics"], input=text, text=True, capture_output=True
    )
    assert (check.returncode, check.stdout, check.stderr) == (0, "", "")


def test_promtool_accepts_the_alert_rules(tmp_path: Path) -> None:
    rules = tmp_path / "rules.yml"
    rules.write_bytes(printed("rules"))
    check = subprocess.run(
        [needs("test-lab", "promtool"), "check", "rules", str(rules)], text=True, capture_output=True
    )
    assert check.returncode == 0, check.stdout + check.stderr


def test_prometheus_scrapes_the_daemon_and_answers_every_query_of_the_dashboard(lab: Lab) -> None:
    cli = str(Path(sys.executable).with_name("skygcs-cli"))
    refused = [cli, "--socket", str(lab.folder / "s"), "mode", "v1", "NO SUCH MODE"]
    assert subprocess.run(refused, capture_output=True).returncode == 1  # an order to count
    lab.start_prometheus()
    for number in range(SCRAPES):
        wait_until(lambda: _scrapes(lab) > number, f"scrape {number}")  # noqa: B023 - called at once
    assert lab.daemon.poll() is None
    # every scrape succeeded, and took all that was there
    assert lab.query("min_over_time(up[1h])")[0]["value"][1] == "1"
    (target,) = lab.ask("targets")["activeTargets"]
    assert (target["health"], target["lastError"]) == ("up", "")
    assert float(lab.query("max_over_time(skygcs_scrapes_total[1h])")[0]["value"][1]) >= SCRAPES
    # numbers are the daemon's
    assert lab.query("skygcs_vehicles_connected")[0]["value"][1] == "4"
    assert {row["metric"]["vehicle"] for row in lab.query("skygcs_vehicle_connected == 1")} == {"v1", "v2", "v3", "v4"}
    assert all(float(row["value"][1]) >= 0 for row in lab.query("resets(skygcs_link_received_frames_total[1h]) == 0"))
    # dashboard and rules
    empty = [text for text in dashboard_queries() if not lab.query(text)]
    empty = [text for text in empty if "skygcs_federation_" not in text]  # a bridge's, which tests/federation asks
    assert [text.partition("{")[0] for text in empty] == ["skygcs_control_lateness_p99_seconds"], "nothing flies"
    assert len(_rules(lab)) >= 10
    wait_until(lambda: {rule["health"] for rule in _rules(lab)} == {"ok"}, "every rule can be evaluated")
    wait_until(lambda: _alarmed(lab) <= {"SkygcsRadioBufferFull"}, "no other alert fires or is about to")
    print(f"\n{_scrapes(lab)} scrapes, {target['lastScrapeDuration']:.3f} s the last one")


def _scrapes(lab: Lab) -> int:
    """How often Prometheus has scraped; 0 before it serves."""
    try:
        counted = lab.query("count_over_time(up[1h])")
    except OSError:
        return 0
    return int(counted[0]["value"][1]) if counted else 0


def _rules(lab: Lab) -> list[Any]:
    return [rule for group in lab.ask("rules")["groups"] for rule in group["rules"]]


def _alarmed(lab: Lab) -> set[str]:
    """Alerts that fire or whose time has begun."""
    return {rule["name"] for rule in _rules(lab) if rule["state"] != "inactive"}


def dashboard_queries() -> list[str]:
    """As Grafana sends them, with all values of each list chosen."""
    dashboard = json.loads(printed("dashboard"))
    queries = [t["expr"] for panel in dashboard["panels"] for t in panel.get("targets", [])]
    return [re.sub(r"\$(job|instance|link|vehicle)\b", ".*", q.replace("$__rate_interval", "1m")) for q in queries]
