"""The Fast DDS program of the tests: built from IDL of the same table, once for each change, into build/ros."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

from ros.idl import idl
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.px4_setpoints import ACK_TYPE, PX4_INPUTS
from skygcs.core.ros.px4_telemetry import PX4_TELEMETRY

BUILD = Path(__file__).parents[2] / "build" / "ros"
SOURCE = Path(__file__).with_name("offboard_node.cpp")

TYPES = (
    "mavros_msgs/msg/State",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/BatteryState",
    "geometry_msgs/msg/PoseStamped",
    *PX4_TELEMETRY.values(),
    *PX4_INPUTS.values(),
    ACK_TYPE,
)
SERVICES = ("mavros_msgs/srv/CommandBool", "mavros_msgs/srv/SetMode")


def built() -> Path:
    """The program. Raises CalledProcessError with what the compiler said."""
    text = idl(ros2_interfaces(), TYPES, SERVICES)
    stamp = hashlib.sha256((text + SOURCE.read_text()).encode()).hexdigest()[:16]
    folder = BUILD / stamp
    program = folder / "offboard_node"
    if program.exists():
        return program
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "types.idl").write_text(text)
    _run(folder, "fastddsgen", "-replace", "types.idl")
    sources = sorted(path.name for path in folder.glob("types*.cxx") if "Main" not in path.name)
    line = [
        "g++",
        "-std=c++17",
        "-O0",
        "-I.",
        "-o",
        "part",
        str(SOURCE),
        *sources,
        "-lfastrtps",
        "-lfastcdr",
        "-lpthread",
    ]
    _run(folder, *line)
    (folder / "part").rename(program)
    return program


def _run(folder: Path, *line: str) -> None:
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, line, done.stdout, done.stderr[-4000:])
