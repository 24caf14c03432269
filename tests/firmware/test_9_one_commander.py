"""A vehicle that two sites hear, and that obeys the ids of one of them: what the firmware itself ignores then."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.firmware_field import HEIGHT_M, Field

OURS, OTHER = 255, 249
"""System ids: the daemon's, which is SYSID_MYGCS by default, and another ground station's."""

GCS_ALONE = 1
"""Bit of MAV_OPTIONS."""

BRAKE = 17
ATTEMPTS = 5
POSITION_ONLY = 0b0000_1101_1111_1000


def obey_one_alone(field: Field, *, alone: bool) -> dict[str, float]:
    """Have the first vehicle obey our ids alone, or anybody again: SYSID_ENFORCE up to 4.6, a bit of MAV_OPTIONS from
    4.7 on. Returns what was set."""
    outcomes = field.daemon.call("params.get", targets=field.one, names=["SYSID_ENFORCE", "MAV_OPTIONS"])["outcomes"]
    held = outcomes[field.one]
    if held["SYSID_ENFORCE"]["ok"]:
        wanted = {"SYSID_ENFORCE": float(alone)}
    else:
        assert held["MAV_OPTIONS"]["ok"], held
        others = int(held["MAV_OPTIONS"]["value"]) & ~GCS_ALONE
        wanted = {"MAV_OPTIONS": float(others | GCS_ALONE if alone else others)}
    # in the air, where a person has to insist: it decides who is obeyed
    field.order("params.set", field.one, params=wanted, settle=False, force=True)
    return wanted


def other_orders(field: Field, orders: Callable[[Any], None]) -> dict[str, Any]:
    """What the first vehicle did in 4 s with what the other station sent five times, through the daemon, which forwards
    it."""
    arrived: Counter[str] = Counter()
    truth, began, place = field.truth(field.one), time.monotonic(), field.enu(field.one)

    def on_up(message: Any, now: float) -> None:
        if message.get_srcSystem() == OTHER and getattr(message, "target_system", 0) == field.sysids[0]:
            arrived[message.get_type()] += 1

    field.relay.on_up = on_up
    with field.ground_station(sysid=OTHER) as other:
        for _ in range(ATTEMPTS):
            orders(other)
            time.sleep(0.4)
        time.sleep(2)
        acks = 0
        while (message := other.recv_msg()) is not None:
            acks += message.get_type() == "COMMAND_ACK" and message.get_srcSystem() == field.sysids[0]
    field.relay.on_up = None
    modes = truth.modes_since(began)
    return {"arrived": dict(arrived), "acks": acks, "modes": modes, "moved m": math.dist(place, field.enu(field.one))}


@pytest.mark.only("ardupilot")
def test_an_arducopter_with_one_commander_ignores_the_other_station(air: Field, figures: dict[str, Any]) -> None:
    """As `one commander` of preflight has it. Without it the same mode order is obeyed."""
    sysid = air.sysids[0]
    east, north = air.stand(air.one)

    def brake(other: Any) -> None:
        other.mav.command_long_send(sysid, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, BRAKE, 0, 0, 0, 0, 0)

    def away(other: Any) -> None:
        frame = mav.MAV_FRAME_LOCAL_NED
        other.mav.set_position_target_local_ned_send(0, sysid, 1, frame, POSITION_ONLY, 20, 20, -20, *[0.0] * 8)

    air.order("vehicles.goto", air.one, enu_m=[east, north, HEIGHT_M])
    air.wait(lambda: air.steady(air.one), 30, "it stands")
    air.order("params.set", air.one, params={"SYSID_MYGCS": OURS}, settle=False, force=True)
    figures["set"] = obey_one_alone(air, alone=True)
    try:
        figures["mode order"] = other_orders(air, brake)
        figures["setpoints"] = other_orders(air, away)
        for found, kind in (
            (figures["mode order"], "COMMAND_LONG"),
            (figures["setpoints"], "SET_POSITION_TARGET_LOCAL_NED"),
        ):
            assert found["arrived"] == {kind: ATTEMPTS}
            assert found["acks"] == 0 and found["modes"] == ["GUIDED"] and found["moved m"] < 1.0
        air.order("vehicles.goto", air.one, enu_m=[east, north, HEIGHT_M + 2])
        air.wait(lambda: air.enu(air.one)[2] > HEIGHT_M + 1, 20, "it obeys this station")
        assert air.daemon.call("vehicles.stop", targets=air.one)["outcomes"][air.one]["ok"]
    finally:
        obey_one_alone(air, alone=False)
    air.order("vehicles.mode", air.one, mode="GUIDED")
    figures["without it"] = other_orders(air, brake)
    assert "BRAKE" in figures["without it"]["modes"] and figures["without it"]["acks"]
