"""The field of the benchmark: a daemon, a web process, and simulated vehicles in a process of their own over UDP."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from support.process import free_port, wait_until
from support.web_station import WebStation, command

LINK = """[links.vehicles]
type = "udp_server"
role = "vehicle"
host = "127.0.0.1"
port = {port}

[defaults.streams]
GLOBAL_POSITION_INT = 10
ATTITUDE = 10
"""


@contextlib.contextmanager
def field(vehicles: int, *, daemon: str = "", more: str = "") -> Iterator[WebStation]:
    """All of it, once the daemon knows every vehicle. Half of them are PX4."""
    port = free_port()
    with tempfile.TemporaryDirectory(prefix="skygcs-bench-web-") as folder:
        station = WebStation(Path(folder), (0, 0), links=LINK.format(port=port), daemon=daemon, more=more)
        kinds = ("--px4", str((vehicles + 1) // 2), "--ardupilot", str(vehicles // 2), "--dynamics", "kinematic")
        sim = subprocess.Popen(
            command("sim", *kinds, "--udp", f"127.0.0.1:{port}"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            station.start()
            wait_until(lambda: len(station.call("vehicles.list")) >= vehicles, f"{vehicles} vehicles")
            wait_until(
                lambda: all((v["position"] or {}).get("enu_m") for v in station.call("vehicles.list")), "positions"
            )
            station.vehicles_port = port
            yield station
        finally:
            station.close()
            sim.terminate()
            sim.wait()
