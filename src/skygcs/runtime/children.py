"""The process beside the daemon that its fleet file asks for: the bridge of [federation]."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path

from skygcs.config.federation import FederationConfig
from skygcs.config.station_path import station_socket
from skygcs.events import Event
from skygcs.runtime.supervised_child import SupervisedChild


def federation_child(
    config: FederationConfig,
    fleet_file: str,
    socket_path: Path,
    loop: asyncio.AbstractEventLoop,
    on_event: Callable[[Event], None],
) -> SupervisedChild:
    """`skygcs federation run` for this fleet file. It reads the file itself, and ends if that cannot be read."""
    line = ["federation", "run", "--supervised", "--socket", os.fspath(socket_path), fleet_file]
    more = {"site": config.site, "role": config.role, "socket": station_socket(str(socket_path))}
    return SupervisedChild("the bridge to other stations", "federation", line, loop, on_event, more=more)
