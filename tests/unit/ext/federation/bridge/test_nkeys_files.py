"""Files with a station's key."""

from __future__ import annotations

import os
from pathlib import Path

import nkeys
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import KeyFileError
from skygcs.ext.federation.bridge.nkeys_files import new_key, read_seed, write_new_seed


def test_a_new_key_is_readable_by_its_owner_alone_and_signs(tmp_path: Path) -> None:
    path = tmp_path / "north.nk"
    before = os.umask(0)
    try:
        public_key = write_new_seed(path)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o600
    key = read_seed(path)
    assert key.public_key == public_key and len(public_key) == 56 and public_key.startswith("U")
    assert nkeys.from_seed(bytearray(key.seed.encode())).verify(
        b"x", nkeys.from_seed(bytearray(key.seed, "ascii")).sign(b"x")
    )


def test_a_key_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "north.nk"
    write_new_seed(path)
    text = path.read_text()
    with pytest.raises(KeyFileError, match="is not overwritten"):
        write_new_seed(path)
    assert path.read_text() == text


def test_a_key_that_others_may_read_and_what_is_no_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "north.nk"
    with pytest.raises(KeyFileError, match=r"does not exist; make it: skygcs federation keys north"):
        read_seed(path)
    write_new_seed(path)
    path.chmod(0o640)
    with pytest.raises(KeyFileError, match="others can read or change it"):
        read_seed(path)
    path.chmod(0o600)
    seed = path.read_text()
    for wrong in (
        *("", "SUAB", seed[:-5], seed[:20] + ("A" if seed[20] != "A" else "B") + seed[21:], seed * 2, seed.lower()),
        new_key().public_key,
        nkeys.encode_seed(bytes(32), nkeys.PREFIX_BYTE_ACCOUNT).decode(),
    ):
        path.write_text(wrong)
        with pytest.raises(KeyFileError, match="holds no seed of a key") as caught:
            read_seed(path)
        assert len(wrong) < 5 or wrong not in str(caught.value)
    path.unlink()
    os.mkfifo(path, 0o600)
    with pytest.raises(KeyFileError):
        read_seed(path)


@given(data=st.binary(max_size=200))
def test_any_content_is_a_key_or_an_error(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.nk"
    path.write_bytes(data)
    path.chmod(0o600)
    with pytest.raises(KeyFileError):
        read_seed(path)
