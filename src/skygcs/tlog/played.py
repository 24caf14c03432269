"""What of a recording may go out where live vehicles are: what its vehicles reported, never what they were ordered."""

from __future__ import annotations

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.source_statistics import RADIO_SOURCE
from skygcs.tlog.reading import LogEntry

GROUND_STATION_COMPIDS = frozenset({190})
"""MAV_COMP_ID_MISSIONPLANNER: ground stations relay under a vehicle's own system id with it."""

MAV_TYPE_GCS = 6

MOST_GROUND_STATIONS = 1024
"""Sources known as ground stations; with more all but autopilots are held back."""


class Told:
    """Knows the vehicles of a recording, by system and component, as they are found.

    A program that hears a recording over UDP cannot know that it is one, and a router may have live vehicles on other
    links. So a frame passes only if a SiK radio sent it, a vehicle's autopilot, or another component of its system that
    is no ground station; and only if it is not addressed to a vehicle's system. Of another component, what is addressed
    to all does not pass either: it may be an order.
    """

    def __init__(self) -> None:
        self.vehicles: set[tuple[int, int]] = set()
        """(sysid, compid) of their autopilots."""
        self._systems: set[int] = set()
        self._ground_stations: set[tuple[int, int]] = set()

    def passes(self, entry: LogEntry) -> bool:
        frame = entry.frame
        if frame is None:
            return False
        source = frame.sysid, frame.compid
        if discovers(frame):
            self.vehicles.add(source)
            self._systems.add(frame.sysid)
        elif _is_ground_station(frame) and len(self._ground_stations) < MOST_GROUND_STATIONS:
            self._ground_stations.add(source)
        if frame.info is None:
            return False  # whom it is addressed to cannot be told
        if source == RADIO_SOURCE:
            return True
        return frame.sysid in self._systems and self._reports(frame, source)

    def _reports(self, frame: Frame, source: tuple[int, int]) -> bool:
        system, _ = frame.target()
        if system in self._systems:
            return False
        if source in self.vehicles:
            return True
        if source in self._ground_stations or len(self._ground_stations) >= MOST_GROUND_STATIONS:
            return False
        addressed = frame.info is not None and frame.info.target_system_offset >= 0
        return frame.compid not in GROUND_STATION_COMPIDS and not (addressed and system == 0)


def _is_ground_station(frame: Frame) -> bool:
    return frame.msgid == HEARTBEAT and frame.info is not None and frame.fields().get("type") == MAV_TYPE_GCS
