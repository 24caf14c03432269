"""ArduPilot's side of the mission protocol (4.5, MissionItemProtocol.cpp): each list has a transfer of its own.

    state     what came                                 next      what it does
    -------   ---------------------------------------   -------   ------------------------------------------------
    any       count, of this uploader or the first      TAKING    cuts the list to it, asks for item 0; no space: ack
    TAKING    anything from somebody else               TAKING    ack denied
    TAKING    the item asked for                        TAKING    writes it, asks for the next; the last: ack, IDLE
    TAKING    another item                              TAKING    ack invalid sequence
    TAKING    an item it cannot take                    IDLE      ack that says why; what was written stays
    TAKING    a request of the list or an item          TAKING    ack denied
    TAKING    1 s                                       TAKING    asks again (by the old MISSION_REQUEST)
    TAKING    8 s of silence                            IDLE      ack cancelled, "Mission upload timeout"
    IDLE      a request of the list, of an item         IDLE      the count; the item, or the count and ack error
    IDLE      an item                                   IDLE      ack error
    any       clear                                     IDLE      ack

A mission or rally points are written item over item; a fence is taken when it is whole. Item 0 of a mission is home:
what is sent for it is taken and thrown away, what is read is where home is now. What the vehicle has no use for is not
kept: unset numbers, the frame of a command without a place, millimetres of altitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import FENCE_COMMANDS, GLOBAL, TERRAIN_ALT, MissionItem, MissionType
from skygcs.sim import protocol as m
from skygcs.sim.behaviours import COPTER
from skygcs.sim.mission_lists import (
    Fields,
    Items,
    ListOwner,
    MissionLists,
    Sender,
    address,
    as_int_item,
    capacity_of,
    kind_of,
)

RULES = COPTER.mission.simulated
ALTITUDE_STEP_M = COPTER.altitude_step_m.simulated
MAX_CORNERS = 255

GUIDED_TARGET, CHANGE_HEIGHT = 2, 3
"""`current` of an item that is no part of a mission (GCS_MAVLINK::handle_mission_item)."""

NO_YAW_NEEDED = frozenset({16, 17, 21, 22, 84, 85})
"""Commands whose param4 may be NaN (AP_Mission::sanity_check_params)."""


@dataclass(slots=True)
class Transfer:
    """An upload under way."""

    partner: Sender
    count: int
    heard_at: float
    asked_at: float = 0.0
    seq: int = 0
    fence: Items = field(default_factory=list)


class CopterLists(MissionLists):
    """See the table at the top."""

    def __init__(self, on_new_mission: Callable[[], None], fly_to: Callable[[MissionItem, float], bool]) -> None:
        """``fly_to(item, now)``: a target in GUIDED; whether it is taken."""
        super().__init__(on_new_mission)
        self._fly_to = fly_to
        self.capacity = capacity_of(RULES)
        self.forget_transfers()

    def forget_transfers(self) -> None:
        self._uploads: dict[MissionType, Transfer] = {}

    def hear(self, v: ListOwner, name: str, fields: Fields, sender: Sender, now: float) -> None:
        kind = kind_of(fields)
        if kind is None:
            return
        upload = self._uploads.get(kind)
        match name:
            case "MISSION_COUNT":
                if self._may_begin(v, kind, sender):
                    self._begin(v, kind, fields["count"], sender, now)
            case "MISSION_ITEM_INT" | "MISSION_ITEM":
                self._on_any_item(v, kind, name, fields, sender, now)
            case "MISSION_CLEAR_ALL":
                if self._may_begin(v, kind, sender):
                    self.keep(kind, [])
                    self.acknowledge(v, kind, sender, m.MAV_MISSION_ACCEPTED)
            case "MISSION_REQUEST_LIST" | "MISSION_REQUEST_INT" | "MISSION_REQUEST" if upload is not None:
                self.acknowledge(v, kind, sender, m.MAV_MISSION_DENIED)
            case "MISSION_REQUEST_LIST":
                self.send_count(v, kind, sender, len(self._on_wire(v, kind)))
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST":
                items, seq = self._on_wire(v, kind), fields["seq"]
                if seq == 0 and kind is MissionType.MISSION and not items:
                    # MissionItemProtocol_Waypoints::get_item: home can always be read; DroneKit asks for it so
                    items = [home_item(v)]
                if seq < len(items):
                    as_float = name == "MISSION_REQUEST"
                    self.send_item(v, kind, sender, seq, items[seq], as_float=as_float, current=0)
                    return
                self.send_count(v, kind, sender, len(items))
                self.acknowledge(v, kind, sender, m.MAV_MISSION_ERROR)

    def step(self, v: ListOwner, now: float) -> None:
        for kind, upload in list(self._uploads.items()):
            if now - upload.heard_at > RULES.give_up_s:
                del self._uploads[kind]
                v.tx.say(m.MAV_SEVERITY_WARNING, "Mission upload timeout")
                self.acknowledge(v, kind, upload.partner, m.MAV_MISSION_OPERATION_CANCELLED)
            elif now - upload.asked_at > RULES.retry_s:
                self._ask(v, kind, upload, now)

    def _may_begin(self, v: ListOwner, kind: MissionType, sender: Sender) -> bool:
        upload = self._uploads.get(kind)
        if upload is not None and upload.partner != sender:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_DENIED)
            return False
        self._uploads.pop(kind, None)
        return True

    def _begin(self, v: ListOwner, kind: MissionType, count: int, sender: Sender, now: float) -> None:
        if count > self.capacity[kind]:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_NO_SPACE)
            v.tx.say(m.MAV_SEVERITY_WARNING, f"Only {self.capacity[kind]} items are supported")
            return
        if kind is not MissionType.FENCE:
            home = kind is MissionType.MISSION
            self.keep(kind, self.items[kind][: max(0, count - home)])
        elif count == 0:
            self.keep(kind, [])
        if count == 0:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_ACCEPTED)
            return
        upload = self._uploads[kind] = Transfer(sender, count, now)
        self._ask(v, kind, upload, now)

    def _on_any_item(
        self, v: ListOwner, kind: MissionType, name: str, fields: Fields, sender: Sender, now: float
    ) -> None:
        """GCS_MAVLINK::handle_mission_item: the float form is converted; current 2 is a target in GUIDED, current 3 a
        change of height, and neither is part of an upload."""
        try:
            fields = as_int_item(fields) if name == "MISSION_ITEM" else fields
        except ValueError:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_INVALID_PARAM5_X)
            return
        if kind is MissionType.MISSION and fields["current"] in (GUIDED_TARGET, CHANGE_HEIGHT):
            self.acknowledge(v, kind, sender, self._guided_item(v, fields, now))
            return
        self._on_item(v, kind, fields, sender, now)

    def _guided_item(self, v: ListOwner, fields: Fields, now: float) -> int:
        """MAV_MISSION_RESULT of an item for GUIDED."""
        try:
            item = MissionItem.from_fields(fields)
        except ValueError:
            return m.MAV_MISSION_INVALID
        if item.command not in RULES.with_place | RULES.without_place:
            return m.MAV_MISSION_UNSUPPORTED
        if item.command in RULES.with_place and (refusal := _place_refusal(item)):
            return refusal
        if fields["current"] == CHANGE_HEIGHT:
            return m.MAV_MISSION_ACCEPTED  # Copter's handle_change_alt_request: only in GUIDED, answered the same
        taken = item.command == mav_cmd.NAV_WAYPOINT and item.position is not None and self._fly_to(item, now)
        return m.MAV_MISSION_ACCEPTED if taken else m.MAV_MISSION_ERROR

    def _on_item(self, v: ListOwner, kind: MissionType, fields: Fields, sender: Sender, now: float) -> None:
        upload = self._uploads.get(kind)
        if upload is None:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_ERROR)
        elif fields["seq"] != upload.seq:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_INVALID_SEQUENCE)
        elif sender != upload.partner:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_DENIED)
        else:
            result = self._take(kind, upload, fields)
            if result != m.MAV_MISSION_ACCEPTED:
                del self._uploads[kind]
                self.acknowledge(v, kind, sender, result)
                return
            upload.seq += 1
            upload.heard_at = now
            if upload.seq < upload.count:
                self._ask(v, kind, upload, now)
            else:
                self._complete(v, kind, upload)

    def _take(self, kind: MissionType, upload: Transfer, fields: Fields) -> int:
        seq = upload.seq
        if kind is MissionType.MISSION and seq == 0:
            return m.MAV_MISSION_ACCEPTED
        try:
            item = MissionItem.from_fields(fields)
        except ValueError:
            return m.MAV_MISSION_INVALID
        refusal = refusal_of(kind, item, upload.count)
        if refusal != m.MAV_MISSION_ACCEPTED:
            return refusal
        if kind is MissionType.FENCE:
            upload.fence.append(as_kept(item))
        else:
            at = seq - (kind is MissionType.MISSION)
            self.items[kind][at : at + 1] = [as_kept(item)]
        return m.MAV_MISSION_ACCEPTED

    def _complete(self, v: ListOwner, kind: MissionType, upload: Transfer) -> None:
        del self._uploads[kind]
        try:
            self.keep(kind, upload.fence if kind is MissionType.FENCE else self.items[kind])
        except ValueError:
            self.acknowledge(v, kind, upload.partner, m.MAV_MISSION_ERROR)
            return
        word = {MissionType.MISSION: "Flight plan", MissionType.FENCE: "Fence", MissionType.RALLY: "Rally points"}[kind]
        v.tx.say(m.MAV_SEVERITY_INFO, f"{word} received")
        self.acknowledge(v, kind, upload.partner, m.MAV_MISSION_ACCEPTED)

    def _ask(self, v: ListOwner, kind: MissionType, upload: Transfer, now: float) -> None:
        upload.asked_at = now
        fields = {**address(upload.partner), "seq": upload.seq, "mission_type": kind}
        v.tx.send("MISSION_REQUEST", fields)

    def _on_wire(self, v: ListOwner, kind: MissionType) -> Items:
        if kind is not MissionType.MISSION or not self.mission:
            return self.items[kind]
        return [home_item(v), *self.mission]


def home_item(v: ListOwner) -> MissionItem:
    """Item 0: where home is now."""
    home = v.home
    if home is None:
        return MissionItem(mav_cmd.NAV_WAYPOINT, GLOBAL)
    lat, lon = v.where.to_geodetic(home.east_m, home.north_m)
    alt = v.where.alt_amsl_m + home.up_m
    return MissionItem.from_params(mav_cmd.NAV_WAYPOINT, GLOBAL, (0.0, 0.0, 0.0, 0.0, lat, lon, round(alt, 2)), True)


def refusal_of(kind: MissionType, item: MissionItem, count: int) -> int:
    """MAV_MISSION_RESULT of ArduPilot's own look at an item of a list of ``count``."""
    belongs = {
        MissionType.FENCE: item.command in FENCE_COMMANDS,
        MissionType.RALLY: item.command == mav_cmd.NAV_RALLY_POINT,
        MissionType.MISSION: item.command
        in (RULES.with_place | RULES.without_place) - FENCE_COMMANDS - {mav_cmd.NAV_RALLY_POINT},
    }
    if not belongs[kind]:
        return m.MAV_MISSION_UNSUPPORTED
    for number, value in enumerate(item.params, 1):
        if value is None and not (number == 4 and item.command in NO_YAW_NEEDED):
            return m.MAV_MISSION_INVALID_PARAM1 + number - 1
    if item.command in RULES.with_place and (refusal := _place_refusal(item)):
        return refusal
    if (
        item.command in (mav_cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION, mav_cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
        and not 3 <= (item.params[0] or 0) <= MAX_CORNERS
    ):
        return m.MAV_MISSION_INVALID_PARAM1
    if item.command == mav_cmd.DO_JUMP and not 0 < (item.params[0] or 0) < count:
        return m.MAV_MISSION_ERROR
    return m.MAV_MISSION_ACCEPTED


def _place_refusal(item: MissionItem) -> int:
    """Return what `mavlink_int_to_mission_cmd` has against the place of an item that has one; 0: nothing."""
    if abs(item.x) > 900_000_000:
        return m.MAV_MISSION_INVALID_PARAM5_X
    if abs(item.y) > 1_800_000_000:
        return m.MAV_MISSION_INVALID_PARAM6_Y
    if item.z is None:
        return m.MAV_MISSION_INVALID_PARAM7
    known = item.frame in (GLOBAL, m.MAV_FRAME_GLOBAL_RELATIVE_ALT, TERRAIN_ALT, m.MAV_FRAME_MISSION)
    return 0 if known else m.MAV_MISSION_UNSUPPORTED_FRAME


def as_kept(item: MissionItem) -> MissionItem:
    """Return what is left of an item in the vehicle's storage."""
    p1, p2, p3, p4 = (value or 0.0 for value in item.params)
    kept = replace(item, params=(p1, p2, p3, p4), autocontinue=True)
    if item.command in RULES.with_place:
        return replace(kept, z=round(round((item.z or 0.0) / ALTITUDE_STEP_M) * ALTITUDE_STEP_M, 6))
    return replace(kept, frame=GLOBAL)
