"""A companion without SSH: a session that answers what a test says, and remembers what was asked."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up.inventory import Companion
from skygcs.ext.companions.bring_up.ssh_session import Ran

FACTS = {
    "home": "/home/pi",
    "uid": "1000",
    "machine": "aarch64",
    "python": "3.11",
    "libc": "glibc 2.36",
    "free_kb": "9000000",
    "program": "/home/pi/skygcs/current/bin/skygcs",
    "version": "skygcs 0.1.0",
    "installed": "versions/old",
    "unit": "user",
    "state": "inactive",
    "uptime": "100",
    "unix": "1700000000",
}

UP = '[{"name": "autopilot", "state": "up"}, {"name": "ground", "state": "up"}]'
AT_REST = '[{"name": "alpha", "sysid": 1, "connected": true, "armed": false, "landed": "on_ground"}]'
ARMED = AT_REST.replace('"armed": false', '"armed": true')


def companion(name: str = "alpha", sysid: int = 1) -> Companion:
    return Companion(name, name, sysid, "10.0.0.7", "pi", 22, None, "aarch64", ())


class FakeSession:
    """Answers commands by a part of their text: the first entry of ``answers`` that occurs in the command. Others
    succeed and print nothing."""

    def __init__(self, **facts: str) -> None:
        self.facts = FACTS | facts
        self.answers: list[tuple[str, Ran]] = [("links", Ran(0, UP, "")), ("status", Ran(0, AT_REST, ""))]
        self.commands: list[str] = []
        self.files: dict[str, bytes] = {}
        self.uploads: list[tuple[str, int]] = []
        self.broken: CompanionError | None = None

    def answer(self, part: str, status: int, stdout: str = "", stderr: str = "") -> None:
        """Before all other answers."""
        self.answers.insert(0, (part, Ran(status, stdout, stderr)))

    def ran(self, part: str) -> bool:
        return any(part in command for command in self.commands)

    async def run(self, command: str, *, stdin: str | None = None) -> Ran:
        if "LONG_BIT" in command:
            return Ran(0, "".join(f"{key}={value}\n" for key, value in self.facts.items()), "")
        self.commands.append(command)
        return next((ran for part, ran in self.answers if part in command), Ran(0, "", ""))

    async def follow(self, command: str, on_line: Callable[[str, str], None]) -> int | None:
        ran = await self.run(command)
        for line in ran.stdout.splitlines():
            on_line("out", line)
        return ran.status

    async def upload(self, local: Path, remote: str, *, offset: int, on_bytes: Callable[[int], None]) -> None:
        self.uploads.append((remote, offset))
        if self.broken is not None:
            raise self.broken
        on_bytes(len(await asyncio.to_thread(local.read_bytes)))

    async def write(self, remote: str, data: bytes, *, mode: int = 0o644) -> None:
        self.files[remote] = data

    async def read(self, remote: str, *, most_bytes: int) -> bytes:
        return self.files[remote]

    @contextlib.asynccontextmanager
    async def connect(self, _: Companion) -> AsyncIterator[FakeSession]:
        yield self
