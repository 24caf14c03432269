"""Flying one vehicle by setpoints in real time: orders, the ticks, the round-trip pings.

What is sent and when it ends is decided in `core.vehicle.pilot`; here it meets the clock and the link. How a vehicle is
taken over and given back is in `takeover`, its trace in `trace_file`.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from skygcs.config.control import ControlSettings
from skygcs.core.control.analysis import why_not_delay
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.guard import ControlMode
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.protocols.command import Outcome
from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle import offboard_entry, orders
from skygcs.core.vehicle.geodetic_position import GeodeticPosition, Setpoint
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardController, OffboardState, Tick
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import ConfigError, RefusedError
from skygcs.events import Event
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.control_clock import ControlClock
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.plan_runner import Attempt, Execute
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.trace_file import Recording

VALID_S = (0.1, 5.0)
"""Deadlines a setpoint may have."""

LEFT_S = 4.0
"""A vehicle that shows the mode of setpoints again within four heartbeats never left it: somebody else sent the other
mode with its ids."""

NEW_STREAM_S = 1.0
"""A client that has sent nothing for so long has noticed that something changed."""

TIMESYNC = "TIMESYNC"

GOLDEN_RATIO = 0.6180339887498949
"""Its multiples, without the whole turns, lie as far from each other as any number of them can: the ticks of a fleet
that one order engages do not wait for each other."""


class FlightControl:
    """One vehicle's. ``execute`` carries out a plan, ``attempt`` plans and carries out.

    Every order that moves the vehicle calls `release` before it is carried out.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        settings: ControlSettings,
        commands: CommandClient,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        *,
        execute: Execute,
        attempt: Attempt,
        position_hz: float | None,
        plan_position: Callable[[float | None], bool] = lambda rate_hz: False,
        on_event: Callable[[Event], None],
        log_dir: Path,
        uplink_bytes_per_s: Callable[[], float],
        stream_refusal: Callable[[bool], str | None] = lambda px4: None,
    ) -> None:
        self._vehicle = vehicle
        self._settings = settings
        self._commands = commands
        self._dialect = dialect
        self._loop = loop
        self._attempt = attempt
        self._on_event = on_event
        self._uplink_bytes_per_s = uplink_bytes_per_s
        self.pilot = OffboardController(vehicle, _offboard_config(settings, None))
        phase = vehicle.sysid * GOLDEN_RATIO % 1.0
        self.clock = ControlClock(loop, self._tick, lambda: self.pilot.period_s, phase=phase)
        self._fence: Fence | None = None
        self._queue_key = ("setpoint", vehicle.sysid, vehicle.compid)
        """Of the link's queue: a newer setpoint replaces one that still waits."""
        self._trace = Recording(self.pilot, log_dir, on_event)
        self._tasks = TaskSet(loop, on_event, vehicle.name, vehicle.sysid)
        self._engagement = OffboardEngagement(
            vehicle,
            settings,
            commands,
            dialect,
            loop,
            self.pilot,
            self.clock,
            self._tasks,
            execute=execute,
            attempt=attempt,
            begin=self._begin,
            release=self.release,
            position_hz=position_hz,
            plan_position=plan_position,
            stream_refusal=stream_refusal,
            on_event=on_event,
        )
        self._law_changed = False
        self._hover_thrust_set = False
        self._followed_at = -math.inf
        self._frozen = False

    @property
    def flying(self) -> bool:
        """Whether it is led by our setpoints now."""
        return self.pilot.state is OffboardState.FLYING

    @property
    def recording(self) -> Path | None:
        """The file its trace goes to now; None: it is not traced."""
        return self._trace.path

    # -- orders

    async def engage(self, control_mode: ControlMode, *, force: bool = False) -> Outcome:
        """The whole sequence: checks, faster position, a stream of setpoints, the mode, its verification; undone on
        failure. While it flies already, only the way changes. ``force``: in spite of what it would do on its own if the
        setpoints ceased."""
        return await self._engagement.engage(control_mode, force=force)

    def release(self, reason: str) -> None:
        """Send nothing from now on. Idempotent."""
        self._engagement.next_turn()
        self._apply(self.pilot.release(reason))

    def fly_to(self, place: GeodeticPosition, yaw_enu_rad: float | None) -> Outcome:
        """Move the reference. Refused outside the fence, and unless it flies."""
        if not self.flying:
            return self._not_flying()
        if (why := self._outside(place)) is not None:
            return Outcome.refused(why)
        self.pilot.fly_to(place, yaw_enu_rad)
        control_mode = self.pilot.control_mode or self.pilot.wanted
        return Outcome(True, "accepted", f"flying there by {control_mode.value} setpoints")

    def follow(self, setpoint: Setpoint, valid_s: float) -> Outcome:
        """One setpoint of a client's stream."""
        if not self.flying:
            return self._not_flying()
        if not VALID_S[0] <= valid_s <= VALID_S[1]:
            return Outcome.refused(f"valid_s {valid_s:g} is not between {VALID_S[0]} and {VALID_S[1]}")
        if (why := self._outside(setpoint.place, setpoint.free_xy, setpoint.free_z)) is not None:
            return Outcome.refused(why)
        now = self._loop.time()
        paused, self._followed_at = now - self._followed_at >= NEW_STREAM_S, now
        if self._frozen and not paused:
            return Outcome.refused(
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
            return Outcome.refused("; ".join(error.problems))
        if not force and (why := why_not_delay(new, self.pilot.config.guard.attitude_delay_s)) is not None:
            return Outcome.refused(f"{why}; insist with force (--force)")
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
        return self._trace.record(on)

    # -- as frames and time come

    def on_timesync(self, frame: Frame, now: float) -> None:
        """The answer to a ping of ours, or somebody else's business."""
        fields = frame.fields()
        if fields["tc1"] != 0:
            self.pilot.delay.on_pong(fields["ts1"], now)

    def on_text(self, text: str) -> None:
        """A status text: what the vehicle throws away it is not sent again and again."""
        if self.pilot.active and offboard_entry.refuses_setpoint(text):
            self.pilot.refusing = text

    def origin_changed(self) -> None:
        """A stream of setpoints in the old frame ends where the vehicle is: its next ones may mean another place."""
        if self.pilot.streaming:
            self.pilot.stay()
            self._frozen = True
            text = "the origin changed while setpoints came: it stays where it is until they are sent anew"
            self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, {"state": "flying"}))

    def refresh_budget(self) -> None:
        """How many attitude setpoints a second the link bears now."""
        self.pilot.attitude_hz_allowed = self._uplink_bytes_per_s() / FRAME_BYTES["SET_ATTITUDE_TARGET"]

    def status(self, now: float) -> dict[str, Any]:
        """The state's ``control`` section, still in the anchor's frame."""
        path = self.recording
        return {
            **self.pilot.status(now),
            **self.clock.as_dict(),
            "recording": None if path is None else str(path),
        }

    async def settled(self) -> None:
        """Until a vehicle that is given back, held or asked for its own rates again has been."""
        await self._tasks.settled()

    def close(self) -> None:
        self.release("skygcs is shutting down")
        self._tasks.close()

    # -- the inside

    def _begin(self, control_mode: ControlMode) -> None:
        hover_thrust = offboard_entry.told_hover_thrust(self._vehicle)
        try:
            config = _offboard_config(self._settings, hover_thrust)
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
        self._fence = _shared(self._settings.fence_at(origin))
        self.pilot.engage(control_mode, self._fence)
        self.clock.start()
        self._trace.begin()

    def _tick(self, now: float) -> None:
        pilot = self.pilot
        try:
            tick = pilot.tick(now)
            if tick.message is not None:
                self._commands.transmit(*tick.message, Priority.SETPOINT, key=self._queue_key)
        except Exception as error:  # a fault of ours must not leave a vehicle under setpoints that nobody checks
            fault = f"flight control failed inside skygcs and ends: {error!r}"
            self._on_event(Event("fault", self._vehicle.name, self._vehicle.sysid, fault, {}))
            tick = Tick(events=pilot.release(fault).events, hold=True)
        if tick.events or tick.row is not None or not pilot.active or tick.hold:
            self._apply(tick)
        if pilot.active and pilot.delay.due_ping(now):
            self._ping(now)

    def _apply(self, tick: Tick) -> None:
        self._trace.write(tick)
        if not self.pilot.active and self.clock.running:
            self.clock.stop()
            self._displace()
            self._trace.end()
            self._engagement.restore_position()
        for event in tick.events:
            self._on_event(event)
        if tick.hold:
            self._tasks.start(self._hold(self._engagement.turn), "hold")
        elif tick.left:
            self._tasks.start(self._hold_if_it_follows(self._engagement.turn), "hold if it follows")

    async def _hold_if_it_follows(self, turn: int) -> None:
        """It showed another mode, and control ended. If it is in the mode of setpoints after all, it flies by those it
        got last and drifts when they are over: it is ordered to hold."""
        follows = await self._commands.until(lambda: offboard_entry.is_following(self._vehicle), LEFT_S)
        if follows and self._vehicle.armed and not self.pilot.active:
            await self._hold(turn)

    async def _hold(self, turn: int) -> None:
        if self._engagement.turn != turn:
            return  # an order came before this had its turn: it must not take that one's place
        outcome = await self._attempt(lambda now: orders.hold(self._vehicle, now))
        if not outcome.ok:
            text = f"it was told to hold, but: {outcome.message}; its own failsafe has to act"
            self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, {"state": "held"}))

    def _ping(self, now: float, priority: Priority = Priority.PROTOCOL, key: Hashable | None = None) -> None:
        if TIMESYNC in self._dialect.by_name:
            token = self.pilot.delay.ping(now)
            self._commands.transmit(TIMESYNC, {"tc1": 0, "ts1": token}, priority, key=key)

    def _displace(self) -> None:
        """A setpoint may still wait for a busy link, and would leave after whatever ended control: a ping takes its
        place (latest wins), for want of a way to take it back."""
        self._ping(self._loop.time(), Priority.SETPOINT, self._queue_key)

    def _outside(self, place: GeodeticPosition | None, free_xy: bool = False, free_z: bool = False) -> str | None:
        if self._fence is None or place is None:
            return None
        here = (place.lat_deg, place.lon_deg, place.alt_amsl_m)
        return self._fence.why_not(*here, reference=True, free_xy=free_xy, free_z=free_z)

    def _not_flying(self) -> Outcome:
        held = self.pilot.state is OffboardState.HELD
        why = f"it is held: {'; '.join(self.pilot.reasons)}" if held else "control is off"
        return Outcome.refused(f"{why}; `skygcs-cli control set {self._vehicle.name} position` first")


def _offboard_config(settings: ControlSettings, hover_thrust: float | None) -> OffboardConfig:
    config = OffboardConfig(settings.law(hover_thrust), settings.guard())
    rates = {"attitude_hz": settings.rate_hz, "velocity_hz": settings.velocity_hz, "position_hz": settings.position_hz}
    told: dict[str, Any] = {k: v for k, v in {**rates, "rate_min_hz": settings.rate_min_hz}.items() if v is not None}
    shared: OffboardConfig = _shared(replace(config, **told))
    return shared


@lru_cache(maxsize=256)
def _shared(value: Hashable) -> Any:
    """The first of those that are equal: with a hundred vehicles it is then still in the CPU's caches when the next one
    ticks (measured there: 4 % of a tick)."""
    return value
