"""JSON-RPC 2.0 as lines of bytes, for both sides of every socket: lines within a limit, how messages begin, and the
reports of an order before its reply. No I/O, and no pydantic, for which a command of the shell would wait.

A line ends with a newline. Blank lines are ignored, and a line beyond the limit is skipped to its end.
https://www.jsonrpc.org/specification
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import Any, Protocol

MAX_LINE_BYTES = 1 << 20
"""Longest line that a daemon or a station takes. A request is a few hundred bytes, a full batch of the largest messages
some 100 kB."""

MAX_REPLY_BYTES = 32 << 20
"""Longest line that is taken from a daemon. It sends 8 MiB at most; a plan of 32 MiB goes to it, not from it."""

ANSWER = b'{"jsonrpc":"2.0","id":'
"""How a reply begins that is written here."""

_BLANK_LINES = re.compile(rb"[ \t\r\n\v\f]*\n")

Id = str | int | float | None


class LineTooLong(ValueError):
    """A line is longer than its reader takes."""

    def __init__(self, limit_bytes: int) -> None:
        super().__init__(f"a line has at most {limit_bytes} bytes")


class LineBuffer:
    """Bytes that have come on a connection and are no line yet. Each is searched once, however small the pieces are.

    Its owner bounds it: with `take`, which skips what is too long, or by its length after `take_whole`.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._searched = 0
        """Number of bytes at the beginning in which there is no newline."""
        self._skipping = False

    def __len__(self) -> int:
        return len(self._bytes)

    def feed(self, data: bytes) -> None:
        """Add what has come."""
        self._bytes += data

    def end(self) -> None:
        """Nothing more comes: what came last is a line, also without its newline."""
        if self._bytes and not self._bytes.endswith(b"\n"):
            self._bytes += b"\n"

    def clear(self) -> None:
        """Forget what has come."""
        self._bytes.clear()
        self._searched = 0

    def take(self, limit_bytes: int) -> bytes | None:
        """The next line without its newline; None: none is complete. Raises LineTooLong once for each line that is
        longer than the limit."""
        buffer = self._bytes
        while True:
            end = buffer.find(b"\n", self._searched)
            if (end if end >= 0 else len(buffer)) > limit_bytes and not self._skipping:
                self._skipping = True
                raise LineTooLong(limit_bytes)
            if end < 0:
                if self._skipping:
                    buffer.clear()
                self._searched = len(buffer)
                return None
            line = bytes(buffer[:end])
            del buffer[: end + 1]
            self._searched = 0
            if self._skipping:
                self._skipping = False
            elif line.strip():
                return line
            elif (blank := _BLANK_LINES.match(buffer, 0, limit_bytes + 1)) is not None:
                del buffer[: blank.end()]

    def take_whole(self) -> bytes:
        """All complete lines with their newlines, in one piece."""
        end = self._bytes.rfind(b"\n", self._searched) + 1
        lines = bytes(self._bytes[:end])
        del self._bytes[:end]
        self._searched = len(self._bytes)
        return lines


def is_id(value: object) -> bool:
    """True if a request may have this id."""
    return value is None or (isinstance(value, str | int | float) and not isinstance(value, bool))


def id_of(request: object) -> Id:
    """The id of a request; None: it has none, or one that no request may have."""
    value: Id = request.get("id") if isinstance(request, dict) else None
    return value if is_id(value) else None


def notification(method: str, params: bytes) -> bytes:
    """A notification, whose parameters are JSON."""
    return b'{"jsonrpc":"2.0","method":%b,"params":%b}' % (json.dumps(method).encode(), params)


def notification_start(method: str, member: str) -> bytes:
    """The beginning of a notification, to be followed by the value of its first parameter."""
    return b'{"jsonrpc":"2.0","method":"%b","params":{"%b":' % (method.encode(), member.encode())


TELEMETRY_START = notification_start("telemetry", "state")
EVENT_START = notification_start("event", "event")
MESSAGE_START = notification_start("message", "message")
PLAN_START = notification_start("plan", "plan")
"""How the notifications of subscriptions begin."""


JsonObject = dict[str, Any]

REPORT = "report"
"""The member of a request that asks for the outcomes as they come."""

BEGUN = "order.begun"
OUTCOME = "order.outcome"


class Notified(Protocol):
    """The client of a request."""

    def notify(self, method: str, params: JsonObject) -> None: ...


class Outcome(Protocol):
    """The outcome of an order for one vehicle."""

    def as_dict(self) -> JsonObject: ...


class OrderReports:
    """The notifications of one request: the outcome of each vehicle while its order is still under way.

    A request with the member `REPORT` ("report": true, beside "id") gets them with its id before its reply:

        order.begun     at the beginning           params: request, vehicles (the names that will have an outcome); at
                                                   a station with several sites once for ours and once for the others
        order.outcome   once for each vehicle      params: request, vehicle, outcome (as in the reply)

    The reply is the same as without it, and has every outcome: a notification may be left out for a client that does
    not read. A request without the member gets no notification.
    """

    def __init__(self, client: Notified, request_id: str | float) -> None:
        self._client = client
        self.request_id = request_id

    def begun(self, vehicles: Iterable[str]) -> None:
        """The order goes to these vehicles."""
        self._client.notify(BEGUN, {"request": self.request_id, "vehicles": list(vehicles)})

    def ended(self, vehicle: str, outcome: Outcome) -> None:
        """Report that the order has ended for one vehicle."""
        self.ended_with(vehicle, outcome.as_dict())

    def ended_with(self, vehicle: str, outcome: JsonObject) -> None:
        """`ended` with an outcome as the reply has it."""
        self._client.notify(OUTCOME, {"request": self.request_id, "vehicle": vehicle, "outcome": outcome})


def wants_reports(request: dict[str, Any]) -> str | float | None:
    """The id under which a request asks for reports; None: it does not, or has no id to report under."""
    return id_of(request) if request.get(REPORT) is True else None
