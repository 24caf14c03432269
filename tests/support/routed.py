"""A router with parsers on every channel: bytes in on one, bytes out on the others. No sockets, no clock."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.routing.filters import ChannelPolicy
from skygcs.core.routing.router import Router
from skygcs.core.routing.routing_table import Decision, RoutingVerdict

DIALECT = load_dialect(("ardupilotmega", "px4-extras"))


def message(name: str, sysid: int, compid: int = 1, seq: int = 0, version: int = 2, **values: Any) -> bytes:
    """One frame of the dialect."""
    return encode(DIALECT.find(name), values, sysid=sysid, compid=compid, seq=seq, version=version)


def heartbeat(sysid: int, compid: int = 1, seq: int = 0, *, gcs: bool = False, version: int = 2) -> bytes:
    """A heartbeat of an ArduPilot quadrotor, or of a ground station."""
    kind = {"type": 6, "autopilot": 8} if gcs else {"type": 2, "autopilot": 3}
    return message("HEARTBEAT", sysid, compid, seq, version, mavlink_version=3, **kind)


class RoutedNet:
    """Channels by name around one Router; ``got[name]`` is what was forwarded to each since the last `clear`."""

    def __init__(self, own: tuple[int, int] = (255, 25), route_timeout_s: float = 60.0) -> None:
        self.router = Router(*own, route_timeout_s=route_timeout_s)
        self.now = 100.0
        self._opened = 0
        self.ids: dict[str, int] = {}
        self.parsers: dict[str, FrameParser] = {}
        self.got: dict[str, list[bytes]] = defaultdict(list)
        self.decisions: list[Decision] = []
        self.counted: list[tuple[str, bool]] = []
        """Of vehicles on several channels: where each frame came, and whether it counted for the state."""

    def open(self, name: str, policy: ChannelPolicy | None = None) -> None:
        self._opened += 1
        self.ids[name] = self._opened
        self.parsers[name] = FrameParser(DIALECT)
        self.router.open(self.ids[name], policy or ChannelPolicy())

    def close(self, name: str) -> None:
        self.router.close(self.ids.pop(name))

    def datagram(self, name: str, data: bytes) -> None:
        self._route(name, self.parsers[name].feed_datagram(data))

    def stream(self, name: str, data: bytes) -> None:
        self._route(name, self.parsers[name].feed(data))

    def silence(self, name: str) -> None:
        """Nothing came on this stream for a while."""
        self._route(name, self.parsers[name].rescue())

    def _route(self, name: str, frames: list[Any]) -> None:
        names = {v: k for k, v in self.ids.items()}
        for frame in frames:
            decision = self.router.decide(self.ids[name], frame, self.now)
            if frame.sysid << 8 | frame.compid in self.router.state_sources:
                copy = decision.verdict is RoutingVerdict.DUPLICATE
                copy_of = self.router.first_channel_id if copy else None
                counts = self.router.selection.supplies(self.ids[name], frame, self.now, copy_of=copy_of)
                self.counted.append((name, counts))
            self.decisions.append(decision)
            for channel_id in decision.destinations:
                self.got[names[channel_id]].append(frame.raw)

    def clear(self) -> None:
        self.got.clear()
        self.decisions.clear()

    def reached(self) -> set[str]:
        """Names of the channels that got anything."""
        return {name for name, frames in self.got.items() if frames}


def five_ports() -> RoutedNet:
    """The set-up of the 22 cases: V0 = systems 1/1 and 1/100, V1 = 2/1, V2 = 3/1; G0 = 250/190, G1 = 249/190."""
    net = RoutedNet()
    for name in ("V0", "V1", "V2", "G0", "G1"):
        net.open(name)
    net.datagram("V0", heartbeat(1))
    net.datagram("V0", message("HEARTBEAT", 1, 100, type=30, autopilot=8, mavlink_version=3))
    net.datagram("V1", heartbeat(2))
    net.datagram("V2", heartbeat(3))
    net.datagram("G0", heartbeat(250, 190, gcs=True))
    net.datagram("G1", heartbeat(249, 190, gcs=True))
    net.clear()
    return net
