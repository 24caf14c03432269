"""[web] of the fleet file: the page that `skygcs run` serves by a process of its own."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from skygcs.config.tables import Model

DEFAULT_WEB_PORT = 8750

LOOPBACK = ("127.0.0.1", "::1")

HostName = Annotated[str, Field(min_length=1, max_length=253, pattern=r"^[A-Za-z0-9.:\[\]-]+$")]

MapPointConfig = Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]
"""[x_px, y_px, lat_deg, lon_deg]"""


class WebMapConfig(Model):
    """[web.map]: an image beneath the fleet view."""

    image: Path
    """PNG or JPEG; relative to the fleet file."""
    points: Annotated[tuple[MapPointConfig, ...], Field(min_length=2, max_length=2)]
    """Two pixels (from the upper left corner) and their places: [x_px, y_px, lat_deg, lon_deg]."""


class WebConfig(Model):
    """[web]: its presence has `skygcs run` start the page."""

    port: Annotated[int, Field(ge=1, le=65535)] = DEFAULT_WEB_PORT
    host: str = "127.0.0.1"
    """Another address needs ``tls_cert``."""
    names: tuple[HostName, ...] = ()
    """With another ``host``: further names and addresses that browsers ask for."""
    tls_cert: Path | None = None
    tls_key: Path | None = None
    map: WebMapConfig | None = None
    tiles: Path | None = None
    """Raster tiles beneath the fleet view: MBTiles or PMTiles; relative to the fleet file."""

    @model_validator(mode="after")
    def _safe(self) -> Self:
        problem = address_problem(self.host, self.names, tls=self.tls_cert is not None)
        if problem is not None:
            raise ValueError(f"host {problem}")
        return self


def address_problem(host: str, names: Sequence[str], *, tls: bool) -> str | None:
    """Why a page may not be served at this address; None: it may."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return f"{host}: give an IP address of this machine, as 192.168.1.10"
    if host in LOOPBACK:
        return None
    if not tls:
        return (
            f"{host}: another address than 127.0.0.1 needs TLS, or anyone on the network could fly the fleet: "
            "set web.tls_cert and web.tls_key (--tls-cert, --tls-key)"
        )
    if address.is_unspecified and not names:
        return f"{host}: web.names must list the names or addresses that browsers will ask for"
    return None
