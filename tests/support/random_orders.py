"""Random orders to three or nine vehicles in virtual time: none that the daemon accepts brings two too near each other.

An order that is refused moves nothing, so another one of its kind is tried at once (`OrderedFlight.propose`): what the
daemon lets through at its limit is flown.

A pair that is heard is judged at every look (`Flown.truth`), in the metric of its margin. It is too near *because of an
order* if the newest that moves one of the two was accepted without ``force``, and is one that is checked:

    newest of the two                       judged                               not judged, as docs/explanation say
    -------------------------------------   ----------------------------------   ---------------------------------------
    goto, take-off, trajectory              the other stands, flies where it     a client streams to the other: it goes
                                            was sent, comes home or down, or     on after the 10 s that are looked at
                                            flies its mission
    formation                               the other as above, but for missions a mission, which goes on as well
    mission, by whatever order              the other as above, or on its own    -
    rtl of one or several, its mode; also   the other is in the air              the other flies a mission; insisted on
    where it waits
    velocity, as a stream                   the other stands                     the other moves
    hold, stop, land, a pilot's, ``force``  -                                    all: nothing refuses these

Vehicles of one order keep their formation, and a pair that was within its margin as the order came may fly apart.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any
from unittest import mock

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink import mav_cmd
from skygcs.core.separation import separation_m
from skygcs.errors import SkygcsError
from skygcs.ext.formation.config import FormationConfig
from skygcs.sim import vehicle_group
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from support.flown import FIELD, SEEN_S, Flown, Truth, flown, put_up
from support.made_files import waypoints
from support.planned import MARGIN_M
from support.random_flights import Deeds, Judged

FLIGHT_S = 75.0

TRIES = 6
"""Orders of one kind that are proposed at most, until one is accepted."""

TOLERANCE_M = 0.5
"""Autopilots are so far off their straight ways in wind; the fleet file's position errors, 0.9 m each, contain it."""

DOWNWASH_RATIO = 2.0

ALOFT_M = 0.5

CHECKED = frozenset({"goto", "takeoff", "trajectory", "mission", "rtl", "formation", "velocity"})

GOES_ON: dict[str, frozenset[str]] = {
    "mission": frozenset({"rtl", "formation", "velocity"}),
    "velocity": CHECKED - {"mission"},
}
"""By what the older order began: newer ones that look at it for 10 s."""

STANDS_MPS = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """What moves a vehicle from ``at`` on. ``free``: no distance is promised under this order."""

    at: float
    kind: str
    text: str
    free: bool = False


Make = Callable[[], tuple[list[str], dict[str, Any]]]
"""The vehicles of an order and its parameters, at random."""


@dataclass
class OrderedFlight(Deeds):
    """One flight: what moves each vehicle, by system id, the oldest first."""

    rng: random.Random
    gcs: Flown
    names: tuple[str, ...]
    moved_by: dict[str, list[Order]] = field(init=False)
    accepted: Counter[str] = field(default_factory=Counter)
    """Deeds of each kind of which one order was accepted, also in part."""
    asked: Counter[str] = field(default_factory=Counter)
    busy: set[str] = field(default_factory=set)
    """Vehicles that a deed brings to rest first: no other one takes them."""

    def __post_init__(self) -> None:
        self.moved_by = {name: [] for name in self.names}

    async def give(self, kind: str, method: str, names: Sequence[str], free: bool = False, **params: Any) -> list[str]:
        """Give one order; those that accept it."""
        begun = self.gcs.now
        text = f"{begun:.2f} {method} {','.join(names)} {params or ''}"
        self.done.append(text)
        accepted = list[str]()
        try:
            answer = await self.gcs(method, targets=list(names), **params)
            accepted = [n for n in names if answer.get("outcomes", {n: {"ok": True}}).get(n, {}).get("ok")]
        finally:
            self.done.append(f"    {self.gcs.now:.2f} accepted by {accepted or 'none'}: {method} of {begun:.2f}")
        order = Order(begun, kind, text, free or bool(params.get("force")))
        for name in accepted:
            insists = kind == "rtl" and len(names) == 1 and self.newest(name, begun).kind == "rtl"
            self.note(name, Order(begun, kind, text, True) if insists else order)
        return accepted

    def propose(self, kind: str, method: str, make: Make, *, tries: int = TRIES, free: bool = False) -> None:
        """Give an order beside the next deeds, and others of its kind until one is accepted."""

        async def give() -> None:
            self.asked[kind] += 1
            for _ in range(tries):
                names, params = make()
                if names and await self.tried(self.give(kind, method, names, free, **params)):
                    self.accepted[kind] += 1
                    return

        self.start(give())

    async def tried(self, work: Awaitable[Any]) -> Any:
        """None if it is refused as a whole."""
        with contextlib.suppress(SkygcsError):
            return await work
        return None

    def note(self, name: str, order: Order) -> None:
        self.moved_by[name].append(order)
        self.moved_by[name].sort(key=lambda one: one.at)

    def newest(self, name: str, at: float) -> Order:
        """The order that moves it at this time."""
        return next((o for o in reversed(self.moved_by[name]) if o.at <= at), Order(-math.inf, "start", "start", True))

    def some(self, among: Sequence[str] | None = None) -> list[str]:
        """One, a few or all of these."""
        among = list(self.names if among is None else among)
        few = self.rng.sample(among, min(len(among), self.rng.choice([1, 1, 1, 2, 2, 3])))
        return among if self.rng.random() < 0.15 else few

    @property
    def flying(self) -> list[str]:
        return [name for name in self.names if name not in self.busy and not self.gcs.sim(name).motion.on_ground]

    @property
    def standing(self) -> list[str]:
        return [f"v{sim.sysid}" for sim in self.gcs.sims if sim.motion.on_ground and not sim.armed]

    async def at_rest(self, names: Sequence[str]) -> None:
        """Hold them, and control them by positions."""
        await self.tried(self.give("hold", "vehicles.hold", names, True))
        await asyncio.sleep(self.rng.uniform(3.0, 5.0))
        await self.tried(self.give("control", "control.set", names, True, mode="position"))
        await asyncio.sleep(1.0)

    def place(self, name: str | None = None) -> list[float]:
        """Anywhere, or not far from a vehicle or its home."""
        anywhere = [self.rng.uniform(-8, 18), self.rng.uniform(-12, 12), self.rng.uniform(4, 14)]
        if name is None or self.rng.random() < 0.4:
            return anywhere
        x, y, z = self.rng.choice([self.gcs.place(name), (*self.gcs.place_of_home(name)[:2], 8.0)])
        return [x + self.rng.gauss(0, 5), y + self.rng.gauss(0, 5), max(3.0, z + self.rng.gauss(0, 3))]

    def mode_of(self, name: str, px4: str, ardupilot: str) -> str:
        return px4 if self.gcs.actor(name).vehicle.family == "px4" else ardupilot


# -- deeds


async def goto(f: OrderedFlight) -> None:
    def make() -> tuple[list[str], dict[str, Any]]:
        names = f.some(f.flying)
        return names, {"enu_m": f.place(names[0] if len(names) == 1 else None)}

    f.propose("goto", "vehicles.goto", make)


async def redirected(f: OrderedFlight) -> None:
    """Elsewhere, soon after it began to fly to a place."""
    names = f.rng.sample(f.flying, min(1, len(f.flying)))

    async def fly() -> None:
        if await f.tried(f.give("goto", "vehicles.goto", names, enu_m=f.place())):
            await asyncio.sleep(f.rng.uniform(0.5, 5.0))
            f.propose("goto", "vehicles.goto", lambda: (names, {"enu_m": f.place()}))

    if names:
        f.start(fly())


async def takeoff(f: OrderedFlight) -> None:
    """One, several, or one after the other; one lands for that if none stands."""
    if not f.standing:
        await land(f)
        return

    def make(names: list[str]) -> Make:
        return lambda: (names, {"height_m": f.rng.uniform(4, 12)})

    if f.rng.random() < 0.5:
        f.propose("takeoff", "vehicles.takeoff", make(f.some(f.standing)))
        return

    async def staggered(names: list[str]) -> None:
        for name in names:
            f.propose("takeoff", "vehicles.takeoff", make([name]))
            await asyncio.sleep(f.rng.uniform(0.1, 3.0))

    f.start(staggered(f.some(f.standing)))


async def rtl(f: OrderedFlight) -> None:
    names = f.some(f.flying)
    if not names:
        return
    if f.rng.random() < 0.3:
        mode = f.mode_of(names[0], "AUTO.RTL", "RTL")
        names = [name for name in names if f.mode_of(name, "AUTO.RTL", "RTL") == mode]
        f.propose("rtl", "vehicles.mode", lambda: (names, {"mode": mode}), tries=1)
    else:
        f.propose("rtl", "vehicles.rtl", lambda: (names, {}), tries=1)


async def land(f: OrderedFlight) -> None:
    if not f.flying:
        return
    f.propose("land", "vehicles.land", lambda: (f.rng.sample(f.flying, min(1, len(f.flying))), {}), tries=1)


async def hold(f: OrderedFlight) -> None:
    method = f.rng.choice(["vehicles.hold", "missions.pause"])
    f.propose("hold", method, lambda: (f.some(f.flying), {}), tries=1)


async def mission(f: OrderedFlight) -> None:
    """Up, two places, and home or down; uploaded and begun, in the place of one that it flies or not."""
    name = f.rng.choice([*f.flying, *f.standing] or f.names)

    async def fly() -> None:
        f.asked["mission"] += 1
        for _ in range(TRIES):
            places = [f.place(name) for _ in range(2)]
            home = f.gcs.place_of_home(name)[:2]
            rows = [(3, mav_cmd.NAV_TAKEOFF, 0, 0, 0, 0, *FIELD.to_geodetic(*home), places[0][2])]
            rows += [(3, mav_cmd.NAV_WAYPOINT, 0, 0, 0, 0, *FIELD.to_geodetic(x, y), up) for x, y, up in places]
            last = f.rng.choice([mav_cmd.NAV_RETURN_TO_LAUNCH, mav_cmd.NAV_LAND, None, None])
            rows += [] if last is None else [(3, last, 0, 0, 0, 0, *FIELD.to_geodetic(*places[1][:2]), 0)]
            plan = waypoints(*rows).decode()
            flying = name in f.flying
            await f.tried(f.gcs("missions.upload", targets=name, plan=plan, name="m.waypoints"))
            start = f.rng.choice(["missions.start"] * 4 + ["vehicles.mode"])
            params = {} if start == "missions.start" else {"mode": f.mode_of(name, "AUTO.MISSION", "AUTO")}
            if start == "missions.start" and not flying:
                params = {"arm": True}
            if await f.tried(f.give("mission", start, [name], **params)):
                f.accepted["mission"] += 1
                return

    f.start(fly())


async def goes_on(f: OrderedFlight) -> None:
    """A mission is paused and resumed, or goes to another item."""
    on_mission = [n for n in f.flying if f.newest(n, f.gcs.now).kind == "mission"]
    if not on_mission:
        await mission(f)
        return
    name = f.rng.choice(on_mission)

    async def fly() -> None:
        if f.rng.random() < 0.3:
            f.propose("mission", "missions.set_current", lambda: ([name], {"item": f.rng.choice([1, 2, 3])}))
        elif await f.tried(f.give("hold", "missions.pause", [name])):
            await asyncio.sleep(f.rng.uniform(0.5, 6.0))
            f.propose("mission", "missions.resume", lambda: ([name], {}), tries=1)

    f.start(fly())


async def trajectory(f: OrderedFlight) -> None:
    """Straight, from rest to rest; now and then it is stopped on its path, and goes on."""
    names = f.some(f.flying)[:2]

    async def follow() -> None:
        f.asked["trajectory"] += 1
        await f.at_rest(names)
        for _ in range(TRIES):
            t = f.rng.uniform(8, 25)
            for name in names:
                axes = {
                    axis: [a, 0.0, 3 * (b - a) / t**2, -2 * (b - a) / t**3]
                    for axis, a, b in zip(("x", "y", "up"), f.gcs.place(name), f.place(name), strict=True)
                }
                await f.tried(f.gcs("trajectory.load", target=name, pieces=[{"duration_s": t, **axes}]))
            if await f.tried(f.give("trajectory", "trajectory.start", names)):
                f.accepted["trajectory"] += 1
                break
        f.busy -= set(names)
        if f.rng.random() < 0.3:
            await asyncio.sleep(f.rng.uniform(2.0, 8.0))
            await f.tried(f.gcs("trajectory.pause", targets=names))
            await asyncio.sleep(f.rng.uniform(1.0, 6.0))
            if await f.tried(f.give("resumed", "trajectory.resume", names, True)):
                return

    if names:
        f.busy |= set(names)
        f.start(follow())


async def formation(f: OrderedFlight) -> None:
    flying = f.flying
    if len(flying) < 2:
        return
    names = f.rng.sample(flying, min(len(flying), f.rng.choice([2, 2, 3])))

    async def form() -> None:
        f.asked["formation"] += 1
        await f.tried(f.gcs("formation.stop"))
        await f.at_rest(names)
        for shape in f.rng.sample(["line", "v", "current"], 3):
            params = {"shape": shape, "spacing_m": f.rng.choice([6.0, 8.0])}
            if await f.tried(f.give("formation", "formation.start", names, **params)):
                f.accepted["formation"] += 1
                break
        f.busy -= set(names)

    f.busy |= set(names)
    f.start(form())


async def ends_formation(f: OrderedFlight) -> None:
    f.start(f.gcs("formation.stop"))


async def velocity(f: OrderedFlight) -> None:
    """A stream of one velocity, for some seconds."""
    name = next(iter(f.some(f.flying)), None)

    async def send(name: str) -> None:
        f.asked["velocity"] += 1
        await f.tried(f.give("control", "control.set", [name], True, mode="velocity"))
        vel = [f.rng.uniform(-2, 2), f.rng.uniform(-2, 2), f.rng.uniform(-0.5, 0.5)]
        begun, passed = f.gcs.now, 0
        for _ in range(round(f.rng.uniform(1, 6) / 0.1)):
            answer = await f.tried(f.gcs("control.setpoint", targets=name, vel_enu_mps=vel, valid_s=0.5))
            if answer is not None and answer["outcomes"][name]["ok"] and not passed:
                f.note(name, Order(begun, "velocity", f"{begun:.2f} velocity {name} {vel}"))
                f.done.append(f.moved_by[name][-1].text)
                passed = 1
            await asyncio.sleep(0.1)
        f.accepted["velocity"] += passed

    if name is not None:
        f.start(send(name))


async def pilot(f: OrderedFlight) -> None:
    """Takes one, and lets it hover."""
    name = f.rng.choice(f.names)
    px4 = f.gcs.actor(name).vehicle.family == "px4"
    f.note(name, Order(f.gcs.now, "pilot", f"{f.gcs.now:.2f} pilot {name}", True))
    f.done.append(f.moved_by[name][-1].text)
    f.gcs.other_sets_mode(*((4, 3) if px4 else (int(CopterMode.LOITER), 0)), sysid=int(name[1:]))


async def slow(f: OrderedFlight) -> None:
    f.gcs.uplink_delay_s = f.rng.choice([0.0, 0.0, 0.1, 0.5])
    f.done.append(f"{f.gcs.now:.2f} uplink {f.gcs.uplink_delay_s} s")


DEEDS: tuple[tuple[Callable[[OrderedFlight], Awaitable[None]], int], ...] = (
    (goto, 8),
    (redirected, 3),
    (takeoff, 5),
    (rtl, 5),
    (land, 2),
    (hold, 2),
    (mission, 4),
    (goes_on, 3),
    (trajectory, 3),
    (velocity, 2),
    (formation, 2),
    (ends_formation, 1),
    (pilot, 1),
    (slow, 1),
)


# -- the judge


def apart_m(a: Truth, b: Truth) -> float:
    x, y, z = (p - q for p, q in zip(a.pos_m, b.pos_m, strict=True))
    return separation_m(x, y, z, DOWNWASH_RATIO)


def too_near(f: OrderedFlight, since: float) -> list[str]:
    """The pairs that came too near because of an order, the nearest look of each with the two orders."""
    found: dict[tuple[str, str, float, float], tuple[float, str]] = {}
    for one, other in combinations(f.names, 2):
        looks = list(zip(f.gcs.truth[int(one[1:])], f.gcs.truth[int(other[1:])], strict=True))
        for a, b in looks:
            near_m = apart_m(a, b)
            if a.at < since or near_m >= MARGIN_M - TOLERANCE_M:
                continue
            if (why := _because_of(f, (one, a), (other, b), looks)) is None:
                continue
            older, newer = why
            key = (one, other, older.at, newer.at)
            if near_m < found.get(key, (math.inf, ""))[0]:
                places = ", ".join(f"({x:.1f} {y:.1f} {z:.1f})" for x, y, z in (a.pos_m, b.pos_m))
                text = f"{one} {other} {near_m:.2f} m at {a.at:.2f} {places}: [{newer.text}] after [{older.text}]"
                found[key] = near_m, text
    return [text for _, text in found.values()]


def _because_of(
    f: OrderedFlight, one: tuple[str, Truth], other: tuple[str, Truth], looks: list[tuple[Truth, Truth]]
) -> tuple[Order, Order] | None:
    """The older and the newer of the orders that move them, if it is the newer one's fault."""
    (name, a), (name_b, b) = one, other
    older, newer = sorted((f.newest(name, a.at), f.newest(name_b, a.at)), key=lambda o: o.at)
    if (a.landed and b.landed) or max(a.pos_m[2], b.pos_m[2]) < ALOFT_M:
        return None
    if newer.free or newer.kind not in CHECKED or older is newer:
        return None
    if newer.kind in GOES_ON.get(older.kind, ()):
        return None
    if newer.kind == "rtl" and (a.landed or b.landed):
        return None
    others = b if newer is f.newest(name, a.at) else a
    if newer.kind == "velocity" and math.hypot(*others.vel_mps) > STANDS_MPS:
        return None
    then = next((apart_m(p, q) for p, q in looks if p.at >= newer.at), math.inf)
    return None if apart_m(a, b) > then - TOLERANCE_M else (older, newer)


# -- the flight


def _with_formation(config: FleetConfig) -> FleetConfig:
    return config.model_copy(update={"extensions": {"formation": FormationConfig()}})


async def fly_by_orders(tmp_path: Path, seed: int) -> Judged:
    """One flight of this seed; a quarter of them with nine vehicles on pads 3 or 4 m apart."""
    rng = random.Random(seed)
    count, pads_m = rng.choice([(3, 5.0), (3, 5.0), (3, 4.0), (9, rng.choice([3.0, 4.0]))])
    px4 = rng.choice([0, count // 3, count - count // 3, count])
    conditions = conditions_of(wind_mps=rng.uniform(0.0, 6.0), wind_from_deg=rng.uniform(0.0, 360.0))
    fence: dict[str, Any] = {"fence": {"x_m": (-60.0, 60.0), "y_m": (-60.0, 60.0), "up_m": (0.0, 40.0)}}
    kind = {"px4": px4, "ardupilot": count - px4}
    options: dict[str, Any] = {"takeoff": False, "setpoints_end": False, "prepared": _with_formation, "control": fence}
    with mock.patch.object(vehicle_group, "SPACING_M", pads_m):
        async with flown(tmp_path, conditions=conditions, **options, **kind) as gcs:
            await asyncio.sleep(5.0)
            for sim in gcs.sims:
                if rng.random() < (0.6 if count == 3 else 0.3) and pads_m > MARGIN_M + TOLERANCE_M:
                    put_up(sim, 10.0, gcs.now)
            await asyncio.sleep(SEEN_S)
            flight = OrderedFlight(rng, gcs, tuple(f"v{sim.sysid}" for sim in gcs.sims))
            began = gcs.now
            deeds, weights = zip(*DEEDS, strict=True)
            while gcs.now < began + FLIGHT_S:
                await asyncio.sleep(rng.choice([0.02, 0.3, 1.0, 2.0, 5.0]))
                (deed,) = rng.choices(deeds, weights)
                await deed(flight)
            await asyncio.sleep(25.0)
            for task in list(flight.under_way):
                task.cancel()
            flight.require_nothing_raised()
            near = tuple(too_near(flight, began))
            accepted = {kind: (flight.accepted[kind], asked) for kind, asked in flight.asked.items()}
            return Judged(seed, (), near, 0, 0, 0, tuple(flight.done), accepted)
