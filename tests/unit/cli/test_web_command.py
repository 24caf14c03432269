"""The options of `skygcs web`."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from skygcs.cli.web import _options, add_web
from skygcs.rpc.address import TOKEN_FILE_VARIABLE


def test_a_daemon_on_tcp_is_given_its_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "token").write_text("secret\n")
    monkeypatch.setenv(TOKEN_FILE_VARIABLE, str(tmp_path / "token"))
    parser = argparse.ArgumentParser()
    add_web(parser.add_subparsers())
    options = _options(parser.parse_args(["web", "--socket", "tcp://127.0.0.1:7000", "--no-open"]))
    assert (options.socket, options.token) == ("tcp://127.0.0.1:7000", "secret")
