"""How vehicles are controlled, as people see it: a row each, and the reasons below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skygcs.cli.render import PIPE_WIDTH, State, fitting, plain

if TYPE_CHECKING:
    from rich.console import RenderableType

TRACK_COLUMNS = (
    "name",
    "mode",
    "control_mode",
    "error",
    "x y z error",
    "age",
    "delay p95",
    "rtt",
    "rate",
    "ticks",
    "late",
    "skipped",
    "thrust",
    "roll pitch",
    "limits",
)
TRACK_LEAVES_OUT = ("roll pitch", "thrust", "x y z error", "ticks", "rate", "rtt", "skipped", "late", "limits")
"""What a narrow terminal does not show, first things first."""

_LEFT = ("name", "mode", "control_mode", "limits")


def track_cells(state: State) -> tuple[str, ...]:
    """One vehicle in the columns of TRACK_COLUMNS, without any markup."""
    control: Mapping[str, Any] = state.get("control") or {}
    if not control or control.get("state") == "off":
        return (str(state["name"]), "off", *("",) * (len(TRACK_COLUMNS) - 2))
    ticks, late, skipped = (_count(control.get(key)) for key in ("ticks", "late", "skipped"))
    return (
        str(state["name"]),
        str(control.get("mode") or "?"),
        _control_mode(control),
        _fixed(control.get("error_m"), 2, " m"),
        _vector(control.get("error_enu_m"), 2),
        _milliseconds(control.get("state_age_s")),
        _milliseconds(control.get("delay_p95_s")),
        _milliseconds(control.get("rtt_s")),
        _fixed(control.get("rate_hz"), 0, " Hz"),
        ticks,
        late,
        skipped,
        _fixed(control.get("thrust"), 2, ""),
        _vector([control.get("roll_deg"), control.get("pitch_deg")], 0, "°"),
        " ".join(str(name) for name in control.get("saturation") or ()),
    )


def track_reasons(state: State) -> str:
    """Why it is not flown as wanted; "" if it is."""
    control: Mapping[str, Any] = state.get("control") or {}
    return "; ".join(str(reason) for reason in control.get("reasons") or ())


def track_line(state: State) -> str:
    """One update as a line of text."""
    cells = zip(TRACK_COLUMNS, track_cells(state), strict=True)
    named = (
        cell if column in ("name", "mode", "control_mode") else f"{column} {cell}" for column, cell in cells if cell
    )
    line = "  ".join(named)
    reasons = track_reasons(state)
    return f"{line}  ({reasons})" if reasons else line


def track_table(states: Sequence[State], width: int = PIPE_WIDTH) -> RenderableType:
    """All vehicles, and below them who is not flown as wanted, and why."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    if not states:
        return Text("no vehicle heard yet (skygcs-cli links shows what arrives)")
    rows = [track_cells(state) for state in states]
    shown = fitting(TRACK_COLUMNS, rows, width, TRACK_LEAVES_OUT, ())
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i in shown:
        table.add_column(TRACK_COLUMNS[i], justify="left" if TRACK_COLUMNS[i] in _LEFT else "right", no_wrap=True)
    for state, row in zip(states, rows, strict=True):
        styles = _styles(state)
        cells = [Text(row[i], style=styles.get(TRACK_COLUMNS[i], "")) for i in shown]
        table.add_row(*cells, style="dim" if row[1] == "off" else None)
    why = [(str(state["name"]), track_reasons(state)) for state in states]
    return Group(table, *(Text(f"{name}: {reasons}", style="yellow") for name, reasons in why if reasons))


def _control_mode(control: Mapping[str, Any]) -> str:
    """How it is flown now; what is going on, where it is not."""
    return str(control.get("control_mode") or "") if control.get("state") == "flying" else str(control.get("state"))


def _styles(state: State) -> dict[str, str]:
    control: Mapping[str, Any] = state.get("control") or {}
    if control.get("state") == "held":
        return {"control_mode": "bold red"}
    if control.get("state") == "flying" and control.get("control_mode") != control.get("mode"):
        return {"control_mode": "bold yellow"}
    return {"limits": "yellow"}


def _count(value: object) -> str:
    return "" if value is None else plain(value)


def _fixed(value: object, digits: int, unit: str) -> str:
    # adding 0.0 makes 0.0 of the -0.0 that rounding left
    return f"{round(value, digits) + 0.0:.{digits}f}{unit}" if isinstance(value, int | float) else ""


def _milliseconds(seconds: object) -> str:
    """ "85 ms"; from ten seconds on "12 s"."""
    if not isinstance(seconds, int | float):
        return ""
    return f"{1000 * seconds:.0f} ms" if seconds < 9.9995 else f"{seconds:.0f} s"


def _vector(values: object, digits: int, unit: str = "") -> str:
    if not isinstance(values, list) or not all(isinstance(v, int | float) for v in values):
        return ""
    return " ".join(f"{_fixed(v, digits, unit):>5}" for v in values)
