"""The companion's book of the orders that the ground relays: each is carried out once, in order, and in time. Pure.

    the order that came                              what is done                what is answered
    ----------------------------------------------   -------------------------   --------------------------------------
    to another session of the companion              nothing                     refused: it has restarted since
    of a ground that does not have the companion     nothing                     refused: contact first
    known, still being carried out                   its outcome is awaited      that outcome, once it is there
    known, ended                                     nothing                     its outcome, again
    new, after its deadline                          nothing                     refused: it came too late
    new, moves the vehicle, a newer such order came  nothing                     refused: a newer order came before it
    new                                              it is carried out           its outcome
    setpoint, a newer one or a newer order that      nothing                     accepted: it was replaced
    moves the vehicle came
    setpoint, new                                    it is followed              its outcome

The ground may therefore repeat an order as often as it likes, with the same number: a repeat of an engagement whose
answer was lost cannot begin control anew after a release that came meanwhile.

    ground     contact of                next
    --------   -----------------------   -----------------------------------------------------------------
    none       any                       that one has the companion
    A          A                         A; the silence begins anew
    A          B, A silent for long      B has it: numbers begin anew, orders of A are refused from now on
    A          B, A heard lately         refused: A has it
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

from skygcs.core.protocols.command import Outcome

MAX_KEPT = 256
"""Orders whose outcomes are kept: more than a ground gives within the longest time in which it asks again (30 s)."""

MAX_NUMBER = 1 << 53
"""Numbers are JSON's."""


@dataclass(frozen=True, slots=True)
class Fresh:
    """The order has to be carried out; call `OrderBook.ended` with its outcome."""


@dataclass(frozen=True, slots=True)
class Known:
    """It came before. ``outcome`` is None while it is being carried out."""

    outcome: Outcome | None


@dataclass(frozen=True, slots=True)
class Refused:
    """The order must not be carried out."""

    why: str


Admission = Fresh | Known | Refused

REPLACED = Outcome(True, "accepted", "a newer setpoint or order came before it")
"""The newest of a stream wins: one that was overtaken on the way is no failure."""


class OrderBook:
    """Orders to one vehicle. ``session`` names this run of the companion's daemon."""

    def __init__(self, session: str, release_ground_s: float) -> None:
        """``release_ground_s``: another ground may have the companion after so long a silence of the present one."""
        self.session = session
        self.ground: str | None = None
        """The run of the ground's daemon that has the companion."""
        self.newest_moving = 0
        """The highest number of an admitted order that moves the vehicle."""
        self.newest_setpoint = 0
        """The highest number of a setpoint of a stream that came."""
        self.contact_at = -math.inf
        self._release_ground_s = release_ground_s
        self._outcomes: OrderedDict[int, Outcome | None] = OrderedDict()
        self._forgotten = 0
        """The highest number whose outcome is not kept any more."""

    def contact(self, ground: str, now: float) -> str | None:
        """Note that a ground is there; why it does not have the companion, None if it has."""
        if ground != self.ground:
            silent_s = now - self.contact_at
            if self.ground is not None and silent_s < self._release_ground_s:
                return (
                    f"another ground has this companion, heard {silent_s:.1f} s ago; it is free after "
                    f"{self._release_ground_s:g} s without it"
                )
            self.ground = ground
            self.newest_moving = self.newest_setpoint = self._forgotten = 0
            self._outcomes.clear()
        self.contact_at = now
        return None

    def admit(self, ground: str, session: str, number: int, *, moves: bool, until_s: float, now: float) -> Admission:
        """Decide about an order. ``until_s``: its deadline on the companion's clock, on which ``now`` is, too."""
        if (stranger := self._stranger(ground, session)) is not None:
            return stranger
        if number in self._outcomes:
            return Known(self._outcomes[number])
        if number <= self._forgotten:
            return Refused("it is older than what the companion remembers")
        if not now <= until_s:  # also for NaN
            return Refused(f"it came {now - until_s:.1f} s too late")
        if moves and number < self.newest_moving:
            return Refused("a newer order came before it")
        if moves:
            self.newest_moving = max(number, self.newest_moving)
        self._outcomes[number] = None
        while len(self._outcomes) > MAX_KEPT:
            oldest, _ = self._outcomes.popitem(last=False)
            self._forgotten = max(self._forgotten, oldest)
        return Fresh()

    def admit_setpoint(self, ground: str, session: str, number: int) -> Outcome | None:
        """None: this setpoint of a stream is to be followed, as it was given after all setpoints and all orders that
        move the vehicle so far. Else what is answered."""
        if (stranger := self._stranger(ground, session)) is not None:
            return Outcome.refused(stranger.why)
        if number <= max(self.newest_setpoint, self.newest_moving):
            return REPLACED
        self.newest_setpoint = number
        return None

    def _stranger(self, ground: str, session: str) -> Refused | None:
        if session != self.session:
            return Refused("the companion's skygcs has restarted since this was given")
        return None if ground == self.ground else Refused("another ground has this companion, or none yet")

    def ended(self, ground: str, number: int, outcome: Outcome) -> None:
        """An order that was `Fresh` has this outcome."""
        if ground == self.ground and number in self._outcomes:
            self._outcomes[number] = outcome
