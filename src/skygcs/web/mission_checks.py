"""Checks of missions and fences for the page: a dropped file, or what a person drew.

The answer has what the page draws, the findings of `core.mission.plan`, and the text to upload with missions.upload.
The vehicle's own check at the upload is the one that counts; this one is made before anything is sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field

from skygcs.config.dialects import load_dialect
from skygcs.config.models import FleetConfig
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mission.fence import FenceCircle, FencePlan, FencePolygon
from skygcs.core.mission.firmware_items import Family, ItemChange, for_firmware, grouped
from skygcs.core.mission.formats import Imported, read_plan
from skygcs.core.mission.item import GLOBAL, MISSION_FRAME, RELATIVE_ALT, TERRAIN_ALT, MissionItem, MissionType
from skygcs.core.mission.plan import (
    MAX_DISTANCE_M,
    MAX_HEIGHT_M,
    CheckLimits,
    Finding,
    MissionPlan,
    PlannedHome,
    check_plan,
    errors,
)
from skygcs.core.mission.qgc import write_qgc
from skygcs.core.separation import Footprint
from skygcs.core.vehicle.formation import (
    MAX_SPACING_M,
    MAX_STEP_M,
    SPACING_M,
    Arrangement,
    ArrangementKind,
    for_several,
)
from skygcs.errors import PlanFileError, RefusedError
from skygcs.web.dropped import CheckRequest, DroppedFile, Height, Metres, OriginKeys, Place, Point, WorldMap, parsed

MAX_SHOWN_ITEMS = 5000
"""Items in an answer. More are uploaded but neither listed nor drawn, and a note says so."""

MAX_SHOWN_FINDINGS = 200
MAX_DRAWN_POINTS = 1000

HEIGHT_ABOVE: dict[int, str] = {GLOBAL: "sea level", RELATIVE_ALT: "home", TERRAIN_ALT: "terrain"}


class DrawnMission(CheckRequest):
    """Waypoints from the canvas: x, y in the world frame, height above home."""

    waypoints: Annotated[list[Place], Field(min_length=1, max_length=MAX_DRAWN_POINTS)]
    takeoff_height_m: Annotated[float, Field(ge=1.0, le=500.0)] | None = None
    """None: no take-off item."""
    end: Literal["return", "land", "hold"] = "return"


class DrawnPolygon(CheckRequest):
    """Corners in the world frame."""

    inclusion: bool = True
    corners: Annotated[list[Point], Field(min_length=3, max_length=MAX_DRAWN_POINTS)]


class DrawnCircle(CheckRequest):
    inclusion: bool = True
    center: Point
    radius_m: Annotated[float, Field(gt=0.0, le=1e5)]


class DrawnFence(CheckRequest):
    polygons: list[DrawnPolygon] = Field(default_factory=list, max_length=100)
    circles: list[DrawnCircle] = Field(default_factory=list, max_length=100)


class SeveralVehicles(CheckRequest):
    """The arrangement of missions.upload, and the vehicles in the order in which it takes them: by system id."""

    kind: ArrangementKind
    step_m: Annotated[float, Field(gt=0, le=MAX_STEP_M)] | None = None
    spacing_m: Annotated[float, Field(gt=0, le=MAX_SPACING_M)] = SPACING_M
    heading_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    places_xy_m: Annotated[list[Point | None], Field(min_length=1, max_length=300)]
    """Where each is now."""


class MissionCheck(CheckRequest):
    """A file or a drawing, and the vehicle that it is for as far as the page knows it."""

    file: DroppedFile | None = None
    drawn: DrawnMission | None = None
    autopilot: Literal["px4", "ardupilot"] | None = None
    vehicle_xy_m: Point | None = None
    """Where the vehicle is now."""
    origin: OriginKeys | None = None
    max_height_m: Annotated[Metres, Field(gt=0)] = MAX_HEIGHT_M
    max_distance_m: Annotated[Metres, Field(gt=0)] = MAX_DISTANCE_M
    several: SeveralVehicles | None = None


class FenceCheck(CheckRequest):
    file: DroppedFile | None = None
    drawn: DrawnFence | None = None
    autopilot: Literal["px4", "ardupilot"] | None = None
    home_xy_m: Point | None = None
    """Home of the vehicle, for the file that is written."""
    home_alt_amsl_m: Height | None = None
    origin: OriginKeys | None = None


def check_mission(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.mission.check: everything in the file, mission, fence and rally points. Raises SkygcsError."""
    asked = parsed(MissionCheck, params)
    world = WorldMap(asked.origin)
    if (asked.file is None) == (asked.drawn is None):
        raise RefusedError("give either a file or a drawing")
    if asked.file is not None:
        name = asked.file.name
        imported = read_plan(asked.file.content(), name)
    else:
        assert asked.drawn is not None
        name, imported = "drawn.plan", Imported(_mission_of(asked.drawn, asked.vehicle_xy_m, world), "plan")
    vehicle = None if asked.vehicle_xy_m is None or not world.known else world.lat_lon(asked.vehicle_xy_m)
    limits = CheckLimits(asked.max_height_m, asked.max_distance_m)
    checked = _checked(name, imported, limits, asked.autopilot, vehicle, world)
    return checked | _text(asked.drawn, imported) | {"several": _several(imported.plan, asked.several, world)}


def _several(plan: MissionPlan, asked: SeveralVehicles | None, world: WorldMap) -> dict[str, Any] | None:
    """The path of each vehicle's own mission, to be drawn; the margins are the default ones, which the daemon has of
    each vehicle. None: they are not asked for."""
    if asked is None or not world.known:
        return None
    arrangement = Arrangement(asked.kind, asked.step_m, asked.spacing_m, asked.heading_deg)
    places = [None if xy is None else world.lat_lon(xy) for xy in asked.places_xy_m]
    try:
        plans = for_several(plan, arrangement, places, [Footprint()] * len(places))
    except ValueError as error:
        return {"problem": str(error), "paths": []}
    most = MAX_SHOWN_ITEMS // len(plans)
    paths = [[_path_point(item, world) for item in own.mission if item.moves and item.position] for own in plans]
    return {"problem": None, "paths": [path[:most] for path in paths]}


def _path_point(item: MissionItem, world: WorldMap) -> list[float]:
    x, y = world.xy(*(item.position or (0.0, 0.0))) or (0.0, 0.0)
    return [x, y, item.z or 0.0]


def check_fence(params: Mapping[str, Any]) -> dict[str, Any]:
    """web.fence.check: the fence of a file, or a drawn one; nothing else of the file is used. Raises SkygcsError."""
    asked = parsed(FenceCheck, params)
    world = WorldMap(asked.origin)
    if (asked.file is None) == (asked.drawn is None):
        raise RefusedError("give either a file or a drawing")
    if asked.file is not None:
        name = asked.file.name
        read = read_plan(asked.file.content(), name)
        if not read.plan.fence:
            raise PlanFileError(name, "", "holds no fence")
        imported = Imported(MissionPlan(fence=read.plan.fence, home=read.plan.home), read.format, read.notes)
    else:
        assert asked.drawn is not None
        if not asked.drawn.polygons and not asked.drawn.circles:
            raise RefusedError("the drawing has neither a polygon nor a circle")
        name, imported = "drawn.plan", Imported(_fence_of(asked, world), "plan")
    return _checked(name, imported, CheckLimits(), asked.autopilot, None, world) | _text(asked.drawn, imported)


# --- drawings ---------------------------------------------------------------------------------------------------------


def _mission_of(drawn: DrawnMission, vehicle_xy_m: list[float] | None, world: WorldMap) -> MissionPlan:
    items = []
    try:
        if drawn.takeoff_height_m is not None:
            # a PX4 wants a place: where the vehicle is, so that it climbs straight up
            lat, lon = world.lat_lon(vehicle_xy_m or drawn.waypoints[0][:2])
            seven = (0.0, 0.0, 0.0, None, lat, lon, drawn.takeoff_height_m)
            items.append(MissionItem.from_params(mav_cmd.NAV_TAKEOFF, RELATIVE_ALT, seven, True))
        for x, y, height in drawn.waypoints:
            lat, lon = world.lat_lon([x, y])
            seven = (0.0, 0.0, 0.0, None, lat, lon, height)
            items.append(MissionItem.from_params(mav_cmd.NAV_WAYPOINT, RELATIVE_ALT, seven, True))
        items.extend(_ending(drawn, world))
    except ValueError as error:
        raise RefusedError(f"the drawing cannot be flown: {error}") from None
    return MissionPlan(mission=tuple(items))


def _ending(drawn: DrawnMission, world: WorldMap) -> list[MissionItem]:
    match drawn.end:
        case "return":
            nothing = (0.0,) * 7
            return [MissionItem.from_params(mav_cmd.NAV_RETURN_TO_LAUNCH, MISSION_FRAME, nothing, True)]
        case "land":
            lat, lon = world.lat_lon(drawn.waypoints[-1][:2])
            return [MissionItem.from_params(mav_cmd.NAV_LAND, RELATIVE_ALT, (0.0, 0.0, 0.0, None, lat, lon, 0.0), True)]
        case "hold":
            x, y, height = drawn.waypoints[-1]
            lat, lon = world.lat_lon([x, y])
            seven = (0.0, 0.0, 0.0, None, lat, lon, height)
            return [MissionItem.from_params(mav_cmd.NAV_LOITER_UNLIM, RELATIVE_ALT, seven, True)]


def _fence_of(asked: FenceCheck, world: WorldMap) -> MissionPlan:
    drawn = asked.drawn
    assert drawn is not None
    try:
        fence = FencePlan(
            tuple(FencePolygon(p.inclusion, tuple(world.lat_lon(c) for c in p.corners)) for p in drawn.polygons),
            tuple(FenceCircle(c.inclusion, world.lat_lon(c.center), c.radius_m) for c in drawn.circles),
        )
    except ValueError as error:
        raise RefusedError(f"the drawing is not a fence: {error}") from None
    home = None
    if asked.home_xy_m is not None and asked.home_alt_amsl_m is not None:
        home = PlannedHome(*world.lat_lon(asked.home_xy_m), asked.home_alt_amsl_m)
    return MissionPlan(fence=fence, home=home)


# --- the answer -------------------------------------------------------------------------------------------------------


@cache
def _dialect() -> Dialect:
    return load_dialect(FleetConfig().dialect)


def _checked(
    name: str,
    imported: Imported,
    limits: CheckLimits,
    family: Family | None,
    vehicle: tuple[float, float] | None,
    world: WorldMap,
) -> dict[str, Any]:
    # check the plan
    plan, dialect = imported.plan, _dialect()
    findings = check_plan(plan, dialect, limits, family=family, vehicle=vehicle)
    changes = for_firmware(plan.mission, family, dialect.enums.get("MAV_CMD", {})).changes
    home = plan.home
    # notes
    notes = list(imported.notes)
    if len(plan.mission) > MAX_SHOWN_ITEMS:
        notes.append(f"{len(plan.mission)} items; the first {MAX_SHOWN_ITEMS} are shown")
    # the part that the page shows
    return {
        "name": name,
        "ok": not errors(findings),
        "format": imported.format,
        "holds": [kind.word for kind in plan.holds()],
        "counts": {kind.word: len(plan.items(kind)) for kind in MissionType},
        "home": None
        if home is None
        else {
            "lat_deg": home.lat_deg,
            "lon_deg": home.lon_deg,
            "alt_amsl_m": home.alt_amsl_m,
            "xy_m": world.xy(home.lat_deg, home.lon_deg),
        },
        "mission": [_item(n, item, dialect, world) for n, item in enumerate(plan.mission[:MAX_SHOWN_ITEMS], 1)],
        "rally": [_item(n, item, dialect, world) for n, item in enumerate(plan.rally[:MAX_SHOWN_ITEMS], 1)],
        "fence": _fence(plan.fence, world),
        "notes": notes,
        "changes": _changes(changes),
        "findings": [_finding(finding) for finding in _worst_first(findings)[:MAX_SHOWN_FINDINGS]],
        "errors": len(errors(findings)),
        "warnings": len(findings) - len(errors(findings)),
    }


def _text(drawn: DrawnMission | DrawnFence | None, imported: Imported) -> dict[str, Any]:
    """The .plan of a drawing; of a file null: the page uploads what was dropped."""
    return {"text": None if drawn is None else write_qgc(imported.plan)}


def _item(number: int, item: MissionItem, dialect: Dialect, world: WorldMap) -> dict[str, Any]:
    place = item.position
    return {
        "number": number,
        "command": item.command,
        "name": dialect.enums.get("MAV_CMD", {}).get(item.command, str(item.command)),
        "moves": item.moves,
        "params": list(item.seven),
        "lat_lon_deg": None if place is None else list(place),
        "xy_m": None if place is None else world.xy(*place),
        "height_m": item.z if place is not None else None,
        "height_above": HEIGHT_ABOVE.get(item.frame) if place is not None else None,
    }


def _fence(fence: FencePlan, world: WorldMap) -> dict[str, Any]:
    return {
        "polygons": [
            {
                "inclusion": polygon.inclusion,
                "corners": len(polygon.corners),
                "xy_m": [world.xy(*corner) for corner in polygon.corners] if world.known else None,
            }
            for polygon in fence.polygons
        ],
        "circles": [
            {"inclusion": circle.inclusion, "center_xy_m": world.xy(*circle.center), "radius_m": circle.radius_m}
            for circle in fence.circles
        ],
    }


def _changes(changes: tuple[ItemChange, ...]) -> list[str]:
    return list(grouped(changes))[:MAX_SHOWN_FINDINGS]


def _worst_first(findings: tuple[Finding, ...]) -> list[Finding]:
    return sorted(findings, key=lambda finding: not finding.error)


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "severity": "error" if finding.error else "warning",
        "list": finding.kind.word,
        "item": finding.item,
        "text": finding.text,
    }
