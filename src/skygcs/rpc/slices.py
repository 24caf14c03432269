"""Long work of the socket's side in slices: an order, a control tick and routing have their turns in between."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable
from itertools import islice
from typing import Any

from pydantic_core import to_json

SLICE_S = 0.0003
"""Then others have their turn: 50 whole states take 7 to 15 ms, the parameters of 15 vehicles 25 ms, in which no
control tick and no stop would come through. One state is 0.15 to 0.3 ms. With 2 ms, nine pages made control ticks
1.9 ms later (p99), with this 1.0 ms."""

PAUSE_S = 0.001
"""After a slice while an order is on its way. A pause of one turn of the loop is not enough then: an order takes six
turns from the socket to the link, so that it met six slices of each of such works: 20 to 40 ms. Without an order one
turn is: with a millisecond after each slice the states of 50 vehicles were 68 ms old on a page (p99), without 30."""

ORDER_S = 0.02
"""How long an order is on its way at most: those of `make bench-web` take 12 ms (p99)."""


class Slices:
    """When long work goes on after a slice. One of each daemon, shared by all clients."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.one_reader = asyncio.Lock()
        """Held by a request that reads much: however many wait, the loop has one slice in a turn."""
        self._loop = loop
        self._order_at = -math.inf

    def order_came(self) -> None:
        """A request has begun that is not answered at once."""
        self._order_at = self._loop.time()

    def ends_at(self) -> float:
        """When a slice that begins now has to end."""
        return self._loop.time() + SLICE_S

    def pause_s(self) -> float:
        """The pause after a slice that ends now; 0: until the next turn of the loop."""
        return PAUSE_S if self._loop.time() - self._order_at < ORDER_S else 0.0

    async def encoded_list(self, values: Iterable[Any], at_once: int = 1) -> bytes:
        """A JSON array of the values, which are taken from the iterable in slices, too; NaN becomes null.

        The clock is read after every ``at_once`` values. Waits for its turn among such lists.
        """
        async with self.one_reader:
            deadline = self.ends_at()
            pieces: list[bytes] = []
            following = iter(values)
            while some := list(islice(following, at_once)):
                pieces.append(to_json(some, inf_nan_mode="null")[1:-1])
                if self._loop.time() > deadline:
                    await asyncio.sleep(self.pause_s())
                    deadline = self.ends_at()
            return b"[" + b",".join(pieces) + b"]"
