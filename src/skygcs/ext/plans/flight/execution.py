"""A plan being flown, as a state machine. Pure: it is called with what happened and returns what is to be ordered.

    state        what is done                                        what ends it
    ----------   -------------------------------------------------   --------------------------------------------------
    arming       vehicles on the ground change to the mode of the    all armed → takeoff; one is not, is lost or
                 take-off; all in it, they arm; nobody moves         forgotten → aborted (disarm)
    takeoff      they climb vertically, each to its layer            all there → engaging; one is not, is lost or
                                                                     forgotten → stopped, who still stands is disarmed

                 where the link is too slow to arm and take off all of them before the first disarms again, each takes
                 off as soon as it is armed: the state begins with the first one, and one that does not arm → stopped

    engaging     each is taken under control (by goto: sent to its   all there → to_starts, returning or flying
                 place) and stands at its place
    to_starts    way there, step by step                             the last barrier → flying
    returning    way back after a stop                               the barrier → the interrupted step
    flying       the steps of the plan                               the last barrier → finished
    paused       the clock stops; on order                           resume → the step; abort, land
    stopped      the clock stops: one is late, lost, held or taken   resume (by a new certificate, or where nobody left
                                                                     its place) → the step; abort, land
    aborting     the clock stops for good                            all stand → each is ordered to hold → aborted
    landing      the clock stops, the landing is certified           refused, or one is forgotten before the last
                                                                     round → stopped; all on the ground → landed
    finished     all were at their goals: each was ordered to hold   land
    aborted      each was ordered to hold, or is on the ground       land
    landed       all are on the ground                               –

Before a vehicle is under control, from the arming on, it stays where it was certified to begin: within its part of the
margins of its measured place, or of the way of its take-off. One that was moved is not sent on: everything stops.

In a step that flies (to_starts, returning, flying) and while it is paused:

    a vehicle                                                        is in trouble
    --------------------------------------------------------------   -------------------------------------------
    is farther from its reference (or straight way) than its tube,   for `LATE_S`, or at twice the tube at once
    heights divided by the downwash ratio as in the certificate
    has sent no position                                             for `POSITION_SILENT_S`
    does not follow any more: guard, pilot, an order, lost           at once
    has not come to its place at the barrier                         for `BARRIER_S`

By goto and by missions (`flight.guidance`) autopilots fly the legs themselves: there is no clock, but `GotoLegs` are
shown as one. A vehicle may then be silent for `SILENT_S`, and is in trouble as well when it has denied its leg
(`Departure`) or has not come to its place in the leg's time and `LEG_S`.

Trouble stops the clock of all; nothing but an order goes on from there. A barrier opens when every vehicle was measured
within its tube of its place, slow, for `SETTLED_S`. `Departure` says why a vehicle does not follow.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from skygcs.core.trajectory import ClockState
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight.flight_steps import FlightStep, distance_to_leg, scaled
from skygcs.ext.plans.flight.guidance import Guidance
from skygcs.ext.plans.flight.plan_states import (
    OVER,
    STATE_OF,
    STEPPING,
    Order,
    OrderKind,
    PlanChange,
    PlanState,
)
from skygcs.ext.plans.flight.sights import ClockProgress, Departure, Measurement, Pair, Tubes, pairs_near, pairs_text
from skygcs.spelling import enumerated

FAR = 2.0
"""Tubes away from its place a vehicle is in trouble at once."""

LATE_S = 1.0
"""A gust, or one position of a bad fix, is over by then; at 2 m/s it is less than the margin of a pair."""

POSITION_SILENT_S = 3.0
"""Radios with gaps of a second lose two positions in a row; the ball of the monitor is 13 m by then."""

GOTO_SILENT_S = 5.0
"""By goto a vehicle that is not heard flies on to the end of its leg, which is certified; it is elsewhere only if its
own failsafe takes it, of which ArduCopter's begins 5 s after the last heartbeat of a ground station (FS_GCS_TIMEOUT).
"""

SILENT_S = {Guidance.GOTO: GOTO_SILENT_S, Guidance.MISSION: math.inf}
"""By a mission a vehicle that is not heard goes on, and keeps from the others wherever it and they are."""

LEG_S = 60.0
"""By goto: how much longer than planned a leg may take. Four orders that are lost, each repeated for 10 s, fit in."""

BARRIER_S = 30.0
"""Ten times what settling takes after a leg."""

SETTLED_S = 0.6
"""Two or three positions."""

SLOW_MPS = 0.6
"""At a barrier: gusts move a vehicle that holds by some tenths."""

START_LEAD_S = 1.0
"""From the order to the common start of a step: setpoints of all vehicles are at the start by then."""


@dataclass(slots=True)
class _Watch:
    """Since when something is so, by vehicle."""

    late: dict[str, float] = field(default_factory=dict)
    settled: dict[str, float] = field(default_factory=dict)
    barrier_since: float | None = None
    step_since: float | None = None

    def clear(self) -> None:
        self.late.clear()
        self.settled.clear()
        self.barrier_since = self.step_since = None


class Execution:
    """One run of a plan. Call `begin`, then `tick` a few times a second and `outcome` for each order's outcome.

    ``changes`` collects state changes; the caller reports and clears them.
    """

    def __init__(
        self,
        steps: Sequence[FlightStep],
        grounded: Collection[str],
        tubes: Tubes,
        measured: Mapping[str, Vector],
        *,
        by: Guidance = Guidance.SETPOINTS,
        together: bool = True,
    ) -> None:
        """``grounded``: vehicles that have to take off, to where the first step has them; ``measured``: the places that
        were certified, where each is now; ``together``: nobody takes off before all are armed."""
        self.steps = list(steps)
        self.tubes = tubes
        self.names = tuple(steps[0].trajectories)
        self.measured = dict(measured)
        self.by = by
        self._together = together
        self._silent_s = SILENT_S.get(by, POSITION_SILENT_S)
        self.grounded = tuple(name for name in self.names if name in grounded)
        self.state = PlanState.ARMING if self.grounded else PlanState.ENGAGING
        self.index = 0
        self.reason = ""
        self.left: dict[str, Departure] = {}
        self.waits_for: tuple[str, ...] = self.names
        self.pairs: tuple[Pair, ...] = ()
        self.changes: list[PlanChange] = []
        self._ready: set[str] = set()
        """In the mode of their take-off, at the beginning."""
        self._done: set[str] = set()
        """Vehicles whose order of this state has ended well."""
        self._unarmed = set(self.grounded)
        """Vehicles on the ground whose arming was not confirmed yet."""
        self._armed: set[str] = set()
        """Vehicles that this run has armed and that were not seen to leave the ground."""
        self._engaged: set[str] = set()
        """Vehicles that are under control, or were."""
        self._started = False
        """True if the step's clock was started."""
        self._rounds: list[tuple[str, ...]] | None = None
        """Rounds of a landing that was certified; the first is under way."""
        self._asked = False
        """True if the landing's certificate was asked for, or the hold of an abort ordered."""
        self._watch = _Watch()
        self._unexpected_modes: dict[str, str] = {}
        """`Measurement.unexpected_mode` of those that have one, as of the last look."""
        self._progress = ClockProgress()

    # -- what is shown

    @property
    def step(self) -> FlightStep:
        return self.steps[self.index]

    @property
    def over(self) -> bool:
        return self.state in OVER

    def tube_m(self, name: str) -> float:
        return self.tubes.tube_m(name, timed=self.step.timed)

    def off_m(self, name: str, place_m: Vector, trajectory_s: float) -> float:
        """How far a vehicle is from where it may be in this step, in the metric of the margins."""
        return self.step.off_m(name, place_m, trajectory_s, self.tubes.downwash_ratio)

    def seen_off_m(self, name: str, sight: Measurement, now: float, trajectory_s: float) -> float:
        """The same as it was when the vehicle reported its place."""
        if sight.reported_m is None:
            return math.inf if sight.place_m is None else self.off_m(name, sight.place_m, trajectory_s)
        then_s = self._progress.trajectory_s_at(now - sight.before_s, now, trajectory_s)
        return self.off_m(name, sight.reported_m, then_s)

    def why_displaced(self, name: str, place_m: Vector | None) -> str | None:
        """Why a vehicle that is not under control yet is not where it was certified to be; None if it is."""
        if place_m is None:
            return f"the position of {name} is not known"
        off_m = self._displaced_m(name, place_m)
        return self._displaced_text(name, off_m) if off_m > self._free_m(name) else None

    def _free_m(self, name: str) -> float:
        """How far from its certified place it may be that is not under control yet: its part of each margin. A take-off
        of either firmware drifts by 0.5 m in 6 m/s of wind and 0.9 m in 9 m/s (simulated), more than its tube."""
        return max(self.tubes.half_m[name], self.tubes.free_m[name])

    def _displaced_m(self, name: str, place_m: Vector) -> float:
        """The distance from its certified place, or from the way of its take-off."""
        ratio, start, begin = self.tubes.downwash_ratio, self.step.starts()[name], self.measured[name]
        place, low, high = (scaled(point, ratio) for point in (place_m, begin, start))
        return distance_to_leg(place, low, high)

    def _displaced_text(self, name: str, off_m: float) -> str:
        where = "from where the plan was certified to have it"
        return f"{name} is {off_m:.1f} m {where}; {self._free_m(name):.1f} m are allowed"

    def _displaced(self, now: float, sights: Mapping[str, Measurement]) -> tuple[str, str] | None:
        """The first vehicle that was moved before it was under control, and by how much."""
        for name in self.names:
            place_m = sights[name].reported_m or sights[name].place_m
            if name in self._engaged or place_m is None:
                continue
            off_m, free_m = self._displaced_m(name, place_m), self._free_m(name)
            if off_m <= free_m:
                self._watch.late.pop(name, None)
            elif now - self._watch.late.setdefault(name, now) >= LATE_S or off_m > FAR * free_m:
                return name, self._displaced_text(name, off_m)
        return None

    # -- orders of people

    def begin(self) -> list[Order]:
        """Return what is ordered first."""
        if self.state is PlanState.ARMING:
            # modes first: of 14 vehicles on one slow radio the first would be armed seconds before the last, and a PX4
            # that has not taken off 10 s later disarms (COM_DISARM_PRFLT)
            self._report(f"arming {enumerated(self.grounded)}")
            self.waits_for = self.grounded
            return [Order(OrderKind.MODE, self.grounded)]
        return self._engage()

    def pause(self) -> list[Order]:
        """Stop on the way. Raises RefusedError."""
        if self.state not in STEPPING:
            raise RefusedError(f"the plan is {self.state}: there is nothing to pause")
        self._enter(PlanState.PAUSED, "stopping on the way, as ordered")
        return [Order(OrderKind.STOP_CLOCK)] if self._started else []

    def go_on(self) -> list[Order]:
        """Go on where it stands, with everybody at its place. Raises RefusedError."""
        self.require_resumable()
        if self.left:
            raise RefusedError(f"{enumerated(tuple(self.left))} left: it takes a new certificate")
        self._watch.clear()
        self._enter(STATE_OF[self.step.kind], "going on")
        return [Order(OrderKind.GO_ON)]

    def require_resumable(self) -> None:
        """Raise RefusedError unless it stands in a step."""
        if self.state not in (PlanState.PAUSED, PlanState.STOPPED):
            raise RefusedError(f"the plan is {self.state}: only a paused or stopped one can be resumed")
        if not self._started:
            raise RefusedError("it was stopped before it flew: `plan abort`, then `plan run` from where they are")

    def away(self, trajectory_s: float, sights: Mapping[str, Measurement]) -> list[str]:
        """The vehicles that are not within their tubes, as far as it is known."""
        found = []
        for name in self.names:
            place = sights[name].place_m
            silent = place is None or sights[name].age_s > self._silent_s
            if silent or self.off_m(name, place or (0.0, 0.0, 0.0), trajectory_s) > self.tube_m(name):
                found.append(name)
        return found

    def abort(self, why: str = "as ordered") -> list[Order]:
        """Stop for good and hold. Raises RefusedError."""
        if self.over or self.state is PlanState.ABORTING:
            raise RefusedError(f"the plan is {self.state} already")
        before = self.state
        self._enter(PlanState.ABORTING, f"stopping for good: {why}")
        if before in (PlanState.ARMING, PlanState.TAKEOFF):
            return self._drop_takeoff(before)
        if before is PlanState.LANDING:
            return self._hold_now()
        return [Order(OrderKind.END_CLOCK)] if self._started else self._hold_now()

    def land(self) -> list[Order]:
        """Stop, then land where a certificate allows it. Raises RefusedError."""
        if self.state in (PlanState.LANDED, PlanState.LANDING):
            raise RefusedError(f"the plan is {self.state}")
        if self.state in (PlanState.ARMING, PlanState.TAKEOFF, PlanState.ABORTING):
            raise RefusedError(f"the plan is {self.state}: wait a moment, or abort it; `land` itself is never refused")
        moving = self.state in STEPPING and self._started
        self._rounds, self._asked = None, False
        self._enter(PlanState.LANDING, "landing: stopping first" if moving else "landing")
        return [Order(OrderKind.STOP_CLOCK)] if moving else []

    def landing(self, rounds: Sequence[Sequence[str]], others: Sequence[str] = ()) -> list[Order]:
        """The landing is certified: in these rounds, each after the one before is on the ground. ``others`` are in the
        air and stay: a pilot flies them, or they are lost."""
        if self.state is not PlanState.LANDING or self._rounds is not None:
            return []
        if others:
            text = f"{enumerated(others)}: flown by a pilot or lost, and not landed; `land` lands one all the same"
            self._report(text, others[0])
        self._rounds = [tuple(names) for names in rounds if names]
        self._done.clear()
        return self._next_round()

    def landing_refused(self, reasons: Sequence[str], pairs: Sequence[Pair] = ()) -> list[Order]:
        """The landing is not certified: they stay where they are."""
        if self.state is PlanState.LANDING and self._rounds is None:
            self.pairs = tuple(pairs)
            self._enter(PlanState.STOPPED, "they do not land: " + "; ".join(reasons[:3]), pairs=self.pairs)
        return []

    # -- outcomes and time

    def outcome(
        self, kind: OrderKind, name: str, ok: bool, text: str, unexpected_mode: str | None = None
    ) -> list[Order]:
        """An order to one vehicle has ended; ``unexpected_mode``: as `Measurement` has it, by now."""
        self._unexpected_modes.pop(name, None)
        if unexpected_mode is not None:
            self._unexpected_modes[name] = unexpected_mode
        if kind is OrderKind.MODE:
            return self._on_mode(name, ok, text)
        if kind is OrderKind.ARM:
            return self._on_armed(name, ok, text)
        if kind is OrderKind.TAKEOFF:
            if not ok and self.state is PlanState.TAKEOFF:
                return self._stop(name, f"{name} does not take off: {text}")
            return []
        if kind is OrderKind.ENGAGE and self.state is PlanState.ENGAGING:
            if not ok:
                return self._stop(name, f"{name} is not under control: {text}")
            self._done.add(name)
            self._engaged.add(name)
        if kind is OrderKind.HOLD and self.state is PlanState.ABORTING:
            return self._on_held(name, ok, text)
        if kind is OrderKind.HOLD and not ok:
            self._report(f"{name} was ordered to hold, but: {text}", name)
        if kind is OrderKind.DISARM and not ok:  # it has left the ground after all
            self._report(f"{name} could not be disarmed: {text}", name)
            return self._hold((name,))
        if kind is OrderKind.LAND and not ok and self.state is PlanState.LANDING:
            self._report(f"{name} does not land: {text}", name)
        return []

    def start_failed(self, text: str) -> list[Order]:
        """A step could not be started."""
        self._started = False
        return self._stop(None, text) if self.state in STEPPING else []

    def tick(
        self, now: float, clock: ClockState | None, trajectory_s: float, sights: Mapping[str, Measurement]
    ) -> list[Order]:
        """``clock``: the state of the step's clock; None: none runs."""
        self._progress.note(now, trajectory_s)
        self._unexpected_modes = {
            name: sights[name].unexpected_mode or "" for name in self.names if sights[name].unexpected_mode
        }
        for name in list(self._armed):
            if not sights[name].on_ground or not sights[name].armed:
                self._armed.discard(name)
        match self.state:
            case PlanState.ARMING:
                return self._tick_arming(now, sights)
            case PlanState.TAKEOFF:
                return self._tick_takeoff(now, sights)
            case PlanState.ENGAGING:
                return self._tick_engaging(now, sights)
            case PlanState.PAUSED | PlanState.STOPPED:
                return self._tick_standing(now, trajectory_s, sights)
            case PlanState.ABORTING:
                still = clock in (None, ClockState.ABORTED, ClockState.FINISHED)
                orders = self._hold_now() if still and not self._asked else []
                return [*orders, *self._tick_holding(sights)]
            case PlanState.LANDING:
                return self._tick_landing(clock, sights)
        if self.state in STEPPING:
            return self._tick_step(now, clock, trajectory_s, sights)
        return []

    # -- before the flight

    def _tick_arming(self, now: float, sights: Mapping[str, Measurement]) -> list[Order]:
        """The outcome of an order to arm may never come from a vehicle that is gone."""
        for name in self.names:
            if (left := sights[name].left) is not None:
                self._enter(PlanState.ABORTED, f"nobody takes off: {name} left: {left.text}", name)
                return self._disarm()
        if (moved := self._displaced(now, sights)) is not None:
            self._enter(PlanState.ABORTED, f"nobody takes off: {moved[1]}", moved[0])
            return self._disarm()
        return []

    def _on_mode(self, name: str, ok: bool, text: str) -> list[Order]:
        if self.state is not PlanState.ARMING or self._ready == set(self.grounded):
            return []
        if not ok:
            self._enter(PlanState.ABORTED, f"nobody takes off: {name} does not change its mode: {text}", name)
            return []
        self._ready.add(name)
        self.waits_for = tuple(n for n in self.grounded if n not in self._ready)
        if self.waits_for:
            return []
        self.waits_for = self.grounded
        return [Order(OrderKind.ARM, self.grounded)]

    def _on_armed(self, name: str, ok: bool, text: str) -> list[Order]:
        one_by_one = self.state is PlanState.TAKEOFF and not self._together
        if self.state is not PlanState.ARMING and not one_by_one:  # it came too late
            over = self.state in (PlanState.ABORTED, PlanState.ABORTING, PlanState.STOPPED)
            return [Order(OrderKind.DISARM, (name,))] if ok and over else []
        if not ok and one_by_one:
            return self._stop(name, f"{name} does not arm: {text}")
        if not ok:
            self._enter(PlanState.ABORTED, f"nobody takes off: {name} does not arm: {text}", name)
            return self._disarm()
        self._armed.add(name)
        self._unarmed.discard(name)
        self._done.add(name)
        self.waits_for = tuple(n for n in self.grounded if n not in self._done)
        if self.waits_for and self._together:
            return []
        if not one_by_one:
            several = len(self.grounded) > 1
            self._enter(PlanState.TAKEOFF, f"{enumerated(self.grounded)} {'take off' if several else 'takes off'}")
        self.waits_for = self.grounded
        return [Order(OrderKind.TAKEOFF, self.grounded if self._together else (name,))]

    def _disarm(self) -> list[Order]:
        armed = tuple(sorted(self._armed))
        return [Order(OrderKind.DISARM, armed)] if armed else []

    def _drop_takeoff(self, before: PlanState) -> list[Order]:
        """On an abort, disarm the vehicles that still stand and hold those that climb."""
        standing = self._disarm()
        standing_now = self._armed | self._unarmed
        climbing = tuple(n for n in self.names if n not in standing_now) if before is PlanState.TAKEOFF else ()
        self._asked = True
        holding = self._hold(climbing)
        self._done = set(self.names) - {name for order in holding for name in order.vehicles}
        if not holding:
            self._enter(PlanState.ABORTED, "nobody follows it any more" if climbing else "nobody took off")
        return [*standing, *holding]

    def _tick_takeoff(self, now: float, sights: Mapping[str, Measurement]) -> list[Order]:
        waits = []
        for name in self.names:
            if (left := sights[name].left) is not None:
                self.left[name] = left
                return self._stop(name, f"{name} left: {left.text}")
        for name in self.grounded:
            seen = sights[name].takeoff
            if seen in ("climbs", None):
                waits.append(name)
            elif seen != "reached":
                return self._stop(name, f"the take-off of {name} ended: {seen}")
        if (moved := self._displaced(now, sights)) is not None:
            return self._stop(*moved)
        self.waits_for = tuple(waits)
        return [] if waits else self._engage()

    def _engage(self) -> list[Order]:
        what = "sending {} to their places" if self.by.own_way else "taking {} under control"
        self._enter(PlanState.ENGAGING, what.format(enumerated(self.names)))
        self.waits_for = self.names
        return [Order(OrderKind.ENGAGE, self.names)]

    def _tick_engaging(self, now: float, sights: Mapping[str, Measurement]) -> list[Order]:
        for name in self.names:
            left = sights[name].left
            if left is not None:
                self.left[name] = left
                return self._stop(name, f"{name} left: {left.text}")
        if (moved := self._displaced(now, sights)) is not None:
            return self._stop(*moved)
        starts = self.step.starts()
        if len(self._done) < len(self.names):
            self.waits_for = tuple(n for n in self.names if n not in self._done)
            return []
        if not self._all_at(now, starts, sights):
            return self._barrier_trouble(now, sights)
        return self._begin_step()

    # -- steps

    def _begin_step(self) -> list[Order]:
        self._watch.clear()
        self._progress.clear()
        self._started = True
        self.waits_for = ()
        step = self.step
        times = "" if self.by is Guidance.GOTO else f": {step.duration_s:.0f} s for {len(self.names)} vehicles"
        self._enter(STATE_OF[step.kind], f"{step.name}{times}")
        return [Order(OrderKind.FLY, self.names)]

    def _tick_step(
        self, now: float, clock: ClockState | None, trajectory_s: float, sights: Mapping[str, Measurement]
    ) -> list[Order]:
        if (trouble := self._trouble(now, trajectory_s, sights)) is not None:
            return self._stop(*trouble)
        if clock in (ClockState.PAUSING, ClockState.PAUSED):  # by an order to the trajectory
            self._enter(PlanState.PAUSED, "stopping on the way, as ordered")
            return []
        if clock in (ClockState.ABORTING, ClockState.ABORTED):
            self._enter(PlanState.ABORTING, "stopping for good: its trajectories were aborted")
            return []
        if clock is not ClockState.FINISHED:
            self._watch.barrier_since = None
            return self._leg_trouble(now, sights) if self.by.own_way else []
        if not self._all_at(now, self.step.places(), sights):
            return self._barrier_trouble(now, sights)
        if self.index + 1 < len(self.steps):
            self.index += 1
            return self._begin_step()
        self._started = False
        self.waits_for = ()
        self._enter(PlanState.FINISHED, "all are at their goals and hold")
        return [] if self.by is Guidance.GOTO else self._hold(self.names)

    def _tick_standing(self, now: float, trajectory_s: float, sights: Mapping[str, Measurement]) -> list[Order]:
        """Paused or stopped: report who leaves meanwhile."""
        if not self._started:
            return []
        for name in self.names:
            left = sights[name].left
            if left is not None and name not in self.left:
                return self._leave(name, left, sights)
        if self.state is PlanState.PAUSED and (trouble := self._trouble(now, trajectory_s, sights)) is not None:
            return self._stop(*trouble)
        return []

    def _trouble(
        self, now: float, trajectory_s: float, sights: Mapping[str, Measurement]
    ) -> tuple[str, str, Mapping[str, Measurement]] | None:
        """The first vehicle in trouble, and what it is."""
        for name in self.names:
            sight = sights[name]
            if sight.left is not None:
                self.left[name] = sight.left
                return name, f"{name} left: {sight.left.text}", sights
            if sight.place_m is None or sight.age_s > self._silent_s:
                if self._silent_s == math.inf:
                    continue
                return name, f"{name} is silent: no position for {sight.age_s:.1f} s", sights
            off_m, tube_m = self.seen_off_m(name, sight, now, trajectory_s), self.tube_m(name)
            if off_m <= tube_m:
                self._watch.late.pop(name, None)
                continue
            since = self._watch.late.setdefault(name, now)
            if now - since >= LATE_S or off_m > FAR * tube_m:
                what = "from its reference" if self.step.timed else "from its way"
                return name, f"{name} is {off_m:.2f} m {what}; {tube_m:.2f} m are allowed", sights
        return None

    def _all_at(self, now: float, places: Mapping[str, Vector], sights: Mapping[str, Measurement]) -> bool:
        """The barrier: whether all were measured at their places for a moment."""
        waits = []
        for name, place in places.items():
            sight = sights[name]
            there = (
                sight.place_m is not None
                and sight.age_s <= POSITION_SILENT_S
                and sight.speed_mps <= SLOW_MPS
                and self.tubes.apart_m(sight.place_m, place) <= self.tubes.free_m[name]
            )
            if not there:
                self._watch.settled.pop(name, None)
            if not there or now - self._watch.settled.setdefault(name, now) < SETTLED_S:
                waits.append(name)
        self.waits_for = tuple(waits)
        return not waits

    def _leg_trouble(self, now: float, sights: Mapping[str, Measurement]) -> list[Order]:
        """One may never hear its order."""
        if self._watch.step_since is None:
            self._watch.step_since = now
        took_s = now - self._watch.step_since
        self._all_at(now, self.step.places(), sights)
        if took_s < self.step.duration_s + LEG_S or not self.waits_for:
            return []
        name = self.waits_for[0]
        return self._stop(name, f"{enumerated(self.waits_for)} did not fly its leg in {took_s:.0f} s", sights)

    def _barrier_trouble(self, now: float, sights: Mapping[str, Measurement]) -> list[Order]:
        if self._watch.barrier_since is None:
            self._watch.barrier_since = now
        waited_s = now - self._watch.barrier_since
        if waited_s < BARRIER_S:
            return []
        name = self.waits_for[0]
        return self._stop(name, f"{enumerated(self.waits_for)} did not come to its place in {waited_s:.0f} s", sights)

    # -- trouble

    def _stop(self, name: str | None, text: str, sights: Mapping[str, Measurement] | None = None) -> list[Order]:
        """Stop the clock of all, and name the pairs in danger."""
        ours = {} if sights is None else {n: sights[n] for n in self.names}
        self.pairs = () if name is None or sights is None else pairs_near(name, ours, self.tubes)
        standing = self._disarm() if self.state is PlanState.TAKEOFF else []
        self._enter(PlanState.STOPPED, text + pairs_text(self.pairs), name, self.pairs)
        return [Order(OrderKind.STOP_CLOCK)] if self._started else standing

    def _leave(self, name: str, left: Departure, sights: Mapping[str, Measurement]) -> list[Order]:
        self.left[name] = left
        return self._stop(name, f"{name} left: {left.text}", sights)

    # -- the end

    def _hold_now(self) -> list[Order]:
        self._asked = True
        self._done.clear()
        staying = tuple(n for n in self.names if n not in self.left and n not in self._armed | self._unarmed)
        standing = self._disarm()
        self._done.update(self.left, self._armed, self._unarmed, self._unexpected_modes)
        holding = self._hold(staying)
        if not holding:
            self._enter(PlanState.ABORTED, "nobody follows it any more")
        return [*standing, *holding]

    def _hold(self, names: Sequence[str]) -> list[Order]:
        """Order these to hold, but none that its pilot has taken meanwhile."""
        for name in names:
            if name in self._unexpected_modes:
                mode = self._unexpected_modes[name]
                self._report(f"{name} is in {mode}, which this plan did not set: it is not ordered to hold", name)
        ours = tuple(name for name in names if name not in self._unexpected_modes)
        return [Order(OrderKind.HOLD, ours)] if ours else []

    def _tick_holding(self, sights: Mapping[str, Measurement]) -> list[Order]:
        """Not wait for the hold of a vehicle that is forgotten."""
        if self.state is PlanState.ABORTING and self._asked:
            for name in self.names:
                if sights[name].forgotten and name not in self._done:
                    self._on_held(name, False, "it was forgotten")
        return []

    def _on_held(self, name: str, ok: bool, text: str) -> list[Order]:
        if not ok:
            self._report(f"{name} was ordered to hold, but: {text}", name)
        self._done.add(name)
        self.waits_for = tuple(n for n in self.names if n not in self._done)
        if not self.waits_for:
            self._enter(PlanState.ABORTED, "aborted: they hold where they are")
        return []

    def _tick_landing(self, clock: ClockState | None, sights: Mapping[str, Measurement]) -> list[Order]:
        if self._rounds is None:
            still = clock not in (ClockState.RUNNING, ClockState.PAUSING, ClockState.ABORTING)
            if still and not self._asked:
                self._asked = True
                return [Order(OrderKind.CERTIFY_LANDING)]
            return []
        self.waits_for = tuple(n for names in self._rounds for n in names if not sights[n].on_ground)
        if not self._rounds:
            return []
        gone = [n for n in self._rounds[0] if not sights[n].on_ground and (sights[n].forgotten or sights[n].piloted())]
        why = "was forgotten" if gone and sights[gone[0]].forgotten else "was taken by its pilot"
        if gone and len(self._rounds) > 1:
            return self._certify_anew(f"{enumerated(gone)} {why} while it landed", gone[0])
        if all(sights[n].on_ground or n in gone for n in self._rounds[0]):
            if gone:
                self._report(f"{enumerated(gone)} {why} while it landed", gone[0])
            del self._rounds[0]
            return self._next_round([n for n in self.names if sights[n].piloted()])
        return []

    def _next_round(self, piloted: Collection[str] = ()) -> list[Order]:
        if not self._rounds:
            self._started = False
            self._enter(PlanState.LANDED, "those that it landed are on the ground")
            return []
        taken = [name for name in self._rounds[0] if name in piloted]
        if taken:
            return self._certify_anew(f"{enumerated(taken)} was taken by its pilot before it was to land", taken[0])
        self._report(f"{enumerated(self._rounds[0])} land" + ("s" if len(self._rounds[0]) == 1 else ""))
        return [Order(OrderKind.LAND, self._rounds[0])]

    def _certify_anew(self, text: str, name: str) -> list[Order]:
        """Where one of a round is not, or may not be, the others stay."""
        self._rounds = None
        self._enter(PlanState.STOPPED, f"{text}: the others stay; `plan land` certifies a landing anew", name)
        return []

    # -- reports

    def _enter(self, state: PlanState, text: str, vehicle: str | None = None, pairs: tuple[Pair, ...] = ()) -> None:
        if state is not self.state:
            self._done.clear()
        self.state, self.reason = state, text
        self._report(text, vehicle, pairs)

    def _report(self, text: str, vehicle: str | None = None, pairs: tuple[Pair, ...] = ()) -> None:
        self.changes.append(PlanChange(self.state, text, vehicle, pairs))
