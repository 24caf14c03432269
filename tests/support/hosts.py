"""A stand-in for the hub: it keeps what links hand to it."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from functools import cache
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.config.models import LinkConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import OwnMessage
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.links.reading import ReadingTurns


@cache
def common_dialect() -> Dialect:
    """The `common` dialect."""
    return load_dialect("common")


def heartbeat(sysid: int, seq: int = 0, compid: int = 1, version: int = 2) -> bytes:
    """A heartbeat as a vehicle sends it."""
    values = {"type": 2, "autopilot": 3, "mavlink_version": 3, "system_status": 4}
    return encode(common_dialect().find("HEARTBEAT"), values, sysid=sysid, compid=compid, seq=seq, version=version)


def text(sysid: int, seq: int, words: str) -> bytes:
    """A STATUSTEXT: a frame of some length."""
    values = {"severity": 6, "text": words}
    return encode(common_dialect().find("STATUSTEXT"), values, sysid=sysid, compid=1, seq=seq)


def own(name: str = "HEARTBEAT", sysid: int = 255, compid: int = 25, **values: Any) -> OwnMessage:
    """A message of our own."""
    info = common_dialect().find(name)
    return OwnMessage(info, info.pack(values), sysid, compid)


def frames_in(data: bytes) -> list[Frame]:
    """The frames of a whole byte string."""
    return FrameParser(common_dialect()).feed_datagram(data)


class RecordingHost:
    """Fulfils LinkHost. ``heard`` holds (channel, frame) in order; ``on_frame`` is called with each."""

    def __init__(self) -> None:
        self.dialect = common_dialect()
        self.fast_path = None
        self.reading = ReadingTurns()
        self.channels: list[Channel] = []
        self.flying: set[Channel] = set()
        """Channels that are the last way to a vehicle in the air."""
        self.detached: list[tuple[Channel, str]] = []
        self.heard: list[tuple[Channel, Frame]] = []
        self.sent: list[tuple[Channel, OwnMessage, bytes]] = []
        self.events: list[Event] = []
        self.on_frame: Callable[[Channel, Frame], None] | None = None
        self._next_id = 1

    def after_fast_path(self) -> None: ...

    def new_parser(self, config: LinkConfig) -> FrameParser:
        return FrameParser(self.dialect)

    def attach(self, channel: Channel) -> None:
        channel.id = self._next_id
        self._next_id += 1
        self.channels.append(channel)

    def detach(self, channel: Channel, reason: str) -> None:
        if channel in self.channels:
            self.channels.remove(channel)
            self.detached.append((channel, reason))

    def on_frames(self, channel: Channel, frames: list[Frame], now: float) -> None:
        assert frames, "links do not call for nothing"
        channel.last_rx_at = now
        for frame in frames:
            channel.rx_frames += 1
            channel.rx_bytes += len(frame.raw)
            self.heard.append((channel, frame))
            if self.on_frame is not None:
                self.on_frame(channel, frame)

    def carries_autopilot(self, channel: Channel) -> bool:
        return any(c is channel and f.msgid == 0 and discovers(f) for c, f in self.heard)

    def leads_to_flying(self, channel: Channel) -> bool:
        return channel in self.flying

    def vouches_for(self, config: LinkConfig, frames: list[Frame]) -> bool:
        return True

    def on_event(self, event: Event) -> None:
        self.events.append(event)

    def on_sent(self, channel: Channel, message: OwnMessage, raw: bytes) -> None:
        self.sent.append((channel, message, raw))

    @property
    def raws(self) -> list[bytes]:
        """The frames heard, as bytes."""
        return [frame.raw for _, frame in self.heard]


def drained(sock: socket.socket) -> list[bytes]:
    """All datagrams that wait in it."""
    got = []
    while True:
        try:
            got.append(sock.recv(65536))
        except BlockingIOError:
            return got


async def until(condition: Callable[[], object], within_s: float = 10.0) -> None:
    """Wait until the condition holds; fail if it does not come true."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within_s
    while not condition():
        assert loop.time() < deadline, "what was waited for did not come"
        await asyncio.sleep(0.005)


def open_descriptors() -> set[str]:
    """What this process has open, as names; the event loop's own are among them."""
    names = set()
    for number in os.listdir("/proc/self/fd"):
        try:
            names.add(f"{number} {os.readlink(f'/proc/self/fd/{number}')}")
        except FileNotFoundError:  # the listing's own
            continue
    return names
