"""Key files: what they may hold, who may read them, and that no message ever tells what is in one."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skygcs.config.loader import load_fleet
from skygcs.config.signing import read_key, write_new_key
from skygcs.core.mavlink.signing import key_from_passphrase
from skygcs.errors import ConfigError, KeyFileError
from support.table import each

KEY = bytes.fromhex("c0ffee" + "5a" * 28 + "80")


def written(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@each(
    ("content", "key"),
    [
        (KEY, KEY),
        (KEY.hex().encode(), KEY),
        (KEY.hex().upper().encode() + b"\r\n", KEY),
        (b"passphrase: correct horse battery staple\n", key_from_passphrase("correct horse battery staple")),
        ("passphrase:schlüssel".encode(), key_from_passphrase("schlüssel")),
    ],
    ids=["raw", "hex", "hex of Windows", "words", "words not of ASCII"],
)
def test_what_a_key_file_may_hold(tmp_path: Path, content: bytes, key: bytes) -> None:
    assert read_key(written(tmp_path, content)) == key


@each(
    ("content", "why"),
    [
        (b"", "neither 32 bytes nor 64"),
        (b"only words here of 32 characters", "neither 32 bytes nor 64 hexadecimal digits; a passphrase is written"),
        (KEY[:31], "holds 31 bytes"),
        (KEY + b"\n", "holds 33 bytes"),
        (KEY.hex()[:-1].encode() + b"g", "neither"),
        (bytes(32), "all zeros"),
        (b"0" * 64, "all zeros"),
        (b"passphrase:  \n", "no words"),
        (b"x" * 5000, "longer than 4096"),
    ],
)
def test_what_is_no_key_is_refused_without_telling_it(tmp_path: Path, content: bytes, why: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(KeyFileError, match=why) as caught:
        read_key(path)
    assert str(path) in str(caught.value)
    assert content[:16].hex() not in str(caught.value) or not content.strip(b"0\0")
    assert "only words" not in str(caught.value)


@given(st.binary(max_size=80))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_file_gives_32_bytes_or_a_reason(tmp_path: Path, content: bytes) -> None:
    path = written(tmp_path, content)
    try:
        assert len(read_key(path)) == 32
    except KeyFileError as error:
        assert error.reason


@each("mode", [0o644, 0o640, 0o604, 0o620, 0o601, 0o777])
def test_a_file_others_can_read_or_change_is_refused(tmp_path: Path, mode: int) -> None:
    path = written(tmp_path, KEY, mode)
    with pytest.raises(KeyFileError, match=f"mode {mode:04o}.*run: chmod 600 {path}"):
        read_key(path)


def test_a_file_that_is_not_there_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match="no such file or directory; make one with: skygcs-cli signing key"):
        read_key(tmp_path / "none")
    (tmp_path / "folder").mkdir(mode=0o700)
    with pytest.raises(KeyFileError, match="is a directory"):
        read_key(tmp_path / "folder")


def test_a_new_key_is_private_and_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "new"
    key = write_new_key(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert read_key(path) == key
    with pytest.raises(KeyFileError, match="exists"):
        write_new_key(path)
    assert read_key(path) == key
    assert write_new_key(tmp_path / "second") != key
    with pytest.raises(KeyFileError, match="cannot be written: No such file"):
        write_new_key(tmp_path / "none" / "key")


def problems(folder: Path, text: str) -> list[str]:
    path = folder / "fleet.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_fleet(path)
    return caught.value.problems


def test_a_relative_key_file_begins_at_the_fleet_file(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text('[links.a]\ntype = "memory"\n[links.a.signing]\nkey_file = "keys/lab"\n')
    settings = load_fleet(path).links["a"].signing
    assert settings is not None
    assert settings.key_file == tmp_path / "keys" / "lab"


def test_wrong_keys_of_the_table_are_told_with_their_line(tmp_path: Path) -> None:
    text = """[links.a]
type = "memory"
[links.a.signing]
key_fil = "k"
key_file = "k"
link_id = 256
[links.b]
type = "memory"
[links.b.signing]
key_file = "k"
accept_unsigned = ["RADIO_STATS"]
[links.c]
type = "replay"
file = "x"
[links.c.signing]
key_file = "k"
"""
    found = problems(tmp_path, text)
    assert "links.a.signing.key_fil (line 4): unknown key; did you mean key_file?" in found
    assert "links.a.signing.link_id (line 6): must be at most 255, not 256" in found
    assert any("accept_unsigned[0] (line 11): the dialect has no message RADIO_STATS; did you mean" in p for p in found)
    assert any(p.startswith("links.c.signing (line 15): a recording cannot be checked") for p in found)


def test_two_links_of_one_key_need_two_ids(tmp_path: Path) -> None:
    link = '[links.{0}]\ntype = "memory"\n[links.{0}.signing]\nkey_file = "k"\n'
    assert problems(tmp_path, link.format("a") + link.format("b")) == [
        "links.b.signing.link_id (line 7): 0 is already the link_id of links.a, "
        "which has the same key; give each link its own"
    ]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_a_file_of_another_user_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, KEY)
    os.chown(path, 12345, -1)
    with pytest.raises(KeyFileError, match="belongs to another user"):
        read_key(path)
