"""`skygcs-cli mission …` and `fence …` with a daemon: plans to vehicles and back, missions started and followed."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from skygcs.cli import render
from skygcs.cli.connection import Exit, client, run, run_offline, waiting
from skygcs.cli.missions import ListName, PlanFile, missions
from skygcs.cli.options import Json, OptionalTargets, Targets
from skygcs.cli.orders import tell_outcomes
from skygcs.errors import PlanFileError
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from skygcs.core.mission.plan import MissionPlan

fences = typer.Typer(
    help="Geofences: of parameters, about home, and polygons and circles of a plan.", no_args_is_help=True
)

Lists = Annotated[
    list[ListName] | None,
    typer.Option("--only", help="This list only (may be repeated).", show_default=False),
]
OneTarget = Annotated[str, typer.Argument(metavar="VEHICLE", help="Its name or system id.", show_default=False)]
OutFile = Annotated[
    Path | None,
    typer.Argument(
        metavar="[FILE]", help="Default: told, not written. A .plan, or one list as WPL.", show_default=False
    ),
]
Overwrite = Annotated[bool, typer.Option("--force", help="Overwrite FILE.")]
TRANSFERS = ("upload", "download", "clear")
NO_MISSION = "no mission"
"""The state for MISSION_STATE_NO_MISSION."""


@missions.command("upload")
def _upload(
    targets: Targets,
    file: PlanFile,
    only: Lists = None,
    force: Annotated[
        bool, typer.Option("--force", help="Although the plan has errors, or the vehicle flies its mission.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Check a plan against each vehicle and bring it there: mission, fence and rally points that it holds."""
    _bring(targets, file, None if only is None else [name.value for name in only], force, json_output)


@missions.command("download")
def _download(
    vehicle: OneTarget,
    file: OutFile = None,
    only: Lists = None,
    force: Overwrite = False,
    json_output: Json = False,
) -> None:
    """Read a vehicle's mission, fence and rally points."""
    _fetch(vehicle, file, [name.value for name in only or ListName], force, json_output)


@missions.command("clear")
def _clear(
    targets: Targets,
    only: Lists = None,
    force: Annotated[bool, typer.Option("--force", help="Although it flies its mission.")] = False,
    json_output: Json = False,
) -> None:
    """Empty the vehicles' missions; fences and rally points with --only."""
    lists = ["mission"] if only is None else [name.value for name in only]
    _clear_lists(targets, lists, force, json_output)


@missions.command("start")
def _start(
    targets: Targets,
    first: Annotated[int, typer.Option("--first", metavar="ITEM", min=1, help="Begin with this item.")] = 1,
    arm: Annotated[bool, typer.Option("--arm/--no-arm", help="Arm if it is not armed.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Without a required preflight.")] = False,
    json_output: Json = False,
) -> None:
    """Fly the mission that is on board."""
    _order("missions.start", targets, json_output, first=first, arm=arm, force=force)


@missions.command("pause")
def _pause(targets: Targets, json_output: Json = False) -> None:
    """Stop and hold position."""
    _order("missions.pause", targets, json_output)


@missions.command("resume")
def _resume(targets: Targets, json_output: Json = False) -> None:
    """Go on with the current item."""
    _order("missions.resume", targets, json_output)


@missions.command("current")
def _current(
    targets: Targets,
    item: Annotated[int, typer.Argument(metavar="ITEM", min=1, help="Counted from 1.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Make an item the current one."""
    _order("missions.set_current", targets, json_output, item=item)


@missions.command("status")
def _status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show where vehicles are in their missions."""

    async def command(gcs: Client) -> None:
        told = await gcs.call("missions.status", targets=targets)
        if json_output:
            typer.echo(json.dumps(told, indent=2))
        for status in () if json_output else told:
            typer.echo(_mission_line(status))

    run(command)


@missions.command("watch")
def _watch(
    targets: OptionalTargets = "all",
    count: Annotated[int, typer.Option("--count", metavar="N", help="End after so many events.", min=1)] = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Follow missions and transfers: the status, then every item reached, until Ctrl-C."""

    async def command(gcs: Client) -> None:
        news = gcs.events(kinds=["mission", "command"])
        told = await gcs.call("missions.status", targets=targets)
        names = {status["vehicle"] for status in told}
        for status in told:
            typer.echo(json.dumps(status) if json_output else _mission_line(status))
        seen = 0
        async for event in news:
            if (targets == "all" or event["vehicle"] in names) and _of_missions(event):
                typer.echo(json.dumps(event) if json_output else render.event_line(event))
                sys.stdout.flush()
                seen += 1
                if seen >= count:
                    return

    run(command)


@fences.command("upload")
def _fence_upload(
    targets: Targets,
    file: PlanFile,
    force: Annotated[bool, typer.Option("--force", help="Although the fence has errors.")] = False,
    json_output: Json = False,
) -> None:
    """Bring the fence of a plan to vehicles; their missions stay."""
    _bring(targets, file, ["fence"], force, json_output)


@fences.command("download")
def _fence_download(
    vehicle: OneTarget, file: OutFile = None, force: Overwrite = False, json_output: Json = False
) -> None:
    """Read a vehicle's fence back."""
    _fetch(vehicle, file, ["fence"], force, json_output)


@fences.command("clear")
def _fence_clear(
    targets: Targets,
    force: Annotated[bool, typer.Option("--force", help="Although it is in the air.")] = False,
    json_output: Json = False,
) -> None:
    """Remove the vehicles' fences."""
    _clear_lists(targets, ["fence"], force, json_output)


def _clear_lists(targets: str, lists: list[str], force: bool, json_output: bool) -> NoReturn:
    async def cleared() -> int:
        try:
            async with client() as gcs, waiting(f"missions.clear {targets}"):
                answer = await gcs.call("missions.clear", targets=targets, lists=lists, force=force)
        except asyncio.CancelledError:
            from skygcs.cli.mission_interrupted import tell_held
            from skygcs.core.mission.plan import MissionPlan

            return await tell_held(targets, lists, MissionPlan(), "", json_output)
        return tell_outcomes(answer["outcomes"], json_output)

    run_offline(lambda: asyncio.run(cleared()))


def _order(method: str, targets: str, json_output: bool, **params: Any) -> NoReturn:
    async def command(gcs: Client) -> int:
        async with waiting(f"{method} {targets}"):
            answer = await gcs.call(method, targets=targets, **params)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


def _bring(targets: str, file: Path, lists: list[str] | None, force: bool, json_output: bool) -> NoReturn:
    """A file that is no plan is told before a daemon is looked for."""

    async def sent(content: str, plan: MissionPlan) -> int:
        try:
            async with client() as gcs, waiting(f"missions.upload {targets}"):
                answer = await gcs.call(
                    "missions.upload", targets=targets, plan=content, name=file.name, lists=lists, force=force
                )
        except asyncio.CancelledError:
            from skygcs.cli.mission_interrupted import tell_held

            return await tell_held(targets, lists or [kind.word for kind in plan.holds()], plan, file.name, json_output)
        return tell_outcomes(answer["outcomes"], json_output)

    def command() -> int:
        from skygcs.cli.mission_files import load_plan

        imported = load_plan(file)
        for note in imported.notes:
            typer.echo(f"note: {note}", err=True)
        return asyncio.run(sent(file.read_text(encoding="utf-8-sig"), imported.plan))

    run_offline(command)


def _fetch(vehicle: str, file: Path | None, lists: list[str], force: bool, json_output: bool) -> NoReturn:
    async def read() -> dict[str, Any]:
        async with client() as gcs, waiting(f"missions.download {vehicle}"):
            answer: dict[str, Any] = await gcs.call("missions.download", target=vehicle, lists=lists)
        return answer

    def command() -> int:
        if file is not None and file.exists() and not force:
            raise PlanFileError(str(file), "", "exists; --force overwrites it")
        try:
            answer = asyncio.run(read())
        except KeyboardInterrupt:
            unwritten = "" if file is None else f"; {file} is not written"
            typer.echo(f"interrupted: {vehicle} holds what it held{unwritten}", err=True)
            return Exit.INTERRUPTED
        code = _tell_download(vehicle, answer, lists, json_output, quiet=file is not None)
        if file is not None and code == Exit.DONE:
            _write(file, answer["plan"], lists)
        return code

    run_offline(command)


def _tell_download(vehicle: str, answer: dict[str, Any], lists: list[str], json_output: bool, *, quiet: bool) -> int:
    outcome = answer["outcome"]
    if json_output:
        typer.echo(json.dumps(answer, indent=2))
        return Exit.DONE if outcome["ok"] else Exit.FAILED
    code = tell_outcomes({vehicle: outcome}, False)
    for name in () if quiet else lists:
        for item in answer[name]:
            params = " ".join("-" if value is None else f"{value:.10g}" for value in item["params"])
            typer.echo(f"{name} {item['number']:>4}  {item['command']:>5}  frame {item['frame']:>2}  {params}")
    return code


def _write(file: Path, plan: str | None, lists: list[str]) -> None:
    """In the format of its name. Raises PlanFileError for what that cannot hold, OSError."""
    from skygcs.core.mission.formats import read_plan, write_plan
    from skygcs.core.mission.item import MissionType

    if plan is None:
        raise PlanFileError(str(file), "", "the plan holds rally points above sea level, which no .plan can")
    only = MissionType[lists[0].upper()] if len(lists) == 1 else None
    text = write_plan(read_plan(plan.encode(), "the vehicle's plan").plan, str(file), only)
    file.write_text(text, encoding="utf-8")
    typer.echo(f"written to {file}", err=True)


def _mission_line(status: dict[str, Any]) -> str:
    count = status["counts"]["mission"]
    parts = [f"{status['vehicle']:<10}"]
    if count == 0 or status["state"] == NO_MISSION:
        return f"{parts[0]}  no mission" + _transfer(status)
    if status["item"] is None:
        parts.append("no item told yet")
    else:
        parts.append(f"item {status['item']}" + ("" if count is None else f" of {count}"))
    if status["reached"] is not None:
        parts.append(f"reached {status['reached']}")
    if status["state"] is not None:
        parts.append(status["state"])
    return "  ".join(parts) + _transfer(status)


def _transfer(status: dict[str, Any]) -> str:
    """What is being transferred now, and how far it is; empty if nothing is."""
    if status["transfer"] is None:
        return ""
    percent = status["transfer"]["percent"]
    return f"  {status['transfer']['what']}" + ("" if percent is None else f" {percent} %")


def _of_missions(event: dict[str, Any]) -> bool:
    order = str(event["data"].get("order", ""))
    return event["kind"] == "mission" or order.startswith("mission") or order.endswith(TRANSFERS)
