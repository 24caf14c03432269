"""Fast DDS, ROS 2's default middleware, reads the fleet and carries goals of skygcs_msgs through."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from ros.conftest import VEHICLES, RosFleet
from ros.fast_dds import built
from support.needed import needs
from support.process import wait_until
from support.system_programs import FAST_DDS

FLIGHT_S = 600
"""A flight takes half a minute; the machine may be slow."""

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@pytest.fixture(scope="module")
def program() -> Path:
    needs("test-ros", *FAST_DDS)
    return built("action_node")


def ran(program: Path, fleet: RosFleet, *words: str) -> dict[str, list[str]]:
    """What the program printed, by the first word of each line."""
    line = [str(program), str(fleet.domain), *words]
    done = subprocess.run(line, capture_output=True, text=True, timeout=FLIGHT_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr + fleet.stderr[-3000:]
    said: dict[str, list[str]] = {}
    for text in done.stdout.splitlines():
        word, _, rest = text.partition(" ")
        said.setdefault(word, []).append(rest)
    return said


def test_the_fleet_and_its_events_are_read(program: Path, fleet: RosFleet) -> None:
    wait_until(lambda: all(_has_place(state) for state in fleet.vehicles().values()), "the estimators have converged")
    said = ran(program, fleet, "fleet")
    count, frame, connected, has_origin = said["fleet"][0].split()
    assert (int(count) >= 4, frame, connected, has_origin) == (True, "map", "1", "1")
    states = fleet.vehicles()
    rows = {row.split()[0]: row.split()[1:] for row in said["vehicle"]}
    assert rows.keys() == set(VEHICLES)
    for name, (sysid, root, autopilot, mode, lat_deg, lon_deg, _) in rows.items():
        state = states[name]
        assert (int(sysid), root, autopilot, mode) == (state["sysid"], f"/{name}", state["autopilot"], state["mode"])
        place = float(lat_deg), float(lon_deg)
        assert place == pytest.approx((state["position"]["lat_deg"], state["position"]["lon_deg"]), abs=1e-5)
    assert said["event"]  # those from before it began


@pytest.mark.parametrize("name", ["alpha", "charlie"])
def test_goals_are_carried_through_and_cancelled(program: Path, fleet: RosFleet, name: str) -> None:
    """A PX4 and an ArduCopter: take-off, a goto with feedback and result, and one that is cancelled on its way."""
    said = ran(program, fleet, "takeoff", f"/{name}", "6")
    assert said["status"] == [f"{SUCCEEDED} {SUCCEEDED}"]
    x, y, _ = fleet.vehicles()[name]["position"]["enu_m"]
    said = ran(program, fleet, "goto", f"/{name}", str(x + 15), str(y), "6")
    assert said["accepted"] == ["1"] and said["status"] == [f"{SUCCEEDED} {SUCCEEDED}"]
    first_m, height_m = map(float, said["first"][0].split())
    assert 10 < first_m < 17 and height_m == pytest.approx(6, abs=1.5)
    count, left_m = said["feedback"][0].split()
    assert int(count) > 10 and float(left_m) < 2.1
    assert said["result"][0].startswith("1 ") and said["result"][0].endswith(" arrived")
    assert fleet.vehicles()[name]["position"]["enu_m"][0] == pytest.approx(x + 15, abs=2.5)

    said = ran(program, fleet, "cancel", f"/{name}", str(x - 25), str(y), "6", "30")
    assert said["cancel"] == ["0 1"] and said["status"] == [f"{CANCELED} {CANCELED}"]
    assert " cancelled: " in said["result"][0] and said["result"][0].startswith("0 ")
    wait_until(lambda: _stands(fleet, name), "it holds")
    assert fleet.vehicles()[name]["position"]["enu_m"][0] > x - 23  # of 25: it was stopped, however late
    assert fleet.call("vehicles.land", targets=name)["outcomes"][name]["ok"]


def test_bytes_that_are_no_goals_and_unknown_goals_harm_nothing(program: Path, fleet: RosFleet) -> None:
    before = fleet.call("ros.status")["report"]["rejected"]
    said = ran(program, fleet, "hostile", "/bravo")
    assert said["unknown"] == ["100"] and said["cancel"] == ["0 0"]
    wait_until(lambda: fleet.call("ros.status")["report"]["rejected"] > before, "requests that were none are counted")
    assert fleet.vehicles()["bravo"]["armed"] is False


def test_a_goal_is_aborted_at_once_when_the_daemon_is_killed(program: Path, tmp_path: Path) -> None:
    """The process of ROS ends with its daemon: what waits for a result gets it before."""
    with RosFleet(tmp_path) as fleet:
        ran(program, fleet, "takeoff", "/alpha", "6")
        x, y, _ = fleet.vehicles()["alpha"]["position"]["enu_m"]
        line = [str(program), str(fleet.domain), "goto", "/alpha", str(x + 40), str(y), "6"]
        with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as client:
            assert client.stdout is not None
            seen = set[str]()
            while not seen >= {"first", "asked"}:  # it flies, and the client waits for the result
                text = client.stdout.readline()
                assert text
                seen.add(text.split()[0])
            fleet.kill()
            killed_at = time.monotonic()
            said = client.stdout.readline(), time.monotonic() - killed_at
            rest = client.stdout.read()
        assert said[0] == f"status {ABORTED} {ABORTED}\n" and said[1] < 5
        assert "result 0 " in rest and "the connection to the daemon is lost" in rest


def _has_place(state: dict[str, Any]) -> bool:
    return (state["position"] or {}).get("lat_deg") is not None


def _stands(fleet: RosFleet, name: str) -> bool:
    return bool(max(abs(v) for v in fleet.vehicles()[name]["position"]["vel_enu_mps"]) < 0.3)
