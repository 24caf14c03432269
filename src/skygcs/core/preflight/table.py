"""All checks in order, what each needs, and how a vehicle is examined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from skygcs.core.mavlink.modes import Family
from skygcs.core.mavlink.vehicle_class import Abilities, VehicleClass, abilities_of
from skygcs.core.params.expectations import Expectations
from skygcs.core.preflight import health, settings
from skygcs.core.preflight.report import Finding, PreflightFacts, PreflightReport, Severity

Judge = Callable[[PreflightFacts, Expectations], Finding]
Needs = Callable[[Expectations], bool]
OfClass = Callable[[Abilities], tuple[tuple[str, ...], ...]]

DANGER, FAULT, NOTE = Severity.DANGER, Severity.FAULT, Severity.NOTE


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the table.

    ``messages``: what has to have come lately, of a PX4 and of an ArduPilot alike where both send it. ``px4`` and
    ``ardupilot``: parameters; of names in one tuple any will do, in this order. ``if_wanted``: whether they are needed.
    """

    name: str
    severity: Severity
    judge: Judge
    messages: tuple[str, ...] = ()
    px4: tuple[tuple[str, ...], ...] = ()
    ardupilot: tuple[tuple[str, ...], ...] = ()
    if_wanted: Needs = lambda wanted: True
    of_copters: bool = False
    """Its parameters are read of copters only."""
    of_class: OfClass = lambda able: ()
    """Further parameters, which the abilities of its class name."""


def _controlled(wanted: Expectations) -> bool:
    return wanted.control is not None


ALONE = ("link", "duplicate", "in fleet file")
"""All that can be said of a vehicle that is lost, a recording, or two."""

CHECKS: tuple[Check, ...] = (
    Check("link", FAULT, health.reachable),
    Check("duplicate", DANGER, health.single),
    Check("in fleet file", FAULT, health.known),
    Check("autopilot", DANGER, health.autopilot),
    Check("system id", DANGER, settings.sysid, px4=(("MAV_SYS_ID",),), ardupilot=(("SYSID_THISMAV",),)),
    Check("failsafe", DANGER, health.failsafe),
    Check("estimator", DANGER, health.estimator, ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")),
    Check("poses", DANGER, health.poses),
    Check(
        "external vision",
        DANGER,
        health.external_vision,
        px4=health.PX4_PARAMS,
        ardupilot=health.COPTER_PARAMS,
        if_wanted=lambda wanted: wanted.mocap,
    ),
    Check("ekf origin", FAULT, health.estimator_origin),
    Check("position", DANGER, health.position, ("GLOBAL_POSITION_INT",)),
    Check("gps fix", DANGER, health.gps_fix, ("GPS_RAW_INT",)),
    Check("satellites", FAULT, health.satellites, ("GPS_RAW_INT",)),
    Check("hdop", FAULT, health.hdop, ("GPS_RAW_INT",)),
    Check("sensors", DANGER, health.sensors, ("SYS_STATUS",)),
    Check("arming checks", FAULT, health.prearm, ("SYS_STATUS",)),
    Check("mode", FAULT, health.arming_mode),
    Check("battery", FAULT, health.battery, ("SYS_STATUS", "BATTERY_STATUS")),
    Check("home", DANGER, health.home, ("HOME_POSITION",)),
    Check("clock", NOTE, health.clock, ("SYSTEM_TIME",)),
    Check("firmware", NOTE, health.firmware, ("AUTOPILOT_VERSION",)),
    Check("loss", FAULT, health.loss),
    Check("radio", FAULT, health.radio_margin),
    Check(
        "gcs id",
        FAULT,
        settings.gcs_id,
        ardupilot=(("FS_GCS_ENABLE",), ("SYSID_MYGCS",)),
    ),
    Check(
        "one commander",
        FAULT,
        settings.one_commander,
        ardupilot=(("SYSID_MYGCS",), ("SYSID_ENFORCE", "MAV_OPTIONS"), ("MAV_GCS_SYSID_HI",)),
        if_wanted=lambda wanted: wanted.delegated,
    ),
    Check("gcs failsafe", FAULT, settings.gcs_failsafe, ardupilot=(("FS_GCS_ENABLE",), ("FS_OPTIONS",))),
    Check(
        "rtl height",
        FAULT,
        settings.rtl_height,
        ardupilot=(("FENCE_ALT_MAX",), ("FENCE_TYPE",)),
        of_class=lambda able: able.height_params,
    ),
    Check(
        "return",
        NOTE,
        settings.return_end,
        of_class=lambda able: tuple((name,) for name in (*able.return_params, *able.failsafe_params)),
    ),
    Check(
        "geofence",
        FAULT,
        settings.geofence,
        px4=(("GF_ACTION",), ("GF_MAX_HOR_DIST",), ("GF_MAX_VER_DIST",)),
        ardupilot=(("FENCE_ENABLE",), ("FENCE_ACTION",)),
    ),
    Check(
        "transmitter",
        FAULT,
        settings.transmitter,
        px4=(("COM_RC_IN_MODE",),),
        ardupilot=(("FS_THR_ENABLE",),),
        if_wanted=lambda wanted: wanted.transmitter is not None,
    ),
    Check(
        "setpoint timeout",
        FAULT,
        settings.setpoint_timeout,
        px4=(("COM_OF_LOSS_T",),),
        ardupilot=(("GUID_TIMEOUT",),),
        if_wanted=_controlled,
    ),
    Check(
        "setpoint loss",
        DANGER,
        settings.setpoint_loss,
        px4=(("COM_OBL_RC_ACT",), ("COM_RC_IN_MODE",)),
        if_wanted=_controlled,
    ),
    Check(
        "thrust",
        DANGER,
        settings.thrust,
        px4=(("MAV_TYPE",),),
        ardupilot=(("GUID_OPTIONS",),),
        if_wanted=lambda wanted: wanted.by_attitude,
    ),
    Check(
        "parameter ranges",
        FAULT,
        settings.ranges,
        px4=(
            ("MPC_XY_CRUISE",),
            ("MPC_XY_VEL_MAX",),
            ("MPC_Z_VEL_MAX_UP",),
            ("MPC_Z_VEL_MAX_DN",),
            ("MPC_TILTMAX_AIR",),
            ("MPC_LAND_SPEED",),
        ),
        ardupilot=(
            ("WPNAV_SPEED", "WP_SPD"),
            ("WPNAV_SPEED_UP", "WP_SPD_UP"),
            ("WPNAV_SPEED_DN", "WP_SPD_DN"),
            ("ANGLE_MAX", "ATC_ANGLE_MAX"),
            ("LAND_SPEED", "LAND_SPD_MS"),
        ),
        of_copters=True,
    ),
)
"""In the order of a person's attention; parameters that the fleet file names come behind them, as `parameter`s."""


def needed_params(
    family: Family, wanted: Expectations, abilities: Abilities | None = None
) -> tuple[tuple[str, ...], ...]:
    """Names of parameters to read from a vehicle of this autopilot, each once; of several in one, any will do.
    ``abilities``: of its class; None: a copter's."""
    able = abilities or abilities_of(family, VehicleClass.COPTER)
    needed: dict[tuple[str, ...], None] = {}
    for check in CHECKS:
        if check.if_wanted(wanted) and (able.setpoints or not check.of_copters):
            needed.update(dict.fromkeys({"px4": check.px4, "ardupilot": check.ardupilot}.get(family, ())))
            needed.update(dict.fromkeys(check.of_class(able)))
    single = {names[0] for names in needed if len(names) == 1}
    needed.update({(name,): None for name, rule in wanted.params.items() if not rule.empty and name not in single})
    return tuple(needed)


def needed_messages(family: str) -> tuple[str, ...]:
    """Messages to ask for if they have not come lately, each once."""
    other = {"px4": "EKF_STATUS_REPORT", "ardupilot": "ESTIMATOR_STATUS"}.get(family)
    return tuple(dict.fromkeys(m for check in CHECKS for m in check.messages if m != other))


def examine(facts: PreflightFacts, wanted: Expectations) -> PreflightReport:
    """Every check's finding. Of a vehicle that cannot be asked only what says so."""
    findings = [
        check.judge(facts, wanted).named(check.name, check.severity)
        for check in CHECKS
        if facts.able or check.name in ALONE
    ]
    if facts.able:
        for name, rule in wanted.params.items():
            if not rule.empty:
                findings.append(settings.parameter(name, rule)(facts, wanted).named(name, FAULT))
    return PreflightReport(tuple(findings))
