"""`skygcs-cli xbee`: read and set up XBee modules, the one at a port and others over its air, and find nodes.

A running daemon closes its link for the time a command needs the port.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from skygcs.cli.connection import Exit, run_offline
from skygcs.cli.options import Json
from skygcs.cli.render import print_json, print_lines, say
from skygcs.cli.serial_ports import lent
from skygcs.core.xbee.registers import (
    LIKELY_BAUD,
    MEANING,
    NETWORK,
    SHOWN,
    order_of_writing,
    parse_setting,
    problems,
    same_value,
    show_setting,
)
from skygcs.errors import LinkError, RefusedError
from skygcs.ext.xbee.port import XBeePort, baud_of

T = TypeVar("T")

xbees = typer.Typer(
    help="Show and set up XBee modules without XCTU; see docs/howto/xbee.md.",
    no_args_is_help=True,
)

Port = Annotated[str, typer.Argument(metavar="PORT", help="The module's serial port.", show_default=False)]
Node = Annotated[
    str | None,
    typer.Option("--node", metavar="ADDRESS", help="This node over the air (16 digits), not the module at the port."),
]
Baud = Annotated[
    str | None, typer.Option("--baud", metavar="RATE[,RATE…]", help="Rates to try. [default: 115200, 9600, …]")
]
Force = Annotated[bool, typer.Option("--force", help="Although vehicles are armed, or a node goes out of reach.")]


@xbees.command("show")
def show(port: Port, node: Node = None, baud: Baud = None, force: Force = False, json_output: Json = False) -> None:
    """Read a module's settings; nothing is changed.

    Example: skygcs-cli xbee show /dev/ttyUSB0
    """
    address, bauds = _address(node), _bauds(baud)

    def read(xbee: XBeePort) -> dict[str, bytes]:
        return {name: value for name in SHOWN if (value := xbee.get(name, address)) is not None}

    def command() -> None:
        values, found_at = _with_port(port, bauds, read, changes=False, force=force)
        wrong = [] if address is not None else problems(values)
        if json_output:
            shown = {name: show_setting(name, value) for name, value in values.items()}
            print_json({"port": port, "node": node, "found_at": found_at, "settings": shown, "problems": wrong})
            return
        print_lines([f"{node or port} ({found_at})"])
        width = max((len(show_setting(name, value)) for name, value in values.items()), default=0)
        print_lines(f"{name}  {show_setting(name, value):{width}}  {MEANING[name]}" for name, value in values.items())
        print_lines(wrong)

    run_offline(command)


@xbees.command("set")
def set_values(
    port: Port,
    pairs: Annotated[list[str], typer.Argument(metavar="NAME=VALUE …", help="AP=2 BD=115200 ID=0x1234 NI=alpha")],
    node: Node = None,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Write settings, read them back, and save; what was written before a failure is put back.

    Numbers are decimal or 0x…, BD is a rate, KY=@FILE reads the key's hexadecimal digits from a file.

    Example: skygcs-cli xbee set /dev/ttyUSB0 AP=2 BD=115200 ID=0x2A5 NI=ground
    """
    address, bauds, wanted = _address(node), _bauds(baud), _settings(pairs)

    def command() -> int:
        # settings that cut a node off need force
        cut_off = sorted(NETWORK & wanted.keys())
        if address is not None and cut_off and not force:
            raise RefusedError(
                f"{', '.join(cut_off)} must be the same in all modules: node {node} goes out of reach until the module "
                "at the port is set alike; set nodes first, the ground last (--force)"
            )
        # write them
        changed, _ = _with_port(port, bauds, lambda xbee: _write(xbee, wanted, address), changes=True, force=force)
        if json_output:
            print_json({"port": port, "node": node, "changed": changed})
        else:
            print_lines(changed or ["nothing had to be changed"])
        if "BD" in wanted and address is None:
            say("set the same baud for this link in the fleet file", err=True)
        return Exit.DONE

    run_offline(command)


@xbees.command("discover")
def discover(
    port: Port,
    wait_s: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.1, max=120, help="How long to wait for answers.")
    ] = 15.0,
    baud: Baud = None,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Find the nodes of the network: address and name of each that answers.

    Example: skygcs-cli xbee discover /dev/ttyUSB0
    """
    bauds = _bauds(baud)

    def command() -> int:
        nodes, _ = _with_port(port, bauds, lambda xbee: xbee.discover(wait_s), changes=False, force=force)
        if json_output:
            print_json([{"address": f"{address:016X}", "name": name} for address, name in nodes])
        elif nodes:
            print_lines(f"{address:016X}  {name}" for address, name in nodes)
        else:
            print_lines(["no node answers: is their ID (HP, CM, KY) the same as this module's?"])
        return Exit.DONE if nodes else Exit.FAILED

    run_offline(command)


def _with_port(
    port: str, bauds: tuple[int, ...], work: Callable[[XBeePort], T], *, changes: bool, force: bool
) -> tuple[T, str]:
    """Do the work at the open port, and say how the module was found."""

    def visit() -> tuple[T, str]:
        with XBeePort(port, bauds) as xbee:
            found_at = f"{xbee.baud} baud, {'API mode' if xbee.mode == 'API' else 'transparent'}"
            return work(xbee), found_at

    async def alone() -> tuple[T, str]:
        async with lent([port], changes=changes, force=force):
            return visit()

    return asyncio.run(alone())


def _write(xbee: XBeePort, wanted: dict[str, bytes], node: int | None) -> list[str]:
    """Write what differs and save it; one line for each change. Raises after putting back what was written."""

    before: dict[str, bytes] = {}
    lines: list[str] = []
    try:
        for name in order_of_writing(list(wanted)):
            value = wanted[name]
            if name == "KY":  # can be written, never read
                xbee.put(name, value, node)
                lines.append("KY  written")
                continue
            old = xbee.get(name, node)
            if old is None:
                raise RefusedError(f"{xbee.device}: this module has no setting {name}")
            if same_value(name, old, value):
                continue
            before[name] = old  # an answer that is lost leaves open whether it was written
            try:
                _put(xbee, name, value, node)
            except RefusedError:
                del before[name]
                raise
            lines.append(f"{name}  {show_setting(name, old)} -> {show_setting(name, value)}")
            held = xbee.get(name, node)
            if held is None or not same_value(name, held, value):
                raise LinkError(f"{xbee.device}: {name} was written but does not read back")
        if lines:
            xbee.put("WR", b"", node)
    except BaseException as error:
        left = _put_back(xbee, before, node)
        if "KY  written" in lines:
            left.append("KY, which cannot be read (without WR it is gone when the module restarts)")
        if isinstance(error, (LinkError, RefusedError)) and (before or left):
            end = f"not put back: {', '.join(left)}" if left else "what was written was put back"
            raise type(error)(f"{error}; nothing was saved, {end}") from None
        raise
    return lines


def _put(xbee: XBeePort, name: str, value: bytes, node: int | None) -> None:
    """Write one, and follow the module to the rate or mode that it has then."""
    xbee.put(name, value, node)
    if node is None and name in ("BD", "AP") and xbee.mode == "API":  # it counts at once
        xbee.reopen(baud_of(value) or xbee.baud if name == "BD" else xbee.baud)


def _put_back(xbee: XBeePort, before: dict[str, bytes], node: int | None) -> list[str]:
    """The names that could not be put back."""
    left = []
    for name in order_of_writing(list(before)):
        try:
            _put(xbee, name, before[name], node)
        except (LinkError, RefusedError):
            left.append(name)
    return left


def _settings(pairs: list[str]) -> dict[str, bytes]:
    wanted: dict[str, bytes] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        name = name.strip().upper()
        if not equals:
            raise typer.BadParameter(f"{pair!r} is not of the form NAME=VALUE")
        if name in wanted:
            raise typer.BadParameter(f"{name} is given twice")
        try:
            if name == "KY" and text.startswith("@"):
                text = Path(text[1:]).read_text(encoding="ascii")[:200].strip()
            wanted[name] = parse_setting(name, text)
        except (ValueError, OSError) as error:
            raise typer.BadParameter(str(error)) from None
    return wanted


def _address(node: str | None) -> int | None:
    if node is None:
        return None
    if len(node) != 16 or not all(c in "0123456789abcdefABCDEF" for c in node):
        raise typer.BadParameter(f"--node {node!r}: an address has 16 hexadecimal digits (SH and SL, on the label)")
    return int(node, 16)


def _bauds(text: str | None) -> tuple[int, ...]:
    if text is None:
        return LIKELY_BAUD
    rates = [int(part) if part.strip().isdecimal() else 0 for part in text.split(",")]
    if not all(1200 <= rate <= 1_000_000 for rate in rates):
        raise typer.BadParameter(f"--baud {text!r}: rates from 1200 to 1000000, separated by commas")
    return tuple(rates)


def add_to(app: typer.Typer) -> None:
    app.add_typer(xbees, name="xbee")
