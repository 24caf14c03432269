"""Ends the work on vehicles that a gate has closed, and asks those that it has opened for their streams again."""

from __future__ import annotations

from collections.abc import Callable

from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub


class SendGateWatch:
    """`tick` a few times a second, and after a change that is to show at once. Each change is an event."""

    def __init__(self, hub: Hub, fleet: Fleet, names: dict[int, str], on_event: Callable[[Event], None]) -> None:
        """``names``: of the fleet file's vehicles, by system id."""
        self._hub = hub
        self._fleet = fleet
        self._names = names
        self._on_event = on_event

    def tick(self) -> None:
        """Compare the gates with the last look."""
        gates = self._hub.send_gates
        if gates is None:
            return
        for sysid, refusal in gates.changes(self._hub.boot_clock()):
            if refusal is None:
                self._fleet.authority_gained(sysid)
            else:
                self._fleet.authority_lost(sysid, refusal)
            name = self._names.get(sysid)
            text = refusal or f"{name or f'system {sysid}'} may be commanded from here"
            self._on_event(Event("authority", name, sysid, text, {"held": refusal is None}))
