"""The conditions under which a vehicle's flight by setpoints may begin, checked before anything is sent.

condition                                                  asked of                      insisting (``force``)
--------------------------------------------------------   ---------------------------   ---------------------
it may be commanded from here                              the links' gates              refused
it flies, and has a mode that follows setpoints            `offboard_entry`              refused
the fleet has an origin, and it is inside its fence        fleet file, its position      refused
no other program sends it setpoints                        its mode                      refused
its radio can carry a stream of setpoints                  the links                     allowed
attitude, raw: its thrust means thrust                     its parameters, read anew     refused
attitude, raw: it does not keep a tilt without setpoints   its parameters, read anew     allowed
"""

from __future__ import annotations

import math

from skygcs.config.control import ControlSettings
from skygcs.core.control.guard import ControlMode
from skygcs.core.vehicle import offboard_entry
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.runtime.order_runner import OrderRunner
from skygcs.runtime.vehicle_services import VehicleServices


class EntryConditions:
    """Conditions of one vehicle. ``active``: its setpoints flow already, so only the control mode would change."""

    def __init__(
        self, vehicle: Vehicle, settings: ControlSettings, order_runner: OrderRunner, services: VehicleServices
    ) -> None:
        self._vehicle = vehicle
        self._settings = settings
        self._orders = order_runner
        self._links = services.links
        self._flown = services.flown
        self.ours_until = -math.inf
        """A PX4 may until then show the OFFBOARD in which it followed our own setpoints."""

    def check(self, now: float, *, active: bool) -> None:
        """Check all that is known without asking the vehicle. Raises RefusedError if it must not be flown now."""
        refusal = self._links.authority_refusal(self._vehicle.sysid)
        refusal = refusal or offboard_entry.entry_refusal(self._vehicle, now)
        if refusal is None and self._vehicle.origin is None:
            refusal = "the fleet has no origin yet, so there is no fence: set [origin], or `skygcs-cli origin from`"
        if refusal is None and not active and self._follows_setpoints() and now >= self.ours_until:
            refusal = f"it is in {self._vehicle.mode} already: another program sends it setpoints; end that first"
        if refusal is None:
            refusal = self._outside_now()
        if refusal is not None:
            raise RefusedError(refusal)

    def check_radio(self) -> None:
        """Raises RefusedError where its radio cannot carry a stream of setpoints."""
        if (refusal := self._links.stream_refusal(self._vehicle, self._flown)) is not None:
            raise RefusedError(refusal)

    async def check_parameters(self, control_mode: ControlMode, *, active: bool, force: bool) -> None:
        """Read the parameters that this control mode depends on. Raises RefusedError where the thrust scale is unknown,
        or where losing the setpoints would be dangerous."""
        if control_mode not in (ControlMode.ATTITUDE, ControlMode.RAW):
            if not active:
                await self._orders.attempt_in_control(
                    lambda now: offboard_entry.ask_loss_parameters(self._vehicle, now)
                )
            return
        await self._orders.attempt_in_control(lambda now: offboard_entry.ask_parameters(self._vehicle, now))
        refusal = offboard_entry.attitude_refusal(self._vehicle)
        if refusal is None and not force:
            refusal = offboard_entry.loss_refusal(self._vehicle)
        if refusal is not None:
            raise RefusedError(refusal)

    def shows_ours(self, now: float) -> bool:
        """True if the mode that it shows may yet be that of our own setpoints, which have ended."""
        return self._follows_setpoints() and now < self.ours_until

    def _follows_setpoints(self) -> bool:
        """PX4 is in OFFBOARD only while setpoints come, and obeys each of two streams in turn. GUIDED shows nothing."""
        return self._vehicle.family == "px4" and offboard_entry.is_following(self._vehicle)

    def _outside_now(self) -> str | None:
        """Why it is outside the control fence; None if it is inside, or where it is is not known."""
        origin, position = self._vehicle.origin, self._vehicle.telemetry("position")
        if origin is None or position is None or position["lat_deg"] is None:
            return None
        fence = self._settings.fence_at(origin)
        return fence.why_not(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])
