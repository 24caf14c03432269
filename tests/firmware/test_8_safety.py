"""Flights of docs/explanation/safety.md on a real autopilot: never unattended, as certified, refused where it harms."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

from firmware.test_4_faults import SAFE_M, stays_up
from skygcs.core.plan.fleet_plan import TimedPlan
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.trajectory import MotionLimits
from support.firmware_field import HEIGHT_M, HOME, Field
from support.planned import content

SLOW = MotionLimits(speed_mps=1.0, acceleration_mps2=1.0, climb_mps=1.0, descent_mps=1.0)

STICK_MODES = {"px4": ("STABILIZED", "ACRO", "ALTCTL", "POSCTL"), "ardupilot": ("STABILIZE", "ACRO", "ALT_HOLD")}
"""Modes that a pilot flies: without sticks they sink, or stop the motors."""

APART_M = 2.0
"""Two vehicles of 0.35 m are never nearer by their own positions, whatever these are worth."""


def outcome_of(field: Field, method: str, name: str, **params: Any) -> dict[str, Any]:
    """The outcome of an order that may be refused; a refusal as a whole is one, too."""
    try:
        answer = field.daemon.call(method, targets=name, **params)
    except AssertionError as error:
        return {"ok": False, "result": "refused", "message": str(error)}
    outcome: dict[str, Any] = answer["outcomes"][name]
    return outcome


def test_a_denied_order_leaves_it_under_control(air: Field, figures: dict[str, Any]) -> None:
    """A mission without items ended control first: 32.6 m of drift in 10 s."""
    air.daemon.call("missions.clear", targets=air.one)
    with air.controlled("attitude"):
        outcome = outcome_of(air, "vehicles.mode", air.one, mode="AUTO.MISSION" if air.px4 else "AUTO")
        figures["answer"] = f"{outcome['result']}: {outcome['message'][:80]}"
        figures["farthest m"], figures["lowest m"] = stays_up(air, 8)
        figures["control then"] = air.control(air.one)["state"]
        assert not outcome["ok"]
        assert figures["farthest m"] < SAFE_M and figures["lowest m"] > HEIGHT_M - 3


def test_the_daemon_is_restarted_in_flight(air: Field, figures: dict[str, Any]) -> None:
    """With our heartbeats back no failsafe acts: an ArduCopter in GUIDED attitude was 30 m away after 10 s."""
    with air.controlled("attitude"):
        began = time.monotonic()
        air.daemon.kill()
        time.sleep(2)
        air.daemon.start()
        figures["farthest m"], figures["lowest m"] = stays_up(air, 12)
        events = air.watcher.events_since(began, vehicle=air.one)
        figures["events"] = [f"{e['kind']}: {e['text'][:70]}" for e in events if e["kind"] != "params"][:6]
        figures["modes"] = air.truth(air.one).modes_since(began)
        assert figures["farthest m"] < SAFE_M
        # a start that took longer than FS_GCS_TIMEOUT on a busy computer: its own failsafe brings it down or back
        assert "RTL" in figures["modes"] or figures["lowest m"] > HEIGHT_M - 3


def test_the_origin_stays_under_a_plan(air: Field, figures: dict[str, Any]) -> None:
    """Turned in a plan, two vehicles passed at 0.28 m."""
    starts = {name: (*air.stand(name), HEIGHT_M) for name in air.names}
    goals = [(x, y + 8.0, up) for x, y, up in starts.values()]
    plan = TimedPlan(dict(zip(starts, straight_trajectories(list(starts.values()), goals, SLOW), strict=True)))
    air.daemon.call("plan.load", plan=content(plan), name="eight metres north")
    started = air.daemon.call("plan.run", mode="position", force=True)
    assert started["started"], started["report"]["findings"]
    air.wait(lambda: air.daemon.call("plan.status")["state"] == "flying", 90, "the plan flies")
    try:
        for what, turned in (("turned", {"x_heading_deg": 270.0}), ("shifted", {"lat_deg": HOME[0] + 6 / 111_132.0})):
            wanted = {"lat_deg": HOME[0], "lon_deg": HOME[1], "alt_amsl_m": HOME[2]} | turned
            try:
                figures[what] = str(air.daemon.call("origin.set", **wanted))[:80]
            except AssertionError as error:
                figures[what] = f"refused: {error}"[:120]
            assert figures[what].startswith("refused"), figures
        air.wait(lambda: air.daemon.call("plan.status")["state"] != "flying", 90, "the plan ends")
        status = air.daemon.call("plan.status")
        figures["ended"] = f"{status['state']}: {status['reason']}"
        figures["beside m"] = {n: math.dist(air.enu(n)[:2], g[:2]) for n, g in zip(air.names, goals, strict=True)}
        assert status["state"] == "finished", status["reason"]
        assert max(figures["beside m"].values()) < 2 * SAFE_M / 3
    finally:
        if air.daemon.call("plan.status")["state"] not in ("finished", "stopped", "aborted", "landed"):
            air.daemon.call("plan.abort")
        air.order("vehicles.hold", "all")
        air.daemon.call("plan.unload")


def test_a_takeoff_counts_from_the_ground_and_not_from_a_home_that_was_moved(
    ground: Field, figures: dict[str, Any]
) -> None:
    """With its home 10 m above it, `takeoff 5` of an ArduCopter went to 15 m."""
    truth = ground.truth(ground.one)
    above = (int(truth.lat_deg * 1e7), int(truth.lon_deg * 1e7), HOME[2] + 10.0)
    ground.order(
        "vehicles.command",
        ground.one,
        command="DO_SET_HOME",
        int_frame="MAV_FRAME_GLOBAL",
        x=above[0],
        y=above[1],
        z=above[2],
        force=True,
    )
    ground.wait(lambda: truth.alt_rel_m < -8, 20, "its home is above it")
    on_ground_m = truth.alt_amsl_m
    figures["home above m"] = -truth.alt_rel_m
    outcome = outcome_of(ground, "vehicles.takeoff", ground.one, height_m=5, wait_s=60)
    figures["answer"] = f"{outcome['result']}: {outcome['message'][:90]}"
    try:
        if outcome["ok"]:
            highest, end = 0.0, time.monotonic() + 20
            while time.monotonic() < end:
                highest = max(highest, truth.alt_amsl_m - on_ground_m)
                time.sleep(0.05)
            figures["highest m"] = highest
            assert 3.0 < highest < 7.5
    finally:
        ground.land()
        ground.order(
            "vehicles.command",
            ground.one,
            command="DO_SET_HOME",
            int_frame="MAV_FRAME_GLOBAL",
            x=above[0],
            y=above[1],
            z=on_ground_m,
            force=True,
        )


def test_modes_that_need_sticks_are_refused_in_the_air(air: Field, figures: dict[str, Any]) -> None:
    """A PX4 here has no receiver; an ArduCopter's simulator has one, with the throttle down."""
    for mode in STICK_MODES["px4" if air.px4 else "ardupilot"]:
        for targets in (air.one, "all"):
            try:
                outcomes = air.daemon.call("vehicles.mode", targets=targets, mode=mode)["outcomes"].values()
            except AssertionError as error:
                outcomes = [{"ok": False, "result": "refused", "message": str(error)}]
            figures[f"{mode} {targets}"] = {f"{o['result']}: {o['message'][:60]}" for o in outcomes}.pop()
            assert not any(o["ok"] for o in outcomes), figures
    figures["farthest m"], figures["lowest m"] = stays_up(air, 4)
    assert figures["lowest m"] > HEIGHT_M - 2


@pytest.mark.only("px4")
def test_a_px4_without_sticks_does_not_sink_when_the_daemon_is_killed(air: Field, figures: dict[str, Any]) -> None:
    """Left to its default it changed to Position mode and sank from 12.4 to 4.5 m: preflight and every engagement say
    so; with COM_OBL_RC_ACT 5 it holds."""
    began = time.monotonic()
    air.order("params.set", air.two, params={"COM_OBL_RC_ACT": 0}, force=True)
    try:
        air.order("control.set", air.two, mode="velocity", force=True)
        warnings = [e["text"] for e in air.watcher.events_since(began, "warning", vehicle=air.two)]
        figures["said"] = warnings[-1:]
        assert any("COM_OBL_RC_ACT is 0" in text and "sticks" in text for text in warnings), warnings
    finally:
        air.daemon.call("control.set", targets=air.two, mode="off")
        air.order("params.set", air.two, params={"COM_OBL_RC_ACT": 5}, force=True)
    with air.controlled("position"):
        air.daemon.kill()
        figures["farthest m"], figures["lowest m"] = stays_up(air, 8)
        figures["mode then"] = air.truth(air.one).mode
        air.daemon.start()
        air.wait(lambda: air.daemon.known() == 2 and air.connected(), 60, "the daemon knows both")
        assert figures["lowest m"] > HEIGHT_M - 2 and figures["farthest m"] < SAFE_M


def test_two_that_have_changed_places_come_home_without_meeting(air: Field, figures: dict[str, Any]) -> None:
    """`rtl all` let them pass at 0.10 m."""
    names = {"px4": {"RTL_RETURN_ALT": 12.0, "RTL_CONE_ANG": 0.0}, "ardupilot": {}}
    if not air.px4:
        held = air.daemon.call("params.get", targets=air.one, names=["RTL_ALT", "RTL_ALT_M"])["outcomes"][air.one]
        names["ardupilot"] = {"RTL_ALT": 1200.0} if held["RTL_ALT"]["ok"] else {"RTL_ALT_M": 12.0}
    air.order("params.set", "all", params=names["px4" if air.px4 else "ardupilot"], force=True)
    # past each other, one above the other, then down to each other's places
    (x1, y1), (x2, y2) = air.stand(air.one), air.stand(air.two)
    air.order("vehicles.goto", air.two, enu_m=[x2, y2, HEIGHT_M + 6])
    air.wait(lambda: air.enu(air.two)[2] > HEIGHT_M + 5, 40, "one is above")
    air.order("vehicles.goto", air.two, enu_m=[x1, y1 + 6, HEIGHT_M + 6])
    air.wait(lambda: math.dist(air.enu(air.two)[:2], (x1, y1 + 6)) < 1.5, 60, "it is there")
    air.order("vehicles.goto", air.one, enu_m=[x2, y2, HEIGHT_M])
    air.wait(lambda: math.dist(air.enu(air.one)[:2], (x2, y2)) < 1.5, 60, "the other, too")
    air.order("vehicles.goto", air.two, enu_m=[x1, y1, HEIGHT_M])
    air.wait(lambda: math.dist(air.enu(air.two), (x1, y1, HEIGHT_M)) < 1.5, 60, "they have changed places")
    # home
    began = time.monotonic()
    answer = air.daemon.call("vehicles.rtl", targets="all")
    figures["answers"] = {n: f"{o['result']}: {o['message'][:70]}" for n, o in answer["outcomes"].items()}
    least = [math.inf]

    def landed() -> bool:
        least[0] = min(least[0], math.dist(air.enu(air.one), air.enu(air.two)))
        return not any(air.truth(n).armed for n in air.names)

    figures["home s"] = air.wait(landed, 240, "both have landed")
    figures["least m"] = round(least[0], 2)
    figures["events"] = [e["text"][:80] for e in air.watcher.events_since(began, "return", "returns", "order")][:4]
    air.wait_idle()
    assert least[0] > APART_M
    homes = {name: air.state(name)["home"] for name in air.names}
    figures["from home m"] = {n: air.truth(n).metres_from(h["lat_deg"], h["lon_deg"]) for n, h in homes.items()}
    assert max(figures["from home m"].values()) < 4
