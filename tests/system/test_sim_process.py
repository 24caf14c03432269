"""`skygcs sim` as a process, flown by pymavlink's mavutil over UDP, TCP and a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mav

from support.hanging import HANG_S
from support.process import ROOT, free_port, wait_until

pytestmark = pytest.mark.system
SPEEDUP = 10.0


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `skygcs sim` with these options; ended by pid after the test, whatever happens."""
    running: list[subprocess.Popen[str]] = []

    def run(*options: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-m", "skygcs", "sim", "--speedup", str(SPEEDUP), *options]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
        running.append(process)
        return process

    yield run
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def connect() -> Iterator[Callable[..., Any]]:
    """A mavutil connection, closed after the test."""
    made: list[Any] = []

    def make(address: str) -> Any:
        made.append(
            mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="ardupilotmega")
        )
        return made[-1]

    os.environ["MAVLINK20"] = "1"
    yield make
    for connection in made:
        connection.close()


def lines(process: subprocess.Popen[str], count: int) -> list[str]:
    assert process.stdout is not None
    return [process.stdout.readline().strip() for _ in range(count)]


def await_message(connection: Any, name: str, sysid: int, good: Callable[[Any], bool] = lambda m: True) -> Any:
    """The next message of that kind that will do; heartbeats go up meanwhile, as from any ground station."""
    deadline = time.monotonic() + HANG_S
    while time.monotonic() < deadline:
        message = connection.recv_match(type=name, blocking=True, timeout=0.2)
        connection.mav.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE)
        if message is not None and message.get_srcSystem() == sysid and good(message):
            return message
    raise AssertionError(f"no {name} of {sysid} in {HANG_S} s that would do")


def order(connection: Any, sysid: int, command: int, *params: float) -> int:
    values = (*params, *[0.0] * (7 - len(params)))
    connection.mav.command_long_send(sysid, 1, command, 0, *values)
    return int(await_message(connection, "COMMAND_ACK", sysid, lambda m: m.command == command).result)


def fly(connection: Any, px4: int, copter: int) -> None:
    """Both up and down again."""
    for sysid in (px4, copter):
        await_message(connection, "HOME_POSITION", sysid)  # its estimator has converged
    nan = float("nan")
    amsl = await_message(connection, "GLOBAL_POSITION_INT", px4).alt / 1000
    assert order(connection, px4, mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, amsl + 5) == 0
    assert order(connection, px4, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert order(connection, copter, mav.MAV_CMD_DO_SET_MODE, 1, 4) == 0
    assert order(connection, copter, mav.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert order(connection, copter, mav.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == 0
    for sysid in (px4, copter):
        await_message(connection, "GLOBAL_POSITION_INT", sysid, lambda m: 4500 < m.relative_alt < 5500)
        assert order(connection, sysid, mav.MAV_CMD_NAV_LAND) == 0
    for sysid in (px4, copter):
        landed = await_message(connection, "HEARTBEAT", sysid, lambda m: not m.base_mode & 128)
        assert landed.system_status == mav.MAV_STATE_STANDBY


def end(process: subprocess.Popen[str], number: signal.Signals = signal.SIGTERM) -> None:
    process.send_signal(number)
    assert process.wait(HANG_S) == 0
    assert process.stderr is not None and process.stderr.read() == ""


def test_over_udp_a_ground_station_flies_both(
    start: Callable[..., subprocess.Popen[str]], connect: Callable[..., Any]
) -> None:
    port = free_port()
    connection = connect(f"udpin:127.0.0.1:{port}")
    process = start("--udp", f"127.0.0.1:{port}", "--first-sysid", "7")
    said = lines(process, 2)
    assert said[0].startswith(f"vehicle 7: PX4 quadrotor, udp to 127.0.0.1:{port} from port ")
    assert said[1].startswith("vehicle 8: ArduCopter quadrotor, udp")
    fly(connection, 7, 8)
    end(process)


def test_over_tcp_every_connection_hears_all(
    start: Callable[..., subprocess.Popen[str]], connect: Callable[..., Any]
) -> None:
    port = free_port(socket.SOCK_STREAM)
    process = start("--tcp", f"127.0.0.1:{port}")
    assert lines(process, 2)[1] == f"vehicle 2: ArduCopter quadrotor, tcp on 127.0.0.1:{port}"
    first, second = connect(f"tcp:127.0.0.1:{port}"), connect(f"tcp:127.0.0.1:{port}")
    for connection in (first, second):
        for sysid in (1, 2):
            await_message(connection, "HEARTBEAT", sysid)
    second.close()
    fly(first, 1, 2)
    end(process, signal.SIGINT)


def test_over_a_pty_there_is_a_radio_and_the_symlink_goes_with_the_process(
    start: Callable[..., subprocess.Popen[str]], connect: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "ttyRadio"
    process = start("--pty", str(path))
    assert lines(process, 2)[0] == f"vehicle 1: PX4 quadrotor, pty {path}"
    connection = connect(str(path))
    fly(connection, 1, 2)
    report = await_message(connection, "RADIO_STATUS", 51)
    assert report.get_srcComponent() == 68 and report.txbuf == 100
    connection.close()
    again = connect(str(path))  # closing it hung nothing up
    await_message(again, "HEARTBEAT", 2)
    end(process)
    assert not path.is_symlink() and not path.exists()


def test_with_separate_ports_each_vehicle_has_its_own_socket(start: Callable[..., subprocess.Popen[str]]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(HANG_S)
        process = start("--udp", f"127.0.0.1:{listener.getsockname()[1]}", "--px4", "2", "--separate-ports")
        ports = [int(line.rsplit(" ", 1)[1]) for line in lines(process, 3)]
        assert len(set(ports)) == 3
        seen: dict[int, set[int]] = {}
        parser = mav.MAVLink(None)
        while {k: len(v) for k, v in seen.items()} != {1: 1, 2: 1, 3: 1} or len(seen) < 3:
            data, address = listener.recvfrom(2048)
            for message in parser.parse_buffer(data):
                seen.setdefault(message.get_srcSystem(), set()).add(address[1])
        assert {sysid: ports[sysid - 1] for sysid in seen} == {sysid: next(iter(v)) for sysid, v in seen.items()}
        end(process)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--udp", "nowhere"), "--udp 'nowhere': write HOST:PORT"),
        (("--udp", "127.0.0.1:99999"), "write HOST:PORT"),
        (("--tcp", "192.0.2.1:5760"), "tcp 192.0.2.1:5760: "),
        (("--pty", "/nonexistent/radio"), "pty /nonexistent/radio: No such file or directory"),
        (("--home", "north pole"), "--home 'north pole': write LAT,LON,AMSL"),
        (("--home", "91,0,0"), "not a place on Earth"),
        (("--home", "0,0,0"), "so near to 0, 0"),
        (("--px4", "0", "--ardupilot", "0"), "no vehicles"),
        (("--px4", "300"), "do not fit in 1..255"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    start: Callable[..., subprocess.Popen[str]], options: tuple[str, ...], complaint: str
) -> None:
    process = start(*options)
    out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 1
    assert complaint in err and err.count("\n") == 1 and out == ""


def test_a_file_in_the_place_of_the_symlink_is_left_alone(
    start: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    path = tmp_path / "data"
    path.write_text("precious")
    process = start("--pty", str(path))
    _, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 1 and "not a symlink" in err
    assert path.read_text() == "precious"


def test_a_pty_nobody_reads_does_not_stop_the_vehicles(
    start: Callable[..., subprocess.Popen[str]], connect: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "radio"
    process = start("--pty", str(path), "--speedup", "100")
    lines(process, 2)
    wait_until(lambda: _written(process.pid) > 60_000, "much more than a terminal holds was sent")
    connection = connect(str(path))
    message = await_message(connection, "SYSTEM_TIME", 1, lambda m: m.time_boot_ms > 0)
    late = await_message(connection, "SYSTEM_TIME", 1, lambda m: m.time_boot_ms > message.time_boot_ms + 20_000)
    assert late.time_boot_ms > 20_000
    end(process)


def _written(pid: int) -> int:
    """Bytes this process wrote so far (Linux)."""
    for line in Path(f"/proc/{pid}/io").read_text().splitlines():
        if line.startswith("wchar:"):
            return int(line.split()[1])
    return 0
