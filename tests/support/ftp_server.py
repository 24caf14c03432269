"""A scripted MAVLink FTP server with ArduPilot's ways, and a bad network to it, all in the test's own time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from skygcs.core.protocols.base import Effect, Send
from skygcs.core.protocols.ftp import Error, Op, Packet, decode, encode
from support.param_vehicle import Delays, Network


@dataclass
class FtpServer:
    """One session, whose number the client gives; a burst's answers leave at once."""

    content: bytes
    burst_packets: int = 500
    session: int | None = None
    read_size: int | None = None
    requests: list[Packet] = field(default_factory=list)
    refuse: dict[int, int] = field(default_factory=dict)
    """By opcode: the error it is answered with."""
    last: Packet | None = None

    def hear(self, request: Packet) -> list[Packet]:
        self.requests.append(request)
        if self.last is not None and (request.session, request.seq + 1) == (self.last.session, self.last.seq):
            return [self.last]
        replies = self._answer(request)
        self.last = replies[-1]
        return replies

    def _answer(self, request: Packet) -> list[Packet]:
        ack = Packet((request.seq + 1) & 0xFFFF, request.session, Op.ACK, req_opcode=request.opcode)
        nak = replace(ack, opcode=Op.NAK)
        if request.opcode in self.refuse:
            return [replace(nak, data=bytes([self.refuse[request.opcode]]))]
        if request.opcode == Op.TERMINATE_SESSION:
            if self.session == request.session:
                self.session = None
            return [ack]
        if self.session is not None and self.session != request.session:
            return [replace(nak, data=bytes([Error.INVALID_SESSION]))]
        if request.opcode == Op.OPEN_FILE_RO:
            if self.session is not None:
                return [replace(nak, data=bytes([Error.FAIL]))]
            self.session, self.read_size = request.session, None
            return [replace(ack, data=len(self.content).to_bytes(4, "little"))]
        if self.session is None:
            return [replace(nak, data=bytes([Error.FILE_NOT_FOUND]))]
        assert request.size and self.read_size in (None, request.size), "ArduPilot lays a file out by one size"
        self.read_size = request.size
        most = self.burst_packets if request.opcode == Op.BURST_READ_FILE else 1
        replies: list[Packet] = []
        while len(replies) < most:
            offset = request.offset + len(replies) * request.size
            seq = (ack.seq + len(replies)) & 0xFFFF
            data = self.content[offset : offset + request.size]
            if not data:
                return [*replies, replace(nak, seq=seq, data=bytes([Error.END_OF_FILE]))]
            replies.append(replace(ack, seq=seq, data=data, offset=offset))
        if request.opcode == Op.BURST_READ_FILE:
            replies[-1] = replace(replies[-1], burst_complete=True)
        return replies


class FtpWire(Delays):
    """Runs a download against a server until it is done."""

    def __init__(self, server: FtpServer, network: Network, seed: int = 0) -> None:
        super().__init__(network, seed)
        self.server = server
        self.sent: list[tuple[float, Packet]] = []

    def run(self, exchange: Any, *, until: float = 3600.0) -> Any:
        """The outcome; None if it is not over ``until`` seconds after the beginning."""
        end = self.now + until
        self.carry(exchange, exchange.start(self.now))
        while not exchange.done:
            due = exchange.deadline
            if self.arrive_by(min(due, end)):
                continue
            if due > end:
                self.now = end
                return None
            self.now = max(self.now, due)
            self.carry(exchange, exchange.on_timer(self.now))
        return exchange.outcome

    def drain(self) -> None:
        """Let everything arrive that is still on its way."""
        while self.arrive_by(math.inf):
            pass

    def carry(self, exchange: Any, effects: tuple[Effect, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                packet = decode(b"\0\0\0" + effect.values["payload"])
                assert packet is not None
                self.sent.append((self.now, packet))
                self._through(lambda p=packet: self._arrive(exchange, p))  # type: ignore[misc]

    def _arrive(self, exchange: Any, request: Packet) -> None:
        for reply in self.server.hear(request):
            packet = decode(b"\0\0\0" + encode(reply).rstrip(b"\0"))
            assert packet is not None
            self._through(lambda p=packet: self.carry(exchange, exchange.on_reply(p, self.now)))  # type: ignore[misc]
