"""`skygcs-cli federation logs`: collects the recordings of several sites through the hub's object store."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import re
import socket
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skygcs.cli.connection import Exit, client, run_offline
from skygcs.cli.render import plural, say
from skygcs.cli.topics import extension_commands
from skygcs.errors import SkygcsError

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.ext.federation.bridge.logs import Collected

CONNECT_WITHIN_S = 10.0

_AGO = re.compile(r"(\d+(?:\.\d+)?)(min|h|d)")
_SECONDS = {"min": 60.0, "h": 3600.0, "d": 86400.0}


def logs(
    places: Annotated[
        list[str],
        typer.Argument(metavar="[SITE]... DIR", help="Sites (default: all), and the folder to collect into."),
    ],
    since: Annotated[
        str | None,
        typer.Option("--since", metavar="WHEN", help="Written since: 90min, 2h, 3d, or a date as 2026-11-20T09:00."),
    ] = None,
    fleet: Annotated[
        Path | None,
        typer.Option("--fleet", metavar="FILE", help="Fleet file with [federation]. [default: the daemon's]"),
    ] = None,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Also write the tables of each recording, as `tlog csv --parquet`.")
    ] = False,
) -> None:
    """Collect the tlogs of sites into DIR/SITE/. Run again, it resumes; each file is checked.

    Exit 0: all that the sites have is here.

    Example: skygcs-cli federation logs north south --since 2h flights/today
    """

    def command() -> int:
        since_unix_s = parse_since(since, time.time())
        done = asyncio.run(_collect(places[:-1], Path(places[-1]), since_unix_s, fleet))
        for problem in done.problems:
            say(f"error: {problem}", err=True)
        if parquet:
            _write_tables(done.files)
        say(f"{plural(len(done.files), 'log')} complete, {done.fetched_bytes / 1e6:.1f} MB collected now")
        return Exit.FAILED if done.problems else Exit.DONE

    run_offline(command)


def parse_since(text: str | None, now_unix_s: float) -> float:
    """Unix seconds of --since. Raises BadParameter."""
    if text is None:
        return 0.0
    ago = _AGO.fullmatch(text)
    if ago is not None:
        return max(now_unix_s - float(ago[1]) * _SECONDS[ago[2]], 0.0)
    try:
        return max(datetime.fromisoformat(text).timestamp(), 0.0)
    except ValueError:
        raise typer.BadParameter(f"--since {text}: write 90min, 2h, 3d, or a date as 2026-11-20T09:00") from None


async def _collect(sites: Sequence[str], folder: Path, since_unix_s: float, file: Path | None) -> Collected:
    """Raises SkygcsError if the hub cannot be reached."""
    from skygcs.config.loader import load_fleet
    from skygcs.ext.federation.program import need_nats

    if file is None or not sites:
        known, fleet_file = await _ask_station()
        sites = sites or known
        file = file or (None if fleet_file is None else Path(fleet_file))
    if file is None:
        raise SkygcsError("which fleet file has this station's [federation]? give --fleet FILE")
    if not sites:
        raise SkygcsError("no site was heard; give their names")
    need_nats()
    return await _collect_over(load_fleet(file), sites, folder, since_unix_s)


async def _ask_station() -> tuple[list[str], str | None]:
    """The sites that this station knows, its own one among them, and its fleet file."""
    async with client(station=True) as gcs:
        answer = await gcs.call("federation.sites")
        info = await gcs.call("daemon.info")
    own = [] if answer["site"] is None else [answer["site"]]
    return own + [site["site"] for site in answer["sites"] if not site["silent"]], info.get("fleet_file")


async def _collect_over(fleet: FleetConfig, sites: Sequence[str], folder: Path, since_unix_s: float) -> Collected:
    """A connection to the hub of its own, by the station's key."""
    from skygcs.ext.federation.bridge.bus import Bus
    from skygcs.ext.federation.bridge.logs import LogCollector
    from skygcs.ext.federation.bridge.process import bus_options
    from skygcs.ext.federation.config import FederationConfig

    table = fleet.extensions.get("federation")
    if not isinstance(table, FederationConfig):
        raise SkygcsError("the fleet file has no table [federation]")
    name = f"logs at {socket.gethostname()}"
    bus = Bus(bus_options(table, name), asyncio.get_running_loop(), lambda _: None)
    connected = asyncio.Event()
    bus.on_change(lambda: connected.set() if bus.connected else None)
    running = asyncio.create_task(bus.run(), name="hub")
    try:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CONNECT_WITHIN_S):
                await connected.wait()
        if not bus.connected:
            raise SkygcsError(bus.text)
        return await LogCollector(bus, folder, print).collect(sites, since_unix_s)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def _write_tables(files: Sequence[Path]) -> None:
    """Parquet beside each recording. Raises SkygcsError if pyarrow is missing."""

    tools = extension_commands().get("tlog")
    if tools is None:
        raise SkygcsError("the log tools are not installed, which write Parquet files")
    for line in importlib.import_module(tools[1]).parquet_beside(files):
        say(line)
