"""A take-off ends at the height that was ordered above the ground it stands on, wherever home is."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.sim.conditions import conditions_of
from skygcs.sim.vehicle_state import Home
from support.flown import FIELD, KINDS, Flown, flown

WINDY = conditions_of(wind_mps=6.0)


def move_home(gcs: Flown, up_m: float, name: str = "v1") -> None:
    """As a station does: arming leaves it there."""
    gcs.sim(name).home_fixed = True
    gcs.sim(name).set_home(Home(0.0, 0.0, up_m))


@pytest.mark.deep
async def test_it_counts_from_the_ground_and_not_from_home(tmp_path: Path) -> None:
    """An ArduCopter with home 10 m above it went to 15 m, with home 3 m below to 2 m."""
    async with flown(tmp_path, px4=2, ardupilot=3, takeoff=False, conditions=WINDY) as gcs:
        for name, home_up_m in {"v1": 10.0, "v2": -3.0, "v3": 10.0, "v4": -3.0, "v5": -40.0}.items():
            move_home(gcs, home_up_m, name)
        await asyncio.sleep(2.0)
        await gcs.done("vehicles.takeoff", targets="all", height_m=5.0, wait_s=30.0)
        await asyncio.sleep(25.0)
        for i in range(1, 6):
            assert gcs.place(f"v{i}")[2] == pytest.approx(5.0, abs=0.7), f"v{i}"
        assert not [t for t in gcs.told if t.kind == "takeoff"]


@pytest.mark.deep
@KINDS
async def test_home_moves_between_the_order_and_the_climb(tmp_path: Path, kind: dict[str, int]) -> None:
    """By the arming, as an ArduCopter moves a home that no station set; and by a station after it has armed."""
    async with flown(tmp_path, takeoff=False, conditions=WINDY, **kind) as gcs:
        gcs.sim().set_home(Home(0.0, 0.0, 10.0))  # not set by a station: arming puts it where it stands
        await asyncio.sleep(2.0)
        await gcs.done("vehicles.takeoff", height_m=5.0, wait_s=30.0)
        await asyncio.sleep(30.0)
        assert gcs.place()[2] == pytest.approx(5.0, abs=0.7)
        await gcs.lands()
        ordered = asyncio.create_task(gcs.outcome("vehicles.takeoff", height_m=5.0, wait_s=30.0))
        await gcs.until(lambda: gcs.sim().armed, 10.0)
        move_home(gcs, 8.0)
        assert (await ordered)["ok"]
        await asyncio.sleep(30.0)
        assert gcs.place()[2] == pytest.approx(5.0, abs=0.7)


async def test_a_take_off_to_a_wrong_height_is_an_alarm(tmp_path: Path) -> None:
    """A station moves home after the height was computed: too high, and too low."""
    for home_up_m, word in ((6.0, "ordered"), (-3.0, "stopped climbing")):
        async with flown(tmp_path / word, px4=0, ardupilot=1, takeoff=False, conditions=WINDY) as gcs:
            sim, before = gcs.sim(), gcs.sim()._command_takeoff  # type: ignore[attr-defined]

            def late(c: object, sim=sim, before=before, gcs=gcs, up_m=home_up_m) -> int:  # type: ignore[no-untyped-def]
                move_home(gcs, up_m)
                return before(c)

            sim._command_takeoff = late  # type: ignore[attr-defined]
            await gcs.done("vehicles.takeoff", height_m=5.0, wait_s=30.0)
            await gcs.until(lambda gcs=gcs: gcs.texts(0.0, "takeoff"), 40.0)
            (text,) = gcs.texts(0.0, "takeoff")
            assert text.startswith("its take-off is wrong") and word in text and "5.0 m were ordered" in text


async def test_a_range_finder_and_a_home_at_another_height_are_refused(tmp_path: Path) -> None:
    """ArduCopter then counts from the ground if the sensor reaches so far, and from home if not."""
    async with flown(tmp_path, px4=0, ardupilot=1, takeoff=False) as gcs:
        move_home(gcs, -3.0)
        vehicle = gcs.actor().vehicle
        vehicle.slots[132] = vehicle.slots[33]
        await asyncio.sleep(2.0)
        outcome = await gcs.outcome("vehicles.takeoff", height_m=5.0, wait_s=3.0)
        assert "range finder" in outcome["message"] and "3.0 m below" in outcome["message"], outcome
        await gcs.until(lambda: not gcs.sim().armed, 5.0)


@pytest.mark.deep
@KINDS
async def test_a_goto_waits_until_the_take_off_has_ended(tmp_path: Path, kind: dict[str, int]) -> None:
    """1 s after the take-off it was accepted at .1 m, and flown."""
    async with flown(tmp_path, takeoff=False, conditions=WINDY, **kind) as gcs:
        await gcs.done("vehicles.takeoff", height_m=6.0, wait_s=30.0)
        assert gcs.place()[2] < 2.0
        await gcs.done("vehicles.goto", enu_m=[30.0, 0.0, 6.0])
        assert gcs.place()[2] > 5.0 and gcs.place()[0] < 3.0
        assert any("waits until its take-off has ended: it is taking off (" in t for t in gcs.texts(0.0, "command"))
        await asyncio.sleep(20.0)
        assert gcs.place()[0] > 25.0
        # one that a newer order takes the place of, or whose take-off is disturbed, is not carried out
        await gcs.lands()
        await gcs.done("vehicles.takeoff", height_m=15.0, wait_s=30.0)
        waits = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=[0.0, 0.0, 15.0]))
        await asyncio.sleep(2.0)
        await gcs.done("vehicles.hold")
        assert "a newer order took its place" in (await waits)["message"]
        await gcs.done("vehicles.goto", enu_m=[0.0, 0.0, 15.0])
        # nor is one in the frame that was another one when it was given: it went 45 m beside
        await gcs.lands()
        await gcs.done("vehicles.takeoff", height_m=15.0, wait_s=30.0)
        waits = asyncio.create_task(gcs.outcome("vehicles.goto", enu_m=[10.0, 0.0, 15.0]))
        await asyncio.sleep(1.0)
        await gcs("origin.set", lat_deg=FIELD.lat_deg + 0.0005, lon_deg=FIELD.lon_deg, alt_amsl_m=FIELD.alt_amsl_m)
        assert "frame was changed" in (await waits)["message"]
        # insisted on, it goes at once
        await gcs.lands()
        await gcs.done("vehicles.takeoff", height_m=15.0, wait_s=30.0)
        await gcs.done("vehicles.goto", enu_m=[0.0, 0.0, 15.0], force=True)
        assert gcs.place()[2] < 6.0
