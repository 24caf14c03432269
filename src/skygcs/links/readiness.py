"""One callback for one file descriptor, alike on every event loop."""

from __future__ import annotations

import asyncio
import select
from collections.abc import Callable


class DescriptorWatcher:
    """Calls ``on_ready`` while ``fd`` can be read, has hung up, or (after `want_write`) can be written.

    The descriptor stands in an epoll of its own and the loop watches that epoll. Reason: libuv (uvloop) stops watching
    a descriptor for good at its first EPOLLERR, which an unplugged serial port or a reset connection gives while there
    still is something to read, and a connected UDP socket each time its peer is not there. An epoll inside an epoll is
    only ever readable.
    """

    __slots__ = ("_epoll", "_fd", "_loop", "_writing")

    def __init__(self, loop: asyncio.AbstractEventLoop, fd: int, on_ready: Callable[[], None]) -> None:
        self._loop = loop
        self._fd = fd
        self._writing = False
        self._epoll = select.epoll(1)
        try:
            self._epoll.register(fd, select.EPOLLIN)
            loop.add_reader(self._epoll.fileno(), on_ready)
        except BaseException:
            self._epoll.close()
            raise

    def want_write(self, wanted: bool) -> None:
        """Whether writability counts as ready too."""
        if wanted != self._writing and not self._epoll.closed:
            self._writing = wanted
            self._epoll.modify(self._fd, select.EPOLLIN | select.EPOLLOUT if wanted else select.EPOLLIN)

    def close(self) -> None:
        """Stop watching; to be called before the descriptor is closed. Idempotent."""
        if not self._epoll.closed:
            self._loop.remove_reader(self._epoll.fileno())
            self._epoll.close()
