"""The input of the checks, and their findings: one vehicle's state, parameters and links, and its entry in the fleet
file; what was found, and its summary.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple, cast

from skygcs.core.mavlink.modes import Family
from skygcs.core.mavlink.param_encoding import Param, Value
from skygcs.core.mavlink.vehicle_class import Abilities, VehicleClass, abilities_of
from skygcs.core.params.names import other_name
from skygcs.core.routing.source_statistics import LinkFacts
from skygcs.core.vehicle.vehicle_model import Sticks
from skygcs.spelling import listed


class Verdict(StrEnum):
    """``UNKNOWN`` is not a pass: the data that the check needs did not come. ``SKIPPED``: the check does not apply."""

    PASS = "pass"
    FAIL = "fail"
    UNKNOWN = "unknown"
    SKIPPED = "skipped"


class Severity(IntEnum):
    """The consequence of a failure for a flight."""

    DANGER = 3
    """It could fly away, fall, or follow another station."""
    FAULT = 2
    """It would probably refuse to fly, or end the flight early."""
    NOTE = 1
    """It would fly, but not as the fleet file specifies."""


@dataclass(frozen=True, slots=True)
class Fix:
    """A parameter change that corrects the failure, with the vehicle's own name of the parameter."""

    name: str
    value: Value
    before: Value


@dataclass(frozen=True, slots=True)
class Finding:
    """The verdict of one check. ``text``: the finding, with the figure and its limit; ``todo``: what to do about it."""

    verdict: Verdict
    text: str
    todo: str = ""
    fixes: tuple[Fix, ...] = ()
    severity: Severity | None = None
    """None: the severity of the check."""
    check: str = ""

    def named(self, check: str, severity: Severity) -> Finding:
        """The same as a finding of this check. A severity of its own takes precedence."""
        return replace(self, check=check, severity=self.severity or severity)

    def as_dict(self) -> dict[str, Any]:
        return {
            "check": self.check,
            "verdict": self.verdict.value,
            "severity": (self.severity or Severity.FAULT).name.lower(),
            "text": self.text,
            "todo": self.todo,
            "fixes": [{"name": f.name, "before": f.before, "value": f.value} for f in self.fixes],
        }


def passed(text: str) -> Finding:
    return Finding(Verdict.PASS, text)


def failed(text: str, todo: str, *fixes: Fix, severity: Severity | None = None) -> Finding:
    return Finding(Verdict.FAIL, text, todo, fixes, severity)


def unknown(text: str, todo: str) -> Finding:
    return Finding(Verdict.UNKNOWN, text, todo)


def skipped(text: str) -> Finding:
    return Finding(Verdict.SKIPPED, text)


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """All findings of one vehicle, in the order of the table."""

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """True if the vehicle is ready: no check failed, and none that matters is unknown."""
        return not self.complaints

    @property
    def complaints(self) -> tuple[Finding, ...]:
        """The failures, worst first, then the unknowns."""
        wrong = [f for f in self.findings if f.verdict in (Verdict.FAIL, Verdict.UNKNOWN)]
        return tuple(sorted(wrong, key=lambda f: (f.verdict is Verdict.UNKNOWN, -(f.severity or 0))))

    @property
    def fixes(self) -> tuple[Fix, ...]:
        """The corrections, one per parameter; where two checks disagree, the first one counts."""
        by_name: dict[str, Fix] = {}
        for finding in self.complaints:
            for fix in finding.fixes:
                by_name.setdefault(fix.name, fix)
        return tuple(by_name.values())

    def summary(self, most: int = 2) -> str:
        """The worst findings in one line."""
        wrong = self.complaints
        if not wrong:
            return f"ready: {sum(f.verdict is Verdict.PASS for f in self.findings)} checks passed"
        return listed([f.text for f in wrong], most)

    def as_dict(self) -> Mapping[str, Any]:
        return {
            "ok": self.ok,
            "summary": self.summary(),
            "findings": [f.as_dict() for f in self.findings],
            "fixes": [{"name": f.name, "before": f.before, "value": f.value} for f in self.fixes],
        }


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of reading a parameter: its value, or why it is unknown.

    ``absent``: the vehicle answers, and has none of this name. ``why``: of any other failure.
    """

    param: Param | None = None
    absent: bool = False
    why: str = ""


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
    dropped: str = ""
    """Why nothing is done with it any more; empty: it is."""

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
