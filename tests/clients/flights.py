"""A client's program flown to its end, and what it has to have seen by then, on simulated and on real vehicles."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clients.environments import CLIENTS

PROGRAMS = Path(__file__).parent / "programs"
FLIGHT_LIMIT_S = 600.0
"""How long a flight may take on a machine that does other things; it takes about a minute."""

MAV_AUTOPILOT = {"px4": 12, "ardupilot": 3}


@dataclass(frozen=True)
class Flight:
    """What a program saw, by step; a step that came twice has its last facts."""

    steps: dict[str, dict[str, Any]]
    order: list[str]

    def __getitem__(self, step: str) -> dict[str, Any]:
        return self.steps[step]


def fly(client: str, words: list[str], folder: Path) -> Flight:
    """Run a client's program until it ends, with all that it started; it has to reach its own end. What it
    says is in ``folder``, program.out and program.log.
    """
    environment = {**os.environ, "MAVLINK20": "1", "PYTHONUNBUFFERED": "1"}
    log, steps = folder / "program.log", folder / "program.out"
    command = [str(CLIENTS[client].python), str(PROGRAMS / f"{client.replace('-', '_')}_flight.py"), *words]
    # files and no pipes, whose end would come with the last of the processes that it started
    with log.open("wb") as stderr, steps.open("wb") as stdout:
        program = subprocess.Popen(
            command, stdout=stdout, stderr=stderr, cwd=folder, env=environment, start_new_session=True
        )
        try:
            with suppress(subprocess.TimeoutExpired):
                program.wait(FLIGHT_LIMIT_S)
        finally:
            with suppress(ProcessLookupError):  # mavsdk_server, MAVProxy
                os.killpg(program.pid, signal.SIGKILL)
            code = program.wait()
    output = steps.read_text(errors="replace")
    lines = [json.loads(line) for line in output.splitlines() if line.startswith('{"step"') and line.endswith("}")]
    order = [line["step"] for line in lines]
    if code != 0 or order[-1:] != ["done"]:
        said = output[-4000:], log.read_text(errors="replace")[-4000:]
        raise AssertionError(f"{client} ended with {code}:\n{said[0]}\n{said[1]}")
    return Flight({line.pop("step"): line for line in lines}, order)


def check_pymavlink(flight: Flight, autopilot: str) -> None:
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


def check_dronekit(flight: Flight, autopilot: str) -> None:
    assert flight["connected"] == {"system": 1, "firmware": MAV_AUTOPILOT[autopilot]}
    assert flight["state"]["fix"] >= 3 and flight["state"]["battery_v"] > 10
    assert flight["parameters"]["before"] != flight["parameters"]["after"]
    mission = flight["mission"]
    hidden = 1 if autopilot == "px4" else 0  # DroneKit shows no item 0: on a PX4 that is the take-off
    assert mission["shown"] == mission["sent"] - hidden and mission["same_commands"] and mission["worst_m"] < 2
    assert flight["flown"]["items"][-1] >= mission["sent"] - 1
    for step in ("there", "velocity"):
        assert (step in flight.order) is (autopilot == "ardupilot")
    assert abs(flight["landed"]["height_m"]) < 1


def check_mavsdk_grpc(flight: Flight, autopilot: str) -> None:
    parameters = flight["parameters"]
    assert parameters["before"] != parameters["after"] and parameters["ints"] and parameters["floats"]
    assert flight["mission"]["back"] == flight["mission"]["sent"] and flight["mission"]["worst_m"] < 0.1
    if autopilot == "ardupilot":  # its home has a frame that MAVSDK's plugin `mission` does not know, GLOBAL
        assert flight["mission plugin"]["result"] == "UNSUPPORTED"
    assert flight["flown"]["finished"]
    for step in ("armed", "up", "there", "offboard position", "offboard velocity"):
        assert step in flight.order
    assert flight["offboard"]["active"] and flight["offboard stopped"]["mode"] == "HOLD"
    assert flight.order[-2:] == ["landed", "done"]


def check_mavsdk(flight: Flight, autopilot: str) -> None:
    check_mavsdk_grpc(flight, autopilot)
    assert flight["connected"] == {"system": 1, "autopilot": {"px4": "PX4", "ardupilot": "ARDUPILOT"}[autopilot]}
    assert flight["heights"]["takeoff_m"] == 3
    if autopilot == "px4":
        assert flight.order.index("down") < flight.order.index("mission") < flight.order.index("paused")


def check_mavproxy(flight: Flight, autopilot: str) -> None:
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


@dataclass(frozen=True)
class Program:
    """How a client is connected: the type of the daemon's link, what it is given, and what it must have seen."""

    link: str
    connect: str
    """With {port}: the link's."""
    check: Callable[[Flight, str], None]
    needs_server_port: bool = False


PROGRAM_OF: Mapping[str, Program] = {
    "pymavlink": Program("udp_server", "udpout:127.0.0.1:{port}", check_pymavlink),
    "dronekit": Program("tcp_server", "tcp:127.0.0.1:{port}", check_dronekit),
    "mavsdk-grpc": Program("udp_client", "udpin://127.0.0.1:{port}", check_mavsdk_grpc, needs_server_port=True),
    "mavsdk": Program("udp_client", "udpin://127.0.0.1:{port}", check_mavsdk),
    "mavproxy": Program("tcp_server", "tcp:127.0.0.1:{port}", check_mavproxy),
}
