"""MAVSDK-Python's examples (gRPC, `mavsdk<4`), one after the other: mavsdk_grpc_flight.py CONNECTION px4|ardupilot PORT

telemetry, params, takeoff_and_land, goto, offboard_position_ned, offboard_velocity_ned and mission, on an ArduCopter
mission_raw.
"""

import asyncio
import sys

from mavsdk import System
from mavsdk.mission import MissionError, MissionItem, MissionPlan
from mavsdk.mission_raw import MissionItem as RawItem
from mavsdk.offboard import PositionNedYaw, VelocityNedYaw
from report import distance_m, moved, saw

TIMEOUT_S = 180.0
NAN = float("nan")


async def first(stream, good=lambda value: True):
    """The stream's first such value."""

    async def look():
        async for value in stream:
            if good(value):
                return value
        raise SystemExit("the stream ended")

    return await asyncio.wait_for(look(), TIMEOUT_S)


async def patiently(call):
    """What the call returns; again if it timed out: MAVSDK waits for half a second each time, too short for a slow
    machine.
    """

    async def done():
        while True:
            try:
                return await call()
            except Exception as error:  # a class for each plugin
                if "TIMEOUT" not in str(error):
                    raise

    return await asyncio.wait_for(done(), TIMEOUT_S)


async def until_at(drone, place, height_m):
    def there(p):
        return distance_m(place, (p.latitude_deg, p.longitude_deg)) < 2 and abs(p.relative_altitude_m - height_m) < 2

    await first(drone.telemetry.position(), there)


async def telemetry(drone):
    health = await first(drone.telemetry.health(), lambda h: h.is_global_position_ok and h.is_home_position_ok)
    battery = await first(drone.telemetry.battery())
    gps = await first(drone.telemetry.gps_info(), lambda g: g.num_satellites > 0)
    attitude = await first(drone.telemetry.attitude_euler())
    version = await patiently(drone.info.get_version)
    saw(
        "state",
        armable=health.is_armable,
        battery_v=battery.voltage_v,
        satellites=gps.num_satellites,
        yaw_deg=attitude.yaw_deg,
        version=[version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch],
    )


async def params(drone, name, value):
    before = await patiently(lambda: drone.param.get_param_float(name))
    await patiently(lambda: drone.param.set_param_float(name, value))
    everything = await patiently(drone.param.get_all_params)
    after = await patiently(lambda: drone.param.get_param_float(name))
    counts = len(everything.int_params), len(everything.float_params)
    saw("parameters", ints=counts[0], floats=counts[1], before=before, after=after)


async def up(drone):
    await patiently(lambda: drone.action.set_takeoff_altitude(8.0))
    for _ in range(60):
        try:
            await drone.action.arm()
            break
        except Exception as error:  # its checks need a few seconds after the position is there
            saw("not yet", error=str(error))
            await asyncio.sleep(2)
    await first(drone.telemetry.armed(), bool)
    saw("armed")
    await patiently(drone.action.takeoff)
    await first(drone.telemetry.in_air(), bool)
    await first(drone.telemetry.position(), lambda p: p.relative_altitude_m > 7)
    saw("up")


async def goto(drone):
    at = await first(drone.telemetry.position())
    ground = at.absolute_altitude_m - at.relative_altitude_m
    place = moved(at.latitude_deg, at.longitude_deg, 12, 8)
    await patiently(lambda: drone.action.goto_location(*place, ground + 12, 0))
    await until_at(drone, place, 12)
    saw("there")


async def offboard(drone):
    """Position and velocity, as the two examples do: a setpoint, start, go on."""
    # an ArduCopter sends what it is asked for
    await patiently(lambda: drone.telemetry.set_rate_position_velocity_ned(4.0))
    await drone.offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -10.0, 0.0))
    await patiently(drone.offboard.start)
    saw("offboard", active=await drone.offboard.is_active())
    await drone.offboard.set_position_ned(PositionNedYaw(5.0, 5.0, -10.0, 90.0))

    def at_goal(odometry):
        p = odometry.position
        return abs(p.north_m - 5) < 1 and abs(p.east_m - 5) < 1 and abs(p.down_m + 10) < 1

    await first(drone.telemetry.position_velocity_ned(), at_goal)
    saw("offboard position")
    await drone.offboard.set_velocity_ned(VelocityNedYaw(0.0, -2.0, 0.0, 90.0))
    moving = await first(drone.telemetry.position_velocity_ned(), lambda o: o.velocity.east_m_s < -1.5)
    saw("offboard velocity", east_mps=moving.velocity.east_m_s)
    await drone.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
    await patiently(drone.offboard.stop)
    mode = await first(drone.telemetry.flight_mode(), lambda mode: str(mode) != "OFFBOARD")
    saw("offboard stopped", mode=str(mode))


async def mission(drone):
    at = await first(drone.telemetry.position())
    legs = [moved(at.latitude_deg, at.longitude_deg, north, east) for north, east in ((12, 0), (12, 12), (0, 12))]
    items = [
        MissionItem(
            *leg, 10, 5, True, NAN, NAN, MissionItem.CameraAction.NONE, NAN, NAN, 1.0, NAN, NAN,
            MissionItem.VehicleAction.NONE,
        )
        for leg in legs
    ]  # fmt: skip
    await drone.mission.set_return_to_launch_after_mission(False)
    await patiently(lambda: drone.mission.upload_mission(MissionPlan(items)))
    back = (await patiently(drone.mission.download_mission)).mission_items
    off = [distance_m(leg, (i.latitude_deg, i.longitude_deg)) for leg, i in zip(legs, back, strict=False)]
    saw("mission", sent=len(items), back=len(back), worst_m=max(off, default=-1.0))
    await patiently(drone.mission.start_mission)
    await first(drone.mission.mission_progress(), finished := Finished())
    saw("flown", items=finished.seen, finished=await drone.mission.is_mission_finished())


class Finished:
    """Whether a mission's progress is its end; keeps what was seen."""

    def __init__(self):
        self.seen = []

    def __call__(self, progress):
        if progress.current not in self.seen:
            self.seen.append(progress.current)
        return progress.total > 0 and progress.current == progress.total


async def raw_mission(drone):
    """An ArduCopter's: item 0 is its home. The plugin `mission` cannot show that one: it is not relative to home."""
    at = await first(drone.telemetry.position())
    home = at.latitude_deg, at.longitude_deg
    places = [home, *(moved(*home, north, east) for north, east in ((12, 0), (12, 12), (0, 12)))]
    items = [
        RawItem(seq, 3 if seq else 0, 16, int(seq == 0), 1, 0.0, 0.0, 0.0, 0.0, round(lat * 1e7), round(lon * 1e7),
                10.0 if seq else at.absolute_altitude_m, 0)
        for seq, (lat, lon) in enumerate(places)
    ]  # fmt: skip
    await patiently(lambda: drone.mission_raw.upload_mission(items))
    back = await patiently(drone.mission_raw.download_mission)
    off = [distance_m(place, (i.x / 1e7, i.y / 1e7)) for place, i in list(zip(places, back, strict=False))[1:]]
    saw("mission", sent=len(items), back=len(back), worst_m=max(off, default=-1.0))
    try:
        await patiently(drone.mission.download_mission)
        saw("mission plugin", result="SUCCESS")
    except MissionError as error:
        saw("mission plugin", result=error._result.result.name)
    await patiently(drone.mission_raw.start_mission)
    await first(drone.mission_raw.mission_progress(), finished := Finished())
    saw("flown", items=finished.seen, finished=True)


async def land(drone):
    await patiently(drone.action.land)
    await first(drone.telemetry.in_air(), lambda flying: not flying)
    await first(drone.telemetry.armed(), lambda armed: not armed)
    saw("landed")


async def main(address, autopilot, port):
    drone = System(port=int(port))
    try:
        await fly(drone, address, autopilot)
    finally:  # System ends its server when it is collected, and the interpreter waits for the server before that
        drone._stop_mavsdk_server()
    saw("done")


async def fly(drone, address, autopilot):
    await drone.connect(system_address=address)
    await first(drone.core.connection_state(), lambda state: state.is_connected)
    saw("connected")
    await telemetry(drone)
    await params(drone, *(("RTL_RETURN_ALT", 23.0) if autopilot == "px4" else ("WPNAV_SPEED", 800.0)))
    await up(drone)
    await goto(drone)
    await offboard(drone)
    await (mission if autopilot == "px4" else raw_mission)(drone)
    await land(drone)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
