"""A daemon in the test's own process: made from tables of a fleet file, and run while the test goes on."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.daemon import Daemon
from skygcs.links.memory import MemoryLink
from skygcs.links.simulated import SimulatedVehiclesLink
from skygcs.sim.vehicle import SimVehicle


def made_daemon(
    folder: Path,
    extensions: Mapping[str, Any] | None = None,
    prepared: Callable[[FleetConfig], FleetConfig] | None = None,
    **tables: Any,
) -> Daemon:
    """With its socket ``s`` and its logs in this folder, and no recording unless the table ``daemon`` asks for it.
    ``extensions``: their tables as models; ``prepared``: what the daemon runs of the fleet file."""
    own = {"socket": folder / "s", "log_dir": folder / "logs", "record": False, **tables.pop("daemon", {})}
    config = FleetConfig.model_validate({"daemon": own, **tables})
    if extensions is not None:
        config = config.model_copy(update={"extensions": dict(extensions)})
    config = config if prepared is None else prepared(config)
    return Daemon(config, load_dialect(config.dialect))


@contextlib.asynccontextmanager
async def started(daemon: Daemon) -> AsyncIterator[Daemon]:
    """It runs and is ready; at the end it is stopped and has ended."""
    running = asyncio.create_task(daemon.run(), name="the daemon")
    await daemon.ready.wait()
    try:
        yield daemon
    finally:
        daemon.stop()
        await running


def memory_link(daemon: Daemon, name: str) -> MemoryLink:
    link = daemon.links.link(name)
    assert isinstance(link, MemoryLink)
    return link


def simulated_link(daemon: Daemon, name: str) -> SimulatedVehiclesLink:
    link = daemon.links.link(name)
    assert isinstance(link, SimulatedVehiclesLink)
    return link


def listening(sim: SimVehicle, hear: Callable[[Frame, float], None], name: str = "") -> None:
    """Call ``hear`` with every message, or those of this name, that reaches the vehicle, before it takes it."""
    before = sim.on_frame

    def on_frame(frame: Frame, now: float) -> None:
        if not name or frame.name == name:
            hear(frame, now)
        before(frame, now)

    sim.on_frame = on_frame  # type: ignore[method-assign]


def first_heard(vehicles: Iterable[SimVehicle], *commands: int) -> dict[int, float]:
    """When each vehicle first hears one of these commands from now on, by its system id."""
    heard: dict[int, float] = {}
    for sim in vehicles:

        def hear(frame: Frame, now: float, sysid: int = sim.sysid) -> None:
            if frame.fields()["command"] in commands:
                heard.setdefault(sysid, now)

        listening(sim, hear, "COMMAND_LONG")
    return heard
