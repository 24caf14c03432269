"""Which entries of a log are wanted, and which may be sent where live vehicles are."""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import discovers
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.source_statistics import RADIO_SOURCE
from skygcs.tlog.format import LogEntry

SourceFilter = tuple[int, int | None]
"""System and component; None: any component."""


GROUND_STATION_COMPIDS = frozenset({190})
"""MAV_COMP_ID_MISSIONPLANNER: ground stations relay under a vehicle's own system id with it."""

MAV_TYPE_GCS = 6

MOST_GROUND_STATIONS = 1024
"""Ground stations that are remembered; with more, only autopilots pass."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The entries that a tool takes: those that match everything that is set.

    ``begin``, ``end``: seconds from the beginning (float) or microseconds since 1970 (int), both included.
    ``addressed``: frames addressed to one of the ``sources`` match as well. An entry with a wrong CRC matches if no
    sources and no messages are set; one with an unknown id is judged by its header.
    """

    begin: float | int | None = None
    end: float | int | None = None
    sources: frozenset[SourceFilter] = frozenset()
    messages: frozenset[int] = frozenset()
    without: frozenset[int] = frozenset()
    addressed: bool = False

    @property
    def absolute(self) -> bool:
        """True if a time of day is set, which a raw capture does not have."""
        return isinstance(self.begin, int) or isinstance(self.end, int)

    @property
    def timed(self) -> bool:
        return self.begin is not None or self.end is not None

    def takes(self, entry: LogEntry) -> bool:
        return self.in_time(entry) and self.takes_frame(entry)

    def in_time(self, entry: LogEntry) -> bool:
        """False for entries without a time of day if one is set."""
        begin, end = self.begin, self.end
        if begin is not None:
            time = entry.dated_us if isinstance(begin, int) else entry.at_s
            if time is None or time < begin:
                return False
        if end is not None:
            time = entry.dated_us if isinstance(end, int) else entry.at_s
            if time is None or time > end:
                return False
        return True

    def takes_frame(self, entry: LogEntry) -> bool:
        frame = entry.frame
        if frame is None:
            return not (self.sources or self.messages)
        if frame.msgid in self.without or (self.messages and frame.msgid not in self.messages):
            return False
        if not self.sources or self.has(frame.sysid, frame.compid):
            return True
        system, component = frame.target() if self.addressed else (0, 0)
        return bool(system) and any(s == system and c in (None, 0, component) for s, c in self.sources)

    def has(self, sysid: int, compid: int) -> bool:
        """True if this source matches; all do if none is set."""
        return not self.sources or (sysid, None) in self.sources or (sysid, compid) in self.sources


class ReportFilter:
    """Passes what the vehicles of a recording reported, never what they were ordered.

    A program that receives a recording over UDP cannot see that it is one, and a router may have live vehicles on other
    links. So a frame passes only if a SiK radio sent it, a vehicle's autopilot, or another component of its system that
    is not a ground station; and only if it is not addressed to a vehicle's system. A frame of another component that is
    addressed to all does not pass either: it may be an order.
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
            return False  # its target is not known
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
