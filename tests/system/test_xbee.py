"""The daemon on an emulated XBee network, and the set-up commands at its port, each a real process."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.hanging import HANG_S
from support.process import DaemonProcess, cli_at, wait_until

pytestmark = pytest.mark.system

BIN = Path(sys.executable).parent


@contextmanager
def network(port: Path, *options: str, air: str = "200,loss=0.1") -> Iterator[subprocess.Popen[bytes]]:
    """`skygcs sim --xbee` at this port; ended by id."""
    words = [BIN / "skygcs", "sim", "--pty", str(port), "--xbee", air, *options]
    with port.with_suffix(".log").open("ab") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log)
    try:
        wait_until(port.exists, "the emulated network is there")
        yield process
    finally:
        process.terminate()
        process.wait(timeout=HANG_S)


def test_vehicles_behind_xbee_are_flown_and_come_back_after_the_module_was_pulled_out(tmp_path: Path) -> None:
    port = tmp_path / "ttyXBEE"
    toml = f'[links.mesh]\ntype = "xbee"\ndevice = "{port}"\n'
    with DaemonProcess(tmp_path, toml) as daemon:
        with network(port, "--px4", "1", "--ardupilot", "2"):
            wait_until(lambda: len(daemon.vehicles()) == 3, "three vehicles are heard")
            assert " ok " in f" {cli_at(daemon.socket, 'arm', 'all', '--wait', '60')}"
            takeoff = cli_at(daemon.socket, "takeoff", "all", "5")
            assert takeoff.count("ok ") == 3, takeoff
            wait_until(lambda: all(v["landed"] == "in_air" for v in daemon.vehicles().values()), "all fly")
            stopped = cli_at(daemon.socket, "stop", "all")
            assert stopped.count("ok ") == 3, stopped
            (link,) = daemon.call("links.list")
            assert {len(c["sources"]) for c in link["channels"]} == {1}, "each node brings its own vehicle alone"
            assert all(c["node"]["failed"] == 0 for c in link["channels"])
        wait_until(lambda: daemon.call("links.list")[0]["state"] == "down", "the module is gone")
        # `last_error` may be that of the next attempt already
        losses = [e["text"] for e in daemon.call("events.recent", limit=1000) if e["kind"] == "link_down"]
        assert "unplugged" in losses[-1], losses
        with network(port, "--px4", "1", "--ardupilot", "2"):
            wait_until(lambda: len(daemon.call("links.list")[0]["channels"]) == 3, "all nodes are back")


def test_a_module_and_its_nodes_are_shown_and_set_while_the_daemon_lends_the_port(tmp_path: Path) -> None:
    port = tmp_path / "ttyXBEE"
    toml = f'[links.mesh]\ntype = "xbee"\ndevice = "{port}"\n'
    with network(port, "--px4", "2", "--ardupilot", "0", air="200"), DaemonProcess(tmp_path, toml) as daemon:
        wait_until(lambda: len(daemon.vehicles()) == 2, "two vehicles are heard")
        told = cli_at(daemon.socket, "xbee", "discover", port, "--wait", "2")
        nodes = re.findall(r"^([0-9A-F]{16})  (\w+)$", told, re.MULTILINE)
        assert [name for _, name in nodes] == ["vehicle1", "vehicle2"] and "mesh: open again" in told
        told = cli_at(daemon.socket, "xbee", "set", port, "NI=base", "RR=3")
        assert "NI  ground -> base" in told and "RR  10 -> 3" in told
        address = nodes[1][0]
        assert "NI  vehicle2 -> bravo" in cli_at(daemon.socket, "xbee", "set", port, "--node", address, "NI=bravo")
        assert re.search("^NI +bravo", cli_at(daemon.socket, "xbee", "show", port, "--node", address), re.MULTILINE)
        assert "out of reach" in cli_at(daemon.socket, "xbee", "set", port, "--node", address, "ID=9", code=1)
        assert "can only be read" in cli_at(daemon.socket, "xbee", "set", port, "NP=72", code=2)
        wait_until(lambda: daemon.call("links.list")[0]["state"] == "up", "the daemon has its port again")


class TransparentModule:
    """A module as it is delivered, at a pty: transparent, and with the command mode behind +++."""

    def __init__(self, path: Path) -> None:
        self.registers = {"AP": "0", "BD": "3", "ID": "7FFF", "NI": " ", "D7": "1", "EE": "0"}
        self.saved: dict[str, str] = {}
        self.refuses = ""
        self.left = False
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        path.symlink_to(os.ttyname(self._slave))
        self._thread = threading.Thread(target=self._serve, name="transparent module", daemon=True)
        self._thread.start()

    def close(self) -> None:
        os.close(self._slave)
        self._thread.join(timeout=10)
        os.close(self._master)

    def _serve(self) -> None:
        heard = b""
        command_mode = False
        while True:
            try:
                heard += os.read(self._master, 256)
            except OSError:
                return
            if not command_mode and heard.endswith(b"+++"):
                command_mode, heard = True, b""
                os.write(self._master, b"OK\r")
            while command_mode and b"\r" in heard:
                line, _, heard = heard.partition(b"\r")
                os.write(self._master, self._answer(line.decode()) + b"\r")
                if line == b"ATCN":
                    command_mode, self.left = False, True

    def _answer(self, line: str) -> bytes:
        name, value = line[2:4], line[4:]
        if name == "WR":
            self.saved = dict(self.registers)
        if name in ("WR", "CN", "AC"):
            return b"OK"
        if name not in self.registers or (value and name == self.refuses):
            return b"ERROR"
        if not value:
            return self.registers[name].encode()
        self.registers[name] = value
        return b"OK"


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[TransparentModule]:
    module = TransparentModule(tmp_path / "ttyNEW")
    yield module
    module.close()


def test_a_module_as_delivered_is_read_and_given_api_mode(tmp_path: Path, fresh: TransparentModule) -> None:
    port, nobody = tmp_path / "ttyNEW", tmp_path / "nobody.sock"
    told = cli_at(nobody, "xbee", "show", port, "--baud", "9600")
    assert "9600 baud, transparent" in told and "AP is 0" in told and fresh.left
    told = cli_at(nobody, "xbee", "set", port, "--baud", "9600", "AP=2", "BD=115200", "NI=ground")
    assert "AP  0 -> 2" in told and "BD  9600 -> 115200" in told
    assert (fresh.saved["AP"], fresh.saved["BD"], fresh.saved["NI"]) == ("2", "7", "ground")


def test_a_refused_setting_puts_back_what_was_written_before(tmp_path: Path, fresh: TransparentModule) -> None:
    fresh.refuses = "BD"
    port, nobody = tmp_path / "ttyNEW", tmp_path / "nobody.sock"
    told = cli_at(nobody, "xbee", "set", port, "--baud", "9600", "BD=115200", "ID=0x22", code=1)
    assert "BD: bad value" in told and "what was written was put back" in told
    assert fresh.registers["ID"] == "7FFF" and fresh.saved == {} and fresh.left


def test_a_port_without_a_module_is_named(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    try:
        told = cli_at(tmp_path / "nobody.sock", "xbee", "show", os.ttyname(slave), "--baud", "9600", code=1)
    finally:
        os.close(master)
        os.close(slave)
    assert "no XBee module answers, neither in API mode nor to +++ (9600 baud)" in told
