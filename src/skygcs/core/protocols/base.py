"""Base of the request/reply state machines: time goes in, effects come out, one deadline says when to call again.

The shell owns the machine: it calls `start` once, `on_timer` when ``deadline`` has come, the machine's other methods
when a message arrived, and carries out the effects returned, in order. A machine with an outcome returns no
further effects and has no deadline.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Transmit:
    """Send the request; ``attempt`` is 0 for the first time (COMMAND_LONG's confirmation count)."""

    attempt: int


@dataclass(frozen=True, slots=True)
class Send:
    """Send this message, of a machine that has several kinds of them; the shell fills in its target fields."""

    message: str
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ProgressReport:
    """The vehicle is working on it; ``percent`` is None where it does not say how far."""

    percent: int | None


@dataclass(frozen=True, slots=True)
class Finish:
    """Over: the machine's ``outcome`` is set."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """Data that follows what came before: to be written at ``offset``."""

    offset: int
    data: bytes


Effect = Transmit | Send | ProgressReport | Chunk | Finish


class ProtocolMachine(ABC):
    """One request and its reply."""

    deadline: float | None = None
    """When `on_timer` has to be called; None while not started and after the end."""

    @abstractmethod
    def start(self, now: float) -> tuple[Effect, ...]:
        """Begin. To be called once."""

    @abstractmethod
    def on_timer(self, now: float) -> tuple[Effect, ...]:
        """The deadline has come; harmless when called early."""

    @property
    @abstractmethod
    def done(self) -> bool:
        """True if it is over."""
