"""[corrections] of the fleet file: where the daemon gets RTK corrections itself."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import unquote, urlsplit

from pydantic import Field, field_validator, model_validator

from skygcs.config.models import FleetConfig
from skygcs.config.tables import Model, Problem
from skygcs.ext.corrections.ntrip import Mountpoint

NTRIP_PORT = 2101
"""IANA's."""
NTRIPS_PORT = 443

EXAMPLE = "ntrip://USER@caster.example:2101/MOUNTPOINT"

NTRIP_KEYS = frozenset({"revision", "password_file", "password_env", "ca_file", "gga_s", "gga_from", "silent_s"})
SERIAL_KEYS = frozenset(
    {"baud", "port", "survey_s", "survey_accuracy_m", "position", "position_accuracy_m", "observations"}
)

_PLAIN = re.compile(r"[!-~]+")
"""ASCII without spaces and control characters, as a request line takes it."""


class CorrectionsConfig(Model):
    """[corrections]: a caster (``ntrip``) or a base receiver of one's own (``serial``)."""

    ntrip: str | None = None
    """ntrip://USER@HOST:PORT/MOUNTPOINT, ntrips:// for TLS; without a password."""
    revision: Literal[1, 2] = 2
    """Revision of NTRIP of the request; either answer is understood."""
    password_file: Path | None = None
    """File with the password, readable by you alone."""
    password_env: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")] | None = None
    """Name of the environment variable with the password."""
    ca_file: Path | None = None
    """Certificates (PEM) that the caster's is checked with, in place of the system's."""
    gga_s: Annotated[float, Field(ge=0, le=600)] = 10.0
    """Period of a vehicle's position for the caster, which a virtual station needs; 0: never."""
    gga_from: str | None = None
    """The vehicle whose position that is; None: the first that has a fix."""
    silent_s: Annotated[float, Field(ge=3, le=300)] = 20.0
    """A caster that sends nothing for so long is given up, and called again."""
    serial: Annotated[str, Field(min_length=1)] | None = None
    """Device of a u-blox receiver."""
    baud: Annotated[int, Field(ge=4800, le=3_000_000)] = 38400
    port: Literal["auto", "usb", "uart1", "uart2"] = "auto"
    """The receiver's port that the cable is in; auto: usb for /dev/ttyACM*, else uart1."""
    survey_s: Annotated[float, Field(ge=10, le=86400)] = 300.0
    survey_accuracy_m: Annotated[float, Field(ge=0.01, le=100)] = 2.0
    position: tuple[float, float, float] | None = None
    """The antenna's latitude, longitude (degrees) and height above the ellipsoid (m), in place of a survey."""
    position_accuracy_m: Annotated[float, Field(ge=0.0001, le=10)] = 0.01
    observations: Literal["msm4", "msm7"] = "msm4"

    @property
    def mountpoint(self) -> Mountpoint:
        """The stream of ``ntrip``. Raises ValueError, which the check of the table has seen to."""
        assert self.ntrip is not None
        return parse_ntrip(self.ntrip)

    @field_validator("ntrip")
    @classmethod
    def _address(cls, ntrip: str | None) -> str | None:
        if ntrip is not None:
            parse_ntrip(ntrip)
        return ntrip

    @field_validator("position")
    @classmethod
    def _on_earth(cls, position: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if position is not None:
            lat, lon, height = position
            if not (abs(lat) <= 90 and abs(lon) <= 180 and -1000 <= height <= 10000):
                raise ValueError("must be [latitude, longitude, height]: degrees, degrees, metres above the ellipsoid")
        return position

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        given = self.model_fields_set
        if (self.ntrip is None) == (self.serial is None):
            raise ValueError(f'needs one of ntrip = "{EXAMPLE}" and serial = "/dev/ttyACM0"')
        for key in sorted(given & (SERIAL_KEYS if self.ntrip is not None else NTRIP_KEYS)):
            raise ValueError(f"{key} has no meaning with {'ntrip' if self.ntrip is not None else 'serial'}")
        if self.password_file is not None and self.password_env is not None:
            raise ValueError("password_file and password_env: give one of them")
        if self.gga_from is not None and self.gga_s == 0:
            raise ValueError("gga_from has no meaning with gga_s = 0")
        if self.position is not None and given & {"survey_s", "survey_accuracy_m"}:
            raise ValueError("position is given: there is no survey, so remove survey_s and survey_accuracy_m")
        if self.ca_file is not None and not self.mountpoint.tls:
            raise ValueError("ca_file has no meaning without TLS: write ntrips:// in ntrip")
        return self


def parse_ntrip(text: str) -> Mountpoint:
    """The stream of an address. Raises ValueError with what to write; never with a password."""
    if _PLAIN.fullmatch(text) is None:
        raise ValueError(f"must be an address without spaces, such as {EXAMPLE}")
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        raise ValueError(f"must be an address such as {EXAMPLE}; the port is 1 to 65535") from None
    if parts.password is not None:
        raise ValueError("no password in the address, which is shown and logged: set password_file or password_env")
    if parts.scheme not in ("ntrip", "ntrips"):
        raise ValueError(f"must begin with ntrip:// or ntrips:// (TLS), such as {EXAMPLE}")
    name = parts.path.removeprefix("/")
    if not parts.hostname or not name or "/" in name or parts.query or parts.fragment:
        raise ValueError(f"must name host and mountpoint, such as {EXAMPLE}")
    if port == 0:
        raise ValueError("the port must be 1 to 65535")
    tls = parts.scheme == "ntrips"
    user = unquote(parts.username or "")
    if ":" in user or not user.isprintable():
        raise ValueError("the user's name must have no colon and no control characters")
    return Mountpoint(parts.hostname, port or (NTRIPS_PORT if tls else NTRIP_PORT), name, tls, user)


def corrections_problems(config: CorrectionsConfig, fleet: FleetConfig) -> list[Problem]:
    """Everything wrong with the table beside the other tables."""
    problems = []
    if config.gga_from is not None and config.gga_from not in fleet.vehicles:
        names = ", ".join(sorted(fleet.vehicles)) or "none"
        text = f'"{config.gga_from}" is not a vehicle of this file; vehicles: {names}'
        problems.append(Problem(("corrections", "gga_from"), text))
    for name, link in fleet.links.items():
        if config.serial is not None and getattr(link, "device", None) == config.serial:
            text = f"{config.serial} is the device of the link {name}: one of them can have it"
            problems.append(Problem(("corrections", "serial"), text))
    return problems
