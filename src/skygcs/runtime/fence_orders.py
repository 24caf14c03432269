"""The fence of a vehicle's parameters: set it, read it, and test it on foot.

The test (as in the UTIAS report, section 2.2.1): a small fence is set, a person carries the vehicle out of it, and the
vehicle's texts and reactions are recorded. The old parameters are restored in any case, also when the test is cancelled
or its client disconnects.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import LOG_MODE, make_log_folder, write_whole
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import fence_params
from skygcs.core.vehicle.flight_lock import FenceWrite, widens
from skygcs.core.vehicle.orders import require_connected
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.undo_journal import UndoableChange
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehiclePart

LOOK_S = 0.25
ASK_S = 1.0
"""FENCE_STATUS is requested once a second; a person walks a metre or two in that time."""

AFTER_S = 12.0
"""Time after the first sign of a breach: a PX4 holds for COM_FAIL_ACT_T (5 s) before it acts."""

STATUS_S = 3.0

FINISH_S = 1.0
"""Time for the parameter in transfer when a test is cancelled: two round trips of a nine-node radio."""

SIGNS_MAX = 20


@dataclass(frozen=True, slots=True)
class FenceOutcome:
    """An outcome with the vehicle's fence, or with the record of its test."""

    outcome: Outcome
    fence: Mapping[str, Any] | None = None
    record: Mapping[str, Any] | None = None

    @property
    def ok(self) -> bool:
        return self.outcome.ok

    def as_dict(self) -> dict[str, Any]:
        return {**self.outcome.as_dict(), "fence": self.fence, "record": self.record}


@dataclass(slots=True)
class _Walk:
    """A test in progress: where it began, and what was observed."""

    began: float
    mode: str
    was_armed: bool
    armed: bool
    signs: list[str] = field(default_factory=list)
    breached_at: float | None = None
    breached_m: float | None = None
    farthest_m: float = 0.0
    reacted: bool = False

    def sign(self, text: str, now: float) -> None:
        if text not in self.signs and len(self.signs) < SIGNS_MAX:
            self.signs.append(text)
        if self.breached_at is None:
            self.breached_at = now


class VehicleFence(VehiclePart):
    """The fence of one vehicle. Tests are reported as events."""

    def __init__(self, actor: VehicleActor) -> None:
        services = actor.services
        self._vehicle = actor.vehicle
        self._params = actor.params
        self._watch = actor.fence_watch
        self._request = actor.request
        self._dialect = services.dialect
        self._loop = services.loop
        self._on_event = services.on_event
        self._log_dir = services.log_dir
        self._journal = services.journal
        self._disk = services.disk
        self._locks = services.locks
        self._tester: asyncio.Task[FenceOutcome] | None = None
        self._ended_with: Outcome | None = None
        """Outcome of the last test."""
        self._walk: _Walk | None = None
        self._endings: set[asyncio.Task[Outcome]] = set()
        """Tests that restore parameters; a task without a reference may be discarded."""
        self._last_text: str | None = None

    async def wind_down(self) -> None:
        if self._tester is not None:
            self._tester.cancel()
            await asyncio.wait({self._tester})
        await self.ended()

    async def ended(self) -> None:
        if self._endings:
            await asyncio.wait(set(self._endings))

    def on_text(self, text: str) -> None:
        if fence_params.reports_breach(text):
            self._last_text = text
            if self._walk is not None:
                self._walk.sign(f'it reports "{text}"', self._loop.time())

    async def set(
        self, *, radius_m: float | None, height_m: float | None, action: str | None, force: bool = False
    ) -> FenceOutcome:
        """Set the arguments that are not None, and read all of the fence back. Refused while a flight was checked
        within a wider one, and unless ``force`` where the vehicle would be outside of it at once."""
        if self._watch.testing:
            return FenceOutcome(_UNDER_TEST)
        held = await self._held()
        if isinstance(held, Outcome):
            return FenceOutcome(held)
        try:
            wanted = fence_params.changes(
                self._vehicle.family, held, radius_m=radius_m, height_m=height_m, action=action
            )
            self._locks.require(FenceWrite(self._vehicle.key, widens(held, wanted)))
            if not force:
                after = fence_params.settings_of(self._vehicle.family, {**held, **wanted})
                fence_params.require_inside(self._vehicle, self._loop.time(), after)
        except RefusedError as error:
            return FenceOutcome(_refused(error))
        failed = await self._put(wanted, checked=True)
        now = await self._held()
        if isinstance(now, Outcome):
            return FenceOutcome(now if failed is None else failed)
        settings = fence_params.settings_of(self._vehicle.family, now)
        return FenceOutcome(failed or Outcome(True, "accepted", f"the fence is {settings}"), settings.as_dict())

    async def settings(self) -> fence_params.FenceSettings | str:
        """Read the fence's settings; returns them, or why they are not known."""
        held = await self._held()
        return held.message if isinstance(held, Outcome) else fence_params.settings_of(self._vehicle.family, held)

    async def status(self) -> FenceOutcome:
        """Read the fence's settings; returns them with the vehicle's reports of breaches."""
        held = await self._held()
        if isinstance(held, Outcome):
            return FenceOutcome(held)
        asked = self._loop.time()
        if self._reports_status:
            await self._request("FENCE_STATUS")
        beyond = fence_params.breach(self._vehicle, fresh_after=asked - STATUS_S)
        settings = fence_params.settings_of(self._vehicle.family, held)
        status = self._fence_status()
        status = {
            **settings.as_dict(),
            "breached": beyond,
            "breaches": None if status is None else status["breach_count"],
            "from_home_m": _rounded(fence_params.from_home_m(self._vehicle)),
            "last_text": self._last_text,
        }
        where = {None: "", True: "; OUTSIDE", False: "; inside"}[beyond]
        return FenceOutcome(Outcome(True, "accepted", f"the fence is {settings}{where}"), status)

    async def test(self, *, radius_m: float, action: str, timeout_s: float) -> FenceOutcome:
        """The whole test. Ok if the vehicle reported the breach and, if armed, acted as its fence demands."""
        if self._watch.testing:
            return FenceOutcome(_UNDER_TEST)
        self._watch.testing, self._ended_with = True, None
        # a task of its own, which the daemon's end can cancel without its caller
        work = self._tested(radius_m, action, timeout_s)
        self._tester = self._loop.create_task(work, name=f"{self._vehicle.name} fence test")
        try:
            return await self._tester
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if task is None or not task.cancelling():  # the test was ended, not its caller
                return FenceOutcome(self._ended_with or Outcome(False, "cancelled", "cancelled"))
            self._tester.cancel()
            await asyncio.wait({self._tester})
            raise
        finally:
            self._tester = None
            self._watch.testing = bool(self._endings)

    async def _tested(self, radius_m: float, action: str, timeout_s: float) -> FenceOutcome:
        vehicle = self._vehicle
        # what it holds now, and what the test sets
        try:
            require_connected(vehicle, self._loop.time())
            fence_params.names_of(vehicle)
            await self._request("HOME_POSITION")
            fence_params.require_testable(vehicle, self._loop.time(), radius_m)
            held = await self._held()
            if isinstance(held, Outcome):
                return FenceOutcome(held)
            wanted = fence_params.changes(vehicle.family, held, radius_m=radius_m, height_m=0.0, action=action)
        except RefusedError as error:
            return FenceOutcome(_refused(error))
        # on disk before anything changes: the record and the journal entry
        record: dict[str, Any] = {
            "vehicle": vehicle.name,
            "sysid": vehicle.sysid,
            "autopilot": vehicle.family,
            "began": _clock(),
            "radius_m": radius_m,
            "action": action,
            "before": dict(held),
            "state": "running: the parameters under 'before' are to be restored",
        }
        try:
            path = await self._disk.run("the record of a fence test", partial(self._write, None, dict(record)))
        except OSError as error:
            text = f"refused: the record cannot be written to {self._log_dir}: {error.strerror or error}"
            return FenceOutcome(Outcome(False, "refused", text))
        back = fence_params.back_to(vehicle.family, held, wanted)
        try:
            begin = partial(self._journal.begin, vehicle.name, vehicle.sysid, vehicle.family, "fence test", back)
            change = await self._disk.run("the undo journal", partial(begin, {n: wanted.get(n, back[n]) for n in back}))
        except RefusedError as error:
            return FenceOutcome(_refused(error))
        except OSError as error:
            text = f"refused: the undo journal cannot be written in {self._journal.folder}: {error.strerror or error}"
            return FenceOutcome(Outcome(False, "refused", text))
        # the test, which is undone however it ends
        outcome = Outcome(False, "cancelled", "cancelled")
        self._walk = walk = _Walk(self._loop.time(), vehicle.mode, vehicle.armed, vehicle.armed)
        try:
            failed = await self._put_whole(wanted)
            outcome = failed or await self._walked(walk, action, timeout_s)
        finally:
            self._walk = None
            ending = self._loop.create_task(self._end(path, record, walk, change, outcome))
            self._endings.add(ending)
            ending.add_done_callback(self._ended)
            outcome = await asyncio.shield(ending)
        return FenceOutcome(outcome, record=record)

    # -- the walk

    async def _walked(self, walk: _Walk, action: str, timeout_s: float) -> Outcome:
        self._report(f"fence test: carry it out of {self._vehicle.name}'s fence now", {"state": "walk"})
        vehicle, next_ask = self._vehicle, self._loop.time()
        walk.began = self._loop.time()
        while True:
            now = self._loop.time()
            if self._reports_status and now >= next_ask:
                next_ask = now + ASK_S
                await self._request("FENCE_STATUS")
            self._look(walk, action, now)
            if walk.breached_at is not None and (walk.reacted or now - walk.breached_at >= AFTER_S):
                return self._judged(walk, action)
            if not vehicle.connected:
                return Outcome(False, "lost", "it was lost during the test", elapsed_s=now - walk.began)
            if walk.breached_at is None and now - walk.began >= timeout_s:
                text = f"timeout: no breach reported in {timeout_s:g} s; it came {walk.farthest_m:.1f} m from its home"
                return Outcome(False, "timeout", text, elapsed_s=now - walk.began)
            await asyncio.sleep(LOOK_S)

    def _look(self, walk: _Walk, action: str, now: float) -> None:
        vehicle = self._vehicle
        away_m = fence_params.from_home_m(vehicle)
        if away_m is not None:
            walk.farthest_m = max(walk.farthest_m, away_m)
        if fence_params.breach(vehicle, fresh_after=walk.began):
            walk.sign("its telemetry shows the breach", now)
        walk.was_armed = walk.was_armed or vehicle.armed
        if vehicle.mode != walk.mode and vehicle.mode in fence_params.REACTIONS.get(action, ()) and vehicle.armed:
            walk.sign(f"it went from {walk.mode} to {vehicle.mode}", now)
            walk.reacted = True
        if walk.armed and not vehicle.armed and walk.breached_at is not None:
            walk.sign("it disarmed", now)
            walk.reacted = True
        walk.armed = vehicle.armed
        if walk.breached_at is not None and walk.breached_m is None and away_m is not None:
            walk.breached_m = away_m

    def _judged(self, walk: _Walk, action: str) -> Outcome:
        assert walk.breached_at is not None
        where = "" if walk.breached_m is None else f" {walk.breached_m:.1f} m from home"
        text = f"breached{where} after {walk.breached_at - walk.began:.0f} s: {'; '.join(walk.signs)}"
        elapsed_s = self._loop.time() - walk.began
        if walk.reacted or action in ("none", "warn"):
            return Outcome(True, "accepted", text, elapsed_s=elapsed_s)
        if walk.was_armed:
            message = f"{text}; but it was armed and did not {action} within {AFTER_S:g} s"
            return Outcome(False, "failed", message, elapsed_s=elapsed_s)
        message = f"{text}; it was not armed, so that what it does then was not tested"
        return Outcome(True, "accepted", message, elapsed_s=elapsed_s)

    async def _end(
        self, path: Path, record: dict[str, Any], walk: _Walk, change: UndoableChange, outcome: Outcome
    ) -> Outcome:
        """Restore the parameters, write the record, report."""
        # put the fence back; the undo journal keeps the change where that fails
        failed = await self._put_back(change.before)
        message = outcome.message
        if failed is None:
            message += "; the fence is as before"
            try:
                await self._disk.run("the undo journal", partial(self._journal.undone, change))
            except OSError as error:
                message += f" (its note {change.id} in {self._journal.folder} cannot be removed: {error.strerror})"
        else:
            self._disk.offer("the undo journal", partial(self._journal.left_over, change))
            message += f"; THE FENCE IS NOT AS BEFORE ({failed.message}): skygcs-cli undo run {change.id} restores it"
        # complete the outcome and the record
        ok = outcome.ok and failed is None
        ended = Outcome(
            ok, outcome.result if ok or not outcome.ok else "failed", message, elapsed_s=self._loop.time() - walk.began
        )
        record |= {
            "ended": _clock(),
            "state": "done",
            "ok": ok,
            "message": message,
            "breached": walk.breached_at is not None,
            "after_s": None if walk.breached_at is None else round(walk.breached_at - walk.began, 1),
            "breached_at_m": _rounded(walk.breached_m),
            "farthest_m": _rounded(walk.farthest_m),
            "armed": walk.was_armed,
            "reacted": walk.reacted,
            "signs": walk.signs,
            "restored": failed is None,
            "file": str(path),
        }
        # write the record and report the end
        try:
            await self._disk.run("the record of a fence test", partial(self._write, path, dict(record)))
        except OSError as error:
            record["file"] = None
            self._report(f"fence test: {path} cannot be written: {error.strerror or error}", {})
        self._report(f"fence test: {message}", {"state": "done", "ok": ok, "file": record["file"]})
        self._ended_with = ended
        return ended

    def _ended(self, ending: asyncio.Task[Outcome]) -> None:
        self._endings.discard(ending)
        self._watch.testing = False

    # -- parameters and messages

    async def _held(self) -> dict[str, float] | Outcome:
        """The present fence parameters; or the outcome to return if one cannot be read."""
        try:
            require_connected(self._vehicle, self._loop.time())
            names = fence_params.names_of(self._vehicle)
        except RefusedError as error:
            return _refused(error)
        held: dict[str, float] = {}
        for name in names:
            read = await self._params.get(name)
            if read.number is None:
                result = read.result if read.result in ("timeout", "lost", "cancelled", "refused") else "failed"
                return Outcome(False, result, f"{name} cannot be read: {read.why_no_number}")
            held[name] = float(read.number)
        return held

    async def _put(self, values: Mapping[str, float], *, checked: bool = False) -> Outcome | None:
        """Set these in order; returns the outcome if not all of them were accepted. ``checked``: as one fence, by the
        locks of all flights, which would refuse its parameters one by one. In the air, too: the checks of the fence and
        of its test stand for the outgoing gate's, and what a test has set must be put back wherever the vehicle is."""
        outcomes = await self._params.set(values, force=True, checked=checked)
        wrong = [outcome for outcome in outcomes.values() if not outcome.ok]
        if not wrong:
            return None
        return Outcome(False, "failed", "; ".join(f"{o.name}: {o.message}" for o in wrong))

    async def _put_back(self, values: Mapping[str, float]) -> Outcome | None:
        """First the parameter that switches the fence, then all others at the same time: a daemon that ends has little
        time."""
        first = {name: value for name, value in list(values.items())[:1] if name == "FENCE_ENABLE"}
        failed = await self._put(first) if first else None
        rest = [self._put({name: value}) for name, value in values.items() if name not in first]
        outcomes = [failed, *await asyncio.gather(*rest)]
        wrong = "; ".join(outcome.message for outcome in outcomes if outcome is not None)
        return Outcome(False, "failed", wrong) if wrong else None

    async def _put_whole(self, values: Mapping[str, float]) -> Outcome | None:
        """`_put` which, when cancelled, first finishes the parameter in transfer: a late answer to it could be taken
        for an answer to the undo."""
        for name, value in values.items():
            setting = self._loop.create_task(self._put({name: value}), name=f"{self._vehicle.name} {name}")
            try:
                failed = await asyncio.shield(setting)
            except asyncio.CancelledError:
                await asyncio.wait({setting}, timeout=FINISH_S)
                setting.cancel()
                raise
            if failed is not None:
                return failed
        return None

    @property
    def _reports_status(self) -> bool:
        return self._vehicle.family == "ardupilot" and "FENCE_STATUS" in self._dialect.by_name

    def _fence_status(self) -> Mapping[str, Any] | None:
        slot = self._vehicle.slot("FENCE_STATUS")
        return None if slot is None or slot.frame is None else slot.frame.fields()

    def _write(self, path: Path | None, record: Mapping[str, Any]) -> Path:
        """Raises OSError."""
        if path is None:
            make_log_folder(self._log_dir)
            name = "".join(c if c.isalnum() else "_" for c in self._vehicle.name)
            path = self._log_dir / f"fence-test-{name}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}.json"
        write_whole(path, (json.dumps(record, indent=2) + "\n").encode(), LOG_MODE, durable=False)
        return path

    def _report(self, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event("fence", self._vehicle.name, self._vehicle.sysid, text, data))


_UNDER_TEST = Outcome(False, "refused", "refused: its fence is being tested; wait for the end, or cancel the test")


def _refused(error: RefusedError) -> Outcome:
    return Outcome(False, "refused", f"refused: {error}")


def _clock() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
