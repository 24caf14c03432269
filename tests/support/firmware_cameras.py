"""Motion capture in front of a real autopilot's simulator: cameras that see the simulator's own truth, and a vehicle
without GPS and compass that flies by what they see.

The truth is SIM_STATE of ArduCopter's SITL. The frame of the cameras is turned and shifted against the world. Its poses
go to a package `motioncapture` of our own, which the daemon's capture process imports as it would import the real one.
"""

from __future__ import annotations

import json
import math
import os
import random
import socket
import time
from pathlib import Path
from typing import Any

from pymavlink.quaternion import Quaternion

from support.firmware_field import HOME, PARAMS, Field
from support.process import free_port

BODY = "quad"
ROTATION_DEG = 25.0
OFFSET_M = (1.5, -0.5, 0.2)
"""The cameras' frame in the world: nothing of it is where the autopilot's own frame is."""

FRAMES_HZ = 100
NOISE_M = 0.0005
NOISE_RAD = 0.002
"""Of good cameras. The truth of a vehicle at rest is bit for bit the same, which no camera's is."""

SIM_STATE = 108
SET_MESSAGE_INTERVAL = 511

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

VISION_PARAMS = (
    "VISO_TYPE=1",
    "EK3_SRC1_POSXY=6",
    "EK3_SRC1_VELXY=0",
    "EK3_SRC1_POSZ=6",
    "EK3_SRC1_VELZ=0",
    "EK3_SRC1_YAW=6",
    "GPS1_TYPE=0",
    "SIM_GPS1_ENABLE=0",  # 4.7's name, SIM_GPS_DISABLE before: there is no receiver either
    "SIM_GPS_DISABLE=1",
    "FS_OPTIONS=0",  # copter.parm has it go on without a ground station, which preflight refuses
    "COMPASS_USE=0",
    "COMPASS_USE2=0",
    "COMPASS_USE3=0",
)


class Cameras:
    """`see` takes what the relay hears. ``hidden``: the body is in no frame; ``enu_m``: where it truly is."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to = ("127.0.0.1", port)
        self._random = random.Random(1)
        self.hidden = False
        self.enu_m = (math.nan, math.nan, math.nan)
        self.track: list[tuple[float, tuple[float, float, float]]] = []
        """Time (monotonic) and place of every frame."""

    def close(self) -> None:
        self._socket.close()

    def see(self, sysid: int, message: Any, now: float) -> None:
        """A message of the vehicle."""
        if message.get_type() != "SIM_STATE":
            return
        east = (message.lon_int / 1e7 - HOME[1]) * math.cos(math.radians(HOME[0])) * 111_319.5
        north = (message.lat_int / 1e7 - HOME[0]) * 111_132.0
        self.enu_m = (east, north, message.alt - HOME[2])
        self.track.append((now, self.enu_m))
        frame = {} if self.hidden else {BODY: self._pose(message.roll, message.pitch, message.yaw)}
        self._socket.sendto(json.dumps(frame).encode(), self._to)

    def _pose(self, roll: float, pitch: float, yaw: float) -> list[float]:
        """Place and quaternion in the frame of the cameras, body axes forward, left, up."""
        turned = math.radians(ROTATION_DEG)
        x, y, z = (at - offset for at, offset in zip(self.enu_m, OFFSET_M, strict=True))
        noise = self._random.gauss
        place = [
            math.cos(turned) * x + math.sin(turned) * y,
            -math.sin(turned) * x + math.cos(turned) * y,
            z,
        ]
        angles = (roll, -pitch, math.pi / 2 - yaw - turned)
        q = Quaternion([angle + noise(0.0, NOISE_RAD) for angle in angles]).q
        return [value + noise(0.0, NOISE_M) for value in place] + [float(value) for value in q]

    def since(self, at: float) -> list[tuple[float, float, float]]:
        """Places since then."""
        return [place for when, place in list(self.track) if when >= at]


class CapturedField(Field):
    """One ArduCopter without GPS and compass, filmed; it looks east-north-east."""

    heading_deg = 60.0

    def __init__(self, folder: Path) -> None:
        super().__init__("ardupilot", folder)
        self.sysids, self.names = self.sysids[:1], self.names[:1]
        self.capture_port = free_port()
        self.cameras = Cameras(self.capture_port)
        self.relay.watch = self.cameras.see
        head = self.daemon.file.read_text().partition("\nrecord_max_mb")[0]
        self.daemon.file.write_text(f"{head}\n{self.captured_toml()}")
        (folder / "package").mkdir()
        (folder / "package" / "motioncapture.py").write_text(PACKAGE)

    def captured_toml(self) -> str:
        return f"""
[origin]
lat_deg = {HOME[0]}
lon_deg = {HOME[1]}
alt_amsl_m = {HOME[2]}

[links.vehicles]
type = "udp_server"
host = "127.0.0.1"
port = {self.daemon_port}
role = "vehicle"

[links.gcs]
type = "udp_server"
host = "127.0.0.1"
port = {self.gcs_port}
role = "gcs"

[mocap]
type = "qualisys"
host = "127.0.0.1"
port = {self.capture_port}
bodies = {{ {self.one} = "{BODY}" }}
rotation_deg = {ROTATION_DEG}
offset_m = {list(OFFSET_M)}

[vehicles.{self.one}]
sysid = {self.sysids[0]}
autopilot = "ardupilot"
"""

    def kinds(self) -> list[str]:
        return ["--ardupilot", "1"]

    def params(self) -> list[str]:
        return [*PARAMS["ardupilot"], *VISION_PARAMS]

    def start(self) -> None:
        """Until the cameras film it; it has no place on earth by then."""
        self.relay.start()
        self.launch()
        before = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(self.folder / "package"), before)))
        try:
            self.daemon.start()
        finally:
            if before is None:
                del os.environ["PYTHONPATH"]
            else:
                os.environ["PYTHONPATH"] = before
        self.watcher.start()
        self.wait(lambda: self.daemon.known() == 1 and self.connected(), 60, "the daemon knows it")
        with self.ground_station() as station:
            self.wait(lambda: self._filmed(station), 60, "its simulator sends the truth")

    def _filmed(self, station: Any) -> bool:
        if len(self.cameras.track) > FRAMES_HZ:
            return True
        station.mav.heartbeat_send(6, 8, 0, 0, 4)
        period_us = 1e6 / FRAMES_HZ
        station.mav.command_long_send(self.sysids[0], 1, SET_MESSAGE_INTERVAL, 0, SIM_STATE, period_us, 0, 0, 0, 0, 0)
        time.sleep(0.5)
        return False

    def stop(self) -> None:
        super().stop()
        self.cameras.close()

    def poses(self) -> dict[str, Any]:
        """Of `mocap.status`, of the vehicle."""
        (status,) = self.daemon.call("mocap.status")["vehicles"]
        assert isinstance(status, dict)
        return status
