"""The user's own controller as a source of setpoints: the newest raw setpoint, and the tilt that ends it. Pure.

Body rates and thrust bound neither tilt nor speed, so both are watched by what the vehicle reports: the speed by
`OffboardController` (the control fence looks ahead), the tilt here. It must not exceed tilt_max_deg by more than
TILT_SLACK_DEG, and for body rates it must be reported. Either makes the vehicle hold its position by position setpoints
(the guard's ``raw_refused``).
"""

from __future__ import annotations

import math

from skygcs.core.vehicle.raw_setpoint import RawLimits, RawSetpoint
from skygcs.core.vehicle.vehicle import Vehicle

TILT_SLACK_DEG = 10.0
"""An attitude loop overshoots: by some 5 degrees in a step of 35 (both firmwares in simulation)."""

TILT_FRESH_S = 0.5
"""An older attitude does not show what body rates have made of it: 90 degrees at 180 degrees/s."""


class RawSource:
    """Raw setpoints of one vehicle; times are the loop's."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.setpoint: RawSetpoint | None = None
        """The one in force."""
        self._until = -math.inf
        self._vehicle = vehicle

    def follow(self, setpoint: RawSetpoint, until: float) -> None:
        """The newest setpoint, in force ``until`` then."""
        self.setpoint, self._until = setpoint, until

    def end(self) -> None:
        """No setpoint is in force."""
        self.setpoint = None

    def expire(self, now: float) -> bool:
        """End a setpoint whose deadline has passed. True in the tick in which that happens."""
        if self.setpoint is None or now <= self._until:
            return False
        self.setpoint = None
        return True

    def tilt_cosine(self, now: float) -> float | None:
        """Cosine of the tilt the vehicle reports; None if that is too old or not known."""
        attitude, at = self._vehicle.message_cache.telemetry("attitude")
        if attitude is None or now - at > TILT_FRESH_S:
            return None
        return math.cos(math.radians(attitude["roll_deg"])) * math.cos(math.radians(attitude["pitch_deg"]))

    def tilt_refusal(self, limits: RawLimits, now: float) -> str | None:
        """Why the tilt forbids the setpoint in force; None if it does not."""
        if self.setpoint is None:
            return None
        cosine = self.tilt_cosine(now)
        if cosine is None:
            if self.setpoint.kind != "rates":
                return None
            return f"body rates need the vehicle's attitude, and none has come for {TILT_FRESH_S:g} s"
        most_deg = limits.tilt_max_deg + TILT_SLACK_DEG
        tilt_deg = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        if tilt_deg <= most_deg:
            return None
        limit = f"limit {most_deg:g}°: control.raw.tilt_max_deg and {TILT_SLACK_DEG:g}°"
        return f"the vehicle tilts by {tilt_deg:.0f}° ({limit})"
