"""A plan: a mission, a fence, rally points and the home they were planned from; and its check before it is sent.

A DO_JUMP names the number of an item (`core.mission.item`); `to_wire` and `from_wire` turn it into the sequence
number of the wire and back.

Each finding of the check has the number of its item. An error is an item that an autopilot would refuse, or fly to an
unintended position; a warning may be intended. Findings that depend on the autopilot are for the given one, or name the
autopilot if none is given.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from skygcs.core.geo import distance_m, swapped_hint
from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mission.fence import FenceArea, FencePlan, fence_from_items, fence_items, fence_problems
from skygcs.core.mission.firmware_items import Family, convert, for_firmware, px4_order, refusals
from skygcs.core.mission.item import (
    FENCE_COMMANDS,
    GLOBAL,
    GLOBAL_FRAMES,
    MISSION_FRAME,
    RELATIVE_ALT,
    MissionItem,
    MissionType,
    item_of_seq,
    seq_of_item,
)
from skygcs.spelling import rounded

PLACELESS = frozenset(
    {20, 93, 112, 114, 115, 177, 178, 181, 182, 183, 184, 187, 197, 203, 205, 206, 211, 218, 222, 223, 530, 531, 532}
    | {600, 601, 2000, 2001, 2500, 2501, 3000}
)
"""Commands without a position. An ArduPilot ignores their frame and reports frame 0; a PX4 accepts them in
MAV_FRAME_MISSION only, which Mission Planner's files do not use."""


@dataclass(frozen=True, slots=True)
class PlannedHome:
    """Home of the plan; its altitude is AMSL."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float

    def item(self) -> MissionItem:
        """Item 0 of an ArduPilot."""
        return MissionItem.from_params(
            mav_cmd.NAV_WAYPOINT, GLOBAL, (0.0, 0.0, 0.0, 0.0, self.lat_deg, self.lon_deg, self.alt_amsl_m), True
        )


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """The vehicle for which a .plan was made; kept for writing the file, not used. Speeds in m/s."""

    firmware_type: int = 0
    vehicle_type: int = 2
    cruise_speed_mps: float = 15.0
    hover_speed_mps: float = 5.0


DEFAULT_SETTINGS = PlanSettings()
NO_FENCE = FencePlan()


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """``rally`` items are all NAV_RALLY_POINT."""

    mission: tuple[MissionItem, ...] = ()
    fence: FencePlan = NO_FENCE
    rally: tuple[MissionItem, ...] = ()
    home: PlannedHome | None = None
    settings: PlanSettings = DEFAULT_SETTINGS

    def holds(self) -> tuple[MissionType, ...]:
        """The lists that are not empty."""
        counts = {
            MissionType.MISSION: len(self.mission),
            MissionType.FENCE: len(fence_items(self.fence)),
            MissionType.RALLY: len(self.rally),
        }
        return tuple(kind for kind, count in counts.items() if count)

    def items(self, kind: MissionType) -> tuple[MissionItem, ...]:
        """The items of one list, without home."""
        match kind:
            case MissionType.MISSION:
                return self.mission
            case MissionType.FENCE:
                return fence_items(self.fence)
            case MissionType.RALLY:
                return self.rally

    def with_items(self, kind: MissionType, items: tuple[MissionItem, ...]) -> MissionPlan:
        """The plan with one list replaced. Raises ValueError if fence items do not form a fence."""
        match kind:
            case MissionType.MISSION:
                return replace(self, mission=items)
            case MissionType.FENCE:
                return replace(self, fence=fence_from_items(items))
            case MissionType.RALLY:
                return replace(self, rally=items)


def shifted_jumps(items: tuple[MissionItem, ...], by: int) -> tuple[MissionItem, ...]:
    """The items with every DO_JUMP's target moved; one that is not set stays so."""
    return tuple(
        replace(item, params=(item.params[0] + by, *item.params[1:]))
        if item.command == mav_cmd.DO_JUMP and item.params[0] is not None
        else item
        for item in items
    )


def to_wire(items: tuple[MissionItem, ...], home_item: MissionItem | None) -> tuple[MissionItem, ...]:
    """The items of a *mission* as they are sent: after ``home_item`` to an ArduPilot, without it (None) to a PX4.

    Fence and rally lists are sent as they are. For ArduPilot numbers that are not set become 0, because it refuses many
    items with NaN; for PX4 commands without a position get the one frame in which it accepts them.
    """
    if home_item is not None:
        return (home_item, *map(_all_set, items))
    return shifted_jumps(tuple(map(_without_place, items)), seq_of_item(0, home_first=False))


def from_wire(items: tuple[MissionItem, ...], *, first_is_home: bool) -> tuple[MissionItem, ...]:
    """The inverse of `to_wire` for downloaded items, as far as the vehicle kept them."""
    if first_is_home:
        return tuple(map(_without_place, items[1:]))
    return shifted_jumps(items, item_of_seq(0, home_first=False))


def _all_set(item: MissionItem) -> MissionItem:
    p1, p2, p3, p4 = (0.0 if value is None else value for value in item.params)
    return replace(item, params=(p1, p2, p3, p4))


def _without_place(item: MissionItem) -> MissionItem:
    if item.command in PLACELESS and (item.x, item.y) == (0, 0):
        return replace(item, frame=MISSION_FRAME)
    return item


MAX_HEIGHT_M = 500.0
"""Default limit of the height above home; as for takeoff heights."""

MAX_DISTANCE_M = 1000.0
"""Default limit of the distance from the vehicle, or from home if that is not known; as for a goto."""

MIN_FLIGHT_HEIGHT_M = 0.5
"""A waypoint below this height is on the ground."""

TAKEOFFS = frozenset({mav_cmd.NAV_TAKEOFF, mav_cmd.NAV_TAKEOFF_LOCAL, mav_cmd.NAV_VTOL_TAKEOFF})

ENDS_ON_GROUND = frozenset(
    {mav_cmd.NAV_RETURN_TO_LAUNCH, mav_cmd.NAV_LAND, mav_cmd.NAV_LAND_LOCAL, mav_cmd.NAV_VTOL_LAND}
)
"""Commands whose altitude may be 0, or is not used: return, and the landings."""

NEEDS_PLACE = frozenset({mav_cmd.NAV_WAYPOINT, mav_cmd.NAV_SPLINE_WAYPOINT, mav_cmd.NAV_ARC_WAYPOINT})
"""They need a position."""

FLOWN_PLACE = NEEDS_PLACE | {
    mav_cmd.NAV_LOITER_UNLIM,
    mav_cmd.NAV_LOITER_TURNS,
    mav_cmd.NAV_LOITER_TIME,
    mav_cmd.NAV_LAND,
    mav_cmd.NAV_TAKEOFF,
    mav_cmd.NAV_LOITER_TO_ALT,
    mav_cmd.NAV_VTOL_TAKEOFF,
    mav_cmd.NAV_VTOL_LAND,
    mav_cmd.NAV_PAYLOAD_PLACE,
}
"""NAV commands whose x and y are a position to fly to."""

RADIUS_PARAM = {
    mav_cmd.NAV_LOITER_UNLIM: 2,
    mav_cmd.NAV_LOITER_TURNS: 2,
    mav_cmd.NAV_LOITER_TIME: 2,
    mav_cmd.NAV_LOITER_TO_ALT: 1,
}
"""Index of the parameter with the radius (m) of the circle that is flown about the place, of those that have one."""

FLOWN_OTHERWISE = frozenset(
    {
        mav_cmd.NAV_TAKEOFF_LOCAL,
        mav_cmd.NAV_LAND_LOCAL,
        mav_cmd.NAV_FOLLOW,
        mav_cmd.NAV_CONTINUE_AND_CHANGE_ALT,
        mav_cmd.DO_FOLLOW,
        mav_cmd.DO_FOLLOW_REPOSITION,
        mav_cmd.DO_ORBIT,
        mav_cmd.DO_FIGURE_EIGHT,
        mav_cmd.NAV_ALTITUDE_WAIT,
        mav_cmd.NAV_GUIDED_ENABLE,
        mav_cmd.CONDITION_CHANGE_ALT,
        mav_cmd.DO_CHANGE_ALTITUDE,
        mav_cmd.DO_SET_HOME,
        mav_cmd.DO_REPOSITION,
        mav_cmd.OVERRIDE_GOTO,
        mav_cmd.GUIDED_CHANGE_ALTITUDE,
    }
)
"""Commands that set a height or a place to fly to (or home, above which heights are) in another way than those of
`FLOWN_PLACE`: an arrangement cannot move them."""

LatLon = tuple[float, float]


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """``max_items``: the vehicle's capacity, home included; None: not known."""

    max_height_m: float = MAX_HEIGHT_M
    max_distance_m: float = MAX_DISTANCE_M
    max_items: int | None = None


DEFAULT_LIMITS = CheckLimits()


@dataclass(frozen=True, slots=True)
class Finding:
    """``item`` is the number in its list, from 1; None for the list as a whole."""

    error: bool
    kind: MissionType
    item: int | None
    text: str

    def __str__(self) -> str:
        where = self.kind.word if self.item is None else f"{self.kind.word} item {self.item}"
        return f"{where}: {self.text}"


def check_plan(
    plan: MissionPlan,
    dialect: Dialect,
    limits: CheckLimits = DEFAULT_LIMITS,
    *,
    family: Family | None = None,
    vehicle: LatLon | None = None,
) -> tuple[Finding, ...]:
    """All findings, in the order of the items. ``vehicle``: its present (lat_deg, lon_deg)."""
    return (
        *_home_findings(plan.home),
        *_counts(plan, limits, family),
        *_mission(plan, dialect, limits, family, vehicle),
        *fence_findings(plan, family),
        *_rally(plan, limits, vehicle),
    )


def errors(findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    return tuple(finding for finding in findings if finding.error)


def _home_findings(home: PlannedHome | None) -> Iterator[Finding]:
    if home is not None and not (abs(home.lat_deg) <= 90 and abs(home.lon_deg) <= 180):
        yield Finding(
            True, MissionType.MISSION, None, f"home at {home.lat_deg}, {home.lon_deg} is not a position on earth"
        )


def _counts(plan: MissionPlan, limits: CheckLimits, family: Family | None) -> Iterator[Finding]:
    if limits.max_items is None:
        return
    for kind in plan.holds():
        count = len(plan.items(kind)) + (kind is MissionType.MISSION and family == "ardupilot")
        if count > limits.max_items:
            yield Finding(True, kind, None, f"{count} items are too many: the vehicle holds {limits.max_items}")


def _mission(
    plan: MissionPlan, dialect: Dialect, limits: CheckLimits, family: Family | None, vehicle: LatLon | None
) -> Iterator[Finding]:
    commands = dialect.enums.get("MAV_CMD", {})
    reference, what = _reference(plan, vehicle)
    tags = {item.params[0] for item in plan.mission if item.command == mav_cmd.JUMP_TAG}
    for number, item in enumerate(plan.mission, 1):
        wrong = list(_command(item, commands, dialect.name))
        texts = [
            *wrong,
            *(() if wrong or family is None else _firmware(item, family, commands)),
            *_place(item, family),
            *_altitude(item, limits, plan.home),
            *_jump(item, number, len(plan.mission), tags),
            *_far(item, reference, what, limits),
        ]
        for is_error, text in texts:
            yield Finding(is_error, MissionType.MISSION, number, text)
    yield from _start(plan.mission)
    if family == "px4":
        for number, text in px4_order(for_firmware(plan.mission, family, commands).items):
            yield Finding(True, MissionType.MISSION, number, text)


def _firmware(item: MissionItem, family: Family, commands: Mapping[int, str]) -> Iterator[tuple[bool, str]]:
    """The firmware's refusals of an item after its conversion."""
    converted, _ = convert(item, family, commands)
    if converted is not None:
        yield from refusals(converted, family, commands)


def _start(items: tuple[MissionItem, ...]) -> Iterator[Finding]:
    first = next(((n, i) for n, i in enumerate(items, 1) if i.moves), None)
    if first is not None and first[1].command not in TAKEOFFS:
        text = "the mission does not begin with a take-off; a vehicle on the ground will not start it"
        yield Finding(False, MissionType.MISSION, first[0], text)


def _reference(plan: MissionPlan, vehicle: LatLon | None) -> tuple[LatLon | None, str]:
    """The point that distances are measured from, and its name."""
    if vehicle is not None:
        return vehicle, "the vehicle"
    if plan.home is not None:
        return (plan.home.lat_deg, plan.home.lon_deg), "home"
    first = next((item.position for item in plan.mission if item.position is not None and _flies_to(item)), None)
    return first, "the first position of the mission"


def _flies_to(item: MissionItem) -> bool:
    return item.command in FLOWN_PLACE


def _command(item: MissionItem, commands: Mapping[int, str], dialect: str) -> Iterator[tuple[bool, str]]:
    if item.command in FENCE_COMMANDS or item.command == mav_cmd.NAV_RALLY_POINT:
        name = commands.get(item.command, str(item.command))
        where = "rally" if item.command == mav_cmd.NAV_RALLY_POINT else "fence"
        yield True, f"{name} belongs in a {where} list, not in a mission"
    elif item.command not in commands:
        yield True, f"command {item.command} is unknown to the dialect {dialect}"


def _place(item: MissionItem, family: Family | None) -> Iterator[tuple[bool, str]]:
    if item.frame in GLOBAL_FRAMES:
        if item.position is not None:
            lat, lon = item.position
            if not (abs(lat) <= 90 and abs(lon) <= 180):
                yield True, f"{lat}, {lon} is not a position on earth{swapped_hint(lat, lon, None, 0.0)}"
        elif item.command in NEEDS_PLACE:
            zero = (item.x, item.y) == (0, 0)
            if family == "px4" or not zero:
                yield True, "has no position" + (" (0, 0)" if zero else "")
            elif family is None:
                yield False, "is at 0, 0: for an ArduPilot that is its own position then, a PX4 flies to 0, 0"
    elif item.frame == MISSION_FRAME and item.command in NEEDS_PLACE:
        yield True, "is a waypoint in frame MISSION, which has no position"


def _altitude(item: MissionItem, limits: CheckLimits, home: PlannedHome | None) -> Iterator[tuple[bool, str]]:
    if item.command not in FLOWN_PLACE or item.command in ENDS_ON_GROUND:
        return
    if item.z is None:
        yield True, "the altitude is not set (NaN)"
        return
    height_m: float | None = item.z
    above = "above home" if item.frame == RELATIVE_ALT else "above the terrain"
    if item.frame == GLOBAL:
        height_m = None if home is None else item.z - home.alt_amsl_m
        above = "above home"
    elif item.frame not in GLOBAL_FRAMES:
        return
    if height_m is None:
        return
    if height_m > limits.max_height_m:
        yield True, f"the altitude is {rounded(height_m)} m {above}, over the limit of {limits.max_height_m:g} m"
    elif height_m < 0:
        yield False, f"the altitude is {rounded(-height_m)} m below {above.removeprefix('above ')}"
    elif height_m < MIN_FLIGHT_HEIGHT_M and item.command in TAKEOFFS:
        yield True, f"a take-off to {rounded(height_m)} m"
    elif height_m < MIN_FLIGHT_HEIGHT_M:
        yield (
            False,
            f"the altitude is {rounded(height_m)} m {above}: on the ground (an ArduPilot keeps its height for 0)",
        )


def _jump(item: MissionItem, number: int, count: int, tags: set[float | None]) -> Iterator[tuple[bool, str]]:
    target, repeat = item.params[0], item.params[1]
    if item.command == mav_cmd.DO_JUMP_TAG and target not in tags:
        yield True, f"jumps to tag {_shown(target)}, which no item has"
    if item.command != mav_cmd.DO_JUMP:
        return
    if target is None or not target.is_integer() or not 1 <= target <= count:
        yield True, f"jumps to item {_shown(target)}; the mission has 1 to {count}"
    elif target == number:
        yield True, "jumps to itself"
    if repeat is None or repeat < -1 or not repeat.is_integer():
        yield True, f"repeats {_shown(repeat)} times; it must be a count, or -1 for ever"


def _far(item: MissionItem, reference: LatLon | None, what: str, limits: CheckLimits) -> Iterator[tuple[bool, str]]:
    if reference is None or item.position is None or not _flies_to(item):
        return
    off_m = distance_m(*reference, *item.position)
    if off_m > limits.max_distance_m:
        hint = swapped_hint(*item.position, reference, limits.max_distance_m)
        yield True, f"is {off_m:,.0f} m from {what}, over the limit of {limits.max_distance_m:,.0f} m{hint}"


def fence_findings(plan: MissionPlan, family: Family | None = None) -> Iterator[Finding]:
    """Problems of the fence itself, and conflicts of the mission and the rally points with it."""
    sound = True
    for shape, text, is_error in fence_problems(plan.fence):
        sound = sound and not is_error
        yield Finding(is_error, MissionType.FENCE, None, f"{shape}: {text}")
    if not sound or not plan.fence:
        return
    area = FenceArea(plan.fence, any_inclusion=family == "px4")
    before: LatLon | None = None
    for kind in (MissionType.MISSION, MissionType.RALLY):
        for number, item in enumerate(plan.items(kind), 1):
            if item.position is None or not (_flies_to(item) or kind is MissionType.RALLY):
                continue
            if conflict := area.conflict(item.position):
                yield Finding(True, kind, number, conflict)
            elif (
                kind is MissionType.MISSION and before is not None and (crossed := area.crossed(before, item.position))
            ):
                yield Finding(False, kind, number, f"the path to it {crossed}")
            before = item.position
        before = None
    if plan.home is not None and (conflict := area.conflict((plan.home.lat_deg, plan.home.lon_deg))):
        yield Finding(False, MissionType.FENCE, None, f"home {conflict}")


def _rally(plan: MissionPlan, limits: CheckLimits, vehicle: LatLon | None) -> Iterator[Finding]:
    reference, what = _reference(plan, vehicle)
    for number, item in enumerate(plan.rally, 1):
        if item.position is None:
            yield Finding(True, MissionType.RALLY, number, "has no position")
            continue
        if item.z is None:
            yield Finding(True, MissionType.RALLY, number, "the altitude is not set (NaN)")
        if reference is None:
            continue
        off_m = distance_m(*reference, *item.position)
        if off_m > limits.max_distance_m:
            text = f"is {off_m:,.0f} m from {what}, over the limit of {limits.max_distance_m:,.0f} m"
            text += swapped_hint(*item.position, reference, limits.max_distance_m)
            yield Finding(True, MissionType.RALLY, number, text)


def _shown(value: float | None) -> str:
    return "nothing" if value is None else f"{value:g}"
