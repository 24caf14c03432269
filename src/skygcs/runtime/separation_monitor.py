"""Runs the monitor (`core.monitor`) over a fleet: evaluates it a few times a second, publishes its events, carries out
the holds that it asks for, and checks orders before they are sent."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, NamedTuple

from skygcs.config.models import VehicleConfig
from skygcs.config.vehicle_tables import MonitorConfig
from skygcs.core.geo import EnuFrame, Origin, ecef, world_from_enu
from skygcs.core.monitor.approach import REST, Vector
from skygcs.core.monitor.conflict_levels import COMING_HOME, HORIZON_S, LANDING, NOISE_MPS
from skygcs.core.monitor.departures import STANDS_MPS, UNKNOWN, Returning, known_return_height
from skygcs.core.monitor.mission_ways import (
    MissionBox,
    MissionOf,
    MissionRun,
    MissionSpace,
    landing_distance_m,
    mission_box,
)
from skygcs.core.monitor.monitor import KIND, HoldRequest, Monitor
from skygcs.core.monitor.order_check import (
    FORGET,
    FRESH_S,
    Course,
    Mover,
    Other,
    TrajectorySpace,
    climb_out_end,
    find_conflicts,
    goto_conflict,
    holding_disc,
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
    PLAN_STEP_S,
    TRACK_SILENT_S,
    USUAL_BRAKE_MPS2,
    Member,
    Place,
    Sample,
    Track,
    arrives,
    is_flying,
    soon_mps,
    way_to,
)
from skygcs.core.monitor.ways import (
    Leg,
    Way,
    are_apart,
    beginning,
    conflict_text,
    distance_m,
    find_way_conflicts,
    joined,
    needed_m,
    sloped,
    standing,
    too_near,
    turning,
    turning_points,
)
from skygcs.core.separation import Footprint, pair_margin
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.vehicle.frames import Setpoint
from skygcs.core.vehicle.mission_orders import MISSION_MODES, current_item
from skygcs.core.vehicle.orders import FORCE_HINT, fresh_position
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.task_set import OWN, TaskSet, in_short_turns
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent

PERIOD_S = 0.25
"""From one evaluation to the next: a position comes 2 to 10 times a second."""

LONGEST_PERIOD_S = 1.0
"""With so many vehicles that an evaluation takes long, the monitor takes at most `SHARE` of a core, and is never slower
than this."""

SHARE = 0.1

ARRIVED_M = 2.0
"""A vehicle so near to where skygcs has sent it holds there: it wanders by GPS noise and gusts."""

BEGINS_S = 1.0
"""From the check of an order to its entry in the vehicle's ledger, at most: it is sent at once."""

ALIKE_MPS = 1.5
"""Two whose velocities differ by less fly alike: it comes of noise and gusts, and is braked within 1.5 m."""

HOME_OR_DOWN = {"rtl": False, "land": True, "stop": True}
"""Orders after which a vehicle flies home, or comes down where it is (True)."""

FIELD_M = 10_000.0
"""In a frame whose origin is farther away, up is more than 0.1 degrees off."""

MAX_HOLDS = 64
"""Orders to hold in progress at one time; each lasts seconds."""


class Destination(NamedTuple):
    """Where skygcs has sent a vehicle. It holds while nothing newer of ours moves it, or may, and its mode is the same.
    What others order is not seen: it counts beside where the vehicle is (`_present`), never in place of that."""

    place: Place
    order_number: int
    mode: str | None
    """None: the order is still on its way."""
    serial: int
    """Serial of the order, by which it is known in whatever form it is kept."""
    before: Destination | None = None
    """Where it flies if this order fails."""


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
        self._actors = actors
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event)
        self._destinations: dict[int, Destination] = {}
        self._serials = itertools.count()
        self._beginning: dict[int, tuple[MissionRun, float, int]] = {}
        """By key, the mission that a vehicle is being ordered to fly, when that was checked, and the number of the
        newest order to it by then."""
        self._footprints: dict[int, tuple[VehicleConfig, Footprint, int]] = {}
        self._spaces: dict[int, TrajectorySpace] = {}
        self._boxes: dict[int, MissionBox] = {}
        self._missions: dict[int, MissionSpace] = {}
        """The missions that are flown, in `_frame`."""
        self._frame: EnuFrame | None = None
        """The frame in which ways are compared with that of an order."""

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
        for key in self._destinations.keys() - self._actors.keys():
            del self._destinations[key]
        for key in self._beginning.keys() - self._actors.keys():
            del self._beginning[key]

    def _members(self) -> Iterator[Member]:
        for key, actor in list(self._actors.items()):
            footprint, priority = self._settings(key, actor)
            self._space(actor)  # so that no order has to wait until those of a fleet are made
            yield Member(actor.vehicle, footprint, priority, self._destination(key), self._trajectory(actor))
        for table in (self._footprints, self._spaces, self._boxes, self._missions):
            for key in table.keys() - self._actors.keys():
                del table[key]

    def _trajectory(self, actor: VehicleActor) -> list[Place]:
        """Where it will be if it follows its trajectory, or the program that flies it; empty: it follows none, or that
        stands."""
        if actor.program is not None and actor.offboard.flying:
            return actor.program.foreseen(actor.vehicle.key)
        controller = actor.offboard.controller
        flight, frame = controller.flight, controller.frame
        now = self._loop.time()
        if flight is None or frame is None or flight.clock.at(now).rate == 0.0:
            return []
        steps = round(HORIZON_S / PLAN_STEP_S)
        return [frame.to_geodetic(*point) for point in flight.ahead(now, PLAN_STEP_S, steps)]

    def _space(self, actor: VehicleActor) -> TrajectorySpace | None:
        """The way of the trajectory that it follows; None: it follows none."""
        key, controller = actor.vehicle.key, actor.offboard.controller
        flight, frame, known = controller.flight, controller.frame, self._spaces.get(key)
        if flight is None or frame is None:
            self._spaces.pop(key, None)
            return None
        if known is None or known.flight is not flight or known.frame is not frame:
            known = self._spaces[key] = TrajectorySpace(flight, frame)
        return known

    def _settings(self, key: int, actor: VehicleActor) -> tuple[Footprint, int]:
        known = self._footprints.get(key)
        if known is None or known[0] is not actor.config:
            settings = actor.config.separation
            known = self._footprints[key] = (actor.config, settings.footprint(), settings.priority or 0)
        return known[1], known[2]

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

    def sent_to(self, actor: VehicleActor, place: Place) -> Destination:
        """It is ordered to fly to this place: for every later order it is on its way there. Give what is returned to
        `arriving`."""
        key, moves = actor.vehicle.key, 0 if actor.offboard.flying else 1  # control only moves the reference
        known = self._destinations.get(key)
        before = known.before if known is not None and known.mode is None else known
        sent = self._destinations[key] = Destination(
            place, actor.order_number + moves, None, next(self._serials), before
        )
        return sent

    def sent_up(self, actor: VehicleActor, height_m: float) -> Destination | None:
        """It is ordered to take off; as `sent_to`. None: where it stands is not known, or it takes off ahead."""
        here = fresh_position(actor.vehicle, self._loop.time())
        if here is None or actor.vehicle.abilities.takeoff.is_ahead:
            return None
        return self.sent_to(actor, (here[0], here[1], here[2] + height_m))

    def arriving(self, actor: VehicleActor, sent: Destination, *, ok: bool, number: int | None = None) -> None:
        """The order of `sent_to` has ended: it flies there, or does not. ``number``: by which it went out at last."""
        key = actor.vehicle.key
        if number is not None:
            sent = sent._replace(order_number=number)
        taken = ok and actor.runner.ledger.effective <= sent.order_number
        known = self._destinations.get(key)
        newest = known is not None and known.serial == sent.serial
        before = known.before if known is not None and newest else sent.before
        now = sent._replace(mode=actor.vehicle.mode, before=None) if taken else None if ok else before
        if newest:
            del self._destinations[key]
            if now is not None:
                self._destinations[key] = now
        elif known is not None and known.mode is None and now is not None:
            self._destinations[key] = known._replace(before=now)  # a newer one is on its way

    def goto_refusal(
        self, vehicle: Vehicle, to: Place, together: frozenset[int], *, only: frozenset[int] | None = None
    ) -> str | None:
        """Why it should not be sent there now; None: nothing is in the way. ``together``: keys of vehicles that are
        sent somewhere by the same order or program, which keeps them apart. ``only``: look at these others only."""
        mover = self._mover(vehicle)
        if mover is None:
            return None
        conflict = goto_conflict(mover, to, self._others(together, only=only), self._loop.time())
        return self._refusal(conflict or self._crosses(mover, to, together, only=only))

    def unlike_refusals(self, vehicles: Sequence[Vehicle]) -> dict[int, str]:
        """Which of these, that are sent somewhere together, should not be, by key, and why: before it turns, one would
        come too near another that flies otherwise. Those that fly alike keep their distances."""
        movers = [mover for vehicle in vehicles if (mover := self._mover(vehicle)) is not None]
        flown = {vehicle.key: (vehicle.telemetry("position") or {}).get("vel_enu_mps", REST) for vehicle in vehicles}
        if all(math.dist(flown[movers[0].key], flown[one.key]) <= ALIKE_MPS / 2.0 for one in movers):
            movers.clear()  # most of them stand, or fly on side by side
        ways = [(mover, _brakes(mover, self._frame_of(movers[0]))) for mover in movers]
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
        mover = self._mover(vehicle)
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
        mover = self._mover(vehicle)
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
                on_trajectory(actor.vehicle, self.footprint(actor), loaded, clock, places_on(loaded, clock, now))
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
                if self._goes_to(other, track) is not None:
                    others.append(self._way_left(other, track, frame))
                else:
                    others += self._goes_on(other, track, frame)
                others += self._begins(other, track, frame)
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
        self.begin_missions(starting)
        ways, frame = await self._mission_ways(starting), self.monitor.tracks.frame
        others = list[Way]()
        for key, track in {**self.monitor.tracks.lost, **self.monitor.tracks.tracks}.items():
            actor = self._actors.get(key)
            waits = track.parked and self._destination(key) is None
            if actor is None or actor in starting or waits or frame is None:
                continue
            others.append(self._flown_mission(actor, frame) or self._way_left(actor, track, frame))
            others += self._begins(actor, track, frame)
        refused = await self._way_refusals(ways, others) | self._landing_refusals(ways)
        for actor in refused:
            self._beginning.pop(actor.vehicle.key, None)
        return refused

    def begin_missions(self, runs: Mapping[VehicleActor, MissionRun]) -> None:
        """These are being ordered to fly these missions: for every other order they do so until theirs has ended."""
        now = self._loop.time()
        self._beginning |= {actor.vehicle.key: (run, now, actor.order_number) for actor, run in runs.items()}

    def _begins(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> list[Way]:
        """The ways of a vehicle by an order that is being given to it, which its telemetry does not show yet: along a
        mission, home or down."""
        ledger, ways = actor.runner.ledger, self._begins_home(actor, track, frame)
        run, checked_at, number = self._beginning.get(track.key, (None, 0.0, 0))
        begun = ledger.number - number  # 1: the order itself is the newest
        lately = self._loop.time() - checked_at <= BEGINS_S
        if run is not None and not (begun <= 1 and (lately or (begun == 1 and ledger.newest_in_progress))):
            del self._beginning[track.key]
        elif run is not None and (way := self._mission_way(actor, run, frame)) is not None:
            ways.append(way)
        return ways

    def _begins_home(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> list[Way]:
        """The same, but for missions."""
        lands, home = HOME_OR_DOWN.get(actor.runner.ledger.newest_in_progress), actor.vehicle.telemetry("home")
        if lands is None or home is None or actor.vehicle.mode in COMING_HOME or not self._hovers(track):
            return []
        return [self._way_home(actor, track, frame, home, lands=lands)]

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
            if (frame := self.monitor.tracks.frame) and (way := self._mission_way(actor, run, frame)):
                ways[actor] = way
            await asyncio.sleep(0)
        return ways

    async def _way_refusals(self, ways: Mapping[VehicleActor, Way], others: Sequence[Way]) -> dict[VehicleActor, str]:
        """Which of these ways lead too near each other or to others, in turns with other tasks."""
        found: dict[int, str] = {}
        await in_short_turns(find_way_conflicts(list(ways.values()), others, found))
        refused = ((actor, self._refusal(found.get(way.key))) for actor, way in ways.items())
        return {actor: why for actor, why in refused if why is not None}

    def _flown_mission(self, actor: VehicleActor, frame: EnuFrame) -> Way | None:
        """The rest of the mission that a vehicle flies; None: it flies none, or none that is known."""
        items = actor.missions.items if actor.vehicle.mode in MISSION_MODES else None
        return self._mission_way(actor, MissionRun(items, current_item(actor.vehicle)), frame) if items else None

    def _mission_way(self, actor: VehicleActor, run: MissionRun, frame: EnuFrame) -> Way | None:
        """The way of a mission from where its vehicle is; None: that is not known."""
        mover, home = self._mover(actor.vehicle), actor.vehicle.telemetry("home")
        if mover is None:
            return None
        alt_m = actor.vehicle.home_alt_amsl_m()
        base = mover.here if alt_m is None else (*mover.here[:2], alt_m)
        if home is not None:
            base = (home["lat_deg"], home["lon_deg"], home["alt_amsl_m"])
        vehicle = actor.vehicle
        ends = vehicle.mission_return_rule.with_mission({item.command for item in run.items})
        run = run._replace(return_end=ends)
        if run.returns and run.height == UNKNOWN:
            run = run._replace(height=known_return_height(vehicle))
        of = MissionOf(mover.key, mover.name, mover.footprint, run, base, frame, vehicle.mission_reach_m)
        space = self._missions.get(mover.key)
        if space is None or space.of != of:
            space = MissionSpace(of)
            if frame is self._frame:
                self._missions[mover.key] = space
        way = space.way(mover.here)
        here, first = frame.from_geodetic(*mover.here), way.legs[min(1, len(way.legs) - 1)]
        velocity = world_from_enu(mover.velocity_mps, frame.origin)
        turns = _turning(mover, here, velocity, (*first.end, here[2]))
        return joined(way, replace(way, legs=turns)) if turns else way

    def present_ways(
        self, frame: EnuFrame, without: Collection[int], *, parked: bool = False
    ) -> Iterator[tuple[Way, bool]]:
        """The ways, in this frame, that vehicles which are heard fly now, and True for each that does not move until
        somebody orders it to. ``without``: keys of those to leave out. ``parked``: also of those on the ground; launch
        pads are often nearer to each other than what flies needs."""
        for key, track in self.monitor.tracks.tracks.items() if self.mode != "off" else ():
            actor = self._actors.get(key)
            waits = track.parked and self._destination(key) is None
            if actor is None or key in without or not actor.vehicle.connected or (waits and not parked):
                continue
            way = self._present_way(actor, track, frame)
            (west, east, south, north), (low_m, high_m) = way.box, way.heights
            stays = math.hypot(east - west, north - south, high_m - low_m) <= ARRIVED_M
            led = actor.offboard.flying or actor.vehicle.mode in MISSION_MODES
            yield way, waits or (stays and not led)
            yield from ((begins, False) for begins in self._begins_home(actor, track, frame))

    def why_leaving(self, actor: VehicleActor) -> str | None:
        """Why a vehicle that stands is not to be taken to stay there, in words; None: nobody has sent it anywhere."""
        vehicle, now, place = actor.vehicle, self._loop.time(), self._destination(actor.vehicle.key)
        if self.mode == "off":
            return None
        here, controller, space = fresh_position(vehicle, now), actor.offboard.controller, self._space(actor)
        if place is not None and (here is None or math.dist(ecef(*here), ecef(*place)) > ARRIVED_M):
            return "was sent elsewhere"
        if not is_flying(vehicle, now):
            return None
        if vehicle.mode in COMING_HOME or vehicle.mode in MISSION_MODES:
            return f"goes on by itself ({vehicle.mode})"
        if space is not None and space.left(now):
            return "is on its trajectory"
        led = actor.offboard.flying and (controller.streaming or actor.program is not None)
        return "is flown by a program" if led else None

    def _present_way(self, actor: VehicleActor, track: Track, frame: EnuFrame, *, ahead: bool = True) -> Way:
        """Where a vehicle is, and the way to where skygcs has sent it, else (``ahead``) where it flies straight on. Not
        ahead for a mission: it takes minutes, and where one passes by now is no obstacle to it."""
        destination = self._destination(track.key)
        holds = holding_disc(Other(track, destination), frame)
        points = [frame.from_ecef(track.ecef_m), holds.middle_m]
        doing, bow_m = _doing(track, "in the air"), 0.0
        if destination is None and not track.parked and not track.lost:
            space = self._space(actor)
            if space is not None and (left := space.left(self._loop.time())):
                doing, bow_m = "on its trajectory", space.bow_m
                points += [frame.from_ecef(point) for point in left]
            elif ahead:
                planned = self._trajectory(actor)
                points += [frame.from_geodetic(*place) for place in planned] or _ahead(points[0], track)
        turns = () if destination is None else _turning(track, points[0], _along(track, frame), points[-1])
        ball_m = self._ball_m(track) + holds.radius_m + bow_m
        return Way(track.key, track.name, self.footprint(actor), sloped(points) + turns, ball_m, doing)

    @staticmethod
    def _hovers(track: Track) -> bool:
        return not track.parked and not track.circle_m

    def _comes_home(self, actor: VehicleActor, track: Track) -> Mapping[str, Any] | None:
        """The home of one that comes home or down, by whatever order or failsafe; None: it does not, or not so that its
        way is known."""
        comes = actor.vehicle.mode in COMING_HOME and self._hovers(track)
        return actor.vehicle.telemetry("home") if comes else None

    def _way_left(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> Way:
        """The way that a vehicle has still to fly: home or down, or to where skygcs has sent it."""
        home = self._comes_home(actor, track)
        if home is None:
            return self._present_way(actor, track, frame, ahead=False)
        return self._way_home(actor, track, frame, home, lands=actor.vehicle.mode in LANDING)

    def _way_home(
        self, actor: VehicleActor, track: Track, frame: EnuFrame, home: Mapping[str, Any], *, lands: bool
    ) -> Way:
        """Its way home, or down where it is (``lands``). A return height that was not read is taken to be the height
        that it is at."""
        one = Returning(
            track.key,
            track.name,
            self.footprint(actor),
            frame.from_ecef(track.ecef_m),
            (0.0, 0.0, track.reported_mps[2]),  # how it turns is added
            frame.from_geodetic(home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]),
            known_return_height(actor.vehicle),
            lands=lands,
        )
        way = one.as_seen().way(under_way=True)
        to = one.here if lands else (*one.home[:2], one.here[2])
        turns = _turning(track, one.here, _along(track, frame), to)
        return replace(way, legs=way.legs + turns, doing=_doing(track, way.doing))

    def _goes_to(self, actor: VehicleActor, track: Track) -> Place | None:
        """Where its way ends (`_way_left`) if it comes home or down, or was sent somewhere; None: neither."""
        home = self._comes_home(actor, track)
        if home is None:
            return self._destination(track.key)
        return home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]

    def _frame_of(self, mover: Mover) -> EnuFrame:
        """The frame in which ways are compared with that of an order: the same one for a field, so that missions stay
        made (`MissionSpace`)."""
        lat_deg, lon_deg, _ = mover.here
        if self._frame is None or math.hypot(*self._frame.from_geodetic(lat_deg, lon_deg, 0.0)) > FIELD_M:
            self._frame = EnuFrame(Origin(lat_deg, lon_deg, 0.0))
            self._missions.clear()
        return self._frame

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
        ways = self._ways(mover, to, together, only=only)
        return space_conflict(mover, to, ways, strict=strict, frame=self._frame_of(mover))

    def _ways(
        self, mover: Mover, to: Place, together: frozenset[int] = frozenset(), *, only: frozenset[int] | None = None
    ) -> Iterator[Way]:
        """The ways of those that come home or down, or were sent somewhere, without most that are far from the straight
        line to that place; see `space_conflict`."""
        frame = self._frame_of(mover)
        line = frame.from_geodetic(*mover.here), frame.from_geodetic(*to)
        for key, track in itertools.chain(self.monitor.tracks.tracks.items(), self.monitor.tracks.lost.items()):
            actor = self._actors.get(key)
            if actor is None or key in together or key == mover.key or (only is not None and key not in only):
                continue
            yield from self._begins(actor, track, frame)
            place = self._goes_to(actor, track)
            if place is None:
                if not self._mission_is_far(actor, track, mover, to):
                    yield from self._trajectory_way(actor, track, mover, to, frame) or self._goes_on(
                        actor, track, frame
                    )
                continue
            margin, ball_m = pair_margin(mover.footprint, track.footprint), self._ball_m(track)
            comes = self._comes_home(actor, track) is not None
            need_m = margin.total_m + ball_m + mover.turns_m + track.turns_m
            need = need_m, need_m, math.inf if comes else need_m * margin.downwash_ratio  # it may climb first
            if are_apart(line, (frame.from_ecef(track.ecef_m), frame.from_geodetic(*place)), need):
                continue
            way = self._way_left(actor, track, frame)
            # its circle is compared at its end
            yield way if comes else replace(way, ball_m=ball_m)

    def _goes_on(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> list[Way]:
        """The space, if it has any, of a vehicle that flies otherwise than where it was sent: all of its mission, or as
        far as it flies on before it stands, as it may stop at any time."""
        if track.parked or track.lost or self._stands(actor, track.reported_mps):
            return []
        if (way := self._flown_mission(actor, frame)) is not None:
            return [way]
        legs = _braking(frame.from_ecef(track.ecef_m), _along(track, frame), track.turns_m)
        way = Way(track.key, track.name, track.footprint, legs, self._ball_m(track))
        return [way] if track.turns_m else []

    def _mission_is_far(self, actor: VehicleActor, track: Track, mover: Mover, to: Place) -> bool:
        """True if it flies a mission that is not near a straight way: most of a fleet's."""
        key, items, home = track.key, actor.missions.items, actor.vehicle.telemetry("home")
        if not items or home is None or actor.vehicle.mode not in MISSION_MODES:
            return False
        base, box = (home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]), self._boxes.get(key)
        if box is None or box.items is not items or box.home != base:
            box = self._boxes[key] = mission_box(items, base)
        margin = pair_margin(mover.footprint, track.footprint)
        need_m = (
            (margin.total_m + self._ball_m(track)) * max(1.0, margin.downwash_ratio) + mover.turns_m + track.turns_m
        )
        return box.is_apart((ecef(*mover.here), ecef(*to)), track.ecef_m, need_m, known_return_height(actor.vehicle))

    def _trajectory_way(self, actor: VehicleActor, track: Track, mover: Mover, to: Place, frame: EnuFrame) -> list[Way]:
        """The way that a vehicle has still to fly on its trajectory, if it follows one, as far as it may be near a way
        to that place."""
        space = None if track.parked or track.lost else self._space(actor)
        if space is None:
            return []
        margin = pair_margin(mover.footprint, track.footprint)
        ball_m = self._ball_m(track) + space.bow_m
        need_m = (margin.total_m + ball_m) * max(1.0, margin.downwash_ratio) + mover.turns_m
        ends = ecef(*mover.here), ecef(*to)
        legs = tuple(
            leg
            for part in space.left_near(ends, need_m, self._loop.time())
            for leg in sloped([frame.from_ecef(point) for point in part])
        )
        legs = (*standing(frame.from_ecef(track.ecef_m)), *legs)
        return [Way(track.key, track.name, track.footprint, legs, ball_m, "on its trajectory")]

    def _ball_m(self, track: Track) -> float:
        """How far it may be from where it was seen last."""
        silence_s = 0.0 if track.parked else min(self._loop.time() - track.at, TRACK_SILENT_S)
        return track.footprint.ball_m(max(0.0, silence_s - FRESH_S))

    def footprint(self, actor: VehicleActor) -> Footprint:
        """The space that a vehicle needs."""
        return self._settings(actor.vehicle.key, actor)[0]

    def _mover(self, vehicle: Vehicle) -> Mover | None:
        """The vehicle of an order, where it is now; None if that is not known or nobody watches."""
        actor = self._actors.get(vehicle.key)
        if self.mode == "off" or actor is None or vehicle.ids.beside:
            return None
        now = self._loop.time()
        here, (position, at) = fresh_position(vehicle, now), vehicle.timed_telemetry("position")
        if here is None or position is None or at is None:
            return None
        circle_m, brake_mps2 = vehicle.hold_reach_m(now), vehicle.abilities.brake_mps2 or USUAL_BRAKE_MPS2
        velocity = self.soon_mps(vehicle, at, position["vel_enu_mps"]) if is_flying(vehicle, now) else REST
        mover = Mover(vehicle.key, vehicle.name, self.footprint(actor), here, circle_m, velocity, brake_mps2)
        before = self._destination(vehicle.key)
        way = REST if before is None else mover_frame(mover).from_geodetic(*before)
        return replace(mover, stops_in_m=math.hypot(*way)) if arrives(velocity, way, brake_mps2) else mover

    def soon_mps(self, vehicle: Vehicle, at: float, velocity_mps: Sequence[float]) -> Vector:
        """The velocity of a vehicle, reported at that time, when an order makes it turn."""
        east, north, up = velocity_mps
        actor = self._actors.get(vehicle.key)
        if actor is not None and self._stands(actor, velocity_mps):
            return east, north, up
        track = self.monitor.tracks.tracks.get(vehicle.key)
        return soon_mps(() if track is None else track.history, Sample(at, (east, north, up)))

    def _stands(self, actor: VehicleActor, velocity_mps: Sequence[float]) -> bool:
        """True if it hovers and was sent nowhere: noise and gusts change its velocity, and nothing comes of that."""
        return math.hypot(*velocity_mps) < STANDS_MPS and self.why_leaving(actor) is None

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
        """A vehicle where it is, and where it was ``sent``, if it was. Only what is seen flying there has left its
        place: it may not have taken the order, or another station, or setpoints, may have moved it since."""
        destination, frame = self._destination(track.key) if sent else None, self.monitor.tracks.frame
        goal_m = None if destination is None or frame is None else frame.from_geodetic(*destination)
        if goal_m is None or track.parked or track.lost:
            yield Other(track)
        elif way_to(track, track.velocity_mps, goal_m) is None and math.dist(track.place_m, goal_m) > track.circle_m:
            yield Other(track, stays_yet=True)
        if destination is not None:
            yield Other(track, destination)

    def _destination(self, key: int) -> Place | None:
        known, actor = self._destinations.get(key), self._actors.get(key)
        if known is None or actor is None:
            return None
        if known.mode is None:
            return known.place
        led = actor.offboard.flying and (actor.offboard.controller.streaming or actor.offboard.controller.flight)
        idle = not actor.vehicle.armed  # its take-off failed, or it is down
        if led or idle or actor.runner.ledger.effective > known.order_number or actor.vehicle.mode != known.mode:
            del self._destinations[key]
            return None
        return known.place

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


def _doing(track: Track, doing: str) -> str:
    return f"lost in the air{FORGET.format(name=track.name)}" if track.lost else doing


def _along(track: Track, frame: EnuFrame) -> Vector:
    """Its velocity in this frame, when an order makes it turn."""
    return world_from_enu(track.soon_mps, frame.origin)


def _turning(one: Track | Mover, here: Vector, velocity: Vector, to: Vector) -> tuple[Leg, ...]:
    """The space in which it turns to this place; nothing if it is seen to arrive there already."""
    way = to[0] - here[0], to[1] - here[1], to[2] - here[2]
    return () if arrives(velocity, way, one.brake_mps2) else turning(here, velocity, one.turns_m, to)


def _ahead(here_m: Vector, track: Track) -> list[Vector]:
    """Where it is after the horizon, if it moves and flies straight on."""
    if math.hypot(*track.reported_mps) <= 2 * NOISE_MPS:
        return []
    x, y, z = (p + v * HORIZON_S for p, v in zip(here_m, track.reported_mps, strict=True))
    return [(x, y, z)]


def _braking(here: Vector, velocity: Vector, on_m: float) -> tuple[Leg, ...]:
    """From here to where what flies on by so much stands."""
    return sloped(turning_points(here, velocity, on_m, here)[:2])


def _brakes(mover: Mover, frame: EnuFrame) -> Way:
    """The space of one until it turns to another place."""
    legs = _braking(frame.from_geodetic(*mover.here), mover.velocity_mps, mover.turns_m)
    return Way(mover.key, mover.name, mover.footprint, legs)
