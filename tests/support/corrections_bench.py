"""A source of corrections at work without a daemon: a feed whose hub keeps what is sent to the vehicles."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from skygcs.events import Event
from skygcs.ext.corrections.caster import CasterSource
from skygcs.ext.corrections.config import CorrectionsConfig
from skygcs.ext.corrections.correction_feed import CorrectionFeed
from skygcs.ext.corrections.feeder import Feeder
from skygcs.ext.corrections.gga import GgaPosition
from skygcs.ext.corrections.receiver import ReceiverSource
from support.frames import dialect


class CorrectionsBench:
    """``table``: [corrections]; ``place``: of a virtual station, by the source of the last one."""

    def __init__(self, place: Callable[[str | None], GgaPosition | None] = lambda last: None, **table: Any) -> None:
        self.config = CorrectionsConfig.model_validate(table)
        self.clock = asyncio.get_running_loop().time
        self.sent = bytearray()
        """The content of all GPS_RTCM_DATA."""
        hub: Any = SimpleNamespace(dialect=dialect(), channels={}, channels_to=lambda *_: (1,), send=self._send)
        self.feed = CorrectionFeed(hub, SimpleNamespace(vehicles={}), self.clock)  # type: ignore[arg-type]
        self.events: list[Event] = []
        self.asleep: Callable[[], bool] = lambda: False
        if self.config.serial is None:
            self.source: Any = CasterSource(self.config, place, self.clock)
        else:
            self.source = ReceiverSource(self.config, self.clock)
        self.feeder = Feeder(self.source, self.feed, self.clock, self.events.append, lambda: self.asleep())

    def _send(self, info: Any, values: Any, *_: Any, **__: Any) -> bool:
        self.sent += bytes(values["data"])[: values["len"]]
        return True

    @property
    def status(self) -> dict[str, Any]:
        return self.feeder.status()

    def changes(self) -> list[str]:
        """What was told by events, in its order."""
        return [event.data["change"] for event in self.events]

    async def until(self, condition: Callable[[], bool], within_s: float) -> None:
        """Wait until it holds. Raises TimeoutError."""
        async with asyncio.timeout(within_s):
            while True:
                if condition():
                    return
                await asyncio.sleep(0.1)
