"""The fleet's dead-man timer: fires once when no operator and no client was active for a time.

    silent              no activity yet, no control begun            never fires
    watching            `alive` or `begin`                            counts from the later of the two
    watching, silent    for timeout_s                                 fires, once -> fired
    fired               `alive` or `begin`                            -> watching

Without any activity the time counts from `begin`: control that the fleet file starts without an operator needs the
timer most. Off by default, because a fleet that is flown by a program may have no operator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skygcs.errors import ConfigError

DeadManAction = Literal["hold", "land", "rtl"]

ACTIONS: tuple[DeadManAction, ...] = ("hold", "land", "rtl")

SHORTEST_S, LONGEST_S = 2.0, 3600.0
"""Heartbeats come once a second; with a shorter timeout a single lost heartbeat would trigger the action."""


@dataclass(frozen=True, slots=True)
class Fired:
    """The action for every vehicle under control, and its reason."""

    action: DeadManAction
    silent_s: float
    timeout_s: float
    last: str | None
    """The last active source; None: none since control began."""

    @property
    def reason(self) -> str:
        """The reason in one sentence, for the operator."""
        who = f"no operator or client (last: {self.last})" if self.last else "no operator or client, ever,"
        return f"{who} for {self.silent_s:.1f} s (limit {self.timeout_s:g} s)"


class DeadMan:
    """One per fleet. ``timeout_s`` None: off. Raises ConfigError.

    Call `alive` for every activity (a ground station's heartbeat, a client's request), `begin` when control of a
    vehicle begins, and `check` about once a second.
    """

    __slots__ = ("_fired", "_last", "_since", "action", "timeout_s")

    def __init__(self, timeout_s: float | None = None, action: DeadManAction = "hold") -> None:
        problems = []
        if timeout_s is not None and not SHORTEST_S <= timeout_s <= LONGEST_S:
            problems.append(f"timeout_s: {timeout_s} is not in {SHORTEST_S:g}..{LONGEST_S:g}")
        if action not in ACTIONS:
            problems.append(f"action: {action!r} is none of {', '.join(ACTIONS)}")
        if problems:
            raise ConfigError("dead-man", problems)
        self.timeout_s = timeout_s
        self.action = action
        self._since: float | None = None
        self._last: str | None = None
        self._fired = False

    def alive(self, source: str, now: float) -> None:
        """Note activity of ``source``, which the reason names if it was the last."""
        self._last = source
        self._watch(now)

    def begin(self, now: float) -> None:
        """Control of a vehicle began, by an order or by the fleet file: restart the timer."""
        self._watch(now)

    def slept(self, seconds: float) -> None:
        """The clock stood still for so long, in which nobody was active."""
        if self._since is not None:
            self._since -= seconds

    def check(self, now: float) -> Fired | None:
        """The action, at the first call after the silence has become too long; else None."""
        if self.timeout_s is None or self._since is None or self._fired:
            return None
        silent_s = now - self._since
        if silent_s < self.timeout_s:
            return None
        self._fired = True
        return Fired(self.action, silent_s, self.timeout_s, self._last)

    def _watch(self, now: float) -> None:
        self._since = now
        self._fired = False
