"""Flying one vehicle by setpoints in real time: entry and exit, the ticks, the round-trip pings, the trace.

What is sent and when it ends is decided in `core.vehicle.pilot`; here it meets the clock, the link and the disk.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from skygcs.config.control import ControlSettings
from skygcs.core.airtime import Priority
from skygcs.core.control.analysis import why_not_delay
from skygcs.core.control.fence import Fence
from skygcs.core.control.guard import WAYS, Way
from skygcs.core.control.trace import TraceHead
from skygcs.core.exchange.command import Outcome
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.vehicle import offboard, orders
from skygcs.core.vehicle.events import Event
from skygcs.core.vehicle.goals import Place, Setpoint
from skygcs.core.vehicle.pilot import Pilot, PilotConfig, PilotState, Tick
from skygcs.core.vehicle.plan import Plan
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import ConfigError, RefusedError
from skygcs.runtime.commander import Commander
from skygcs.runtime.control_clock import ControlClock
from skygcs.runtime.trace_file import TraceFile

STREAM_BEFORE_S = 1.3
"""Setpoints flow this long before the mode is changed: PX4 wants more than 1 s of them (field-notes 10.5)."""

SETTLE_S = 5.0
"""As long at most for the round trip to be known and the position to come faster: the delay is judged over 3 s, and an
ArduCopter was seen to pause its position for 0.6 s when its rate was raised."""

PAUSE_S = 1.0
"""The pause begins some time after the acknowledgement; it is over, or seen, by then."""

MEASURED_PINGS = 4
"""So many pings went out, the burst of the first second, before the round trip is believed."""

POSITION_HZ = {Way.ATTITUDE: 50.0, Way.VELOCITY: 10.0}
"""GLOBAL_POSITION_INT asked for: the age of the state is half a period of it on average. Position setpoints need none:
the autopilot closes the loop, the nav profile's 2 Hz stay."""

ATTITUDE_FRAME_BYTES = 51
"""SET_ATTITUDE_TARGET on the wire (field-notes 10.1)."""

VALID_S = (0.1, 5.0)
"""Deadlines a setpoint may have."""

NEW_STREAM_S = 1.0
"""A client that has sent nothing for so long has noticed that something changed."""

LATE_ENTRY_S = 2.5
"""After a mode was commanded in vain, or given up while it was on its way, it may still be taken: an exchange's repeats
and a heartbeat, which tells, come within so long."""

FIRST_WORD_S = 1.0
"""Some periods of the slowest way."""

TIMESYNC = "TIMESYNC"

GOLDEN_RATIO = 0.6180339887498949
"""Its multiples, without the whole turns, lie as far from each other as any number of them can: the ticks of a fleet
that one order engages do not wait for each other."""

Attempt = Callable[[Callable[[float], Plan]], Awaitable[Outcome]]
Execute = Callable[[Plan], Awaitable[Outcome]]


class FlightControl:
    """One vehicle's. ``execute`` carries out a plan, ``attempt`` plans and carries out.

    Every order that moves the vehicle calls `release` before it is carried out. Taking control up takes seconds, and
    each of its steps asks whether such an order, or a newer one of its own kind, has come meanwhile (``_turn``).
    """

    def __init__(
        self,
        vehicle: Vehicle,
        settings: ControlSettings,
        commander: Commander,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        *,
        execute: Execute,
        attempt: Attempt,
        position_hz: float | None,
        on_event: Callable[[Event], None],
        log_dir: Path,
        uplink_bytes_per_s: Callable[[], float],
    ) -> None:
        self._vehicle = vehicle
        self._settings = settings
        self._commander = commander
        self._dialect = dialect
        self._loop = loop
        self._execute = execute
        self._attempt = attempt
        self._position_hz = position_hz
        self._on_event = on_event
        self._log_dir = log_dir
        self._uplink_bytes_per_s = uplink_bytes_per_s
        self.pilot = Pilot(vehicle, _pilot_config(settings, None))
        phase = vehicle.sysid * GOLDEN_RATIO % 1.0
        self.clock = ControlClock(loop, self._tick, lambda: self.pilot.period_s, phase=phase)
        self._fence: Fence | None = None
        self._queue_key = ("setpoint", vehicle.sysid, vehicle.compid)
        """Of the link's queue: a newer setpoint replaces one that still waits."""
        self._trace: TraceFile | None = None
        self._recording = False
        self._tasks: set[asyncio.Task[Any]] = set()
        self._turn = 0
        """Increases with everything that ends or begins control: who began under another number goes no further."""
        self._law_changed = False
        self._hover_thrust_set = False
        self._followed_at = -math.inf
        self._frozen = False

    @property
    def flying(self) -> bool:
        """Whether it is led by our setpoints now."""
        return self.pilot.state is PilotState.FLYING

    @property
    def recording(self) -> Path | None:
        return None if self._trace is None else self._trace.path

    # -- orders

    async def engage(self, way: Way, *, force: bool = False) -> Outcome:
        """The whole sequence: checks, faster position, a stream of setpoints, the mode, its verification; undone on
        failure. While it flies already, only the way changes. ``force``: in spite of what it would do on its own if the
        setpoints ceased."""
        started, turn = self._loop.time(), self._turn
        try:
            self._check_entry(started)
            if way is Way.ATTITUDE:
                await self._check_attitude(force=force)
            if self._turn != turn:
                return _superseded(self._loop.time() - started)
            if self.pilot.state is PilotState.ENGAGING:
                self.release("a newer order took its place")
            turn = self._next_turn()
            if self.flying:
                return await self._change(way, turn)
            back_to = self._vehicle.custom_mode
            await self._ask_position(POSITION_HZ.get(way))
            if self._turn != turn:
                return _superseded(self._loop.time() - started)
            self._check_entry(self._loop.time())  # what was true before all this waiting may not be any more
            self._begin(way)
        except RefusedError as error:
            return _refused(str(error))
        outcome: Outcome | None = None
        try:
            outcome = await self._enter(way, turn, back_to)
        finally:
            if (outcome is None or not outcome.ok) and self._turn == turn:
                self._undo("it could not be begun" if outcome is None else outcome.message, back_to)
        return replace(outcome, elapsed_s=self._loop.time() - started)

    def disengage(self) -> Outcome:
        """Stop sending; have the vehicle hold (see VehicleActor.control)."""
        self.release("switched off")
        return Outcome(True, "accepted", "control is off")

    def release(self, reason: str) -> None:
        """Send nothing from now on. Idempotent."""
        self._next_turn()
        self._apply(self.pilot.release(reason))

    def fly_to(self, place: Place, yaw_enu_rad: float | None) -> Outcome:
        """Move the reference. Refused outside the fence, and unless it flies."""
        if not self.flying:
            return self._not_flying()
        if (why := self._outside(place)) is not None:
            return _refused(why)
        self.pilot.fly_to(place, yaw_enu_rad)
        way = self.pilot.way or self.pilot.wanted
        return Outcome(True, "accepted", f"flying there by {way.value} setpoints")

    def follow(self, setpoint: Setpoint, valid_s: float) -> Outcome:
        """One setpoint of a client's stream."""
        if not self.flying:
            return self._not_flying()
        if not VALID_S[0] <= valid_s <= VALID_S[1]:
            return _refused(f"valid_s {valid_s:g} is not between {VALID_S[0]} and {VALID_S[1]}")
        if (why := self._outside(setpoint.place, setpoint.free_xy, setpoint.free_z)) is not None:
            return _refused(why)
        now = self._loop.time()
        paused, self._followed_at = now - self._followed_at >= NEW_STREAM_S, now
        if self._frozen and not paused:
            return _refused(
                f"the origin changed under this stream, and it stays where it is: pause for {NEW_STREAM_S:g} s, then "
                "send in the new frame"
            )
        self._frozen = False
        self.pilot.follow(setpoint, now + valid_s)
        return Outcome(True, "accepted", "followed")

    def change_gains(self, changes: Mapping[str, Any], *, force: bool = False) -> Outcome:
        """Part of xy, z and hover_thrust; checked as the fleet file's are, and, unless ``force``, against the delay
        with which attitude control is let fly."""
        law = self.pilot.config.law
        try:
            new = replace(
                law,
                xy=replace(law.xy, **changes.get("xy", {})),
                z=replace(law.z, **changes.get("z", {})),
                hover_thrust=changes.get("hover_thrust", law.hover_thrust),
            )
        except ConfigError as error:
            return _refused("; ".join(error.problems))
        if not force and (why := why_not_delay(new, self.pilot.config.guard.attitude_delay_s)) is not None:
            return _refused(f"{why}; insist with force (--force)")
        self.pilot.change_law(new)
        self._law_changed = True
        self._hover_thrust_set |= "hover_thrust" in changes
        return Outcome(True, "accepted", "gains changed")

    def gains(self) -> dict[str, Any]:
        """The law's gains and limits, as control.gains shows them."""
        law = self.pilot.config.law
        return {
            "xy": asdict(law.xy),
            "z": asdict(law.z),
            "hover_thrust": law.hover_thrust,
            "limits": {
                "thrust_min": law.thrust_min,
                "thrust_max": law.thrust_max,
                "tilt_max_deg": round(math.degrees(law.tilt_max_rad), 2),
                "vel_xy_max_mps": law.vel_xy_max_mps,
                "vel_z_max_mps": law.vel_z_max_mps,
            },
        }

    def record(self, on: bool) -> Path | None:
        """Trace every tick while it flies. The path of the file that is written, or was until now; None if there is
        none yet."""
        self._recording = on
        if on and self.pilot.active:
            self._open_trace()
        path = self.recording
        if not on:
            self._close_trace()
        return path

    # -- as frames and time come

    def on_timesync(self, frame: Frame, now: float) -> None:
        """The answer to a ping of ours, or somebody else's business."""
        fields = frame.fields()
        if fields["tc1"] != 0:
            self.pilot.delay.on_pong(fields["ts1"], now)

    def origin_changed(self) -> None:
        """A stream of setpoints in the old frame ends where the vehicle is: its next ones may mean another place."""
        if self.pilot.streaming:
            self.pilot.stay()
            self._frozen = True
            text = "the origin changed while setpoints came: it stays where it is until they are sent anew"
            self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, {"state": "flying"}))

    def refresh_budget(self) -> None:
        """How many attitude setpoints a second the link bears now."""
        self.pilot.attitude_hz_allowed = self._uplink_bytes_per_s() / ATTITUDE_FRAME_BYTES

    def status(self, now: float) -> dict[str, Any]:
        """The state's ``control`` section, still in the anchor's frame."""
        path = self.recording
        return {
            **self.pilot.status(now),
            **self.clock.as_dict(),
            "recording": None if path is None else str(path),
        }

    def close(self) -> None:
        self.release("skygcs is shutting down")
        for task in self._tasks:
            task.cancel()

    # -- the inside

    def _next_turn(self) -> int:
        self._turn += 1
        return self._turn

    def _check_entry(self, now: float) -> None:
        refusal = offboard.entry_refusal(self._vehicle, now)
        if refusal is None and self._vehicle.origin is None:
            refusal = "the fleet has no origin yet, so there is no fence: set [origin], or `skygcs-cli origin from`"
        if refusal is None and not self.pilot.active and self._led_by_another():
            refusal = f"it is in {self._vehicle.mode} already: another program sends it setpoints; end that first"
        if refusal is None:
            refusal = self._outside_now(self._vehicle.origin)
        if refusal is not None:
            raise RefusedError(refusal)

    def _led_by_another(self) -> bool:
        """PX4 is in OFFBOARD only while setpoints come, and obeys each of two streams in turn. GUIDED tells nothing."""
        return self._vehicle.family == "px4" and offboard.is_following(self._vehicle)

    async def _check_attitude(self, *, force: bool) -> None:
        """Raises RefusedError where thrust would not mean thrust, or cannot be checked, or where losing the setpoints
        would be dangerous."""
        await self._attempt(lambda now: offboard.ask_parameters(self._vehicle, now))
        refusal = offboard.attitude_refusal(self._vehicle)
        if refusal is None and not force:
            refusal = offboard.loss_refusal(self._vehicle)
        if refusal is not None:
            raise RefusedError(refusal)
        if (note := offboard.loss_note(self._vehicle)) is not None:
            self._on_event(Event("warning", self._vehicle.name, self._vehicle.sysid, note, {}))

    def _begin(self, way: Way) -> None:
        hover_thrust = offboard.told_hover_thrust(self._vehicle)
        try:
            config = _pilot_config(self._settings, hover_thrust)
            if self._law_changed:
                law = self.pilot.config.law
                if not self._hover_thrust_set:  # other gains were: that the vehicle knows its own better still holds
                    law = replace(law, hover_thrust=config.law.hover_thrust)
                config = replace(config, law=law)
        except ConfigError as error:
            why = "; ".join(error.problems)
            raise RefusedError(
                f"it says its hover thrust is {hover_thrust:g}, and {why}; give hover_thrust in the fleet file"
            ) from None
        self.pilot.config = config
        self.refresh_budget()
        origin = self._vehicle.origin
        assert origin is not None
        self._fence = self._settings.fence_at(origin)
        self.pilot.engage(way, self._fence)
        self.clock.start()
        if self._recording:
            self._open_trace()

    async def _enter(self, way: Way, turn: int, back_to: int) -> Outcome:
        """Stream, measure, switch the mode over and see that it has."""
        if (ended := await self._settle(way, turn, STREAM_BEFORE_S)) is not None:
            return ended
        try:
            self._check_entry(self._loop.time())  # seconds have passed: it may have landed, or be in its failsafe
        except RefusedError as error:
            return _refused(str(error))
        if self._vehicle.custom_mode != back_to and not offboard.is_following(self._vehicle):
            return _refused(f"somebody else switched it to {self._vehicle.mode} meanwhile")
        outcome = await self._execute(offboard.enter(self._vehicle))
        if self._turn != turn:
            return _superseded(0.0)
        if not outcome.ok:
            return replace(outcome, message=f"it was not switched over: {outcome.message}")
        self.pilot.entered()
        return await self._flown(way)

    def _undo(self, reason: str, back_to: int) -> None:
        """What the guard has ended after the entry, it has ended rightly: by a hold, or because somebody else flies."""
        if self.pilot.active or not self.pilot.was_entered:
            self.release(reason)
            self._spawn(self._give_back(back_to, self._turn), "control given back")

    async def _give_back(self, back_to: int, turn: int) -> None:
        """A vehicle that obeys setpoints, or is about to because its mode was commanded already, gets none any more: it
        is not left to its timeouts. An ArduCopter whose attitude ends would drift with the wind."""
        following = await self._commander.until(lambda: offboard.is_following(self._vehicle), LATE_ENTRY_S)
        if following and self._vehicle.armed and self._turn == turn:
            await self._attempt(lambda now: offboard.leave(self._vehicle, back_to))

    async def _change(self, way: Way, turn: int) -> Outcome:
        """Another way while it flies. Its present one goes on until the state comes as fast as the new one needs it."""
        slower = WAYS.index(way) > WAYS.index(self.pilot.wanted)
        if slower:
            self.pilot.want(way)
        await self._ask_position(POSITION_HZ.get(way))
        if not slower:
            if (ended := await self._settle(way, turn, PAUSE_S)) is not None:
                return ended
            self.pilot.want(way)
        return await self._flown(way)

    async def _settle(self, way: Way, turn: int, least_s: float) -> Outcome | None:
        """Wait ``least_s``, and longer while something stands against the way that a few seconds may cure: a round trip
        not measured yet, a position stream that was slower until now. An Outcome if control ended meanwhile."""
        started = self._loop.time()
        while True:
            waited = self._loop.time() - started
            if self._turn != turn:
                return _superseded(waited)
            if not self.pilot.active:
                return _refused("; ".join(self.pilot.reasons) or "control ended")
            ready = self._measured() and not self.pilot.why_not(way, self._loop.time())
            if waited >= SETTLE_S or (waited >= least_s and ready):
                return None
            await asyncio.sleep(0.1)

    async def _flown(self, way: Way) -> Outcome:
        """The guard's first word belongs to the answer."""
        judged = self.clock.ticks + 1
        await self._commander.until(lambda: self.clock.ticks >= judged, FIRST_WORD_S)
        if not self.flying:
            return Outcome(False, "failed", f"control ended at once: {'; '.join(self.pilot.reasons)}")
        flown = self.pilot.way or way
        why = "" if flown is way else f" and not by {way.value}: {'; '.join(self.pilot.reasons)}"
        return Outcome(True, "accepted", f"flown by {flown.value} setpoints{why}")

    def _measured(self) -> bool:
        return self.pilot.delay.pings > MEASURED_PINGS and self.pilot.delay.rtt_p95_s is not None

    def _tick(self, now: float) -> None:
        pilot = self.pilot
        try:
            tick = pilot.tick(now)
            if tick.message is not None:
                self._commander.transmit(*tick.message, Priority.SETPOINT, key=self._queue_key)
        except Exception as error:  # a fault of ours must not leave a vehicle under setpoints that nobody checks
            fault = f"flight control failed inside skygcs and ends: {error!r}"
            self._on_event(Event("fault", self._vehicle.name, self._vehicle.sysid, fault, {}))
            tick = Tick(events=pilot.release(fault).events, hold=True)
        self._apply(tick)
        if pilot.active and pilot.delay.due_ping(now):
            self._ping(now)

    def _apply(self, tick: Tick) -> None:
        if tick.row is not None and self._trace is not None and tick.before is not None and tick.after is not None:
            try:
                self._trace.write(tick.row, self.pilot.config.law, tick.before, tick.after)
            except OSError as error:
                self._give_up_trace(error)
        if not self.pilot.active and self.clock.running:
            self.clock.stop()
            self._displace()
            self._close_trace()
            self._restore_position()
        for event in tick.events:
            self._on_event(event)
        if tick.hold:
            self._spawn(self._hold(self._turn), "hold")

    async def _hold(self, turn: int) -> None:
        if self._turn != turn:
            return  # an order came before this had its turn: it must not take that one's place
        outcome = await self._attempt(lambda now: orders.hold(self._vehicle, now))
        if not outcome.ok:
            text = f"it was told to hold, but: {outcome.message}; its own failsafe has to act"
            self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, {"state": "held"}))

    def _ping(self, now: float) -> None:
        if TIMESYNC not in self._dialect.by_name:
            return
        token = self.pilot.delay.ping(now)
        self._commander.transmit(TIMESYNC, {"tc1": 0, "ts1": token}, Priority.EXCHANGE)

    def _displace(self) -> None:
        """A setpoint may still wait for a busy link, and would leave after whatever ended control: a ping takes its
        place (latest wins), for want of a way to take it back."""
        if TIMESYNC in self._dialect.by_name:
            token = self.pilot.delay.ping(self._loop.time())
            self._commander.transmit(TIMESYNC, {"tc1": 0, "ts1": token}, Priority.SETPOINT, key=self._queue_key)

    async def _ask_position(self, rate_hz: float | None) -> None:
        if rate_hz is not None:
            rate_hz = max(rate_hz, self._position_hz or 0.0)
            await self._attempt(lambda now: self._interval(now, rate_hz))

    def _restore_position(self) -> None:
        """Back to the rate of the picture; nobody waits for it."""
        if self._vehicle.connected:
            self._spawn(self._attempt(lambda now: self._interval(now, self._position_hz)), "position rate")

    def _interval(self, now: float, rate_hz: float | None) -> Plan:
        return orders.message_interval(self._vehicle, now, self._dialect, "GLOBAL_POSITION_INT", rate_hz)

    def _outside_now(self, origin: Origin | None) -> str | None:
        position = self._vehicle.section("position")
        if origin is None or position is None or position["lat_deg"] is None:
            return None
        fence = self._settings.fence_at(origin)
        return fence.why_not(position["lat_deg"], position["lon_deg"], position["alt_amsl_m"])

    def _outside(self, place: Place | None, free_xy: bool = False, free_z: bool = False) -> str | None:
        if self._fence is None or place is None:
            return None
        here = (place.lat_deg, place.lon_deg, place.alt_amsl_m)
        return self._fence.why_not(*here, reference=True, free_xy=free_xy, free_z=free_z)

    def _not_flying(self) -> Outcome:
        held = self.pilot.state is PilotState.HELD
        why = f"it is held: {'; '.join(self.pilot.reasons)}" if held else "control is off"
        return _refused(f"{why}; `skygcs-cli control set {self._vehicle.name} position` first")

    def _open_trace(self) -> None:
        if self._trace is not None or self.pilot.frame is None:
            return
        anchor = self.pilot.frame.origin
        head = TraceHead(self._vehicle.name, anchor.lat_deg, anchor.lon_deg, anchor.alt_amsl_m)
        try:
            self._trace = TraceFile(self._log_dir, head)
        except OSError as error:
            self._give_up_trace(error)
            return
        self.pilot.tracing = True

    def _close_trace(self) -> None:
        trace, self._trace = self._trace, None
        self.pilot.tracing = False
        if trace is not None:
            try:
                trace.close()
            except OSError as error:
                self._give_up_trace(error)

    def _give_up_trace(self, error: OSError) -> None:
        trace, self._trace, self.pilot.tracing = self._trace, None, False
        if trace is not None:
            with contextlib.suppress(OSError):  # of what could not be written, which is told below
                trace.close()
        text = f"its control is traced no more: {error.strerror or error}"
        self._on_event(Event("warning", self._vehicle.name, self._vehicle.sysid, text, {}))

    def _spawn(self, work: Any, name: str) -> None:
        task = self._loop.create_task(work, name=f"{self._vehicle.name} {name}")
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            text = f"{task.get_name()} failed inside skygcs: {error!r}"
            self._on_event(Event("fault", self._vehicle.name, self._vehicle.sysid, text, {}))


def _pilot_config(settings: ControlSettings, hover_thrust: float | None) -> PilotConfig:
    config = PilotConfig(settings.law(hover_thrust), settings.guard())
    rates = {"attitude_hz": settings.rate_hz, "velocity_hz": settings.velocity_hz, "position_hz": settings.position_hz}
    told: dict[str, Any] = {k: v for k, v in {**rates, "rate_min_hz": settings.rate_min_hz}.items() if v is not None}
    return replace(config, **told)


def _refused(why: str) -> Outcome:
    return Outcome(False, "refused", f"refused: {why}")


def _superseded(elapsed_s: float) -> Outcome:
    return Outcome(False, "cancelled", "a newer order took its place", elapsed_s=elapsed_s)
