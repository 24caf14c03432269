"""CPU of one control tick in each way of control: of the pilot alone, of pilot and message up to a link in memory
("sent"), and of all the daemon does in a tick ("whole": the clock's timer, a new position and attitude for each, a UDP
socket, the record).

Run by `make bench`. Interleaved with the law alone, and compared with it as a ratio: these machines are noisy. One
vehicle, so all of it is in the CPU's caches; what a tick costs among a hundred is told by `bench.control`.
Results also in build/bench/control-tick.json.
"""

from __future__ import annotations

import asyncio
import math
import socket
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import uvloop
from pymavlink.dialects.v20 import ardupilotmega as mav

from bench.results import keep
from skygcs.config.control import ControlSettings
from skygcs.config.models import FleetConfig, MemoryLinkConfig, UdpClientLinkConfig, VehicleConfig
from skygcs.core.control.cascade import Estimate, Memory, Reference, step
from skygcs.core.control.control_fence import Fence
from skygcs.core.control.guard import CONTROL_MODES, ControlMode
from skygcs.core.geo import Origin
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.frames import GeodeticPosition
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardController, OffboardState
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.links.memory import MemoryLink
from skygcs.links.udp import UdpClientLink
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.hub import Hub
from skygcs.runtime.offboard_engagement import OffboardEngagement
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.stream_requester import StreamRequester
from support.services import connect, services
from support.vehicles import HOME, PX4, PX4_LOITER, Voice, flight_dialect

TICKS = 2_000
ROUNDS = 7
RATIO_LIMIT = 12.0
"""Of an attitude tick that is sent to the law's step in it. Measured: 6.7 to 8.2, of 4.5 us."""
OFFBOARD = 6 << 16
GPS = mav.MAVLink_gps_raw_int_message(0, 3, 473977420, 85455940, 488000, 80, 120, 100, 9000, 12)
BATTERY = mav.MAVLink_sys_status_message(0, 0, 0, 0, 15800, 1200, 80, 0, 0, 0, 0, 0, 0)


class Flown:
    """One vehicle behind a memory link, flown by ``way``, with a new position for every tick."""

    def __init__(self, way: ControlMode) -> None:
        self.loop = asyncio.get_running_loop()
        self.now = self.loop.time()
        dialect = flight_dialect()
        hub = Hub(FleetConfig(), dialect, self.loop, lambda event: None)
        connect(hub)
        self.link = MemoryLink(MemoryLinkConfig(type="memory", name="radio", loss=1.0), hub, self.loop)
        self.hub = hub
        self.vehicle = Vehicle(1, 1, dialect, decoder=Decoder(dialect))
        self.voice = Voice(1)
        self.commands = CommandClient((1, 1), (255, 25), dialect, hub.send, self.loop)
        settings = ControlSettings()
        self.pilot = OffboardController(self.vehicle, OffboardConfig(settings.law(), settings.guard()))
        self.control_mode = way
        self.positions = [
            self.voice.position(HOME[0] + 1e-6 * math.sin(i / 9), HOME[1], HOME[2] + 10, 10.0, heading=100 * i)
            for i in range(50)
        ]

    async def begin(self) -> None:
        await self.link.open()
        self.link.arrived(self.voice.beat(PX4, PX4_LOITER, armed=True, status=4).raw)
        assert self.hub.channels_to(1, 1), "the route to the vehicle is known"
        self.vehicle.on_frame(self.voice.beat(PX4, OFFBOARD, armed=True, status=4), self.now)
        self.vehicle.on_frame(self.voice.landed(2), self.now)
        self.vehicle.on_frame(self.positions[0], self.now)
        self.pilot.engage(self.control_mode, Fence(Origin(*HOME)))
        for _ in range(5):
            self.pilot.delay.on_pong(self.pilot.delay.ping(self.now - 0.004), self.now)
        self.pilot.entered()
        self.pilot.fly_to(GeodeticPosition(HOME[0] + 1e-5, HOME[1], HOME[2] + 12), None)
        for i in range(400):
            self.tick(i)
        assert (self.pilot.state, self.pilot.control_mode) == (OffboardState.FLYING, self.control_mode)

    def hear(self, i: int) -> None:
        """A position every other tick, once a second the rest."""
        self.now += 0.02
        if i % 2 == 0:
            self.vehicle.on_frame(self.positions[i // 2 % len(self.positions)], self.now)
        if i % 50 == 0:
            self.vehicle.on_frame(self.voice.beat(PX4, OFFBOARD, armed=True, status=4), self.now)
            self.vehicle.on_frame(self.voice.landed(2), self.now)
            self.vehicle.on_frame(self.voice.say(GPS), self.now)
            self.vehicle.on_frame(self.voice.say(BATTERY), self.now)
            self.pilot.delay.on_pong(self.pilot.delay.ping(self.now - 0.004), self.now)

    def tick(self, i: int, *, send: bool = True) -> None:
        self.hear(i)
        tick = self.pilot.tick(self.now)
        assert tick.message is not None
        if send:
            self.commands.transmit(*tick.message, Priority.SETPOINT, key=("setpoint", 1, 1))

    def cost_us(self, send: bool) -> float:
        """CPU of one tick; of the pilot alone without ``send``. What the vehicle says is not counted."""
        return per_tick_us(lambda i: self.tick(i, send=send)) - per_tick_us(self.hear)


class TimeOfItsOwn:
    """The loop, whose time passes only when told; its timers are real, and never fire."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.now = loop.time()
        self._loop = loop
        self._timers: list[asyncio.TimerHandle] = []
        self.fire: Callable[[], object] = lambda: None
        """What the newest timer would do."""

    def time(self) -> float:
        return self.now

    def call_at(self, when: float, callback: Callable[[], object]) -> asyncio.TimerHandle:
        timer = self._loop.call_later(3600.0, callback)
        self._timers.append(timer)
        self.fire = callback
        return timer

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loop, name)

    def forget(self) -> None:
        while self._timers:
            self._timers.pop().cancel()


class Whole:
    """One vehicle as the daemon flies it, but for who calls: each tick has a position and an attitude of its own."""

    def __init__(self, way: ControlMode, folder: Path) -> None:
        self.loop = TimeOfItsOwn(asyncio.get_running_loop())
        loop: Any = self.loop
        dialect = flight_dialect()
        self.peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.peer.bind(("127.0.0.1", 0))  # nobody reads it: who wakes up for a setpoint is not measured
        self.hub = Hub(
            FleetConfig(),
            dialect,
            loop,
            lambda event: None,
            recorder=Recorder(folder, 1 << 30, 3600.0, lambda event: None),
        )
        connect(self.hub)
        config = UdpClientLinkConfig(name="air", host="127.0.0.1", port=self.peer.getsockname()[1], role="vehicle")
        self.link = UdpClientLink(config, self.hub, asyncio.get_running_loop())
        self.vehicle = Vehicle(1, 1, dialect, decoder=Decoder(dialect))
        self.voice = Voice(1)
        commands = CommandClient((1, 1), (255, 25), dialect, self.hub.send, loop)
        runner: Any = SimpleNamespace(attempt_in_control=_nothing)
        self.offboard = OffboardEngagement(
            self.vehicle,
            VehicleConfig(name="v1", sysid=1, streams={}),
            commands,
            runner,
            StreamRequester(self.vehicle, commands, dialect, {}),
            services(dialect, self.hub.send, loop, lambda event: None, log_dir=folder),
        )
        self.control_mode = way
        self.heard = 0
        self.positions = [
            self.voice.position(HOME[0] + 1e-6 * math.sin(i / 9), HOME[1], HOME[2] + 10, 10.0, heading=100 * i)
            for i in range(50)
        ]
        self.attitudes = [
            self.voice.say(mav.MAVLink_attitude_message(0, 0.001 * i, 0.02, 0.3, 0.1, 0.1, 0.1)) for i in range(50)
        ]

    async def begin(self) -> None:
        await self.link.open()
        beat = self.voice.beat(PX4, PX4_LOITER, armed=True, status=4)
        self.hub.on_frames(self.link.channels[0], [beat], self.loop.now)
        self.hear(0)
        pilot = self.offboard.controller
        pilot.engage(self.control_mode, Fence(Origin(*HOME)))
        self.offboard.clock.start()
        pilot.delay.on_pong(pilot.delay.ping(self.loop.now - 0.004), self.loop.now)
        pilot.entered()
        pilot.fly_to(GeodeticPosition(HOME[0] + 1e-5, HOME[1], HOME[2] + 12), None)
        self.cost_us()

    def hear(self, _: int) -> None:
        """Position and attitude; once a second the rest."""
        now = self.loop.now = self.loop.now + 0.02
        self.heard += 1
        self.vehicle.on_frame(self.positions[self.heard % 50], now)
        self.vehicle.on_frame(self.attitudes[self.heard % 50], now)
        if self.heard % 50 == 1:
            self.vehicle.on_frame(self.voice.beat(PX4, OFFBOARD, armed=True, status=4), now)
            self.vehicle.on_frame(self.voice.landed(2), now)
            self.vehicle.on_frame(self.voice.say(GPS), now)
            self.vehicle.on_frame(self.voice.say(BATTERY), now)
        delay = self.offboard.controller.delay
        if delay.due_ping(now - 0.5):  # nobody ticks
            delay.ping(now)
        for token in list(delay._sent):  # it answers each ping, as a vehicle does
            delay.on_pong(token, now)

    def tick(self, i: int) -> None:
        self.hear(i)
        self.loop.fire()

    def cost_us(self) -> float:
        """CPU of one tick. What the vehicle says is not counted."""
        cost = per_tick_us(self.tick) - per_tick_us(self.hear)
        self.loop.forget()
        pilot = self.offboard.controller
        assert (pilot.state, pilot.control_mode) == (OffboardState.FLYING, self.control_mode), pilot.reasons
        return cost


async def _nothing(*args: object, **kwargs: object) -> Any:
    return None


def per_tick_us(work: Callable[[int], object]) -> float:
    before = time.process_time_ns()
    for i in range(TICKS):
        work(i)
    return (time.process_time_ns() - before) / TICKS / 1000


def law_us() -> float:
    """CPU of the law alone."""
    config, memory, reference = ControlSettings().law(), Memory(), Reference((1.0, 2.0, 3.0), 0.3)
    estimates = [Estimate((0.01 * i, 2.1, 2.9), (0.1, -0.2, 0.05)) for i in range(50)]
    return per_tick_us(lambda i: step(config, memory, estimates[i % 50], reference, 0.02, following=True))


def test_control_tick_cost(tmp_path: Path) -> None:
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:  # the daemon's
        runner.run(_measure(tmp_path))


async def _measure(folder: Path) -> None:
    flown = {way: Flown(way) for way in CONTROL_MODES}
    whole = {way: Whole(way, folder) for way in CONTROL_MODES}
    for flight in (*flown.values(), *whole.values()):
        await flight.begin()
    rows: dict[str, list[float]] = {}
    for _ in range(ROUNDS):
        for way, flight in flown.items():
            rows.setdefault(f"{way} pilot", []).append(flight.cost_us(send=False))
            rows.setdefault(f"{way} sent", []).append(flight.cost_us(send=True))
            rows.setdefault(f"{way} whole", []).append(whole[way].cost_us())
        rows.setdefault("law alone", []).append(law_us())
    table = {name: {"us": round(statistics.median(v), 1), "min": round(min(v), 1)} for name, v in rows.items()}
    for flight in (*flown.values(), *whole.values()):
        await flight.link.close()
    for each in whole.values():
        each.peer.close()
    keep("control-tick", table)
    print()
    for name, row in table.items():
        print(f"  {name:16} {row['us']:7.1f} us  (least {row['min']})")
    ratio = table["attitude sent"]["us"] / table["law alone"]["us"]
    print(f"  attitude sent / law alone: {ratio:.2f}")
    assert ratio <= RATIO_LIMIT
