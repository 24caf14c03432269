"""Admission of third-party traffic into one radio: from ground stations and programs that do not know its 500 B/s.

They were made for links on which another request costs nothing. Each frame of theirs is judged once, on its way to the
radio's queue: it is sent as what it is (an order, an emergency, anything else), replaces an older one, waits for a
turn, or is refused. docs/explanation/airtime.md has the rules and their reasons.

Pure: the channel's sender calls `judge` for each frame, reports what comes down, and sends what `poll` gives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.radio_link.admission_frames import MAX_HZ, Kind, ThirdPartyFrame
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.radio_link.turn_gate import FILE_SILENCE_S, LONGEST_FILE_S, ParameterListGate, TurnGate
from skygcs.core.token_bucket import TokenBucket

THIRD_PARTY_SHARE = 0.5
"""Part of the uplink for all third-party traffic; the other half is ours whatever others do."""

CORRECTIONS_SHARE = 0.4
"""Part of the uplink for RTCM corrections, counted apart: 200 of 500 B/s, the observations of one constellation."""

BURST_S = 1.0
LEAST_BURST_BYTES = 280.0
"""Burst that third-party traffic may save up: one second of its rate, and no less than the longest frame."""

PER_VEHICLE_HZ, PER_VEHICLE_BURST = 2.0, 3.0
"""Orders, and as many emergencies, of one source to one vehicle; further ones have a lower priority."""

RATE_BURST = 1.5
"""Messages that a source may save up of a message with a rate: enough for a stream that jitters."""

ORDERS_SHARE = 0.5
ORDERS_BURST_BYTES = 900.0
"""The part of the third-party share that may go as orders. The burst is twenty orders of 45 B: one for each vehicle of
a large network."""

EMERGENCIES_BURST_BYTES = 64 * 45.0
"""Burst of emergencies; their rate is that of all third-party traffic."""

MAX_SOURCES = 64
"""Sources with rates of their own; further ones share those of one."""

OTHERS = -1
"""Key shared by all sources beyond the limit."""

SOURCE_GONE_S = 30.0
"""A source silent for so long has gone: a ground station's heartbeats come every second."""

REPORT_AFTER, REPORT_AFTER_S = 5, 2.0
"""Frames left out, and over how long, before a rate is reported: a station that connects sends some of everything at
once, which is no rate."""

MAX_NOTES = 64


@dataclass(frozen=True, slots=True)
class ThirdPartyRules:
    """Rules of a fleet file for third-party traffic. None: the shares above."""

    param_lists: Literal["one", "deny", "allow"] = "one"
    files: Literal["one", "deny", "allow"] = "one"
    streams: Literal["deny", "allow"] = "deny"
    logs: Literal["deny", "allow"] = "deny"
    rates_hz: Mapping[int, float] = field(default_factory=dict)
    """By message id, of each source; 0: none at all."""
    bytes_per_s: float | None = None
    corrections_bytes_per_s: float | None = None


class AdmissionDecision(NamedTuple):
    """Decision about a frame. "send": offer it to the queue so; "wait": `poll` gives it later."""

    outcome: Literal["send", "wait", "refuse", "correction"]
    priority: Priority = Priority.FORWARDED
    key: Hashable | None = None
    flow: Hashable = None
    answer_bytes: int = 0
    """Charged to the share beside the frame itself, when it is sent in the last class."""


REFUSED = AdmissionDecision("refuse")


class Note(NamedTuple):
    """The first time that something became of a source's frames: ``kind`` is streams, logs, param_lists, files or rate
    (refused), thinned (sent too often), held (a list behind another) or turn (a file while another vehicle's comes)."""

    kind: str
    source: int
    target: int
    msgid: int
    hz: float
    """With "thinned": how often they came."""


IsWaiting = Callable[[Priority, Hashable, Hashable], bool]
"""True if an entry of this class, flow and key is in the radio's queue."""


class _Source:
    """One program or ground station, identified by its frames."""

    __slots__ = ("buckets", "changes", "counts", "heard_at", "key", "late", "reported", "serial", "thinned")

    def __init__(self, key: int, now: float) -> None:
        self.key = key
        self.heard_at = now
        self.counts: dict[str, int] = {}
        self.buckets: dict[Hashable, TokenBucket] = {}
        """By message id with a rate, and by vehicle."""
        self.changes: dict[int, tuple[Hashable, int]] = {}
        """Last change per vehicle, with its serial: an equal change counts as a repeat of this one only."""
        self.serial = 0
        self.late: dict[int, Hashable] = {}
        """By vehicle, the key of the last order that went in the last class: later ones must not overtake it."""
        self.thinned: dict[int, tuple[int, float]] = {}
        """By message id with a rate, how many were left out since when."""
        self.reported: set[tuple[str, int]] = set()

    def count(self, what: str, number: int = 1) -> None:
        self.counts[what] = self.counts.get(what, 0) + number

    def take(self, key: Hashable, hz: float, burst: float, now: float) -> bool:
        """True if the rate of this key allows one more."""
        bucket = self.buckets.get(key)
        if bucket is None:
            bucket = self.buckets[key] = TokenBucket(hz, burst, now)
        return bucket.take(now)

    def key_of(self, frame: ThirdPartyFrame) -> Hashable:
        """Return what a repeat of it has in common with it. A change is repeated only if nothing else was changed in
        between: on, off, on are three."""
        if not frame.is_change:
            return frame.identity
        identity, number = self.changes.get(frame.target, (None, 0))
        if identity != frame.identity:
            self.serial = number = self.serial + 1
            self.changes[frame.target] = frame.identity, number
        return (*frame.identity, number)

    def status(self, now: float) -> dict[str, Any]:
        """Return what became of its frames; JSON-able."""
        counts = dict(sorted(self.counts.items()))
        return {
            "source": "others" if self.key == OTHERS else f"{self.key >> 8}/{self.key & 0xFF}",
            "age_s": round(now - self.heard_at, 1),
            "sent": counts.pop("sent", 0),
            "sent_bytes": counts.pop("sent_bytes", 0),
            "counts": counts,
        }


class ThirdPartyTraffic:
    """One radio's. ``budget`` is the share of all third-party traffic; the queue charges it for the last class."""

    def __init__(self, rules: ThirdPartyRules, bytes_per_s: float, now: float) -> None:
        """``bytes_per_s``: what goes up into the radio altogether."""
        self.rules = rules
        self.own_sysid: int | None = None
        """Ours, while our own heartbeat goes into this radio."""
        self._unplanned: frozenset[int] = frozenset()
        """See `set_unplanned`."""
        self.lists = ParameterListGate()
        self.files = TurnGate(FILE_SILENCE_S, LONGEST_FILE_S)
        self.notes: deque[Note] = deque(maxlen=MAX_NOTES)
        self.budget = TokenBucket(1.0, LEAST_BURST_BYTES, now)
        self._orders = TokenBucket(1.0, ORDERS_BURST_BYTES, now)
        self._emergencies = TokenBucket(1.0, EMERGENCIES_BURST_BYTES, now)
        self._sources: dict[int, _Source] = {}
        self.set_rate(bytes_per_s, now)

    def set_rate(self, bytes_per_s: float, now: float) -> None:
        """Share ``bytes_per_s``, which goes up into the radio altogether from now on."""
        third_party = THIRD_PARTY_SHARE * bytes_per_s if self.rules.bytes_per_s is None else self.rules.bytes_per_s
        self.budget.set_rate(third_party, now)
        self.budget.set_burst(max(LEAST_BURST_BYTES, BURST_S * third_party), now)
        self._orders.set_rate(ORDERS_SHARE * third_party, now)
        self._emergencies.set_rate(third_party, now)

    # -- up

    def set_unplanned(self, sysids: Iterable[int]) -> None:
        """Systems without a stream plan: ground stations may set their streams."""
        self._unplanned = frozenset(sysids)

    def judge(self, frame: Frame, now: float, is_waiting: IsWaiting) -> AdmissionDecision:
        """Decide what becomes of one frame. Never raises. An order or emergency is charged to `budget` at once."""
        third_party = ThirdPartyFrame.of(frame)
        source = self._source(third_party.source, now)
        decision = self._decide(third_party, source, now, is_waiting)
        if decision.outcome == "send":
            source.count("sent")
            source.count("sent_bytes", third_party.size)
        return decision

    def poll(self, now: float) -> tuple[Frame, AdmissionDecision] | None:
        """A parameter list whose turn has come, to be offered to the queue."""
        listed = self.lists.due(now, lambda source: self._is_there(source, now))
        if listed is None:
            return None
        source = self._sources.get(listed.source) or self._source(OTHERS, now, heard=False)
        source.count("sent")
        source.count("sent_bytes", listed.size)
        return listed.frame, self._begin_list(listed, now)

    def next_poll(self, now: float) -> float | None:
        """When `poll` may give something; None: not before something comes."""
        return self.lists.next_at(now)

    @property
    def waiting(self) -> int:
        """Parameter lists that wait."""
        return len(self.lists.waiting)

    def clear(self) -> int:
        """Drop all waiting frames (the link went down); return their number."""
        return self.lists.clear()

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
            "bytes_per_s": round(self.budget.rate, 1),
            "param_lists": {"rule": self.rules.param_lists, **self.lists.status(now)},
            "files": {"rule": self.rules.files, "running": self.files.running(now)},
            "streams": self.rules.streams,
            "logs": self.rules.logs,
            "waiting": self.waiting,
            "sources": [source.status(now) for source in self._sources.values()],
        }

    # -- the rules

    def _decide(self, frame: ThirdPartyFrame, source: _Source, now: float, is_waiting: IsWaiting) -> AdmissionDecision:
        if frame.kind is Kind.EMERGENCY:
            return self._admit_emergency(frame, source, now, is_waiting)
        if (refusal := self._refusal(frame, source, now)) is not None:
            return refusal
        # kinds with a way of their own
        match frame.kind:
            case Kind.CORRECTION:
                source.count("corrections")
                return AdmissionDecision("correction")
            case Kind.PARAMETER_LIST if self.rules.param_lists == "one":
                return self._admit_list(frame, source, now)
            case Kind.ORDER:
                return self._admit_order(frame, source, now, is_waiting)
            case Kind.STREAM:
                key: Hashable = ("newest", frame.source, frame.msgid, frame.target, frame.component)
                return AdmissionDecision("send", key=key, flow=source.key)
        # the last class, where a repeat takes the place of what still waits
        key = source.key_of(frame)
        if is_waiting(Priority.FORWARDED, source.key, key):
            source.count("repeated")
        return AdmissionDecision("send", key=key, flow=source.key, answer_bytes=frame.answer_bytes)

    def _refusal(self, frame: ThirdPartyFrame, source: _Source, now: float) -> AdmissionDecision | None:
        """Refuse what the rules do not allow at all, another vehicle's turn, and what comes too often."""
        rules, kind, hz = self.rules, frame.kind, self.rules.rates_hz.get(frame.msgid, MAX_HZ.get(frame.msgid))
        if hz is not None and hz <= 0:
            return self._refuse("rate", frame, source)
        if frame.msgid == HEARTBEAT and frame.source >> 8 == self.own_sysid:
            source.count("needless")  # ours goes anyway, and vehicles distinguish stations by system (airtime.md)
            return REFUSED
        if kind is Kind.LOG and rules.logs == "deny":
            return self._refuse("logs", frame, source)
        if kind is Kind.STREAM_RATE and rules.streams == "deny" and frame.target not in self._unplanned:
            return self._refuse("streams", frame, source)
        if kind is Kind.PARAMETER_LIST and (
            rules.param_lists == "deny" or (rules.param_lists == "one" and not frame.target)
        ):
            return self._refuse("param_lists", frame, source)  # of all vehicles at once: as many lists
        if kind in (Kind.FILE, Kind.FILE_END) and rules.files == "deny":
            return self._refuse("files", frame, source)
        if kind is Kind.FILE and rules.files == "one" and not self.files.enter(frame.target, now):
            return self._refuse("turn", frame, source)
        if hz is not None and not source.take(frame.msgid, hz, RATE_BURST, now):
            source.count("thinned")
            self._note_thinned(frame, source, hz, now)
            return REFUSED
        return None

    def _admit_list(self, frame: ThirdPartyFrame, source: _Source, now: float) -> AdmissionDecision:
        match self.lists.ask(frame, now):
            case "send":
                return self._begin_list(frame, now)
            case "hold":
                source.count("held")
                self._note("held", frame, source, 0.0)
            case "repeat":
                source.count("repeated")
        return AdmissionDecision("wait")

    def _begin_list(self, frame: ThirdPartyFrame, now: float) -> AdmissionDecision:
        """Before all that waits in the last class, in which its turn could end before the request is sent."""
        self.budget.spend(frame.size, now)
        return AdmissionDecision("send", Priority.PROTOCOL, frame.identity, frame.target)

    def _admit_emergency(
        self, frame: ThirdPartyFrame, source: _Source, now: float, is_waiting: IsWaiting
    ) -> AdmissionDecision:
        key = ("stop", frame.source, frame.command)
        urgent = AdmissionDecision("send", Priority.EMERGENCY, key, frame.target)
        if is_waiting(Priority.EMERGENCY, frame.target, key):
            source.count("repeated")
            return urgent
        allowed = source.take(("stop", frame.target), PER_VEHICLE_HZ, PER_VEHICLE_BURST, now)
        if allowed and self._charge(self._emergencies, frame, now):
            return urgent
        # beyond its rate it goes as an order, before those that follow it, and then as anything else
        source.count("slowed")
        if self._charge(self._orders, frame, now):
            return AdmissionDecision("send", Priority.COMMAND, key, frame.target)
        source.late[frame.target] = late = (*key, frame.target)
        return AdmissionDecision("send", key=late, flow=source.key)

    def _admit_order(
        self, frame: ThirdPartyFrame, source: _Source, now: float, is_waiting: IsWaiting
    ) -> AdmissionDecision:
        key = source.key_of(frame)
        order = AdmissionDecision("send", Priority.COMMAND, key, frame.target)
        later = AdmissionDecision("send", key=key, flow=source.key)
        for known in (order, later):
            if is_waiting(known.priority, known.flow, key):
                source.count("repeated")
                return known
        overtakes = is_waiting(Priority.FORWARDED, source.key, source.late.get(frame.target))
        allowed = not overtakes and source.take(("order", frame.target), PER_VEHICLE_HZ, PER_VEHICLE_BURST, now)
        if allowed and self._charge(self._orders, frame, now):
            return order
        source.late[frame.target] = key
        source.count("slowed")
        return later

    def _charge(self, part: TokenBucket, frame: ThirdPartyFrame, now: float) -> bool:
        """True if this part of the share pays for the frame; if so the whole share is charged as well."""
        if not part.take(now, frame.size):
            return False
        self.budget.spend(frame.size, now)
        return True

    def _refuse(self, kind: str, frame: ThirdPartyFrame, source: _Source) -> AdmissionDecision:
        source.count(f"refused_{kind}")
        self._note(kind, frame, source, 0.0)
        return REFUSED

    # -- reports

    def _note_thinned(self, frame: ThirdPartyFrame, source: _Source, hz: float, now: float) -> None:
        """``hz``: how many of them go; those are not among the ones left out, which are counted here."""
        if frame.msgid == HEARTBEAT:
            return  # every station sends one a second, and need not change that
        number, since = source.thinned.get(frame.msgid, (0, now))
        source.thinned[frame.msgid] = number + 1, since
        if number + 1 >= REPORT_AFTER and now - since >= REPORT_AFTER_S:
            self._note("thinned", frame, source, hz + number / (now - since))

    def _note(self, kind: str, frame: ThirdPartyFrame, source: _Source, hz: float) -> None:
        mark = (kind, frame.msgid if kind in ("rate", "thinned") else 0)
        if mark not in source.reported and len(source.reported) < MAX_NOTES:
            source.reported.add(mark)
            self.notes.append(Note(kind, frame.source, frame.target, frame.msgid, hz))

    # -- sources

    def _source(self, key: int, now: float, *, heard: bool = True) -> _Source:
        source = self._sources.get(key)
        if source is None:
            full = key != OTHERS and len(self._sources) - (OTHERS in self._sources) >= MAX_SOURCES
            if full and not self._forget_one(now):
                return self._source(OTHERS, now, heard=heard)
            source = self._sources[key] = _Source(key, now)
        if heard:
            source.heard_at = now
        return source

    def _forget_one(self, now: float) -> bool:
        """Forget a source that has gone, if there is one."""
        for key, source in self._sources.items():
            if key != OTHERS and now - source.heard_at > 2 * SOURCE_GONE_S:
                del self._sources[key]
                return True
        return False

    def _is_there(self, key: int, now: float) -> bool:
        source = self._sources.get(key) or self._sources.get(OTHERS)
        return source is not None and now - source.heard_at <= SOURCE_GONE_S
