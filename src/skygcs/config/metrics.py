"""``[metrics]``: the HTTP address at which Prometheus scrapes the daemon."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from skygcs.config.tables import Model
from skygcs.config.web import HostName

DEFAULT_PORT = 9464
"""The port of OpenTelemetry's exporter for Prometheus; 9090 is Prometheus itself, 9100 the node exporter."""


class MetricsConfig(Model):
    """[metrics]: its presence turns the endpoint on."""

    host: str = "127.0.0.1"
    """The numeric address to listen on; other addresses than loopback need ``token_file``."""
    port: Annotated[int, Field(ge=0, le=65535)] = DEFAULT_PORT
    """0: one that the system chooses; the log names it."""
    names: tuple[HostName, ...] = ()
    """Further names and addresses by which a scraper asks, without the port."""
    token_file: Path | None = None
    """File with the token that a scraper sends (``Authorization: Bearer``), readable by you alone."""

    @field_validator("host")
    @classmethod
    def _numeric(cls, host: str) -> str:
        try:
            return str(ipaddress.ip_address(host))
        except ValueError:
            raise ValueError(f'"{host}" is not a numeric address: write 127.0.0.1, 0.0.0.0 or ::1') from None

    @model_validator(mode="after")
    def _others_need_a_token(self) -> MetricsConfig:
        if self.token_file is None and not ipaddress.ip_address(self.host).is_loopback:
            raise ValueError(f"host {self.host} can be reached by others: set token_file, or host 127.0.0.1")
        return self
