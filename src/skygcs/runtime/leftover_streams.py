"""Restores stream rates that disconnected programs had requested, where no radio's stream plan is."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import COMMAND_INT, COMMAND_LONG, REQUEST_DATA_STREAM
from skygcs.core.radio_link.program_streams import Leftover, Program, ProgramStreams, Stream, StreamRequest, restoring
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.token_bucket import TokenBucket
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent

WATCHED = frozenset({REQUEST_DATA_STREAM, COMMAND_INT, COMMAND_LONG})

SETTLE_S = 8.0
"""Time after a request until rates are measured again: they are smoothed over a few seconds."""

ATTEMPTS = 3
"""Attempts, after which the stream is left as it is and reported: the vehicle may not follow requests, or another
program requested the rate over a link that skygcs does not see."""

NOTED_PER_S = 1000
"""Noted requests, one per addressed vehicle: ten for each of a hundred vehicles. More are a flood; a program's later
request is noted again."""

_COMMAND = struct.Struct("<2f20xH")
"""param1, param2 and command of COMMAND_LONG and COMMAND_INT."""

_DATA_STREAM = struct.Struct("<H2xB")
"""req_message_rate and req_stream_id."""


@dataclass(slots=True)
class _Task:
    """The restoring of one stream of one vehicle."""

    leftover: Leftover
    attempts: int = 0
    next_at: float = float("-inf")


class LeftoverStreams:
    """`on_frame` observes the WATCHED messages; call `tick` once a second.

    A program is gone when its channel is closed, or when nothing came from it for ``gone_after_s``, after which routing
    forgets it as well. No request is sent to a vehicle that is controlled by setpoints, that is in a radio's stream
    plan, or that has ``streams = {}``; nor for a stream that a connected program requested.
    """

    def __init__(self, hub: Hub, fleet: Fleet, dialect: Dialect, gone_after_s: float, on_event: OnEvent) -> None:
        self._hub = hub
        self._fleet = fleet
        self._dialect = dialect
        self._gone_after_s = gone_after_s
        self._on_event = on_event
        self._requests = ProgramStreams()
        self._tasks: dict[int, dict[Stream, _Task]] = {}
        self._now = 0.0
        self._noted = TokenBucket(NOTED_PER_S, NOTED_PER_S)

    def on_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        """Note a message of another program that may request streams."""
        stream = self._stream(frame)
        if stream is None or channel.config.type == "replay":
            return
        program = channel.id, frame.sysid << 8 | frame.compid
        system, component = frame.target()
        for key, actor in self._addressed(system, component):
            if not self._noted.take(now):
                self._requests.not_counted += 1
                return
            if not self._is_kept(actor) or (stream.group is not None and actor.vehicle.family != "ardupilot"):
                continue  # PX4 ignores requests for stream groups
            self._requests.on_request(key, program, stream, partial(_rates, actor))
            self._tasks.get(key, {}).pop(stream, None)

    def _addressed(self, system: int, component: int) -> list[tuple[int, VehicleActor]]:
        """The vehicles with these ids; 0 is any."""
        vehicles = self._fleet.vehicles
        if system and component:
            actor = vehicles.get(system << 8 | component)
            return [] if actor is None else [(system << 8 | component, actor)]
        return [
            (key, actor)
            for key, actor in vehicles.items()
            if system in (0, actor.sysid) and component in (0, actor.compid)
        ]

    def on_reboot(self, event: Event) -> None:
        """The vehicle rebooted: it streams as its parameters say."""
        for vehicle in () if event.sysid is None else self._fleet.vehicles_of(event.sysid):
            self._requests.forget(vehicle.key)
            self._tasks.pop(vehicle.key, None)

    def tick(self, now: float) -> None:
        """Find programs that are gone, and request the rates to restore."""
        self._now = now
        for key, leftovers in self._requests.left_behind(self._is_connected).items():
            tasks = self._tasks.setdefault(key, {})
            for leftover in leftovers:
                tasks[leftover.stream] = _Task(leftover)
        for key, tasks in list(self._tasks.items()):
            actor = self._fleet.vehicles.get(key)
            if actor is None or not self._is_kept(actor):
                del self._tasks[key]
            elif actor.vehicle.connected and not actor.offboard.controller.active:
                self._put_back(actor, tasks, now)
                if not tasks:
                    del self._tasks[key]

    # -- the inside

    def _is_kept(self, actor: VehicleActor) -> bool:
        """True if this module restores its streams."""
        return not actor.vehicle.replayed and not actor.streams.planned and bool(actor.config.streams)

    def _is_connected(self, program: Program) -> bool:
        channel_id, key = program
        channel = self._hub.channels.get(channel_id)
        if channel is None:
            return False
        stats = channel.sources.get(key)
        # in a full table a source is not counted by itself: it is taken for connected
        return (
            channel.link.config.type.startswith("tcp")
            or stats is None
            or (self._now - stats.last_at < self._gone_after_s)
        )

    def _put_back(self, actor: VehicleActor, tasks: dict[Stream, _Task], now: float) -> None:
        rates_hz = _rates(actor)
        for stream, task in list(tasks.items()):
            if now < task.next_at:
                continue
            wanted_hz = {n: hz for n, hz in actor.config.streams.items() if hz > 0 and not actor.streams.is_left(n)}
            requests = restoring(task.leftover, rates_hz, wanted_hz)
            requests = [r for r in requests if r.stream.message is None or not actor.streams.is_left(r.stream.message)]
            if not requests or task.attempts >= ATTEMPTS:
                del tasks[stream]
                if requests and stream.group is not None:  # a message's default rate may have changed
                    self._report(actor, stream)
                continue
            task.attempts += 1
            task.next_at = now + SETTLE_S
            for request in requests:
                self._send(actor, request, now)

    def _send(self, actor: VehicleActor, request: StreamRequest, now: float) -> None:
        group, message = request.stream
        if group is not None:
            if "REQUEST_DATA_STREAM" in self._dialect.by_name:
                rate_hz = int(request.rate_hz or 0)
                values = {"req_stream_id": group, "req_message_rate": rate_hz, "start_stop": int(rate_hz > 0)}
                actor.commands.transmit("REQUEST_DATA_STREAM", values, Priority.PROTOCOL)
            return
        info = self._dialect.by_name.get(message or "")
        if info is None or "COMMAND_LONG" not in self._dialect.by_name:
            return
        interval_us = 0.0 if not request.rate_hz else round(1e6 / request.rate_hz)
        command = {"command": mav_cmd.SET_MESSAGE_INTERVAL, "param1": float(info.msgid), "param2": float(interval_us)}
        actor.commands.expect_stray_ack(mav_cmd.SET_MESSAGE_INTERVAL, now)
        actor.commands.transmit("COMMAND_LONG", command, Priority.PROTOCOL)

    def _report(self, actor: VehicleActor, stream: Stream) -> None:
        what = stream.message or f"its stream group {stream.group}"
        text = f"still sends {what} at the rate that a program, now gone, had requested, although asked to stop"
        self._on_event(Event("warning", actor.name, actor.sysid, text, {"stream": what}))

    def _stream(self, frame: Frame) -> Stream | None:
        """The stream that the frame requests; None: none."""
        payload = frame.payload.ljust(32, b"\0")
        if frame.msgid == REQUEST_DATA_STREAM:
            return Stream(_DATA_STREAM.unpack_from(payload)[1], None)
        msgid, _, command = _COMMAND.unpack_from(payload)
        if command != mav_cmd.SET_MESSAGE_INTERVAL or not 0 <= msgid < 1 << 24:  # false for NaN
            return None
        info = self._dialect.messages.get(int(msgid))
        return None if info is None else Stream(None, info.name)


def _rates(actor: VehicleActor) -> Mapping[str, float]:
    return {slot.name: slot.rate_hz for slot in actor.vehicle.slots.values()}
