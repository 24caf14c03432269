"""A radio that can be plugged in and out: a pty whose slave is reached through a symlink, as udev does it."""

from __future__ import annotations

import asyncio
import os
import time
import tty
from pathlib import Path


class PtyRadio:
    """The far end of a serial port at ``path``. Bytes written here are what the radio heard."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._master: int | None = None

    def plug_in(self) -> None:
        """The device appears."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def pull_out(self) -> None:
        """The device vanishes under whoever has it open. Idempotent."""
        if self._master is not None:
            self.path.unlink()
            os.close(self._master)
            self._master = None

    @property
    def fd(self) -> int:
        assert self._master is not None, "not plugged in"
        return self._master

    def write(self, data: bytes) -> int:
        """Towards the port; how many bytes it took."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def send(self, data: bytes) -> None:
        """All of it towards the port, as soon as it takes it."""
        while data := data[self.write(data) :]:
            time.sleep(0.001)

    def read(self) -> bytes:
        """What the port has sent so far; nothing while it is pulled out."""
        got = b""
        try:
            while self._master is not None and (data := os.read(self._master, 65536)):
                got += data
        except OSError:  # nothing more, or nobody has the port open
            pass
        return got

    async def read_exactly(self, size: int) -> bytes:
        """The next ``size`` bytes: the kernel hands a pty's bytes over in its own time."""
        got = b""
        while len(got) < size:
            await asyncio.sleep(0.001)
            got += self.read()
        return got
