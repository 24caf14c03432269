"""A process beside the daemon of an extension: started with it, restarted when it ends, ended with it.

    running     it ends                  -> waiting; an event, the first time of a series
    waiting     FIRST_PAUSE_S, doubling to LONGEST_PAUSE_S -> running
    running     for STEADY_S             the next pause is the first one again
    `close`     SIGTERM, and its standard input ends, as it does when the daemon is killed

The daemon never waits for it: it is looked at twice a second.
"""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from skygcs.events import Event

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
STEADY_S = 30.0
LOOK_S = 0.5


class SupervisedChild:
    """Run `run` in a task; `close` ends the process.

    ``what``: for a person, "the web page"; ``kind``: begins the names of its changes in events.
    ``more``: what its status has besides.
    """

    def __init__(
        self,
        what: str,
        kind: str,
        arguments: list[str],
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        *,
        more: Mapping[str, Any] = MappingProxyType({}),
        command: list[str] | None = None,
    ) -> None:
        self.restarts = 0
        self.what = what
        self.kind = kind
        self.more = more
        self._line = (command or [sys.executable, "-m", "skygcs"]) + arguments
        self._loop = loop
        self._on_event = on_event
        self._process: subprocess.Popen[bytes] | None = None
        self._failing = False
        self._closed = False
        self._start_lock = threading.Lock()
        """Around `_process` and `_closed`: the thread that starts a process goes on when the task is cancelled."""

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
                    text = f"the process of {self.what} has ended ({reason}); it is started again"
                    self._report(text, "ended", reason=reason)
                await asyncio.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                self.restarts += 1
        finally:
            self.close()

    async def _run_once(self) -> str:
        """Start it and wait for its end; how it ended."""
        try:
            process = await asyncio.to_thread(self._start)
        except OSError as error:
            return error.strerror or str(error)
        began = self._loop.time()
        while process.poll() is None:
            await asyncio.sleep(LOOK_S)
            if self._failing and self._loop.time() - began >= STEADY_S:
                self._failing = False
                self._report(f"{self.what} is there again", "back")
        self._release(process)
        code = process.returncode
        return f"exit code {code}" if code >= 0 else signal.Signals(-code).name

    def _start(self) -> subprocess.Popen[bytes]:
        """In a thread. A process that is there only after `close` is ended at once. Raises OSError."""
        process = subprocess.Popen(self._line, stdin=subprocess.PIPE)
        with self._start_lock:
            if self._closed:
                self._end(process)
            else:
                self._process = process
        return process

    def close(self) -> None:
        """End it for good, without waiting. Idempotent."""
        with self._start_lock:
            self._closed = True
            process, self._process = self._process, None
        if process is not None:
            self._end(process)

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        self._release(process)
        process.returncode = process.returncode or 0  # nobody looks at it any more: its parent ends

    def _report(self, text: str, change: str, **data: str) -> None:
        self._on_event(Event("warning", None, None, text, {"change": f"{self.kind}_{change}", **data}))

    def _release(self, process: subprocess.Popen[bytes]) -> None:
        if process.stdin is not None and not process.stdin.closed:
            process.stdin.close()

    def status(self) -> dict[str, Any]:
        """Status for daemon.info."""
        process = self._process
        return {
            **self.more,
            "running": process is not None and process.returncode is None,
            "pid": None if process is None else process.pid,
            "restarts": self.restarts,
        }
