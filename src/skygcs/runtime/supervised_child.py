"""A process beside the daemon of an extension: started with it, restarted when it ends, ended with it.

    running     it ends                  -> waiting; an event, the first time of a series
    waiting     FIRST_PAUSE_S, doubling to LONGEST_PAUSE_S -> running
    running     for STEADY_S             the next pause is the first one again
    `run` ends  SIGTERM, and its standard input ends, as it does when the daemon is killed; `run` again starts a new one
    `close`     the same, for good
    `ended`     it has ended, or gets SIGKILL END_S later

While the daemon runs, it does not wait for the process: it looks at it twice a second. At its own end it does: what a
process does last, in a folder that the daemon's starter removes, is done then.
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

import structlog

from skygcs.back_off import BackOff
from skygcs.events import Event

_log = structlog.get_logger("skygcs")

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 60.0
STEADY_S = 30.0
LOOK_S = 0.5
END_S = 5.0
"""From SIGTERM to SIGKILL. The web page ends within 0.3 s; ROS waits for its clients before it ends, up to
`ext.ros.process.FAREWELL_S`."""


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
        self._wanted: object | None = None
        """The `run` in progress."""
        self._starting: asyncio.Task[subprocess.Popen[bytes]] | None = None
        self._ending: list[subprocess.Popen[bytes]] = []
        """Those that got SIGTERM."""
        self._start_lock = threading.Lock()
        """Around `_process` and `_wanted`: the thread that starts a process goes on when the task is cancelled."""

    async def run(self) -> None:
        """Keep it running until the task is cancelled. After a fault it may be called again."""
        await self.ended()
        wanted = self._wanted = object()
        back_off = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S, STEADY_S)
        try:
            while True:
                began = self._loop.time()
                reason = await self._run_once(wanted)
                pause_s = back_off.after(self._loop.time() - began)
                if not self._failing:
                    self._failing = True
                    text = f"the process of {self.what} has ended ({reason}); it is started again"
                    self._report(text, "ended", reason=reason)
                await asyncio.sleep(pause_s)
                self.restarts += 1
        finally:
            self._stop()

    async def _run_once(self, wanted: object) -> str:
        """Start it and wait for its end; how it ended."""
        try:
            self._starting = asyncio.create_task(asyncio.to_thread(self._start, wanted), name=f"start of {self.what}")
            process = await asyncio.shield(self._starting)
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

    def _start(self, wanted: object) -> subprocess.Popen[bytes]:
        """Start the process, in a thread. A process that is there only after its `run` or after `close` is ended at
        once. Raises OSError."""
        # in a session of its own: Ctrl-C ends the daemon, and a hang-up has it read its file, but neither ends this
        process = subprocess.Popen(self._line, stdin=subprocess.PIPE, start_new_session=True)
        with self._start_lock:
            if self._closed or self._wanted is not wanted:
                self._end(process)
            else:
                self._process = process
        return process

    def close(self) -> None:
        """End it for good, without waiting. Idempotent."""
        self._closed = True
        self._stop()

    def _stop(self) -> None:
        with self._start_lock:
            self._wanted = None
            process, self._process = self._process, None
        if process is not None:
            self._end(process)

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            self._ending.append(process)
        self._release(process)

    async def ended(self) -> None:
        """Wait until what got SIGTERM has ended, at most END_S; then kill it."""
        if self._starting is not None:
            await asyncio.wait({self._starting})  # its fault is that of `run`
        while self._ending:
            process = self._ending[0]
            await asyncio.to_thread(self._wait, process)
            if process in self._ending:  # `run` and the daemon's end may both wait
                self._ending.remove(process)

    def _wait(self, process: subprocess.Popen[bytes]) -> None:
        """Wait for the process, in a thread."""
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            _log.warning(f"the process of {self.what} did not end when asked, and was killed", pid=process.pid)
            process.kill()
            process.wait()

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
