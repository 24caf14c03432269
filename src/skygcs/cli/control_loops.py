"""`skygcs-cli control`: who closes the control loops of a vehicle, with which gains, and what was recorded of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli import render
from skygcs.cli.connection import Exit, run, run_offline, waiting
from skygcs.cli.options import Json, OptionalTargets, Targets
from skygcs.cli.orders import tell_outcomes
from skygcs.cli.parsing import finite
from skygcs.rpc.client import Client

app = typer.Typer(help="Close the control loops here: choose how, change gains, record, replay.", no_args_is_help=True)

MISMATCHES_SHOWN = 10
"""One wrong cell of the input changes every row after it; the first few tell where to look."""


class Mode(StrEnum):
    """What `control set` takes."""

    OFF = "off"
    POSITION = "position"
    VELOCITY = "velocity"
    ATTITUDE = "attitude"


class Switch(StrEnum):
    ON = "on"
    OFF = "off"


@app.command("set")
def set_mode(
    targets: Targets,
    mode: Annotated[
        Mode,
        typer.Argument(
            metavar="off|position|velocity|attitude",
            help="The last loop that skygcs leaves to the autopilot; off: all of them, nothing is sent.",
            show_default=False,
        ),
    ],
    force: Annotated[
        bool, typer.Option("--force", help="Attitude in spite of what the vehicle would do if setpoints ceased.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Take vehicles under control: start the setpoints, switch the flight mode, check; or give them back.

    position: the autopilot flies to positions. velocity: skygcs closes the position loop. attitude: the velocity loop
    as well. It falls back by itself where the link is too slow, and says so.
    """

    async def command(gcs: Client) -> int:
        async with waiting(f"control {mode} {targets}"):
            answer = await gcs.call("control.set", targets=targets, mode=mode.value, force=force)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


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
    hover: Annotated[float | None, _gain("--hover", "Normalised thrust that hovers.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Although the delay leaves them little margin.")] = False,
    json_output: Json = False,
) -> None:
    """Show the gains, or change them (also in flight; until the daemon ends). `gains` tells what delay they bear."""
    xy = _given(pos_p_per_s=xy_pos_p, vel_p=xy_vel_p, vel_i=xy_vel_i, vel_d=xy_vel_d)
    z = _given(pos_p_per_s=z_pos_p, vel_p=z_vel_p, vel_i=z_vel_i, vel_d=z_vel_d)
    changes = _given(xy=xy or None, z=z or None, hover_thrust=hover)

    async def command(gcs: Client) -> int:
        before = (await gcs.call("control.gains", targets=targets))["gains"]
        if not changes:
            _show_gains(before, json_output)
            return Exit.DONE
        answer = await gcs.call("control.gains", targets=targets, **changes, force=force)
        outcomes, after = answer["outcomes"], answer["gains"]
        if json_output:
            typer.echo(json.dumps({"outcomes": outcomes, "before": before, "after": after}, indent=2))
            return Exit.DONE if all(o["ok"] for o in outcomes.values()) else Exit.FAILED
        code = tell_outcomes(outcomes, False)
        for line in _gain_changes(before, after):
            typer.echo(line)
        return code

    run(command)


@app.command("status")
def status(targets: OptionalTargets = "all", json_output: Json = False) -> None:
    """Show how each vehicle is controlled, once; `track` goes on."""

    async def command(gcs: Client) -> None:
        if json_output:
            typer.echo(json.dumps(await gcs.call("control.status", targets=targets), indent=2))
            return
        from skygcs.cli.track_table import track_table

        screen = render.console()
        screen.print(track_table(await gcs.vehicles(targets), screen.width))

    run(command)


@app.command("record")
def record(
    targets: Targets,
    switch: Annotated[Switch, typer.Argument(metavar="on|off", help="Begin or end.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Write reference, estimate and output of every tick to a file of its own for each vehicle."""

    async def command(gcs: Client) -> int:
        files: dict[str, str | None] = (await gcs.call("control.record", targets=targets, on=switch is Switch.ON))[
            "files"
        ]
        if json_output:
            typer.echo(json.dumps({"files": files}, indent=2))
            return Exit.DONE
        nothing = "recording begins when it is under control" if switch is Switch.ON else "nothing was being recorded"
        for name, file in files.items():
            typer.echo(f"{name}: {file or nothing}")
        return Exit.DONE

    run(command)


@app.command("replay")
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file of `control record`.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Offline: run the law over a recording and tell whether it answers the same, bit for bit."""

    def command() -> int:
        from skygcs.cli.trace_file import read_trace
        from skygcs.core.control.trace import ATTITUDE, VELOCITY, Mismatch, TraceEntry, rerun

        steps = 0
        mismatches: list[Mismatch] = []
        count = 0
        with read_trace(file) as trace:

            def counted() -> Iterator[TraceEntry]:
                nonlocal steps
                for entry in trace:
                    steps += entry.row.control_mode in (ATTITUDE, VELOCITY)
                    yield entry

            for mismatch in rerun(counted()):
                count += 1
                if len(mismatches) < MISMATCHES_SHOWN:
                    mismatches.append(mismatch)
            cut = trace.cut_line
        if json_output:
            shown = [
                {"line": m.line, "column": m.column, "recorded": m.recorded, "computed": m.computed} for m in mismatches
            ]
            answer = {"vehicle": trace.head.vehicle, "steps": steps, "mismatches": count, "first": shown}
            typer.echo(json.dumps(answer | {"cut_line": cut}, indent=2))
            return Exit.FAILED if count else Exit.DONE
        if cut is not None:
            typer.echo(f"line {cut} was cut off and is left out")
        for m in mismatches:
            typer.echo(
                f"{file}:{m.line}: {m.column} is {m.recorded or 'empty'}, the law gives {m.computed or 'nothing'}"
            )
        if count > len(mismatches):
            typer.echo(f"… and {count - len(mismatches):,} more cells")
        verdict = f"{count:,} cell{'s differ' if count > 1 else ' differs'}" if count else "all bit-identical"
        typer.echo(f"{trace.head.vehicle}: {steps:,} steps, {verdict}" if steps else "nothing of ours to run again")
        return Exit.FAILED if count else Exit.DONE

    run_offline(command)


def _given(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _flat(gains: Mapping[str, Any]) -> dict[str, Any]:
    """{"xy": {"vel_p": 1}, "hover_thrust": 2} as {"xy.vel_p": 1, "hover_thrust": 2}."""
    flat: dict[str, Any] = {}
    for key, value in gains.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{name}": number for name, number in value.items()}
        else:
            flat[key] = value
    return flat


def _show_gains(gains: Mapping[str, Mapping[str, Any]], json_output: bool) -> None:
    if json_output:
        typer.echo(json.dumps({"gains": gains}, indent=2))
        return
    from rich.table import Table
    from rich.text import Text

    flats = {name: _flat(of_one) for name, of_one in gains.items()}
    keys = list(dict.fromkeys(key for flat in flats.values() for key in flat))
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("gain", no_wrap=True)
    for name in flats:
        table.add_column(Text(name), justify="right", no_wrap=True)
    for key in keys:
        table.add_row(key, *(render.plain(flat.get(key)) for flat in flats.values()))
    render.console().print(table)


def _gain_changes(before: Mapping[str, Mapping[str, Any]], after: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """ "alpha: xy.vel_p 0.08 -> 0.1" for all that changed."""
    lines = []
    for name, gains in after.items():
        old, new = _flat(before.get(name, {})), _flat(gains)
        changed = [f"{k} {render.plain(old.get(k))} -> {render.plain(v)}" for k, v in new.items() if v != old.get(k)]
        if changed:
            lines.append(f"{name}: {', '.join(changed)}")
    return lines
