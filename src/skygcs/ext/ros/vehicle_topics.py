"""The topics of one vehicle: MAVLink messages in, ROS messages out, as far as somebody reads them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skygcs.core.ros.condition import disconnected, log_entry
from skygcs.core.ros.memory import FrameNames, Sample, VehicleMemory
from skygcs.core.ros.ros_names import ros_name, vehicle_root
from skygcs.core.ros.shared_topics import mavlink_frames, pose_transform
from skygcs.core.ros.topics import SOURCES, TELEMETRY, samples
from skygcs.ext.ros.config import RosConfig
from skygcs.ext.ros.graph import SharedTopics
from skygcs.ext.ros.px4_topics import Px4Topics


class VehicleTopics:
    """Topics of one vehicle, from its discovery to the end of the process. ``state``: as the daemon sent it last."""

    def __init__(self, shared: SharedTopics, config: RosConfig, state: Mapping[str, Any], now_ns: int) -> None:
        """Raises ValueError for a name that ROS does not take."""
        self.name: str = state["name"]
        self.sysid: int = state["sysid"]
        self.state = state
        self.connected = False
        self.root = vehicle_root(config.root, self.name, self.sysid)
        self.mavros = f"{self.root}/mavros"
        prefix = config.frame_prefix.format(name=ros_name(self.name), sysid=self.sysid)
        self.memory = VehicleMemory(FrameNames(f"{prefix}map", f"{prefix}base_link"), config.geoid_m)
        self.publications = {
            topic: shared.node.publish(f"{self.mavros}/{topic}", made.type, made.quality)
            for topic, made in TELEMETRY.items()
        }
        self.shown_mode = ""
        """Mode that the topic state shows; "": the autopilot's own."""
        self.px4: Px4Topics | None = None
        """PX4's own topics, once it is known to be a PX4 and if they are wanted."""
        self._shared = shared
        self._logger = self.mavros.strip("/").replace("/", ".")
        self._sends_tf = bool(prefix)
        self._publish(disconnected(now_ns))
        if self._sends_tf:
            shared.fix_transforms(*mavlink_frames(self.memory.frames, now_ns))

    def on_message(self, name: str, fields: Mapping[str, Any], arrival_ns: int) -> None:
        """One MAVLink message of its autopilot, or of the radio. Raises InterfaceError, KeyError, TypeError or
        ValueError for fields that are not those of the message in the common dialect."""
        for sample in samples(name, fields, arrival_ns, self.memory):
            self._publish(sample)
        if name == "HEARTBEAT":
            self.connected = True
        elif name == "STATUSTEXT":
            self.log(fields["severity"], f"FCU: {fields['text']}", arrival_ns)
        if self.px4 is not None:
            self.px4.on_message(name, fields, arrival_ns, self.shown_mode)

    def log(self, severity: int, text: str, now_ns: int) -> None:
        """A message of the vehicle's on /rosout; ``severity``: a MAV_SEVERITY."""
        self._shared.log(log_entry(self._logger, severity, text, now_ns))

    def on_lost(self, now_ns: int) -> None:
        """Take note that the vehicle is not heard any more."""
        if self.connected:
            self.connected = False
            self.memory = self.memory.after_loss()
            self._publish(disconnected(now_ns))
            if self.px4 is not None:
                self.px4.on_lost()

    def wanted_messages(self) -> set[str]:
        """MAVLink messages of which somebody reads a topic now."""
        read = {topic for topic, publication in self.publications.items() if publication.readers}
        if self._sends_tf and self._shared.transforms_wanted:
            read.add("local_position/pose")
        wanted = {name for name, source in SOURCES.items() if not read.isdisjoint(source.topics)}
        return wanted if self.px4 is None else wanted | self.px4.wanted_messages()

    def _publish(self, sample: Sample) -> None:
        publication = self.publications[sample.topic]
        if sample.topic == "state" and self.shown_mode and sample.fields.get("connected"):
            sample.fields["mode"] = self.shown_mode
        if publication.wanted:
            publication.write(sample.fields)
        if self._sends_tf and sample.topic == "local_position/pose":
            self._shared.transform(pose_transform(sample.fields, self.memory.frames.base_link))
