"""`skygcs-cli fence …`: the fence that an autopilot's parameters make, and its test on foot.

Polygons and circles of a plan are in `mission_flight`.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.connection import Exit, fail, run, waiting
from skygcs.cli.mission_flight import fences
from skygcs.cli.options import Json, OptionalTargets, Targets
from skygcs.cli.orders import tell_outcomes
from skygcs.cli.parsing import finite
from skygcs.rpc.client import Client


class ActionName(StrEnum):
    """What an autopilot does beyond its fence; ArduCopter has no terminate."""

    NONE = "none"
    WARN = "warn"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"
    TERMINATE = "terminate"


BEFORE_THE_WALK = """\
  1  Take the propellers off. All of them.
  2  Put the vehicle where its home is, outdoors, with GPS; a test radius is counted from home.
  3  To see what it does, and not only what it says, arm it (props off!) and keep the throttle a bit up, or it
     disarms by itself. A PX4 that is not armed tells of no breach.
  4  Carry it straight away from home, {radius:g} m and more, until the result is told here.
The fence it has now is put back afterwards, also after Ctrl-C."""


@fences.command("set")
def _set(
    targets: Targets,
    radius: Annotated[
        float | None,
        typer.Option("--radius", metavar="M", parser=finite, help="About home; 0: none.", show_default=False),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option("--height", metavar="M", parser=finite, help="Above home; 0: none.", show_default=False),
    ] = None,
    action: Annotated[
        ActionName | None, typer.Option("--action", help="Beyond it; none: no fence.", show_default=False)
    ] = None,
    json_output: Json = False,
) -> None:
    """Set the fence about home by the autopilot's parameters, and read it back; what is not given stays."""
    if radius is None and height is None and action is None:
        raise typer.BadParameter("give --radius, --height or --action")

    async def command(gcs: Client) -> int:
        word = None if action is None else action.value
        async with waiting(f"fence.set {targets}"):
            answer = await gcs.call("fence.set", targets=targets, radius_m=radius, height_m=height, action=word)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


@fences.command("status")
def _status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show the fences of vehicles, read now, and whether they are beyond them. Exit 1 if one is, or does not tell."""

    async def command(gcs: Client) -> int:
        async with waiting(f"fence.status {targets}"):
            answer = await gcs.call("fence.status", targets=targets)
            lists = {s["vehicle"]: s["counts"]["fence"] for s in await gcs.call("missions.status", targets=targets)}
        outcomes = answer["outcomes"]
        for name, outcome in outcomes.items():
            outcome["fence_items"] = lists.get(name)
        if json_output:
            typer.echo(json.dumps(answer, indent=2))
        for name, outcome in () if json_output else outcomes.items():
            typer.echo(status_line(name, outcome))
        beyond = any(o["ok"] and o["fence"]["breached"] for o in outcomes.values())
        return Exit.FAILED if beyond or not all(o["ok"] for o in outcomes.values()) else Exit.DONE

    run(command)


@fences.command("test")
def _test(
    targets: Targets,
    radius: Annotated[
        float, typer.Option("--radius", metavar="M", parser=finite, help="Of the test's fence about home, 1 to 50.")
    ] = 2.0,
    action: Annotated[ActionName, typer.Option("--action", help="What it is to do beyond it.")] = ActionName.RETURN,
    timeout_s: Annotated[
        float, typer.Option("--timeout", metavar="S", parser=finite, help="For the walk, 5 to 1800.")
    ] = 120.0,
    yes: Annotated[bool, typer.Option("--yes", help="The propellers are off: do not ask.")] = False,
    json_output: Json = False,
) -> None:
    """Test the fence on foot: a small one is set, carry the vehicle out of it, the result goes to a file."""
    if not yes:
        typer.echo(BEFORE_THE_WALK.format(radius=radius), err=True)
        if not sys.stdin.isatty():
            fail("nobody is there to say that the propellers are off: --yes says it")
            raise typer.Exit(Exit.FAILED)
        if typer.prompt('Are the propellers off? Then type "off"', err=True).strip().lower() != "off":
            fail("not tested: nothing was sent")
            raise typer.Exit(Exit.FAILED)

    async def command(gcs: Client) -> int:
        following = asyncio.create_task(_follow(gcs, targets), name="fence events")
        try:
            answer = await gcs.call(
                "fence.test", targets=targets, radius_m=radius, action=action.value, timeout_s=timeout_s
            )
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)
        code = tell_outcomes(answer["outcomes"], json_output)
        for outcome in () if json_output else answer["outcomes"].values():
            if outcome["record"] is not None:
                typer.echo(f"     recorded in {outcome['record']['file']}")
        return code

    run(command)


def add_to(app: typer.Typer) -> None:
    app.add_typer(fences, name="fence")


async def _follow(gcs: Client, targets: str) -> None:
    """What the daemon tells of the test, on stderr: results go to stdout."""
    async for event in gcs.events(targets, kinds=["fence", "armed", "disarmed", "mode", "statustext"]):
        if event["data"].get("state") != "done":
            typer.echo(render.event_line(event), err=True)


def status_line(name: str, outcome: Mapping[str, Any]) -> str:
    """One vehicle's fence."""
    parts = [f"{name:<10}"]
    if not outcome["ok"]:
        return "  ".join((*parts, outcome["message"]))
    parts.append(outcome["message"])
    fence, items = outcome["fence"], outcome["fence_items"]
    if items:
        watched = "" if fence["follows_list"] else ", not watched (FENCE_TYPE)"
        parts.append(f"{items} fence items{watched}")
    elif items is None:
        parts.append("polygons and circles not read yet")
    if fence["breaches"]:
        parts.append(f"{fence['breaches']} breach{'' if fence['breaches'] == 1 else 'es'} since boot")
    if fence["from_home_m"] is not None:
        parts.append(f"{fence['from_home_m']:.1f} m from home")
    if fence["last_text"] is not None:
        parts.append(f'last said "{fence["last_text"]}"')
    return "  ".join(parts)
