"""A hub on which channels are made by hand, with surroundings that only take notes."""

from __future__ import annotations

import asyncio
from collections.abc import Hashable
from typing import Any

from skygcs.config.models import FleetConfig, LinkConfig, MemoryLinkConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Outgoing, Priority
from skygcs.core.routing.routing_table import RouteNote
from skygcs.links.base import Channel, Link
from skygcs.runtime.hub import Hub
from support.routed import DIALECT
from support.services import connect, list_recorder


class PlainLink(Link):
    """A link whose channels are made by hand."""

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    @property
    def channels(self) -> list[Channel]:
        return []


class PlainChannel(Channel):
    """Keeps what it is given."""

    def __init__(self, link: Link, peer: str) -> None:
        super().__init__(link, peer)
        self.got: list[bytes] = []
        self.priorities: list[Priority] = []

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        self.got.append(self.encode(outgoing))
        self.priorities.append(priority)
        return True


class HubBench:
    """A hub whose surroundings only take notes."""

    def __init__(self, **daemon: Any) -> None:
        self.loop = asyncio.get_running_loop()
        self.vehicle_frames: list[tuple[int, str, str]] = []
        self.recorded: list[bytes] = []
        self.notes: list[tuple[str, int]] = []
        self.faults: list[str] = []
        self.hub = Hub(
            FleetConfig.model_validate({"daemon": daemon}),
            DIALECT,
            self.loop,
            lambda event: self.faults.append(event.text),
            recorder=list_recorder(lambda raw, unix_us: self.recorded.append(raw)),
        )
        self.fleet = connect(self.hub, self.on_vehicle_frame, self.on_note)

    def on_vehicle_frame(self, key: int, frame: Frame, label: str, now: float) -> None:
        if frame.name == "VFR_HUD":
            raise RuntimeError("a fault behind one message")
        self.vehicle_frames.append((key, frame.name, label))

    def on_note(self, note: RouteNote, channel: Channel | None) -> None:
        self.notes.append((note.kind, note.sysid))

    def channel(self, name: str, peer: str = "x", **keys: Any) -> PlainChannel:
        return self.channel_of(MemoryLinkConfig(name=name, **keys), peer)

    def channel_of(self, config: LinkConfig, peer: str = "x") -> PlainChannel:
        channel = PlainChannel(PlainLink(config, self.hub, self.loop), peer)
        self.hub.attach(channel)
        return channel

    def feed(self, channel: Channel, *raws: bytes, now: float = 1.0) -> None:
        for raw in raws:
            self.hub.on_frames(channel, channel.parser.feed_datagram(raw), now)
