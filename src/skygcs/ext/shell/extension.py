"""Shells in the daemon: opens them, sends what is typed as the vehicle's shell reads it, and keeps what it puts out."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

from skygcs.config.tables import Model, Problem
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.flight_lock import ConsoleInput
from skygcs.core.vehicle.gate import clear_message
from skygcs.core.vehicle.orders import FORCE_HINT
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import VehicleModel, model_of
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.ext.shell.methods import METHODS
from skygcs.ext.shell.shell_input import QUIET_S
from skygcs.ext.shell.shell_session import ShellSession
from skygcs.extension import Clock, Extension

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.core.mavlink.frame import Frame
    from skygcs.links.base import Channel
    from skygcs.rpc.context import Context, JsonObject, Services
    from skygcs.runtime.vehicle_actor import VehicleActor

MESSAGE = "SERIAL_CONTROL"
DEVICE_SHELL = 10
"""SERIAL_CONTROL_DEV_SHELL."""

REPLY = 1
"""SERIAL_CONTROL_FLAG_REPLY: from the vehicle."""

OPEN_FLAGS = 2 | 4 | 16
"""SERIAL_CONTROL_FLAG_RESPOND, without which PX4 ends the shell; _EXCLUSIVE and _MULTI as PX4's own tools send them."""

DATA_BYTES = 70

PERIOD_S = 0.05
"""One message of 70 bytes at most in this time, and none while the one before still waits for its turn on the link."""

MIN_VERSION = (1, 16)
"""The first PX4 whose source was seen to look at the message's addressee (mavlink_receiver.cpp:
handle_message_serial_control). An earlier one may execute what another on the same link is sent."""

RESTART_S = 2.0
"""From the end of a shell to the begin of the next one of its vehicle. It ends in a task of its own, and SITL's has the
output of the whole process until then (pxh.cpp: run_remote_pxh)."""

KIND = "shell"


class ShellConfig(Model):
    """[shell]: its presence adds the shell methods."""


class Shell(Extension[ShellConfig]):
    """One session for each vehicle at most."""

    Config = ShellConfig
    own_methods = METHODS

    def __init__(self, core: Services, config: ShellConfig) -> None:
        super().__init__(core, config)
        self._sessions: dict[str, ShellSession] = {}
        self._info = core.dialect.by_name.get(MESSAGE)
        self._addressed = self._info is not None and self._info.target_system_offset >= 0
        self._own = core.config.daemon.sysid
        self._left: set[int] = set()
        """Vehicles (sysid << 8 | compid) on which a shell was left: it may hold the beginning of a line."""
        self._closed_at: dict[int, float] = {}
        """When a vehicle (sysid << 8 | compid) was told to end its shell."""
        self.ignored_frames = 0
        self.bad_frames = 0

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        if not fleet.daemon.keep_vehicles:
            return [Problem(("shell",), "needs vehicles: set daemon.keep_vehicles = true")]
        return []

    def clocks(self) -> Iterable[Clock]:
        yield Clock("shell", PERIOD_S, lambda: self.tick(self.core.now()))

    def observed_msgids(self) -> Collection[int]:
        return () if self._info is None else (self._info.msgid,)

    def close(self) -> None:
        for session in [*self._sessions.values()]:
            self._end(session, "the daemon ends")

    # -- methods

    def open(self, context: Context, target: str | int, *, force: bool) -> JsonObject:
        """Open the shell of a vehicle for this client. Raises TargetError and RefusedError."""
        now, actor = self.core.now(), self.core.fleet.find(target)
        other = next((s for s in self._sessions.values() if s.actor is actor), None)
        if other is not None:
            raise RefusedError(
                f"a client has had {actor.name}'s shell for {now - other.opened_at:.0f} s: one at a time"
            )
        if (why := self._why_none(actor)) is not None:
            raise RefusedError(f"{actor.name}: {why}")
        if (why := self._refusal(actor, force=force)) is not None:
            raise RefusedError(why)
        session = ShellSession(actor, force=force, now=now)
        if not self.core.hub.channels_to(actor.sysid, actor.compid):
            raise RefusedError(f"{actor.name}: no link leads to it")
        key = actor.vehicle.key
        if key in self._left and self._send(session, b"", flags=0):
            self._left.discard(key)
            self._closed_at[key] = now
        session.starts_at = self._closed_at.get(key, -math.inf) + RESTART_S
        if session.starts_at <= now and not self._start(session, now):
            raise RefusedError(f"{actor.name}: no link can send the message now")
        self._sessions[session.key] = session
        session.take_back = context.at_end(lambda: self._end(session, "its client is gone"))
        others = ", ".join(vehicle.name for vehicle in self._others(actor))
        note = f"on the same link {others} hear what is typed, too" if others else ""
        self._report(session, f"shell opened{' by force' if force else ''}")
        return {"session": session.key, "vehicle": actor.name, "note": note}

    def write(self, key: str, text: str) -> JsonObject:
        """Take text for the shell. Raises RefusedError."""
        session = self._session(key)
        if (why := self._refusal(session.actor, force=session.force)) is not None:
            raise RefusedError(why)
        if (problem := session.input.put(text)) is not None:
            raise RefusedError(f"the text {problem}")
        if session.input.cut:
            self._end(session, "Ctrl-C came while a line was being sent: open the shell anew")
        return {"waiting_bytes": session.input.waiting_bytes}

    async def read(self, key: str, wait_s: float) -> JsonObject:
        """The output since the last read. Raises RefusedError."""
        session = self._session(key)
        if wait_s and not session.has_news:
            await session.wait(wait_s)
        text, dropped = session.output.take()
        refused, session.refused = session.refused, ""
        answer = {"text": text, "dropped_bytes": dropped, "refused": refused, "end": session.end}
        return answer | {"ready": session.end is None and session.input.ready}

    def close_session(self, key: str) -> JsonObject:
        """Raises RefusedError if there is none."""
        self._end(self._session(key), "closed")
        return {"closed": True}

    def status(self) -> JsonObject:
        """See `ShellStatus`."""
        now = self.core.now()
        sessions = [
            {
                "vehicle": session.actor.name,
                "forced": session.force,
                "open_s": round(now - session.opened_at, 1),
                "waiting_bytes": session.input.waiting_bytes,
                "received_bytes": session.output.received_bytes,
                "dropped_bytes": session.output.dropped_bytes,
            }
            for session in self._sessions.values()
        ]
        return {"sessions": sessions, "ignored_frames": self.ignored_frames, "bad_frames": self.bad_frames}

    # -- the vehicle

    def on_frame(self, frame: Frame, channel: Channel, now: float) -> None:
        """Keep output of a shell that is open; nothing of anybody else gets in."""
        fields = frame.fields()
        if fields["device"] != DEVICE_SHELL or not fields["flags"] & REPLY or channel.config.type == "replay":
            return
        session = next(
            (s for s in self._sessions.values() if s.actor.vehicle.key == frame.sysid << 8 | frame.compid), None
        )
        if session is None or fields.get("target_system", 0) not in (0, self._own):
            self.ignored_frames += 1
            return
        if fields["count"] > DATA_BYTES:
            self.bad_frames += 1
            return
        data = bytes(fields["data"][: fields["count"]])
        session.input.on_output(data, now)
        session.output.put(data)
        session.wake()

    def tick(self, now: float) -> None:
        """Send what the shells may be sent now."""
        for session in [*self._sessions.values()]:
            if self.core.fleet.vehicles.get(session.actor.vehicle.key) is not session.actor:
                self._end(session, "the vehicle is gone, or has another system id")
                continue
            if session.started_at is None:
                if (why := self._refusal(session.actor, force=session.force)) is not None:
                    session.drop_input(why)
                elif now >= session.starts_at:
                    self._start(session, now)
                continue
            if not session.woken and now - session.started_at >= QUIET_S:
                self._wake(session, now)
                continue
            piece = session.input.next_piece(now)
            if not piece or self._still_waits(session):
                continue
            if (why := self._refusal(session.actor, force=session.force)) is not None:
                session.drop_input(why)
                if session.input.cut:
                    self._end(session, f"a line was cut off: {why}")
                continue
            if self._send(session, piece, flags=OPEN_FLAGS):
                session.input.sent(piece, now)
                if (line := session.line_sent(piece)) is not None:
                    self._report(session, f"shell: {line}")

    def _wake(self, session: ShellSession, now: float) -> None:
        """Send an Enter for the first prompt if none has come: pxh does not greet, nor does a shell that another
        program has left, and what modules print is no prompt. It is input as any other."""
        if not session.input.awaits_prompt:
            session.woken = True
        elif self._refusal(session.actor, force=session.force) is None and self._send(session, b"\n", flags=OPEN_FLAGS):
            session.input.sent_enter(now)
            session.woken = True

    def _start(self, session: ShellSession, now: float) -> bool:
        """Have the vehicle begin a shell, whose greeting may come; False if no link takes the message."""
        if not self._send(session, b"", flags=OPEN_FLAGS):
            return False
        session.started_at = now
        session.input.begin(now)
        return True

    def _still_waits(self, session: ShellSession) -> bool:
        """True if a message of this session waits for its turn on the link: a radio would get a queue of them."""
        sysid, channels = session.actor.sysid, self.core.hub.channels
        ids = self.core.hub.channels_to(sysid, session.actor.compid)
        return any(channels[i].holds(Priority.PROTOCOL, sysid, (KIND, sysid)) for i in ids)

    def _send(self, session: ShellSession, data: bytes, *, flags: int) -> bool:
        """True if a link took it. What the outgoing gate does not let pass is not sent."""
        actor, info = session.actor, self._info
        assert info is not None
        values: dict[str, Any] = {"device": DEVICE_SHELL, "flags": flags, "count": len(data), "data": data}
        if self._addressed:
            values |= {"target_system": actor.sysid, "target_component": actor.compid}
        try:
            clearance = clear_message(self._reached(actor), MESSAGE, values, {}, force=session.force)
        except RefusedError:
            return False
        key = (KIND, actor.sysid)
        ids = (actor.sysid, actor.compid)
        return self.core.hub.send(info, values, *ids, Priority.PROTOCOL, key=key, clearance=clearance)

    # -- reasons against it

    def _why_none(self, actor: VehicleActor) -> str | None:
        """Why a vehicle has no shell that could be opened, even by force."""
        vehicle = actor.vehicle
        if self._info is None:
            return f"dialect {self.core.dialect.name} has no {MESSAGE}"
        if vehicle.replayed:
            return "it is heard only in a recording"
        if vehicle.family == "ardupilot":
            return "ArduPilot has no shell over MAVLink (its SERIAL_CONTROL reaches serial ports)"
        if vehicle.family != "px4":
            return "its firmware is not known to have a shell over MAVLink; PX4 has one"
        return None

    def _refusal(self, actor: VehicleActor, *, force: bool) -> str | None:
        """Why nothing may be typed for this vehicle now; None: it may."""
        gates = self.core.hub.send_gates
        if gates is not None and (why := gates.refusal(actor.sysid, self.core.hub.boot_clock())) is not None:
            return why
        hearing = [v for v in self._others(actor) if not (self._addressed and _looks(v.firmware))]
        for vehicle in [*self.core.fleet.vehicles_of(actor.sysid), *hearing]:
            if (why := self.core.fleet.locks.refusal(ConsoleInput(vehicle.key))) is not None:
                return why
        if force:
            return None
        for model in self._reached(actor):
            if model.not_disarmed is not None:
                own = model.name in (v.name for v in self.core.fleet.vehicles_of(actor.sysid))
                why = f"{model.name} {model.not_disarmed}{'' if own else ' and on the same link'}"
                return f"{why}: a shell is for disarmed vehicles; {FORCE_HINT}"
        if hearing:
            names = ", ".join(f"{one.name} (PX4 {one.firmware or 'of unknown version'})" for one in hearing)
            return f"on the same link {names} may execute what is typed for {actor.name}, too; {FORCE_HINT}"
        return None

    def _reached(self, actor: VehicleActor) -> list[VehicleModel]:
        """All that will hear what is typed: the system itself, and other PX4s on its link."""
        now = self.core.now()
        own = [model_of(vehicle, now) for vehicle in self.core.fleet.vehicles_of(actor.sysid) if not vehicle.replayed]
        return [*own, *(model_of(vehicle, now) for vehicle in self._others(actor))]

    def _others(self, actor: VehicleActor) -> list[Vehicle]:
        """PX4s of other systems on the channels that lead to this one."""
        hub = self.core.hub
        on = {key for i in hub.channels_to(actor.sysid, actor.compid) for key in hub.router.table.autopilots_on(i)}
        actors = (self.core.fleet.vehicles.get(key) for key in sorted(on))
        vehicles: list[Vehicle] = [other.vehicle for other in actors if other is not None]
        return [
            vehicle
            for vehicle in vehicles
            if vehicle.sysid != actor.sysid and vehicle.family == "px4" and not vehicle.replayed
        ]

    # -- parts

    def _session(self, key: str) -> ShellSession:
        session = self._sessions.get(key)
        if session is None:
            raise RefusedError("there is no such session: it was closed, or ended with its client or its vehicle")
        return session

    def _end(self, session: ShellSession, why: str) -> None:
        """End it, and the shell of a vehicle that may be told. Idempotent."""
        if self._sessions.pop(session.key, None) is None:
            return
        session.take_back()
        session.input.drop()
        told = self._refusal(session.actor, force=session.force) is None and self._send(session, b"", flags=0)
        key = session.actor.vehicle.key
        if told:
            self._closed_at[key] = self.core.now()
        if not told or session.input.cut:
            self._left.add(key)
        session.end = why
        session.wake()
        self._report(session, f"shell ended: {why}")

    def _report(self, session: ShellSession, text: str) -> None:
        self.core.event_log.publish(Event(KIND, session.actor.name, session.actor.sysid, text, {}))


def _looks(version: str | None) -> bool:
    """True if a PX4 of this version looks at the addressee."""
    found = re.match(r"(\d+)\.(\d+)", version or "")
    return found is not None and (int(found[1]), int(found[2])) >= MIN_VERSION
