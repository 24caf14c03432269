"""Where a body may be that the cameras have lost: the rows of the table."""

from __future__ import annotations

from skygcs.ext.mocap.lost_body import MOST_M, LostBody
from skygcs.ext.mocap.pose import Pose, Vector, about_up
from support.table import each

DT = 0.01
MARGIN_M = 0.3


def pose(at: float, *pos_m: float) -> Pose:
    x, y, z = pos_m
    return Pose(at, (x, y, z), about_up(0.0))


def flown(velocity: Vector = (0.0, 0.0, 0.0), own: bool = False) -> LostBody:
    """Seen for a second until t = 1, when it was at the origin. ``own``: its vehicle's estimate is 7 m beside."""
    body = LostBody()
    for n in range(101):
        t = n * DT
        here = (velocity[0] * (t - 1), velocity[1] * (t - 1), velocity[2] * (t - 1))
        body.seen(pose(t, *here), ((here[0] + 7.0, here[1], here[2]), t) if own else None)
    return body


@each(
    ("velocity", "after_s", "at_m", "is_it"),
    [
        # at rest: what it can have reached by a manoeuvre
        ((0.0, 0.0, 0.0), 0.3, (0.2, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), 0.3, (2.4, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), 3.0, (3.2, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), 3.0, (6.2, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), 60.0, (MOST_M + 0.4, 0.0, 0.0), False),
        # on its way: as far as it would have come, or less if it was stopped; not as far the other way
        ((2.0, 0.0, 0.0), 0.5, (1.0, 0.0, 0.0), True),
        ((2.0, 0.0, 0.0), 0.5, (0.1, 0.0, 0.0), True),
        ((2.0, 0.0, 0.0), 0.5, (-1.0, 0.0, 0.0), False),
        ((2.0, 0.0, 0.0), 0.5, (0.5, 1.0, 0.0), False),
    ],
)
def test_it_is_expected_on_its_way(velocity: Vector, after_s: float, at_m: Vector, is_it: bool) -> None:
    assert flown(velocity).may_be(pose(1.0 + after_s, *at_m), None, (), MARGIN_M) is is_it


@each(("at_m", "is_it"), [((5.0, 0.5, 0.0), True), ((0.0, 0.0, 0.0), False)])
def test_the_estimate_of_its_vehicle_counts_more(at_m: Vector, is_it: bool) -> None:
    """In 3 s without poses it flew on by 5 m, and says so in a frame that lies beside."""
    body, now = flown(own=True), ((12.0, 0.0, 0.0), 3.9)
    assert body.may_be(pose(4.0, *at_m), now, (), MARGIN_M) is is_it
    stale = ((12.0, 0.0, 0.0), 1.5)
    assert not body.may_be(pose(4.0, 5.0, 0.0, 0.0), stale, (), MARGIN_M), "old: its own velocity counts"


def test_a_place_nearer_to_another_body_is_that_one() -> None:
    body = flown()
    found = pose(1.5, 0.5, 0.0, 0.0)
    assert body.may_be(found, None, [(1.6, 0.0, 0.0)], MARGIN_M)
    assert not body.may_be(found, None, [(0.6, 0.0, 0.0)], MARGIN_M)


def test_a_body_that_was_never_seen_may_be_anywhere() -> None:
    assert LostBody().may_be(pose(1.0, 50.0, 0.0, 0.0), None, [(50.0, 0.0, 0.0)], MARGIN_M)
