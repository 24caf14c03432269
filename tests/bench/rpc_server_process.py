"""A fleet of real vehicles that hear telemetry, behind an RPC server, in a process of its own, for the benches.

python -m rpc_server_process SOCKET NUMBER: prints "ready", ends when its stdin is closed.
"""

from __future__ import annotations

import asyncio
import sys
from typing import Any

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.rpc.server import RpcServer
from skygcs.runtime.fleet import Fleet
from support.fake_daemon import FakeDaemon
from support.services import KnownLinks

TELEMETRY: dict[str, dict[str, Any]] = {
    "HEARTBEAT": {"type": 2, "autopilot": 12, "base_mode": 81, "custom_mode": 50593792, "system_status": 3},
    "ATTITUDE": {"time_boot_ms": 1000, "roll": 0.1, "pitch": -0.05, "yaw": 1.5},
    "GLOBAL_POSITION_INT": {"time_boot_ms": 1000, "lat": 437806000, "lon": -794653000, "alt": 182500, "hdg": 9000},
    "LOCAL_POSITION_NED": {"time_boot_ms": 1000, "x": 1.0, "y": 2.0, "z": -3.0},
    "GPS_RAW_INT": {"fix_type": 3, "lat": 437806000, "lon": -794653000, "eph": 80, "epv": 90, "satellites_visible": 11},
    "SYS_STATUS": {"voltage_battery": 15800, "current_battery": 120, "battery_remaining": 87},
    "VFR_HUD": {"airspeed": 1.0, "groundspeed": 1.0, "heading": 90, "throttle": 40},
    "STATUSTEXT": {"severity": 6, "text": "Ready to fly"},
}


class BenchDaemon(FakeDaemon):
    """The fake daemon with a real fleet."""

    def __init__(self, vehicle_count: int) -> None:
        super().__init__(0)
        loop = asyncio.get_running_loop()
        self.fleet: Any = Fleet(FleetConfig(), self.dialect, lambda *_: True, loop, lambda _: None, links=KnownLinks())
        for sysid in range(1, vehicle_count + 1):
            self.hear_all(sysid)

    def now(self) -> float:
        return asyncio.get_running_loop().time()

    def hear_all(self, sysid: int) -> None:
        for name, fields in TELEMETRY.items():
            info = self.dialect.by_name[name]
            frame = Frame(encode(info, fields, sysid=sysid, compid=1, seq=0), 0, sysid, 1, info.msgid, info)
            self.fleet.on_frame(sysid << 8 | 1, frame, "radio", self.now())


async def serve(path: str, vehicle_count: int) -> None:
    server = RpcServer(BenchDaemon(vehicle_count), path)
    await server.start()
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    await server.close()


if __name__ == "__main__":
    import uvloop

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(serve(sys.argv[1], int(sys.argv[2])))
