"""The stream of a u-blox receiver: RTCM and UBX messages in one stream, with NMEA between them that nobody reads.

One search for both: the content of an RTCM message may hold the beginning of a UBX message, and the other way round.
After anything that proves to be no message the search goes on at the next byte, so that a false start costs none that
follow. It holds less than one message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from skygcs.core.radio_link.corrections import (
    CRC_BYTES,
    HEADER_BYTES,
    PREAMBLE,
    RESERVED_BITS,
    CheckAllowance,
    crc24q,
)
from skygcs.ext.corrections import ubx
from skygcs.ext.corrections.ubx import UbxMessage

_BEGIN = re.compile(b"[%c%c]" % (PREAMBLE, ubx.SYNC[0]))


class ReceiverStream:
    """The sound messages in a stream of bytes, and counts of the rest."""

    def __init__(self) -> None:
        self.rtcm = 0
        self.ubx = 0
        self.damaged = 0
        """Starts of messages whose checksum was wrong, or beyond what is checked (`CheckAllowance`)."""
        self.skipped_bytes = 0
        """Bytes that belong to neither: NMEA, and noise."""
        self._held = bytearray()
        self._allowance = CheckAllowance()

    @property
    def held_bytes(self) -> int:
        """Bytes of a message that has only begun."""
        return len(self._held)

    def feed(self, data: bytes) -> Iterator[bytes | UbxMessage]:
        """The messages that these bytes complete, in their order: RTCM as bytes, UBX as messages."""
        held = self._held
        held += data
        self._allowance.fed(len(data), len(held))
        at = 0
        found: list[bytes | UbxMessage] = []
        while True:
            begin = _BEGIN.search(held, at)
            start = len(held) if begin is None else begin.start()
            self.skipped_bytes += start - at
            at = start
            if begin is None:
                break
            length = self._length_at(at)
            if length is None:  # no message begins here
                at += 1
                self.skipped_bytes += 1
            elif length > len(held) - at:
                break
            elif (message := self._message(at, length)) is None:
                at += 1
                self.skipped_bytes += 1
                self.damaged += 1
            else:
                found.append(message)
                at += length
        del held[:at]
        return iter(found)

    def _length_at(self, at: int) -> int | None:
        """How long the message is that may begin here; more than is there if that is not known yet; None: none does."""
        held = self._held
        left = len(held) - at
        if held[at] == PREAMBLE:
            if left < 2:
                return left + 1
            if held[at + 1] & RESERVED_BITS:
                return None
            return left + 1 if left < HEADER_BYTES else HEADER_BYTES + (held[at + 1] << 8 | held[at + 2]) + CRC_BYTES
        if held[at] != ubx.SYNC[0]:
            return None
        if left < 2:
            return left + 1
        if held[at + 1] != ubx.SYNC[1]:
            return None
        if left < ubx.HEADER_BYTES:
            return left + 1
        content = held[at + 4] | held[at + 5] << 8
        return ubx.HEADER_BYTES + content + ubx.CHECKSUM_BYTES if content <= ubx.MAX_CONTENT_BYTES else None

    def _message(self, at: int, length: int) -> bytes | UbxMessage | None:
        """The message that stands here; None if its checksum is wrong."""
        if not self._allowance.take(length):
            return None
        raw = bytes(self._held[at : at + length])
        if raw[0] == PREAMBLE:
            if crc24q(raw):
                return None
            self.rtcm += 1
            return raw
        if ubx.checksum(memoryview(raw)[2:-2]) != raw[-2:]:
            return None
        self.ubx += 1
        return UbxMessage((raw[2], raw[3]), raw[ubx.HEADER_BYTES : -ubx.CHECKSUM_BYTES])
