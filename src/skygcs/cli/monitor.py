"""`skygcs-cli monitor`: which vehicles are about to meet, and what cannot be watched."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import typer

from skygcs.cli.connection import run_show
from skygcs.cli.options import Json
from skygcs.cli.render import fixed, plural


def monitor(json_output: Json = False) -> None:
    """Show which vehicles are about to meet, and which cannot be watched for it.

    Example: skygcs-cli monitor
    """
    run_show("monitor.status", json_output, monitor_lines)


def monitor_lines(state: Mapping[str, Any]) -> Iterator[str]:
    """The answer of monitor.status for a person."""
    if state["mode"] == "off":
        yield 'off: nothing is watched and orders are not checked (fleet file: [monitor] mode = "advisory")'
        return
    parked = state["watched"] - state["flying"]
    yield f"{state['mode']}: {plural(state['watched'], 'vehicle')} watched, {state['flying']} flying, {parked} parked"
    for conflict in state["conflicts"]:
        yield conflict_line(conflict)
    for vehicle in state["unwatched"]:
        where = "flies and " if vehicle["flying"] else ""
        yield f"not watched  {vehicle['vehicle']}: {where}{vehicle['reason']}"
    counters = state["counters"]
    yield (
        f"so far: {plural(counters['notices'], 'notice')}, {plural(counters['warnings'], 'warning')}, "
        f"{plural(counters['actions'], 'action')}, {plural(counters['holds'], 'hold')} "
        f"({counters['holds_failed']} failed), {plural(counters['orders_refused'], 'order')} refused"
    )


def conflict_line(conflict: Mapping[str, Any]) -> str:
    """One pair: level, names, what is predicted and each term of the margin."""
    first, second = conflict["vehicles"]
    line = f"{conflict['level']:<11}  {first} and {second}: "
    if conflict.get("margin_m") is None:
        return line + "clear at present"
    return line + (
        f"{fixed(conflict['distance_m'], 1)} m now, {fixed(conflict['closest_m'], 1)} m in "
        f"{fixed(conflict['closest_in_s'], 0)} s; margin {fixed(conflict['margin_m'], 1)} m = wingspans "
        f"{fixed(conflict['wingspans_m'], 1)} + position errors {fixed(conflict['position_errors_m'], 1)} + age "
        f"{fixed(conflict['balls_m'], 1)}"
    )


def add_to(app: typer.Typer) -> None:
    app.command()(monitor)
