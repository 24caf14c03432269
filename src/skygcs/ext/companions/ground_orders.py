"""On the companion: carries out what the ground relays, reports its control, and acts when the ground is lost.

What becomes of each order is decided in `order_book`, the loss of the ground in `ground_contact`.
Nothing here ever begins control by itself, or takes a vehicle back from a pilot.
"""

from __future__ import annotations

import asyncio
import math
import secrets
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from skygcs.core.geo import Origin
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory import Trajectory
from skygcs.core.trajectory.trajectory_clock import MAX_NOTED, STOP_ROOM, ClockOrder, ReplicatedClock
from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.core.vehicle.trajectory_flight import LoadedTrajectory, StartTube, TrajectoryFlight
from skygcs.errors import RefusedError, SkygcsError, TrajectoryError
from skygcs.events import Event
from skygcs.ext.companions import wire
from skygcs.ext.companions.ground_contact import GROUND_LINK, Action, GroundContact, GroundLost
from skygcs.ext.companions.order_book import Fresh, Known, OrderBook
from skygcs.links.base import Channel
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.offboard_engagement import VALID_S, OffboardEngagement
from skygcs.runtime.order_runner import UNHEARD
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.trajectories import LARGE_PIECES, LATEST_START_S, MAX_PIECES
from skygcs.runtime.vehicle_actor import VehicleActor

GCS_TYPE = 6
"""MAV_TYPE_GCS in a HEARTBEAT."""

MAX_TRAJECTORIES = 64
"""Kept for a start: a plan has one for each of its steps."""

PLACED = StartTube(5.0, 2.0)
"""The ground has compared the place with its certificate; farther than this it has another frame."""

LATE_START_S = 0.2
"""A trajectory that is to begin together with others begins no later than this: its first reference would jump by
speed times this, which no vehicle at rest there notices."""

MAX_SETPOINT_AGE_S = 2.0
"""A setpoint that is older was overtaken by what has happened since."""

RETURN: Mapping[Action, Callable[[VehicleActor], Awaitable[Outcome]]] = {
    "return": VehicleActor.rtl,
    "hold": VehicleActor.hold,
    "land": VehicleActor.land,
}

RELAYED_MOVES = frozenset({"engage", "hand_over", "taken_over", "keep", "release", "goto", "start"})
"""Orders that move the vehicle: an older one than the newest is not carried out. Not "clock": it names the flight that
it is about, and counts for as long as that is flown; if it comes before the start of that, it waits for it."""

MAX_CLOCK_ORDERS = MAX_NOTED + STOP_ROOM

Json = dict[str, Any]


@dataclass(slots=True)
class FollowedTrajectory:
    """``number`` of the order that began it; ``noted``: of the newest order to its clock."""

    number: int
    clock: ReplicatedClock
    flight: TrajectoryFlight | None = None
    """None: it has not begun."""
    noted: int = 0

    def note(self, orders: Mapping[int, ClockOrder], now: float) -> str:
        """Orders to its clock by their numbers, of which it may have some; which it did not have. Raises
        RefusedError."""
        done = []
        for number in sorted(n for n in orders if n > self.noted):
            self.clock.note(orders[number])
            self.noted = number
            late_s = now - orders[number].at_s
            done.append(orders[number].kind + (f", {late_s:.2f} s too late" if late_s > 0.0 else ""))
        return "; ".join(done)


class GroundOrders:
    """Orders to the companion's one vehicle, by its name in the companion's file. Call `tick` five times a second."""

    def __init__(
        self,
        vehicle: str,
        lost: GroundLost,
        lost_s: float,
        fleet: Fleet,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
    ) -> None:
        """``lost``: what is done ``lost_s`` after the last contact with the ground."""
        self.contact_watch = GroundContact(lost, lost_s)
        self.book = OrderBook(secrets.token_hex(4), lost_s)
        self._vehicle = vehicle
        self._fleet = fleet
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event)
        self._under_way: dict[tuple[str, int], asyncio.Task[Outcome]] = {}
        """Orders being carried out, by ground and number."""
        self._parts = wire.TrajectoryParts(MAX_PIECES)
        self._loaded: OrderedDict[str, LoadedTrajectory] = OrderedDict()
        self._followed: FollowedTrajectory | None = None
        self._early: tuple[int, dict[int, ClockOrder]] = 0, {}
        """A flight whose start has not come yet, and the orders to its clock that have."""
        self._handed_over: str | None = None
        """The order of the ground that takes over, or took over last."""
        self._client = ClientIdentity(lambda: "the ground")
        """The owner of the streams that the ground relays; another one for each ground."""
        self._ground_ids: tuple[int, int] | None = None
        """System and component id of the ground that has the companion."""
        self._heartbeat_at = -math.inf

    # -- what the ground calls

    def contact(self, ground: str, ids: tuple[int, int]) -> Json:
        """A ground is there: the report of the companion's control. ``ids``: of its heartbeats."""
        before, actor = self.book.ground, self._actor()
        refused = self.book.contact(ground, self._loop.time())
        if refused is None:
            self._ground_ids = ids
        if self.book.ground != before:
            self._forget_ground(actor)
        return {**self.report(), "refused": refused}

    async def order(self, ground: str, session: str, number: int, until_s: float, order: str, given: Json) -> Json:
        """Carry out one order, or return the outcome of an earlier one with this number."""
        now = self._loop.time()
        moves = order in RELAYED_MOVES
        admitted = self.book.admit(ground, session, number, moves=moves, until_s=until_s, now=now)
        match admitted:
            case Fresh():
                self.book.contact(ground, now)
                task = self._tasks.start(self._carried_out(ground, number, order, given), f"relayed {order}")
                self._under_way[ground, number] = task
                task.add_done_callback(lambda _: self._under_way.pop((ground, number), None))
                outcome = await asyncio.shield(task)
            case Known(outcome=None):
                task_ = self._under_way.get((ground, number))
                outcome = Outcome.refused("it was given up") if task_ is None else await asyncio.shield(task_)
            case Known(outcome=known):
                assert known is not None
                outcome = known
            case refused:
                outcome = Outcome.refused(refused.why)
        return {"outcome": outcome.as_dict(), "report": self.report()}

    def setpoint(self, ground: str, session: str, number: int, at_s: float, valid_s: float, given: Json) -> Json:
        """One setpoint of a stream, given at ``at_s`` of the companion's clock; the newest number wins."""
        now = self._loop.time()
        outcome = self._setpoint(ground, session, number, at_s, valid_s, given, now)
        return {"outcome": outcome.as_dict(), "report": self.report()}

    def report(self) -> Json:
        """The companion's control now."""
        now, actor = self._loop.time(), self._actor()
        base: Json = {
            "session": self.book.session,
            "now_s": now,
            "newest": self.book.newest_moving,
            "ground_lost": self.contact_watch.state.value,
            "origin": wire.origin_json(self._fleet.origin),
            "control": None,
        }
        if actor is None:
            return base
        engagement = _engagement(actor)
        tracking, followed = engagement.tracking, self._followed
        follows = followed is not None and engagement.controller.flight is followed.flight
        return base | {
            "control": actor.control_state(now),
            "flight": followed.number if follows and followed is not None else None,
            "gains": engagement.gains(),
            "guard_falls": dict(engagement.controller.guard_falls),
            "tracking": {
                "tracking_error_m": tracking.tracking_error_m,
                "measured_s": tracking.measured_s,
                "delay_s": tracking.delay_s,
                "round_trips": tracking.round_trips,
            },
        }

    # -- as frames and time come

    def on_heartbeat(self, frame: Frame, channel: Channel, now: float) -> None:
        """A HEARTBEAT of any link: the ground's own counts as contact. Its ids prove nothing, as every station has the
        same by default: it has to come over the link to the ground, or signed with the key of its link."""
        ours = channel.link.name == GROUND_LINK or (frame.signed and channel.signing is not None)
        if ours and (frame.sysid, frame.compid) == self._ground_ids and frame.fields().get("type") == GCS_TYPE:
            self._heartbeat_at = now

    def tick(self, now: float) -> None:
        """Act if the ground is lost."""
        actor = self._actor()
        if actor is None or self.book.ground is None:
            return
        engagement, followed = _engagement(actor), self._followed
        if followed is not None and engagement.controller.flight is not followed.flight:
            self._followed = None
        contact_at = max(self.book.contact_at, self._heartbeat_at)
        watch, before = self.contact_watch, self.contact_watch.state
        silent_s = watch.silence_s(now, contact_at)
        flight = engagement.controller.flight
        ends_at_s = None if flight is None else flight.clock.finishes_at_s(now)  # a paused one never ends by itself
        follows = ends_at_s is not None and ends_at_s > now
        action = watch.tick(now, controlled=engagement.controller.active, follows=follows, contact_at=contact_at)
        if watch.state is not before and watch.lost:
            what = f"it is ordered to {action}" if action is not None else watch.state.value
            text = f"the ground is lost, silent for {silent_s:.1f} s: {what}"
            data = {"state": watch.state.value, "action": action}
            self._on_event(Event("ground_lost", actor.name, actor.sysid, text, data))
        if action is not None:
            self._tasks.start(self._act(actor, action), f"{action} without the ground")

    def close(self) -> None:
        """Cancel what is under way."""
        self._tasks.close()

    # -- the inside

    def _forget_ground(self, actor: VehicleActor | None) -> None:
        """Another ground has the companion: the one before will not say how the order that takes over has ended, and
        its numbers name no trajectory any more."""
        if actor is not None:
            self._keep(_engagement(actor), "the ground that gave it is gone")
        self._handed_over, self._followed, self._early = None, None, (0, {})
        self._client.leave()
        self._client = ClientIdentity(lambda: "the ground")

    def _keep(self, engagement: OffboardEngagement, why: str) -> None:
        """The ground's order takes over no more; another order that does, as one of the companion's own, goes on."""
        if self._handed_over is not None and engagement.successor == self._handed_over:
            engagement.keep(why)

    def _actor(self) -> VehicleActor | None:
        return next((actor for actor in self._fleet.vehicles.values() if actor.name == self._vehicle), None)

    def _known(self) -> VehicleActor:
        actor = self._actor()
        if actor is None or not actor.vehicle.connected:
            raise RefusedError("the companion does not hear its vehicle's autopilot")
        return actor

    async def _act(self, actor: VehicleActor, action: Action) -> None:
        outcome = await RETURN[action](actor)
        if not outcome.ok:
            then = "whether it does is not known" if outcome.result in UNHEARD else "its own failsafe has to act"
            text = f"without the ground it was ordered to {action}, but: {outcome.message}; {then}"
            self._on_event(Event("ground_lost", actor.name, actor.sysid, text, {"action": action}))

    async def _carried_out(self, ground: str, number: int, order: str, given: Json) -> Outcome:
        outcome = Outcome(False, "cancelled", "the companion's skygcs is shutting down")
        try:
            outcome = await self._carry_out(number, order, given)
        except (RefusedError, TrajectoryError) as error:
            outcome = Outcome.refused(str(error))
        except SkygcsError as error:
            outcome = Outcome(False, "failed", str(error))
        except Exception as error:
            outcome = Outcome(False, "failed", f"failed inside the companion's skygcs: {error!r}")
            raise
        finally:
            self.book.ended(ground, number, outcome)
        return outcome

    async def _carry_out(self, number: int, order: str, given: Json) -> Outcome:
        # orders that need no vehicle
        match order:
            case "origin":
                return self._take_origin(wire.origin_from(given.get("origin")))
            case "pieces":
                return await self._take_pieces(given)
        # orders to the vehicle's control
        actor = self._known()
        engagement = _engagement(actor)
        match order:
            case "engage":
                self._take_origin(wire.origin_from(given.get("origin")))
                self._keep(engagement, "control is set anew")  # the ground sets it after the end of its hand-over
                return await actor.control(str(given.get("mode")), force=given.get("force") is True)
            case "hand_over" | "taken_over" | "keep" | "release":
                self._end(actor, engagement, order, f"the ground: {given.get('reason')}"[:200])
                return Outcome(True, "accepted", "")
            case "goto":
                place = wire.setpoint_from({"place": given.get("place"), "yaw_enu_rad": given.get("yaw_enu_rad")})
                if place.place is None:
                    raise RefusedError("a goto has a place")
                outcome = await engagement.fly_to(place.place, place.yaw_enu_rad)
                return self._led(actor, outcome, "the ground ordered a goto")
            case "gains":
                changes = given.get("changes")
                return await actor.change_gains(
                    changes=changes if isinstance(changes, dict) else {}, force=given.get("force") is True
                )
            case "record":
                path = await engagement.record(given.get("on") is True)
                return Outcome(True, "accepted", path or "")
            case "start":
                return self._led(actor, self._start(engagement, number, given), "the ground started a trajectory")
            case "clock":
                return self._order_clock(engagement, given)
        raise RefusedError(f"the companion knows no order {order!r}; is its skygcs older?")

    def _end(self, actor: VehicleActor, engagement: OffboardEngagement, order: str, reason: str) -> None:
        """The ground ends control, or hands it over to an order that it sends by MAVLink and says how that has ended.
        ``taken_over`` and ``keep`` may come before the hand-over, which is older then, and not admitted any more."""
        match order:
            case "hand_over":
                self._handed_over = reason
                engagement.hand_over(reason)
            case "keep":
                self._keep(engagement, reason)
            case _:
                engagement.release(reason)
        if order == "taken_over":
            actor.unattended.watch.on_station("the ground", "place", self._loop.time())

    def _led(self, actor: VehicleActor, outcome: Outcome, how: str) -> Outcome:
        """Return the outcome of an order of the ground, which leads it from now on if it is accepted. The ground itself
        knows which of its clients has lost it."""
        if outcome.ok:
            actor.stream.ended(how, spares=self._client)
        return outcome

    def _take_origin(self, origin: Origin | None) -> Outcome:
        """The ground's origin, in which its trajectories are. Raises RefusedError, which names both."""
        ours = self._fleet.origin
        if origin is None or origin == ours:
            return Outcome(True, "accepted", "the origins agree")
        try:
            self._fleet.set_origin(origin)
        except RefusedError as error:
            raise RefusedError(f"the ground's origin is {origin}, the companion's {ours}: {error}") from None
        return Outcome(True, "accepted", "the companion has the ground's origin")

    def _setpoint(
        self, ground: str, session: str, number: int, at_s: float, valid_s: float, given: Json, now: float
    ) -> Outcome:
        if (answered := self.book.admit_setpoint(ground, session, number)) is not None:
            return answered
        self.book.contact(ground, now)
        age_s = now - at_s
        if not age_s <= MAX_SETPOINT_AGE_S:  # also for NaN
            return Outcome.refused(f"it is {age_s:.1f} s old: the way to the companion is too slow for a stream")
        try:
            actor = self._known()
            engagement = _engagement(actor)
            raw = given.get("raw")
            if isinstance(raw, dict):
                left_s = valid_s - max(age_s, 0.0)  # nothing moves it on, as a place is: it is of its time
                if left_s < VALID_S[0]:
                    return Outcome.refused(
                        f"it is {age_s:.2f} s old and valid for {valid_s:g} s: give a longer valid_s"
                    )
                valid_s, follow = left_s, partial(engagement.follow_raw, wire.raw_from(raw), left_s)
            else:
                wanted = wire.setpoint_from(given)
                follow = partial(engagement.follow, wanted, valid_s, given_at=min(at_s, now))
        except RefusedError as error:
            return Outcome.refused(str(error))
        return actor.stream.follow(self._client, valid_s, follow, take_over=given.get("take_over") is True)

    async def _take_pieces(self, given: Json) -> Outcome:
        """One part of a trajectory; with the last one it is kept."""
        key, part, parts = str(given.get("key"))[:32], given.get("part"), given.get("parts")
        pieces = self._parts.take(key, part, parts, given.get("pieces"))
        if pieces is None:
            return Outcome(True, "accepted", f"part {given['part'] + 1} of {parts}; others are still to come")
        whole = Trajectory(pieces)
        name = str(given.get("name") or "trajectory")[:64]
        if len(whole.pieces) < LARGE_PIECES:
            loaded = LoadedTrajectory(whole, name)
        else:
            loaded = await asyncio.to_thread(LoadedTrajectory, whole, name)
        self._loaded[key] = loaded
        while len(self._loaded) > MAX_TRAJECTORIES:
            self._loaded.popitem(last=False)
        return Outcome(True, "accepted", f"{name}: {len(whole.pieces)} pieces")

    def _start(self, engagement: OffboardEngagement, number: int, given: Json) -> Outcome:
        """Begin a trajectory that was sent before, on a replica of the ground's clock."""
        loaded = self._loaded.get(str(given.get("key"))[:32])
        if loaded is None:
            raise RefusedError("the companion does not have this trajectory: load it again")
        now, at_s, speed = self._loop.time(), wire.required(given, "at_s"), wire.required(given, "speed_factor")
        if not now - LATE_START_S <= at_s <= now + LATEST_START_S:
            raise RefusedError(f"its start was {now - at_s:.1f} s ago when the order came: it begins with all or not")
        self._take_origin(wire.origin_from(given.get("origin")))
        if (lock := engagement.lock) is None:
            raise RefusedError("control is off")
        tube = PLACED if given.get("placed") is True else None
        if (why := engagement.trajectory_refusal(loaded, speed, lock, tube)) is not None:
            raise RefusedError(why)
        clock = ReplicatedClock(
            wire.required(given, "duration_s"),
            wire.required(given, "rate_limit_per_s"),
            speed_factor=speed,
            rests_at_start=given.get("rests_at_start") is True,
            rests_at_end=given.get("rests_at_end") is True,
        )
        clock.start(now, max(now, at_s))
        followed, (flight, early) = FollowedTrajectory(number, clock), self._early
        if flight == number:
            followed.note(early, now)
        followed.flight = engagement.follow_trajectory(loaded, clock, lock)
        self._followed = followed
        return Outcome(True, "accepted", f"{loaded.name} begins in {at_s - now:.1f} s")

    def _order_clock(self, engagement: OffboardEngagement, given: Json) -> Outcome:
        """Orders of the ground's clock, for its replica: those that it does not have yet. If the start of the flight
        has not come, they are kept for it."""
        followed, flight, listed = self._followed, given.get("flight"), given.get("orders")
        if not isinstance(listed, list) or len(listed) > MAX_CLOCK_ORDERS:
            raise RefusedError(f"a clock gets a list of up to {MAX_CLOCK_ORDERS} orders")
        orders = dict(wire.clock_order_from(values) for values in listed)
        if type(flight) is int and flight > self.book.newest_moving:
            kept = {**(self._early[1] if self._early[0] == flight else {}), **orders}
            if len(kept) > MAX_CLOCK_ORDERS:
                raise RefusedError(f"{MAX_CLOCK_ORDERS} orders to the clock wait for the start already")
            self._early = flight, kept
            return Outcome(True, "accepted", "it waits for the start of the trajectory")
        if followed is None or followed.number != flight or engagement.controller.flight is not followed.flight:
            raise RefusedError("it does not follow this trajectory any more")
        return Outcome(True, "accepted", followed.note(orders, self._loop.time()))


def _engagement(actor: VehicleActor) -> OffboardEngagement:
    """Raises RefusedError if the companion's own file has control elsewhere."""
    if not isinstance(actor.offboard, OffboardEngagement):
        raise RefusedError("the companion's own file says control.at = companion: remove that key there")
    return actor.offboard
