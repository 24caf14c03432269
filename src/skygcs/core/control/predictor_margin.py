"""How wrong the delay may be for velocity control with prediction: exact, for one axis. Pure.

With T the lag of the autopilot's velocity loop, A the attitude's inside it (which the predictor leaves out), h the
delay that the predictor assumes and D the one there is, the loop of `velocity_predictor` is in the Laplace domain

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

from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.velocity_predictor import DISTURBANCE_TIME_S, OPPOSED, VelocityLoop

UNCERTAINTY = 0.3
"""Share of the delay by which it may be wrong, on either side."""

STEP_S = 0.02
"""Delays are looked up in steps of so much, rounded up."""

_LOWEST_RADPS, _HIGHEST_RADPS, _PER_DECADE = 0.01, 300.0, 80
_BISECTIONS = 40


@dataclass(frozen=True, slots=True)
class DelayRange:
    """The delays between which the loop is stable; ``assumed_s`` is what the predictor counts with."""

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
def velocity_delay_range(law: ControlConfig, loop: VelocityLoop, assumed_s: float) -> DelayRange | None:
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


def why_not_predicted(law: ControlConfig, loop: VelocityLoop, delay_s: float, uncertainty_s: float) -> str | None:
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
