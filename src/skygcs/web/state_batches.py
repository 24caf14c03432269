"""Coalescing of vehicle states for pages: one store for all, one number for each page. Pure.

The store has the newest state of each vehicle, encoded once, in the order in which they came. What a page has not been
sent is what came after the number it remembers: a page that does not read costs no memory and gets, when it reads
again, each vehicle's newest state once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

MAX_REMOVED = 1024
"""Vehicles forgotten and not yet reported to every page; beyond, pages get the whole fleet anew."""

SETTLE_S = 0.004
"""A round of states comes from the daemon in several pieces, and the daemon marks the last one. From a source that
marks none, it is complete when it was quiet for so long."""

MAX_ROUND_S = 0.05
"""It is sent at the latest so long after its first piece. What comes then waits for half a period, which is as long:
with 50 vehicles a round takes 5 ms, with 200 on a busy machine 30 ms."""


@dataclass(slots=True)
class _Entry:
    number: int
    body: bytes
    at: float


class LatestStates:
    """The newest state of each vehicle. ``generation`` counts the times when all before was forgotten."""

    def __init__(self) -> None:
        self.generation = 0
        self.complete = False
        """False from `reset` to the end of a round: what the fleet is, is not known, and pages are sent nothing."""
        self.number = 0
        self.heard_at = 0.0
        """When the newest state came."""
        self.began_at = 0.0
        """When the first state of the newest round came."""
        self._entries: dict[str, _Entry] = {}
        self._removed: dict[str, int] = {}
        self._round_began: float | None = None
        self._round_over = False
        self._marked = False
        """Whether the source marks the end of a round."""

    def __len__(self) -> int:
        return len(self._entries)

    def put(self, name: str, body: bytes, now: float) -> None:
        """A newer state of this vehicle, encoded."""
        self.number += 1
        self.heard_at = now
        self._round_over = False
        if self._round_began is None:
            self._round_began = self.began_at = now
        self._entries.pop(name, None)
        self._removed.pop(name, None)
        self._entries[name] = _Entry(self.number, body, now)

    def remove(self, name: str) -> None:
        """The vehicle is forgotten."""
        if self._entries.pop(name, None) is None:
            return
        self.number += 1
        self._removed[name] = self.number
        if len(self._removed) > MAX_REMOVED:
            self._removed.clear()
            self.generation += 1

    def remove_older(self, than: float) -> None:
        """Forget vehicles whose newest state came before: the daemon no longer has them."""
        for name in [name for name, entry in self._entries.items() if entry.at < than]:
            self.remove(name)

    def reset(self) -> None:
        """Forget everything: another daemon, or another place in a recording."""
        self._entries.clear()
        self._removed.clear()
        self._round_began = None
        self._marked = self.complete = False
        self.generation += 1
        self.number += 1

    def settle(self) -> None:
        """There are no other vehicles than those that are known, be it none."""
        self.complete = True

    def round_complete_at(self) -> float | None:
        """When what came may be sent; None: nothing has come since `end_round`."""
        if self._round_began is None:
            return None
        if self._round_over:
            return self.heard_at
        latest = self._round_began + MAX_ROUND_S
        return latest if self._marked else min(self.heard_at + SETTLE_S, latest)

    def complete_round(self) -> None:
        """The source says that no more of this round is on its way."""
        self._round_over = self._marked = True

    def end_round(self) -> None:
        """What came so far is a round."""
        self._round_began = None
        self._round_over = False
        self.settle()

    def since(self, number: int) -> tuple[list[bytes], list[str]]:
        """(states, names that are gone) after ``number``, the oldest state first."""
        changed = []
        for entry in reversed(self._entries.values()):
            if entry.number <= number:
                break
            changed.append(entry.body)
        changed.reverse()
        return changed, [name for name, at in self._removed.items() if at > number]


class PageStates:
    """What one page has been sent. At most ``rate_hz`` batches a second."""

    def __init__(self, states: LatestStates, rate_hz: float) -> None:
        self.seq = 0
        self.rate_hz = rate_hz
        self._states = states
        self._number = -1
        self._generation: int | None = None
        self._sent_at = float("-inf")

    def again(self, rate_hz: float) -> None:
        """Begin anew with the whole fleet."""
        self.rate_hz = rate_hz
        self._generation = None

    def due_at(self) -> float | None:
        """When the next batch may be sent; None: there is nothing to send. A new generation waits only until its fleet
        is known."""
        if not self._states.complete:
            return None
        if self._generation != self._states.generation:
            return float("-inf")
        if self._states.number == self._number:
            return None
        # half a period early is in time: rounds jitter, and one that is left out costs a whole period of age
        return self._sent_at + 0.5 / self.rate_hz

    def batch(self, now: float) -> tuple[bool, list[bytes], Sequence[str]]:
        """(whether it is the whole fleet, states, names that are gone); `seq` is its number."""
        full = self._generation != self._states.generation
        changed, gone = self._states.since(-1 if full else self._number)
        self._generation, self._number = self._states.generation, self._states.number
        self._sent_at = now
        self.seq += 1
        return full, changed, () if full else gone
