"""A ground station made of pymavlink that flies simulated vehicles in virtual time, without sockets."""

from __future__ import annotations

import struct
from functools import cache
from math import nan
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.ardupilot import CopterVehicle
from skygcs.sim.firmware_modes import Px4Mode
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.rng import Rng
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import SimFleet

FIELD = LocalFrame(43.7806, -79.4653, 180.0)
UNIX_US = 1_700_000_000_000_000
COPTER_GUIDED = 4


@cache
def sim_dialect() -> Dialect:
    """ardupilotmega."""
    return load_dialect("ardupilotmega")


def px4(sysid: int = 1, seed: int = 1) -> Px4Vehicle:
    return Px4Vehicle(sim_dialect(), sysid, FIELD, rng=Rng(seed), unix_us=UNIX_US)


def copter(sysid: int = 1, seed: int = 1) -> CopterVehicle:
    return CopterVehicle(sim_dialect(), sysid, FIELD, rng=Rng(seed), unix_us=UNIX_US)


class Pilot:
    """Flies ``vehicles`` as system 255, component 190. ``now`` is the virtual time; everything heard is kept."""

    def __init__(self, *vehicles: SimVehicle, sysid: int = 255, compid: int = 190) -> None:
        self.vehicles = list(vehicles)
        self.now = 0.0
        self.heard: list[Any] = []
        self.raw: list[bytes] = []
        self._fleet = SimFleet(self.vehicles)
        self._parser = mav.MAVLink(None)
        self._packer = mav.MAVLink(None, sysid, compid)
        self.uplink = FrameParser(sim_dialect())

    def run(self, seconds: float, step_s: float = 0.1) -> list[Any]:
        """Let time pass; what was heard meanwhile."""
        before = len(self.heard)
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now = min(end, self.now + step_s)
            self.collect()
        return self.heard[before:]

    def collect(self) -> None:
        for raw in self._fleet.step(self.now):
            self.raw.append(raw)
            messages = self._parser.parse_buffer(raw)
            assert messages is not None and len(messages) == 1, "each write is exactly one frame pymavlink accepts"
            self.heard.append(messages[0])

    def send(self, message: Any) -> list[Any]:
        """Send a message; what was answered at once."""
        before = len(self.heard)
        for frame in self.uplink.feed(message.pack(self._packer)):
            self._fleet.on_frame(frame, self.now)
        self.collect()
        return self.heard[before:]

    def command(self, command: int, *params: float, to: int = 1, comp: int = 1) -> int | None:
        """Result of a COMMAND_LONG as answered at once; None without an answer."""
        filled = (*params, *[0.0] * (7 - len(params)))
        return self._result(self.send(mav.MAVLink_command_long_message(to, comp, command, 0, *filled)), command)

    def command_int(
        self, command: int, *params: float, x: int = 0, y: int = 0, z: float = 0.0, frame: int = 0, to: int = 1
    ) -> int | None:
        """The same with a COMMAND_INT."""
        p = (*params, *[0.0] * (4 - len(params)))
        message = mav.MAVLink_command_int_message(to, 1, frame, command, 0, 0, *p, x, y, z)
        return self._result(self.send(message), command)

    def _result(self, answers: list[Any], command: int) -> int | None:
        acks = [a for a in answers if a.get_type() == "COMMAND_ACK" and a.command == command]
        return acks[-1].result if acks else None

    def all(self, name: str, sysid: int = 1) -> list[Any]:
        return [x for x in self.heard if x.get_type() == name and x.get_srcSystem() == sysid]

    def last(self, name: str, sysid: int = 1) -> Any:
        return self.all(name, sysid)[-1]

    def texts(self, sysid: int = 1) -> list[str]:
        return [x.text.rstrip("\t") for x in self.all("STATUSTEXT", sysid)]

    def rate_hz(self, name: str, seconds: float = 20.0) -> float:
        """Measured over so long."""
        return sum(x.get_type() == name for x in self.run(seconds)) / seconds

    def forget(self) -> None:
        self.heard.clear()

    # -- the way into the air

    def get_ready(self) -> None:
        """Until both firmwares would arm."""
        self.run(10.0)

    def take_off(self, height_m: float = 10.0) -> None:
        """Every vehicle, each its own way, until it hovers there."""
        for v in self.vehicles:
            if isinstance(v, Px4Vehicle):
                amsl = v.where.alt_amsl_m + height_m
                assert self.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, amsl, to=v.sysid) == 0
                assert self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, to=v.sysid) == 0
            else:
                assert self.command(mav.MAV_CMD_DO_SET_MODE, 1, COPTER_GUIDED, to=v.sysid) == 0
                assert self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, to=v.sysid) == 0
                assert self.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m, to=v.sysid) == 0
        self.run(20.0)
        for v in self.vehicles:
            assert abs(v.motion.up_m - height_m) < 0.3, "it did not reach its height"

    def hovering(self, height_m: float = 10.0) -> None:
        """Every vehicle in the air at this height."""
        self.get_ready()
        self.take_off(height_m)
        self.forget()


def int_param(value: int) -> float:
    """An integer parameter as PX4 has it in PARAM_SET's float."""
    wire: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return wire


def px4_mode(pilot: Pilot) -> Px4Mode:
    return Px4Mode(pilot.vehicles[0].mode)
