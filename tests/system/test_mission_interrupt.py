"""Ctrl-C in a transfer of missions: real processes, a daemon with simulated vehicles of both firmwares."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.hanging import HANG_S
from support.process import DaemonProcess, wait_until

pytestmark = pytest.mark.system

COUNT = 25
"""Items; one takes some tenths of a second over the emulated radio."""

FLEET = """
[links.sim]
type = "simulated"
role = "radio"
radio = { air_kbps = 64 }
px4 = 1
ardupilot = 1
dynamics = "kinematic"
"""


def plan(folder: Path, count: int, name: str) -> Path:
    rows = ["QGC WPL 110", "0 1 0 16 0 0 0 0 43.78 -79.46 180 1", "1 0 3 22 0 0 0 0 43.7801 -79.4651 20 1"]
    rows += [f"{n} 0 3 16 0 0 0 0 {43.7801 + n / 1e7:.7f} -79.4651 20 1" for n in range(2, count + 1)]
    path = folder / name
    path.write_text("\n".join(rows))
    return path


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaemonProcess]:
    with DaemonProcess(tmp_path_factory.mktemp("interrupted"), FLEET) as process:
        wait_until(lambda: process.known() == 2, "both vehicles are known")
        yield process


def interrupted(daemon: DaemonProcess, name: str, *words: str, percent: int = 10) -> tuple[int, str]:
    """Exit code and output of a command that gets Ctrl-C when its transfer has come so far."""
    cli = [str(Path(sys.executable).with_name("skygcs-cli")), "--socket", str(daemon.socket)]
    process = subprocess.Popen([*cli, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def far_enough() -> bool:
        assert process.poll() is None, process.communicate()
        transfer = daemon.call("missions.status", targets=name)[0]["transfer"]
        return transfer is not None and (transfer["percent"] or 0) >= percent

    wait_until(far_enough, "the transfer is under way")
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=HANG_S)
    return process.returncode, out


def held(daemon: DaemonProcess, name: str) -> int:
    return len(daemon.call("missions.download", target=name, lists=["mission"])["mission"])


@pytest.mark.parametrize("name", ["v1", "v2"])
def test_an_upload_says_what_the_vehicle_holds(daemon: DaemonProcess, tmp_path: Path, name: str) -> None:
    """A PX4 keeps its old mission; an ArduPilot has a part of the new one, and says so only 8 s later."""
    short, long = plan(tmp_path, 3, "short.waypoints"), plan(tmp_path, COUNT, "long.waypoints")
    assert daemon.cli("mission", "upload", name, str(short), "--force").returncode == 0
    code, out = interrupted(daemon, name, "mission", "upload", name, str(long), "--force", percent=30)
    assert code == 130
    assert "interrupted; reading what the vehicles hold now" in out and "Traceback" not in out
    count = held(daemon, name)
    if name == "v1":
        assert f"v1: holds {count} mission items, not those of long.waypoints: as before" in out and count == 3
    else:
        assert f"v2: holds {count} mission items: the first {count} are of long.waypoints" in out
        assert f"{COUNT - count} are missing; do not fly it: upload it again, or clear it" in out and 3 < count < COUNT
    assert daemon.call("missions.status", targets=name)[0]["last"]["mission"]["state"] == "complete"


def test_a_download_says_that_nothing_is_written(daemon: DaemonProcess, tmp_path: Path) -> None:
    some, out_file = plan(tmp_path, 10, "some.waypoints"), tmp_path / "back.plan"
    assert daemon.cli("mission", "upload", "v1", str(some), "--force").returncode == 0
    code, out = interrupted(daemon, "v1", "mission", "download", "v1", str(out_file), "--only", "mission")
    assert code == 130 and not out_file.exists()
    assert f"interrupted: nothing changed in v1; {out_file} is not written" in out
    assert held(daemon, "v1") == 10


def test_rally_points_and_json(daemon: DaemonProcess, tmp_path: Path) -> None:
    points = [[43.78 + n / 1e6, -79.465, 20] for n in range(30)]
    path = tmp_path / "rally.plan"
    rally = {"version": 2, "points": points}
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "rallyPoints": rally, "mission": {"version": 2}}))
    words = ("mission", "upload", "v1", str(path), "--force", "--json")
    code, out = interrupted(daemon, "v1", *words, percent=5)
    reported = json.loads(out[out.index("{") :])
    assert code == 130 and reported["interrupted"] is True
    assert reported["held"]["v1"]["rally"] == {"message": "holds no rally", "items": 0}
