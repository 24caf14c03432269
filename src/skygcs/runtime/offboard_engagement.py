"""Taking one vehicle over to be flown by setpoints, and giving it back; see `FlightControl`.

Both take seconds, and meanwhile a person, the guard or another order may end or begin control: every step asks whether
its *turn* is still the present one, and goes no further if it is not.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

from skygcs.config.control import ControlSettings
from skygcs.core.control.guard import CONTROL_MODES, ControlMode
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.protocols.command import Outcome
from skygcs.core.radio_link.stream_rates import intended_rate
from skygcs.core.vehicle import offboard_entry, orders
from skygcs.core.vehicle.offboard_controller import OffboardController, OffboardState
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.control_clock import ControlClock
from skygcs.runtime.plan_runner import Attempt, Execute
from skygcs.runtime.task_set import TaskSet

STREAM_BEFORE_S = 1.3
"""Setpoints flow this long before the mode is changed: PX4 wants more than 1 s of them (field-notes 10.5)."""

SETTLE_S = 5.0
"""As long at most for the round trip to be known and the position to come faster: the delay is judged over 3 s, and an
ArduCopter was seen to pause its position for 0.6 s when its rate was raised."""

PAUSE_S = 1.0
"""The pause begins some time after the acknowledgement; it is over, or seen, by then."""

MEASURED_PINGS = 4
"""So many pings went out, the burst of the first second, before the round trip is believed."""

RATE_SETTLES_S = 20.0
"""After the position's rate was put back, its smoothed measure tells of the time before for so long."""

POSITION_HZ = {ControlMode.ATTITUDE: 50.0, ControlMode.VELOCITY: 10.0}
"""GLOBAL_POSITION_INT asked for: the age of the state is half a period of it on average. Position setpoints need none:
the autopilot closes the loop, the nav profile's 2 Hz stay."""

LATE_ENTRY_S = 2.5
"""After a mode was commanded in vain, or given up while it was on its way, it may still be taken: an exchange's repeats
and a heartbeat, which tells, come within so long."""

FIRST_WORD_S = 1.0
"""Some periods of the slowest way."""


class OffboardEngagement:
    """Of one vehicle. ``execute`` carries out a plan, ``attempt`` plans and carries out; ``position_hz``: of its
    position while nobody flies it by setpoints, None: its own. ``plan_position(rate)`` is told how often it is wanted
    (None: not any more); if it is True, a radio's plan sees to it, as far as there is room.
    ``stream_refusal`` (whether it is a PX4): why its link bears no stream of setpoints.

    ``begin`` has the setpoints stream, and raises RefusedError if they cannot; ``release`` ends them, which begins a
    turn (`next_turn`) like everything that begins or ends control.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        settings: ControlSettings,
        commands: CommandClient,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        pilot: OffboardController,
        clock: ControlClock,
        tasks: TaskSet,
        *,
        execute: Execute,
        attempt: Attempt,
        begin: Callable[[ControlMode], None],
        release: Callable[[str], None],
        position_hz: float | None,
        plan_position: Callable[[float | None], bool] = lambda rate_hz: False,
        stream_refusal: Callable[[bool], str | None] = lambda px4: None,
        on_event: Callable[[Event], None],
    ) -> None:
        self.turn = 0
        """Who began under another number goes no further."""
        self._vehicle = vehicle
        self._settings = settings
        self._commands = commands
        self._dialect = dialect
        self._loop = loop
        self._offboard = pilot
        self._clock = clock
        self._tasks = tasks
        self._execute = execute
        self._attempt = attempt
        self._begin = begin
        self._release = release
        self._position_hz = position_hz
        self._before_hz = position_hz or 0.0
        """How often its position came before it was asked for more: an own 5 Hz of PX4, or what a program asked for."""
        self._raised = False
        self._restored_at = float("-inf")
        self._plan_position = plan_position
        self._stream_refusal = stream_refusal
        self._on_event = on_event

    def next_turn(self) -> int:
        """Control begins or ends now."""
        self.turn += 1
        return self.turn

    async def engage(self, control_mode: ControlMode, *, force: bool) -> Outcome:
        """See `FlightControl.engage`."""
        started, turn = self._loop.time(), self.turn
        try:
            self._check_entry(started)
            if not force and not self._offboard.active:
                self._check_stream()
            if control_mode is ControlMode.ATTITUDE:
                await self._check_attitude(force=force)
            if self.turn != turn:
                return _superseded(self._loop.time() - started)
            if self._offboard.state is OffboardState.ENGAGING:
                self._release("a newer order took its place")
            turn = self.next_turn()
            if self._offboard.state is OffboardState.FLYING:
                return await self._change(control_mode, turn)
            back_to = self._vehicle.custom_mode
            await self._ask_position(POSITION_HZ.get(control_mode))
            if self.turn != turn:
                return _superseded(self._loop.time() - started)
            self._check_entry(self._loop.time())  # what was true before all this waiting may not be any more
            self._begin(control_mode)
        except RefusedError as error:
            if not self._offboard.active:
                self._plan_position(None)
            return Outcome.refused(str(error))
        outcome: Outcome | None = None
        try:
            outcome = await self._enter(control_mode, turn, back_to)
        finally:
            if (outcome is None or not outcome.ok) and self.turn == turn:
                self._undo("it could not be begun" if outcome is None else outcome.message, back_to)
        return replace(outcome, elapsed_s=self._loop.time() - started)

    def restore_position(self) -> None:
        """Back to the rate of before; nobody waits for it."""
        if not self._plan_position(None) and self._vehicle.connected and self._raised:
            self._raised, self._restored_at = False, self._loop.time()
            self._tasks.start(self._ask_interval(self._before_hz or None), "position rate")

    # -- may it be taken over

    def _check_entry(self, now: float) -> None:
        refusal = offboard_entry.entry_refusal(self._vehicle, now)
        if refusal is None and self._vehicle.origin is None:
            refusal = "the fleet has no origin yet, so there is no fence: set [origin], or `skygcs-cli origin from`"
        if refusal is None and not self._offboard.active and self._led_by_another():
            refusal = f"it is in {self._vehicle.mode} already: another program sends it setpoints; end that first"
        if refusal is None:
            refusal = self._outside_now()
        if refusal is not None:
            raise RefusedError(refusal)

    def _check_stream(self) -> None:
        """Raises RefusedError where its radio cannot carry a stream of setpoints."""
        refusal = self._stream_refusal(self._vehicle.family == "px4")
        if refusal is not None:
            raise RefusedError(refusal)

    def _led_by_another(self) -> bool:
        """PX4 is in OFFBOARD only while setpoints come, and obeys each of two streams in turn. GUIDED tells nothing."""
        return self._vehicle.family == "px4" and offboard_entry.is_following(self._vehicle)

    def _outside_now(self) -> str | None:
        origin, position = self._vehicle.origin, self._vehicle.section("position")
        if origin is None or position is None or position["lat_deg"] is None:
            return None
        fence = self._settings.fence_at(origin)
        return fence.why_not(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])

    async def _check_attitude(self, *, force: bool) -> None:
        """Raises RefusedError where thrust would not mean thrust, or cannot be checked, or where losing the setpoints
        would be dangerous."""
        await self._attempt(lambda now: offboard_entry.ask_parameters(self._vehicle, now))
        refusal = offboard_entry.attitude_refusal(self._vehicle)
        if refusal is None and not force:
            refusal = offboard_entry.loss_refusal(self._vehicle)
        if refusal is not None:
            raise RefusedError(refusal)
        if (note := offboard_entry.loss_note(self._vehicle)) is not None:
            self._on_event(Event("warning", self._vehicle.name, self._vehicle.sysid, note, {}))

    # -- over, and to another way

    async def _enter(self, control_mode: ControlMode, turn: int, back_to: int) -> Outcome:
        """Stream, measure, switch the mode over and see that it has."""
        if (ended := await self._settle(control_mode, turn, STREAM_BEFORE_S)) is not None:
            return ended
        try:
            self._check_entry(self._loop.time())  # seconds have passed: it may have landed, or be in its failsafe
        except RefusedError as error:
            return Outcome.refused(str(error))
        if self._vehicle.custom_mode != back_to and not offboard_entry.is_following(self._vehicle):
            return Outcome.refused(f"somebody else switched it to {self._vehicle.mode} meanwhile")
        outcome = await self._execute(offboard_entry.enter(self._vehicle))
        if self.turn != turn:
            return _superseded(0.0)
        if not outcome.ok:
            return replace(outcome, message=f"it was not switched over: {outcome.message}")
        self._offboard.entered()
        return await self._flown(control_mode)

    async def _change(self, control_mode: ControlMode, turn: int) -> Outcome:
        """Another way while it flies. Its present one goes on until the state comes as fast as the new one needs it."""
        slower = CONTROL_MODES.index(control_mode) > CONTROL_MODES.index(self._offboard.wanted)
        if slower:
            self._offboard.want(control_mode)
        await self._ask_position(POSITION_HZ.get(control_mode))
        if not slower:
            if (ended := await self._settle(control_mode, turn, PAUSE_S)) is not None:
                return ended
            self._offboard.want(control_mode)
        return await self._flown(control_mode)

    async def _settle(self, control_mode: ControlMode, turn: int, least_s: float) -> Outcome | None:
        """Wait ``least_s``, and longer while something stands against the way that a few seconds may cure: a round trip
        not measured yet, a position stream that was slower until now. An Outcome if control ended meanwhile."""
        started = self._loop.time()
        while True:
            waited = self._loop.time() - started
            if self.turn != turn:
                return _superseded(waited)
            if not self._offboard.active:
                return Outcome.refused("; ".join(self._offboard.reasons) or "control ended")
            ready = self._measured() and not self._offboard.why_not(control_mode, self._loop.time())
            if waited >= SETTLE_S or (waited >= least_s and ready):
                return None
            await asyncio.sleep(0.1)

    async def _flown(self, control_mode: ControlMode) -> Outcome:
        """The guard's first word belongs to the answer."""
        pilot = self._offboard
        judged = self._clock.ticks + 1
        await self._commands.until(lambda: self._clock.ticks >= judged, FIRST_WORD_S)
        if pilot.state is not OffboardState.FLYING:
            return Outcome(False, "failed", f"control ended at once: {'; '.join(pilot.reasons)}")
        flown = pilot.control_mode or control_mode
        why = "" if flown is control_mode else f" and not by {control_mode.value}: {'; '.join(pilot.reasons)}"
        return Outcome(True, "accepted", f"flown by {flown.value} setpoints{why}")

    def _measured(self) -> bool:
        return self._offboard.delay.pings > MEASURED_PINGS and self._offboard.delay.rtt_p95_s is not None

    # -- and back

    def _undo(self, reason: str, back_to: int) -> None:
        """What the guard has ended after the entry, it has ended rightly: by a hold, or because somebody else flies."""
        if self._offboard.active or not self._offboard.was_entered:
            self._release(reason)
            self._tasks.start(self._give_back(back_to, self.turn), "control given back")

    async def _give_back(self, back_to: int, turn: int) -> None:
        """A vehicle that obeys setpoints, or is about to because its mode was commanded already, gets none any more: it
        is not left to its timeouts. An ArduCopter whose attitude ends would drift with the wind."""
        following = await self._commands.until(lambda: offboard_entry.is_following(self._vehicle), LATE_ENTRY_S)
        if following and self._vehicle.armed and self.turn == turn:
            await self._attempt(lambda now: offboard_entry.leave(self._vehicle, back_to))

    # -- how often it tells where it is

    async def _ask_position(self, rate_hz: float | None) -> None:
        if not self._plan_position(rate_hz) and rate_hz is not None:
            now = self._loop.time()
            if not self._raised and now - self._restored_at > RATE_SETTLES_S:
                slot = self._vehicle.slot("GLOBAL_POSITION_INT")
                measured_hz = 0.0 if slot is None else slot.rate_hz
                self._before_hz = max(intended_rate(measured_hz), self._position_hz or 0.0)
            self._raised = True
            await self._ask_interval(max(rate_hz, self._before_hz))

    async def _ask_interval(self, rate_hz: float | None) -> None:
        await self._attempt(
            lambda now: orders.message_interval(self._vehicle, now, self._dialect, "GLOBAL_POSITION_INT", rate_hz)
        )


def _superseded(elapsed_s: float) -> Outcome:
    return Outcome(False, "cancelled", "a newer order took its place", elapsed_s=elapsed_s)
