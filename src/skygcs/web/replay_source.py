"""A recording in place of a daemon: read once for its length, its events and its checkpoints, then played and scrubbed.

The file is read in pieces and in slices of time, so that neither memory nor the pages' requests suffer from a long
one. What is kept of it: MAX_CHECKPOINTS checkpoints, whatever its length (they are thinned out when they become too
many), and the newest MAX_EVENTS events.
"""

from __future__ import annotations

import asyncio
import bisect
import contextlib
import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, overload

import structlog

from skygcs import __version__
from skygcs.config.files import open_regular
from skygcs.core.alarms import VehicleFacts, event_record
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import RpcError, SkygcsError
from skygcs.events import Event
from skygcs.rpc.client_connection import OnReport
from skygcs.rpc.error_codes import INVALID_PARAMS, REFUSED, TARGET_ERROR
from skygcs.rpc.replies import encode
from skygcs.spelling import is_number
from skygcs.tlog.files import FileWindow, LogFile
from skygcs.tlog.format import ByteSource, LogEntry, LogKind
from skygcs.tlog.reading import LogReader
from skygcs.web.daemon_connection import STATE_KEYS, Pages
from skygcs.web.page_clients import OwnMethod, PageClient, PageClients
from skygcs.web.replay_fleet import Checkpoint, ReplayFleet
from skygcs.web.replay_marks import marks_of
from skygcs.web.state_batches import LatestStates

SLICE_S = 0.004
"""Reading goes on for so long at a time; then the pages have their turn."""

LOOKS = 64
"""Places searched in damaged parts before the pages have their turn."""

MAX_CHECKPOINTS = 64
"""A jump reads a 32nd of the file at most. 50 vehicles with 60 messages: some 0.2 MB each."""

FIRST_SPACING_S = 5.0
"""Recorded time between two checkpoints at first; it doubles when they become too many."""

TICK_S = 0.1
"""Recorded time between two ticks of the vehicles."""

STEP_S, PUBLISH_S, POSITION_S = 0.05, 0.1, 0.2
"""Playing moves on so often; states are published and the position is notified so often at most."""

LONGEST_GAP_S = 10.0
"""A longer pause in the recording, the time between two flights, is left out while playing."""

MAX_EVENTS = 5000
LEAST_SPEED, MAX_SPEED = 0.1, 100.0

_log = structlog.get_logger(__name__)


class _Tail:
    """A log from an offset on, as a reader sees it."""

    def __init__(self, data: ByteSource, offset: int) -> None:
        self._data = data
        self._offset = offset

    def __len__(self) -> int:
        return max(len(self._data) - self._offset, 0)

    @overload
    def __getitem__(self, index: int, /) -> int: ...

    @overload
    def __getitem__(self, index: slice, /) -> bytes: ...

    def __getitem__(self, index: int | slice, /) -> int | bytes:
        if isinstance(index, slice):
            start, stop, _ = index.indices(len(self))
            return self._data[start + self._offset : max(start, stop) + self._offset]
        return self._data[index + self._offset]


class Recording:
    """The file: entries from any checkpoint on, what the first reading has found. Raises SkygcsError when opened."""

    def __init__(self, path: Path, dialect: Dialect) -> None:
        self.path = path
        self.dialect = dialect
        try:
            self._file: BinaryIO = open_regular(path)
        except OSError as error:
            raise SkygcsError(f"{path}: {error.strerror or error}") from None
        try:
            self.kind: LogKind = LogFile(path, FileWindow(self._file), dialect).kind
        except SkygcsError:
            self._file.close()
            raise
        self.duration_s = 0.0
        self.start_unix_s: float | None = None
        self.scanned = False
        self.events: deque[tuple[float, dict[str, Any]]] = deque(maxlen=MAX_EVENTS)
        self.checkpoints = [Checkpoint(0.0, 0, (), None)]
        self._spacing_s = FIRST_SPACING_S

    def entries(self, checkpoint: Checkpoint) -> Iterator[LogEntry | None]:
        """The entries after a checkpoint; None after a stretch of damage."""
        # a window of its own: two readers at different places would throw each other's away
        source = _Tail(FileWindow(self._file), checkpoint.offset)
        for entry in LogReader(source, self.dialect, self.kind).steps(LOOKS):
            if entry is not None:
                entry.at_s += checkpoint.at_s
                entry.offset += checkpoint.offset
            yield entry

    def nearest(self, at_s: float) -> Checkpoint:
        """The last checkpoint that is not after this time."""
        return self.checkpoints[bisect.bisect_right(self.checkpoints, at_s, key=lambda c: c.at_s) - 1]

    def offer_checkpoint(self, fleet: ReplayFleet, entry: LogEntry) -> None:
        """Keep one before this entry if the last is far enough away. A raw capture has only that of its beginning:
        its times follow from all that went before."""
        if self.kind == "raw" or entry.at_s - self.checkpoints[-1].at_s < self._spacing_s:
            return
        self.checkpoints.append(fleet.checkpoint(entry.at_s, entry.offset))
        if len(self.checkpoints) > MAX_CHECKPOINTS:
            del self.checkpoints[1::2]
            self._spacing_s *= 2

    def record(self, event: Event, at_s: float, fleet: ReplayFleet) -> dict[str, Any]:
        """An event as pages get it. ``fleet``: at that time."""
        vehicle = None if event.vehicle is None else fleet.find(event.vehicle)
        facts = VehicleFacts(None if vehicle is None else vehicle.armed)
        return event_record(event, (self.start_unix_s or 0.0) + at_s, facts)

    def close(self) -> None:
        self._file.close()


class ReplaySource:
    """In the place of `DaemonConnection`. Run `run` in a task."""

    def __init__(self, path: Path, dialect: Dialect, states: LatestStates) -> None:
        self.loop = asyncio.get_running_loop()
        self.recording = Recording(path, dialect)
        self.takes_orders = False
        self.connected, self.slow = True, False
        self.text = f"a recording: {path.name}"
        self.since = self.loop.time()
        self.info: dict[str, Any] = {}
        self.note: str | None = None
        self.site: str | None = None
        self.stopping = False
        self.fleet = ReplayFleet(dialect)
        self.position_s = 0.0
        self.playing = False
        self.speed = 1.0
        self.ended = False
        self._dialect = dialect
        self._states = states
        self._entries = self.recording.entries(self.recording.checkpoints[0])
        self._next: LogEntry | None = None
        self._ticked_s = -math.inf
        self._seek_s: float | None = None
        self._moved = asyncio.Event()
        self._notified_at = -math.inf
        self._published_at = -math.inf

    # -- requests of pages

    def own_methods(self) -> dict[str, OwnMethod]:
        """The methods replay.*"""
        return {
            "replay.info": self._on_info,
            "replay.marks": self._on_marks,
            "replay.play": self._on_play,
            "replay.pause": self._on_pause,
            "replay.seek": self._on_seek,
            "replay.speed": self._on_speed,
        }

    def status(self) -> dict[str, Any]:
        """The answer of every replay method."""
        recording = self.recording
        return {
            "file": recording.path.name,
            "start_unix_s": recording.start_unix_s,
            "duration_s": round(recording.duration_s, 3),
            "scanned": recording.scanned,
            "position_s": round(self.position_s if self._seek_s is None else self._seek_s, 3),
            "playing": self.playing,
            "speed": self.speed,
            "ended": self.ended,
        }

    async def call(
        self,
        method: str,
        params: dict[str, Any],
        deadline_s: float | None = None,
        on_report: OnReport | None = None,
    ) -> bytes:
        """Return what a recording can answer, encoded. Raises RpcError."""
        return encode(self._result(method, params), serialize_unknown=True)

    def _result(self, method: str, params: dict[str, Any]) -> Any:
        match method:
            case "daemon.info":
                return {"version": __version__, "replay": True, "file": str(self.recording.path)}
            case "origin.get":
                origin = self.fleet.origin
                known = None if origin is None else {k: getattr(origin, k) for k in ORIGIN_KEYS}
                return {"origin": known, "generation": 0}
            case "vehicles.list":
                return [self.fleet.state(vehicle, self.position_s) for vehicle in self.fleet.vehicles.values()]
            case "vehicles.get":
                vehicle = self.fleet.find(params.get("target"))
                if vehicle is None:
                    raise RpcError(TARGET_ERROR, "no such vehicle in this part of the recording")
                return self.fleet.state(vehicle, self.position_s)
            case "events.recent":
                limit = params.get("limit", 100)
                if isinstance(limit, bool) or not isinstance(limit, int) or limit < 1:
                    raise RpcError(INVALID_PARAMS, "events.recent: limit must be a positive integer")
                before = [event for at_s, event in self.recording.events if at_s <= self.position_s]
                return before[-limit:]
        raise RpcError(REFUSED, f"{method[:80]}: this is a replay; nothing can be ordered or asked")

    def operator_active(self) -> None:
        """Do nothing: a replay has no operator."""

    async def _on_info(self, _: PageClient, __: dict[str, Any]) -> dict[str, Any]:
        return self.status()

    async def _on_marks(self, _: PageClient, __: dict[str, Any]) -> dict[str, Any]:
        return {"marks": marks_of(self.recording.events), "scanned": self.recording.scanned}

    async def _on_play(self, _: PageClient, __: dict[str, Any]) -> dict[str, Any]:
        if self.ended:
            self._seek_s = 0.0
        self.playing = True
        return self._changed()

    async def _on_pause(self, _: PageClient, __: dict[str, Any]) -> dict[str, Any]:
        self.playing = False
        return self._changed()

    async def _on_seek(self, _: PageClient, params: dict[str, Any]) -> dict[str, Any]:
        position_s = _number(params, "position_s")
        self._seek_s = min(max(position_s, 0.0), self.recording.duration_s)
        return self._changed()

    async def _on_speed(self, _: PageClient, params: dict[str, Any]) -> dict[str, Any]:
        speed = _number(params, "speed")
        if not LEAST_SPEED <= speed <= MAX_SPEED:
            raise RpcError(INVALID_PARAMS, f"speed must be from {LEAST_SPEED:g} to {MAX_SPEED:g}")
        self.speed = speed
        return self._changed()

    def _changed(self) -> dict[str, Any]:
        self._notified_at = -math.inf
        self._moved.set()
        return self.status()

    # -- life

    async def run(self, pages: PageClients) -> None:
        """Read the file once, and play it as the pages ask; until it is cancelled."""
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._scan(pages), name="scan of the recording")
                group.create_task(self._play(pages), name="playing")
        finally:
            self.recording.close()

    async def _scan(self, pages: PageClients) -> None:
        """Find the length, the events and the checkpoints."""
        recording, fleet = self.recording, ReplayFleet(self._dialect)
        slice_ends = self.loop.time() + SLICE_S
        ticked_s = 0.0
        for entry in recording.entries(recording.checkpoints[0]):
            if entry is not None and entry.frame is not None:
                if recording.start_unix_s is None and entry.unix_us is not None:
                    recording.start_unix_s = entry.unix_us / 1e6
                recording.offer_checkpoint(fleet, entry)
                events = list(fleet.on_frame(entry.frame, entry.at_s))
                if entry.at_s - ticked_s >= TICK_S:
                    ticked_s = entry.at_s
                    events += fleet.tick(entry.at_s)
                recording.events.extend((entry.at_s, recording.record(event, entry.at_s, fleet)) for event in events)
                recording.duration_s = max(recording.duration_s, entry.at_s)
            if self.loop.time() > slice_ends:
                await asyncio.sleep(0.001)
                slice_ends = self.loop.time() + SLICE_S
        recording.scanned = True
        self._notified_at = -math.inf
        _log.info("recording read", file=recording.path.name, seconds=round(recording.duration_s, 1))

    async def _play(self, pages: PageClients) -> None:
        at = self.loop.time()
        while True:
            if self._seek_s is not None:
                await self._go_to(pages)
            now = self.loop.time()
            if self.playing:
                await self._advance(self.position_s + (now - at) * self.speed, pages)
            at = now
            self._publish(pages)
            self._moved.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(STEP_S):
                    await self._moved.wait()

    async def _go_to(self, pages: PageClients) -> None:
        """Begin at the nearest checkpoint and read on to the place; a newer place in the meantime begins anew."""
        target_s = self._seek_s or 0.0
        checkpoint = self.recording.nearest(target_s)
        self.fleet = ReplayFleet(self._dialect)
        self.fleet.restore(checkpoint)
        self._entries, self._next = self.recording.entries(checkpoint), None
        self._ticked_s = -math.inf
        self.ended = False
        await self._advance(target_s, None)
        if self._seek_s == target_s:
            self._seek_s = None
            self.position_s = target_s
            self._states.reset()
            self._published_at = -math.inf
            self._notified_at = -math.inf

    async def _advance(self, target_s: float, pages: Pages | None) -> None:
        """Feed the entries up to this time. ``pages``: receivers of the events; None for a jump, whose events
        are not sent."""
        slice_ends = self.loop.time() + SLICE_S
        while True:
            entry = self._next or next(self._entries, _END)
            if entry is _END:
                self.ended, self.playing = True, False
                self._notified_at = -math.inf
                break
            if isinstance(entry, LogEntry):
                if pages is not None and entry.at_s - self.position_s > LONGEST_GAP_S:
                    self.position_s = target_s = entry.at_s
                if entry.at_s > target_s:
                    self._next = entry
                    break
                self._next = None
                self._feed(entry, pages)
            if self.loop.time() > slice_ends:
                await asyncio.sleep(0)
                slice_ends = self.loop.time() + SLICE_S
                if self._seek_s is not None and (pages is not None or self._seek_s != target_s):
                    return
        if pages is not None:
            self.position_s = min(target_s, self.recording.duration_s) if self.ended else target_s
        self._tick(target_s, pages)

    def _feed(self, entry: LogEntry, pages: Pages | None) -> None:
        if entry.frame is not None:
            events = self.fleet.on_frame(entry.frame, entry.at_s)
            self._tell(events, entry.at_s, pages)
        if entry.at_s - self._ticked_s >= TICK_S:
            self._tick(entry.at_s, pages)

    def _tick(self, at_s: float, pages: Pages | None) -> None:
        self._ticked_s = at_s
        self._tell(self.fleet.tick(at_s), at_s, pages)

    def _tell(self, events: Any, at_s: float, pages: Pages | None) -> None:
        if pages is not None:
            for event in events:
                pages.on_event(self.recording.record(event, at_s, self.fleet))

    def _publish(self, pages: PageClients) -> None:
        """States also while it stands still: the pages let ages grow by themselves."""
        now = self.loop.time()
        if now - self._notified_at >= (POSITION_S if self.playing or not self.recording.scanned else math.inf):
            self._notified_at = now
            pages.notify("replay.position", self.status())
        if now - self._published_at < PUBLISH_S or pages.rate_hz() is None:
            return
        self._published_at = now
        for vehicle in self.fleet.vehicles.values():
            state = self.fleet.state(vehicle, self.position_s)
            light = {key: state[key] for key in ("name", "sysid", *STATE_KEYS)}
            self._states.put(vehicle.name, encode(light), now)
        if not self._states.complete and not self.fleet.vehicles:
            self._states.settle()  # nothing was heard yet at this time of the recording
            pages.wake_all()
        pages.on_states()


ORIGIN_KEYS = ("lat_deg", "lon_deg", "alt_amsl_m", "x_heading_deg")
_END: Any = object()


def _number(params: dict[str, Any], name: str) -> float:
    value = params.get(name)
    if not is_number(value):
        raise RpcError(INVALID_PARAMS, f"{name} must be a number")
    return float(value)
