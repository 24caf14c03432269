"""Arm, take off, go, hold, return, land: one vehicle and all of them; a mission; another origin in flight."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

from firmware.test_1_ground import plan
from support.firmware_field import HEIGHT_M, HOME, Field

NEAR_M = 2.0
"""A vehicle is where it was sent to: GPS noise of both simulators and the acceptance radius."""


def near(field: Field, name: str, enu_m: tuple[float, float, float]) -> bool:
    return math.dist(field.enu(name), enu_m) < NEAR_M


def test_arm_and_disarm_one_and_all(ground: Field, figures: dict[str, Any]) -> None:
    ground.order("vehicles.arm", ground.one, wait_s=60)
    assert not ground.truth(ground.two).armed
    ground.order("vehicles.disarm", ground.one)
    outcomes = ground.order("vehicles.arm", "all", wait_s=60)
    figures["arm s"] = max(o["elapsed_s"] for o in outcomes.values())
    ground.wait(lambda: all(ground.truth(n).armed for n in ground.names), 5, "both are armed")
    ground.order("vehicles.disarm", "all")
    ground.wait(lambda: not any(ground.truth(n).armed for n in ground.names), 5, "both are disarmed")


def test_one_takes_off_goes_holds_and_lands(ground: Field, figures: dict[str, Any]) -> None:
    figures["takeoff s"] = ground.takeoff(ground.one)
    assert not ground.truth(ground.two).armed
    ground.order("vehicles.goto", ground.one, enu_m=[0, 15, 12])
    figures["goto s"] = ground.wait(lambda: near(ground, ground.one, (0, 15, 12)), 60, "it is there")
    ground.order("vehicles.goto", ground.one, enu_m=[0, -15, 12])
    time.sleep(3)
    truth = ground.truth(ground.one)
    assert truth.speed_mps > 1
    ground.order("vehicles.hold", ground.one)
    at = (truth.lat_deg, truth.lon_deg)
    figures["standing s"] = ground.wait(lambda: truth.speed_mps < 0.5, 20, "it stands")
    figures["stopped after m"] = truth.metres_from(*at)
    assert figures["stopped after m"] < 15  # the goto was 30 m long
    figures["hold"] = truth.mode
    figures["land s"] = ground.land()


@pytest.mark.minutes
def test_one_returns(ground: Field, figures: dict[str, Any]) -> None:
    home = ground.enu(ground.one)[:2]
    ground.takeoff(ground.one)
    ground.order("vehicles.goto", ground.one, enu_m=[0, 20, 10])
    ground.wait(lambda: near(ground, ground.one, (0, 20, 10)), 60, "it is there")
    ground.order("vehicles.rtl", ground.one)
    figures["return s"] = ground.wait(lambda: not ground.truth(ground.one).armed, 180, "it has returned and disarmed")
    figures["from home m"] = math.dist(ground.enu(ground.one)[:2], home)
    assert figures["from home m"] < 3
    assert ground.truth(ground.two).alt_rel_m < 1


@pytest.mark.minutes
def test_all_take_off_go_return_and_land(ground: Field, figures: dict[str, Any]) -> None:
    homes = {name: ground.enu(name)[:2] for name in ground.names}
    figures["takeoff s"] = ground.takeoff()
    ground.order("vehicles.goto", "all", enu_m=[5, 12, 12])
    figures["goto s"] = ground.wait(
        lambda: near(ground, ground.one, (0, 12, 12)) and near(ground, ground.two, (10, 12, 12)), 60, "both are there"
    )
    ground.order("vehicles.hold", "all")
    ground.wait(lambda: all(ground.truth(n).speed_mps < 0.5 for n in ground.names), 20, "both stand")
    ground.order("vehicles.rtl", "all")
    figures["return s"] = ground.wait(
        lambda: not any(ground.truth(n).armed for n in ground.names), 180, "both have returned and disarmed"
    )
    figures["from home m"] = {name: math.dist(ground.enu(name)[:2], homes[name]) for name in ground.names}
    assert max(figures["from home m"].values()) < 3


@pytest.mark.minutes
def test_a_mission_is_flown(ground: Field, figures: dict[str, Any]) -> None:
    ground.order("missions.upload", ground.one, plan=plan(ground), lists=["mission"])
    began = time.monotonic()
    ground.order("missions.start", ground.one)
    ground.wait(lambda: near(ground, ground.one, (0, 15, 12)), 90, "the first waypoint")
    figures["first waypoint s"] = time.monotonic() - began
    ground.wait(lambda: near(ground, ground.one, (5, 15, 10)), 60, "the second waypoint")
    ground.wait(lambda: not ground.truth(ground.one).armed, 180, "it has returned and disarmed")
    figures["whole s"] = time.monotonic() - began
    events = [e["text"] for e in ground.watcher.events_since(began, "mission", vehicle=ground.one)]
    figures["events"] = len(events)
    assert events
    ground.ready_on_ground()
    ground.order("missions.clear", "all")


def test_another_origin_in_flight_moves_nobody(air: Field, figures: dict[str, Any]) -> None:
    before = {name: (air.truth(name).lat_deg, air.truth(name).lon_deg) for name in air.names}
    reported = air.state(air.one)["position"]["enu_m"]
    origin = {"lat_deg": HOME[0] + 0.0002, "lon_deg": HOME[1], "alt_amsl_m": HOME[2] - 5}
    try:
        air.daemon.call("origin.set", **origin)
        shifted = air.state(air.one)["position"]["enu_m"]
        figures["shift m"] = [round(b - a, 2) for a, b in zip(reported, shifted, strict=True)]
        assert abs(shifted[1] - reported[1] + 22.2) < 1
        assert abs(shifted[2] - reported[2] - 5) < 1
        air.holds(
            lambda: all(air.truth(n).metres_from(*before[n]) < 2.5 for n in air.names), 4, "the origin moved a vehicle"
        )
        # A goto in the new frame goes to the place that it names.
        air.order("vehicles.goto", air.one, enu_m=[0, -22.2, HEIGHT_M + 5])
        air.wait(lambda: near(air, air.one, (0, 0, HEIGHT_M)), 40, "it is at the place of the new frame")
    finally:
        air.daemon.call("origin.set", lat_deg=HOME[0], lon_deg=HOME[1], alt_amsl_m=HOME[2])
