"""PX4's own topics of one vehicle, under fmu/out: MAVLink messages in, px4_msgs out, as far as somebody reads them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skygcs.core.ros.interfaces import Interfaces
from skygcs.core.ros.memory import Sample
from skygcs.core.ros.px4_telemetry import (
    OFFBOARD_STATE,
    PX4_SOURCES,
    PX4_TELEMETRY,
    Px4Memory,
    px4_samples,
    versioned,
)
from skygcs.ext.ros.graph import Node


class Px4Topics:
    """Telemetry of one PX4, from its discovery on."""

    def __init__(self, node: Node, known: Interfaces, root: str, sysid: int) -> None:
        self.memory = Px4Memory(sysid)
        self._known = known
        self.publications = {
            topic: node.publish(f"{root}/fmu/out/{versioned(known, topic, type_)}", type_, "px4")
            for topic, type_ in PX4_TELEMETRY.items()
        }

    def on_message(self, name: str, fields: Mapping[str, Any], arrival_ns: int, shown_mode: str) -> None:
        """One MAVLink message. ``shown_mode``: what nodes are shown in place of the autopilot's mode, or "". Raises
        InterfaceError, KeyError, TypeError or ValueError for fields that are not those of the message."""
        for sample in px4_samples(name, fields, arrival_ns, self.memory):
            if sample.topic == "vehicle_status" and shown_mode == "OFFBOARD":
                sample.fields["nav_state"] = sample.fields["nav_state_user_intention"] = OFFBOARD_STATE
            self._publish(sample)

    def on_lost(self) -> None:
        """Take note that the vehicle is not heard any more."""
        self.memory = self.memory.after_loss()

    def wanted_messages(self) -> set[str]:
        """MAVLink messages of which somebody reads a topic now."""
        read = {topic for topic, publication in self.publications.items() if publication.readers}
        return {name for name, source in PX4_SOURCES.items() if not read.isdisjoint(source.topics)}

    def _publish(self, sample: Sample) -> None:
        publication = self.publications[sample.topic]
        if publication.wanted:
            publication.write(self._known.only_known(PX4_TELEMETRY[sample.topic], sample.fields))
