"""[companions] of the fleet file, on the ground: the computers on the vehicles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from skygcs.config.addresses import HostAndPort
from skygcs.config.models import FleetConfig, TcpServerLinkConfig, UdpServerLinkConfig
from skygcs.config.tables import KeyPath, Model, Problem

HostText = Annotated[str, Field(min_length=1, max_length=253, pattern=r"^[A-Za-z0-9._:%-]+$")]
"""A name or a numeric address, without a port."""

Architecture = Literal["x86_64", "aarch64", "armv7l"]
"""Words that `uname -m` prints."""

MAX_COMPANIONS = 250


class CompanionEntry(Model):
    """[companions.NAME]: the computer on one vehicle."""

    host: HostText | None = None
    """Where SSH reaches it."""
    user: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    """User of SSH; None: as SSH itself decides."""
    ssh_port: Annotated[int, Field(ge=1, le=65535)] = 22
    rpc: HostAndPort | None = None
    """``HOST:PORT`` of its JSON-RPC over TLS; None: no orders go there."""
    vehicle: Annotated[str, Field(min_length=1)] | None = None
    """The vehicle it is on, by name; None: the one with the companion's name."""
    arch: Architecture | None = None
    """The architecture of its offline bundle; None: asked of the computer."""


class CompanionsConfig(Model):
    """[companions]: its tables are the companions by name, its plain keys are for all of them."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, CompanionEntry] = Field(init=False)

    advertise: bool = False
    """Announce this ground station by mDNS, for companions with ground = "mdns"."""
    name: Annotated[str, Field(min_length=1, max_length=63, pattern=r"^[A-Za-z0-9_-]+$")] | None = None
    """The name that is announced; None: the name of this computer."""
    link: str | None = None
    """The link of type udp_server or tcp_server that is announced; None: the only one of them."""
    interfaces: tuple[Annotated[str, Field(min_length=1, max_length=64)], ...] = ()
    """The addresses of this computer that are announced, where it has several; (): all."""
    key_dir: Path = Path("keys")
    """Holds ground.crt and ground.key, and companions/NAME.crt for each companion; relative to the fleet file."""

    @property
    def entries(self) -> dict[str, CompanionEntry]:
        """Every companion by its name."""
        return dict(self.__pydantic_extra__ or {})

    def vehicle_of(self, name: str) -> str:
        """Name of the vehicle that a companion is on."""
        return self.entries[name].vehicle or name

    def of_vehicle(self, vehicle: str) -> str | None:
        """Name of the companion on a vehicle; None if it has none."""
        return next((name for name in self.entries if self.vehicle_of(name) == vehicle), None)


def companions_table(fleet: FleetConfig) -> CompanionsConfig | None:
    """[companions] of a fleet file; None: it has none."""
    table = fleet.extensions.get("companions")
    return table if isinstance(table, CompanionsConfig) else None


def companions_problems(companions: CompanionsConfig, fleet: FleetConfig) -> list[Problem]:
    """Contradictions to the rest of the fleet file."""
    problems: list[Problem] = []
    vehicles = fleet.vehicles
    owner: dict[str, str] = {}
    for name, entry in companions.entries.items():
        path: KeyPath = ("companions", name)
        if not name.isascii() or not name.replace("-", "").replace("_", "").isalnum():
            problems.append(Problem(path, "a companion's name has letters, digits, - and _ only: files have it"))
        vehicle = companions.vehicle_of(name)
        if vehicle not in vehicles:
            known = ", ".join(sorted(vehicles)) or "none"
            at = path if entry.vehicle is None else (*path, "vehicle")
            problems.append(Problem(at, f"{vehicle!r} is not a vehicle of this file; vehicles: {known}"))
        elif vehicle in owner:
            problems.append(Problem(path, f"is on vehicle {vehicle}, which has the companion {owner[vehicle]} already"))
        owner.setdefault(vehicle, name)
    if len(companions.entries) > MAX_COMPANIONS:
        problems.append(Problem(("companions",), f"names {len(companions.entries)}; at most {MAX_COMPANIONS}"))
    if companions.advertise:
        problems += _advertise_problems(companions, servers_of(fleet))
    elif companions.link is not None:
        problems.append(Problem(("companions", "link"), "has no meaning without advertise = true"))
    return problems


def servers_of(fleet: FleetConfig) -> list[str]:
    """The enabled links that companions can connect to."""
    kinds = (UdpServerLinkConfig, TcpServerLinkConfig)
    return [name for name, link in fleet.links.items() if link.enabled and isinstance(link, kinds)]


def _advertise_problems(companions: CompanionsConfig, servers: list[str]) -> list[Problem]:
    known = ", ".join(servers) or "none"
    if companions.link is None and len(servers) != 1:
        text = f"needs `link`, the one link that is announced; links of type udp_server and tcp_server: {known}"
        return [Problem(("companions", "advertise"), text)]
    if companions.link is not None and companions.link not in servers:
        text = f"{companions.link!r} is no enabled link of type udp_server or tcp_server; there are: {known}"
        return [Problem(("companions", "link"), text)]
    return []
