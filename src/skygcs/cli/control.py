"""`skygcs-cli control` and `track`: control loops that skygcs closes, their gains, recordings and errors."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import Exit, exit_code, print_outcomes, run, run_offline, run_order, run_show
from skygcs.cli.options import Json, OptionalTargets, OrderJson, Targets
from skygcs.cli.parsing import finite
from skygcs.cli.render import PIPE_WIDTH, State, console, fitting, fixed, plain, print_json, print_lines, say, table
from skygcs.cli.status import NOTHING_HEARD, Count, Rate, follow_states
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from rich.console import RenderableType

app = typer.Typer(
    help="Close the control loops in skygcs: choose the mode, change gains, record, replay.", no_args_is_help=True
)

MISMATCHES_SHOWN = 10
"""One wrong cell of the input changes every row after it; the first few show where to look."""

Gains = Mapping[str, Any]


class Mode(StrEnum):
    """Argument of `control set`."""

    OFF = "off"
    POSITION = "position"
    VELOCITY = "velocity"
    ATTITUDE = "attitude"
    RAW = "raw"


class Switch(StrEnum):
    ON = "on"
    OFF = "off"


@app.command("set")
def set_mode(
    targets: Targets,
    mode: Annotated[
        Mode,
        typer.Argument(
            metavar="off|position|velocity|attitude|raw",
            help="The setpoint that skygcs sends; off: the autopilot flies alone, nothing is sent.",
            show_default=False,
        ),
    ],
    force: Annotated[
        bool, typer.Option("--force", help="Send attitudes although the vehicle may not be safe if they stop.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Take vehicles under control (start setpoints, switch the flight mode, check), or give them back.

    position: the autopilot flies to positions. velocity: skygcs closes the position loop. attitude: skygcs closes the
    velocity loop, too. skygcs falls back by itself if the link is too slow, and reports that. raw: your own program
    closes all loops and sends attitude, body rates or accelerations with `setpoint`.

    Example: skygcs-cli control set alpha position
    """
    run_order("control.set", json_output, targets=targets, mode=mode.value, force=force)


# --- gains ------------------------------------------------------------------------------------------------------------


def _gain(option: str, text: str) -> Any:
    return typer.Option(option, metavar="K", help=text, parser=finite, show_default=False)


@app.command("gains")
def gains(
    targets: OptionalTargets = "all",
    xy_pos_p: Annotated[float | None, _gain("--xy-pos-p", "x, y: velocity per metre of error, 1/s.")] = None,
    xy_vel_p: Annotated[float | None, _gain("--xy-vel-p", "x, y: thrust per m/s of error.")] = None,
    xy_vel_i: Annotated[float | None, _gain("--xy-vel-i", "x, y: thrust per metre of integrated error.")] = None,
    xy_vel_d: Annotated[float | None, _gain("--xy-vel-d", "x, y: thrust per m/s² of error.")] = None,
    z_pos_p: Annotated[float | None, _gain("--z-pos-p", "The same for z.")] = None,
    z_vel_p: Annotated[float | None, _gain("--z-vel-p", "")] = None,
    z_vel_i: Annotated[float | None, _gain("--z-vel-i", "")] = None,
    z_vel_d: Annotated[float | None, _gain("--z-vel-d", "")] = None,
    hover: Annotated[float | None, _gain("--hover", "Normalised thrust at hover.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Although the measured delay leaves these gains little margin.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Show the gains, or change them until the daemon ends (also in flight). `skygcs-cli gains` shows their margins.

    Example: skygcs-cli control gains alpha --xy-vel-p 0.1
    """
    # the gains that are given
    xy = _given(pos_p_per_s=xy_pos_p, vel_p=xy_vel_p, vel_i=xy_vel_i, vel_d=xy_vel_d)
    z = _given(pos_p_per_s=z_pos_p, vel_p=z_vel_p, vel_i=z_vel_i, vel_d=z_vel_d)
    changes = _given(xy=xy or None, z=z or None, hover_thrust=hover)

    async def command(gcs: Client) -> int:
        # the present gains
        before = (await gcs.call("control.gains", targets=targets))["gains"]
        if not changes:
            _show_gains(before, json_output)
            return Exit.DONE
        # change them and show what changed
        answer = await gcs.call("control.gains", targets=targets, **changes, force=force)
        outcomes, after = answer["outcomes"], answer["gains"]
        if json_output:
            print_json({"outcomes": outcomes, "before": before, "after": after})
            return exit_code(outcomes)
        code = print_outcomes(outcomes, False)
        print_lines(_gain_changes(before, after))
        return code

    run(command)


def _given(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _flat(gains: Gains) -> dict[str, Any]:
    """{"xy": {"vel_p": 1}, "hover_thrust": 2} as {"xy.vel_p": 1, "hover_thrust": 2}."""
    flat: dict[str, Any] = {}
    for key, value in gains.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{name}": number for name, number in value.items()}
        else:
            flat[key] = value
    return flat


def _show_gains(gains: Mapping[str, Gains], json_output: bool) -> None:
    """A column per vehicle, a row per gain."""
    if json_output:
        print_json({"gains": gains})
        return
    flats = {name: _flat(of_one) for name, of_one in gains.items()}
    keys = dict.fromkeys(key for flat in flats.values() for key in flat)
    rows = [(key, *(plain(flat.get(key)) for flat in flats.values())) for key in keys]
    console().print(table(("gain", *flats), rows, right=flats))


def _gain_changes(before: Mapping[str, Gains], after: Mapping[str, Gains]) -> Iterator[str]:
    """ "alpha: xy.vel_p 0.08 -> 0.1" for all gains that changed."""
    for name, gains in after.items():
        old, new = _flat(before.get(name, {})), _flat(gains)
        changed = [f"{k} {plain(old.get(k))} -> {plain(v)}" for k, v in new.items() if v != old.get(k)]
        if changed:
            yield f"{name}: {', '.join(changed)}"


# --- recordings -------------------------------------------------------------------------------------------------------


@app.command("record")
def record(
    targets: Targets,
    switch: Annotated[Switch, typer.Argument(metavar="on|off", help="Start or stop.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Write reference, estimate and output of every control tick to a file, one for each vehicle.

    Example: skygcs-cli control record alpha on
    """
    nothing = "recording begins when it is under control" if switch is Switch.ON else "nothing was being recorded"

    def lines(answer: dict[str, dict[str, str | None]]) -> Iterator[str]:
        return (f"{name}: {file or nothing}" for name, file in answer["files"].items())

    run_show("control.record", json_output, lines, targets=targets, on=switch is Switch.ON)


@app.command("replay")
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file of `control record`.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Run the control law over a recording and compare its output with the recorded one, bit for bit. No daemon.

    Example: skygcs-cli control replay alpha.csv
    """
    run_offline(lambda: _replay(file, json_output))


def _replay(file: Path, json_output: bool) -> int:
    from skygcs.core.control.trace import ATTITUDE, VELOCITY, TraceEntry, rerun
    from skygcs.tlog.trace_file import read_trace

    steps = 0

    def counted(trace: Iterator[TraceEntry]) -> Iterator[TraceEntry]:
        nonlocal steps
        for entry in trace:
            steps += entry.row.control_mode in (ATTITUDE, VELOCITY)
            yield entry

    # run the law over every row; keep the first mismatches, count the others
    with read_trace(file) as trace:
        found = rerun(counted(iter(trace)))
        first = list(islice(found, MISMATCHES_SHOWN))
        count = len(first) + sum(1 for _ in found)
        cut_line = trace.cut_line
    # report
    if json_output:
        shown = [{"line": m.line, "column": m.column, "recorded": m.recorded, "computed": m.computed} for m in first]
        answer = {"vehicle": trace.head.vehicle, "steps": steps, "mismatches": count, "first": shown}
        print_json(answer | {"cut_line": cut_line})
        return Exit.FAILED if count else Exit.DONE
    if cut_line is not None:
        say(f"line {cut_line} is incomplete and was left out")
    for m in first:
        say(f"{file}:{m.line}: {m.column} is {m.recorded or 'empty'}, the law gives {m.computed or 'nothing'}")
    if count > len(first):
        say(f"… and {count - len(first):,} more cells")
    verdict = f"{count:,} cell{'s differ' if count > 1 else ' differs'}" if count else "all bit-identical"
    nothing = "skygcs closed no loop in this recording: there is nothing to run again"
    say(f"{trace.head.vehicle}: {steps:,} steps, {verdict}" if steps else nothing)
    return Exit.FAILED if count else Exit.DONE


# --- tracking ---------------------------------------------------------------------------------------------------------

TRACK_COLUMNS = (
    *("name", "mode", "control_mode", "error", "x y z error", "age", "delay p95", "rtt", "rate"),
    *("ticks", "late", "skipped", "thrust", "roll pitch", "limits"),
)
TRACK_LEAVES_OUT = ("roll pitch", "thrust", "x y z error", "ticks", "rate", "rtt", "skipped", "late", "limits")
"""Columns that a narrow terminal does not show, in the order in which they are left out."""

_LEFT = ("name", "mode", "control_mode", "limits")


@app.command("status")
def status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show once how each vehicle is controlled; `track` shows it live.

    Example: skygcs-cli control status alpha
    """

    async def command(gcs: Client) -> None:
        if json_output:
            print_json(await gcs.call("control.status", targets=targets))
        else:
            screen = console()
            screen.print(track_table(await gcs.vehicles(targets), screen.width))

    run(command)


def track(
    targets: OptionalTargets = "all",
    rate_hz: Rate = 4.0,
    once: Annotated[bool, typer.Option("--once", help="Show it once and exit.")] = False,
    count: Count = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Show tracking error, delays and ticks of controlled vehicles, until Ctrl-C. On a pipe: one line per update.

    Example: skygcs-cli track all --rate 1
    """

    async def command(gcs: Client) -> None:
        if not once:
            updates = gcs.telemetry(targets, rate_hz=rate_hz, groups=["control", "connected"])
            await follow_states(updates, count, json_output, track_line, track_table)
            return
        states = await gcs.vehicles(targets)
        if json_output:
            for state in states:
                wanted = {"name": state["name"], "sysid": state["sysid"], "control": state.get("control")}
                print_json(wanted, line=True)
        else:
            screen = console()
            screen.print(track_table(states, screen.width))

    run(command)


def track_cells(state: State) -> tuple[str, ...]:
    """One vehicle in the columns of TRACK_COLUMNS, without any markup."""
    control: Mapping[str, Any] = state.get("control") or {}
    if not control or control.get("state") == "off":
        return (str(state["name"]), "off", *("",) * (len(TRACK_COLUMNS) - 2))
    flying = control.get("state") == "flying"
    counts = (control.get(key) for key in ("ticks", "late", "skipped"))
    return (
        str(state["name"]),
        str(control.get("mode") or "?"),
        str(control.get("control_mode") or "") if flying else str(control.get("state")),
        fixed(control.get("error_m"), 2, " m"),
        _vector(control.get("error_enu_m"), 2),
        _milliseconds(control.get("state_age_s")),
        _milliseconds(control.get("delay_p95_s")),
        _milliseconds(control.get("rtt_s")),
        fixed(control.get("rate_hz"), 0, " Hz"),
        *("" if count is None else plain(count) for count in counts),
        fixed(control.get("thrust"), 2),
        _vector([control.get("roll_deg"), control.get("pitch_deg")], 0, "°"),
        " ".join(str(name) for name in control.get("saturation") or ()),
    )


def track_reasons(state: State) -> str:
    """Why the requested mode is not flown, and the client or trajectory it follows; "" if there is nothing to say."""
    control: Mapping[str, Any] = state.get("control") or {}
    reasons = [str(reason) for reason in control.get("reasons") or ()]
    if stream := control.get("stream"):
        reasons.append(f"follows the setpoints of {stream['client']}")
    trajectory = control.get("trajectory")
    if trajectory:
        at, of = trajectory["trajectory_s"], trajectory["duration_s"]
        reasons.append(f"trajectory {trajectory['name']} {trajectory['state']}, {at:.1f} of {of:.1f} s")
    return "; ".join(reasons)


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
    """All vehicles; below them, why a requested mode is not flown."""
    from rich.console import Group
    from rich.text import Text

    if not states:
        return Text(f"no vehicle {NOTHING_HEARD}")
    rows = [track_cells(state) for state in states]
    known = [column if any(row[i] for row in rows) else "" for i, column in enumerate(TRACK_COLUMNS)]
    shown = fitting(known, rows, width, TRACK_LEAVES_OUT, ())
    columns = [TRACK_COLUMNS[i] for i in shown]
    styles = [_styles(state) for state in states]
    cells = [
        [(row[i], style.get(TRACK_COLUMNS[i], "")) for i in shown] for row, style in zip(rows, styles, strict=True)
    ]
    made = table(
        columns,
        cells,
        right=set(columns).difference(_LEFT),
        styles=["dim" if row[1] == "off" else None for row in rows],
    )
    why = [(str(state["name"]), track_reasons(state)) for state in states]
    return Group(made, *(Text(f"{name}: {reasons}", style="yellow") for name, reasons in why if reasons))


def _styles(state: State) -> dict[str, str]:
    control: Mapping[str, Any] = state.get("control") or {}
    if control.get("state") == "held":
        return {"control_mode": "bold red"}
    if control.get("state") == "flying" and control.get("control_mode") != control.get("mode"):
        return {"control_mode": "bold yellow"}
    return {"limits": "yellow"}


def _milliseconds(seconds: object) -> str:
    """ "85 ms"; from ten seconds on "12 s"."""
    if not isinstance(seconds, int | float):
        return ""
    return f"{1000 * seconds:.0f} ms" if seconds < 9.9995 else f"{seconds:.0f} s"


def _vector(values: object, digits: int, unit: str = "") -> str:
    if not isinstance(values, list) or not all(isinstance(v, int | float) for v in values):
        return ""
    return " ".join(f"{fixed(v, digits, unit):>5}" for v in values)


def add_to(app_: typer.Typer) -> None:
    app_.command()(track)
    app_.add_typer(app, name="control")
