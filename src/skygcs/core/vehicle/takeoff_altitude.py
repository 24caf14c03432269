"""How high the ground is that a vehicle took off from."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skygcs.core.vehicle.vehicle import Vehicle

HEARD_S = 1.5
"""A heartbeat older than this does not tell whether it is still disarmed; they come at 1 Hz."""

POSITION_FRESH_S = 5.0
"""Of a vehicle that stands; the slowest stream profile sends 0.5 Hz, and one may be lost."""

STANDS_MPS = 0.5
"""Climbing or sinking faster is flying, whatever the landed state, which comes every two seconds, still says."""


class TakeoffAltitude:
    """``alt_amsl_m``: where it stood when it last armed, or lifted off again; None if nobody here saw it stand.

    A vehicle that is met in the air (the daemon was started in mid-flight) has none until it has landed: whoever needs
    one then falls back on its home's altitude. It is kept over a landing, until the next take-off, and forgotten at a
    reboot.
    """

    def __init__(self) -> None:
        self.alt_amsl_m: float | None = None
        self._standing_amsl_m: float | None = None
        self._wanted = True

    def look(self, vehicle: Vehicle, now: float) -> None:
        """Once a second."""
        silence_s = vehicle.silence_s(now)
        if silence_s is None or silence_s > HEARD_S:
            return
        in_air = vehicle.in_air(now)
        self._standing_amsl_m = _standing(vehicle, now) if in_air is False else None
        if vehicle.armed and self._wanted:
            if self._standing_amsl_m is not None:
                self.alt_amsl_m = self._standing_amsl_m
            self._wanted = self._standing_amsl_m is None and not in_air

    def armed(self, *, seen: bool) -> None:
        """It is armed, and was not. ``seen``: its heartbeats told; not, if it was lost in between."""
        self.alt_amsl_m = self._standing_amsl_m if seen else None
        self._wanted = self.alt_amsl_m is None

    def touched_down(self) -> None:
        """It stands again; still armed it may take off from there without a word."""
        self._wanted = True

    def forget(self) -> None:
        self.alt_amsl_m = self._standing_amsl_m = None
        self._wanted = True


def _standing(vehicle: Vehicle, now: float) -> float | None:
    position, at = vehicle.section("position"), vehicle.section_at("position")
    if position is None or at is None or position["lat_deg"] is None or now - at > POSITION_FRESH_S:
        return None
    return float(position["alt_amsl_m"]) if abs(position["vel_enu_mps"][2]) < STANDS_MPS else None
