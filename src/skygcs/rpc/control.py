"""The methods of flight control: `METHODS` is their part of the table."""

from __future__ import annotations

from skygcs.rpc import control_models as c
from skygcs.rpc import dispatch
from skygcs.rpc import models as m
from skygcs.rpc.context import Context, outcomes
from skygcs.rpc.dispatch import Method
from skygcs.rpc.ports import JsonObject, resolve
from skygcs.runtime.vehicle_actor import VehicleActor


async def control_set(context: Context, params: c.ControlSetParams) -> JsonObject:
    """Fly vehicles by setpoints of skygcs, or leave them to their autopilots again.

    The whole sequence: checks, a stream of setpoints, the autopilot's mode (OFFBOARD, GUIDED), its verification; undone
    on failure. A vehicle begins by staying where it is. With "off" it is told to hold.
    """
    return await outcomes(context, params.targets, VehicleActor.control, mode=params.mode, force=params.force)


async def control_gains(context: Context, params: c.ControlGainsParams) -> JsonObject:
    """Read the gains of the control law, or change some of them from the next tick on."""
    changes = params.changes()
    told: JsonObject = {}
    if changes:
        answer = await outcomes(context, params.targets, VehicleActor.change_gains, changes=changes, force=params.force)
        told = answer["outcomes"]
    vehicles = context.daemon.fleet.resolve(params.targets)
    return {"outcomes": told, "gains": {vehicle.name: vehicle.gains() for vehicle in vehicles}}


def control_setpoint(context: Context, params: c.SetpointParams) -> JsonObject:
    """One setpoint of a stream: made for 50 a second. See control.set first."""
    told = context.daemon.fleet.setpoint(params.targets, **params.model_dump(exclude={"targets"}))
    return {"outcomes": {name: outcome.as_dict() for name, outcome in told.items()}}


def control_status(context: Context, params: m.ListParams) -> list[JsonObject]:
    """How each vehicle is flown: way, error, ages, ticks. The state of a vehicle has the same under "control"."""
    now = context.daemon.now()
    return [{"vehicle": v.name, **v.control_state(now)} for v in resolve(context.daemon, params.targets)]


def control_record(context: Context, params: c.ControlRecordParams) -> JsonObject:
    """Trace control at its full rate to a CSV file per vehicle (docs/reference/control-trace.md)."""
    files = {v.name: v.record_control(params.on) for v in context.daemon.fleet.resolve(params.targets)}
    return {"files": files}


_TARGET = (dispatch.TARGET_ERROR,)

METHODS: tuple[Method[Context], ...] = (
    Method("control.set", c.ControlSetParams, control_set, m.Outcomes, _TARGET),
    Method("control.gains", c.ControlGainsParams, control_gains, c.GainsAnswer, _TARGET),
    Method("control.setpoint", c.SetpointParams, control_setpoint, m.Outcomes, _TARGET),
    Method("control.status", m.ListParams, control_status, list[c.ControlState], _TARGET),
    Method("control.record", c.ControlRecordParams, control_record, c.Files, _TARGET),
)
