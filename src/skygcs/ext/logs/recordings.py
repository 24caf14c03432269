"""[recordings]: the tlogs that the daemon has written, and a page that replays one of them.

A replay is a process of its own (`skygcs web --replay`) on a free port of this computer: nothing of it can reach a
vehicle, and it is given nothing but the file. There is one at a time; it ends with the next one, after `LONGEST_S`, and
with the daemon, also one that is killed: its standard input ends then.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import signal
import socket
import stat
import sys
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from skygcs.child_process import start_process
from skygcs.config.tables import Model
from skygcs.errors import RefusedError, SkygcsError
from skygcs.events import Event
from skygcs.ext.logs.methods import METHODS
from skygcs.extension import Extension
from skygcs.web.control_socket import ask_for_link, control_path

if TYPE_CHECKING:
    from skygcs.rpc.context import Services

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}\.tlog")
"""A file's name, and no path."""

BEGUN = re.compile(r"(\d{8})T(\d{6})Z")
"""The UTC time in the names that the recorder gives."""

MAX_LISTED = 200
"""The newest; older ones are counted."""

MAX_LOOKED_AT = 20_000
"""Entries of the folder; a larger one is listed in part."""

READY_S = 60.0
"""A process of Python with aiohttp is up in one second on a quick computer."""

ASK_AGAIN_S = 0.2

LONGEST_S = 4 * 3600.0

ENDS_WITHIN_S = 5.0

KIND = "recorder"


class RecordingsConfig(Model):
    """[recordings]: its presence adds the methods. It plays nothing by itself."""


class Found(NamedTuple):
    """One file of the folder."""

    name: str
    size_bytes: int
    changed_unix_s: float

    @property
    def begun_unix_s(self) -> float | None:
        """By its name; None: it has no time."""
        found = BEGUN.search(self.name)
        try:
            begun = None if found is None else datetime.strptime("".join(found.groups()), "%Y%m%d%H%M%S")
        except ValueError:
            return None
        return None if begun is None else begun.replace(tzinfo=UTC).timestamp()


class Replay:
    """The running page of one recording."""

    def __init__(self, name: str, control: Path, process: asyncio.subprocess.Process) -> None:
        self.name = name
        self.control = control
        self.process = process

    @property
    def running(self) -> bool:
        return self.process.returncode is None

    def end(self) -> None:
        """End it, without waiting. Idempotent."""
        if self.running:
            with contextlib.suppress(ProcessLookupError):
                self.process.send_signal(signal.SIGTERM)
        if self.process.stdin is not None:
            self.process.stdin.close()

    async def ended(self) -> None:
        """Wait for its end; one that does not end is killed."""
        try:
            async with asyncio.timeout(ENDS_WITHIN_S):
                await self.process.wait()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                self.process.kill()
        for path in (self.control, Path(f"{self.control}.cookies")):
            with contextlib.suppress(OSError):
                path.unlink()


class Recordings(Extension[RecordingsConfig]):
    """Lists the recordings of the log folder, and has one replayed."""

    Config = RecordingsConfig
    own_methods = METHODS

    def __init__(self, core: Services, config: RecordingsConfig) -> None:
        super().__init__(core, config)
        self.folder = core.config.daemon.log_dir
        self._replay: Replay | None = None
        self._starting = asyncio.Lock()
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        missing = find_spec("aiohttp") is None
        return ["aiohttp is not installed here, for replays: pip install 'skygcs[web]'"] if missing else []

    def info(self) -> dict[str, Any]:
        replay = self._replay
        return {"replays": None if replay is None or not replay.running else replay.name}

    # -- what the methods do

    async def listed(self) -> dict[str, Any]:
        """The newest recordings, as recordings.list answers."""
        found, more = await asyncio.to_thread(recordings_in, self.folder)
        files = [
            {"name": f.name, "bytes": f.size_bytes, "begun_unix_s": f.begun_unix_s, "ended_unix_s": f.changed_unix_s}
            for f in found
        ]
        return {"folder": str(self.folder), "recordings": files, "left_out": more, **self.info()}

    async def replay(self, name: str) -> dict[str, Any]:
        """Have a recording replayed in place of another; the address of its page, for one browser. Raises
        RefusedError."""
        async with self._starting:
            replay = self._replay
            if replay is None or not replay.running or replay.name != name:
                path = await asyncio.to_thread(recording_of, self.folder, name)
                await self._end_replay()
                replay = self._replay = await self._start(name, path)
            address = await self._address(replay)
            return {"name": name, "address": address}

    async def end(self) -> dict[str, Any]:
        """End the replay."""
        async with self._starting:
            was = self._replay is not None and self._replay.running
            await self._end_replay()
            return {"ended": was}

    # -- its life

    def close(self) -> None:
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()
        if self._replay is not None:
            self._replay.end()

    async def ended(self) -> None:
        if self._replay is not None:
            await self._replay.ended()

    # -- internal

    async def _start(self, name: str, path: Path) -> Replay:
        if self._closed:
            raise RefusedError("skygcs is shutting down")
        port, base = _free_port(), f"{self.core.socket_path}.replay"
        line = [sys.executable, "-m", "skygcs", "web", "--supervised", "--no-open", "--replay", os.fspath(path)]
        line += ["--socket", base, "--port", str(port)]
        try:
            process = await start_process(*line, stdin=asyncio.subprocess.PIPE)
        except OSError as error:
            raise RefusedError(f"the page of the replay does not start: {error.strerror or error}") from None
        self.core.event_log.publish(Event(KIND, None, None, f"{name} is replayed on port {port}", {"replay": name}))
        replay = Replay(name, control_path(base, port), process)
        self._timer = asyncio.get_running_loop().call_later(LONGEST_S, replay.end)
        return replay

    async def _address(self, replay: Replay) -> str:
        """An address of its page, once that answers. Raises RefusedError if it does not."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + READY_S
        while replay.running and loop.time() < deadline:
            if replay.control.exists():
                with contextlib.suppress(SkygcsError):
                    return await asyncio.to_thread(ask_for_link, replay.control, "command")
            await asyncio.sleep(ASK_AGAIN_S)
        code = replay.process.returncode
        why = "does not answer" if code is None else f"has ended with {code}; see the daemon's log"
        await self._end_replay()
        raise RefusedError(f"the page of the replay of {replay.name} {why}")

    async def _end_replay(self) -> None:
        replay, self._replay = self._replay, None
        if self._timer is not None:
            self._timer.cancel()
        if replay is not None:
            replay.end()
            await replay.ended()


def recordings_in(folder: Path) -> tuple[list[Found], int]:
    """The newest recordings of a folder, newest first, and how many more there are. Symbolic links are left out. Raises
    RefusedError if it cannot be read."""
    found: list[Found] = []
    try:
        with os.scandir(folder) as entries:
            for looked_at, entry in enumerate(entries):
                if looked_at >= MAX_LOOKED_AT:
                    break
                if NAME.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    with contextlib.suppress(OSError):  # deleted meanwhile
                        status = entry.stat(follow_symlinks=False)
                        found.append(Found(entry.name, status.st_size, status.st_mtime))
    except FileNotFoundError:
        return [], 0
    except OSError as error:
        raise RefusedError(f"{folder}: {error.strerror or error}") from None
    found.sort(key=lambda f: (f.changed_unix_s, f.name), reverse=True)
    return found[:MAX_LISTED], max(0, len(found) - MAX_LISTED)


def recording_of(folder: Path, name: str) -> Path:
    """The file of a recording. Raises RefusedError for a name that is no recording of this folder."""
    if not NAME.fullmatch(name):
        raise RefusedError(f"{name[:80]!r} is not the name of a recording; recordings.list has them")
    path = folder / name
    try:
        regular = stat.S_ISREG(os.lstat(path).st_mode)
    except OSError as error:
        raise RefusedError(f"{path}: {error.strerror or error}") from None
    if not regular:
        raise RefusedError(f"{path}: is not a regular file")
    return path


def _free_port() -> int:
    """A port of this computer that nobody has now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
