"""Output that people read: tables, the live screen, outcomes, events and values as text; and JSON for programs.

rich is imported in functions only: a command that prints JSON starts without it.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import typer

from skygcs.terminal_text import visible

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live
    from rich.table import Table

State = Mapping[str, Any]
Cell = str | tuple[str, str]
"""Text of a cell, or text and style. Square brackets in it are no markup."""

PIPE_WIDTH = 250
"""Columns where there is no terminal: nothing is cut."""

SCREEN_HZ = 4.0
"""A live screen is redrawn this often at most."""

LONG_REASON = 60
"""Columns. A longer reason that several vehicles share is printed in full once."""

WRAPPING_COLUMNS = 16
"""Smallest width of a column that may be wrapped."""


def print_json(value: object, *, line: bool = False) -> None:
    """Print ``value`` as JSON: indented, or as one line of a stream, which is flushed."""
    typer.echo(json.dumps(value, indent=None if line else 2))
    if line:
        sys.stdout.flush()


def print_lines(lines: Iterable[str]) -> None:
    for line in lines:
        say(line)


def say(text: str, *, err: bool = False, nl: bool = True, over: bool = False) -> None:
    """Print text for a person: the only way, since a vehicle's text or a file's name may hold what moves the cursor,
    which is shown and not obeyed. ``over``: in place of what stands in the terminal's line."""
    typer.echo(("\r\033[K" if over else "") + visible(text, lines=True), nl=nl, err=err)


# --- terminal and tables ----------------------------------------------------------------------------------------------


def console() -> Console:
    from rich.console import Console

    return Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=PIPE_WIDTH)


def screen_width(stream: Any) -> int | None:
    """Columns of the terminal that ``stream`` is connected to; None if it is no terminal."""
    return shutil.get_terminal_size().columns if stream.isatty() else None


def wrapped(text: str, columns: int | None, indent: int = 0) -> str:
    """Wrap each line between words and indent the continuation lines. ``columns`` None: the text as it is."""
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


def cut(text: str, columns: int) -> str:
    return text if len(text) <= columns else text[: columns - 1] + "…"


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[Cell]],
    *,
    right: Iterable[str] = (),
    wrap: Iterable[str] = (),
    styles: Sequence[str | None] = (),
    title: str | None = None,
) -> Table:
    """A table without lines. ``right``: columns aligned right; ``wrap``: columns that may be wrapped; ``styles``: one
    for each row."""
    from rich.table import Table
    from rich.text import Text

    made = Table(box=None, pad_edge=False, header_style="bold", title=title, title_justify="left")
    right, wrap = frozenset(right), frozenset(wrap)
    for column in columns:
        made.add_column(
            Text(column),
            justify="right" if column in right else "left",
            no_wrap=column not in wrap,
            overflow="fold" if column in wrap else "ellipsis",
        )
    for i, row in enumerate(rows):
        styled = ((cell, "") if isinstance(cell, str) else cell for cell in row)
        cells = (Text(visible(text, lines=True), style=style) for text, style in styled)
        made.add_row(*cells, style=styles[i] if styles else None)
    return made


def fitting(
    columns: Sequence[str], rows: Sequence[Sequence[str]], width: int, leave_out: Sequence[str], wrapping: Sequence[str]
) -> list[int]:
    """Indices of the columns that fit into ``width``. Those of ``leave_out`` are left out first, in this order; a
    column without name and cells is always left out."""
    wide = [max(len(column), *(len(row[i]) for row in rows), 0) for i, column in enumerate(columns)]
    wide = [min(w, WRAPPING_COLUMNS) if c in wrapping else w for w, c in zip(wide, columns, strict=True)]
    shown = [i for i, w in enumerate(wide) if w]
    for name in (n for n in leave_out if n in columns):
        if sum(wide[i] + 2 for i in shown) - 2 <= width:
            break
        shown.remove(columns.index(name))
    return shown


class LiveView:
    """A part of the terminal that is redrawn in place. A context manager; what was drawn last stays on the screen.

    ``draw(columns)`` makes the picture. ``enabled`` False: nothing is drawn.
    """

    def __init__(self, draw: Callable[[int], RenderableType], *, enabled: bool = True) -> None:
        self._draw = draw
        self._enabled = enabled
        self._live: Live | None = None
        self._drawn_s = 0.0

    def __enter__(self) -> Self:
        if self._enabled:
            from rich.live import Live

            screen = console()
            self._live = Live(self._draw(screen.width), console=screen, auto_refresh=False, vertical_overflow="crop")
            self._live.start(refresh=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.refresh(now=True)
        if self._live is not None:
            self._live.stop()

    def refresh(self, *, now: bool = False) -> None:
        """Draw again, unless the last picture is newer than 1 / SCREEN_HZ; ``now``: in any case."""
        if self._live is None or not (now or time.monotonic() - self._drawn_s >= 1 / SCREEN_HZ):
            return
        self._drawn_s = time.monotonic()
        self._live.update(self._draw(self._live.console.width), refresh=True)


# --- outcomes and events ----------------------------------------------------------------------------------------------


class OutcomeLines:
    """The lines of an order's outcomes: whether it succeeded for each vehicle, and how or why not. A long reason that
    several vehicles share is printed in full once. ``columns``: of the terminal; ``width``: of the longest name."""

    def __init__(self, columns: int | None = None, width: int = 0) -> None:
        self.width = width
        self._columns = columns
        self._first_with: dict[str, str] = {}

    def of(self, name: str, outcome: Mapping[str, Any]) -> list[str]:
        """The lines of one vehicle."""
        width = self.width
        word = "ok  " if outcome["ok"] else "FAIL"
        message = outcome["message"] or outcome["result"]
        first = self._first_with.setdefault(message, name)
        if first != name and len(message) > LONG_REASON:
            begin = textwrap.shorten(message.partition(";")[0], LONG_REASON, placeholder="")
            message = min(message, f"{begin} … as {first}", key=len)
        sent = outcome["attempts"]
        if sent:  # 0: nothing was sent
            how = f"{outcome['elapsed_s']:.1f} s" + (f", {sent} transmissions" if sent > 1 else "")
            message = f"{message} ({how})"
        extra = [t for t in outcome.get("status_texts") or () if t not in message]
        rows = [f"{word} {name:<{width}}  {message}", *(f"     {'':<{width}}  {text}" for text in extra)]
        return [wrapped(row, self._columns, indent=width + 7) for row in rows]


def outcome_lines(outcomes: Mapping[str, Mapping[str, Any]], columns: int | None = None) -> list[str]:
    """The lines of several outcomes, by vehicle name."""
    lines = OutcomeLines(columns, max((len(name) for name in outcomes), default=0))
    return [line for name, outcome in outcomes.items() for line in lines.of(name, outcome)]


def event_line(event: Mapping[str, Any]) -> str:
    """Local time, kind and text of an event, and how many events were lost before it."""
    clock = time.strftime("%H:%M:%S", time.localtime(event["time_unix_s"]))
    vehicle = event.get("vehicle")
    text = str(event["text"])
    if vehicle and re.search(rf"\b{re.escape(vehicle)}\b", text) is None:  # whole words: "reached" does not name "ac"
        text = f"{vehicle}: {text}"
    lost = f"  [{event['dropped']} events lost before this one]" if event.get("dropped") else ""
    return f"{clock} {event['kind']:<18} {text}{lost}"


# --- values -----------------------------------------------------------------------------------------------------------


def field_text(state: State, path: str) -> str:
    """The value at a dotted path ("position.alt_rel_m", "imu.accel_mps2.2") as text; "-" if it is unknown."""
    value: Any = state
    for part in path.split("."):
        if isinstance(value, Mapping):
            value = value.get(part)
        elif isinstance(value, list) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            return "-"
    return plain(value)


def plain(value: object) -> str:
    """Any JSON value as short text."""
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


def fixed(value: object, digits: int, unit: str = "") -> str:
    """A number with so many decimals and its unit; "" if it is unknown."""
    # adding 0.0 turns the -0.0 of rounding into 0.0
    return f"{round(value, digits) + 0.0:.{digits}f}{unit}" if isinstance(value, int | float) else ""


def duration(seconds: object) -> str:
    """ "0.4 s", "12 s", "5 min", "3 h"; "?" if it is unknown."""
    if not isinstance(seconds, int | float):
        return "?"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


def percent(ratio: object) -> str:
    return f"{100 * ratio:.1f} %" if isinstance(ratio, int | float) else ""


def plural(count: int, word: str) -> str:
    """ "1 vehicle", "2 vehicles"."""
    return f"{count:,} {word}" + ("" if count == 1 else "s")
