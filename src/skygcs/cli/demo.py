"""`skygcs demo`: the daemon and three simulated vehicles, which a script flies through the JSON-RPC socket.

Two PX4 and one ArduCopter behind one simulated radio; a live table, a tlog, a summary. With `--stay` it keeps running.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import tempfile
import webbrowser
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from skygcs.cancellation import ended
from skygcs.cli.process import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK, serve_until_signal
from skygcs.cli.render import LiveView, table
from skygcs.cli.status import status_table
from skygcs.cli.web import can_open_browser, unused_port, wait_for_link
from skygcs.config.dialects import load_dialect
from skygcs.config.extension_tables import find_owners
from skygcs.config.models import (
    DaemonConfig,
    FleetConfig,
    OriginConfig,
    SimulatedLinkConfig,
    UdpClientLinkConfig,
    VehicleEntry,
)
from skygcs.config.tables import Model
from skygcs.config.web import WebConfig
from skygcs.daemon import Daemon
from skygcs.ending_signals import ending_signals
from skygcs.errors import SkygcsError
from skygcs.rpc.address import default_socket_path
from skygcs.rpc.client import Client, connect
from skygcs.web.built_page import is_built

HOME = OriginConfig(lat_deg=43.7806, lon_deg=-79.4653, alt_amsl_m=180.0)
"""UTIAS, Toronto, where the lab flew."""

QGC_PORT = 14550
"""Default port of QGroundControl; with --stay it shows the three vehicles without any set-up."""

DISCOVERY_S = 20.0
ARMING_S = 30.0
"""A simulated ArduCopter refuses to arm until its estimator has converged, as a real one does."""

ARRIVAL_M = 1.0
LEG_S = 40.0
TARGETS_ENU_M = {"alpha": (-12.0, 0.0, 6.0), "bravo": (5.0, 12.0, 8.0), "charlie": (22.0, 0.0, 10.0)}
"""Target of each vehicle. They stand in a row to the east, 5 m apart, and fly away from each other."""
RETURN_MODES = ("AUTO.RTL", "RTL")
REFRESH_S = 0.25


@dataclass
class DemoFlight:
    """The flight of one vehicle, for the summary."""

    max_height_m: float = 0.0
    """Before the return, which climbs to the autopilot's return height first."""
    return_height_m: float | None = None
    flown_m: float = 0.0
    modes: list[str] = field(default_factory=list)
    last_enu_m: tuple[float, float, float] | None = None

    def on_state(self, state: dict[str, Any]) -> None:
        mode = state.get("mode")
        if mode and (not self.modes or self.modes[-1] != mode):
            self.modes.append(mode)
        position = state.get("position") or {}
        height = position.get("alt_rel_m")
        if height is not None and mode in RETURN_MODES:
            self.return_height_m = max(self.return_height_m or 0.0, height)
        elif height is not None and self.return_height_m is None:
            self.max_height_m = max(self.max_height_m, height)
        enu = position.get("enu_m")
        if enu is not None:
            here = (enu[0], enu[1], enu[2])
            if self.last_enu_m is not None and state.get("armed"):
                self.flown_m += math.dist(here, self.last_enu_m)
            self.last_enu_m = here


class Demo:
    """The script: the orders of the flight, and the states of the vehicles during it."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.states: dict[str, dict[str, Any]] = {}
        self.flights: dict[str, DemoFlight] = {}
        self.step = "starting"
        self.log: list[str] = []
        self.failed = False

    async def fly(self, gcs: Client) -> None:
        """Send every order of the demo. Sets ``failed`` if any vehicle did not carry one out."""
        watching = asyncio.create_task(self._watch(gcs), name="demo telemetry")
        try:
            self._say("waiting for three vehicles")
            await self._until(lambda: len(self.states) >= len(TARGETS_ENU_M), DISCOVERY_S)
            self._say("arming all (ArduCopter needs its estimator first)")
            await self._order(gcs, "vehicles.arm", targets="all", wait_s=ARMING_S)
            for name, (_, _, height_m) in TARGETS_ENU_M.items():
                self._say(f"{name} takes off to {height_m:g} m")
                await self._order(gcs, "vehicles.takeoff", targets=name, height_m=height_m)
            await self._until(self._all_up, LEG_S)
            for name, enu_m in TARGETS_ENU_M.items():
                self._say(f"{name} goes to {enu_m[0]:+g} m east, {enu_m[1]:+g} m north, {enu_m[2]:g} m up")
                await self._order(gcs, "vehicles.goto", targets=name, enu_m=list(enu_m))
            await self._until(self._all_arrived, LEG_S)
            self._say("hold")
            await self._order(gcs, "vehicles.hold", targets="all")
            self._say("charlie lands at its position, the others return")
            await self._order(gcs, "vehicles.land", targets="charlie")
            await self._order(gcs, "vehicles.rtl", targets="alpha,bravo")
            await self._until(lambda: not any(s.get("armed") for s in self.states.values()), 2 * LEG_S)
            self._say("all landed and disarmed")
            # after a landing an ArduCopter stays in LAND, where it does not arm: GUIDED prepares it for further orders
            await self._order(gcs, "vehicles.mode", targets="charlie", mode="GUIDED")
        finally:
            await ended(watching)

    async def _watch(self, gcs: Client) -> None:
        async for state in gcs.telemetry("all", rate_hz=1 / REFRESH_S):
            self.states[state["name"]] = state
            self.flights.setdefault(state["name"], DemoFlight()).on_state(state)

    async def _order(self, gcs: Client, method: str, **params: Any) -> None:
        answer = await gcs.call(method, **params)
        for name, outcome in answer["outcomes"].items():
            if not outcome["ok"]:
                self.failed = True
                self.log.append(f"{name}: {method.split('.')[1]} {outcome['message']}")

    async def _until(self, condition: Any, limit_s: float) -> None:
        """Wait until the condition holds; after the limit set ``failed`` and log it."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + limit_s
        while not condition():
            if loop.time() > deadline:
                self.failed = True
                self.log.append(f"gave up after {limit_s:g} s: {self.step}")
                return
            await asyncio.sleep(REFRESH_S)

    def _height(self, name: str) -> float:
        position = self.states.get(name, {}).get("position") or {}
        return float(position.get("alt_rel_m") or 0.0)

    def _all_up(self) -> bool:
        return all(self._height(name) > target[2] - ARRIVAL_M for name, target in TARGETS_ENU_M.items())

    def _all_arrived(self) -> bool:
        for name, target in TARGETS_ENU_M.items():
            enu = (self.states.get(name, {}).get("position") or {}).get("enu_m")
            if enu is None or math.dist(enu, target) > ARRIVAL_M:
                return False
        return True

    def _say(self, step: str) -> None:
        self.step = step
        self.log.append(step)
        if not self.console.is_terminal:
            self.console.print(step)

    def view(self, columns: int) -> Table:
        """The live table, for a terminal with so many columns."""
        grid = Table.grid()
        grid.add_row(f"[bold]skygcs demo[/bold]  {self.step}")
        grid.add_row(status_table(list(self.states.values()), width=columns))
        return grid


def demo_config(socket: Path, log_dir: Path, *, for_qgc: bool, web_port: int | None = None) -> FleetConfig:
    """Three simulated vehicles behind one radio, the port where QGroundControl listens, and the web page."""
    links: dict[str, Any] = {
        "radio": SimulatedLinkConfig(
            name="radio",
            role="radio",
            px4=2,
            ardupilot=1,
            lat_deg=HOME.lat_deg,
            lon_deg=HOME.lon_deg,
            alt_amsl_m=HOME.alt_amsl_m,
        )
    }
    if for_qgc:
        links["qgc"] = UdpClientLinkConfig(name="qgc", role="gcs", host="127.0.0.1", port=QGC_PORT)
    return FleetConfig(
        daemon=DaemonConfig(socket=socket, log_dir=log_dir),
        extensions=_tables() | ({} if web_port is None else {"web": WebConfig(port=web_port)}),
        origin=HOME,
        links=links,
        vehicles={
            "alpha": VehicleEntry(sysid=1, autopilot="px4"),
            "bravo": VehicleEntry(sysid=2, autopilot="px4"),
            "charlie": VehicleEntry(sysid=3, autopilot="ardupilot"),
        },
    )


def _tables() -> dict[str, Model]:
    """The tables [drills] and [recordings]: the page of the demo offers faults for its vehicles, and replays."""
    owners, _ = find_owners({"drills", "recordings"})
    return {name: owner.Config() for name, owner in owners.items()}


@contextlib.asynccontextmanager
async def _running(daemon: Daemon) -> AsyncIterator[None]:
    serving = asyncio.create_task(serve_until_signal(daemon, endings=ending_signals()), name="daemon")
    ready = asyncio.create_task(daemon.ready.wait(), name="daemon ready")
    await asyncio.wait({serving, ready}, return_when=asyncio.FIRST_COMPLETED)
    ready.cancel()
    try:
        if not serving.done():
            yield
    finally:
        daemon.stop()
        await serving


async def demo(*, stay: bool, socket: Path | None, log_dir: Path) -> int:
    """Run the demo; 0 if every vehicle carried out its orders."""
    console = Console()
    dialect = load_dialect(FleetConfig().dialect)
    with tempfile.TemporaryDirectory(prefix="skygcs-demo-") as scratch:
        # without --stay it must not use the socket of a daemon that flies; with --stay skygcs-cli must find it
        path = socket or (default_socket_path() if stay else Path(scratch) / "skygcs.sock")
        missing = _missing_page()
        web_port = unused_port() if missing is None else None
        config = demo_config(path, log_dir, for_qgc=stay, web_port=web_port)
        daemon = Daemon(config, dialect, source="demo")
        script = Demo(console)
        async with _running(daemon):
            if web_port is None:
                console.print(f"web page: {missing}", highlight=False, markup=False)
            else:
                await _show_web_page(path, web_port, console)
            await _show_flight(script, daemon, console)
            if daemon.stopping:
                console.print("Stopped before the end of the flight.")
                return EXIT_INTERRUPTED
            _summarise(script, daemon, console)
            if stay and not daemon.stopping:
                console.print("\nStill running. Try:  skygcs-cli status   skygcs-cli takeoff all 5   (Ctrl-C ends it)")
                await daemon.stopped()
    return EXIT_FAILED if script.failed else EXIT_OK


def _missing_page() -> str | None:
    """Why there is no web page here, and what to do; None: there is one."""
    if find_spec("aiohttp") is None:
        return "not installed; pip install 'skygcs[web]' adds it"
    return None if is_built() else "not built; make web builds it in a checkout"


async def _show_web_page(socket: Path, port: int, console: Console) -> None:
    """Print the page's address, and open it on a terminal with a display."""
    try:
        address = await asyncio.to_thread(wait_for_link, str(socket), port)
    except SkygcsError:  # its text says how to start one, and one is being started
        text = f"web page: still starting; its address: skygcs web link --socket {socket}"
        console.print(text, soft_wrap=True, highlight=False)
        return
    console.print(f"web page: {address}", soft_wrap=True, highlight=False)
    if can_open_browser():  # with an address of its own: the one that is printed is for another browser
        opened = await asyncio.to_thread(wait_for_link, str(socket), port, own_user=True)
        await asyncio.to_thread(webbrowser.open, opened)


async def _show_flight(script: Demo, daemon: Daemon, console: Console) -> None:
    """Run the flight script and draw the live table; a signal to the daemon ends the script, too."""

    async def fly() -> None:
        async with connect(daemon.socket_path) as gcs:
            await script.fly(gcs)

    flying = asyncio.create_task(fly(), name="demo flight")
    stopped = asyncio.create_task(daemon.stopped(), name="demo stopped")
    try:
        with LiveView(script.view, enabled=console.is_terminal) as view:
            while not flying.done() and not stopped.done():
                await asyncio.wait({flying, stopped}, timeout=REFRESH_S, return_when=asyncio.FIRST_COMPLETED)
                view.refresh(now=True)
        if flying.done():
            await flying
    except SkygcsError as error:
        script.failed = True
        console.print(f"[red]{error}[/red]")
    finally:
        for task in (flying, stopped):
            await ended(task)


def _summarise(script: Demo, daemon: Daemon, console: Console) -> None:
    rows = [
        (
            name,
            str(script.states[name].get("autopilot")),
            f"{flight.max_height_m:.1f} m",
            "-" if flight.return_height_m is None else f"{flight.return_height_m:.1f} m",
            f"{flight.flown_m:.0f} m",
            " > ".join(flight.modes),
        )
        for name, flight in sorted(script.flights.items())
    ]
    columns = ("vehicle", "autopilot", "highest", "on return", "flown", "modes")
    console.print()
    console.print(table(columns, rows, right=columns[2:5], wrap=("modes",)))
    for line in script.log:
        if script.failed:
            console.print(f"  {line}")
    recorded = {} if daemon.recorder is None else daemon.recorder.status()
    if recorded.get("file"):
        console.print(f"tlog: {os.path.relpath(recorded['file'])}  (skygcs-cli tlog info FILE reads it)")
    console.print(
        "[red]A vehicle did not carry out its orders, see above.[/red]"
        if script.failed
        else "[green]All vehicles carried out their orders.[/green]"
    )
