"""One vehicle's files at a time over one radio.

A BurstReadFile is one frame up and a whole file down, as fast as the vehicle sees fit. Stations that know ArduPilot's
@PARAM/param.pck, or PX4's component metadata, begin so with every vehicle they meet.
"""

from __future__ import annotations

from skygcs.core.radio_link.admission_frames import ThirdPartyFrame

QUIET_S = 3.0
"""A transfer of which nothing went up or came down for so long is over: stations repeat a request after a second."""

LONGEST_S = 300.0
"""After so long somebody else's request takes the turn: a large file is no reason to keep everybody waiting."""

_OPCODE_AT = 6
"""In the payload of a FILE_TRANSFER_PROTOCOL: target network, system, component, then the FTP header's seq_number (2),
session and opcode."""

TERMINATE_SESSION, RESET_SESSIONS = 1, 2


class FileTurns:
    """`may` for each FILE_TRANSFER_PROTOCOL that is to go up, `heard` for each that comes down. Nothing waits here: who
    is told to wait repeats the request, or asks for the parameters in another way."""

    __slots__ = ("_at", "_since", "_system")

    def __init__(self) -> None:
        self._system: int | None = None
        self._since = 0.0
        self._at = 0.0

    def may(self, frame: ThirdPartyFrame, now: float) -> bool:
        """Whether it may go now. What ends a transfer always may."""
        opcode = frame.payload[_OPCODE_AT] if len(frame.payload) > _OPCODE_AT else 0
        if opcode in (TERMINATE_SESSION, RESET_SESSIONS):
            return True
        if frame.target != self._system:
            if self.running(now) is not None and now - self._since < LONGEST_S:
                return False
            self._system, self._since = frame.target, now
        self._at = now
        return True

    def heard(self, system: int, now: float) -> None:
        """A vehicle has sent a part of a file, or any other answer."""
        if system == self._system and self.running(now) is not None:
            self._at = now

    def running(self, now: float) -> int | None:
        """The system whose turn it is."""
        return None if self._system is None or now - self._at > QUIET_S else self._system
