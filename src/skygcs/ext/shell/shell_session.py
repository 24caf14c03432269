"""The shell of one vehicle, as one client has it open."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable

from skygcs.ext.shell.shell_input import INTERRUPT, ShellInput
from skygcs.ext.shell.shell_output import ShellOutput
from skygcs.runtime.vehicle_actor import VehicleActor


class ShellSession:
    """Text on its way in both directions. Whoever knows its ``key`` has it."""

    def __init__(self, actor: VehicleActor, *, force: bool, now: float) -> None:
        self.key = secrets.token_hex(8)
        self.actor = actor
        self.force = force
        self.opened_at = now
        self.input = ShellInput(now)
        self.output = ShellOutput()
        self.starts_at = now
        """When the vehicle is told to begin a shell."""
        self.started_at: float | None = None
        self.woken = False
        """It has been time for an Enter, if the shell shows no prompt by itself."""
        self.refused = ""
        """Why text that waited was not sent; told with the next read."""
        self.end: str | None = None
        """Why it is no session any more."""
        self.take_back: Callable[[], None] = lambda: None
        """Ends the watch for its client's end."""
        self._news = asyncio.Event()
        self._reads = 0
        self._line = ""

    @property
    def has_news(self) -> bool:
        """True if a read has something to return."""
        return bool(self.output or self.refused or self.end is not None)

    def wake(self) -> None:
        """Something of what a read returns has changed."""
        self._news.set()

    async def wait(self, seconds: float) -> None:
        """Wait for news, this long at most; a later call ends an earlier one, so that one reads."""
        self._reads += 1
        number = self._reads
        self._news.set()  # an earlier one sees that it is not the last
        await asyncio.sleep(0)
        try:
            async with asyncio.timeout(seconds):
                while number == self._reads and not self.has_news:
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            return

    def drop_input(self, why: str) -> None:
        """Forget the text that waits, and say why with the next read. A line that was cut off ends the session: the
        shell would execute its beginning with the next line."""
        gone = self.input.drop()
        if gone:
            self.refused = f"{gone} bytes were not sent: {why}"
            self.wake()

    def line_sent(self, piece: bytes) -> str | None:
        """A piece was sent: the line that it ends, or a Ctrl-C as ^C; None: nothing to report."""
        text = piece.decode("ascii")
        if text == INTERRUPT:
            return "^C"
        self._line += text
        if not text.endswith("\n"):
            return None
        line, self._line = self._line.rstrip("\n"), ""
        return line or None
