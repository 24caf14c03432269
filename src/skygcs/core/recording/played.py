"""What of a recording may be sent out again: what its vehicles told, never what somebody ordered them."""

from __future__ import annotations

from skygcs.core.linkstats import RADIO_SOURCE
from skygcs.core.recording.reading import Entry
from skygcs.core.vehicle.discovery import discovers


class Told:
    """Knows the vehicles of a recording as they are found.

    A program that hears a recording over UDP cannot know that it is one, and a router may have live vehicles on other
    links. So a frame passes only if a vehicle's system sent it, or a SiK radio, and if it is not addressed to a
    vehicle's system: ground stations relay their orders under a vehicle's own system id, too (component 190).
    """

    def __init__(self) -> None:
        self.vehicles: set[int] = set()

    def passes(self, entry: Entry) -> bool:
        frame = entry.frame
        if frame is None:
            return False
        if discovers(frame):
            self.vehicles.add(frame.sysid)
        if frame.info is None:
            return False  # whom it is addressed to cannot be told
        if frame.sysid not in self.vehicles and (frame.sysid, frame.compid) != RADIO_SOURCE:
            return False
        return frame.target()[0] not in self.vehicles
