"""Upload of a list (mission, fence or rally points): taken whole, or the outcome names what the vehicle holds. Pure.

Rule: everything that decides how an upload goes on is in this file.

    state      what came                                      next         effects
    --------   --------------------------------------------   ----------   -----------------------------------------
    IDLE       start                                          OFFERING     MISSION_COUNT
    OFFERING   timer, repeats left                            OFFERING     MISSION_COUNT
    OFFERING   timer, none left                               DONE         Finish: timeout
    OFFERING, SENDING   a request                             SENDING      that item; Report
    SENDING    timer: no request for a while, items missing   OFFERING     MISSION_COUNT (next round)
    SENDING    timer: no ack for a while, all sent            READING      a download: was the last ack lost?
    SENDING    ack accepted, all sent                         DONE         Finish: accepted
    READING    it holds what was sent                         DONE         Finish: accepted
    READING    it holds anything else, or says nothing        OFFERING     MISSION_COUNT (next round)
    READING    a request                                      READING      that item
    OFFERING, SENDING   ack: gave up                          OFFERING     MISSION_COUNT (next round)
    OFFERING, SENDING   ack: out of sequence, or error        unchanged    - (said of items that came twice or late)
    OFFERING, SENDING   any other ack refusing                SETTLING     - (the text that says why may follow)
    SETTLING   timer                                          DONE         Finish: that refusal
    not DONE   rounds or messages used up                     DONE         Finish: failed
    not DONE   stop (cancelled, vehicle lost, ...)            DONE         MISSION_ACK (cancelled), Finish: as given
    DONE       a request, if it was accepted lately           DONE         that item (a MISSION_COUNT came late)

The vehicle leads: it asks for items, again where one is lost. The old MISSION_REQUEST is answered by MISSION_ITEM_INT,
too, as the protocol asks. An ack that accepts before the last item was asked for belongs to something else.

`rejection`: PX4 checks a mission some ms after it has acknowledged the upload (1.16.1:
MissionFeasibility/FeasibilityChecker.cpp and mission_feasibility_checker.cpp) and reports problems by events; the
status text with the same content is not sent on every link. An event's id is a hash of its name
(platforms/common/include/px4_platform_common/events.h).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum, auto
from typing import Any

from skygcs.core.mission.firmware_items import Family, same_start
from skygcs.core.mission.item import MAX_ITEMS, MissionItem, MissionType
from skygcs.core.protocols.base import Effect, ProgressReport, Send
from skygcs.core.protocols.command import SETTLE_S
from skygcs.core.protocols.mission import (
    ACCEPTED,
    ERROR,
    INVALID_SEQUENCE,
    MAX_TRIES,
    OPERATION_CANCELLED,
    ListState,
    MissionDownload,
    MissionProtocol,
    RoundTrip,
    item_values,
    meaning_of,
)

# --- late rejections of a PX4 -----------------------------------------------------------------------------------------

EVENT = "EVENT"

AUTOPILOT = 1 << 24
"""The high byte of an event's id is the component, the rest the hash."""

REASONS: Mapping[str, str] = {
    "navigator_mis_no_home_rel_alt": "it has no home, and items have heights above it",
    "navigator_mis_unsup_cmd": "a command that it does not fly",
    "navigator_mis_starts_w_landing": "it begins with a landing",
    "navigator_mis_starts_w_landing2": "it begins with a landing",
    "navigator_mis_takeoff_too_low": "the take-off is not above home",
    "navigator_mis_takeoff_not_first": "the take-off is not the first item with a position",
    "navigator_mis_approach_wp_below_land": "the item before the landing is not above it",
    "navigator_mis_land_wp_inside_orbit_radius": "the landing point is within the orbit before it",
    "navigator_mis_unsupported_landing_approach_wp": "the item before the landing is neither waypoint nor orbit",
    "navigator_mis_glide_slope_too_steep": "the descent to the landing is too steep (FW_LND_ANG)",
    "navigator_mis_multiple_land": "there is more than one landing start",
    "navigator_mis_land_before_rtl": "a landing start comes before a return",
    "navigator_mis_invalid_land": "the landing start has no landing",
    "navigator_mis_takeoff_missing": "it needs a take-off (MIS_TKO_LAND_REQ)",
    "navigator_mis_land_missing": "it needs a landing (MIS_TKO_LAND_REQ)",
    "navigator_mis_takeoff_or_land_missing": "it needs a take-off and a landing (MIS_TKO_LAND_REQ)",
    "feasibility_mis_in_air_landing_req": "it needs a landing (MIS_TKO_LAND_REQ)",
    "navigator_mis_add_land_or_rm_to": "it has a take-off and no landing (MIS_TKO_LAND_REQ)",
    "navigator_mis_add_to_or_rm_land": "it has a landing and no take-off (MIS_TKO_LAND_REQ)",
    "navigator_mis_wp_gate_too_close": "a gate is at the position of a waypoint",
    "navigator_mis_vtol_items": "it has items for a VTOL, and the vehicle is not one",
    "navigator_mis_geofence_no_home": "its fence needs a home",
    "navigator_mis_geofence_no_home2": "its fence needs a home",
    "navigator_mis_geofence_violation": "an item is outside its fence",
}


def event_id(name: str) -> int:
    """Event id: 24 bits of the name's FNV-1a hash, and the autopilot's component."""
    value = 0x811C9DC5
    for byte in name.encode("ascii"):
        value = ((value ^ byte) * 0x01000193) & 0xFFFF_FFFF
    return AUTOPILOT | (value & 0xFF_FFFF)


_BY_ID = {event_id(name): reason for name, reason in REASONS.items()}


def rejection(number: int) -> str | None:
    """Why the mission was rejected, if the event with this id is a rejection."""
    return _BY_ID.get(number)


# --- mission upload ---------------------------------------------------------------------------------------------------


MAX_ROUNDS = 5
"""Offers from the beginning. A round fails when the vehicle gives up, or when its last ack was lost and it holds
something else."""

SILENCE_S = 6.0
"""A vehicle that waits for an item asks again after 0.25 s (PX4) or 1 s (ArduPilot), for 5 or 8 s: silent for so long,
with a delay of two seconds each way, it does not wait any more."""

ANSWERS_PER_ITEM = 3 * MAX_TRIES
"""A vehicle that asks for one item more often than this, on the average, will never have enough."""

TWICE_S = 0.1
"""The same request again so soon is one that came over two links; a vehicle waits longer before it repeats."""

LINGER_S = 10.0
"""A repeated MISSION_COUNT may still be on its way when the upload is done; the vehicle begins anew with it, and would
hold half a list if nobody answered."""


class UploadState(Enum):
    IDLE = auto()
    OFFERING = auto()
    SENDING = auto()
    READING = auto()
    SETTLING = auto()
    DONE = auto()


class MissionUpload(MissionProtocol):
    """See the table at the top.

    ``keeps_old``: the vehicle holds its old list until the new one is whole (PX4; an ArduPilot's fence), instead of
    writing item over item. ``first_number``: what the first item is called in messages; ``home_first``: it is an
    ArduPilot's home, which the vehicle may keep its own in place of. ``family``: whose way of keeping items
    the list that is read back is compared by; None: they have to be as they were sent.
    """

    def __init__(
        self,
        kind: MissionType,
        items: Sequence[MissionItem],
        *,
        keeps_old: bool,
        first_number: int = 1,
        home_first: bool = False,
        family: Family | None = None,
    ) -> None:
        if not 0 < len(items) <= MAX_ITEMS:
            raise ValueError(f"{len(items)} items cannot be uploaded; 1 to {MAX_ITEMS} can")
        super().__init__(kind)
        self.state = UploadState.IDLE
        self._items = tuple(items)
        self._keeps_old = keeps_old
        self._first = first_number
        self._home_first = home_first
        self._family = family
        self._wait = RoundTrip()
        self._rounds = 1
        self._tries = 0
        self._asked: set[int] = set()
        self._offered_at = 0.0
        self._last_seq = -1
        self._answered_at = -math.inf
        self._hint = ""
        self._refusal = 0
        self._reading: MissionDownload | None = None
        self._answers = 0
        self._ended = 0.0

    def start(self, now: float) -> tuple[Effect, ...]:
        self._started = now
        return self._offer(now)

    def on_request(self, seq: int, now: float) -> tuple[Effect, ...]:
        if not 0 <= seq < len(self._items) or self.state in (UploadState.IDLE, UploadState.SETTLING):
            return ()
        if self.state is UploadState.DONE:
            return self._late_answer(seq, now)
        if self._answers >= ANSWERS_PER_ITEM * len(self._items):
            return self._finish(now, "failed", f"the vehicle goes on asking after {self._answers} answers")
        if self.state is UploadState.OFFERING:
            self._wait.took(now - self._offered_at)
        if self.state is not UploadState.READING:
            self.state = UploadState.SENDING
            self.deadline = now + SILENCE_S
        if seq == self._last_seq and now < self._answered_at + TWICE_S:
            return ()
        self._answers += 1
        self._answered_at = now
        self._asked.add(seq)
        self._last_seq = seq
        item = self._send("MISSION_ITEM_INT", **item_values(self._items[seq], seq))
        return (item, ProgressReport(100 * len(self._asked) // (len(self._items) + 1)))

    def on_ack(self, result: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        if self.state is UploadState.READING:
            assert self._reading is not None
            if result == ACCEPTED:  # it was only late
                stopped = self._passed(self._reading.stop(now, "cancelled", ""))
                return (*stopped, *self._accepted(now, "", number))
            return self._read(now, self._reading.on_ack(result, now))
        if self.state not in (UploadState.OFFERING, UploadState.SENDING):
            return ()
        if result == ACCEPTED:
            return self._accepted(now, "", number) if self._all_sent else ()
        if result in (INVALID_SEQUENCE, ERROR):
            # to an item that came twice, or late: an ArduPilot goes on after the first, either says the second when it
            # is done already. Silence shows what has become of it
            self._hint = meaning_of(result)[1]
            return ()
        if result == OPERATION_CANCELLED:
            return self._again(now, meaning_of(result)[1])
        self._refusal = result
        self.state = UploadState.SETTLING
        self.deadline = now + SETTLE_S
        return ()

    def on_count(self, count: int, now: float, number: int | None = None) -> tuple[Effect, ...]:
        if self.state is not UploadState.READING or self._reading is None:
            return ()
        return self._read(now, self._reading.on_count(count, now, number))

    def on_item(self, seq: int, fields: Mapping[str, Any], now: float) -> tuple[Effect, ...]:
        if self.state is not UploadState.READING or self._reading is None:
            return ()
        return self._read(now, self._reading.on_item(seq, fields, now))

    def on_timer(self, now: float) -> tuple[Effect, ...]:
        if self.deadline is None or now < self.deadline:
            return ()
        match self.state:
            case UploadState.OFFERING:
                if self._tries >= MAX_TRIES:
                    return self._finish(now, "timeout", f"no request came after {self._tries} offers{self._hinted()}")
                self._wait.failed()
                return self._ask(now)
            case UploadState.SENDING if self._all_sent:
                self.state = UploadState.READING
                self._reading = MissionDownload(self.kind)
                return self._read(now, self._reading.start(now))
            case UploadState.SENDING:
                why = f"the vehicle stopped asking after item {self._last_seq + self._first}"
                return self._again(now, why + self._hinted())
            case UploadState.READING:
                return () if self._reading is None else self._read(now, self._reading.on_timer(now))
        result, meaning = meaning_of(self._refusal)
        return self._finish(now, result, self.texts.behind(self._refused(meaning)))

    def stop(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        if self.state in (UploadState.IDLE, UploadState.DONE):
            return ()
        cancel = self._send("MISSION_ACK", type=OPERATION_CANCELLED)
        return (cancel, *self._finish(now, result, message))

    @property
    def _all_sent(self) -> bool:
        return len(self._asked) == len(self._items)

    def _offer(self, now: float) -> tuple[Effect, ...]:
        self.state = UploadState.OFFERING
        self._reading = None
        self._tries = 0
        self._offered_at = now
        return self._ask(now)

    def _ask(self, now: float) -> tuple[Effect, ...]:
        self._tries += 1
        self.deadline = now + self._wait.wait_s
        return (self._send("MISSION_COUNT", count=len(self._items)),)

    def _again(self, now: float, why: str) -> tuple[Effect, ...]:
        if self._rounds >= MAX_ROUNDS:
            return self._finish(now, "failed", f"not taken in {MAX_ROUNDS} rounds: {why}")
        self._rounds += 1
        return self._offer(now)

    def _read(self, now: float, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Carry on the download by which a lost ack is found out."""
        reading = self._reading
        assert reading is not None
        self.deadline = reading.deadline
        passed = self._passed(effects)
        if reading.outcome is None:
            return passed
        held = reading.outcome
        if held.items is not None and self._same(held.items):
            return (*passed, *self._accepted(now, ", and read back: its own word for it was lost", held.opaque_id))
        why = f"it holds other items, {len(held.items)} of them" if held.items is not None else held.message
        return (*passed, *self._again(now, why))

    def _passed(self, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Return what of the download's effects is the upload's."""
        passed = tuple(effect for effect in effects if isinstance(effect, Send))
        self.sent += len(passed)
        return passed

    def _same(self, held: tuple[MissionItem, ...]) -> bool:
        """True if the vehicle holds what was sent, in its own form; its home is its own."""
        same = same_start(self._items[self._home_first :], held[self._home_first :], self._family)
        return len(held) == len(self._items) == same + self._home_first

    def _accepted(self, now: float, how: str, number: int | None) -> tuple[Effect, ...]:
        count = len(self._items) - self._home_first
        self.state = UploadState.DONE
        self._ended = now
        text = f"{count} {self.kind.word} item{'s' if count != 1 else ''} taken{how}"
        return self._end(now, "accepted", text, "complete", self._items, number)

    def _late_answer(self, seq: int, now: float) -> tuple[Effect, ...]:
        ok = self.outcome is not None and self.outcome.ok
        if not ok or now - self._ended > LINGER_S or self._answers >= ANSWERS_PER_ITEM * len(self._items):
            return ()
        self._answers += 1
        return (self._send("MISSION_ITEM_INT", **item_values(self._items[seq], seq)),)

    def _hinted(self) -> str:
        return f" ({self.texts.behind(self._hint)})" if self._hint else ""

    def _refused(self, meaning: str) -> str:
        """An ack does not name the item; it is the one that was sent last."""
        if not self._asked:
            return f"not taken: {meaning}"
        return f"item {self._last_seq + self._first}: {meaning}"

    def _finish(self, now: float, result: str, message: str) -> tuple[Effect, ...]:
        state, held = self._held(refused=self.state is UploadState.SETTLING)
        self.state = UploadState.DONE
        return self._end(now, result, f"{message}; {held}", state)

    def _held(self, *, refused: bool) -> tuple[ListState, str]:
        """Return what the vehicle holds after an upload that came to no good end. ``refused``: it has said so."""
        word = self.kind.word
        if self._all_sent and not refused:
            return "unknown", f"it may hold the new {word} or not: download it to see"
        if self._keeps_old:
            return "unchanged", f"the vehicle keeps the {word} it had"
        if not self._asked:
            return "unknown", f"the vehicle keeps the {word} it had, cut to {len(self._items)} items if it was longer"
        new = max(self._asked) - 1 + self._first  # what it asked for last may not have come
        if new < 1:
            return (
                "partial",
                f"the vehicle may hold a mixture of the old and the new {word}: upload it again, or clear it",
            )
        return "partial", (
            f"items up to {new} are new and what follows is old: do not fly it; upload the {word} again, or clear it"
        )
