"""The compiled lane changes nothing but the speed: whatever comes, hub, fleet and wires end up as without it."""

from __future__ import annotations

import asyncio
import fcntl
import random
import socket
import termios
import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame, frame_size
from skygcs.core.vehicle.events import Event
from skygcs.links import express
from skygcs.links.address import Address
from skygcs.links.udp import UdpClientLink, UdpLink, UdpServerLink
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from support.frames import dialect, frame, heartbeat, unknown_frame, with_bit_errors

native = pytest.mark.skipif(
    express.new_table(dialect(), recording=False) is None, reason="skygcs was installed without a compiler"
)

GROUND_STATIONS = 2
PEERS = 3
MAX_FRAMES = 120
"""At one time: a socket's default buffer holds some 250 datagrams, and what it loses is none of our differences."""


class Clock(asyncio.SelectorEventLoop):
    """A loop whose time stands until it is set."""

    now = 1000.0

    def time(self) -> float:
        return self.now


class Station:
    """A hub with its fleet between vehicles' sockets on one port and two ground stations, driven step by step."""

    def __init__(self, pure: bool, links: dict[str, dict[str, Any]], keep_vehicles: bool, tap: bool) -> None:
        self.loop = Clock()
        self.recorded: list[bytes] = []
        self.recorded_us: list[int] = []
        self.events: list[tuple[str, str]] = []
        self.tapped: list[bytes] = []
        self.sinks = [_socket() for _ in range(GROUND_STATIONS)]
        self.peers = [_socket() for _ in range(PEERS)]
        ports = [s.getsockname()[1] for s in self.sinks]
        config = FleetConfig.model_validate(
            {
                "daemon": {"heartbeat": False},
                "links": {
                    "air": {"type": "udp_server", "host": "127.0.0.1", "port": 0, **links.get("air", {})},
                    **{
                        f"gcs{n}": {"type": "udp_client", "host": "127.0.0.1", "port": p, **links.get(f"gcs{n}", {})}
                        for n, p in enumerate(ports)
                    },
                },
            }
        )
        self.fleet = Fleet(config, dialect(), lambda *a, **k: self.hub.send(*a, **k), self.loop, self.on_event)
        with pytest.MonkeyPatch.context() as patch:
            if pure:
                patch.setenv(express.PURE, "1")
            self.hub = Hub(
                config,
                dialect(),
                self.loop,
                on_vehicle_frame=self.fleet.on_frame if keep_vehicles else None,
                record=self.record,
                on_note=lambda note, channel: self.events.append((note.kind, f"{note.sysid}/{note.compid}")),
                on_fault=lambda text: self.events.append(("fault", text)),
                record_many=self.record_many,
                only_noted=self.fleet.only_noted,
            )
        assert (self.hub.express is None) == pure
        self.fleet.on_roster = self.hub.forget_lanes
        if tap:
            self.hub.add_tap({30}, None, lambda f, channel, now: self.tapped.append(f.raw))
        self.links: list[UdpLink] = []
        for link in config.links.values():
            made = UdpServerLink if link.type == "udp_server" else UdpClientLink
            self.links.append(made(link, self.hub, self.loop))
            self.loop.run_until_complete(self.links[-1].open())
        self.port = self.links[0].bound_port

    def on_event(self, event: Event) -> None:
        self.events.append((event.kind, event.text))

    def record(self, raw: bytes, unix_us: int) -> None:
        self.recorded.append(raw)
        self.recorded_us.append(unix_us)

    def record_many(self, records: bytes, count: int) -> None:
        at = 0
        for _ in range(count):
            self.recorded_us.append(int.from_bytes(records[at : at + 8], "big"))
            size = frame_size(records, at + 8)
            self.recorded.append(records[at + 8 : at + 8 + size])
            at += 8 + size
        assert at == len(records)

    def play(self, steps: list[list[tuple[int, bytes]]]) -> dict[str, Any]:
        """Each step's datagrams arrive together; then half a second passes."""
        got: list[list[bytes]] = []
        for number, step in enumerate(steps):
            for peer, datagram in step:
                self.peers[peer].sendto(datagram, ("127.0.0.1", self.port))
            _wait_delivered(self.peers)
            for link in self.links:
                for _ in range(3):
                    link._lane.ready() if link._lane is not None else link._on_readable()
            for _ in range(3):
                self.loop.run_until_complete(asyncio.sleep(0))
            _wait_delivered([link._socket for link in self.links])
            got += [_drain(s) for s in (*self.sinks, *self.peers)]
            self.loop.now += 0.3
            self.fleet.tick(self.loop.now)
            if number % 3 == 0:
                self.hub.tick(self.loop.now)
        now = self.loop.now
        self.hub.after_lane()
        return {
            "datagrams": got,
            "recorded": self.recorded,
            "tapped": self.tapped,
            "events": self.events,
            "counters": self.hub.router.counters,
            "routes": self.hub.router.routes(),
            "channels": [(c.counters(), c.last_rx_at) for c in self.hub.channels.values()],
            "sources": [{k: s.as_dict(now) for k, s in c.sources.items()} for c in self.hub.channels.values()],
            "links": [link.counters() for link in self.links],
            "vehicles": {k: actor.state(now) for k, actor in self.fleet.vehicles.items()},
            "slots": {
                k: {m: (s.count, s.at, s.frame and _all_of(s.frame)) for m, s in a.vehicle.slots.items()}
                for k, a in self.fleet.vehicles.items()
            },
        }

    def close(self) -> None:
        self.loop.run_until_complete(self._end())
        self.loop.close()
        for sock in (*self.sinks, *self.peers):
            sock.close()

    async def _end(self) -> None:
        self.fleet.close()
        for link in self.links:
            await link.close()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    return sock


def _wait_delivered(socks: list[socket.socket]) -> None:
    """Until nothing of what was sent is under way: a busy machine may take its time even on the loopback."""
    for sock in socks:
        while any(fcntl.ioctl(sock, termios.TIOCOUTQ, bytes(4))):
            time.sleep(0.0005)


def _drain(sock: socket.socket) -> list[bytes]:
    got = []
    while True:
        try:
            got.append(sock.recv(65536))
        except BlockingIOError:
            return got


def _all_of(f: Frame) -> tuple[Any, ...]:
    return f.raw, f.seq, f.sysid, f.compid, f.msgid, f.info


def _one_frame(rng: random.Random, seqs: dict[int, int]) -> bytes:
    """Mostly a vehicle's telemetry in sequence; now and then everything else that there is."""
    sysid = rng.choice([1, 1, 1, 2, 2, 3, 0, 255])
    seqs[sysid] = seq = (seqs.get(sysid, 0) + rng.choice([1, 1, 1, 1, 1, 2, 0, 250])) & 0xFF
    version = rng.choice([2, 2, 2, 1])
    compid = rng.choice([1, 1, 1, 1, 100])
    common = {"sysid": sysid, "compid": compid, "seq": seq, "version": version}
    kind = rng.randrange(20)
    if kind < 8:
        return frame("ATTITUDE", {"time_boot_ms": rng.randrange(1000), "yaw": 1.0}, **common)
    if kind < 11:
        return frame("GLOBAL_POSITION_INT", {"lat": 437806000 + rng.randrange(9), "lon": 1, "alt": 2}, **common)
    if kind < 14:
        return heartbeat(**common, autopilot=rng.choice([12, 12, 12, 12, 12, 3, 8]), type=rng.choice([2, 2, 2, 6]))
    if kind == 14:
        return frame("SYSTEM_TIME", {"time_boot_ms": rng.choice([5_000, 200_000, 300_000])}, **common)
    if kind == 15:
        return frame("COMMAND_LONG", {"target_system": rng.choice([0, 1, 2, 255, 9]), "target_component": 1}, **common)
    if kind == 16:
        return frame("STATUSTEXT", {"severity": 4, "text": "low battery"}, **common)
    if kind == 17:
        return unknown_frame(sysid=sysid, compid=compid, seq=seq)
    if kind == 18:
        return frame("RADIO_STATUS", {"rssi": 100}, **common)
    return frame("ATTITUDE", {"time_boot_ms": 3}, **common)[: rng.randrange(1, 30)]


def _datagram(rng: random.Random, seqs: dict[int, int]) -> bytes:
    data = b"".join(_one_frame(rng, seqs) for _ in range(rng.choice([1, 1, 1, 1, 2, 5, 60])))
    kind = rng.randrange(20)
    if kind == 0:
        return with_bit_errors(data, 0.01, rng)
    if kind == 1:
        return data[: rng.randrange(len(data) + 1)]
    return data


def _steps(rng: random.Random, quiet: bool) -> list[list[tuple[int, bytes]]]:
    """Each step some datagrams of some peers. Quiet: each peer has its own vehicle and sends only telemetry."""
    seqs: list[dict[int, int]] = [{} for _ in range(PEERS)]
    steps = []
    for _ in range(rng.randrange(2, 25)):
        step: list[tuple[int, bytes]] = []
        for _ in range(rng.randrange(0, 40)):
            if sum(data.count(b"\xfd") + data.count(b"\xfe") for _, data in step) > MAX_FRAMES:
                break
            peer = rng.randrange(PEERS)
            if quiet and rng.randrange(50):
                seqs[peer][0] = seq = (seqs[peer].get(0, 0) + 1) & 0xFF
                make = rng.choice([heartbeat, lambda **k: frame("ATTITUDE", {"time_boot_ms": rng.randrange(99)}, **k)])
                data = make(sysid=peer + 1, seq=seq)
            else:
                data = _datagram(rng, seqs[peer])
            step.append((peer, data))
            if not rng.randrange(60):
                step.append((rng.randrange(PEERS), data))  # a copy, perhaps over another channel
        steps.append(step)
    return steps


_LINKS = st.fixed_dictionaries(
    {},
    optional={
        "air": st.fixed_dictionaries(
            {"role": st.sampled_from(["peer", "radio", "vehicle"])},
            optional={"block_msg_id_in": st.just(["GLOBAL_POSITION_INT"]), "whole_datagrams": st.booleans()},
        ),
        "gcs1": st.sampled_from([{"role": "gcs", "vehicles": [1]}, {"role": "gcs", "vehicles": [2], "present_as": 1}]),
        "gcs0": st.fixed_dictionaries(
            {"role": st.sampled_from(["peer", "gcs"])},
            optional={
                "block_msg_id_out": st.just(["ATTITUDE"]),
                "rate_out": st.just({"messages": {"ATTITUDE": 1.0}}),
                "whole_datagrams": st.booleans(),
            },
        ),
    },
)


@native
@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    quiet=st.booleans(),
    links=_LINKS,
    keep_vehicles=st.booleans(),
    tap=st.sampled_from([False, False, False, True]),
)
def test_whatever_comes_ends_as_without_the_lane(
    seed: int, quiet: bool, links: dict[str, Any], keep_vehicles: bool, tap: bool
) -> None:
    steps = _steps(random.Random(seed), quiet)
    results = []
    for pure in (True, False):
        station = Station(pure, links, keep_vehicles, tap)
        try:
            results.append(station.play(steps))
            assert station.recorded_us == sorted(station.recorded_us)
        finally:
            station.close()
    slow, fast = results
    for key in slow:
        if key == "channels":
            continue
        assert fast[key] == slow[key], key
    for (fast_counters, fast_at), (slow_counters, slow_at) in zip(fast["channels"], slow["channels"], strict=True):
        assert fast_counters == slow_counters
        assert fast_at == slow_at


@native
def test_steady_telemetry_takes_the_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the property above would hold of a lane that lets nothing pass."""
    seen: list[bytes] = []
    original = UdpLink._on_datagram

    def watched(link: UdpLink, data: bytes, address: Address, now: float) -> None:
        seen.append(data)
        original(link, data, address, now)

    monkeypatch.setattr(UdpLink, "_on_datagram", watched)
    station = Station(False, {"air": {"role": "radio"}, "gcs0": {"role": "gcs"}}, True, False)
    frames = [[heartbeat(1, seq=2 * n), frame("ATTITUDE", sysid=1, seq=2 * n + 1)] for n in range(100)]
    steps = [[(0, data) for pair in frames[at : at + 20] for data in pair] for at in range(0, 100, 20)]
    try:
        result = station.play(steps)
    finally:
        station.close()
    assert result["channels"][-1][0]["rx_frames"] == 200
    assert 0 < len(seen) < 20


@native
def test_frames_that_come_late_through_the_lane_are_no_loss() -> None:
    """As PX4 sends them: one of twenty comes twelve places late. And more frames than the lane notes of one source."""
    order = sorted(range(1200), key=lambda n: n + (12.5 if n % 20 == 7 else 0))
    datagrams = [(0, frame("ATTITUDE", sysid=1, seq=n & 0xFF)) for n in order if n % 300 != 299]
    station = Station(False, {"air": {"role": "radio"}, "gcs0": {"role": "gcs"}}, True, False)
    try:
        result = station.play([[(0, heartbeat(1, seq=255))], *(datagrams[at : at + 100] for at in range(0, 1200, 100))])
    finally:
        station.close()
    stats = next(sources[1 << 8 | 1] for sources in result["sources"] if 1 << 8 | 1 in sources)
    assert (stats["frames"], stats["lost"]) == (1197, 3)
