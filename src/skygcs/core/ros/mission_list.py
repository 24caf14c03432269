"""mission/waypoints of one vehicle: the list that was pulled, pushed or cleared last, and the item that is flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Fields = Mapping[str, Any]


class MissionList:
    """A message of the topic when MAVROS publishes one: the list is another, or another item is current
    (handle_mission_ack, handle_mission_item_int and handle_mission_current of its mission_protocol_base.cpp). Before
    the first list there is none: an empty one would say that the vehicle has no mission."""

    def __init__(self) -> None:
        self._waypoints: list[Fields] | None = None
        self._current_seq = 0

    def replaced(self, waypoints: Sequence[Fields]) -> dict[str, Any]:
        """The list that the vehicle has now: mavros_msgs' WaypointList, its items as they were given."""
        self._waypoints = list(waypoints)
        return {"current_seq": self._current_seq, "waypoints": self._waypoints}

    def on_current(self, seq: int | None) -> dict[str, Any] | None:
        """MISSION_CURRENT.seq of the vehicle, None if it has sent none. What is published: None if no list is known, or
        the item is no other than before."""
        if seq is None or seq == self._current_seq:
            return None
        self._current_seq = seq
        if self._waypoints is None:
            return None
        return self.replaced([{**item, "is_current": n == seq} for n, item in enumerate(self._waypoints)])
