"""The mission protocol: what its machines share (messages, results, waits), and two of them, `MissionClear` and
`MissionDownload`. The upload has a file of its own. Only messages of this vehicle that are addressed to us and of this
list's type may be handed in to any of them.

`MissionClear`:

    state      what came                                      next         effects
    --------   --------------------------------------------   ----------   -----------------------------------------
    IDLE       start                                          WAITING      MISSION_CLEAR_ALL
    WAITING    timer, repeats left                            WAITING      MISSION_CLEAR_ALL
    WAITING    timer, none left                               DONE         Finish: timeout
    WAITING    ack accepted                                   DONE         Finish: accepted
    WAITING    ack refusing                                   SETTLING     - (the text that says why may follow)
    SETTLING   timer                                          DONE         Finish: that refusal
    not DONE   stop (cancelled, vehicle lost, ...)            DONE         Finish: as given

`MissionDownload` (mission, fence or rally points):

    state      what came                                      next         effects
    --------   --------------------------------------------   ----------   -----------------------------------------
    IDLE       start                                          LISTING      MISSION_REQUEST_LIST
    LISTING    timer, repeats left                            LISTING      MISSION_REQUEST_LIST
    LISTING    count of 0                                     DONE         MISSION_ACK, Finish: accepted
    LISTING    count                                          FETCHING     MISSION_REQUEST_INT of item 0
    LISTING    ack: denied, for less than DENIED_S            LISTING      - (the timer asks again)
    LISTING    ack refusing (not: error, gave up)             SETTLING     - (the text that says why may follow)
    FETCHING   the item asked for, not the last               FETCHING     Report, MISSION_REQUEST_INT of the next (in
                                                                           later rounds not before the gap is over)
    FETCHING   the item asked for, the last                   DONE         MISSION_ACK, Finish: accepted
    FETCHING   another item (late, twice)                     FETCHING     -
    FETCHING   timer, repeats left                            FETCHING     MISSION_REQUEST_INT again
    FETCHING   another count, or ack refusing                 LISTING      MISSION_REQUEST_LIST: it is another list now
    FETCHING   timer, no repeats left                         LISTING      MISSION_REQUEST_LIST: it ended it unheard
    LISTING    timer, no repeats left                         DONE         Finish: timeout
    LISTING, FETCHING   no rounds left                        DONE         Finish: failed
    SETTLING   timer                                          DONE         Finish: that refusal
    not DONE   stop (cancelled, vehicle lost, ...)            DONE         MISSION_ACK (cancelled), Finish: as given
    DONE       anything                                       DONE         -

One request is under way at a time: a PX4 answers only the next item and the one before it. A late copy of an earlier
request ends its transfer: it says so once, in an ack that may be lost, and answers no request but that of the list
(1.16, handle_mission_request_both of mavlink_mission.cpp). So each round leaves more time between one request and the
next: `LEAST_GAP_S`, `MOST_GAP_S`.

Protocol: https://mavlink.io/en/services/mission.html
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Literal

from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.protocols.base import Effect, Finish, ProgressReport, ProtocolMachine, Send
from skygcs.core.protocols.command import MAX_TEXTS, SETTLE_S

# --- shared parts, clearing -------------------------------------------------------------------------------------------

FIRST_WAIT_S = 1.0
"""First wait for an answer; longer than a full round of a nine-node multipoint radio at 64 kbit/s (0.75 s)."""

LEAST_WAIT_S = 0.5
MOST_WAIT_S = 2.0
"""Bounds of what the link's own round trips make of it. A PX4 that hears no request for 5 s ends the transfer: it is
asked more than twice in that time, however slow the link is."""

BACKOFF = 1.25
SAMPLES = 8

MAX_TRIES = 20
"""Transmissions of one request. With 20 % lost each way, one transfer in 700 million needs more."""

ITEM_TRIES = MAX_TRIES // 2
"""Those of one item until the list is asked for again. With 20 % lost each way, one item in 27 000 needs more."""

CLEAR_TRIES = 8

RESULTS = {
    0: ("accepted", "accepted"),
    1: ("failed", "the vehicle says error"),
    2: ("unsupported", "the coordinate frame is not supported"),
    3: ("unsupported", "not supported by the vehicle"),
    4: ("denied", "the vehicle has no space for so many items"),
    5: ("denied", "invalid"),
    6: ("denied", "param1 is invalid"),
    7: ("denied", "param2 is invalid"),
    8: ("denied", "param3 is invalid"),
    9: ("denied", "param4 is invalid"),
    10: ("denied", "latitude (param5) is invalid"),
    11: ("denied", "longitude (param6) is invalid"),
    12: ("denied", "altitude (param7) is invalid"),
    13: ("failed", "an item came out of sequence"),
    14: ("denied", "the vehicle takes no missions from us now"),
    15: ("cancelled", "the vehicle gave it up"),
}
"""MAV_MISSION_RESULT: the outcome's word, and what it means."""

ACCEPTED, ERROR, INVALID_SEQUENCE, DENIED, OPERATION_CANCELLED = 0, 1, 13, 14, 15

ListState = Literal["complete", "cleared", "unchanged", "partial", "unknown"]
"""State of the vehicle's list after the transfer."""


@dataclass(frozen=True, slots=True)
class MissionOutcome:
    """Outcome of a transfer. ``message``: for the user, with the state of the vehicle's list if that is in doubt.

    ``result``: accepted denied unsupported failed cancelled timeout lost. ``items``: those on board, as on the wire,
    after a transfer that was accepted, else None; ``opaque_id`` is the vehicle's own number for its list, None where it
    has none; ``sent``: messages sent.
    """

    ok: bool
    result: str
    message: str
    kind: MissionType
    state: ListState
    items: tuple[MissionItem, ...] | None = None
    opaque_id: int | None = None
    sent: int = 0
    elapsed_s: float = 0.0
    status_texts: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The fields of every order's outcome, and ``list``, ``state`` and ``opaque_id``."""
        return {
            "ok": self.ok,
            "result": self.result,
            "message": self.message,
            "attempts": self.sent,
            "elapsed_s": round(self.elapsed_s, 3),
            "status_texts": list(self.status_texts),
            "list": self.kind.word,
            "state": self.state,
            "opaque_id": self.opaque_id,
        }


def opaque_id(payload: bytes, offset: int) -> int | None:
    """The vehicle's number for a list, behind the fields that every dialect has: at byte 5 of MISSION_COUNT, 4 of
    MISSION_ACK, 6, 10 and 14 (mission, fence, rally) of MISSION_CURRENT. None: it has none, or a zero was cut off.

    It is read from the bytes because pymavlink's ardupilotmega lacks the field, though a PX4 sends it.
    """
    return int.from_bytes(payload[offset : offset + 4], "little") or None


class Texts:
    """Status texts that may explain a refusal."""

    __slots__ = ("_texts",)

    def __init__(self) -> None:
        self._texts: list[str] = []

    def add(self, text: str) -> None:
        if text not in self._texts:
            self._texts.append(text)
            del self._texts[:-MAX_TEXTS]

    def all(self) -> tuple[str, ...]:
        return tuple(self._texts)

    def behind(self, message: str) -> str:
        return ": ".join((message, "; ".join(self._texts))) if self._texts else message


class RoundTrip:
    """How long to wait for an answer before asking again, from the link's own round trips.

    A round trip is counted from the first of several requests, since it is not known which of them was answered. So
    the quicker ones show the link's time, and the slower ones its losses: the lower quartile of the last few counts.
    `ReplyTimeout` (TCP's rule) waits longer on a bad link, and a PX4 ends a transfer after 5 s without a request.
    """

    __slots__ = ("_took", "wait_s")

    def __init__(self) -> None:
        self._took: deque[float] = deque(maxlen=SAMPLES)
        self.wait_s = FIRST_WAIT_S

    def took(self, elapsed_s: float) -> None:
        self._took.append(elapsed_s)
        quick_s = sorted(self._took)[(len(self._took) - 1) // 4]
        self.wait_s = min(MOST_WAIT_S, max(LEAST_WAIT_S, 1.5 * quick_s))

    def failed(self) -> None:
        """Nothing came within the wait: the link is busier, or slower."""
        self.wait_s = min(MOST_WAIT_S, BACKOFF * self.wait_s)


ANSWERS = ("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
"""Messages of a vehicle that belong to a transfer."""


class MissionProtocol(ProtocolMachine):
    """Common part of upload, download and clearing."""

    def __init__(self, kind: MissionType) -> None:
        self.kind = kind
        self.outcome: MissionOutcome | None = None
        self.sent = 0
        self.texts = Texts()
        self._started = 0.0

    @property
    def done(self) -> bool:
        return self.outcome is not None

    def on_message(self, name: str, fields: Mapping[str, Any], payload: bytes, now: float) -> tuple[Effect, ...]:
        """One of ANSWERS came."""
        match name:
            case "MISSION_COUNT":
                return self.on_count(fields["count"], now, opaque_id(payload, 5))
            case "MISSION_ITEM_INT":
                return self.on_item(fields["seq"], fields, now)
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST":
                return self.on_request(fields["seq"], now)
            case "MISSION_ACK":
                return self.on_ack(fields["type"], now, opaque_id(payload, 4))
        return ()

    def on_count(self, count: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        """MISSION_COUNT; ``number`` is its opaque id."""
        return ()

    def on_item(self, seq: int, fields: Mapping[str, Any], now: float) -> tuple[Effect, ...]:
        """MISSION_ITEM_INT."""
        return ()

    def on_request(self, seq: int, now: float) -> tuple[Effect, ...]:
        """MISSION_REQUEST_INT or MISSION_REQUEST."""
        return ()

    @abstractmethod
    def on_ack(self, result: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        """MISSION_ACK; ``number`` is its opaque id."""

    @abstractmethod
    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        """End it from outside: cancelled, or the vehicle was lost. The outcome says what the vehicle holds."""

    def on_text(self, text: str) -> None:
        """A status text of this vehicle came: it may say why."""
        if not self.done:
            self.texts.add(text)

    def _send(self, message: str, **values: Any) -> Send:
        self.sent += 1
        return Send(message, {**values, "mission_type": int(self.kind)})

    def _end(
        self,
        now: float,
        result: str,
        message: str,
        state: ListState,
        items: tuple[MissionItem, ...] | None = None,
        number: int | None = None,
    ) -> tuple[Effect, ...]:
        self.deadline = None
        self.outcome = MissionOutcome(
            result == "accepted",
            result,
            message,
            self.kind,
            state,
            items,
            number,
            self.sent,
            now - self._started,
            self.texts.all(),
        )
        return (Finish(),)


class MissionClear(MissionProtocol):
    """See the table at the top."""

    def __init__(self, kind: MissionType) -> None:
        super().__init__(kind)
        self._wait = RoundTrip()
        self._refusal: int | None = None

    def start(self, now: float) -> tuple[Effect, ...]:
        self._started = now
        return self._ask(now)

    def on_ack(self, result: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        if self.done or self._refusal is not None or not self.sent:
            return ()
        if result == ACCEPTED:
            return self._end(now, "accepted", f"the {self.kind.word} is cleared", "cleared", (), number)
        self._refusal = result
        self.deadline = now + SETTLE_S
        return ()

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self._refusal is not None:
            result, meaning = meaning_of(self._refusal)
            return self._end(now, result, self.texts.behind(f"not cleared: {meaning}"), "unchanged")
        if self.sent < CLEAR_TRIES:
            self._wait.failed()
            return self._ask(now)
        return self._end(now, "timeout", f"no answer to {self.sent} transmissions; {_UNHEARD}", "unknown")

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        if self.done:
            return ()
        return self._end(now, result, f"{message}; {_UNHEARD}", "unknown")

    def _ask(self, now: float) -> tuple[Effect, ...]:
        self.deadline = now + self._wait.wait_s
        return (self._send("MISSION_CLEAR_ALL"),)


_UNHEARD = "whether the vehicle has cleared it is not known: download it to see"


def meaning_of(result: int) -> tuple[str, str]:
    """(word of an outcome, meaning) of a MAV_MISSION_RESULT."""
    return RESULTS.get(result, ("failed", f"the vehicle answers MAV_MISSION_RESULT {result}"))


def item_values(item: MissionItem, seq: int) -> Mapping[str, Any]:
    """Fields of MISSION_ITEM_INT without target and type. No item is marked current: autopilots ignore the mark in an
    upload, and an ArduPilot takes a 2 for a guided target."""
    return {**item.values(), "seq": seq, "current": 0}


# --- download ---------------------------------------------------------------------------------------------------------


MAX_ROUNDS = 12
"""Times that the list is fetched from its beginning; one that changes more often is being changed by somebody. A PX4
ends a transfer after 5 s without a request that it hears: 18 items at 25 % lost each way and delays up to 1 s failed in
23 of 300 runs with 4 rounds, in none with 8; 12 leave room for slower links (2 of 40 failed with 4 s round trips)."""


LEAST_GAP_S, MOST_GAP_S = 0.5, 1.0
"""Time from one request to that of the next item in the second round, and from the third on, so that no copy of the
first arrives behind the other; none in the first round. A longer one leaves too few repeats of a lost request within
the 5 s of a PX4."""

DENIED_S = 10.0
"""An ArduPilot denies its list while it waits for the items of an upload that was broken off: 8 s from the last one
(`upload_timeout_ms` of MissionItemProtocol.h)."""


class DownloadState(Enum):
    IDLE = auto()
    LISTING = auto()
    FETCHING = auto()
    SETTLING = auto()
    DONE = auto()


class MissionDownload(MissionProtocol):
    """See the table at the top. At most MAX_ROUNDS * MAX_TRIES * (items + 1) + 1 messages are sent."""

    def __init__(self, kind: MissionType) -> None:
        super().__init__(kind)
        self.state = DownloadState.IDLE
        self.count: int | None = None
        self._items: list[MissionItem] = []
        self._number: int | None = None
        self._wait = RoundTrip()
        self._rounds = 1
        self._tries = 0
        self._asked = 0.0
        self._sent_at = 0.0
        self._gap_s = 0.0
        self._refusal = 0
        self._denied_at: float | None = None

    def start(self, now: float) -> tuple[Effect, ...]:
        self._started = now
        return self._list(now)

    def on_count(self, count: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        if self.state is DownloadState.FETCHING and (count, number) != (self.count, self._number):
            return self._again(now, "its list changed while it was read")
        if self.state is not DownloadState.LISTING:
            return ()
        self._wait.took(now - self._asked)
        self.count, self._number = count, number
        if count == 0:
            return self._complete(now)
        self.state = DownloadState.FETCHING
        return self._request(now)

    def on_item(self, seq: int, fields: Mapping[str, Any], now: float) -> tuple[Effect, ...]:
        if self.state is not DownloadState.FETCHING or seq != len(self._items) or not self._tries:
            return ()
        try:
            item = MissionItem.from_fields(fields)
        except ValueError as error:
            return self._finish(now, "failed", f"item {seq} of the vehicle's {self.kind.word}: {error}")
        self._wait.took(now - self._asked)
        self._items.append(item)
        assert self.count is not None
        if len(self._items) == self.count:
            return self._complete(now)
        return (ProgressReport(100 * len(self._items) // self.count), *self._request(now))

    def on_ack(self, result: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        if result == ACCEPTED or self.state not in (DownloadState.LISTING, DownloadState.FETCHING):
            return ()
        if self.state is DownloadState.FETCHING:
            # a PX4 refuses a late request of an item it is past, and what comes after its own time-out
            return () if result == INVALID_SEQUENCE else self._again(now, meaning_of(result)[1])
        if result in (ERROR, OPERATION_CANCELLED):  # busy; or it gives up an upload that was broken off before
            return ()
        if result == DENIED:
            self._denied_at = now if self._denied_at is None else self._denied_at
            if now < self._denied_at + DENIED_S:
                return ()
        self._refusal = result
        self.state = DownloadState.SETTLING
        self.deadline = now + SETTLE_S
        return ()

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        if self.state is DownloadState.SETTLING:
            result, meaning = meaning_of(self._refusal)
            hint = " (an ArduPilot: 8 s from an upload that was broken off)" if self._refusal == DENIED else ""
            return self._finish(now, result, self.texts.behind(f"not read: {meaning}{hint}"))
        if self._tries:
            self._wait.failed()
        if self.state is DownloadState.FETCHING:
            if self._tries < ITEM_TRIES:
                return self._ask_item(now)
            return self._again(now, f"no answer to {self._tries} requests of item {len(self._items)} of {self.count}")
        if self._tries < MAX_TRIES:
            return self._ask_list(now)
        return self._finish(now, "timeout", f"no answer to {self._tries} requests of the list")

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        if self.state in (DownloadState.IDLE, DownloadState.DONE):
            return ()
        cancel = self._send("MISSION_ACK", type=OPERATION_CANCELLED)
        return (cancel, *self._finish(now, result, f"{message}; the vehicle's {self.kind.word} is as it was"))

    def _list(self, now: float) -> tuple[Effect, ...]:
        self.state = DownloadState.LISTING
        self._items.clear()
        self._tries = 0
        self._asked = now
        return self._ask_list(now)

    def _ask_list(self, now: float) -> tuple[Effect, ...]:
        self._tries += 1
        self._sent_at = now
        self.deadline = now + self._wait.wait_s
        return (self._send("MISSION_REQUEST_LIST"),)

    def _request(self, now: float) -> tuple[Effect, ...]:
        self._tries = 0
        self._asked = self.deadline = max(now, self._sent_at + self._gap_s)
        return self._ask_item(now) if self.deadline <= now else ()

    def _ask_item(self, now: float) -> tuple[Effect, ...]:
        self._tries += 1
        self._sent_at = now
        self.deadline = now + self._wait.wait_s
        return (self._send("MISSION_REQUEST_INT", seq=len(self._items)),)

    def _again(self, now: float, why: str) -> tuple[Effect, ...]:
        if self._rounds >= MAX_ROUNDS:
            return self._finish(now, "failed", f"not read in {MAX_ROUNDS} rounds: {why}")
        self._rounds += 1
        self._gap_s = min(MOST_GAP_S, 2 * self._gap_s or LEAST_GAP_S)
        return self._list(now)

    def _complete(self, now: float) -> tuple[Effect, ...]:
        items = tuple(self._items)
        what = f"{len(items)} item{'s' if len(items) != 1 else ''}"
        ack = self._send("MISSION_ACK", type=ACCEPTED)
        self.state = DownloadState.DONE
        return (ack, *self._end(now, "accepted", f"{what} read", "complete", items, self._number))

    def _finish(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        self.state = DownloadState.DONE
        return self._end(now, result, message, "unchanged")
