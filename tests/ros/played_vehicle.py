"""Vehicles that pymavlink packs: they send any message, and keep what was sent to them."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from typing import Any

from support.pymav import UdpPeer
from support.pymav_filled import filled

PX4, ARDUPILOT = 12, 3
"""MAV_AUTOPILOT."""

TURN_S = 0.02

CARRIES_NOTHING = frozenset({"HEARTBEAT", "SYSTEM_TIME", "TIMESYNC", "PING", "REQUEST_DATA_STREAM"})
READS = frozenset({"PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "MISSION_REQUEST_LIST", "LOG_REQUEST_LIST"})
REQUESTS = frozenset({511, 512, 519, 520})
"""MAV_CMD: SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, REQUEST_PROTOCOL_VERSION, REQUEST_AUTOPILOT_CAPABILITIES."""


class PlayedVehicle(UdpPeer):
    """A vehicle that stands disarmed on the ground: heartbeats and a position, from a thread of its own until `close`."""

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
