"""The same datagrams through a hub with the compiled fast path and through one without: everything must end up equal.

A scenario (links, traffic, what is opened and closed under way) comes from one number, so that a difference can be
seen again (`fuzz.fast_path --first N --count 1`). Used by tests/integration/test_fast_path_hub.py, in a process of its
own with a watchdog, and by `make fuzz`, under sanitizers.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import random
import socket
import termios
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

from fastcrc.crc16 import mcrf4xx

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame, frame_size
from skygcs.core.routing.routing_table import RouteNote
from skygcs.events import Event
from skygcs.links import fast_path
from skygcs.links.base import Channel
from skygcs.links.peers import Address
from skygcs.links.reading import ReadingTurns, Share
from skygcs.links.udp import UdpClientLink, UdpServerLink
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.link_view import LinkView, LinkWatch
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.route_reports import RouteReports
from support.frames import dialect, noise, unknown_frame, with_bit_errors
from support.hosts import drained
from support.services import Notes, list_recorder

PEERS = 3
"""Sockets of vehicles on the link "air"."""

SINKS = ("gcs0", "gcs1", "near")
"""Links with one socket behind each, which also talk."""

SENDERS = PEERS + len(SINKS)

MAX_FRAMES = 400
"""In one step: a socket's default buffer holds some 550 small datagrams, and what it loses is no difference of ours."""

SIZES = (65, 66, 256, 257)
"""Frames in a datagram about which something changes: 64 datagrams are sent at once, 256 frames of one are taken."""

STEP_S = 0.3
"""Time between two steps."""


class Clock(asyncio.SelectorEventLoop):
    """A loop whose time stands until it is set."""

    now = 1000.0

    def time(self) -> float:
        return self.now


@dataclass
class Scenario:
    """What is set up, and what happens. A step is a list of datagrams (sender, bytes), or something else to do."""

    seed: int
    links: dict[str, dict[str, Any]]
    keep_vehicles: bool
    tap: bool
    steps: list[list[tuple[int, bytes]] | str]
    datagrams: int = 0
    frames: int = 0
    bursts: int = 0
    """Datagrams of 65 frames and more."""
    fast: int = 0
    """Datagrams that took the fast path when it was played."""

    def describe(self) -> str:
        return f"seed {self.seed}: {self.links}, keep_vehicles={self.keep_vehicles}, tap={self.tap}"


AMPLE = Share(1 << 40, 3600.0)
"""A share of a turn that no burst spends."""


class _AmpleTurns(ReadingTurns):
    def share(self, reader: Hashable) -> Share:
        return AMPLE


class _Counted:
    """A link that counts the datagrams that its fast path leaves to Python."""

    left = 0

    def _on_datagram(self, data: bytes, address: Address, now: float) -> None:
        self.left += 1
        super()._on_datagram(data, address, now)  # type: ignore[misc]


class _Server(_Counted, UdpServerLink):
    pass


class _Client(_Counted, UdpClientLink):
    pass


class Station:
    """A hub with its fleet between vehicles' sockets on one port and those of other links, driven step by step."""

    def __init__(self, scenario: Scenario, *, pure: bool) -> None:
        self.loop = Clock()
        self.recorded: list[bytes] = []
        self.recorded_at_us = 0
        self.backwards = 0
        self.events: list[tuple[str, str]] = []
        self.tapped: list[bytes] = []
        self.stop_tap: Callable[[], None] | None = None
        self.sinks = [_socket() for _ in SINKS]
        self.peers = [_socket() for _ in range(PEERS)]
        self.config = _config(scenario, [s.getsockname()[1] for s in self.sinks])
        before = os.environ.pop(fast_path.PURE, None)
        if pure:
            os.environ[fast_path.PURE] = "1"
        try:
            recorder = list_recorder(self._record, self._record_many)
            self.hub = Hub(self.config, dialect(), self.loop, self._on_hub_event, recorder=recorder)
        finally:
            os.environ.pop(fast_path.PURE, None)
            if before is not None:
                os.environ[fast_path.PURE] = before
        self.hub.reading = _AmpleTurns()  # else what comes first depends on how much of it Python reads
        assert (self.hub.fast_path is None) == pure, "there is no compiled fast path"
        view = LinkView(self.hub, cast(LinkTable, SimpleNamespace(configs={})), LinkWatch(self.hub))
        self.fleet = Fleet(self.config, dialect(), self.hub.send, self.loop, self.on_event, links=view)
        self.hub.connect(self.fleet if scenario.keep_vehicles else None, cast(RouteReports, Notes(self._on_note)))
        if scenario.tap:
            self._tap()
        self.links: list[_Server | _Client] = []
        for link in self.config.links.values():
            made = _Server if link.type == "udp_server" else _Client
            self.links.append(made(link, self.hub, self.loop))
            self.loop.run_until_complete(self.links[-1].open())

    def _on_note(self, note: RouteNote, channel: Channel | None) -> None:
        """As the daemon does."""
        if note.kind in ("duplicate", "duplicate_over"):
            self.fleet.set_duplicate(note.sysid << 8 | note.compid, "there" if note.kind == "duplicate" else None)
        self.events.append((note.kind, f"{note.sysid}/{note.compid} {note.count} {note.why}"))

    def _tap(self) -> None:
        self.stop_tap = self.hub.observers.add({30}, None, lambda f, channel, now: self.tapped.append(f.raw))

    def _on_hub_event(self, event: Event) -> None:
        """Of the links' events, which name ports, only faults count."""
        if event.kind == "fault":
            self.on_event(event)

    def on_event(self, event: Event) -> None:
        self.events.append((event.kind, event.text))

    def _record(self, raw: bytes, unix_us: int) -> None:
        self.recorded.append(raw)
        self.backwards += unix_us < self.recorded_at_us
        self.recorded_at_us = unix_us

    def _record_many(self, records: bytes, count: int) -> None:
        at = 0
        for _ in range(count):
            size = frame_size(records, at + 8)
            self._record(records[at + 8 : at + 8 + size], int.from_bytes(records[at : at + 8], "big"))
            at += 8 + size
        assert at == len(records)

    def play(self, scenario: Scenario) -> dict[str, Any]:
        """Each step's datagrams arrive together; then some time passes."""
        got: list[list[bytes]] = []
        for number, step in enumerate(scenario.steps):
            if isinstance(step, str):
                self._change(step)
                continue
            self._send(step)
            for link in self.links:
                for _ in range(3):
                    link._fast_path.ready(*AMPLE) if link._fast_path is not None else link._on_readable()
            for _ in range(3):
                self.loop.run_until_complete(asyncio.sleep(0))
            _wait_delivered([link._socket for link in self.links])
            got += [drained(s) for s in (*self.sinks, *self.peers)]
            self.loop.now += STEP_S
            self.fleet.tick(self.loop.now)
            if number % 3 == 0:
                self.hub.tick(self.loop.now)
        self.hub.flows.take()
        return self._result(got)

    def _send(self, step: list[tuple[int, bytes]]) -> None:
        ports = [self.links[0].bound_port] * PEERS + [link.bound_port for link in self.links[1:]]
        senders = [*self.peers, *self.sinks]
        for sender, datagram in step:
            if ports[sender]:
                senders[sender].sendto(datagram, ("127.0.0.1", ports[sender]))
        _wait_delivered(senders)

    def _change(self, what: str) -> None:
        """Something that ends flows, or peers, or links."""
        if what == "reopen":
            link = self.links[1]
            self.loop.run_until_complete(link.close())
            link.rearm()
            self.loop.run_until_complete(link.open())
        elif what == "tap":
            if self.stop_tap is None:
                self._tap()
            else:
                self.stop_tap()
                self.stop_tap = None
        elif what == "silence":  # peers expire, vehicles are lost
            self.loop.now += 5.0
            self.fleet.tick(self.loop.now)
            self.hub.tick(self.loop.now)
            for _ in range(3):
                self.loop.run_until_complete(asyncio.sleep(0))

    def _result(self, got: list[list[bytes]]) -> dict[str, Any]:
        now = self.loop.now
        return {
            "datagrams": got,
            "recorded": self.recorded,
            "recorded backwards": self.backwards,
            "tapped": self.tapped,
            "events": self.events,
            "faults": self.hub.faults,
            "counters": self.hub.router.counters,
            "routes": self.hub.router.table.routes(),
            "channels": [(c.id, c.counters(), c.last_rx_at) for c in self.hub.channels.values()],
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


def _config(scenario: Scenario, ports: list[int]) -> FleetConfig:
    sinks = dict(zip(SINKS, ports, strict=True))
    return FleetConfig.model_validate(
        {
            "daemon": {"heartbeat": False},
            "links": {
                "air": {"type": "udp_server", "host": "127.0.0.1", "port": 0, **scenario.links.get("air", {})},
                **{
                    name: {"type": "udp_client", "host": "127.0.0.1", "port": port, **scenario.links.get(name, {})}
                    for name, port in sinks.items()
                },
            },
        }
    )


def _socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
    sock.bind(("127.0.0.1", 0))
    sock.setblocking(False)
    return sock


def _wait_delivered(socks: list[socket.socket | None]) -> None:
    """Until nothing of what was sent is under way: a busy machine may take its time even on the loopback."""
    for sock in socks:
        while sock is not None and any(fcntl.ioctl(sock, termios.TIOCOUTQ, bytes(4))):
            time.sleep(0.0005)


def _all_of(f: Frame) -> tuple[Any, ...]:
    return f.raw, f.seq, f.sysid, f.compid, f.msgid, f.info


# -- scenarios


@dataclass
class Sender:
    """What one socket says: its sources with their sequence numbers."""

    rng: random.Random
    own_sysid: int
    seqs: dict[tuple[int, int], int] = field(default_factory=dict)

    def next_seq(self, sysid: int, compid: int, steps: tuple[int, ...] = (1,)) -> int:
        seq = self.seqs.get((sysid, compid), 0) + self.rng.choice(steps) & 0xFF
        self.seqs[sysid, compid] = seq
        return seq


def encoded(name: str, payload: bytes, sysid: int, compid: int, seq: int, *, version: int = 2, flags: int = 0) -> bytes:
    """A frame around exactly this payload, trimmed or not; with flag 1 it has a signature, which none checks."""
    info = dialect().find(name)
    ids = (seq, sysid, compid, info.msgid & 0xFF)
    if version == 1:
        head = bytes((0xFE, len(payload), *ids))
    else:
        head = bytes((0xFD, len(payload), flags, 0, *ids, info.msgid >> 8 & 0xFF, info.msgid >> 16))
    body = head + payload
    raw = body + mcrf4xx(body[1:] + info.crc_extra_byte).to_bytes(2, "little")
    return raw + bytes(13) if flags == 1 else raw


def _attitude(rng: random.Random) -> bytes:
    return rng.randrange(1000).to_bytes(4, "little") + b"\x01\x02" * 12


def _heartbeat(rng: random.Random, *, steady: bool) -> bytes:
    if steady:
        return bytes((4, 0, 0, 0, 2, 12, 81, 4, 3))
    autopilot, type_ = rng.choice((12, 12, 12, 12, 3, 8)), rng.choice((2, 2, 2, 6))
    return bytes((rng.choice((4, 4, 4, 9)), 0, 0, 0, type_, autopilot, rng.choice((81, 81, 209)), 4, 3))


STEADY = ("ATTITUDE", "LOCAL_POSITION_NED", "SCALED_PRESSURE", "ATTITUDE_QUATERNION")
"""Of 14 to 32 bytes; only the first is filtered or tapped by some scenarios."""


def _steady_frame(sender: Sender) -> bytes:
    """Of the sender's own vehicle, in sequence, or of its companion."""
    rng, sysid = sender.rng, sender.own_sysid
    kind = rng.randrange(10)
    if kind < 1:
        return encoded("HEARTBEAT", _heartbeat(rng, steady=True), sysid, 1, sender.next_seq(sysid, 1))
    if kind < 8:
        name = STEADY[min(rng.randrange(12), 3)]
        payload = _attitude(rng)[: 14 if name == "SCALED_PRESSURE" else 28]
        return encoded(name, payload, sysid, 1, sender.next_seq(sysid, 1))
    return encoded("NAMED_VALUE_FLOAT", _attitude(rng)[:8] + b"companion\x01", sysid, 191, sender.next_seq(sysid, 191))


def _any_frame(sender: Sender) -> bytes:
    """Mostly a vehicle's telemetry in sequence; now and then everything else that there is."""
    rng = sender.rng
    sysid, compid = rng.choice((1, 1, 1, 2, 2, 3, 0, 255)), rng.choice((1, 1, 1, 1, 100, 191))
    seq = sender.next_seq(sysid, compid, (1, 1, 1, 1, 1, 2, 0, 250))
    version, flags = rng.choice(((2, 0), (2, 0), (2, 0), (1, 0), (2, 1)))
    common: dict[str, Any] = {"version": version, "flags": flags}
    kind = rng.randrange(24)
    if kind < 8:
        return encoded("ATTITUDE", _attitude(rng), sysid, compid, seq, **common)
    if kind < 11:
        position = rng.randrange(9).to_bytes(4, "little") + b"\x90\x12\x18\x1a" + b"\x01" * 20
        return encoded("GLOBAL_POSITION_INT", position, sysid, compid, seq, **common)
    if kind < 15:
        return encoded("HEARTBEAT", _heartbeat(rng, steady=rng.random() < 0.5), sysid, compid, seq, **common)
    if kind == 15:
        boot_ms = rng.choice((5_000, 200_000, 300_000))
        return encoded("SYSTEM_TIME", bytes(8) + boot_ms.to_bytes(4, "little"), sysid, compid, seq, **common)
    if kind == 16:
        payload = bytes(28) + b"\x90\x01" + bytes((rng.choice((0, 1, 2, 255, 9)), rng.choice((0, 1, 191)), 1))
        return encoded("COMMAND_LONG", payload, sysid, compid, seq, **common)
    if kind == 17:
        return encoded("STATUSTEXT", b"\x04low battery".ljust(51, b"\0"), sysid, compid, seq, **common)
    if kind == 18:
        return unknown_frame(sysid=sysid, compid=compid, seq=seq)
    if kind == 19:
        return encoded("RADIO_STATUS", b"\x01\x00\x02\x00\x64\x64\x64\x01\x02", sysid, compid, seq, **common)
    if kind == 20:  # a payload that is trimmed, or longer than the dialect knows
        return encoded("ATTITUDE", _attitude(rng)[: rng.randrange(29)] + bytes(rng.randrange(3)), sysid, compid, seq)
    if kind == 21:
        return encoded("ATTITUDE", _attitude(rng) + b"\x07" * rng.randrange(1, 200), sysid, compid, seq)
    if kind == 22:
        return encoded("ATTITUDE", _attitude(rng), sysid, compid, seq, flags=rng.choice((2, 3, 128)))
    return encoded("ATTITUDE", _attitude(rng), sysid, compid, seq)[: rng.randrange(1, 30)]


COUNTS = (*[1] * 120, *[2] * 10, *[3] * 10, 4, 5, 6, 8, 10, 12, 20, 30, 60, 0)
"""Frames in a datagram; 0: one of SIZES. Some three on the average."""

MOODS = {"quiet": 0.998, "busy": 0.96, "wild": 0.2}
"""How many datagrams are a vehicle's telemetry in sequence. One that is not may end all flows."""


def _datagram(sender: Sender, mood: str, room: int) -> tuple[bytes, int]:
    """Some frames at once, mostly few, and how many; sometimes damaged, or nothing of the kind."""
    rng = sender.rng
    make = _steady_frame if rng.random() < MOODS[mood] else _any_frame
    count = min(rng.choice(COUNTS) or rng.choice(SIZES), room)
    data = b"".join([make(sender) for _ in range(count)])
    if rng.random() < MOODS[mood]:
        return data[:65_507], count
    kind = rng.randrange(4)
    if kind == 0:
        return with_bit_errors(data, 0.01, rng)[:65_507], count
    if kind == 1:
        return data[: rng.randrange(len(data) + 1)][:65_507], count
    if kind == 2:
        return noise(rng.choice((0, 1, 7, 300, 9_000)), rng.randrange(1 << 30)), 1
    return bytes((0xFD, rng.randrange(256), rng.choice((0, 1)), 0)) + noise(
        rng.randrange(40), rng.randrange(1 << 30)
    ), 1


def _links(rng: random.Random) -> dict[str, dict[str, Any]]:
    """What may be different about links."""

    def some(of: dict[str, Any], share: float = 0.3) -> dict[str, Any]:
        return {key: rng.choice(values) for key, values in of.items() if rng.random() < share}

    whole = {"whole_datagrams": (True, False)}
    bound: list[dict[str, Any]] = [{}, {}, {"vehicles": [1]}, {"vehicles": [2], "translated_sysid": 1}]
    return {
        "air": {
            "role": rng.choice(("peer", "peer", "radio", "vehicle")),
            **some(whole, 0.6),
            **some({"block_msg_id_in": (["GLOBAL_POSITION_INT"],), "peer_timeout_s": (1.0,), "max_peers": (2,)}, 0.15),
        },
        "gcs0": {
            "role": rng.choice(("peer", "gcs", "gcs")),
            **some(whole, 0.6),
            **some({"block_msg_id_out": (["ATTITUDE"],), "rate_out": ({"messages": {"ATTITUDE": 1.0}},)}, 0.08),
        },
        "gcs1": {"role": "gcs", **rng.choice(bound), **some(whole, 0.3)},
        "near": {"role": rng.choice(("peer", "vehicle", "radio")), **some(whole, 0.6)},
    }


def scenario(seed: int, *, length: int = 25) -> Scenario:
    """The scenario of this number, of ``length`` steps at most."""
    rng = random.Random(seed)
    mood = rng.choice(("quiet", "quiet", "quiet", "quiet", "busy", "busy", "busy", "wild"))
    made = Scenario(seed, _links(rng), rng.random() < 0.7, rng.random() < 0.1, [])
    senders = [Sender(rng, n + 1 if n < PEERS else 250 + n) for n in range(SENDERS)]
    for _ in range(rng.randrange(2, length)):
        if rng.random() < 0.05:
            made.steps.append(rng.choice(("reopen", "tap", "silence")))
        step, room = [], MAX_FRAMES
        for _ in range(rng.choice((0, 3, 20, 64, 70, 130))):
            sender = rng.randrange(PEERS) if rng.random() < 0.9 else rng.randrange(SENDERS)
            data, count = _datagram(senders[sender], mood, room)
            room -= count
            step.append((sender, data))
            if mood != "quiet" and not rng.randrange(60 if mood == "wild" else 300):
                step.append((rng.randrange(PEERS), data))  # a copy, perhaps over another channel
                room -= count
            made.frames += count
            made.bursts += count >= SIZES[0]
            if room <= 0:
                break
        made.datagrams += len(step)
        made.steps.append(step)
    return made


def differences(of: Scenario) -> list[str]:
    """What ends up otherwise with the fast path than without; nothing, it is to be hoped."""
    results = []
    for pure in (True, False):
        station = Station(of, pure=pure)
        try:
            results.append(station.play(of))
            of.fast = of.datagrams - sum(link.left for link in station.links)
        finally:
            station.close()
    slow, fast = results
    backwards = [f"{of.describe()}\n{fast['recorded backwards']} records older than the one before"]
    return (backwards if fast["recorded backwards"] else []) + [
        f"{of.describe()}\n{key} differ:\n{_first_difference(slow[key], fast[key])}"
        for key in slow
        if fast[key] != slow[key]
    ]


def _first_difference(slow: Any, fast: Any) -> str:
    if isinstance(slow, list) and isinstance(fast, list):
        for at, (a, b) in enumerate(zip(slow, fast, strict=False)):
            if a != b:
                return f"at {at}: {_first_difference(a, b)}"
        return f"{len(slow)} without, {len(fast)} with the fast path"
    if isinstance(slow, dict) and isinstance(fast, dict):
        for key in slow.keys() | fast.keys():
            if slow.get(key) != fast.get(key):
                return f"{key}: {_first_difference(slow.get(key), fast.get(key))}"
    return f"without: {slow!r:.500}\nwith: {fast!r:.500}"
