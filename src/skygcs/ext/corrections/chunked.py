"""The chunked transfer coding of HTTP/1.1 (RFC 9112, 7.1), as casters of NTRIP 2 send their streams.

state   input                                      next
-----   ----------------------------------------   -----
size    a hex number, extensions, end of line      data; ended if it is 0
size    anything else, or a line that is too long  LinkError
data    so many bytes                              end
end     end of line                                size
end     anything else                              LinkError
ended   anything                                   ended
"""

from __future__ import annotations

import re
from typing import Literal

from skygcs.errors import LinkError

MAX_SIZE_LINE_BYTES = 128
"""A hex number and extensions, which nobody uses."""

MAX_CHUNK_BYTES = 1 << 20
"""A caster sends each message, or what came together, as one chunk: some kilobytes."""

_SIZE_LINE = re.compile(rb"[ \t]*([0-9A-Fa-f]{1,16})[ \t]*(?:;[^\r\n]*)?\r?\n")


class ChunkedDecoder:
    """Takes the coded bytes in any pieces; holds less than one size line, and nothing of the content."""

    def __init__(self) -> None:
        self.state: Literal["size", "data", "end", "ended"] = "size"
        self._left = 0
        self._line = b""

    def feed(self, data: bytes) -> bytes:
        """The content of these bytes. Raises LinkError where they are not chunks; there is no way on after that."""
        content = bytearray()
        at = 0
        while at < len(data) and self.state != "ended":
            if self.state == "data":
                piece = data[at : at + self._left]
                content += piece
                at += len(piece)
                self._left -= len(piece)
                if not self._left:
                    self.state = "end"
            else:
                at = self._take_line(data, at)
        return bytes(content)

    def _take_line(self, data: bytes, at: int) -> int:
        """Add bytes up to the end of the line; where to go on."""
        end = data.find(b"\n", at, at + MAX_SIZE_LINE_BYTES + 1)
        stop = min(len(data), at + MAX_SIZE_LINE_BYTES + 1) if end < 0 else end + 1
        self._line += data[at:stop]
        if len(self._line) > MAX_SIZE_LINE_BYTES:
            raise LinkError(f"a chunk begins with a line of more than {MAX_SIZE_LINE_BYTES} bytes: no chunked stream")
        if end >= 0:
            line, self._line = self._line, b""
            self._end_line(line)
        return stop

    def _end_line(self, line: bytes) -> None:
        if self.state == "end":
            if line not in (b"\r\n", b"\n"):
                raise LinkError("a chunk is longer than it says: no chunked stream")
            self.state = "size"
            return
        found = _SIZE_LINE.fullmatch(line)
        if found is None:
            raise LinkError("a chunk begins without its size: no chunked stream")
        self._left = int(found[1], 16)
        if self._left > MAX_CHUNK_BYTES:
            raise LinkError(f"a chunk of {self._left} bytes: no caster sends more than {MAX_CHUNK_BYTES} at once")
        self.state = "data" if self._left else "ended"
