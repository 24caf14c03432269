"""The processes beside the daemon that its fleet file asks for: the web page of [web], the bridge of [federation]."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path

from skygcs.config.federation import FederationConfig
from skygcs.config.station_path import station_socket
from skygcs.config.web import WebConfig
from skygcs.events import Event
from skygcs.runtime.supervised_child import SupervisedChild


def web_child(
    config: WebConfig, socket_path: Path, loop: asyncio.AbstractEventLoop, on_event: Callable[[Event], None]
) -> SupervisedChild:
    """`skygcs web` for this table."""
    line = web_arguments(config, socket_path)
    return SupervisedChild("the web page", "web", line, loop, on_event, more={"page": page_address(config)})


def page_address(config: WebConfig) -> str:
    scheme = "http" if config.tls_cert is None else "https"
    return f"{scheme}://{f'[{config.host}]' if ':' in config.host else config.host}:{config.port}/"


def web_arguments(config: WebConfig, socket_path: Path) -> list[str]:
    """The arguments of `skygcs` for this table."""
    found = ["web", "--supervised", "--socket", os.fspath(socket_path), "--port", str(config.port)]
    found += ["--host", config.host]
    for name in config.names:
        found += ["--name", name]
    for option, path in (("--tls-cert", config.tls_cert), ("--tls-key", config.tls_key)):
        if path is not None:
            found += [option, os.fspath(path)]
    if config.map is not None:
        found += ["--map", os.fspath(config.map.image)]
        for point in config.map.points:
            found += [f"--map-point={','.join(map(repr, point))}"]
    return found


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
