"""The fleet's dead-man: when no operator and no client has shown life for so long, something is done about it, once.

    silent              nobody ever alive, no control begun          never fires
    watching            `alive` or `begin`, whichever came last       counts from there
    watching, silent    for timeout_s                                 fires, once -> fired
    fired               `alive` or `begin`                            -> watching

Silence without anybody ever counts from `begin`: control that the fleet file switches on without an operator is the
case a dead-man is made for, and who configures one says by it that somebody is to be there. Off by default, because a
fleet that flies by its own program may well have no operator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skygcs.errors import ConfigError

DeadManAction = Literal["hold", "land", "rtl"]

ACTIONS: tuple[DeadManAction, ...] = ("hold", "land", "rtl")

SHORTEST_S, LONGEST_S = 2.0, 3600.0
"""Heartbeats come once a second; of a shorter timeout a single lost one would be somebody's death."""


@dataclass(frozen=True, slots=True)
class Fired:
    """What is to be done now with every vehicle under control, and why."""

    action: DeadManAction
    silent_s: float
    timeout_s: float
    last: str | None
    """Who showed life last; None: nobody since control began."""

    @property
    def reason(self) -> str:
        """One sentence for an operator who comes back."""
        who = f"no operator or client (last: {self.last})" if self.last else "no operator or client, ever,"
        return f"{who} for {self.silent_s:.1f} s (limit {self.timeout_s:g} s)"


class DeadMan:
    """One for the fleet. ``timeout_s`` None: off. Raises ConfigError.

    Feed `alive` with every sign of life (a ground station's heartbeat, a client's request) and `begin` when control of
    a vehicle begins; ask `check` now and then, once a second will do.
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
        """Somebody showed life; ``source`` is told to the operator if it was the last time."""
        self._last = source
        self._watch(now)

    def begin(self, now: float) -> None:
        """Control of a vehicle began: whoever ordered it, or the fleet file, starts the count anew."""
        self._watch(now)

    def check(self, now: float) -> Fired | None:
        """What is to be done, the first time somebody asks after the silence has become too long."""
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
