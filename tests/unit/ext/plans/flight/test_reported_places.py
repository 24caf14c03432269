"""A vehicle whose positions come late is judged by where it was when it reported, not by where it may be by now."""

from __future__ import annotations

from skygcs.core.trajectory import ClockState, Piece, Trajectory
from skygcs.ext.plans.flight.execution import Execution
from skygcs.ext.plans.flight.flight_steps import FlightStep, StepKind
from skygcs.ext.plans.flight.plan_states import OrderKind, PlanState
from skygcs.ext.plans.flight.sights import Measurement, Tubes

TUBES = Tubes({"v1": 1.65}, {"v1": 0.4}, {"v1": 0.4}, 2.0)


def flying(*, timed: bool) -> Execution:
    """Along x with 2 m/s for 10 s; begun, at time 100."""
    way = Trajectory([Piece(10.0, (0.0, 2.0), (0.0,), (10.0,))])
    execution = Execution(
        [FlightStep("leg", StepKind.PLAN, {"v1": way}, timed=timed)], (), TUBES, {"v1": way.start_enu_m}
    )
    execution.begin()
    execution.outcome(OrderKind.ENGAGE, "v1", True, "")
    for at in (98.0, 99.0, 100.0):
        execution.tick(at, None, 0.0, {"v1": Measurement((0.0, 0.0, 10.0))})
    assert execution.state is PlanState.FLYING
    return execution


def test_a_gap_at_the_end_of_a_leg_is_no_trouble() -> None:
    execution = flying(timed=False)
    for n in range(1, 9):  # 1.6 s without a position: carried on, it is 2 m beyond the end
        sight = Measurement((20.0 + 0.3 * n, 0.0, 10.0), 0.2 * n, 2.0, reported_m=(19.8, 0.0, 10.0), before_s=0.2 * n)
        execution.tick(109.9 + 0.2 * n, ClockState.RUNNING, 9.95, {"v1": sight})
    assert execution.state is PlanState.FLYING


def test_a_gap_is_compared_with_the_reference_of_that_time() -> None:
    execution = flying(timed=True)
    for n in range(1, 26):
        now, s = 100.0 + 0.2 * n, 0.2 * n
        age_s = max(0.0, now - 103.5)  # the vehicle was last heard then, and turned away from its velocity since
        seen = 2.0 * (s - age_s)
        execution.tick(
            now,
            ClockState.RUNNING,
            s,
            {"v1": Measurement((seen + 9.0, 0.0, 10.0), age_s, 2.0, reported_m=(seen, 0.0, 10.0), before_s=age_s)},
        )
    assert execution.state is PlanState.FLYING


def test_one_that_was_late_when_it_reported_is_in_trouble() -> None:
    execution = flying(timed=True)
    for n in range(1, 16):
        now, s = 100.0 + 0.2 * n, 0.2 * n
        sight = Measurement((2.0 * s, 0.0, 10.0), 0.2, 2.0, reported_m=(2.0 * s - 1.0, 0.0, 10.0), before_s=0.2)
        execution.tick(now, ClockState.RUNNING, s, {"v1": sight})
    assert execution.state is PlanState.STOPPED and "from its reference" in execution.reason
