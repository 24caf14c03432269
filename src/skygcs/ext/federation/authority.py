"""Authority over the vehicles of [federation.vehicles]: which of them this site may command now.

A vehicle is *held* while a grant of this site's lease is in force, by the clock that the caller passes; else nothing is
sent to it (`core.routing.send_gates`). There is no timer. Each question compares the end of the grant with the time, so
a process that was stopped past the end sends nothing when it goes on.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

MAX_VALID_S = 3.0
"""The longest grant: the TTL of a lease. A longer one could outlive its lease."""

CLOCK_ERROR_S = 0.1
"""Tolerance of that limit: the two processes read one clock, but round it differently."""

GrantResult = Literal["granted", "late", "fenced"]
"""late: the grant has ended already; fenced: a newer grant or revocation came before it."""


@dataclass(slots=True)
class _Shared:
    """One vehicle."""

    name: str
    sysid: int
    until: float = -math.inf
    """End of the last grant."""
    hub: str = ""
    token: int = 0
    """Fencing token of the newest grant or revocation from ``hub``; an older one is refused."""
    revoked: bool = False
    commander: str | None = None
    """The site that commands the vehicle, as far as known."""


@dataclass(slots=True)
class Authority:
    """The gate of one daemon. ``now`` is always the same clock, which also runs while the machine sleeps.

    ``site``: this site's name.
    """

    site: str
    vehicles: Mapping[str, int]
    """System ids of the vehicles by name."""
    _by_sysid: dict[int, _Shared] = field(init=False)

    def __post_init__(self) -> None:
        self._by_sysid = {sysid: _Shared(name, sysid) for name, sysid in self.vehicles.items()}

    # -- at the moment of sending

    @property
    def sysids(self) -> Collection[int]:
        """See `SendGate.sysids`."""
        return self._by_sysid.keys()

    def refusal(self, sysid: int, now: float) -> str | None:
        """See `SendGate.refusal`."""
        shared = self._by_sysid[sysid]
        return None if now < shared.until else self._why(shared)

    # -- grants

    def grant(self, name: str, until: float, now: float, *, token: int, hub: str = "") -> GrantResult:
        """Allow frames to a vehicle until ``until``. ``token``: the revision of the lease, which grows; ``hub``:
        identifies the store that counts the revisions, so that another store may begin anew. Raises KeyError for a
        vehicle that is not shared, ValueError for an end that no lease can have."""
        shared = self._named(name)
        if not until - now <= MAX_VALID_S + CLOCK_ERROR_S:
            raise ValueError(
                f"the grant ends in {until - now:.1f} s, a lease in {MAX_VALID_S:g} s at most: "
                "the bridge has to run on the daemon's machine, by one clock"
            )
        if hub == shared.hub and (token < shared.token or (token == shared.token and shared.revoked)):
            return "fenced"
        if until <= now:
            return "late"
        shared.hub, shared.token, shared.revoked = hub, token, False
        shared.until, shared.commander = until, self.site
        return "granted"

    def revoke(self, name: str, *, token: int, hub: str = "", commander: str | None = None) -> None:
        """Allow no frame to a vehicle. Grants with this token or an older one are refused from now on. ``commander``:
        the site that commands the vehicle instead, None if not known. Raises KeyError for a vehicle that is not
        shared."""
        shared = self._named(name)
        shared.token = max(token, shared.token) if hub == shared.hub else token
        shared.hub, shared.revoked = hub, True
        shared.until, shared.commander = -math.inf, commander

    # -- status

    def status_of(self, sysid: int, now: float) -> dict[str, Any] | None:
        """The ``authority`` part of a vehicle's state, but the frames that were not sent; None if it is not shared."""
        shared = self._by_sysid.get(sysid)
        if shared is None:
            return None
        held = now < shared.until
        return {
            "held": held,
            "commander": self.site if held else self._commander(shared),
            "remaining_s": round(shared.until - now, 3) if held else 0.0,
            "token": shared.token,
            "hub": shared.hub,
        }

    def _named(self, name: str) -> _Shared:
        return self._by_sysid[self.vehicles[name]]

    def _commander(self, shared: _Shared) -> str | None:
        """The site that commands the vehicle, None if not known: after the end of our own grant it may be any."""
        return None if shared.commander == self.site else shared.commander

    def _why(self, shared: _Shared) -> str:
        commander = self._commander(shared)
        by = f"is commanded by {commander}" if commander is not None else f"is not commanded by {self.site} now"
        return f"{shared.name} {by}; `skygcs-cli federation take {shared.name}`"
