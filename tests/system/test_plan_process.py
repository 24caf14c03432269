"""A plan from its file to its end with real processes: a daemon with simulated vehicles, and the command line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.plan.plan_json import write_plan_json
from support.hanging import HANG_S
from support.planned import SLOW, timed

pytestmark = pytest.mark.system

CLI = [sys.executable, "-c", "from skygcs.cli.main import main; main()"]
DAEMON = [sys.executable, "-c", "from skygcs.cli.serve import main; main()"]
LONG_S = 240.0

FLEET = """
[daemon]
socket = "{socket}"
log_dir = "{folder}/logs"
record = false

[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0

[links.sim]
type = "simulated"
px4 = 1
ardupilot = 1
dynamics = "kinematic"
"""


class Field:
    """The daemon's process, and what the command line says of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        socket = folder / "s.sock"
        self.environment = {**os.environ, "SKYGCS_SOCKET": str(socket), "COLUMNS": "160", "HOME": str(folder)}
        (folder / "fleet.toml").write_text(FLEET.format(socket=socket, folder=folder))
        command = [*DAEMON, "run", str(folder / "fleet.toml")]
        with open(folder / "daemon.log", "wb") as log:
            self.daemon = subprocess.Popen(command, env=self.environment, stdout=log, stderr=log)
        self.until(lambda: len(self.json("status") or []) == 2)

    def until(self, condition: Any) -> None:
        end = time.monotonic() + LONG_S
        while not condition():
            assert time.monotonic() < end and self.daemon.poll() is None, (self.folder / "daemon.log").read_text()
            time.sleep(0.5)

    def start(self, *args: str) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        return subprocess.Popen([*CLI, *args], env=self.environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def code(self, *args: str) -> int:
        """The exit code of a command that is waited for."""
        with self.start(*args) as process:
            process.communicate(timeout=LONG_S)
            return process.returncode

    def json(self, *args: str) -> Any:
        out, _ = self.start(*args, "--json").communicate(timeout=LONG_S)
        return json.loads(out) if out.strip() else None

    def state(self) -> str:
        return str((self.json("plan", "status") or {}).get("state"))

    def stop(self) -> None:
        self.daemon.send_signal(signal.SIGTERM)
        self.daemon.wait(timeout=HANG_S)


@pytest.fixture
def field(tmp_path: Path) -> Iterator[Field]:
    found = Field(tmp_path)
    try:
        yield found
    finally:
        found.stop()


def written(folder: Path) -> str:
    starts = {"v1": (0.0, 0.0, 5.0), "v2": (5.0, 0.0, 5.0)}
    plan = timed(starts, {name: (x, 8.0, up) for name, (x, _, up) in starts.items()}, SLOW)
    (folder / "north.json").write_text(write_plan_json(plan, FlightSpace()))
    return str(folder / "north.json")


def test_a_plan_is_flown_by_the_command_line_and_lands(field: Field) -> None:
    path = written(field.folder)
    run = ("plan", "run", path, "--margin", "2.5", "--force")
    # the estimators have to converge: until then positions and preflight are refused
    field.until(lambda: field.code(*run, "--dry-run") == 0)
    out, err = field.start(*run).communicate(timeout=LONG_S)
    assert "finished: all are at their goals and hold" in out, out + err
    assert field.state() == "finished"
    places = {state["name"]: state["position"]["enu_m"] for state in field.json("status")}
    assert abs(places["v1"][1] - 8.0) < 1.0 and abs(places["v2"][1] - 8.0) < 1.0
    assert field.code("plan", "land") == 0
    assert field.code("plan", "watch") == 0
    assert field.state() == "landed"


def test_a_plan_that_no_request_holds_is_checked_and_loaded_in_parts(field: Field) -> None:
    """A hundred vehicles with two hundred pieces each, of which two are there."""
    plan = field.folder / "large.json"
    plan.write_text(large_plan(100, 200))
    assert plan.stat().st_size > 1 << 20
    checked = field.json("plan", "check", str(plan), "--fleet", "--margin", "2.5")
    assert checked["certified"] and checked["vehicles"] == 100, checked
    run = ("plan", "run", str(plan), "v1,v2", "--margin", "2.5", "--force", "--dry-run")
    field.until(lambda: field.json(*run)["certificate"] is not None)
    report = field.json(*run)
    assert report["certificate"]["certified"] and report["certificate"]["vehicles"] == 2, report
    status = field.json("plan", "status")
    assert (status["name"], status["state"]) == ("large", "loaded")


def large_plan(count: int, pieces: int) -> str:
    """Each vehicle flies 0.17 m to and fro, by cubics that begin and end at rest, 12 m from its neighbours; the first
    two as far apart as they stand."""
    vehicles = {}
    for i in range(count):
        east_m, north_m = (5.0 * i, 0.0) if i < 2 else (12.0 * (i % 10), 12.0 * (1 + i // 10))
        there_m = east_m + 4.0 * 0.123456789012 - 8.0 * 0.041152263004
        there = [2.0, [east_m, 0.0, 0.123456789012, -0.041152263004], [north_m], [10.0], None]
        back = [2.0, [there_m, 0.0, -0.123456789012, 0.041152263004], [north_m], [10.0], None]
        vehicles[f"v{i + 1}"] = [there, back] * (pieces // 2)
    return json.dumps({"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": vehicles})


def test_ctrl_c_without_a_terminal_aborts_and_the_vehicles_hold(field: Field) -> None:
    run = ("plan", "run", written(field.folder), "--margin", "2.5", "--force")
    field.until(lambda: field.code(*run, "--dry-run") == 0)
    process = field.start(*run)
    field.until(lambda: field.state() == "flying")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=LONG_S)
    assert process.returncode == 1 and "stopping for good" in err, out + err
    assert field.state() == "aborted"
