"""Programs' traffic on the links: reports, once each, what a radio does not carry of it, in the log, to subscribers and
to its sender; and restores stream rates that disconnected programs had requested, where no radio's stream plan is."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from skygcs.config.models import DaemonConfig
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import COMMAND_INT, COMMAND_LONG, REQUEST_DATA_STREAM
from skygcs.core.radio_link.admission import Note
from skygcs.core.radio_link.admission_frames import MAX_HZ
from skygcs.core.radio_link.capacity import BITS_PER_BYTE, HALF_DUPLEX_SHARE
from skygcs.core.radio_link.program_streams import Leftover, Program, ProgramStreams, Stream, StreamRequest, restoring
from skygcs.core.radio_link.transmit_queue import OwnMessage, Priority
from skygcs.core.token_bucket import TokenBucket
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.links.paced import AirBudget
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


LOG_BYTES = 10e6
"""Size of a short flight's log, for the example in the text."""

TEXT_BYTES = 50
"""Length of a STATUSTEXT without chunks."""

WARNING, INFO = 4, 6
"""MAV_SEVERITY."""


class AdmissionReports:
    """`tick` once a second."""

    def __init__(self, hub: Hub, own: DaemonConfig, dialect: Dialect, on_event: OnEvent) -> None:
        self._hub = hub
        self._own = own
        self._dialect = dialect
        self._on_event = on_event

    def tick(self, now: float) -> None:
        """Report the admission decisions since the last call."""
        for channel in tuple(self._hub.channels.values()):
            air = channel.air
            if air is None:
                continue
            air.third_party.own_sysid = self._own.sysid if self._own.heartbeat else None
            while air.third_party.notes:
                self._report(air.third_party.notes.popleft(), channel, air, now)

    def _report(self, note: Note, channel: Channel, air: AirBudget, now: float) -> None:
        link = channel.link.name
        clients = self._clients(note.source)
        where = f" ({', '.join(c.peer for c in clients)})" if clients else ""
        sender = f"{note.source >> 8}/{note.source & 0xFF}{where}"
        text = f"radio {link}: {sender} {self._sentence(note, link, air, now)}"
        name = self._name(note.msgid)
        data = {
            "link": link,
            "what": note.kind,
            "source": f"{note.source >> 8}/{note.source & 0xFF}",
            "target": note.target,
            "message": name,
        }
        self._on_event(Event("third_party", None, note.target or None, text, data))
        self._answer(clients, note, name)

    def _sentence(self, note: Note, link: str, air: AirBudget, now: float) -> str:
        name, key = self._name(note.msgid), f"links.{link}.third_party"
        target = f"vehicle {note.target}" if note.target else "all vehicles"
        match note.kind:
            case "streams":
                return (
                    f"asks {target} for streams ({name}): not sent, as skygcs plans the streams of this radio; "
                    f'change their streams in the fleet file or by skygcs-cli interval, or set {key}.streams = "allow"'
                )
            case "logs":
                rate = _down_bytes_per_s(air)
                return (
                    f"asks {target} for logs ({name}): not sent; at the {rate:.0f} B/s that one vehicle can send, "
                    f"10 MB take {LOG_BYTES / rate / 3600:.1f} h; fetch it by cable or from the card, or set "
                    f'{key}.logs = "allow"'
                )
            case "param_lists":
                how = "name one vehicle after the other" if not note.target else "ask for single parameters"
                return f'asks {target} for all parameters: not sent; {how}, or set {key}.param_lists = "allow"'
            case "files":
                return f'asks {target} for files: not sent, since {key}.files is "deny"'
            case "turn":
                other = air.third_party.files.running(now)
                return (
                    f"asks {target} for files while those of {other or 'another'} come: not sent until asked again "
                    f'then, as one vehicle at a time sends files; {key}.files = "allow" sends for all at once'
                )
            case "rate":
                return f"sends {name} to {target}: not sent, since {key}.rates.{name} is 0"
            case "thinned":
                allowed = self._allowed_hz(note.msgid, air)
                return (
                    f"sends {name} at {note.hz:.2g} Hz, of which {allowed:g} Hz go into the radio; send less of it, or "
                    f"raise {key}.rates.{name}"
                )
            case _:
                running = air.third_party.lists.running
                first = "" if running is None else f" ({_progress(running)})"
                return (
                    f"asks for the parameters of vehicle {note.target} while another's list is under way{first}: it "
                    f'waits, as one list at a time is sent for; {key}.param_lists = "allow" sends for all at once'
                )

    def _answer(self, clients: list[Channel], note: Note, name: str) -> None:
        """Send a short text on the client's own channel, unless the client sees only its vehicle there.

        It is sent as a component with our id in the addressed vehicle's system: QGroundControl shows texts of vehicles
        only. (MAVProxy shows only those of autopilots, and we do not pretend to be one.)
        """
        info = self._dialect.by_name.get("STATUSTEXT")
        if info is None:
            return
        text, severity = {
            "streams": ("streams are planned here: request not sent", WARNING),
            "logs": ("no log downloads over this radio", WARNING),
            "param_lists": ("parameter list refused on this radio", WARNING),
            "rate": (f"refused on this radio: {name}", WARNING),
            "files": ("no file transfers over this radio", WARNING),
            "turn": (f"files of {note.target} wait: one vehicle at a time", INFO),
            "thinned": (f"slowed down on this radio: {name}", INFO),
        }.get(note.kind, (f"parameters of {note.target} wait: one list at a time", INFO))
        payload = info.pack({"severity": severity, "text": text[:TEXT_BYTES]})
        message = OwnMessage(info, payload, note.target or self._own.sysid, self._own.compid)
        for channel in clients:
            if channel.translator is None:
                channel.send(message, Priority.PROTOCOL)

    def _clients(self, source: int) -> list[Channel]:
        """The channels that carry this source, except those of vehicles."""
        channels = (self._hub.channels[n] for n in self._hub.router.channels_of(source) if n in self._hub.channels)
        return [c for c in channels if c.air is None and c.config.role != "vehicle" and c.config.type != "replay"]

    def _name(self, msgid: int) -> str:
        info = self._dialect.messages.get(msgid)
        return str(msgid) if info is None else info.name

    def _allowed_hz(self, msgid: int, air: AirBudget) -> float:
        return air.rules.rates_hz.get(msgid, MAX_HZ.get(msgid, 0.0))


def _down_bytes_per_s(air: AirBudget) -> float:
    """Upper limit of one vehicle's rate: its timeslot, or half of the serial rate."""
    rates = air.pacer.rates
    round_s = rates.round_s(air.pacer.vehicles)
    serial = rates.baud / BITS_PER_BYTE * HALF_DUPLEX_SHARE
    return serial if round_s is None else min(serial, rates.slot_bytes / round_s)


def _progress(running: tuple[int, int, int]) -> str:
    system, seen, count = running
    return f"{system}'s: {seen} of {count}" if count else f"{system}'s, of which nothing has come yet"
