"""Checks against plain facts: what the simulated vehicles do not tell, both generations of names, bad input."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from skygcs.core.mavlink.modes import Family
from skygcs.core.mavlink.param_encoding import Param, Value
from skygcs.core.mavlink.vehicle_class import VehicleClass, abilities_of
from skygcs.core.params.expectations import Expectations, Rule
from skygcs.core.preflight import health, settings
from skygcs.core.preflight.report import (
    Answer,
    Finding,
    LinkFacts,
    PreflightFacts,
    PreflightReport,
    Severity,
    Verdict,
    failed,
    passed,
    unknown,
)
from skygcs.core.preflight.table import CHECKS, examine, needed_messages, needed_params
from skygcs.core.vehicle.vehicle_model import SEEN_AT_ALL, Sticks
from support.table import each

STATE: dict[str, Any] = {
    "name": "alpha",
    "sysid": 1,
    "autopilot": "ardupilot",
    "connected": True,
    "duplicate_sysid": False,
    "replayed": False,
    "last_heartbeat_age_s": 0.5,
    "failsafe": False,
    "armed": False,
    "mode": "STABILIZE",
    "system_status": "standby",
    "firmware": "4.6.2",
    "clock_offset_s": 0.1,
    "status_texts": [],
    **dict.fromkeys(("estimator", "position", "gps", "sensors", "battery", "home")),
}


def facts(answers: dict[str, Value | None] | None = None, **state: Any) -> PreflightFacts:
    """``answers``: None is a name the vehicle has not."""
    reported = {n: Answer(absent=True) if v is None else Answer(Param(n, v)) for n, v in (answers or {}).items()}
    return PreflightFacts(state={**STATE, **state}, answers=reported)


WANTED = Expectations()
ATTITUDE = Expectations(control="attitude")


def test_nothing_told_is_no_pass() -> None:
    report = examine(facts(), WANTED)
    assert not report.ok
    unknowns = {f.check for f in report.findings if f.verdict is Verdict.UNKNOWN}
    assert unknowns >= {"estimator", "position", "gps fix", "sensors", "battery", "loss"}
    assert all(f.todo for f in report.complaints)


@each("state", [{"connected": False}, {"replayed": True}, {"duplicate_sysid": True}])
def test_of_who_cannot_be_asked_only_that_is_said(state: dict[str, bool]) -> None:
    report = examine(facts(**state), WANTED)
    assert (len(report.findings), len(report.complaints)) == (3, 1)
    assert len({check.name for check in CHECKS}) == len(CHECKS)


def test_worst_first_and_what_is_not_known_last() -> None:
    findings = [
        unknown("d", "").named("d", Severity.DANGER),
        failed("b", "").named("b", Severity.FAULT),
        passed("a").named("a", Severity.DANGER),
        failed("n", "").named("n", Severity.NOTE),
        failed("c", "", severity=Severity.DANGER).named("c", Severity.NOTE),
    ]
    report = PreflightReport(tuple(findings))
    assert [f.check for f in report.complaints] == ["c", "b", "n", "d"]
    assert report.summary() == "c; b; and 2 more"


@each("name", ["SYSID_THISMAV", "MAV_SYSID"])
def test_either_generations_name_is_found(name: str) -> None:
    answers = {"SYSID_THISMAV": Answer(Param(name, 9))}  # as VehicleParams answers: by the vehicle's own name
    finding = settings.sysid(PreflightFacts(state=STATE, answers=answers), WANTED)
    assert finding.verdict is Verdict.FAIL and f"set {name} to 1" in finding.todo


@each(
    ("answers", "verdict", "says"),
    [
        ({"RTL_ALT": 1500}, Verdict.PASS, "15 m"),
        ({"RTL_ALT": None, "RTL_ALT_M": 15.0}, Verdict.PASS, "15 m"),
        ({"RTL_ALT": 20000}, Verdict.FAIL, "at 200 m (0 to 120 m)"),
        ({"RTL_ALT": None, "RTL_ALT_M": 200.0}, Verdict.FAIL, "RTL_ALT_M is 200"),
        ({"RTL_ALT": 0}, Verdict.PASS, "at the height it is at"),
        ({"RTL_ALT": None, "RTL_ALT_M": None}, Verdict.SKIPPED, "has no"),
    ],
)
def test_return_heights_in_either_unit(answers: dict[str, Value | None], verdict: Verdict, says: str) -> None:
    finding = settings.rtl_height(facts(answers), WANTED)
    assert finding.verdict is verdict and says in finding.text


@each(("answers", "fix"), [({"RTL_ALT": 1500}, 1250), ({"RTL_ALT": None, "RTL_ALT_M": 15.0}, 12.5)])
def test_the_fix_of_a_return_height_is_in_its_own_unit(answers: dict[str, Value | None], fix: float) -> None:
    (found,) = settings.rtl_height(facts(answers), Expectations(rtl_height_m=(3.0, 12.5))).fixes
    assert (found.name, found.value) == (list(answers)[-1], fix)


@each(("enabled", "action", "kinds", "acts"), [(1, 1, 7, True), (0, 1, 7, False), (1, 0, 7, False), (1, 1, 6, False)])
def test_a_return_through_the_fences_ceiling(enabled: int, action: int, kinds: int, acts: bool) -> None:
    fence = {"FENCE_ENABLE": enabled, "FENCE_ACTION": action, "FENCE_TYPE": kinds, "FENCE_ALT_MAX": 10.0}
    finding = settings.rtl_height(facts({"RTL_ALT": 1500, **fence}), WANTED)
    assert (finding.severity is Severity.DANGER) is acts


def test_a_required_fence() -> None:
    wanted = Expectations(geofence_required=True)
    assert settings.geofence(facts({"FENCE_ENABLE": 0}), wanted).fixes[0].value == 1
    px4 = facts({"GF_ACTION": 2, "GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0}, autopilot="px4")
    assert settings.geofence(px4, wanted).verdict is Verdict.FAIL
    assert settings.geofence(px4, WANTED).verdict is Verdict.SKIPPED


def test_attitude_without_the_option_is_refused_as_control_refuses_it() -> None:
    finding = settings.thrust(facts({"GUID_OPTIONS": None}), ATTITUDE)
    assert finding.verdict is Verdict.FAIL and "since 4.1" in finding.todo
    (fix,) = settings.thrust(facts({"GUID_OPTIONS": 3}), ATTITUDE).fixes
    assert fix.value == 11
    raw = Expectations(control="raw")
    assert settings.thrust(facts({"GUID_OPTIONS": 3}), raw).fixes == (fix,)
    assert settings.setpoint_timeout(facts({"GUID_TIMEOUT": 3.0}), raw).verdict is Verdict.FAIL


def test_a_setpoint_timeout_must_outlast_lost_setpoints_but_not_by_attitude() -> None:
    slow = Expectations(control="position", setpoint_hz=2.0)
    px4 = facts({"COM_OF_LOSS_T": 1.0}, autopilot="px4")
    finding = settings.setpoint_timeout(px4, slow)
    assert "3 lost ones take 1.50 s" in finding.text and finding.fixes[0].value == 1.5
    long = facts({"COM_OF_LOSS_T": 5.0}, autopilot="px4")
    assert settings.setpoint_timeout(long, slow).verdict is Verdict.PASS
    assert settings.setpoint_timeout(long, ATTITUDE).severity is Severity.DANGER


def test_sticks_save_who_has_them() -> None:
    """Sticks of the telemetry, whatever the fleet file says: an unset `transmitter` counted as sticks."""
    px4 = facts({"COM_OBL_RC_ACT": 0, "COM_RC_IN_MODE": 0}, autopilot="px4")
    for sticks in Sticks:
        finding = settings.setpoint_loss(replace(px4, sticks=sticks), ATTITUDE)
        assert finding.verdict is (Verdict.PASS if sticks in SEEN_AT_ALL else Verdict.FAIL), sticks
    off = replace(facts({"COM_OBL_RC_ACT": 0, "COM_RC_IN_MODE": 4}, autopilot="px4"), sticks=Sticks.SEEN)
    assert settings.setpoint_loss(off, ATTITUDE).verdict is Verdict.FAIL


def test_a_transmitter_that_belongs_to_it_must_be_heard() -> None:
    wanted = Expectations(transmitter=True)
    assert settings.transmitter(facts({"FS_THR_ENABLE": 0}), wanted).verdict is Verdict.FAIL
    assert settings.transmitter(facts({"COM_RC_IN_MODE": 4}, autopilot="px4"), wanted).fixes[0].value == 0
    lost = PreflightFacts(state=STATE, answers={"FS_GCS_ENABLE": Answer(why="no answer in 7 s")})
    finding = settings.gcs_id(lost, WANTED)
    assert finding.verdict is Verdict.UNKNOWN and "no answer in 7 s" in finding.text


@each("value", [float("nan"), float("inf")])
def test_what_is_no_number_is_not_known(value: float) -> None:
    wanted = Expectations(control="attitude", params={"FENCE_TYPE": Rule(bits=1)})
    names = [n for group in needed_params("ardupilot", wanted) for n in group]
    reported = examine(facts(dict.fromkeys(names, value)), wanted)
    verdicts = {f.check: f.verdict for f in reported.findings}
    of_params = ("system id", "gcs id", "rtl height", "geofence", "setpoint timeout", "thrust", "FENCE_TYPE")
    assert {verdicts[check] for check in of_params} == {Verdict.UNKNOWN}


@each(
    ("firmware", "least", "verdict"),
    [
        ("4.6.2", "4.6", Verdict.PASS),
        ("4.6.2", "4.7", Verdict.FAIL),
        ("1.16.0-rc2", "1.16.0", Verdict.FAIL),
        ("1.16.0", "1.16.0-rc2", Verdict.PASS),
        ("1.16.0-beta10", "1.16.0-beta9", Verdict.PASS),
        ("1.9.0", "1.14", Verdict.FAIL),
        (None, "1.14", Verdict.UNKNOWN),
    ],
)
def test_versions_are_compared_as_versions(firmware: str | None, least: str, verdict: Verdict) -> None:
    assert health.firmware(facts(firmware=firmware), Expectations(firmware_min=least)).verdict is verdict
    exact = Expectations(firmware=("4.6.1", "4.6.3"))
    assert "must be 4.6.1 or 4.6.3" in health.firmware(facts(), exact).text


def sensor_part(present: Iterable[str], unhealthy: Iterable[str] = (), healthy: Iterable[str] = (), age_s: float = 1.0):
    return {"present": present, "enabled": present, "health": healthy, "unhealthy": unhealthy, "age_s": age_s}


def test_sensors_by_name() -> None:
    def found(unhealthy: Iterable[str] = ("3d_mag",), age_s: float = 1.0, texts: Any = (), **wanted: Any) -> Finding:
        part = sensor_part(["gps", "3d_mag"], unhealthy, ["gps"], age_s)
        return health.sensors(facts(sensors=part, status_texts=list(texts)), Expectations(**wanted))

    text = {"text": "PreArm: Compass not healthy", "age_s": 3.0, "level": 2}
    assert found(texts=[text]).text == "sensors unhealthy: 3d_mag (PreArm: Compass not healthy)"
    assert found(sensors_ignored=("3d_mag",)).verdict is Verdict.PASS
    missing = found(sensors_ignored=("3d_mag",), sensors_required=("rangefinder",))
    assert "missing or disabled: rangefinder" in missing.text
    assert found(age_s=60.0).verdict is Verdict.UNKNOWN
    # an ArduPlane from the factory, whose ground station sends no heights of the ground
    ground = found(unhealthy=("terrain",))
    assert (ground.verdict, ground.severity) == (Verdict.FAIL, Severity.NOTE) and "TERRAIN_ENABLE 0" in ground.todo
    for unhealthy in ("terrain",), ():
        needed = found(unhealthy=unhealthy, sensors_required=("terrain",))
        assert (needed.verdict, needed.severity) == (Verdict.FAIL, None), "that of the check"


@each(
    ("autopilot", "firmware", "present", "healthy", "verdict"),
    [
        ("ardupilot", "4.6.2", True, True, Verdict.PASS),
        ("ardupilot", "4.6.2", True, False, Verdict.FAIL),
        ("ardupilot", "3.6.0", False, False, Verdict.SKIPPED),
        ("px4", "1.16.0", False, True, Verdict.PASS),  # PX4 sets the bit of health alone
        ("px4", "1.16.0", False, False, Verdict.FAIL),
        ("px4", "1.12.3", False, False, Verdict.SKIPPED),
        ("px4", None, False, False, Verdict.SKIPPED),
    ],
)
def test_arming_checks(autopilot: str, firmware: str | None, present: bool, healthy: bool, verdict: Verdict) -> None:
    bit = ["prearm_check"]
    part = sensor_part(bit * present, bit * (present and not healthy), bit * healthy)
    assert health.prearm(facts(autopilot=autopilot, firmware=firmware, sensors=part), WANTED).verdict is verdict


def copter_in(mode: str, **state: Any) -> PreflightFacts:
    return PreflightFacts(state={**STATE, "mode": mode, **state}, answers={}, copter=True)


FIRMWARE_ARMS = {
    **dict.fromkeys(("STABILIZE", "ACRO", "ALT_HOLD", "GUIDED", "LOITER", "DRIFT", "SPORT", "POSHOLD", "THROW"), True),
    **dict.fromkeys(("GUIDED_NOGPS", "FLOWHOLD", "ZIGZAG", "TURTLE"), True),
    **dict.fromkeys(("RTL", "CIRCLE", "LAND", "FLIP", "AUTOTUNE", "BRAKE", "AVOID_ADSB", "SMART_RTL", "FOLLOW"), False),
    **dict.fromkeys(("SYSTEMID", "AUTOROTATE", "AUTO_RTL"), False),
}
"""What `Mode::allows_arming` answers to an arming by a ground station, read from ArduCopter 4.6.3 (mode.h)."""


def test_a_mode_that_a_takeoff_leaves_first_is_no_fault_and_is_named() -> None:
    """One judgement: `preflight`, `takeoff` and `plan run` take the mode from `autopilot.takes_off_from`."""
    for mode, arms in {**FIRMWARE_ARMS, "AUTO": False}.items():
        finding = health.arming_mode(copter_in(mode), WANTED)
        assert finding.verdict is Verdict.PASS
        assert (finding.text == f"arms in {mode}") is arms
        assert arms or (mode in finding.text and "change to GUIDED first" in finding.text)
    px4 = health.arming_mode(copter_in("AUTO.LAND", autopilot="px4"), WANTED)
    assert px4.verdict is Verdict.PASS and "change to AUTO.LOITER first" in px4.text


def test_a_px4s_arming_checks_are_not_reported_in_a_mode_in_which_nothing_arms() -> None:
    said = [{"text": "Preflight Fail: No GPS", "severity": "critical", "level": 2, "age_s": 1.0}]
    for mode, why in (("AUTO.LAND", "it does not arm in"), ("OFFBOARD", "only while setpoints come")):
        landed = facts(autopilot="px4", firmware="1.16.0", sensors=sensor_part([]), mode=mode)
        assert health.prearm(landed, WANTED).verdict is Verdict.PASS
        failing = health.prearm(facts(**{**landed.state, "status_texts": said}), WANTED)
        assert failing.verdict is Verdict.FAIL and why in failing.todo and "alpha AUTO.LOITER" in failing.todo


def test_the_mode_is_judged_of_a_disarmed_copter_only() -> None:
    disarmed, armed, no_copter = copter_in("RTL"), copter_in("RTL", armed=True), facts(mode="RTL")
    for seen, wanted in ((armed, WANTED), (no_copter, WANTED), (disarmed, Expectations(prearm=False))):
        assert health.arming_mode(seen, wanted).verdict is Verdict.SKIPPED


def test_a_fleet_indoors() -> None:
    inside = Expectations(gps_fix_min="no_gps", estimator=False, home_max_m=0, clock_max_s=0)
    gone = {"estimator", "position", "gps fix", "satellites", "hdop", "home", "clock"}
    reported = {f.check: f.verdict for f in examine(facts(), inside).findings}
    assert {reported[name] for name in gone} == {Verdict.SKIPPED}


def test_without_gps_a_clock_may_be_unknown_and_not_wrong() -> None:
    inside = Expectations(gps_fix_min="no_gps")
    assert health.clock(facts(clock_offset_s=None), inside).verdict is Verdict.SKIPPED
    assert health.clock(facts(clock_offset_s=None), WANTED).verdict is Verdict.UNKNOWN
    assert health.clock(facts(clock_offset_s=60.0), inside).verdict is Verdict.FAIL


def test_the_best_of_parallel_links_counts() -> None:
    links = {"radio": LinkFacts(0.4, 200, 5.0), "wifi": LinkFacts(0.01, 200)}
    assert health.loss(PreflightFacts(state=STATE, links=links), WANTED).verdict is Verdict.PASS
    assert health.radio_margin(PreflightFacts(state=STATE, links=links), WANTED).verdict is Verdict.FAIL


def test_each_parameter_is_read_once_and_an_empty_rule_is_none() -> None:
    wanted = Expectations(params={"MAV_SYS_ID": Rule(one_of=(1,)), "A": Rule(), "B": Rule(least=1)}, control="attitude")
    names = needed_params("px4", wanted)
    assert len(names) == len(set(names))
    flat = [n for group in names for n in group]
    assert flat.count("MAV_SYS_ID") == 1 and "A" not in flat and "B" in flat and "COM_OBL_RC_ACT" in flat
    assert needed_params("generic", Expectations()) == ()


def test_each_autopilot_is_asked_for_its_own_estimator() -> None:
    assert "ESTIMATOR_STATUS" in needed_messages("px4") and "EKF_STATUS_REPORT" not in needed_messages("px4")
    assert "EKF_STATUS_REPORT" in needed_messages("ardupilot")


@each("kind", [None, *VehicleClass])
@each("family", ["px4", "ardupilot"])
def test_every_parameter_a_check_looks_at_is_asked_for(family: Family, kind: VehicleClass | None) -> None:
    """A check that looks at more than its line of the table says would call it not known."""
    wanted = Expectations(control="attitude", transmitter=False, geofence_required=True) if kind is None else WANTED
    able = None if kind is None else abilities_of(family, kind)
    asked = {n: Answer(Param(n, 1)) for group in needed_params(family, wanted, *filter(None, [able])) for n in group}
    seen = PreflightFacts(state={**STATE, "autopilot": family}, answers=asked)
    if able is not None:
        seen = replace(seen, abilities=able, copter=able.setpoints)
    assert not [f.text for f in examine(seen, wanted).findings if "it was not asked for" in f.text]


QUADPLANE = abilities_of("ardupilot", VehicleClass.VTOL)
PLANE = abilities_of("ardupilot", VehicleClass.PLANE)
PX4_COPTER = abilities_of("px4", VehicleClass.COPTER)


@each(
    ("able", "answers", "verdict", "text"),
    [
        (PLANE, {"RTL_ALTITUDE": 100.0}, Verdict.PASS, "returns at 100 m"),
        (PLANE, {"RTL_ALTITUDE": -1.0}, Verdict.PASS, "at the height it is at"),
        (PLANE, {"RTL_ALTITUDE": 300.0}, Verdict.FAIL, "RTL_ALTITUDE is 300: it would return at 300 m (0 to 120 m)"),
        (QUADPLANE, {"RTL_ALTITUDE": 100.0, "Q_RTL_ALT": 15.0}, Verdict.PASS, "returns at 100 m"),
        (QUADPLANE, {"RTL_ALTITUDE": 100.0, "Q_RTL_ALT": 150.0}, Verdict.FAIL, "Q_RTL_ALT is 150"),
        (abilities_of("ardupilot", VehicleClass.ROVER), {}, Verdict.SKIPPED, "it has no return height"),
    ],
)
def test_the_height_of_a_return_is_that_of_the_class(able, answers, verdict, text) -> None:
    seen = replace(facts(answers, autopilot="ardupilot"), abilities=able)
    finding = settings.rtl_height(seen, WANTED)
    assert finding.verdict is verdict and text in finding.text, finding


def test_planes_of_one_fleet_are_offered_return_heights_by_their_own_parameters() -> None:
    answers: dict[str, Value | None] = {"RTL_ALTITUDE": 30.0, "Q_RTL_ALT": 40.0}
    seen = replace(facts(answers, autopilot="ardupilot"), abilities=QUADPLANE)
    assert settings.return_height(seen) == ("Q_RTL_ALT", 1.0, 40.0)
    assert settings.return_height(replace(seen, abilities=PLANE)) == ("RTL_ALTITUDE", 1.0, 30.0)
    assert settings.return_height(replace(facts({"RTL_ALTITUDE": -1.0}), abilities=PLANE)) is None


STUCK = "if it loses its link in QSTABILIZE, QHOVER, QLOITER, QACRO or QAUTOTUNE it lands where it is (QLAND)"


@each(
    ("able", "answers", "verdict", "text"),
    [
        (PLANE, {"RTL_AUTOLAND": 0}, Verdict.PASS, "on a return it circles above its home (RTL_AUTOLAND 0)"),
        (PLANE, {"RTL_AUTOLAND": 1}, Verdict.PASS, "landing of its mission (DO_LAND_START); without one it circles"),
        (PX4_COPTER, {"RTL_TYPE": 0, "RTL_LAND_DELAY": 0.0}, Verdict.PASS, "on a return it lands and disarms"),
        (PX4_COPTER, {"RTL_TYPE": 0, "RTL_LAND_DELAY": -1.0}, Verdict.FAIL, "on a return it holds above its home"),
        (PX4_COPTER, {"RTL_TYPE": 1, "RTL_LAND_DELAY": -1.0}, Verdict.FAIL, "without one it holds above its home"),
        (QUADPLANE, {"Q_RTL_MODE": 0, "Q_OPTIONS": 0}, Verdict.FAIL, "in GUIDED and AUTO FS_LONG_ACTN decides"),
        (QUADPLANE, {"Q_RTL_MODE": 0, "Q_OPTIONS": 0}, Verdict.FAIL, STUCK),
        (QUADPLANE, {"Q_RTL_MODE": 1, "Q_OPTIONS": 32}, Verdict.PASS, "QAUTOTUNE it returns on them (QRTL)"),
        (QUADPLANE, {"Q_RTL_MODE": 3, "Q_OPTIONS": (1 << 20) + 32}, Verdict.PASS, "QAUTOTUNE it returns as above"),
    ],
)
def test_how_a_return_ends_is_shown_where_parameters_decide_it(able, answers, verdict: Verdict, text: str) -> None:
    seen = replace(facts({"RTL_AUTOLAND": 0, **answers}, autopilot="ardupilot"), abilities=able)
    finding = settings.return_end(seen, WANTED)
    assert finding.verdict is verdict and text in finding.text, finding
    if verdict is Verdict.FAIL:
        todo = "RTL_LAND_DELAY to 0" if able is PX4_COPTER else "Q_RTL_MODE to 1"
        assert finding.severity is Severity.NOTE and todo in finding.todo
    assert settings.return_end(facts(), WANTED).verdict is Verdict.SKIPPED


INDOORS: dict[str, Value | None] = {
    **{"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6, "EK3_SRC1_POSZ": 6, "EK3_SRC1_VELXY": 0, "EK3_SRC1_VELZ": 0},
    **{"EK3_SRC1_YAW": 1, "GPS1_TYPE": 0, "GPS_TYPE": None},
}


@each(
    ("used", "verdict"),
    [
        *(((1, 0, 0), Verdict.PASS), ((0, 0, 1), Verdict.PASS), ((0, 0, 0), Verdict.FAIL)),
        *(((0, None, None), Verdict.FAIL), ((None, None, None), Verdict.PASS)),
    ],
)
def test_a_yaw_of_compasses_that_are_not_used(used: tuple[int | None, ...], verdict: Verdict) -> None:
    compasses = dict(zip(("COMPASS_USE", "COMPASS_USE2", "COMPASS_USE3"), used, strict=True))
    finding = health.external_vision(facts({**INDOORS, **compasses}), Expectations(mocap=True))
    fixes = [("EK3_SRC1_YAW", 6)] if verdict is Verdict.FAIL else []
    assert (finding.verdict, [(fix.name, fix.value) for fix in finding.fixes]) == (verdict, fixes)


@each(("name", "value", "reboot"), [("EKF2_HGT_REF", 1, True), ("EKF2_GPS_CTRL", 7, False), ("EKF2_EV_CTRL", 0, False)])
def test_a_px4_is_rebooted_for_what_it_reads_at_its_start(name: str, value: int, reboot: bool) -> None:
    answers: dict[str, Value | None] = {"EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0, name: value}
    finding = health.external_vision(facts(answers, autopilot="px4"), Expectations(mocap=True))
    assert [fix.name for fix in finding.fixes] == [name]
    assert ("reboot it" in finding.todo) is reboot


def test_a_companion_never_takes_the_ground_stations_place_in_the_failsafe() -> None:
    known = facts({"FS_GCS_ENABLE": 1, "SYSID_MYGCS": 255})
    assert settings.gcs_id(replace(known, gcs_sysid=9), WANTED).fixes  # a ground station would
    companion = settings.gcs_id(replace(known, gcs_sysid=None), WANTED)
    assert companion.fixes == ()
    assert "no ground station" in companion.text


OURS = 253


@each(
    ("answers", "verdict", "severity", "fix"),
    [
        ({"SYSID_MYGCS": OURS, "SYSID_ENFORCE": 1, "MAV_GCS_SYSID_HI": None}, Verdict.PASS, None, None),
        ({"MAV_GCS_SYSID": OURS, "MAV_OPTIONS": 3, "MAV_GCS_SYSID_HI": 0}, Verdict.PASS, None, None),
        ({"SYSID_MYGCS": OURS, "SYSID_ENFORCE": 0}, Verdict.FAIL, Severity.NOTE, ("SYSID_ENFORCE", 1)),
        ({"MAV_GCS_SYSID": OURS, "MAV_OPTIONS": 2}, Verdict.FAIL, Severity.NOTE, ("MAV_OPTIONS", 3)),
        ({"MAV_GCS_SYSID": OURS, "MAV_OPTIONS": 1, "MAV_GCS_SYSID_HI": 255}, Verdict.FAIL, Severity.NOTE, None),
        ({"SYSID_MYGCS": 255, "SYSID_ENFORCE": 1}, Verdict.FAIL, None, None),
        ({"SYSID_MYGCS": OURS}, Verdict.UNKNOWN, None, None),
    ],
)
def test_a_delegated_vehicle_obeys_one_station(answers, verdict, severity, fix) -> None:
    wanted = replace(WANTED, delegated=True)
    finding = settings.one_commander(replace(facts(answers), gcs_sysid=OURS), wanted)
    assert (finding.verdict, finding.severity) == (verdict, severity)
    assert [(f.name, f.value) for f in finding.fixes] == ([] if fix is None else [fix])
    assert settings.one_commander(facts(answers), WANTED).verdict is Verdict.SKIPPED
    assert settings.one_commander(facts(answers, autopilot="px4"), wanted).verdict is Verdict.SKIPPED
    assert ("SYSID_ENFORCE", "MAV_OPTIONS") in needed_params("ardupilot", wanted)
    assert ("SYSID_ENFORCE", "MAV_OPTIONS") not in needed_params("ardupilot", WANTED)
