"""Formations in the daemon: begins them, sends each member its setpoint ten times a second, and sees who leaves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from skygcs.config.tables import Problem
from skygcs.core.control.control_fence import fence_ahead
from skygcs.core.geo import EnuFrame, Origin, world_from_enu
from skygcs.core.mavlink.vehicle_class import cannot_hover
from skygcs.core.monitor.conflict_levels import HORIZON_S
from skygcs.core.monitor.tracks import PLAN_STEP_S, Place, Track, is_flying
from skygcs.core.plan.formations import CURRENT, WantedFormation, middle_of
from skygcs.core.plan.margins import OFF_REFERENCE, MarginRule, Motion
from skygcs.core.plan.straight_flight import assigned
from skygcs.core.vehicle.flight_lock import Holder
from skygcs.core.vehicle.offboard_entry import loss_reach
from skygcs.core.vehicle.order_ledger import ClientIdentity, OrderLedger, StreamOwner
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.ext.formation.config import FormationConfig, formation_problems
from skygcs.ext.formation.formation_flight import FormationFlight, FormationState, WantedFlight
from skygcs.ext.formation.leader import SPEED_SHARE, Demand, Leader, Stay, turned
from skygcs.ext.formation.methods import METHODS
from skygcs.ext.formation.separation_filter import (
    SLACK_M,
    Allowed,
    Member,
    MotionBounds,
    Moving,
    Obstacle,
    SeparationFilter,
    Vector,
    minus,
)
from skygcs.extension import Clock, Extension, StateGroup
from skygcs.runtime.fleet_margins import margin_rule, place
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.rpc.context import Services

PERIOD_S = 0.1

VALID_S = 0.5
"""A setpoint is valid for five periods. A vehicle that gets no newer one stays where it comes to rest."""

SEEN_S = 1.5
"""A vehicle whose position is older is not seen: the guard holds it soon after (`position_stale_s`)."""

STANDS_MPS = 1.0
"""A vehicle that hovers in wind moves slower than this; one that brakes from this stands within its tube."""

KIND = "formation"

MOST_MEMBERS = 30
"""A step of 20 that are all in each other's way takes 5 ms, at most 11, and of 40 14 and 22 (measured): the other tasks
of the loop wait for it, and a control period is 20 ms."""

FLOWN_IN = ("position", "velocity")
"""The control modes in which a member may be flown: both take places."""


class Formation(Extension[FormationConfig]):
    """One formation at a time."""

    Config = FormationConfig
    own_methods = METHODS

    def __init__(self, core: Services, config: FormationConfig) -> None:
        super().__init__(core, config)
        self.flight: FormationFlight | None = None
        self._numbers: dict[str, int] = {}
        """`VehicleActor.order_number` of each member when it began."""
        self._actors: dict[str, VehicleActor] = {}
        self._origin: Origin | None = None
        self._beginning = False
        self._client = ClientIdentity(lambda: "the formation")
        """The owner of the members' streams; another one for each formation."""
        self._guide = StreamOwner(OrderLedger())
        """The program whose places the present formation flies to."""
        self._stops = 0
        """Counts the orders to stop: one that comes while a formation is being begun ends that."""
        self._stepped_at = -math.inf
        self._reported: tuple[FormationState, str] | None = None

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return formation_problems(config, fleet)

    def state_groups(self) -> Mapping[str, StateGroup]:
        return {"formation": self._state_of}

    def clocks(self) -> Iterable[Clock]:
        yield Clock("formation tick", PERIOD_S, lambda: self.tick(self.core.now()))

    def close(self) -> None:
        self._end()

    def _state_of(self, actor: VehicleActor, now: float) -> dict[str, Any] | None:
        flight = self.flight
        if flight is None or self._actors.get(actor.name) is not actor or actor.name in flight.left:
            return None
        off_m = flight.off_place_m.get(actor.name)
        return {"state": flight.state.value, "off_place_m": None if off_m is None else round(off_m, 2)}

    # -- begin and end

    async def begin(self, wanted: WantedFlight) -> dict[str, Any]:
        """Take the vehicles under control where they are not, and fly to the formation. A formation of the same members
        that flies is given new places. Raises TargetError and RefusedError."""
        if self._beginning:
            raise RefusedError("another formation is being begun")
        self._beginning = True
        try:
            fleet = self.core.fleet
            actors = fleet.resolve(wanted.targets)
            lead = None if wanted.leader is None else fleet.find(wanted.leader)
            self._require_free(actors, lead)
            stops = self._stops
            await self._take_control(actors)
            if self._stops != stops:
                raise RefusedError("it was stopped during its start; vehicles under control hold")
            self._begin(actors, lead, wanted)
        finally:
            self._beginning = False
        return self.status()

    def _require_free(self, actors: Sequence[VehicleActor], lead: VehicleActor | None) -> None:
        """Raises RefusedError where somebody or something else flies one of them."""
        if len(actors) > MOST_MEMBERS:
            raise RefusedError(f"{len(actors)} vehicles: a formation has {MOST_MEMBERS} members at most")
        if lead is not None and lead in actors:
            raise RefusedError(f"{lead.name} leads, so it is no follower: leave it out of the targets")
        for actor in actors:
            if (why := cannot_hover(actor.vehicle.family, actor.vehicle.kind)) is not None:
                raise RefusedError(f"{actor.name}: {why}")
        flight = self.flight
        if (
            flight is not None
            and flight.state is not FormationState.STOPPED
            and {*self._actors} != {actor.name for actor in actors}
        ):
            raise RefusedError(f"a formation of {', '.join(self._actors)} flies: `skygcs-cli formation stop` first")
        keys = {actor.vehicle.key for actor in actors}
        for lock in self.core.fleet.locks.held():
            if lock.holder is not Holder.ENGAGEMENT and any(lock.holds(key) for key in keys):
                raise RefusedError(f"{lock.flight}: `{lock.end_command}` first")
        for actor in actors:
            mode = actor.offboard.controller.wanted.value if actor.offboard.flying else FLOWN_IN[0]
            if mode not in FLOWN_IN:
                fix = f"`skygcs-cli control set {actor.name} position` first"
                raise RefusedError(f"{actor.name} is flown in {mode}: {fix}")

    async def _take_control(self, actors: Sequence[VehicleActor]) -> None:
        """Raises RefusedError if one cannot be flown by setpoints. The others stay under control, and hold."""
        names = [actor.name for actor in actors if not actor.offboard.flying]
        if not names:
            return
        outcomes = await self.core.fleet.orders.command_all(names, VehicleActor.control, mode=FLOWN_IN[0])
        failed = [f"{name}: {outcome.message}" for name, outcome in outcomes.items() if not outcome.ok]
        if failed:
            more = f"; {len(names) - len(failed)} are under control and hold" if len(names) > len(failed) else ""
            raise RefusedError("; ".join(failed) + more)

    def _begin(self, actors: Sequence[VehicleActor], lead: VehicleActor | None, wanted: WantedFlight) -> None:
        """Raises RefusedError where there is no room for it."""
        now, origin = self.core.now(), self.core.fleet.origin
        if origin is None:
            raise RefusedError("the fleet has no origin yet: `skygcs-cli origin set` first")
        flight = self.flight
        goes_on = flight is not None and flight.state is FormationState.FLYING
        starts = self._starts(actors, now, moving=goes_on)
        # the leader and the places about it
        bounds = self._bounds(actors)
        rule = margin_rule(actors)
        ratio = rule.downwash_ratio
        leader = self._leader(wanted, starts, lead, bounds, ratio, now)
        if goes_on and flight is not None and lead is None and flight.led_by is None and wanted.at_enu_m is None:
            leader.moving = flight.leader.moving
        # the distances
        motion = Motion(speed_mps=bounds.speed_mps)
        shares = {name: _share(rule, name, motion) for name in starts}

        def needed_m(a: str, b: str) -> float:
            wanted_m = shares[a].radius_m + shares[b].radius_m + 2 * SLACK_M
            if wanted.shape != CURRENT:
                return wanted_m
            x, y, z = minus(starts[a], starts[b])  # they may stay as near as they are, and come no nearer
            least_m = shares[a].footprint_m + shares[b].footprint_m
            return max(min(wanted_m, math.hypot(x, y, z / ratio) - SLACK_M), least_m)

        self._require_room(leader, needed_m, ratio)
        allowed = self._allowed(actors, starts, origin)
        self._require_allowed(leader.places_at(leader.moving.pos_enu_m, leader.yaw_rad, leader.scale), allowed)
        if goes_on and flight is not None:
            self._follow_leader(flight)
            flight.leader, flight.led_by = leader, None if lead is None else lead.name
            self._report(f"{wanted.shape}: new places", {})
            return
        members = {name: Member(shares[name].radius_m, Moving(start)) for name, start in starts.items()}
        filter_ = SeparationFilter(members, bounds, ratio, allowed)
        self._end()
        self.flight = FormationFlight(
            leader, filter_, {name: share.tube_m for name, share in shares.items()}, None if lead is None else lead.name
        )
        self._actors = {actor.name: actor for actor in actors}
        self._numbers = {actor.name: actor.order_number for actor in actors}
        self._origin, self._stepped_at, self._reported = origin, now, None
        self._client, self._guide = ClientIdentity(lambda: "the formation"), StreamOwner(OrderLedger())
        for actor in actors:
            actor.program = self
            actor.stream.lead(self._client, VALID_S)
        self._report(f"{wanted.shape} of {', '.join(starts)} begins", {})

    def _starts(self, actors: Iterable[VehicleActor], now: float, *, moving: bool) -> dict[str, Vector]:
        """Where all are. Raises RefusedError where that is not known, or where one flies on, unless they may be
        ``moving``: its reference begins at rest."""
        starts: dict[str, Vector] = {}
        for actor in actors:
            there = self._measured(actor, now)
            if there is None:
                raise RefusedError(f"{actor.name}: its position is not known, or old")
            speed_mps = math.hypot(*there.vel_enu_mps)
            if speed_mps > STANDS_MPS and not moving:
                raise RefusedError(f"{actor.name} flies with {speed_mps:.1f} m/s: `skygcs-cli hold {actor.name}` first")
            starts[actor.name] = there.pos_enu_m
        return starts

    def _allowed(self, actors: Sequence[VehicleActor], starts: Mapping[str, Vector], origin: Origin) -> Allowed:
        """Within each one's control fence, also if its setpoints cease, and not too low."""
        fences = {actor.name: actor.config.control.fence_at(origin) for actor in actors}
        reaches = {actor.name: loss_reach(actor.vehicle) for actor in actors}
        lowest_m = {name: min(self.config.lowest_m, start[2]) - SLACK_M for name, start in starts.items()}
        frame = EnuFrame(origin)

        def allowed(name: str, moving: Moving, stands: Vector) -> bool:
            fence = fences[name]
            return (
                stands[2] >= lowest_m[name]
                and fence.contains(*frame.to_geodetic(*stands), reference=True)
                and fence_ahead(fence, origin, *moving, reaches[name], less_m=fence.margin_m + SLACK_M) is None
            )

        return allowed

    def _bounds(self, actors: Iterable[VehicleActor]) -> MotionBounds:
        """Limits that all members can keep."""
        laws = [actor.config.control.law() for actor in actors]
        speed_mps = min(self.config.speed_mps / SPEED_SHARE, *(law.vel_xy_max_mps for law in laws))
        climb_mps = min(self.config.climb_mps / SPEED_SHARE, *(law.vel_z_max_mps for law in laws))
        return MotionBounds(speed_mps, climb_mps)

    def _leader(
        self,
        wanted: WantedFlight,
        starts: Mapping[str, Vector],
        lead: VehicleActor | None,
        bounds: MotionBounds,
        ratio: float,
        now: float,
    ) -> Leader:
        """The leader at the beginning: in the middle of all, where it is wanted, or where the vehicle is that leads."""
        names = list(starts)
        middle = wanted.at_enu_m or middle_of(list(starts.values()))
        if lead is not None:
            here = place(lead, now, fresh=True)
            if here is None:
                raise RefusedError(f"{lead.name} leads, and its position is not known, or old")
            if not is_flying(lead.vehicle, now):
                raise RefusedError(f"{lead.name} leads, and does not fly: `skygcs-cli takeoff {lead.name} 10` first")
            middle = here
        heading = wanted.heading_rad or 0.0
        if wanted.shape == CURRENT:
            # as they are, about the leader
            about = middle_of(list(starts.values())) if lead is None else middle
            offsets = {name: turned(minus(start, about), -heading) for name, start in starts.items()}
        else:
            shape = WantedFormation(wanted.shape, (0.0, 0.0, 0.0), 0.0, 1.0, wanted.spacing_m)
            points = list(shape.places(names, starts).values())
            if lead is not None:
                points = _behind(points, wanted)
            offsets = _assigned(names, starts, points, middle, heading, ratio)
        return Leader(Moving(middle), heading, bounds, offsets)

    def _require_room(self, leader: Leader, needed_m: Callable[[str, str], float], ratio: float) -> None:
        """Raises RefusedError where two places are nearer than the two vehicles may be."""
        places = leader.places_at(leader.moving.pos_enu_m, leader.wanted_yaw_rad, leader.wanted_scale)
        for a, b in itertools.combinations(sorted(places), 2):
            x, y, z = minus(places[a], places[b])
            away_m, least_m = math.hypot(x, y, z / ratio), needed_m(a, b)
            if away_m < least_m:
                raise RefusedError(
                    f"the places of {a} and {b} are {away_m:.1f} m apart, heights divided by {ratio:g}; they need "
                    f"{least_m:.1f} m: a larger spacing or scale, or a lower speed_mps of [formation]"
                )

    def _require_allowed(self, places: Mapping[str, Vector], allowed: Allowed) -> None:
        """Raises RefusedError where a vehicle may not stand at its place."""
        for name, at in places.items():
            if not allowed(name, Moving(at), at):
                x, y, z = at
                raise RefusedError(
                    f"the place of {name} ({x:.1f}, {y:.1f}, {z:.1f} m) is outside its control fence, or nearer to it "
                    "than its margin, or lower than lowest_m of [formation]"
                )

    def _end(self) -> None:
        """Nothing is sent any more. Idempotent."""
        self._client.leave()
        self._actors, self._numbers = {}, {}

    # -- while it flies

    def tick(self, now: float) -> None:
        """One step of the flight, and its setpoints."""
        flight = self.flight
        if flight is None or not self._actors or now <= self._stepped_at:
            return  # also at the moment of its begin: there are no rates over no time
        dt_s, self._stepped_at = now - self._stepped_at, now
        for name in flight.members:
            if (why := self._gone(name)) is not None:
                flight.leave(name, why)
        seen = {name: there for name in flight.members if (there := self._measured(self._actors[name], now))}
        references = flight.step(seen, self._led(flight, now), list(self._obstacles(self.keys, now)), dt_s, now)
        for name, (pos, vel, acc) in references.items():
            outcome = self.core.fleet.orders.setpoint(
                name, self._client, pos_enu_m=pos, vel_enu_mps=vel, acc_enu_mps2=acc, valid_s=VALID_S, program=self
            )[name]
            if not outcome.ok:
                flight.stop(f"{name}: {outcome.message}")
        if (flight.state, flight.reason) != self._reported:
            self._reported = flight.state, flight.reason
            if flight.state is not FormationState.FLYING:
                self._report(f"{flight.state.value}: {flight.reason}", {})
        if flight.state is FormationState.STOPPED:
            self._end()

    def _led(self, flight: FormationFlight, now: float) -> Moving | None:
        """Where the vehicle is that leads; None: it is not seen, or none leads. One that lands ends the flight: the
        others must not follow it down."""
        if flight.led_by is None:
            return None
        actor = next((a for a in self.core.fleet.vehicles.values() if a.name == flight.led_by), None)
        if actor is None:
            return None
        if not is_flying(actor.vehicle, now):
            flight.stop(f"{actor.name}, which leads, does not fly")
        return self._measured(actor, now)

    def _gone(self, name: str) -> str | None:
        """Why a member is not flown by this formation any more; None: it is."""
        actor = self._actors[name]
        if self.core.fleet.vehicles.get(actor.vehicle.key) is not actor:
            return "it was forgotten, or renumbered"
        if not actor.offboard.flying:
            controller = actor.offboard.controller
            return actor.offboard.successor or "; ".join(controller.reasons) or f"control is {controller.state.value}"
        # an order that it refuses, too: control holds it since (`keep`), and who gave it wants something else
        if actor.order_number != self._numbers[name] or actor.program is not self:
            return "it was given another order, or setpoints of a client"
        return None

    def _measured(self, actor: VehicleActor, now: float) -> Moving | None:
        """Where a vehicle is by its last position, carried on with its velocity; None: not known, or too old."""
        here, origin = place(actor, now, fresh=True), actor.vehicle.origin
        position, at = actor.vehicle.timed_telemetry("position")
        if here is None or position is None or at is None or origin is None or now - at > SEEN_S:
            return None
        vel = world_from_enu(tuple(position["vel_enu_mps"]), origin)
        age_s = max(0.0, now - at)
        return Moving((here[0] + vel[0] * age_s, here[1] + vel[1] * age_s, here[2] + vel[2] * age_s), vel)

    def _obstacles(self, members: frozenset[int], now: float) -> Iterable[Obstacle]:
        """Everything that the monitor watches or has lost, but the members."""
        assert self._origin is not None
        frame, tracks = EnuFrame(self._origin), self.core.fleet.monitor.monitor.tracks
        for key, track in (*tracks.tracks.items(), *tracks.lost.items()):
            if key not in members:
                yield _obstacle(track, frame, self._origin, now)

    @property
    def keys(self) -> frozenset[int]:
        flight = self.flight
        return (
            frozenset()
            if flight is None
            else frozenset(self._actors[name].vehicle.key for name in flight.members if name in self._actors)
        )

    def foreseen(self, key: int) -> list[Place]:
        """A member's backup: what it does if anything fails."""
        flight = self.flight
        name = next((name for name, actor in self._actors.items() if actor.vehicle.key == key), None)
        if flight is None or name is None or name in flight.left or self._origin is None:
            return []
        frame, steps = EnuFrame(self._origin), round(HORIZON_S / PLAN_STEP_S)
        return [frame.to_geodetic(*point) for point in flight.filter.backup(name, PLAN_STEP_S, steps)]

    # -- what is asked of it

    def flying(self) -> FormationFlight:
        """The formation that flies. Raises RefusedError without one."""
        flight = self.flight
        if flight is None or flight.state is not FormationState.FLYING:
            why = "" if flight is None or not flight.reason else f" (it stopped: {flight.reason})"
            raise RefusedError(f"no formation flies{why}: `skygcs-cli formation start` first")
        return flight

    def lead(self, demand: Demand) -> dict[str, Any]:
        """Move the virtual leader. Raises RefusedError for a leader that is a vehicle, or a place outside."""
        flight = self.flying()
        if flight.led_by is not None and not isinstance(demand, Stay):
            raise RefusedError(f"{flight.led_by} leads: fly that, or start the formation without a leader")
        self._follow_leader(flight)
        leader = flight.leader
        if (to := getattr(demand, "place_enu_m", None)) is not None:
            places = leader.places_at(to, leader.wanted_yaw_rad, leader.wanted_scale)
            self._require_allowed(places, flight.filter.allowed)
        leader.demand = demand
        return self.status()

    def guide(
        self, places: Mapping[str, Moving], valid_s: float, client: ClientIdentity, *, take_over: bool = False
    ) -> dict[str, Any]:
        """Fly members to a client's own places for so long. Raises RefusedError for who is no member, a place where it
        may not be, and places of another client (`StreamOwner`)."""
        flight = self.flying()
        if unknown := sorted(places.keys() - {*flight.members}):
            raise RefusedError(f"{', '.join(unknown)}: no members; there are {', '.join(flight.members)}")
        self._require_allowed({name: moving.pos_enu_m for name, moving in places.items()}, flight.filter.allowed)
        now = self.core.now()
        if (why := self._guide.refusal(client, valid_s, now, take_over=take_over)) is not None:
            raise RefusedError(why)
        flight.guide(places, now + valid_s)
        if (before := self._guide.followed(client, valid_s, now)) is not None:
            self._report(f"{client.name} has taken over from the places of {before.name}", {})
        return self.status()

    def _follow_leader(self, flight: FormationFlight) -> None:
        """An order leads it from now on, and no program's places."""
        flight.follow_leader()
        self._guide.ended("another order was given", self.core.now())

    def turn(self, heading_rad: float) -> dict[str, Any]:
        """Turn the formation about its leader."""
        flight = self.flying()
        self._follow_leader(flight)
        flight.leader.wanted_yaw_rad = math.remainder(heading_rad, math.tau)
        return self.status()

    def scale(self, factor: float) -> dict[str, Any]:
        """Scale all offsets. Raises RefusedError where two places would be too near."""
        flight = self.flying()
        self._follow_leader(flight)
        before, flight.leader.wanted_scale = flight.leader.wanted_scale, factor
        try:
            self._require_room(flight.leader, flight.filter.kept_m, flight.filter.downwash_ratio)
        except RefusedError:
            flight.leader.wanted_scale = before
            raise
        return self.status()

    def stop(self) -> dict[str, Any]:
        """Brake all; they stay under control, and hold."""
        self._stops += 1
        if self.flight is not None:
            self.flight.stop("asked for")
        return self.status()

    def status(self) -> dict[str, Any]:
        """The formation as formation.status answers it."""
        if self.flight is None:
            return {"state": "none", "members": []}
        return self.flight.status(self.core.now())

    def _report(self, text: str, data: dict[str, Any]) -> None:
        self.core.event_log.publish(Event(KIND, None, None, f"formation {text}", data))


class _Share(NamedTuple):
    """The part of one member in the distance of each of its pairs."""

    radius_m: float
    """All of it."""
    footprint_m: float
    """Its size and the error of its position."""
    tube_m: float
    """How far it may be from its reference, as it is measured: what the distance allows for, and the error of the
    position by which that is judged."""


def _share(rule: MarginRule, name: str, motion: Motion) -> _Share:
    terms = rule.terms(name, motion)
    off_m = math.fsum(metres for term, metres in terms.items() if term in OFF_REFERENCE)
    radius_m = math.fsum(terms.values())
    known = rule.by_vehicle.get(name, rule.uncertainty)
    return _Share(radius_m, radius_m - off_m, off_m + known.position_error_m)


def _obstacle(track: Track, frame: EnuFrame, origin: Origin, now: float) -> Obstacle:
    """A vehicle as the monitor knows it, carried on to now."""
    here, vel = frame.from_ecef(track.ecef_m), (0.0, 0.0, 0.0)
    footprint, age_s = track.footprint, 0.0 if track.parked else max(0.0, now - track.at)
    if not track.parked and not track.lost:
        vel = world_from_enu(track.reported_mps, origin)
        here = (here[0] + vel[0] * age_s, here[1] + vel[1] * age_s, here[2] + vel[2] * age_s)
    radius_m = footprint.wingspan_m / 2 + footprint.position_error_m + footprint.ball_m(min(age_s, HORIZON_S))
    return Obstacle(track.name, here, vel, radius_m)


def _assigned(
    names: Sequence[str],
    starts: Mapping[str, Vector],
    points: Sequence[Vector],
    middle: Vector,
    heading: float,
    ratio: float,
) -> dict[str, Vector]:
    """A point of the shape for each vehicle, so that they cross each other little on their way."""
    goals = [_plus(middle, turned(point, heading)) for point in points]
    order = assigned([starts[name] for name in names], goals, ratio)
    return {name: points[index] for name, index in zip(names, order, strict=True)}


def _behind(points: Sequence[Vector], wanted: WantedFlight) -> list[Vector]:
    """The points behind a vehicle that leads: the foremost is a spacing behind it."""
    foremost = max(point[0] for point in points)
    return [(x - foremost - wanted.spacing_m, y, z) for x, y, z in points]


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
