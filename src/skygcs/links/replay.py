"""A tlog or a raw capture, played as if its frames came from a link; the link finishes with the file."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Hashable
from typing import BinaryIO

from skygcs.config import models
from skygcs.config.files import open_regular
from skygcs.core.radio_link.transmit_queue import Outgoing, Priority
from skygcs.errors import LinkError
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.stream import StreamIntake
from skygcs.tlog.files import WINDOW_BYTES, FileWindow
from skygcs.tlog.format import sniff
from skygcs.tlog.reading import LogReader
from skygcs.tlog.timeline import Pace

RECORDS_PER_TURN = 64
RAW_BYTES_PER_TURN = 4096
"""The most work without a turn for the loop: below 1 ms if a frame takes 12 µs."""

LOOKS_PER_TURN = 64
"""The same for damage and noise: places searched for a record, some 15 µs each."""

PAUSE_S = 0.001
"""At full speed, after each turn: for the recorder's writer, the sockets and other tasks."""

RAW_STEP_S = 0.02
"""A raw capture has no times and is fed in steps of this length."""


class ReplayChannel(Channel):
    """Frames come from the file; what is sent to it is dropped and counted."""

    def __init__(self, link: Link, peer: str) -> None:
        super().__init__(link, peer)
        self.intake = StreamIntake(self)

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        self.tx_dropped += 1
        return False


class ReplayLink(Link):
    """Plays its file once, or again and again. Frames of both directions come from the one channel."""

    config: models.ReplayLinkConfig

    def __init__(self, config: models.ReplayLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._file: BinaryIO | None = None
        self._channel: ReplayChannel | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def channels(self) -> list[Channel]:
        return [self._channel] if self._channel is not None else []

    async def open(self) -> None:
        path = self.config.file
        self.finished = False
        try:
            file = self._file = open_regular(path)
            window = FileWindow(file)
            kind: str | None = "tlog"
            if path.suffix.lower() != ".tlog":
                kind = sniff(window[:WINDOW_BYTES], self.host.dialect)
                if kind is None and len(window) > WINDOW_BYTES:  # a few seconds for 16 MB of noise
                    kind = await asyncio.to_thread(sniff, window, self.host.dialect)
            if self._file is not file:
                raise LinkError(f"replay {path}: closed while it was being opened")
            if kind is None:
                raise LinkError(f"replay {path}: no MAVLink in it, neither as a tlog nor as a raw capture")
            channel = self._channel = ReplayChannel(self, path.name)
            self.host.attach(channel)
            player = self._run(window, channel, kind == "tlog")
        except BaseException as error:
            await self.close()
            if isinstance(error, OSError):
                raise LinkError(f"replay {path}: {_explain(error)}") from None
            raise
        self._task = self.loop.create_task(player, name=f"link {self.name}: replay")

    async def close(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.intake.close()
            self.host.detach(channel, self.why_closed)
        if self._file is not None:
            self._file.close()
            self._file = None
        if task is not None and task is not asyncio.current_task():
            await asyncio.wait({task})

    async def _run(self, file: FileWindow, channel: ReplayChannel, is_tlog: bool) -> None:
        try:
            while await (self._play_tlog(file, channel) if is_tlog else self._play_raw(file, channel)):
                if not self.config.loop:
                    break
        except Exception as error:  # a file that became unreadable fails this link only
            reason = _explain(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            self.fail(f"replay {self.config.file}: {reason}")
            return
        self.finished = True
        self.fail("finished: the end of the file")

    async def _play_tlog(self, file: FileWindow, channel: ReplayChannel) -> int:
        """Play all records once, each at its time; returns their number."""
        speed, pace = self.config.speed, Pace(self.config.speed)
        began = self.loop.time()
        played = in_turn = 0
        for entry in LogReader(file, self.host.dialect).steps(LOOKS_PER_TURN):
            if entry is None:
                await asyncio.sleep(0)
                continue
            # wait until it is due
            wait_s = began + pace.due_s(entry.at_s) - self.loop.time() if speed else 0.0
            if wait_s >= PAUSE_S:
                await asyncio.sleep(wait_s)
                in_turn = 0
            # hand it to the hub, and give the loop a turn now and then
            played += 1
            in_turn += 1
            frames = channel.parser.feed_datagram(entry.raw)
            if frames:
                self.host.on_frames(channel, frames, self.loop.time())
            if in_turn >= RECORDS_PER_TURN:
                in_turn = 0
                await asyncio.sleep(0 if speed else PAUSE_S)
        return played

    async def _play_raw(self, file: FileWindow, channel: ReplayChannel) -> int:
        """Play all bytes once, at the configured rate; returns their number."""
        rate = self.config.raw_bytes_per_s * self.config.speed
        step = max(1, min(round(rate * RAW_STEP_S), RAW_BYTES_PER_TURN)) if rate else RAW_BYTES_PER_TURN
        due = self.loop.time()
        for at in range(0, len(file), step):
            channel.intake.feed(file[at : at + step])
            if rate:
                due += step / rate
                await asyncio.sleep(max(due - self.loop.time(), 0.0))
            else:
                await asyncio.sleep(PAUSE_S)
        channel.intake.rescue()
        return len(file)


def _explain(error: OSError) -> str:
    match error.errno:
        case errno.ENOENT:
            return "no such file"
        case errno.EACCES:
            return "you may not read it"
        case errno.EISDIR:
            return "that is a directory; name the file"
        case _:
            return (error.strerror or str(error)).lower()
