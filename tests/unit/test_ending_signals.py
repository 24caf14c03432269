"""A closed terminal ends a program in order, unless nohup began it."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

PROGRAM = "from skygcs.ending_signals import ending_signals; print(*(number.name for number in ending_signals()))"


@pytest.mark.parametrize(("trap", "asked"), [("-", "SIGINT SIGTERM SIGHUP"), ("''", "SIGINT SIGTERM")])
def test_a_closed_terminal_ends_a_program_that_nohup_did_not_begin(trap: str, asked: str) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a shell cannot take it back where it is ignored
    try:
        line = ["/bin/sh", "-c", f'trap {trap} HUP; exec "$@"', "sh", sys.executable, "-c", PROGRAM]
        assert subprocess.run(line, check=True, capture_output=True, text=True).stdout.strip() == asked
    finally:
        signal.signal(signal.SIGHUP, before)
