"""What `skygcs-cli param` prints, as lines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from skygcs.core.mavlink.param_encoding import NAME_CHARS, float32, short_float
from skygcs.core.params.compare import ApplyPlan, Change, Difference
from skygcs.core.params.param_file import Rounding

BAR_CELLS = 30
MAX_NAMED = 10
"""Names listed of those that are left alone."""


def outcomes(told: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[str]:
    """One line per vehicle and parameter."""
    width = max((len(name) for name in told), default=0)
    for vehicle, by_name in told.items():
        for asked, outcome in by_name.items():
            name = asked if asked == outcome["name"] else f"{asked} ({outcome['name']})"
            word = "ok  " if outcome["ok"] else "FAIL"
            yield f"{word} {vehicle:<{width}}  {name:<{NAME_CHARS}}  {outcome['message']}"


def lists(told: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """All parameters, each vehicle under its head."""
    for name, entry in told.items():
        how = "not read again" if entry["source"] == "cache" else f"read in {entry['elapsed_s']:.1f} s"
        if entry["vouched"] == "count":
            how = "from an earlier run, by their number only; --refresh reads them"
        yield f"{name}: {entry['message']} ({how})" if entry["ok"] else f"{name}: FAIL {entry['message']}"
        for param in entry["params"]:
            yield f"  {param['name']:<{NAME_CHARS}}  {_value(param['value']):<14} {param['type']}"


def differences(first: str, second: str, found: Sequence[Difference]) -> Iterator[str]:
    if not found:
        yield "no difference"
        return
    yield f"{'':<{NAME_CHARS}}  {first}  ->  {second}"
    for d in found:
        other = f"  (there {d.other})" if d.other else ""
        note = "" if d.sort == "settings" else f"  [{d.sort}]"
        yield f"{d.name:<{NAME_CHARS}}  {_side(d.first)}  ->  {_side(d.second)}{other}{note}"


WRITERS: Mapping[Rounding, str] = {
    "6 decimals": "rounded to 6 decimals, as MAVProxy writes them",
    "7 digits": "rounded to 7 digits, as Mission Planner writes them",
}
"""QGroundControl's 18 decimals hide nothing that matters to anybody."""


def rounded(name: str, rounding: Rounding) -> Iterator[str]:
    """Says what a comparison with this file cannot show."""
    if rounding in WRITERS:
        yield f"{name}: its values are {WRITERS[rounding]}; smaller differences do not show"


def after_lines(vehicle: str, left: Sequence[Change]) -> Iterator[str]:
    """What differs from the file when all is done and read again."""
    if not left:
        yield f"{vehicle}: read again, nothing differs from the file"
        return
    yield f"{vehicle}: read again, {len(left)} still {'differs' if len(left) == 1 else 'differ'} from the file:"
    for change in left:
        yield f"  {change.name:<{NAME_CHARS}}  {_value(change.before)} instead of {_value(change.value)}"


def plan_lines(vehicle: str, made: ApplyPlan) -> Iterator[str]:
    """What applying a file would do."""
    yield f"{vehicle}: {len(made.changes)} to set, {made.same} as they are, {len(made.skipped)} left alone"
    for note in rounded("the file", made.rounding):
        yield f"  {note}"
    for warning in made.warnings:
        yield f"  WARNING: {warning}"
    for problem in made.problems:
        yield f"  FAIL {problem}"
    for change in made.changes:
        yield f"  {change.name:<{NAME_CHARS}}  {_value(change.before)} -> {_value(change.value)}"
    if made.skipped:
        yield f"  left alone (see --include): {_named(name for name, _ in made.skipped)}"
    if made.unknown:
        yield f"  the vehicle has no {_named(made.unknown)}"
        yield "  (ArduPilot shows some only when their feature is on: apply again after that)"
    if made.changes:
        yield "  some parameters take effect after a reboot only; autopilots do not say which"


def plan_data(made: ApplyPlan) -> dict[str, Any]:
    """The plan as JSON."""
    return asdict(made)


def bar(event: Mapping[str, Any]) -> str:
    """A progress event as a bar."""
    data = event["data"]
    percent = data.get("percent")
    if percent is None:
        return str(event["text"])
    full = BAR_CELLS * percent // 100
    left = "" if data.get("remaining_s") is None else f"  {data['remaining_s']:.0f} s left"
    counted = f"{data['received']}/{data['count']}"
    return f"{event['vehicle']}  [{'#' * full}{'.' * (BAR_CELLS - full)}] {counted}{left}"


def _named(names: Iterable[str]) -> str:
    listed = list(names)
    more = len(listed) - MAX_NAMED
    return ", ".join(listed[:MAX_NAMED]) + (f" and {more} more" if more > 0 else "")


def _side(value: float | None) -> str:
    return "-" if value is None else _value(value)


def _value(value: float | None) -> str:
    if value is None:
        return "?"
    return str(value) if isinstance(value, int) or float32(value) != value else short_float(value)
