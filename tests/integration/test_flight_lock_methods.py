"""Every method of the socket while a flight is under way: it reads, it is known to move or end the flight, it asks the
lock and is refused, or it is called and changes nothing that the flight stands on."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import SkygcsError
from skygcs.sim.conditions import Conditions
from skygcs.web.roles import READ
from support.extension_parts import ALL_METHODS
from support.flown import Flown, flown
from support.planned import UP_M, here, north, northwards, plan_events, run, state

WIND = Conditions(wind_enu_mps=(6.0, 0.0, 0.0))

ASKS: dict[str, list[dict[str, Any]]] = {
    "origin.set": [{"lat_deg": 43.78, "lon_deg": -79.46, "alt_amsl_m": 0.0, "x_heading_deg": 9.0, "force": True}],
    "origin.from_vehicle": [{"target": "{v}", "force": True, "heading": True}],
    "origin.push": [{"targets": "{v}", "force": True, "home": True}],
    "params.set": [
        {"targets": "v1", "params": {"COM_OF_LOSS_T": 9.0, "MAV_SYS_ID": 9.0}, "force": True},
        {"targets": "v2", "params": {"GUID_TIMEOUT": 9.0, "SYSID_THISMAV": 9.0, "FRAME_CLASS": 2.0}, "force": True},
    ],
    "fence.set": [{"targets": "{v}", "radius_m": 40.0, "height_m": 30.0, "force": True}],
    "fence.test": [{"targets": "{v}", "radius_m": 30.0, "action": "hold"}],
    "links.remove": [{"name": "air"}],
    "links.change": [{"name": "air", "link": {"type": "memory", "delay_s": 0.2}}],
    "vehicles.set_home": [{"targets": "{v}", "lat_deg": 43.781, "lon_deg": -79.4653, "force": True}],
    "vehicles.renumber": [{"target": "{v}", "sysid": 9, "force": True}],
    "vehicles.calibrate": [{"targets": "{v}", "sensor": "gyro"}],
    "vehicles.forget": [{"targets": "{v}", "force": True}],
    "vehicles.interval": [
        {"targets": "{v}", "message": "GLOBAL_POSITION_INT", "rate_hz": 0.0},
        {"targets": "{v}", "message": "ATTITUDE", "rate_hz": 0.5},
    ],
    "vehicles.stream": [{"targets": "{v}", "stream": "POSITION", "rate_hz": 0.0}],
    "missions.clear": [{"targets": "{v}", "lists": ["fence"]}, {"targets": "{v}", "lists": ["rally"]}],
    "signing.setup": [{"targets": "{v}", "key_file": "key", "force": True}],
    "signing.off": [{"targets": "{v}"}],
    "signing.reset_clock": [{"key_id": "00000000", "force": True}],
    "undo.run": [{"id": "nothing", "force": True}],
    "plan.unload": [{}],
    "trajectory.unload": [{"targets": "{v}"}],
    "trajectory.start": [{"targets": "{v}", "force": True}],
    "plan.run": [{}],
}
"""Refused for each of the members, whoever insists."""

HARMLESS: dict[str, list[dict[str, Any]]] = {
    "vehicles.arm": [{"targets": "{v}"}],
    "vehicles.takeoff": [{"targets": "{v}", "height_m": 5.0}],
    "vehicles.request": [{"targets": "{v}", "message": "AUTOPILOT_VERSION"}],
    "vehicles.interval": [{"targets": "{v}", "message": "VIBRATION", "rate_hz": 1.0}],
    "vehicles.calibrate_confirm": [{"targets": "{v}"}],
    "vehicles.calibrate_cancel": [{"targets": "{v}"}],
    "params.get": [{"targets": "v1", "names": ["COM_OF_LOSS_T"]}],
    "params.metadata": [{"targets": "v1", "names": ["COM_OF_LOSS_T"], "read": True}],
    "params.list": [{"targets": "{v}", "values": False}],
    "params.cancel": [{"targets": "{v}"}],
    "missions.download": [{"target": "{v}"}],
    "missions.clear": [{"targets": "{v}", "lists": ["mission"]}],
    "control.record": [{"targets": "{v}", "on": False}],
    "link.select": [{"targets": "{v}"}],
    "corrections.send": [{"data": "AAAA", "source": "a test"}],
    "links.add": [{"name": "more", "link": {"type": "memory"}}],
    "fence.status": [{"targets": "{v}"}],
    "preflight.run": [{"targets": "{v}"}],
    "logs.list": [{"targets": "{v}"}],
    "logs.get": [{"targets": "{v}", "logs": "latest"}],
    "operator.active": [{}],
    "control.gains": [{"targets": "{v}"}],
    "undo.drop": [{"id": "nothing"}],
    "plan.cancel": [{"job": 1}],
}
"""Called for each of the members: accepted or refused, the flight goes on as it was certified."""

MOVES = {
    "tests/integration/test_control_handed_over.py": (
        *("vehicles.mode", "vehicles.land", "vehicles.rtl", "vehicles.hold", "vehicles.goto", "missions.start"),
        *("missions.pause", "missions.resume", "missions.set_current"),
    ),
    "tests/integration/test_emergency_stop_lossy.py": ("vehicles.stop", "vehicles.disarm"),
    "tests/integration/test_plan_taken_over.py": (
        "control.set",
        "plan.abort",
        "plan.land",
        "plan.pause",
        "plan.resume",
    ),
    "tests/integration/test_trajectory_flight.py": (
        *("trajectory.load", "trajectory.pause", "trajectory.resume", "trajectory.speed", "trajectory.abort"),
        *("control.setpoint", "plan.speed"),
    ),
    "tests/integration/test_formation.py": (
        *("formation.start", "formation.guide", "formation.move", "formation.turn", "formation.scale"),
        "formation.stop",
    ),
    "tests/integration/test_shell.py": ("shell.open", "shell.write", "shell.read", "shell.close"),
    "tests/integration/test_companion_control.py": ("companion.contact", "companion.order", "companion.setpoint"),
    "tests/integration/test_authority.py": ("authority.grant", "authority.revoke"),
    "tests/unit/core/vehicle/test_gate.py": ("vehicles.command", "messages.send"),
    "tests/unit/core/vehicle/test_orders.py": ("vehicles.reboot",),
    "tests/integration/test_mission_flights.py": ("missions.upload",),
    "tests/integration/test_missions_for_several.py": ("missions.end_turns",),
    "tests/integration/test_drills.py": ("drills.begin", "drills.end"),
    "tests/unit/ext/logs/test_recordings.py": ("recordings.replay", "recordings.end"),
    "tests/integration/test_planning.py": (*("plan.upload", "plan.load", "plan.check", "plan.make", "plan.certify"),),
}
"""What moves a vehicle or ends its flight, or is no part of one, with the tests that show how."""

OF_CLIENTS = {"subscribe", "unsubscribe", "operator.relay", "alarms.acknowledge", "ros.report", "corrections.survey"}


def test_each_method_is_sorted_in() -> None:
    sorted_in = [*ASKS, *(set(HARMLESS) - set(ASKS)), *OF_CLIENTS, *(READ & set(ALL_METHODS))]
    sorted_in += [name for names in MOVES.values() for name in names]
    assert sorted(set(sorted_in)) == sorted(ALL_METHODS)
    root = Path(__file__).parents[2]
    assert all((root / path).is_file() for path in MOVES)


async def called(gcs: Flown, method: str, params: dict[str, Any]) -> str | None:
    """Why it was refused; None if it was accepted."""
    try:
        answer = await gcs(method, **params)
    except SkygcsError as error:
        return str(error)
    if isinstance(answer, dict) and answer.get("started") is False:
        return "not started"
    outcomes = answer.get("outcomes") if isinstance(answer, dict) else None
    if outcomes is None:
        return None
    flat = [o for one in outcomes.values() for o in ([one] if "ok" in one else one.values())]
    return None if any(o["ok"] for o in flat) else "; ".join(str(o["message"]) for o in flat)


async def what_may_change(gcs: Flown) -> None:
    """Call the two tables, and compare what flies with what it was."""
    (lock, *_) = gcs.daemon.fleet.locks.held()  # the plan's, if there is one
    before = (gcs.daemon.fleet.origin, [_held(sim) for sim in gcs.sims])
    for method, calls in (*ASKS.items(), *HARMLESS.items()):
        for params in calls:
            for name in ("v1", "v2") if "{v}" in str(params) else ("",):
                given = {k: name if v == "{v}" else v for k, v in params.items()}
                why = await called(gcs, method, given)
                refused = why is not None
                assert refused or params not in ASKS.get(method, ()), f"{method} {given} was accepted"
    assert gcs.daemon.fleet.locks.held()[0] is lock
    assert (gcs.daemon.fleet.origin, [_held(sim) for sim in gcs.sims]) == before


def _held(sim: Any) -> list[float | None]:
    names = ("COM_OF_LOSS_T", "MAV_SYS_ID", "GF_MAX_HOR_DIST", "GUID_TIMEOUT", "SYSID_THISMAV", "FENCE_RADIUS")
    home = sim.home
    return [*(sim.params.get(name) for name in names), None if home is None else home.up_m]


async def test_while_a_plan_is_flown_and_while_it_is_paused(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, height_m=UP_M, in_air=True, conditions=WIND) as gcs:
        starts = here(gcs)
        await run(gcs, northwards(starts, 35.0))
        await gcs.until(lambda: state(gcs) in ("engaging", "to_starts"), 60.0)
        await what_may_change(gcs)
        await gcs.until(lambda: state(gcs) == "flying", 120.0)
        await what_may_change(gcs)
        await gcs("plan.pause")
        await asyncio.sleep(4.0)
        await what_may_change(gcs)
        assert state(gcs) == "paused", plan_events(gcs)
        await gcs("plan.resume")
        await gcs.until(lambda: state(gcs) in ("finished", "stopped", "aborted"), 120.0)
        assert state(gcs) == "finished", plan_events(gcs)
        assert all(math.dist(gcs.place(name), goal) < 0.9 for name, goal in north(starts, 35.0).items())


@pytest.mark.deep
async def test_while_each_is_under_control(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=1, in_air=True, conditions=WIND) as gcs:
        await gcs.fly("position", targets="all")
        since = gcs.now
        await what_may_change(gcs)
        assert all(gcs.control(name)["state"] == "flying" for name in ("v1", "v2"))
        assert all(gcs.farthest_m(since, name) < 1.5 for name in ("v1", "v2"))
