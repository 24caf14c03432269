"""PX4's failsafes (1.16, commander/failsafe): loss of offboard, ground station, position; geofence; battery.

Without a transmitter the manual fallbacks of COM_OBL_RC_ACT (position, altitude, manual) come to a hold. The delay
COM_FAIL_ACT_T, in which a pilot with sticks could take over, is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TYPE_CHECKING

from skygcs.sim import protocol as m
from skygcs.sim.failsafe import outside, tell_breach
from skygcs.sim.fence_shapes import within
from skygcs.sim.legs import Follow
from skygcs.sim.px4_setup import Px4Mode

if TYPE_CHECKING:
    from skygcs.sim.px4 import Px4Vehicle


class Action(Enum):
    """In words for the text."""

    WARN = "warning only"
    HOLD = "holding"
    RETURN = "returning"
    LAND = "landing"
    STOP = "motors off"


OFFBOARD_LOSS: Mapping[int, Action] = {3: Action.RETURN, 4: Action.LAND, 6: Action.STOP, 7: Action.STOP}
"""COM_OBL_RC_ACT; every other value: hold."""

GEOFENCE: Mapping[int, Action] = {
    1: Action.WARN,
    2: Action.HOLD,
    3: Action.RETURN,
    4: Action.STOP,
    5: Action.LAND,
}
"""GF_ACTION; 0: none."""

DATA_LINK_LOSS: Mapping[int, Action] = {
    1: Action.HOLD,
    2: Action.RETURN,
    3: Action.LAND,
    5: Action.STOP,
    6: Action.STOP,
}
"""NAV_DLL_ACT; 0: none."""

BATTERY_CRITICAL: Mapping[int, Action] = {2: Action.LAND, 3: Action.RETURN}
BATTERY_EMERGENCY: Mapping[int, Action] = {2: Action.LAND, 3: Action.LAND}
"""COM_LOW_BAT_ACT; else a warning."""

MODES: Mapping[Action, Px4Mode] = {
    Action.HOLD: Px4Mode.LOITER,
    Action.RETURN: Px4Mode.RTL,
    Action.LAND: Px4Mode.LAND,
}
RANK: Mapping[int, int] = {Px4Mode.LOITER: 1, Px4Mode.RTL: 2, Px4Mode.LAND: 3}
"""A milder mode does not replace what another failsafe has begun."""


def watch(v: Px4Vehicle, now: float) -> None:
    """One tick's look at everything."""
    p, alarms = v.params, v.failsafes
    if v.mode == Px4Mode.OFFBOARD and now - v.setpoint_at > p["COM_OF_LOSS_T"]:
        action = OFFBOARD_LOSS.get(int(p["COM_OBL_RC_ACT"]), Action.HOLD)
        _act(v, action, "no offboard signal", now)
    if alarms.position_lost(v, now) and not _needs_no_position(v):
        _act(v, Action.LAND, "position lost", now)
    _watch_battery(v, now)
    if alarms.gcs_lost(now, p["COM_DL_LOSS_T"]):
        _act_if(v, DATA_LINK_LOSS.get(int(p["NAV_DLL_ACT"])), "GCS lost", now)
    here = v.estimated
    breach = outside(v, *here.pos_enu_m, radius_m=p["GF_MAX_HOR_DIST"], height_m=p["GF_MAX_VER_DIST"])
    if not breach and not within(v.lists.fence, v.where, here.east_m, here.north_m, every=False):
        breach = "polygon"
    tell_breach(v, breach)
    if alarms.fence.check(breach != "", now):
        _act_if(v, GEOFENCE.get(int(p["GF_ACTION"])), f"fence {breach}", now)


def _watch_battery(v: Px4Vehicle, now: float) -> None:
    alarms, percent, p = v.failsafes, v.battery.percent, v.params
    if alarms.battery_low.check(percent <= v.low_battery_percent, now):
        v.say_event(m.MAV_SEVERITY_WARNING, "Low battery level, return advised")
    way = int(p["COM_LOW_BAT_ACT"])
    if alarms.battery_critical.check(percent <= 100 * p["BAT_CRIT_THR"], now):
        _act(v, BATTERY_CRITICAL.get(way, Action.WARN), "critical battery", now)
    if alarms.battery_emergency.check(percent <= 100 * p["BAT_EMERGEN_THR"], now):
        _act(v, BATTERY_EMERGENCY.get(way, Action.WARN), "battery emergency", now)


def _needs_no_position(v: Px4Vehicle) -> bool:
    leg = v.plan.leg
    return v.mode == Px4Mode.OFFBOARD and isinstance(leg, Follow) and not leg.needs_position


def _act_if(v: Px4Vehicle, action: Action | None, reason: str, now: float) -> None:
    if action is not None:
        _act(v, action, reason, now)


def _act(v: Px4Vehicle, action: Action, reason: str, now: float) -> None:
    if not v.armed:
        return
    if action in (Action.HOLD, Action.RETURN) and not v.position_ok:
        action = Action.LAND
    v.say_event(m.MAV_SEVERITY_CRITICAL, f"Failsafe activated: {reason}, {action.value}")
    if action is Action.WARN:
        return
    if action is Action.STOP:
        v.switch_off("Disarmed by failsafe")
        return
    mode = MODES[action]
    if v.failsafe and RANK.get(v.mode, 0) >= RANK[mode]:
        return
    v.enter(mode, now)
    v.failsafe = True
