"""ArduPlane as a ground station sees it (4.6): TAKEOFF, GUIDED, LOITER, RTL, AUTO with its landing.

disarmed --TAKEOFF, arm--> roll and climb to TKOFF_ALT --there--> circles in TAKEOFF
any mode in the air --GUIDED + DO_REPOSITION--> to the place, and circles about it with WP_LOITER_RAD
LOITER: circles about where it was. RTL: to home at RTL_ALTITUDE, and circles there. It lands by its mission only:
DO_LAND_START goes to its landing and fails without one (GCS_Mavlink.cpp, handle_command_int_packet).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from math import radians

from skygcs.core.mavlink import mav_cmd
from skygcs.sim import protocol as m
from skygcs.sim.ardupilot import CourseVehicle
from skygcs.sim.behaviours import COPTER, Fact, HomeFollows, Reaction, Reactions
from skygcs.sim.command_message import Command
from skygcs.sim.conditions import Conditions
from skygcs.sim.copter_mission import CopterRun
from skygcs.sim.courses import CoursePlan, Turning
from skygcs.sim.firmware_modes import ModeRule
from skygcs.sim.firmware_params import plane_params
from skygcs.sim.kinematics import Limits, bounded_limits
from skygcs.sim.legs import ClimbOut, GoTo
from skygcs.sim.mission_run import MissionVehicle
from skygcs.sim.param_table import Params
from skygcs.sim.wings_and_wheels import Wing, turn_limit_radps


class PlaneMode(IntEnum):
    """HEARTBEAT.custom_mode (ArduPlane/mode.h: Mode::Number), without those of QuadPlanes."""

    MANUAL = 0
    CIRCLE = 1
    STABILIZE = 2
    TRAINING = 3
    ACRO = 4
    FBWA = 5
    FBWB = 6
    CRUISE = 7
    AUTOTUNE = 8
    AUTO = 10
    RTL = 11
    LOITER = 12
    TAKEOFF = 13
    AVOID_ADSB = 14
    GUIDED = 15
    THERMAL = 24


_GOES = frozenset({"AUTO", "RTL", "LOITER", "TAKEOFF", "GUIDED", "CIRCLE", "THERMAL", "AVOID_ADSB"})
"""MAV_MODE_FLAG_GUIDED_ENABLED (GCS_MAVLINK_Plane::base_mode)."""

PLANE_RULES = {
    mode.value: ModeRule(
        mode,
        arms=mode.name != "RTL",
        autopilot=mode.name in _GOES,
        guided=mode.name in _GOES,
        by_command=mode.name not in ("THERMAL", "AVOID_ADSB"),
    )
    for mode in PlaneMode
}

LAND_START = frozenset({mav_cmd.DO_LAND_START})

PLANE = replace(
    COPTER,
    name="ArduPlane",
    modes=Fact(PLANE_RULES, "ArduPlane/mode.h: _pre_arm_checks (of a fixed wing RTL alone does not arm)"),
    idle_disarm=Fact(("", 0.0), "ArduPlane has no DISARM_DELAY: it stays armed on the ground until it has landed"),
    home_follows=Fact(
        HomeFollows(5.0, 0.0, 0.0),
        "ArduPlane/ArduPlane.cpp: one_second_loop; commands.cpp: update_home (HOME_RESET_ALT 0)",
    ),
    spool_up_s=Fact(0.0, "ArduPlane/servos.cpp: suppress_throttle (a take-off starts by TKOFF_THR_MINACC 0 at once)"),
    landed_after_s=Fact(5.0, "ArduPlane/is_flying.cpp: update_is_flying_5Hz (isFlyingProbability below 0.1)"),
    crash=Fact((0.0, 0.0, 0.0, 0.0), "ArduPlane/is_flying.cpp: CRASH_DETECT 0"),
    gcs=Fact(
        Reactions("FS_GCS_ENABL", {0: Reaction.NONE}, Reaction.RETURN),
        "ArduPlane/events.cpp: failsafe_long_on_event",
        used=Reactions("FS_GCS_ENABL", {0: Reaction.NONE}, Reaction.RETURN),
        why="as with FS_LONG_ACTN 1; with 0 it goes on in the modes that fly by themselves",
    ),
    gcs_timeout=Fact("FS_LONG_TIMEOUT", "ArduPlane/system.cpp: check_long_failsafe"),
    fence=Fact(
        Reactions("FENCE_ACTION", {0: Reaction.WARN, 1: Reaction.RETURN}, Reaction.RETURN),
        "ArduPlane/fence.cpp: Plane::fence_check (GUIDED to the return point, or RTL)",
    ),
    battery_low=Fact(
        Reactions("BATT_FS_LOW_ACT", {0: Reaction.NONE, 1: Reaction.RETURN}, Reaction.RETURN),
        "ArduPlane/events.cpp: handle_battery_failsafe",
    ),
    battery_critical=Fact(
        Reactions("BATT_FS_CRT_ACT", {0: Reaction.NONE, 1: Reaction.RETURN}, Reaction.RETURN),
        "ArduPlane/events.cpp: handle_battery_failsafe",
    ),
)

_REACTION_MODES: Mapping[Reaction, PlaneMode] = {
    Reaction.BRAKE: PlaneMode.LOITER,
    Reaction.RETURN: PlaneMode.RTL,
    Reaction.SMART_RETURN: PlaneMode.RTL,
    Reaction.LAND: PlaneMode.FBWA,  # without a position it glides with its wings level
}


class PlaneRun(CopterRun):
    """A mission as ArduPlane flies it: a take-off climbs out, a landing glides."""

    def why_not_auto(self, v: MissionVehicle) -> str:
        """ModeAuto::_enter asks a QuadPlane only; see `PlaneVehicle.begin`."""
        return ""

    def takeoff_mps(self, v: MissionVehicle) -> float | None:
        return 0.0

    def land_mps(self, v: MissionVehicle) -> float:
        return 0.0  # its glide has a slope of its own

    def finish(self, v: MissionVehicle, now: float) -> None:
        """Behind its last item it returns (Plane::exit_mission_callback); at its end on the ground it stands."""
        if v.estimated.on_ground:
            v.plan.fly()
        else:
            self._copter.try_mode(PlaneMode.RTL, now)

    def jump_to_landing(self, v: MissionVehicle, now: float) -> bool:
        """Go on at the first DO_LAND_START (AP_Mission::jump_to_landing_sequence takes the nearest one)."""
        for seq, item in enumerate(v.lists.mission):
            if item.command in LAND_START:
                return self.set_current(v, seq + self.first_seq, now)
        return False


class PlaneVehicle(CourseVehicle):
    """An ArduPlane without sticks, which stands on its wheels in the wind's eye."""

    run: PlaneRun
    mav_type = m.MAV_TYPE_FIXED_WING
    looks = "plane"
    firmware = PLANE
    mode_names = PlaneMode
    first_mode = PlaneMode.MANUAL  # INITIAL_MODE 0
    boot_texts = ("ArduPlane V4.6.3 (skygcs01)", "EKF3 IMU0 initialised", "AHRS: EKF3 active")
    reaction_modes = _REACTION_MODES
    not_supported = frozenset({m.MAV_CMD_NAV_LAND, m.MAV_CMD_CONDITION_YAW})

    @staticmethod
    def factory_params(sysid: int) -> Params:
        return Params(plane_params(sysid), bytewise=False)

    @staticmethod
    def make_body(conditions: Conditions, yaw_rad: float, seed: int) -> Wing:
        return Wing(yaw_rad)

    def make_plan(self) -> CoursePlan:
        return CoursePlan(lambda: self.estimated, lambda: Turning(self.params["WP_RADIUS"], self.circle_m))

    def make_run(self) -> PlaneRun:
        return PlaneRun(self)

    @property
    def circle_m(self) -> float:
        """Radius of its circles, positive clockwise (Plane::update_loiter: a small one is the default, 60 m)."""
        radius = self.params["WP_LOITER_RAD"]
        return radius if abs(radius) > 1 else 60.0

    def limits(self) -> Limits:
        p = self.params
        speed = min(max(self.speed_mps or p["AIRSPEED_CRUISE"], p["AIRSPEED_MIN"]), p["AIRSPEED_MAX"])
        bank = radians(p["ROLL_LIMIT_DEG"])
        return bounded_limits(speed, 2.0, p["TECS_CLMB_MAX"], p["TECS_SINK_MAX"], turn_limit_radps(speed, bank))

    def on_tick(self, now: float) -> None:
        climbed = isinstance(self.plan.leg, ClimbOut) and self.plan.arrived
        super().on_tick(now)
        if climbed and self.mode == PlaneMode.TAKEOFF:
            self.hold_here()  # at its height or TKOFF_DIST ahead it circles

    def begin(self, mode: IntEnum, now: float) -> None:
        if mode == PlaneMode.TAKEOFF and self.armed and self.landed:
            self._take_off()
        elif mode == PlaneMode.RTL and not self.landed and self.home is not None:
            self.fly_home()
        elif mode == PlaneMode.AUTO and not self.lists.mission:  # Plane::exit_mission_callback
            self.tx.say(m.MAV_SEVERITY_INFO, "Mission complete, changing mode to RTL")
            self.enter(PlaneMode.RTL, now)
        elif mode == PlaneMode.AUTO and self.armed:
            self.run.begin(self, now)
        else:
            self.hold_here()

    def _take_off(self) -> None:
        """ModeTakeoff::update: straight ahead to TKOFF_ALT above where it stands."""
        here = self.estimated
        self.taking_off = True
        self.plan.fly(GoTo(here.east_m, here.north_m, here.up_m + self.params["TKOFF_ALT"], climb_mps=0.0))

    def hold_here(self) -> None:
        """Circle about where it is (ModeLoiter, ModeGuided::_enter); on the ground it stands."""
        here = self.estimated
        self.plan.fly(*([] if self.landed else [GoTo(here.east_m, here.north_m, here.up_m)]))

    def fly_home(self) -> None:
        """ModeRTL: to home at RTL_ALTITUDE above it (-1: as high as it is), and circle there."""
        home = self.home
        if home is not None:
            wanted = self.params["RTL_ALTITUDE"]
            up_m = self.estimated.up_m if wanted < 0 else home.up_m + wanted
            self.plan.fly(GoTo(home.east_m, home.north_m, up_m))

    def arm(self, now: float) -> None:
        super().arm(now)
        if self.mode in (PlaneMode.TAKEOFF, PlaneMode.AUTO):
            self.begin(PlaneMode(self.mode), now)

    def on_landed(self, now: float) -> None:
        """AP_Landing disarms it LAND_DISARMDELAY after the landing of a mission."""
        if self.armed and self.flown_since_arming and self.mode == PlaneMode.AUTO:
            still = self.armed_at
            after_s = self.params["LAND_DISARMDELAY"]
            self.later(now + after_s, lambda: self.switch_off() if self.armed_at == still and self.landed else None)

    def command(self, c: Command, now: float) -> int | None:
        match c.id:
            case m.MAV_CMD_NAV_TAKEOFF:
                return m.MAV_RESULT_FAILED  # a QuadPlane's (handle_command_MAV_CMD_NAV_TAKEOFF)
            case mav_cmd.DO_LAND_START:
                found = self.run.jump_to_landing(self, now)
                return self._accepted_if(found and self.try_mode(PlaneMode.AUTO, now))
            case m.MAV_CMD_MISSION_START:
                self.try_mode(PlaneMode.AUTO, now)
                return m.MAV_RESULT_ACCEPTED  # whether or not it could
            case _:
                return super().command(c, now)

    def _mode_refusal(self) -> str | None:
        return None if self.mode_rule.arms else f"{self.mode_names(self.mode).name} mode not armable"
