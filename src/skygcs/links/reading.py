"""Reading of links: how much one wake-up may take, so that no turn of the loop is long whatever is sent to us.

All links of a hub share one `ReadingTurns`. A reader is what the loop calls when a descriptor can be read: one per
socket, connection or port. It is called again in the next turn of the loop while there is more, so that timers, control
ticks and orders have their turns in between.

What waits in a reader when this process wakes from a sleep or a standstill looks fresh and is not: the hub routes
nothing of it. A reader is stale until it has been empty once or, where more comes than is read, until as much was read
as can have waited at the wake:

    bytes of a port or a connection    what the kernel says (FIONREAD), and what drivers may hold beyond that
    datagrams                          the memory that the kernel says they take, by the least that one takes
    connections                        the two queues of a listener
"""

from __future__ import annotations

import fcntl
import select
import socket
import struct
import sys
import termios
import weakref
from collections.abc import Callable, Hashable
from typing import NamedTuple

LARGEST_DATAGRAM_BYTES = 12_288
"""A longer datagram is dropped and counted. Programs send a frame (280 bytes), or fill a packet of the network: 1,472
bytes, 8,972 with jumbo frames; on one computer 300 frames of the usual 40 bytes fit."""

TURN_BYTES = 16_384
"""Taken in one turn of the loop by all readers together: 0.2 µs per byte as small frames, up to 0.4 as garbage that is
made to cost, hence 2 to 6 ms."""

TURN_S = 0.005
"""The same as a time, for a slow or busy computer: a turn ends with the datagram that exceeds it."""

LEAST_BYTES = 256
"""Least share of one reader, about one frame: with 64 readers that are all flooded a turn takes 16 kB."""


DRIVER_BYTES = 128 << 10
"""Bytes that may wait beyond FIONREAD: 64 KiB between a driver and its terminal (tty_buffer.c), and its own."""

SO_MEMINFO, MEMINFO = 55, struct.Struct("9I")
"""linux/sock_diag.h: the first number is the memory of what waits."""

LEAST_DATAGRAM_MEMORY = 256
"""Measured with Linux 6 on x86-64: 832 bytes for a datagram of one byte; sk_buff and skb_shared_info of a 32-bit
computer alone take more than this."""


def waiting_bytes(descriptor: int) -> int:
    """How many bytes of a port or a connection can have come by now and are not read."""
    try:
        known = int.from_bytes(fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)), sys.byteorder)
    except OSError:  # an adapter that was pulled out: its next read breaks it
        known = 0
    return known + DRIVER_BYTES


def waiting_datagrams(sock: socket.socket) -> int:
    """How many datagrams can have come by now and are not read."""
    try:
        memory = int(MEMINFO.unpack(sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size))[0])
    except (OSError, struct.error):  # Linux before 4.12: as many as it may hold
        memory = 2 * sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    return memory // LEAST_DATAGRAM_MEMORY + 1


class Share(NamedTuple):
    """Share that one wake-up may take. At least one datagram, or one read of ``bytes``."""

    bytes: int
    seconds: float


class _Open(NamedTuple):
    descriptor: int
    waiting: Callable[[], int]
    kept: Callable[[], int]


class ReadingTurns:
    """Shares the bytes and the time of a turn among the readers that have something to read."""

    def __init__(self) -> None:
        self.asleep: Callable[[], bool] = lambda: False
        """Asked before anything is read: `runtime.loop_clock.SleepWatch.check`. True: nothing may be read now."""
        self.stale: dict[Hashable, int] = {}
        """Readers in which something waited when this process woke, and how much may still be of that."""
        self._open: dict[Hashable, _Open] = {}
        self._seen: weakref.WeakSet[Hashable] = weakref.WeakSet()
        self._readers = 1
        self._share = Share(TURN_BYTES, TURN_S)

    def add(
        self, reader: Hashable, descriptor: int, waiting: Callable[[], int], kept: Callable[[], int] = lambda: 0
    ) -> None:
        """A reader has opened. ``waiting``: how much can wait in its descriptor now, in the unit of `emptied`.
        ``kept``: how much it has read from it and not yet handed on."""
        self._open[reader] = _Open(descriptor, waiting, kept)

    def remove(self, reader: Hashable) -> None:
        """Forget a reader that closes; call this before its descriptor is closed. Idempotent."""
        self._open.pop(reader, None)
        self.stale.pop(reader, None)

    def woke(self) -> None:
        """This process did not run for a while: all readers in which something waits now are stale."""
        self.stale = {reader: opened.waiting() for reader, opened in self._open.items() if not self._is_empty(reader)}

    def emptied(self, reader: Hashable, taken: int) -> bool:
        """Count the ``taken`` bytes of a stale reader; True: nothing old is left. The caller then delivers what its
        parser holds back, and calls `trust`.
        """
        self.stale[reader] -= taken
        return self.stale[reader] <= 0 or self._is_empty(reader)

    def trust(self, reader: Hashable) -> None:
        """Count what comes from now on as new."""
        self.stale.pop(reader, None)

    def _is_empty(self, reader: Hashable) -> bool:
        opened = self._open[reader]
        if opened.kept():
            return False
        look = select.poll()
        look.register(opened.descriptor, select.POLLIN)
        return not look.poll(0)

    def share(self, reader: Hashable) -> Share | None:
        """The share of a reader that the loop has called. A turn is over when one is called for the second time; each
        gets its part by the number of readers in the turn before. None: read nothing in this turn."""
        if self.asleep():
            return None
        seen = self._seen
        if reader in seen:
            self._end_turn(len(seen))
            seen.clear()
        seen.add(reader)
        return self._share

    def _end_turn(self, readers: int) -> None:
        if readers != self._readers:
            self._readers = readers
            self._share = Share(max(LEAST_BYTES, TURN_BYTES // readers), TURN_S / readers)
