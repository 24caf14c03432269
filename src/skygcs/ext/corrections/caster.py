"""The connection to a caster: TCP or TLS, the request, the stream, and a vehicle's position now and then."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from skygcs.config.files import open_regular
from skygcs.errors import LinkError, explain_address_error
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.feeder import flow_of
from skygcs.ext.corrections.gga import GgaPosition, gga_sentence
from skygcs.ext.corrections.ntrip import NtripAnswer, request

if TYPE_CHECKING:
    import ssl

    from skygcs.ext.corrections.feeder import Feeder

CONNECT_S = 10.0
"""Time for name, TCP and TLS: a caster on another continent, over a phone."""

ANSWER_S = 10.0
"""From the request to the first byte of the stream, or to the end of its table of mountpoints."""

READ_BYTES = 4096

BUFFER_BYTES = 16384
"""asyncio stops reading when it holds twice as many."""

MAX_UNSENT_BYTES = 4096
"""Positions that a caster has not taken."""

PLACE_AGAIN_S = 1.0
"""Between two looks for a vehicle with a position."""

MAX_PASSWORD_BYTES = 1024


class CasterSource:
    """A stream of one caster. ``place(last)`` is where a virtual station is wanted, None as long as nobody knows;
    ``last``: the source of the place before."""

    kind: Literal["ntrip"] = "ntrip"

    def __init__(
        self,
        config: CorrectionsConfig,
        place: Callable[[str | None], GgaPosition | None],
        clock: Callable[[], float],
    ) -> None:
        self._config = config
        self._place = place
        self._clock = clock
        self._mountpoint = config.mountpoint
        self.name = self._mountpoint.text
        self.revision = 0
        self._gga_from: str | None = None
        self._gga_sent = 0
        self._gga_at: float | None = None

    async def run(self, feeder: Feeder) -> None:
        """One connection, to its end. Raises LinkError."""
        host, port = self._mountpoint.host, self._mountpoint.port
        password = read_password(self._config)
        tls = await self._tls() if self._mountpoint.tls else None
        try:
            async with asyncio.timeout(CONNECT_S):
                reader, writer = await asyncio.open_connection(
                    host, port, ssl=tls, limit=BUFFER_BYTES, ssl_handshake_timeout=None if tls is None else CONNECT_S
                )
        except TimeoutError:
            raise LinkError(
                f"no connection within {CONNECT_S:g} s: is the network up, and {host}:{port} right?"
            ) from None
        except (OSError, UnicodeError) as error:
            raise LinkError(_why(error, host, port, tls=tls is not None)) from None
        try:
            await self._talk(feeder, reader, writer, password)
        except OSError as error:
            raise LinkError(f"the connection broke: {_why(error, host, port, tls=tls is not None)}") from None
        finally:
            writer.transport.abort()

    def status(self, now: float) -> dict[str, Any]:
        """``gga``: whose position was sent; ``survey`` is a receiver's."""
        gga = {
            "from": self._gga_from,
            "sent": self._gga_sent,
            "age_s": None if self._gga_at is None else round(now - self._gga_at, 1),
        }
        return {"gga": gga if self._config.gga_s else None, "survey": None}

    # -- the inside

    async def _talk(
        self, feeder: Feeder, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, password: str
    ) -> None:
        config = self._config
        # request
        begun = self._clock()
        gga = self._next_gga() if config.revision == 2 else b""
        writer.write(request(self._mountpoint, password, revision=config.revision, gga=gga))
        answer = NtripAnswer(self._mountpoint, with_password=bool(password))
        due = heard = begun
        streams = False
        flow = flow_of(begun)
        while True:
            # until its answer, the next byte or the next position that is due
            now = self._clock()
            until = heard + config.silent_s if streams else begun + ANSWER_S
            if streams and config.gga_s and now >= due:
                due = now + (config.gga_s if self._send_gga(writer) else PLACE_AGAIN_S)
            data = await self._read(reader, min(until, due) - now if streams and config.gga_s else until - now)
            if data == b"":
                raise answer.ended()
            if data is None:
                if self._clock() >= until:
                    raise self._silence(answer, streams)
                continue
            content = answer.feed(data)
            heard = self._clock()
            flow.spend(len(data), heard)
            if answer.state == "stream" and not streams:
                streams = True
                self.revision = answer.revision
                feeder.connected()
            if content:
                feeder.take(content)
            # bytes that wait already are read without a pause in which the loop does something else
            await asyncio.sleep(max(flow.ready_at(0.0, heard) - heard, 0.0))

    async def _read(self, reader: asyncio.StreamReader, wait_s: float) -> bytes | None:
        """The next bytes; None: nothing within that time; b"": the end."""
        try:
            async with asyncio.timeout(max(wait_s, 0.001)):
                return await reader.read(READ_BYTES)
        except TimeoutError:
            return None

    def _silence(self, answer: NtripAnswer, streams: bool) -> LinkError:
        if not streams:
            if answer.state in ("head", "table"):
                return answer.ended()
            return LinkError(f"no answer within {ANSWER_S:g} s: is this address an NTRIP caster's?")
        why = f"the caster was silent for {self._config.silent_s:g} s"
        if self._config.gga_s and not self._gga_sent:
            why += (
                ": if it is a virtual station, it waits for a position, and no vehicle has one (nor is there [origin])"
            )
        return LinkError(why)

    def _next_gga(self) -> bytes:
        """The sentence of the place now; empty if there is none."""
        if not self._config.gga_s or (place := self._place(self._gga_from)) is None:
            return b""
        self._gga_from = place.source
        self._gga_at = self._clock()
        self._gga_sent += 1
        return gga_sentence(place, time.time())

    def _send_gga(self, writer: asyncio.StreamWriter) -> bool:
        """True if there was a place to send. Raises LinkError if the caster takes nothing."""
        if writer.transport.get_write_buffer_size() > MAX_UNSENT_BYTES:
            raise LinkError("the caster accepts no positions: its connection is stuck")
        sentence = self._next_gga()
        if sentence:
            writer.write(sentence)
        return bool(sentence)

    async def _tls(self) -> ssl.SSLContext:
        """A context that checks the caster's certificate and name. Reading the system's takes 30 ms: in a thread."""
        return await asyncio.to_thread(tls_context, self._config.ca_file)


def tls_context(ca_file: Path | None) -> ssl.SSLContext:
    """Certificates of the system, or those of a file alone. Raises LinkError if the file is none."""
    import ssl

    try:
        context = ssl.create_default_context(cafile=None if ca_file is None else str(ca_file))
    except ssl.SSLError:
        raise LinkError(f"ca_file {ca_file}: holds no certificates in PEM format") from None
    except OSError as error:
        raise LinkError(f"ca_file {ca_file}: {error.strerror}") from None
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    return context


def read_password(config: CorrectionsConfig) -> str:
    """The password; "" if the table names none. Read for each connection, so that it can be put right without a
    restart. Raises LinkError, which never holds anything of it."""
    if config.password_env is not None:
        password = os.environ.get(config.password_env, "")
        if not password:
            raise LinkError(f"the environment variable {config.password_env} (password_env) is not set")
        # bytes that are no UTF-8 are not printable
        if len(password) > MAX_PASSWORD_BYTES or not password.isprintable():
            raise LinkError(f"the environment variable {config.password_env} (password_env) holds no password")
        return password
    path = config.password_file
    if path is None:
        return ""
    try:
        with open_regular(path) as file:
            mode = os.fstat(file.fileno()).st_mode
            raw = file.read(MAX_PASSWORD_BYTES + 1)
    except OSError as error:
        raise LinkError(f"password_file {path}: {error.strerror}") from None
    if mode & 0o077:
        raise LinkError(f"password_file {path}: others can read it; chmod 600 {path}")
    try:
        password = raw.decode().strip()
    except UnicodeDecodeError:
        raise LinkError(f"password_file {path}: is not text") from None
    if not password or len(raw) > MAX_PASSWORD_BYTES or not password.isprintable():
        raise LinkError(f"password_file {path}: must hold one line, the password")
    return password


def _why(error: OSError | UnicodeError, host: str, port: int, *, tls: bool) -> str:
    """Why a connection failed, and what to do."""
    if isinstance(error, UnicodeError):
        return f"{host} is not the name of a computer"
    if tls:
        import ssl

        if isinstance(error, ssl.SSLCertVerificationError):
            return (
                f"its certificate is not accepted ({error.verify_message}): check the host's name and this computer's "
                "clock; for a caster with a certificate of its own set ca_file"
            )
        if isinstance(error, ssl.SSLError):
            return f"no TLS there ({(error.reason or str(error)).lower()}): write ntrip:// if it speaks none"
    import socket

    if isinstance(error, socket.gaierror):
        return f"{host}: the name has no address ({str(error.strerror).lower()}); check spelling and network"
    return explain_address_error(error, host, port)
