"""The page of `skygcs demo`: its address is printed, and opened only on a terminal with a display."""

from __future__ import annotations

import contextlib
import http.client
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from support.hanging import HANG_S

pytestmark = pytest.mark.system

PROGRAM = f"""
import sys
from skygcs.cli import demo, serve, web
demo.is_built = lambda: True
web.LINK_WITHIN_S = {HANG_S}
sys.exit(serve.main())
"""
"""`skygcs`, with a page whether it was built or not, and however long it takes to start."""

ADDRESS = re.compile(rb"web page: (http://127\.0\.0\.1:\d+/\?token=[\w-]+)")
QUIET_S = 3.0
"""After the address was printed a browser is opened at once, if one is."""


@contextlib.contextmanager
def demo(folder: Path, *, terminal: bool, display: bool) -> Iterator[tuple[str, Path]]:
    """The demo until it has printed its address, which is given with the file that the browser writes."""
    browser, opened = folder / "browser", folder / "opened"
    browser.write_text(f'#!/bin/sh\necho "$1" >> {opened}\n')
    browser.chmod(0o700)
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"BROWSER": f"{browser} %s", "XDG_RUNTIME_DIR": str(folder), "TERM": "xterm"}
    environment |= {"DISPLAY": ":99"} if display else {}
    ours, theirs = pty.openpty() if terminal else os.pipe()
    line = [sys.executable, "-c", PROGRAM, "demo", "--log-dir", str(folder / "logs")]
    process = subprocess.Popen(
        line, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=environment, cwd=folder
    )
    os.close(theirs)
    try:
        yield _address(ours, process), opened
    finally:
        process.send_signal(signal.SIGHUP if terminal else signal.SIGINT)
        deadline = time.monotonic() + HANG_S
        while process.poll() is None and time.monotonic() < deadline:
            _read(ours)  # a full pipe would hold it
        os.close(ours)
        process.kill()
        process.wait()


def _address(source: int, process: subprocess.Popen[bytes]) -> str:
    shown, deadline = b"", time.monotonic() + HANG_S
    while (found := ADDRESS.search(shown)) is None:
        assert process.poll() is None and time.monotonic() < deadline, shown.decode(errors="replace")
        shown += _read(source)
    return found[1].decode()


def _read(source: int) -> bytes:
    ready, _, _ = select.select([source], [], [], 0.2)
    try:
        return os.read(source, 65536) if ready else b""
    except OSError:  # a terminal whose other end has closed
        return b""


def status(address: str) -> int:
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=HANG_S)
    connection.request("GET", f"/?{parts.query}")
    with contextlib.closing(connection):
        return connection.getresponse().status


def test_on_a_terminal_with_a_display_it_opens_an_address_and_prints_another(tmp_path: Path) -> None:
    with demo(tmp_path, terminal=True, display=True) as (address, opened):
        deadline = time.monotonic() + HANG_S
        while not (opened.exists() and opened.read_text().endswith("\n")):
            assert time.monotonic() < deadline, "no browser was started"
            time.sleep(0.1)
        (given,) = opened.read_text().split()
        assert given.partition("?")[0] == address.partition("?")[0] and given != address
        assert [status(each) for each in (given, address, given)] == [303, 303, 403]


@pytest.mark.parametrize(("terminal", "display"), [(True, False), (False, True)])
def test_elsewhere_it_prints_the_address_and_opens_nothing(tmp_path: Path, terminal: bool, display: bool) -> None:
    with demo(tmp_path, terminal=terminal, display=display) as (address, opened):
        assert status(address) == 303
        time.sleep(QUIET_S)
        assert not opened.exists()
