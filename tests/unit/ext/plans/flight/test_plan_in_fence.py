"""A plan, with its vehicle's tube, against the autopilot's own fence."""

from __future__ import annotations

import math

from skygcs.core.mission.fence import FenceCircle, FencePlan, FencePolygon
from skygcs.core.vehicle.fence_params import FenceSettings
from skygcs.ext.plans.flight.flight_findings import Level
from skygcs.ext.plans.flight.plan_in_fence import Reach, fence_finding
from support.table import each
from support.vehicles import HOME

LISTED = FenceSettings(enabled=True, action="return", radius_m=None, height_m=None, follows_list=True)


def at(east_m: float, north_m: float) -> tuple[float, float]:
    return HOME[0] + north_m / 111_195.0, HOME[1] + east_m / (111_195.0 * math.cos(math.radians(HOME[0])))


def reach(tube_m: float, *way: tuple[float, float]) -> Reach:
    return Reach(((*HOME[:2], HOME[2]),), tuple((*at(*place), HOME[2] + 10.0) for place in way), tube_m)


def square(half_m: float, *, inclusion: bool) -> FencePolygon:
    return FencePolygon(inclusion, (at(-half_m, -half_m), at(half_m, -half_m), at(half_m, half_m), at(-half_m, half_m)))


@each(
    ("shapes", "way", "tube_m", "said"),
    [
        (FencePlan((square(30, inclusion=True),)), ((0, 0), (28, 0)), 1.5, ""),
        (
            FencePlan((square(30, inclusion=True),)),
            ((0, 0), (29, 0)),
            1.5,
            "near the border of the inclusion polygon 1",
        ),
        (FencePlan((square(30, inclusion=True),)), ((0, 0), (31, 0)), 1.5, "outside the inclusion polygon 1"),
        (FencePlan((square(5, inclusion=False),)), ((-20, 6), (20, 6)), 0.5, ""),
        (
            FencePlan((square(5, inclusion=False),)),
            ((-20, 6), (20, 6)),
            1.5,
            "near the border of the exclusion polygon 1",
        ),
        (FencePlan((square(0.1, inclusion=False),)), ((-20, 0), (20, 0)), 0.0, "exclusion polygon 1"),  # between places
        (FencePlan((), (FenceCircle(True, at(0, 0), 30.0),)), ((0, 0), (0, 29)), 1.5, "the inclusion circle 1"),
        (FencePlan(), ((0, 0), (500, 0)), 1.5, ""),
    ],
)
def test_the_tube_has_to_be_inside_of_polygons_and_circles_too(
    shapes: FencePlan, way: tuple[tuple[float, float], ...], tube_m: float, said: str
) -> None:
    """Its places alone were compared with them."""
    finding = fence_finding("alpha", LISTED, shapes, reach(tube_m, *way))
    assert (finding.level is Level.OK) is (said == ""), finding
    assert said in finding.text, finding
