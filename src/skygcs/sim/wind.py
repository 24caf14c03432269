"""Wind about a simulated vehicle: a steady part and gusts.

Gusts are an Ornstein-Uhlenbeck process per axis, the first-order form of the Dryden spectra (MIL-F-8785C) seen by a
vehicle that hovers.
"""

from __future__ import annotations

from math import exp, sqrt

from skygcs.sim.body import Vector
from skygcs.sim.rng import Rng

GUST_CORRELATION_S = 2.0
"""Dryden's low-altitude length of some 10 m at the height of a lab flight, carried past by 5 m/s."""

VERTICAL_SHARE = 0.5
"""Vertical gusts near the ground are about half as strong as horizontal ones."""


class Wind:
    """``mean_enu_mps`` is where the air moves to; ``gust_mps`` the standard deviation of each horizontal axis."""

    __slots__ = ("_dt_s", "_gust", "_keep", "_kick", "_rng", "gust_mps", "mean_enu_mps")

    def __init__(self, mean_enu_mps: Vector = (0.0, 0.0, 0.0), gust_mps: float = 0.0, seed: int = 1) -> None:
        self.mean_enu_mps = mean_enu_mps
        self.gust_mps = gust_mps
        self._rng = Rng(seed)
        self._gust = (0.0, 0.0, 0.0)
        self._dt_s = self._keep = self._kick = 0.0

    def step(self, dt_s: float) -> Vector:
        """The air's velocity (ENU, m/s) over the next ``dt_s``."""
        mean = self.mean_enu_mps
        size = self.gust_mps
        if size <= 0.0:
            return mean
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._keep = exp(-dt_s / GUST_CORRELATION_S)
            self._kick = sqrt(1.0 - self._keep * self._keep)
        keep, kick, normal = self._keep, self._kick * size, self._rng.gauss
        east, north, up = self._gust
        east = keep * east + kick * normal()
        north = keep * north + kick * normal()
        up = keep * up + kick * VERTICAL_SHARE * normal()
        self._gust = (east, north, up)
        return mean[0] + east, mean[1] + north, mean[2] + up
