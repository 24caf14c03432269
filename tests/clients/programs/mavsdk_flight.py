"""MAVSDK 4 for Python (C++ without a server): mavsdk_flight.py CONNECTION px4|ardupilot

Its own examples with the blocking interface (telemetry, params, takeoff_and_land, mission with a pause), then goto and
offboard with `mavsdk.asyncio`, as the examples of MAVSDK 3 fly them.
"""

import asyncio
import sys
from math import isfinite

from mavsdk import ComponentType, Configuration, Mavsdk, MavsdkError, log_subscribe
from mavsdk.asyncio import System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw, VelocityNedYaw
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.info import Info
from mavsdk.plugins.mission import Mission, MissionError, MissionItem, MissionPlan
from mavsdk.plugins.mission_raw import MissionItem as RawItem
from mavsdk.plugins.mission_raw import MissionRaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry
from report import distance_m, moved, saw, until

TIMEOUT_S = 180.0


def patiently(call):
    """What the call returns; again if it timed out: MAVSDK waits for half a second each time, too short for a slow
    machine.
    """

    def done():
        try:
            return [call()]
        except MavsdkError as error:
            if error.result.name != "TIMEOUT":
                raise
            return None

    return until(done, "an answer in time")[0]


def found(mavsdk):
    """As all its examples look for the vehicle."""

    def autopilot():
        return next((s for s in mavsdk.get_systems() if s.has_autopilot() and s.is_connected()), None)

    system = until(autopilot, "a system with an autopilot")
    saw("connected", system=system.get_system_id(), autopilot=system.autopilot_type().name)
    return system


def look(system, telemetry):
    info = Info(system)
    positions = []
    handle = telemetry.subscribe_position(lambda position, user_data=None: positions.append(position))
    until(lambda: positions and isfinite(positions[-1].latitude_deg), "a position by call-back")
    telemetry.unsubscribe_position(handle)
    until(lambda: telemetry.health().is_global_position_ok, "a global position")
    until(lambda: telemetry.health().is_home_position_ok, "a home position")
    until(lambda: telemetry.gps_info().num_satellites > 0, "satellites")
    until(lambda: telemetry.battery().voltage_v > 1, "a battery")
    version = patiently(info.get_version)
    saw(
        "state",
        armable=telemetry.health().is_armable,
        battery_v=telemetry.battery().voltage_v,
        satellites=telemetry.gps_info().num_satellites,
        yaw_deg=telemetry.attitude_euler().yaw_deg,
        version=[version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch],
    )


def params(system, name, value):
    param = Param(system)
    before = patiently(lambda: param.get_param_float(name))
    patiently(lambda: param.set_param_float(name, value))
    everything = patiently(param.get_all_params)
    after = patiently(lambda: param.get_param_float(name))
    counts = len(everything.int_params), len(everything.float_params)
    saw("parameters", ints=counts[0], floats=counts[1], before=before, after=after)


def arm(action, telemetry):
    def armed():  # its checks need a few seconds after the position is there
        try:
            action.arm()
        except ActionError as error:
            saw("not yet", error=str(error))
        return telemetry.armed()

    until(armed, "armed", pause_s=2)
    saw("armed")


def takeoff_and_land(action, telemetry, px4):
    patiently(lambda: action.set_takeoff_altitude(3.0))
    heights = patiently(action.get_takeoff_altitude), patiently(action.get_return_to_launch_altitude)
    saw("heights", takeoff_m=heights[0], rtl_m=heights[1])
    arm(action, telemetry)
    patiently(action.takeoff)
    until(lambda: telemetry.position().relative_altitude_m > 2, "2 m")
    saw("up")
    if not px4:  # in LAND it could not arm an ArduCopter again: it takes BRAKE before, in which no ArduCopter arms
        return
    patiently(action.land)
    until(lambda: telemetry.landed_state() == LandedState.ON_GROUND and not telemetry.armed(), "landed and disarmed")
    saw("down")


def mission(system, action, telemetry):
    """The example: armed on the ground, started, paused, continued, finished."""
    plugin = Mission(system)
    at = telemetry.position()
    legs = [moved(at.latitude_deg, at.longitude_deg, north, east) for north, east in ((12, 0), (12, 12), (0, 12))]
    items = [
        MissionItem(
            latitude_deg=lat, longitude_deg=lon, relative_altitude_m=8.0, speed_m_s=5.0, acceptance_radius_m=1.0
        )
        for lat, lon in legs
    ]
    plugin.set_return_to_launch_after_mission(False)
    patiently(lambda: plugin.upload_mission(MissionPlan(items)))
    back = patiently(plugin.download_mission).mission_items
    off = [distance_m(leg, (i.latitude_deg, i.longitude_deg)) for leg, i in zip(legs, back, strict=False)]
    saw("mission", sent=len(items), back=len(back), worst_m=max(off, default=-1.0))
    progress = []
    plugin.subscribe_mission_progress(lambda now, user_data=None: progress.append((now.current, now.total)))
    arm(action, telemetry)
    patiently(plugin.start_mission)
    until(lambda: progress and progress[-1][0] >= 1, "the first item", TIMEOUT_S)
    patiently(plugin.pause_mission)
    until(lambda: telemetry.flight_mode() == FlightMode.HOLD, "HOLD")
    saw("paused", item=progress[-1][0])
    patiently(plugin.start_mission)
    until(plugin.is_mission_finished, "the end of the mission", TIMEOUT_S, 0.5)
    saw("flown", items=sorted({current for current, _ in progress}), finished=True)


def raw_mission(system, _, telemetry):
    """An ArduCopter's: item 0 is its home, and the take-off an item; the plugin `mission` cannot show it."""
    plugin = MissionRaw(system)
    at = telemetry.position()
    home = at.latitude_deg, at.longitude_deg
    places = [home, home, *(moved(*home, north, east) for north, east in ((12, 0), (12, 12), (0, 12)))]
    commands = [16, 22, 16, 16, 16]
    items = [
        RawItem(seq, 3 if seq else 0, command, int(seq == 0), 1, 0.0, 0.0, 0.0, 0.0, round(lat * 1e7), round(lon * 1e7),
                8.0 if seq else at.absolute_altitude_m, 0)
        for seq, (command, (lat, lon)) in enumerate(zip(commands, places, strict=True))
    ]  # fmt: skip
    patiently(lambda: plugin.upload_mission(items))
    back = patiently(plugin.download_mission)
    off = [distance_m(place, (i.x / 1e7, i.y / 1e7)) for place, i in list(zip(places, back, strict=False))[2:]]
    same = [item.command for item in back] == commands
    saw("mission", sent=len(items), back=len(back), worst_m=max(off, default=-1.0), same_commands=same)
    try:
        patiently(Mission(system).download_mission)
        saw("mission plugin", result="SUCCESS")
    except MissionError as error:
        saw("mission plugin", result=error.result.name)
    patiently(plugin.start_mission)
    seen = []

    def last():
        now = plugin.mission_progress()
        if now.current not in seen:
            seen.append(now.current)
        return now.total > 0 and now.current == now.total

    until(last, "the end of the mission", TIMEOUT_S)
    saw("flown", items=seen, finished=True)


async def first(stream, good=lambda value: True):
    """The stream's first such value."""

    async def value():
        async for found_one in stream:
            if good(found_one):
                return found_one
        raise SystemExit("the stream ended")

    return await asyncio.wait_for(value(), TIMEOUT_S)


async def in_time(call):
    """As `patiently`, with the other interface."""
    end = asyncio.get_running_loop().time() + TIMEOUT_S
    while True:
        try:
            return await call()
        except MavsdkError as error:
            if error.result.name != "TIMEOUT" or asyncio.get_running_loop().time() > end:
                raise


async def fly_on(system):
    """goto, offboard_position_ned, offboard_velocity_ned, land."""
    action, telemetry, offboard = ActionAsync(system), TelemetryAsync(system), OffboardAsync(system)
    at = await first(telemetry.subscribe_position(), lambda p: isfinite(p.latitude_deg))
    ground = at.absolute_altitude_m - at.relative_altitude_m
    place = moved(at.latitude_deg, at.longitude_deg, 12, 8)
    await in_time(lambda: action.goto_location(*place, ground + 12, 0.0))

    def there(p):
        return distance_m(place, (p.latitude_deg, p.longitude_deg)) < 2 and abs(p.relative_altitude_m - 12) < 2

    await first(telemetry.subscribe_position(), there)
    saw("there")
    await in_time(lambda: telemetry.set_rate_position_velocity_ned(4.0))  # an ArduCopter sends what it is asked for
    await offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -10.0, 0.0))
    await in_time(offboard.start)
    saw("offboard", active=await offboard.is_active())
    await offboard.set_position_ned(PositionNedYaw(5.0, 5.0, -10.0, 90.0))

    def at_goal(odometry):
        p = odometry.position
        return abs(p.north_m - 5) < 1 and abs(p.east_m - 5) < 1 and abs(p.down_m + 10) < 1

    await first(telemetry.subscribe_position_velocity_ned(), at_goal)
    saw("offboard position")
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, -2.0, 0.0, 90.0))
    moving = await first(telemetry.subscribe_position_velocity_ned(), lambda o: o.velocity.east_m_s < -1.5)
    saw("offboard velocity", east_mps=moving.velocity.east_m_s)
    await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
    await in_time(offboard.stop)
    mode = await first(telemetry.subscribe_flight_mode(), lambda mode: mode != FlightMode.OFFBOARD)
    saw("offboard stopped", mode=mode.name)
    await in_time(action.land)
    await first(telemetry.subscribe_armed(), lambda armed: not armed)
    saw("landed")


def main(address, autopilot):
    log_subscribe(lambda level, message, file, line: print(message, file=sys.stderr) or True)
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(address)
    system = found(mavsdk)
    action, telemetry = Action(system), Telemetry(system)
    look(system, telemetry)
    params(system, *(("RTL_RETURN_ALT", 23.0) if autopilot == "px4" else ("WPNAV_SPEED", 800.0)))
    takeoff_and_land(action, telemetry, autopilot == "px4")
    fly_mission = mission if autopilot == "px4" else raw_mission
    fly_mission(system, action, telemetry)
    asyncio.run(fly_on(System(system)))
    saw("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
