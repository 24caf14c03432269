"""A parameter file as what simulated vehicles begin with: a real vehicle's thousand parameters instead of the fifty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from skygcs.core.params.names import sort_of
from skygcs.core.params.param_file import Entry, ParamFile
from skygcs.errors import ConfigError
from skygcs.sim import protocol as m
from skygcs.sim.firmware_params import copter_params, px4_params
from skygcs.sim.param_table import INTEGER_RANGE, Param

Family = Literal["px4", "ardupilot"]


@dataclass(frozen=True, slots=True)
class ParamSet:
    """Parameters that the vehicles of one firmware take in, without their identities (system ids)."""

    family: Family
    params: Mapping[str, Param]


def param_set(file: ParamFile, source: str) -> ParamSet:
    """Set for the firmware with which the file shares more names. Raises ConfigError if it shares none."""
    names = {entry.name for entry in file.entries}
    shared: dict[Family, int] = {
        "px4": len(names & {p.name for p in px4_params(1)}),
        "ardupilot": len(names & {p.name for p in copter_params(1)}),
    }
    family = max(shared, key=lambda f: shared[f])
    if not shared[family]:
        raise ConfigError(source, ["holds no parameter that a simulated PX4 or ArduCopter has"])
    return ParamSet(family, {e.name: _param(e) for e in file.entries if sort_of(e.name) != "identity"})


def _param(entry: Entry) -> Param:
    """Parameter of its own type where the file names one that simulated vehicles have; else a float, which holds them
    all."""
    type_ = m.MAV_PARAM_TYPE_REAL32 if entry.type is None else int(entry.type)
    value = float(entry.value)
    low, high = INTEGER_RANGE.get(type_, (0, -1))
    if not (low <= value <= high and value == round(value)):
        type_ = m.MAV_PARAM_TYPE_REAL32
    return Param(entry.name, value, type_)
