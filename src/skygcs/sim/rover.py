"""ArduPilot's Rover as a ground station sees it (4.6): modes, GUIDED, AUTO, RTL. Values beside their sources below.

disarmed --arm--> standing --GUIDED + DO_REPOSITION, AUTO, RTL--> under way --at the place, HOLD--> standing
It never takes off or lands: NAV_TAKEOFF and NAV_LAND are not among its commands (Rover/GCS_Mavlink.cpp,
handle_command_int_packet). It shows no landed state, and MAV_STATE_ACTIVE in every mode but HOLD, moving or not
(vehicle_system_status).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from math import inf

from skygcs.sim import protocol as m
from skygcs.sim.ardupilot import CourseVehicle
from skygcs.sim.behaviours import COPTER, Fact, HomeFollows, Reaction, Reactions
from skygcs.sim.command_message import Command
from skygcs.sim.conditions import Conditions
from skygcs.sim.courses import CoursePlan, Turning
from skygcs.sim.firmware_modes import ModeRule
from skygcs.sim.firmware_params import rover_params
from skygcs.sim.kinematics import Limits, bounded_limits
from skygcs.sim.legs import GoTo
from skygcs.sim.param_table import Params
from skygcs.sim.wings_and_wheels import SIDE_MPS2, Rover


class RoverMode(IntEnum):
    """HEARTBEAT.custom_mode (Rover/mode.h: Mode::Number)."""

    MANUAL = 0
    ACRO = 1
    STEERING = 3
    HOLD = 4
    LOITER = 5
    FOLLOW = 6
    SIMPLE = 7
    DOCK = 8
    CIRCLE = 9
    AUTO = 10
    RTL = 11
    SMART_RTL = 12
    GUIDED = 15


_GOES = frozenset({"AUTO", "CIRCLE", "GUIDED", "LOITER", "RTL", "SMART_RTL", "FOLLOW", "DOCK"})
"""is_autopilot_mode()."""
_WITHOUT_POSITION = frozenset({"HOLD", "MANUAL", "ACRO", "STEERING"})
"""requires_position() is false."""
_NOT_ARMED_IN = frozenset({"RTL", "SMART_RTL"})
"""allows_arming() is false."""
_NEVER = frozenset({"FOLLOW", "DOCK", "CIRCLE", "SMART_RTL"})
"""Their enter fails without what they need: a target, a beacon, a set-up circle, a recorded way."""

ROVER_RULES = {
    mode.value: ModeRule(
        mode,
        arms=mode.name not in _NOT_ARMED_IN,
        position=mode.name not in _WITHOUT_POSITION,
        autopilot=mode.name in _GOES,
        guided=mode.name in _GOES,
        by_command=mode.name not in _NEVER,
    )
    for mode in RoverMode
}

_LINK = {0: Reaction.NONE, 1: Reaction.BRAKE, 2: Reaction.NONE}

ROVER = replace(
    COPTER,
    name="Rover",
    modes=Fact(
        ROVER_RULES,
        "Rover/mode.h: is_autopilot_mode, requires_position, allows_arming; mode.cpp: Mode::enter (anything while "
        "disarmed)",
    ),
    idle_disarm=Fact(("", 0.0), "Rover has no DISARM_DELAY: it stays armed"),
    home_follows=Fact(
        HomeFollows(1.0, 0.5, inf),
        "Rover/Rover.cpp: one_second_loop; commands.cpp: update_home (DISTANCE_HOME_MINCHANGE)",
    ),
    spool_up_s=Fact(0.0, "Rover/AP_Arming.cpp: AP_Arming_Rover::arm"),
    crash=Fact((0.0, 0.0, 0.0, 0.0), "Rover/crash_check.cpp: FS_CRASH_CHECK 0"),
    gcs=Fact(
        Reactions("FS_GCS_ENABLE", _LINK, Reaction.NONE),
        "Rover/failsafe.cpp: Rover::failsafe_trigger (FS_ACTION 2: HOLD; FS_GCS_ENABLE 2 goes on in AUTO)",
    ),
    fence=Fact(
        Reactions("FENCE_ACTION", {0: Reaction.WARN, 1: Reaction.RETURN, 2: Reaction.BRAKE}, Reaction.BRAKE),
        "Rover/fence.cpp: Rover::fence_check",
    ),
    battery_low=Fact(
        Reactions("BATT_FS_LOW_ACT", {0: Reaction.NONE, 1: Reaction.RETURN, 2: Reaction.BRAKE}, Reaction.BRAKE),
        "Rover/failsafe.cpp: Rover::handle_battery_failsafe",
    ),
    battery_critical=Fact(
        Reactions("BATT_FS_CRT_ACT", {0: Reaction.NONE, 1: Reaction.RETURN, 2: Reaction.BRAKE}, Reaction.BRAKE),
        "Rover/failsafe.cpp: Rover::handle_battery_failsafe",
    ),
)

_REACTION_MODES: Mapping[Reaction, RoverMode] = {
    Reaction.BRAKE: RoverMode.HOLD,
    Reaction.RETURN: RoverMode.RTL,
    Reaction.SMART_RETURN: RoverMode.RTL,
    Reaction.LAND: RoverMode.HOLD,  # FS_EKF_ACTION 1: Rover/ekf_check.cpp
}


class RoverVehicle(CourseVehicle):
    """A Rover on wheels, without sticks."""

    mav_type = m.MAV_TYPE_GROUND_ROVER
    looks = "rover"
    flies = False
    firmware = ROVER
    mode_names = RoverMode
    first_mode = RoverMode.MANUAL  # INITIAL_MODE 0
    boot_texts = ("ArduRover V4.6.3 (skygcs01)", "EKF3 IMU0 initialised", "AHRS: EKF3 active")
    reaction_modes = _REACTION_MODES
    not_supported = frozenset({m.MAV_CMD_NAV_TAKEOFF, m.MAV_CMD_NAV_LAND, m.MAV_CMD_CONDITION_YAW})
    guided_place: GoTo | None = None
    """Goal in GUIDED, kept until the mode is left: a rover that is disarmed on its way and armed again drives on."""

    @staticmethod
    def factory_params(sysid: int) -> Params:
        return Params(rover_params(sysid), bytewise=False)

    @staticmethod
    def make_body(conditions: Conditions, yaw_rad: float, seed: int) -> Rover:
        return Rover(yaw_rad)

    def make_plan(self) -> CoursePlan:
        return CoursePlan(lambda: self.estimated, lambda: Turning(max(0.1, self.params["WP_RADIUS"])))

    @property
    def base_mode(self) -> int:
        flags = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if self.mode_rule.autopilot:
            flags |= m.MAV_MODE_FLAG_GUIDED_ENABLED
        else:
            flags |= m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        return flags | (m.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return m.MAV_STATE_CRITICAL
        return m.MAV_STATE_STANDBY if self.mode == RoverMode.HOLD else m.MAV_STATE_ACTIVE

    @property
    def landed_state(self) -> int:
        return m.MAV_LANDED_STATE_UNDEFINED

    def limits(self) -> Limits:
        p = self.params
        fastest = self.speed_mps or p["WP_SPEED"]
        return bounded_limits(fastest, p["ATC_ACCEL_MAX"], 1.0, 1.0, SIDE_MPS2 / max(1.0, fastest))

    def go_to(self, east_m: float, north_m: float, up_m: float) -> None:
        super().go_to(east_m, north_m, up_m)
        self.guided_place = GoTo(east_m, north_m, up_m)

    def begin(self, mode: IntEnum, now: float) -> None:
        self.guided_place = None
        if mode == RoverMode.RTL and self.armed and self.home is not None:
            self.fly_home()
        elif mode == RoverMode.AUTO and self.armed:
            self.run.begin(self, now)
        else:
            self.hold_here()

    def hold_here(self) -> None:
        """Brake and stand: HOLD, and LOITER of what stands within LOIT_RADIUS."""
        self.plan.fly()

    def fly_home(self) -> None:
        """ModeRTL: to home at RTL_SPEED (0: WP_SPEED), and stand there."""
        if self.home is not None:
            self.plan.fly(GoTo(self.home.east_m, self.home.north_m, 0.0))

    def arm(self, now: float) -> None:
        super().arm(now)
        self.landed = False
        if self.mode in (RoverMode.RTL, RoverMode.AUTO):
            self.begin(RoverMode(self.mode), now)
        elif self.mode == RoverMode.GUIDED and self.guided_place is not None:  # ModeGuided::update
            self.plan.fly(self.guided_place)

    def _mode_refusal(self) -> str | None:
        return None if self.mode_rule.arms else "Mode not armable"

    def _command_arm(self, c: Command, now: float) -> int | None:
        """AP_Arming_Rover::disarm asks nothing: it stops where it is."""
        if c.p1 == 0.0 and self.armed:
            self.switch_off()
            return m.MAV_RESULT_ACCEPTED
        return super()._command_arm(c, now)
