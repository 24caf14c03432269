"""On the ground: who is there, what they stream, their parameters, preflight, plans."""

from __future__ import annotations

import json
import struct
import time
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.firmware_field import HOME, Field

NAV = ("ATTITUDE", "GLOBAL_POSITION_INT", "SYS_STATUS", "GPS_RAW_INT")
ALIVE = ("STAT_", "SIM_", "LND_FLIGHT_T", "COM_FLIGHT_UUID")
"""Begins of names of parameters that count by themselves."""

SETTLE_S = 8.0
"""Until rates are those that were asked for."""


def rates(field: Field, seconds: float) -> dict[str, dict[str, float]]:
    """Hz of each message as it leaves each vehicle."""
    before = {name: dict(field.truth(name).counts) for name in field.names}
    began = time.monotonic()
    time.sleep(seconds)
    passed_s = time.monotonic() - began

    def rate(name: str, message: str) -> float:
        return round((field.truth(name).counts[message] - before[name].get(message, 0)) / passed_s, 2)

    return {name: {message: rate(name, message) for message in NAV} for name in field.names}


def lost(field: Field) -> dict[str, Any]:
    """Frames that the daemon counts as lost, by vehicle."""
    found = {}
    for name in field.names:
        found[name] = [link["lost"] for link in field.state(name)["links"].values()]
    return found


def test_discovery_and_streams(ground: Field, figures: dict[str, Any]) -> None:
    ground.wait(lambda: all(ground.state(name)["firmware"] for name in ground.names), 20, "versions are known")
    states = {name: ground.state(name) for name in ground.names}
    assert all(s["connected"] and not s["armed"] for s in states.values())
    assert {s["autopilot"] for s in states.values()} == {"px4" if ground.px4 else "ardupilot"}
    time.sleep(SETTLE_S)
    for name, measured in rates(ground, 5).items():
        figures[f"{name} Hz"] = measured
        assert all(rate > 0.3 for rate in measured.values()), measured
        assert measured["GLOBAL_POSITION_INT"] > 1.5
        position = ground.state(name)["position"]
        assert position["age_s"] < 2
        east, north = ground.stand(name)
        assert abs(position["enu_m"][0] - east) < 3
        assert abs(position["enu_m"][1] - north) < 3


def test_nothing_is_lost_on_loopback(ground: Field, figures: dict[str, Any]) -> None:
    time.sleep(10)
    found = lost(ground)
    figures["lost"] = found
    assert all(count == 0 for counts in found.values() for count in counts), found


@pytest.mark.minutes
def test_stream_rates_are_the_same_after_a_restart(ground: Field, figures: dict[str, Any]) -> None:
    before = rates(ground, 6)[ground.one]
    ground.restart_daemon()
    time.sleep(SETTLE_S)
    after = rates(ground, 6)[ground.one]
    figures.update(before=before, after=after)
    for name, rate in before.items():
        assert after[name] > 0.75 * rate, (name, before, after)


def test_every_parameter_with_its_type(ground: Field, figures: dict[str, Any]) -> None:
    began = time.monotonic()
    answer = ground.daemon.call("params.list", targets=ground.one, refresh=True, burst=True, bytes_per_s=None)
    figures["seconds"] = time.monotonic() - began
    ours = {p["name"]: (p["type"], p["value"]) for p in answer["lists"][ground.one]["params"]}
    theirs: dict[str, tuple[int, float]] = {}
    with ground.ground_station(ground.bound_port) as program:
        total = 0
        for _ in range(4):
            program.mav.param_request_list_send(1, 1)
            end = time.monotonic() + 8
            while time.monotonic() < end and (not total or len(theirs) < total):
                message = program.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.5)
                if message is not None and message.param_id != "_HASH_CHECK":
                    theirs[message.param_id] = (message.param_type, message.param_value)
                    total = message.param_count
            if total and len(theirs) >= total:
                break
    figures["ours"], figures["pymavlink's"] = len(ours), len(theirs)
    assert set(theirs) <= set(ours), sorted(set(theirs) - set(ours))[:9]
    assert len(ours) >= len(theirs) > 800
    for name, (kind, wire) in theirs.items():
        our_type, our_value = ours[name]
        assert mav.enums["MAV_PARAM_TYPE"][kind].name == f"MAV_PARAM_TYPE_{our_type}", name
        packed = struct.pack("<f", wire)
        # PX4 sends the bytes of an integer in the float field, ArduPilot its value (MAV_PROTOCOL_CAPABILITY_PARAM_…).
        theirs_value = struct.unpack("<i", packed)[0] if ground.px4 and our_type == "INT32" else wire
        assert our_value == theirs_value or name.startswith(ALIVE), (name, our_value, theirs_value)


def of_this_copter(ground: Field, **values: float) -> tuple[str, float]:
    """The parameter that it has, and its value: ArduCopter 4.7 gave those in centimetres other names, in metres."""
    answer = ground.daemon.call("params.get", targets=ground.one, names=list(values))["outcomes"][ground.one]
    return next((name, value) for name, value in values.items() if answer[name]["ok"])


def test_a_parameter_is_set_and_one_beyond_its_limits_is_reported(ground: Field, figures: dict[str, Any]) -> None:
    name, value = ("MPC_XY_CRUISE", 6.0) if ground.px4 else of_this_copter(ground, WPNAV_SPEED=600.0, WP_SPD=6.0)
    before = ground.daemon.call("params.get", targets=ground.one, names=[name])["outcomes"][ground.one][name]["value"]
    ground.order("params.set", ground.one, params={name: value})
    if ground.px4:
        # PX4 takes it and lowers it to MPC_XY_VEL_MAX at once (mc_pos_control, parameters_update).
        answer = ground.daemon.call("params.set", targets=ground.one, params={name: 19.0})
        outcome = answer["outcomes"][ground.one][name]
        figures["19 m/s"] = outcome["message"]
        assert outcome["result"] == "changed", outcome
    ground.order("params.set", ground.one, params={name: before})


def test_preflight_is_true_and_fixes_what_is_wrong(ground: Field, figures: dict[str, Any]) -> None:
    name, wrong, right = ("RTL_RETURN_ALT", 40, 25) if ground.px4 else ("FENCE_MARGIN", 4, 2)
    ground.order("params.set", "all", params={name: wrong})
    before = ground.daemon.call("preflight.run", targets="all")
    assert name in json.dumps(before)
    after = ground.daemon.call("preflight.run", targets="all", fix=True)
    answer = ground.daemon.call("params.get", targets="all", names=[name])
    figures["fixed"] = name
    for vehicle in ground.names:
        assert answer["outcomes"][vehicle][name]["value"] == right
    again = ground.daemon.call("preflight.run", targets="all")
    verdicts = {v: _verdict(again, v) for v in ground.names}
    figures["passed"] = verdicts
    assert all(verdicts.values()), _failures(again)
    ground.order("vehicles.arm", "all", wait_s=60)
    ground.order("vehicles.disarm", "all")
    assert after


@pytest.mark.only("ardupilot")
@pytest.mark.parametrize("mode", ["RTL", "BRAKE", "LAND"])
def test_preflight_knows_modes_that_do_not_arm(ground: Field, figures: dict[str, Any], mode: str) -> None:
    ground.order("vehicles.mode", ground.one, mode=mode)
    answer = ground.daemon.call("preflight.run", targets=ground.one)
    findings = answer["vehicles"][ground.one]["findings"]
    (found,) = [finding["text"] for finding in findings if finding["check"] == "mode"]
    outcome = ground.daemon.call("vehicles.arm", targets=ground.one)["outcomes"][ground.one]
    figures["preflight"], figures["armed"] = found, outcome["ok"]
    assert not outcome["ok"]
    assert found.startswith(f"would not arm in {mode}; takeoff, plan run and mission start change to GUIDED")


def _verdict(answer: dict[str, Any], name: str) -> bool:
    return bool(answer["vehicles"][name]["ok"])


def _failures(answer: dict[str, Any]) -> dict[str, str]:
    return {name: entry["summary"] for name, entry in answer["vehicles"].items()}


PLAN = {
    "fileType": "Plan",
    "version": 1,
    "groundStation": "skygcs",
    "mission": {"version": 2, "firmwareType": 12, "vehicleType": 2, "cruiseSpeed": 15, "hoverSpeed": 5},
    "geoFence": {"version": 2, "polygons": [], "circles": []},
    "rallyPoints": {"version": 2, "points": []},
}


def plan(field: Field, east_m: float = 0.0) -> str:
    """Take-off, two waypoints, return; a circle and a polygon as fence, a rally point."""

    def place(east: float, north: float) -> tuple[float, float]:
        return round(HOME[0] + north / 111_132, 7), round(HOME[1] + (east + east_m) / 80_400, 7)

    def item(number: int, command: int, where: tuple[float, float], height: float, frame: int = 3) -> dict[str, Any]:
        params = [0, 0, 0, None, *where, height]
        return {
            "type": "SimpleItem", "autoContinue": True, "command": command, "doJumpId": number, "frame": frame,
            "params": params, "AMSLAltAboveTerrain": None, "Altitude": height, "AltitudeMode": 1,
        }  # fmt: skip

    home = [*place(0, 0), HOME[2]]
    items = [
        item(1, 22, place(0, 0), 10),
        item(2, 16, place(0, 15), 12),
        item(3, 16, place(5, 15), 10),
        {"type": "SimpleItem", "autoContinue": True, "command": 20, "doJumpId": 4, "frame": 2, "params": [0] * 7},
    ]
    polygon = [list(place(e, n)) for e, n in ((-80, -80), (80, -80), (80, 80), (-80, 80))]
    whole = {
        **PLAN,
        "mission": {**PLAN["mission"], "plannedHomePosition": home, "items": items},  # type: ignore[dict-item]
        "geoFence": {"version": 2, "circles": [], "polygons": [{"inclusion": True, "polygon": polygon, "version": 1}]},
        "rallyPoints": {"version": 2, "points": [[*place(0, 5), 15]]},
    }
    return json.dumps(whole)


def test_mission_fence_and_rally_points_up_and_down_and_equal(ground: Field, figures: dict[str, Any]) -> None:
    sent = json.loads(plan(ground))
    began = time.monotonic()
    ground.order("missions.upload", "all", plan=json.dumps(sent))
    figures["upload s"] = time.monotonic() - began
    for name in ground.names:
        began = time.monotonic()
        answer = ground.daemon.call("missions.download", target=name)
        figures["download s"] = time.monotonic() - began
        back = answer["plan"] if isinstance(answer["plan"], dict) else json.loads(answer["plan"])
        for ours, theirs in zip(sent["mission"]["items"], back["mission"]["items"], strict=True):
            assert ours["command"] == theirs["command"]
            if ours["command"] == 16:
                assert ours["params"][4:7] == pytest.approx(theirs["params"][4:7], abs=2e-7)
        assert back["geoFence"]["polygons"][0]["polygon"] == [
            pytest.approx(corner, abs=2e-7) for corner in sent["geoFence"]["polygons"][0]["polygon"]
        ]
        assert back["rallyPoints"]["points"][0] == pytest.approx(sent["rallyPoints"]["points"][0], abs=1e-4)
    ground.order("missions.clear", "all", lists=["mission", "fence", "rally"])


def test_parameters_have_ranges_and_come_as_fast_as_they_are_answered(ground: Field, figures: dict[str, Any]) -> None:
    """A PX4's ranges are read from its own file; 893 parameters took 12.6 s, read at the rate of a radio."""
    name = "MPC_XY_CRUISE" if ground.px4 else of_this_copter(ground, WPNAV_SPEED=0.0, WP_SPD=0.0)[0]
    unit = "cm/s" if name == "WPNAV_SPEED" else "m/s"
    found = ground.daemon.call("params.metadata", targets=ground.one, names=[name])["vehicles"][ground.one]
    figures["metadata"] = found["source"]
    assert found["own"] is ground.px4, found["why_not_own"]
    assert found["parameters"][name]["unit"] == unit
    answer = ground.daemon.call("params.set", targets=ground.one, params={name: 50_000})
    figures["50000"] = answer["outcomes"][ground.one][name]["message"]
    assert answer["outcomes"][ground.one][name]["result"] == "refused"
    listed = ground.daemon.call("params.list", targets=ground.one, refresh=True)["lists"][ground.one]
    figures["listed"], figures["in s"] = listed["count"], listed["elapsed_s"]
    assert listed["ok"] and listed["elapsed_s"] < 6.0
