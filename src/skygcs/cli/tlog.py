"""`skygcs-cli tlog info FILE…`: what is in a tlog or a raw capture. Needs no daemon."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skygcs.cli.log_file import KIND_NAMES, dialect_named, opened_log
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.heartbeat import TYPE_GENERIC, HeartbeatChecks
from skygcs.core.mavlink.modes import SAFETY_ARMED, family, mode_name
from skygcs.core.mavlink.msgids import HEARTBEAT
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.errors import SkygcsError
from skygcs.tlog.faults import LogFaults
from skygcs.tlog.reading import LogEntry

MOST_KINDS = 8
"""Different (autopilot, type) of one source's heartbeats that are told apart; more are an attack."""


@dataclass(slots=True)
class SeenVehicle:
    """What the heartbeats of one vehicle told. Times in seconds from the first record, None in a raw capture."""

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
        if mode not in self.modes:
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
    """What one system and component sent."""

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
        """Heartbeats under these ids that are of something else: another program's, or another vehicle's."""
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
    """Counts of one file; ``as_dict`` is the JSON answer."""

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


def tlog_infos(files: Sequence[Path], json_output: bool, dialect: str | None, fail: Callable[[str], None]) -> int:
    """Print what is in each file; 0 if all of them are good. JSON is a list, each answer with its "file".

    A file that cannot be read or holds no MAVLink is told to ``fail``, and does not keep the others from being shown.
    """
    if len(files) == 1:
        return tlog_info(files[0], json_output, dialect)
    table = dialect_named(dialect)
    answers = []
    for file in files:
        try:
            kind, answer = _counted(file, table)
        except SkygcsError as error:
            fail(str(error))
            continue
        answers.append({"file": str(file), **answer})
        if not json_output:
            _show(file, kind, answer)
    if json_output:
        print(json.dumps(answers, indent=1))
    return int(len(answers) < len(files))


def tlog_info(file: Path, json_output: bool = False, dialect: str | None = None) -> int:
    """Print what is in ``file``; 0. Raises SkygcsError for a file that cannot be read or holds no MAVLink."""
    kind, answer = _counted(file, dialect_named(dialect))
    if json_output:
        print(json.dumps(answer, indent=1))
    else:
        _show(file, kind, answer)
    return 0


def _counted(file: Path, table: Dialect) -> tuple[str, dict[str, Any]]:
    """What kind of file it is, and what is in it."""
    census = Census(table)
    with opened_log(file, table) as log:
        for entry in log.entries():
            census.add(entry)
    return KIND_NAMES[log.kind], census.as_dict(log.faults)


def _name(enum: str, value: int, dialect: Dialect) -> str:
    return dialect.enums.get(enum, {}).get(value, str(value)).removeprefix(f"{enum}_")


def _rounded(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds, 1)


def _show(file: Path, kind: str, answer: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(soft_wrap=True)
    duration = "" if answer["duration_s"] is None else f", {answer['duration_s']:.1f} s"
    console.print(f"[bold]{escape(file.name)}[/bold]: {kind}, {answer['records']} records{duration}", highlight=False)
    console.print(
        f"{answer['ok']} good, {answer['bad_crc']} with a wrong CRC, {answer['unknown']} of unknown id, "
        f"{answer['skipped_bytes']} bytes skipped",
        highlight=False,
    )
    for line in _remarks(answer):
        console.print(escape(line), highlight=False)
    if answer["vehicles"]:
        table = Table("vehicle", "autopilot", "type", "heard, s", "armed", "lost", box=box.SIMPLE_HEAD)
        table.add_column("modes", overflow="fold")
        for v in answer["vehicles"]:
            heard = "" if v["first_s"] is None else f"{v['first_s']:.1f} to {v['last_s']:.1f}"
            armed, lost = "yes" if v["armed"] else "no", f"{100 * v['loss_ratio']:.1f} %"
            row = (f"{v['sysid']}/{v['compid']}", v["autopilot"], v["type"], heard, armed, lost)
            table.add_row(*row, "\n".join(v["modes"]))
        console.print(table)
    else:
        console.print("no vehicle")
    for title, counts in (("source", answer["sources"]), ("message", answer["types"])):
        table = Table(title, box=box.SIMPLE_HEAD)
        table.add_column("frames", justify="right")
        for name, count in counts.items():
            table.add_row(name, str(count))
        console.print(table)


def _remarks(answer: dict[str, Any]) -> list[str]:
    """What is out of the ordinary, a line each."""
    lines = []
    if answer["signed"]:
        lines.append(f"{answer['signed']} signed frames (whether the signatures are right is not looked at)")
    if answer["backwards"]:
        lines.append(f"the time goes backwards {answer['backwards']}×, by up to {_span(answer['most_backwards_s'])}")
    if answer["clock_steps"]:
        lines.append(f"the clock steps by more than a day {answer['clock_steps']}×")
    for v in answer["vehicles"]:
        others = ", ".join(f"{c['heartbeats']} of {c['autopilot']} {c['type']}" for c in v["conflicting"])
        if others:
            lines.append(f"conflicting heartbeats under {v['sysid']}/{v['compid']}: {others}")
    return lines


def _span(seconds: float) -> str:
    return f"{1000 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.1f} s"
