"""The methods that search and certify plans, in a process of their own. `METHODS` is their part of the table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from typing import Annotated, Any, Literal, Protocol, Self, TypeVar

from pydantic import Field, model_validator

from skygcs.core.plan.file_reading import MAX_VEHICLES
from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.plan.formations import CURRENT, POINTS, SHAPES, WantedFormation
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.plan_json import MAX_BOXES, MAX_CORNERS
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.piecewise import MAX_DURATION_S, MAX_PIECES, MAX_POSITION_M, Vector
from skygcs.errors import RefusedError, TrajectoryError
from skygcs.ext.plans.flight.guidance import Choice, by_goto
from skygcs.ext.plans.plan_runner import PlanRunner
from skygcs.ext.plans.planning.planning_queue import PlanningQueue
from skygcs.ext.plans.planning.request import WrittenPath, check_request, make_request, paths_request
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, Services, one_vehicle
from skygcs.rpc.dispatch import Encoded, InvalidParams, Method
from skygcs.rpc.models import MethodParams, NoParams, Result
from skygcs.runtime import fleet_margins
from skygcs.runtime.vehicle_actor import VehicleActor

MAX_YAW_DEG = 36_000.0

Metres = Annotated[float, Field(ge=-MAX_POSITION_M, le=MAX_POSITION_M)]
Point = Annotated[list[Metres], Field(min_length=3, max_length=3)]
Corner = Annotated[list[Metres], Field(min_length=2, max_length=2)]
PlacesByVehicle = Annotated[dict[str, Point], Field(min_length=1, max_length=MAX_VEHICLES)]


class PlanParts(Protocol):
    """The parts of the extension that its methods act on."""

    runner: PlanRunner
    queue: PlanningQueue


def plans_of(services: Services) -> PlanParts:
    """The extension of a running daemon: one of its methods was called, so it is made."""
    parts: PlanParts = services.extensions["plan"]
    return parts


class SpaceParams(MethodParams):
    """Where the plan may be flown, besides the vehicles of the fleet."""

    fence: Annotated[list[Corner], Field(max_length=MAX_CORNERS)] = Field([])
    floor_m: Metres | None = None
    ceiling_m: Metres | None = None
    boxes: Annotated[list[Annotated[list[Point], Field(min_length=2, max_length=2)]], Field(max_length=MAX_BOXES)] = (
        Field([])
    )
    standing: Annotated[dict[str, Point], Field(max_length=MAX_VEHICLES)] = Field({})


class LimitsParams(MethodParams):
    """Limits that a vehicle can follow; null: its own of the fleet file, else the default."""

    speed_mps: float | None = None
    acceleration_mps2: float | None = None
    jerk_mps3: float | None = None
    climb_mps: float | None = None
    descent_mps: float | None = None


class FormationParams(MethodParams):
    vehicles: Annotated[list[str], Field(min_length=1, max_length=MAX_VEHICLES)]
    shape: str = Field(
        description=f"One of {', '.join(SHAPES)}; {POINTS}: points_m; {CURRENT}: where they are, each keeps its place."
    )
    middle_m: Point | None = Field(None, description="null: where the middle of the points, or of the vehicles, is.")
    spacing_m: float = Field(5.0, description="Between neighbours of a shape.")
    yaw_deg: Annotated[float, Field(ge=-MAX_YAW_DEG, le=MAX_YAW_DEG)] = Field(
        0.0, description="A shape looks there, points are turned by it; counter-clockwise."
    )
    scale: float = Field(1.0, description="Factor for all distances from the middle.")
    points_m: Annotated[list[Point], Field(max_length=MAX_VEHICLES)] = Field(
        [], description="Of the shape points: [x, y, up] for each vehicle, about any point."
    )

    def wanted(self) -> WantedFormation:
        return WantedFormation(
            self.shape,
            None if self.middle_m is None else _vector(self.middle_m),
            math.radians(self.yaw_deg),
            self.scale,
            self.spacing_m,
            tuple(_vector(point) for point in self.points_m),
        )


class PathParams(MethodParams):
    """Points that a vehicle flies. With times they are joined by straight lines; without, it stops at corners."""

    points: Annotated[list[Point], Field(min_length=1, max_length=MAX_PIECES)]
    times_s: Annotated[list[Annotated[float, Field(ge=0, le=MAX_DURATION_S)]], Field(max_length=MAX_PIECES)] = Field([])
    yaws_deg: Annotated[
        list[Annotated[float, Field(ge=-MAX_YAW_DEG, le=MAX_YAW_DEG)]], Field(max_length=MAX_PIECES)
    ] = Field([])

    @model_validator(mode="after")
    def _one_for_each(self) -> Self:
        for name in ("times_s", "yaws_deg"):
            if len(getattr(self, name)) not in (0, len(self.points)):
                raise ValueError(f"{name}: one for each of the {len(self.points)} points, or none")
        return self

    def written(self) -> WrittenPath:
        return WrittenPath(
            [_vector(point) for point in self.points], self.times_s, [math.radians(yaw) for yaw in self.yaws_deg]
        )


class CertifyParams(MethodParams):
    """Parameters that all requests to plan have."""

    margin_m: float | None = Field(None, description="For each pair, in place of its terms.")
    downwash_ratio: float | None = Field(None, description="null: the fleet file's.")
    limits: LimitsParams | None = Field(
        None,
        description="For timing: speed_mps, acceleration_mps2, jerk_mps3, climb_mps, descent_mps; null: each "
        "vehicle's control.trajectory.",
    )
    within_limits: bool = Field(False, description="Refuse trajectories that exceed the limits.")
    space: SpaceParams | None = Field(
        None, description="fence, floor_m, ceiling_m, boxes, standing; metres of the frame."
    )
    others: bool = Field(True, description="Other vehicles are obstacles, where they were last heard.")
    progress: bool = Field(
        False, description="Notifications plan.progress {job, what, done, total} until the answer, to this client."
    )


class PlanMakeParams(CertifyParams):
    """One of goals, formation and paths."""

    goals: PlacesByVehicle | None = Field(
        None, description="Final positions by vehicle (name or system id): [x, y, up]."
    )
    formation: FormationParams | None = Field(
        None,
        description=f"Or vehicles, shape ({', '.join((*SHAPES, POINTS, CURRENT))}), middle_m, spacing_m, yaw_deg, "
        "scale, points_m of a formation; any vehicle may take any place, in the current formation each keeps its own.",
    )
    paths: Annotated[dict[str, PathParams], Field(min_length=1, max_length=MAX_VEHICLES)] | None = Field(
        None, description="Or written paths by vehicle: points, and times_s and yaws_deg for each point or not at all."
    )
    starts: PlacesByVehicle | None = Field(None, description="null: where the vehicles are now.")
    exchangeable: bool = Field(False, description="Any vehicle may take any goal.")
    by: Literal["auto", "goto", "setpoints", "onboard", "mission"] = Field(
        "auto",
        description="How plan.run is to fly it; goto: phased, with the autopilots' own margins.",
    )
    kind: Literal["auto", "timed", "phased", "direct"] = Field(
        "auto", description="Only plans of this kind; direct: all fly straight at once."
    )

    @model_validator(mode="after")
    def _one_task(self) -> Self:
        if sum(task is not None for task in (self.goals, self.formation, self.paths)) != 1:
            raise ValueError("give one of goals, formation and paths")
        return self


M = TypeVar("M")


def one_plan(model: M, plan: object, upload: object) -> M:
    """Require one plan of a model that has both keys. Raises ValueError."""
    if (plan is None) == (upload is None):
        raise ValueError("give either plan or upload")
    return model


class GivenPlan(MethodParams):
    plan: dict[str, Any] | None = Field(None, description="A plan of skygcs: the content of its JSON file.")


class PlanCertifyParams(CertifyParams, GivenPlan):  # the last base comes first by position
    keep: bool = Field(False, description="The answer has the plan, with its certificate.")
    upload: int | None = Field(
        None, description="Or the number of one that plan.upload took in parts, used up by that."
    )

    @model_validator(mode="after")
    def _one_plan(self) -> Self:
        return one_plan(self, self.plan, self.upload)


class PlanCancelParams(MethodParams):
    job: int | None = Field(None, description="Its number, of plan.jobs or plan.progress; null: this client's.")


class PlanAnswer(Result):
    certificate: dict[str, Any] | None = Field(
        None,
        description="As `plan check --json`: certified, closest with each term of the margin and its source, reasons.",
    )
    plan: dict[str, Any] | None = Field(None, description="The certified plan, which a file of it would contain.")
    attempts: list[str] = Field([], description="What was tried, the successful one last.")
    reasons: list[str] = Field([], description="Why nothing was certified: pair, time and place.")
    standing: dict[str, list[float]] = Field({}, description="Vehicles of the fleet that counted as obstacles.")
    unknown: list[str] = Field([], description="Vehicles of the fleet that did not: nobody knows where they are.")
    by: str | None = Field(None, description="The way in which it is to be flown: goto, setpoints, onboard or mission.")
    why: str | None = Field(None, description="Why it is that way.")


class PlanningJobState(Result):
    job: int
    what: str
    state: Literal["waiting", "running"]
    since_s: float
    progress: dict[str, Any] | None


class PlanningState(Result):
    jobs: list[PlanningJobState] = Field(description="The oldest first; one is computed at a time.")
    answered: int
    failed: int
    cancelled: int
    turned_away: int


class PlanCancelled(Result):
    cancelled: list[int] = Field(description="Their numbers.")


async def plan_make(context: Context, params: PlanMakeParams) -> Encoded:
    """Search a certified plan: to positions, into a formation, or along paths. Nothing moves.

    If some stand on the ground, the plan begins with a climb. Without a fence or ceiling in space the control fences
    count.
    """
    facts = _Facts(context.services, params)
    limits = _limits(params.limits)
    if params.paths is not None:
        paths = {facts.name(key): path.written() for key, path in params.paths.items()}
        facts.require_each_once(params.paths)
        facts.choose_way(paths, params.by, timed=True)
        request = paths_request(paths, facts.rule(), limits, facts.space(paths), within_limits=params.within_limits)
    else:
        starts, goals, exchangeable = facts.task(params)
        in_phases = facts.choose_way(starts, params.by, timed=params.kind == "timed")
        if facts.begins_on_ground and params.kind == "timed":
            raise RefusedError("they stand on the ground, and a timed plan begins in the air: take off first")
        kind = "phased" if (in_phases or facts.begins_on_ground) and params.kind == "auto" else params.kind
        request = make_request(
            starts,
            goals,
            facts.rule(),
            limits,
            facts.space(goals),
            exchangeable=exchangeable,
            kind=kind,
        )
    return await _run(context, "make", request, facts, params.progress)


async def plan_certify(context: Context, params: PlanCertifyParams) -> Encoded:
    """Certify a plan or refuse it, with the fleet's margins, and other vehicles as obstacles. Nothing moves."""
    facts = _Facts(context.services, params)
    space = facts.space(())  # those that take part are taken out by the process, which reads the plan
    text = b"" if params.upload is None else plans_of(context.services).runner.uploads.take(params.upload, facts.now())
    request = check_request(
        params.plan, facts.rule(), _limits(params.limits), space, within_limits=params.within_limits, keep=params.keep
    )
    return await _run(context, "certify", request, facts, params.progress, text)


def plan_cancel(context: Context, params: PlanCancelParams) -> JsonObject:
    """Cancel a request to plan, which is then answered as refused."""
    queue = plans_of(context.services).queue
    return {"cancelled": queue.cancel(client=id(context), number=params.job)}


def plan_jobs(context: Context, _: NoParams) -> JsonObject:
    """Plans that are being made, and requests that wait."""
    queue = plans_of(context.services).queue
    counters = queue.counters
    return {
        "jobs": queue.status(),
        "answered": counters.answered,
        "failed": counters.failed,
        "cancelled": counters.cancelled,
        "turned_away": counters.turned_away,
    }


async def _run(
    context: Context, what: str, request: JsonObject, facts: _Facts, progress: bool, text: bytes = b""
) -> Encoded:
    def note(done: JsonObject) -> None:
        context.notify("plan.progress", done)

    request["notes"], request["limits_of"] = facts.notes(), facts.limits_of()
    on_progress = note if progress else None
    return Encoded(await plans_of(context.services).queue.run(id(context), what, request, on_progress, text))


# --- what the daemon knows --------------------------------------------------------------------------------------------


class _Facts:
    """Facts of one request: the fleet's vehicles, where they are, and their margins."""

    def __init__(self, services: Services, params: CertifyParams) -> None:
        self._services = services
        self._params = params
        self._standing: dict[str, Vector] = {}
        self._unknown: list[str] = []
        self._ground_m: float | None = None
        """The lowest place of vehicles that begin on the ground: none crosses there, nor below."""
        self._way: Choice | None = None
        self._taking_part: list[VehicleActor] = []

    @property
    def begins_on_ground(self) -> bool:
        """True if some vehicles stand on the ground where they are to begin."""
        return self._ground_m is not None

    def name(self, key: str) -> str:
        """Raises TargetError."""
        return one_vehicle(self._services, key).name

    def now(self) -> float:
        return self._services.now()

    def require_each_once(self, keys: Iterable[str]) -> None:
        """Raise InvalidParams for a vehicle by its name and by its system id."""
        names = [self.name(key) for key in keys]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InvalidParams(("", f"{twice} is there twice, by its name and by its system id"))

    def task(self, params: PlanMakeParams) -> tuple[dict[str, Vector], dict[str, Vector], bool]:
        """Initial and final positions by the vehicles' names, and whether goals may be exchanged. Raises RefusedError,
        TargetError."""
        if params.formation is None:
            assert params.goals is not None
            self.require_each_once(params.goals)
            goals = {self.name(key): _vector(point) for key, point in params.goals.items()}
            return self.starts(goals, params.starts), goals, params.exchangeable
        self.require_each_once(params.formation.vehicles)
        names = [self.name(key) for key in params.formation.vehicles]
        starts, wanted = self.starts(names, params.starts), params.formation.wanted()
        return starts, wanted.places(names, starts), params.exchangeable or wanted.exchangeable

    def starts(self, names: Iterable[str], given: Mapping[str, list[float]] | None) -> dict[str, Vector]:
        """Initial positions: those given, else where the vehicles are now. Raises RefusedError."""
        if given is not None:
            self.require_each_once(given)
            return {self.name(key): _vector(point) for key, point in given.items()}
        if self._services.fleet.origin is None:
            raise RefusedError("the fleet has no frame yet, so positions mean nothing: origin.set")
        now = self._services.now()
        found = {name: fleet_margins.place(one_vehicle(self._services, name), now, fresh=True) for name in names}
        if nowhere := [name for name, place in found.items() if place is None]:
            raise RefusedError(f"{', '.join(nowhere)}: its position is not known; give starts")
        starts = {name: place for name, place in found.items() if place is not None}
        grounded = [
            place[2]
            for name, place in starts.items()
            if one_vehicle(self._services, name).vehicle.in_air(now) is not True
        ]
        self._ground_m = min((place[2] for place in starts.values()), default=None) if grounded else None
        return starts

    def rule(self) -> MarginRule:
        """Margins of the plan's vehicles and of those that stand. Raises RefusedError."""
        ratio, margin = self._params.downwash_ratio, self._params.margin_m
        actors = self._services.fleet.vehicles.values()
        rule = fleet_margins.margin_rule(actors, margin_m=margin, downwash_ratio=ratio)
        if self._way is None or not self._way.by.own_way:
            return rule
        return by_goto(rule, {actor.name: actor.vehicle.family for actor in self._taking_part})

    def choose_way(self, names: Iterable[str], by: str, *, timed: bool) -> bool:
        """Choose the way in which these are to fly a plan; True if it takes phases. Raises RefusedError."""
        self._taking_part = [one_vehicle(self._services, name) for name in names]
        runner = plans_of(self._services).runner
        self._way = runner.chosen_way(self._taking_part, "position", by, timed=timed).choice
        return self._way.by.own_way

    def limits_of(self) -> dict[str, JsonObject]:
        """The limits of each vehicle of the fleet; those that the request gives count before."""
        given = {} if self._params.limits is None else self._params.limits.model_dump(exclude_none=True)
        actors = self._services.fleet.vehicles.values()
        return {actor.name: asdict(actor.config.control.motion_limits()) | given for actor in actors}

    def space(self, names: Iterable[str]) -> FlightSpace:
        """Return what was given, and the fleet's vehicles that take no part. Raises RefusedError."""
        given, taking_part = self._params.space or SpaceParams.model_validate({}), set(names)
        if 0 < len(given.fence) < 3:
            raise InvalidParams(("space.fence", "a fence has three corners at least"))
        # vehicles that stand beside the plan
        standing = {name: _vector(point) for name, point in given.standing.items()}
        if self._params.others:
            now = self._services.now()
            for actor in self._services.fleet.vehicles.values():
                if actor.name in taking_part or actor.name in standing or actor.vehicle.replayed:
                    continue
                place = fleet_margins.place(actor, now, fresh=False)
                if place is None:
                    self._unknown.append(actor.name)
                else:
                    self._standing[actor.name] = standing[actor.name] = place
        # boxes and fence
        boxes = []
        for least, greatest in given.boxes:
            if any(a > b for a, b in zip(least, greatest, strict=True)):
                raise InvalidParams(("space.boxes", "the least corner of a box is above the greatest"))
            boxes.append((_vector(least), _vector(greatest)))
        fence = tuple((x, y) for x, y in given.fence)
        floor_m = self._ground_m if given.floor_m is None else given.floor_m
        asked = FlightSpace(fence, floor_m, given.ceiling_m, tuple(boxes), standing)
        # within the control fences of the vehicles that take part
        origin = self._services.fleet.origin
        if origin is None or not self._taking_part:
            return asked
        allowed = fleet_margins.control_space(self._taking_part, origin, self.rule())
        lower = [m for m in (allowed.ceiling_m, given.ceiling_m) if m is not None]
        return replace(allowed.joined(asked), ceiling_m=min(lower, default=None))

    def notes(self) -> JsonObject:
        """Return what the answer says of the vehicles that take no part."""
        way = {} if self._way is None else {"by": self._way.by.value, "why": self._way.reason}
        return {"standing": self._standing, "unknown": self._unknown, **way}


def _limits(given: LimitsParams | None) -> MotionLimits:
    try:
        return MotionLimits() if given is None else MotionLimits(**given.model_dump(exclude_none=True))
    except TrajectoryError as error:
        raise RefusedError(str(error)) from None


def _vector(point: list[float]) -> Vector:
    x, y, z = point
    return x, y, z


_ERRORS = (error_codes.TARGET_ERROR, error_codes.REFUSED)

METHODS: tuple[Method[Context], ...] = (
    Method("plan.make", PlanMakeParams, plan_make, PlanAnswer, _ERRORS, unique_keys=True, reach="nothing"),
    Method("plan.certify", PlanCertifyParams, plan_certify, PlanAnswer, _ERRORS, unique_keys=True, reach="nothing"),
    Method("plan.cancel", PlanCancelParams, plan_cancel, PlanCancelled),
    Method("plan.jobs", NoParams, plan_jobs, PlanningState),
)
