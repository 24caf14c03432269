"""The gates before bytes are sent: whether a frame may leave for a vehicle that an extension closes.

An extension names the vehicles that it *gates*. Each of them is *closed* while its gate gives a refusal, and while its
gate fails: what cannot be asked sends nothing. The gates decide for each frame on a channel:

    frame                                       while the vehicle is closed
    ----------------------------------------    ------------------------------------------------------------------------
    of vehicles.stop                            sent, always
    its target is the vehicle                   not sent
    its target field is 0 (every system)        not sent on a channel on which the vehicle is heard
    without a target field (heartbeat, RTCM)    not sent on a channel on which only closed vehicles are heard; sent on
                                                other channels, because the frame is for their other vehicles as well
    its target is another system                sent

The vehicles heard on a channel are kept until the channel is closed: a silent vehicle may still receive. The gates have
no timer. Each question asks anew, with the time of now, so a process that was stopped past the end of a permission
sends nothing when it goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple, Protocol

from skygcs.core.mavlink.dialect import MessageInfo

NO_TARGET = -1
"""Result of `target_of` for a message without a target field."""


class SendGate(Protocol):
    """The gate of one extension."""

    @property
    def sysids(self) -> Collection[int]:
        """System ids of the vehicles that it gates. They are read once, before a link is open."""
        ...

    def refusal(self, sysid: int, now: float) -> str | None:
        """Why nothing may be sent to one of its vehicles now; None: it may. It is called for each frame to the vehicle:
        be short. ``now``: a clock that also runs while the machine sleeps, read for this question. If it raises,
        nothing is sent."""
        ...


class GateChange(NamedTuple):
    """A vehicle that was closed or opened. ``refusal``: why it is closed, for people; None: it is open."""

    sysid: int
    refusal: str | None


class SendGates:
    """The gates of one daemon. ``now`` is always the same clock."""

    def __init__(self, gates: Mapping[str, SendGate], on_fault: Callable[[Exception], None]) -> None:
        """``gates``: by the names of their extensions' tables. ``on_fault`` gets the exceptions of a gate."""
        self._on_fault = on_fault
        self._by_sysid: dict[int, list[tuple[str, SendGate]]] = {}
        for table, gate in gates.items():
            for sysid in gate.sysids:
                self._by_sysid.setdefault(sysid, []).append((table, gate))
        self._heard: dict[int, set[int]] = {}
        """By channel, the gated systems heard on it."""
        self._open: set[int] = set()
        """Systems that `changes` has returned as open, and not as closed since."""
        self._blocked: dict[int, int] = {}

    # -- at the moment of sending

    def __bool__(self) -> bool:
        """True if any vehicle is gated."""
        return bool(self._by_sysid)

    def gates(self, sysid: int) -> bool:
        """True if this system is gated, closed or not."""
        return sysid in self._by_sysid

    def refusal(self, sysid: int, now: float) -> str | None:
        """Why an order to this system is refused; None if it is not."""
        for table, gate in self._by_sysid.get(sysid, ()):
            try:
                refusal = gate.refusal(sysid, now)
            except Exception as error:
                self._on_fault(error)
                return f"[{table}] could not be asked whether it may be commanded, and its fault is in the log"
            if refusal is not None:
                return refusal
        return None

    def is_closed(self, sysid: int, now: float) -> bool:
        """True if nothing may be sent to this system."""
        return sysid in self._by_sysid and self.refusal(sysid, now) is not None

    def passes(self, channel_id: int, target: int, others: Collection[int], now: float) -> bool:
        """True if a frame may be sent on a channel; a frame that may not is counted.

        ``target``: its target system, 0 for all, `NO_TARGET` without a target field. ``others``: system ids of the
        autopilots that are heard on the channel.
        """
        if target > 0:
            closed = [target] if self.is_closed(target, now) else []
        else:
            closed = [s for s in self._heard.get(channel_id, ()) if self.is_closed(s, now)]
        if not closed or (target == NO_TARGET and any(s not in closed for s in others)):
            return True
        for sysid in closed:
            self._blocked[sysid] = self._blocked.get(sysid, 0) + 1
        return False

    def blocked(self, sysid: int) -> int:
        """Frames that were not sent to a system."""
        return self._blocked.get(sysid, 0)

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

    # -- for people and for the work on a vehicle

    def tables_of(self, sysid: int) -> list[str]:
        """The tables of the extensions that gate this system."""
        return [table for table, _ in self._by_sysid.get(sysid, ())]

    def changes(self, now: float) -> list[GateChange]:
        """Vehicles that were closed or opened since the last call. All are closed before the first one."""
        changed = []
        for sysid in self._by_sysid:
            refusal = self.refusal(sysid, now)
            if (refusal is None) != (sysid in self._open):
                changed.append(GateChange(sysid, refusal))
                (self._open.add if refusal is None else self._open.discard)(sysid)
        return changed


def target_of(info: MessageInfo | None, payload: bytes) -> int:
    """The target system of a message, for `SendGates.passes`. 0, every system, for a message that the dialect does not
    have."""
    if info is None:
        return 0
    at = info.target_system_offset
    if at < 0:
        return NO_TARGET
    return payload[at] if at < len(payload) else 0
