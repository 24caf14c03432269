"""What crosses between ground and companion comes out as it went in, and what does not fit is refused."""

from __future__ import annotations

import contextlib
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.trajectory_clock import ClockOrder
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.raw_setpoint import RawSetpoint
from skygcs.errors import RefusedError
from skygcs.ext.companions import wire
from support.table import each

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=5),
    max_leaves=12,
)
KEYS = (
    *("place", "vel_enu_mps", "acc_enu_mps2", "yaw_enu_rad", "free_xy", "kind"),
    *("number", "order", "at_s", "thrust", "attitude_ned_frd", "lat_deg"),
)


@each(
    "setpoint",
    [
        Setpoint(GeodeticPosition(43.7, -79.4, 190.0)),
        Setpoint(GeodeticPosition(43.7, -79.4, 190.0), (1.0, -2.0, 0.5), (0.1, 0.0, 0.0), 1.5, False, True, 0.2),
        Setpoint(None, (1.0, 0.0, 0.0), free_xy=True, free_z=True),
    ],
)
def test_a_setpoint_comes_out_as_it_went_in(setpoint: Setpoint) -> None:
    assert wire.setpoint_from(json.loads(json.dumps(wire.setpoint_json(setpoint)))) == setpoint


@each(
    "setpoint",
    [
        RawSetpoint("attitude", 0.5, (1.0, 0.0, 0.0, 0.0)),
        RawSetpoint("rates", 0.5, rates_frd_radps=(0.1, 0.2, 0.3)),
        RawSetpoint("acceleration", acc_enu_mps2=(1.0, 0.0, 0.0), yaw_enu_rad=0.3),
    ],
)
def test_a_raw_setpoint_comes_out_as_it_went_in(setpoint: RawSetpoint) -> None:
    assert wire.raw_from(json.loads(json.dumps(wire.setpoint_json(setpoint)))) == setpoint


@each("yaw", [None, (0.1, 0.2)])
def test_a_trajectory_comes_out_in_its_parts(yaw: tuple[float, ...] | None) -> None:
    count = wire.PIECES_A_PART + 3
    whole = Trajectory([Piece(1.0, (float(k), 1.0), (0.0,), (5.0,), yaw) for k in range(count)])
    parts = json.loads(json.dumps(wire.pieces_json(whole)))
    assert [len(part) for part in parts] == [wire.PIECES_A_PART, 3]
    assert Trajectory([wire.piece_from(piece) for part in parts for piece in part]) == whole


A_PIECE = {"duration_s": 1.0, "x": [0.0], "y": [0.0], "up": [5.0]}


def test_parts_come_in_any_order_and_twice() -> None:
    parts = wire.TrajectoryParts(2_000)
    assert parts.take("a", 1, 2, [A_PIECE]) is None
    assert parts.take("a", 1, 2, [A_PIECE, A_PIECE]) is None
    assert parts.take("b", 0, 2, [A_PIECE]) is None
    assert len(parts.take("a", 0, 2, [A_PIECE]) or []) == 3
    assert parts.take("a", 0, 2, [A_PIECE]) is None  # what was complete is forgotten


def test_another_number_of_parts_begins_the_trajectory_anew() -> None:
    parts = wire.TrajectoryParts(2_000)
    assert parts.take("a", 5, 6, [A_PIECE]) is None
    assert parts.take("a", 0, 2, [A_PIECE]) is None
    assert len(parts.take("a", 1, 2, [A_PIECE]) or []) == 2


def test_incomplete_trajectories_are_bounded() -> None:
    parts = wire.TrajectoryParts(2_000)
    for number in range(wire.MAX_INCOMPLETE + 1):
        assert parts.take(str(number), 0, 2, [A_PIECE]) is None
    assert parts.take("0", 1, 2, [A_PIECE]) is None  # the oldest went
    assert parts.take(str(wire.MAX_INCOMPLETE), 1, 2, [A_PIECE]) is not None


@given(ANYTHING, ANYTHING, ANYTHING)
def test_whatever_comes_as_a_part_is_refused_or_incomplete(part: object, count: object, pieces: object) -> None:
    parts = wire.TrajectoryParts(2_000)
    for given_part, given_count in ((part, count), (0, 2)):
        with contextlib.suppress(RefusedError):
            parts.take("a", given_part, given_count, pieces)


@each(
    "piece",
    [
        {**A_PIECE, "duration_s": "1"},
        {**A_PIECE, "x": [10**400]},
        {**A_PIECE, "up": [True]},
        {**A_PIECE, "y": []},
        {**A_PIECE, "yaw": [math.nan]},
        {key: value for key, value in A_PIECE.items() if key != "up"},
        [1.0],
    ],
)
def test_a_piece_that_is_none_is_refused(piece: object) -> None:
    with pytest.raises(RefusedError):
        wire.TrajectoryParts(2_000).take("a", 0, 1, [piece])


@each("order", [ClockOrder("pause", 2e6), ClockOrder("speed", 3.5, 0.5)])
def test_an_order_to_a_clock_comes_out_as_it_went_in(order: ClockOrder) -> None:
    sent = json.loads(json.dumps({"number": 7, "at_s": order.at_s, **wire.clock_order_json(order)}))
    assert wire.clock_order_from(sent) == (7, order)
    wrong: tuple[dict[str, object], ...] = ({"number": True}, {"at_s": None}, {"order": ["pause"]})
    for changes in (*wrong, {"speed_factor": 2.0 if order.speed_factor is None else None}):
        with pytest.raises(RefusedError):
            wire.clock_order_from({**sent, **changes})


def test_an_origin_comes_out_as_it_went_in() -> None:
    origin = Origin(43.7, -79.4, 180.0, 30.0)
    assert wire.origin_from(json.loads(json.dumps(wire.origin_json(origin)))) == origin
    assert wire.origin_from(None) is None


@given(st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=6), ANYTHING, max_size=8))
def test_whatever_comes_is_refused_or_finite(values: dict[str, object]) -> None:
    for read in (wire.setpoint_from, wire.raw_from, wire.origin_from, wire.clock_order_from):
        try:
            found = read(values)
        except RefusedError:
            continue
        for number in _numbers(found):
            assert math.isfinite(number)


@each("value", [10**400, -(10**400), float("nan"), True, "1", None])
def test_a_number_that_is_none_is_refused(value: object) -> None:
    with pytest.raises(RefusedError):
        wire.setpoint_from({"vel_enu_mps": [value, 0.0, 0.0]})
    with pytest.raises(RefusedError):
        wire.origin_from({"lat_deg": value, "lon_deg": 1.0, "alt_amsl_m": 1.0, "x_heading_deg": 90.0})


def _numbers(value: object) -> list[float]:
    if isinstance(value, float):
        return [value]
    if isinstance(value, tuple):
        return [number for item in value for number in _numbers(item)]
    fields = getattr(type(value), "__dataclass_fields__", {})
    return [number for name in fields for number in _numbers(getattr(value, name))]
