"""What keeps a plan on the ground: batteries, return heights, what force passes; and measured consumption."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.mavlink.param_encoding import Param
from skygcs.core.mavlink.vehicle_class import TABLE, VehicleClass
from skygcs.core.preflight.report import ReturnSetting, offered_heights
from skygcs.core.protocols.parameter import ParamOutcome
from skygcs.core.vehicle.flight_note import FlightRecord
from skygcs.ext.plans import plan_checks
from skygcs.ext.plans.flight import remedies
from skygcs.ext.plans.flight.flight_findings import (
    Finding,
    FlightTime,
    Level,
    battery_finding,
    refusals,
    refused,
    return_height_findings,
)
from skygcs.runtime import return_members
from support.table import each

MEASURED = FlightTime(600.0, "measured in flight")


@each(
    ("percent", "plan_s", "level"),
    [(100, 240.0, Level.OK), (80, 240.0, Level.OK), (79, 240.0, Level.REFUSED), (None, 1.0, Level.REFUSED)],
)
def test_the_charge_covers_plan_landing_and_reserve(percent: float | None, plan_s: float, level: Level) -> None:
    found = battery_finding("alpha", percent, MEASURED, plan_s, 30.0)  # 240 s and 60 s of 600 s are 50 %
    assert found.level is level and found.check == "battery"
    assert level is Level.OK or found.insist
    assert percent is None or "measured in flight" in found.text


@each("said", [math.nan, math.inf])
async def test_a_return_height_that_is_no_number_is_not_known(said: float) -> None:
    """Else it is near no other, and no way home would ever cross another."""

    class Params:
        async def get(self, name: str) -> ParamOutcome:
            return ParamOutcome(True, "accepted", "", name, Param(name, said))

    actor: Any = SimpleNamespace(
        name="alpha", vehicle=SimpleNamespace(abilities=TABLE["px4", VehicleClass.COPTER]), params=Params()
    )
    assert await plan_checks.return_heights([actor]) == {"alpha": None}
    assert await return_members._param(actor, (("RTL_ALT", 100.0),)) is None


def test_return_heights_that_are_too_near_name_both_and_what_to_set() -> None:
    heights = {
        "alpha": ReturnSetting("RTL_RETURN_ALT", 1.0, 30.0),
        "bravo": ReturnSetting("RTL_ALT", 100.0, 30.0),
        "carol": ReturnSetting("RTL_ALT", 100.0, 50.0),
        "delta": None,
    }
    found = return_height_findings(heights, 6.6)
    assert [(f.vehicle, f.level) for f in found] == [("delta", Level.REFUSED), ("bravo", Level.REFUSED)]
    assert "alpha at 30 m" in found[1].text and "37 m" in found[1].text and all(f.insist for f in found)
    apart = {"alpha": heights["alpha"], "carol": heights["carol"]}
    assert [f.level for f in return_height_findings(apart, 6.6)] == [Level.OK]


@given(st.dictionaries(st.text(min_size=1, max_size=4), st.floats(5.0, 100.0), max_size=20), st.floats(0.5, 15.0))
def test_offered_heights_are_apart_and_never_lower(now: dict[str, float], apart_m: float) -> None:
    heights = {name: ReturnSetting("RTL_ALT", 100.0, height) for name, height in now.items()}
    offered = offered_heights(heights, apart_m)
    assert all(offered[name] >= height - 1e-6 for name, height in now.items())
    again = {name: ReturnSetting("RTL_ALT", 100.0, height) for name, height in offered.items()}
    assert [f.level for f in return_height_findings(again, apart_m)] == [Level.OK]


def test_force_passes_only_what_can_be_insisted_on() -> None:
    battery = refused("alpha", "battery", "low", remedies.again("charge it"), insist=True)
    position = refused("alpha", "position", "unknown", remedies.leave_out("alpha", ["alpha", "bravo"]))
    fine = Finding("alpha", "link", Level.OK, "fine")
    assert refusals([battery, position, fine], force=False) == [battery, position]
    assert refusals([battery, position, fine], force=True) == [position]


def test_consumption_is_believed_after_some_minutes_and_begins_anew_with_another_battery() -> None:
    record = FlightRecord()
    now = 0.0
    for percent in range(100, 79, -1):
        record.charge(now, float(percent), in_air=True)
        now += 6.0
    assert record.flight_time_s == pytest.approx(600.0)
    record.charge(now, 100.0, in_air=True)
    assert record.flight_time_s is None
    record = FlightRecord()
    for percent in (100.0, 90.0):
        record.charge(now, percent, in_air=False)
    record.charge(now + 900.0, None, in_air=True)
    assert record.flight_time_s is None, "on the ground nothing is consumed for flying"
