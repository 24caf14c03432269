"""[federation] of the fleet file: this station among others, over a hub that all of them reach."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from skygcs.config.metrics import MetricsConfig
from skygcs.config.tables import KeyPath, Model, Problem

FederationRole = Literal["site", "operator", "observer"]

DEFAULT_HUB_PORT = 4222
"""Port of nats-server."""

DEFAULT_METRICS_PORT = 9465
"""Beside that of the daemon's metrics."""

SITE_PATTERN = r"^[a-z][a-z0-9-]{0,15}$"
SiteName = Annotated[str, Field(pattern=SITE_PATTERN)]

ANY_SITE = "*"
"""In lists of sites: all of them."""

MAX_SERVERS = 16
MAX_SHARED = 1000

_VEHICLE_NAME = re.compile(r"[A-Za-z0-9_]{1,64}", re.ASCII)
"""A vehicle's name is one token of a subject and of a key of the hub."""


class ServerAddress(NamedTuple):
    """Where a hub listens."""

    tls: bool
    host: str
    port: int

    @property
    def url(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'tls' if self.tls else 'nats'}://{host}:{self.port}"


def server_address(text: str) -> ServerAddress:
    """The hub at ``tls://HOST:PORT``, or ``nats://127.0.0.1:PORT``. Raises ValueError in a person's words."""
    from urllib.parse import urlsplit  # a daemon without [federation] does without

    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f'"{text}": {error}') from None
    if parts.scheme not in ("tls", "nats") or not host or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError(f'"{text}" is not an address of a hub: write tls://HOST:PORT')
    if parts.username is not None:
        raise ValueError(f'"{parts.scheme}://…@{host}": a hub knows this station by its key (federation.nkey) alone')
    address = ServerAddress(parts.scheme == "tls", host, DEFAULT_HUB_PORT if port is None else port)
    if not address.tls and not is_loopback(host):
        raise ValueError(
            f'"{text}": without TLS anyone on the way could give orders; write tls://{host}:{address.port}'
        )
    return address


def is_loopback(host: str) -> bool:
    """True for an address that only programs of this machine reach."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _server(text: str) -> str:
    return server_address(text).url


class SharedVehicle(Model):
    """[federation.vehicles.NAME]: a vehicle that several sites hear, or that may be delegated to another site."""

    home: SiteName
    """The site that commands it when nothing else is said."""
    without_hub: Literal["continue", "stop"] = "continue"
    """Reaction of its home when the hub is lost while the home holds the vehicle's lease."""


class FederationMetricsConfig(MetricsConfig):
    """[federation.metrics]: as [metrics], with the numbers of the bridge."""

    port: Annotated[int, Field(ge=0, le=65535)] = DEFAULT_METRICS_PORT
    """0: one that the system chooses; the log names it."""


class FederationConfig(Model):
    """[federation]: its presence has `skygcs run` start the process that connects this station to the hub."""

    role: FederationRole = "site"
    site: SiteName | None = None
    """Name of this station; required for role "site"."""
    servers: Annotated[tuple[Annotated[str, AfterValidator(_server)], ...], Field(min_length=1, max_length=MAX_SERVERS)]
    """Addresses of the hub, tls://HOST:PORT, tried in turn; nats:// on loopback only."""
    nkey: Path
    """File with the seed of this station's key, made by `skygcs federation keys`; relative to the fleet file."""
    ca: Path | None = None
    """Certificates that the hub's must be signed by; None: those that the system trusts."""
    cert: Path | None = None
    """This station's certificate, for a hub that asks for one."""
    key: Path | None = None
    rate_hz: Annotated[float, Field(ge=1, le=20)] = 10.0
    """Batches of states a second that are published; another series has 2."""
    subscribe_hz: Literal[10, 2] = 10
    """Which of the two series of other sites is read: 10 is theirs at ``rate_hz``."""
    share: tuple[Annotated[str, Field(min_length=1, max_length=128)], ...] = ("all",)
    """Targets: the vehicles whose states are published."""
    vehicles: Annotated[dict[str, SharedVehicle], Field(max_length=MAX_SHARED)] = Field(default_factory=dict)
    """Only those that need a lease; every other vehicle is commanded by the site that has it."""
    metrics: FederationMetricsConfig | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.role == "site" and self.site is None:
            raise ValueError('site is missing: role "site" needs the name of this station, as "north"')
        if self.role != "site" and self.vehicles:
            raise ValueError(f'vehicles has no meaning for role "{self.role}", which commands no vehicle of its own')
        if (self.cert is None) != (self.key is None):
            missing, there = ("cert", "key") if self.cert is None else ("key", "cert")
            raise ValueError(f"{missing} is missing: {there} needs it")
        return self

    @property
    def uses_tls(self) -> bool:
        return any(server_address(server).tls for server in self.servers)


def federation_problems(federation: FederationConfig, vehicles: Collection[str]) -> list[Problem]:
    """Return what contradicts the rest of the fleet file, whose vehicles have these names."""
    problems: list[Problem] = []
    at: KeyPath = ("federation", "vehicles")
    for name in federation.vehicles:
        if name not in vehicles:
            known = ", ".join(sorted(vehicles)) or "none"
            problems.append(Problem((*at, name), f"is not a vehicle of this file; vehicles: {known}"))
    if federation.role == "site":
        text = (
            "is part of the hub's subjects: letters of ASCII, digits and _ only, at most 64 (there is a [federation])"
        )
        problems += [Problem(("vehicles", name), text) for name in vehicles if not _VEHICLE_NAME.fullmatch(name)]
    return problems
