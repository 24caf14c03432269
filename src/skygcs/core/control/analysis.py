"""The linear position loop of one axis: poles, stability, margins, step response, and gains for a given delay.

The law of one axis (UTIAS report, Eqs 1 to 3), for a reference r, position x and velocity v:

    outer P       v_sp = Kp (r - x)
    inner PI      e = v_sp - v,   u = Kv e + Ki ∫e dt
    airframe      dv/dt = G u,   dx/dt = v       (attitude and thrust follow at once: a double integrator)

In the Laplace domain e = Kp r - (s + Kp) x, hence u = (Kv + Ki/s) (Kp r - (s + Kp) x) and s² x = G u. Cut open at u,
the loop is

    L(s) = G (Kv s + Ki) (s + Kp) / s³

and 1 + L(s) = 0, times s³, is the characteristic polynomial

    s³ + G Kv s² + G (Kp Kv + Ki) s + G Kp Ki.

A pure delay τ anywhere in the loop (telemetry down, setpoint up) multiplies L by exp(-s τ), nothing else.

What u is decides G. The law's u is normalised thrust: hovering needs ``hover`` of it and balances g, so G = g/hover on
every axis. The UTIAS report's analysis has u as tilt angle with G = g for x and y, and as vertical acceleration with
G = 1.

Facts the functions below rest on, for a loop that is stable without delay (G Kv > 0, Kp > 0, G Ki >= 0):

- |L(jω)| falls strictly with ω: there is exactly one crossover, so the loop is stable for every delay below the delay
  margin and for none above it. No approximation of the delay is involved.
- The phase margin as a function of ω, φ(ω) = atan(ω Kv/Ki) + atan(ω/Kp) - ω τ - π/2, is concave: it is positive on one
  interval around the crossover, whose ends are the two gain margins.
- With Kp/λ, Kv/λ, Ki/λ² the loop is L(λ s): the same motion, λ times slower. Phase and gain margins stay, every delay
  margin is multiplied by λ.

What a real loop has beside its pure delay, and how `suggest` counts it: an output that is held until the next one and a
state that is held until the next one delay by half a period each on average; an airframe that follows its attitude with
a lag T multiplies L by 1/(1 + T s). That falls with ω too, so there is still one crossover, and the delay margin is its
phase over its frequency, exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from skygcs.core.control.gains import GRAVITY_MPS2, AxisGains, ControlConfig

DEFAULT_RESERVE = 2.0
"""Delay margin over measured delay. An airframe's attitude takes 0.1 to 0.2 s to follow, which the model leaves out."""

LEAST_DELAY_S = 0.05
"""Attitude gains have to bear at least so much: states at 50 Hz are 0.02 s old, and a link has two ways."""

AIRFRAME_LAG_S = 0.15
"""Lag of the attitude behind its setpoint: the upper half of the range that multirotors of 0.5 to 2 kg show."""

SETTLED_WITHIN = 0.05
"""Share of the step around its end; the usual 5 % band."""

CONTINUOUS_PERIOD_S = 0.001
"""Sampling with hold delays by half a period on average: 0.5 ms, 0.25 % of z's delay margin (0.213 s)."""

SMALLEST, LARGEST = 1e-12, 1e6
"""Sizes of gains that are not 0: far beyond any vehicle, and no arithmetic below overflows or underflows."""

DIVERGED = 1e6
"""Steps. Beyond this nothing is learned, and floats would overflow in the end."""

_BISECTIONS = 100


@dataclass(frozen=True, slots=True)
class Loop:
    """Gains on a plant, also unstable ones.

    Raises ValueError for sizes outside the two above, for G = 0, and for a derivative gain: its filter is not modelled.
    """

    gains: AxisGains
    plant_gain: float

    def __post_init__(self) -> None:
        numbers = (*_gains(self), self.plant_gain)
        if not all(number == 0 or SMALLEST <= abs(number) <= LARGEST for number in numbers) or self.plant_gain == 0:
            raise ValueError(f"gains must be 0 or between {SMALLEST:g} and {LARGEST:g} in size, the plant gain not 0")
        if self.gains.vel_d != 0:
            raise ValueError("the analysis knows no derivative gain")

    @property
    def polynomial(self) -> tuple[float, ...]:
        """Characteristic polynomial, highest power first.

        Without an integrator (Ki = 0) its state takes no part, and the polynomial is s² + G Kv s + G Kp Kv.
        """
        (kp, kv, ki), g = _gains(self), self.plant_gain
        if ki == 0:
            return (1.0, g * kv, g * kp * kv)
        return (1.0, g * kv, g * (kp * kv + ki), g * kp * ki)


@dataclass(frozen=True, slots=True)
class Routh:
    """Routh's criterion. ``first_column`` ends at a zero that the scheme cannot divide by."""

    first_column: tuple[float, ...]
    stable: bool


@dataclass(frozen=True, slots=True)
class Margins:
    """Margins that a stable loop bears, each alone. Gain margins are factors >= 1, infinity if there is no limit.

    ``gain_up``: by this the plant gain may grow. ``gain_down``: by this it may be divided (an integrator sets such a
    limit).
    """

    crossover_radps: float
    phase_margin_rad: float
    delay_margin_s: float
    gain_up: float
    gain_down: float


@dataclass(frozen=True, slots=True)
class Factoring:
    """The polynomial as (s + kpx) (s² + kpv s + kiv): the primed gains of Eqs 8 to 16 of the UTIAS report."""

    kpx: float
    kpv: float
    kiv: float


@dataclass(frozen=True, slots=True)
class Suggestion:
    """Gains that bear a delay with a reserve; ``factor`` is λ, 1 if they need not be changed."""

    factor: float
    gains: AxisGains


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Positions after a step of the reference from 0 to 1 at time 0, one per ``period_s``.

    ``settling_s`` is None if the response was outside the band around 1 in the last tenth: one that still swings
    through it has not settled. ``rise_s`` (10 to 90 %) is None if it never came that far.
    """

    period_s: float
    positions: tuple[float, ...]
    overshoot: float  # of the step: 0.08 is 8 %
    rise_s: float | None
    settling_s: float | None


def poles(loop: Loop) -> tuple[complex, ...]:
    """Closed-loop poles without delay, the slowest (rightmost) first, conjugates next to each other."""
    import numpy as np  # 0.1 s, which the rest of the command line need not wait for

    found = [complex(root) for root in np.roots(loop.polynomial)]
    return tuple(sorted(found, key=lambda pole: (-pole.real, pole.imag)))


def routh(loop: Loop) -> Routh:
    """Stability without delay, by the signs of the first column."""
    column = list(loop.polynomial[:2])
    if len(loop.polynomial) == 3:
        column.append(loop.polynomial[2])
    elif column[1] != 0:
        _, a, b, c = loop.polynomial
        column += [b - c / a, c]
    return Routh(tuple(column), len(column) == len(loop.polynomial) and all(entry > 0 for entry in column))


def factorings(loop: Loop) -> tuple[Factoring, ...]:
    """One per real pole -kpx, the slowest first. None without an integrator."""
    if len(loop.polynomial) == 3:
        return ()
    _, a, b, _ = loop.polynomial
    real = (-pole.real for pole in poles(loop) if pole.imag == 0)
    return tuple(Factoring(kpx, a - kpx, b - kpx * (a - kpx)) for kpx in real)


def margins(loop: Loop, delay_s: float = 0.0) -> Margins | None:
    """The margins that are left with this delay in the loop; None if the loop is not stable with it."""
    if not routh(loop).stable:
        return None
    crossover = _bisect(lambda w: _magnitude(loop, w) < 1, *_bracket(lambda w: _magnitude(loop, w) < 1))
    phase = _phase_margin(loop, crossover, delay_s)
    if phase <= 0:
        return None
    gain_down = gain_up = math.inf
    if loop.gains.vel_i != 0:  # else the phase never falls below -180 degrees on this side
        lowest = _bisect(lambda w: _phase_margin(loop, w, delay_s) > 0, 0.0, crossover)
        gain_down = _magnitude(loop, lowest)
    if delay_s > 0:  # both arcs together stay below π: the phase is used up at the latest where ω τ = π/2
        highest = _bisect(lambda w: _phase_margin(loop, w, delay_s) <= 0, crossover, math.pi / (2 * delay_s))
        gain_up = 1 / _magnitude(loop, highest)
    return Margins(crossover, phase, phase / crossover, gain_up, gain_down)


def slowed(gains: AxisGains, factor: float) -> AxisGains:
    """The same motion ``factor`` times slower; every delay margin is multiplied by it (the λ rule)."""
    return AxisGains(gains.pos_p_per_s / factor, gains.vel_p / factor, gains.vel_i / factor**2)


def delay_margin_s(loop: Loop, lag_s: float = 0.0) -> float:
    """The pure delay from which on the loop is unstable, on an airframe with this lag; 0 if it is without any."""
    if not routh(loop).stable:
        return 0.0

    def beyond(w: float) -> bool:
        return _magnitude(loop, w) < math.hypot(1.0, lag_s * w)

    crossover = _bisect(beyond, *_bracket(beyond))
    return max(0.0, _phase_margin(loop, crossover, 0.0) - math.atan(lag_s * crossover)) / crossover


def suggest(
    loop: Loop, delay_s: float, reserve: float = DEFAULT_RESERVE, *, held_s: float = 0.0, lag_s: float = 0.0
) -> Suggestion | None:
    """The gains, slowed just so much that the delay margin is ``reserve`` times the delay; never made faster.

    ``held_s``: half the period of the outputs and half that of the states, which count as delay. ``lag_s``: of the
    airframe. None for a loop that is unstable without delay: slowing does not help it. Raises ValueError for a reserve
    below 1.
    """
    if reserve < 1:
        raise ValueError("a reserve below 1 would be unstable")
    bearable_s, wanted_s = delay_margin_s(loop), reserve * (delay_s + held_s)
    if bearable_s == 0.0:
        return None
    factor = max(1.0, wanted_s / bearable_s)
    if lag_s > 0:

        def enough(factor: float) -> bool:
            return delay_margin_s(Loop(slowed(loop.gains, factor), loop.plant_gain), lag_s) >= wanted_s

        if not enough(factor):  # a lag leaves more of the margin the slower the loop is: it rises with the factor
            low, high = factor, 2.0 * factor
            while not enough(high):
                low, high = high, 2.0 * high
            factor = _bisect(enough, low, high)
    return Suggestion(factor, slowed(loop.gains, factor))


def bearable_delay_s(config: ControlConfig, reserve: float = DEFAULT_RESERVE) -> float | None:
    """The largest loop delay with which `why_not_delay` lets these gains be flown; None if it cannot be known."""
    try:
        found = [delay_margin_s(Loop(gains, GRAVITY_MPS2 / config.hover_thrust)) for gains in (config.xy, config.z)]
    except ValueError:
        return None
    return max(0.0, math.floor((min(found) - config.period_s / 2) / reserve * 1000) / 1000)


def why_not_delay(config: ControlConfig, delay_s: float, reserve: float = DEFAULT_RESERVE) -> str | None:
    """Why these gains must not be flown as attitude with a loop delay of ``delay_s``; None if they bear it.

    Each axis on its true plant, g/hover. Wanted of the delay margin is ``reserve`` times the delay, for all the model
    leaves out, and half a period for an output that is held until the next, which is known and needs no reserve.
    Takes 0.2 ms and no numpy: fit for an order, not for a tick. Raises ValueError for a reserve below 1, and for a
    negative or infinite delay.
    """
    if reserve < 1:
        raise ValueError("a reserve below 1 would be unstable")
    if not 0 <= delay_s < math.inf:
        raise ValueError(f"a delay of {delay_s} s is not possible: 0 or more")
    problems = (
        _why_not_axis(axis, gains, config, delay_s, reserve) for axis, gains in (("xy", config.xy), ("z", config.z))
    )
    return "; ".join(problem for problem in problems if problem) or None


def _why_not_axis(axis: str, gains: AxisGains, config: ControlConfig, delay_s: float, reserve: float) -> str | None:
    try:
        bearable = margins(Loop(gains, GRAVITY_MPS2 / config.hover_thrust))
    except ValueError as error:
        return f"{axis}: nobody knows which delay these gains bear: {error}"
    if bearable is None:
        return f"{axis}: these gains are unstable without any delay"
    margin_s, held_s = bearable.delay_margin_s, config.period_s / 2
    wanted_s = reserve * delay_s + held_s
    if wanted_s <= margin_s:
        return None
    text = (
        f"{axis}: these gains are unstable from {margin_s:.3f} s of delay on, and {reserve:g} times {delay_s:g} s plus "
        f"half a period ({held_s:g} s) is {wanted_s:.3f} s"
    )
    if margin_s <= held_s:
        return f"{text}; they need a faster loop, or slower gains"
    allowed_s = math.floor((margin_s - held_s) / reserve * 1000) / 1000
    factor = math.ceil(wanted_s / margin_s * 100) / 100
    return (
        f"{text}; allow at most {allowed_s:g} s of delay, or divide pos_p_per_s and vel_p by {factor:g} and vel_i by "
        "its square"
    )


def step_response(
    loop: Loop,
    *,
    delay_s: float = 0.0,
    duration_s: float = 20.0,
    period_s: float = CONTINUOUS_PERIOD_S,
    lag_s: float = 0.0,
) -> StepResponse:
    """Simulate a step of the reference, the delay being on the way to the vehicle.

    The law runs once per ``period_s`` and its output is held; between, the double integrator behind the airframe's lag
    is solved exactly, for delays that are no multiple of the period, too. Ends early if it diverges.
    """
    (kp, kv, ki), g = _gains(loop), loop.plant_gain
    whole = int(delay_s / period_s)
    late = delay_s - whole * period_s  # in each period the older of two outputs still acts for so long
    early = period_s - late
    delayed = [0.0] * (whole + 2)
    x = v = a = integral = 0.0
    positions = [x]
    for tick in range(math.ceil(duration_s / period_s)):
        error = kp * (1.0 - x) - v
        delayed[tick % (whole + 2)] = kv * error + integral
        integral += ki * error * period_s
        older = g * delayed[(tick + 1) % (whole + 2)]
        newer = g * delayed[(tick + 2) % (whole + 2)]
        for wanted, span_s in ((older, late), (newer, early)):
            x, v, a = _moved(x, v, a, wanted, span_s, lag_s)
        positions.append(x)
        if abs(x) > DIVERGED:
            break
    return _described(period_s, positions)


def _moved(x: float, v: float, a: float, wanted: float, span_s: float, lag_s: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration after a span with one wanted acceleration."""
    if lag_s == 0:
        return x + v * span_s + 0.5 * wanted * span_s * span_s, v + wanted * span_s, wanted
    left, gone = a - wanted, -math.expm1(-span_s / lag_s)
    moved = x + v * span_s + wanted * span_s * span_s / 2 + left * lag_s * (span_s - lag_s * gone)
    return moved, v + wanted * span_s + left * lag_s * gone, wanted + left * (1 - gone)


def _described(period_s: float, positions: list[float]) -> StepResponse:
    outside = [n for n, x in enumerate(positions) if abs(x - 1) > SETTLED_WITHIN]
    tenth = next((n for n, x in enumerate(positions) if x >= 0.1), None)
    most = next((n for n, x in enumerate(positions) if x >= 0.9), None)
    return StepResponse(
        period_s,
        tuple(positions),
        max(0.0, max(positions) - 1),
        None if tenth is None or most is None else (most - tenth) * period_s,
        (outside[-1] + 1) * period_s if outside[-1] < 0.9 * (len(positions) - 1) else None,
    )


def _gains(loop: Loop) -> tuple[float, float, float]:
    """Kp, Kv, Ki of the module's text."""
    return loop.gains.pos_p_per_s, loop.gains.vel_p, loop.gains.vel_i


def _magnitude(loop: Loop, w: float) -> float:
    """|L(jω)|; a delay does not change it."""
    kp, kv, ki = _gains(loop)
    return abs(loop.plant_gain) * math.hypot(kv * w, ki) * math.hypot(w, kp) / w**3


def _phase_margin(loop: Loop, w: float, delay_s: float) -> float:
    """φ(ω) of the module's text: the phase of L above -180 degrees, of a loop that is stable without delay."""
    kp, kv, ki = _gains(loop)  # there G, Kv and Ki have the same sign
    return math.atan2(abs(kv) * w, abs(ki)) + math.atan2(w, kp) - w * delay_s - math.pi / 2


def _bracket(beyond: Callable[[float], bool]) -> tuple[float, float]:
    """Two frequencies a factor 2 apart with the one where ``beyond`` becomes true between them."""
    w = 1.0
    while beyond(w):
        w /= 2
    while not beyond(w):
        w *= 2
    return w / 2, w


def _bisect(beyond: Callable[[float], bool], low: float, high: float) -> float:
    """Where ``beyond`` becomes true, between ``low`` (where it is not) and ``high`` (where it is)."""
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if beyond(middle):
            high = middle
        else:
            low = middle
    return high
