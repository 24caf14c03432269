"""Where the user's autopilot binaries are: `SKYGCS_ARDUCOPTER`, `SKYGCS_ARDUPLANE`, `SKYGCS_ROVER` and `SKYGCS_PX4`.
skygcs brings none."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from skygcs.errors import ConfigError

PX4 = "SKYGCS_PX4"


class Program(NamedTuple):
    """One of ArduPilot's programs: the variable that names its binary, and what it is called in a clone."""

    variable: str
    binary: str
    target: str
    """Target of `./waf`."""
    defaults: str
    """Its default parameters, below Tools/autotest."""

    @property
    def defaults_variable(self) -> str:
        """The variable that names the file of default parameters."""
        stem = Path(self.defaults).stem.upper()
        return f"SKYGCS_{'QUADPLANE' if stem == 'QUADPLANE' else self.variable.removeprefix('SKYGCS_')}_DEFAULTS"

    @property
    def help(self) -> str:
        """How to get it, and what to set."""
        return (
            f"build it in a clone of ArduPilot (./waf configure --board sitl && ./waf {self.target}) and set "
            f"{self.variable}=…/ardupilot/build/sitl/bin/{self.binary}"
        )


PROGRAMS = {
    "ardupilot": Program("SKYGCS_ARDUCOPTER", "arducopter", "copter", "default_params/copter.parm"),
    "ardupilot_plane": Program("SKYGCS_ARDUPLANE", "arduplane", "plane", "models/plane.parm"),
    "quadplane": Program("SKYGCS_ARDUPLANE", "arduplane", "plane", "default_params/quadplane.parm"),
    "rover": Program("SKYGCS_ROVER", "ardurover", "rover", "default_params/rover.parm"),
}
"""By the kinds of simulated vehicles (`sim.sitl.KINDS`) that they are the firmware of."""

PX4_HELP = (
    "build it in a clone of PX4-Autopilot (make px4_sitl_default) and set "
    f"{PX4}=…/PX4-Autopilot/build/px4_sitl_default, or install PX4's package and set {PX4}=/opt/px4"
)


@dataclass(frozen=True, slots=True)
class ArduPilot:
    """A binary, and ArduPilot's own default parameters of its simulated vehicle, without which it has no frame."""

    binary: Path
    defaults: Path


@dataclass(frozen=True, slots=True)
class Px4:
    """The binary and its startup files."""

    binary: Path
    etc: Path


def find_ardupilot(kind: str, environment: Mapping[str, str] = os.environ) -> ArduPilot:
    """The program of a kind of `PROGRAMS`. Raises ConfigError, which says what to set, if it is not named or not
    there."""
    program = PROGRAMS[kind]
    binary = _named(environment, program.variable, program.help)
    if binary.is_dir():
        binary = binary / program.binary
    _check_executable(binary, program.variable)
    named = environment.get(program.defaults_variable)
    file = Path(program.defaults)
    places = [Path(named).expanduser()] if named else [binary.with_name(file.name)]
    if not named and len(binary.parents) > 3:  # ardupilot/build/sitl/bin/arducopter
        places.append(binary.parents[3] / "Tools" / "autotest" / file)
    for place in places:
        if place.is_file():
            return ArduPilot(binary, place.resolve())
    tried = " nor ".join(str(place) for place in places)
    reason = f"its default parameters are not at {tried}: set {program.defaults_variable} to ArduPilot's {file.name}"
    raise ConfigError(str(binary), [reason])


def find_px4(environment: Mapping[str, str] = os.environ) -> Px4:
    """A build folder or installation with ``bin/px4`` and ``etc``, or the binary within one. Raises ConfigError."""
    named = _named(environment, PX4, PX4_HELP)
    binary = named / "bin" / "px4" if named.is_dir() else named
    _check_executable(binary, PX4)
    binary = binary.resolve()  # a package links /usr/bin/px4 to its own folder
    for etc in (binary.parent.parent / "etc", binary.parent / "etc"):
        if (etc / "init.d-posix" / "rcS").is_file():
            return Px4(binary, etc)
    raise ConfigError(str(binary), [f"its startup files (etc/init.d-posix/rcS) are not in {binary.parent.parent}"])


def _named(environment: Mapping[str, str], variable: str, help_text: str) -> Path:
    value = environment.get(variable, "").strip()
    if not value:
        raise ConfigError(variable, [f"is not set: {help_text}"])
    path = Path(value).expanduser()
    if not path.exists():
        raise ConfigError(variable, [f"{path} is not there: {help_text}"])
    return path.absolute()


def _check_executable(binary: Path, variable: str) -> None:
    if not binary.is_file():
        raise ConfigError(variable, [f"{binary} is not there"])
    if not os.access(binary, os.X_OK):
        raise ConfigError(variable, [f"{binary} is not executable"])
