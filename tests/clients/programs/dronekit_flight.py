"""DroneKit's examples, one after the other: dronekit_flight.py CONNECTION px4|ardupilot

vehicle_state, simple_goto, guided_set_speed_yaw, mission_basic; on a PX4 that of its guide, a mission by base modes.
"""

import collections
import collections.abc
import sys

collections.MutableMapping = collections.abc.MutableMapping  # DroneKit 2.9.2 is of a time when it was there

from dronekit import Command, LocationGlobalRelative, TimeoutError, VehicleMode, connect  # noqa: E402
from pymavlink import mavutil  # noqa: E402
from report import distance_m, moved, saw, until  # noqa: E402

m = mavutil.mavlink


def place(vehicle):
    at = vehicle.location.global_relative_frame
    return at.lat, at.lon


def near(vehicle, target, height_m):
    at = vehicle.location.global_relative_frame
    return at.alt is not None and distance_m((at.lat, at.lon), target) < 2 and abs(at.alt - height_m) < 2


def vehicle_state(vehicle, name, value):
    """The example of this name: attributes, parameters, home."""
    until(lambda: vehicle.location.global_frame.lat, "a position")
    until(lambda: vehicle.battery and vehicle.battery.voltage, "a battery")
    until(lambda: vehicle.gps_0.fix_type and vehicle.gps_0.fix_type >= 3, "a fix")
    saw(
        "state",
        version=str(vehicle.version),
        fix=vehicle.gps_0.fix_type,
        battery_v=vehicle.battery.voltage,
        heading=vehicle.heading,
        pitch=vehicle.attitude.pitch,
        mode=vehicle.mode.name,
        armed=vehicle.armed,
        status=vehicle.system_status.state,
    )
    before = vehicle.parameters[name]
    vehicle.parameters[name] = value
    until(lambda: vehicle.parameters[name] == value, f"{name} is set")
    saw("parameters", count=len(vehicle.parameters), before=before, after=vehicle.parameters[name])


def download(vehicle):
    def received():
        vehicle.commands.download()
        try:
            vehicle.commands.wait_ready(timeout=20)
        except TimeoutError:
            vehicle._ready_attrs.add("commands")  # else it waits for the first answer before it asks again
            return False
        return True

    until(received, "download")
    return list(vehicle.commands)


def upload(vehicle, items, home):
    """Up and down again. What DroneKit has first in a mission it calls home and does not show (`Commands.__len__`,
    `__getitem__`): that is there with ``home``, else the first item.
    """
    commands = vehicle.commands
    commands.clear()
    for item in items:
        commands.add(item)

    def sent():  # it asks once only, and an autopilot gives up after a few seconds
        try:
            commands.upload(timeout=20)
        except TimeoutError:
            return False
        return True

    until(sent, "upload")
    back = download(vehicle)
    kept = items if home else items[1:]
    off = [distance_m((a.x, a.y), (b.x, b.y)) for a, b in zip(kept, back, strict=False)]
    same = [item.command for item in kept] == [item.command for item in back]
    saw("mission", sent=len(items), shown=len(back), same_commands=same, worst_m=max(off, default=-1.0))


def waypoint(command, lat, lon, height_m):
    return Command(0, 0, 0, m.MAV_FRAME_GLOBAL_RELATIVE_ALT, command, 0, 1, 0, 0, 0, 0, lat, lon, height_m)


def progress(vehicle, last):
    """What `commands.next` said until this item."""
    seen = []

    def look():
        if vehicle.commands.next not in seen:
            seen.append(vehicle.commands.next)
        return vehicle.commands.next == last

    until(look, f"item {last}")
    return seen


def set_mode(vehicle, name):
    vehicle.mode = VehicleMode(name)
    until(lambda: vehicle.mode.name == name, f"mode {name}; it is {vehicle.mode.name}")
    saw("mode", name=name)


def arm(vehicle):
    until(lambda: vehicle.is_armable, "armable", pause_s=1)
    vehicle.armed = True

    def armed():
        if not vehicle.armed:
            vehicle.armed = True
        return vehicle.armed

    until(armed, "armed", pause_s=2)
    saw("armed")


def copter(vehicle):
    home = place(vehicle)
    set_mode(vehicle, "GUIDED")
    arm(vehicle)
    vehicle.simple_takeoff(10)
    until(lambda: vehicle.location.global_relative_frame.alt > 9.5, "10 m")
    saw("up", height_m=vehicle.location.global_relative_frame.alt)

    vehicle.airspeed = 3
    target = moved(*home, 20, 10)
    vehicle.simple_goto(LocationGlobalRelative(*target, 15))
    until(lambda: near(vehicle, target, 15), "simple_goto's target")
    saw("there")

    def velocity():
        message = vehicle.message_factory.set_position_target_local_ned_encode(
            0, 0, 0, m.MAV_FRAME_LOCAL_NED, 0b0000111111000111, 0, 0, 0, 0, -2, 0, 0, 0, 0, 0, 0
        )
        vehicle.send_mavlink(message)
        return vehicle.velocity[1] < -1.5

    until(velocity, "2 m/s to the west", pause_s=0.5)
    saw("velocity", east_mps=vehicle.velocity[1])
    vehicle.send_mavlink(
        vehicle.message_factory.command_long_encode(0, 0, m.MAV_CMD_CONDITION_YAW, 0, 90, 0, 1, 0, 0, 0, 0)
    )

    lat, lon = place(vehicle)
    legs = [moved(lat, lon, north, east) for north, east in ((12, 0), (12, 12), (0, 12))]
    download(vehicle)
    if not vehicle._wploader.count():  # an ArduCopter takes the first item for home, and this one had no mission yet
        vehicle._wploader.add(waypoint(m.MAV_CMD_NAV_WAYPOINT, lat, lon, 0))
    items = [waypoint(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 10)]
    items += [waypoint(m.MAV_CMD_NAV_WAYPOINT, *leg, 11) for leg in legs]
    items.append(waypoint(m.MAV_CMD_NAV_WAYPOINT, *legs[-1], 11))  # a dummy, as in the example
    upload(vehicle, items, home=True)
    vehicle.commands.next = 0
    set_mode(vehicle, "AUTO")
    saw("flown", items=progress(vehicle, len(items)))
    set_mode(vehicle, "LAND")
    until(lambda: not vehicle.armed, "landed and disarmed")
    saw("landed", height_m=vehicle.location.global_relative_frame.alt)


def px4(vehicle):
    """mission_basic of DroneKit's PX4 guide: modes by base mode, the mission is armed on the ground."""
    lat, lon = place(vehicle)
    legs = [moved(lat, lon, north, east) for north, east in ((10, 0), (10, 10), (0, 10))]
    items = [waypoint(m.MAV_CMD_NAV_TAKEOFF, lat, lon, 10)]
    items += [waypoint(m.MAV_CMD_NAV_WAYPOINT, *leg, 10) for leg in legs]
    items.append(waypoint(m.MAV_CMD_NAV_LAND, *legs[-1], 0))
    upload(vehicle, items, home=False)
    master = vehicle._master

    def mission_mode():
        master.mav.command_long_send(
            master.target_system, master.target_component, m.MAV_CMD_DO_SET_MODE, 0, 4, 0, 0, 0, 0, 0, 0
        )
        return vehicle.mode.name == "MISSION"

    until(mission_mode, "MISSION by base mode", pause_s=1)
    saw("mode", name=vehicle.mode.name)
    until(lambda: vehicle.gps_0.fix_type >= 3, "a fix")

    def armed():
        vehicle.armed = True
        return vehicle.armed

    until(armed, "armed", pause_s=2)
    saw("armed")
    saw("flown", items=progress(vehicle, len(items) - 1))
    until(lambda: not vehicle.armed, "landed and disarmed")
    saw("landed", height_m=vehicle.location.global_relative_frame.alt)


def main(address, autopilot):
    vehicle = connect(address, wait_ready=True, timeout=120, heartbeat_timeout=120)
    saw("connected", system=vehicle._master.target_system, firmware=vehicle.version.autopilot_type)
    if autopilot == "px4":
        vehicle_state(vehicle, "RTL_RETURN_ALT", 22)
        px4(vehicle)
    else:
        vehicle_state(vehicle, "RTL_ALT", 2200)
        copter(vehicle)
    vehicle.close()
    saw("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
