"""A vehicle in the air that follows setpoints and that nobody flies: it is ordered to hold. Pure.

The invariant: a vehicle that is armed, in the air, in a mode that follows setpoints, heard, and that nobody is known to
fly is ordered to hold within 1 s, whatever led there.

    its mode follows setpoints, and                                  it is flown by           effect
    --------------------------------------------------------------   ----------------------   --------------------------
    our setpoints go to it                                           us                       none
    an order of ours is on its way                                   us, until it has ended   none; denied or lost it
                                                                                              changes nothing, and
                                                                                              `GRACE_S` is over then
    it carries out an order of ours (goto, takeoff, hold)            its autopilot            none
    our companion on it is in contact and flies it                   the companion            none
    another site may command it                                      that site                none
    a station's setpoints or gotos to it pass us                     that station             none
    its mode was changed by another station or a pilot               whoever changed it       none
    it was in this mode when it was heard first, and no journal      whoever put it there     none
    says that we flew it
    one of these flew it, and does no more                           nobody                   hold after `GRACE_S`,
                                                                                              again every `REPEAT_S`
    it is silent                                                     not known                none; its failsafe acts
    it shows another mode, is disarmed or on the ground              its autopilot, a pilot   none; forgotten after
                                                                                              `LEFT_S`

Which targets need it (ArduCopter 4.6, mode_guided.cpp): attitude targets, which end level after GUID_TIMEOUT and drift
with the wind. A position target is held, a velocity ends in one after GUID_TIMEOUT. A PX4 leaves OFFBOARD by itself,
after COM_OF_LOSS_T, into the mode of COM_OBL_RC_ACT, by default one that needs sticks. A hold changes nothing for the
better of them, so the watch does not ask which target it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from skygcs.core.vehicle.vehicle import Vehicle

OURS = "this station's setpoints"
"""Names us among those who fly a vehicle."""

GRACE_S = 0.3
"""Between the end of one who flies it and the next one's begin; the watch looks every 0.2 s, and an order takes a round
trip. A second is promised."""

REPEAT_S = 3.0
"""Between two orders to hold: one takes as long to be verified by a heartbeat (`order_plan.VERIFY_S`)."""

STREAM_S = 1.0
"""A stream of another station with a longer gap has ended: PX4 leaves OFFBOARD after as long."""

LEFT_S = 4.0
"""Another mode that is shown for four heartbeats was entered; a shorter one may be a forged or late heartbeat."""

HEARTBEAT_SILENT_S = 2.0
"""Without a heartbeat for so long, of which one may be lost, it is not known which mode it is in."""

FOLLOWING = {
    "px4": frozenset({"OFFBOARD"}),
    "ardupilot": frozenset({"GUIDED", "GUIDED_NOGPS"}),
}
"""Modes that follow setpoints, of multirotors; GUIDED of a plane or rover always has a place to go to."""

HOLDING = frozenset({"AUTO.LOITER", "BRAKE"})
"""Modes in which our order to hold leaves a vehicle, beside GUIDED."""

Target = Literal["place", "motion"]
"""Kind of a setpoint: a place, at which the autopilot holds, or a motion, which somebody has to end."""


@dataclass(frozen=True, slots=True)
class Watched:
    """Facts of one moment. ``flown_by``: who flies it now, by what this daemon does itself; None: nobody. ``ordered``:
    an order of ours is on its way."""

    heard: bool
    flying: bool
    """Armed, and not known to be on the ground."""
    follows: bool
    mode: str
    flown_by: str | None
    ordered: bool = False


@dataclass(frozen=True, slots=True)
class HoldIt:
    """Order it to hold. ``who``: flew it until now; ``again``: it was ordered before."""

    who: str
    again: bool


@dataclass(frozen=True, slots=True)
class HoldsAfterAll:
    """The vehicle carries out an order to hold whose outcome was not known."""

    mode: str


Effect = HoldIt | HoldsAfterAll


class UnattendedWatch:
    """Watch which program flies one vehicle, by what was noted. `tick` a few times a second."""

    def __init__(self, flown_before: str | None = None) -> None:
        """``flown_before``: who flew it until this daemon began, by its journal; None: not known."""
        self._before = flown_before
        """Program or station that flew it last; None: whoever put it into its mode."""
        self._flown_at = -math.inf
        """When somebody was seen last to fly it, of those whose flight is known here."""
        self._carries_out: str | None = None
        """The order that its autopilot carries out by itself."""
        self._stream: tuple[str, float] | None = None
        """The station whose setpoints pass us, and when the newest one did."""
        self._since: float | None = None
        self._left_at: float | None = None
        self._next_at = -math.inf
        self._ordered = 0
        self._unconfirmed = False

    @property
    def owed_to(self) -> str | None:
        """Return which program flew it last, if it does nothing by itself since: what a daemon that begins anew has to
        know. None: it may be left alone."""
        return self._before if self._carries_out is None else None

    def on_order(self, order: str) -> None:
        """Note an accepted order of ours that the autopilot carries out by itself."""
        self._carries_out, self._stream, self._since = f"its autopilot, by our order {order}", None, None

    def on_flown(self, who: str, now: float) -> None:
        """Somebody flies it, for however short a time (between two ticks nobody would see it) and in whatever mode: its
        setpoints come before the mode that follows them."""
        self._before, self._carries_out, self._flown_at = who, None, now

    def on_station(self, station: str, target: Target, now: float) -> None:
        """Note a setpoint or an order of another station to it that was routed."""
        if target == "place":
            self._carries_out, self._stream = f"its autopilot, by an order of {station}", None
        else:
            self._stream = (station, now)
            self.on_flown(station, now)

    def on_hold(self, *, ok: bool, unheard: bool) -> None:
        """The outcome of an order to hold that no person gave. ``unheard``: no answer came."""
        self._unconfirmed = not ok and unheard
        if ok:
            self.on_order("hold")

    def tick(self, facts: Watched, now: float) -> Effect | None:
        """Return what has to be done now; None: nothing."""
        if not facts.heard:
            self._since = None
            return None
        if not (facts.flying and facts.follows):
            return self._other_mode(facts, now)
        # back in the mode that follows setpoints
        if self._left_at is not None:
            if self._is_others(self._left_at, now) and self._carries_out is None:
                self._carries_out = f"whoever changed its mode to {facts.mode}"
            self._left_at = None
        who = self._who(facts, now)
        if who is not None:
            self._since = None
            return None
        # nobody flies it
        if self._before is None:
            return None
        if self._since is None:
            self._since, self._ordered = now, 0
            self._next_at = max(self._next_at, now + GRACE_S)
        if facts.ordered or now < self._next_at:  # what a person has ordered is not crossed; denied, it cost no grace
            return None
        self._next_at = now + REPEAT_S
        self._ordered += 1
        return HoldIt(self._before, self._ordered > 1)

    def _is_others(self, left_at: float, now: float) -> bool:
        """True if another mode that it showed since ``left_at`` was entered, and nobody known flew it in that."""
        return now - max(left_at, self._flown_at) > LEFT_S

    def _who(self, facts: Watched, now: float) -> str | None:
        if facts.flown_by is not None:
            self.on_flown(facts.flown_by, now)
            self._stream = None  # of two, the one that goes on after the other shows it by its next setpoint
            return facts.flown_by
        if self._carries_out is not None:
            return self._carries_out
        if self._stream is None:
            return None
        station, at = self._stream
        if now - at <= STREAM_S:
            self._before = station
            return station
        return None

    def _other_mode(self, facts: Watched, now: float) -> Effect | None:
        """Note a mode in which it does not follow setpoints, or that it does not fly."""
        self._since = None
        if self._left_at is None:
            self._left_at = now
        if facts.flying and facts.flown_by is not None:
            self.on_flown(facts.flown_by, now)
        if self._is_others(self._left_at, now):
            self._before = self._carries_out = self._stream = None
        if self._unconfirmed:
            self._unconfirmed = False
            if facts.flying and facts.mode in HOLDING:
                return HoldsAfterAll(facts.mode)
        return None


def follows_setpoints(vehicle: Vehicle) -> bool:
    """True if its last heartbeat shows a mode in which a multirotor follows setpoints."""
    if not vehicle.abilities.setpoints:
        return False
    return vehicle.mode in FOLLOWING.get(vehicle.family, ())


def watched(vehicle: Vehicle, flown_by: str | None, now: float, *, ordered: bool) -> Watched:
    """The facts of a vehicle now. In doubt an armed one is in the air."""
    silence_s = vehicle.silence_s(now)
    return Watched(
        heard=vehicle.connected and silence_s is not None and silence_s <= HEARTBEAT_SILENT_S,
        flying=vehicle.under_way(now),
        follows=follows_setpoints(vehicle),
        mode=vehicle.mode,
        flown_by=flown_by,
        ordered=ordered,
    )
