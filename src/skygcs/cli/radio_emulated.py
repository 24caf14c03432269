"""An emulated radio on a pty: answers AT commands in real time."""

from __future__ import annotations

import os
import pty
import select
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

import typer

from skygcs.cli.connection import Exit
from skygcs.errors import RefusedError
from skygcs.sim.at_modem import AtRadio, Kind

TICK_S = 0.02
_BAUD = {
    getattr(termios, f"B{rate}"): rate
    for rate in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 1000000)
    if hasattr(termios, f"B{rate}")
}


def port_rate(descriptor: int) -> int:
    """The rate that whoever has a pty open has set; 0: one that no radio has."""
    return _BAUD.get(termios.tcgetattr(descriptor)[5], 0)


def set_port_rate(descriptor: int, baud: int) -> None:
    """What the port is at before anybody sets it."""
    attributes = termios.tcgetattr(descriptor)
    code = next(code for code, rate in _BAUD.items() if rate == baud)
    attributes[4] = attributes[5] = code
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


class EmulatedPort:
    """A radio's serial port at ``path``, a symlink to a pty, and the radio behind it. `serve` until `stop`."""

    def __init__(self, path: Path, radio: AtRadio) -> None:
        self.path = path
        self.radio = radio
        self._stop = threading.Event()
        self._master, slave = pty.openpty()
        try:
            tty.setraw(slave)
            os.set_blocking(self._master, False)
            path.symlink_to(os.ttyname(slave))
        except OSError:
            os.close(self._master)
            os.close(slave)
            raise
        self._slave = slave
        """Held open, so that the port stays as it is between two visits."""

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        """The port vanishes. Only after `serve` has ended."""
        self.path.unlink(missing_ok=True)
        os.close(self._master)
        os.close(self._slave)

    def serve(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Hear and answer until `stop`."""
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], TICK_S)
            now, baud = clock(), self._rate()
            if ready:
                self.radio.hear(os.read(self._master, 4096), now, baud)
            self.radio.advance(now)
            if output := self.radio.take_output(baud):
                os.write(self._master, output)

    def _rate(self) -> int:
        return port_rate(self._master)


def emulate_radio(link: Path, kind: str, node: int | None, remotes: str) -> int:
    radio = _made(kind, node)
    try:
        radio.remotes = [_made(kind, int(text)) for text in remotes.split(",") if text.strip()]
    except ValueError:
        raise typer.BadParameter(f"--remotes: {remotes!r} are not node ids with commas between") from None
    if link.is_symlink() and not link.exists():  # left behind by one that was killed
        link.unlink()
    elif link.exists():
        raise RefusedError(f"{link} exists; give another name, or remove it")
    port = EmulatedPort(link, radio)
    typer.echo(f"an emulated {kind} radio at {link}, {radio.baud} baud; Ctrl-C ends it")
    try:
        port.serve()
    finally:
        port.close()
    return Exit.DONE


def _made(kind: str, node: int | None) -> AtRadio:
    try:
        radio = AtRadio(Kind(kind))
    except ValueError:
        raise typer.BadParameter(f"--kind: {kind!r} is none of {', '.join(Kind)}") from None
    if node is not None:
        radio.renumber(node)
    return radio
