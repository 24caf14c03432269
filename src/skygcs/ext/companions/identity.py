"""Makes the key and certificate by which ground and companion know each other, and stores the other side's.

Needs the extra `companions` (cryptography); a daemon that only uses them does not.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from skygcs.config.files import write_whole
from skygcs.errors import LinkError, SkygcsError
from skygcs.ext.companions.tls import fingerprint, read_certificate

VALID_FROM = datetime(1970, 1, 2, tzinfo=UTC)
"""A board without a battery-backed clock starts in 1970 and has no network time on a field."""

VALID_UNTIL = datetime(2099, 12, 31, tzinfo=UTC)
"""No date ends the trust: the pin is trusted, and withdrawn by removing the file."""


def make_identity(folder: Path, role: str) -> tuple[str, bool]:
    """ROLE.crt and ROLE.key in this folder, made unless they are there; returns the certificate's fingerprint and
    whether it was made now. The key has mode 0600 from its first byte. Raises SkygcsError."""
    certificate, key = folder / f"{role}.crt", folder / f"{role}.key"
    if certificate.exists() and key.exists():
        return fingerprint(certificate), False
    if certificate.exists() or key.exists():
        there, missing = (certificate, key) if certificate.exists() else (key, certificate)
        raise LinkError(f"{there} is there and {missing} is not: put it back, or remove the other and pin anew")
    key_pem, certificate_pem = _new_pair(f"skygcs {role}")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(key, key_pem, 0o600)
        write_whole(certificate, certificate_pem, 0o644)
    except OSError as error:
        raise LinkError(f"{folder}: {error.strerror}") from None
    return fingerprint(certificate), True


def pin(source: Path, target: Path, *, force: bool = False) -> str:
    """Store the certificate in ``source`` as ``target``; returns its fingerprint. Raises LinkError if another one is
    pinned there and not ``force``, or the file holds no certificate."""
    read_certificate(source)
    if target.exists() and not force and read_certificate(target) != read_certificate(source):
        raise LinkError(
            f"{target} pins another certificate ({fingerprint(target)}); --force replaces it, if the other side has "
            "been installed anew"
        )
    try:
        target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(target, source.read_bytes(), 0o644)
    except OSError as error:
        raise LinkError(f"{target}: {error.strerror}") from None
    return fingerprint(target)


def _new_pair(common_name: str) -> tuple[bytes, bytes]:
    """A new key and its self-signed certificate, as PEM."""
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import NameOID
    except ImportError:
        raise SkygcsError('this needs the extra "companions": pip install "skygcs[companions]"') from None
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(VALID_FROM)
        .not_valid_after(VALID_UNTIL)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    encoded = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return encoded, certificate.public_bytes(serialization.Encoding.PEM)
