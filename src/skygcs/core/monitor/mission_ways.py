"""The space of a mission on board, to compare it with those of vehicles that fly at the same time. Pure.

    item                        leg
    -------------------------   ---------------------------------------------------------------------------------------
    NAV_TAKEOFF                 straight up where the vehicle is, then level to its place if it has one
    an item with a place        from the place before to it; a loiter is as wide as its radius
    NAV_RETURN_TO_LAUNCH        level to home, and down
    NAV_LAND                    level to its place if it has one, and down
    DO_JUMP, DO_JUMP_TAG        from anywhere the whole mission, as it may lead back before the first item that is flown

Heights above terrain are taken as above home.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from skygcs.core.geo import EnuFrame
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.check import FLOWN_PLACE, TAKEOFFS
from skygcs.core.mission.item import GLOBAL, MissionItem
from skygcs.core.monitor.approach import Vector
from skygcs.core.monitor.tracks import Place
from skygcs.core.monitor.ways import Leg, Way, along, column
from skygcs.core.separation import Footprint

JUMPS = frozenset({mav_cmd.DO_JUMP, mav_cmd.DO_JUMP_TAG})

LANDINGS = frozenset({mav_cmd.NAV_LAND, mav_cmd.NAV_VTOL_LAND})

RADIUS_PARAM = {mav_cmd.NAV_LOITER_UNLIM: 2, mav_cmd.NAV_LOITER_TURNS: 2, mav_cmd.NAV_LOITER_TIME: 2}
"""Index of the parameter with the radius of a circle in m."""


class MissionRun(NamedTuple):
    """A mission that is flown from an item on, counted from 1."""

    items: Sequence[MissionItem]
    first: int = 1


def mission_way(
    key: int,
    name: str,
    footprint: Footprint,
    run: MissionRun,
    here: Place,
    home: Place,
    frame: EnuFrame,
    circle_m: float = 0.0,
) -> Way:
    """The way of a vehicle from where it is along a mission. Places are geodetic; the way is in ``frame``.
    ``circle_m``: radius of the circle of what cannot stop, which rounds each corner and ends with it; 0: it stops."""
    rest = run.items[run.first - 1 :]
    legs, widest_m = _legs(rest, here, home, frame)
    if run.first > 1 and any(item.command in JUMPS for item in rest):
        every, widest_m = _legs(run.items, here, home, frame)
        legs += every
    return Way(key, name, footprint, tuple(legs), max(widest_m, circle_m), "on its mission")


def _legs(items: Sequence[MissionItem], here: Place, home: Place, frame: EnuFrame) -> tuple[list[Leg], float]:
    """The legs along these items, and how wide its circles are."""
    at, base = frame.from_geodetic(*here), frame.from_geodetic(*home)
    legs: list[Leg] = list(along([at]))
    widest_m = 0.0
    for item in items:
        if item.command == mav_cmd.NAV_RETURN_TO_LAUNCH:
            at = _level(legs, at, base)
            legs.append(column(at, base[2]))
            continue
        if item.command not in FLOWN_PLACE:
            continue
        alt_amsl_m = (item.z or 0.0) + (0.0 if item.frame == GLOBAL else home[2])
        up_m = frame.from_geodetic(home[0], home[1], alt_amsl_m)[2]
        there = at if item.position is None else frame.from_geodetic(*item.position, alt_amsl_m)
        if item.command in LANDINGS:
            at = _level(legs, at, there)
            legs.append(column(at, min(base[2], at[2])))
            continue
        if item.command in TAKEOFFS:
            legs.append(column(at, up_m))
            at = (at[0], at[1], max(at[2], up_m))
        legs += along([at, (there[0], there[1], up_m)])
        at = (there[0], there[1], up_m)
        radius_m = item.params[RADIUS_PARAM.get(item.command, 0)] if item.command in RADIUS_PARAM else 0.0
        widest_m = max(widest_m, abs(radius_m or 0.0))
    return legs, widest_m


def _level(legs: list[Leg], at: Vector, to: Vector) -> Vector:
    """Add the leg to above a place, at the height it is at."""
    end = (to[0], to[1], at[2])
    legs += along([at, end])
    return end
