"""`skygcs-cli link`: what a radio carries now, and `plan`: what one can carry, worked out without it or a daemon."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from skygcs.cli import link_screen
from skygcs.cli.connection import Exit, run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite

if TYPE_CHECKING:  # every command line registers every command: what only this one needs is imported when it runs
    from skygcs.core.radio_link.capacity import LinkPlan

link = typer.Typer(help="The shared radio: what it carries, what it can carry.", invoke_without_command=True)
link.command("status")(link_screen.status)
link.command("select")(link_screen.select)


@link.callback()
def _link(ctx: typer.Context) -> None:
    """Without a command: `link status`, live on a terminal."""
    if ctx.invoked_subcommand is None:
        link_screen.status(follow=sys.stdout.isatty(), every_s=1.0, json_output=False)


@link.command("plan")
def plan(
    vehicles: Annotated[int, typer.Argument(metavar="VEHICLES", min=1, max=254, help="Behind this radio.")],
    baud: Annotated[int, typer.Option("--baud", metavar="RATE", min=300, help="Of the ground's serial port.")] = 57600,
    air_kbps: Annotated[
        str, typer.Option("--air-speed", metavar="KBPS", help="Of a multipoint radio; none: no timeslots.")
    ] = "64",
    profile: Annotated[
        str, typer.Option("--profile", help="monitor, nav, control, control-10, full, or custom.")
    ] = "nav",
    rates: Annotated[
        list[str] | None,
        typer.Option("--rate", metavar="MESSAGE=HZ", help="Changes the profile; its own set: --profile custom."),
    ] = None,
    setpoint: Annotated[
        str, typer.Option("--setpoints", help="Streamed to every vehicle: none, position, velocity, attitude.")
    ] = "none",
    setpoint_hz: Annotated[float, typer.Option("--setpoint-rate", metavar="HZ", parser=finite)] = 2.0,
    fill: Annotated[
        float, typer.Option("--fill", metavar="SHARE", parser=finite, help="Of each way that may be planned with.")
    ] = 0.5,
    json_output: Json = False,
) -> None:
    """Tell whether a number of vehicles fits on a radio, what each gets, and what would fit. Exit 1 if it does not."""
    from skygcs.core.radio_link.capacity import SETPOINTS, LinkDemand, plan_link

    demand = LinkDemand(
        vehicles,
        baud,
        _air(air_kbps),
        profile,
        _rates(profile, rates or []),
        _one_of("--setpoints", setpoint, SETPOINTS),
        _within("--setpoint-rate", setpoint_hz, 0.1, 100) if setpoint != "none" else 0.0,
        _within("--fill", fill, 0.05, 1),
    )

    def command() -> int:
        answer = plan_link(demand)
        if json_output:
            typer.echo(json.dumps(_as_json(answer), indent=2))
        else:
            _show(answer)
        return Exit.DONE if answer.fits else Exit.FAILED

    run_offline(command)


def _show(answer: LinkPlan) -> None:
    demand = answer.demand
    air = "no timeslots" if demand.air_kbps is None else f"{demand.air_kbps:g} kbit/s air"
    streamed = f", {demand.setpoint} setpoints at {demand.setpoint_hz:g} Hz" if demand.setpoint != "none" else ""
    typer.echo(f"{demand.vehicles} vehicles, {demand.baud} baud, {air}, profile {demand.profile}{streamed}")
    typer.echo(
        f"one vehicle: {demand.down_per_vehicle_bytes_per_s:,.1f} B/s down, {demand.up_per_vehicle_bytes_per_s:,.1f} up"
    )
    if answer.round_s is not None:
        typer.echo(f"a round of {demand.nodes} nodes: {answer.round_s * 1000:,.0f} ms (open SiK's timeslots)")
    typer.echo(f"\n{'':<24}{'needed':>10}{'carries':>10}{'planned':>10}{'share':>8}")
    for direction in answer.directions:
        mark = "" if direction.fits else "  too much"
        typer.echo(
            f"{direction.name:<24}{direction.needed:>10,.0f}{direction.capacity:>10,.0f}{direction.usable:>10,.0f}{direction.share:>8.0%}{mark}"
        )
    typer.echo("")
    for problem in answer.problems:
        typer.echo(f"does not fit: {problem}")
    gets = ", ".join(f"{name} {rate:.2g}" for name, rate in answer.rates_hz.items())
    typer.echo(f"each vehicle {'gets' if answer.fits else 'would get'} (Hz): {gets}")
    if demand.setpoint != "none":
        typer.echo(f"setpoints: {answer.setpoint_hz:.2g} Hz each")
    typer.echo(f"vehicles that fit like this: {answer.most_vehicles}")
    for proposal in answer.proposals:
        typer.echo(f"would fit: {proposal}")


def _as_json(answer: LinkPlan) -> dict[str, object]:
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
        "ways": [
            {**asdict(direction), "share": direction.share, "fits": direction.fits} for direction in answer.directions
        ],
        "most_vehicles": answer.most_vehicles,
        "rates_hz": dict(answer.rates_hz),
        "setpoint_hz": answer.setpoint_hz,
        "problems": answer.problems,
        "proposals": answer.proposals,
    }


def _air(text: str) -> float | None:
    return None if text.lower() == "none" else _within("--air-speed", finite(text), 1, 1000)


def _rates(profile: str, changes: list[str]) -> dict[str, float]:
    from skygcs.core.radio_link.capacity import FRAME_BYTES, PROFILES

    rates = {"HEARTBEAT": 1.0} if profile == "custom" else dict(PROFILES[_one_of("--profile", profile, PROFILES)])
    for pair in changes:
        name, equals, text = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"--rate: {pair!r} is not of the form MESSAGE=HZ")
        rates[_one_of("--rate", name.upper(), FRAME_BYTES)] = _within("--rate", finite(text), 0, 400)
    return rates


def _one_of(option: str, name: str, known: Iterable[str]) -> str:
    names = list(known)
    if name not in names:
        raise typer.BadParameter(f"{option}: {name!r} is none of {', '.join(names)}")
    return name


def _within(option: str, value: float, least: float, most: float) -> float:
    if not least <= value <= most:
        raise typer.BadParameter(f"{option}: {value:g} is not within {least:g} to {most:g}")
    return value
