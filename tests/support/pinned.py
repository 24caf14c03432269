"""Identities of a ground station and a companion that trust each other, and certificates that they must not trust."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from skygcs.ext.companions.identity import make_identity, pin
from skygcs.ext.companions.tls import Identity

NAME = "alpha"
LONG_AGO = datetime(2001, 1, 1, tzinfo=UTC)
FAR_AHEAD = datetime(2099, 1, 1, tzinfo=UTC)


def make_pair(ground: Path, companion: Path) -> tuple[Identity, Identity]:
    """Both sides in their folders, each pinned by the other: (the ground's, the companion's)."""
    make_identity(ground, "ground")
    make_identity(companion, "companion")
    pin(companion / "companion.crt", ground / "companions" / f"{NAME}.crt")
    pin(ground / "ground.crt", companion / "ground.crt")
    return Identity.of_ground(ground, NAME), Identity.of_companion(companion)


class Issuer:
    """Makes certificates as a test wants them, itself the issuer of further ones."""

    def __init__(self, *, until: datetime = FAR_AHEAD) -> None:
        self.key = ec.generate_private_key(ec.SECP256R1())
        self.name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "skygcs ground")])
        self.certificate = self._signed(self.key, self.name, until, ca=True)

    def _signed(
        self, key: ec.EllipticCurvePrivateKey, subject: x509.Name, until: datetime, *, ca: bool
    ) -> x509.Certificate:
        return (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(self.name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(datetime(2000, 1, 1, tzinfo=UTC))
            .not_valid_after(until)
            .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
            .sign(self.key, hashes.SHA256())
        )

    def write(self, folder: Path, role: str) -> None:
        """Its own certificate and key, as ROLE.crt and ROLE.key."""
        _write(folder, role, self.certificate, self.key)

    def write_issued(self, folder: Path, role: str) -> None:
        """A certificate that it has issued, with a key of its own."""
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "somebody else")])
        _write(folder, role, self._signed(key, subject, FAR_AHEAD, ca=False), key)


def _write(folder: Path, role: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    key_file = folder / f"{role}.key"
    key_file.write_bytes(pem)
    key_file.chmod(0o600)
    (folder / f"{role}.crt").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
