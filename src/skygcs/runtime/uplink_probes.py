"""Probes of one vehicle's uplink on the wire, and the report when it dies or recovers (`core.vehicle.uplink_watch`)."""

from __future__ import annotations

import math
from typing import Any

from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.uplink_watch import FEWEST, Change, UplinkWatch
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.vehicle_services import VehicleServices

PROBE = "uplink probe"
"""Key of a vehicle's probe in the queue of a slow link."""


class UplinkProbes:
    """Sends probes (TIMESYNC) when ``watch`` wants them, and gives it what answers them."""

    def __init__(
        self, watch: UplinkWatch, vehicle: Vehicle, commands: CommandClient, services: VehicleServices
    ) -> None:
        self._watch = watch
        self._vehicle = vehicle
        self._commands = commands
        self._services = services
        self._enabled = services.probes and "TIMESYNC" in services.dialect.by_name

    def state(self, now: float) -> dict[str, Any] | None:
        """The uplink's part of a vehicle's state (`VehicleState.uplink`); None: nothing is known."""
        watch = self._watch
        if not self._enabled or watch.answered_at is None:
            return None
        return {
            "heard": not watch.lost,
            "unanswered": watch.unanswered,
            "rtt_s": None if watch.trip_s is None else round(watch.trip_s, 3),
            "age_s": round(now - watch.answered_at, 2),
        }

    def tick(self, now: float) -> None:
        """Send a probe if one is due, and report the result of earlier ones."""
        if not self._enabled or not self._vehicle.connected:
            return
        watch = self._watch
        if watch.unanswered >= FEWEST and watch.verdict(now, self._last_frame_at()) is not None:
            self._report("lost")
        armed = self._vehicle.armed
        if not watch.due(now, armed=armed):  # so most ticks do not ask what the links carry
            return
        links, key = self._services.links, (PROBE, self._vehicle.key)
        share = links.setpoint_bytes_per_s(self._vehicle, self._services.flown)
        if not watch.due(now, armed=armed, share_bytes_per_s=share):
            return
        if math.isfinite(share) and links.holds(self._vehicle, Priority.COMMAND, key):
            return  # the last one has not left yet: another one behind it measures nothing
        token = watch.token()
        if self._commands.transmit("TIMESYNC", {"tc1": 0, "ts1": token}, key=key):
            watch.sent(token, now, self._last_frame_at())

    def _last_frame_at(self) -> float:
        return max((slot.at for slot in self._vehicle.slots.values()), default=-math.inf)

    def on_ack(self, now: float) -> None:
        """The vehicle has acknowledged a command of ours: it hears us."""
        if self._watch.answered_at is not None:
            self._report(self._watch.heard(now))

    def is_answer(self, frame: Frame, now: float) -> bool:
        """Take a TIMESYNC; True if it answers a probe."""
        fields = frame.fields()
        if fields["tc1"] == 0:
            return False
        ours, change = self._watch.answered(int(fields["ts1"]), now)
        self._report(change)
        return ours

    def _report(self, change: Change | None) -> None:
        if change is None:
            return
        if change == "lost":
            self._services.links.uplink_lost(self._vehicle.key)
            text = (
                f"it does not hear us: no answer to {self._watch.unanswered} probes, while its telemetry comes; "
                "orders do not reach it, and its failsafe for a lost ground station will act"
            )
        else:
            text = "it hears us again"
        self._services.on_event(Event(f"uplink_{change}", self._vehicle.name, self._vehicle.sysid, text, {}))
