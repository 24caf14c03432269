"""Coalescing of vehicle states for pages: one store for all, one number for each page. Pure.

The store has the newest state of each vehicle, encoded once, in the order in which they came. What a page has not been
sent is what came after the number it remembers: a page that does not read costs no memory and gets, when it reads
again, each vehicle's newest state once.

Of a large fleet it gets what it shows (`fleet_digest`): states in full of those that its view asks for, the others in
brief and counts of each site once a second. A vehicle that leaves the view is sent in brief at once: no page keeps a
state in full that it is not sent any more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from skygcs.web.fleet_digest import EVERYTHING, LARGE_FLEET, SMALL_AGAIN, Digest, View, count_sites, digest_of

MAX_REMOVED = 1024
"""Vehicles forgotten and not yet reported to every page; beyond, pages get the whole fleet anew."""

SETTLE_S = 0.004
"""A round of states comes from the daemon in several pieces, and the daemon marks the last one. From a source that
marks none, it is complete when it was quiet for so long."""

BRIEF_EVERY_S = 1.0
"""The brief level: a vehicle that is drawn as a dot moves by a few pixels meanwhile."""

MAX_ROUND_S = 0.05
"""It is sent at the latest so long after its first piece. What comes then waits for half a period, which is as long:
with 50 vehicles a round takes 5 ms, with 200 on a busy machine 30 ms."""


@dataclass(slots=True)
class _Entry:
    number: int
    body: bytes
    at: float
    digest: Digest | None = None
    """Digest of the state, in a large fleet."""


class Batch(NamedTuple):
    """Batch that one page is sent at one time."""

    full: bool
    """It is the whole fleet; forget what was sent before."""
    states: list[bytes]
    gone: list[str]
    brief: list[bytes] | None = None
    """Rows of `Digest`; None: the fleet is not large, and ``states`` has all."""
    sites: list[dict[str, Any]] | None = None
    """Counts; None: those sent last still hold."""
    left_out: int = 0
    """Vehicles that the page's view asks for and that are sent in brief, because they are too many."""


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
        self.large = False
        """Pages get levels of detail."""
        self._entries: dict[str, _Entry] = {}
        self._ordered: list[str] | None = None
        """Names in the order of lists; None: not known any more."""
        self._removed: dict[str, int] = {}
        self._round_began: float | None = None
        self._round_over = False
        self._marked = False
        """True if the source marks the end of a round."""

    def __len__(self) -> int:
        return len(self._entries)

    def put(self, name: str, body: bytes, now: float) -> None:
        """A newer state of this vehicle, encoded."""
        self.number += 1
        self.heard_at = now
        self._round_over = False
        if self._round_began is None:
            self._round_began = self.began_at = now
        known = self._entries.pop(name, None)
        self._removed.pop(name, None)
        # of a large fleet it is read at once: all of them together would keep the loop for 15 ms
        self._entries[name] = _Entry(self.number, body, now, digest_of(name, body, now) if self.large else None)
        if known is None:
            self._ordered = None

    def remove(self, name: str) -> None:
        """The vehicle is forgotten."""
        if self._entries.pop(name, None) is None:
            return
        self.number += 1
        self._ordered = None
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
        self._ordered = None
        self.large = False
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
        """End a round with what came so far."""
        self._round_began = None
        self._round_over = False
        self.settle()
        large = len(self._entries) > (SMALL_AGAIN if self.large else LARGE_FLEET)
        if large != self.large:
            self.large = large
            self.generation += 1

    def since(self, number: int) -> tuple[list[tuple[str, bytes]], list[str]]:
        """(names with their states, names that are gone) after ``number``, the oldest state first."""
        changed = []
        for name, entry in reversed(self._entries.items()):
            if entry.number <= number:
                break
            changed.append((name, entry.body))
        changed.reverse()
        return changed, [name for name, at in self._removed.items() if at > number]

    def body(self, name: str) -> bytes:
        return self._entries[name].body

    def digests(self) -> Iterator[Digest]:
        """Digests of a large fleet, in the order of their lists."""
        if self._ordered is None:
            self._ordered = [digest.name for digest in sorted(self._digests(), key=lambda one: one.order)]
        for name in self._ordered:
            yield self._digest(name, self._entries[name])

    def _digests(self) -> Iterator[Digest]:
        for name, entry in self._entries.items():
            yield self._digest(name, entry)

    def _digest(self, name: str, entry: _Entry) -> Digest:
        if entry.digest is None:
            entry.digest = digest_of(name, entry.body, entry.at)
        return entry.digest


class PageStates:
    """States that one page has been sent. At most ``rate_hz`` batches a second."""

    def __init__(self, states: LatestStates, rate_hz: float) -> None:
        self.seq = 0
        self.rate_hz = rate_hz
        self._states = states
        self._view = EVERYTHING
        self._view_changed = False
        self._number = -1
        self._generation: int | None = None
        self._sent_at = float("-inf")
        self._full: set[str] = set()
        """Vehicles of a large fleet that the page was sent in full."""
        self._left_out = 0
        self._briefed_at = float("-inf")
        self._briefed = -1
        """The number up to which it was sent the others."""

    def again(self, rate_hz: float) -> None:
        """Begin anew with the whole fleet."""
        self.rate_hz = rate_hz
        self._generation = None

    def show(self, view: View) -> None:
        """Set the vehicles of a large fleet that the page shows in full."""
        self._view_changed = self._view_changed or view != self._view
        self._view = view

    def due_at(self) -> float | None:
        """When the next batch may be sent; None: there is nothing to send. A new generation waits only until its fleet
        is known, and a new view for nothing."""
        if not self._states.complete:
            return None
        if self._generation != self._states.generation or (self._view_changed and self._states.large):
            return float("-inf")
        if self._states.number == self._number:
            return None
        # half a period early is in time: rounds jitter, and one that is left out costs a whole period of age
        return self._sent_at + 0.5 / self.rate_hz

    def batch(self, now: float) -> Batch:
        """The next one; `seq` is its number."""
        states = self._states
        anew = self._generation != states.generation
        changed, gone = states.since(-1 if anew else self._number)
        if anew:
            gone = []
            self._full.clear()
            self._briefed_at, self._briefed = float("-inf"), -1
        self._generation, self._number = states.generation, states.number
        self._sent_at = now
        self.seq += 1
        if not states.large:
            return Batch(anew, [body for _, body in changed], gone)
        return self._levels(anew, changed, gone, now)

    def _levels(self, anew: bool, changed: list[tuple[str, bytes]], gone: list[str], now: float) -> Batch:
        """Levels of a large fleet. What a page asks for is looked at anew with each brief, and when its view
        changes."""
        states, before = self._states, self._full
        brief_due = now - self._briefed_at >= BRIEF_EVERY_S
        if brief_due or self._view_changed:
            self._full, self._left_out = self._view.wanted(states.digests(), now)
            self._view_changed = False
        else:
            self._full = before.difference(gone)
        bodies = [body for name, body in changed if name in self._full and name in before]
        bodies += [states.body(name) for name in self._full - before]
        left = before - self._full
        brief, sites = [], None
        if brief_due:
            newer = {name for name, _ in states.since(self._briefed)[0]}
            self._briefed_at, self._briefed = now, states.number
            brief = [
                d.row for d in states.digests() if d.name not in self._full and (d.name in newer or d.name in left)
            ]
            sites = count_sites(states.digests(), now)
        elif left:
            brief = [digest.row for digest in states.digests() if digest.name in left]
        return Batch(anew, bodies, gone, brief, sites, self._left_out)
