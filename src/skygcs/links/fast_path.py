"""The express lane: datagrams whose way is known pass from socket to socket in compiled code. Optional.

What it does and why it may be left out is told in `_fast_path.c`; without it (no compiler when skygcs was installed, or
SKYGCS_PURE set to anything) the very same happens in Python, at some four times the cost per frame.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import structlog

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame

if TYPE_CHECKING:
    from skygcs.links._fast_path import FastPath, Out, Table
    from skygcs.links.address import Address

PURE = "SKYGCS_PURE"
"""Environment variable: leave the compiled code aside."""

INTERFACE = 2
"""Of `_fast_path.c` as this module uses it. A compiled file of an older checkout would lose frames: it is not used."""

_log = structlog.get_logger("skygcs")


def new_table(dialect: Dialect, *, recording: bool) -> Table | None:
    """What all lanes of one hub share; None if there is no compiled code. ``recording``: tlog records are wanted."""
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
    """The lane of one UDP socket. Nothing passes until `FastPath.add_flow` says so.

    ``slow(data, address, now)`` gets what does not pass, ``broken(error)`` the socket's errors; ``after()`` is to call
    `Table.take`, for there is much to be taken.
    """
    from skygcs.links._fast_path import FastPath

    return FastPath(table, fd, clock, slow, after, broken)


def new_out(fd: int, address: tuple[object, ...], channel: object, *, whole: bool) -> Out | None:
    """A UDP peer as a destination of lanes; None if it is not of IPv4. ``whole``: see `Channel.whole_datagrams`."""
    if len(address) != 2:
        return None
    from skygcs.links._fast_path import Out

    return Out(fd, address, channel, whole)
