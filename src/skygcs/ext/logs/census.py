"""Count what is in a log: records, messages, sources, vehicles, faults."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import TYPE_GENERIC, HeartbeatChecks
from skygcs.core.mavlink.modes import SAFETY_ARMED, family, mode_name
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.tlog.format import LogEntry
from skygcs.tlog.reading import LogFaults

MOST_KINDS = 8
"""Different (autopilot, type) of one source's heartbeats that are counted; more are an attack."""

MOST_MODES = 100
"""Different modes of one vehicle that are listed: ArduPilot's and PX4's have 55 at most. A custom mode has 32 bits."""


@dataclass(slots=True)
class SeenVehicle:
    """One vehicle by its heartbeats. Times in seconds from the first record, None in a raw capture."""

    sysid: int
    compid: int
    first_s: float | None
    last_s: float | None = None
    autopilot: int = 0
    type: int = 0
    heartbeats: int = 0
    modes: list[str] = field(default_factory=list)
    armed: bool = False

    def on_heartbeat(self, frame: Frame, elapsed_s: float | None) -> None:
        fields = frame.fields()
        self.last_s = elapsed_s
        self.heartbeats += 1
        self.autopilot, self.type = fields["autopilot"], fields["type"]
        base_mode = fields.get("base_mode", 0)
        self.armed = self.armed or bool(base_mode & SAFETY_ARMED)
        mode = mode_name(self.autopilot, self.type, base_mode, fields.get("custom_mode", 0))
        if len(self.modes) < MOST_MODES and mode not in self.modes:
            self.modes.append(mode)

    def as_dict(self, source: _Source, dialect: Dialect) -> dict[str, Any]:
        return {
            "sysid": self.sysid,
            "compid": self.compid,
            "autopilot": family(self.autopilot),
            "type": _name("MAV_TYPE", self.type, dialect),
            "first_s": _rounded(self.first_s),
            "last_s": _rounded(self.last_s),
            "heartbeats": self.heartbeats,
            "modes": self.modes,
            "armed": self.armed,
            "lost": source.stats.lost,
            "loss_ratio": round(source.stats.loss_ratio, 4),
            "conflicting": source.conflicting(self.autopilot, self.type, dialect),
        }


class _Source:
    """The frames of one system and component."""

    __slots__ = ("count", "kinds", "stats")

    def __init__(self, sysid: int, compid: int) -> None:
        self.count = 0
        self.stats = SourceStats(sysid, compid)
        self.kinds: Counter[tuple[int, int]] = Counter()
        """Heartbeats by autopilot and type."""

    def on_heartbeat(self, frame: Frame) -> None:
        fields = frame.fields()
        kind = fields.get("autopilot", 0), fields.get("type", 0)
        if kind in self.kinds or len(self.kinds) < MOST_KINDS:
            self.kinds[kind] += 1

    def conflicting(self, autopilot: int, kind: int, dialect: Dialect) -> list[dict[str, Any]]:
        """Heartbeats with these ids from another sender: another program, or another vehicle."""
        return [
            {
                "autopilot": _name("MAV_AUTOPILOT", a, dialect),
                "type": _name("MAV_TYPE", t, dialect),
                "heartbeats": count,
            }
            for (a, t), count in self.kinds.most_common()
            if (a, t) != (autopilot, kind) and (a, t) != (autopilot, TYPE_GENERIC)  # not configured yet
        ]


class Census:
    """Counts of one log; ``as_dict`` is the JSON answer of `tlog info`."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self.verdicts: Counter[str] = Counter()
        self.signed = 0
        self.duration_s: float | None = None
        self._types: Counter[str] = Counter()
        self._sources: dict[int, _Source] = {}
        self._vehicles: dict[int, SeenVehicle] = {}
        self._heartbeats = HeartbeatChecks()

    def add(self, entry: LogEntry) -> None:
        """The next entry, in the file's order."""
        self.verdicts[entry.verdict] += 1
        elapsed_s = None if entry.unix_us is None else entry.at_s
        self.duration_s = elapsed_s
        frame = entry.frame
        if frame is None:
            return
        self.signed += frame.signed
        key = frame.sysid << 8 | frame.compid
        source = self._sources.get(key)
        if source is None:
            source = self._sources[key] = _Source(frame.sysid, frame.compid)
        source.stats.on_frame(frame.seq, len(entry.raw), entry.at_s)
        if frame.info is None:
            return
        source.count += 1
        self._types[frame.name] += 1
        own = self._heartbeats.own(frame, entry.at_s)
        if frame.msgid == HEARTBEAT:
            source.on_heartbeat(frame)
            if own:
                vehicle = self._vehicles.get(key)
                if vehicle is None:
                    vehicle = self._vehicles[key] = SeenVehicle(frame.sysid, frame.compid, elapsed_s)
                vehicle.on_heartbeat(frame, elapsed_s)

    def as_dict(self, faults: LogFaults) -> dict[str, Any]:
        """``faults`` as the reader of the entries counted them."""
        counts = sorted(((s.count, k) for k, s in self._sources.items() if s.count), key=lambda found: -found[0])
        bad_crc = faults.bad_crc.count
        return {
            "records": self.verdicts["ok"] + self.verdicts["unknown"] + bad_crc,
            "ok": self.verdicts["ok"],
            "bad_crc": bad_crc,
            "unknown": self.verdicts["unknown"],
            "signed": self.signed,
            "skipped_bytes": faults.skipped_bytes,
            "backwards": faults.out_of_order,
            "most_backwards_s": faults.most_backwards_us / 1e6,
            "clock_steps": faults.clock_steps.count,
            "duration_s": _rounded(self.duration_s),
            "sources": {f"{key >> 8}/{key & 0xFF}": count for count, key in counts},
            "types": dict(self._types.most_common()),
            "vehicles": [
                self._vehicles[key].as_dict(self._sources[key], self.dialect) for key in sorted(self._vehicles)
            ],
        }


def _name(enum: str, value: int, dialect: Dialect) -> str:
    return dialect.enums.get(enum, {}).get(value, str(value)).removeprefix(f"{enum}_")


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 1)
