"""A TCP proxy on loopback that is as slow and lossy as a test sets it: each piece comes later, in order, and a lost one
later still, as TCP repeats it."""

from __future__ import annotations

import random
import select
import socket
import threading
import time
from collections import deque

TICK_S = 0.005
READ_BYTES = 65536
REPEAT_LEAST_S = 0.2
"""TCP's shortest time until it repeats (RFC 6298 as Linux has it); otherwise a round trip."""


class SlowTcp(threading.Thread):
    """``port`` leads to ``to_port``. `delay_s` (each way) and `loss` (of pieces) may be set at any time."""

    def __init__(self, to_port: int) -> None:
        super().__init__(name="slow tcp", daemon=True)
        self._to_port = to_port
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self.port = int(self._server.getsockname()[1])
        self.delay_s = 0.0
        self.loss = 0.0
        self._random = random.Random(to_port)
        self._peers: dict[socket.socket, socket.socket] = {}
        self._ended: set[socket.socket] = set()
        """Sides that send nothing any more."""
        self._due: dict[socket.socket, deque[tuple[float, bytes]]] = {}
        """By the socket they go to; an empty piece is the end."""
        self._ending = threading.Event()

    def stop(self) -> None:
        self._ending.set()
        self.join(5)
        for link in (self._server, *self._peers):
            link.close()

    def run(self) -> None:
        while not self._ending.is_set():
            readable, _, _ = select.select([self._server, *self._peers.keys() - self._ended], [], [], TICK_S)
            for link in readable:
                if link is self._server:
                    self._accept()
                else:
                    self._read(link)
            self._deliver()

    def _accept(self) -> None:
        near, _ = self._server.accept()
        try:
            far = socket.create_connection(("127.0.0.1", self._to_port), timeout=1.0)
        except OSError:
            near.close()
            return
        for one, other in ((near, far), (far, near)):
            self._peers[one] = other
            self._due[one] = deque()

    def _read(self, link: socket.socket) -> None:
        other = self._peers[link]
        try:
            data = link.recv(READ_BYTES)
        except OSError:
            data = b""
        late_s = self.delay_s
        if self.loss and self._random.random() < self.loss:
            late_s += max(REPEAT_LEAST_S, 2 * self.delay_s)
        due = self._due[other]
        at = max(time.monotonic() + late_s, due[-1][0] if due else 0.0)
        due.append((at, data))
        if not data:
            self._ended.add(link)

    def _deliver(self) -> None:
        now = time.monotonic()
        for link, due in list(self._due.items()):
            while link in self._due and due and due[0][0] <= now:
                _, data = due.popleft()
                try:
                    if data:
                        link.sendall(data)
                        continue
                    link.shutdown(socket.SHUT_WR)
                except OSError:
                    pass
                self._close(link)
                break

    def _close(self, link: socket.socket) -> None:
        """One side has ended: both are closed."""
        for one in (link, self._peers[link]):
            del self._peers[one], self._due[one]
            self._ended.discard(one)
            one.close()
