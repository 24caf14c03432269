"""The stderr of a process whose pipe is full and that nobody reads: whatever prints there does not hold it up."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys

import pytest

BEGIN = """
import asyncio, gc, logging, os, signal, sys, threading, traceback, warnings
from skygcs.cli.process import configure_logging, import_structlog
configure_logging()
structlog = import_structlog()
class Fails:
    def __del__(self):
        raise RuntimeError("in a finalizer")
def fails():
    raise RuntimeError("in a thread")
async def nothing():
    pass
"""

WRITES = {
    "a warning": "warnings.warn('of a library')",
    "a finalizer": "Fails()",
    "a coroutine that was never awaited": "nothing(); gc.collect()",
    "a thread that fails": "t = threading.Thread(target=fails); t.start(); t.join()",
    "a traceback": "\ntry:\n    fails()\nexcept RuntimeError:\n    traceback.print_exc()",
    "a print": "print('x' * 5000, file=sys.stderr, flush=True)",
    "the log": "structlog.get_logger('x').warning('a line')",
    "a log of a library": "logging.getLogger('y').warning('a line')",
    "a log that fails": "logging.getLogger('y').warning('%d', 'no number')",
}

PIPE_BYTES = 4096


def started(program: str, *, full: bool) -> tuple[subprocess.Popen[bytes], int]:
    """A process of this program, and the end of its stderr that nobody reads."""
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    if full:
        os.write(writer, b"z" * PIPE_BYTES)
    process = subprocess.Popen([sys.executable, "-c", BEGIN + program], stderr=writer, stdout=subprocess.DEVNULL)
    os.close(writer)
    return process, reader


def ended(process: subprocess.Popen[bytes]) -> int:
    """Its exit code."""
    try:
        return process.wait(120)  # it would never end
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("what", ["all of them", *WRITES])
def test_whatever_prints_to_a_full_pipe_does_not_hold_the_process_up(what: str) -> None:
    lines = [WRITES[what]] if what in WRITES else list(WRITES.values())
    process, reader = started("\n".join([*lines, "sys.exit(7)"]), full=True)
    assert ended(process) == 7
    os.close(reader)


def test_an_error_at_the_end_of_it_is_an_exit_code() -> None:
    process, reader = started("raise RuntimeError('a fault')", full=True)
    assert ended(process) == 1
    os.close(reader)
    main = "from skygcs.cli import serve\nserve.main(['check', '/nonexistent/fleet.toml'])"
    process, reader = started(main, full=True)
    assert ended(process) == 1
    os.close(reader)


@pytest.mark.parametrize("number", [signal.SIGABRT, signal.SIGKILL])
def test_an_abrupt_end_takes_no_line_along(number: int) -> None:
    program = f"structlog.get_logger('x').warning('the last line')\nos.kill(os.getpid(), {int(number)})"
    process, reader = started(program, full=False)
    assert ended(process) == -number
    assert b"the last line" in os.read(reader, PIPE_BYTES)
    os.close(reader)
