"""A PX4 fixed wing as a ground station sees it (1.16): what differs from the multirotor of `px4`.

take-off    NAV_TAKEOFF: ahead, where its nose points, to the height; then it circles there in AUTO.LOITER
            (takeoff.cpp; fw_pos_control: control_auto_takeoff)
hold        a circle of NAV_LOITER_RAD about where it is (loiter.cpp: setLoiterItemFromCurrentPosition)
goto        to the place, and a circle about it (navigator_main.cpp: DO_REPOSITION)
return      to home at RTL_RETURN_ALT, and a circle there: RTL_LAND_DELAY is -1 (init.d/rc.fw_defaults)
land        down ahead of where it is (land.cpp)
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

from skygcs.sim import protocol as m
from skygcs.sim.behaviours import PX4, Fact
from skygcs.sim.conditions import Conditions
from skygcs.sim.courses import CoursePlan, Turning
from skygcs.sim.firmware_modes import Px4Mode
from skygcs.sim.firmware_params import px4_plane_params
from skygcs.sim.kinematics import Home, Limits, bounded_limits
from skygcs.sim.legs import ClimbOut, GoTo, Land
from skygcs.sim.param_table import Params
from skygcs.sim.px4 import Px4Vehicle
from skygcs.sim.wings_and_wheels import GLIDE_SLOPE, Wing, turn_limit_radps

LAND_AHEAD_M = 30.0
"""Least way to the ground of a landing where it is."""

PX4_PLANE = replace(
    PX4,
    spool_up_s=Fact(1.0, "commander/commander_params.c: COM_SPOOLUP_TIME"),
    landed_after_s=Fact(2.0, "land_detector/FixedwingLandDetector.cpp: LNDFW_TRIG_TIME"),
)


class Px4PlaneVehicle(Px4Vehicle):
    """A PX4 plane that takes off from its wheels, without a transmitter."""

    mav_type = m.MAV_TYPE_FIXED_WING
    looks = "plane"
    firmware = PX4_PLANE

    @staticmethod
    def factory_params(sysid: int) -> Params:
        return Params(px4_plane_params(sysid), bytewise=True)

    @staticmethod
    def make_body(conditions: Conditions, yaw_rad: float, seed: int) -> Wing:
        return Wing(yaw_rad)

    def make_plan(self) -> CoursePlan:
        return CoursePlan(lambda: self.estimated, lambda: Turning(self.params["NAV_ACC_RAD"], self.circle_m))

    @property
    def circle_m(self) -> float:
        """Radius of its circles; clockwise (mission_block.cpp: a negative one turns to the left)."""
        return self.params["NAV_LOITER_RAD"] or 80.0

    def limits(self) -> Limits:
        p = self.params
        speed = min(max(self.cruise_mps or p["FW_AIRSPD_TRIM"], p["FW_AIRSPD_MIN"]), p["FW_AIRSPD_MAX"])
        turn = turn_limit_radps(speed, radians(p["FW_R_LIM"]))
        return bounded_limits(speed, 2.0, p["FW_T_CLMB_R_SP"], p["FW_T_SINK_R_SP"], turn)

    def on_tick(self, now: float) -> None:
        climbed = isinstance(self.plan.leg, ClimbOut) and self.plan.arrived
        super().on_tick(now)
        if climbed and self.mode == Px4Mode.LOITER:
            self.hold_here()

    def hold_here(self) -> None:
        here = self.estimated
        self.plan.fly(*([] if self.landed else [GoTo(here.east_m, here.north_m, here.up_m)]))

    def land_at(self, east_m: float, north_m: float, speed_mps: float, *, not_before: float = 0.0) -> Land:
        """Ahead, as far as it glides: `Land.east_m` and `north_m` are where it comes to the ground."""
        here = self.estimated
        ahead_m = max(LAND_AHEAD_M, here.up_m / GLIDE_SLOPE)
        east_m, north_m = here.east_m + ahead_m * sin(here.yaw_rad), here.north_m + ahead_m * cos(here.yaw_rad)
        return super().land_at(east_m, north_m, speed_mps, not_before=not_before)

    def _return(self) -> None:
        """RtlDirect: to home at RTL_RETURN_ALT or as high as it is, and a circle there."""
        home = self.home or Home(*self.estimated.pos_enu_m)
        if self.landed:
            return
        up_m = max(self.estimated.up_m, home.up_m + self.params["RTL_RETURN_ALT"])
        self.say_event(m.MAV_SEVERITY_INFO, f"RTL: start return at {round(up_m - home.up_m)} m above home")
        self.plan.fly(GoTo(home.east_m, home.north_m, up_m))
