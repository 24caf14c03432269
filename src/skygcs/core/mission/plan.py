"""A plan: a mission, a fence, rally points and the home they were planned from.

A DO_JUMP names the number of an item (`core.mission.item`); `to_wire` and `from_wire` turn it into the sequence
number of the wire and back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.fence import FencePlan, fence_from_items, fence_items
from skygcs.core.mission.item import GLOBAL, MISSION_FRAME, MissionItem, MissionType, item_of_seq, seq_of_item

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
