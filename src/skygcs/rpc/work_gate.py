"""The one gate of calls that go to vehicles: it counts each by its targets and bounds those in flight.

The call is                                              and it is
an order that ends a flight (`Method.ends_flight`)       carried out, beside everything below; never refused
that, the same again within JOIN_S, nothing between      answered with the outcome of the earlier one
that, the same again within JOIN_S, else                 carried out; beyond MAX_SAME of one client it waits for JOIN_S
another one, within MAX_ITEMS_OF_A_CLIENT and MAX_ITEMS  carried out
beyond, and the client holds no reserve                  carried out as the client's reserve, however many vehicles
beyond, and the client's reserve is in use               refused

So all clients together have at most MAX_ITEMS in flight and one call each: a greedy client slows others down by no
more than its share, and a client's first call is never refused because of others.

What a method goes to follows from its declaration (`Method.goes_to`): its targets, or the whole fleet if it does not
say that it goes to no vehicle. It is counted while it is carried out if its handler is a coroutine; one that is done at
once has nothing in flight. An item is an order to a single vehicle. `WorkBound` is pure.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable, Hashable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from skygcs.errors import SkygcsError, TargetError
from skygcs.rpc.dispatch import LimitExceeded, Method
from skygcs.rpc.models import MethodParams

MAX_ITEMS_OF_A_CLIENT = 512
"""Ten orders to a laboratory's 50 vehicles at the same time, two to 240; one more as the client's reserve."""

MAX_ITEMS = 1024
"""The limit of all clients together, without their reserves. To begin one takes 0.1 to 0.7 ms of the loop,
in which no frame is read, and a vehicle counts as lost after seconds of silence."""

MAX_SAME = 2
"""The same order that ends a flight, of one client to the same vehicles: so many at once, further ones wait."""

JOIN_S = 0.5
"""So long after it began, the same order that ends a flight may join it: a key that repeats, a second press. Later a
vehicle that has answered may have been moved by its pilot."""


class Asked(NamedTuple):
    """The moment at which a client asked: of the loop's clock, and the number of calls before it."""

    at_s: float
    number: int


NEVER = Asked(float("-inf"), 0)


class TooMuchWork(SkygcsError):
    """A call would exceed the bound; the text says by how much, and what to do."""


@dataclass(eq=False, slots=True)
class Work:
    """A call in flight, from `WorkBound.begin` to `WorkBound.end`."""

    client: Hashable
    items: int
    is_reserve: bool = False
    same_as: Hashable | None = None
    """Only of an order that ends a flight: what a call that is the same has, too."""
    began: Asked = NEVER


class WorkBound:
    """Work in flight of all clients. Each room that was taken is given back by one `end`."""

    def __init__(self) -> None:
        self._shared: Counter[Hashable] = Counter()
        self._reserves: dict[Hashable, Work] = {}
        self._ending: dict[Hashable, list[Work]] = {}
        self._asked = 0

    @property
    def shared_items(self) -> int:
        """Items of all clients but those of their reserves and of orders that end flights."""
        return self._shared.total()

    @property
    def items(self) -> int:
        """All items in flight."""
        ending = sum(work.items for works in self._ending.values() for work in works)
        return self.shared_items + sum(work.items for work in self._reserves.values()) + ending

    def asked(self, now: float) -> Asked:
        """The present moment, for `to_join`."""
        return Asked(now, self._asked)

    def other_asked(self) -> None:
        """Something was asked that may move a vehicle: no order that ends a flight joins an earlier one any more."""
        self._asked += 1

    def begin(self, client: Hashable, name: str, items: int) -> Work:
        """Take room for a call of the method ``name`` to ``items`` vehicles. Raises TooMuchWork."""
        own, everyone = self._shared[client], self.shared_items
        if own + items <= MAX_ITEMS_OF_A_CLIENT and everyone + items <= MAX_ITEMS:
            work = Work(client, items)
            self._shared[client] += items
        elif client not in self._reserves:
            work = self._reserves[client] = Work(client, items, is_reserve=True)
        else:
            limit = (
                f"at most {MAX_ITEMS_OF_A_CLIENT} beside one call"
                if own + items > MAX_ITEMS_OF_A_CLIENT
                else f"and all clients together for {everyone} of at most {MAX_ITEMS}"
            )
            raise TooMuchWork(
                f"{name} to {_vehicles(items)} was not carried out: this client waits for "
                f"{own + self._reserves[client].items} orders to single vehicles, {limit}; wait for their answers, or "
                "name fewer vehicles"
            )
        self._asked += 1
        return work

    def to_join(self, same_as: Hashable, asked: Asked) -> Work | None:
        """The same order that ends a flight, of any client, if it is in force for one that was ``asked`` then: it began
        later, or at most JOIN_S before and nothing else was asked since. ``same_as``: equal for the same orders."""
        same = self._ending.get(same_as)
        if not same or same[-1].began.number < asked.number or asked.at_s - same[-1].began.at_s > JOIN_S:
            return None
        return same[-1]

    def wait_s(self, client: Hashable, same_as: Hashable, now: float) -> float:
        """How long an order that ends a flight is to wait, as its client gives many of the same at once."""
        own = [work for work in self._ending.get(same_as, ()) if work.client == client]
        return max(own[-1].began.at_s + JOIN_S - now, 0.0) if len(own) >= MAX_SAME else 0.0

    def begin_ending(self, client: Hashable, items: int, same_as: Hashable, now: float) -> Work:
        """Take room for an order that ends a flight."""
        self._asked += 1
        work = Work(client, items, same_as=same_as, began=self.asked(now))
        self._ending.setdefault(same_as, []).append(work)
        return work

    def end(self, work: Work) -> None:
        """Give its room back, however the call ended."""
        if work.same_as is not None:
            self._ending[work.same_as].remove(work)
            if not self._ending[work.same_as]:
                del self._ending[work.same_as]
        elif work.is_reserve:
            del self._reserves[work.client]
        else:
            self._shared[work.client] -= work.items
            if not self._shared[work.client]:
                del self._shared[work.client]


class Client(Protocol):
    """The part of `rpc.context.Context` that is used here."""

    @property
    def client(self) -> object:
        """Identity of the client, the same for all of its requests."""
        ...

    @property
    def reports(self) -> object | None:
        """Where the call reports each vehicle's outcome; None: nowhere."""
        ...


class Named(Protocol):
    @property
    def name(self) -> str: ...


Resolve = Callable[[Any], Sequence[Named]]
"""`runtime.fleet.Fleet.resolve_any`."""

ALL = "all"
"""The targets that are the whole fleet."""

COUNTED = ("vehicle_orders_refused", "vehicle_orders_joined", "vehicle_orders_delayed")
"""Calls that were refused, that joined an earlier one, and that waited."""


class WorkGate:
    """`rpc.dispatch.Gate` of a daemon. ``counters``: `COUNTED`."""

    def __init__(self, resolve: Resolve) -> None:
        self.bound = WorkBound()
        self.counters: Counter[str] = Counter(dict.fromkeys(COUNTED, 0))
        self._resolve = resolve
        self._outcomes: dict[Work, asyncio.Future[Any]] = {}
        """By call that is carried out."""

    def stats(self) -> dict[str, Any]:
        """JSON-able: the orders to single vehicles that are in flight, and `COUNTED`."""
        return {"vehicle_orders": self.bound.items, **self.counters}

    def asked(self, method: Method[Any]) -> None:
        """A method that is done at once was called."""
        if not method.while_stopping:
            self.bound.other_asked()

    @asynccontextmanager
    async def room(
        self, method: Method[Any], context: Client, params: MethodParams
    ) -> AsyncIterator[asyncio.Future[Any]]:
        """Room for a call of a method whose handler is a coroutine, within the bound, while the block carries it out.
        Yields its outcome, which the block sets unless it is done: that of the same order, which was in force. Raises
        LimitExceeded, and what the block raises."""
        outcome: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        names = self._names(method, context, params)
        if names is None or (method.always and not method.ends_flight):
            self.asked(method)
            yield outcome
            return
        if method.ends_flight:
            work = await self._room_or_outcome(method, context, params, names)
            if isinstance(work, asyncio.Future):
                yield work
                return
        else:
            try:
                work = self.bound.begin(context.client, method.name, len(names))
            except TooMuchWork as error:
                self.counters["vehicle_orders_refused"] += 1
                raise LimitExceeded(str(error)) from None
        # let it be carried out, give the room back, and the outcome to those that have joined
        self._outcomes[work] = outcome
        try:
            yield outcome
        except Exception as error:
            outcome.set_exception(error)
            outcome.exception()  # it is read here: there may be none that has joined
            raise
        finally:
            outcome.cancel()
            self.bound.end(work)
            del self._outcomes[work]

    async def _room_or_outcome(
        self, method: Method[Any], context: Client, params: MethodParams, names: frozenset[str]
    ) -> Work | asyncio.Future[Any]:
        """Room for an order that ends a flight, or the outcome of the same one that was in force, once it has ended."""
        same_as = (method.name, names, params.model_dump_json(exclude={"targets"}))
        now = asyncio.get_running_loop().time
        asked = self.bound.asked(now())
        # each vehicle's outcome is reported by the call that carries the order out
        may_join = context.reports is None
        while True:
            earlier = self.bound.to_join(same_as, asked) if may_join else None
            if earlier is not None:
                self.counters["vehicle_orders_joined"] += 1
                outcome = self._outcomes[earlier]
                await asyncio.wait({outcome})
                if outcome.cancelled():
                    continue  # the earlier one was; this one is not
                return outcome
            wait_s = self.bound.wait_s(context.client, same_as, now())
            if wait_s <= 0.0:
                return self.bound.begin_ending(context.client, len(names), same_as, now())
            self.counters["vehicle_orders_delayed"] += 1
            await asyncio.sleep(wait_s)
            may_join = True

    def _names(self, method: Method[Any], context: Client, params: MethodParams) -> frozenset[str] | None:
        """The vehicles and components that a call goes to; None: it goes to none. A call that names none that exists,
        which its method refuses, counts as one."""
        if method.goes_to == "nothing":
            return None
        if method.reached is not None:  # one that is not heard keeps the others in the count
            each = (self._resolved(target) for target in method.reached(context, params))
            return frozenset().union(*each) or frozenset({""})
        targets: Any = ALL
        if method.goes_to == "targets":
            targets = getattr(params, "targets", None) or getattr(params, "target", None)
            if targets is None:
                return None
        return self._resolved(targets) or frozenset({""})

    def _resolved(self, targets: Any) -> frozenset[str]:
        try:
            return frozenset(actor.name for actor in self._resolve(targets))
        except TargetError:
            return frozenset()


def _vehicles(number: int) -> str:
    return "1 vehicle" if number == 1 else f"{number} vehicles"
