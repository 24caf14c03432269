"""Runs the monitor (`core.monitor`) over a fleet: evaluates it a few times a second, publishes its events, carries out
the holds that it asks for, and checks orders before they are sent."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from skygcs.config.vehicle_tables import MonitorConfig
from skygcs.core.geo import EnuFrame
from skygcs.core.monitor.approach import REST
from skygcs.core.monitor.conflict_levels import HORIZON_S
from skygcs.core.monitor.mission_ways import (
    MissionRun,
    landing_distance_m,
)
from skygcs.core.monitor.monitor import KIND, HoldRequest, Monitor
from skygcs.core.monitor.order_check import (
    Course,
    Mover,
    Other,
    climb_out_end,
    find_conflicts,
    goto_conflict,
    left_s,
    meant,
    mover_frame,
    of_track,
    on_trajectory,
    places_in,
    places_on,
    setpoint_conflict,
    space_conflict,
    takeoff_conflict,
)
from skygcs.core.monitor.tracks import (
    Member,
    Place,
    Track,
    way_to,
)
from skygcs.core.monitor.ways import (
    Way,
    beginning,
    conflict_text,
    distance_m,
    find_way_conflicts,
    needed_m,
    standing,
    too_near,
)
from skygcs.core.separation import pair_margin
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.vehicle.frames import Setpoint
from skygcs.core.vehicle.orders import FORCE_HINT
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.task_set import OWN, TaskSet, in_short_turns
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent
from skygcs.runtime.vehicle_ways import VehicleWays, braking

PERIOD_S = 0.25
"""From one evaluation to the next: a position comes 2 to 10 times a second."""

LONGEST_PERIOD_S = 1.0
"""With so many vehicles that an evaluation takes long, the monitor takes at most `SHARE` of a core, and is never slower
than this."""

SHARE = 0.1

ALIKE_MPS = 1.5
"""Two whose velocities differ by less fly alike: it comes of noise and gusts, and is braked within 1.5 m."""

MAX_HOLDS = 64
"""Orders to hold in progress at one time; each lasts seconds."""


class SeparationMonitor:
    """`run` is the task; the rest may be called at any time. Without it, or with mode "off", every order passes."""

    def __init__(
        self,
        config: MonitorConfig,
        actors: Mapping[int, VehicleActor],
        loop: asyncio.AbstractEventLoop,
        on_event: OnEvent,
    ) -> None:
        """``actors``: the fleet's vehicles by sysid << 8 | compid."""
        self.mode = config.mode
        self.monitor = Monitor(acting=config.mode == "acting")
        self.took_s = 0.0
        """How long the last evaluation took, the turns of others excluded."""
        self.longest_turn_s = 0.0
        """The longest part of an evaluation for which the loop had to wait."""
        self.ways = VehicleWays(actors, self.monitor.tracks, loop, off=config.mode == "off")
        self._actors = actors
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event)

    # -- the watch

    async def run(self) -> None:
        """Evaluate until it is cancelled. A fault behind one evaluation is reported and does not end the watch."""
        if self.mode == "off":
            return
        reported: str | None = None
        while True:
            try:
                await self.evaluate()
                reported = None
            except Exception as error:
                if repr(error) != reported:  # the same one comes again four times a second
                    self._on_event(Event("fault", None, None, f"the monitor failed inside skygcs: {error!r}", {}))
                reported = repr(error)
            await asyncio.sleep(min(max(PERIOD_S, self.took_s / SHARE), LONGEST_PERIOD_S))

    async def evaluate(self) -> None:
        """Evaluate once. Others get their turn every `TURN_S` of it."""
        self.took_s, self.longest_turn_s = await in_short_turns(self._work())

    def _work(self) -> Iterator[None]:
        """One evaluation and what comes of it; yields where others may have their turn. Holds come first."""
        yield from self.monitor.evaluate(self._members(), self._loop.time())
        events, self.monitor.events = self.monitor.events, []
        holds, self.monitor.holds = self.monitor.holds, []
        for hold in holds:
            self._hold(hold)
            yield
        for event in events:
            self._on_event(event)
            yield
        self.ways.forget_gone()

    def _members(self) -> Iterator[Member]:
        for key, actor in list(self._actors.items()):
            footprint, priority = self.ways.settings(key, actor)
            self.ways.trajectory_space(actor)  # so that no order has to wait until those of a fleet are made
            yield Member(actor.vehicle, footprint, priority, self.ways.destination(key), self.ways.foreseen(actor))

    # -- holds

    def _hold(self, request: HoldRequest) -> None:
        actor = self._actors.get(request.key)
        if actor is None or actor.name != request.name or len(self._tasks) >= MAX_HOLDS:
            self.monitor.counters.holds_failed += 1
            self.monitor.hold_failed(request, self._loop.time())
            return
        data = {**request.data, "order": "hold", "with": request.other}
        self._on_event(Event(KIND, actor.name, actor.sysid, request.text, data))
        self._tasks.start(self._carry_out(actor, request), f"hold {actor.name} for its distance", OWN)

    async def _carry_out(self, actor: VehicleActor, request: HoldRequest) -> None:
        outcome = await actor.hold()
        if not outcome.ok:
            self.monitor.counters.holds_failed += 1
            if outcome.result != "cancelled":  # not where a newer order replaced it
                self.monitor.hold_failed(request, self._loop.time())
        text = f"{actor.name}, ordered to hold for its distance to {request.other}: {outcome.message}"
        data = {**request.data, "order": "hold", "with": request.other, "outcome": outcome.as_dict()}
        self._on_event(Event(KIND, actor.name, actor.sysid, text, data))

    def close(self) -> None:
        """Cancel holds in progress."""
        self._tasks.close()

    # -- orders

    def goto_refusal(
        self, vehicle: Vehicle, to: Place, together: frozenset[int], *, only: frozenset[int] | None = None
    ) -> str | None:
        """Why it should not be sent there now; None: nothing is in the way. ``together``: keys of vehicles that are
        sent somewhere by the same order or program, which keeps them apart. ``only``: look at these others only."""
        mover = self.ways.mover(vehicle)
        if mover is None:
            return None
        conflict = goto_conflict(mover, to, self._others(together, only=only), self._loop.time())
        return self._refusal(conflict or self._crosses(mover, to, together, only=only))

    def unlike_refusals(self, vehicles: Sequence[Vehicle]) -> dict[int, str]:
        """Which of these, that are sent somewhere together, should not be, by key, and why: before it turns, one would
        come too near another that flies otherwise. Those that fly alike keep their distances."""
        movers = [mover for vehicle in vehicles if (mover := self.ways.mover(vehicle)) is not None]
        flown = {vehicle.key: (vehicle.telemetry("position") or {}).get("vel_enu_mps", REST) for vehicle in vehicles}
        if all(math.dist(flown[movers[0].key], flown[one.key]) <= ALIKE_MPS / 2.0 for one in movers):
            movers.clear()  # most of them stand, or fly on side by side
        ways = [(mover, _brakes(mover, self.ways.frame_of(movers[0]))) for mover in movers]
        ways.sort(key=lambda one: one[1].box)  # from west to east, so that few are compared
        widest_m = max((needed_m(way, way) for _, way in ways), default=0.0)
        found = dict[int, str]()
        for n, (one, way) in enumerate(ways):
            for other, theirs in itertools.islice(ways, n + 1, None):
                if theirs.box[0] > way.box[1] + widest_m:
                    break
                unlike = math.dist(flown[one.key], flown[other.key]) > ALIKE_MPS
                if not unlike or not too_near(way, theirs) or too_near(beginning(way), beginning(theirs)):
                    continue
                for mover, a, b in ((one, way, theirs), (other, theirs, way)):
                    if mover.turns_m and mover.key not in found:
                        text = f"{conflict_text(a, b, distance_m(a, b))}, before it has turned there"
                        found[mover.key] = self._refusal(text) or text
        return found

    def takeoff_refusal(self, vehicle: Vehicle, height_m: float) -> str | None:
        """Why it should not take off to this height now."""
        mover = self.ways.mover(vehicle)
        if mover is None:
            return None
        others, now = self._others(frozenset()), self._loop.time()
        ahead = vehicle.telemetry("attitude") if vehicle.abilities.takeoff.is_ahead else None
        if ahead is not None:
            to = climb_out_end(mover, height_m, math.radians(ahead["yaw_deg"]))
            conflict = goto_conflict(mover, to, others, now)
        else:
            to = mover_frame(mover).to_geodetic(0.0, 0.0, height_m)
            conflict = takeoff_conflict(mover, height_m, others, now)
        return self._refusal(conflict or self._crosses(mover, to, strict=ahead is None))

    def setpoint_refusal(self, vehicle: Vehicle, setpoint: Setpoint, together: frozenset[int]) -> str | None:
        """Why this setpoint of a stream should not be followed. ``together``: as for `goto_refusal`."""
        mover = self.ways.unmoved(vehicle)
        if mover is None:
            return None
        place, velocity = meant(mover, setpoint)
        others = self._others(together, sent=False)
        return self._refusal(setpoint_conflict(mover, place, velocity, others, self._loop.time()))

    async def trajectory_refusals(
        self, starting: Mapping[VehicleActor, LoadedTrajectory], clock: TrajectoryClock
    ) -> dict[VehicleActor, str]:
        """Which of them should not follow these trajectories on this clock, which is started, and why. They are
        compared with all others and with each other; others get their turn every `TURN_S`."""
        origin = next((actor.vehicle.origin for actor in starting), None)
        if self.mode == "off" or origin is None:
            return {}
        now, frame = self._loop.time(), EnuFrame(origin)
        # trajectories that are about to start
        movers, end_s = list[Course](), 0.0
        others: list[Course | Way] = []
        for actor, loaded in starting.items():
            movers.append(
                on_trajectory(actor.vehicle, self.ways.footprint(actor), loaded, clock, places_on(loaded, clock, now))
            )
            end_s = max(end_s, left_s(clock, now))
        # all other vehicles: on trajectories of their own, or on their courses
        for key, track in {**self.monitor.tracks.lost, **self.monitor.tracks.tracks}.items():
            other = self._actors.get(key)
            if other is None or other in starting:
                continue
            flight, local = other.offboard.controller.flight, other.offboard.controller.frame
            if flight is None or local is None:
                if any(one.destination is None for one in self._present(track, sent=True)):
                    others.append(of_track(track, frame, now))
                if self.ways.goes_to(other, track) is not None:
                    others.append(self.ways.way_left(other, track, frame))
                else:
                    others += self.ways.goes_on(other, track, frame)
                others += self.ways.begins(other, track, frame)
                continue
            at = places_in(frame, local, flight, now)
            others.append(on_trajectory(other.vehicle, track.footprint, flight.loaded, flight.clock, at))
            end_s = max(end_s, left_s(flight.clock, now))
        # compare them, in turns with other tasks
        found: dict[int, str] = {}
        await in_short_turns(find_conflicts(movers, others, end_s, found))
        refused = ((actor, self._refusal(found.get(actor.vehicle.key))) for actor in starting)
        return {actor: why for actor, why in refused if why is not None}

    async def mission_refusals(self, starting: Mapping[VehicleActor, MissionRun]) -> dict[VehicleActor, str]:
        """Which of these missions, that begin or go on now, lead too near each other's, a mission that another vehicle
        flies, or a vehicle that flies otherwise, or end on one that stands, and why. They are compared as space, in
        turns with others."""
        self.ways.begin_missions(starting)
        ways, frame = await self._mission_ways(starting), self.monitor.tracks.frame
        others = list[Way]()
        for key, track in {**self.monitor.tracks.lost, **self.monitor.tracks.tracks}.items():
            actor = self._actors.get(key)
            waits = track.parked and self.ways.destination(key) is None
            if actor is None or actor in starting or waits or frame is None:
                continue
            others.append(self.ways.flown_mission(actor, frame) or self.ways.way_left(actor, track, frame))
            others += self.ways.begins(actor, track, frame)
        refused = await self._way_refusals(ways, others) | self._landing_refusals(ways)
        for actor in refused:
            self.ways.not_begun(actor)
        return refused

    def _landing_refusals(self, ways: Mapping[VehicleActor, Way]) -> dict[VehicleActor, str]:
        """Which of these ways come down on a vehicle that stands, or lead low over it, and why that is refused. The way
        up may begin beside it: launch pads are often near each other."""
        refused, frame = dict[VehicleActor, str](), self.monitor.tracks.frame
        if frame is None:
            return refused
        tracks = [track for track in self.monitor.tracks.tracks.values() if track.parked]
        for actor, way in ways.items():
            home = actor.vehicle.telemetry("home")
            at_home = (
                way.legs[0].begin if home is None else frame.from_geodetic(home["lat_deg"], home["lon_deg"], 0.0)[:2]
            )
            for track in tracks:
                if track.key == way.key:
                    continue
                off_m = landing_distance_m(way, frame.from_ecef(track.ecef_m)[:2], at_home)
                if off_m < pair_margin(way.footprint, track.footprint).total_m:
                    where = f"{off_m:.1f} m from {track.name}, which stands there"
                    refused[actor] = f"{way.name} would land {where}; {FORCE_HINT}"
                parked = Way(track.key, track.name, track.footprint, standing(frame.from_ecef(track.ecef_m)))
                over = replace(way, legs=tuple(leg for leg in way.legs if leg.begin != leg.end))
                if over.legs and too_near(over, parked) and not too_near(beginning(way), parked):
                    text = conflict_text(over, replace(parked, doing="parked"), distance_m(over, parked))
                    refused.setdefault(actor, f"{text}; {FORCE_HINT}")
        return refused

    async def mission_overlaps(self, runs: Mapping[VehicleActor, MissionRun]) -> dict[VehicleActor, str]:
        """Which of these missions, that are to be flown at the same time, lead too near another of them, and why; also
        one of a vehicle whose way is not known. What else flies is compared when they start: `mission_refusals`."""
        if self.mode == "off" or len(runs) < 2:
            return {}
        ways = await self._mission_ways(runs)
        unknown = "where it is is not known, so it is not known whom its mission comes near"
        refused = {actor: f"{unknown}; {FORCE_HINT}" for actor in runs if actor not in ways}
        return refused | await self._way_refusals(ways, [])

    async def _mission_ways(self, runs: Mapping[VehicleActor, MissionRun]) -> dict[VehicleActor, Way]:
        """The ways of missions, of those that are known; others get their turn after each of them."""
        ways: dict[VehicleActor, Way] = {}
        for actor, run in runs.items():
            if (frame := self.monitor.tracks.frame) and (way := self.ways.mission_way(actor, run, frame)):
                ways[actor] = way
            await asyncio.sleep(0)
        return ways

    async def _way_refusals(self, ways: Mapping[VehicleActor, Way], others: Sequence[Way]) -> dict[VehicleActor, str]:
        """Which of these ways lead too near each other or to others, in turns with other tasks."""
        found: dict[int, str] = {}
        await in_short_turns(find_way_conflicts(list(ways.values()), others, found))
        refused = ((actor, self._refusal(found.get(way.key))) for actor, way in ways.items())
        return {actor: why for actor, why in refused if why is not None}

    def _crosses(
        self,
        mover: Mover,
        to: Place,
        together: frozenset[int] = frozenset(),
        *,
        only: frozenset[int] | None = None,
        strict: bool = False,
    ) -> str | None:
        """With which way of another vehicle the straight way to a place conflicts, in words; None: with none."""
        ways = self.ways.near(mover, to, together, only=only)
        return space_conflict(mover, to, ways, strict=strict, frame=self.ways.frame_of(mover))

    def _others(
        self, together: frozenset[int], *, sent: bool = True, only: frozenset[int] | None = None
    ) -> Iterator[Other]:
        """``sent``: for an order that goes on by itself, so where others were sent and who is lost counts, too."""
        tracks, lost = self.monitor.tracks.tracks, self.monitor.tracks.lost
        for key in tracks if only is None else only & tracks.keys():
            if key not in together:
                yield from self._present(tracks[key], sent=sent)
        for key in (lost if only is None else only & lost.keys()) if sent else ():
            if key not in together and key in self._actors:
                yield Other(lost[key])

    def _present(self, track: Track, *, sent: bool) -> Iterator[Other]:
        """A vehicle where it is, and where it was ``sent``, if it was; for a stream where it flies by now, on and up to
        its stop there. Only what is seen flying there has left its place: it may not have taken the order, or another
        station, or setpoints, may have moved it since."""
        destination, frame = self.ways.destination(track.key), self.monitor.tracks.frame
        if destination is None or frame is None or track.parked or track.lost:
            yield Other(track)
            if sent and destination is not None:
                yield Other(track, destination)
            return
        goal_m = frame.from_geodetic(*destination)
        way = way_to(track, track.velocity_mps, goal_m)
        if not sent:
            yield Other(track)
            if way is not None and not track.circle_m:
                yield Other(track, stops_in_s=way.duration_s)
            return
        if way is None and math.dist(track.place_m, goal_m) > track.circle_m:
            yield Other(track, stays_yet=True)
        yield Other(track, destination)

    def _refusal(self, conflict: str | None) -> str | None:
        counters = self.monitor.counters
        counters.orders_checked += 1
        if conflict is None:
            return None
        counters.orders_refused += 1
        return f"{conflict}; {FORCE_HINT}"

    # -- state

    def of(self, key: int) -> dict[str, Any] | None:
        """The most urgent conflict of a vehicle, for its state; None: none."""
        return self.monitor.of(key)

    def status(self) -> dict[str, Any]:
        """Status as monitor.status answers it."""
        monitor = self.monitor
        tracks = monitor.tracks
        return {
            "mode": self.mode,
            "horizon_s": HORIZON_S,
            "watched": len(tracks.tracks),
            "flying": sum(not track.parked for track in tracks.tracks.values()),
            "unwatched": [
                {"vehicle": name, "reason": why, "flying": flying} for name, why, flying in tracks.unwatched.values()
            ],
            "conflicts": [pair.describe() for pair in monitor.conflicts()],
            "counters": asdict(monitor.counters),
            "took_s": round(self.took_s, 5),
            "longest_turn_s": round(self.longest_turn_s, 5),
        }


def _brakes(mover: Mover, frame: EnuFrame) -> Way:
    """The space of one until it turns to another place."""
    legs = braking(frame.from_geodetic(*mover.here), mover.velocity_mps, mover.turns_m)
    return Way(mover.key, mover.name, mover.footprint, legs)
