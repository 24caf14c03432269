"""Commands that show vehicles, components, events and the daemon, and that call any RPC method."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import USAGE_ERRORS, Exit, fail, run, run_on_sites, run_show, show, waiting
from skygcs.cli.options import Json, OptionalTargets, complete_methods
from skygcs.cli.parsing import finite, parse_json
from skygcs.cli.render import (
    PIPE_WIDTH,
    WRAPPING_COLUMNS,
    LiveView,
    State,
    console,
    cut,
    duration,
    event_line,
    field_text,
    fitting,
    fixed,
    percent,
    plain,
    print_json,
    say,
    table,
)
from skygcs.errors import RpcError
from skygcs.rpc.client import EVENT_KINDS, Client

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

NOTHING_HEARD = "heard yet (skygcs-cli links shows what arrives)"

STATUS_COLUMNS = (
    *("name", "site", "commander", "id", "autopilot", "mode", "armed", "alt", "x, y, up"),
    *("battery", "gps", "link", "companion", "loss", "age", "last text"),
)

ONLY_IF_KNOWN = ("site", "commander", "x, y, up", "companion")
"""Columns of what a whole fleet may not have: other sites, vehicles shared with them, an origin, companions."""

COMPANION_SILENT_S = 5.0
"""A companion's heartbeat comes every second."""

STATUS_LEAVES_OUT = (
    "last text",
    "loss",
    "site",
    "companion",
    "link",
    "autopilot",
    "gps",
    "x, y, up",
    "id",
    "commander",
)
"""Columns that a narrow terminal does not show, in the order in which they are left out."""

LOW_BATTERY_PERCENT = 25

OUTCOME_KEYS = ("outcome", "outcomes", "lists")
"""Keys under which answers of RPC methods say whether the order succeeded."""

Rate = Annotated[float, typer.Option("--rate", metavar="HZ", help="Updates per second, at most 20.", parser=finite)]
Count = Annotated[int, typer.Option("--count", metavar="N", help="End after N updates.", min=1, show_default=False)]


# --- vehicles and components ------------------------------------------------------------------------------------------


def status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show every vehicle, or some; with [federation] those of all sites.

    Example: skygcs-cli status alpha
    """

    async def command(gcs: Client, targets: str) -> None:
        states = await gcs.vehicles(targets)
        if json_output:
            print_json(states)
        elif states:
            screen = console()
            screen.print(status_table(by_site(states), width=screen.width))
        else:
            say(f"no vehicle {NOTHING_HEARD}")
        info = await gcs.call("daemon.info")
        if left := info.get("to_undo"):
            fail(f"{left} change{'s' if left > 1 else ''} in vehicles not undone: skygcs-cli undo list")
        if info.get("pid") is None and (site := (info.get("federation") or {}).get("site")) is not None:
            fail(f"the daemon of {site} does not answer: own vehicles are not shown")

    run_on_sites(targets, command)


def components(json_output: Json = False) -> None:
    """Show every component that was heard: autopilots, companions, cameras, gimbals, ground stations.

    Example: skygcs-cli components
    """

    async def command(gcs: Client) -> None:
        heard = await gcs.call("components.list")
        if json_output:
            print_json(heard)
        elif heard:
            console().print(components_table(heard))
        else:
            say(f"nothing {NOTHING_HEARD}")

    run(command)


def watch(
    targets: OptionalTargets = "all",
    rate_hz: Rate = 2.0,
    fields: Annotated[
        str,
        typer.Option(
            "--fields", "--telemetry", metavar="F,F,…", help="Only these: position.alt_rel_m,battery.volts, …"
        ),
    ] = "",
    count: Count = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Show vehicles as they change, until Ctrl-C; with [federation] those of all sites. On a pipe or with --json: one
    line per update.

    Example: skygcs-cli watch all --rate 1
    """
    wanted = [f.strip() for f in fields.split(",") if f.strip()]
    sections = sorted({f.split(".")[0] for f in wanted} | {"connected"}) if wanted else None

    def line(state: State) -> str:
        if wanted:
            return f"{state['name']} " + " ".join(f"{f}={field_text(state, f)}" for f in wanted)
        return "  ".join(cell for cell in status_cells(state) if cell)

    async def command(gcs: Client, targets: str) -> None:
        updates = gcs.telemetry(targets, rate_hz=rate_hz, groups=sections)
        await follow_states(
            updates, count, json_output, line, lambda states, width: status_table(states, wanted, width)
        )

    run_on_sites(targets, command)


async def follow_states(
    updates: AsyncIterator[State],
    count: int,
    json_output: bool,
    line: Callable[[State], str],
    draw: Callable[[list[State], int], RenderableType],
) -> None:
    """Show ``count`` updates of vehicles: live on a terminal, else one line each.

    ``draw(states, columns)`` gets the newest state of every vehicle, ordered by site and system id.
    """
    states: dict[str, State] = {}
    seen = 0
    live = sys.stdout.isatty() and not json_output

    def picture(columns: int) -> RenderableType:
        ordered = by_site(states.values())
        return draw(ordered, columns) if ordered else "waiting for vehicles …"

    with LiveView(picture, enabled=live) as view:
        async for state in updates:
            states[str(state["name"])] = state
            seen += 1
            if json_output:
                print_json(state, line=True)
            elif not live:
                say(line(state))
                sys.stdout.flush()
            view.refresh(now=len(states) == seen)  # a vehicle that was not shown before appears at once
            if seen >= count:
                return


def by_site(states: Iterable[State]) -> list[State]:
    """Own vehicles first, then those of other sites; each by system id."""
    return sorted(states, key=lambda state: (str(state.get("site") or ""), int(state["sysid"]), state["name"]))


def status_cells(state: State) -> tuple[str, ...]:
    """One vehicle in the columns of STATUS_COLUMNS, without any markup."""
    battery, gps, position = (state.get(k) or {} for k in ("battery", "gps", "position"))
    links: Mapping[str, Any] = state.get("links") or {}
    chosen = [name for name, link in links.items() if link.get("chosen")]
    best = min(chosen or links, key=lambda name: _number(links[name].get("loss_ratio"), 1.0), default=None)
    texts: Sequence[Mapping[str, Any]] = state.get("status_texts") or ()
    newest = min(texts, key=lambda t: _number(t.get("age_s"), 0.0), default=None)
    return (
        str(state["name"]),
        str(state.get("site") or ""),
        commander_word(state),
        str(state["sysid"]),
        " ".join(filter(None, (state.get("autopilot"), state.get("firmware")))),
        state.get("mode") or "?",
        armed_word(state),
        height_word(state),
        ", ".join(fixed(value, 1) for value in position.get("enu_m") or ()),
        " ".join(filter(None, (fixed(battery.get("percent"), 0, " %"), fixed(battery.get("volts"), 1, " V")))),
        " ".join(filter(None, (gps.get("fix"), fixed(gps.get("satellites"), 0, " sat")))),
        "" if best is None else f"{best} +{len(links) - 1}" if len(links) > 1 else best,
        companion_word(state),
        percent(links[best].get("loss_ratio")) if best is not None else "",
        age_word(state),
        f"{newest['text']} ({duration(newest.get('age_s'))} ago)" if newest is not None else "",
    )


DRIVES = ("GROUND_ROVER", "SURFACE_BOAT")
"""Types without a height: a Rover keeps a home of altitude 0 until it has moved (Rover::update_home), and so reports
itself as high as the ground is above the sea."""


def height_word(state: State) -> str:
    """Return how high it is above its home, and that it is on the ground."""
    altitude = fixed((state.get("position") or {}).get("alt_rel_m"), 1, " m")
    if state.get("type") in DRIVES:
        altitude = ""
    return f"{altitude} ground".strip() if state.get("landed") == "on_ground" else altitude


def armed_word(state: State) -> str:
    """Return whether it is armed, and warnings that matter more."""
    armed = {True: "ARMED", False: "no", None: "?"}[state.get("armed")]
    warnings = (("failsafe", "FAILSAFE"), ("duplicate_sysid", "DUPLICATE ID"), ("replayed", "REPLAY"))
    words = [word for key, word in warnings if state.get(key)]
    if (near := near_word(state)) is not None:
        words.append(near)
    if is_deaf(state):
        words.append("HEARS NOTHING")
    return " ".join([armed, *words])


def commander_word(state: State) -> str:
    """Return which site commands a vehicle of [federation.vehicles]: "here", the other site, or "nobody"; "" for every
    other vehicle.

    A vehicle of another site has the holder of its lease, as that site knows it.
    """
    authority: Mapping[str, Any] | None = state.get("authority")
    if authority is not None:
        return "here" if authority["held"] else str(authority["commander"] or "nobody")
    return str((state.get("lease") or {}).get("holder") or "")


def companion_word(state: State) -> str:
    """The computer on the vehicle: our connection to it, else whether MAVLink of it is heard; "" without one."""
    companion: Mapping[str, Any] | None = state.get("companion")
    if not companion:
        return ""
    link, age_s = companion.get("link"), companion.get("age_s")
    if link is not None:
        return str(link) if link != "down" else f"DOWN {duration(companion.get('since_s'))}"
    if age_s is None:
        return "not heard"
    return "heard" if age_s < COMPANION_SILENT_S else f"silent {duration(age_s)}"


def near_word(state: State) -> str | None:
    """The vehicle that it is about to meet, in capitals if that is soon; None: none."""
    conflict: Mapping[str, Any] = state.get("separation") or {}
    if not conflict:
        return None
    word = f"near {conflict['with']}"
    return word if conflict.get("level") == "notice" else word.upper()


def is_deaf(state: State) -> bool:
    """True if skygcs receives the vehicle, but the vehicle does not receive skygcs."""
    return (state.get("uplink") or {}).get("heard") is False


def age_word(state: State) -> str:
    """How long ago it was heard, in all if it is of another site; with "lost" if that is too long."""
    age = duration(state.get("last_heartbeat_age_s"))
    return age if state.get("connected") else f"lost {age}"


def status_table(states: Iterable[State], fields: Sequence[str] = (), width: int = PIPE_WIDTH) -> Table:
    """All vehicles; with ``fields`` (dotted paths) only the name and these. A small ``width`` leaves columns out."""
    states = list(states)
    dim = ["dim" if state.get("connected") is False else None for state in states]
    if fields:
        values = [(str(s["name"]), *(field_text(s, f) for f in fields)) for s in states]
        return table(("name", *fields), values, styles=dim)
    rows = [status_cells(state) for state in states]
    columns = [
        "" if column in ONLY_IF_KNOWN and not any(row[i] for row in rows) else column
        for i, column in enumerate(STATUS_COLUMNS)
    ]
    shown = fitting(columns, rows, width, STATUS_LEAVES_OUT, ("last text",))
    # the last text is cut to the room that is left, never wrapped
    if len(columns) - 1 in shown:
        others = sum(max(len(columns[i]), *(len(row[i]) for row in rows), 0) + 2 for i in shown[:-1])
        rows = [(*row[:-1], cut(row[-1], max(width - others, WRAPPING_COLUMNS))) for row in rows]
    styles = [_styles(state) for state in states]
    cells = [[(row[i], style.get(columns[i], "")) for i in shown] for row, style in zip(rows, styles, strict=True)]
    return table([columns[i] for i in shown], cells, right=("id", "alt", "x, y, up", "loss", "age"), styles=dim)


def components_table(components: Iterable[Mapping[str, Any]]) -> Table:
    """A row per component, ordered by system: the name that its id stands for, and the type it reports."""
    rows = []
    for component in components:
        kind = component["type"] or "no heartbeat"
        rows.append(
            (
                component["vehicle"] or "-",
                f"{component['sysid']}/{component['compid']}",
                component["name"] or "-",
                f"{kind} (autopilot)" if component["autopilot"] else kind,
                f"{component['messages']}",
                duration(component["age_s"]),
            )
        )
    return table(("vehicle", "component", "named", "type", "messages", "age"), rows, right=("messages", "age"))


def _styles(state: State) -> dict[str, str]:
    """Styles of the cells by column."""
    styles = {}
    if state.get("armed"):
        styles["armed"] = "bold yellow"
    meets = (state.get("separation") or {}).get("level") in ("warning", "action")
    if state.get("failsafe") or state.get("duplicate_sysid") or is_deaf(state) or meets:
        styles["armed"] = "bold red"
    if (state.get("authority") or {}).get("held") is False:
        styles["commander"] = "bold yellow"
    if (state.get("companion") or {}).get("link") == "down":
        styles["companion"] = "bold red"
    if not state.get("connected"):
        styles["age"] = "bold red"
    charge = (state.get("battery") or {}).get("percent")
    if isinstance(charge, int | float) and charge <= LOW_BATTERY_PERCENT:
        styles["battery"] = "bold red"
    if ((state.get("gps") or {}).get("fix_type") or 0) < 3:
        styles["gps"] = "yellow"
    return styles


def _number(value: object, default: float) -> float:
    return float(value) if isinstance(value, int | float) else default


# --- events and the daemon --------------------------------------------------------------------------------------------


def events(
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Show new events, too, until Ctrl-C.")] = False,
    limit: Annotated[int, typer.Option("--limit", "-n", metavar="N", help="Show N past events.", min=0)] = 20,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="Only this kind (may be repeated).")
    ] = None,
    json_output: Json = False,
) -> None:
    """Show what happened: found and lost vehicles, arming, modes, texts, links.

    Example: skygcs-cli events --follow --kind statustext
    """
    unknown = [k for k in kind or () if k not in EVENT_KINDS]
    if unknown:
        raise typer.BadParameter(f"--kind: no kind {', '.join(unknown)}; there are: {', '.join(EVENT_KINDS)}")

    def print_event(event: dict[str, Any]) -> None:
        if json_output:
            print_json(event, line=True)
        else:
            say(event_line(event))
            sys.stdout.flush()

    async def command(gcs: Client) -> None:
        news = gcs.events(kinds=kind) if follow else None  # subscribe first: no event is missed between the two
        if limit:
            past = await gcs.call("events.recent", limit=10000 if kind else limit)
            wanted = [e for e in past if not kind or e["kind"] in kind][-limit:]
            for event in wanted:
                print_event(event)
            if not (wanted or follow or json_output):
                say(f"no event of kind {', '.join(kind)} yet" if kind else "no event yet")
        if news is not None:
            async for event in news:
                print_event(event)

    run(command)


def info(json_output: Json = False) -> None:
    """Show the daemon itself: version, ids, dialect, recorder.

    Example: skygcs-cli info --json
    """

    def lines(answer: dict[str, dict[str, Any]]) -> Iterator[str]:
        rows = [(f"{section}.{key}", value) for section, values in answer.items() for key, value in values.items()]
        width = max(len(key) for key, _ in rows)
        return (f"{key:<{width}}  {plain(value)}" for key, value in rows)

    async def command(gcs: Client) -> None:
        answer = {"daemon": await gcs.call("daemon.info"), "recorder": await gcs.call("recorder.status")}
        show(answer, json_output, lines)

    run(command)


# --- any method -------------------------------------------------------------------------------------------------------


def call(
    method: Annotated[str, typer.Argument(metavar="METHOD", autocompletion=complete_methods, help="Any RPC method.")],
    params: Annotated[str, typer.Argument(metavar="JSON", help="Its parameters, an object.")] = "{}",
    _json: Annotated[bool, typer.Option("--json", help="No effect: the answer is always JSON.")] = False,
) -> None:
    """Call any method and print the result as JSON; `discover` lists the methods.

    Example: skygcs-cli call router.stats
    """
    try:
        given = parse_json(params)
    except ValueError as error:
        raise typer.BadParameter(f"not JSON: {error}") from None
    if not isinstance(given, dict):
        raise typer.BadParameter('parameters are a JSON object: {"targets": "all"}')

    async def command(gcs: Client) -> int:
        try:
            async with waiting(method):
                result = await gcs.call(method, **given)
        except RpcError as error:
            if error.code not in USAGE_ERRORS:
                raise
            fail(str(error))  # with the method's own names: they were typed
            return Exit.USAGE
        print_json(result)
        outcomes = [result.get(key, {}) for key in OUTCOME_KEYS] if isinstance(result, dict) else []
        return Exit.DONE if all(_succeeded(outcome) for outcome in outcomes) else Exit.FAILED

    run(command)


def _succeeded(outcome: dict[str, Any]) -> bool:
    """True if an outcome, or every outcome of a table by vehicle or by vehicle and parameter, is good."""
    return bool(outcome["ok"]) if "ok" in outcome else all(_succeeded(one) for one in outcome.values())


def discover(json_output: Json = False) -> None:
    """List the RPC methods; --json prints the OpenRPC document.

    Example: skygcs-cli discover --json
    """

    def lines(document: dict[str, Any]) -> Iterator[str]:
        for method in document["methods"]:
            params = ", ".join(p["name"] if p["required"] else f"[{p['name']}]" for p in method["params"])
            yield f"{method['name']:<20} {params}"
            yield f"{'':<20} {method['summary']}"

    run_show("rpc.discover", json_output, lines)


def add_to(app: typer.Typer) -> None:
    looking: tuple[Callable[..., None], ...] = (status, components, watch, events, info)
    for function in looking:
        app.command()(function)
    programming: tuple[Callable[..., None], ...] = (call, discover)
    for function in programming:
        app.command()(function)
