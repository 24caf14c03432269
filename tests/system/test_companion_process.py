"""A ground station and a companion as processes: orders over TLS, kill -9, and mDNS on loopback."""

from __future__ import annotations

import asyncio
import socket
import struct
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.ext.companions.pinned_client import connect_pinned
from support.pinned import NAME, make_pair
from support.process import DaemonProcess, free_port, wait_until

pytestmark = pytest.mark.system

MDNS_GROUP = ("224.0.0.251", 5353)

VEHICLE = f"[vehicles.{NAME}]\nsysid = 1\n"


class Pair:
    """Both daemons, an ArduCopter at the companion, and the ground's identity."""

    def __init__(self, folder: Path, announced: str | None = None) -> None:
        mavlink, self.rpc = free_port(), free_port(socket.SOCK_STREAM)
        self.identity, _ = make_pair(folder / "ground", folder / "companion")
        mdns = "" if announced is None else f'advertise = true\nname = "{announced}"\ninterfaces = ["127.0.0.1"]\n'
        self.ground = DaemonProcess(
            folder,
            f'[companions]\nkey_dir = "ground"\n{mdns}[companions.{NAME}]\nrpc = "127.0.0.1:{self.rpc}"\n{VEHICLE}'
            f'[links.wifi]\ntype = "udp_server"\nhost = "127.0.0.1"\nport = {mavlink}\nrole = "vehicle"\n',
            name="ground",
        )
        where = f'ground = "udp:127.0.0.1:{mavlink}"\n'
        if announced is not None:
            where = f'ground = "mdns"\nground_name = "{announced}"\ninterfaces = ["127.0.0.1"]\n'
        self.companion = DaemonProcess(
            folder,
            f'[companion]\nvehicle = "{NAME}"\nkey_dir = "companion"\nrpc_listen = "127.0.0.1:{self.rpc}"\n{where}'
            f'{VEHICLE}[links.autopilot]\ntype = "simulated"\nardupilot = 1\nrole = "vehicle"\n',
            name="companion",
        )

    def start(self) -> None:
        self.ground.start()
        self.companion.start()

    def stop(self) -> None:
        for daemon in (self.companion, self.ground):
            daemon.stop()

    def seen(self) -> dict[str, Any]:
        """The companion as the ground has it."""
        (companion,) = self.ground.call("companions.status")["companions"]
        found: dict[str, Any] = companion
        return found

    def vehicle(self) -> dict[str, Any] | None:
        """The vehicle as the ground hears it by MAVLink; None while it does not."""
        found: list[dict[str, Any]] = self.ground.call("vehicles.list", targets="all")
        return next((state for state in found if state["name"] == NAME and state["connected"]), None)

    def order(self, method: str, **params: Any) -> Any:
        """Ask the companion over TLS, as the ground does."""

        async def ask() -> Any:
            client = await connect_pinned("127.0.0.1", self.rpc, self.identity)
            try:
                return await client.call(method, **params)
            finally:
                await client.close()

        return asyncio.run(ask())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


def ended(pair: Pair) -> Iterator[Pair]:
    try:
        pair.start()
        yield pair
    finally:
        pair.stop()


@pytest.fixture
def pair(folder: Path) -> Iterator[Pair]:
    yield from ended(Pair(folder))


def test_orders_over_tls_kill_and_restart(pair: Pair) -> None:
    wait_until(lambda: pair.seen()["clock"], "the ground is connected and has compared the clocks")
    state = wait_until(pair.vehicle, "the ground hears the vehicle through the companion")
    wait_until(
        lambda: {c["compid"]: c["type"] for c in (pair.vehicle() or state)["components"]}.get(191),
        "the ground hears the companion's own heartbeats",
    )
    components = {c["compid"]: c["type"] for c in (pair.vehicle() or state)["components"]}
    assert components[191] == "ONBOARD_CONTROLLER"
    assert len(pair.ground.call("vehicles.list", targets="all")) == 1

    armed = pair.order("vehicles.arm", targets=NAME, wait_s=60)["outcomes"][NAME]
    assert armed["ok"], armed
    wait_until(lambda: (pair.vehicle() or {}).get("armed"), "the ground sees it armed")
    assert pair.order("companions.status")["companion"]["vehicle"] == NAME
    stopped = pair.order("vehicles.disarm", targets=NAME)["outcomes"][NAME]
    assert stopped["ok"], stopped

    pair.companion.kill()
    wait_until(lambda: pair.seen()["state"] == "down", "the ground notices that the companion is gone")
    wait_until(lambda: pair.vehicle() is None, "and that its vehicle is lost")
    pair.companion.start()
    wait_until(lambda: pair.seen()["state"] == "up", "it is connected again")
    wait_until(pair.vehicle, "and its vehicle is back")
    assert pair.seen()["connected"] == 2
    assert pair.order("vehicles.arm", targets=NAME, wait_s=60)["outcomes"][NAME]["ok"]

    (pair.identity.pinned).unlink()  # what the ground trusts is a file
    pair.companion.kill()
    wait_until(lambda: "is missing" in str(pair.seen()["last_error"]), "without its pin no orders go there")
    assert pair.ground.call("daemon.info")["faults"] == 0


def test_a_ground_that_is_announced_is_found(folder: Path) -> None:
    if not multicast_loops():
        pytest.skip("multicast does not work on this machine's loopback")
    for pair in ended(Pair(folder, announced=f"test-{uuid.uuid4().hex[:12]}")):
        wait_until(pair.vehicle, "the companion has found the ground")
        own = pair.companion.call("companions.status")["companion"]
        assert own["mdns"]["problem"] is None
        assert own["ground_peer"].startswith("127.0.0.1:")
        pair.ground.kill()
        pair.ground.start()
        wait_until(pair.vehicle, "a ground station that was restarted has it again")


def multicast_loops() -> bool:
    """Whether a datagram to mDNS' group comes back on loopback."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(("", 0))
            member = struct.pack("4s4s", socket.inet_aton(MDNS_GROUP[0]), socket.inet_aton("127.0.0.1"))
            listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            listener.settimeout(10.0)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            sender.sendto(b"skygcs", (MDNS_GROUP[0], listener.getsockname()[1]))
            return listener.recv(64) == b"skygcs"
        except OSError:
            return False
