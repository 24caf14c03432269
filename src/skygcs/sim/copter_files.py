"""ArduCopter's MAVLink FTP server, as far as it serves @PARAM/param.pck: one session for all, as in GCS_FTP.cpp.

no session --OpenFileRO--> open --TerminateSession, or 3 s of silence and another session's request--> no session
A request whose sequence number is that of the last one has the last answer again. All reads of a session have one size,
by which the file is laid out.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace

from skygcs.core.protocols.ftp import MAX_DATA_BYTES, MESSAGE, Error, Op, Packet, decode, encode
from skygcs.sim import protocol as m
from skygcs.sim.param_table import Param
from skygcs.sim.vehicle_state import VehicleState

Sender = tuple[int, int]

PATH = b"@PARAM/param.pck"

SESSION_TIMEOUT_S = 3.0
BURST_PACKETS = 500
"""FTP_SESSION_TIMEOUT and transfer_size of GCS_FTP.cpp."""

PACKETS_PER_TICK = 2
"""100 a second, 27 kB/s: a third of what USB at 921600 baud carries."""

GUESSED_BYTES = 12
"""Bytes of a parameter by estimate: OpenFileRO reports an estimated size."""

EINVAL = 22

_KINDS = {
    m.MAV_PARAM_TYPE_INT8: (1, struct.Struct("<b")),
    m.MAV_PARAM_TYPE_INT16: (2, struct.Struct("<h")),
    m.MAV_PARAM_TYPE_INT32: (3, struct.Struct("<i")),
}
_FLOAT = (4, struct.Struct("<f"))
"""AP_Param's number of a type."""


def packed(params: Iterable[Param], read_bytes: int) -> bytes:
    """The file as it is laid out for reads of this size."""
    entries = list(params)
    out = bytearray(struct.pack("<HHH", 0x671B, len(entries), len(entries)))
    last = b""
    for param in entries:
        name = param.name.encode()
        common = next(
            (i for i, (a, b) in enumerate(zip(name, last, strict=False)) if a != b), min(len(name), len(last))
        )
        common = min(common, len(name) - 1)
        kind, layout = _KINDS.get(param.type, _FLOAT)
        value = param.value if kind == 4 else round(param.value)
        entry = bytes([kind, common | (len(name) - common - 1) << 4]) + name[common:] + layout.pack(value)
        beyond = (len(out) + len(entry)) % read_bytes
        if 0 < beyond < layout.size:  # the value would lie across two reads
            out += bytes(layout.size - beyond)
        out += entry
        last = name
    return bytes(out)


@dataclass(slots=True)
class _Burst:
    request: Packet
    to: Sender
    sent: int = 0


class FileServer:
    """One vehicle's; `hear` answers at once, `step` goes on with a burst."""

    def __init__(self) -> None:
        self.session: int | None = None
        """The open one."""
        self._read_bytes = 0
        self._content = b""
        self._last: tuple[Sender, Packet] | None = None
        self._active_at = 0.0
        self._burst: _Burst | None = None
        self._waiting: list[tuple[Packet, Sender]] = []

    def hear(self, v: VehicleState, payload: bytes, sender: Sender, now: float) -> None:
        """The message's payload field, as it came."""
        request = decode(b"\0\0\0" + payload)
        if request is None:
            return
        if self._burst is not None:  # its one worker is busy; it queues five
            if len(self._waiting) < 5:
                self._waiting.append((request, sender))
            return
        self._handle(v, request, sender, now)

    def step(self, v: VehicleState, now: float) -> None:
        for _ in range(PACKETS_PER_TICK):
            if self._burst is None:
                break
            self._next_of_burst(v, self._burst, now)
        while self._burst is None and self._waiting:
            self._handle(v, *self._waiting.pop(0), now)

    def _handle(self, v: VehicleState, request: Packet, sender: Sender, now: float) -> None:
        if self._last is not None:
            to, last = self._last
            if to == sender and last.session == request.session and (request.seq + 1) & 0xFFFF == last.seq:
                self._send(v, last, sender, now)
                return
        reply = self._answer(v, request, sender, now)
        if reply is not None:
            self._send(v, reply, sender, now)

    def _answer(self, v: VehicleState, request: Packet, sender: Sender, now: float) -> Packet | None:
        other = request.session != self.session
        if request.opcode in (Op.TERMINATE_SESSION, Op.RESET_SESSIONS):
            if not other:
                self.session = None
            return _ack(request)
        if self.session is not None and other:
            if now - self._active_at < SESSION_TIMEOUT_S:
                return _nak(request, Error.INVALID_SESSION)
            self.session = None
        match request.opcode:
            case Op.OPEN_FILE_RO:
                return self._open(v, request, now)
            case Op.READ_FILE | Op.BURST_READ_FILE if self.session is None:
                return _nak(request, Error.FILE_NOT_FOUND)
            case Op.READ_FILE:
                return self._read(v, request, request.offset)
            case Op.BURST_READ_FILE:
                self._burst = _Burst(request, sender)
                return None
            case _:
                return _nak(request, Error.FAIL)

    def _open(self, v: VehicleState, request: Packet, now: float) -> Packet:
        if self.session is not None and now - self._active_at <= SESSION_TIMEOUT_S:
            return _nak(request, Error.FAIL)
        if request.data != PATH:
            return _nak(request, Error.FILE_NOT_FOUND)
        self.session, self._read_bytes = request.session, 0
        return _ack(request, (GUESSED_BYTES * len(v.params)).to_bytes(4, "little"))

    def _read(self, v: VehicleState, request: Packet, offset: int) -> Packet:
        size = min(request.size or MAX_DATA_BYTES, MAX_DATA_BYTES)
        if self._read_bytes == 0:
            self._read_bytes = size
            self._content = packed(v.params, size)
        if size != self._read_bytes:
            return replace(_nak(request, Error.FAIL_ERRNO), data=bytes([Error.FAIL_ERRNO, EINVAL]))
        data = self._content[offset : offset + size]
        return replace(_ack(request, data), offset=offset) if data else _nak(request, Error.END_OF_FILE)

    def _next_of_burst(self, v: VehicleState, burst: _Burst, now: float) -> None:
        request = burst.request
        size = min(request.size or MAX_DATA_BYTES, MAX_DATA_BYTES)
        reply = self._read(v, request, request.offset + burst.sent * size)
        burst.sent += 1
        last = burst.sent == BURST_PACKETS
        if reply.opcode == Op.NAK or last:
            self._burst = None
        self._send(v, replace(reply, seq=(request.seq + burst.sent) & 0xFFFF, burst_complete=last), burst.to, now)

    def _send(self, v: VehicleState, reply: Packet, to: Sender, now: float) -> None:
        self._last = (to, reply)
        self._active_at = now
        fields = {"target_system": to[0], "target_component": to[1], "payload": encode(reply)}
        v.tx.send(MESSAGE, fields)


def _ack(request: Packet, data: bytes = b"") -> Packet:
    return Packet((request.seq + 1) & 0xFFFF, request.session, Op.ACK, data, req_opcode=request.opcode)


def _nak(request: Packet, error: Error) -> Packet:
    reply = _ack(request, bytes([error]))
    return replace(reply, opcode=Op.NAK)
