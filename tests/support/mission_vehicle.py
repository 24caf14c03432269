"""Scripted autopilots that store missions as ArduPilot and PX4 do, and a bad network, all in the test's own time.

Independent of the simulated vehicles: what a vehicle answers to items that come twice, late, or for somebody else is
written here from the two autopilots' documented behaviour.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from skygcs.core.mavlink.frame import encode_payload
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.mission.item import MissionItem
from skygcs.core.protocols.base import Effect, ProgressReport, Send
from skygcs.core.protocols.mission import ANSWERS, MissionProtocol
from support.frames import dialect
from support.param_vehicle import Delays, Network

Reply = tuple[str, dict[str, Any], int]
"""(message, fields, opaque id, which pymavlink's dialects lack)."""


def opaque_of(items: list[MissionItem]) -> int:
    """Some number that differs with the content."""
    return (hash(tuple(items)) & 0x7FFFFFFF) | 1


@dataclass
class MissionVehicle:
    """What both autopilots share; ``capacity`` items, ``refuses`` item by number with a MAV_MISSION_RESULT."""

    items: list[MissionItem] = field(default_factory=list)
    capacity: int = 1000
    refuses: dict[int, int] = field(default_factory=dict)
    old_requests: bool = False
    kind: int = 0
    receiving: bool = False
    expected: int = 0
    want: int = 0
    heard_at: float = 0.0
    asked_at: float = 0.0
    cancelled: bool = False
    now: float = 0.0

    RETRY_S = 1.0
    GIVE_UP_S = 8.0

    def hear(self, message: str, fields: Mapping[str, Any]) -> list[Reply]:
        if fields["mission_type"] != self.kind:
            return []
        match message:
            case "MISSION_COUNT":
                return self.on_count(fields["count"])
            case "MISSION_ITEM_INT":
                return self.on_item(fields["seq"], MissionItem.from_fields(fields))
            case "MISSION_REQUEST_LIST":
                return self.on_list()
            case "MISSION_REQUEST_INT":
                return self.on_wanted(fields["seq"])
            case "MISSION_CLEAR_ALL":
                return self.on_clear()
            case "MISSION_ACK":
                return self.on_ack(fields["type"])
        raise AssertionError(message)

    def tick(self) -> list[Reply]:
        if not self.receiving:
            return []
        if self.now - self.heard_at > self.GIVE_UP_S:
            return self.gave_up()
        return self.ask() if self.now - self.asked_at >= self.RETRY_S else []

    def ask(self) -> list[Reply]:
        self.asked_at = self.now
        return [("MISSION_REQUEST" if self.old_requests else "MISSION_REQUEST_INT", {"seq": self.want}, 0)]

    def ack(self, result: int) -> list[Reply]:
        return [("MISSION_ACK", {"type": result}, opaque_of(self.items) if result == 0 and self.items else 0)]

    def begin(self, count: int) -> list[Reply]:
        self.receiving, self.expected, self.want, self.heard_at = True, count, 0, self.now
        return self.ask()

    def count(self) -> list[Reply]:
        return [("MISSION_COUNT", {"count": len(self.items)}, opaque_of(self.items) if self.items else 0)]

    def item(self, seq: int) -> list[Reply]:
        return [("MISSION_ITEM_INT", {**self.items[seq].values(), "seq": seq}, 0)]


class ArduPilotMission(MissionVehicle):
    """Writes item over item; says INVALID_SEQUENCE of what it did not ask for and ERROR of what comes afterwards."""

    def on_count(self, count: int) -> list[Reply]:
        if count > self.capacity:
            return self.ack(4)
        del self.items[count:]
        return self.begin(count)

    def on_item(self, seq: int, item: MissionItem) -> list[Reply]:
        if not self.receiving:
            return self.ack(1)
        if seq != self.want:
            return self.ack(13)
        if seq in self.refuses:
            self.receiving = False
            return self.ack(self.refuses[seq])
        self.items[seq : seq + 1] = [item]
        self.want, self.heard_at = seq + 1, self.now
        if self.want < self.expected:
            return self.ask()
        self.receiving = False
        return self.ack(0)

    def gave_up(self) -> list[Reply]:
        self.receiving = False
        return self.ack(15)

    def on_list(self) -> list[Reply]:
        return self.ack(14) if self.receiving else self.count()

    def on_wanted(self, seq: int) -> list[Reply]:
        return self.item(seq) if seq < len(self.items) else self.ack(1)

    def on_clear(self) -> list[Reply]:
        if self.receiving:
            return self.ack(14)
        self.items.clear()
        return self.ack(0)

    def on_ack(self, result: int) -> list[Reply]:
        self.cancelled = self.cancelled or result == 15
        return []


class Px4Mission(MissionVehicle):
    """Keeps the old mission until the new one is whole; answers only the next item and the one before it. A request of
    another ends the transfer, said once; what is requested after the end has no answer (mavlink_mission.cpp)."""

    RETRY_S = 0.25
    GIVE_UP_S = 5.0

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        self.new: list[MissionItem] = []
        self.sending: int | None = None

    def on_count(self, count: int) -> list[Reply]:
        if self.receiving:
            return self.ask() if self.want == 0 else []
        if self.sending is not None:
            return self.ack(1)
        if count > self.capacity:
            return self.ack(4)
        self.new = []
        return self.begin(count)

    def on_item(self, seq: int, item: MissionItem) -> list[Reply]:
        if not self.receiving:
            return self.ack(1)
        if seq != self.want:
            return []
        if seq in self.refuses:
            self.receiving = False
            return self.ack(self.refuses[seq])
        self.new.append(item)
        self.want, self.heard_at = seq + 1, self.now
        if self.want < self.expected:
            return self.ask()
        self.receiving = False
        self.items = self.new
        return self.ack(0)

    def gave_up(self) -> list[Reply]:
        self.receiving = False
        return []

    def tick(self) -> list[Reply]:
        if self.sending is not None and self.now - self.heard_at > self.GIVE_UP_S:
            self.sending = None
        return super().tick()

    def on_list(self) -> list[Reply]:
        if self.receiving:
            return []
        self.sending, self.heard_at = (0 if self.items else None), self.now
        return self.count()

    def on_wanted(self, seq: int) -> list[Reply]:
        if self.sending is None:
            return []
        if seq not in (self.sending, self.sending - 1) or seq >= len(self.items):
            self.sending = None
            return self.ack(1)
        self.sending, self.heard_at = seq + 1, self.now
        return self.item(seq)

    def on_clear(self) -> list[Reply]:
        if self.receiving or self.sending is not None:
            return []
        self.items = []
        return self.ack(0)

    def on_ack(self, result: int) -> list[Reply]:
        self.cancelled = self.cancelled or result == 15
        self.sending = None
        if result == 15:
            self.receiving = False
        return []


TICK_S = 0.05


class MissionRig(Delays):
    """One exchange, one vehicle, the network between them. `run` returns when the exchange is done."""

    def __init__(
        self, exchange: MissionProtocol, vehicle: MissionVehicle, net: Network | None = None, seed: int = 1
    ) -> None:
        super().__init__(net or Network(), seed)
        self.exchange, self.vehicle = exchange, vehicle
        self.reports: list[int | None] = []
        self.sent: list[tuple[str, Mapping[str, Any]]] = []
        self._parsers = {True: FrameParser(dialect()), False: FrameParser(dialect())}

    def run(self, until: Callable[[], bool] | None = None, limit_s: float = 3600.0) -> MissionRig:
        """From start to the exchange's end, or to ``until``."""
        end = self.now + limit_s
        self._carry_out(self.exchange.start(self.now))
        while not self.exchange.done and not (until is not None and until()):
            assert self.now < end, "the exchange does not end"
            self.step()
        return self

    def settle(self, for_s: float = 30.0) -> MissionRig:
        """Let what is still on its way arrive, and the vehicle end what it waits for."""
        end = self.now + for_s
        while self.now < end:
            self.step()
        return self

    def step(self) -> None:
        self.now += TICK_S
        self.vehicle.now = self.now
        while self._queue and self._queue[0][0] <= self.now:  # answered at the end of the tick
            heapq.heappop(self._queue)[2]()
        self._reply(self.vehicle.tick())
        deadline = self.exchange.deadline
        if deadline is not None and self.now >= deadline:
            self._carry_out(self.exchange.on_timer(self.now))

    def _arrive(self, raw: bytes, *, up: bool) -> None:
        parser = self._parsers[up]
        pieces = [raw[i : i + 1] for i in range(len(raw))] if self.network.bytewise else [raw]
        for frame in [f for piece in pieces for f in parser.feed(piece)]:
            if up:
                self._reply(self.vehicle.hear(frame.name, frame.fields()))
            elif frame.name in ANSWERS:
                self._carry_out(self.exchange.on_message(frame.name, frame.fields(), frame.payload, self.now))

    def _carry_out(self, effects: tuple[Effect, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                self.sent.append((effect.message, effect.values))
                self._wire(effect.message, effect.values, 0, up=True)
            elif isinstance(effect, ProgressReport):
                self.reports.append(effect.percent)

    def _reply(self, replies: list[Reply]) -> None:
        for message, fields, number in replies:
            self._wire(message, {**fields, "mission_type": self.vehicle.kind}, number, up=False)

    def _wire(self, message: str, fields: Mapping[str, Any], number: int, *, up: bool) -> None:
        info = dialect().by_name[message]
        payload = info.pack(fields) + (number.to_bytes(4, "little") if number else b"")
        raw = encode_payload(info, payload, sysid=1, compid=1, seq=0)
        self._through(lambda: self._arrive(raw, up=up))
