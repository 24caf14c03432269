"""Keeps one link open: open, wait until it fails, close, back off, open again. One place for all kinds.

opening ──► up ──failed──► down ──back-off, opened again──► up          up ──finished──► finished (the end)
   └─────could not open─────▲ └──back-off, could not open──► down
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Literal

from skygcs.back_off import BackOff
from skygcs.errors import LinkError
from skygcs.events import Event
from skygcs.links.base import Link

LinkState = Literal["opening", "up", "down", "finished"]

FIRST_BACK_OFF_S = 0.5
LONGEST_BACK_OFF_S = 5.0
"""A replugged radio is back within this."""

STABLE_AFTER_S = 5.0
"""A link that was up for less has not recovered: the next back-off is longer still."""


class LinkSupervisor:
    """Owner of one link's life. ``state`` since ``since`` (loop time); ``last_error`` is the latest reason, also after
    recovery. The first failure is reported by a link_down event, later ones are counted in ``failures``, and a link_up
    event ends it. ``opened`` counts successes.
    """

    def __init__(self, link: Link, on_event: Callable[[Event], None]) -> None:
        self.link = link
        self.state: LinkState = "opening"
        self.since = link.loop.time()
        self.last_error: str | None = None
        self.failures = 0
        self.opened = 0
        self._on_event = on_event
        self._down_since: float | None = None

    async def run(self) -> None:
        """Until cancelled, or until the link has finished by itself. Nothing a link raises ends it."""
        back_off = BackOff(FIRST_BACK_OFF_S, LONGEST_BACK_OFF_S, STABLE_AFTER_S)
        try:
            while True:
                reason = await self._one_life()
                up_s = self.link.loop.time() - self.since if self.state == "up" else 0.0
                await self._close()
                if self.link.finished:
                    self._finish(reason)
                    return
                self._went_down(reason)
                await asyncio.sleep(back_off.after(up_s))
        finally:
            await self._close()

    async def _one_life(self) -> str:
        """Open and wait for the end; its reason."""
        link = self.link
        link.rearm()
        try:
            await link.open()
        except LinkError as error:
            return str(error)
        except Exception as error:  # a bug or an unexpected error fails this link only
            return f"{link.config.type} {link.name}: unexpected {type(error).__name__}: {error}"
        self._came_up()
        return await link.failed

    async def _close(self) -> None:
        try:
            await self.link.close()
        except Exception as error:
            self.last_error = f"{self.link.name}: closing: {type(error).__name__}: {error}"

    def _enter(self, state: LinkState) -> None:
        if state != self.state:
            self.state = state
            self.since = self.link.loop.time()

    def _came_up(self) -> None:
        self._enter("up")
        self.opened += 1
        down_s = round(self.since - self._down_since, 1) if self._down_since is not None else None
        text = f"link {self.link.name} is up" + (f" again after {down_s:g} s" if down_s is not None else "")
        self._report("link_up", text, {"down_s": down_s, "failures": self.failures})
        self._down_since = None
        self.failures = 0

    def _went_down(self, reason: str) -> None:
        self._enter("down")
        self.last_error = reason
        self.failures += 1
        if self._down_since is None:
            self._down_since = self.since
            self._report("link_down", f"link {self.link.name} is down: {reason}", {"reason": reason})

    def _finish(self, reason: str) -> None:
        self._enter("finished")
        self._report("link_down", f"link {self.link.name}: {reason}", {"reason": reason, "finished": True})

    def _report(self, kind: str, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event(kind, None, None, text, {"link": self.link.name, **data}))
