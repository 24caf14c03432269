"""Steps in virtual time: the law and a quadrotor with a pure delay between them, nothing else.

The delay is all of it, telemetry down and setpoint up; where in the loop it sits changes nothing. It is on the
setpoint's way here. What holding an output for a period adds, half a period, is on top, as in field-notes 10.4.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from bench.control.measures import swing_m
from skygcs.core.control import ControlConfig, Estimate, Memory, Reference, step
from skygcs.core.control.analysis import slowed
from skygcs.core.control.gains import GRAVITY_MPS2, UTIAS_XY, UTIAS_Z, AxisGains
from skygcs.sim.quad import F450, IDEAL, Airframe, Quad
from skygcs.sim.wind import Wind

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
START_M = 50.0
"""High enough that nothing that swings meets the ground."""

SUB_S = 0.01
"""Step of the airframe, which halves it itself; delays are whole numbers of it. With half of it an overshoot of 65.8 %
is 66.4 %, and below 20 % none moves by more than 0.2."""

EAST, UP = 0, 2
ATTITUDE_LAG = replace(IDEAL, attitude_lag_s=0.15)
"""Ideal but for the lag of the attitude."""
SEED = ControlConfig()
SLOW_Z = ControlConfig(z=slowed(UTIAS_Z, 4.0))
"""For the horizontal loop alone: at its own gains z swings first, and takes the thrust from x and y."""

LAST_S = 20.0
"""The end of a flight, in which it is to have come to rest."""
LONG_S = 80.0
NUDGE_M = 0.1
"""Small enough that no limit is met, where a swing that grows and one that dies are told apart at once."""


@dataclass(frozen=True, slots=True)
class Flight:
    """Under what a step is flown. ``delay_s`` in whole SUB_S."""

    frame: Airframe = IDEAL
    step_m: Vector = (3.0, 0.0, 0.0)
    delay_s: float = 0.0
    config: ControlConfig = SEED
    following: bool = True
    wind_enu_mps: Vector = ZERO
    supply_v: float = F450.nominal_v
    """Of the battery. A fuller one lifts more: it then begins with the integral that keeps the height."""
    seconds: float = 40.0


def fly(flight: Flight) -> list[Vector]:
    """Positions (ENU, m, from the start) at every tick, from a hover on the spot."""
    config = flight.config
    quad = Quad(flight.frame, wind=Wind(flight.wind_enu_mps))
    quad.place(0.0, 0.0, START_M)
    quad.supply_v = flight.supply_v
    if flight.frame.battery_sag:
        quad.thrust = config.hover_thrust * (flight.frame.nominal_v / flight.supply_v) ** 2
    memory = Memory((0.0, 0.0, quad.thrust - config.hover_thrust))
    east, north, up = flight.step_m
    reference = Reference((east, north, START_M + up))
    hover, _ = step(config, memory, _estimate(quad), Reference(quad.pos_enu_m), config.period_s, following=False)
    assert hover is not None
    under_way = deque([hover] * round(flight.delay_s / SUB_S))
    track = []
    for _ in range(round(flight.seconds / config.period_s)):
        estimate = _estimate(quad)
        track.append((quad.east_m, quad.north_m, quad.up_m - START_M))
        output, memory = step(config, memory, estimate, reference, config.period_s, following=flight.following)
        assert output is not None, "the simulator only has numbers"
        for _ in range(round(config.period_s / SUB_S)):
            under_way.append(output)
            due = under_way.popleft()
            quad.fly(SUB_S, due.attitude_ned_frd, due.collective_thrust)
    return track


def axis(track: list[Vector], number: int) -> list[float]:
    return [position[number] for position in track]


def _estimate(quad: Quad) -> Estimate:
    return Estimate(quad.pos_enu_m, quad.vel_enu_mps)


# -- what the arithmetic says beforehand


def bearable_delay_s(gains: AxisGains, lags_s: tuple[float, ...], drag_per_s: float, period_s: float) -> float:
    """The pure delay from which on the linear loop swings: the margin of L(s) = G (Kv s + Ki)(s + Kp) / (s² (s + drag))
    with these first-order lags in it, less half a period for holding each output."""
    kp, kv, ki = gains.pos_p_per_s, gains.vel_p, gains.vel_i

    def loop(w: float) -> complex:
        s = 1j * w
        value = GRAVITY_MPS2 / ControlConfig().hover_thrust * (kv * s + ki) * (s + kp)
        value /= s * s * (s + drag_per_s)
        for lag_s in lags_s:
            value /= 1 + lag_s * s
        return value

    crossover = _falls_to_one(lambda w: abs(loop(w)))
    phase = math.pi - (-cmath.phase(loop(crossover)) % (2 * math.pi))
    return phase / crossover - period_s / 2


def _falls_to_one(size: Callable[[float], float]) -> float:
    low, high = 1e-3, 1e3
    for _ in range(100):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if size(middle) > 1 else (low, middle)
    return low


def drag_mps2(frame: Airframe, wind_mps: float) -> float:
    """What a wind pushes a vehicle that stays where it is."""
    force_n = frame.drag_linear_n_per_mps * wind_mps + frame.drag_quadratic_n_per_mps2 * wind_mps**2
    return force_n / frame.mass_kg


@dataclass(frozen=True, slots=True)
class WindArithmetic:
    """What a steady push does to the linear horizontal loop."""

    push_mps2: float
    offset_m: float
    """Where it stays without the integral: push = G Kv Kp x."""
    most_m: float
    """About how far it is blown before the integral has begun: push = G (Kv Kp + Ki) x."""
    slow_pole_per_s: float
    """Kp Ki / (Kv Kp + Ki): at this rate the integral takes it back."""

    def below_s(self, off_m: float) -> float:
        """From when on it is nearer than that."""
        return max(0.0, math.log(self.most_m / off_m) / self.slow_pole_per_s)


def wind_arithmetic(frame: Airframe, wind_mps: float, gains: AxisGains = UTIAS_XY) -> WindArithmetic:
    """Small angles; the drag as it is for a vehicle at rest."""
    push, plant = drag_mps2(frame, wind_mps), GRAVITY_MPS2 / frame.hover_thrust
    stiff = gains.vel_p * gains.pos_p_per_s
    return WindArithmetic(
        push,
        push / (plant * stiff),
        push / (plant * (stiff + gains.vel_i)),
        gains.pos_p_per_s * gains.vel_i / (stiff + gains.vel_i),
    )


def swings_on(track_m: list[float], period_s: float) -> bool:
    """Whether a nudge still moves it, and no less than before: near its margin a loop takes long to come to rest, and a
    limit cycle long to find its size."""
    before = swing_m(track_m[: -round(LAST_S / period_s)], LAST_S, period_s)
    last = swing_m(track_m, LAST_S, period_s)
    return last > 0.1 * NUDGE_M and last > 0.9 * before


def first_swinging_s(flight: Flight, number: int, about_s: float) -> float | None:
    """The first delay, in whole SUB_S near ``about_s``, with which a nudge along that axis swings on; None: none."""
    period_s = flight.config.period_s
    nudge = (NUDGE_M, 0.0, 0.0) if number == EAST else (0.0, 0.0, NUDGE_M)
    for n in range(max(0, round(about_s / SUB_S) - 4), round(about_s / SUB_S) + 8):
        track = fly(replace(flight, step_m=nudge, delay_s=n * SUB_S, seconds=LONG_S))
        if swings_on(axis(track, number), period_s):
            return round(n * SUB_S, 3)
    return None


AIRFRAMES: dict[str, Airframe] = {"attitude at once": IDEAL, "lag 0.15 s": ATTITUDE_LAG, "F450": F450}
LAGS_S: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "attitude at once": ((), ()),
    "lag 0.15 s": ((0.15,), ()),
    "F450": ((0.15,), (0.05,)),
}
"""Of each airframe, horizontally (where the push points) and vertically (how strong it is)."""
