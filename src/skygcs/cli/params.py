"""`skygcs-cli param`: parameters of vehicles and of files, compared, kept and brought back."""

from __future__ import annotations

import asyncio
import contextlib
import fnmatch
import json
import os
import sys
from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import Exit, run, run_offline
from skygcs.cli.options import Json, Targets
from skygcs.cli.parsing import NUMBERS, NumbersCommand, parse_number
from skygcs.errors import RefusedError
from skygcs.rpc.client import Client

if TYPE_CHECKING:  # every command line registers every command: what only these need is imported when they run
    from skygcs.cli.param_file import Held
    from skygcs.core.params.compare import ApplyPlan, Difference
    from skygcs.core.params.param_file import Entry, ParamFile

params = typer.Typer(
    help="Read, set, save, compare and apply parameters; `diff` of two files needs no daemon.", no_args_is_help=True
)

Refresh = Annotated[
    bool, typer.Option("--refresh", help="Read all from the vehicle, although it vouches for what is known.")
]
Burst = Annotated[
    bool,
    typer.Option("--burst", help="All at once: quicker on USB or Wi-Fi, but it drowns a radio that vehicles share."),
]
Include = Annotated[
    str,
    typer.Option(
        "--include",
        metavar="SORT,…",
        help="Also what is of one vehicle alone: calibration, statistics, identity, or all.",
    ),
]


@params.command("get")
def get(
    targets: Targets,
    names: Annotated[list[str], typer.Argument(metavar="NAME …", help="Names of parameters.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Read parameters from vehicles: `param get all NAV_RCL_ACT`."""

    async def command(gcs: Client) -> int:
        answer = await gcs.call("params.get", targets=targets, names=[n.upper() for n in names])
        return _tell(answer["outcomes"], json_output)

    run(command)


@params.command("set", cls=NumbersCommand, context_settings=dict(NUMBERS))
def set_(
    targets: Targets,
    pairs: Annotated[
        list[str], typer.Argument(metavar="NAME VALUE …", help="One or more, set in this order.", show_default=False)
    ],
    json_output: Json = False,
) -> None:
    """Set parameters and read them back: `param set 1 NAV_RCL_ACT 0 COM_RC_IN_MODE 4`."""
    if len(pairs) % 2:
        raise typer.BadParameter(f"{pairs[-1]} has no value behind it")
    values = {name.upper(): parse_number(text, name) for name, text in zip(pairs[::2], pairs[1::2], strict=True)}

    async def command(gcs: Client) -> int:
        return _tell(await _set(gcs, targets, values), json_output)

    run(command)


@params.command("list")
def list_(
    targets: Targets,
    pattern: Annotated[
        str, typer.Argument(metavar="[PATTERN]", help="Only these: MPC_*, *SYSID*. Quote it for the shell.")
    ] = "*",
    refresh: Refresh = False,
    burst: Burst = False,
    json_output: Json = False,
) -> None:
    """All parameters of vehicles, or those whose names fit a pattern."""

    async def command(gcs: Client) -> int:
        from skygcs.cli import param_lines

        lists = await _lists(gcs, targets, refresh=refresh, burst=burst)
        for entry in lists.values():
            entry["params"] = [p for p in entry["params"] if fnmatch.fnmatchcase(p["name"], pattern.upper())]
        if json_output:
            typer.echo(json.dumps({"lists": lists}, indent=2))
        else:
            for line in param_lines.lists(lists):
                typer.echo(line)
        return Exit.DONE if all(entry["ok"] for entry in lists.values()) else Exit.FAILED

    run(command)


@params.command("save")
def save(
    target: Annotated[str, typer.Argument(metavar="VEHICLE", help="Its name or system id.")],
    file: Annotated[Path, typer.Argument(metavar="FILE", help=".params: QGroundControl's; .param, .parm: others'.")],
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    refresh: Refresh = False,
    burst: Burst = False,
) -> None:
    """Save all parameters of a vehicle to a file."""
    from skygcs.cli.param_file import kind_of, write_file

    kind = kind_of(file)
    if file.exists() and not force:
        raise typer.BadParameter(f"{file} is there already; --force writes over it")

    async def command(gcs: Client) -> int:
        held = await _held(gcs, target, refresh=refresh, burst=burst)
        state = await gcs.vehicle(target)
        write_file(file, held, kind, state)
        typer.echo(f"{len(held.params)} parameters of {held.name} saved to {file}")
        return Exit.DONE

    run(command)


@params.command("apply")
def apply(
    targets: Targets,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A parameter file of any kind.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be set.")] = False,
    include: Include = "",
    force: Annotated[bool, typer.Option("--force", help="Although it seems to be another vehicle's file.")] = False,
    refresh: Refresh = False,
    burst: Burst = False,
    json_output: Json = False,
) -> None:
    """Set what a file has otherwise, and nothing else; every value is read back, and what differs then is listed.

    Calibration, statistics and system ids are left alone unless asked for with --include. Nothing is sent if the file
    has a value that the vehicle cannot hold, or seems to be another vehicle's.
    """
    from skygcs.cli import param_lines
    from skygcs.cli.param_file import held_of, include_of, read_file
    from skygcs.core.params.compare import plan

    sorts = include_of(include)

    def planned(contents: ParamFile, held: Held) -> ApplyPlan:
        return plan(
            contents,
            {p.name: p for p in held.params},
            sysid=held.sysid,
            compid=held.compid,
            stack=held.autopilot,
            include=sorts,
        )

    async def applied(gcs: Client, contents: ParamFile, held: Held, made: ApplyPlan) -> dict[str, Any]:
        """Sets, reads again and reports; what JSON says of it."""

        def tell(lines: Iterable[str]) -> None:
            for line in () if json_output else lines:
                typer.echo(line)

        done: dict[str, Any] = {"outcomes": {}, "differs": []}
        if not made.changes:
            return done
        outcomes = (await _set(gcs, str(held.sysid), {c.name: c.value for c in made.changes}))[held.name]
        done["outcomes"] = outcomes
        tell(param_lines.outcomes({held.name: outcomes}))
        why = "its identity has been changed" if any(c.sort == "identity" for c in made.changes) else ""
        try:
            # what was set has been read once more by the daemon, which hears what else the vehicle changes
            now = held if why else await _held(gcs, str(held.sysid), refresh=False, burst=False)
            left = () if why else planned(contents, now).changes
        except RefusedError as error:
            why, left = str(error), ()
        if why:
            done["differs"] = None
            tell([f"{held.name}: not read again: {why}"])
        else:
            done["differs"] = [asdict(change) for change in left]
            tell(param_lines.after_lines(held.name, left))
        return done

    async def command(gcs: Client) -> int:
        contents = read_file(file)
        exit_code = Exit.DONE
        answers: dict[str, Any] = {}
        for entry in (await _lists(gcs, targets, refresh=refresh, burst=burst, sure=True)).values():
            held = held_of(entry)
            made = planned(contents, held)
            answers[held.name] = param_lines.plan_data(made)
            if not json_output:
                for line in param_lines.plan_lines(held.name, made):
                    typer.echo(line)
            if dry_run:
                continue
            _refuse(held.name, made, force=force)
            done = await applied(gcs, contents, held, made)
            answers[held.name] |= done
            if done["differs"] or not all(o["ok"] for o in done["outcomes"].values()):
                exit_code = Exit.FAILED
        if json_output:
            typer.echo(json.dumps(answers, indent=2))
        return exit_code

    run(command)


@params.command("diff")
def diff_(
    first: Annotated[str, typer.Argument(metavar="A", help="A file, or a vehicle.", show_default=False)],
    second: Annotated[str, typer.Argument(metavar="B", help="A file, or a vehicle.", show_default=False)],
    include: Include = "all",
    refresh: Refresh = False,
    json_output: Json = False,
) -> None:
    """Where two sets of parameters differ; exit 1 if they do. Each is a file or a vehicle.

    Values are compared as the 32-bit floats that vehicles hold, exactly. Only of a file whose writer rounds (MAVProxy,
    Mission Planner) a value stands for all that it would have rounded to it.
    """
    from skygcs.cli import param_lines
    from skygcs.cli.param_file import include_of, read_file
    from skygcs.core.params.compare import diff
    from skygcs.core.params.param_file import Entry

    sorts = include_of(include)
    notes: list[str] = []

    def from_file(name: str) -> tuple[Entry, ...]:
        contents = read_file(Path(name))
        notes.extend(param_lines.rounded(name, contents.rounding))
        return contents.entries

    def tell(left: tuple[Entry, ...], right: tuple[Entry, ...]) -> int:
        found = [d for d in diff(left, right) if d.sort in sorts]
        if json_output:
            typer.echo(json.dumps([_difference(d) for d in found], indent=2))
        else:
            for line in (*param_lines.differences(first, second, found), *notes):
                typer.echo(line)
        return Exit.FAILED if found else Exit.DONE

    if all(_is_file(name) for name in (first, second)):
        run_offline(lambda: tell(from_file(first), from_file(second)))

    async def command(gcs: Client) -> int:
        sides = []
        for name in (first, second):
            if _is_file(name):
                sides.append(from_file(name))
            else:
                held = await _held(gcs, name, refresh=refresh, burst=False)
                sides.append(tuple(Entry(p.name, p.value) for p in held.params))
        return tell(*sides)

    run(command)


@params.command("cancel")
def cancel(targets: Targets) -> None:
    """Stop what is being read or set by anybody."""

    async def command(gcs: Client) -> None:
        for name, count in (await gcs.call("params.cancel", targets=targets)).items():
            typer.echo(f"{name}: {count} request{'s' if count != 1 else ''} stopped")

    run(command)


def _is_file(name: str) -> bool:
    """A file that is there, or one by its looks: a vehicle's name has neither a slash nor one of these endings."""
    return Path(name).is_file() or os.sep in name or name.endswith((".params", ".param", ".parm"))


def _difference(d: Difference) -> dict[str, Any]:
    return {"name": d.name, "other": d.other, "first": d.first, "second": d.second, "kind": d.kind, "sort": d.sort}


def _refuse(name: str, made: ApplyPlan, *, force: bool) -> None:
    """Raises RefusedError if nothing of the file must be sent."""
    if made.problems:
        raise RefusedError(f"{name}: nothing was set: {'; '.join(made.problems[:10])}")
    if made.warnings and not force:
        raise RefusedError(f"{name}: nothing was set: {'; '.join(made.warnings)}; insist with --force")


def _tell(outcomes: Mapping[str, Mapping[str, Mapping[str, Any]]], json_output: bool) -> int:
    from skygcs.cli import param_lines

    if json_output:
        typer.echo(json.dumps({"outcomes": outcomes}, indent=2))
    else:
        for line in param_lines.outcomes(outcomes):
            typer.echo(line)
    return Exit.DONE if all(o["ok"] for of in outcomes.values() for o in of.values()) else Exit.FAILED


async def _set(gcs: Client, targets: str, values: Mapping[str, float]) -> dict[str, dict[str, dict[str, Any]]]:
    async with _progress(gcs, targets):
        answer = await gcs.call("params.set", targets=targets, params=dict(values))
    outcomes: dict[str, dict[str, dict[str, Any]]] = answer["outcomes"]
    return outcomes


async def _lists(
    gcs: Client, targets: str, *, refresh: bool, burst: bool, sure: bool = False
) -> dict[str, dict[str, Any]]:
    """One vehicle after another, by name: together they could be too much for one answer.

    ``sure``: something rests on the values; that their number is what it was will not do.
    """
    lists: dict[str, dict[str, Any]] = {}
    for state in await gcs.vehicles(targets):
        name = state["name"]
        async with _progress(gcs, name):
            answer = await gcs.call("params.list", targets=name, refresh=refresh, burst=burst)
            if sure and answer["lists"][name]["vouched"] == "count":
                answer = await gcs.call("params.list", targets=name, refresh=True, burst=burst)
        lists[name] = answer["lists"][name] | {"name": name}
    if not lists:
        raise RefusedError("no vehicle has been heard yet")
    return lists


async def _held(gcs: Client, target: str, *, refresh: bool, burst: bool) -> Held:
    lists = await _lists(gcs, target, refresh=refresh, burst=burst, sure=True)
    if len(lists) != 1:
        raise RefusedError(f"{target} names {len(lists)} vehicles ({', '.join(lists)}); give one")
    from skygcs.cli.param_file import held_of

    return held_of(next(iter(lists.values())))


@contextlib.asynccontextmanager
async def _progress(gcs: Client, targets: str) -> AsyncIterator[None]:
    """A bar with the time that is left while the body runs; on a terminal only."""
    if not sys.stderr.isatty():
        yield
        return
    drawing = asyncio.create_task(_draw(gcs, targets), name="progress")
    try:
        yield
    finally:
        drawing.cancel()
        await asyncio.wait([drawing])
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


async def _draw(gcs: Client, targets: str) -> None:
    from skygcs.cli import param_lines

    async for event in gcs.events(targets, kinds=["params"]):
        sys.stderr.write(f"\r\033[K{param_lines.bar(event)}")
        sys.stderr.flush()
