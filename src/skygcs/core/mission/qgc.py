"""QGroundControl's JSON: .plan files, and the .mission files of its older versions.

Complex items (survey, corridor scan, fixed-wing and VTOL landing, structure scan) are replaced by their simple items:
those of a structure scan are computed (`structure_items`), those of the others are stored in the file. Written files
contain simple items only, so a converted plan has lost its polygons and cameras.

Format: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html

A structure scan is stored as the outline, the distance from it and the layers. Its pattern is that of QGroundControl
(StructureScanComplexItem, file version 3): fly to the entrance, turn the camera towards the structure, fly along the
outline once per layer with the camera triggering, turn the camera back, leave.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from skygcs.core.geo import EARTH_RADIUS_M
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.fence import FenceCircle, FencePlan, FencePolygon
from skygcs.core.mission.item import MAX_ITEMS, MISSION_FRAME, RELATIVE_ALT, MissionItem, shortest
from skygcs.core.mission.plan import MissionPlan, PlannedHome, PlanSettings
from skygcs.errors import PlanFileError

# --- structure scans --------------------------------------------------------------------------------------------------

Point = tuple[float, float]

YAW_TO_STRUCTURE_DEG = 90.0
"""The outline is flown clockwise, with the structure to the right."""

MAX_LAYERS = 1000
"""More than any structure needs; a bound for files with values such as 1e9."""

PARALLEL = 1e-9
"""Sine of the angle below which two edges count as one line."""


@dataclass(frozen=True, slots=True)
class StructureScan:
    """Lengths in metres, heights above home, angles in degrees. ``outline``: (lat_deg, lon_deg) of its corners."""

    outline: tuple[Point, ...]
    distance_m: float
    layers: int
    layer_height_m: float
    trigger_distance_m: float
    entrance_height_m: float
    bottom_height_m: float
    top_height_m: float
    from_top: bool
    gimbal_pitch_deg: float = 0.0


def structure_items(scan: StructureScan) -> tuple[MissionItem, ...]:
    """The scan's items. Raises ValueError for an impossible outline and for more than MAX_LAYERS."""
    if not 0 < scan.layers <= MAX_LAYERS:
        raise ValueError(f"{scan.layers} layers are not between 1 and {MAX_LAYERS}")
    path = offset_outline(scan.outline, scan.distance_m)
    entrance = _waypoint(path[0], scan.entrance_height_m)
    items = [
        entrance,
        _action(mav_cmd.DO_SET_ROI_WPNEXT_OFFSET, 0.0, 0.0, scan.gimbal_pitch_deg, YAW_TO_STRUCTURE_DEG),
    ]
    step_m = -scan.layer_height_m if scan.from_top else scan.layer_height_m
    height_m = (scan.top_height_m if scan.from_top else scan.bottom_height_m) + step_m / 2
    for _ in range(scan.layers):
        first, *rest = (_waypoint(corner, height_m) for corner in (*path, path[0]))
        items += [
            first,
            _action(mav_cmd.DO_SET_CAM_TRIGG_DIST, scan.trigger_distance_m, 1.0),
            *rest,
            _action(mav_cmd.DO_SET_CAM_TRIGG_DIST),
        ]
        height_m += step_m
    return (*items, _action(mav_cmd.DO_SET_ROI_NONE), entrance)


def offset_outline(outline: Sequence[Point], distance_m: float) -> tuple[Point, ...]:
    """The polygon moved outwards by a distance, clockwise, beginning with the outline's first corner.

    Plane geometry around that corner. Raises ValueError for fewer than three corners, or corners without an area.
    """
    if len(outline) < 3:
        raise ValueError(f"the outline has {len(outline)} corners, not three or more")
    lat0, lon0 = outline[0]
    per_deg = math.radians(EARTH_RADIUS_M)
    shrink = math.cos(math.radians(lat0))
    corners = [((lon - lon0) * per_deg * shrink, (lat - lat0) * per_deg) for lat, lon in outline]
    twice_area = sum(ax * by - bx * ay for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True))
    if abs(twice_area) < 1e-3:
        raise ValueError("the outline's corners lie in one line")
    if twice_area > 0:  # counter-clockwise: reversed, or outwards would be inwards
        corners = [corners[0], *corners[:0:-1]]
    moved = [
        _moved(corners[n - 1], corners[n], corners[(n + 1) % len(corners)], distance_m) for n in range(len(corners))
    ]
    return tuple((lat0 + y / per_deg, lon0 + x / (per_deg * shrink)) for x, y in moved)


def _moved(before: Point, corner: Point, after: Point, distance_m: float) -> Point:
    """The intersection of the two edges at a corner after both are moved to the left of their (clockwise) direction."""
    ux, uy = _unit(before, corner)
    vx, vy = _unit(corner, after)
    cross = ux * vy - uy * vx
    px, py = corner[0] - uy * distance_m, corner[1] + ux * distance_m
    if abs(cross) < PARALLEL:
        return px, py
    qx, qy = corner[0] - vy * distance_m, corner[1] + vx * distance_m
    along = ((qx - px) * vy - (qy - py) * vx) / cross
    return px + along * ux, py + along * uy


def _unit(a: Point, b: Point) -> Point:
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        raise ValueError("the outline has the same corner twice in a row")
    return dx / length, dy / length


def _waypoint(place: Point, height_m: float) -> MissionItem:
    return MissionItem.from_params(mav_cmd.NAV_WAYPOINT, RELATIVE_ALT, (0.0, 0.0, 0.0, None, *place, height_m), True)


def _action(command: int, p1: float = 0.0, p3: float = 0.0, p5: float = 0.0, p7: float = 0.0) -> MissionItem:
    return MissionItem.from_params(command, MISSION_FRAME, (p1, 0.0, p3, 0.0, p5, 0.0, p7), True)


# --- files ------------------------------------------------------------------------------------------------------------


PLAN_VERSION = 1
MISSION_VERSION = 2
OLD_MISSION_VERSIONS = (1, 2)
"""Version 1 has the text "1.0", and a whole item as its home."""

GROUP_VERSIONS = (1, 2)
"""Version of the fence and rally sections: version 1 had one polygon without a kind."""

COMPLEX_VERSIONS = {"survey": (2, 3, 4, 5), "CorridorScan": (1, 2)}
"""Versions of complex items whose stored items are known to be complete (QGroundControl 3.4 to 5)."""


@dataclass(slots=True)
class _File:
    """The state of reading a file: the location for errors, and notes for the user."""

    source: str
    notes: list[str] = field(default_factory=list)

    def error(self, where: str, reason: str) -> PlanFileError:
        return PlanFileError(self.source, where, reason)

    def number(self, value: Any, where: str) -> float | None:
        """A number, or None for null. JSON's NaN, which some programs write, is the same as null."""
        if value is None or (isinstance(value, float) and value != value):
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(where, f"must be a number, not {_short(value)}")
        try:
            number = float(value)
        except OverflowError:  # JSON's integers have no limit
            number = math.inf
        if math.isinf(number):
            raise self.error(where, "is not a finite number")
        return number

    def given(self, value: Any, where: str) -> float:
        number = self.number(value, where)
        if number is None:
            raise self.error(where, "must be a number, not null or NaN")
        return number

    def whole(self, value: Any, where: str) -> int:
        number = self.given(value, where)
        if number != int(number):
            raise self.error(where, f"must be a whole number, not {_short(value)}")
        return int(number)

    def table(self, value: Any, where: str) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.error(where, f"must be an object, not {_short(value)}")
        return value

    def array(self, value: Any, where: str, length: int | None = None) -> list[Any]:
        if not isinstance(value, list):
            raise self.error(where, f"must be a list, not {_short(value)}")
        if length is not None and len(value) != length:
            raise self.error(where, f"must hold {length} numbers, not {len(value)}")
        return value

    def place(self, value: Any, where: str) -> tuple[float, float]:
        """Latitude and longitude; what follows them, as a height, is not read."""
        values = self.array(value, where)
        if len(values) < 2:
            raise self.error(where, f"must hold a latitude and a longitude, not {_short(value)}")
        lat, lon = (self.given(v, where) for v in values[:2])
        return lat, lon


def read_qgc(text: str, source: str) -> tuple[MissionPlan, tuple[str, ...]]:
    """(plan, notes for the user). Raises PlanFileError with the line or the item."""
    file = _File(source)
    try:
        root = file.table(json.loads(text), "")
    except json.JSONDecodeError as error:
        raise file.error(f"line {error.lineno}", f"not JSON: {error.msg}") from None
    except RecursionError:
        raise file.error("", "not a plan: nested too deeply") from None
    except ValueError as error:  # a number of more digits than Python converts
        raise file.error("", f"not JSON: {error}") from None
    plan = _plan(file, root) if "fileType" in root or "mission" in root else _old_mission(file, root)
    return plan, tuple(file.notes)


def _plan(file: _File, root: dict[str, Any]) -> MissionPlan:
    kind = root.get("fileType", "Plan")
    if kind != "Plan":
        raise file.error("", f'fileType must be "Plan", not {_short(kind)}')
    _version(file, root, "", (PLAN_VERSION,))
    plan = MissionPlan(
        fence=_fence(file, file.table(root.get("geoFence", {}), "geoFence")),
        rally=_rally(file, file.table(root.get("rallyPoints", {}), "rallyPoints")),
    )
    if "mission" not in root:
        file.notes.append("the file holds no mission")
        return plan
    mission = file.table(root["mission"], "mission")
    _version(file, mission, "mission", (MISSION_VERSION,))
    items = _items(file, file.array(mission.get("items", []), "mission.items"))
    settings = PlanSettings(
        firmware_type=file.whole(mission.get("firmwareType", 0), "mission.firmwareType"),
        vehicle_type=file.whole(mission.get("vehicleType", 2), "mission.vehicleType"),
        cruise_speed_mps=file.given(mission.get("cruiseSpeed", 15), "mission.cruiseSpeed"),
        hover_speed_mps=file.given(mission.get("hoverSpeed", 5), "mission.hoverSpeed"),
    )
    home = _home(file, mission.get("plannedHomePosition"), "mission.plannedHomePosition")
    return MissionPlan(items, plan.fence, plan.rally, home, settings)


def _old_mission(file: _File, root: dict[str, Any]) -> MissionPlan:
    """A .mission file: a .plan's mission only."""
    if "items" not in root:
        raise file.error("", "is JSON, and neither a QGroundControl plan nor a mission: it has no items")
    said = {**root, "version": _old_version(root["version"])} if "version" in root else root
    _version(file, said, "", OLD_MISSION_VERSIONS)
    if root.get("complexItems"):
        raise file.error("complexItems", "surveys of this old format hold no waypoints; save the plan again")
    items = _items(file, file.array(root["items"], "items"))
    firmware = root.get("firmwareType", root.get("MAV_AUTOPILOT", 0))
    settings = PlanSettings(firmware_type=file.whole(firmware, "firmwareType"))
    home = _home(file, root.get("plannedHomePosition"), "plannedHomePosition")
    return MissionPlan(items, home=home, settings=settings)


def _old_version(value: Any) -> Any:
    """A version written as text ("1.0") as a number; anything else unchanged."""
    try:
        return float(value) if isinstance(value, str) and len(value) <= 8 else value
    except ValueError:
        return value


def _version(file: _File, table: dict[str, Any], where: str, supported: tuple[int, ...]) -> None:
    if "version" not in table:
        raise file.error(where, "has no version")
    if table["version"] not in supported or isinstance(table["version"], bool):
        known = " or ".join(map(str, supported))
        raise file.error(where, f"version {_short(table['version'])} is not supported, only {known} is")


def _home(file: _File, value: Any, where: str) -> PlannedHome | None:
    if value is None:
        return None
    if isinstance(value, dict):  # version 1 of .mission: a simple item
        value = value.get("coordinate")
    lat, lon, alt = (file.number(v, where) for v in file.array(value, where, 3))
    if lat is None or lon is None:
        return None
    return PlannedHome(lat, lon, 0.0 if alt is None else alt)


def _items(file: _File, entries: list[Any]) -> tuple[MissionItem, ...]:
    items: list[MissionItem] = []
    numbered: list[tuple[int, int]] = []
    """(number in the file, number by counting)"""
    for entry in entries:
        where = f"item {len(items) + 1}"
        table = file.table(entry, where)
        if table.get("type") == "ComplexItem":
            items += _complex(file, table, where, numbered, len(items))
        elif table.get("type", "SimpleItem") in ("SimpleItem", "missionItem"):
            _number_of(file, table, where, numbered, len(items) + 1)
            items.append(_simple(file, table, where))
        else:
            raise file.error(where, f"type {_short(table.get('type'))} is neither SimpleItem nor ComplexItem")
        if len(items) > MAX_ITEMS:
            raise file.error(where, f"MAVLink can number {MAX_ITEMS} items")
    _check_numbers(file, numbered, any(item.command == mav_cmd.DO_JUMP for item in items))
    return tuple(items)


def _number_of(file: _File, table: dict[str, Any], where: str, numbered: list[tuple[int, int]], counted: int) -> None:
    number = table.get("doJumpId", table.get("id"))
    if number is not None:
        numbered.append((file.whole(number, f"{where}: doJumpId"), counted))


def _check_numbers(file: _File, numbered: list[tuple[int, int]], jumps: bool) -> None:
    """Numbers out of sequence are only noted if nothing uses them. If a DO_JUMP names one, its target is not known and
    the plan is refused."""
    ids = [number for number, _ in numbered]
    if any(b <= a for a, b in itertools.pairwise(ids)):
        if jumps:
            raise file.error("", "the items' numbers (doJumpId) are out of order, and a DO_JUMP names one of them")
        file.notes.append("the items' numbers (doJumpId) are out of order; the items were renumbered")
        return
    for number, counted in numbered:
        if number == counted:
            continue
        if jumps and number > counted:
            reason = f"is missing: the next one in the file is number {number}, and a DO_JUMP names a number"
            raise file.error(f"item {counted}", reason)
        if jumps:
            raise file.error(f"item {counted}", f"has the number (doJumpId) {number}, and a DO_JUMP names a number")
        file.notes.append(
            f"item {counted} has the number (doJumpId) {number}"
            + (", as if one were missing before it" if number > counted else "")
            + "; the items were renumbered"
        )
        return


def _simple(file: _File, table: dict[str, Any], where: str) -> MissionItem:
    for key in ("command", "frame"):
        if key not in table:
            raise file.error(where, f"has no {key}")
    frame = file.whole(table["frame"], f"{where}: frame")
    seven = _seven(file, table, where)
    if frame == 2 and any(v is not None and v != round(v) for v in seven[4:6]):
        file.notes.append(f"{where}: in frame MISSION param5 and param6 are sent as whole numbers; they were rounded")
    try:
        return MissionItem.from_params(
            file.whole(table["command"], f"{where}: command"),
            frame,
            seven,
            table.get("autoContinue", True) is not False,
        )
    except ValueError as error:
        raise file.error(where, str(error)) from None


def _seven(file: _File, table: dict[str, Any], where: str) -> tuple[float | None, ...]:
    """``params`` has all seven; the older form has four (or param1 to param4) and a coordinate."""
    if "coordinate" in table:
        first = table["params"] if "params" in table else [table.get(f"param{n}", 0) for n in range(1, 5)]
        values = [
            *file.array(first, f"{where}: params", 4),
            *file.array(table["coordinate"], f"{where}: coordinate", 3),
        ]
    else:
        values = file.array(table.get("params"), f"{where}: params", 7)
    return tuple(file.number(value, f"{where}: param{n}") for n, value in enumerate(values, 1))


def _complex(
    file: _File, table: dict[str, Any], where: str, numbered: list[tuple[int, int]], before: int
) -> list[MissionItem]:
    kind = table.get("complexItemType")
    if kind == "StructureScan":
        items = _structure(file, table, where)
        file.notes.append(f"{where}: structure scan, {len(items)} items computed as QGroundControl does")
        return items
    stored = table.get("TransectStyleComplexItem", table)
    stored = file.table(stored, f"{where}: TransectStyleComplexItem").get("Items")
    if not isinstance(stored, list) or not stored:
        raise file.error(where, f"{_short(kind)} holds no items; open the plan in QGroundControl and save it again")
    version, known = table.get("version"), COMPLEX_VERSIONS.get(str(kind))
    if known is not None and (version not in known or isinstance(version, bool)):
        text = f"{where}: {kind} of the unknown version {_short(version)}, only {', '.join(map(str, known))} are known"
        file.notes.append(f"{text}; its stored items are taken as they are: check them")
    items = []
    for n, entry in enumerate(stored, before + 1):
        inner = file.table(entry, f"item {n}")
        _number_of(file, inner, f"item {n}", numbered, n)
        items.append(_simple(file, inner, f"item {n}"))
    file.notes.append(f"{where}: {kind}, expanded to its {len(items)} stored items")
    return items


def _structure(file: _File, table: dict[str, Any], where: str) -> list[MissionItem]:
    _version(file, table, where, (3,))
    camera = file.table(table.get("CameraCalc"), f"{where}: CameraCalc")
    outline = file.array(table.get("polygon"), f"{where}: polygon")

    def of(source: dict[str, Any], key: str) -> float:
        return file.given(source.get(key), f"{where}: {key}")

    scan = StructureScan(
        outline=tuple(file.place(corner, f"{where}: polygon") for corner in outline),
        distance_m=of(camera, "DistanceToSurface"),
        layers=file.whole(table.get("Layers"), f"{where}: Layers"),
        layer_height_m=of(camera, "AdjustedFootprintFrontal"),
        trigger_distance_m=of(camera, "AdjustedFootprintSide"),
        entrance_height_m=of(table, "EntranceAltitude"),
        bottom_height_m=of(table, "ScanBottomAlt"),
        top_height_m=of(table, "StructureHeight"),
        from_top=table.get("StartFromTop") is True,
        gimbal_pitch_deg=of(table, "GimbalPitch"),
    )
    try:
        return list(structure_items(scan))
    except ValueError as error:
        raise file.error(where, str(error)) from None


def _fence(file: _File, section: dict[str, Any]) -> FencePlan:
    if section:
        _version(file, section, "geoFence", GROUP_VERSIONS)
    polygons = [
        _polygon(file, entry, f"fence polygon {n}")
        for n, entry in enumerate(file.array(section.get("polygons", []), "geoFence.polygons"), 1)
    ]
    if section.get("polygon"):
        polygons.append(_polygon(file, {"polygon": section["polygon"]}, "fence polygon 1"))
    circles = [
        _circle(file, entry, f"fence circle {n}")
        for n, entry in enumerate(file.array(section.get("circles", []), "geoFence.circles"), 1)
    ]
    back = section.get("breachReturn")
    return FencePlan(tuple(polygons), tuple(circles), None if back is None else _return_point(file, back))


def _polygon(file: _File, entry: Any, where: str) -> FencePolygon:
    table = file.table(entry, where)
    corners = tuple(file.place(corner, where) for corner in file.array(table.get("polygon"), where))
    try:
        return FencePolygon(table.get("inclusion", True) is not False, corners)
    except ValueError as error:
        raise file.error(where, str(error)) from None


def _circle(file: _File, entry: Any, where: str) -> FenceCircle:
    table = file.table(entry, where)
    circle = file.table(table.get("circle"), where)
    center = file.place(circle.get("center"), f"{where}: center")
    radius_m = file.given(circle.get("radius"), f"{where}: radius")
    try:
        return FenceCircle(table.get("inclusion", True) is not False, center, radius_m)
    except ValueError as error:
        raise file.error(where, str(error)) from None


def _return_point(file: _File, value: Any) -> tuple[float, float, float]:
    lat, lon, height_m = (file.given(v, "breachReturn") for v in file.array(value, "breachReturn", 3))
    return lat, lon, height_m


def _rally(file: _File, section: dict[str, Any]) -> tuple[MissionItem, ...]:
    if section:
        _version(file, section, "rallyPoints", GROUP_VERSIONS)
    items = []
    for n, point in enumerate(file.array(section.get("points", []), "rallyPoints.points"), 1):
        where = f"rally point {n}"
        place = tuple(file.number(v, where) for v in file.array(point, where, 3))
        try:
            items.append(
                MissionItem.from_params(mav_cmd.NAV_RALLY_POINT, RELATIVE_ALT, (0.0, 0.0, 0.0, 0.0, *place), True)
            )
        except ValueError as error:
            raise file.error(where, str(error)) from None
    return tuple(items)


def write_qgc(plan: MissionPlan) -> str:
    """The plan as a .plan file. Raises ValueError naming a rally point whose height is not above home, which the format
    requires."""
    for n, item in enumerate(plan.rally, 1):
        if item.frame != RELATIVE_ALT:
            raise ValueError(f"rally point {n} is in frame {item.frame}; a .plan holds heights above home only")
    home = plan.home
    document = {
        "fileType": "Plan",
        "groundStation": "skygcs",
        "version": PLAN_VERSION,
        "mission": {
            "version": MISSION_VERSION,
            "firmwareType": plan.settings.firmware_type,
            "vehicleType": plan.settings.vehicle_type,
            "cruiseSpeed": plan.settings.cruise_speed_mps,
            "hoverSpeed": plan.settings.hover_speed_mps,
            "plannedHomePosition": None if home is None else [home.lat_deg, home.lon_deg, home.alt_amsl_m],
            "items": [_item_entry(n, item) for n, item in enumerate(plan.mission, 1)],
        },
        "geoFence": _fence_entry(plan.fence),
        "rallyPoints": {"version": 2, "points": [item.seven[4:] for item in plan.rally]},
    }
    return json.dumps(document, indent=4, allow_nan=False) + "\n"


def _item_entry(number: int, item: MissionItem) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "doJumpId": number,
        "command": item.command,
        "frame": item.frame,
        "params": item.seven,
        "autoContinue": item.autocontinue,
    }


def _fence_entry(fence: FencePlan) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "version": 2,
        "polygons": [
            {"inclusion": p.inclusion, "polygon": [list(corner) for corner in p.corners], "version": 1}
            for p in fence.polygons
        ],
        "circles": [
            {
                "circle": {"center": list(c.center), "radius": shortest(c.radius_m)},
                "inclusion": c.inclusion,
                "version": 1,
            }
            for c in fence.circles
        ],
    }
    if fence.return_point is not None:
        entry["breachReturn"] = list(fence.return_point)
    return entry


def _short(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else text[:37] + "..."
