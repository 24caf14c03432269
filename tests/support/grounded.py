"""A whole daemon in virtual time, and simulated vehicles of both firmwares on the ground behind a link with faults."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.daemon import Daemon
from skygcs.sim.vehicle_group import make_vehicles
from support.daemons import made_daemon
from support.flown import FIELD, Flown, alive


@contextlib.asynccontextmanager
async def on_the_ground(
    tmp_path: Path, *, extensions: Mapping[str, Any] | None = None, **link: float
) -> AsyncIterator[Flown]:
    """A PX4 and an ArduCopter, ready to arm; ``link``: the faults of the memory link, both ways; ``extensions``: their
    tables."""
    links = {"air": {"type": "memory", "role": "radio", **{"seed": 7, **link}}}
    async with grounded(made_daemon(tmp_path, extensions or {}, links=links), settle_s=15.0) as gcs:
        yield gcs


@contextlib.asynccontextmanager
async def grounded(daemon: Daemon, *, settle_s: float) -> AsyncIterator[Flown]:
    """The same with a daemon that is made already, whose memory link is "air"."""
    sims = make_vehicles(
        load_dialect("ardupilotmega"),
        px4=1,
        ardupilot=1,
        first_sysid=1,
        home=FIELD,
        now=daemon.now(),
        unix_us=1_700_000_000_000_000,
    )
    async with alive(daemon, sims) as gcs:
        await asyncio.sleep(settle_s)
        yield gcs
