"""Output of a shell on its way to the client: kept until it is read, the newest of it. Pure."""

from __future__ import annotations

import codecs

MAX_OUTPUT_BYTES = 64 * 1024
"""Most output that waits for the client: 4 minutes of what a telemetry radio carries, 200 lines of dmesg seven times.
When more comes the oldest is dropped, and counted."""


class ShellOutput:
    """Bytes that no client has read."""

    def __init__(self) -> None:
        self._kept = bytearray()
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._dropped = 0
        self.received_bytes = 0
        self.dropped_bytes = 0
        """All of the session, with those that a read has reported."""

    def __bool__(self) -> bool:
        return bool(self._kept or self._dropped)

    def put(self, data: bytes) -> None:
        """Keep it, and drop the oldest beyond `MAX_OUTPUT_BYTES`."""
        self._kept += data
        self.received_bytes += len(data)
        excess = len(self._kept) - MAX_OUTPUT_BYTES
        if excess > 0:
            del self._kept[:excess]
            self._dropped += excess
            self.dropped_bytes += excess

    def take(self) -> tuple[str, int]:
        """All of it as text, and how many bytes were dropped before it. Bytes that are no UTF-8 become U+FFFD."""
        dropped, self._dropped = self._dropped, 0
        if dropped:
            self._decoder.reset()
        text = self._decoder.decode(bytes(self._kept))
        self._kept.clear()
        return text, dropped
