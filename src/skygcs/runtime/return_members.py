"""Members of the returns under way: the vehicles whose places and ways home count when it is decided who leaves.

Those that were ordered to return while others waited, or that come home by themselves. Here is what is known of each:
when it was sent home, whether it is on its way, where it is and has its home, at which height it returns, below which
one its fence keeps it, and whether it holds at the end of its return. Who waits, leaves or climbs, and every order, is
`runtime.returns`.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, ItemsView, KeysView, Mapping, Sequence, Set, ValuesView
from dataclasses import replace

from skygcs.core.geo import EnuFrame, Origin
from skygcs.core.mavlink.vehicle_class import HeightParam, ReturnEnd
from skygcs.core.monitor.conflict_levels import COMING_HOME, LANDING, LANDING_ORDERS
from skygcs.core.monitor.departures import (
    AT_A_TURN,
    UNKNOWN,
    ReturnHeight,
    Returning,
    is_placed,
    known_return_height,
    return_height,
)
from skygcs.core.monitor.tracks import is_flying, why_unplaced
from skygcs.core.monitor.ways import Way, beginning, column, leads_on, too_near
from skygcs.core.vehicle.fence_params import CLEARANCE_M, NAMES, has_known_fence, known_ceiling_m
from skygcs.core.vehicle.mission_orders import HOME_S, MISSION_RETURN_MODES, HomeWatch
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor

ELSEWHERE = frozenset({"goto", "hold", "takeoff"})
"""Orders after which a vehicle is no longer on its way home by an older one."""

TAKES_S = 10.0
"""So long after its order a vehicle counts as on its way home, whatever mode it reports: an order is sent for 7 s."""


class ReturnMembers:
    """Members of one round of returns, by key of the vehicle, until none of them is under way. ``goal_m``: gives the
    height to which a member was sent to climb, in the common frame; ``tasks``: settings are read in these."""

    def __init__(
        self,
        monitor: SeparationMonitor,
        loop: asyncio.AbstractEventLoop,
        tasks: TaskSet,
        goal_m: Callable[[int], float | None],
    ) -> None:
        self._monitor = monitor
        self._loop = loop
        self._tasks = tasks
        self._goal_m = goal_m
        self.frame: EnuFrame | None = None
        """The common frame of this round; None before the first one."""
        self.staying: set[int] = set()
        """Keys of those that hold at the end of their return, for good."""
        self._actors: dict[int, VehicleActor] = {}
        self._left_at: dict[int, tuple[float, int]] = {}
        """When each was sent home, and the number of the last order to it by then."""
        self._heights: dict[int, ReturnHeight] = {}
        """Heights that were read in this round, where the vehicle itself keeps none."""
        self._reading: dict[int, asyncio.Task[None]] = {}
        self._seen: dict[int, tuple[Returning, float]] = {}
        """Each member where its place was known last, and when that was."""
        self._homes: dict[int, HomeWatch] = {}

    # -- who is a member

    def begin_round(self, frame: EnuFrame) -> None:
        """Nobody waits any more: forget the members, but those that are seen on their way home. One that is lost keeps
        nobody in the air."""
        now = self._loop.time()
        seen = {key: actor for key, actor in self.items() if actor.vehicle.connected and not actor.closed}
        self._actors = {key: actor for key, actor in seen.items() if self.is_under_way(actor, now)}
        self._left_at = {key: at for key, at in self._left_at.items() if key in self._actors}
        for table in (self._homes, self._heights, self._seen):
            table.clear()
        self.staying.clear()
        self.frame = frame

    def add(self, actors: Sequence[VehicleActor]) -> None:
        """Count these among the members."""
        self._actors |= {actor.vehicle.key: actor for actor in actors}

    def add_those_that_come_home(self, vehicles: Mapping[int, VehicleActor], now: float) -> None:
        """Add those that come home by whatever order, pilot or failsafe: their ways are those of a return."""
        for key, actor in vehicles.items():
            if key not in self._actors and _comes(actor, COMING_HOME) and is_placed(actor.vehicle, now):
                self._actors[key] = actor

    def leave_out_gone(self) -> None:
        """Vehicles that were forgotten are not in the way any more."""
        for key in [key for key, actor in self.items() if actor.closed]:
            del self._actors[key]
            self.staying.discard(key)

    def keys(self) -> KeysView[int]:
        """Keys of the members."""
        return self._actors.keys()

    def actors(self) -> ValuesView[VehicleActor]:
        """The members."""
        return self._actors.values()

    def items(self) -> ItemsView[int, VehicleActor]:
        """The members with their keys."""
        return self._actors.items()

    def names(self, keys: Set[int]) -> set[str]:
        """Names of the members of these keys."""
        return {self._actors[key].name for key in keys}

    # -- who is on its way

    def leaves_now(self, actor: VehicleActor) -> None:
        """Note that a vehicle is sent home now."""
        self._left_at[actor.vehicle.key] = self._loop.time(), actor.runner.ledger.number

    def has_left(self, actor: VehicleActor, now: float) -> bool:
        """True if it was sent home in the last `TAKES_S`, and nowhere else since."""
        at, number = self._left_at.get(actor.vehicle.key, (-math.inf, 0))
        ledger = actor.runner.ledger
        elsewhere = ledger.effective > number and ledger.effective_order in ELSEWHERE
        return now - at < TAKES_S and not elsewhere

    def _lands(self, actor: VehicleActor, now: float) -> bool:
        """True if it comes down where it is. One that was sent home since may be in its landing yet."""
        number, ledger = self._left_at.get(actor.vehicle.key, (0.0, 0))[1], actor.runner.ledger
        again = ledger.effective > number and ledger.effective_order in LANDING_ORDERS
        return _comes(actor, LANDING if again or not self.has_left(actor, now) else frozenset())

    def is_under_way(self, actor: VehicleActor, now: float, *, leaves: bool = False) -> bool:
        """True if it comes home, or down, by whatever order or failsafe, or was ordered to in the last `TAKES_S`.
        ``leaves``: its order to return is being sent."""
        comes = leaves or self.has_left(actor, now) or _comes(actor, COMING_HOME)
        return is_flying(actor.vehicle, now) and actor.vehicle.key not in self.staying and comes

    def look_home(self) -> list[VehicleActor]:
        """Note who holds at the end of its return; returns those that do since now."""
        now = self._loop.time()
        begun = []
        for key, actor in self.items():
            vehicle, flying = actor.vehicle, is_flying(actor.vehicle, now)
            home_s = self._homes.setdefault(key, HomeWatch()).stays_s(vehicle, now, flying=flying)
            rule = vehicle.return_rule(now)
            holds = rule.known and not rule.markers and rule.end is ReturnEnd.HOLDS
            holds = holds and vehicle.connected and not vehicle.failsafe
            if not (flying and holds and vehicle.mode in MISSION_RETURN_MODES and home_s >= HOME_S):
                self.staying.discard(key)
            elif key not in self.staying:
                self.staying.add(key)
                begun.append(actor)
        return begun

    # -- settings of a return

    def read_settings(self) -> None:
        """Begin to read the return height of each, until which any height is taken to be possible, and how it ends."""
        for key, actor in self.items():
            if key not in self._reading:
                self._reading[key] = self._tasks.start(self._read(actor), f"return height of {actor.name}")

    def is_read(self) -> bool:
        """True if the settings of all have been read, as far as they answer."""
        return all(key in self._reading and self._reading[key].done() for key in self.keys())

    def end_reading(self) -> None:
        """Nobody waits any more for what is being read."""
        for task in self._reading.values():
            task.cancel()
        self._reading.clear()

    async def _read(self, actor: VehicleActor) -> None:
        if known_return_height(actor.vehicle) is UNKNOWN:
            height = await read_return_height(actor)
            if height is not UNKNOWN:
                self._heights[actor.vehicle.key] = height
        fence = NAMES[actor.vehicle.family] if has_known_fence(actor.vehicle) else ()
        for name in (*actor.vehicle.abilities.return_params, *fence):
            if actor.vehicle.param(name) is None:
                await actor.params.get(name)

    # -- where they are

    def returning(self, actor: VehicleActor, now: float) -> Returning | None:
        """A member, where it is now, or was when that was known last; None if it or its home never was."""
        vehicle = actor.vehicle
        position, at = vehicle.timed_telemetry("position")
        home = vehicle.telemetry("home")
        placed = why_unplaced(position) is None
        if position is None or at is None or home is None or self.frame is None or not placed:
            seen = self._seen.get(vehicle.key)
            return None if seen is None else replace(seen[0], age_s=max(0.0, now - seen[1]))
        height, ceiling_m = known_return_height(vehicle), known_ceiling_m(vehicle)
        home_m = self.frame.from_geodetic(home["lat_deg"], home["lon_deg"], home["alt_amsl_m"])
        one = Returning(
            vehicle.key,
            vehicle.name,
            self._monitor.ways.footprint(actor),
            self.frame.from_geodetic(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"]),
            self._monitor.ways.soon_mps(vehicle, at, position["vel_enu_mps"]),
            home_m,
            self._heights.get(vehicle.key, UNKNOWN) if height is UNKNOWN else height,
            max(0.0, now - at),
            self._goal_m(vehicle.key),
            lands=self._lands(actor, now),
            ceiling_m=math.inf if ceiling_m is None else home_m[2] + ceiling_m - CLEARANCE_M,
        )
        self._seen[vehicle.key] = one, at
        return one

    async def followed(self, holding: Sequence[VehicleActor]) -> dict[int, list[str]]:
        """Which of these, that are to hold together, fly somewhere and are followed, by key: the names of those that
        fly to where each would come to rest now, as those that were sent somewhere together do. One of them that is
        followed flies on, and may follow another one. In turns with others."""
        frame, now = self.frame, self._loop.time()
        flying = (actor for actor in holding if self._monitor.ways.why_leaving(actor) is not None)
        rests = [one.place() for actor in flying if (one := self.returning(actor, now)) is not None]
        if frame is None or not rests:
            return {}
        ways = list[Way]()
        for n, (way, _) in enumerate(self._monitor.ways.present_ways(frame, ())):
            ways += [way] if leads_on(way) else []
            if n % AT_A_TURN == AT_A_TURN - 1:
                await asyncio.sleep(0)
        come = dict[int, list[Way]]()
        for rest in rests:
            others = (way for way in ways if way.key != rest.key and too_near(rest, way))
            come[rest.key] = [way for way in others if not too_near(rest, beginning(way))]
            await asyncio.sleep(0)
        found, held = dict[int, list[str]](), {actor.vehicle.key for actor in holding}
        while more := [key for key in come.keys() - found.keys() if any(way.key not in held for way in come[key])]:
            held.difference_update(more)
            found |= {key: list(dict.fromkeys(way.name for way in come[key] if way.key not in held)) for key in more}
        return found

    def below(self, actor: VehicleActor) -> list[str]:
        """Name those onto which it would come down where it is, in the air or on the ground."""
        now = self._loop.time()
        one = self.returning(actor, now)
        if one is None:
            return []
        down = replace(one.place(), legs=(column(one.here, one.home[2]),))
        others = [self.returning(other, now) for other in self.actors() if other is not actor]
        ways = [other.place() for other in others if other is not None]
        if self.frame is not None:
            ways += [way for way, _ in self._monitor.ways.present_ways(self.frame, self.keys(), parked=True)]
        return [way.name for way in ways if too_near(down, way)]


def _comes(actor: VehicleActor, modes: Set[str]) -> bool:
    """True if it is in one of these modes, or an order is being sent that may bring it down where it is."""
    return actor.vehicle.mode in modes or actor.runner.ledger.newest_in_progress in LANDING_ORDERS


async def read_return_height(actor: VehicleActor) -> ReturnHeight:
    """The return height by its parameters, read from the vehicle; `UNKNOWN`: it does not answer, or has none."""
    able = actor.vehicle.abilities
    heights = [await _param(actor, height) for height in able.return_heights]
    return return_height(heights, await _param(actor, able.return_climb) if able.return_climb else 0.0)


def frame_at(vehicle: Vehicle) -> EnuFrame:
    """A frame whose origin is below, or above, a vehicle whose place is known, at height zero."""
    position = vehicle.telemetry("position")
    assert position is not None
    return EnuFrame(Origin(position["lat_deg"], position["lon_deg"], 0.0))


async def _param(actor: VehicleActor, param: HeightParam) -> float | None:
    """The first of these parameters that the vehicle has, in metres; None: it has none, or does not answer."""
    for name, per_metre in param:
        outcome = await actor.params.get(name)
        if outcome.ok and outcome.number is not None:
            return float(outcome.number) / per_metre
    return None
