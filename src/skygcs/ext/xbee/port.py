"""A module's serial port for the time of a set-up: in API mode, or in the command mode of a transparent module."""

from __future__ import annotations

import os
import re
import select
import termios
import time
from collections.abc import Iterator, Sequence
from typing import Literal

import serial

from skygcs.cli.serial_ports import explain
from skygcs.core.xbee.api_frames import (
    ApiFrame,
    ApiParser,
    AtResponse,
    at_command,
    decode,
    encode,
    remote_at_command,
)
from skygcs.core.xbee.registers import BAUD_CODES
from skygcs.errors import LinkError, RefusedError

ANSWER_S = 0.5
"""A local module answers within milliseconds, after what it is passing on at the moment."""

REMOTE_ANSWER_S = 4.0
"""A transmission with all its retries, and a route to be found first."""

GUARD_S = 1.1
"""GT: a second of silence before and after +++."""

STATUS = ("done", "refused", "no such setting in this module", "bad value", "the node does not answer")

MAX_HEARD_BYTES = 65536
"""Largest answer; more is noise."""

Mode = Literal["API", "command"]


class XBeePort:
    """Opens the port and finds rate and mode. A context manager. Raises LinkError that says what to do."""

    def __init__(self, device: str, bauds: Sequence[int]) -> None:
        self.device = device
        self._bauds = tuple(bauds)
        self.baud = self._bauds[0]
        self.mode: Mode = "API"
        self.escaped = False
        self._frame_id = 0
        try:
            self._port = serial.Serial(device, self.baud, timeout=0, write_timeout=1.0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise LinkError(f"{device}: {explain(error)}") from None

    def __enter__(self) -> XBeePort:
        try:
            self._find()
        except BaseException:
            self._port.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self.mode == "command":
                self._write(b"ATCN\r")  # transparent again
        finally:
            self._port.close()

    def get(self, name: str, node: int | None = None) -> bytes | None:
        """A register's value; None if the module has no such register. Raises LinkError."""
        status, value = self._at(name, b"", node)
        if status == 4 or (status and node is not None and status not in (1, 2)):
            raise LinkError(f"{self._who(node)}: {name}: {STATUS[min(status, 4)]}")
        return None if status else value

    def put(self, name: str, value: bytes, node: int | None = None) -> None:
        """Write a register, or carry a command out. Raises RefusedError or LinkError."""
        status, _ = self._at(name, value, node)
        if status:
            error = LinkError if status == 4 else RefusedError
            raise error(f"{self._who(node)}: {name}: {STATUS[min(status, 4)]}")

    def discover(self, wait_s: float) -> list[tuple[int, str]]:
        """Address and name of each node that answers within the time. Raises RefusedError outside API mode."""
        self._need_api("discover")
        frame_id = self._request(at_command(self._next_id(), "ND"))
        found: dict[int, str] = {}
        for frame in self._frames(wait_s):
            if not isinstance(frame, AtResponse) or frame.frame_id != frame_id or frame.command != "ND":
                continue
            if not frame.value:  # newer firmware says that it is over
                break
            if len(frame.value) >= 11:
                name, _, _ = frame.value[10:].partition(b"\0")
                found[int.from_bytes(frame.value[2:10], "big")] = name.decode("ascii", "replace")
        return sorted(found.items())

    def reopen(self, baud: int) -> None:
        """After a change of rate or mode: find the module again, at this rate first. Raises LinkError."""
        self._bauds = (baud, *(b for b in self._bauds if b != baud))
        self.mode = "API"
        self._find()

    # -- the conversation

    def _find(self) -> None:
        tried = []
        for baud in self._bauds:
            self.baud = self._port.baudrate = baud
            self._port.reset_input_buffer()
            self.escaped = False  # these bytes and their answer are the same in both modes
            status, value = self._api("AP", b"", None)
            if status == 0 and value and value[-1] in (1, 2):
                self.escaped = value[-1] == 2
                return
            tried.append(str(baud))
        for baud in self._bauds:
            self.baud = self._port.baudrate = baud
            if self._enter_command_mode():
                self.mode = "command"
                return
        raise LinkError(
            f"{self.device}: no XBee module answers, neither in API mode nor to +++ ({', '.join(tried)} baud); is it "
            "powered, is this its port, has it another rate (--baud)?"
        )

    def _enter_command_mode(self) -> bool:
        time.sleep(GUARD_S)
        self._port.reset_input_buffer()
        self._write(b"+++")
        return (self._line(GUARD_S + 1.0) or "").endswith("OK")

    def _at(self, name: str, value: bytes, node: int | None) -> tuple[int, bytes]:
        if self.mode == "API":
            status, answer = self._api(name, value, node)
            if status < 0:
                raise LinkError(f"{self._who(node)}: no answer to {name}")
            return status, answer
        if node is not None:
            self._need_api("remote modules are reached")
        # a name is written as it is, everything else in hexadecimal
        said = value.decode("ascii") if name == "NI" else value.hex().upper().lstrip("0") or ("0" if value else "")
        self._port.reset_input_buffer()
        self._write(f"AT{name}{said}\r".encode("ascii"))
        line = self._line(ANSWER_S + GUARD_S, blank=name == "NI")
        if line == "ERROR":
            return 2 if not value else 3, b""
        if line is None:
            raise LinkError(f"{self.device}: no answer to AT{name}")
        if value or line == "OK":
            return 0 if line == "OK" else 1, b""
        if name == "NI":
            return 0, line.encode("ascii", "replace")
        if not re.fullmatch("[0-9A-Fa-f]{1,32}", line):
            raise LinkError(f"{self.device}: AT{name}: {line[:40]!r} is not a value")
        return 0, bytes.fromhex(line.rjust(len(line) + len(line) % 2, "0"))

    def _api(self, name: str, value: bytes, node: int | None) -> tuple[int, bytes]:
        """Status and value; status -1: no answer."""
        frame_id = self._next_id()
        if node is None:
            self._request(at_command(frame_id, name, value))
        else:
            self._request(remote_at_command(frame_id, node, name, value))
        for frame in self._frames(ANSWER_S if node is None else REMOTE_ANSWER_S):
            if (
                isinstance(frame, AtResponse)
                and (frame.frame_id, frame.command) == (frame_id, name)
                and (frame.address == node)
            ):
                return frame.status, frame.value
        return -1, b""

    def _request(self, data: bytes) -> int:
        self._write(encode(data, escaped=self.escaped))
        return data[1]

    def _next_id(self) -> int:
        self._frame_id = self._frame_id % 255 + 1
        return self._frame_id

    def _need_api(self, what: str) -> None:
        if self.mode != "API":
            raise RefusedError(
                f"{self.device}: {what}: needs API mode; this module is transparent "
                f"(skygcs-cli xbee set {self.device} AP=2)"
            )

    def _who(self, node: int | None) -> str:
        return self.device if node is None else f"{self.device} node {node:016X}"

    # -- bytes

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (OSError, termios.error) as error:
            raise LinkError(f"{self.device}: {explain(error)}") from None

    def _read(self, until: float) -> bytes:
        """Return what comes before the time; b"" when it is over."""
        left = until - time.monotonic()
        if left <= 0 or not select.select([self._port.fileno()], [], [], left)[0]:
            return b""
        try:
            data = os.read(self._port.fileno(), 4096)
        except OSError as error:
            raise LinkError(f"{self.device}: {explain(error)}") from None
        if not data:
            raise LinkError(f"{self.device}: the port hung up")
        return data

    def _frames(self, within_s: float) -> Iterator[ApiFrame]:
        """Return what the module sends within the time; the caller stops when it has what it asked for."""
        until, parser, heard = time.monotonic() + within_s, ApiParser(decode, escaped=self.escaped), 0
        while heard < MAX_HEARD_BYTES and (data := self._read(until)):
            heard += len(data)
            yield from parser.feed(data)

    def _line(self, within_s: float, *, blank: bool = False) -> str | None:
        """A line of an answer, ended by a carriage return; None if none comes. ``blank``: it may be blank, as the name
        of a module is that was never given one."""
        until, text = time.monotonic() + within_s, b""
        while len(text) < MAX_HEARD_BYTES and (data := self._read(until)):
            text += data
            *lines, _ = text.split(b"\r")
            if answers := [line for line in lines if blank or line.strip()]:
                return answers[0].decode("ascii", "replace").strip()
        return None


def baud_of(value: bytes) -> int | None:
    """The rate of a BD; None for one that is no standard rate."""
    code = int.from_bytes(value, "big")
    return next((baud for baud, known in BAUD_CODES.items() if known == code), None)
