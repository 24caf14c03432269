"""mission/waypoints of one vehicle: the list that was pulled, pushed or cleared last, and the item that is flown. Pure.

The numbers are the wire's: the first waypoint has 0, which is home in the lists of an ArduPilot.

    event                                              next
    ------------------------------------------------   ---------------------------------------------------------
    a node has pulled, pushed or cleared the list      it is known; published at once
    another item is current                            published, at most once in LIST_S, while somebody reads
    a transfer ends that is not a node's own           not known: nothing is published until the next pull or push
    the vehicle reports another number of items        the same
    it reboots, or the connection to the daemon ends   the same
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

Fields = Mapping[str, Any]

LIST_S = 1.0
"""From one list to the next that has another current item alone. One of 2000 waypoints is 96 kB and takes 21 ms."""

OWN_S = 1.0
"""A MISSION_ACK that comes so soon after a node's own transfer is one of it, sent again."""

MISSION_TYPES = frozenset({0, 255})
"""MAV_MISSION_TYPE of a MISSION_ACK that is about the mission: MISSION, ALL."""


class MissionList:
    """A message of the topic when MAVROS publishes one: the list is another, or another item is current
    (handle_mission_ack, handle_mission_item_int and handle_mission_current of its mission_protocol_base.cpp). Before
    the first list nothing is published: an empty one would say that the vehicle has no mission."""

    def __init__(self) -> None:
        self.third_party_transfers = 0
        """Number of transfers that ended and were no node's own."""
        self._waypoints: list[Fields] | None = None
        self._lengths: frozenset[int] = frozenset()
        """Numbers of items that the vehicle may report for it."""
        self._current_seq = 0
        self._count: int | None = None
        self._own_until = -math.inf
        """A MISSION_ACK until then is of a node's own transfer."""
        self._own_acks = 0
        self._is_due = False
        self._published_at = -math.inf

    def replaced(self, waypoints: Sequence[Fields], home_first: bool, now: float) -> dict[str, Any]:
        """The list that the vehicle has now: mavros_msgs' WaypointList, its items as they were given. ``home_first``:
        the first of them is home, which some firmwares count as an item and some do not."""
        self._waypoints = list(waypoints)
        self._lengths = frozenset({len(waypoints), max(len(waypoints) - home_first, 0)})
        self._is_due, self._published_at = False, now
        return {"current_seq": self._current_seq, "waypoints": self._waypoints}

    def forget(self) -> None:
        """It is not known any more which list the vehicle has."""
        self._waypoints, self._is_due = None, False

    def own_begins(self) -> None:
        """A node's own transfer begins: what ends while it goes on is it."""
        self._own_until, self._own_acks = math.inf, 0

    def own_ended(self, ok: bool, was_sent: bool, now: float) -> None:
        """It has ended. ``was_sent``: something of it was sent to the vehicle; after one that failed then, it is not
        known which mission the vehicle has."""
        self._own_until = now + OWN_S if ok else -math.inf
        if not ok and (was_sent or self._own_acks):
            self.forget()

    def on_transfer_ended(self, mission_type: int, at: float) -> None:
        """A MISSION_ACK of the vehicle to any station: an upload or a clear has ended, well or not."""
        if mission_type not in MISSION_TYPES:
            return
        if at <= self._own_until:
            self._own_acks += 1
            return
        self.third_party_transfers += 1
        self.forget()

    def on_state(self, mission: Fields | None) -> None:
        """A vehicle's state: ``seq`` is the current item, ``count`` the number of items, None if it is not known. A
        number that stays as it was before the list is older than the list."""
        seq, count = (None, None) if mission is None else (mission.get("seq"), mission.get("count"))
        if seq is not None and seq != self._current_seq:
            self._current_seq, self._is_due = seq, self._waypoints is not None
        if count != self._count:
            self._count = count
            if count is not None and count not in self._lengths:
                self.forget()

    def due(self, has_readers: bool, now: float) -> dict[str, Any] | None:
        """Return what is to be published now because another item is current; None: nothing."""
        if not (self._is_due and has_readers) or self._waypoints is None or now - self._published_at < LIST_S:
            return None
        seq = self._current_seq
        self._waypoints = [{**item, "is_current": n == seq} for n, item in enumerate(self._waypoints)]
        self._is_due, self._published_at = False, now
        return {"current_seq": seq, "waypoints": self._waypoints}
