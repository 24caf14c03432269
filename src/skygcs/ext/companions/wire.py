"""Messages of ground and companion about control, as JSON and back: setpoints, pieces of trajectories, origins.

Values are geodetic or true ENU wherever they can be, so that they mean the same in both daemons whatever the origin of
each is; a trajectory carries the origin of the ground whose axes it is given along. Pure. What does not fit raises
RefusedError or TrajectoryError.
"""

from __future__ import annotations

import sys
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, get_args

from skygcs.core.geo import Origin
from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DEGREE
from skygcs.core.trajectory.trajectory_clock import ClockOrder, ClockOrderKind
from skygcs.core.vehicle.frames import GeodeticPosition, Setpoint
from skygcs.core.vehicle.raw_setpoint import RawSetpoint
from skygcs.errors import RefusedError

Json = dict[str, Any]

LARGEST_NUMBER = 1e6
"""Largest number accepted in a setpoint."""

LARGEST_SECONDS = 1e12
"""Largest number accepted in a relayed order: seconds of a clock."""

PIECES_A_PART = 200
"""Pieces sent in one call: 250 kB for the largest degree, a quarter of the longest line of the socket."""

MAX_INCOMPLETE = 4
"""Trajectories of which parts are kept: the ground sends them one after another."""


def setpoint_json(setpoint: Setpoint | RawSetpoint) -> Json:
    """The JSON that `setpoint_from` reads."""
    return {key: value for key, value in asdict(setpoint).items() if value is not None and value is not False}


def setpoint_from(values: Mapping[str, Any]) -> Setpoint:
    """Raises RefusedError."""
    place = values.get("place")
    return Setpoint(
        None if place is None else _place(place),
        _vector(values, "vel_enu_mps"),
        _vector(values, "acc_enu_mps2"),
        _number(values, "yaw_enu_rad"),
        values.get("free_xy") is True,
        values.get("free_z") is True,
        _number(values, "yaw_rate_enu_radps"),
    )


def raw_from(values: Mapping[str, Any]) -> RawSetpoint:
    """Raises RefusedError. The limits are checked where it is followed."""
    kind = values.get("kind")
    if kind not in ("attitude", "rates", "acceleration"):
        raise RefusedError("a raw setpoint is attitude, rates or acceleration")
    attitude = values.get("attitude_ned_frd")
    quaternion = None if attitude is None else _numbers(attitude, 4, "attitude_ned_frd")
    setpoint = RawSetpoint(
        kind,
        _number(values, "thrust"),
        None if quaternion is None else (quaternion[0], quaternion[1], quaternion[2], quaternion[3]),
        _vector(values, "rates_frd_radps"),
        _vector(values, "acc_enu_mps2"),
        _number(values, "yaw_enu_rad"),
    )
    needed = {
        "attitude": (setpoint.thrust, setpoint.attitude_ned_frd),
        "rates": (setpoint.thrust, setpoint.rates_frd_radps),
        "acceleration": (setpoint.acc_enu_mps2,),
    }[kind]
    if None in needed:
        raise RefusedError(f"a raw setpoint of kind {kind} lacks a value")
    return setpoint


def pieces_json(trajectory: Trajectory) -> list[list[Json]]:
    """All its pieces, in parts of `PIECES_A_PART`."""
    pieces = [
        {
            "duration_s": piece.duration_s,
            "x": list(piece.east),
            "y": list(piece.north),
            "up": list(piece.up),
            **({} if piece.yaw is None else {"yaw": list(piece.yaw)}),
        }
        for piece in trajectory.pieces
    ]
    return [pieces[at : at + PIECES_A_PART] for at in range(0, len(pieces), PIECES_A_PART)]


def piece_from(values: Any) -> Piece:
    """A piece of finite numbers; the trajectory it is put into checks what they make. Raises RefusedError."""
    if not isinstance(values, dict):
        raise RefusedError("a piece has duration_s, x, y and up")
    duration_s = required(values, "duration_s", LARGEST_NUMBER)
    east, north, up = (_coefficients(values.get(axis), axis) for axis in ("x", "y", "up"))
    yaw = values.get("yaw")
    return Piece(duration_s, east, north, up, None if yaw is None else _coefficients(yaw, "yaw"))


def _coefficients(values: Any, name: str) -> tuple[float, ...]:
    if not isinstance(values, list) or not 1 <= len(values) <= MAX_DEGREE + 1:
        raise RefusedError(f"{name} of a piece has 1 to {MAX_DEGREE + 1} coefficients")
    return tuple(_numbers(values, len(values), name, sys.float_info.max))  # large ones are usual in short pieces


class TrajectoryParts:
    """Trajectories of which parts have come, the newest `MAX_INCOMPLETE` of them; ``max_pieces``: of each."""

    def __init__(self, max_pieces: int) -> None:
        self._max_parts = max_pieces // PIECES_A_PART + 1
        self._incomplete: OrderedDict[str, list[Sequence[Piece] | None]] = OrderedDict()

    def take(self, key: str, part: Any, parts: Any, pieces: Any) -> list[Piece] | None:
        """Take ``part`` (from 0) of ``parts``, as `pieces_json` makes them; returns all pieces of ``key`` once the last
        of its parts has come. A part of another number of parts begins the trajectory anew. Raises RefusedError."""
        if not (type(part) is int and type(parts) is int and 0 <= part < parts <= self._max_parts):
            raise RefusedError(f"a trajectory has 1 to {self._max_parts} parts")
        if not isinstance(pieces, list) or len(pieces) > PIECES_A_PART:
            raise RefusedError(f"a part has up to {PIECES_A_PART} pieces")
        taken = [piece_from(piece) for piece in pieces]
        kept = self._incomplete.setdefault(key, [None] * parts)
        if len(kept) != parts:
            self._incomplete[key] = kept = [None] * parts
        kept[part] = taken
        while len(self._incomplete) > MAX_INCOMPLETE:
            self._incomplete.popitem(last=False)
        come = [one for one in kept if one is not None]
        if len(come) < parts:
            return None
        self._incomplete.pop(key, None)
        return [piece for one in come for piece in one]


def clock_order_json(order: ClockOrder) -> Json:
    """Without its time, which differs on each clock; `clock_order_from` reads it with ``at_s``."""
    return {"order": order.kind} | ({} if order.speed_factor is None else {"speed_factor": order.speed_factor})


def clock_order_from(values: object) -> tuple[int, ClockOrder]:
    """The order and its number. Raises RefusedError."""
    if not isinstance(values, Mapping):
        raise RefusedError("a clock order needs number, order and at_s")
    kinds: tuple[ClockOrderKind, ...] = get_args(ClockOrderKind)
    kind = next((kind for kind in kinds if kind == values.get("order")), None)
    number, speed_factor = values.get("number"), _number(values, "speed_factor")
    at_s = _number(values, "at_s", LARGEST_SECONDS)
    if kind is None or type(number) is not int or at_s is None or (kind == "speed") != (speed_factor is not None):
        raise RefusedError(f"an order to a clock has number, at_s, order ({', '.join(kinds)}), speed_factor with speed")
    return number, ClockOrder(kind, at_s, speed_factor)


def origin_json(origin: Origin | None) -> Json | None:
    """The JSON that `origin_from` reads."""
    return None if origin is None else asdict(origin)


def origin_from(values: Mapping[str, Any] | None) -> Origin | None:
    """Raises RefusedError."""
    if values is None:
        return None
    numbers = [_number(values, key) for key in ("lat_deg", "lon_deg", "alt_amsl_m", "x_heading_deg")]
    lat_deg, lon_deg, alt_m, heading_deg = numbers
    if lat_deg is None or lon_deg is None or alt_m is None or heading_deg is None:
        raise RefusedError("an origin has lat_deg, lon_deg, alt_amsl_m and x_heading_deg")
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        raise RefusedError(f"an origin at {lat_deg:g}, {lon_deg:g} is not on earth")
    return Origin(lat_deg, lon_deg, alt_m, heading_deg)


def _place(values: object) -> GeodeticPosition:
    if not isinstance(values, Mapping):
        raise RefusedError("a place needs lat_deg, lon_deg and alt_amsl_m")
    found = [_number(values, key) for key in ("lat_deg", "lon_deg", "alt_amsl_m")]
    lat_deg, lon_deg, alt_m = found
    if lat_deg is None or lon_deg is None or alt_m is None or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        raise RefusedError("a place needs lat_deg, lon_deg and alt_amsl_m, within ±90 and ±180 degrees")
    return GeodeticPosition(lat_deg, lon_deg, alt_m)


def _number(values: Mapping[str, Any], key: str, largest: float = LARGEST_NUMBER) -> float | None:
    value = values.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= largest:  # or NaN
        raise RefusedError(f"{key} is not a number of at most {largest:g}")
    return float(value)


def required(values: Mapping[str, Any], key: str, largest: float = LARGEST_SECONDS) -> float:
    """A number that must be there. Raises RefusedError."""
    value = _number(values, key, largest)
    if value is None:
        raise RefusedError(f"{key} is missing")
    return value


def _vector(values: Mapping[str, Any], key: str) -> tuple[float, float, float] | None:
    given = values.get(key)
    if given is None:
        return None
    x, y, z = _numbers(given, 3, key)
    return x, y, z


def _numbers(given: object, count: int, key: str, largest: float = LARGEST_NUMBER) -> list[float]:
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != count:
        raise RefusedError(f"{key} has {count} numbers")
    found = []
    for value in given:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= largest:
            raise RefusedError(f"{key} has {count} numbers")
        found.append(float(value))
    return found
