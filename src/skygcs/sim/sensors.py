"""Sensors of a simulated vehicle, and the estimate that it reports: the truth, a slow error, some delay.

An estimator's error is smooth: each is an Ornstein-Uhlenbeck process. Without noise and latency all three are the
same object and cost nothing.
"""

from __future__ import annotations

from collections import deque
from math import exp, sqrt

from skygcs.sim.body import Body, Vector, wrap_pi
from skygcs.sim.conditions import Conditions
from skygcs.sim.rng import Rng

GPS_WANDER_S = 30.0
"""Correlation time of a GPS position error under open sky."""

ATTITUDE_WANDER_S = 1.0

VERTICAL_FACTOR = 1.5
"""GPS heights are worse than positions by about so much (its geometry: VDOP over HDOP)."""

SPEED_NOISE_PER_S = 0.1
"""Velocity noise (m/s) per metre of position noise: 5 cm/s at 0.5 m, a u-blox M8's data sheet."""

MAX_LATENCY_S = 2.0


class Drift:
    """Some numbers that wander about 0 with a standard deviation of 1 and forget after ``correlation_s``."""

    __slots__ = ("_keep", "_kick", "_rng", "values")

    def __init__(self, size: int, correlation_s: float, dt_s: float, rng: Rng) -> None:
        self._keep = exp(-dt_s / correlation_s)
        self._kick = sqrt(1.0 - self._keep * self._keep)
        self._rng = rng
        self.values = [rng.gauss() for _ in range(size)]

    def step(self) -> None:
        keep, kick, normal = self._keep, self._kick, self._rng.gauss
        self.values = [keep * value + kick * normal() for value in self.values]


class Sensors:
    """``estimated`` is the autopilot's own state, ``reported`` what it sends; `step` changes both, once per ``dt_s``.

    ``error_enu_m`` is the estimated minus the true position. The place where the vehicle was powered counts as known:
    the error begins with its first value, which is part of home.
    """

    __slots__ = (
        "_attitude",
        "_conditions",
        "_late",
        "_past",
        "_position",
        "_truth",
        "error_enu_m",
        "estimated",
        "reported",
    )

    def __init__(self, truth: Body, conditions: Conditions, dt_s: float, seed: int) -> None:
        self._truth = truth
        self._conditions = conditions
        rng = Rng(seed ^ 0x5E45)
        self._position = Drift(6, GPS_WANDER_S, dt_s, rng)
        self._attitude = Drift(3, ATTITUDE_WANDER_S, dt_s, rng)
        self._late = round(min(max(conditions.sensor_latency_s, 0.0), MAX_LATENCY_S) / dt_s)
        self._past: deque[Body] = deque()
        noisy = conditions.gps_noise_m > 0.0 or conditions.attitude_noise_rad > 0.0
        self.estimated: Body = Body() if noisy else truth
        self.error_enu_m: Vector = (0.0, 0.0, 0.0)
        self.reported: Body = self.estimated
        self.step()

    def step(self) -> None:
        """The truth has moved on by one ``dt_s``."""
        if self.estimated is not self._truth:
            self._err()
        if self._late:
            spare = self._past.popleft() if len(self._past) > self._late else Body()
            spare.copy(self.estimated)
            self._past.append(spare)
            self.reported = self._past[0]

    def _err(self) -> None:
        conditions, estimated = self._conditions, self.estimated
        estimated.copy(self._truth)
        if conditions.gps_noise_m > 0.0:
            self._position.step()
            size = conditions.gps_noise_m
            e, n, u, ve, vn, vu = self._position.values
            self.error_enu_m = (size * e, size * n, size * VERTICAL_FACTOR * u)
            estimated.east_m += size * e
            estimated.north_m += size * n
            estimated.up_m += size * VERTICAL_FACTOR * u
            estimated.vel_e_mps += size * SPEED_NOISE_PER_S * ve
            estimated.vel_n_mps += size * SPEED_NOISE_PER_S * vn
            estimated.vel_u_mps += size * SPEED_NOISE_PER_S * vu
        if conditions.attitude_noise_rad > 0.0:
            self._attitude.step()
            roll, pitch, yaw = self._attitude.values
            estimated.roll_rad += conditions.attitude_noise_rad * roll
            estimated.pitch_rad += conditions.attitude_noise_rad * pitch
            estimated.yaw_rad = wrap_pi(estimated.yaw_rad + conditions.attitude_noise_rad * yaw)
