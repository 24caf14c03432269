"""Seeded randomness: the same seed gives the same flight, to the byte."""

from __future__ import annotations

from random import Random


class Rng(Random):
    """`random.Random`, and what the models ask of it."""

    def spread(self, size: float) -> float:
        """Around 0 within ±size, the middle more likely than the ends."""
        return self.triangular(-size, size) if size else 0.0

    def happens(self, probability: float) -> bool:
        return probability > 0.0 and self.random() < probability

    def child_seed(self) -> int:
        """A seed for something else that is to be random on its own."""
        return self.getrandbits(31)
