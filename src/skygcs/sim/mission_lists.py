"""The lists a simulated vehicle keeps (mission, fence, rally points), and what both firmwares share in giving them.

How a list is taken in differs: `px4_lists` and `copter_lists`. The lists survive a reboot, a transfer does not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from math import isfinite
from typing import Any, Protocol

from skygcs.core.mission.fence import FencePlan, fence_from_items
from skygcs.core.mission.item import GLOBAL_FRAMES, MissionItem, MissionType
from skygcs.sim.behaviours import MissionRules
from skygcs.sim.kinematics import Home, LocalFrame
from skygcs.sim.transmitter import Transmitter

Fields = dict[str, Any]
Sender = tuple[int, int]
Items = list[MissionItem]

MESSAGES = frozenset(
    {
        "MISSION_COUNT",
        "MISSION_ITEM_INT",
        "MISSION_ITEM",
        "MISSION_REQUEST_LIST",
        "MISSION_REQUEST_INT",
        "MISSION_REQUEST",
        "MISSION_CLEAR_ALL",
        "MISSION_ACK",
    }
)
"""Messages that `MissionLists.hear` handles. DroneKit still uses MISSION_ITEM and MISSION_REQUEST, with degrees as
floats."""

INT_FRAMES = {0: 5, 3: 6, 10: 11}
"""MAV_FRAME_GLOBAL, GLOBAL_RELATIVE_ALT and GLOBAL_TERRAIN_ALT to their names for integer messages."""


class ListOwner(Protocol):
    """Parts of a vehicle that its lists need."""

    tx: Transmitter
    where: LocalFrame
    home: Home | None

    @property
    def current_item(self) -> int: ...


class MissionLists(ABC):
    """One vehicle's. ``items`` of a mission are without an ArduPilot's home. ``capacity`` may be changed."""

    capacity: dict[MissionType, int]

    def __init__(self, on_new_mission: Callable[[], None]) -> None:
        self.items: dict[MissionType, Items] = {kind: [] for kind in MissionType}
        self.fence = FencePlan()
        """The shapes of the fence list, as far as it is one."""
        self._on_new_mission = on_new_mission

    @property
    def mission(self) -> Items:
        return self.items[MissionType.MISSION]

    @abstractmethod
    def hear(self, v: ListOwner, name: str, fields: Fields, sender: Sender, now: float) -> None:
        """One of MESSAGES that is for this vehicle."""

    @abstractmethod
    def step(self, v: ListOwner, now: float) -> None:
        """Ask again, give up."""

    @abstractmethod
    def forget_transfers(self) -> None:
        """The autopilot boots."""

    def opaque_id(self, kind: MissionType) -> int:
        """The firmware's own number of a list; 0: it keeps none."""
        return 0

    def keep(self, kind: MissionType, items: Items) -> None:
        """This is the list now. Raises ValueError for an invalid fence; the old one stays then."""
        if kind is MissionType.FENCE:
            self.fence = fence_from_items(items)
        self.items[kind] = items
        if kind is MissionType.MISSION:
            self._on_new_mission()

    # -- what is sent

    def acknowledge(self, v: ListOwner, kind: MissionType, to: Sender, result: int, number: int = 0) -> None:
        v.tx.send("MISSION_ACK", {**address(to), "type": result, "mission_type": kind}, tail(number))

    def send_count(self, v: ListOwner, kind: MissionType, to: Sender, count: int) -> None:
        fields = {**address(to), "count": count, "mission_type": kind}
        v.tx.send("MISSION_COUNT", fields, tail(self.opaque_id(kind)))

    def send_item(
        self, v: ListOwner, kind: MissionType, to: Sender, seq: int, item: MissionItem, *, as_float: bool, current: int
    ) -> None:
        """Send as MISSION_ITEM (``as_float``: degrees as float32) or MISSION_ITEM_INT; see `wire_frame` for its
        frame."""
        fields = {**address(to), **item.values(), "seq": seq, "mission_type": kind, "current": current}
        fields["frame"] = self.wire_frame(item.frame, as_float=as_float)
        if as_float:
            v.tx.send("MISSION_ITEM", {**fields, "x": item.x / scale_of(item), "y": item.y / scale_of(item)})
        else:
            v.tx.send("MISSION_ITEM_INT", fields)

    def wire_frame(self, frame: int, *, as_float: bool) -> int:
        """The MAV_FRAME that goes out for an item's."""
        return frame


def capacity_of(rules: MissionRules) -> dict[MissionType, int]:
    """How many items of each list a firmware keeps."""
    return {MissionType.MISSION: rules.missions, MissionType.FENCE: rules.fence, MissionType.RALLY: rules.rally}


def scale_of(item: MissionItem) -> float:
    """Scale of x and y in MISSION_ITEM_INT: 1e7 for degrees, 1 for items without a place."""
    return 1e7 if item.frame in GLOBAL_FRAMES else 1.0


def as_int_item(fields: Fields) -> Fields:
    """The fields of a MISSION_ITEM as those of a MISSION_ITEM_INT. Raises ValueError for x or y that no int32 holds."""
    scale = 1e7 if fields["frame"] in GLOBAL_FRAMES or fields["frame"] in INT_FRAMES.values() else 1.0
    if not (isfinite(fields["x"]) and isfinite(fields["y"])):
        raise ValueError("x or y is not finite")
    return {**fields, "x": round(fields["x"] * scale), "y": round(fields["y"] * scale)}


def address(to: Sender) -> Fields:
    return {"target_system": to[0], "target_component": to[1]}


def tail(number: int) -> bytes:
    """The opaque id behind a message whose dialect does not know it."""
    return number.to_bytes(4, "little") if number else b""


def kind_of(fields: Fields) -> MissionType | None:
    value = fields.get("mission_type", 0)
    return MissionType(value) if value in MissionType._value2member_map_ else None
