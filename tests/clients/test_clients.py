"""Programs that people fly with, each through a real `skygcs run` against simulated vehicles, as their examples do.

Shared: a link that carries everything, and one vehicle. Bound: two vehicles, one of each firmware, and a link for this
one only, shown as system 1 (docs/howto/clients.md).
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from clients.environments import CLIENTS
from support.process import DaemonProcess, free_port, wait_until

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

PROGRAMS = Path(__file__).parent / "programs"
FLIGHT_LIMIT_S = 600.0
"""How long a flight may take on a machine that does other things; it takes one to two minutes."""

SYSIDS = {"px4": 1, "ardupilot": 2}
"""Of simulated vehicles: PX4s come first."""

FORMS = ("shared", "bound")


@dataclass(frozen=True)
class Flight:
    """What a program saw, by step; a step that came twice has its last facts."""

    steps: dict[str, dict[str, Any]]
    order: list[str]

    def __getitem__(self, step: str) -> dict[str, Any]:
        return self.steps[step]


def link_of(kind: str, port: int, vehicle: str, form: str) -> str:
    bound = f'vehicles = ["{vehicle}"]\npresent_as = 1\n' if form == "bound" else ""
    return f'[links.program]\ntype = "{kind}"\nhost = "127.0.0.1"\nport = {port}\nrole = "gcs"\n{bound}'


def fleet_of(autopilot: str, form: str) -> str:
    vehicles = "px4 = 1\nardupilot = 1\n" if form == "bound" else f"{autopilot} = 1\n"
    names = {"px4": 1, "ardupilot": 2} if form == "bound" else {autopilot: 1}
    named = "".join(f"[vehicles.{name}]\nsysid = {sysid}\n" for name, sysid in names.items())
    return f'[links.air]\ntype = "simulated"\nrole = "radio"\n{vehicles}{named}'


def fly(folder: Path, program: str, autopilot: str, form: str, kind: str, connect: str, *more: str) -> Flight:
    """Start a daemon and the program, which gets ``connect`` with the link's port; the program has to reach its end."""
    client = CLIENTS[program]
    missing = client.install()
    assert not missing, missing
    port = free_port(socket.SOCK_STREAM if kind == "tcp_server" else socket.SOCK_DGRAM)
    toml = fleet_of(autopilot, form) + link_of(kind, port, autopilot, form)
    with DaemonProcess(folder, toml) as daemon:
        wait_until(lambda: daemon.known() == (2 if form == "bound" else 1), "all vehicles are heard")
        script = PROGRAMS / f"{program.replace('-', '_')}_flight.py"
        command = [str(client.python), str(script), connect.format(port=port), autopilot, *more]
        log = folder / "program.log"
        environment = {**os.environ, "MAVLINK20": "1", "PYTHONUNBUFFERED": "1"}
        with log.open("wb") as stderr:
            try:
                done = subprocess.run(
                    command,
                    stdout=subprocess.PIPE,
                    stderr=stderr,
                    timeout=FLIGHT_LIMIT_S,
                    check=False,
                    cwd=folder,
                    env=environment,
                )
            except subprocess.TimeoutExpired as late:
                raise AssertionError(f"did not end; it said {late.stdout!r}\n{log.read_text()[-3000:]}") from None
        lines = [json.loads(line) for line in done.stdout.decode().splitlines() if line.startswith('{"step"')]
        order = [line["step"] for line in lines]
        assert done.returncode == 0 and order[-1:] == ["done"], f"{lines}\n{log.read_text()[-3000:]}"
        others = [v for name, v in daemon.vehicles().items() if name != autopilot]
        assert not any(v["armed"] for v in others), "no other vehicle took part"
        return Flight({line.pop("step"): line for line in lines}, order)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("autopilot", SYSIDS)
def test_pymavlink(tmp_path: Path, autopilot: str, form: str) -> None:
    flight = fly(tmp_path, "pymavlink", autopilot, form, "udp_server", "udpout:127.0.0.1:{port}")
    assert flight["connected"]["system"] == 1
    assert flight["connected"]["autopilot"] == {"px4": 12, "ardupilot": 3}[autopilot]
    parameters = flight["parameters"]
    assert parameters["received"] == parameters["announced"] and parameters["set"] == parameters["wanted"]
    for step in ("uploaded", "takeoff", "started", "land"):
        assert flight[step]["result"] == 0, step
    assert flight.order.count("downloaded") == 2, "as MISSION_ITEM and as MISSION_ITEM_INT"
    assert flight["downloaded"]["same_commands"] and flight["downloaded"]["worst_m"] < 0.1
    assert flight["flown"]["items"][-1] == flight["flown"]["count"] - 1
    assert abs(flight["landed"]["height_m"]) < 1


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("autopilot", ["ardupilot"])  # DroneKit takes item 0 of any mission for home
def test_dronekit(tmp_path: Path, autopilot: str, form: str) -> None:
    flight = fly(tmp_path, "dronekit", autopilot, form, "tcp_server", "tcp:127.0.0.1:{port}")
    assert flight["connected"] == {"system": 1, "firmware": {"px4": 12, "ardupilot": 3}[autopilot]}
    assert flight["state"]["fix"] >= 3 and flight["state"]["battery_v"] > 10
    assert flight["parameters"]["before"] != flight["parameters"]["after"]
    mission = flight["mission"]
    assert mission["back"] == mission["sent"] and mission["same_commands"] and mission["worst_m"] < 2
    assert flight["flown"]["items"][-1] >= mission["sent"] - 1
    assert ("there" in flight.order) is (autopilot == "ardupilot")
    assert abs(flight["landed"]["height_m"]) < 1


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("autopilot", ["px4"])  # MAVSDK calls the home item of an ArduCopter's mission unsupported
def test_mavsdk_over_grpc(tmp_path: Path, autopilot: str, form: str) -> None:
    server = str(free_port(socket.SOCK_STREAM))
    flight = fly(tmp_path, "mavsdk-grpc", autopilot, form, "udp_client", "udpin://127.0.0.1:{port}", server)
    assert flight["state"]["version"] == {"px4": [1, 16, 0], "ardupilot": [4, 5, 7]}[autopilot]
    assert flight["parameters"]["before"] != flight["parameters"]["after"]
    assert flight["mission"]["back"] == flight["mission"]["sent"] and flight["mission"]["worst_m"] < 0.1
    assert flight["flown"]["finished"]
    if autopilot == "px4":
        assert flight["offboard"]["active"] and flight["offboard stopped"]["mode"] == "HOLD"
    assert flight.order[-2:] == ["landed", "done"]
