"""`skygcs-cli joystick` as a process: a pipe brings the kernel's events, a daemon flies simulated vehicles."""

from __future__ import annotations

import os
import pty
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.hanging import HANG_S
from support.process import DaemonProcess, wait_until

pytestmark = pytest.mark.system

FLEET = """
[origin]
lat_deg = 43.7806
lon_deg = -79.4653
alt_amsl_m = 180.0

[links.field]
type = "simulated"
px4 = 1
ardupilot = 1

[vehicles.alpha]
sysid = 1

[vehicles.bravo]
sysid = 2
"""
BUTTON = 5
ATTEMPTS = 5
"""On a machine that others use."""
HOLDS = {"alpha": "AUTO.LOITER", "bravo": "GUIDED"}
"""The modes of `hold`: docs/explanation/flight-control.md."""


class Joystick:
    """The near side of the pipe: events as linux/joystick.h lays them out."""

    def __init__(self, path: Path) -> None:
        self.path = path
        os.mkfifo(path)
        self._descriptor: int | None = os.open(path, os.O_RDWR)

    def plugged(self, **values: int) -> Joystick:
        """What the kernel sends at opening: all axes and buttons, at rest but for ``values`` (a4=32767, b5=1)."""
        for number in range(6):
            self.axis(number, values.get(f"a{number}", 0), initial=True)
        for number in range(11):
            self.button(number, values.get(f"b{number}", 0), initial=True)
        return self

    def axis(self, number: int, value: int, *, initial: bool = False) -> None:
        self._write(value, 2 | 0x80 * initial, number)

    def button(self, number: int, value: int, *, initial: bool = False) -> None:
        self._write(value, 1 | 0x80 * initial, number)

    def _write(self, value: int, kind: int, number: int) -> None:
        assert self._descriptor is not None
        os.write(self._descriptor, struct.pack("<IhBB", 0, value, kind, number))

    def unplug(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


class Flown:
    """The command as a process, and what it prints."""

    def __init__(self, daemon: DaemonProcess, joystick: Joystick, vehicle: str, *more: str, stderr: Any = None) -> None:
        self.log = daemon.folder / "joystick.log"
        command = [str(Path(sys.executable).with_name("skygcs-cli")), "--socket", str(daemon.socket), "joystick"]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [*command, vehicle, "--device", str(joystick.path), *more],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log if stderr is None else stderr,
            )

    def says(self, words: str, times: int = 1) -> None:
        wait_until(lambda: " ".join(self.log.read_text().split()).count(words) >= times, f"{words}: {self.log}")

    @property
    def disturbed(self) -> bool:
        """The machine was too busy for a second: the command stopped the vehicle, as it must, or gave the daemon up."""
        log = self.log.read_text()
        return "stood still" in log or "no answer within" in log

    def ended(self) -> int:
        return self.process.wait(HANG_S)


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaemonProcess]:
    with DaemonProcess(tmp_path_factory.mktemp("joystick"), FLEET) as daemon:
        wait_until(lambda: daemon.known() == 2, "both vehicles are known")
        assert daemon.cli("takeoff", "all", "8", "--wait", "60").returncode == 0
        wait_until(lambda: daemon.vehicles()["alpha"]["mode"] == "AUTO.LOITER", "alpha's take-off has ended")
        wait_until(lambda: min(v["position"]["alt_rel_m"] for v in daemon.vehicles().values()) > 7, "both are up")
        yield daemon


@pytest.fixture
def joystick(tmp_path: Path) -> Iterator[Joystick]:
    joystick = Joystick(tmp_path / "js0")
    yield joystick
    joystick.unplug()


@pytest.fixture
def fly(daemon: DaemonProcess, joystick: Joystick) -> Iterator[Any]:
    """Start the command and have it fly at full stick forward."""
    running: list[Flown] = []

    def start(vehicle: str = "alpha", terminal: tuple[int, int] | None = None) -> Flown:
        for _ in range(ATTEMPTS):
            flown = attempt(vehicle, terminal)
            wait_until(lambda: speed_mps(daemon, vehicle) > 0.7 or flown.disturbed, "it moves")  # noqa: B023
            if not flown.disturbed:
                return flown
            flown.process.kill()
            flown.process.wait()
            daemon.call("vehicles.hold", targets="all")
        raise AssertionError("the machine never had a second for it")

    def attempt(vehicle: str, terminal: tuple[int, int] | None) -> Flown:
        flown = Flown(daemon, joystick.plugged(), vehicle, "--engage", stderr=terminal and terminal[1])
        running.append(flown)
        if terminal is None:
            flown.says("ready: hold button 5")
        else:
            seen = b""
            while b"ready: hold" not in seen:
                seen += os.read(terminal[0], 4096)
        joystick.button(BUTTON, 1)
        wait_until(lambda: status(daemon, vehicle)["state"] == "flying" or flown.disturbed, "it is under control")
        joystick.axis(4, -32767)
        return flown

    yield start
    for flown in running:
        if flown.process.poll() is None:
            flown.process.kill()
            flown.process.wait()
    daemon.call("vehicles.hold", targets="all")


def status(daemon: DaemonProcess, vehicle: str) -> dict[str, Any]:
    found: dict[str, Any] = daemon.call("control.status", targets=vehicle)[0]
    return found


def speed_mps(daemon: DaemonProcess, vehicle: str) -> float:
    x, y, _ = daemon.vehicles()[vehicle]["position"]["vel_enu_mps"]
    return float((x * x + y * y) ** 0.5)


def holds(daemon: DaemonProcess, vehicle: str = "alpha") -> None:
    wait_until(lambda: status(daemon, vehicle)["state"] == "off", "control has ended")
    wait_until(lambda: daemon.vehicles()[vehicle]["mode"] == HOLDS[vehicle], "it holds")
    wait_until(lambda: speed_mps(daemon, vehicle) < 0.1, "it stands")


@pytest.mark.parametrize("vehicle", ["alpha", "bravo"])
def test_it_flies_while_the_button_is_held_and_then_holds(
    daemon: DaemonProcess, joystick: Joystick, fly: Any, vehicle: str
) -> None:
    flown = fly(vehicle)
    joystick.button(BUTTON, 0)
    flown.says("holds")
    holds(daemon, vehicle)
    joystick.axis(4, 0)
    joystick.button(BUTTON, 1)  # and again
    flown.says("flying", times=2)
    joystick.button(BUTTON, 0)
    flown.says("holds", times=2)
    flown.process.send_signal(signal.SIGINT)
    assert flown.ended() == 130
    assert "Traceback" not in flown.log.read_text()


def test_unplugging_stops_it_and_ends_the_command(daemon: DaemonProcess, joystick: Joystick, fly: Any) -> None:
    flown = fly()
    joystick.unplug()
    assert flown.ended() == 1
    flown.says("the joystick is gone")
    holds(daemon)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_it_and_ends_the_command(daemon: DaemonProcess, fly: Any, number: signal.Signals) -> None:
    flown = fly()
    flown.process.send_signal(number)
    assert flown.ended() == 128 + number
    holds(daemon)


def test_a_closed_terminal_does_not_keep_it_from_being_stopped(daemon: DaemonProcess, fly: Any) -> None:
    master, slave = pty.openpty()
    flown = fly(terminal=(master, slave))
    os.close(slave)
    os.close(master)  # writes to it fail from now on
    flown.process.send_signal(signal.SIGHUP)
    assert flown.ended() == 128 + signal.SIGHUP
    holds(daemon)


def test_killed_it_leaves_a_vehicle_that_stays(daemon: DaemonProcess, fly: Any) -> None:
    fly().process.kill()
    wait_until(lambda: speed_mps(daemon, "alpha") < 0.1, "the deadline of the last setpoint stopped it")
    assert status(daemon, "alpha")["state"] == "flying", "under the daemon's control, at its place"


def test_after_a_standstill_of_the_program_the_press_has_to_be_made_again(daemon: DaemonProcess, fly: Any) -> None:
    flown = fly()
    flown.process.send_signal(signal.SIGSTOP)
    wait_until(lambda: speed_mps(daemon, "alpha") < 0.1, "the deadline stopped it")
    flown.process.send_signal(signal.SIGCONT)
    flown.says("holds")
    holds(daemon)


def test_what_another_client_orders_is_not_fought(daemon: DaemonProcess, fly: Any) -> None:
    for _ in range(ATTEMPTS):
        flown = fly("bravo")
        assert daemon.cli("stop", "bravo").returncode == 0
        wait_until(lambda: flown.process.poll() is not None or flown.disturbed, "it ends")  # noqa: B023
        if not flown.disturbed:
            break
        flown.process.kill()
    assert flown.ended() == 1
    flown.says("control has ended")
    assert daemon.vehicles()["bravo"]["mode"] == "BRAKE", "no hold came after the stop"


@pytest.mark.parametrize(("values", "words"), [({"b5": 1}, "button 5 is pressed"), ({"a3": -20000}, "axis 3 (left)")])
def test_a_stuck_button_or_stick_is_refused(
    daemon: DaemonProcess, joystick: Joystick, values: dict[str, int], words: str
) -> None:
    flown = Flown(daemon, joystick.plugged(**values), "alpha", "--engage")
    assert flown.ended() == 1
    flown.says(words)


def test_without_engage_only_what_is_under_control_is_flown(daemon: DaemonProcess, joystick: Joystick) -> None:
    flown = Flown(daemon, joystick.plugged(), "alpha")
    flown.says("ready")
    before = daemon.vehicles()["alpha"]["mode"]
    joystick.button(BUTTON, 1)
    flown.says("control set alpha velocity, or --engage")
    joystick.unplug()
    assert flown.ended() == 1 and daemon.vehicles()["alpha"]["mode"] == before


def test_what_is_no_joystick_and_what_is_no_vehicle_is_refused(daemon: DaemonProcess, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(bytes(80))
    for device, words in ((tmp_path / "file", "not a joystick"), (tmp_path / "none", "plug it in")):
        done = daemon.cli("joystick", "alpha", "--device", str(device))
        assert done.returncode == 1 and words in " ".join(done.stderr.split())
    for vehicle in ("all", "1,2", "nobody"):
        done = daemon.cli("joystick", vehicle)
        assert done.returncode in (1, 2) and "Traceback" not in done.stderr
        assert "plug it in" not in done.stderr, "the vehicle is looked at first"


def test_a_vehicle_follows_one_client_and_another_that_insists(daemon: DaemonProcess, joystick: Joystick) -> None:
    running: list[subprocess.Popen[str]] = []

    def stream(*more: str) -> subprocess.Popen[str]:
        """A client whose setpoints the vehicle follows."""
        command = daemon.command("setpoint", "bravo", "--vel", "0", "0", "0", "--valid", "5", *more)
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True))
        process, pid = running[-1], f"pid {running[-1].pid})"

        def is_followed() -> bool:
            return pid in (status(daemon, "bravo")["stream"] or {"client": ""})["client"]

        wait_until(lambda: is_followed() or process.poll() is not None, "it is followed, or refused")
        assert is_followed()
        return process

    try:
        assert daemon.cli("control", "set", "bravo", "velocity").returncode == 0
        first = stream()
        refused = daemon.cli("setpoint", "bravo", "--vel", "0", "0", "0", "--for", "0")
        assert refused.returncode == 1 and f"pid {first.pid}), each valid for 5 s" in " ".join(refused.stderr.split())
        flown = Flown(daemon, joystick.plugged(), "bravo")
        flown.says("ready: hold button 5")
        joystick.button(BUTTON, 1)
        assert flown.ended() == 1
        flown.says(f"pid {first.pid}), each")
        assert first.poll() is None, "the vehicle was left to it"
        second = stream("--take-over")
        assert first.wait(HANG_S) == 1 and first.stdout is not None and "has taken it over" in first.stdout.read()
        second.kill()
        second.wait()
        stream()  # its setpoints were good for longer
        assert daemon.cli("hold", "bravo").returncode == 0
        assert status(daemon, "bravo")["stream"] is None
    finally:
        for process in running:
            process.kill()
            process.communicate()
