"""Frames that a channel sends: received bytes, or a message of our own."""

from __future__ import annotations

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.frame import Frame, encode_payload
from skygcs.core.mavlink.msgids import SETUP_SIGNING


class OwnMessage:
    """A message of our own for one or more channels. It gets its sequence number when it is written, so that one that
    was dropped or replaced while it waited does not look like a loss to the vehicle."""

    __slots__ = ("compid", "exempt", "info", "payload", "recorded", "sysid", "to_system")

    def __init__(self, info: MessageInfo, payload: bytes, sysid: int, compid: int) -> None:
        self.info = info
        self.payload = payload
        self.sysid = sysid
        self.compid = compid
        self.to_system = 0
        """The system it was sent to, also if the message has no target field; 0: not known, or all."""
        self.exempt = False
        """It is of vehicles.stop, which is sent without authority over the vehicle, too."""
        self.recorded = info.msgid == SETUP_SIGNING
        """It must not be recorded (any more): it was, or it holds a key."""

    def encode(self, seq: int, version: int) -> bytes:
        """The frame for one channel. An id above 255 is sent as MAVLink 2 whatever the channel prefers."""
        if self.info.msgid > 255:
            version = 2
        return encode_payload(self.info, self.payload, sysid=self.sysid, compid=self.compid, seq=seq, version=version)


Outgoing = bytes | Frame | OwnMessage
"""Received bytes forwarded as they are (into a radio the frame, which admission looks into), or our own message."""
