"""Streams setpoints to the daemon: one and the same at a rate, or the newest that the user's program wrote.

Each setpoint is good for so long; when the last one has run out, the vehicle stays where it then is. So nothing has to
be undone at the end: who stops or dies leaves vehicles that hold their places.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from skygcs.cli.setpoint_lines import LineError, LineReader, SplitLines
from skygcs.errors import RpcError
from skygcs.rpc.client import Client

READ_BYTES = 65536

MOST_WAITING = 256
"""Setpoints that wait at a time, one for each vehicle named; there are at most 255 system ids. Of a file that is flown
at a rate what was read at once (READ_BYTES) comes on top."""

MOST_REFUSED = 50
"""In a row: 5 s at the default rate, enough for a vehicle to be taken under control while its program runs already."""

LINE_ERRORS = (-32602, -32001)
"""Codes of the RPC for a line that says something impossible: wrong parameters, no such vehicle."""

ERRORS_TOLD = 10
"""Of lines that are none; a program that writes nonsense writes a lot of it."""

Setpoint = Mapping[str, Any]


@dataclass
class Tally:
    """What was sent, and what came of it."""

    sent: int = 0
    """Handed to the daemon, whatever it answered."""
    no_taker: int = 0
    """Of these, those that every vehicle refused."""
    skipped: int = 0
    """Not sent because a newer one was there, or because the daemon took longer than the time between two."""
    wrong_lines: int = 0
    outcomes: dict[str, dict[str, Any]] = field(default_factory=dict)
    """The last one of each vehicle."""
    refused: dict[str, str] = field(default_factory=dict)
    """Why, by vehicle, of all that refused at any time."""

    @property
    def ok(self) -> bool:
        return self.sent > 0 and not self.refused and not self.wrong_lines


class Sender:
    """Sends setpoints one after the other and tells news of them: ``tell(text)``."""

    def __init__(self, gcs: Client, valid_s: float, tell: Callable[[str], None]) -> None:
        self.tally = Tally()
        self.tell = tell
        self._gcs = gcs
        self._valid_s = valid_s

    async def send(self, targets: str, setpoint: Setpoint) -> bool:
        """Whether any vehicle took it. Raises RpcError as `Client.call`."""
        self.tally.sent += 1  # before the answer: who interrupts the waiting has sent it all the same
        answer = await self._gcs.call("control.setpoint", targets=targets, **setpoint, valid_s=self._valid_s)
        outcomes: dict[str, dict[str, Any]] = answer["outcomes"]
        news: dict[str, list[str]] = {}
        for name, outcome in outcomes.items():
            before = self.tally.outcomes.get(name)
            self.tally.outcomes[name] = outcome
            if not outcome["ok"]:
                self.tally.refused.setdefault(name, outcome["message"])
                if before is None or before["ok"] or before["message"] != outcome["message"]:
                    news.setdefault(outcome["message"], []).append(name)
            elif before is not None and not before["ok"]:
                self.tell(f"{name} takes setpoints again")
        for message, names in news.items():
            self.tell(f"{', '.join(names)}: {message}")
        taken = any(outcome["ok"] for outcome in outcomes.values())
        self.tally.no_taker += not taken
        return taken


async def repeat(sender: Sender, targets: str, setpoint: Setpoint, rate_hz: float, duration_s: float | None) -> None:
    """The same setpoint at a rate, on absolute times; ends early if no vehicle takes it."""
    clock = asyncio.get_running_loop().time
    began = clock()
    tick = 0
    while duration_s is None or tick < max(1, round(duration_s * rate_hz)):
        if not await sender.send(targets, setpoint):
            return
        late = int((clock() - began) * rate_hz) - tick
        sender.tally.skipped += max(0, late)
        tick += 1 + max(0, late)
        await asyncio.sleep(began + tick / rate_hz - clock())


class Inbox:
    """Setpoints that wait to be sent: of each vehicle the newest one."""

    def __init__(self, targets: str, tally: Tally, tell: Callable[[str], None], *, newest_only: bool) -> None:
        self._targets = targets
        self._tally = tally
        self._tell = tell
        self._newest_only = newest_only
        self._lines = SplitLines()
        self._reader = LineReader()
        self._waiting: list[tuple[int, str, Setpoint]] = []
        self._news = asyncio.Event()
        self.room = asyncio.Event()
        """Set while it takes more without dropping any."""
        self.room.set()
        self._ended = False

    def feed(self, data: bytes) -> None:
        """What was read; b"" is the end."""
        for number, line in self._lines.feed(data) if data else self._lines.end():
            try:
                if line is None:
                    raise LineError("too long for a setpoint")
                found = self._reader.read(line)
            except LineError as error:
                self.wrong(number, str(error))
                continue
            if found is not None:
                self._put(number, found[0] or self._targets, found[1])
        self._ended = self._ended or not data
        self._news.set()
        if len(self._waiting) >= MOST_WAITING:
            self.room.clear()

    async def take(self) -> tuple[int, str, Setpoint] | None:
        """The next one with its line, and for whom; None at the end."""
        while not self._waiting:
            if self._ended:
                return None
            self._news.clear()
            await self._news.wait()
        if len(self._waiting) <= MOST_WAITING:
            self.room.set()
        return self._waiting.pop(0)

    def _put(self, number: int, targets: str, setpoint: Setpoint) -> None:
        if self._newest_only:
            for i, (_, other, _) in enumerate(self._waiting):
                if other == targets:
                    self._waiting[i] = (number, targets, setpoint)
                    self._tally.skipped += 1
                    return
            if len(self._waiting) >= MOST_WAITING:
                self._waiting.pop(0)
                self._tally.skipped += 1
        self._waiting.append((number, targets, setpoint))

    def wrong(self, number: int, reason: str) -> None:
        """That line is no setpoint."""
        self._tally.wrong_lines += 1
        if self._tally.wrong_lines <= ERRORS_TOLD:
            self._tell(f"line {number}: {reason}")
            if self._tally.wrong_lines == ERRORS_TOLD:
                self._tell("further wrong lines are counted only")


async def forward(sender: Sender, targets: str, source: AsyncIterator[bytes], rate_hz: float | None) -> None:
    """Setpoints from the lines of ``source`` until it ends.

    Without a rate the source has the pace: each line is sent when it comes, the newest if they come faster than the
    daemon answers. With a rate all are sent, one after the other, that many a second: that is how a file is flown.
    """
    inbox = Inbox(targets, sender.tally, sender.tell, newest_only=rate_hz is None)
    clock = asyncio.get_running_loop().time

    async def fill() -> None:
        try:
            async for data in source:
                inbox.feed(data)
                if rate_hz is not None:
                    await inbox.room.wait()
        finally:
            inbox.feed(b"")

    filling = asyncio.create_task(fill(), name="setpoint lines")
    refused = 0
    due = clock()
    try:
        while (found := await inbox.take()) is not None:
            number, whom, setpoint = found
            try:
                refused = 0 if await sender.send(whom, setpoint) else refused + 1
            except RpcError as error:
                if error.code not in LINE_ERRORS:
                    raise
                inbox.wrong(number, str(error))
            if refused >= MOST_REFUSED:
                sender.tell(f"{refused} setpoints in a row were refused: no more are sent")
                return
            if rate_hz is not None:
                due = max(due + 1 / rate_hz, clock())
                await asyncio.sleep(due - clock())
    finally:
        filling.cancel()
        await asyncio.wait([filling])
    if not filling.cancelled():
        filling.result()  # raises what ended the reading


async def bytes_of(descriptor: int) -> AsyncIterator[bytes]:
    """What can be read there, as it comes: a pipe, a terminal or a file.

    Read by a thread of its own, which dies with the process: a loop cannot watch a file, and a read that waits for a
    program that writes nothing cannot be cancelled.
    """
    loop = asyncio.get_running_loop()
    taken = threading.Semaphore(1)
    queue: asyncio.Queue[bytes | OSError] = asyncio.Queue()

    def read() -> None:
        data: bytes | OSError = b"-"
        while data and not isinstance(data, OSError):
            taken.acquire()
            try:
                data = os.read(descriptor, READ_BYTES)
            except OSError as error:
                data = error
            try:
                loop.call_soon_threadsafe(queue.put_nowait, data)
            except RuntimeError:  # the loop is closed: nobody wants it any more
                return

    threading.Thread(target=read, name="stdin", daemon=True).start()
    while data := await queue.get():
        if isinstance(data, OSError):
            raise data
        yield data
        taken.release()
