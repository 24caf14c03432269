"""The record of orders from other stations: sender, time, order and outcome of each. Pure; JSON lines.

An order that is carried out has a line with the status "running", written before anything is sent to the vehicle, and
a second line when it ends; an order that is not carried out has one line. After a restart of the bridge the lines
restore the keys of the orders.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pydantic_core import from_json, to_json

from skygcs.ext.federation.protocol.order_gate import Remembered
from skygcs.ext.federation.protocol.order_messages import (
    STATUSES,
    Json,
    OrderReply,
    OrderRequest,
    Status,
    is_key,
)
from skygcs.ext.federation.protocol.received_json import MAX_TEXT_CHARS, printable
from skygcs.spelling import is_number

MAX_PARAMS_BYTES = 1024
"""Longer parameters are left out of the record: the daemon refuses an order with them."""

MAX_LINE_BYTES = 32 * 1024
"""Longest line that is read: more than a record has in which every text is at its bound."""


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """One line of the record. ``at_s`` and ``deadline_s``: unix seconds of the home site's clock."""

    at_s: float
    key: str
    by: str
    role: str
    vehicle: str
    method: str
    params: Json | None
    status: Status
    text: str
    deadline_s: float
    outcome: Json | None = None
    run: str = ""
    seq: int = 0
    sender: str = ""
    """Public key of the station that gave the order, as the hub enforces it; ``by`` and ``role`` are that station's own
    statement."""

    def encoded(self) -> bytes:
        """The line, without its newline."""
        return to_json(
            {
                "at_s": round(self.at_s, 3),
                "id": self.key,
                "by": self.by,
                "role": self.role,
                "sender": self.sender,
                "vehicle": self.vehicle,
                "method": self.method,
                "params": self.params,
                "status": self.status,
                "text": self.text,
                "deadline_s": round(self.deadline_s, 3),
                "outcome": self.outcome,
                "run": self.run,
                "seq": self.seq,
            },
            inf_nan_mode="null",
        )


def record(request: OrderRequest, reply: OrderReply, at_s: float) -> AuditRecord:
    """The line for an order that has this reply now; texts are cut to their bounds."""
    params: Json | None = request.params
    if len(to_json(request.params, inf_nan_mode="null")) > MAX_PARAMS_BYTES:
        params = None
    return AuditRecord(
        at_s,
        request.key,
        printable(request.by),
        printable(request.role),
        printable(request.vehicle),
        printable(request.method),
        params,
        reply.status,
        reply.text[:MAX_TEXT_CHARS],
        request.deadline_s,
        _short(reply.outcome),
        printable(request.run),
        request.seq,
        printable(request.sender),
    )


def remembered(lines: Iterable[bytes]) -> Iterator[Remembered | None]:
    """The order of each line, for `OrderGate.restore`; None for a line that cannot be read, such as the last one of a
    process that was killed while it wrote."""
    for line in lines:
        yield _remembered(line)


def _remembered(line: bytes) -> Remembered | None:
    if len(line) > MAX_LINE_BYTES:
        return None
    try:
        found = from_json(line, allow_inf_nan=False)
    except ValueError:
        return None
    if not isinstance(found, dict) or not is_key(found.get("id")) or found.get("status") not in STATUSES:
        return None
    at_s, deadline_s, text, outcome = (found.get(key) for key in ("at_s", "deadline_s", "text", "outcome"))
    vehicle, run, seq, sender = (*(found.get(key) for key in ("vehicle", "run", "seq")), found.get("sender", ""))
    if not (is_number(at_s) and is_number(deadline_s) and isinstance(text, str)):
        return None
    if not (isinstance(vehicle, str) and isinstance(run, str) and isinstance(seq, int) and isinstance(sender, str)):
        return None
    reply = OrderReply(found["id"], found["status"], text, outcome if isinstance(outcome, dict) else None)
    return Remembered(reply, float(deadline_s), float(at_s), vehicle, run, seq, sender)


def _short(outcome: Json | None) -> Json | None:
    """An outcome whose texts cannot make a line too long."""
    if outcome is None:
        return None
    texts: list[Any] = list(outcome.get("status_texts") or ())
    return {
        "ok": outcome["ok"],
        "result": printable(outcome["result"]),
        "message": str(outcome["message"])[:MAX_TEXT_CHARS],
        "attempts": outcome["attempts"],
        "elapsed_s": outcome["elapsed_s"],
        "status_texts": [str(text)[:200] for text in texts[:8]],
    }
