"""Findings about a flight before anything arms: which vehicle, what, and what to do about it. Pure."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from skygcs.core.preflight.report import ReturnSetting, offered_heights
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.remedies import Remedy
from skygcs.spelling import rounded

DEFAULT_FLIGHT_TIME_S = 600.0
"""Flight time of a full battery, where nothing is measured or configured: ten minutes, which an F450 with 5000 mAh
exceeds."""

DEFAULT_RESERVE_PERCENT = 30.0
"""Left at the end: below 20 % LiPo cells sag, and a landing or a return still has to be flown."""

LANDING_S = 60.0
"""Flown after the plan: a landing from 30 m at 0.5 m/s."""


class Level(StrEnum):
    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Finding:
    """``vehicle``: None: it is about all. ``insist``: force passes it. A refusal has a remedy, and is made by
    `refused`."""

    vehicle: str | None
    check: str
    level: Level
    text: str
    note: str = ""
    """Remark about a finding that is no refusal."""
    insist: bool = False
    remedy: Remedy | None = None

    def __post_init__(self) -> None:
        if (self.level is Level.REFUSED) != (self.remedy is not None):
            raise ValueError(f"{self.check}: a refusal, and nothing else, has a remedy")

    @property
    def todo(self) -> str:
        """Remedy, as text for people."""
        return self.note if self.remedy is None else self.remedy.text(insist=self.insist)

    def as_dict(self) -> dict[str, Any]:
        return {
            "vehicle": self.vehicle,
            "check": self.check,
            "severity": self.level.value,
            "text": self.text,
            "todo": self.todo,
            "command": None if self.remedy is None else self.remedy.command,
            "insist": self.insist,
        }


def refused(vehicle: str | None, check: str, text: str, remedy: Remedy, *, insist: bool = False) -> Finding:
    """Return what keeps a plan on the ground. ``insist``: force passes it."""
    return Finding(vehicle, check, Level.REFUSED, text, insist=insist, remedy=remedy)


def refusals(findings: Sequence[Finding], *, force: bool) -> list[Finding]:
    """Those that keep the plan on the ground."""
    return [f for f in findings if f.level is Level.REFUSED and not (force and f.insist)]


class FlightTime(NamedTuple):
    """How long a full battery lasts, and where that is from: measured, fleet file or default."""

    seconds: float
    source: str


def battery_finding(
    vehicle: str, percent: float | None, flight_time: FlightTime, plan_s: float, reserve_percent: float
) -> Finding:
    """Judge whether the charge lasts for the plan and a landing, with the reserve left."""
    check = "battery"
    if percent is None:
        remedy = remedies.insist("set up its battery monitor")
        return refused(vehicle, check, "it does not report its charge", remedy, insist=True)
    needed = 100.0 * (plan_s + LANDING_S) / flight_time.seconds
    text = (
        f"{percent:.0f} %; the plan and a landing take {needed:.0f} % ({plan_s + LANDING_S:.0f} s of "
        f"{rounded(flight_time.seconds / 60)} min, {flight_time.source}), {reserve_percent:g} % stay as reserve"
    )
    if percent - needed < reserve_percent:
        remedy = remedies.again("charge it, or set flight_time_min in the fleet file if it flies longer")
        return refused(vehicle, check, text, remedy, insist=True)
    return Finding(vehicle, check, Level.OK, text)


def return_height_findings(heights: Mapping[str, ReturnSetting | None], apart_m: float) -> list[Finding]:
    """Losing the ground sends all home at once: in different heights."""
    check, findings = "return height", []
    for name, height in heights.items():
        if height is None:
            text = "its return height could not be read"
            findings.append(refused(name, check, text, remedies.insist("check its link"), insist=True))
    known = sorted(((h.height_m, name, h.param) for name, h in heights.items() if h is not None))
    offered = offered_heights(heights, apart_m)
    for (low_m, lower, _), (high_m, upper, param) in itertools.pairwise(known):
        if high_m - low_m >= apart_m - 1e-6:
            continue
        text = (
            f"it returns at {rounded(high_m)} m ({param}) and {lower} at {rounded(low_m)} m, {apart_m:.1f} m apart is "
            "the least: if the ground station is lost, all return at once"
        )
        text += f"; --set-return-heights sets it to {rounded(offered[upper])} m"
        findings.append(refused(upper, check, text, remedies.set_return_heights(), insist=True))
    if not findings:
        findings.append(Finding(None, check, Level.OK, f"all return at least {apart_m:.1f} m apart"))
    return findings
