from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.plans.random_plans import judge
from bench.plans.refusals import Case, cases, line, passing
from skygcs.core.plan.fleet_plan import FlightSpace, Phase, PhasedPlan, TimedPlan
from skygcs.core.plan.margins import MarginRule, Motion, Uncertainty
from skygcs.core.plan.segment_distance import SLACK_M, segment_segment
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory, motion_peaks
from skygcs.core.trajectory.timing import hover
from skygcs.errors import RefusedError, TrajectoryError
from skygcs.ext.plans.certificates import certify as certifying
from skygcs.ext.plans.certificates import space_check
from skygcs.ext.plans.certificates.bernstein_arrays import gathered
from skygcs.ext.plans.certificates.certificate import SpaceProblem
from skygcs.ext.plans.certificates.certify import MAX_NAMED, certify, motions_of
from skygcs.ext.plans.certificates.space_check import breaches
from support.examples import examples
from support.table import each

RULE = MarginRule(fixed_m=2.5)
NAMED = re.compile(r"(straight, timed: )?(\w+ and \w+ come within|\w+ is) [\d.]+ m .*at [\d.]+ s, at \([-\d., ]+\)")


@each("case", list(cases()))
def test_what_must_be_refused_is_refused_with_its_pair(case: Case) -> None:
    certified, reasons = case.judged()
    if case.names:
        assert not certified
        assert all(any(name in reason for reason in reasons) for name in case.names), reasons
        assert any(NAMED.match(reason) for reason in reasons), "the pair or the wall, the time and the place"
    else:
        assert certified, reasons


def test_the_near_miss_is_one_that_samples_at_5_hz_do_not_see() -> None:
    alpha, bravo = passing(2.427).values()
    sampled = [math.dist(alpha.at(t).pos_enu_m, bravo.at(t).pos_enu_m) for t in np.arange(0.0, 10.3, 0.2)]
    assert min(sampled) > 2.5 > math.dist(alpha.at(5.1).pos_enu_m, bravo.at(5.1).pos_enu_m)


def test_random_plans_agree_with_the_independent_checker() -> None:
    for seed in range(examples(24)):
        judged = judge(seed)
        assert not judged.violation and not judged.loose, (seed, judged)


# --- without barriers -------------------------------------------------------------------------------------------------

corners = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(4, 20))


@given(
    st.lists(corners, min_size=3, max_size=3),
    st.lists(st.lists(corners | st.none(), min_size=3, max_size=3), min_size=1, max_size=3),
)
@settings(max_examples=examples(40), deadline=None)
def test_without_barriers_a_vehicle_may_be_anywhere_on_its_way_while_another_is(
    starts: list[tuple[float, float, float]], goals: list[list[tuple[float, float, float] | None]]
) -> None:
    """Against points on all ways, each beside each other, in the same metric."""
    names = ("a", "b", "c")
    phases = tuple(
        Phase(f"p{i}", {n: goal for n, goal in zip(names, phase, strict=True) if goal is not None})
        for i, phase in enumerate(goals)
    )
    plan = PhasedPlan(dict(zip(names, starts, strict=True)), phases)
    found = certify(plan, RULE, barriers=False)
    step_m, ways = 0.25, {}
    for name in names:
        points = []
        for _, legs in plan.legs():
            begin, end = (np.array(place) / (1.0, 1.0, RULE.downwash_ratio) for place in legs[name])
            parts = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(end - begin) / step_m))
            points.append(begin + parts[:, None] * (end - begin))
        ways[name] = np.concatenate(points)
    least_m = min(
        float(np.sqrt(((ways[a][:, None] - ways[b][None]) ** 2).sum(axis=2)).min())
        for a, b in itertools.combinations(names, 2)
    )
    assert found.closest is not None and found.kind == "free"
    one, other = (np.array(place) / (1.0, 1.0, RULE.downwash_ratio) for place in found.closest.places_m)
    assert float(np.linalg.norm(one - other)) == pytest.approx(found.closest.distance_m, abs=1e-9)
    assert found.closest.distance_m - 1e-6 <= least_m <= found.closest.distance_m + step_m
    assert found.certified == (found.closest.distance_m >= RULE.half_m("a") * 2 - 1e-9)
    assert certify(plan, RULE).certified or not found.certified, "what needs no barriers holds with them"


def test_a_swap_in_layers_needs_its_barriers_and_its_phases_are_named() -> None:
    a, b = (0.0, 0.0, 10.0), (9.0, 0.0, 10.0)
    plan = PhasedPlan(
        {"a": a, "b": b},
        (
            Phase("climb", {"b": (9.0, 0.0, 17.0)}),
            Phase("cross", {"a": b, "b": (0.0, 0.0, 17.0)}),
            Phase("descend", {"b": a}),
        ),
    )
    assert certify(plan, RULE).certified
    free = certify(plan, RULE, barriers=False)
    assert not free.certified and {approach.phase for approach in free.too_close} == {
        "climb and descend",
        "climb and cross",
        "cross and descend",
    }


# --- margins ----------------------------------------------------------------------------------------------------------


def test_every_term_of_a_margin_is_named() -> None:
    rule = MarginRule(
        Uncertainty(wingspan_m=1.0, position_error_m=0.5, tracking_error_m=0.25, delay_s=0.2, clock_error_s=0.05),
        by_vehicle={"big": Uncertainty(wingspan_m=3.0)},
    )
    assert rule.terms("alpha") == {"half wingspan": 0.5, "position error": 0.5, "tracking error p99": 0.25}
    timed = rule.terms("alpha", Motion(4.0, 2.0, 0.01))
    assert timed["speed × (delay p99 + clock error)"] == pytest.approx(1.0)
    assert timed["velocity jumps"] == pytest.approx(1.01)
    assert rule.terms("big")["half wingspan"] == 1.5
    plan = TimedPlan({"alpha": line((0, 0, 10), (40, 0, 10), 10.0), "big": hover((0.0, 30.0, 10.0), 10.0)})
    closest = certify(plan, rule).closest
    assert closest is not None
    assert closest.margin_m == pytest.approx(sum(sum(terms.values()) for terms in closest.terms.values()))
    assert closest.terms["alpha"]["velocity jumps"] == pytest.approx(4.0)  # 4 m/s from and to standing at 2 m/s²
    json.dumps(certify(plan, rule).as_dict())


def test_what_is_left_to_vehicles_that_use_up_their_terms_is_reported() -> None:
    off = Uncertainty(tracking_error_m=1.5)
    plan = PhasedPlan({"a": (0.0, 0.0, 10.0), "b": (0.0, 0.0, 21.0)}, (Phase("go", {"a": (20.0, 0.0, 10.0)}),))
    closest = certify(plan, MarginRule(off)).closest
    assert closest is not None and closest.margin_m == pytest.approx(5.5) and closest.distance_m == pytest.approx(5.5)
    assert closest.flown_at_least_m == pytest.approx(2 * (0.35 + 0.9), abs=1e-3)
    given = certify(plan, MarginRule(fixed_m=2.5)).closest
    assert given is not None and given.flown_at_least_m is None


@each("value", [math.nan, -1.0, 1e3])
def test_uncertainties_that_are_none_are_refused(value: float) -> None:
    with pytest.raises(RefusedError):
        Uncertainty(wingspan_m=value)
    with pytest.raises(RefusedError):
        MarginRule(downwash_ratio=value)
    with pytest.raises(RefusedError):
        MarginRule(fixed_m=value if value != 1e3 else 1e4)


@settings(max_examples=examples(60), deadline=None)
@given(
    st.lists(
        st.builds(Piece, st.floats(0.2, 3.0), *[st.lists(st.floats(-5, 5), min_size=1, max_size=8).map(tuple)] * 3),
        min_size=1,
        max_size=3,
    )
)
def test_speeds_for_the_margin_are_bounds_and_not_far_off(pieces: list[Piece]) -> None:
    trajectory = Trajectory(pieces)
    (motion,) = motions_of([trajectory])
    peak = motion_peaks(trajectory).speed_mps
    assert motion.speed_mps >= peak.at_least * (1 - 1e-9)
    assert motion.speed_mps <= 1.3 * peak.at_most + 1e-3


@each("degree", [1, 3, 7])
@each("duration_s", [0.5, 2.0])
def test_what_coordinates_may_be_wrong_by_is_in_the_speed(
    degree: int, duration_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against the curve whose first coefficient is wrong by that to one side and its second to the other, on each
    axis; it is the fastest at its beginning."""
    error_m = 1e-3
    monkeypatch.setattr(certifying, "gathered", lambda ways: gathered(ways)._replace(error_m=np.array([error_m])))
    axis = (1.0, 5.0, *(0.0,) * (degree - 2), -1e-4)[: degree + 1]
    (motion,) = motions_of([Trajectory([Piece(duration_s, axis, axis, axis)])])
    assert motion.speed_mps == pytest.approx(math.sqrt(3) * (5.0 + degree * 2 * error_m / duration_s), rel=1e-7)


# --- phases and walls -------------------------------------------------------------------------------------------------


def test_a_phase_is_judged_wherever_each_vehicle_is_on_its_leg() -> None:
    """They would pass in time; one that is late would not."""
    starts = {"a": (0.0, 0.0, 10.0), "b": (20.0, 0.0, 10.0)}
    cross = PhasedPlan(starts, (Phase("cross", {"a": (20.0, 5.0, 10.0), "b": (20.0, 30.0, 10.0)}),))
    certificate = certify(cross, RULE)
    assert not certificate.certified
    assert "a and b come within 0.000 m in phase cross, at (20.00, 5.00, 10.00)" in certificate.reasons()[0]
    after = PhasedPlan(starts, (Phase("b", {"b": (20.0, 30.0, 10.0)}), Phase("a", {"a": (20.0, 5.0, 10.0)})))
    assert certify(after, RULE).certified


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 12), st.integers(1, 4), st.floats(0.01, 4.0))
def test_what_is_dropped_before_the_exact_distance_is_never_the_nearest_pair(
    seed: int, count: int, phases: int, margin_m: float
) -> None:
    """Every pair of every phase by the exact distance of its segments: of 255 vehicles in 1,000 phases it took 30 s."""
    rng = np.random.default_rng(seed)
    names = [f"v{number}" for number in range(count)]
    places = rng.uniform(-8.0, 8.0, (phases + 1, count, 3)).round(1)
    rows = [dict(zip(names, map(tuple, row.tolist()), strict=True)) for row in places]
    plan = PhasedPlan(rows[0], tuple(Phase(f"p{number}", goals) for number, goals in enumerate(rows[1:])))
    reports: list[tuple[int, int]] = []
    found = certify(plan, MarginRule(fixed_m=margin_m), progress=lambda *done: reports.append(done))
    first, second = np.triu_indices(count, 1)
    exact = []
    for begins, ends in itertools.pairwise(places / [1.0, 1.0, MarginRule().downwash_ratio]):
        distances, *_ = segment_segment(begins[first], ends[first], begins[second], ends[second])
        exact.append(distances)
    least_m = float(np.min(exact))
    assert found.closest is not None and found.closest.distance_m == pytest.approx(least_m, abs=1e-9)
    assert least_m - 2 * SLACK_M < found.closest.distance_at_least_m < least_m
    too_close = int((np.array(exact) - margin_m < SLACK_M).sum())
    assert len(found.too_close) == min(too_close, MAX_NAMED) or too_close > MAX_NAMED
    assert reports == [(number, phases) for number in range(phases)]


def test_all_pairs_that_are_too_close_in_a_phase_are_named() -> None:
    starts = {f"v{i}": (2.0 * i, 0.0, 10.0) for i in range(4)}
    certificate = certify(PhasedPlan(starts, (Phase("stay", {}),)), RULE)
    assert [approach.vehicles for approach in certificate.too_close] == [("v0", "v1"), ("v1", "v2"), ("v2", "v3")]


def test_no_more_pairs_are_named_than_a_person_reads_and_the_first_of_equal_ones_is_the_closest() -> None:
    starts = {f"v{i}": (2.0 * i, 0.0, 10.0) for i in range(3)}
    stays = PhasedPlan(starts, tuple(Phase(f"p{number}", {}) for number in range(MAX_NAMED)))
    certificate = certify(stays, RULE)
    assert len(certificate.too_close) == len(certificate.reasons()) == MAX_NAMED
    assert certificate.closest is not None
    assert (certificate.closest.phase, certificate.closest.vehicles) == ("p0", ("v0", "v1"))


def test_the_closest_pair_is_named_however_far_apart_and_of_one_vehicle_there_is_none() -> None:
    starts = {"a": (-30.0, 0.0, 0.0), "b": (30.0, 0.0, 0.0), "c": (30.0, 40.0, 0.0)}
    certificate = certify(PhasedPlan(starts, (Phase("stay", {}),)), RULE)
    assert certificate.certified and certificate.closest is not None
    assert (certificate.closest.vehicles, certificate.closest.distance_m) == (("b", "c"), 40.0)
    alone = certify(PhasedPlan({"a": (0.0, 0.0, 10.0)}, (Phase("go", {"a": (5.0, 0.0, 10.0)}),)), RULE)
    assert alone.certified and alone.closest is None and alone.as_dict()["closest"] is None


def test_walls_are_kept_on_the_whole_of_each_leg() -> None:
    """The first phase ends before the box, and the second one behind it."""
    plan = PhasedPlan(
        {"a": (0.0, 0.0, 10.0), "b": (0.0, 40.0, 10.0)},
        (Phase("near", {"a": (4.0, 0.0, 10.0)}), Phase("through", {"a": (20.0, 0.0, 10.0)})),
    )
    space = FlightSpace(boxes=(((10.0, -1.0, 0.0), (12.0, 1.0, 30.0)),))
    certificate = certify(plan, RULE, space)
    assert not certificate.certified and certificate.too_close == ()
    (problem,) = certificate.space
    assert (problem.vehicle, problem.what, problem.phase, problem.t_s) == ("a", "box 1", "through", None)
    assert problem.margin_m == 1.25 and problem.distance_m == pytest.approx(1.25, abs=1e-4)
    assert problem.text() == "a is 1.25 m from box 1 in phase through, at (8.75, 0.00, 10.00); margin 1.25 m"
    said = certificate.as_dict()
    assert said["space"] == [asdict(problem) | {"text": problem.text()}] and said["reasons"] == [problem.text()]
    assert said["closest"] == asdict(certificate.closest) | {
        "clearance_m": certificate.closest.clearance_m,
        "flown_at_least_m": certificate.closest.flown_at_least_m,
        "text": certificate.closest.text(),
    }
    assert certify(plan, RULE, FlightSpace(boxes=(((10.0, 1.3, 0.0), (12.0, 3.0, 30.0)),))).certified


def test_no_more_problems_with_walls_are_named_than_a_person_reads() -> None:
    starts = {f"v{i}": (10.0 * i, 0.0, 10.0) for i in range(8)}
    plan = PhasedPlan(starts, tuple(Phase(f"p{number}", {}) for number in range(4)))
    certificate = certify(plan, RULE, FlightSpace(floor_m=11.0))
    assert len(certificate.space) == MAX_NAMED and not certificate.certified
    assert {problem.margin_m for problem in certificate.space} == {0.0}, "every flight begins and ends at the floor"


def test_no_leg_may_pass_a_standing_vehicle() -> None:
    space = FlightSpace(standing={"p": (10.0, 2.0, 10.0), "q": (11.0, 2.0, 10.0)})
    plan = PhasedPlan({"a": (0.0, 0.0, 10.0)}, (Phase("cross", {"a": (20.0, 0.0, 10.0)}),))
    certificate = certify(plan, RULE, space)
    assert [approach.vehicles for approach in certificate.too_close] == [("a", "p"), ("a", "q")]
    assert certificate.as_dict()["too_close"] == [approach.as_dict() for approach in certificate.too_close]
    assert certify(plan, MarginRule(fixed_m=1.9), space).certified  # the two that stand are not compared


def test_a_vehicle_that_takes_part_cannot_stand() -> None:
    plan = TimedPlan({"a": hover((0.0, 0.0, 10.0), 1.0)})
    with pytest.raises(RefusedError, match="a takes part"):
        certify(plan, RULE, FlightSpace(standing={"a": (0.0, 0.0, 0.0)}))


def test_a_trajectory_that_jumps_is_refused() -> None:
    jump = Trajectory([Piece(1.0, (0.0,), (0.0,), (10.0,)), Piece(1.0, (1.0,), (0.0,), (10.0,))])
    with pytest.raises(TrajectoryError, match="vehicle a: piece 2: the position jumps by 1 m at 1 s"):
        certify(TimedPlan({"a": jump}), RULE)


def test_limits_of_motion_are_part_of_the_judgement_where_they_are_asked_for() -> None:
    plan = TimedPlan({"a": line((0, 0, 10), (60, 0, 10), 10.0), "b": line((0, 30, 10), (40, 30, 10), 10.0)})
    assert certify(plan, RULE).certified
    certificate = certify(plan, RULE, limits=MotionLimits(speed_mps=5.0))
    assert not certificate.certified
    assert certificate.reasons() == ["a: piece 1: speed of 6 m/s at 0 s; the limit is 5 m/s"]


@each(
    ("space", "what"),
    [
        (FlightSpace(ceiling_m=16.24), "the ceiling"),
        (FlightSpace(ceiling_m=16.26), None),
        (FlightSpace(floor_m=10.01), "the floor"),
        (FlightSpace(floor_m=10.0), None),
        (FlightSpace(boxes=(((4.0, 1.2, 0.0), (6.0, 3.0, 30.0)),)), "box 1"),
        (FlightSpace(boxes=(((4.0, 1.26, 0.0), (6.0, 3.0, 30.0)),)), None),
        (FlightSpace(boxes=(((4.0, -1.0, 0.0), (6.0, 1.0, 30.0)),)), "box 1"),
        (FlightSpace(fence=((-2, -2), (12, -2), (12, 2), (-2, 2))), None),
        (FlightSpace(fence=((-2, -2), (12, -2), (12, 1.24), (-2, 1.24))), "the fence"),
        (FlightSpace(fence=((20, -2), (32, -2), (32, 2), (20, 2))), "the fence"),
    ],
)
def test_walls_are_kept_between_all_samples(space: FlightSpace, what: str | None) -> None:
    """A hop from (0, 0) to (10, 0), 5 m up in the middle."""
    hop = Trajectory([Piece(2.0, (0.0, 5.0), (0.0,), (10.0, 10.0, -5.0))])
    certificate = certify(TimedPlan({"a": hop}), RULE, space)
    assert [problem.what for problem in certificate.space] == ([] if what is None else [what])
    assert certificate.certified == (what is None)


@settings(max_examples=examples(40), deadline=None)
@given(
    st.lists(st.floats(-8, 8), min_size=4, max_size=4).map(tuple),
    st.lists(st.floats(-8, 8), min_size=4, max_size=4).map(tuple),
    st.lists(st.tuples(st.floats(-15, 15), st.floats(-15, 15)), min_size=3, max_size=7).map(tuple),
)
@example((0.0,) * 4, (0.0,) * 4, ((0.0, 0.0), (0.0, 2.225073858507203e-309), (1.0, 0.0)))
def test_no_sample_is_beyond_a_fence_that_was_kept(east, north, fence) -> None:
    trajectory = Trajectory([Piece(1.0, east, north, (10.0,))])
    kept = not breaches([trajectory], [0.5], FlightSpace(fence=fence))
    inside = [_distance_to(fence, trajectory.at(t).pos_enu_m[:2]) for t in np.linspace(0.0, 1.0, 101)]
    if kept:
        assert min(inside) >= 0.5 - 1e-9
    else:
        assert min(inside) < 0.5 + 0.5  # a sample near the breach
    east_m, north_m, up_m = trajectory.at(0.5).pos_enu_m
    (found,) = breaches([hover((east_m, north_m, up_m), 1.0)], [1000.0], FlightSpace(fence=fence))
    wanted_m = _distance_to(fence, (east_m, north_m))
    assert found.distance_m == pytest.approx(wanted_m, abs=1e-9) or abs(wanted_m) < 1e-6


@each(
    ("up_m", "space", "distance_m"),
    [
        (-0.5, FlightSpace(ceiling_m=0.0), 0.5),
        (0.0, FlightSpace(ceiling_m=0.0), 0.0),
        (-0.5, FlightSpace(floor_m=0.0), -0.5),
        (10.0, FlightSpace(boxes=(((-3.0, -2.0, 0.0), (3.0, 2.5, 30.0)),)), -2.0),
        (10.0, FlightSpace(boxes=(((-3.0, -0.4, 0.0), (3.0, 2.5, 30.0)),)), -0.4),
        (10.0, FlightSpace(boxes=(((3.0, 4.0, 0.0), (9.0, 9.0, 30.0)),)), 5.0),
    ],
)
def test_a_breach_says_how_far_it_is_from_its_wall(up_m: float, space: FlightSpace, distance_m: float) -> None:
    (found,) = breaches([hover((0.0, 0.0, up_m), 1.0)], [1000.0], space)
    assert found.distance_m == pytest.approx(distance_m)
    problem = SpaceProblem("a", found.what, found.distance_m, 0.0, found.place_m, found.t_s)
    beyond = "beyond" if distance_m < 0.0 else "from"
    assert problem.text().startswith(f"a is {abs(distance_m):.2f} m {beyond} {found.what} at 0.00 s")


def test_what_is_not_decided_when_halving_ends_counts_as_too_near(monkeypatch: pytest.MonkeyPatch) -> None:
    curve = Trajectory([Piece(1.0, (0.0, 4.0, 3.0, -5.0), (0.0,), (10.0, 10.0, -5.0, -5.0))])
    space = FlightSpace(ceiling_m=15.5)
    assert breaches([curve], [0.9], space) == breaches([], [], space) == []
    monkeypatch.setattr(space_check, "MAX_PARTS", 1)
    (found,) = breaches([curve], [0.9], space)
    assert (found.vehicle, found.what, found.distance_m, found.t_s) == (0, "the ceiling", 5.5, 0.0)


def _distance_to(corners, point) -> float:
    """Written anew: winding number, and distance from each side."""
    x, y = point
    turns, nearest = 0, math.inf
    for (x1, y1), (x2, y2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        length2 = (x2 - x1) ** 2 + (y2 - y1) ** 2
        u = 0.0 if length2 == 0 else min(max(((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / length2, 0.0), 1.0)
        nearest = min(nearest, math.hypot(x - x1 - u * (x2 - x1), y - y1 - u * (y2 - y1)))
        side = (x2 - x1) * (y - y1) - (x - x1) * (y2 - y1)
        if (y1 <= y < y2 and side > 0) or (y2 <= y < y1 and side < 0):
            turns += 1
    return nearest if turns % 2 else -nearest
