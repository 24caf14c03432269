"""A simulated vehicle's failsafes: when they go off, and what they do. The firmwares differ in `behaviours`.

Each goes off once when its trouble begins, and again only after the trouble has ended. A vehicle in the air without GPS
loses its estimate after a while; without a transmitter no pilot takes over.
"""

from __future__ import annotations

from math import hypot, inf

from skygcs.sim import protocol as m
from skygcs.sim.behaviours import Reaction
from skygcs.sim.fence_shapes import within
from skygcs.sim.firmware_modes import CopterMode, Px4Mode
from skygcs.sim.vehicle_state import VehicleState

FENCE_HEIGHT = 1
FENCE_CIRCLE = 2
FENCE_POLYGON = 4
FENCE_FLOOR = 8
"""Bits of ArduCopter's FENCE_TYPE; that of polygons is for the fence list; no floor is flown."""

GIVE_UP_M = 100.0
"""AC_FENCE_GIVE_UP_DISTANCE: this far outside, a return has failed and it lands."""

PILOT_GOES_ON = 16
"""Bit of FS_OPTIONS (Copter.h, GCS_CONTINUE_IF_PILOT_CONTROL), set by default: a lost ground station means nothing in
a mode that is flown by a pilot."""


AUTO_GOES_ON = 2
"""Bit of FS_OPTIONS (Copter.h, GCS_CONTINUE_IF_AUTO)."""

PX4_GOES_ON = {Px4Mode.MISSION: 1, Px4Mode.LOITER: 2, Px4Mode.TAKEOFF: 2, Px4Mode.OFFBOARD: 4}
"""Bits of COM_DLL_EXCEPT (failsafe.cpp, DatalinkLossExceptionBits). Looked at all the time: with the mode, what is
ignored ends."""


def watch(v: VehicleState, now: float) -> None:
    """One tick's look at everything."""
    firmware, alarms = v.firmware, v.failsafes
    silent = v.setpoints_expected and now - v.setpoint_at > v.params[firmware.setpoint_timeout.simulated]
    if alarms.setpoints.check(silent, now):
        _react(v, firmware.setpoints_lost.simulated.of(v.params["COM_OBL_RC_ACT"]), "no offboard signal", now)
    without = not v.landed and not v.position_ok
    if alarms.position.check(without, now, firmware.position_lost_s.simulated) and v.needs_position:
        _react(v, Reaction.LAND, "position lost", now)
    _watch_battery(v, now)
    _watch_gcs(v, now)
    _watch_fence(v, now)
    _watch_crash(v, now)


def _watch_battery(v: VehicleState, now: float) -> None:
    """The worst level that was newly reached counts."""
    firmware, alarms = v.firmware, v.failsafes
    low, critical, emergency = v.battery_levels()
    if not (low or alarms.battery_low.raised or critical or alarms.battery_critical.raised) and not (
        emergency or alarms.battery_emergency.raised
    ):
        return  # nearly always
    for alarm, reached, facts, name in (
        (alarms.battery_low, low, firmware.battery_low, "low battery"),
        (alarms.battery_critical, critical, firmware.battery_critical, "critical battery"),
        (alarms.battery_emergency, emergency, firmware.battery_emergency, "battery emergency"),
    ):
        if alarm.check(reached, now):
            v.say_battery(name)
            reactions = facts.simulated
            _react(v, reactions.of(v.params[reactions.param]), name, now, delayed=True)


def _watch_gcs(v: VehicleState, now: float) -> None:
    firmware, alarms = v.firmware, v.failsafes
    heard_at, timeout_s = alarms.gcs_heard_at, v.params[firmware.gcs_timeout.simulated]
    if not alarms.gcs.raised and (heard_at is None or now - heard_at <= timeout_s):
        return  # nearly always
    reactions = firmware.gcs.simulated
    reaction = reactions.of(v.params[reactions.param])
    before, rule, options = alarms.gcs.raised, v.mode_rule, v.params.get("FS_OPTIONS")
    px4 = v.autopilot == m.MAV_AUTOPILOT_PX4
    ignored = px4 and int(v.params["COM_DLL_EXCEPT"]) & PX4_GOES_ON.get(Px4Mode(rule.number), 0) != 0
    lost = alarms.gcs_lost(now, inf if ignored else timeout_s)
    if lost and reaction is not Reaction.NONE and v.armed:
        if options is None:
            if not rule.lands:
                _react(v, reaction, "GCS lost", now, delayed=True)
        elif not v.landed and int(options) & AUTO_GOES_ON and rule.number == CopterMode.AUTO:
            v.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe - Continuing Auto Mode")
        elif not v.landed and int(options) & PILOT_GOES_ON and not rule.autopilot:
            v.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe - Continuing Pilot Control")
        else:
            v.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe")
            _react(v, reaction, "", now)
    elif before and not alarms.gcs.raised and reaction is not Reaction.NONE:
        v.say_gcs_is_back()


def _watch_fence(v: VehicleState, now: float) -> None:
    """ArduCopter knows of a breach on the ground, too; it acts on it only with the motors on, and there by switching
    them off."""
    breach = v.breach(*v.estimated.pos_enu_m)
    _report_breach(v, breach)
    if not v.failsafes.fence.check(breach != "" and v.armed, now):
        return
    reactions = v.firmware.fence.simulated
    reaction = reactions.of(v.params[reactions.param])
    v.say_breach(breach)
    if v.too_far_beyond(breach) and reaction is not Reaction.WARN:
        reaction = Reaction.LAND
    if reaction is Reaction.HOLD:
        v.hold_here()  # Navigator::geofence_breach_check moves the place it holds, in LOITER as well
    _react(v, reaction, f"fence {breach}", now, delayed=True)


def _watch_crash(v: VehicleState, now: float) -> None:
    lean_deg, error_deg, accel_mps2, time_s = v.firmware.crash.simulated
    if time_s <= 0.0:
        return
    motion = v.motion
    crashed = v.armed and not v.landed and v.attitude_error_deg > error_deg and motion.lean_deg > lean_deg
    still = crashed and hypot(*motion.accel_enu_mps2) < accel_mps2
    if v.failsafes.crash.check(still, now, time_s):
        text = f"Crash: Disarming: AngErr={v.attitude_error_deg:.0f}>{error_deg:.0f}, Accel=0.0<{accel_mps2:.1f}"
        v.tx.say(m.MAV_SEVERITY_EMERGENCY, text)
        v.switch_off("crash")


def _react(v: VehicleState, reaction: Reaction, reason: str, now: float, *, delayed: bool = False) -> None:
    """Do it, or hold first (``delayed``, where the firmware does). ``reason`` is for its text; "": it has said it."""
    if not v.armed or reaction is Reaction.NONE:
        return
    if reason and not (reaction is Reaction.WARN and "battery" in reason):
        v.say_failsafe(reason, reaction)
    hold = v.firmware.failsafe_hold.simulated
    delay_s = v.params[hold] if hold and delayed and reaction in (Reaction.RETURN, Reaction.LAND) else 0.0
    if delay_s <= 0.0 or v.failsafe or not v.position_ok:
        v.carry_out(reaction, now)
        return
    v.tx.say(m.MAV_SEVERITY_CRITICAL, f"Failsafe activated: entering Hold for {delay_s:.0f} seconds\t")
    v.carry_out(Reaction.HOLD, now)
    v.later(now + delay_s, lambda: v.carry_out(reaction, now + delay_s) if v.armed and v.failsafe else None)


def outside(v: VehicleState, east_m: float, north_m: float, up_m: float, *, radius_m: float, height_m: float) -> str:
    """Which side of a cylinder about home this place is beyond: "distance", "height" or ""; a size of 0 is no bound."""
    home = v.home
    if home is None:
        return ""
    if radius_m > 0 and hypot(east_m - home.east_m, north_m - home.north_m) > radius_m:
        return "distance"
    return "height" if height_m > 0 and up_m - home.up_m > height_m else ""


def copter_fence_present(v: VehicleState) -> bool:
    """True if a fence is set up, enabled or not (AC_Fence::present)."""
    polygon = FENCE_POLYGON if v.lists.fence else 0
    return bool(int(v.params["FENCE_TYPE"]) & (FENCE_HEIGHT | FENCE_CIRCLE | FENCE_FLOOR | polygon))


def copter_breach(v: VehicleState, east_m: float, north_m: float, up_m: float) -> str:
    """ArduCopter: within all inclusions, and of the fences that FENCE_TYPE names."""
    p = v.params
    if not p["FENCE_ENABLE"]:
        return ""
    kinds = int(p["FENCE_TYPE"])
    if kinds & FENCE_POLYGON and not within(v.lists.fence, v.where, east_m, north_m, every=True):
        return "polygon"
    radius = p["FENCE_RADIUS"] if kinds & FENCE_CIRCLE else 0.0
    height = p["FENCE_ALT_MAX"] if kinds & FENCE_HEIGHT else 0.0
    return outside(v, east_m, north_m, up_m, radius_m=radius, height_m=height)


def px4_breach(v: VehicleState, east_m: float, north_m: float, up_m: float) -> str:
    """PX4: within one of the inclusions."""
    p = v.params
    breach = outside(v, east_m, north_m, up_m, radius_m=p["GF_MAX_HOR_DIST"], height_m=p["GF_MAX_VER_DIST"])
    if not breach and not within(v.lists.fence, v.where, east_m, north_m, every=False):
        return "polygon"
    return breach


def _report_breach(v: VehicleState, breach: str) -> None:
    """Keep in mind, for telemetry, which side of its fence it is beyond."""
    kind = m.FENCE_BREACH_NONE
    if breach:
        kind = m.FENCE_BREACH_MAXALT if breach == "height" else m.FENCE_BREACH_BOUNDARY
    if kind != m.FENCE_BREACH_NONE and v.fence_breach == m.FENCE_BREACH_NONE:
        v.fence_breaches += 1
    v.fence_breach = kind
