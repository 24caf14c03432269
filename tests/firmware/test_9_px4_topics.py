"""PX4's own topics against the uORB topics in the vehicle, as its console lists them: the other end of the streams."""

from __future__ import annotations

import math
import re
import time
from typing import Any

import pytest

from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.core.ros.px4_telemetry import PX4_SOURCES, PX4_TELEMETRY, Px4Memory, px4_samples
from support.firmware_field import Field

pytestmark = pytest.mark.only("px4")

CLI_S = 120.0

EXACT: dict[str, str] = {
    "vehicle_global_position": "lat_lon_valid alt_valid terrain_alt_valid",
    "vehicle_local_position": "xy_valid z_valid v_xy_valid v_z_valid xy_global z_global ref_timestamp "
    "dist_bottom_valid",
    "vehicle_odometry": "pose_frame velocity_frame",
    "battery_status": "connected id warning faults",
    "vehicle_status": "arming_state nav_state nav_state_user_intention hil_state vehicle_type failsafe is_vtol "
    "is_vtol_tailsitter in_transition_mode in_transition_to_fw system_type system_id component_id "
    "pre_flight_checks_pass",
}
NEAR: dict[str, dict[str, float]] = {
    "vehicle_attitude": {"q": 0.05},
    "vehicle_global_position": {"lat": 2e-5, "lon": 2e-5, "alt": 2, "alt_ellipsoid": 2, "terrain_alt": 2, "eph": 1},
    "vehicle_local_position": dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "eph", "epv", "dist_bottom"), 2.0)
    | {"ref_lat": 1e-6, "ref_lon": 1e-6, "ref_alt": 0.01, "heading": 0.1},
    "vehicle_odometry": {"position": 2, "q": 0.05, "velocity": 1, "position_variance": 1},
    "battery_status": {"voltage_v": 0.5, "remaining": 0.05, "discharged_mah": 20},
}
"""Fields that messages carry. A vehicle that stands moves by the noise of its estimator between the two readings."""

ESTIMATES = ("ESTIMATOR_STATUS", "ALTITUDE", "GPS_RAW_INT", "SYS_STATUS", "EXTENDED_SYS_STATE", "GPS_GLOBAL_ORIGIN")
"""Messages that complete others, so they are converted first."""


def listed(field: Field, topic: str) -> dict[str, list[float]]:
    """The fields of a uORB topic by PX4's command `listener`."""
    done = field.daemon.cli("shell", field.one, f"listener {topic} -n 1", timeout_s=CLI_S)
    assert done.returncode == 0, done.stdout + done.stderr
    found = {}
    for name, text in re.findall(r"^ +(\w+): ([^(\n]*)", done.stdout, re.MULTILINE):
        words = text.strip().strip("[]").replace(",", " ").split()
        found[name] = [{"True": 1.0, "False": 0.0}.get(word) or float(word.replace("False", "0")) for word in words]
    return found


def converted(field: Field) -> dict[str, dict[str, Any]]:
    """What the newest messages become, as a reader decodes it."""
    known, memory = ros2_interfaces(), Px4Memory(field.sysids[0])
    found = {}
    for name in (*ESTIMATES, *(name for name in PX4_SOURCES if name not in ESTIMATES)):
        message = field.daemon.call("messages.latest", target=field.one, name=name)
        for sample in px4_samples(name, message["fields"], time.time_ns(), memory):
            type_ = PX4_TELEMETRY[sample.topic]
            found[sample.topic] = known.decode(type_, known.encode(type_, known.only_known(type_, sample.fields)))
    return found


def numbers(value: Any) -> list[float]:
    return [float(one) for one in (value if isinstance(value, list) else [value])]


def test_topics_are_those_in_the_vehicle(console: Field, figures: dict[str, Any]) -> None:
    for name in sorted(PX4_SOURCES.keys() - {"HEARTBEAT", "GPS_GLOBAL_ORIGIN"}):
        console.order("vehicles.interval", console.one, message=name, rate_hz=5.0)
    console.order("vehicles.request", console.one, message="GPS_GLOBAL_ORIGIN")

    def has_all() -> bool:
        latest = {n: console.daemon.call("messages.latest", target=console.one, name=n) for n in PX4_SOURCES}
        return all(latest.values())

    console.wait(has_all, 60, "every message has come")
    found, compared = converted(console), 0
    assert found.keys() == PX4_TELEMETRY.keys()
    for topic, made in found.items():
        uorb = listed(console, topic)
        for name in EXACT.get(topic, "").split():
            assert numbers(made[name]) == uorb[name], (topic, name)
            compared += 1
        for name, most in NEAR.get(topic, {}).items():
            for mine, theirs in zip(numbers(made[name]), uorb[name], strict=True):
                assert abs(mine - theirs) <= most or (math.isnan(mine) and math.isnan(theirs)), (topic, name)
            compared += 1
    figures["fields of uORB topics compared"] = compared
