"""`skygcs-cli radio`: reads and sets up SiK and RFD900x radios at serial ports, and remote ones through them.

Options and their check are here; the work is in radio_work, imported when it is asked for.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skygcs.cli.connection import run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import parse_pairs

radios = typer.Typer(
    help="Look at and set up SiK and RFD900x radios, without the vendor's tool; see docs/howto/radio-setup.md.",
    no_args_is_help=True,
)

Port = Annotated[str, typer.Argument(metavar="PORT", help="The radio's serial port.", show_default=False)]
Baud = Annotated[
    str | None,
    typer.Option("--baud", metavar="RATE[,RATE…]", help="Rates to try. [default: the usual ones, 57600 first]"),
]
Remote = Annotated[
    int | None,
    typer.Option("--remote", metavar="NODE", min=0, help="Not the radio at the port: this node, over the air."),
]
Force = Annotated[bool, typer.Option("--force", help="Although vehicles of the running daemon are armed.")]


@radios.command("show")
def show(port: Port, remote: Remote = None, baud: Baud = None, force: Force = False, json_output: Json = False) -> None:
    """Read a radio's firmware and settings; nothing is changed."""
    rates = _rates(baud)

    def command() -> int:
        from skygcs.cli import radio_work

        return radio_work.show_radio(port, remote, rates, force, json_output)

    run_offline(command)


@radios.command("set")
def set_values(
    port: Port,
    pairs: Annotated[list[str], typer.Argument(metavar="NAME=VALUE …", help="NETID=7 AIR_SPEED=125 MAVLINK=1")],
    remote: Remote = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Write settings, read them back, save, restart, and read again; what fails before the save is undone.

    NODECOUNT=N sets the node table of an RFD900x multipoint master (AT&M0).
    """
    rates, values = _rates(baud), _settings(pairs)

    def command() -> int:
        from skygcs.cli import radio_work

        return radio_work.set_radio(port, remote, rates, values, force, json_output)

    run_offline(command)


@radios.command("provision")
def provision(
    fleet: Annotated[Path, typer.Argument(metavar="FLEET.toml", help="Whose vehicles get radios.", show_default=False)],
    ports: Annotated[
        list[str] | None,
        typer.Argument(metavar="[PORT …]", help="Radios to set up now, for nodes from --node on; none: show the plan."),
    ] = None,
    nodes: Annotated[
        int | None, typer.Option("--nodes", metavar="N", help="Radios in all, with the ground's and spare ones.")
    ] = None,
    node: Annotated[
        int,
        typer.Option("--node", metavar="K", min=1, help="Which radio of the plan the first port is; 1: the ground's."),
    ] = 1,
    net_id: Annotated[int, typer.Option("--net-id", metavar="ID", min=0, max=65535)] = 0,
    air_speed_kbps: Annotated[int, typer.Option("--air-speed", metavar="KBPS", min=2, max=1000)] = 64,
    duty_cycle: Annotated[int, typer.Option("--duty-cycle", metavar="PERCENT", min=1, max=100)] = 100,
    to_ground_only: Annotated[
        bool, typer.Option("--to-ground-only", help="Vehicles send to the master alone, not to each other.")
    ] = False,
    extra: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A further setting of all radios.")
    ] = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Make a multipoint network: the ground's radio and one for each vehicle, by system id.

    Serial speed and flow control are those of the fleet file's radio link. Radios are set up at their ports, several
    at once or one after the other (--node); every step is verified.
    """
    rates = _rates(baud)
    further = _settings(extra or [])

    def command() -> int:
        from skygcs.cli import radio_work
        from skygcs.modem.network import NetworkSettings

        common = NetworkSettings(
            net_id=net_id,
            air_speed_kbps=air_speed_kbps,
            duty_cycle_percent=duty_cycle,
            to_ground_only=to_ground_only,
            extra=further,
        )
        return radio_work.provision(fleet, ports or [], nodes, node, common, rates, force, json_output)

    run_offline(command)


@radios.command("diff")
def diff(
    sources: Annotated[list[str], typer.Argument(metavar="PORT|FILE …", help="Two or more: ports, or backups.")],
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Compare radios: each with the first, and all of them as one network. Exit 1 if anything differs or is wrong."""
    rates = _rates(baud)
    if len(sources) < 2:
        raise typer.BadParameter("two or more are needed: ports, or files of `radio backup`")

    def command() -> int:
        from skygcs.cli import radio_work

        return radio_work.diff(sources, rates, force, json_output)

    run_offline(command)


@radios.command("backup")
def backup(
    port: Port,
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Default: stdout.")] = None,
    remote: Remote = None,
    baud: Baud = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace FILE if it exists.")] = False,
    force: Force = False,
) -> None:
    """Write a radio's settings as TOML."""
    rates = _rates(baud)

    def command() -> int:
        from skygcs.cli import radio_work

        return radio_work.backup(port, file, remote, rates, force, overwrite)

    run_offline(command)


@radios.command("restore")
def restore(
    port: Port,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Of `radio backup`.", show_default=False)],
    remote: Remote = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Give a radio the settings of a backup, as `set` does. Both must have the same kind of firmware."""
    rates = _rates(baud)

    def command() -> int:
        from skygcs.cli import radio_work

        return radio_work.restore(port, file, remote, rates, force, json_output)

    run_offline(command)


@radios.command("emulate")
def emulate(
    link: Annotated[
        Path, typer.Argument(metavar="PATH", help="The port's name to make, a symlink.", show_default=False)
    ],
    kind: Annotated[
        str, typer.Option("--kind", help="sik, rfd900x, rfd900x-multipoint or sik-multipoint.")
    ] = "rfd900x-multipoint",
    node: Annotated[int | None, typer.Option("--node", min=0, help="Its node id.")] = None,
    remotes: Annotated[
        str, typer.Option("--remotes", metavar="NODES", help="Node ids in its range, with commas.")
    ] = "",
) -> None:
    """Rehearse without a radio: an emulated one on a pty, until Ctrl-C. It answers AT commands; it carries no data."""

    def command() -> int:
        from skygcs.cli.radio_emulated import emulate_radio

        return emulate_radio(link, kind, node, remotes)

    run_offline(command)


def _rates(text: str | None) -> tuple[int, ...]:
    """Empty: not given."""
    rates = []
    for part in text.split(",") if text else ():
        if not part.strip().isdecimal() or not 300 <= int(part) <= 4_000_000:
            raise typer.BadParameter(f"--baud: {part!r} is no rate between 300 and 4000000")
        rates.append(int(part))
    return tuple(rates)


def _settings(pairs: list[str]) -> dict[str, int]:
    settings: dict[str, int] = {}
    for name, value in parse_pairs(pairs).items():
        if type(value) is not int or not 0 <= value < 2**32:
            raise typer.BadParameter(f"{name}: a radio's settings are whole numbers, not {value!r}")
        settings[name.upper()] = value
    return settings
