"""PX4's own topics (px4_msgs) of a PX4's MAVLink messages: /alpha/fmu/out/….

Each converter is the inverse of the stream with which a PX4 makes the message of its topics
(src/modules/mavlink/streams of PX4 1.16). Frames and units are PX4's, which are MAVLink's: NED, FRD, quaternions
(w, x, y, z) that turn FRD into NED. Times are microseconds since the vehicle's boot, as the definitions state. A field
that no message carries has the value that PX4's definition gives to "unknown"; where it gives none, the value of an
estimator that was never reset (0, false, the identity). docs/reference/ros-parity.md lists them.

Some fields come from another message than the one that is converted: `Px4Memory.kept` has its newest while it is
fresh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from skygcs.core.geo import Quaternion, is_no_place, quaternion_from_euler
from skygcs.core.ros.interfaces import Interfaces
from skygcs.core.ros.memory import Sample, number
from skygcs.core.ros.rotations import yaw_of
from skygcs.core.ros.stamps import EPOCH_US, VehicleClock

Fields = Mapping[str, Any]

PX4_TELEMETRY: dict[str, str] = {
    "vehicle_attitude": "px4_msgs/msg/VehicleAttitude",
    "vehicle_global_position": "px4_msgs/msg/VehicleGlobalPosition",
    "vehicle_local_position": "px4_msgs/msg/VehicleLocalPosition",
    "vehicle_odometry": "px4_msgs/msg/VehicleOdometry",
    "battery_status": "px4_msgs/msg/BatteryStatus",
    "vehicle_status": "px4_msgs/msg/VehicleStatus",
}
"""Topics below fmu/out, without the version that `versioned` adds."""

FRESH_NS = 3_000_000_000
"""A value of another message is unknown when it is older: PX4 sends the slowest of them once a second."""

MOVING_FRESH_NS = 500_000_000
"""The same for an attitude that completes a position: at 2 Hz, the slowest that is planned for a radio."""

NAN3 = (math.nan,) * 3
IDENTITY = (1.0, 0.0, 0.0, 0.0)

DISARMED, ARMED = 1, 2
"""VehicleStatus.arming_state. Release 1.14 calls 1 "standby"; it is what it has on the ground as well."""

OFFBOARD_STATE = 14
"""VehicleStatus.NAVIGATION_STATE_OFFBOARD."""

NAV_STATES = {
    (1, 0): 0,
    (2, 0): 1,
    (3, 0): 2,
    (3, 1): 21,
    (3, 2): 6,
    (4, 2): 17,
    (4, 3): 4,
    (4, 4): 3,
    (4, 5): 5,
    (4, 6): 18,
    (4, 8): 19,
    (4, 9): 20,
    (4, 10): 22,
    **{(4, 10 + n): 22 + n for n in range(1, 9)},
    (5, 0): 10,
    (6, 0): OFFBOARD_STATE,
    (7, 0): 15,
    (10, 0): 13,
    (11, 0): 8,
}
"""NAVIGATION_STATE of each main and sub mode of HEARTBEAT.custom_mode (px4_custom_mode.h)."""

NAV_STATE_UNKNOWN = 31
"""NAVIGATION_STATE_MAX: a mode that is not in the table."""

HIL_ENABLED, SAFETY_ARMED = 32, 128
"""MAV_MODE_FLAG."""

STATE_UNINIT, STATE_STANDBY, STATE_CRITICAL = 0, 3, 5
"""MAV_STATE of a PX4's heartbeat: disarmed before and after its checks have passed; armed while a failsafe acts."""

PREARM_CHECK = 0x10000000
"""MAV_SYS_STATUS_PREARM_CHECK."""

ROTARY_WING, FIXED_WING, ROVER = 1, 2, 3
VEHICLE_TYPES = {1: FIXED_WING, 10: ROVER, 11: ROVER, **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), ROTARY_WING)}
"""VehicleStatus.vehicle_type of each MAV_TYPE; of a VTOL it is how it flies now."""

VTOLS = range(19, 26)
TAILSITTERS = (19, 20, 23)
"""MAV_TYPE."""

TO_FIXED_WING, TO_MULTICOPTER, AS_FIXED_WING = 1, 2, 4
"""MAV_VTOL_STATE."""

CELL_UNKNOWN, CELL_CONTINUES = 0xFFFF, 0xFFFE
CELLS = 14
"""Size of BatteryStatus.voltage_cell_v."""

TEMPERATURE_UNKNOWN = 0x7FFF

WARNINGS = {2: 1, 3: 2, 4: 3, 5: 4, 6: 6, 7: 7}
"""BatteryStatus.warning of each MAV_BATTERY_CHARGE_STATE."""

POSE_FRAMES = {1: 1, 20: 2}
VELOCITY_FRAMES = {1: 1, 20: 2, 12: 3, 8: 3}
"""VehicleOdometry's frames of each MAV_FRAME: NED, FRD with a heading of its own, the body's FRD."""

POSE_DIAGONAL = (0, 6, 11, 15, 18, 20)
"""Variances in the upper right triangle of a covariance of 6 by 6, row by row."""

VELOCITY_HORIZ, VELOCITY_VERT, POS_HORIZ_ABS, POS_VERT_ABS, POS_VERT_AGL = 1 << 1, 1 << 2, 1 << 4, 1 << 5, 1 << 6
"""ESTIMATOR_STATUS_FLAGS. A PX4 fills them of the same conditions as its positions: the first two are xy_valid and
z_valid, with those of the velocities; POS_HORIZ_ABS and POS_VERT_AGL lat_lon_valid and terrain_alt_valid; POS_VERT_ABS
means that a height or a vertical velocity is fused (Ekf::get_ekf_soln_status, EKF2::PublishLocalPosition and
PublishGlobalPosition, 1.16)."""

ALTITUDE_FLAGS = POS_VERT_ABS | VELOCITY_VERT
"""The nearest to alt_valid, which is isGlobalVerticalPositionValid: no bit is of the vertical position alone."""

NEVER_SENT_FLAGS = 0xFFFF
"""Flags of an estimator that has never sent any: what it sends is taken as valid."""


@dataclass(slots=True)
class Px4Memory:
    """Memory of one PX4."""

    sysid: int
    clock: VehicleClock = field(default_factory=VehicleClock)
    messages: dict[str, tuple[int, Fields]] = field(default_factory=dict)
    """The newest of each message of PX4_SOURCES: its arrival and its fields."""
    estimator_flags: int = NEVER_SENT_FLAGS
    """ESTIMATOR_STATUS.flags as they came last: what is invalid does not become valid by silence."""

    def after_loss(self) -> Px4Memory:
        """Memory after the connection was lost: its clock, and what its estimator called valid."""
        return Px4Memory(self.sysid, self.clock, estimator_flags=self.estimator_flags)

    def kept(self, name: str, now_ns: int, fresh_ns: int = FRESH_NS) -> Fields | None:
        """The newest message of this name; None: none came, or it is too old."""
        at_ns, fields = self.messages.get(name, (0, None))
        return fields if fields is not None and now_ns - at_ns <= fresh_ns else None

    def stamp_us(self, message_us: int, arrival_ns: int) -> int:
        """The time of a message since boot."""
        stamp_ns = self.clock.stamp_ns(message_us, arrival_ns)
        return message_us if message_us < EPOCH_US else self.clock.boot_us(stamp_ns)


Converter = Callable[[Fields, int, Px4Memory], Iterator[Sample]]
"""``(fields of a MAVLink message, its arrival in nanoseconds since 1970, memory)``: what is published of it."""


class Px4Source(NamedTuple):
    """How a MAVLink message is used: its converter, and the topics that have something of it."""

    convert: Converter
    topics: tuple[str, ...]


def _only_kept(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """A message that completes others."""
    return iter(())


def _stamps(time_us: int, arrival_ns: int, memory: Px4Memory) -> dict[str, int]:
    stamp_us = memory.stamp_us(time_us, arrival_ns)
    return {"timestamp": stamp_us, "timestamp_sample": stamp_us}


# -- attitude


def attitude(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """ATTITUDE, unless ATTITUDE_QUATERNION comes."""
    stamps = _stamps(fields["time_boot_ms"] * 1000, arrival_ns, memory)
    if memory.kept("ATTITUDE_QUATERNION", arrival_ns) is None:
        yield Sample("vehicle_attitude", _attitude(stamps, _orientation("ATTITUDE", fields)))


def attitude_quaternion(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """ATTITUDE_QUATERNION."""
    stamps = _stamps(fields["time_boot_ms"] * 1000, arrival_ns, memory)
    yield Sample("vehicle_attitude", _attitude(stamps, _orientation("ATTITUDE_QUATERNION", fields)))


def _attitude(stamps: dict[str, int], q: Quaternion) -> dict[str, Any]:
    return {**stamps, "q": q, "delta_q_reset": IDENTITY}


def _orientation(name: str, fields: Fields) -> Quaternion:
    if name == "ATTITUDE":
        return quaternion_from_euler(fields["roll"], fields["pitch"], fields["yaw"])
    return fields["q1"], fields["q2"], fields["q3"], fields["q4"]


def _attitude_now(arrival_ns: int, memory: Px4Memory) -> tuple[Quaternion, tuple[float, ...]] | None:
    """The newest attitude, and its rates about the axes of FRD in rad/s; None: it is not fresh."""
    for name in ("ATTITUDE_QUATERNION", "ATTITUDE"):
        fields = memory.kept(name, arrival_ns, MOVING_FRESH_NS)
        if fields is not None:
            return _orientation(name, fields), (fields["rollspeed"], fields["pitchspeed"], fields["yawspeed"])
    return None


# -- position


def global_position_int(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """GLOBAL_POSITION_INT; accuracies and what is valid of ESTIMATOR_STATUS, the geoid of GPS_RAW_INT, the terrain of
    ALTITUDE, whose own altitude_terrain counts from the local frame's origin."""
    alt_m = fields["alt"] / 1e3
    fix, altitude = memory.kept("GPS_RAW_INT", arrival_ns), memory.kept("ALTITUDE", arrival_ns)
    ellipsoid_mm = math.nan if fix is None else fix.get("alt_ellipsoid") or math.nan  # 0: a receiver without it
    geoid_m = math.nan if fix is None else (ellipsoid_mm - fix["alt"]) / 1e3
    bottom_m = _bottom_m(altitude)
    terrain_m = math.nan if altitude is None else altitude["altitude_amsl"] - bottom_m
    has_place, flags = not is_no_place(fields["lat"], fields["lon"]), memory.estimator_flags
    yield Sample(
        "vehicle_global_position",
        {
            **_stamps(fields["time_boot_ms"] * 1000, arrival_ns, memory),
            "lat": fields["lat"] / 1e7,
            "lon": fields["lon"] / 1e7,
            "alt": alt_m,
            "alt_ellipsoid": alt_m + geoid_m,
            "lat_lon_valid": has_place and bool(flags & POS_HORIZ_ABS),
            "alt_valid": has_place and flags & ALTITUDE_FLAGS == ALTITUDE_FLAGS,
            **_accuracy(arrival_ns, memory),
            "terrain_alt": terrain_m,
            "terrain_alt_valid": bool(flags & POS_VERT_AGL) and not math.isnan(terrain_m),
        },
    )


def estimator_status(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """ESTIMATOR_STATUS, which completes the positions."""
    memory.estimator_flags = int(fields["flags"])
    return iter(())


def _bottom_m(altitude: Fields | None) -> float:
    """The distance to the ground of ALTITUDE; NaN when it is not known, which is NaN or negative there."""
    bottom_m: float = math.nan if altitude is None else altitude["bottom_clearance"]
    return bottom_m if bottom_m >= 0 else math.nan


def _accuracy(arrival_ns: int, memory: Px4Memory) -> dict[str, float]:
    status = memory.kept("ESTIMATOR_STATUS", arrival_ns)
    if status is None:
        return {"eph": math.nan, "epv": math.nan}
    return {"eph": status["pos_horiz_accuracy"], "epv": status["pos_vert_accuracy"]}


def local_position_ned(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """LOCAL_POSITION_NED, which a PX4 sends of every estimate, valid or not: ESTIMATOR_STATUS says which; also an
    odometry, unless ODOMETRY comes."""
    stamps = _stamps(fields["time_boot_ms"] * 1000, arrival_ns, memory)
    velocity = {name: fields[name] for name in ("vx", "vy", "vz")}
    flags = memory.estimator_flags
    has_xy, has_z = bool(flags & VELOCITY_HORIZ), bool(flags & VELOCITY_VERT)
    turned = _attitude_now(arrival_ns, memory)
    bottom_m = _bottom_m(memory.kept("ALTITUDE", arrival_ns))
    yield Sample(
        "vehicle_local_position",
        {
            **stamps,
            "xy_valid": has_xy,
            "z_valid": has_z,
            "v_xy_valid": has_xy,
            "v_z_valid": has_z,
            **{name: fields[name] for name in ("x", "y", "z")},
            **velocity,
            "z_deriv": fields["vz"],
            **dict.fromkeys(("ax", "ay", "az", "heading_var", "unaided_heading", "tilt_var"), math.nan),
            "heading": math.nan if turned is None else yaw_of(turned[0]),
            **_reference(memory),
            "dist_bottom_valid": not math.isnan(bottom_m),
            "dist_bottom": bottom_m,
            "dist_bottom_var": math.nan,
            **_accuracy(arrival_ns, memory),
            "evh": math.nan,
            "evv": math.nan,
            **dict.fromkeys(("vxy_max", "vz_max", "hagl_min", "hagl_max", "hagl_max_z", "hagl_max_xy"), math.inf),
        },
    )
    if memory.kept("ODOMETRY", arrival_ns) is None:
        q, rates = ((math.nan,) * 4, NAN3) if turned is None else turned
        yield Sample(
            "vehicle_odometry",
            {
                **stamps,
                "pose_frame": POSE_FRAMES[1],
                "position": (fields["x"], fields["y"], fields["z"]),
                "q": q,
                "velocity_frame": VELOCITY_FRAMES[1],
                "velocity": tuple(velocity.values()),
                "angular_velocity": rates,
                **dict.fromkeys(("position_variance", "orientation_variance", "velocity_variance"), NAN3),
            },
        )


def _reference(memory: Px4Memory) -> dict[str, Any]:
    """The origin of the local frame, once GPS_GLOBAL_ORIGIN has come; it holds until the next one."""
    _, origin = memory.messages.get("GPS_GLOBAL_ORIGIN", (0, None))
    if origin is None:
        return {"ref_lat": math.nan, "ref_lon": math.nan, "ref_alt": math.nan}
    time_us = origin.get("time_usec") or 0
    return {
        "xy_global": True,
        "z_global": True,
        "ref_timestamp": 0 if math.isnan(time_us) or time_us >= EPOCH_US else time_us,
        "ref_lat": origin["latitude"] / 1e7,
        "ref_lon": origin["longitude"] / 1e7,
        "ref_alt": origin["altitude"] / 1e3,
    }


def odometry(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """ODOMETRY."""
    pose, velocity = fields["pose_covariance"], fields["velocity_covariance"]
    variances = [pose[index] for index in POSE_DIAGONAL]
    quality = fields.get("quality", 0)
    yield Sample(
        "vehicle_odometry",
        {
            **_stamps(fields["time_usec"], arrival_ns, memory),
            "pose_frame": POSE_FRAMES.get(fields["frame_id"], 0),
            "position": (fields["x"], fields["y"], fields["z"]),
            "q": fields["q"],
            "velocity_frame": VELOCITY_FRAMES.get(fields["child_frame_id"], 0),
            "velocity": (fields["vx"], fields["vy"], fields["vz"]),
            "angular_velocity": (fields["rollspeed"], fields["pitchspeed"], fields["yawspeed"]),
            "position_variance": variances[:3],
            "orientation_variance": variances[3:],
            "velocity_variance": [velocity[index] for index in POSE_DIAGONAL[:3]],
            "reset_counter": fields["reset_counter"],
            "quality": 0 if math.isnan(quality) else quality,
        },
    )


# -- condition


def heartbeat(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """HEARTBEAT; how a VTOL flies is EXTENDED_SYS_STATE's; of an armed vehicle the checks before arming are
    SYS_STATUS's."""
    base_mode, mode, kind = fields["base_mode"], fields["custom_mode"], fields["type"]
    armed = bool(base_mode & SAFETY_ARMED)
    nav_state = NAV_STATES.get((mode >> 16 & 0xFF, mode >> 24 & 0xFF), NAV_STATE_UNKNOWN)
    extended, system = memory.kept("EXTENDED_SYS_STATE", arrival_ns), memory.kept("SYS_STATUS", arrival_ns)
    vtol = 0 if extended is None or kind not in VTOLS else extended["vtol_state"]
    health = 0 if system is None else system["onboard_control_sensors_health"]
    flies = VEHICLE_TYPES.get(kind, 0)
    if kind in VTOLS:
        flies = FIXED_WING if vtol == AS_FIXED_WING else ROTARY_WING
    yield Sample(
        "vehicle_status",
        {
            "timestamp": memory.clock.boot_us(arrival_ns),
            "arming_state": ARMED if armed else DISARMED,
            "nav_state_user_intention": nav_state,
            "nav_state": nav_state,
            "nav_state_display": nav_state,
            "hil_state": int(bool(base_mode & HIL_ENABLED)),
            "vehicle_type": flies,
            "failsafe": armed and fields["system_status"] == STATE_CRITICAL,
            "is_vtol": kind in VTOLS,
            "is_vtol_tailsitter": kind in TAILSITTERS,
            "in_transition_mode": vtol in (TO_FIXED_WING, TO_MULTICOPTER),
            "in_transition_to_fw": vtol == TO_FIXED_WING,
            "system_type": kind,
            "system_id": memory.sysid,
            "component_id": 1,
            "pre_flight_checks_pass": _checks_pass(armed, fields["system_status"], health),
        },
    )


def _checks_pass(armed: bool, system_status: int, health: int) -> bool:
    """pre_flight_checks_pass: a disarmed PX4 has it in its heartbeat, which comes each second."""
    if not armed and system_status in (STATE_UNINIT, STATE_STANDBY):
        return system_status == STATE_STANDBY
    return bool(health & PREARM_CHECK)


def battery_status(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """BATTERY_STATUS. A PX4 that knows no cells puts the whole battery in the first, or in several that continue; of
    one that is not connected there is no voltage."""
    millivolts = [value for value in fields["voltages"] if value != CELL_UNKNOWN]
    extra = [value for value in fields.get("voltages_ext") or () if value not in (0, CELL_UNKNOWN)]
    known = len(millivolts) > 1 and CELL_CONTINUES not in millivolts
    cells = [value / 1e3 for value in (*millivolts, *extra)][:CELLS] if known else []
    current_a, temperature = fields["current_battery"], fields["temperature"]
    time_s = fields.get("time_remaining") or math.nan
    yield Sample(
        "battery_status",
        {
            **_battery(bool(millivolts), arrival_ns, memory),
            "voltage_v": sum((*millivolts, *extra)) / 1e3,
            "current_a": -1.0 if current_a == -1 else current_a / 100,
            "discharged_mah": float(fields["current_consumed"]),
            "remaining": _fraction(fields["battery_remaining"]),
            "time_remaining_s": time_s,
            "temperature": math.nan if temperature == TEMPERATURE_UNKNOWN else temperature / 100,
            "cell_count": len(cells),
            "id": fields["id"] + 1 & 0xFF,
            "voltage_cell_v": cells + [0.0] * (CELLS - len(cells)),
            "max_cell_voltage_delta": max(cells) - min(cells) if cells else 0.0,
            "faults": int(fields.get("fault_bitmask") or 0) & 0xFFFF,
            "warning": WARNINGS.get(fields.get("charge_state", 0), 0),
        },
    )


def sys_status(fields: Fields, arrival_ns: int, memory: Px4Memory) -> Iterator[Sample]:
    """SYS_STATUS: a battery, unless BATTERY_STATUS comes. Of several it is the weakest, by no number: it is given 1."""
    if memory.kept("BATTERY_STATUS", arrival_ns) is None:
        millivolts, current = fields["voltage_battery"], fields["current_battery"]
        yield Sample(
            "battery_status",
            {
                **_battery(millivolts != CELL_UNKNOWN, arrival_ns, memory),
                "voltage_v": 0.0 if millivolts == CELL_UNKNOWN else millivolts / 1e3,
                "current_a": -1.0 if current == -1 else current / 100,
                "remaining": _fraction(fields["battery_remaining"]),
                "id": 1,
            },
        )


def _battery(connected: bool, arrival_ns: int, memory: Px4Memory) -> dict[str, Any]:
    """A battery of which nothing else is known."""
    unknown = ("current_average_a", "discharged_mah", "scale")
    not_a_number = ("time_remaining_s", "temperature", "nominal_voltage", "remaining_capacity_wh")
    return {
        "timestamp": memory.clock.boot_us(arrival_ns),
        "connected": connected,
        **dict.fromkeys(unknown, -1.0),
        **dict.fromkeys(not_a_number, math.nan),
    }


def _fraction(percent: int) -> float:
    return -1.0 if percent == -1 else percent / 100


_POSITIONS = ("vehicle_global_position", "vehicle_local_position")
_ATTITUDE = ("vehicle_attitude", "vehicle_local_position", "vehicle_odometry")

PX4_SOURCES: Mapping[str, Px4Source] = {
    "HEARTBEAT": Px4Source(heartbeat, ("vehicle_status",)),
    "EXTENDED_SYS_STATE": Px4Source(_only_kept, ("vehicle_status",)),
    "SYS_STATUS": Px4Source(sys_status, ("battery_status", "vehicle_status")),
    "BATTERY_STATUS": Px4Source(battery_status, ("battery_status",)),
    "ATTITUDE": Px4Source(attitude, _ATTITUDE),
    "ATTITUDE_QUATERNION": Px4Source(attitude_quaternion, _ATTITUDE),
    "GLOBAL_POSITION_INT": Px4Source(global_position_int, ("vehicle_global_position",)),
    "GPS_RAW_INT": Px4Source(_only_kept, ("vehicle_global_position",)),
    "ALTITUDE": Px4Source(_only_kept, _POSITIONS),
    "ESTIMATOR_STATUS": Px4Source(estimator_status, _POSITIONS),
    "LOCAL_POSITION_NED": Px4Source(local_position_ned, ("vehicle_local_position", "vehicle_odometry")),
    "GPS_GLOBAL_ORIGIN": Px4Source(_only_kept, ("vehicle_local_position",)),
    "ODOMETRY": Px4Source(odometry, ("vehicle_odometry",)),
}
"""By the name of the MAVLink message."""


def px4_samples(name: str, fields: Fields, arrival_ns: int, memory: Px4Memory) -> list[Sample]:
    """Return what is published of one MAVLink message of a PX4; nothing of most messages.

    ``fields``: as the dialect decodes them; None, which is NaN in JSON, is taken as NaN."""
    source = PX4_SOURCES.get(name)
    if source is None:
        return []
    known = {k: number(v) for k, v in fields.items()}
    made = list(source.convert(known, arrival_ns, memory))
    memory.messages[name] = (arrival_ns, known)
    return made


def versioned(known: Interfaces, topic: str, type_: str) -> str:
    """The topic's name as PX4 has it since 1.16: with the version of its message unless that is 0."""
    try:
        version = known.constant(type_, "MESSAGE_VERSION")
    except KeyError:
        version = 0
    return f"{topic}_v{version}" if version else topic
