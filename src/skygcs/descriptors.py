"""File descriptors of this process: enough of them, and some kept for clients on this computer.

The system gives a new file the lowest free number. So a connection with one of the last numbers that the process may
have says that descriptors run out, and whoever accepted it closes it, or an older one, at once. What stays free lets a
client of the Unix socket in, which may be the one that orders a stop.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys

WANTED = 4096
"""A full daemon: 255 TCP clients, each with an epoll of its own, 192 sessions, links, files."""

DESCRIPTORS_KEPT = 24
"""File descriptors kept free for the next clients on this computer, and for files that are opened for a moment; of a
small limit a quarter."""

STANDARD = {"stdin": "r", "stdout": "w", "stderr": "w"}
"""Streams of `sys` on the descriptors 0, 1 and 2, with their modes."""


def raise_limit() -> None:
    """Allow as many descriptors as are wanted, as far as the system lets us; the usual limit is 1024."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = WANTED if hard == resource.RLIM_INFINITY else min(WANTED, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def is_of_the_last(descriptor: int) -> bool:
    """True if a file with this number is one of those that are kept."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return soft != resource.RLIM_INFINITY and descriptor >= soft - min(DESCRIPTORS_KEPT, soft // 4)


def hold_standard() -> None:
    """Open /dev/null as each of the descriptors 0 to 2 that this process was begun without, and as its stream.

    Else the next socket or file becomes stdin, stdout or stderr: what is printed goes into it, and libuv ends the
    process when it closes it (uv__close: fd > STDERR_FILENO). Without the stream, which is None then, whatever asks for
    the terminal's width before it sends an order fails.
    """
    for number, (name, mode) in enumerate(STANDARD.items()):
        try:
            os.fstat(number)
        except OSError:
            handle = os.open(os.devnull, os.O_RDWR)  # the system gives the lowest number that is free: this one
            os.set_inheritable(handle, True)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
