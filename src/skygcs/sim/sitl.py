"""Autopilot firmware as simulators (software in the loop): how instances are started, and when one is ready. Pure.

Both firmwares get two MAVLink links over UDP on loopback. One goes to the ground station's port. The other goes to the
launcher, which only listens: a ground station may come and go without the launcher losing sight of a vehicle, and the
launcher is no ground station to any failsafe. On request a third goes to another port of the ground station, as the
radio of a vehicle that has Wi-Fi as well; it is a port of its own on the autopilot, with its own streams.

ArduPilot takes all of it as options and a file of default parameters (libraries/AP_HAL_SITL/SITL_cmdline.cpp).
A stock PX4 has fixed ports (14550, 14540+i, 18570+i) in its startup script, but the script searches $PATH for its
parts ("user defined mavlink streams for instances can be in PATH", ROMFS/px4fmu_common/init.d-posix/rcS). Two parts of
our own come first there: `px4-rc.simulator`, before the commander starts, sets the system id, which rcS has just set to
the instance number + 1 and which the commander reads only once; `px4-rc.mavlink` starts our two links and no others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from skygcs.core.geo import Origin, geodetic_from_enu, is_no_place

Autopilot = Literal["px4", "ardupilot"]

Kind = Literal["px4", "px4_plane", "px4_vtol", "ardupilot", "ardupilot_plane", "quadplane", "rover"]


class SitlKind(NamedTuple):
    """Vehicles that a firmware simulates: their family, their name in fleets, their firmware and their model in it."""

    autopilot: Autopilot
    prefix: str
    firmware: str
    model: str


KINDS: Mapping[Kind, SitlKind] = {
    "px4": SitlKind("px4", "px", "PX4", "sihsim_quadx"),
    "px4_plane": SitlKind("px4", "pxplane", "PX4", "sihsim_airplane"),
    "px4_vtol": SitlKind("px4", "pxvtol", "PX4", "sihsim_standard_vtol"),
    "ardupilot": SitlKind("ardupilot", "copter", "ArduCopter", "quad"),
    "ardupilot_plane": SitlKind("ardupilot", "plane", "ArduPlane", "plane"),
    "quadplane": SitlKind("ardupilot", "quadplane", "ArduPlane", "quadplane"),
    "rover": SitlKind("ardupilot", "rover", "Rover", "rover"),
}
"""In the order of their system ids."""

MIN_SPACING_M = 5.0
"""Between homes: PX4's SIH keeps its home in a 32-bit float, a grid of 0.4 m, and GPS errors are a metre or two."""

PX4_LINK_BYTES_PER_S = 4_000_000
"""PX4 scales its stream rates down to this; what its own SITL script asks for."""

PX4_SECOND_BYTES_PER_S = 5_760
"""Byte rate of a second link: that of a telemetry port at 57600 baud."""

WATCH_BYTES_PER_S = 20_000
"""Ample for the five messages a second of the launcher's link."""

WATCHED = ("HEARTBEAT", "SYS_STATUS", "GLOBAL_POSITION_INT", "ESTIMATOR_STATUS")
"""Messages that PX4 sends to the launcher once a second."""

COPTER_STREAMS = ("EXT_STAT", "POSITION", "EXTRA3")
"""ArduPilot's stream groups with SYS_STATUS, GLOBAL_POSITION_INT and EKF_STATUS_REPORT. 4.7 names the second port's
rates MAV2_…, earlier versions SR1_…; what a version does not know it ignores."""

MAV_AUTOPILOT: Mapping[int, Autopilot] = {12: "px4", 3: "ardupilot"}

PREARM_CHECK = 1 << 28
"""MAV_SYS_STATUS_PREARM_CHECK."""

EKF_WANTED = 1 | 4 | 16 | 32
"""Attitude, vertical velocity, absolute horizontal and vertical position: the same bits in ESTIMATOR_STATUS_FLAGS and
EKF_STATUS_FLAGS."""

EKF_CONST_POSITION = 128
"""EKF_STATUS_FLAGS, EKF_CONST_POS_MODE: the position is assumed, not measured. PX4 1.16 sets this bit of its
ESTIMATOR_STATUS at rest as well (ekf2/EKF/ekf_helper.cpp, get_ekf_soln_status), so it counts for ArduPilot only."""


@dataclass(frozen=True, slots=True)
class Home:
    """Initial position and compass heading of a vehicle (PX4's SIH begins with heading north in any case)."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    heading_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Instance:
    """One autopilot to start. ``port`` is its own UDP port for the ground station's link, ``watch_port`` for the
    launcher's, ``own_second_port`` for the ground station's second one (PX4 only: ArduPilot takes any). ``number`` is
    the firmware's instance number."""

    kind: Kind
    sysid: int
    number: int
    home: Home
    port: int = 0
    watch_port: int = 0
    own_second_port: int = 0
    params: Mapping[str, str] = field(default_factory=dict)

    @property
    def autopilot(self) -> Autopilot:
        return KINDS[self.kind].autopilot

    @property
    def name(self) -> str:
        return f"{KINDS[self.kind].prefix}{self.sysid}"


class Ports(NamedTuple):
    """UDP ports on loopback that an instance sends to: the ground station's, the launcher's, and the ground station's
    for a second link (0: there is none)."""

    gcs: int
    listen: int
    second: int = 0


@dataclass(frozen=True, slots=True)
class Launch:
    """Launch of an executable: files to write below the working folder, arguments, and additions to the environment."""

    argv: tuple[str, ...]
    environment: Mapping[str, str]
    files: Mapping[str, str]


def homes(first: Home, count: int, spacing_m: float) -> list[Home]:
    """``count`` places side by side, from the first to the east. Raises ValueError for a spacing that is too small."""
    if not spacing_m >= MIN_SPACING_M:
        raise ValueError(f"spacing {spacing_m:g} m: vehicles stand at least {MIN_SPACING_M:g} m apart")
    origin = Origin(first.lat_deg, first.lon_deg, first.alt_amsl_m)
    places = [geodetic_from_enu(i * spacing_m, 0.0, 0.0, origin) for i in range(count)]
    return [Home(lat, lon, first.alt_amsl_m, first.heading_deg) for lat, lon, _ in places]


def px4_launch(instance: Instance, *, binary: str, etc: str, folder: str, ports: Ports, speedup: float = 1.0) -> Launch:
    """PX4's SIH simulator."""
    scripts = "startup"
    links = [
        "#!/bin/sh",
        "# Written by skygcs sitl; found in PATH before PX4's own file of this name.",
        f"mavlink start -x -u {instance.port} -r {PX4_LINK_BYTES_PER_S} -f -o {ports.gcs}",
        f"mavlink start -u {instance.watch_port} -r {WATCH_BYTES_PER_S} -m custom -o {ports.listen}",
        *(f"mavlink stream -u {instance.watch_port} -s {name} -r 1" for name in WATCHED),
    ]
    if ports.second:
        links.append(f"mavlink start -u {instance.own_second_port} -r {PX4_SECOND_BYTES_PER_S} -o {ports.second}")
    # Logging from boot, as is usual in SITL, writes 200 kB/s to the disk; this logs while armed.
    params = {"SDLOG_MODE": "0", **instance.params}
    before_command_client = [
        "#!/bin/sh",
        "# Written by skygcs sitl; found in PATH before PX4's own file of this name.",
        f"param set MAV_SYS_ID {instance.sysid}",
        # After the airframe's defaults: by PX4_PARAM_… a value that is PX4's default would not outlast `set-default`.
        *(f"param set {name} {value}" for name, value in params.items()),
        '. "${R}etc/init.d-posix/px4-rc.simulator"',
    ]
    environment = {
        "PX4_SIM_MODEL": KINDS[instance.kind].model,
        "PX4_HOME_LAT": f"{instance.home.lat_deg:.8f}",
        "PX4_HOME_LON": f"{instance.home.lon_deg:.8f}",
        "PX4_HOME_ALT": f"{instance.home.alt_amsl_m:.2f}",
    }
    if speedup != 1.0:
        environment["PX4_SIM_SPEED_FACTOR"] = f"{speedup:g}"
    return Launch(
        argv=(binary, "-i", str(instance.number), "-d", "-w", folder, etc),
        environment={**environment, "PATH": f"{folder}/{scripts}"},
        files={
            f"{scripts}/px4-rc.mavlink": "\n".join(links) + "\n",
            f"{scripts}/px4-rc.simulator": "\n".join(before_command_client) + "\n",
        },
    )


def ardupilot_launch(
    instance: Instance, *, binary: str, defaults: str, folder: str, ports: Ports, rc_port: int, speedup: float = 1.0
) -> Launch:
    """ArduPilot's SITL of a program. ``defaults`` is the firmware's own file (copter.parm); ``rc_port`` is where it
    listens for a transmitter, which is nobody's."""
    # parameters: ids, streams and those of the instance
    own = {"SYSID_THISMAV": str(instance.sysid), "MAV_SYSID": str(instance.sysid)}
    streams = {f"{port}_{group}": "1" for port in ("SR1", "MAV2") for group in COPTER_STREAMS}
    lines = [f"{name} {value}" for name, value in {**own, **streams, **instance.params}.items()]
    # options of the program
    home = instance.home
    place = f"{home.lat_deg:.8f},{home.lon_deg:.8f},{home.alt_amsl_m:.2f},{home.heading_deg:g}"
    options: list[tuple[str, str]] = [
        ("--model", KINDS[instance.kind].model),
        ("--speedup", f"{speedup:g}"),
        ("--slave", "0"),
        ("--defaults", f"{defaults},{folder}/skygcs.parm"),
        ("--rc-in-port", str(rc_port)),
        ("-I", str(instance.number)),
        ("--sysid", str(instance.sysid)),
        ("--home", place),
        ("--serial0", f"udpclient:127.0.0.1:{ports.gcs}"),
        ("--serial1", f"udpclient:127.0.0.1:{ports.listen}"),
        ("--serial2", f"udpclient:127.0.0.1:{ports.second}" if ports.second else "none:"),
    ]
    return Launch(
        argv=(binary, *(word for option in options for word in option)),
        environment={},
        files={"skygcs.parm": "\n".join(lines) + "\n"},
    )


def fleet_text(instances: Sequence[Instance], *, port: int, second_port: int = 0) -> str:
    """The fleet file for `skygcs run`. The first home is the origin. ``second_port``: see `Ports`."""
    first = instances[0].home
    lines = [
        "# Written by skygcs sitl.",
        "",
        "[daemon]",
        'log_dir = "logs"',
        "",
        "[origin]",
        f"lat_deg = {first.lat_deg:.8f}",
        f"lon_deg = {first.lon_deg:.8f}",
        f"alt_amsl_m = {first.alt_amsl_m:.2f}",
        "",
        "[links.sitl]",
        'type = "udp_server"',
        'host = "127.0.0.1"',
        f"port = {port}",
        'role = "vehicle"',
        "",
        *_second_link(second_port),
        "# QGroundControl on this computer listens on 14550:",
        "# [links.qgc]",
        '# type = "udp_client"',
        '# host = "127.0.0.1"',
        "# port = 14550",
        '# role = "gcs"',
    ]
    for instance in instances:
        lines += ["", f"[vehicles.{instance.name}]", f"sysid = {instance.sysid}"]
        lines += [f'autopilot = "{instance.autopilot}"']
    return "\n".join(lines) + "\n"


def _second_link(port: int) -> list[str]:
    """Lines of the second link to each vehicle, which costs more than the first, as a radio does; empty without one."""
    if not port:
        return []
    where = [f"port = {port}", 'role = "vehicle"', "cost = 20", ""]
    return ["[links.sitl_second]", 'type = "udp_server"', 'host = "127.0.0.1"', *where]


class Readiness:
    """Statements of one vehicle about itself so far: it is ready when nothing is `missing` any more.

    Ready is: its autopilot's heartbeat, a position, an estimator that measures its position, and its own arming checks
    passed. Once ready it stays ready; arming checks come and go with modes.
    """

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot: Autopilot = autopilot
        self._seen: dict[str, bool] = {}
        self.ready = False

    def on_message(self, name: str, fields: Mapping[str, Any]) -> None:
        """A message of its autopilot component."""
        if name == "HEARTBEAT":
            self._seen["heartbeat"] = MAV_AUTOPILOT.get(int(fields["autopilot"])) == self._autopilot
        elif name == "GLOBAL_POSITION_INT":
            self._seen["position"] = not is_no_place(fields["lat"], fields["lon"])
        elif name in ("ESTIMATOR_STATUS", "EKF_STATUS_REPORT"):
            flags = int(fields["flags"])
            assumed = name == "EKF_STATUS_REPORT" and flags & EKF_CONST_POSITION
            self._seen["estimator"] = flags & EKF_WANTED == EKF_WANTED and not assumed
        elif name == "SYS_STATUS":
            # A firmware that does not report the check is not waited for.
            reported = int(fields["onboard_control_sensors_present"]) & PREARM_CHECK
            self._seen["arming checks"] = not reported or bool(
                int(fields["onboard_control_sensors_health"]) & PREARM_CHECK
            )
        self.ready = self.ready or not self.missing

    @property
    def missing(self) -> list[str]:
        """Return what is not there yet, in the order in which it comes."""
        return [what for what in ("heartbeat", "position", "estimator", "arming checks") if not self._seen.get(what)]


def last_lines(text: str, count: int = 10) -> list[str]:
    """The end of a log for a person: the last lines that are not empty."""
    return [line.rstrip() for line in text.splitlines() if line.strip()][-count:]


def refused_params(log: str, names: Iterable[str]) -> list[str]:
    """Names that PX4's log calls unknown. ArduPilot ignores an unknown name silently."""
    return [name for name in names if f"Parameter {name} not found" in log]
