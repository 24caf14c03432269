"""The battery of a simulated vehicle: charge drawn by time and flight, voltage by charge and load."""

from __future__ import annotations

IDLE_A = 0.4
"""Electronics of an F450-sized quadrotor."""

HOVER_A = 15.0
"""Hover current of a 1.5 kg quadrotor on 4S: some 15 minutes from 5.2 Ah, what the UTIAS F450s flew."""

CELL_EMPTY_V = 3.3
CELL_FULL_V = 4.2
RESISTANCE_OHM = 0.02
CELLS = 4
CAPACITY_MAH = 5200.0


class Battery:
    """`CELLS` in series, `CAPACITY_MAH`; full at power-up."""

    __slots__ = ("amps", "used_mah")

    def __init__(self) -> None:
        self.used_mah = 0.0
        self.amps = IDLE_A

    def step(self, dt_s: float, *, flying: bool, climb_mps: float = 0.0) -> None:
        self.amps = HOVER_A + max(0.0, climb_mps) * 1.5 if flying else IDLE_A
        self.used_mah = min(CAPACITY_MAH, self.used_mah + self.amps * dt_s / 3.6)

    def set_percent(self, percent: float) -> None:
        """Put it at this state of charge (0..100)."""
        self.used_mah = CAPACITY_MAH * (1 - min(100.0, max(0.0, percent)) / 100)

    @property
    def percent(self) -> int:
        return round(100 * (1 - self.used_mah / CAPACITY_MAH))

    @property
    def volts(self) -> float:
        charge = 1 - self.used_mah / CAPACITY_MAH
        return CELLS * (CELL_EMPTY_V + (CELL_FULL_V - CELL_EMPTY_V) * charge) - self.amps * RESISTANCE_OHM
