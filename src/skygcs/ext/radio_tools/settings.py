"""A radio's settings by name: as ATI5 lists them, which values they take, what follows from several together,
and as a file.

The number of a register differs between firmwares (NODEID is S15 in open SiK multipoint, S18 in RFD900x 2.75MP and S24
in 3.00MP; RTSCTS is S14 in SiK and S13 in RFD900x), so nothing here is addressed by number: names are looked up in what
the radio itself lists. Ranges: SiK firmware (parameters.c: param_check), the RFD900x manuals, and for NODEID and
NODEDESTINATION the multipoint manual.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from skygcs.errors import ConfigError
from skygcs.spelling import parse_toml

SERIAL_BAUD: Mapping[int, int] = {
    1: 1200,
    2: 2400,
    4: 4800,
    9: 9600,
    19: 19200,
    38: 38400,
    57: 57600,
    115: 115200,
    230: 230400,
    460: 460800,
    1000: 1000000,
}
"""SERIAL_SPEED -> baud. SiK ends at 230; the last two are RFD900x."""

SIK_AIR_SPEEDS_KBPS = (2, 4, 8, 16, 19, 24, 32, 48, 64, 96, 128, 192, 250)
RFD_AIR_SPEEDS_KBPS = (12, 56, 64, 100, 125, 188, 200, 224, 250, 500, 750)
"""AIR_SPEED values that the firmwares are known to have. SiK takes the next one above any other; an RFD900x refuses."""

RFD_LAST_NODE = 16
"""Node ids of RFD900x multipoint are 1 (the master) to 16."""


class Firmware(StrEnum):
    """Kinds of firmware that differ in what can be set up."""

    SIK = "SiK"
    """A pair of radios: open SiK, and the RFD900x as it is delivered."""
    RFD_MULTIPOINT = "RFD900x multipoint"
    """Master is node 1; it holds the number of nodes in a table (AT&M0=net,nodes)."""
    SIK_MULTIPOINT = "open SiK multipoint"
    """Base is node 0; every node holds NODECOUNT, the highest node id and one."""
    ASYNC = "RFD900x asynchronous mesh"


_LINE = re.compile(r"([SR])(\d{1,3}): ?([A-Za-z][\w/ ]{0,40}?)\s*(?:\([^)]*\))?\s*(?:\[([^\]]*)\])?\s*=\s*(-?\d{1,10})")


@dataclass(frozen=True, slots=True)
class Register:
    """One setting as the radio lists it: ``id`` is what AT commands call it ("S3")."""

    id: str
    name: str
    value: int


@dataclass(frozen=True, slots=True)
class RadioState:
    """State that one radio reported about itself."""

    banner: str
    firmware: Firmware
    registers: Mapping[str, Register]
    """By name, in the radio's order."""
    board: str | None = None
    band: str | None = None
    unique_id: str | None = None

    @property
    def values(self) -> dict[str, int]:
        return {name: register.value for name, register in self.registers.items()}

    @property
    def node(self) -> int | None:
        """The node id, None where the firmware has none."""
        return self.values.get("NODEID")


def parse_registers(lines: Iterable[str]) -> dict[str, Register]:
    """ATI5's or ATI5?'s lines ("S3:NETID=25", "S20:ANT_MODE(N)[0..3]=0{…}"); lines that are none are passed over."""
    found = {}
    for line in lines:
        if match := _LINE.match(line):
            kind, number, name, _, value = match.groups()
            name = name.strip().upper().replace(" ", "_")
            found[name] = Register(f"{kind}{int(number)}", name, int(value))
    return found


def has_antenna_meaning(register: Register) -> bool:
    """True for an ANT_MODE that `ANTENNA_MEANINGS` knows."""
    return register.name == "ANT_MODE" and 0 <= register.value < len(ANTENNA_MEANINGS)


def missing_registers(registers: Mapping[str, Register]) -> list[str]:
    """Gaps in the S numbers: lines that got lost. RFD900x multipoint drops some when its buffer runs over."""
    numbers = {int(r.id[1:]) for r in registers.values() if r.id.startswith("S")}
    return [f"S{n}" for n in range(max(numbers, default=-1) + 1) if n not in numbers]


def firmware_of(banner: str, names: Iterable[str]) -> Firmware:
    """From ATI's answer ("RFD SiK 3.00MP on RFD900x", "SiK 2.2 on HM-TRP") and the names of ATI5."""
    names = set(names)
    if "ASYNC" in banner.upper():
        return Firmware.ASYNC
    if "NODECOUNT" in names:
        return Firmware.SIK_MULTIPOINT
    if "NODEID" in names or re.search(r"\dMP\b|\bMP\b|MULTIPOINT", banner.upper()):
        return Firmware.RFD_MULTIPOINT
    return Firmware.SIK


@dataclass(frozen=True, slots=True)
class _Limits:
    least: int
    most: int
    meaning: str
    also: tuple[int, ...] = ()


ALIASES: Mapping[str, str] = {"MAVLINK": "RXFRAME", "OPPRESEND": "OP_RESEND"}
"""Two names of one setting, by firmware version."""

_OTHER_NAME = {**ALIASES, **{new: old for old, new in ALIASES.items()}}

ANTENNA_MODES: Mapping[str, int] = {"both": 0, "1": 1, "2": 2, "tx1-rx2": 3}
"""Words of a person -> ANT_MODE of an RFD900x."""

ANTENNA_MEANINGS = ("both antennas, the better one", "antenna 1 only", "antenna 2 only", "sends by 1, receives by 2")
"""By ANT_MODE. The radio's own words (ATI5?): Ant1&2, Ant1, Ant2, Ant1=TX;2=RX."""

_FRAMING = _Limits(0, 2, "0 raw, 1 MAVLink framing, 2 MAVLink with low latency")
_LIMITS: Mapping[str, _Limits] = {
    "AIR_SPEED": _Limits(2, 1000, "kbit/s"),
    "NETID": _Limits(0, 65535, "the same in all radios of a network"),
    "TXPOWER": _Limits(0, 30, "dBm"),
    "ECC": _Limits(0, 1, "error correction, which halves what the air carries"),
    "MAVLINK": _FRAMING,
    "RXFRAME": _FRAMING,
    "OPPRESEND": _Limits(0, 1, "send again in spare time"),
    "OP_RESEND": _Limits(0, 1, "send again in spare time"),
    "MIN_FREQ": _Limits(400_000, 960_000, "kHz", (0,)),
    "MAX_FREQ": _Limits(400_000, 960_000, "kHz", (0,)),
    "NUM_CHANNELS": _Limits(0, 64, "channels; 0: the firmware's choice"),
    "DUTY_CYCLE": _Limits(1, 100, "percent of the time it may send"),
    "LBT_RSSI": _Limits(25, 220, "listen before talk", (0,)),
    "MANCHESTER": _Limits(0, 1, "Manchester coding"),
    "RTSCTS": _Limits(0, 1, "hardware flow control"),
    "MAX_WINDOW": _Limits(20, 131, "ms"),
    "ANT_MODE": _Limits(0, 3, ", ".join(f"{mode} {text}" for mode, text in enumerate(ANTENNA_MEANINGS))),
    "SYNCANY": _Limits(0, 1, "synchronise to any node"),
    "NODECOUNT": _Limits(2, 32768, "nodes, the base as well"),
    "NETCOUNT": _Limits(1, 16, "networks of the master"),
}


def resolve_name(name: str, registers: Mapping[str, Register]) -> str:
    """The radio's own name of what a person calls ``name``. Raises KeyError whose text names close ones."""
    wanted = name.upper().replace("-", "_")
    for candidate in (wanted, _OTHER_NAME.get(wanted)):
        if candidate is not None and candidate in registers:
            return candidate
    close = difflib.get_close_matches(wanted, registers, n=3, cutoff=0.5)
    hint = f"; did you mean {', '.join(close)}?" if close else ""
    raise KeyError(f"this radio has no setting {wanted[:40]}{hint}")


def why_not(name: str, value: int, firmware: Firmware) -> str | None:
    """Why a value cannot be right, None if nothing is known against it: the radio has the last word."""
    if name == "FORMAT":
        return "FORMAT is the firmware's own and cannot be set"
    if name == "SERIAL_SPEED" and value not in SERIAL_BAUD:
        rates = ", ".join(f"{code} ({baud})" for code, baud in SERIAL_BAUD.items())
        return f"SERIAL_SPEED takes {rates}, not {value}"
    if name in ("NODEID", "NODEDESTINATION"):
        return _why_no_node(name, value, firmware)
    limits = _LIMITS.get(name)
    if limits is None or limits.least <= value <= limits.most or value in limits.also:
        return None
    also = "".join(f" or {v}" for v in limits.also)
    return f"{name} takes {limits.least} to {limits.most}{also} ({limits.meaning}), not {value}"


def _why_no_node(name: str, value: int, firmware: Firmware) -> str | None:
    if firmware is Firmware.RFD_MULTIPOINT:
        if 1 <= value <= RFD_LAST_NODE or (name == "NODEDESTINATION" and value in (255, 65535)):
            return None
        everyone = ", 255 (65535 before firmware 2.86) is all nodes" if name == "NODEDESTINATION" else ""
        return f"{name} takes 1 (the master) to {RFD_LAST_NODE}{everyone}, not {value}"
    if 0 <= value < 32768 or (name == "NODEDESTINATION" and value == 65535):
        return None
    return (
        f"{name} takes 0 (the base) to 32767{', 65535 is all nodes' if name == 'NODEDESTINATION' else ''}, not {value}"
    )


def inconsistencies(values: Mapping[str, int], firmware: Firmware) -> list[str]:
    """Return what one radio's settings do that nobody wants, one line each. Nothing here keeps it from being set."""
    found = []
    known = _air_speeds(firmware)
    air = values.get("AIR_SPEED")
    if air is not None and air not in known:
        found.append(f"AIR_SPEED {air} is not one of the known values: {', '.join(map(str, known))}")
    low, high = values.get("MIN_FREQ", 0), values.get("MAX_FREQ", 0)
    if low and high and low >= high:
        found.append(f"MIN_FREQ {low} is not below MAX_FREQ {high}")
    node, destination = values.get("NODEID"), values.get("NODEDESTINATION")
    if node is not None and node == destination:
        found.append(f"NODEDESTINATION is the node itself ({node}): it would send to nobody")
    count = values.get("NODECOUNT")
    if node is not None and count is not None and node >= count:
        found.append(f"NODEID {node} is not below NODECOUNT {count}, which must be the highest node id and one")
    framing = values.get("MAVLINK", values.get("RXFRAME"))
    if framing == 0:
        found.append("MAVLink framing is off: frames are torn at packet borders, and the radio sends no RADIO_STATUS")
    if values.get("RTSCTS") == 0 and node is not None:
        found.append("RTSCTS is off: the multipoint manual asks for hardware flow control, or data gets lost")
    if values.get("DUTY_CYCLE", 100) < 100:
        found.append(f"DUTY_CYCLE {values['DUTY_CYCLE']}: the radio is silent for the rest of the time, whatever waits")
    return found


def _air_speeds(firmware: Firmware) -> tuple[int, ...]:
    if firmware is Firmware.SIK:  # open SiK or an RFD900x as delivered: the settings do not show which
        return tuple(sorted({*SIK_AIR_SPEEDS_KBPS, *RFD_AIR_SPEEDS_KBPS}))
    return SIK_AIR_SPEEDS_KBPS if firmware is Firmware.SIK_MULTIPOINT else RFD_AIR_SPEEDS_KBPS


# -- settings as a TOML file, and the difference of two

BACKUP_VERSION = 1
MAX_BYTES = 65536
"""Largest backup file; one has about 1 kB."""

NOT_RESTORED = frozenset({"FORMAT"})
"""The firmware's own, and no setting."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One setting that two radios hold differently; None: one has no such setting."""

    name: str
    left: int | None
    right: int | None


def to_toml(state: RadioState, note: str = "") -> str:
    """The file's text. The node table of an RFD900x master is not in it: no firmware reports it."""
    text = ["# Settings of one radio; written and read by `skygcs-cli radio backup` and `restore`."]
    text += [f"# {line}" for line in note.splitlines()]
    text += [f"version = {BACKUP_VERSION}", "", "[radio]", f"banner = {_quoted(state.banner)}"]
    text.append(f"firmware = {_quoted(state.firmware)}")
    for key, value in (("board", state.board), ("band", state.band), ("unique_id", state.unique_id)):
        if value is not None:
            text.append(f"{key} = {_quoted(value)}")
    text += ["", "[registers]", "# name = value   # register of this firmware"]
    for register in state.registers.values():
        meaning = f", {ANTENNA_MEANINGS[register.value]}" if has_antenna_meaning(register) else ""
        text.append(f"{_quoted(register.name)} = {register.value}  # {register.id}{meaning}")
    return "\n".join(text) + "\n"


def from_toml(text: str, source: str) -> RadioState:
    """The radio of a backup; register ids are numbered in order, for they are those of another radio perhaps.
    Raises ConfigError with everything that is wrong."""
    if len(text) > MAX_BYTES:
        raise ConfigError(source, [f"longer than {MAX_BYTES} bytes: this is no backup of a radio"])
    try:
        document = parse_toml(text)
    except ValueError as error:
        raise ConfigError(source, [str(error)]) from None
    problems = []
    radio, registers = document.get("radio"), document.get("registers")
    if document.get("version") != BACKUP_VERSION:
        problems.append(f"version: must be {BACKUP_VERSION}; is this a backup of `skygcs-cli radio backup`?")
    if not isinstance(radio, dict) or not isinstance(radio.get("banner"), str):
        problems.append("radio: must be a table with banner")
        radio = {}
    if radio.get("firmware") not in list(Firmware):
        problems.append(f"radio.firmware: must be one of {', '.join(repr(str(f)) for f in Firmware)}")
    if not isinstance(registers, dict) or not registers:
        problems.append("registers: must be a table of settings")
        registers = {}
    for name, value in registers.items():
        if type(value) is not int or not 0 <= value < 2**32:
            problems.append(f"registers.{name}: must be a whole number")
    if problems:
        raise ConfigError(source, problems)
    named = {name: Register(f"S{i}", name, value) for i, (name, value) in enumerate(registers.items())}
    optional = [str(radio[key]) if key in radio else None for key in ("board", "band", "unique_id")]
    return RadioState(radio["banner"], Firmware(radio["firmware"]), named, *optional)


def restorable(backup: RadioState) -> dict[str, int]:
    """The settings of a backup that a radio is to get."""
    return {name: value for name, value in backup.values.items() if name not in NOT_RESTORED}


def differences(left: Mapping[str, int], right: Mapping[str, int]) -> list[Difference]:
    """Return what differs, in the order of the left one, then of the right one."""
    names = [*left, *(name for name in right if name not in left)]
    return [Difference(n, left.get(n), right.get(n)) for n in names if left.get(n) != right.get(n)]


def _quoted(text: str) -> str:
    """A TOML basic string; JSON's escapes are all TOML's as well, once there is nothing beyond ASCII."""
    return json.dumps("".join(c for c in text if c.isprintable() and ord(c) < 0x10000))
