"""Orders about what a vehicle keeps on board: its mission, fence and rally lists.

Each is a function of the vehicle's actor, to be given with `FleetOrders.command_all` as the methods of `VehicleActor`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial

from skygcs.core.mission.item import MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle import mission_orders
from skygcs.core.vehicle.flight_lock import FenceListWrite, RallyWrite
from skygcs.core.vehicle.order_ledger import may_have_effect
from skygcs.core.vehicle.order_plan import Plan
from skygcs.runtime.order_runner import Planner
from skygcs.runtime.vehicle_actor import VehicleActor

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

    return await _new_run(actor, "mission", planner, first)


async def resume_mission(actor: VehicleActor, *, force: bool = False) -> Outcome:
    """Go on with the current item; `VehicleActor.hold` pauses a mission. ``force``: also if another
    vehicle is in the way, which the fleet checks."""
    return await _new_run(actor, "mission", lambda now: mission_orders.resume(actor.vehicle, now))


async def set_mission_item(actor: VehicleActor, *, item: int, force: bool = False) -> Outcome:
    """Make it the current item, from 1. ``force``: as for `resume_mission`."""
    return await _new_run(actor, "mission item", lambda now: mission_orders.set_current(actor.vehicle, now, item), item)


async def _new_run(actor: VehicleActor, order: str, planner: Planner, first: int | None = None) -> Outcome:
    """Run an order with which another run of its mission begins; if it is refused, the present one goes on."""
    begun: list[Callable[[], None]] = []

    def begins(now: float) -> Plan:
        plan = planner(now)
        begun.append(actor.missions.run_begins(first))
        return plan

    outcome = await actor.runner.run(order, begins)
    for goes_on in () if may_have_effect(outcome) else reversed(begun):
        goes_on()
    return outcome
