"""Vehicles that pymavlink packs: they send any message, and keep what was sent to them."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

from support.process import DaemonProcess, free_port, wait_until
from support.pymav import UdpPeer
from support.pymav_filled import filled

PX4, ARDUPILOT = 12, 3
"""MAV_AUTOPILOT."""

FLEET = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0
[links.field]
type = "udp_server"
host = "127.0.0.1"
port = {port}
role = "vehicle"
[vehicles.alpha]
sysid = 1
[vehicles.bravo]
sysid = 2
[vehicles.charlie]
sysid = 3
[ros]
domain = {domain}
commands = "{commands}"
px4_msgs = "1.16"
"""

VEHICLES = {"alpha": PX4, "bravo": PX4, "charlie": ARDUPILOT}

TURN_S = 0.02

CARRIES_NOTHING = frozenset({"HEARTBEAT", "SYSTEM_TIME", "TIMESYNC", "PING", "REQUEST_DATA_STREAM"})
READS = frozenset({"PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "MISSION_REQUEST_LIST", "LOG_REQUEST_LIST"})
REQUESTS = frozenset({510, 511, 512, 519, 520, 42428})
"""MAV_CMD: GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, REQUEST_PROTOCOL_VERSION,
REQUEST_AUTOPILOT_CAPABILITIES, DO_SEND_BANNER."""


class PlayedVehicle(UdpPeer):
    """A vehicle that stands disarmed on the ground: heartbeats and a position, from its own thread until `close`."""

    def __init__(self, sysid: int, autopilot: int, port: int) -> None:
        super().__init__(sysid, 1, port)
        self.autopilot = autopilot
        self.began = time.monotonic()
        self._chance = random.Random(sysid)
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def boot_ms(self) -> int:
        return 60_000 + int(1000 * (time.monotonic() - self.began))

    def play(self, name: str, **fields: Any) -> None:
        """Send one message: values that are not given are small numbers at random."""
        stamps = {"time_boot_ms": self.boot_ms, "time_usec": 1000 * self.boot_ms}
        with self._lock:
            self.send(self.pack(filled(name, self._chance, **stamps | fields)))

    def _run(self) -> None:
        next_s = 0.0
        while not self._ended.wait(TURN_S):
            self.poll()
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + 0.5
                mode = {"base_mode": 0x51, "custom_mode": 0x3040000 if self.autopilot == PX4 else 0}
                self.play("HEARTBEAT", type=2, autopilot=self.autopilot, system_status=3, mavlink_version=3, **mode)
                self.play("EXTENDED_SYS_STATE", vtol_state=0, landed_state=1)
                place = {"lat": 437806000, "lon": -794653000, "alt": 180_000, "relative_alt": 0, "hdg": 0}
                self.play("GLOBAL_POSITION_INT", **place, vx=0, vy=0, vz=0)

    def orders(self) -> Counter[str]:
        """What was sent to it beside heartbeats and requests for messages, parameters and lists."""
        found: Counter[str] = Counter()
        for message in list(self.seen):
            name = message.get_type()
            target = getattr(message, "target_system", self.mav.srcSystem)
            if target not in (0, self.mav.srcSystem) or name in CARRIES_NOTHING | READS:
                continue
            if name == "COMMAND_LONG" and message.command in REQUESTS:
                continue
            found[f"{name} {message.command}" if name == "COMMAND_LONG" else name] += 1
        return found

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        super().close()


class PlayedFleet(DaemonProcess):
    """A daemon with ROS and three vehicles on UDP."""

    def __init__(self, folder: Path, commands: str) -> None:
        self.domain = random.SystemRandom().randrange(50, 200)
        self.commands = commands
        self.port = free_port()
        super().__init__(folder, FLEET.format(port=self.port, domain=self.domain, commands=commands))
        self.start()
        wait_until(lambda: all(link["state"] == "up" for link in self.call("links.list")), "the link is up")
        self.wire = {name: PlayedVehicle(n, kind, self.port) for n, (name, kind) in enumerate(VEHICLES.items(), 1)}
        wait_until(self.is_up, "the process of ROS has all vehicles")

    def is_up(self) -> bool:
        report = self.call("ros.status")["report"]
        heard = [state for state in self.vehicles().values() if state["connected"] and state["autopilot"]]
        return report is not None and {v["name"] for v in report["vehicles"]} == VEHICLES.keys() and len(heard) == 3

    def close(self) -> None:
        for vehicle in self.wire.values():
            vehicle.close()
        self.stop()
