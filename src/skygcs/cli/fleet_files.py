"""`skygcs check` and `skygcs import-router`: check a fleet file, and convert a mavlink-router configuration into one.

Both open no link and start nothing.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from skygcs.cli.render import table
from skygcs.config.checks import endpoint_text, link_warnings, open_servers
from skygcs.config.dialects import load_dialect
from skygcs.config.extension_tables import TableOwner, find_owners
from skygcs.config.files import read_named, write_named
from skygcs.config.loader import load_fleet
from skygcs.config.models import (
    FleetConfig,
    LinkConfig,
    MemoryLinkConfig,
    ReplayLinkConfig,
    SerialLinkConfig,
    SimulatedLinkConfig,
    TcpServerLinkConfig,
    UdpServerLinkConfig,
    XBeeLinkConfig,
)
from skygcs.config.router_import import import_router
from skygcs.config.signing import read_key
from skygcs.core.geo import EAST_DEG
from skygcs.errors import ConfigError, KeyFileError
from skygcs.terminal_text import visible

PIPE_COLUMNS = 160
"""Width where there is no terminal: a table has room for a path."""


def check(file: Path) -> int:
    """Print what the file defines and return 0, or print all problems on stderr and return 1."""
    try:
        config = load_fleet(file)
    except ConfigError as error:
        print(visible(str(error), lines=True), file=sys.stderr)
        return 1
    _show(Path(file), config)
    return 0


def _show(file: Path, config: FleetConfig) -> None:
    from rich import markup
    from rich.console import Console

    def escape(text: str) -> str:
        return markup.escape(visible(text))

    screen = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else PIPE_COLUMNS)
    # the daemon itself
    own = config.daemon
    dialect = load_dialect(list(config.dialect))
    screen.print(f"[bold]{escape(str(file))}[/bold]: no problem found")
    screen.print(f"own ids  {own.sysid}/{own.compid}")
    screen.print(f"dialect  {escape(dialect.name)}, {len(dialect.messages)} messages")
    screen.print(f"tlogs    {escape(str(own.log_dir)) if own.record else 'not recorded'}")
    if config.origin is not None:
        origin = config.origin
        axes = "" if origin.x_heading_deg == EAST_DEG else f", x to {origin.x_heading_deg:g}°"
        screen.print(f"origin   {origin.lat_deg}, {origin.lon_deg}, {origin.alt_amsl_m} m above sea level{axes}")
    owners = find_owners(set(config.extensions))[0]
    for name, owner in owners.items():
        if summary := owner.summary(config.extensions[name]):
            screen.print(escape(f"{name:8} {summary}"))
    # links
    rows = []
    for name, link in config.links.items():
        role = f"{link.role}: {endpoint_text(link)}" if link.vehicles else link.role
        rows.append((name, link.type, _where(link), role if link.enabled else f"{role}, not enabled"))
    if rows:
        screen.print()
        screen.print(table(("link", "type", "where", "role"), rows, wrap=("where",)))
    else:
        screen.print("links    none; they can be added while the daemon runs")
    # vehicles
    vehicles = [(v.name, str(v.sysid), v.autopilot or "any", ", ".join(v.groups)) for v in config.vehicle_configs()]
    if vehicles:
        screen.print()
        screen.print(table(("vehicle", "system id", "autopilot", "groups"), vehicles))
    else:
        screen.print("vehicles none named; a vehicle that is heard gets its system id as its name")
    if rows or vehicles:
        screen.print()
    for note in _notes(config, owners):
        screen.print(f"note: {escape(note)}")


def _where(link: LinkConfig) -> str:
    match link:
        case SerialLinkConfig():
            rates = (link.baud,) if isinstance(link.baud, int) else link.baud
            return f"{link.device} at {' or '.join(map(str, rates))} baud"
        case XBeeLinkConfig():
            return f"{link.device} at {link.baud} baud, API mode {link.api_mode}"
        case UdpServerLinkConfig() | TcpServerLinkConfig():
            return f"listens on {link.host}:{link.port}"
        case ReplayLinkConfig():
            return str(link.file)
        case SimulatedLinkConfig():
            return f"{_simulated(link)} from system id {link.first_sysid}"
        case MemoryLinkConfig():
            return "in memory"
    return f"{link.host}:{link.port}"


def _notes(config: FleetConfig, owners: Mapping[str, type[TableOwner]]) -> list[str]:
    """Problems that may be solved before the daemon runs: a device that is not plugged in, a file or a package
    that is missing."""
    notes = []
    for name, link in config.links.items():
        if isinstance(link, SerialLinkConfig | XBeeLinkConfig) and not Path(link.device).exists():
            notes.append(f"links.{name}: {link.device} does not exist now; it is opened when it appears")
        if isinstance(link, ReplayLinkConfig) and not link.file.is_file():
            notes.append(f"links.{name}: the file {link.file} does not exist now")
        if link.signing is not None and link.enabled:
            try:
                read_key(link.signing.key_file)
            except KeyFileError as error:
                notes.append(f"links.{name}.signing: {error}; skygcs does not start with this error")
    notes += [f"links.{name}: {text}" for name, text in link_warnings(config).items()]
    notes += [f"links.{name}: {text}" for name, text in open_servers(config).items()]
    token = config.daemon.token_file
    if token is not None and not token.is_file():
        notes.append(f"daemon.token_file: the file {token} does not exist now")
    for name, owner in owners.items():
        notes += [f"{name}: {text}" for text in owner.notes(config.extensions[name])]
        notes += [f"{name}: {text}" for text in owner.fleet_notes(config.extensions[name], config)]
    return notes


# --- import from mavlink-router ---------------------------------------------------------------------------------------


def import_router_file(file: Path, output: Path | None, *, force: bool) -> int:
    """Write the fleet file to ``output`` or stdout, notes to stderr.

    Raises ConfigError if the file is not a mavlink-router configuration, if ``output`` exists, or if the links cannot
    be in one fleet file.
    """
    try:
        text = read_named(file).decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(str(file), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(file), [f"is not UTF-8 text (byte {error.start})"]) from None
    imported = import_router(text, str(file))
    _check(imported.text, file)
    if output is None:
        sys.stdout.write(imported.text)
    else:
        try:
            write_named(output, imported.text, force=force)
        except FileExistsError:
            raise ConfigError(str(output), ["exists; --force overwrites it"]) from None
        except OSError as error:
            raise ConfigError(str(output), [f"cannot be written: {error.strerror}"]) from None
    for note in imported.notes:
        print(f"note: {note}", file=sys.stderr)
    return 0


def _check(text: str, file: Path) -> None:
    """Raises ConfigError unless the result is a valid fleet file; two endpoints on one port, for example, are not."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.toml"
        path.write_text(text, encoding="utf-8")
        try:
            load_fleet(path)
        except ConfigError as error:
            reason = "its links cannot be in one fleet file (the line numbers are those of that fleet file):"
            raise ConfigError(str(file), [reason, *error.problems]) from None


# --- examples ---------------------------------------------------------------------------------------------------------


def write_example(scenario: str | None, folder: Path, *, force: bool) -> int:
    """Write an example as fleet.toml into ``folder`` and print what to do next; None: list the scenarios. Raises
    ConfigError."""
    from skygcs.config.examples import HUB, example_text, scenarios, station_texts

    if scenario is None:
        width = max(map(len, scenarios()))
        print("skygcs init SCENARIO [DIR] writes a fleet file for:\n")
        for name, purpose in scenarios().items():
            print(f"  {name:{width}}  {purpose}")
        return 0
    if (texts := station_texts(scenario)) is not None:
        for name, text in texts.items():
            _write_new(folder / name, text, force=force)
        print(f"{', '.join(texts)} are written to {folder}. Then, there, each in a terminal of its own:\n")
        print("  skygcs federation up          # the hub, and a key for each station")
        print("\n".join(f"  skygcs run {name}" for name in texts if name != HUB))
        return 0
    path = folder / "fleet.toml"
    text = example_text(scenario, path.name)
    _write_new(path, text, force=force)
    print(f"{path} is written. Change it to what you have, then:\n")
    print(f"  skygcs check {path}\n  skygcs run {path}\n  skygcs-cli status        # in another terminal")
    return 0


def _write_new(path: Path, text: str, *, force: bool) -> None:
    """Raises ConfigError, also for a file that is there unless ``force``."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_named(path, text, force=force)
    except FileExistsError:
        raise ConfigError(str(path), ["exists already; --force overwrites it"]) from None
    except OSError as error:
        raise ConfigError(str(path), [error.strerror or str(error)]) from None


def _simulated(link: SimulatedLinkConfig) -> str:
    """Numbers of simulated vehicles by kind; both copters, if there is one, and the others that there are."""
    names = {"px4": "PX4", "ardupilot": "ArduPilot", "px4_plane": "PX4 plane"}
    names |= {"ardupilot_plane": "ArduPlane", "rover": "rover"}
    copters = link.px4 or link.ardupilot
    kinds = {k: n for k, n in link.counts.items() if n or (copters and k in ("px4", "ardupilot"))}
    if not kinds:
        return "no vehicles"
    *parts, last = (f"{count} {names[kind]}" for kind, count in kinds.items())
    return f"{', '.join(parts)} and {last}" if parts else last
