"""Plans that must be refused, each with its pair, and the same with a little more room, which are certified."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from skygcs.core.plan.fleet_plan import FlightSpace, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.trajectory import MotionLimits, Piece, Trajectory
from skygcs.core.trajectory.timing import TimedPoint, hover, straight_lines
from skygcs.ext.plans.certificates.certificate import Certificate
from skygcs.ext.plans.certificates.certify import certify
from skygcs.ext.plans.certificates.plan_search import Kind, Task, make_plan

RULE = MarginRule(fixed_m=2.5)
LIMITS = MotionLimits()
Place = tuple[float, float, float]


class Case(NamedTuple):
    """``judged()`` is the certificate and the reasons; ``names`` occur in them, or the plan is certified."""

    what: str
    judged: Callable[[], tuple[bool, list[str]]]
    names: tuple[str, ...]
    """Empty: it is certified."""


def line(begin: Place, end: Place, seconds: float) -> Trajectory:
    return straight_lines([TimedPoint(0.0, begin), TimedPoint(seconds, end)])


def timed(space: FlightSpace | None = None, **fleet: Trajectory) -> Callable[[], tuple[bool, list[str]]]:
    def judged() -> tuple[bool, list[str]]:
        certificate: Certificate = certify(TimedPlan(fleet), RULE, space)
        return certificate.certified, certificate.reasons()

    return judged


def searched(
    starts: list[Place], goals: list[Place], kind: Kind = "auto", space: FlightSpace | None = None
) -> Callable[[], tuple[bool, list[str]]]:
    def judged() -> tuple[bool, list[str]]:
        names = [f"v{i}" for i in range(len(starts))]
        found = make_plan(
            Task(dict(zip(names, starts, strict=True)), dict(zip(names, goals, strict=True)), kind=kind),
            RULE,
            LIMITS,
            space,
        )
        return found.plan is not None, found.reasons()

    return judged


def passing(offset_m: float, at_s: float = 5.1, speed_mps: float = 4.0) -> dict[str, Trajectory]:
    """Two that pass each other ``offset_m`` apart at ``at_s``."""
    reach = speed_mps * at_s
    end = 2 * at_s
    return {
        "alpha": line((-reach, 0.0, 10.0), (reach, 0.0, 10.0), end),
        "bravo": line((reach, offset_m, 10.0), (-reach, offset_m, 10.0), end),
    }


PEAK = 3.0 / 7.0
"""Where u³ (1 - u)⁴ is largest."""


def bulging(height_m: float) -> Trajectory:
    """From (0, 0) to (10, 0) in 4 s by a polynomial of degree 7 that swings ``height_m`` to the side in between."""
    t = 4.0
    scale = height_m / (PEAK**3 * (1.0 - PEAK) ** 4)
    north = [0.0] * 8
    for k, c in ((3, 1.0), (4, -4.0), (5, 6.0), (6, -4.0), (7, 1.0)):
        north[k] = scale * c / t**k
    return Trajectory([Piece(t, (0.0, 10.0 / t), tuple(north), (10.0,))])


def circle(count: int, radius_m: float) -> list[Place]:
    turns = [math.tau * i / count for i in range(count)]
    return [(radius_m * math.cos(a), radius_m * math.sin(a), 10.0) for a in turns]


def grid(count: int, spacing_m: float = 5.0) -> list[Place]:
    width = math.ceil(math.sqrt(count))
    return [(spacing_m * (i % width), spacing_m * (i // width), 10.0) for i in range(count)]


def follow(shift_s: float) -> dict[str, Trajectory]:
    """The same curve, ``shift_s`` apart."""
    curve = ((0.0, 4.0), (0.0, 0.5, -0.03), (10.0,))

    def shifted(c: tuple[float, ...], by: float) -> tuple[float, ...]:
        n = len(c)
        return tuple(sum(math.comb(k, j) * c[k] * by ** (k - j) for k in range(j, n)) for j in range(n))

    later = [shifted(c, -shift_s) for c in curve]
    return {"alpha": Trajectory([Piece(10.0, *curve)]), "bravo": Trajectory([Piece(10.0, *later)])}


NOTCHED = ((-5.0, -20.0), (45.0, -20.0), (45.0, 20.0), (25.0, 20.0), (20.0, -5.0), (15.0, 20.0), (-5.0, 20.0))
"""A square with a wedge cut into it from the north, down to (20, -5)."""

AHEAD = line((0.0, 0.0, 10.0), (40.0, 0.0, 10.0), 10.0)
AROUND = straight_lines(
    [
        TimedPoint(0.0, (0.0, 0.0, 10.0)),
        TimedPoint(5.0, (15.0, -12.0, 10.0)),
        TimedPoint(8.0, (25.0, -12.0, 10.0)),
        TimedPoint(13.0, (40.0, 0.0, 10.0)),
    ]
)


def cases() -> Iterator[Case]:
    """Refused ones and their certified neighbours."""
    yield Case("near miss between samples at 5 Hz", timed(**passing(2.427)), ("alpha", "bravo", "at 5.10 s"))
    yield Case("1 mm inside the margin", timed(**passing(2.499)), ("alpha", "bravo"))
    yield Case("1 mm outside the margin", timed(**passing(2.501)), ())
    yield Case("identical paths, shifted by .5 s", timed(**follow(0.5)), ("alpha", "bravo"))
    yield Case("identical paths, shifted by .7 s", timed(**follow(0.7)), ())
    parked = FlightSpace(standing={"parked": (20.0, 1.0, 10.0)})
    yield Case("a parked vehicle on the path", timed(parked, alpha=AHEAD), ("alpha", "parked", "at 5.00 s"))
    aside = FlightSpace(standing={"parked": (20.0, 2.6, 10.0)})
    yield Case("a parked vehicle beside the path", timed(aside, alpha=AHEAD), ())
    for count in (2, 3, 50):
        places = grid(count)
        yield Case(
            f"a cycle of {count}, straight at one height", searched(places, places[1:] + places[:1], "timed"), ("v",)
        )
    yield Case(
        "a vertical stack inside the downwash",
        timed(alpha=hover((0.0, 0.0, 10.0), 5.0), bravo=hover((0.0, 0.0, 14.9), 5.0)),
        ("alpha", "bravo"),
    )
    yield Case(
        "a vertical stack outside the downwash",
        timed(alpha=hover((0.0, 0.0, 10.0), 5.0), bravo=hover((0.0, 0.0, 15.1), 5.0)),
        (),
    )
    fence = FlightSpace(fence=NOTCHED)
    yield Case("a concave fence", timed(fence, alpha=AHEAD), ("alpha", "the fence"))
    yield Case("around the notch of a concave fence", timed(fence, alpha=AROUND), ())
    two = [(0.0, 0.0, 10.0), (20.0, 0.0, 10.0)]
    for ceiling, names in ((16.2, ("v0", "layers")), (16.3, ())):
        space = FlightSpace(ceiling_m=ceiling)
        yield Case(f"a swap below {ceiling:g} m", searched(two, two[::-1], space=space), names)
    yield Case(
        "a degree-7 piece that bulges",
        timed(alpha=bulging(6.0), bravo=hover((10.0 * PEAK, 8.0, 10.0), 4.0)),
        ("alpha", "bravo", "at 1.71 s"),
    )
    yield Case(
        "a degree-7 piece that bulges less", timed(alpha=bulging(5.4), bravo=hover((10.0 * PEAK, 8.0, 10.0), 4.0)), ()
    )
    ring = circle(50, 45.0)
    yield Case("50 antipodal on a circle", searched(ring, ring[25:] + ring[:25], "timed"), ("v",))
    middle = FlightSpace(standing={"bystander": (10.0, 0.5, 10.0)})
    yield Case("a non-participant in mid-field", searched([two[0]], [two[1]], "timed", middle), ("v0", "bystander"))
    yield Case("above a non-participant in mid-field", searched([two[0]], [two[1]], "auto", middle), ())
