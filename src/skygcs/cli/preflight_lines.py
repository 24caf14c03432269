"""What `skygcs-cli preflight` prints, as lines: what is wrong and what to do, worst first; what is well in a word."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from skygcs.cli.render import wrapped
from skygcs.core.mavlink.param_encoding import NAME_CHARS, short_float

Report = Mapping[str, Any]

WORDS = {"danger": "DANGER ", "fault": "FAULT  ", "note": "note   "}
UNKNOWN = "unknown"
INDENT = 10
"""Columns before the text of a finding; what to do stands below it."""

SEVERITIES = ("danger", "fault", "note")


def report_lines(
    vehicles: Mapping[str, Report], columns: int | None = None, *, everything: bool = False
) -> Iterator[str]:
    """Vehicle by vehicle; with ``everything`` also what passed and what was not expected."""
    for name, report in vehicles.items():
        yield wrapped(f"{name}: {_head(report)}", columns, indent=2)
        for finding in complaints(report):
            word = UNKNOWN if finding["verdict"] == "unknown" else WORDS[finding["severity"]]
            text = finding["text"] if finding["check"] in finding["text"] else f"{finding['check']}: {finding['text']}"
            yield wrapped(f"  {word} {text}", columns, indent=INDENT)
            if finding["todo"]:
                yield wrapped(f"{'':<{INDENT}}-> {finding['todo']}", columns, indent=INDENT + 3)
        if report["unfixed"]:
            yield wrapped(f"  not set: {report['unfixed']}", columns, indent=INDENT)
        if everything:
            yield from _quiet(report, columns)
    flying = sum(bool(report.get("in_air")) for report in vehicles.values())
    ready = sum(report["ok"] and not report.get("in_air") for report in vehicles.values())
    if len(vehicles) > 1:
        yield f"{ready} of {len(vehicles)} ready" + (f", {flying} in flight" if flying else "")


def complaints(report: Report) -> list[Mapping[str, Any]]:
    """What failed, worst first, then what is not known."""
    wrong = [f for f in report["findings"] if f["verdict"] in ("fail", "unknown")]
    return sorted(wrong, key=lambda f: (f["verdict"] == "unknown", SEVERITIES.index(f["severity"])))


def plan_lines(vehicles: Mapping[str, Report]) -> Iterator[str]:
    """What --fix would set; nothing if there is nothing."""
    width = max(map(len, vehicles), default=0)
    for name, report in vehicles.items():
        for fix in report["fixes"]:
            change = f"{_value(fix['before'])} -> {_value(fix['value'])}"
            yield f"  {name:<{width}}  {fix['name']:<{NAME_CHARS}}  {change}"


def planned(vehicles: Mapping[str, Report]) -> dict[str, dict[str, float]]:
    """The same, as the method takes it."""
    return {
        name: {f["name"]: f["value"] for f in report["fixes"]} for name, report in vehicles.items() if report["fixes"]
    }


def _head(report: Report) -> str:
    counts = {
        verdict: sum(f["verdict"] == verdict for f in report["findings"]) for verdict in ("fail", "unknown", "pass")
    }
    if report.get("in_air"):
        failed = f", {counts['fail']} failed" if counts["fail"] else ""
        return f"in flight, where nothing is armed: {counts['pass']} checks pass now{failed}"
    if report["ok"]:
        return f"ready, {counts['pass']} checks passed"
    told = [f"{counts['fail']} failed"] * bool(counts["fail"]) + [f"{counts['unknown']} unknown"] * bool(
        counts["unknown"]
    )
    return f"NOT READY, {', '.join(told)}, {counts['pass']} passed"


def _quiet(report: Report, columns: int | None) -> Iterator[str]:
    for verdict, word in (("pass", "ok     "), ("skipped", "-      ")):
        for finding in report["findings"]:
            if finding["verdict"] == verdict:
                yield wrapped(f"  {word} {finding['check']}: {finding['text']}", columns, indent=INDENT)


def _value(value: float) -> str:
    return str(value) if isinstance(value, int) else short_float(value)
