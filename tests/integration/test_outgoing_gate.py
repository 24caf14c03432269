"""The outgoing gate in whole daemons with vehicles in the air: modes by sticks, raw messages, parameters, and one
judgement of a vehicle that has landed. PX4 and ArduCopter."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.errors import RefusedError
from support.flown import Flown, aloft, flown
from support.planned import UP_M, run, state, timed
from support.sim_pilot import int_param

KINDS = pytest.mark.parametrize("kind", [{"px4": 1, "ardupilot": 0}, {"px4": 0, "ardupilot": 1}], ids=["px4", "copter"])
FALLS = {"px4": ("MANUAL", "ACRO", "STABILIZED"), "ardupilot": ("STABILIZE", "ACRO")}
INSISTED = {"px4": ("ALTCTL", "POSCTL"), "ardupilot": ("ALT_HOLD", "LOITER", "GUIDED_NOGPS")}


async def raw(gcs: Flown, method: str, **params: Any) -> str:
    """The refusal of a raw message, or "" if it was sent."""
    try:
        answer = await gcs(method, **params)
    except RefusedError as error:
        return str(error)
    outcomes = answer.get("outcomes", {})
    return "".join(o["message"] for o in outcomes.values() if not o["ok"])


@KINDS
async def test_no_order_and_no_raw_door_leads_into_a_mode_by_sticks_or_past_the_list(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        family = gcs.actor().vehicle.family
        former, height_m, sent = gcs.sim().mode, gcs.place()[2], len(gcs.sent)
        # modes, for all and for one
        for name in (*FALLS[family], *INSISTED[family]):
            outcome = await gcs.outcome("vehicles.mode", "all", mode=name)
            assert outcome["result"] == "refused" and "no sticks are seen" in outcome["message"], outcome
            assert ("--force" in outcome["message"]) is (name in INSISTED[family])
        for name in FALLS[family]:
            assert (await gcs.outcome("vehicles.mode", mode=name, force=True))["result"] == "refused"
        # what the audit sent
        for name, fields in (
            ("SET_MODE", {"base_mode": 128, "custom_mode": 0}),
            ("ODOMETRY", {}),
            ("VISION_POSITION_ESTIMATE", {}),
            ("GPS_INPUT", {}),
            ("PARAM_SET", {"param_id": "FENCE_ENABLE", "param_value": 0.0}),
            ("PARAM_SET", {"param_id": "MAV_SYS_ID", "param_value": 9.0}),
        ):
            assert "--force" in await raw(gcs, "messages.send", name=name, fields=fields, target="v1"), name
        for command in (5300, 42007, 420):
            assert "--force" in await raw(gcs, "vehicles.command", targets="v1", command=command, params=[1.0])
        names = {"px4": ("GF_ACTION", "MAV_SYS_ID"), "ardupilot": ("FENCE_ENABLE", "SYSID_THISMAV")}[family]
        for name in names:
            outcome = (await gcs("params.set", targets="v1", params={name: 3}))["outcomes"]["v1"][name]
            assert outcome["result"] == "refused" and "--force" in outcome["message"], outcome
        await asyncio.sleep(3)
        assert gcs.sim().mode == former and abs(gcs.place()[2] - height_m) < 0.5
        moving = [s.name for s in gcs.sent[sent:] if s.name in ("SET_MODE", "PARAM_SET", "ODOMETRY", "GPS_INPUT")]
        assert moving == [] and gcs.daemon.hub.gate.blocked == 0, "nothing reached the gate's last place"


@KINDS
async def test_a_part_of_skygcs_without_a_clearance_sends_what_is_harmless_only(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    async with aloft(tmp_path, **kind) as gcs:
        hub, dialect = gcs.daemon.hub, gcs.daemon.dialect
        long, ping = dialect.by_name["COMMAND_LONG"], dialect.by_name["PING"]
        disarm = {"target_system": 1, "target_component": 1, "command": 400, "param1": 0.0, "param2": 21196.0}
        assert not hub.send(long, disarm, 1, 1, Priority.EMERGENCY)
        assert not hub.send_on(tuple(hub.channels), long, {**disarm, "target_system": 0}, Priority.COMMAND)
        assert hub.send(ping, {"target_system": 1, "target_component": 1}, 1, 1, Priority.PROTOCOL)
        await asyncio.sleep(2)
        assert gcs.sim().armed and hub.gate.blocked == 2
        faults = [t for t in gcs.told if t.kind == "fault"]
        assert len(faults) == 1 and "outgoing gate" in faults[0].text
        gcs.told.remove(faults[0])  # it was made here


async def test_a_plan_begins_in_the_mode_that_a_landing_left_to_a_px4(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, takeoff=False) as gcs:
        await gcs.done("vehicles.mode", mode="AUTO.LAND")
        x, y, _ = gcs.place_of_home()
        await run(gcs, timed({"v1": (x, y, UP_M)}, {"v1": (x, y + 4.0, UP_M)}))
        await gcs.until(lambda: state(gcs) in ("flying", "finished", "stopped", "aborted"), 60.0)
        assert state(gcs) in ("flying", "finished")


async def test_every_engagement_says_what_happens_when_this_station_dies(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1, ardupilot=0) as gcs:
        gcs.sim().params.set("COM_OBL_RC_ACT", int_param(0))
        await gcs.fly("position")
        warned = [t.text for t in gcs.told if t.kind == "warning" and "COM_OBL_RC_ACT" in t.text]
        assert len(warned) == 1 and "no sticks are seen" in warned[0] and "sinks" in warned[0]
