"""The options of `skygcs web`."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest
from rich.console import Console

from skygcs.cli import demo
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


# -- `skygcs demo` without what its page needs says what to install, in full.


def test_a_plain_install_is_told_which_extra_the_page_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """It printed "needs the package aiohttp", a restart warning and two wrong hints."""
    monkeypatch.setattr(demo, "find_spec", lambda name: None)
    missing = demo._missing_page()
    console = Console(record=True, width=100)
    console.print(f"web page: {missing}", highlight=False, markup=False)
    assert "pip install 'skygcs[web]'" in console.export_text()
    monkeypatch.setattr(demo, "find_spec", lambda name: name)
    monkeypatch.setattr(demo, "is_built", lambda: False)
    assert "make web" in str(demo._missing_page())
    monkeypatch.setattr(demo, "is_built", lambda: True)
    assert demo._missing_page() is None
