"""Orders about what a vehicle keeps on board: its mission, fence and rally lists, its fence, its logs, the origin
of its estimator, and its home.

Each is a function of the vehicle's actor, to be given with `FleetOrders.command_all` as the methods of `VehicleActor`.
The fleet's origin is sent until the vehicle reports it or is known to refuse it (`WorldFrame`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Coroutine, Sequence
from functools import partial
from typing import TYPE_CHECKING

from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import mission_orders
from skygcs.core.vehicle.flight_lock import FenceListWrite, RallyWrite
from skygcs.core.vehicle.order_plan import Plan
from skygcs.runtime.fence_orders import FenceOutcome
from skygcs.runtime.order_runner import duplicate_refusal
from skygcs.runtime.vehicle_actor import VehicleActor

if TYPE_CHECKING:  # only some vehicles have them
    from skygcs.runtime.onboard_logs import LogsOutcome
import asyncio
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.core.vehicle import orders
from skygcs.core.vehicle import origin as origins
from skygcs.core.vehicle.flight_lock import EstimatorOrigin, HomeMove, OriginChange
from skygcs.core.vehicle.orders import FORCE_HINT, require_connected
from skygcs.core.vehicle.origin import ORIGIN_MESSAGE, SAME_M, announce, kept, off_m
from skygcs.disk_writer import DiskWriter
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.runtime.flight_locks import FlightLocks
from skygcs.runtime.order_runner import Planner
from skygcs.runtime.undo_journal import UndoableChange, UndoJournal
from skygcs.runtime.vehicle_services import OnEvent

# -- lists


async def upload_plan(
    actor: VehicleActor, *, plan: MissionPlan, kinds: Collection[MissionType], force: bool = False
) -> Outcome:
    """See `Missions.bring`. Not the fence or the rally points while a flight stands on the present ones."""
    await actor.services.one_a_turn.wait()
    limit_m = actor.config.goto_limit_m
    work = actor.missions.bring(plan, kinds, partial(_held_list, actor), limit_m=limit_m, force=force)
    with actor.outcomes.tracked("plan upload") as ended:
        return ended(await work)


async def clear_plan(actor: VehicleActor, *, kinds: Collection[MissionType], force: bool = False) -> Outcome:
    """See `Missions.drop`; as `upload_plan`."""
    with actor.outcomes.tracked("plan clear") as ended:
        return ended(await actor.missions.drop(kinds, partial(_held_list, actor), force=force))


async def download_plan(actor: VehicleActor, kinds: Collection[MissionType]) -> tuple[Outcome, MissionPlan]:
    """See `Missions.fetch`."""
    if (why := actor.authority_refusal()) is not None:
        return actor.refuse("plan download", why), MissionPlan()
    outcome, plan = await actor.missions.fetch(kinds)
    return actor.outcomes.finish("plan download", outcome), plan


def _held_list(actor: VehicleActor, kind: MissionType) -> str | None:
    """Why this list must not be changed now; None if it may. A mission is nothing that a flight stands on."""
    refusal, key = actor.services.locks.refusal, actor.vehicle.key
    match kind:
        case MissionType.FENCE:
            return refusal(FenceListWrite(key))
        case MissionType.RALLY:
            return refusal(RallyWrite(key))
        case MissionType.MISSION:
            return None


# -- missions in flight


async def start_mission(actor: VehicleActor, *, first: int = 1, arm: bool = True, force: bool = False) -> Outcome:
    """See `mission_orders.start`; ``force`` as for `VehicleActor.takeoff`."""

    def planner(now: float) -> Plan:
        actor.require_preflight(force=force)
        return mission_orders.start(actor.vehicle, now, first=first, arm=arm)

    return await actor.runner.run("mission", _new_run(actor, planner, first))


async def resume_mission(actor: VehicleActor, *, force: bool = False) -> Outcome:
    """Go on with the current item; `VehicleActor.hold` pauses a mission. ``force``: also if another
    vehicle is in the way, which the fleet checks."""
    planner = _new_run(actor, lambda now: mission_orders.resume(actor.vehicle, now))
    return await actor.runner.run("mission", planner)


async def set_mission_item(actor: VehicleActor, *, item: int, force: bool = False) -> Outcome:
    """Make it the current item, from 1. ``force``: as for `resume_mission`."""
    planner = _new_run(actor, lambda now: mission_orders.set_current(actor.vehicle, now, item), item)
    return await actor.runner.run("mission item", planner)


def _new_run(
    actor: VehicleActor, planner: Callable[[float], Plan], first: int | None = None
) -> Callable[[float], Plan]:
    """The planner of an order with which another run of its mission begins, unless it refuses."""

    def begins(now: float) -> Plan:
        plan = planner(now)
        actor.missions.run_begins(first)
        return plan

    return begins


# -- the fence


async def set_fence(
    actor: VehicleActor,
    *,
    radius_m: float | None = None,
    height_m: float | None = None,
    action: str | None = None,
    force: bool = False,
) -> FenceOutcome:
    """See `VehicleFence.set`."""
    work = lambda: actor.fence.set(radius_m=radius_m, height_m=height_m, action=action, force=force)  # noqa: E731
    return await _report_fence(actor, "fence", work)


async def read_fence(actor: VehicleActor) -> FenceOutcome:
    """See `VehicleFence.status`."""
    return await actor.fence.status()


async def test_fence(actor: VehicleActor, *, radius_m: float, action: str, timeout_s: float) -> FenceOutcome:
    """See `VehicleFence.test`."""
    work = lambda: actor.fence.test(radius_m=radius_m, action=action, timeout_s=timeout_s)  # noqa: E731
    return await _report_fence(actor, "fence test", work)


async def _report_fence(
    actor: VehicleActor, order: str, work: Callable[[], Coroutine[None, None, FenceOutcome]]
) -> FenceOutcome:
    """Report its outcome like that of any order; a cancelled test reports itself."""
    if actor.vehicle.duplicate:
        return FenceOutcome(actor.outcomes.finish(order, duplicate_refusal(actor.vehicle)))
    outcome = await work()
    actor.outcomes.finish(order, outcome.outcome)
    return outcome


# -- logs


async def list_logs(actor: VehicleActor) -> LogsOutcome:
    """See `VehicleLogs.list`."""
    return await actor.logs.list()


async def get_logs(actor: VehicleActor, *, logs: Sequence[int] | str, force: bool = False) -> LogsOutcome:
    """See `VehicleLogs.get`."""
    return await actor.logs.get(logs, force=force)


TRIES = 3
"""SET_GPS_GLOBAL_ORIGIN has no acknowledgement: it may be lost while the request after it arrives."""

NO_USE = frozenset({"refused", "unsupported", "lost", "cancelled"})
"""Outcomes that another attempt would not change."""


async def push_origin(actor: VehicleActor, origin: Origin, *, home: bool = False, force: bool = False) -> Outcome:
    """Send the fleet's origin to the vehicle; with ``home`` also make it the home. When armed only with ``force``."""
    with actor.outcomes.tracked("origin") as ended:
        return ended(await _pushed(actor, origin, home, force))


async def _pushed(actor: VehicleActor, origin: Origin, home: bool, force: bool) -> Outcome:
    if (why := actor.services.locks.refusal(EstimatorOrigin(actor.vehicle.key))) is not None:
        return Outcome.refused(why)
    sent = await _until_reported(actor, origin, force=force)
    if not home or sent.result == "refused":
        return sent
    planner = _home(actor, origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, force=force)
    return _both(sent, await actor.runner.attempt(planner))


async def _until_reported(actor: VehicleActor, origin: Origin, *, force: bool) -> Outcome:
    """The outcome is ok only once the vehicle itself reports this origin."""
    vehicle, dialect = actor.vehicle, actor.services.dialect
    elapsed_s = 0.0
    texts: tuple[str, ...] = ()
    for number in range(1, TRIES + 1):
        before = vehicle.count(ORIGIN_MESSAGE)
        outcome = await actor.runner.attempt(lambda now: announce(vehicle, now, dialect, origin, force=force))
        elapsed_s += outcome.elapsed_s
        texts += tuple(t for t in outcome.status_texts if t not in texts)
        sent = 0 if outcome.result == "refused" else number
        outcome = replace(outcome, attempts=sent, elapsed_s=elapsed_s, status_texts=texts)
        if outcome.ok and vehicle.count(ORIGIN_MESSAGE) > before:
            away_m = off_m(vehicle, origin)
            if away_m is not None and away_m <= SAME_M:
                return outcome
            text = f"denied: {kept(vehicle, origin)}"
            return replace(outcome, ok=False, result="denied", message=text)
        if outcome.result in NO_USE:
            return outcome
    return outcome


def _both(origin: Outcome, home: Outcome) -> Outcome:
    """The outcome of sending the origin and of setting the home there: ok if both are."""
    worse = origin if not origin.ok else home
    return Outcome(
        origin.ok and home.ok,
        worse.result,
        f"origin: {origin.message}; home: {home.message}",
        max(origin.attempts, home.attempts),
        origin.elapsed_s + home.elapsed_s,
        origin.status_texts + tuple(t for t in home.status_texts if t not in origin.status_texts),
    )


async def set_home(
    actor: VehicleActor,
    *,
    lat_deg: float | None = None,
    lon_deg: float | None = None,
    alt_amsl_m: float | None = None,
    force: bool = False,
) -> Outcome:
    """Set its home; without arguments at its position. In the air, or farther than goto_limit_m, only with
    ``force``; never to another place while a flight counts from it."""
    planner = _home(actor, lat_deg, lon_deg, alt_amsl_m, force=force)
    return await actor.runner.run("home", planner)


def _home(
    actor: VehicleActor, lat_deg: float | None, lon_deg: float | None, alt_amsl_m: float | None, *, force: bool
) -> Planner:
    vehicle, limit_m = actor.vehicle, actor.config.goto_limit_m

    def planner(now: float) -> Plan:
        altitude_m = vehicle.home_alt_amsl_m() if alt_amsl_m is None else alt_amsl_m
        place = None
        if lat_deg is not None and lon_deg is not None and altitude_m is not None:
            place = (lat_deg, lon_deg, altitude_m)
        actor.services.locks.require(HomeMove(vehicle.key, place))
        where = {"lat_deg": lat_deg, "lon_deg": lon_deg, "alt_amsl_m": alt_amsl_m}
        return orders.set_home(vehicle, now, **where, limit_m=limit_m, force=force)

    return planner


class WorldFrame:
    """``origin`` (None: there is no frame yet) and ``generation``, the count of its changes.

    A change is one synchronous step: before the next frame is read or the next request answered, every vehicle object
    has the new origin, so no answer mixes two frames. Nothing is sent to the vehicles.
    """

    def __init__(
        self, origin: Origin | None, actors: Mapping[int, VehicleActor], locks: FlightLocks, on_event: OnEvent
    ) -> None:
        self.origin = origin
        self.generation = 0 if origin is None else 1
        self._actors = actors
        self._locks = locks
        self._on_event = on_event

    def join(self, actor: VehicleActor) -> None:
        """Pass the frame to a new vehicle."""
        actor.set_origin(self.origin, self.generation)

    def set(self, origin: Origin | None, *, force: bool = False, source: str = "") -> None:
        """Set the frame. Setting the same origin again has no effect.

        Raises RefusedError for an impossible origin, while a flight is made of the present one, and without ``force``
        for one of another site. The event names ``source``: "alpha".
        """
        if origin is not None:
            origin = origins.checked(origin)
            if not force:
                origins.require_near(origin, [actor.vehicle for actor in self._actors.values()])
        old = self.origin
        if origin == old:
            return
        self._locks.require(OriginChange(origin))
        self.origin = origin
        self.generation += 1
        for actor in self._actors.values():
            self.join(actor)
        data = {"old": as_dict(old), "new": as_dict(origin), "generation": self.generation, "source": source or None}
        self._on_event(Event("origin", None, None, _reported(old, origin, source), data))

    def set_from_vehicle(self, actor: VehicleActor, now: float, *, heading: bool = False, force: bool = False) -> None:
        """Set the origin at the vehicle's position; with ``heading`` its nose is along x, else the x axis stays.

        Raises RefusedError.
        """
        if actor.vehicle.duplicate and not force:
            raise RefusedError(f"two vehicles have system id {actor.sysid}: it is not known whose position this is")
        origin = origins.from_vehicle(actor.vehicle, now, heading=heading, force=force)
        if not heading and self.origin is not None:
            origin = Origin(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m, self.origin.x_heading_deg)
        self.set(origin, force=force, source=actor.name)

    def status(self) -> dict[str, Any]:
        """The frame for RPC and CLI."""
        return {"origin": as_dict(self.origin), "generation": self.generation}


def as_dict(origin: Origin | None) -> dict[str, float] | None:
    """`Origin.as_dict`, and None for None."""
    return None if origin is None else origin.as_dict()


def _reported(old: Origin | None, new: Origin | None, source: str) -> str:
    return f"origin {_place(new)}" + (f", from {source}" if source else "") + f"; it was {_place(old)}"


def _place(origin: Origin | None) -> str:
    if origin is None:
        return "none"
    place = f"{origin.lat_deg:.7f}, {origin.lon_deg:.7f}, {origin.alt_amsl_m:.1f} m AMSL"
    return place if origin.x_heading_deg == EAST_DEG else f"{place}, x to {origin.x_heading_deg:.1f}°"


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

    def report(self) -> None:
        """Report each change that was left, and files that cannot be read, as one event each."""
        for change in self._journal.left():
            text = f"{change}; skygcs-cli undo run {change.id} restores it, undo drop removes the entry"
            self._publish(change, text, {"id": change.id, "state": "left"})
        if problems := self._journal.problems:
            text = f"{self._journal.folder}: {'; '.join(problems[:5])}; these files are not undone"
            self._on_event(Event("undo", None, None, text, {"state": "unreadable"}))

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
        if actor.fence.testing:
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
