"""The lease of one vehicle, as one site sees it: which site may command, and what to write to the hub's store.

The key `<home>.<vehicle>` of the key-value store expires TTL_S after its last write. A site acquires the lease by
creating the key and renews it by an update with the last revision; of two writers the store accepts one. For its holder
the lease is valid for VALID_S from the moment the write was *sent*, by the holder's own clock, so that it ends before
the store can give the key to another site.

    state      meaning                                     may send   goes on to
    --------   -----------------------------------------   --------   -------------------------------------------------
    observed   another site commands it, or none does      no         wanted: a person takes it, or a rule below
    wanted     this site creates the key when it is free   no         held: written; observed: refused, or given up
    held       ours, renewed each RENEW_S                  yes        late: no answer; releasing; observed: taken
    late       ours, the last renewal has no answer        yes        held: renewed; alone: the hub is away (*);
                                                                      wanted or observed: the validity is over
    alone      the home goes on without the hub (*)        yes        held: the hub is back; observed: taken meanwhile
    releasing  given up: the daemon's gate is closed first no         observed: written, or the validity is over

    (*) only the home, only with without_hub = "continue", and only before its validity has ended: a process that was
        stopped, or a home that did not hold the lease when the hub was lost, does not go on alone by itself.

Which site takes a free key, after the previous entry has expired:

    home           at once, whichever site held it before; not after a release by its own operator
    another site   on a person's request: with "stop", or with force where the home may go on alone ("continue")
                   by itself: only with "stop", after it saw a holder vanish, OTHERS_LATER_S later than the home

With "continue" no other site takes the lease by itself: a home that goes on alone can conflict with another site only
where a person forced it.

A released key has no holder and names the site that asked for it; the home keeps a released key written. After a change
of the hub (another store, see `lease_store`) a site that holds nothing writes nothing for NEW_HUB_S, because an older
holder may be valid until then; a site whose lease is valid writes it there at once.

Pure: time comes in as ``now``, the holder's clock, which also runs while the machine sleeps; every method returns the
actions to carry out. Every write ends with a call of `answered`, or `tick` gives it up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal

from pydantic_core import from_json, to_json

from skygcs.ext.federation.protocol.received_json import printable

TTL_S = 3.0
"""The bucket's TTL. Three renewals fit: two of them may be lost."""

MARGIN_S = 0.5
"""From the end of a lease for its holder to its expiry at the store. Two clocks whose rates differ by 1 % drift apart
by 0.06 s in the meantime; the rest is for frames that the daemon has given to the kernel already."""

VALID_S = TTL_S - MARGIN_S
"""How long a holder may send, from the moment it sent the write."""

RENEW_S = 1.0
"""Period of the renewals."""

REPLY_S = 1.0
"""A write that has no answer after this time is given up; the store may have accepted it."""

RETRY_S = 0.25
"""Pause before a write that failed is sent again."""

NEW_HUB_S = TTL_S + MARGIN_S
"""How long a site that holds nothing waits at a new hub: leases of the previous hub have expired by then."""

LOOK_S = 0.1
"""Least time between two readings of a key that should have expired: the store does not report an expiry."""

ALONE_BEFORE_S = 1.0
"""How long before the end of its validity a home decides to go on alone: a renewal has had no answer by then."""

ALONE_GRANT_S = 0.5
"""Period of the grants while the home goes on alone; each is valid for VALID_S."""

OTHERS_LATER_S = 0.25
"""How much later than the home another site takes an expired lease, so that the home is first."""

RECONNECT_S = 2.0
"""Time for the home's bridge to reconnect to a hub that all sites lost; it pauses 0.5 s at most between attempts."""

REQUEST_S = 8.0
"""How long a person's request to take a lease is pursued: an expiry, a new hub and some retries fit."""

WITHOUT_HUB_AFTER_S = TTL_S + 1.0
"""Time after the loss of the hub before a person may command without it: the lease of any other site is over."""

ASK_S = 1.0
"""Period of the requests to the holder to release its lease."""


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
    """The value of the key. ``holder``: None if it was released. ``run``: identifies the run of the holder's daemon."""

    revision: int
    holder: str | None
    run: str
    wanted_by: str | None = None


@dataclass(frozen=True, slots=True)
class Write:
    """Create the key (``revision`` None) or update it; call `Lease.answered` with ``number`` and the result."""

    number: int
    holder: str | None
    run: str
    wanted_by: str | None
    revision: int | None


@dataclass(frozen=True, slots=True)
class Look:
    """Read the key and call `Lease.seen`; call nothing if the reading failed. The hub permits no watch on a key."""


@dataclass(frozen=True, slots=True)
class Inspect:
    """A lower revision than before was read: ask the store about itself, and call `Lease.hub_up` if `LeaseStore` finds
    that it is another one. If it is not, the reading was old and came late."""


@dataclass(frozen=True, slots=True)
class Ask:
    """Ask the holder to release the lease and call `Lease.asked` with its answer."""

    holder: str
    force: bool


@dataclass(frozen=True, slots=True)
class Grant:
    """Permit the daemon to send until ``sent_s`` + `VALID_S` of this clock."""

    sent_s: float
    token: int
    hub: str


@dataclass(frozen=True, slots=True)
class Revoke:
    """Have the daemon stop sending; call `Lease.revoked` with ``number`` when it has."""

    token: int
    hub: str
    commander: str | None
    number: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class LeaseReport:
    """Report this text to people: log and events."""

    text: str


Action = Write | Look | Inspect | Ask | Grant | Revoke | LeaseReport
Answer = Literal["conflict", "failed"] | int
"""Result of a `Write`: the new revision; "conflict": the key had another revision; "failed": no answer, or no hub."""

Actions = list[Action]


@dataclass(frozen=True, slots=True)
class LeaseConfig:
    """One vehicle of [federation.vehicles], for one site."""

    vehicle: str
    home: str
    site: str
    run: str
    """Identifies this run of the daemon. A lease of this run is still ours after a restart of the bridge; a lease of
    another run of this site's daemon is treated as another site's."""
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
    """The lease of one vehicle at one site. Call `tick` ten times a second, and carry out the actions that each method
    returns, in order."""

    def __init__(self, config: LeaseConfig) -> None:
        self.config = config
        self.state = State.OBSERVED
        self.valid_until = -math.inf
        # connection to the hub
        self._hub: str | None = None
        self._connected = False
        self._away_since: float | None = None
        """When the hub was lost; from the first call on if it was not there. None: it was there, or no call yet."""
        self._usable_at = math.inf
        self._others_from = -math.inf
        """Until then only the home takes it by itself; the home may not have reconnected yet."""
        # the entry of the lease as this site knows it
        self._known = False
        """True if ``_entry`` was read in this connection."""
        self._entry: Entry | None = None
        self._entry_at = -math.inf
        self._revision = 0
        """Revision of our last write to this hub; 0: none."""
        self._token, self._token_hub = 0, ""
        """Fencing token of the last grant or revocation, and the hub that numbered it."""
        # requests in progress, and when the next ones are due
        self._pending: _Pending | None = None
        self._numbers = 0
        self._next_write = -math.inf
        self._next_look = -math.inf
        self._next_ask = -math.inf
        self._next_grant = -math.inf
        # absence of the holder
        self._absent_since: float | None = None
        self._vanished = False
        """True if a holder was seen and its key has expired since."""
        # wishes of this site's operator
        self._requested_until = -math.inf
        """End of a person's request to take it."""
        self._forced = False
        self._released = False
        """The home's operator gave it up: the home does not take it again by itself until another site has held it."""
        self._release_to: str | None = None
        # conflicts with other writers
        self._revoked = False
        self._revocations = 0
        self._unwanted = False
        """It was given up while a write that may make it ours had no answer yet."""
        self._contested = False
        """A write of ours met another revision: the home does not go on alone until it has read whose it is."""

    # -- time

    def tick(self, now: float) -> Actions:
        """The actions that are due now."""
        self._note_away(now)
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
        if self.state is State.WANTED and not self._is_requested(now) and not self._takes_by_itself(now):
            self.state = State.OBSERVED
        return out

    # -- the hub

    def hub_up(self, hub: str, now: float) -> Actions:
        """The bridge has connected, or the store is another one now. ``hub``: its name by `LeaseStore`."""
        if hub != self._hub:
            self._usable_at = now + NEW_HUB_S
            self._vanished, self._revision, self._entry = False, 0, None
        self._hub, self._connected, self._known, self._pending = hub, True, False, None
        self._away_since = None
        self._absent_since = None
        self._others_from = now + RECONNECT_S
        self._next_write = self._next_look = now
        return [Look()]

    def hub_down(self, now: float) -> Actions:
        """The connection to the hub is lost."""
        self._connected, self._known = False, False
        self._note_away(now)
        return self._failed(now) if self._pending is not None else []

    def seen(self, entry: Entry | None, now: float) -> Actions:
        """The result of a `Look`; ``entry`` None: the key does not exist."""
        before = self._entry
        if entry is not None and entry.revision < max(self._revision, 0 if before is None else before.revision):
            return [Inspect()]  # an older answer that came late, or the store's revisions went back
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
        """The result of the `Write` with this number."""
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
        """A person asks for the lease. Returns why that is refused, None if it is pursued; `state` and `LeaseReport`
        actions show the result."""
        if self.state in VALID:
            return None
        if without_hub:
            return self._take_without_hub(now, force=force)
        if not self._connected:
            hint = "; `--without-hub --force` if no other site commands it" if self.config.is_home else ""
            return f"the hub is away{hint}"
        self._released, self._forced, self._requested_until = False, force, now + REQUEST_S
        self._unwanted = False
        self.state, self._next_ask = State.WANTED, now
        if self._usable_at > now:
            self._requested_until = self._usable_at + REQUEST_S
        return None

    def release(self, now: float) -> Actions:
        """A person gives the lease up; another site may take it."""
        self._requested_until = -math.inf
        self._released = self.config.is_home
        if self.state not in VALID:
            self._unwanted = self._pending is not None  # it may become ours yet
            return []
        return self._begin_release(None)

    def requested(self, by: str, now: float, *, busy: str | None, force: bool = False) -> tuple[str | None, Actions]:
        """The site ``by`` asks for the lease. Returns why it is not released (None: it is) and the actions.
        ``busy``: what this site does with the vehicle, None for nothing; ``force`` releases it all the same."""
        if self.state not in VALID:
            return None, []  # no objection: the key shows which site holds it
        if busy is not None and not force:
            return f"{busy}; `--force` takes it all the same", []
        self._released = False
        return None, [LeaseReport(f"{self.config.vehicle} goes to {by}, which asked for it"), *self._begin_release(by)]

    def asked(self, refusal: str | None, now: float) -> Actions:
        """The answer to an `Ask`: why the holder refuses, None if it releases the lease. Without an answer do not
        call it."""
        if self.state is not State.WANTED:
            return []
        if refusal is None or self._forced:
            self._known = False  # read again until the release shows
            return []
        self._requested_until = -math.inf
        return [LeaseReport(f"{self.config.vehicle} was not taken: {refusal}")]

    def revoked(self, number: int) -> None:
        """The daemon has closed its gate for this `Revoke`. An older number is ignored: a grant may have opened the
        gate in between."""
        self._revoked = number == self._revocations

    def adopt(self, until: float, token: int, hub: str) -> None:
        """Continue the grant that the daemon has from an earlier run of the bridge: valid until ``until``, with this
        fencing token of this hub. Call it before any other method."""
        self.state, self.valid_until, self._revision, self._hub = State.LATE, until, token, hub
        self._token, self._token_hub, self._usable_at = token, hub, -math.inf

    def remember(self, hub: str) -> None:
        """The hub of an earlier run of the bridge, which is therefore not new. Call it before `hub_up`."""
        self._hub, self._usable_at = hub, -math.inf

    # -- status

    @property
    def holder(self) -> str | None:
        """The site that commands the vehicle, as far as this site knows."""
        if self.state in VALID:
            return self.config.site
        return self._entry.holder if self._known and self._entry is not None else None

    def status(self, now: float) -> dict[str, Any]:
        """Status for federation.leases, JSON-able."""
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

    # -- private: a valid lease

    def _hold(self, now: float) -> Actions:
        out: Actions = []
        config = self.config
        if self.state is State.ALONE:
            out += self._go_on_alone(now)
        elif now >= self.valid_until - ALONE_BEFORE_S:  # no renewal came through
            self.state = State.LATE
            if config.is_home and config.goes_on_alone and not self._contested:
                self.state, self._next_grant = State.ALONE, now
                out.append(LeaseReport(f"{config.vehicle}: the hub is away; {config.site} goes on alone, as its home"))
                out += self._go_on_alone(now)
        if not self._connected or self._pending is not None or now < self._next_write:
            return out
        if not self._known:
            return out + self._look(now)
        return [*out, self._write(now, None if self._entry is None else self._entry.revision)]

    def _go_on_alone(self, now: float) -> Actions:
        self.valid_until = now + VALID_S
        if now < self._next_grant:
            return []
        self._next_grant = now + ALONE_GRANT_S
        return [self._grant(now)]

    def _grant(self, sent_s: float) -> Grant:
        """A grant for the lease that was written at ``sent_s``. A home that goes on alone keeps the last token."""
        if self._revision:
            self._token, self._token_hub = self._revision, self._hub or ""
        return Grant(sent_s, self._token, self._token_hub)

    def _revoke(self, commander: str | None) -> Revoke:
        self._revocations += 1
        return Revoke(self._token, self._token_hub, commander, self._revocations)

    def _written(self, sent_s: float, now: float) -> Actions:
        """The store has accepted our entry, some time after ``sent_s``."""
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
            out.append(LeaseReport(f"{config.vehicle} is commanded by {config.site}"))
        elif self.state is State.ALONE:
            out.append(LeaseReport(f"{config.vehicle}: the hub is back, and the lease is held"))
        self.state, self.valid_until = State.HELD, sent_s + VALID_S
        self._requested_until, self._forced, self._vanished = -math.inf, False, False
        return [self._grant(sent_s), *out]

    def _lose(self, why: str, commander: str | None) -> Actions:
        config = self.config
        self.state, self.valid_until = State.OBSERVED, -math.inf
        self._next_look = -math.inf
        by = "" if commander is None else f" ({commander})"
        return [
            self._revoke(commander),
            LeaseReport(f"{config.vehicle} is not commanded by {config.site} any more: {why}{by}"),
        ]

    def _failed(self, now: float) -> Actions:
        self._pending = None
        self._known = False
        self._next_write = now + RETRY_S
        if self.state is State.HELD:
            self.state = State.LATE
        return []

    # -- private: giving it up

    def _begin_release(self, to: str | None) -> Actions:
        self.state, self._release_to, self._revoked, self._next_write = State.RELEASING, to, False, -math.inf
        return [self._revoke(to)]

    def _let_go(self, now: float) -> Actions:
        """Write the release once the daemon sends nothing any more: it has confirmed that, or its grant has ended."""
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
        return [self._write_release(now, self._revision)]

    # -- private: not ours

    def _seek(self, now: float) -> Actions:
        if not self._known or self._entry_is_old(now):
            return self._look(now)
        if self._pending is not None or now < self._next_write:
            return []
        entry, config = self._entry, self.config
        if entry is not None and entry.holder is not None and not self._is_ours(entry):
            if self.state is State.WANTED and self._is_requested(now) and now >= self._next_ask:
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
            return self.config.is_home or self._is_requested(now)
        if entry is None:
            return self._may_take_free(now)
        reserved = entry.wanted_by is not None and entry.wanted_by != self.config.site
        if self._is_requested(now):
            return not reserved or self._forced
        return self.config.is_home and not reserved and not self._released

    def _may_take_free(self, now: float) -> bool:
        if self._takes_by_itself(now):
            return True
        if not self._is_requested(now):
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
        wait_s = self._note_away(now) + WITHOUT_HUB_AFTER_S - now
        if wait_s > 0:
            return f"another site may hold it for {wait_s:.1f} s more: try again then"
        self.state, self._next_grant, self._released = State.ALONE, now, False
        self.valid_until = now + VALID_S
        self._token, self._revision = self._token + 1, 0  # the last one may have been revoked
        return None

    def _note_away(self, now: float) -> float:
        """Since when the hub is away; ``now`` if it is there."""
        if self._connected:
            return now
        if self._away_since is None:
            self._away_since = now
        return self._away_since

    def _entry_is_old(self, now: float) -> bool:
        """True if the key has to be read again: the store reports neither a renewal nor an expiry."""
        return now >= self._entry_at + (RENEW_S + RETRY_S if self._entry is not None else RENEW_S)

    def _look(self, now: float) -> Actions:
        if now < self._next_look:
            return []
        self._next_look = now + LOOK_S
        return [Look()]

    def _is_requested(self, now: float) -> bool:
        """True while a person's request to take it is pursued."""
        return now < self._requested_until

    def _is_ours(self, entry: Entry) -> bool:
        return entry.holder == self.config.site and entry.run == self.config.run

    def _write(self, now: float, revision: int | None) -> Write:
        return self._next(now, Write(0, self.config.site, self.config.run, None, revision), release=False)

    def _write_release(self, now: float, revision: int | None) -> Write:
        return self._next(now, Write(0, None, self.config.run, self._release_to, revision), release=True)

    def _next(self, now: float, write: Write, *, release: bool) -> Write:
        self._numbers += 1
        self._pending = _Pending(self._numbers, now, release)
        return replace(write, number=self._numbers)


MAX_ENTRY_BYTES = 1024
_UNREADABLE = Entry(0, "?", "")
"""Stands for a value that cannot be read: it is treated as held by another site until it expires."""


def encode_entry(holder: str | None, run: str, since_s: float, wanted_by: str | None) -> bytes:
    """The value of a key, as `decode_entry` reads it. ``since_s``: unix seconds since the holder has it."""
    return to_json({"holder": holder, "run": run, "since_s": round(since_s, 3), "wanted_by": wanted_by})


def decode_entry(value: bytes, revision: int) -> Entry:
    """The entry of a value. Never raises: a value that cannot be read gives the entry of an unknown holder."""
    try:
        found = from_json(value) if len(value) <= MAX_ENTRY_BYTES else None
    except ValueError:
        found = None
    if not isinstance(found, dict):
        return replace(_UNREADABLE, revision=revision)
    holder, run, wanted_by = found.get("holder"), found.get("run"), found.get("wanted_by")
    if not all(text is None or (isinstance(text, str) and len(text) <= 64) for text in (holder, run, wanted_by)):
        return replace(_UNREADABLE, revision=revision)
    holder, run, wanted_by = (None if text is None else printable(text) for text in (holder, run, wanted_by))
    return Entry(revision, holder, run or "", wanted_by)
