"""The daemon's alarms: fed by its events and the batteries, kept in a file, shared by all clients."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import make_log_folder, read_state, write_whole
from skygcs.config.models import AlarmsConfig
from skygcs.core.alarms import OF_THE_PROCESS, RULES, Alarm, Alarms, Signal, VehicleFacts, battery, signals
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.disk_writer import DiskWriter
from skygcs.events import Event
from skygcs.runtime.event_log import EventLog

FILE = "alarms.json"

KIND = "alarm"
"""The kind of the events by which clients learn that the list has changed."""

MAX_BYTES = 1_000_000
"""500 alarms of 1 kB, and some room."""

MAX_BY_CHARS = 80
"""Longest name of the person or program that acknowledges."""


class AlarmBook:
    """`tick` once a second; `close` at the end. The file is written beside the loop (`DiskWriter`); while the disk is
    stuck, only the newest content waits for it."""

    def __init__(
        self,
        config: AlarmsConfig,
        events: EventLog,
        vehicles: Callable[[], Iterable[Vehicle]],
        folder: Path,
        disk: DiskWriter,
    ) -> None:
        self._limits = (config.battery_low_percent, config.battery_critical_percent)
        self._events = events
        self._vehicles = vehicles
        self._path = folder / FILE
        self._disk = disk
        self._alarms = Alarms()
        self._writing = self._changed = self._failed = False
        events.facts = lambda name: _facts(self._vehicle(name))
        for kind in RULES:
            events.on(kind, self._on_event)

    def recall(self) -> None:
        """Take over the alarms of the daemon before. A file that cannot be read is reported, and is none."""
        try:
            read_state(self._path, MAX_BYTES, self._alarms.restore)
        except FileNotFoundError:
            return
        except (OSError, ValueError) as error:
            self._report(f"{self._path} cannot be read: {error}; alarms of before the restart are not known")
        for kind in OF_THE_PROCESS:
            self._take(Signal(kind, None, False), logged=False)

    def all(self) -> list[dict[str, Any]]:
        """List all alarms for alarms.list."""
        return [alarm.as_dict() for alarm in self._alarms.all()]

    def acknowledge(self, numbers: Collection[int] | None, by: str) -> list[dict[str, Any]]:
        """Acknowledge open alarms, by number or (None) all; returns those that were open."""
        done = self._alarms.acknowledge(numbers, by[:MAX_BY_CHARS], time.time())
        for alarm in done:
            self._publish(alarm, "acknowledged", f"{alarm.text}; acknowledged by {alarm.acknowledged_by}")
        return [alarm.as_dict() for alarm in done]

    def tick(self) -> None:
        """Look at the batteries, and write what has changed."""
        for vehicle in self._vehicles():
            state = None if vehicle.replayed or not vehicle.connected else vehicle.telemetry("battery")
            percent = None if state is None else state["percent"]
            if percent is not None:
                signal = battery(vehicle.name, percent, self._limits, VehicleFacts(vehicle.armed))
                if signal is not None:
                    self._take(signal, logged=False)
        self._write()

    def close(self) -> None:
        """Write what has changed once more."""
        self._write()

    # -- private

    def _on_event(self, event: Event) -> None:
        vehicle = self._vehicle(event.vehicle)
        if vehicle is not None and vehicle.replayed:
            return
        for signal in signals(event, _facts(vehicle)):
            self._take(signal, logged=True)

    def _vehicle(self, name: str | None) -> Vehicle | None:
        return None if name is None else next((v for v in self._vehicles() if v.name == name), None)

    def _take(self, signal: Signal, *, logged: bool) -> None:
        """Take in a signal, and publish the alarm that it raises. ``logged``: the event of the signal is in the log."""
        before = self._alarms.changes
        alarm = self._alarms.take(signal, time.time())
        if alarm is not None:
            self._publish(alarm, "raised", alarm.text, logged=logged)
        elif self._alarms.changes != before:
            self._changed = True
            if not signal.raised:
                self._events.publish(Event(KIND, signal.vehicle, None, f"{signal.kind} is over", {"change": "over"}))

    def _publish(self, alarm: Alarm, change: str, text: str, *, logged: bool = True) -> None:
        self._changed = True
        data = {"change": change, "logged": logged, **alarm.as_dict()}
        self._events.publish(Event(KIND, alarm.vehicle, None, f"{alarm.severity} {alarm.number}: {text}", data))

    def _write(self) -> None:
        if not self._changed or self._writing:
            return
        content = json.dumps(self._alarms.saved()).encode()
        written = self._disk.offer("the list of alarms", partial(_write, self._path, content), len(content))
        if written is not None:  # else it is stuck, and the next tick tries again
            self._changed, self._writing = False, True
            written.add_done_callback(self._written)

    def _written(self, written: asyncio.Future[None]) -> None:
        self._writing = False
        error = None if written.cancelled() else written.exception()
        if error is not None:
            self._changed = True  # the next tick tries again
        if error is not None and not self._failed:
            self._report(f"{self._path} cannot be written: {error}; a restart will not know what was acknowledged")
        elif error is None and self._failed:
            self._report(f"{self._path} is written again")
        self._failed = error is not None

    def _report(self, text: str) -> None:
        self._events.publish(Event("warning", None, None, text, {"file": str(self._path)}))


def _facts(vehicle: Vehicle | None) -> VehicleFacts:
    return VehicleFacts(None if vehicle is None else vehicle.armed)


def _write(path: Path, content: bytes) -> None:
    make_log_folder(path.parent)
    write_whole(path, content, 0o600, durable=False)
