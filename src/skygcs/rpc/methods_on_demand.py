"""Methods of extensions without a table: looked for when a method is called that the table does not have.

The packages' metadata is read once, and an extension is imported, both beside the loop; what is no first word of an
installed extension's methods is refused at once from then on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Coroutine
from typing import Any, Protocol

import structlog

from skygcs.config.extension_tables import entry_point_problems, find_on_demand, on_demand
from skygcs.rpc.dispatch import Method, MethodTable

_log = structlog.get_logger(__name__)

Beside = Callable[[Callable[[], object]], Awaitable[None]]
"""Calls a function while the loop goes on."""


class Demanded(Protocol):
    """The extensions of the daemon."""

    def require_well(self, word: str) -> None: ...
    def failed(self, word: str, error: Exception) -> Exception: ...
    def demand(self, word: str, accept: Callable[[Collection[Method[Any]]], None]) -> Collection[Method[Any]]: ...


class MethodsOnDemand:
    """Adds to ``table``, which is one server's own. Calls of one first word go on in the order in which they came."""

    def __init__(
        self, table: MethodTable[Any], extensions: Demanded, beside: Beside, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._table = table
        self._extensions = extensions
        self._beside = beside
        self._loop = loop
        self._words: Collection[str] | None = None
        """First words of methods that are not in the table yet; None: not known."""
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def may_have(self, name: str) -> bool:
        """True if an extension that was not imported may have this method."""
        return name not in self._table and (self._words is None or _first_word(name) in self._words)

    async def add(self, name: str) -> None:
        """Add the methods with the first word of ``name``, if an extension has them. Raises RefusedError if it
        cannot be made."""
        if self._words is None:
            await self._once("", self._look)
        word = _first_word(name)
        if self._words is not None and word in self._words:
            await self._once(word, lambda: self._import(word))

    async def _once(self, word: str, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        task = self._tasks.get(word)
        if task is None:
            task = self._tasks[word] = self._loop.create_task(work(), name=f"methods on demand {word}")
            task.add_done_callback(lambda done: self._tasks.pop(word))
        await asyncio.shield(task)

    async def _look(self) -> None:
        try:
            await self._beside(on_demand)
            await self._beside(entry_point_problems)
            self._words = set(on_demand())
            for problem in entry_point_problems():
                _log.warning("installed extensions", problem=problem)
        except Exception as error:  # it is not asked again: unknown names are refused in the core's words
            _log.error("the installed extensions cannot be found", exc_info=error)
            self._words = frozenset()

    async def _import(self, word: str) -> None:
        self._extensions.require_well(word)
        try:
            await self._beside(lambda: find_on_demand(word))
        except Exception as error:
            raise self._extensions.failed(word, error) from error
        self._table.add(self._extensions.demand(word, self._table.require_free))
        assert self._words is not None
        self._words = set(self._words) - {word}


def _first_word(name: str) -> str:
    return name.partition(".")[0]
