"""A radio's settings as a TOML file, and the difference of two."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass

from skygcs.errors import ConfigError
from skygcs.modem.settings import Firmware, RadioState, Register

VERSION = 1
MAX_BYTES = 65536
"""A backup has about 1 kB."""

NOT_RESTORED = frozenset({"FORMAT"})
"""The firmware's own, and no setting."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One setting that two radios hold differently; None: one has no such setting."""

    name: str
    left: int | None
    right: int | None


def to_toml(state: RadioState, note: str = "") -> str:
    """The file's text. The node table of an RFD900x master is not in it: no firmware tells it."""
    text = ["# Settings of one radio; written and read by `skygcs-cli radio backup` and `restore`."]
    text += [f"# {line}" for line in note.splitlines()]
    text += [f"version = {VERSION}", "", "[radio]", f"banner = {_quoted(state.banner)}"]
    text.append(f"firmware = {_quoted(state.firmware)}")
    for key, value in (("board", state.board), ("band", state.band), ("unique_id", state.unique_id)):
        if value is not None:
            text.append(f"{key} = {_quoted(value)}")
    text += ["", "[registers]", "# name = value   # register of this firmware"]
    for register in state.registers.values():
        text.append(f"{_quoted(register.name)} = {register.value}  # {register.id}")
    return "\n".join(text) + "\n"


def from_toml(text: str, source: str) -> RadioState:
    """The radio of a backup; register ids are numbered in order, for they are those of another radio perhaps.
    Raises ConfigError with everything that is wrong."""
    if len(text) > MAX_BYTES:
        raise ConfigError(source, [f"longer than {MAX_BYTES} bytes: this is no backup of a radio"])
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(source, [str(error)]) from None
    problems = []
    radio, registers = document.get("radio"), document.get("registers")
    if document.get("version") != VERSION:
        problems.append(f"version: must be {VERSION}; is this a backup of `skygcs-cli radio backup`?")
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
    told = [str(radio[key]) if key in radio else None for key in ("board", "band", "unique_id")]
    return RadioState(radio["banner"], Firmware(radio["firmware"]), named, *told)


def restorable(backup: RadioState) -> dict[str, int]:
    """The settings of a backup that a radio is to get."""
    return {name: value for name, value in backup.values.items() if name not in NOT_RESTORED}


def differences(left: Mapping[str, int], right: Mapping[str, int]) -> list[Difference]:
    """What differs, in the order of the left one, then of the right one."""
    names = [*left, *(name for name in right if name not in left)]
    return [Difference(n, left.get(n), right.get(n)) for n in names if left.get(n) != right.get(n)]


def _quoted(text: str) -> str:
    """A TOML basic string; JSON's escapes are all TOML's as well, once there is nothing beyond ASCII."""
    return json.dumps("".join(c for c in text if c.isprintable() and ord(c) < 0x10000))
