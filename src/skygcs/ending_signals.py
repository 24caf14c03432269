"""The signals that ask a program to end in order."""

from __future__ import annotations

import signal


def ending_signals() -> list[signal.Signals]:
    """SIGINT, SIGTERM, and SIGHUP: the terminal was closed, or the connection to it is gone. A program that was begun
    with SIGHUP ignored (nohup) goes on."""
    kept = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if kept else [signal.SIGHUP])]
