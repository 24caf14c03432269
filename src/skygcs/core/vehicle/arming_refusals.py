"""Reasons for a refused arming that do not pass with time, and what the operator does about each.

`arm --wait` repeats the command while the estimator converges. It must not repeat it for a minute while the mode or a
switch forbids arming. The texts are those of the firmwares: ArduPilot `AP_Arming.cpp` and `ArduCopter/AP_Arming.cpp`
(4.7-dev), PX4 `CommandClient.cpp` and `HealthAndArmingChecks` (1.16). A reason that is not listed may pass with time.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from skygcs.core.mavlink.modes import PX4_NOT_ARMABLE
from skygcs.core.vehicle.stick_modes import PX4_STICK_MODES

LASTING_REASONS: tuple[tuple[str, str], ...] = (
    (r"mode not armable", "set another mode first: skygcs-cli mode {name} GUIDED"),
    (r"switch to manual mode first", "set another mode first: skygcs-cli mode {name} AUTO.LOITER"),
    (r"hardware safety switch|press safety", "press the safety switch on the vehicle"),
    (r"motors emergency stopped|kill switch engaged", "release the kill switch of its transmitter"),
    (r"disarm switch on", "release the disarm switch of its transmitter"),
    (r"RTL switch engaged", "release the return switch of its transmitter"),
    (r"calibration needed|(?<!gyros )not calibrated|uncalibrated", "calibrate it in QGroundControl or Mission Planner"),
    (r"requires reboot", "reboot it: skygcs-cli reboot {name}"),
    (
        r"radio failsafe on|RC calibrating|not neutral|throttle above center|denied: high throttle",
        "check its transmitter",
    ),
    (r"below minimum arming voltage|low battery", "charge or change its battery"),
    (r"no SD card|missing FMU SD card", "put an SD card into its autopilot"),
    (r"sensor \d+ missing|compass sensor \d+ missing", "check its sensors; preflight lists them"),
    (r"duplicate aux switch|RC\d*_OPTION conflict", "correct its parameters; preflight lists them"),
    (
        r"leaning|attitude failure|high angle|vehicle is not level",
        "it does not stand upright: set it up; a simulated vehicle is set up by a restart: skygcs-cli reboot {name}",
    ),
    (r"check frame_class", "set its frame: skygcs-cli param set {name} FRAME_CLASS 1 (1: quadrotor), then reboot it"),
)
"""Regular expression of the vehicle's text (any case), and what to do; ``{name}`` is the vehicle."""

_PATTERNS = tuple((re.compile(pattern, re.IGNORECASE), todo) for pattern, todo in LASTING_REASONS)


def todo_for(texts: Iterable[str], name: str) -> str | None:
    """Return what the operator has to do before ``name`` arms; None if the reasons in ``texts`` may pass with time."""
    for text in texts:
        for pattern, todo in _PATTERNS:
            if pattern.search(text):
                return todo.format(name=name)
    return None


def todo_in_mode(family: str, mode: str, name: str) -> str | None:
    """Return why ``name`` may not arm in ``mode``, and what to do, where its firmware's text does not name the mode: a
    PX4 1.16 says "Resolve system health failures first" in all of these (modeCheck.cpp). None: it arms, as far as the
    mode is concerned. It disarms into OFFBOARD if that was the last mode before its landing (UserModeIntention.cpp)."""
    if family != "px4":
        return None
    if mode in PX4_NOT_ARMABLE:
        why = f"it does not arm in {mode}"
    elif mode == "OFFBOARD":
        why = "in OFFBOARD it arms only while setpoints come"
    elif mode in PX4_STICK_MODES:
        why = f"in {mode} it arms only with sticks"
    else:
        return None
    return f"{why}; set another mode first: skygcs-cli mode {name} AUTO.LOITER"
