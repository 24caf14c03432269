"""Fast DDS, ROS 2's default middleware, reads the topics of three vehicles, calls services and flies."""

from __future__ import annotations

import subprocess
from collections import defaultdict
from pathlib import Path

import pytest

from ros.conftest import VEHICLES, RosFleet
from ros.fast_dds import built
from support.needed import needs
from support.process import wait_until
from support.system_programs import FAST_DDS

FLIGHT_S = 600
"""A flight takes half a minute; the machine may be slow."""


@pytest.fixture(scope="module")
def program() -> Path:
    needs("test-ros", *FAST_DDS)
    return built("offboard_node")


def ran(program: Path, fleet: RosFleet, *words: str) -> subprocess.CompletedProcess[str]:
    line = [str(program), str(fleet.domain), *words]
    return subprocess.run(line, capture_output=True, text=True, timeout=FLIGHT_S, check=False)


def test_every_vehicle_is_read(program: Path, fleet: RosFleet) -> None:
    done = ran(program, fleet, "echo", "20", *(f"/{name}/mavros" for name in VEHICLES))
    found: dict[str, set[str]] = defaultdict(set)
    values: dict[tuple[str, str], list[str]] = {}
    for line in done.stdout.splitlines():
        namespace, topic, *rest = line.split(" ")
        found[namespace].add(topic.partition(":")[0])
        values[namespace, topic.partition(":")[0]] = rest
    topics = {"state", "imu/data", "local_position/pose", "global_position/global", "battery"}
    assert found == {f"/{name}/mavros": topics for name in VEHICLES}
    states = fleet.vehicles()
    for name in VEHICLES:
        stamp, frame, lat, lon, *_ = values[f"/{name}/mavros", "global_position/global"]
        assert frame == f"{name}/base_link" and float(stamp) > 1e9
        assert float(lat) == pytest.approx(states[name]["position"]["lat_deg"], abs=1e-5)
        assert float(lon) == pytest.approx(states[name]["position"]["lon_deg"], abs=1e-5)
        assert values[f"/{name}/mavros", "state"][2] == "1"  # connected


@pytest.mark.parametrize(("name", "land"), [("alpha", "AUTO.LAND"), ("charlie", "LAND")])
def test_an_offboard_node_flies_a_square_and_lands(program: Path, fleet: RosFleet, name: str, land: str) -> None:
    """A PX4 and an ArduCopter, by the node that MAVROS' documentation has: stream, OFFBOARD, arm, fly, land."""
    done = ran(program, fleet, "fly", f"/{name}/mavros", land)
    assert done.returncode == 0, done.stdout + fleet.stderr[-3000:]
    assert done.stdout.count("mode OFFBOARD") == 5


def test_a_px4_node_flies_a_square_and_lands(program: Path, fleet: RosFleet) -> None:
    """PX4's offboard_control example by its own topics; values of its telemetry are those of the daemon."""
    done = ran(program, fleet, "px4", "/alpha")
    assert done.returncode == 0, done.stdout + fleet.stderr[-3000:]
    assert done.stdout.count("nav_state 14") == 4
    place = fleet.vehicles()["alpha"]["position"]  # it has landed where it began
    values = {word: rest.split() for word, _, rest in (line.partition(" ") for line in done.stdout.splitlines())}
    lat_deg, lon_deg, alt_m = map(float, values["global"])
    assert (lat_deg, lon_deg) == pytest.approx((place["lat_deg"], place["lon_deg"]), abs=1e-5)
    assert alt_m == pytest.approx(place["alt_amsl_m"] + 4, abs=1)
    assert values["odometry"][0] == "1" and float(values["odometry"][3]) == pytest.approx(-4, abs=0.7)
    assert float(values["q"][0]) == pytest.approx(1, abs=0.05)  # level, its nose to the north
    assert float(values["battery"][0]) > 5 and 0 < float(values["battery"][1]) <= 1
    assert {"ack 176 0", "ack 400 0", "ack 21 0"} <= set(done.stdout.splitlines())


def test_a_node_killed_in_flight_leaves_the_vehicle_hovering(program: Path, fleet: RosFleet) -> None:
    line = [str(program), str(fleet.domain), "fly", "/bravo/mavros", "AUTO.LAND"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as node:
        assert node.stdout is not None
        for text in node.stdout:
            if text.startswith("corner 0 4"):
                break
        node.kill()
    held = wait_until(lambda: _still(fleet, "bravo"), "it stays where it is")
    assert held["armed"] and held["landed"] == "in_air" and held["position"]["alt_rel_m"] > 2
    wait_until(lambda: _still(fleet, "bravo"), "and still does")
    assert fleet.call("vehicles.land", targets="bravo")["outcomes"]["bravo"]["ok"]


def _still(fleet: RosFleet, name: str) -> dict[str, object] | None:
    state = fleet.vehicles()[name]
    speed = max(abs(v) for v in state["position"]["vel_enu_mps"])
    return state if speed < 0.3 and (state["control"] or {}).get("reasons") is not None else None
