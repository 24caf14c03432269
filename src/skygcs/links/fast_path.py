"""The fast path: compiled code forwards UDP datagrams of open flows from socket to socket. Optional.

`_fast_path.c` explains what it does and why it may be left out. Without it (no compiler when skygcs was installed, or
SKYGCS_PURE set to anything) Python does the same at some four times the cost per frame.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import structlog

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.links.reading import LARGEST_DATAGRAM_BYTES

if TYPE_CHECKING:
    from skygcs.links._fast_path import FastPath, Out, Table
    from skygcs.links.peers import Address

PURE = "SKYGCS_PURE"
"""Environment variable: do not use the compiled code."""

INTERFACE = 4
"""The interface of `_fast_path.c` that this module uses. Code compiled from an older checkout would lose frames: it is
not used."""

_log = structlog.get_logger("skygcs")


def new_table(dialect: Dialect, *, recording: bool) -> Table | None:
    """Return what all fast paths of one hub share; None if there is no compiled code. ``recording``: collect tlog
    records."""
    if os.environ.get(PURE):
        return None
    try:
        from skygcs.links import _fast_path
    except ImportError:
        return None
    compiled = getattr(_fast_path, "INTERFACE", 0)
    if compiled != INTERFACE:
        _log.warning(
            "the compiled fast path is of another version of skygcs and is not used; install skygcs again "
            "(pip install -e ., or make)",
            compiled=compiled,
            wanted=INTERFACE,
        )
        return None
    messages = {
        m.msgid: (m.crc_extra, m.min_length, m.length, m.target_system_offset, m) for m in dialect.messages.values()
    }
    return _fast_path.Table(messages, Frame, recording)


def new_fast_path(
    table: Table,
    fd: int,
    *,
    clock: Callable[[], float],
    slow: Callable[[bytes, Address, float], None],
    after: Callable[[], None],
    broken: Callable[[OSError], None],
) -> FastPath:
    """The fast path of one UDP socket. It forwards nothing until `FastPath.add_flow` opens a flow.

    ``slow(data, address, now)`` gets every other datagram and ``broken(error)`` the socket's errors; ``after()`` must
    call `Table.take`, as many records wait.
    """
    from skygcs.links._fast_path import FastPath

    return FastPath(table, fd, LARGEST_DATAGRAM_BYTES, clock, slow, after, broken)


def new_out(fd: int, address: tuple[object, ...], channel: object, *, whole: bool) -> Out | None:
    """A UDP peer as a destination of fast paths; None for IPv6. ``whole``: see `Channel.whole_datagrams`."""
    if len(address) != 2:
        return None
    from skygcs.links._fast_path import Out

    return Out(fd, address, channel, whole)
