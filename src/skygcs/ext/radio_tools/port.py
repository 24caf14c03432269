"""Serial ports of radios: a real one for the time of a set-up procedure, and an emulated radio on a pty."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import pty
import select
import signal
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import serial
import typer

from skygcs.cli.connection import Exit
from skygcs.cli.render import say
from skygcs.cli.serial_ports import explain, port_rate
from skygcs.ending_signals import ending_signals
from skygcs.errors import LinkError, RefusedError
from skygcs.ext.radio_tools.change import Visit
from skygcs.ext.radio_tools.dialogue import Dialogue, Procedure
from skygcs.ext.radio_tools.link_probe import LinkProbe
from skygcs.sim.at_modem import AtRadio, Kind
from skygcs.sim.radio_pair import RadioPair
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import TdmConfig

T = TypeVar("T")

READ_BYTES = 4096

_OF_NO_CTRL_C = frozenset({signal.SIGTERM, signal.SIGHUP})
"""SIGINT cancels the program's task anyway."""


class RadioPort:
    """A radio's serial port, opened exclusively. A context manager. Raises LinkError that says what to do."""

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
        """Run a set-up procedure in real time. Raises what the procedure raises, and LinkError if the port fails.

        If it is interrupted (Ctrl-C, SIGTERM, a closed terminal), the visit's last command leaves the radio's command
        mode: a radio in command mode carries no data until it is switched off and on.
        """
        loop = asyncio.get_running_loop()
        readable = asyncio.Event()
        loop.add_reader(self._port.fileno(), readable.set)
        terminated = _cancelled_by_signals(loop)
        dialogue = None
        try:
            dialogue = Dialogue(procedure, loop.time())
            while True:
                # send what the procedure wants to send, at the rate it wants
                if dialogue.baud is not None and dialogue.baud != self._port.baudrate:
                    self._port.baudrate = dialogue.baud
                    _read_means_data(self._port.fileno())
                if output := dialogue.take_output():
                    self._port.write(output)
                # wait for input or for the next deadline
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
                raise KeyboardInterrupt from None  # as for Ctrl-C: the exit code says that it was interrupted
            raise
        finally:
            _leave_signals(loop)
            loop.remove_reader(self._port.fileno())
            if dialogue is None or not dialogue.done:
                self._say_farewell(visit)
                procedure.close()

    def set_flow_control(self, on: bool) -> None:
        """RTS/CTS as the radio has it. Raises LinkError."""
        try:
            self._port.rtscts = on
            _read_means_data(self._port.fileno())
        except (OSError, ValueError, termios.error) as error:
            raise LinkError(f"{self.device}: {explain(error)}") from None

    def _read(self) -> bytes:
        try:
            data = os.read(self._port.fileno(), READ_BYTES)
        except BlockingIOError:  # a change of the rate discarded the input
            return b""
        if not data:
            raise OSError(errno.EIO, "the port hung up")
        return data

    def _say_farewell(self, visit: Visit) -> None:
        try:
            self._port.write(visit.farewell())
            self._port.flush()
        except (OSError, termios.error):  # the port failed, which is reported already
            return


async def carry(ports: tuple[RadioPort, RadioPort], probe: LinkProbe) -> None:
    """Carry a probe's frames between both ports in real time until it is over. Raises LinkError if a port fails."""
    loop = asyncio.get_running_loop()
    readable = asyncio.Event()
    terminated = _cancelled_by_signals(loop)
    for port in ports:
        loop.add_reader(port._port.fileno(), readable.set)
    port = ports[0]
    try:
        while (deadline := probe.next_deadline()) is not None:
            for end, port in enumerate(ports):
                if frames := probe.take_output(end):
                    port._port.write(b"".join(frames))
            await _wait(readable, deadline - loop.time())
            if readable.is_set():
                readable.clear()
                for end, port in enumerate(ports):
                    with contextlib.suppress(BlockingIOError):
                        probe.feed(end, port._read(), loop.time())
            probe.advance(loop.time())
    except serial.SerialTimeoutException:
        raise LinkError(f"{port.device}: the radio accepts no data: are RTS and CTS wired (RTSCTS is on)?") from None
    except (OSError, termios.error, ValueError) as error:
        raise LinkError(f"{port.device}: {explain(error)}") from None
    except asyncio.CancelledError:
        if terminated.is_set():
            raise KeyboardInterrupt from None  # as for Ctrl-C: the exit code says that it was interrupted
        raise
    finally:
        _leave_signals(loop)
        for port in ports:
            loop.remove_reader(port._port.fileno())


def _cancelled_by_signals(loop: asyncio.AbstractEventLoop) -> asyncio.Event:
    """Make the signals that end a program cancel the current task, as Ctrl-C does; the event is set when one did."""
    terminated = asyncio.Event()
    task = asyncio.current_task()
    assert task is not None

    def terminate() -> None:
        terminated.set()
        task.cancel()

    with contextlib.suppress(ValueError, RuntimeError):  # not the main thread
        for number in _OF_NO_CTRL_C.intersection(ending_signals()):
            loop.add_signal_handler(number, terminate)
    return terminated


def _leave_signals(loop: asyncio.AbstractEventLoop) -> None:
    for number in _OF_NO_CTRL_C:
        loop.remove_signal_handler(number)


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


# --- the emulated radio -----------------------------------------------------------------------------------------------

TICK_S = 0.02
PAIR_TICK_S = 0.002


class EmulatedPort:
    """An emulated radio and its serial port: ``path`` is a symlink to a pty. `serve` runs until `stop`."""

    def __init__(self, path: Path, radio: AtRadio) -> None:
        self.path = path
        self.radio = radio
        self._stop = threading.Event()
        self.master, slave = pty.openpty()
        try:
            tty.setraw(slave)
            os.set_blocking(self.master, False)
            path.symlink_to(os.ttyname(slave))
        except OSError:
            os.close(self.master)
            os.close(slave)
            raise
        self._slave = slave
        """Kept open, so that the port keeps its settings between two visits."""

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        """Remove the port; only after `serve` has ended."""
        self.path.unlink(missing_ok=True)
        os.close(self.master)
        os.close(self._slave)

    def serve(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Read and answer until `stop`."""
        while not self._stop.is_set():
            ready, _, _ = select.select([self.master], [], [], TICK_S)
            now, baud = clock(), self.rate()
            if ready:
                self.radio.hear(os.read(self.master, 4096), now, baud)
            self.radio.advance(now)
            if output := self.radio.take_output(baud):
                os.write(self.master, output)

    def rate(self) -> int:
        """The rate that was set at it."""
        return port_rate(self.master)


class EmulatedPair:
    """Two emulated radios that hear each other, each at a pty of its own. `serve` runs until `stop`."""

    def __init__(self, paths: tuple[Path, Path], pair: RadioPair) -> None:
        self._pair = pair
        self._ports: list[EmulatedPort] = []
        self._stop = threading.Event()
        try:
            for path, radio in zip(paths, pair.radios, strict=True):
                self._ports.append(EmulatedPort(path, radio))
        except OSError:
            self.close()
            raise

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        """Remove the ports; only after `serve` has ended."""
        for port in self._ports:
            port.close()

    def serve(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Carry and answer until `stop`."""
        masters = [port.master for port in self._ports]
        while not self._stop.is_set():
            ready, _, _ = select.select(masters, [], [], PAIR_TICK_S)
            now = clock()
            for end, port in enumerate(self._ports):
                if port.master in ready:
                    self._pair.hear(end, os.read(port.master, READ_BYTES), now, port.rate())
            self._pair.step(now)
            for end, port in enumerate(self._ports):
                if output := self._pair.take_output(end, port.rate()):
                    with contextlib.suppress(BlockingIOError):  # nobody reads: a real radio's bytes get lost as well
                        os.write(port.master, output)


def emulate_pair(links: tuple[Path, Path], air_kbps: float, loss: float) -> int:
    """Serve two radios with a way between them at ptys until Ctrl-C."""
    from skygcs.config.dialects import load_dialect

    for link in links:
        _make_free(link)
    config = TdmConfig(2, air_kbps, loss=loss)
    ports = EmulatedPair(links, RadioPair(config, load_dialect("common"), Rng(1), time.monotonic()))
    say(f"emulated radios at {links[0]} (node 1) and {links[1]} (node 2), 57600 baud; Ctrl-C ends them")
    try:
        ports.serve()
    finally:
        ports.close()
    return Exit.DONE


def emulate_radio(link: Path, kind: str, node: int | None, remotes: str) -> int:
    radio = _made(kind, node)
    try:
        radio.remotes = [_made(kind, int(text)) for text in remotes.split(",") if text.strip()]
    except ValueError:
        raise typer.BadParameter(f"--remotes: {remotes!r} are not node ids separated by commas") from None
    _make_free(link)
    port = EmulatedPort(link, radio)
    say(f"an emulated {kind} radio at {link}, {radio.baud} baud; Ctrl-C ends it")
    try:
        port.serve()
    finally:
        port.close()
    return Exit.DONE


def _make_free(link: Path) -> None:
    if link.is_symlink() and not link.exists():  # of an earlier one that was killed
        link.unlink()
    elif link.exists():
        raise RefusedError(f"{link} exists; give another name, or remove it")


def _made(kind: str, node: int | None) -> AtRadio:
    try:
        radio = AtRadio(Kind(kind))
    except ValueError:
        raise typer.BadParameter(f"--kind: {kind!r} is not one of {', '.join(Kind)}") from None
    if node is not None:
        radio.renumber(node)
    return radio
