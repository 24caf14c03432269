"""Calibrations of sensors as the firmwares report them: PX4 by texts, ArduCopter by acknowledgements and messages.

Sources: PX4 1.16 src/modules/commander (Commander.cpp VEHICLE_CMD_PREFLIGHT_CALIBRATION, calibration_routines.cpp,
gyro_, level_, accelerometer_ and mag_calibration.cpp); ArduCopter 4.6 GCS_Common.cpp, AP_AccelCal.cpp,
AP_Compass_Calibration.cpp. A calibration is a generator that yields the seconds until it goes on.

Simpler than real: nothing is measured, so a calibration fails only for want of a new pose; somebody turns the vehicle
(`VehicleState.turned_by_hand`) `TURN_S` after it asked. An ArduCopter does not look in which pose it is confirmed.
"""

from __future__ import annotations

from skygcs.sim import protocol as m
from skygcs.sim.command_message import Calibration, Command, Script
from skygcs.sim.vehicle_state import VehicleState

PX4_SIDES = ("back", "front", "left", "right", "up", "down")
"""detect_orientation_str, in the order in which the pending ones are listed."""

TURN_S = 2.0
"""Until a person has turned the vehicle."""

STILL_S = 1.3
"""detect_orientation waits so long for rest."""

MOST_SAME_SIDES = 4
"""calibrate_from_orientation gives up after more in a row (orientation_failures)."""

POSITION_EVERY_S = 1.0
"""AP_ACCELCAL_POSITION_REQUEST_INTERVAL_MS."""

GYRO_S, LEVEL_S, SIDE_S, COMPASS_S = 2.0, 1.5, 2.0, 10.0

BUSY_S = 0.3
"""PX4's worker is busy for a moment after its last text: the next calibration is refused until then."""

COMPASSES = 2


def start(v: VehicleState, c: Command, now: float) -> int | None:
    """Result of PREFLIGHT_CALIBRATION; None if the vehicle answers later."""
    if v.armed:
        return v.firmware.answers.simulated.calibrate_armed
    px4 = v.autopilot == m.MAV_AUTOPILOT_PX4
    if px4 and v.calibration is not None:
        return _while_running(v, c)
    if c.p1 == 1:
        return _begin(v, c, now, "gyro", _px4_measure(v, "gyro", GYRO_S) if px4 else _copter_answer(v, c, GYRO_S))
    if c.p5 == 2:
        return _begin(v, c, now, "level", _px4_measure(v, "level", LEVEL_S) if px4 else _copter_answer(v, c, LEVEL_S))
    if c.p5 == 1:
        return _begin(v, c, now, "accel", _px4_sides(v, "accel") if px4 else _copter_accel(v))
    if px4 and c.p2 == 1:
        return _begin(v, c, now, "mag", _px4_sides(v, "mag"))
    if px4:
        return m.MAV_RESULT_ACCEPTED  # param4 0 ends an RC calibration; none is simulated
    return m.MAV_RESULT_UNSUPPORTED


def compass_command(v: VehicleState, c: Command, now: float) -> int:
    """Result of DO_START_MAG_CAL and DO_CANCEL_MAG_CAL, which only ArduCopter supports."""
    if v.autopilot == m.MAV_AUTOPILOT_PX4:
        return m.MAV_RESULT_UNSUPPORTED
    if c.id == m.MAV_CMD_DO_CANCEL_MAG_CAL:
        v.calibration = None
        return m.MAV_RESULT_ACCEPTED
    if v.armed:
        return m.MAV_RESULT_FAILED
    v.calibration = Calibration(c.sender, _copter_compass(v), now + c.p4, "compass")
    return m.MAV_RESULT_ACCEPTED


def pose_command(v: VehicleState, c: Command, _: float) -> int:
    """ACCELCAL_VEHICLE_POS: an ArduCopter's (gcs_vehicle_position)."""
    if v.autopilot == m.MAV_AUTOPILOT_PX4:
        return m.MAV_RESULT_UNSUPPORTED
    running = v.calibration
    if running is None or running.position == 0 or c.p1 != running.position:
        return m.MAV_RESULT_FAILED
    running.confirmed = True
    return m.MAV_RESULT_ACCEPTED


def step(v: VehicleState, now: float) -> None:
    """Each tick."""
    running = v.calibration
    while running is not None and running is v.calibration and now >= running.due:
        try:
            running.due += next(running.script)
        except StopIteration:
            if running is v.calibration:
                v.calibration = None


def _begin(v: VehicleState, c: Command, now: float, sensor: str, script: Script) -> int | None:
    v.calibration = Calibration(c.sender, script, now, sensor)
    answered_later = v.autopilot != m.MAV_AUTOPILOT_PX4 and sensor in ("gyro", "level")
    return None if answered_later else m.MAV_RESULT_ACCEPTED


# -- PX4


def _while_running(v: VehicleState, c: Command) -> int:
    """Commander refuses as its worker is busy; then the worker answers as well (calibrate_cancel_check)."""
    v.tx.acknowledge(c.id, m.MAV_RESULT_TEMPORARILY_REJECTED, c.sender)
    if any((c.p1, c.p2, c.p3, c.p4, c.p5, c.p6)):
        v.tx.say(m.MAV_SEVERITY_CRITICAL, f"command denied during calibration: {c.id}")
        return m.MAV_RESULT_DENIED
    v.calibration = None
    v.tx.say(m.MAV_SEVERITY_CRITICAL, "[cal] calibration cancelled")
    return m.MAV_RESULT_ACCEPTED


def _cal(v: VehicleState, text: str, severity: int = m.MAV_SEVERITY_INFO) -> None:
    v.tx.say(severity, f"[cal] {text}")


def _px4_measure(v: VehicleState, sensor: str, seconds: float) -> Script:
    _cal(v, f"calibration started: 2 {sensor}")
    for percent in range(0, 100, 20):
        yield seconds / 5
        _cal(v, f"progress <{percent}>")
    _cal(v, f"calibration done: {sensor}")
    yield BUSY_S


def _px4_sides(v: VehicleState, sensor: str) -> Script:
    """calibrate_from_orientation, with the worker of each sensor."""
    _cal(v, f"calibration started: 2 {sensor}")
    pending = list(PX4_SIDES)
    same = 0
    while pending:
        # give up when the pose does not change
        if same > MOST_SAME_SIDES:
            _cal(v, "calibration failed: timeout: no motion", m.MAV_SEVERITY_CRITICAL)
            return
        # ask for the next pose and wait until it rests
        _cal(v, f"pending: {' '.join(pending)}")
        yield 0.02
        _cal(v, "hold vehicle still on a pending side")
        yield TURN_S
        if v.turned_by_hand and v.side_down not in pending:
            v.side_down = pending[-1]
        _cal(v, "detected rest position, hold still...")
        yield STILL_S
        # a side that is done already is not measured again
        side = v.side_down
        if side not in pending:
            same += 1
            _cal(v, f"{side} side already completed")
            yield 0.02
            continue
        # measure the side
        same = 0
        for _ in range(2):
            _cal(v, f"{side} orientation detected")
            yield 0.02
        _cal(v, f"Hold still, measuring {side} side" if sensor == "accel" else "Rotate vehicle")
        yield SIDE_S
        # report the progress
        pending.remove(side)
        done = len(PX4_SIDES) - len(pending)
        if sensor == "mag":
            _cal(v, f"{side} side calibration: progress <{100 * done // len(PX4_SIDES)}>")
        else:
            _cal(v, f"progress <{17 * done}>")
        for _ in range(2):
            _cal(v, f"{side} side done, rotate to a different side")
            yield 0.02
    _cal(v, f"calibration done: {sensor}")


# -- ArduCopter


def _copter_answer(v: VehicleState, c: Command, seconds: float) -> Script:
    """ArduCopter measures in its main loop and answers at the end. Meanwhile it sends only what it sends during its
    start (AP_Vehicle::scheduler_delay_callback)."""
    v.tx.say(m.MAV_SEVERITY_INFO, "Initialising ArduPilot")
    yield seconds
    v.tx.acknowledge(c.id, m.MAV_RESULT_ACCEPTED, c.sender)


def _copter_accel(v: VehicleState) -> Script:
    """AP_AccelCal: a text for each pose, and its number each second until it is confirmed. The result is repeated each
    second until the next start."""
    for position, text in enumerate(
        ("level", "on its LEFT side", "on its RIGHT side", "nose DOWN", "nose UP", "on its BACK"), 1
    ):
        running = v.calibration
        assert running is not None
        running.position, running.confirmed = position, False
        v.tx.say(m.MAV_SEVERITY_CRITICAL, f"Place vehicle {text} and press any key.")
        waited_s = POSITION_EVERY_S
        while not running.confirmed:
            if waited_s >= POSITION_EVERY_S:
                _send_position(v, position)
                waited_s = 0.0
            yield 0.1
            waited_s += 0.1
        yield 0.5
    v.tx.say(m.MAV_SEVERITY_CRITICAL, "Calibration successful")
    while True:
        _send_position(v, m.ACCELCAL_VEHICLE_POS_SUCCESS)
        yield POSITION_EVERY_S


def _send_position(v: VehicleState, position: int) -> None:
    fields = {f"param{i}": 0.0 for i in range(2, 8)}
    v.tx.send("COMMAND_LONG", {**fields, "command": m.MAV_CMD_ACCELCAL_VEHICLE_POS, "param1": float(position)})


def _copter_compass(v: VehicleState) -> Script:
    mask = (1 << COMPASSES) - 1
    for percent in range(0, 101, 10):
        for compass in range(COMPASSES):
            fields = {"compass_id": compass, "cal_mask": mask, "cal_status": m.MAG_CAL_RUNNING_STEP_ONE, "attempt": 1}
            v.tx.send("MAG_CAL_PROGRESS", {**fields, "completion_pct": percent})
        yield COMPASS_S / 10
    while True:
        for compass in range(COMPASSES):
            fields = {"compass_id": compass, "cal_mask": mask, "cal_status": m.MAG_CAL_SUCCESS, "autosaved": 1}
            v.tx.send("MAG_CAL_REPORT", {**fields, "fitness": 5.0})
        yield 1.0
