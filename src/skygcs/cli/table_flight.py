"""Sends vehicles to the places of a table and watches them arrive, with a stopwatch."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from skygcs.cli import render
from skygcs.cli.status import SCREEN_HZ
from skygcs.cli.table_file import Point, Spot
from skygcs.errors import DaemonUnreachable, RefusedError, RpcError
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from rich.table import Table as RichTable

WATCH_HZ = 4.0
"""Updates per vehicle and second: at 5 m/s one is seen every 1.25 m, and the stopwatch is good to a quarter second."""

AT_ONCE = 32
"""Orders under way; the daemon takes 64 of one client."""


@dataclass
class Flight:
    """One vehicle on its way. Times are since the orders were given."""

    name: str
    goal: Spot
    distance_m: float
    refused: str | None = None
    """Why it does not go; it is not waited for."""
    connected: bool = True
    arrived_s: float | None = None
    """When it came within the radius; None again if it left it."""

    @property
    def settled(self) -> bool:
        return self.refused is not None or self.arrived_s is not None

    def see(self, position_m: Point, elapsed_s: float, radius_m: float) -> bool:
        """Its newest position; whether it arrived just now."""
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
    """The daemon's name and the position of each vehicle the table names. Raises RefusedError with all that are not
    there, and if there is no common frame."""
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


def others(states: Iterable[Mapping[str, Any]], flying: Iterable[str]) -> dict[str, Point]:
    """Where vehicles that do not take part are, as far as that is known."""
    skipped = set(flying)
    return {
        str(s["name"]): _point(s["position"]["enu_m"])
        for s in states
        if s["name"] not in skipped and (s.get("position") or {}).get("enu_m") is not None
    }


async def send(gcs: Client, flights: Sequence[Flight]) -> None:
    """A goto to each, all at once; who refuses says why."""

    free = asyncio.Semaphore(AT_ONCE)

    async def send_one(flight: Flight) -> None:
        goal = flight.goal
        async with free:
            try:
                outcomes = await gcs.goto(flight.name, enu_m=goal.position_m, yaw_deg=goal.heading_deg)
            except DaemonUnreachable:
                raise
            except RpcError as error:
                flight.refused = str(error)
                return
        for outcome in outcomes.values():
            if not outcome["ok"]:
                flight.refused = outcome["message"] or outcome["result"]

    await asyncio.gather(*(send_one(flight) for flight in flights))


async def watch(gcs: Client, flights: Sequence[Flight], radius_m: float, timeout_s: float, quiet: bool) -> float:
    """Until all are within the radius of their goals at the same time, or the time is up; gives how long it took.

    On a terminal a live table, elsewhere a line for each arrival, and nothing if ``quiet``.
    """
    live = not quiet and sys.stdout.isatty()
    follow = _follow(gcs, flights, radius_m, live=live, tell=not quiet and not live)
    clock = asyncio.get_running_loop().time
    began = clock()
    try:
        async with asyncio.timeout(timeout_s):
            await follow
    except TimeoutError:
        pass
    return clock() - began


async def _follow(gcs: Client, flights: Sequence[Flight], radius_m: float, *, live: bool, tell: bool) -> None:
    by_name = {flight.name: flight for flight in flights if flight.refused is None}
    if not by_name:
        return
    clock = asyncio.get_running_loop().time
    began = clock()
    updates = gcs.telemetry(list(by_name), rate_hz=WATCH_HZ, sections=["position", "connected"])
    screen = _Screen(flights, live)
    try:
        async for state in updates:
            flight = by_name.get(str(state["name"]))
            if flight is None:
                continue
            elapsed_s = clock() - began
            flight.connected = bool(state["connected"])
            position = (state.get("position") or {}).get("enu_m")
            if position is not None and flight.see(_point(position), elapsed_s, radius_m) and tell:
                typer.echo(f"{elapsed_s:7.1f} s  {flight.name} arrived, {flight.distance_m:.2f} m from its place")
                sys.stdout.flush()
            screen.draw(elapsed_s)
            if all(f.settled for f in flights):
                return
    finally:
        updates.close()
        screen.close(clock() - began)


class _Screen:
    """The live table, if there is a terminal."""

    def __init__(self, flights: Sequence[Flight], live: bool) -> None:
        self._flights = flights
        self._live: Any = None
        self._drawn_s = -math.inf
        if live:
            from rich.live import Live

            self._live = Live(console=render.console(), auto_refresh=False, vertical_overflow="crop")
            self._live.start()

    def draw(self, elapsed_s: float) -> None:
        if self._live is not None and elapsed_s - self._drawn_s >= 1 / SCREEN_HZ:
            self._drawn_s = elapsed_s
            self._live.update(flight_table(self._flights, elapsed_s), refresh=True)

    def close(self, elapsed_s: float) -> None:
        if self._live is not None:
            self._live.update(flight_table(self._flights, elapsed_s), refresh=True)
            self._live.stop()


def flight_table(flights: Sequence[Flight], elapsed_s: float) -> RichTable:
    """Who is how far from its place, and who arrived when."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold", title=f"{elapsed_s:.1f} s", title_justify="left")
    for column, right in (("vehicle", False), ("goal", False), ("distance", True), ("time", True), ("", False)):
        table.add_column(column, justify="right" if right else "left", no_wrap=True)
    for f in flights:
        word, style = _word(f)
        time_s = elapsed_s if f.arrived_s is None else f.arrived_s
        time = "" if f.refused is not None else f"{time_s:.1f} s"
        table.add_row(Text(f.name), place(f.goal.position_m), f"{f.distance_m:.2f} m", time, Text(word, style=style))
    return table


def _word(flight: Flight) -> tuple[str, str]:
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
