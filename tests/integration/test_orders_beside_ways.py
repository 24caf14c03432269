"""Each order that sends a vehicle somewhere, beside each kind of way that another one is on: they cross in space, far
from where the other is when it is ordered.

v1 stands on its pad, v3 is in the air south of the pads with v5 behind it, and v2 is the other vehicle. Pads are 2 m
apart, so what flies above one of them is too near what flies above the next.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import pytest

from integration.test_flight_lock_methods import MOVES
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink import mav_cmd
from skygcs.errors import SkygcsError
from skygcs.ext.formation.config import FormationConfig
from skygcs.sim import vehicle_group
from support.called import plans_of
from support.flown import FIELD, SEEN_S, Flown, flown, put_up
from support.made_files import waypoints
from support.planned import content, inline, refused, timed

COSTS = "each kind of way is flown in a daemon of its own"

Vector = tuple[float, float, float]

PADS_M = 2.0

UP_M = 10.0

SOUTH, NORTH = (0.0, -15.0, UP_M), (0.0, 15.0, UP_M)
"""v3 is ordered from one to the other, and crosses the row of pads between them ..."""

WEST, EAST = (-90.0, 0.0, UP_M), (10.0, 0.0, UP_M)
"""... along which v2 flies, from far away."""


def put(gcs: Flown, name: str, place: Vector) -> None:
    """In the air at a place, by no order."""
    sim, pad = gcs.sim(name), gcs.place_of_home(name)
    put_up(sim, place[2], gcs.now)
    sim.motion.east_m, sim.motion.north_m = place[0] - pad[0], place[1] - pad[1]
    sim.hold_here()


def straight(begin: Vector, end: Vector, seconds: float) -> list[dict[str, Any]]:
    """From rest to rest."""
    t, axes = seconds, zip(("x", "y", "up"), begin, end, strict=True)
    return [{"duration_s": t, **{axis: [a, 0.0, 3 * (b - a) / t**2, -2 * (b - a) / t**3] for axis, a, b in axes}}]


def mission(*places: Vector) -> str:
    rows = [(3, mav_cmd.NAV_WAYPOINT, 0, 0, 0, 0, *FIELD.to_geodetic(x, y), up) for x, y, up in places]
    return waypoints(*rows).decode()


# -- the ways of v2


async def stands(gcs: Flown) -> None:
    await gcs.done("vehicles.hold", "v2")


async def was_sent(gcs: Flown) -> None:
    await gcs.done("vehicles.goto", "v2", enu_m=list(EAST))


async def takes_off(gcs: Flown) -> None:
    """It is on the ground yet."""
    gcs.daemon.loop.create_task(gcs("vehicles.takeoff", targets="v2", height_m=30.0, force=True))
    await asyncio.sleep(0.1)


async def climbs(gcs: Flown) -> None:
    await takes_off(gcs)
    await gcs.until(lambda: gcs.place("v2")[2] > 0.5)


async def lands(gcs: Flown) -> None:
    await gcs.done("vehicles.land", "v2")
    await asyncio.sleep(1.0)


async def returns(gcs: Flown) -> None:
    await gcs.done("vehicles.rtl", "v2")


async def on_mission(gcs: Flown) -> None:
    await gcs.done("missions.upload", "v2", plan=mission(WEST, (-90.0, 30.0, UP_M), (0.0, 0.0, UP_M), EAST))
    await gcs.done("missions.start", "v2")


async def on_trajectory(gcs: Flown) -> None:
    await gcs.fly("position", "v2")
    await gcs("trajectory.load", target="v2", pieces=straight(WEST, EAST, 120.0))
    await gcs.done("trajectory.start", "v2", after_s=5.0)


async def in_formation(gcs: Flown) -> None:
    await gcs("formation.start", targets=["v2", "v4"], shape="current")
    await gcs("formation.move", to_enu_m=[10.0, 10.0, UP_M])


async def on_plan(gcs: Flown) -> None:
    await gcs("plan.load", plan=content(timed({"v2": WEST}, {"v2": EAST})), name="test")
    answer = await gcs("plan.run", force=True, margin_m=2.5)
    assert answer["started"], answer["report"]
    await asyncio.sleep(8.0)


class OtherWay(NamedTuple):
    """A way of v2: the method that begins it, and from where. None: from its pad."""

    method: str
    begin: Callable[[Flown], Awaitable[None]]
    put_at: Vector | None = WEST


WAYS = (
    OtherWay("vehicles.hold", stands, (PADS_M, 0.0, UP_M)),
    OtherWay("vehicles.goto", was_sent),
    OtherWay("vehicles.takeoff", takes_off, None),
    OtherWay("vehicles.takeoff", climbs, None),
    OtherWay("vehicles.land", lands, (PADS_M, 0.0, 60.0)),
    OtherWay("vehicles.rtl", returns),
    OtherWay("missions.start", on_mission),
    OtherWay("trajectory.start", on_trajectory),
    OtherWay("formation.start", in_formation),
    OtherWay("plan.run", on_plan),
)


# -- the orders of v3, and of v1 from its pad: each returns what was said


async def said(gcs: Flown, method: str, target: str, **params: Any) -> str:
    outcome = await gcs.outcome(method, target, **params)
    return f"{'accepted' if outcome['ok'] else 'refused'}: {outcome['message']}"


async def plan(gcs: Flown) -> str:
    try:
        await gcs("plan.load", plan=content(timed({"v3": SOUTH}, {"v3": NORTH})), name="test")
    except SkygcsError as error:  # one plan at a time
        return f"refused: {error} (v2)"
    found = refused(await gcs("plan.check", margin_m=2.5))
    return f"refused: {found}" if found else "accepted: "


ORDERS: dict[str, Callable[[Flown], Awaitable[str]]] = {
    "vehicles.goto": lambda gcs: said(gcs, "vehicles.goto", "v3", enu_m=list(NORTH)),
    "vehicles.takeoff": lambda gcs: said(gcs, "vehicles.takeoff", "v1", height_m=20.0),
    "missions.start": lambda gcs: said(gcs, "missions.start", "v3"),
    "plan.run": plan,
    "trajectory.start": lambda gcs: said(gcs, "trajectory.start", "v3"),
    "vehicles.rtl": lambda gcs: said(gcs, "vehicles.rtl", "v3"),
}

ITSELF = (
    "a formation keeps itself from what comes near (tests/integration/test_formation.py), and may be moved anywhere"
)

NOT_REFUSED: dict[tuple[str, str], str] = {
    ("trajectory.start", "on_trajectory"): "accepted: ",  # both have times: v3 has passed 90 s before v2 comes
    ("trajectory.start", "on_plan"): "accepted: ",
    **{("vehicles.rtl", way.begin.__name__): "accepted: it holds until v2 is out of its way" for way in WAYS},
    ("vehicles.rtl", "stands"): "accepted: it holds until v2 is out of its way",
    ("vehicles.rtl", "on_mission"): "accepted: returning",  # looked at for 10 s: a mission takes minutes
    **{(method, "in_formation"): ITSELF for method in ORDERS if method != "plan.run"},
}
"""The answer to an order that v2 is no reason to refuse; `ITSELF`: nothing is promised."""

ELSEWHERE: dict[str, tuple[str, ...]] = {
    "never refused, or nothing flies on by it": (
        *("vehicles.land", "vehicles.hold", "vehicles.stop", "vehicles.disarm", "vehicles.reboot", "missions.pause"),
        *("plan.abort", "plan.land", "plan.pause", "trajectory.pause", "trajectory.abort", "formation.stop"),
        *("trajectory.load", "missions.upload", "missions.end_turns", "control.set", "plan.upload", "plan.load"),
        *("plan.check", "plan.make", "plan.certify", "drills.begin", "drills.end", "recordings.replay"),
        *("recordings.end", "authority.grant", "authority.revoke", "shell.open", "shell.write", "shell.read"),
        *("shell.close",),
    ),
    "as the order whose way it begins or goes on with (test_mission_overlap.py, test_plan_flight.py)": (
        *("vehicles.mode", "missions.resume", "missions.set_current", "plan.resume"),
    ),
    "nothing, or no farther than a moment: docs/explanation/monitor.md": (
        *("trajectory.resume", "trajectory.speed", "plan.speed", "control.setpoint", "vehicles.command"),
        *("messages.send", "companion.contact", "companion.order", "companion.setpoint"),
    ),
    ITSELF: ("formation.start", "formation.guide", "formation.move", "formation.turn", "formation.scale"),
}


def test_each_method_that_moves_a_vehicle_has_a_row_and_begins_a_way() -> None:
    moves = {name for names in MOVES.values() for name in names}
    moves |= {"vehicles.takeoff", "trajectory.start", "plan.run"}
    elsewhere = [name for names in ELSEWHERE.values() for name in names]
    assert sorted([*ORDERS, *elsewhere]) == sorted(moves)
    assert {way.method for way in WAYS} >= {*ORDERS, "formation.start", "vehicles.land"}


@contextlib.asynccontextmanager
async def field(tmp_path: Path, autopilot: str) -> AsyncIterator[Flown]:
    """Five vehicles; v3 is ready for each of the orders."""

    def prepared(config: FleetConfig) -> FleetConfig:
        return config.model_copy(update={"extensions": {"formation": FormationConfig()}})

    kind = {"px4": 0, autopilot: 5}
    fence: dict[str, Any] = {"fence": {"x_m": (-160.0, 160.0), "y_m": (-160.0, 160.0), "up_m": (0.0, 80.0)}}
    params = {"RTL_RETURN_ALT": UP_M, "RTL_ALT": 100 * UP_M}
    options: dict[str, Any] = {"takeoff": False, "setpoints_end": False, "prepared": prepared, "control": fence}
    with mock.patch.object(vehicle_group, "SPACING_M", PADS_M):
        async with flown(tmp_path, params=params, **options, **kind) as gcs:
            plans_of(gcs.daemon).runner.work = inline
            yield gcs


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
@pytest.mark.parametrize("way", WAYS, ids=[way.begin.__name__ for way in WAYS])
async def test_an_order_across_the_way_of_another_one_is_refused(tmp_path: Path, way: OtherWay, autopilot: str) -> None:
    """A plan took who had been sent away, or was about to take off, to stay; a return did so with who took off; and
    goto and trajectory did not know missions."""
    kind = way.begin.__name__
    async with field(tmp_path, autopilot) as gcs:
        put(gcs, "v3", SOUTH)
        if way.put_at is not None:
            put(gcs, "v2", way.put_at)
        if way.begin is in_formation:
            put(gcs, "v4", (WEST[0], 20.0, UP_M))
        await asyncio.sleep(SEEN_S)
        await gcs.done("missions.upload", "v3", plan=mission(SOUTH, NORTH))
        await gcs.fly("position", "v3")
        await gcs("trajectory.load", target="v3", pieces=straight(SOUTH, NORTH, 30.0))
        await way.begin(gcs)
        await asyncio.sleep(0.2)
        for method, order in ORDERS.items():
            expected = NOT_REFUSED.get((method, kind), "refused: ")
            if expected is ITSELF:
                continue
            text = await order(gcs)
            assert text.startswith(expected), (method, kind, text)
            assert "v2" in text or expected.startswith("accepted"), (method, kind, text)


@pytest.mark.parametrize(
    ("method", "params"), [("vehicles.rtl", {}), ("missions.start", {}), ("vehicles.goto", {"enu_m": list(EAST)})]
)
async def test_an_order_counts_as_its_way_from_when_it_is_given(
    tmp_path: Path, method: str, params: dict[str, Any]
) -> None:
    """Until its mode showed, a mission and a return were no way to others (random flight 102)."""
    async with field(tmp_path, "px4") as gcs:
        for name, place in (("v2", WEST), ("v3", SOUTH)):
            put(gcs, name, place)
        await asyncio.sleep(SEEN_S)
        await gcs.done("missions.upload", "v2", plan=mission(WEST, EAST))
        await gcs.done("missions.upload", "v3", plan=mission(SOUTH, NORTH))
        gcs.uplink_delay_s = 0.5
        begun = asyncio.ensure_future(gcs.outcome(method, "v2", **params))
        await asyncio.sleep(0.1)
        for order, also in (("vehicles.goto", {"enu_m": list(NORTH)}), ("missions.start", {})):
            text = await said(gcs, order, "v3", **also)
            assert text.startswith("refused: ") and "v2" in text, (order, text)
        assert (await begun)["ok"]
