"""Texts of a vehicle, put together of the parts in which they come. Pure; bounded whatever it sends.

MAVLink 2 senders split long texts into chunks of 50 bytes with one id. A text whose end does not come is returned after
a time-out, with ``…`` in place of a missing part. https://mavlink.io/en/messages/common.html#STATUSTEXT
"""

from __future__ import annotations

from dataclasses import dataclass, field

CHUNK_BYTES = 50

MAX_CHUNKS = 16
"""800 characters; the longest text of PX4 has 200 or so, ArduPilot's 250."""

MAX_OPEN = 4
"""Incomplete texts per vehicle; beyond this number the oldest is returned as it is."""

CHUNK_TIMEOUT_S = 2.0
"""Chunks follow each other at once; two rounds of a multipoint radio are 1.5 s."""

MISSING = "…"

MAX_STATUS_TEXTS = 32
"""Texts kept of one autopilot, and shown of one vehicle: the newest."""


@dataclass(frozen=True, slots=True)
class StatusText:
    """A whole text; ``at``: when its last part came; ``severity``: MAV_SEVERITY (0 emergency .. 7 debug)."""

    severity: int
    text: str
    at: float


@dataclass(slots=True)
class _Open:
    severity: int
    since: float
    chunks: dict[int, bytes] = field(default_factory=dict)
    last: int | None = None


class StatusTextAssembler:
    """`on_text` and `flush` return the texts that are complete (or given up) now, oldest first."""

    def __init__(self) -> None:
        self._open: dict[int, _Open] = {}

    def on_text(self, severity: int, raw: bytes, text_id: int, chunk_seq: int, now: float) -> list[StatusText]:
        """One STATUSTEXT; ``raw`` is its 50-byte text field."""
        if text_id == 0:
            return [StatusText(severity, _clean(raw), now)]
        done: list[StatusText] = []
        if chunk_seq >= MAX_CHUNKS:
            return done
        known = self._open.get(text_id)
        if known is not None and known.chunks.get(chunk_seq, raw) != raw:
            done.append(self._close(text_id, now))  # the id was used again: it has 16 bits, and some senders use fewer
            known = None
        if known is None:
            if len(self._open) >= MAX_OPEN:
                done.append(self._close(min(self._open, key=lambda i: self._open[i].since), now))
            known = self._open[text_id] = _Open(severity, now)
        known.chunks[chunk_seq] = raw
        if b"\0" in raw:
            known.last = chunk_seq
        if known.last is not None and all(n in known.chunks for n in range(known.last + 1)):
            done.append(self._close(text_id, now))
        return done

    def flush(self, now: float) -> list[StatusText]:
        """Give up waiting for the rest of texts begun more than `CHUNK_TIMEOUT_S` ago."""
        if not self._open:
            return []
        stale = [text_id for text_id, text in self._open.items() if now - text.since >= CHUNK_TIMEOUT_S]
        return [self._close(text_id, now) for text_id in stale]

    def _close(self, text_id: int, now: float) -> StatusText:
        text = self._open.pop(text_id)
        end = text.last if text.last is not None else max(text.chunks)
        parts: list[bytes] = []
        for n in range(end + 1):
            if n in text.chunks:
                parts.append(text.chunks[n].split(b"\0", 1)[0])
            elif not parts or parts[-1] != MISSING.encode():
                parts.append(MISSING.encode())
        return StatusText(text.severity, _clean(b"".join(parts)), now)


def _clean(raw: bytes) -> str:
    """Printable text for terminals and logs. PX4 ends texts that are also events with a tab."""
    text = raw.split(b"\0", 1)[0].decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in text).strip()
