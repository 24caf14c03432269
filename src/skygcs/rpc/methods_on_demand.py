"""Methods that come into the table of a server when one of them is first called, all with its first word together.

They are those of installed extensions without a table, made for it by `skygcs.extension.Extensions.demand`.

Modules are imported beside the loop, and so is the packages' metadata read, once.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Awaitable, Callable, Collection, Coroutine
from typing import Any, Protocol

import structlog

from skygcs.config.extension_tables import demanded_word, entry_point_problems, find_on_demand, installed, on_demand
from skygcs.errors import RefusedError
from skygcs.rpc.dispatch import Method, MethodTable, first_word
from skygcs.runtime.task_set import ask, asking_from

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
        self._from_the_start = frozenset(table)
        """Methods that never wait: an order of the core does not, though an extension adds one with its first word."""
        self.extension_tables: Collection[str] = frozenset()
        """Names of the tables of installed extensions; empty until they are looked for."""
        self._words: Collection[str] | None = None
        """First words of extensions' methods that are not in the table yet; None: not known."""
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._last_turns: dict[str, asyncio.Future[None]] = {}
        """By first word the end of the last call that waits; each waits for the one before it. A word without any is
        not in it."""

    def may_have(self, name: str) -> bool:
        """True if a part that was not imported may have this method, or calls wait for that part."""
        if name in self._from_the_start:
            return False
        if first_word(name) in self._last_turns:
            return True
        return name not in self._table and (self._words is None or demanded_word(name, self._words) in self._words)

    def came(self) -> Callable[[], None]:
        """Note that a call comes which has to wait: its order is asked for now. Returns what its task calls first."""
        return functools.partial(asking_from, ask())

    async def add(self, name: str) -> None:
        """Add the methods with the first word of ``name``, if there are any. It returns to calls of one first word in
        their order, also to one that comes when the methods are there and others still wait. Raises RefusedError if
        their extension cannot be made."""
        word = first_word(name)
        before = self._last_turns.get(word)
        turn = self._last_turns[word] = self._loop.create_future()
        try:
            await self._add(name)
        finally:
            try:
                if before is not None and not before.done():
                    await asyncio.wait((before,))
            finally:  # cancelled: the next call waits for the one before this one
                if before is None or before.done():
                    self._end_turn(word, turn)
                else:
                    before.add_done_callback(lambda _: self._end_turn(word, turn))

    def _end_turn(self, word: str, turn: asyncio.Future[None]) -> None:
        turn.set_result(None)
        if self._last_turns[word] is turn:
            del self._last_turns[word]

    async def _add(self, name: str) -> None:
        words = await self._words_of_extensions()
        if name not in self._table and (word := demanded_word(name, words)) in words:
            await self._once(word, lambda: self._import_extension(word))

    async def add_all(self) -> None:
        """Add all. An extension that cannot be made is left out; that was reported."""
        for word in sorted(await self._words_of_extensions()):
            with contextlib.suppress(RefusedError):
                await self.add(word)

    async def once_beside(self, name: str, function: Callable[[], object]) -> None:
        """Call a function while the loop goes on, once for all that wait for it by this name, which has a dot."""

        async def call() -> None:
            await self._beside(function)

        await self._once(name, call)

    async def _words_of_extensions(self) -> Collection[str]:
        if self._words is None:
            await self._once("", self._look)
        return self._words or ()

    async def _once(self, word: str, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        task = self._tasks.get(word)
        if task is None:
            task = self._tasks[word] = self._loop.create_task(work(), name=f"methods on demand {word}")
            task.add_done_callback(lambda _: self._tasks.pop(word))
        await asyncio.shield(task)

    async def _look(self) -> None:
        try:
            await self._beside(on_demand)
            await self._beside(entry_point_problems)
            await self._beside(self._read_tables)
            self._words = set(on_demand())
            for problem in entry_point_problems():
                _log.warning("installed extensions", problem=problem)
        except Exception as error:  # it is not asked again: unknown names are refused in the core's words
            _log.error("the installed extensions cannot be found", exc_info=error)
            self._words = frozenset()

    def _read_tables(self) -> None:
        self.extension_tables = frozenset(installed())

    async def _import_extension(self, word: str) -> None:
        self._extensions.require_well(word)
        try:
            await self._beside(lambda: find_on_demand(word))
        except Exception as error:
            raise self._extensions.failed(word, error) from error
        self._table.add(self._extensions.demand(word, self._table.require_free))
        assert self._words is not None
        self._words = set(self._words) - {word}
