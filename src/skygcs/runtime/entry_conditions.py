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

The message rates that the flight needs are requested when it begins, and restored when it ends.

    message                  requested for                  rate
    ----------------------   ----------------------------   ---------------------------------
    GLOBAL_POSITION_INT      attitude, raw; velocity        POSITION_HZ
    ATTITUDE, VFR_HUD        attitude                       ATTITUDE_AIDS_HZ
    GPS_GLOBAL_ORIGIN        moving references              once

Where a radio's stream plan sets the rates, it is asked for the position's, and nothing is requested here.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from skygcs.config.control import ControlSettings
from skygcs.core.control.guard import ControlMode
from skygcs.core.protocols.command import Outcome
from skygcs.core.radio_link.stream_rates import POSITION, intended_rate
from skygcs.core.vehicle import offboard_entry, orders
from skygcs.core.vehicle.order_ledger import REFUSALS
from skygcs.core.vehicle.origin import ORIGIN_MESSAGE
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.runtime.order_runner import OrderRunner
from skygcs.runtime.stream_requester import StreamRequester
from skygcs.runtime.task_set import TaskSet
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


RATE_SETTLES_S = 20.0
"""After the position's rate was restored, its smoothed measure still includes the time before for so long."""

POSITION_HZ = {ControlMode.RAW: 50.0, ControlMode.ATTITUDE: 50.0, ControlMode.VELOCITY: 10.0}
"""GLOBAL_POSITION_INT asked for: the age of the state is half a period of it on average. Position setpoints need none:
the autopilot closes the loop, the nav profile's 2 Hz stay."""

ATTITUDE_AIDS_HZ = {"ATTITUDE": 10.0, "VFR_HUD": 5.0}
"""Requested while attitude is wanted: tilt and throttle, from which the law's integral begins (`SteadyThrust`)."""


class ControlStreams:
    """The rates of one vehicle while skygcs flies it. What is not awaited runs in ``tasks``."""

    def __init__(
        self,
        vehicle: Vehicle,
        configured_hz: Mapping[str, float],
        order_runner: OrderRunner,
        streams: StreamRequester,
        services: VehicleServices,
        tasks: TaskSet,
    ) -> None:
        self._vehicle = vehicle
        self._configured_hz = configured_hz
        self._orders = order_runner
        self._streams = streams
        self._loop = services.loop
        self._dialect = services.dialect
        self._tasks = tasks
        self._before_hz = configured_hz.get(POSITION, 0.0)
        """The position's rate before it was raised: an own 5 Hz of PX4, or what a program asked for."""
        self._raised = False
        self._owed_hz: dict[str, float] = {}
        """Rates to which messages are to go back, until the vehicle has answered."""
        self._restoring: asyncio.Task[None] | None = None
        self._restored_at = -math.inf
        self._aids_before_hz: dict[str, float] = {}
        """Rates of the messages that are requested for attitude, from before."""

    async def raise_position_rate(self, control_mode: ControlMode, *, new_link: bool = False) -> None:
        """Request the position as often as this control mode needs it, unless a radio's plan sees to it. ``new_link``:
        its rate on this link is not known."""
        rate_hz = POSITION_HZ.get(control_mode)
        if self._streams.want_position(rate_hz) or rate_hz is None:
            return
        now = self._loop.time()
        owed = self._owed_hz.pop(POSITION, None) is not None
        if not self._raised and not owed and now - self._restored_at > RATE_SETTLES_S:
            slot = self._vehicle.slot(POSITION)
            measured_hz = 0.0 if slot is None or new_link else slot.rate_hz
            self._before_hz = max(intended_rate(measured_hz), self._configured_hz.get(POSITION, 0.0))
        self._raised = True
        await self._request(POSITION, max(rate_hz, self._before_hz))

    def request_aids(self, control_mode: ControlMode) -> None:
        """Have tilt and throttle come faster for attitude, in the background, unless a radio's plan sets the rates."""
        if control_mode is not ControlMode.ATTITUDE or self._streams.planned:
            return
        wanted: dict[str, float] = {}
        for name, rate_hz in ATTITUDE_AIDS_HZ.items():
            slot, owed_hz = self._vehicle.slot(name), self._owed_hz.pop(name, None)
            measured_hz = 0.0 if slot is None else slot.rate_hz
            if name in self._aids_before_hz or name not in self._dialect.by_name:
                continue
            if owed_hz is not None or measured_hz < rate_hz:
                before_hz = max(intended_rate(measured_hz), self._configured_hz.get(name, 0.0))
                self._aids_before_hz[name] = before_hz if owed_hz is None else owed_hz
                wanted[name] = rate_hz
        if wanted:
            self._tasks.start(self._request_all(wanted), "attitude rate")

    def request_estimator_origin(self) -> None:
        """Ask where its estimator has its origin, in the background: moving references need it, and without it they go
        without their acceleration."""
        self._tasks.start(self._request_origin(), "estimator origin")

    def restore(self) -> None:
        """Control has ended, did not begin, or the vehicle is heard again: request the earlier rates again, in the
        background, until it answers. Idempotent."""
        if not self._streams.want_position(None) and self._raised:
            self._owed_hz[POSITION] = self._before_hz
            self._raised, self._restored_at = False, self._loop.time()
        self._owed_hz |= self._aids_before_hz
        self._aids_before_hz = {}
        if self._streams.planned:
            self._owed_hz.clear()
        if self._owed_hz and self._vehicle.connected and (self._restoring is None or self._restoring.done()):
            self._restoring = self._tasks.start(self._restore_owed(), "rates from before control")

    def settle(self, name: str) -> None:
        """Owe this message no rate any more."""
        self._owed_hz.pop(name, None)

    async def _restore_owed(self) -> None:
        asked: set[str] = set()
        while names := self._owed_hz.keys() - asked:
            name = min(names)
            asked.add(name)
            rate_hz = self._owed_hz[name]
            outcome = await self._request(name, rate_hz or None)
            if (outcome.ok or outcome.result in REFUSALS) and self._owed_hz.get(name) == rate_hz:
                del self._owed_hz[name]
                asked.discard(name)

    async def _request_all(self, rates_hz: Mapping[str, float]) -> None:
        for name, rate_hz in rates_hz.items():
            await self._request(name, rate_hz or None)

    async def _request(self, name: str, rate_hz: float | None) -> Outcome:
        return await self._orders.attempt_in_control(
            lambda now: orders.message_interval(self._vehicle, now, self._dialect, name, rate_hz)
        )

    async def _request_origin(self) -> None:
        await self._orders.attempt_in_control(
            lambda now: orders.request_message(self._vehicle, now, self._dialect, ORIGIN_MESSAGE)
        )
