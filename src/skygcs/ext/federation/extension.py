"""The daemon's part of [federation]: authority over shared vehicles, and the process that connects this station.

The process (`skygcs federation run`) talks to the hub and is a client of the socket. The daemon knows only which
vehicles are shared, and until when this site may command each: it judges at the moment of sending, by its own clock.
"""

from __future__ import annotations

import asyncio
import os
import secrets
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skygcs.config.station_path import station_socket
from skygcs.errors import SkygcsError
from skygcs.ext.federation import methods
from skygcs.ext.federation.authority import Authority
from skygcs.ext.federation.config import FederationConfig, federation_problems, is_loopback, server_address
from skygcs.ext.federation.server_program import find_server, server_version, version_warning
from skygcs.process_extension import ProcessExtension
from skygcs.runtime.supervised_child import SupervisedChild

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig
    from skygcs.config.tables import Problem
    from skygcs.core.routing.send_gates import SendGate
    from skygcs.extension import StateGroup
    from skygcs.rpc.context import Services
    from skygcs.runtime.vehicle_actor import VehicleActor


PACKAGES = ("nats", "nkeys")
"""Modules of the extra of this name."""


class Federation(ProcessExtension[FederationConfig]):
    """Gates the shared vehicles, and keeps the process running."""

    Config = FederationConfig
    names = ("authority",)
    own_methods = methods.METHODS

    def __init__(self, core: Services, config: FederationConfig) -> None:
        super().__init__(core, config)
        self.authority = _authority(config, core.config)
        self.daemon_run = secrets.token_hex(8)
        """Names this run of the daemon to the process."""
        line, more = federation_arguments(core.source, core.socket_path), _station(config, core.socket_path)
        loop, publish = asyncio.get_running_loop(), core.event_log.publish
        self.child = SupervisedChild("the bridge to other stations", "federation", line, loop, publish, more=more)

    # -- its table

    @classmethod
    def problems(cls, config: Any, fleet: FleetConfig) -> list[Problem]:
        return federation_problems(config, fleet.vehicles)

    @classmethod
    def notes(cls, config: Any) -> list[str]:
        """Packages and files that are missing, and what is wrong with the nats-server of this computer if it is the
        hub's."""
        missing = [module for module in PACKAGES if find_spec(module) is None]
        notes = [f"{', '.join(missing)} is not installed here: pip install 'skygcs[federation]'"] if missing else []
        for key in ("nkey", "ca", "cert", "key"):
            path = getattr(config, key)
            if path is not None and not os.path.isfile(path):
                notes.append(f"the file {path} ({key}) does not exist now")
        if any(is_loopback(server_address(server).host) for server in config.servers):
            notes += _server_notes()
        return notes

    @classmethod
    def applied(cls, config: Any, fleet: FleetConfig) -> FleetConfig:
        return fleet.model_copy(update={"delegated": fleet.delegated | config.vehicles.keys()})

    @classmethod
    def summary(cls, config: Any) -> str:
        return f"{', '.join(config.servers)} as {config.role} {config.site or ''}".rstrip()

    # -- its parts

    def state_groups(self) -> Mapping[str, StateGroup]:
        return {"authority": self._state_group}

    def _state_group(self, vehicle: VehicleActor, _: float) -> dict[str, Any] | None:
        return self.state_of(vehicle.sysid)

    def state_of(self, sysid: int) -> dict[str, Any] | None:
        """Authority over a vehicle now; None if it is not shared."""
        if self.authority is None or (state := self.authority.status_of(sysid, self.core.hub.boot_clock())) is None:
            return None
        gates = self.core.hub.send_gates
        return {**state, "blocked_frames": 0 if gates is None else gates.blocked(sysid)}

    def send_gate(self) -> SendGate | None:
        return self.authority


def _authority(config: FederationConfig, fleet: FleetConfig) -> Authority | None:
    """Authority over the vehicles that other sites may command; None without [federation.vehicles]."""
    if config.site is None or not config.vehicles:
        return None
    return Authority(config.site, {name: fleet.vehicles[name].sysid for name in config.vehicles})


def _server_notes() -> list[str]:
    try:
        warning = version_warning(server_version(find_server()))
    except SkygcsError as error:
        warning = str(error)
    return [] if warning is None else [f"servers: {warning}"]


def _station(config: FederationConfig, socket_path: Path) -> dict[str, Any]:
    """The station of the process, for daemon.info."""
    return {"site": config.site, "role": config.role, "socket": station_socket(str(socket_path))}


def federation_arguments(fleet_file: str, socket_path: Path) -> list[str]:
    """The arguments of `skygcs` for this fleet file. The process reads the file itself, and ends if that cannot be
    read."""
    return ["federation", "run", "--supervised", "--socket", os.fspath(socket_path), fleet_file]
