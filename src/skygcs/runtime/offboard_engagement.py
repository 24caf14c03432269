"""Flies one vehicle by setpoints: enters and leaves the mode, sends a setpoint each tick, measures the round trip.

What is sent and when it ends is decided in `core.vehicle.offboard_controller`; here it meets the clock and the link.
The trace is in `trace_file`.

Entering and leaving take seconds. Meanwhile a person, the guard or another order may begin or end control: each of
these begins a new *turn*, and every step of a sequence checks that its turn is still the present one before it goes
on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from skygcs.config.models import VehicleConfig
from skygcs.core.control.guard import BY_DELAY, ControlMode
from skygcs.core.geo import EnuFrame
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.trajectory import TrajectoryClock
from skygcs.core.vehicle import offboard_entry, orders
from skygcs.core.vehicle.flight_lock import FlightLock, Holder
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.gate import standing
from skygcs.core.vehicle.offboard_controller import OffboardController, OffboardState
from skygcs.core.vehicle.raw_setpoint import RawSetpoint
from skygcs.core.vehicle.setpoint_generator import Tick
from skygcs.core.vehicle.tracking_record import TrackingRecord
from skygcs.core.vehicle.trajectory_flight import (
    LoadedTrajectory,
    StartTube,
    TrajectoryFlight,
    distance_refusal,
)
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.command_client import SUPERSEDED, CommandClient
from skygcs.runtime.control_tuning import ControlTuning, first_equal, law_json, offboard_config
from skygcs.runtime.entry_conditions import ControlStreams, EntryConditions
from skygcs.runtime.loop_clock import ControlClock
from skygcs.runtime.order_runner import UNHEARD, OrderRunner
from skygcs.runtime.stream_requester import StreamRequester
from skygcs.runtime.task_set import OWN, TaskSet
from skygcs.runtime.trace_file import Recording
from skygcs.runtime.vehicle_services import VehicleServices

VALID_S = (0.1, 5.0)
"""Deadlines a setpoint may have."""

LEFT_S = 4.0
"""A vehicle that shows the mode of setpoints again within four heartbeats never left it: another program sent the other
mode with its ids."""

STREAM_BEFORE_S = 1.3
"""Setpoints flow this long before the mode is changed: PX4 requires more than 1 s of them (field-notes 10.5)."""

SETPOINTS = standing("setpoints")

SETTLE_S = 5.0
"""The longest wait for the round trip to be measured and the position to come faster: the delay is judged over 3 s, and
an ArduCopter was seen to pause its position for 0.6 s when its rate was raised."""

PAUSE_S = 1.0
"""The pause begins some time after the acknowledgement; it is over, or seen, by then."""

MEASURED_PINGS = 4
"""Pings of the burst in the first second, after which the measured round trip is used."""

HAND_OVER_S = 15.0
"""The longest wait of an engagement for an order in progress, which is repeated for 7 s at most and then proved."""

LOOK_S = 0.5
"""Between two looks whether an order in progress has ended, if nothing is heard of the vehicle meanwhile."""

LATE_ENTRY_S = 2.5
"""After a mode was commanded in vain, or given up while the command was on its way, the vehicle may still take it: the
repeats of the command and a heartbeat, which shows the mode, come within so long."""

OURS_S = 3.0
"""A PX4 that we led shows OFFBOARD for so long after control ended at most: the order to hold takes up to a second over
a radio, and its mode comes with its heartbeat, once a second, of which one may be lost."""

FIRST_VERDICT_S = 1.0
"""Some periods of the slowest control mode."""

TIMESYNC = "TIMESYNC"

GOLDEN_RATIO = 0.6180339887498949
"""Its multiples, without the whole turns, lie as far from each other as any number of them can: the ticks of a fleet
that one order engages do not wait for each other."""


class OffboardEngagement:
    """Flight by setpoints of one vehicle. Every order that moves the vehicle takes over from it (`hand_over`)."""

    def __init__(
        self,
        vehicle: Vehicle,
        config: VehicleConfig,
        commands: CommandClient,
        order_runner: OrderRunner,
        streams: StreamRequester,
        services: VehicleServices,
    ) -> None:
        """``streams``: sets the position's rate itself where a radio's plan is in force."""
        settings = config.control
        # the controller and the clock that ticks it
        self.controller = OffboardController(vehicle, offboard_config(settings, None))
        phase = vehicle.sysid * GOLDEN_RATIO % 1.0
        self.clock = ControlClock(
            services.loop,
            self._tick,
            lambda: self.controller.period_s,
            phase=phase,
            running_clocks=services.running_clocks,
        )
        self.tracking = TrackingRecord()
        self._tuning = ControlTuning(self.controller, vehicle, settings)
        # collaborators
        self._vehicle = vehicle
        self._settings = settings
        self._commands = commands
        self._orders = order_runner
        order_runner.flown_by = self
        self._services = services
        self._loop = services.loop
        self._on_event = services.on_event
        self.lock: FlightLock | None = None
        """Flight lock of the present control, or of the last one; None before the first."""
        self._queue_key = ("setpoint", vehicle.sysid, vehicle.compid)
        """Key in the link's queue: a newer setpoint replaces one that still waits."""
        # recording, tasks and streams of the engagement
        self._conditions = EntryConditions(vehicle, settings, order_runner, services)
        self._trace = Recording(self.controller, services.log_dir, services.disk, services.on_event)
        self._tasks = TaskSet(services.loop, services.on_event, vehicle.name, vehicle.sysid)
        self._streams = ControlStreams(vehicle, config.streams, order_runner, streams, services, self._tasks)
        # callbacks of begin and end
        self.on_hold: Callable[[Outcome], None] = lambda outcome: None
        """Called with the outcome of the order to hold at the end of control."""
        self.on_begin: Callable[[], None] = lambda: None
        """Called when the stream of setpoints begins, however short it will be."""
        # state of the present control
        self.successor: str | None = None
        """Why control ends as soon as the order that takes over has taken effect; None: no order takes over."""
        self._turn = 0
        """Counts beginnings and ends of control: a sequence that began under another number goes no further."""
        self._releases = 0
        """Calls of `release`."""
        self._entering = 0
        """Calls of `engage` in progress."""

    @property
    def flying(self) -> bool:
        """True while it flies by our setpoints, and no order takes over from them."""
        return self.controller.state is OffboardState.FLYING and self.successor is None

    @property
    def sends_setpoints(self) -> bool:
        """True if setpoints to it take a share of the daemon's links."""
        return self.controller.active

    @property
    def may_send(self) -> bool:
        """No other program sends; see `FlightElsewhere.may_send`."""
        return False

    @property
    def recording(self) -> Path | None:
        """The file its trace goes to now; None: it is not traced."""
        return self._trace.path

    # -- orders

    async def engage(self, control_mode: ControlMode, *, force: bool = False) -> Outcome:
        """The whole sequence: checks, faster position, a stream of setpoints, the mode, its verification; undone on
        failure. While it flies already, only the control mode changes. ``force``: even if the vehicle would do
        something dangerous when the setpoints stop."""
        self._entering += 1
        try:
            return await self._engage(control_mode, force=force)
        finally:
            self._entering -= 1
            if not self._entering and not self.controller.active:
                self._streams.restore()  # however it ended

    async def _engage(self, control_mode: ControlMode, *, force: bool) -> Outcome:
        started = self._loop.time()
        try:
            # an order that takes over has an end before; what came since, from whomever, is not overtaken
            releases, before = self._releases, self._orders.precedence.hands()
            await self._mode_of_its_own()
            await self._handed_over()
            if await self._orders.precedence.late("control") is not None or self._releases != releases:
                return _superseded(self._loop.time() - started)
            if (why := self._orders.precedence.pilot_since("control", before)) is not None:
                raise RefusedError(why)
            # checks
            turn = self._turn
            back_to = offboard_entry.settled_mode(self._vehicle)  # what is switched from here on is switched by others
            active = self.controller.active
            self._conditions.check(self._loop.time(), active=active)
            if not force and not active:
                self._conditions.check_radio()
            await self._conditions.check_parameters(control_mode, active=active, force=force)
            self._warn_of_loss()
            if self._turn != turn:
                return _superseded(self._loop.time() - started)
            self._require_mode(back_to)
            # this order is the newest from here on
            if self.controller.state is OffboardState.ENGAGING:
                self.release(SUPERSEDED)
            turn = self._next_turn()
            if self.controller.state is OffboardState.FLYING:
                self._tuning.renew_hover_thrust()
                self._check_gains(control_mode, force=force)
                return await self._change(control_mode, turn)
            # faster position, then the stream
            await self._streams.raise_position_rate(control_mode)
            if self._turn != turn:
                return _superseded(self._loop.time() - started)
            self._conditions.check(self._loop.time(), active=self.controller.active)
            self._begin(control_mode, force=force)
            self._streams.request_aids(control_mode)
        except RefusedError as error:
            return Outcome.refused(str(error))
        # the mode and its verification
        outcome: Outcome | None = None
        try:
            outcome = await self._enter(control_mode, turn, back_to)
        finally:
            if (outcome is None or not outcome.ok) and self._turn == turn:
                self._undo("it could not be begun" if outcome is None else outcome.message, back_to)
        return replace(outcome, elapsed_s=self._loop.time() - started)

    def release(self, reason: str) -> None:
        """Send nothing from now on, and begin nothing that was asked for before. Idempotent."""
        self._releases += 1
        self._end(reason)

    def _end(self, reason: str) -> None:
        self._next_turn()
        self.successor = None
        self._apply(self.controller.release(reason))

    def hand_over(self, reason: str) -> None:
        """A newer order takes over: hold by setpoints until the vehicle shows another mode, `taken_over` or `keep` is
        called. A setpoint that arrives after the order is ignored in its mode, or is the place where it stands. An
        ArduCopter in GUIDED follows already while it is being engaged."""
        if not self.controller.active or not self._follows_ours():
            self.release(reason)
            return
        self._next_turn()
        self.successor = reason
        self.controller.stay()

    def taken_over(self) -> None:
        """The order has taken effect: control ends. Idempotent."""
        if self.successor is not None:
            self._end(self.successor)

    def keep(self, why: str) -> None:
        """The order has not taken effect: go on holding. Idempotent."""
        if self.successor is None:
            return
        if self.controller.state is OffboardState.ENGAGING:
            self._end(self.successor)  # who engaged it was told that it ended: the unattended vehicle is held
            return
        text = f"control goes on, it holds its position: {self.successor}, but {why}"
        self.successor = None
        self._publish("control", text, {"state": "flying"})

    def _follows_ours(self) -> bool:
        """True if it flies by our setpoints now, if they come: under control, or engaged in the mode it was in."""
        return self.controller.state is OffboardState.FLYING or offboard_entry.is_following(self._vehicle)

    async def fly_to(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> Outcome:
        """Move the reference. Refused outside the fence, and unless it flies by setpoints."""
        if not self.flying:
            return self._not_flying()
        if (why := self.why_not_to(place)) is not None:
            return Outcome.refused(why)
        self.controller.fly_to(place, yaw_enu_rad)
        control_mode = self.controller.control_mode or self.controller.wanted
        return Outcome(True, "accepted", f"flying there by {control_mode.value} setpoints")

    def why_not_to(self, place: GeodeticPosition) -> str | None:
        """Why the reference may not be moved there; None: it may."""
        return self._own_controller() or self._outside(place)

    def follow(self, setpoint: Setpoint, valid_s: float, *, given_at: float | None = None) -> Outcome:
        """One setpoint of a client's stream. ``given_at``: the time it is for, if it was under way since; it is moved
        on by its velocity and acceleration from then, and its deadline counts from now."""
        if not self.flying:
            return self._not_flying()
        if self.controller.flight is not None:
            return Outcome.refused("it follows a trajectory: `skygcs-cli trajectory abort` first")
        why = self._own_controller() or self._outside(setpoint.place, setpoint.free_xy, setpoint.free_z)
        if (refusal := why or self._stream_refusal(valid_s)) is not None:
            return Outcome.refused(refusal)
        now = self._loop.time()
        if (why := self.controller.follow(setpoint, now if given_at is None else given_at, now + valid_s)) is not None:
            return Outcome.refused(why)
        return Outcome(True, "accepted", "followed")

    def follow_raw(self, setpoint: RawSetpoint, valid_s: float) -> Outcome:
        """One setpoint of the user's own controller. Refused beyond a limit: it is never clipped."""
        controller = self.controller
        if not self.flying:
            return self._not_flying()
        if controller.wanted is not ControlMode.RAW:
            name = self._vehicle.name
            return Outcome.refused(
                f"it is flown in {controller.wanted.value}: `skygcs-cli control set {name} raw` first"
            )
        if not controller.raw_allowed:
            return Outcome.refused(f"raw setpoints are not flown: {'; '.join(controller.reasons)}")
        if (refusal := setpoint.refusal(controller.config.raw) or self._stream_refusal(valid_s)) is not None:
            return Outcome.refused(refusal)
        if controller.follow_raw(setpoint, self._loop.time() + valid_s) and self.clock.running:
            self.clock.stop()  # the next tick of a position hold would come too late for the first one
            self.clock.start()
        return Outcome(True, "accepted", "followed")

    def insist(self) -> None:
        """Do nothing: the setpoints of other clients come through the same gate; see `FlightElsewhere.insist`."""

    async def prepare(self, loaded: LoadedTrajectory) -> str | None:
        """Do nothing: only a flight elsewhere has to be prepared; see `FlightElsewhere.prepare`."""
        return None

    @property
    def lead_s(self) -> float:
        """An order to a clock takes effect at once; see `FlightElsewhere.lead_s`."""
        return 0.0

    def trajectory_refusal(
        self, loaded: LoadedTrajectory, speed_factor: float, lock: FlightLock, tube: StartTube | None = None
    ) -> str | None:
        """Why it cannot begin this trajectory now; None if it can. ``lock``: of the flight that it is a part of;
        ``tube``: how far from its begin it may be."""
        controller, now = self.controller, self._loop.time()
        if not self.flying or controller.frame is None:
            return self._not_flying().message.removeprefix("refused: ")
        if (why := self._own_controller()) is not None:
            return why
        if controller.flight is not None:
            return f"it follows {controller.flight.loaded.name} already: abort that first"
        first = controller.frame.from_geodetic(*EnuFrame(lock.origin).to_geodetic(*loaded.trajectory.start_enu_m))
        limits = lock.member(self._vehicle.name).limits
        away = distance_refusal(controller.here(now), first, limits, tube)
        return away or lock.path_refusal(self._vehicle.name, loaded, speed_factor)

    def follow_trajectory(self, loaded: LoadedTrajectory, clock: TrajectoryClock, lock: FlightLock) -> TrajectoryFlight:
        """Follow a trajectory that `trajectory_refusal` accepted, along the axes of the lock's origin."""
        frame = self.controller.frame
        assert frame is not None
        flight = TrajectoryFlight(loaded, clock, lock.origin, frame)
        self.controller.follow_trajectory(flight, self._loop.time())
        return flight

    def _stream_refusal(self, valid_s: float) -> str | None:
        """Why a setpoint of a stream is not taken now; None if it is."""
        if not VALID_S[0] <= valid_s <= VALID_S[1]:
            return f"valid_s {valid_s:g} is not between {VALID_S[0]} and {VALID_S[1]}"
        return None

    def _own_controller(self) -> str | None:
        """Why a place or a velocity is not taken: the user's own controller flies it; None if it does not."""
        if self.controller.wanted is not ControlMode.RAW:
            return None
        name = self._vehicle.name
        how = "by attitude, body rates or acceleration"
        return f"it is flown in raw, {how}; `skygcs-cli control set {name} position` first"

    async def change_gains(self, changes: Mapping[str, Any], *, force: bool = False) -> Outcome:
        """Part of xy, z and hover_thrust; see `ControlTuning.change`."""
        refusal = self._tuning.change(changes, force=force)
        return Outcome(True, "accepted", "gains changed") if refusal is None else Outcome.refused(refusal)

    def gains(self) -> dict[str, Any]:
        """The law's gains and limits, as control.gains shows them."""
        return law_json(self.controller.config.law)

    async def record(self, on: bool) -> str | None:
        """Trace every tick while it flies. The path of the file that is being written, or was until now; None before
        the first."""
        path = self._trace.record(on)
        return None if path is None else str(path)

    # -- as frames and time come

    def on_timesync(self, frame: Frame, now: float) -> None:
        """An answer to one of our pings; other TIMESYNC messages are ignored."""
        fields = frame.fields()
        if fields["tc1"] != 0:
            trip_s = self.controller.delay.on_pong(fields["ts1"], now)
            if trip_s is not None:
                self.tracking.on_round_trip(trip_s)

    def on_text(self, text: str) -> None:
        """A status text: setpoints that the vehicle rejects are not sent again and again."""
        if self.controller.active and offboard_entry.refuses_setpoint(text):
            self.controller.refusing = text

    def origin_changed(self) -> None:
        """Do nothing: nothing flies by the old origin, as the lock of an engagement keeps the origin while it flies."""

    def link_changed(self) -> None:
        """Setpoints go over another link from now on: its delay and its rate are other ones, and the position is
        requested there. Attitude is flown again once its round trip is measured."""
        controller = self.controller
        if not controller.active:
            self._streams.restore()  # what was raised on the one that is used again
            return
        controller.delay.restart()
        self.refresh_budget()
        raised = self._streams.raise_position_rate(controller.wanted, new_link=True)
        self._tasks.start(raised, "position rate on another link")

    def heard_again(self) -> None:
        """It was lost: what it did not get then of the rates that it is to go back to is requested again."""
        if not self.controller.active:
            self._streams.restore()

    def rate_set(self, name: str) -> None:
        """A person has set the rate of this message: it stays."""
        self._streams.settle(name)

    def watch(self, now: float) -> None:
        """Called a few times a second."""
        if self.controller.active:
            self.refresh_budget()

    def refresh_budget(self) -> None:
        """Fly as many attitude setpoints a second as the link can carry now; see `ControlTuning.share_link`."""
        self._tuning.share_link(self._services.links.setpoint_bytes_per_s(self._vehicle, self._services.flown))

    def status(self, now: float) -> dict[str, Any]:
        """The ``control`` part of the vehicle's state, still in the controller's local frame."""
        path = self.recording
        return {
            **self.controller.status(now),
            **self.clock.as_dict(),
            "recording": None if path is None else str(path),
        }

    async def settled(self) -> None:
        """Wait until a vehicle that is being given back, held or asked for its own rates has been."""
        await self._tasks.settled()

    def close(self, reason: str) -> None:
        """End control and all that belongs to it."""
        self.release(reason)
        self._tasks.close()

    # -- checks before entry

    def _require_mode(self, back_to: int) -> None:
        """Raises RefusedError if its pilot, or another program, has switched it from this mode."""
        if offboard_entry.settled_mode(self._vehicle) != back_to and not offboard_entry.is_following(self._vehicle):
            raise RefusedError(f"another program switched it to {self._vehicle.mode} meanwhile")

    async def _mode_of_its_own(self) -> None:
        """Wait while a PX4 may still show the OFFBOARD in which it followed our own setpoints."""
        if not self.controller.active:
            await self._commands.until(lambda: not self._conditions.shows_ours(self._loop.time()), OURS_S)

    async def _handed_over(self) -> None:
        """Wait until the order that takes over has an outcome: it took effect, or it did not. Raises RefusedError if it
        has none."""
        ends_at = self._loop.time() + HAND_OVER_S
        while self.successor is not None:
            if self._loop.time() >= ends_at:
                raise RefusedError(f"another order takes over: {self.successor}; it has had no outcome yet")
            await self._commands.until(lambda: self.successor is None, LOOK_S)

    def _warn_of_loss(self) -> None:
        """Say what the vehicle does if this computer dies, where that is dangerous."""
        if (note := offboard_entry.loss_note(self._vehicle, self._loop.time())) is not None:
            self._publish("warning", note, {})

    def _check_gains(self, control_mode: ControlMode, *, force: bool) -> None:
        """Raises RefusedError if the gains bear too little delay; see `ControlTuning.check`."""
        if (warning := self._tuning.check(control_mode, force=force)) is not None:
            self._publish("warning", warning, {})

    # -- entry, and change of the control mode

    def _next_turn(self) -> int:
        self._turn += 1
        return self._turn

    def _begin(self, control_mode: ControlMode, *, force: bool) -> None:
        """Start the stream of setpoints. Raises RefusedError if the vehicle's own hover thrust cannot be right, or the
        gains do not bear the delay with it."""
        self._tuning.begin()
        self.refresh_budget()
        self._check_gains(control_mode, force=force)
        # what it is entered with, the controller, its clock and its trace
        origin = self._vehicle.origin
        assert origin is not None
        locks, flown = self._services.locks, (self._vehicle, self._settings)
        self.lock = lock = locks.make(Holder.ENGAGEMENT, "", origin, [flown])
        self.controller.engage(control_mode, first_equal(lock.members[0].fence))
        locks.take(lock, lambda: self.controller.active and self.lock is lock)
        self._tuning.limit_delay()
        if self._vehicle.family == "ardupilot" and self._vehicle.telemetry("ekf_origin") is None:
            self._streams.request_estimator_origin()
        self.clock.start()
        self._trace.begin()
        self.on_begin()

    async def _enter(self, control_mode: ControlMode, turn: int, back_to: int) -> Outcome:
        """Stream, measure, change the vehicle's mode and verify it."""
        if (ended := await self._settle(control_mode, turn, STREAM_BEFORE_S)) is not None:
            return ended
        try:
            # seconds have passed: it may have landed, or be in its failsafe
            self._conditions.check(self._loop.time(), active=self.controller.active)
            self._require_mode(back_to)
        except RefusedError as error:
            return Outcome.refused(str(error))
        outcome = await self._orders.attempt_in_control(lambda now: offboard_entry.enter(self._vehicle))
        if self._turn != turn:
            return _superseded(0.0)
        if not outcome.ok:
            return replace(outcome, message=f"it was not switched over: {outcome.message}")
        self.controller.entered()
        return await self._first_verdict(control_mode)

    async def _change(self, control_mode: ControlMode, turn: int) -> Outcome:
        """Another control mode while it flies. The present one goes on until the state comes as fast as the new one
        needs it."""
        slower = BY_DELAY.index(control_mode) > BY_DELAY.index(self.controller.wanted)
        if slower:
            self.controller.want(control_mode)
        await self._streams.raise_position_rate(control_mode)
        self._streams.request_aids(control_mode)
        if not slower:
            if (ended := await self._settle(control_mode, turn, PAUSE_S)) is not None:
                return ended
            self.controller.want(control_mode)
        self._tuning.limit_delay()
        return await self._first_verdict(control_mode)

    async def _settle(self, control_mode: ControlMode, turn: int, least_s: float) -> Outcome | None:
        """Wait ``least_s``, and longer while the guard rejects the mode for a reason that a few seconds may cure: a
        round trip not measured yet, a position stream that was slower until now. An Outcome if control ended meanwhile.
        """
        started = self._loop.time()
        while True:
            waited = self._loop.time() - started
            if self._turn != turn:
                return _superseded(waited)
            if not self.controller.active:
                return Outcome.refused("; ".join(self.controller.reasons) or "control ended")
            ready = self._measured() and not self.controller.why_not(control_mode, self._loop.time())
            if waited >= SETTLE_S or (waited >= least_s and ready):
                return None
            await asyncio.sleep(0.1)

    async def _first_verdict(self, control_mode: ControlMode) -> Outcome:
        """The outcome includes what the guard decides at the first tick."""
        controller = self.controller
        judged = self.clock.ticks + 1
        await self._commands.until(lambda: self.clock.ticks >= judged, FIRST_VERDICT_S)
        if controller.state is not OffboardState.FLYING:
            return Outcome(False, "failed", f"control ended at once: {'; '.join(controller.reasons)}")
        if controller.raw_allowed:
            return Outcome(True, "accepted", "flown by raw setpoints; it holds its position while none is in force")
        flown = controller.control_mode or control_mode
        why = "" if flown is control_mode else f" and not by {control_mode.value}: {'; '.join(controller.reasons)}"
        return Outcome(True, "accepted", f"flown by {flown.value} setpoints{why}")

    def _measured(self) -> bool:
        return self.controller.delay.pings > MEASURED_PINGS and self.controller.delay.rtt_p95_s is not None

    # -- undo of an entry that failed

    def _undo(self, reason: str, back_to: int) -> None:
        """End control after a failed entry. What the guard has ended after the entry stays as it is: it holds, or
        another program flies it."""
        if self.controller.active or not self.controller.was_entered:
            self.release(reason)
            self._tasks.start(self._give_back(back_to, self._turn), "control given back", OWN)

    async def _give_back(self, back_to: int, turn: int) -> None:
        """Switch back a vehicle that follows setpoints, or is about to because its mode was commanded already: it gets
        no more of them and must not wait for its timeouts. An ArduCopter whose attitude setpoints end would drift with
        the wind."""
        following = await self._commands.until(lambda: offboard_entry.is_following(self._vehicle), LATE_ENTRY_S)
        if following and self._vehicle.armed and self._turn == turn:
            await self._orders.attempt_in_control(lambda now: offboard_entry.leave(self._vehicle, back_to, now))

    # -- ticks

    def _tick(self, now: float) -> None:
        """One tick of the clock. Hot; never raises."""
        if self._services.asleep():
            return  # and what was known before is gone, with this engagement
        controller = self.controller
        if (why := self._services.links.authority_refusal(self._vehicle.sysid)) is not None:
            self.release(why)  # its own failsafe, or the site that commands it, acts
            return
        if self.successor is not None and not offboard_entry.is_following(self._vehicle):
            self.taken_over()  # its heartbeat came before the order's own outcome
            return
        try:
            tick = controller.tick(now)
            if tick.message is not None:
                self._commands.transmit(*tick.message, Priority.SETPOINT, key=self._queue_key, clearance=SETPOINTS)
        except Exception as error:  # a fault of ours must not leave a vehicle under setpoints without checks
            fault = f"flight control failed inside skygcs and ends: {error!r}"
            self._publish("fault", fault, {})
            tick = Tick(events=controller.release(fault).events, hold=True)
        if tick.events or tick.row is not None or not controller.active or tick.hold:
            self._apply(tick)
        if controller.active:
            self.tracking.observe(controller, now)
            if controller.delay.due_ping(now):
                self._ping(now)

    def _apply(self, tick: Tick) -> None:
        """Trace a tick, publish its events, and end what control needs if control has ended."""
        self._trace.write(tick)
        taken_over = self.successor is not None
        if not self.controller.active and self.clock.running:
            self.clock.stop()
            self.successor = None
            self._orders.sent_before_at = self._loop.time()
            self._conditions.ours_until = self._orders.sent_before_at + OURS_S
            self._displace()
            self._trace.end()
            self._streams.restore()
        for event in tick.events:
            self._on_event(event)
        if tick.hold and not taken_over:  # a hold would be the newer order, and end a return or a landing
            self._tasks.start(self._hold(self._turn), "hold", OWN)
        elif tick.left:
            self._tasks.start(self._hold_if_it_follows(self._turn), "hold if it follows", OWN)

    async def _hold_if_it_follows(self, turn: int) -> None:
        """It showed another mode, and control ended. If it is in the mode of setpoints after all, it flies by the last
        ones it got and drifts when they expire: it is ordered to hold."""
        follows = await self._commands.until(lambda: offboard_entry.is_following(self._vehicle), LEFT_S)
        if follows and self._vehicle.armed and not self.controller.active:
            await self._hold(turn)

    async def _hold(self, turn: int) -> None:
        if self._turn != turn:
            return  # an order came before this task began: hold must not take its place
        outcome = await self._orders.attempt_in_control(lambda now: orders.hold(self._vehicle, now))
        self.on_hold(outcome)
        if not outcome.ok:
            then = (
                "whether it does is not known"
                if outcome.result in UNHEARD
                else "its own failsafe or its pilot has to act"
            )
            text = f"it was ordered to hold, but: {outcome.message}; {then}"
            self._publish("control", text, {"state": "held"})

    def _ping(self, now: float, priority: Priority = Priority.PROTOCOL, key: Hashable | None = None) -> None:
        if TIMESYNC in self._services.dialect.by_name:
            token = self.controller.delay.ping(now)
            self._commands.transmit(TIMESYNC, {"tc1": 0, "ts1": token}, priority, key=key)

    def _displace(self) -> None:
        """A setpoint may still wait for a busy link, and would leave after control has ended. It cannot be taken back;
        a ping takes its place in the queue (latest wins)."""
        self._ping(self._loop.time(), Priority.SETPOINT, self._queue_key)

    def _outside(self, place: GeodeticPosition | None, free_xy: bool = False, free_z: bool = False) -> str | None:
        if self.lock is None or place is None:
            return None
        here = (place.lat_deg, place.lon_deg, place.alt_amsl_m)
        return self.lock.members[0].fence.why_not(*here, reference=True, free_xy=free_xy, free_z=free_z)

    def _not_flying(self) -> Outcome:
        if self.successor is not None:
            return Outcome.refused(f"another order takes over: {self.successor}")
        held = self.controller.state is OffboardState.HELD
        why = f"it is held: {'; '.join(self.controller.reasons)}" if held else "control is off"
        return Outcome.refused(f"{why}; `skygcs-cli control set {self._vehicle.name} position` first")

    def _publish(self, kind: str, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event(kind, self._vehicle.name, self._vehicle.sysid, text, data))


def _superseded(elapsed_s: float) -> Outcome:
    return Outcome(False, "cancelled", SUPERSEDED, elapsed_s=elapsed_s)
