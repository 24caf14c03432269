"""One autopilot, simulated by skygcs in virtual time or by its own firmware in real time, behind the same few calls.

`behaviour_flights` flies both through a `Rig`. Nothing here knows what either should answer.
"""

from __future__ import annotations

import math
import signal
import socket
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.vehicle import SimVehicle
from support.process import ROOT, free_port
from support.sim_pilot import FIELD, copter, px4, sim_dialect

STEP_S = 0.05
HEARTBEAT_S = 1.0
ACK_S = 3.0
"""A firmware on a loaded machine answers within this; the simulator at once."""

STREAMS_HZ = {"HEARTBEAT": 10, "GLOBAL_POSITION_INT": 20, "EXTENDED_SYS_STATE": 10, "SYS_STATUS": 2}


@dataclass(frozen=True, slots=True)
class Sample:
    """Where it was by its own GLOBAL_POSITION_INT; ``t_s`` is its own time since boot."""

    t_s: float
    east_m: float
    north_m: float
    up_m: float
    vel_mps: float


class Rig(ABC):
    """A ground station (255, component 190) before one vehicle. Times are the vehicle's own, from its boot."""

    def __init__(self, firmware: str, sysid: int) -> None:
        self.firmware = firmware
        self.sysid = sysid
        self.px4 = firmware == "px4"
        self.silent = False
        """Send no heartbeats."""
        self.modes: list[tuple[float, int]] = []
        """(time, HEARTBEAT.custom_mode) whenever it changed."""
        self.track: list[Sample] = []
        self.texts: list[str] = []
        self.armed = False
        self.armed_at = 0.0
        self.disarmed_at = 0.0
        self.landed_state = 0
        self.heard: dict[str, Any] = {}
        self.base = (0.0, 0.0)
        """East and north of FIELD: where the track's zero is, the place of the last take-off."""
        self.now = 0.0
        """Of the vehicle's clock, as far as heard."""
        self._heard_at = 0.0
        """By the station's clock, when `now` was heard."""
        self._acks: list[tuple[int, int]] = []
        self._params: dict[str, float] = {}
        self._parser = mav.MAVLink(None)
        self._parser.robust_parsing = True
        self._packer = mav.MAVLink(None, 255, 190)
        self._beat_at = -1e9
        self.stream: Callable[[float], Any] | None = None
        """Sent at every step while set: a setpoint by the vehicle's time."""

    # -- what differs

    @abstractmethod
    def clock(self) -> float:
        """Seconds of the station: virtual or real."""

    @abstractmethod
    def _write(self, raw: bytes) -> None: ...

    @abstractmethod
    def _pass(self, seconds: float) -> None:
        """Let time pass, and `_hear` what comes when it comes."""

    @abstractmethod
    def gps(self, there: bool) -> None:
        """Take its GPS away, or give it back."""

    @abstractmethod
    def close(self) -> None: ...

    # -- time

    def time(self) -> float:
        """The vehicle's clock now: the time that it reported last, and at most a step more. On a busy machine a
        firmware's simulator is slower than real time, so flights are timed and measured by this clock."""
        return self.now + min(self.clock() - self._heard_at, STEP_S)

    def step(self) -> None:
        if not self.silent and self.clock() - self._beat_at >= HEARTBEAT_S:
            self._beat_at = self.clock()
            self.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self.stream is not None and (setpoint := self.stream(self.time())) is not None:
            self.send(setpoint)
        self._pass(STEP_S)

    def run(self, seconds: float) -> None:
        """So long by both clocks, at most twice as long by the station's. What a vehicle says of its clock may come
        late, and then much of it at once."""
        end_s, end = self.time() + seconds, self.clock() + seconds
        while (left_s := end - self.clock()) > 1e-9 or (self.time() < end_s - STEP_S / 2 and left_s > -seconds):
            self.step()

    def wait(self, condition: Callable[[], Any], limit_s: float, what: str = "") -> float | None:
        """Seconds, by the vehicle's clock, until it held; None if it did not within ``limit_s`` of the station's. With
        ``what`` that is an error."""
        began, began_s = self.clock(), self.time()
        while not condition():
            if self.clock() - began > limit_s:
                assert not what, f"not within {limit_s:g} s: {what}; mode {self.mode:#x}, {self.texts[-3:]}"
                return None
            self.step()
        return self.time() - began_s

    # -- what it says

    @property
    def mode(self) -> int:
        return self.modes[-1][1] if self.modes else -1

    @property
    def here(self) -> Sample:
        return self.track[-1]

    def mode_sequence(self, since_s: float) -> list[int]:
        return [mode for at, mode in self.modes if at >= since_s]

    def _hear(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(data) or []:
            self._take(message)

    def _take(self, message: Any) -> None:
        if message.get_srcSystem() != self.sysid or message.get_srcComponent() != 1:
            return
        name = message.get_type()
        self.heard[name] = message
        if (now := getattr(message, "time_boot_ms", 0) / 1e3) > self.now:
            self.now, self._heard_at = now, self.clock()
        if name == "HEARTBEAT":
            armed = bool(message.base_mode & 128)
            if armed != self.armed:
                self.armed = armed
                if armed:
                    self.armed_at = self.now
                else:
                    self.disarmed_at = self.now
            if message.custom_mode != self.mode:
                self.modes.append((self.now, message.custom_mode))
        elif name == "GLOBAL_POSITION_INT":
            east_m, north_m = FIELD.to_local(message.lat / 1e7, message.lon / 1e7)
            self.track.append(
                Sample(
                    message.time_boot_ms / 1e3,
                    east_m - self.base[0],
                    north_m - self.base[1],
                    message.relative_alt / 1e3,
                    math.hypot(message.vx, message.vy) / 100,
                )
            )
        elif name == "EXTENDED_SYS_STATE":
            self.landed_state = message.landed_state
        elif name == "COMMAND_ACK":
            self._acks.append((message.command, message.result))
        elif name == "PARAM_VALUE":
            self._params[message.param_id] = message.param_value
        elif name == "STATUSTEXT":
            self.texts.append(message.text.rstrip("\t"))

    def zero_here(self) -> None:
        """The track's zero is where it is now."""
        self.base = (self.base[0] + self.here.east_m, self.base[1] + self.here.north_m)
        self.track.clear()
        self.wait(lambda: self.track, 5, "its position")

    # -- what is asked

    def send(self, message: Any) -> None:
        self._write(message.pack(self._packer))

    def command(self, command: int, *params: float) -> int | None:
        """MAV_RESULT of a COMMAND_LONG."""
        filled = (*params, *[0.0] * (7 - len(params)))
        return self._ask(command, mav.MAVLink_command_long_message(self.sysid, 1, command, 0, *filled))

    def command_int(
        self, command: int, *params: float, x: int = 0, y: int = 0, z: float = 0.0, frame: int = 0
    ) -> int | None:
        p = (*params, *[0.0] * (4 - len(params)))
        return self._ask(command, mav.MAVLink_command_int_message(self.sysid, 1, frame, command, 0, 0, *p, x, y, z))

    def _ask(self, command: int, message: Any) -> int | None:
        """The last acknowledgement: PX4 answers DO_SET_MODE twice, and the first answer is always ACCEPTED."""
        self._acks.clear()
        self.send(message)
        self.wait(lambda: self._results(command), ACK_S)
        if self.px4 and command == mav.MAV_CMD_DO_SET_MODE:
            self.wait(lambda: len(self._results(command)) > 1, 1.0)
        return (self._results(command) or [None])[-1]

    def _results(self, command: int) -> list[int]:
        return [r for c, r in self._acks if c == command and r != 5]

    def set_param(self, name: str, value: float, *, integer: bool = False) -> None:
        """Until it answers with the value."""
        wire = value
        if integer and self.px4:
            wire = _int_as_float(int(value))
        kind = 6 if integer else 9
        for _ in range(5):
            self._params.pop(name, None)
            self.send(mav.MAVLink_param_set_message(self.sysid, 1, name.encode(), wire, kind))
            if self.wait(lambda: name in self._params, 1.0) is not None:
                return
        raise AssertionError(f"{name} was not set")

    def set_mode(self, mode: int) -> int | None:
        """MAV_CMD_DO_SET_MODE; PX4's main and sub mode from the custom mode."""
        if self.px4:
            return self.command(mav.MAV_CMD_DO_SET_MODE, 1, mode >> 16 & 0xFF, mode >> 24 & 0xFF)
        return self.command(mav.MAV_CMD_DO_SET_MODE, 1, mode)

    def arm(self, *, forced: bool = False) -> int | None:
        return self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1, 21196 if forced else 0)

    def disarm(self, *, forced: bool = True) -> int | None:
        return self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196 if forced else 0)

    def request_streams(self) -> None:
        for name, rate_hz in STREAMS_HZ.items():
            msgid = getattr(mav, f"MAVLINK_MSG_ID_{name}")
            self.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, msgid, 1e6 / rate_hz)


def _int_as_float(value: int) -> float:
    import struct

    unpacked: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return unpacked


class SimRig(Rig):
    """skygcs's own simulated vehicle; ``vehicle`` may be broken as tests do."""

    def __init__(self, firmware: str, sysid: int = 1, *, rate: float = 1.0) -> None:
        """``rate``: seconds of the vehicle in one of the station."""
        super().__init__(firmware, sysid)
        self._rate = rate
        self.vehicle: SimVehicle = px4(sysid) if firmware == "px4" else copter(sysid)
        self._clock = 0.0
        self._uplink = FrameParser(sim_dialect())

    def clock(self) -> float:
        return self._clock

    def _write(self, raw: bytes) -> None:
        for frame in self._uplink.feed(raw):
            self.vehicle.on_frame(frame, self._clock * self._rate)

    def _pass(self, seconds: float) -> None:
        self._clock += seconds
        for raw in self.vehicle.step(self._clock * self._rate):
            self._hear(raw)

    def gps(self, there: bool) -> None:
        self.vehicle.faults.gps_lost = not there

    def close(self) -> None:
        return


class FirmwareRig(Rig):
    """The firmware's own simulator, started by `skygcs sitl` in ``folder``."""

    def __init__(self, firmware: str, folder: Path, sysid: int = 1) -> None:
        super().__init__(firmware, sysid)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", free_port()))
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        self._log = (folder / "behaviours-sitl.log").open("wb")
        words = [sys.executable, "-m", "skygcs", "sitl", f"--{firmware}", "1", "--first-sysid", str(sysid)]
        words += ["--port", str(self._socket.getsockname()[1]), "--folder", str(folder / "behaviours")]
        if firmware == "ardupilot":
            words += ["--param", "BATT_CAPACITY=30000"]
        words += ["--home", f"{FIELD.lat_deg},{FIELD.lon_deg},{FIELD.alt_amsl_m}"]
        self._sitl = subprocess.Popen(words, stdout=self._log, stderr=self._log, cwd=ROOT)
        self.wait(lambda: "HEARTBEAT" in self.heard, 60, "its first heartbeat")

    def clock(self) -> float:
        return time.monotonic()

    def _write(self, raw: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(raw, self._peer)

    def _pass(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while True:
            try:
                data, self._peer = self._socket.recvfrom(65536)
                self._hear(data)
            except BlockingIOError:
                if (left := end - time.monotonic()) <= 0:
                    return
                time.sleep(min(left, 0.01))

    def gps(self, there: bool) -> None:
        if self.px4:
            self.set_param("SIM_GPS_USED", 10 if there else 0, integer=True)
        else:
            self.set_param("SIM_GPS_DISABLE", float(not there))

    def close(self) -> None:
        self._sitl.send_signal(signal.SIGTERM)
        self._sitl.wait(20)
        self._log.close()
        self._socket.close()
