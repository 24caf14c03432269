"""Which bridge acts under a site's name when two run, as after a fleet file was copied. Pure.

Every bridge of a site publishes claims on bridge.<site>, which that site alone may send and read.

    state     it                                 goes on to
    -------   --------------------------------   --------------------------------------------------------------------
    asking    claims each ASK_EVERY_S            active: ASKS claims were sent over one connection and nobody objected
                                                 standby: an active one is heard, or one that asks with a smaller run
    active    acts as the site, claims each      standby: an active one is heard that has been so for longer
              CLAIM_EVERY_S
    standby   does nothing in the site's name,   asking: no active one was heard for TAKE_OVER_S while the hub was there
              claims each CLAIM_EVERY_S

Two are active after a network was cut between them. They compare the same two pairs of numbers, the wall time since
when each is active and its run, so exactly one goes on. A wall clock that is wrong changes which of them.

One that is active stays so without the hub: nobody hears it there. A bridge that was killed is back within ASKS *
ASK_EVERY_S, long before another one takes over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from pydantic_core import from_json, to_json

from skygcs.ext.federation.protocol.received_json import MAX_INTEGER, printable
from skygcs.spelling import is_number

ASKS = 3
ASK_EVERY_S = 0.2
"""An active bridge answers at once; three claims cover one that stands still for as long."""

CLAIM_EVERY_S = 1.0
TAKE_OVER_S = 10.0
"""More than a bridge needs to be started again, and than a connection that is silent is kept."""

SHOWN_S = 5.0
"""Another bridge is shown for so long after its last claim."""

MAX_CLAIM_BYTES = 1024
MAX_TEXT_CHARS = 64


class BridgeState(StrEnum):
    ASKING = "asking"
    ACTIVE = "active"
    STANDBY = "standby"


@dataclass(frozen=True, slots=True)
class BridgeClaim:
    """A bridge's claim about itself. ``active_since_unix_s``: inf unless it is active. ``host``, ``pid``: for
    people."""

    run: str
    state: BridgeState
    active_since_unix_s: float
    host: str
    pid: int

    def encoded(self) -> bytes:
        since = self.active_since_unix_s if self.state is BridgeState.ACTIVE else None
        return to_json(
            {"v": 1, "run": self.run, "state": self.state, "since": since, "host": self.host, "pid": self.pid}
        )


def decode_claim(data: bytes) -> BridgeClaim:
    """Raises ValueError."""
    if len(data) > MAX_CLAIM_BYTES:
        raise ValueError("too long")
    found = from_json(data, allow_inf_nan=False)
    if not isinstance(found, dict):
        raise ValueError("no claim")
    run, host, pid, since = found.get("run"), found.get("host"), found.get("pid"), found.get("since")
    state = BridgeState(str(found.get("state")))
    if not isinstance(run, str) or not isinstance(host, str) or max(len(run), len(host)) > MAX_TEXT_CHARS or not run:
        raise ValueError("run and host are short texts")
    if isinstance(pid, bool) or not isinstance(pid, int) or abs(pid) > MAX_INTEGER:
        raise ValueError("pid is an integer")
    if since is not None and not is_number(since):
        raise ValueError("since is a number")
    if (state is BridgeState.ACTIVE) != (since is not None):
        raise ValueError("an active bridge has since, and no other")
    since_unix_s = math.inf if since is None else float(since)
    return BridgeClaim(printable(run), state, since_unix_s, printable(host), pid)


class BridgeElection:
    """`heard` for each claim that comes, `tick` when `next_tick_s` is over and after each change of the connection.
    Times are seconds of one clock that goes on while the computer sleeps."""

    def __init__(self, run: str, host: str, pid: int) -> None:
        self.state = BridgeState.ASKING
        self.stood_by = False
        """Another bridge has acted as this site since this one began."""
        self._run, self._host, self._pid = run, host[:MAX_TEXT_CHARS], pid
        self._active_since_unix_s = math.inf
        self._asks = 0
        self._active_heard_s = -math.inf
        self._other: BridgeClaim | None = None
        self._other_s = -math.inf

    @property
    def claim(self) -> BridgeClaim:
        """Return what is to be published now."""
        return BridgeClaim(self._run, self.state, self._active_since_unix_s, self._host, self._pid)

    @property
    def next_tick_s(self) -> float:
        """How long to wait for the next `tick`."""
        return ASK_EVERY_S if self.state is BridgeState.ASKING else CLAIM_EVERY_S

    def other(self, now_s: float) -> BridgeClaim | None:
        """Another bridge of this site that was heard lately; an active one rather than others."""
        return self._other if now_s - self._other_s < SHOWN_S else None

    def tick(self, now_s: float, now_unix_s: float, *, connected: bool) -> bool:
        """The time has come. True: publish the claim."""
        if not connected:  # nobody can be heard: no silence counts
            self._asks = 0
            self._active_heard_s = now_s
            return False
        if self.state is BridgeState.STANDBY and now_s - self._active_heard_s > TAKE_OVER_S:
            self.state, self._asks = BridgeState.ASKING, 0
        if self.state is BridgeState.ASKING:
            if self._asks >= ASKS:
                self.state, self._active_since_unix_s = BridgeState.ACTIVE, now_unix_s
            self._asks += 1
        return True

    def heard(self, claim: BridgeClaim, now_s: float) -> bool:
        """A claim has come, perhaps the own one. True: publish the own claim at once, the other one needs it."""
        if claim.run == self._run:
            return False
        other = self.other(now_s)
        if claim.state is BridgeState.ACTIVE or other is None or other.state is not BridgeState.ACTIVE:
            self._other, self._other_s = claim, now_s
        if claim.state is BridgeState.ACTIVE:
            return self._heard_active(claim, now_s)
        if claim.state is BridgeState.ASKING and self.state is BridgeState.ASKING:
            if claim.run < self._run:
                return self._stand_by(now_s)
            return True
        return claim.state is BridgeState.ASKING and self.state is BridgeState.ACTIVE

    def _heard_active(self, claim: BridgeClaim, now_s: float) -> bool:
        ours = (self._active_since_unix_s, self._run)
        if self.state is BridgeState.ACTIVE and ours < (claim.active_since_unix_s, claim.run):
            return True
        return self._stand_by(now_s)

    def _stand_by(self, now_s: float) -> bool:
        """True if it did not before."""
        changed = self.state is not BridgeState.STANDBY
        self.state, self.stood_by = BridgeState.STANDBY, True
        self._active_since_unix_s = math.inf
        self._active_heard_s = now_s
        return changed
