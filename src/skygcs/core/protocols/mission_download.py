"""Download of a whole list (mission, fence or rally points).

Rule: everything that decides how a download goes on is in this file.

    state      what came                                      next         effects
    --------   --------------------------------------------   ----------   -----------------------------------------
    IDLE       start                                          LISTING      MISSION_REQUEST_LIST
    LISTING    timer, repeats left                            LISTING      MISSION_REQUEST_LIST
    LISTING    count of 0                                     DONE         MISSION_ACK, Finish: accepted
    LISTING    count                                          FETCHING     MISSION_REQUEST_INT of item 0
    LISTING    ack: denied, for less than DENIED_S            LISTING      - (the timer asks again)
    LISTING    ack refusing (not: error, gave up)             SETTLING     - (the text that says why may follow)
    FETCHING   the item asked for, not the last               FETCHING     Report, MISSION_REQUEST_INT of the next
    FETCHING   the item asked for, the last                   DONE         MISSION_ACK, Finish: accepted
    FETCHING   another item (late, twice)                     FETCHING     -
    FETCHING   timer, repeats left                            FETCHING     MISSION_REQUEST_INT again
    FETCHING   another count, or ack refusing                 LISTING      MISSION_REQUEST_LIST: it is another list now
    LISTING, FETCHING   timer, or rounds, none left           DONE         Finish: timeout or failed
    SETTLING   timer                                          DONE         Finish: that refusal
    not DONE   stop (cancelled, vehicle lost, ...)            DONE         MISSION_ACK (cancelled), Finish: as given
    DONE       anything                                       DONE         -

One request is under way at a time: a PX4 answers only the next item and the one before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, auto
from typing import Any

from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.protocols.base import Effect, ProgressReport
from skygcs.core.protocols.command import SETTLE_S
from skygcs.core.protocols.mission import (
    ACCEPTED,
    DENIED,
    ERROR,
    INVALID_SEQUENCE,
    MAX_TRIES,
    OPERATION_CANCELLED,
    MissionProtocol,
    RoundTrip,
    meaning_of,
)

MAX_ROUNDS = 12
"""Times that the list is fetched from its beginning; one that changes more often is being changed by somebody. A PX4
ends a transfer after 5 s without a request that it hears: 18 items at 25 % lost each way and delays up to 1 s failed in
298 of 3000 runs with 4 rounds, in 31 with 8 and in 1 with 12."""


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
        if self.state is not DownloadState.FETCHING or seq != len(self._items):
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
        self._wait.failed()
        if self._tries < MAX_TRIES:
            return self._ask_list(now) if self.state is DownloadState.LISTING else self._ask_item(now)
        what = "the list" if self.state is DownloadState.LISTING else f"item {len(self._items)} of {self.count}"
        return self._finish(now, "timeout", f"no answer to {self._tries} requests of {what}")

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
        self.deadline = now + self._wait.wait_s
        return (self._send("MISSION_REQUEST_LIST"),)

    def _request(self, now: float) -> tuple[Effect, ...]:
        self._tries = 0
        self._asked = now
        return self._ask_item(now)

    def _ask_item(self, now: float) -> tuple[Effect, ...]:
        self._tries += 1
        self.deadline = now + self._wait.wait_s
        return (self._send("MISSION_REQUEST_INT", seq=len(self._items)),)

    def _again(self, now: float, why: str) -> tuple[Effect, ...]:
        if self._rounds >= MAX_ROUNDS:
            return self._finish(now, "failed", f"not read in {MAX_ROUNDS} rounds: {why}")
        self._rounds += 1
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
