"""The lease of one vehicle, as one site sees it: who may command, and what to write to the hub's key-value store.

The key `<home>.<vehicle>` expires TTL_S after its last write. Create is to acquire, an update with the last revision to
renew; the store lets one writer win. Valid is a lease for its holder from the moment the write was *sent* for VALID_S,
by the holder's own clock, so that it ends before the store can give the key to another.

    state      meaning                                     may send   goes on to
    --------   -----------------------------------------   --------   -------------------------------------------------
    observed   another site commands it, or nobody does    no         wanted: a person takes it, or a rule below
    wanted     it is to be ours: created when it is free   no         held: written; observed: refused, or given up
    held       ours, renewed each RENEW_S                  yes        late: no answer; releasing; observed: taken
    late       ours, the last renewal has no answer        yes        held: renewed; alone: the hub is away (*);
                                                                      wanted or observed: the validity is over
    alone      the home goes on without the hub (*)        yes        held: the hub is back; observed: taken meanwhile
    releasing  given up: the daemon's gate is closed first no         observed: written, or the validity is over

    (*) only the home, only with without_hub = "continue", and only before its validity has ended: a process that was
        stopped, or a home that did not hold it when the hub went, does not begin by itself.

Who takes a key that is free, after what was there has expired:

    home           at once, from anybody; not after a release by its own operator
    another site   if a person said so: with "stop", or with force where the home may go on alone ("continue")
                   by itself: only with "stop", after it saw a holder vanish, OTHERS_LATER_S later than the home

With "continue" no automatic taker exists, so the home alone meets one only where a person insisted.

A released key has no holder and names who wanted it; the home of a released vehicle keeps it written. A hub that is new
(another bucket) grants nothing for NEW_HUB_S to a site that holds nothing: an older holder may be valid until then. A
site that is valid writes its lease there at once.

Pure: time comes in as ``now``, the holder's clock that also runs while the machine sleeps; every method returns what is
to be done. Every write is answered by `answered` or given up by `tick`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal

from pydantic_core import from_json, to_json

TTL_S = 3.0
"""The bucket's TTL. Three renewals fit: two of them may be lost."""

MARGIN_S = 0.5
"""Between the end of a lease for its holder and at the store: two clocks whose rates differ by 1 % part by .06 s, and
what the daemon gave the kernel is on its way for less than the rest."""

VALID_S = TTL_S - MARGIN_S
RENEW_S = 1.0
REPLY_S = 1.0
"""A write without an answer for so long is given up; it may have been stored all the same."""

RETRY_S = 0.25
NEW_HUB_S = TTL_S + MARGIN_S
LOOK_S = 0.1
"""Between two looks at a key that should have expired: the store reports no expiry."""

ALONE_BEFORE_S = 1.0
"""So long before its validity ends a home decides to go on alone: two more renewals have failed by then."""

ALONE_GRANT_S = 0.5
OTHERS_LATER_S = 0.25
RECONNECT_S = 2.0
"""For the home to come back to a hub that was away for all: its bridge tries each .8 s."""

WISH_S = 8.0
"""A person's wish lasts so long: an expiry, a new hub and some retries."""

WITHOUT_HUB_AFTER_S = TTL_S + 1.0
ASK_S = 1.0


class State(StrEnum):
    OBSERVED = "observed"
    WANTED = "wanted"
    HELD = "held"
    LATE = "late"
    ALONE = "alone"
    RELEASING = "releasing"


VALID = frozenset({State.HELD, State.LATE, State.ALONE})


@dataclass(frozen=True, slots=True)
class Entry:
    """What is written under the key. ``holder`` None: released. ``run``: of the holder's daemon."""

    revision: int
    holder: str | None
    run: str
    wanted_by: str | None = None


@dataclass(frozen=True, slots=True)
class Write:
    """Create the key (``revision`` None) or update it; then call `Lease.answered` with ``number``."""

    number: int
    holder: str | None
    run: str
    wanted_by: str | None
    revision: int | None


@dataclass(frozen=True, slots=True)
class Look:
    """Read the key; then call `Lease.seen`, or nothing if that failed. The hub permits no watching."""


@dataclass(frozen=True, slots=True)
class Ask:
    """Ask the holder to release it; then call `Lease.asked`."""

    holder: str
    force: bool


@dataclass(frozen=True, slots=True)
class Grant:
    """Let the daemon send until ``sent_s`` + `VALID_S` of this clock."""

    sent_s: float
    token: int
    hub: str


@dataclass(frozen=True, slots=True)
class Revoke:
    """Have the daemon stop; then call `Lease.revoked` with ``number``."""

    token: int
    hub: str
    commander: str | None
    number: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Report:
    """Say it to people."""

    text: str


Action = Write | Look | Ask | Grant | Revoke | Report
Answer = Literal["conflict", "failed"] | int
"""The revision that was written; conflict: the key was another one; failed: no answer, or no hub."""

Actions = list[Action]


@dataclass(frozen=True, slots=True)
class LeaseConfig:
    """One vehicle of [federation.vehicles], for one site."""

    vehicle: str
    home: str
    site: str
    run: str
    """Names this run of the daemon: a lease of another run is another's, one of this run is ours after a restart of the
    bridge."""
    goes_on_alone: bool = True
    """without_hub = "continue" """

    @property
    def is_home(self) -> bool:
        return self.site == self.home


@dataclass(slots=True)
class _Pending:
    number: int
    sent_s: float
    release: bool


class Lease:
    """One vehicle at one site. Call `tick` ten times a second and carry out what each method returns, in order."""

    def __init__(self, config: LeaseConfig) -> None:
        self.config = config
        self.state = State.OBSERVED
        self.valid_until = -math.inf
        self._hub: str | None = None
        self._connected = False
        self._away_since = -math.inf
        self._usable_at = math.inf
        self._others_from = -math.inf
        """Before, no other site than the home takes it by itself: the home may not be connected again yet."""
        self._known = False
        """``_entry`` is what was seen in this connection."""
        self._entry: Entry | None = None
        self._entry_at = -math.inf
        self._revision = 0
        """Of our last write to this hub; 0: none."""
        self._token, self._token_hub = 0, ""
        """Of the last grant or revocation."""
        self._pending: _Pending | None = None
        self._numbers = 0
        self._next_write = -math.inf
        self._next_look = -math.inf
        self._next_ask = -math.inf
        self._next_grant = -math.inf
        self._absent_since: float | None = None
        self._vanished = False
        """A holder was seen, and its key expired."""
        self._wish_until = -math.inf
        self._forced = False
        self._released = False
        """The home's operator gave it up: it is not taken again by itself until another site has held it."""
        self._release_to: str | None = None
        self._revoked = False
        self._revocations = 0
        self._unwanted = False
        """It was given up while a write was under way that may make it ours."""
        self._contested = False
        """A write of ours met another revision: not alone before it is seen whose."""

    # -- time

    def tick(self, now: float) -> Actions:
        """What is due."""
        out: Actions = []
        pending = self._pending
        if pending is not None and now >= pending.sent_s + REPLY_S:
            out += self._failed(now)
        if self.state in VALID and now >= self.valid_until:
            out += self._lose("its lease was not renewed in time", None)
        if self.state in VALID:
            out += self._hold(now)
        elif self.state is State.RELEASING:
            out += self._let_go(now)
        elif self._connected:
            out += self._seek(now)
        if self.state is State.WANTED and not self._wishes(now) and not self._takes_by_itself(now):
            self.state = State.OBSERVED
        return out

    # -- the hub

    def hub_up(self, hub: str, now: float) -> Actions:
        """Connected to a hub; ``hub`` names its bucket by the time of its creation."""
        if hub != self._hub:
            self._usable_at = now + NEW_HUB_S
            self._vanished, self._revision, self._entry = False, 0, None
        self._hub, self._connected, self._known, self._pending = hub, True, False, None
        self._absent_since = None
        self._others_from = now + RECONNECT_S
        self._next_write = self._next_look = now
        return [Look()]

    def hub_down(self, now: float) -> Actions:
        """The connection is gone."""
        if self._connected:
            self._away_since = now
        self._connected, self._known = False, False
        return self._failed(now) if self._pending is not None else []

    def seen(self, entry: Entry | None, now: float) -> Actions:
        """The key as it is after a `Look`; None: there is none."""
        before = self._entry
        if entry is not None and entry.revision < max(self._revision, 0 if before is None else before.revision):
            return []  # an older answer that came late
        if entry is not None:
            self._vanished = False
        elif before is not None:
            self._vanished = before.holder is not None
        if entry is None:
            self._absent_since = now if self._absent_since is None else self._absent_since
        else:
            self._absent_since = None
        if entry is None or before is None or entry.revision != before.revision:
            self._entry_at = now
        self._entry, self._known = entry, True
        if entry is None or self._is_ours(entry):
            self._contested = False
            self._revision = self._revision if entry is None else entry.revision
            return []
        if entry.holder is not None and entry.holder != self.config.site:
            self._released = False
        if self.state in VALID:
            return self._lose("another site has taken it", entry.holder)
        if self.state is State.RELEASING:
            self.state = State.OBSERVED
        return [self._revoke(entry.holder)]

    def answered(self, number: int, answer: Answer, now: float) -> Actions:
        """The answer to a `Write`."""
        pending = self._pending
        if pending is None or pending.number != number:
            return []  # given up; a look shows what became of it
        self._pending = None
        if answer == "failed":
            self._pending = pending
            return self._failed(now)
        if answer == "conflict":
            self._known, self._contested = False, True
            self._next_look = self._next_write = now + RETRY_S
            return [Look()]
        self._revision = int(answer)
        self._absent_since = None
        if pending.release:
            self._entry = Entry(self._revision, None, self.config.run, self._release_to)
            self._known, self._entry_at, self._next_write = True, now, pending.sent_s + RENEW_S
            if self.state is State.RELEASING:
                self.state = State.OBSERVED
            return []
        return self._written(pending.sent_s, now)

    # -- people

    def take(self, now: float, *, force: bool = False, without_hub: bool = False) -> str | None:
        """Have it be ours; a text if that is refused. What becomes of it shows in `state` and in reports."""
        if self.state in VALID:
            return None
        if without_hub:
            return self._take_without_hub(now, force=force)
        if not self._connected:
            hint = "; `--without-hub --force` if no other site commands it" if self.config.is_home else ""
            return f"the hub is away{hint}"
        self._released, self._forced, self._wish_until = False, force, now + WISH_S
        self._unwanted = False
        self.state, self._next_ask = State.WANTED, now
        if self._usable_at > now:
            self._wish_until = self._usable_at + WISH_S
        return None

    def release(self, now: float) -> Actions:
        """Give it up; others may take it."""
        self._wish_until = -math.inf
        self._released = self.config.is_home
        if self.state not in VALID:
            self._unwanted = self._pending is not None  # it may become ours yet
            return []
        return self._begin_release(None)

    def requested(self, by: str, now: float, *, busy: str | None, force: bool = False) -> tuple[str | None, Actions]:
        """Another site asks for it: why not (None: it is released) and what to do. ``busy``: what it is doing for this
        site; with ``force`` it is released all the same."""
        if self.state not in VALID:
            return None, []  # nothing against it: the key shows who does
        if busy is not None and not force:
            return f"{busy}; `--force` takes it all the same", []
        self._released = False
        return None, [Report(f"{self.config.vehicle} goes to {by}, which asked for it"), *self._begin_release(by)]

    def asked(self, refusal: str | None, now: float) -> Actions:
        """The answer to an `Ask`; None: it is being released. No call if none came."""
        if self.state is not State.WANTED:
            return []
        if refusal is None or self._forced:
            self._known = False  # it is looked at until the release shows
            return []
        self._wish_until = -math.inf
        return [Report(f"{self.config.vehicle} was not taken: {refusal}")]

    def revoked(self, number: int) -> None:
        """The daemon has closed its gate for this `Revoke`. Of an older one it says nothing: a grant may have come
        between them."""
        self._revoked = number == self._revocations

    def adopt(self, until: float, token: int, hub: str) -> None:
        """Go on with what the daemon holds from an earlier run of the bridge; call it before anything else."""
        self.state, self.valid_until, self._revision, self._hub = State.LATE, until, token, hub
        self._token, self._token_hub, self._usable_at = token, hub, -math.inf

    def remember(self, hub: str) -> None:
        """The hub of an earlier run of the bridge: it is not new. Call it before `hub_up`."""
        self._hub, self._usable_at = hub, -math.inf

    # -- status

    @property
    def holder(self) -> str | None:
        """The site that commands it, as far as known here."""
        if self.state in VALID:
            return self.config.site
        return self._entry.holder if self._known and self._entry is not None else None

    def status(self, now: float) -> dict[str, Any]:
        """For people and programs."""
        valid = self.state in VALID and now < self.valid_until
        return {
            "vehicle": self.config.vehicle,
            "home": self.config.home,
            "state": str(self.state),
            "holder": self.holder,
            "held": valid,
            "revision": self._revision if valid or self._entry is None else self._entry.revision,
            "remaining_s": round(self.valid_until - now, 2) if valid else 0.0,
            "without_hub": "continue" if self.config.goes_on_alone else "stop",
        }

    # -- the inside: a valid lease

    def _hold(self, now: float) -> Actions:
        out: Actions = []
        config = self.config
        if self.state is State.ALONE:
            out += self._go_on_alone(now)
        elif now >= self.valid_until - ALONE_BEFORE_S:  # no renewal came through
            self.state = State.LATE
            if config.is_home and config.goes_on_alone and not self._contested:
                self.state, self._next_grant = State.ALONE, now
                out.append(Report(f"{config.vehicle}: the hub is away; {config.site} goes on alone, as its home"))
                out += self._go_on_alone(now)
        if not self._connected or self._pending is not None or now < self._next_write:
            return out
        if not self._known:
            return out + self._look(now)
        self._next_write = now + RETRY_S
        return [*out, self._write(now, None if self._entry is None else self._entry.revision)]

    def _go_on_alone(self, now: float) -> Actions:
        self.valid_until = now + VALID_S
        if now < self._next_grant:
            return []
        self._next_grant = now + ALONE_GRANT_S
        return [self._grant(now)]

    def _grant(self, sent_s: float) -> Grant:
        """Of what is valid from then. Alone, it is still the last token."""
        if self._revision:
            self._token, self._token_hub = self._revision, self._hub or ""
        return Grant(sent_s, self._token, self._token_hub)

    def _revoke(self, commander: str | None) -> Revoke:
        self._revocations += 1
        return Revoke(self._token, self._token_hub, commander, self._revocations)

    def _written(self, sent_s: float, now: float) -> Actions:
        """Our name is under the key since some time after ``sent_s``."""
        config = self.config
        self._entry = Entry(self._revision, config.site, config.run)
        self._known, self._entry_at, self._contested = True, now, False
        self._next_write = sent_s + RENEW_S
        if now >= sent_s + VALID_S:
            self._next_write = now
            return []  # the answer took too long; written again
        out: Actions = []
        if self.state not in VALID:
            if self.state is State.RELEASING:
                return []
            if self._unwanted:
                self._unwanted = False
                return self._begin_release(None)
            out.append(Report(f"{config.vehicle} is commanded by {config.site}"))
        elif self.state is State.ALONE:
            out.append(Report(f"{config.vehicle}: the hub is back, and the lease is held"))
        self.state, self.valid_until = State.HELD, sent_s + VALID_S
        self._wish_until, self._forced, self._vanished = -math.inf, False, False
        return [self._grant(sent_s), *out]

    def _lose(self, why: str, commander: str | None) -> Actions:
        config = self.config
        self.state, self.valid_until = State.OBSERVED, -math.inf
        self._next_look = -math.inf
        by = "" if commander is None else f" ({commander})"
        return [
            self._revoke(commander),
            Report(f"{config.vehicle} is not commanded by {config.site} any more: {why}{by}"),
        ]

    def _failed(self, now: float) -> Actions:
        self._pending = None
        self._known = False
        self._next_write = now + RETRY_S
        if self.state is State.HELD:
            self.state = State.LATE
        return []

    # -- the inside: giving it up

    def _begin_release(self, to: str | None) -> Actions:
        self.state, self._release_to, self._revoked, self._next_write = State.RELEASING, to, False, -math.inf
        return [self._revoke(to)]

    def _let_go(self, now: float) -> Actions:
        """Write the release once the daemon sends nothing any more: it said so, or its grant is over."""
        over = now >= self.valid_until
        if not self._connected:
            if over:
                self.state = State.OBSERVED
            return []
        if self._pending is not None or now < self._next_write or not (self._revoked or over):
            return []
        if over and (not self._known or self._entry is None):
            self.state = State.OBSERVED  # it has expired, or will
            return []
        self._next_write = now + RETRY_S
        revision = self._revision if self._entry is None or not self._known else self._entry.revision
        return [self._write_release(now, revision)]

    # -- the inside: not ours

    def _seek(self, now: float) -> Actions:
        if not self._known or self._entry_is_old(now):
            return self._look(now)
        if self._pending is not None or now < self._next_write:
            return []
        entry, config = self._entry, self.config
        if entry is not None and entry.holder is not None and not self._is_ours(entry):
            if self.state is State.WANTED and self._wishes(now) and now >= self._next_ask:
                self._next_ask = now + ASK_S
                return [Ask(entry.holder, self._forced)]
            return []
        if self._released and config.is_home:
            self._release_to = None
            return [self._write_release(now, None if entry is None else entry.revision)]
        if now < self._usable_at or not self._may_take(entry, now):
            return []
        self.state = State.WANTED
        return [self._write(now, None if entry is None else entry.revision)]

    def _may_take(self, entry: Entry | None, now: float) -> bool:
        if entry is not None and self._is_ours(entry):
            return self.config.is_home or self._wishes(now)
        if entry is None:
            return self._may_take_free(now)
        reserved = entry.wanted_by is not None and entry.wanted_by != self.config.site
        if self._wishes(now):
            return not reserved or self._forced
        return self.config.is_home and not reserved and not self._released

    def _may_take_free(self, now: float) -> bool:
        if self._takes_by_itself(now):
            return True
        if not self._wishes(now):
            return False
        return self.config.is_home or self._forced or not self.config.goes_on_alone

    def _takes_by_itself(self, now: float) -> bool:
        if self.config.is_home:
            return not self._released
        if self.config.goes_on_alone or not self._vanished or self._absent_since is None:
            return False
        return now >= max(self._absent_since + OTHERS_LATER_S, self._others_from)

    def _take_without_hub(self, now: float, *, force: bool) -> str | None:
        if not self.config.is_home:
            return f"only its home ({self.config.home}) may command it without the hub"
        if self._connected:
            return "the hub is there: take it without --without-hub"
        if not force:
            return "another site may command it: insist with --force if none does"
        wait_s = self._away_since + WITHOUT_HUB_AFTER_S - now
        if wait_s > 0:
            return f"another site may hold it for {wait_s:.1f} s more: try again then"
        self.state, self._next_grant, self._released = State.ALONE, now, False
        self.valid_until = now + VALID_S
        self._token, self._revision = self._token + 1, 0  # the last one may have been revoked
        return None

    def _entry_is_old(self, now: float) -> bool:
        """A holder that renews is seen each second; a key that expires is not reported."""
        return now >= self._entry_at + (RENEW_S + RETRY_S if self._entry is not None else RENEW_S)

    def _look(self, now: float) -> Actions:
        if now < self._next_look:
            return []
        self._next_look = now + LOOK_S
        return [Look()]

    def _wishes(self, now: float) -> bool:
        return now < self._wish_until

    def _is_ours(self, entry: Entry) -> bool:
        return entry.holder == self.config.site and entry.run == self.config.run

    def _write(self, now: float, revision: int | None) -> Write:
        return self._next(now, Write(0, self.config.site, self.config.run, None, revision), release=False)

    def _write_release(self, now: float, revision: int | None) -> Write:
        self._next_write = now + RETRY_S
        return self._next(now, Write(0, None, self.config.run, self._release_to, revision), release=True)

    def _next(self, now: float, write: Write, *, release: bool) -> Write:
        self._numbers += 1
        self._pending = _Pending(self._numbers, now, release)
        return replace(write, number=self._numbers)


MAX_ENTRY_BYTES = 1024
_UNREADABLE = Entry(0, "?", "")
"""Somebody's, as far as one can see: nobody uses the key before it has expired."""


def encode_entry(holder: str | None, run: str, since_s: float, wanted_by: str | None) -> bytes:
    """The value of a key."""
    return to_json({"holder": holder, "run": run, "since_s": round(since_s, 3), "wanted_by": wanted_by})


def decode_entry(value: bytes, revision: int) -> Entry:
    """The value of a key, whoever wrote it."""
    try:
        found = from_json(value) if len(value) <= MAX_ENTRY_BYTES else None
    except ValueError:
        found = None
    if not isinstance(found, dict):
        return replace(_UNREADABLE, revision=revision)
    holder, run, wanted_by = found.get("holder"), found.get("run"), found.get("wanted_by")
    if not all(text is None or (isinstance(text, str) and len(text) <= 64) for text in (holder, run, wanted_by)):
        return replace(_UNREADABLE, revision=revision)
    return Entry(revision, holder, run or "", wanted_by)
