"""PX4's side of the mission protocol (1.16, mavlink_mission.cpp): one transfer at a time, whatever its list.

    state     what came                                 next      what it does
    -------   ---------------------------------------   -------   ------------------------------------------------
    IDLE      count                                     TAKING    asks for item 0; no space: ack; 0: clears, ack
    IDLE      request of the list                       GIVING    sends the count
    IDLE      the last item of the last upload again    IDLE      the same ack again; another item: ack error
    IDLE      a request of an item                      IDLE      -
    IDLE      clear                                     IDLE      ack
    TAKING    the item asked for                        TAKING    asks for the next; the last: takes all, ack, IDLE
    TAKING    another item                              TAKING    -
    TAKING    count before the first item               TAKING    asks for item 0; later, or of another: ack error
    TAKING    0.25 s                                    TAKING    asks again
    GIVING    request of the next item, or the last     GIVING    that item; any other: ack error, IDLE
    TAKING, GIVING   ack (cancelled; any, if GIVING)    IDLE      -
    TAKING, GIVING   5 s of silence                     IDLE      "Operation timeout"

The old list stays until the new one is whole. Real PX4 keeps its count of items sent when it goes idle, so that a list
may be asked for by somebody else as soon as the last item was given.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from zlib import crc32

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import FENCE_COMMANDS, GLOBAL, MISSION_FRAME, RELATIVE_ALT, MissionItem, MissionType
from skygcs.sim import protocol as m
from skygcs.sim.behaviours import PX4
from skygcs.sim.mission_lists import (
    INT_FRAMES,
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

RULES = PX4.mission.simulated


class State(Enum):
    IDLE = auto()
    TAKING = auto()
    GIVING = auto()


class Px4Lists(MissionLists):
    """See the table at the top."""

    def __init__(self, on_new_mission: Callable[[], None]) -> None:
        super().__init__(on_new_mission)
        self.capacity = capacity_of(RULES)
        self.forget_transfers()

    def forget_transfers(self) -> None:
        self._state = State.IDLE
        self._kind = MissionType.MISSION
        self._partner: Sender = (0, 0)
        self._new: Items = []
        self._count = 0
        self._seq = 0
        self._heard_at = 0.0
        self._asked_at = 0.0
        self._int_mode = False
        """True if its partner writes integer messages and frames; False: the old float ones."""

    def wire_frame(self, frame: int, *, as_float: bool) -> int:
        """format_mavlink_mission_item: in integer messages the frames have their own names."""
        return frame if as_float else INT_FRAMES.get(frame, frame)

    def opaque_id(self, kind: MissionType) -> int:
        number = 0
        for item in self.items[kind]:
            number = crc32(repr(item).encode(), number)
        return number

    def hear(self, v: ListOwner, name: str, fields: Fields, sender: Sender, now: float) -> None:
        kind = kind_of(fields)
        if kind is None:
            return
        match name:
            case "MISSION_COUNT":
                self._on_count(v, kind, fields["count"], sender, now)
            case "MISSION_ITEM_INT":
                self._int_mode = True
                self._on_item(v, kind, fields, sender, now)
            case "MISSION_ITEM":
                self._int_mode = False
                self._on_item(v, kind, fields, sender, now)
            case "MISSION_REQUEST_LIST":
                self._on_list(v, kind, sender, now)
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST":
                self._int_mode = name == "MISSION_REQUEST_INT"
                self._on_request(v, kind, fields["seq"], sender, now)
            case "MISSION_CLEAR_ALL":
                self._on_clear(v, kind, sender)
            case "MISSION_ACK":
                self._on_ack(v, kind, fields["type"], sender, now)

    def step(self, v: ListOwner, now: float) -> None:
        if self._state is State.IDLE:
            return
        if now - self._heard_at > RULES.give_up_s:
            self._state = State.IDLE
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "Operation timeout\t")
        elif self._state is State.TAKING and now - self._asked_at > RULES.retry_s:
            self._ask(v, now)

    # -- taking

    def _on_count(self, v: ListOwner, kind: MissionType, count: int, sender: Sender, now: float) -> None:
        if self._state is State.TAKING:
            self._heard_at = now
            if sender != self._partner or self._seq > 0:
                self.acknowledge(v, kind, sender, m.MAV_MISSION_ERROR)
            else:
                self._ask(v, now)
            return
        if self._state is State.GIVING:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: IGN MISSION_COUNT: Busy\t")
            self.acknowledge(v, kind, sender, m.MAV_MISSION_ERROR)
        elif count > self.capacity[kind]:
            self.acknowledge(v, kind, sender, m.MAV_MISSION_NO_SPACE)
        elif count == 0:
            self.keep(kind, [])
            self.acknowledge(v, kind, sender, m.MAV_MISSION_ACCEPTED)
        else:
            self._state, self._kind, self._partner = State.TAKING, kind, sender
            self._new, self._count, self._seq, self._heard_at = [], count, 0, now
            self._ask(v, now)

    def _on_item(self, v: ListOwner, kind: MissionType, fields: Fields, sender: Sender, now: float) -> None:
        if sender != self._partner:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "REJ. MIS ITEM: partner id mismatch\t")
        elif kind is not self._kind or self._state is State.GIVING:
            self.acknowledge(v, self._kind, sender, m.MAV_MISSION_ERROR)
        elif self._state is State.IDLE:
            again = self._seq == fields["seq"] + 1
            result = m.MAV_MISSION_ACCEPTED if again else m.MAV_MISSION_ERROR
            self.acknowledge(v, kind, sender, result, self.opaque_id(kind) if again else 0)
        else:
            self._heard_at = now
            if fields["seq"] == self._seq:
                self._take(v, fields, now)

    def _take(self, v: ListOwner, fields: Fields, now: float) -> None:
        try:
            item = MissionItem.from_fields(fields if self._int_mode else as_int_item(fields))
            refusal = refusal_of(self._kind, item)
        except ValueError:
            refusal = m.MAV_MISSION_INVALID
        if refusal != m.MAV_MISSION_ACCEPTED:
            self._refuse(v, refusal)
            return
        self._new.append(item)
        self._seq += 1
        if self._seq < self._count:
            self._ask(v, now)
            return
        try:
            self.keep(self._kind, self._new)
        except ValueError:
            self._refuse(v, m.MAV_MISSION_ERROR)
            return
        self._state = State.IDLE
        self.acknowledge(v, self._kind, self._partner, m.MAV_MISSION_ACCEPTED, self.opaque_id(self._kind))

    def _refuse(self, v: ListOwner, result: int) -> None:
        self._state = State.IDLE
        v.tx.say(m.MAV_SEVERITY_CRITICAL, "IGN MISSION_ITEM: Invalid item\t")
        self.acknowledge(v, self._kind, self._partner, result)

    def _ask(self, v: ListOwner, now: float) -> None:
        self._asked_at = now
        fields = {**address(self._partner), "seq": self._seq, "mission_type": self._kind}
        v.tx.send("MISSION_REQUEST_INT" if self._int_mode else "MISSION_REQUEST", fields)

    # -- giving

    def _on_list(self, v: ListOwner, kind: MissionType, sender: Sender, now: float) -> None:
        if self._seq == len(self.items[self._kind]):
            self._state = State.IDLE
        own = self._state is State.GIVING and (kind, sender) == (self._kind, self._partner)
        if self._state is not State.IDLE and not own:
            v.tx.say(m.MAV_SEVERITY_INFO, "Mission download request ignored, already active\t")
            return
        self._state, self._kind, self._partner = State.GIVING, kind, sender
        self._seq, self._count, self._heard_at = 0, len(self.items[kind]), now
        self.send_count(v, kind, sender, self._count)

    def _on_request(self, v: ListOwner, kind: MissionType, seq: int, sender: Sender, now: float) -> None:
        if sender != self._partner:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: partner id mismatch\t")
        elif self._state is State.TAKING:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: Busy\t")
        elif self._state is State.GIVING and kind is self._kind:
            self._heard_at = now
            if seq not in (self._seq, self._seq - 1) or seq >= len(self.items[kind]):
                self._state = State.IDLE
                self.acknowledge(v, kind, sender, m.MAV_MISSION_ERROR)
                v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: Req. WP was unexpected\t")
                return
            self._seq = seq + 1
            current = int(kind is MissionType.MISSION and seq == v.current_item)
            item = self.items[kind][seq]
            self.send_item(v, kind, sender, seq, item, as_float=not self._int_mode, current=current)

    def _on_clear(self, v: ListOwner, kind: MissionType, sender: Sender) -> None:
        if self._state is not State.IDLE:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "WPM: IGN CLEAR CMD: Busy\t")
            return
        self._kind, self._partner = kind, sender
        self.keep(kind, [])
        self.acknowledge(v, kind, sender, m.MAV_MISSION_ACCEPTED)

    def _on_ack(self, v: ListOwner, kind: MissionType, result: int, sender: Sender, now: float) -> None:
        if sender != self._partner:
            v.tx.say(m.MAV_SEVERITY_CRITICAL, "REJ. WP CMD: partner id mismatch\t")
        elif self._state is State.TAKING and result == m.MAV_MISSION_UNSUPPORTED:
            # handle_mission_ack: the partner (MAVSDK) does not know this kind of request; it gets the other one
            self._int_mode = not self._int_mode
            self._ask(v, now)
        elif (self._state is State.GIVING and kind is self._kind) or result == m.MAV_MISSION_OPERATION_CANCELLED:
            self._state = State.IDLE


def refusal_of(kind: MissionType, item: MissionItem) -> int:
    """MAV_MISSION_RESULT of PX4's own look at an item."""
    if item.frame in (GLOBAL, RELATIVE_ALT):
        known = item.command in RULES.with_place
    elif item.frame == MISSION_FRAME:
        known = item.command in RULES.without_place
    else:
        return m.MAV_MISSION_UNSUPPORTED_FRAME
    if not known:
        return m.MAV_MISSION_UNSUPPORTED
    fenced = item.command in FENCE_COMMANDS
    if kind is MissionType.MISSION and (fenced or item.command == mav_cmd.NAV_RALLY_POINT):
        return m.MAV_MISSION_ERROR
    corner = item.command in (mav_cmd.NAV_FENCE_POLYGON_VERTEX_INCLUSION, mav_cmd.NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
    circle = item.command in (mav_cmd.NAV_FENCE_CIRCLE_INCLUSION, mav_cmd.NAV_FENCE_CIRCLE_EXCLUSION)
    if kind is MissionType.FENCE and (not (fenced or circle) or (corner and (item.params[0] or 0) < 3)):
        return m.MAV_MISSION_ERROR
    return m.MAV_MISSION_ACCEPTED
