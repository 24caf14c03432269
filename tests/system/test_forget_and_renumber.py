"""A real daemon and the command line: a simulated vehicle gets another system id, goes, and is forgotten."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from support.process import DaemonProcess, wait_until

pytestmark = pytest.mark.system

FLEET = """vehicle_timeout_s = 1
record = false
[links.sim]
type = "simulated"
px4 = 1
[links.other]
type = "simulated"
ardupilot = 1
first_sysid = 2
[vehicles.papa]
sysid = 1
group = "scouts"
"""


def test_a_vehicle_is_renumbered_and_a_ghost_forgotten(tmp_path: Path) -> None:
    with DaemonProcess(tmp_path, FLEET) as daemon:
        wait_until(lambda: daemon.known() == 2, "both vehicles are heard")
        done = daemon.cli("sysid", "papa", "22")
        assert done.returncode == 0, done.stdout + done.stderr
        assert (
            "papa is system 22 now, it was 1; MAV_SYS_ID read back; change sysid of [vehicles.papa] to 22"
            in done.stdout
        )
        line = daemon.file.read_text().splitlines().index("sysid = 1") + 1
        assert f"{daemon.file}, line {line}" in " ".join(done.stdout.split())
        assert [s["sysid"] for s in json.loads(daemon.cli("status", "scouts", "--json").stdout)] == [22]
        states = json.loads(daemon.cli("status", "--json").stdout)
        assert {s["name"]: s["sysid"] for s in states} == {"papa": 22, "v2": 2}
        taken = daemon.cli("sysid", "papa", "2")
        assert taken.returncode == 1 and "system id 2 is taken: v2 has it" in " ".join(taken.stdout.split())
        assert daemon.cli("sysid", "papa", "251").returncode == 2
        assert daemon.cli("links", "remove", "other").returncode == 0
        wait_until(lambda: not daemon.vehicles()["v2"]["connected"], "v2 is lost")
        assert daemon.cli("hold", "v2").returncode == 1
        gone = daemon.cli("forget", "v2")
        assert gone.returncode == 0 and "v2 (system 2) is forgotten" in gone.stdout
        assert set(daemon.vehicles()) == {"papa"}
        still = daemon.cli("forget", "all")
        assert still.returncode == 1 and "it was heard " in still.stdout and daemon.known() == 1
        assert "Traceback" not in daemon.stderr
