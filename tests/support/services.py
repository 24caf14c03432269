"""What objects of the runtime are given in unit tests: links with set properties, a recorder, a fleet that listens."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.routing_table import RouteNote
from skygcs.core.routing.source_statistics import LinkFacts
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.param_cache import ParamCache
from skygcs.runtime.recorder import Recorder
from skygcs.runtime.route_reports import RouteReports
from skygcs.runtime.undo_journal import UndoJournal
from skygcs.runtime.vehicle_services import VehicleServices
from support.inline_disk import inline_disk


class KnownLinks:
    """Links with the properties that a test sets; without limits until then."""

    def __init__(self) -> None:
        self.bytes_per_s = math.inf
        self.broadcast = True
        self.heard: Mapping[str, LinkFacts] = {}
        self.replayed: set[int] = set()
        self.held: Callable[[Hashable], bool] = lambda key: False
        """True for the key of a message that still waits to be sent."""

    def setpoint_bytes_per_s(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> float:
        return self.bytes_per_s

    def facts(self, key: int, now: float) -> Mapping[str, LinkFacts]:
        return self.heard

    def holds(self, vehicle: Vehicle, priority: Priority, key: Hashable) -> bool:
        return self.held(key)

    def may_broadcast(self) -> bool:
        return self.broadcast

    def is_replayed(self, key: int) -> bool:
        return key in self.replayed

    def stream_refusal(self, vehicle: Vehicle, flown: Callable[[], Iterable[Vehicle]]) -> str | None:
        return None

    def why_silent(self, vehicle: Vehicle) -> str:
        return ""

    def radio_to(self, vehicle: Vehicle) -> str | None:
        return None

    def channels_to(self, vehicle: Vehicle) -> tuple[int, ...]:
        return ()

    def links_to(self, vehicle: Vehicle) -> frozenset[str]:
        return frozenset()

    def uplink_lost(self, key: int) -> None:
        pass

    def counts_on(self, key: int, channel_id: int) -> Mapping[int, int] | None:
        return None

    def forget_flows(self) -> None:
        pass

    def authority_refusal(self, sysid: int) -> str | None:
        return None


def services(
    dialect: Dialect,
    send: Any,
    loop: asyncio.AbstractEventLoop,
    on_event: Callable[[Event], None],
    *,
    own: tuple[int, int] = (255, 25),
    links: KnownLinks | None = None,
    log_dir: Path = Path("logs"),
    param_cache: ParamCache | None = None,
) -> VehicleServices:
    return VehicleServices(
        own,
        dialect,
        send,
        loop,
        on_event,
        links or KnownLinks(),
        list,
        param_cache or ParamCache(None),
        UndoJournal(log_dir / "undo"),
        inline_disk(loop, on_event),
        log_dir=log_dir,
    )


class ListeningFleet:
    """Gets the frames of vehicles from a hub; ``on_frame`` may raise."""

    def __init__(self, on_frame: Callable[[int, Frame, str, float], None]) -> None:
        self.on_frame = on_frame
        self.changed: list[int] = []

    def source_changed(self, key: int) -> None:
        self.changed.append(key)

    def state_update_only(self, key: int, frame: Frame, label: str) -> None:
        return None

    def known(self, key: int) -> None:
        return None

    def replaced(self, key: int) -> None:
        pass

    def may_fly(self, key: int) -> bool:
        return False

    def vehicles_of(self, sysid: int) -> list[Vehicle]:
        return []


class Notes:
    """Gets a hub's notes as a RouteReports does."""

    def __init__(self, on_note: Callable[[RouteNote, Channel | None], None]) -> None:
        self._on_note = on_note

    def on_note(self, note: RouteNote, channel: Channel | None, present: Channel | None) -> None:
        self._on_note(note, channel)

    def on_key(self, sysid: int, channel: Channel) -> None:
        pass


def connect(
    hub: Hub,
    on_frame: Callable[[int, Frame, str, float], None] = lambda key, frame, label, now: None,
    on_note: Callable[[RouteNote, Channel | None], None] = lambda note, channel: None,
) -> ListeningFleet:
    fleet = ListeningFleet(on_frame)
    hub.connect(cast(Fleet, fleet), cast(RouteReports, Notes(on_note)))
    return fleet


class ListRecorder:
    """Hands each record to a function."""

    def __init__(self, record: Callable[[bytes, int], None], record_many: Callable[[bytes, int], None]) -> None:
        self.offer = record
        self.offer_many = record_many


def list_recorder(
    record: Callable[[bytes, int], None], record_many: Callable[[bytes, int], None] = lambda records, count: None
) -> Recorder:
    return cast(Recorder, ListRecorder(record, record_many))
