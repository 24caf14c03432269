"""Bytes in, frames out, from any split of a byte stream.

Rules (docs/explanation/routing.md, "strict frames"):
- a frame counts only if its CRC is right; one whose id the dialect does not know cannot be checked and is taken
  only from a (sysid, compid) that a good CRC verified before on this link, with incompat_flags in {0, 1} and
  compat_flags 0;
- after a false start the search goes on at the next byte, never behind the claimed length: a noise byte that
  looks like a start would otherwise eat the good frames behind it (pymavlink, gomavlib, mavlink-router do that);
- nothing raises and nothing grows: at most one incomplete frame (280 bytes) is kept.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from fastcrc.crc16 import mcrf4xx

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import INCOMPAT_SIGNED, MAGIC_V1, MAGIC_V2, Frame

_MAGIC = re.compile(rb"[\xfd\xfe]")

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
    arrives for a while, call `rescue` once: a false start may be holding complete frames back.
    ``pass_bad_crc`` accepts a known id with a bad CRC from a verified source, as an unknown one (info None).
    """

    __slots__ = ("_buffer", "_messages", "_pass_bad_crc", "stats", "verified")

    def __init__(self, dialect: Dialect, *, pass_bad_crc: bool = False) -> None:
        self._messages = dialect.messages
        self._pass_bad_crc = pass_bad_crc
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

    def feed_datagram(self, data: bytes) -> list[Frame]:
        """Frames of one whole datagram. What is incomplete at its end is skipped: it never meets the next one."""
        frames: list[Frame] = []
        self._scan(data, frames, final=True)
        return frames

    def rescue(self) -> list[Frame]:
        """To be called after a silence on the stream: complete frames that stand inside the incomplete one.

        If there are any, the incomplete one was a false start and its bytes are skipped; otherwise nothing changes
        and the rest of a slow frame may still come.
        """
        buffer = self._buffer
        if not buffer:
            return []
        at = 1
        while (found := _MAGIC.search(buffer, at)) is not None:
            at = found.start()
            frame, size = self._frame_at(buffer, at, len(buffer), final=False, count=False)
            if frame is not None and frame.info is not None and size > 0:
                self.stats.skipped_bytes += at
                self._buffer = b""
                return self.feed(buffer[at:])
            at += 1
        return []

    def _scan(self, buffer: bytes, frames: list[Frame], *, final: bool) -> int:
        """Append the frames of ``buffer``; return where the incomplete rest begins (its end if ``final``)."""
        at = 0
        end = len(buffer)
        stats = self.stats
        while at < end:
            magic = buffer[at]
            if magic != MAGIC_V2 and magic != MAGIC_V1:
                found = _MAGIC.search(buffer, at)
                start = found.start() if found is not None else end
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
                stats.skipped_bytes += 1
                at += 1
        return end

    def _frame_at(self, buffer: bytes, at: int, end: int, *, final: bool, count: bool) -> tuple[Frame | None, int]:
        """(frame, its size) at a magic byte, or (None, NEED_MORE or NOT_A_FRAME)."""
        if buffer[at] == MAGIC_V2:
            if end - at < 10:
                return None, NEED_MORE
            length = buffer[at + 1]
            incompat = buffer[at + 2]
            if incompat > INCOMPAT_SIGNED:
                return None, NOT_A_FRAME  # flags nobody defined: cannot be parsed (serialization guide)
            seq, sysid, compid = buffer[at + 4], buffer[at + 5], buffer[at + 6]
            msgid = buffer[at + 7] | buffer[at + 8] << 8 | buffer[at + 9] << 16
            crc_at = at + 10 + length
            size = length + 25 if incompat else length + 12
            plain = buffer[at + 3] == 0
        else:
            if end - at < 6:
                return None, NEED_MORE
            length, seq, sysid, compid, msgid = buffer[at + 1 : at + 6]
            crc_at = at + 6 + length
            size = length + 8
            plain = True
        info = self._messages.get(msgid)
        source = sysid << 8 | compid
        if info is None and (not plain or source not in self.verified):
            if count:
                self.stats.unverified += 1
            return (
                None,
                NOT_A_FRAME,
            )  # at once: an unverified unknown never makes good frames wait for its length
        if at + size > end:
            return None, NEED_MORE
        if info is None:
            return self._unknown_at(buffer, at, size, end, (seq, sysid, compid, msgid), count)
        crc = mcrf4xx(buffer[at + 1 : crc_at] + info.crc_extra_byte)
        if buffer[crc_at] == crc & 0xFF and buffer[crc_at + 1] == crc >> 8:
            if count:
                self.stats.good += 1
                if source not in self.verified and len(self.verified) < MAX_VERIFIED_SOURCES:
                    self.verified.add(source)
            return Frame(buffer[at : at + size], seq, sysid, compid, msgid, info), size
        if count:
            self.stats.bad_crc += 1
        if self._pass_bad_crc and plain and source in self.verified:
            return self._unknown_at(buffer, at, size, end, (seq, sysid, compid, msgid), False)
        return None, NOT_A_FRAME

    def _unknown_at(
        self, buffer: bytes, at: int, size: int, end: int, header: tuple[int, int, int, int], count: bool
    ) -> tuple[Frame | None, int]:
        """A frame that no CRC can vouch for: it must at least end where the next one begins, or the data ends."""
        after = at + size
        if after < end and buffer[after] != MAGIC_V2 and buffer[after] != MAGIC_V1:
            return None, NOT_A_FRAME
        if count:
            self.stats.unknown += 1
        seq, sysid, compid, msgid = header
        return Frame(buffer[at:after], seq, sysid, compid, msgid, None), size
