"""The methods of vehicles: their state and their orders. `METHODS` is their part of the table.

An order whose arguments are its parameters is one row of the table: it names the method of `VehicleActor` that carries
it out, and the daemon calls that for every target (`FleetOrders.command_all`).
"""

from __future__ import annotations

from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from skygcs.core.vehicle.state import ComponentEntry, MessageRate, StatusTextEntry, VehicleState
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, as_json, command, one_vehicle, order_method, resolve, state_of
from skygcs.rpc.dispatch import Encoded, Method
from skygcs.rpc.models import Enu, Lat, ListParams, Lon, NoParams, Outcomes, TargetParams, Targets, TargetsParams
from skygcs.runtime.home_orders import set_home
from skygcs.runtime.vehicle_actor import VehicleActor

StateConfig = ConfigDict(use_attribute_docstrings=True, extra="allow")
for _typed in (StatusTextEntry, ComponentEntry, MessageRate, VehicleState):
    _typed.__pydantic_config__ = StateConfig  # type: ignore[union-attr]  # where pydantic looks for it


class SystemComponent(ComponentEntry):
    """One component and the vehicle it belongs to."""

    __pydantic_config__ = StateConfig  # type: ignore[misc]

    sysid: int
    vehicle: str | None
    """The vehicle to whose system it belongs; null: no autopilot was heard."""


class ArmParams(TargetsParams):
    force: bool = Field(
        False,
        description="Although the autopilot's checks fail, or a required preflight.",
    )
    wait_s: float = Field(0.0, ge=0, le=600, description="Keep trying this long while the autopilot is not ready.")


class DisarmParams(TargetsParams):
    force: bool = Field(False, description="Disarm in flight as well: the vehicle falls.")
    confirm: str | None = Field(
        None,
        max_length=100,
        description='While two vehicles send with one system id: "disarm-N", N vehicles.',
    )


class ModeParams(TargetsParams):
    mode: str = Field(min_length=1, description='E.g. "AUTO.LOITER" (PX4), "GUIDED" (ArduCopter).')
    force: bool = Field(
        False,
        description="In the air into a mode flown by sticks, without sticks; never one in which it would fall.",
    )


class TakeoffParams(TargetsParams):
    height_m: float | None = Field(None, gt=0, le=500, description="Above the ground; null: the fleet file's.")
    arm: bool = Field(True, description="Arm first if it is not armed.")
    wait_s: float = Field(0.0, ge=0, le=600, description="Keep trying this long while the autopilot is not ready.")
    force: bool = Field(
        False,
        description="Although a required preflight is not passed, or another vehicle is in the "
        "way; the autopilot's checks remain.",
    )


class HoldParams(TargetsParams):
    instead_of: int | None = Field(
        None,
        ge=0,
        description="order_number of the order to end; refused if a newer one moves the vehicle, or may. null: any.",
    )


class StopParams(TargetsParams):
    action: Literal["hold", "land", "kill"] = Field(
        "hold", description="hold where it is, land there, or kill: stop the motors, and what flies falls."
    )
    confirm: str | None = Field(
        None,
        max_length=100,
        description='kill only: "kill-N", N vehicles; two that send with one system id count twice.',
    )


class GotoParams(TargetsParams):
    lat_deg: Lat | None = None
    lon_deg: Lon | None = None
    height_m: float | None = Field(None, description="Metres above home; null: as high as it is now.")
    enu_m: Enu | None = None
    yaw_deg: float | None = Field(None, description="Heading, clockwise from north; null: the autopilot's choice.")
    force: bool = Field(
        False, description="Although it is beyond the configured limit, or another vehicle is in the way."
    )
    same_place: bool = Field(False, description="All to the same point, not in formation.")
    together: Targets | None = Field(
        None, description="Vehicles that the caller keeps apart from these: never in the way."
    )

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        geodetic = self.lat_deg is not None or self.lon_deg is not None
        if self.enu_m is not None and (geodetic or self.height_m is not None):
            raise ValueError("give either enu_m, or lat_deg, lon_deg and height_m, not both")
        if self.enu_m is None and (self.lat_deg is None or self.lon_deg is None):
            raise ValueError("give lat_deg and lon_deg, or enu_m")
        return self


class RebootParams(TargetsParams):
    force: bool = Field(False, description="Reboot although it is armed.")


class ForgetParams(TargetsParams):
    force: bool = Field(False, description="Although it is heard, or was lost armed in the last half hour.")


class RenumberParams(TargetParams):
    sysid: int = Field(ge=1, le=250, description="The new system id; 251 to 255 belong to ground stations.")
    force: bool = Field(False, description="Although the fleet file gives it to a vehicle that is not heard.")


class SetHomeParams(TargetsParams):
    lat_deg: Lat | None = None
    lon_deg: Lon | None = None
    alt_amsl_m: float | None = Field(None, description="Above mean sea level; null: as its present home.")
    force: bool = Field(False, description="Also in the air, and beyond the configured limit.")

    @model_validator(mode="after")
    def _place_or_none(self) -> Self:
        given = [self.lat_deg is not None, self.lon_deg is not None]
        if not all(given) and (any(given) or self.alt_amsl_m is not None):
            raise ValueError("give lat_deg and lon_deg, or nothing (home is where it stands)")
        return self


async def vehicles_list(context: Context, params: ListParams) -> Encoded:
    """The state of some or all vehicles, by system id."""
    vehicles = resolve(context.services, params.targets)
    return Encoded(await context.slices.encoded_list(state_of(context.services, vehicle) for vehicle in vehicles))


def vehicles_get(context: Context, params: TargetParams) -> JsonObject:
    """The state of one vehicle."""
    return state_of(context.services, one_vehicle(context.services, params.target))


async def vehicles_mode(context: Context, params: ModeParams) -> JsonObject:
    """Set the flight mode by the autopilot's own name for it.

    For copters in flight the mode of a return or landing is vehicles.rtl or vehicles.land; force sets the mode alone.
    """
    return await command(context, params.targets, VehicleActor.set_mode, name=params.mode, force=params.force)


def vehicles_forget(context: Context, params: ForgetParams) -> JsonObject:
    """Forget vehicles that are gone. One that is heard again is discovered anew."""
    return as_json(context.services.fleet.forget(params.targets, force=params.force))


async def vehicles_renumber(context: Context, params: RenumberParams) -> JsonObject:
    """Give a vehicle another system id, by its parameter and a reboot.

    Refused while it is not known to be disarmed, and for a taken id. It keeps its name until the daemon ends.
    """
    return as_json(await context.services.renumbering.run(params.target, params.sysid, force=params.force))


def components_list(context: Context, _: NoParams) -> list[JsonObject]:
    """Every component that was heard; at most 32 of a system and 1024 in all."""
    return context.services.fleet.components_status()


_TARGET = (error_codes.TARGET_ERROR,)

METHODS: tuple[Method[Context], ...] = (
    Method("vehicles.list", ListParams, vehicles_list, list[VehicleState], _TARGET, always=True),
    Method("vehicles.get", TargetParams, vehicles_get, VehicleState, _TARGET, always=True),
    order_method("vehicles.arm", ArmParams, VehicleActor.arm, "Arm."),
    order_method("vehicles.disarm", DisarmParams, VehicleActor.disarm, "Disarm; in flight only with force."),
    Method("vehicles.mode", ModeParams, vehicles_mode, Outcomes, _TARGET),
    order_method(
        "vehicles.takeoff", TakeoffParams, VehicleActor.takeoff, "Take off to a height above the ground it stands on."
    ),
    order_method("vehicles.land", TargetsParams, VehicleActor.land, "Land where it is."),
    order_method(
        "vehicles.rtl",
        TargetsParams,
        VehicleActor.rtl,
        "Return to launch and land there, once the way home is clear; ordered again alone, a vehicle returns at once.",
    ),
    order_method("vehicles.hold", HoldParams, VehicleActor.hold, "Stop and hold position."),
    order_method(
        "vehicles.stop",
        StopParams,
        VehicleActor.stop,
        "Emergency stop: over every link, also to lost vehicles, for up to 30 s until the vehicle shows or refuses it.",
        errors=(*_TARGET, error_codes.REFUSED),
    ),
    order_method(
        "vehicles.goto",
        GotoParams,
        VehicleActor.goto,
        "Fly to a place on earth, or in metres about the fleet's origin.",
    ),
    order_method("vehicles.reboot", RebootParams, VehicleActor.reboot, "Reboot the autopilot; armed only with force."),
    Method("vehicles.forget", ForgetParams, vehicles_forget, Outcomes, _TARGET),
    Method("vehicles.renumber", RenumberParams, vehicles_renumber, Outcomes, _TARGET, outlives_client=True),
    order_method(
        "vehicles.set_home",
        SetHomeParams,
        set_home,
        "Set the autopilot's home: a place, or (without one) where it stands.",
    ),
)

COMPONENTS = Method("components.list", NoParams, components_list, list[SystemComponent])
