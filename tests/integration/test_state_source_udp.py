"""The attacks of `test_state_source` over real UDP sockets, on uvloop and with the compiled fast path: another peer of
the same port sends with the vehicle's ids. With signing required on the port, nothing of it is heard at all.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.mavlink.signing import sign, timestamp_at
from skygcs.daemon import Daemon
from skygcs.links.udp import UdpServerLink
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.vehicle_group import SimFleet, make_vehicles
from skygcs.sim.vehicle_state import TICK_S
from support.called import call
from support.daemons import made_daemon
from support.pymav import PymavPeer
from support.virtual_uvloop import VirtualUvloop

FIELD = LocalFrame(43.7806, -79.4653, 180.0)
KEY = bytes(range(32))


def new_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    return sock


class Port:
    """A daemon with one UDP port; an ArduCopter is one peer of it, whoever forges another."""

    def __init__(self, daemon: Daemon, key: bytes | None) -> None:
        self.daemon = daemon
        self.dialect = daemon.dialect
        self.key = key
        link = daemon.links.link("udp")
        assert isinstance(link, UdpServerLink)
        self.address = ("127.0.0.1", link.bound_port)
        self.vehicle_socket, self.peer = new_socket(), new_socket()
        self.sim = make_vehicles(
            load_dialect("ardupilotmega"),
            px4=0,
            ardupilot=1,
            first_sysid=1,
            home=FIELD,
            now=daemon.now(),
            unix_us=1_700_000_000_000_000,
        )[0]
        self.sim.params.set("GUID_OPTIONS", 8)
        self.sim.params.set("GUID_TIMEOUT", 1.0)
        self.forger = PymavPeer(1, 1)
        self.events: list[dict[str, Any]] = []
        self.echoing = False
        self.peer_got: list[Frame] = []
        self._fleet = SimFleet([self.sim])
        self._up, self._of_peer = FrameParser(self.dialect), FrameParser(self.dialect)
        self._stamp = timestamp_at(time.time())
        daemon.event_log.subscribe(self.events.append)

    async def live(self) -> None:
        while True:
            for raw in self._fleet.step(self.daemon.now()):
                self.vehicle_socket.sendto(self._signed(raw), self.address)
            for data in drained(self.vehicle_socket):
                for frame in self._up.feed_datagram(data):
                    self._fleet.on_frame(frame, self.daemon.now())
            for data in drained(self.peer):
                frames = self._of_peer.feed_datagram(data)
                self.peer_got += frames
                if self.echoing and all(frame.sysid == 1 for frame in frames):
                    self.peer.sendto(data, self.address)
            await asyncio.sleep(TICK_S)

    def move(self) -> None:
        """The vehicle's datagrams come from another port from now on."""
        self.vehicle_socket.close()
        self.vehicle_socket = new_socket()

    def greet(self) -> None:
        """The other peer is heard as a ground station, so that it is sent what goes to all."""
        self.peer.sendto(PymavPeer(200, 190).pack(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)), self.address)

    def forge(self, message: Any) -> None:
        self.peer.sendto(self.forger.pack(message), self.address)

    async def outcome(self, method: str, **params: Any) -> dict[str, Any]:
        (outcome,) = (await call(self.daemon, method, targets="v1", **params))["outcomes"].values()
        return dict(outcome)

    def state(self) -> dict[str, Any]:
        return self.daemon.fleet.find("v1").state(self.daemon.now())

    def told(self, *kinds: str) -> list[dict[str, Any]]:
        return [e for e in self.events if e["kind"] in kinds]

    async def until(self, condition: Callable[[], object], timeout_s: float = 60.0) -> None:
        end = self.daemon.now() + timeout_s
        while not condition():
            assert self.daemon.now() < end, "it never happened"
            await asyncio.sleep(0.05)

    def _signed(self, raw: bytes) -> bytes:
        if self.key is None:
            return raw
        (frame,) = FrameParser(self.dialect).feed_datagram(raw)
        assert frame.info is not None
        self._stamp += 1
        return sign(raw, frame.info.crc_extra_byte, self.key, 1, self._stamp)


def drained(sock: socket.socket) -> list[bytes]:
    got = []
    with contextlib.suppress(BlockingIOError):
        while True:
            got.append(sock.recv(65536))
    return got


@contextlib.asynccontextmanager
async def port(tmp_path: Path, *, signed: bool) -> AsyncIterator[Port]:
    """An ArduCopter that hovers at 10 m, flown by attitude setpoints."""
    link: dict[str, Any] = {"type": "udp_server", "host": "127.0.0.1", "port": 0, "role": "peer"}
    if signed:
        key_file = tmp_path / "key"
        key_file.write_text(KEY.hex())
        key_file.chmod(0o600)
        link["signing"] = {"key_file": key_file}
    daemon = made_daemon(
        tmp_path,
        origin={"lat_deg": FIELD.lat_deg, "lon_deg": FIELD.lon_deg, "alt_amsl_m": FIELD.alt_amsl_m},
        links={"udp": link},
    )
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    net = Port(daemon, KEY if signed else None)
    living = asyncio.create_task(net.live())
    try:
        await net.until(lambda: daemon.fleet.vehicles)
        await asyncio.sleep(7)
        assert (await net.outcome("vehicles.takeoff", height_m=10.0, wait_s=60.0))["ok"]
        await net.until(lambda: abs(net.sim.motion.up_m - 10.0) < 0.5)
        await asyncio.sleep(4)
        outcome = await net.outcome("control.set", mode="attitude")
        assert outcome["ok"] and "flown by attitude" in outcome["message"], outcome
        await asyncio.sleep(2)
        yield net
        assert not net.told("fault")
    finally:
        living.cancel()
        await asyncio.gather(living, return_exceptions=True)
        daemon.stop()
        await running
        net.vehicle_socket.close()
        net.peer.close()


def on_uvloop(work: Coroutine[Any, Any, None]) -> None:
    """In virtual time, with real sockets."""
    loop = VirtualUvloop()
    try:
        loop.run_until_complete(work)
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.run_until_complete(loop.shutdown_default_executor())
    finally:
        loop.close()


def heartbeat(kind: int, autopilot: int, *, armed: bool, mode: int = 0) -> Any:
    return mav.MAVLink_heartbeat_message(kind, autopilot, 0x81 if armed else 0x51, mode, 3, 3)


def forged_position(net: Port) -> Any:
    lat_deg, lon_deg = FIELD.to_geodetic(40.0, 0.0)
    boot_ms = round(net.state()["uptime_s"] * 1000)
    return mav.MAVLink_global_position_int_message(
        boot_ms, round(lat_deg * 1e7), round(lon_deg * 1e7), 190_000, 10_000, 0, 0, 0, 0
    )


ATTACKS: dict[str, tuple[Callable[[Port], Any], list[str]]] = {
    "a companion's heartbeats": (lambda net: heartbeat(18, 8, armed=False), ["conflict"]),
    "type GENERIC": (lambda net: heartbeat(0, 0, armed=False), ["conflict"]),
    "disarmed": (lambda net: heartbeat(2, 3, armed=False, mode=CopterMode.STABILIZE), ["duplicate"]),
    "positions": (forged_position, ["duplicate"]),
    "echo": (lambda net: None, []),
}


@pytest.mark.parametrize("signed", [False, True], ids=["unsigned", "signed"])
@pytest.mark.parametrize("name", ATTACKS)
def test_another_peer_of_the_port_changes_nothing(tmp_path: Path, name: str, signed: bool) -> None:
    make, kinds = ATTACKS[name]

    async def attack() -> None:
        async with port(tmp_path, signed=signed) as net:
            net.greet()
            before = net.sim.motion.east_m, net.sim.motion.north_m
            net.events.clear()
            net.echoing = name == "echo"
            for _ in range(120):
                if (message := make(net)) is not None:
                    net.forge(message)
                await asyncio.sleep(0.1)
                state = net.state()
                assert (state["autopilot"], state["mode"], state["armed"]) == ("ardupilot", "GUIDED", True)
                assert state["control"]["state"] == "flying"
            now = net.sim.motion.east_m, net.sim.motion.north_m
            assert max(abs(a - b) for a, b in zip(before, now, strict=True)) < 1.0
            told = net.told("conflict", "duplicate", "reboot", "disarmed", "mode", "control")
            assert [e["kind"] for e in told] == ([] if signed else kinds)
            net.peer_got.clear()
            assert (await net.outcome("vehicles.stop", action="hold"))["ok"]
            assert net.sim.mode in (CopterMode.BRAKE, CopterMode.GUIDED)
            assert (await net.outcome("vehicles.land"))["ok"]
            assert net.sim.mode == CopterMode.LAND
            orders = [f for f in net.peer_got if f.target() == (1, 1)]
            assert bool(orders) is (not signed), "what ends a flight goes to every channel that is heard"

    on_uvloop(attack())


@pytest.mark.deep
def test_a_vehicle_that_comes_back_from_another_port_is_followed(tmp_path: Path) -> None:
    async def moved() -> None:
        async with port(tmp_path, signed=False) as net:
            assert (await net.outcome("control.set", mode="off"))["ok"]
            for _ in range(3):
                net.events.clear()
                net.move()
                await net.until(lambda: [e for e in net.told("route") if e["data"].get("change") == "switched"], 4.0)
                outcome = await net.outcome("vehicles.goto", enu_m=[0.0, 2.0, 10.0])
                assert outcome["ok"] and outcome["attempts"] == 1
                await asyncio.sleep(5)
                assert not net.told("duplicate", "conflict", "reboot", "vehicle_lost")
                assert net.state()["position"]["age_s"] < 2.0

    on_uvloop(moved())
