"""An extension whose work is done by a process beside the daemon: the web page, ROS, the bridge to other stations."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, TypeVar

from skygcs.config.tables import Model
from skygcs.extension import Extension

if TYPE_CHECKING:
    from skygcs.rpc.context import Services
    from skygcs.runtime.supervised_child import SupervisedChild

C = TypeVar("C", bound=Model)


class ProcessExtension(Extension[C]):
    """Keeps one process running, which is a client of the daemon's socket: started when that answers, and gone when
    the daemon has ended. A subclass makes ``child`` in its `__init__`."""

    child: SupervisedChild

    def __init__(self, core: Services, config: C) -> None:
        super().__init__(core, config)
        self._answers = asyncio.Event()

    def info(self) -> dict[str, Any]:
        return self.child.status()

    async def start(self) -> None:
        """The socket answers."""
        self._answers.set()

    async def run(self) -> None:
        """Keep it running."""
        await self._answers.wait()
        await self.child.run()

    def close(self) -> None:
        self.child.close()

    async def ended(self) -> None:
        await self.child.ended()
