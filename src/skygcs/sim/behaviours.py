"""Behaviours of PX4 and ArduCopter, as data: each value with the place in the firmware's source it was read from.

The models of `skygcs.sim` take their values from here; docs/reference/simulated-firmware.md is this table in words,
and tests/unit/sim and tests/firmware fly the same scenarios on the simulator and on real firmware against it.

Read from PX4 v1.16.1 (94cb2012; paths below src/modules, but for src/lib) and Copter-4.6.3 (92b0cd78). "measured"
beside a source: flown with that firmware's own simulator (SIH, SITL), because the source gives a mechanism and not a
number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Generic, TypeVar

from skygcs.core.mavlink import mav_cmd
from skygcs.core.mission.item import FENCE_COMMANDS
from skygcs.sim import protocol as m
from skygcs.sim.firmware_modes import COPTER_RULES, PX4_RULES, ModeRule

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Fact(Generic[T]):
    """One value of a firmware. ``source`` is "path: function, constant or parameter" in its repository.

    ``used`` is what the simulator does instead, with ``why``; None: the same.
    """

    value: T
    source: str
    used: T | None = None
    why: str = ""
    simulated: T = field(init=False, repr=False, compare=False)
    """Value that the simulator takes: a field and no property, as each tick reads a dozen of them."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "simulated", self.value if self.used is None else self.used)


# -- failsafes


class Reaction(Enum):
    """Reaction of a failsafe, in the word of its text."""

    NONE = "nothing"
    WARN = "warning only"
    POSITION = "position mode without sticks"
    ALTITUDE = "altitude mode without sticks"
    STABILIZED = "stabilized mode without sticks"
    BRAKE = "braking"
    HOLD = "holding"
    RETURN = "returning"
    SMART_RETURN = "returning by its own way"
    LAND = "landing"
    STOP = "motors off"


@dataclass(frozen=True, slots=True)
class HomeFollows:
    """Home is moved each ``period_s`` if the vehicle is farther from it, over the ground or in height."""

    period_s: float
    over_ground_m: float
    in_height_m: float


@dataclass(frozen=True, slots=True)
class Reactions:
    """Reactions to the values of a parameter."""

    param: str
    by_value: Mapping[int, Reaction]
    otherwise: Reaction

    def of(self, value: float) -> Reaction:
        return self.by_value.get(int(value), self.otherwise)


_COPTER_LINK = {
    0: Reaction.NONE,
    1: Reaction.RETURN,
    2: Reaction.RETURN,
    3: Reaction.SMART_RETURN,
    4: Reaction.SMART_RETURN,
}
_COPTER_BATTERY = {
    0: Reaction.NONE,
    1: Reaction.LAND,
    2: Reaction.RETURN,
    3: Reaction.SMART_RETURN,
    4: Reaction.SMART_RETURN,
    5: Reaction.STOP,
    7: Reaction.BRAKE,
}
_PX4_LINK = {
    0: Reaction.NONE,
    1: Reaction.HOLD,
    2: Reaction.RETURN,
    3: Reaction.LAND,
    5: Reaction.STOP,
    6: Reaction.STOP,
}


@dataclass(frozen=True, slots=True)
class MissionRules:
    """The mission protocol of a firmware; the state machines are in `px4_lists` and `copter_lists`."""

    retry_s: float
    give_up_s: float
    missions: int
    fence: int
    rally: int
    with_place: frozenset[int]
    without_place: frozenset[int]


@dataclass(frozen=True, slots=True)
class Answers:
    """MAV_RESULT of what differs between the firmwares. None: no COMMAND_ACK at all."""

    unknown_message: int
    """REQUEST_MESSAGE for a message it does not have."""
    unknown_interval: int
    """SET_MESSAGE_INTERVAL for one."""
    reboot_armed: int
    reboot_nothing: int
    """PREFLIGHT_REBOOT_SHUTDOWN with param1 0."""
    arm_neither: int | None
    """COMPONENT_ARM_DISARM with another number than 0 and 1."""
    calibrate_armed: int
    prearm_checks: int | None
    """RUN_PREARM_CHECKS while disarmed."""
    terminate_not: int
    """DO_FLIGHTTERMINATION with param1 0."""
    pause: int
    """DO_PAUSE_CONTINUE outside of a mission."""
    mission_current_beyond: int
    """DO_SET_MISSION_CURRENT of an item that is not there."""
    forced_arming: bool
    """True if 21196 in param2 passes over the arming checks."""


@dataclass(frozen=True, slots=True)
class GainNames:
    """The parameters of position and velocity control; "": it has none."""

    xy_p: str
    xy_vel_p: str
    xy_vel_i: str
    xy_vel_d: str
    z_p: str
    z_vel_p: str
    z_vel_i: str
    tilt_max: str
    tilt_unit_deg: float
    jerk_xy: str = ""
    jerk_z: str = ""


@dataclass(frozen=True, slots=True)
class Firmware:
    """One firmware's behaviour. Every field is a `Fact`, but the name and version."""

    name: str
    version: str

    # start
    ready_after_s: Fact[float]
    """From boot until the position estimate is good enough to arm."""

    # modes and arming
    modes: Fact[dict[int, ModeRule]]
    arming_needs_position: Fact[bool]
    """In every mode, not only in those that need a position."""
    arming_battery: Fact[str]
    """Parameter of the charge (0..1) below which nothing arms; "": none."""
    idle_disarm: Fact[tuple[str, float]]
    """Armed on the ground and not taken off: parameter (s), and what is added to it."""
    answers: Fact[Answers]
    home_here_is_fixed: Fact[bool]
    """DO_SET_HOME to where it is keeps that home over the next arming, as one elsewhere does on both."""
    home_follows: Fact[HomeFollows | None]
    """Rule by which home follows a disarmed vehicle; None: home stays until the next arming."""

    # flight
    spool_up_s: Fact[float]
    """From arming until the motors lift."""
    climb_accel: Fact[tuple[str, float]]
    """Parameter, and its unit in m/s²."""
    jerk: Fact[str]
    """Parameter (m/s³) that bounds how the speed changes on the way to a position; "": none."""
    brake: Fact[tuple[float, float, float]]
    """Stopping where it is: acceleration (m/s²), jerk (m/s³), and time (s) until the body follows."""
    land_fast_above_m: Fact[float]
    land_slow_below_m: Fact[float]
    """A landing goes at its normal speed of descent above the one, at its landing speed below the other height."""
    landed_after_s: Fact[float]
    """From touching the ground until the vehicle believes it."""
    crash: Fact[tuple[float, float, float, float]]
    """Lean (deg), error of the attitude (deg), acceleration (m/s²) and time (s) from which an armed vehicle has crashed
    and disarms; all 0: it does not."""

    times: Fact[dict[str, float]]
    """To 10 m, 15 m away (from stand to stand, to 1 m), down from 10 m to 0.5 m, and until it disarms (s)."""

    # setpoints
    setpoint_timeout: Fact[str]
    """Parameter (s) after which a stream that has ceased has ceased."""
    attitude_timeout_s: Fact[float | None]
    """The same for attitudes, where it is another; None: the parameter."""

    control_gains: Fact[GainNames]
    """Velocity per metre, acceleration per m/s, lean and jerk."""
    target_moves_on: Fact[bool]
    """Between two messages a position moves on with its velocity and acceleration."""
    target_shaped: Fact[bool]
    """The way to a target is a path within jerk and acceleration; otherwise each target is followed at once."""
    axes_mix: Fact[bool]
    """Each axis may be given a position, a velocity or an acceleration; otherwise all three axes or none."""
    global_int_acceleration: Fact[bool]
    """SET_POSITION_TARGET_GLOBAL_INT with position and velocity: whether its acceleration counts."""
    yaw_unset: Fact[str]
    """Heading for a target with neither yaw nor yaw rate."""

    circle_rms_m: Fact[dict[str, float]]
    """RMS of the distance from a circle of 5 m at 2 m/s that is sent five times a second, by what is sent of it."""
    attitude_targets: Fact[dict[str, str]]
    """Effect of a SET_ATTITUDE_TARGET."""
    controllers_s: Fact[float]
    """The other kind of target (position, attitude or rates) is flown from the next multiple of this (s) since the last
    command or change of mode; until then the target before is."""

    # failsafes
    failsafe_hold: Fact[str]
    """Parameter (s): so long it holds before it returns or lands; "": at once."""
    failsafe_land_pause_s: Fact[float]
    """So long a landing by a failsafe waits before it descends."""
    gcs_timeout: Fact[str]
    gcs: Fact[Reactions]
    setpoints_lost: Fact[Reactions]
    fence: Fact[Reactions]
    battery_low: Fact[Reactions]
    battery_critical: Fact[Reactions]
    battery_emergency: Fact[Reactions]
    position_lost_s: Fact[float]
    """In the air, from the last GPS fix until the estimate is given up."""

    # missions
    mission: Fact[MissionRules] = field(repr=False)
    altitude_step_m: Fact[float] = field(repr=False)
    """Altitudes of items are kept in steps of this; 0: as they came."""


_NEVER = Reactions("", {}, Reaction.NONE)

COPTER: Final = Firmware(
    name="ArduCopter",
    version="4.6.3",
    ready_after_s=Fact(
        42.0,
        "libraries/AP_NavEKF3/AP_NavEKF3_Control.cpp: setAidingMode, after AP_GPS's fix and the tilt "
        "alignment (measured)",
        used=7.0,
        why="demos and tests in real time would wait for nothing else",
    ),
    modes=Fact(
        COPTER_RULES,
        "ArduCopter/mode.h: allows_arming, requires_GPS, is_autopilot, is_landing; mode_auto.cpp: "
        "ModeAuto::allows_arming (bit 0 of AUTO_OPTIONS); never: the mode's init fails or it is not compiled in "
        "(measured)",
    ),
    arming_needs_position=Fact(False, "ArduCopter/AP_Arming.cpp: AP_Arming_Copter::mandatory_gps_checks"),
    arming_battery=Fact("", "libraries/AP_Arming/AP_Arming.cpp: battery_checks (BATT_ARM_VOLT 0, BATT_ARM_MAH 0)"),
    idle_disarm=Fact(("DISARM_DELAY", 0.0), "ArduCopter/motors.cpp: Copter::auto_disarm_check"),
    answers=Fact(
        Answers(
            unknown_message=m.MAV_RESULT_FAILED,
            unknown_interval=m.MAV_RESULT_DENIED,
            reboot_armed=m.MAV_RESULT_FAILED,
            reboot_nothing=m.MAV_RESULT_UNSUPPORTED,
            arm_neither=m.MAV_RESULT_UNSUPPORTED,
            calibrate_armed=m.MAV_RESULT_FAILED,
            prearm_checks=m.MAV_RESULT_ACCEPTED,
            terminate_not=m.MAV_RESULT_FAILED,
            pause=m.MAV_RESULT_FAILED,
            mission_current_beyond=m.MAV_RESULT_DENIED,
            forced_arming=True,
        ),
        "libraries/GCS_MAVLink/GCS_Common.cpp: handle_command_int_packet, set_message_interval, "
        "handle_command_do_set_mission_current; ArduCopter/GCS_Mavlink.cpp (each measured)",
    ),
    home_here_is_fixed=Fact(
        True, "ArduCopter/commands.cpp: set_home_to_current_location (locks it); AP_Arming.cpp: AP_Arming_Copter::arm"
    ),
    home_follows=Fact(None, "ArduCopter/commands.cpp: update_home_from_EKF (only while home is not set)"),
    spool_up_s=Fact(
        2.0,
        "libraries/AP_Motors/AP_MotorsMulticopter.cpp: MOT_SPOOL_TIME, and the arming delay (Copter.h: "
        "in_arming_delay)",
    ),
    climb_accel=Fact(("WPNAV_ACCEL_Z", 0.01), "libraries/AC_WPNav/AC_WPNav.cpp: WPNAV_ACCEL_Z (100 cm/s²)"),
    jerk=Fact("", "ArduCopter/mode_guided.cpp: pos_control_run (input shaping with PSC_JERK_XY, no S-curve in GUIDED)"),
    brake=Fact(
        (7.5, 5.0, 0.3),
        "ArduCopter/config.h: BRAKE_MODE_DECEL_RATE; libraries/AC_AttitudeControl/AC_PosControl.cpp: "
        "PSC_JERK_XY (measured)",
    ),
    land_fast_above_m=Fact(10.0, "ArduCopter/mode.cpp: Mode::land_run_vertical_control (LAND_ALT_LOW)"),
    land_slow_below_m=Fact(10.0, "ArduCopter/mode.cpp: Mode::land_run_vertical_control (LAND_ALT_LOW)"),
    landed_after_s=Fact(
        2.0,
        "ArduCopter/config.h: LAND_DETECTOR_TRIGGER_SEC, after the 1 Hz filter of the acceleration, and MOT_SPOOL_TIME "
        "(measured)",
    ),
    crash=Fact((15.0, 30.0, 3.0, 2.0), "ArduCopter/crash_check.cpp: Copter::crash_check, CRASH_CHECK_*"),
    times=Fact(
        {"takeoff s": 9.5, "15 m s": 4.7, "land to .5 m s": 19.5, "land to disarmed s": 22.6},
        "ArduCopter/mode_guided.cpp: run; mode_land.cpp: run (measured in SITL, with its default parameters)",
    ),
    setpoint_timeout=Fact("GUID_TIMEOUT", "ArduCopter/mode_guided.cpp: ModeGuided::get_timeout_ms (at least 0.1 s)"),
    attitude_timeout_s=Fact(
        None, "ArduCopter/mode_guided.cpp: ModeGuided::angle_control_run (up to 4.0: GUIDED_ATTITUDE_TIMEOUT_MS, 1 s)"
    ),
    control_gains=Fact(
        GainNames(
            xy_p="PSC_POSXY_P",
            xy_vel_p="PSC_VELXY_P",
            xy_vel_i="PSC_VELXY_I",
            xy_vel_d="PSC_VELXY_D",
            z_p="PSC_POSZ_P",
            z_vel_p="PSC_VELZ_P",
            z_vel_i="",
            tilt_max="ANGLE_MAX",
            tilt_unit_deg=0.01,
            jerk_xy="PSC_JERK_XY",
            jerk_z="PSC_JERK_Z",
        ),
        "libraries/AC_AttitudeControl/AC_PosControl.cpp: update_xy_controller, update_z_controller "
        "(1.0; 2.0, 1.0, 0.25; z 1.0, 5.0; 30 deg; 5 m/s³)",
    ),
    target_moves_on=Fact(
        True,
        "libraries/AC_AttitudeControl/AC_PosControl.cpp: input_pos_vel_accel_xy, input_vel_accel_xy (until "
        "GUID_TIMEOUT; then its velocity is 0)",
    ),
    target_shaped=Fact(
        True,
        "libraries/AP_Math/control.cpp: shape_pos_vel_accel_xy (WPNAV_ACCEL, PSC_JERK_XY; beside the feed-forward)",
    ),
    axes_mix=Fact(
        False,
        "ArduCopter/GCS_Mavlink.cpp: handle_message_set_position_target_local_ned (position and acceleration without "
        "velocity: it stops)",
    ),
    global_int_acceleration=Fact(
        False, "ArduCopter/GCS_Mavlink.cpp: handle_message_set_position_target_global_int (set_destination_posvel)"
    ),
    yaw_unset=Fact(
        "where it flies, faster than 5 % of WPNAV_SPEED",
        "ArduCopter/mode_guided.cpp: ModeGuided::set_yaw_state; autoyaw.cpp: default_mode (WP_YAW_BEHAVIOR 2); "
        "AC_PosControl.cpp: calculate_yaw_and_rate_yaw",
    ),
    circle_rms_m=Fact(
        {"position": 2.7, "position, velocity": 0.65, "position, velocity, acceleration": 0.15},
        "libraries/AC_AttitudeControl/AC_PosControl.cpp: input_pos_vel_accel_xy (measured)",
    ),
    attitude_targets=Fact(
        {
            "attitude and rates": "flown",
            "attitude and one rate of three": "stops",
            "thrust ignored": "passed over",
            "quaternion of length 1.01": "passed over",
        },
        "ArduCopter/GCS_Mavlink.cpp: handle_message_set_attitude_target (measured)",
    ),
    controllers_s=Fact(0.0, "ArduCopter/mode_guided.cpp: angle_control_start, pva_control_start (at once)"),
    failsafe_hold=Fact("", "ArduCopter/events.cpp: Copter::do_failsafe_action"),
    failsafe_land_pause_s=Fact(4.0, "ArduCopter/config.h: LAND_WITH_DELAY_MS; mode_land.cpp: set_mode_land_with_pause"),
    gcs_timeout=Fact("FS_GCS_TIMEOUT", "ArduCopter/events.cpp: Copter::failsafe_gcs_check (only SYSID_MYGCS counts)"),
    gcs=Fact(
        Reactions("FS_GCS_ENABLE", _COPTER_LINK, Reaction.RETURN),
        "ArduCopter/events.cpp: Copter::failsafe_gcs_on_event (6: DO_LAND_START, else RTL)",
    ),
    setpoints_lost=Fact(
        _NEVER, "ArduCopter/mode_guided.cpp: velaccel_control_run (a velocity becomes 0, the mode stays)"
    ),
    fence=Fact(
        Reactions(
            "FENCE_ACTION",
            {
                0: Reaction.WARN,
                1: Reaction.RETURN,
                2: Reaction.LAND,
                3: Reaction.SMART_RETURN,
                4: Reaction.BRAKE,
                5: Reaction.SMART_RETURN,
            },
            Reaction.RETURN,
        ),
        "ArduCopter/fence.cpp: Copter::fence_check (more than 100 m beyond: LAND)",
    ),
    battery_low=Fact(
        Reactions("BATT_FS_LOW_ACT", _COPTER_BATTERY, Reaction.RETURN),
        "ArduCopter/Copter.h: FailsafeAction; events.cpp: handle_battery_failsafe (BATT_LOW_MAH at once, "
        "BATT_LOW_VOLT after "
        "BATT_LOW_TIMER)",
    ),
    battery_critical=Fact(
        Reactions("BATT_FS_CRT_ACT", _COPTER_BATTERY, Reaction.RETURN),
        "ArduCopter/events.cpp: handle_battery_failsafe (BATT_CRT_MAH)",
    ),
    battery_emergency=Fact(_NEVER, "libraries/AP_BattMonitor/AP_BattMonitor.h: Failsafe (there is no third level)"),
    position_lost_s=Fact(
        8.0,
        "libraries/AP_NavEKF3/AP_NavEKF3.h: posRetryTimeUseVel_ms; ArduCopter/ekf_check.cpp: "
        "EKF_CHECK_ITERATIONS_MAX (1 s; measured)",
    ),
    mission=Fact(
        MissionRules(
            retry_s=1.0,
            give_up_s=8.0,
            missions=724,
            fence=84,
            rally=20,
            with_place=frozenset({16, 17, 18, 19, 21, 22, 30, 31, 82, 84, 85, 92, 94, 179, 188, 189, 191, 195, 201})
            | FENCE_COMMANDS
            | {mav_cmd.NAV_RALLY_POINT},
            without_place=frozenset(
                {20, 83, 93, 112, 114, 115, 177, 178, 181, 182, 183, 184, 193, 194, 197, 202, 203, 205, 206}
                | {207, 208, 210, 211, 212, 213, 215, 216, 217, 218, 222, 223, 531, 532, 534, 600, 601, 1000}
                | {2000, 2001, 2500, 2501, 3000, 42600, 42702, 42703}
            ),
        ),
        "libraries/GCS_MAVLink/MissionItemProtocol.h: upload_timeout_ms; libraries/AP_Mission/AP_Mission.cpp: "
        "stored_in_location, mavlink_int_to_mission_cmd",
    ),
    altitude_step_m=Fact(0.01, "libraries/AP_Common/Location.h: alt in centimetres"),
)

PX4: Final = Firmware(
    name="PX4",
    version="1.16.1",
    ready_after_s=Fact(4.0, "ekf2/EKF/aid_sources/gnss/gnss_checks.cpp: EKF2_REQ_GPS_H (SITL: 0.5 s; measured)"),
    modes=Fact(
        PX4_RULES,
        "commander/ModeUtil/mode_requirements.cpp: getModeRequirements; "
        "HealthAndArmingChecks/checks/modeCheck.cpp: ModeChecks::checkAndReport; Commander.cpp: handle_command "
        "(DO_SET_MODE; LAND is always entered)",
    ),
    arming_needs_position=Fact(
        True,
        "commander/HealthAndArmingChecks/checks/modeCheck.cpp: local and global position in every mode that "
        "arms but OFFBOARD",
    ),
    arming_battery=Fact("BAT_CRIT_THR", "commander/HealthAndArmingChecks/checks/batteryCheck.cpp (COM_ARM_BAT_MIN -1)"),
    idle_disarm=Fact(("COM_DISARM_PRFLT", 1.0), "commander/Commander.cpp: handleAutoDisarm (plus COM_SPOOLUP_TIME)"),
    answers=Fact(
        Answers(
            unknown_message=m.MAV_RESULT_DENIED,
            unknown_interval=m.MAV_RESULT_FAILED,
            reboot_armed=m.MAV_RESULT_DENIED,
            reboot_nothing=m.MAV_RESULT_ACCEPTED,
            arm_neither=None,
            calibrate_armed=m.MAV_RESULT_TEMPORARILY_REJECTED,
            prearm_checks=m.MAV_RESULT_ACCEPTED,
            terminate_not=m.MAV_RESULT_DENIED,
            pause=m.MAV_RESULT_UNSUPPORTED,
            mission_current_beyond=m.MAV_RESULT_UNSUPPORTED,
            forced_arming=False,
        ),
        "commander/Commander.cpp: handle_command; mavlink/mavlink_receiver.cpp: "
        "handle_message_command_both (each measured)",
    ),
    home_here_is_fixed=Fact(False, "commander/HomePosition.cpp: setHomePosition (manual_home), setManually"),
    home_follows=Fact(
        HomeFollows(0.0, 1.0, 1.5),
        "commander/HomePosition.cpp: update, hasMovedFromCurrentHomeLocation; Commander.cpp: run (disarmed and landed)",
    ),
    spool_up_s=Fact(2.5, "commander/commander_params.c: COM_SPOOLUP_TIME (1 s), then half of MPC_TKO_RAMP_T (3 s)"),
    climb_accel=Fact(("MPC_ACC_UP_MAX", 1.0), "mc_pos_control/multicopter_position_control_limits_params.c"),
    jerk=Fact("MPC_JERK_AUTO", "src/lib/motion_planning/PositionSmoothing.cpp: computeMaxSpeedFromDistance"),
    brake=Fact(
        (3.0, 4.0, 0.3), "navigator/navigator_main.cpp: preproject_stop_point (MPC_ACC_HOR, MPC_JERK_AUTO; measured)"
    ),
    land_fast_above_m=Fact(
        10.0, "flight_mode_manager/tasks/Auto/FlightTaskAuto.cpp: _prepareLandSetpoints (MPC_LAND_ALT1)"
    ),
    land_slow_below_m=Fact(
        5.0, "flight_mode_manager/tasks/Auto/FlightTaskAuto.cpp: _prepareLandSetpoints (MPC_LAND_ALT2)"
    ),
    landed_after_s=Fact(
        4.0,
        "land_detector/MulticopterLandDetector.cpp: three stages of LNDMC_TRIG_TIME / 3, each once the thrust is "
        "low (measured)",
    ),
    crash=Fact(
        (0.0, 0.0, 0.0, 0.0),
        "commander/failsafe/failsafe.cpp: fd_critical_failure (CBRK_FLIGHTTERM 121212: a warning, but for the "
        "first COM_LKDOWN_TKO + COM_SPOOLUP_TIME seconds)",
    ),
    times=Fact(
        {"takeoff s": 11.4, "15 m s": 5.9, "land to .5 m s": 13.5, "land to disarmed s": 20.4},
        "flight_mode_manager/tasks/Auto/FlightTaskAuto.cpp: update (measured in SIH, with its default parameters)",
    ),
    setpoint_timeout=Fact("COM_OF_LOSS_T", "commander/HealthAndArmingChecks/checks/offboardCheck.cpp"),
    attitude_timeout_s=Fact(None, "commander/HealthAndArmingChecks/checks/offboardCheck.cpp"),
    control_gains=Fact(
        GainNames(
            xy_p="MPC_XY_P",
            xy_vel_p="MPC_XY_VEL_P_ACC",
            xy_vel_i="MPC_XY_VEL_I_ACC",
            xy_vel_d="MPC_XY_VEL_D_ACC",
            z_p="MPC_Z_P",
            z_vel_p="MPC_Z_VEL_P_ACC",
            z_vel_i="MPC_Z_VEL_I_ACC",
            tilt_max="MPC_TILTMAX_AIR",
            tilt_unit_deg=1.0,
        ),
        "mc_pos_control/PositionControl/PositionControl.cpp: _positionControl, _velocityControl "
        "(0.95; 1.8, 0.4, 0.2; z 1.0, 4.0, 2.0; 45 deg)",
    ),
    target_moves_on=Fact(False, "mavlink/mavlink_receiver.cpp: handle_message_set_position_target_local_ned"),
    target_shaped=Fact(
        False,
        "mc_pos_control/MulticopterPositionControl.cpp: Run (trajectory_setpoint as it came, within MPC_XY_VEL_MAX, "
        "MPC_Z_VEL_MAX_UP and _DN)",
    ),
    axes_mix=Fact(
        True,
        "mc_pos_control/PositionControl/PositionControl.cpp: _inputValid (x and y in pairs; else it stops after 0.2 s)",
    ),
    global_int_acceleration=Fact(True, "mavlink/mavlink_receiver.cpp: handle_message_set_position_target_global_int"),
    yaw_unset=Fact("where it points", "mc_pos_control/PositionControl/PositionControl.cpp: update"),
    circle_rms_m=Fact(
        {"position": 2.9, "position, velocity": 1.2, "position, velocity, acceleration": 1.2},
        "mc_pos_control/PositionControl/PositionControl.cpp: update (measured, against SIH_KDV 1)",
        used={"position": 2.3, "position, velocity": 0.64, "position, velocity, acceleration": 0.4},
        why="the F450 has a sixth of the drag of the quadrotor in PX4's own simulator",
    ),
    attitude_targets=Fact(
        {
            "attitude and rates": "flown",
            "attitude and one rate of three": "flown",
            "thrust ignored": "without thrust",
            "quaternion of length 1.01": "flown",
        },
        "mavlink/mavlink_receiver.cpp: handle_message_set_attitude_target (measured)",
    ),
    controllers_s=Fact(0.5, "commander/Commander.cpp: run (updateControlMode, with the status)"),
    failsafe_hold=Fact("COM_FAIL_ACT_T", "commander/failsafe/framework.cpp: FailsafeBase::getSelectedAction"),
    failsafe_land_pause_s=Fact(0.0, "navigator/land.cpp"),
    gcs_timeout=Fact("COM_DL_LOSS_T", "commander/Commander.cpp: dataLinkCheck (any ground station counts)"),
    gcs=Fact(
        Reactions("NAV_DLL_ACT", _PX4_LINK, Reaction.NONE),
        "commander/failsafe/failsafe.cpp: fromNavDllOrRclActParam (ignored in LAND and PRECLAND)",
    ),
    setpoints_lost=Fact(
        Reactions(
            "COM_OBL_RC_ACT",
            {
                0: Reaction.POSITION,
                1: Reaction.ALTITUDE,
                2: Reaction.STABILIZED,
                3: Reaction.RETURN,
                4: Reaction.LAND,
                5: Reaction.HOLD,
                6: Reaction.STOP,
                7: Reaction.STOP,
            },
            Reaction.POSITION,
        ),
        "commander/failsafe/failsafe.cpp: fromOffboardLossActParam, checkModeFallback; framework.cpp: modeCanRun "
        "(manual control is not looked at)",
    ),
    fence=Fact(
        Reactions(
            "GF_ACTION",
            {
                0: Reaction.NONE,
                1: Reaction.WARN,
                2: Reaction.HOLD,
                3: Reaction.RETURN,
                4: Reaction.STOP,
                5: Reaction.LAND,
            },
            Reaction.WARN,
        ),
        "commander/failsafe/failsafe.cpp: fromGfActParam",
    ),
    battery_low=Fact(
        Reactions("COM_LOW_BAT_ACT", {}, Reaction.WARN), "commander/failsafe/failsafe.cpp: fromBatteryWarningActParam"
    ),
    battery_critical=Fact(
        Reactions("COM_LOW_BAT_ACT", {1: Reaction.RETURN, 2: Reaction.LAND, 3: Reaction.RETURN}, Reaction.WARN),
        "commander/failsafe/failsafe.cpp: fromBatteryWarningActParam",
    ),
    battery_emergency=Fact(
        Reactions("COM_LOW_BAT_ACT", {1: Reaction.RETURN, 2: Reaction.LAND, 3: Reaction.LAND}, Reaction.WARN),
        "commander/failsafe/failsafe.cpp: fromBatteryWarningActParam",
    ),
    position_lost_s=Fact(5.0, "ekf2/module.yaml: EKF2_NOAID_TOUT (5 s)"),
    mission=Fact(
        MissionRules(
            retry_s=0.25,
            give_up_s=5.0,
            missions=500,
            fence=64,
            rally=32,
            with_place=frozenset({16, 17, 19, 21, 22, 31, 80, 84, 85, 195, 201, 4501})
            | FENCE_COMMANDS
            | {mav_cmd.NAV_RALLY_POINT},
            without_place=frozenset(
                {20, 93, 112, 114, 177, 178, 179, 187, 189, 196, 197, 200, 201, 203, 204, 205, 206, 211, 214}
                | {260, 530, 532, 534, 80, 1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000, 42600}
            ),
        ),
        "mavlink/mavlink_mission.h: MAVLINK_MISSION_*_TIMEOUT_DEFAULT; mavlink_mission.cpp: parse_mavlink_mission_item",
    ),
    altitude_step_m=Fact(0.0, "navigator/navigation.h: mission_item_s (float)"),
)
