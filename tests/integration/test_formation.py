"""Formations in a whole daemon: begun, moved, turned, scaled, stopped, and each way in which one is stopped."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import runpy
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.models import FleetConfig
from skygcs.core.separation import POSITION_ERROR_M, WINGSPAN_M
from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.errors import RefusedError
from skygcs.ext.formation.config import FormationConfig
from skygcs.sim.conditions import Conditions
from support.flown import Flown, aloft
from support.planned import least_distance
from support.process import ROOT

COSTS = "formations of two and three vehicles, each flown to its end"

MARGIN_M = WINGSPAN_M + 2 * POSITION_ERROR_M

NAMES = ["v1", "v2", "v3", "v4"]
KINDS = pytest.mark.parametrize("kind", [{"px4": 3}, {"px4": 0, "ardupilot": 3}], ids=["px4", "ardupilot"])
WIDE = {"fence": {"x_m": (-120.0, 120.0), "y_m": (-120.0, 120.0), "up_m": (0.0, 40.0)}}


@contextlib.asynccontextmanager
async def formed(tmp_path: Path, *, fly: dict[str, Any] | None = None, **kind: Any) -> AsyncIterator[Flown]:
    table = FormationConfig(**(fly or {}))

    def prepared(config: FleetConfig) -> FleetConfig:
        return config.model_copy(update={"extensions": {"formation": table}})

    acting = {"monitor": {"mode": "acting"}}
    async with aloft(tmp_path, control=WIDE, tables=acting, prepared=prepared, **kind) as gcs:
        yield gcs


async def status(gcs: Flown) -> dict[str, Any]:
    return dict(await gcs("formation.status"))


async def at_places(gcs: Flown, within_s: float = 90.0) -> None:
    """Until all are at their places, and the leader stands."""

    def there() -> bool:
        flight = gcs.daemon.extensions["formation"].status()
        assert flight["state"] == "flying", flight["reason"]
        return bool(flight["settled"])

    end = gcs.now + within_s
    while not there():
        assert gcs.now < end, str(await status(gcs))
        await asyncio.sleep(0.1)


@KINDS
async def test_a_formation_is_formed_moved_turned_scaled_and_stopped(tmp_path: Path, kind: dict[str, int]) -> None:
    async with formed(tmp_path, **kind) as gcs:
        since, names = gcs.now, NAMES[:3]
        answer = await gcs("formation.start", targets=names, shape="v", spacing_m=8.0)
        assert answer["state"] == "flying"
        gcs.daemon.extensions["formation"].tick(gcs.now)  # at the moment of its begin it divided by no time
        await at_places(gcs)
        await gcs("formation.move", to_enu_m=[20.0, 10.0, 14.0])
        await at_places(gcs)
        await gcs("formation.turn", heading_deg=90.0)
        await at_places(gcs)
        await gcs("formation.scale", factor=1.5)
        await at_places(gcs)
        flight = await status(gcs)
        assert flight["heading_deg"] == pytest.approx(90.0, abs=1.0) and flight["scale"] == pytest.approx(1.5, abs=0.01)
        for member in flight["members"]:
            assert math.dist(gcs.place(member["vehicle"]), member["place_enu_m"]) < 1.0
        await gcs("formation.stop")
        await gcs.until(lambda: gcs.daemon.extensions["formation"].status()["state"] == "stopped", 10.0)
        await asyncio.sleep(5.0)
        assert all(gcs.control(name)["state"] == "flying" for name in names)
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert not [t for t in gcs.told if t.kind == "separation" and t.data.get("level") in ("warning", "action")]


async def test_a_formation_follows_a_vehicle(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=3) as gcs:
        since = gcs.now
        await gcs.fly("position", "v1")
        await gcs("formation.start", targets=NAMES[1:3], shape="line", spacing_m=8.0, leader="v1", heading_deg=90.0)
        await asyncio.sleep(20.0)
        await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 25.0, 12.0])
        await asyncio.sleep(30.0)
        flight = await status(gcs)
        assert flight["state"] == "flying", flight
        assert flight["rms_m"] < 1.0, flight
        assert least_distance(gcs, since)[0] > MARGIN_M
        with pytest.raises(RefusedError, match="v1 leads"):
            await gcs("formation.move", to_enu_m=[0.0, 0.0, 12.0])


@pytest.mark.deep  # three vehicles fly for a minute
async def test_nobody_follows_a_leader_down_to_the_ground(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=3) as gcs:
        await gcs("formation.start", targets=["v2", "v3"], shape="line", spacing_m=8.0, leader="v1")
        await asyncio.sleep(15.0)
        await gcs.done("vehicles.land", targets="v1")
        await gcs.until(lambda: gcs.daemon.extensions["formation"].status()["state"] == "stopped", 60.0)
        assert "does not fly" in (await status(gcs))["reason"]
        await asyncio.sleep(5.0)
        assert all(gcs.place(name)[2] > 2.5 for name in ("v2", "v3"))
        with pytest.raises(RefusedError, match="leads, and does not fly"):
            await gcs("formation.start", targets=["v2", "v3"], leader="v1")


@pytest.mark.deep
async def test_a_velocity_ends_by_itself(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2) as gcs:
        await gcs("formation.start", targets=["v1", "v2"], shape="current")
        await gcs("formation.move", vel_enu_mps=[0.0, 1.5, 0.0], valid_s=6.0)
        await asyncio.sleep(6.0)
        away_m = gcs.place("v1")[1]
        assert away_m > 4.0
        await asyncio.sleep(10.0)
        assert gcs.place("v1")[1] < away_m + 4.0
        assert math.hypot(*gcs.truth[1][-1].vel_mps) < 0.3
        assert (await status(gcs))["state"] == "flying"


@pytest.mark.deep  # ends as when one leaves
async def test_an_order_to_a_member_takes_it_out(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2) as gcs:
        await gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=8.0)
        await at_places(gcs)
        await gcs.step(0.0, 10.0, 0.0, name="v1")
        await asyncio.sleep(12.0)
        assert "another order" in (await status(gcs))["reason"]
        assert gcs.place("v1")[1] > 8.0


async def test_a_client_takes_a_member_out_if_it_insists_and_one_client_guides_it(tmp_path: Path) -> None:
    a, b = (ClientIdentity(lambda name=name: name) for name in ("planner", "script"))  # type: ignore[misc]
    async with formed(tmp_path, px4=2) as gcs:
        await gcs.fly("position", targets="v1")
        await gcs.done("control.setpoint", client=a, pos_enu_m=[*gcs.place("v1")], valid_s=5.0)
        await gcs("formation.start", targets=["v1", "v2"], shape="current")
        for given, why in (({}, "the formation has taken it over"), ({"client": b}, "setpoints of the formation")):
            given = {"client": a, "pos_enu_m": [*gcs.place("v1")], **given}
            assert why in (await gcs.outcome("control.setpoint", **given))["message"]
        places = {"v1": {"pos_enu_m": list(gcs.place("v1"))}}
        await gcs("formation.guide", places=places, client=a)
        with pytest.raises(RefusedError, match="setpoints of planner, each valid for 1 s"):
            await gcs("formation.guide", places=places, client=b)
        await gcs("formation.guide", places=places, client=b, take_over=True)
        for how in ("script has taken it over", "another order"):
            with pytest.raises(RefusedError, match=how):
                await gcs("formation.guide", places=places, client=a if "script" in how else b)
            await gcs("formation.move")
        assert (await status(gcs))["state"] == "flying"
        await gcs.done("control.setpoint", client=b, take_over=True, pos_enu_m=[*gcs.place("v1")])
        await asyncio.sleep(1.0)
        assert "setpoints of a client" in (await status(gcs))["reason"]
        await gcs("formation.start", targets=["v1", "v2"], shape="current")
        await gcs("formation.stop")
        await asyncio.sleep(3.0)
        await gcs.done("control.setpoint", client=a, pos_enu_m=[*gcs.place("v1")])


@pytest.mark.deep
async def test_a_stop_that_comes_while_it_is_being_begun_ends_that(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2) as gcs:
        beginning = asyncio.create_task(gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=20.0))
        await asyncio.sleep(0.5)
        await gcs("formation.stop")
        with pytest.raises(RefusedError, match="stopped during its start"):
            await beginning
        since = gcs.now
        await asyncio.sleep(8.0)
        assert (await status(gcs))["state"] == "none"
        assert all(gcs.farthest_m(since, name) < 0.5 for name in ("v1", "v2"))


@pytest.mark.deep
async def test_a_vehicle_in_the_way_is_flown_around(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=3) as gcs:
        since, names = gcs.now, NAMES[:2]
        await gcs.fly("position", "v3")
        await gcs.done("vehicles.goto", targets="v3", enu_m=[2.5, 25.0, 10.0], force=True)
        await asyncio.sleep(20.0)
        await gcs("formation.start", targets=names, shape="current")
        await gcs("formation.move", to_enu_m=[2.5, 50.0, 10.0])
        await at_places(gcs, 120.0)
        assert gcs.place("v1")[1] > 45.0
        assert least_distance(gcs, since)[0] > MARGIN_M


class Program:
    """A client whose calls are those of a daemon in virtual time."""

    def __init__(self, gcs: Flown) -> None:
        self.call = gcs


@pytest.mark.deep
async def test_the_flock_of_the_examples_flies_in_its_box_and_stays_when_it_ends(tmp_path: Path) -> None:
    flock = runpy.run_path(str(ROOT / "configs" / "flock.py"))
    names = [*NAMES, "v5", "v6"]
    async with formed(tmp_path, px4=3, ardupilot=3) as gcs:
        since = gcs.now
        await gcs("formation.start", targets=names, shape="current")
        flying: dict[str, Any] = {}
        for _ in range(320):
            members = {name: (gcs.place(name), flying.get(name, (0.0, 0.0, 0.0))) for name in names}
            flying = await flock["guide"](Program(gcs), members)
            await asyncio.sleep(flock["PERIOD_S"])
            assert (await status(gcs))["leader"] == "program"
        assert least_distance(gcs, since)[0] > MARGIN_M
        for name in names:
            flown_m = [math.dist(a.pos_m, b.pos_m) for a, b in itertools.pairwise(gcs.truth[int(name[1:])])]
            assert math.fsum(flown_m) > 20.0
            x, y, up = gcs.place(name)
            assert abs(x) < 32.0 and abs(y) < 32.0
            assert 2.5 < up < 18.0  # around each other also below the box, not below lowest_m
        # those whose places were left for others come round them
        await asyncio.sleep(8.0)
        await gcs.until(lambda: all(math.hypot(*gcs.truth[int(n[1:])][-1].vel_mps) < 0.3 for n in names), 30.0)
        flight = await status(gcs)
        assert flight["leader"] == "virtual" and flight["settled"]


@pytest.mark.deep
async def test_a_new_shape_takes_over_from_a_programs_places(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2) as gcs:
        await gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=8.0)
        await gcs("formation.guide", places={"v1": {"pos_enu_m": [0.0, 20.0, 10.0]}}, valid_s=60.0)
        await asyncio.sleep(3.0)
        await gcs("formation.start", targets=["v1", "v2"], shape="column", spacing_m=9.0)
        await at_places(gcs)
        await asyncio.sleep(60.0)
        flight = await status(gcs)
        (a, b) = (member["place_enu_m"] for member in flight["members"])
        assert flight["settled"] and flight["leader"] == "virtual" and math.dist(a, b) == pytest.approx(9.0, abs=0.1)


async def test_a_programs_places_are_checked_and_a_leader_takes_over_from_it(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2) as gcs:
        await gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=8.0)
        with pytest.raises(RefusedError, match="v9: no members; there are v1, v2"):
            await gcs("formation.guide", places={"v9": {"pos_enu_m": [0.0, 0.0, 10.0]}})
        with pytest.raises(RefusedError, match="outside its control fence"):
            await gcs("formation.guide", places={"v1": {"pos_enu_m": [0.0, 500.0, 10.0]}})
        await gcs("formation.guide", places={"v1": {"pos_enu_m": [0.0, 20.0, 10.0]}}, valid_s=60.0)
        await asyncio.sleep(20.0)
        assert math.dist(gcs.place("v1"), (0.0, 20.0, 10.0)) < 1.0
        await gcs("formation.move")
        await at_places(gcs)
        assert (await status(gcs))["leader"] == "virtual"
        assert math.dist(gcs.place("v1"), (0.0, 20.0, 10.0)) < 1.0


async def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2) as gcs:
        with pytest.raises(RefusedError, match="no formation flies"):
            await gcs("formation.move", to_enu_m=[0.0, 0.0, 10.0])
        with pytest.raises(RefusedError, match="larger spacing"):
            await gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=2.0)
        with pytest.raises(RefusedError, match="outside its control fence"):
            await gcs("formation.start", targets=["v1", "v2"], shape="line", at_enu_m=[119.0, 0.0, 10.0])
        await gcs.fly("velocity", "v1")
        await gcs.done("control.setpoint", targets="v1", vel_enu_mps=[0.0, 3.0, 0.0], valid_s=4.0)
        await asyncio.sleep(3.0)
        with pytest.raises(RefusedError, match=r"v1 flies with 3\.\d m/s"):
            await gcs("formation.start", targets=["v1", "v2"], shape="line")
        await asyncio.sleep(8.0)
        with pytest.raises(RefusedError, match="no follower"):
            await gcs("formation.start", targets=["v1", "v2"], leader="v1")
        await gcs("formation.start", targets=["v1", "v2"], shape="line")
        with pytest.raises(RefusedError, match="they need"):
            await gcs("formation.scale", factor=0.2)
        with pytest.raises(RefusedError, match="outside"):
            await gcs("formation.move", to_enu_m=[0.0, 200.0, 10.0])
        assert (await status(gcs))["state"] == "flying"


async def test_a_gust_that_carries_one_away_stops_all(tmp_path: Path) -> None:
    async with formed(tmp_path, px4=2, conditions=Conditions()) as gcs:
        await gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=10.0)
        await at_places(gcs)
        gcs.sim("v2").motion.north_m += 12.0
        await gcs.until(lambda: gcs.daemon.extensions["formation"].status()["state"] != "flying", 5.0)
        assert "from its reference" in (await status(gcs))["reason"]
