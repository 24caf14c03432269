"""The onboard logs of one vehicle: lists them, and writes them to the daemon's log folder, resuming what is there.

The protocol is `log_protocol`; here it meets the link and the disk. Chunks are written by a thread,
because a slow card can block for seconds.
"""

from __future__ import annotations

import asyncio
import os
import re
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from skygcs.config.files import LOG_MODE, make_log_folder
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import LOG_DATA, LOG_ENTRY
from skygcs.core.protocols.base import Chunk, Effect, ProgressReport, Send
from skygcs.core.protocols.command import Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.gate import standing
from skygcs.disk_writer import WriterThread
from skygcs.events import Event
from skygcs.ext.onboard_logs.log_protocol import BLOCK_BYTES, LogInfo, LogOutcome, OnboardLogDownload, OnboardLogList
from skygcs.runtime.loop_clock import DeadlineTimer
from skygcs.runtime.vehicle_actor import SHUTDOWN, VehicleActor
from skygcs.runtime.vehicle_services import VehiclePart

LOGS = standing("logs")

NEEDED = ("LOG_REQUEST_LIST", "LOG_ENTRY", "LOG_REQUEST_DATA", "LOG_DATA", "LOG_REQUEST_END")

MAX_WAITING_CHUNKS = 64
"""3 MB that wait for the disk; then the download stops, to be resumed."""

PROGRESS_EVERY_S = 2.0

FOLDER = "onboard"
"""In daemon.log_dir."""

PART_SUFFIX = ".part"

RADIO_BYTES_PER_S = 500.0
"""Bytes a second of LOG_DATA that half of a shared radio carries at best: for an estimate in the refusal."""


@dataclass(frozen=True, slots=True)
class StoredLog:
    """A log on disk. ``resumed_at``: bytes of it that were there before."""

    id: int
    path: Path
    size_bytes: int
    resumed_at: int


@dataclass(frozen=True, slots=True)
class LogsOutcome:
    """The outcome of a list or a download. ``logs``: what the vehicle listed; ``files``: what is on disk now."""

    ok: bool
    result: str
    message: str
    logs: tuple[LogInfo, ...] = ()
    files: tuple[StoredLog, ...] = ()
    sent: int = 0
    elapsed_s: float = 0.0

    @classmethod
    def without_logs(cls, outcome: Outcome) -> Self:
        """The outcome of an order that did not reach the logs."""
        return cls(outcome.ok, outcome.result, outcome.message)

    def as_dict(self) -> dict[str, Any]:
        """Fields of an `Outcome`, with the logs."""
        return {
            "ok": self.ok,
            "result": self.result,
            "message": self.message,
            "attempts": self.sent,
            "elapsed_s": round(self.elapsed_s, 3),
            "status_texts": [],
            "logs": [
                {"id": log.id, "size_bytes": log.size_bytes, "time_unix_s": log.time_unix_s or None}
                for log in self.logs
            ],
            "files": [
                {"id": f.id, "path": str(f.path), "size_bytes": f.size_bytes, "resumed_at": f.resumed_at}
                for f in self.files
            ],
        }


class VehicleLogs(VehiclePart):
    """Onboard logs of one vehicle, one transfer at a time. Failures are outcomes, not exceptions."""

    messages = frozenset({LOG_ENTRY, LOG_DATA})

    def __init__(self, actor: VehicleActor) -> None:
        self._vehicle = actor.vehicle
        services = self._services = actor.services
        self._loop = services.loop
        self._able = all(name in services.dialect.by_name for name in NEEDED)
        self._machine: OnboardLogList | OnboardLogDownload | None = None
        self._ended = asyncio.Event()
        self._busy = False
        self._taken = 0
        self._chunks: deque[Chunk] = deque()
        self._disk = WriterThread("onboard logs")
        self._some = asyncio.Event()
        self._reported_at = float("-inf")
        self._timer = DeadlineTimer(services.loop, self._on_timer)

    # -- what the actor calls

    def on_frame(self, frame: Frame, now: float) -> None:
        machine = self._machine
        if machine is None or frame.info is None:
            return
        if frame.msgid == LOG_DATA and isinstance(machine, OnboardLogDownload):
            payload = frame.payload.ljust(97, b"\0")  # ofs, id, count, data
            offset, log_id = int.from_bytes(payload[:4], "little"), int.from_bytes(payload[4:6], "little")
            count = min(payload[6], BLOCK_BYTES)
            self._apply(machine.on_data(log_id, offset, payload[7 : 7 + count], now))
        elif frame.msgid == LOG_ENTRY and isinstance(machine, OnboardLogList):
            values = frame.fields()
            info = LogInfo(int(values["id"]), int(values["size"]), int(values["time_utc"]))
            self._apply(machine.on_entry(info, int(values["num_logs"]), now))

    def on_armed(self) -> None:
        self.stop("cancelled", "it was armed; the same command goes on when it is disarmed")

    def stop(self, result: str, text: str) -> None:
        if self._machine is not None:
            self._apply(self._machine.stop(self._loop.time(), result, text))

    async def wind_down(self) -> None:
        self.stop("cancelled", SHUTDOWN)

    def close(self, reason: str) -> None:
        self.stop("cancelled", reason)

    # -- orders

    async def list(self) -> LogsOutcome:
        """The logs that the vehicle has."""
        started = self._loop.time()
        refusal = self._refusal()
        if refusal is not None:
            return LogsOutcome(False, "refused", f"refused: {refusal}")
        self._busy = True
        try:
            return await self._listed(started)
        finally:
            self._busy = False

    async def get(self, wanted: Sequence[int] | str, *, force: bool = False) -> LogsOutcome:
        """Write logs to disk: "latest", "all", or those of these ids. ``force``: over a radio, too."""
        started = self._loop.time()
        refusal = self._refusal()
        if refusal is not None:
            return LogsOutcome(False, "refused", f"refused: {refusal}")
        self._busy = True
        try:
            listed = await self._listed(started)
            if not listed.ok:
                return listed
            chosen, unknown = _chosen(listed.logs, wanted)
            if unknown:
                known = ", ".join(str(log.id) for log in listed.logs[-10:]) or "none"
                text = f"refused: it has no log {', '.join(map(str, unknown))}; the newest: {known}"
                return LogsOutcome(False, "refused", text, listed.logs)
            radio = self._services.links.radio_to(self._vehicle)
            if radio is not None and not force:
                return LogsOutcome(False, "refused", f"refused: {_radio_text(radio, chosen)}", listed.logs)
            return await self._get_all(chosen, listed, started, shared=radio is not None)
        finally:
            self._busy = False

    def _refusal(self) -> str | None:
        if not self._able:
            return f"dialect {self._services.dialect.name} has no messages for onboard logs"
        if self._busy:
            return "a transfer of its logs is in progress"
        return self._unfit()

    def _unfit(self) -> str | None:
        """Why no transfer may begin with the vehicle as it is now."""
        vehicle = self._vehicle
        if vehicle.replayed:
            return "it is heard only in a recording"
        if vehicle.duplicate:
            return f"two vehicles with system id {vehicle.sysid} are on the air; give one of them another"
        if not vehicle.connected:
            return "the vehicle is lost: nothing is heard from it"
        if vehicle.armed:
            return "it is armed: its card is needed for the log of this flight, and an ArduPilot sends none then"
        return None

    async def _listed(self, started: float) -> LogsOutcome:
        machine = OnboardLogList()
        outcome = await self._run(machine)
        logs = tuple(machine.entries[n] for n in sorted(machine.entries))
        elapsed_s = self._loop.time() - started
        return LogsOutcome(outcome.ok, outcome.result, outcome.message, logs, (), machine.sent, elapsed_s)

    async def _get_all(
        self, chosen: Sequence[LogInfo], listed: LogsOutcome, started: float, *, shared: bool
    ) -> LogsOutcome:
        files: list[StoredLog] = []
        sent = listed.sent
        ok, result, message = True, "accepted", "it has no logs"
        for info in chosen:
            outcome, file, more = await self._get_one(info, shared=shared)
            sent += more
            if file is not None:
                files.append(file)
            ok, result, message = outcome.ok, outcome.result, outcome.message
            if not ok:
                message = f"log {info.id}: {message}"
                break
        if ok and files:
            total = sum(file.size_bytes for file in files)
            message = f"{len(files)} logs, {total:,} bytes, in {files[0].path.parent}"
        self._report(f"onboard logs: {message}", {"state": "done", "ok": ok})
        return LogsOutcome(ok, result, message, listed.logs, tuple(files), sent, self._loop.time() - started)

    async def _get_one(self, info: LogInfo, *, shared: bool) -> tuple[LogOutcome, StoredLog | None, int]:
        """The outcome, the whole file, and the messages sent."""
        file = _File(self._services.log_dir / FOLDER / _safe(self._vehicle.name), info, self._vehicle.family)
        try:
            begin = await self._loop.run_in_executor(self._disk, file.open)
        except OSError as error:
            return LogOutcome(False, "failed", f"{file.path}: {error.strerror or error}"), None, 0
        except asyncio.CancelledError:
            self._close(file)  # the thread goes on, and would open it for nobody
            raise
        if begin is None:
            text = f"{file.path} is there already"
            return (
                LogOutcome(True, "accepted", text),
                StoredLog(info.id, file.path, info.size_bytes, info.size_bytes),
                0,
            )
        if (why := self._unfit()) is not None:  # since: `stop` ends only what is in progress
            await self._close(file)
            return LogOutcome(False, "refused", f"refused: {why}"), None, 0
        # read it from where the file ends, and write beside that
        machine = OnboardLogDownload(info, begin=begin, shared=shared)
        self._chunks.clear()
        writing = self._loop.create_task(self._write(file, machine), name=f"onboard log of {self._vehicle.name}")
        try:
            outcome = await self._run(machine)
            self._some.set()
            written = await writing
        finally:
            writing.cancel()
            await asyncio.shield(self._close(file))
        # what the disk said comes first: the vehicle has sent all the same
        if written is not None:
            outcome = LogOutcome(False, "failed", written)
        if not outcome.ok:
            return outcome, None, machine.sent
        try:
            await self._loop.run_in_executor(self._disk, file.finish)
        except OSError as error:
            return LogOutcome(False, "failed", f"{file.path}: {error.strerror or error}"), None, machine.sent
        return outcome, StoredLog(info.id, file.path, machine.size, begin), machine.sent

    def _close(self, file: _File) -> asyncio.Future[None]:
        """Close the file, in a thread, as that waits for a write in progress."""
        return self._loop.run_in_executor(self._disk, file.close)

    async def _write(self, file: _File, machine: OnboardLogDownload) -> str | None:
        """Write chunks until the machine is done; the reason if the disk does not take them."""
        while True:
            await self._some.wait()
            self._some.clear()
            while self._chunks:
                chunk = self._chunks.popleft()
                try:
                    await self._loop.run_in_executor(self._disk, file.write, chunk)
                except OSError as error:
                    text = f"{file.path}: {error.strerror or error}"
                    self._apply(machine.stop(self._loop.time(), "failed", text))
                    return text
            if machine.done:
                return None

    # -- the machine in progress

    async def _run(self, machine: OnboardLogList | OnboardLogDownload) -> LogOutcome:
        self._machine = machine
        self._ended.clear()
        self._taken = 0
        self._apply(machine.start(self._loop.time()))
        try:
            await self._ended.wait()
        except asyncio.CancelledError:
            self._apply(machine.stop(self._loop.time(), "cancelled", "cancelled"))
            raise
        finally:
            self._machine = None
            self._timer.set(None)
        assert machine.outcome is not None
        if machine.outcome.result == "timeout" and not self._taken:
            return LogOutcome(False, "lost", "could not be sent: no link leads to it")
        return machine.outcome

    def _apply(self, effects: Sequence[Effect]) -> None:
        machine = self._machine
        if machine is None:
            return
        for effect in effects:
            if isinstance(effect, Send):
                self._transmit(effect)
            elif isinstance(effect, Chunk):
                self._chunks.append(effect)
                self._some.set()
            elif isinstance(effect, ProgressReport) and isinstance(machine, OnboardLogDownload):
                self._report_progress(machine)
        if len(self._chunks) > MAX_WAITING_CHUNKS and not machine.done:
            self._apply(machine.stop(self._loop.time(), "failed", "the disk is too slow; the same command goes on"))
            return
        self._timer.set(machine.deadline)
        if machine.done:
            self._ended.set()

    def _transmit(self, effect: Send) -> None:
        sysid, compid = self._vehicle.sysid, self._vehicle.compid
        values = {**effect.values, "target_system": sysid, "target_component": compid}
        info = self._services.dialect.by_name[effect.message]
        self._taken += self._services.send(info, values, sysid, compid, Priority.PROTOCOL, clearance=LOGS)

    def _on_timer(self) -> None:
        if self._machine is not None:
            self._apply(self._machine.on_timer(self._loop.time()))

    def _report_progress(self, machine: OnboardLogDownload) -> None:
        now = self._loop.time()
        if now - self._reported_at >= PROGRESS_EVERY_S:
            self._reported_at = now
            percent = 100 * machine.received // max(machine.size, 1)
            data = {"log": machine.info.id, "received": machine.received, "size_bytes": machine.size}
            text = f"onboard log {machine.info.id}: {percent} % of {machine.size:,} bytes"
            self._report(text, {"state": "under_way", "percent": percent, **data})

    def _report(self, text: str, data: dict[str, Any]) -> None:
        self._services.on_event(Event("onboard_log", self._vehicle.name, self._vehicle.sysid, text, data))


@dataclass
class _File:
    """One log on disk, on threads: a part until it is whole. Its name has the log's time and size, so that only the
    same log is resumed. The lock keeps `close` from taking the descriptor from a `write` whose caller was cancelled,
    and an `open` that is done only after `close` from keeping one."""

    folder: Path
    info: LogInfo
    family: str
    path: Path = field(init=False)

    def __post_init__(self) -> None:
        suffix = {"px4": ".ulg", "ardupilot": ".bin"}.get(self.family, ".log")
        begun = "undated"
        if self.info.time_unix_s:
            begun = f"{datetime.fromtimestamp(self.info.time_unix_s, UTC):%Y%m%dT%H%M%SZ}"
        self.path = self.folder / f"{self.info.id:04d}-{begun}-{self.info.size_bytes}{suffix}"
        self._part = self.path.with_name(self.path.name + PART_SUFFIX)
        self._fd = -1
        self._closed = False
        self._lock = threading.Lock()

    def open(self) -> int | None:
        """The bytes that are there already; None: all."""
        make_log_folder(self.folder)
        if self.path.exists():
            return None
        fd = os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, LOG_MODE)
        begin = 0
        try:
            there = min(os.fstat(fd).st_size, self.info.size_bytes)
            begin = there // BLOCK_BYTES * BLOCK_BYTES
            os.ftruncate(fd, begin)
            with self._lock:
                if not self._closed:
                    self._fd, fd = fd, -1
        finally:
            if fd >= 0:
                os.close(fd)
        return begin

    def write(self, chunk: Chunk) -> None:
        data = memoryview(chunk.data)
        with self._lock:
            while data and self._fd >= 0:
                written = os.pwrite(self._fd, data, chunk.offset + len(chunk.data) - len(data))
                data = data[written:]

    def close(self) -> None:
        """Close for good: also against an `open` that is still in progress."""
        with self._lock:
            self._closed = True
            fd, self._fd = self._fd, -1
            if fd >= 0:
                os.close(fd)

    def finish(self) -> None:
        """Give a complete file its name, and the time of the log's beginning."""
        self._part.replace(self.path)
        if self.info.time_unix_s:
            os.utime(self.path, (time.time(), self.info.time_unix_s))


def _safe(name: str) -> str:
    """A vehicle's name as that of a folder."""
    return re.sub(r"[^\w-]", "_", name) or "_"


def _chosen(logs: Sequence[LogInfo], wanted: Sequence[int] | str) -> tuple[list[LogInfo], list[int]]:
    """The logs to get, and ids that do not exist."""
    if wanted == "all":
        return list(logs), []
    if isinstance(wanted, str):  # "latest"; PX4 lists folders in no order
        newest = max(logs, key=lambda log: (log.time_unix_s, log.id), default=None)
        return ([] if newest is None else [newest]), []
    known = {log.id: log for log in logs}
    return [known[n] for n in wanted if n in known], [n for n in wanted if n not in known]


def _radio_text(radio: str, chosen: Sequence[LogInfo]) -> str:
    total = sum(log.size_bytes for log in chosen)
    minutes = total / RADIO_BYTES_PER_S / 60
    return (
        f"{radio} is a radio: {total:,} bytes would take it {minutes:,.0f} minutes and more, and slow down every "
        "vehicle on it; use USB or Wi-Fi, or insist with --force"
    )
