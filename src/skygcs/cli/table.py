"""`skygcs-cli table`: sends many vehicles to the initial or final positions of a file, and says when they are there."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run, run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from skygcs.cli.table_file import Near, Table, Which
    from skygcs.cli.table_flight import Flight

DEFAULT_ARRIVE_M = 0.5
"""A vehicle that holds by GPS in some wind moves within it; the UTIAS ground station had 0.25 m."""

DEFAULT_SEPARATION_M = 2.0
"""About four F450 airframes (0.45 m) with the error of two GPS receivers between them."""

DEFAULT_TIMEOUT_S = 120.0


class Action(StrEnum):
    """What is to be done with a table."""

    CHECK = "check"
    INITIAL = "initial"
    FINAL = "final"


def table(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV or TOML.", show_default=False)],
    action: Annotated[
        Action,
        typer.Argument(
            metavar="check|initial|final", help="Look at it (needs no daemon), or fly there.", show_default=False
        ),
    ],
    targets: Annotated[
        str, typer.Argument(metavar="[TARGETS]", help="Only these of the table: names with commas, or all.")
    ] = "all",
    arrive_m: Annotated[
        float, typer.Option("--arrive", metavar="M", help="Who is this near has arrived.", parser=finite)
    ] = DEFAULT_ARRIVE_M,
    timeout_s: Annotated[
        float, typer.Option("--timeout", metavar="S", help="Wait so long for all to arrive.", parser=finite)
    ] = DEFAULT_TIMEOUT_S,
    separation_m: Annotated[
        float, typer.Option("--separation", metavar="M", help="Least distance between two.", parser=finite)
    ] = DEFAULT_SEPARATION_M,
    force: Annotated[bool, typer.Option("--force", help="Although paths cross.")] = False,
    json_output: Json = False,
) -> None:
    """Send vehicles to the initial or final positions of a file; exit 0 when all are there.

    Places closer than --separation are refused, paths that cross closer than that need --force: straight ones, flown at
    the same speed. Nobody is kept apart on the way: the autopilots fly straight.
    """
    for option, value, most in (("--arrive", arrive_m, 100), ("--timeout", timeout_s, 86400)):
        if not 0 < value <= most:
            raise typer.BadParameter(f"{option}: {value:g} is not between 0 and {most}")
    if not 0 <= separation_m <= 1000:
        raise typer.BadParameter(f"--separation: {separation_m:g} is not between 0 and 1000")

    if action is Action.CHECK:
        run_offline(lambda: _check(_chosen(file, targets), separation_m, json_output))

    async def command(gcs: Client) -> int:
        which: Which = "initial" if action is Action.INITIAL else "final"
        flights = await _prepared(gcs, _chosen(file, targets), which, separation_m, force)
        return await _fly(gcs, flights, arrive_m, timeout_s, json_output)

    run(command)


def _chosen(file: Path, targets: str) -> Table:
    """The rows that are wanted. Raises SkygcsError."""
    from skygcs.cli.table_file import read_table
    from skygcs.errors import TargetError

    rows = read_table(file)
    names = [part.strip() for part in targets.split(",")]
    if "all" in names:
        return rows
    unknown = [name for name in names if name not in rows]
    if unknown:
        raise TargetError(f"{file} has no {', '.join(unknown)}; it has: {', '.join(rows)}")
    return {name: rows[name] for name in names}


def _check(rows: Table, separation_m: float, json_output: bool) -> int:
    from skygcs.cli.table_file import crossings, spots, too_near

    places = {which: {name: s.position_m for name, s in spots(rows, which).items()} for which in ("initial", "final")}
    near = {which: too_near(points, separation_m) for which, points in places.items()}
    crossing = crossings(places["initial"], places["final"], separation_m)
    good = not (crossing or any(near.values()))
    if json_output:
        found = {which: [_pair(n) for n in pairs] for which, pairs in (*near.items(), ("paths", crossing))}
        typer.echo(json.dumps({"ok": good, "vehicles": list(rows), "too_near": found}, indent=2))
        return Exit.DONE if good else Exit.FAILED
    for line in _near_lines(near, separation_m) + _crossing_lines(crossing, separation_m):
        typer.echo(line)
    counts = ", ".join(f"{len(points)} {which} positions" for which, points in places.items())
    typer.echo(f"{len(rows)} vehicles: {counts}" + (f"; all at least {separation_m:g} m apart" if good else ""))
    return Exit.DONE if good else Exit.FAILED


async def _prepared(gcs: Client, rows: Table, which: Which, separation_m: float, force: bool) -> list[Flight]:
    """Checked against the table and the fleet. Raises RefusedError."""
    from skygcs.cli.table_file import crossings, spots, too_near
    from skygcs.cli.table_flight import Flight, located, others
    from skygcs.errors import RefusedError

    wanted = spots(rows, which)
    missing = [name for name in rows if name not in wanted]
    if missing:
        raise RefusedError(f"{', '.join(missing)}: the table has no {which} position")
    near = too_near({name: spot.position_m for name, spot in wanted.items()}, separation_m)
    if near:
        raise RefusedError("\n".join(_near_lines({which: near}, separation_m)))
    states = await gcs.vehicles("all")
    found = located(states, wanted)
    starts = {name: position for name, position in found.values()}
    goals = {found[key][0]: spot.position_m for key, spot in wanted.items()}
    crossing = crossings({**starts, **others(states, starts)}, goals, separation_m)
    lines = _crossing_lines(crossing, separation_m)
    if lines and not force:
        raise RefusedError(
            "\n".join([*lines, "fly them one after the other, at other heights, or insist with --force"])
        )
    for line in lines:
        fail(line)
    return [Flight(found[key][0], spot, math.dist(found[key][1], spot.position_m)) for key, spot in wanted.items()]


async def _fly(gcs: Client, flights: Sequence[Flight], arrive_m: float, timeout_s: float, json_output: bool) -> int:
    from skygcs.cli.table_flight import send, watch

    try:
        await send(gcs, flights)
        if not json_output:
            for flight in flights:
                if flight.refused is not None:
                    fail(f"{flight.name} does not go: {flight.refused}")
        took_s = await watch(gcs, flights, arrive_m, timeout_s, json_output)
    except asyncio.CancelledError:
        fail("no longer watching; they fly on to their places (skygcs-cli hold stops them)")
        raise
    away = [flight for flight in flights if flight.arrived_s is None]
    if json_output:
        answer = {"ok": not away, "elapsed_s": round(took_s, 2), "vehicles": {f.name: f.as_dict() for f in flights}}
        typer.echo(json.dumps(answer, indent=2))
    elif away:
        where = ", ".join(f"{f.name} ({f.distance_m:.2f} m away)" for f in away)
        fail(f"{len(flights) - len(away)} of {len(flights)} arrived in {took_s:.1f} s; not: {where}")
    else:
        typer.echo(f"all {len(flights)} arrived in {took_s:.1f} s")
    return Exit.FAILED if away else Exit.DONE


def _near_lines(near: Mapping[str, Sequence[Near]], separation_m: float) -> list[str]:
    return [
        f"{which} positions of {n.one} and {n.other} are {n.distance_m:.2f} m apart (least: {separation_m:g} m)"
        for which, pairs in near.items()
        for n in pairs
    ]


def _crossing_lines(crossing: Sequence[Near], separation_m: float) -> list[str]:
    return [
        f"{n.one} and {n.other} come within {n.distance_m:.2f} m of each other after {n.at:.1f} m of their ways "
        f"(least: {separation_m:g} m)"
        for n in crossing
    ]


def _pair(near: Near) -> dict[str, Any]:
    return {"vehicles": [near.one, near.other], "distance_m": round(near.distance_m, 3), "after_m": round(near.at, 2)}


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Orders")(table)
