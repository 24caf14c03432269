"""What crosses between ground and companion comes out as it went in, and what does not fit is refused."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.vehicle.geodetic_position import GeodeticPosition, Setpoint
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
    "place",
    "vel_enu_mps",
    "acc_enu_mps2",
    "yaw_enu_rad",
    "free_xy",
    "kind",
    "thrust",
    "attitude_ned_frd",
    "lat_deg",
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


def test_an_origin_comes_out_as_it_went_in() -> None:
    origin = Origin(43.7, -79.4, 180.0, 30.0)
    assert wire.origin_from(json.loads(json.dumps(wire.origin_json(origin)))) == origin
    assert wire.origin_from(None) is None


@given(st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=6), ANYTHING, max_size=8))
def test_whatever_comes_is_refused_or_finite(values: dict[str, object]) -> None:
    for read in (wire.setpoint_from, wire.raw_from, wire.origin_from):
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
