"""What the daemon takes on a companion that flies its vehicle by attitude at 50 Hz, beside a bare interpreter.

Run by `make bench`; results also in build/bench/companion.json. The vehicle is a simulated ArduCopter or PX4 in a
process of its own, over UDP; the ground is a port that takes MAVLink; the door for orders is open (TLS). Processor
time is that of the process alone over FLOWN_S, beside a bare asyncio loop on uvloop whose timer fires as often. Only
that the vehicle is flown by attitude is asserted: times are for reading.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bench.results import keep
from bench.test_memory import memory_mb
from support.pinned import make_pair
from support.process import DaemonProcess, free_port, wait_until
from support.router_bench import cpu_s

FLOWN_S = float(os.environ.get("SKYGCS_BENCH_COMPANION_S", "20"))
RATE_HZ = 50.0
LOCAL_LOOP = (
    "import asyncio, sys\n"
    "async def tick():\n"
    "    print(flush=True)\n"
    f"    while True: await asyncio.sleep({1 / RATE_HZ})\n"
)
BARE = {
    "interpreter": "import time; print(flush=True); time.sleep(600)",
    "asyncio and uvloop": "import asyncio, time, uvloop; print(flush=True); time.sleep(600)",
    "asyncio and uvloop, a timer at 50 Hz": f"import uvloop\n{LOCAL_LOOP}uvloop.run(tick())",
}


def figures(pid: int, during_s: float) -> dict[str, float]:
    """Memory, and processor time in parts of one core."""
    began, used = time.monotonic(), cpu_s(pid)
    time.sleep(during_s)
    share = (cpu_s(pid) - used) / (time.monotonic() - began)
    return {**memory_mb(pid), "core": share}


def bare(code: str) -> dict[str, float]:
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = figures(process.pid, min(FLOWN_S, 10.0))
        process.kill()
    return found


def companion(folder: Path, firmware: str) -> dict[str, float]:
    """The companion's daemon while its vehicle is flown by attitude."""
    autopilot, ground, rpc = free_port(), free_port(), free_port(socket.SOCK_STREAM)
    make_pair(folder / "ground", folder / "keys")
    daemon = DaemonProcess(
        folder,
        f'[companion]\nvehicle = "alpha"\nground = "udp:127.0.0.1:{ground}"\nrpc_listen = "127.0.0.1:{rpc}"\n'
        f"[vehicles.alpha]\nsysid = 1\n[vehicles.alpha.control]\nrate_hz = {RATE_HZ}\n"
        "[origin]\nlat_deg = 43.7806\nlon_deg = -79.4653\nalt_amsl_m = 180.0\n"
        f'[links.autopilot]\ntype = "udp_server"\nhost = "127.0.0.1"\nport = {autopilot}\nrole = "vehicle"\n',
    )
    numbers = {"px4": 0, "ardupilot": 0, firmware: 1}
    options = [word for name, number in numbers.items() for word in (f"--{name}", str(number))]
    vehicle = [sys.executable, "-m", "skygcs", "sim", *options, "--udp", f"127.0.0.1:{autopilot}"]
    with daemon, subprocess.Popen(vehicle, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as flown:
        try:
            wait_until(daemon.known, "the vehicle is heard")
            outcome: dict[str, Any] = daemon.call("vehicles.arm", targets="alpha", wait_s=100)["outcomes"]["alpha"]
            assert outcome["ok"], outcome
            assert daemon.call("vehicles.takeoff", targets="alpha", height_m=8)["outcomes"]["alpha"]["ok"]
            wait_until(lambda: height_m(daemon) > 7.0, "it has taken off")
            if firmware == "ardupilot":  # the thrust of an attitude is thrust, and no climb rate
                daemon.call("params.set", targets="alpha", params={"GUID_OPTIONS": 8, "GUID_TIMEOUT": 1})
            wait_until(lambda: takes_control(daemon), "it is flown by setpoints")
            wait_until(lambda: mode(daemon) == "attitude", "they are attitudes")
            assert daemon.process is not None
            found = figures(daemon.process.pid, FLOWN_S)
            found["by_attitude"] = float(mode(daemon) == "attitude")
            found["ticks_hz"] = RATE_HZ
            return found
        finally:
            flown.send_signal(signal.SIGTERM)
            flown.wait()


def height_m(daemon: DaemonProcess) -> float:
    position = daemon.vehicles()["alpha"]["position"] or {}
    return float(position.get("alt_rel_m") or 0.0)


def takes_control(daemon: DaemonProcess) -> bool:
    return bool(daemon.call("control.set", targets="alpha", mode="attitude")["outcomes"]["alpha"]["ok"])


def mode(daemon: DaemonProcess) -> str | None:
    control = daemon.vehicles()["alpha"]["control"] or {}
    found: str | None = control.get("control_mode")
    return found


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_a_companion_that_flies_by_attitude(firmware: str, tmp_path: Path) -> None:
    rows = {name: bare(code) for name, code in BARE.items()}
    rows["companion"] = companion(tmp_path, firmware)
    keep("companion", {firmware: rows}, beside=True)
    base = rows["interpreter"]
    for name, row in rows.items():
        print(
            f"\n{firmware:9s} {name:38s} {row['rss']:5.1f} MB resident ({row['rss'] / base['rss']:.2f}), "
            f"{row['own']:5.1f} own, {100 * row['core']:5.2f} % of a core"
        )
    assert rows["companion"]["by_attitude"]
