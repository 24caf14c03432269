"""Where the reference of flight control comes from: a place to hold, or a stream of setpoints. Pure.

source    reference                                 what ends it
-------   ---------------------------------------   ---------------------------------------------------------
hold      a point on earth, at rest                 `follow` -> stream
stream    the newest setpoint of a client           its deadline, `stay` -> hold where the vehicle then is;
                                                    `hold_at` -> hold there
"""

from __future__ import annotations

from skygcs.core.control.cascade import ZERO, Reference
from skygcs.core.vehicle.estimate_view import EstimateView
from skygcs.core.vehicle.geodetic_position import GeodeticPosition, Setpoint


class ReferenceSource:
    """The reference of one vehicle, in the local frame of its `EstimateView`; times are the loop's."""

    def __init__(self, estimate_view: EstimateView) -> None:
        self.reference = Reference()
        self._estimate_view = estimate_view
        self._until: float | None = None

    @property
    def streaming(self) -> bool:
        """Whether a stream of setpoints moves the reference now."""
        return self._until is not None

    @property
    def velocity_only(self) -> bool:
        """Whether at least one axis follows a velocity and has no position."""
        return self.reference.velocity_only_xy or self.reference.velocity_only_z

    def hold_at(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> None:
        """Hold a point on earth; None keeps the yaw."""
        yaw = self.reference.yaw_rad if yaw_enu_rad is None else yaw_enu_rad
        self.reference = Reference(self._estimate_view.in_local_frame(place), yaw)
        self._until = None

    def follow(self, setpoint: Setpoint, until: float) -> None:
        """The newest setpoint of a stream, valid ``until`` then."""
        yaw = self.reference.yaw_rad if setpoint.yaw_enu_rad is None else setpoint.yaw_enu_rad
        self.reference = Reference(
            ZERO if setpoint.place is None else self._estimate_view.in_local_frame(setpoint.place),
            yaw,
            setpoint.vel_enu_mps or ZERO,
            setpoint.acc_enu_mps2 or ZERO,
            velocity_only_xy=setpoint.free_xy,
            velocity_only_z=setpoint.free_z,
        )
        self._until = until

    def stay(self, yaw_rad: float | None = None) -> None:
        """Hold where the vehicle is now; None keeps the yaw."""
        estimate = self._estimate_view.estimate()
        position = self.reference.pos_enu_m if estimate is None else estimate.pos_enu_m
        self.reference = Reference(position, self.reference.yaw_rad if yaw_rad is None else yaw_rad)
        self._until = None

    def end_stream(self) -> None:
        """The stream ends; the reference remains for whoever reads the status."""
        self._until = None

    def expire(self, now: float) -> bool:
        """End a stream whose deadline has passed: hold where the vehicle is. True in the tick in which that happens."""
        if self._until is None or now <= self._until:
            return False
        self.stay()
        return True
