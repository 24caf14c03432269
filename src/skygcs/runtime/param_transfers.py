"""Parameters of one vehicle: the asyncio side of `ParameterProtocol`, `ParamList` and `FileDownload`, with one timer.

The actor owns one and passes the vehicle's messages to it (`on_frame`, `on_text`, `stop_all`). Nothing is requested
automatically: a parameter is transferred on request, and a list only if it is not known already.

A known list stays valid as long as the vehicle confirms it: PX4 by a hash over all values; ArduPilot, which has no
hash, by its firmware and the number of parameters, which does not confirm values. Changes by other stations are heard
here like our own, because the vehicle sends them to all.
"""

from __future__ import annotations

import asyncio
import math
from collections import defaultdict
from collections.abc import Callable, Coroutine, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from skygcs.core.mavlink import param_encoding
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import FILE_TRANSFER_PROTOCOL, PARAM_VALUE
from skygcs.core.mavlink.param_encoding import HASH_NAME, Param, Value, bits_message, value_reader, value_text
from skygcs.core.params.names import other_name
from skygcs.core.protocols.base import Effect, ProgressReport, Send
from skygcs.core.protocols.command import MAX_TEXTS
from skygcs.core.protocols.ftp import CAPABILITY_FTP, MESSAGE, FileDownload, FileOutcome, decode
from skygcs.core.protocols.parameter import ABSENT_PROBES, ParameterProtocol, ParamOutcome
from skygcs.core.protocols.parameter_list import (
    BYTES_PER_S,
    MAX_COUNT,
    WIDE_WINDOW,
    WINDOW,
    ListProgress,
    ParamList,
)
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.flight_lock import FlightLock, ParamWrite
from skygcs.core.vehicle.gate import clear_param, standing
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.loop_clock import DeadlineTimer
from skygcs.runtime.param_cache import ParamBook, ParamCache
from skygcs.runtime.task_set import fault
from skygcs.runtime.vehicle_services import VehicleServices

GUESSED_BYTES = 12
"""Bytes per parameter in ArduPilot's estimate of the file's size, which it reports when the file is opened."""


def offered(vehicle: Vehicle, dialect: Dialect, capabilities: int) -> bool:
    """True if the vehicle reports FTP, and has this file."""
    return vehicle.family == "ardupilot" and bool(capabilities & CAPABILITY_FTP) and MESSAGE in dialect.by_name


def rate_for(bytes_per_s: float | None, link_bytes_per_s: float) -> float | None:
    """Bytes a second that the answers may take of the link; None: no limit. ``link_bytes_per_s``: rate of the slowest
    link to the vehicle, infinite if none is known to be slow. Then it is read as fast as it answers, unless a rate
    below that of a slow link is requested."""
    return None if math.isinf(link_bytes_per_s) and (bytes_per_s or math.inf) >= BYTES_PER_S else bytes_per_s


def progress_of(download: FileDownload, now: float) -> ListProgress:
    """Progress in parameters, from the vehicle's estimate of the file's size."""
    progress = download.progress(now)
    count = None if progress.size is None else progress.size // GUESSED_BYTES
    received = progress.received // GUESSED_BYTES
    return ListProgress(
        received if count is None else min(received, count), count, progress.sent, progress.elapsed_s, None
    )


def params_of(outcome: FileOutcome, heard: Mapping[str, Param]) -> tuple[Param, ...]:
    """All parameters of the file; ``heard``: newer values that the vehicle sent during the download. Raises ValueError
    with a message for the user if some are missing."""
    if not outcome.ok:
        raise ValueError(outcome.message)
    held = param_encoding.decode_packed(outcome.data)
    if not held.params or len(held.params) != held.total:
        raise ValueError(f"it contains {len(held.params)} of {held.total} parameters")
    return tuple(heard.get(p.name, p) for p in held.params)


NEEDED = ("PARAM_VALUE", "PARAM_SET", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST")

MAX_EXCHANGES = 16
"""Single parameters requested at the same time; further ones wait."""

LOCKS = 64
"""One request per name at a time; names share locks, so that their number is bounded."""

PROGRESS_EVERY_S = 1.0

SETTLE_S = 0.5
"""Time after the last set parameter until the set ones are read once more: a PX4 corrects some of them itself
(MPC_XY_CRUISE above MPC_XY_VEL_MAX) when the module they belong to runs, some ms later."""

_CLEARED = {"PARAM_SET": standing("param set")}
"""Messages of these transfers that are not harmless: who sets a parameter has asked (`_write`, or ``checked``)."""

T = TypeVar("T")

Transfer = ParameterProtocol | ParamList | FileDownload


@dataclass(frozen=True, slots=True)
class Loaded:
    """All parameters of a vehicle, or the reason why not. ``source``: "vehicle", or "cache" if the vehicle confirmed
    the known ones.

    ``vouched``: how they were confirmed: "read" (and later changes were heard), "hash" (of all values), or "count"
    (only their number and the firmware are unchanged). ``sent``: number of messages sent.
    """

    ok: bool
    result: str
    message: str
    source: str
    vouched: str
    params: tuple[Param, ...]
    count: int | None
    sent: int
    elapsed_s: float


class VehicleParams:
    """Parameter transfers of one vehicle; see the module. Failures by the vehicle are outcomes, not exceptions."""

    def __init__(self, vehicle: Vehicle, services: VehicleServices) -> None:
        dialect = services.dialect
        # collaborators
        self.progress: ListProgress | None = None
        """Progress of the list in transfer."""
        self._vehicle = vehicle
        self._dialect = dialect
        self._services = services
        self._send = services.send
        self._loop = services.loop
        self._on_event = services.on_event
        self._book = ParamBook(vehicle, dialect, services.param_cache)
        # messages that the dialect must have
        self._able = all(name in dialect.by_name for name in NEEDED)
        self._read = value_reader(dialect) if self._able else None
        self._set_info = bits_message(dialect.by_name["PARAM_SET"]) if self._able else None
        error = dialect.by_name.get("PARAM_ERROR")
        self._error_id = -1 if error is None else error.msgid
        # exchanges in progress, and their bounds
        self._running: dict[Transfer, asyncio.Future[None]] = {}
        self._taken: dict[Transfer, int] = {}
        """Number of messages of each that were sent."""
        self._locks: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._quiet_until: dict[str, float] = {}
        self._slots = asyncio.Semaphore(MAX_EXCHANGES)
        # the list and the file of all parameters
        self._hashless = False
        """True if it has no hash: it answered everything else."""
        self._count: int | None = None
        self._file_session = 0
        self._downloading = asyncio.Lock()
        self._file_running = False
        self._changed: dict[str, Param] = {}
        """Values sent during a file's download: newer than those in the file."""
        self._loading: asyncio.Task[Loaded] | None = None
        # callers, cancellation and timer
        self._waiting = 0
        self._closed = ""
        """Why it was closed."""
        self._cancelled = 0
        self._reported_at = -math.inf
        self._timer = DeadlineTimer(services.loop, self._on_timer)
        # probes for absent parameters, and texts about limits
        self._probe = 0
        self._texts: list[str] = []
        """PX4's texts about limits since the last `set` began: "Cruise speed has been constrained by …"."""

    # -- messages of the vehicle

    def on_frame(self, frame: Frame, now: float) -> None:
        """A frame of this vehicle of one of `messages`. Never raises."""
        if frame.msgid == PARAM_VALUE and self._read is not None:
            value = self._read(frame.payload, self._book.encoding)
            if value is None:
                return
            self._count = value.count
            self._book.heard(value.param)
            if self._file_running and len(self._changed) < MAX_COUNT:
                self._changed[value.param.name] = value.param
            for protocol in list(self._running):
                if isinstance(protocol, ParameterProtocol | ParamList):
                    self._apply(protocol, protocol.on_value(value, now))
        elif frame.msgid == self._error_id and self._running:
            fields = frame.fields()
            name, code = str(fields.get("param_id", "")), int(fields.get("error", 0))
            for protocol in list(self._running):
                if isinstance(protocol, ParameterProtocol):
                    self._apply(protocol, protocol.on_error(name, code, now))
        elif frame.msgid == FILE_TRANSFER_PROTOCOL and self._running:
            self._on_file_reply(frame, now)
        else:
            return
        self._set_timer()

    def _on_file_reply(self, frame: Frame, now: float) -> None:
        reply = decode(frame.payload) if frame.target() == self._services.own else None
        for protocol in list(self._running):
            if isinstance(protocol, FileDownload) and reply is not None:
                self._apply(protocol, protocol.on_reply(reply, now))

    @property
    def messages(self) -> frozenset[int]:
        """Ids of the messages that `on_frame` is to be given."""
        return frozenset({PARAM_VALUE, FILE_TRANSFER_PROTOCOL, self._error_id})

    def on_text(self, text: str) -> None:
        if "constrained" in text and text not in self._texts and len(self._texts) < MAX_TEXTS:
            self._texts.append(text)
        for protocol in list(self._running):
            if isinstance(protocol, ParameterProtocol):
                self._apply(protocol, protocol.on_text(text, self._loop.time()))
        self._set_timer()

    def stop_all(self, result: str, message: str) -> int:
        """End all transfers and return their number. After a reboot the known values need a new confirmation."""
        if result == "lost":
            self._book.doubt()
            self._hashless = False
        self._cancelled += 1
        running = list(self._running)
        for protocol in running:
            self._apply(protocol, protocol.stop(self._loop.time(), result, message))
        self._set_timer()
        return len(running)

    def cancel(self) -> int:
        """Cancel the transfers on request and return their number. Safe at any moment."""
        return self.stop_all("cancelled", "cancelled")

    def stop_list(self) -> None:
        """Cancel the list in transfer, if there is one."""
        if self._loading is not None:
            self._loading.cancel()

    def close(self, reason: str) -> None:
        """The daemon ends, or the vehicle is dropped: end all transfers for this reason."""
        self._closed = reason
        self._book.save()
        self.stop_all("cancelled", reason)
        if self._loading is not None:
            self._loading.cancel()
        self._timer.set(None)

    # -- requests

    async def get(self, name: str) -> ParamOutcome:
        """Read one parameter from the vehicle; by its name in the other generation if the vehicle has only that."""
        return await self._either(name, lambda n: self._one(n))

    async def set(
        self,
        values: Mapping[str, Value],
        *,
        settle: bool = False,
        force: bool = False,
        own: FlightLock | None = None,
        checked: bool = False,
    ) -> dict[str, ParamOutcome]:
        """Set parameters one after another and read each back; returns an outcome for each, also for those not sent
        after a cancellation, and for those that a flight holds. ``settle``: read the changed ones once more at the end,
        as a vehicle may correct them. ``force``: also those with an unknown effect on a flight; ``own``: the lock of
        the flight that sets them for itself; ``checked``: the caller has asked the locks for all of them together."""
        # does the cache still hold what is on board?
        cancelled = self._cancelled
        hashed = self._book.complete and self._book.hash is not None
        vouched = hashed and self._book.vouches(await self._ask_hash())
        outcomes: dict[str, ParamOutcome] = {}
        self._texts.clear()
        # set one after the other, until somebody cancels
        try:
            for done, (name, value) in enumerate(values.items()):
                if self._cancelled != cancelled:
                    outcomes[name] = ParamOutcome(False, "cancelled", "cancelled: not sent", name)
                    continue
                if done:
                    self._progress("set", ListProgress(done, len(values), done, 0.0, None), f"setting {name}")
                outcomes[name] = await (
                    self._either(name, lambda n, v=value: self._one(n, v))  # type: ignore[misc]
                    if checked
                    else self._write(name, value, force=force, own=own)
                )
            # read values back that others may have changed
            if settle and self._cancelled == cancelled:
                await self._settle(outcomes)
        finally:
            self._report_set(outcomes, len(values))
        # keep the cache valid
        if hashed:
            self._book.vouched(await self._ask_hash() if vouched else None)
        self._book.save()
        return outcomes

    async def _write(self, name: str, value: Value, *, force: bool, own: FlightLock | None) -> ParamOutcome:
        """Set one, unless a flight holds it; a value that the vehicle has already changes nothing."""
        if self._refusal() is not None:
            return await self._either(name, lambda n: self._one(n, value))  # which says so
        if own is None:  # a flight that sets them for itself has judged all of them
            try:
                clear_param(model_of(self._vehicle, self._loop.time()), name, force=force)
            except RefusedError as error:
                return await self._unless_held(name, value, str(error))
        write = ParamWrite(self._vehicle.key, name, force)
        if (why := self._services.locks.refusal(write, own=own)) is not None:
            return await self._unless_held(name, value, why)
        return await self._either(name, lambda n: self._one(n, value))

    async def _unless_held(self, name: str, value: Value, why: str) -> ParamOutcome:
        """A refusal, unless the vehicle has this value already."""
        held = await self.get(name)
        if not held.ok or held.param is None or held.param.value != value:
            return ParamOutcome(False, "refused", f"refused: {why}", name)
        return held

    async def _settle(self, outcomes: dict[str, ParamOutcome]) -> None:
        """Read the changed parameters once more; an outcome states if the vehicle has another value now."""
        changed = [n for n, o in outcomes.items() if o.ok and o.param is not None and o.param != o.before]
        if not changed:
            return
        await asyncio.sleep(SETTLE_S)
        again = await asyncio.gather(*(self._one(outcomes[name].name) for name in changed))
        for name, now in zip(changed, again, strict=True):
            taken = outcomes[name]
            assert taken.param is not None
            if now.ok and now.param is not None and now.param.value != taken.param.value:
                took, held = value_text(taken.param.value), value_text(now.param.value)
                before = "" if taken.before is None else f" (it was {value_text(taken.before.value)})"
                why = f": {'; '.join(self._texts)}" if self._texts else ""
                message = f"it accepted {took} and then changed it to {held} itself{before}{why}"
                outcomes[name] = replace(taken, ok=False, result="changed", message=message, param=now.param)

    async def load(
        self, *, refresh: bool = False, burst: bool = False, bytes_per_s: float | None = BYTES_PER_S
    ) -> Loaded:
        """Read all parameters. One list at a time: further requests wait for the same list, at the rate of the first.
        One with ``refresh`` reads its own after it if that list was only confirmed. It is cancelled when no request
        waits for it any more."""
        while refresh and self._loading is not None:
            loaded = await self._join(self._loading)
            if loaded.source != "cache":
                return loaded
        if self._loading is None:
            work = self._load(refresh=refresh, burst=burst, bytes_per_s=bytes_per_s)
            self._loading = self._loop.create_task(work, name=f"parameters of {self._vehicle.name}")
            self._loading.add_done_callback(self._loaded)
        return await self._join(self._loading)

    async def _join(self, loading: asyncio.Task[Loaded]) -> Loaded:
        """Wait for the list in transfer."""
        self._waiting += 1
        try:
            return await asyncio.shield(loading)
        finally:
            self._waiting -= 1
            if not self._waiting and self._loading is not None:
                self._loading.cancel()
                self._loading = None

    @property
    def rate(self) -> float | None:
        """Bytes a second that long answers may take of the links to it; None: no limit."""
        return self._rate_for(BYTES_PER_S)

    @property
    def cache(self) -> ParamCache:
        """The store on disk."""
        return self._services.param_cache

    def known(self) -> Mapping[str, Param]:
        """The values as last heard, complete or not."""
        return self._book.params

    async def file(self, path: str, *, max_bytes: int) -> FileOutcome:
        """Read one file of the vehicle by MAVLink FTP, as fast as its links allow."""
        if (refusal := self._refusal()) is not None:
            return FileOutcome(False, *refusal, b"", 0, 0.0)
        rate = self.rate
        return await self._download(path, max_bytes, burst=rate is None, bytes_per_s=rate)

    async def vouched(self) -> Mapping[str, Param]:
        """All known parameters if the vehicle confirms them by its hash; else nothing."""
        book = self._book
        book.recall()
        if not book.complete or book.hash is None or self._refusal() is not None:
            return {}
        return dict(book.params) if book.vouches(await self._ask_hash()) else {}

    def status(self) -> dict[str, Any]:
        """JSON-able: the known parameters and the transfers in progress."""
        progress = None if self.progress is None else _progress_data(self.progress)
        return {
            "known": len(self._book.params),
            "complete": self._book.complete,
            "hash": self._book.hash,
            "loading": progress,
            "in_progress": len(self._running),
        }

    # -- transfers

    def _refusal(self) -> tuple[str, str] | None:
        """Why no request is sent to it now: the result word and the text of the outcome."""
        if self._closed:
            return "cancelled", f"cancelled: {self._closed}"
        if not self._able:
            return "refused", f"refused: dialect {self._dialect.name} has no parameter messages"
        if self._vehicle.replayed:
            return "refused", "refused: it is heard only in a recording"
        if self._vehicle.duplicate:
            text = f"two vehicles with system id {self._vehicle.sysid} are on the air; give one of them another"
            return "refused", f"refused: {text}"
        if (why := self._services.links.authority_refusal(self._vehicle.sysid)) is not None:
            return "refused", f"refused: {why}"
        return None if self._vehicle.connected else ("lost", "the vehicle is lost: nothing is heard from it")

    async def _either(self, name: str, run: Callable[[str], Coroutine[Any, Any, ParamOutcome]]) -> ParamOutcome:
        other = other_name(name)
        if other is None:
            return await run(name)
        if self._book.complete and name not in self._book.params and other in self._book.params:
            return await run(other)
        outcome = await run(name)
        if outcome.result != "unknown":
            return outcome
        second = await run(other)
        return second if second.result != "unknown" else outcome

    async def _one(self, name: str, value: Value | None = None) -> ParamOutcome:
        refusal = self._refusal()
        if refusal is not None:
            return ParamOutcome(False, *refusal, name)
        cancelled = self._cancelled
        async with self._locks[hash(name) % LOCKS], self._slots:
            await asyncio.sleep(max(0.0, self._quiet_until.pop(name, 0.0) - self._loop.time()))
            if self._cancelled != cancelled:
                return ParamOutcome(False, "cancelled", "cancelled: not sent", name)
            protocol = ParameterProtocol(
                name, self._book.encoding, value, absent_of=self._absent_of(name), probe_index=self._probe
            )
            self._probe += ABSENT_PROBES + 1
            try:
                unsent = await self._run(protocol)
            finally:
                self._keep_quiet(name, protocol.quiet_until)
        assert protocol.outcome is not None
        if protocol.outcome.result != "timeout":
            return protocol.outcome
        if unsent:
            return ParamOutcome(False, "lost", "could not be sent: no link leads to it", name)
        why_silent = self._services.links.why_silent(self._vehicle)
        return replace(protocol.outcome, message=protocol.outcome.message + why_silent)

    def _absent_of(self, name: str) -> int:
        """Number of parameters in its complete list if none of them has this name; else 0."""
        self._book.recall()
        known = self._book.params
        return len(known) if self._book.complete and name not in known and name != HASH_NAME else 0

    async def _load(self, *, refresh: bool, burst: bool, bytes_per_s: float | None) -> Loaded:
        started = self._loop.time()
        refusal = self._refusal()
        if refusal is not None:
            return Loaded(False, *refusal, "vehicle", "read", (), None, 0, 0.0)
        cancelled = self._cancelled
        # the list that is known, if a PX4 confirms by its hash that it is still the vehicle's
        px4 = self._vehicle.family == "px4"
        before = await self._ask_hash() if px4 else None
        if not refresh and await self._still_known(before):
            return self._known_list(started)
        if self._cancelled != cancelled:
            return Loaded(False, "cancelled", "cancelled", "vehicle", "read", (), None, 0, self._loop.time() - started)
        # by file where the vehicle offers it
        rate, why_not = self._rate_for(bytes_per_s), ""
        if offered(self._vehicle, self._dialect, self._book.capabilities):
            by_file = await self._load_file(burst=burst or rate is None, bytes_per_s=rate)
            if by_file.ok or by_file.result in ("cancelled", "lost", "refused"):
                return by_file
            why_not = f" (not by file: {by_file.message})"
        # otherwise by messages
        window = WINDOW if rate is not None else WIDE_WINDOW
        protocol = ParamList(burst=burst, window=window, bytes_per_s=rate, stops_burst=px4)
        try:
            await self._run(protocol)
        finally:
            self.progress = None
        outcome = protocol.outcome
        assert outcome is not None
        if outcome.ok:
            # values that changed during the transfer are valid, but not confirmed by a hash
            after = await self._ask_hash() if before is not None else None
            self._book.remember(outcome.params, after if after == before else None)
        why_silent = self._services.links.why_silent(self._vehicle) if outcome.result == "timeout" else ""
        # what the caller and the log are given
        message = outcome.message + why_not + why_silent
        self._report("list", f"parameters: {message}", {"received": len(outcome.params), "count": outcome.count})
        return Loaded(
            outcome.ok,
            outcome.result,
            message,
            "vehicle",
            "read",
            outcome.params,
            outcome.count,
            outcome.sent,
            self._loop.time() - started,
        )

    async def _load_file(self, *, burst: bool, bytes_per_s: float | None) -> Loaded:
        started = self._loop.time()
        self._changed.clear()
        self._file_running = True
        try:
            outcome = await self._download(
                param_encoding.PACKED_PATH, param_encoding.MAX_PACKED_BYTES, burst=burst, bytes_per_s=bytes_per_s
            )
        finally:
            self.progress = None
            self._file_running = False
        return self._loaded_file(outcome, self._loop.time() - started)

    async def _download(self, path: str, max_bytes: int, *, burst: bool, bytes_per_s: float | None) -> FileOutcome:
        """Download files one after another: a PX4 has one session."""
        async with self._downloading:
            self._file_session = (self._file_session + 16) & 0xFF  # a download may need several attempts
            protocol = FileDownload(
                path, session=self._file_session, max_bytes=max_bytes, burst=burst, bytes_per_s=bytes_per_s
            )
            await self._run(protocol)
        assert protocol.outcome is not None
        return protocol.outcome

    def _rate_for(self, bytes_per_s: float | None) -> float | None:
        services = self._services
        return rate_for(bytes_per_s, services.links.setpoint_bytes_per_s(self._vehicle, services.flown))

    def _loaded_file(self, outcome: FileOutcome, elapsed_s: float) -> Loaded:
        try:
            params = params_of(outcome, self._changed)
        except ValueError as error:
            result = "incomplete" if outcome.ok else outcome.result
            return Loaded(False, result, str(error), "vehicle", "read", (), None, outcome.sent, elapsed_s)
        self._book.remember(params, None)
        text, count = f"{len(params)} parameters, by file", len(params)
        self._report("list", f"parameters: {text}", {"received": count, "count": count})
        return Loaded(True, "accepted", text, "vehicle", "read", params, count, outcome.sent, elapsed_s)

    async def _still_known(self, hash_now: int | None) -> bool:
        """True if the values read before, in this run or an earlier one, are those of the vehicle, as far as can be
        known."""
        book = self._book
        book.recall()
        if not book.complete or self._vehicle.family == "px4":
            return book.vouches(hash_now)
        outcome = await self._one(next(iter(book.params)))
        return outcome.ok and self._count == len(book.params)

    def _known_list(self, started: float) -> Loaded:
        params = tuple(self._book.params.values())
        text = f"{len(params)} parameters, as known"
        vouched = "hash" if self._book.hash is not None else "count" if self._book.recalled else "read"
        return Loaded(True, "accepted", text, "cache", vouched, params, len(params), 1, self._loop.time() - started)

    async def _ask_hash(self) -> int | None:
        if self._hashless:
            return None
        outcome = await self._one(HASH_NAME)
        self._hashless = outcome.result == "unknown"
        return int(outcome.number) if outcome.ok and outcome.number is not None else None

    def _keep_quiet(self, name: str, until: float) -> None:
        """Wait before another request with this name: answers to the last one may still come."""
        now = self._loop.time()
        for past in [n for n, t in self._quiet_until.items() if t <= now]:
            del self._quiet_until[past]
        if until > now:
            self._quiet_until[name] = until

    async def _run(self, protocol: Transfer) -> bool:
        """Run it to its outcome; True if no link took any of its messages."""
        done: asyncio.Future[None] = self._loop.create_future()
        self._running[protocol] = done
        self._taken[protocol] = 0
        self._apply(protocol, protocol.start(self._loop.time()))
        self._set_timer()
        try:
            await done
            return self._taken[protocol] == 0
        except asyncio.CancelledError:
            self._apply(protocol, protocol.stop(self._loop.time(), "cancelled", "no request waits for it any more"))
            raise
        finally:
            self._running.pop(protocol, None)
            del self._taken[protocol]
            self._set_timer()

    def _apply(self, protocol: Transfer, effects: Sequence[Effect]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                self._transmit(protocol, effect)
            elif isinstance(effect, ProgressReport) and isinstance(protocol, ParamList):
                self.progress = protocol.progress(self._loop.time())
                self._progress("list", self.progress, "reading parameters")
            elif isinstance(effect, ProgressReport) and isinstance(protocol, FileDownload) and self._file_running:
                self.progress = progress_of(protocol, self._loop.time())
                self._progress("list", self.progress, "reading parameters by file, some")
        done = self._running.get(protocol)
        if protocol.done and done is not None and not done.done():
            done.set_result(None)

    def _transmit(self, protocol: Transfer, effect: Send) -> None:
        sysid, compid = self._vehicle.sysid, self._vehicle.compid
        info = self._set_info if effect.message == "PARAM_SET" else self._dialect.by_name[effect.message]
        assert info is not None
        values = {**effect.values, "target_system": sysid, "target_component": compid}
        cleared: dict[str, Any] = {"clearance": _CLEARED[effect.message]} if effect.message in _CLEARED else {}
        key = _key(effect.message, effect.values, sysid, compid)
        self._taken[protocol] += self._send(info, values, sysid, compid, Priority.PROTOCOL, key=key, **cleared)

    def _set_timer(self) -> None:
        self._timer.set(min((e.deadline for e in self._running if e.deadline is not None), default=None))

    def _on_timer(self) -> None:
        now = self._loop.time()
        for protocol in list(self._running):
            if isinstance(protocol, ParameterProtocol) and self._is_queued(protocol, now):
                protocol.still_waits(now)
            self._apply(protocol, protocol.on_timer(now))
        self._set_timer()

    def _is_queued(self, protocol: ParameterProtocol, now: float) -> bool:
        """True if its deadline has come while its request still waits for the radio: to repeat it would be to let it
        wait once more."""
        if protocol.deadline is None or now < protocol.deadline:
            return False
        links, ids = self._services.links, (self._vehicle.sysid, self._vehicle.compid)
        values = {"param_id": protocol.name, "param_index": -1}
        keys = (_key(message, values, *ids) for message in ("PARAM_SET", "PARAM_REQUEST_READ"))
        return any(links.holds(self._vehicle, Priority.PROTOCOL, key) for key in keys)

    def _loaded(self, task: asyncio.Task[Loaded]) -> None:
        if self._loading is task:
            self._loading = None
        if (text := fault(task)) is not None:
            self._on_event(Event("fault", self._vehicle.name, self._vehicle.sysid, text, {}))

    def _progress(self, action: str, progress: ListProgress, text: str) -> None:
        """Report the progress, in at most one event a second."""
        now = self._loop.time()
        if now - self._reported_at >= PROGRESS_EVERY_S:
            self._reported_at = now
            rest = "" if progress.remaining_s is None else f", {progress.remaining_s:.0f} s left"
            line = f"{text}: {progress.received} of {progress.count}{rest}"
            self._report(action, line, _progress_data(progress) | {"state": "under_way"})

    def _report_set(self, outcomes: Mapping[str, ParamOutcome], wanted: int) -> None:
        """Report set parameters as an event, also if the client has disconnected meanwhile."""
        good = sum(o.ok for o in outcomes.values())
        if wanted == 1 and outcomes:
            ((name, outcome),) = outcomes.items()
            text = f"{name}: {outcome.message}"
        else:
            text = f"{good} of {wanted} parameters set"
        failed = [name for name, o in outcomes.items() if not o.ok]
        self._report("set", text, {"received": good, "count": wanted, "failed": failed})

    def _report(self, action: str, text: str, data: dict[str, Any]) -> None:
        data = {"action": action, "state": "done"} | data
        self._on_event(Event("params", self._vehicle.name, self._vehicle.sysid, text, data))


def _key(message: str, values: Mapping[str, Any], sysid: int, compid: int) -> Hashable | None:
    """Key in the link's queue: a repeated request takes the place of one that still waits. None: a part of a file."""
    if message == "PARAM_SET":
        return message, sysid, compid, values["param_id"]
    if message == "PARAM_REQUEST_READ":
        return message, sysid, compid, values["param_id"], values["param_index"]
    return None


def _progress_data(progress: ListProgress) -> dict[str, Any]:
    percent = None if not progress.count else 100 * progress.received // progress.count
    return {
        "received": progress.received,
        "count": progress.count,
        "percent": percent,
        "elapsed_s": round(progress.elapsed_s, 1),
        "remaining_s": None if progress.remaining_s is None else round(progress.remaining_s, 1),
    }
