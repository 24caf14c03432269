"""Vehicles for tests: pymavlink says what they say (an independent encoder), our parser reads it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.dialect import Dialect, MessageInfo
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.mavlink.vehicle_class import TABLE, VehicleClass
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.gate import Clearance
from skygcs.events import Event
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.vehicle_actor import VehicleActor
from support.pymav import PymavPeer
from support.services import KnownLinks

CAPTURE = Path(__file__).parents[1] / "data" / "sitl-3ardupilot-2px4.tlog"

PX4, ARDUPILOT = 12, 3
PX4_LOITER = 4 << 16 | 3 << 24
PX4_TAKEOFF = 4 << 16 | 2 << 24
PX4_RTL = 4 << 16 | 5 << 24
PX4_LAND = 4 << 16 | 6 << 24
PX4_POSCTL = 3 << 16

ASKED_PARAMS = TABLE["px4", VehicleClass.COPTER].asked_params
"""Parameters that skygcs reads of each new vehicle."""

HOME = (47.3977420, 8.5455940, 488.1)
"""Where the capture was flown."""


@cache
def flight_dialect() -> Dialect:
    """The default dialect of a fleet file."""
    return load_dialect(["ardupilotmega", "px4-extras"])


def parsed(data: bytes) -> Frame:
    """The one frame of these bytes."""
    (frame,) = FrameParser(flight_dialect()).feed_datagram(data)
    return frame


class Voice(PymavPeer):
    """Says what one vehicle says."""

    def __init__(self, sysid: int = 1, compid: int = 1) -> None:
        super().__init__(sysid, compid)

    def say(self, message: Any) -> Frame:
        return parsed(self.pack(message))

    def beat(
        self, autopilot: int = PX4, mode: int = PX4_LOITER, *, armed: bool = False, status: int = 3, kind: int = 2
    ) -> Frame:
        base = 1 | (0x80 if armed else 0)
        return self.say(mav.MAVLink_heartbeat_message(kind, autopilot, base, mode, status, 3))

    def text(self, words: str, severity: int = 6) -> Frame:
        return self.say(mav.MAVLink_statustext_message(severity, words.encode()))

    def position(
        self,
        lat_deg: float = HOME[0],
        lon_deg: float = HOME[1],
        alt_amsl_m: float = HOME[2],
        rel_m: float = 0.0,
        *,
        velocity: tuple[int, int, int] = (0, 0, 0),
        heading: int = 0,
        boot_ms: int = 60_000,
    ) -> Frame:
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        alt, rel = round(alt_amsl_m * 1000), round(rel_m * 1000)
        return self.say(mav.MAVLink_global_position_int_message(boot_ms, lat, lon, alt, rel, *velocity, heading))

    def ack(self, command: int, result: int = 0, *, progress: int = 0, to: tuple[int, int] = (255, 25)) -> Frame:
        return self.say(mav.MAVLink_command_ack_message(command, result, progress, 0, *to))

    def estimate(self, flags: int = 831) -> Frame:
        """An EKF_STATUS_REPORT; without flags of one that knows where it is."""
        return self.say(mav.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.0))

    def landed(self, state: int) -> Frame:
        return self.say(mav.MAVLink_extended_sys_state_message(0, state))

    def system_time(self, boot_ms: int, unix_us: int = 1_700_000_000_000_000) -> Frame:
        return self.say(mav.MAVLink_system_time_message(unix_us, boot_ms))


class Sent:
    """One message of ours, as pymavlink reads its bytes."""

    def __init__(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        compid: int,
        priority: Priority,
        everywhere: bool = False,
        clearance: Clearance | None = None,
    ):
        raw = encode(info, values, sysid=255, compid=25, seq=0)
        (self.message,) = PymavPeer(1, 1).mav.parse_buffer(raw)
        self.name = info.name
        self.sysid = sysid
        self.compid = compid
        self.priority = priority
        self.everywhere = everywhere

    def __getattr__(self, field: str) -> Any:
        return getattr(self.message, field)


Script = Callable[["ScriptedVehicle", Sent], None]


class ScriptedVehicle(Voice):
    """A vehicle that does what a test tells it: it beats once a second and hands every command to ``script``.

    ``mode``, ``armed``, ``status`` go out with the next heartbeat; ``delay_s`` is one way of the link.
    """

    def __init__(
        self, ground: Ground, sysid: int = 1, autopilot: int = PX4, mode: int | None = None, *, delay_s: float = 0.05
    ) -> None:
        super().__init__(sysid)
        self.ground = ground
        self.autopilot = autopilot
        self.mode = mode if mode is not None else (PX4_LOITER if autopilot == PX4 else 0)
        self.armed = False
        self.status = 3
        self.flying = False
        self.place = HOME[:2]
        self.target: tuple[int, int, float] | None = None
        """What an ArduCopter reports that it flies to: latitude and longitude (1e-7 degrees), altitude."""
        self.delay_s = delay_s
        self.booted_at = asyncio.get_running_loop().time() - 60.0
        self.silent = False
        self.got: list[Sent] = []
        self.script: Script = accept_everything
        self._task = asyncio.get_running_loop().create_task(self._heartbeat_task())
        ground.scripted.append(self)

    def tell(self, frame: Frame, after_s: float = 0.0) -> None:
        """Let the ground hear a frame."""
        loop = asyncio.get_running_loop()
        loop.call_later(self.delay_s + after_s, self._arrive, frame)

    def reply(self, sent: Sent, result: int = 0, *, after_s: float = 0.0, progress: int = 0) -> None:
        self.tell(self.ack(sent.command, result, progress=progress), after_s)

    def on_sent(self, sent: Sent) -> None:
        """A message of ours goes to this vehicle."""
        asyncio.get_running_loop().call_later(self.delay_s, self._hear, sent)

    @property
    def boot_ms(self) -> int:
        """Its time since boot."""
        return round((asyncio.get_running_loop().time() - self.booted_at) * 1000)

    def restart(self, after_s: float) -> None:
        """It is silent from now on and starts anew; its clock is heard first."""

        def started() -> None:
            self.silent = False
            self.booted_at = asyncio.get_running_loop().time()
            self.tell(self.system_time(self.boot_ms))

        self.silent = True
        asyncio.get_running_loop().call_later(after_s, started)

    def pulse(self) -> None:
        self.tell(self.beat(self.autopilot, self.mode, armed=self.armed, status=self.status))
        up_m = 10.0 if self.flying else 0.0
        self.tell(self.position(*self.place, alt_amsl_m=HOME[2] + up_m, rel_m=up_m, boot_ms=self.boot_ms))
        self.tell(self.landed(2 if self.flying else 1))

    def commands(self) -> list[tuple[int, tuple[float, ...]]]:
        """(command, its first two parameters) of all that was heard."""
        return [(s.command, (s.param1, s.param2)) for s in self.got if s.name.startswith("COMMAND_")]

    async def stop(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _heartbeat_task(self) -> None:
        while True:
            self.pulse()
            await asyncio.sleep(1.0)

    def _hear(self, sent: Sent) -> None:
        if self.silent or (
            sent.name == "COMMAND_LONG" and sent.command in (512, 42428) and sent.priority is Priority.PROTOCOL
        ):
            return
        if sent.name == "PARAM_REQUEST_READ" and (name := sent.param_id) in ASKED_PARAMS:
            self.tell(self.say(mav.MAVLink_param_value_message(name.encode(), 0.0, 9, 1, 0)))  # its default
            return
        self.got.append(sent)
        self.script(self, sent)

    def _arrive(self, frame: Frame) -> None:
        if not self.silent:
            now = asyncio.get_running_loop().time()
            self.ground.fleet.on_frame(frame.sysid << 8 | frame.compid, frame, "test", now)


def accept_everything(vehicle: ScriptedVehicle, sent: Sent) -> None:
    """Does what it is told, as an autopilot in perfect health."""
    if sent.name == "COMMAND_LONG" and sent.command == 400:
        vehicle.armed = sent.param1 == 1
    elif sent.name == "COMMAND_LONG" and sent.command == 176:
        px4 = vehicle.autopilot == PX4
        vehicle.mode = int(sent.param2) << 16 | int(sent.param3) << 24 if px4 else int(sent.param2)
    elif sent.name == "COMMAND_LONG" and sent.command == 22:
        vehicle.mode = PX4_TAKEOFF if vehicle.autopilot == PX4 else 4
        vehicle.flying = True
    elif sent.name == "COMMAND_LONG" and sent.command == 21:
        vehicle.mode = PX4_LAND if vehicle.autopilot == PX4 else 9
    elif sent.name == "COMMAND_LONG" and sent.command == 20:
        vehicle.mode = PX4_RTL if vehicle.autopilot == PX4 else 6
    elif sent.command == 192:
        vehicle.mode = PX4_LOITER if vehicle.autopilot == PX4 else 4
        if sent.name == "COMMAND_INT":
            vehicle.target = (sent.x, sent.y, HOME[2] + sent.z)
    elif sent.name == "COMMAND_LONG" and sent.command == 512 and vehicle.target is not None:
        target = mav.MAVLink_position_target_global_int_message(1, 0, 0xFFF8, *vehicle.target, *[0.0] * 8)
        vehicle.tell(vehicle.say(target), 0.01)
    if sent.name.startswith("COMMAND_"):
        vehicle.reply(sent)


class Ground:
    """A fleet with nothing below it: what it sends goes to scripted vehicles, what happens is kept in ``events``."""

    def __init__(self, config: dict[str, Any] | None = None) -> None:
        self.events: list[Event] = []
        self.sent: list[Sent] = []
        self.scripted: list[ScriptedVehicle] = []
        self.links_up = True
        self.links = KnownLinks()
        self.loop = asyncio.get_running_loop()
        quiet = {"defaults": {"streams": {}}, **(config or {})}  # no requests for messages but those of the test
        self.fleet = Fleet(
            FleetConfig.model_validate(quiet),
            flight_dialect(),
            self._send,
            self.loop,
            self.events.append,
            links=self.links,
        )
        self._task = self.loop.create_task(self._tick())

    async def __aenter__(self) -> Ground:
        return self

    async def __aexit__(self, *_: object) -> None:
        for vehicle in self.scripted:
            await vehicle.stop()
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        self.fleet.close()

    def kinds(self) -> list[str]:
        return [e.kind for e in self.events]

    async def met(self, *vehicles: ScriptedVehicle) -> list[VehicleActor]:
        """Their actors, once they were heard."""
        await asyncio.sleep(0.5)
        return [self.fleet.vehicles[v.mav.srcSystem << 8 | v.mav.srcComponent] for v in vehicles]

    def _send(
        self,
        info: MessageInfo,
        values: Mapping[str, Any],
        sysid: int,
        compid: int,
        priority: Priority,
        *,
        everywhere: bool = False,
        clearance: Clearance | None = None,
        key: object = None,
    ) -> bool:
        sent = Sent(info, values, sysid, compid, priority, everywhere)
        self.sent.append(sent)
        if not self.links_up:
            return False
        for vehicle in self.scripted:
            if sysid in (0, vehicle.mav.srcSystem):
                vehicle.on_sent(sent)
        return True

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(0.2)
            self.fleet.tick(self.loop.time())
