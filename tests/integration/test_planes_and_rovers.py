"""Planes and a rover under a whole daemon: what moves them, what holds them, and what they refuse.

Where they are is the simulator's truth; what their modes are called, pymavlink says.
"""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from skygcs.config.models import FleetConfig
from skygcs.errors import RefusedError
from skygcs.ext.formation.config import FormationConfig
from skygcs.sim.vehicle import SimVehicle
from support.flown import FIELD, Flown, flown
from support.planned import MARGIN_M, above, load, northwards

EMPTY: dict[str, Any] = {"px4": 0, "takeoff": False}


def away_m(sim: SimVehicle, east_m: float, north_m: float) -> float:
    return math.hypot(sim.motion.east_m - east_m, sim.motion.north_m - north_m)


def mode_of(sim: SimVehicle) -> str:
    """By pymavlink's tables."""
    if sim.autopilot == 12:
        return str(mavutil.interpret_px4_mode(0x1D, sim.mode))
    return str(mavutil.mode_mapping_bynumber(sim.mav_type)[sim.mode])


async def refusal(gcs: Flown, method: str, **params: Any) -> str:
    """The reason of a refused order, for which nothing was sent."""
    commands = [s for s in gcs.sent if s.name.startswith("COMMAND") or s.name == "SET_MODE"]
    outcome = await gcs.outcome(method, **params)
    assert not outcome["ok"], outcome
    sent = [s for s in gcs.sent if s.name.startswith("COMMAND") or s.name == "SET_MODE"]
    known = (512, 511, 510, 42428)  # requests of messages and of the banner
    assert [s for s in sent[len(commands) :] if s.values.get("command") not in known] == []
    return str(outcome["message"])


async def test_a_rover_goes_holds_where_it_stops_and_returns(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"rover": 1}) as gcs:
        rover = gcs.sims[0]
        assert gcs.actor().vehicle.kind == "rover"
        assert "arm it first" in await refusal(gcs, "vehicles.goto", enu_m=[20, 30, 0])
        assert "does not take off; goto or mission start moves it" in await refusal(gcs, "vehicles.takeoff", height_m=5)
        await gcs.done("vehicles.arm", wait_s=60.0)
        await gcs.done("vehicles.goto", enu_m=[20, 30, 0])
        assert mode_of(rover) == "GUIDED"
        await gcs.until(lambda: rover.motion.groundspeed_mps > 1.5)
        assert gcs.actor().vehicle.in_air(gcs.now) is False
        await gcs.done("vehicles.hold")
        assert mode_of(rover) == "HOLD"
        await gcs.until(lambda: rover.motion.groundspeed_mps == 0.0)
        stands = rover.motion.pos_enu_m
        assert 1.0 < away_m(rover, 0, 0) < 34.0
        await asyncio.sleep(20)
        assert rover.motion.pos_enu_m == stands
        # on, to its end, and home
        await gcs.done("vehicles.goto", enu_m=[20, 30, 0])
        await gcs.until(lambda: away_m(rover, 20, 30) <= rover.params["WP_RADIUS"], 60.0)
        await asyncio.sleep(5)
        assert rover.motion.groundspeed_mps == 0.0 and away_m(rover, 20, 30) <= rover.params["WP_RADIUS"]
        assert "does not land; hold or stop it" in await refusal(gcs, "vehicles.land")
        await gcs.done("vehicles.rtl")
        assert mode_of(rover) == "RTL"
        await gcs.until(lambda: away_m(rover, 0, 0) <= rover.params["WP_RADIUS"], 60.0)
        await gcs.done("vehicles.disarm")
        assert not rover.armed


async def disarmed_on_its_way(gcs: Flown) -> SimVehicle:
    """Drive the rover, disarm it in GUIDED on its way, and wait until it stands."""
    rover = gcs.sims[0]
    await gcs.done("vehicles.arm", wait_s=60.0)
    await gcs.done("vehicles.goto", enu_m=[0, 60, 0])
    await gcs.until(lambda: rover.motion.groundspeed_mps > 1.5)
    await gcs.done("vehicles.disarm")
    await gcs.until(lambda: rover.motion.groundspeed_mps == 0.0)
    return rover


async def test_a_rover_that_is_disarmed_on_its_way_coasts_to_a_stop(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"rover": 1}) as gcs:
        rover = await disarmed_on_its_way(gcs)
        assert away_m(rover, 0, 60) > 30
        # armed again it would drive on to its place; out of GUIDED and back it stands
        assert "may drive on at once" in await refusal(gcs, "vehicles.arm")
        stands = rover.motion.pos_enu_m
        await gcs.done("vehicles.mode", mode="HOLD")
        await gcs.done("vehicles.arm")
        await asyncio.sleep(10)
        assert rover.motion.pos_enu_m == stands
        await gcs.done("vehicles.mode", mode="GUIDED")
        await asyncio.sleep(10)
        assert rover.motion.pos_enu_m == stands


async def test_a_rover_that_is_made_to_arm_in_guided_drives_on(tmp_path: Path) -> None:
    """ModeGuided::update goes on where it was (Rover/mode_guided.cpp)."""
    async with flown(tmp_path, **EMPTY, others={"rover": 1}) as gcs:
        rover = await disarmed_on_its_way(gcs)
        await gcs.done("vehicles.arm", force=True)
        await gcs.until(lambda: away_m(rover, 0, 60) <= rover.params["WP_RADIUS"], 60.0)


async def test_a_heading_of_a_goto_is_refused_before_a_rover_drives_off(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"rover": 1}) as gcs:
        await gcs.done("vehicles.arm", wait_s=60.0)
        assert "takes no heading; leave it out" in await refusal(gcs, "vehicles.goto", enu_m=[0, 60, 0], yaw_deg=90)


async def test_an_arduplane_takes_off_to_its_own_height_goes_and_circles(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"ardupilot_plane": 1}) as gcs:
        plane = gcs.sims[0]
        await gcs.until(lambda: gcs.actor().vehicle.param("TKOFF_ALT") is not None)
        assert "its TKOFF_ALT (50 m), not to 20 m" in await refusal(gcs, "vehicles.takeoff", height_m=20)
        await gcs.done("vehicles.takeoff", height_m=50, wait_s=60.0)
        assert mode_of(plane) == "TAKEOFF"
        await gcs.until(lambda: plane.motion.up_m > 47, 60.0)
        assert "taking off" in str(gcs.actor().takeoffs.under_way()) or plane.motion.up_m > 47
        assert "would fall" in await refusal(gcs, "vehicles.disarm")
        # goto ends in a circle about the place, of the radius of its parameter
        await gcs.done("vehicles.goto", lat_deg=FIELD.lat_deg + 0.003, lon_deg=FIELD.lon_deg, height_m=60)
        assert mode_of(plane) == "GUIDED"
        north_m = FIELD.to_local(FIELD.lat_deg + 0.003, FIELD.lon_deg)[1]
        await gcs.until(lambda: away_m(plane, 0, north_m) < 65, 90.0)
        await asyncio.sleep(20)
        ring = []
        for _ in range(30):
            await asyncio.sleep(1)
            ring.append(away_m(plane, 0, north_m))
        assert all(abs(radius_m - 60) < 6 for radius_m in ring), ring
        assert abs(plane.motion.up_m - 60) < 2
        # hold circles about where it was, and so does the emergency stop
        outcome = await gcs.outcome("vehicles.hold")
        assert outcome["ok"] and "circling in LOITER, 60 m about where it was" in outcome["message"]
        where = plane.motion.pos_enu_m
        await asyncio.sleep(60)
        assert mode_of(plane) == "LOITER" and away_m(plane, *where[:2]) < 70 and plane.motion.groundspeed_mps > 9
        # it lands by a mission only, and it has none
        outcome = await gcs.outcome("vehicles.land")
        assert not outcome["ok"] and "DO_LAND_START" in outcome["message"], outcome
        await gcs.done("vehicles.rtl")
        await gcs.until(lambda: away_m(plane, 0, 0) < 65, 90.0)
        await asyncio.sleep(30)
        assert mode_of(plane) == "RTL" and away_m(plane, 0, 0) < 70 and abs(plane.motion.up_m - 100) < 10


async def test_a_refused_arming_leaves_an_arduplane_in_a_mode_without_sticks(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"ardupilot_plane": 1}) as gcs:
        plane = gcs.sims[0]
        await gcs.until(lambda: gcs.actor().vehicle.param("TKOFF_ALT") is not None)
        plane.faults.refuse_arming = "Hardware safety switch"
        outcome = await gcs.outcome("vehicles.takeoff", height_m=50)
        assert not outcome["ok"] and "put it in LOITER" in outcome["message"]
        assert mode_of(plane) == "LOITER"
        plane.faults.refuse_arming = ""
        await gcs.done("vehicles.arm")
        await asyncio.sleep(10)
        assert plane.motion.up_m == 0.0 and plane.motion.groundspeed_mps == 0.0  # no arming lifts it


@pytest.mark.deep
async def test_a_takeoff_that_is_not_seen_puts_no_flying_plane_into_another_mode(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"ardupilot_plane": 1}) as gcs:
        plane, vehicle = gcs.sims[0], gcs.actor().vehicle
        await gcs.until(lambda: vehicle.param("TKOFF_ALT") is not None)
        assert mode_of(plane) == "MANUAL"
        ordered = asyncio.create_task(gcs.outcome("vehicles.takeoff", height_m=50))
        await gcs.until(lambda: vehicle.armed, 40.0)
        gcs.muted.add(1)  # the downlink alone is gone
        outcome = await ordered
        await asyncio.sleep(20)
        assert not outcome["ok"] and "did not disarm again" in outcome["message"], outcome
        assert outcome["message"].count("did not") == 1, "what cannot be undone ends it"
        assert plane.armed and plane.motion.up_m > 40 and mode_of(plane) == "TAKEOFF"


@pytest.mark.parametrize("kind", ["ardupilot_plane", "rover"])
async def test_an_arming_that_is_not_heard_takes_no_mission_back(tmp_path: Path, kind: str) -> None:
    async with flown(tmp_path, **EMPTY, others={kind: 1}) as gcs:
        sim = gcs.sims[0]
        home = f"0\t1\t0\t16\t0\t0\t0\t0\t{FIELD.lat_deg}\t{FIELD.lon_deg}\t180\t1"
        lines = ["QGC WPL 110", home]
        for command, north_m in ((22, 100), (16, 500), (16, 900))[kind == "rover" :]:
            lat, lon = FIELD.to_geodetic(0.0, north_m)
            lines.append(f"{len(lines) - 1}\t0\t3\t{command}\t0\t0\t0\t0\t{lat:.7f}\t{lon:.7f}\t40\t1")
        await gcs.done("missions.upload", plan="\n".join(lines), force=True)
        ordered = asyncio.create_task(gcs.outcome("missions.start"))
        await gcs.until(lambda: mode_of(sim) == "AUTO")
        gcs.muted.add(1)
        outcome = await ordered
        assert not outcome["ok"] and "no heartbeat has shown it disarmed" in outcome["message"], outcome
        await asyncio.sleep(20)
        assert sim.armed and mode_of(sim) == "AUTO" and sim.motion.groundspeed_mps > 1


async def test_an_arduplane_lands_by_its_mission(tmp_path: Path) -> None:
    def item(command: int, north_m: float = 0.0, up_m: float = 0.0) -> str:
        """A line of ArduPilot's own text format: heights above home, places on the line of its nose."""
        lat, lon = FIELD.to_geodetic(0.0, north_m) if north_m else (0.0, 0.0)
        return f"0\t3\t{command}\t0\t0\t0\t0\t{lat:.7f}\t{lon:.7f}\t{up_m}\t1"

    async with flown(tmp_path, **EMPTY, others={"ardupilot_plane": 1}) as gcs:
        plane = gcs.sims[0]
        home = f"0\t1\t0\t16\t0\t0\t0\t0\t{FIELD.lat_deg}\t{FIELD.lon_deg}\t180\t1"
        items = [item(22, up_m=40), item(16, 500, 60), item(189), item(16, 900, 40), item(21, 400, 0)]
        lines = ["QGC WPL 110", home, *(f"{seq}\t{line}" for seq, line in enumerate(items, 1))]
        await gcs.done("missions.upload", plan="\n".join(lines), force=True)
        await gcs.until(lambda: gcs.actor().vehicle.param("TKOFF_ALT") is not None)
        await gcs.done("vehicles.takeoff", height_m=50, wait_s=60.0)
        await gcs.until(lambda: plane.motion.up_m > 47, 60.0)
        await gcs.done("vehicles.land")
        assert mode_of(plane) == "AUTO"
        await gcs.until(lambda: plane.motion.on_ground, 240.0)
        assert away_m(plane, 0, 400) < 60
        await gcs.until(lambda: not plane.armed, 60.0)


async def test_a_px4_plane_takes_off_goes_holds_returns_and_lands(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"px4_plane": 1}, params={"NAV_LOITER_RAD": 50.0}) as gcs:
        plane = gcs.sims[0]
        await gcs.until(lambda: gcs.actor().vehicle.param("NAV_LOITER_RAD") == 50.0)  # it is asked for
        await gcs.done("vehicles.takeoff", height_m=40, wait_s=60.0)
        await gcs.until(lambda: mode_of(plane) == "LOITER", 90.0)
        assert plane.motion.up_m > 35
        await gcs.done("vehicles.goto", enu_m=[200, 200, 60])
        await gcs.until(lambda: away_m(plane, 200, 200) < 55, 120.0)
        await asyncio.sleep(30)
        assert 45 < away_m(plane, 200, 200) < 55 and abs(plane.motion.up_m - 60) < 3
        outcome = await gcs.outcome("vehicles.hold")
        assert outcome["ok"] and "circling in AUTO.LOITER, 50 m about where it was" in outcome["message"]
        await gcs.done("vehicles.rtl")
        assert mode_of(plane) == "RTL"
        await gcs.until(lambda: away_m(plane, 0, 0) < 55, 120.0)
        await gcs.done("vehicles.land")
        assert mode_of(plane) == "LAND"
        await gcs.until(lambda: not plane.armed, 240.0)
        assert plane.motion.up_m == 0.0 and not plane.motion.crashed


async def test_planes_and_rovers_fly_no_setpoints_no_plans_and_no_formations(tmp_path: Path) -> None:
    async with flown(tmp_path, **EMPTY, others={"px4_plane": 1, "ardupilot_plane": 1, "rover": 1}) as gcs:
        for name, kind in (("v1", "plane"), ("v2", "plane"), ("v3", "rover")):
            outcome = await gcs.outcome("control.set", targets=name, mode="position", force=True)
            assert not outcome["ok"] and f"it is a {kind}, and only copters hover" in outcome["message"], outcome


async def test_a_plan_and_a_formation_name_the_vehicle_that_cannot_hover(tmp_path: Path) -> None:
    def prepared(config: FleetConfig) -> FleetConfig:
        return config.model_copy(update={"extensions": {"formation": FormationConfig()}})

    async with flown(tmp_path, px4=1, takeoff=False, others={"rover": 1}, prepared=prepared) as gcs:
        await load(gcs, northwards(above(gcs, up_m=8.0)))
        findings = (await gcs("plan.check", margin_m=MARGIN_M))["findings"]
        states = {f["vehicle"]: f for f in findings if f["check"] == "state"}
        assert states["v1"]["severity"] != "refused", states
        assert states["v2"]["severity"] == "refused" and "it is a rover, and only copters hover" in str(states["v2"])
        sent = len([s for s in gcs.sent if s.name.startswith("SET_") or s.values.get("command") == 176])
        with pytest.raises(RefusedError, match="v2: it is a rover, and only copters hover at setpoints"):
            await gcs("formation.start", targets=["v1", "v2"], shape="line", spacing_m=8.0)
        assert len([s for s in gcs.sent if s.name.startswith("SET_") or s.values.get("command") == 176]) == sent


async def test_a_copter_is_not_sent_into_the_circle_of_a_plane(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, height_m=50.0, others={"px4_plane": 1}, takeoff=False) as gcs:
        await gcs.done("vehicles.takeoff", "v2", height_m=50, wait_s=60.0)
        await gcs.until(lambda: mode_of(gcs.sims[1]) == "LOITER", 90.0)
        await gcs.done("vehicles.goto", "v2", enu_m=[0, 250, 50])
        await gcs.done("vehicles.takeoff", "v1", height_m=20, wait_s=60.0)
        await gcs.until(lambda: away_m(gcs.sims[1], 0, 250) < 85, 90.0)
        refused = await gcs.outcome("vehicles.goto", "v1", enu_m=[0, 250, 50])
        assert not refused["ok"] and "v2" in refused["message"], refused
        refused = await gcs.outcome("vehicles.goto", "v1", enu_m=[60, 200, 48])
        assert not refused["ok"] and "v2" in refused["message"], refused
        await gcs.done("vehicles.goto", "v1", enu_m=[0, 60, 20])  # beside it, and below
