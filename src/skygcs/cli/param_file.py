"""Files and answers as sets of parameters, for `skygcs-cli param`."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from skygcs.core.mavlink.param_encoding import Param, ParamType
from skygcs.core.params.names import SORTS, Sort
from skygcs.core.params.param_file import MAX_CHARS, Kind, ParamFile, of_vehicle, parse, write
from skygcs.errors import ConfigError, RefusedError

STACKS = {"px4": "PX4 Pro", "ardupilot": "ArduPilot"}
"""As QGroundControl writes them."""


@dataclass(frozen=True, slots=True)
class Held:
    """All parameters that a vehicle holds."""

    name: str
    sysid: int
    compid: int
    autopilot: str
    params: tuple[Param, ...]


def held_of(entry: Mapping[str, Any]) -> Held:
    """One entry of params.list's answer. Raises RefusedError if it is not complete."""
    if not entry["ok"]:
        raise RefusedError(f"{entry['name']}: its parameters are not known: {entry['message']}")
    params = tuple(_param(p) for p in entry["params"] if p["value"] is not None)
    return Held(entry["name"], entry["sysid"], entry["compid"], entry["autopilot"], params)


def _param(entry: Mapping[str, Any]) -> Param:
    type_ = ParamType[entry["type"]]
    value = entry["value"]
    return Param(entry["name"], int(value) if type_.integer and value == int(value) else float(value), type_)


def kind_of(path: Path) -> Kind:
    """By its ending. Raises BadParameter for another."""
    kinds: dict[str, Kind] = {".params": "qgc", ".param": "plain", ".parm": "plain"}
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise typer.BadParameter(f"{path}: name it .params (QGroundControl) or .param, .parm (the others)")
    return kind


def include_of(text: str) -> frozenset[Sort]:
    """ "calibration,identity" or "all", and the settings in any case. Raises BadParameter."""
    words = [w.strip() for w in text.split(",") if w.strip()]
    if "all" in words:
        return frozenset(SORTS)
    if wrong := [w for w in words if w not in SORTS]:
        raise typer.BadParameter(f"--include: no {', '.join(wrong)}; there are: {', '.join(SORTS)}, all")
    return frozenset(s for s in SORTS if s == "settings" or s in words)


def read_file(path: Path) -> ParamFile:
    """Raises ConfigError with line and reason."""
    try:
        if path.stat().st_size > 4 * MAX_CHARS:
            raise ConfigError(str(path), ["is too long for a parameter file"])
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is no text in UTF-8 (byte {error.start})"]) from None
    return parse(text, str(path))


def write_file(path: Path, held: Held, kind: Kind, state: Mapping[str, Any]) -> None:
    """Whole or not at all. ``state``: the vehicle's, for the header."""
    about = {"Stack": STACKS.get(held.autopilot, held.autopilot), "Vehicle": str(state.get("type", "unknown"))}
    if state.get("firmware"):
        about["Version"] = str(state["firmware"])
    file = of_vehicle(held.params, kind, sysid=held.sysid, compid=held.compid, about=about)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}", suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as out:
            out.write(write(file))
        Path(name).chmod(0o644)
        os.replace(name, path)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise
