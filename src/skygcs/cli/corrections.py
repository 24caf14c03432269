"""`skygcs-cli corrections`: RTK corrections of a base for all vehicles, and what became of them."""

from __future__ import annotations

import json
import os
import stat
import sys
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.connection import Exit, fail, run
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite
from skygcs.rpc.client import Client

if TYPE_CHECKING:  # every command line registers every command: what only one needs is imported when it runs
    from skygcs.cli.correction_stream import Tally

corrections = typer.Typer(help="RTK corrections for all vehicles: send them, see what became of them.")

FILE_BYTES_PER_S = 1000.0
"""A recorded file without --rate: what a base of four constellations sends."""

TERMINAL_EVERY_S = 1.0
ELSEWHERE_EVERY_S = 60.0
"""Between two lines of a log that may become days long."""


@corrections.command("send")
def send(
    file: Annotated[str, typer.Argument(metavar="FILE", help="RTCM 3; -: standard input.")] = "-",
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="B/S", parser=finite, help="No faster. A recorded file: 1000.", show_default=False
        ),
    ] = None,
    every_s: Annotated[
        float | None,
        typer.Option(
            "--every",
            metavar="S",
            parser=finite,
            help="Tell what went so often: 1, or 60 if not on a terminal.",
            show_default=False,
        ),
    ] = None,
    json_output: Json = False,
) -> None:
    """Send corrections to all vehicles until they end: `str2str -in ntrip://… | skygcs-cli corrections send`."""
    _within("--rate", rate, 10, 1e6)
    _within("--every", every_s, 0.1, 3600)
    descriptor = sys.stdin.fileno() if file == "-" else _opened(file)
    if os.isatty(descriptor):
        raise typer.BadParameter(
            "there is a terminal, not RTCM: give a FILE, or the output of a program that fetches corrections: "
            "str2str -in ntrip://USER:PASSWORD@CASTER/MOUNTPOINT | skygcs-cli corrections send"
        )
    if rate is None and stat.S_ISREG(os.fstat(descriptor).st_mode):
        rate = FILE_BYTES_PER_S

    async def command(gcs: Client) -> int:
        from skygcs.cli.correction_stream import Stream, at_rate, forward, line_of
        from skygcs.cli.setpoint_stream import bytes_of

        live = sys.stdout.isatty() and not json_output
        stream = Stream(gcs, lambda text: _interrupting(live, text))

        def show(tally: Tally, bytes_per_s: float) -> None:
            if json_output:
                _print_json({**tally.as_dict(), "bytes_per_s": round(bytes_per_s, 1)})
            elif live:
                width = render.screen_width(sys.stdout)
                line = line_of(tally, bytes_per_s)
                typer.echo(f"\r\033[K{line if width is None else line[: width - 1]}", nl=False)
            else:
                typer.echo(line_of(tally, bytes_per_s))
            sys.stdout.flush()

        source: AsyncIterator[bytes] = bytes_of(descriptor)
        try:
            await forward(
                stream,
                source if rate is None else at_rate(source, rate),
                show,
                every_s or (TERMINAL_EVERY_S if sys.stdout.isatty() else ELSEWHERE_EVERY_S),
            )
        finally:
            await stream.end()
            if json_output:
                _print_json(stream.tally.as_dict())
            else:
                typer.echo(("\r\033[K" if live else "") + f"sent {line_of(stream.tally, None)}")
        if not stream.tally.read_bytes:
            fail("nothing came: the program that was to bring the corrections ended without a byte")
        return Exit.DONE if stream.tally.counts["messages"] else Exit.FAILED

    run(command)


@corrections.command("status")
def status(json_output: Json = False) -> None:
    """Show what went since the daemon began, what each radio made of it, and what fix every vehicle has."""

    async def command(gcs: Client) -> None:
        told = await gcs.call("corrections.status")
        if json_output:
            typer.echo(json.dumps(told, indent=2))
            return
        for line in status_lines(told):
            typer.echo(line)

    run(command)


def status_lines(told: dict[str, Any]) -> list[str]:
    """What corrections.status answered, for a person."""
    lines: list[str] = []
    if told["age_s"] is None:
        lines.append("over this daemon's socket nothing was sent yet")
    else:
        whose = f"from {told['source']}" if told["source"] else "no source at present"
        lines.append(
            f"{whose}: {told['messages']:,} messages, {told['bytes']:,} B, {told['bytes_per_s']:,.0f} B/s, "
            f"the last {told['age_s']:,.0f} s ago"
        )
    lines += [
        f"  {type_:<5} {of['messages']:>7,} messages {of['bytes']:>10,} B, the last {of['age_s']:,.0f} s ago"
        for type_, of in told["types"].items()
    ]
    flaws = (("not taken by any link", "refused"), ("too long", "too_long"), ("damaged", "bad_crc"))
    lines += [f"  {what}: {told[name]:,} messages" for what, name in flaws if told[name]]
    for radio in told["radios"]:
        of = "" if radio["source"] is None else f" of {radio['source']}"
        waits = "" if radio.get("wait_p95_s") is None else f", waits p95 {radio['wait_p95_s']:.1f} s"
        lines.append(
            f"{radio['link']} ({radio['peer']}): {radio['bytes_per_s']:,.0f} B/s for corrections, "
            f"{radio['messages']:,} messages{of} sent, {radio['waiting']:,} fragments wait{waits}"
        )
        lost = [f"{radio[name]:,} {name}" for name in ("replaced", "expired", "dropped", "incomplete") if radio[name]]
        if radio["other_source"]:
            lost.append(f"{radio['other_source']:,} fragments of a second base refused")
        if lost:
            lines.append(f"  {', '.join(lost)}")
    for vehicle in told["vehicles"]:
        satellites = "" if vehicle["satellites"] is None else f", {vehicle['satellites']} satellites"
        lines.append(f"{vehicle['name']}: {vehicle['fix'] or 'no GPS told'}{satellites}")
    return lines


def _opened(file: str) -> int:
    try:
        return os.open(file, os.O_RDONLY | os.O_NOCTTY)
    except OSError as error:
        fail(f"cannot read {file}: {os.strerror(error.errno) if error.errno else error}")
        raise typer.Exit(Exit.FAILED) from None


def _interrupting(live: bool, text: str) -> None:
    if live:
        typer.echo("\r\033[K", nl=False)
    fail(text)


def _print_json(told: dict[str, Any]) -> None:
    typer.echo(json.dumps(told))


def _within(option: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:
        raise typer.BadParameter(f"{option}: {value:g} is not between {least:g} and {most:g}")
