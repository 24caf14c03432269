"""A ground's daemon and a companion's daemon in virtual time: the vehicle is behind the companion, the ground's way to
both is as slow and lossy as a test sets it.

    Flown: vehicle ── air ── companion's daemon ── "wifi" (MAVLink) ── ground's daemon
                                    ^                                       │
                                    └──────── CallsByMemory (RPC) ──────────┘
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import random
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.clock_offset import ClockOffset
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.stream_rates import DEFAULT_RATES_HZ
from skygcs.core.radio_link.transmit_queue import OwnMessage
from skygcs.daemon import Daemon
from skygcs.errors import LinkError, RpcError, SkygcsError
from skygcs.ext.companions.companion_table import CompanionConfig
from skygcs.ext.companions.companions_table import CompanionsConfig
from skygcs.ext.companions.ground import Companions
from skygcs.ext.companions.ground_contact import GROUND_LINK
from skygcs.ext.companions.role import as_companion
from skygcs.links.base import Channel
from skygcs.links.memory import MemoryLink
from skygcs.rpc.dispatch import REFUSED
from support.called import call
from support.daemons import memory_link
from support.flown import FIELD, Flown, Ordering, Told, aloft, let_its_disk_finish


class CallsByMemory:
    """Calls another daemon in the same loop, as `CompanionLink` does; each message takes ``delay_s``, and some never
    come."""

    def __init__(self, daemon: Daemon, *, delay_s: float = 0.0, loss: float = 0.0, seed: int = 1) -> None:
        self.name = "pi"
        self.daemon = daemon
        self.delay_s = delay_s
        self.loss = loss
        self.up = True
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.served: list[asyncio.Task[Any]] = []
        self.lose: Callable[[str, dict[str, Any]], bool] = lambda method, params: False
        """Of calls that are lost on their way there."""
        self.lose_answer: Callable[[str, dict[str, Any]], bool] = lambda method, params: False
        self._random = random.Random(seed)

    @property
    def is_up(self) -> bool:
        return self.up

    def summary(self) -> dict[str, Any]:
        return {"link": "up" if self.up else "down", "since_s": 0.0, "error": None, "version": None}

    def clock(self) -> ClockOffset:
        return ClockOffset(0.0, 0.0, self.delay_s, 2 * self.delay_s, 0.0)

    async def call(self, method: str, params: dict[str, Any] | None = None, timeout_s: float = 5.0) -> Any:
        if not self.up:
            raise LinkError("companion pi is not connected")
        given = json.loads(json.dumps(params or {}))
        self.calls.append((method, given))
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self.served = [task for task in self.served if not task.done()]
        self.served.append(asyncio.create_task(self._serve(method, given, answer)))
        try:
            async with asyncio.timeout(timeout_s):
                return await answer
        except TimeoutError:
            raise LinkError(f"companion pi: no answer to {method} within {timeout_s:g} s") from None

    async def _serve(self, method: str, given: dict[str, Any], answer: asyncio.Future[Any]) -> None:
        await asyncio.sleep(self.delay_s)
        if not self.up or self._random.random() < self.loss or self.lose(method, given):
            return
        result: Any = None
        failed: Exception | None = None
        try:
            result = json.loads(json.dumps(await call(self.daemon, method, **given)))
        except SkygcsError as error:
            failed = RpcError(REFUSED, str(error))
        await asyncio.sleep(self.delay_s)
        if not self.up or self._random.random() < self.loss or self.lose_answer(method, given) or answer.done():
            return
        if failed is None:
            answer.set_result(result)
        else:
            answer.set_exception(failed)


@dataclass
class Pair(Ordering):
    """``pi`` is the companion and its vehicle; ``pair(method, …)`` asks the ground."""

    pi: Flown
    ground: Daemon
    calls: CallsByMemory
    ground_running: asyncio.Task[None]
    told: list[Told] = field(default_factory=list)
    """Events of the ground."""
    from_ground: list[str] = field(default_factory=list)
    """Names of the messages that the ground sent."""
    radio: bool = False
    """The ground has a radio to the vehicle."""
    to_vehicle: list[tuple[float, str]] = field(default_factory=list)
    """What came to the vehicle over the ground's radio, and when."""

    @property
    def now(self) -> float:
        return self.pi.now

    async def __call__(self, method_name: str, /, **params: Any) -> Any:
        return await call(self.ground, method_name, **params)

    def control(self) -> dict[str, Any]:
        """As the ground shows it."""
        return self.ground.fleet.find("v1").control_state(self.now)

    def texts(self, *kinds: str) -> list[str]:
        return [t.text for t in self.told if t.kind in kinds]

    async def until(self, condition: Callable[[], object], timeout_s: float = 30.0) -> float:
        return await self.pi.until(condition, timeout_s)

    async def lose_ground(self) -> None:
        """SIGKILL to the ground's daemon: nothing of it is sent or answered any more."""
        self.calls.up = False
        wifi = memory_link(self.ground, "wifi")
        wifi.peer.on_bytes = None
        self.ground_running.cancel()
        await asyncio.gather(self.ground_running, return_exceptions=True)

    async def ground_begins_again(self) -> None:
        """Another daemon of the ground, with the same file and folder."""
        before = self.ground
        for link in ("wifi", "radio"):
            kept = memory_link(before, link)
            kept.peer.on_bytes = None
        let_its_disk_finish(before)
        self.ground = Daemon(before.config, load_dialect(before.config.dialect))
        _join(self.ground, self.calls)
        self.ground_running = asyncio.create_task(self.ground.run(), name="the ground's daemon that begins again")
        await self.ground.ready.wait()
        self.connect()

    async def companion_begins_again(self) -> None:
        """Another daemon of the companion."""
        await self.pi.begin_again()
        self.calls.daemon = self.pi.daemon
        self.connect()

    def connect(self) -> None:
        """Join the daemons as they are now, and the radio to the vehicle."""
        self.ground.event_log.subscribe(
            lambda e: self.told.append(Told(self.now, e["kind"], e["vehicle"], e["text"], e["data"] or {}))
        )
        here, there = self.ground.links.link("wifi"), self.pi.daemon.links.link(GROUND_LINK)
        assert isinstance(here, MemoryLink) and isinstance(there, MemoryLink)
        here.peer.on_bytes = there.peer.send
        there.peer.on_bytes = here.peer.send
        if self.radio:
            _open_radio(self)

    async def lose_companion(self) -> None:
        """SIGKILL to the companion's daemon."""
        self.calls.up = False
        self.pi.cut = True
        assert self.pi.running is not None
        self.pi.running.cancel()
        await asyncio.gather(self.pi.running, return_exceptions=True)


Point = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""Position, velocity and acceleration across."""


def circle(t: float) -> Point:
    """5 m about the origin at 2 m/s."""
    r, w = 5.0, 0.4
    c, s = math.cos(w * t), math.sin(w * t)
    return (r * c, r * s), (-r * w * s, r * w * c), (-r * w * w * c, -r * w * w * s)


@contextlib.asynccontextmanager
async def companion_pair(
    tmp_path: Path,
    *,
    delay_s: float = 0.0,
    loss: float = 0.0,
    companion: Mapping[str, Any] | None = None,
    control: Mapping[str, Any] | None = None,
    ground_links: Mapping[str, Any] | None = None,
    engaged: str | None = None,
    radio: bool = False,
    streams: tuple[Mapping[str, float], Mapping[str, float]] = ({}, {}),
    **vehicle: Any,
) -> AsyncIterator[Pair]:
    """``delay_s``, ``loss``: of MAVLink and RPC between ground and companion, each way. ``engaged``: the control mode
    that the ground has ordered. ``radio``: the ground has another link "radio", straight to the vehicle. ``companion``:
    keys of [companion]. ``streams``: Hz of messages by the ground's file and by the companion's, beside their defaults.
    ``vehicle``: see `flown`."""
    tables = {"vehicles": {"v1": {"sysid": 1, "streams": {**DEFAULT_RATES_HZ, **streams[1]}}}}
    table = CompanionConfig.model_validate({"vehicle": "v1", "ground": "udp:127.0.0.1:9", **(companion or {})})

    def with_our_ground_link(config: FleetConfig) -> FleetConfig:
        """As the loader makes it of [companion], but with our link in place of that to the ground."""
        ours = config.links[GROUND_LINK]
        made = as_companion(table, config.model_copy(update={"extensions": {"companion": table}}))
        return made.model_copy(update={"links": {**made.links, GROUND_LINK: ours}})

    air = {"ground": {"type": "memory", "role": "gcs"}, "others": {"type": "memory", "role": "gcs"}}
    (tmp_path / "pi").mkdir()
    (tmp_path / "ground").mkdir()
    flying = {"control": control, "tables": tables, "links": air, "prepared": with_our_ground_link, **vehicle}
    async with aloft(tmp_path / "pi", **flying) as pi:
        config = _ground_config(tmp_path / "ground", delay_s, loss, control, ground_links, streams[0])
        ground = Daemon(config, load_dialect(config.dialect))
        calls = CallsByMemory(pi.daemon, delay_s=delay_s, loss=loss)
        _join(ground, calls)
        running = asyncio.create_task(ground.run(), name="the ground's daemon")
        await ground.ready.wait()
        pair = Pair(pi, ground, calls, running, radio=radio)
        pair.connect()
        before = ground.hub.on_sent

        def on_sent(channel: Channel, message: OwnMessage, raw: bytes) -> None:
            before(channel, message, raw)
            frames = FrameParser(ground.dialect).feed_datagram(raw)
            pair.from_ground.extend(frame.info.name for frame in frames if frame.info is not None)

        ground.hub.on_sent = on_sent  # type: ignore[method-assign]
        try:
            await pair.until(lambda: ground.fleet.vehicles)
            await asyncio.sleep(2 + 4 * delay_s)
            if engaged is not None:
                await pair.done("control.set", mode=engaged)
            yield pair
            faults = [t for t in pair.told if t.kind == "fault"]
            assert not faults, faults
        finally:
            for daemon, link in ((pair.ground, "wifi"), (pi.daemon, GROUND_LINK)):
                end = memory_link(daemon, link)
                end.peer.on_bytes = None
            pair.ground.stop()
            await asyncio.gather(pair.ground_running, return_exceptions=True)
            for task in calls.served:
                task.cancel()
            await asyncio.gather(*calls.served, return_exceptions=True)


def _join(ground: Daemon, calls: CallsByMemory) -> None:
    """Give the ground its connection to the companion."""
    companions: Companions = ground.extensions["companions"]  # type: ignore[assignment]
    companions.by_vehicle["v1"] = calls


def _open_radio(pair: Pair) -> None:
    """The vehicle's frames come to the ground and the ground's to the vehicle, beside the companion."""
    link = memory_link(pair.ground, "radio")
    parser = FrameParser(pair.pi.sims[0].dialect)

    def to_vehicle(raw: bytes) -> None:
        for frame in parser.feed_datagram(raw):
            if frame.info is not None:
                pair.to_vehicle.append((pair.now, frame.info.name))
            pair.pi.to_vehicles(frame)

    pair.pi.also[:] = [link.peer.send]
    link.peer.on_bytes = to_vehicle


def _ground_config(
    folder: Path,
    delay_s: float,
    loss: float,
    control: Mapping[str, Any] | None,
    links: Mapping[str, Any] | None,
    streams: Mapping[str, float],
) -> FleetConfig:
    origin = {"lat_deg": FIELD.lat_deg, "lon_deg": FIELD.lon_deg, "alt_amsl_m": FIELD.alt_amsl_m}
    wifi = {"type": "memory", "role": "vehicle", "delay_s": delay_s, "loss": loss, "seed": 5}
    config = FleetConfig.model_validate(
        {
            "daemon": {"socket": folder / "s", "log_dir": folder / "logs", "record": False},
            "origin": origin,
            "links": {"wifi": wifi, "radio": {"type": "memory", "role": "vehicle"}, **(links or {})},
            "vehicles": {
                "v1": {"sysid": 1, "control": {"at": "companion"}, "streams": {**DEFAULT_RATES_HZ, **streams}}
            },
            "defaults": {"control": dict(control or {})},
        }
    )
    return config.model_copy(update={"extensions": {"companions": CompanionsConfig()}})


async def start_circle(pair: Pair, seconds: int = 60) -> float:
    """Load ``seconds`` of the circle as pieces of 1 s, go to its begin, start. When it would have begun without its
    ramp: `circle` of the time since then is where it is."""
    await pair.done("vehicles.goto", enu_m=[5.0, 0.0, 10.0])
    await asyncio.sleep(12)
    (outcome,) = (await pair("trajectory.load", target="v1", pieces=circle_pieces(seconds), name="circle"))[
        "outcomes"
    ].values()
    assert outcome["ok"], outcome
    outcome = await pair.outcome("trajectory.start", after_s=2.0, force=True)
    assert outcome["ok"], outcome
    actor = pair.ground.fleet.find("v1")
    flight = actor.offboard.controller.flight
    assert flight is not None
    return flight.clock.begins_at_s + 0.5 / flight.clock.rate_limit_per_s


def circle_pieces(seconds: int) -> list[dict[str, Any]]:
    """Taylor polynomials of degree 9 of the circle: some µm from it at the end of each second."""
    r, w = 5.0, 0.4
    pieces = []
    for k in range(seconds):
        x, y = [], []
        for n in range(10):
            turn = w * k + n * math.pi / 2
            scale = r * w**n / math.factorial(n)
            x.append(scale * math.cos(turn))
            y.append(scale * math.sin(turn))
        pieces.append({"duration_s": 1.0, "x": x, "y": y, "up": [10.0]})
    return pieces
