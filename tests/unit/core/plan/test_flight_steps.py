"""How far a vehicle is from where it may be in a step of a plan."""

from __future__ import annotations

import pytest

from skygcs.core.plan.flight_steps import FlightStep, StepKind
from skygcs.core.trajectory import Piece, Trajectory


@pytest.mark.parametrize("timed", [True, False])
def test_heights_count_as_in_the_certificate(timed: bool) -> None:
    way = Trajectory([Piece(10.0, (0.0, 1.0), (0.0,), (10.0,))])
    step = FlightStep("leg", StepKind.PLAN, {"v1": way}, timed=timed)
    assert step.off_m("v1", (5.0, 0.0, 10.8), 5.0, 2.0) == pytest.approx(0.4)
    assert step.off_m("v1", (5.0, 0.8, 10.0), 5.0, 2.0) == pytest.approx(0.8)
    assert step.off_m("v1", (5.0, 0.6, 11.6), 5.0, 2.0) == pytest.approx(1.0)


def test_only_a_timed_step_asks_for_the_time() -> None:
    way = Trajectory([Piece(10.0, (0.0, 1.0), (0.0,), (10.0,))])
    late = (2.0, 0.0, 10.0)
    assert FlightStep("leg", StepKind.PLAN, {"v1": way}, timed=True).off_m("v1", late, 5.0, 2.0) == pytest.approx(3.0)
    assert FlightStep("leg", StepKind.PLAN, {"v1": way}).off_m("v1", late, 5.0, 2.0) == pytest.approx(0.0)
