"""Brings vehicles home that are ordered to return: those whose ways conflict leave one after another.

Who leaves, climbs or waits is decided by `core.monitor.departures`; here the decision meets orders, telemetry and time.
A vehicle that is not ordered to return is in the way where it is, and on its way to where it was sent; one that comes
home by itself has a way of its own. A single vehicle waits only if something is in its way, and leaves when it is
ordered again. The steps of one that has to return (`Step`):

    step     what it does                            next
    ------   -------------------------------------   -------------------------------------------------------------
    GOES_ON  flies on where it was sent: somebody    HOLDS, once nobody does, it is there, or after `GOES_ON_S`
             flies to where it would come to rest
    HOLDS    its hold is being sent                  WAITS; LEAVES, if it cannot hold
    WAITS    holds, until its way home is clear      CLIMBS, LEAVES; given up: goes on holding, or lands (``at_end``)
    CLIMBS   is being sent up, where it stands       WAITS
    LEAVES   its return is being sent; the others    on its way; WAITS, if it did not take that and has waited
             stay clear of its way, not its place    before

In WAITS, and before each order, it may turn out that something else has taken it. Then it is left to that, and its way
or its place is kept free:

    another order that went out, not refused by it   taken; meanwhile nothing is ordered
    another order that it refused                    goes on; so it does after a hold of the daemon's own, after a pause
    its own return or landing, as by its failsafe    taken
    another mode, by its pilot or another station    taken
    it is down, or was forgotten                     taken
    it is not heard                                  nothing is ordered until it is, or it is given up
    another order to return                          waits or leaves by that one; if that one fails, as before
    the daemon ends, or stood still                  goes on holding

One that is not heard counts where it was, and on its way home. After a fault in the decision they return one at a time:
nothing is known of their ways. Each end of a wait is an event of order "rtl".
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import partial
from typing import Literal

from skygcs.core.monitor.conflict_levels import COMING_HOME, LANDING, RETURNING
from skygcs.core.monitor.departures import (
    ASIDE_M,
    AT_A_TURN,
    MOVED_M,
    STUCK_S,
    Departures,
    Progress,
    Returning,
    departing,
    is_placed,
    one_at_a_time,
    why_not_held,
)
from skygcs.core.monitor.tracks import is_flying
from skygcs.core.monitor.ways import Way
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.orders import Where, goto
from skygcs.events import Event
from skygcs.runtime.return_members import TAKES_S, ReturnMembers, frame_at
from skygcs.runtime.separation_monitor import SeparationMonitor
from skygcs.runtime.task_set import TaskSet, in_turns
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import OnEvent
from skygcs.spelling import enumerated

PERIOD_S = 0.5

SAME_S = 1.0
"""An order to return that comes again within this, as by a double click, is the same one and insists on nothing."""

AGAIN_S = 5.0
"""After an order to one that waits which it did not take."""

HELD_S = 10.0
"""After a hold of the daemon's own, as for its distance to another: that other one has passed by then, or is held."""

GOES_ON_S = 30.0
"""Longest flight of one that may not stop before others: 150 m of a goto. Then it holds, as it was ordered."""

AtEnd = Literal["hold", "land"]

HOLDS_IN = frozenset({"AUTO.LOITER", "GUIDED", "BRAKE"})
"""Modes of a PX4 and of an ArduCopter in which an order to hold leaves it."""

NEWER = "it does not return by this order: a newer order took its place"


class Step(Enum):
    """See the table of this module."""

    GOES_ON = auto()
    HOLDS = auto()
    WAITS = auto()
    CLIMBS = auto()
    LEAVES = auto()


@dataclass(slots=True, eq=False)
class Waiting:
    """A vehicle that is one of several that return. ``serial``: of the order to return."""

    actor: VehicleActor
    serial: int
    asked_at: float
    at_end: AtEnd
    told: tuple[str, ...]
    step: Step
    begun: bool = False
    """The order by which it was decided is being carried out."""
    over: str = NEWER
    """Why it does not return by this order, once it is not waited for any more."""
    has_waited: bool = False
    """It holds by an order of ours already."""
    order_number: int = 0
    """The last order to it that was ours, or that counts for nothing."""
    goal_m: float | None = None
    """Height to which it was sent to climb, in the common frame."""
    retry_at: float = -math.inf
    custom_mode: int | None = None
    """The mode that our hold, or our climb, left it in."""
    ordered_at: float = -math.inf
    """When that ended."""
    behind: Sequence[str] = ()
    """Names of those that fly to where it would come to rest."""
    hint: str = ""
    """Added to what is said of its wait: how a person ends it."""

    @property
    def holds_first(self) -> bool:
        return self.step is not Step.LEAVES

    @property
    def stays(self) -> str:
        """Text of what it does while it does not return."""
        return "it flies on where it was sent" if self.step is Step.GOES_ON else "it holds"


Begun = dict[VehicleActor, Waiting]


class Returns:
    """Returns under way of one fleet: `begin`, `carry_out` and `run` with each order to return. ``vehicles``: all of
    the fleet, by key."""

    def __init__(
        self,
        monitor: SeparationMonitor,
        vehicles: Mapping[int, VehicleActor],
        loop: asyncio.AbstractEventLoop,
        on_event: OnEvent,
    ) -> None:
        self._monitor = monitor
        self._vehicles = vehicles
        self._loop = loop
        self._on_event = on_event
        self._tasks = TaskSet(loop, on_event)
        self._waiting: dict[int, Waiting] = {}
        self._members = ReturnMembers(monitor, loop, self._tasks, self._goal_m)
        self._deciding = asyncio.Lock()
        self._running: asyncio.Task[None] | None = None
        self._progress = Progress()
        self._given_up: dict[int, tuple[int, float]] = {}
        """By key, the last order that had an effect as it was given up, and when the return was ordered."""
        self._fenced: tuple[str, ...] = ()
        """Names of those that would have to climb out of their own fences."""
        self._fault: str | None = None
        """The fault that was reported last."""

    async def begin(self, actors: Sequence[VehicleActor], serial: int, *, at_end: AtEnd = "hold") -> Begun:
        """Decide which of these have to wait. Those that are returned are to be given to `carry_out` now, and to `run`
        afterwards; the others are to be ordered to return now. Orders to return are decided in the order in which they
        came, so that the last one counts. ``at_end``: what those do whose way does not become clear. After a fault here
        each returns at once."""
        self._fault = None
        try:
            async with self._deciding:
                return await self._begin(actors, serial, at_end)
        except Exception as error:
            self._report_fault("who waits for whom: each returns at once, by itself; it", error)
            return {}

    async def _begin(self, actors: Sequence[VehicleActor], serial: int, at_end: AtEnd) -> Begun:
        now = self._loop.time()
        known = [actor for actor in actors if is_placed(actor.vehicle, now)]
        if not known:
            return {}
        alone = known[0] if len(known) == 1 else None
        if alone is not None and self._is_insisted_on(alone):
            self._join(alone)
            return {}
        # a repeated order keeps those that have already left as members
        if not self._waiting:
            self._members.begin_round(frame_at(known[0].vehicle))
            self._given_up = {key: one for key, one in self._given_up.items() if key in self._vehicles}
        self._members.add(known)
        begun = await self._change_ways(known, serial, at_end)
        free = [actor for actor in known if why_not_held(actor.vehicle) is None and not self._leaves(actor)]
        decided = await self._decide(free, alone=alone is not None)
        if alone is not None and alone.vehicle.key in decided.leave:
            self._join(alone)
            return {}
        # those of an older order to return go on as before if this one fails
        holding = [actor for actor in free if actor.vehicle.key in decided.waits_for]
        followed = await self._members.followed(holding)
        for actor in free:
            key = actor.vehicle.key
            if key not in decided.leave and key not in decided.waits_for:
                continue
            step = Step.LEAVES if key in decided.leave else Step.HOLDS
            waits = Waiting(actor, serial, now, at_end, decided.waits_for.get(key, ()), step)
            if alone is not None:
                waits.hint = f"; ordered again (skygcs-cli rtl {actor.name}), it returns at once"
            older = self._waiting.get(key)
            if step is Step.HOLDS and key in followed:
                waits.step, waits.behind = Step.GOES_ON, followed[key]
            if older is not None and older.actor is actor and older.has_waited:
                waits.asked_at = older.asked_at
                waits.has_waited, waits.order_number = True, older.order_number
                waits.goal_m, waits.custom_mode = older.goal_m, older.custom_mode
            if step is Step.LEAVES:
                self._members.leaves_now(actor)
            self._waiting[key] = begun[actor] = waits
        return begun

    async def _change_ways(self, known: Sequence[VehicleActor], serial: int, at_end: AtEnd) -> Begun:
        """Those that must not be held, as they come down, or in a failsafe: each leaves now, or goes on as it does, and
        is returned. The next one is decided with the way of the last one. What flies home by such an order is on its
        way; so is what is in a failsafe if nobody is there to insist."""
        going_on: Begun = {}
        for actor in known:
            key, mode = actor.vehicle.key, actor.vehicle.mode
            if why_not_held(actor.vehicle) is None and not self._leaves(actor):
                continue
            leaves = self._leaves(actor) or mode in RETURNING or (at_end == "land" and mode not in LANDING)
            decided = Departures() if leaves else await self._decide((actor,), alone=True)
            if (names := decided.waits_for.get(key)) is None:
                self._members.leaves_now(actor)
                continue
            over = f"it goes on in {mode}, as its way home is not clear of {enumerated(names)}, and does not return; "
            over += f"ordered again (skygcs-cli rtl {actor.name}), it returns at once"
            going_on[actor] = Waiting(actor, serial, self._loop.time(), at_end, names, Step.HOLDS, over=over)
            self._note_given_up(going_on[actor])
            self._report(actor, over, given_up=True)
        return going_on

    async def carry_out(self, waits: Waiting) -> Outcome:
        """The order to return of one of those of `begin`: it leaves, or holds until its way is clear. One that cannot
        hold returns at once."""
        if not self._is_current(waits):
            return Outcome(False, "cancelled", waits.over)
        waits.begun = True
        try:
            return await (self._hold_first(waits) if waits.holds_first else self._return_now(waits))
        finally:
            if waits.step in (Step.HOLDS, Step.LEAVES):
                self._put_back(waits)

    def run(self, begun: Iterable[Waiting] = ()) -> None:
        """Go on with those that wait, if there are any; ``begun``: of `begin`, of which each has been carried out that
        ever will be. Idempotent."""
        for waits in begun:
            if not waits.begun:
                self._put_back(waits)
        if self._waiting and (self._running is None or self._running.done()):
            self._running = self._tasks.start(self._bring_home(), "returns one after another")

    def _is_insisted_on(self, actor: VehicleActor) -> bool:
        """True if this one was ordered to return, and waits, or was given up: it is ordered again, alone."""
        key, now = actor.vehicle.key, self._loop.time()
        again = self.waits(key) and now - self._waiting[key].asked_at >= SAME_S
        order, at = self._given_up.get(key, (None, now))
        return again or (order == actor.runner.ledger.effective and now - at >= SAME_S)

    def _note_given_up(self, waits: Waiting) -> None:
        """It does not return by this order; it does by the next one, unless another order has an effect before."""
        key, order = waits.actor.vehicle.key, waits.actor.runner.ledger.effective
        if self._given_up.get(key, (None,))[0] != order:
            self._given_up[key] = order, waits.asked_at

    def _join(self, actor: VehicleActor) -> None:
        """A single vehicle is sent home: those that wait, or are to, keep clear of its way, too."""
        self._leave_out_gone()
        self._members.add((actor,))
        self._members.leaves_now(actor)

    def waits(self, key: int) -> bool:
        """True if the vehicle holds, climbs or flies on until it is sent home by this round."""
        waits = self._waiting.get(key)
        return waits is not None and (waits.has_waited or waits.step is Step.GOES_ON)

    def end(self, why: str) -> None:
        """End the returns: those that wait go on holding."""
        self._let_go(why)
        self._running = None
        self._tasks.close()

    def _let_go(self, why: str) -> None:
        for waits in self._waiting.values():
            waits.over = f"cancelled: {why}"
            text = f"{why}: {waits.stays} and does not return"
            if not waits.begun:
                text = waits.over
            elif waits.step is Step.LEAVES:
                text = f"{why}: whether it takes its order to return is not known"
            self._report(waits.actor, text, given_up=True)
        self._waiting.clear()

    def close(self) -> None:
        """The daemon ends."""
        self.end("skygcs ends")

    # -- the order of a person

    async def _hold_first(self, waits: Waiting) -> Outcome:
        actor = waits.actor
        if (why := why_not_held(actor.vehicle)) is not None:  # it began after the decision, and must not be stopped
            return self._spared(waits, why)
        if waits.step is Step.GOES_ON:
            return self._go_on(waits)
        are = "is" if len(waits.told) == 1 else "are"
        text = f"it holds until {enumerated(waits.told)} {are} out of its way home, and returns then{waits.hint}"
        goes_on = actor.order_number == waits.order_number and actor.vehicle.custom_mode == waits.custom_mode
        if waits.has_waited and goes_on:  # by the order before
            waits.step = Step.WAITS
            actor.runner.precedence.note_effect()
            self._report(actor, text)
            return Outcome(True, "accepted", text, order_number=waits.order_number)
        outcome = await actor.hold(spares=COMING_HOME)
        if not self._is_current(waits):
            return replace(outcome, ok=False, result="cancelled", message=waits.over) if outcome.ok else outcome
        if outcome.ok:
            waits.goal_m = None  # if it was climbing, that has ended
            self._ordered(waits, outcome)
            self._report(actor, text)
            return replace(outcome, message=text)
        if actor.vehicle.mode in COMING_HOME:
            return self._spared(waits, f"it is in {actor.vehicle.mode}")
        if outcome.result == "cancelled" or waits.has_waited:
            return outcome
        waits.step = Step.LEAVES
        self._members.leaves_now(actor)
        return await self._return_now(waits)

    def _go_on(self, waits: Waiting) -> Outcome:
        """It flies on where it was sent, and holds later (`_hold_those_that_may`)."""
        actor = waits.actor
        fly = "flies" if len(waits.behind) == 1 else "fly"
        text = (
            f"it flies on while {enumerated(waits.behind)} {fly} to where it would stop, at most {GOES_ON_S:g} s; then "
            f"it holds until {enumerated(waits.told)} {'is' if len(waits.told) == 1 else 'are'} out of its way home, "
            f"and returns{waits.hint}"
        )
        waits.order_number, waits.custom_mode = actor.order_number, actor.vehicle.custom_mode
        actor.runner.precedence.note_effect()
        self._report(actor, text)
        return Outcome(True, "accepted", text, order_number=waits.order_number)

    async def _hold_those_that_may(self) -> None:
        """Hold those that flew on, once nobody flies to where they stop."""
        now = self._loop.time()
        going = [waits for waits in self._waiting.values() if waits.step is Step.GOES_ON and waits.begun]
        going = [waits for waits in going if self._is_ours(waits)]
        followed = await self._members.followed([waits.actor for waits in going])
        for waits in going:
            late = now - waits.asked_at > GOES_ON_S
            if (late or waits.actor.vehicle.key not in followed) and self._is_current(waits):
                self._start(waits, Step.HOLDS, partial(waits.actor.hold, spares=COMING_HOME))

    def _spared(self, waits: Waiting, why: str) -> Outcome:
        """Drop a vehicle that was to wait but goes home by itself; returns its outcome."""
        self._drop(waits, f"it does not wait: {why}")
        return Outcome(False, "cancelled", f"it is not held to wait for its return: {why}")

    async def _return_now(self, waits: Waiting) -> Outcome:
        outcome = await waits.actor.rtl()
        if outcome.ok and self._is_current(waits):
            self._gone(waits)
        return outcome

    def _put_back(self, waits: Waiting) -> None:
        """An order to return was not carried out. One that has waited before goes on waiting; the next look says
        whether it is left to another order."""
        if not self._is_current(waits):
            return
        if waits.has_waited:
            waits.step, waits.retry_at = Step.WAITS, self._loop.time() + AGAIN_S
            self._report(waits.actor, "the newer order to return failed: it goes on waiting as before")
        else:
            self._drop(waits, None)

    # -- those that wait

    async def _bring_home(self) -> None:
        whole_at = self._loop.time()
        self._progress = Progress(whole_at)
        try:
            while self._waiting:
                await asyncio.sleep(PERIOD_S)
                try:
                    await self._look_again()
                    whole_at = self._loop.time()
                except Exception as error:
                    self._report_fault("returns one after another", error)
                    if self._loop.time() - whole_at > STUCK_S:
                        self._let_go("a fault inside skygcs")
        finally:
            self._members.end_reading()

    async def _look_again(self) -> None:
        self._members.read_settings()
        async with self._deciding:
            self._leave_out_gone()
            for actor in self._members.look_home():
                self._report(actor, "it holds at the end of its return: those that wait fly home above it, if at all")
            waiting = [waits for waits in self._waiting.values() if waits.step is Step.WAITS]
            ready = [waits.actor for waits in waiting if self._is_ours(waits)]
            await self._hold_those_that_may()
            self._carry_out(await self._decide(ready))
        if not self._moves() and self._members.is_read():
            self._give_up([(waits, waits.told) for waits in self._waiting.values()])

    def _report_fault(self, what: str, error: Exception) -> None:
        """Report it once for each order to return: the same one may come twice a second."""
        if repr(error) != self._fault:
            self._fault = repr(error)
            self._on_event(Event("fault", None, None, f"{what} failed inside skygcs: {error!r}", {}))

    def _leave_out_gone(self) -> None:
        """Vehicles that were forgotten are not in the way any more."""
        for waits in [waits for waits in self._waiting.values() if waits.actor.closed]:
            self._drop(waits, "it does not wait any more to return: it was forgotten")
        self._members.leave_out_gone()

    def _is_current(self, waits: Waiting) -> bool:
        """False once it was dropped, or another order to return took its place."""
        return self._waiting.get(waits.actor.vehicle.key) is waits

    def _is_ours(self, waits: Waiting) -> bool:
        """True if it may be ordered something now. Drops one that something else has taken; see the table."""
        if not self._is_current(waits):
            return False
        actor, vehicle, ledger = waits.actor, waits.actor.vehicle, waits.actor.runner.ledger
        if not vehicle.connected:
            return False
        if actor.order_number != waits.order_number and ledger.in_progress:
            return False  # that may be refused
        if ledger.effective > waits.order_number and ledger.effective_serial > waits.serial:
            text = f"it does not wait any more to return: it was ordered something else ({ledger.effective_order})"
            self._drop(waits, text)
        elif vehicle.mode in COMING_HOME:
            self._drop(waits, f"it does not wait any more: it is in {vehicle.mode}")
        elif not is_flying(vehicle, self._loop.time()):
            self._drop(waits, "it does not wait any more to return: it is down")
        elif ledger.effective > waits.order_number and vehicle.mode in HOLDS_IN:
            self._adopt(waits, HELD_S)
            return False
        elif vehicle.custom_mode != waits.custom_mode and self._is_settling(waits):
            waits.custom_mode = vehicle.custom_mode
        elif vehicle.custom_mode != waits.custom_mode:
            self._drop(waits, f"it does not wait any more to return: it was switched to {vehicle.mode}")
        elif actor.order_number != waits.order_number:
            self._adopt(waits, 0.0)
        return self._is_current(waits)

    def _is_settling(self, waits: Waiting) -> bool:
        """True if its mode may still be that of a hold, or of a repeat of it, which a slow link brings late."""
        lately = self._loop.time() - waits.ordered_at < TAKES_S
        return waits.actor.vehicle.mode in HOLDS_IN and (lately or waits.step is Step.GOES_ON)

    def _adopt(self, waits: Waiting, pause_s: float) -> None:
        """An order that changes nothing of its wait has ended: it was refused, or was a hold of the daemon's own."""
        waits.order_number, waits.custom_mode = waits.actor.order_number, waits.actor.vehicle.custom_mode
        waits.goal_m = None if pause_s else waits.goal_m
        waits.retry_at = max(waits.retry_at, self._loop.time() + pause_s)
        why = (
            f"{waits.actor.runner.ledger.effective_order}, not asked for" if pause_s else "another order, which failed"
        )
        self._report(waits.actor, f"it goes on waiting after {why}")

    def _drop(self, waits: Waiting, why: str | None) -> None:
        del self._waiting[waits.actor.vehicle.key]
        if why is not None:
            waits.over = why
            self._report(waits.actor, why)

    def _gone(self, waits: Waiting) -> None:
        """Note that a vehicle is on its way home."""
        self._drop(waits, None)
        self._members.leaves_now(waits.actor)

    def _leaves(self, actor: VehicleActor) -> bool:
        waits = self._waiting.get(actor.vehicle.key)
        return waits is not None and waits.step is Step.LEAVES

    def _is_under_way(self, actor: VehicleActor, now: float) -> bool:
        return self._members.is_under_way(actor, now, leaves=self._leaves(actor))

    def _goal_m(self, key: int) -> float | None:
        waits = self._waiting.get(key)
        return None if waits is None else waits.goal_m

    async def _decide(self, free: Sequence[VehicleActor], *, alone: bool = False) -> Departures:
        """The decision for these, in turns with others. After a fault they leave one at a time. ``alone``: one that is
        ordered to return now, for which only what is seen in its way counts, not what may be."""
        try:
            return await self._decide_by_ways(free, alone=alone)
        except Exception as error:
            self._report_fault("the comparison of ways home: they return one at a time; it", error)
            now = self._loop.time()
            if alone:
                return Departures(tuple(actor.vehicle.key for actor in free))
            ahead = [a.name for a in self._members.actors() if a not in free and self._is_under_way(a, now)]
            return one_at_a_time({actor.vehicle.key: actor.name for actor in free}, ahead)

    async def _decide_by_ways(self, free: Sequence[VehicleActor], *, alone: bool) -> Departures:
        now = self._loop.time()
        self._members.add_those_that_come_home(self._vehicles, now)
        ordered = (self._members.returning(actor, now) for actor in free)
        waiting = [replace(one, lands=False) for one in ordered if one is not None]
        under_way: list[Returning] = []
        fixed: list[Way] = []
        going = {key for key, waits in self._waiting.items() if waits.step is Step.GOES_ON}
        for actor in self._members.actors():
            one = None if actor in free or actor.vehicle.key in going else self._members.returning(actor, now)
            if one is None:
                continue
            flies, comes = is_flying(actor.vehicle, now), self._is_under_way(actor, now)
            silent = flies and not actor.vehicle.connected
            under_way += [one] if comes or silent else []
            if silent or not comes:
                fixed.append(replace(one.place(), doing="in the air" if flies else "parked"))
        # those that are not ordered to return
        stays, moving = set(self._members.staying), set[str]()
        frame = frame_at(free[0].vehicle) if self._members.frame is None and free else self._members.frame
        present = () if frame is None else self._monitor.ways.present_ways(frame, self._members.keys() - going)
        for n, (way, still) in enumerate(present):
            if n % AT_A_TURN == AT_A_TURN - 1:
                await asyncio.sleep(0)
            fixed.append(replace(way, ball_m=0.0) if alone else way)
            if still:
                stays.add(way.key)
            else:
                moving.add(way.name)
        if alone:
            waiting, under_way = [one.as_seen() for one in waiting], [one.as_seen() for one in under_way]
        decided = await in_turns(departing(waiting, under_way, fixed, stays))
        if any(name in moving for names in decided.waits_for.values() for name in names):
            self._progress.moved_at = now
        self._fenced = tuple(sorted(self._members.names(decided.fenced)))
        return decided

    def _carry_out(self, decided: Departures) -> None:
        now = self._loop.time()
        for key, names in decided.waits_for.items():
            if (waits := self._waiting.get(key)) is not None:
                waits.told = names
        for key in (*decided.leave, *decided.climb):
            waits = self._waiting.get(key)
            if waits is None or waits.step is not Step.WAITS or now < waits.retry_at or not self._is_ours(waits):
                continue  # the decision took time
            goal_m = decided.climb.get(key)
            if goal_m is not None and waits.goal_m is not None and abs(goal_m - waits.goal_m) < MOVED_M:
                continue  # it climbs there
            if goal_m is not None and waits.actor.vehicle.failsafe:
                continue  # its own failsafe may be about to act, and must not be broken off
            if goal_m is None:
                self._start(waits, Step.LEAVES, waits.actor.rtl)
            else:
                self._start(waits, Step.CLIMBS, partial(self._climb, waits, goal_m))
        if self._members.is_read():  # what was not ordered to return may be ordered away yet
            for_good = self._members.names(self._members.staying)
            stuck = [(key, names) for key, names in decided.stuck.items() if for_good.issuperset(names)]
            self._give_up([(self._waiting[key], names) for key, names in stuck if key in self._waiting])

    def _start(self, waits: Waiting, step: Step, order: Callable[[], Awaitable[Outcome]]) -> None:
        """Give this order to one that waits, as a task of its own."""
        before, waits.step = waits.step, step
        if step is Step.LEAVES:
            self._members.leaves_now(waits.actor)
        self._tasks.start(self._give(waits, before, order), f"return of {waits.actor.name}", waits.serial)

    async def _give(self, waits: Waiting, before: Step, order: Callable[[], Awaitable[Outcome]]) -> None:
        """A turn of the loop after it was decided. A fault in the order is reported by the task; it is given again, or
        given up, as one that the vehicle did not take."""
        if not self._is_ours(waits):
            waits.step = before
            return
        step, outcome = waits.step, Outcome(False, "cancelled", "it failed inside skygcs")
        try:
            outcome = await order()
        finally:
            if self._is_current(waits):
                self._ended(waits, step, outcome)

    def _ended(self, waits: Waiting, step: Step, outcome: Outcome) -> None:
        """The order of a step has ended; it is the one of this return that counts."""
        if step is Step.LEAVES and outcome.ok:
            self._gone(waits)
            return
        self._ordered(waits, outcome)
        if step is not Step.HOLDS:
            return
        if outcome.ok:
            waits.goal_m = None
        elif outcome.result != "cancelled" and self._is_ours(waits):  # it cannot hold
            self._start(waits, Step.LEAVES, waits.actor.rtl)

    async def _climb(self, waits: Waiting, goal_m: float) -> Outcome:
        actor, now = waits.actor, self._loop.time()
        one = self._members.returning(actor, now)
        if one is None or self._members.frame is None:
            return Outcome.refused("its place is not known")
        lat_deg, lon_deg, alt_amsl_m = self._members.frame.to_geodetic(*one.here[:2], goal_m)
        home_amsl_m = actor.vehicle.home_alt_amsl_m()
        over = [name for name in waits.told if name not in {other.actor.name for other in self._waiting.values()}]
        above = f"{enumerated(over)}, and returns then" if over else "the way home of others, and waits there"
        self._report(actor, f"it climbs by {goal_m - one.here[2]:.0f} m, above {above}")
        height_m = alt_amsl_m - (0.0 if home_amsl_m is None else home_amsl_m)
        where: Where = {"lat_deg": lat_deg, "lon_deg": lon_deg, "height_m": height_m, "force": True}
        limit_m = actor.config.goto_limit_m
        sent, outcome = self._monitor.ways.sent_to(actor, (lat_deg, lon_deg, alt_amsl_m)), Outcome.refused("it ended")
        try:
            outcome = await actor.runner.run(
                "goto", lambda now: replace(goto(actor.vehicle, now, limit_m=limit_m, **where), spares=COMING_HOME)
            )
        finally:
            self._monitor.ways.arriving(actor, sent, ok=outcome.ok, number=outcome.order_number)
        waits.goal_m = goal_m if outcome.ok else None
        return outcome

    def _ordered(self, waits: Waiting, outcome: Outcome) -> None:
        """An order to one that goes on waiting has ended. A climb whose answer did not come may have changed the mode
        of a plane, which holds in another one; any other mode after a failure is not ours. Without a number it was not
        sent."""
        vehicle = waits.actor.vehicle
        waits.step, waits.has_waited = Step.WAITS, True
        if outcome.order_number is not None:
            waits.order_number = outcome.order_number  # a newer one that took its place is not ours
        if outcome.ok or vehicle.mode == "GUIDED":
            waits.custom_mode, waits.ordered_at = vehicle.custom_mode, self._loop.time()
        if not outcome.ok:
            waits.retry_at = self._loop.time() + AGAIN_S

    def _moves(self) -> bool:
        """True if one of them has moved, or landed, of late; see `Progress`."""
        now = self._loop.time()
        for key, actor in self._members.items():
            one = self._members.returning(actor, now)
            here = None if one is None or not is_flying(actor.vehicle, now) else one.here
            left = self._members.has_left(actor, now)
            ours = left or key in self._waiting or actor.vehicle.mode in COMING_HOME
            self._progress.note(key, here, now, ours=ours)
        return self._progress.goes_on(now)

    def _give_up(self, stuck: Sequence[tuple[Waiting, Sequence[str]]]) -> None:
        """The ways of these do not become clear: what is left is a person's decision, or a landing where they are."""
        for waits, names in stuck:
            actor, heard = waits.actor, waits.actor.vehicle.connected
            if waits.step is Step.GOES_ON and heard:
                continue  # it holds after `GOES_ON_S`
            if waits.step not in (Step.WAITS, Step.GOES_ON) or (heard and not self._is_ours(waits)):
                continue
            text = self._why_given_up(names) if heard else "it is not heard"
            self._drop(waits, None)
            self._note_given_up(waits)
            below = self._members.below(actor)
            if waits.at_end == "land" and not below:
                self._report(actor, f"{text}: it lands where it is", given_up=True)
                self._tasks.start(self._land(waits), f"landing of {actor.name}", waits.serial)
            elif waits.at_end == "land":
                are = "is" if len(below) == 1 else "are"
                text += f", and {enumerated(below)} {are} below it: it holds, and does not land"
                self._report(actor, text, given_up=True)
            else:
                todo = f"send it home in spite of that (skygcs-cli rtl {actor.name}), elsewhere, or land it"
                self._report(actor, f"{text}: {waits.stays} and does not return; {todo}", given_up=True)

    def _why_given_up(self, names: Sequence[str]) -> str:
        staying = self._members.names(self._members.staying)
        stays = "stays" if len(names) == 1 else "stay"
        held = [name for name in names if name in staying]
        at_end = f" ({enumerated(held)} after a return that ends in a hold)" if held else ""
        low = f", and {enumerated(self._fenced)} would have to climb out of its own fence, or above {ASIDE_M:g} m"
        low = low if self._fenced else ""
        return f"{enumerated(names)} {stays} in its way home{at_end}{low}"

    async def _land(self, waits: Waiting) -> None:
        """A turn of the loop after it was given up: unless its pilot took it, or something else was ordered."""
        actor = waits.actor
        ours = actor.order_number == waits.order_number and actor.vehicle.custom_mode == waits.custom_mode
        if ours and why_not_held(actor.vehicle) is None:
            await actor.land()

    def _report(self, actor: VehicleActor, text: str, *, given_up: bool = False) -> None:
        data = {"order": "rtl", "result": "failed" if given_up else "in_progress"}
        self._on_event(Event("command", actor.name, actor.sysid, f"rtl: {text}", data))
