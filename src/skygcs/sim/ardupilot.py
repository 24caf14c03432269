"""ArduCopter as a ground station sees it (4.6): modes, arming checks, refusals, GUIDED, streams by SRx groups. Values:
`behaviours`.

disarmed --arm--> armed on ground --GUIDED + NAV_TAKEOFF--> in air --LAND/RTL--> touch --2 s--> disarmed
armed on ground for DISARM_DELAY: disarmed
GUIDED: flies to the last position target; a velocity target lasts GUID_TIMEOUT, then it stops
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from functools import partial
from math import hypot, isfinite, radians
from typing import Any

from skygcs.core.mavlink.modes import COPTER_AUTO_ARMABLE
from skygcs.core.mission.item import MissionItem
from skygcs.sim import copter_sticks, failsafe
from skygcs.sim import protocol as m
from skygcs.sim.battery import CAPACITY_MAH
from skygcs.sim.behaviours import COPTER, Reaction
from skygcs.sim.body import Vector
from skygcs.sim.command_message import Command
from skygcs.sim.copter_files import FileServer
from skygcs.sim.copter_guided import GuidedTargets
from skygcs.sim.copter_lists import CopterLists
from skygcs.sim.copter_mission import CopterRun
from skygcs.sim.copter_position_control import CopterPositionControl
from skygcs.sim.firmware_modes import CopterMode
from skygcs.sim.firmware_params import STREAM_GROUPS, copter_params
from skygcs.sim.kinematics import Home, Limits, bounded_limits
from skygcs.sim.legs import Descend, GoTo, Land, Leg, Wait
from skygcs.sim.param_table import Params
from skygcs.sim.position_control import ControlGains
from skygcs.sim.position_targets import is_altitude, is_position, up_of
from skygcs.sim.requests import common_command
from skygcs.sim.vehicle import SimVehicle

FORCE = 21196
"""Magic of MAV_CMD_COMPONENT_ARM_DISARM.param2: no checks."""

LEAST_CONE_SLOPE = 0.5
"""RTL_MIN_CONE_SLOPE (ArduCopter/config.h)."""

MOST_LEAN_CDEG = 3000
"""Without ANGLE_MAX, which is a copter's."""

PREARM_EVERY_S = 30.0
"""Failing pre-arm checks are reported this often."""

BOOT_TEXTS = ("ArduCopter V4.6.3 (skygcs01)", "Frame: QUAD/X", "EKF3 IMU0 initialised", "AHRS: EKF3 active")
"""Ground stations read the firmware and its version from the first."""

BREACH_TEXTS = {
    "height": "Max Alt fence breached",
    "distance": "Circle fence breached",
    "polygon": "Polygon fence breached",
}

_REACTION_MODES: Mapping[Reaction, CopterMode] = {
    Reaction.BRAKE: CopterMode.BRAKE,
    Reaction.RETURN: CopterMode.RTL,
    Reaction.SMART_RETURN: CopterMode.SMART_RTL,
    Reaction.LAND: CopterMode.LAND,
}


class CopterVehicle(SimVehicle):
    """An ArduCopter quadrotor."""

    run: CopterRun
    autopilot = m.MAV_AUTOPILOT_ARDUPILOTMEGA
    vtol_state = m.MAV_VTOL_STATE_MC
    firmware = COPTER
    default_rates_hz = {"HEARTBEAT": 1.0}  # noqa: RUF012  a constant; the SR1_ parameters say the rest
    sysid_param = "SYSID_THISMAV"
    can_sign = True
    named_param_index = 65535
    renumbers_at_once = False
    """True if a new system id takes effect when it is set: GCS::update_send from 4.7 on; before, GCS::init reads it."""
    attitude_timeout_s: float | None = COPTER.attitude_timeout_s.simulated
    """None: GUID_TIMEOUT (3 s), as from 4.1 on; before, GUIDED_ATTITUDE_TIMEOUT_MS: 1 s."""
    mode_names: type[IntEnum] = CopterMode
    """Modes of the program; AUTO, GUIDED and RTL are among them in all of ArduPilot's."""
    first_mode: int = CopterMode.STABILIZE
    boot_texts: tuple[str, ...] = BOOT_TEXTS
    reaction_modes: Mapping[Reaction, IntEnum] = _REACTION_MODES
    landing_modes: frozenset[int] = frozenset({CopterMode.LAND, CopterMode.RTL, CopterMode.SMART_RTL})
    """Modes in which it disarms once it has landed."""
    not_supported: frozenset[int] = frozenset()
    """Commands of ArduCopter that the program has not."""

    @property
    def auto_mode(self) -> int:
        """The mode that flies its mission."""
        return self.mode_names["AUTO"].value

    @property
    def guided_mode(self) -> int:
        """The mode in which it goes where it is sent."""
        return self.mode_names["GUIDED"].value

    @staticmethod
    def factory_params(sysid: int) -> Params:
        return Params(copter_params(sysid), bytewise=False)

    @staticmethod
    def make_position_control(gains: ControlGains) -> CopterPositionControl:
        return CopterPositionControl(gains)

    # -- what it says of itself

    @property
    def by_vision(self) -> bool:
        return self.params["VISO_TYPE"] == 1 and self.params["EK3_SRC1_POSXY"] == 6

    @property
    def low_battery_percent(self) -> float:
        return 100 * self.params["BATT_LOW_MAH"] / CAPACITY_MAH

    @property
    def base_mode(self) -> int:
        flags = (
            m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | m.MAV_MODE_FLAG_STABILIZE_ENABLED
            | m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        )
        if self.mode_rule.guided:
            flags |= m.MAV_MODE_FLAG_GUIDED_ENABLED
        return flags | (m.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return m.MAV_STATE_CRITICAL
        return m.MAV_STATE_STANDBY if self.landed else m.MAV_STATE_ACTIVE

    @property
    def version(self) -> dict[str, Any]:
        return {
            "capabilities": m.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            | m.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | m.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | m.MAV_PROTOCOL_CAPABILITY_FTP
            | m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
            | m.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
            | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
            | m.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
            "flight_sw_version": 4 << 24 | 6 << 16 | 3 << 8 | m.FIRMWARE_VERSION_TYPE_OFFICIAL,
            "board_version": 140 << 16,
            "flight_custom_version": list(b"skygcs01"),
            "uid": 0x4150430000000000 | self.sysid,
        }

    def limits(self) -> Limits:
        p = self.params
        braking, _, _ = self.firmware.brake.simulated
        accel, unit_mps2 = self.firmware.climb_accel.simulated
        return bounded_limits(
            speed_mps=self.speed_mps or p["WPNAV_SPEED"] / 100,
            accel_mps2=braking if self.mode == CopterMode.BRAKE else p["WPNAV_ACCEL"] / 100,
            climb_mps=p["WPNAV_SPEED_UP"] / 100,
            descent_mps=copter_sticks.descent_mps(self.mode) or p["WPNAV_SPEED_DN"] / 100,
            yaw_rate_radps=radians(60),
            climb_accel_mps2=p[accel] * unit_mps2,
        )

    def arming_refusal(self) -> str | None:
        """Why it would not arm now, None if it would. A missing position is no check that ARMING_CHECK turns off."""
        if self.faults.refuse_arming:
            return self.faults.refuse_arming
        p = self.params
        if not self.position_ok:
            if self.mode_rule.position or self.firmware.arming_needs_position.simulated:
                return "Need Position Estimate"
            if p["FENCE_ENABLE"] and int(p["FENCE_TYPE"]) & (failsafe.FENCE_CIRCLE | failsafe.FENCE_POLYGON):
                return "Fence enabled, need position estimate"
        if not p["ARMING_CHECK"]:
            return None
        if self.motion.lean_deg > (p.get("ANGLE_MAX") or MOST_LEAN_CDEG) / 100:
            return "Leaning"
        low, critical, _ = self.battery_levels()
        return "Battery 1 low capacity failsafe" if low or critical else None

    def battery_levels(self) -> tuple[bool, bool, bool]:
        left_mah = CAPACITY_MAH - self.battery.used_mah
        low, critical = self.params["BATT_LOW_MAH"], self.params["BATT_CRT_MAH"]
        return 0 < low >= left_mah, 0 < critical >= left_mah, False

    @property
    def setpoints_expected(self) -> bool:
        return False  # in GUIDED a stream that ceases ends in a stop, without a failsafe

    @property
    def needs_position(self) -> bool:
        return self.mode_rule.position

    def breach(self, east_m: float, north_m: float, up_m: float) -> str:
        return failsafe.copter_breach(self, east_m, north_m, up_m)

    def too_far_beyond(self, breach: str) -> bool:
        home = self.home
        if home is None or breach == "height":
            return False
        return self.estimated.distance_m(*home.pos_enu_m) > self.params["FENCE_RADIUS"] + failsafe.GIVE_UP_M

    @property
    def fence_flags(self) -> tuple[bool, bool, bool]:
        # AC_Fence::sys_status_present, _enabled and _failed: one that is off is present and healthy
        present = failsafe.copter_fence_present(self)
        enabled = present and bool(self.params["FENCE_ENABLE"]) and self.params["FENCE_ACTION"] != 0
        return present, enabled, not present or self.fence_breach == m.FENCE_BREACH_NONE

    def make_lists(self) -> tuple[CopterLists, CopterRun]:
        self.run = run = self.make_run()
        return CopterLists(lambda: run.changed(self), self.guided_waypoint), run

    def make_run(self) -> CopterRun:
        """Return what flies its missions."""
        return CopterRun(self)

    # -- life

    def on_boot(self, now: float) -> None:
        self.mode: int = self.first_mode
        self.files = FileServer()
        self.failsafe = False
        self.speed_mps = 0.0
        self.setpoint_at = now
        self.guided = GuidedTargets()
        self._prearm_at = now + 3.0
        for stream, (param, _) in STREAM_GROUPS.items():
            self._set_group(stream, self.params[param], now)
        self._report_banner(now)

    def _report_banner(self, now: float) -> None:
        for i, text in enumerate(self.boot_texts):
            self.later(now + 0.3 + 0.4 * i, partial(self.tx.say, m.MAV_SEVERITY_INFO, text))

    def on_ready(self, now: float) -> None:
        self.tx.say(m.MAV_SEVERITY_INFO, "EKF3 IMU0 origin set")
        used = "external nav data" if self.by_vision else "GPS"
        self.tx.say(m.MAV_SEVERITY_INFO, f"EKF3 IMU0 is using {used}")
        self.send_soon("GPS_GLOBAL_ORIGIN")

    def on_file_transfer(self, payload: bytes, sender: tuple[int, int], now: float) -> None:
        self.files.hear(self, payload, sender, now)

    def on_tick(self, now: float) -> None:
        self.files.step(self, now)
        if not self.armed and now >= self._prearm_at:
            self._prearm_at = now + PREARM_EVERY_S
            self._report_prearm()
        if self.taking_off and self.plan.arrived and self.mode != self.auto_mode:
            self.taking_off = False
        if self.mode == self.auto_mode and self.armed:
            self.run.step(self, now)
        self.guided.watch(self, now, self.attitude_timeout_s)
        failsafe.watch(self, now)
        name, more_s = self.firmware.idle_disarm.simulated
        delay = self.params[name] + more_s if name else 0.0
        if self.armed and self.landed and not self.taking_off and delay > 0:
            since = max(self.armed_at, self.landed_at)
            if now - since >= delay:
                self.switch_off()

    def _report_prearm(self) -> None:
        refusal = self.arming_refusal()
        if refusal is not None:
            self.tx.say(m.MAV_SEVERITY_CRITICAL, f"PreArm: {refusal}")

    def switch_off(self, reason: str = "") -> None:
        self.disarm()
        self.failsafe = False
        self.tx.say(m.MAV_SEVERITY_INFO, "Disarming motors")

    # -- failsafes

    def say_failsafe(self, reason: str, reaction: Reaction) -> None:
        if reason == "position lost":
            self.tx.say(m.MAV_SEVERITY_CRITICAL, "EKF Failsafe: changed to LAND Mode")
        elif "battery" in reason:
            self.tx.say(m.MAV_SEVERITY_WARNING, "Battery Failsafe")

    def say_battery(self, level: str) -> None:
        battery, word = self.battery, "low" if level == "low battery" else "critical"
        text = f"Battery 1 is {word} {battery.volts:.1f}V used {battery.used_mah:.0f} mAh"
        self.tx.say(m.MAV_SEVERITY_WARNING, text)

    def say_breach(self, breach: str) -> None:
        if not self.landed:
            self.tx.say(m.MAV_SEVERITY_WARNING, BREACH_TEXTS[breach])

    def say_gcs_is_back(self) -> None:
        self.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe Cleared")

    def carry_out(self, reaction: Reaction, now: float) -> None:
        """Change to the mode, to LAND where it is impossible; on the ground: disarm."""
        if reaction is Reaction.WARN:
            return
        if self.landed or reaction is Reaction.STOP:
            self.switch_off()
            return
        mode, last = self.reaction_modes[reaction], self.reaction_modes[Reaction.LAND]
        if self.firmware.modes.simulated[mode].position and not self.position_ok:
            mode = last
        if self.mode == last and self.failsafe:
            return  # a landing that a failsafe has begun goes on
        self.enter(mode, now)
        leg = self.plan.leg
        pause_s = self.firmware.failsafe_land_pause_s.simulated
        if mode == last and isinstance(leg, Land | Descend) and pause_s > 0.0:
            self.plan.fly(replace(leg, not_before=now + pause_s))
        self.failsafe = True

    def on_takeoff(self, now: float) -> None:
        return  # ArduCopter says nothing

    def on_landed(self, now: float) -> None:
        lands = self.mode in self.landing_modes or self.run.landing
        if lands and self.armed:
            self.switch_off()

    def on_gcs_heartbeat(self, sender: tuple[int, int], now: float) -> None:
        if sender[0] == int(self.params["SYSID_MYGCS"]):
            self.failsafes.gcs_heard_at = now

    # -- modes

    def try_mode(self, number: int, now: float) -> bool:
        """Change the mode if ArduCopter would; a disarmed vehicle takes any mode it has."""
        if number not in self.firmware.modes.simulated:
            self.tx.say(m.MAV_SEVERITY_WARNING, f"No such mode {number}")
            return False
        mode = self.mode_names(number)
        reason = self.faults.refuse_mode
        if not reason and self.armed and mode == self.auto_mode and mode != self.mode:
            reason = self.run.why_not_auto(self)
        rule = self.firmware.modes.simulated[mode]
        if not reason and self.armed and mode != self.mode and rule.position and not self.position_ok:
            reason = "requires position"
        if not reason and not rule.by_command:
            reason = "init failed"
        if reason:
            self.tx.say(m.MAV_SEVERITY_WARNING, f"Mode change to {mode.name} failed: {reason}")
            return False
        self.enter(mode, now)
        return True

    def enter(self, mode: IntEnum, now: float) -> None:
        """Be in this mode and begin what it does."""
        if mode == self.mode:
            return
        if self.mode == self.auto_mode:
            self.run.leave()
        self.mode = mode
        self.failsafe = False
        self.taking_off = False
        self.guided.forget()
        self.send_soon("HEARTBEAT")  # a mode change is reported at once
        self.begin(mode, now)

    def begin(self, mode: IntEnum, now: float) -> None:
        """Begin what this mode does."""
        motion = self.estimated
        if mode == CopterMode.LAND:
            speed = self.params["LAND_SPEED"] / 100
            here = self.land_at(motion.east_m, motion.north_m, speed)
            self.plan.fly(here if self.position_ok else Descend(speed))
        elif mode in (CopterMode.RTL, CopterMode.SMART_RTL) and not self.landed and self.home is not None:
            self.fly_home()
        elif mode == CopterMode.AUTO and self.armed:
            self.run.begin(self, now)
        elif self.landed or not copter_sticks.begin(self, CopterMode(mode)):
            self.hold_here()

    def fly_home(self) -> None:
        """Climb, go there, wait, and down as far as RTL_ALT_FINAL says."""
        motion, home, p = self.estimated, self.home or Home(*self.estimated.pos_enu_m), self.params
        up = max(home.up_m + p["RTL_ALT"] / 100, motion.up_m)
        if p["RTL_CONE_SLOPE"] >= LEAST_CONE_SLOPE:  # ModeRTL::compute_return_target: close to home it climbs less
            away = hypot(motion.east_m - home.east_m, motion.north_m - home.north_m)
            up = min(up, max(home.up_m + away * p["RTL_CONE_SLOPE"], motion.up_m))
        legs: list[Leg] = [GoTo(motion.east_m, motion.north_m, up), GoTo(home.east_m, home.north_m, up)]
        legs.append(Wait(p["RTL_LOIT_TIME"] / 1000))
        final = p["RTL_ALT_FINAL"] / 100
        if final > 0:
            legs.append(GoTo(home.east_m, home.north_m, home.up_m + final))
        else:
            legs.append(self.land_at(home.east_m, home.north_m, p["LAND_SPEED"] / 100))
        self.plan.fly(*legs)

    def on_set_mode_message(self, custom_mode: int, sender: tuple[int, int], now: float) -> None:
        self.try_mode(custom_mode, now)  # SET_MODE is not acknowledged

    def on_setpoint(self, name: str, fields: dict[str, Any], now: float) -> None:
        self.guided.take(self, name, fields, now)

    def reported_target_enu_m(self) -> Vector | None:
        if self.mode == CopterMode.GUIDED:
            return self.guided.place_enu_m
        leg = self.plan.leg
        if self.mode not in (CopterMode.AUTO, CopterMode.RTL) or not isinstance(leg, GoTo):
            return None
        return leg.east_m, leg.north_m, leg.up_m

    # -- streams

    def on_data_stream(self, stream: int, rate_hz: float, now: float) -> None:
        for group in STREAM_GROUPS:  # the SR1_ parameters stay: after a reboot the rates are theirs again
            if stream in (group, m.MAV_DATA_STREAM_ALL):
                self._set_group(group, rate_hz, now)

    def on_param(self, name: str, now: float) -> None:
        if name == self.sysid_param and self.renumbers_at_once:
            self.sysid = self.tx.sysid = self.sysid_of_params()
        for stream, (param, _) in STREAM_GROUPS.items():
            if param == name:
                self._set_group(stream, self.params[param], now)

    def _set_group(self, stream: int, rate_hz: float, now: float) -> None:
        for name in STREAM_GROUPS[stream][1]:
            self.streams.set_default(name, min(rate_hz, 50.0), now)

    # -- commands

    def command(self, c: Command, now: float) -> int | None:
        if c.id in self.not_supported:
            return m.MAV_RESULT_UNSUPPORTED
        match c.id:
            case m.MAV_CMD_COMPONENT_ARM_DISARM:
                return self._command_arm(c, now)
            case m.MAV_CMD_DO_SET_MODE:
                if not (isfinite(c.p1) and isfinite(c.p2) and int(c.p1) & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
                    return m.MAV_RESULT_DENIED
                return self._accepted_if(self.try_mode(int(c.p2), now))
            case m.MAV_CMD_NAV_TAKEOFF:
                return self._command_takeoff(c)
            case m.MAV_CMD_NAV_LAND:
                return self._accepted_if(self.try_mode(CopterMode.LAND, now))
            case m.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return self._accepted_if(self.try_mode(self.mode_names["RTL"], now))
            case m.MAV_CMD_DO_REPOSITION:
                return self._command_reposition(c, now)
            case m.MAV_CMD_DO_CHANGE_SPEED:
                self.speed_mps = c.p2 if c.p2 > 0 else 0.0
                return m.MAV_RESULT_ACCEPTED
            case m.MAV_CMD_CONDITION_YAW:
                return self._command_yaw(c)
            case m.MAV_CMD_DO_SET_HOME:
                return self._command_home(c)
            case m.MAV_CMD_RUN_PREARM_CHECKS:
                if self.armed:
                    return m.MAV_RESULT_TEMPORARILY_REJECTED
                self._report_prearm()
                return self.firmware.answers.simulated.prearm_checks
            case m.MAV_CMD_DO_SEND_BANNER:
                self._report_banner(now)
                return m.MAV_RESULT_ACCEPTED
            case m.MAV_CMD_MISSION_START:
                return self.run.start(now)
            case m.MAV_CMD_DO_SET_MISSION_CURRENT:
                return self.run.on_set_current_command(self, c, now)
            case _:
                return common_command(self, c, now)

    @staticmethod
    def _accepted_if(ok: bool) -> int:
        return m.MAV_RESULT_ACCEPTED if ok else m.MAV_RESULT_FAILED

    def _command_arm(self, c: Command, now: float) -> int | None:
        if c.p1 not in (0.0, 1.0):
            return self.firmware.answers.simulated.arm_neither
        forced = round(c.p2) == FORCE if isfinite(c.p2) else False
        if c.p1 == 0.0:
            if self.armed and not self.landed and not forced:
                return m.MAV_RESULT_FAILED
            if self.armed:
                self.switch_off()
            return m.MAV_RESULT_ACCEPTED
        if self.armed:
            return m.MAV_RESULT_ACCEPTED
        refusal = None if forced else self._mode_refusal() or self.arming_refusal()
        if refusal is not None:
            self.tx.say(m.MAV_SEVERITY_CRITICAL, f"Arm: {refusal}")
            return m.MAV_RESULT_FAILED
        self.arm(now)
        self.tx.say(m.MAV_SEVERITY_INFO, "Arming motors")
        return m.MAV_RESULT_ACCEPTED

    def _mode_refusal(self) -> str | None:
        auto = self.mode == CopterMode.AUTO and int(self.params["AUTO_OPTIONS"]) & COPTER_AUTO_ARMABLE
        return None if auto or self.mode_rule.arms else f"{CopterMode(self.mode).name} mode not armable"

    def _command_takeoff(self, c: Command) -> int:
        if c.frame not in (None, m.MAV_FRAME_GLOBAL_RELATIVE_ALT):
            return m.MAV_RESULT_DENIED
        ready = self.mode == CopterMode.GUIDED and self.armed and self.landed
        if not ready or not is_altitude(c.p7) or c.p7 <= self.height_m():
            return m.MAV_RESULT_FAILED
        home_up = self.home.up_m if self.home else 0.0
        self.plan.fly(GoTo(self.estimated.east_m, self.estimated.north_m, home_up + c.p7))
        self.taking_off = True
        return m.MAV_RESULT_ACCEPTED

    def _command_reposition(self, c: Command, now: float) -> int:
        if c.frame is None:  # mav_frame_for_command_long knows no frame of it
            return m.MAV_RESULT_UNSUPPORTED
        change_mode = isfinite(c.p2) and int(c.p2) & m.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
        if self.mode != self.guided_mode and not change_mode:
            return m.MAV_RESULT_DENIED
        up = up_of(self, c.frame, c.p7)
        if up is None or not is_position(c.lat_deg, c.lon_deg):
            return m.MAV_RESULT_DENIED
        east, north = self.where.to_local(c.lat_deg, c.lon_deg)
        if not self.inside_fence(east, north, up):
            return m.MAV_RESULT_FAILED
        if self.mode != self.guided_mode and not self.try_mode(self.guided_mode, now):
            return m.MAV_RESULT_FAILED
        if not self.landed:
            self.taking_off = False
            self.go_to(east, north, up)
        return m.MAV_RESULT_ACCEPTED

    def go_to(self, east_m: float, north_m: float, up_m: float) -> None:
        """Go to this place and hold there."""
        self.guided.go_to(self, east_m, north_m, up_m)

    def inside_fence(self, east_m: float, north_m: float, up_m: float) -> bool:
        """True if GUIDED takes a target there; without a fence, everywhere."""
        return self.breach(east_m, north_m, up_m) == ""

    def guided_waypoint(self, item: MissionItem, now: float) -> bool:
        """ModeAuto::do_guided: a waypoint outside a mission is a target, in GUIDED only; whether it is taken."""
        up = up_of(self, item.frame, item.z or 0.0)
        if self.mode != self.guided_mode or up is None or item.position is None:
            return False
        east, north = self.where.to_local(*item.position)
        if not self.inside_fence(east, north, up):
            return False
        if not self.landed:
            self.taking_off = False
            self.go_to(east, north, up)
        return True

    def _command_yaw(self, c: Command) -> int:
        if not 0 <= c.p1 <= 360 or c.p4 not in (0.0, 1.0):
            return m.MAV_RESULT_FAILED
        leg = self.plan.leg
        if self.mode == CopterMode.GUIDED and isinstance(leg, GoTo):
            yaw = radians(c.p1)
            if c.p4 == 1.0:
                yaw = self.estimated.yaw_rad + (yaw if c.p3 >= 0 else -yaw)
            self.plan.fly(GoTo(leg.east_m, leg.north_m, leg.up_m, yaw_rad=yaw))
        return m.MAV_RESULT_ACCEPTED

    def _command_home(self, c: Command) -> int:
        nowhere = all(value == 0 or not isfinite(value) for value in (c.p5, c.p6))
        if c.p1 == 1 or nowhere:  # handle_command_do_set_home
            if not self.position_ok:
                return m.MAV_RESULT_FAILED
            self.home_fixed = self.firmware.home_here_is_fixed.simulated
            self.set_home_here()
            return m.MAV_RESULT_ACCEPTED
        up = up_of(self, m.MAV_FRAME_GLOBAL if c.frame is None else c.frame, c.p7)
        if up is None or not is_position(c.lat_deg, c.lon_deg):
            return m.MAV_RESULT_DENIED
        self.home_fixed = True
        self.set_home(Home(*self.where.to_local(c.lat_deg, c.lon_deg), up))
        return m.MAV_RESULT_ACCEPTED


WITHOUT_TARGETS = ControlGains(1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.5, 5.0, 5.0)
"""Gains of what follows no streamed targets."""


class CourseVehicle(CopterVehicle):
    """An ArduPilot vehicle that goes only where its nose points: it has neither sticks, nor streamed targets (skygcs
    sends it none), nor a landing mode, nor a position from outside."""

    vtol_state = m.MAV_VTOL_STATE_UNDEFINED
    landing_modes = frozenset()

    @property
    def by_vision(self) -> bool:
        return False

    def control_gains(self) -> ControlGains:
        return WITHOUT_TARGETS

    def go_to(self, east_m: float, north_m: float, up_m: float) -> None:
        self.plan.fly(GoTo(east_m, north_m, up_m))

    def reported_target_enu_m(self) -> None:
        return None

    def on_setpoint(self, name: str, fields: dict[str, Any], now: float) -> None:
        return
