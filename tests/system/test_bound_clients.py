"""Eight unmodified pymavlink connections, over UDP both ways and TCP, to one `skygcs run` with one radio."""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from support.hanging import HANG_S
from support.process import DaemonProcess, free_port, wait_until

pytestmark = pytest.mark.system

KINDS = ("udp_server", "udp_client", "tcp_server")
SHOWN = {2: 1, 4: 1, 6: 1, 8: 200}
"""System id -> under which its program sees it, where that is another."""

PX4_VEHICLES = 4
"""Systems 1 to 4; those up to 8 are ArduPilots."""

PARAMETERS = ("MAV_SYS_ID", "SYSID_THISMAV")
"""Of PX4 and of ArduPilot: vehicles know their real ids."""

FORCE = 21196


class Script:
    """What a user writes with pymavlink, knowing of one vehicle only; nothing of its id is told to it."""

    def __init__(self, sysid: int, port: int) -> None:
        self.sysid = sysid
        self.kind = KINDS[sysid % len(KINDS)]
        self.port = port
        self.connection: Any = None
        self.sources: set[tuple[int, int]] = set()
        self.acks: list[int] = []

    @property
    def link(self) -> str:
        shown = f"translated_sysid = {SHOWN[self.sysid]}\n" if self.sysid in SHOWN else ""
        return (
            f'[links.p{self.sysid}]\ntype = "{self.kind}"\nhost = "127.0.0.1"\nport = {self.port}\nrole = "gcs"\n'
            f"vehicles = [{self.sysid}]\n{shown}"
        )

    def connect(self) -> None:
        way = {"udp_server": "udpout", "udp_client": "udpin", "tcp_server": "tcp"}[self.kind]
        self.connection = mavutil.mavlink_connection(f"{way}:127.0.0.1:{self.port}")

    def heartbeat(self) -> None:
        self.connection.mav.heartbeat_send(6, 8, 0, 0, 4)

    def receive(self, kind: str) -> Any:
        """The next message of this kind, or None after a second."""
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            message = self.connection.recv_match(blocking=True, timeout=0.2)
            if message is None:
                continue
            self.sources.add((message.get_srcSystem(), message.get_srcComponent()))
            if message.get_type() == "COMMAND_ACK":
                self.acks.append(message.command)
            if message.get_type() == kind:
                return message
        return None

    def until_answered(self, ask: Any, kind: str, answers: Callable[[Any], bool] = lambda _: True) -> Any:
        """Ask as often as it takes, as scripts over radios do. Other messages of this kind may come meanwhile."""
        end = time.monotonic() + HANG_S
        while time.monotonic() < end:
            ask()
            for _ in range(3):
                message = self.receive(kind)
                if message is not None and answers(message):
                    return message
        raise AssertionError(f"no {kind} for the program of vehicle {self.sysid}")

    def meet(self) -> int:
        """The system that the connection found by itself."""
        if self.kind == "udp_client":  # it is written to: a script may just listen, as many do
            assert self.connection.wait_heartbeat(timeout=HANG_S) is not None
        else:
            self.until_answered(self.heartbeat, "HEARTBEAT")
        self.heartbeat()
        return int(self.connection.target_system)

    def command(self, command: int, *params: float) -> tuple[int, int, int]:
        """(command, result, who answered)."""
        padded = [*params, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0][:7]
        system, component = self.connection.target_system, self.connection.target_component
        ack = self.until_answered(
            lambda: self.connection.mav.command_long_send(system, component, command, 0, *padded), "COMMAND_ACK"
        )
        return ack.command, ack.result, ack.get_srcSystem()

    def own_id(self) -> int:
        """By the vehicle's own parameter."""
        name = PARAMETERS[self.sysid > PX4_VEHICLES]
        value = self.until_answered(
            lambda: self.connection.param_fetch_one(name), "PARAM_VALUE", lambda value: value.param_id == name
        )
        if self.sysid > PX4_VEHICLES:
            return int(value.param_value)
        (number,) = struct.unpack("<i", struct.pack("<f", value.param_value))  # PX4 sends an integer's bytes so
        return int(number)


def _free_port(sysid: int) -> int:
    return free_port(socket.SOCK_STREAM if KINDS[sysid % len(KINDS)] == "tcp_server" else socket.SOCK_DGRAM)


@pytest.fixture
def scripts(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[int, Script]]:
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    made: dict[int, Script] = {}
    for sysid in range(1, 9):
        made[sysid] = Script(sysid, _free_port(sysid))
    yield made
    for script in made.values():
        if script.connection is not None:
            script.connection.close()


def armed(daemon: DaemonProcess) -> set[str]:
    return {name for name, vehicle in daemon.vehicles().items() if vehicle["armed"]}


def test_eight_unmodified_programs_each_have_their_own_vehicle(tmp_path: Path, scripts: dict[int, Script]) -> None:
    air = (
        '[links.air]\ntype = "simulated"\nrole = "radio"\npx4 = 4\nardupilot = 4\ndynamics = "kinematic"\n'
        'radio = { air_kbps = 250 }\nstream_profile = "monitor"\n'
    )
    for script in scripts.values():
        if script.kind == "udp_client":
            script.connect()  # before somebody writes to its port
    with DaemonProcess(tmp_path, air + "".join(s.link for s in scripts.values())) as daemon:
        wait_until(lambda: daemon.known() == 8, "all vehicles are heard")
        for script in scripts.values():
            if script.connection is None:
                script.connect()

        def all_do(what: str, *values: float) -> dict[int, Any]:
            with ThreadPoolExecutor(len(scripts)) as pool:
                started = {s: pool.submit(getattr(script, what), *values) for s, script in scripts.items()}
                return {s: future.result() for s, future in started.items()}

        assert all_do("meet") == {sysid: SHOWN.get(sysid, sysid) for sysid in scripts}
        assert all_do("own_id") == {sysid: sysid for sysid in scripts}, "each asked its own vehicle"

        # PX4 checks its position also before it arms by force
        wait_until(lambda: scripts[3].command(400, 1, FORCE) == (400, 0, 3), "vehicle 3 arms")
        assert scripts[6].command(400, 1, FORCE) == (400, 0, 1), "vehicle 6, as its program knows it"
        wait_until(lambda: {"v3", "v6"} <= armed(daemon), "vehicles 3 and 6 are armed")
        assert armed(daemon) == {"v3", "v6"}
        assert all_do("receive", "HEARTBEAT")
        assert {sysid for sysid, script in scripts.items() if script.acks} == {3, 6}

        answers = all_do("command", 400, 1, FORCE)
        assert answers == {sysid: (400, 0, SHOWN.get(sysid, sysid)) for sysid in scripts}
        wait_until(lambda: len(armed(daemon)) == len(scripts), "all are armed")
        for sysid, script in scripts.items():
            assert script.sources == {(SHOWN.get(sysid, sysid), 1)}, f"program of vehicle {sysid}"
        rows = {row["name"]: row for row in daemon.call("links.list")}
        assert (rows["p6"]["vehicles"], rows["p6"]["translated_sysid"]) == ([6], 1)
        shown = daemon.cli("links")
        assert "6 as 1" in shown.stdout, shown.stdout + shown.stderr
        assert daemon.known() == 8
