"""Preflight of simulated vehicles: every fault put into one is found, by name and figure, and nothing else is."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from skygcs.core.routing.source_statistics import LinkFacts
from skygcs.runtime.preflight_run import examine_fleet
from skygcs.sim import protocol as m
from skygcs.sim.kinematics import Home
from support.preflight_field import PreflightField

pytestmark = pytest.mark.looptime

SETTLE_S = 8.0
"""Until a fault shows: SYS_STATUS comes every two seconds, SYSTEM_TIME every five."""

PARAMS = {
    "SERIAL1_PROTOCOL": {"in": [1, 2], "optional": True},
    "NAV_RCL_ACT": {"in": [0, 2], "optional": True},
    "WPNAV_SPEED": {"min": 200, "max": 1000, "optional": True, "why": "the net"},
}
LAB: dict[str, Any] = {
    "control": {},
    "preflight": {"transmitter": False, "firmware_min": "1.10", "rtl_height_m": [3, 50], "params": PARAMS},
}
"""What a laboratory without transmitters expects, which `right` gives the vehicles."""


def right(field: PreflightField) -> None:
    field.hold("papa", COM_RC_IN_MODE=4, COM_OBL_RC_ACT=5)
    field.hold("echo", GUID_OPTIONS=8, GUID_TIMEOUT=1.0, FS_THR_ENABLE=0)


@dataclass(frozen=True)
class Fault:
    """Put into ``who`` by ``how``; ``found`` are the checks that complain, and what the first of them says."""

    who: str
    found: tuple[str, ...]
    says: str
    how: Callable[[PreflightField], object]


def hold(who: str, check: str, says: str, **params: float) -> tuple[Fault, dict[str, float]]:
    """A fault of parameters, and these."""
    return Fault(who, (check,), says, lambda f: f.hold(who, **params)), params


def vehicle(who: str, found: str, says: str, **faults: Any) -> Fault:
    def how(f: PreflightField) -> None:
        for name, value in faults.items():
            setattr(f.vehicle(who).faults, name, value)

    return Fault(who, tuple(found.split(", ")), says, how)


def far_home(f: PreflightField) -> None:
    f.vehicle("echo").set_home(Home(300.0, 0.0, 0.0))


def stop(f: PreflightField) -> None:
    f.vehicle("papa").faults.mute = True


def heard(**facts: Any) -> Callable[[PreflightField], None]:
    return lambda f: f.heard.update(radio=LinkFacts(**facts))


def two(f: PreflightField) -> None:
    f.fleet.set_duplicate(1 << 8 | 1, "on udp and on radio")


MAG = m.MAV_SYS_STATUS_SENSOR_3D_MAG

FAULTS = {
    "battery low": Fault("papa", ("battery",), "battery 21 %", lambda f: f.vehicle("papa").battery.set_percent(21)),
    "compass broken": vehicle("papa", "sensors", "unhealthy: 3d_mag", unhealthy_sensors=MAG),
    "barometer broken": vehicle(
        "echo", "sensors", "absolute_pressure", unhealthy_sensors=m.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    ),
    "refuses to arm": vehicle("echo", "arming checks", "its own arming checks fail", refuse_arming="Throttle too high"),
    "gps lost": vehicle("papa", "gps fix, estimator, sensors", "GPS fix no fix (at least 3D)", gps_lost=True),
    "gps lost, copter": vehicle("echo", "gps fix, estimator, sensors", "GPS fix no fix", gps_lost=True),
    "few satellites": vehicle("echo", "satellites", "5 satellites (at least 6)", satellites=5),
    "poor geometry": vehicle("papa", "hdop", "HDOP 3.1 (at most 2)", hdop=3.1),
    "clock wrong": vehicle("papa", "clock", "s ahead of ours (at most 5 s)", clock_error_s=60.0),
    "home elsewhere": Fault("echo", ("home",), "m from where it stands", far_home),
    "silent": Fault("papa", ("link",), "no heartbeat", stop),
    "two of one id": Fault("papa", ("duplicate",), "two vehicles with system id 1", two),
}
WRONG_PARAMS = {
    "id changed": hold("papa", "system id", "will be 7 after its next start (MAV_SYS_ID)", MAV_SYS_ID=7),
    "id changed, copter": hold("echo", "system id", "will be 9 after its next start", SYSID_THISMAV=9),
    "other ground station": hold(
        "echo", "gcs id", "SYSID_MYGCS is 252, we are 255", SYSID_MYGCS=252, FS_GCS_ENABLE=1, FS_OPTIONS=0
    ),
    "stays when it is alone": hold("echo", "gcs failsafe", "FS_OPTIONS is 16: in BRAKE", FS_GCS_ENABLE=1),
    "returns too high": hold("papa", "rtl height", "it would return at 60 m (3 to 50 m)", RTL_RETURN_ALT=60.0),
    "returns too high, copter": hold("echo", "rtl height", "at 80 m (3 to 50 m)", RTL_ALT=8000),
    "returns through its fence": hold(
        "echo", "rtl height", "returning would break the fence", FENCE_ENABLE=1, FENCE_ALT_MAX=10.0
    ),
    "fence does nothing": hold(
        "papa", "geofence", "leaving the fence would do nothing", GF_ACTION=0, GF_MAX_HOR_DIST=50
    ),
    "fence only reports": hold("echo", "geofence", "would only be reported", FENCE_ENABLE=1, FENCE_ACTION=0),
    "waits for sticks": hold("papa", "transmitter", "COM_RC_IN_MODE is 1", COM_RC_IN_MODE=1),
    "throttle failsafe": hold("echo", "transmitter", "FS_THR_ENABLE is 1", FS_THR_ENABLE=1),
    "setpoints end too soon": hold("papa", "setpoint timeout", "COM_OF_LOSS_T is 0.3 s", COM_OF_LOSS_T=0.3),
    "leans on": hold("echo", "setpoint timeout", "it keeps its last tilt for that time", GUID_TIMEOUT=3.0),
    "left to nobody": hold("papa", "setpoint loss", "it changes to Position mode", COM_OBL_RC_ACT=0),
    "left to fall": hold("papa", "setpoint loss", "it stops its motors (Disarm) and falls", COM_OBL_RC_ACT=7),
    "thrust is a climb rate": hold("echo", "thrust", "GUID_OPTIONS is 1", GUID_OPTIONS=1),
    "no multirotor": hold("papa", "thrust", "MAV_TYPE is 1", MAV_TYPE=1),
    "telemetry off": hold("echo", "SERIAL1_PROTOCOL", "SERIAL1_PROTOCOL is 5 (must be 1 or 2)", SERIAL1_PROTOCOL=5),
    "wrong action": hold("papa", "NAV_RCL_ACT", "NAV_RCL_ACT is 3 (must be 0 or 2)", NAV_RCL_ACT=3),
    "too fast": hold("echo", "WPNAV_SPEED", "is 1200 (must be 200 to 1000): the net", WPNAV_SPEED=1200.0),
}
FOLLOW_FROM_GPS = {"satellites", "clock", "arming checks"}
"""A vehicle without GPS knows no date, either, and would not arm."""

OF_BOTH = {
    "loss": (heard(loss=0.31, frames=200), ("loss",), "31 % of its frames are lost on radio (at most 20 %)"),
    "few frames": (heard(frames=8), ("loss",), "8 frames so far"),
    "weak radio": (heard(loss=0.0, frames=99, margin_db=6.0), ("radio",), "6 dB above the noise"),
}


async def test_vehicles_as_their_firmware_ships_them_are_ready() -> None:
    async with PreflightField() as field:
        assert await field.complaints("papa") == {}
        assert await field.complaints("echo") == {}


async def assert_found(field: PreflightField, fault: Fault, name: str) -> None:
    """It is found in its vehicle, and nothing else is."""
    found = await field.complaints(fault.who)
    assert set(fault.found) <= set(found), (name, found)
    assert fault.says in found[fault.found[0]], (name, found)
    follows = FOLLOW_FROM_GPS if "gps fix" in fault.found else set()
    assert set(found) - set(fault.found) <= follows, (name, found)


def other(who: str) -> str:
    return "echo" if who == "papa" else "papa"


async def test_wrong_parameters_are_found_and_nothing_else_and_right_ones_make_it_ready() -> None:
    """One after the other, in vehicles as the laboratory wants them."""
    async with PreflightField(defaults=LAB) as field:
        right(field)
        assert await field.complaints("papa") == await field.complaints("echo") == {}
        for name, (fault, params) in WRONG_PARAMS.items():
            before = field.held(fault.who, *params)
            fault.how(field)
            await assert_found(field, fault, name)
            assert await field.complaints(other(fault.who)) == {}, name
            field.hold(fault.who, **before)
        assert await field.complaints("papa") == await field.complaints("echo") == {}


async def test_bad_links_are_found() -> None:
    async with PreflightField(defaults=LAB) as field:
        right(field)
        for name, (how, checks, says) in OF_BOTH.items():
            how(field)
            found = await field.complaints("papa")
            assert tuple(found) == checks and says in found[checks[0]], (name, found)


PAIRS = list(
    itertools.zip_longest(*([name for name, fault in FAULTS.items() if fault.who == who] for who in ("echo", "papa")))
)
"""Each fault of one vehicle beside one of the other's, which must not be told of it."""


@pytest.mark.parametrize("names", PAIRS)
async def test_a_fault_is_found_in_its_vehicle_and_nothing_else(names: tuple[str | None, ...]) -> None:
    faults = {name: FAULTS[name] for name in names if name is not None}
    async with PreflightField(defaults=LAB) as field:
        right(field)
        for fault in faults.values():
            fault.how(field)
        await asyncio.sleep(SETTLE_S)
        for name, fault in faults.items():
            await assert_found(field, fault, name)
            if len(faults) == 1:
                assert await field.complaints(other(fault.who)) == {}, name


async def test_firmware_and_strangers() -> None:
    old = {"preflight": {"firmware_min": "9.0"}}
    async with PreflightField(defaults=old, vehicles={"papa": {"sysid": 1, "autopilot": "ardupilot"}}) as field:
        assert set(await field.complaints("papa")) == {"firmware", "autopilot"}
        found = await field.complaints("v2")
        assert "system id 2 is not in the fleet file" in found["in fleet file"]


async def test_who_is_missing_is_told() -> None:
    named = {"papa": {"sysid": 1}, "echo": {"sysid": 2}, "zulu": {"sysid": 77, "group": "far"}}
    async with PreflightField(vehicles=named) as field:
        told = await examine_fleet(field.fleet, "all")
        assert [name for name, report in told.items() if not report["ok"]] == ["zulu"]
        assert "has not been heard" in (await examine_fleet(field.fleet, "far"))["zulu"]["summary"]
