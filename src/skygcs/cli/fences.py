"""`skygcs-cli fence`: the fence that an autopilot's parameters define, its test on foot, and the fence of a plan.

`skygcs-cli undo`: restore what a fence test left changed in a vehicle.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, print_outcomes, run, run_order, run_show, show, waiting
from skygcs.cli.missions import OutFile, Overwrite, PlanFile, clear, download, upload
from skygcs.cli.options import Json, OneVehicle, OptionalTargets, OrderJson, Targets
from skygcs.cli.parsing import finite
from skygcs.cli.render import event_line, say
from skygcs.rpc.client import Client

fences = typer.Typer(
    help="Geofences: one around home, from parameters; polygons and circles of a plan.", no_args_is_help=True
)
undo = typer.Typer(
    help="Restore what a fence test left changed in a vehicle, if the daemon was killed or could not reach it.",
    no_args_is_help=True,
)


class FenceAction(StrEnum):
    """Action of an autopilot outside its fence; ArduCopter has no terminate."""

    NONE = "none"
    WARN = "warn"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"
    TERMINATE = "terminate"


BEFORE_THE_WALK = """\
  1  Take the propellers off. All of them.
  2  Put the vehicle at its home, outdoors, with GPS; the test radius is measured from home.
  3  To see what it does, not only what it reports, arm it (propellers off!) and keep the throttle slightly up,
     or it disarms by itself. A PX4 that is not armed reports no breach.
  4  Carry it straight away from home, {radius:g} m and more, until the result is printed here.
Its present fence is restored afterwards, also after Ctrl-C."""


@fences.command("set")
def _set(
    targets: Targets,
    radius: Annotated[
        float | None,
        typer.Option("--radius", metavar="M", parser=finite, help="Around home; 0: no limit.", show_default=False),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option("--height", metavar="M", parser=finite, help="Above home; 0: no limit.", show_default=False),
    ] = None,
    action: Annotated[
        FenceAction | None, typer.Option("--action", help="Action outside it; none: no fence.", show_default=False)
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Although it flies and would be outside of that fence.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Set the fence around home in the autopilot's parameters and read it back; options not given stay unchanged.

    Example: skygcs-cli fence set all --radius 50 --height 20 --action return
    """
    if radius is None and height is None and action is None:
        raise typer.BadParameter("give --radius, --height or --action")
    word = None if action is None else action.value
    run_order("fence.set", json_output, targets=targets, radius_m=radius, height_m=height, action=word, force=force)


@fences.command("status")
def _status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Read and show the fences of vehicles. Exit 1 if a vehicle is outside its fence, or does not answer.

    Example: skygcs-cli fence status all
    """

    def lines(answer: dict[str, Any]) -> Iterator[str]:
        return (status_line(name, outcome) for name, outcome in answer["outcomes"].items())

    async def command(gcs: Client) -> int:
        async with waiting(f"fence.status {targets}"):
            answer = await gcs.call("fence.status", targets=targets)
            lists = {s["vehicle"]: s["counts"]["fence"] for s in await gcs.call("missions.status", targets=targets)}
        outcomes = answer["outcomes"]
        for name, outcome in outcomes.items():
            outcome["fence_items"] = lists.get(name)
        show(answer, json_output, lines)
        outside = any(o["ok"] and o["fence"]["breached"] for o in outcomes.values())
        return Exit.FAILED if outside or not all(o["ok"] for o in outcomes.values()) else Exit.DONE

    run(command)


@fences.command("test")
def _test(
    targets: Targets,
    radius: Annotated[
        float, typer.Option("--radius", metavar="M", parser=finite, help="Test fence around home, 1 to 50 m.")
    ] = 2.0,
    action: Annotated[FenceAction, typer.Option("--action", help="Action outside it.")] = FenceAction.RETURN,
    timeout_s: Annotated[
        float, typer.Option("--timeout", metavar="S", parser=finite, help="Time for the walk, 5 to 1800 s.")
    ] = 120.0,
    yes: Annotated[bool, typer.Option("--yes", help="The propellers are off: do not ask.")] = False,
    json_output: Json = False,
) -> None:
    """Test the fence on foot: it sets a small fence, you carry the vehicle out of it, a file records the result.

    Example: skygcs-cli fence test alpha --radius 2
    """
    # confirm that the propellers are off
    if not yes:
        say(BEFORE_THE_WALK.format(radius=radius), err=True)
        if not sys.stdin.isatty():
            fail("there is no terminal to confirm that the propellers are off: --yes confirms it")
            raise typer.Exit(Exit.FAILED)
        if typer.prompt('Are the propellers off? Then type "off"', err=True).strip().lower() != "off":
            fail("not tested: nothing was sent")
            raise typer.Exit(Exit.FAILED)

    async def command(gcs: Client) -> int:
        # test, with its events shown
        following = asyncio.create_task(_follow(gcs, targets), name="fence events")
        try:
            answer = await gcs.call(
                "fence.test", targets=targets, radius_m=radius, action=action.value, timeout_s=timeout_s
            )
        finally:
            following.cancel()
            await asyncio.gather(following, return_exceptions=True)
        # show the outcomes
        code = print_outcomes(answer["outcomes"], json_output)
        for outcome in () if json_output else answer["outcomes"].values():
            if outcome["record"] is not None:
                say(f"     recorded in {outcome['record']['file']}")
        return code

    run(command)


async def _follow(gcs: Client, targets: str) -> None:
    """Print the events of the test on stderr; results go to stdout."""
    async for event in gcs.events(targets, kinds=["fence", "armed", "disarmed", "mode", "statustext"]):
        if event["data"].get("state") != "done":
            say(event_line(event), err=True)


def status_line(name: str, outcome: Mapping[str, Any]) -> str:
    """The fence of one vehicle."""
    parts = [f"{name:<10}"]
    if not outcome["ok"]:
        return "  ".join((*parts, outcome["message"]))
    parts.append(outcome["message"])
    fence, items = outcome["fence"], outcome["fence_items"]
    if items:
        enforced = "" if fence["follows_list"] else ", not enforced (FENCE_TYPE)"
        parts.append(f"{items} fence items{enforced}")
    elif items is None:
        parts.append("polygons and circles not read yet")
    if fence["breaches"]:
        parts.append(f"{fence['breaches']} breach{'' if fence['breaches'] == 1 else 'es'} since boot")
    if fence["from_home_m"] is not None:
        parts.append(f"{fence['from_home_m']:.1f} m from home")
    if fence["last_text"] is not None:
        parts.append(f'last text "{fence["last_text"]}"')
    return "  ".join(parts)


# --- the fence of a plan ----------------------------------------------------------------------------------------------


@fences.command("upload")
def _upload(
    targets: Targets,
    file: PlanFile,
    force: Annotated[bool, typer.Option("--force", help="Although the fence has errors.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Upload the fence of a plan to vehicles; their missions stay.

    Example: skygcs-cli fence upload all site.plan
    """
    upload(targets, file, ["fence"], force, json_output)


@fences.command("download")
def _download(vehicle: OneVehicle, file: OutFile = None, force: Overwrite = False, json_output: Json = False) -> None:
    """Read the fence of a vehicle.

    Example: skygcs-cli fence download alpha site.plan
    """
    download(vehicle, file, ["fence"], force, json_output)


@fences.command("clear")
def _clear(
    targets: Targets,
    force: Annotated[bool, typer.Option("--force", help="Although it is in the air.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Delete the vehicles' fences.

    Example: skygcs-cli fence clear all
    """
    clear(targets, ["fence"], force, json_output)


# --- undo -------------------------------------------------------------------------------------------------------------

ChangeId = Annotated[str, typer.Argument(metavar="ID|all", help="As `undo list` shows it.")]


@undo.command("list")
def _undo_list(json_output: Json = False) -> None:
    """Show the changes to undo; skygcs never undoes them by itself.

    Example: skygcs-cli undo list
    """
    run_show("undo.list", json_output, _undo_lines)


@undo.command("run")
def _undo_run(
    id: ChangeId,
    force: Annotated[
        bool, typer.Option("--force", help="Although it is armed, or the values have changed since.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Restore the earlier values, and read them back.

    Example: skygcs-cli undo run all
    """

    async def command(gcs: Client) -> int:
        outcomes: dict[str, Any] = {}
        for one in await _ids(gcs, id):
            async with waiting(f"undo {one}"):
                outcomes |= (await gcs.call("undo.run", id=one, force=force))["outcomes"]
        return print_outcomes(outcomes, json_output)

    run(command)


@undo.command("drop")
def _undo_drop(id: ChangeId) -> None:
    """Remove a change from the list; the vehicle keeps its values.

    Example: skygcs-cli undo drop all
    """

    async def command(gcs: Client) -> None:
        for one in await _ids(gcs, id):
            await gcs.call("undo.drop", id=one)
            say(f"{one} removed from the list")

    run(command)


async def _ids(gcs: Client, id: str) -> list[str]:
    if id != "all":
        return [id]
    return [change["id"] for change in (await gcs.call("undo.list"))["changes"]]


def _undo_lines(answer: dict[str, Any]) -> Iterator[str]:
    for change in answer["changes"]:
        yield f"{change['id']}: {change['vehicle']} (system {change['sysid']}), {change['what']} of {change['began']}"
        yield f"  before  {_values(change['before'])}"
        yield f"  set to  {_values(change['changed'])}"
    for problem in answer["problems"]:
        yield f"cannot be read: {problem}"
    if answer["changes"]:
        yield "skygcs-cli undo run ID restores it, undo drop ID removes it from this list"
    elif not answer["problems"]:
        yield "nothing to undo"


def _values(table: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in table.items())


def add_to(app: typer.Typer) -> None:
    app.add_typer(fences, name="fence")
    app.add_typer(undo, name="undo")
