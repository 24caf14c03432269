"""`skygcs-cli preflight`: check whether vehicles are ready to fly, what is wrong and how to correct it."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run, show, waiting
from skygcs.cli.options import Json, OptionalTargets
from skygcs.cli.params import outcome_lines
from skygcs.cli.render import print_lines, say, screen_width, wrapped
from skygcs.core.mavlink.param_encoding import NAME_CHARS, short_float
from skygcs.rpc.client import Client

Report = Mapping[str, Any]

WORDS = {"danger": "DANGER ", "fault": "FAULT  ", "note": "note   "}
UNKNOWN = "unknown"
INDENT = 10
"""Columns before the text of a finding; what to do is printed below it."""

SEVERITIES = ("danger", "fault", "note")
REBOOT_HINT = "some parameters take effect only after a reboot; run preflight again then"


def preflight(
    targets: OptionalTargets = "all",
    fix: Annotated[bool, typer.Option("--fix", help="Set the parameters that correct a finding.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="With --fix: do not ask.")] = False,
    everything: Annotated[
        bool, typer.Option("--all", "-a", help="Show also the checks that passed or were skipped.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Check whether vehicles are ready to fly; exit 0 if all of them are.

    The fleet file says what is expected of them ([types.NAME.preflight]). --fix shows the parameters it would set,
    asks, sets them, reads them back and checks again.

    Example: skygcs-cli preflight all --fix
    """
    if fix and json_output and not yes:
        raise typer.BadParameter("--fix asks before it sets anything: with --json give --yes, too")

    def lines(answer: dict[str, Any]) -> Iterator[str]:
        return report_lines(answer["vehicles"], screen_width(sys.stdout), everything=everything)

    async def command(gcs: Client) -> int:
        # examine
        async with waiting(f"preflight {targets}"):
            answer = await gcs.call("preflight.run", targets=targets)
        # set what was agreed to, and examine again
        if fix and _agreed(answer["vehicles"], yes=yes, quiet=json_output):
            confirmed = planned(answer["vehicles"])
            async with waiting(f"preflight {targets}"):
                answer = await gcs.call("preflight.run", targets=targets, fix=True, confirmed=confirmed)
            if not json_output:
                print_lines(_fixed_lines(answer["vehicles"]))
        # show
        show(answer, json_output, lines)
        return Exit.DONE if answer["ok"] else Exit.FAILED

    run(command)


def _agreed(vehicles: Mapping[str, Any], *, yes: bool, quiet: bool) -> bool:
    """Print what --fix would set, and ask; True if it may be set."""
    plan = list(plan_lines(vehicles))
    if not plan:
        if not quiet:
            say("no finding can be corrected by a parameter")
        return False
    if not quiet:
        print_lines(("to be set:", *plan))
    if yes:
        return True
    if not sys.stdin.isatty():
        fail("nothing was set: there is no terminal to ask at; --yes sets it")
        return False
    return typer.confirm(f"Set {'this parameter' if len(plan) == 1 else f'these {len(plan)} parameters'}?")


def _fixed_lines(vehicles: Mapping[str, Any]) -> Iterator[str]:
    fixed = {name: report["fixed"] for name, report in vehicles.items() if report["fixed"]}
    yield from outcome_lines(fixed)
    if fixed:
        yield REBOOT_HINT


def report_lines(
    vehicles: Mapping[str, Report], columns: int | None = None, *, everything: bool = False
) -> Iterator[str]:
    """Vehicle by vehicle; with ``everything`` also the checks that passed or were skipped."""
    for name, report in vehicles.items():
        yield wrapped(f"{name}: {_head(report)}", columns, indent=2)
        # what is wrong, and what to do about it
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
    """Return what failed, worst first, then what is unknown."""
    wrong = [f for f in report["findings"] if f["verdict"] in ("fail", "unknown")]
    return sorted(wrong, key=lambda f: (f["verdict"] == "unknown", SEVERITIES.index(f["severity"])))


def plan_lines(vehicles: Mapping[str, Report]) -> Iterator[str]:
    """The parameters that --fix would set; empty if it would set nothing."""
    width = max(map(len, vehicles), default=0)
    for name, report in vehicles.items():
        for fix in report["fixes"]:
            change = f"{_value(fix['before'])} -> {_value(fix['value'])}"
            yield f"  {name:<{width}}  {fix['name']:<{NAME_CHARS}}  {change}"


def planned(vehicles: Mapping[str, Report]) -> dict[str, dict[str, float]]:
    """The parameters that --fix would set, as preflight.run takes them."""
    return {
        name: {f["name"]: f["value"] for f in report["fixes"]} for name, report in vehicles.items() if report["fixes"]
    }


def _head(report: Report) -> str:
    counts = {
        verdict: sum(f["verdict"] == verdict for f in report["findings"]) for verdict in ("fail", "unknown", "pass")
    }
    if report.get("in_air"):
        failed = f", {counts['fail']} failed" if counts["fail"] else ""
        return f"in flight, no arming decision: {counts['pass']} checks pass now{failed}"
    if report["ok"]:
        return f"ready, {counts['pass']} checks passed"
    problems = [f"{counts['fail']} failed"] * bool(counts["fail"]) + [f"{counts['unknown']} unknown"] * bool(
        counts["unknown"]
    )
    return f"NOT READY, {', '.join(problems)}, {counts['pass']} passed"


def _quiet(report: Report, columns: int | None) -> Iterator[str]:
    for verdict, word in (("pass", "ok     "), ("skipped", "-      ")):
        for finding in report["findings"]:
            if finding["verdict"] == verdict:
                yield wrapped(f"  {word} {finding['check']}: {finding['text']}", columns, indent=INDENT)


def _value(value: float) -> str:
    return str(value) if isinstance(value, int) else short_float(value)


def add_to(app: typer.Typer) -> None:
    app.command()(preflight)
