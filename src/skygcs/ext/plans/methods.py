"""The methods of plans: these ones keep and fly one, those of `planning_methods` make and certify. `METHODS`: all."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from skygcs.core.trajectory.trajectory_clock import MAX_SPEED_FACTOR, MIN_SPEED_FACTOR
from skygcs.core.vehicle.state import Vec3
from skygcs.errors import PlanFileError
from skygcs.ext.plans import planning_methods
from skygcs.ext.plans.flight.flight_steps import starts_of
from skygcs.ext.plans.flight_check import FlightRequest
from skygcs.ext.plans.plan_uploads import MAX_PART_CHARS
from skygcs.ext.plans.planning_methods import one_plan, plans_of
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import InvalidParams, Method
from skygcs.rpc.models import MethodParams, NoParams, Result, Target

SpeedFactor = Annotated[float, Field(ge=MIN_SPEED_FACTOR, le=MAX_SPEED_FACTOR)]


class PlanUploadParams(MethodParams):
    part: Annotated[str, Field(min_length=1, max_length=MAX_PART_CHARS)] = Field(
        description="The next part of a plan's JSON file, at most 400,000 characters."
    )
    upload: int | None = Field(None, description="What the first part returned; null: this is the first.")


class PlanUploaded(Result):
    upload: int = Field(description="Its number, for further parts, plan.load and plan.certify.")
    bytes: int = Field(description="What it has by now; 32 MiB at most.")


class PlanLoadParams(MethodParams):
    """One of plan and upload."""

    plan: dict[str, Any] | None = Field(
        None, description="A plan in skygcs' own JSON format (docs/explanation/plans.md)."
    )
    name: Annotated[str, Field(min_length=1, max_length=64)] = Field(
        "plan", description="For people: in texts and status."
    )
    upload: int | None = Field(
        None, description="Or the number of one that plan.upload took in parts, used up by that."
    )

    @model_validator(mode="after")
    def _one_plan(self) -> Self:
        return one_plan(self, self.plan, self.upload)


class PlanFlightParams(MethodParams):
    plan: str | None = Field(None, description="What plan.load returned; null: the loaded plan.")
    vehicles: dict[str, Target] | None = Field(
        None,
        description="By name in the plan: its vehicle; others do not fly. null: all, by name.",
    )
    mode: Literal["position", "velocity", "attitude"] = Field("position", description="The control mode.")
    speed: SpeedFactor = Field(1.0, description="Multiple of the planned speed; certified with it.")
    margin_m: Annotated[float, Field(gt=0, le=1000)] | None = Field(
        None, description="The margin of each pair, in place of its terms."
    )
    force: bool = Field(False, description="Although it is refused by checks that force can override.")
    by: Literal["auto", "goto", "setpoints", "onboard", "mission"] = Field(
        "auto",
        description="What flies it (docs/howto/fly-several.md#by-goto-setpoints-or-on-board).",
    )


class PlanRunParams(PlanFlightParams):
    set_return_heights: bool = Field(
        False, description="Set the return heights of vehicles that would return too near each other."
    )


class PlanSpeedParams(MethodParams):
    speed: SpeedFactor = Field(description="Multiple of the planned speed, at most the one it was run with.")


class PlanForceParams(MethodParams):
    force: bool = Field(
        False,
        description="Without a certificate; resume: also with silent vehicles and those that pilots fly, where "
        "they were measured.",
    )


class LoadedPlan(Result):
    plan: str = Field(description="Its number, for plan.check and plan.run.")
    name: str
    kind: Literal["timed", "phased"]
    vehicles: list[str]
    duration_s: float | None = Field(description="null: phases have no times.")
    phases: list[str]


class PlanFinding(Result):
    vehicle: str | None = Field(description="null: all.")
    check: str
    severity: Literal["ok", "note", "warning", "refused"]
    text: str
    todo: str
    command: str | None = Field(description="What clears a refusal; FILE: the plan's.")
    insist: bool = Field(description="Whether force passes it.")


class PlanStep(Result):
    name: str
    duration_s: float | None
    goals: dict[str, Vec3]


class PlanReport(Result):
    """Findings before a flight."""

    ok: bool = Field(description="Whether it may be flown (with force: if that was given).")
    by: Literal["goto", "setpoints", "onboard", "mission"] = Field(description="The way in which it is flown.")
    why: str = Field(description="Why it is that way.")
    findings: list[PlanFinding]
    certificate: dict[str, Any] | None = Field(description="Of the plan, with what is measured now.")
    way_there: dict[str, Any] | None = Field(description="The certificate of the way to the starts.")
    margins: dict[str, dict[str, list[Any]]] = Field(
        description="By vehicle: each term, and whether it is measured, of the fleet file or a default."
    )
    duration_s: float = Field(description="Way and plan, at the planned speed.")
    steps: list[PlanStep] = Field(description="The first 50.")
    return_heights: dict[str, tuple[float | None, float, str]] = Field(
        description="By vehicle: is, offered (m), the parameter."
    )


class PlanStarted(Result):
    started: bool = Field(description="False: the report says why; nothing has moved.")
    report: PlanReport


class PlanOrderAnswer(Result):
    ok: bool
    message: str
    reasons: list[str] = Field(description="Why not: each pair with its distance and margin, each vehicle.")


class StepClock(Result):
    state: str
    trajectory_s: float
    duration_s: float
    rate: float
    speed_factor: float
    finishes_in_s: float | None


class VehicleInPlan(Result):
    vehicle: str
    state: str
    error_m: float | None = Field(description="From its reference or its way.")
    tube_m: float | None = Field(description="How far it may be.")
    pos_enu_m: Vec3 | None
    goal_enu_m: Vec3 | None
    position_age_s: float | None
    left: str | None = Field(description="Why it does not follow.")


class PlanStatus(Result):
    now_s: float = Field(description="The daemon's clock.")
    plan: str | None
    name: str | None
    kind: str | None
    state: str = Field(
        description="none, loaded; in flight arming, takeoff, engaging, to_starts, flying, paused, stopped, returning, "
        "aborting, landing; over: finished, aborted, landed."
    )
    busy: str | None = Field(description="A check or a certificate that is under way.")
    phase: str | None = Field(description="The name of the step.")
    step: int
    steps: int
    reason: str = Field(description="What the last change of the state was.")
    by: str | None = Field(description="goto, setpoints, onboard or mission.")
    mode: str | None = Field(description="The control mode; null by goto.")
    speed: float | None
    clock: StepClock | None = Field(description="Of the step.")
    waits_for: list[str] = Field(description="Vehicles that are not where they have to be before it goes on.")
    pairs: list[dict[str, Any]] = Field(description="In danger when it was stopped: vehicles, distance_m, margin_m.")
    vehicles: list[VehicleInPlan]


def plan_upload(context: Context, params: PlanUploadParams) -> JsonObject:
    """Take a plan in parts, for plan.load or plan.certify; a request has at most 1 MiB.

    Four at a time; one without a further part for a minute is dropped.
    """
    services = context.services
    number, size = plans_of(services).runner.uploads.add(params.upload, params.part, services.now())
    return {"upload": number, "bytes": size}


async def plan_load(context: Context, params: PlanLoadParams) -> JsonObject:
    """Keep a plan in place of the one before. Refused while one is flown."""
    content = params.upload if params.plan is None else params.plan
    assert content is not None
    try:
        return await plans_of(context.services).runner.load(content, params.name)
    except PlanFileError as error:
        raise InvalidParams(("plan", str(error))) from None


def plan_unload(context: Context, _: NoParams) -> JsonObject:
    """Forget the plan. Refused while it is flown."""
    return _done(plans_of(context.services).runner.unload())


async def plan_check(context: Context, params: PlanFlightParams) -> JsonObject:
    """Check what plan.run checks (docs/howto/fly-several.md#what-a-plan-looks-at-first); nothing moves."""
    return await plans_of(context.services).runner.check(_request(params))


async def plan_run(context: Context, params: PlanRunParams) -> JsonObject:
    """Check the plan; if it passes, arm, take off in layers, fly to the starts and begin together.

    Answered when vehicles begin to arm; the daemon goes on without the client.
    """
    started, report = await plans_of(context.services).runner.run(
        _request(params), set_return_heights=params.set_return_heights
    )
    return {"started": started, "report": report}


def plan_pause(context: Context, _: NoParams) -> JsonObject:
    """Stop all on their ways, smoothly."""
    return _done(plans_of(context.services).runner.pause())


async def plan_resume(context: Context, params: PlanForceParams) -> JsonObject:
    """Go on after a pause or a stop.

    Where all are at their places it goes on; else a way back and the rest are certified first, without vehicles that
    landed.
    """
    ok, message, reasons = await plans_of(context.services).runner.resume(force=params.force)
    return {"ok": ok, "message": message, "reasons": reasons}


def plan_speed(context: Context, params: PlanSpeedParams) -> JsonObject:
    """Fly faster or slower, at most as fast as was certified."""
    return _done(plans_of(context.services).runner.set_speed(params.speed))


def plan_abort(context: Context, _: NoParams) -> JsonObject:
    """Stop all for good, and order each to hold; those that stand armed are disarmed."""
    return _done(plans_of(context.services).runner.abort())


def plan_land(context: Context, params: PlanForceParams) -> JsonObject:
    """Stop all, then land them where they are: at once, or the lowest first, as a certificate allows it. Without one
    they stay.
    """
    return _done(plans_of(context.services).runner.land(force=params.force))


def plan_status(context: Context, _: NoParams) -> JsonObject:
    """The plan that is loaded, and its flight."""
    return context.services.fleet.plans.status()


def _request(params: PlanFlightParams) -> FlightRequest:
    return FlightRequest(
        params.plan, params.vehicles, params.mode, params.speed, params.margin_m, params.force, params.by
    )


def _flown(context: Context, params: PlanFlightParams | PlanForceParams) -> list[Target]:
    """The vehicles that a check or a flight goes to: those that are named, else those of the flight, or of the plan."""
    runner = plans_of(context.services).runner
    if isinstance(params, PlanForceParams):
        return [] if runner.flight is None else list(runner.flight.actors)
    if params.vehicles is not None:
        return list(params.vehicles.values())
    return [] if runner.kept is None else list(starts_of(runner.kept.plan))


def _done(message: str) -> JsonObject:
    return {"ok": True, "message": message, "reasons": []}


_REFUSED = (error_codes.REFUSED,)
_BOTH = (error_codes.TARGET_ERROR, error_codes.REFUSED)

METHODS: tuple[Method[Context], ...] = (
    Method("plan.upload", PlanUploadParams, plan_upload, PlanUploaded, _REFUSED),
    Method("plan.load", PlanLoadParams, plan_load, LoadedPlan, _REFUSED, unique_keys=True, reach="nothing"),
    Method(
        "plan.check", PlanFlightParams, plan_check, PlanReport, _BOTH, unique_keys=True, reach="fleet", reached=_flown
    ),
    Method("plan.run", PlanRunParams, plan_run, PlanStarted, _BOTH, unique_keys=True, reach="fleet", reached=_flown),
    Method("plan.pause", NoParams, plan_pause, PlanOrderAnswer, _REFUSED, always=True),
    Method("plan.resume", PlanForceParams, plan_resume, PlanOrderAnswer, _REFUSED, reach="fleet", reached=_flown),
    Method("plan.speed", PlanSpeedParams, plan_speed, PlanOrderAnswer, _REFUSED),
    Method("plan.abort", NoParams, plan_abort, PlanOrderAnswer, _REFUSED, always=True),
    Method("plan.land", PlanForceParams, plan_land, PlanOrderAnswer, _REFUSED, always=True),
    Method("plan.status", NoParams, plan_status, PlanStatus, while_stopping=True),
    Method("plan.unload", NoParams, plan_unload, PlanOrderAnswer, _REFUSED),
    *planning_methods.METHODS,
)
