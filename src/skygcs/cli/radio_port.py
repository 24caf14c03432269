"""A radio's serial port for the time of a visit: runs a set-up procedure on it in real time."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import termios
from typing import TypeVar

import serial

from skygcs.errors import LinkError
from skygcs.modem.dialogue import Dialogue, Procedure
from skygcs.modem.visit import Visit

T = TypeVar("T")

READ_BYTES = 4096


class RadioPort:
    """Opened by nobody else meanwhile; a context manager. Raises LinkError that says what to do."""

    def __init__(self, device: str) -> None:
        self.device = device
        try:
            self._port = serial.Serial(device, timeout=0, write_timeout=1.0, exclusive=True)
            _read_means_data(self._port.fileno())
        except (OSError, ValueError, termios.error) as error:
            raise LinkError(f"{device}: {explain(error)}") from None

    def __enter__(self) -> RadioPort:
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    async def run(self, procedure: Procedure[T], visit: Visit) -> T:
        """Carry the procedure out; what it raises comes out, and LinkError where the port breaks.

        Ended in the middle (Ctrl-C, SIGTERM), the radio is told the visit's farewell: left in its command mode it would
        carry nothing until its power is cut.
        """
        loop = asyncio.get_running_loop()
        readable = asyncio.Event()
        loop.add_reader(self._port.fileno(), readable.set)
        terminated = _cancelled_by_sigterm(loop)
        dialogue = None
        try:
            dialogue = Dialogue(procedure, loop.time())
            while True:
                if dialogue.baud is not None and dialogue.baud != self._port.baudrate:
                    self._port.baudrate = dialogue.baud
                    _read_means_data(self._port.fileno())
                if output := dialogue.take_output():
                    self._port.write(output)
                deadline = dialogue.next_deadline()
                if deadline is None:
                    return dialogue.result
                await _wait(readable, deadline - loop.time())
                if readable.is_set():
                    readable.clear()
                    dialogue.feed(self._read(), loop.time())
                dialogue.advance(loop.time())
        except (OSError, termios.error, ValueError) as error:
            raise LinkError(f"{self.device}: {explain(error)}") from None
        except asyncio.CancelledError:
            if terminated.is_set():
                raise KeyboardInterrupt from None  # as Ctrl-C, whose exit code says that it was ended
            raise
        finally:
            loop.remove_signal_handler(signal.SIGTERM)
            loop.remove_reader(self._port.fileno())
            if dialogue is None or not dialogue.done:
                self._say_farewell(visit)
                procedure.close()

    def _read(self) -> bytes:
        try:
            data = os.read(self._port.fileno(), READ_BYTES)
        except BlockingIOError:  # a change of the rate threw away what there was
            return b""
        if not data:
            raise OSError(errno.EIO, "the port hung up")
        return data

    def _say_farewell(self, visit: Visit) -> None:
        try:
            self._port.write(visit.farewell())
            self._port.flush()
        except (OSError, termios.error):  # it broke: that is being told already
            return


def _cancelled_by_sigterm(loop: asyncio.AbstractEventLoop) -> asyncio.Event:
    """Have SIGTERM cancel the present task; what is returned says whether it did."""
    terminated = asyncio.Event()
    task = asyncio.current_task()
    assert task is not None

    def terminate() -> None:
        terminated.set()
        task.cancel()

    with contextlib.suppress(ValueError, RuntimeError):  # not the main thread
        loop.add_signal_handler(signal.SIGTERM, terminate)
    return terminated


def _read_means_data(fd: int) -> None:
    """VMIN = 1: with pyserial's 0 an empty read means "nothing now" as well as "hung up"."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    os.set_blocking(fd, False)


async def _wait(readable: asyncio.Event, timeout_s: float) -> None:
    try:
        async with asyncio.timeout(max(0.0, timeout_s)):
            await readable.wait()
    except TimeoutError:
        return


def explain(error: Exception) -> str:
    """What to do about a port that cannot be opened, or broke."""
    code = error.errno if isinstance(error, OSError) else error.args[0] if isinstance(error, termios.error) else None
    match code:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            return "no such device; plug it in, or correct the name (ls -l /dev/serial/by-id)"
        case errno.EACCES | errno.EPERM:
            return "permission denied; add yourself to the group that owns it (ls -l tells; usually dialout)"
        case errno.EAGAIN | errno.EBUSY:
            return "in use by another program; stop that one first (fuser -v shows it)"
        case errno.ENOTTY | errno.EISDIR:
            return "not a serial port"
        case errno.EIO:
            return "the port went away: unplugged, or its power went"
    if "Inappropriate ioctl" in str(error) or "Could not configure" in str(error):
        return "not a serial port"
    return str(error)
