"""RTCM 3 frames in a stream of bytes, and on their way as GPS_RTCM_DATA.

RTCM 10403, transport layer: 0xD3, six reserved bits (zero), ten bits of length, so many bytes, CRC-24Q of all that.
Only the message type and the epoch of observations are read from the content.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

PREAMBLE = 0xD3
RESERVED_BITS = 0xFC
"""In the second byte; they are zero."""
HEADER_BYTES = 3
CRC_BYTES = 3
MAX_FRAME_BYTES = HEADER_BYTES + 1023 + CRC_BYTES

CHECKED_PER_BYTE = 4
"""Bytes whose checksum is computed per byte of the stream: a sound stream needs one, and any other binary data that a
base mixes in 0.03 (a preamble and six zero bits every 16 kB, with 512 bytes behind it on average)."""

CHECKED_SAVED = 16 * MAX_FRAME_BYTES
"""Most that is saved up for false starts."""

CRC24Q_POLYNOMIAL = 0x1864CFB
"""Register 0 at first, most significant bit first, nothing inverted."""

FRAGMENT_BYTES = 180
"""Bytes of RTCM that one GPS_RTCM_DATA holds."""

MAX_FRAGMENTS = 4
"""The fragment id has two bits."""

MAX_MESSAGE_BYTES = FRAGMENT_BYTES * MAX_FRAGMENTS

SEQUENCES = 32
"""The sequence id has five bits."""

FRAGMENTED = 0x01
"""Bit 0 of the flags; bits 1 and 2 are the fragment id, bits 3 to 7 the sequence id."""

MSM_TYPES = range(1071, 1138)
"""Observations as Multiple Signal Messages of any constellation: twelve bits of type, twelve of station, thirty of
epoch."""


class RtcmContent(NamedTuple):
    """Contents of one RTCM message."""

    type: int
    """0 where it is too short to have one."""
    kind: int
    """Its type and the twelve bits that follow: the station, of an ephemeris its satellite, of a maker's own message
    its subtype. A newer one of a kind takes the place of an older one ..."""
    epoch: int | None
    """... but for the parts of observations too many for one message, which have one epoch (as its 30 bits stand)."""


def crc24q(data: bytes | bytearray | memoryview) -> int:
    """The checksum of an RTCM frame; over a frame with its checksum it is 0."""
    table = _crc_table()
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


@cache
def _crc_table() -> tuple[int, ...]:
    def of(byte: int) -> int:
        crc = byte << 16
        for _ in range(8):
            crc <<= 1
            if crc & 0x1000000:
                crc ^= CRC24Q_POLYNOMIAL
        return crc

    return tuple(of(byte) for byte in range(256))


def content_of(frame: bytes) -> RtcmContent:
    """Return what a whole RTCM frame is."""
    body = frame[HEADER_BYTES:-CRC_BYTES]
    if len(body) < 2:
        return RtcmContent(0, 0, None)  # a filler, or a maker's
    kind = int.from_bytes(body[:3].ljust(3, b"\0"), "big")
    type_ = kind >> 12
    epoch = int.from_bytes(body[3:7], "big") >> 2 if type_ in MSM_TYPES and len(body) >= 7 else None
    return RtcmContent(type_, kind, epoch)


class RtcmDeframer:
    """The whole and sound RTCM frames in a stream of bytes. After anything else it resumes at the next byte that may
    begin a frame, so that a false start costs none that follow. It holds less than one frame.

    Bytes that look like a frame at every second place would cost a checksum of a kilobyte each, 75 µs per byte: such a
    place is passed over unchecked beyond CHECKED_PER_BYTE.
    """

    __slots__ = ("_allowance", "_held", "bad_crc", "frames", "skipped_bytes")

    def __init__(self) -> None:
        self.frames = 0
        self.bad_crc = 0
        """Starts of frames that proved false, or frames that were damaged."""
        self.skipped_bytes = 0
        """Bytes that belong to no sound frame."""
        self._held = bytearray()
        self._allowance = CHECKED_SAVED

    @property
    def held_bytes(self) -> int:
        """Bytes of a frame that has only begun."""
        return len(self._held)

    def drop_held(self) -> None:
        """Forget a frame that has only begun: what follows is no part of it."""
        self.skipped_bytes += len(self._held)
        self._held.clear()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that these bytes complete, in their order."""
        self._held += data
        most = max(CHECKED_SAVED, CHECKED_PER_BYTE * len(self._held))
        self._allowance = min(self._allowance + CHECKED_PER_BYTE * len(data), most)
        held = self._held
        frames: list[bytes] = []
        at = 0
        while True:
            # find the next preamble
            start = held.find(PREAMBLE, at)
            self.skipped_bytes += (len(held) if start < 0 else start) - at
            at = len(held) if start < 0 else start
            if len(held) - at < HEADER_BYTES:
                break
            if held[at + 1] & RESERVED_BITS:
                at += 1
                self.skipped_bytes += 1
                continue
            # wait for the whole frame
            length = HEADER_BYTES + (held[at + 1] << 8 | held[at + 2]) + CRC_BYTES
            if len(held) - at < length:
                break
            # a wrong CRC means that the preamble was payload: go on behind it
            frame = bytes(held[at : at + length])
            if not self._checks(frame):
                self.bad_crc += 1
                self.skipped_bytes += 1
                at += 1
                continue
            # take the frame
            self.frames += 1
            frames.append(frame)
            at += length
        del held[:at]
        return frames

    def _checks(self, frame: bytes) -> bool:
        """True if its checksum is right; False as well where no further one is computed."""
        if self._allowance < len(frame):
            return False
        self._allowance -= len(frame)
        return crc24q(frame) == 0


def fragments_of(message: bytes, sequence: int) -> Iterator[dict[str, int | bytes]]:
    """The values of the GPS_RTCM_DATA that carry a message of 1 to MAX_MESSAGE_BYTES; ``sequence`` counts messages.

    The receiver knows the last fragment by its being short, so that after two or three full ones an empty one follows
    (ArduPilot throws the message away otherwise). Raises ValueError for a message that does not fit.
    """
    if not 0 < len(message) <= MAX_MESSAGE_BYTES:
        raise ValueError(f"{len(message)} bytes do not go as GPS_RTCM_DATA, which takes 1 to {MAX_MESSAGE_BYTES}")
    return _fragments(message, sequence % SEQUENCES << 3)


def _fragments(message: bytes, flags: int) -> Iterator[dict[str, int | bytes]]:
    if len(message) <= FRAGMENT_BYTES:
        yield _values(flags, message)
        return
    for number in range(min(MAX_FRAGMENTS, len(message) // FRAGMENT_BYTES + 1)):
        chunk = message[number * FRAGMENT_BYTES : (number + 1) * FRAGMENT_BYTES]
        yield _values(flags | number << 1 | FRAGMENTED, chunk)


def _values(flags: int, chunk: bytes) -> dict[str, int | bytes]:
    return {"flags": flags, "len": len(chunk), "data": chunk.ljust(FRAGMENT_BYTES, b"\0")}
