"""`skygcs-cli up`: from switched on to ready, each stage shown. `skygcs-cli down`: the services stopped again."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs import __version__
from skygcs.cli.connection import Exit, client, fail, print_outcomes, run_offline
from skygcs.cli.options import Json, with_groups
from skygcs.cli.render import Cell, LiveView, duration, print_json, print_lines, say, screen_width, table, wrapped
from skygcs.core.vehicle.targets import select
from skygcs.errors import DaemonUnreachable
from skygcs.ext.companions.bring_up import service_control
from skygcs.ext.companions.bring_up.content import own_content
from skygcs.ext.companions.bring_up.ground_view import GroundView
from skygcs.ext.companions.bring_up.inventory import Companion, Inventory, load_vehicles
from skygcs.ext.companions.bring_up.readiness import STAGES, BringUp, Candidate, link_text
from skygcs.ext.companions.bring_up.side_by_side import Progress, side_by_side
from skygcs.ext.companions.bring_up.ssh_session import Session, connected
from skygcs.ext.companions.commands import SERVICE_TIMEOUT_S, TICK_S, AllCompanions, Connector, Ssh, connector, watched

if TYPE_CHECKING:
    from rich.console import RenderableType

UP_TIMEOUT_S = 300.0
WAIT_S = 60.0
"""An autopilot starts in 10 s, its GPS has a fix half a minute later."""


@with_groups
def up(
    ssh: Ssh,
    targets: AllCompanions = "all",
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0, max=3600, help="For links, vehicle and preflight, each.")
    ] = WAIT_S,
    json_output: Json = False,
) -> None:
    """Bring vehicles from switched on to ready: companions, services, links, vehicles heard, preflight.

    Starts the services that do not run; arms and moves nothing. Exit 0 only if all are ready. Vehicles without a
    companion need no SSH, and no extra package.

    Example: skygcs-cli up all --wait 60
    """

    def command() -> int:
        inventory = load_vehicles(ssh.fleet)
        chosen = [choice.candidate for choice in select(targets, candidates(inventory))]
        on_board = any(candidate.companion is not None for candidate in chosen)
        connect = connector(ssh, inventory) if on_board else None
        return asyncio.run(_up(chosen, connect, ssh, wait_s, json_output))

    run_offline(command)


@dataclass(frozen=True, slots=True)
class Choice:
    """A candidate as target expressions select it."""

    candidate: Candidate
    name: str
    sysid: int
    groups: tuple[str, ...]
    compid: int = 1


def candidates(inventory: Inventory) -> list[Choice]:
    """Every vehicle of the fleet file, also those without a companion."""
    on_board = {companion.vehicle: companion for companion in inventory.companions}
    choices = []
    for vehicle in inventory.config.vehicle_configs():
        companion = on_board.get(vehicle.name)
        name = vehicle.name if companion is None else companion.name
        groups = vehicle.groups if companion is None else companion.groups
        choices.append(Choice(Candidate(name, vehicle.name, vehicle.sysid, companion), name, vehicle.sysid, groups))
    return choices


@contextlib.asynccontextmanager
async def _ground() -> AsyncIterator[tuple[GroundView, str]]:
    """The view of the ground's daemon, or the reason why it cannot be had."""
    async with contextlib.AsyncExitStack() as stack:
        try:
            gcs = await stack.enter_async_context(client())
        except DaemonUnreachable as error:
            yield GroundView(None, str(error)), str(error)
            return
        view = GroundView(gcs)
        await stack.enter_async_context(view.watching())
        yield view, ""


async def _up(
    chosen: Sequence[Candidate], connect: Connector | None, ssh: Ssh, wait_s: float, json_output: bool
) -> int:
    """Bring them up. ``connect``: None if none of them has a companion."""
    # how progress is shown
    loop = asyncio.get_running_loop()
    began = loop.time()
    plain = not json_output and not sys.stdout.isatty()
    rows = {candidate.name: Progress(candidate.name) for candidate in chosen}
    width = max(map(len, rows))

    def on_stage(progress: Progress, stage: str) -> None:
        entry = progress.data["stages"][stage]
        if plain and entry["ok"] is not None:
            word = "ok  " if entry["ok"] else "FAIL"
            say(f"{loop.time() - began:6.1f} s  {word} {progress.name:<{width}}  {stage:<9}  {entry['text']}")

    def open_session(companion: Companion) -> contextlib.AbstractAsyncContextManager[Session]:
        assert connect is not None
        return connected(companion, connect.host_keys, connect.identity)

    # bring up all companions side by side
    async with _ground() as (ground, no_daemon):
        bring_up = BringUp(
            open_session, ground, version=__version__, content=own_content(), wait_s=wait_s, on_stage=on_stage
        )
        with _shown(rows, loop.time, live=not json_output) as changed:
            limit_s = UP_TIMEOUT_S if ssh.timeout_s is None else ssh.timeout_s
            done = await side_by_side(
                chosen, bring_up.run, at_once=max(ssh.at_once, len(chosen)), timeout_s=limit_s, on_change=changed
            )
        closed = [link_text(link) for link in await ground.closed_links()]
    # report
    problems = [*([no_daemon] if no_daemon else []), *(f"on the ground, {text}" for text in closed)]
    report = {
        "ok": not problems and all(progress.ok for progress in done.values()),
        "elapsed_s": round(loop.time() - began, 3),
        "ground": problems,
        "vehicles": {name: progress.outcome() for name, progress in done.items()},
    }
    if json_output:
        print_json(report)
    else:
        print_lines(report_lines(report, screen_width(sys.stdout)))
    return Exit.UNREACHABLE if no_daemon else Exit.DONE if report["ok"] else Exit.FAILED


@contextlib.contextmanager
def _shown(rows: dict[str, Progress], now: Callable[[], float], *, live: bool) -> Iterator[Callable[[Progress], None]]:
    """A table of vehicles and stages, redrawn on a terminal while the body runs; gives what takes in the progress."""

    def draw(_columns: int) -> RenderableType:
        return table(["", *STAGES, "time"], [_row(row, now()) for row in rows.values()], right=["time"])

    def changed(progress: Progress) -> None:
        rows[progress.name] = progress

    with LiveView(draw, enabled=live and sys.stdout.isatty()) as view:

        async def tick() -> None:
            while True:
                await asyncio.sleep(TICK_S)
                view.refresh()

        ticker = asyncio.create_task(tick(), name="up view")
        try:
            yield changed
        finally:
            ticker.cancel()


def _row(progress: Progress, now: float) -> list[Cell]:
    stages = progress.data.get("stages", {})
    return [progress.name, *(_cell(stages.get(stage)) for stage in STAGES), duration(progress.elapsed_s(now))]


def _cell(entry: Mapping[str, Any] | None) -> Cell:
    if entry is None:
        return "", "default"
    if entry["ok"] is None:
        return "…", "yellow"
    return ("ok", "green") if entry["ok"] else ("FAIL", "red")


def report_lines(report: Mapping[str, Any], columns: int | None = None) -> Iterator[str]:
    """One line for each vehicle: ready or what is missing, and the time it took; then the ground, then the sum."""
    vehicles = report["vehicles"]
    width = max(map(len, vehicles), default=0)
    for name, outcome in vehicles.items():
        word = "ok  " if outcome["ok"] else "FAIL"
        line = f"{word} {name:<{width}}  {outcome['elapsed_s']:5.1f} s  {outcome['message']}"
        yield wrapped(line, columns, indent=width + 15)
    for problem in report["ground"]:
        yield wrapped(f"FAIL {problem}", columns, indent=5)
    ready = sum(outcome["ok"] for outcome in vehicles.values())
    yield f"{ready} of {len(vehicles)} ready in {duration(report['elapsed_s'])}"


# --- down -------------------------------------------------------------------------------------------------------------


@with_groups
def down(
    ssh: Ssh,
    targets: AllCompanions = "all",
    force: Annotated[bool, typer.Option("--force", help="Although a vehicle is armed or in the air.")] = False,
    json_output: Json = False,
) -> None:
    """Stop the services of the companions; nothing is stopped while one of the vehicles is armed or in the air.

    Example: skygcs-cli down all
    """

    def command() -> int:
        connect = connector(ssh)
        return asyncio.run(_down(connect.inventory.chosen(targets), connect, ssh, force, json_output))

    run_offline(command)


async def _down(chosen: Sequence[Companion], connect: Connector, ssh: Ssh, force: bool, json_output: bool) -> int:
    if not force:
        active = await _active(chosen, connect, ssh)
        if active:
            fail(f"{', '.join(active)}: armed or in the air; nothing was stopped (--force insists)")
            return Exit.FAILED

    async def stop(companion: Companion, progress: Progress) -> str:
        async with connect.open(companion, progress) as (session, facts):
            progress.step = "stopping"
            return await service_control.stop(session, facts, force=force)

    done = await watched(chosen, stop, ssh, SERVICE_TIMEOUT_S, live=not json_output)
    return print_outcomes({name: progress.outcome() for name, progress in done.items()}, json_output)


async def _active(chosen: Sequence[Companion], connect: Connector, ssh: Ssh) -> list[str]:
    """The vehicles of these companions that are armed or in the air, as the ground or a companion knows."""
    async with _ground() as (ground, _):
        known = set(await ground.active())
    found = [companion.vehicle for companion in chosen if companion.vehicle in known]

    async def look(companion: Companion, progress: Progress) -> str:
        async with connect.open(companion, progress) as (session, facts):
            progress.data["active"] = await service_control.active_vehicles(session, facts)
        return ""

    done = await side_by_side(chosen, look, at_once=ssh.at_once, timeout_s=ssh.timeout_s or SERVICE_TIMEOUT_S)
    there = [name for progress in done.values() for name in progress.data.get("active", ())]
    return sorted({*found, *there})


def add_to(app: typer.Typer) -> None:
    app.command()(up)
    app.command()(down)
