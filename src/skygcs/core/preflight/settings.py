"""Checks of a vehicle's parameters: those that apply to every vehicle, and those that the fleet file names.

Each of the former knows the meaning of its parameters in PX4 and in ArduPilot, with ArduPilot's names of 4.6 and 4.7.
"""

from __future__ import annotations

from collections.abc import Callable

from skygcs.core.mavlink.param_encoding import value_text
from skygcs.core.mavlink.vehicle_class import Q_OPTIONS, Q_RTL_MODE, RTL_LAND_DELAY, HeightParam, ReturnEnd
from skygcs.core.params.expectations import Expectations, Rule
from skygcs.core.params.names import other_name, sort_of
from skygcs.core.preflight.report import (
    Finding,
    Fix,
    PreflightFacts,
    Severity,
    Verdict,
    failed,
    passed,
    skipped,
    unknown,
)
from skygcs.core.vehicle.offboard_entry import (
    BY_STICKS,
    FALLS,
    LONGEST_LEAN_S,
    NO_STICKS,
    PILOT_GOES_ON,
    PX4_LOSS_ACTS,
    PX4_THRUST_TYPES,
    THRUST_AS_THRUST,
)
from skygcs.core.vehicle.vehicle_model import SEEN_AT_ALL
from skygcs.spelling import listed, rounded

LOST_PERIODS = 3
"""Setpoints that may be lost in a row before the vehicle concludes that no more will come."""

STICKS_OFF = 4
"""COM_RC_IN_MODE: stick input disabled."""

HOLD = 5
"""COM_OBL_RC_ACT."""

GF_WARN = 1
"""GF_ACTION: 0 is no action, 1 only a warning."""

GCS_ALONE = 1
"""MAV_OPTIONS of 4.7, in the place of SYSID_ENFORCE: messages of other ground stations are dropped
(libraries/GCS_MAVLink/GCS.cpp: "Accept MAVLink only from system IDs given by MAV_SYSID_GCS and MAV_SYSID_GCS_HI")."""

FENCE_ALT = 1
"""The bit of FENCE_TYPE that enables FENCE_ALT_MAX."""

MAX_OUTSIDE = 5
"""Parameters outside their ranges that a finding names."""

ON_ROTORS_FAILSAFE = {1 << 20: "returns as above", 1 << 5: "returns on them (QRTL)"}
"""Bits of Q_OPTIONS, the first one that is set counts: FS_RTL and FS_QRTL (ArduPlane/events.cpp:
failsafe_long_on_event, for the transmitter and the ground station)."""

Q_FAILSAFE_MODES = "QSTABILIZE, QHOVER, QLOITER, QACRO or QAUTOTUNE"
"""The modes in which those bits count; QLAND and QRTL are flown on (the same function)."""

NEITHER = "neither PX4 nor ArduPilot"


def sysid(facts: PreflightFacts, wanted: Expectations) -> Finding:
    name = "MAV_SYS_ID" if facts.family == "px4" else "SYSID_THISMAV"
    value, heard = facts.value(name), facts.state["sysid"]
    if value is None:
        return _not_known(facts, name)
    if value == heard:
        return passed(f"system id {heard}")
    held = _held_name(facts, name)
    return failed(
        f"it is heard as system {heard} and will be {value_text(value)} after its next start ({held})",
        f"reboot it if that is meant, or set {held} to {heard}",
    )


def gcs_id(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if facts.family != "ardupilot":
        return skipped("PX4 counts every ground station's heartbeats")
    if facts.gcs_sysid is None:
        return skipped("we are its companion and no ground station: the ground's preflight checks it")
    enabled, watched = facts.value("FS_GCS_ENABLE"), facts.value("SYSID_MYGCS")
    if enabled is None:
        return _not_known(facts, "FS_GCS_ENABLE")
    if enabled == 0:
        return skipped("FS_GCS_ENABLE is 0: it watches no ground station")
    if watched is None:
        return _not_known(facts, "SYSID_MYGCS")
    name = _held_name(facts, "SYSID_MYGCS")
    if watched == facts.gcs_sysid:
        return passed(f"watches for our system id {facts.gcs_sysid}")
    return failed(
        f"{name} is {value_text(watched)}, we are {facts.gcs_sysid}: its GCS failsafe ignores our heartbeats "
        f"(FS_GCS_ENABLE {value_text(enabled)})",
        f"set {name} to {facts.gcs_sysid}, or daemon.sysid to {value_text(watched)}",
        Fix(name, facts.gcs_sysid, watched),
    )


def one_commander(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check whether the vehicle itself obeys this site's station alone, besides the lease."""
    # vehicles to which the rule does not apply
    if not wanted.delegated:
        return skipped("no other site may command it")
    if facts.family != "ardupilot":
        return skipped("ArduPilot's alone: only the lease keeps the sites apart")
    if facts.gcs_sysid is None:
        return skipped("we are its companion and no ground station: the ground's preflight checks it")
    # the parameters that decide which stations it obeys
    watched, enforce, options = (facts.value(name) for name in ("SYSID_MYGCS", "SYSID_ENFORCE", "MAV_OPTIONS"))
    if watched is None:
        return _not_known(facts, "SYSID_MYGCS")
    if enforce is None and options is None:
        return _not_known(facts, "SYSID_ENFORCE")
    name = _held_name(facts, "SYSID_MYGCS")
    last = max(watched, facts.value("MAV_GCS_SYSID_HI") or 0)
    enforced = bool(enforce) if enforce is not None else bool(int(options or 0) & GCS_ALONE)
    # it must obey this station ...
    if not watched <= facts.gcs_sysid <= last:
        text = f"{name} is {value_text(watched)}, we are {facts.gcs_sysid}"
        then = "it ignores us" if enforced else "its GCS failsafe ignores our heartbeats"
        todo = f"set {name} to {facts.gcs_sysid} at the site that it obeys, when this one is to command it"
        return failed(f"{text}: {then}", todo)
    # ... and no other one
    if last > watched:
        text = f"it obeys stations {value_text(watched)} to {value_text(last)}: other sites', if they have these ids"
        return failed(text, f"set MAV_GCS_SYSID_HI to {facts.gcs_sysid}", severity=Severity.NOTE)
    if enforced:
        return passed(f"obeys system id {facts.gcs_sysid} alone: a stop of another site does not reach it either")
    # propose the setting that enforces it
    to = (
        ("SYSID_ENFORCE", 1, enforce)
        if enforce is not None
        else ("MAV_OPTIONS", int(options or 0) | GCS_ALONE, options)
    )
    fix = Fix(to[0], to[1], to[2] or 0)
    return failed(
        "it obeys every station that reaches it: only the lease keeps the sites apart",
        f"set {fix.name} to {fix.value}; then it ignores the stop of another site as well",
        fix,
        severity=Severity.NOTE,
    )


def gcs_failsafe(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check whether the GCS failsafe acts in every mode that our orders leave the vehicle in."""
    if facts.family != "ardupilot" or not facts.copter:
        return skipped("an ArduCopter's alone")
    enabled, options = facts.value("FS_GCS_ENABLE"), facts.value("FS_OPTIONS")
    if enabled == 0:
        return skipped("FS_GCS_ENABLE is 0: it watches no ground station")
    if options is None:
        return _not_known(facts, "FS_OPTIONS")
    if not int(options) & PILOT_GOES_ON:
        return passed(f"FS_OPTIONS {value_text(options)}")
    to = int(options) & ~PILOT_GOES_ON
    return failed(
        f"FS_OPTIONS is {value_text(options)}: in BRAKE, where stop leaves it, and in a pilot's modes it ignores the "
        "loss of the ground station and stays until its battery is empty",
        f"set FS_OPTIONS to {to} (without bit 4)",
        Fix("FS_OPTIONS", to, options),
    )


def rtl_height(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check each of the heights in which it may return; the worst of them is reported."""
    if facts.family == "generic":
        return skipped(NEITHER)
    heights = facts.class_abilities.return_heights
    if not heights:
        return skipped("it has no return height")
    findings = [_height_finding(facts, wanted, param) for param in heights]
    return next((f for v in (Verdict.FAIL, Verdict.UNKNOWN) for f in findings if f.verdict is v), findings[0])


def _height_finding(facts: PreflightFacts, wanted: Expectations, param: HeightParam) -> Finding:
    least, most = wanted.rtl_height_m
    name, unit = _held(facts, param)
    value = facts.value(name)
    if value is None:
        return _not_known(facts, name)
    height_m = value / unit
    if height_m <= 0 and least == 0:
        return passed("returns at the height it is at")
    # a fence below it is worse than a height that somebody does not want
    ceiling_m, fence = _ceiling(facts)
    if ceiling_m is not None and height_m >= ceiling_m:
        return failed(
            f"{name} is {value_text(value)} ({rounded(height_m)} m) and the fence's ceiling {rounded(ceiling_m)} m "
            f"({fence}): returning would break the fence",
            f"set {name} lower, or {fence} higher",
            severity=Severity.DANGER,
        )
    if least <= height_m <= most:
        return passed(f"returns at {rounded(height_m)} m")
    to_m = min(max(height_m, least), most)
    to = int(to_m * unit) if unit != 1 else to_m
    return failed(
        f"{name} is {value_text(value)}: it would return at {rounded(height_m)} m ({least:g} to {most:g} m)",
        f"set {name} to {value_text(to)}, or change rtl_height_m",
        Fix(name, to, value),
    )


def return_end(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """State how its return ends, where its parameters decide that."""
    able = facts.class_abilities
    if not able.return_params:
        return skipped("no parameter changes how its return ends")
    for name in (*able.return_params, *able.failsafe_params):
        if facts.value(name) is None:
            return _not_known(facts, name)
    ends = able.return_rule(facts.value)
    values = ", ".join(f"{name} {value_text(facts.value(name) or 0)}" for name in able.return_params)
    text = f"on a return {ends} ({values})"
    if ends.end is ReturnEnd.HOLDS:
        return failed(text, f"set {RTL_LAND_DELAY} to 0 if it is to land there", severity=Severity.NOTE)
    if Q_OPTIONS not in able.failsafe_params:
        return passed(text)
    options = int(facts.value(Q_OPTIONS) or 0)
    does = next((does for bit, does in ON_ROTORS_FAILSAFE.items() if options & bit), "lands where it is (QLAND)")
    text += (
        f"; if it loses its link in {Q_FAILSAFE_MODES} it {does} ({Q_OPTIONS} {options}), "
        "in GUIDED and AUTO FS_LONG_ACTN decides"
    )
    if ends.end is ReturnEnd.CIRCLES and not ends.markers:
        return failed(text, f"set {Q_RTL_MODE} to 1 if it is to land there on its rotors", severity=Severity.NOTE)
    return passed(text)


def geofence(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if facts.family == "px4":
        return _px4_fence(facts, wanted)
    if facts.family != "ardupilot":
        return skipped(NEITHER)
    on, action = facts.value("FENCE_ENABLE"), facts.value("FENCE_ACTION")
    if on is None:
        return (
            _no_fence(wanted, "this firmware has none")
            if facts.answer("FENCE_ENABLE").absent
            else _not_known(facts, "FENCE_ENABLE")
        )
    if on == 0:
        return _no_fence(wanted, "FENCE_ENABLE is 0", Fix("FENCE_ENABLE", 1, on))
    if action is None:
        return _not_known(facts, "FENCE_ACTION")
    if action == 0:
        text = "FENCE_ACTION is 0: the fence is on, and leaving it would only be reported"
        return failed(text, "set FENCE_ACTION to 1 (return or land)", Fix("FENCE_ACTION", 1, action))
    return passed(f"fence on, action {value_text(action)}")


def _px4_fence(facts: PreflightFacts, wanted: Expectations) -> Finding:
    action, far, high = (facts.value(n) for n in ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST"))
    if action is None:
        return _not_known(facts, "GF_ACTION")
    walls = [n for n, v in (("GF_MAX_HOR_DIST", far), ("GF_MAX_VER_DIST", high)) if v]
    if action <= GF_WARN and (walls or wanted.geofence_required):
        text = f"GF_ACTION is {value_text(action)}: leaving the fence would {'only warn' if action else 'do nothing'}"
        return failed(text, "set GF_ACTION to 2 (hold) or 3 (return)", Fix("GF_ACTION", 2, action))
    if walls:
        return passed(f"fence by {' and '.join(walls)}, action {value_text(action)}")
    return _no_fence(wanted, "GF_MAX_HOR_DIST and GF_MAX_VER_DIST are 0")


def _no_fence(wanted: Expectations, why: str, *fixes: Fix) -> Finding:
    if not wanted.geofence_required:
        return skipped(f"no fence: {why}")
    return failed(f"it has no geofence by its parameters: {why}", "set radius and height, and switch it on", *fixes)


def transmitter(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if wanted.transmitter is None:
        return skipped("the fleet file does not say whether a pilot's transmitter belongs to it")
    if facts.family == "px4":
        return _px4_transmitter(facts, wanted.transmitter)
    if facts.family != "ardupilot":
        return skipped(NEITHER)
    on = facts.value("FS_THR_ENABLE")
    if on is None:
        return _not_known(facts, "FS_THR_ENABLE")
    if wanted.transmitter and on == 0:
        text = "FS_THR_ENABLE is 0: losing its transmitter would go unnoticed"
        return failed(text, "set FS_THR_ENABLE to 1 (return)", Fix("FS_THR_ENABLE", 1, on))
    if not wanted.transmitter and on != 0:
        text = (
            f"FS_THR_ENABLE is {value_text(on)}, and no transmitter belongs to it: it would not arm, or return at once"
        )
        return failed(text, "set FS_THR_ENABLE to 0", Fix("FS_THR_ENABLE", 0, on))
    return passed(f"FS_THR_ENABLE {value_text(on)}")


def _px4_transmitter(facts: PreflightFacts, there: bool) -> Finding:
    source = facts.value("COM_RC_IN_MODE")
    if source is None:
        return _not_known(facts, "COM_RC_IN_MODE")
    if there and source in (1, STICKS_OFF):
        text = f"COM_RC_IN_MODE is {value_text(source)}: its transmitter would be ignored"
        return failed(text, "set COM_RC_IN_MODE to 0", Fix("COM_RC_IN_MODE", 0, source))
    if not there and source != STICKS_OFF:
        return failed(
            f"COM_RC_IN_MODE is {value_text(source)}, and no transmitter belongs to it: it may refuse to arm, and "
            "takes the missing input for a lost transmitter",
            f"set COM_RC_IN_MODE to {STICKS_OFF} (sticks disabled)",
            Fix("COM_RC_IN_MODE", STICKS_OFF, source),
        )
    return passed(f"COM_RC_IN_MODE {value_text(source)}")


def setpoint_timeout(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check whether the time-out is long enough for the setpoint rate and short enough for attitude setpoints."""
    if wanted.control is None:
        return skipped("it will not be flown by setpoints")
    name = "COM_OF_LOSS_T" if facts.family == "px4" else "GUID_TIMEOUT"
    value = facts.value(name)
    if value is None:
        return _not_known(facts, name)
    least_s = LOST_PERIODS / wanted.setpoint_hz
    if value < least_s:
        return failed(
            f"{name} is {value_text(value)} s: at {wanted.setpoint_hz:g} setpoints a second {LOST_PERIODS} lost ones "
            f"take {least_s:.2f} s, and it would leave the mode",
            f"set {name} to at least {least_s:.2f}, or raise position_hz and velocity_hz",
            Fix(name, max(least_s, LONGEST_LEAN_S), value),
        )
    if wanted.by_attitude and value > LONGEST_LEAN_S:
        return failed(
            f"{name} is {value_text(value)} s: if the setpoints stop, it keeps its last tilt for that time "
            f"(at most {LONGEST_LEAN_S:g} s)",
            f"set {name} to {LONGEST_LEAN_S:g}",
            Fix(name, LONGEST_LEAN_S, value),
            severity=Severity.DANGER,
        )
    return passed(f"{name} {value_text(value)} s")


def setpoint_loss(facts: PreflightFacts, wanted: Expectations) -> Finding:
    if wanted.control is None or facts.family != "px4":
        return skipped("it will not be flown by setpoints" if wanted.control is None else "PX4's alone")
    action = facts.value("COM_OBL_RC_ACT")
    if action is None:
        return _not_known(facts, "COM_OBL_RC_ACT")
    repair, fix = f"set COM_OBL_RC_ACT to {HOLD} (Hold) or 3 (Return)", Fix("COM_OBL_RC_ACT", HOLD, action)
    if action in FALLS:
        does = PX4_LOSS_ACTS[int(action)]
        return failed(
            f"COM_OBL_RC_ACT is {value_text(action)}: if the setpoints stop, it {does} and falls", repair, fix
        )
    off = facts.value("COM_RC_IN_MODE") == STICKS_OFF
    if action not in BY_STICKS or (facts.sticks in SEEN_AT_ALL and not off):
        return passed(f"COM_OBL_RC_ACT {value_text(action)}")
    why = f"COM_RC_IN_MODE is {STICKS_OFF}: it takes no sticks" if off else NO_STICKS[facts.sticks]
    return failed(
        f"COM_OBL_RC_ACT is {value_text(action)}: if the setpoints stop, it changes to {BY_STICKS[int(action)]} "
        f"mode, and {why}",
        repair,
        fix,
    )


def thrust(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Check whether the autopilot interprets the thrust of attitude setpoints as thrust."""
    if not wanted.by_attitude:
        return skipped("it will not be flown by attitude setpoints")
    name = "MAV_TYPE" if facts.family == "px4" else "GUID_OPTIONS"
    value = facts.value(name)
    if facts.answer("GUID_OPTIONS").absent:
        text = "it has no GUID_OPTIONS: the thrust of attitude setpoints would be interpreted as a climb rate"
        return failed(text, "fly it by velocity (control_mode), or update it: ArduCopter has had the option since 4.1")
    if value is None:
        return _not_known(facts, name)
    if facts.family == "px4":
        if value in PX4_THRUST_TYPES:
            return passed(f"MAV_TYPE {value_text(value)}")
        text = f"MAV_TYPE is {value_text(value)}: PX4 takes the thrust of attitude setpoints for multirotors only"
        return failed(text, "set MAV_TYPE to what it is (2: quadrotor), and reboot it")
    if int(value) & THRUST_AS_THRUST:
        return passed(f"GUID_OPTIONS {value_text(value)}")
    to = int(value) | THRUST_AS_THRUST
    return failed(
        f"GUID_OPTIONS is {value_text(value)}: the thrust of attitude setpoints would be interpreted as a climb rate",
        f"set bit 3 (GUID_OPTIONS to {to})",
        Fix("GUID_OPTIONS", to, value),
    )


def ranges(facts: PreflightFacts, wanted: Expectations) -> Finding:
    """Values outside the ranges of their metadata; one that the fleet file asks for is meant."""
    if facts.outside is None or not facts.judged:
        return skipped("no ranges of its parameters are known")
    wrong = {name: why for name, why in facts.outside.items() if name not in wanted.params}
    if not wrong:
        return passed(f"{facts.judged} parameters are in their ranges")
    text = listed([f"{name}: {why}" for name, why in wrong.items()], MAX_OUTSIDE)
    return failed(text, "correct it; a value that is meant is named in [defaults.preflight.params] of the file")


def parameter(name: str, rule: Rule) -> Callable[[PreflightFacts, Expectations], Finding]:
    """The check of one parameter that the fleet file names."""

    def check(facts: PreflightFacts, wanted: Expectations) -> Finding:
        answer = facts.answer(name)
        if answer.param is None:
            if answer.absent and rule.optional:
                return skipped(f"it has no {name}")
            if answer.absent:
                todo = "correct the name, or say optional = true; ArduPilot hides some while their feature is off"
                return failed(f"it has no parameter {name}", todo)
            return _not_known(facts, name)
        value, held = answer.param.value, answer.param.name
        if rule.holds(value):
            return passed(f"{held} {value_text(value)}")
        to = rule.fix(value)
        text = f"{held} is {value_text(value)} (must be {rule})" + (f": {rule.why}" if rule.why else "")
        if to is None:
            return failed(text, f"set {held}, or change what the fleet file expects")
        todo = f"set {held} to {value_text(to)}, or change what the fleet file expects"
        if sort_of(held) == "identity":  # nothing reaches it by its old id after the next start
            return failed(text, f"{todo}; by hand, then reboot it: this parameter is its identity")
        return failed(text, todo, Fix(held, to, value))

    return check


def return_height(facts: PreflightFacts) -> tuple[str, float, float] | None:
    """Its parameter of the height of a return above home, that parameter's units per metre, and the height in m: the
    highest one of several. None: not known, or it returns as high as it is."""
    found = []
    for param in facts.class_abilities.return_heights:
        name, unit = _held(facts, param)
        value = facts.value(name)
        if value is None or value < 0:
            return None
        found.append((name, unit, value / unit))
    return max(found, key=lambda height: height[2], default=None)


def _held(facts: PreflightFacts, param: HeightParam) -> tuple[str, float]:
    """The name under which the vehicle holds it, and its units per metre; the first one without an answer."""
    return next(((name, unit) for name, unit in param if facts.value(name) is not None), param[0])


def _ceiling(facts: PreflightFacts) -> tuple[float | None, str]:
    """The height of the fence's ceiling above home and its parameter; None if no ceiling is enforced."""
    if facts.family == "px4":
        high = facts.value("GF_MAX_VER_DIST")
        acts = (facts.value("GF_ACTION") or 0) > GF_WARN
        return (high if high and acts else None), "GF_MAX_VER_DIST"
    on, kinds, high = (facts.value(n) for n in ("FENCE_ENABLE", "FENCE_TYPE", "FENCE_ALT_MAX"))
    acts = bool(on) and bool(facts.value("FENCE_ACTION")) and kinds is not None and bool(int(kinds) & FENCE_ALT)
    return (high if acts else None), "FENCE_ALT_MAX"


def _held_name(facts: PreflightFacts, name: str) -> str:
    param = facts.answer(name).param
    return name if param is None else param.name


def _not_known(facts: PreflightFacts, name: str) -> Finding:
    answer = facts.answer(name)
    if answer.absent:
        other = other_name(name)
        named = name if other is None else f"{name} or {other}"
        return skipped(f"it has no {named}")
    return unknown(f"{name} is unknown: {answer.why}", "repeat the preflight; on a busy radio one vehicle at a time")
