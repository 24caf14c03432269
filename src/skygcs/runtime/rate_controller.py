"""One vehicle's part in a radio's plan: asked for by single frames that nobody waits for, verified by what comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.protocols.command import RESULT_NAMES, Ack
from skygcs.core.radio_link.stream_rates import POSITION, RateController, RateRequest
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.command_client import CommandClient

SET_MESSAGE_INTERVAL = 511

ROUND_TRIPS = 20
"""Kept, of the last requests that were acknowledged."""

ANSWER_WITHIN_S = 5.0
"""An acknowledgement that comes later is of another request."""

Send = Callable[[MessageInfo, Mapping[str, Any]], bool]


class PlannedStreams:
    """`plan` whenever the plan changes, `ask` some times a second. ``active`` while a radio's plan is about it."""

    def __init__(self, vehicle: Vehicle, commands: CommandClient, dialect: Dialect, own: tuple[int, int]) -> None:
        self.active = False
        self.position_hz: float | None = None
        """What flight control wants; None: nobody flies it by setpoints, or its autopilot closes the loops."""
        self.keeper = RateController()
        self._vehicle = vehicle
        self._commands = commands
        self._dialect = dialect
        self._own = own
        self._bytes: dict[str, int] = {}
        self._asked_at: float | None = None
        self._round_trips: deque[float] = deque(maxlen=ROUND_TRIPS)

    @property
    def settled(self) -> bool:
        """Whether it is asked for nothing now."""
        return not self.active or self.keeper.settled

    def plan(self, rates_hz: Mapping[str, float] | None, frame_bytes: dict[str, int]) -> None:
        """What it is to send; None: no radio's plan is about it any more."""
        self.active = rates_hz is not None
        self._bytes = frame_bytes
        self.keeper.plan(rates_hz or {})

    def restart(self) -> None:
        """It rebooted, or is back: it knows of no request."""
        self.keeper.restart()

    def leave(self, message: str) -> None:
        """A person took the rate of this message in hand."""
        self.keeper.leave(message)

    def want_position(self, rate_hz: float | None) -> bool:
        """Flight control wants its position that often (None: not any more). Whether the plan sees to it."""
        self.position_hz = rate_hz
        return self.active

    def ask(self, now: float, send: Send) -> bool:
        """Ask for the next thing, if there is one; whether something was sent."""
        if not self.active or not self._vehicle.connected or self._commands.in_flight(SET_MESSAGE_INTERVAL):
            return False
        counts = {slot.name: slot.count for slot in self._vehicle.slots.values()}
        ardupilot = self._vehicle.family == "ardupilot"
        ask = self.keeper.due(counts, now, ardupilot=ardupilot, frame_bytes=self._bytes)
        if ask is None:
            return False
        message = self._message(ask)
        if message is None:
            return False
        if ask.message is not None:
            self._commands.expect_stray_ack(SET_MESSAGE_INTERVAL, now)
            self._asked_at = now
        return send(*message)

    def on_ack(self, ack: Ack, now: float) -> None:
        """A COMMAND_ACK of this vehicle."""
        if not self.active or ack.command != SET_MESSAGE_INTERVAL or not ack.is_for(*self._own):
            return
        asked_at, self._asked_at = self._asked_at, None
        if asked_at is not None and now - asked_at <= ANSWER_WITHIN_S:
            self._round_trips.append(now - asked_at)
        if RESULT_NAMES.get(ack.result) == "unsupported":
            self.keeper.old = True

    def round_trip_s(self) -> float | None:
        """Median of the last requests, their wait for the air included."""
        ordered = sorted(self._round_trips)
        return ordered[len(ordered) // 2] if ordered else None

    def status(self) -> dict[str, dict[str, float]]:
        """By message: planned and measured Hz, of all that is planned or comes."""
        rates = {slot.name: slot.rate_hz for slot in self._vehicle.slots.values()}
        names = sorted(
            {*self.keeper.rates_hz, *(n for n, hz in rates.items() if hz > 0)}, key=lambda n: (n != POSITION, n)
        )
        return {
            name: {"planned_hz": self.keeper.rates_hz.get(name, 0.0), "measured_hz": round(rates.get(name, 0.0), 2)}
            for name in names
        }

    def add_to(self, state: dict[str, Any]) -> None:
        """Beside the measured rate of each message of a vehicle's state the planned one."""
        for name, message in state["messages"].items():
            message["planned_hz"] = self.keeper.rates_hz.get(name, 0.0)

    def _message(self, ask: RateRequest) -> tuple[MessageInfo, dict[str, Any]] | None:
        """None for a message the dialect lacks."""
        target = {"target_system": self._vehicle.sysid, "target_component": self._vehicle.compid}
        if ask.stream is not None:
            info = self._dialect.by_name.get("REQUEST_DATA_STREAM")
            rate = {"req_message_rate": round(ask.rate_hz), "start_stop": int(ask.rate_hz > 0)}
            return None if info is None else (info, {**target, "req_stream_id": ask.stream, **rate})
        info = self._dialect.by_name.get("COMMAND_LONG")
        streamed = self._dialect.by_name.get(ask.message or "")
        if info is None or streamed is None:
            return None
        interval_us = round(1e6 / ask.rate_hz) if ask.rate_hz > 0 else -1
        command = {"command": SET_MESSAGE_INTERVAL, "param1": float(streamed.msgid), "param2": float(interval_us)}
        return info, {**target, **command}
