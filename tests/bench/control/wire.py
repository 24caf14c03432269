"""One vehicle of the daemon's core and a simulated PX4 with a link between them that delays both ways, in virtual time.

What `steps` leaves out is here: the entry into OFFBOARD, the messages with their rounding, the simulator's and the
telemetry's ticks of 20 ms, the guard with the delay it measures itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from skygcs.core.control import ControlConfig
from skygcs.core.control.guard import ControlMode, GuardConfig
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardController, OffboardState
from skygcs.core.vehicle.offboard_entry import guided_mode
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.sim.conditions import Conditions
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.quad import Quad
from skygcs.sim.rng import Rng

FIELD = LocalFrame(43.7806, -79.4653, 180.0)
OWN = (255, 190)
GRID_S = 0.005
"""Of time here; delays are kept to it."""
PERIOD_S = 0.02
PHASE_S = 0.015
"""Of our ticks after the vehicle's. A setpoint works from the beginning of the vehicle's tick in which it comes; so a
state of time 0 comes at d/2, is seen by the next of our ticks and works from d on: `steps` with the same delay."""
GLOBAL_POSITION_INT, TIMESYNC = 33, 111
SET_MESSAGE_INTERVAL, ARM, TAKEOFF, SET_MODE = 511, 400, 22, 176
TIMEOUT_S = 60.0

BEAR_ALL = GuardConfig(attitude_delay_s=1.0, velocity_delay_s=1.0, stale_s=2.0)
"""A guard that lets attitude fly with any delay of the bench, so that what it protects from can be seen."""


@dataclass(frozen=True, slots=True)
class Flown:
    """A step under the pilot. ``delay_s`` is what the delay meter measured, p95."""

    track_m: list[float]
    """East, from the start, at every tick, as it truly was."""
    control_mode: ControlMode | None
    delay_s: float | None
    supply_v: float
    """Of its battery when the step began."""
    events: list[str]


class WiredPilot:
    """A pilot, its vehicle, and the simulated one at the other end of ``delay_s`` (there and back)."""

    def __init__(
        self,
        dialect: Dialect,
        conditions: Conditions,
        delay_s: float,
        guard: GuardConfig,
        law: ControlConfig | None = None,
    ) -> None:
        self.now = 0.0
        self.sim = Px4Vehicle(dialect, 1, FIELD, rng=Rng(1), conditions=conditions)
        self.vehicle = Vehicle(1, 1, dialect)
        self.pilot = OffboardController(self.vehicle, OffboardConfig(law or ControlConfig(), guard))
        self.events: list[str] = []
        self._dialect = dialect
        self._one_way_s = delay_s / 2
        self._up: deque[tuple[float, bytes]] = deque()
        self._down: deque[tuple[float, bytes]] = deque()
        self._ears, self._sim_ears = FrameParser(dialect), FrameParser(dialect)
        self._seq = 0
        self._steps = 0

    def fly_step(self, control_mode: ControlMode, east_m: float, seconds: float) -> Flown:
        """Take off, take over, come to rest, then a step to the east."""
        self._until(lambda: self.sim.position_ok)
        self.command(TAKEOFF, p7=FIELD.alt_amsl_m + 10.0, p5=math.nan, p6=math.nan)
        self.command(ARM, p1=1.0)
        self.command(SET_MESSAGE_INTERVAL, p1=GLOBAL_POSITION_INT, p2=1e6 * PERIOD_S)
        self._until(lambda: self.sim.motion.up_m > 9.8)
        self.run(5.0)
        self.pilot.engage(control_mode, None)
        self.run(1.5 + 2 * self._one_way_s)
        self.command(SET_MODE, p1=1.0, p2=6.0)
        self._until(lambda: self.vehicle.custom_mode == guided_mode(self.vehicle))
        self.pilot.entered()
        self.run(10.0)
        assert self.pilot.state is OffboardState.FLYING and self.pilot.frame is not None, self.events
        x, y, z = self.pilot.reference.pos_enu_m if self.pilot.reference else (0.0, 0.0, 0.0)
        start_m, supply_v = self.sim.motion.east_m, _supply_v(self.sim)
        self.pilot.fly_to(GeodeticPosition(*self.pilot.frame.to_geodetic(x + east_m, y, z)), None)
        track = self.run(seconds)
        return Flown(
            [e - start_m for e in track], self.pilot.control_mode, self.pilot.delay_p95_s, supply_v, self.events
        )

    def run(self, seconds: float) -> list[float]:
        """Let time pass; where it truly was (east, m) at each of our ticks."""
        track = []
        for _ in range(round(seconds / GRID_S)):
            self._steps += 1
            self.now = self._steps * GRID_S
            for raw in self._arrived(self._up):
                for frame in self._sim_ears.feed_datagram(raw):
                    self.sim.on_frame(frame, self.now)
            self._down.extend((self.now + self._one_way_s, raw) for raw in self.sim.step(self.now))
            for raw in self._arrived(self._down):
                for frame in self._ears.feed_datagram(raw):
                    self._hear(frame)
            if self._steps % round(PERIOD_S / GRID_S) == round(PHASE_S / GRID_S):
                track.append(self.sim.motion.east_m)
                self._tick()
            if self._steps % round(1 / GRID_S) == 0:
                self.vehicle.tick(self.now)
                self._send("HEARTBEAT", {"type": 6, "autopilot": 8, "mavlink_version": 3})
        return track

    def command(self, command: int, **params: float) -> None:
        names = {f"p{n}": f"param{n}" for n in range(1, 8)}
        values = {names[key]: value for key, value in params.items()}
        self._send("COMMAND_LONG", {"target_system": 1, "target_component": 1, "command": command, **values})

    def _until(self, condition: Callable[[], bool]) -> None:
        end = self.now + TIMEOUT_S
        while not condition():
            assert self.now < end, f"stuck after {TIMEOUT_S} s: {self.events}"
            self.run(0.1)

    def _hear(self, frame: Frame) -> None:
        self.vehicle.on_frame(frame, self.now)
        if frame.msgid == TIMESYNC and frame.fields()["tc1"] != 0:
            self.pilot.delay.on_pong(frame.fields()["ts1"], self.now)

    def _tick(self) -> None:
        tick = self.pilot.tick(self.now)
        self.events += [event.text for event in tick.events]
        if tick.message is not None:
            self._send(*tick.message)
        if self.pilot.active and self.pilot.delay.due_ping(self.now):
            self._send("TIMESYNC", {"tc1": 0, "ts1": self.pilot.delay.ping(self.now)})

    def _send(self, name: str, values: dict[str, Any]) -> None:
        info = self._dialect.by_name[name]
        target = {"target_system": 1, "target_component": 1} if info.target_system_offset >= 0 else {}
        raw = encode(info, {**target, **values}, sysid=OWN[0], compid=OWN[1], seq=self._seq)
        self._seq = (self._seq + 1) & 0xFF
        self._up.append((self.now + self._one_way_s, raw))

    def _arrived(self, way: deque[tuple[float, bytes]]) -> list[bytes]:
        arrived = []
        while way and way[0][0] <= self.now + 1e-9:
            arrived.append(way.popleft()[1])
        return arrived


def _supply_v(sim: Px4Vehicle) -> float:
    assert isinstance(sim.motion, Quad), "rigid bodies only"
    return sim.motion.supply_v
