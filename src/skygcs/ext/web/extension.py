"""The web page in the daemon: `skygcs web` with the arguments of [web], from the daemon's start to its end."""

from __future__ import annotations

import asyncio
import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs.config.web import WebConfig
from skygcs.process_extension import ProcessExtension
from skygcs.runtime.supervised_child import SupervisedChild

if TYPE_CHECKING:
    from skygcs.rpc.context import Services


class Web(ProcessExtension[WebConfig]):
    """Keeps `skygcs web` running."""

    Config = WebConfig

    def __init__(self, core: Services, config: WebConfig) -> None:
        super().__init__(core, config)
        line, loop = web_arguments(config, core.socket_path), asyncio.get_running_loop()
        more = {"page": page_address(config)}
        self.child = SupervisedChild("the web page", "web", line, loop, core.event_log.publish, more=more)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        missing = find_spec("aiohttp") is None
        return ["aiohttp is not installed here: pip install 'skygcs[web]'"] if missing else []

    def announcement(self) -> str:
        return f"{self.child.more['page']} (skygcs web link prints an address)"


def page_address(config: WebConfig) -> str:
    """The page's address on this computer."""
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
    if config.tiles is not None:
        found += ["--tiles", os.fspath(config.tiles)]
    if config.map is not None:
        found += ["--map", os.fspath(config.map.image)]
        for point in config.map.points:
            found += [f"--map-point={','.join(map(repr, point))}"]
    return found
