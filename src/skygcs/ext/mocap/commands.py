"""`skygcs-cli mocap`: poses of a motion capture system, and recordings of them."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import typer

from skygcs.cli.connection import fail, run_show
from skygcs.cli.options import Json
from skygcs.cli.render import fixed, plural, say
from skygcs.ext.mocap.recording import CaptureState, parse_line
from skygcs.ext.mocap.source import SYSTEMS

app = typer.Typer(help="Show the poses of a motion capture system, or record them.", no_args_is_help=True)


READ_BYTES = 65536


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show the system and the poses of each vehicle: rate, latency, drop-outs, what is wrong.

    Example: skygcs-cli mocap status
    """
    run_show("mocap.status", json_output, status_lines)


def status_lines(state: Mapping[str, Any]) -> Iterator[str]:
    """The answer of mocap.status for a person."""
    text = f"  {state['text']}" if state["text"] else ""
    yield f"{state['type']}  {state['state']}{text}"
    yield f"{plural(state['frames'], 'frame')}, {plural(state['restarts'], 'restart')}, as {state['message'].upper()}"
    for vehicle in state["vehicles"]:
        yield from _vehicle_lines(vehicle)
    named = {vehicle["body"] for vehicle in state["vehicles"]}
    if others := [body for body in state["bodies_seen"] if body not in named]:
        yield f"other rigid bodies: {', '.join(others)}"


def _vehicle_lines(v: Mapping[str, Any]) -> Iterator[str]:
    where = v["link"] or "-"
    if v["age_s"] is None:
        yield f"{v['vehicle']}  body {v['body']}  no pose yet  link {where}"
    else:
        seen = "tracking" if v["tracking"] else "LOST"
        yield (
            f"{v['vehicle']}  body {v['body']}  {seen}  age {fixed(v['age_s'], 2)} s  "
            f"{fixed(v['rate_hz'], 0)} Hz in, {fixed(v['sent_hz'], 0)} of {fixed(v['limit_hz'], 0)} Hz sent  "
            f"latency {_ms(v['latency_p50_s'])}, at most {_ms(v['latency_max_s'])}  link {where}"
        )
        rejected = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in v["rejected"].items() if count)
        yield (
            f"    {plural(v['dropouts'], 'drop-out')}, the longest {fixed(v['longest_dropout_s'], 1)} s; "
            f"not sent: {rejected or 'none'}"
        )
    if v["problem"]:
        yield f"    {v['problem']}"


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1000 * seconds:.0f} ms"


@app.command("record")
def record(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="JSON lines; for type recorded of [mocap].")],
    system: Annotated[str, typer.Option("--type", metavar="TYPE", help="vicon, optitrack, qualisys or vrpn.")],
    host: Annotated[str, typer.Option("--host", metavar="HOST", help="The computer with the capture software.")],
    port: Annotated[int | None, typer.Option("--port", min=1, max=65535, help="If it is not the system's own.")] = None,
    body: Annotated[
        list[str] | None, typer.Option("--body", metavar="NAME", help="Only this rigid body; may be given again.")
    ] = None,
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.1, help="Stop after S seconds.")] = None,
) -> None:
    """Record frames of a motion capture system, without a daemon; Ctrl-C ends the recording.

    Example: skygcs-cli mocap record flight.jsonl --type vicon --host 192.168.10.1 --seconds 60
    """
    if system not in SYSTEMS:
        raise typer.BadParameter(f"{system}: one of {', '.join(SYSTEMS)}", param_hint="--type")
    line = [sys.executable, "-P", "-m", "skygcs.ext.mocap.worker", "--system", system, "--host", host]
    line += [] if port is None else ["--port", str(port)]
    line += [f"--body={name}" for name in body or ()]
    try:
        with file.open("xb") as out:
            raise typer.Exit(_record(line, out, seconds))
    except FileExistsError:
        fail(f"{file} exists already: give another name")
    except OSError as error:
        fail(f"{file}: {error.strerror or error}")
    raise typer.Exit(1)


def _record(line: list[str], out: BinaryIO, seconds: float | None) -> int:
    """Write the frames of a capture process to a file; the exit code."""
    # start the process of the capture system
    deadline = None if seconds is None else time.monotonic() + seconds
    frames, failed, rest = 0, False, b""
    process = subprocess.Popen(line, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    assert process.stdout is not None
    # write each frame until the time is over or the process ends
    try:
        while deadline is None or time.monotonic() < deadline:
            if not select.select([process.stdout], [], [], 0.1)[0]:
                continue
            part = os.read(process.stdout.fileno(), READ_BYTES)
            if not part:
                break
            *lines, rest = (rest + part).split(b"\n")
            for one in lines:
                said = parse_line(one)
                if isinstance(said, CaptureState):
                    failed = said.state == "failed"
                    say(f"{said.state}: {said.text}", err=True)
                elif said is not None:
                    out.write(one + b"\n")
                    frames += 1
    except KeyboardInterrupt:
        pass
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    # report
    say(f"{plural(frames, 'frame')} recorded")
    return 1 if failed or not frames else 0


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="mocap")
