"""Returns one after another of PX4s of which one holds above its home for good (RTL_LAND_DELAY below 0)."""

from __future__ import annotations

import asyncio
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.firmware_modes import Px4Mode
from support.flown import FIELD, Flown, aloft
from support.planned import MARGIN_M, least_distance
from support.sim_pilot import int_param

HOLDS_UP_M = 10.0

HOLDS = {"RTL_LAND_DELAY": -1.0, "RTL_DESCEND_ALT": HOLDS_UP_M}
LANDS = {"RTL_LAND_DELAY": 0.0}
BOTH = {"RTL_TYPE": int_param(0), "RTL_CONE_ANG": int_param(0), "RTL_RETURN_ALT": 12.0}


async def apart(gcs: Flown, places: dict[str, tuple[float, float]]) -> None:
    """v1 returns and holds, the others return and land; each is at its place (east, north)."""
    for target, own in (("v1", HOLDS), ("v2,v3", LANDS)):
        await gcs("params.set", targets=target, params=own, force=True)
    for name, place in places.items():
        await gcs.done("vehicles.goto", targets=name, enu_m=[*place, HOLDS_UP_M], force=True)
    await asyncio.sleep(25.0)


async def test_those_whose_way_one_that_holds_at_its_home_is_in_fly_home_above_it(tmp_path: Path) -> None:
    """They waited for it to land until they were given up, 45 s later."""
    async with aloft(tmp_path, px4=3, params=BOTH) as gcs:
        # v1's home is in the way of v2, and not in that of v3
        await apart(gcs, {"v1": (0.0, 15.0), "v2": (-20.0, 0.0), "v3": (10.0, 15.0)})
        since = gcs.now
        await gcs("vehicles.rtl", targets="all")
        await gcs.until(lambda: not gcs.sim("v2").armed and not gcs.sim("v3").armed, 120.0)
        assert gcs.sim("v1").mode == Px4Mode.RTL and abs(gcs.place("v1")[2] - HOLDS_UP_M) < 0.5, "it holds there"
        assert any("above v1, and returns then" in text for text in gcs.texts(since, "command", "v2"))
        assert any("it holds at the end of its return" in text for text in gcs.texts(since, "command", "v1"))
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert not [t for t in gcs.told if "does not return" in t.text]


async def test_one_that_is_forgotten_while_it_holds_at_its_home_is_in_nobodys_way(tmp_path: Path) -> None:
    """Its name was looked up in each later decision, which failed."""
    async with aloft(tmp_path, px4=1) as gcs:
        returns, actor = gcs.daemon.fleet.returns, gcs.actor("v1")
        members = returns._members
        members.add((actor,))
        members.staying.add(actor.vehicle.key)
        gcs.muted.add(1)
        await asyncio.sleep(8.0)
        await gcs.done("vehicles.forget", force=True)
        returns._leave_out_gone()
        assert not members.keys() and members.staying == set()


async def test_one_that_cannot_come_by_it_is_given_up_at_once(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=3, params=BOTH) as gcs:
        lat, lon = FIELD.to_geodetic(10.0, 0.0)
        home = mav.MAVLink_command_int_message(1, 1, 0, 179, 0, 0, 0, 0, 0, 0, int(lat * 1e7), int(lon * 1e7), 180.0)
        gcs.by_other_station(home)  # v1's home is above that of v3 now
        await apart(gcs, {"v1": (10.0, 10.0), "v2": (-20.0, 0.0), "v3": (10.0, 30.0)})
        since = gcs.now
        await gcs("vehicles.rtl", targets="all")
        holds = await gcs.until(lambda: gcs.sim("v1").mode == Px4Mode.RTL and abs(gcs.place("v1")[1]) < 0.5, 60.0)
        await gcs.until(
            lambda: any("v1 after a return that ends in a hold" in t for t in gcs.texts(since, "command", "v3")), 20.0
        )
        (text,) = [t for t in gcs.texts(holds, "command", "v3") if "does not return" in t]
        assert "skygcs-cli rtl v3" in text
        assert gcs.is_safe("v3") and gcs.sim("v3").armed
        assert least_distance(gcs, since)[0] > MARGIN_M
