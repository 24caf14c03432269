"""`skygcs-cli setpoint`: streams setpoints to controlled vehicles, its own or those of the user's program."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run
from skygcs.cli.options import Json, Targets
from skygcs.cli.parsing import finite, parse_unset_number
from skygcs.errors import DaemonUnreachable
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from skygcs.cli.setpoint_stream import Tally

DEFAULT_HZ = 10.0
LEAST_HZ = 0.2
"""One in LARGEST_VALID_S."""

LARGEST_HZ = 100.0
"""More than twice the default rate of the control loop: what is faster is not flown."""

VALID_S = 0.5
"""How long a setpoint is good, unless the rate is so low that it would run out between two."""

LARGEST_VALID_S = 5.0


def setpoint(
    targets: Targets,
    position: Annotated[
        tuple[str, str, str] | None,
        typer.Option("--pos", metavar="X Y Z", help="Metres in the fleet's frame; -: not given.", show_default=False),
    ] = None,
    velocity: Annotated[
        tuple[str, str, str] | None,
        typer.Option(
            "--vel", metavar="X Y Z", help="m/s; for an axis with a position it is feed-forward.", show_default=False
        ),
    ] = None,
    yaw: Annotated[
        float | None,
        typer.Option("--yaw", metavar="DEG", help="From the frame's x axis, counter-clockwise.", parser=finite),
    ] = None,
    duration_s: Annotated[
        float | None,
        typer.Option("--for", metavar="S", help="End after so many seconds; else at Ctrl-C.", parser=finite),
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="HZ",
            help="Setpoints per second, default 10. With --stdin: lines per second.",
            parser=finite,
        ),
    ] = None,
    stdin: Annotated[
        bool, typer.Option("--stdin", help="Take them from standard input: JSON lines or CSV, the newest each time.")
    ] = False,
    valid_s: Annotated[
        float | None,
        typer.Option(
            "--valid", metavar="S", help="Each is good so long, then the vehicle stays where it is.", parser=finite
        ),
    ] = None,
    json_output: Json = False,
) -> None:
    """Stream setpoints to vehicles under `control`: `setpoint alpha --pos 5 -3 10 --for 20`.

    From your own program: `./my-planner | skygcs-cli setpoint alpha --stdin`, a line each: {"pos": [5, -3, 10]} or
    5,-3,10. `--vel 1 0 - --pos - - 10`: level flight. When the setpoints end, vehicles stay where they then are.
    """
    given = _given(position, velocity, yaw)
    if stdin and (given or duration_s is not None):
        raise typer.BadParameter("--stdin brings the setpoints itself: give no --pos, --vel, --yaw or --for with it")
    if not stdin:
        from skygcs.cli.setpoint_lines import LineError, checked

        try:
            given = checked(given)
        except LineError as error:
            raise typer.BadParameter(f"{error}: give --pos X Y Z, --vel X Y Z, or --stdin") from None
    _check("--rate", rate_hz, LEAST_HZ, LARGEST_HZ)
    _check("--for", duration_s, 0.0, 86400.0)
    _check("--valid", valid_s, 0.1, LARGEST_VALID_S)
    rate = DEFAULT_HZ if rate_hz is None and not stdin else rate_hz
    if valid_s is None:
        valid_s = VALID_S if rate is None else min(max(VALID_S, 2.5 / rate), LARGEST_VALID_S)
    if rate is not None and valid_s * rate < 1:
        raise typer.BadParameter(f"--valid {valid_s:g} s ends before the next one comes at {rate:g} Hz")
    good_for_s = valid_s

    async def command(gcs: Client) -> int:
        from skygcs.cli.setpoint_stream import Sender, bytes_of, forward, repeat

        sender = Sender(gcs, good_for_s, fail)
        tally = sender.tally
        if not stdin and sys.stderr.isatty():
            typer.echo(f"streaming to {targets} at {rate:g} Hz; Ctrl-C ends it", err=True)
        clock = asyncio.get_running_loop().time
        began = clock()
        after = f"from {good_for_s:g} s after the last one on, still under control"
        try:
            if stdin:
                await forward(sender, targets, bytes_of(sys.stdin.fileno()), rate)
            else:
                assert rate is not None
                await repeat(sender, targets, given, rate, duration_s)
        except DaemonUnreachable:
            after = "only if its autopilot's failsafe does so: nobody sends setpoints any more"
            raise
        finally:
            _tell_end(tally, clock() - began, after, json_output)
        return Exit.DONE if tally.ok else Exit.FAILED

    run(command)


def _given(
    position: tuple[str, str, str] | None, velocity: tuple[str, str, str] | None, yaw: float | None
) -> dict[str, Any]:
    """As control.setpoint takes it. Raises BadParameter."""
    given: dict[str, Any] = {}
    for option, parameter, vector in (("--pos", "pos_enu_m", position), ("--vel", "vel_enu_mps", velocity)):
        if vector is not None:
            given[parameter] = [parse_unset_number(value, option) for value in vector]
    return given if yaw is None else {**given, "yaw_deg": yaw}


def _tell_end(tally: Tally, elapsed_s: float, after: str, json_output: bool) -> None:
    """What was sent, and what the vehicles do now; also after Ctrl-C and when the daemon went away."""
    took = [name for name, outcome in tally.outcomes.items() if outcome["ok"]]
    if json_output:
        answer = {
            "sent": tally.sent,
            "refused_by_all": tally.no_taker,
            "skipped": tally.skipped,
            "wrong_lines": tally.wrong_lines,
            "elapsed_s": round(elapsed_s, 3),
            "outcomes": tally.outcomes,
        }
        typer.echo(json.dumps(answer, indent=2))
        return
    further = (
        ("refused by all", tally.no_taker),
        ("skipped for newer ones", tally.skipped),
        ("wrong lines", tally.wrong_lines),
    )
    counts = "".join(f", {what}: {count:,}" for what, count in further if count)
    count = tally.sent - tally.no_taker
    typer.echo(f"{count or 'no'} setpoint{'s' if count != 1 else ''} in {elapsed_s:.1f} s{counts}")
    if took:
        stay = "stays where it is" if len(took) == 1 else "stay where they are"
        typer.echo(f"{', '.join(took)} {stay} {after}")


def _check(option: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:
        raise typer.BadParameter(f"{option}: {value:g} is not between {least:g} and {most:g}")


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Orders")(setpoint)
