"""The companions of a fleet file, and which of them a target expression names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.core.vehicle.targets import select
from skygcs.errors import ConfigError

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig

FLEET_VARIABLE = "SKYGCS_FLEET"
"""Environment variable: the fleet file of commands that need no daemon."""

AUTOPILOT_COMPID = 1


@dataclass(frozen=True, slots=True)
class Companion:
    """One computer on a vehicle: where SSH reaches it, and the vehicle it is on."""

    name: str
    vehicle: str
    sysid: int
    host: str | None
    """None: the fleet file does not say."""
    user: str | None
    """None: as SSH itself decides."""
    port: int
    rpc: str | None
    """``HOST:PORT`` of its JSON-RPC over TLS; None: it has none."""
    arch: str | None
    groups: tuple[str, ...]
    """Words that select it besides its name: its vehicle, and the vehicle's groups."""
    compid: int = AUTOPILOT_COMPID

    @property
    def place(self) -> str:
        """``user@host:port`` without what is usual."""
        user = f"{self.user}@" if self.user else ""
        return f"{user}{self.host or '?'}" + ("" if self.port == 22 else f":{self.port}")


@dataclass(frozen=True, slots=True)
class Inventory:
    """A fleet file, and its companions by system id of their vehicles."""

    path: Path
    config: FleetConfig
    key_dir: Path
    """Folder with the ground's certificate and those of the companions."""
    companions: tuple[Companion, ...]

    def chosen(self, targets: str | Sequence[str]) -> list[Companion]:
        """The companions of a target expression, by system id. Raises TargetError."""
        return select(targets, self.companions)


def load_inventory(path: Path) -> Inventory:
    """The companions of a fleet file. Raises ConfigError, also for a file without any."""
    inventory = load_vehicles(path)
    if not inventory.companions:
        raise ConfigError(str(path), ["has no table [companions.NAME]: docs/howto/companion.md"])
    return inventory


def load_vehicles(path: Path) -> Inventory:
    """A fleet file whose vehicles may have companions or not. Raises ConfigError, also for a file without vehicles."""
    from skygcs.config.loader import load_fleet
    from skygcs.ext.companions.companions_table import CompanionsConfig, companions_table

    config = load_fleet(path)
    table = companions_table(config) or CompanionsConfig()
    vehicles = {vehicle.name: vehicle for vehicle in config.vehicle_configs()}
    if not vehicles:
        raise ConfigError(str(path), ["has no table [vehicles.NAME]: docs/reference/fleet-file.md"])
    made = []
    for name, entry in table.entries.items():
        vehicle = vehicles[table.vehicle_of(name)]
        words = (*([] if vehicle.name == name else [vehicle.name]), *vehicle.groups)
        made.append(
            Companion(
                name=name,
                vehicle=vehicle.name,
                sysid=vehicle.sysid,
                host=entry.host,
                user=entry.user,
                port=entry.ssh_port,
                rpc=entry.rpc,
                arch=entry.arch,
                groups=words,
            )
        )
    return Inventory(path, config, table.key_dir, tuple(sorted(made, key=lambda companion: companion.sysid)))
