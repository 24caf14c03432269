"""Gives a vehicle another system id: sets the parameter, restarts the autopilot, and finds it again under the new one.

When the new id takes effect differs (from the firmwares' sources): ArduPilot from 4.7 on copies MAV_SYSID at once
(`GCS::update_send`), Plane, Rover and Tracker before it once a second, a Copter up to 4.6 reads
SYSID_THISMAV when it starts (`GCS::init`), PX4 reads MAV_SYS_ID when its MAVLink module starts. So the answer to the
parameter may have either id, or be lost; the id that is heard afterwards decides.

The vehicle keeps its name: the entry of the old id is removed as soon as the vehicle is heard under the new one
(`Fleet`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from skygcs.cancellation import end_if_cancelled
from skygcs.config.tables import key_lines, line_of
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import flight_lock
from skygcs.core.vehicle.flight_evidence import why_not_idle
from skygcs.core.vehicle.orders import FORCE_HINT, require_connected
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.fleet import Expected, Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.vehicle_actor import VehicleActor

MAX_SYSID = 250
"""PX4's largest MAV_SYS_ID; 251 to 255 are ground stations' by convention."""

PARAMETERS = {"px4": "MAV_SYS_ID", "ardupilot": "SYSID_THISMAV"}
"""ArduPilot's is MAV_SYSID from 4.7 on; `VehicleParams` finds it under either name."""

AT_ONCE_S = 3.0
"""Three heartbeats: by then a firmware that copies its parameter at once shows it."""

RETURN_S = 60.0
"""A Pixhawk is back in 5 to 20 s, behind a multipoint radio a few seconds later."""

STILL_S = 10.0
"""If heartbeats of the old id still come this long after the accepted restart, the id has not changed."""

KEPT_S = 900.0
"""How long a vehicle that has to be restarted by hand is expected under the new id."""

HEARD_S = 15.0
"""An id that was heard less than this ago is taken; several heartbeats may be lost on a radio. The old id of a vehicle
is free again after this time."""

ALONE_S = 2.5
"""Two heartbeats: a second vehicle that still has the old id would have been heard by then."""

LOOK_S = 0.1
READ_TRIES = 3

T = TypeVar("T")


class Renumbering:
    """`run` serves the RPC method vehicles.renumber, one vehicle at a time. ``source``: the fleet file, for
    messages."""

    def __init__(
        self, hub: Hub, fleet: Fleet, loop: asyncio.AbstractEventLoop, on_event: Callable[[Event], None], source: str
    ) -> None:
        self._hub = hub
        self._fleet = fleet
        self._loop = loop
        self._on_event = on_event
        self._source = source
        self._busy: str | None = None
        self._change: asyncio.Task[Outcome] | None = None

    def close(self) -> None:
        """The daemon ends: end the change that is under way, with an outcome that says so."""
        if self._change is not None:
            self._change.cancel()

    async def run(self, target: str, sysid: int, *, force: bool = False) -> dict[str, Outcome]:
        """Give it the id; returns the outcome by its name. ``force``: even if the fleet file gives that id to a vehicle
        that is not heard. Raises TargetError."""
        actor = self._fleet.find(target)
        name, before = actor.name, actor.sysid
        if sysid == before:
            return {name: Outcome(True, "accepted", f"it is system {sysid} already")}
        try:
            self._require_possible(actor, sysid, force=force)
        except RefusedError as error:
            return {name: self._finish(name, before, sysid, Outcome.refused(str(error)))}
        self._busy = name
        started = self._loop.time()
        self._change = self._loop.create_task(self._carry(actor, sysid), name=f"{name} gets another id")
        try:
            outcome = await self._change
        except asyncio.CancelledError:
            text = f"cancelled during the change: it may come back as system {before} or {sysid}"
            ended = self._finish(name, before, sysid, Outcome(False, "cancelled", text))
            end_if_cancelled()  # nobody waits for the answer
            return {name: ended}
        finally:
            self._busy = self._change = None
            self._fleet.expect_when_lost(sysid)
        return {name: self._finish(name, before, sysid, replace(outcome, elapsed_s=self._loop.time() - started))}

    # -- checks

    def _require_possible(self, actor: VehicleActor, sysid: int, *, force: bool) -> None:
        # rules of gates and of ids
        vehicle = actor.vehicle
        now = self._loop.time()
        gates = self._hub.send_gates
        if gates is not None and (tables := gates.tables_of(actor.sysid) or gates.tables_of(sysid)):
            raise RefusedError(
                f"[{tables[0]}] decides when something may be sent to a vehicle with this system id: change the id "
                "with a daemon without that table, then the fleet file of every station that has it"
            )
        if not 1 <= sysid <= MAX_SYSID:
            raise RefusedError(f"system id {sysid} is not between 1 and {MAX_SYSID}")
        if self._busy is not None:
            raise RefusedError(f"{self._busy} is being given another id: one at a time")
        # state of the vehicle
        require_connected(vehicle, now)
        self._fleet.locks.require(flight_lock.Renumbering(vehicle.key))
        if vehicle.family not in PARAMETERS:
            raise RefusedError("it is neither a PX4 nor an ArduPilot: its parameter for the system id is not known")
        if (why := why_not_idle(vehicle, now)) is not None:
            raise RefusedError(f"{why}; an id is changed on the ground, disarmed")
        # both ids must be clear
        if vehicle.duplicate:
            raise RefusedError(f"two vehicles have system id {actor.sysid}: switch one of them off first")
        if len(self._fleet.vehicles_of(actor.sysid)) > 1:
            raise RefusedError(f"system {actor.sysid} has several autopilots, which share one id")
        if (owner := self._owner(sysid)) is not None:
            raise RefusedError(f"system id {sysid} is taken: {owner}")
        planned = self._fleet.configured_name(sysid)
        if planned is not None and planned != actor.name and not force:
            raise RefusedError(
                f"system id {sysid} is {planned}'s in the fleet file; if this is {planned}, {FORCE_HINT}"
            )

    def _owner(self, sysid: int) -> str | None:
        """Names the present user of this id, for a message; None: the id is free."""
        own = self._fleet.config.daemon.sysid
        if sysid == own:
            return "it is skygcs' own (daemon.sysid)"
        for actor in self._fleet.vehicles.values():
            if actor.sysid == sysid:
                lost = "" if actor.vehicle.connected else f", which is lost (skygcs-cli forget {actor.name})"
                return f"{actor.name} has it{lost}"
            if actor.vehicle.gcs_sysid == sysid:
                return f"{actor.name} expects its ground station under it"
        since = self._loop.time() - HEARD_S
        routes = any(at > since for source, _, _, at in self._hub.router.table.routes() if source == sysid)
        if routes or any(c.component.heard_at() > since for c in self._fleet.components.of_system(sysid)):
            return "a system with that id is heard (skygcs-cli components)"
        return None

    # -- the change

    async def _carry(self, actor: VehicleActor, sysid: int) -> Outcome:
        fleet, before, link = self._fleet, actor.sysid, actor.channel
        parameter = PARAMETERS[actor.vehicle.family]
        fleet.expect(sysid, Expected(actor.vehicle.key, link, self._loop.time() + KEPT_S))
        key = sysid << 8 | actor.compid
        outcomes = await self._unless_met(key, actor.params.set({parameter: float(sysid)}))
        if outcomes is not None and not (outcome := next(iter(outcomes.values()))).ok and key not in fleet.vehicles:
            if outcome.result in ("denied", "unknown", "refused"):
                fleet.expect(sysid, None)
                return Outcome(
                    False, outcome.result, f"{parameter} was not set, nothing has changed: {outcome.message}"
                )
            text = f"{outcome.message}: {parameter} may be {sysid} now; a restart shows it"
            return Outcome(False, outcome.result, f"{text}; check with: param get {actor.name} {parameter}")
        if actor.vehicle.family == "ardupilot":
            await self._met(key, AT_ONCE_S)
        if key not in fleet.vehicles:
            failed = await self._restart(actor, parameter, sysid)
            if failed is not None:
                return failed
        return await self._verified(key, before, link, parameter)

    async def _restart(self, actor: VehicleActor, parameter: str, sysid: int) -> Outcome | None:
        """Restart it and wait for it; None once it is heard under the new id."""
        # restart it
        key, before = sysid << 8 | actor.compid, actor.sysid
        now = self._loop.time
        rebooted = await self._unless_met(key, actor.reboot())
        kept = f"its {parameter} is {sysid} now: until it restarts it is system {before}"
        # without a restart the old id stays
        if rebooted is not None and not rebooted.ok and key not in self._fleet.vehicles:
            by_hand = "switch it off and on (a simulated one: stop and start it); it is then found under the new id"
            undo = f"to undo: param set {actor.name} {parameter}={before}"
            return Outcome(
                False, rebooted.result, f"{kept}, and it does not restart ({rebooted.message}): {by_hand}; {undo}"
            )
        # wait until it is heard under the new id
        began = now()
        while key not in self._fleet.vehicles:
            silence_s = actor.vehicle.silence_s(now()) or 0.0
            if now() - silence_s > began + STILL_S:
                return Outcome(
                    False,
                    "failed",
                    f"it accepted the restart and is still heard as system {before}: check with param get {actor.name} "
                    f"{parameter}, and restart it by hand",
                )
            if now() - began > RETURN_S:
                return Outcome(
                    False,
                    "timeout",
                    f"it restarted {now() - began:.0f} s ago with {parameter} {sysid} and was not heard since, neither "
                    f"as {sysid} nor as {before}: if it is heard as {sysid} within {KEPT_S / 60:.0f} min it keeps "
                    f"its name; if it never is, skygcs-cli forget {actor.name}",
                )
            await asyncio.sleep(LOOK_S)
        return None

    async def _verified(self, key: int, before: int, link: str, parameter: str) -> Outcome:
        """Verify that the vehicle heard under the new id is the same one."""
        # the same link as before
        fleet, sysid = self._fleet, key >> 8
        new = fleet.vehicles[key]
        if new.channel != link:
            return Outcome(
                False,
                "failed",
                f"system {sysid} is heard on {new.channel}, not on {link} where it was: another vehicle?",
            )
        # the parameter of the vehicle with the new id
        held = await new.params.get(parameter)
        for _ in range(READ_TRIES - 1):
            if held.ok or fleet.vehicles.get(key) is not new:
                break
            held = await new.params.get(parameter)
        if not held.ok:
            text = f"system {sysid} is heard on {link}, but {parameter} could not be read there: {held.message}"
            return Outcome(False, held.result, text)
        value = None if held.param is None else held.param.value
        if value != sysid:
            return Outcome(
                False, "failed", f"system {sysid}, which is heard now, has {parameter} {value}: it is another vehicle"
            )
        # the old id must be silent
        await asyncio.sleep(ALONE_S)
        again = fleet.vehicles_of(before)
        if any(vehicle.connected for vehicle in again):
            return Outcome(False, "failed", f"system {sysid} is heard, and system {before} still is, too: two vehicles")
        # write the note for the fleet file
        note = self._file_note(new.name, before, sysid)
        return Outcome(
            True, "accepted", f"{new.name} is system {sysid} now, it was {before}; {held.name} read back{note}"
        )

    def _file_note(self, name: str, before: int, sysid: int) -> str:
        """The necessary change in the fleet file, with its line; empty if the file does not name the vehicle."""
        entry = self._fleet.config.vehicles.get(name)
        if entry is None or entry.sysid != before:
            return ""
        where = self._source
        try:
            line = line_of(("vehicles", name, "sysid"), key_lines(Path(where).read_text(encoding="utf-8")))
        except (OSError, UnicodeDecodeError):
            line = None
        if line is not None:
            where += f", line {line}"
        bound = [n for n, link in self._fleet.config.links.items() if before in link.vehicles or name in link.vehicles]
        also = f"; links bound to it ({', '.join(bound)}) follow when skygcs is restarted" if bound else ""
        return f"; change sysid of [vehicles.{name}] to {sysid} in {where}{also}"

    # -- waiting

    async def _unless_met(self, key: int, work: Awaitable[T]) -> T | None:
        """The result of the work; None if the vehicle is heard under ``key`` before."""
        task = asyncio.ensure_future(work)
        try:
            while not task.done():
                if key in self._fleet.vehicles:
                    return None
                await asyncio.wait({task}, timeout=LOOK_S)
            return task.result()
        finally:
            if not task.done():
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)

    async def _met(self, key: int, within_s: float) -> None:
        for _ in range(round(within_s / LOOK_S)):
            if key in self._fleet.vehicles:
                return
            await asyncio.sleep(LOOK_S)

    def _finish(self, name: str, before: int, sysid: int, outcome: Outcome) -> Outcome:
        data: dict[str, Any] = {"order": "sysid", "was": before, "sysid": sysid, **outcome.as_dict()}
        self._on_event(Event("command", name, sysid if outcome.ok else before, f"sysid: {outcome.message}", data))
        return outcome
