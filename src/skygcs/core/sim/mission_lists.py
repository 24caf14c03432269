"""The lists a simulated vehicle keeps (mission, fence, rally points), and what both firmwares share in giving them.

How a list is taken in differs: `px4_lists` and `copter_lists`. The lists survive a reboot, a transfer does not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from skygcs.core.mission.fence import FencePlan, fence_from_items
from skygcs.core.mission.item import MissionItem, MissionType

if TYPE_CHECKING:
    from skygcs.core.sim.vehicle import SimVehicle

Fields = dict[str, Any]
Sender = tuple[int, int]
Items = list[MissionItem]

MESSAGES = frozenset(
    {
        "MISSION_COUNT",
        "MISSION_ITEM_INT",
        "MISSION_REQUEST_LIST",
        "MISSION_REQUEST_INT",
        "MISSION_REQUEST",
        "MISSION_CLEAR_ALL",
        "MISSION_ACK",
    }
)
"""What `MissionLists.hear` wants. The float MISSION_ITEM is left out: its users are gone."""


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
    def hear(self, v: SimVehicle, name: str, fields: Fields, sender: Sender, now: float) -> None:
        """One of MESSAGES that is for this vehicle."""

    @abstractmethod
    def step(self, v: SimVehicle, now: float) -> None:
        """Ask again, give up."""

    @abstractmethod
    def forget_transfers(self) -> None:
        """The autopilot boots."""

    def opaque_id(self, kind: MissionType) -> int:
        """Its own number for a list; 0: it has none."""
        return 0

    def keep(self, kind: MissionType, items: Items) -> None:
        """This is the list now. Raises ValueError for a fence that is none; the old one stays then."""
        if kind is MissionType.FENCE:
            self.fence = fence_from_items(items)
        self.items[kind] = items
        if kind is MissionType.MISSION:
            self._on_new_mission()

    # -- what is sent

    def acknowledge(self, v: SimVehicle, kind: MissionType, to: Sender, result: int, number: int = 0) -> None:
        v.tx.send("MISSION_ACK", {**address(to), "type": result, "mission_type": kind}, tail(number))

    def send_count(self, v: SimVehicle, kind: MissionType, to: Sender, count: int) -> None:
        fields = {**address(to), "count": count, "mission_type": kind}
        v.tx.send("MISSION_COUNT", fields, tail(self.opaque_id(kind)))

    def send_item(self, v: SimVehicle, kind: MissionType, to: Sender, seq: int, item: MissionItem) -> None:
        fields = {**address(to), **item.values(), "seq": seq, "mission_type": kind}
        v.tx.send("MISSION_ITEM_INT", {**fields, "current": 0})


def address(to: Sender) -> Fields:
    return {"target_system": to[0], "target_component": to[1]}


def tail(number: int) -> bytes:
    """The opaque id behind a message whose dialect does not know it."""
    return number.to_bytes(4, "little") if number else b""


def kind_of(fields: Fields) -> MissionType | None:
    value = fields.get("mission_type", 0)
    return MissionType(value) if value in MissionType._value2member_map_ else None
