"""`skygcs-cli preflight`: whether vehicles are ready to fly, what is wrong with them and how to put it right."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run, waiting
from skygcs.cli.options import Json, OptionalTargets
from skygcs.cli.render import screen_width
from skygcs.rpc.client import Client

REBOOT_HINT = "some take effect after a reboot only; preflight is to be run again then"


def preflight(
    targets: OptionalTargets = "all",
    fix: Annotated[bool, typer.Option("--fix", help="Set the parameters that would put something right.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="With --fix: do not ask.")] = False,
    everything: Annotated[
        bool, typer.Option("--all", "-a", help="Show also what passed, and what was skipped.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Tell whether vehicles are ready to fly; exit 0 if all of them are.

    What is expected of them is in the fleet file ([types.NAME.preflight]). --fix tells what it would set, asks, sets
    it, reads it back and looks again.
    """
    if fix and json_output and not yes:
        raise typer.BadParameter("--fix asks before it sets anything: with --json give --yes, too")

    async def command(gcs: Client) -> int:
        from skygcs.cli import preflight_lines

        async with waiting(f"preflight {targets}"):
            answer = await gcs.call("preflight.run", targets=targets)
        if fix and _agreed(answer["vehicles"], yes=yes, quiet=json_output):
            confirmed = preflight_lines.planned(answer["vehicles"])
            async with waiting(f"preflight {targets}"):
                answer = await gcs.call("preflight.run", targets=targets, fix=True, confirmed=confirmed)
            if not json_output:
                _tell_fixed(answer["vehicles"])
        if json_output:
            typer.echo(json.dumps(answer, indent=2))
        else:
            for line in preflight_lines.report_lines(
                answer["vehicles"], screen_width(sys.stdout), everything=everything
            ):
                typer.echo(line)
        return Exit.DONE if answer["ok"] else Exit.FAILED

    run(command)


def _agreed(vehicles: Mapping[str, Any], *, yes: bool, quiet: bool) -> bool:
    """Whether to set what would put something right: the plan is told, then asked for."""
    from skygcs.cli import preflight_lines

    plan = list(preflight_lines.plan_lines(vehicles))
    if not plan:
        if not quiet:
            typer.echo("no parameter would put anything right")
        return False
    if not quiet:
        typer.echo("to be set:")
        for line in plan:
            typer.echo(line)
    if yes:
        return True
    if not sys.stdin.isatty():
        fail("nothing was set: there is nobody to ask; --yes sets it")
        return False
    return typer.confirm(f"Set {'this parameter' if len(plan) == 1 else f'these {len(plan)} parameters'}?")


def _tell_fixed(vehicles: Mapping[str, Any]) -> None:
    from skygcs.cli import param_lines

    told = {name: report["fixed"] for name, report in vehicles.items() if report["fixed"]}
    for line in param_lines.outcomes(told):
        typer.echo(line)
    if told:
        typer.echo(REBOOT_HINT)


def add_to(app: typer.Typer) -> None:
    app.command(rich_help_panel="Looking")(preflight)
