"""The place that every message of ours passes before it becomes bytes: asks the gate (`core.vehicle.gate`) at the hub.

What an order, a stream or a transfer sends carries the clearance that the gate gave it. A message without one, or one
that its clearance does not cover, is judged as a raw message to the vehicles that it would reach, and nobody insists
on it here: a part of skygcs, or an extension, that asks for no clearance can send what is harmless and no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from skygcs.core.vehicle.gate import HARMLESS_MESSAGES, Clearance, message_rule
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.events import Event

MAX_REPORTED = 64
"""Kinds of message that are reported once each; all are counted."""


class OutgoingGate:
    """The gate of one hub. ``blocked`` counts the messages that it has kept back."""

    def __init__(self, now: Callable[[], float], on_event: Callable[[Event], None]) -> None:
        self.blocked = 0
        self._now = now
        self._on_event = on_event
        self._reported: set[str] = set()

    def passes(
        self,
        name: str,
        fields: Mapping[str, Any],
        clearance: Clearance | None,
        reached: Callable[[], Iterable[Vehicle]],
    ) -> bool:
        """True if a message of ours may be sent. ``reached``: the vehicles that will accept it. One that may not is
        counted, and reported once per kind."""
        if clearance is not None and clearance.covers(name, fields):
            return True
        if name in HARMLESS_MESSAGES:
            return True
        now = self._now()
        rule = message_rule(name, fields)
        why = rule.refusal((model_of(vehicle, now) for vehicle in reached()), force=False)
        if why is None:
            return True
        self.blocked += 1
        if rule.what not in self._reported and len(self._reported) < MAX_REPORTED:
            self._reported.add(rule.what)
            self._on_event(
                Event("fault", None, None, f"the outgoing gate kept a message back: {why}", {"what": rule.what})
            )
        return False
