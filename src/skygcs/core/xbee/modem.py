"""The module at our port: what may be given to it, what became of it, and which nodes it hears.

```
 closed ──start──> asking ──answers to every question, or ASK_S──> open ──restart reported──> asking
```

The module has few buffers, and what it cannot take it drops. So no more than WINDOW transmit requests are outstanding:
the next is given when a transmit status of an earlier one arrives, or after LOST_AFTER_S. Between, what waits stands in
the queues of the channels, where an emergency overtakes the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from skygcs.core.xbee.api_frames import (
    BROADCAST,
    ApiFrame,
    ApiParser,
    AtResponse,
    ModemStatus,
    ReceivePacket,
    TransmitStatus,
    at_command,
    decode,
    encode,
    transmit_request,
)

WINDOW = 3
"""Transmit requests outstanding. With one the air is idle while the status and the next request pass the port; with
three it never is, and an emergency waits for three others at most: 60 ms at 200 kbit/s on air, 0.7 s at 10 kbit/s."""

LOST_AFTER_S = 4.0
"""A transmit status comes after the last retry and, on an unknown route, after its discovery: 1.6 s and less with the
defaults of 900HP modules (unicast time, RR = 10). Later than this it was lost on the port."""

ASK_S = 1.0
"""Answers to local AT commands come within milliseconds."""

DEFAULT_PAYLOAD_BYTES = 72
"""Least of the maximum payloads (NP) of DigiMesh modules (72 on 2.4 GHz, 256 on 900HP): used until the module says."""

MOST_PAYLOAD_BYTES = 256
"""Greatest NP of any of these modules."""

QUESTIONS = ("NP", "SH", "SL", "AP", "HV", "VR", "ID", "CM")
"""AT commands that are sent to the module at the start: payload, own address, API mode, hardware, firmware, network."""

RESTARTED = frozenset({0, 1})
"""Modem status: hardware reset, watchdog reset."""

_DELIVERY = {
    0x00: "delivered",
    0x01: "no acknowledgement",
    0x02: "channel busy",
    0x21: "no acknowledgement from the network",
    0x24: "address not found",
    0x25: "no route",
    0x32: "out of buffers",
    0x74: "payload too large",
    0x75: "indirect message not requested",
}

State = Literal["closed", "asking", "open"]


@dataclass(slots=True)
class NodeStats:
    """Counts of what was sent to one node, and what came from it."""

    sent: int = 0
    delivered: int = 0
    failed: int = 0
    retries: int = 0
    """By the modules, for what was delivered."""
    unknown: int = 0
    """Requests without a status."""
    last_failure: str | None = None
    rx_packets: int = 0

    def as_dict(self) -> dict[str, Any]:
        return {
            "sent": self.sent,
            "delivered": self.delivered,
            "failed": self.failed,
            "retries": self.retries,
            "unknown": self.unknown,
            "last_failure": self.last_failure,
            "rx_packets": self.rx_packets,
        }


@dataclass(frozen=True, slots=True)
class _Outstanding:
    address: int
    at: float


@dataclass(slots=True)
class ModemCounters:
    """Counters of the module as a whole."""

    unasked: int = 0
    """Transmit statuses of no request that is outstanding: late ones, or of an earlier daemon."""
    restarts: int = 0
    other_frames: int = 0


@dataclass(slots=True)
class Heard:
    """Contents that bytes from the module brought."""

    packets: list[ReceivePacket] = field(default_factory=list)
    """Packets of any node: the link decides which nodes are its own, and admits them (`XBeeModem.admit`)."""
    questions: list[bytes] = field(default_factory=list)
    """Bytes to write to the port now, in place of what waits there: the module has restarted."""
    opened: bool = False
    """The module may be given payloads from now on (again)."""


class XBeeModem:
    """`start` when the port is open, `feed` with what comes, `transmit` while `has_room`, `expire` at `next_expiry`.

    Counters are kept of the nodes that the link admits, until it forgets them: strangers take no place."""

    def __init__(self, *, escaped: bool) -> None:
        self.escaped = escaped
        self.parser = ApiParser(decode, escaped=escaped)
        self.state: State = "closed"
        self.counters = ModemCounters()
        self.nodes: dict[int, NodeStats] = {}
        """Those that were admitted."""
        self.payload_bytes = DEFAULT_PAYLOAD_BYTES
        self._answers: dict[str, bytes] = {}
        self._asked_until = 0.0
        self._outstanding: dict[int, _Outstanding] = {}
        self._frame_id = 0

    def start(self, now: float) -> list[bytes]:
        """The port is open: the questions to write."""
        self.state = "asking"
        self._asked_until = now + ASK_S
        self._answers = {}
        self._outstanding = {}
        return [encode(at_command(self._next_id(), name), escaped=self.escaped) for name in QUESTIONS]

    def has_room(self) -> bool:
        """True if a payload may be given to the module."""
        return self.state == "open" and len(self._outstanding) < WINDOW

    @property
    def outstanding(self) -> int:
        """Transmit requests without a status."""
        return len(self._outstanding)

    def transmit(self, address: int, payload: bytes, now: float) -> bytes:
        """The bytes of a transmit request; only while `has_room`, with at most ``payload_bytes``."""
        assert self.has_room() and 0 < len(payload) <= self.payload_bytes
        frame_id = self._next_id()
        self._outstanding[frame_id] = _Outstanding(address, now)
        if (node := self.nodes.get(address)) is not None:
            node.sent += 1
        return encode(transmit_request(frame_id, address, payload), escaped=self.escaped)

    def admit(self, address: int) -> None:
        """A packet of `Heard` is of a node of the link's."""
        self.nodes.setdefault(address, NodeStats()).rx_packets += 1

    def forget(self, address: int) -> None:
        """The link has no such node any more."""
        self.nodes.pop(address, None)

    def feed(self, data: bytes, now: float) -> Heard:
        """Bytes from the port, in any split."""
        return self._take(self.parser.feed(data), now)

    def on_silence(self, now: float) -> Heard:
        """Nothing came for a while though a frame is not complete: a false start."""
        return self._take(self.parser.give_up(), now)

    def _take(self, frames: list[ApiFrame], now: float) -> Heard:
        heard = Heard()
        for frame in frames:
            match frame:
                case ReceivePacket() if frame.address != BROADCAST:
                    heard.packets.append(frame)
                case TransmitStatus():
                    self._on_status(frame)
                case AtResponse(address=None):
                    self._on_answer(frame, heard)
                case ModemStatus() if frame.status in RESTARTED:
                    self.counters.restarts += 1
                    heard.questions = self.start(now)
                case _:
                    self.counters.other_frames += 1
        return heard

    def next_expiry(self) -> float | None:
        """When `expire` is due; None: not before something else happens."""
        times = [out.at + LOST_AFTER_S for out in self._outstanding.values()]
        if self.state == "asking":
            times.append(self._asked_until)
        return min(times, default=None)

    def expire(self, now: float) -> bool:
        """Give up what was not answered. True if `has_room` may have become true."""
        late = [frame_id for frame_id, out in self._outstanding.items() if now >= out.at + LOST_AFTER_S]
        for frame_id in late:
            out = self._outstanding.pop(frame_id)
            if (node := self.nodes.get(out.address)) is not None:
                node.unknown += 1
        if self.state == "asking" and now >= self._asked_until:
            self.state = "open"
            return True
        return bool(late)

    def why_mute(self) -> str | None:
        """Why the module does not answer, once it had the time to; None if it does."""
        if self.state != "open" or self._answers:
            return None
        mode = "AP=2" if self.escaped else "AP=1"
        return (
            f"no module answers in API mode ({mode}): check the baud rate and its AP setting "
            "(skygcs-cli xbee show PORT finds both)"
        )

    def why_wrong_mode(self) -> str | None:
        """Return what is wrong with the module's API mode; None if it is right, or not known."""
        answer = self._answers.get("AP")
        wanted = 2 if self.escaped else 1
        if not answer or answer[-1] == wanted:
            return None
        return f"the module's AP is {answer[-1]}, this link's api_mode is {wanted}: set one of them"

    def status(self) -> dict[str, Any]:
        """JSON-able: settings of the module and counters."""
        answers = self._answers
        own = answers.get("SH", b"").rjust(4, b"\0") + answers.get("SL", b"").rjust(4, b"\0")
        return {
            "state": self.state,
            "address": own.hex().upper() if "SL" in answers else None,
            "network_id": answers["ID"].hex().upper().lstrip("0") or "0" if "ID" in answers else None,
            "hardware": answers["HV"].hex().upper() if "HV" in answers else None,
            "firmware": answers["VR"].hex().upper() if "VR" in answers else None,
            "payload_bytes": self.payload_bytes,
            "outstanding": self.outstanding,
            "unasked": self.counters.unasked,
            "restarts": self.counters.restarts,
            "other_frames": self.counters.other_frames,
            "bad_checksum": self.parser.stats.bad_checksum,
            "skipped_bytes": self.parser.stats.skipped_bytes,
        }

    # -- the inside

    def _next_id(self) -> int:
        """Frame ids 1 to 255 in turn; 0 would ask for no status. One that is outstanding is passed over."""
        while True:
            self._frame_id = self._frame_id % 255 + 1
            if self._frame_id not in self._outstanding:
                return self._frame_id

    def _on_status(self, status: TransmitStatus) -> None:
        out = self._outstanding.pop(status.frame_id, None)
        if out is None:
            self.counters.unasked += 1
            return
        node = self.nodes.get(out.address)
        if node is None:
            return
        if status.delivery == 0:
            node.delivered += 1
            node.retries += status.retries
            return
        node.failed += 1
        node.last_failure = _DELIVERY.get(status.delivery, f"delivery status 0x{status.delivery:02X}")

    def _on_answer(self, answer: AtResponse, heard: Heard) -> None:
        if answer.command not in QUESTIONS:
            return
        self._answers[answer.command] = answer.value if answer.status == 0 else b""
        if answer.command == "NP" and answer.status == 0 and answer.value:
            self.payload_bytes = min(max(int.from_bytes(answer.value, "big"), 1), MOST_PAYLOAD_BYTES)
        if self.state == "asking" and len(self._answers) == len(QUESTIONS):
            self.state = "open"
            heard.opened = True
