"""A serial port: a radio, a telemetry cable, a pty. pyserial opens and configures it; reading and writing are ours."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import grp
import os
import shlex
import struct
import termios
from functools import partial
from itertools import cycle

import serial

from skygcs.config import models
from skygcs.config.radio import radio_rates
from skygcs.errors import LinkError
from skygcs.links.base import Channel, Link, LinkHost
from skygcs.links.paced import third_party_rules
from skygcs.links.stream import StreamChannel, WriteLimits

TRY_BAUD_S = 5.0
"""How long one rate of a list is tried: five heartbeats of a vehicle at 1 Hz (mavlink-router takes the same time)."""

BITS_PER_BYTE = 10
"""8N1: a start bit, eight data bits, a stop bit."""


class SerialLink(Link):
    """One serial port, one channel. ``baud`` is the rate in use; of a list, the one that worked stays first."""

    config: models.SerialLinkConfig

    def __init__(self, config: models.SerialLinkConfig, host: LinkHost, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(config, host, loop)
        self._rates = (config.baud,) if isinstance(config.baud, int) else config.baud
        self.baud = self._rates[0] if self._rates else 0
        self._port: serial.Serial | None = None
        self._channel: StreamChannel | None = None
        self._scan: asyncio.TimerHandle | None = None

    @property
    def channels(self) -> list[Channel]:
        return [self._channel] if self._channel is not None else []

    async def open(self) -> None:
        if not self._rates:
            raise LinkError(f"serial {self.config.device}: the list of baud rates is empty")
        port = self._port = self._open_port()
        fd = port.fileno()
        try:
            self._channel = StreamChannel(
                self,
                self.config.device,
                fd,
                self._on_broken,
                WriteLimits(partial(_bytes_outstanding, fd), self.baud / BITS_PER_BYTE),
                radio=radio_rates(self.config, self.baud) if self.config.role == "radio" else None,
                third_party=third_party_rules(self.config.third_party, self.host.dialect),
            )
            self.host.attach(self._channel)
        except BaseException:
            await self.close()
            raise
        if len(self._rates) > 1:
            first = self._rates.index(self.baud)
            following = cycle(self._rates[first + 1 :] + self._rates[: first + 1])
            self._scan = self.loop.call_later(TRY_BAUD_S, self._try_next_baud, following)

    async def close(self) -> None:
        if self._scan is not None:
            self._scan.cancel()
            self._scan = None
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()
            self.host.detach(channel, self.why_closed)
        port, self._port = self._port, None
        if port is not None:
            _discard(port)

    def _on_broken(self, channel: StreamChannel, reason: str) -> None:
        if channel is self._channel:
            self.fail(f"serial {self.config.device}: {reason}; unplugged, or its power went")

    def _open_port(self) -> serial.Serial:
        device = self.config.device
        try:
            port = serial.Serial(
                device, self.baud, timeout=0, write_timeout=0, rtscts=self.config.rtscts, exclusive=True
            )
        except (OSError, ValueError, termios.error) as error:
            raise LinkError(f"serial {device}: {_explain(error, device, self.baud)}") from None
        try:
            os.set_blocking(port.fileno(), False)
            _read_means_data(port.fileno())
        except (OSError, termios.error) as error:
            _discard(port)
            raise LinkError(f"serial {device}: {_explain(error, device, self.baud)}") from None
        if self.config.low_latency:
            with contextlib.suppress(ValueError, OSError):  # a pty and some drivers have no such setting
                port.set_low_latency_mode(True)
        return port

    def _try_next_baud(self, following: cycle[int]) -> None:
        """No good frame at this rate so far: take the next one of the list; after one, stay."""
        self._scan = None
        port, channel = self._port, self._channel
        if port is None or channel is None or channel.parser.stats.good:
            return
        baud = next(following)
        try:
            port.baudrate = baud
            _read_means_data(port.fileno())
        except (OSError, ValueError, termios.error) as error:
            self.fail(f"serial {self.config.device}: {_explain(error, self.config.device, baud)}")
            return
        self.baud = baud
        channel.bytes_per_s = baud / BITS_PER_BYTE
        if channel.air is not None:
            channel.air.set_baud(baud, self.loop.time())
        self._scan = self.loop.call_later(TRY_BAUD_S, self._try_next_baud, following)


def _read_means_data(fd: int) -> None:
    """VMIN = 1: with pyserial's 0 an empty read means "nothing now" as well as "hung up". No signal from a break."""
    attributes = termios.tcgetattr(fd)
    attributes[0] &= ~termios.BRKINT
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _discard(port: serial.Serial) -> None:
    """Close without waiting: with bytes unsent and no CTS, close() would hold the whole daemon for up to 30 s."""
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(port.fileno(), termios.TCIOFLUSH)
    with contextlib.suppress(OSError):
        port.close()


def _bytes_outstanding(fd: int) -> int:
    """Written bytes that the kernel still holds; 0 if the driver does not report it, as for a pty."""
    try:
        (held,) = struct.unpack("i", fcntl.ioctl(fd, termios.TIOCOUTQ, bytes(4)))
    except OSError:
        return 0
    return int(held)


def _explain(error: Exception, device: str, baud: int) -> str:
    """What to do about a port that cannot be opened or set up."""
    code = error.errno if isinstance(error, OSError) else error.args[0] if isinstance(error, termios.error) else None
    match code:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO:
            return "no such device; plug it in, or correct the name (ls -l /dev/serial/by-id)"
        case errno.EACCES | errno.EPERM:
            return f"permission denied; {_who_may(device)}"
        case errno.EAGAIN | errno.EBUSY:
            return "in use by another program; stop that one first (sudo fuser -v " + device + " shows it)"
        case errno.ENOTTY | errno.EISDIR:
            return "not a serial port"
        case _ if isinstance(error, ValueError):
            return f"the driver does not do {baud} baud; choose another rate"
        case _:
            text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            return "not a serial port" if "Inappropriate ioctl" in text else f"{text[:1].lower()}{text[1:]}"


def _who_may(device: str) -> str:
    try:
        status = os.stat(device)
    except OSError:
        return "add yourself to the group that owns it (dialout) and log in again"
    try:
        group = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        group = str(status.st_gid)
    if status.st_mode & 0o060 != 0o060:
        mode = f"its mode {status.st_mode & 0o777:04o} lets no group use it"
        return f"{mode}; add a udev rule, or run: sudo chmod 660 {shlex.quote(device)}"
    return f"add yourself to the group that owns it ({group}) and log in again"
