"""The orders and methods of calibrations, and the extension that has them: it is made when one of them is first
called."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.flight_lock import SensorCalibration
from skygcs.ext.calibration.calibration_run import CalibrationRun
from skygcs.ext.calibration.sensor_calibration import Sensor
from skygcs.extension import Extension, NoTable, StateGroup
from skygcs.rpc.context import Context, order_method
from skygcs.rpc.dispatch import Method
from skygcs.rpc.models import TargetsParams
from skygcs.runtime.vehicle_actor import VehicleActor

CALIBRATE = 'Calibrate a sensor of disarmed vehicles. Progress: events of kind "calibration". It ends with its client.'


class CalibrateParams(TargetsParams):
    sensor: Literal["gyro", "level", "compass", "accel"] = Field(
        description="accel: six poses; an ArduPilot asks for each and waits for vehicles.calibrate_confirm."
    )


async def calibrate(actor: VehicleActor, *, sensor: str) -> Outcome:
    """Lasts until it has a result."""
    if (why := actor.services.locks.refusal(SensorCalibration(actor.vehicle.key))) is not None:
        return actor.refuse("calibrate", why)
    with actor.outcomes.tracked("calibrate") as ended:
        return ended(await actor.part(CalibrationRun).run(Sensor(sensor)))


async def confirm_pose(actor: VehicleActor) -> Outcome:
    """Confirm the pose that an accel calibration of an ArduPilot asked for; a PX4 detects it."""
    with actor.outcomes.tracked("calibrate confirm") as ended:
        return ended(await actor.part(CalibrationRun).confirm())


async def cancel_calibration(actor: VehicleActor) -> Outcome:
    """End the calibration that runs."""
    with actor.outcomes.tracked("calibrate cancel") as ended:
        return ended(await actor.part(CalibrationRun).cancel())


METHODS: tuple[Method[Context], ...] = (
    order_method("vehicles.calibrate", CalibrateParams, calibrate, CALIBRATE),
    order_method("vehicles.calibrate_confirm", TargetsParams, confirm_pose, confirm_pose.__doc__ or ""),
    order_method("vehicles.calibrate_cancel", TargetsParams, cancel_calibration, cancel_calibration.__doc__ or ""),
)


class Calibration(Extension[NoTable]):
    names = ("calibration",)
    own_methods = METHODS

    def state_groups(self) -> Mapping[str, StateGroup]:
        return {"calibration": _state_of}


def _state_of(actor: VehicleActor, now: float) -> dict[str, Any] | None:
    run = actor.part_made(CalibrationRun)
    status = None if run is None else run.status()
    return None if status is None else dict(status)
