"""The findings of the checks, and their summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from typing import Any

from skygcs.core.mavlink.param_encoding import Value
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
