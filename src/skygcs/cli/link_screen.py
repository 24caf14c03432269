"""`skygcs-cli link status`: where the air of each radio goes, once or live."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.admission_lines import third_party_lines
from skygcs.cli.connection import run
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from rich.console import RenderableType

BARS = "▁▂▃▄▅▆▇█"
HISTORY_COLUMNS = 30

NO_RADIO = 'no link has the role "radio": give the radio\'s serial link role = "radio" in the fleet file'
RADIO_DOWN = "{name} is {state}: skygcs-cli links says why"
NO_AIRTIME = (
    "{name} is up, but a {type} link without an emulated radio has no limited airtime to show; "
    "radio = {{ air_kbps = 64 }} under [links.{name}] in the fleet file emulates one"
)


async def look(gcs: Client) -> RenderableType:
    """What each radio carries now, for a screen; without one, why there is nothing to show."""
    from rich.text import Text

    radios = await gcs.call("link.status")
    return drawn(radios) if radios else Text("\n".join(await no_radio_lines(gcs)))


async def no_radio_lines(gcs: Client) -> list[str]:
    """Why link.status is empty: one line per link of role radio, or that there is none."""
    radios = [link for link in await gcs.call("links.list") if link["role"] == "radio"]
    if not radios:
        return [NO_RADIO]
    return [(NO_AIRTIME if link["state"] == "up" else RADIO_DOWN).format(**link) for link in radios]


def status(
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on, until Ctrl-C.")] = False,
    every_s: Annotated[float, typer.Option("--every", metavar="S", help="Between two looks.", parser=finite)] = 1.0,
    json_output: Json = False,
) -> None:
    """Show what each radio carries: budget, classes, vehicles, losses, signal. Live with --follow."""
    if not 0.1 <= every_s <= 3600:
        raise typer.BadParameter("--every: is not within 0.1 to 3600 s")

    async def command(gcs: Client) -> None:
        if json_output:
            while True:
                typer.echo(json.dumps(await gcs.call("link.status"), indent=None if follow else 2))
                if not follow:
                    return
                sys.stdout.flush()
                await asyncio.sleep(every_s)
        screen = render.console()
        if not follow or not sys.stdout.isatty():
            while True:
                screen.print(await look(gcs))
                if not follow:
                    return
                await asyncio.sleep(every_s)
        from rich.live import Live

        with Live(await look(gcs), console=screen, auto_refresh=False) as shown:
            while True:
                await asyncio.sleep(every_s)
                shown.update(await look(gcs), refresh=True)

    run(command)


def select(
    targets: Annotated[str, typer.Argument(metavar="TARGETS", help="Vehicles, or none.", show_default=False)],
) -> None:
    """Give some vehicles twice the others' part of a radio that is too narrow for all; `none` ends it."""

    async def command(gcs: Client) -> None:
        answer = await gcs.call("link.select", targets=None if targets == "none" else targets)
        typer.echo(f"selected: {', '.join(answer['selected']) or 'none'}")

    run(command)


def drawn(radios: list[dict[str, Any]]) -> RenderableType:
    """Everything that link.status told, for a screen."""
    from rich.console import Group
    from rich.text import Text

    parts: list[RenderableType] = []
    for radio in radios:
        parts += [Text(line) for line in head_lines(radio)]
        parts += [_classes(radio["up"]["classes"]), *(Text(line) for line in third_party_lines(radio["up"]))]
        parts.append(_vehicles(radio["vehicles"]))
    return Group(*parts)


def head_lines(radio: dict[str, Any]) -> list[str]:
    """What goes up and down one radio, and what it says of itself."""
    up, down = radio["up"], radio["down"]
    turn = "" if up["round_s"] is None else f", a round takes {up['round_s']:.2f} s"
    slower = f", cut to {down['factor']:.0%} after losses" if down["factor"] < 1 else ""
    lines = [
        f"{radio['link']} ({radio['peer']}){turn}",
        f"  up    {up['bytes_per_s']:,.0f} of {up['base_bytes_per_s']:,.0f} B/s, paced by its {up['paced_by']}",
        f"  down  {down['measured_bytes_per_s']:,.0f} B/s come, {down['planned_bytes_per_s']:,.0f} planned, "
        f"{down['budget_bytes_per_s']:,.0f} may be{slower}",
    ]
    report = up["radio"]
    if report is None:
        lines.append("  radio says nothing (is its MAVLink framing on?)")
    else:
        lines.append(
            f"  radio rssi {report['rssi']} noise {report['noise']} (other end {report['remrssi']}, "
            f"{report['remnoise']}), buffer {report['txbuf_percent']} % free, {report['age_s']:.0f} s ago"
        )
        lines.append(f"        buffer free {_bars([r['txbuf_percent'] for r in radio['history']], 0, 100)}")
        lines.append(f"        rssi        {_bars([r['rssi'] for r in radio['history']], 0, 254)}")
    if radio["poor"]:
        lines.append(f"  degraded: {', '.join(radio['poor'])}")
    return lines


def _bars(values: list[float], least: float, most: float) -> str:
    steps = len(BARS) - 1
    shares = [(min(max(v, least), most) - least) / (most - least) for v in values[-HISTORY_COLUMNS:]]
    return "".join(BARS[round(share * steps)] for share in shares)


def _classes(classes: dict[str, dict[str, Any]]) -> RenderableType:
    from rich.table import Table

    table = Table("class", *("waits", "sent", "bytes", "replaced", "dropped", "refused", "wait p50", "p95"), box=None)
    for column in table.columns[1:]:
        column.justify = "right"
    for name, told in classes.items():
        if any(told[key] for key in ("waiting", "sent", "dropped", "refused")):
            numbers = [f"{told[k]:,}" for k in ("waiting", "sent", "sent_bytes", "replaced", "dropped", "refused")]
            table.add_row(name, *numbers, _seconds(told["wait_p50_s"]), _seconds(told["wait_p95_s"]))
    return table


def _vehicles(vehicles: list[dict[str, Any]]) -> RenderableType:
    from rich.table import Table

    table = Table("vehicle", "B/s", "planned", "position Hz", "planned", "loss", "round trip", "", box=None)
    for column in table.columns[1:7]:
        column.justify = "right"
    for told in sorted(vehicles, key=lambda v: int(v["sysid"])):
        position = told["streams"].get("GLOBAL_POSITION_INT", {"measured_hz": 0.0, "planned_hz": 0.0})
        remarks = [
            word for word, true in (("being set up", not told["settled"]), ("less than wanted", told["scaled"])) if true
        ]
        remarks += ["flown"] if told["weight"] >= 4 else ["selected"] if told["weight"] >= 2 else []
        table.add_row(
            told["name"],
            "-" if told["measured_bytes_per_s"] is None else f"{told['measured_bytes_per_s']:,.0f}",
            f"{told['planned_bytes_per_s']:,.0f}",
            f"{position['measured_hz']:.1f}",
            f"{position['planned_hz']:.2g}",
            "-" if told["loss"] is None else f"{told['loss']:.1%}",
            _seconds(told["round_trip_s"]),
            ", ".join(remarks),
        )
    return table


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"
