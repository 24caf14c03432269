"""A whole daemon in virtual time, and simulated vehicles in the air behind a link that can be slow or cut.

The vehicles do not live inside the daemon: they go on when it is cut off or has died. Everything the daemon sends is
kept with its time, and of every vehicle the simulator's truth ten times a second.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.transmit_queue import OwnMessage
from skygcs.daemon import Daemon
from skygcs.links.base import Channel
from skygcs.links.memory import MemoryLink
from skygcs.runtime.flight_notes import FILE
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.conditions import CALM, Conditions
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.quad import Quad
from skygcs.sim.vehicle import SimVehicle
from skygcs.sim.vehicle_group import SimFleet, make_vehicles
from skygcs.sim.vehicle_state import TICK_S
from support.called import call
from support.daemons import made_daemon, memory_link
from support.examples import is_deep
from support.pymav import PymavPeer
from support.sim_pilot import int_param

FIELD = LocalFrame(43.7806, -79.4653, 180.0)
"""Where the first vehicle stands and the world's origin is; the others stand 5 m apart to the east of it."""

SETPOINTS = frozenset({"SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"})

Vector = tuple[float, float, float]

SYSID_BYTE = 5
"""Of a MAVLink 2 frame, which is all that the simulated vehicles send."""

UNIX_S = 1_700_000_000.0
"""The wall clock at the beginning of virtual time."""

CONVERGED_S = 10.0
"""Vehicles that a test brings into the air have been switched on for so long: the estimators of both firmwares have
converged (7 s and a fifth more), and their home is on the ground."""

SPOOLED_UP_S = 10.0
"""Its motors have run for so long."""

ASKS_S = 2.0
"""The daemon has by then asked a new vehicle for what it wants to know of it."""

SEEN_S = 2.0
"""The daemon has by then heard that a vehicle that was put into the air flies: its heartbeats come once a second."""

KINDS = pytest.mark.parametrize("kind", [{"px4": 1}, {"px4": 0, "ardupilot": 1}], ids=["px4", "ardupilot"])
PAIRS = pytest.mark.parametrize("kind", [{"px4": 2}, {"px4": 0, "ardupilot": 2}], ids=["px4", "ardupilot"])
"""One vehicle, and two, of each firmware."""

HOLDING = frozenset({Px4Mode.LOITER, CopterMode.BRAKE, CopterMode.LOITER, CopterMode.GUIDED})
GOING_HOME = frozenset({Px4Mode.RTL, Px4Mode.LAND, CopterMode.RTL, CopterMode.LAND})


@dataclass(frozen=True, slots=True)
class Sent:
    """A message of the daemon's own as it left; ``state``: of the pilot of the vehicle it is for, at that moment."""

    at: float
    name: str
    sysid: int | None
    values: Mapping[str, Any]
    state: str | None


@dataclass(frozen=True, slots=True)
class Told:
    """An event of the daemon."""

    at: float
    kind: str
    vehicle: str | None
    text: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Truth:
    """One look into the simulator: east, north, up of the FIELD."""

    at: float
    pos_m: Vector
    vel_mps: Vector
    mode: int
    armed: bool
    landed: bool


class Ordering:
    """Gives orders to a daemon, which it calls as ``await self(method, **params)``."""

    async def __call__(self, method_name: str, /, **params: Any) -> Any:
        raise NotImplementedError

    async def outcome(self, name: str, targets: str = "v1", **params: Any) -> dict[str, Any]:
        """Give an order to one vehicle and return its outcome."""
        (outcome,) = (await self(name, targets=targets, **params))["outcomes"].values()
        return dict(outcome)

    async def done(self, name: str, targets: str = "v1", **params: Any) -> None:
        outcomes = (await self(name, targets=targets, **params))["outcomes"]
        assert all(o["ok"] for o in outcomes.values()), outcomes


@dataclass
class Flown(Ordering):
    """``gcs(method, **params)`` asks as a session does, without a socket: its waiting has no place in virtual time."""

    daemon: Daemon
    sims: list[SimVehicle]
    link: MemoryLink
    sent: list[Sent] = field(default_factory=list)
    told: list[Told] = field(default_factory=list)
    truth: dict[int, list[Truth]] = field(default_factory=dict)
    running: asyncio.Task[None] | None = None
    """The life of ``daemon``."""
    also: list[Callable[[bytes], None]] = field(default_factory=list)
    """Called with each frame of the vehicles beside the link: their further radios."""
    cut: bool = False
    """Nothing passes the link any more, in either direction: so a daemon looks that was killed."""

    deaf: bool = False
    """Nothing of ours reaches the vehicles; all that they send comes."""

    loses: frozenset[str] = frozenset()
    """Names of messages of ours that do not reach the vehicles."""

    uplink_delay_s: float = 0.0
    """What is sent from now on reaches the vehicles so much later; the order is kept."""

    muted: set[int] = field(default_factory=set)
    """System ids of vehicles of which nothing is heard; they still get what is sent to them."""

    def __post_init__(self) -> None:
        self._arrives = 0.0
        self._fleet = SimFleet(self.sims)
        self._uplink = FrameParser(self.sims[0].dialect)
        self.other = PymavPeer(250, 190)
        """Another ground station, whose frames reach the vehicles straight."""
        self._record()
        self.link.peer.on_bytes = self._to_vehicles
        self._listen()

    def _listen(self) -> None:
        self.daemon.event_log.subscribe(
            lambda e: self.told.append(Told(self.now, e["kind"], e["vehicle"], e["text"], e["data"] or {}))
        )

    # -- asking

    @property
    def now(self) -> float:
        return self.daemon.now()

    async def __call__(self, method_name: str, /, **params: Any) -> Any:
        self.daemon.operator_watchdog.on_client()
        return await call(self.daemon, method_name, **params)

    async def fly(self, mode: str, targets: str = "v1") -> None:
        """Control in this way, and no other."""
        outcomes = (await self("control.set", targets=targets, mode=mode))["outcomes"]
        assert all(o["ok"] and f"flown by {mode} setpoints" == o["message"] for o in outcomes.values()), outcomes

    async def step(self, *by_m: float, name: str = "v1") -> None:
        """A goto by so much from where it is."""
        here = self.actor(name).vehicle.enu_m()
        assert here is not None
        await self.done("vehicles.goto", targets=name, enu_m=[a + b for a, b in zip(here, by_m, strict=True)])

    async def in_mid_step(self, mode: str) -> Vector:
        """v1 flies 3 m east in this way, and has been at it for a second; where it began."""
        await self.fly(mode)
        start = self.place()
        await self.step(3.0, 0.0, 0.0)
        await asyncio.sleep(1.0)
        return start

    async def lands(self, *names: str) -> None:
        """Land where it is (v1, unless others are named), and see it disarmed."""
        flying = names or ("v1",)
        await self.done("vehicles.land", targets=",".join(flying))
        await self.until(lambda: not any(self.sim(name).armed for name in flying), 180.0)
        await asyncio.sleep(3.0)

    def actor(self, name: str = "v1") -> VehicleActor:
        return self.daemon.fleet.find(name)

    def control(self, name: str = "v1") -> dict[str, Any]:
        return self.actor(name).control_state(self.now)

    async def stopped(self, within_s: float) -> None:
        """SIGTERM: until the daemon has ended, which it must within so long."""
        assert self.running is not None
        began = self.now
        self.daemon.stop()
        await asyncio.wait({self.running}, timeout=60.0)
        assert self.running.done() and self.now - began <= within_s, self.now - began
        self.running.result()

    async def die(self, journal: Callable[[Path], None] = lambda path: None) -> None:
        """SIGKILL: nothing is sent or written after it. ``journal``: what becomes of the file of what flies."""
        self.cut = True
        path = self.daemon.config.daemon.log_dir / FILE
        kept = path.read_bytes() if path.exists() else None
        assert self.running is not None
        self.running.cancel()
        await asyncio.gather(self.running, return_exceptions=True)
        let_its_disk_finish(self.daemon)
        if kept is not None:
            path.write_bytes(kept)
        journal(path)

    async def begin_again(self) -> None:
        """Another daemon with the same fleet file and folder, on the same link."""
        self.daemon = Daemon(self.daemon.config, load_dialect(self.daemon.config.dialect))
        self._listen()
        self.running = asyncio.create_task(self.daemon.run(), name="the daemon that begins again")
        await self.daemon.ready.wait()
        link, before = self.daemon.links.link("air"), self.link
        assert isinstance(link, MemoryLink)
        link.peer.on_bytes = before.peer.on_bytes
        self.link = link
        self._record()
        self.cut = False

    async def until(self, condition: Callable[[], object], timeout_s: float = 30.0) -> float:
        """Wait for it; when it was."""
        end = self.now + timeout_s
        while not condition():
            assert self.now < end, "it never happened"
            await asyncio.sleep(0.02)
        return self.now

    # -- what was seen

    def sim(self, name: str = "v1") -> SimVehicle:
        return self.sims[int(name[1:]) - 1]

    def place(self, name: str = "v1") -> Vector:
        """In truth, now."""
        return self._look(self.sim(name)).pos_m

    def place_of_home(self, name: str = "v1") -> Vector:
        """Where it was put up: its own motion counts from there."""
        east, north = FIELD.to_local(self.sim(name).where.lat_deg, self.sim(name).where.lon_deg)
        return east, north, 0.0

    def setpoints(self, since: float, name: str = "v1") -> list[Sent]:
        sysid = int(name[1:])
        return [s for s in self.sent if s.at > since and s.name in SETPOINTS and s.sysid == sysid]

    def last_setpoint(self, name: str = "v1") -> float:
        return self.setpoints(-1.0, name)[-1].at

    @property
    def hold_commands(self) -> set[int]:
        """What the order to hold is made of: a PX4's pause (DO_REPOSITION), an ArduCopter's modes (DO_SET_MODE)."""
        return {192 if self.actor().vehicle.family == "px4" else 176}

    def commands(self, since: float, name: str = "v1") -> list[Sent]:
        """Orders that move a vehicle, sent since then; questions are none."""
        orders = (176, 20, 21, 22, 192, 400)
        return [
            s
            for s in self.sent
            if s.at > since
            and s.name in ("COMMAND_LONG", "COMMAND_INT")
            and s.sysid == int(name[1:])
            and s.values["command"] in orders
        ]

    def texts(self, since: float, kind: str = "control", name: str | None = "v1") -> list[str]:
        return [t.text for t in self.told if t.at >= since and t.kind == kind and t.vehicle == name]

    def farthest_m(self, since: float, name: str = "v1", of: Vector | None = None) -> float:
        """How far it went since then, from where it was then or from ``of``."""
        looks = [t for t in self.truth[int(name[1:])] if t.at >= since]
        start = looks[0].pos_m if of is None else of
        return max(math.dist(start, t.pos_m) for t in looks)

    def is_safe(self, name: str = "v1") -> bool:
        """On the ground and disarmed, going home by itself, or standing still in a mode that holds."""
        look = self._look(self.sim(name))
        if look.landed or look.mode in GOING_HOME:
            return True
        return look.mode in HOLDING and math.hypot(*look.vel_mps) < 0.3

    async def ends_safe(self, name: str = "v1", *, within_m: float, since: float, of: Vector | None = None) -> None:
        """Give it half a minute: safe in truth, still safe at the end, and never far; nothing is sent all the while."""
        quiet_since = self.now
        await self.until(lambda: self.is_safe(name))
        await asyncio.sleep(10)
        assert self.is_safe(name), self._look(self.sim(name))
        assert self.farthest_m(since, name, of) < within_m
        assert not self.setpoints(quiet_since, name), "setpoints after control ended"

    # -- the vehicles' side

    def by_other_station(self, message: Any) -> None:
        """Another ground station sends this to the vehicles, over a radio of its own."""
        for frame in self._uplink.feed_datagram(self.other.pack(message)):
            self._fleet.on_frame(frame, self.now)

    def other_sets_mode(self, main: int, sub: int = 0, sysid: int = 1) -> None:
        self.by_other_station(mav.MAVLink_command_long_message(sysid, 1, 176, 0, 1, main, sub, 0, 0, 0, 0))

    def to_vehicles(self, frame: Frame) -> None:
        """A frame reaches the vehicles, over whatever radio."""
        self._fleet.on_frame(frame, self.now)

    async def live(self) -> None:
        """The vehicles' own clock; to be run as a task."""
        due, looked = self.now, -1.0
        while True:
            frames = self._fleet.step(self.now)
            heard = frames if not self.muted else [raw for raw in frames if raw[SYSID_BYTE] not in self.muted]
            if heard and not self.cut:
                self.link.peer.send(b"".join(heard))
            for radio in self.also:
                for frame in frames:
                    radio(frame)
            if self.now - looked >= 0.1 - 1e-6:
                looked = self.now
                for sim in self.sims:
                    self.truth.setdefault(sim.sysid, []).append(self._look(sim))
            due += TICK_S
            await asyncio.sleep(max(0.0, due - self.now))

    def _to_vehicles(self, raw: bytes) -> None:
        if self.cut or self.deaf:
            return
        self._arrives = max(self._arrives, self.now + self.uplink_delay_s)
        if self._arrives > self.now:
            asyncio.get_running_loop().call_at(self._arrives, self._arrive, raw)
        else:
            self._arrive(raw)

    def _arrive(self, raw: bytes) -> None:
        for frame in self._uplink.feed_datagram(raw):
            if frame.info is None or frame.info.name not in self.loses:
                self._fleet.on_frame(frame, self.now)

    def _look(self, sim: SimVehicle) -> Truth:
        motion = sim.motion
        east, north = FIELD.to_local(*sim.where.to_geodetic(motion.east_m, motion.north_m))
        velocity = (motion.vel_e_mps, motion.vel_n_mps, motion.vel_u_mps)
        return Truth(self.now, (east, north, motion.up_m), velocity, sim.mode, sim.armed, motion.on_ground)

    def _record(self) -> None:
        hub = self.daemon.hub
        before, parser = hub.on_sent, FrameParser(self.daemon.dialect)

        def on_sent(channel: Channel, message: OwnMessage, raw: bytes) -> None:
            before(channel, message, raw)
            for frame in parser.feed_datagram(raw):
                values = frame.fields()
                sysid = values.get("target_system")
                actor = self.daemon.fleet.vehicles.get((sysid or 0) << 8 | 1)
                state = None if actor is None else actor.offboard.controller.state.value
                assert frame.info is not None
                self.sent.append(Sent(self.now, frame.info.name, sysid, values, state))

        hub.on_sent = on_sent  # type: ignore[method-assign]


def let_its_disk_finish(daemon: Daemon) -> None:
    """Wait for the thread that writes the files of a daemon that has ended. `DiskWriter.close` waits in virtual time,
    which goes on meanwhile."""
    writer = daemon.fleet.disk._thread
    writer.shutdown()
    if writer._thread is not None:
        writer._thread.join(30.0)
        assert not writer._thread.is_alive()


def put_up(sim: SimVehicle, height_m: float, now: float) -> None:
    """Armed, hovering, in the mode in which a take-off leaves it."""
    sim.arm(now)
    sim.armed_at = now - SPOOLED_UP_S
    if isinstance(sim.motion, Quad):
        sim.motion.place(0.0, 0.0, height_m)
    else:  # without forces: it is where it is put
        sim.motion.up_m = height_m
    sim.landed, sim.flown_since_arming = False, True
    sim.mode = Px4Mode.LOITER if sim.autopilot == mav.MAV_AUTOPILOT_PX4 else CopterMode.GUIDED
    sim.hold_here()


@contextlib.asynccontextmanager
async def flown(
    tmp_path: Path,
    *,
    px4: int = 1,
    ardupilot: int = 0,
    others: Mapping[str, int] | None = None,
    height_m: float = 10.0,
    delay_s: float = 0.0,
    control: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    conditions: Conditions = CALM,
    params: Mapping[str, float] | None = None,
    links: Mapping[str, Mapping[str, Any]] | None = None,
    tables: Mapping[str, Any] | None = None,
    takeoff: bool = True,
    in_air: bool = False,
    setpoints_end: bool = True,
    prepared: Callable[[FleetConfig], FleetConfig] = lambda config: config,
) -> AsyncIterator[Flown]:
    """Vehicles that hover at ``height_m`` in the mode a take-off leaves them in. ``control``, ``settings``: the tables
    defaults.control and daemon. ``delay_s``: of the link, each way. ``params`` of the vehicles: floats of a PX4,
    any of an ArduCopter, which is set up for attitude setpoints. PX4s come first: v1, v2, …; ``others``: how
    many of further kinds, as the fleet file names them. ``links``: further
    ones. ``tables``: further tables of the fleet file. ``takeoff``: without it they stand on the ground. ``in_air``:
    they were brought there by the test, without an order. ``setpoints_end``: see that none is sent after control has
    ended. ``prepared``: what the daemon runs of the fleet file. The wall clock goes with virtual time."""
    loop = asyncio.get_running_loop()
    with mock.patch("time.time", lambda: UNIX_S + loop.time()):
        own = {
            "daemon": settings or {},
            "origin": {"lat_deg": FIELD.lat_deg, "lon_deg": FIELD.lon_deg, "alt_amsl_m": FIELD.alt_amsl_m},
            "links": {"air": {"type": "memory", "role": "radio", "delay_s": delay_s}, **(links or {})},
            "defaults": {"control": dict(control or {})},
        }
        daemon = made_daemon(tmp_path, prepared=prepared, **{**own, **(tables or {})})
        before_s = CONVERGED_S if in_air else 0.0
        sims = make_vehicles(
            load_dialect("ardupilotmega"),
            px4=px4,
            ardupilot=ardupilot,
            **(others or {}),
            first_sysid=1,
            home=FIELD,
            now=daemon.now() - before_s,
            unix_us=1_700_000_000_000_000 - round(before_s * 1e6),
            conditions=conditions,
        )
        for sim in sims:
            sim.skip_to(daemon.now())
            if sim.autopilot == mav.MAV_AUTOPILOT_PX4:
                sim.params.set("COM_OBL_RC_ACT", int_param(5))  # as docs/explanation/flight-control.md asks for
            for name, value in {"GUID_OPTIONS": 8, "GUID_TIMEOUT": 1.0, **(params or {})}.items():
                sim.params.set(name, value)  # a firmware that has none of this name takes no notice
        async with alive(daemon, sims) as gcs:
            await asyncio.sleep(ASKS_S if in_air else 7.0)  # the estimators converge, and the daemon asks
            if in_air:
                for sim in sims:
                    put_up(sim, height_m, daemon.now())
            elif takeoff:
                await gcs.done("vehicles.takeoff", targets="all", height_m=height_m, wait_s=90.0)
                await gcs.until(lambda: all(abs(s.motion.up_m - height_m) < 0.5 for s in sims), 60.0)
            await asyncio.sleep(SEEN_S if in_air else 5.0)  # nothing moves any more
            yield gcs
            assert not setpoints_end or all(
                s.state in ("engaging", "flying") for s in gcs.sent if s.name in SETPOINTS
            ), "setpoints after the end"


@contextlib.asynccontextmanager
async def alive(daemon: Daemon, sims: list[SimVehicle]) -> AsyncIterator[Flown]:
    """The daemon runs, and has heard these vehicles behind its memory link "air". No fault of ours may be told."""
    running = asyncio.create_task(daemon.run(), name="the daemon")
    await daemon.ready.wait()
    gcs = Flown(daemon, sims, memory_link(daemon, "air"), running=running)
    living = asyncio.create_task(gcs.live())
    try:
        await gcs.until(lambda: len(daemon.fleet.vehicles) == len(sims))
        yield gcs
        assert not [t for t in gcs.told if t.kind == "fault"], gcs.told
    finally:
        living.cancel()
        await asyncio.gather(living, return_exceptions=True)
        gcs.daemon.stop()
        assert gcs.running is not None
        with contextlib.suppress(asyncio.CancelledError):
            await gcs.running


def aloft(tmp_path: Path, **options: Any) -> contextlib.AbstractAsyncContextManager[Flown]:
    """`flown` for tests of what happens in the air: in `make test` without the order to take off and its climb, a third
    of what such a flight costs; in `make test-deep` with them."""
    return flown(tmp_path, **{"in_air": not is_deep() and options.get("takeoff", True), **options})
