"""Which refused armings time cannot cure, by the firmwares' own texts."""

from __future__ import annotations

from skygcs.core.vehicle.arming_refusals import LASTING_REASONS, todo_for, todo_in_mode
from support.table import each


@each(
    ("text", "todo"),
    [
        ("Arm: LAND mode not armable", "skygcs-cli mode alpha GUIDED"),
        ("Arm: Mode not armable", "skygcs-cli mode alpha GUIDED"),
        ("PreArm: Hardware safety switch", "safety switch"),
        ("PreArm: 3D Accel calibration needed", "calibrate"),
        ("PreArm: Compass not calibrated", "calibrate"),
        ("Preflight Fail: Gyro 0 uncalibrated", "calibrate"),
        ("PreArm: Compass calibrated requires reboot", "skygcs-cli reboot alpha"),
        ("Preflight Fail: Kill switch engaged", "kill switch"),
        ("Arm: Leaning", "set it up"),
        ("Preflight Fail: Attitude failure (roll)", "skygcs-cli reboot alpha"),
        ("PreArm: Battery 1 below minimum arming voltage", "battery"),
    ],
)
def test_a_lasting_reason_names_what_cures_it(text: str, todo: str) -> None:
    reported = todo_for(["AHRS: waiting for home", text], "alpha")
    assert reported is not None and todo in reported


@each(
    "text",
    [
        "Arm: Need Position Estimate",
        "PreArm: AHRS not healthy",
        "PreArm: EKF3 waiting for GPS config data",
        "PreArm: Gyros not calibrated",
        "PreArm: Gyros inconsistent",
        "PreArm: GPS 1: Bad fix",
        "Preflight Fail: heading estimate not stable",
        "Preflight Fail: No valid data from Accel 0",
        "Arming denied: calibrating",
        "",
    ],
)
def test_what_time_may_cure_is_waited_for(text: str) -> None:
    assert todo_for([text], "alpha") is None


def test_every_advice_is_complete_for_any_name() -> None:
    for _, todo in LASTING_REASONS:
        assert "{" not in todo.format(name="alpha")


@each(
    ("mode", "why"),
    [("AUTO.LAND", "it does not arm in AUTO.LAND"), ("OFFBOARD", "while setpoints come"), ("POSCTL", "with sticks")],
)
def test_a_px4_is_said_to_refuse_for_its_mode_since_its_text_does_not_say_it(mode: str, why: str) -> None:
    assert why in (todo_in_mode("px4", mode, "alpha") or "")
    assert todo_in_mode("ardupilot", mode, "alpha") is todo_in_mode("px4", "AUTO.LOITER", "alpha") is None
