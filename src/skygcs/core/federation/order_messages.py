"""The messages by which one site asks another to carry out an order: made and read, with bounds. Pure.

    cmd.<site>.<vehicle>    OrderRequest  ->  OrderReply    one vehicle, one order, one subscriber
    cmd.<site>.outcome      OutcomeQuestion  ->  OrderReply

All are JSON objects; keys that are not known here are ignored. What cannot be read gives None.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic_core import from_json, to_json

from skygcs.core.federation.site_names import MAX_NAME_CHARS, name_of_token, subject_token

VERSION = 1

METHODS = frozenset(
    {
        "vehicles.arm",
        "vehicles.disarm",
        "vehicles.goto",
        "vehicles.hold",
        "vehicles.land",
        "vehicles.mode",
        "vehicles.rtl",
        "vehicles.stop",
        "vehicles.takeoff",
    }
)
"""Orders that travel: each is for one vehicle and changes nothing of the daemon."""

ENDS_FLIGHT = frozenset({"vehicles.disarm", "vehicles.hold", "vehicles.land", "vehicles.rtl", "vehicles.stop"})
"""Orders that end a flight; the daemon carries them on to their outcome without the client."""

STOP = "vehicles.stop"

MAX_BYTES = 4096
"""Of a request: the longest, a goto with every parameter, has 500."""

MAX_REPLY_BYTES = 64 * 1024
"""An outcome has up to eight status texts."""

MAX_BY_CHARS = 100
MAX_TEXT_CHARS = 1000
MAX_SEQ = 1 << 53
"""Numbers are JSON's."""

OUTCOME_SUBJECT = "outcome"
"""Stands where a vehicle's name stands in the subject of an order."""

Status = Literal["done", "failed", "refused", "late", "running", "unknown", "never came"]
"""done, failed: it was given to the vehicle. refused, late: it was not, and never will be. running: it is still being
carried out. unknown: the site cannot say, since its daemon or its bridge ended meanwhile. never came: it did not come,
and is refused if it comes now."""

STATUSES: frozenset[str] = frozenset({"done", "failed", "refused", "late", "running", "unknown", "never came"})

FINAL: frozenset[str] = STATUSES - {"running"}

_KEY = re.compile(r"[0-9a-f]{32}")
_NAMED_OUTCOME = f"={ord(OUTCOME_SUBJECT[0]):02X}{OUTCOME_SUBJECT[1:]}"

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class OrderRequest:
    """One order to one vehicle. ``key``: 128 bits as hex, never used for another order. ``deadline_s``: on the home
    site's clock. ``by``: "user@station". ``role``: of the station that sends it. ``run`` and ``seq``: of its bridge and
    the number of the order, growing, so that an order does not overtake a newer one; "" and 0: not numbered.
    ``sender``: the key of the station that the hub has it from; "" before it was sent."""

    key: str
    vehicle: str
    method: str
    params: Json
    deadline_s: float
    by: str
    role: str
    run: str = ""
    seq: int = 0
    sender: str = ""

    def encoded(self) -> bytes:
        """Without vehicle and sender, which stand in the subject."""
        return to_json(
            {
                "v": VERSION,
                "id": self.key,
                "method": self.method,
                "params": self.params,
                "deadline_s": self.deadline_s,
                "by": self.by,
                "role": self.role,
                "run": self.run,
                "seq": self.seq,
            }
        )


@dataclass(frozen=True, slots=True)
class OutcomeQuestion:
    """What became of an order? ``wait_s``: how long the answer may wait for the order's end. ``deadline_s``: of the
    order, if it is known: a site whose memory does not reach back so far then says so."""

    key: str
    wait_s: float = 0.0
    deadline_s: float | None = None

    def encoded(self) -> bytes:
        return to_json({"v": VERSION, "id": self.key, "wait_s": self.wait_s, "deadline_s": self.deadline_s})


@dataclass(frozen=True, slots=True)
class OrderReply:
    """What became of an order. ``outcome``: the daemon's, of the vehicle, if the daemon answered."""

    key: str
    status: Status
    text: str
    outcome: Json | None = None

    def encoded(self) -> bytes:
        return to_json(
            {"v": VERSION, "id": self.key, "status": self.status, "outcome": self.outcome, "text": self.text},
            inf_nan_mode="null",
        )


def decode_request(vehicle: str, payload: bytes, sender: str = "") -> OrderRequest | None:
    """The order for ``vehicle`` from the station with this key; None if it is none."""
    found = _object(payload, MAX_BYTES)
    if found is None or not is_key(found.get("id")):
        return None
    method, params, deadline_s = found.get("method"), found.get("params"), found.get("deadline_s")
    by, role = found.get("by"), found.get("role")
    if not (isinstance(method, str) and isinstance(params, dict) and isinstance(by, str) and isinstance(role, str)):
        return None
    if isinstance(deadline_s, bool) or not isinstance(deadline_s, int | float) or not _is_number(deadline_s):
        return None
    run, seq = found.get("run", ""), found.get("seq", 0)
    if not isinstance(run, str) or isinstance(seq, bool) or not isinstance(seq, int) or not 0 <= seq <= MAX_SEQ:
        return None
    method, role, run = (text[:MAX_NAME_CHARS] for text in (method, role, run))
    return OrderRequest(found["id"], vehicle, method, params, float(deadline_s), printable(by), role, run, seq, sender)


def decode_question(payload: bytes) -> OutcomeQuestion | None:
    found = _object(payload, MAX_BYTES)
    if found is None or not is_key(found.get("id")):
        return None
    wait_s, deadline_s = found.get("wait_s", 0.0), found.get("deadline_s")
    if not _is_number(wait_s) or not (deadline_s is None or _is_number(deadline_s)):
        return None
    return OutcomeQuestion(found["id"], float(wait_s), None if deadline_s is None else float(deadline_s))


def decode_reply(key: str, payload: bytes) -> OrderReply | None:
    """The reply about the order ``key``; None if it is none, or about another one."""
    found = _object(payload, MAX_REPLY_BYTES)
    if found is None or found.get("id") != key or found.get("status") not in STATUSES:
        return None
    outcome, text = found.get("outcome"), found.get("text")
    if not isinstance(text, str) or not (outcome is None or _is_outcome(outcome)):
        return None
    return OrderReply(key, found["status"], text[:MAX_TEXT_CHARS], outcome)


def is_key(value: object) -> bool:
    """True for the idempotency key of an order."""
    return isinstance(value, str) and _KEY.fullmatch(value) is not None


def vehicle_token(name: str) -> str:
    """A vehicle's name as the last token of an order's subject; the reserved token is none."""
    return _NAMED_OUTCOME if name == OUTCOME_SUBJECT else subject_token(name)


def vehicle_of_token(token: str) -> str | None:
    """The name that `vehicle_token` was given; None for a token that it does not make."""
    if token == _NAMED_OUTCOME:
        return OUTCOME_SUBJECT
    try:
        name = name_of_token(token)
    except ValueError:
        return None
    return name if len(name) <= MAX_NAME_CHARS else None


def status_of(outcome: Mapping[str, Any]) -> Status:
    """Of a daemon's outcome: "refused" if skygcs itself refused it."""
    if outcome["ok"]:
        return "done"
    return "refused" if outcome["result"] == "refused" else "failed"


def printable(text: str) -> str:
    """What another station wrote, for logs and screens: bounded, without control characters."""
    return "".join(c if c.isprintable() else "?" for c in text[:MAX_BY_CHARS])


def _is_outcome(value: object) -> bool:
    """True for what clients of the daemon expect of an outcome."""
    return (
        isinstance(value, dict)
        and isinstance(value.get("ok"), bool)
        and isinstance(value.get("result"), str)
        and isinstance(value.get("message"), str)
        and isinstance(value.get("attempts"), int)
        and isinstance(value.get("elapsed_s"), int | float)
        and isinstance(value.get("status_texts", []), list)
    )


def _is_number(value: object) -> bool:
    """True for a finite number; an integer too large for a float is none."""
    try:
        return not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)
    except OverflowError:
        return False


def _object(payload: bytes, most_bytes: int) -> Json | None:
    if len(payload) > most_bytes:
        return None
    try:
        found = from_json(payload, allow_inf_nan=False)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
