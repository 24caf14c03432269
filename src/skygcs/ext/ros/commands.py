"""`skygcs-cli ros`: what nodes read and at which rates, and the messages and actions of skygcs for a workspace."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import fail, run_show
from skygcs.cli.options import Json
from skygcs.cli.process import EXIT_FAILED
from skygcs.cli.render import plural

PACKAGE = "skygcs_msgs"

app = typer.Typer(help="Vehicles as topics and services of ROS.", no_args_is_help=True)


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show which vehicles are in ROS, and each topic that is read: readers and measured rate.

    Example: skygcs-cli ros status
    """
    run_show("ros.status", json_output, status_lines)


@app.command("messages")
def messages(
    folder: Annotated[Path, typer.Argument(help="The package's folder, which is empty or not there yet.")],
) -> None:
    """Write the package skygcs_msgs, which a colcon workspace builds as it is: messages of /skygcs/… and actions.

    Example: skygcs-cli ros messages ~/ros2_ws/src/skygcs_msgs
    """
    try:
        written = write_messages(folder)
    except OSError as error:
        fail(f"{folder}: {error.strerror or error}")
        raise typer.Exit(EXIT_FAILED) from None
    print(f"{plural(len(written), 'file')} written; in the workspace: colcon build --packages-select {PACKAGE}")


def write_messages(folder: Path) -> list[Path]:
    """Write the package, and return its files. Raises OSError, FileExistsError for a folder that is not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(errno.EEXIST, "it is not empty, and nothing in it is written over")
    made = []
    for part in (".", "msg", "action"):
        (folder / part).mkdir(parents=True, exist_ok=True)
        for source in files("skygcs.core.ros").joinpath(PACKAGE, part).iterdir():
            if source.is_file():
                made.append(folder / part / source.name)
                made[-1].write_text(source.read_text("utf-8"), "utf-8")
    return made


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
        counts = {
            "setpoints sent": vehicle["setpoints_sent"],
            "setpoints refused": vehicle["setpoints_refused"],
            "commands rejected": vehicle["commands_rejected"],
        }
        shown = [vehicle["name"], vehicle["root"], vehicle["setpoints"]]
        yield "  ".join(filter(None, [*shown, *(f"{count} {what}" for what, count in counts.items() if count)]))
    width = max((len(topic["name"]) for topic in report["topics"]), default=0)
    for topic in report["topics"]:
        refused = f"  {topic['refused']} refused" if topic["refused"] else ""
        readers = f"  {plural(topic['readers'], 'reader')}" if topic["readers"] else ""
        yield f"  {topic['name']:{width}}  {topic['rate_hz']:6.1f} Hz{readers}{refused}"
    if report["rejected"]:
        yield f"{plural(report['rejected'], 'sample')} of other types dropped"


def add_to(main: typer.Typer) -> None:
    """Add the commands to the program."""
    main.add_typer(app, name="ros")
