"""How firmware instances are started, and when one counts as ready."""

from __future__ import annotations

import math
import tomllib

import pytest

from skygcs.sim.sitl import (
    Home,
    Instance,
    Ports,
    Readiness,
    ardupilot_launch,
    fleet_text,
    homes,
    last_lines,
    px4_launch,
    refused_params,
)
from support.table import each

HOME = Home(43.7806, -79.4653, 180.0, 90.0)
PREARM = 1 << 28
PX4 = Instance("px4", 21, 7, HOME, port=40001, watch_port=40002, params={"COM_DISARM_PRFLT": "30"})
COPTER = Instance("ardupilot", 22, 0, HOME, params={"FS_GCS_ENABLE": "1"})


def test_homes_stand_side_by_side_to_the_east() -> None:
    places = homes(HOME, 3, 5.0)
    east_m = [(p.lon_deg - HOME.lon_deg) * 111_320 * math.cos(math.radians(HOME.lat_deg)) for p in places]
    assert east_m == pytest.approx([0.0, 5.0, 10.0], abs=0.05)
    assert {p.heading_deg for p in places} == {90.0}


@each("spacing_m", [4.9, 0.0, -5.0, math.nan])
def test_homes_nearer_than_the_grid_of_a_float_are_refused(spacing_m: float) -> None:
    with pytest.raises(ValueError, match="at least 5 m apart"):
        homes(HOME, 2, spacing_m)


def test_px4_gets_its_links_and_system_id_by_parts_of_its_own_startup() -> None:
    launch = px4_launch(
        PX4, binary="/p/bin/px4", etc="/p/etc", folder="/w/px21", ports=Ports(50001, 50002), speedup=2.0
    )
    assert launch.argv == ("/p/bin/px4", "-i", "7", "-d", "-w", "/w/px21", "/p/etc")
    assert launch.environment["PATH"] == "/w/px21/startup"
    assert launch.environment["PX4_SIM_SPEED_FACTOR"] == "2"
    links = launch.files["startup/px4-rc.mavlink"].splitlines()
    assert "mavlink start -x -u 40001 -r 4000000 -f -o 50001" in links
    assert "mavlink start -u 40002 -r 20000 -m custom -o 50002" in links
    early = launch.files["startup/px4-rc.simulator"].splitlines()
    assert early.index("param set MAV_SYS_ID 21") < early.index('. "${R}etc/init.d-posix/px4-rc.simulator"')
    assert "param set COM_DISARM_PRFLT 30" in early
    assert "param set SDLOG_MODE 0" in early


def test_a_px4_logs_as_the_user_says() -> None:
    instance = Instance("px4", 1, 0, HOME, params={"SDLOG_MODE": "1"})
    launch = px4_launch(instance, binary="b", etc="e", folder="f", ports=Ports(1, 2))
    assert [line for line in launch.files["startup/px4-rc.simulator"].splitlines() if "SDLOG" in line] == [
        "param set SDLOG_MODE 1"
    ]


def test_copter_gets_both_links_and_its_parameters() -> None:
    launch = ardupilot_launch(
        COPTER,
        binary="/a/arducopter",
        defaults="/a/copter.parm",
        folder="/w/copter22",
        ports=Ports(50001, 50002),
        rc_port=50003,
    )
    words = launch.argv
    options = dict(zip(words[1::2], words[2::2], strict=True))
    assert options["--serial0"] == "udpclient:127.0.0.1:50001"
    assert options["--serial1"] == "udpclient:127.0.0.1:50002"
    assert options["--sysid"] == "22"
    assert options["--home"] == "43.78060000,-79.46530000,180.00,90"
    assert options["--defaults"] == "/a/copter.parm,/w/copter22/skygcs.parm"
    assert "FS_GCS_ENABLE 1" in launch.files["skygcs.parm"].splitlines()


def test_a_second_link_is_a_port_of_its_own_on_each_autopilot() -> None:
    px4 = px4_launch(
        Instance("px4", 1, 0, HOME, own_second_port=40003),
        binary="b",
        etc="e",
        folder="f",
        ports=Ports(50001, 50002, second=50004),
    )
    assert px4.files["startup/px4-rc.mavlink"].splitlines()[-1] == "mavlink start -u 40003 -r 5760 -o 50004"
    copter = ardupilot_launch(COPTER, binary="b", defaults="d", folder="f", ports=Ports(1, 2, 50004), rc_port=3)
    assert copter.argv[copter.argv.index("--serial2") + 1] == "udpclient:127.0.0.1:50004"
    fleet = tomllib.loads(fleet_text([PX4, COPTER], port=50001, second_port=50004))
    assert fleet["links"]["sitl_second"]["port"] == 50004
    assert "sitl_second" not in fleet_text([PX4], port=50001)


def test_the_fleet_file_is_one(tmp_path: object) -> None:
    fleet = tomllib.loads(fleet_text([PX4, COPTER], port=50001))
    assert fleet["links"]["sitl"]["port"] == 50001
    assert {name: v["sysid"] for name, v in fleet["vehicles"].items()} == {"px21": 21, "copter22": 22}


def heartbeat(autopilot: int) -> dict[str, int]:
    return {"autopilot": autopilot, "type": 2}


def status(*, health: int, present: int = PREARM) -> dict[str, int]:
    return {"onboard_control_sensors_present": present, "onboard_control_sensors_health": health}


def test_ready_is_when_everything_was_said() -> None:
    readiness = Readiness("ardupilot")
    steps = [
        ("HEARTBEAT", heartbeat(3), ["position", "estimator", "arming checks"]),
        ("GLOBAL_POSITION_INT", {"lat": 40, "lon": -7}, ["position", "estimator", "arming checks"]),
        ("GLOBAL_POSITION_INT", {"lat": 437806000, "lon": -794653000}, ["estimator", "arming checks"]),
        ("EKF_STATUS_REPORT", {"flags": 167}, ["estimator", "arming checks"]),
        ("EKF_STATUS_REPORT", {"flags": 831}, ["arming checks"]),
        ("SYS_STATUS", status(health=0), ["arming checks"]),
        ("SYS_STATUS", status(health=PREARM), []),
    ]
    for name, fields, missing in steps:
        assert not readiness.ready
        readiness.on_message(name, fields)
        assert readiness.missing == missing
    assert readiness.ready
    readiness.on_message("SYS_STATUS", status(health=0))
    assert readiness.ready


def test_another_firmware_under_the_same_id_is_not_ready() -> None:
    readiness = Readiness("px4")
    readiness.on_message("HEARTBEAT", heartbeat(3))
    assert readiness.missing[0] == "heartbeat"


def test_px4_at_rest_counts_although_it_says_constant_position() -> None:
    readiness = Readiness("px4")
    readiness.on_message("ESTIMATOR_STATUS", {"flags": 1023})
    assert "estimator" not in readiness.missing


def test_a_firmware_without_the_arming_bit_is_not_waited_for() -> None:
    readiness = Readiness("ardupilot")
    readiness.on_message("SYS_STATUS", status(health=0, present=0))
    assert "arming checks" not in readiness.missing


def test_log_ends_and_unknown_parameters() -> None:
    log = "a\n\n" + "\n".join(str(i) for i in range(20)) + "\nERROR [param] Parameter NO_SUCH not found.\n"
    assert last_lines(log, 2) == ["19", "ERROR [param] Parameter NO_SUCH not found."]
    assert refused_params(log, ["NO_SUCH", "NO_SUC", "OTHER"]) == ["NO_SUCH"]
