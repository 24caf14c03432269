"""Checks of a vehicle that flies by poses of motion capture: whether they come, and whether its firmware uses them.

parameter          wanted                      source
----------------   -------------------------   --------------------------------------------------------------------
EKF2_EV_CTRL       bits 0, 1 and 3 set         PX4 ekf2/module.yaml: horizontal position, vertical position, yaw
EKF2_HGT_REF       3                           vision is the reference of height
EKF2_GPS_CTRL      0                           a GPS indoors contradicts the poses
EKF2_MAG_TYPE      5                           None: steel and motors turn the yaw of a magnetometer indoors
VISO_TYPE          1                           AP_VisualOdom.h: MAVLink; takes effect at the next start
EK3_SRC1_POSXY     6                           AP_NavEKF_Source.h: ExternalNav
EK3_SRC1_POSZ      6, or 1 (barometer)
EK3_SRC1_VELXY     0 or 6                      3 is GPS
EK3_SRC1_VELZ      0 or 6
EK3_SRC1_YAW       6, or 1 (compass)           6: from the poses; 1 with a compass that is used (COMPASS_USE…)
GPS1_TYPE          0                           GPS_TYPE up to 4.6; a GPS that is missing holds the arming up
"""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.core.mavlink.param_encoding import value_text
from skygcs.core.preflight.expectations import Expectations
from skygcs.core.preflight.facts import PreflightFacts
from skygcs.core.preflight.report import Finding, Fix, failed, passed, skipped, unknown

NO_MOCAP = "[mocap] of the fleet file does not name it"

EV_HPOS, EV_VPOS, EV_VEL, EV_YAW = 1, 2, 4, 8
"""Bits of EKF2_EV_CTRL."""

ORIGIN_OFF_M = 1.0
"""Between its estimator's origin and [origin]: rounding is centimetres."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Values of a parameter; the first is what --fix sets."""

    names: tuple[str, ...]
    """Names of the parameter in its generations of firmware; any of them will do."""
    values: tuple[int, ...]
    why: str


_COPTER = (
    _Wanted(("VISO_TYPE",), (1,), "it takes no poses over MAVLink"),
    _Wanted(("EK3_SRC1_POSXY",), (6,), "its estimator does not take the position of the poses"),
    _Wanted(("EK3_SRC1_POSZ",), (6, 1), "its height is neither that of the poses nor the barometer's"),
    _Wanted(("EK3_SRC1_VELXY",), (0, 6), "its estimator waits for a velocity that poses do not have"),
    _Wanted(("EK3_SRC1_VELZ",), (0, 6), "its estimator waits for a velocity that poses do not have"),
    _Wanted(("EK3_SRC1_YAW",), (6, 1), "its yaw is neither that of the poses nor the compass's"),
    _Wanted(("GPS1_TYPE", "GPS_TYPE"), (0,), "it waits for a GPS"),
)

_PX4 = (
    _Wanted(("EKF2_HGT_REF",), (3,), "its height is not that of the poses"),
    _Wanted(("EKF2_GPS_CTRL",), (0,), "a GPS indoors contradicts the poses"),
)

COMPASSES = ("COMPASS_USE", "COMPASS_USE2", "COMPASS_USE3")

YAW, YAW_COMPASS, YAW_POSES = "EK3_SRC1_YAW", 1, 6

AT_THE_START = frozenset({"EKF2_HGT_REF"})
"""PX4 parameters that take effect at the start (reboot_required in ekf2/module.yaml). All of ArduCopter's do."""

PX4_PARAMS = (("EKF2_EV_CTRL",), *(wanted.names for wanted in _PX4))

COPTER_PARAMS = (*(wanted.names for wanted in _COPTER), *((name,) for name in COMPASSES))


def poses(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not wanted.mocap:
        return skipped(NO_MOCAP)
    if facts.pose_problem is not None:
        return failed(facts.pose_problem, "see skygcs-cli mocap status")
    return passed("poses of motion capture come")


def estimator_origin(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check whether its own origin is that of the fleet: the poses count from there."""
    if not wanted.mocap:
        return skipped(NO_MOCAP)
    if facts.origin_off_m is None:
        todo = "wait until it is sent ([mocap] set_origin), or send it: skygcs-cli origin push"
        return failed("its estimator reports no origin: it has no position on earth", todo)
    if facts.origin_off_m > ORIGIN_OFF_M:
        return failed(
            f"its estimator's origin is {facts.origin_off_m:.1f} m from [origin], from which its poses count",
            "reboot it, and let skygcs send the origin before others do",
        )
    return passed("its estimator's origin is that of the fleet")


def external_vision(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check whether its estimator uses the poses: the first parameter that is wrong, with a fix for each."""
    if not wanted.mocap:
        return skipped(NO_MOCAP)
    if facts.family not in ("px4", "ardupilot"):
        return skipped("neither PX4 nor ArduPilot")
    missing: list[str] = []
    wrong = _control_wrong(facts, missing) if facts.family == "px4" else _compass_wrong(facts)
    for one in _PX4 if facts.family == "px4" else _COPTER:
        answers = [facts.answer(name) for name in one.names]
        param = next((answer.param for answer in answers if answer.param is not None), None)
        if param is None:
            if not all(answer.absent for answer in answers) or one.names == ("VISO_TYPE",):
                missing.append(one.names[0])
        elif param.value not in one.values:
            text = f"{param.name} is {value_text(param.value)}: {one.why}"
            wrong.append((text, Fix(param.name, one.values[0], param.value)))
    if wrong:
        todo = "set " + ", ".join(f"{fix.name} to {value_text(fix.value)}" for _, fix in wrong)
        later = facts.family == "ardupilot" or any(fix.name in AT_THE_START for _, fix in wrong)
        reboot = "; then reboot it" if later else ""
        return failed("; ".join(text for text, _ in wrong), todo + reboot, *(fix for _, fix in wrong))
    if missing:
        return unknown(f"{', '.join(missing)} not known", "repeat the preflight, or see whether its firmware has them")
    return passed("its estimator takes the poses")


def _control_wrong(facts: PreflightFacts, missing: list[str]) -> list[tuple[str, Fix]]:
    """Return what of the poses a PX4 does not take."""
    control = facts.value("EKF2_EV_CTRL")
    if control is None:
        missing.append("EKF2_EV_CTRL")
    elif ~int(control) & (EV_HPOS | EV_VPOS | EV_YAW):
        to = (int(control) | EV_HPOS | EV_VPOS | EV_YAW) & ~EV_VEL
        text = f"EKF2_EV_CTRL is {value_text(control)}: its estimator does not take position, height and yaw"
        return [(text, Fix("EKF2_EV_CTRL", to, control))]
    return []


def _compass_wrong(facts: PreflightFacts) -> list[tuple[str, Fix]]:
    """An ArduCopter whose yaw is a compass's while it uses none: its estimator never has a yaw."""
    used = [value for name in COMPASSES if (value := facts.value(name)) is not None]
    if facts.value(YAW) != YAW_COMPASS or not used or any(used):
        return []
    text = f"{YAW} is 1: its yaw is a compass's, and it uses none ({COMPASSES[0]} is 0)"
    return [(text, Fix(YAW, YAW_POSES, YAW_COMPASS))]
