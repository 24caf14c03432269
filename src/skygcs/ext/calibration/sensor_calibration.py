"""One calibration of one vehicle's sensors, from its first command to its outcome. Pure.

    state      what came                                            next       what is to be sent
    --------   --------------------------------------------------   --------   --------------------------------
    STARTING   the command was accepted, and that is the result     DONE       -
    STARTING   the command was accepted, more follows               RUNNING    -
    STARTING   the command was refused, or not answered             DONE       -
    RUNNING    the vehicle asks for a pose (ArduCopter, accel)      POSING     -
    POSING     the operator confirms the pose                       RUNNING    the pose, to the vehicle
    RUNNING    the vehicle did not take the pose                    POSING     -
    RUNNING    progress, poses that are measured or still wanted    RUNNING    -
    not DONE   success, failure, or the end of a cancelled one      DONE       -
    RUNNING    a PX4 is no longer in state CALIBRATING              RUNNING    - (its last text may follow: LATE_TEXT_S)
    RUNNING    nothing for SILENCE_S, or LATE_TEXT_S after that     DONE       -
    not DONE   cancel, of a PX4                                     CANCELLING what cancels it
    CANCELLING success, failure or "cancelled", or CANCEL_S is over DONE       -
    not DONE   cancel, of an ArduCopter                             DONE       what cancels it, if there is such a thing
    not DONE   the vehicle was lost                                 DONE       -

What the autopilots do (PX4 1.16: src/modules/commander, calibration_messages.h and *_calibration.cpp; ArduCopter 4.6:
GCS_Common.cpp, AP_AccelCal.cpp, AP_Compass_Calibration.cpp):

    sensor    PX4                                            ArduCopter
    gyro      PREFLIGHT_CALIBRATION 1; texts "[cal] …"       the same; the acknowledgement, up to 30 s later, is the
    level     the same with param5 = 2                       result, and it sends nothing meanwhile
    compass   param2 = 1; it finds the poses by itself       DO_START_MAG_CAL; MAG_CAL_PROGRESS, MAG_CAL_REPORT
    accel     param5 = 1; it finds the poses by itself       param5 = 1; asks for each pose by ACCELCAL_VEHICLE_POS,
                                                             and is given the same command when the vehicle lies so
"""

from __future__ import annotations

import re
from collections.abc import Callable
from enum import Enum, StrEnum, auto
from typing import Any, TypedDict

from skygcs.core.mavlink import mav_cmd
from skygcs.core.protocols.command import MAX_TEXTS, CommandSpec, Outcome
from skygcs.core.vehicle.flight_evidence import why_not_idle
from skygcs.core.vehicle.orders import require_connected
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

SILENCE_S = 120.0
"""A PX4 that waits for a pose says so, and gives up after 90 s (detect_orientation); an ArduCopter repeats its request
each second."""

CANCEL_S = 5.0
"""PX4 looks for a cancellation between two poses and during a measurement, not while it waits for a pose. Its
acknowledgement says nothing: Commander refuses the command as it is busy, and the calibration accepts it."""

LATE_TEXT_S = 3.0
"""PX4's heartbeat may show the end before the text with the result has come."""

BLOCKING_TIMERS_S = (35.0, 35.0)
"""An ArduCopter answers a gyro calibration after up to 30 s (_init_gyro); a repeat before that would begin another."""

COMPASS_START_DELAY_S = 2.0
"""Before it samples (DO_START_MAG_CAL, param4): time to lift the vehicle."""

CALIBRATING = 2
"""MAV_STATE."""

PX4_POSES = {
    "down": "level",
    "left": "left",
    "right": "right",
    "front": "nose_down",
    "back": "nose_up",
    "up": "upside_down",
}
"""detect_orientation_str: the side of the vehicle that is down, or up where that is the top."""

ARDUPILOT_POSES = {1: "level", 2: "left", 3: "right", 4: "nose_down", 5: "nose_up", 6: "upside_down"}
"""ACCELCAL_VEHICLE_POS."""

ACCEL_SUCCESS, ACCEL_FAILED = 16777215, 16777216

COMPASS_SUCCESS = 4
COMPASS_FAILURES = {
    5: "failed",
    6: "it is not mounted as its parameters say",
    7: "the measured field has a wrong strength: metal or current nearby",
    8: "its offsets are too large: metal or current nearby",
}
"""MAG_CAL_STATUS."""

STARTED = re.compile(r"\[cal\] calibration started: (\d+) ")
PROGRESS = re.compile(r"\[cal\].*progress <(\d{1,3})>")
PENDING = re.compile(r"\[cal\] pending:((?: \w+)*)")
DETECTED = re.compile(r"\[cal\] (\w+) orientation detected")
SIDE_DONE = re.compile(r"\[cal\] (\w+) side (?:done|already completed)")
DONE_TEXT = re.compile(r"\[cal\] calibration done: ")
FAILED_TEXT = re.compile(r"\[cal\] calibration failed: (.*)")
CANCELLED_TEXT = "[cal] calibration cancelled"

TEXTS_VERSION = "2"
"""Version of PX4's texts, in the text that reports the start; with another version the table above may not hold."""


class Sensor(StrEnum):
    """Sensor that is calibrated."""

    GYRO = "gyro"
    LEVEL = "level"
    COMPASS = "compass"
    ACCEL = "accel"


class CalibrationState(Enum):
    """See the table at the top."""

    STARTING = auto()
    RUNNING = auto()
    POSING = auto()
    CANCELLING = auto()
    DONE = auto()


class CalibrationStatus(TypedDict):
    """How far a calibration is."""

    sensor: str
    percent: int | None
    """None: the vehicle does not say."""
    pose: str | None
    """The pose it is asked for or measured in: level, left, right, nose_down, nose_up or upside_down."""
    confirm: bool
    """It waits until somebody confirms that it lies so."""
    pending: list[str]
    """The poses that a PX4 still wants, in any order."""
    text: str
    """The vehicle's last text."""


def check_calibration(vehicle: Vehicle, now: float) -> None:
    """Raises RefusedError if it must not be calibrated now."""
    require_connected(vehicle, now)
    if vehicle.family not in ("px4", "ardupilot"):
        raise RefusedError("only PX4 and ArduPilot can be calibrated")
    if (why := why_not_idle(vehicle, now)) is not None:
        raise RefusedError(f"{why}; a vehicle is calibrated on the ground, disarmed")


class Calibration:
    """See the table at the top. ``now`` is the loop's time; `outcome` is set at its end."""

    def __init__(self, sensor: Sensor, family: str, now: float) -> None:
        """``family``: px4 or ardupilot."""
        self.sensor = sensor
        self.state = CalibrationState.STARTING
        self.outcome: Outcome | None = None
        self._px4 = family == "px4"
        self._started = self._heard_at = now
        self._idle_at: float | None = None
        """Since when a PX4 is no longer in state CALIBRATING."""
        self._was_calibrating = False
        self._percent: int | None = None
        self._pose: str | None = None
        self._position = 0
        self._pending: tuple[str, ...] = ()
        self._text = ""
        self._texts: list[str] = []
        self._compasses: dict[int, int] = {}
        """Percent of each."""
        self._reports: dict[int, str] = {}
        """Why the calibration of each compass that is at its end failed; "" if it did not."""

    # -- what is sent

    def start(self) -> CommandSpec:
        """The command that begins it."""
        if self.sensor is Sensor.COMPASS and not self._px4:
            # all compasses; not again on failure; saved when good
            return CommandSpec(mav_cmd.DO_START_MAG_CAL, (0.0, 0.0, 1.0, COMPASS_START_DELAY_S))
        place = {Sensor.GYRO: (0, 1.0), Sensor.COMPASS: (1, 1.0), Sensor.ACCEL: (4, 1.0), Sensor.LEVEL: (4, 2.0)}
        index, value = place[self.sensor]
        return CommandSpec(mav_cmd.PREFLIGHT_CALIBRATION, tuple(value if i == index else 0.0 for i in range(7)))

    @property
    def answer_is_result(self) -> bool:
        """True if the acknowledgement of `start` is the result, which may come after `BLOCKING_TIMERS_S`."""
        return not self._px4 and self.sensor in (Sensor.GYRO, Sensor.LEVEL)

    def confirm(self, now: float) -> CommandSpec | str:
        """The vehicle lies as it was asked to: what is to be sent, or why nothing is."""
        if self.state is not CalibrationState.POSING:
            return "it finds its pose by itself" if self._px4 else "it has not asked for a pose"
        self.state, self._heard_at = CalibrationState.RUNNING, now
        return CommandSpec(mav_cmd.ACCELCAL_VEHICLE_POS, (float(self._position),))

    def cancel(self, now: float) -> CommandSpec | None:
        """End it; the command that cancels it, None where an autopilot has no such command."""
        if self._px4:
            if self.state is not CalibrationState.DONE:
                self.state, self._heard_at = CalibrationState.CANCELLING, now
            return CommandSpec(mav_cmd.PREFLIGHT_CALIBRATION, (0.0,) * 7)
        if self.sensor is Sensor.COMPASS:
            # AP_Compass_Calibration.cpp sets _cal_requires_reboot when it begins
            self._end("cancelled", "cancelled; it arms only after a reboot", now)
            return CommandSpec(mav_cmd.DO_CANCEL_MAG_CAL, (0.0,))
        # AP_AccelCal waits for the next pose without an end
        self._end("cancelled", "given up; an ArduCopter ends it only when it is rebooted", now)
        return None

    # -- what came

    def on_answer(self, outcome: Outcome, now: float) -> None:
        """The outcome of the command of `start`."""
        if self.state is not CalibrationState.STARTING:
            return
        if not outcome.ok:
            self.state = CalibrationState.DONE
            self.outcome = outcome
        elif self.answer_is_result:
            self._end("accepted", f"{self.sensor} calibrated", now)
        else:
            self.state, self._heard_at = CalibrationState.RUNNING, now

    def on_pose_answer(self, outcome: Outcome) -> None:
        """The outcome of the command of `confirm`: where the vehicle did not take it, it waits for the pose still."""
        if not outcome.ok and self.state is CalibrationState.RUNNING:
            self.state = CalibrationState.POSING

    def on_text(self, text: str, now: float) -> None:
        """A text of the vehicle. A PX4's may come before the acknowledgement of its command."""
        if self.state is CalibrationState.DONE:
            return
        self._texts = [*self._texts, text][-MAX_TEXTS:]
        if not (self._px4 and text.startswith("[cal]")):
            return
        self._text = text.removeprefix("[cal] ")
        if self.state is not CalibrationState.CANCELLING:
            self._heard_at = now
        if DONE_TEXT.match(text):
            self._end("accepted", f"{self.sensor} calibrated", now)
        elif (failed := FAILED_TEXT.match(text)) is not None:
            self._end("failed", f"failed: {failed.group(1)}", now)
        elif text.startswith(CANCELLED_TEXT):
            self._end("cancelled", "cancelled", now)
        else:
            self._on_progress_text(text)

    def on_pose(self, position: int, now: float) -> None:
        """ACCELCAL_VEHICLE_POS of an ArduCopter: the pose it wants, or its end. It goes on sending the end of an
        earlier calibration until a new one begins."""
        if self.sensor is not Sensor.ACCEL or self._px4:
            return
        if self.state not in (CalibrationState.RUNNING, CalibrationState.POSING):
            return
        self._heard_at = now
        if position == ACCEL_SUCCESS:
            self._end("accepted", "accel calibrated; reboot it", now)
        elif position == ACCEL_FAILED:
            self._end("failed", "failed: begin again, and hold the vehicle still in each pose", now)
        elif position in ARDUPILOT_POSES and position != self._position:
            self._position, self._pose = position, ARDUPILOT_POSES[position]
            self._percent = 100 * (position - 1) // len(ARDUPILOT_POSES)
            self.state = CalibrationState.POSING

    def on_compass_progress(self, compass: int, percent: int, now: float) -> None:
        """MAG_CAL_PROGRESS."""
        if self._compass_runs() and compass not in self._reports:
            self._heard_at = now
            self._compasses[compass] = min(percent, 100)
            self._percent = min(self._compasses.values())

    def on_compass_report(self, compass: int, mask: int, status: int, saved: bool, now: float) -> None:
        """MAG_CAL_REPORT. ``mask``: the compasses that are calibrated, a bit for each. Repeated until the next start:
        one without progress before it is of an earlier calibration."""
        if not self._compass_runs() or compass not in self._compasses:
            return
        if status not in COMPASS_FAILURES and not (status == COMPASS_SUCCESS and saved):
            return  # it is saved in a moment
        self._heard_at = now
        self._reports[compass] = COMPASS_FAILURES.get(status, "")
        self._compasses[compass] = 100
        wanted = {index for index in range(8) if mask >> index & 1} & self._compasses.keys()
        if wanted - self._reports.keys():
            return
        bad = [f"compass {index + 1}: {why}" for index, why in sorted(self._reports.items()) if why]
        if bad:
            self._end("failed", f"failed: {'; '.join(bad)}", now)
        else:
            self._end("accepted", "compass calibrated; reboot it", now)

    def on_heartbeat(self, system_status: int, now: float) -> None:
        """The vehicle's MAV_STATE. A PX4 shows there whether a calibration runs; its last text may be lost."""
        if not self._px4 or self.state is not CalibrationState.RUNNING:
            return
        if system_status == CALIBRATING:
            self._was_calibrating, self._idle_at = True, None
        elif self._was_calibrating and self._idle_at is None:
            self._idle_at = now

    def on_lost(self, text: str, now: float) -> None:
        """The vehicle was lost, or has rebooted."""
        self._end("lost", text, now)

    def give_up(self, now: float) -> None:
        """End it, as nobody waits for it any more."""
        self._end("cancelled", "cancelled: the client that gave it is gone", now)

    def on_time(self, now: float) -> None:
        """Act on a deadline that has passed; call this at ``deadline``, harmless at other times."""
        if (at := self.deadline) is None or now < at:
            return
        if self.state is CalibrationState.CANCELLING:
            self._end("cancelled", "cancelled; the vehicle did not confirm that", now)
        elif self._idle_at is not None:
            self._end("timeout", "it ended, and its result was not heard: read its parameters, or calibrate again", now)
        else:
            self._end("timeout", f"timeout: no progress for {SILENCE_S:.0f} s", now)

    @property
    def deadline(self) -> float | None:
        """When `on_time` is to be called."""
        if self.state is CalibrationState.CANCELLING:
            return self._heard_at + CANCEL_S
        if self.state is not CalibrationState.RUNNING:
            return None
        at = self._heard_at + SILENCE_S
        return at if self._idle_at is None else min(at, self._idle_at + LATE_TEXT_S)

    def status(self) -> CalibrationStatus:
        return {
            "sensor": self.sensor.value,
            "percent": self._percent,
            "pose": self._pose,
            "confirm": self.state is CalibrationState.POSING,
            "pending": list(self._pending),
            "text": self._text,
        }

    # -- internal

    def _compass_runs(self) -> bool:
        return self.sensor is Sensor.COMPASS and not self._px4 and self.state is CalibrationState.RUNNING

    def _on_progress_text(self, text: str) -> None:
        """A text of a PX4 that ends nothing."""
        if (started := STARTED.match(text)) is not None and started.group(1) != TEXTS_VERSION:
            self._text += " (its texts have a version that skygcs does not know: only its end may be understood)"
        if (progress := PROGRESS.match(text)) is not None:
            self._percent = min(int(progress.group(1)), 100)
        elif (pending := PENDING.match(text)) is not None:
            self._pending = tuple(PX4_POSES[side] for side in pending.group(1).split() if side in PX4_POSES)
            self._pose = None
        elif (detected := DETECTED.match(text)) is not None:
            self._pose = PX4_POSES.get(detected.group(1), self._pose)
        elif (side := SIDE_DONE.match(text)) is not None:
            done = PX4_POSES.get(side.group(1))
            self._pending = tuple(pose for pose in self._pending if pose != done)
            self._pose = None

    def _end(self, result: str, message: str, now: float) -> None:
        if self.state is CalibrationState.DONE:
            return
        self.state = CalibrationState.DONE
        texts = () if result == "accepted" else tuple(dict.fromkeys(self._texts))
        self.outcome = Outcome(result == "accepted", result, message, 1, now - self._started, texts)


def reader_of(calibration: Calibration) -> dict[str, Callable[[dict[str, Any], float], None]]:
    """Return what a calibration does with the fields of a message, by the message's name."""

    def on_command(fields: dict[str, Any], now: float) -> None:
        position = fields["param1"]
        if fields["command"] == mav_cmd.ACCELCAL_VEHICLE_POS and 0 < position <= ACCEL_FAILED:
            calibration.on_pose(int(position), now)

    def on_progress(fields: dict[str, Any], now: float) -> None:
        calibration.on_compass_progress(int(fields["compass_id"]), int(fields["completion_pct"]), now)

    def on_report(fields: dict[str, Any], now: float) -> None:
        mask, status = int(fields["cal_mask"]), int(fields["cal_status"])
        calibration.on_compass_report(int(fields["compass_id"]), mask, status, bool(fields["autosaved"]), now)

    return {"COMMAND_LONG": on_command, "MAG_CAL_PROGRESS": on_progress, "MAG_CAL_REPORT": on_report}
