"""Arguments and options that several commands share, and what the shell proposes for them after TAB."""

from __future__ import annotations

import asyncio
import inspect
import os
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_type_hints

import typer

from skygcs.cli.connection import client
from skygcs.errors import SkygcsError

WAIT_VARIABLE = "SKYGCS_COMPLETION_WAIT_S"
"""Environment variable: how long completion waits for the daemon, for a daemon on another computer or a slow one."""

DEFAULT_WAIT_S = 1.0
"""A person waits at the prompt; the daemon answers within 10 ms on an idle machine."""

MAX_WAIT_S = 600.0

COMMON_MODES = (
    *("AUTO.LAND", "AUTO.LOITER", "AUTO.MISSION", "AUTO.RTL", "AUTO.TAKEOFF", "ALTCTL", "POSCTL", "OFFBOARD"),
    *("MANUAL", "STABILIZED", "ALT_HOLD", "AUTO", "BRAKE", "GUIDED", "LAND", "LOITER", "POSHOLD", "RTL"),
    *("SMART_RTL", "STABILIZE"),
)
"""Flight modes that completion proposes; any other may be typed."""

# --- completion -------------------------------------------------------------------------------------------------------


def wait_s() -> float:
    """How long completion waits for the daemon: $SKYGCS_COMPLETION_WAIT_S if that is a number of seconds."""
    try:
        value = float(os.environ.get(WAIT_VARIABLE, ""))
    except ValueError:
        return DEFAULT_WAIT_S
    return min(value, MAX_WAIT_S) if value >= 0 else DEFAULT_WAIT_S


def complete_targets(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names, groups and "all"; after a comma, the next part of the list."""
    states = _ask(ctx, "vehicles.list") or []
    words = {"all": None} | {s["name"]: None for s in states} | {g: None for s in states for g in s["groups"]}
    before, comma, last = incomplete.rpartition(",")
    return [before + comma + word for word in words if word.startswith(last)]


def complete_messages(ctx: typer.Context, incomplete: str) -> list[str]:
    """Message names of the daemon's dialect; upper and lower case are the same."""
    found = _ask(ctx, "messages.list") or []
    return [m["name"] for m in found if m["name"].upper().startswith(incomplete.upper())]


def complete_commands(ctx: typer.Context, incomplete: str) -> list[str]:
    """MAV_CMD names of the daemon's dialect, without their prefix."""
    found = _ask(ctx, "commands.list") or []
    return [c["name"] for c in found if c["name"].startswith(incomplete)]


def complete_links(ctx: typer.Context, incomplete: str) -> list[str]:
    return [link["name"] for link in _ask(ctx, "links.list") or [] if link["name"].startswith(incomplete)]


def complete_methods(ctx: typer.Context, incomplete: str) -> list[str]:
    document = _ask(ctx, "rpc.discover") or {"methods": []}
    return [m["name"] for m in document["methods"] if m["name"].startswith(incomplete)]


def complete_modes(_: typer.Context, incomplete: str) -> list[str]:
    return [mode for mode in COMMON_MODES if mode.startswith(incomplete.upper())]


def _ask(ctx: typer.Context, method: str) -> Any:
    """The daemon's answer; None if it does not come in time: the shell then proposes nothing."""

    async def ask() -> Any:
        async with asyncio.timeout(wait_s()), client(ctx.find_root().params.get("socket")) as gcs:
            return await gcs.call(method)

    try:
        return asyncio.run(ask())
    except (SkygcsError, OSError, TimeoutError):
        return None


# --- arguments and options --------------------------------------------------------------------------------------------

_TARGETS = "Vehicles: 1, 1,3, 2-5, a name, a group, all"

Targets = Annotated[
    str,
    typer.Argument(
        metavar="TARGETS",
        help=f"{_TARGETS}; of other sites: south/alpha, south/all, */all.",
        autocompletion=complete_targets,
        show_default=False,
    ),
]
ComponentTargets = Annotated[
    str,
    typer.Argument(
        metavar="TARGETS",
        help=f"{_TARGETS}; or components: 7/191, alpha/191, all/100.",
        autocompletion=complete_targets,
        show_default=False,
    ),
]
OptionalTargets = Annotated[
    str, typer.Argument(metavar="TARGETS", help=f"{_TARGETS}.", autocompletion=complete_targets)
]
OneVehicle = Annotated[
    str,
    typer.Argument(
        metavar="VEHICLE", help="Its name or system id.", autocompletion=complete_targets, show_default=False
    ),
]
LinkName = Annotated[
    str, typer.Argument(metavar="NAME", help="The link's name.", autocompletion=complete_links, show_default=False)
]
MessageName = Annotated[
    str,
    typer.Argument(
        metavar="NAME",
        help="A message of the dialect, by name or id.",
        autocompletion=complete_messages,
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

OrderJson = Annotated[
    bool | None,
    typer.Option(
        "--json/--json-lines",
        help="Print JSON: one object at the end, or a line for each vehicle as it answers.",
        show_default=False,
    ),
]
"""See `skygcs.cli.order_output.JsonForm`."""


# --- options that several commands have in common ---------------------------------------------------------------------


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameter of a dataclass type is, on the command line, an option for each of its fields."""
    hints = get_type_hints(command, include_extras=True)
    groups = {name: hint for name, hint in hints.items() if isinstance(hint, type) and is_dataclass(hint)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name in groups:
            group = groups[parameter.name]
            types = get_type_hints(group, include_extras=True)
            parameters += [
                inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=types[f.name])
                for f in fields(group)
            ]
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[parameter.name]))

    def called(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        command(**given)

    called.__name__, called.__doc__ = command.__name__, command.__doc__
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return called
