"""The capture process of [mocap]: started with the daemon, watched, started again, ended with the daemon.

    connecting  the system answers                          -> connected
    connected   no line for STALLED_S                       -> killed, waiting
    connecting  not connected after CONNECT_S               -> killed, waiting: some libraries never give up, or hang
    any         the process ends, or writes what is no line -> waiting; an event, the first time of a series
    waiting     FIRST_PAUSE_S, doubling to LONGEST_PAUSE_S  -> connecting
    connected   for STEADY_S                                   the next pause is the first one again
    ended       a recording was played to its end              nothing more

The daemon reads its lines without waiting for it; a line has a bound. Of frames that wait only the newest are taken: a
system that sends thousands a second would have the loop for 40 ms at a time, and what it sends would be too old.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

from skygcs.back_off import BackOff
from skygcs.cancellation import carried_through
from skygcs.child_process import start_process
from skygcs.events import Event
from skygcs.ext.mocap.config import MocapConfig
from skygcs.ext.mocap.recording import BODIES, MAX_LINE_BYTES, CaptureFrameData, CaptureState, parse_line

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
STEADY_S = 30.0
STALLED_S = 5.0
"""Every system sends frames all the time, with bodies or without."""

CONNECT_S = 30.0
END_S = 1.0
"""From the end of its output to its own."""

STDERR_BYTES = 4096

READ_BYTES = 1 << 16
"""A pipe of Linux holds so much: frames of two bodies for three seconds at 200 Hz."""

TAKEN_BYTES, LEAST_FRAMES = 1 << 14, 2
"""Bytes of one read that are taken, 10 ms: 140 frames of two bodies, ten of 35. The newest frame may have
come in part, so the one before it is taken, too."""

FLOOD_BYTES, FLOOD_PAUSE_S = READ_BYTES // 2, 0.02
"""After a read of so many bytes the next one is later. After less there is no pause: in this time an ordinary system
(30 bodies at 240 Hz) sends more than is taken of one read, so one that was late would lose frames from then on."""

OnFrame = Callable[[CaptureFrameData, float], None]


class CaptureProcess:
    """Run `run` in a task; `close` ends the process. ``on_frame(frame, now)`` gets every frame."""

    def __init__(
        self,
        config: MocapConfig,
        loop: asyncio.AbstractEventLoop,
        on_frame: OnFrame,
        on_event: Callable[[Event], None],
        *,
        command: list[str] | None = None,
    ) -> None:
        self.state = "waiting"
        self.text = ""
        self.restarts = 0
        self.bad_lines = 0
        self.skipped = 0
        """Lines of frames that were not taken, as newer ones had come."""
        self._command = command or [sys.executable, "-P", "-m", "skygcs.ext.mocap.worker", *arguments(config)]
        self._loop = loop
        self._on_frame = on_frame
        self._on_event = on_event
        self._process: asyncio.subprocess.Process | None = None
        self._failing = False
        self._why_killed = ""
        self._heard_at = 0.0
        self._connected_at: float | None = None

    async def run(self) -> None:
        """Keep it running until the task is cancelled, or a recording has ended."""
        back_off = BackOff(FIRST_PAUSE_S, LONGEST_PAUSE_S)
        while True:
            self._connected_at = None
            reason = await self._run_once()
            if reason is None:
                self._report("ended", f"motion capture: {self.text} has ended")
                return
            if self._was_steady():
                back_off.reset()
            self.state, self.text = "waiting", reason
            if not self._failing:
                self._failing = True
                self._report("failed", f"motion capture: {reason}; it is tried again")
            await asyncio.sleep(back_off.after())
            self.restarts += 1

    def _was_steady(self) -> bool:
        return self._connected_at is not None and self._loop.time() - self._connected_at >= STEADY_S

    def tick(self, now: float) -> None:
        """Called a few times a second: kills a process that does nothing any more."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        limit_s = STALLED_S if self.state == "connected" else CONNECT_S
        if now - self._heard_at > limit_s:
            what = "sends no frames" if self.state == "connected" else "does not answer"
            self._why_killed = f"{self.text.partition(';')[0]} {what}"
            self._heard_at = now
            self._kill()

    def close(self) -> None:
        """End it, without waiting. Idempotent."""
        self._kill()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        process = self._process
        return {
            "state": self.state,
            "text": self.text,
            "pid": None if process is None or process.returncode is not None else process.pid,
            "restarts": self.restarts,
            "bad_lines": self.bad_lines,
            "skipped_lines": self.skipped,
        }

    async def _run_once(self) -> str | None:
        """Start it and read it to its end; how it ended, None for the end of a recording."""
        self.state, self.text, self._why_killed = "connecting", "", ""
        self._heard_at = self._loop.time()
        pipe = asyncio.subprocess.PIPE
        try:
            process = await start_process(
                *self._command, stdin=asyncio.subprocess.DEVNULL, stdout=pipe, stderr=pipe, limit=2 * MAX_LINE_BYTES
            )
        except OSError as error:
            return f"its process cannot be started: {error.strerror or error}"
        self._process = process
        errors = self._loop.create_task(_last_of(process.stderr), name="motion capture errors")
        try:
            if await self._read(process):  # its end: a signal now would make Popen take the exit code from asyncio
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(END_S):
                        await process.wait()
        finally:
            self._kill()
            code, errors_text = await carried_through(_end_of(process, errors))
        if self.state == "ended":
            return None
        if self.state == "failed" or self._why_killed:
            return self._why_killed or self.text
        what = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        return f"its process has ended ({what})" + (f": {errors_text}" if errors_text else "")

    async def _read(self, process: asyncio.subprocess.Process) -> bool:
        """Read its lines; True at their end, False if it has to be killed."""
        assert process.stdout is not None
        rest = b""
        while data := await process.stdout.read(READ_BYTES):
            *lines, rest = (rest + data).split(b"\n")
            now = self._heard_at = self._loop.time()
            taken = newest_frames(lines)
            for line in taken:
                self._on_line(line, now)
                if len(data) >= FLOOD_BYTES:  # a control tick comes between: a frame of 20 bodies takes 0.6 ms
                    await asyncio.sleep(0)
            if len(rest) > MAX_LINE_BYTES:  # longer than any line: it writes something else
                self.bad_lines += 1
                self._why_killed = "its process writes a line that is not poses"
                return False
            self.skipped += len(lines) - len(taken)
            if len(data) >= FLOOD_BYTES:
                await asyncio.sleep(FLOOD_PAUSE_S)
        return True

    def _on_line(self, line: bytes, now: float) -> None:
        match parse_line(line):
            case None:
                self.bad_lines += 1
            case CaptureState() as said:
                self._on_state(said, now)
            case frame:
                self._on_frame(frame, now)

    def _on_state(self, said: CaptureState, now: float) -> None:
        self.state, self.text = said.state, said.text
        if said.state == "connected":
            self._connected_at = now
            self._failing = False
            self._report("connected", f"motion capture: {said.text}")

    def _report(self, change: str, text: str) -> None:
        self._on_event(Event("mocap", None, None, text, {"change": change}))

    def _kill(self) -> None:
        process = self._process
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()  # it has nothing to put back, and may hang in a call that does not end


async def _end_of(process: asyncio.subprocess.Process, errors: asyncio.Task[str]) -> tuple[int, str]:
    """(exit code, its last error) of a process that ends: its pipes are read up to their ends, which closes them."""
    await _drain(process.stdout)
    return await process.wait(), await errors


async def _drain(stream: asyncio.StreamReader | None) -> None:
    """Read what a killed process has left in the pipe, which is closed only then."""
    while stream is not None and await stream.read(STDERR_BYTES):
        pass


async def _last_of(stream: asyncio.StreamReader | None) -> str:
    """The last line of what it writes to standard error."""
    text = b""
    while stream is not None and (part := await stream.read(STDERR_BYTES)):
        text = (text + part)[-STDERR_BYTES:]
    return text.decode(errors="replace").strip().rpartition("\n")[2][:300]


def newest_frames(lines: list[bytes]) -> list[bytes]:
    """All of these lines but those of older frames, beyond `TAKEN_BYTES`. A frame of many bodies has several lines with
    one time, which stay together."""
    taken: list[bytes] = []
    times: set[bytes] = set()
    size = 0
    for line in reversed(lines):
        time, is_frame, _ = line.partition(BODIES)
        size += len(line)
        if not is_frame or time in times or size <= TAKEN_BYTES or len(times) < LEAST_FRAMES:
            taken.append(line)
            times.add(time)
    return taken[::-1]


def arguments(config: MocapConfig) -> list[str]:
    """The arguments of the capture process for this table."""
    found: list[str] = []
    if config.file is not None:
        found += ["--file", os.fspath(config.file)] + ["--loop"] * config.loop
    else:
        found += ["--system", config.type, "--host", config.host or "localhost"]
        found += [] if config.port is None else ["--port", str(config.port)]
    for body in config.bodies.values():
        found.append(f"--body={body}")
    return found
