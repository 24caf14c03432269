"""`skygcs check FILE`: is this fleet file right? Opens no link and starts nothing."""

from __future__ import annotations

import sys
from pathlib import Path

from skygcs.config.checks import link_warnings, open_servers
from skygcs.config.dialects import load_dialect
from skygcs.config.endpoints import endpoint_text
from skygcs.config.loader import load_fleet
from skygcs.config.models import (
    FleetConfig,
    LinkConfig,
    MemoryLink,
    ReplayLink,
    SerialLink,
    SimulatedLink,
    TcpServerLink,
    UdpServerLink,
)
from skygcs.config.signing import read_key
from skygcs.core.geo import EAST_DEG
from skygcs.errors import ConfigError, KeyFileError

PIPE_COLUMNS = 160
"""Width where there is no terminal: room for a path in a table."""


def check(file: Path) -> int:
    """Print what the file says, 0; or every problem on stderr, 1. Never raises for what the file holds."""
    try:
        config = load_fleet(file)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 1
    _show(Path(file), config)
    return 0


def _show(file: Path, config: FleetConfig) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else PIPE_COLUMNS)
    own = config.daemon
    dialect = load_dialect(list(config.dialect))
    console.print(f"[bold]{escape(str(file))}[/bold]: no problem found")
    console.print(f"own ids  {own.sysid}/{own.compid}")
    console.print(f"dialect  {escape(dialect.name)}, {len(dialect.messages)} messages")
    console.print(f"tlogs    {escape(str(own.log_dir)) if own.record else 'not recorded'}")
    if config.origin is not None:
        origin = config.origin
        axes = "" if origin.x_heading_deg == EAST_DEG else f", x to {origin.x_heading_deg:g}°"
        console.print(f"origin   {origin.lat_deg}, {origin.lon_deg}, {origin.alt_amsl_m} m above sea level{axes}")
    if config.links:
        table = Table("link", "type", box=box.SIMPLE_HEAD)
        table.add_column("where", overflow="fold")
        table.add_column("role")
        for name, link in config.links.items():
            role = f"{link.role}: {endpoint_text(link)}" if link.vehicles else link.role
            role = role if link.enabled else f"{role}, not enabled"
            table.add_row(escape(name), link.type, escape(_where(link)), escape(role))
        console.print(table)
    else:
        console.print("links    none; they can be added while it runs")
    vehicles = config.vehicle_configs()
    if vehicles:
        table = Table("vehicle", "system id", "autopilot", "groups", box=box.SIMPLE_HEAD)
        for v in vehicles:
            table.add_row(escape(v.name), str(v.sysid), v.autopilot or "any", escape(", ".join(v.groups)))
        console.print(table)
    else:
        console.print("vehicles none named; every one that is heard gets its system id as its name")
    for note in _notes(config):
        console.print(f"note: {escape(note)}")


def _where(link: LinkConfig) -> str:
    match link:
        case SerialLink():
            rates = (link.baud,) if isinstance(link.baud, int) else link.baud
            return f"{link.device} at {' or '.join(map(str, rates))} baud"
        case UdpServerLink() | TcpServerLink():
            return f"listens on {link.host}:{link.port}"
        case ReplayLink():
            return str(link.file)
        case SimulatedLink():
            return f"{link.px4} PX4 and {link.ardupilot} ArduPilot from system id {link.first_sysid}"
        case MemoryLink():
            return "in memory"
    return f"{link.host}:{link.port}"


def _notes(config: FleetConfig) -> list[str]:
    """What is not there now and may be there when it runs: a device is plugged in later, a file is copied later."""
    notes = []
    for name, link in config.links.items():
        if isinstance(link, SerialLink) and not Path(link.device).exists():
            notes.append(f"links.{name}: there is no {link.device} now; it is opened when it appears")
        if isinstance(link, ReplayLink) and not link.file.is_file():
            notes.append(f"links.{name}: there is no file {link.file} now")
        if link.signing is not None and link.enabled:
            try:
                read_key(link.signing.key_file)
            except KeyFileError as error:
                notes.append(f"links.{name}.signing: {error}; skygcs will not start so")
    notes += [f"links.{name}: {text}" for name, text in link_warnings(config).items()]
    notes += [f"links.{name}: {text}" for name, text in open_servers(config).items()]
    token = config.daemon.token_file
    if token is not None and not token.is_file():
        notes.append(f"daemon.token_file: there is no file {token} now")
    return notes
