"""The programs themselves: `skygcs federation up`, `skygcs run` with [federation], `skygcs federation run`."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.federation.bridge.process import cancelled
from support.certificates import Authority
from support.hanging import HANG_S
from support.hub import Hub
from support.process import DaemonProcess, free_port, wait_until

SIM = """
[links.sim]
type = "simulated"
px4 = 1
ardupilot = 0
[vehicles.alpha]
sysid = 1
"""


def federation(*words: str, **options: Any) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", "skygcs", "federation", *words]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options)


def ended(process: subprocess.Popen[str]) -> str:
    """What it wrote until its end."""
    return process.communicate(timeout=HANG_S)[0]


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.fixture
def inventory(tmp_path: Path) -> Iterator[int]:
    """A folder for `federation up`; the port."""
    port = free_port(socket.SOCK_STREAM)
    users = "".join(
        f'[users.{name}]\nrole = "{role}"\nnkey_file = "{name}.nk"\n'
        for name, role in (("north", "site"), ("visitor", "observer"))
    )
    (tmp_path / "hub.toml").write_text(f'listen = "127.0.0.1:{port}"\n{users}')
    yield port


def test_the_hub_of_a_try_out_serves_a_site_and_an_observer_and_ends_with_its_program(
    inventory: int, tmp_path: Path
) -> None:
    hub = federation("up", str(tmp_path))
    try:
        assert hub.stdout is not None
        first = hub.stdout.readline()
        line = hub.stdout.readline() if first.startswith("warning") else first
        assert f"the hub is up at nats://127.0.0.1:{inventory}" in line and "north, visitor" in line
        assert (tmp_path / "north.nk").stat().st_mode & 0o777 == 0o600
        table = f'[federation]\nsite = "north"\nservers = ["nats://127.0.0.1:{inventory}"]\nnkey = "north.nk"\n'
        with DaemonProcess(tmp_path, table + SIM) as north:
            wait_until(lambda: "federation: connected to nats" in north.stderr, "the site is connected")
            child = north.call("daemon.info")["federation"]
            assert (child["site"], child["role"], child["running"]) == ("north", "site", True)
            os.kill(child["pid"], signal.SIGKILL)
            wait_until(lambda: north.stderr.count("federation: connected to nats") == 2, "the bridge is back")
            again = north.call("daemon.info")["federation"]
            assert again["restarts"] == 1 and again["pid"] != child["pid"]
        wait_until(lambda: not Path(f"/proc/{again['pid']}").exists(), "the bridge ends with its daemon")

        (tmp_path / "visitor.toml").write_text(
            f'[federation]\nrole = "observer"\nservers = ["nats://127.0.0.1:{inventory}"]\nnkey = "visitor.nk"\n'
        )
        visitor = federation("run", "--no-daemon", str(tmp_path / "visitor.toml"))
        assert visitor.stdout is not None
        seen = ""
        while "federation: connected to nats" not in seen:
            seen += visitor.stdout.readline() or pytest.fail(f"it has ended: {seen}")
        visitor.send_signal(signal.SIGTERM)
        ended(visitor)
        assert visitor.returncode == 0
        (server,) = children(hub.pid)
    finally:
        hub.kill()  # not even in order
        ended(hub)
    wait_until(lambda: not Path(f"/proc/{server}").exists(), "nats-server ends with it")


async def test_a_daemon_that_is_killed_leaves_no_bridge(hub: Hub, tmp_path: Path) -> None:
    table = f'[federation]\nsite = "north"\nservers = ["{hub.url}"]\nnkey = "{hub.key_file("north")}"\n'
    daemon = DaemonProcess(tmp_path, table + SIM)
    daemon.start()
    pid = wait_until(lambda: daemon.call("daemon.info")["federation"]["pid"], "the bridge is started")
    daemon.kill()
    wait_until(lambda: not Path(f"/proc/{pid}").exists(), "the bridge notices that its daemon is gone")


async def test_the_command_line_shows_the_other_sites_and_a_hub_that_is_away(hub: Hub, tmp_path: Path) -> None:
    def site(name: str) -> DaemonProcess:
        table = f'[federation]\nsite = "{name}"\nservers = ["{hub.url}"]\nnkey = "{hub.key_file(name)}"\n'
        (tmp_path / name).mkdir()
        return DaemonProcess(tmp_path / name, table + SIM)

    def shown(station: DaemonProcess) -> str:
        return station.cli("federation", "sites").stdout

    with site("north") as north, site("south") as south:
        wait_until(lambda: "1 vehicle: 1 heard" in shown(north), "north sees south's vehicle")
        lines = shown(north).splitlines()
        assert re.match(rf"site north  connected to {hub.url} for .*, \d+ ms there and back$", lines[0])
        assert re.match(
            r"south  \d+\.\d s old, clock within \d+ ms  1 vehicle: 1 heard, 0 armed, 0 in the air", lines[1]
        )
        south.stop()
        wait_until(lambda: "south  SILENT, " in shown(north), "a site that has gone is silent")
        hub.kill()
        wait_until(lambda: "site north  HUB AWAY for" in shown(north), "a hub that is away is shown")
        assert json.loads(north.cli("federation", "sites", "--json").stdout)["hub"]["connected"] is False


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('site = "north"\nservers = ["nats://10.0.0.1:4222"]\nnkey = "n.nk"', "without TLS anyone on the way"),
        ('servers = ["tls://10.0.0.1"]\nnkey = "n.nk"', "site is missing"),
        ('site = "North"\nservers = ["tls://10.0.0.1"]\nnkey = "n.nk"', "federation.site"),
        ('site = "north"\nservers = ["http://10.0.0.1"]\nnkey = "n.nk"', "is not an address of a hub"),
        ('site = "north"\nservers = ["tls://10.0.0.1"]\nnkey = "n.nk"\nrates_hz = 1', "did you mean rate_hz"),
        ('site = "north"\nservers = ["nats://127.0.0.1:1"]\nnkey = "absent.nk"', "absent.nk: does not exist; make it"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_with_its_key(table: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(f"[federation]\n{table}\n")
    process = federation("run", str(file))
    text = ended(process)
    assert process.returncode == 1 and words in text and "Traceback" not in text, text


def line_with(process: subprocess.Popen[str], words: str) -> str:
    """Its first line with these words."""
    seen: list[str] = []
    assert process.stdout is not None
    while not seen or words not in seen[-1]:
        seen.append(process.stdout.readline() or pytest.fail(f"it has ended: {seen}"))
    return seen[-1]


def test_over_tls_the_programs_connect_and_come_back_after_the_hub_was_away(tmp_path: Path) -> None:
    """On uvloop, which the programs use, and the tests of the connection do not."""
    authority = Authority(tmp_path, "ca")
    authority.issue("hub", "127.0.0.1")
    authority.issue("visitor", "127.0.0.1")
    port = free_port(socket.SOCK_STREAM)
    (tmp_path / "hub.toml").write_text(
        f'listen = "127.0.0.1:{port}"\n[tls]\ncert = "hub.crt"\nkey = "hub.key"\nca = "ca.crt"\n'
        '[users.visitor]\nrole = "observer"\nnkey_file = "visitor.nk"\n'
    )
    (tmp_path / "visitor.toml").write_text(
        f'[federation]\nrole = "observer"\nservers = ["tls://127.0.0.1:{port}"]\nnkey = "visitor.nk"\n'
        'ca = "ca.crt"\ncert = "visitor.crt"\nkey = "visitor.key"\n'
    )
    for tries in range(2):
        hub = federation("up", cwd=tmp_path)
        try:
            line_with(hub, f"the hub is up at tls://127.0.0.1:{port}")
            if tries == 0:
                visitor = federation(
                    "run", "--no-daemon", "--socket", str(tmp_path / "v.sock"), "visitor.toml", cwd=tmp_path
                )
            line_with(visitor, "federation: connected to tls://")
        finally:
            hub.send_signal(signal.SIGINT)
            ended(hub)
        line_with(visitor, "federation: the hub at tls://")
    visitor.send_signal(signal.SIGINT)
    ended(visitor)
    assert (hub.returncode, visitor.returncode) == (0, 0)


async def test_a_port_that_another_hub_has_is_said(hub: Hub, tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text(f'listen = "127.0.0.1:{hub.port}"\n[users.a]\nrole="site"\nnkey_file="a.nk"\n')
    process = federation("up", str(tmp_path))
    text = ended(process)
    assert process.returncode == 1 and "another nats-server listens on 127.0.0.1:" in text and "Traceback" not in text


def test_the_configuration_is_one_that_nats_server_takes(tmp_path: Path) -> None:
    (tmp_path / "hub.toml").write_text('store = "a $HOME b"\n[users.a]\nrole="site"\nnkey_file="a.nk"\n')
    text = ended(federation("keys", "a", "--out", str(tmp_path)))
    assert 'role = "site"' in text and "nkey = " in text
    process = federation("hub-config", str(tmp_path / "hub.toml"), "--check", "-o", str(tmp_path / "nats.conf"))
    assert ended(process).startswith("warning") or process.returncode == 0
    assert process.returncode == 0 and "authorization {" in (tmp_path / "nats.conf").read_text()


def test_without_the_program_the_package_is_named(inventory: int, tmp_path: Path) -> None:
    code = (
        "import skygcs.ext.federation.server_program as p; p.SYSTEM_FOLDERS = ''\n"
        f"from skygcs.cli.serve import main; main(['federation', 'up', {str(tmp_path)!r}])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PATH": ""}, check=False
    )
    assert done.returncode == 1
    assert re.fullmatch(r"skygcs: nats-server is not installed: apt-get install nats-server, .*\n", done.stderr)


async def test_parts_end_although_the_daemon_goes_at_the_moment_of_their_cancellation() -> None:
    """Both happen when a daemon ends: it signals its bridge, and closes the connections of the parts."""
    lost = asyncio.Event()

    async def connection() -> None:
        await lost.wait()
        raise DaemonUnreachable("gcs.sock", "it closed the connection")

    async def part() -> None:
        while True:
            try:
                async with asyncio.TaskGroup() as group:
                    group.create_task(connection())
            except* RpcError:
                lost.clear()

    task = asyncio.create_task(part())
    await asyncio.sleep(0.01)
    lost.set()
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.sleep(0.05)
    assert not task.done()  # one cancellation is not enough
    async with asyncio.timeout(HANG_S):
        await cancelled([task])
    assert task.cancelled()
