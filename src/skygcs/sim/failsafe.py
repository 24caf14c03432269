"""When a simulated vehicle's failsafes go off. What they do is in `px4_failsafe` and `copter_failsafe`.

Each goes off once when its trouble begins, and again only after the trouble has ended.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from skygcs.sim import protocol as m

if TYPE_CHECKING:
    from skygcs.sim.vehicle import SimVehicle

GPS_FAILSAFE_S = 5.0
"""In the air without GPS for longer than this: the estimate has drifted too far to go on."""


class ConditionTimer:
    """One condition and since when it holds."""

    __slots__ = ("_since", "raised", "raised_at")

    def __init__(self) -> None:
        self._since: float | None = None
        self.raised = False
        self.raised_at: float | None = None
        """When it went off last."""

    def check(self, bad: bool, now: float, after_s: float = 0.0) -> bool:
        """True at the one moment when it has been bad for ``after_s``."""
        if not bad:
            self._since = None
            self.raised = False
            return False
        if self._since is None:
            self._since = now
        if self.raised or now - self._since < after_s:
            return False
        self.raised = True
        self.raised_at = now
        return True


class Failsafes:
    """The alarms of one vehicle; anew with every boot."""

    __slots__ = ("battery_critical", "battery_emergency", "battery_low", "fence", "gcs", "gcs_heard_at", "position")

    def __init__(self) -> None:
        self.position = ConditionTimer()
        self.battery_low = ConditionTimer()
        self.battery_critical = ConditionTimer()
        self.battery_emergency = ConditionTimer()
        self.gcs = ConditionTimer()
        self.fence = ConditionTimer()
        self.gcs_heard_at: float | None = None
        """None: never; who has never had a ground station does not miss it."""

    def gcs_lost(self, now: float, timeout_s: float) -> bool:
        """True at the moment the ground station has been silent for too long."""
        heard = self.gcs_heard_at
        return self.gcs.check(heard is not None and now - heard > timeout_s, now)

    def position_lost(self, v: SimVehicle, now: float) -> bool:
        """True at the moment the vehicle, in the air, has been without GPS for too long."""
        return self.position.check(not v.position_ok and not v.landed, now, GPS_FAILSAFE_S)


def outside(v: SimVehicle, east_m: float, north_m: float, up_m: float, *, radius_m: float, height_m: float) -> str:
    """Which side of a cylinder about home this place is beyond: "distance", "height" or ""; a size of 0 is no bound."""
    home = v.home
    if home is None:
        return ""
    if radius_m > 0 and hypot(east_m - home.east_m, north_m - home.north_m) > radius_m:
        return "distance"
    return "height" if height_m > 0 and up_m - home.up_m > height_m else ""


def tell_breach(v: SimVehicle, breach: str) -> None:
    """Keep in mind, for telemetry, which side of its fence it is beyond: as `outside` says, or "polygon"."""
    kind = m.FENCE_BREACH_NONE
    if breach:
        kind = m.FENCE_BREACH_MAXALT if breach == "height" else m.FENCE_BREACH_BOUNDARY
    if kind != m.FENCE_BREACH_NONE and v.fence_breach == m.FENCE_BREACH_NONE:
        v.fence_breaches += 1
    v.fence_breach = kind
