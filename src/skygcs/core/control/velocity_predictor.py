"""Velocity control over a delay: the vehicle's motion predicted through the setpoints that are under way. Pure.

The measured state is old when it comes, and what is sent now acts later still. Between the two lie setpoints that were
sent already: the loop that ignores them answers the same error again and again. Here the state is moved on through
them, by a model of the autopilot's velocity loop, to the moment at which this tick's setpoint acts:

    measured x, v ──> model, setpoints under way, disturbance ──> x^ at the time t + h
    v_sp = v_ref(t + h) + Kp (x_ref(t + h) - x^),    a_ff = a_ref - c d^

    model         dv/dt = (u - v)/T + a_u + d,   dx/dt = v         u, a_u: velocity and acceleration that were sent
    observer      d^ += (1 - exp(-dt/Td)) ((v - v_model) / (T (1 - exp(-dt/T))) - d^)    at each new measurement
    horizon       h = round trip + age of the state

A predictor that leaves out the disturbance is worse than none at short delays: gusts that the vehicle has felt already
would be ignored until they are measured as position. So there is no prediction here without the observer.
Derivation, source and figures: docs/developers/velocity-prediction.md.
Measured: 25 us a tick at 0.8 s of delay and 10 Hz (CPython 3.11).

Its delay margin, how wrong the delay may be (`delay_range`): exact, for one axis.

With T the lag of the autopilot's velocity loop, A the attitude's inside it (which the predictor leaves out), h the
delay that the predictor assumes and D the one there is, the loop is in the Laplace domain

    vehicle      v = G exp(-s D) u,   x = v / s,        G = 1 / (1 + T s + T A s²)
    observer     d = H ((s + 1/T) v - exp(-s h) u / T),  H = 1 / (1 + Td s)
    prediction   x^ = x + a v + F u + b d
                 a = T (1 - exp(-h/T)),  b = T h - T a,  F = (1 - exp(-s h)) / s - (1 - exp(-(s + 1/T) h)) / (s + 1/T)
    law          u = Kp (r - x^) - c T d

so that 0 = P + M exp(-s D) decides stability, with

    P = 1 + Kp F - (Kp b + c T) H exp(-s h) / T           what is known of u without measuring
    M = (Kp (1/s + a) + (Kp b + c T) H (s + 1/T)) G       what is measured

F is entire, so s (P + M exp(-s D)) has its poles in the left half-plane, and by the argument principle (Mikhailov's
criterion) the loop is stable exactly if its phase on s = jw turns by pi/2 altogether as w goes from 0 to infinity. As
D changes, poles cross the axis only where |P| = |M|, at D = (arg(-M/P) + 2 pi k) / w: the nearest of these on either
side of D are the delays at which a stable loop becomes unstable. No approximation of the delay is involved.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from skygcs.core.control.cascade import LARGEST_INPUT, ZERO, Estimate, Reference, Vector, velocity_setpoint
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.velocity_loop import clip, record, within

# --- prediction -------------------------------------------------------------------------------------------------------

MAX_COMMANDS = 64
"""Setpoints kept, the oldest are dropped first: 3.2 s at `MAX_RATE_HZ`."""

MAX_RATE_HZ = 20.0
"""Velocity setpoints per second with prediction: each one under way is a step of the model."""

DISTURBANCE_TIME_S = 1.0
"""Time constant of the observer: gusts last about 2 s (Dryden, low altitude), and noise of 5 cm/s at 10 Hz moves d^ by
5 cm/s²."""

OPPOSED = 0.5
"""Share c of the disturbance that the feed-forward opposes; the autopilot's integral takes the steady part. On the
circle of `make bench-control` at 0.05 and 0.8 s of delay 0 leaves 0.32 and 0.29 m with PX4, 0.5 leaves 0.20 and 0.23,
and 1 leaves 0.15 and 0.25; with 0.8 s assumed and 1.04 s true 0.41, 0.51 and 0.62 m."""

DISTURBANCE_MAX_MPS2 = 3.0
"""Bound of d^: the drag of an F450 in 10 m/s of wind."""

GAP_S = 1.0
"""Without a measurement or a setpoint for so long the model has nothing to go on from: it begins anew."""

DELAY_SLEW = 0.2
"""Seconds per second: so fast the round trip in use follows the measured one. A jump of the delay by 0.5 s would
otherwise move the prediction, at 2 m/s, by a metre within one tick."""

NEW_S = 1e-3
"""A state is newer than the last if it came so much later; received times are differences of floats."""


@dataclass(frozen=True, slots=True)
class AutopilotLoop:
    """The autopilot's velocity loop as the model has it: a lag of first order, and what delays it further."""

    lag_xy_s: float
    lag_z_s: float
    attitude_lag_s: float
    """Lag of the airframe's attitude behind the requested acceleration. The model leaves it out, because it changes the
    model only from the second order on; the analysis of the delay margin has it."""
    accel_max_xy_mps2: float
    accel_max_z_mps2: float
    """Largest acceleration with which the vehicle answers a velocity, per axis."""
    feed_forward_xy: float
    """Acceleration to send for 1 m/s² of it: what a derivative gain on the measured acceleration takes off again."""


PX4_LOOP = AutopilotLoop(
    lag_xy_s=0.667,
    lag_z_s=0.25,
    attitude_lag_s=0.15,
    accel_max_xy_mps2=9.81,
    accel_max_z_mps2=9.81,
    feed_forward_xy=1.2,
)
"""a_sp = a_ff + P (v_sp - v) - D dv/dt with P = MPC_XY_VEL_P_ACC = 1.8 and D = MPC_XY_VEL_D_ACC = 0.2: a lag of
(1 + D)/P, and 1 + D of acceleration for each of it. Up 1/MPC_Z_VEL_P_ACC (4.0), D is 0. In OFFBOARD only
MPC_TILTMAX_AIR (45 degrees) limits the acceleration (PositionControl.cpp, v1.16.1). Attitude lag: the F450's, as
measured for the simulator."""

ARDUCOPTER_LOOP = AutopilotLoop(
    lag_xy_s=0.5, lag_z_s=0.2, attitude_lag_s=0.15, accel_max_xy_mps2=2.5, accel_max_z_mps2=1.0, feed_forward_xy=1.0
)
"""shape_vel_accel answers a velocity error with jerk_max/accel_max: 5/2.5 across (PSC_JERK_XY, WPNAV_ACCEL) and 5/1 up
(PSC_JERK_Z, WPNAV_ACCEL_Z); the path it makes is followed with feed-forward (AC_PosControl.cpp, Copter-4.6.3)."""


@record
class SentVelocity:
    """A velocity setpoint that was sent, and the acceleration that the feed-forward with it makes."""

    at: float
    vel_enu_mps: Vector
    acc_enu_mps2: Vector


@record
class PredictorMemory:
    """Memory that one step leaves to the next. A new one forgets everything: no setpoint is under way, no
    disturbance."""

    sent: tuple[SentVelocity, ...] = ()
    """The oldest first; before it the vehicle is taken to go on as it was measured."""
    received_at: float | None = None
    """When the state that was last seen came in."""
    estimate: Estimate | None = None
    disturbance_enu_mps2: Vector = ZERO
    round_trip_s: float | None = None
    """In use: follows the measured one with `DELAY_SLEW`."""
    ticked_at: float | None = None


@record
class Timing:
    """The times of one step, in seconds of the loop's clock."""

    now: float
    state_age_s: float
    """Since the state came in."""
    round_trip_s: float
    """Measured: down and up together."""
    hold_s: float
    """Until the next setpoint."""


@record
class PredictedSetpoint:
    """Setpoint to be sent now, and what it was made from."""

    vel_enu_mps: Vector
    acc_enu_mps2: Vector
    pos_enu_m: Vector
    """Predicted for the moment at which this setpoint acts."""
    disturbance_enu_mps2: Vector
    round_trip_s: float
    """In use."""


def predicted_setpoint(
    law: ControlConfig,
    loop: AutopilotLoop,
    memory: PredictorMemory,
    estimate: Estimate,
    reference: Reference,
    timing: Timing,
) -> tuple[PredictedSetpoint | None, PredictorMemory]:
    """One step. None, and the memory as it was, for a number that is NaN, infinite or above `LARGEST_INPUT`.

    The first step after a new memory sends what velocity control without prediction would send from the state moved
    on at its measured velocity: entering makes no jump. The reference is moved on by the uplink, its velocity and
    acceleration by half of ``hold_s`` more; an axis without position follows its velocity alone.
    """
    numbers = (timing.now, timing.state_age_s, timing.round_trip_s, timing.hold_s)
    if not (
        reference.usable and estimate.usable and all(-LARGEST_INPUT <= number <= LARGEST_INPUT for number in numbers)
    ):
        return None, memory
    memory = _observed(loop, _continued(memory, timing), estimate, timing)
    assert memory.round_trip_s is not None and memory.received_at is not None
    shift_s = memory.round_trip_s
    position, _, _ = _moved_on(
        loop, memory, estimate, shift_s, memory.received_at, timing.now + shift_s, memory.disturbance_enu_mps2
    )
    lead_s = 0.5 * memory.round_trip_s
    held = reference.ahead(lead_s + 0.5 * timing.hold_s)
    # positions are compared at the moment at which the setpoint begins to act; the velocity is of its middle
    before, since_s = _last_sent(memory, estimate, timing)
    velocity = velocity_setpoint(law, position, reference.ahead(lead_s), before, since_s, held.vel_enu_mps)
    acceleration = _against(held.acc_enu_mps2, memory.disturbance_enu_mps2)
    sent = (*memory.sent, SentVelocity(timing.now, velocity, acceleration))[-MAX_COMMANDS:]
    (ax, ay, az), gain = acceleration, loop.feed_forward_xy
    setpoint = PredictedSetpoint(
        velocity, (gain * ax, gain * ay, az), position, memory.disturbance_enu_mps2, memory.round_trip_s
    )
    return setpoint, PredictorMemory(
        sent,
        memory.received_at,
        memory.estimate,
        memory.disturbance_enu_mps2,
        memory.round_trip_s,
        timing.now,
    )


def _last_sent(memory: PredictorMemory, estimate: Estimate, timing: Timing) -> tuple[Vector, float]:
    """The velocity asked for last, and how long ago; the vehicle's own before the first."""
    if not memory.sent:
        return estimate.vel_enu_mps, timing.hold_s
    return memory.sent[-1].vel_enu_mps, max(0.0, timing.now - memory.sent[-1].at)


def _against(acceleration: Vector, disturbance: Vector) -> Vector:
    """The reference's acceleration, less the share of the disturbance that is opposed."""
    (ax, ay, az), (dx, dy, dz) = acceleration, disturbance
    return ax - OPPOSED * dx, ay - OPPOSED * dy, az - OPPOSED * dz


def _continued(memory: PredictorMemory, timing: Timing) -> PredictorMemory:
    """The memory for this step, with the round trip moved towards the measured one; a new one after a gap."""
    before = memory.ticked_at
    if before is None or memory.round_trip_s is None or not 0.0 <= timing.now - before <= GAP_S:
        return PredictorMemory(round_trip_s=max(0.0, timing.round_trip_s))
    most = DELAY_SLEW * (timing.now - before)
    change = clip(timing.round_trip_s - memory.round_trip_s, most)
    return PredictorMemory(
        memory.sent,
        memory.received_at,
        memory.estimate,
        memory.disturbance_enu_mps2,
        max(0.0, memory.round_trip_s + change),
        before,
    )


def _observed(loop: AutopilotLoop, memory: PredictorMemory, estimate: Estimate, timing: Timing) -> PredictorMemory:
    """With the newest state, and the disturbance that the difference from the model shows."""
    received_at = timing.now - timing.state_age_s
    before_at, before = memory.received_at, memory.estimate
    if before_at is not None and received_at - before_at < NEW_S:
        return memory
    disturbance = memory.disturbance_enu_mps2
    if before is not None and before_at is not None and received_at - before_at <= GAP_S:
        assert memory.round_trip_s is not None
        _, model, at_limit = _moved_on(loop, memory, before, memory.round_trip_s, before_at, received_at, ZERO)
        if not at_limit:  # the difference is then the limit's, not the wind's
            disturbance = _disturbance(loop, disturbance, estimate.vel_enu_mps, model, received_at - before_at)
    return PredictorMemory(memory.sent, received_at, estimate, disturbance, memory.round_trip_s, memory.ticked_at)


def _disturbance(loop: AutopilotLoop, before: Vector, measured: Vector, model: Vector, dt_s: float) -> Vector:
    weight = -math.expm1(-dt_s / DISTURBANCE_TIME_S)
    xy = loop.lag_xy_s * -math.expm1(-dt_s / loop.lag_xy_s)
    z = loop.lag_z_s * -math.expm1(-dt_s / loop.lag_z_s)
    shown = ((measured[0] - model[0]) / xy, (measured[1] - model[1]) / xy, (measured[2] - model[2]) / z)
    most = DISTURBANCE_MAX_MPS2
    return (
        clip(before[0] + weight * (shown[0] - before[0]), most),
        clip(before[1] + weight * (shown[1] - before[1]), most),
        clip(before[2] + weight * (shown[2] - before[2]), most),
    )


def _moved_on(
    loop: AutopilotLoop,
    memory: PredictorMemory,
    state: Estimate,
    shift_s: float,
    start: float,
    end: float,
    disturbance: Vector,
) -> tuple[Vector, Vector, bool]:
    """Position and velocity at ``end``, from those at ``start`` through the setpoints that act between, each
    ``shift_s`` after it was sent; and whether the acceleration was at its limit."""
    (x, y, z), (vx, vy, vz) = state.pos_enu_m, state.vel_enu_mps
    sent = memory.sent
    at, at_limit = start, False
    following = next((n for n, command in enumerate(sent) if command.at + shift_s > start), len(sent))
    while at < end:
        until = min(end, sent[following].at + shift_s) if following < len(sent) else end
        step_s = until - at
        if following == 0:  # nothing of ours acts yet: it goes on as it does
            x, y, z = x + vx * step_s, y + vy * step_s, z + vz * step_s
        else:
            command = sent[following - 1]
            (ux, uy, uz), (ax, ay, az) = command.vel_enu_mps, command.acc_enu_mps2
            xy, up = (loop.lag_xy_s, loop.accel_max_xy_mps2), (loop.lag_z_s, loop.accel_max_z_mps2)
            x, vx, limited_x = _axis(xy, (x, vx), (ux, ax, disturbance[0]), step_s)
            y, vy, limited_y = _axis(xy, (y, vy), (uy, ay, disturbance[1]), step_s)
            z, vz, limited_z = _axis(up, (z, vz), (uz, az, disturbance[2]), step_s)
            at_limit = at_limit or limited_x or limited_y or limited_z
        at = until
        following += 1
    return (x, y, z), (vx, vy, vz), at_limit


def _axis(
    lag: tuple[float, float], state: tuple[float, float], acting: tuple[float, float, float], step_s: float
) -> tuple[float, float, bool]:
    """Position and velocity of one axis after a time in which nothing changes: the lag's exact solution, or motion
    with its largest acceleration; and which of the two. ``lag``: time constant and largest acceleration."""
    (lag_s, accel_max), (x, v), (u, a, d) = lag, state, acting
    asked = (u - v) / lag_s + a
    if not -accel_max <= asked <= accel_max:
        accel = within(asked, -accel_max, accel_max) + d
        return x + (v + 0.5 * accel * step_s) * step_s, v + accel * step_s, True
    end = u + lag_s * (a + d)
    left = math.exp(-step_s / lag_s)
    return x + end * step_s + (v - end) * lag_s * (1.0 - left), end + (v - end) * left, False


# --- delay margin -----------------------------------------------------------------------------------------------------


UNCERTAINTY = 0.3
"""Share of the delay by which it may be wrong, on either side."""

STEP_S = 0.02
"""Delays are looked up in steps of so much, rounded up."""

_LOWEST_RADPS, _HIGHEST_RADPS, _PER_DECADE = 0.01, 300.0, 80
_BISECTIONS = 40


@dataclass(frozen=True, slots=True)
class DelayRange:
    """The delays between which the loop is stable while the predictor assumes ``assumed_s``."""

    assumed_s: float
    least_s: float
    """0: down to none at all."""
    most_s: float

    @property
    def margin_s(self) -> float:
        """By how much the delay may be wrong on either side; a delay cannot be less than none."""
        below_s = math.inf if self.least_s <= 0.0 else self.assumed_s - self.least_s
        return min(below_s, self.most_s - self.assumed_s)

    @property
    def holds(self) -> bool:
        """True if it is stable with a delay that is wrong by `UNCERTAINTY` of it."""
        return self.margin_s >= UNCERTAINTY * self.assumed_s


def delay_range(kp: float, lag_s: float, attitude_lag_s: float, assumed_s: float) -> DelayRange | None:
    """The range about the assumed delay (telemetry, setpoint and holding); None if the loop is unstable with the right
    delay already. 2 ms."""
    if not (kp > 0 and lag_s > 0 and attitude_lag_s >= 0 and 0 <= assumed_s < math.inf):
        raise ValueError("gain and lag must be above 0, attitude lag and delay not below")
    axis = _Axis(kp, lag_s, attitude_lag_s, assumed_s)
    decades = math.log10(_HIGHEST_RADPS / _LOWEST_RADPS)
    grid = [_LOWEST_RADPS * 10 ** (decades * n / (decades * _PER_DECADE)) for n in range(round(decades * _PER_DECADE))]
    parts = [axis.parts(w) for w in grid]
    if not _stable(grid, parts, assumed_s):
        return None
    least_s, most_s = 0.0, math.inf
    for (w0, (p0, m0)), (w1, (p1, m1)) in pairwise(zip(grid, parts, strict=True)):
        if (abs(p0) < abs(m0)) == (abs(p1) < abs(m1)):
            continue
        w = axis.crossing(w0, w1)
        p, m = axis.parts(w)
        first_s = (cmath.phase(-m / p) % math.tau) / w
        turn_s = math.tau / w
        below_s = first_s + turn_s * math.floor((assumed_s - first_s) / turn_s)
        least_s, most_s = max(least_s, below_s), min(most_s, below_s + turn_s)
    return DelayRange(assumed_s, least_s, most_s)


@lru_cache(maxsize=512)
def velocity_delay_range(law: ControlConfig, loop: AutopilotLoop, assumed_s: float) -> DelayRange | None:
    """Range for both axes together; None if one of them is unstable."""
    found = [
        delay_range(gains.pos_p_per_s, lag_s, loop.attitude_lag_s, assumed_s)
        for gains, lag_s in ((law.xy, loop.lag_xy_s), (law.z, loop.lag_z_s))
        if gains.pos_p_per_s > 0
    ]
    ranges = [one for one in found if one is not None]
    if len(ranges) < len(found) or not ranges:
        return None
    return DelayRange(assumed_s, max(one.least_s for one in ranges), min(one.most_s for one in ranges))


def why_not_predicted(law: ControlConfig, loop: AutopilotLoop, delay_s: float, uncertainty_s: float) -> str | None:
    """Why prediction must not be flown with this delay, uncertain by so much; None if it may be."""
    assumed_s = math.ceil(delay_s / STEP_S) * STEP_S
    found = velocity_delay_range(law, loop, assumed_s)
    if found is None:
        return f"these gains are unstable with prediction over {delay_s:.3f} s"
    wanted_s = max(UNCERTAINTY * assumed_s, uncertainty_s)
    if found.margin_s >= wanted_s:
        return None
    return (
        f"with prediction over {delay_s:.3f} s the delay may be wrong by {found.margin_s:.3f} s, and it is uncertain "
        f"by {wanted_s:.3f} s"
    )


@dataclass(frozen=True, slots=True)
class _Axis:
    kp: float
    lag_s: float
    attitude_lag_s: float
    horizon_s: float

    def parts(self, w: float) -> tuple[complex, complex]:
        """P and M of the module's text at s = jw."""
        s, pole, h, kp = complex(0.0, w), 1.0 / self.lag_s, self.horizon_s, self.kp
        ahead_s = self.lag_s * -math.expm1(-h * pole)
        opposed_s = kp * self.lag_s * (h - ahead_s) + OPPOSED * self.lag_s
        late = cmath.exp(-s * h)
        under_way = (1.0 - late) / s - (1.0 - late * math.exp(-h * pole)) / (s + pole)
        observer = 1.0 / (1.0 + DISTURBANCE_TIME_S * s)
        vehicle = 1.0 / (1.0 + self.lag_s * s * (1.0 + self.attitude_lag_s * s))
        known = 1.0 + kp * under_way - opposed_s * observer * late * pole
        measured = (kp * (1.0 / s + ahead_s) + opposed_s * observer * (s + pole)) * vehicle
        return known, measured

    def crossing(self, low: float, high: float) -> float:
        """Where |P| = |M|, between two frequencies on whose two sides it differs."""
        below = self._measured_larger(low)
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            if self._measured_larger(middle) == below:
                low = middle
            else:
                high = middle
        return high

    def _measured_larger(self, w: float) -> bool:
        known, measured = self.parts(w)
        return abs(known) < abs(measured)


def _stable(grid: list[float], parts: list[tuple[complex, complex]], delay_s: float) -> bool:
    """Mikhailov's criterion; the grid begins where s M dominates (phase 0) and ends where s does (pi/2)."""
    turned, before = 0.0, 0.0
    for w, (known, measured) in zip(grid, parts, strict=True):
        s = complex(0.0, w)
        phase = cmath.phase(s * (known + measured * cmath.exp(-s * delay_s)))
        turned += math.remainder(phase - before, math.tau)
        before = phase
    return abs(turned - math.pi / 2) < math.pi / 4
