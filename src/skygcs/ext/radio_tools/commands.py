"""`skygcs-cli radio`: read and set up SiK and RFD900x radios at serial ports, and remote radios through them.

A running daemon closes its link for the time a command needs the port. Modules that import pydantic or pyserial are
imported in functions.
"""

from __future__ import annotations

import asyncio
import os
import stat
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run_offline, waiting
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_pairs, parse_rates, within
from skygcs.cli.render import print_json, print_lines, say
from skygcs.cli.serial_ports import lent
from skygcs.config.files import write_named
from skygcs.errors import ConfigError, LinkError, RefusedError, SkygcsError
from skygcs.ext.radio_tools.change import Ledger, Visit, change, look
from skygcs.ext.radio_tools.measure_commands import measure
from skygcs.ext.radio_tools.network import NetworkPlan, NetworkSettings, check_network, plan_network
from skygcs.ext.radio_tools.port import RadioPort, emulate_pair, emulate_radio
from skygcs.ext.radio_tools.reading import LIKELY_BAUD
from skygcs.ext.radio_tools.settings import (
    ANTENNA_MEANINGS,
    ANTENNA_MODES,
    MAX_BYTES,
    SERIAL_BAUD,
    Difference,
    Firmware,
    RadioState,
    Register,
    differences,
    from_toml,
    inconsistencies,
    restorable,
    to_toml,
)

if TYPE_CHECKING:
    from skygcs.config.models import FleetConfig, SerialLinkConfig

radios = typer.Typer(
    help="Show and set up SiK and RFD900x radios without the vendor's tool; see docs/howto/radio.md.",
    no_args_is_help=True,
)

NODE_OWN = frozenset({"NODEID", "NODEDESTINATION", "NETCOUNT"})
"""Settings that differ between the radios of a network."""


_UNITS = {"AIR_SPEED": "kbit/s", "TXPOWER": "dBm", "MIN_FREQ": "kHz", "MAX_FREQ": "kHz", "DUTY_CYCLE": "%"}
_FRAMING = ("raw", "MAVLink", "low latency")
_SWITCH = ("off", "on")
_WORDS = {
    "MAVLINK": _FRAMING,
    "RXFRAME": _FRAMING,
    "RTSCTS": _SWITCH,
    "ECC": _SWITCH,
    "ANT_MODE": ANTENNA_MEANINGS,
}

Wanted = Callable[[RadioState], Mapping[str, int]]
"""The settings to write, for the radio that was found."""

PortName = Annotated[str, typer.Argument(metavar="PORT", help="The radio's serial port.", show_default=False)]
Baud = Annotated[
    str | None,
    typer.Option("--baud", metavar="RATE[,RATE…]", help="Rates to try. [default: the usual ones, 57600 first]"),
]
Remote = Annotated[
    int | None,
    typer.Option("--remote", metavar="NODE", min=0, help="This node, over the air, instead of the radio at the port."),
]
Force = Annotated[bool, typer.Option("--force", help="Although vehicles of the running daemon are armed.")]


@dataclass(frozen=True, slots=True)
class RadioAtPort:
    """A radio as the options name it: at a port, or behind it over the air."""

    port: str
    remote: int | None
    rates: tuple[int, ...]
    force: bool

    @property
    def name(self) -> str:
        return self.port if self.remote is None else f"{self.port} remote {self.remote}"


# --- reading ----------------------------------------------------------------------------------------------------------


@radios.command("show")
def show(
    port: PortName, remote: Remote = None, baud: Baud = None, force: Force = False, json_output: Json = False
) -> None:
    """Read a radio's firmware and settings; nothing is changed.

    Example: skygcs-cli radio show /dev/ttyUSB0
    """
    radio = RadioAtPort(port, remote, parse_rates(baud), force)

    def command() -> None:
        rate, state = asyncio.run(_look_lent(radio))
        if json_output:
            print_json(_state_json(radio.name, rate, state))
        else:
            print_lines(_state_lines(radio.name, rate, state))

    run_offline(command)


@radios.command("backup")
def backup(
    port: PortName,
    file: Annotated[Path | None, typer.Argument(metavar="FILE", help="Default: stdout.")] = None,
    remote: Remote = None,
    baud: Baud = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Overwrite FILE.")] = False,
    force: Force = False,
) -> None:
    """Write a radio's settings as TOML.

    Example: skygcs-cli radio backup /dev/ttyUSB0 ground.toml
    """
    radio = RadioAtPort(port, remote, parse_rates(baud), force)

    def command() -> None:
        if file is not None and file.exists() and not overwrite:
            raise RefusedError(f"{file} exists; --overwrite replaces it")
        _, state = asyncio.run(_look_lent(radio))
        text = to_toml(state, f"Read from {radio.name}.")
        if file is None:
            say(text, nl=False)
        else:
            write_named(file, text)
            say(f"{len(state.registers)} settings of {radio.name} -> {file}")

    run_offline(command)


@radios.command("diff")
def diff(
    sources: Annotated[list[str], typer.Argument(metavar="PORT|FILE …", help="Two or more: ports, or backups.")],
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Compare radios: each with the first, and all as one network. Exit 1 if anything differs or is wrong.

    Example: skygcs-cli radio diff ground.toml /dev/ttyUSB1
    """
    rates = parse_rates(baud)
    if len(sources) < 2:
        raise typer.BadParameter("give two or more: ports, or files of `radio backup`")
    run_offline(lambda: _diff(asyncio.run(_read_all(sources, rates, force)), json_output))


def _diff(radios: Mapping[str, RadioState], json_output: bool) -> int:
    (first, left), *others = radios.items()
    found = {name: differences(left.values, right.values) for name, right in others}
    # a radio and its own backup have the same unique id: they are no two nodes of a network
    ids = [state.unique_id for state in radios.values()]
    one_twice = any(id_ is not None and ids.count(id_) > 1 for id_ in ids)
    multipoint = all(state.node is not None for state in radios.values()) and not one_twice
    wrong = check_network(radios) if multipoint else []
    # print
    if json_output:
        pairs = {name: [{"name": d.name, first: d.left, name: d.right} for d in rows] for name, rows in found.items()}
        print_json({"first": first, "differences": pairs, "problems": wrong})
    else:
        for name, rows in found.items():
            equal = [f"{first} and {name} have the same settings"]
            print_lines(_difference_lines((first, name), rows) if rows else equal)
        print_lines(f"network: {text}" for text in wrong)
        if multipoint and not wrong:
            say("the radios fit together as one network")
    different = any(d.name not in NODE_OWN or not multipoint for rows in found.values() for d in rows)
    return Exit.FAILED if different or wrong else Exit.DONE


async def _look_lent(radio: RadioAtPort) -> tuple[int | None, RadioState]:
    async with lent([radio.port], changes=False, force=radio.force):
        return await _look(radio)


async def _look(radio: RadioAtPort) -> tuple[int | None, RadioState]:
    """The rate of the port and the state of the radio."""
    visit = Visit()
    with RadioPort(radio.port) as port:
        try:
            async with waiting(f"{radio.name}: reading"):
                state = await port.run(look(visit, radio.rates or LIKELY_BAUD, radio.remote), visit)
        except LinkError as error:
            raise LinkError(str(error) if str(error).startswith(radio.port) else f"{radio.port}: {error}") from None
    return visit.baud, state


async def _read_all(sources: Sequence[str], rates: tuple[int, ...], force: bool) -> dict[str, RadioState]:
    ports = [s for s in sources if _is_port(s)]
    radios = {}
    async with lent(ports, changes=False, force=force):
        for source in sources:
            if source in ports:
                _, radios[source] = await _look(RadioAtPort(source, None, rates, force))
            else:
                radios[source] = _backup_of(Path(source))
    if len(radios) < 2:
        raise RefusedError(f"{sources[0]} is one radio; give two different ones")
    return radios


def _is_port(source: str) -> bool:
    try:
        return stat.S_ISCHR(Path(source).stat().st_mode)
    except OSError:
        return source.startswith("/dev/")


def _backup_of(file: Path) -> RadioState:
    try:
        with file.open("rb") as source:
            text = source.read(MAX_BYTES + 1).decode("utf-8")
    except UnicodeDecodeError:
        raise ConfigError(str(file), ["not UTF-8 text; is it a backup of `skygcs-cli radio backup`?"]) from None
    return from_toml(text, str(file))


# --- changing ---------------------------------------------------------------------------------------------------------


@radios.command("set")
def set_values(
    port: PortName,
    pairs: Annotated[list[str], typer.Argument(metavar="NAME=VALUE …", help="NETID=7 AIR_SPEED=125 MAVLINK=1")],
    remote: Remote = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Write settings, read them back, save, restart, and read again; a failure before the save is undone.

    NODECOUNT=N sets the node table of an RFD900x multipoint master (AT&M0).

    Example: skygcs-cli radio set /dev/ttyUSB0 AIR_SPEED=125 MAVLINK=1
    """
    radio, values = RadioAtPort(port, remote, parse_rates(baud), force), _settings(pairs)
    run_offline(lambda: _change_one(radio, lambda _: values, json_output))


@radios.command("restore")
def restore(
    port: PortName,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file of `radio backup`.", show_default=False)],
    remote: Remote = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Write the settings of a backup to a radio, as `set` does. Both must have the same kind of firmware.

    Example: skygcs-cli radio restore /dev/ttyUSB0 ground.toml
    """
    radio = RadioAtPort(port, remote, parse_rates(baud), force)

    def command() -> int:
        saved = _backup_of(file)

        def wanted(state: RadioState) -> Mapping[str, int]:
            if state.firmware is not saved.firmware:
                raise RefusedError(
                    f"{file} is of {saved.firmware} ({saved.banner}), this radio has {state.firmware} "
                    f"({state.banner}): their settings differ; set single ones with: skygcs-cli radio set"
                )
            return restorable(saved)

        return _change_one(radio, wanted, json_output)

    run_offline(command)


def _change_one(radio: RadioAtPort, wanted: Wanted, json_output: bool) -> int:
    async def work() -> Ledger:
        async with lent([radio.port], changes=True, force=radio.force):
            return await _change(radio, wanted)

    ledger = asyncio.run(work())
    if json_output:
        print_json(_ledger_json(radio.name, ledger))
    else:
        _print_ledger(radio.name, ledger)
    if "SERIAL_SPEED" in ledger.written and radio.remote is None:
        say("set the same baud for this link in the fleet file, and for the autopilot's port", err=True)
    if "NODEID" in ledger.written:
        say(
            f"no other radio of this network may have node id {ledger.wanted['NODEID']}; to compare them: "
            "skygcs-cli radio diff PORT PORT …",
            err=True,
        )
    return Exit.DONE if ledger.ok else Exit.FAILED


async def _change(radio: RadioAtPort, wanted: Wanted) -> Ledger:
    """Change a radio; returns a ledger whatever happens, once the port is open. After Ctrl-C it first prints what was
    done."""
    visit = Visit()
    try:
        with RadioPort(radio.port) as port:
            async with waiting(f"{radio.name}: reading, writing, restarting"):
                return await port.run(change(visit, radio.rates or LIKELY_BAUD, radio.remote, wanted), visit)
    except SkygcsError as error:
        ledger = visit.ledger or Ledger()
        ledger.problem = str(error).removeprefix(f"{radio.port}: ")
        return ledger
    except BaseException:
        if visit.ledger is not None:
            visit.ledger.problem = "interrupted"
            for text in visit.ledger.sentences():
                fail(f"{radio.name}: {text}")
        raise


# --- a network --------------------------------------------------------------------------------------------------------

Ports = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="PORT …", help="Radios to set up now, for the nodes from --node on; without: print the plan."
    ),
]
Nodes = Annotated[
    int | None, typer.Option("--nodes", metavar="N", help="Number of radios, with the ground's and spare ones.")
]
FirstNode = Annotated[
    int,
    typer.Option("--node", metavar="K", min=1, help="Radio of the plan at the first port; 1 is the ground's."),
]
NetId = Annotated[int, typer.Option("--net-id", metavar="ID", min=0, max=65535, help="Network id.")]
AirSpeed = Annotated[int, typer.Option("--air-speed", metavar="KBPS", min=2, max=1000, help="Air data rate.")]
DutyCycle = Annotated[
    int, typer.Option("--duty-cycle", metavar="PERCENT", min=1, max=100, help="Share of time a radio may transmit.")
]
ToGroundOnly = Annotated[
    bool, typer.Option("--to-ground-only", help="Vehicles send to the master only, not to each other.")
]
_ANTENNA_WORDS = "both, 1, 2, tx1-rx2"
Antennas = Annotated[
    str | None,
    typer.Option("--antennas", metavar="MODE", help=f"Antennas of the vehicles' RFD900x (ANT_MODE): {_ANTENNA_WORDS}."),
]
GroundAntennas = Annotated[
    str | None,
    typer.Option("--ground-antennas", metavar="MODE", help=f"Antennas of the ground's RFD900x: {_ANTENNA_WORDS}."),
]
Extra = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A further setting of all radios.")
]


@radios.command("provision")
def provision(
    fleet: Annotated[
        Path, typer.Argument(metavar="FLEET.toml", help="The vehicles that get radios.", show_default=False)
    ],
    ports: Ports = None,
    nodes: Nodes = None,
    node: FirstNode = 1,
    net_id: NetId = 0,
    air_speed_kbps: AirSpeed = 64,
    duty_cycle: DutyCycle = 100,
    to_ground_only: ToGroundOnly = False,
    antennas: Antennas = None,
    ground_antennas: GroundAntennas = None,
    extra: Extra = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Set up a multipoint network: the ground's radio and one for each vehicle, ordered by system id.

    Serial speed and flow control come from the fleet file's radio link. Radios are set up at their ports, several in
    one call or one after the other (--node); every step is verified.

    Example: skygcs-cli radio provision fleet.toml --nodes 5 /dev/ttyUSB0
    """
    rates = parse_rates(baud)
    common = NetworkSettings(
        net_id=net_id,
        air_speed_kbps=air_speed_kbps,
        duty_cycle_percent=duty_cycle,
        to_ground_only=to_ground_only,
        antennas=_antenna_mode(antennas),
        ground_antennas=_antenna_mode(ground_antennas),
        extra=_settings(extra or []),
    )

    def command() -> int:
        plan, common_ = _network_plan(fleet, nodes, common)
        bauds = rates or tuple(dict.fromkeys((common_.serial_baud, *LIKELY_BAUD)))
        at_ports = [RadioAtPort(port, None, bauds, force) for port in ports or ()]
        if not at_ports:
            return _show_network(fleet, plan, json_output)
        return _provision(plan, at_ports, node, json_output)

    run_offline(command)


def _network_plan(fleet: Path, nodes: int | None, common: NetworkSettings) -> tuple[NetworkPlan, NetworkSettings]:
    """The plan for the vehicles of a fleet file, and the settings of all its radios. Raises SkygcsError."""
    from skygcs.config.loader import load_fleet

    config = load_fleet(fleet)
    vehicles = [name for name, _ in sorted(config.vehicles.items(), key=lambda item: item[1].sysid)]
    link = _radio_link(config)
    if link is not None:
        baud = link.baud if isinstance(link.baud, int) else link.baud[0]
        common = replace(common, serial_baud=baud, rtscts=link.rtscts)
    return plan_network(vehicles, nodes, common), common


def _show_network(fleet: Path, plan: NetworkPlan, json_output: bool) -> int:
    rows = _plan_rows(plan)
    if json_output:
        print_json({"nodes": plan.nodes, "plan": rows, "radios": []})
    else:
        print_lines(_plan_lines(rows))
        say(f"set them up: skygcs-cli radio provision {fleet} PORT … [--node K]; all powered at the same time")
    return Exit.DONE


def _provision(plan: NetworkPlan, radios: Sequence[RadioAtPort], first: int, json_output: bool) -> int:
    """Set up the radios for the nodes from ``first`` on. Raises RefusedError."""
    times = Counter(os.path.realpath(radio.port) for radio in radios)
    if twice := [port for port, count in times.items() if count > 1]:
        raise RefusedError(f"{', '.join(twice)} is given twice: each radio of the network is set up once, at its port")
    if first + len(radios) - 1 > plan.nodes:
        raise RefusedError(f"{len(radios)} ports from node {first} on are more than the plan's {plan.nodes} radios")
    rows = _plan_rows(plan)
    if not json_output:
        print_lines(_plan_lines(rows))
    done = asyncio.run(_set_up(plan, radios, first - 1, quiet=json_output))
    good = sum(ledger.ok for ledger in done.values())
    if json_output:
        reports = [_ledger_json(port, ledger) for port, ledger in done.items()]
        print_json({"nodes": plan.nodes, "plan": rows, "radios": reports})
    else:
        last = first + len(radios) - 1
        left = [str(i) for i in range(1, plan.nodes + 1) if not first <= i <= last]
        further = f"; still to do: radio {', '.join(left)}" if left else ""
        say(f"{good} of {len(radios)} radios are set up{further}")
    return Exit.DONE if good == len(radios) else Exit.FAILED


async def _set_up(plan: NetworkPlan, radios: Sequence[RadioAtPort], position: int, *, quiet: bool) -> dict[str, Ledger]:
    """One radio after the other; a failure of one does not stop the others."""
    done: dict[str, Ledger] = {}
    async with lent([radio.port for radio in radios], changes=True, force=radios[0].force):
        for i, radio in enumerate(radios, position):
            if not quiet:
                say(f"{radio.port}: radio {i + 1} of {plan.nodes}, {plan.name(i)} …")

            def wanted(state: RadioState, i: int = i) -> Mapping[str, int]:
                return plan.settings(i, state.firmware)

            ledger = await _change(radio, wanted)
            done[radio.port] = ledger
            if not quiet:
                _print_ledger(radio.port, ledger)
    return done


def _radio_link(config: FleetConfig) -> SerialLinkConfig | None:
    """The serial link with the role "radio", else the first serial link."""
    from skygcs.config.models import SerialLinkConfig

    serial: list[Any] = [link for link in config.links.values() if isinstance(link, SerialLinkConfig)]
    return next((link for link in serial if link.role == "radio"), serial[0] if serial else None)


# --- rehearsal --------------------------------------------------------------------------------------------------------


@radios.command("emulate")
def emulate(
    link: Annotated[
        Path, typer.Argument(metavar="PATH", help="Name of the port to create, a symlink.", show_default=False)
    ],
    kind: Annotated[
        str, typer.Option("--kind", help="sik, rfd900x, rfd900x-multipoint or sik-multipoint.")
    ] = "rfd900x-multipoint",
    node: Annotated[int | None, typer.Option("--node", min=0, help="Its node id.")] = None,
    remotes: Annotated[
        str, typer.Option("--remotes", metavar="NODES", help="Node ids in its range, with commas.")
    ] = "",
    second: Annotated[
        Path | None, typer.Option("--pair", metavar="PATH_B", help="A second radio, to rehearse `radio measure`.")
    ] = None,
    air_kbps: Annotated[
        float, typer.Option("--air-speed", metavar="KBPS", parser=finite, help="With --pair: between both.")
    ] = 64.0,
    loss: Annotated[
        float, typer.Option("--loss", metavar="SHARE", parser=finite, help="With --pair: of the packets.")
    ] = 0.0,
) -> None:
    """Emulate a radio on a pty until Ctrl-C, to rehearse. It answers AT commands; only a pair carries data.

    Example: skygcs-cli radio emulate /tmp/radio --node 1 --remotes 2,3
    """

    def command() -> int:
        if second is not None:
            within("--air-speed", air_kbps, 2, 750)
            within("--loss", loss, 0, 0.9)
            return emulate_pair((link, second), air_kbps, loss)
        return emulate_radio(link, kind, node, remotes)

    run_offline(command)


def _settings(pairs: list[str]) -> dict[str, int]:
    settings: dict[str, int] = {}
    for name, value in parse_pairs(pairs).items():
        if name.upper() == "ANT_MODE" and isinstance(value, str):
            value = _antenna_mode(value)
        if type(value) is not int or not 0 <= value < 2**32:
            raise typer.BadParameter(f"{name}: a radio's settings are whole numbers, not {value!r}")
        settings[name.upper()] = value
    return settings


def _antenna_mode(word: str | None) -> int | None:
    """ANT_MODE of a word; None of None. Raises BadParameter."""
    if word is None:
        return None
    mode = ANTENNA_MODES.get(word.strip().lower())
    if mode is None:
        raise typer.BadParameter(f"antennas are {_ANTENNA_WORDS}, not {word!r}")
    return mode


# --- text and JSON ----------------------------------------------------------------------------------------------------


def _state_lines(where: str, baud: int | None, state: RadioState) -> Iterator[str]:
    """Firmware and settings of one radio, and notes about settings that do not fit together."""
    yield f"{where}: {state.banner} ({state.firmware})" + (f", answers at {baud} baud" if baud else "")
    about = [("board", state.board), ("band", state.band), ("id", state.unique_id)]
    if line := ", ".join(f"{key} {value}" for key, value in about if value):
        yield f"  {line}"
    for register in state.registers.values():
        yield f"  {register.id:<4} {register.name:<18} {_meaning(register.name, register.value)}"
    for text in inconsistencies(state.values, state.firmware):
        yield f"  note: {text}"


def _meaning(name: str, value: int) -> str:
    """A value and what it stands for."""
    if name == "SERIAL_SPEED" and value in SERIAL_BAUD:
        return f"{value} ({SERIAL_BAUD[value]} baud)"
    if name == "NODEDESTINATION" and value in (255, 65535):
        return f"{value} (all nodes)"
    words = _WORDS.get(name, ())
    if value < len(words):
        return f"{value} ({words[value]})"
    return f"{value} {_UNITS[name]}" if name in _UNITS and value else str(value)


def _state_json(where: str, baud: int | None, state: RadioState) -> dict[str, Any]:
    return {
        "radio": where,
        "baud": baud,
        "banner": state.banner,
        "firmware": state.firmware,
        "board": state.board,
        "band": state.band,
        "unique_id": state.unique_id,
        "node": state.node,
        "registers": [_register_json(r) for r in state.registers.values()],
        "notes": inconsistencies(state.values, state.firmware),
    }


def _register_json(register: Register) -> dict[str, Any]:
    """One setting; with ``meaning`` where its value is one of words."""
    entry: dict[str, Any] = {"id": register.id, "name": register.name, "value": register.value}
    words = _WORDS.get(register.name, ())
    return entry | ({"meaning": words[register.value]} if 0 <= register.value < len(words) else {})


def _print_ledger(where: str, ledger: Ledger) -> None:
    """Print the result of a change; a failure goes to stderr."""
    prefix = "" if ledger.ok else "requested: "
    for name, value in ledger.wanted.items():
        say(f"{where}: {prefix}{name} {ledger.before.get(name)} -> {value}")
    if ledger.node_table is not None:
        say(f"{where}: {prefix}{ledger.node_table} (the master's node table; it cannot be read back)")
    for i, text in enumerate(ledger.sentences()):
        say(f"{where}: {'' if ledger.ok else 'FAIL ' if i == 0 else '     '}{text}", err=not ledger.ok)


def _ledger_json(where: str, ledger: Ledger) -> dict[str, Any]:
    return {
        "radio": where,
        "ok": ledger.ok,
        "problem": ledger.problem,
        "before": {name: ledger.before[name] for name in ledger.wanted},
        "wanted": ledger.wanted,
        "written": ledger.written,
        "perhaps_written": ledger.unsure,
        "node_table": ledger.node_table,
        "node_table_written": ledger.table_written,
        "saved": ledger.saved,
        "restarted": ledger.restarted,
        "verified": ledger.verified,
        "undone": ledger.undone,
        "differs": ledger.differs,
        "messages": ledger.sentences(),
    }


def _plan_rows(plan: NetworkPlan) -> list[dict[str, Any]]:
    """Node id, name and settings of every radio of a plan."""
    rows = []
    for i in range(plan.nodes):
        settings = plan.settings(i, Firmware.RFD_MULTIPOINT)
        rows.append({"node": settings["NODEID"], "for": plan.name(i), "settings": settings})
    return rows


def _plan_lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The settings that all radios share, then those of each."""
    alike = {n: v for n, v in rows[0]["settings"].items() if all(row["settings"].get(n) == v for row in rows)}
    yield "all nodes: " + ", ".join(f"{name} {_meaning(name, value)}" for name, value in alike.items())
    for row in rows:
        own = ", ".join(f"{n} {_meaning(n, v)}" for n, v in row["settings"].items() if n not in alike)
        yield f"  node {row['node']:<3} {row['for']:<14} {own}"


def _difference_lines(names: Sequence[str], found: Sequence[Difference]) -> Iterator[str]:
    width = max(14, *(len(name) for name in names))
    yield f"{'':<18} " + " ".join(f"{name:>{width}}" for name in names)
    for d in found:
        cells = ("-" if value is None else str(value) for value in (d.left, d.right))
        yield f"{d.name:<18} " + " ".join(f"{cell:>{width}}" for cell in cells)


radios.command("measure")(measure)


def add_to(app: typer.Typer) -> None:
    app.add_typer(radios, name="radio")
