"""The lock of a flight: which changes touch it, and what a refusal says."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import Origin
from skygcs.core.vehicle.flight_lock import (
    Change,
    ConsoleInput,
    FenceListWrite,
    FenceWrite,
    FlightLock,
    Holder,
    HomeMove,
    LinkLoss,
    Member,
    OriginChange,
    ParamWrite,
    Renumbering,
    SensorCalibration,
    widens,
)
from skygcs.core.vehicle.trajectory_flight import TrajectoryLimits
from skygcs.errors import RefusedError
from skygcs.runtime.flight_locks import FlightLocks
from support.table import each

ORIGIN = Origin(43.7806, -79.4653, 180.0)
HOME = (43.7806, -79.4653, 180.0)
ALPHA, BRAVO, OTHER = 0x101, 0x201, 0x301


def member(name: str, key: int, family: str = "px4") -> Member:
    return Member(name, key, family, Fence(ORIGIN), TrajectoryLimits(), HOME, frozenset({"air"}), "AUTO.LOITER")


def lock(holder: Holder = Holder.PLAN, *members: Member) -> FlightLock:
    return FlightLock(holder, "show", ORIGIN, members or (member("alpha", ALPHA), member("bravo", BRAVO, "ardupilot")))


@each(
    ("change", "why"),
    [
        (OriginChange(ORIGIN), None),
        (OriginChange(replace(ORIGIN, x_heading_deg=270.0)), "count from the origin"),
        (OriginChange(None), "count from the origin"),
        (ParamWrite(ALPHA, "MAV_SYS_ID", force=True), "MAV_SYS_ID: it is addressed by it"),
        (ParamWrite(BRAVO, "FRAME_CLASS", force=True), "FRAME_CLASS: its motors"),
        (ParamWrite(BRAVO, "PSC_POSXY_P"), r"a gain or a limit of its control \(force sets it"),
        (ParamWrite(BRAVO, "PSC_POSXY_P", force=True), None),
        (ParamWrite(ALPHA, "NEXT_YEARS_IDEA"), "not known to skygcs"),
        (ParamWrite(ALPHA, "SDLOG_MODE"), None),
        (ParamWrite(OTHER, "MAV_SYS_ID"), None),
        (FenceWrite(ALPHA, widens=True), None),
        (FenceWrite(ALPHA, widens=False), "within the present fence"),
        (FenceListWrite(BRAVO), "within the present fence"),
        (LinkLoss("air", frozenset({ALPHA, OTHER})), "air is the only link to alpha"),
        (LinkLoss("air", frozenset({OTHER})), None),
        (Renumbering(BRAVO), "addressed"),
        (HomeMove(ALPHA, (HOME[0] + 1e-6, HOME[1], HOME[2] + 0.4)), None),
        (HomeMove(ALPHA, (HOME[0] + 1e-4, HOME[1], HOME[2])), "from the present home"),
        (HomeMove(ALPHA, (*HOME[:2], HOME[2] + 3.0)), "from the present home"),
        (HomeMove(ALPHA, None), "from the present home"),
        (SensorCalibration(ALPHA), "present calibration"),
        (SensorCalibration(OTHER), None),
        (ConsoleInput(BRAVO), "command of the console"),
        (ConsoleInput(OTHER), None),
    ],
)
def test_a_change_waits_for_the_end_unless_it_touches_nothing(change: Change, why: str | None) -> None:
    refusal = lock().refusal(change)
    if why is None:
        assert refusal is None
    else:
        assert refusal is not None
        assert re.search(why, refusal)
        assert refusal.endswith("plan show is flown by alpha and bravo: `skygcs-cli plan abort` first")


@each(
    ("family", "changes", "wider"),
    [
        ("px4", {"GF_MAX_HOR_DIST": 60.0}, True),
        ("px4", {"GF_MAX_HOR_DIST": 0.0}, True),
        ("px4", {"GF_MAX_HOR_DIST": 20.0}, False),
        ("px4", {"GF_MAX_VER_DIST": 20.0}, False),
        ("px4", {"GF_ACTION": 0.0}, False),
        ("ardupilot", {"FENCE_RADIUS": 60.0, "FENCE_TYPE": 2.0}, True),
        ("ardupilot", {"FENCE_RADIUS": 20.0}, False),
        ("ardupilot", {"FENCE_TYPE": 3.0}, False),
        ("ardupilot", {"FENCE_ENABLE": 0.0}, False),
    ],
)
def test_a_fence_is_wider_if_nothing_of_it_is_nearer(family: str, changes: dict[str, float], wider: bool) -> None:
    held = {
        "px4": {"GF_MAX_HOR_DIST": 30.0, "GF_MAX_VER_DIST": 0.0, "GF_ACTION": 2.0},
        "ardupilot": {"FENCE_RADIUS": 30.0, "FENCE_ALT_MAX": 50.0, "FENCE_TYPE": 2.0, "FENCE_ENABLE": 1.0},
    }[family]
    assert widens(held, changes) is wider


def test_the_plan_is_named_before_its_engagements_and_a_flight_that_ended_holds_nothing() -> None:
    locks, flies = FlightLocks(), {"plan": True, "control": True}
    engaged = locks.take(lock(Holder.ENGAGEMENT, member("alpha", ALPHA)), lambda: flies["control"])
    plan = locks.take(lock(), lambda: flies["plan"])
    change = OriginChange(None)
    assert locks.held() == [plan, engaged]
    assert "`skygcs-cli plan abort` first" in str(locks.refusal(change))
    assert "`skygcs-cli hold alpha` first" in str(locks.refusal(change, own=plan))
    flies["plan"] = False
    with pytest.raises(RefusedError, match="alpha is under control: `skygcs-cli hold alpha` first"):
        locks.require(change)
    flies["control"] = False
    assert locks.held() == [] and locks.refusal(change) is None


def test_a_flight_whose_code_fails_holds_its_lock_and_stops_no_order_path() -> None:
    faults: list[Exception] = []
    locks, fails, flies = FlightLocks(on_fault=faults.append), True, True

    def under_way() -> bool:
        if fails:
            raise ValueError("broken")
        return flies

    plan = locks.take(lock(), under_way)
    assert locks.held() == [plan] and [str(fault) for fault in faults] == ["broken"]
    why = str(locks.refusal(Renumbering(ALPHA)))
    assert "`skygcs-cli plan abort` first" in why and why.endswith("if it has, restart skygcs")
    with pytest.raises(RefusedError, match="could not say whether it has ended"):
        locks.require(OriginChange(None))
    assert locks.refusal(Renumbering(OTHER)) is None, "what touches no flight is none of its business"
    fails = False
    assert str(locks.refusal(Renumbering(ALPHA))).endswith("`skygcs-cli plan abort` first"), "it answers again"
    flies = False
    assert locks.held() == []


def test_a_flight_that_recovers_may_still_change_what_it_holds_itself() -> None:
    fails = True

    def under_way() -> bool:
        if fails:
            raise ValueError("broken")
        return True

    locks = FlightLocks()
    own = locks.take(lock(), under_way)
    later = locks.take(lock(Holder.PLAN, member("alpha", ALPHA)), lambda: True)
    fails = False
    assert [[m.name for m in one.members] for one in locks.held()] == [["bravo"], ["alpha"]]
    assert locks.refusal(Renumbering(BRAVO), own=own) is None, "the flight has its own lock, whoever took members of it"
    assert locks.refusal(Renumbering(BRAVO)) is not None
    assert locks.refusal(Renumbering(ALPHA), own=own) is not None
    assert locks.refusal(Renumbering(ALPHA), own=later) is None


def test_flights_that_fail_leave_one_lock_per_kind_and_vehicle() -> None:
    def broken() -> bool:
        raise ValueError("broken")

    locks = FlightLocks()
    for _ in range(3):
        locks.take(lock(), broken)
    other = locks.take(lock(Holder.ENGAGEMENT, member("alpha", ALPHA)), broken)
    last = locks.take(lock(Holder.PLAN, member("alpha", ALPHA)), lambda: True)
    held = locks.held()
    assert [[m.name for m in one.members] for one in held] == [["bravo"], ["alpha"], ["alpha"]]
    assert last in held and other in held
