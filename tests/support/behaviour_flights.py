"""What a vehicle does, measured through a `Rig`: the same for the simulator and for real firmware.

Each flight begins with a vehicle that is disarmed on the ground and ready, and ends so. It returns figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, nan
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.sim.behaviours import COPTER, PX4, Firmware
from skygcs.sim.kinematics import stopping_distance
from support.behaviour_rig import Rig, Sample
from support.sim_pilot import FIELD

Figures = dict[str, Any]

PX4_LOITER, PX4_OFFBOARD, PX4_LAND, PX4_RTL = 0x03040000, 0x00060000, 0x06040000, 0x05040000
PX4_MISSION, PX4_POSCTL = 0x04040000, 0x00030000
GUIDED, BRAKE, LAND, RTL = 4, 17, 9, 6
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
"""MAV_RESULT."""
HEIGHT_M = 10.0

VELOCITY_MASK = 0b0000_1101_1100_0111
"""Velocity only."""
POSITION_MASK = 0b0000_1101_1111_1000
POSITION_VELOCITY_MASK = 0b0000_1101_1100_0000


def local_target(
    rig: Rig, mask: int, *, pos: tuple[float, float, float] = (0, 0, 0), vel: tuple[float, float, float] = (0, 0, 0)
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED of ENU numbers about the place of the take-off."""
    (e, n, u), (ve, vn, vu) = (pos[0] + rig.base[0], pos[1] + rig.base[1], pos[2]), vel
    return mav.MAVLink_set_position_target_local_ned_message(
        0, rig.sysid, 1, 1, mask, n, e, -u, vn, ve, -vu, 0, 0, 0, 0, 0
    )


# -- getting there


def get_ready(rig: Rig, limit_s: float = 150.0) -> None:
    """Streams on, and an arming that is accepted in the mode of this station's flights."""
    rig.request_streams()

    def armable() -> bool:
        rig.run(1.0)
        rig.set_mode(PX4_LOITER if rig.px4 else GUIDED)
        return rig.arm() == 0

    rig.wait(armable, limit_s, "it arms")
    rig.disarm()
    rig.wait(lambda: not rig.armed, 5, "it disarms")
    rig.request_streams()


def take_off(rig: Rig, height_m: float = HEIGHT_M) -> float:
    """Seconds until it is within half a metre of the height, by its own clock from its arming: how long an order is on
    its way says how busy the computer is."""
    rig.zero_here()
    if rig.px4:
        amsl = FIELD.alt_amsl_m + height_m
        if "HOME_POSITION" in rig.heard:
            amsl = rig.heard["HOME_POSITION"].altitude / 1e3 + height_m
        assert rig.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, amsl) == 0
        assert rig.arm() == 0
    else:
        assert rig.set_mode(GUIDED) == 0
        assert rig.arm() == 0
        assert rig.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == 0
    rig.wait(lambda: rig.here.up_m > height_m - 0.5, 60, "it is at its height")
    took = rig.now - rig.armed_at
    if rig.px4:
        rig.wait(lambda: rig.mode == PX4_LOITER, 20, "its take-off has ended")
    rig.run(3.0)
    return took


def go(rig: Rig, east_m: float, north_m: float, up_m: float) -> int | None:
    """DO_REPOSITION about the place of the take-off."""
    lat, lon = FIELD.to_geodetic(rig.base[0] + east_m, rig.base[1] + north_m)
    if rig.px4:
        amsl = rig.heard["GLOBAL_POSITION_INT"].alt / 1e3 - rig.here.up_m + up_m
        return rig.command_int(
            mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, x=round(lat * 1e7), y=round(lon * 1e7), z=amsl, frame=0
        )
    return rig.command_int(
        mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, 0, x=round(lat * 1e7), y=round(lon * 1e7), z=up_m, frame=3
    )


def at(rig: Rig, east_m: float, north_m: float, up_m: float, near_m: float = 1.0) -> bool:
    here = rig.here
    return hypot(here.east_m - east_m, here.north_m - north_m, here.up_m - up_m) < near_m


SINKS_M, SINKS_S = 0.3, 1.0
"""Height that both have lost a second after the order to land."""


def land(rig: Rig) -> Figures:
    """Land where it is: seconds to the ground and to disarming, by its own clock, from when it begins to sink: an order
    was 8 s on its way on a busy computer."""
    began, up_m = rig.now, rig.here.up_m
    assert rig.set_mode(PX4_LAND if rig.px4 else LAND) == 0
    rig.wait(lambda: not rig.armed, 120, "it has landed and disarmed")
    sinks = next((s.t_s for s in rig.track if s.t_s > began and s.up_m < up_m - SINKS_M), began)
    began = max(began, sinks - SINKS_S)
    down = next((s.t_s for s in rig.track if s.t_s > began and s.up_m < 0.5), nan)
    return {
        "from m": round(up_m, 1),
        "to .5 m s": round(down - began, 1),
        "to disarmed s": round(rig.disarmed_at - began, 1),
    }


def end(rig: Rig) -> None:
    """Whatever goes on: on the ground and disarmed, heartbeats and GPS there again."""
    rig.silent, rig.stream = False, None
    if rig.armed:
        rig.set_mode(PX4_LAND if rig.px4 else LAND)
        rig.wait(lambda: not rig.armed, 120, "it has landed")
    rig.run(2.0)
    rig.set_mode(PX4_LOITER if rig.px4 else GUIDED)


def go_out(rig: Rig) -> None:
    """15 m north, and rest there."""
    go(rig, 0, 15, HEIGHT_M)
    rig.wait(lambda: at(rig, 0, 15, HEIGHT_M), 60, "it is there")
    rig.run(2)


def begin_stream(rig: Rig) -> None:
    """Let setpoints come; a PX4 has to be told that it is to follow them."""
    rig.run(0.3)
    if rig.px4:
        assert rig.set_mode(PX4_OFFBOARD) == 0


def set_params(rig: Rig, px4: Mapping[str, float], copter: Mapping[str, float]) -> None:
    """Those of this firmware, in their order; an int is an integer parameter of a PX4."""
    for name, value in (px4 if rig.px4 else copter).items():
        rig.set_param(name, value, integer=rig.px4 and isinstance(value, int))


def modes_since(rig: Rig, since: float, after: str = "after s") -> Figures:
    """The modes it went through, and when it changed into each."""
    return {
        "modes": [hex(m) if rig.px4 else m for m in rig.mode_sequence(since)],
        after: [round(t - since, 1) for t, _ in rig.modes if t >= since],
    }


def drift_m(track: list[Sample], a: Sample) -> float:
    return max((hypot(s.east_m - a.east_m, s.north_m - a.north_m) for s in track), default=0.0)


# -- flights


def modes_on_the_ground(rig: Rig, numbers: list[int]) -> Figures:
    """For each mode: MAV_RESULT of entering it disarmed, whether it is in it, and MAV_RESULT of arming there."""
    seen: Figures = {}
    for number in numbers:
        rig.set_mode(PX4_LOITER if rig.px4 else GUIDED)
        rig.wait(lambda: rig.mode == (PX4_LOITER if rig.px4 else GUIDED), 2)
        result = rig.set_mode(number)
        entered = rig.wait(lambda number=number: rig.mode == number, 1.5) is not None
        armed = rig.arm() if entered else None
        if armed == 0:
            rig.disarm()
            rig.wait(lambda: not rig.armed, 5)
        seen[f"{number:#x}" if rig.px4 else str(number)] = (result, entered, armed)
    end(rig)
    return seen


def idle_on_the_ground(rig: Rig) -> Figures:
    """Armed and left alone."""
    assert rig.arm() == 0
    rig.wait(lambda: rig.armed, 3, "it is armed")
    rig.wait(lambda: not rig.armed, 60, "it disarms itself")
    return {"s": round(rig.disarmed_at - rig.armed_at, 1)}


def up_there_and_down(rig: Rig) -> Figures:
    figures: Figures = {"takeoff s": round(take_off(rig), 1)}
    assert go(rig, 0, 15, HEIGHT_M) == 0
    began = rig.now
    rig.wait(lambda: at(rig, 0, 15, HEIGHT_M), 60, "it is there")
    figures["15 m s"] = round(rig.now - began, 1)
    figures["top speed"] = round(max(s.vel_mps for s in rig.track[-200:]), 1)
    rig.run(4)
    assert go(rig, 0, -15, HEIGHT_M) == 0
    rig.wait(lambda: rig.here.north_m < 8 and rig.here.vel_mps > 2, 30, "it is on its way")
    from_, speed = rig.here, rig.here.vel_mps
    if rig.px4:
        assert rig.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, nan, nan, nan) == 0
    else:
        assert rig.set_mode(BRAKE) == 0
    rig.wait(lambda: rig.here.vel_mps < 0.3, 30, "it stands")
    figures["hold from mps"] = round(speed, 1)
    figures["hold s"] = round(rig.now - from_.t_s, 1)
    rig.run(2)
    figures["hold m"] = round(hypot(rig.here.north_m - from_.north_m, rig.here.east_m - from_.east_m), 1)
    return figures | {f"land {k}": v for k, v in land(rig).items()}


def velocity_then_silence(rig: Rig) -> Figures:
    """3 m/s north for 5 s at 10 Hz, then nothing."""
    take_off(rig)
    rig.stream = lambda t: local_target(rig, VELOCITY_MASK, vel=(0, 3, 0))
    begin_stream(rig)
    rig.run(5)
    reached = rig.here.vel_mps
    rig.stream = None
    from_, since = rig.here, rig.now
    stood = rig.wait(lambda: rig.here.vel_mps < 0.3, 30)
    rig.run(8)
    later = [s for s in rig.track if s.t_s > since]
    figures = {
        "speed": round(reached, 1),
        "stood after s": stood and round(stood, 1),
        "went m": round(drift_m(later, from_), 1),
        **modes_since(rig, since, "mode after s"),
        "sank m": round(from_.up_m - rig.here.up_m, 1),
    }
    end(rig)
    return figures


def position_and_velocity(rig: Rig) -> Figures:
    """A target that moves north at 2 m/s, with its velocity and without: how far behind it is after 6 s."""
    figures: Figures = {}
    for name, mask in (("with velocity", POSITION_VELOCITY_MASK), ("without", POSITION_MASK)):
        take_off(rig)
        begin, north, east = rig.time(), rig.here.north_m, rig.here.east_m

        def target(t: float, mask: int = mask, begin: float = begin, north: float = north, east: float = east) -> Any:
            where = (east, north + 2 * (t - begin), HEIGHT_M)
            return local_target(rig, mask, pos=where, vel=(0, 2, 0))

        rig.stream = target
        begin_stream(rig)
        rig.run(8)
        figures[f"behind {name} m"] = round(north + 2 * (rig.now - begin) - rig.here.north_m, 1)
        figures[f"speed {name}"] = round(rig.here.vel_mps, 1)
        end(rig)
    return figures


def attitude_then_silence(rig: Rig) -> Figures:
    """Level, at hover: then nothing."""
    take_off(rig)
    from math import cos, sin

    tilt = -0.1
    q = [cos(tilt / 2), 0.0, sin(tilt / 2), 0.0]
    hover = 0.5
    rig.stream = lambda t: mav.MAVLink_set_attitude_target_message(0, rig.sysid, 1, 7, q, 0, 0, 0, hover)
    begin_stream(rig)
    rig.run(2)
    rig.stream = None
    since = rig.now
    rig.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAVLINK_MSG_ID_ATTITUDE, 5e4)
    rig.run(0.2)
    level = rig.wait(lambda: abs(rig.heard["ATTITUDE"].pitch) < 0.02, 10)
    rig.run(4)
    figures = {"level after s": level and round(level + 0.2, 1), **modes_since(rig, since, "mode after s")}
    end(rig)
    return figures


def offboard_entry(rig: Rig) -> Figures:
    """PX4: entering OFFBOARD in flight without, with one old and with one fresh setpoint."""
    if not rig.px4:
        return {}
    take_off(rig)
    target = local_target(rig, VELOCITY_MASK)
    rig.run(2)
    figures: Figures = {"never": rig.set_mode(PX4_OFFBOARD)}
    rig.send(target)
    rig.run(0.3)
    figures["0.3 s old"] = rig.set_mode(PX4_OFFBOARD)
    rig.run(3)
    figures["later"] = hex(rig.mode)
    rig.set_mode(PX4_LOITER)
    rig.send(target)
    rig.run(1.6)
    figures["1.6 s old"] = rig.set_mode(PX4_OFFBOARD)
    end(rig)
    return figures


def ground_station_lost(rig: Rig) -> Figures:
    set_params(rig, {"NAV_DLL_ACT": 2}, {"FS_GCS_ENABLE": 1})
    take_off(rig)
    go_out(rig)
    rig.silent = True
    since = rig.now
    rig.run(22)
    rig.silent = False
    figures = {**modes_since(rig, since), "texts": [t for t in rig.texts[-8:]]}
    rig.run(3)
    figures["back again"] = hex(rig.mode) if rig.px4 else rig.mode
    end(rig)
    set_params(rig, {"NAV_DLL_ACT": 0}, {"FS_GCS_ENABLE": 0})
    return figures


def battery_critical(rig: Rig) -> Figures:
    """The threshold is set above the charge, in flight."""
    set_params(rig, {"COM_LOW_BAT_ACT": 3}, {"BATT_FS_LOW_ACT": 2})
    take_off(rig)
    go_out(rig)
    since, heard = rig.now, len(rig.texts)
    set_params(rig, {"BAT_LOW_THR": 0.9999, "BAT_CRIT_THR": 0.999}, {"BATT_LOW_MAH": 100000})
    rig.run(20)
    figures = {**modes_since(rig, since), "texts": rig.texts[heard:]}
    usual = {"BAT_CRIT_THR": 0.07, "BAT_LOW_THR": 0.15, "COM_LOW_BAT_ACT": 0}
    set_params(rig, usual, {"BATT_LOW_MAH": 0, "BATT_FS_LOW_ACT": 0})
    end(rig)
    return figures


def gps_lost(rig: Rig) -> Figures:
    take_off(rig)
    rig.run(2)
    since, heard, up = rig.now, len(rig.texts), rig.here.up_m
    rig.gps(there=False)
    rig.run(25)
    figures = {
        **modes_since(rig, since),
        "sank m": round(up - rig.here.up_m, 1),
        "armed": rig.armed,
        "texts": rig.texts[heard:],
    }
    rig.gps(there=True)
    rig.wait(lambda: not rig.armed, 60)
    rig.run(15)
    end(rig)
    return figures


def beyond_the_fence(rig: Rig) -> Figures:
    set_params(rig, {"GF_MAX_HOR_DIST": 20.0}, {"FENCE_RADIUS": 20.0, "FENCE_ENABLE": 1})
    figures: Figures = {}
    take_off(rig)
    since, heard = rig.now, len(rig.texts)
    figures["goto outside"] = go(rig, 0, 40, HEIGHT_M)
    rig.run(3)
    figures["goto flown m"] = round(rig.here.north_m, 1)
    rig.stream = lambda t: local_target(rig, VELOCITY_MASK, vel=(0, 3, 0))
    begin_stream(rig)
    if rig.px4:
        rig.wait(lambda: rig.mode == PX4_OFFBOARD, 3, "it is in OFFBOARD")
    first = len(rig.modes)
    rig.wait(lambda: rig.here.north_m > 20 or len(rig.modes) > first, 20)
    rig.run(4)
    rig.stream = None
    figures["at m"] = [round(next((s.north_m for s in rig.track if s.t_s >= t), nan), 1) for t, _ in rig.modes[first:]]
    figures["modes"] = [hex(m) if rig.px4 else m for _, m in rig.modes[first:]]
    rig.run(12)
    figures["most m"] = round(max(s.north_m for s in rig.track if s.t_s > since), 1)
    figures["texts"] = rig.texts[heard:]
    set_params(rig, {"GF_MAX_HOR_DIST": 0.0}, {"FENCE_ENABLE": 0})
    end(rig)
    return figures


def home_of(rig: Rig) -> tuple[float, float]:
    """Where its home is, east and north of the place of the take-off: an ArduCopter keeps one that was set."""
    rig.command(mav.MAV_CMD_REQUEST_MESSAGE, mav.MAVLINK_MSG_ID_HOME_POSITION)
    rig.run(0.5)
    home = rig.heard["HOME_POSITION"]
    east_m, north_m = FIELD.to_local(home.latitude / 1e7, home.longitude / 1e7)
    return east_m - rig.base[0], north_m - rig.base[1]


def returns(rig: Rig) -> Figures:
    """From 20, 6 and 1 m away: how high it climbs, how long it takes and how far from home it ends."""
    figures: Figures = {}
    for away in (20.0, 6.0, 1.0):
        take_off(rig)
        east, north = home_of(rig)
        assert go(rig, east, north + away, HEIGHT_M) == 0
        rig.wait(lambda e=east, n=north + away: at(rig, e, n, HEIGHT_M), 60, "it is there")
        rig.run(4)
        since = rig.now
        assert rig.set_mode(PX4_RTL if rig.px4 else RTL) == 0
        rig.wait(lambda: not rig.armed, 200, "it has returned")
        later = [s for s in rig.track if s.t_s > since]
        off = hypot(rig.here.east_m - east, rig.here.north_m - north)
        figures[f"{away:g} m"] = (
            round(max(s.up_m for s in later), 1),
            round(rig.disarmed_at - since, 1),
            round(off, 1),
        )
        end(rig)
    return figures


def answers(rig: Rig) -> Figures:
    """MAV_RESULT of commands on the ground, disarmed."""
    figures: Figures = {
        "unknown command": rig.command(31999),
        "request unknown message": rig.command(mav.MAV_CMD_REQUEST_MESSAGE, 60000),
        "takeoff disarmed": rig.command(mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan if rig.px4 else 0, 0, 0, 10),
        "reposition without flag": rig.command(mav.MAV_CMD_DO_REPOSITION, -1, 0, 0, nan, nan, nan, nan),
        "pause on ground": rig.command(mav.MAV_CMD_DO_REPOSITION, -1, 1, 0, nan, nan, nan, nan),
        "arm with 2": rig.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 2),
        "disarm disarmed": rig.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0),
        "no such mode": rig.command(mav.MAV_CMD_DO_SET_MODE, 1, 99, 99),
        "no such auto mode": rig.command(mav.MAV_CMD_DO_SET_MODE, 1, 4, 99),
        "land on ground": rig.command(mav.MAV_CMD_NAV_LAND),
        "return on ground": rig.command(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH),
        "mission start without": rig.command(mav.MAV_CMD_MISSION_START, 0, 0),
        "change speed": rig.command(mav.MAV_CMD_DO_CHANGE_SPEED, 1, 5, -1),
        "get home": rig.command(mav.MAV_CMD_GET_HOME_POSITION),
        "mission current 5": rig.command(mav.MAV_CMD_DO_SET_MISSION_CURRENT, 5),
        "reboot 0": rig.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0),
        "condition yaw": rig.command(mav.MAV_CMD_CONDITION_YAW, 90, 0, 1, 0),
        "terminate": rig.command(mav.MAV_CMD_DO_FLIGHTTERMINATION, 0),
        "pause continue": rig.command(mav.MAV_CMD_DO_PAUSE_CONTINUE, 0),
        "guided enable": rig.command(mav.MAV_CMD_NAV_GUIDED_ENABLE, 1),
        "interval of unknown": rig.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 60000, 1e6),
        "version": rig.command(mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1),
        "prearm checks": rig.command(mav.MAV_CMD_RUN_PREARM_CHECKS),
        "set home nan": rig.command(mav.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, nan, nan, nan),
    }
    rig.set_mode(0x05040000 if rig.px4 else 6)
    rig.run(0.5)
    figures["forced arm in RTL"] = rig.arm(forced=True)
    rig.wait(lambda: rig.armed, 2)
    rig.disarm()
    end(rig)
    return figures


def answers_in_flight(rig: Rig) -> Figures:
    take_off(rig)
    again = (0, 0, 0, nan, nan, nan, FIELD.alt_amsl_m + HEIGHT_M) if rig.px4 else (0, 0, 0, 0, 0, 0, 2 * HEIGHT_M)
    figures: Figures = {
        "disarm": rig.disarm(forced=False),
        "arm armed": rig.arm(),
        "reboot": rig.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1),
        "manual": rig.set_mode(0x00010000) if rig.px4 else rig.set_mode(2),
        "takeoff again": rig.command(mav.MAV_CMD_NAV_TAKEOFF, *again),
        "calibrate": rig.command(mav.MAV_CMD_PREFLIGHT_CALIBRATION, 1),
        "mission start": rig.command(mav.MAV_CMD_MISSION_START, 0, 0),
        "auto": rig.set_mode(0x04040000 if rig.px4 else 3),
    }
    end(rig)
    return figures


def modes(rig: Rig) -> Figures:
    """Every mode of the table, and two that are none."""
    numbers = sorted(rules(rig).modes.value)
    return modes_on_the_ground(rig, [*numbers, *((0x01040000, 0x00080000) if rig.px4 else (8, 29))])


# -- against the table


def rules(rig: Rig) -> Firmware:
    return PX4 if rig.px4 else COPTER


class Findings(list[str]):
    """What is not as the table says. ``late_s`` is allowed on top of a time: a firmware on a busy machine."""

    def __init__(self, late_s: float) -> None:
        super().__init__()
        self.late_s = late_s

    def time(self, what: str, value: float | None, wanted: float, *, early_s: float = 0.3, late_s: float = 0.5) -> None:
        if value is None or not wanted - early_s <= value <= wanted + late_s + self.late_s:
            self.append(f"{what}: {value} s, the table says {wanted:g}")

    def share(self, what: str, value: float | None, wanted: float, tolerance: float) -> None:
        if value is None or not wanted / tolerance <= value <= wanted * tolerance:
            self.append(f"{what}: {value}, the table says {wanted:g}")

    def same(self, what: str, value: Any, wanted: Any) -> None:
        if value != wanted:
            self.append(f"{what}: {value!r}, the table says {wanted!r}")


def check_modes(rig: Rig, f: Figures, found: Findings) -> None:
    for number, rule in rules(rig).modes.value.items():
        _, entered, armed = f[f"{number:#x}" if rig.px4 else str(number)]
        found.same(f"mode {number:#x} entered", entered, rule.by_command)
        arms = rule.arms and not rule.sticks and number not in (PX4_OFFBOARD, PX4_MISSION)  # neither is given anything
        if rule.by_command:
            found.same(f"arming in mode {number:#x}", armed == 0, arms)
    for number in (0x01040000, 0x00080000) if rig.px4 else (8, 29):
        found.same(f"mode {number:#x} entered", f[f"{number:#x}" if rig.px4 else str(number)][1], False)


def check_idle(rig: Rig, f: Figures, found: Findings) -> None:
    name, more_s = rules(rig).idle_disarm.value
    found.time("disarmed on the ground", f["s"], {"COM_DISARM_PRFLT": 10.0, "DISARM_DELAY": 10.0}[name] + more_s)


def check_answers(rig: Rig, f: Figures, found: Findings) -> None:
    answers = rules(rig).answers.value
    wanted: Figures = {
        "unknown command": UNSUPPORTED,
        "request unknown message": answers.unknown_message,
        "takeoff disarmed": ACCEPTED if rig.px4 else FAILED,
        "reposition without flag": UNSUPPORTED,
        "pause on ground": ACCEPTED if rig.px4 else UNSUPPORTED,
        "arm with 2": answers.arm_neither,
        "disarm disarmed": ACCEPTED,
        "no such mode": ACCEPTED if rig.px4 else FAILED,
        "no such auto mode": REJECTED if rig.px4 else ACCEPTED,
        "land on ground": ACCEPTED,
        "return on ground": ACCEPTED,
        "mission start without": DENIED if rig.px4 else ACCEPTED,
        "change speed": ACCEPTED,
        "get home": ACCEPTED,
        "mission current 5": answers.mission_current_beyond,
        "reboot 0": answers.reboot_nothing,
        "terminate": answers.terminate_not,
        "pause continue": answers.pause,
        "interval of unknown": answers.unknown_interval,
        "version": ACCEPTED,
        "prearm checks": answers.prearm_checks,
        "set home nan": DENIED if rig.px4 else ACCEPTED,
        "forced arm in RTL": ACCEPTED if answers.forced_arming else REJECTED,
    }
    for what, result in wanted.items():
        found.same(what, f[what], result)


def check_answers_in_flight(rig: Rig, f: Figures, found: Findings) -> None:
    answers = rules(rig).answers.value
    refused = REJECTED if rig.px4 else FAILED
    found.same("disarm", f["disarm"], refused)
    found.same("arm armed", f["arm armed"], ACCEPTED)
    found.same("reboot", f["reboot"], answers.reboot_armed)
    found.same("a mode for sticks", f["manual"], REJECTED if rig.px4 else ACCEPTED)
    found.same("takeoff again", f["takeoff again"], ACCEPTED if rig.px4 else FAILED)
    found.same("calibrate", f["calibrate"], answers.calibrate_armed)
    found.same("mission start", f["mission start"], DENIED if rig.px4 else FAILED)
    found.same("a mission's mode without one", f["auto"], refused)


def check_up_there_and_down(rig: Rig, f: Figures, found: Findings) -> None:
    firmware = rules(rig)
    for what in ("takeoff s", "15 m s", "land to .5 m s", "land to disarmed s"):
        found.share(what, f[what], firmware.times.value[what], 1.4)
    wanted = stopping_distance(f["hold from mps"], *firmware.brake.value)
    found.share("hold m", f["hold m"], wanted, 2.0)


def check_velocity_then_silence(rig: Rig, f: Figures, found: Findings) -> None:
    found.share("speed", f["speed"], 3.0, 1.3)
    if rig.px4:
        found.same("modes", f["modes"], [hex(PX4_POSCTL)])
        found.time("mode after", f["mode after s"][0] if f["mode after s"] else None, 1.0)
        found.share("sank m", f["sank m"], 6.0, 2.0)
    else:
        found.same("modes", f["modes"], [])
        found.time("stood after", f["stood after s"], 3.0, late_s=3.0)


def check_attitude_then_silence(rig: Rig, f: Figures, found: Findings) -> None:
    if rig.px4:
        found.same("modes", f["modes"], [hex(PX4_POSCTL)])
        found.time("mode after", f["mode after s"][0] if f["mode after s"] else None, 1.0)
    else:
        found.same("modes", f["modes"], [])
        found.time("level after", f["level after s"], 3.0)


def check_position_and_velocity(rig: Rig, f: Figures, found: Findings) -> None:
    for name, low, high in (("with velocity", -0.8, 0.8), ("without", 1.0, 3.5)):
        value = f[f"behind {name} m"]
        if not low <= value <= high:
            found.append(f"behind a moving target {name}: {value} m, not {low} to {high}")


def check_offboard_entry(rig: Rig, f: Figures, found: Findings) -> None:
    if rig.px4:
        wanted = {"never": REJECTED, "0.3 s old": ACCEPTED, "1.6 s old": REJECTED, "later": hex(PX4_POSCTL)}
        for what, value in wanted.items():
            found.same(what, f[what], value)


def check_ground_station_lost(rig: Rig, f: Figures, found: Findings) -> None:
    found.same("modes", f["modes"], [hex(PX4_RTL) if rig.px4 else RTL])
    wanted = 10.0 + 5.0 if rig.px4 else 5.0  # and where a PX4 is, it holds meanwhile
    found.time("returns after", f["after s"][0] if f["after s"] else None, wanted, early_s=1.3, late_s=1.0)


def check_battery_critical(rig: Rig, f: Figures, found: Findings) -> None:
    found.same("modes", f["modes"], [hex(PX4_RTL) if rig.px4 else RTL])
    found.time("returns after", f["after s"][0] if f["after s"] else None, 5.0 if rig.px4 else 0.0, late_s=1.0)


def check_beyond_the_fence(rig: Rig, f: Figures, found: Findings) -> None:
    found.same("a goto outside", f["goto outside"], ACCEPTED if rig.px4 else FAILED)
    if abs(f["goto flown m"]) > 2.5:
        found.append(f"a goto outside was flown: {f['goto flown m']} m")
    if rig.px4:
        found.same("modes", f["modes"], [hex(PX4_LOITER)])
        found.share("turned at m", f["at m"][0] if f["at m"] else None, 20.0, 1.15)
    else:
        found.same("modes", f["modes"], [])
        found.share("stopped at m", f["most m"], 18.0, 1.08)


def check_returns(rig: Rig, f: Figures, found: Findings) -> None:
    highest = {"20 m": 30.0, "6 m": 10.0, "1 m": 10.0} if rig.px4 else {"20 m": 15.0, "6 m": 15.0, "1 m": 10.0}
    for name, wanted in highest.items():
        up, _, off = f[name]
        if abs(up - wanted) > 1.0:
            found.append(f"a return from {name} climbs to {up} m, the table says {wanted:g}")
        if off > 1.5:
            found.append(f"a return from {name} ends {off} m from home")


def check_gps_lost(rig: Rig, f: Figures, found: Findings) -> None:
    first = f["modes"][0] if f["modes"] else None
    found.same("first mode", first, hex(PX4_LAND) if rig.px4 else LAND)
    wanted = rules(rig).position_lost_s.value
    found.time("given up after", f["after s"][0] if f["after s"] else None, wanted, early_s=1.0, late_s=2.0)
