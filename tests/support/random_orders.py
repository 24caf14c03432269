"""Random orders to three vehicles in virtual time: none that the daemon accepts brings two of them too near each other.

A pair that is heard is judged at every look (`Flown.truth`), in the metric of its margin. It is too near *because of an
order* if the newest that moves one of the two was accepted without ``force``, and is one that is checked:

    newest of the two                       judged                               not judged, as docs/explanation say
    -------------------------------------   ----------------------------------   ---------------------------------------
    goto, take-off, trajectory, formation   the other stands, flies where it     the other flies a mission, which goes
                                            was sent, comes home or down         on after the 10 s that are looked at
    mission, by whatever order              the other as above, or on its own    -
    rtl of one or several, its mode         the other is in the air              the other flies a mission; insisted on
    hold, stop, land, a pilot's, ``force``  -                                    all: nothing refuses these

Vehicles of one order keep their formation, and a pair that was within its margin as the order came may fly apart.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

from skygcs.config.models import FleetConfig
from skygcs.core.mavlink import mav_cmd
from skygcs.core.separation import separation_m
from skygcs.ext.formation.config import FormationConfig
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from support.flown import FIELD, Flown, Truth, flown
from support.made_files import waypoints
from support.planned import MARGIN_M
from support.random_flights import Deeds, Judged

FLIGHT_S = 75.0

NAMES = ("v1", "v2", "v3")

TOLERANCE_M = 0.5
"""Autopilots are so far off their straight ways in wind; the fleet file's position errors, 0.9 m each, contain it."""

DOWNWASH_RATIO = 2.0

ALOFT_M = 0.5

CHECKED = frozenset({"goto", "takeoff", "trajectory", "mission", "rtl", "formation"})

GOES_ON = frozenset({"mission"})
"""Their ways are looked at for 10 s by what is not a mission."""

SETTLED_S = 12.0
"""A mode without an order of ours counts as another's from then on."""


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """What moves a vehicle from ``at`` on. ``free``: no distance is promised under this order."""

    at: float
    kind: str
    text: str
    free: bool = False


@dataclass
class OrderedFlight(Deeds):
    """One flight: what moves each vehicle, by system id, the oldest first."""

    rng: random.Random
    gcs: Flown
    moved_by: dict[str, list[Order]] = field(default_factory=lambda: {name: [] for name in NAMES})

    def order(self, kind: str, method: str, targets: Iterable[str], *, free: bool = False, **params: Any) -> None:
        names, begun = list(targets), self.gcs.now
        text = f"{begun:.2f} {method} {','.join(names)} {params or ''}"
        self.done.append(text)

        async def give() -> None:
            order = Order(begun, kind, text, free or bool(params.get("force")))
            answer = await self.gcs(method, targets=names, **params)
            accepted = [n for n in names if answer.get("outcomes", {n: {"ok": True}}).get(n, {}).get("ok")]
            self.done.append(f"    {self.gcs.now:.2f} accepted by {accepted or 'none'}: {method} of {begun:.2f}")
            for name in accepted:
                insists = kind == "rtl" and len(names) == 1 and self.newest(name, begun).kind == "rtl"
                self.note(name, Order(begun, kind, text, True) if insists else order)

        self.start(give())

    def note(self, name: str, order: Order) -> None:
        self.moved_by[name].append(order)
        self.moved_by[name].sort(key=lambda one: one.at)

    def newest(self, name: str, at: float) -> Order:
        """The order that moves it at this time."""
        return next((o for o in reversed(self.moved_by[name]) if o.at <= at), Order(-math.inf, "start", "start", True))

    def some(self) -> list[str]:
        """One, two or all."""
        return self.rng.choice([[self.rng.choice(NAMES)]] * 3 + [self.rng.sample(NAMES, 2), list(NAMES)])

    def place(self) -> list[float]:
        return [self.rng.uniform(-8, 18), self.rng.uniform(-12, 12), self.rng.uniform(4, 14)]


# -- deeds


async def goto(f: OrderedFlight) -> None:
    f.order("goto", "vehicles.goto", f.some(), enu_m=f.place())


async def takeoff(f: OrderedFlight) -> None:
    on_ground = [f"v{sim.sysid}" for sim in f.gcs.sims if sim.motion.on_ground]
    f.order("takeoff", "vehicles.takeoff", on_ground or f.some(), height_m=f.rng.uniform(4, 12))


async def rtl(f: OrderedFlight) -> None:
    names = f.some()
    if f.rng.random() < 0.3:
        family = f.gcs.actor(names[0]).vehicle.family
        names = [name for name in names if f.gcs.actor(name).vehicle.family == family]
        f.order("rtl", "vehicles.mode", names, mode="AUTO.RTL" if family == "px4" else "RTL")
    else:
        f.order("rtl", "vehicles.rtl", names)


async def land(f: OrderedFlight) -> None:
    f.order("land", "vehicles.land", f.some()[:1])


async def hold(f: OrderedFlight) -> None:
    method = f.rng.choice(["vehicles.hold", "missions.pause"])
    f.order("hold", method, f.some())


async def mission(f: OrderedFlight) -> None:
    name = f.rng.choice(NAMES)
    mode = "AUTO.MISSION" if f.gcs.actor(name).vehicle.family == "px4" else "AUTO"
    method, params = f.rng.choice(
        [
            ("missions.start", {}),
            ("missions.start", {}),
            ("missions.resume", {}),
            ("missions.set_current", {"item": f.rng.choice([1, 2, 3])}),
            ("vehicles.mode", {"mode": mode}),
        ]
    )
    f.order("mission", method, [name], **params)


async def upload(f: OrderedFlight) -> None:
    """Up, two places, and home or down."""
    name = f.rng.choice(NAMES)
    places = [f.place() for _ in range(2)]
    rows = [(3, mav_cmd.NAV_TAKEOFF, 0, 0, 0, 0, *FIELD.to_geodetic(*f.gcs.place_of_home(name)[:2]), places[0][2])]
    rows += [(3, mav_cmd.NAV_WAYPOINT, 0, 0, 0, 0, *FIELD.to_geodetic(x, y), up) for x, y, up in places]
    last = f.rng.choice([mav_cmd.NAV_RETURN_TO_LAUNCH, mav_cmd.NAV_LAND])
    rows.append((3, last, 0, 0, 0, 0, *FIELD.to_geodetic(*places[1][:2]), 0))
    f.start(f.gcs("missions.upload", targets=name, plan=waypoints(*rows).decode(), name="m.waypoints"))


async def trajectory(f: OrderedFlight) -> None:
    """Straight, from rest to rest."""
    name = f.rng.choice(NAMES)
    to, t = f.place(), f.rng.uniform(8, 25)

    async def follow() -> None:
        await f.gcs("control.set", targets=name, mode="position")
        here = f.gcs.place(name)
        axes = {
            axis: [a, 0.0, 3 * (b - a) / t**2, -2 * (b - a) / t**3]
            for axis, a, b in zip(("x", "y", "up"), here, to, strict=True)
        }
        await f.gcs("trajectory.load", target=name, pieces=[{"duration_s": t, **axes}])
        f.order("trajectory", "trajectory.start", [name])

    f.start(follow())


async def formation(f: OrderedFlight) -> None:
    f.order("formation", "formation.start", f.rng.choice([NAMES, NAMES[:2], NAMES[1:]]), shape="line", spacing_m=6.0)


async def ends_formation(f: OrderedFlight) -> None:
    f.start(f.gcs("formation.stop"))


async def pilot(f: OrderedFlight) -> None:
    """Takes one, and lets it hover."""
    name = f.rng.choice(NAMES)
    px4 = f.gcs.actor(name).vehicle.family == "px4"
    f.note(name, Order(f.gcs.now, "pilot", f"{f.gcs.now:.2f} pilot {name}", True))
    f.done.append(f.moved_by[name][-1].text)
    f.gcs.other_sets_mode(*((4, 3) if px4 else (int(CopterMode.LOITER), 0)), sysid=int(name[1:]))


async def slow(f: OrderedFlight) -> None:
    f.gcs.uplink_delay_s = f.rng.choice([0.0, 0.0, 0.1, 0.5])
    f.done.append(f"{f.gcs.now:.2f} uplink {f.gcs.uplink_delay_s} s")


DEEDS: tuple[tuple[Callable[[OrderedFlight], Awaitable[None]], int], ...] = (
    (goto, 10),
    (takeoff, 5),
    (rtl, 4),
    (land, 2),
    (hold, 3),
    (upload, 3),
    (mission, 4),
    (trajectory, 3),
    (formation, 1),
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
    for one, other in combinations(NAMES, 2):
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
    if newer.kind != "mission" and older.kind in GOES_ON:
        return None
    if newer.kind == "rtl" and (a.landed or b.landed):
        return None
    then = next((apart_m(p, q) for p, q in looks if p.at >= newer.at), math.inf)
    return None if then < MARGIN_M + TOLERANCE_M else (older, newer)


# -- the flight


def _with_formation(config: FleetConfig) -> FleetConfig:
    return config.model_copy(update={"extensions": {"formation": FormationConfig()}})


async def fly_by_orders(tmp_path: Path, seed: int) -> Judged:
    """One flight of this seed."""
    rng = random.Random(seed)
    px4 = rng.choice([0, 1, 2, 3])
    conditions = conditions_of(wind_mps=rng.uniform(0.0, 6.0), wind_from_deg=rng.uniform(0.0, 360.0))
    fence: dict[str, Any] = {"fence": {"x_m": (-60.0, 60.0), "y_m": (-60.0, 60.0), "up_m": (0.0, 40.0)}}
    kind = {"px4": px4, "ardupilot": 3 - px4}
    options: dict[str, Any] = {"in_air": True, "setpoints_end": False, "prepared": _with_formation, "control": fence}
    async with flown(tmp_path, conditions=conditions, **options, **kind) as gcs:
        flight = OrderedFlight(rng, gcs)
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
        return Judged(seed, (), tuple(too_near(flight, began)), 0, 0, 0, tuple(flight.done))
