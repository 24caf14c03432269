"""The methods of flight by setpoints, and of the fleet's world frame, in which setpoints are given. `METHODS` and
`ORIGIN` are their parts of the table."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from skygcs.core.geo import EAST_DEG, Origin
from skygcs.rpc import error_codes
from skygcs.rpc.context import Context, JsonObject, as_json, command, resolve
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import (
    Lat,
    ListParams,
    Lon,
    MethodParams,
    NoParams,
    Outcomes,
    Result,
    TargetParams,
    TargetsParams,
)
from skygcs.runtime.vehicle_actor import VehicleActor


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

    It moves the vehicle's local frame, for programs on board. ArduPilot accepts it only while it has none.
    """
    push = context.services.fleet.orders.push_origin
    return as_json(await push(params.targets, home=params.home, force=params.force, reports=context.reports))


_REFUSED = (error_codes.REFUSED,)


_VEHICLE = (error_codes.TARGET_ERROR, error_codes.REFUSED)


ORIGIN: tuple[Method[Context], ...] = (
    Method("origin.get", NoParams, origin_get, OriginStatus),
    Method("origin.set", OriginSetParams, origin_set, OriginStatus, _REFUSED),
    Method("origin.from_vehicle", OriginFromParams, origin_from_vehicle, OriginStatus, _VEHICLE),
    Method("origin.push", OriginPushParams, origin_push, Outcomes, _VEHICLE),
)


Gain = Annotated[float, Field(ge=0, le=100)]


Mode = Literal["off", "position", "velocity", "attitude", "raw"]


Axes = Annotated[
    list[float | None],
    Field(min_length=3, max_length=3, description="[x, y, up] in the fleet's frame; null: not given."),
]


class ControlSetParams(TargetsParams):
    """Which control loops skygcs closes: none (position), position (velocity), position and velocity (attitude)."""

    mode: Mode = Field(
        description="What is sent (docs/explanation/flight-control.md). raw: attitude, body rates or "
        "acceleration; off: hold is ordered."
    )
    force: bool = Field(
        False, description="Attitude although the autopilot keeps its tilt for long after setpoints are lost."
    )


class AxisChange(MethodParams):
    """Gains of one axis; what is left out stays."""

    pos_p_per_s: Gain | None = Field(None, description="m/s per metre.")
    vel_p: Gain | None = Field(None, description="Thrust per m/s.")
    vel_i: Gain | None = Field(None, description="Thrust per metre.")
    vel_d: Gain | None = Field(None, description="Thrust per m/s².")


class ControlGainsParams(TargetsParams):
    """Without changes the gains are read."""

    xy: AxisChange | None = Field(None, description="Any of pos_p_per_s, vel_p, vel_i, vel_d; the rest stays.")
    z: AxisChange | None = Field(None, description="The same of the vertical axis.")
    hover_thrust: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None, description="Normalised thrust that carries the weight."
    )
    force: bool = Field(False, description="Also gains that the measured delay leaves too little margin.")

    def changes(self) -> dict[str, Any]:
        """Return what is to change, nested as it came."""
        given = self.model_dump(exclude={"targets", "force"}, exclude_none=True)
        return {key: value for key, value in given.items() if value != {}}


class SetpointParams(TargetsParams):
    """A position, a velocity, or of each axis one of them; valid for ``valid_s``.

    In the control mode raw instead: an attitude (quaternion, or roll_deg, pitch_deg and yaw_deg) with a thrust, body
    rates with a thrust, or acc_enu_mps2 alone. One that exceeds a limit of the fleet file is refused.
    """

    pos_enu_m: Axes | None = None
    vel_enu_mps: Axes | None = None
    acc_enu_mps2: Annotated[list[float], Field(min_length=3, max_length=3)] | None = Field(
        None,
        description="[x, y, up] along the fleet's axes. Beside a position or velocity: fed forward; alone: raw.",
    )
    yaw_deg: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        None, description="From the frame's x axis, counter-clockwise; null: it stays."
    )
    yaw_rate_dps: Annotated[float, Field(ge=-360, le=360)] | None = Field(
        None,
        description="Degrees per second, counter-clockwise. Without yaw_deg: from wherever the nose is.",
    )
    valid_s: Annotated[float, Field(ge=0.1, le=5)] = Field(
        0.5, description="Without a newer setpoint the vehicle stays where it is after this."
    )
    attitude: Annotated[list[float], Field(min_length=4, max_length=4)] | None = Field(
        None,
        description="Raw: quaternion [w, x, y, z], body (x forward, y left, z up) to the fleet's frame (x, y, up).",
    )
    roll_deg: Annotated[float, Field(ge=-180, le=180)] | None = Field(
        None, description="Raw: right side down; with pitch_deg and yaw_deg instead of the quaternion."
    )
    pitch_deg: Annotated[float, Field(ge=-90, le=90)] | None = Field(None, description="Raw: nose up.")
    body_rates_deg_s: Annotated[list[float], Field(min_length=3, max_length=3)] | None = Field(
        None,
        description="Raw: [roll, pitch, yaw], positive as roll_deg, pitch_deg and yaw_deg grow in level flight.",
    )
    thrust: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None, description="Raw: collective, beside an attitude or body rates."
    )
    force: bool = Field(False, description="Follow it although it leads too close to another vehicle.")
    take_over: bool = Field(
        False,
        description="Follow it although the vehicle follows the setpoints of another client, which loses it.",
    )

    @model_validator(mode="after")
    def _say_every_axis(self) -> SetpointParams:
        raw = (self.attitude, self.roll_deg, self.pitch_deg, self.body_rates_deg_s, self.thrust)
        is_raw = any(value is not None for value in raw)
        if self.pos_enu_m is None and self.vel_enu_mps is None and (is_raw or self.acc_enu_mps2 is not None):
            return self
        if is_raw:
            raise ValueError("attitude, body rates and thrust exclude position and velocity: give one or the other")
        position = self.pos_enu_m or [None, None, None]
        velocity = self.vel_enu_mps or [None, None, None]
        if (position[0] is None) != (position[1] is None):
            raise ValueError("pos_enu_m: give x and y together, or neither")
        for i, axis in enumerate(("x", "y", "up")):
            if position[i] is None and velocity[i] is None:
                raise ValueError(f"{axis} is given neither in pos_enu_m nor in vel_enu_mps")
        return self


class ControlRecordParams(TargetsParams):
    on: bool = Field(description="Begin or end.")


class GainsOfVehicle(Result):
    xy: dict[str, float]
    z: dict[str, float]
    hover_thrust: float
    limits: dict[str, float] = Field(
        description="thrust_min, thrust_max, tilt_max_deg, vel_xy_max_mps, vel_z_max_mps, acc_xy_max_mps2, "
        "acc_z_max_mps2."
    )


class GainsAnswer(Result):
    outcomes: dict[str, dict[str, Any]] = Field(description="Of each vehicle, if gains were to change.")
    gains: dict[str, GainsOfVehicle]


class Files(Result):
    files: dict[str, str | None] = Field(description="By vehicle: what is written, or was until now; null: nothing.")


class ControlReference(Result):
    """A setpoint in the fleet's frame; null on an axis: it follows the other of the two."""

    pos_enu_m: list[float | None] | None
    vel_enu_mps: list[float | None] | None
    yaw_deg: float | None


class StreamState(Result):
    client: str = Field(description="The client, for people.")
    left_s: float = Field(description="Until the deadline of its newest setpoint: then another client may begin.")


class ControlState(Result):
    """The state's ``control`` section, with the vehicle's name where it stands alone."""

    vehicle: str
    mode: str | None = Field(description="The control mode that was ordered; null: off.")
    control_mode: str | None = Field(
        description="The control mode it is flown in now: raw, attitude, velocity or position."
    )
    state: Literal["off", "engaging", "flying", "held"] = Field(
        description="held: the guard had it hold; nothing is sent."
    )
    reasons: list[str] = Field(description="Why it is not flown as it was wanted.")
    successor: str | None = Field(
        description="The order that takes over: until its mode is seen it is held, and no setpoint is followed."
    )
    reference: ControlReference | None
    error_enu_m: list[float] | None = Field(
        description="Reference minus position along the fleet's axes; 0 for a height that follows its velocity; null "
        "without a reference, and where the horizontal velocity is followed."
    )
    error_m: float | None = Field(description="Its length.")
    state_age_s: float | None = Field(description="Age of the newest position.")
    delay_p95_s: float | None = Field(description="State age and round trip, 95th percentile: what the guard judges.")
    rtt_s: float | None = Field(description="Round trip, 95th percentile.")
    rate_hz: float | None
    ticks: int
    late: int
    skipped: int
    lateness_p99_s: float | None
    trajectory: dict[str, Any] | None = Field(
        description="The trajectory it follows: name, state, trajectory_s, duration_s, speed_factor, rate, "
        "finishes_in_s; null: none."
    )
    prediction: dict[str, Any] | None = Field(
        description="Of velocity control with prediction: active, refused, round_trip_s, disturbance_enu_mps2; "
        "null: off."
    )
    raw: str | None = Field(description="Kind of the raw setpoint in force: attitude, rates, acceleration; null: none.")
    saturation: list[str]
    integral_enu: list[float]
    thrust: float | None
    roll_deg: float | None
    pitch_deg: float | None
    recording: str | None
    stream: StreamState | None = Field(description="Whose setpoints it follows; null: nobody's.")
    setpoints_refused: int = Field(description="Refused as it followed those of another client, since it is known.")


async def control_set(context: Context, params: ControlSetParams) -> JsonObject:
    """Fly vehicles by setpoints of skygcs, or end that.

    A failure is undone.
    """
    return await command(context, params.targets, VehicleActor.control, mode=params.mode, force=params.force)


async def control_gains(context: Context, params: ControlGainsParams) -> JsonObject:
    """Read or change gains of the control law."""
    changes = params.changes()
    outcomes: JsonObject = {}
    if changes:
        answer = await command(context, params.targets, VehicleActor.change_gains, changes=changes, force=params.force)
        outcomes = answer["outcomes"]
    vehicles = context.services.fleet.resolve(params.targets)
    return {"outcomes": outcomes, "gains": {vehicle.name: vehicle.offboard.gains() for vehicle in vehicles}}


def control_setpoint(context: Context, params: SetpointParams) -> JsonObject:
    """One setpoint of a stream, up to 50 a second, after control.set.

    A vehicle follows the stream of one client, until its deadline or the end of its connection.
    """
    return as_json(context.services.fleet.orders.setpoint(params.targets, context.client, **params.arguments()))


def control_status(context: Context, params: ListParams) -> list[JsonObject]:
    """How each vehicle is controlled: mode, error, ages, ticks."""
    now = context.services.now()
    return [{"vehicle": v.name, **v.control_state(now)} for v in resolve(context.services, params.targets)]


async def control_record(context: Context, params: ControlRecordParams) -> JsonObject:
    """Trace control at its full rate to a CSV file per vehicle (docs/reference/control-trace.md)."""
    files = {v.name: await v.offboard.record(params.on) for v in context.services.fleet.resolve(params.targets)}
    return {"files": files}


_TARGET = (error_codes.TARGET_ERROR,)


METHODS: tuple[Method[Context], ...] = (
    Method("control.set", ControlSetParams, control_set, Outcomes, _TARGET),
    Method("control.gains", ControlGainsParams, control_gains, GainsAnswer, _TARGET),
    Method("control.setpoint", SetpointParams, control_setpoint, Outcomes, _TARGET),
    Method("control.status", ListParams, control_status, list[ControlState], _TARGET),
    Method("control.record", ControlRecordParams, control_record, Files, _TARGET),
)
