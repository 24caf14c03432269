"""One axis of the control law over a link, in small steps of time: what the analysis is tested against, and made of
nothing of it.

    airframe ─> state, sampled at the telemetry's rate ─> way down ─> the newest is kept
       ^                                                                    │
       └── first-order lag <── kept until the next <── way up <── the law, at its own rate
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

STEP_S = 0.002
"""A fortieth of the fastest crossover in use (6.6 rad/s: 0.15 s)."""

SETTLED_M = 0.1
DIVERGED_M = 50.0


@dataclass(frozen=True, slots=True)
class SampledLoop:
    """What a step of 1 m came to. ``grows``: the largest error in the last fifth over that in the fifth before."""

    overshoot: float
    settled: bool
    grows: float


def fly_step(
    gains: tuple[float, float, float],
    *,
    plant_gain: float,
    lag_s: float,
    delays_s: tuple[float, float],
    rate_hz: float,
    telemetry_hz: float,
    phase: float,
    seconds: float | None = None,
) -> SampledLoop:
    """``gains``: position P, velocity P, velocity I. ``delays_s``: down and up. ``phase``: of the law's ticks against
    the telemetry, in periods. ``seconds``: by default ten time constants of the position loop."""
    kp, kv, ki = gains
    down_s, up_s = delays_s
    steps = round((10.0 / kp if seconds is None else seconds) / STEP_S)
    x = v = push = integral = wanted = 0.0
    seen = (0.0, 0.0)
    down: deque[tuple[float, tuple[float, float]]] = deque()
    up: deque[tuple[float, float]] = deque()
    sampled_at, ticks_at = 0.0, phase / rate_hz
    track = []
    for n in range(steps):
        now = n * STEP_S + 1e-9
        if now >= sampled_at:
            sampled_at += 1.0 / telemetry_hz
            down.append((now + down_s, (x, v)))
        while down and down[0][0] <= now:
            seen = down.popleft()[1]
        if now >= ticks_at:
            ticks_at += 1.0 / rate_hz
            error = kp * (1.0 - seen[0]) - seen[1]
            up.append((now + up_s, kv * error + integral))
            integral += ki * error / rate_hz
        while up and up[0][0] <= now:
            wanted = up.popleft()[1]
        push = wanted if lag_s == 0.0 else push + (wanted - push) * STEP_S / lag_s
        v += plant_gain * push * STEP_S
        x += v * STEP_S
        track.append(x)
        if abs(x) > DIVERGED_M:
            return SampledLoop(max(track) - 1.0, False, float("inf"))
    fifth = steps // 5
    last, before = (max(abs(x - 1.0) for x in part) for part in (track[-fifth:], track[-2 * fifth : -fifth]))
    return SampledLoop(max(track) - 1.0, last < SETTLED_M, last / before)
