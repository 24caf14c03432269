"""`skygcs-cli mission`: check and convert plan files, transfer plans to and from vehicles, fly missions.

`upload`, `download` and `clear` also serve `skygcs-cli fence`. The dialect, which `check` and `convert` need, is
imported in functions.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path, PurePath
from typing import Annotated, Any, NoReturn

import typer

from skygcs.cli.connection import (
    Exit,
    client,
    exit_code,
    give_order,
    print_outcomes,
    run,
    run_offline,
    run_order,
    run_show,
    waiting,
)
from skygcs.cli.mission_arrangement import Arrange, Heading, Spacing, Step, arrangement_of
from skygcs.cli.options import Json, OneVehicle, OptionalTargets, OrderJson, Targets
from skygcs.cli.order_output import JsonForm
from skygcs.cli.parsing import finite, parse_number
from skygcs.cli.render import event_line, plural, print_json, say
from skygcs.config.files import read_named, write_named
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mission.firmware_items import Family, ItemChange, for_firmware, grouped, same_start
from skygcs.core.mission.formats import Imported, read_plan, write_plan
from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.mission.plan import CheckLimits, Finding, MissionPlan, check_plan, errors
from skygcs.errors import PlanFileError, SkygcsError
from skygcs.rpc.client import Client

missions = typer.Typer(
    help="Missions, fences and rally points: plan files of QGroundControl and Mission Planner.", no_args_is_help=True
)

TRANSFERS = ("upload", "download", "clear")
NO_MISSION = "no mission"
"""The state for MISSION_STATE_NO_MISSION."""

TRANSFER_END_S = 3.0
"""The daemon notices at once that its client is gone; a busy daemon may need a moment."""

POLL_S = 0.1


class AutopilotName(StrEnum):
    PX4 = "px4"
    ARDUPILOT = "ardupilot"


class ListName(StrEnum):
    """MAV_MISSION_TYPE in words."""

    MISSION = "mission"
    FENCE = "fence"
    RALLY = "rally"


PlanFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="A .plan, .waypoints, .txt or .mission file.", show_default=False)
]
Lists = Annotated[
    list[ListName] | None, typer.Option("--only", help="Only this list (may be repeated).", show_default=False)
]
OutFile = Annotated[
    Path | None,
    typer.Argument(metavar="FILE", help="Default: printed. A .plan, or one list as WPL.", show_default=False),
]
InTheWay = Annotated[bool, typer.Option("--force", help="Although another vehicle is in the way.")]
Overwrite = Annotated[bool, typer.Option("--force", help="Overwrite FILE.")]


# --- plan files, without a daemon -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _CheckRequest:
    """Request to check a plan file."""

    limits: CheckLimits
    family: Family | None
    vehicle: tuple[float, float] | None
    dialect: str | None


@missions.command("check")
def _check(
    file: PlanFile,
    autopilot: Annotated[
        AutopilotName | None,
        typer.Option("--autopilot", help="Firmware of the vehicle. [default: either]", show_default=False),
    ] = None,
    max_height_m: Annotated[
        float, typer.Option("--max-height", metavar="M", parser=finite, help="Above home.")
    ] = 500.0,
    max_distance_m: Annotated[
        float, typer.Option("--max-distance", metavar="M", parser=finite, help="From the vehicle, else from home.")
    ] = 1000.0,
    max_items: Annotated[
        int | None, typer.Option("--max-items", min=1, metavar="N", help="Number of items the vehicle can hold.")
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", metavar="LAT,LON", help="Position of the vehicle.")
    ] = None,
    dialect: Annotated[
        str | None,
        typer.Option(
            "--dialect", metavar="NAME", help="The dialect that defines the commands. [default: the daemon's]"
        ),
    ] = None,
    json_output: Json = False,
) -> None:
    """Show what a plan file holds, and everything that is wrong with it, by item.

    Example: skygcs-cli mission check survey.plan --autopilot px4
    """
    place = None if vehicle is None else _place("--vehicle", vehicle)
    limits = CheckLimits(max_height_m, max_distance_m, max_items)
    request = _CheckRequest(limits, _family(autopilot), place, dialect)
    run_offline(lambda: _check_file(file, request, json_output))


@missions.command("convert")
def _convert(
    file: PlanFile,
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Ends in .plan, or in .waypoints, .txt or .mission (QGC WPL 110).")
    ],
    only: Annotated[
        ListName | None, typer.Option("--only", help="One of the lists; WPL holds one only.", show_default=False)
    ] = None,
    autopilot: Annotated[
        AutopilotName | None,
        typer.Option("--autopilot", help="Change items for this firmware, as an upload does.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.")] = False,
) -> None:
    """Write a plan in the other format. Surveys and scans become their single items.

    Example: skygcs-cli mission convert survey.plan survey.waypoints
    """
    kind = None if only is None else MissionType[only.upper()]
    run_offline(lambda: _convert_file(file, out, kind, _family(autopilot), force=force))


def _family(autopilot: AutopilotName | None) -> Family | None:
    families: dict[AutopilotName | None, Family] = {AutopilotName.PX4: "px4", AutopilotName.ARDUPILOT: "ardupilot"}
    return families.get(autopilot)


def _place(option: str, text: str) -> tuple[float, float]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise typer.BadParameter(f"{option}: {text!r} is not LAT,LON")
    lat, lon = (parse_number(part, option) for part in parts)
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise typer.BadParameter(f"{option}: {text!r} is not a place on earth")
    return lat, lon


def load_plan(file: Path) -> tuple[Imported, str]:
    """The plan, and the text that it was read from: a pipe can be read but once. Raises PlanFileError, also if the file
    cannot be read."""
    try:
        content = read_named(file)
    except OSError as error:
        raise PlanFileError(str(file), "", f"cannot be read: {error.strerror}") from None
    return read_plan(content, str(file)), content.decode("utf-8-sig")


def _check_file(file: Path, request: _CheckRequest, json_output: bool) -> int:
    """Print the report; FAILED if it has an error.

    Raises DialectError. Raises PlanFileError unless the report is JSON, where it becomes the one finding.
    """
    from skygcs.config.dialects import load_dialect
    from skygcs.config.models import FleetConfig

    try:
        imported, _ = load_plan(file)
    except PlanFileError as error:
        if not json_output:
            raise
        print_json(_unreadable(file, error))
        return Exit.FAILED
    dialect = load_dialect(request.dialect or FleetConfig().dialect)
    findings = check_plan(imported.plan, dialect, request.limits, family=request.family, vehicle=request.vehicle)
    changes = for_firmware(imported.plan.mission, request.family, dialect.enums.get("MAV_CMD", {})).changes
    if json_output:
        print_json(_report(file, imported, findings, changes, dialect))
    else:
        say(_text(file, imported, findings, changes))
    return Exit.FAILED if errors(findings) else Exit.DONE


def _convert_file(file: Path, out: Path, only: MissionType | None, family: Family | None, *, force: bool) -> int:
    """Write the plan to ``out``, changed for ``family``. Raises PlanFileError, DialectError, OSError."""
    imported, _ = load_plan(file)
    changes: tuple[ItemChange, ...] = ()
    if family is not None:
        from skygcs.config.dialects import load_dialect
        from skygcs.config.models import FleetConfig

        dialect = load_dialect(FleetConfig().dialect)
        converted = for_firmware(imported.plan.mission, family, dialect.enums.get("MAV_CMD", {}))
        imported, changes = replace(imported, plan=replace(imported.plan, mission=converted.items)), converted.changes
    text = write_plan(imported.plan, str(out), only)
    try:
        write_named(out, text, force=force)
    except FileExistsError:
        raise PlanFileError(str(out), "", "exists; --force overwrites it") from None
    for note in imported.notes:
        say(f"note: {note}", err=True)
    for line in grouped(changes):
        say(f"changed: mission {line}", err=True)
    say(f"{out}: {_counts(read_plan(text.encode(), str(out)))}")
    return Exit.DONE


def _report(
    file: Path, imported: Imported, findings: tuple[Finding, ...], changes: tuple[ItemChange, ...], dialect: Dialect
) -> dict[str, Any]:
    plan = imported.plan
    home = plan.home
    return {
        "file": os.fspath(file),
        "ok": not errors(findings),
        "format": imported.format,
        "home": None
        if home is None
        else {"lat_deg": home.lat_deg, "lon_deg": home.lon_deg, "alt_amsl_m": home.alt_amsl_m},
        **{kind.word: [_item(n, i, dialect) for n, i in enumerate(plan.items(kind), 1)] for kind in MissionType},
        "notes": list(imported.notes),
        "changes": [{"item": change.item, "text": change.text} for change in changes],
        "findings": [
            {"severity": "error" if f.error else "warning", "list": f.kind.word, "item": f.item, "text": f.text}
            for f in findings
        ],
    }


def _unreadable(file: Path, error: PlanFileError) -> dict[str, Any]:
    """`_report` of a file that is not a plan."""
    return {
        "file": os.fspath(file),
        "ok": False,
        "format": None,
        "home": None,
        **{kind.word: [] for kind in MissionType},
        "notes": [],
        "changes": [],
        "findings": [{"severity": "error", "list": None, "item": None, "text": str(error)}],
    }


def _item(number: int, item: MissionItem, dialect: Dialect) -> dict[str, Any]:
    return {
        "number": number,
        "command": item.command,
        "name": dialect.enums.get("MAV_CMD", {}).get(item.command),
        "frame": item.frame,
        "params": list(item.seven),
        "autocontinue": item.autocontinue,
    }


def _text(file: Path, imported: Imported, findings: tuple[Finding, ...], changes: tuple[ItemChange, ...]) -> str:
    lines = [f"{file}: {_counts(imported)}"]
    lines += [f"  note     {note}" for note in imported.notes]
    lines += [f"  changed  mission {line}" for line in grouped(changes)]
    lines += [f"  {'ERROR  ' if finding.error else 'warning'}  {finding}" for finding in findings]
    wrong = len(errors(findings))
    mild = len(findings) - wrong
    lines.append(f"{plural(wrong, 'error')}, {plural(mild, 'warning')}" if findings else "no problem found")
    return "\n".join(lines)


def _counts(imported: Imported) -> str:
    plan = imported.plan
    parts = [plural(len(plan.mission), "mission item")]
    if plan.fence:
        shapes = [plural(len(plan.fence.polygons), "polygon"), plural(len(plan.fence.circles), "circle")]
        parts.append(f"a fence of {' and '.join(shape for shape in shapes if not shape.startswith('0'))}")
    if plan.rally:
        parts.append(plural(len(plan.rally), "rally point"))
    if plan.home is not None:
        parts.append(f"home at {plan.home.lat_deg:.7g}, {plan.home.lon_deg:.7g}")
    return ", ".join(parts)


# --- vehicles ---------------------------------------------------------------------------------------------------------


@missions.command("upload")
def _upload(
    targets: Targets,
    file: PlanFile,
    only: Lists = None,
    arrange: Arrange = None,
    step_m: Step = None,
    spacing_m: Spacing = None,
    heading_deg: Heading = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Although the plan has errors, the vehicle flies a mission, or missions come too near each other.",
        ),
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Check a plan against each vehicle and upload what it holds: mission, fence, rally points.

    Example: skygcs-cli mission upload alpha survey.plan
    """
    arrangement = arrangement_of(arrange, step_m=step_m, spacing_m=spacing_m, heading_deg=heading_deg)
    lists = None if only is None else [name.value for name in only]
    upload(targets, file, lists, force, json_output, arrangement)


@missions.command("download")
def _download(
    vehicle: OneVehicle, file: OutFile = None, only: Lists = None, force: Overwrite = False, json_output: Json = False
) -> None:
    """Read a vehicle's mission, fence and rally points.

    Example: skygcs-cli mission download alpha alpha.plan
    """
    download(vehicle, file, [name.value for name in only or ListName], force, json_output)


@missions.command("clear")
def _clear(
    targets: Targets,
    only: Lists = None,
    force: Annotated[bool, typer.Option("--force", help="Although it flies a mission.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Delete the vehicles' missions; with --only fences and rally points.

    Example: skygcs-cli mission clear alpha
    """
    lists = ["mission"] if only is None else [name.value for name in only]
    clear(targets, lists, force, json_output)


@missions.command("start")
def _start(
    targets: Targets,
    first: Annotated[int, typer.Option("--first", metavar="ITEM", min=1, help="Begin with this item.")] = 1,
    arm: Annotated[bool, typer.Option("--arm/--no-arm", help="Arm if it is not armed.")] = True,
    one_after_another: Annotated[
        bool, typer.Option("--one-after-another", help="The next one starts when the one before is done or has landed.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Without a required preflight, and although another vehicle is in the way.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Fly the mission that is in the vehicle.

    Example: skygcs-cli mission start alpha
    """
    given = {"first": first, "arm": arm, "one_after_another": one_after_another, "force": force}
    run_order("missions.start", json_output, targets=targets, **given)


@missions.command("end-turns")
def _end_turns(json_output: Json = False) -> None:
    """End `mission start --one-after-another`: the vehicle that flies goes on, those that wait do not start.

    Example: skygcs-cli mission end-turns
    """

    def lines(answer: dict[str, Any]) -> Iterator[str]:
        yield "ended: nobody else starts" if answer["ended"] else "no missions are flown one after another"

    run_show("missions.end_turns", json_output, lines)


@missions.command("pause")
def _pause(targets: Targets, json_output: OrderJson = None) -> None:
    """Stop and hold position.

    Example: skygcs-cli mission pause alpha
    """
    run_order("missions.pause", json_output, targets=targets)


@missions.command("resume")
def _resume(targets: Targets, force: InTheWay = False, json_output: OrderJson = None) -> None:
    """Continue with the current item.

    Example: skygcs-cli mission resume alpha
    """
    run_order("missions.resume", json_output, targets=targets, force=force)


@missions.command("current")
def _current(
    targets: Targets,
    item: Annotated[int, typer.Argument(metavar="ITEM", min=1, help="Counted from 1.", show_default=False)],
    force: InTheWay = False,
    json_output: OrderJson = None,
) -> None:
    """Make an item the current one.

    Example: skygcs-cli mission current alpha 4
    """
    run_order("missions.set_current", json_output, targets=targets, item=item, force=force)


@missions.command("status")
def _status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show where vehicles are in their missions.

    Example: skygcs-cli mission status all
    """

    def lines(statuses: list[dict[str, Any]]) -> Iterator[str]:
        return (_mission_line(status) for status in statuses)

    run_show("missions.status", json_output, lines, targets=targets)


@missions.command("watch")
def _watch(
    targets: OptionalTargets = "all",
    count: Annotated[
        int, typer.Option("--count", metavar="N", help="End after N events.", min=1, show_default=False)
    ] = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Follow missions and transfers: the status, then every item reached, until Ctrl-C.

    Example: skygcs-cli mission watch alpha
    """

    def show(item: dict[str, Any], line: str) -> None:
        if json_output:
            print_json(item, line=True)
        else:
            say(line)
            sys.stdout.flush()

    async def command(gcs: Client) -> None:
        news = gcs.events(kinds=["mission", "command"])  # subscribe first: no event is missed between the two
        statuses = await gcs.call("missions.status", targets=targets)
        names = {status["vehicle"] for status in statuses}
        for status in statuses:
            show(status, _mission_line(status))
        seen = 0
        async for event in news:
            if (targets == "all" or event["vehicle"] in names) and _of_missions(event):
                show(event, event_line(event))
                seen += 1
                if seen >= count:
                    return

    run(command)


def _mission_line(status: dict[str, Any]) -> str:
    count, turn = status["counts"]["mission"], status["turn"]
    parts = [f"{status['vehicle']:<10}"]
    if turn is not None and turn["state"] == "waits":
        return f"{parts[0]}  waits for its turn, {turn['turn']} of {turn['of']}" + _transfer(status)
    if count == 0 or status["state"] == NO_MISSION:
        return f"{parts[0]}  no mission" + _transfer(status)
    if status["item"] is None:
        parts.append("no current item reported yet")
    else:
        parts.append(f"item {status['item']}" + ("" if count is None else f" of {count}"))
    if status["reached"] is not None:
        parts.append(f"reached {status['reached']}")
    if status["state"] is not None:
        parts.append(status["state"])
    return "  ".join(parts) + _transfer(status)


def _transfer(status: dict[str, Any]) -> str:
    """The transfer in progress and how far it is; empty if no transfer runs."""
    if status["transfer"] is None:
        return ""
    percent = status["transfer"]["percent"]
    return f"  {status['transfer']['what']}" + ("" if percent is None else f" {percent} %")


def _of_missions(event: dict[str, Any]) -> bool:
    order = str(event["data"].get("order", ""))
    return event["kind"] == "mission" or order.startswith("mission") or order.endswith(TRANSFERS)


# --- transfers --------------------------------------------------------------------------------------------------------


def upload(
    targets: str,
    file: Path,
    lists: list[str] | None,
    force: bool,
    json_output: JsonForm,
    arrangement: dict[str, Any] | None = None,
) -> NoReturn:
    """Upload lists of a plan (None: all it holds). The plan file is read before the daemon is called."""

    async def sent(content: str, plan: MissionPlan) -> int:
        try:
            async with client() as gcs:
                given = {"plan": content, "name": file.name, "lists": lists, "force": force, "arrangement": arrangement}
                outcomes = await give_order(gcs, "missions.upload", json_output, targets=targets, **given)
        except asyncio.CancelledError:
            kinds = lists or [kind.word for kind in plan.holds()]
            return await report_held(targets, kinds, plan, file.name, json_output)
        return exit_code(outcomes)

    def command() -> int:
        imported, text = load_plan(file)
        for note in imported.notes:
            say(f"note: {note}", err=True)
        return asyncio.run(sent(text, imported.plan))

    run_offline(command)


def clear(targets: str, lists: list[str], force: bool, json_output: JsonForm) -> NoReturn:
    """Delete lists in vehicles."""

    async def cleared() -> int:
        try:
            async with client() as gcs:
                outcomes = await give_order(
                    gcs, "missions.clear", json_output, targets=targets, lists=lists, force=force
                )
        except asyncio.CancelledError:
            return await report_held(targets, lists, MissionPlan(), "", json_output)
        return exit_code(outcomes)

    run_offline(lambda: asyncio.run(cleared()))


def download(vehicle: str, file: Path | None, lists: list[str], force: bool, json_output: bool) -> NoReturn:
    """Read lists from a vehicle; print them, or write them to ``file``."""

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
            say(f"interrupted: nothing changed in {vehicle}{unwritten}", err=True)
            return Exit.INTERRUPTED
        code = _show_download(vehicle, answer, lists, json_output, quiet=file is not None)
        if file is not None and code == Exit.DONE:
            _write(file, answer["plan"], lists)
        return code

    run_offline(command)


def _show_download(vehicle: str, answer: dict[str, Any], lists: list[str], json_output: bool, *, quiet: bool) -> int:
    outcomes = {vehicle: answer["outcome"]}
    if json_output:
        print_json(answer)
        return exit_code(outcomes)
    code = print_outcomes(outcomes, False)
    for name in () if quiet else lists:
        for item in answer[name]:
            params = " ".join("-" if value is None else f"{value:.10g}" for value in item["params"])
            say(f"{name} {item['number']:>4}  {item['command']:>5}  frame {item['frame']:>2}  {params}")
    return code


def _write(file: Path, plan: str | None, lists: list[str]) -> None:
    """Write in the format of the file's name. Raises PlanFileError if that format cannot hold the plan, OSError."""
    if plan is None:
        raise PlanFileError(str(file), "", "the plan has rally points above sea level, which no .plan file can hold")
    only = MissionType[lists[0].upper()] if len(lists) == 1 else None
    text = write_plan(read_plan(plan.encode(), "the vehicle's plan").plan, str(file), only)
    write_named(file, text)
    say(f"written to {file}", err=True)


# --- after an interrupted transfer ------------------------------------------------------------------------------------


async def report_held(targets: str, lists: Sequence[str], sent: MissionPlan, file: str, json_output: JsonForm) -> int:
    """After Ctrl-C in a transfer: read from the vehicles what they hold now, and compare it with ``sent``.

    The daemon stops a transfer when its client disconnects, and keeps how it ended (`missions.status`, ``last``). An
    ArduPilot refuses to send its list for 8 s after an interrupted upload; the download waits for that. ``file``: the
    name of the plan. To be awaited after a CancelledError; a second Ctrl-C stops it.
    """
    if (task := asyncio.current_task()) is not None:
        task.uncancel()
    say("interrupted; reading what the vehicles hold now (an ArduPilot answers after 8 s; Ctrl-C stops this)", err=True)
    answers: dict[str, Any] = {}
    try:
        async with client() as gcs, waiting(f"reading {targets}"):
            names = [state["name"] for state in await gcs.vehicles(targets)]
            found = await asyncio.gather(*(_held(gcs, name, lists) for name in names))
        answers = dict(zip(names, found, strict=True))
    except (SkygcsError, OSError) as error:
        say(f"it is unknown what they hold: {error}", err=True)
    for name, by_list in answers.items():
        for kind, answer in by_list.items():
            family = answer["autopilot"] if answer["autopilot"] in ("px4", "ardupilot") else None
            answer["message"] = held_line(answer, sent, MissionType[kind.upper()], file, family)
            if not json_output:
                say(f"{name}: {answer['message']}")
    if json_output:
        # the plan itself is left out: it is long
        kept = {
            n: {k: {"message": a["message"], "items": a["items"]} for k, a in b.items()} for n, b in answers.items()
        }
        print_json({"interrupted": True, "held": kept})
    return Exit.INTERRUPTED


async def _held(gcs: Client, name: str, lists: Sequence[str]) -> dict[str, Any]:
    """By list: how the transfer ended, and what was read then (``plan`` None: reading failed)."""
    for _ in range(round(TRANSFER_END_S / POLL_S)):
        (status,) = await gcs.call("missions.status", targets=name)
        if status["transfer"] is None:
            break
        await asyncio.sleep(POLL_S)
    autopilot = (await gcs.vehicle(name))["autopilot"]
    held = {}
    for kind in lists:
        answer = await gcs.call("missions.download", target=name, lists=[kind])
        ok = answer["outcome"]["ok"]
        held[kind] = {
            "autopilot": autopilot,
            "last": status["last"][kind],
            "plan": answer["plan"],
            "items": len(answer[kind]) if ok else None,
            "why": "" if ok else answer["outcome"]["message"],
        }
    return held


def held_line(answer: dict[str, Any], sent: MissionPlan, kind: MissionType, file: str, family: Family | None) -> str:
    """Return what a vehicle holds of one list, compared with the list that was sent."""
    count, last = answer["items"], answer["last"]
    if count is None:
        ended = "" if last is None else f"{last['message']}; "
        return f"{ended}reading what it holds failed: {answer['why']}"
    word = f"{kind.word} item" + ("" if count == 1 else "s")
    if count == 0:
        return f"holds no {kind.word}"
    if answer["plan"] is None:
        return f"holds {count} {word}"
    new = for_firmware(sent.mission, family, {}).items if kind is MissionType.MISSION else sent.items(kind)
    same = same_start(new, read_plan(answer["plan"].encode(), "the vehicle's plan").plan.items(kind), family)
    name = PurePath(file).name
    if same == count == len(new):
        return f"holds the whole {kind.word} of {name} ({count} {word})"
    unchanged = last is not None and last["state"] == "unchanged"
    if unchanged or same == 0:
        return f"holds {count} {word}, not those of {name}" + (
            ": as before" if unchanged else "; check it before you fly"
        )
    rest = f"the other {count - same} are not" if count > same else f"{len(new) - same} are missing"
    todo = "do not fly it: upload it again, or clear it"
    start = "the first is" if same == 1 else f"the first {same} are"
    return f"holds {count} {word}: {start} of {name}, {rest}; {todo}"


def add_to(app: typer.Typer) -> None:
    app.add_typer(missions, name="mission")
