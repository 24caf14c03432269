"""ROS in the daemon: its process, from the daemon's start to its end, and what that reports (ros.status)."""

from __future__ import annotations

import asyncio
import os
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from skygcs.config.tables import Problem
from skygcs.ext.ros.config import RosConfig, ros_problems
from skygcs.ext.ros.methods import METHODS, RosReport
from skygcs.process_extension import ProcessExtension
from skygcs.runtime.supervised_child import SupervisedChild

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.rpc.context import Services

MODULES = {1: ("rosbags",), 2: ("cyclonedds", "rosbags")}
"""By the version of ROS."""


class Ros(ProcessExtension[RosConfig]):
    """Keeps the process of ROS running, and has its last report."""

    Config = RosConfig
    own_methods = METHODS

    def __init__(self, core: Services, config: RosConfig) -> None:
        super().__init__(core, config)
        self.child = SupervisedChild(
            "ROS",
            "ros",
            ["--supervised", "--socket", os.fspath(core.socket_path), "--config", config.model_dump_json()],
            asyncio.get_running_loop(),
            core.event_log.publish,
            command=[sys.executable, "-m", "skygcs.ext.ros"],
        )
        self.report: RosReport | None = None
        """The last one of the process."""
        self.reported_at = 0.0

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return ros_problems(config, fleet)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        missing = [name for name in MODULES[config.version] if find_spec(name) is None]
        return [f"{' and '.join(missing)} not installed here: pip install 'skygcs[ros]'"] if missing else []

    def announcement(self) -> str:
        allowed = {"none": "topics only", "setpoints": "topics and setpoints", "all": "topics, setpoints and services"}
        return f"{allowed[self.config.commands]}, {self.config.network} (skygcs-cli ros status)"

    def take(self, report: RosReport) -> None:
        """A report of the process."""
        self.report, self.reported_at = report, self.core.now()
