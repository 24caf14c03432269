"""PX4 as a ground station sees it (1.16 multicopter): navigation modes, arming rules, refusals. Values: `behaviours`.

disarmed --arm--> armed on ground --TAKEOFF/OFFBOARD--> in air --LAND/RTL/touch--> landed --COM_DISARM_LAND--> disarmed
armed on ground and not taken off: disarmed after COM_DISARM_PRFLT
disarmed: any mode. Armed: OFFBOARD with one setpoint younger than COM_OF_LOSS_T (no warm-up), a mode for sticks never
TAKEOFF at its height: LOITER. Disarmed: the last ordered mode in which it may be armed (OFFBOARD after OFFBOARD, LAND)
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, isfinite, radians, tan
from typing import Any

from skygcs.sim import failsafe, px4_mission
from skygcs.sim import protocol as m
from skygcs.sim.attitude_targets import UNCONTROLLED, Refusal, px4_attitude
from skygcs.sim.behaviours import PX4, Reaction
from skygcs.sim.body import AttitudeSetpoint
from skygcs.sim.command_message import Command
from skygcs.sim.firmware_modes import Px4Mode, px4_mode
from skygcs.sim.firmware_params import PX4_RATES_HZ, px4_params
from skygcs.sim.kinematics import Home, Limits, bounded_limits
from skygcs.sim.legs import Descend, Follow, GoTo, Land, Leg, Wait
from skygcs.sim.param_table import Params
from skygcs.sim.position_control import ControlGains, PositionTarget
from skygcs.sim.position_targets import is_altitude, is_position, px4_target
from skygcs.sim.px4_lists import Px4Lists
from skygcs.sim.px4_mission import Px4Run
from skygcs.sim.px4_position_control import Px4PositionControl
from skygcs.sim.px4_shell import Px4Shell
from skygcs.sim.requests import common_command
from skygcs.sim.vehicle import SimVehicle

FORCE = 21196
"""Magic of MAV_CMD_COMPONENT_ARM_DISARM.param2: no checks."""

_AUTO_MAIN, _POSCTL_MAIN = 4, 3

_REACTION_MODES: Mapping[Reaction, Px4Mode] = {
    Reaction.POSITION: Px4Mode.POSCTL,
    Reaction.ALTITUDE: Px4Mode.ALTCTL,
    Reaction.STABILIZED: Px4Mode.STABILIZED,
    Reaction.HOLD: Px4Mode.LOITER,
    Reaction.RETURN: Px4Mode.RTL,
    Reaction.LAND: Px4Mode.LAND,
}
_RANK: Mapping[int, int] = {Px4Mode.LOITER: 1, Px4Mode.RTL: 2, Px4Mode.LAND: 3}
"""A milder mode does not replace what another failsafe has begun (framework.cpp: the worst action counts)."""


def wanted_mode(base_mode: int, main: int, sub: int) -> int | None:
    """The custom_mode that MAV_CMD_DO_SET_MODE's numbers name (Commander.cpp: handle_command). -1 for a sub mode that
    AUTO does not have; None if they name none, which changes nothing.

    Without MAV_MODE_FLAG_CUSTOM_MODE_ENABLED the base mode counts: DroneKit's PX4 guide enters MISSION so.
    """
    if base_mode & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        if main == _POSCTL_MAIN:
            return Px4Mode.POSCTL_SLOW if px4_mode(main, sub) == Px4Mode.POSCTL_SLOW else Px4Mode.POSCTL
        if main == _AUTO_MAIN:
            mode = px4_mode(main, sub) if sub else Px4Mode.MISSION
            return mode if mode in Px4Mode._value2member_map_ else -1
        mode = px4_mode(main)  # others have no sub modes
        return mode if mode in Px4Mode._value2member_map_ else None
    if base_mode & m.MAV_MODE_FLAG_AUTO_ENABLED:
        return Px4Mode.MISSION
    if not base_mode & m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED:
        return None
    if base_mode & m.MAV_MODE_FLAG_GUIDED_ENABLED:
        return Px4Mode.POSCTL
    return Px4Mode.STABILIZED if base_mode & m.MAV_MODE_FLAG_STABILIZE_ENABLED else Px4Mode.MANUAL


def kind_of(setpoint: PositionTarget | AttitudeSetpoint) -> str:
    """Return which controllers fly it, as OFFBOARD_CONTROL_MODE names them."""
    if isinstance(setpoint, PositionTarget):
        return "position"
    rates_alone = setpoint.attitude_ned_frd is None and setpoint.rates_frd_radps is not UNCONTROLLED
    return "body_rate" if rates_alone else "attitude"


class Px4Vehicle(SimVehicle):
    """A PX4 quadrotor without a transmitter, as the lab flies it under a ground station."""

    run: Px4Run
    autopilot = m.MAV_AUTOPILOT_PX4
    firmware = PX4
    default_rates_hz = PX4_RATES_HZ
    sysid_param = "MAV_SYS_ID"
    named_param_index = None
    hears_broadcast_commands = False

    @staticmethod
    def factory_params(sysid: int) -> Params:
        return Params(px4_params(sysid), bytewise=True)

    @staticmethod
    def make_position_control(gains: ControlGains) -> Px4PositionControl:
        return Px4PositionControl(gains)

    # -- what it says of itself

    @property
    def base_mode(self) -> int:
        flags = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        rule = self.mode_rule
        if rule.sticks:
            flags |= m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        if self.mode != Px4Mode.ACRO:
            flags |= m.MAV_MODE_FLAG_STABILIZE_ENABLED
        if rule.guided:
            flags |= m.MAV_MODE_FLAG_AUTO_ENABLED | m.MAV_MODE_FLAG_GUIDED_ENABLED
        return flags | (m.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)

    @property
    def system_status(self) -> int:
        if self.failsafe:
            return m.MAV_STATE_CRITICAL
        if self.calibration is not None:
            return m.MAV_STATE_CALIBRATING
        return m.MAV_STATE_ACTIVE if self.armed else m.MAV_STATE_STANDBY

    @property
    def version(self) -> dict[str, Any]:
        return {
            "capabilities": m.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            | m.MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | m.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            | m.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
            | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
            | m.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
            "flight_sw_version": 1 << 24 | 16 << 16 | 1 << 8 | m.FIRMWARE_VERSION_TYPE_OFFICIAL,
            "os_sw_version": 11 << 24 | m.FIRMWARE_VERSION_TYPE_OFFICIAL,
            "board_version": 0x38,
            "flight_custom_version": list(b"skygcs01"),
            "uid": 0x5058340000000000 | self.sysid,
        }

    def limits(self) -> Limits:
        p = self.params
        accel, unit_mps2 = self.firmware.climb_accel.simulated
        if self.mode == Px4Mode.OFFBOARD:
            return bounded_limits(
                speed_mps=p["MPC_XY_VEL_MAX"],
                accel_mps2=p["MPC_ACC_HOR"],
                climb_mps=p["MPC_Z_VEL_MAX_UP"],
                descent_mps=p["MPC_Z_VEL_MAX_DN"],
                yaw_rate_radps=radians(p["MPC_YAWRAUTO_MAX"]),
                climb_accel_mps2=p[accel] * unit_mps2,
            )
        return bounded_limits(
            speed_mps=self.cruise_mps or p["MPC_XY_CRUISE"],
            accel_mps2=p["MPC_ACC_HOR"],
            climb_mps=p["MPC_Z_V_AUTO_UP"],
            descent_mps=p["MPC_Z_V_AUTO_DN"],
            yaw_rate_radps=radians(p["MPC_YAWRAUTO_MAX"]),
            climb_accel_mps2=p[accel] * unit_mps2,
            jerk_mps3=p[self.firmware.jerk.simulated],
        )

    @property
    def by_vision(self) -> bool:
        return bool(int(self.params["EKF2_EV_CTRL"]) & 1) and self.params["EKF2_GPS_CTRL"] == 0

    @property
    def low_battery_percent(self) -> float:
        return 100 * self.params["BAT_LOW_THR"]

    def say_event(self, severity: int, text: str) -> None:
        """PX4 marks texts that are also sent as events by a trailing tab."""
        self.tx.say(severity, text + "\t")

    def arming_refusal(self) -> str | None:
        """Why it would not arm now, None if it would."""
        if self.faults.refuse_arming:
            return self.faults.refuse_arming
        p, rule = self.params, self.mode_rule
        if rule.position and not self.position_ok:
            return "Preflight Fail: position estimate not ready"
        least = p["COM_ARM_BAT_MIN"] if p["COM_ARM_BAT_MIN"] >= 0 else p[self.firmware.arming_battery.simulated]
        if self.battery.percent <= 100 * least:
            return "Preflight Fail: low battery"
        if self.motion.crashed:
            return "Preflight Fail: Attitude failure (roll)"
        lacks_setpoints = self.mode == Px4Mode.OFFBOARD and not self.setpoints_fresh
        lacks_mission = self.mode == Px4Mode.MISSION and not self.lists.mission
        if rule.sticks or not rule.arms or lacks_setpoints or lacks_mission:
            return "Arming denied: Resolve system health failures first"  # modeCheck.cpp says which in an event only
        return None

    def battery_levels(self) -> tuple[bool, bool, bool]:
        percent, p = self.battery.percent, self.params
        low, critical, emergency = p["BAT_LOW_THR"], p["BAT_CRIT_THR"], p["BAT_EMERGEN_THR"]
        return percent <= 100 * low, percent <= 100 * critical, percent <= 100 * emergency

    @property
    def setpoints_expected(self) -> bool:
        return self.mode == Px4Mode.OFFBOARD

    @property
    def setpoints_fresh(self) -> bool:
        return self._clock - self.setpoint_at < self.params[self.firmware.setpoint_timeout.simulated]

    @property
    def needs_position(self) -> bool:
        leg = self.plan.leg
        if self.mode == Px4Mode.OFFBOARD and isinstance(leg, Follow):
            return leg.needs_position
        return True

    def breach(self, east_m: float, north_m: float, up_m: float) -> str:
        return failsafe.px4_breach(self, east_m, north_m, up_m)

    def too_far_beyond(self, breach: str) -> bool:
        return False

    @property
    def fence_flags(self) -> tuple[bool, bool, bool]:
        return False, False, False  # SYS_STATUS.hpp has no bit for it

    def make_lists(self) -> tuple[Px4Lists, Px4Run]:
        self.run = run = Px4Run(self)
        return Px4Lists(lambda: run.changed(self)), run

    def tail_of(self, name: str) -> bytes:
        return px4_mission.ids(self.lists) if name == "MISSION_CURRENT" else b""

    # -- life

    def on_boot(self, now: float) -> None:
        self.mode: int = Px4Mode.LOITER
        self._mode_after_disarming: int = Px4Mode.LOITER
        self.failsafe = False
        self.cruise_mps = 0.0
        self.setpoint_at = -1e9
        self._controllers: str | None = None
        self._kind, self._kind_since, self._status_at = "", now, now
        self.shell = Px4Shell(self.tx, self.dialect, lambda: self.armed)

    def on_ready(self, now: float) -> None:
        self.say_event(m.MAV_SEVERITY_INFO, "Ready for takeoff!")

    def on_tick(self, now: float) -> None:
        if self.mode == Px4Mode.TAKEOFF and self.plan.arrived and not self.landed:
            self.mode = Px4Mode.LOITER
            self.intend(self.mode)
            self.taking_off = False
        if self.mode == Px4Mode.MISSION and self.armed:
            self.run.step(self, now)
        failsafe.watch(self, now)
        if self.armed and self.landed:
            self._auto_disarm(now)

    def _auto_disarm(self, now: float) -> None:
        if self.flown_since_arming:
            delay, since, text = self.params["COM_DISARM_LAND"], self.landed_at, "Disarmed by landing"
        else:
            name, more_s = self.firmware.idle_disarm.simulated
            delay, since = self.params[name], self.armed_at + more_s
            text = "Disarmed by auto preflight disarming"
        if delay > 0 and now - since >= delay:
            self.switch_off(text.removeprefix("Disarmed by "))

    def switch_off(self, reason: str) -> None:
        self.disarm()
        self.failsafe = False
        self.say_event(m.MAV_SEVERITY_INFO, f"Disarmed by {reason}")
        self.run.leave()
        self.mode = self._mode_after_disarming

    # -- failsafes

    def say_failsafe(self, reason: str, reaction: Reaction) -> None:
        self.say_event(m.MAV_SEVERITY_CRITICAL, f"Failsafe activated: {reason}, {reaction.value}")

    def say_battery(self, level: str) -> None:
        if level == "low battery":
            self.say_event(m.MAV_SEVERITY_WARNING, "Low battery level, return advised")

    def say_breach(self, breach: str) -> None:
        return  # said with the failsafe

    def say_gcs_is_back(self) -> None:
        self.say_event(m.MAV_SEVERITY_INFO, "GCS connection regained")

    def carry_out(self, reaction: Reaction, now: float) -> None:
        if reaction is Reaction.STOP:
            self.switch_off("failsafe")
            return
        if reaction in (Reaction.HOLD, Reaction.RETURN, Reaction.POSITION) and not self.position_ok:
            reaction = Reaction.LAND
        if reaction not in _REACTION_MODES:
            return
        mode = _REACTION_MODES[reaction]
        if self.failsafe and _RANK.get(self.mode, 0) >= _RANK.get(mode, 0):
            return
        self.enter(mode, now)
        self.failsafe = True

    def on_takeoff(self, now: float) -> None:
        self.say_event(m.MAV_SEVERITY_INFO, "Takeoff detected")

    def on_landed(self, now: float) -> None:
        self.say_event(m.MAV_SEVERITY_INFO, "Landing detected")

    def on_gcs_heartbeat(self, sender: tuple[int, int], now: float) -> None:
        self.failsafes.gcs_heard_at = now

    # -- modes

    def try_mode(self, mode: int, now: float) -> bool:
        """Change the mode if PX4 would."""
        if self.faults.refuse_mode or not self._may_enter(mode, now):
            name = Px4Mode(mode).name if mode in Px4Mode._value2member_map_ else "unknown"
            reason = f": {self.faults.refuse_mode}" if self.faults.refuse_mode else ""
            self.say_event(m.MAV_SEVERITY_CRITICAL, f"Switching to {name} is currently not possible{reason}")
            return False
        self.intend(mode)
        self.enter(mode, now)
        return True

    def intend(self, mode: int) -> None:
        """Somebody wants this mode: the last one in which it may be armed is what it disarms into."""
        rule = self.firmware.modes.simulated.get(mode)
        if rule is not None and (rule.arms or rule.sticks):
            self._mode_after_disarming = mode

    def _may_enter(self, mode: int, now: float) -> bool:
        """UserModeIntention::change: anything while disarmed, LAND always."""
        if mode not in self.firmware.modes.simulated:
            return False
        if not self.armed or mode == Px4Mode.LAND:
            return True
        if mode == Px4Mode.OFFBOARD:
            return self.setpoints_fresh
        if mode == Px4Mode.MISSION and not self.lists.mission:
            return False
        rule = self.firmware.modes.simulated[mode]
        return not rule.sticks and (self.position_ok or not rule.position)

    def enter(self, mode: int, now: float) -> None:
        """Be in this mode and begin what it does."""
        if mode == self.mode and mode not in (Px4Mode.TAKEOFF, Px4Mode.MISSION):
            return  # in LOITER as well: it flies on to where DO_REPOSITION sent it
        if self.mode == Px4Mode.MISSION:
            self.run.leave()
        self._set_mode(mode)
        self._controllers, self._status_at = None, now
        motion = self.estimated
        if mode == Px4Mode.TAKEOFF:
            home_up = self.home.up_m if self.home else motion.up_m
            self._take_off_to(home_up + self.params["MIS_TAKEOFF_ALT"], None)
        elif mode in (Px4Mode.LAND, Px4Mode.PRECLAND):
            self.say_event(m.MAV_SEVERITY_INFO, "Landing at current position")
            speed = self.params["MPC_LAND_SPEED"]
            here = self.land_at(motion.east_m, motion.north_m, speed)
            self.plan.fly(here if self.position_ok else Descend(speed))
        elif self.mode_rule.sticks and not self.landed:
            self._sink()
        elif mode == Px4Mode.RTL:
            self._return()
        elif mode == Px4Mode.MISSION and self.armed:
            self.run.begin(self, now)
        else:
            self.hold_here()

    def _set_mode(self, mode: int) -> None:
        self.mode = mode
        self.failsafe = False
        self.taking_off = False

    def _take_off_to(self, up_m: float, goal: tuple[float, float] | None) -> None:
        motion = self.estimated
        if up_m <= motion.up_m + 0.1:
            self.say_event(m.MAV_SEVERITY_CRITICAL, "Already higher than takeoff altitude")
            up_m = motion.up_m
        legs: list[Leg] = [GoTo(motion.east_m, motion.north_m, up_m, climb_mps=self.params["MPC_TKO_SPEED"])]
        if goal is not None:
            legs.append(GoTo(*goal, up_m))
        self.taking_off = True
        self.plan.fly(*legs)

    def _sink(self) -> None:
        """A mode for sticks without sticks (COM_OBL_RC_ACT 0 to 2): it stops and sinks (with MPC_LAND_SPEED)."""
        self.hold_here()
        leg, speed = self.plan.leg, self.params["MPC_LAND_SPEED"]
        if isinstance(leg, GoTo) and self.position_ok:
            self.plan.fly(Land(leg.east_m, leg.north_m, speed, fast_above_m=1e9, slow_below_m=1e9))
        else:
            self.plan.fly(Descend(speed))

    def return_up_m(self) -> float:
        """RTL::calculate_return_alt_from_cone_half_angle: how high it returns, in the local frame."""
        here, home, p = self.estimated, self.home or Home(*self.estimated.pos_enu_m), self.params
        most = home.up_m + p["RTL_RETURN_ALT"]
        distance, near = hypot(here.east_m - home.east_m, here.north_m - home.north_m), p["NAV_ACC_RAD"]
        up = most
        if p["RTL_CONE_ANG"] > 0 and distance <= near:
            up = home.up_m + 2 * distance
        elif p["RTL_CONE_ANG"] > 0:
            if distance <= p["RTL_MIN_DIST"]:
                up = min(most, home.up_m + distance / tan(radians(min(89.0, p["RTL_CONE_ANG"]))))
            up = max(up, home.up_m + 2 * near)
        return max(here.up_m, min(up, most))

    def _return(self) -> None:
        if self.landed or self.home is None:
            return
        motion, home, p = self.estimated, self.home, self.params
        up = self.return_up_m()
        self.say_event(m.MAV_SEVERITY_INFO, f"RTL: start return at {round(up - home.up_m)} m above home")
        legs: list[Leg] = [GoTo(motion.east_m, motion.north_m, up), GoTo(home.east_m, home.north_m, up)]
        wait_s = p["RTL_LAND_DELAY"]
        if wait_s:  # RtlDirect: down to RTL_DESCEND_ALT, and wait there; below 0 for good
            legs.append(GoTo(home.east_m, home.north_m, min(up, home.up_m + p["RTL_DESCEND_ALT"])))
        if wait_s >= 0:
            legs += [Wait(wait_s), self.land_at(home.east_m, home.north_m, p["MPC_LAND_SPEED"])]
        self.plan.fly(*legs)

    def on_set_mode_message(self, custom_mode: int, sender: tuple[int, int], now: float) -> None:
        self._status_at = now
        ok = self.try_mode(custom_mode, now)
        result = m.MAV_RESULT_ACCEPTED if ok else m.MAV_RESULT_TEMPORARILY_REJECTED
        self.tx.acknowledge(m.MAV_CMD_DO_SET_MODE, result, sender)

    def on_data_stream(self, stream: int, rate_hz: float, now: float) -> None:
        return  # PX4 knows SET_MESSAGE_INTERVAL only

    def on_param(self, name: str, now: float) -> None:
        return  # read where they are used; MAV_SYS_ID at the next boot

    def on_setpoint(self, name: str, fields: dict[str, Any], now: float) -> None:
        setpoint: PositionTarget | AttitudeSetpoint
        if name == "SET_ATTITUDE_TARGET":
            target = px4_attitude(fields)
            if isinstance(target, Refusal):
                return
            setpoint = target
        else:
            position = px4_target(self, name, fields)
            if isinstance(position, str):
                self.say_event(m.MAV_SEVERITY_CRITICAL, position)
            if not isinstance(position, PositionTarget):
                return
            setpoint = position
        self.setpoint_at = now
        if self._controlled(kind_of(setpoint), now) and self.mode == Px4Mode.OFFBOARD:
            self.plan.fly(Follow(setpoint))

    def _controlled(self, kind: str, now: float) -> bool:
        """True if the controllers for this kind of target run: they change with the status alone."""
        if kind != self._kind:
            self._kind, self._kind_since = kind, now
        published = now - (now - self._status_at) % self.firmware.controllers_s.simulated
        if self._controllers is None or published >= self._kind_since:
            self._controllers = kind
        return self._controllers == kind

    # -- commands

    def command(self, c: Command, now: float) -> int | None:
        self._status_at = now  # handle_command: whatever was ordered
        match c.id:
            case m.MAV_CMD_COMPONENT_ARM_DISARM:
                return self._command_arm(c, now)
            case m.MAV_CMD_DO_SET_MODE:
                return self._command_mode(c, now)
            case m.MAV_CMD_NAV_TAKEOFF:
                return self._command_takeoff(c, now)
            case m.MAV_CMD_NAV_LAND:
                return self._accepted_if(self.try_mode(Px4Mode.LAND, now))
            case m.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return self._accepted_if(self.try_mode(Px4Mode.RTL, now))
            case m.MAV_CMD_MISSION_START:
                return self.run.start(self, c, now)
            case m.MAV_CMD_DO_REPOSITION:
                return self._command_reposition(c, now)
            case m.MAV_CMD_DO_CHANGE_SPEED:
                self.cruise_mps = c.p2 if c.p2 > 0 else 0.0
                return m.MAV_RESULT_ACCEPTED
            case m.MAV_CMD_DO_SET_HOME:
                return self._command_home(c)
            case m.MAV_CMD_RUN_PREARM_CHECKS:
                return self.firmware.answers.simulated.prearm_checks
            case _:
                return common_command(self, c, now)

    @staticmethod
    def _accepted_if(ok: bool) -> int:
        return m.MAV_RESULT_ACCEPTED if ok else m.MAV_RESULT_TEMPORARILY_REJECTED

    def _command_arm(self, c: Command, now: float) -> int | None:
        if c.p1 not in (0.0, 1.0):
            return self.firmware.answers.simulated.arm_neither
        forced = round(c.p2) == FORCE if isfinite(c.p2) else False
        if c.p1 == 0.0:
            if self.armed and not self.landed and not forced:
                self.say_event(m.MAV_SEVERITY_CRITICAL, "Disarming denied: not landed")
                return m.MAV_RESULT_TEMPORARILY_REJECTED
            if self.armed:
                self.switch_off("external command")
            return m.MAV_RESULT_ACCEPTED
        return self._accepted_if(self.try_arm(now, forced=forced and self.firmware.answers.simulated.forced_arming))

    def try_arm(self, now: float, *, forced: bool = False) -> bool:
        """Armed afterwards; why not is said."""
        if self.armed:
            return True
        refusal = None if forced else self.arming_refusal()
        if refusal is not None:
            self.say_event(m.MAV_SEVERITY_CRITICAL, "Arming denied: preflight checks failed")
            self.say_event(m.MAV_SEVERITY_CRITICAL, refusal)
            return False
        self.arm(now)
        if self.mode in (Px4Mode.TAKEOFF, Px4Mode.MISSION) and self.plan.leg is None:
            self.enter(self.mode, now)
        self.say_event(m.MAV_SEVERITY_INFO, "Armed by external command")
        return True

    def _command_mode(self, c: Command, now: float) -> int:
        if not all(isfinite(p) and 0 <= p < 256 for p in (c.p1, c.p2, c.p3)):
            return m.MAV_RESULT_TEMPORARILY_REJECTED
        # The receiver answers before the commander (mavlink_receiver.cpp: handle_message_command_both): the first
        # of two acknowledgements is always ACCEPTED.
        self.tx.acknowledge(c.id, m.MAV_RESULT_ACCEPTED, c.sender)
        mode = wanted_mode(int(c.p1), int(c.p2), int(c.p3))
        if mode == -1:
            self.say_event(m.MAV_SEVERITY_CRITICAL, "Unsupported auto mode")
            return m.MAV_RESULT_TEMPORARILY_REJECTED
        # numbers that name no mode are accepted and change nothing, as its commander does
        return m.MAV_RESULT_ACCEPTED if mode is None else self._accepted_if(self.try_mode(mode, now))

    def _command_takeoff(self, c: Command, now: float) -> int:
        if not self._may_enter(Px4Mode.TAKEOFF, now):
            return m.MAV_RESULT_TEMPORARILY_REJECTED
        self._set_mode(Px4Mode.TAKEOFF)
        # AMSL whatever the frame says; a position that is given is flown to, 0/0 as well
        home_up = self.home.up_m if self.home else 0.0
        up = c.p7 - self.where.alt_amsl_m if is_altitude(c.p7) else home_up + self.params["MIS_TAKEOFF_ALT"]
        goal = self.where.to_local(c.lat_deg, c.lon_deg) if is_position(c.lat_deg, c.lon_deg) else None
        self._take_off_to(up, goal)
        return m.MAV_RESULT_ACCEPTED

    def _command_reposition(self, c: Command, now: float) -> int:
        if not isfinite(c.p2) or int(c.p2) != m.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
            return m.MAV_RESULT_UNSUPPORTED
        if not self.try_mode(Px4Mode.LOITER, now):
            return m.MAV_RESULT_TEMPORARILY_REJECTED
        if self.mode == Px4Mode.LOITER and not any(map(isfinite, (c.p4, c.lat_deg, c.lon_deg, c.p7))):
            self.hold_here()  # "pause vehicle"
        elif self.mode == Px4Mode.LOITER and not self.landed:
            motion = self.estimated
            east, north = motion.east_m, motion.north_m
            if is_position(c.lat_deg, c.lon_deg):
                east, north = self.where.to_local(c.lat_deg, c.lon_deg)
            up = c.p7 - self.where.alt_amsl_m if is_altitude(c.p7) else motion.up_m
            reaction = self.firmware.fence.simulated.of(self.params["GF_ACTION"])
            if reaction not in (Reaction.NONE, Reaction.WARN) and self.breach(east, north, up):
                # Navigator::geofence_allows_position; the commander has accepted it all the same
                self.say_event(m.MAV_SEVERITY_CRITICAL, "Reposition is outside geofence")
                return m.MAV_RESULT_ACCEPTED
            self.cruise_mps = c.p1 if c.p1 > 0 else 0.0
            self.plan.fly(GoTo(east, north, up, yaw_rad=c.p4 if isfinite(c.p4) else None))
        return m.MAV_RESULT_ACCEPTED

    def _command_home(self, c: Command) -> int:
        if c.p1 == 1:
            if not self.position_ok:
                return m.MAV_RESULT_TEMPORARILY_REJECTED
            self.home_fixed = self.firmware.home_here_is_fixed.simulated
            self.set_home_here()
            return m.MAV_RESULT_ACCEPTED
        if not (is_position(c.lat_deg, c.lon_deg) and is_altitude(c.p7)):
            return m.MAV_RESULT_DENIED
        self.home_fixed = True
        self.set_home(Home(*self.where.to_local(c.lat_deg, c.lon_deg), c.p7 - self.where.alt_amsl_m))
        return m.MAV_RESULT_ACCEPTED
