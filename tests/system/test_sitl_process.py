"""`skygcs sitl` as a process, with programs that play the firmware."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet
from support.fake_firmware import make_copter, make_px4
from support.hanging import HANG_S
from support.process import ROOT, DaemonProcess, wait_until

pytestmark = pytest.mark.system
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts `skygcs sitl` with the fake firmware; ended by pid after the test, whatever happens."""
    running: list[subprocess.Popen[str]] = []
    binaries = {
        "SKYGCS_PX4": str(make_px4(tmp_path / "px4 tree")),
        "SKYGCS_ARDUCOPTER": str(make_copter(tmp_path / "ardupilot")),
    }

    def run(*options: str, **environment: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-m", "skygcs", "sitl", *options]
        everything = {**os.environ, **binaries, "TMPDIR": str(tmp_path), **environment}
        process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=everything
        )
        running.append(process)
        return process

    yield run
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


def lines_until(process: subprocess.Popen[str], last: str) -> list[str]:
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line.strip())
        if last in line:
            return lines
    raise AssertionError(f"{last!r} never came: {lines}; {process.stderr.read() if process.stderr else ''}")


def pids_of(lines: list[str]) -> list[int]:
    return [int(match[1]) for line in lines if (match := re.search(r"pid (\d+)", line))]


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    return state != "Z"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_instances_are_started_reported_ready_and_stopped(start: Start, tmp_path: Path, number: int) -> None:
    process = start("--px4", "2", "--ardupilot", "1", "--first-sysid", "21")
    lines = lines_until(process, "all are ready")
    assert [line.split(" is ready")[0] for line in lines if " is ready" in line].__len__() == 3
    fleet = Path(next(line for line in lines if line.startswith("skygcs run ")).removeprefix("skygcs run "))
    assert [v.sysid for v in load_fleet(fleet).vehicles.values()] == [21, 22, 23]
    pids = pids_of(lines)
    assert len(pids) == 3
    assert all(is_alive(pid) for pid in pids)
    process.send_signal(number)
    assert process.wait(HANG_S) == 0
    assert not any(is_alive(pid) for pid in pids)
    assert not fleet.parent.exists()


def test_the_daemon_meets_the_vehicles_by_the_fleet_file(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "vehicles"
    process = start("--px4", "1", "--ardupilot", "1", "--first-sysid", "31", "--folder", str(folder))
    lines_until(process, "all are ready")
    toml = re.sub(r"\[daemon\]\nlog_dir.*\n", "", (folder / "fleet.toml").read_text())
    with DaemonProcess(tmp_path, toml) as daemon:
        wait_until(lambda: daemon.known() == 2 and all(v["connected"] for v in daemon.vehicles().values()), "both")
        found = {v["name"]: (v["sysid"], v["autopilot"]) for v in daemon.vehicles().values()}
    assert found == {"px31": (31, "px4"), "copter32": (32, "ardupilot")}
    process.terminate()
    assert process.wait(HANG_S) == 0
    assert (folder / "px31/console.log").is_file()  # a folder of the user's is kept


def test_px4_has_its_id_before_the_commander_and_none_of_the_usual_ports(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "vehicles"
    options = ("--param", "px4:COM_X=1", "--param", "ardupilot:FS_GCS_ENABLE=1", "--home", "47.4,8.5,488")
    process = start("--px4", "1", "--first-sysid", "77", "--folder", str(folder), "--param", "NO_SUCH=1", *options)
    lines_until(process, "all are ready")
    process.terminate()
    _, stderr = process.communicate(timeout=HANG_S)
    assert "px77 has no parameter NO_SUCH" in stderr
    calls = (folder / "px77/calls").read_text().splitlines()
    assert calls.index("param set MAV_SYS_ID 77") < calls.index("commander start")
    assert "param set COM_X 1" in calls
    assert not any("FS_GCS" in call for call in calls)
    assert "home 47.40000000 8.50000000 488.00" in calls
    assert not any("1857" in call or "14550" in call for call in calls if call.startswith("mavlink"))


def test_an_instance_that_dies_is_reported_with_its_last_words(start: Start, tmp_path: Path) -> None:
    process = start("--ardupilot", "1", FAKE_COPTER="dies")
    stdout, stderr = process.communicate(timeout=HANG_S)
    assert process.returncode == 1
    assert "copter1 exited with 3" in stderr
    assert "panic: no frame" in stderr
    kept = Path(stdout.strip().splitlines()[-1].removeprefix("kept: "))
    assert (kept / "copter1/console.log").is_file()


def test_others_live_on_when_one_dies(start: Start) -> None:
    process = start("--px4", "1", "--ardupilot", "1", FAKE_COPTER="no estimator")
    lines = lines_until(process, "px1 is ready")
    px4, copter = pids_of(lines)
    os.kill(copter, signal.SIGKILL)
    assert process.stderr is not None
    assert "copter2 ended by signal 9" in process.stderr.readline()
    assert is_alive(px4)
    process.terminate()
    assert process.wait(HANG_S) == 1


def test_two_launchers_share_no_instance_number(start: Start, tmp_path: Path) -> None:
    first = start("--px4", "2", "--folder", str(tmp_path / "one"))
    second = start("--px4", "2", "--folder", str(tmp_path / "two"), "--first-sysid", "11")
    lines_until(first, "all are ready")
    lines_until(second, "all are ready")
    numbers = []
    for calls in tmp_path.glob("*/px*/calls"):
        numbers.append(calls.read_text().splitlines()[0])  # rcS sets the system id to the number + 1
    assert len(numbers) == len(set(numbers)) == 4


def test_no_firmware_outlives_a_killed_launcher(start: Start) -> None:
    process = start("--px4", "1", "--ardupilot", "1")
    pids = pids_of(lines_until(process, "all are ready"))
    process.kill()
    wait_until(lambda: not any(is_alive(pid) for pid in pids), "the end of the firmware")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ((), "--px4, --px4-plane"),
        (("--px4", "33"), "1 to 32"),
        (("--px4", "2", "--first-sysid", "250"), "--first-sysid"),
        (("--px4", "2", "--spacing", "1"), "at least 5 m apart"),
        (("--px4", "1", "--home", "1,2"), "--home"),
        (("--px4", "1", "--home", "95,2,3"), "not a place on Earth"),
        (("--px4", "1", "--home", "0,0,3"), "so near to 0, 0"),
        (("--px4", "1", "--param", "A"), "NAME=VALUE"),
        (("--px4", "1", "--param", "A;rm=1"), "NAME=VALUE"),
        (("--px4", "1", "--param", "copter:A=1"), "NAME=VALUE"),
        (("--px4", "1", "--param", "A=$(id)"), "NAME=VALUE"),
        (("--px4", "1", "--speedup", "nan"), "--speedup"),
        (("--px4", "1", "--params", "/no/such.params"), "No such file"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(start: Start, options: tuple[str, ...], text: str) -> None:
    process = start(*options)
    _, stderr = process.communicate(timeout=HANG_S)
    assert process.returncode == 1
    assert text in stderr
    assert "Traceback" not in stderr


def test_without_binaries_it_says_what_to_set(start: Start) -> None:
    process = start("--px4", "1", SKYGCS_PX4="")
    _, stderr = process.communicate(timeout=HANG_S)
    assert process.returncode == 1
    assert "SKYGCS_PX4" in stderr
    assert "make px4_sitl_default" in stderr
