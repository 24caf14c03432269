"""Host keys: the fleet's file before the user's, changes named, only what was agreed to is stored."""

from __future__ import annotations

from pathlib import Path

import asyncssh
import pytest

from skygcs.errors import ConfigError
from skygcs.ext.companions.bring_up.host_keys import HostKeys, fingerprint, refusal
from support.table import each

HOST, PORT = "10.0.0.7", 2222


def new_key() -> asyncssh.SSHKey:
    return asyncssh.generate_private_key("ssh-ed25519").convert_to_public()


def line(key: asyncssh.SSHKey, pattern: str = f"[{HOST}]:{PORT}") -> str:
    return f"{pattern} {key.export_public_key('openssh').decode().strip()}\n"


def host_keys(folder: Path) -> HostKeys:
    return HostKeys(folder, folder / "users")


def test_a_host_that_no_file_names_is_not_known(tmp_path: Path) -> None:
    known = host_keys(tmp_path).known(HOST, HOST, PORT)
    assert (known.keys, known.source) == ((), None)
    error = refusal(known, key := new_key(), "alpha", "10.0.0.7:2222")
    assert "is not known" in str(error) and fingerprint(key) in str(error) and "companions trust alpha" in error.todo


def test_the_fleets_file_counts_before_the_users(tmp_path: Path) -> None:
    old, new = new_key(), new_key()
    (tmp_path / "users").write_text(line(old))
    keys = host_keys(tmp_path)
    assert keys.known(HOST, HOST, PORT).keys == (old,)
    keys.trust(HOST, PORT, new)
    assert keys.known(HOST, HOST, PORT).keys == (new,)
    assert host_keys(tmp_path).known(HOST, "", PORT).keys == (new,)
    assert (tmp_path / "users").read_text() == line(old)


def test_a_changed_key_is_named_with_both_fingerprints(tmp_path: Path) -> None:
    old, new = new_key(), new_key()
    keys = host_keys(tmp_path)
    keys.trust(HOST, PORT, old)
    text = str(refusal(keys.known(HOST, HOST, PORT), new, "alpha", "place"))
    assert text.count("SHA256:") == 2
    assert text.index(fingerprint(old)) < text.index("now " + fingerprint(new))


def test_storing_replaces_this_host_and_keeps_the_others_and_the_comments(tmp_path: Path) -> None:
    first, second, other = new_key(), new_key(), new_key()
    (tmp_path / "known_hosts").write_text("# ours\n" + line(other, "bravo,10.0.0.8") + line(first))
    keys = host_keys(tmp_path)
    keys.trust(HOST, PORT, second)
    text = (tmp_path / "known_hosts").read_text()
    assert text.startswith("# ours\n") and keys.known("bravo", "", 22).keys == (other,)
    assert keys.known(HOST, HOST, PORT).keys == (second,)
    assert len(list(tmp_path.iterdir())) == 1


def test_a_revoked_key_stays_revoked(tmp_path: Path) -> None:
    key = new_key()
    (tmp_path / "known_hosts").write_text("@revoked " + line(key))
    keys = host_keys(tmp_path)
    keys.trust(HOST, PORT, key)
    known = keys.known(HOST, HOST, PORT)
    assert known.revoked == (key,)
    assert "revoked" in str(refusal(known, key, "alpha", "place"))


@each("data", [b"nonsense\n", b"@what host ssh-ed25519 AAAA\n", b"\xff\xfe", b"x" * (5 << 20)])
def test_a_file_that_is_none_is_refused_by_name(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "known_hosts").write_bytes(data)
    with pytest.raises(ConfigError, match="known_hosts"):
        host_keys(tmp_path)
