"""The user's own controller flies a vehicle: what is sent, what is refused, and what ends it."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.control.trace import decode
from skygcs.core.geo import Origin
from skygcs.errors import RefusedError
from support.flown import KINDS, Flown, aloft

LEVEL = {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 90.0}


async def streams(gcs: Flown, seconds: float, **setpoint: Any) -> list[dict[str, Any]]:
    """Fifty a second; the outcomes that were not ok."""
    refused = []
    for _ in range(round(seconds * 50)):
        outcome = await gcs.outcome("control.setpoint", **setpoint)
        if not outcome["ok"]:
            refused.append(outcome)
        await asyncio.sleep(0.02)
    return refused


@KINDS
async def test_attitude_and_thrust_are_sent_as_they_are_and_their_deadline_holds(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        outcome = await gcs.outcome("control.set", mode="raw")
        assert outcome["ok"] and outcome["message"].startswith("flown by raw setpoints"), outcome
        await asyncio.sleep(1.0)
        assert {s.name for s in gcs.setpoints(gcs.now - 0.9)} == {"SET_POSITION_TARGET_GLOBAL_INT"}, "none is in force"
        assert gcs.control()["mode"] == "raw" and gcs.control()["raw"] is None
        began = gcs.now
        thrust = 0.5
        assert not await streams(gcs, 0.4, roll_deg=6.0, pitch_deg=0.0, yaw_deg=90.0, thrust=thrust)
        assert gcs.control()["control_mode"] == "raw" and gcs.control()["raw"] == "attitude"
        sent = gcs.setpoints(began)
        assert {s.name for s in sent[2:]} == {"SET_ATTITUDE_TARGET"} and len(sent) >= 18
        values = sent[-1].values
        assert values["type_mask"] == 7
        # nose north, right side down by 6 degrees: in NED the yaw is 0
        assert values["q"] == pytest.approx([math.cos(math.radians(3)), math.sin(math.radians(3)), 0, 0], abs=1e-6)
        boosted = math.cos(math.radians(6)) if "ardupilot" in kind else 1.0
        assert values["thrust"] == pytest.approx(thrust * boosted, abs=1e-6)
        ended = gcs.now
        await asyncio.sleep(3.0)
        assert gcs.texts(ended) == ["the raw setpoints ended: it holds its position by position setpoints"]
        # an ArduCopter is given a lean against its motion first
        assert {s.name for s in gcs.setpoints(ended + 1.0)} == {"SET_POSITION_TARGET_GLOBAL_INT"}
        assert gcs.control()["control_mode"] == "position" and gcs.control()["raw"] is None
        # a next one is flown again, at once
        again = gcs.now
        await gcs.done("control.setpoint", **LEVEL, thrust=0.5)
        await asyncio.sleep(0.06)
        assert [s.name for s in gcs.setpoints(again)][-1] == "SET_ATTITUDE_TARGET"


@KINDS
async def test_body_rates_and_accelerations_give_what_the_masks_say(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.outcome("control.set", mode="raw")
        began = gcs.now
        assert not await streams(gcs, 0.1, body_rates_deg_s=[3.0, -2.0, 1.0], thrust=0.5)
        values = gcs.setpoints(began)[-1].values
        assert values["type_mask"] == 128
        rates = [values[f"body_{axis}_rate"] for axis in ("roll", "pitch", "yaw")]
        assert rates == pytest.approx([math.radians(3), math.radians(-2), math.radians(-1)], abs=1e-6)
        began = gcs.now
        assert not await streams(gcs, 0.1, acc_enu_mps2=[0.5, 0.25, 0.125], yaw_deg=0.0)
        sent = gcs.setpoints(began)[-1]
        assert sent.name == "SET_POSITION_TARGET_LOCAL_NED" and sent.values["type_mask"] == 0b1000_0011_1111
        acc = [sent.values[f"af{axis}"] for axis in "xyz"]
        assert acc == pytest.approx([0.25, 0.5, -0.125], abs=1e-6)
        assert sent.values["yaw"] == pytest.approx(math.pi / 2)


@pytest.mark.deep  # flies along each axis
async def test_axes_are_those_of_the_fleets_frame(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        origin = gcs.daemon.fleet.origin
        assert origin is not None
        turned = Origin(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, x_heading_deg=0.0)
        gcs.daemon.fleet.set_origin(turned, force=True)  # x is north
        await gcs.outcome("control.set", mode="raw")
        began = gcs.now
        assert not await streams(gcs, 0.1, acc_enu_mps2=[0.5, 0.25, 0.0])
        values = gcs.setpoints(began)[-1].values
        assert [values["afx"], values["afy"]] == pytest.approx([0.5, -0.25], abs=1e-6)
        assert not await streams(gcs, 0.1, attitude=[1.0, 0.0, 0.0, 0.0], thrust=0.5)
        assert gcs.setpoints(began)[-1].values["q"] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    ("setpoint", "why"),
    [
        ({"roll_deg": 36.0, "pitch_deg": 0.0, "yaw_deg": 0.0, "thrust": 0.5}, "a tilt of 36 degrees is above 35"),
        ({"attitude": [0.0, 1.0, 0.0, 0.0], "thrust": 0.5}, "a tilt of 180 degrees is above 35"),
        ({"attitude": [1.0, 1.0, 0.0, 0.0], "thrust": 0.5}, "norm 1.414"),
        ({**LEVEL, "thrust": 0.95}, "a thrust of 0.95 is not in 0.1..0.9"),
        ({**LEVEL, "thrust": 0.05}, "a thrust of 0.05 is not in 0.1..0.9"),
        (LEVEL, "needs a thrust"),
        ({"roll_deg": 1.0, "thrust": 0.5}, "needs roll_deg, pitch_deg and yaw_deg"),
        ({"body_rates_deg_s": [0.0, 181.0, 0.0], "thrust": 0.5}, "a pitch rate of 181 degrees/s is above 180"),
        ({"acc_enu_mps2": [4.0, 4.0, 0.0]}, "an acceleration of 5.66 m/s² is above 5"),
        ({"acc_enu_mps2": [0.0, 0.0, 0.0], "thrust": 0.5}, "no thrust beside"),
        ({**LEVEL, "body_rates_deg_s": [0.0, 0.0, 0.0], "thrust": 0.5}, "not an attitude and body rates"),
        ({"pos_enu_m": [0.0, 0.0, 10.0]}, "it is flown in raw"),
    ],
)
async def test_a_setpoint_beyond_a_limit_is_refused_and_the_one_before_stays(
    tmp_path: Path, setpoint: dict[str, Any], why: str
) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.outcome("control.set", mode="raw")
        await gcs.done("control.setpoint", **LEVEL, thrust=0.5)
        outcome = await gcs.outcome("control.setpoint", **setpoint)
        assert not outcome["ok"] and why in outcome["message"], outcome
        since = gcs.now
        await asyncio.sleep(0.3)
        assert {s.name for s in gcs.setpoints(since)} == {"SET_ATTITUDE_TARGET"}
        await asyncio.sleep(0.5)
        assert gcs.control()["control_mode"] == "position", "a refused one has no deadline to extend"


async def test_without_the_order_raw_is_refused(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.fly("position")
        outcome = await gcs.outcome("control.setpoint", **LEVEL, thrust=0.5)
        assert not outcome["ok"] and "control set v1 raw" in outcome["message"], outcome


async def test_an_arducopter_whose_thrust_is_a_climb_rate_is_refused(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=1, params={"GUID_OPTIONS": 0}) as gcs:
        outcome = await gcs.outcome("control.set", mode="raw")
        assert not outcome["ok"] and "GUID_OPTIONS" in outcome["message"], outcome
        assert not gcs.setpoints(0.0)


@pytest.mark.deep
@KINDS
async def test_it_is_stopped_before_the_fence_though_the_setpoint_would_lead_out(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    control = {"fence": {"x_m": [-20, 20], "y_m": [-20, 20], "up_m": [0, 90]}, "raw": {"tilt_max_deg": 20}}
    async with aloft(tmp_path, control=control, **kind) as gcs:
        await gcs.outcome("control.set", mode="raw")
        began = gcs.now
        tilt = math.radians(12)
        thrust = 0.5 / math.cos(tilt)
        refused = await streams(gcs, 12.0, roll_deg=0.0, pitch_deg=-12.0, yaw_deg=0.0, thrust=thrust)
        assert refused and "after its last setpoint" in refused[0]["message"], refused[:1]
        (text,) = [t for t in gcs.texts(began) if "its own controller flies no more" in t]
        assert "the vehicle is at x" in text
        await asyncio.sleep(5.0)
        assert max(t.pos_m[0] for t in gcs.truth[1]) < 20.0
        assert gcs.control()["state"] == "flying", "it stays where it is, inside"
        assert {s.name for s in gcs.setpoints(gcs.now - 2.0)} == {"SET_POSITION_TARGET_GLOBAL_INT"}


@pytest.mark.deep
async def test_delay_ends_it_and_only_an_order_begins_it_again(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs.outcome("control.set", mode="raw")
        flying = asyncio.create_task(streams(gcs, 8.0, **LEVEL, thrust=0.5))
        await asyncio.sleep(1.0)
        slow = gcs.now
        gcs.uplink_delay_s = 0.3
        fell = await gcs.until(lambda: gcs.control()["control_mode"] == "position", 6.0)
        gcs.uplink_delay_s = 0.0
        assert fell - slow < 5.0 and "state age plus setpoint transport is" in " ".join(gcs.texts(slow))
        refused = await flying
        assert refused and "raw setpoints are not flown: " in refused[-1]["message"], refused[-1:]
        assert gcs.control()["control_mode"] == "position", "not by itself"
        await asyncio.sleep(10.0)  # the delay that was measured is forgotten
        outcome = await gcs.outcome("control.set", mode="raw")
        assert outcome["ok"], outcome
        assert not await streams(gcs, 0.2, **LEVEL, thrust=0.5)
        assert gcs.control()["control_mode"] == "raw"


@KINDS
@pytest.mark.parametrize("order", ["land", "hold"])
async def test_an_order_ends_it_at_once(tmp_path: Path, kind: dict[str, int], order: str) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.outcome("control.set", mode="raw")
        flying = asyncio.create_task(streams(gcs, 3.0, **LEVEL, thrust=0.5))
        await asyncio.sleep(1.0)
        await gcs.done(f"vehicles.{order}")
        ended = gcs.now
        assert (await flying)[-1]["message"].startswith("refused: control is off")
        assert not gcs.setpoints(ended)


@KINDS
async def test_sigterm_while_it_flies_holds(tmp_path: Path, kind: dict[str, int]) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.outcome("control.set", mode="raw")
        await streams(gcs, 1.0, roll_deg=3.0, pitch_deg=0.0, yaw_deg=90.0, thrust=0.5)
        ended = gcs.now
        await gcs.stopped(4.0)
        assert gcs.hold_commands & {c.values["command"] for c in gcs.commands(ended - 0.01)}
        await gcs.ends_safe(within_m=6.0, since=ended)


@pytest.mark.deep  # a controller at 50 Hz
@KINDS
async def test_an_own_controller_of_accelerations_flies_a_step(tmp_path: Path, kind: dict[str, int]) -> None:
    """PD on position and velocity as reported, in the test; gravity and thrust are the autopilot's."""
    async with aloft(tmp_path, **kind) as gcs:
        await gcs.outcome("control.set", mode="raw")
        goal = (gcs.place()[0] + 2.0, gcs.place()[1], gcs.place()[2])
        for _ in range(600):
            state = gcs.actor().state(gcs.now)["position"]
            acc = [1.0 * (g - p) - 1.6 * v for g, p, v in zip(goal, state["enu_m"], state["vel_enu_mps"], strict=True)]
            await gcs.done("control.setpoint", acc_enu_mps2=[max(-3.0, min(3.0, a)) for a in acc])
            await asyncio.sleep(0.02)
        assert math.dist(gcs.place(), goal) < 0.5, gcs.place()
        assert gcs.control()["control_mode"] == "raw" and gcs.control()["raw"] == "acceleration"


@KINDS
async def test_body_rates_that_never_end_are_ended_by_the_tilt_that_is_reported(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with aloft(tmp_path, control={"raw": {"tilt_max_deg": 10}}, **kind) as gcs:
        await gcs.outcome("control.set", mode="raw")
        since = gcs.now
        refused = await streams(gcs, 2.0, body_rates_deg_s=[30.0, 0.0, 0.0], thrust=0.5)
        assert refused and "the vehicle tilts by" in refused[0]["message"], refused[:1]
        (text,) = [t for t in gcs.texts(since) if "flies no more" in t]
        assert "limit 20°" in text
        await asyncio.sleep(8.0)
        assert gcs.control()["control_mode"] == "position" and gcs.farthest_m(since) < 8.0
        assert math.hypot(*gcs.truth[1][-1].vel_mps) < 0.5


async def test_the_trace_has_what_was_sent(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        await gcs("control.record", targets="v1", on=True)
        await gcs.outcome("control.set", mode="raw")
        await streams(gcs, 0.3, body_rates_deg_s=[9.0, 0.0, -18.0], thrust=0.5)
        await streams(gcs, 0.3, acc_enu_mps2=[0.1, 0.2, 0.3])
        path = Path((await gcs("control.record", targets="v1", on=False))["files"]["v1"])
        await gcs.done("control.set", mode="off")
        await asyncio.sleep(1.0)
        lines = (await asyncio.to_thread(path.read_text)).splitlines(keepends=True)
        rows = [entry.row for entry in decode(lines) if entry.row.control_mode == "raw"]
        rates = {row.rates_frd_radps for row in rows if row.rates_frd_radps is not None}
        assert len(rates) == 1 and rates.pop() == pytest.approx((math.radians(9), 0.0, math.radians(18)))
        acc = {row.acc_setpoint_enu_mps2 for row in rows if row.acc_setpoint_enu_mps2 is not None}
        assert len(acc) == 1 and acc.pop() == pytest.approx((0.1, 0.2, 0.3))


async def test_messages_that_fly_stay_refused_and_name_the_guarded_way(tmp_path: Path) -> None:
    async with aloft(tmp_path) as gcs:
        values = {"type_mask": 7, "q": [1.0, 0.0, 0.0, 0.0], "thrust": 0.5}
        with pytest.raises(RefusedError, match="control set raw"):
            await gcs("messages.send", name="SET_ATTITUDE_TARGET", target="v1", fields=values)
