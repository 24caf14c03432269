"""The clock that drives trajectories: from the time of the fleet to the time s of the trajectories.

    state      start      time                     pause     resume    abort      set_speed
    ────────────────────────────────────────────────────────────────────────────────────────────
    ready      waiting    –                        refused   refused   aborted    kept
    waiting    refused    start time: running      paused    refused   aborted    kept
    running    refused    s at the end: finished   pausing   refused   aborting   ramps to it
    pausing    refused    rate 0: paused           –         running   aborting   kept
    paused     refused    –                        –         running   aborted    kept
    aborting   refused    rate 0: aborted          refused   refused   –          refused
    aborted    refused    –                        refused   refused   –          refused
    finished   refused    –                        refused   refused   –          refused

    rate s'   f ┤    ┌────────╲      ╱──────╲
                │    │         ╲    ╱        ╲           each ramp at |s''| = rate_limit_per_s; the vehicle stays on its
              0 ┼────┘          ╲__╱          ╲____      path, and stops within f / rate_limit_per_s seconds
                  waiting running pausing … aborting

s never jumps and never goes back. One clock may drive any number of trajectories: a common s(t) leaves the geometry
of the fleet at each s as it was planned, so what holds for all pairs at all s (a separation) holds at any rate.

The commanded acceleration is p'' s'² + p' s'' (chain rule). With largest speed V and acceleration A of the trajectories
it is at most A f² + V |s''|; `rate_limit` chooses |s''| = b / V, so a stop adds at most b.

A trajectory that does not begin at rest is ramped in from rate 0, one that does not end at rest is ramped out so that
the rate reaches 0 at its end. Pure: the caller passes `now`, in seconds of the fleet clock.

A clock of which others run replicas (`ReplicatedClock`): its orders take effect at a time that all of them know before.

    order        at once                                   at its time, on the clock and on each replica
    ----------   ---------------------------------------   ------------------------------------------------------
    pause …      checked, noted, given to the observers    carried out as `TrajectoryClock` does; refused by then
                 with its time                             (it has finished meanwhile): nothing

    ground       ──pause──┬──── lead_s ────┐ rate falls
    companion             └─ delay ─┐ noted└ rate falls          the same s(t) on both, whatever the delay below lead_s

An order that reaches a replica after its time is carried out when it comes: the replica is ahead on its path by rate
times the lateness, which its vehicle's distance from the common reference shows. Orders have to be noted as they were
given: a pause that is noted after the resume that followed it would stand.
"""

from __future__ import annotations

import contextlib
import enum
import math
from collections.abc import Callable
from typing import Literal, NamedTuple

from skygcs.core.trajectory.piecewise import MAX_DURATION_S
from skygcs.errors import RefusedError, TrajectoryError

# --- clock ------------------------------------------------------------------------------------------------------------

MAX_SPEED_FACTOR = 4.0
"""Speeds grow with it, accelerations with its square: beyond it a trajectory has a wrong time scale."""

MIN_SPEED_FACTOR = 0.01

MAX_RATE_LIMIT_PER_S = 10.0
"""Largest rate limit, used for trajectories that hardly move: a stop takes at least a tenth of a second."""

MIN_RATE_LIMIT_PER_S = 0.01

MAX_LEAD_S = 3600.0
"""A start later than in an hour is a wrong clock."""

AT_REST_MPS = 0.05
"""A trajectory that begins or ends slower than this begins or ends at rest."""


NO_TIME_S = 1e-9
"""Remaining time below which a trajectory counts as over: rounding leaves no more."""


class ClockState(enum.StrEnum):
    READY = "ready"
    WAITING = "waiting"
    RUNNING = "running"
    PAUSING = "pausing"
    PAUSED = "paused"
    ABORTING = "aborting"
    ABORTED = "aborted"
    FINISHED = "finished"


_MOVING = frozenset({ClockState.RUNNING, ClockState.PAUSING, ClockState.ABORTING})
_OVER = frozenset({ClockState.ABORTING, ClockState.ABORTED, ClockState.FINISHED})


class ClockTime(NamedTuple):
    """The clock at one time; the first three are the arguments of `Trajectory.at`."""

    trajectory_s: float
    rate: float
    rate_change_per_s: float
    state: ClockState


class _Phase(NamedTuple):
    """From ``begin`` on, s = s0 + rate (t - begin) + ½ change (t - begin)²."""

    begin: float
    s: float
    rate: float
    change: float

    def s_at(self, now: float) -> float:
        since = now - self.begin if self.rate or self.change else 0.0
        return self.s + (self.rate + 0.5 * self.change * since) * since


class TrajectoryClock:
    """Time of trajectories of at most ``duration_s``; they may be shorter: then they stand at their end.

    ``rests_at_start``, ``rests_at_end``: all of them begin or end at rest, so no ramp is needed there.
    """

    __slots__ = (
        *("_latest", "_phases", "_state", "duration_s", "rate_limit_per_s"),
        *("rests_at_end", "rests_at_start", "speed_factor"),
    )

    def __init__(
        self,
        duration_s: float,
        rate_limit_per_s: float,
        *,
        speed_factor: float = 1.0,
        rests_at_start: bool = True,
        rests_at_end: bool = True,
    ) -> None:
        if not 0.0 < duration_s <= MAX_DURATION_S:  # also for NaN
            raise TrajectoryError(f"a duration of {duration_s:g} s is not between 0 and {MAX_DURATION_S:g} s")
        if not MIN_RATE_LIMIT_PER_S <= rate_limit_per_s <= MAX_RATE_LIMIT_PER_S:
            raise TrajectoryError(
                f"a rate limit of {rate_limit_per_s:g}/s is not between {MIN_RATE_LIMIT_PER_S:g} and "
                f"{MAX_RATE_LIMIT_PER_S:g}/s"
            )
        self.duration_s = duration_s
        self.rate_limit_per_s = rate_limit_per_s
        self.rests_at_start = rests_at_start
        self.rests_at_end = rests_at_end
        self.speed_factor = _checked_factor(speed_factor)
        self._state = ClockState.READY
        self._phases: tuple[_Phase, ...] = (_Phase(-math.inf, 0.0, 0.0, 0.0),)
        self._latest = ClockTime(0.0, 0.0, 0.0, ClockState.READY), -math.inf

    # --- orders -------------------------------------------------------------------------------------------------------

    def start(self, now: float, at_s: float) -> None:
        """Begin at ``at_s``, which is ``now`` or later. Raises RefusedError."""
        state = self.at(now).state
        if state is not ClockState.READY:
            raise RefusedError(f"the trajectory is {state} and cannot be started again")
        if not now <= at_s <= now + MAX_LEAD_S:  # also for NaN
            raise RefusedError(f"the start is {at_s - now:g} s ahead; it has to be 0 to {MAX_LEAD_S:g} s ahead")
        self._state = ClockState.WAITING
        self._phases = (_Phase(now, 0.0, 0.0, 0.0), *self._running(at_s, 0.0, self._first_rate()))
        self._forget(now)

    def pause(self, now: float) -> None:
        """Stop on the path; `resume` goes on. Raises RefusedError."""
        time = self.at(now)
        if time.state is ClockState.READY or time.state in _OVER:
            raise RefusedError(f"the trajectory is {time.state}: there is nothing to pause")
        if time.state in (ClockState.RUNNING, ClockState.WAITING):
            self._stop(now, time, ClockState.PAUSING)

    def resume(self, now: float) -> None:
        """Go on from where it is. Raises RefusedError."""
        time = self.at(now)
        if time.state not in (ClockState.PAUSING, ClockState.PAUSED):
            raise RefusedError(f"the trajectory is {time.state}: only a paused one can be resumed")
        self._state = ClockState.RUNNING
        self._phases = self._running(self._now(now), time.trajectory_s, time.rate)
        self._forget(now)

    def set_speed(self, now: float, speed_factor: float) -> None:
        """Fly at this multiple of the planned speed, at once or from the start or resumption on. Raises RefusedError.

        Whether the vehicles can follow is checked before: `require_within` with the factor.
        """
        factor = _checked_factor(speed_factor)
        time = self.at(now)
        if time.state in _OVER:
            raise RefusedError(f"the trajectory is {time.state}: its speed cannot be changed")
        self.speed_factor = factor
        if time.state is ClockState.WAITING:
            begin = self._phases[1].begin
            self._phases = (self._phases[0], *self._running(begin, 0.0, self._first_rate()))
        elif time.state is ClockState.RUNNING:
            self._phases = self._running(self._now(now), time.trajectory_s, time.rate)
        self._forget(now)

    def abort(self, now: float) -> None:
        """Stop on the path for good; without effect where it is over already."""
        time = self.at(now)
        if time.state not in _OVER:
            self._stop(now, time, ClockState.ABORTING)

    # --- time ---------------------------------------------------------------------------------------------------------

    def at(self, now: float) -> ClockTime:
        """Trajectory time, rate and state at ``now``; a ``now`` before the latest one (or NaN) counts as that."""
        latest, latest_now = self._latest
        if not now > latest_now:
            return latest
        phase = self._phase_at(now)
        since = now - phase.begin if phase.rate or phase.change else 0.0
        rate = max(phase.rate + phase.change * since, 0.0)
        s = min(max(phase.s_at(now), latest.trajectory_s), self.duration_s)
        state = self._state_at(phase, now, s)
        time = ClockTime(s, 0.0, 0.0, state) if state not in _MOVING else ClockTime(s, rate, phase.change, state)
        self._latest = time, now
        return time

    @property
    def begins_at_s(self) -> float:
        """Start time of a clock that waits; else the time of its present order."""
        return self._phases[1].begin if self._state is ClockState.WAITING else self._phases[0].begin

    @property
    def latest_rate(self) -> float:
        """Rate as of the latest `at`."""
        return self._latest[0].rate

    def foreseen_s(self, at: float) -> float:
        """Trajectory time at a later time if nothing is ordered until then. Changes nothing, unlike `at`."""
        return min(max(self._phase_at(at).s_at(at), self._latest[0].trajectory_s), self.duration_s)

    def _phase_at(self, now: float) -> _Phase:
        phase = self._phases[0]
        for later in self._phases[1:]:
            if later.begin > now:
                break
            phase = later
        return phase

    def finishes_at_s(self, now: float) -> float | None:
        """When the trajectory will be at its end; None if it is paused, aborted or not started."""
        state = self.at(now).state
        if state in (ClockState.WAITING, ClockState.RUNNING, ClockState.FINISHED):
            return self._phases[-1].begin
        return None

    def _state_at(self, phase: _Phase, now: float, s: float) -> ClockState:
        if phase is not self._phases[-1]:
            if self._state is ClockState.WAITING and now >= self._phases[1].begin:
                self._state = ClockState.RUNNING
        elif self._state is ClockState.ABORTING:
            self._state = ClockState.ABORTED
        elif self._state is ClockState.PAUSING:
            self._state = ClockState.FINISHED if s >= self.duration_s else ClockState.PAUSED
        elif self._state in (ClockState.WAITING, ClockState.RUNNING):
            self._state = ClockState.FINISHED
        return self._state

    # --- phases -------------------------------------------------------------------------------------------------------

    def _now(self, now: float) -> float:
        """``now``, or the latest time asked for if that is later."""
        latest_now = self._latest[1]
        return now if now > latest_now else latest_now

    def _forget(self, now: float) -> None:
        """The phases changed: evaluate the present anew."""
        latest, latest_now = self._latest
        now = self._now(now) if math.isfinite(latest_now) else now
        self._latest = latest, math.nextafter(latest_now, -math.inf)
        self.at(now)

    def _first_rate(self) -> float:
        return self.speed_factor if self.rests_at_start else 0.0

    def _stop(self, now: float, time: ClockTime, state: ClockState) -> None:
        self._state = state
        now, s, rate = self._now(now), time.trajectory_s, time.rate
        if rate <= 0.0:
            self._phases = (_Phase(now, s, 0.0, 0.0),)
        else:
            # the end of the trajectory may come first
            room = self.duration_s - s
            brake = self.rate_limit_per_s
            if rate * rate > 2.0 * brake * room and not self.rests_at_end:
                brake = rate * rate / (2.0 * max(room, NO_TIME_S))
            if rate * rate > 2.0 * brake * room:
                took = (rate - math.sqrt(rate * rate - 2.0 * brake * room)) / brake
                end = self.duration_s
            else:
                took, end = rate / brake, min(s + 0.5 * rate * rate / brake, self.duration_s)
            self._phases = (_Phase(now, s, rate, -brake), _Phase(now + took, end, 0.0, 0.0))
        self._forget(now)

    def _running(self, begin: float, s: float, rate: float) -> tuple[_Phase, ...]:
        """From ``rate`` to the speed factor, on to the end, and out."""
        limit, target, room = self.rate_limit_per_s, self.speed_factor, self.duration_s - s
        if room <= NO_TIME_S:
            return (_Phase(begin, self.duration_s, 0.0, 0.0),)
        phases = []
        if not self.rests_at_end:
            target = min(target, math.sqrt(0.5 * (2.0 * limit * room + rate * rate)))
        # ramp
        change = math.copysign(limit, target - rate)
        took = abs(target - rate) / limit
        length = 0.5 * (rate + target) * took
        if took > 0.0 and length < room:
            phases.append(_Phase(begin, s, rate, change))
            begin, s, rate, room = begin + took, s + length, target, room - length
        elif took > 0.0:  # the end comes within the ramp
            final = math.sqrt(max(rate * rate + 2.0 * change * room, 0.0))
            phases.append(_Phase(begin, s, rate, change))
            return (*phases, _Phase(begin + (final - rate) / change, self.duration_s, 0.0, 0.0))
        # cruise, and the ramp out
        out = 0.0 if self.rests_at_end else min(0.5 * rate * rate / limit, room)
        cruise_s = (room - out) / rate
        phases.append(_Phase(begin, s, rate, 0.0))
        begin += cruise_s
        if out > 0.0:
            phases.append(_Phase(begin, self.duration_s - out, rate, -0.5 * rate * rate / out))
            begin += 2.0 * out / rate
        return (*phases, _Phase(begin, self.duration_s, 0.0, 0.0))


def rate_limit(fastest_mps: float, brake_mps2: float) -> float:
    """|s''| in 1/s such that a change of rate adds at most ``brake_mps2`` to the acceleration of a trajectory whose
    largest speed is ``fastest_mps``. Raises TrajectoryError where it would take longer than 100 s to stop."""
    if not brake_mps2 > 0.0:  # also for NaN
        raise TrajectoryError(f"a braking acceleration of {brake_mps2:g} m/s² is not positive")
    limit = MAX_RATE_LIMIT_PER_S if fastest_mps <= 0.0 else min(brake_mps2 / fastest_mps, MAX_RATE_LIMIT_PER_S)
    if limit < MIN_RATE_LIMIT_PER_S:
        raise TrajectoryError(f"at {brake_mps2:g} m/s² a stop from {fastest_mps:g} m/s takes longer than 100 s")
    return limit


def _checked_factor(speed_factor: float) -> float:
    if not MIN_SPEED_FACTOR <= speed_factor <= MAX_SPEED_FACTOR:  # also for NaN
        raise RefusedError(
            f"a speed factor of {speed_factor:g} is not between {MIN_SPEED_FACTOR:g} and {MAX_SPEED_FACTOR:g}"
        )
    return speed_factor


# --- replicated clock -------------------------------------------------------------------------------------------------


ClockOrderKind = Literal["pause", "resume", "abort", "speed"]

MAX_NOTED = 32
"""Orders that wait for their time; a person gives one or two a second."""

STOP_ROOM = 2
"""Room beyond that for stops alone: a pause, and an abort. Only a resume, which has no room there, comes before the
next pause."""

STATE_AFTER = {"pause": ClockState.PAUSING, "resume": ClockState.RUNNING, "abort": ClockState.ABORTING}


class ClockOrder(NamedTuple):
    """``at_s``: when it takes effect; ``speed_factor``: of "speed" only."""

    kind: ClockOrderKind
    at_s: float
    speed_factor: float | None = None

    @property
    def stops(self) -> bool:
        return self.kind in ("pause", "abort")

    def has_room(self, waiting: int) -> bool:
        """True if it may wait beside so many others; a stop of a clock always may."""
        return waiting < MAX_NOTED + (STOP_ROOM if self.stops else 0)


class ReplicatedClock(TrajectoryClock):
    """``lead_s`` after they are given, orders take effect; 0: at once. ``observers`` get each order as it is given."""

    __slots__ = ("_noted", "lead_s", "observers")

    def __init__(
        self,
        duration_s: float,
        rate_limit_per_s: float,
        *,
        speed_factor: float = 1.0,
        rests_at_start: bool = True,
        rests_at_end: bool = True,
        lead_s: float = 0.0,
    ) -> None:
        super().__init__(
            duration_s,
            rate_limit_per_s,
            speed_factor=speed_factor,
            rests_at_start=rests_at_start,
            rests_at_end=rests_at_end,
        )
        self.lead_s = lead_s
        self.observers: list[Callable[[ClockOrder], None]] = []
        self._noted: list[ClockOrder] = []

    def note(self, order: ClockOrder) -> None:
        """An order of the clock that this one replicates. Raises RefusedError if too many wait."""
        if not order.has_room(len(self._noted)):
            raise RefusedError(f"{MAX_NOTED} orders to the clock wait for their time already")
        self._noted.append(order)
        self._noted.sort(key=lambda noted: noted.at_s)

    def pause(self, now: float) -> None:
        """Stop on the path, ``lead_s`` from now. Raises RefusedError."""
        if self.lead_s <= 0.0:
            super().pause(now)
            return
        state = self._expected(now)
        if state is ClockState.READY or state in _OVER:
            raise RefusedError(f"the trajectory is {state}: there is nothing to pause")
        if state in (ClockState.RUNNING, ClockState.WAITING):
            self._order(ClockOrder("pause", now + self.lead_s))

    def resume(self, now: float) -> None:
        """Go on, ``lead_s`` from now. Raises RefusedError."""
        if self.lead_s <= 0.0:
            super().resume(now)
            return
        state = self._expected(now)
        if state not in (ClockState.PAUSING, ClockState.PAUSED):
            raise RefusedError(f"the trajectory is {state}: only a paused one can be resumed")
        self._order(ClockOrder("resume", now + self.lead_s))

    def abort(self, now: float) -> None:
        """Stop for good, ``lead_s`` from now; without effect where it is over already."""
        if self.lead_s <= 0.0:
            super().abort(now)
        elif self._expected(now) not in _OVER:
            self._order(ClockOrder("abort", now + self.lead_s))

    def set_speed(self, now: float, speed_factor: float) -> None:
        """Fly at this multiple of the planned speed, ``lead_s`` from now. Raises RefusedError."""
        if self.lead_s <= 0.0:
            super().set_speed(now, speed_factor)
            return
        state = self._expected(now)
        if state in _OVER:
            raise RefusedError(f"the trajectory is {state}: its speed cannot be changed")
        if not MIN_SPEED_FACTOR <= speed_factor <= MAX_SPEED_FACTOR:  # also for NaN
            limits = f"{MIN_SPEED_FACTOR:g} and {MAX_SPEED_FACTOR:g}"
            raise RefusedError(f"a speed factor of {speed_factor:g} is not between {limits}")
        self._order(ClockOrder("speed", now + self.lead_s, speed_factor))

    def at(self, now: float) -> ClockTime:
        """Same as `TrajectoryClock.at`, after the orders whose time has come. A paused clock that is to go on is
        running: what looks at it must not take the wait for another pause."""
        due = [order for order in self._noted if order.at_s <= now]
        del self._noted[: len(due)]  # before the first is carried out, which asks for the present again
        for order in due:
            self._carry_out(order)
        time = super().at(now)
        if self._noted and time.state is ClockState.PAUSED and self._noted[-1].kind == "resume":
            return time._replace(state=ClockState.RUNNING)
        return time

    def _expected(self, now: float) -> ClockState:
        """The state once all that waits has been carried out."""
        for order in reversed(self._noted):
            if order.kind in STATE_AFTER:
                return STATE_AFTER[order.kind]
        return self.at(now).state

    def _order(self, order: ClockOrder) -> None:
        self.note(order)
        for observer in self.observers:
            observer(order)

    def _carry_out(self, order: ClockOrder) -> None:
        super().at(order.at_s)
        with contextlib.suppress(RefusedError):  # it has come to its end meanwhile
            match order.kind:
                case "pause":
                    super().pause(order.at_s)
                case "resume":
                    super().resume(order.at_s)
                case "abort":
                    super().abort(order.at_s)
                case "speed" if order.speed_factor is not None:
                    super().set_speed(order.at_s, order.speed_factor)
