"""`skygcs-cli tlog info FILE…`: what is in a tlog or a raw capture. Needs no daemon."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skygcs.cli.log_file import KIND_NAMES, Progress, dialect_named, mapped, no_mavlink
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.modes import SAFETY_ARMED, family, mode_name
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.tlog import ByteSource, RecordReader, sniff
from skygcs.core.vehicle.discovery import HEARTBEAT, discovers
from skygcs.errors import SkygcsError

RAW_PIECE_BYTES = 1 << 16


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

    def as_dict(self, dialect: Dialect) -> dict[str, Any]:
        kind = dialect.enums.get("MAV_TYPE", {}).get(self.type, str(self.type))
        return {
            "sysid": self.sysid,
            "compid": self.compid,
            "autopilot": family(self.autopilot),
            "type": kind.removeprefix("MAV_TYPE_"),
            "first_s": _rounded(self.first_s),
            "last_s": _rounded(self.last_s),
            "heartbeats": self.heartbeats,
            "modes": self.modes,
            "armed": self.armed,
        }


class Census:
    """Counts of one file; ``as_dict`` is the JSON answer."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self.verdicts: Counter[str] = Counter()
        self.skipped_bytes = 0
        self.duration_s: float | None = None
        self._types: Counter[str] = Counter()
        self._sources: Counter[int] = Counter()
        self._vehicles: dict[int, SeenVehicle] = {}

    def read_tlog(self, data: ByteSource, advance: Progress) -> None:
        reader = RecordReader(data, self.dialect)
        for record in reader:
            self.verdicts[record.verdict] += 1
            self.duration_s = record.elapsed_s
            if record.verdict == "ok" and record.frame is not None:
                self._on_good(record.frame, record.elapsed_s)
            advance(record.offset)
        self.skipped_bytes = reader.skipped_bytes

    def read_raw(self, data: ByteSource, advance: Progress) -> None:
        parser = FrameParser(self.dialect)
        for start in range(0, len(data), RAW_PIECE_BYTES):
            self._on_frames(parser.feed(data[start : start + RAW_PIECE_BYTES]))
            advance(start)
        self._on_frames(parser.finish())
        stats = parser.stats
        self.verdicts = Counter(ok=stats.good, bad_crc=stats.bad_crc, unknown=stats.unknown)
        self.skipped_bytes = stats.skipped_bytes

    def as_dict(self) -> dict[str, Any]:
        sources = {f"{key >> 8}/{key & 0xFF}": count for key, count in self._sources.most_common()}
        return {
            "records": sum(self.verdicts.values()),
            "ok": self.verdicts["ok"],
            "bad_crc": self.verdicts["bad_crc"],
            "unknown": self.verdicts["unknown"],
            "skipped_bytes": self.skipped_bytes,
            "duration_s": _rounded(self.duration_s),
            "sources": sources,
            "types": dict(self._types.most_common()),
            "vehicles": [self._vehicles[key].as_dict(self.dialect) for key in sorted(self._vehicles)],
        }

    def _on_frames(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.info is not None:
                self._on_good(frame, None)

    def _on_good(self, frame: Frame, elapsed_s: float | None) -> None:
        key = frame.sysid << 8 | frame.compid
        self._sources[key] += 1
        self._types[frame.name] += 1
        if frame.msgid == HEARTBEAT and discovers(frame):
            vehicle = self._vehicles.get(key)
            if vehicle is None:
                vehicle = self._vehicles[key] = SeenVehicle(frame.sysid, frame.compid, elapsed_s)
            vehicle.on_heartbeat(frame, elapsed_s)


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
    with mapped(file) as data:
        kind = sniff(data, table) or ("tlog" if file.suffix == ".tlog" else None)
        census = Census(table)
        progress = Progress(data)
        try:
            if kind == "tlog":
                census.read_tlog(data, progress)
            elif kind == "raw":
                census.read_raw(data, progress)
        finally:
            progress.stop()
    answer = census.as_dict()
    if not answer["records"]:
        raise no_mavlink(file)
    return KIND_NAMES["tlog" if kind == "tlog" else "raw"], answer


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
    if answer["vehicles"]:
        table = Table("vehicle", "autopilot", "type", "heard, s", "armed", box=box.SIMPLE_HEAD)
        table.add_column("modes", overflow="fold")
        for v in answer["vehicles"]:
            heard = "" if v["first_s"] is None else f"{v['first_s']:.1f} to {v['last_s']:.1f}"
            row = (f"{v['sysid']}/{v['compid']}", v["autopilot"], v["type"], heard, "yes" if v["armed"] else "no")
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
