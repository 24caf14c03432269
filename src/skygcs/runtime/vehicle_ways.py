"""Where vehicles go: the places to which skygcs has sent them, and the ways that they have still to fly, as space.

Orders are compared with these ways (`runtime.separation_monitor`), and returns with those that others fly now
(`runtime.returns`).
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from skygcs.config.models import VehicleConfig
from skygcs.core.geo import EnuFrame, Origin, ecef, world_from_enu
from skygcs.core.monitor.approach import REST, Vector
from skygcs.core.monitor.conflict_levels import (
    COMING_HOME,
    HOMING_ORDERS,
    HORIZON_S,
    LANDING,
    LANDING_ORDERS,
    NOISE_MPS,
)
from skygcs.core.monitor.departures import STANDS_MPS, UNKNOWN, Returning, known_return_height
from skygcs.core.monitor.mission_ways import (
    MissionBox,
    MissionOf,
    MissionRun,
    MissionSpace,
    mission_box,
)
from skygcs.core.monitor.order_check import (
    FORGET,
    FRESH_S,
    Mover,
    Other,
    TrajectorySpace,
    holding_disc,
    mover_frame,
)
from skygcs.core.monitor.tracks import (
    PLAN_STEP_S,
    TRACK_SILENT_S,
    USUAL_BRAKE_MPS2,
    Place,
    Sample,
    Track,
    TrackTable,
    arrives,
    is_flying,
    soon_mps,
)
from skygcs.core.monitor.ways import (
    Leg,
    Way,
    are_apart,
    joined,
    sloped,
    standing,
    turning,
    turning_points,
)
from skygcs.core.separation import Footprint, pair_margin
from skygcs.core.vehicle.mission_orders import MISSION_MODES, current_item
from skygcs.core.vehicle.orders import fresh_position
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.runtime.vehicle_actor import VehicleActor

BEGINS_S = 1.0
"""From the check of an order to its entry in the vehicle's ledger, at most: it is sent at once."""

ARRIVED_M = 2.0
"""A vehicle so near to where skygcs has sent it holds there: it wanders by GPS noise and gusts."""

FIELD_M = 10_000.0
"""In a frame whose origin is farther away, up is more than 0.1 degrees off."""

FIELDS = 4
"""Fields farther apart than that whose missions stay made while orders come to them in turn."""


class Destination(NamedTuple):
    """Where skygcs has sent a vehicle. It holds while nothing newer of ours moves it, or may, and its mode is the same.
    What others order is not seen: it counts beside where the vehicle is, never in place of that
    (`SeparationMonitor._present`)."""

    place: Place
    order_number: int
    mode: str | None
    """None: the order is still on its way."""
    serial: int
    """Serial of the order, by which it is known in whatever form it is kept."""
    before: Destination | None = None
    """Where it flies if this order fails."""


class VehicleWays:
    """The ways of a fleet's vehicles. Nothing of it sends anything; with ``off`` nobody has a way."""

    def __init__(
        self, actors: Mapping[int, VehicleActor], tracks: TrackTable, loop: asyncio.AbstractEventLoop, *, off: bool
    ) -> None:
        """``actors``: the fleet's vehicles by sysid << 8 | compid. ``tracks``: those of the monitor."""
        self._actors = actors
        self._tracks = tracks
        self._loop = loop
        self._off = off
        self._destinations: dict[int, Destination] = {}
        self._serials = itertools.count()
        self._beginning: dict[int, tuple[MissionRun, float, int]] = {}
        """By key, the mission that a vehicle is being ordered to fly, when that was checked, and the number of the
        newest order to it by then."""
        self._footprints: dict[int, tuple[VehicleConfig, Footprint, int]] = {}
        self._spaces: dict[int, TrajectorySpace] = {}
        self._boxes: dict[int, MissionBox] = {}
        self._fields: list[tuple[EnuFrame, dict[int, MissionSpace]]] = []
        """Frames in which ways are compared with that of an order, and the missions that are flown in each; at most
        FIELDS, that of the newest order last."""

    def forget_gone(self) -> None:
        """Keep nothing of vehicles that the fleet has forgotten."""
        kept: list[dict[int, Any]] = [missions for _, missions in self._fields]
        kept += [self._destinations, self._beginning, self._footprints, self._spaces, self._boxes]
        for table in kept:
            for key in table.keys() - self._actors.keys():
                del table[key]

    # -- settings and trajectories

    def settings(self, key: int, actor: VehicleActor) -> tuple[Footprint, int]:
        """The space that a vehicle needs, and its priority."""
        known = self._footprints.get(key)
        if known is None or known[0] is not actor.config:
            settings = actor.config.separation
            known = self._footprints[key] = (actor.config, settings.footprint(), settings.priority or 0)
        return known[1], known[2]

    def footprint(self, actor: VehicleActor) -> Footprint:
        """The space that a vehicle needs."""
        return self.settings(actor.vehicle.key, actor)[0]

    def foreseen(self, actor: VehicleActor) -> list[Place]:
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

    def trajectory_space(self, actor: VehicleActor) -> TrajectorySpace | None:
        """The way of the trajectory that it follows; None: it follows none."""
        key, controller = actor.vehicle.key, actor.offboard.controller
        flight, frame, known = controller.flight, controller.frame, self._spaces.get(key)
        if flight is None or frame is None:
            self._spaces.pop(key, None)
            return None
        if known is None or known.flight is not flight or known.frame is not frame:
            known = self._spaces[key] = TrajectorySpace(flight, frame)
        return known

    # -- where skygcs has sent them

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

    def destination(self, key: int) -> Place | None:
        """Where skygcs has sent a vehicle; None: nowhere, or something newer moves it."""
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

    def begin_missions(self, runs: Mapping[VehicleActor, MissionRun]) -> None:
        """These are being ordered to fly these missions: for every other order they do so until theirs has ended."""
        now = self._loop.time()
        self._beginning |= {actor.vehicle.key: (run, now, actor.order_number) for actor, run in runs.items()}

    def why_leaving(self, actor: VehicleActor) -> str | None:
        """Why a vehicle that stands is not to be taken to stay there, in words; None: nobody has sent it anywhere."""
        vehicle, now, place = actor.vehicle, self._loop.time(), self.destination(actor.vehicle.key)
        if self._off:
            return None
        here, controller, space = fresh_position(vehicle, now), actor.offboard.controller, self.trajectory_space(actor)
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

    # -- the vehicle of an order

    def unmoved(self, vehicle: Vehicle) -> Mover | None:
        """The vehicle of an order, where it is now, without its motion, which a setpoint of a stream has no use for;
        None if that is not known or nobody watches."""
        actor = self._actors.get(vehicle.key)
        if self._off or actor is None or vehicle.ids.beside:
            return None
        now = self._loop.time()
        here = fresh_position(vehicle, now)
        if here is None:
            return None
        return Mover(vehicle.key, vehicle.name, self.footprint(actor), here, vehicle.hold_reach_m(now))

    def mover(self, vehicle: Vehicle) -> Mover | None:
        """`unmoved` with its motion: how it brakes and turns before it flies there."""
        mover, (position, at) = self.unmoved(vehicle), vehicle.timed_telemetry("position")
        if mover is None or position is None or at is None:
            return None
        brake_mps2 = vehicle.abilities.brake_mps2 or USUAL_BRAKE_MPS2
        flies = is_flying(vehicle, self._loop.time())
        velocity = self.soon_mps(vehicle, at, position["vel_enu_mps"]) if flies else REST
        before = self.destination(vehicle.key)
        way = REST if before is None else mover_frame(mover).from_geodetic(*before)
        stops_in_m = math.hypot(*way) if arrives(velocity, way, brake_mps2) else math.inf
        return replace(mover, velocity_mps=velocity, brake_mps2=brake_mps2, stops_in_m=stops_in_m)

    def soon_mps(self, vehicle: Vehicle, at: float, velocity_mps: Sequence[float]) -> Vector:
        """The velocity of a vehicle, reported at that time, when an order makes it turn."""
        east, north, up = velocity_mps
        actor = self._actors.get(vehicle.key)
        if actor is not None and self._stands(actor, velocity_mps):
            return east, north, up
        track = self._tracks.tracks.get(vehicle.key)
        return soon_mps(() if track is None else track.history, Sample(at, (east, north, up)))

    def _stands(self, actor: VehicleActor, velocity_mps: Sequence[float]) -> bool:
        """True if it hovers and was sent nowhere: noise and gusts change its velocity, and nothing comes of that."""
        return math.hypot(*velocity_mps) < STANDS_MPS and self.why_leaving(actor) is None

    def frame_of(self, mover: Mover) -> EnuFrame:
        """The frame in which ways are compared with that of an order: the same one for a field, so that missions stay
        made (`MissionSpace`)."""
        lat_deg, lon_deg, _ = mover.here
        for field in reversed(self._fields):
            if math.hypot(*field[0].from_geodetic(lat_deg, lon_deg, 0.0)) <= FIELD_M:
                self._fields = [other for other in self._fields if other is not field]
                break
        else:
            field = EnuFrame(Origin(lat_deg, lon_deg, 0.0)), {}
        self._fields = [*self._fields, field][-FIELDS:]
        return field[0]

    # -- ways that vehicles have still to fly

    def present_ways(
        self, frame: EnuFrame, without: Collection[int], *, parked: bool = False
    ) -> Iterator[tuple[Way, bool]]:
        """The ways, in this frame, that vehicles which are heard fly now, and True for each that does not move until
        somebody orders it to. ``without``: keys of those to leave out. ``parked``: also of those on the ground; launch
        pads are often nearer to each other than what flies needs."""
        for key, track in self._tracks.tracks.items() if not self._off else ():
            actor = self._actors.get(key)
            waits = track.parked and self.destination(key) is None
            if actor is None or key in without or not actor.vehicle.connected or (waits and not parked):
                continue
            way = self._present_way(actor, track, frame)
            (west, east, south, north), (low_m, high_m) = way.box, way.heights
            stays = math.hypot(east - west, north - south, high_m - low_m) <= ARRIVED_M
            led = actor.offboard.flying or actor.vehicle.mode in MISSION_MODES
            yield way, waits or (stays and not led)
            yield from ((begins, False) for begins in self._begins_home(actor, track, frame))

    def near(
        self, mover: Mover, to: Place, together: frozenset[int] = frozenset(), *, only: frozenset[int] | None = None
    ) -> Iterator[Way]:
        """The ways of those that come home or down, or were sent somewhere, without most that are far from the straight
        line to that place; see `space_conflict`."""
        frame = self.frame_of(mover)
        line = frame.from_geodetic(*mover.here), frame.from_geodetic(*to)
        for key, track in itertools.chain(self._tracks.tracks.items(), self._tracks.lost.items()):
            actor = self._actors.get(key)
            if actor is None or key in together or key == mover.key or (only is not None and key not in only):
                continue
            yield from self.begins(actor, track, frame)
            place = self.goes_to(actor, track)
            if place is None:
                if not self._mission_is_far(actor, track, mover, to):
                    yield from self._trajectory_way(actor, track, mover, to, frame) or self.goes_on(actor, track, frame)
                continue
            margin, ball_m = pair_margin(mover.footprint, track.footprint), self._ball_m(track)
            comes = self._comes_home(actor, track) is not None
            need_m = margin.total_m + ball_m + mover.turns_m + track.turns_m
            need = need_m, need_m, math.inf if comes else need_m * margin.downwash_ratio  # it may climb first
            if are_apart(line, (frame.from_ecef(track.ecef_m), frame.from_geodetic(*place)), need):
                continue
            way = self.way_left(actor, track, frame)
            # its circle is compared at its end
            yield way if comes else replace(way, ball_m=ball_m)

    def _present_way(self, actor: VehicleActor, track: Track, frame: EnuFrame, *, ahead: bool = True) -> Way:
        """Where a vehicle is, and the way to where skygcs has sent it, else (``ahead``) where it flies straight on. Not
        ahead for a mission: it takes minutes, and where one passes by now is no obstacle to it."""
        destination = self.destination(track.key)
        holds = holding_disc(Other(track, destination), frame)
        points = [frame.from_ecef(track.ecef_m), holds.middle_m]
        doing, bow_m = _doing(track, "in the air"), 0.0
        if destination is None and not track.parked and not track.lost:
            space = self.trajectory_space(actor)
            if space is not None and (left := space.left(self._loop.time())):
                doing, bow_m = "on its trajectory", space.bow_m
                points += [frame.from_ecef(point) for point in left]
            elif ahead:
                planned = self.foreseen(actor)
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

    def goes_to(self, actor: VehicleActor, track: Track) -> Place | None:
        """Where its way ends (`way_left`) if it comes home or down, or was sent somewhere; None: neither."""
        home = self._comes_home(actor, track)
        if home is None:
            return self.destination(track.key)
        return home["lat_deg"], home["lon_deg"], home["alt_amsl_m"]

    def way_left(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> Way:
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

    def not_begun(self, actor: VehicleActor) -> None:
        """The order of `begin_missions` was refused."""
        self._beginning.pop(actor.vehicle.key, None)

    def begins(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> list[Way]:
        """The ways of a vehicle by an order that is being given to it, which its telemetry does not show yet: along a
        mission, home or down."""
        ledger, ways = actor.runner.ledger, self._begins_home(actor, track, frame)
        run, checked_at, number = self._beginning.get(track.key, (None, 0.0, 0))
        begun = ledger.number - number  # 1: the order itself is the newest
        lately = self._loop.time() - checked_at <= BEGINS_S
        if run is not None and not (begun <= 1 and (lately or (begun == 1 and ledger.newest_in_progress))):
            del self._beginning[track.key]
        elif run is not None and (way := self.mission_way(actor, run, frame)) is not None:
            ways.append(way)
        return ways

    def _begins_home(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> list[Way]:
        """`begins` without missions."""
        order, home = actor.runner.ledger.newest_in_progress, actor.vehicle.telemetry("home")
        known = order in HOMING_ORDERS and actor.vehicle.mode not in COMING_HOME and self._hovers(track)
        if not known or home is None:
            return []
        return [self._way_home(actor, track, frame, home, lands=order in LANDING_ORDERS)]

    def goes_on(self, actor: VehicleActor, track: Track, frame: EnuFrame) -> list[Way]:
        """The space, if it has any, of a vehicle that flies otherwise than where it was sent: all of its mission, or as
        far as it flies on before it stands, as it may stop at any time."""
        if track.parked or track.lost or self._stands(actor, track.reported_mps):
            return []
        if (way := self.flown_mission(actor, frame)) is not None:
            return [way]
        legs = braking(frame.from_ecef(track.ecef_m), _along(track, frame), track.turns_m)
        way = Way(track.key, track.name, track.footprint, legs, self._ball_m(track))
        return [way] if track.turns_m else []

    def flown_mission(self, actor: VehicleActor, frame: EnuFrame) -> Way | None:
        """The rest of the mission that a vehicle flies; None: it flies none, or none that is known."""
        items = actor.missions.items if actor.vehicle.mode in MISSION_MODES else None
        return self.mission_way(actor, MissionRun(items, current_item(actor.vehicle)), frame) if items else None

    def mission_way(self, actor: VehicleActor, run: MissionRun, frame: EnuFrame) -> Way | None:
        """The way of a mission from where its vehicle is; None: that is not known."""
        mover, home = self.mover(actor.vehicle), actor.vehicle.telemetry("home")
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
        made = next((missions for known, missions in self._fields if known is frame), {})
        space = made.get(mover.key)
        if space is None or space.of != of:
            space = made[mover.key] = MissionSpace(of)
        way = space.way(mover.here)
        here, first = frame.from_geodetic(*mover.here), way.legs[min(1, len(way.legs) - 1)]
        velocity = world_from_enu(mover.velocity_mps, frame.origin)
        turns = _turning(mover, here, velocity, (*first.end, here[2]))
        return joined(way, replace(way, legs=turns)) if turns else way

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
        space = None if track.parked or track.lost else self.trajectory_space(actor)
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


def braking(here: Vector, velocity: Vector, on_m: float) -> tuple[Leg, ...]:
    """From here to where what flies on by so much stands."""
    return sloped(turning_points(here, velocity, on_m, here)[:2])
