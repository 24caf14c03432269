"""The autopilot's onboard logs over MAVLink: the list of them, and one log, whole or resumed. Logs are only ever read.

`OnboardLogList`:

    state      what came                              next        effects
    --------   ------------------------------------   ---------   ------------------------------------------
    IDLE       start                                  LISTING     LOG_REQUEST_LIST of all
    LISTING    LOG_ENTRY                              LISTING     Report
    LISTING    the last missing one, or "there is     DONE        LOG_REQUEST_END, Finish: accepted
               none" (num_logs 0)
    LISTING    another num_logs                       LISTING     - (the list begins anew)
    LISTING    that, after MAX_CHANGES                DONE        LOG_REQUEST_END, Finish: incomplete
    LISTING    timer: quiet, tries left               LISTING     LOG_REQUEST_LIST of the missing range
    LISTING    timer: no tries left                   DONE        LOG_REQUEST_END, Finish: timeout or incomplete

`OnboardLogDownload` reads a log in chunks, each whole before the next, so that what is on disk has no gaps:

    state      what came                              next        effects
    --------   ------------------------------------   ---------   ------------------------------------------
    IDLE       start                                  READING     LOG_REQUEST_DATA of a chunk
    READING    LOG_DATA of this chunk                 READING     Report
    READING    the last of what was requested; quiet  READING     LOG_REQUEST_DATA of the first gap
    READING    the last gap of a chunk                READING     Chunk, LOG_REQUEST_DATA of the next (a share of
                                                      or PAUSING  the link: after a pause)
    PAUSING    timer                                  READING     LOG_REQUEST_DATA
    READING    the last chunk                         DONE        Chunk, LOG_REQUEST_END, Finish: accepted
    READING    quiet, no tries left                   DONE        LOG_REQUEST_END, Finish: timeout
    not DONE   stop                                   DONE        LOG_REQUEST_END, Finish: as given

What the firmwares do (ArduCopter 4.6.3, AP_Logger_MAVLinkLogTransfer.cpp; PX4 1.16.1, mavlink_log_handler.cpp).
ArduPilot numbers logs from 1, answers nothing while armed, and drops requests while it sends; what it sends ends with a
packet of fewer than 90 bytes or with the requested count. PX4 numbers them from 0, sends data only after a list, sends
the whole list from the first requested entry, does not answer a read behind the end, and is silent if it has no log. So
the end of a log is the size in its LOG_ENTRY, or an earlier short packet.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from skygcs.core.protocols.base import Chunk, Effect, Finish, ProgressReport, ProtocolMachine, Send

BLOCK_BYTES = 90
"""Data of one LOG_DATA."""

CHUNK_BLOCKS = 512
"""46 kB: one round trip of waiting for each chunk leaves 460 kB/s at 100 ms."""

RADIO_CHUNK_BLOCKS = 16
"""1.4 kB, half a second of a radio with 64 kbit/s: orders wait no longer for a vehicle's turn."""

QUIET_S = 0.5
MOST_QUIET_S = 1.5
"""Nothing came for so long: request again; doubled with each try that brings nothing."""

TRIES = 20
"""Requests without any new data: 28 s. With 30 % lost each way, one gap in 700,000 needs more."""

MAX_LOGS = 2000
"""ArduPilot keeps 500 at most, PX4 as many as the card holds; more entries are not kept."""

MAX_CHANGES = 100
"""How often the number of logs may change while they are listed. Each time the list begins anew; with two vehicles of
one id it would never end. Once is usual (a new log), a few tens if entries of before come late over a second link."""

MAX_LOG_BYTES = (1 << 32) - 1


@dataclass(frozen=True, slots=True)
class LogInfo:
    """One LOG_ENTRY. ``time_unix_s`` 0: the vehicle does not know it."""

    id: int
    size_bytes: int
    time_unix_s: int


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """``result`` is accepted, timeout, incomplete, cancelled, lost or refused."""

    ok: bool
    result: str
    message: str


class LogState(Enum):
    IDLE = auto()
    LISTING = auto()
    READING = auto()
    PAUSING = auto()
    DONE = auto()


class _LogMachine(ProtocolMachine):
    """Common part of both: one end, one number of tries without progress."""

    def __init__(self) -> None:
        self.state = LogState.IDLE
        self.outcome: LogOutcome | None = None
        self.sent = 0
        self._tries = 0
        self._quiet_s = QUIET_S

    @property
    def done(self) -> bool:
        return self.state is LogState.DONE

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        """End it from outside."""
        if self.state in (LogState.IDLE, LogState.DONE):
            return ()
        return self._finish(result, message)

    def _progress(self, now: float) -> None:
        """Something new came."""
        self._tries, self._quiet_s = 0, QUIET_S
        self.deadline = now + QUIET_S

    def _sent(self, now: float, message: str, values: dict[str, int]) -> Send:
        self.sent += 1
        self._tries += 1
        self.deadline = now + self._quiet_s
        self._quiet_s = min(2 * self._quiet_s, MOST_QUIET_S)
        return Send(message, values)

    def _finish(self, result: str, message: str) -> tuple[Effect, ...]:
        self.state, self.deadline = LogState.DONE, None
        self.outcome = LogOutcome(result == "accepted", result, message)
        goodbye: tuple[Effect, ...] = ()
        if result != "lost":  # else nobody is there to hear it
            self.sent += 1
            goodbye = (Send("LOG_REQUEST_END", {}),)
        return (*goodbye, Finish())


class OnboardLogList(_LogMachine):
    """See the table at the top. ``entries`` is complete if the outcome is ok."""

    def __init__(self) -> None:
        super().__init__()
        self.entries: dict[int, LogInfo] = {}
        self._count: int | None = None
        self._changes = 0

    def start(self, now: float) -> tuple[Effect, ...]:
        assert self.state is LogState.IDLE, "start is called once"
        self.state = LogState.LISTING
        return (self._sent(now, "LOG_REQUEST_LIST", {"start": 0, "end": 0xFFFF}),)

    def on_entry(self, info: LogInfo, count: int, now: float) -> tuple[Effect, ...]:
        """A LOG_ENTRY of this vehicle; ``count`` is its num_logs."""
        if self.state is not LogState.LISTING:
            return ()
        if count == 0:
            return self._finish("accepted", "it has no logs")
        if self._count is not None and count != self._count:
            if self._changes == MAX_CHANGES:
                text = f"its number of logs was another one {MAX_CHANGES + 1} times: do two vehicles have its id?"
                return self._finish("incomplete", text)
            self._changes += 1
            self.entries.clear()  # logs came or went
        self._count = count
        if info.id not in self.entries and len(self.entries) < MAX_LOGS:
            self.entries[info.id] = info
            self._progress(now)
        if len(self.entries) >= min(count, MAX_LOGS):
            return self._finish("accepted", f"{len(self.entries)} logs")
        return (ProgressReport(100 * len(self.entries) // count),)

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self._tries >= TRIES:
            if self._count is None:
                why = "no answer: it has no logs (PX4 says nothing then), or sends none on this link"
                return self._finish("timeout", why)
            return self._finish("incomplete", f"{len(self.entries)} of {self._count} entries came")
        first, last = self._missing()
        return (self._sent(now, "LOG_REQUEST_LIST", {"start": first, "end": last}),)

    def _missing(self) -> tuple[int, int]:
        """The range with all missing entries. ArduPilot's numbers begin with 1, PX4's with 0: while neither the first
        of a PX4 nor the last of an ArduPilot has come, both may be missing."""
        if self._count is None or not self.entries:
            return 0, 0xFFFF
        begin, end = (0, self._count) if 0 in self.entries else (self._count in self.entries, self._count + 1)
        missing = [n for n in range(begin, end) if n not in self.entries]
        return (missing[0], missing[-1]) if missing else (0, 0xFFFF)


class OnboardLogDownload(_LogMachine):
    """See the table at the top. ``received`` counts the bytes on disk and those of the chunk in progress.

    ``begin``: bytes of it that are there already, of whole chunks. ``shared``: use half of the time at most, and small
    chunks: the link is a radio that others need, too.
    """

    def __init__(self, info: LogInfo, *, begin: int = 0, shared: bool = False) -> None:
        super().__init__()
        self._chunk_blocks = RADIO_CHUNK_BLOCKS if shared else CHUNK_BLOCKS
        if begin % BLOCK_BYTES or not 0 <= begin <= info.size_bytes:
            raise ValueError(f"a log of {info.size_bytes} bytes is not resumed at {begin}")
        self.info = info
        self._shared = shared
        self._size = info.size_bytes
        self._begin = begin
        self._blocks: dict[int, bytes] = {}
        """Data blocks of this chunk, by number within it."""
        self._until = 0
        """The block behind those that were requested last."""
        self._began = 0.0
        self._percent = -1

    @property
    def received(self) -> int:
        return self._begin + sum(map(len, self._blocks.values()))

    @property
    def size(self) -> int:
        """Size as listed, or where it ended earlier."""
        return self._size

    def start(self, now: float) -> tuple[Effect, ...]:
        assert self.state is LogState.IDLE, "start is called once"
        self.state = LogState.READING
        if self._begin >= self._size:
            return self._finish("accepted", f"{self._size} bytes")
        return self._next_chunk(now)

    def on_data(self, log_id: int, offset: int, data: bytes, now: float) -> tuple[Effect, ...]:
        """A LOG_DATA of this vehicle, with ``count`` bytes of data."""
        if self.state is not LogState.READING or log_id != self.info.id:
            return ()
        number, rest = divmod(offset - self._begin, BLOCK_BYTES)
        if rest or not 0 <= number < self._chunk_blocks or offset >= self._size or len(data) > BLOCK_BYTES:
            return ()
        if len(data) < min(BLOCK_BYTES, self._size - offset):
            self._size = offset + len(data)  # it ends earlier than listed
            self._blocks = {n: block for n, block in self._blocks.items() if n < number}
        is_new = bool(data) and number not in self._blocks
        if is_new:
            self._blocks[number] = data[: self._size - offset]
            self._progress(now)
        if len(self._blocks) >= self._wanted():
            return self._chunk_done(now)
        if is_new and number + 1 >= min(self._until, self._wanted()):  # what was requested has been sent
            return (*self._report(), *self._request(now))
        return self._report()

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self.state is LogState.PAUSING:
            self.state = LogState.READING
            return self._next_chunk(now)
        if self._tries >= TRIES:
            text = f"nothing more came after {self.received} of {self._size} bytes; the same command goes on there"
            return self._finish("timeout", text)
        return self._request(now)

    # -- the inside

    def _wanted(self) -> int:
        """Blocks of this chunk."""
        left = -(-(self._size - self._begin) // BLOCK_BYTES)
        return max(0, min(left, self._chunk_blocks))

    def _next_chunk(self, now: float) -> tuple[Effect, ...]:
        self._blocks, self._began = {}, now
        return self._request(now)

    def _request(self, now: float) -> tuple[Effect, ...]:
        """The first gap."""
        wanted = self._wanted()
        first = next(n for n in range(wanted) if n not in self._blocks)
        self._until = next((n for n in range(first, wanted) if n in self._blocks), wanted)
        offset = self._begin + first * BLOCK_BYTES
        count = (self._until - first) * BLOCK_BYTES
        return (self._sent(now, "LOG_REQUEST_DATA", {"id": self.info.id, "ofs": offset, "count": count}),)

    def _chunk_done(self, now: float) -> tuple[Effect, ...]:
        data = b"".join(self._blocks[n] for n in range(self._wanted()))
        chunk = (Chunk(self._begin, data),) if data else ()
        self._begin += len(data)
        self._blocks = {}
        if self._begin >= self._size:
            return (*chunk, *self._finish("accepted", f"{self._size} bytes"))
        if not self._shared:
            return (*chunk, *self._report(), *self._next_chunk(now))
        self.state = LogState.PAUSING
        self.deadline = now + max(now - self._began, QUIET_S)
        return (*chunk, *self._report())

    def _report(self) -> tuple[Effect, ...]:
        percent = min(99, 100 * self.received // max(self._size, 1))
        if percent == self._percent:
            return ()
        self._percent = percent
        return (ProgressReport(percent),)
