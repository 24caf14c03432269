"""The web page of [web] as a process of its own: started with the daemon, restarted when it ends, ended with it.

    running     it ends                  -> waiting; an event, the first time of a series
    waiting     FIRST_PAUSE_S, doubling to LONGEST_PAUSE_S -> running
    running     for STEADY_S             the next pause is the first one again
    `close`     SIGTERM, and its standard input ends, as it does when the daemon is killed

The daemon never waits for it: it is looked at twice a second.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from skygcs.config.web import WebConfig
from skygcs.events import Event

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
STEADY_S = 30.0
LOOK_S = 0.5


class WebChild:
    """Run `run` in a task; `close` ends the process."""

    def __init__(
        self,
        config: WebConfig,
        socket_path: Path,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        *,
        command: list[str] | None = None,
    ) -> None:
        self.restarts = 0
        self._line = (command or [sys.executable, "-m", "skygcs"]) + arguments(config, socket_path)
        scheme = "http" if config.tls_cert is None else "https"
        self.page = f"{scheme}://{f'[{config.host}]' if ':' in config.host else config.host}:{config.port}/"
        self._loop = loop
        self._on_event = on_event
        self._process: subprocess.Popen[bytes] | None = None
        self._failing = False

    async def run(self) -> None:
        """Keep it running until the task is cancelled."""
        pause_s = FIRST_PAUSE_S
        try:
            while True:
                began = self._loop.time()
                reason = await self._run_once()
                if self._loop.time() - began >= STEADY_S:
                    pause_s = FIRST_PAUSE_S
                if not self._failing:
                    self._failing = True
                    text = f"the web page's process has ended ({reason}); it is started again"
                    self._on_event(Event("warning", None, None, text, {"change": "web_ended", "reason": reason}))
                await asyncio.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                self.restarts += 1
        finally:
            self.close()

    async def _run_once(self) -> str:
        """Start it and wait for its end; how it ended."""
        try:
            process = await asyncio.to_thread(subprocess.Popen, self._line, stdin=subprocess.PIPE)
        except OSError as error:
            return error.strerror or str(error)
        self._process = process
        began = self._loop.time()
        while process.poll() is None:
            await asyncio.sleep(LOOK_S)
            if self._failing and self._loop.time() - began >= STEADY_S:
                self._failing = False
                self._on_event(Event("warning", None, None, "the web page is there again", {"change": "web_back"}))
        self._release(process)
        code = process.returncode
        return f"exit code {code}" if code >= 0 else signal.Signals(-code).name

    def close(self) -> None:
        """End it, without waiting. Idempotent."""
        process, self._process = self._process, None
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGTERM)
        if process is not None:
            self._release(process)
            process.returncode = process.returncode or 0  # nobody looks at it any more: its parent ends

    def _release(self, process: subprocess.Popen[bytes]) -> None:
        if process.stdin is not None and not process.stdin.closed:
            process.stdin.close()

    def status(self) -> dict[str, Any]:
        """For daemon.info."""
        process = self._process
        return {
            "page": self.page,
            "running": process is not None and process.returncode is None,
            "pid": None if process is None else process.pid,
            "restarts": self.restarts,
        }


def arguments(config: WebConfig, socket_path: Path) -> list[str]:
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
