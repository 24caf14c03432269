"""A master of ROS 1, and nodes of rospy under the system's Python."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from pathlib import Path

from support.process import wait_until

PYTHON = "/usr/bin/python3"
NODE = Path(__file__).with_name("offboard_rospy.py")

FLIGHT_S = 600
"""A flight takes half a minute; the machine may be slow."""


class Master:
    """A master of ROS 1 on a port of its own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri = f"http://127.0.0.1:{self.port}"
        self.folder = folder
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "ROS_"))},
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_LOG_DIR": str(folder),
        }
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        line = ["rosmaster", "--core", "-p", str(self.port)]
        self._process = subprocess.Popen(
            line, env=self.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        wait_until(lambda: self.ran("rostopic", "list").returncode == 0, "the master answers")

    def stop(self) -> None:
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    def ran(self, *line: str, given: str | None = None) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            line, env=self.environment, input=given, capture_output=True, text=True, timeout=FLIGHT_S, check=False
        )

    def node(self, *words: str, given: str | None = None) -> subprocess.CompletedProcess[str]:
        return self.ran(PYTHON, str(NODE), *words, given=given)
