"""formation.start, move, turn, scale, stop and status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Protocol

from pydantic import Field, model_validator

from skygcs.core.vehicle.order_ledger import ClientIdentity
from skygcs.core.vehicle.state import Vec3
from skygcs.ext.formation.config import FormationConfig
from skygcs.ext.formation.formation_flight import WantedFlight
from skygcs.ext.formation.leader import Demand, Fly, GoTo, Stay
from skygcs.ext.formation.separation_filter import Moving
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import MethodParams, NoParams, Result, TargetsParams

LONGEST_FLY_S = 60.0
"""A velocity ends by itself after this time: the client that sent it may be gone."""

Place = Annotated[list[float], Field(min_length=3, max_length=3, description="[x, y, up] in the fleet's frame.")]


class FormationStartParams(TargetsParams):
    """Take the vehicles under control where they are not, and fly to their places about the leader."""

    shape: Literal["current", "line", "column", "v", "circle", "grid"] = Field(
        "current", description="current: each keeps its place."
    )
    spacing_m: Annotated[float, Field(gt=0, le=1000)] = Field(8.0, description="Between neighbours of a shape.")
    heading_deg: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        None, description="Heading, counter-clockwise from the frame's x axis; null: along it."
    )
    leader: str | None = Field(None, description="The vehicle that leads, which is no target; null: a virtual point.")
    at_enu_m: Place | None = Field(None, description="Where its middle is to be; null: where the vehicles are.")


class FormationMoveParams(MethodParams):
    """A place for the leader to fly to, or a velocity for a few seconds; neither: stay."""

    to_enu_m: Place | None = None
    vel_enu_mps: Annotated[list[float], Field(min_length=3, max_length=3)] | None = Field(
        None, description="[x, y, up] along the fleet's axes."
    )
    speed_mps: Annotated[float, Field(gt=0, le=15)] | None = Field(
        None, description="To a place, at most speed_mps of [formation], the default."
    )
    valid_s: Annotated[float, Field(ge=0.1, le=LONGEST_FLY_S)] = Field(
        10.0, description="A velocity ends by itself after so long."
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> FormationMoveParams:
        if self.to_enu_m is not None and self.vel_enu_mps is not None:
            raise ValueError("give to_enu_m or vel_enu_mps, not both")
        return self


class FormationTurnParams(MethodParams):
    heading_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        description="Counter-clockwise from the frame's x axis; the shorter way round."
    )


class FormationScaleParams(MethodParams):
    factor: Annotated[float, Field(ge=0.1, le=10)] = Field(description="Of the offsets at the start.")


class GuidedPlace(MethodParams):
    """Where one member is to be now, and how that place moves."""

    pos_enu_m: Place
    vel_enu_mps: Annotated[list[float], Field(min_length=3, max_length=3)] = Field(
        [0.0, 0.0, 0.0], description="[x, y, up] along the fleet's axes; the place moves on with it."
    )


class FormationGuideParams(MethodParams):
    """Places of a program's own, in place of those about a leader."""

    places: dict[str, GuidedPlace] = Field(max_length=300, description="By vehicle; members without one stay.")
    valid_s: Annotated[float, Field(ge=0.1, le=LONGEST_FLY_S)] = Field(
        1.0, description="Without newer ones all stay where they are after this."
    )
    take_over: bool = Field(False, description="Although it flies to the places of another client, which loses it.")


class FormationMember(Result):
    """One follower."""

    vehicle: str
    place_enu_m: Vec3 = Field(description="Where it is to be now.")
    off_place_m: float | None = Field(description="Its distance from there, as measured; null: not seen.")
    at_place: bool
    hindered: bool = Field(description="Another is in its way.")
    radius_m: float = Field(description="Its part of the distance of each of its pairs.")
    left: str | None = Field(description="Why it is no member any more; null: it is.")


class FormationStatus(Result):
    """The formation that flies, or flew last."""

    state: Literal["none", "flying", "stopping", "stopped"]
    reason: str = Field("", description="Why it stops.")
    settled: bool = Field(False, description="The leader rests, and all members are within a metre of their places.")
    leader: str | None = Field(None, description="The vehicle that leads, virtual, or program (formation.guide).")
    middle_enu_m: Vec3 | None = Field(None, description="Where the leader is.")
    vel_enu_mps: list[float] | None = None
    heading_deg: float | None = None
    scale: float | None = None
    rms_m: float | None = Field(None, description="Root mean square of all distances from their places.")
    least_m: float | None = Field(
        None, description="The least distance that two members were measured at, heights divided by the downwash ratio."
    )
    least_pair: list[str] | None = None
    members: list[FormationMember]


def formation_guide(context: Context, params: FormationGuideParams) -> JsonObject:
    """Fly members to places of the caller's own, which a filter keeps apart."""
    places = {name: Moving(vector(place.pos_enu_m), vector(place.vel_enu_mps)) for name, place in params.places.items()}
    return shown(_keeper(context).guide(places, params.valid_s, context.client, take_over=params.take_over))


async def formation_start(context: Context, params: FormationStartParams) -> JsonObject:
    """Fly vehicles as a formation about a leader: a virtual point, or a vehicle.

    Takes them under position control first; a formation in flight gets new places (docs/howto/formation.md).
    """
    heading = None if params.heading_deg is None else math.radians(params.heading_deg)
    at = None if params.at_enu_m is None else vector(params.at_enu_m)
    wanted = WantedFlight(params.targets, params.shape, params.spacing_m, heading, params.leader, at)
    return shown(await _keeper(context).begin(wanted))


def formation_move(context: Context, params: FormationMoveParams) -> JsonObject:
    """Send the virtual leader to a place or along a velocity; without either it stays."""
    keeper = _keeper(context)
    if params.to_enu_m is not None:
        speed_mps = keeper.config.speed_mps if params.speed_mps is None else params.speed_mps
        return shown(keeper.lead(GoTo(vector(params.to_enu_m), speed_mps)))
    if params.vel_enu_mps is not None:
        return shown(keeper.lead(Fly(vector(params.vel_enu_mps), context.services.now() + params.valid_s)))
    return shown(keeper.lead(Stay()))


def formation_turn(context: Context, params: FormationTurnParams) -> JsonObject:
    """Turn the formation about its leader, as fast as the outermost member can fly."""
    return shown(_keeper(context).turn(math.radians(params.heading_deg)))


def formation_scale(context: Context, params: FormationScaleParams) -> JsonObject:
    """Make the formation larger or smaller; refused where two members would come too near each other."""
    return shown(_keeper(context).scale(params.factor))


def formation_stop(context: Context, params: NoParams) -> JsonObject:
    """Brake all members; they stay under control, and hold their places."""
    return shown(_keeper(context).stop())


def formation_status(context: Context, params: NoParams) -> JsonObject:
    """The formation, each member's distance from its place, and the least distance."""
    return shown(_keeper(context).status())


class FormationKeeper(Protocol):
    """The extension, as its methods see it."""

    config: FormationConfig

    async def begin(self, wanted: WantedFlight) -> JsonObject: ...
    def lead(self, demand: Demand) -> JsonObject: ...
    def guide(
        self, places: Mapping[str, Moving], valid_s: float, client: ClientIdentity, *, take_over: bool
    ) -> JsonObject: ...
    def turn(self, heading_rad: float) -> JsonObject: ...
    def scale(self, factor: float) -> JsonObject: ...
    def stop(self) -> JsonObject: ...
    def status(self) -> JsonObject: ...


def _keeper(context: Context) -> FormationKeeper:
    keeper: FormationKeeper = context.services.extensions["formation"]
    return keeper


def shown(status: JsonObject) -> JsonObject:
    """A status with its heading in degrees, as everything that people read."""
    if (heading := status.pop("heading_rad", None)) is not None:
        status["heading_deg"] = round(math.degrees(heading), 1)
    return status


def vector(values: list[float]) -> tuple[float, float, float]:
    """Three numbers of a request."""
    x, y, z = values
    return x, y, z


_TARGET = (error_codes.TARGET_ERROR, error_codes.REFUSED)

METHODS: tuple[Method[Context], ...] = (
    Method("formation.start", FormationStartParams, formation_start, FormationStatus, _TARGET),
    Method("formation.move", FormationMoveParams, formation_move, FormationStatus, (error_codes.REFUSED,)),
    Method("formation.guide", FormationGuideParams, formation_guide, FormationStatus, (error_codes.REFUSED,)),
    Method("formation.turn", FormationTurnParams, formation_turn, FormationStatus, (error_codes.REFUSED,)),
    Method("formation.scale", FormationScaleParams, formation_scale, FormationStatus, (error_codes.REFUSED,)),
    Method("formation.stop", NoParams, formation_stop, FormationStatus, always=True),
    Method("formation.status", NoParams, formation_status, FormationStatus, while_stopping=True),
)
