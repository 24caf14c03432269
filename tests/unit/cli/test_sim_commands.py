"""`skygcs sim --radio`."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from pathlib import Path

import pytest

from skygcs.cli.serve import main
from skygcs.cli.sim import parse_conditions, parse_radio, run_sim
from skygcs.cli.sim_ports import DRIVER_BYTES, PtyPort, SimClock, TcpPort
from skygcs.config.dialects import load_dialect
from skygcs.config.radio import EmulatedRadio
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.errors import LinkError
from skygcs.links.simulated import emulated
from skygcs.sim.conditions import Conditions, Dynamics
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.tdm import GROUND
from skygcs.sim.vehicle_group import make_vehicles
from support.table import each


def test_an_air_speed_and_keys_make_a_radio() -> None:
    assert parse_radio("125") == EmulatedRadio(air_kbps=125)
    assert parse_radio("64,loss=0.02, nodes=16,rtscts=true") == EmulatedRadio(
        air_kbps=64, loss=0.02, nodes=16, rtscts=True
    )


@each("text", ["", "fast", "64,loss", "64,loss=2", "64,colour=red", "0", "nan"])
def test_what_is_none_is_refused_with_what_was_given(text: str) -> None:
    with pytest.raises(LinkError, match="--radio"):
        parse_radio(text)


def test_it_needs_a_pty_and_a_node_for_each_vehicle() -> None:
    with pytest.raises(LinkError, match="--pty"):
        run_sim(counts={"px4": 1}, first_sysid=1, udp="127.0.0.1:14550", air="64")
    with pytest.raises(LinkError, match="no rate of 60000 baud"):
        run_sim(counts={"px4": 1}, first_sysid=1, pty="/nonexistent/tty", air="64,baud=60000")
    with pytest.raises(LinkError, match="4 vehicles and the ground are 5"):
        run_sim(counts={"px4": 4}, first_sysid=1, pty="/nonexistent/tty", air="64,nodes=3")


async def test_the_port_is_the_grounds_radio_and_takes_no_more_than_a_serial_line_passes_on(tmp_path: Path) -> None:
    dialect = load_dialect("ardupilotmega")
    vehicles = make_vehicles(dialect, px4=1, ardupilot=0, first_sysid=1, home=LocalFrame(43.78, -79.46, 180.0))
    clock = SimClock(20.0)
    air = emulated(EmulatedRadio(), vehicles, dialect, seed=1, now=0.0)
    port = PtyPort(vehicles, dialect, clock, str(tmp_path / "tty"), None, air)
    await port.open()
    fd = os.open(tmp_path / "tty", os.O_RDWR | os.O_NONBLOCK)
    try:
        heartbeat = encode(dialect.by_name["HEARTBEAT"], {"type": 6}, sysid=255, compid=190, seq=0)
        request = encode(dialect.by_name["PARAM_REQUEST_READ"], {"param_index": -1}, sysid=255, compid=190, seq=0)
        written = os.write(fd, heartbeat + request * 200)
        parser, sources = FrameParser(dialect), set()
        for _ in range(100):
            await asyncio.sleep(0.01)
            port.pump()
            with contextlib.suppress(BlockingIOError):
                sources |= {(f.sysid, f.compid) for f in parser.feed(os.read(fd, 65536))}
        assert sources == {(51, 68), (1, 1)}
        assert written == len(heartbeat + request * 200)
        assert air.network.backlog_bytes(GROUND, clock.now()) <= 2 * DRIVER_BYTES
    finally:
        os.close(fd)
        port.close()


async def test_a_tcp_port_that_another_has_is_told_with_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        host, port = taken.getsockname()
        vehicles = TcpPort([], load_dialect("ardupilotmega"), SimClock(1.0), (host, port))
        with pytest.raises(LinkError, match=f"tcp {host}:{port}: port {port} is in use by another program"):
            await vehicles.open()


# -- How `skygcs sim` words the air and the sensors, and what it says of words it cannot use.


def parse(wind: str = "0", **words: object) -> Conditions:
    reported: dict[str, object] = {
        "dynamics": "rigid",
        "airframe": "f450",
        "attitude_lag_s": None,
        "gps_noise_m": 0.0,
        "attitude_noise_deg": 0.0,
        "sensor_latency_s": 0.0,
    }
    return parse_conditions(wind, **(reported | words))  # type: ignore[arg-type]


def test_no_options_are_calm_air_and_a_rigid_f450() -> None:
    assert parse() == Conditions()


@each(("wind", "east", "north", "gust"), [("5", 5, 0, 0), ("5,0", 0, -5, 0), ("4,90,1.5", -4, 0, 1.5)])
def test_wind_is_a_speed_a_direction_and_gusts(wind: str, east: float, north: float, gust: float) -> None:
    conditions = parse(wind)
    assert conditions.wind_enu_mps == pytest.approx((east, north, 0), abs=1e-9)
    assert conditions.gust_mps == gust


def test_the_other_options_arrive() -> None:
    conditions = parse(dynamics="kinematic", attitude_lag_s=0.3, gps_noise_m=0.5, sensor_latency_s=0.1)
    assert conditions.dynamics is Dynamics.KINEMATIC
    assert conditions.airframe.attitude_lag_s == 0.3
    assert (conditions.gps_noise_m, conditions.sensor_latency_s) == (0.5, 0.1)


@each("wind", ["", "strong", "1,2,3,4", "40", "nan", "-3", "5,inf", "5,0,-1"])
def test_a_wind_that_is_none_is_refused_in_words(wind: str) -> None:
    with pytest.raises(LinkError, match=r"--wind|wind|gust"):
        parse(wind)


def test_the_command_line_ends_with_one_line_and_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["sim", "--wind", "99"])
    assert end.value.code == 1
    said = capsys.readouterr()
    assert said.err == "skygcs: wind 99 is not in 0..30\n"
