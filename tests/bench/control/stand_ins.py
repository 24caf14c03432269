"""Vehicles that cost next to nothing: each tells its state 50 times a second and follows whatever mode it is told.

python -m bench.control.stand_ins N PORT: N armed PX4s that hover where they are, on N sockets, until SIGTERM. Position
and attitude go out in a datagram each; setpoints are read and thrown away, a TIMESYNC is answered at once, every
command is accepted. 100 of them take a quarter of a core, where as many simulated ones would take three: with those
the simulator, not the daemon, would be measured.
"""

from __future__ import annotations

import heapq
import select
import socket
import struct
import sys
import time
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import HEADER_V2_BYTES, encode
from skygcs.core.mavlink.modes import px4_custom_mode

STATE_HZ = 50.0
SLOW_EVERY = 50
"""Of the states: heartbeat, GPS, battery and landed state once a second."""

HOME = (43.7806, -79.4653, 180.0)
HEIGHT_M = 8.0
APART_M = 6.0
"""A fleet that keeps the monitor's margin of 2.5 m: with conflicts all around it takes a tenth of a core."""
DEGREES_PER_M = 1 / 111_320

COMMAND_LONG, SET_MODE, TIMESYNC = 76, 176, 111
ARMED_CUSTOM = 0x81
MULTIROTOR, PX4, ACTIVE, IN_AIR, FIX_3D = 2, 12, 4, 2, 3
LARGEST_DATAGRAM = 512


class StandIn:
    """One vehicle."""

    def __init__(self, dialect: Dialect, sysid: int, port: int) -> None:
        self._by_name = dialect.by_name
        self._sysid = sysid
        self._seq = 0
        self._states = 0
        self._mode = px4_custom_mode("AUTO.LOITER")
        self._lat = round((HOME[0] + (sysid % 10) * APART_M * DEGREES_PER_M) * 1e7)
        self._lon = round((HOME[1] + (sysid // 10) * APART_M * DEGREES_PER_M) * 1e7)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.connect(("127.0.0.1", port))

    def tell(self, now: float) -> None:
        """One state, and once a second the rest."""
        boot_ms = int(now * 1000) & 0xFFFFFFFF
        alt_mm, height_mm = round((HOME[2] + HEIGHT_M) * 1000), round(HEIGHT_M * 1000)
        position = {"time_boot_ms": boot_ms, "lat": self._lat, "lon": self._lon, "alt": alt_mm}
        self._say("GLOBAL_POSITION_INT", {**position, "relative_alt": height_mm, "vx": self._states % 3})
        self._say("ATTITUDE", {"time_boot_ms": boot_ms, "roll": 0.01 * (self._states % 5), "yaw": 0.5})
        if self._states % SLOW_EVERY == 0:
            self._heartbeat_task()
            self._say("EXTENDED_SYS_STATE", {"landed_state": IN_AIR})
            fix = {"fix_type": FIX_3D, "lat": self._lat, "lon": self._lon, "alt": alt_mm, "satellites_visible": 12}
            self._say("GPS_RAW_INT", fix)
            self._say("SYS_STATUS", {"voltage_battery": 15_800, "battery_remaining": 80})
        self._states += 1

    def hear(self) -> None:
        """All that has come."""
        while True:
            try:
                data = self.socket.recv(LARGEST_DATAGRAM)
            except (BlockingIOError, ConnectionRefusedError):
                return
            msgid = int.from_bytes(data[7:10], "little")
            if msgid == TIMESYNC:
                (ours,) = struct.unpack_from(
                    "<q", data[HEADER_V2_BYTES : HEADER_V2_BYTES + data[1]].ljust(16, b"\0"), 8
                )
                self._say("TIMESYNC", {"tc1": time.monotonic_ns(), "ts1": ours})
            elif msgid == COMMAND_LONG:
                info = self._by_name["COMMAND_LONG"]
                self._obey(info.unpack(data[HEADER_V2_BYTES : HEADER_V2_BYTES + data[1]]))

    def _obey(self, reported: dict[str, Any]) -> None:
        if reported["command"] == SET_MODE:
            self._mode = int(reported["param2"]) << 16 | int(reported["param3"]) << 24
        self._say("COMMAND_ACK", {"command": reported["command"], "result": 0})
        self._heartbeat_task()

    def _heartbeat_task(self) -> None:
        mode = {"base_mode": ARMED_CUSTOM, "custom_mode": self._mode, "system_status": ACTIVE, "mavlink_version": 3}
        self._say("HEARTBEAT", {"type": MULTIROTOR, "autopilot": PX4, **mode})

    def _say(self, name: str, values: dict[str, Any]) -> None:
        raw = encode(self._by_name[name], values, sysid=self._sysid, compid=1, seq=self._seq)
        self._seq = self._seq + 1 & 0xFF
        try:
            self.socket.send(raw)
        except (BlockingIOError, ConnectionRefusedError):
            return  # nobody listens yet, or any more


def main() -> int:
    count, port = int(sys.argv[1]), int(sys.argv[2])
    dialect = load_dialect(["ardupilotmega"])
    poll = select.epoll()
    begun = time.monotonic()
    waiting: list[tuple[float, int]] = []
    vehicles = {}
    for n in range(count):
        vehicle = StandIn(dialect, n + 1, port)
        vehicles[vehicle.socket.fileno()] = vehicle
        poll.register(vehicle.socket, select.EPOLLIN)
        heapq.heappush(waiting, (begun + n / count / STATE_HZ, vehicle.socket.fileno()))
    while True:
        now = time.monotonic()
        while waiting[0][0] <= now:
            due, fd = waiting[0]
            heapq.heapreplace(waiting, (due + 1 / STATE_HZ, fd))
            vehicles[fd].tell(now)
        for fd, _ in poll.poll(max(0.001, waiting[0][0] - now)):
            vehicles[fd].hear()


if __name__ == "__main__":
    sys.exit(main())
