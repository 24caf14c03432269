"""The control fence: where a vehicle may be, where it may be sent, and that the box stands on earth."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from skygcs.core.control.control_fence import Fence
from skygcs.core.geo import Origin, ecef, enu_from_geodetic, geodetic_from_enu
from skygcs.errors import ConfigError
from support.table import each

ORIGIN = Origin(43.78, -79.46, 170.0)
FENCE = Fence(ORIGIN)


def at(x_m: float, y_m: float, up_m: float, origin: Origin = ORIGIN) -> tuple[float, float, float]:
    return geodetic_from_enu(x_m, y_m, up_m, origin)


@each(
    ("vehicle", "reference", "points"),
    [
        (True, True, [(0.0, 0.0, 5.0), (47.9, -47.9, 17.9), (0.0, 0.0, 0.1)]),
        (True, False, [(49.9, 0.0, 5.0), (0.0, -49.9, 5.0), (0.0, 0.0, 19.9), (0.0, 0.0, -1.9)]),
        (False, False, [(50.1, 0.0, 5.0), (-50.1, 0.0, 5.0), (0.0, 50.1, 5.0), (0.0, 0.0, 20.1), (0.0, 0.0, -2.1)]),
    ],
)
def test_keeps_vehicles_in_the_box_and_references_a_margin_inside_with_a_soft_floor(
    vehicle: bool, reference: bool, points: list[tuple[float, float, float]]
) -> None:
    for point in points:
        assert FENCE.contains(*at(*point)) is vehicle, point
        assert FENCE.contains(*at(*point), reference=True) is reference, point


def test_says_where_it_is_and_what_the_limit_is() -> None:
    assert FENCE.why_not(*at(51.24, 0, 5)) == "the vehicle is at x 51.2 m (limit -50..50 m, the fence)"
    assert FENCE.why_not(*at(0, -49, 5), reference=True) == (
        "the target position is at y -49.0 m (limit -48..48 m, the fence less 2 m of margin)"
    )
    assert FENCE.why_not(*at(0, 0, 5)) is None


def test_looks_only_at_the_axes_that_have_a_place_and_calls_it_what_it_is_told() -> None:
    fence = Fence(ORIGIN, up_m=(5.0, 20.0))
    assert fence.why_not(*at(0.0, 0.0, 0.0), reference=True, free_z=True) is None
    assert "up 0.0 m" in str(fence.why_not(*at(900.0, 0.0, 0.0), reference=True, free_xy=True))
    assert fence.why_not(*at(900.0, -900.0, 10.0), reference=True, free_xy=True) is None
    assert fence.why_not(*at(900.0, 0.0, 90.0), free_xy=True, free_z=True) is None
    assert str(fence.why_not(*at(60.0, 0.0, 10.0), what="its shadow", free_z=True)).startswith(
        "its shadow is at x 60.0 m"
    )
    assert fence.why_not(math.nan, 0.0, 0.0, free_xy=True, free_z=True) is not None


def test_stands_along_the_axes_of_its_origin() -> None:
    north_up = Origin(43.78, -79.46, 170.0, x_heading_deg=0.0)
    corridor = Fence(north_up, x_m=(0.0, 40.0), y_m=(-5.0, 5.0))
    assert corridor.contains(*at(0.0, 30.0, 5.0))  # true north
    assert not corridor.contains(*at(30.0, 0.0, 5.0))


@given(st.floats(-60, 60), st.floats(-60, 60), st.floats(-4, 24), st.floats(0, 359))
@example(0.0, 0.0, 0.0, 90.0)
def test_agrees_with_the_frame_of_its_origin_everywhere(x: float, y: float, up: float, heading: float) -> None:
    origin = Origin(-33.9, 151.2, 40.0, x_heading_deg=heading)
    fence, place = Fence(origin), geodetic_from_enu(x, y, up, origin)
    seen = enu_from_geodetic(*place, origin)
    nearest = min(abs(abs(seen[0]) - 50), abs(abs(seen[1]) - 50), abs(seen[2] - 20), abs(seen[2] + 2))
    inside = abs(seen[0]) <= 50 and abs(seen[1]) <= 50 and -2 <= seen[2] <= 20
    if nearest > 1e-3:
        assert fence.contains(*place) is inside
    assert fence.holds(ecef(*place)) is fence.contains(*place)


@given(st.tuples(st.floats(), st.floats(), st.floats()))
@example((43.78, -79.46, math.nan))
@example((43.78, math.inf, 170.0))
@example((90.1, -79.46, 170.0))
def test_no_number_whatsoever_raises_or_is_inside_by_mistake(place: tuple[float, float, float]) -> None:
    for reference in (False, True):
        reason = FENCE.why_not(*place, reference=reference)
        assert FENCE.contains(*place, reference=reference) is (reason is None)
        if not all(map(math.isfinite, place)):
            assert reason is not None and "not a position on earth" in reason


def test_where_a_reference_may_be_a_vehicle_may_be() -> None:
    for n in range(-120, 121):
        place = at(n * 0.5, 0.0, 1.0)
        assert FENCE.contains(*place) or not FENCE.contains(*place, reference=True)


def test_refuses_a_box_with_nothing_in_it_and_tells_every_problem() -> None:
    with pytest.raises(ConfigError) as error:
        Fence(ORIGIN, x_m=(5.0, 5.0), up_m=(0.0, math.nan), margin_m=-1.0)
    assert [p.split(":")[0] for p in error.value.problems] == ["x_m", "up_m", "margin_m"]
    with pytest.raises(ConfigError):
        Fence(ORIGIN, x_m=(-2.0, 2.0), margin_m=2.0)
    with pytest.raises(ConfigError):
        Fence(ORIGIN, margin_m=math.nan)
