"""Moving references, flown by a whole daemon in virtual time: the public RPC in, the simulator's truth out."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.results import in_virtual_time
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.conditions import Conditions
from support.flown import Flown, flown
from support.virtual_uvloop import VirtualUvloop

Vector = tuple[float, float, float]
Motion = tuple[Vector, Vector, Vector]
"""Position, velocity and acceleration."""

Path3 = Callable[[float], Motion]
"""Of the time since its begin, about where it begins."""

SPEED_MPS, RADIUS_M = 2.0, 5.0
STREAM_S = 0.05
"""From one `control.setpoint` of the client to the next."""

SETTLE_S = 20.0
"""Not judged: it begins at rest."""

FLIGHT_S = 65.0
"""Almost three rounds after that."""

WIND = Conditions(wind_enu_mps=(4.0, 3.0, 0.0), gust_mps=1.0)
"""5 m/s and gusts of 1 m/s in each horizontal axis."""

TIMESYNC = 111

WIDE = {"x_m": [-100, 100], "y_m": [-100, 100], "up_m": [0, 60]}
BEAR_ALL = {"attitude_delay_s": 1.0, "velocity_delay_s": 2.0, "stale_s": 1.9, "fence": WIDE}
"""The guard lets each mode fly, so that what it protects from can be seen."""


@dataclass(frozen=True, slots=True)
class Case:
    """One flight."""

    mode: str
    delay_s: float
    """There and back."""
    control: Mapping[str, Any]
    feed_forward: bool = True
    """The client streams velocities and accelerations as well."""
    autopilot: str = "px4"
    loss: float = 0.0
    delay_error: float = 0.0
    """Share of ``delay_s``, which the daemon measures, by which the true one is longer."""


@dataclass(frozen=True, slots=True)
class Tracked:
    """What came of it, against the reference at the same moment."""

    rms_m: float
    most_m: float
    control_mode: str | None
    """Flown at the end."""


def circle(t: float) -> Motion:
    """5 m about a point to the west, at 2 m/s."""
    w = SPEED_MPS / RADIUS_M
    c, s = math.cos(w * t), math.sin(w * t)
    v, a = SPEED_MPS, SPEED_MPS * w
    return (RADIUS_M * (c - 1.0), RADIUS_M * s, 0.0), (-v * s, v * c, 0.0), (-a * c, -a * s, 0.0)


def figure_of_eight(t: float) -> Motion:
    """12 m by 6 m, at most 2 m/s."""
    x, y = 6.0, 3.0
    w = SPEED_MPS / math.hypot(x, 2.0 * y)
    position = (x * math.sin(w * t), y * math.sin(2 * w * t), 0.0)
    velocity = (x * w * math.cos(w * t), 2 * y * w * math.cos(2 * w * t), 0.0)
    return position, velocity, (-x * w * w * math.sin(w * t), -4 * y * w * w * math.sin(2 * w * t), 0.0)


def rounded_square(t: float) -> Motion:
    """16 m a side at 2 m/s, its corners rounded with 4 m: there 1 m/s² begins and ends at once."""
    return _square(t, 16.0, 4.0)


def sharp_square(t: float) -> Motion:
    """12 m a side at 2 m/s, its corners rounded with 2.5 m: 1.6 m/s², of the 2.5 that an ArduCopter uses by default."""
    return _square(t, 12.0, 2.5)


def _square(t: float, side: float, radius: float) -> Motion:
    straight, corner = side - 2 * radius, radius * math.pi / 2
    quarter, way = divmod(SPEED_MPS * t, straight + corner)
    if way <= straight:
        along, across, course, turning = radius + way, 0.0, 0.0, 0.0
    else:
        course = (way - straight) / radius
        along, across = radius + straight + radius * math.sin(course), radius * (1.0 - math.cos(course))
        turning = SPEED_MPS**2 / radius
    position, velocity = (along, across), (SPEED_MPS * math.cos(course), SPEED_MPS * math.sin(course))
    acceleration = (-turning * math.sin(course), turning * math.cos(course))
    x, y = position
    for _ in range(int(quarter) % 4):  # a quarter turn about the square's middle
        x, y = side - y, x
        velocity, acceleration = (-velocity[1], velocity[0]), (-acceleration[1], acceleration[0])
    return (x - radius, y, 0.0), (*velocity, 0.0), (*acceleration, 0.0)


def track(case: Case, path: Path3) -> Tracked:
    """Fly the path and measure."""
    return in_virtual_time(lambda folder: _track(case, path, folder), VirtualUvloop)


async def _track(case: Case, path: Path3, folder: Path) -> Tracked:
    true_s = case.delay_s * (1.0 + case.delay_error)
    air = {"type": "memory", "role": "radio", "delay_s": min(case.delay_s, true_s) / 2}
    kind = {"px4": int(case.autopilot == "px4"), "ardupilot": int(case.autopilot == "ardupilot")}
    async with flown(folder, control=case.control, conditions=WIND, links={"air": air}, **kind) as gcs:
        if case.delay_error:
            _mislead(gcs, case.delay_s, true_s)
        await gcs.done("control.set", mode=case.mode)
        await asyncio.sleep(5.0)
        lose(gcs, case.loss)
        start, began = gcs.place(), gcs.now
        streaming = asyncio.create_task(stream(gcs, path, start, feed_forward=case.feed_forward))
        await asyncio.sleep(FLIGHT_S)
        streaming.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await streaming
        off = [
            math.dist(look.pos_m, _plus(start, path(look.at - began)[0]))
            for look in gcs.truth[1]
            if look.at - began >= SETTLE_S
        ]
        control_mode = gcs.control()["control_mode"]
        lose(gcs, 0.0)
        return Tracked(math.sqrt(sum(d * d for d in off) / len(off)), max(off), control_mode)


def _mislead(gcs: Flown, measured_s: float, true_s: float) -> None:
    """The daemon measures one round trip, and its states come with another: what is too early on the link waits."""
    peer, loop, parser = gcs.link.peer, asyncio.get_running_loop(), FrameParser(gcs.daemon.dialect)
    send = peer.send

    def send_late(data: bytes) -> None:
        for frame in parser.feed_datagram(data):
            extra_s = measured_s - true_s if frame.msgid == TIMESYNC else true_s - measured_s
            loop.call_later(max(0.0, extra_s), send, frame.raw)

    peer.send = send_late  # type: ignore[method-assign]


async def stream(gcs: Flown, path: Path3, start: Vector, *, feed_forward: bool = True, name: str = "v1") -> None:
    """As a program does it, until it is cancelled."""
    began = gcs.now
    n = 0
    while True:
        position, velocity, acceleration = path(gcs.now - began)
        given: dict[str, Any] = {"pos_enu_m": list(_plus(start, position))}
        if feed_forward:
            given |= {"vel_enu_mps": list(velocity), "acc_enu_mps2": list(acceleration)}
        await gcs("control.setpoint", targets=name, **given)
        n += 1
        await asyncio.sleep(max(0.0, began + n * STREAM_S - gcs.now))


def lose(gcs: Flown, share: float) -> None:
    """From now on so much of the packets gets lost, in each direction."""
    for network in (gcs.link.inward, gcs.link.outward):
        network._config = network._config.model_copy(update={"loss": share})


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
