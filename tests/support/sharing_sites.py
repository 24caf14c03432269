"""Two real daemons with their bridges, and one vehicle that both hear."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.heard_vehicle import HeardVehicle, Orders
from support.hub import Hub
from support.process import DaemonProcess, call_socket, free_port, wait_until

ALPHA = 7
STATION = {"north": 254, "south": 253}
"""System ids of the ground stations: the vehicle's log tells them apart by these."""


@dataclass
class Sites:
    """``north`` is the home."""

    north: DaemonProcess
    south: DaemonProcess
    alpha: HeardVehicle

    def pids(self, name: str, part: str) -> list[int]:
        """Of a site's "daemon", "bridge" or "both"."""
        daemon: DaemonProcess = getattr(self, name)
        assert daemon.process is not None
        found = {"daemon": daemon.process.pid, "bridge": self.bridge_of(daemon)}
        return [pid for key, pid in found.items() if part in (key, "both")]

    @staticmethod
    def bridge_of(daemon: DaemonProcess) -> int:
        return int(daemon.call("daemon.info")["federation"]["pid"])

    def signal(self, pids: list[int], number: signal.Signals) -> None:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

    def holder(self) -> str | None:
        """By the daemons' gates."""
        held = [n for n in STATION if (getattr(self, n).call("authority.status")["vehicles"]["alpha"]["held"])]
        assert len(held) < 2, held
        return held[0] if held else None

    def wait_for(self, name: str) -> None:
        wait_until(lambda: self.holder() == name, f"{name} holds alpha's lease")

    def sends(self, name: str, since_s: float = 0.0) -> list[Any]:
        return self.alpha.of(STATION[name], since_s)


def seen_holder(daemon: DaemonProcess) -> str | None:
    """As the bridge of a site sees it."""
    try:
        leases = call_socket(station_socket(daemon), "federation.leases")
    except OSError:
        return None  # it is not there yet
    return leases[0]["holder"] if leases else None


def station_socket(daemon: DaemonProcess) -> Path:
    return daemon.socket.with_name(daemon.socket.name + ".federation")


def _joined(hub: Hub, name: str) -> str:
    return f"""[federation]
site = "{name}"
servers = ["{hub.url}"]
nkey = "{hub.key_file(name)}"
[federation.vehicles.alpha]
home = "north\""""


def fleet_file(hub: Hub, name: str, port: int, without_hub: str) -> str:
    """To be put behind the first lines of [daemon]."""
    return f"""
sysid = {STATION[name]}
[links.air]
type = "udp_server"
host = "127.0.0.1"
port = {port}
role = "vehicle"
[vehicles.alpha]
sysid = {ALPHA}
{_joined(hub, name)}
without_hub = "{without_hub}"
"""


@contextlib.contextmanager
def sharing_sites(hub: Hub, folder: Path, without_hub: str = "stop") -> Iterator[Sites]:
    """Both run, both hear the vehicle, both have clients that order it without end, and the home commands it."""
    ports = {name: free_port() for name in STATION}
    north, south = (DaemonProcess(folder, fleet_file(hub, n, ports[n], without_hub), name=n) for n in STATION)
    with contextlib.ExitStack() as stack:
        sites = Sites(stack.enter_context(north), stack.enter_context(south), HeardVehicle(ALPHA, ports))
        stack.enter_context(sites.alpha)
        for daemon in (north, south):
            known: Callable[[], Any] = lambda d=daemon: "alpha" in d.vehicles()  # noqa: E731
            wait_until(known, "the vehicle is heard")
            stack.enter_context(Orders(daemon, "alpha"))
        sites.wait_for("north")
        wait_until(lambda: sites.sends("north"), "frames of north arrive")
        # only a site that saw the holder takes over from it by itself
        wait_until(lambda: seen_holder(south) == "north", "south's bridge sees who holds the lease")
        yield sites


def home_with_flight(hub: Hub) -> str:
    """The fleet file of north alone, with a simulated vehicle of its own that it goes on with without the hub."""
    return f"""
[links.sim]
type = "simulated"
px4 = 1
ardupilot = 0
[vehicles.alpha]
sysid = 1
{_joined(hub, "north")}
"""


class Flight:
    """Of alpha, in position control of north's daemon."""

    def __init__(self, north: DaemonProcess) -> None:
        self.north = north
        self.station = station_socket(north)

    def begin(self) -> None:
        """Take off and control it."""
        north = self.north
        wait_until(lambda: "alpha" in north.vehicles(), "the vehicle is heard")
        wait_until(lambda: self.held(), "north holds its lease")
        wait_until(lambda: (north.vehicles()["alpha"]["position"] or {}).get("lat_deg"), "it has a position")
        north.call("origin.from_vehicle", target="alpha")
        for method, params in (("vehicles.takeoff", {"wait_s": 60.0}), ("control.set", {"mode": "position"})):
            self._retried(method, params)

    def _retried(self, method: str, params: dict[str, Any]) -> None:
        """A simulated vehicle needs a few seconds until it may fly."""
        outcomes: list[Any] = []

        def ok() -> bool:
            outcomes.append(self.north.call(method, targets="alpha", **params)["outcomes"]["alpha"])
            return bool(outcomes[-1]["ok"])

        try:
            wait_until(ok, method)
        except AssertionError:
            raise AssertionError(f"{method}: {outcomes[-1]}") from None

    def held(self) -> bool:
        return bool(self.north.call("authority.status")["vehicles"]["alpha"]["held"])

    def ticks(self) -> int:
        """Of its control, which must be flying."""
        (state,) = self.north.call("control.status", targets="alpha")
        assert state["state"] == "flying", state
        return int(state["ticks"])

    def lease(self) -> str:
        """How the bridge sees it."""
        (lease,) = call_socket(self.station, "federation.leases")
        return str(lease["state"])
