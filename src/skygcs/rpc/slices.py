"""Long work of the socket's side in slices: an order, a control tick and routing have their turns in between."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any

from skygcs.rpc.replies import encode
from skygcs.runtime.loop_clock import exact_clock

SLICE_S = 0.0006
"""Then others have their turn: 50 whole states take 7 to 15 ms, the parameters of 15 vehicles 25 ms, in which no
control tick and no stop would come through. One state is 0.07 to 0.15 ms. With half of it there are twice as many
pauses, and lists take longer."""

AHEAD_S = 0.0008
"""A slice begins only if no control tick is due for so long: a slice and the state that is begun at its end."""

PUT_OFF_S = 0.002
"""A slice waits for control ticks no longer: one that is due may come 1.5 ms later (libuv counts in milliseconds).
Where ticks are so dense that nothing fits in between, 50 states in 8 slices are 16 ms later."""

LOOK_S = 0.00001
"""The shortest wait for a control tick: virtual time does not pass in none at all. To uvloop it is the next turn."""

PAUSE_S = 0.001
"""After a slice while an order is on its way. A pause of one turn of the loop is not enough then: an order takes six
turns from the socket to the link, so that it met six slices of each of such works: 20 to 40 ms. Without an order one
turn is: with a millisecond after each slice the states of 50 vehicles were 68 ms old on a page (p99), without 30."""

ORDER_S = 0.02
"""How long an order is on its way at most: those of `make bench-web` take 12 ms (p99)."""


MOST_REST_S = 0.02
"""The longest pause after requests: a control tick at 50 Hz has come through by then."""

LONG_S = 0.01
"""A line that has the loop for so long makes control ticks late by itself: 1 MB of JSON takes 20 to 40 ms, in one
piece."""

OWN_REST, MOST_OWN_REST_S = 3.0, 0.25
"""The pause of a client after such a line, in times that it took, and the longest. The others go on meanwhile. Beside
20 vehicles at 50 Hz a flood of such lines cost 28 % of the ticks, with these pauses 12 %; an order to hold of another
client began after 6 ms instead of 51. An order behind a plan of 32 MiB, which takes 1.5 s, waits no longer."""


class Slices:
    """When long work begins and goes on. One of each daemon, shared by all clients. Its clock is exact: uvloop's own
    counts milliseconds, by which each slice went on until the next one, when timers are due."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, next_control_tick: Callable[[], float] = lambda: math.inf
    ) -> None:
        """``next_control_tick``: `Fleet.next_control_tick`."""
        self.one_reader = asyncio.Lock()
        """Held by a request that reads much: however many wait, the loop has one slice in a turn."""
        self.now = exact_clock(loop)
        self._next_control_tick = next_control_tick
        self._order_at = -math.inf

    def order_came(self) -> None:
        """A request has begun that is not answered at once."""
        self._order_at = self.now()

    def begins_by(self, pause_s: float = 0.0) -> float:
        """When a slice that could begin after this pause has to begin, whatever is due."""
        return self.now() + pause_s + PUT_OFF_S

    def wait_s(self, begins_by: float) -> float | None:
        """How long to wait before a slice because of a control tick that is due or late, and then to ask again; None:
        it begins now."""
        now = self.now()
        due_in_s = self._next_control_tick() - now
        return max(due_in_s, LOOK_S) if due_in_s < AHEAD_S and now < begins_by else None

    def ends_at(self) -> float:
        """When a slice that begins now has to end; see `over`."""
        return self.now() + SLICE_S

    def over(self, ends_at: float) -> bool:
        return self.now() > ends_at

    def pause_s(self) -> float:
        """The pause after a slice that ends now; 0: until the next turn of the loop."""
        return PAUSE_S if self.now() - self._order_at < ORDER_S else 0.0

    def rest_s(self, took_s: float) -> float:
        """The pause after requests that took so long: as long, while a vehicle is flown by setpoints. One client that
        sent setpoints for 20 vehicles without a pause made five ticks in six late, and one in eight was left out."""
        return min(took_s, MOST_REST_S) if self._next_control_tick() < math.inf else 0.0

    def own_rest_s(self, took_s: float) -> float:
        """The pause of a client after a line that took so long, while a vehicle is flown by setpoints."""
        if took_s <= LONG_S or self._next_control_tick() == math.inf:
            return 0.0
        return min(OWN_REST * took_s, MOST_OWN_REST_S)

    async def encoded_list(self, values: Iterable[Any], at_once: int = 1) -> bytes:
        """A JSON array of the values, which are taken from the iterable in slices, too; NaN becomes null.

        The clock is read after every ``at_once`` values. Waits for its turn among such lists.
        """
        async with self.one_reader:
            deadline = await self._turn()
            pieces: list[bytes] = []
            following = iter(values)
            while some := list(islice(following, at_once)):
                pieces.append(encode(some)[1:-1])
                if self.over(deadline):
                    await asyncio.sleep(self.pause_s())
                    deadline = await self._turn()
            return b"[" + b",".join(pieces) + b"]"

    async def _turn(self) -> float:
        """Wait until a slice may begin; when it has to end."""
        begins_by = self.begins_by()
        while True:
            wait_s = self.wait_s(begins_by)
            if wait_s is None:
                return self.ends_at()
            await asyncio.sleep(wait_s)
