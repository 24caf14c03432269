"""What people see: states, outcomes, links and events as text. rich is imported only where a table is drawn."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

State = Mapping[str, Any]

PIPE_WIDTH = 250
"""Columns where there is no terminal: nothing is cut."""

LONG_REASON = 60
"""A reason longer than this is told whole once, not for each vehicle."""

LOW_BATTERY_PERCENT = 25
STATUS_COLUMNS = (
    "name",
    "id",
    "autopilot",
    "mode",
    "armed",
    "alt",
    "x, y, up",
    "battery",
    "gps",
    "link",
    "loss",
    "age",
    "last text",
)
WORLD_COLUMN = STATUS_COLUMNS.index("x, y, up")
"""Metres along the axes of the fleet's world frame."""

LINK_COLUMNS = (
    "link",
    "type",
    "role",
    "state",
    "peer",
    "rx",
    "tx",
    "dropped",
    "bad crc",
    "unknown",
    "noise",
    "sources",
)


STATUS_LEAVES_OUT = ("last text", "loss", "link", "autopilot", "gps", "x, y, up", "id")
LINKS_LEAVE_OUT = ("unknown", "noise", "role", "type", "bad crc")
"""What a narrow terminal does not show, first things first."""

WRAPPING_COLUMNS = 16
"""Least width of a column that may be wrapped."""


def console() -> Console:
    from rich.console import Console

    return Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=PIPE_WIDTH)


def status_cells(state: State) -> tuple[str, ...]:
    """One vehicle in the columns of STATUS_COLUMNS, without any markup."""
    battery, gps, position = (state.get(k) or {} for k in ("battery", "gps", "position"))
    links: Mapping[str, Any] = state.get("links") or {}
    best = min(links, key=lambda name: _number(links[name].get("loss_ratio"), 1.0), default=None)
    texts: Sequence[Mapping[str, Any]] = state.get("status_texts") or ()
    newest = min(texts, key=lambda t: _number(t.get("age_s"), 0.0), default=None)
    return (
        str(state["name"]),
        str(state["sysid"]),
        " ".join(filter(None, (state.get("autopilot"), state.get("firmware")))),
        state.get("mode") or "?",
        armed_word(state),
        _altitude(position, state.get("landed")),
        _world(position.get("enu_m")),
        " ".join(filter(None, (_unit(battery.get("percent"), "%", 0), _unit(battery.get("volts"), "V", 1)))),
        " ".join(filter(None, (gps.get("fix"), _unit(gps.get("satellites"), "sat", 0)))),
        best or "",
        percent(links[best].get("loss_ratio")) if best is not None else "",
        age_word(state),
        f"{newest['text']} ({duration(newest.get('age_s'))} ago)" if newest is not None else "",
    )


def armed_word(state: State) -> str:
    """Armed or not, and what is worse than either."""
    armed = {True: "ARMED", False: "no", None: "?"}[state.get("armed")]
    further = (("failsafe", "FAILSAFE"), ("duplicate_sysid", "DUPLICATE ID"), ("replayed", "REPLAY"))
    words = [word for key, word in further if state.get(key)]
    if is_deaf(state):
        words.append("HEARS NOTHING")
    return " ".join([armed, *words])


def is_deaf(state: State) -> bool:
    """True if it is heard, and does not hear us."""
    return (state.get("uplink") or {}).get("heard") is False


def age_word(state: State) -> str:
    """How long ago it was heard; "lost" if that is too long."""
    age = duration(state.get("last_heartbeat_age_s"))
    return age if state.get("connected") else f"lost {age}"


def status_table(states: Iterable[State], fields: Sequence[str] = (), width: int = PIPE_WIDTH) -> Table:
    """All vehicles; with ``fields`` (dotted paths) only the name and these. In a small ``width`` columns are missing:
    better that than all of them cut off."""
    from rich.table import Table
    from rich.text import Text

    states = list(states)
    columns = ("name", *fields) if fields else STATUS_COLUMNS
    rows = [(str(s["name"]), *(field_text(s, f) for f in fields)) if fields else status_cells(s) for s in states]
    if not fields and not any(row[WORLD_COLUMN] for row in rows):  # the fleet has no origin: no column for it
        columns = tuple("" if i == WORLD_COLUMN else column for i, column in enumerate(columns))
    shown = range(len(columns)) if fields else fitting(columns, rows, width, STATUS_LEAVES_OUT, ("last text",))
    if not fields and len(columns) - 1 in shown:  # the last text is cut to the room that is left, and never wrapped
        others = sum(max(len(columns[i]), *(len(row[i]) for row in rows), 0) + 2 for i in shown[:-1])
        rows = [(*row[:-1], _cut(row[-1], max(width - others, WRAPPING_COLUMNS))) for row in rows]
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i in shown:
        right = columns[i] in ("id", "alt", "x, y, up", "loss", "age")
        table.add_column(columns[i], justify="right" if right else "left", no_wrap=True)
    for state, row in zip(states, rows, strict=True):
        styles = [""] * len(row) if fields else _styles(state)
        cells = [Text(row[i], style=styles[i]) for i in shown]
        table.add_row(*cells, style="dim" if state.get("connected") is False else None)
    return table


def components_table(components: Iterable[Mapping[str, Any]]) -> Table:
    """A row per component, by system; what its id is meant for beside what it says it is."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in ("vehicle", "component", "named", "type", "messages", "age"):
        table.add_column(column, justify="right" if column in ("messages", "age") else "left", no_wrap=True)
    for component in components:
        kind = component["type"] or "no heartbeat"
        cells = (
            component["vehicle"] or "-",
            f"{component['sysid']}/{component['compid']}",
            component["name"] or "-",
            f"{kind} (autopilot)" if component["autopilot"] else kind,
            f"{component['messages']}",
            duration(component["age_s"]),
        )
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _cut(text: str, columns: int) -> str:
    return text if len(text) <= columns else text[: columns - 1] + "…"


def fitting(
    columns: Sequence[str], rows: Sequence[Sequence[str]], width: int, leave_out: Sequence[str], wrapping: Sequence[str]
) -> list[int]:
    """Indices of the columns that have room, two spaces between them; one without name and cells has none."""
    wide = [max(len(column), *(len(row[i]) for row in rows), 0) for i, column in enumerate(columns)]
    wide = [min(w, WRAPPING_COLUMNS) if c in wrapping else w for w, c in zip(wide, columns, strict=True)]
    shown = [i for i, w in enumerate(wide) if w]
    for name in (n for n in leave_out if n in columns):
        if sum(wide[i] + 2 for i in shown) - 2 <= width:
            break
        shown.remove(columns.index(name))
    return shown


def field_text(state: State, path: str) -> str:
    """The value at a dotted path ("position.alt_rel_m", "imu.accel_mps2.2") as text; "-" where nothing is known."""
    value: Any = state
    for part in path.split("."):
        if isinstance(value, Mapping):
            value = value.get(part)
        elif isinstance(value, list) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            return "-"
    return plain(value)


def screen_width(stream: Any) -> int | None:
    """Columns of the terminal that ``stream`` is; None where it is none and nothing is wrapped."""
    return shutil.get_terminal_size().columns if stream.isatty() else None


def wrapped(text: str, columns: int | None, indent: int = 0) -> str:
    """Each line between words, further lines indented."""
    if columns is None:
        return text
    wrapper = textwrap.TextWrapper(
        columns,
        subsequent_indent=" " * min(indent, columns // 2),
        replace_whitespace=False,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(line if len(line) <= columns else wrapper.fill(line) for line in text.split("\n"))


def outcome_lines(outcomes: Mapping[str, Mapping[str, Any]], columns: int | None = None) -> list[str]:
    """One line per vehicle: whether it is done, and how or why not. Long reasons that repeat are told once."""
    width = max((len(name) for name in outcomes), default=0)
    lines = []
    told: dict[str, str] = {}
    for name, outcome in outcomes.items():
        word = "ok  " if outcome["ok"] else "FAIL"
        message = outcome["message"] or outcome["result"]
        first = told.setdefault(message, name)
        if first != name and len(message) > LONG_REASON:
            message = f"{message.partition(';')[0][:LONG_REASON]} … as {first}"
        sent = outcome["attempts"]
        if sent:  # none: nothing was sent
            how = f"{outcome['elapsed_s']:.1f} s" + (f", {sent} transmissions" if sent > 1 else "")
            message = f"{message} ({how})"
        extra = [t for t in outcome.get("status_texts") or () if t not in message]
        rows = [f"{word} {name:<{width}}  {message}", *(f"     {'':<{width}}  {text}" for text in extra)]
        lines += [wrapped(row, columns, indent=width + 7) for row in rows]
    return lines


def event_line(event: Mapping[str, Any]) -> str:
    """Local time, kind, text; and how many were lost before it."""
    clock = time.strftime("%H:%M:%S", time.localtime(event["time_unix_s"]))
    vehicle = event.get("vehicle")
    text = str(event["text"])
    if vehicle and re.search(rf"\b{re.escape(vehicle)}\b", text) is None:  # "ac" is not told by "reached"
        text = f"{vehicle}: {text}"
    lost = f"  [{event['dropped']} events lost before this one]" if event.get("dropped") else ""
    return f"{clock} {event['kind']:<18} {text}{lost}"


def message_line(message: Mapping[str, Any]) -> str:
    """Source, name and every field of one message."""
    source = message.get("source") or f"{message.get('sysid')}/{message.get('compid')}"
    fields = " ".join(f"{k}={plain(v)}" for k, v in message["fields"].items())
    lost = f"  [{message['dropped']} lost before this one]" if message.get("dropped") else ""
    return f"{source} {message['name']} {fields}{lost}"


def links_table(links: Iterable[Mapping[str, Any]], width: int = PIPE_WIDTH) -> RenderableType:
    """A row per channel; a link without channels has one row of its own. Below it, why links are down, and
    who behind a bound link reaches for vehicles that are not its own.

    ``width`` as in `status_table`.
    """
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    rows: list[tuple[str, ...]] = []
    styles: list[str | None] = []
    reasons = []
    for link in links:
        state = str(link.get("state", "?"))
        since = link.get("since_s")
        timeless = since is None or state == "disabled"
        state_text = state if timeless else f"{state} {duration(since)}"
        if state not in ("up", "disabled") and link.get("last_error"):
            reasons.append(Text(f"{link['name']}: {' '.join(str(link['last_error']).split())}", style="red"))
        head = (str(link["name"]), str(link.get("type", "")), _role(link), state_text)
        reached = sum(channel.get("out_of_bounds") or 0 for channel in link.get("channels") or ())
        if reached:
            text = f"{link['name']}: {reached} frames for others than the vehicles of this link were dropped"
            reasons.append(Text(text, style="yellow"))
        channels = [_channel_cells(channel) for channel in link.get("channels") or ()] or [("",) * 8]
        rows += [(*(head if i == 0 else ("",) * 4), *cells) for i, cells in enumerate(channels)]
        styles += [{"down": "red", "disabled": "dim"}.get(state)] * len(channels)
    table = Table(box=None, pad_edge=False, header_style="bold")
    shown = fitting(LINK_COLUMNS, rows, width, LINKS_LEAVE_OUT, ("peer", "sources"))
    for i in shown:
        table.add_column(LINK_COLUMNS[i], no_wrap=LINK_COLUMNS[i] not in ("peer", "sources"))
    for row, style in zip(rows, styles, strict=True):
        table.add_row(*(Text(row[i]) for i in shown), style=style)
    return Group(table, *reasons)


def _role(link: Mapping[str, Any]) -> str:
    """ "radio"; of a link bound to vehicles also whom it shows: "gcs: kite as 1"."""
    bound = [str(vehicle) for vehicle in link.get("vehicles") or ()]
    vehicles = ", ".join(bound[:3]) + (f" +{len(bound) - 3}" if len(bound) > 3 else "")
    shown_as = f" as {link['present_as']}" if link.get("present_as") is not None else ""
    return f"{link.get('role', '')}{vehicles and ': '}{vehicles}{shown_as}"


def _channel_cells(channel: Mapping[str, Any]) -> tuple[str, ...]:
    counters: Mapping[str, Any] = channel.get("counters") or channel
    sources = channel.get("sources") or {}
    heard = (f"{name} {percent(s.get('loss_ratio'))}" for name, s in list(sources.items())[:8])
    more = f" +{len(sources) - 8}" if len(sources) > 8 else ""
    keys = ("rx_frames", "tx_frames", "tx_dropped", "bad_crc", "unknown")
    noise = _unit(counters.get("skipped_bytes"), "B", 0)
    return (str(channel.get("peer", "")), *(plain(counters.get(k)) for k in keys), noise, ", ".join(heard) + more)


def duration(seconds: object) -> str:
    """ "0.4 s", "12 s", "5 min", "3 h"; "?" if unknown."""
    if not isinstance(seconds, int | float):
        return "?"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


def percent(ratio: object) -> str:
    return f"{100 * ratio:.1f} %" if isinstance(ratio, int | float) else ""


def _altitude(position: Mapping[str, Any], landed: object) -> str:
    altitude = _unit(position.get("alt_rel_m"), "m", 1)
    return f"{altitude} ground".strip() if landed == "on_ground" else altitude


def _world(enu_m: Sequence[float] | None) -> str:
    return "" if enu_m is None else ", ".join(_unit(value, "", 1).strip() for value in enu_m)


def _styles(state: State) -> list[str]:
    styles = dict.fromkeys(STATUS_COLUMNS, "")
    if state.get("armed"):
        styles["armed"] = "bold yellow"
    if state.get("failsafe") or state.get("duplicate_sysid") or is_deaf(state):
        styles["armed"] = "bold red"
    if not state.get("connected"):
        styles["age"] = "bold red"
    charge = (state.get("battery") or {}).get("percent")
    if isinstance(charge, int | float) and charge <= LOW_BATTERY_PERCENT:
        styles["battery"] = "bold red"
    if ((state.get("gps") or {}).get("fix_type") or 0) < 3:
        styles["gps"] = "yellow"
    return list(styles.values())


def plain(value: object) -> str:
    match value:
        case None:
            return "-"
        case bool():
            return str(value).lower()
        case float():
            return f"{value:.7g}"
        case list():
            return "[" + ", ".join(plain(v) for v in value) + "]"
        case Mapping():
            return " ".join(f"{k}={plain(v)}" for k, v in value.items())
    return str(value)


def _unit(value: object, unit: str, digits: int) -> str:
    # adding 0.0 makes 0.0 of the -0.0 that rounding left
    return f"{round(value, digits) + 0.0:.{digits}f} {unit}" if isinstance(value, int | float) else ""


def _number(value: object, default: float) -> float:
    return float(value) if isinstance(value, int | float) else default
