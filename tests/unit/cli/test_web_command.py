"""The options of `skygcs web`."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from skygcs.cli.web import _options, add_web
from skygcs.rpc.address import TOKEN_FILE_VARIABLE
from support.table import each


def test_a_daemon_on_tcp_is_given_its_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "token").write_text("secret\n")
    monkeypatch.setenv(TOKEN_FILE_VARIABLE, str(tmp_path / "token"))
    parser = argparse.ArgumentParser()
    add_web(parser.add_subparsers())
    options = _options(parser.parse_args(["web", "--socket", "tcp://127.0.0.1:7000", "--no-open"]))
    assert (options.socket, options.token) == ("tcp://127.0.0.1:7000", "secret")


@each("text", ["99999", "-1", "http"])
def test_a_port_that_is_none_is_a_usage_error(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    add_web(parser.add_subparsers())
    with pytest.raises(SystemExit):
        parser.parse_args(["web", f"--port={text}"])
    assert f"argument --port: '{text}' is not a port: a number from 0 to 65535" in capsys.readouterr().err


@each(
    ("terminal", "display", "opens"),
    [
        (True, {"DISPLAY": ":0"}, True),
        (True, {"WAYLAND_DISPLAY": "wayland-0"}, True),
        (True, {}, False),
        (True, {"DISPLAY": ""}, False),
        (False, {"DISPLAY": ":0"}, False),
    ],
)
def test_a_browser_is_opened_on_a_terminal_with_a_display_only(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, display: dict[str, str], opens: bool
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in display.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("os.isatty", lambda fd: terminal and fd == 1)
    parser = argparse.ArgumentParser()
    add_web(parser.add_subparsers())
    assert _options(parser.parse_args(["web"])).open_browser is opens
    for never in (["web", "--no-open"], ["web", "--supervised"]):
        assert not _options(parser.parse_args(never)).open_browser
