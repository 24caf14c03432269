"""Keys and certificates of ground and companion: made once, kept from others, and pinned on purpose only."""

from __future__ import annotations

import stat
import subprocess
from pathlib import Path

import pytest
from cryptography import x509

from skygcs.cli.serve import main
from skygcs.errors import LinkError
from skygcs.ext.companions.identity import make_identity, pin
from skygcs.ext.companions.tls import fingerprint
from support.table import each


def test_an_identity_is_made_once_and_its_key_is_ours_alone(tmp_path: Path) -> None:
    shown, made = make_identity(tmp_path / "keys", "companion")
    key = (tmp_path / "keys" / "companion.key").read_bytes()
    assert made
    assert stat.S_IMODE((tmp_path / "keys" / "companion.key").stat().st_mode) == 0o600
    assert stat.S_IMODE((tmp_path / "keys").stat().st_mode) == 0o700
    assert make_identity(tmp_path / "keys", "companion") == (shown, False)
    assert (tmp_path / "keys" / "companion.key").read_bytes() == key
    assert make_identity(tmp_path / "keys", "ground")[0] != shown


def test_the_certificate_holds_with_a_clock_that_starts_in_1970(tmp_path: Path) -> None:
    make_identity(tmp_path, "companion")
    certificate = x509.load_pem_x509_certificate((tmp_path / "companion.crt").read_bytes())
    assert certificate.not_valid_before_utc.year == 1970
    assert certificate.not_valid_after_utc.year == 2099
    assert certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False


def test_the_fingerprint_is_the_one_that_openssl_prints(tmp_path: Path) -> None:
    shown, _ = make_identity(tmp_path, "ground")
    command = ["openssl", "x509", "-in", str(tmp_path / "ground.crt"), "-noout", "-fingerprint", "-sha256"]
    try:
        printed = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True).stdout
    except FileNotFoundError:
        certificate = x509.load_pem_x509_certificate((tmp_path / "ground.crt").read_bytes())
        from cryptography.hazmat.primitives import hashes

        printed = "=" + certificate.fingerprint(hashes.SHA256()).hex(":").upper()
    assert printed.strip().partition("=")[2] == shown


def test_half_an_identity_is_not_replaced(tmp_path: Path) -> None:
    make_identity(tmp_path, "ground")
    (tmp_path / "ground.crt").unlink()
    with pytest.raises(LinkError, match=r"ground.key is there and .*ground.crt is not"):
        make_identity(tmp_path, "ground")


def test_another_certificate_is_pinned_only_by_force(tmp_path: Path) -> None:
    make_identity(tmp_path / "a", "companion")
    make_identity(tmp_path / "b", "companion")
    target = tmp_path / "keys" / "companions" / "alpha.crt"
    first = pin(tmp_path / "a" / "companion.crt", target)
    assert pin(tmp_path / "a" / "companion.crt", target) == first  # again: nothing to do
    with pytest.raises(LinkError, match="--force"):
        pin(tmp_path / "b" / "companion.crt", target)
    assert fingerprint(target) == first
    assert pin(tmp_path / "b" / "companion.crt", target, force=True) == fingerprint(tmp_path / "b" / "companion.crt")


def test_a_key_is_never_pinned_and_never_copied(tmp_path: Path) -> None:
    make_identity(tmp_path, "ground")
    both = tmp_path / "both.pem"
    both.write_bytes((tmp_path / "ground.crt").read_bytes() + (tmp_path / "ground.key").read_bytes())
    for wrong in (tmp_path / "ground.key", both, tmp_path / "absent.crt", tmp_path):
        with pytest.raises(LinkError):
            pin(wrong, tmp_path / "pinned.crt")
    assert not (tmp_path / "pinned.crt").exists()


@each("content", [b"", b"\0" * 100, b"\xff", b"-----BEGIN CERTIFICATE-----\n", b"x" * 100_000])
def test_what_is_no_certificate_is_named(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.crt").write_bytes(content)
    with pytest.raises(LinkError, match="certificate"):
        fingerprint(tmp_path / "x.crt")


def test_a_full_disk_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("skygcs.config.files.os.fsync", full)
    with pytest.raises(LinkError, match="No space left"):
        make_identity(tmp_path, "ground")
    assert list(tmp_path.iterdir()) == []


# -- `skygcs companion identity|pin|show`.


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["companion", *words])
    return int(ended.value.code or 0)


def test_both_sides_exchange_their_certificates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ground, vehicle = tmp_path / "ground", tmp_path / "vehicle"
    assert run("identity", "ground", "--dir", str(ground)) == 0
    assert run("identity", "companion", "--dir", str(vehicle)) == 0
    assert run("identity", "companion", "--dir", str(vehicle)) == 0
    assert "is there already" in capsys.readouterr().out
    assert run("pin", str(ground / "ground.crt"), "--dir", str(vehicle)) == 0
    assert run("pin", str(vehicle / "companion.crt"), "alpha", "--dir", str(ground)) == 0
    assert (vehicle / "ground.crt").read_bytes() == (ground / "ground.crt").read_bytes()
    assert (ground / "companions" / "alpha.crt").read_bytes() == (vehicle / "companion.crt").read_bytes()
    printed = capsys.readouterr().out
    assert run("show", "--dir", str(ground)) == 0
    shown = capsys.readouterr().out
    assert "companions/alpha.crt" in shown and shown.count("SHA-256") == 2
    assert all(line.split()[-1] in printed for line in shown.splitlines())


@each(
    ("words", "reason"),
    [
        (("pin", "{ground}/ground.crt", "--dir", "{ground}"), "name the companion"),
        (("pin", "{ground}/ground.crt", "../x", "--dir", "{ground}"), "is not a companion's name"),
        (("pin", "{ground}/ground.key", "alpha", "--dir", "{ground}"), "one certificate in PEM format"),
        (("pin", "{ground}/absent", "alpha", "--dir", "{ground}"), "No such file"),
        (("show", "--dir", "{ground}/none"), "no certificate in"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
    words: tuple[str, ...], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("identity", "ground", "--dir", str(tmp_path)) == 0
    capsys.readouterr()
    assert run(*(word.format(ground=tmp_path) for word in words)) == 1
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1 and error.startswith("skygcs: ")
