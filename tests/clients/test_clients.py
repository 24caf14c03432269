"""Programs that people fly with, each through a real `skygcs run` against simulated vehicles, as their examples do.

Shared: a link that carries everything, and one vehicle. Bound: two vehicles, one of each firmware, and a link for this
one only, shown as system 1 (docs/howto/clients.md).
"""

from __future__ import annotations

import os
import socket
from itertools import count
from pathlib import Path

import pytest

from clients.environments import CLIENTS
from clients.flights import PROGRAM_OF, Flight, fly
from support.process import DaemonProcess, wait_until

pytestmark = pytest.mark.system

SYSIDS = {"px4": 1, "ardupilot": 2}
"""Of simulated vehicles: PX4s come first."""

VERSION = {"px4": [1, 16, 1], "ardupilot": [4, 6, 3]}
"""The firmwares that the simulator is held to."""

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


def link_of(kind: str, port: int, vehicle: str, form: str) -> str:
    bound = f'vehicles = ["{vehicle}"]\ntranslated_sysid = 1\n' if form == "bound" else ""
    return f'[links.program]\ntype = "{kind}"\nhost = "127.0.0.1"\nport = {port}\nrole = "gcs"\n{bound}'


def fleet_of(autopilot: str, form: str) -> str:
    vehicles = "px4 = 1\nardupilot = 1\n" if form == "bound" else f"{autopilot} = 1\n"
    names = {"px4": 1, "ardupilot": 2} if form == "bound" else {autopilot: 1}
    named = "".join(f"[vehicles.{name}]\nsysid = {sysid}\n" for name, sysid in names.items())
    return f'[links.air]\ntype = "simulated"\nrole = "radio"\n{vehicles}{named}'


@pytest.mark.parametrize("form", ["shared", "bound"])
@pytest.mark.parametrize("autopilot", SYSIDS)
@pytest.mark.parametrize("client", PROGRAM_OF)
def test_a_program_flies_its_vehicle(tmp_path: Path, client: str, autopilot: str, form: str) -> None:
    assert CLIENTS[client].is_installed, f"{client} is not installed: `make test-clients` does that"
    program = PROGRAM_OF[client]
    port = own_port(socket.SOCK_STREAM if program.link == "tcp_server" else socket.SOCK_DGRAM)
    words = [program.connect.format(port=port), autopilot]
    if program.needs_server_port:
        words.append(str(own_port(socket.SOCK_STREAM)))
    with DaemonProcess(tmp_path, fleet_of(autopilot, form) + link_of(program.link, port, autopilot, form)) as daemon:
        wait_until(lambda: daemon.known() == (2 if form == "bound" else 1), "all vehicles are heard")
        flight = flown(client, words, tmp_path, daemon)
        others = [v for name, v in daemon.vehicles().items() if name != autopilot]
        assert not any(v["armed"] for v in others), "no other vehicle took part"
    program.check(flight, autopilot)
    if "mavsdk" in client:
        assert flight["state"]["version"] == VERSION[autopilot]


def flown(client: str, words: list[str], folder: Path, daemon: DaemonProcess) -> Flight:
    try:
        return fly(client, words, folder)
    except AssertionError as failed:
        raise AssertionError(f"{failed}\nskygcs said:\n{daemon.stderr[-2000:]}") from None
