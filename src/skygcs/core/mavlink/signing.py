"""MAVLink 2 message signing: holders of a secret key sign and verify, and no frame counts twice.

Rules and layout: https://mavlink.io/en/guide/message_signing.html
    signature block   link id (1)  timestamp (6, little endian)  signature (6)
    signature         the first 48 bits of SHA-256(key + frame from the magic byte to the CRC + link id + timestamp)
    timestamp         10 µs units since 2015-01-01 00:00 UTC, of one (sysid, compid, link id) stream strictly rising

It authenticates and does not encrypt: every payload stays readable. A guessed signature passes once in 2.8e14 tries. A
weak passphrase is not protected: with one signed frame, passphrases can be tried offline.
"""

from __future__ import annotations

import hashlib
import hmac
from enum import StrEnum

from skygcs.core.mavlink.frame import (
    CRC_BYTES,
    INCOMPAT_SIGNED,
    MAGIC_V2,
    SIGNATURE_BYTES,
    Frame,
    decode_header,
    mcrf4xx,
)

KEY_BYTES = 32
DIGEST_BYTES = 6
"""The signature proper, of the signature block's 13 bytes."""

EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01 00:00 UTC."""

TICKS_PER_S = 100_000
"""A timestamp's unit is 10 µs."""

MAX_TIMESTAMP = (1 << 48) - 1
"""In the year 2104."""

NEW_STREAM_TICKS = 60 * TICKS_PER_S
"""A stream not met before may be this far behind our own clock (the guide's minute), and no further: else whatever was
recorded of it earlier could be played to us."""

MAX_AHEAD_S = 86_400.0
"""A stamp further ahead of the computer's clock is neither believed nor followed: it would take the time of the key, of
every vehicle that hears us and of what is kept on disk along, for good, and one of the year 2104 ends all signing. A
day, and not the guide's minute, because honest clocks run ahead: an ArduPilot without GPS starts a minute later at
each start, and a computer whose clock was set to local time is up to 14 h off."""

MAX_STREAMS = 512
"""Most sources, the same as in one channel's table of counters. Only holders of the key can make one."""


class SignatureVerdict(StrEnum):
    """Fate of a received frame on a link that checks signatures. All but the first two are dropped."""

    SIGNED = "signed"
    ALLOWED = "unsigned_allowed"
    """Not signed, and of an id that need not be."""
    UNSIGNED = "unsigned"
    FORGED = "bad_signature"
    """Signed with another key, or changed in transit."""
    REPLAYED = "replayed"
    """Not newer than the last of its stream: a copy, or one that was overtaken."""
    STALE = "stale"
    """The first of its stream, and more than a minute older than what we have seen from others."""
    AHEAD = "ahead"
    """Its time is too far ahead of this computer's clock."""
    CROWDED = "too_many_streams"


def timestamp_at(unix_s: float) -> int:
    """The signing timestamp of a moment; 0 before 2015."""
    return min(max(int((unix_s - EPOCH_UNIX_S) * TICKS_PER_S), 0), MAX_TIMESTAMP)


def unix_time_of(timestamp: int) -> float:
    """The moment of a signing timestamp, in Unix seconds."""
    return EPOCH_UNIX_S + timestamp / TICKS_PER_S


def key_from_passphrase(passphrase: str) -> bytes:
    """SHA-256 of its UTF-8 bytes, as Mission Planner, QGroundControl and MAVProxy do it."""
    return hashlib.sha256(passphrase.encode()).digest()


def key_id(key: bytes) -> str:
    """Eight hexadecimal digits that identify a key and do not reveal it."""
    return hashlib.sha256(b"skygcs signing key id" + key).hexdigest()[:8]


def sign(raw: bytes, crc_extra: bytes, key: bytes, link_id: int, timestamp: int) -> bytes:
    """The signed frame of a complete unsigned MAVLink 2 frame. Raises ValueError for any other."""
    header = decode_header(raw)
    if header is None or raw[0] != MAGIC_V2 or header[1] or len(raw) != header[-1]:
        raise ValueError("only a whole unsigned MAVLink 2 frame can be signed")
    body = raw[1:2] + bytes((INCOMPAT_SIGNED,)) + raw[3:-CRC_BYTES]
    crc = mcrf4xx(body + crc_extra)
    stamped = raw[:1] + body + crc.to_bytes(2, "little") + bytes((link_id,)) + timestamp.to_bytes(6, "little")
    return stamped + hashlib.sha256(key + stamped).digest()[:DIGEST_BYTES]


def link_id_of(signed: bytes) -> int:
    """The link id of a signed frame."""
    return signed[-SIGNATURE_BYTES]


def timestamp_of(signed: bytes) -> int:
    """The timestamp of a signed frame."""
    return int.from_bytes(signed[1 - SIGNATURE_BYTES : -DIGEST_BYTES], "little")


def is_signed_with(signed: bytes, key: bytes) -> bool:
    """True if this signed frame carries the signature of this key."""
    digest = hashlib.sha256(key + signed[:-DIGEST_BYTES]).digest()
    return hmac.compare_digest(digest[:DIGEST_BYTES], signed[-DIGEST_BYTES:])


class SigningClock:
    """The time of one key. It never goes back by itself: it is the highest of the wall clock, of what was sent and of
    what was seen, rightly signed, from others."""

    __slots__ = ("timestamp", "wall")

    def __init__(self, timestamp: int = 0, wall: int = 0) -> None:
        self.timestamp = timestamp
        self.wall = wall
        """The latest that this computer's clock has shown, before a restart as well: a computer that starts with an old
        time (it has no battery for its clock) does not take everybody else's for the future."""

    def see_wall(self, wall: int) -> None:
        """The computer's clock shows this."""
        if wall > self.wall:
            self.wall = min(wall, MAX_TIMESTAMP)
        self.advance(wall)

    def reset(self, wall: int) -> None:
        """Back to the computer's clock, whatever was seen and sent."""
        self.timestamp = self.wall = wall

    def advance(self, timestamp: int) -> None:
        """Somebody with the key is at this time, or the wall clock is."""
        if timestamp > self.timestamp:
            self.timestamp = min(timestamp, MAX_TIMESTAMP)

    def stamp(self, wall: int) -> int:
        """A timestamp no frame of ours had before, for one that is sent at ``wall`` (`timestamp_at`)."""
        self.timestamp = min(max(self.timestamp + 1, wall), MAX_TIMESTAMP)
        return self.timestamp


class SignatureStreams:
    """The last timestamp of each stream, and whether the next one is newer. Bounded."""

    __slots__ = ("_clock", "_last")

    def __init__(self, clock: SigningClock) -> None:
        self._clock = clock
        self._last: dict[tuple[int, int, int], int] = {}

    def __len__(self) -> int:
        return len(self._last)

    def check(self, link_id: int, sysid: int, compid: int, timestamp: int) -> SignatureVerdict:
        """Judge whether a frame that is rightly signed may count; if so (SIGNED), it is remembered and our clock
        follows."""
        stream = (link_id, sysid, compid)
        last = self._last.get(stream)
        if last is not None:
            if timestamp <= last:
                return SignatureVerdict.REPLAYED
        elif timestamp + NEW_STREAM_TICKS < self._clock.timestamp:
            return SignatureVerdict.STALE
        elif len(self._last) >= MAX_STREAMS and not self._make_room():
            return SignatureVerdict.CROWDED
        self._last[stream] = timestamp
        self._clock.advance(timestamp)
        return SignatureVerdict.SIGNED

    def reset(self) -> None:
        """Forget streams that are ahead of our clock, which was set back: what their senders sign next is new."""
        self._last = {stream: at for stream, at in self._last.items() if at <= self._clock.timestamp}

    def _make_room(self) -> bool:
        """Forget what is a minute old: anything that old, or older, is refused to a stream that is not known, too."""
        limit = self._clock.timestamp - NEW_STREAM_TICKS
        self._last = {stream: at for stream, at in self._last.items() if at >= limit}
        return len(self._last) < MAX_STREAMS


class Gate:
    """Checks the frames of one link with one key. ``allowed`` are the ids that may come unsigned; None: all of them.
    ``max_ahead_s``: how far a stamp may be ahead of the computer's clock; None: by any time.

    A frame that is signed, and wrongly, is never let in, whatever its id.
    """

    __slots__ = ("_allowed", "_clock", "_key", "_max_ahead", "_streams")

    def __init__(
        self,
        key: bytes,
        clock: SigningClock,
        streams: SignatureStreams,
        allowed: frozenset[int] | None,
        max_ahead_s: float | None = None,
    ) -> None:
        self._key = key
        self._max_ahead = MAX_TIMESTAMP if max_ahead_s is None else int(max_ahead_s * TICKS_PER_S)
        self._clock = clock
        self._streams = streams
        self._allowed = allowed

    def check(self, frame: Frame, wall: int) -> SignatureVerdict:
        """Return what becomes of a frame received at ``wall`` (`timestamp_at`)."""
        if not frame.signed:
            allowed = self._allowed
            return SignatureVerdict.ALLOWED if allowed is None or frame.msgid in allowed else SignatureVerdict.UNSIGNED
        raw = frame.raw
        if not is_signed_with(raw, self._key):
            return SignatureVerdict.FORGED
        self._clock.see_wall(wall)
        timestamp = timestamp_of(raw)
        if timestamp > self._clock.wall + self._max_ahead:
            return SignatureVerdict.AHEAD
        return self._streams.check(link_id_of(raw), frame.sysid, frame.compid, timestamp)
