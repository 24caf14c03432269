"""What the checks look at: one vehicle's state, its parameters, its link and its place in the fleet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.core.mavlink.param_encoding import Param, Value
from skygcs.core.params.names import other_name


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of asking for a parameter: what it is, or why that is not known.

    ``absent``: the vehicle answers, and has none of this name. ``why``: of any other failure.
    """

    param: Param | None = None
    absent: bool = False
    why: str = ""


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """One link on which the vehicle is heard.

    ``loss``: 0..1 of its frames of the last while, None with too few of them. ``margin_db``: the lower of signal above
    noise at either end of a radio, None if it is none or told nothing lately. Of several vehicles behind one radio the
    margin is the radio's own word for whom it heard last.
    """

    loss: float | None = None
    frames: int = 0
    margin_db: float | None = None


@dataclass(frozen=True, slots=True)
class Facts:
    """``state``: a `VehicleState`. ``configured``: it is named in the fleet file; None: that file names none.

    ``links`` by name. ``answers`` by parameter's name, for all that `table.needed_params` names. ``gcs_sysid``: ours.
    ``copter``: ArduPilot's copter firmware flies it, if ArduPilot does.
    """

    state: Mapping[str, Any]
    gcs_sysid: int = 255
    configured: bool | None = None
    expected_autopilot: str | None = None
    links: Mapping[str, LinkFacts] | None = None
    answers: Mapping[str, Answer] | None = None
    copter: bool = False

    @property
    def family(self) -> str:
        """px4, ardupilot or generic."""
        return str(self.state["autopilot"])

    @property
    def able(self) -> bool:
        """Whether anything it says of itself is to be believed and acted on: it is there, and it is one."""
        state = self.state
        return bool(state["connected"]) and not state["duplicate_sysid"] and not state["replayed"]

    def answer(self, name: str) -> Answer:
        """Of a parameter that was asked for, by its name of either generation; what is no finite number is none."""
        answers = self.answers or {}
        answer = answers.get(name) or answers.get(other_name(name) or "") or Answer(why="it was not asked for")
        if answer.param is not None and not math.isfinite(answer.param.value):
            return Answer(why=f"it says {answer.param.value}")
        return answer

    def value(self, name: str) -> Value | None:
        """None if it is not known, or there is none."""
        param = self.answer(name).param
        return None if param is None else param.value

    def fresh(self, section: str, limit_s: float) -> Mapping[str, Any] | None:
        """A section of the state that is not older than this; None if there is none."""
        part: Mapping[str, Any] | None = self.state.get(section)
        return part if part is not None and part["age_s"] <= limit_s else None
