"""The command line of a radio, as SiK and RFD900x firmware answer on it: for rehearsal, and for tests of the set-up.

A model of at.c and parameters.c of open SiK and its multipoint branch, and of what the RFD900x manuals and published
listings show of that closed firmware: guard times, echo, "OK" and "ERROR", settings in RAM and in flash, restart,
silent corrections, remote radios. Nothing is passed on over the air but commands for remote radios. `Faults` are what
goes wrong with real ones.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

GUARD_S = 1.0
BOOT_S = 1.0
REMOTE_DELAY_S = 0.25
"""There and back between two radios at 64 kbit/s."""

MAX_COMMAND_CHARS = 16
"""at.h: a longer one ends the command mode, for it is no person's."""


class Kind(StrEnum):
    SIK = "sik"
    RFD_SIK = "rfd900x"
    RFD_MULTIPOINT = "rfd900x-multipoint"
    SIK_MULTIPOINT = "sik-multipoint"


_COMMON: dict[int, tuple[str, int]] = {
    0: ("FORMAT", 26), 1: ("SERIAL_SPEED", 57), 2: ("AIR_SPEED", 64), 3: ("NETID", 25), 4: ("TXPOWER", 20),
    5: ("ECC", 0), 6: ("MAVLINK", 1), 7: ("OPPRESEND", 0), 8: ("MIN_FREQ", 915000), 9: ("MAX_FREQ", 928000),
    10: ("NUM_CHANNELS", 50), 11: ("DUTY_CYCLE", 100), 12: ("LBT_RSSI", 0),
}  # fmt: skip
_RFD: dict[int, tuple[str, int]] = {
    **_COMMON, 0: ("FORMAT", 69), 4: ("TXPOWER", 30), 13: ("RTSCTS", 0), 14: ("MAX_WINDOW", 131),
    15: ("ENCRYPTION_LEVEL", 0), 16: ("GPI1_1R/CIN", 0), 17: ("GPO1_1R/COUT", 0), 18: ("GPO1_1SBUSIN", 0),
    19: ("GPO1_1SBUSOUT", 0), 20: ("ANT_MODE", 0), 21: ("GPO1_3STATLED", 0), 22: ("GPO1_0TXEN485", 0),
    23: ("RATE/FREQBAND", 0),
}  # fmt: skip
REGISTERS: Mapping[Kind, Mapping[int, tuple[str, int]]] = {
    Kind.SIK: {**_COMMON, 13: ("MANCHESTER", 0), 14: ("RTSCTS", 0), 15: ("MAX_WINDOW", 131)},
    Kind.RFD_SIK: _RFD,
    Kind.RFD_MULTIPOINT: {
        **_RFD, 3: ("NETID", 0), 6: ("RXFRAME", 1), 7: ("OP_RESEND", 0), 24: ("NODEID", 2),
        25: ("NODEDESTINATION", 255), 26: ("NETCOUNT", 1),
    },
    Kind.SIK_MULTIPOINT: {
        **_COMMON, 2: ("AIR_SPEED", 128), 6: ("MAVLINK", 0), 13: ("MANCHESTER", 0), 14: ("RTSCTS", 1),
        15: ("NODEID", 1), 16: ("NODEDESTINATION", 65535), 17: ("SYNCANY", 0), 18: ("NODECOUNT", 2),
    },
}  # fmt: skip
BANNERS: Mapping[Kind, str] = {
    Kind.SIK: "SiK 2.2 on HM-TRP",
    Kind.RFD_SIK: "RFD SiK 3.57 on RFD900x2",
    Kind.RFD_MULTIPOINT: "RFD SiK 3.00MP on RFD900x2",
    Kind.SIK_MULTIPOINT: "MP SiK 2.6 on RFD900A",
}
BAUD = {1: 1200, 2: 2400, 4: 4800, 9: 9600, 19: 19200, 38: 38400, 57: 57600, 115: 115200, 230: 230400}
_RANGES = {"AIR_SPEED": 750, "TXPOWER": 30, "ECC": 1, "MAVLINK": 2, "RXFRAME": 2, "OPPRESEND": 1, "MAX_WINDOW": 131}


@dataclass(slots=True)
class Faults:
    """Faults of a radio."""

    silent: bool = False
    """No answer to anything, as without power."""
    refuses: frozenset[str] = frozenset()
    """Settings it takes no value for."""
    forgets: frozenset[str] = frozenset()
    """Settings that are as before after a restart, although saved."""
    restarts_at: str | None = None
    """Command at which power is lost for a moment, once ("ATS3=", the beginning is enough)."""
    dies_at: str | None = None
    """Command from which on it does not answer."""
    loses_lines: int = 0
    """Number of lines that the next ATI5 loses, from its tenth line on."""
    loses_remote: int = 0
    """So many commands to remote radios get lost in the air."""


@dataclass(slots=True)
class AtRadio:
    """One radio. `hear` what its serial port gets at a rate, `advance`, and `take_output` at a rate."""

    kind: Kind = Kind.RFD_MULTIPOINT
    faults: Faults = field(default_factory=Faults)
    remotes: list[AtRadio] = field(default_factory=list)
    """Radios that are powered and in range."""
    saved: dict[int, int] = field(default_factory=dict)
    live: dict[int, int] = field(default_factory=dict)
    node_table: dict[int, tuple[int, int]] = field(default_factory=dict)
    """AT&Mi=net,nodes as saved and live; RFD900x multipoint."""
    commands: list[str] = field(default_factory=list)
    """Every command that was taken, for tests to look at."""
    restarts: int = 0
    unique_id: str = "0x0123456789ABCDEF"
    """Answer to ATI8; RFD900x firmware only."""
    command_mode: bool = False
    traffic: bytes = b""
    """Bytes that were heard as data and passed on to the air."""
    _output: bytearray = field(default_factory=bytearray)
    _later: list[tuple[float, bytes]] = field(default_factory=list)
    _line: str = ""
    _plus: int = 0
    """Plus signs since the guard time; more than three: data."""
    _last_heard: float = float("-inf")
    _booting_until: float = float("-inf")
    _in_force: dict[int, int] = field(default_factory=dict)
    """Settings since the last start: rate, network and air speed are taken up then only."""

    def __post_init__(self) -> None:
        defaults = {number: value for number, (_, value) in REGISTERS[self.kind].items()}
        self.saved = {**defaults, **self.saved}
        self.live = dict(self.saved)
        self._in_force = dict(self.saved)

    def renumber(self, node: int) -> None:
        """Give it a node id, as if it had left the bench with it; nothing where the firmware has none."""
        for number, (name, _) in REGISTERS[self.kind].items():
            if name == "NODEID":
                self.saved[number] = self.live[number] = self._in_force[number] = node

    # -- its serial port

    @property
    def baud(self) -> int:
        return BAUD[self._in_force[1]]

    def hear(self, data: bytes, now: float, baud: int) -> None:
        """Bytes at its serial port, sent at ``baud``; at another rate than its own they are garbage to it."""
        self.advance(now)
        if self.faults.silent or now < self._booting_until or not data:
            return
        if baud != self.baud:
            data = bytes(b ^ 0xA5 | 0x80 for b in data)
        if self.command_mode:
            for char in data.decode("latin-1"):
                if self.command_mode:
                    self._input(char, now)
            return
        guarded = now - self._last_heard >= GUARD_S
        self._plus = len(data) if guarded and data.strip(b"+") == b"" else self._plus + len(data) if self._plus else 0
        if data.strip(b"+") or self._plus > 3:
            self._plus = 0
        self.traffic = (self.traffic + data)[-4096:]
        self._last_heard = now

    def pass_on(self, data: bytes) -> None:
        """Data from the air; not shown in command mode."""
        if not self.command_mode and not self.faults.silent:
            self._output += data

    def take_traffic(self) -> bytes:
        """Return what was heard as data since the last call."""
        traffic, self.traffic = self.traffic, b""
        return traffic

    def advance(self, now: float) -> None:
        """Let time pass: the guard time after "+++", and answers of remote radios."""
        if self._plus == 3 and now - self._last_heard >= GUARD_S:
            self._plus = 0
            self.command_mode = True
            self._line = ""
            self._status(True)
        due = [data for at, data in self._later if at <= now]
        self._later = [(at, data) for at, data in self._later if at > now]
        for data in due:
            self._output += data

    def take_output(self, baud: int) -> bytes:
        """Return what it sent since the last call, as a listener at ``baud`` receives it."""
        output = bytes(self._output)
        self._output.clear()
        if baud != self.baud:
            return bytes(b ^ 0xA5 | 0x80 for b in output)
        return output

    # -- its command line

    def _input(self, char: str, now: float) -> None:
        if char == "\r":
            self._print("", echo=True)
            command, self._line = self._line, ""
            self._run(command, now)
        elif len(self._line) >= MAX_COMMAND_CHARS:
            self.command_mode = False
            self._line = ""
        elif char.isprintable() and char.isascii():
            self._line += char.upper()
            self._output += char.upper().encode()

    def _run(self, command: str, now: float) -> None:
        self.commands.append(command)
        if self.faults.dies_at is not None and command.startswith(self.faults.dies_at):
            self.faults.silent = True
            return
        if self.faults.restarts_at is not None and command.startswith(self.faults.restarts_at):
            self.faults.restarts_at = None
            self._restart(now)
            return
        if command.startswith("RT"):
            self._remote(command, now)
        elif command == "ATO":
            self.command_mode = False
            self._last_heard = now
        elif command == "ATZ":
            self._restart(now)
        elif command.startswith("AT"):
            for line in self.answer(command[2:]):
                self._print(line)

    def answer(self, command: str) -> list[str]:
        """The lines that the firmware answers to a command without its "AT"."""
        if command == "":
            return ["OK"]
        if command.startswith("I"):
            return self._report(command[1:])
        if match := re.fullmatch(r"S(\d{1,3})(\?|=(\d{1,10}))", command):
            number = int(match[1])
            if number not in self.live:
                return ["ERROR"]
            if match[2] == "?":
                return [str(self.live[number])]
            return ["OK" if self._set(number, int(match[3])) else "ERROR"]
        if command == "&W":
            self.saved = dict(self.live)
            return ["OK"]
        if command == "&F":
            self.live = {number: value for number, (_, value) in REGISTERS[self.kind].items()}
            return ["OK"]
        if self.kind is Kind.RFD_MULTIPOINT and (match := re.fullmatch(r"&M(\d{1,2})=(\d{1,5}),(\d{1,2})", command)):
            self.node_table[int(match[1])] = (int(match[2]), int(match[3]))
            return ["OK"]
        return ["ERROR"]

    def _report(self, what: str) -> list[str]:
        rfd = self.kind in (Kind.RFD_SIK, Kind.RFD_MULTIPOINT)
        match what:
            case "" | "0":
                return [BANNERS[self.kind]]
            case "2" | "3":
                return [{"2": "RFD900X2" if rfd else "78", "3": "FREQ_915" if rfd else "145"}[what]]
            case "5":
                names = REGISTERS[self.kind]
                gap = ": " if self.kind is Kind.SIK_MULTIPOINT else ":"
                lines = [f"S{number}{gap}{names[number][0]}={value}" for number, value in self.live.items()]
                lost, self.faults.loses_lines = self.faults.loses_lines, 0
                return [*lines[:10], *lines[10 + lost :]]
            case "8" if rfd:
                return [self.unique_id]
            case _:
                return ["ERROR"]

    def _set(self, number: int, value: int) -> bool:
        name = REGISTERS[self.kind][number][0]
        if number == 0 or name in self.faults.refuses or value > _RANGES.get(name, 2**32 - 1):
            return False
        if name == "SERIAL_SPEED" and value not in BAUD:
            return False
        if self.kind is Kind.SIK_MULTIPOINT:
            count = self.live[18]
            if name == "NODEID" and value >= count:
                return False
            if name == "NODEDESTINATION" and value != 65535 and (value >= count or value == self.live[15]):
                return False
        if name == "DUTY_CYCLE":
            value = min(value, 100)
        if name == "LBT_RSSI" and value:
            value = min(max(value, 25), 220)
        if name == "TXPOWER" and self.kind is Kind.SIK:  # the next step that the chip has
            value = min(step for step in (1, 2, 5, 8, 11, 14, 17, 20, 30) if step >= value)
        self.live[number] = value
        return True

    # -- other radios, and itself again

    def _remote(self, command: str, now: float) -> None:
        body, comma, node = command[2:].partition(",")
        if self.faults.loses_remote:
            self.faults.loses_remote -= 1
            return
        for radio in self.remotes:
            mine, other = self._value("NODEID"), radio._value("NODEID")
            if not self.hears(radio) or (mine is not None and comma and node != str(other)):
                continue
            if body == "Z":
                radio._restart(now)
                return
            if now < radio._booting_until:
                return
            radio.commands.append(f"AT{body}")
            text = "".join(f"{radio._tagged(line)}\r\n" for line in radio.answer(body))
            self._later.append((now + REMOTE_DELAY_S, text.encode()))
            return

    def hears(self, other: AtRadio) -> bool:
        """True if what one sends reaches the other: that one is on, and their settings since they started agree."""
        alike = ("NETID", "AIR_SPEED", "ECC", "MIN_FREQ", "MAX_FREQ", "NUM_CHANNELS")
        return not other.faults.silent and all(
            self._value(name, self._in_force) == other._value(name, other._in_force) for name in alike
        )

    def _value(self, name: str, settings: Mapping[int, int] | None = None) -> int | None:
        held = self.live if settings is None else settings
        return next((held[n] for n, (own, _) in REGISTERS[self.kind].items() if own == name), None)

    def _restart(self, now: float) -> None:
        kept = {n: REGISTERS[self.kind][n][1] for n in self.live if REGISTERS[self.kind][n][0] in self.faults.forgets}
        self.live = {**self.saved, **kept}
        self.saved = dict(self.live)
        self._in_force = dict(self.live)
        self.restarts += 1
        self.command_mode = False
        self._plus = 0
        self._line = ""
        self._output.clear()
        self._later.clear()
        self._booting_until = now + BOOT_S

    def _tagged(self, line: str) -> str:
        node = self._value("NODEID")
        return line if node is None else f"[{node}] {line}"

    def _status(self, ok: bool) -> None:
        self._print("OK" if ok else "ERROR")

    def _print(self, line: str, *, echo: bool = False) -> None:
        self._output += (line if echo else self._tagged(line)).encode() + b"\r\n"
