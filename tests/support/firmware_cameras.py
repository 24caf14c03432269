"""Motion capture in front of a real autopilot's simulator: cameras that see the simulator's own truth, and a vehicle
without GPS and compass that flies by what they see.

The truth is SIM_STATE of ArduCopter's SITL and HIL_STATE_QUATERNION of PX4's SIH. The frame of the cameras is turned
and shifted against the world. Its poses go to a package `motioncapture` of our own, which the daemon's capture process
imports as it would import the real one.
"""

from __future__ import annotations

import json
import math
import os
import random
import socket
import subprocess
from pathlib import Path
from typing import Any

from pymavlink.quaternion import Quaternion

from support.firmware_field import HOME, PARAMS, Field
from support.hanging import HANG_S
from support.process import free_port

BODY = "quad"
ROTATION_DEG = 25.0
OFFSET_M = (1.5, -0.5, 0.2)
"""The cameras' frame in the world: nothing of it is where the autopilot's own frame is."""

FRAMES_HZ = 100
NOISE_M = 0.0005
NOISE_RAD = 0.002
"""Of good cameras. The truth of a vehicle at rest is bit for bit the same, which no camera's is."""

TRUTH = {"px4": "HIL_STATE_QUATERNION", "ardupilot": "SIM_STATE"}

PACKAGE = """
import json, socket
class _Rotation:
    def __init__(self, q): self.w, self.x, self.y, self.z = q
class _Body:
    def __init__(self, pose): self.position, self.rotation = pose[:3], _Rotation(pose[3:])
class _System:
    def __init__(self, port):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self.rigidBodies = {}
    def waitForNextFrame(self):
        self.rigidBodies = {name: _Body(pose) for name, pose in json.loads(self._socket.recv(65536)).items()}
def connect(kind, config):
    return _System(int(config["port"]))
"""

INDOORS = {
    "px4": ("SENS_EN_GPSSIM=0", "SYS_HAS_GPS=0", "SENS_EN_MAGSIM=0", "SYS_HAS_MAG=0", "EKF2_MAG_TYPE=5"),
    "ardupilot": (
        "SIM_GPS1_ENABLE=0",  # 4.7's name, SIM_GPS_DISABLE before: there is no receiver
        "SIM_GPS_DISABLE=1",
        "FS_OPTIONS=0",  # copter.parm has it go on without a ground station, which preflight refuses
        "EK3_SRC1_POSZ=6",  # a barometer's height is allowed as well
        "COMPASS_USE=0",
        "COMPASS_USE2=0",
        "COMPASS_USE3=0",
    ),
}
"""No receiver and no magnetometer. What a vehicle needs beyond that to fly by poses, preflight sets."""


ORIGIN_ALT_AMSL_M = {"px4": 0.0, "ardupilot": HOME[2]}
"""A PX4 takes the height of a pose for an altitude when it takes poses again: its origin has to be at 0. With 0 an
ArduCopter, whose barometer is at 180 m, had its height wrong by 1.3 m, and by 2.7 m after the first flight."""


class Cameras:
    """`see` takes what the relay hears. ``hidden``: the body is in no frame; ``enu_m`` and ``heading_deg``: where it
    truly is, and where it looks."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to = ("127.0.0.1", port)
        self._random = random.Random(1)
        self.hidden = False
        self.enu_m = (math.nan, math.nan, math.nan)
        self.heading_deg = math.nan
        self.track: list[tuple[float, tuple[float, float, float]]] = []
        """Time (monotonic) and place of every frame."""

    def close(self) -> None:
        self._socket.close()

    def see(self, sysid: int, message: Any, now: float) -> None:
        """A message of the vehicle."""
        kind = message.get_type()
        if kind == "SIM_STATE":
            lat_deg, lon_deg, alt_amsl_m = message.lat_int / 1e7, message.lon_int / 1e7, message.alt
            roll, pitch, yaw = message.roll, message.pitch, message.yaw
        elif kind == "HIL_STATE_QUATERNION":
            lat_deg, lon_deg, alt_amsl_m = message.lat / 1e7, message.lon / 1e7, message.alt / 1000
            roll, pitch, yaw = Quaternion(message.attitude_quaternion).euler
        else:
            return
        east = (lon_deg - HOME[1]) * math.cos(math.radians(HOME[0])) * 111_319.5
        north = (lat_deg - HOME[0]) * 111_132.0
        self.enu_m = (east, north, alt_amsl_m - HOME[2])
        self.heading_deg = math.degrees(yaw) % 360
        self.track.append((now, self.enu_m))
        frame = {} if self.hidden else {BODY: self._pose(roll, pitch, yaw)}
        self._socket.sendto(json.dumps(frame).encode(), self._to)

    def _pose(self, roll: float, pitch: float, yaw: float) -> list[float]:
        """Place and quaternion in the frame of the cameras, body axes forward, left, up."""
        turned = math.radians(ROTATION_DEG)
        x, y, z = (at - offset for at, offset in zip(self.enu_m, OFFSET_M, strict=True))
        noise = self._random.gauss
        place = [math.cos(turned) * x + math.sin(turned) * y, -math.sin(turned) * x + math.cos(turned) * y, z]
        angles = (roll, -pitch, math.pi / 2 - yaw - turned)
        q = Quaternion([angle + noise(0.0, NOISE_RAD) for angle in angles]).q
        return [value + noise(0.0, NOISE_M) for value in place] + [float(value) for value in q]

    def since(self, at: float) -> list[tuple[float, float, float]]:
        """Places since then."""
        return [place for when, place in list(self.track) if when >= at]


class CapturedField(Field):
    """One vehicle without GPS and compass, filmed. An ArduCopter looks east-north-east at first, a PX4 north."""

    heading_deg = 60.0

    def __init__(self, firmware: str, folder: Path) -> None:
        super().__init__(firmware, folder)
        self.sysids, self.names = self.sysids[:1], self.names[:1]
        self.capture_port = free_port()
        self.cameras = Cameras(self.capture_port)
        self.relay.watch = self.cameras.see
        self._head = self.daemon.file.read_text().partition("\nrecord_max_mb")[0]
        self.daemon.file.write_text(f"{self._head}\n{self.captured_toml('vision_position_estimate')}")
        (folder / "package").mkdir()
        (folder / "package" / "motioncapture.py").write_text(PACKAGE)

    def captured_toml(self, message: str) -> str:
        return f"""
[origin]
lat_deg = {HOME[0]}
lon_deg = {HOME[1]}
alt_amsl_m = {ORIGIN_ALT_AMSL_M[self.firmware]}

[links.vehicles]
type = "udp_server"
host = "127.0.0.1"
port = {self.daemon_port}
role = "vehicle"

[mocap]
type = "qualisys"
host = "127.0.0.1"
port = {self.capture_port}
bodies = {{ {self.one} = "{BODY}" }}
rotation_deg = {ROTATION_DEG}
offset_m = {list(OFFSET_M)}
message = "{message}"

[vehicles.{self.one}]
sysid = {self.sysids[0]}
autopilot = "{self.firmware}"
"""

    def kinds(self) -> list[str]:
        return [f"--{self.firmware}", "1"]

    def params(self) -> list[str]:
        return [*PARAMS[self.firmware], *INDOORS[self.firmware]]

    def start(self) -> None:
        """Until the cameras film it; it has no place on earth by then."""
        self.relay.start()
        self.launch()
        self._start_daemon()
        self.watcher.start()
        self.wait(lambda: self.daemon.known() == 1 and self.connected(), 60, "the daemon knows it")
        self.film()

    def film(self) -> None:
        """Until the simulator streams the truth. The daemon requests it: the stream of a program that is gone would be
        set back to its rate of before."""
        began = len(self.cameras.track)
        message = TRUTH[self.firmware]

        def filmed() -> bool:
            if len(self.cameras.track) - began > FRAMES_HZ:
                return True
            if len(self.cameras.track) == began:
                self.daemon.call("vehicles.interval", targets=self.one, message=message, rate_hz=FRAMES_HZ)
            return False

        self.wait(filmed, 60, "its simulator sends the truth")

    def power_cut(self) -> None:
        """Its firmware begins again, with the parameters that it has."""
        self.relaunch()
        self.film()

    def send_as(self, message: str) -> None:
        """Start the daemon again, with this as the message of poses."""
        self.daemon.stop()
        self.daemon.file.write_text(f"{self._head}\n{self.captured_toml(message)}")
        self._start_daemon()
        self.wait(lambda: self.daemon.known() == 1 and self.connected(), 60, "the daemon knows it")
        self.film()

    def _start_daemon(self) -> None:
        before = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(self.folder / "package"), before)))
        try:
            self.daemon.start()
        finally:
            if before is None:
                del os.environ["PYTHONPATH"]
            else:
                os.environ["PYTHONPATH"] = before

    def stop(self) -> None:
        super().stop()
        self.cameras.close()

    def status(self) -> dict[str, Any]:
        """Of `mocap.status`."""
        status = self.daemon.call("mocap.status")
        assert isinstance(status, dict)
        return status

    def poses(self) -> dict[str, Any]:
        """Of `mocap.status`, of the vehicle."""
        (poses,) = self.status()["vehicles"]
        assert isinstance(poses, dict)
        return poses

    def listened(self, topic: str) -> str:
        """What a PX4 publishes on a topic, as its own shell shows it."""
        assert self.px4
        (pid,) = self.firmware_pids()
        words = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
        command = [str(Path(words[0]).parent / "px4-listener"), "--instance", words[words.index("-i") + 1], topic]
        return subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, check=True).stdout
