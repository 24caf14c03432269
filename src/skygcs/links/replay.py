"""A tlog or a raw capture, played as if it came from a link; it ends with the file."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Hashable
from typing import BinaryIO, overload

from skygcs.config import models
from skygcs.config.regular_file import open_regular
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.errors import LinkError
from skygcs.links.base import Channel, Link, LinkHost, Outgoing
from skygcs.links.stream import StreamIntake
from skygcs.tlog.format import iter_records, sniff

RECORDS_PER_TURN = 64
RAW_BYTES_PER_TURN = 4096
"""Most work without giving the loop a turn: below 1 ms for a daemon that spends 12 µs on a frame."""

LOOKS_PER_TURN = 64
"""The same for what is no record: places of damage or noise that are looked at for one, some 15 µs each."""

PAUSE_S = 0.001
"""At full speed, after each turn: for the recorder's writer, the sockets and everybody else."""

RAW_STEP_S = 0.02
"""A raw capture has no times and is fed in steps of this length."""

LONGEST_GAP_S = 10.0
"""A longer pause between two records is cut to this: the time between two flights in one file."""

WINDOW_BYTES = 65536


class FileWindow:
    """A file as a sequence of bytes, read piecewise. Not memory-mapped: if somebody truncates the file while it is
    played, a mapped one would kill the daemon by SIGBUS; here what is missing reads as nothing."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        self._window = b""
        self._start = 0

    def __len__(self) -> int:
        return self._size

    @overload
    def __getitem__(self, index: int, /) -> int: ...

    @overload
    def __getitem__(self, index: slice, /) -> bytes: ...

    def __getitem__(self, index: int | slice, /) -> int | bytes:
        if isinstance(index, slice):
            start, stop, _ = index.indices(self._size)
            return self._read(start, max(stop - start, 0))
        found = self._read(index, 1)
        return found[0] if found else 0

    def _read(self, start: int, size: int) -> bytes:
        at = start - self._start
        if at < 0 or at + size > len(self._window):
            self._file.seek(start)
            self._window = self._file.read(max(size, WINDOW_BYTES))
            self._start = start
            at = 0
        return self._window[at : at + size]


class ReplayChannel(Channel):
    """Hears the file; nobody hears what is sent to it."""

    def __init__(self, link: Link, peer: str) -> None:
        super().__init__(link, peer)
        self.intake = StreamIntake(self)

    def send(self, outgoing: Outgoing, priority: Priority = Priority.FORWARDED, key: Hashable | None = None) -> bool:
        self.tx_dropped += 1
        return False


class ReplayLink(Link):
    """Plays its file once, or again and again. Frames of both directions come from the one channel."""

    config: models.ReplayLink

    def __init__(self, config: models.ReplayLink, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
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
                if kind is None and len(window) > WINDOW_BYTES:  # some seconds for 16 MB of noise
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
        except Exception as error:  # a file that cannot be read on: this link's failure, nobody else's
            reason = _explain(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            self.fail(f"replay {self.config.file}: {reason}")
            return
        self.finished = True
        self.fail("finished: the end of the file")

    async def _play_tlog(self, file: FileWindow, channel: ReplayChannel) -> int:
        """Play all records once, each at its time; how many there were."""
        speed = self.config.speed
        due = self.loop.time()
        before_s = 0.0
        played = in_turn = 0
        reader = iter_records(file, self.host.dialect)
        while not reader.at_end:
            record = reader.find(LOOKS_PER_TURN)
            if record is None:
                await asyncio.sleep(0)
                continue
            if speed:
                due += min(max(record.elapsed_s - before_s, 0.0), LONGEST_GAP_S) / speed
                before_s = record.elapsed_s
                if due - self.loop.time() >= PAUSE_S:
                    await asyncio.sleep(due - self.loop.time())
                    in_turn = 0
            played += 1
            in_turn += 1
            frames = channel.parser.feed_datagram(record.raw)
            if frames:
                self.host.on_frames(channel, frames, self.loop.time())
            if in_turn >= RECORDS_PER_TURN:
                in_turn = 0
                await asyncio.sleep(0 if speed else PAUSE_S)
        return played

    async def _play_raw(self, file: FileWindow, channel: ReplayChannel) -> int:
        """Play all bytes once, at the configured rate; how many there were."""
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
