"""The messages by which one site asks another to carry out an order: encoded, and decoded within bounds. Pure.

    cmd.<site>.<vehicle>    OrderRequest  ->  OrderReply    one vehicle, one order, one subscriber
    cmd.<site>.outcome      OutcomeQuestion  ->  OrderReply

All are JSON objects; unknown keys are ignored. The decoders return None for a message that is not valid.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic_core import from_json, to_json

from skygcs.ext.federation.protocol.received_json import MAX_TEXT_CHARS, cleaned, printable
from skygcs.ext.federation.protocol.site_names import MAX_NAME_CHARS, name_of_token, subject_token
from skygcs.spelling import is_number

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
"""Orders that may be sent to another site: each is for one vehicle and changes no setting of the daemon."""

ENDS_FLIGHT = frozenset({"vehicles.disarm", "vehicles.hold", "vehicles.land", "vehicles.rtl", "vehicles.stop"})
"""Orders that end a flight; the daemon carries them out to their outcome even if the client disconnects."""

STOP = "vehicles.stop"

MAX_BYTES = 4096
"""Longest request. The longest valid one, a goto with every parameter, has 500 bytes."""

MAX_REPLY_BYTES = 64 * 1024
"""Longest reply. An outcome has up to eight status texts."""

MAX_STATUS_TEXTS = 8
"""Status texts of one outcome; further ones are left out."""

MAX_SEQ = 1 << 53
"""Largest number of an order: the largest integer that every JSON reader keeps exactly."""

OUTCOME_SUBJECT = "outcome"
"""Last token of the subject of questions, in the place of a vehicle's name."""

Status = Literal["done", "failed", "refused", "late", "running", "unknown", "never came"]
"""done, failed: the order was given to the vehicle. refused, late: it was not, and never will be. running: it is still
being carried out. unknown: the site does not know, because its daemon or its bridge ended meanwhile. never came: the
order did not arrive, and is refused if it arrives now."""

STATUSES: frozenset[str] = frozenset({"done", "failed", "refused", "late", "running", "unknown", "never came"})

FINAL: frozenset[str] = STATUSES - {"running"}

_KEY = re.compile(r"[0-9a-f]{32}")
_NAMED_OUTCOME = f"={ord(OUTCOME_SUBJECT[0]):02X}{OUTCOME_SUBJECT[1:]}"

Json = dict[str, Any]


@dataclass(frozen=True, slots=True)
class OrderRequest:
    """One order to one vehicle.

    ``key``: 128 bits as hexadecimal digits, never used for another order. ``deadline_s``: by the home site's clock.
    ``by``: "user@station". ``role``: role of the sending station. ``run`` and ``seq``: run of the sender's bridge and
    the growing number of the order there, so that the home site can refuse an order that comes after a newer one; ""
    and 0: not numbered. ``sender``: public key of the sending station, as the hub enforces it; "" before sending.
    """

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
        """The payload. Vehicle and sender are not in it but in the subject."""
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
    """The question for the outcome of an order. ``wait_s``: how long the answer may wait for the order's end.
    ``deadline_s``: deadline of the order, if it is known, so that a site can say that its memory does not reach back
    to that time."""

    key: str
    wait_s: float = 0.0
    deadline_s: float | None = None

    def encoded(self) -> bytes:
        return to_json({"v": VERSION, "id": self.key, "wait_s": self.wait_s, "deadline_s": self.deadline_s})


@dataclass(frozen=True, slots=True)
class OrderReply:
    """The status of an order. ``outcome``: the vehicle's outcome from the daemon, if the daemon answered."""

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
    """The order for ``vehicle`` from the station with the key ``sender``; None if the payload is not valid."""
    found = _object(payload, MAX_BYTES)
    if found is None or not is_key(found.get("id")):
        return None
    method, params, deadline_s = found.get("method"), found.get("params"), found.get("deadline_s")
    by, role = found.get("by"), found.get("role")
    if not (isinstance(method, str) and isinstance(params, dict) and isinstance(by, str) and isinstance(role, str)):
        return None
    if not is_number(deadline_s) or cleaned(params) != params:  # a value left out would be another order
        return None
    run, seq = found.get("run", ""), found.get("seq", 0)
    if not isinstance(run, str) or isinstance(seq, bool) or not isinstance(seq, int) or not 0 <= seq <= MAX_SEQ:
        return None
    method, role, run = (printable(text, MAX_NAME_CHARS) for text in (method, role, run))
    return OrderRequest(found["id"], vehicle, method, params, float(deadline_s), printable(by), role, run, seq, sender)


def decode_question(payload: bytes) -> OutcomeQuestion | None:
    """The question; None if the payload is not valid."""
    found = _object(payload, MAX_BYTES)
    if found is None or not is_key(found.get("id")):
        return None
    wait_s, deadline_s = found.get("wait_s", 0.0), found.get("deadline_s")
    if not is_number(wait_s) or not (deadline_s is None or is_number(deadline_s)):
        return None
    return OutcomeQuestion(found["id"], float(wait_s), None if deadline_s is None else float(deadline_s))


def decode_reply(key: str, payload: bytes) -> OrderReply | None:
    """The reply about the order ``key``; None if the payload is not valid, or about another order."""
    found = _object(payload, MAX_REPLY_BYTES)
    if found is None or found.get("id") != key or found.get("status") not in STATUSES:
        return None
    outcome, text = found.get("outcome"), found.get("text")
    if not isinstance(text, str) or not (outcome is None or _is_outcome(outcome)):
        return None
    shown = None if outcome is None else _shown(outcome)
    return OrderReply(key, found["status"], printable(text, MAX_TEXT_CHARS), shown)


def is_key(value: object) -> bool:
    """True for the idempotency key of an order."""
    return isinstance(value, str) and _KEY.fullmatch(value) is not None


def vehicle_token(name: str) -> str:
    """A vehicle's name as the last token of an order's subject. The name "outcome" is escaped, as that token is
    reserved for questions."""
    return _NAMED_OUTCOME if name == OUTCOME_SUBJECT else subject_token(name)


def vehicle_of_token(token: str) -> str | None:
    """The inverse of `vehicle_token`; None for a token that it does not make."""
    if token == _NAMED_OUTCOME:
        return OUTCOME_SUBJECT
    try:
        name = name_of_token(token)
    except ValueError:
        return None
    return name if len(name) <= MAX_NAME_CHARS else None


def status_of(outcome: Mapping[str, Any]) -> Status:
    """The status for an outcome of the daemon: "refused" if skygcs itself refused the order."""
    if outcome["ok"]:
        return "done"
    return "refused" if outcome["result"] == "refused" else "failed"


def _is_outcome(value: object) -> bool:
    """True if the value has the fields that clients of the daemon read in an outcome."""
    return (
        isinstance(value, dict)
        and isinstance(value.get("ok"), bool)
        and isinstance(value.get("result"), str)
        and isinstance(value.get("message"), str)
        and isinstance(attempts := value.get("attempts"), int)
        and 0 <= attempts <= MAX_SEQ
        and is_number(value.get("elapsed_s"))
        and isinstance(texts := value.get("status_texts", []), list)
        and all(isinstance(text, str) for text in texts)
    )


def _shown(outcome: Json) -> Json:
    """The outcome with its texts as a person may see them."""
    texts = outcome.get("status_texts", [])[:MAX_STATUS_TEXTS]
    shown: Json = cleaned({**outcome, "status_texts": texts})
    return {**shown, "result": printable(outcome["result"])}


def _object(payload: bytes, most_bytes: int) -> Json | None:
    if len(payload) > most_bytes:
        return None
    try:
        found = from_json(payload, allow_inf_nan=False)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
