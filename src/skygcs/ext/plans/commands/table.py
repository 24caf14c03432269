"""`skygcs-cli table`: send many vehicles to the initial or final positions of a file and wait until they arrive.

The file is CSV, a row for each vehicle (columns that are not needed may be missing):

    vehicle,initial_x,initial_y,initial_z,initial_heading_deg,final_x,final_y,final_z,final_heading_deg
    alpha,0,0,5,,10,0,5,90

or TOML:

    [vehicles.alpha]
    initial = [0, 0, 5]
    final = [10, 0, 5]
    final_heading_deg = 90

It is a plan with two formations: what is flown is certified first (docs/explanation/plans.md), as one phase of straight
legs. Metres in the fleet's frame (x, y, up, as `goto --enu` takes them), headings clockwise from north (as `goto
--yaw`).
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.connection import Exit, fail, run, run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, within
from skygcs.cli.render import LiveView, print_json, print_lines, say
from skygcs.core.plan.fleet_plan import Phase, PhasedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.errors import DaemonUnreachable, RefusedError, RpcError, SkygcsError, TargetError
from skygcs.ext.plans.certificates.certificate import Approach, Certificate
from skygcs.ext.plans.position_table import LARGEST_FILE, WHICH, Point, Spot, Table, Which, parse_table, spots
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from rich.table import Table as RichTable

# --- the command ------------------------------------------------------------------------------------------------------

DEFAULT_ARRIVE_M = 0.5
"""A vehicle that holds by GPS in light wind stays within it; the UTIAS ground station used 0.25 m."""

DEFAULT_TIMEOUT_S = 120.0


class TableAction(StrEnum):
    """Action on a table."""

    CHECK = "check"
    INITIAL = "initial"
    FINAL = "final"


def table(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="CSV or TOML.", show_default=False)],
    action: Annotated[
        TableAction,
        typer.Argument(
            metavar="check|initial|final", help="Check the file (needs no daemon), or fly there.", show_default=False
        ),
    ],
    targets: Annotated[
        str, typer.Argument(metavar="TARGETS", help="Only these vehicles of the table: names with commas, or all.")
    ] = "all",
    arrive_m: Annotated[
        float, typer.Option("--arrive", metavar="M", help="A vehicle within this distance has arrived.", parser=finite)
    ] = DEFAULT_ARRIVE_M,
    timeout_s: Annotated[
        float, typer.Option("--timeout", metavar="S", help="Wait S seconds for all to arrive.", parser=finite)
    ] = DEFAULT_TIMEOUT_S,
    separation_m: Annotated[
        float | None,
        typer.Option(
            "--separation", metavar="M", help="Margin of each pair, in place of its measured terms.", parser=finite
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Although the paths are not certified.")] = False,
    json_output: Json = False,
) -> None:
    """Send vehicles to the initial or final positions of a file; exit 0 when all are there.

    The flight is certified first: positions and straight paths keep every margin at any timing, also from
    vehicles that take no part. Positions too close are refused, paths too close need --force.

    Example: skygcs-cli table places.csv final --timeout 60
    """
    for option, value, most in (("--arrive", arrive_m, 100), ("--timeout", timeout_s, 86400)):
        if not 0 < value <= most:
            raise typer.BadParameter(f"{option}: {value:g} is not between 0 and {most}")
    within("--separation", separation_m, 0.01, 1000)

    if action is TableAction.CHECK:
        run_offline(lambda: _check(_chosen(file, targets), separation_m, json_output))

    async def command(gcs: Client) -> int:
        which: Which = "initial" if action is TableAction.INITIAL else "final"
        flights = await _prepared(gcs, _chosen(file, targets), which, separation_m, force)
        # they were certified against each other and all others above; with --force against nobody
        together = "all" if force else ",".join(flight.name for flight in flights)
        return await _fly(gcs, flights, together, arrive_m, timeout_s, json_output)

    run(command)


def _chosen(file: Path, targets: str) -> Table:
    """The rows of the target vehicles. Raises SkygcsError."""

    rows = read_table(file)
    names = [part.strip() for part in targets.split(",")]
    if "all" in names:
        return rows
    unknown = [name for name in names if name not in rows]
    if unknown:
        raise TargetError(f"{file} has no {', '.join(unknown)}; it has: {', '.join(rows)}")
    return {name: rows[name] for name in names}


def _check(rows: Table, separation_m: float | None, json_output: bool) -> int:
    """Certify the positions and the way between them, without a daemon."""
    from skygcs.ext.plans.certificates.certify import certify

    rule = MarginRule(fixed_m=separation_m)
    places = {which: {name: s.position_m for name, s in spots(rows, which).items()} for which in WHICH}
    found: dict[str, Certificate] = {
        which: certify(PhasedPlan(points, (Phase(f"standing at the {which} positions", {}),)), rule)
        for which, points in places.items()
        if points
    }
    if places["initial"] and places["final"]:
        goals = {name: place for name, place in places["final"].items() if name in places["initial"]}
        found["paths"] = certify(PhasedPlan(places["initial"], (Phase("initial to final", goals),)), rule)
    good = all(certificate.certified for certificate in found.values())
    closest = found.get("paths", next(iter(found.values()))).closest
    if json_output:
        pairs = {what: [_pair(approach) for approach in c.too_close] for what, c in found.items()}
        empty: dict[str, list[Any]] = {"initial": [], "final": [], "paths": []}
        print_json({"ok": good, "vehicles": list(rows), "too_near": empty | pairs})
        return Exit.DONE if good else Exit.FAILED
    print_lines(line for certificate in found.values() for line in certificate.reasons())
    counts = ", ".join(f"{len(points)} {which} positions" for which, points in places.items())
    say(f"{len(rows)} vehicles: {counts}" + ("; certified" if good else ""))
    if good and closest is not None:
        say(f"closest: {closest.text()}")
    return Exit.DONE if good else Exit.FAILED


async def _prepared(
    gcs: Client, rows: Table, which: Which, separation_m: float | None, force: bool
) -> list[TableFlight]:
    """The flights to the positions of the table, certified. Raises RefusedError."""

    # every vehicle has a position, and is known
    wanted = spots(rows, which)
    missing = [name for name in rows if name not in wanted]
    if missing:
        raise RefusedError(f"{', '.join(missing)}: the table has no {which} position")
    found = located(await gcs.vehicles("all"), wanted)
    flights = [
        TableFlight(found[key][0], spot, math.dist(found[key][1], spot.position_m)) for key, spot in wanted.items()
    ]
    # their straight ways keep the margins at any timing
    margin: dict[str, Any] = {} if separation_m is None else {"margin_m": separation_m}
    goals = {flight.name: list(flight.goal.position_m) for flight in flights}
    answer = await gcs.planning("plan.make", goals=goals, kind="direct", **margin)
    if answer["plan"] is not None:
        return flights
    if answer["attempts"] == ["goals"]:
        raise RefusedError(
            "\n".join([*answer["reasons"], "move the positions apart or into the fence, or give a --separation"])
        )
    if not force:
        raise RefusedError("\n".join([*answer["reasons"], HINT]))
    for reason in answer["reasons"]:
        fail(reason)
    return flights


HINT = (
    "fly them at other heights, one after the other, or in layers (skygcs-cli plan make FILE --fleet -o plan.json, "
    "then plan run); --force insists"
)


async def _fly(
    gcs: Client,
    flights: Sequence[TableFlight],
    together: str,
    arrive_m: float,
    timeout_s: float,
    json_output: bool,
) -> int:
    try:
        await send(gcs, flights, together)
        if not json_output:
            for flight in flights:
                if flight.refused is not None:
                    fail(f"{flight.name} does not fly: {flight.refused}")
        took_s = await watch(gcs, flights, arrive_m, timeout_s, json_output)
    except asyncio.CancelledError:
        fail("stopped watching; the vehicles fly on to their positions (skygcs-cli hold stops them)")
        raise
    away = [flight for flight in flights if flight.arrived_s is None]
    if json_output:
        answer = {"ok": not away, "elapsed_s": round(took_s, 2), "vehicles": {f.name: f.as_dict() for f in flights}}
        print_json(answer)
    elif away:
        where = ", ".join(f"{f.name} ({f.distance_m:.2f} m away)" for f in away)
        fail(f"{len(flights) - len(away)} of {len(flights)} arrived in {took_s:.1f} s; not: {where}")
    else:
        say(f"all {len(flights)} arrived in {took_s:.1f} s")
    return Exit.FAILED if away else Exit.DONE


def _pair(approach: Approach) -> dict[str, Any]:
    return {
        "vehicles": list(approach.vehicles),
        "distance_m": round(approach.distance_m, 3),
        "margin_m": round(approach.margin_m, 3),
        "places_m": [[round(value, 2) for value in place] for place in approach.places_m],
    }


# --- the file ---------------------------------------------------------------------------------------------------------


def read_table(path: Path) -> Table:
    """Raises ConfigError with all problems, SkygcsError if the file cannot be read."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None
    return parse_table(str(path), data)


# --- the flight -------------------------------------------------------------------------------------------------------

WATCH_HZ = 4.0
"""Updates per second and vehicle: one every 1.25 m at 5 m/s; arrival times are accurate to a quarter of a second."""

AT_ONCE = 32
"""Orders sent at the same time; the daemon accepts 64 of one client."""


@dataclass
class TableFlight:
    """The flight of one vehicle to its position. Times count from the orders."""

    name: str
    goal: Spot
    distance_m: float
    refused: str | None = None
    """Why it does not fly; the command does not wait for it."""
    connected: bool = True
    arrived_s: float | None = None
    """When it came within the radius; None again when it leaves it."""

    @property
    def settled(self) -> bool:
        return self.refused is not None or self.arrived_s is not None

    def see(self, position_m: Point, elapsed_s: float, radius_m: float) -> bool:
        """Take in its newest position; True if it has just arrived."""
        self.distance_m = math.dist(position_m, self.goal.position_m)
        if self.distance_m > radius_m:
            self.arrived_s = None
            return False
        arrives = self.arrived_s is None
        if arrives:
            self.arrived_s = elapsed_s
        return arrives

    def as_dict(self) -> dict[str, Any]:
        return {
            "arrived": self.arrived_s is not None,
            "arrived_s": self.arrived_s,
            "distance_m": round(self.distance_m, 3),
            "goal_m": list(self.goal.position_m),
            "refused": self.refused,
            "connected": self.connected,
        }


def located(states: Iterable[Mapping[str, Any]], wanted: Mapping[str, Spot]) -> dict[str, tuple[str, Point]]:
    """The daemon's name and the position of each vehicle in the table.

    Raises RefusedError that names all vehicles that are unknown, not connected or without a position in the fleet's
    frame.
    """
    known = {str(s["name"]): s for s in states}
    by_id = {str(s["sysid"]): s for s in known.values()}
    unknown = [name for name in wanted if name not in known and name not in by_id]
    if unknown:
        there_is = ", ".join(known) or "none yet"
        raise RefusedError(f"the table names {', '.join(unknown)}; the daemon knows: {there_is}")
    chosen = {name: known.get(name) or by_id[name] for name in wanted}
    if len({s["name"] for s in chosen.values()}) < len(chosen):
        raise RefusedError("the table names a vehicle twice, by its name and by its system id")
    lost = [name for name, s in chosen.items() if not s["connected"]]
    if lost:
        raise RefusedError(f"{', '.join(lost)}: not connected")
    nowhere = [name for name, s in chosen.items() if s.get("position") is None]
    if nowhere:
        raise RefusedError(f"{', '.join(nowhere)}: no position yet (skygcs-cli status shows the GPS)")
    frameless = [name for name, s in chosen.items() if s["position"].get("enu_m") is None]
    if frameless:
        raise RefusedError(
            f"{', '.join(frameless)}: no position in the fleet's frame, as it has no origin: skygcs-cli origin set"
        )
    return {name: (str(s["name"]), _point(s["position"]["enu_m"])) for name, s in chosen.items()}


async def send(gcs: Client, flights: Sequence[TableFlight], together: str) -> None:
    """Send a goto to each, all at the same time; a refusal is kept in ``refused``. ``together``: vehicles of which the
    daemon need not check whether they are in the way."""

    free = asyncio.Semaphore(AT_ONCE)

    async def send_one(flight: TableFlight) -> None:
        goal = flight.goal
        async with free:
            try:
                place, heading = goal.position_m, goal.heading_deg
                outcomes = await gcs.goto(flight.name, enu_m=place, yaw_deg=heading, together=together)
            except DaemonUnreachable:
                raise
            except RpcError as error:
                flight.refused = str(error)
                return
        for outcome in outcomes.values():
            if not outcome["ok"]:
                flight.refused = outcome["message"] or outcome["result"]

    await asyncio.gather(*(send_one(flight) for flight in flights))


async def watch(gcs: Client, flights: Sequence[TableFlight], radius_m: float, timeout_s: float, quiet: bool) -> float:
    """Wait until all are within the radius of their goals at the same time, or the time is up; returns the seconds.

    Shows a live table on a terminal, elsewhere a line for each arrival, nothing if ``quiet``.
    """
    live = not quiet and sys.stdout.isatty()
    follow = _follow(gcs, flights, radius_m, live=live, lines=not quiet and not live)
    clock = asyncio.get_running_loop().time
    began = clock()
    try:
        async with asyncio.timeout(timeout_s):
            await follow
    except TimeoutError:
        pass
    return clock() - began


async def _follow(gcs: Client, flights: Sequence[TableFlight], radius_m: float, *, live: bool, lines: bool) -> None:
    by_name = {flight.name: flight for flight in flights if flight.refused is None}
    if not by_name:
        return
    clock = asyncio.get_running_loop().time
    began = clock()
    updates = gcs.telemetry(list(by_name), rate_hz=WATCH_HZ, groups=["position", "connected"])
    view = LiveView(lambda _: flight_table(flights, clock() - began), enabled=live)
    with contextlib.closing(updates), view:
        async for state in updates:
            flight = by_name.get(str(state["name"]))
            if flight is None:
                continue
            elapsed_s = clock() - began
            flight.connected = bool(state["connected"])
            position = (state.get("position") or {}).get("enu_m")
            if position is not None and flight.see(_point(position), elapsed_s, radius_m) and lines:
                say(f"{elapsed_s:7.1f} s  {flight.name} arrived, {flight.distance_m:.2f} m from its position")
                sys.stdout.flush()
            view.refresh()
            if all(f.settled for f in flights):
                return


def flight_table(flights: Sequence[TableFlight], elapsed_s: float) -> RichTable:
    """Goal, distance and time of arrival of every vehicle."""
    rows = []
    for f in flights:
        time_s = elapsed_s if f.arrived_s is None else f.arrived_s
        time = "" if f.refused is not None else f"{time_s:.1f} s"
        rows.append((f.name, place(f.goal.position_m), f"{f.distance_m:.2f} m", time, _word(f)))
    columns = ("vehicle", "goal", "distance", "time", "")
    return render.table(columns, rows, right=("distance", "time"), title=f"{elapsed_s:.1f} s")


def _word(flight: TableFlight) -> tuple[str, str]:
    if flight.refused is not None:
        return f"refused: {flight.refused}", "red"
    if not flight.connected:
        return "lost", "bold red"
    return ("arrived", "green") if flight.arrived_s is not None else ("on its way", "")


def place(point: Point) -> str:
    return ", ".join(f"{x:g}" for x in point)


def _point(values: Sequence[float]) -> Point:
    x, y, z = values
    return float(x), float(y), float(z)


def add_to(app: typer.Typer) -> None:
    app.command()(table)
