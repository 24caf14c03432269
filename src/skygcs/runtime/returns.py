"""Brings several vehicles home that were ordered to return together: those whose ways conflict leave one after another.

Who leaves, climbs or waits is decided by `core.monitor.departures`; here the decision meets orders, telemetry and time.
Those that wait hold. One that another order, its pilot or its own failsafe has taken is left to them, and its way is
kept free. The order to a single vehicle does not pass here.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.vehicle_class import HeightParam
from skygcs.core.monitor.approach import Vector
from skygcs.core.monitor.departures import UNKNOWN, Departures, ReturnHeight, Returning, departing
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.monitor.ways import Way
from skygcs.core.monitor.yielding import COMING_HOME
from skygcs.core.protocols.command import Outcome
from skygcs.core.separation import Footprint
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent

PERIOD_S = 0.5

STUCK_S = 45.0
"""While none of them has moved by `MOVED_M` or landed for so long, those that wait are given up. ArduCopter waits for
RTL_LOIT_TIME above its home, 5 s by default, and a landing moves all the while."""

MOVED_M = 1.0

AGAIN_S = 5.0
"""After an order to one that waits which it did not take."""

AtEnd = Literal["hold", "land"]

TAKES_S = 10.0
"""So long after its order a vehicle counts as on its way home, whatever mode it reports: an order is sent for 7 s."""


@dataclass(slots=True)
class _Waiting:
    """One that waits. ``order_number``: of the last order that was ours; None: one is on its way."""

    actor: VehicleActor
    at_end: AtEnd
    told: tuple[str, ...]
    order_number: int | None = None
    goal_m: float | None = None
    """Height to which it was sent to climb, in the common frame."""
    retry_at: float = -math.inf


class Returns:
    """Returns under way of one fleet: `begin`, `wait` and `run` with each order to return to several vehicles."""

    def __init__(
        self, footprint: Callable[[VehicleActor], Footprint], loop: asyncio.AbstractEventLoop, on_event: OnEvent
    ) -> None:
        self._footprint = footprint
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event)
        self._members: dict[int, VehicleActor] = {}
        """All that were ordered to return together, until none of them waits."""
        self._waiting: dict[int, _Waiting] = {}
        self._left_at: dict[int, float] = {}
        self._heights: dict[int, ReturnHeight] = {}
        self._frame: EnuFrame | None = None
        self._running = False
        self._moved_at = -math.inf
        self._places: dict[int, Vector] = {}
        """Where each member was when it last had moved."""

    async def begin(self, actors: Sequence[VehicleActor], *, at_end: AtEnd = "hold") -> dict[VehicleActor, str]:
        """Decide who of these has to wait; returns whom each of them waits for, in words. The others are to be ordered
        to return now. ``at_end``: what those do whose way does not become clear."""
        now = self._loop.time()
        for actor in actors:
            self._waiting.pop(actor.vehicle.key, None)
        known = [actor for actor in actors if _is_placed(actor.vehicle, now)]
        if len(known) < 2 and not self._waiting:
            return {}
        if not self._waiting:
            self._members.clear()
            self._frame = _frame(known[0].vehicle)
        # who goes home already, or by its own failsafe, is not held
        free = [a for a in known if a.vehicle.mode not in COMING_HOME and not a.vehicle.failsafe]
        self._members |= {actor.vehicle.key: actor for actor in known}
        self._left_at |= dict.fromkeys((a.vehicle.key for a in known if a not in free), now)
        decided = await self._decide(free)
        self._left_at |= dict.fromkeys(decided.leave, now)
        for key, names in decided.waits_for.items():
            self._waiting[key] = _Waiting(self._members[key], at_end, names)
        return {self._members[key]: _named(names) for key, names in decided.waits_for.items()}

    async def wait(self, actor: VehicleActor, names: str) -> Outcome:
        """The order to return of one that has to wait: it holds. One that cannot hold returns at once."""
        waits = self._waiting[actor.vehicle.key]
        outcome = await actor.hold()
        if self._waiting.get(actor.vehicle.key) is not waits:
            return outcome
        if outcome.ok:
            waits.order_number = actor.order_number
            text = f"it holds until {names} is out of its way home, and returns then"
            self._report(actor, text)
            return replace(outcome, message=text)
        self._drop(waits)
        return outcome if outcome.result == "cancelled" else await actor.rtl()

    def run(self) -> None:
        """Go on with those that wait, if there are any. Idempotent."""
        if self._waiting and not self._running:
            self._running = True
            self._tasks.start(self._bring_home(), "returns one after another")

    def close(self) -> None:
        """The daemon ends: those that wait go on holding."""
        for waits in self._waiting.values():
            self._report(waits.actor, "skygcs ends: it goes on holding and does not return", given_up=True)
        self._waiting.clear()
        self._tasks.close()

    # -- internal

    async def _bring_home(self) -> None:
        reading = self._tasks.start(self._read_heights(), "return heights")
        self._places, self._moved_at = {}, self._loop.time()
        try:
            while self._waiting:
                await asyncio.sleep(PERIOD_S)
                for waits in list(self._waiting.values()):
                    self._look(waits)
                ready = [waits.actor for waits in self._waiting.values() if waits.order_number is not None]
                self._carry_out(await self._decide(ready))
                if not self._moves() and reading.done():
                    self._give_up()
        finally:
            self._running = False
            reading.cancel()

    def _look(self, waits: _Waiting) -> None:
        """Leave it to whoever else has taken it: another order, its failsafe, its pilot."""
        actor, vehicle = waits.actor, waits.actor.vehicle
        if waits.order_number is None:
            return
        if vehicle.mode in COMING_HOME:
            self._drop(waits)
            self._report(actor, f"it does not wait any more: it is in {vehicle.mode}")
        elif actor.order_number != waits.order_number or not is_flying(vehicle, self._loop.time()):
            self._drop(waits)
            self._report(actor, "it does not wait any more to return: it was ordered something else, or is down")

    def _drop(self, waits: _Waiting) -> None:
        del self._waiting[waits.actor.vehicle.key]

    async def _decide(self, free: Sequence[VehicleActor]) -> Departures:
        """The decision for these, in turns with others."""
        now = self._loop.time()
        waiting = [one for actor in free if (one := self._returning(actor, now)) is not None]
        under_way: list[Returning] = []
        fixed: list[Way] = []
        for key, actor in self._members.items():
            one = None if actor in free else self._returning(actor, now)
            if one is None:
                continue
            flies = is_flying(actor.vehicle, now)
            leaves = actor.vehicle.mode in COMING_HOME or now - self._left_at.get(key, -math.inf) < TAKES_S
            if flies and leaves and key not in self._waiting:
                under_way.append(one)
            else:
                fixed.append(replace(one.place(), doing="in the air" if flies else "parked"))
        work = departing(waiting, under_way, fixed)
        while True:
            try:
                next(work)
            except StopIteration as end:
                decided: Departures = end.value
                return decided
            await asyncio.sleep(0)

    def _carry_out(self, decided: Departures) -> None:
        now = self._loop.time()
        for key in (*decided.leave, *decided.climb):
            waits = self._waiting.get(key)
            if waits is None or waits.order_number is None or now < waits.retry_at:
                continue
            goal_m = decided.climb.get(key)
            if goal_m is not None and waits.goal_m is not None and abs(goal_m - waits.goal_m) < MOVED_M:
                continue  # it climbs there
            waits.order_number = None
            work = self._leave(waits) if goal_m is None else self._climb(waits, goal_m)
            self._tasks.start(work, f"return of {waits.actor.name}")
        for key, names in decided.waits_for.items():
            waits = self._waiting.get(key)
            if waits is not None:
                waits.told = names

    async def _leave(self, waits: _Waiting) -> None:
        actor = waits.actor
        self._left_at[actor.vehicle.key] = self._loop.time()
        outcome = await actor.rtl()
        if self._waiting.get(actor.vehicle.key) is not waits:
            return
        if outcome.ok or outcome.result == "cancelled":
            self._drop(waits)
            self._left_at[actor.vehicle.key] = self._loop.time()
        else:
            del self._left_at[actor.vehicle.key]
            self._ordered(waits)

    async def _climb(self, waits: _Waiting, goal_m: float) -> None:
        actor, now = waits.actor, self._loop.time()
        one = self._returning(actor, now)
        if one is None or self._frame is None:
            self._ordered(waits)
            return
        lat_deg, lon_deg, alt_amsl_m = self._frame.to_geodetic(*one.here[:2], goal_m)
        home_amsl_m = actor.vehicle.home_alt_amsl_m()
        self._report(actor, f"it climbs by {goal_m - one.here[2]:.0f} m, above the way home of others, and waits there")
        height_m = alt_amsl_m - (0.0 if home_amsl_m is None else home_amsl_m)
        outcome = await actor.goto(lat_deg=lat_deg, lon_deg=lon_deg, height_m=height_m, force=True)
        waits.goal_m = goal_m if outcome.ok else None
        self._ordered(waits, ok=outcome.ok)

    def _ordered(self, waits: _Waiting, *, ok: bool = False) -> None:
        """An order to one that goes on waiting has ended."""
        waits.order_number = waits.actor.order_number
        if not ok:
            waits.retry_at = self._loop.time() + AGAIN_S

    def _moves(self) -> bool:
        """True if one of them has moved, or landed, in the last `STUCK_S`."""
        now = self._loop.time()
        for key, actor in self._members.items():
            one = self._returning(actor, now)
            here = None if one is None or not is_flying(actor.vehicle, now) else one.here
            last = self._places.get(key)
            if (here is None) != (last is None) or (here and last and math.dist(here, last) > MOVED_M):
                self._moved_at = now
                if here is None:
                    del self._places[key]
                else:
                    self._places[key] = here
        return now - self._moved_at < STUCK_S

    def _give_up(self) -> None:
        """The ways do not become clear: what is left is a person's decision, or a landing where they are."""
        for waits in list(self._waiting.values()):
            self._drop(waits)
            actor, text = waits.actor, f"{_named(waits.told)} stays in its way home"
            if waits.at_end == "land":
                self._report(actor, f"{text}: it lands where it is", given_up=True)
                self._tasks.start(actor.land(), f"landing of {actor.name}")
            else:
                todo = f"send it home in spite of that (skygcs-cli rtl {actor.name}), elsewhere, or land it"
                self._report(actor, f"{text}: it holds and does not return; {todo}", given_up=True)

    async def _read_heights(self) -> None:
        """Read the return heights of all, until which any height is taken to be possible."""
        wanted = [actor for key, actor in self._members.items() if key not in self._heights]
        async with asyncio.TaskGroup() as group:
            for actor in wanted:
                group.create_task(self._read_height(actor), name=f"return height of {actor.name}")

    async def _read_height(self, actor: VehicleActor) -> None:
        height = await read_return_height(actor)
        if height is not UNKNOWN:
            self._heights[actor.vehicle.key] = height

    def _returning(self, actor: VehicleActor, now: float) -> Returning | None:
        """A member, where it is now; None if that or its home is not known."""
        vehicle = actor.vehicle
        position, at = vehicle.timed_telemetry("position")
        home = vehicle.telemetry("home")
        if position is None or at is None or home is None or self._frame is None or position["lat_deg"] is None:
            return None
        return Returning(
            vehicle.key,
            vehicle.name,
            self._footprint(actor),
            self._frame.from_geodetic(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]),
            position["vel_enu_mps"],
            self._frame.from_geodetic(home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]),
            self._heights.get(vehicle.key, UNKNOWN),
            max(0.0, now - at),
        )

    def _report(self, actor: VehicleActor, text: str, *, given_up: bool = False) -> None:
        data = {"order": "rtl", "result": "failed" if given_up else "in_progress"}
        self._on_event(Event("command", actor.name, actor.sysid, f"rtl: {text}", data))


async def read_return_height(actor: VehicleActor) -> ReturnHeight:
    """The return height by its parameters, read from the vehicle; `UNKNOWN`: it does not answer, or has none."""
    able = actor.vehicle.abilities
    heights = [await _param(actor, height) for height in able.return_heights]
    return _return_height(heights, await _param(actor, able.return_climb) if able.return_climb else 0.0)


def known_return_height(vehicle: Vehicle) -> ReturnHeight:
    """The return height by parameters that have been read before; `UNKNOWN` without them."""
    able = vehicle.abilities
    climb_m = _known(vehicle, able.return_climb) if able.return_climb else 0.0
    if climb_m is None:
        return UNKNOWN
    return _return_height([_known(vehicle, height) for height in able.return_heights], climb_m)


def _return_height(heights_m: Sequence[float | None], climb_m: float | None) -> ReturnHeight:
    """The highest of its heights; `UNKNOWN` if one of them is not known. Below 0: as high as it is (ArduPlane)."""
    known = [max(height_m, 0.0) for height_m in heights_m if height_m is not None]
    if not known or len(known) < len(heights_m):
        return UNKNOWN
    return ReturnHeight(0.0, max(known), max(climb_m or 0.0, 0.0))


def _known(vehicle: Vehicle, param: HeightParam) -> float | None:
    return next((value / per_metre for name, per_metre in param if (value := vehicle.param(name)) is not None), None)


def _is_placed(vehicle: Vehicle, now: float) -> bool:
    """True if its way home is known: it flies, is heard, and reports where it and its home are."""
    position, home = vehicle.telemetry("position"), vehicle.telemetry("home")
    placed = position is not None and position["lat_deg"] is not None and home is not None
    stays = vehicle.abilities_now(now).hovers and not vehicle.abilities_now(now).circles
    return placed and stays and vehicle.connected and not vehicle.replayed and is_flying(vehicle, now)


def _frame(vehicle: Vehicle) -> EnuFrame:
    position = vehicle.telemetry("position")
    assert position is not None
    return EnuFrame(Origin(position["lat_deg"], position["lon_deg"], 0.0))


def _named(names: Sequence[str]) -> str:
    return " and ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


async def _param(actor: VehicleActor, param: HeightParam) -> float | None:
    """The first of these parameters that the vehicle has, in metres; None: it has none, or does not answer."""
    for name, per_metre in param:
        outcome = await actor.params.get(name)
        if outcome.ok and outcome.number is not None:
            return float(outcome.number) / per_metre
    return None
