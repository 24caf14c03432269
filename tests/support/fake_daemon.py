"""A daemon without links: what the RPC methods need, under the test's control.

As a process, for the command line: python -m support.fake_daemon SOCKET [NUMBER_OF_VEHICLES]
"""

from __future__ import annotations

import asyncio
import inspect
import json
import math
import sys
import tempfile
import time
from collections import deque
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from skygcs.config.control import ControlSettings
from skygcs.config.dialects import load_dialect
from skygcs.config.vehicle_tables import SeparationSettings
from skygcs.core.alarms import VehicleFacts, event_record
from skygcs.core.geo import Origin
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.vehicle.orders import require_confirmed
from skygcs.core.vehicle.tracking_record import TrackingRecord
from skygcs.errors import ConfigError, LinkError, RefusedError, TargetError
from skygcs.events import Event
from skygcs.ext.corrections.methods import Corrections
from skygcs.ext.messages.methods import MessageSending
from skygcs.ext.plans.flight.guidance import choose
from skygcs.ext.plans.flight_check import ChosenWay
from skygcs.ext.plans.methods import METHODS as PLAN_METHODS
from skygcs.ext.plans.planning.planning_queue import PlanningQueue
from skygcs.ext.plans.planning.process import OnProgress, ProcessLimits
from skygcs.ext.plans.planning.worker import answered
from skygcs.ext.preflight.methods import PreflightChecks
from skygcs.extension import Extension, Extensions, NoTable
from skygcs.rpc.context import Services
from skygcs.rpc.dispatch import Method
from skygcs.rpc.server import RpcServer
from skygcs.runtime.fleet_orders import Order, Reports, Unreported

NAMES = ("alpha", "bravo", "carol")


@cache
def common_dialect() -> Dialect:
    """Read once for all fake daemons; cached in the temporary directory, not in the user's cache."""
    return load_dialect("common", cache_dir=Path(tempfile.gettempdir()) / "skygcs-test-dialects")


@dataclass(frozen=True)
class FakeOutcome:
    ok: bool
    result: str
    message: str
    attempts: int = 1
    elapsed_s: float = 0.1
    status_texts: tuple[str, ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict)
    """Further keys of `as_dict`."""

    def as_dict(self) -> dict[str, Any]:
        fields = asdict(self)
        return {**fields, **fields.pop("more")}


class FakeMissions:
    """What one vehicle tells of its mission; a test sets ``told``."""

    def __init__(self) -> None:
        nothing = dict.fromkeys(("mission", "fence", "rally"))
        self.told: dict[str, Any] = {
            **dict.fromkeys(("item", "reached", "state", "transfer")),
            "counts": dict(nothing),
            "opaque_ids": dict(nothing),
        }
        self.fetch: Callable[[Collection[MissionType]], Awaitable[tuple[FakeOutcome, MissionPlan]]] | None = None

    def status(self) -> dict[str, Any]:
        return dict(self.told)


class FakeVehicle:
    """Accepts every order unless told otherwise, and remembers them in ``orders``."""

    def __init__(self, sysid: int, name: str, autopilot: str, groups: tuple[str, ...]) -> None:
        self.sysid, self.compid, self.name, self.autopilot, self.groups = sysid, 1, name, autopilot, groups
        self.params: Any = None
        self.parts: dict[type, Any] = {}
        self.missions = FakeMissions()
        self.missions.fetch = self._fetched
        self.outcomes = SimpleNamespace(finish=lambda order, outcome: outcome)
        self.stored_plan = MissionPlan()
        self.fence: dict[str, Any] = {
            "enabled": True,
            "action": "return",
            "radius_m": 50.0,
            "height_m": None,
            "follows_list": True,
            "breached": None,
            "breaches": None,
            "from_home_m": 1.25,
            "last_text": None,
        }
        self.orders: list[tuple[str, dict[str, Any]]] = []
        self.cancelled = 0
        self.finished: list[str] = []
        self.states_made = 0
        self.connected = True
        self.duplicate = False
        self.replayed = False
        self.armed = False
        self.mode = "AUTO.LOITER" if autopilot == "px4" else "LOITER"
        self.outcome = FakeOutcome(True, "accepted", "accepted")
        self.delay_s = 0.0
        self.fails: Exception | None = None
        self.state_fails: Exception | None = None
        self.config = SimpleNamespace(separation=SeparationSettings(), control=ControlSettings())
        clock = SimpleNamespace(ticks=0, lateness_p99_s=lambda: None)
        self.offboard = SimpleNamespace(tracking=TrackingRecord(), clock=clock)

    def part(self, kind: type) -> Any:
        return self.parts[kind]

    async def given(self, order: str, **arguments: Any) -> FakeOutcome:
        """The outcome of an order by its name: by a method of this name, where it has one."""
        own: Callable[..., Awaitable[FakeOutcome]] | None = getattr(self, order, None)
        return await (self._order(order, **arguments) if own is None else own(**arguments))

    async def _order(self, order: str, **arguments: Any) -> FakeOutcome:
        self.orders.append((order, arguments))
        try:
            await asyncio.sleep(self.delay_s)
        except asyncio.CancelledError:
            self.cancelled += 1
            raise
        if self.fails is not None:
            raise self.fails
        self.finished.append(order)
        if self.outcome.ok and order in ("arm", "disarm"):
            self.armed = order == "arm"
        return self.outcome

    async def set_mode(self, name: str, *, force: bool) -> FakeOutcome:
        if name == "NONSENSE":
            return FakeOutcome(False, "refused", f"refused: {self.autopilot} has no mode NONSENSE", attempts=0)
        self.mode = name
        return await self._order("set_mode", name=name, force=force)

    async def hold(self, *, instead_of: int | None = None) -> FakeOutcome:
        return await self._order("hold", **({} if instead_of is None else {"instead_of": instead_of}))

    async def set_fence(self, **arguments: Any) -> FakeOutcome:
        return self._fenced(await self._order("set_fence", **arguments))

    async def read_fence(self) -> FakeOutcome:
        return self._fenced(await self._order("read_fence"))

    async def test_fence(self, **arguments: Any) -> FakeOutcome:
        outcome = self._fenced(await self._order("test_fence", **arguments))
        return replace(outcome, more={**outcome.more, "record": {"file": "logs/fence-test-alpha.json"}})

    def _fenced(self, outcome: FakeOutcome) -> FakeOutcome:
        return replace(outcome, more={"fence": self.fence if outcome.ok else None, "record": None})

    def authority_refusal(self) -> str | None:
        return None

    async def _fetched(self, kinds: Collection[MissionType]) -> tuple[FakeOutcome, MissionPlan]:
        return await self._order("download_plan", kinds=kinds), self.stored_plan

    def latest(self, message_name: str) -> dict[str, Any] | None:
        if message_name != "ATTITUDE":
            return None
        return {
            "name": "ATTITUDE",
            "sysid": self.sysid,
            "compid": self.compid,
            "fields": {"roll": math.nan, "pitch": 0.1, "yaw": 1.5},
            "age_s": 0.2,
            "rate_hz": 4.0,
            "count": 7,
        }

    def state(self, now: float, names: frozenset[str] | None = None) -> dict[str, Any]:
        state = self.whole_state(now)
        return state if names is None else {key: value for key, value in state.items() if key in names}

    def whole_state(self, now: float) -> dict[str, Any]:
        self.states_made += 1
        if self.state_fails is not None:
            raise self.state_fails
        swing = math.sin(now + self.sysid)
        known = self.connected
        return {
            "name": self.name,
            "sysid": self.sysid,
            "compid": self.compid,
            "autopilot": self.autopilot,
            "type": "QUADROTOR",
            "firmware": "1.14.3" if self.autopilot == "px4" else "4.5.1",
            "groups": list(self.groups),
            "gcs_sysid": None,
            "connected": known,
            "duplicate_sysid": self.duplicate,
            "replayed": self.replayed,
            "last_heartbeat_age_s": 0.4 if known else 73.0,
            "uptime_s": 321.0,
            "clock_offset_s": None,
            "armed": self.armed,
            "mode": self.mode,
            "system_status": "ACTIVE" if self.armed else "STANDBY",
            "landed": "in_air" if self.armed else "on_ground",
            "failsafe": False,
            "gps": {
                "fix": "3D",
                "fix_type": 3,
                "satellites": 11,
                "hdop": 0.8,
                "vdop": math.nan,
                "lat_deg": 43.7806,
                "lon_deg": -79.4653,
                "alt_amsl_m": 180.0,
                "time_usec": 1,
                "age_s": 0.2,
            },
            "position": {
                "lat_deg": 43.7806 + swing * 1e-4,
                "lon_deg": -79.4653,
                "alt_amsl_m": 182.5,
                "alt_rel_m": 2.5 + swing,
                "heading_deg": 90.0,
                "vel_enu_mps": [0.1, swing, 0.0],
                "time_boot_s": 1.0,
                "age_s": 0.1,
                **dict.fromkeys(("takeoff_alt_amsl_m", "alt_takeoff_m", "enu_m", "vel_world_mps", "yaw_world_deg")),
                "origin_generation": None,
            },
            "local": {"pos_enu_m": [1.0, 2.0, 3.0], "vel_enu_mps": [0.0, 0.0, 0.0], "age_s": 0.1},
            "attitude": {
                "roll_deg": swing,
                "pitch_deg": -0.5,
                "yaw_deg": 90.0,
                "rates_dps": [0.0, 0.0, 0.0],
                "quaternion": [1.0, 0.0, 0.0, 0.0],
                "time_boot_s": 1.0,
                "age_s": 0.1,
            },
            "battery": {"volts": 15.8, "amps": 1.2, "percent": 23 if self.sysid == 3 else 87, "age_s": 0.5}
            | dict.fromkeys(("consumed_mah", "temperature_degc", "remaining_s")),
            "home": None,
            "estimator": {"flags": 831, "ok": True, "names": ["ATTITUDE"], "age_s": 0.5},
            "sensors": {"present": ["3D_GYRO"], "enabled": ["3D_GYRO"], "health": ["3D_GYRO"], "age_s": 0.5},
            "vfr": None,
            "rc": None,
            "imu": None,
            "status_texts": [
                {
                    "severity": "warning",
                    "level": 4,
                    "text": "PreArm: Throttle too high" if self.sysid == 3 else "Ready",
                    "compid": self.compid,
                    "age_s": 12.0,
                }
            ],
            "components": [],
            "messages": {"HEARTBEAT": {"rate_hz": 1.0, "age_s": 0.4, "count": 321}},
            "links": {},
            "authority": None,
            "control": None,
            "uplink": None,
            "separation": None,
            "calibration": None,
            "companion": None,
            **dict.fromkeys(
                (
                    "ekf_origin",
                    "servos",
                    "mission",
                    "target_global",
                    "target_local",
                    "target_attitude",
                    "time",
                    "high_latency",
                    "last_ack",
                )
            ),
        }


class FakeMonitor:
    """Answers what a test puts into ``answer``; by sysid << 8 | compid ``conflicts`` of vehicles."""

    def __init__(self) -> None:
        self.conflicts: dict[int, dict[str, Any]] = {}
        self.answer: dict[str, Any] = {
            "mode": "advisory",
            "horizon_s": 10.0,
            "watched": 3,
            "flying": 2,
            "unwatched": [],
            "conflicts": [],
            "counters": dict.fromkeys(
                (
                    *("evaluations", "pairs_checked", "pairs_dropped", "notices", "warnings", "actions", "holds"),
                    *("holds_failed", "orders_checked", "orders_refused"),
                ),
                0,
            ),
            "took_s": 0.0,
            "longest_turn_s": 0.0,
        }

    def of(self, key: int) -> dict[str, Any] | None:
        return self.conflicts.get(key)

    def status(self) -> dict[str, Any]:
        return self.answer


class FakePlans:
    """No plan is flown."""

    moving = False

    def __init__(self) -> None:
        self.observers: set[Callable[[], None]] = set()

    def status(self) -> dict[str, Any]:
        return {"state": "none"}

    @property
    def runner(self) -> FakePlans:
        return self

    def pause(self) -> str:
        return "nothing is flown"

    abort = pause

    def chosen_way(self, actors: Sequence[FakeVehicle], control_mode: str, by: str, *, timed: bool) -> ChosenWay:
        """Every link carries setpoints, and there are no companions."""
        choice = choose(by, timed=timed, own_companion={v.name: False for v in actors}, not_streamed={})
        return ChosenWay(choice, [])

    def land(self, *, force: bool = False) -> str:
        return "nothing is flown"


class FakePlanning(Extension[NoTable]):
    """The extension of plans, with the fleet's `FakePlans`."""

    def methods(self) -> tuple[Method[Any], ...]:
        return PLAN_METHODS

    @property
    def runner(self) -> FakePlans:
        return cast("FakePlans", self.core.fleet.plans)

    @cached_property
    def queue(self) -> PlanningQueue:
        return PlanningQueue(asyncio.get_running_loop(), compute_here)


class FakeChecks(PreflightChecks):
    """Preflight of the `FakeFleet`; a test sets its findings."""

    async def examine(self, targets: Any, **how: Any) -> dict[str, Any]:
        fleet = cast("FakeFleet", self.core.fleet)
        return await fleet.preflight(targets, **how)

    def status(self, targets: Any) -> dict[str, Any]:
        return {vehicle.name: {"state": "never"} for vehicle in self.core.fleet.resolve(targets)}


class FakeSending(MessageSending):
    """messages.send; what was sent is in ``sent`` of the `FakeDaemon`."""

    def __init__(self, core: Any, config: NoTable) -> None:
        super().__init__(SimpleNamespace(hub=None, fleet=None, links=None, now=core.now), config)  # type: ignore[arg-type]
        self.sender = SimpleNamespace(send=core._send)  # type: ignore[assignment]


class FakeFeed(Corrections):
    """corrections.*, on the `FakeCorrections` of the `FakeDaemon`."""

    def __init__(self, core: Any, config: NoTable) -> None:
        super().__init__(SimpleNamespace(hub=SimpleNamespace(dialect=core.dialect), fleet=None, now=core.now), config)  # type: ignore[arg-type]
        self.feed = core.corrections


class Awake:
    """A process that never stands still."""

    def check(self) -> bool:
        return False


class FakeFleet:
    """``resolve`` as the real one for sysids, names, groups, lists and ranges."""

    control_tick_at = math.inf

    def next_control_tick(self) -> float:
        return self.control_tick_at

    def __init__(self, vehicles: Sequence[FakeVehicle]) -> None:
        self.vehicles = {v.sysid << 8 | v.compid: v for v in vehicles}
        self.monitor = FakeMonitor()
        self.plans = FakePlans()
        self.on_ending: list[Any] = []
        self.journal = self.disk = None
        self.origin: Origin | None = None
        self.generation = 0
        self.origin_asked: list[tuple[Any, ...]] = []
        self.preflight_asked: list[tuple[bool, Any]] = []
        self.preflight_told: dict[str, dict[str, Any]] = {}
        self.sleep = Awake()

    def companion_of(self, _: FakeVehicle) -> None:
        return None

    def origin_status(self) -> dict[str, Any]:
        return {"origin": None if self.origin is None else asdict(self.origin), "generation": self.generation}

    def set_origin(self, origin: Origin | None, *, force: bool = False) -> None:
        if origin is not None and origin.lat_deg == 0:
            raise RefusedError("0, 0 has a zero coordinate")
        self.origin = origin
        self.generation += 1
        self.origin_asked.append(("set", force))

    def set_origin_from(self, target: str, *, heading: bool = False, force: bool = False) -> None:
        (vehicle,) = self.resolve(target)
        self.set_origin(Origin(43.5, -79.5, 100.0 + vehicle.sysid))
        self.origin_asked.append(("from", vehicle.name, heading, force))

    async def push_origin(
        self, targets: str | list[str], *, home: bool = False, force: bool = False, reports: Reports | None = None
    ) -> dict[str, FakeOutcome]:
        self.origin_asked.append(("push", home, force))
        return {vehicle.name: vehicle.outcome for vehicle in self.resolve(targets)}

    async def preflight(
        self, targets: str | list[str], *, fix: bool, confirmed: Mapping[str, Mapping[str, float]] | None
    ) -> dict[str, Any]:
        self.preflight_asked.append((fix, confirmed))
        return {vehicle.name: self.preflight_told[vehicle.name] for vehicle in self.resolve(targets)}

    def forget(self, targets: str | list[str], *, force: bool = False) -> dict[str, FakeOutcome]:
        there = self.resolve(targets)
        gone = {v.name: FakeOutcome(force or not v.connected, "accepted", f"{v.name} is forgotten", 0) for v in there}
        self.vehicles = {k: v for k, v in self.vehicles.items() if v.name not in gone or not gone[v.name].ok}
        return gone

    def resolve_any(self, targets: str | list[str]) -> list[FakeVehicle]:
        return self.resolve(targets)

    def sources(self, targets: str | list[str]) -> set[int]:
        return {vehicle.sysid << 8 | vehicle.compid for vehicle in self.resolve(targets)}

    def names_of(self, sysid: int, compid: int) -> tuple[str | None, str]:
        vehicle = self.vehicles.get(sysid << 8 | compid)
        return (None, f"{sysid}/{compid}") if vehicle is None else (vehicle.name, vehicle.name)

    def latest(self, target: str, message: str) -> dict[str, Any] | None:
        found = self.resolve(target)
        if len(found) != 1:
            raise TargetError(f"{target} names {len(found)} vehicles ({', '.join(v.name for v in found)}); give one")
        return found[0].latest(message)

    def components_status(self) -> list[dict[str, Any]]:
        companion = {"compid": 191, "name": "ONBOARD_COMPUTER", "type": "ONBOARD_CONTROLLER", "autopilot": False}
        more = {"age_s": 0.3, "messages": 42}
        return [{"sysid": 1, "vehicle": "alpha", **companion, **more}]

    def resolve(self, targets: str | list[str]) -> list[FakeVehicle]:
        parts = targets if isinstance(targets, list) else targets.split(",")
        found: dict[int, FakeVehicle] = {}
        for part in parts:
            matching = [v for v in self.vehicles.values() if self._matches(v, str(part).strip())]
            if not matching:
                raise TargetError(
                    f"no vehicle {part!r}; there are: {', '.join(v.name for v in self.vehicles.values())}"
                )
            found.update({v.sysid: v for v in matching})
        return list(found.values())

    @property
    def orders(self) -> FakeFleet:
        return self

    async def command_all(
        self,
        targets: str | list[str],
        order: Order,
        /,
        *,
        reports: Reports | None = None,
        shaped: object = None,
        each: object = None,
        moves: bool = True,
        **arguments: Any,
    ) -> dict[str, FakeOutcome]:
        vehicles, name = self.resolve(targets), order.__name__
        inspect.signature(order).bind(None, **{k: v for k, v in arguments.items() if k != "confirm"})
        if name == "disarm":
            arguments.pop("confirm", None)
        if name == "stop":
            require_confirmed(arguments["action"], dict.fromkeys(v.name for v in vehicles), arguments.pop("confirm"))
        reports = reports or Unreported()
        reports.begun([v.name for v in vehicles])

        async def reported(vehicle: FakeVehicle) -> FakeOutcome:
            outcome = await vehicle.given(name, **arguments)
            reports.ended(vehicle.name, outcome)
            return outcome

        done = await asyncio.gather(*map(reported, vehicles))
        return dict(zip((v.name for v in vehicles), done, strict=True))

    @staticmethod
    def _matches(vehicle: FakeVehicle, part: str) -> bool:
        first, _, last = part.partition("-")
        if first.isdigit() and last.isdigit():
            return int(first) <= vehicle.sysid <= int(last)
        return part in ("all", vehicle.name, str(vehicle.sysid), *vehicle.groups)


class FakeLinks(dict[str, dict[str, Any]]):
    """The links by name, and their configurations."""

    async def add(self, name: str, link: dict[str, Any]) -> None:
        if name in self:
            raise LinkError(f"there is a link {name} already")
        if "type" not in link:
            raise ConfigError(f"links.{name}", [f"links.{name}.type: is missing", f"links.{name}.port: is missing"])
        self[name] = link

    async def change(self, name: str, link: dict[str, Any]) -> None:
        await self.remove(name)
        await self.add(name, link)

    async def remove(self, name: str) -> None:
        if name not in self:
            raise LinkError(f"no link {name}; there are: {', '.join(self)}")
        del self[name]


class FakeCorrections(list[tuple[str, bytes, bool]]):
    """What was sent; a test sets what is answered."""

    def __init__(self) -> None:
        super().__init__()
        self.fails: Exception | None = None
        self.answer: dict[str, Any] = {}
        self.told: dict[str, Any] = {}

    def send(self, source: str, data: bytes, *, end: bool = False) -> dict[str, Any]:
        if self.fails is not None:
            raise self.fails
        self.append((source, data, end))
        return dict(self.answer)

    def status(self) -> dict[str, Any]:
        return dict(self.told)


async def compute_here(request: bytes, on_progress: OnProgress | None, limits: ProcessLimits) -> bytes:
    """In place of a planning process."""
    if on_progress is not None:
        on_progress({"what": "certify", "done": 1, "total": 1})
    return json.dumps(answered(json.loads(request), lambda *_: None)).encode()


def _raised(error: Exception) -> None:
    raise error


class FakeDaemon:
    """Everything `skygcs.rpc.context.Services` asks for."""

    def __init__(self, vehicle_count: int = 3) -> None:
        self.requests_seen = 0
        self.dialect = common_dialect()
        self.fleet = FakeFleet(
            [
                FakeVehicle(
                    i, NAMES[i - 1] if i <= 3 else f"v{i}", "ardupilot" if i % 3 == 0 else "px4", ("red",) * (i % 2)
                )
                for i in range(1, vehicle_count + 1)
            ]
        )
        self.events: deque[dict[str, Any]] = deque(maxlen=1000)
        self.sent: list[tuple[str, dict[str, Any], str | None, str | None]] = []
        self.links = FakeLinks(radio={"type": "serial", "device": "/dev/ttyUSB0"})
        self.link_states: dict[str, dict[str, Any]] = {}
        self.corrections = FakeCorrections()
        counted = {"frames": 100, "bytes": 4000, "lost": 1, "frames_per_s": 20.0, "age_s": 0.1}
        quality = {"radio": {"loss_ratio": 0.013, "bytes_per_s": 812.0, **counted}}
        self.hub = SimpleNamespace(
            observers=SimpleNamespace(add=self._add_observer),
            statistics=SimpleNamespace(link_quality=lambda key: quality, router_stats=self._router_stats),
            send_gates=None,
        )
        self.links.status = self._links_status  # type: ignore[attr-defined]
        services = cast("Services", self)
        self.extensions = Extensions(
            {
                "plan": FakePlanning(services, NoTable()),
                "preflight": FakeChecks(services, NoTable()),
                "messages.send": FakeSending(services, NoTable()),
                "corrections": FakeFeed(services, NoTable()),
            },
            _raised,
            services,
        )
        self.event_log = SimpleNamespace(recent=self.events, publish=self.on_event, subscribe=self.subscribe_events)
        self.operator_watchdog = SimpleNamespace(on_client=self._on_client)
        self.signing = SimpleNamespace(status=lambda channels: {"keys": [], "links": []})
        self.recorder = SimpleNamespace(status=lambda: {"recording": True, "file": "logs/a.tlog", "dropped": 0})
        self.air = SimpleNamespace(status=lambda now: [], select=lambda keys: None)
        self._on_event: list[Callable[[Mapping[str, Any]], None]] = []
        self._on_frame: list[tuple[set[int] | None, set[int] | None, Callable[[Frame, Any, float], None]]] = []
        self.emit("vehicle_discovered", "alpha", "alpha (1) discovered on radio")

    def vehicle(self, name: str) -> FakeVehicle:
        return self.fleet.resolve(name)[0]

    def _on_client(self) -> None:
        self.requests_seen += 1

    def now(self) -> float:
        return time.monotonic()

    stopping = False

    def info(self) -> dict[str, Any]:
        return {"version": "0.1.0", "pid": 1, "uptime_s": 12.5, "sysid": 255, "compid": 25, "dialect": "common"}

    def _links_status(self) -> list[dict[str, Any]]:
        return [
            {
                "name": name,
                "type": link["type"],
                "role": "peer",
                "state": "up",
                "since_s": 42.0,
                "last_error": None,
                **self.link_states.get(name, {}),
                "channels": [
                    {
                        "peer": link.get("device", "127.0.0.1:14550"),
                        "rx_frames": 1200,
                        "rx_bytes": 48000,
                        "tx_frames": 30,
                        "tx_bytes": 900,
                        "tx_dropped": 0,
                        "good": 1200,
                        "bad_crc": 3,
                        "unknown": 1,
                        "skipped_bytes": 57,
                        "sources": {"1/1": {"frames": 1200, "bytes": 48000, "lost": 12, "loss_ratio": 0.0099}},
                    }
                ],
            }
            for name, link in self.links.items()
        ]

    @property
    def renumbering(self) -> FakeDaemon:
        return self

    async def run(self, target: str, sysid: int, *, force: bool = False) -> dict[str, FakeOutcome]:
        (vehicle,) = self.fleet.resolve(target)
        taken = [v.name for v in self.fleet.vehicles.values() if v.sysid == sysid and v is not vehicle]
        if taken and not force:
            return {vehicle.name: FakeOutcome(False, "refused", f"refused: {taken[0]} has it", 0)}
        vehicle.sysid = sysid
        return {vehicle.name: FakeOutcome(True, "accepted", f"{vehicle.name} is system {sysid} now", 0)}

    def _router_stats(self) -> dict[str, Any]:
        return {"forwarded": 17, "routes": {}}

    def _send(
        self, name: str, fields: dict[str, Any], target: str | None, link: str | None, *, force: bool = False
    ) -> dict[str, Any]:
        self.sent.append((name, fields, target, link))
        note = {"note": f"{name} has no target field: bravo got it as well"} if target == "alpha,carol" else {}
        return {"sent": 0 if link == "dead" else 1, "message": name, **note}

    @property
    def followed(self) -> bool:
        """Whether anybody has subscribed to events."""
        return bool(self._on_event)

    def subscribe_events(self, callback: Callable[[Mapping[str, Any]], None]) -> Callable[[], None]:
        self._on_event.append(callback)
        return lambda: self._on_event.remove(callback)

    def _add_observer(
        self, msgids: set[int] | None, keys: set[int] | None, callback: Callable[[Frame, Any, float], None]
    ) -> Callable[[], None]:
        entry = (msgids, keys, callback)
        self._on_frame.append(entry)
        return lambda: self._on_frame.remove(entry)

    @property
    def listeners(self) -> int:
        """Subscriptions that clients hold here just now."""
        return len(self._on_event) + len(self._on_frame)

    def on_event(self, event: Event) -> None:
        self.emit(event.kind, event.vehicle, event.text, **event.data)

    def emit(self, kind: str, vehicle: str | None, text: str, **data: Any) -> None:
        armed = next((each.armed for each in self.fleet.vehicles.values() if each.name == vehicle), None)
        event = event_record(Event(kind, vehicle, None, text, data), time.time(), VehicleFacts(armed))
        self.events.append(event)
        for callback in list(self._on_event):
            callback(event)

    def hear(self, name: str, sysid: int = 1, compid: int = 1, **fields: Any) -> None:
        """A message arrives."""
        info = self.dialect.by_name[name]
        frame = Frame(encode(info, fields, sysid=sysid, compid=compid, seq=0), 0, sysid, compid, info.msgid, info)
        for msgids, keys, callback in list(self._on_frame):
            if (msgids is None or info.msgid in msgids) and (keys is None or sysid << 8 | compid in keys):
                callback(frame, None, self.now())


async def serve(path: str, vehicle_count: int) -> None:
    """Until it is killed: vehicles that move a little, an event and some messages each second."""
    daemon = FakeDaemon(vehicle_count)
    if vehicle_count >= 3:
        carol = daemon.vehicle("carol")
        carol.outcome = FakeOutcome(
            False, "denied", "denied: Arm: Throttle too high", status_texts=("Arm: Throttle too high",)
        )
    server = RpcServer(daemon, path)
    await server.start()
    print("ready", flush=True)
    try:
        for i in range(1 << 30):
            await asyncio.sleep(0.2)
            daemon.hear("ATTITUDE", roll=0.1 * (i % 7), pitch=-0.02, yaw=1.5)
            if i % 5 == 0:
                daemon.emit("statustext", "bravo", f"bravo: all well, {i // 5} s")
    finally:
        await server.close()


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3))
