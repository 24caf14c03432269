"""What may change while vehicles are flown by setpoints: places, origins, gains, streams; nobody jumps."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.vehicle.order_ledger import ClientIdentity
from support.flown import KINDS, Flown, aloft


def thrusts(gcs: Flown, since: float) -> list[float]:
    return [float(s.values["thrust"]) for s in gcs.setpoints(since) if s.name == "SET_ATTITUDE_TARGET"]


@pytest.mark.deep  # several vehicles under control
async def test_several_keep_their_formation(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, ardupilot=1) as gcs:
        await gcs.fly("attitude", targets="all")
        before = [gcs.place(name) for name in ("v1", "v2", "v3")]
        await gcs.done("vehicles.goto", targets="all", enu_m=[10.0, 6.0, 12.0])
        await asyncio.sleep(25)
        after = [gcs.place(name) for name in ("v1", "v2", "v3")]
        middle = [sum(axis) / 3 for axis in zip(*after, strict=True)]
        assert middle == pytest.approx([10.0, 6.0, 12.0], abs=0.4)
        for i in (1, 2):
            for axis in (0, 1):
                assert after[i][axis] - after[0][axis] == pytest.approx(before[i][axis] - before[0][axis], abs=0.5)
        one_place = (await gcs("control.setpoint", targets="all", pos_enu_m=[0.0, 0.0, 10.0]))["outcomes"]
        assert all(o["result"] == "refused" for o in one_place.values())


@KINDS
async def test_new_gains_make_no_jump_and_those_that_the_delay_does_not_bear_take_force(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(20)
        before = gcs.actor().offboard.gains()
        outcome = await gcs.outcome("control.gains", xy={"pos_p_per_s": 4.0, "vel_p": 0.9})
        assert outcome["result"] == "refused" and "force" in outcome["message"], outcome
        wrong = await gcs.outcome("control.gains", hover_thrust=0.95)
        assert wrong["result"] == "refused", wrong
        assert gcs.actor().offboard.gains() == before
        changes: tuple[dict[str, Any], ...] = (
            {"z": {"vel_p": 0.2, "vel_i": 0.03}},
            {"xy": {"pos_p_per_s": 0.7, "vel_p": 0.1}},
            {"hover_thrust": 0.40},
            {"hover_thrust": 0.55},
        )
        for change in changes:
            since = gcs.now
            await asyncio.sleep(0.5)
            changed = gcs.now
            await gcs.done("control.gains", **change, force=True)
            await asyncio.sleep(0.3)
            old, new = thrusts(gcs, since), thrusts(gcs, changed)
            assert new[0] == pytest.approx(old[-len(new) - 1], abs=0.01), change
            await asyncio.sleep(8)
            assert gcs.farthest_m(changed) < 0.3, change
            assert max(thrusts(gcs, changed)) - min(thrusts(gcs, changed)) < 0.05, change
            assert gcs.control()["control_mode"] == "attitude"


async def test_gains_set_on_the_ground_leave_the_hover_thrust_to_the_vehicle(tmp_path: Path) -> None:
    async with aloft(tmp_path, params={"MPC_THR_HOVER": 0.47}) as gcs:
        await gcs.done("control.gains", xy={"pos_p_per_s": 0.9})
        await gcs.fly("attitude")
        gains = gcs.actor().offboard.gains()
        assert gains["hover_thrust"] == pytest.approx(0.47, abs=1e-6) and gains["xy"]["pos_p_per_s"] == 0.9


async def test_one_client_leads_each_vehicle_and_orders_are_not_refused_for_it(tmp_path: Path) -> None:
    """Two that streamed were followed in turns, unseen."""
    a, b = (ClientIdentity(lambda name=name: name) for name in ("planner", "script"))  # type: ignore[misc]
    slow = {"vel_enu_mps": [0.5, 0.0, 0.0]}

    async with aloft(tmp_path, px4=2) as gcs:
        await gcs.fly("velocity", targets="all")
        began = gcs.now
        for _ in range(10):
            await gcs.done("control.setpoint", client=a, **slow)
            both = (await gcs("control.setpoint", targets="all", client=b, vel_enu_mps=[0.0, -0.5, 0.0]))["outcomes"]
            assert both["v2"]["ok"] and both["v1"]["taken"] and "setpoints of planner" in both["v1"]["message"], both
            await asyncio.sleep(0.05)
        shown = gcs.control()
        assert shown["stream"]["client"] == "planner" and 0.0 < shown["stream"]["left_s"] <= 0.5
        assert shown["setpoints_refused"] == 10 and gcs.control("v2")["setpoints_refused"] == 0
        await gcs.done("control.setpoint", client=b, take_over=True, **slow)
        for _ in range(30):  # longer than the deadline of what it took over with
            late = await gcs.outcome("control.setpoint", client=a, take_over=True, **slow)
            assert late["taken"] and "script has taken it over" in late["message"], late
            await asyncio.sleep(0.05)
        how = "take_over: true (--take-over) takes it over"
        again = "this client may begin again after a pause of 1 s, or when control is set again"
        assert gcs.texts(began) == [
            f"setpoints of script are refused: it follows the setpoints of planner, each valid for 0.5 s; {how}",
            "script has taken over from the setpoints of planner",
            f"setpoints of planner are refused: script has taken it over: {again}",
            "the setpoints ended: it stays where it is",
        ]
        for method, given in (
            ("vehicles.goto", {"enu_m": [0.0, 0.0, 10.0]}),
            ("control.set", {"mode": "off"}),
            ("vehicles.hold", {}),
            ("vehicles.rtl", {}),
            ("vehicles.land", {}),
        ):
            await gcs.fly("velocity")
            await gcs.done("control.setpoint", client=a, valid_s=5.0, **slow)
            await gcs.done(method, **given)
            assert not (await gcs.outcome("control.setpoint", client=a, take_over=True, **slow))["ok"], method
            assert gcs.control()["stream"] is None
