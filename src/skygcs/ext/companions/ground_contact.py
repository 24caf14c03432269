"""The loss of the ground at a companion that flies its vehicle. Pure.

    state       what happens                                              next        what is ordered
    ---------   -------------------------------------------------------   ---------   ------------------------------
    idle        control begins                                            watched     -
    watched     contact                                                   watched     -
    watched     silence > ground_lost_s; "return", "hold", "land"         acted       that
    watched     silence > ground_lost_s; "finish", a trajectory runs      finishing   - (it is flown on)
    watched     silence > ground_lost_s; "finish", none runs              acted       return
    finishing   contact                                                   watched     -
    finishing   the trajectory has ended or is paused: it stays there     waiting     -
    waiting     contact                                                   watched     -
    waiting     for ground_lost_s                                         acted       return
    acted       contact, and control goes on: the order was denied        watched     -
    any         control has ended: an order, a pilot, the guard           idle        -
    any         it ticks again after a standstill, for LISTEN_S; after    the same    -
                MOST_STANDSTILLS without contact they count as silence

Contact is a call of the ground, or a heartbeat of it that is proven to be its own. An order of this table is given
once in each loss: a pilot who takes the vehicle out of it is not answered by another one. Without control nothing is
ever ordered: the vehicle is its pilot's or its autopilot's then, and their failsafes act. After a standstill of this
process, which heard nothing, the ground's word of that time waits to be read: it is not the ground that was silent.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Literal

GROUND_LINK = "ground"
"""Name of the link to the ground, which the companion opens itself."""

LATE_S = 0.5
"""Between two ticks; more is a standstill, or a loop that was busy for so long."""

LISTEN_S = 1.0
"""Two of the ground's signs of life, and time to read what waits."""

MOST_STANDSTILLS = 3
"""Without contact in between; a loop that is late at every tick would otherwise never lose the ground."""

GroundLost = Literal["return", "hold", "land", "finish"]
"""The configured reaction."""

Action = Literal["return", "hold", "land"]
"""The reaction that is ordered."""


class ContactState(StrEnum):
    IDLE = "idle"
    WATCHED = "watched"
    FINISHING = "finishing"
    WAITING = "waiting"
    ACTED = "acted"


class GroundContact:
    """The contact of one vehicle. Call `tick` a few times a second; it returns what is to be ordered, or None."""

    __slots__ = ("_contact_at", "_listens_until", "_since", "_standstills", "_ticked_at", "action", "lost_s", "state")

    def __init__(self, action: GroundLost, lost_s: float) -> None:
        """``lost_s``: the ground is lost after a silence of so long."""
        self.action = action
        self.lost_s = lost_s
        self.state = ContactState.IDLE
        self._since = 0.0
        """When control began, or when the end of the trajectory was reached."""
        self._ticked_at = math.inf
        self._listens_until = -math.inf
        self._contact_at = -math.inf
        self._standstills = 0
        """Since the last contact."""

    @property
    def lost(self) -> bool:
        """True if the ground is lost."""
        return self.state in (ContactState.FINISHING, ContactState.WAITING, ContactState.ACTED)

    def tick(self, now: float, *, controlled: bool, follows: bool, contact_at: float) -> Action | None:
        """``controlled``: it is flown by setpoints of this companion; ``follows``: on a trajectory that comes to its
        end by itself; ``contact_at``: the last contact with the ground."""
        # a standstill
        if contact_at > self._contact_at:
            self._contact_at, self._standstills = contact_at, 0
        if now - self._ticked_at > LATE_S and self._standstills < MOST_STANDSTILLS:
            self._listens_until = now + LISTEN_S
            self._standstills += 1
        self._ticked_at = now
        # the contact
        if not controlled:
            self.state = ContactState.IDLE
            return None
        if now < self._listens_until:
            return None
        if self.state is ContactState.IDLE:
            self.state, self._since = ContactState.WATCHED, now
        heard = now - max(contact_at, self._since if self.state is ContactState.WATCHED else contact_at) < self.lost_s
        match self.state:
            case ContactState.WATCHED if not heard:
                return self._lose(follows=follows)
            case ContactState.FINISHING | ContactState.WAITING | ContactState.ACTED if heard:
                self.state, self._since = ContactState.WATCHED, now
            case ContactState.FINISHING if not follows:
                self.state, self._since = ContactState.WAITING, now
            case ContactState.WAITING if now - self._since >= self.lost_s:
                self.state = ContactState.ACTED
                return "return"
        return None

    def silence_s(self, now: float, contact_at: float) -> float:
        """How long the ground has been silent, but not longer than control has lasted."""
        return now - max(contact_at, self._since) if self.state is ContactState.WATCHED else now - contact_at

    def _lose(self, *, follows: bool) -> Action | None:
        if self.action == "finish" and follows:
            self.state = ContactState.FINISHING
            return None
        self.state = ContactState.ACTED
        return "return" if self.action == "finish" else self.action
