"""`skygcs-cli federation`: other sites, as the station's bridge knows them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Any

import typer

from skygcs.cli.connection import USAGE_ERRORS, Exit, run, show
from skygcs.cli.options import Json
from skygcs.cli.render import duration, fixed, plural
from skygcs.errors import RpcError, SkygcsError
from skygcs.ext.federation.log_commands import logs
from skygcs.rpc.client import Client
from skygcs.rpc.error_codes import METHOD_NOT_FOUND

federation = typer.Typer(
    name="federation",
    no_args_is_help=True,
    help="Other sites and their vehicles, through the station's bridge (`skygcs federation run`).",
)


@federation.command()
def sites(json_output: Json = False) -> None:
    """Show this station's connection to the hub, the other sites and the leases.

    Example: skygcs-cli federation sites
    """

    async def command(gcs: Client) -> None:
        answer = await gcs.call("federation.sites")
        answer["leases"] = await _leases(gcs)
        show(answer, json_output, _site_lines)

    run(command, station=True)


async def _leases(gcs: Client) -> list[dict[str, Any]]:
    """Leases of the vehicles that need one; none at a station that is no site."""
    try:
        found: list[dict[str, Any]] = await gcs.call("federation.leases")
    except RpcError as error:
        if error.code not in USAGE_ERRORS:
            raise
        return []
    return found


def _site_lines(answer: dict[str, Any]) -> Iterator[str]:
    """federation.sites for a person."""
    hub = answer["hub"]
    who = f"site {answer['site']}" if answer["site"] else f"{answer['role']} {answer['station']}"
    if hub["connected"]:
        trip = "" if hub["round_trip_s"] is None else f", {1000 * hub['round_trip_s']:.0f} ms there and back"
        yield f"{who}  {hub['text']} for {duration(hub['since_s'])}{trip}"
    else:
        yield f"{who}  HUB AWAY for {duration(hub['since_s'])}: {hub['text']}"
    if hub["denied"]:
        yield f"  the hub has refused {plural(hub['denied'], 'message')} that its inventory does not permit"
    yield from _bridge_lines(answer)
    if not answer["sites"]:
        yield "no other site was heard"
    for site in answer["sites"]:
        yield from _one_site_lines(site)
    for lease in answer["leases"]:
        yield _lease_line(lease)
    for conflict in answer["conflicts"]:
        ours, other = conflict["vehicles"]
        yield f"{conflict['level'].upper()}  {ours} and {other}: {_approach(conflict)}"


def _bridge_lines(answer: dict[str, Any]) -> Iterator[str]:
    """Another bridge of this site."""
    bridge = answer["bridge"]
    other = None if bridge is None else bridge["other"]
    if other is not None:
        who = f"ANOTHER BRIDGE runs as {answer['site']} (host {other['host']}, process {other['pid']})"
        end = "end one of the two, or give its computer a site name and key of its own"
        does = "this one stands by" if bridge["state"] == "standby" else f"this one is {bridge['state']}"
        yield f"  {who}; {does}: {end}"
    elif answer["contested"]:
        yield f"  ANOTHER BRIDGE sends as {answer['site']}: end one of the two"


def _one_site_lines(site: dict[str, Any]) -> Iterator[str]:
    vehicles = site["vehicles"]
    age = "age unknown" if site["age_s"] is None else f"{site['age_s']:.1f} s old"
    heard = f"SILENT, {age}" if site["silent"] else age
    clock = "clock unknown" if site["clock"] is None else f"clock within {1000 * site['clock']['error_s']:.0f} ms"
    oldest = "" if vehicles["oldest_age_s"] is None else f", the oldest {vehicles['oldest_age_s']:.1f} s"
    yield (
        f"{site['site']}  {heard}, {clock}  {plural(vehicles['count'], 'vehicle')}: {vehicles['heard']} heard, "
        f"{vehicles['armed']} armed, {vehicles['in_the_air']} in the air, {vehicles['problems']} with a problem{oldest}"
    )
    batches = site["batches"]
    if batches["lost"] or site["restarts"]:
        of = batches["taken"] + batches["lost"]
        yield f"    {batches['lost']} of {of} batches lost, {plural(site['restarts'], 'restart')} of its bridge"
    if not site["daemon"]:
        yield "    ITS DAEMON IS AWAY: what is shown of its vehicles is old"
    if site["contested"]:
        yield "    TWO BRIDGES send under this name: what is shown may be of either"


def _lease_line(lease: dict[str, Any]) -> str:
    holder = lease["holder"] or "nobody"
    mine = f" (for {lease['remaining_s']:.1f} s more)" if lease["held"] else ""
    return f"{lease['vehicle']}  home {lease['home']}, commanded by {holder}{mine}, {lease['state']}"


def _approach(conflict: dict[str, Any]) -> str:
    closest, when = conflict.get("closest_m"), conflict.get("closest_in_s")
    if closest is None:
        return "no prediction"
    return f"{fixed(closest, 1, ' m')} in {fixed(when, 0, ' s')}"


@federation.command()
def outcome(
    ident: Annotated[
        str, typer.Argument(metavar="ID", help="Of the order, as it was shown: SITE/32 digits.", show_default=False)
    ],
    json_output: Json = False,
) -> None:
    """Ask what became of an order whose outcome is unknown. Exit 0: it was carried out.

    One that has not reached its site by now is refused if it arrives later.

    Example: skygcs-cli federation outcome south/9c6af8408d0890231e0ad1171ed7a477
    """

    async def command(gcs: Client) -> int:
        answer = await gcs.call("federation.outcome", id=ident)
        show(answer, json_output, _outcome_lines)
        return Exit.DONE if answer["status"] == "done" else Exit.FAILED

    run(command, station=True)


def _outcome_lines(answer: dict[str, Any]) -> Iterable[str]:
    order = f"{answer['method']} of {answer['vehicle']}" if answer["vehicle"] else answer["id"]
    yield f"{order}: {answer['status']}" + (f": {answer['text']}" if answer["text"] else "")
    for text in (answer["outcome"] or {}).get("status_texts", ()):
        yield f"  {text}"


Vehicle = Annotated[
    str,
    typer.Argument(
        metavar="VEHICLE", help='One that "federation.vehicles" of the fleet file names.', show_default=False
    ),
]


@federation.command()
def take(
    vehicle: Vehicle,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Although its holder is busy with it, or its home may go on commanding it without the hub.",
        ),
    ] = False,
    without_hub: Annotated[
        bool,
        typer.Option(
            "--without-hub",
            help="At its home, with --force, while the hub is away: you know that no other site commands it.",
        ),
    ] = False,
    json_output: Json = False,
) -> None:
    """Command a vehicle from this site: ask its holder for the lease, or take it when it is free.

    Example: skygcs-cli federation take south/bravo
    """

    async def command(gcs: Client) -> None:
        answer = await _lease_call(gcs, "federation.take", vehicle=vehicle, force=force, without_hub=without_hub)
        show(answer, json_output, lambda lease: [_lease_line(lease)])

    run(command, station=True)


@federation.command()
def release(vehicle: Vehicle, json_output: Json = False) -> None:
    """Give a vehicle's lease up, for another site to take. Control from here ends without an order to the vehicle.

    Example: skygcs-cli federation release south/bravo
    """

    async def command(gcs: Client) -> None:
        answer = await _lease_call(gcs, "federation.release", vehicle=vehicle)
        show(answer, json_output, lambda lease: [_lease_line(lease)])

    run(command, station=True)


async def _lease_call(gcs: Client, method: str, **params: Any) -> Any:
    """Raises SkygcsError at a station that has no leases, and so no such method."""
    try:
        return await gcs.call(method, **params)
    except RpcError as error:
        if error.code != METHOD_NOT_FOUND:
            raise
        text = "this station has no leases: they are for sites whose fleet file has [federation.vehicles]"
        raise SkygcsError(f"{text}; docs/explanation/federation.md") from None


federation.command()(logs)


def add_to(app: typer.Typer) -> None:
    app.add_typer(federation, name="federation")
