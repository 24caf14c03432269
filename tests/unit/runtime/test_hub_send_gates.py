"""Where frames leave for a vehicle that an extension has closed: nothing but the emergency stop passes."""

from __future__ import annotations

import asyncio
import os
import socket
import time
from typing import Any

import pytest

from skygcs.config.models import FleetConfig, MemoryLinkConfig, UdpServerLinkConfig
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.send_gates import SendGates
from skygcs.events import Event
from skygcs.links.stream import StreamChannel
from skygcs.links.udp import UdpServerLink
from skygcs.runtime.hub import Hub
from skygcs.runtime.loop_clock import boot_clock
from support.clearances import cleared
from support.hosts import until
from support.plain_hub import PlainLink
from support.routed import DIALECT, heartbeat, message
from support.send_gate import TimedGate
from support.services import connect

ALPHA, OWN, GCS = 7, 8, 250
LONG = DIALECT.find("COMMAND_LONG")
BEAT = DIALECT.find("HEARTBEAT")


class Wire:
    """A stream channel of a hub, and the messages that came out at its other end."""

    def __init__(self, hub: Hub, name: str, **keys: Any) -> None:
        ours, self.end = socket.socketpair()
        ours.setblocking(False)
        self.end.setblocking(False)
        self._ours = ours
        link = PlainLink(MemoryLinkConfig(name=name, **keys), hub, asyncio.get_running_loop())
        self.channel = StreamChannel(link, name, ours.fileno(), lambda channel, reason: None)
        hub.attach(self.channel)
        self._parser = FrameParser(DIALECT)

    def got(self) -> list[str]:
        """What came since the last call."""
        try:
            data = self.end.recv(65536)
        except BlockingIOError:
            return []
        return [frame.name for frame in self._parser.feed(data)]

    def close(self) -> None:
        self.channel.close()
        self._ours.close()
        self.end.close()


class Bench:
    """A hub with a gate for `ALPHA`, whose clock the test sets."""

    def __init__(self) -> None:
        self.now = 100.0
        self.gate = TimedGate(ALPHA)
        self.events: list[Event] = []
        self.hub = Hub(FleetConfig(), DIALECT, asyncio.get_running_loop(), self.events.append)
        self.gates = SendGates({"lease": self.gate}, self.hub.fault)
        self.hub.gate_sending(self.gates)
        self.hub.boot_clock = lambda: self.now
        connect(self.hub)
        self.wires: list[Wire] = []

    def wire(self, name: str, *sysids: int, **keys: Any) -> Wire:
        """A channel on which these vehicles are heard."""
        wire = Wire(self.hub, name, **{"role": "vehicle", **keys})
        self.wires.append(wire)
        self.feed(wire, *(heartbeat(sysid) for sysid in sysids))
        return wire

    def feed(self, wire: Wire, *raws: bytes) -> None:
        channel = wire.channel
        for raw in raws:
            self.hub.on_frames(channel, channel.parser.feed(raw), 1.0)

    def grant(self, valid_s: float = 2.5) -> None:
        self.gate.until[ALPHA] = self.now + valid_s

    def command(self, sysid: int = ALPHA, priority: Priority = Priority.COMMAND, **more: Any) -> bool:
        more.setdefault("clearance", cleared("disarm"))
        return self.hub.send(LONG, {"target_system": sysid, "command": 400}, sysid, 1, priority, **more)

    def beat(self) -> None:
        self.hub.send_heartbeat(BEAT, {"type": 6, "autopilot": 8, "mavlink_version": 3})

    def close(self) -> None:
        for wire in self.wires:
            wire.close()


@pytest.fixture
async def bench() -> Any:
    made = Bench()
    yield made
    made.close()


async def test_our_messages_reach_a_gated_vehicle_only_while_it_is_held(bench: Bench) -> None:
    air = bench.wire("air", ALPHA, OWN)
    assert not bench.command()
    assert bench.command(OWN)
    bench.grant()
    assert bench.command()
    bench.now += 2.5
    assert not bench.command()
    assert air.got() == ["COMMAND_LONG", "COMMAND_LONG"]


async def test_only_the_emergency_stop_is_exempt_and_not_the_priority_of_an_emergency(bench: Bench) -> None:
    air = bench.wire("air", ALPHA)
    assert not bench.command(priority=Priority.EMERGENCY)
    assert bench.command(priority=Priority.EMERGENCY, clearance=cleared("stop"))
    assert air.got() == ["COMMAND_LONG"]


async def test_a_gate_that_fails_lets_nothing_leave_but_the_stop(bench: Bench) -> None:
    air, station = bench.wire("air", ALPHA, OWN), bench.wire("station", role="gcs")
    bench.grant()
    assert bench.command()
    bench.gate.fault = ValueError("broken")
    assert not bench.command()
    bench.feed(station, message("COMMAND_LONG", GCS, 190, target_system=ALPHA, target_component=1, command=400))
    bench.command(0)
    assert air.got() == ["COMMAND_LONG"], "what was sent before"
    assert bench.command(OWN) and bench.command(clearance=cleared("stop"), priority=Priority.EMERGENCY)
    assert air.got() == ["COMMAND_LONG", "COMMAND_LONG"]
    assert [event.kind for event in bench.events if event.kind == "fault"] == ["fault"], "reported once"


async def test_gates_are_there_before_a_channel_or_never(bench: Bench) -> None:
    bench.wire("air", OWN)
    hub = Hub(FleetConfig(), DIALECT, asyncio.get_running_loop(), bench.events.append)
    gates = SendGates({"lease": bench.gate}, hub.fault)
    hub.gate_sending(gates)
    with pytest.raises(RuntimeError, match="once"):
        hub.gate_sending(gates)
    with pytest.raises(RuntimeError, match="before channels"):
        bench.hub.gate_sending(gates)


async def test_a_broadcast_order_does_not_reach_it_among_others_and_a_heartbeat_does(bench: Bench) -> None:
    both, alone, own = bench.wire("both", ALPHA, OWN), bench.wire("alone", ALPHA), bench.wire("own", OWN)
    bench.beat()
    assert (both.got(), alone.got(), own.got()) == (["HEARTBEAT"], [], ["HEARTBEAT"])
    bench.command(0)
    assert (both.got(), alone.got(), own.got()) == ([], [], ["COMMAND_LONG"])
    bench.grant()
    bench.beat()
    assert (both.got(), alone.got()) == (["HEARTBEAT"], ["HEARTBEAT"])


async def test_a_message_without_a_target_field_goes_by_the_vehicle_it_is_sent_to(bench: Bench) -> None:
    air = bench.wire("air", ALPHA, OWN)
    info = DIALECT.find("ATT_POS_MOCAP")
    poses = cleared("poses")
    assert not bench.hub.send(info, {}, ALPHA, 1, Priority.POSE, clearance=poses)
    assert bench.hub.send(info, {}, OWN, 1, Priority.POSE, clearance=poses)
    assert air.got() == ["ATT_POS_MOCAP"]


async def test_frames_of_other_programs_are_kept_from_it(bench: Bench) -> None:
    air, station = bench.wire("air", ALPHA), bench.wire("station", role="gcs")
    order = message("COMMAND_LONG", GCS, 190, target_system=ALPHA, target_component=1, command=400)
    manual = message("MANUAL_CONTROL", GCS, 190, seq=1, target=ALPHA)
    bench.feed(station, heartbeat(GCS, 190, gcs=True), order, manual)
    assert air.got() == []
    bench.grant()
    again = message("COMMAND_LONG", GCS, 190, seq=5, target_system=ALPHA, target_component=1, command=400)
    bench.feed(station, heartbeat(GCS, 190, seq=4, gcs=True), again)
    assert air.got() == ["HEARTBEAT", "COMMAND_LONG"]
    bench.feed(air, message("ATTITUDE", ALPHA, seq=9))
    assert "ATTITUDE" in station.got(), "what it sends goes on, whoever commands it"


async def test_what_waits_in_a_queue_is_judged_when_it_is_written(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    air = bench.wire("air", ALPHA, OWN)
    bench.grant()
    real, full = os.write, True

    def write(fd: int, data: bytes) -> int:
        if full:
            raise BlockingIOError
        return real(fd, data)

    monkeypatch.setattr("skygcs.links.stream.os.write", write)
    assert bench.command()
    assert bench.command(OWN)
    bench.now += 2.5
    full = False
    await until(lambda: air.channel.tx_frames, within_s=5)
    assert air.got() == ["COMMAND_LONG"]
    assert air.channel.tx_dropped == 1


async def test_the_rest_of_a_frame_is_not_written_after_the_end(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    air = bench.wire("air", ALPHA, OWN)
    bench.grant()
    real, first = os.write, [5]

    def write(fd: int, data: bytes) -> int:
        return real(fd, data[: first.pop()] if first else data)

    monkeypatch.setattr("skygcs.links.stream.os.write", write)
    assert bench.command()
    bench.now += 2.5
    await until(lambda: air.channel.tx_dropped, within_s=5)
    assert len(air.end.recv(4096)) == 5
    assert bench.command(OWN)
    assert air.got() == ["COMMAND_LONG"]


async def test_the_clock_of_gates_is_read_at_each_call() -> None:
    clock = boot_clock(asyncio.get_running_loop())
    first = clock()
    time.sleep(0.002)  # noqa: ASYNC251 - within one turn of the loop, in which uvloop's own clock stands still
    assert clock() - first >= 0.002


async def test_no_fast_path_leads_to_a_gated_vehicle_and_those_to_others_stay() -> None:
    """Over real sockets: a station's heartbeats take the fast path to a vehicle of ours and not to a gated one."""
    loop = asyncio.get_running_loop()
    hub = Hub(FleetConfig(), DIALECT, loop, lambda event: None)
    gates = SendGates({"lease": TimedGate(ALPHA)}, hub.fault)
    hub.gate_sending(gates)
    connect(hub)
    if hub.fast_path is None:
        pytest.skip("skygcs was installed without a compiler")
    air = UdpServerLink(UdpServerLinkConfig(name="air", host="127.0.0.1", port=0, role="vehicle"), hub, loop)
    ground = UdpServerLink(UdpServerLinkConfig(name="ground", host="127.0.0.1", port=0, role="gcs"), hub, loop)
    peers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
    try:
        for link in (air, ground):
            await link.open()
        alpha, own, station = peers
        for peer in peers:
            peer.setblocking(False)
        alpha.sendto(heartbeat(ALPHA), ("127.0.0.1", air.bound_port))
        own.sendto(heartbeat(OWN), ("127.0.0.1", air.bound_port))
        await until(lambda: len(air.channels) == 2)
        await until(lambda: len(hub.router.table.routes()) == 2)
        for seq in range(20):
            station.sendto(heartbeat(GCS, 190, seq=seq, gcs=True), ("127.0.0.1", ground.bound_port))
            await asyncio.sleep(0.002)
        got: dict[int, int] = {}
        await until(lambda: _count(own, got) == 20)
        assert _count(alpha, got) == 0
        assert gates.blocked(ALPHA) == 20
    finally:
        for link in (air, ground):
            await link.close()
        for peer in peers:
            peer.close()


def _count(peer: socket.socket, into: dict[int, int]) -> int:
    """Datagrams that a peer has got so far; counted in ``into``."""
    while True:
        try:
            peer.recv(2048)
        except BlockingIOError:
            return into.get(peer.fileno(), 0)
        into[peer.fileno()] = into.get(peer.fileno(), 0) + 1
