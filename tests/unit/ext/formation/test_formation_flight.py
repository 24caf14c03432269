"""The states of a formation's flight."""

from __future__ import annotations

import pytest

from skygcs.ext.formation.formation_flight import FormationFlight, FormationState
from skygcs.ext.formation.leader import Fly, Leader
from skygcs.ext.formation.separation_filter import Member, MotionBounds, Moving, SeparationFilter

BOUNDS = MotionBounds()
STARTS = {"a": (0.0, 5.0, 10.0), "b": (0.0, -5.0, 10.0)}
FLYING, STOPPING, STOPPED = FormationState


def flight(led_by: str | None = None) -> FormationFlight:
    leader = Leader(Moving((0.0, 0.0, 10.0)), 0.0, BOUNDS, {"a": (0.0, 5.0, 0.0), "b": (0.0, -5.0, 0.0)})
    members = {name: Member(2.0, Moving(start)) for name, start in STARTS.items()}
    return FormationFlight(leader, SeparationFilter(members, BOUNDS, 2.0), {"a": 1.0, "b": 1.0}, led_by)


class Run:
    """Steps, with members that are where their references are."""

    def __init__(self, formation: FormationFlight) -> None:
        self.formation, self.now = formation, 0.0

    def step(self, seconds: float, *, leader: Moving | None = None, **seen: Moving | None) -> dict[str, object]:
        """``seen``: those that are elsewhere; None: not seen."""
        sent: dict[str, object] = {}
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            members = {name: member.moving for name, member in self.formation.filter.members.items()}
            members.update(seen)  # type: ignore[arg-type]
            known = {name: moving for name, moving in members.items() if moving is not None}
            sent = dict(self.formation.step(known, leader, [], 0.1, self.now))
        return sent


def test_it_stops_by_braking_and_then_sends_nothing() -> None:
    run = Run(flight())
    run.formation.leader.demand = Fly((1.5, 0.0, 0.0), 100.0)
    assert run.step(5.0).keys() == {"a", "b"}
    run.formation.stop("asked for")
    assert run.formation.state is STOPPING and run.step(0.5).keys() == {"a", "b"}
    run.step(3.0)
    assert run.formation.state is STOPPED and run.step(0.1) == {}
    run.formation.stop("again")
    assert run.formation.reason == "asked for"


def test_one_that_is_off_its_reference_for_a_second_stops_all() -> None:
    run, away = Run(flight()), Moving((0.0, 7.0, 10.0))
    run.step(0.8, a=away)
    run.step(0.2)
    run.step(0.8, a=away)
    assert run.formation.state is FLYING
    run.step(0.5, a=away)
    assert run.formation.state is not FLYING and "a is off: 2.0 m from its reference" in run.formation.reason


def test_one_that_is_not_seen_stops_all() -> None:
    run = Run(flight())
    run.step(1.5, b=None)
    assert "b is off: its position is old" in run.formation.reason


def test_one_that_leaves_is_sent_nothing_more_and_stops_the_others() -> None:
    run = Run(flight())
    run.formation.leave("a", "it was given another order")
    run.formation.leave("a", "twice")
    assert run.step(0.1).keys() == {"b"}
    assert run.formation.reason == "a left: it was given another order"
    assert run.formation.members == ["b"]
    assert [member["left"] for member in run.formation.status(run.now)["members"]] == [
        "it was given another order",
        None,
    ]


def test_a_leader_that_is_not_seen_stops_all() -> None:
    run = Run(flight("lead"))
    run.step(0.5, leader=Moving((0.0, 0.0, 10.0)))
    assert run.formation.state is FLYING
    run.step(0.1)
    assert "lead, which leads, is not seen" in run.formation.reason


def test_its_status_has_distances_and_whether_it_is_settled() -> None:
    run = Run(flight())
    run.step(1.0)
    status = run.formation.status(run.now)
    assert status["settled"] and status["rms_m"] == 0.0 and status["least_m"] == pytest.approx(10.0)
    run.formation.leader.wanted_yaw_rad = 1.0
    run.step(0.3)
    assert not run.formation.status(run.now)["settled"]


def test_a_programs_places_hold_until_then_and_then_all_stay() -> None:
    run = Run(flight())
    run.formation.guide({"a": Moving((3.0, 5.0, 10.0), (0.5, 0.0, 0.0))}, until=4.0)
    run.step(3.5)
    assert run.formation.guided and run.formation.status(run.now)["leader"] == "program"
    assert not run.formation.status(run.now)["settled"]
    a = run.formation.filter.members["a"].moving
    assert a.pos_enu_m[0] > 2.0 and a.vel_enu_mps[0] > 0.4
    assert run.formation.filter.members["b"].moving.pos_enu_m == pytest.approx(STARTS["b"])
    run.step(6.0)
    assert not run.formation.guided and run.formation.status(run.now)["settled"]
    assert run.formation.filter.members["a"].moving.pos_enu_m[0] < 7.0


def test_after_a_pause_of_the_loop_the_leader_does_not_run_ahead() -> None:
    formation = flight()
    formation.leader.demand = Fly((1.5, 0.0, 0.0), 100.0)
    seen = {name: member.moving for name, member in formation.filter.members.items()}
    formation.step(seen, None, [], 20.0, 20.0)
    assert formation.leader.moving.pos_enu_m[0] < 0.1
    assert formation.leader.moving.vel_enu_mps[0] <= 1.5
