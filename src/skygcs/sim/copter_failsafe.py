"""ArduCopter's failsafes (4.5, ArduCopter/events.cpp and fence.cpp): ground station, battery, fence, estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from skygcs.sim import protocol as m
from skygcs.sim.copter_setup import NEEDS_POSITION, CopterMode
from skygcs.sim.failsafe import outside, tell_breach
from skygcs.sim.fence_shapes import within

if TYPE_CHECKING:
    from skygcs.sim.ardupilot import CopterVehicle

FENCE_HEIGHT = 1
FENCE_CIRCLE = 2
FENCE_POLYGON = 4
FENCE_FLOOR = 8
"""Bits of FENCE_TYPE; that of polygons is for polygons and circles of the fence list. No floor is simulated."""

TEXTS = {"height": "Max Alt fence breached", "distance": "Circle fence breached", "polygon": "Polygon fence breached"}

GIVE_UP_M = 100.0
"""FENCE_GIVE_UP_DISTANCE: this far outside, a return has failed and it lands."""

GCS_LOSS: Mapping[int, CopterMode] = {
    1: CopterMode.RTL,
    2: CopterMode.RTL,
    3: CopterMode.SMART_RTL,
    4: CopterMode.SMART_RTL,
    5: CopterMode.LAND,
    7: CopterMode.BRAKE,
}
"""FS_GCS_ENABLE; 0: none."""

PILOT_GOES_ON = 16
"""Bit of FS_OPTIONS (Copter.h, GCS_CONTINUE_IF_PILOT_CONTROL), set by default: a lost ground station means nothing in
a mode that is flown by a pilot."""

AUTOPILOT = frozenset(
    {
        *(CopterMode.AUTO, CopterMode.GUIDED, CopterMode.GUIDED_NOGPS, CopterMode.AVOID_ADSB, CopterMode.FOLLOW),
        *(CopterMode.CIRCLE, CopterMode.LAND, CopterMode.RTL, CopterMode.SMART_RTL, CopterMode.AUTO_RTL),
        *(CopterMode.ZIGZAG, CopterMode.AUTOROTATE),
    }
)
"""Modes whose is_autopilot() is true (ArduCopter/mode.h, 4.6); BRAKE is none."""

BATTERY: Mapping[int, CopterMode] = {
    1: CopterMode.LAND,
    2: CopterMode.RTL,
    3: CopterMode.SMART_RTL,
    4: CopterMode.SMART_RTL,
    7: CopterMode.BRAKE,
}
"""BATT_FS_LOW_ACT and BATT_FS_CRT_ACT; 0: a warning, 5: motors off."""

TERMINATE = 5

FENCE: Mapping[int, CopterMode] = {
    1: CopterMode.RTL,
    2: CopterMode.LAND,
    3: CopterMode.SMART_RTL,
    4: CopterMode.BRAKE,
    5: CopterMode.SMART_RTL,
}
"""FENCE_ACTION; 0: report only."""


def watch(v: CopterVehicle, now: float) -> None:
    """One tick's look at everything."""
    p, alarms = v.params, v.failsafes
    if alarms.position_lost(v, now) and v.mode in NEEDS_POSITION:
        v.tx.say(m.MAV_SEVERITY_CRITICAL, "EKF Failsafe: changed to LAND Mode")
        _go(v, now, CopterMode.LAND)
    _watch_battery(v, now)
    was_lost = alarms.gcs.raised
    lost = alarms.gcs_lost(now, p["FS_GCS_TIMEOUT"])
    action = int(p["FS_GCS_ENABLE"])
    if (
        lost
        and action
        and v.armed
        and not v.landed
        and int(p["FS_OPTIONS"]) & PILOT_GOES_ON
        and v.mode not in AUTOPILOT
    ):
        v.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe - Continuing Pilot Control")
    elif lost and action and v.armed:
        v.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe")
        _go(v, now, GCS_LOSS.get(action, CopterMode.RTL))
    elif was_lost and not alarms.gcs.raised and action:
        v.tx.say(m.MAV_SEVERITY_WARNING, "GCS Failsafe Cleared")
    _watch_fence(v, now)


def fence_present(v: CopterVehicle) -> bool:
    """Whether a fence is set up, enabled or not (AC_Fence::present)."""
    polygon = FENCE_POLYGON if v.lists.fence else 0
    return bool(int(v.params["FENCE_TYPE"]) & (FENCE_HEIGHT | FENCE_CIRCLE | FENCE_FLOOR | polygon))


def inside_fence(v: CopterVehicle, east_m: float, north_m: float, up_m: float) -> bool:
    """Whether GUIDED takes a target there; without a fence, everywhere."""
    return _breach(v, east_m, north_m, up_m) == ""


def _breach(v: CopterVehicle, east_m: float, north_m: float, up_m: float) -> str:
    p = v.params
    if not p["FENCE_ENABLE"]:
        return ""
    kinds = int(p["FENCE_TYPE"])
    radius = p["FENCE_RADIUS"] if kinds & FENCE_CIRCLE else 0.0
    height = p["FENCE_ALT_MAX"] if kinds & FENCE_HEIGHT else 0.0
    if kinds & FENCE_POLYGON and not within(v.lists.fence, v.where, east_m, north_m, every=True):
        return "polygon"
    return outside(v, east_m, north_m, up_m, radius_m=radius, height_m=height)


def _watch_fence(v: CopterVehicle, now: float) -> None:
    """It knows of a breach on the ground, too; it acts on it only with the motors on, and there by switching them
    off."""
    here = v.estimated
    breach = _breach(v, *here.pos_enu_m)
    tell_breach(v, breach)
    if not v.failsafes.fence.check(breach != "" and v.armed, now):
        return
    if not v.landed:
        v.tx.say(m.MAV_SEVERITY_WARNING, TEXTS[breach])
    action = int(v.params["FENCE_ACTION"])
    if action == 0:
        return
    home = v.home
    far = home is not None and here.distance_m(*home.pos_enu_m) > v.params["FENCE_RADIUS"] + GIVE_UP_M
    _go(v, now, CopterMode.LAND if far and breach != "height" else FENCE.get(action, CopterMode.RTL))


def _watch_battery(v: CopterVehicle, now: float) -> None:
    battery, p, alarms = v.battery, v.params, v.failsafes
    left_mah = battery.capacity_mah - battery.used_mah
    for alarm, least, action, word in (
        (alarms.battery_low, p["BATT_LOW_MAH"], p["BATT_FS_LOW_ACT"], "low"),
        (alarms.battery_critical, p["BATT_CRT_MAH"], p["BATT_FS_CRT_ACT"], "critical"),
    ):
        if alarm.check(least > 0 and left_mah <= least, now):
            v.tx.say(
                m.MAV_SEVERITY_WARNING, f"Battery 1 is {word} {battery.volts:.1f}V used {battery.used_mah:.0f} mAh"
            )
            _act_on_battery(v, int(action), now)


def _act_on_battery(v: CopterVehicle, action: int, now: float) -> None:
    if action == 0 or not v.armed:
        return
    v.tx.say(m.MAV_SEVERITY_WARNING, "Battery Failsafe")
    if action == TERMINATE:
        v.switch_off()
    else:
        _go(v, now, BATTERY.get(action, CopterMode.RTL))


def _go(v: CopterVehicle, now: float, mode: CopterMode) -> None:
    """Change to the mode, to LAND where it is impossible; on the ground: disarm."""
    if not v.armed:
        return
    if v.landed:
        v.switch_off()
        return
    if mode in NEEDS_POSITION and not v.position_ok:
        mode = CopterMode.LAND
    if v.mode == CopterMode.LAND and v.failsafe:
        return  # a landing that a failsafe has begun goes on
    v.enter(mode, now)
    v.failsafe = True
