"""`skygcs-cli links`: list and change links. `skygcs-cli link`: what a shared radio carries, and what it can carry."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from skygcs.cli.connection import Exit, run, run_offline
from skygcs.cli.options import Json, LinkName
from skygcs.cli.parsing import finite, parse_link, within
from skygcs.cli.render import (
    PIPE_WIDTH,
    LiveView,
    console,
    duration,
    fitting,
    fixed,
    percent,
    plain,
    print_json,
    print_lines,
    say,
    table,
)
from skygcs.core.radio_link.capacity import FLOWN_HZ, FRAME_BYTES, PROFILES, SETPOINTS, LinkDemand, LinkPlan, plan_link
from skygcs.errors import ConfigError
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from rich.console import RenderableType

links = typer.Typer(help="List, add, change and remove links.", invoke_without_command=True)
link = typer.Typer(help="The shared radio: what it carries now, and what it could carry.", invoke_without_command=True)

LINK_COLUMNS = (
    *("link", "type", "role", "state", "peer", "rx", "tx"),
    *("dropped", "bad crc", "unknown", "noise", "sources"),
)
LINKS_LEAVE_OUT = ("unknown", "noise", "role", "type", "bad crc")
"""Columns that a narrow terminal does not show, in the order in which they are left out."""

MAX_SOURCES = 8
"""Sources shown of a channel, and of a radio those that sent most; the others are counted."""

Pairs = Annotated[
    list[str],
    typer.Argument(
        metavar="KEY=VALUE …",
        help="As in the fleet file: type=udp_server port=14550 allow_msg_id_in=HEARTBEAT,ATTITUDE.",
    ),
]


@links.callback()
def _links_default(ctx: typer.Context, json_output: Json = False) -> None:
    """List, add, change and remove links; without a command: `links list`."""
    if ctx.invoked_subcommand is None:
        _links("links.list", json_output)


@links.command("list")
def _list_links(json_output: Json = False) -> None:
    """Show every link and channel with its counters.

    Example: skygcs-cli links list
    """
    _links("links.list", json_output)


@links.command("add")
def _add_link(name: LinkName, pairs: Pairs, json_output: Json = False) -> None:
    """Add a link until the daemon ends: `links add qgc type=udp_client host=10.0.0.5 port=14550`.

    Example: skygcs-cli links add tablet type=udp_client host=192.168.1.20 port=14550 role=gcs
    """
    _links("links.add", json_output, name=name, link=parse_link(pairs))


@links.command("change")
def _change_link(name: LinkName, pairs: Pairs, json_output: Json = False) -> None:
    """Close a link and open it again with these keys changed.

    Example: skygcs-cli links change tablet port=14551
    """
    _links("links.change", json_output, name=name, link=parse_link(pairs))


@links.command("remove")
def _remove_link(name: LinkName, json_output: Json = False) -> None:
    """Close a link and remove it.

    Example: skygcs-cli links remove tablet
    """
    _links("links.remove", json_output, name=name)


def _links(method: str, json_output: bool, **params: Any) -> NoReturn:
    async def command(gcs: Client) -> None:
        answer = await gcs.call(method, **params)
        if json_output:
            print_json(answer)
        elif answer:
            screen = console()
            screen.print(links_table(answer, screen.width))
            for row in answer:
                if row.get("warning") and params.get("name") in (None, row["name"]):
                    say(f"warning: {row['name']}: {row['warning']}", err=True)
        else:
            say("no links; add one: skygcs-cli links add NAME type=udp_server port=14550")

    run(command)


def links_table(links: Iterable[Mapping[str, Any]], width: int = PIPE_WIDTH) -> RenderableType:
    """A row per channel; a link without channels has one row. A small ``width`` leaves columns out.

    Below the table: why links are down, and how many frames for other vehicles a bound link dropped.
    """
    from rich.console import Group
    from rich.text import Text

    rows: list[tuple[str, ...]] = []
    styles: list[str | None] = []
    remarks = []
    for link in links:
        # the link itself: state and the error behind it
        state = str(link.get("state", "?"))
        since = link.get("since_s")
        state_text = state if since is None or state == "disabled" else f"{state} {duration(since)}"
        if state not in ("up", "disabled") and link.get("last_error"):
            remarks.append(Text(f"{link['name']}: {' '.join(str(link['last_error']).split())}", style="red"))
        dropped = sum(channel.get("out_of_bounds") or 0 for channel in link.get("channels") or ())
        if dropped:
            text = f"{link['name']}: {dropped} frames for other vehicles than those of this link were dropped"
            remarks.append(Text(text, style="yellow"))
        # its channels; the columns of the link are filled in the first row only
        head = (str(link["name"]), str(link.get("type", "")), _role(link), state_text)
        channels = [_channel_cells(channel) for channel in link.get("channels") or ()] or [("",) * 8]
        rows += [(*(head if i == 0 else ("",) * 4), *cells) for i, cells in enumerate(channels)]
        styles += [{"down": "red", "disabled": "dim"}.get(state)] * len(channels)
    wrapping = ("peer", "sources")
    shown = fitting(LINK_COLUMNS, rows, width, LINKS_LEAVE_OUT, wrapping)
    cells = [[row[i] for i in shown] for row in rows]
    return Group(table([LINK_COLUMNS[i] for i in shown], cells, wrap=wrapping, styles=styles), *remarks)


def _role(link: Mapping[str, Any]) -> str:
    """ "radio"; for a link bound to vehicles also which, and the system id it shows: "gcs: kite as 1"."""
    bound = [str(vehicle) for vehicle in link.get("vehicles") or ()]
    vehicles = ", ".join(bound[:3]) + (f" +{len(bound) - 3}" if len(bound) > 3 else "")
    shown_as = f" as {link['translated_sysid']}" if link.get("translated_sysid") is not None else ""
    return f"{link.get('role', '')}{vehicles and ': '}{vehicles}{shown_as}"


def _channel_cells(channel: Mapping[str, Any]) -> tuple[str, ...]:
    counters: Mapping[str, Any] = channel.get("counters") or channel
    sources = channel.get("sources") or {}
    heard = (f"{name} {percent(s.get('loss_ratio'))}" for name, s in list(sources.items())[:MAX_SOURCES])
    more = f" +{len(sources) - MAX_SOURCES}" if len(sources) > MAX_SOURCES else ""
    keys = ("rx_frames", "tx_frames", "tx_dropped", "bad_crc", "unknown")
    noise = fixed(counters.get("skipped_bytes"), 0, " B")
    return (str(channel.get("peer", "")), *(plain(counters.get(k)) for k in keys), noise, ", ".join(heard) + more)


# --- the radio now ----------------------------------------------------------------------------------------------------

BARS = "▁▂▃▄▅▆▇█"
HISTORY_COLUMNS = 30

NO_RADIO = 'no link has the role "radio": give the radio\'s serial link role = "radio" in the fleet file'
RADIO_DOWN = "{name} is {state}: skygcs-cli links shows why"
NO_AIRTIME = (
    "{name} is up, but a {type} link without an emulated radio has no limited airtime to show; "
    "radio = {{ air_kbps = 64 }} under [links.{name}] in the fleet file emulates one"
)


@link.callback()
def _link_default(ctx: typer.Context) -> None:
    """The shared radio; without a command: `link status`, live on a terminal."""
    if ctx.invoked_subcommand is None:
        status(follow=sys.stdout.isatty(), every_s=1.0, json_output=False)


@link.command("status")
def status(
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Show it live, until Ctrl-C.")] = False,
    every_s: Annotated[float, typer.Option("--every", metavar="S", help="Period.", parser=finite)] = 1.0,
    json_output: Json = False,
) -> None:
    """Show what each radio carries: budget, classes, vehicles, losses, signal. Live with --follow.

    Example: skygcs-cli link status --follow
    """
    within("--every", every_s, 0.1, 3600)

    async def command(gcs: Client) -> None:
        live = follow and sys.stdout.isatty() and not json_output
        picture: RenderableType = ""
        with LiveView(lambda _: picture, enabled=live) as view:
            while True:
                if json_output:
                    print_json(await gcs.call("link.status"), line=follow)
                else:
                    picture = await look(gcs)
                if live:
                    view.refresh(now=True)
                elif not json_output:
                    console().print(picture)
                if not follow:
                    return
                await asyncio.sleep(every_s)

    run(command)


@link.command("select")
def _select(
    targets: Annotated[str, typer.Argument(metavar="TARGETS", help="Vehicles, or none.", show_default=False)],
) -> None:
    """Give some vehicles twice the share of the others on a radio that is too slow for all; `none` ends it.

    Example: skygcs-cli link select 3
    """

    async def command(gcs: Client) -> None:
        answer = await gcs.call("link.select", targets=None if targets == "none" else targets)
        say(f"selected: {', '.join(answer['selected']) or 'none'}")

    run(command)


async def look(gcs: Client) -> RenderableType:
    """Return what each radio carries now; without a radio, why there is nothing to show."""
    from rich.text import Text

    radios = await gcs.call("link.status")
    return drawn(radios) if radios else Text("\n".join(await no_radio_lines(gcs)))


async def no_radio_lines(gcs: Client) -> list[str]:
    """Why link.status is empty: one line per link with the role radio, or that there is no such link."""
    radios = [link for link in await gcs.call("links.list") if link["role"] == "radio"]
    if not radios:
        return [NO_RADIO]
    return [(NO_AIRTIME if link["state"] == "up" else RADIO_DOWN).format(**link) for link in radios]


def drawn(radios: list[dict[str, Any]]) -> RenderableType:
    """The answer of link.status for a screen."""
    from rich.console import Group
    from rich.text import Text

    parts: list[RenderableType] = []
    for radio in radios:
        parts += [Text(line) for line in head_lines(radio)]
        parts += [_classes(radio["up"]["classes"]), *(Text(line) for line in third_party_lines(radio["up"]))]
        parts.append(_vehicles(radio["vehicles"]))
    return Group(*parts)


def head_lines(radio: dict[str, Any]) -> list[str]:
    """Rates of one radio in both directions, and what it reports about itself."""
    up, down = radio["up"], radio["down"]
    timing = f" ({up['timing']})" if up.get("timing") else ""
    round_ = "" if up["round_s"] is None else f", a round takes {up['round_s']:.2f} s{timing}"
    slower = f", cut to {down['factor']:.0%} after losses" if down["factor"] < 1 else ""
    lines = [
        f"{radio['link']} ({radio['peer']}){round_}",
        f"  up    {up['bytes_per_s']:,.0f} of {up['base_bytes_per_s']:,.0f} B/s, paced by its {up['paced_by']}",
        f"  down  measured {down['measured_bytes_per_s']:,.0f} B/s, planned {down['planned_bytes_per_s']:,.0f}, "
        f"available {down['budget_bytes_per_s']:,.0f}{slower}",
    ]
    report = up["radio"]
    if report is None:
        lines.append("  radio no RADIO_STATUS received (is its MAVLink framing on?)")
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
    """The traffic classes of the transmit queue that carried anything."""
    keys = ("waiting", "sent", "sent_bytes", "replaced", "dropped", "refused")
    rows = [
        (name, *(f"{one[key]:,}" for key in keys), _seconds(one["wait_p50_s"]), _seconds(one["wait_p95_s"]))
        for name, one in classes.items()
        if any(one[key] for key in ("waiting", "sent", "dropped", "refused"))
    ]
    columns = ("class", "waiting", "sent", "bytes", "replaced", "dropped", "refused", "wait p50", "p95")
    return table(columns, rows, right=columns[1:])


def _vehicles(vehicles: list[dict[str, Any]]) -> RenderableType:
    rows = []
    for one in sorted(vehicles, key=lambda v: int(v["sysid"])):
        position = one["streams"].get("GLOBAL_POSITION_INT", {"measured_hz": 0.0, "planned_hz": 0.0})
        remarks = ["being set up"] * (not one["settled"]) + ["less than requested"] * one["scaled"]
        remarks += ["flown"] if one["weight"] >= 4 else ["selected"] if one["weight"] >= 2 else []
        rows.append(
            (
                one["name"],
                "-" if one["measured_bytes_per_s"] is None else f"{one['measured_bytes_per_s']:,.0f}",
                f"{one['planned_bytes_per_s']:,.0f}",
                f"{position['measured_hz']:.1f}",
                f"{position['planned_hz']:.2g}",
                "-" if one["loss"] is None else f"{one['loss']:.1%}",
                _seconds(one["round_trip_s"]),
                ", ".join(remarks),
            )
        )
    columns = ("vehicle", "B/s", "planned", "position Hz", "planned Hz", "loss", "round trip", "")
    return table(columns, rows, right=columns[1:7])


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


COUNT_WORDS = {
    "corrections": "corrections",
    "slowed": "slowed",
    "thinned": "too often",
    "repeated": "repeated",
    "held": "lists held",
    "refused_streams": "streams refused",
    "refused_logs": "logs refused",
    "refused_param_lists": "lists refused",
    "refused_files": "files refused",
    "refused_turn": "file transfers out of turn",
    "refused_rate": "rate 0",
    "needless": "needless heartbeats",
}
"""Words for the counters of third-party traffic."""


def third_party_lines(up: dict[str, Any]) -> list[str]:
    """Return what other programs send to the vehicles through this radio; no line if they have sent nothing."""
    third_party, corrections = up.get("third_party"), up.get("corrections")
    lines = []
    if third_party is not None and third_party["sources"]:
        limit = f"{third_party['bytes_per_s']:,.0f} B/s"
        lines.append(f"  limit of other programs {limit}{_lists(third_party['param_lists'])}")
        sources = sorted(third_party["sources"], key=lambda s: -(s["sent"] + sum(s["counts"].values())))
        lines += [_source(source) for source in sources[:MAX_SOURCES]]
        if len(sources) > MAX_SOURCES:
            lines.append(f"    and {len(sources) - MAX_SOURCES} more")
    if corrections is not None and corrections["source"] is not None:
        lines.append(_corrections(corrections))
    return lines


def _lists(lists: dict[str, Any]) -> str:
    running, waiting = lists["running"], lists["waiting"]
    if running is None:
        return ""
    waits = f", those of {', '.join(map(str, waiting))} wait" if waiting else ""
    return f"; parameters of {running['sysid']} arrive ({running['seen']} of {running['count'] or '?'}){waits}"


def _source(source: dict[str, Any]) -> str:
    parts = [f"sent {source['sent']:,} ({source['sent_bytes']:,} B)"]
    parts += [f"{COUNT_WORDS.get(name, name)} {count:,}" for name, count in source["counts"].items()]
    silent = f", silent for {source['age_s']:.0f} s" if source["age_s"] > 5 else ""
    return f"    {source['source']:<9} {', '.join(parts)}{silent}"


def _corrections(corrections: dict[str, Any]) -> str:
    source = corrections["source"]
    wait = "" if corrections["wait_p95_s"] is None else f", wait p95 {corrections['wait_p95_s']:.1f} s"
    old = corrections["replaced"] + corrections["expired"] + corrections["dropped"]
    return (
        f"  corrections of {source >> 8}/{source & 0xFF}: {corrections['messages']:,} messages sent "
        f"({corrections['bytes']:,} B, {corrections['bytes_per_s']:,.0f} B/s), {old:,} replaced by newer ones{wait}"
    )


# --- planning a radio -------------------------------------------------------------------------------------------------


@link.command("plan")
def plan(
    vehicles: Annotated[int, typer.Argument(metavar="VEHICLES", min=1, max=254, help="Number behind this radio.")],
    baud: Annotated[int, typer.Option("--baud", metavar="RATE", min=300, help="Of the ground's serial port.")] = 57600,
    air_kbps: Annotated[
        str, typer.Option("--air-speed", metavar="KBPS", help="Of a multipoint radio; none: no timeslots.")
    ] = "64",
    profile: Annotated[
        str, typer.Option("--profile", help="monitor, nav, control, control-10, full, or custom.")
    ] = "nav",
    rates: Annotated[
        list[str] | None,
        typer.Option("--rate", metavar="MESSAGE=HZ", help="Changes the profile; to start from none: --profile custom."),
    ] = None,
    setpoint: Annotated[
        str, typer.Option("--setpoints", help="Streamed to every vehicle: none, position, velocity, attitude.")
    ] = "none",
    setpoint_hz: Annotated[
        float, typer.Option("--setpoint-rate", metavar="HZ", parser=finite, help="Setpoints per second.")
    ] = 2.0,
    fill: Annotated[
        float, typer.Option("--fill", metavar="SHARE", parser=finite, help="Share of each direction to plan with.")
    ] = 0.5,
    timing_file: Annotated[
        Path | None, typer.Option("--timing", metavar="FILE", help="Measured timeslots, of `radio measure`.")
    ] = None,
    json_output: Json = False,
) -> None:
    """Compute whether vehicles fit on a radio, what each gets, and what would fit. Exit 1 if they do not fit.

    Example: skygcs-cli link plan 8 --air-speed 64
    """
    # check the options
    within("--fill", fill, 0.05, 1)
    if setpoint != "none":
        within("--setpoint-rate", setpoint_hz, 0.1, 100)
    demand = LinkDemand(
        vehicles,
        baud,
        _air_kbps(air_kbps),
        profile,
        _rates(profile, rates or []),
        _one_of("--setpoints", setpoint, SETPOINTS),
        setpoint_hz if setpoint != "none" else 0.0,
        fill,
    )

    # plan the link and show it
    def command() -> int:
        answer = plan_link(demand if timing_file is None else _with_measured(demand, timing_file))
        if json_output:
            print_json(_plan_json(answer))
        else:
            print_lines(_plan_lines(answer))
        return Exit.DONE if answer.fits else Exit.FAILED

    run_offline(command)


def _with_measured(demand: LinkDemand, file: Path) -> LinkDemand:
    """The demand with the timeslots of a file, which must have its air speed. Raises ConfigError."""
    from skygcs.config.radio import RadioKeys, read_timings, timing_problem

    if problem := timing_problem(RadioKeys(air_speed_kbps=demand.air_kbps), file):
        raise ConfigError("--timing", [problem.replace("air_speed_kbps", "--air-speed")])
    return replace(demand, measured=read_timings(file))


def _plan_lines(answer: LinkPlan) -> Iterator[str]:
    # what was asked
    demand = answer.demand
    air = "no timeslots" if demand.air_kbps is None else f"{demand.air_kbps:g} kbit/s air"
    streamed = f", {demand.setpoint} setpoints at {demand.setpoint_hz:g} Hz" if demand.setpoint != "none" else ""
    yield f"{demand.vehicles} vehicles, {demand.baud} baud, {air}, profile {demand.profile}{streamed}"
    down, up = demand.down_per_vehicle_bytes_per_s, demand.up_per_vehicle_bytes_per_s
    yield f"one vehicle: {down:,.1f} B/s down, {up:,.1f} B/s up"
    # what the radio carries
    if answer.round_s is not None and demand.timing is not None:
        yield f"a round of {demand.nodes} nodes: {answer.round_s * 1000:,.0f} ms ({demand.timing.source})"
    yield f"\n{'':<24}{'needed':>10}{'carries':>10}{'planned':>10}{'share':>8}"
    for one in answer.directions:
        numbers = f"{one.needed:>10,.0f}{one.capacity:>10,.0f}{one.usable:>10,.0f}{one.share:>8.0%}"
        yield f"{one.name:<24}{numbers}" + ("" if one.fits else "  too much")
    yield ""
    # what follows
    for problem in answer.problems:
        yield f"does not fit: {problem}"
    gets = ", ".join(f"{name} {rate:.2g}" for name, rate in answer.rates_hz.items())
    yield f"each vehicle {'gets' if answer.fits else 'would get'} (Hz): {gets}"
    if demand.setpoint != "none":
        yield f"setpoints: {answer.setpoint_hz:.2g} Hz each"
    yield f"vehicles that fit with these options: {answer.most_vehicles}"
    most = min(answer.most_streamed, answer.most_vehicles)
    yield f"`plan run` flies {_streamed(most)} by position setpoints ({FLOWN_HZ['position']:g} Hz), more by goto"
    for proposal in answer.proposals:
        yield f"would fit: {proposal}"


def _streamed(count: int) -> str:
    return f"up to {count} vehicle{'' if count == 1 else 's'}" if count else "none"


def _plan_json(answer: LinkPlan) -> dict[str, object]:
    return {
        "fits": answer.fits,
        "vehicles": answer.demand.vehicles,
        "baud": answer.demand.baud,
        "air_kbps": answer.demand.air_kbps,
        "profile": answer.demand.profile,
        "setpoints": answer.demand.setpoint,
        "down_per_vehicle_bytes_per_s": answer.demand.down_per_vehicle_bytes_per_s,
        "up_per_vehicle_bytes_per_s": answer.demand.up_per_vehicle_bytes_per_s,
        "round_s": answer.round_s,
        "timing": None if answer.demand.timing is None else answer.demand.timing.source,
        "directions": [
            {**asdict(direction), "share": direction.share, "fits": direction.fits} for direction in answer.directions
        ],
        "most_vehicles": answer.most_vehicles,
        "most_streamed": answer.most_streamed,
        "rates_hz": dict(answer.rates_hz),
        "setpoint_hz": answer.setpoint_hz,
        "problems": answer.problems,
        "proposals": answer.proposals,
    }


def _air_kbps(text: str) -> float | None:
    if text.lower() == "none":
        return None
    value = finite(text)
    within("--air-speed", value, 1, 1000)
    return value


def _rates(profile: str, changes: list[str]) -> dict[str, float]:
    rates = {"HEARTBEAT": 1.0} if profile == "custom" else dict(PROFILES[_one_of("--profile", profile, PROFILES)])
    for pair in changes:
        name, equals, text = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"--rate: {pair!r} is not of the form MESSAGE=HZ")
        rate_hz = finite(text)
        within("--rate", rate_hz, 0, 400)
        rates[_one_of("--rate", name.upper(), FRAME_BYTES)] = rate_hz
    return rates


def _one_of(option: str, name: str, known: Iterable[str]) -> str:
    names = list(known)
    if name not in names:
        raise typer.BadParameter(f"{option}: {name!r} is not one of {', '.join(names)}")
    return name


def add_to(app: typer.Typer) -> None:
    app.add_typer(links, name="links")
    app.add_typer(link, name="link")
