"""Mutual TLS between ground and companion: TLS 1.3, and the one certificate that was pinned at installation.

No certificate authority takes part: each side trusts exactly the certificate it has in a file, and compares its SHA-256
with that of the one it was shown. Whoever can write these files, or read the keys, can give orders.

    on the companion                        on the ground
    --------------------------------        ----------------------------------------
    companion.crt, companion.key  ours      ground.crt, ground.key            ours
    ground.crt                    pinned    companions/NAME.crt               pinned
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs.errors import LinkError

if TYPE_CHECKING:
    import ssl

MAX_PEM_BYTES = 64 * 1024
"""A certificate has some 600 bytes."""

HANDSHAKE_S = 5.0
"""Longest time for a handshake: two round trips at 0.8 s, and a lost packet."""

PIN_LOOK_S = 1.0
"""How soon a certificate that is not pinned any more loses its open connections, on both sides."""

SHUTDOWN_S = 2.0
"""Longest time for closing a connection in order."""


@dataclass(frozen=True, slots=True)
class Identity:
    """The files of one side of a connection: our certificate and key, and the other side's certificate."""

    certificate: Path
    key: Path
    pinned: Path

    @classmethod
    def of_companion(cls, folder: Path) -> Identity:
        """On the vehicle's computer."""
        return cls(folder / "companion.crt", folder / "companion.key", folder / "ground.crt")

    @classmethod
    def of_ground(cls, folder: Path, companion: str) -> Identity:
        """On the ground, for the connection to one companion."""
        return cls(folder / "ground.crt", folder / "ground.key", folder / "companions" / f"{companion}.crt")

    def changed(self) -> object:
        """Another value after any of the files was replaced, removed or made."""
        found: list[tuple[int, int, int, int] | None] = []
        for path in (self.certificate, self.key, self.pinned):
            try:
                status = path.stat()
                found.append((status.st_ino, status.st_size, status.st_mtime_ns, status.st_mode))
            except OSError:
                found.append(None)
        return tuple(found)

    def is_unpinned(self) -> bool:
        """True if the pinned certificate is gone while our own files are there, as after its owner removed it. A file
        that cannot be read is not gone, and where our own are missing, too, nobody has removed one: a disk fails."""
        try:
            self.pinned.lstat()
        except FileNotFoundError:
            return self.certificate.is_file() and self.key.is_file()
        except OSError:
            pass
        return False


class PinnedTls:
    """A TLS context that accepts one certificate, and the check to make after each handshake
    (`client_connection.ClientTls`)."""

    handshake_s = HANDSHAKE_S
    shutdown_s = SHUTDOWN_S
    closed_early_hint = "has it pinned our ground.crt? (there: skygcs companion pin ground.crt)"

    def __init__(self, identity: Identity, *, server: bool) -> None:
        """Raises LinkError if a file is missing, not what it should be, or a key that others can read."""
        import ssl

        folder = identity.certificate.parent
        remedy = f"`skygcs companion identity {'companion' if server else 'ground'} --dir {folder}` makes it"
        name = "" if server else f" {identity.pinned.stem}"
        _require(identity.certificate, remedy)
        _require(identity.key, remedy)
        _require(
            identity.pinned, f"`skygcs companion pin FILE{name} --dir {folder}` stores the other side's certificate"
        )
        if stat.S_IMODE(identity.key.stat().st_mode) & 0o077:
            raise LinkError(f"{identity.key}: others can read this key; chmod 600 {identity.key}")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.check_hostname = False  # the certificate is pinned; addresses change
        context.verify_mode = ssl.CERT_REQUIRED
        if server:
            context.num_tickets = 0  # each connection shows its certificate
        try:
            context.load_cert_chain(identity.certificate, identity.key)
            self._pinned_sha256 = hashlib.sha256(read_certificate(identity.pinned)).digest()
            context.load_verify_locations(identity.pinned)
        except ssl.SSLError as error:
            files = f"{identity.certificate}, {identity.key} or {identity.pinned}"
            raise LinkError(f"{files} cannot be used: {error.reason or error}; make the identity again") from None
        self.context: ssl.SSLContext = context

    @property
    def pinned_fingerprint(self) -> str:
        """Fingerprint of the other side's certificate."""
        return fingerprint_text(self._pinned_sha256)

    def is_pinned(self, transport: Any) -> bool:
        """True if the other side of a connection has shown the pinned certificate itself, not one issued by it."""
        connection = transport.get_extra_info("ssl_object")
        shown = None if connection is None else connection.getpeercert(binary_form=True)
        return shown is not None and hmac.compare_digest(hashlib.sha256(shown).digest(), self._pinned_sha256)

    def is_revoked(self, identity: Identity) -> bool:
        """True if another certificate is pinned now, or none (`Identity.is_unpinned`)."""
        try:
            return hashlib.sha256(read_certificate(identity.pinned)).digest() != self._pinned_sha256
        except LinkError:
            return identity.is_unpinned()

    def explain(self, error: OSError) -> str | None:
        """Why a handshake failed and what to do; None if ``error`` is not about TLS."""
        import ssl

        if isinstance(error, ssl.SSLCertVerificationError):
            return f"it shows another certificate than the pinned one, or one that has expired ({error.verify_message})"
        if not isinstance(error, ssl.SSLError):
            return None
        alert = error.reason or str(error)
        if "ALERT" in alert:
            return f"it refuses our certificate ({alert.lower()}): pin ground.crt there with `skygcs companion pin`"
        return f"no TLS 1.3 connection ({alert.lower()})"


def read_certificate(path: Path) -> bytes:
    """The one certificate of a PEM file, as DER. Raises LinkError for anything else."""
    import ssl

    try:
        if path.stat().st_size > MAX_PEM_BYTES:
            raise LinkError(f"{path} is not a certificate: it has more than {MAX_PEM_BYTES} bytes")
        text = path.read_text(encoding="ascii")
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise LinkError(f"{path} is not a certificate in PEM format") from None
    if text.count("-----BEGIN CERTIFICATE-----") != 1 or "PRIVATE KEY" in text:
        raise LinkError(f"{path} must hold one certificate in PEM format and nothing else")
    try:
        return ssl.PEM_cert_to_DER_cert(text[text.index("-----BEGIN CERTIFICATE-----") :].strip())
    except ValueError:
        raise LinkError(f"{path} is not a certificate in PEM format") from None


def fingerprint(path: Path) -> str:
    """SHA-256 of the certificate in a PEM file, as `fingerprint_text`. Raises LinkError."""
    return fingerprint_text(hashlib.sha256(read_certificate(path)).digest())


def fingerprint_text(sha256: bytes) -> str:
    """The digest as openssl x509 -fingerprint -sha256 prints it: AB:CD:…"""
    return sha256.hex(":").upper()


def _require(path: Path, remedy: str) -> None:
    try:
        readable = os.path.isfile(path) and os.access(path, os.R_OK)
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror}") from None
    if not readable:
        raise LinkError(f"{path} is missing or cannot be read: {remedy}")
