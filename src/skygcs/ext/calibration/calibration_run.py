"""Runs the calibrations of one vehicle (`sensor_calibration`): sends its commands, gives it what the vehicle
says, and publishes each change as an event of kind "calibration". One at a time per vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import COMMAND_LONG, MAG_CAL_PROGRESS, MAG_CAL_REPORT
from skygcs.core.protocols.command import RETRY_TIMERS_S, CommandSpec, Outcome
from skygcs.core.vehicle.gate import standing
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.ext.calibration.sensor_calibration import (
    BLOCKING_TIMERS_S,
    Calibration,
    CalibrationStatus,
    Sensor,
    check_calibration,
    reader_of,
)
from skygcs.runtime.loop_clock import DeadlineTimer
from skygcs.runtime.order_runner import duplicate_refusal
from skygcs.runtime.task_set import TaskSet
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehiclePart

CALIBRATE = standing("calibrate")

COMPASS_INTERVAL_US = 500_000.0
"""An ArduCopter streams the progress of a compass only where a station has asked for it, by SR_EXTRA3 or by itself."""

BUSY_TRIES, BUSY_S = 3, 1.0
"""A PX4's last text comes while its worker is still busy, and the next calibration is refused for up to a second."""

KIND = "calibration"


class CalibrationRun(VehiclePart):
    """Calibration of one vehicle's sensors. The coroutines are orders: they return an outcome and do not raise."""

    messages = frozenset({COMMAND_LONG, MAG_CAL_PROGRESS, MAG_CAL_REPORT})

    def __init__(self, actor: VehicleActor) -> None:
        self._vehicle = vehicle = actor.vehicle
        self._commands = actor.commands
        self._loop = loop = actor.services.loop
        self._on_event = actor.services.on_event
        self._tasks = TaskSet(loop, self._on_event, vehicle.name, vehicle.sysid)
        self._timer = DeadlineTimer(loop, self._on_timer)
        self._calibration: Calibration | None = None
        self._readers: dict[str, Callable[[dict[str, Any], float], None]] = {}
        self._done: asyncio.Future[None] | None = None
        self._published: CalibrationStatus | None = None

    # -- orders

    async def run(self, sensor: Sensor) -> Outcome:
        """Calibrate, until the vehicle has a result. If its caller is cancelled, so is the calibration."""
        # refuse
        now = self._loop.time()
        if self._calibration is not None:
            return Outcome.refused(f"its {self._calibration.sensor} is being calibrated")
        if self._vehicle.duplicate:
            return duplicate_refusal(self._vehicle)
        try:
            check_calibration(self._vehicle, now)
        except RefusedError as error:
            return Outcome.refused(str(error))
        # begin
        calibration = self._calibration = Calibration(sensor, self._vehicle.family, now)
        self._readers = reader_of(calibration)
        done = self._done = self._loop.create_future()
        self._published = None
        # start it on board and follow it to its end
        try:
            if sensor is Sensor.COMPASS and self._vehicle.family == "ardupilot":
                await self._request_progress()
            answer = await self._start(calibration)
            calibration.on_answer(answer, self._loop.time())
            self._changed()
            if calibration.outcome is None:
                await done
        finally:
            # end in every case, and cancel on board what still runs
            self._timer.set(None)
            self._calibration, self._readers = None, {}
            if calibration.outcome is None:
                if (spec := calibration.cancel(self._loop.time())) is not None:
                    self._tasks.start(self._commands.run(spec, clearance=CALIBRATE), "cancel calibration")
                calibration.give_up(self._loop.time())
            if not done.done():
                done.set_result(None)
        assert calibration.outcome is not None
        return calibration.outcome

    async def confirm(self) -> Outcome:
        """Confirm that the vehicle lies as its calibration asked for."""
        calibration = self._calibration
        if calibration is None:
            return Outcome.refused("it is not being calibrated")
        step = calibration.confirm(self._loop.time())
        if isinstance(step, str):
            return Outcome.refused(step)
        self._changed()
        outcome = await self._commands.run(step, clearance=CALIBRATE)
        calibration.on_pose_answer(outcome)
        self._changed()
        return outcome

    async def cancel(self) -> Outcome:
        """End the calibration that runs."""
        calibration, done = self._calibration, self._done
        if calibration is None or done is None:
            return Outcome.refused("it is not being calibrated")
        spec = calibration.cancel(self._loop.time())
        self._changed()
        if spec is not None:
            await self._commands.run(spec, clearance=CALIBRATE)
        await asyncio.shield(done)
        ended = calibration.outcome
        assert ended is not None
        if ended.result == "cancelled":
            return Outcome(True, "accepted", ended.message)
        return Outcome(False, ended.result, f"it ended before that: {ended.message}")

    # -- what the vehicle says

    def status(self) -> CalibrationStatus | None:
        """Status of the calibration that runs; None: none runs."""
        return None if self._calibration is None else self._calibration.status()

    def on_frame(self, frame: Frame, now: float) -> None:
        if self._readers and (reader := self._readers.get(frame.name)) is not None:
            reader(frame.fields(), now)
            self._changed()

    def on_text(self, text: str) -> None:
        if self._calibration is not None:
            self._calibration.on_text(text, self._loop.time())
            self._changed()

    def tick(self, now: float) -> None:
        if self._calibration is not None:
            self._calibration.on_heartbeat(self._vehicle.system_status, now)
            self._changed()

    def stop(self, result: str, text: str) -> None:
        if self._calibration is not None:
            self._calibration.on_lost(text, self._loop.time())
            self._changed()

    async def wind_down(self) -> None:
        """Cancel the calibration that runs, and wait until the vehicle has been sent that."""
        if self._calibration is not None:
            await self.cancel()
        await self._tasks.settled()

    def close(self, reason: str) -> None:
        self.stop("lost", reason)  # nobody ticks it any more: it would not end by itself
        self._timer.set(None)
        self._tasks.close()

    # -- internal

    async def _start(self, calibration: Calibration) -> Outcome:
        timers_s = BLOCKING_TIMERS_S if calibration.answer_is_result else RETRY_TIMERS_S
        answer = await self._commands.run(calibration.start(), timers_s=timers_s, clearance=CALIBRATE)
        for _ in range(BUSY_TRIES):
            if answer.result != "temporarily_rejected" or calibration.outcome is not None:
                break
            await asyncio.sleep(BUSY_S)
            answer = await self._commands.run(calibration.start(), timers_s=timers_s, clearance=CALIBRATE)
        return answer

    async def _request_progress(self) -> None:
        for msgid in (MAG_CAL_PROGRESS, MAG_CAL_REPORT):
            await self._commands.run(CommandSpec(mav_cmd.SET_MESSAGE_INTERVAL, (float(msgid), COMPASS_INTERVAL_US)))

    def _on_timer(self) -> None:
        if self._calibration is not None:
            self._calibration.on_time(self._loop.time())
            self._changed()

    def _changed(self) -> None:
        """Publish a change, end the run if the calibration is done, and set the timer."""
        calibration, done = self._calibration, self._done
        if calibration is None or done is None:
            return
        if calibration.outcome is not None and not done.done():
            done.set_result(None)
        self._timer.set(calibration.deadline)
        status = calibration.status()
        if status != self._published and calibration.outcome is None:
            self._published = status
            self._on_event(Event(KIND, self._vehicle.name, self._vehicle.sysid, _text(status), dict(status)))


def _text(status: CalibrationStatus) -> str:
    """One line for the log."""
    parts = [f"calibrating {status['sensor']}"]
    if status["percent"] is not None:
        parts.append(f"{status['percent']} %")
    if status["pose"] is not None:
        parts.append(f"{'wants to lie' if status['confirm'] else 'in pose'} {status['pose'].replace('_', ' ')}")
    if status["text"]:
        parts.append(status["text"])
    return ": ".join([parts[0], ", ".join(parts[1:])]) if len(parts) > 1 else parts[0]
