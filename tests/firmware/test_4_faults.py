"""Each fault that the guard knows, on a real autopilot under control: what skygcs says, and what the vehicle does."""

from __future__ import annotations

import json
import math
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.firmware_field import HEIGHT_M, Field

IN_FULL = partial(pytest.param, marks=pytest.mark.minutes)
"""A way of it that the full form flies as well."""

SAFE_M = 3.0
"""A vehicle that held its place may be this far from it when the fault is over."""


def first_report(field: Field, since: float, *kinds: str) -> dict[str, Any]:
    """When the first event of these kinds came, and what it said."""
    wanted = kinds or ("control", "warning", "link_degraded", "vehicle_lost", "uplink_lost")
    for when, event in list(field.watcher.events):
        if when > since and event["kind"] in wanted and event["vehicle"] in (field.one, None):
            return {"after s": round(when - since, 2), "text": event["text"][:90]}
    return {}


def stays_up(field: Field, seconds: float) -> tuple[float, float]:
    """Watch it for so long: the largest distance from its place, and the least height."""
    place = field.stand(field.one)
    far, low = 0.0, math.inf
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        x, y, up = field.enu(field.one)
        far, low = max(far, math.dist((x, y), place)), min(low, up)
        time.sleep(0.05)
    return far, low


@pytest.mark.parametrize("mode", [IN_FULL("velocity"), "attitude"])
def test_telemetry_is_cut(air: Field, figures: dict[str, Any], mode: str) -> None:
    with air.controlled(mode):
        began = time.monotonic()
        air.relay.cut_down = set(air.sysids)
        figures["farthest m"], figures["lowest m"] = stays_up(air, 6)
        figures["report"] = first_report(air, began)
        figures["mode then"] = air.truth(air.one).mode
        air.relay.clear()
        figures["events"] = [e["text"][:80] for e in air.watcher.events_since(began, "control", vehicle=air.one)]
        assert figures["farthest m"] < SAFE_M
        assert figures["lowest m"] > HEIGHT_M - 3
        assert figures["report"]
        assert figures["mode then"] == ("LOITER" if air.px4 else "GUIDED")  # where its own failsafes act
    air.wait(air.connected, 20, "both are heard again")


@pytest.mark.parametrize("mode", ["velocity", IN_FULL("attitude")])
def test_the_uplink_is_cut(air: Field, figures: dict[str, Any], mode: str) -> None:
    with air.controlled(mode):
        began = time.monotonic()
        air.relay.cut_up = {air.sysids[0]}
        figures["farthest m"], figures["lowest m"] = stays_up(air, 8)
        figures["report"] = first_report(air, began)
        figures["mode then"] = air.truth(air.one).mode
        figures["texts"] = air.truth(air.one).texts_since(began)[:3]
        assert figures["farthest m"] < SAFE_M
        assert figures["lowest m"] > HEIGHT_M - 3
        assert figures["report"], "nobody was told"
    air.wait(air.connected, 20, "both are heard again")


def test_a_delay_brings_attitude_down_to_velocity_and_position(air: Field, figures: dict[str, Any]) -> None:
    with air.controlled("attitude"):
        began = time.monotonic()
        air.relay.delay_down_s = air.relay.delay_up_s = 0.12
        figures["velocity after s"] = air.wait(
            lambda: air.control(air.one)["control_mode"] == "velocity", 30, "velocity instead of attitude"
        )
        air.relay.delay_down_s = air.relay.delay_up_s = 0.45
        figures["position after s"] = air.wait(
            lambda: air.control(air.one)["control_mode"] == "position", 30, "position instead of velocity"
        )
        figures["farthest m"], figures["lowest m"] = stays_up(air, 4)
        figures["events"] = [e["text"][:80] for e in air.watcher.events_since(began, "control", vehicle=air.one)]
        assert figures["farthest m"] < SAFE_M


HOLD_LAG_S = 0.25
"""By which a braking of 2.5 m/s² is late whose jerk is 5 m/s³ (ArduCopter's PSC_JERK_XY): BRAKE took 2.43 m from 1.85
m/s, by the simulator's own log."""


def allowed_m(speed_mps: float) -> float:
    """How far beyond its reference a vehicle may travel after a fault at this speed: 0.7 s until it is noticed, braking
    with 2.5 m/s², and half a metre."""
    return 0.7 * speed_mps + speed_mps**2 / 5.0 + 0.5


def farthest_north(field: Field, seconds: float) -> float:
    """Of the first vehicle, within so long."""
    most, end = -math.inf, time.monotonic() + seconds
    while time.monotonic() < end:
        most = max(most, field.enu(field.one)[1])
        time.sleep(0.02)
    return most


def test_the_uplink_gets_slow_in_a_step(air: Field, figures: dict[str, Any]) -> None:
    """0.5 s slower, in the middle of an 8 m step by attitude."""
    far_m = 8.0
    steps_at = [math.inf]

    def reference(t: float) -> dict[str, Any]:
        return {"pos_enu_m": [0, far_m if time.monotonic() >= steps_at[0] else 0, HEIGHT_M]}

    with air.controlled("attitude", reference):
        time.sleep(6)  # 21 pongs
        steps_at[0] = time.monotonic()
        air.wait(lambda: air.enu(air.one)[1] > 0.4 * far_m, 10, "it is on its way")
        began, speed = time.monotonic(), air.truth(air.one).speed_mps
        if (flown_by := air.control(air.one)["control_mode"]) != "attitude":
            pytest.skip(f"this computer is too busy: it was flown by {flown_by} before the fault")
        air.relay.delay_up_s = 0.5
        most = farthest_north(air, 15)
        report = first_report(air, began, "control")
        figures["speed m/s"], figures["beyond m"], figures["allowed m"] = speed, most - far_m, allowed_m(speed)
        figures["report"] = report
        assert report and report["after s"] < 1.0, report  # 0.7 s, and a busy computer
        assert most - far_m < allowed_m(speed)


@pytest.mark.parametrize("mode", ["velocity", IN_FULL("attitude"), IN_FULL("position")])
def test_telemetry_is_cut_for_two_seconds_on_the_way(air: Field, figures: dict[str, Any], mode: str) -> None:
    """At 2 m/s along a line, whose end comes while nothing is seen. A state of 2 s is held for, so it brakes there."""
    speed, length_m = 2.0, 14.0
    allowed = allowed_m(speed) + speed * HOLD_LAG_S
    starts_at = [math.inf]

    def reference(t: float) -> dict[str, Any]:
        gone_m = speed * max(0.0, time.monotonic() - starts_at[0])
        moving = 0.0 < gone_m < length_m
        return {
            "pos_enu_m": [0, min(gone_m, length_m), HEIGHT_M],
            "vel_enu_mps": [0, speed if moving else 0, 0],
        }

    with air.controlled(mode, reference):
        starts_at[0] = time.monotonic()
        air.wait(lambda: time.monotonic() > starts_at[0] + 10.0 / speed, 10, "10 m of it are done")
        began = time.monotonic()
        air.relay.cut_down = set(air.sysids)
        most = farthest_north(air, 2)
        air.relay.clear()
        most = max(most, farthest_north(air, 8))
        figures["beyond m"], figures["allowed m"] = most - length_m, allowed
        figures["report"] = first_report(air, began, "control")
        assert figures["report"] or mode == "position"  # which bears 2 s
        assert most - length_m < allowed


@pytest.mark.only("ardupilot")
def test_attitude_begins_in_wind_without_a_bump(air: Field, figures: dict[str, Any]) -> None:
    """5 m/s, to which ArduCopter's own position hold leans."""
    set_by_another_program(air, {"SIM_WIND_SPD": 5, "SIM_WIND_DIR": 270})
    try:
        time.sleep(25)
        air.wait(lambda: air.steady(air.one, 3.0), 30, "it stands in the wind")
        place, most, climbed = air.enu(air.one), 0.0, 0.0
        began = time.monotonic()
        air.order("control.set", air.one, mode="attitude", force=True)
        while time.monotonic() < began + 12:
            x, y, up = air.enu(air.one)
            most, climbed = max(most, math.dist((x, y), place[:2])), max(climbed, abs(up - place[2]))
            time.sleep(0.02)
        figures["moved m"], figures["height m"] = most, climbed
        figures["integral"] = air.control(air.one)["integral_enu"]
        if (why := air.fell_back(began)) is not None:
            pytest.skip(f"this computer is too busy for it: {why}")
        assert air.control(air.one)["control_mode"] == "attitude"
        assert most < 0.4 and climbed < 0.4  # its estimator and its gusts have a part in it
    finally:
        air.daemon.call("control.set", targets=air.one, mode="off")
        set_by_another_program(air, {"SIM_WIND_SPD": 0})


def set_by_another_program(field: Field, values: Mapping[str, float], *, whole: bool = False) -> None:
    """Change parameters under a flight, which skygcs itself does not. ``whole``: a PX4's integers, sent bytewise."""
    kind = mav.MAV_PARAM_TYPE_INT32 if whole else mav.MAV_PARAM_TYPE_REAL32
    with field.ground_station() as program:
        for name, value in [*values.items()] * 3:  # no answer is waited for
            sent = struct.unpack("<f", struct.pack("<i", int(value)))[0] if whole else value
            program.mav.param_set_send(field.sysids[0], 1, name.encode(), sent, kind)
            time.sleep(0.1)


def battery(field: Field, low: bool) -> None:
    """Change what the simulated battery holds."""
    values = {"SIM_BAT_DRAIN": 1 if low else 60, "SIM_BAT_MIN_PCT": 17 if low else 100}
    if not field.px4:
        values = {"BATT_CAPACITY": 100 if low else 30000}
    set_by_another_program(field, values)


def test_the_battery_is_low(air: Field, figures: dict[str, Any]) -> None:
    with air.controlled("velocity"):
        began = time.monotonic()
        battery(air, low=True)
        try:
            figures["hold after s"] = air.wait(lambda: air.control(air.one)["state"] != "flying", 30, "it holds")
            figures["state"] = air.control(air.one)["state"]
            figures["report"] = first_report(air, began, "control")
            figures["percent"] = air.state(air.one)["battery"]["percent"]
            figures["farthest m"], figures["lowest m"] = stays_up(air, 3)
            assert "battery" in json.dumps(air.watcher.events_since(began, "control"))
        finally:
            battery(air, low=False)
        assert figures["farthest m"] < SAFE_M
    air.wait(lambda: air.state(air.one)["battery"]["percent"] > 50, 20, "the battery is full again")


def test_setpoints_beyond_the_fence(air: Field, figures: dict[str, Any]) -> None:
    def reference(t: float) -> dict[str, Any]:
        return {"vel_enu_mps": [0, 4, 0]} if t > 3 else {"vel_enu_mps": [0, 0, 0]}

    with air.controlled("velocity", reference) as stream:
        began = time.monotonic()
        far = 0.0
        while time.monotonic() - began < 18:
            far = max(far, air.enu(air.one)[1])
            time.sleep(0.05)
        figures["farthest north m"] = far
        figures["refused setpoints"] = len(stream.refused)
        figures["events"] = [e["text"][:80] for e in air.watcher.events_since(began, "control", vehicle=air.one)]
        assert far < 45  # the fence is at 30; from 4 m/s it brakes beyond it
        if (why := air.fell_back(began)) is not None:  # then its velocity has ended early
            pytest.skip(f"this computer is too busy for it: {why}")
        assert far > 15
    air.order("vehicles.goto", air.one, enu_m=[0, 0, HEIGHT_M])


def test_another_ground_station_takes_over(air: Field, figures: dict[str, Any]) -> None:
    with air.controlled("velocity"), air.ground_station() as program:
        time.sleep(1)
        params = (1, 4, 3) if air.px4 else (1, 17, 0)  # AUTO.LOITER, BRAKE
        program.mav.command_long_send(air.sysids[0], 1, 176, 0, *params, 0, 0, 0, 0)
        figures["control ends after s"] = air.wait(
            lambda: air.control(air.one)["state"] == "off", 10, "control ends when another changes the mode"
        )
        time.sleep(0.5)
        names = ("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_GLOBAL_INT")
        before = sum(air.relay.sent_up[n] for n in names)
        time.sleep(3)
        figures["setpoints after it"] = sum(air.relay.sent_up[n] for n in names) - before
        assert figures["setpoints after it"] == 0
        assert air.truth(air.one).mode == ("LOITER" if air.px4 else "BRAKE")


def after_the_end(field: Field, figures: dict[str, Any], seconds: float) -> None:
    """What the first vehicle does while no daemon is there."""
    began = time.monotonic()
    figures["farthest m"], figures["lowest m"] = stays_up(field, 4)
    time.sleep(max(0.0, seconds - 4))
    figures["modes"] = field.truth(field.one).modes_since(began - 2)
    figures["texts"] = field.truth(field.one).texts_since(began - 2)[:4]


ENDS = [
    IN_FULL("SIGTERM", "position"),
    IN_FULL("SIGTERM", "velocity"),
    ("SIGTERM", "attitude"),
    IN_FULL("SIGKILL", "position"),
    ("SIGKILL", "velocity"),
    IN_FULL("SIGKILL", "attitude"),
]


@pytest.mark.parametrize(("end", "mode"), ENDS)
def test_the_daemon_ends_in_flight(air: Field, figures: dict[str, Any], end: str, mode: str) -> None:
    with air.controlled(mode):
        process = air.daemon.process
        assert process is not None
        began = time.monotonic()
        os.kill(process.pid, getattr(signal, end))
        process.wait(30)
        figures["exit s"] = time.monotonic() - began
    after_the_end(air, figures, 12)
    air.daemon.start()
    air.wait(lambda: air.daemon.known() == 2 and air.connected(), 30, "the new daemon knows both")
    assert air.truth(air.one).armed
    assert figures["lowest m"] > HEIGHT_M - 3
    assert figures["farthest m"] < SAFE_M
    if not air.px4:  # FS_GCS_ENABLE is 1: without a ground station it returns after FS_GCS_TIMEOUT (5 s)
        assert "RTL" in figures["modes"], figures["modes"]


@pytest.mark.only("ardupilot")
@pytest.mark.parametrize("order", ["hold", IN_FULL("stop")])
def test_the_gcs_failsafe_after_our_hold_and_stop(air: Field, figures: dict[str, Any], order: str) -> None:
    air.order(f"vehicles.{order}", air.one)
    air.wait(lambda: air.steady(air.one), 20, "it stands")
    figures["mode"] = air.truth(air.one).mode
    air.daemon.kill()
    began = time.monotonic()
    time.sleep(10)
    truth = air.truth(air.one)
    figures["modes"], figures["texts"] = truth.modes_since(began), truth.texts_since(began)[:3]
    air.daemon.start()
    air.wait(lambda: air.daemon.known() == 2 and air.connected(), 30, "the new daemon knows both")
    if order == "hold":
        assert figures["mode"] == "GUIDED"
        assert "RTL" in figures["modes"], figures
    else:  # BRAKE ignores setpoints; with FS_OPTIONS 16 the failsafe leaves it alone, as preflight says
        assert figures["mode"] == "BRAKE"


FENCE = {
    "px4": ["GF_MAX_HOR_DIST", "GF_ACTION"],
    "ardupilot": ["FENCE_ENABLE", "FENCE_RADIUS", "FENCE_TYPE", "FENCE_ACTION"],
}


def fence(field: Field) -> dict[str, Any]:
    """The fence's parameters as the first vehicle holds them."""
    answer = field.daemon.call("params.get", targets=field.one, names=FENCE[field.firmware])["outcomes"][field.one]
    return {name: answer[name]["value"] for name in FENCE[field.firmware]}


@pytest.mark.parametrize("where", [IN_FULL("ground"), IN_FULL("air")])
def test_sigterm_in_a_fence_test_leaves_no_fence(ground: Field, figures: dict[str, Any], where: str) -> None:
    """`air`: it takes off while the test is under way, inside the test's fence."""
    before = fence(ground)
    cli = Path(sys.executable).with_name("skygcs-cli")
    command = [str(cli), "--socket", str(ground.daemon.socket), "fence", "test", ground.one, "--radius", "8", "--yes"]
    output = ground.folder / f"fence-test-{where}.txt"
    truth = ground.truth(ground.one)
    with output.open("wb") as log, subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log) as test:
        ground.wait(lambda: fence(ground) != before, 20, "the test's fence is there")
        if where == "air":
            ground.takeoff(ground.one, 6.0)
            figures["fence in flight"] = fence(ground)
        process = ground.daemon.process
        assert process is not None
        at, began = (truth.lat_deg, truth.lon_deg), time.monotonic()
        process.send_signal(signal.SIGTERM)
        process.wait(60)
        figures["exit s"] = time.monotonic() - began
        test.wait(30)
        time.sleep(3)
        figures["modes"], figures["moved m"] = truth.modes_since(began), truth.metres_from(*at)
        figures["height m"], figures["armed"] = truth.alt_rel_m, truth.armed
    ground.daemon.start()
    ground.wait(lambda: ground.daemon.known() == 2 and ground.connected(), 30, "the new daemon knows both")
    after = fence(ground)
    figures["fence"], figures["cli"] = after, output.read_text()[-120:]
    assert after == before
    assert figures["exit s"] < 8
    assert figures["armed"] is (where == "air")
    assert figures["moved m"] < SAFE_M


def test_a_fence_test_is_refused_in_flight(air: Field, figures: dict[str, Any]) -> None:
    before = fence(air)
    test = air.daemon.cli("fence", "test", air.one, "--yes")
    figures["answer"] = (test.stdout + test.stderr)[:120]
    assert test.returncode == 1
    assert fence(air) == before


def gps(field: Field, on: bool) -> None:
    # By the simulators' own parameters: satellites in use, and (4.6) a receiver that says nothing.
    params = {"SIM_GPS_USED": 10 if on else 0} if field.px4 else {"SIM_GPS_DISABLE": 0 if on else 1}
    set_by_another_program(field, params, whole=field.px4)


@pytest.mark.minutes
def test_gps_is_lost(air: Field, figures: dict[str, Any]) -> None:
    with air.controlled("velocity"):
        began = time.monotonic()
        gps(air, on=False)
        try:
            figures["control ends after s"] = air.wait(
                lambda: air.control(air.one)["state"] != "flying" and first_report(air, began, "control"),
                40,
                "the guard acts",
            )
            figures["report"] = first_report(air, began, "control")
            time.sleep(5)
            figures["mode"] = air.truth(air.one).mode
            figures["texts"] = air.truth(air.one).texts_since(began)[:4]
        finally:
            gps(air, on=True)
    time.sleep(10)
    field = air
    field.land()
    field.wait(lambda: field.state(field.one)["position"]["age_s"] < 2, 60, "it has a position again")
