"""The console of a simulated PX4 over SERIAL_CONTROL: nsh behind two pipes, and a few of its commands.

Read in PX4 1.16:

    a message for another device, or a reply    nothing (mavlink_receiver.cpp: handle_message_serial_control)
    bytes                                       into a pipe to the shell, which is started if there is none; the sender
                                                gets its output from now on; a count above 70 is no bytes (ibid.)
    no RESPOND flag                             the shell ends, and the command in it is cut off (ibid.; close_shell)
    output                                      at most 70 bytes at a time (mavlink_main.cpp: task_main)
    a character                                 echoed, and kept (pxh.cpp: run_remote_pxh; nsh does so in readline)
    a newline                                   the line is executed, then the prompt (ibid.)
    a pipe to the shell that is full            the thread that receives MAVLink waits for the shell: nothing else is
                                                heard (mavlink_shell.cpp: write; NuttX: CONFIG_DEV_PIPE_SIZE=70)

The simulated one counts what would have made it wait, and goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.sim.transmitter import Transmitter

SHELL = 10
"""SERIAL_CONTROL_DEV_SHELL."""

REPLY, RESPOND = 1, 2
"""SERIAL_CONTROL_FLAG_REPLY and _RESPOND."""

DATA_BYTES = 70
"""SERIAL_CONTROL.data."""

PIPE_BYTES = 70
"""CONFIG_DEV_PIPE_SIZE of each board with NuttX (boards/*/nuttx-config/*/defconfig)."""

LINE_BYTES = 126
"""Characters that nsh reads of one line (CONFIG_NSH_LINELEN=128, with newline and NUL)."""

READ_PER_TICK = 40
"""Bytes that the shell reads in a tick of 20 ms."""

PROMPT = b"nsh> \x1b[K"

VERSION = """\
HW arch: PX4_FMU_V5X
PX4 git-hash: 736b6671c1000000000000000000000000000000
PX4 version: 1.16.1 (17826303)
OS: NuttX
OS version: Release 11.0.0 (184549631)
MCU: STM32F7[6|7]x, rev. Z
"""

COMMANDS = ("commander", "dmesg", "echo", "exit", "help", "sleep", "ver")


class Px4Shell:
    """One vehicle's. `hear` takes a message, `step` sends what is due."""

    def __init__(self, tx: Transmitter, dialect: Dialect, armed: Callable[[], bool]) -> None:
        self._tx = tx
        info = dialect.by_name.get("SERIAL_CONTROL")
        self._addressed = info is not None and info.target_system_offset >= 0
        self._armed = armed
        self.overfull = 0
        """Bytes that came while the pipe to the shell was full."""
        self.lines: list[str] = []
        """Every line that was executed."""
        self.greeting = b"\nNuttShell (NSH) NuttX-11.0.0\n" + PROMPT
        """Output of a new shell; pxh, SITL's, has none."""
        self.client = (0, 0)
        self.running = False
        self._forget()

    def _forget(self) -> None:
        self._pipe, self._line, self._out = bytearray(), bytearray(), bytearray()
        self._busy_until = -1.0

    def hear(self, fields: Mapping[str, Any], sender: tuple[int, int]) -> None:
        """A SERIAL_CONTROL for this vehicle."""
        if fields["device"] != SHELL or fields["flags"] & REPLY:
            return
        if not self.running:
            self.running = True
            self._forget()
            self._out += self.greeting
        if 0 < fields["count"] <= DATA_BYTES:
            self.client = sender
            data = bytes(fields["data"][: fields["count"]])
            self.overfull += max(0, len(self._pipe) + len(data) - PIPE_BYTES)
            self._pipe += data
        if not fields["flags"] & RESPOND:
            self.running = False

    def step(self, now: float) -> None:
        """Read what came, and send what the commands have put out."""
        if not self.running:
            return
        for _ in range(READ_PER_TICK):
            if self._busy_until >= 0 and now >= self._busy_until:
                self._busy_until = -1.0
                self._out += PROMPT
            if not self._pipe or self._busy_until >= 0:
                break
            self._read(self._pipe.pop(0), now)
        if self._out:
            self._send(bytes(self._out[:DATA_BYTES]))
            del self._out[:DATA_BYTES]

    def put_out(self, data: bytes) -> None:
        """Output of a module that runs beside the commands."""
        self._out += data

    def _read(self, byte: int, now: float) -> None:
        if byte != ord("\n"):
            if byte > 3 and len(self._line) < LINE_BYTES:
                self._out.append(byte)
                self._line.append(byte)
            return
        self._out += b"\n"
        line, self._line = self._line.decode("latin-1"), bytearray()
        self.lines.append(line)
        words = line.split()
        if words[:1] == ["sleep"] and words[1:] and words[1].isdigit():
            self._busy_until = now + int(words[1])
            return
        for text in self._answers(words):
            self._out += text.encode("latin-1")
        self._out += PROMPT

    def _answers(self, words: list[str]) -> Iterator[str]:
        """Texts that a line puts out."""
        match words:
            case []:
                return
            case ["ver", "all"]:
                yield VERSION
            case ["commander", "status"]:
                yield f"INFO  [commander] {'Armed' if self._armed() else 'Disarmed'}\n"
            case ["dmesg"]:
                for n in range(200):
                    yield f"INFO  [logger] line {n:3d} of the boot\n"
            case ["echo", *rest]:
                yield " ".join(rest) + "\n"
            case ["help"]:
                yield "Builtin Apps:\n" + "".join(f"    {name}\n" for name in COMMANDS)
            case [name, *_] if name in COMMANDS:
                yield f"usage: {name}\n"
            case [name, *_]:
                yield f"nsh: {name}: command not found\n"

    def _send(self, data: bytes) -> None:
        fields = {"device": SHELL, "flags": REPLY, "count": len(data), "data": data}
        to = {"target_system": self.client[0], "target_component": self.client[1]} if self._addressed else {}
        self._tx.send("SERIAL_CONTROL", fields | to)
