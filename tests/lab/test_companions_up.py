"""Ten companions on loopback sshd: `up` to ready in one command, and each that is not ready is named."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lab.ssh_hosts import SshHost, install_programs, make_key, prepare_sshd, short_folder, small_disk
from skygcs.cli.service import Installation, unit_text
from support.needed import needs
from support.process import free_port, wait_until

NAMES = ("alpha", "bravo", "carol", "delta", "echo", "fox", "golf", "hotel", "india", "juliet")
UNREACHABLE, NEW_KEY, FULL, OTHER_VERSION = "bravo", "delta", "fox", "hotel"
BROKEN = {UNREACHABLE, NEW_KEY, FULL, OTHER_VERSION}
TIMEOUT_S = "600"
"""What it may take on a slow machine; not what is tested."""

COMPANION = """
[daemon]
log_dir = "logs"
[companion]
vehicle = "{name}"
ground = "udp:127.0.0.1:{port}"
[vehicles.{name}]
sysid = {sysid}
[links.autopilot]
type = "simulated"
px4 = 1
first_sysid = {sysid}
lat_deg = 43.78{sysid:02d}
dynamics = "kinematic"
"""

GROUND = """
[daemon]
socket = "s"
log_dir = "logs"
[defaults]
group = "field"
[links.wifi]
type = "udp_server"
host = "127.0.0.1"
port = {port}
"""


class Fleet:
    """The hosts, the ground's daemon and its fleet file."""

    def __init__(self, folder: Path, full_disk: Path) -> None:
        self.folder = folder
        make_key(folder / "id")
        self.udp = free_port()
        self.hosts: dict[str, SshHost] = {}
        text = GROUND.format(port=self.udp)
        for sysid, name in enumerate(NAMES, 1):
            host = SshHost(name, folder, folder / "id", full_disk if name == FULL else None)
            self.hosts[name] = host
            install_programs(host, "0.0.9" if name == OTHER_VERSION else None)
            self._add_service(host, COMPANION.format(name=name, port=self.udp, sysid=sysid))
            text += f"[vehicles.{name}]\nsysid = {sysid}\n"
            text += f'[companions.{name}]\nhost = "127.0.0.1"\nssh_port = {host.port}\n'
        (folder / "fleet.toml").write_text(text)
        (folder / "known_hosts").write_text("".join(host.public_key() + "\n" for host in self.hosts.values()))
        with (folder / "daemon.log").open("wb") as log:
            words = [sys.executable, "-m", "skygcs", "run", str(folder / "fleet.toml")]
            self.daemon = subprocess.Popen(words, stdout=log, stderr=log, cwd=folder)
        wait_until((folder / "s").exists, "the ground's daemon is up")

    def _add_service(self, host: SshHost, text: str) -> None:
        fleet = host.home / "skygcs" / "companion.toml"
        fleet.write_text(text)
        unit = host.home / ".config" / "systemd" / "user" / "skygcs.service"
        unit.parent.mkdir(parents=True)
        program = host.home / "skygcs" / "current" / "bin" / "skygcs"
        unit.write_text(unit_text(Installation(fleet, host.home / "skygcs" / "logs", program, None)))

    def cli(self, *words: str) -> subprocess.CompletedProcess[str]:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("SKYGCS", "SSH_"))}
        environment |= {"HOME": str(self.folder), "SKYGCS_FLEET": str(self.folder / "fleet.toml")}
        environment |= {"SKYGCS_SOCKET": str(self.folder / "s")}
        cli = Path(sys.executable).with_name("skygcs-cli")
        return subprocess.run([str(cli), *words], env=environment, capture_output=True, text=True)

    def ssh(self, *words: str) -> subprocess.CompletedProcess[str]:
        return self.cli(*words, "--identity", str(self.folder / "id"), "--timeout", TIMEOUT_S)

    def json(self, *words: str) -> Any:
        done = self.ssh(*words, "--json")
        assert done.stdout, done.stderr
        return json.loads(done.stdout)

    def close(self) -> None:
        self.daemon.send_signal(signal.SIGTERM)
        for host in self.hosts.values():
            host.close()
        self.daemon.wait(60)


@pytest.fixture(scope="module")
def fleet() -> Iterator[Fleet]:
    needs("test-lab", "sshd")
    prepare_sshd()
    with short_folder() as folder, small_disk(folder / "full", 1024) as mounted:
        fleet = Fleet(folder, folder / "full")
        try:
            if not mounted:  # without the right to mount: the disk's own report
                line = "echo 'F 1024-blocks Used Available'; echo 'none 1024 1024 0'"
                fleet.hosts[FULL].add_program("df", f"#!/bin/sh\n{line}\n")
            yield fleet
        finally:
            fleet.close()


def test_up_brings_all_that_are_well_to_ready_and_names_each_other_one(fleet: Fleet) -> None:
    old = fleet.hosts[NEW_KEY].fingerprint()
    fleet.hosts[NEW_KEY].new_key()
    fleet.hosts[UNREACHABLE].stop_sshd()
    report = fleet.json("up", "--wait", TIMEOUT_S)
    vehicles = report["vehicles"]
    assert {name for name, outcome in vehicles.items() if not outcome["ok"]} == BROKEN, report
    # each with its cause
    assert "connection refused" in vehicles[UNREACHABLE]["message"]
    changed = vehicles[NEW_KEY]["message"]
    assert old in changed and fleet.hosts[NEW_KEY].fingerprint() in changed
    assert vehicles[FULL]["message"].startswith("disk: ") and "free" in vehicles[FULL]["message"]
    assert "skygcs 0.0.9 there" in vehicles[OTHER_VERSION]["message"]
    # the others went through all stages, and nothing was started on those
    for name, outcome in vehicles.items():
        assert outcome["elapsed_s"] > 0
        if name in BROKEN:
            assert not any("start" in call.split() for call in fleet.hosts[name].calls())
        else:
            assert list(outcome["stages"]) == ["reach", "version", "disk", "service", "links", "heard", "preflight"]
            assert "--user start skygcs" in fleet.hosts[name].calls()
    assert report["ok"] is False and report["ground"] == []
    print("\n" + "\n".join(f"{name:<7} {o['elapsed_s']:6.1f} s  {o['message']}" for name, o in vehicles.items()))


def test_down_stops_what_rests_and_nothing_while_a_vehicle_flies(fleet: Fleet) -> None:
    assert fleet.json("up", "alpha,carol", "--wait", TIMEOUT_S)["ok"], "they were ready, or are made ready now"
    assert fleet.json("down", "carol")["outcomes"]["carol"]["message"] == "stopped"
    wait_until(lambda: _takes_off(fleet, "alpha"), "alpha flies")
    refused = fleet.ssh("down")
    assert refused.returncode == 1
    assert "alpha: armed or in the air; nothing was stopped" in refused.stderr
    assert not any("stop" in call.split() for call in fleet.hosts["alpha"].calls())
    single = fleet.json("companions", "stop", "alpha")["outcomes"]["alpha"]
    assert not single["ok"] and "alpha is armed or in the air" in single["message"]
    forced = fleet.json("down", "--force")["outcomes"]
    assert forced["alpha"]["message"] == "stopped"
    assert forced["carol"]["message"] == "was not running"
    assert not forced[UNREACHABLE]["ok"]
    assert fleet.hosts["alpha"].calls()[-1] == "--user stop skygcs"


def _takes_off(fleet: Fleet, name: str) -> bool:
    order = fleet.cli("takeoff", name, "5")
    (state,) = json.loads(fleet.cli("status", name, "--json").stdout)
    return bool(state["armed"]) or order.returncode == 0
