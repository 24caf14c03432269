"""The signals that ask a program to end in order."""

from __future__ import annotations

import signal


def ending_signals() -> list[signal.Signals]:
    """Return those by which this program is to end: SIGINT, SIGTERM, and SIGHUP, as its terminal was closed, or the
    connection to that is gone; not SIGHUP where it was begun with that ignored (nohup). `skygcs run` does not
    ask: a SIGHUP has it read its fleet file anew."""
    kept = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if kept else [signal.SIGHUP])]
