"""The authority gate: whether a frame may leave for a vehicle that several sites could command.

Only vehicles of [federation.vehicles] are gated. A gated vehicle is *held* while a grant of this site's lease is in
force, by the clock that the caller passes; else it is *closed*. The gate decides for each frame on a channel:

    frame                                       while the vehicle is closed
    ----------------------------------------    ------------------------------------------------------------------------
    of vehicles.stop                            sent, always
    its target is the vehicle                   not sent
    its target field is 0 (every system)        not sent on a channel on which the vehicle is heard
    without a target field (heartbeat, RTCM)    not sent on a channel on which only closed vehicles are heard; sent on
                                                other channels, because the frame is for their other vehicles as well
    its target is another system                sent

The vehicles heard on a channel are kept until the channel is closed: a silent vehicle may still receive. The gate has
no timer. Each question compares the end of the grant with the time, so a process that was stopped past the end sends
nothing when it goes on.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from skygcs.core.mavlink.dialect import MessageInfo

MAX_VALID_S = 3.0
"""The longest grant: the TTL of a lease. A longer one could outlive its lease."""

CLOCK_ERROR_S = 0.1
"""Tolerance of that limit: the two processes read one clock, but round it differently."""

MANUAL_CONTROL = "MANUAL_CONTROL"
"""The only message whose target system is in a field named ``target``."""

NO_TARGET = -1
"""Result of `target_of` for a message without a target field."""

GrantResult = Literal["granted", "late", "fenced"]
"""late: the grant has ended already; fenced: a newer grant or revocation came before it."""


@dataclass(slots=True)
class _Gated:
    """One gated vehicle."""

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
    was_held: bool = False
    reported: bool = False
    """True if `gains` has returned it, and `lapses` has not since."""
    blocked: int = 0


@dataclass(frozen=True, slots=True)
class Lapse:
    """A vehicle whose grant has ended since the last call of `AuthorityGate.lapses`. ``text``: why, for people."""

    name: str
    sysid: int
    text: str


@dataclass(slots=True)
class AuthorityGate:
    """The gate of one daemon. ``now`` is always the same clock, which also runs while the machine sleeps.

    ``site``: this site's name.
    """

    site: str
    vehicles: Mapping[str, int]
    """System ids of the gated vehicles by name."""
    _by_sysid: dict[int, _Gated] = field(init=False)
    _heard: dict[int, set[int]] = field(init=False, default_factory=dict)
    """By channel, the gated systems heard on it."""

    def __post_init__(self) -> None:
        self._by_sysid = {sysid: _Gated(name, sysid) for name, sysid in self.vehicles.items()}

    # -- at the moment of sending

    def gates(self, sysid: int) -> bool:
        """True if this system is gated, held or not."""
        return sysid in self._by_sysid

    def is_closed(self, sysid: int, now: float) -> bool:
        """True if nothing may be sent to this system."""
        gated = self._by_sysid.get(sysid)
        return gated is not None and now >= gated.until

    def passes(self, channel_id: int, target: int, others: Collection[int], now: float) -> bool:
        """True if a frame may be sent on a channel; a frame that may not is counted.

        ``target``: its target system, 0 for all, `NO_TARGET` without a target field. ``others``: system ids of the
        autopilots that are heard on the channel.
        """
        if target > 0:
            gated = self._by_sysid.get(target)
            if gated is None or now < gated.until:
                return True
            gated.blocked += 1
            return False
        closed = [s for s in self._heard.get(channel_id, ()) if self.is_closed(s, now)]
        if not closed or (target == NO_TARGET and any(s not in closed for s in others)):
            return True
        for sysid in closed:
            self._by_sysid[sysid].blocked += 1
        return False

    def refusal(self, sysid: int, now: float) -> str | None:
        """Why an order to this system is refused; None if it is not."""
        return self._why(self._by_sysid[sysid]) if self.is_closed(sysid, now) else None

    # -- where gated vehicles are

    def hear(self, channel_id: int, sysid: int) -> bool:
        """Note that a gated system is heard on a channel. True if that is new: the fast paths there must be closed."""
        heard = self._heard.setdefault(channel_id, set())
        if sysid in heard:
            return False
        heard.add(sysid)
        return True

    def leads_to_gated(self, channel_id: int) -> bool:
        """True if a gated system is or was heard on this channel: each frame sent there must be checked."""
        return channel_id in self._heard

    def forget_channel(self, channel_id: int) -> None:
        """The channel is closed."""
        self._heard.pop(channel_id, None)

    # -- grants

    def grant(self, name: str, until: float, now: float, *, token: int, hub: str = "") -> GrantResult:
        """Open the gate of a vehicle until ``until``. ``token``: the revision of the lease, which grows; ``hub``:
        identifies the store that counts the revisions, so that another store may begin anew. Raises KeyError for a
        vehicle that is not gated, ValueError for an end that no lease can have."""
        gated = self._named(name)
        if not until - now <= MAX_VALID_S + CLOCK_ERROR_S:
            raise ValueError(
                f"the grant ends in {until - now:.1f} s, a lease in {MAX_VALID_S:g} s at most: "
                "the bridge has to run on the daemon's machine, by one clock"
            )
        if hub == gated.hub and (token < gated.token or (token == gated.token and gated.revoked)):
            return "fenced"
        if until <= now:
            return "late"
        gated.hub, gated.token, gated.revoked = hub, token, False
        gated.until, gated.commander, gated.was_held = until, self.site, True
        return "granted"

    def revoke(self, name: str, *, token: int, hub: str = "", commander: str | None = None) -> None:
        """Close the gate of a vehicle. Grants with this token or an older one are refused from now on. ``commander``:
        the site that commands the vehicle instead, None if not known. Raises KeyError for a vehicle that is not
        gated."""
        gated = self._named(name)
        gated.token = max(token, gated.token) if hub == gated.hub else token
        gated.hub, gated.revoked = hub, True
        gated.until, gated.commander = -math.inf, commander

    def lapses(self, now: float) -> list[Lapse]:
        """Vehicles that were held at the last call, or granted since, and are closed now."""
        ended = [g for g in self._by_sysid.values() if g.was_held and now >= g.until]
        for gated in ended:
            gated.was_held = gated.reported = False
        return [Lapse(g.name, g.sysid, self._why(g)) for g in ended]

    def gains(self, now: float) -> list[tuple[str, int]]:
        """Name and system id of vehicles that are held now and were not at the last call."""
        begun = [g for g in self._by_sysid.values() if now < g.until and not g.reported]
        for gated in begun:
            gated.reported = True
        return [(g.name, g.sysid) for g in begun]

    # -- status

    def status_of(self, sysid: int, now: float) -> dict[str, Any] | None:
        """The ``authority`` part of a vehicle's state; None if it is not gated."""
        gated = self._by_sysid.get(sysid)
        if gated is None:
            return None
        held = now < gated.until
        return {
            "held": held,
            "commander": self.site if held else self._commander(gated),
            "remaining_s": round(gated.until - now, 3) if held else 0.0,
            "token": gated.token,
            "hub": gated.hub,
            "blocked_frames": gated.blocked,
        }

    def _named(self, name: str) -> _Gated:
        return self._by_sysid[self.vehicles[name]]

    def _commander(self, gated: _Gated) -> str | None:
        """The site that commands the vehicle, None if not known: after the end of our own grant it may be any."""
        return None if gated.commander == self.site else gated.commander

    def _why(self, gated: _Gated) -> str:
        commander = self._commander(gated)
        by = f"is commanded by {commander}" if commander is not None else f"is not commanded by {self.site} now"
        return f"{gated.name} {by}; `skygcs-cli federation take {gated.name}`"


def target_of(info: MessageInfo | None, payload: bytes) -> int:
    """The target system of a message, for `AuthorityGate.passes`. 0, every system, for a message that the dialect does
    not have."""
    if info is None:
        return 0
    at = info.target_system_offset
    if at < 0 and info.name == MANUAL_CONTROL:
        at = next((f.offset for f in info.fields if f.name == "target"), NO_TARGET)
    if at < 0:
        return NO_TARGET
    return payload[at] if at < len(payload) else 0
