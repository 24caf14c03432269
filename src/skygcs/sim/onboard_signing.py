"""Message signing on board, as ArduPilot does it: one key for all links, unsigned frames of radios let in.

PX4 1.16 cannot sign and takes no notice of SETUP_SIGNING.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import RADIO, RADIO_STATUS
from skygcs.core.mavlink.signing import TICKS_PER_S, Gate, SignatureStreams, SignatureVerdict, SigningClock, sign

AHEAD_TICKS = 60 * TICKS_PER_S
"""ArduPilot goes on a minute after the time it was given (GCS_Signing.cpp), so that what was heard before is old."""


class BoardSigning:
    """A vehicle's signing, kept over a reboot. ``key`` None: it signs nothing and accepts everything."""

    def __init__(self) -> None:
        self.key: bytes | None = None
        self.clock = SigningClock()
        self._gate: Gate | None = None

    def set_up(self, fields: Mapping[str, Any]) -> None:
        """SETUP_SIGNING; key and time of zero turn it off."""
        key, timestamp = bytes(fields["secret_key"]), int(fields["initial_timestamp"])
        if not any(key) and not timestamp:
            self.key = self._gate = None
            return
        self.key = key
        self.clock = SigningClock(timestamp + AHEAD_TICKS)
        self._gate = Gate(key, self.clock, SignatureStreams(self.clock), frozenset({RADIO, RADIO_STATUS}))

    def hears(self, frame: Frame) -> bool:
        """True if a received frame may count."""
        return self._gate is None or self._gate.check(frame, 0) in (SignatureVerdict.SIGNED, SignatureVerdict.ALLOWED)

    def signed(self, raw: bytes, info: MessageInfo) -> bytes:
        """A frame of its own as it is sent."""
        return raw if self.key is None else sign(raw, info.crc_extra_byte, self.key, 0, self.clock.stamp(0))
