"""The programs and command lines of the pages, run as they are written against a daemon with simulated vehicles."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.hanging import HANG_S
from support.process import FIELD_TOML, ROOT, DaemonProcess, free_port, wait_until

pytestmark = pytest.mark.system

PROGRAMS = {
    "README.md": 0,
    "docs/howto/clients.md": 0,
    "docs/howto/fly-setpoints.md": 0,
}
"""Page -> which of its Python examples is a whole program for a daemon."""

NOT_RUN = {
    "docs/howto/extension.md": "a gate without its extension; a whole one of another name gates in test_extension",
    "docs/explanation/control-law.md": "a fragment, without the numbers that it takes",
    "docs/howto/logs.md": "needs pandas",
    "docs/howto/federation.md": "run in tests/federation/test_how_to.py, where there is a hub",
}
"""Further pages with Python."""

FLEET = (
    FIELD_TOML
    + """
[links.field]
type = "simulated"
px4 = 1
ardupilot = 1

[vehicles.alpha]
sysid = 1

[vehicles.bravo]
sysid = 2
"""
)


def python_blocks(page: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.M | re.S)


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[DaemonProcess]:
    port = free_port()
    ground = f'[links.kite]\ntype = "udp_server"\nport = {port}\nrole = "gcs"\nvehicles = ["bravo"]\n'
    with DaemonProcess(tmp_path, FLEET + ground) as daemon:
        wait_until(
            lambda: (
                {n: v["position"] and v["position"]["alt_rel_m"] is not None for n, v in daemon.vehicles().items()}
                == {"alpha": True, "bravo": True}
            ),
            "both vehicles know where they are",
        )
        yield daemon


def start(program: str, daemon: DaemonProcess) -> subprocess.Popen[str]:
    file = daemon.folder / "program.py"
    file.write_text(program, encoding="utf-8")
    environment = {**os.environ, "SKYGCS_SOCKET": str(daemon.socket), "PYTHONUNBUFFERED": "1"}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, str(file)], env=environment, stdout=pipe, stderr=pipe, text=True)


def altitude_m(daemon: DaemonProcess, name: str) -> float:
    return float(daemon.vehicles()[name]["position"]["alt_rel_m"])


def test_every_page_with_python_is_run_or_says_why_not() -> None:
    pages = [str(p.relative_to(ROOT)) for p in (*ROOT.glob("docs/**/*.md"), ROOT / "README.md")]
    assert sorted(page for page in pages if python_blocks(page)) == sorted([*PROGRAMS, *NOT_RUN])


@pytest.mark.parametrize("page", ["README.md", "docs/howto/clients.md"])
def test_the_first_program_takes_off_and_prints_heights(page: str, daemon: DaemonProcess) -> None:
    program = python_blocks(page)[PROGRAMS[page]]
    process = start(program, daemon)
    try:
        wait_until(lambda: min(altitude_m(daemon, n) for n in ("alpha", "bravo")) > 4.0, "both have taken off")
    finally:
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=HANG_S)
    assert re.search(r"^alpha \d", out, re.M) and re.search(r"^bravo \d", out, re.M), out


def test_the_circle_is_flown(daemon: DaemonProcess) -> None:
    (program,) = python_blocks("docs/howto/fly-setpoints.md")
    assert daemon.cli("takeoff", "alpha", "8", "--wait", "60").returncode == 0
    wait_until(lambda: daemon.vehicles()["alpha"]["mode"] == "AUTO.LOITER", "its take-off has ended")
    assert "range(60 * RATE_HZ)" in program
    process = start(program.replace("range(60 * RATE_HZ)", "range(6 * RATE_HZ)"), daemon)
    _, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 0, err
    reference = daemon.call("control.status", targets="alpha")[0]["reference"]
    assert reference is not None and abs(reference["pos_enu_m"][2] - 10.0) < 2.0


def test_the_pymavlink_program_arms_its_vehicle(daemon: DaemonProcess) -> None:
    _, program = python_blocks("docs/howto/clients.md")
    port = re.search(r"port = (\d+)", daemon.file.read_text(encoding="utf-8"))
    assert port is not None
    wait_until(lambda: daemon.cli("preflight", "bravo").returncode == 0, "bravo is ready")
    process = start(program.replace("14561", port[1]), daemon)
    out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 0, err
    assert "COMMAND_ACK" in out and "result : 0" in out, out
