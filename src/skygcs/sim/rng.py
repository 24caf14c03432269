"""Seeded chance: the same seed gives the same flight, to the byte."""

from __future__ import annotations

from math import cos, log, sqrt, tau

_MASK = 0xFFFFFFFFFFFFFFFF


class Rng:
    """xorshift64* (Vigna 2014, "An experimental exploration of Marsaglia's xorshift generators")."""

    __slots__ = ("_state",)

    def __init__(self, seed: int) -> None:
        # splitmix64's first step: neighbouring seeds must not give neighbouring sequences, and 0 would stay 0
        mixed = (seed + 0x9E3779B97F4A7C15) & _MASK
        mixed = ((mixed ^ mixed >> 30) * 0xBF58476D1CE4E5B9) & _MASK
        self._state = (mixed ^ mixed >> 27) or 1

    def fraction(self) -> float:
        """Uniform in [0, 1)."""
        x = self._state
        x ^= x >> 12
        x ^= x << 25 & _MASK
        x ^= x >> 27
        self._state = x
        return ((x * 0x2545F4914F6CDD1D & _MASK) >> 11) / (1 << 53)

    def spread(self, size: float) -> float:
        """Around 0 within ±size, the middle more likely than the ends (sum of two uniforms)."""
        return (self.fraction() + self.fraction() - 1.0) * size

    def happens(self, probability: float) -> bool:
        return probability > 0.0 and self.fraction() < probability

    def seed(self) -> int:
        """A seed for something else that is to have a chance of its own."""
        return int(self.fraction() * (1 << 31))

    def normal(self) -> float:
        """Mean 0, standard deviation 1 (Box and Muller 1958)."""
        return sqrt(-2.0 * log(1.0 - self.fraction())) * cos(tau * self.fraction())
