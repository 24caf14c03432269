"""Calibrations of simulated vehicles through their actors, over a link with delay, in virtual time."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.ext.calibration.calibration_run import CalibrationRun
from skygcs.ext.calibration.methods import calibrate, cancel_calibration, confirm_pose
from skygcs.ext.calibration.sensor_calibration import CANCEL_S, SILENCE_S, Sensor
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.vehicle import SimVehicle
from support.sim_field import SimField

pytestmark = pytest.mark.looptime

FIRMWARES = pytest.mark.parametrize("px4", [True, False], ids=["px4", "ardupilot"])


class Field(SimField):
    """One vehicle that stands ready."""

    def __init__(self, px4: bool) -> None:
        super().__init__(int(px4), int(not px4), {})
        self.sent: list[tuple[int, tuple[float, ...]]] = []

    @property
    def actor(self) -> VehicleActor:
        return next(iter(self.fleet.vehicles.values()))

    @property
    def simulated(self) -> SimVehicle:
        return self.sim.vehicles[0]

    def on_send(self, message: str, values: Any) -> None:
        if message == "COMMAND_LONG":
            self.sent.append((int(values["command"]), tuple(values.get(f"param{i}", 0.0) for i in range(1, 8))))

    def progress(self) -> list[dict[str, Any]]:
        return [event.data for event in self.events if event.kind == "calibration"]


@FIRMWARES
async def test_one_calibration_right_after_another_and_no_reboot_is_reported(px4: bool) -> None:
    """On the real firmwares a PX4 refused the second one for a moment, and an ArduCopter that had been up for long sent
    "Initialising ArduPilot" while it calibrates."""
    async with Field(px4) as field:
        await asyncio.sleep(40.0)
        for sensor in (Sensor.GYRO, Sensor.LEVEL, Sensor.COMPASS):
            begun = len(field.events)
            outcome = await calibrate(field.actor, sensor=sensor)
            assert outcome.ok, outcome
            assert field.actor.part(CalibrationRun).status() is None
            if px4 or sensor is Sensor.COMPASS:
                told = [event.data["percent"] for event in field.events[begun:] if event.kind == "calibration"]
                percents = [percent for percent in told if percent is not None]
                assert percents == sorted(percents) and len(set(percents)) >= 4, sensor
        assert not [event for event in field.events if event.kind == "reboot"]


async def test_a_px4_finds_its_six_poses_by_itself() -> None:
    async with Field(px4=True) as field:
        assert (await calibrate(field.actor, sensor=Sensor.ACCEL)).ok
        poses = list(dict.fromkeys(data["pose"] for data in field.progress() if data["pose"]))
        assert sorted(poses) == ["left", "level", "nose_down", "nose_up", "right", "upside_down"]
        assert not any(data["confirm"] for data in field.progress())
        wanted = [len(data["pending"]) for data in field.progress() if data["pending"]]
        assert wanted[0] == 6 and wanted == sorted(wanted, reverse=True)


async def test_a_px4_that_nobody_turns_reports_its_own_reason() -> None:
    async with Field(px4=True) as field:
        field.simulated.turned_by_hand = False
        outcome = await calibrate(field.actor, sensor=Sensor.ACCEL)
        assert (outcome.result, outcome.message) == ("failed", "failed: timeout: no motion")


async def test_an_arducopter_waits_for_each_pose_until_it_is_confirmed() -> None:
    async with Field(px4=False) as field:
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.ACCEL))
        asked = []
        while not run.done():
            await asyncio.sleep(0.5)
            status = field.actor.part(CalibrationRun).status()
            if status is not None and status["confirm"]:
                asked.append(status["pose"])
                assert (await confirm_pose(field.actor)).ok
        assert asked == ["level", "left", "right", "nose_down", "nose_up", "upside_down"]
        assert (await run).ok
        assert [p[0] for command, p in field.sent if command == 42429] == [1, 2, 3, 4, 5, 6]
        # the end that it repeats is not taken for the next one's
        again = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.ACCEL))
        await asyncio.sleep(5.0)
        assert not again.done() and field.actor.part(CalibrationRun).status()["confirm"]
        again.cancel()


async def test_a_pose_that_was_not_taken_is_asked_for_again() -> None:
    async with Field(px4=False) as field:
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.ACCEL))
        await asyncio.sleep(5.0)
        field.simulated.calibration.position = 3  # it is at another step by now
        assert not (await confirm_pose(field.actor)).ok
        assert field.actor.part(CalibrationRun).status()["confirm"]
        run.cancel()


@FIRMWARES
async def test_what_does_not_fit_is_refused(px4: bool) -> None:
    async with Field(px4) as field:
        for order in (confirm_pose, cancel_calibration):
            assert (await order(field.actor)).message == "refused: it is not being calibrated"
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.COMPASS))
        await asyncio.sleep(2.0)
        assert (await calibrate(field.actor, sensor=Sensor.GYRO)).message == "refused: its compass is being calibrated"
        assert (await run).ok
        await asyncio.sleep(15.0)
        assert (await field.actor.arm(force=True)).ok
        field.sent.clear()
        outcome = await calibrate(field.actor, sensor=Sensor.GYRO)
        assert outcome.result == "refused" and "armed" in outcome.message
        assert not field.sent


@FIRMWARES
async def test_an_order_a_client_that_goes_and_the_end_of_the_daemon_cancel_it(px4: bool) -> None:
    async with Field(px4) as field:

        async def ordered(run: asyncio.Future[Any]) -> None:
            assert (await cancel_calibration(field.actor)).ok
            assert (await run).result == "cancelled"

        async def gone(run: asyncio.Future[Any]) -> None:
            run.cancel()
            await asyncio.gather(run, return_exceptions=True)
            await asyncio.sleep(2.0)
            assert field.actor.part(CalibrationRun).status() is None

        async def ended(run: asyncio.Future[Any]) -> None:
            await field.actor.wind_down()
            assert (await run).result == "cancelled"

        for end in (ordered, gone, ended):
            run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.COMPASS))
            await asyncio.sleep(4.0)
            assert field.simulated.calibration is not None, end
            await end(run)
            assert field.simulated.calibration is None, end


async def test_a_px4_whose_last_text_is_lost_is_seen_to_have_ended() -> None:
    async with Field(px4=True) as field:
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.GYRO))
        await asyncio.sleep(1.7)
        field.simulated.calibration.script = iter(())  # it says nothing more
        outcome = await run
        assert outcome.result == "timeout" and "its result was not heard" in outcome.message
        assert outcome.elapsed_s < 15.0


async def test_a_vehicle_that_says_nothing_more_is_not_waited_for_for_ever() -> None:
    async with Field(px4=False) as field:
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.COMPASS))
        await asyncio.sleep(4.0)
        field.simulated.calibration.script = iter([10_000.0])
        began = field.loop.time()
        assert (await run).message == f"timeout: no progress for {SILENCE_S:.0f} s"
        assert field.loop.time() - began < SILENCE_S + 5.0


async def test_a_px4_that_does_not_confirm_a_cancellation_is_given_up() -> None:
    async with Field(px4=True) as field:
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.ACCEL))
        await asyncio.sleep(3.0)
        field.simulated.tx.say = lambda severity, text: None  # type: ignore[method-assign]
        assert (await cancel_calibration(field.actor)).ok
        outcome = await run
        assert outcome.result == "cancelled" and "did not confirm" in outcome.message
        assert CANCEL_S < outcome.elapsed_s < 20.0


@FIRMWARES
@pytest.mark.parametrize("forgotten", [False, True])
async def test_a_lost_rebooted_or_forgotten_vehicle_ends_it(px4: bool, forgotten: bool) -> None:
    async with Field(px4) as field:
        run = asyncio.ensure_future(calibrate(field.actor, sensor=Sensor.COMPASS))
        await asyncio.sleep(3.0)
        if forgotten:
            field.fleet.forget("all", force=True)
        else:
            field.simulated.reboot(field.loop.time())
        assert (await asyncio.wait_for(run, 60.0)).result == "lost"
