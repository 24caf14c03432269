"""Bytes in, frames out, from any split of a byte stream.

Rules (docs/explanation/routing.md, "strict frames"):
- a frame counts only if its CRC is right, and in MAVLink 1 its length too: v1 does not trim, so that a known message
  is exactly as long as its fields (this alone takes away 99 % of the frames that chance finds in noise);
- a frame whose id the dialect does not know cannot be checked and is taken only from a (sysid, compid) that a good
  CRC verified before on this link, with incompat_flags in {0, 1} and compat_flags 0, if the next frame begins where
  it ends (or the data ends) and no good frame stands inside it;
- after a false start the search continues at the next byte, never after the claimed length: a noise byte that
  looks like a start would otherwise eat the good frames behind it (pymavlink, gomavlib, mavlink-router do that);
- nothing raises and nothing grows: at most one incomplete frame (280 bytes) is kept.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import (
    HEADER_V1_BYTES,
    HEADER_V2_BYTES,
    INCOMPAT_SIGNED,
    MAGIC_V1,
    MAGIC_V2,
    Frame,
    Header,
    check,
    crc_offset,
    decode_header,
    frame_size,
    mcrf4xx,
)

_MAGIC = re.compile(rb"[\xfd\xfe]")

_START = re.compile(rb"\xfe|\xfd(?:.[\x00\x01]|.?\Z)", re.DOTALL)
"""Where a frame may begin: in MAVLink 2 the incompatibility flags, two bytes on, are 0 or 1 (`INCOMPAT_SIGNED`). So a
run of 0xFD costs 0.04 µs a byte, not 0.6."""

VAIN_CHECKS, BYTES_PER_VAIN_CHECK = 1024, 4
"""Checksums that may fail within the bytes of one call, and one more for so many bytes; then the rest is skipped. In
8 kB of a stream that is 5 ms. Noise of that length has 60 bytes that look like a start; bytes that are made to cost
have one in two, and each of them may hold 40 more."""

VAIN_CHECKS_IN_DATAGRAM = 1024
"""The same for a datagram of any length: 2 ms. One with frames has hardly any."""

_LAST_STEPS = frozenset((x << 8 ^ x << 3 ^ x >> 4) & 0xFFFF for x in range(256))
"""Changes of the state that the last byte of a CRC-16/MCRF4XX, which is CRC_EXTRA, can make."""

MAX_VERIFIED_SOURCES = 4096
"""Bound of the set of verified (sysid, compid): a real link has a few, a hostile one could invent 65,536."""

NEED_MORE = -1
NOT_A_FRAME = -2


@dataclass(slots=True)
class ParserStats:
    """Counts since the parser was made. ``skipped_bytes`` are bytes in no accepted frame, bad CRCs included."""

    good: int = 0
    bad_crc: int = 0
    unknown: int = 0
    unverified: int = 0
    skipped_bytes: int = 0


class FrameParser:
    """Parser of one byte stream, or of one peer's datagrams.

    `feed` takes stream bytes, `feed_datagram` whole datagrams. After `feed`, if `pending` is true and nothing more
    arrives for a while, call `rescue` once: a false start may be holding complete frames back. How the stream is
    split between calls of `feed` changes nothing.
    ``pass_bad_crc`` accepts a known id with a bad CRC from a verified source, as an unknown one (info None).
    """

    __slots__ = ("_buffer", "_messages", "_pass_bad_crc", "_v1_lengths", "_vain_checks", "stats", "verified")

    def __init__(self, dialect: Dialect, *, pass_bad_crc: bool = False) -> None:
        self._messages = dialect.messages
        self._pass_bad_crc = pass_bad_crc
        self._v1_lengths = _v1_lengths(dialect)
        self._vain_checks = 0
        self._buffer = b""
        self.verified: set[int] = set()
        self.stats = ParserStats()

    @property
    def pending(self) -> bool:
        """True while bytes of an incomplete frame (or of a false start) are kept."""
        return bool(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Frames completed by these stream bytes, in order."""
        frames: list[Frame] = []
        buffer = self._buffer + data if self._buffer else data
        self._buffer = buffer[self._scan(buffer, frames, final=False) :]
        return frames

    def feed_datagram(self, data: bytes, *, search: bool = True) -> list[Frame]:
        """Frames of one whole datagram. What is incomplete at its end is skipped: it never meets the next one.

        Without ``search``: only those that it begins with; all from the first byte that begins no frame is skipped.
        """
        frames: list[Frame] = []
        if search:
            self._scan(data, frames, final=True, vain_checks=VAIN_CHECKS_IN_DATAGRAM)
        else:
            self._take_leading(data, frames)
        return frames

    def finish(self) -> list[Frame]:
        """At the end of the stream (a file, a closed connection): the complete frames that were held back; the rest is
        skipped, and the next `feed` starts with empty state."""
        frames: list[Frame] = []
        buffer, self._buffer = self._buffer, b""
        self._scan(buffer, frames, final=True)
        return frames

    def rescue(self) -> list[Frame]:
        """Call after a silence on the stream: returns the complete frames among the kept bytes.

        If there are any behind the first byte, the incomplete frame was a false start and its bytes are skipped;
        otherwise nothing changes and the rest of a slow frame may still come.
        """
        frames: list[Frame] = []
        while buffer := self._buffer:
            at = self._complete_at(buffer)
            if at < 0:
                break
            self.stats.skipped_bytes += at
            frame, size = self._frame_at(buffer, at, len(buffer), final=True, count=True)
            if frame is not None:
                frames.append(frame)
            self._buffer = b""
            frames += self.feed(buffer[at + size :])
        return frames

    def _complete_at(self, buffer: bytes) -> int:
        """Place of the first complete frame: at 0 also one with an unknown id, later only a checked one. Or -1."""
        frame, _ = self._frame_at(buffer, 0, len(buffer), final=True, count=False)
        return 0 if frame is not None else self._good_from(buffer, 1)

    def _scan(self, buffer: bytes, frames: list[Frame], *, final: bool, vain_checks: int | None = None) -> int:
        """Append the frames of ``buffer``; return where the incomplete rest begins (its end if ``final``).
        ``vain_checks``: how many may fail; None: as many as are usual for its length."""
        at = 0
        end = len(buffer)
        stats = self.stats
        self._vain_checks = -(VAIN_CHECKS + end // BYTES_PER_VAIN_CHECK if vain_checks is None else vain_checks)
        while at < end:
            magic = buffer[at]
            if magic != MAGIC_V2 and magic != MAGIC_V1:
                start = self._next_start(buffer, at, end)
                stats.skipped_bytes += start - at
                at = start
                continue
            frame, size = self._frame_at(buffer, at, end, final=final, count=True)
            if frame is not None:
                frames.append(frame)
                at += size
            elif size == NEED_MORE and not final:
                return at
            else:
                after = end if self._vain_checks > 0 else self._next_start(buffer, at + 1, end)
                stats.skipped_bytes += after - at
                at = after
        return end

    def _take_leading(self, data: bytes, frames: list[Frame]) -> None:
        """Append the frames with which ``data`` begins; what follows them is skipped unread."""
        at = 0
        end = len(data)
        while at < end and data[at] in (MAGIC_V2, MAGIC_V1):
            frame, size = self._frame_at(data, at, end, final=True, count=True)
            if frame is None:
                break
            frames.append(frame)
            at += size
        self.stats.skipped_bytes += end - at

    def _next_start(self, buffer: bytes, at: int, end: int) -> int:
        """Place of the next byte that may begin a frame by its first bytes; ``end`` without one. HOT for garbage."""
        lengths = self._v1_lengths
        while (found := _START.search(buffer, at)) is not None:
            at = found.start()
            # a run of 0xFE, byte by byte: what `_frame_at` would say of its length and message
            while at + HEADER_V1_BYTES <= end and buffer[at] == MAGIC_V1:
                known = lengths[buffer[at + 5]]
                if known is None:
                    if buffer[at + 3] << 8 | buffer[at + 4] in self.verified:
                        return at
                    self.stats.unverified += 1
                elif buffer[at + 1] in known:
                    return at
                at += 1
            if at >= end or buffer[at] == MAGIC_V1 or _START.match(buffer, at):
                return at
        return end

    def _frame_at(self, buffer: bytes, at: int, end: int, *, final: bool, count: bool) -> tuple[Frame | None, int]:
        """(frame, its size) at a magic byte, or (None, NEED_MORE or NOT_A_FRAME)."""
        header = decode_header(buffer, at)
        if header is None:
            return None, NEED_MORE
        # what the header alone rules out
        length, incompat, compat, seq, sysid, compid, msgid, size = header
        if incompat > INCOMPAT_SIGNED:
            return None, NOT_A_FRAME  # undefined flags: cannot be parsed (serialization guide)
        info = self._messages.get(msgid)
        first_version = buffer[at] == MAGIC_V1
        if first_version and info is not None and not info.min_length <= length <= info.length:
            return None, NOT_A_FRAME  # up to info.length, as pymavlink sends extensions in MAVLink 1 too
        source = sysid << 8 | compid
        # an unknown id has no CRC_EXTRA: it is taken from verified sources only
        if info is None:
            if compat or source not in self.verified:
                self.stats.unverified += count
                return None, NOT_A_FRAME  # at once: it never makes good frames wait for its length
            if at + size > end:
                return None, NEED_MORE
            return self._unknown_at(buffer, at, end, header, final=final, count=count)
        if at + size > end:
            return None, NEED_MORE
        # the CRC decides
        crc_at = at + (HEADER_V1_BYTES if first_version else HEADER_V2_BYTES) + length
        crc = mcrf4xx(buffer[at + 1 : crc_at] + info.crc_extra_byte)
        if buffer[crc_at] == crc & 0xFF and buffer[crc_at + 1] == crc >> 8:
            if count:
                self.stats.good += 1
                if source not in self.verified and len(self.verified) < MAX_VERIFIED_SOURCES:
                    self.verified.add(source)
            return Frame(buffer[at : at + size], seq, sysid, compid, msgid, info), size
        if self._pass_bad_crc and not compat and source in self.verified:
            frame, step = self._unknown_at(buffer, at, end, header, final=final, count=False)
            if step != NEED_MORE:
                self.stats.bad_crc += count
            return frame, step
        self.stats.bad_crc += count
        self._vain_checks += 1
        return None, NOT_A_FRAME

    def _unknown_at(
        self, buffer: bytes, at: int, end: int, header: Header, *, final: bool, count: bool
    ) -> tuple[Frame | None, int]:
        """A complete frame whose CRC cannot be checked, or is wrong: see the rules above."""
        _, _, _, seq, sysid, compid, msgid, size = header
        after = at + size
        raw = buffer[at:after]
        if after == end and not final:
            return None, NEED_MORE
        if after < end and buffer[after] not in (MAGIC_V1, MAGIC_V2):
            return None, NOT_A_FRAME
        if self._good_from(raw, 1) >= 0 and not _some_extra_fits(raw):
            return None, NOT_A_FRAME  # a false start would swallow the good one; an intact tunnel may carry it
        self.stats.unknown += count
        return Frame(raw, seq, sysid, compid, msgid, None), size

    def _good_from(self, buffer: bytes, at: int) -> int:
        """Place of the first complete frame with a correct CRC, from ``at`` on; -1 without one."""
        for found in _MAGIC.finditer(buffer, at):
            start = found.start()
            size = frame_size(buffer, start)
            if size and start + size <= len(buffer):
                self._vain_checks += 1
                _, verdict = check(buffer[start : start + size], self._messages)
                if verdict == "ok":
                    return start
        return -1


@lru_cache(maxsize=8)  # dialects of a daemon: a flood opens channels, each with a parser, faster than it is made
def _v1_lengths(dialect: Dialect) -> tuple[range | None, ...]:
    """By message id below 256: the lengths that it may have in MAVLink 1; None for an id that is not known."""
    found = (dialect.messages.get(msgid) for msgid in range(256))
    return tuple(None if info is None else range(info.min_length, info.length + 1) for info in found)


def _some_extra_fits(raw: bytes) -> bool:
    """True if any CRC_EXTRA makes the CRC of this frame right: true for every intact frame, for 1 of 256 others."""
    crc_at = crc_offset(raw)
    before_extra = mcrf4xx(raw[1:crc_at])
    sent = raw[crc_at] | raw[crc_at + 1] << 8
    return (sent ^ before_extra >> 8) in _LAST_STEPS
