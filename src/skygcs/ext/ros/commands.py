"""`skygcs-cli ros`: what nodes read and at which rates, the process by hand, and the interfaces for a workspace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import typer

from skygcs.cli.connection import run_show
from skygcs.cli.options import Json
from skygcs.cli.render import plural

app = typer.Typer(help="Vehicles as topics and services of ROS.", no_args_is_help=True)


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show which vehicles are in ROS, and each topic that is read: readers and measured rate.

    Example: skygcs-cli ros status
    """
    run_show("ros.status", json_output, status_lines)


def status_lines(state: Mapping[str, Any]) -> Iterator[str]:
    """The answer of ros.status for a person."""
    report = state["report"]
    if report is None:
        yield "running, no report yet" if state["running"] else "not running; the daemon's log says why"
        return
    age = "" if state["age_s"] < 5 else f"  report of {state['age_s']:.0f} s ago"
    yield (
        f"domain {report['domain']} ({report['network']})  commands {report['commands']}  "
        f"{plural(state['restarts'], 'restart')}{age}"
    )
    for vehicle in report["vehicles"]:
        yield f"{vehicle['name']}  {vehicle['root']}  {vehicle['setpoints']}".rstrip()
    width = max((len(topic["name"]) for topic in report["topics"]), default=0)
    for topic in report["topics"]:
        refused = f"  {topic['refused']} refused" if topic["refused"] else ""
        readers = f"  {plural(topic['readers'], 'reader')}" if topic["readers"] else ""
        yield f"  {topic['name']:{width}}  {topic['rate_hz']:6.1f} Hz{readers}{refused}"
    if report["rejected"]:
        yield f"{plural(report['rejected'], 'sample')} of other types were dropped"


def add_to(main: typer.Typer) -> None:
    """Add the commands to the program."""
    main.add_typer(app, name="ros")
