"""The Fast DDS programs of the tests: built from IDL of the same table, once for each change, into build/ros."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

from ros.idl import idl
from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.order_progress import ACTIONS
from skygcs.core.ros.px4_setpoints import ACK_TYPE, PX4_INPUTS
from skygcs.core.ros.px4_telemetry import PX4_TELEMETRY

BUILD = Path(__file__).parents[2] / "build" / "ros"
HERE = Path(__file__).parent

COMPILER = ("g++", "-std=c++17", "-O0")

TYPES = (
    "mavros_msgs/msg/State",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "sensor_msgs/msg/BatteryState",
    "geometry_msgs/msg/PoseStamped",
    *PX4_TELEMETRY.values(),
    *PX4_INPUTS.values(),
    ACK_TYPE,
    "skygcs_msgs/msg/Fleet",
    "skygcs_msgs/msg/Event",
    "action_msgs/msg/GoalStatusArray",
    *(f"{action}_FeedbackMessage" for action in ACTIONS.values()),
)
SERVICES = (
    "mavros_msgs/srv/CommandBool",
    "mavros_msgs/srv/SetMode",
    "action_msgs/srv/CancelGoal",
    *(f"{action}_{part}" for action in ACTIONS.values() for part in ("SendGoal", "GetResult")),
)


def built(name: str) -> Path:
    """A program by its name. Raises CalledProcessError with what the compiler said."""
    text = idl(ros2_interfaces(), TYPES, SERVICES)
    source = HERE / f"{name}.cpp"
    written = "".join(path.read_text() for path in (source, HERE / "dds_node.hpp"))
    types = _types(text)
    program = types.parent / f"{name}_{_digest(written)}"
    if not program.exists():
        libraries = ("-lfastrtps", "-lfastcdr", "-lpthread")
        _run(types.parent, *COMPILER, "-I.", f"-I{HERE}", "-o", "part", str(source), types.name, *libraries)
        (types.parent / "part").rename(program)
    return program


def built_alone(name: str) -> Path:
    """A program that makes its types when it runs. Raises CalledProcessError with what the compiler said."""
    source = HERE / f"{name}.cpp"
    program = BUILD / f"{name}_{_digest(source.read_text())}"
    if not program.exists():
        BUILD.mkdir(parents=True, exist_ok=True)
        part = BUILD / f"{name}.part"
        _run(BUILD, *COMPILER, "-o", part.name, str(source), "-lfastrtps", "-lfastcdr", "-lpthread")
        part.rename(program)
    return program


def _types(text: str) -> Path:
    """The types of an IDL text as an archive: they take a minute, and serve every program."""
    folder = BUILD / _digest(text)
    archive = folder / "types.a"
    if not archive.exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "types.idl").write_text(text)
        _run(folder, "fastddsgen", "-replace", "types.idl")
        sources = sorted(path.name for path in folder.glob("types*.cxx") if "Main" not in path.name)
        _run(folder, *COMPILER, "-I.", "-c", *sources)
        _run(folder, "ar", "rcs", "part.a", *(str(Path(name).with_suffix(".o")) for name in sources))
        (folder / "part.a").rename(archive)
    return archive


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _run(folder: Path, *line: str) -> None:
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, line, done.stdout, done.stderr[-4000:])
