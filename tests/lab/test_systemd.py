"""The units that `skygcs service install` writes, read by systemd's own tools."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from skygcs.cli.service import Installation, unit_text
from support.needed import needs

MOST_EXPOSURE = 3.0


def unit(folder: Path, user_name: str | None) -> Path:
    program = folder / "my programs" / "skygcs"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    fleet = folder / "50% of a fleet.toml"
    fleet.touch()
    path = folder / "skygcs.service"
    path.write_text(unit_text(Installation(fleet, folder / "logs", program, user_name)))
    return path


@pytest.mark.parametrize("user_name", ["root", None])
def test_systemd_reads_the_unit_without_a_complaint(user_name: str | None, tmp_path: Path) -> None:
    words = [needs("test-lab", "systemd-analyze"), "verify", "--man=no", *(["--user"] if user_name is None else [])]
    done = subprocess.run([*words, str(unit(tmp_path, user_name))], capture_output=True, text=True)
    complaints = [line for line in done.stderr.splitlines() if "skygcs" in line]
    assert complaints == [], done.stderr


def test_the_machine_s_unit_exposes_little(tmp_path: Path) -> None:
    path = unit(tmp_path, "pilot")
    words = [needs("test-lab", "systemd-analyze"), "security", "--offline=true", "--no-pager", "--json=short"]
    done = subprocess.run([*words, str(path)], capture_output=True, text=True)
    if done.returncode:
        raise AssertionError(done.stderr)
    exposed = [row for row in json.loads(done.stdout) if row.get("exposure")]
    text = subprocess.run([*words[:-1], str(path)], capture_output=True, text=True, env={"LC_ALL": "C"}).stdout
    level = float(text.rpartition("Overall exposure level for")[2].split(":")[1].split()[0])
    print(f"\nexposure level {level}, {len(exposed)} items", file=sys.stderr)
    assert level <= MOST_EXPOSURE, text
