"""The methods of timed trajectories, and the extension that has them: it is made when one of them is first called."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from skygcs.core.trajectory import Piece, Trajectory
from skygcs.core.trajectory.piecewise import MAX_DEGREE
from skygcs.core.trajectory.trajectory_clock import MAX_SPEED_FACTOR, MIN_SPEED_FACTOR
from skygcs.core.vehicle.state import Vec3
from skygcs.errors import RefusedError, TrajectoryError
from skygcs.extension import Extension, NoTable
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, as_json, one_vehicle, resolve
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import ListParams, MethodParams, Outcomes, Result, TargetParams, TargetsParams
from skygcs.runtime.task_set import numbered
from skygcs.runtime.trajectories import LATEST_START_S, MAX_PIECES

Coefficients = Annotated[list[float], Field(min_length=1, max_length=MAX_DEGREE + 1)]

SpeedFactor = Annotated[float, Field(ge=MIN_SPEED_FACTOR, le=MAX_SPEED_FACTOR)]


class PieceParams(MethodParams):
    """Polynomials in the seconds since the piece began, ascending coefficients."""

    duration_s: float
    x: Coefficients
    y: Coefficients
    up: Coefficients
    yaw: Coefficients | None = Field(None, description="Radians from the fleet's x axis, counter-clockwise.")


class TrajectoryLoadParams(TargetParams):
    pieces: Annotated[list[PieceParams], Field(min_length=1, max_length=MAX_PIECES)] = Field(
        description="Each with duration_s and ascending coefficients x, y, up (metres of the fleet's frame) and, "
        "in all or none, yaw (radians)."
    )
    name: Annotated[str, Field(max_length=64)] = Field("trajectory", description="For people: in texts and status.")


class TrajectoryStartParams(TargetsParams):
    """One clock for all of them."""

    after_s: Annotated[float, Field(ge=0, le=LATEST_START_S)] | None = Field(
        None, description="Begin so many seconds from now; without at_s: 1."
    )
    at_s: float | None = Field(None, description="Or at this time of the daemon's clock, now_s of trajectory.status.")
    speed: SpeedFactor = Field(1.0, description="Multiple of the planned speed.")
    force: bool = Field(False, description="Although one comes too close to another vehicle.")

    @model_validator(mode="after")
    def _say_one_time(self) -> TrajectoryStartParams:
        if self.after_s is not None and self.at_s is not None:
            raise ValueError("give after_s or at_s, not both")
        return self


class TrajectorySpeedParams(TargetsParams):
    speed: SpeedFactor = Field(description="Multiple of the planned speed; it is reached on a ramp.")


class TrajectoryOfVehicle(Result):
    """A trajectory that is loaded or flown; also speed_max_mps, acceleration_max_mps2, box_m, with, left, flight."""

    vehicle: str
    name: str
    pieces: int
    duration_s: float
    start_enu_m: Vec3


class TrajectoryStatus(Result):
    now_s: float = Field(description="The daemon's clock, for at_s.")
    trajectories: list[TrajectoryOfVehicle] = Field(description="Of each vehicle that has one.")


class TrajectoryPathsParams(ListParams):
    known: Annotated[str, Field(max_length=64)] | None = Field(
        None, description="key of an earlier answer: paths is null if nothing has changed."
    )


class TrajectoryPath(Result):
    vehicle: str
    name: str
    flown: bool
    points_enu_m: list[Vec3] = Field(description="At equal times; for pictures.")


class TrajectoryPaths(Result):
    key: str = Field(description="Another one when a trajectory is loaded, begun, ended or unloaded.")
    paths: list[TrajectoryPath] | None = Field(description="Of each vehicle that has one.")


async def trajectory_load(context: Context, params: TrajectoryLoadParams) -> JsonObject:
    """Keep a trajectory for a vehicle, in place of the one before."""
    actor = one_vehicle(context.services, params.target)
    try:
        trajectory = Trajectory(
            [
                Piece(p.duration_s, tuple(p.x), tuple(p.y), tuple(p.up), None if p.yaw is None else tuple(p.yaw))
                for p in params.pieces
            ]
        )
    except TrajectoryError as error:
        raise RefusedError(str(error)) from None
    return as_json({actor.name: await context.services.fleet.trajectories.load(actor, trajectory, params.name)})


async def trajectory_start(context: Context, params: TrajectoryStartParams) -> JsonObject:
    """Start the trajectories of vehicles on one clock, all or none.

    Conditions: docs/howto/fly-several.md#trajectories. The daemon goes on without the client.
    """
    fleet = context.services.fleet
    now = context.services.now()
    at_s = now + (1.0 if params.after_s is None else params.after_s) if params.at_s is None else params.at_s
    actors = fleet.resolve(params.targets)
    with numbered():
        if refused := await fleet.trajectories.prepare(actors):
            return as_json(refused)
        if params.force:
            return as_json(fleet.trajectories.start(actors, at_s, params.speed))
        return as_json(await fleet.trajectories.start_apart(actors, at_s, params.speed))


def trajectory_pause(context: Context, params: TargetsParams) -> JsonObject:
    """Stop vehicles on their paths, smoothly, with all that started with them."""
    fleet = context.services.fleet
    return as_json(fleet.trajectories.pause(fleet.resolve(params.targets)))


def trajectory_resume(context: Context, params: TargetsParams) -> JsonObject:
    """Let paused vehicles go on, with all that started with them."""
    fleet = context.services.fleet
    return as_json(fleet.trajectories.resume(fleet.resolve(params.targets)))


def trajectory_speed(context: Context, params: TrajectorySpeedParams) -> JsonObject:
    """Change the speed of vehicles, and of all that started with them; refused where a limit would be exceeded."""
    fleet = context.services.fleet
    return as_json(fleet.trajectories.set_speed(fleet.resolve(params.targets), params.speed))


def trajectory_abort(context: Context, params: TargetsParams) -> JsonObject:
    """Stop vehicles, and all that started with them, for good; they stay under control."""
    fleet = context.services.fleet
    return as_json(fleet.trajectories.abort(fleet.resolve(params.targets)))


def trajectory_unload(context: Context, params: TargetsParams) -> JsonObject:
    """Forget loaded trajectories."""
    fleet = context.services.fleet
    return as_json(fleet.trajectories.unload(fleet.resolve(params.targets)))


def trajectory_status(context: Context, params: ListParams) -> JsonObject:
    """Loaded and flown trajectories, and the daemon's clock."""
    actors = resolve(context.services, params.targets)
    return {
        "now_s": context.services.now(),
        "trajectories": context.services.fleet.trajectories.status(actors),
    }


async def trajectory_paths(context: Context, params: TrajectoryPathsParams) -> JsonObject:
    """The paths that are loaded and flown, as points."""
    actors = resolve(context.services, params.targets)
    key, paths = await context.services.fleet.trajectories.paths(actors, params.known)
    return {"key": key, "paths": paths}


_TARGET = (error_codes.TARGET_ERROR,)
_REFUSED = (error_codes.TARGET_ERROR, error_codes.REFUSED)

METHODS: tuple[Method[Context], ...] = (
    Method("trajectory.load", TrajectoryLoadParams, trajectory_load, Outcomes, _REFUSED),
    Method("trajectory.start", TrajectoryStartParams, trajectory_start, Outcomes, _TARGET),
    Method("trajectory.pause", TargetsParams, trajectory_pause, Outcomes, _TARGET),
    Method("trajectory.resume", TargetsParams, trajectory_resume, Outcomes, _TARGET),
    Method("trajectory.speed", TrajectorySpeedParams, trajectory_speed, Outcomes, _TARGET),
    Method("trajectory.abort", TargetsParams, trajectory_abort, Outcomes, _TARGET),
    Method("trajectory.unload", TargetsParams, trajectory_unload, Outcomes, _TARGET),
    Method("trajectory.paths", TrajectoryPathsParams, trajectory_paths, TrajectoryPaths, _TARGET),
    Method("trajectory.status", ListParams, trajectory_status, TrajectoryStatus, _TARGET),
)


class Trajectories(Extension[NoTable]):
    own_methods = METHODS
