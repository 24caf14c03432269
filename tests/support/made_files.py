"""Parameter files, plans and router configurations in every form that other programs write, made here.

The forms are those of other people's files (see `public_data`), the content is made up. What a test expects of a file
stands beside it in that test.
"""

from __future__ import annotations

import functools
import json
import random
import struct
from collections.abc import Callable
from typing import Any

from skygcs.sim.firmware_params import copter_params, px4_params

LAT, LON = 43.7806, -79.4653
REAL32, INT32 = 9, 6


def _float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _params(family: str, count: int) -> dict[str, float | int]:
    """Those that a simulated vehicle of the family has, and made-up ones until there are ``count``."""
    rng = random.Random(family)
    known = px4_params(1) if family == "px4" else copter_params(1)
    found: dict[str, float | int] = {p.name: p.value for p in known if not p.name.startswith(("SYSID", "MAV_SYS"))}
    while len(found) < count:
        name = f"MADE{len(found):04d}_{rng.choice(['P', 'MAX', 'TC', 'OFF'])}"
        found[name] = rng.choice([rng.randrange(-5, 3000), _float32(rng.uniform(-20.0, 20.0))])
    return dict(sorted(found.items()))


def qgroundcontrol_params(family: str, count: int) -> str:
    """Tabs, 18 decimals for floats, a type each, and eight lines of comment."""
    stack = "PX4 Pro" if family == "px4" else "ArduPilot"
    head = ["Onboard parameters for Vehicle 1", "", f"Stack: {stack}", "Vehicle: Made here", "Version: 1.15.4"]
    lines = [f"# {line}".rstrip() for line in [*head, "Git Revision: 0123456789abcdef", ""]]
    lines.append("# Vehicle-Id Component-Id Name Value Type")
    for name, value in _params(family, count).items():
        text = f"{value}\t{INT32}" if isinstance(value, int) else f"{value:.18f}\t{REAL32}"
        lines.append(f"1\t1\t{name}\t{text}")
    return "\n".join(lines) + "\n"


def mavproxy_params(family: str, count: int) -> str:
    """Names in 16 columns, six decimals."""
    return "".join(
        f"{name:<16} {value}\n" if isinstance(value, int) else f"{name:<16} {value:f}\n"
        for name, value in _params(family, count).items()
    )


def seven_digit_params() -> str:
    """As programs write them that know single precision has seven digits."""
    return "".join(f"{name:<16} {value:.7g}\n" for name, value in _params("ardupilot", 60).items())


def commented_params() -> str:
    """Mission Planner's form with a remark behind each, and one without."""
    rows = ["BATT_ARM_VOLT,14.9  # Only arm above this voltage", "BATT_CAPACITY,5200  # mAh", "BATT_CRT_MAH,0"]
    rows += ["FENCE_ALT_MAX,100", "FENCE_RADIUS,300  # metres", "FS_GCS_ENABLE,1", "WPNAV_SPEED,500  # cm/s"]
    return "\n".join(rows) + "\n"


# --- plans


def simple(number: int, command: int, *params: float | None, frame: int = 3, **more: Any) -> dict[str, Any]:
    seven = [*params, *[0] * (7 - len(params))]
    entry = {"autoContinue": True, "command": command, "doJumpId": number, "frame": frame, "params": seven}
    return {**entry, "type": "SimpleItem", **more}


def _at(number: int, command: int = 16, height_m: float = 20.0) -> dict[str, Any]:
    return simple(number, command, 0, 0, 0, None, LAT + number * 1e-4, LON - number * 1e-4, height_m)


def plan(*items: dict[str, Any], version: int = 1, mission_version: int = 2, **sections: Any) -> bytes:
    """QGroundControl's .plan with everything it writes into one."""
    mission = {
        "cruiseSpeed": 15,
        "firmwareType": 12,
        "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5,
        "items": list(items),
        "plannedHomePosition": [LAT, LON, 180.5],
        "vehicleType": 2,
        "version": mission_version,
    }
    fence = {"circles": [], "polygons": [], "version": 2}
    root = {"fileType": "Plan", "geoFence": fence, "groundStation": "QGroundControl", "mission": mission}
    return json.dumps(
        {**root, "rallyPoints": {"points": [], "version": 2}, "version": version, **sections}, indent=4
    ).encode()


CAMERA = {
    "AdjustedFootprintFrontal": 25,
    "AdjustedFootprintSide": 25,
    "CameraName": "Manual (no camera specs)",
    "DistanceToSurface": 50,
    "DistanceToSurfaceRelative": True,
    "version": 1,
}
OUTLINE = [[LAT, LON], [LAT + 5e-4, LON], [LAT + 5e-4, LON + 7e-4], [LAT - 1e-4, LON + 6e-4]]
"""Of a building, and of a field."""


def structure_scan_plan() -> bytes:
    scan = {
        "CameraCalc": CAMERA,
        "EntranceAltitude": 50,
        "GimbalPitch": 0,
        "Layers": 2,
        "ScanBottomAlt": 50,
        "StartFromTop": True,
        "StructureHeight": 100,
        "complexItemType": "StructureScan",
        "polygon": OUTLINE,
        "type": "ComplexItem",
        "version": 3,
    }
    return plan(simple(1, 530, 0, 2, None, None, None, None, None, frame=2), scan)


def survey_plan() -> bytes:
    """Four passes, each with the camera's trigger on and off: twelve stored items."""
    stored = []
    for leg in range(4):
        first = 3 * leg + 2
        stored.append(_at(first, height_m=50))
        stored.append(simple(first + 1, 206, 25 if leg % 2 == 0 else 0, 0, 1, 0, 0, 0, 0, frame=2))
        stored.append(_at(first + 2, height_m=50))
    style = {"CameraCalc": CAMERA, "CameraShots": 6, "HoverAndCapture": False, "Items": stored, "version": 1}
    survey = {
        "TransectStyleComplexItem": style,
        "angle": 0,
        "complexItemType": "survey",
        "polygon": OUTLINE,
        "type": "ComplexItem",
        "version": 5,
    }
    return plan(simple(1, 530, 0, 2, None, None, None, None, None, frame=2), survey)


def fenced_plan() -> bytes:
    """Two polygons, one to stay out of, a circle, a point to return to, and rally points."""
    square = [[LAT + a, LON + b] for a, b in ((-1e-3, -1e-3), (1e-3, -1e-3), (1e-3, 1e-3), (-1e-3, 1e-3))]
    small = [[LAT - 6e-4 + (a - LAT) / 8, LON + 6e-4 + (b - LON) / 8] for a, b in square]
    fence = {
        "breachReturn": [LAT, LON, 30.0],
        "circles": [{"circle": {"center": [LAT, LON], "radius": 250.5}, "inclusion": True, "version": 1}],
        "polygons": [
            {"inclusion": False, "polygon": small, "version": 1},
            {"inclusion": True, "polygon": square, "version": 1},
        ],
        "version": 2,
    }
    rally = {"points": [[LAT, LON + 1e-4, 25], [LAT + 1e-4, LON, 25]], "version": 2}
    items = [_at(1, 22), *(_at(n) for n in range(2, 5)), simple(5, 20, 0, 0, 0, 0, 0, 0, 0, frame=2)]
    return plan(*items, geoFence=fence, rallyPoints=rally)


def plan_without_mission() -> bytes:
    fence = {"polygon": [], "version": 1}
    return json.dumps({"fileType": "Plan", "geoFence": fence, "groundStation": "QGroundControl", "version": 1}).encode()


def old_mission(version: int | str = 2) -> bytes:
    """The .mission of QGroundControl before 3.2: four params and a coordinate."""
    items = [
        {
            "autoContinue": True,
            "command": command,
            "coordinate": [LAT + n * 1e-4, LON, 20 + n],
            "doJumpId": n,
            "frame": 2 if n == 1 else 3,
            "params": [n % 3, 0, 0, 0],
            "type": "SimpleItem",
        }
        for n, command in enumerate((22, 18, 18, 16, 16, 21), 1)
    ]
    home = [LAT, LON, 180]
    return json.dumps(
        {"firmwareType": 3, "groundStation": "QGroundControl", "items": items, "plannedHomePosition": home}
        | {"version": version}
    ).encode()


def waypoints(*rows: tuple[float, ...], home: bool = True, tabs: bool = True) -> bytes:
    """QGC WPL 110; each row is frame, command, four params and a place."""
    lines = ["QGC WPL 110"]
    if home:
        rows = ((0, 16, 0, 0, 0, 0, LAT, LON, 180.079248), *rows)
    for n, (frame, command, *rest) in enumerate(rows):
        cells = [str(n), str(int(n == 0)), str(frame), str(command), *(f"{value:.8f}" for value in rest), "1"]
        lines.append(("\t" if tabs else " ").join(cells))
    return ("\n".join(lines) + "\n").encode()


def _leg(n: int, command: int = 16, frame: int = 3) -> tuple[float, ...]:
    return frame, command, 0, 0, 0, 0, LAT + n * 1e-4, LON - n * 1e-4, 20.0


def fence_waypoints() -> bytes:
    """Mission Planner's: circles to stay within, and a polygon's corners, which say how many they are."""
    corners = [(3, 5001, 5, 0, 0, 0, LAT + a, LON + b, 0) for a, b in ((1, 0), (1, 1), (0, 2), (-1, 1), (-1, 0))]
    corners = [(*c[:6], LAT + (c[6] - LAT) * 1e-3, LON + (c[7] - LON) * 1e-3, 0) for c in corners]
    circles = [(3, 5003, radius_m, 0, 0, 0, LAT, LON, 0) for radius_m in (300.0, 250.5)]
    return waypoints(*circles, *corners)


MISSIONS: dict[str, Callable[[], bytes]] = {
    "made-mission-planner.txt": lambda: waypoints(
        _leg(0, 22, 5), _leg(1, frame=5), _leg(2, frame=5), _leg(3, 20, 5), home=False
    ),
    "made-sample.plan": lambda: plan(_at(1, 22), *(_at(n) for n in range(2, 6)), simple(6, 20, frame=2)),
    "made-structure-scan.plan": structure_scan_plan,
    "made-survey.plan": survey_plan,
    "made-without-mission.plan": plan_without_mission,
    "made-sample.waypoints": lambda: waypoints(_leg(0, 22), _leg(1), _leg(2, 20)),
    "made-fence.waypoints": fence_waypoints,
    "made-spaces.waypoints": lambda: waypoints(*(_leg(n) for n in range(5)), tabs=False),
    "made-old.mission": old_mission,
    "made-oldest.mission": lambda: old_mission("1.0"),
    "made-copter-mission.txt": lambda: waypoints(
        *(_leg(0, 22), _leg(1), (3, 115, 640, 20, 1, 1, 0, 0, 0), _leg(2, 19), (3, 177, 2, 1, 0, 0, 0, 0, 0)),
        _leg(3, 20),
    ),
    "made-fenced.plan": fenced_plan,
    "made-wrong-mission-version.plan": lambda: plan(_at(1), mission_version=7),
    "made-wrong-overall-version.plan": lambda: plan(_at(1), version=42),
}

PARAMS: dict[str, Callable[[], str]] = {
    "made-px4.params": lambda: qgroundcontrol_params("px4", 1100),
    "made-px4-mavproxy.parm": lambda: mavproxy_params("px4", 730),
    "made-copter-mavproxy.parm": lambda: mavproxy_params("ardupilot", 1060),
    "made-copter-seven-digits.param": seven_digit_params,
    "made-copter-comments.param": commented_params,
}

_UDP = "\n[UdpEndpoint {}]\nMode = {}\nAddress = {}\nPort = {}\n"

ROUTERS: dict[str, Callable[[], str]] = {
    "made-companion.conf": lambda: (
        "[General]\n# comments stand anywhere\n\nTcpServerPort = 0\n\n"
        "[UartEndpoint FCUSB]\nDevice = /dev/serial/by-id/usb-Made_FMU-if00\nBaud = 2000000\n"
        + _UDP.format("GCS", "Server", "0.0.0.0", 14550)
        + "".join(_UDP.format(f"local{n}", "Normal", "127.0.0.1", 14551 + n) for n in range(6))
    ),
    "made-small.conf": lambda: (
        "[General]\nDebugLogLevel=info\n[UartEndpoint serial0]\nDevice=/dev/serial0\nBaud=57600,115200\n"
        "FlowControl=true\n[UdpEndpoint local]\nMode=Normal\nAddress=127.0.0.1\nPort=14550\n"
    ),
    "made-eavesdropping.conf": lambda: (
        "[General]\nMavlinkDialect=ardupilotmega\n\n[UartEndpoint to_fc]\nDevice = /dev/serial0\nBaud = 921600\n"
        + _UDP.format("to_all", "eavesdropping", "0.0.0.0", 14550)
        + "PortLock = 0\n"
        + _UDP.format("to_web", "Normal", "127.0.0.1", 14756)
    ),
    "made-every-kind.conf": lambda: (
        "[General]\nTcpServerPort=5790\nReportStats=false\nMavlinkDialect=common\nLog=/var/log/made\n"
        "[UartEndpoint alpha]\nDevice=/dev/ttyS0\nBaud=52000\nAllowMsgIdOut=0,33\nGroup=pair\n"
        "[UdpEndpoint bravo]\nMode=Server\nAddress=0.0.0.0\nPort=10000\nBlockSrcSysIn=7\n"
        "[UdpEndpoint charlie]\nMode=Normal\nAddress=127.0.0.1\nPort=11000\n"
        "[TcpEndpoint delta]\nAddress=127.0.0.1\nPort=25760\nRetryTimeout=10\n"
    ),
}


@functools.cache
def made_file(relative: str) -> bytes | None:
    """Content of "missions/NAME", "params/NAME" or "router/NAME"; None if that is not made here."""
    folder, _, name = relative.partition("/")
    makers: dict[str, Any] = {"missions": MISSIONS, "params": PARAMS, "router": ROUTERS}.get(folder, {})
    if name not in makers:
        return None
    content = makers[name]()
    return content.encode() if isinstance(content, str) else bytes(content)


def made_names(folder: str) -> list[str]:
    return sorted({"missions": MISSIONS, "params": PARAMS, "router": ROUTERS}.get(folder, {}))
