"""The altitude of the ground from which a vehicle took off."""

from __future__ import annotations

from skygcs.core.vehicle.decoding import TelemetryGroup

HEARD_S = 1.5
"""An older heartbeat does not show whether the vehicle is still disarmed; heartbeats come at 1 Hz."""

STANDING_POSITION_S = 5.0
"""Oldest position that is the altitude of the ground: the vehicle stands, and must be the same one that stands there
now. The slowest stream profile sends 0.5 Hz, so that one may be lost."""

STANDS_MPS = 0.5
"""A vehicle that climbs or sinks faster is flying, even if the landed state, sent every two seconds, is still old."""


class TakeoffAltitude:
    """``alt_amsl_m``: altitude at which the vehicle last armed or lifted off again; None if that was not observed.

    A vehicle that is first heard in the air (the daemon was started in mid-flight) has no take-off altitude until it
    has landed; callers then use its home's altitude. The altitude is kept over a landing, until the next take-off, and
    forgotten at a reboot.
    """

    def __init__(self) -> None:
        self.alt_amsl_m: float | None = None
        self._standing_amsl_m: float | None = None
        self._wanted = True

    def update(
        self, silence_s: float | None, *, armed: bool, in_air: bool | None, standing_amsl_m: float | None
    ) -> None:
        """Update the altitude, once a second. ``silence_s``: time since the last heartbeat. ``in_air``: None if that is
        not known.

        ``standing_amsl_m``: its altitude, if that is fresh and it neither climbs nor sinks (`standing_amsl_m`).
        """
        if silence_s is None or silence_s > HEARD_S:
            return
        self._standing_amsl_m = standing_amsl_m if in_air is False else None
        if armed and self._wanted:
            if self._standing_amsl_m is not None:
                self.alt_amsl_m = self._standing_amsl_m
            self._wanted = self._standing_amsl_m is None and not in_air

    def armed(self, *, seen: bool) -> None:
        """The vehicle was disarmed and is armed now. ``seen``: False if it was lost in between."""
        self.alt_amsl_m = self._standing_amsl_m if seen else None
        self._wanted = self.alt_amsl_m is None

    def touched_down(self) -> None:
        """Note that it stands again. While it is still armed it may take off from there without a further order."""
        self._wanted = True

    def forget(self) -> None:
        self.alt_amsl_m = self._standing_amsl_m = None
        self._wanted = True


def standing_amsl_m(position: TelemetryGroup | None, age_s: float) -> float | None:
    """The altitude of a position of this age if the vehicle may be standing; else None."""
    if position is None or position["lat_deg"] is None or age_s > STANDING_POSITION_S:
        return None
    return float(position["alt_amsl_m"]) if abs(position["vel_enu_mps"][2]) < STANDS_MPS else None
