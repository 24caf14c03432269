"""What a flight was certified or entered with does not change under it: each order that would, in a whole daemon."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import RefusedError
from skygcs.sim.conditions import Conditions
from support.flown import PAIRS, Flown, aloft, flown
from support.planned import MARGIN_M, UP_M, above, here, least_distance, north, northwards, plan_events, run, state

WIND = Conditions(wind_enu_mps=(6.0, 0.0, 0.0))

LOCKED = {
    "px4": {
        "MAV_SYS_ID": 9.0,
        "COM_OF_LOSS_T": 5.0,
        "COM_OBL_RC_ACT": 0.0,
        "GF_MAX_HOR_DIST": 10.0,
        "SYS_AUTOSTART": 0.0,
    },
    "ardupilot": {
        "SYSID_THISMAV": 9.0,
        "FRAME_CLASS": 2.0,
        "GUID_TIMEOUT": 30.0,
        "FENCE_ENABLE": 1.0,
        "EK3_SRC1_YAW": 6.0,
    },
}
HARMLESS = {"px4": "SDLOG_MODE", "ardupilot": "LOG_BITMASK"}
TUNED = {"px4": ("MPC_XY_CRUISE", 4.0), "ardupilot": ("WPNAV_SPEED", 400.0)}


def family(kind: Mapping[str, int]) -> str:
    return "px4" if kind["px4"] else "ardupilot"


async def refused(gcs: Flown, method: str, **params: Any) -> str:
    """Why an order that raises or reports its refusal is refused."""
    try:
        answer = await gcs(method, **params)
    except RefusedError as error:
        return str(error)
    outcomes = [o for o in answer.get("outcomes", {}).values() if not o.get("ok", False)]
    assert outcomes, f"{method} was accepted: {answer}"
    return str(outcomes[0]["message"])


async def set_param(gcs: Flown, name: str, value: float, **params: Any) -> dict[str, Any]:
    answer = await gcs("params.set", targets="v1", params={name: value}, **params)
    outcome: dict[str, Any] = answer["outcomes"]["v1"][name]
    return outcome


async def origins_are_refused(gcs: Flown) -> None:
    """Turned, shifted by 6 m, and taken from a vehicle; the same one again is applied."""
    now = (await gcs("origin.get"))["origin"]
    for change in ({"x_heading_deg": 270.0}, {"lat_deg": now["lat_deg"] + 5.4e-5}):
        assert "`skygcs-cli " in await refused(gcs, "origin.set", **{**now, **change}, force=True)
    if gcs.place("v1")[2] > 1.0:  # on the ground it stands at the origin
        assert "`skygcs-cli " in await refused(gcs, "origin.from_vehicle", target="v1", force=True)
    assert (await gcs("origin.set", **now))["origin"] == now


@pytest.mark.deep
@PAIRS
async def test_an_origin_set_during_a_plan_changes_nothing_that_is_flown(tmp_path: Path, kind: dict[str, int]) -> None:
    async with flown(tmp_path, **kind, takeoff=False, conditions=WIND) as gcs:
        starts, began = above(gcs), gcs.now
        await run(gcs, northwards(starts))
        await gcs.until(lambda: state(gcs) == "takeoff", 60.0)
        await origins_are_refused(gcs)
        await gcs.until(lambda: state(gcs) == "flying", 120.0)
        await gcs.until(lambda: gcs.place("v1")[1] > 3.0, 30.0)
        await origins_are_refused(gcs)
        await gcs("plan.pause")
        await asyncio.sleep(5.0)
        await origins_are_refused(gcs)
        assert "in place" in (await gcs("plan.resume"))["message"] or state(gcs) == "flying"
        await gcs.until(lambda: state(gcs) in ("finished", "stopped", "aborted"), 60.0)
        assert state(gcs) == "finished", plan_events(gcs)
        assert all(math.dist(gcs.place(name), goal) < 0.8 for name, goal in north(starts).items())
        assert least_distance(gcs, began)[0] > MARGIN_M
        # with the plan over, the origin is anybody's
        now = (await gcs("origin.get"))["origin"]
        await asyncio.sleep(2.0)
        await gcs("origin.set", **{**now, "x_heading_deg": 270.0})


@PAIRS
@pytest.mark.parametrize("flight", ["control", "plan"])
async def test_what_a_flight_was_entered_with_is_refused_until_it_has_ended(
    tmp_path: Path, kind: dict[str, int], flight: str
) -> None:
    async with aloft(tmp_path, **kind, conditions=WIND) as gcs:
        if flight == "control":
            await gcs.fly("position")
            ends = "`skygcs-cli hold v1`"
        else:
            await run(gcs, northwards(here(gcs)))
            await gcs.until(lambda: state(gcs) in ("engaging", "to_starts"), 60.0)
            ends = "`skygcs-cli plan abort`"
        # what is locked, whoever insists
        for name, value in LOCKED[family(kind)].items():
            before = gcs.sim("v1").params.get(name)
            outcome = await set_param(gcs, name, value, force=True)
            assert outcome["result"] == "refused" and ends in outcome["message"], (name, outcome)
            assert gcs.sim("v1").params.get(name) == before
        # gains take somebody who insists; logs and the same again change nothing
        name, value = TUNED[family(kind)]
        assert (await set_param(gcs, name, value))["result"] == "refused"
        assert (await set_param(gcs, name, value, force=True))["ok"]
        assert (await set_param(gcs, HARMLESS[family(kind)], 1.0))["ok"]
        same = {"px4": ("COM_OF_LOSS_T", 1.0), "ardupilot": ("GUID_TIMEOUT", 1.0)}[family(kind)]
        assert (await set_param(gcs, *same))["ok"]
        # the link, the home, the fence, the id, its sensors
        assert ends in await refused(gcs, "links.remove", name="air")
        assert ends in await refused(gcs, "links.change", name="air", link={"type": "memory", "delay_s": 0.1})
        assert ends in await refused(gcs, "vehicles.set_home", targets="v1", force=True)
        assert ends in await refused(gcs, "fence.set", targets="v1", radius_m=40.0, force=True)
        assert await refused(gcs, "vehicles.renumber", target="v1", sysid=9)
        assert await refused(gcs, "vehicles.calibrate", targets="v1", sensor="gyro")
        assert gcs.control("v1")["state"] in ("flying", "engaging")
        # and afterwards they are applied
        if flight == "control":
            await gcs.done("vehicles.hold", targets="v1")
        else:
            await gcs("plan.abort")
            await gcs.until(lambda: state(gcs) == "aborted", 30.0)
        assert (await set_param(gcs, *LOCKED[family(kind)].popitem(), force=True))["ok"]


@PAIRS
async def test_a_fence_that_a_flying_vehicle_is_outside_of_is_refused(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind, conditions=WIND) as gcs:
        x, y, up = gcs.place("v1")
        await gcs.done("vehicles.goto", targets="v1", enu_m=[x, y + 15.0, up])
        await gcs.until(lambda: gcs.place("v1")[1] > y + 14.0, 60.0)
        await asyncio.sleep(3.0)
        mode = gcs.sim("v1").mode
        why = await refused(gcs, "fence.set", targets="v1", radius_m=10.0, action="return")
        assert "from its home" in why and "force" in why
        why = await refused(gcs, "fence.set", targets="v1", height_m=5.0, action="return")
        assert "above its home" in why
        await asyncio.sleep(3.0)
        assert gcs.sim("v1").mode == mode
        await gcs.done("fence.set", targets="v1", radius_m=40.0)
        since = gcs.now
        await gcs.done("fence.set", targets="v1", radius_m=10.0, action="return", force=True)
        await gcs.until(lambda: any("fence" in text.lower() for text in gcs.texts(since, "statustext")), 10.0)


@PAIRS
@pytest.mark.parametrize("moved", ["carried off", "switched"])
async def test_an_airborne_member_that_its_pilot_moved_is_not_sent_to_its_start(
    tmp_path: Path, kind: dict[str, int], moved: str
) -> None:
    """v1 takes off while v2, in the air, waits to be taken under control."""
    async with flown(tmp_path, **kind, takeoff=False, conditions=WIND) as gcs:
        await gcs.done("vehicles.takeoff", targets="v2", height_m=UP_M, wait_s=60.0)
        await gcs.until(lambda: abs(gcs.sim("v2").motion.up_m - UP_M) < 0.5, 60.0)
        await asyncio.sleep(5.0)
        await run(gcs, northwards({**above(gcs, "v1"), "v2": gcs.place("v2")}))
        await gcs.until(lambda: gcs.sim("v1").motion.up_m > 2.0, 60.0)
        since, hold = gcs.now, (4, 3) if kind["px4"] else (5, 0)
        if moved == "carried off":
            gcs.sim("v2").motion.east_m += 4.0
            hold = (4, 3) if kind["px4"] else (17, 0)  # BRAKE
        else:
            hold = (4, 5) if kind["px4"] else (5, 0)  # AUTO.RTL, LOITER
        gcs.other_sets_mode(*hold, sysid=2)
        await gcs.until(lambda: state(gcs) in ("stopped", "aborted"), 15.0)
        text = plan_events(gcs, since)[0]
        assert "v2" in text and ("from where the plan" in text or "switched to" in text), text
        await asyncio.sleep(10.0)
        assert not gcs.setpoints(since, "v2") and state(gcs) in ("stopped", "aborted")
