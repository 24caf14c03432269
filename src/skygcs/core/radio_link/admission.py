"""What others may send into one radio: ground stations and programs that know nothing of its 500 bytes a second.

They were made for links on which another request costs nothing. Each frame of theirs is looked at once, on its way to
the radio's queue: it goes as what it is (an order, an emergency, anything else), takes the place of an older one,
waits for its turn, or is refused. docs/explanation/airtime.md says which and why.

Pure: the channel's sender asks `judge` about each frame, tells what comes down, and sends what `poll` gives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from skygcs.core.mavlink.dialect import MessageInfo
from skygcs.core.mavlink.msgids import FILE_TRANSFER_PROTOCOL, GPS_RTCM_DATA, HEARTBEAT, PARAM_REQUEST_LIST
from skygcs.core.radio_link.admission_frames import (
    LOGS,
    NEWEST_ONLY,
    RateClass,
    ThirdPartyFrame,
    asks_for_streams,
    command_of,
    is_emergency,
    is_order,
    parse,
    rate_class_of,
)
from skygcs.core.radio_link.admission_sources import OTHERS, Bucket, Line, Source
from skygcs.core.radio_link.file_turns import FileTurns
from skygcs.core.radio_link.list_turns import Asked, ParamLists
from skygcs.core.radio_link.transmit_queue import ByteBudget, Priority

THIRD_PARTY_SHARE = 0.5
"""Of what goes up into the radio, for all third-party traffic; the other half is ours whatever others do."""

CORRECTIONS_SHARE = 0.4
"""The same for RTCM corrections, which are counted apart: of 500 B/s 200, the observations of one constellation."""

BURST_S = 1.0
LEAST_BURST_BYTES = 280.0
"""What third-party traffic may save up: a second's worth, and no less than the longest frame."""

ORDER_HZ, ORDER_BURST = 2.0, 3.0
"""Orders of one source to one vehicle that go as orders; further ones go as anything else does."""

ORDERS_SHARE = 0.5
ORDERS_BURST_BYTES = 900.0
"""The part of the third-party share that may go as orders. The burst is twenty orders of 45 B: one for each vehicle of
a large network."""

EMERGENCY_HZ, EMERGENCY_BURST = 2.0, 3.0
EMERGENCIES_BURST_BYTES = 64 * 45.0
"""The same of emergencies, with as many bytes a second as all third-party traffic. Those beyond it go all the same: as
orders or, beyond what those have, as anything forwarded does."""

MAX_SOURCES = 64
"""Sources told apart; what further ones send counts as that of one."""

SOURCE_GONE_S = 30.0
"""A source silent for so long is not waited for: a ground station's heartbeats come every second."""

MAX_WAITING, MAX_WAITING_OF_ONE = 512, 64
"""Frames that wait for their source's turn. More are dropped, the oldest first: whoever asked has asked again."""

TELL_AFTER, TELL_AFTER_S = 5, 2.0
"""Frames left out, and over how long, before it is told that somebody sends too many: a station that connects sends
some of everything at once, which is no rate."""

MAX_NOTES = 64

Outcome = Literal["send", "wait", "refuse", "correction"]


@dataclass(frozen=True, slots=True)
class ThirdPartyRules:
    """What a fleet file says of third-party traffic. None: the shares above."""

    param_lists: Literal["one", "deny", "allow"] = "one"
    files: Literal["one", "deny", "allow"] = "one"
    streams: Literal["deny", "allow"] = "deny"
    logs: Literal["deny", "allow"] = "deny"
    rates_hz: Mapping[int, float] = field(default_factory=dict)
    """By message id, of each source; 0: none at all."""
    bytes_per_s: float | None = None
    corrections_bytes_per_s: float | None = None


class AdmissionDecision(NamedTuple):
    """What becomes of a frame. "send": offer it to the queue so; "wait": `poll` gives it later."""

    outcome: Outcome
    priority: Priority = Priority.FORWARDED
    key: Hashable | None = None
    flow: Hashable = None


class Released(NamedTuple):
    """A frame that has waited long enough."""

    raw: bytes
    admission: AdmissionDecision


class Note(NamedTuple):
    """The first time that something became of a source's frames: ``kind`` is streams, logs, param_lists, files or rate
    (refused), thinned (sent too often), held (a list behind another) or turn (a file while another vehicle's comes)."""

    kind: str
    source: int
    target: int
    msgid: int
    hz: float
    """Of thinned: how often they came."""


StillWaits = Callable[[Priority, Hashable, Hashable], bool]
"""Whether an entry of this class, flow and key is in the radio's queue."""


class ThirdPartyTraffic:
    """One radio's. ``budget`` is the share that all third-party traffic has; whoever sends keeps to it."""

    def __init__(
        self, rules: ThirdPartyRules, messages: Mapping[int, MessageInfo], bytes_per_s: float, now: float
    ) -> None:
        """``bytes_per_s``: what goes up into the radio altogether; ``messages``: of the dialect, by id."""
        self.rules = rules
        self.own_sysid: int | None = None
        """Ours, while our own heartbeat goes into this radio."""
        self.unplanned: frozenset[int] = frozenset()
        """Systems whose streams nobody plans: others may set them."""
        self.lists = ParamLists()
        self.files = FileTurns()
        self.notes: deque[Note] = deque(maxlen=MAX_NOTES)
        self.budget = ByteBudget(1.0, LEAST_BURST_BYTES, now)
        self._orders = ByteBudget(1.0, ORDERS_BURST_BYTES, now)
        self._stops = ByteBudget(1.0, EMERGENCIES_BURST_BYTES, now)
        self._messages = messages
        self._sources: dict[int, Source] = {}
        self._waiting = 0
        self.set_rate(bytes_per_s, now)

    def set_rate(self, bytes_per_s: float, now: float) -> None:
        """What goes up into the radio altogether has changed."""
        third_party = THIRD_PARTY_SHARE * bytes_per_s if self.rules.bytes_per_s is None else self.rules.bytes_per_s
        self.budget.set_rate(third_party, now)
        self.budget.set_burst(max(LEAST_BURST_BYTES, BURST_S * third_party), now)
        self._orders.set_rate(ORDERS_SHARE * third_party, now)
        self._stops.set_rate(third_party, now)

    # -- up

    def judge(self, raw: bytes, now: float, still_waits: StillWaits) -> AdmissionDecision:
        """What becomes of one frame. Never raises, whatever the bytes are. An order or emergency is charged at once;
        of the rest the queue charges `budget` when it sends."""
        frame = parse(raw, self._messages)
        if frame is None:
            self._source(OTHERS, now).count("malformed")
            return AdmissionDecision("refuse")
        source = self._source(frame.source, now)
        admission = self._ruled(frame, source, now, still_waits)
        if admission.outcome == "send":
            source.count("sent")
            source.count("sent_bytes", len(raw))
        return admission

    def poll(self, now: float) -> list[Released]:
        """Frames whose turn has come, to be offered to the queue."""
        released: list[Released] = []
        listed = self.lists.due(now, lambda source: self._is_there(source, now))
        if listed is not None:
            asker = self._sources.get(listed.source) or self._source(OTHERS, now, heard=False)
            released.append(self._released(asker, listed.identity, listed))
        if self._waiting:
            for source in self._sources.values():
                for line in source.lines.values():
                    while line.frames and line.bucket.take(now):
                        key = next(iter(line.frames))
                        released.append(self._released(source, key, line.frames.pop(key)))
                        self._waiting -= 1
        return released

    def next_poll(self, now: float) -> float | None:
        """When `poll` gives something; None: not before something comes."""
        times = [] if (listed := self.lists.next_at(now)) is None else [listed]
        if self._waiting:
            lines = (line for source in self._sources.values() for line in source.lines.values() if line.frames)
            times += [line.bucket.ready_at(now) for line in lines]
        return min(times, default=None)

    @property
    def waiting(self) -> int:
        """Frames that wait here."""
        return self._waiting + len(self.lists.waiting)

    def clear(self) -> int:
        """Forget what waits (the link went down); how many those were."""
        gone, self._waiting = self._waiting, 0
        for source in self._sources.values():
            for line in source.lines.values():
                line.frames.clear()
        return gone + self.lists.clear()

    # -- down

    def on_param_value(self, system: int, component: int, index: int, count: int, now: float) -> None:
        """A PARAM_VALUE came from the radio."""
        self.lists.heard(system, component, index, count, now)

    def on_file_part(self, system: int, now: float) -> None:
        """A FILE_TRANSFER_PROTOCOL came from the radio."""
        self.files.heard(system, now)

    def status(self, now: float) -> dict[str, Any]:
        """Rules, what waits, and what became of each source's frames; JSON-able."""
        return {
            "bytes_per_s": round(self.budget.bytes_per_s, 1),
            "param_lists": {"rule": self.rules.param_lists, **self.lists.status(now)},
            "files": {"rule": self.rules.files, "running": self.files.running(now)},
            "streams": self.rules.streams,
            "logs": self.rules.logs,
            "waiting": self.waiting,
            "sources": [source.status(now) for source in self._sources.values()],
        }

    # -- the rules

    def _ruled(self, frame: ThirdPartyFrame, source: Source, now: float, still_waits: StillWaits) -> AdmissionDecision:
        msgid = frame.msgid
        if self.rules.rates_hz.get(msgid, 1.0) <= 0 and not is_emergency(frame):
            return self._refused("rate", frame, source)
        if msgid == GPS_RTCM_DATA:
            source.count("corrections")
            return AdmissionDecision("correction")
        if msgid == HEARTBEAT and frame.source >> 8 == self.own_sysid:
            source.count("needless")  # ours goes anyway, and vehicles tell stations apart by system (airtime.md)
            return AdmissionDecision("refuse")
        if msgid in LOGS and self.rules.logs == "deny":
            return self._refused("logs", frame, source)
        if asks_for_streams(frame) and self.rules.streams == "deny" and frame.target not in self.unplanned:
            return self._refused("streams", frame, source)
        if msgid == PARAM_REQUEST_LIST and self.rules.param_lists != "allow":
            return self._listed(frame, source, now)
        if msgid == FILE_TRANSFER_PROTOCOL and self.rules.files != "allow":
            if self.rules.files == "deny":
                return self._refused("files", frame, source)
            if not self.files.may(frame, now):
                return self._refused("turn", frame, source)
        if is_emergency(frame):
            return self._stopped(frame, source, now, still_waits)
        if is_order(frame) and msgid not in self.rules.rates_hz:
            return self._ordered(frame, source, now, still_waits)
        rate_class = rate_class_of(frame, self.rules.rates_hz)
        if msgid in NEWEST_ONLY or msgid == HEARTBEAT:
            newest = ("newest", frame.source, msgid, frame.target, frame.component)
            admission = AdmissionDecision("send", key=newest, flow=source.key)
        else:
            admission = AdmissionDecision("send", key=source.key_of(frame), flow=source.key)
            if still_waits(Priority.FORWARDED, admission.flow, admission.key):
                source.count("repeated")
                return admission
        return admission if rate_class is None else self._allotted(frame, rate_class, admission, source, now)

    def _allotted(
        self, frame: ThirdPartyFrame, rate_class: RateClass, admission: AdmissionDecision, source: Source, now: float
    ) -> AdmissionDecision:
        line = source.lines.get(rate_class.group)
        if line is None:
            line = source.lines[rate_class.group] = Line(Bucket(rate_class.hz, rate_class.burst, now))
        if not line.frames and line.bucket.take(now):
            return admission
        if not rate_class.waits:
            source.count("thinned")
            self._note_thinned(frame, source, rate_class.hz, now)
            return AdmissionDecision("refuse")
        if admission.key in line.frames:
            source.count("repeated")
            line.frames[admission.key] = frame
            return AdmissionDecision("wait")
        if self._waiting >= MAX_WAITING or source.waiting >= MAX_WAITING_OF_ONE:
            if not line.frames:
                source.count("dropped")
                return AdmissionDecision("refuse")
            del line.frames[next(iter(line.frames))]
            self._waiting -= 1
            source.count("dropped")
        line.frames[admission.key] = frame
        self._waiting += 1
        source.count("slowed")
        return AdmissionDecision("wait")

    def _listed(self, frame: ThirdPartyFrame, source: Source, now: float) -> AdmissionDecision:
        if self.rules.param_lists == "deny" or not frame.target:  # to all at once is as many lists as vehicles
            return self._refused("param_lists", frame, source)
        match self.lists.ask(frame, now):
            case Asked.SEND:
                return AdmissionDecision("send", key=frame.identity, flow=source.key)
            case Asked.HOLD:
                source.count("held")
                self._note("held", frame, source, 0.0)
                return AdmissionDecision("wait")
            case Asked.SWALLOW:
                source.count("repeated")
                return AdmissionDecision("wait")

    def _stopped(
        self, frame: ThirdPartyFrame, source: Source, now: float, still_waits: StillWaits
    ) -> AdmissionDecision:
        key = ("stop", frame.source, command_of(frame))
        urgent = AdmissionDecision("send", Priority.EMERGENCY, key, frame.target)
        if still_waits(Priority.EMERGENCY, frame.target, key):
            source.count("repeated")
            return urgent
        bucket = source.stops.setdefault(frame.target, Bucket(EMERGENCY_HZ, EMERGENCY_BURST, now))
        if bucket.take(now) and self._charged(self._stops, frame, now):
            return urgent
        source.count("slowed")
        if self._charged(self._orders, frame, now):
            return AdmissionDecision("send", Priority.COMMAND, key, frame.target)  # before the orders that follow it
        source.late[frame.target] = late = (*key, frame.target)
        return AdmissionDecision("send", key=late, flow=source.key)

    def _ordered(
        self, frame: ThirdPartyFrame, source: Source, now: float, still_waits: StillWaits
    ) -> AdmissionDecision:
        key = source.key_of(frame)
        order = AdmissionDecision("send", Priority.COMMAND, key, frame.target)
        later = AdmissionDecision("send", key=key, flow=source.key)
        for known in (order, later):
            if still_waits(known.priority, known.flow, key):
                source.count("repeated")
                return known
        bucket = source.orders.setdefault(frame.target, Bucket(ORDER_HZ, ORDER_BURST, now))
        overtakes = still_waits(Priority.FORWARDED, source.key, source.late.get(frame.target))
        if not overtakes and bucket.take(now) and self._charged(self._orders, frame, now):
            return order
        source.late[frame.target] = key
        source.count("slowed")
        return later

    def _charged(self, part: ByteBudget, frame: ThirdPartyFrame, now: float) -> bool:
        """Whether the frame goes at the cost of this part, and so of all third-party traffic."""
        size = len(frame.raw)
        if part.saved(now) < size:
            return False
        part.spend(size, now)
        self.budget.spend(size, now)
        return True

    def _refused(self, kind: str, frame: ThirdPartyFrame, source: Source) -> AdmissionDecision:
        source.count(f"refused_{kind}")
        self._note(kind, frame, source, 0.0)
        return AdmissionDecision("refuse")

    # -- telling

    def _note_thinned(self, frame: ThirdPartyFrame, source: Source, hz: float, now: float) -> None:
        """``hz``: how many of them go; those are not among the ones left out, which are counted here."""
        if frame.msgid == HEARTBEAT:
            return  # every station sends one a second, and nobody is to change that
        number, since = source.thinned.get(frame.msgid, (0, now))
        source.thinned[frame.msgid] = number + 1, since
        if number + 1 >= TELL_AFTER and now - since >= TELL_AFTER_S:
            self._note("thinned", frame, source, hz + number / (now - since))

    def _note(self, kind: str, frame: ThirdPartyFrame, source: Source, hz: float) -> None:
        mark = (kind, frame.msgid if kind in ("rate", "thinned") else 0)
        if mark not in source.told and len(source.told) < MAX_NOTES:
            source.told.add(mark)
            self.notes.append(Note(kind, frame.source, frame.target, frame.msgid, hz))

    # -- sources

    def _source(self, key: int, now: float, *, heard: bool = True) -> Source:
        source = self._sources.get(key)
        if source is None:
            full = key != OTHERS and len(self._sources) - (OTHERS in self._sources) >= MAX_SOURCES
            if full and not self._forget_one(now):
                return self._source(OTHERS, now, heard=heard)
            source = self._sources[key] = Source(key, now)
        if heard:
            source.heard_at = now
        return source

    def _forget_one(self, now: float) -> bool:
        """One that is gone and has nothing waiting, if there is one."""
        for key, source in self._sources.items():
            if key != OTHERS and now - source.heard_at > 2 * SOURCE_GONE_S and not source.waiting:
                del self._sources[key]
                return True
        return False

    def _is_there(self, key: int, now: float) -> bool:
        source = self._sources.get(key) or self._sources.get(OTHERS)
        return source is not None and now - source.heard_at <= SOURCE_GONE_S

    @staticmethod
    def _released(source: Source, key: Hashable, frame: ThirdPartyFrame) -> Released:
        source.count("sent")
        source.count("sent_bytes", len(frame.raw))
        return Released(frame.raw, AdmissionDecision("send", key=key, flow=source.key))
