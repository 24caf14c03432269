"""The methods of the fleet's world frame. `METHODS` is their part of the table."""

from __future__ import annotations

from pydantic import Field

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, as_json
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import Lat, Lon, MethodParams, NoParams, Outcomes, Result, TargetParams, TargetsParams


class OriginSetParams(MethodParams):
    lat_deg: Lat
    lon_deg: Lon
    alt_amsl_m: float = Field(description="Above mean sea level.")
    x_heading_deg: float | None = Field(
        None, ge=-360, le=360, description="Compass heading of the x axis; null: as it is, 90 (plain ENU) at first."
    )
    force: bool = Field(False, description="Although a vehicle is farther than 20 km away.")


class OriginFromParams(TargetParams):
    heading: bool = Field(False, description="Point x along the vehicle's nose.")
    force: bool = Field(
        False, description="Without a 3D fix, too, and although another vehicle is farther than 20 km away."
    )


class OriginPushParams(TargetsParams):
    home: bool = Field(
        False,
        description="Set their homes there as well, to which all would return.",
    )
    force: bool = Field(False, description="Although it is armed; also a home in the air or beyond the goto limit.")


class OriginPlace(Result):
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    x_heading_deg: float


class OriginStatus(Result):
    """The fleet's world frame."""

    origin: OriginPlace | None = Field(description="null: no origin is set, and positions have no enu_m.")
    generation: int = Field(description="Increases with every change; positions name theirs as origin_generation.")


def origin_get(context: Context, _: NoParams) -> JsonObject:
    """The origin of the fleet's world frame."""
    return context.services.fleet.origin_status()


def origin_set(context: Context, params: OriginSetParams) -> JsonObject:
    """Set the origin until the daemon ends. No vehicle moves."""
    fleet = context.services.fleet
    heading_deg = params.x_heading_deg
    if heading_deg is None:
        heading_deg = EAST_DEG if fleet.origin is None else fleet.origin.x_heading_deg
    fleet.set_origin(Origin(params.lat_deg, params.lon_deg, params.alt_amsl_m, heading_deg), force=params.force)
    return fleet.origin_status()


def origin_from_vehicle(context: Context, params: OriginFromParams) -> JsonObject:
    """Set the origin to where a vehicle is now; as origin.set."""
    fleet = context.services.fleet
    fleet.set_origin_from(params.target, heading=params.heading, force=params.force)
    return fleet.origin_status()


async def origin_push(context: Context, params: OriginPushParams) -> JsonObject:
    """Send vehicles the origin (SET_GPS_GLOBAL_ORIGIN) and read theirs back.

    It moves the vehicle's own local frame, for programs on board. ArduPilot accepts it only while it has none.
    """
    push = context.services.fleet.orders.push_origin
    return as_json(await push(params.targets, home=params.home, force=params.force, reports=context.reports))


_REFUSED = (error_codes.REFUSED,)


_VEHICLE = (error_codes.TARGET_ERROR, error_codes.REFUSED)


METHODS: tuple[Method[Context], ...] = (
    Method("origin.get", NoParams, origin_get, OriginStatus),
    Method("origin.set", OriginSetParams, origin_set, OriginStatus, _REFUSED),
    Method("origin.from_vehicle", OriginFromParams, origin_from_vehicle, OriginStatus, _VEHICLE),
    Method("origin.push", OriginPushParams, origin_push, Outcomes, _VEHICLE),
)
