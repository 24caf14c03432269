"""The methods of missions, fences and rally points, and the extension that has them: it is made when one of them is
first called."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any, Literal, cast

from pydantic import Field

from skygcs.core.mission.formats import read_plan
from skygcs.core.mission.item import FIRST_ITEM, MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan
from skygcs.core.mission.qgc import write_qgc
from skygcs.core.monitor.mission_ways import MissionRun
from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.formation import MAX_SPACING_M, MAX_STEP_M, SPACING_M, Arrangement, ArrangementKind, arranging
from skygcs.core.vehicle.orders import fresh_position
from skygcs.errors import PlanFileError
from skygcs.ext.missions.mission_turns import MissionTurns
from skygcs.extension import Extension, NoTable
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, Services, as_json, command, one_vehicle, resolve
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.json_lines import MAX_LINE_BYTES
from skygcs.rpc.models import (
    ListParams,
    MethodParams,
    NoParams,
    OutcomeResult,
    Outcomes,
    Result,
    TargetParams,
    TargetsParams,
)
from skygcs.runtime import onboard_orders
from skygcs.runtime.fleet_orders import Own
from skygcs.runtime.task_set import in_turns
from skygcs.runtime.vehicle_actor import VehicleActor

ListName = Literal["mission", "fence", "rally"]


Lists = Annotated[list[ListName], Field(min_length=1, max_length=3)]


ALL_LISTS: list[ListName] = ["mission", "fence", "rally"]


ItemNumber = Annotated[int, Field(ge=FIRST_ITEM, le=65535, description="An item of the mission, counted from 1.")]


class ArrangementParams(MethodParams):
    """How the missions of several vehicles differ that are made from one."""

    kind: ArrangementKind = Field(
        description="heights: each next vehicle higher; present: the path moved by where each is now, seen from the "
        "first; line, column: each next one beside or behind the one before."
    )
    step_m: float | None = Field(
        None, gt=0, le=MAX_STEP_M, description="Of heights; null: what the margins and the climbs need, at least 3 m."
    )
    spacing_m: float = Field(SPACING_M, gt=0, le=MAX_SPACING_M, description="Of line and column.")
    heading_deg: float | None = Field(
        None, ge=-360, le=360, description="Of line and column, by compass; null: the course of the first leg."
    )

    def arrangement(self) -> Arrangement:
        return Arrangement(**self.model_dump())


class PlanUploadParams(TargetsParams):
    plan: str = Field(
        min_length=1, max_length=MAX_LINE_BYTES, description="The content of a .plan or QGC WPL 110 file."
    )
    name: str = Field("plan", max_length=200, description="Name of the plan in error texts.")
    lists: Lists | None = Field(None, description="null: those that the plan holds.")
    arrangement: ArrangementParams | None = Field(
        None,
        description="Give each vehicle, by system id, a mission of its own; null: all get the plan's.",
    )
    force: bool = Field(
        False,
        description="Although the plan has errors, the vehicle flies its mission, or missions come too near each "
        "other.",
    )


class PlanDownloadParams(TargetParams):
    lists: Lists = Field(ALL_LISTS, description="Which lists.")


class PlanClearParams(TargetsParams):
    lists: Lists = Field(["mission"], description="Which lists.")
    force: bool = Field(False, description="Although it flies its mission, or would be in the air without a fence.")


class MissionStartParams(TargetsParams):
    first: ItemNumber = FIRST_ITEM
    arm: bool = Field(True, description="Arm first if it is not armed.")
    one_after_another: bool = Field(
        False,
        description="By system id, each when the one before is done.",
    )
    force: bool = Field(False, description="Without a required preflight, or with another vehicle in the way.")


InTheWay = Annotated[bool, Field(description="Although another vehicle is in the way.")]


class MissionResumeParams(TargetsParams):
    force: InTheWay = False


class MissionItemParams(TargetsParams):
    item: ItemNumber
    force: InTheWay = False


class PlanDownload(Result):
    outcome: OutcomeResult
    plan: str | None = Field(description="The content of a .plan file; null if a list could not be read.")
    mission: list[dict[str, Any]] = Field(description="Items: number, command, frame, params (7), autocontinue.")
    fence: list[dict[str, Any]]
    rally: list[dict[str, Any]]


class MissionTransfer(Result):
    what: str
    percent: int | None
    sent: int


class MissionTurn(Result):
    """Turn of a vehicle in missions flown one after another."""

    turn: int
    of: int
    state: Literal["flies", "waits", "done"]


class MissionStatus(Result):
    """Report of a vehicle about its mission."""

    vehicle: str
    item: int | None = Field(description="The current item, from 1; 0 is an ArduPilot's home.")
    reached: int | None = Field(description="The item it reached last.")
    state: str | None = Field(description="no mission, not started, active, paused, complete; null: not reported.")
    counts: dict[str, int | None] = Field(description="Items per list, as last sent or read; null: not known.")
    opaque_ids: dict[str, int | None] = Field(description="The vehicle's own numbers for its lists (PX4).")
    transfer: MissionTransfer | None = Field(description="The one in progress.")
    last: dict[str, dict[str, Any] | None] = Field(
        description="How the last transfer of each list ended: an outcome, with state (complete, cleared, unchanged, "
        "partial or unknown: what the vehicle holds) and the same as a sentence in message."
    )
    turn: MissionTurn | None = Field(description="Null: missions are not flown one after another.")
    fence: dict[str, Any] | None = Field(description="Fields of FENCE_STATUS; null: it sends none (PX4).")


class TurnsEnded(Result):
    ended: bool = Field(description="False: no missions were flown one after another.")


async def missions_upload(context: Context, params: PlanUploadParams) -> JsonObject:
    """Check a plan against each vehicle and upload it, its fence first.

    Progress: events of kind command. A failed outcome says what the vehicle holds. The upload ends with its client.
    """
    try:
        plan = (await asyncio.to_thread(read_plan, params.plan.encode(), params.name)).plan  # 1 MB: up to 0.6 s
    except PlanFileError as error:
        raise InvalidParams(("plan", str(error))) from None
    kinds = plan.holds() if params.lists is None else _kinds(params.lists)
    arrangement = None if params.arrangement is None else params.arrangement.arrangement()
    if arrangement is not None and MissionType.MISSION not in kinds:
        raise InvalidParams(("arrangement", "it is of missions, and none is uploaded"))
    each = None if arrangement is None else partial(_arranged, context.services, plan, arrangement, force=params.force)
    given = {"plan": plan, "kinds": kinds, "force": params.force}
    return await command(context, params.targets, onboard_orders.upload_plan, each=each, moves=False, **given)


async def _arranged(
    services: Services, plan: MissionPlan, arrangement: Arrangement, actors: Sequence[VehicleActor], *, force: bool
) -> tuple[Own, dict[VehicleActor, str]]:
    """The plan of each vehicle, made of one, and why some do not get it: two of these missions come too near each
    other, unless ``force``."""
    now, monitor = services.now(), services.fleet.monitor
    found = [fresh_position(actor.vehicle, now) for actor in actors]
    places = [None if place is None else place[:2] for place in found]
    try:
        plans = await in_turns(
            arranging(plan, arrangement, places, [monitor.ways.footprint(actor) for actor in actors])
        )
    except ValueError as error:
        return {}, dict.fromkeys(actors, str(error))
    own: Own = {actor: {"plan": one} for actor, one in zip(actors, plans, strict=True)}
    if force:
        return own, {}
    runs = {actor: MissionRun(one.mission) for actor, one in zip(actors, plans, strict=True)}
    return own, await monitor.mission_overlaps(await services.fleet.orders.with_return_heights(runs))


async def missions_download(context: Context, params: PlanDownloadParams) -> JsonObject:
    """Read a vehicle's mission, fence and rally points."""
    outcome, plan = await onboard_orders.download_plan(
        one_vehicle(context.services, params.target), _kinds(params.lists)
    )
    answer = outcome.as_dict()
    return {
        "outcome": answer,
        "plan": _written(plan) if answer["ok"] else None,
        **{kind.word: [_item(n, i) for n, i in enumerate(plan.items(kind), 1)] for kind in MissionType},
    }


async def missions_clear(context: Context, params: PlanClearParams) -> JsonObject:
    """Empty lists of vehicles."""
    return await command(
        context, params.targets, onboard_orders.clear_plan, kinds=_kinds(params.lists), force=params.force
    )


def turns_of(services: Services) -> MissionTurns:
    return cast("Missions", services.extensions["missions"]).turns


async def missions_start(context: Context, params: MissionStartParams) -> JsonObject:
    """Fly the mission that is on board, from an item on.

    One after another, the answer comes when the first has started (what ends the turns: docs/howto/missions.md).
    """
    arguments: dict[str, Any] = {"first": params.first, "arm": params.arm, "force": params.force}
    if params.one_after_another:
        fleet = context.services.fleet

        async def start(actor: VehicleActor) -> Outcome:
            outcomes = await fleet.orders.command_all([actor.name], onboard_orders.start_mission, **arguments)
            return outcomes[actor.name]

        return as_json(await turns_of(context.services).begin(fleet.resolve(params.targets), start))
    return await command(context, params.targets, onboard_orders.start_mission, **arguments)


def missions_end_turns(context: Context, params: NoParams) -> JsonObject:
    """End the turns: the vehicle that flies goes on, others do not start."""
    return {"ended": turns_of(context.services).end("ended by an order")}


async def missions_pause(context: Context, params: TargetsParams) -> JsonObject:
    """Stop and hold position."""
    return await command(context, params.targets, VehicleActor.hold)


async def missions_resume(context: Context, params: MissionResumeParams) -> JsonObject:
    """Go on with the current item."""
    return await command(context, params.targets, onboard_orders.resume_mission, force=params.force)


async def missions_set_current(context: Context, params: MissionItemParams) -> JsonObject:
    """Make an item the current one: a vehicle that flies its mission goes there."""
    return await command(context, params.targets, onboard_orders.set_mission_item, item=params.item, force=params.force)


def missions_status(context: Context, params: ListParams) -> list[JsonObject]:
    """Each vehicle's place in its mission, and transfers."""
    reports, turns = [], turns_of(context.services)
    for vehicle in resolve(context.services, params.targets):
        has_fence = "FENCE_STATUS" in context.services.dialect.by_name
        fence = vehicle.latest("FENCE_STATUS") if has_fence else None
        status = vehicle.missions.status() | {"turn": turns.of(vehicle)}
        reports.append({"vehicle": vehicle.name, **status, "fence": fence and fence["fields"]})
    return reports


def _kinds(lists: list[ListName]) -> tuple[MissionType, ...]:
    return tuple(MissionType[name.upper()] for name in lists)


def _written(plan: MissionPlan) -> str | None:
    """None if the format cannot hold it (rally points above sea level); the items are returned in any case."""
    try:
        return write_qgc(plan)
    except ValueError:
        return None


def _item(number: int, item: MissionItem) -> JsonObject:
    return {
        "number": number,
        "command": item.command,
        "frame": item.frame,
        "params": list(item.seven),
        "autocontinue": item.autocontinue,
    }


_TARGET = (error_codes.TARGET_ERROR,)


METHODS: tuple[Method[Context], ...] = (
    Method("missions.upload", PlanUploadParams, missions_upload, Outcomes, _TARGET),
    Method("missions.download", PlanDownloadParams, missions_download, PlanDownload, _TARGET),
    Method("missions.clear", PlanClearParams, missions_clear, Outcomes, _TARGET),
    Method("missions.start", MissionStartParams, missions_start, Outcomes, _TARGET),
    Method("missions.end_turns", NoParams, missions_end_turns, TurnsEnded),
    Method("missions.pause", TargetsParams, missions_pause, Outcomes, _TARGET),
    Method("missions.resume", MissionResumeParams, missions_resume, Outcomes, _TARGET),
    Method("missions.set_current", MissionItemParams, missions_set_current, Outcomes, _TARGET),
    Method("missions.status", ListParams, missions_status, list[MissionStatus], _TARGET),
)


class Missions(Extension[NoTable]):
    own_methods = METHODS

    def __init__(self, core: Services, config: NoTable) -> None:
        super().__init__(core, config)
        self.turns = MissionTurns(asyncio.get_running_loop(), core.event_log.publish)

    def registered(self) -> None:
        self.core.fleet.orders.on_ending.append(self.turns.taken)

    def woke(self, why: str) -> None:
        self.turns.end(why)

    def close(self) -> None:
        self.turns.close()
