"""MAVLink FTP: its packets, and the download of one file, whole and exact or failed. Files are only read. Pure.

The 251 bytes of FILE_TRANSFER_PROTOCOL and the words in them: https://mavlink.io/en/services/ftp.html (little-endian;
req_opcode and offset of a reply are those of the request it answers, its seq_number is the request's plus one).

Rule: everything that decides how a download goes on is in this file.

    state      what came                                      next       effects
    --------   --------------------------------------------   --------   -------------------------------------------
    IDLE       start                                          OPENING    OpenFileRO
    OPENING    its Ack                                        BURSTING   BurstReadFile (in turn: FILLING, ReadFile)
    OPENING    NAK: somebody else has a file open             BUSY       TerminateSession
    OPENING    NAK: anything else                             DONE       Finish: unknown or denied
    OPENING    timer, repeats left                            OPENING    the same OpenFileRO
    BUSY       timer                                          OPENING    OpenFileRO, of the next session
    BURSTING   data                                           BURSTING   Report (burst_complete: BurstReadFile)
    BURSTING   NAK: end of file; timer: nothing for a while   FILLING    ReadFile of what is missing
    FILLING    data; NAK: end of file                         FILLING    Report, the next ReadFile
    FILLING    timer: an answer overdue, or its turn          FILLING    ReadFile
    BURSTING, FILLING   NAK: the session is gone              OPENING    TerminateSession, OpenFileRO, next session
    BURSTING, FILLING   the last byte                         DONE       TerminateSession, Finish: accepted
    BURSTING, FILLING   silent too long, or given up          DONE       TerminateSession, Finish: timeout or incomplete
    not DONE   stop (cancelled, vehicle lost, ...)            DONE       TerminateSession, Finish: as given
    DONE       anything                                       DONE       -

A file is read in blocks of one size from multiples of it, since ArduPilot lays some files out by the size of the reads
and refuses another one in the same session. Only its end shows how long the file is: a block that is not full, or the
NAK of a read behind it. The size in an Ack of OpenFileRO is a guess for files that are made up while they are read.
ArduPilot sends a burst to its end, whatever comes meanwhile, and has one session for all ground stations; it closes one
of which nothing was heard for 3 s, which is why a lost TerminateSession is not repeated. Each session has its own
number, so that what is late from the last one is not taken for this one's.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum, auto

from skygcs.core.protocols.base import Effect, Finish, ProgressReport, ProtocolMachine, Send, SlidingWindow

# --- packets ----------------------------------------------------------------------------------------------------------

MESSAGE = "FILE_TRANSFER_PROTOCOL"

CAPABILITY_FTP = 1 << 5
"""MAV_PROTOCOL_CAPABILITY_FTP of AUTOPILOT_VERSION."""

PAYLOAD_BYTES = 251
MAX_DATA_BYTES = 239
"""Data bytes of one packet: the payload without its header of 12 bytes."""

FRAME_BYTES = 12 + 3 + PAYLOAD_BYTES
"""A full packet as a MAVLink 2 frame: header and checksum, target fields, payload."""

_PAYLOAD_AT = 3
"""Behind target_network, target_system and target_component."""

_HEAD = struct.Struct("<HBBBBBxI")


class Op(IntEnum):
    """opcode: what is asked for, or how it was answered."""

    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    OPEN_FILE_RO = 4
    READ_FILE = 5
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


class Error(IntEnum):
    """The first byte of a NAK's data."""

    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    END_OF_FILE = 6
    UNKNOWN_COMMAND = 7
    FILE_EXISTS = 8
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


ERROR_TEXTS = {
    Error.FAIL: "it failed",
    Error.INVALID_DATA_SIZE: "the request had a wrong size",
    Error.INVALID_SESSION: "the session is not open",
    Error.NO_SESSIONS_AVAILABLE: "no session is free",
    Error.END_OF_FILE: "the file ended",
    Error.UNKNOWN_COMMAND: "it does not know the command",
    Error.FILE_PROTECTED: "the file is protected",
    Error.FILE_NOT_FOUND: "it has no such file",
}


@dataclass(frozen=True, slots=True)
class Packet:
    """One request or reply. ``opcode`` and ``req_opcode`` are plain numbers: others than `Op`'s may come.

    ``size``: of the data, or how much is asked for; None: as long as ``data`` is.
    """

    seq: int
    session: int
    opcode: int
    data: bytes = b""
    size: int | None = None
    req_opcode: int = 0
    burst_complete: bool = False
    offset: int = 0

    @property
    def error(self) -> int:
        """Error code of a NAK; 0 if it has none."""
        return self.data[0] if self.data else 0


def encode(packet: Packet) -> bytes:
    """The field ``payload``. Raises ValueError for more data than a packet holds, struct.error for large numbers."""
    if len(packet.data) > MAX_DATA_BYTES:
        raise ValueError(f"{len(packet.data)} bytes do not fit into a packet of {MAX_DATA_BYTES}")
    size = len(packet.data) if packet.size is None else packet.size
    head = _HEAD.pack(
        packet.seq, packet.session, packet.opcode, size, packet.req_opcode, packet.burst_complete, packet.offset
    )
    return (head + packet.data).ljust(PAYLOAD_BYTES, b"\0")


def decode(frame_payload: bytes) -> Packet | None:
    """Return what a FILE_TRANSFER_PROTOCOL frame's payload, trimmed or not, says as a reply; None if its size cannot
    be."""
    raw = frame_payload[_PAYLOAD_AT:].ljust(PAYLOAD_BYTES, b"\0")
    seq, session, opcode, size, req_opcode, burst_complete, offset = _HEAD.unpack_from(raw)
    if size > MAX_DATA_BYTES:
        return None
    data = raw[_HEAD.size : _HEAD.size + size]
    return Packet(seq, session, opcode, data, size, req_opcode, bool(burst_complete), offset)


def error_text(packet: Packet) -> str:
    """Return what a NAK says, for a person."""
    if packet.error == Error.FAIL_ERRNO and len(packet.data) > 1:
        return f"it failed with error number {packet.data[1]}"
    try:
        return ERROR_TEXTS[Error(packet.error)]
    except (KeyError, ValueError):
        return f"it failed (error {packet.error})"


# --- file download ----------------------------------------------------------------------------------------------------


WINDOW = 4
"""Reads under way. ArduPilot queues 5 requests and forgets what does not fit."""

OPEN_TRIES = 8
MOST_OPEN_WAIT_S = 2.0
"""Requests of one OpenFileRO, 1 s and then 2 s apart: a vehicle that answers none within 15 s will not."""

BUSY_WAIT_S = 3.5
"""ArduPilot closes a session that was silent for 3 s."""

MAX_SESSIONS = 5
"""Opened for one file, because another ground station had one open or the vehicle lost it."""

BURST_QUIET_S = 2.0
"""A burst in which nothing new came for so long is over: ArduPilot sends a packet every 1.4 s into 57600 baud's
tenth, of which it takes a third."""

MAX_TRIES = 20
"""Reads of one block. With 20 % lost each way, one block in 700 million needs more."""

SILENCE_S = 20.0
"""A vehicle that answers no read for so long will not."""

BUSY_ERRORS = frozenset({Error.FAIL, Error.INVALID_SESSION, Error.NO_SESSIONS_AVAILABLE})
"""Errors with which a vehicle answers OpenFileRO while it has a file open."""


@dataclass(frozen=True, slots=True)
class FileProgress:
    """How far a download is; ``size`` is the vehicle's own guess, None while not known."""

    received: int
    size: int | None
    sent: int
    elapsed_s: float


@dataclass(frozen=True, slots=True)
class FileOutcome:
    """``data``: the whole file if ``ok``, else nothing.

    ``result`` is accepted, unknown (no such file), denied, busy, incomplete, timeout, too_large, cancelled or lost.
    """

    ok: bool
    result: str
    message: str
    data: bytes
    sent: int
    elapsed_s: float


class FileState(Enum):
    IDLE = auto()
    OPENING = auto()
    BUSY = auto()
    BURSTING = auto()
    FILLING = auto()
    DONE = auto()


class FileDownload(ProtocolMachine):
    """See the table at the top. Only replies of this vehicle to us may be handed in.

    ``session`` (0 to 255): the number of its first session; the next download had better begin with another one.
    ``burst``: have the vehicle send all at once, at its own pace, and fill the gaps. Else: block after block, and
    ``bytes_per_s`` is what the answers may take of the link (None: as fast as the window lets them).
    """

    def __init__(
        self,
        path: str,
        *,
        session: int,
        max_bytes: int,
        burst: bool = False,
        bytes_per_s: float | None = None,
        window: int = WINDOW,
    ) -> None:
        self._path = path.encode()
        if not 0 < len(self._path) <= MAX_DATA_BYTES:
            raise ValueError(f"the path {path!r} does not fit into one packet")
        # state and outcome
        self.state = FileState.IDLE
        self.outcome: FileOutcome | None = None
        self.sent = 0
        """Messages sent: at most MAX_SESSIONS * (OPEN_TRIES + 2) and, in each session, MAX_TRIES for each block and one
        for each burst."""
        # the session and its requests
        self.session = session & 0xFF
        self._max_blocks = -(-max_bytes // MAX_DATA_BYTES)
        self._max_bytes = max_bytes
        self._bursts = burst
        spacing_s = 0.0 if bytes_per_s is None else FRAME_BYTES / bytes_per_s
        self._reads = SlidingWindow(
            self._next_unread, self._is_missing, size=window, spacing_s=spacing_s, max_tries=MAX_TRIES
        )
        # progress
        self._started = 0.0
        self._heard = 0.0
        self._seq = 0
        self._sessions = 0
        self._percent = -1
        self._size: int | None = None
        self._forget()

    def _forget(self) -> None:
        """Nothing of the file is known."""
        self._opens = 0
        self._open_seq = -1
        self._blocks: dict[int, bytes] = {}
        self._end: int | None = None
        """Number of blocks, an empty one behind full ones not counted; None while not known."""
        self._highest = -1
        self._burst_from = 0
        self._reads.clear()
        self._block_of: dict[int, int] = {}
        """By the sequence number of each read."""
        self._next_block = 0

    @property
    def done(self) -> bool:
        return self.state is FileState.DONE

    def progress(self, now: float) -> FileProgress:
        return FileProgress(sum(map(len, self._blocks.values())), self._size, self.sent, now - self._started)

    def start(self, now: float) -> tuple[Effect, ...]:
        assert self.state is FileState.IDLE, "start is called once"
        self._started = now
        return self._open(now)

    def on_reply(self, reply: Packet, now: float) -> tuple[Effect, ...]:
        """Any packet of this vehicle to us."""
        if self.state is FileState.OPENING:
            return self._on_open_reply(reply, now)
        if self.state not in (FileState.BURSTING, FileState.FILLING) or reply.session != self.session:
            return ()
        if reply.req_opcode not in (Op.READ_FILE, Op.BURST_READ_FILE):
            return ()
        if reply.opcode == Op.ACK:
            return self._on_data(reply, now)
        return self._on_read_nak(reply, now) if reply.opcode == Op.NAK else ()

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        match self.state:
            case FileState.OPENING if self._opens == OPEN_TRIES:
                return self._finish(now, "timeout", f"no answer to {OPEN_TRIES} requests to open the file")
            case FileState.OPENING:
                return self._ask_to_open(now)
            case FileState.BUSY:
                return self._open(now)
            case _:
                self.state = FileState.FILLING
                return self._fill(now)

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        """End it from outside. The vehicle closes the session, after a burst that it is sending."""
        if self.state in (FileState.IDLE, FileState.DONE):
            return ()
        return self._finish(now, result, message)

    # -- opening

    def _open(self, now: float) -> tuple[Effect, ...]:
        """The file, in a session of its own number, from its beginning."""
        if self._sessions:
            self.session = (self.session + 1) & 0xFF
        self._sessions += 1
        self._forget()
        self.state = FileState.OPENING
        self._seq = (self._seq + 1) & 0xFFFF
        self._open_seq = self._seq
        return self._ask_to_open(now)

    def _ask_to_open(self, now: float) -> tuple[Effect, ...]:
        """With the same sequence number each time: ArduPilot gives the same answer again then."""
        self.deadline = now + min(self._reads.timeout.seconds * (1 + self._opens), MOST_OPEN_WAIT_S)
        self._opens += 1
        return (self._send(Packet(self._open_seq, self.session, Op.OPEN_FILE_RO, self._path)),)

    def _on_open_reply(self, reply: Packet, now: float) -> tuple[Effect, ...]:
        if reply.req_opcode != Op.OPEN_FILE_RO or reply.seq != (self._open_seq + 1) & 0xFFFF:
            return ()
        if reply.opcode == Op.NAK:
            return self._on_open_nak(reply, now)
        if reply.opcode != Op.ACK:
            return ()
        self.session = reply.session  # PX4 gives the number
        self._heard = now
        if len(reply.data) == 4:
            self._size = int.from_bytes(reply.data, "little") or None
        if not self._bursts:
            self.state = FileState.FILLING
            return self._fill(now)
        self.state = FileState.BURSTING
        return self._burst(0, now)

    def _on_open_nak(self, reply: Packet, now: float) -> tuple[Effect, ...]:
        if reply.error in BUSY_ERRORS:
            if self._sessions == MAX_SESSIONS:
                return self._finish(now, "busy", f"it could not be opened: {error_text(reply)}")
            self.state = FileState.BUSY
            self.deadline = now + BUSY_WAIT_S
            return (self._terminate(),)  # an answer to an earlier request may have been lost
        result = "unknown" if reply.error == Error.FILE_NOT_FOUND else "denied"
        return self._finish(now, result, f"it could not be opened: {error_text(reply)}")

    def _reopen(self, reply: Packet, now: float) -> tuple[Effect, ...]:
        if self._sessions == MAX_SESSIONS:
            return self._finish(now, "incomplete", f"it was lost {MAX_SESSIONS} times: {error_text(reply)}")
        return (self._terminate(), *self._open(now))

    # -- reading

    def _burst(self, block: int, now: float) -> tuple[Effect, ...]:
        self._burst_from = block
        self._seq = (self._seq + 1) & 0xFFFF
        self.deadline = now + BURST_QUIET_S
        offset = block * MAX_DATA_BYTES
        return (self._send(Packet(self._seq, self.session, Op.BURST_READ_FILE, b"", MAX_DATA_BYTES, offset=offset)),)

    def _on_data(self, reply: Packet, now: float) -> tuple[Effect, ...]:
        block, rest = divmod(reply.offset, MAX_DATA_BYTES)
        if rest or not reply.data:
            return ()
        if block >= self._max_blocks:
            return self._finish(now, "too_large", f"it is larger than {self._max_bytes} bytes")
        self._heard = now
        self._seq = self._later(reply.seq)
        self._reads.answered(block, now, measure=reply.req_opcode == Op.READ_FILE)
        new = block not in self._blocks
        self._blocks[block] = reply.data
        self._highest = max(self._highest, block)
        if len(reply.data) < MAX_DATA_BYTES:
            self._ends_after(block + 1)
        if self._whole:
            return self._complete(now)
        if self.state is FileState.FILLING:
            return self._report() + self._fill(now)
        if reply.burst_complete and self._highest >= self._burst_from:
            return self._report() + self._burst(self._highest + 1, now)
        if new:
            self.deadline = now + BURST_QUIET_S
        return self._report()

    def _on_read_nak(self, reply: Packet, now: float) -> tuple[Effect, ...]:
        self._seq = self._later(reply.seq)
        if reply.req_opcode == Op.BURST_READ_FILE:
            if self.state is not FileState.BURSTING:
                return ()
            # where it ends is read, not believed: the NAK's offset is that of the last block if this is full
            self.state = FileState.FILLING
            return self._fill(now) if reply.error == Error.END_OF_FILE else self._reopen(reply, now)
        block = self._block_of.get((reply.seq - 1) & 0xFFFF)
        if block is None:
            return ()
        if reply.error != Error.END_OF_FILE:
            return self._reopen(reply, now) if block in self._reads else ()
        self._heard = now
        self._reads.answered(block, now, measure=False)
        self._ends_after(block)
        return self._complete(now) if self._whole else self._fill(now)

    def _ends_after(self, blocks: int) -> None:
        self._end = blocks if self._end is None else min(self._end, blocks)

    @property
    def _whole(self) -> bool:
        return self._end is not None and all(block in self._blocks for block in range(self._end))

    def _complete(self, now: float) -> tuple[Effect, ...]:
        assert self._end is not None
        data = b"".join(self._blocks[block] for block in range(self._end))
        if self._highest >= self._end:
            return self._finish(now, "incomplete", "its length changed while it was read")
        return self._finish(now, "accepted", f"{len(data)} bytes", data)

    def _fill(self, now: float) -> tuple[Effect, ...]:
        """Read what is missing, as many blocks as may be under way, in their turns; sets the deadline."""
        if now >= self._heard + SILENCE_S:  # as the deadline is reckoned: a rounding must not ask for it again
            return self._finish(now, "timeout", f"nothing more of it came for {SILENCE_S:.0f} s")
        blocks = self._reads.advance(now)
        if self._reads.given_up:
            return self._finish(now, "incomplete", f"incomplete after {MAX_TRIES} reads of one part")
        self.deadline = min(self._reads.due, self._heard + SILENCE_S)
        return tuple(self._read(block) for block in blocks)

    def _next_unread(self) -> int | None:
        """The next block that was not read yet; one behind the highest that came, if the end is not known."""
        while self._next_block in self._blocks:
            self._next_block += 1
        if not self._is_missing(self._next_block) or self._next_block >= self._max_blocks + 1:
            return None
        self._next_block += 1
        return self._next_block - 1

    def _is_missing(self, block: int) -> bool:
        return block not in self._blocks and (self._end is None or block < self._end)

    def _read(self, block: int) -> Send:
        self._seq = (self._seq + 1) & 0xFFFF
        self._block_of[self._seq] = block
        offset = block * MAX_DATA_BYTES
        return self._send(Packet(self._seq, self.session, Op.READ_FILE, b"", MAX_DATA_BYTES, offset=offset))

    # -- all of it

    def _later(self, seq: int) -> int:
        """The later one of ours and the vehicle's: a burst has counted on, and a number used twice may be answered by
        what was said last (ArduPilot)."""
        return seq if (seq - self._seq) & 0xFFFF < 0x8000 else self._seq

    def _send(self, packet: Packet) -> Send:
        self.sent += 1
        return Send(MESSAGE, {"payload": encode(packet)})

    def _terminate(self) -> Send:
        self._seq = (self._seq + 1) & 0xFFFF
        return self._send(Packet(self._seq, self.session, Op.TERMINATE_SESSION))

    def _report(self) -> tuple[Effect, ...]:
        percent = None if self._size is None else min(99, 100 * len(self._blocks) * MAX_DATA_BYTES // self._size)
        if percent == self._percent:
            return ()
        self._percent = -1 if percent is None else percent
        return (ProgressReport(percent),)

    def _finish(self, now: float, result: str, message: str, data: bytes = b"") -> tuple[Effect, ...]:
        self.state = FileState.DONE
        self.deadline = None
        goodbye = () if result == "lost" else (self._terminate(),)
        self.outcome = FileOutcome(result == "accepted", result, message, data, self.sent, now - self._started)
        return (*goodbye, Finish())
