"""When a joystick flies: the state machine around its dead-man button.

| state | on | next | effects |
|---|---|---|---|
| starting | every mapped axis and the button seen, sticks centred, button released | ready | Report |
| starting | the same, but a stick is off its centre or the button is pressed | ended | Finish |
| starting | START_S passed: an axis or the button does not exist | ended | Finish |
| ready | button pressed, sticks centred | engaging | Engage |
| ready | button pressed, a stick off its centre | ready | Report; only the next press counts |
| engaging | engaged | flying | Report |
| engaging | not engaged | ready | Report; only the next press counts |
| flying | a tick | flying | Send |
| engaging, flying | button released, or ticks came GAP_S apart | stopping | Stop |
| engaging, flying | device lost, exit asked | stopping | Stop, then ended |
| engaging, flying | someone else has the vehicle | ended | Finish: nothing is sent |
| stopping | stopped | ready or ended | Report or Finish |
| stopping | device lost, exit asked | stopping | then ended |
| starting, ready | device lost, exit asked | ended | Finish |

Nothing moves the vehicle in any state but flying. A press during stopping is not taken over: it has to be made again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from skygcs.ext.joystick.device_events import AXIS, BUTTON, JoystickEvent
from skygcs.ext.joystick.stick_mapping import STILL, StickAxes, StickDemand, StickLimits, approach, demand, off_centre

START_S = 2.0
"""The kernel sends the state of all axes and buttons with the first read."""

GAP_S = 1.0
"""Twenty periods. This program or its computer was stopped, and the daemon has stopped the vehicle: a press from before
does not move it again."""

LONGEST_STEP_S = 0.1
"""After late ticks the velocity goes on from where it was, without a jump."""


class SessionState(Enum):
    STARTING = "starting"
    READY = "ready"
    ENGAGING = "engaging"
    FLYING = "flying"
    STOPPING = "stopping"
    ENDED = "ended"


@dataclass(frozen=True)
class Engage:
    """Take the vehicle under control, then call `StickSession.on_engaged`."""


@dataclass(frozen=True)
class Send:
    """Send this velocity now."""

    demand: StickDemand


@dataclass(frozen=True)
class Stop:
    """Send zero velocity (if ``flying``), order hold, then call `StickSession.on_stopped`."""

    flying: bool


@dataclass(frozen=True)
class SessionReport:
    text: str


@dataclass(frozen=True)
class Finish:
    """The end. ``ok``: it was asked for, and the vehicle, if it was flown, holds."""

    text: str
    ok: bool


Effect = Engage | Send | Stop | SessionReport | Finish


class StickSession:
    """One joystick and one vehicle, from the opening of the device to the end. Methods return what is to be done."""

    def __init__(self, axes: StickAxes, limits: StickLimits, button: int, now: float) -> None:
        self.state = SessionState.STARTING
        self._axes = axes
        self._limits = limits
        self._button = button
        self._began = now
        self._values: dict[int, float] = {}
        self._pressed: bool | None = None
        self._spent = False
        """The press that is going on does not count."""
        self._ending: tuple[str, bool] | None = None
        self._last_tick: float | None = None
        self._vel_mps = STILL.vel_mps

    def on_events(self, events: Iterable[JoystickEvent], now: float) -> list[Effect]:
        """Return what the device reported, in its order: a release between two presses is never missed."""
        effects: list[Effect] = []
        for event in events:
            if event.kind == AXIS:
                self._values[event.number] = event.value
            elif event.kind == BUTTON and event.number == self._button:
                before, self._pressed = self._pressed, event.value > 0
                if self.state is not SessionState.STARTING and before != self._pressed:
                    effects += self._on_button(now)
        return effects + (self._look_at_start(now) if self.state is SessionState.STARTING else [])

    def on_device_lost(self, reason: str) -> list[Effect]:
        """Unplugged, or the device cannot be read."""
        return self._end(f"the joystick is gone ({reason})", ok=False)

    def on_exit_asked(self, reason: str) -> list[Effect]:
        return self._end(reason, ok=True)

    def on_engaged(self, ok: bool, message: str, now: float) -> list[Effect]:
        """The answer to Engage; one that comes after the button was released is of no effect."""
        if self.state is not SessionState.ENGAGING:
            return []
        if not ok:
            self.state, self._spent = SessionState.READY, True
            return [SessionReport(f"not taken under control: {message}; release the button and try again")]
        self.state, self._last_tick, self._vel_mps = SessionState.FLYING, now, STILL.vel_mps
        return [SessionReport("flying: release the button to stop")]

    def on_stopped(self, ok: bool, message: str) -> list[Effect]:
        """The answer to Stop."""
        if self.state is not SessionState.STOPPING:
            return []
        if self._ending is not None:
            reason, asked = self._ending
            return self._finish(f"{reason}: {message}", asked and ok)
        self.state, self._spent = SessionState.READY, bool(self._pressed)
        return [SessionReport(message)]

    def on_taken_away(self, message: str) -> list[Effect]:
        """The vehicle is not flown by our setpoints any more; whoever has it is not fought."""
        if self.state not in (SessionState.ENGAGING, SessionState.FLYING):
            return []
        return self._finish(f"control has ended: {message}", False)

    def tick(self, now: float) -> list[Effect]:
        """At a constant rate; all events that had come must have been given to `on_events` before."""
        if self.state is SessionState.STARTING:
            return self._look_at_start(now)
        if self.state is not SessionState.FLYING:
            return []
        dt_s = now - (self._last_tick if self._last_tick is not None else now)
        self._last_tick = now
        if not 0 <= dt_s <= GAP_S:
            self._spent = True
            return [SessionReport(f"this program stood still for {dt_s:.1f} s"), *self._stop()]
        wanted = approach(
            self._vel_mps, demand(self._axes, self._limits, self._values), self._limits, min(dt_s, LONGEST_STEP_S)
        )
        self._vel_mps = wanted.vel_mps
        return [Send(wanted)]

    def on_refused_setpoint(self) -> None:
        """The vehicle was sent a zero velocity instead: the sticks take effect from there."""
        self._vel_mps = STILL.vel_mps

    # -- transitions

    def _look_at_start(self, now: float) -> list[Effect]:
        missing = [f"axis {n} ({name})" for n, name in sorted(self._axes.numbers().items()) if n not in self._values]
        missing += [f"button {self._button}"] if self._pressed is None else []
        if missing:
            if now - self._began < START_S:
                return []
            return self._finish(f"the joystick has no {', '.join(missing)}: see --axes and --button", False)
        if self._pressed:
            return self._finish(f"button {self._button} is pressed at the start: release it, or it is stuck", False)
        if away := off_centre(self._axes, self._values):
            return self._finish(f"not centred at the start: {', '.join(away)}", False)
        self.state = SessionState.READY
        return [SessionReport(f"ready: hold button {self._button} to fly")]

    def _on_button(self, now: float) -> list[Effect]:
        if not self._pressed:
            self._spent = False
            return self._stop() if self.state in (SessionState.ENGAGING, SessionState.FLYING) else []
        if self.state is SessionState.STOPPING:
            self._spent = True
        if self.state is not SessionState.READY or self._spent:
            return []
        if away := off_centre(self._axes, self._values):
            self._spent = True
            return [SessionReport(f"not centred: {', '.join(away)}; release the button, centre, press it again")]
        self.state = SessionState.ENGAGING
        return [Engage()]

    def _stop(self) -> list[Effect]:
        flying = self.state is SessionState.FLYING
        self.state = SessionState.STOPPING
        return [Stop(flying)]

    def _end(self, reason: str, *, ok: bool) -> list[Effect]:
        if self.state in (SessionState.ENGAGING, SessionState.FLYING):
            self._ending = (reason, ok)
            return self._stop()
        if self.state is SessionState.STOPPING:
            self._ending = self._ending or (reason, ok)
            return []
        return [] if self.state is SessionState.ENDED else self._finish(reason, ok)

    def _finish(self, text: str, ok: bool) -> list[Effect]:
        self.state = SessionState.ENDED
        return [Finish(text, ok)]
