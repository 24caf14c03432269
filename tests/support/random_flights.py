"""Random flights in virtual time: orders, denials, pilots, other programs, links and restarts, by one seed each.

A flight is two vehicles in the air in wind for half a minute, while a person, a client, another station and the link do
what `DEEDS` lists. `support.truth_monitor` judges it.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.core.mavlink.frame import Frame
from skygcs.errors import SkygcsError
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.vehicle import SimVehicle
from support.daemons import memory_link
from support.flown import Flown, flown
from support.truth_monitor import LOOK_S, Breach, TruthMonitor

FLIGHT_S = 25.0

HEARTBEAT_AT = slice(7, 10)
"""The message id in a MAVLink 2 frame; that of HEARTBEAT is 0."""

NAMES = ("v1", "v2")

KINDS = ({"px4": 2}, {"px4": 0, "ardupilot": 2}, {"px4": 1, "ardupilot": 1})


@dataclass
class Deeds:
    """What was done in a random flight, and what of it is still under way."""

    done: list[str] = field(init=False, default_factory=list)
    under_way: set[asyncio.Task[Any]] = field(init=False, default_factory=set)
    raised: list[BaseException] = field(init=False, default_factory=list)

    def start(self, work: Awaitable[Any]) -> asyncio.Task[Any]:
        """Let something go on beside the next deeds."""
        task = asyncio.ensure_future(quietly(work))
        self.under_way.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self.under_way.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.raised.append(error)

    def require_nothing_raised(self) -> None:
        """A deed that is no order at all tests nothing."""
        for error in self.raised:
            raise error


@dataclass
class RandomFlight(Deeds):
    """One flight of two vehicles."""

    seed: int
    rng: random.Random
    gcs: Flown
    monitor: TruthMonitor
    restarts: int = 0

    def order(self, method: str, **params: Any) -> asyncio.Task[Any]:
        """A person orders something; sometimes its client goes away meanwhile."""
        task = self.start(self.gcs(method, **params))
        if self.rng.random() < 0.1:
            asyncio.get_running_loop().call_later(self.rng.uniform(0.0, 1.0), task.cancel)
        return task

    def vehicle(self) -> str:
        return self.rng.choice(NAMES)

    def sim(self, name: str) -> SimVehicle:
        return self.gcs.sim(name)

    def is_px4(self, name: str) -> bool:
        return self.sim(name).autopilot == mav.MAV_AUTOPILOT_PX4


async def quietly(work: Awaitable[Any]) -> None:
    """Refusals are outcomes here; so is a daemon that has died."""
    with contextlib.suppress(SkygcsError, asyncio.CancelledError):
        await work


# -- deeds


async def engage(f: RandomFlight) -> None:
    mode = f.rng.choice(["position", "velocity", "attitude", "attitude", "attitude", "off"])
    f.order("control.set", targets=f.vehicle(), mode=mode)


async def stream(f: RandomFlight) -> None:
    """A client's setpoints, which end without a word."""

    async def send(name: str, seconds: float, rate_hz: float) -> None:
        vel = [f.rng.uniform(-2, 2), f.rng.uniform(-2, 2), 0.0]
        for _ in range(round(seconds * rate_hz)):
            await f.gcs("control.setpoint", targets=name, vel_enu_mps=vel, valid_s=f.rng.choice([0.2, 0.5, 2.0]))
            await asyncio.sleep(1 / rate_hz)

    f.start(send(f.vehicle(), f.rng.uniform(1, 6), f.rng.choice([5.0, 20.0])))


async def goto(f: RandomFlight) -> None:
    name = f.vehicle()
    x = 0.0 if name == "v1" else 5.0
    place = [x + f.rng.uniform(-1, 1), f.rng.uniform(-15, 15), f.rng.uniform(6, 14)]
    f.order("vehicles.goto", targets=name, enu_m=place, force=f.rng.random() < 0.3)


async def simple(f: RandomFlight) -> None:
    method = f.rng.choice(["vehicles.hold", "vehicles.hold", "vehicles.land", "vehicles.rtl", "vehicles.takeoff"])
    f.order(method, targets=f.rng.choice([*NAMES, "all"]))


async def stop(f: RandomFlight) -> None:
    f.order("vehicles.stop", targets=f.vehicle(), action="hold")


async def mode(f: RandomFlight) -> None:
    """Some are denied: there is no mission, no sticks."""
    name = f.vehicle()
    modes = ["AUTO.MISSION", "AUTO.LOITER", "OFFBOARD", "POSCTL"] if f.is_px4(name) else ["AUTO", "GUIDED", "BRAKE"]
    f.order("vehicles.mode", targets=name, mode=f.rng.choice(modes))


async def denied(f: RandomFlight) -> None:
    f.order("missions.start", targets=f.vehicle())


async def changes(f: RandomFlight) -> None:
    """What a flight stands on."""
    name = f.vehicle()
    origin = {"lat_deg": 43.7806, "lon_deg": -79.4653, "alt_amsl_m": 180.0, "x_heading_deg": 270.0}
    param = "COM_OF_LOSS_T" if f.is_px4(name) else "GUID_TIMEOUT"
    method, params = f.rng.choice(
        [
            ("origin.set", {**origin, "force": True}),
            ("params.set", {"targets": name, "params": {param: 30.0}, "force": True}),
            ("links.remove", {"name": "air"}),
            ("vehicles.set_home", {"targets": name, "force": True}),
            ("fence.set", {"targets": name, "radius_m": 10.0, "force": True}),
        ]
    )
    if any(actor.offboard.controller.active for actor in f.gcs.daemon.fleet.vehicles.values()):
        f.order(method, **params)  # otherwise they are granted


async def pilot(f: RandomFlight) -> None:
    """Another station's pilot takes one, and may give it back."""
    name = f.vehicle()
    sysid, sim = int(name[1:]), f.sim(name)

    async def fly() -> None:
        f.gcs.other_sets_mode(*((4, 3) if f.is_px4(name) else (int(CopterMode.LOITER), 0)), sysid=sysid)
        await asyncio.sleep(f.rng.uniform(0.3, 8.0))
        if not f.is_px4(name) and sim.mode == CopterMode.LOITER and f.rng.random() < 0.5:
            f.gcs.other_sets_mode(int(CopterMode.GUIDED), sysid=sysid)

    f.start(fly())


async def program(f: RandomFlight) -> None:
    """Another program's attitude, through the daemon; it dies."""
    name = f.vehicle()
    thrust = 0.71 if f.is_px4(name) else 0.37
    level = mav.MAVLink_set_attitude_target_message(0, int(name[1:]), 1, 7, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, thrust)

    async def send(seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            link = memory_link(f.gcs.daemon, "program")
            link.peer.send(f.gcs.other.pack(level))
            await asyncio.sleep(0.05)

    f.start(send(f.rng.uniform(0.5, 4.0)))


async def cut(f: RandomFlight) -> None:
    """The link: cut, deaf, mute, or slower."""
    gcs, seconds = f.gcs, f.rng.choice([0.4, 1.5, 4.0, 12.0])
    what = f.rng.choice(["cut", "deaf", "mute", "delay", "orders"])
    f.done[-1] += f" {what} {seconds}"
    match what:
        case "cut" | "deaf":
            setattr(gcs, what, True)
            await asyncio.sleep(seconds)
            setattr(gcs, what, False)
        case "mute":
            gcs.muted.add(1)
            await asyncio.sleep(seconds)
            gcs.muted.clear()
        case "orders":
            gcs.loses = frozenset({"COMMAND_LONG", "COMMAND_INT"})
            await asyncio.sleep(min(seconds, 4.0))
            gcs.loses = frozenset()
        case _:
            gcs.uplink_delay_s = f.rng.choice([0.0, 0.02, 0.05, 0.1])


async def restart(f: RandomFlight) -> None:
    """Killed, or stopped in order; the journal is as it was left."""
    gcs, away_s = f.gcs, f.rng.choice([0.3, 2.0, 6.0])
    if f.restarts >= 2:
        return
    f.restarts += 1
    f.done[-1] += f" {away_s}"
    if f.rng.random() < 0.7:
        f.monitor.daemon_died(gcs.now)
        await gcs.die()
    else:
        await gcs.stopped(12.0)
        gcs.cut = True
    for task in list(f.under_way):
        task.cancel()
    await asyncio.sleep(away_s)
    f.monitor.daemon_began()
    await gcs.begin_again()


DEEDS: tuple[tuple[Callable[[RandomFlight], Awaitable[None]], int], ...] = (
    (engage, 8),
    (stream, 3),
    (goto, 2),
    (simple, 3),
    (stop, 1),
    (mode, 3),
    (denied, 2),
    (changes, 2),
    (pilot, 2),
    (program, 2),
    (cut, 2),
    (restart, 2),
)


# -- the flight


@contextlib.asynccontextmanager
async def watched(gcs: Flown) -> AsyncIterator[TruthMonitor]:
    """The monitor, at every frame and LOOK_S."""
    monitor = TruthMonitor(
        gcs.sims,
        (255, 25),
        lambda sysid: not (gcs.cut or gcs.deaf or gcs.loses or sysid in gcs.muted),
        lambda: gcs.uplink_delay_s,
    )

    def heard(sysid: int) -> bool:
        return not gcs.cut and sysid not in gcs.muted

    looking = asyncio.create_task(watch(monitor, gcs, heard), name="the monitor")
    try:
        await asyncio.sleep(0)  # it sees what follows
        yield monitor
    finally:
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)


async def watch(monitor: TruthMonitor, gcs: Flown, heard: Callable[[int], bool]) -> None:
    """Show the monitor each frame and each moment. ``heard``: whether the daemon hears this vehicle's heartbeats."""
    fleet, on_frame, step = gcs._fleet, gcs._fleet.on_frame, gcs._fleet.step

    def arrives(frame: Frame, now: float) -> None:
        monitor.on_setpoint(frame, now)
        on_frame(frame, now)

    def steps(now: float) -> list[bytes]:
        frames = step(now)
        for raw in frames:
            if raw[HEARTBEAT_AT] == bytes(3) and heard(raw[5]):
                monitor.on_heartbeat(raw[5], now)
        return frames

    fleet.on_frame, fleet.step = arrives, steps  # type: ignore[method-assign]
    while True:
        monitor.look(gcs.now)
        await asyncio.sleep(LOOK_S)


@dataclass(frozen=True, slots=True)
class Judged:
    """What one flight showed."""

    seed: int
    breaches: tuple[Breach, ...]
    inside: tuple[str, ...]
    """Pairs that came inside their certified margin."""
    looked: int
    attended_again: int
    holds: int
    done: tuple[str, ...]
    accepted: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """By kind of order, how many of those that were asked for were accepted."""


async def fly_randomly(tmp_path: Path, seed: int) -> Judged:
    """One flight of this seed."""
    rng = random.Random(seed)
    kind, wind = rng.choice(KINDS), rng.uniform(0.0, 8.0)
    turn = rng.uniform(0.0, math.tau)
    conditions = conditions_of(wind_mps=wind, wind_from_deg=math.degrees(turn))
    links = {"program": {"type": "memory", "role": "gcs"}}
    async with (
        flown(tmp_path, conditions=conditions, links=links, in_air=True, setpoints_end=False, **kind) as gcs,
        watched(gcs) as monitor,
    ):
        flight = RandomFlight(seed, rng, gcs, monitor)
        began = gcs.now
        deeds, weights = zip(*DEEDS, strict=True)
        await asyncio.sleep(rng.uniform(0.0, 2.0))
        for name in NAMES:
            flight.order("control.set", targets=name, mode=rng.choice(["attitude", "velocity", "position"]))
        while gcs.now < began + FLIGHT_S:
            await asyncio.sleep(rng.choice([0.05, 0.5, 1.0, 2.0, 3.0]))
            (deed,) = rng.choices(deeds, weights)
            flight.done.append(f"{gcs.now:.2f} {deed.__name__}")
            await deed(flight)
        gcs.cut = gcs.deaf = False
        gcs.muted.clear()
        gcs.loses = frozenset()
        await asyncio.sleep(6.0)
        for task in list(flight.under_way):
            task.cancel()
        await asyncio.sleep(4.0)
        monitor.look(gcs.now)
        flight.require_nothing_raised()
        holds = sum(t.kind == "unattended" for t in gcs.told)
        return Judged(
            seed, tuple(monitor.breaches), (), monitor.looked, monitor.attended_again, holds, tuple(flight.done)
        )
