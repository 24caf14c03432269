"""What all sessions of a server share, and the orders that no session's end may end."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any

from skygcs.rpc.context import Context
from skygcs.rpc.dispatch import Dispatcher
from skygcs.rpc.ports import Daemon, JsonObject
from skygcs.rpc.subscriptions import Feeds

if TYPE_CHECKING:
    from skygcs.rpc.session import Session

MAX_WITHOUT_CLIENT = 256
"""Landings and the like that go on after their clients have gone; beyond that they end with the client. One client
that connects, orders and leaves in a loop must not make the daemon keep more and more."""


class Sessions:
    """What all sessions share."""

    def __init__(self, daemon: Daemon, dispatcher: Dispatcher[Context], loop: asyncio.AbstractEventLoop) -> None:
        self.daemon = daemon
        self.dispatcher = dispatcher
        self.loop = loop
        self.feeds = Feeds(daemon, loop)
        self.sessions: set[Session] = set()
        self.counters: Counter[str] = Counter()
        self.lasting: set[asyncio.Task[bytes]] = set()
        """Orders that end a flight: they belong to no session, so that no session's end ends them."""

    def outlive(self, work: Coroutine[Any, Any, bytes]) -> Coroutine[Any, Any, bytes]:
        """Begin ``work`` at once, whoever goes away; awaiting what is returned gives its reply."""
        if len(self.lasting) >= MAX_WITHOUT_CLIENT:
            return work
        task = self.loop.create_task(work, name="rpc order")
        self.lasting.add(task)
        task.add_done_callback(self.lasting.discard)

        async def reply() -> bytes:
            return await asyncio.shield(task)

        return reply()

    def unauthenticated(self) -> int:
        return sum(not s.authenticated for s in self.sessions)

    def stats(self) -> JsonObject:
        return {"sessions": len(self.sessions), **self.counters}

    async def close(self) -> None:
        """End every session, and what outlives them; wait for all of it."""
        tasks: list[asyncio.Task[Any]] = [task for session in self.sessions for task in session.tasks]
        tasks += self.lasting
        for session in list(self.sessions):
            session.close()
        for task in list(self.lasting):
            task.cancel()
        self.feeds.close()
        await asyncio.gather(*tasks, return_exceptions=True)
