"""Which store of leases the hub has, and whether its revisions went back.

Each write gets a revision above all earlier ones of the store. A hub that lost its last writes, was restored from a
snapshot, or whose bucket was deleted and created again counts from a lower one. Keys are missing there although their
holders are valid, so it is another store to a `Lease`, and gets another name:

    what is seen                                                       name
    ----------------------------------------------------------------   ------------------------------------
    another time of creation, or another process of the hub            another one
    the last revision is below one that was known before the question  another one
    an answer with a low revision to a read                            ask: it may be old and have come late

The process of the hub counts because a site that was away does not know the last revisions before a power cut. A write
whose answer has a revision that was known before it was sent went to another store as well.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

MAX_NAMES = 256
"""Stores whose revisions are kept, those noted last: the daemon may have tokens of an older one for each vehicle."""

NAME_DIGITS = 32


@dataclass(frozen=True, slots=True)
class StoreQuestion:
    """State that was known before a question or a write was sent."""

    name: str
    highest: int


class LeaseStore:
    """The hub's store of leases, as one bridge sees it. ``name`` is "" before the first answer. Pure."""

    def __init__(self) -> None:
        self.name = ""
        self._identity: str | None = None
        self._highest: dict[str, int] = {}
        """By name, the highest revision that is known."""

    def note(self, revision: int, name: str | None = None) -> None:
        """A revision of the present store, or of the one with this name, is known."""
        name = self.name if name is None else name
        self._highest[name] = max(revision, self._highest.pop(name, 0))
        while len(self._highest) > MAX_NAMES:
            del self._highest[next(iter(self._highest))]

    def question(self) -> StoreQuestion:
        """Make it before the store is read or written; pass it on with the answer."""
        return StoreQuestion(self.name, self._highest.get(self.name, 0))

    def found(self, question: StoreQuestion, identity: str, last_revision: int, now: float) -> bool:
        """The store's answer about itself. ``identity``: its creation and the hub's process. True if it is another
        store than before, with another `name`."""
        if question.name != self.name:
            return False  # renamed meanwhile
        if identity != self._identity:
            self._identity = identity
            self.name = _name(identity)
            if last_revision < self._highest.get(self.name, 0):
                self.name = _name(f"{identity} {now!r}")
        elif last_revision < question.highest:
            self.name = _name(f"{identity} {now!r}")
        self.note(last_revision)
        return self.name != question.name

    def written(self, question: StoreQuestion, revision: int, now: float) -> bool:
        """A write was accepted with this revision. True if it went to another store than before, which has another
        `name` now."""
        if question.name != self.name:
            return False
        back = revision <= question.highest
        if back:
            self.name = _name(f"{self._identity} {now!r}")
        self.note(revision)
        return back


def _name(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:NAME_DIGITS]
