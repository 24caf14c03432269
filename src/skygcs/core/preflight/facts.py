"""The input of the checks: one vehicle's state, parameters and links, and its entry in the fleet file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

from skygcs.core.mavlink.modes import Family
from skygcs.core.mavlink.param_encoding import Param, Value
from skygcs.core.mavlink.vehicle_class import Abilities, VehicleClass, abilities_of
from skygcs.core.params.names import other_name
from skygcs.core.vehicle.vehicle_model import Sticks


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of reading a parameter: its value, or why it is unknown.

    ``absent``: the vehicle answers, and has none of this name. ``why``: of any other failure.
    """

    param: Param | None = None
    absent: bool = False
    why: str = ""


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """One link on which the vehicle is heard.

    ``loss``: 0..1 of its frames of the last while, None with too few of them. ``margin_db``: the lower of signal above
    noise at either end of a radio, None without a radio or recent report. Of several vehicles behind one radio the
    margin is the radio's own word for whom it heard last.
    """

    loss: float | None = None
    frames: int = 0
    margin_db: float | None = None


@dataclass(frozen=True, slots=True)
class PreflightFacts:
    """``state``: a `VehicleState`. ``configured``: it is named in the fleet file; None: that file names none.

    ``links`` by name. ``answers`` by parameter's name, for all that `table.needed_params` names. ``gcs_sysid``: ours;
    None on a companion, which is no ground station.
    ``copter``: ArduPilot's copter firmware flies it, if ArduPilot does.
    """

    state: Mapping[str, Any]
    gcs_sysid: int | None = 255
    configured: bool | None = None
    expected_autopilot: str | None = None
    links: Mapping[str, LinkFacts] | None = None
    answers: Mapping[str, Answer] | None = None
    copter: bool = False
    abilities: Abilities | None = None
    """Abilities of its class; None: a copter's."""
    sticks: Sticks = Sticks.UNKNOWN
    """State of a pilot's sticks by the vehicle's telemetry."""
    outside: Mapping[str, str] | None = None
    """By name: why a parameter whose value is known is outside the range of its metadata; None: there are no metadata
    of this firmware."""
    judged: int = 0
    """Number of parameters that were compared with their ranges."""
    pose_problem: str | None = None
    """Why it cannot fly by its poses of motion capture now; None: it can, or it has none."""
    origin_off_m: float | None = None
    """Distance of its estimator's origin from [origin]; None: it has reported none."""

    @property
    def family(self) -> str:
        """px4, ardupilot or generic."""
        return str(self.state["autopilot"])

    @property
    def class_abilities(self) -> Abilities:
        """Abilities of its class with its firmware."""
        return self.abilities or abilities_of(cast("Family", self.family), VehicleClass.COPTER)

    @property
    def able(self) -> bool:
        """True if its reports can be trusted: it is connected, live, and the only one with its system id."""
        state = self.state
        return bool(state["connected"]) and not state["duplicate_sysid"] and not state["replayed"]

    def answer(self, name: str) -> Answer:
        """The value of a parameter that was read, by its name of 4.6 or 4.7; a NaN counts as missing."""
        answers = self.answers or {}
        answer = answers.get(name) or answers.get(other_name(name) or "") or Answer(why="it was not asked for")
        if answer.param is not None and not math.isfinite(answer.param.value):
            return Answer(why=f"it says {answer.param.value}")
        return answer

    def value(self, name: str) -> Value | None:
        """The value; None if it is unknown or the firmware does not have it."""
        param = self.answer(name).param
        return None if param is None else param.value

    def fresh(self, section: str, limit_s: float) -> Mapping[str, Any] | None:
        """A telemetry group of the state that is not older than this, else None."""
        part: Mapping[str, Any] | None = self.state.get(section)
        return part if part is not None and part["age_s"] <= limit_s else None


class ReturnSetting(NamedTuple):
    """The parameter of the height in which a vehicle returns, and its units per metre."""

    param: str
    per_metre: float
    height_m: float


def offered_heights(heights: Mapping[str, ReturnSetting | None], apart_m: float) -> dict[str, float]:
    """Return heights in metres so far apart that all vehicles may return at once, as when the ground station is lost:
    in the order they have now, none lower than it is."""
    offered: dict[str, float] = {}
    last_m = -math.inf
    for name, height in sorted(
        ((n, h) for n, h in heights.items() if h is not None), key=lambda item: (item[1].height_m, item[0])
    ):
        last_m = max(height.height_m, last_m + apart_m)
        offered[name] = float(math.ceil(last_m - 1e-9))
        last_m = offered[name]
    return offered
