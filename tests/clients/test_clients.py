"""Programs that people fly with, each through a real `skygcs run` against simulated vehicles, as their examples do.

Shared: a link that carries everything, and one vehicle. Bound: two vehicles, one of each firmware, and a link for this
one only, shown as system 1 (docs/howto/clients.md).
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from clients.environments import CLIENTS
from support.process import DaemonProcess, wait_until

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

PROGRAMS = Path(__file__).parent / "programs"
FLIGHT_LIMIT_S = 600.0
"""How long a flight may take on a machine that does other things; it takes about a minute."""

SYSIDS = {"px4": 1, "ardupilot": 2}
"""Of simulated vehicles: PX4s come first."""

FORMS = ("shared", "bound")

both_autopilots = pytest.mark.parametrize("autopilot", SYSIDS)
both_forms = pytest.mark.parametrize("form", FORMS)

MAV_AUTOPILOT = {"px4": 12, "ardupilot": 3}
VERSION = {"px4": [1, 16, 0], "ardupilot": [4, 5, 7]}

_ports = count(20000 + os.getpid() % 600 * 20)
"""Below those that systems give out by themselves, and others in each process: flights start beside each other."""


def own_port(kind: int) -> int:
    """A port on loopback that nobody else takes before it is used."""
    while True:
        port = next(_ports)
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


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


def run(client: str, words: list[str], folder: Path) -> tuple[int, str]:
    """A client's program until it ends, with all that it started. Returns its exit code and what it wrote; its errors
    are in ``folder``/program.log.
    """
    environment = {**os.environ, "MAVLINK20": "1", "PYTHONUNBUFFERED": "1"}
    with (folder / "program.log").open("wb") as stderr:
        program = subprocess.Popen(
            [str(CLIENTS[client].python), str(PROGRAMS / f"{client.replace('-', '_')}_flight.py"), *words],
            stdout=subprocess.PIPE,
            stderr=stderr,
            cwd=folder,
            env=environment,
            start_new_session=True,
        )
        try:
            output, _ = program.communicate(timeout=FLIGHT_LIMIT_S)
        except subprocess.TimeoutExpired as late:
            output = (late.stdout or b"") + b"\nit did not end"
        finally:
            with suppress(ProcessLookupError):  # what it started: mavsdk_server, MAVProxy
                os.killpg(program.pid, signal.SIGKILL)
            code = program.wait()
    return code, output.decode(errors="replace")


def fly(folder: Path, client: str, autopilot: str, form: str, kind: str, connect: str, *more: str) -> Flight:
    """Start a daemon and the client's program, which gets ``connect`` with the link's port; it has to reach its end."""
    assert CLIENTS[client].is_installed, f"{client} is not installed: `make test-clients` does that"
    port = own_port(socket.SOCK_STREAM if kind == "tcp_server" else socket.SOCK_DGRAM)
    toml = fleet_of(autopilot, form) + link_of(kind, port, autopilot, form)
    with DaemonProcess(folder, toml) as daemon:
        wait_until(lambda: daemon.known() == (2 if form == "bound" else 1), "all vehicles are heard")
        code, output = run(client, [connect.format(port=port), autopilot, *more], folder)
        lines = [json.loads(line) for line in output.splitlines() if line.startswith('{"step"')]
        order = [line["step"] for line in lines]
        if code != 0 or order[-1:] != ["done"]:
            errors = (folder / "program.log").read_text(errors="replace")[-4000:]
            pytest.fail(
                f"{client} ended with {code}:\n{output[-4000:]}\n{errors}\nskygcs said:\n{daemon.stderr[-2000:]}"
            )
        others = [v for name, v in daemon.vehicles().items() if name != autopilot]
        assert not any(v["armed"] for v in others), "no other vehicle took part"
        return Flight({line.pop("step"): line for line in lines}, order)


@both_forms
@both_autopilots
def test_pymavlink(tmp_path: Path, autopilot: str, form: str) -> None:
    flight = fly(tmp_path, "pymavlink", autopilot, form, "udp_server", "udpout:127.0.0.1:{port}")
    assert flight["connected"]["system"] == 1
    assert flight["connected"]["autopilot"] == MAV_AUTOPILOT[autopilot]
    parameters = flight["parameters"]
    assert parameters["received"] == parameters["announced"] and parameters["set"] == parameters["wanted"]
    for step in ("uploaded", "takeoff", "started", "land"):
        assert flight[step]["result"] == 0, step
    assert flight.order.count("downloaded") == 2, "as MISSION_ITEM and as MISSION_ITEM_INT"
    assert flight["downloaded"]["same_commands"] and flight["downloaded"]["worst_m"] < 0.1
    assert flight["flown"]["items"][-1] == flight["flown"]["count"] - 1
    assert abs(flight["landed"]["height_m"]) < 1


@both_forms
@both_autopilots
def test_dronekit(tmp_path: Path, autopilot: str, form: str) -> None:
    flight = fly(tmp_path, "dronekit", autopilot, form, "tcp_server", "tcp:127.0.0.1:{port}")
    assert flight["connected"] == {"system": 1, "firmware": MAV_AUTOPILOT[autopilot]}
    assert flight["state"]["fix"] >= 3 and flight["state"]["battery_v"] > 10
    assert flight["parameters"]["before"] != flight["parameters"]["after"]
    mission = flight["mission"]
    hidden = 1 if autopilot == "px4" else 0  # DroneKit shows no item 0: on a PX4 that is the take-off
    assert mission["shown"] == mission["sent"] - hidden and mission["same_commands"] and mission["worst_m"] < 2
    assert flight["flown"]["items"][-1] >= mission["sent"] - 1
    assert ("there" in flight.order) is (autopilot == "ardupilot")
    assert abs(flight["landed"]["height_m"]) < 1


@both_forms
@both_autopilots
def test_mavsdk_over_grpc(tmp_path: Path, autopilot: str, form: str) -> None:
    server = str(own_port(socket.SOCK_STREAM))
    flight = fly(tmp_path, "mavsdk-grpc", autopilot, form, "udp_client", "udpin://127.0.0.1:{port}", server)
    assert_mavsdk(flight, autopilot)


@both_forms
@both_autopilots
def test_mavsdk(tmp_path: Path, autopilot: str, form: str) -> None:
    flight = fly(tmp_path, "mavsdk", autopilot, form, "udp_client", "udpin://127.0.0.1:{port}")
    assert flight["connected"] == {"system": 1, "autopilot": {"px4": "PX4", "ardupilot": "ARDUPILOT"}[autopilot]}
    assert flight["heights"]["takeoff_m"] == 3
    if autopilot == "px4":
        assert flight.order.index("down") < flight.order.index("mission") < flight.order.index("paused")
    assert_mavsdk(flight, autopilot)


def assert_mavsdk(flight: Flight, autopilot: str) -> None:
    assert flight["state"]["version"] == VERSION[autopilot]
    parameters = flight["parameters"]
    assert parameters["before"] != parameters["after"] and parameters["ints"] and parameters["floats"]
    assert flight["mission"]["back"] == flight["mission"]["sent"] and flight["mission"]["worst_m"] < 0.1
    if (
        autopilot == "ardupilot"
    ):  # frame GLOBAL, which MAVSDK's plugin `mission` does not know: a real one answers so too
        assert flight["mission plugin"]["result"] == "UNSUPPORTED"
    assert flight["flown"]["finished"]
    for step in ("armed", "up", "there", "offboard position", "offboard velocity"):
        assert step in flight.order
    assert flight["offboard"]["active"] and flight["offboard stopped"]["mode"] == "HOLD"
    assert flight.order[-2:] == ["landed", "done"]


@both_forms
@both_autopilots
def test_mavproxy(tmp_path: Path, autopilot: str, form: str) -> None:
    flight = fly(tmp_path, "mavproxy", autopilot, form, "tcp_server", "tcp:127.0.0.1:{port}")
    parameters = flight["parameters"]
    assert parameters["received"] > 30 and parameters["before"] != parameters["after"]
    mission = flight["mission"]
    assert mission["back"] == mission["sent"] and mission["same_commands"] and mission["worst_m"] < 0.1
    assert flight["takeoff"]["answer"] == "ACCEPTED"
    assert ("velocity" in flight.order) is (autopilot == "ardupilot")
    assert flight["flown"]["item"] == mission["sent"] - 1
    for step in ("armed", "up", "there", "returning"):
        assert step in flight.order
    assert abs(flight["landed"]["height_m"]) < 1
