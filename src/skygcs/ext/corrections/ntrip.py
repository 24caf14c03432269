"""An NTRIP client without its connection: its request, and a state machine that takes the caster's answer.

    state    input                                                     next
    ------   -------------------------------------------------------   ---------------------------------
    status   "ICY 200 OK" (revision 1)                                 icy
    status   "SOURCETABLE 200 OK" (revision 1)                         table
    status   "ERROR - ...", something else, no line at all             refused
    status   "HTTP/1.x ..." (revision 2)                               head
    head     end of the head: 200 and data                             stream
    head     end of the head: 200 and text or a source table           table
    head     end of the head: any other status                         refused
    icy      lines of text, up to an empty one                         icy
    icy      an empty line, or a byte that is no text                  stream
    table    lines; "ENDSOURCETABLE", the end, or MAX_TABLE_BYTES      refused: the mountpoint does not exist
    stream   bytes, chunked if the head said so                        stream
    stream   the end of the chunks                                     ended

Refused and ended are exceptions: the connection is of no use any more. A caster answers the request for a mountpoint
that it does not have with the table of those that it has, so that is what the table state reads.
"""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from typing import Literal

from skygcs.errors import LinkError
from skygcs.ext.corrections.chunked import ChunkedDecoder
from skygcs.spelling import near_names
from skygcs.terminal_text import visible

MAX_STATUS_BYTES = 512
MAX_HEAD_BYTES = 8192
MAX_TABLE_BYTES = 1 << 20
"""The largest public casters send 200 kB."""
MAX_LINE_BYTES = 2048
MAX_MOUNTPOINTS = 4096
SHOWN_MOUNTPOINTS = 8
MAX_COMPARED = 200
"""Names that are compared with the wrong one, of those that begin most like it: a caster that makes up 4096 of its
letters had the loop for 0.4 s."""
MAX_SHOWN_CHARS = 120
"""The caster's texts are cut to that in texts of ours."""

FIRST_BINARY = 0x80
"""Bytes from here on are no text: the first byte of an RTCM message is 0xD3."""

USER_AGENT = "NTRIP skygcs"

_END_OF_HEAD = re.compile(rb"\r?\n\r?\n")

State = Literal["status", "head", "icy", "table", "stream"]


class RefusedByCaster(LinkError):
    """The caster answered, and the same request will have the same answer: somebody has to change something."""


@dataclass(frozen=True, slots=True)
class Mountpoint:
    """Where a stream of corrections is; never with a password."""

    host: str
    port: int
    name: str
    tls: bool = False
    user: str = ""

    @property
    def text(self) -> str:
        """Its address for a person, without the user."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}/{self.name}"


def request(mountpoint: Mountpoint, password: str, *, revision: int, gga: bytes = b"") -> bytes:
    """The request for a stream. A ``gga`` sentence goes into the head of revision 2, for a virtual station."""
    host = f"[{mountpoint.host}]" if ":" in mountpoint.host else mountpoint.host
    lines = [f"GET /{mountpoint.name} HTTP/1.{0 if revision == 1 else 1}"]
    if revision != 1:
        lines += [f"Host: {host}:{mountpoint.port}", "Ntrip-Version: Ntrip/2.0"]
    lines.append(f"User-Agent: {USER_AGENT}")
    if mountpoint.user or password:
        token = base64.b64encode(f"{mountpoint.user}:{password}".encode()).decode()
        lines.append(f"Authorization: Basic {token}")
    if revision != 1:
        lines += [f"Ntrip-GGA: {gga.decode('ascii').strip()}"] if gga else []
        lines.append("Connection: close")
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


class NtripAnswer:
    """The caster's answer, in pieces of any length. Beside the last piece it holds less than one head or one line."""

    def __init__(self, mountpoint: Mountpoint, *, with_password: bool = False) -> None:
        self.state: State = "status"
        self.revision = 0
        """The revision of the caster's answer, 1 or 2; 0: there is none yet."""
        self._mountpoint = mountpoint
        self._with_password = with_password
        self._held = b""
        self._chunks: ChunkedDecoder | None = None
        self._table = SourceTable()

    def feed(self, data: bytes) -> bytes:
        """The bytes of the stream in this piece. Raises RefusedByCaster or LinkError, with what to do."""
        if self.state == "status":
            data = self._take_status(data)
        if self.state == "head":
            data = self._take_head(data)
        if self.state == "icy":
            data = self._take_icy_lines(data)
        if self.state not in ("table", "stream"):
            return b""
        content = data if self._chunks is None else self._chunks.feed(data)
        if self.state == "table":
            self._table.feed(content)
            if self._table.complete or (self._chunks is not None and self._chunks.state == "ended"):
                raise self._no_mountpoint()
            return b""
        if self._chunks is not None and self._chunks.state == "ended" and not content:
            raise LinkError("the caster ended the stream")
        return content

    def ended(self) -> LinkError:
        """Why there is no stream, after the connection ended or nothing more came in time."""
        if self.state == "table":
            return self._no_mountpoint()
        if self.state == "stream":
            return LinkError("the caster closed the connection")
        if self.state == "head":  # some send no more than the status of a refusal
            status = self._held.partition(b"\n")[0].strip()
            if (code := _code(status)) != b"200":
                return self._refusal(code, status, {})
        return LinkError("the caster closed the connection without an answer")

    # -- the inside

    def _take_status(self, data: bytes) -> bytes:
        self._held += data
        end = self._held.find(b"\n", 0, MAX_STATUS_BYTES)
        if end < 0:
            if not _is_text(self._held[:4]) or len(self._held) >= MAX_STATUS_BYTES:
                raise RefusedByCaster("it sends data without an answer: this address is not an NTRIP caster")
            return b""
        line = self._held[:end].strip()
        rest, self._held = self._held, b""
        upper = line.upper()
        if upper.startswith(b"HTTP/1."):
            self.revision, self.state = 2, "head"
            return rest
        self.revision = 1
        if upper.startswith(b"ICY 200"):
            self.state = "icy"
        elif upper.startswith(b"SOURCETABLE 200"):
            self.state = "table"
        elif upper.startswith((b"ERROR", b"ICY", b"SOURCETABLE")):
            raise self._error_of_revision_1(line)
        else:
            raise RefusedByCaster(f"it answers {_shown(line)}: this address is not an NTRIP caster")
        return rest[end + 1 :]

    def _error_of_revision_1(self, line: bytes) -> RefusedByCaster:
        upper = line.upper()
        if b"PASSWORD" in upper or b"401" in upper or b"UNAUTHORIZED" in upper:
            return self._unauthorized()
        if b"MOUNT" in upper or b"404" in upper:
            return RefusedByCaster(f"it has no mountpoint {self._mountpoint.name} ({_shown(line)})")
        return RefusedByCaster(f"it answers {_shown(line)}")

    def _take_head(self, data: bytes) -> bytes:
        self._held += data
        end = _END_OF_HEAD.search(self._held, 0, MAX_HEAD_BYTES)
        if end is None:
            if len(self._held) >= MAX_HEAD_BYTES:
                raise RefusedByCaster(f"the head of its answer has more than {MAX_HEAD_BYTES} bytes: no NTRIP caster")
            return b""
        status, *lines = self._held[: end.start()].split(b"\n")
        rest, self._held = self._held[end.end() :], b""
        fields: dict[bytes, bytes] = {}
        for line in lines:
            name, _, value = line.partition(b":")
            fields.setdefault(name.strip().lower(), value.strip())
        self._begin_body(status, fields)
        return rest

    def _begin_body(self, status: bytes, fields: dict[bytes, bytes]) -> None:
        """The status and the fields of an answer by HTTP."""
        code = _code(status)
        if code != b"200":
            raise self._refusal(code, status, fields)
        coding = fields.get(b"transfer-encoding", b"identity").lower()
        if coding == b"chunked":
            self._chunks = ChunkedDecoder()
        elif coding != b"identity":
            raise RefusedByCaster(f"it codes the stream as {_shown(coding)}, which nobody asked for")
        kind = fields.get(b"content-type", b"gnss/data").lower()
        is_table = kind.startswith((b"gnss/sourcetable", b"text/"))
        self.state = "table" if is_table else "stream"

    def _refusal(self, code: bytes, status: bytes, fields: dict[bytes, bytes]) -> LinkError:
        name = self._mountpoint.name
        if code == b"401":
            return self._unauthorized()
        if code == b"403":
            return RefusedByCaster(f"this user may not use {name} (403): ask those who run the caster")
        if code == b"404":
            return RefusedByCaster(f"it has no mountpoint {name} (404): correct the name in ntrip, capitals matter")
        if code in (b"301", b"302", b"307", b"308"):
            place = _shown(fields.get(b"location", b"another address"))
            return RefusedByCaster(f"the stream is at {place} now ({code.decode()}): write that address in ntrip")
        if code[:1] == b"5":
            return LinkError(f"the caster reports an internal error ({_shown(status)})")
        return RefusedByCaster(f"it answers {_shown(status)}")

    def _unauthorized(self) -> RefusedByCaster:
        if not self._with_password:
            return RefusedByCaster(
                f"{self._mountpoint.name} needs a password (401): write the user into ntrip (ntrip://USER@HOST/...), "
                "and set password_file or password_env"
            )
        user = self._mountpoint.user or "none"
        return RefusedByCaster(
            f"user or password is wrong, or not meant for {self._mountpoint.name} (401): correct the user in ntrip "
            f"({user}), or the password in password_file or password_env"
        )

    def _take_icy_lines(self, data: bytes) -> bytes:
        """Skip lines of a head that some casters send after "ICY 200 OK", and others do not."""
        held = self._held + data
        while self.state == "icy" and held:
            line, newline, rest = held.partition(b"\n")
            if not _is_text(line) or len(line) > MAX_STATUS_BYTES:
                self.state = "stream"
            elif not newline:
                break
            else:
                held = rest
                self.state = "icy" if line.strip() else "stream"
        if self.state == "icy":
            self._held = held
            return b""
        self._held = b""
        return held

    def _no_mountpoint(self) -> RefusedByCaster:
        known, name = self._table.mountpoints, self._mountpoint.name
        if not known:
            return RefusedByCaster(
                f"it answers a text instead of the stream {name}: is there a mountpoint of this name?"
            )
        alike = sorted(known, key=lambda one: (one[:2] == name[:2], one[:1] == name[:1]), reverse=True)
        near = near_names(name, alike[:MAX_COMPARED]) or sorted(known)
        shown = [visible(one) for one in near[:SHOWN_MOUNTPOINTS]]
        more = f", and {len(known) - len(shown)} more" if len(known) > len(shown) else ""
        return RefusedByCaster(
            f"it has no mountpoint {name}, and answers the table of its {len(known)}: {', '.join(shown)}{more}"
        )


class SourceTable:
    """The names of a caster's mountpoints, read from its table: lines "STR;NAME;...". Bounded."""

    def __init__(self) -> None:
        self.mountpoints: list[str] = []
        self.complete = False
        self._line = b""
        self._bytes = 0

    def feed(self, data: bytes) -> None:
        """The next bytes of the table."""
        self._bytes += len(data)
        *lines, rest = (self._line + data).split(b"\n")
        for line in lines:
            self._take(line)
        self._line = rest[:MAX_LINE_BYTES]
        self.complete |= self._bytes > MAX_TABLE_BYTES

    def _take(self, line: bytes) -> None:
        if line.strip().upper() == b"ENDSOURCETABLE":
            self.complete = True
        kind, _, rest = line[:MAX_LINE_BYTES].partition(b";")
        if kind.strip().upper() == b"STR" and len(self.mountpoints) < MAX_MOUNTPOINTS:
            name = rest.partition(b";")[0].decode("utf-8", "replace").strip()[:MAX_SHOWN_CHARS]
            if name:
                self.mountpoints.append(name)


def _code(status: bytes) -> bytes:
    """The number in a status line of HTTP; empty if there is none."""
    return [*status.split(maxsplit=2), b"", b""][1]


def _is_text(data: bytes) -> bool:
    return all(byte < FIRST_BINARY and (byte >= 0x20 or byte in b"\t\r\n") for byte in data)


def _shown(data: bytes) -> str:
    """A text of the caster's, for a person."""
    text = data.decode("utf-8", "replace").strip()
    return f'"{visible(text[:MAX_SHOWN_CHARS])}"'
