"""Where clients find the daemon, and its token."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.errors import SkygcsError
from skygcs.rpc.address import TOKEN_FILE_VARIABLE, client_token


def test_the_token_is_read_from_the_file_that_the_environment_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TOKEN_FILE_VARIABLE, raising=False)
    assert client_token() is None
    file = tmp_path / "token"
    file.write_text("secret\n")
    monkeypatch.setenv(TOKEN_FILE_VARIABLE, str(file))
    assert client_token() == "secret"
    file.unlink()
    with pytest.raises(SkygcsError, match=f"cannot read the token file {file}"):
        client_token()
