"""Undoes changes that were left in a vehicle, on request; see `UndoJournal`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.orders import FORCE_HINT, require_connected
from skygcs.disk_writer import DiskWriter
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.undo_journal import UndoableChange, UndoJournal
from skygcs.runtime.vehicle_actor import VehicleActor

SAME = 1e-6
"""Relative difference below which two values of a parameter are equal: it is a 32-bit float on the wire."""

JOURNAL = "the undo journal"

T = TypeVar("T")


class UndoOrders:
    """`left`, `run` and `drop` serve the RPC. ``vehicles``: by sysid << 8 | compid."""

    def __init__(
        self,
        journal: UndoJournal,
        vehicles: Mapping[int, VehicleActor],
        now: Callable[[], float],
        disk: DiskWriter,
        on_event: Callable[[Event], None],
    ) -> None:
        self._journal = journal
        self._vehicles = vehicles
        self._now = now
        self._disk = disk
        self._on_event = on_event
        self._running: set[str] = set()
        self._reading: asyncio.Future[list[UndoableChange]] | None = None

    async def left(self) -> dict[str, Any]:
        """JSON-able: entries that wait for their undo, and files that cannot be read. Raises RefusedError if the disk
        does not answer. One reading serves all who ask before it is done: other journals wait for the same disk."""
        if self._reading is None or self._reading.done():
            self._reading = self._disk.offer(JOURNAL, self._journal.left)
        changes = [change.as_dict() for change in await self._outcome(self._reading)]
        return {"changes": changes, "problems": list(self._journal.problems)}

    async def drop(self, id: str) -> None:
        """Remove an entry. Raises RefusedError."""
        change = await self._with_disk(partial(self._journal.find, id))
        if id in self._running:
            raise RefusedError(f"{id} is being undone just now")
        await self._with_disk(partial(self._journal.drop, change))
        self._publish(
            change, f"{change.what} of {change.began}: entry removed, nothing is undone", {"id": id, "state": "dropped"}
        )

    async def run(self, id: str, *, force: bool = False) -> Outcome:
        """Restore the values of one entry, and read them back. Raises RefusedError for an unknown id.

        Without ``force`` it is refused for an armed vehicle, and if a parameter has neither its old value nor that of
        the change: another program has set it since.
        """
        change = await self._with_disk(partial(self._journal.find, id))
        if id in self._running:
            raise RefusedError(f"{id} is being undone just now")
        self._running.add(id)
        try:
            outcome = await self._undo(change, force=force)
        except RefusedError as error:
            outcome = Outcome.refused(str(error))
        finally:
            self._running.discard(id)
        text = f"undo of {change.what}: {outcome.message}"
        self._publish(change, text, {"id": id, "state": "undone" if outcome.ok else "left", "result": outcome.result})
        return outcome

    async def _undo(self, change: UndoableChange, *, force: bool) -> Outcome:
        # refuse while a change would be dangerous
        actor = self._actor(change)
        require_connected(actor.vehicle, self._now())
        if actor.vehicle.armed and not force:
            raise RefusedError(f"it is armed; {FORCE_HINT}")
        if actor.fence_watch.testing:
            raise RefusedError("its fence is being tested")
        # find the parameters that differ; one that was changed since needs force
        to_set: dict[str, float] = {}
        for name, before in change.before.items():
            held = await actor.params.get(name)
            if held.param is None:
                return Outcome(False, held.result, f"{name} cannot be read: {held.message}")
            value = held.param.value  # compared and shown only: NaN is what nobody set
            if _same(value, before):
                continue
            if not force and not _same(value, change.changed.get(name, before)):
                by_test = change.changed.get(name, before)
                raise RefusedError(
                    f"{name} is {value:g}, neither {before:g} as before nor {by_test:g} as the {change.what} set it: "
                    f"it was changed since; {FORCE_HINT}"
                )
            to_set[name] = before
        # set them
        outcomes = await actor.params.set(to_set, force=force) if to_set else {}
        wrong = [outcome for outcome in outcomes.values() if not outcome.ok]
        if wrong:
            return Outcome(False, "failed", "; ".join(f"{o.name}: {o.message}" for o in wrong))
        # remove the journal's entry
        try:
            await self._disk.run(JOURNAL, partial(self._journal.undone, change))
        except OSError as error:
            return Outcome(False, "failed", f"it is as before, but {change.id} cannot be removed: {error.strerror}")
        return Outcome(True, "accepted", "it is as before" + (f" ({', '.join(to_set)} set)" if to_set else " already"))

    async def _with_disk(self, job: Callable[[], T]) -> T:
        return await self._outcome(self._disk.offer(JOURNAL, job))

    async def _outcome(self, done: asyncio.Future[T] | None) -> T:
        try:
            return await self._disk.outcome(JOURNAL, done)
        except OSError as error:
            raise RefusedError(f"{self._journal.folder}: {error.strerror or error}") from None

    def _actor(self, change: UndoableChange) -> VehicleActor:
        found = [a for a in self._vehicles.values() if a.sysid == change.sysid and not a.vehicle.replayed]
        if not found:
            raise RefusedError(f"no vehicle with system id {change.sysid} is heard")
        for actor in found:
            if actor.vehicle.family == change.autopilot:
                return actor
        raise RefusedError(f"system {change.sysid} is not a {change.autopilot} now: another vehicle has its id")

    def _publish(self, change: UndoableChange, text: str, data: dict[str, Any]) -> None:
        self._on_event(Event("undo", change.vehicle, change.sysid, text, data))


def _same(one: float, other: float) -> bool:
    return abs(one - other) <= SAME * max(abs(one), abs(other))
