"""The capture process: ``python -m skygcs.ext.mocap.worker`` with a system's type and address, or a recording.

It writes frames of the named bodies, and what it does, as lines of `ext.mocap.recording` on its standard output. A
reader that is slow loses frames, which are counted, and never gets an old one. It ends with its parent, also amid a
call of `motioncapture` that does not return.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import os
import signal
import sys
import time
from pathlib import Path

from skygcs.ext.mocap.recording import frame_lines, state_line
from skygcs.ext.mocap.source import SYSTEMS, CaptureError, RecordedSource, SystemSource, only

PR_SET_PDEATHSIG = 1
"""prctl(2): the signal that this process gets when its parent ends."""

FAILED, WRONG = 1, 2
"""Exit codes: the system cannot be read; the arguments are wrong."""

REPORT_S = 5.0
"""Between two lines that say that frames were lost."""


class LineWriter:
    """Whole lines into a pipe that may be full; those that do not fit are counted and dropped."""

    def __init__(self, fd: int) -> None:
        os.set_blocking(fd, False)
        self._fd = fd
        self.dropped = 0

    def write(self, line: bytes) -> None:
        """A line of at most PIPE_BUF bytes: written as a whole, or not at all. Raises BrokenPipeError."""
        try:
            os.write(self._fd, line)
        except BlockingIOError:
            self.dropped += 1


def main(arguments: list[str] | None = None) -> int:
    """Read until the recording ends, the system fails or the reader is gone."""
    options = _parser().parse_args(arguments)
    _end_with_parent()
    # the libraries beneath write to standard output themselves; that goes to standard error
    lines = LineWriter(os.dup(sys.stdout.fileno()))
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    source: SystemSource | RecordedSource
    if options.file is not None:
        source = RecordedSource(options.file, options.loop)
    else:
        source = SystemSource(options.system, options.host, options.port)
    with contextlib.suppress(BrokenPipeError):
        lines.write(state_line("connecting", source.label))
        return _read(source, frozenset(options.body), lines)
    return 0


def _read(source: SystemSource | RecordedSource, names: frozenset[str], lines: LineWriter) -> int:
    connected, reported, next_report = False, 0, time.monotonic() + REPORT_S
    try:
        for at, bodies in source.frames():
            if not connected:
                connected = True
                seen = ", ".join(sorted(bodies)[:20]) or "none yet"
                lines.write(state_line("connected", f"{source.label}; rigid bodies: {seen}"))
            for line in frame_lines(at, only(bodies, names)):
                lines.write(line)
            if lines.dropped > reported and time.monotonic() >= next_report:
                print(f"{lines.dropped - reported} lines were dropped: the reader is too slow", file=sys.stderr)
                reported, next_report = lines.dropped, time.monotonic() + REPORT_S
    except CaptureError as error:
        lines.write(state_line("failed", str(error)))
        return FAILED
    lines.write(state_line("ended", source.label))
    return 0


def _end_with_parent() -> None:
    """SIGTERM and the end of the parent kill at once: a handler in Python would wait for the call that blocks."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
    if sys.platform == "linux":
        parent = os.getppid()
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended in between
            os.kill(os.getpid(), signal.SIGKILL)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="skygcs.ext.mocap.worker")
    parser.add_argument("--system", choices=SYSTEMS)
    parser.add_argument("--host", default="localhost")
    parser.add_argument("--port", type=int)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--loop", action="store_true")
    parser.add_argument("--body", action="append", default=[])
    return parser


if __name__ == "__main__":
    sys.exit(main())
