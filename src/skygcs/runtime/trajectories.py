"""Trajectories of the fleet: those that are loaded, and the groups that fly on one clock.

    loaded     in the daemon's memory, one for each vehicle, until `unload`; it survives the client that loaded it
    group      the vehicles of one `start`. They share a clock, so that what was planned for all of them at the same
               time stays so when they are paused, slowed down or aborted

All of a start begin, or none. A vehicle that leaves its group (an order, a pilot, the guard, a lost link) stops the
others on their paths: what is planned for them does not know that one stands still. Nobody but a person resumes.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import ClockState, Trajectory, TrajectoryClock
from skygcs.core.vehicle.flight_lock import FlightLock, Holder
from skygcs.core.vehicle.trajectory_flight import (
    OVER,
    LoadedTrajectory,
    StartTube,
    TrajectoryFlight,
    common_clock,
    require_speed,
)
from skygcs.errors import RefusedError, TrajectoryError
from skygcs.events import Event
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.vehicle_actor import VehicleActor

MAX_PIECES = 2_000
"""Most pieces of one vehicle: a quarter of an hour at two pieces a second. Its bounds take 1.5 ms for each piece of
degree 7."""

MAX_ALL_PIECES = 50_000
"""Most pieces of all vehicles: 75 MB at 1.45 kB for each piece of degree 7 (measured)."""

LARGE_PIECES = 4
"""From here on bounds are computed in a thread: control ticks on the event loop, 50 times a second."""

LATEST_START_S = 3600.0

MOST_PATH_POINTS, LEAST_PATH_POINTS, POINTS_EACH_PIECE = 400, 32, 4
"""Points of one trajectory in a picture: at most, at least, and for each piece."""

MOST_POINTS_OF_ALL = 20_000
"""Most points of all trajectories in one answer: some 400 kB."""


NO_TUBES: Mapping[str, StartTube] = {}


class DrawnPath(NamedTuple):
    """Points of a trajectory for a picture; ``number`` is never given twice."""

    number: int
    points_enu_m: tuple[tuple[float, float, float], ...]


@dataclass(eq=False)
class TrajectoryGroup:
    """The vehicles of one start, and their clock."""

    clock: TrajectoryClock
    flights: dict[VehicleActor, TrajectoryFlight]
    lock: FlightLock
    """Flight lock with which it was checked and begun."""
    state: ClockState = ClockState.WAITING
    """State of the clock that was reported last."""
    left: list[str] = field(default_factory=list)
    """Vehicles that left it."""
    plan: str | None = None
    """The plan it is a step of, which reports its changes; None: of no plan."""
    serials: dict[VehicleActor, int] = field(default_factory=dict)
    """The last effective order of each when it began."""

    def ordered_otherwise(self, actor: VehicleActor) -> str | None:
        """Return that another order took it, which under control leaves no other trace; None: none did."""
        serial = actor.runner.ledger.effective_serial
        return "it was ordered otherwise" if serial != self.serials.get(actor, serial) else None

    def following(self, actor: VehicleActor) -> bool:
        return actor.offboard.controller.flight is self.flights.get(actor)


class Trajectories:
    """Trajectories of one fleet. ``vehicles``: those there are now."""

    def __init__(
        self,
        vehicles: Callable[[], Collection[VehicleActor]],
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        separation: SeparationMonitor,
        locks: FlightLocks,
    ) -> None:
        self._vehicles = vehicles
        self._separation = separation
        self._locks = locks
        self._checking = asyncio.Lock()
        self._starting: FlightLock | None = None
        """Flight lock of the start whose distances are being checked."""
        self._loop = loop
        self._on_event = on_event
        self._loaded: dict[VehicleActor, LoadedTrajectory] = {}
        self._groups: list[TrajectoryGroup] = []
        self._drawn: WeakKeyDictionary[LoadedTrajectory, DrawnPath] = WeakKeyDictionary()
        self._numbers = itertools.count(1)

    # -- what is loaded

    async def load(self, actor: VehicleActor, trajectory: Trajectory, name: str) -> Outcome:
        """Keep a trajectory for a vehicle, in place of the one before. Refused while it follows one."""
        if (refusal := self._load_refusal(actor, trajectory)) is not None:
            return Outcome.refused(refusal)
        try:
            if len(trajectory.pieces) < LARGE_PIECES:
                loaded = LoadedTrajectory(trajectory, name)
            else:
                loaded = await asyncio.to_thread(LoadedTrajectory, trajectory, name)
        except TrajectoryError as error:
            return Outcome.refused(str(error))
        if (refusal := self._load_refusal(actor, trajectory)) is not None:
            return Outcome.refused(refusal)
        self._loaded[actor] = loaded
        peaks = loaded.peaks
        text = (
            f"{name}: {len(trajectory.pieces)} pieces, {trajectory.duration_s:.1f} s, up to "
            f"{peaks.speed_mps.at_most:.2f} m/s and {peaks.acceleration_mps2.at_most:.2f} m/s²"
        )
        return Outcome(True, "accepted", text)

    def _load_refusal(self, actor: VehicleActor, trajectory: Trajectory) -> str | None:
        """Why it cannot be kept; None if it can."""
        count = len(trajectory.pieces)
        others = sum(len(one.trajectory.pieces) for key, one in self._loaded.items() if key is not actor)
        if count > MAX_PIECES:
            return f"it has {count} pieces; the most for one vehicle is {MAX_PIECES}"
        if others + count > MAX_ALL_PIECES:
            return f"all vehicles together have {others} pieces already; with {count} more it is above {MAX_ALL_PIECES}"
        if actor.vehicle.replayed:
            return "it is a replay"
        if actor.offboard.controller.flight is not None:
            return "it follows a trajectory: abort that first"
        if actor not in self._vehicles():
            return "it was forgotten"
        return None

    def unload(self, actors: Sequence[VehicleActor]) -> dict[str, Outcome]:
        """Forget their trajectories. Refused for one that follows its own."""
        outcomes = {}
        for actor in actors:
            if actor.offboard.controller.flight is not None:
                outcomes[actor.name] = Outcome.refused("it follows its trajectory: abort that first")
            elif self._loaded.pop(actor, None) is None:
                outcomes[actor.name] = Outcome.refused("no trajectory is loaded")
            else:
                outcomes[actor.name] = Outcome(True, "accepted", "unloaded")
        return outcomes

    # -- flight

    def lead_s(self, actors: Iterable[VehicleActor]) -> float:
        """How long before its time a start or an order to the clock must be given: above 0 where a companion flies."""
        return max((actor.offboard.lead_s for actor in actors), default=0.0)

    async def prepare(self, actors: Sequence[VehicleActor]) -> dict[str, Outcome]:
        """Bring what is loaded to the companions that fly it; outcomes of refusal if that is not possible for all."""
        chosen, refused = self._chosen(actors)
        for actor, loaded in chosen.items():
            if (why := await actor.offboard.prepare(loaded)) is not None:
                refused[actor] = why
        return self._none_starts(actors, refused) if refused else {}

    def start(self, actors: Sequence[VehicleActor], at_s: float, speed_factor: float) -> dict[str, Outcome]:
        """Let all of them begin at ``at_s`` of the daemon's clock, or none. Distances are the caller's matter."""
        chosen, refused = self._chosen(actors)
        lock = None if refused else self._lock_of(chosen)
        return self._start(actors, chosen, refused, at_s, speed_factor, lock)

    def _start(
        self,
        actors: Sequence[VehicleActor],
        chosen: Mapping[VehicleActor, LoadedTrajectory],
        refused: dict[VehicleActor, str],
        at_s: float,
        speed_factor: float,
        lock: FlightLock | None,
    ) -> dict[str, Outcome]:
        at_s = max(at_s, self._loop.time() + self.lead_s(actors)) if self.lead_s(actors) > 0.0 else at_s
        if not refused and lock is None:
            refused = dict.fromkeys(chosen, "the fleet has no origin yet")
        if not refused and lock is not None:
            begun = self.begin(chosen, at_s, speed_factor, lock)
            if isinstance(begun, TrajectoryGroup):
                text = f"begins in {at_s - self._loop.time():.1f} s"
                return {actor.name: Outcome(True, "accepted", text) for actor in actors}
            refused = begun
        return self._none_starts(actors, refused)

    async def start_apart(self, actors: Sequence[VehicleActor], at_s: float, speed_factor: float) -> dict[str, Outcome]:
        """Start like `start`, if none of them would come too close to another vehicle. A start that comes due during
        the check begins at its end. One check at a time: the next one knows what the one before let start."""
        began = self._loop.time()
        async with self._checking:
            at_s = max(at_s, self._loop.time()) if at_s >= began else at_s
            chosen, refused = self._chosen(actors)
            lock = None if refused else self._lock_of(chosen)
            clock = None if lock is None else self._clock(chosen, at_s, speed_factor, lock)
            if isinstance(clock, TrajectoryClock):
                self._starting = lock
                try:
                    refused = await self._separation.trajectory_refusals(chosen, clock)
                finally:
                    self._starting = None
                changed = [actor for actor in actors if self._loaded.get(actor) is not chosen[actor]]
                refused |= dict.fromkeys(changed, "its trajectory was changed while it was checked")
            elif clock is not None:
                refused = clock
            if refused:
                return self._none_starts(actors, refused)
            return self._start(actors, chosen, {}, max(at_s, self._loop.time()), speed_factor, lock)

    def _lock_of(self, chosen: Mapping[VehicleActor, LoadedTrajectory]) -> FlightLock | None:
        """The lock of these vehicles, held while they fly; None without an origin."""
        first, loaded = next(iter(chosen.items()), (None, None))
        if first is None or loaded is None or first.vehicle.origin is None:
            return None
        flown = [(actor.vehicle, actor.config.control) for actor in chosen]
        lock = self._locks.make(Holder.TRAJECTORY, loaded.name, first.vehicle.origin, flown)
        return self._locks.take(lock, lambda: self._flown_by(lock))

    def _flown_by(self, lock: FlightLock) -> bool:
        """True if a group flies by this lock, or is about to."""
        now = self._loop.time()
        groups = (group for group in self._groups if group.lock is lock and group.flights)
        return self._starting is lock or any(group.clock.at(now).state not in OVER for group in groups)

    def _chosen(
        self, actors: Sequence[VehicleActor]
    ) -> tuple[dict[VehicleActor, LoadedTrajectory], dict[VehicleActor, str]]:
        """The trajectory of each, and why others do not start: none is loaded, or another site commands them."""
        missing = "no trajectory is loaded: `skygcs-cli trajectory load FILE {}` first"
        refused = {actor: missing.format(actor.name) for actor in actors if actor not in self._loaded}
        refused |= {actor: why for actor in actors if (why := actor.authority_refusal()) is not None}
        return {actor: self._loaded[actor] for actor in actors if actor not in refused}, refused

    def _clock(
        self,
        chosen: Mapping[VehicleActor, LoadedTrajectory],
        at_s: float,
        speed_factor: float,
        lock: FlightLock,
        tubes: Mapping[str, StartTube] = NO_TUBES,
    ) -> TrajectoryClock | dict[VehicleActor, str]:
        """The started clock of a start, or why it must not be, by vehicle."""
        found = {
            actor: actor.runner.precedence.superseded()
            or actor.offboard.trajectory_refusal(loaded, speed_factor, lock, tubes.get(actor.name))
            for actor, loaded in chosen.items()
        }
        refused = {actor: why for actor, why in found.items() if why is not None}
        if refused:
            return refused
        try:
            brake = min(lock.member(actor.name).limits.brake_mps2 for actor in chosen)
            clock = common_clock(list(chosen.values()), brake, speed_factor, self.lead_s(chosen))
            clock.start(self._loop.time(), at_s)
        except (RefusedError, TrajectoryError) as error:
            return dict.fromkeys(chosen, str(error))
        return clock

    def begin(
        self,
        chosen: Mapping[VehicleActor, LoadedTrajectory],
        at_s: float,
        speed_factor: float,
        lock: FlightLock,
        tubes: Mapping[str, StartTube] = NO_TUBES,
    ) -> TrajectoryGroup | dict[VehicleActor, str]:
        """Let all of them begin these trajectories, or none: then why not, by vehicle. ``lock``: of the start, or of
        the plan it belongs to, which reports what becomes of it and alone may let it go on. ``tubes``: how far from
        its begin each may be, where a certificate says so."""
        now, clock = self._loop.time(), self._clock(chosen, at_s, speed_factor, lock, tubes)
        if not isinstance(clock, TrajectoryClock):
            return clock
        flights = {actor: actor.offboard.follow_trajectory(loaded, clock, lock) for actor, loaded in chosen.items()}
        plan = lock.title if lock.holder is Holder.PLAN else None
        group = TrajectoryGroup(clock, flights, lock, plan=plan)
        self._groups.append(group)
        for actor, flight in flights.items():
            actor.runner.precedence.note_effect()
            actor.stream.ended("a trajectory was started")
            group.serials[actor] = actor.runner.ledger.effective_serial
            text = (
                f"{flight.loaded.name} begins in {at_s - now:.1f} s and takes {flight.duration_s / speed_factor:.1f} s"
            )
            self._publish(group, actor, text, ClockState.WAITING)
        return group

    def _none_starts(self, actors: Sequence[VehicleActor], refused: dict[VehicleActor, str]) -> dict[str, Outcome]:
        first = ", ".join(actor.name for actor in list(refused)[:5])
        return {
            actor.name: Outcome.refused(refused.get(actor) or f"all start together, and {first} cannot")
            for actor in actors
        }

    def pause(self, actors: Sequence[VehicleActor]) -> dict[str, Outcome]:
        """Stop their groups on their paths."""
        return self._order(actors, lambda group, now: group.clock.pause(now), "stops on its path")

    def pause_plans(self) -> None:
        """Stop the groups of plans on their paths: nobody checks their flights any more."""
        now = self._loop.time()
        for group in self._groups:
            if group.plan is not None:
                _stop(group, now)

    def resume(self, actors: Sequence[VehicleActor]) -> dict[str, Outcome]:
        """Let their groups go on; those that left a group stay out of it."""

        def resume(group: TrajectoryGroup, now: float) -> None:
            _require_no_plan(group)
            group.clock.resume(now)

        return self._order(actors, resume, "goes on")

    def abort(self, actors: Sequence[VehicleActor]) -> dict[str, Outcome]:
        """Stop their groups on their paths, for good."""
        return self._order(actors, lambda group, now: group.clock.abort(now), "stops on its path, for good")

    def set_speed(self, actors: Sequence[VehicleActor], speed_factor: float) -> dict[str, Outcome]:
        """Fly their groups at this multiple of the planned speed. Refused where a limit would be exceeded."""

        def change(group: TrajectoryGroup, now: float) -> None:
            _require_no_plan(group)
            limits = [group.lock.member(actor.name).limits for actor in group.flights]
            require_speed(list(group.flights.values()), limits, speed_factor)
            group.clock.set_speed(now, speed_factor)

        return self._order(actors, change, f"flies at {speed_factor:g} times the planned speed")

    def _order(
        self, actors: Sequence[VehicleActor], order: Callable[[TrajectoryGroup, float], None], done: str
    ) -> dict[str, Outcome]:
        """Give an order to the groups of these vehicles; the outcome of every member of them."""
        now, outcomes = self._loop.time(), dict[str, Outcome]()
        meant: list[TrajectoryGroup] = []
        for actor in actors:
            group = self._group_of(actor)
            if group is None:
                outcomes[actor.name] = Outcome.refused(actor.authority_refusal() or "it follows no trajectory")
            elif group not in meant:
                meant.append(group)
        for group in meant:
            try:
                order(group, now)
                outcome = Outcome(True, "accepted", done)
            except RefusedError as error:
                outcome = Outcome.refused(str(error))
            outcomes.update({actor.name: outcome for actor in group.flights if group.following(actor)})
            self._report(group, now)
        return outcomes

    def _group_of(self, actor: VehicleActor) -> TrajectoryGroup | None:
        return next((group for group in self._groups if actor in group.flights and group.following(actor)), None)

    # -- as time comes

    def tick(self, now: float) -> None:
        """Ten times a second: vehicles that left, and what the clocks have come to."""
        for group in list(self._groups):
            if group.clock.at(now).state not in OVER:
                self._see_who_left(group, now)
            self._report(group, now)
            if not group.flights or group.clock.at(now).state in OVER:
                self._groups.remove(group)
        if self._loaded:
            there = set(self._vehicles())
            for actor in [key for key in self._loaded if key not in there]:
                del self._loaded[actor]

    def _see_who_left(self, group: TrajectoryGroup, now: float) -> None:
        gone = [actor for actor in group.flights if not group.following(actor)]
        for actor in gone:
            del group.flights[actor]
            group.left.append(actor.name)
            controller = actor.offboard.controller
            why = "; ".join(controller.reasons) or f"control is {controller.state.value}"
            why = actor.offboard.successor or group.ordered_otherwise(actor) or why
            self._publish(group, actor, f"it left its trajectory: {why}", ClockState.ABORTED)
        if not gone or not group.flights:
            return
        names = ", ".join(actor.name for actor in gone)
        _stop(group, now)
        for actor in group.flights:
            text = f"it stops on its path, because {names} left: resume or abort the trajectory"
            self._publish(group, actor, text, group.clock.at(now).state)

    def _report(self, group: TrajectoryGroup, now: float) -> None:
        """Publish a change of the clock's state, once for each vehicle."""
        state = group.clock.at(now).state
        if state is group.state:
            return
        group.state = state
        for actor, flight in group.flights.items():
            self._publish(group, actor, f"{flight.loaded.name} is {state.value}", state)

    def _publish(self, group: TrajectoryGroup, actor: VehicleActor, text: str, state: ClockState) -> None:
        if group.plan is not None:
            return  # a step of a plan is one change for all of them
        loaded = self._loaded.get(actor)
        data = {"state": state.value, "name": None if loaded is None else loaded.name}
        self._on_event(Event("trajectory", actor.name, actor.sysid, text, data))

    # -- what is shown

    async def paths(self, actors: Sequence[VehicleActor], known: str | None) -> tuple[str, list[dict[str, Any]] | None]:
        """(key, paths) of what is loaded or flown, as points at equal times; None for the paths if ``known`` is the
        key. Points are computed once for each trajectory, in a thread."""
        shown = []
        for actor in actors:
            flight = actor.offboard.controller.flight
            loaded = self._loaded.get(actor) if flight is None else flight.loaded
            if loaded is not None:
                shown.append((actor.name, loaded, flight is not None))
        for _, loaded, _ in shown:
            if loaded not in self._drawn:
                points = await asyncio.to_thread(path_points, loaded.trajectory)
                self._drawn[loaded] = DrawnPath(next(self._numbers), points)
        listed = [(name, self._drawn[loaded].number, flown) for name, loaded, flown in shown]
        key = hashlib.blake2s(repr(listed).encode(), digest_size=8).hexdigest()
        if key == known:
            return key, None
        step = max(1, math.ceil(sum(len(self._drawn[one].points_enu_m) for _, one, _ in shown) / MOST_POINTS_OF_ALL))
        return key, [
            {"vehicle": name, "name": loaded.name, "flown": flown, "points_enu_m": _thinned(self._drawn[loaded], step)}
            for name, loaded, flown in shown
        ]

    def status(self, actors: Sequence[VehicleActor]) -> list[dict[str, Any]]:
        """Trajectories that are loaded or flown, by vehicle; vehicles with neither are left out."""
        now, found = self._loop.time(), []
        for actor in actors:
            loaded, flight = self._loaded.get(actor), actor.offboard.controller.flight
            if loaded is None and flight is None:
                continue
            group = self._group_of(actor)
            shown = flight.loaded if flight is not None else loaded
            assert shown is not None
            found.append(
                {
                    "vehicle": actor.name,
                    "name": shown.name,
                    "pieces": len(shown.trajectory.pieces),
                    "duration_s": round(shown.trajectory.duration_s, 3),
                    "start_enu_m": [round(x, 3) for x in shown.trajectory.start_enu_m],
                    "speed_max_mps": _finite(shown.peaks.speed_mps.at_most),
                    "acceleration_max_mps2": _finite(shown.peaks.acceleration_mps2.at_most),
                    "box_m": [[round(x, 3) for x in side] for side in shown.box],
                    "with": [] if group is None else [other.name for other in group.flights if other is not actor],
                    "left": [] if group is None else list(group.left),
                    "flight": None if flight is None else _rounded(flight.status(now)),
                }
            )
        return found


def path_points(trajectory: Trajectory) -> tuple[tuple[float, float, float], ...]:
    """Places at equal times, to the centimetre."""
    count = min(MOST_PATH_POINTS, max(LEAST_PATH_POINTS, POINTS_EACH_PIECE * len(trajectory.pieces)))
    places = (trajectory.at(trajectory.duration_s * k / (count - 1)).pos_enu_m for k in range(count))
    return tuple((round(x, 2), round(y, 2), round(up, 2)) for x, y, up in places)


def _thinned(drawn: DrawnPath, step: int) -> list[tuple[float, float, float]]:
    """Every ``step``th point, and the last."""
    points = drawn.points_enu_m
    return [*points[:-1:step], points[-1]]


def _stop(group: TrajectoryGroup, now: float) -> None:
    """Stop a group on its path, unless it has ended or is about to."""
    with contextlib.suppress(RefusedError):
        group.clock.pause(now)


def _require_no_plan(group: TrajectoryGroup) -> None:
    """Raise RefusedError for the vehicles of a plan: what is faster than certified, or goes on after a stop, is decided
    there."""
    if group.plan is not None:
        raise RefusedError(f"it flies the plan {group.plan}: `skygcs-cli plan resume` and `plan speed` are for that")


def _finite(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _rounded(status: dict[str, Any]) -> dict[str, Any]:
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in status.items()}
