"""The hub's inventory: a TOML file with its address, its certificate, and every station that may connect.

listen = "10.0.0.1:4222"

[tls]
cert = "hub.crt"
key = "hub.key"

[users.north]
role = "site"
nkey = "UC5BFF3O…"             # its public key, as `skygcs federation keys` prints it
orders = ["south"]             # sites whose vehicles it may give orders to, and take the leases of
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from skygcs.config.addresses import HostAndPort, host_and_port
from skygcs.config.files import read_named
from skygcs.config.tables import KeyPath, Model, key_lines, line_of
from skygcs.errors import ConfigError
from skygcs.ext.federation.config import ANY_SITE, SITE_PATTERN, ServerAddress, is_loopback
from skygcs.spelling import parse_toml

MAX_USERS = 1000
MAX_INVENTORY_BYTES = 4 << 20

PUBLIC_KEY_PATTERN = r"^U[A-Z2-7]{55}$"

UserName = Annotated[str, Field(pattern=SITE_PATTERN)]
"""Name of a site's user: the name of the site."""

OrderTarget = Annotated[str, Field(pattern=rf"{SITE_PATTERN}|^\*$")]

HubRole = Literal["site", "operator", "observer", "keeper"]
"""A keeper makes the hub's stores and does nothing else: its key stays on the hub's computer."""


class HubTls(Model):
    """[tls]: the hub's certificate."""

    cert: Path
    """With its chain, PEM; relative to the inventory."""
    key: Path
    ca: Path | None = None
    """Stations need a certificate signed by one of these; None: their key is enough."""


class HubUser(Model):
    """[users.NAME]: one station."""

    role: HubRole
    nkey: Annotated[str, Field(pattern=PUBLIC_KEY_PATTERN)] | None = None
    """The public key."""
    nkey_file: Path | None = None
    """Instead, for try-outs: the file with the station's seed on this very computer, made if it is not there."""
    orders: Annotated[tuple[OrderTarget, ...], Field(max_length=MAX_USERS)] = ()
    """Names of sites, or "*": those whose vehicles this station may give orders to; for role site also those whose
    vehicles' leases it may take."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.nkey is None) == (self.nkey_file is None):
            raise ValueError("needs nkey, the station's public key, or for a try-out nkey_file, its seed; and not both")
        if self.orders and self.role not in ("site", "operator"):
            raise ValueError(f'orders has no meaning for role "{self.role}"')
        return self


class HubInventory(Model):
    """A whole inventory."""

    listen: HostAndPort = "127.0.0.1:4222"
    """HOST:PORT; another address than loopback needs [tls]."""
    store: Path = Path("jetstream")
    """Folder of leases and logs that are being collected; relative to the inventory."""
    store_mb: Annotated[int, Field(ge=512, le=1_000_000)] = 1024
    """Its size, in 10⁶ bytes."""
    tls: HubTls | None = None
    users: Annotated[dict[UserName, HubUser], Field(min_length=1, max_length=MAX_USERS)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.tls is None and not is_loopback(self.host):
            raise ValueError(
                f"listen {self.listen}: an address beyond loopback needs [tls], or anyone on the way could give orders"
            )
        owner: dict[str, str] = {}
        for name, user in self.users.items():
            key = user.nkey or str(user.nkey_file)
            if key in owner:
                raise ValueError(f"users.{name}.nkey is that of {owner[key]}: each station has a key of its own")
            owner[key] = name
            for site in user.orders:
                if site != ANY_SITE and site not in self.sites:
                    known = ", ".join(self.sites) or "none"
                    raise ValueError(
                        f'users.{name}.orders names "{site}", which is not a user of role site here: {known}'
                    )
        return self

    @property
    def host(self) -> str:
        return host_and_port(self.listen)[0]

    @property
    def port(self) -> int:
        return host_and_port(self.listen)[1]

    @property
    def local_host(self) -> str:
        """Address at which the hub's own computer reaches it."""
        return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)

    @property
    def local_url(self) -> str:
        """URL for a client on the hub's own computer."""
        return ServerAddress(self.tls is not None, self.local_host, self.port).url

    @property
    def sites(self) -> list[str]:
        return [name for name, user in self.users.items() if user.role == "site"]

    def sites_ordered_by(self, name: str) -> list[str]:
        """The sites that this user may give orders to, itself left out."""
        orders = self.users[name].orders
        return [site for site in self.sites if site != name and (ANY_SITE in orders or site in orders)]


def load_inventory(path: Path) -> HubInventory:
    """The inventory, its relative paths resolved against its folder. Raises ConfigError with every problem."""
    try:
        raw = read_named(path)
        text = raw.decode("utf-8-sig") if len(raw) <= MAX_INVENTORY_BYTES else ""
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is not UTF-8 text (byte {error.start})"]) from None
    if len(raw) > MAX_INVENTORY_BYTES:
        raise ConfigError(str(path), [f"is longer than {MAX_INVENTORY_BYTES >> 20} MiB: not an inventory"])
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise ConfigError(str(path), [f"not TOML: {error}"]) from None
    if "federation" in table or "links" in table:
        raise ConfigError(
            str(path), ["is a station's fleet file; the hub's inventory has [users.NAME] (see the how-to)"]
        )
    return _absolute(inventory_of(table, str(path), text), path.parent.absolute())


def inventory_of(table: dict[str, Any], source: str, text: str = "") -> HubInventory:
    """The inventory in a table as TOML has it. Raises ConfigError."""
    try:
        return HubInventory.model_validate(table)
    except ValidationError as error:
        lines = key_lines(text)
        raise ConfigError(source, [_problem(one, lines) for one in error.errors(include_url=False)]) from None


def _problem(error: ErrorDetails, lines: dict[KeyPath, int]) -> str:
    path = tuple(part for part in error["loc"] if part != "[key]")
    message = error["msg"].removeprefix("Value error, ")
    named = re.match(r"[a-z_]+(?:\.[a-z0-9_-]+)*(?= )", message) if not path else None
    if named:  # a check of several keys names the one that it is about
        path, message = tuple(named.group().split(".")), message[named.end() :].strip()
    match error["type"]:
        case "extra_forbidden":
            message = "unknown key"
        case "missing":
            message = "is missing"
        case "string_pattern_mismatch" if path[-1:] == ("nkey",):
            message = (
                "is not a public key: 56 letters and digits that begin with U, as `skygcs federation keys` prints it"
            )
        case "string_pattern_mismatch":
            message = "must be a small letter and up to 15 small letters, digits or -"
    line = line_of(path, lines)
    return ".".join(map(str, path)) + (f" (line {line})" if line else "") + f": {message}"


def _absolute(inventory: HubInventory, folder: Path) -> HubInventory:
    def placed(path: Path) -> Path:
        return Path(os.path.normpath(folder / path.expanduser()))

    tls = inventory.tls
    if tls is not None:
        ca = None if tls.ca is None else placed(tls.ca)
        tls = tls.model_copy(update={"cert": placed(tls.cert), "key": placed(tls.key), "ca": ca})
    users = {
        name: user if user.nkey_file is None else user.model_copy(update={"nkey_file": placed(user.nkey_file)})
        for name, user in inventory.users.items()
    }
    return inventory.model_copy(update={"store": placed(inventory.store), "tls": tls, "users": users})
