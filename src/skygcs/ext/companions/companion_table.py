"""[companion] of the fleet file, on the vehicle's computer: its presence makes the daemon a companion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from skygcs.config.addresses import HostAndPort, host_and_port
from skygcs.config.models import FleetConfig
from skygcs.config.signing import SigningSettings
from skygcs.config.tables import Model
from skygcs.ext.companions.ground_contact import GroundLost

COMPANION_COMPID = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER."""

MDNS = "mdns"


class GroundAddress(NamedTuple):
    """Where the ground takes MAVLink."""

    transport: Literal["udp", "tcp"]
    host: str
    port: int


def ground_address(text: str) -> GroundAddress | None:
    """The address in ``udp:HOST:PORT`` or ``tcp:HOST:PORT``; None for "mdns". Raises ValueError in a person's words."""
    if text == MDNS:
        return None
    transport, _, rest = text.partition(":")
    if transport == "udp":
        return GroundAddress("udp", *host_and_port(rest))
    if transport == "tcp":
        return GroundAddress("tcp", *host_and_port(rest))
    raise ValueError(f'"{text}" is neither "mdns" nor an address: write udp:HOST:PORT or tcp:HOST:PORT')


def _ground(text: str) -> str:
    ground_address(text)
    return text


class CompanionConfig(Model):
    """[companion]"""

    vehicle: Annotated[str, Field(min_length=1)]
    """The vehicle behind the autopilot's link: a table [vehicles.NAME], whose system id the companion shares."""
    ground: Annotated[str, AfterValidator(_ground)] = MDNS
    """"mdns", or the address of the ground's link: udp:HOST:PORT, tcp:HOST:PORT."""
    ground_name: Annotated[str, Field(min_length=1, max_length=63)] | None = None
    """With "mdns": the only ground station to follow, by the name of its computer; None: the first one found."""
    interfaces: tuple[Annotated[str, Field(min_length=1, max_length=64)], ...] = ()
    """With "mdns": the addresses of this computer on which it is used; (): all."""
    rpc_listen: HostAndPort | None = None
    """``HOST:PORT`` where the ground gives orders, by JSON-RPC over mutual TLS; None: nowhere but the Unix socket."""
    ground_lost: GroundLost = "return"
    """The flight by setpoints of this companion (control.at = "companion" on the ground) after the ground is lost: it
    returns, holds, lands, or flies its trajectory to the end and returns then."""
    ground_lost_s: Annotated[float, Field(ge=2, le=600)] = 5.0
    """The ground is lost when neither a heartbeat nor a call of it came for so long."""
    key_dir: Path = Path("keys")
    """Holds companion.crt, companion.key and ground.crt; relative to the fleet file."""
    signing: SigningSettings | None = None
    """The keys of a link's [signing], for the link to the ground."""

    @model_validator(mode="after")
    def _named_ground(self) -> Self:
        for key, value in (("ground_name", self.ground_name), ("interfaces", self.interfaces)):
            if value and self.ground != MDNS:
                raise ValueError(f'{key} has no meaning without ground = "mdns"')
        return self


def companion_table(fleet: FleetConfig) -> CompanionConfig | None:
    """[companion] of a fleet file; None: it has none."""
    table = fleet.extensions.get("companion")
    return table if isinstance(table, CompanionConfig) else None
