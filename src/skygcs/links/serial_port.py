"""Opens serial ports for links: pyserial configures them, and says what to do where it cannot."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import grp
import os
import shlex
import struct
import termios

import serial

from skygcs.errors import LinkError

BITS_PER_BYTE = 10
"""8N1: a start bit, eight data bits, a stop bit."""


def open_port(device: str, baud: int, *, rtscts: bool, low_latency: bool) -> serial.Serial:
    """The port, opened exclusively, non-blocking and raw. Raises LinkError with what to do."""
    try:
        port = serial.Serial(device, baud, timeout=0, write_timeout=0, rtscts=rtscts, exclusive=True)
    except (OSError, ValueError, termios.error) as error:
        raise LinkError(f"serial {device}: {explain(error, device, baud)}") from None
    try:
        os.set_blocking(port.fileno(), False)
        read_means_data(port.fileno())
    except (OSError, termios.error) as error:
        discard(port)
        raise LinkError(f"serial {device}: {explain(error, device, baud)}") from None
    if low_latency:
        with contextlib.suppress(ValueError, OSError):  # a pty and some drivers have no such setting
            port.set_low_latency_mode(True)
    return port


def read_means_data(fd: int) -> None:
    """VMIN = 1: with pyserial's 0 an empty read means "nothing now" as well as "hung up". No signal from a break."""
    attributes = termios.tcgetattr(fd)
    attributes[0] &= ~termios.BRKINT
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def discard(port: serial.Serial) -> None:
    """Close without waiting: with bytes unsent and no CTS, close() would hold the whole daemon for up to 30 s."""
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(port.fileno(), termios.TCIOFLUSH)
    with contextlib.suppress(OSError):
        port.close()


def bytes_outstanding(fd: int) -> int:
    """Written bytes that the kernel still holds; 0 if the driver does not report it, as for a pty."""
    try:
        (held,) = struct.unpack("i", fcntl.ioctl(fd, termios.TIOCOUTQ, bytes(4)))
    except OSError:
        return 0
    return int(held)


def explain(error: Exception, device: str, baud: int) -> str:
    """Return what to do about a port that cannot be opened or set up."""
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
