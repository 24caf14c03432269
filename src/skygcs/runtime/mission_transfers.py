"""Transfers of missions, fences and rally points of one vehicle: the asyncio side of the mission protocol.

One transfer at a time: an autopilot handles one, whatever its type. The next one waits.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Collection
from dataclasses import replace
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import EVENT as EVENT_ID
from skygcs.core.mavlink.msgids import MISSION_CURRENT, MISSION_ITEM_REACHED
from skygcs.core.mission.fence import FencePlan
from skygcs.core.mission.firmware_items import ItemChange, grouped
from skygcs.core.mission.item import MissionItem, MissionType, item_of_seq
from skygcs.core.mission.plan import MissionPlan, from_wire
from skygcs.core.protocols.base import Effect, ProgressReport, Send
from skygcs.core.protocols.command import MAX_TEXTS, SETTLE_S, Outcome
from skygcs.core.protocols.mission import (
    ACCEPTED,
    ANSWERS,
    MissionClear,
    MissionDownload,
    MissionOutcome,
    MissionProtocol,
    opaque_id,
)
from skygcs.core.protocols.mission_upload import EVENT, LINGER_S, MissionUpload, rejection
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.gate import standing
from skygcs.core.vehicle.mission_orders import (
    Progress,
    converted,
    firmware_family,
    keeps_home,
    keeps_old,
    number_of,
    on_wire,
    require_clearable,
    require_uploadable,
    with_downloaded,
)
from skygcs.core.vehicle.orders import require_connected
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.command_client import CommandClient
from skygcs.runtime.loop_clock import DeadlineTimer
from skygcs.runtime.order_runner import duplicate_refusal
from skygcs.runtime.task_set import TaskSet

UPLOAD = standing("mission upload")

NEEDED = ("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_INT", "MISSION_REQUEST_LIST", "MISSION_CLEAR_ALL",
          "MISSION_ACK")  # fmt: skip
"""Messages without which a dialect cannot carry a mission."""

MESSAGES = frozenset({40, MISSION_CURRENT, 44, MISSION_ITEM_REACHED, 47, 51, 73, EVENT_ID})
"""Ids of the messages that `on_frame` needs."""

ALL_LISTS = 255
"""MAV_MISSION_TYPE_ALL: a MISSION_CLEAR_ALL may be for all lists, and its MISSION_ACK then is."""

ID_OFFSETS = {MissionType.MISSION: 6, MissionType.FENCE: 10, MissionType.RALLY: 14}
"""Where MISSION_CURRENT has the numbers of the lists; see `opaque_id`."""

REPORT_STEP = 10
"""Step of the progress reports in percent: a report per item would be two hundred events."""

MAX_WAITING = 4

MAX_CHANGES = 5
"""Kinds of changes to a mission that the outcome of its upload names."""

NO_MISSION = 1

STATES = {NO_MISSION: "no mission", 2: "not started", 3: "active", 4: "paused", 5: "complete"}
"""MISSION_STATE."""

STATE_TEXTS = {NO_MISSION: "it has no mission", **{state: f"its mission is {STATES[state]}" for state in (2, 3, 4, 5)}}

Held = Callable[[MissionType], str | None]
Check = Callable[[], None]


class Missions:
    """The mission, fence and rally points of one vehicle. ``on_progress(what, percent)`` gets the progress of
    transfers; the mission's is reported as events."""

    def __init__(
        self,
        vehicle: Vehicle,
        commands: CommandClient,
        dialect: Dialect,
        loop: asyncio.AbstractEventLoop,
        on_progress: Callable[[str, int | None], None],
        on_event: Callable[[Event], None],
    ) -> None:
        # lists on board, as far as they are known
        self._counts: dict[MissionType, int] = {}
        """Number of items in each list as last sent or read here, without home."""
        self._items: tuple[MissionItem, ...] | None = None
        """The mission as last sent or read here."""
        self._opaque_ids: dict[MissionType, int | None] = {}
        """The vehicle's own numbers for these lists; None: it gave none."""
        self._heard_ids: dict[MissionType, int | None] = {}
        """The numbers that it reported last."""
        self._doubted: set[MissionType] = set()
        """Lists that may have changed unheard: it was lost, or has rebooted. Its number for one ends the doubt."""
        self.last: dict[MissionType, MissionOutcome] = {}
        """Outcome of the last transfer of each list."""
        # collaborators
        self._vehicle = vehicle
        self._commands = commands
        self._dialect = dialect
        self._loop = loop
        self._on_progress = on_progress
        self._on_event = on_event
        # the transfer in progress
        self._closed = ""
        """Why it was closed."""
        self._lock = asyncio.Lock()
        self._waiting = 0
        self._running: tuple[MissionProtocol, asyncio.Future[None], str] | None = None
        self._reported_percent = 0
        self._percent: int | None = None
        self._done_upload: tuple[MissionUpload, float] | None = None
        self._rejections: deque[str] = deque(maxlen=MAX_TEXTS)
        """Why a PX4 rejects its mission, since the last transfer began."""
        self._crossed = False
        """Another station has changed the list that is being transferred."""
        self._timer = DeadlineTimer(loop, self._on_timer)
        self._tasks = TaskSet(loop, on_event, vehicle.name, vehicle.sysid)
        self._reading: asyncio.Task[Any] | None = None
        """The download of `known_items`."""
        # progress of the mission as the vehicle reports it
        self._current = b""
        self._seq: int | None = None
        self._state = 0
        self._progress = Progress()
        self._completed: Progress | None = None
        """The last run that came to its end."""
        self._total: int | None = None
        """Number of items that it reports, without home; None: it does not report it."""

    async def _upload(self, kind: MissionType, items: tuple[MissionItem, ...], may_begin: Check) -> MissionOutcome:
        """Upload ``items`` as on the wire (`mission_orders.on_wire`); an empty list clears the vehicle's list."""
        if not items:
            return await self._clear(kind, may_begin)
        home_first = kind is MissionType.MISSION and keeps_home(self._vehicle)
        protocol = MissionUpload(
            kind,
            items,
            keeps_old=keeps_old(self._vehicle, kind),
            first_number=item_of_seq(0, home_first=home_first),
            home_first=home_first,
            family=firmware_family(self._vehicle),
        )
        return await self._run(protocol, f"{kind.word} upload", may_begin)

    async def _feasible(self, outcome: MissionOutcome) -> MissionOutcome:
        """A PX4 accepts a mission and checks it afterwards; only an event or a text reports that it is rejected."""
        if self._vehicle.family != "px4":
            return outcome
        await asyncio.sleep(SETTLE_S)
        if not self._rejections:
            return outcome
        reasons = tuple(dict.fromkeys(self._rejections))
        message = f"{outcome.message}, and it will not fly them: {'; '.join(reasons)}"
        return replace(outcome, ok=False, result="denied", message=message)

    async def download(self, kind: MissionType) -> MissionOutcome:
        """Download one list; its ``items`` are as on the wire."""
        return await self._run(MissionDownload(kind), f"{kind.word} download")

    async def _clear(self, kind: MissionType, may_begin: Check) -> MissionOutcome:
        return await self._run(MissionClear(kind), f"{kind.word} clear", may_begin)

    async def bring(
        self, plan: MissionPlan, kinds: Collection[MissionType], held: Held, *, limit_m: float, force: bool
    ) -> Outcome:
        """Check these lists of a plan and upload them, fence first; stops at the first that is not accepted.

        ``held(kind)``: why a flight holds that list; None: none does. Everything is checked before the first list is
        sent, and each list again when its turn comes: a flight may have begun while it waited."""
        kinds = _ordered(kinds)
        vehicle, dialect = self._vehicle, self._dialect

        def require(kinds: tuple[MissionType, ...]) -> None:
            _require_free(kinds, held)
            require_uploadable(vehicle, self._loop.time(), plan, kinds, dialect, limit_m=limit_m, force=force)

        async def one(kind: MissionType) -> MissionOutcome:
            return await self._upload(kind, on_wire(vehicle, plan, kind, dialect), lambda: require((kind,)))

        if (refused := _raised_by(lambda: require(kinds))) is not None:
            return Outcome.refused(str(refused))
        outcome = await self._each(kinds, one)
        changes = converted(vehicle, plan, dialect).changes if MissionType.MISSION in kinds else ()
        return replace(outcome, message="; ".join((outcome.message, *_change_texts(changes)))) if changes else outcome

    async def drop(self, kinds: Collection[MissionType], held: Held, *, force: bool) -> Outcome:
        """Clear these lists; ``held`` and checks as for `bring`."""
        kinds = _ordered(kinds)

        def require(kinds: tuple[MissionType, ...]) -> None:
            _require_free(kinds, held)
            require_clearable(self._vehicle, self._loop.time(), kinds, force=force)

        if (refused := _raised_by(lambda: require(kinds))) is not None:
            return Outcome.refused(str(refused))
        return await self._each(kinds, lambda kind: self._clear(kind, lambda: require((kind,))))

    async def fetch(self, kinds: Collection[MissionType]) -> tuple[Outcome, MissionPlan]:
        """Download these lists; the plan contains those that came, and an ArduPilot's home."""
        plan = MissionPlan()
        vehicle = self._vehicle

        async def one(kind: MissionType) -> MissionOutcome:
            nonlocal plan
            outcome = await self.download(kind)
            if outcome.items is None:
                return outcome
            try:
                plan = with_downloaded(vehicle, plan, kind, outcome.items)
            except ValueError as error:
                return replace(outcome, ok=False, result="failed", message=f"not a {kind.word}: {error}")
            return outcome

        try:
            require_connected(vehicle, self._loop.time())
        except RefusedError as error:
            return Outcome.refused(str(error)), plan
        return await self._each(_ordered(kinds), one), plan

    def count(self, kind: MissionType) -> int | None:
        """Number of items of that list as last sent or read here, without home; None: not known, or the vehicle reports
        another list since."""
        count = self._counts.get(kind)
        if self._opaque_ids.get(kind) != self._heard_ids.get(kind):
            return None
        return None if kind is MissionType.MISSION and self._total not in (None, count) else count

    @property
    def items(self) -> tuple[MissionItem, ...] | None:
        """The mission as last sent or read here, with the numbers that it has on board; None as of `count`. One that
        was lost may have another by now: see `known_items`."""
        return None if self.count(MissionType.MISSION) is None else self._items

    def _is_known(self, kind: MissionType) -> bool:
        running = None if self._running is None else self._running[0]
        changing = running is not None and running.kind is kind and not isinstance(running, MissionDownload)
        return self.count(kind) is not None and kind not in self._doubted and not changing

    def forget(self, kind: MissionType) -> None:
        """The vehicle holds another list of that kind than was sent or read here."""
        self._counts.pop(kind, None)
        self._opaque_ids.pop(kind, None)
        if self._running is not None and self._running[0].kind is kind:
            self._crossed = True

    async def known_items(self, within_s: float | None = None) -> tuple[MissionItem, ...] | None:
        """The mission on board, read if it is not known, or may not be the one that was sent from here; None: it could
        not be read, or not ``within_s``. One reading serves all who ask meanwhile."""
        if not self._is_known(MissionType.MISSION):
            if self._reading is None or self._reading.done():
                self._reading = self._tasks.start(self.fetch([MissionType.MISSION]), "reading of its mission")
            await asyncio.wait({self._reading}, timeout=within_s)
        return self.items if self._is_known(MissionType.MISSION) else None

    async def fence_shapes(self) -> FencePlan | None:
        """The polygons and circles that it has, downloaded unless it is known to have none; None: not known."""
        if self._is_known(MissionType.FENCE) and self.count(MissionType.FENCE) == 0:
            return FencePlan()
        outcome, plan = await self.fetch([MissionType.FENCE])
        return (plan.fence or FencePlan()) if outcome.ok else None

    async def _each(
        self, kinds: tuple[MissionType, ...], transfer: Callable[[MissionType], Awaitable[MissionOutcome]]
    ) -> Outcome:
        """Run one transfer after the other; one outcome states how far they came."""
        texts: list[str] = []
        sent, began = 0, self._loop.time()
        for done, kind in enumerate(kinds):
            outcome = await transfer(kind)
            sent += outcome.sent
            texts.append(outcome.message if kind.word in outcome.message else f"{kind.word}: {outcome.message}")
            elapsed_s = self._loop.time() - began
            if outcome.result == "timeout":
                texts[-1] += self._commands.why_silent()
            if not outcome.ok:
                if rest := kinds[done + 1 :]:
                    texts.append(f"{' and '.join(k.word for k in rest)} not begun")
                return Outcome(False, outcome.result, "; ".join(texts), sent, elapsed_s, outcome.status_texts)
        return Outcome(True, "accepted", "; ".join(texts), sent, self._loop.time() - began)

    def status(self) -> dict[str, Any]:
        """The mission state that the vehicle reports, and the transfer in progress."""
        transfer = None
        if self._running is not None:
            protocol, _, what = self._running
            transfer = {"what": what, "percent": self._percent, "sent": protocol.sent}
        return {
            "item": None if self._seq is None else number_of(self._vehicle, self._seq),
            "reached": self._progress.reached,
            "state": STATES.get(self._state),
            "counts": {kind.word: self.count(kind) for kind in MissionType},
            "opaque_ids": {kind.word: self._opaque_ids.get(kind) for kind in MissionType},
            "transfer": transfer,
            "last": {kind.word: self.last[kind].as_dict() if kind in self.last else None for kind in MissionType},
        }

    def on_frame(self, frame: Frame, now: float) -> None:
        """A frame of this vehicle with one of MESSAGES, to any station."""
        if frame.msgid == MISSION_CURRENT:
            self._on_current(frame)
        elif frame.msgid == MISSION_ITEM_REACHED:
            self._on_reached(frame.fields()["seq"])
        elif frame.name == EVENT:
            if (reason := rejection(frame.fields()["id"])) is not None:
                self._rejections.append(reason)
        elif frame.name in ANSWERS:
            self._on_answer(frame, now)

    def on_text(self, text: str) -> None:
        """A status text of this vehicle, which may be the reason of a refusal."""
        if "mission rejected" in text.lower():
            self._rejections.append(text)
        if self._running is not None:
            self._running[0].on_text(text)

    def stop(self, result: str, message: str) -> None:
        """The vehicle is lost, has rebooted or is no more ours to order: what it holds may change unheard."""
        self._done_upload = None
        self._doubted.update(MissionType)
        self._current = b""
        if self._running is not None:
            protocol, _, what = self._running
            self._cut(protocol, what, result, message)

    def close(self, reason: str) -> None:
        """The daemon ends, or the vehicle is dropped: end the transfer for this reason."""
        self._closed = reason
        self.stop("cancelled", reason)
        self._tasks.close()
        self._timer.set(None)

    async def _run(self, protocol: MissionProtocol, what: str, may_begin: Check | None = None) -> MissionOutcome:
        """Run one transfer when its turn comes, unless ``may_begin`` raises RefusedError then."""
        missing = [name for name in NEEDED if name not in self._dialect.by_name]
        if missing:
            text = f"dialect {self._dialect.name} has no {missing[0]}"
            return MissionOutcome(False, "refused", text, protocol.kind, "unchanged")
        if self._waiting >= MAX_WAITING:
            text = f"{self._waiting} transfers are waiting already"
            return MissionOutcome(False, "refused", text, protocol.kind, "unchanged")
        self._waiting += 1
        try:
            await self._lock.acquire()
        finally:
            self._waiting -= 1
        try:
            if self._closed:  # while it waited for its turn
                return MissionOutcome(False, "cancelled", f"cancelled: {self._closed}", protocol.kind, "unchanged")
            if self._vehicle.duplicate:
                refused = duplicate_refusal(self._vehicle)
                return MissionOutcome(False, refused.result, refused.message, protocol.kind, "unchanged")
            if may_begin is not None and (refused_by := _raised_by(may_begin)) is not None:
                return MissionOutcome(False, "refused", f"refused: {refused_by}", protocol.kind, "unchanged")
            outcome = await self._protocol(protocol, what)
            if outcome.ok and isinstance(protocol, MissionUpload) and protocol.kind is MissionType.MISSION:
                return await self._feasible(outcome)
            return outcome
        finally:
            self._lock.release()

    async def _protocol(self, protocol: MissionProtocol, what: str) -> MissionOutcome:
        over: asyncio.Future[None] = self._loop.create_future()
        self._running = (protocol, over, what)
        self._done_upload = None
        self._rejections.clear()
        self._crossed = False
        self._reported_percent, self._percent = 0, None
        try:
            self._apply(protocol.start(self._loop.time()))
            await over
        except asyncio.CancelledError:
            self._cut(protocol, what, "cancelled", "cancelled")
            raise
        finally:
            self._running = None
            self._timer.set(None)
            if protocol.outcome is not None:
                self._note(protocol, protocol.outcome)
        assert protocol.outcome is not None
        return protocol.outcome

    def _cut(self, protocol: MissionProtocol, what: str, result: str, message: str) -> None:
        """End a transfer before its end. Who asked may be gone: a warning says what the vehicle holds then."""
        begun = protocol.outcome is None
        self._apply(protocol.stop(self._loop.time(), result, message))
        outcome = protocol.outcome
        if begun and outcome is not None and not isinstance(protocol, MissionDownload):
            self._publish("warning", f"{what}: {outcome.message}", outcome.as_dict())

    def _note(self, protocol: MissionProtocol, outcome: MissionOutcome) -> None:
        """Note what the vehicle holds after a transfer."""
        kind, items = protocol.kind, outcome.items or ()
        self.last[kind] = replace(outcome, items=None)
        if not outcome.ok or self._crossed:
            if self._crossed or outcome.state in ("partial", "unknown"):
                self.forget(kind)
            return
        if isinstance(protocol, MissionUpload):
            self._done_upload = (protocol, self._loop.time())
        home_first = kind is MissionType.MISSION and keeps_home(self._vehicle) and bool(items)
        self._counts[kind] = len(items) - home_first
        self._opaque_ids[kind] = self._heard_ids[kind] = outcome.opaque_id
        self._doubted.discard(kind)
        if kind is MissionType.MISSION:
            before, self._items = self._items, from_wire(items, first_is_home=home_first)
            if not isinstance(protocol, MissionDownload) or self._items != before:
                self._progress = Progress()  # what was reached was of the one before
            self._total, self._current = None, b""

    def _apply(self, effects: tuple[Effect, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                self._commands.transmit(effect.message, effect.values, Priority.PROTOCOL, clearance=UPLOAD)
            elif isinstance(effect, ProgressReport):
                self._report(effect.percent)
        if self._running is None:
            return
        protocol, over, _ = self._running
        if protocol.done and not over.done():
            over.set_result(None)
        self._timer.set(protocol.deadline)

    def _report(self, percent: int | None) -> None:
        self._percent = percent
        if self._running is None or percent is None or percent < self._reported_percent + REPORT_STEP:
            return
        self._reported_percent = percent - percent % REPORT_STEP
        self._on_progress(self._running[2], self._reported_percent)

    def _on_timer(self) -> None:
        if self._running is not None:
            self._apply(self._running[0].on_timer(self._loop.time()))

    def _on_answer(self, frame: Frame, now: float) -> None:
        fields = frame.fields()
        if not self._for_us(fields):
            self._on_answer_elsewhere(frame.name, fields)
            return
        protocol = None if self._running is None else self._running[0]
        if protocol is None and self._done_upload is not None:
            protocol, done_at = self._done_upload
            if now - done_at > LINGER_S:
                self._done_upload = protocol = None
        if protocol is None or fields.get("mission_type", 0) != protocol.kind:
            return
        self._apply(protocol.on_message(frame.name, fields, frame.payload, now))

    def _on_answer_elsewhere(self, name: str, fields: dict[str, Any]) -> None:
        """An answer to another station: it is changing a list if its items are asked for, and has if they are
        accepted."""
        accepted = name == "MISSION_ACK" and fields["type"] == ACCEPTED
        asked = name in ("MISSION_REQUEST_INT", "MISSION_REQUEST")
        for kind in MissionType:
            changed = accepted or (asked and not keeps_old(self._vehicle, kind))
            if changed and fields.get("mission_type", 0) in (kind, ALL_LISTS):
                self.forget(kind)

    def _for_us(self, fields: dict[str, Any]) -> bool:
        sysid, compid = self._commands.own
        return fields["target_system"] in (0, sysid) and fields["target_component"] in (0, compid)

    def _on_current(self, frame: Frame) -> None:
        if frame.payload == self._current:
            return
        self._current = frame.payload
        fields = frame.fields()
        seq, state = fields["seq"], fields.get("mission_state", 0)
        total = fields.get("total", 0)  # 65535: none; 0: not sent, or none of an ArduPilot that says so
        self._total = 0 if total == 0xFFFF or (total == 0 and state == NO_MISSION) else total or None
        for kind, offset in ID_OFFSETS.items():
            number = self._heard_ids[kind] = opaque_id(frame.payload, offset)
            if number is not None and number == self._opaque_ids.get(kind):
                self._doubted.discard(kind)
        if self._seq is not None and seq != self._seq:
            number = number_of(self._vehicle, seq)
            self._publish("mission", f"goes on with item {number}", {"item": number})
        if state != self._state and self._state and state in STATES:
            self._publish("mission", STATE_TEXTS[state], {"state": STATES[state]})
        self._seq, self._state = seq, state
        self._progress.on_current(number_of(self._vehicle, seq))
        self._note_end()

    def _on_reached(self, seq: int) -> None:
        number = number_of(self._vehicle, seq)
        if not self._progress.on_reached(number):
            return
        self._note_end()
        self._publish_reached(number)

    def _publish_reached(self, number: int) -> None:
        count = self.count(MissionType.MISSION)
        of = f" of {count}" if count else ""
        self._publish("mission", f"reached item {number}{of}", {"reached": number, "count": count})

    def run_begins(self, first: int | None = None) -> Callable[[], None]:
        """It is ordered to fly its mission from item ``first`` on, or from the current one: what was reached before
        counts no more. Call what is returned if it does not take the order: the run before goes on."""
        before, begun = self._progress, Progress(first)
        self._progress, self._current = begun, b""

        def goes_on() -> None:
            if self._progress is begun:
                self._progress, self._current = before, b""
                if (number := before.go_on_after(begun)) is not None:
                    self._publish_reached(number)
                self._note_end()

        return goes_on

    @property
    def complete(self) -> bool:
        """True if it has reported the last item of the mission that is on board as reached, in this run of it."""
        return self._completed is self._progress

    def _note_end(self) -> None:
        if self._progress.complete(self.count(MissionType.MISSION)):
            self._completed = self._progress

    @property
    def furthest(self) -> int:
        """The highest item that was its current one in this run of its mission; 0: none was."""
        return self._progress.furthest

    def begun(self, item: int | None) -> bool:
        """True if that item of the mission, or a later one, was its current one in this run of it."""
        return item is not None and self._progress.furthest >= item

    def _publish(self, kind: str, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event(kind, self._vehicle.name, self._vehicle.sysid, text, data))


def _change_texts(changes: tuple[ItemChange, ...]) -> list[str]:
    lines = grouped(changes)
    more = [f"and {len(lines) - MAX_CHANGES} more kinds of changes: skygcs-cli mission check lists them"]
    return [f"mission {line}" for line in lines[:MAX_CHANGES]] + (more if len(lines) > MAX_CHANGES else [])


def _require_free(kinds: tuple[MissionType, ...], held: Held) -> None:
    """Raises RefusedError for the first of these lists that a flight holds."""
    for kind in kinds:
        if (why := held(kind)) is not None:
            raise RefusedError(why)


def _raised_by(check: Check) -> RefusedError | None:
    """The refusal that a check raises; None if it raises none."""
    try:
        check()
    except RefusedError as error:
        return error
    return None


def _ordered(kinds: Collection[MissionType]) -> tuple[MissionType, ...]:
    """Fence, rally points, mission: the protecting lists first."""
    return tuple(kind for kind in (MissionType.FENCE, MissionType.RALLY, MissionType.MISSION) if kind in kinds)
