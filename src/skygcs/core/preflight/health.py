"""Checks of what a vehicle reports about itself, and of how well it is received.

A vehicle that flies by poses of motion capture is asked whether they come, and whether its firmware uses them:

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

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.core.geo import distance_m
from skygcs.core.mavlink.param_encoding import value_text
from skygcs.core.params.expectations import FIXES, Expectations, version_of
from skygcs.core.preflight.report import Finding, Fix, PreflightFacts, Severity, failed, passed, skipped, unknown
from skygcs.core.vehicle.autopilot import TAKEOFF_MODES, takes_off_from
from skygcs.core.vehicle.decoding import ESTIMATE_NEEDED
from skygcs.core.vehicle.orders import todo_in_mode

FRESH_S = 15.0
"""Older values do not describe the present: three periods of the slowest message requested by default (0.2 Hz)."""

TEXT_FRESH_S = 60.0
"""ArduPilot repeats why it would not arm every 30 s."""

MAX_TEXTS = 3

PREARM_SENSOR = "prearm_check"
PREARM_TEXTS = ("prearm:", "arm:", "preflight fail:", "arming denied")
"""How ArduPilot and PX4 begin their texts about failed arming checks."""

PX4_REPORTS_PREARM = (1, 14)
"""PX4 reports its arming checks from this version on (SYS_STATUS.hpp)."""

_NEEDED = (
    (1, "no attitude"),
    (2, "no horizontal velocity"),
    (4, "no vertical velocity"),
    (16, "no position on earth"),
    (32, "no height"),
)
"""Bits of `ESTIMATE_NEEDED`, and what is missing without each."""

TERRAIN = "terrain"
TERRAIN_TODO = (
    "it has no heights of the ground here, which a ground station like Mission Planner sends and skygcs does not: set "
    'TERRAIN_ENABLE 0, or sensors_ignored = ["terrain"] if it never flies by them'
)
"""An ArduPlane has TERRAIN_ENABLE 1 from the factory, and flies without: terrain matters to TERRAIN_FOLLOW and to items
above the terrain, for which its own arming checks wait (AP_Arming::terrain_checks)."""

PREARM_TODO = "correct what its status texts name; skygcs-cli status --json shows the latest"

ASK_AGAIN = "repeat the preflight in a moment"


def reachable(facts: PreflightFacts, wanted: Expectations) -> Finding:
    state = facts.state
    if state["replayed"]:
        return failed("it is heard only in a recording", "there is no vehicle to fly: remove the replay link")
    if facts.dropped:
        return failed(facts.dropped, "repeat the preflight when it is heard again")
    if not state["connected"]:
        age = state["last_heartbeat_age_s"]
        heard = "never" if age is None else f"{age:.0f} s ago"
        return failed(f"no heartbeat: last heard {heard}", "switch it on; check its radio and the link")
    return passed("heard")


def single(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not facts.state["duplicate_sysid"]:
        return passed("its system id is unique")
    sysid = facts.state["sysid"]
    return failed(
        f"two vehicles with system id {sysid} are on the air",
        "switch one off and give it another (PX4: MAV_SYS_ID; ArduPilot: SYSID_THISMAV, from 4.7 on MAV_SYSID)",
    )


def known(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if facts.configured is None:
        return skipped("the fleet file names no vehicles")
    if facts.configured:
        return passed("in the fleet file")
    sysid = facts.state["sysid"]
    return failed(
        f"system id {sysid} is not in the fleet file",
        f"add it ([vehicles.NAME] with sysid = {sysid}), or find out whose it is",
    )


def autopilot(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if facts.expected_autopilot is None:
        return skipped("the fleet file expects no particular autopilot")
    if facts.expected_autopilot == facts.family:
        return passed(facts.family)
    text = f"it runs {facts.family}, the fleet file says {facts.expected_autopilot}"
    return failed(text, "correct autopilot in the fleet file, or find out which vehicle this is")


def failsafe(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not facts.state["failsafe"]:
        return passed("no failsafe")
    text = f"its own failsafe is active, system status {facts.state['system_status']}"
    return failed(
        text + _because(_texts(facts, ())),
        "find the cause in its status texts; a reboot clears a failsafe whose cause is gone",
    )


def estimator(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not wanted.estimator:
        return skipped("estimator = false")
    part = facts.fresh("estimator", FRESH_S)
    if part is None:
        return unknown("the estimator's state is unknown: the vehicle did not report it on request", ASK_AGAIN)
    if part["ok"]:
        return passed("estimator good")
    wrong = [text for bit, text in _NEEDED if bit & ESTIMATE_NEEDED & ~part["flags"]]
    wrong += [f"{name} innovation {ratio:.2f}" for name, ratio in part["ratios"].items() if ratio and ratio >= 0.8]
    reported = {n.lower().removeprefix("estimator_").removeprefix("ekf_") for n in part["names"]}
    wrong += sorted(
        n.replace("_", " ") for n in reported & {"gps_glitch", "gps_glitching", "accel_error", "uninitialized"}
    )
    return failed(
        "the estimator is not good enough for navigation" + (f": {', '.join(wrong)}" if wrong else ""),
        "wait until it has converged with a clear sky; if it does not, reboot it where it stands",
    )


def position(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if wanted.gps_fix_min == "no_gps" or not wanted.estimator:
        return skipped("no position on earth is expected")
    part = facts.fresh("position", FRESH_S)
    if part is None:
        return unknown("it reports no position, not even on request (GLOBAL_POSITION_INT)", "wait for a GPS fix")
    if part["lat_deg"] is None:
        return failed("it does not know its position", "wait for a GPS fix")
    return passed("knows its position")


def gps_fix(facts: PreflightFacts, wanted: Expectations) -> Finding:
    least = FIXES.index(wanted.gps_fix_min)
    if least == 0:
        return skipped('gps_fix_min = "no_gps"')
    part = facts.fresh("gps", FRESH_S)
    if part is None:
        return unknown("the GPS state is unknown: the vehicle did not report it on request", ASK_AGAIN)
    fix = _fix_word(part["fix"])
    if part["fix_type"] >= least:
        return passed(f"GPS fix {fix}")
    return failed(
        f"GPS fix {fix} (at least {_fix_word(wanted.gps_fix_min)})",
        "wait with a clear sky; if it stays, check the antenna and its cable",
    )


def satellites(facts: PreflightFacts, wanted: Expectations) -> Finding:
    part = None if wanted.gps_fix_min == "no_gps" else facts.fresh("gps", FRESH_S)
    if not wanted.satellites_min or part is None:
        return skipped("not expected" if not wanted.satellites_min else "no GPS data")
    seen = part["satellites"]
    if seen is None:
        return unknown("the GPS does not report how many satellites it uses", "satellites_min = 0 skips this check")
    if seen >= wanted.satellites_min:
        return passed(f"{seen} satellites")
    return failed(f"{seen} satellites (at least {wanted.satellites_min})", "wait, or move to a place with open sky")


def hdop(facts: PreflightFacts, wanted: Expectations) -> Finding:
    part = None if wanted.gps_fix_min == "no_gps" else facts.fresh("gps", FRESH_S)
    if not wanted.hdop_max or part is None:
        return skipped("not expected" if not wanted.hdop_max else "no GPS data")
    if part["hdop"] is None:
        if part["fix_type"] < FIXES.index("3d"):
            return skipped("no fix yet")
        return unknown("the GPS does not report its HDOP", "hdop_max = 0 skips this check")
    if part["hdop"] <= wanted.hdop_max:
        return passed(f"HDOP {part['hdop']:g}")
    return failed(f"HDOP {part['hdop']:g} (at most {wanted.hdop_max:g})", "wait, or move to a place with open sky")


def sensors(facts: PreflightFacts, wanted: Expectations) -> Finding:
    part = facts.fresh("sensors", FRESH_S)
    if part is None:
        return unknown("the sensors' state is unknown: the vehicle sent no SYS_STATUS on request", ASK_AGAIN)
    ignored = {*wanted.sensors_ignored, PREARM_SENSOR}
    bad = [name for name in part["unhealthy"] if name not in ignored]
    working = set(part["present"]) & set(part["enabled"])
    gone = [name for name in wanted.sensors_required if name not in working]
    if not bad and not gone:
        return passed(f"{len(working)} sensors healthy")
    found = [f"unhealthy: {', '.join(bad)}"] * bool(bad) + [f"missing or disabled: {', '.join(gone)}"] * bool(gone)
    text = "sensors " + "; ".join(found) + _because(_texts(facts, PREARM_TEXTS))
    if [*bad, *gone] == [TERRAIN] and TERRAIN not in wanted.sensors_required:
        return failed(text, TERRAIN_TODO, severity=Severity.NOTE)
    todo = (
        "check or calibrate them; sensors_ignored lists those that may be unhealthy"
        if bad
        else "connect and enable them"
    )
    return failed(text, todo)


def arming_mode(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """The mode in which it would be armed. One in which nothing arms is no fault: take-off, plan and mission set
    another one first, as `autopilot.takes_off_from` has it for all of them."""
    mode = facts.state["mode"]
    if not wanted.prearm:
        return skipped("prearm = false")
    if facts.state["armed"]:
        return skipped("it is armed already")
    if not facts.copter or facts.family not in TAKEOFF_MODES:
        return skipped("its own arming checks cover its mode")
    changed_to = takes_off_from(facts.family, mode)
    if changed_to is None:
        return passed(f"arms in {mode}")
    arms = "arms only while setpoints come" if mode == "OFFBOARD" else "would not arm"
    return passed(f"{arms} in {mode}; takeoff, plan run and mission start change to {changed_to} first")


def prearm(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not wanted.prearm:
        return skipped("prearm = false")
    if facts.state["armed"]:
        return skipped("it is armed already")
    part = facts.fresh("sensors", FRESH_S)
    if part is None or not (PREARM_SENSOR in part["present"] or _px4_reports(facts)):
        return skipped("it does not report whether it would arm")
    if PREARM_SENSOR in part["health"]:
        return passed("its own arming checks pass")
    changed_to = takes_off_from(facts.family, facts.state["mode"]) if facts.family == "px4" else None
    if changed_to is not None and not _texts(facts, PREARM_TEXTS):
        return passed(f"not reported in {facts.state['mode']}: a take-off changes to {changed_to} first")
    text = f"its own arming checks fail in {facts.state['mode']}" + _because(_texts(facts, PREARM_TEXTS))
    mode_first = todo_in_mode(facts.family, facts.state["mode"], facts.state["name"])
    return failed(text, PREARM_TODO if mode_first is None else f"{mode_first}; then {PREARM_TODO}")


def _px4_reports(facts: PreflightFacts) -> bool:
    """PX4 sets the bit of the arming checks in ``health`` alone, neither in ``present`` nor in ``enabled``."""
    return facts.family == "px4" and version_of(facts.state["firmware"] or "") >= PX4_REPORTS_PREARM


def battery(facts: PreflightFacts, wanted: Expectations) -> Finding:
    limit = wanted.battery_min_percent
    if not limit:
        return skipped("battery_min_percent = 0")
    part = facts.fresh("battery", FRESH_S)
    percent = None if part is None else part["percent"]
    if percent is None:
        text = "the battery's charge is unknown: the vehicle did not report it on request"
        return unknown(
            text, "set its battery monitor up (BAT1_SOURCE, BATT_MONITOR); battery_min_percent = 0 skips this check"
        )
    if percent >= limit:
        return passed(f"battery {percent:g} %")
    volts = "" if part is None or part["volts"] is None else f", {part['volts']:.1f} V"
    return failed(f"battery {percent:g} %{volts} (at least {limit:g} %)", "change or charge it")


def home(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not wanted.home_max_m or wanted.gps_fix_min == "no_gps":
        return skipped("no home is expected")
    name = facts.state["name"]
    part, here = facts.state["home"], facts.fresh("position", FRESH_S)
    if part is None:
        return failed("it has no home position, so it could not return", f"wait for a fix, or skygcs-cli home {name}")
    if here is None or here["lat_deg"] is None:
        return unknown("the distance to its home is unknown without its position", "wait for a GPS fix")
    away_m = distance_m(here["lat_deg"], here["lon_deg"], part["lat_deg"], part["lon_deg"])
    if away_m <= wanted.home_max_m:
        return passed(f"home {away_m:.0f} m away")
    return failed(
        f"home is {away_m:.0f} m from where it stands (at most {wanted.home_max_m:g} m)",
        f"set it here: skygcs-cli home {name}",
    )


def clock(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if not wanted.clock_max_s:
        return skipped("clock_max_s = 0")
    offset_s = facts.state["clock_offset_s"]
    if offset_s is None and wanted.gps_fix_min == "no_gps":
        return skipped("without GPS it does not know the time")
    if offset_s is None:
        return unknown(
            "its clock is unknown (no SYSTEM_TIME)", "wait: it gets the time from GPS; clock_max_s = 0 skips this check"
        )
    if abs(offset_s) <= wanted.clock_max_s:
        return passed(f"clock {offset_s:+.1f} s")
    direction = "ahead of" if offset_s > 0 else "behind"
    return failed(
        f"its clock is {abs(offset_s):.1f} s {direction} ours (at most {wanted.clock_max_s:g} s)",
        "find out which clock is wrong (this computer: timedatectl); logs of both could not be compared",
    )


def firmware(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if wanted.firmware_min is None and not wanted.firmware:
        return skipped("no version is expected")
    version = facts.state["firmware"]
    if version is None:
        return unknown("the firmware version is unknown: the vehicle did not report it on request", ASK_AGAIN)
    if wanted.firmware and version not in wanted.firmware:
        return failed(f"firmware {version} (must be {' or '.join(wanted.firmware)})", "flash that version")
    least = wanted.firmware_min
    if least is not None and version_of(version) < version_of(least):
        return failed(f"firmware {version} (at least {least})", "flash a newer one")
    return passed(f"firmware {version}")


def loss(facts: PreflightFacts, wanted: Expectations) -> Finding:
    limit = wanted.loss_max_percent
    if not limit:
        return skipped("loss_max_percent = 0")
    links = facts.links or {}
    losses = {name: link.loss for name, link in links.items() if link.loss is not None}
    if not losses:
        most = max((link.frames for link in links.values()), default=0)
        return unknown(f"the frame loss is unknown: {most} frames so far", "repeat the preflight in half a minute")
    best = min(losses, key=lambda name: losses[name])
    percent = 100 * losses[best]
    if percent <= limit:
        return passed(f"{percent:.0f} % lost on {best}")
    return failed(
        f"{percent:.0f} % of its frames are lost on {best} (at most {limit:g} %)",
        "check antennas; ask for fewer messages (streams); skygcs-cli link plan says what a radio can carry",
    )


def radio_margin(facts: PreflightFacts, wanted: Expectations) -> Finding:
    limit = wanted.radio_margin_min_db
    margins = {name: link.margin_db for name, link in (facts.links or {}).items() if link.margin_db is not None}
    if not limit or not margins:
        return skipped("no radio reports its signal")
    best = max(margins, key=lambda name: margins[name])
    if margins[best] >= limit:
        return passed(f"{margins[best]:.0f} dB above noise on {best}")
    text = f"the signal is {margins[best]:.0f} dB above the noise on {best} (at least {limit:g} dB)"
    return failed(text, "check antennas, distance and what else sends on this band")


def _fix_word(fix: str) -> str:
    return fix.upper() if fix in ("2d", "3d", "dgps") else fix.replace("_", " ")


def _texts(facts: PreflightFacts, beginnings: tuple[str, ...]) -> list[str]:
    """The newest status texts with one of these beginnings; with none given, the newest warnings."""
    entries: list[Mapping[str, Any]] = [t for t in facts.state["status_texts"] if t["age_s"] <= TEXT_FRESH_S]
    entries.sort(key=lambda t: t["age_s"])
    if beginnings:
        found = [t["text"] for t in entries if t["text"].lower().startswith(beginnings)]
    else:
        found = [t["text"] for t in entries if t["level"] <= 4]
    return list(dict.fromkeys(found))[:MAX_TEXTS]


def _because(texts: list[str]) -> str:
    return f" ({'; '.join(texts)})" if texts else ""


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
