"""Commands about what goes over the wire: messages and links."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Any, NoReturn

import typer

from skygcs.cli import completion, render
from skygcs.cli.connection import Exit, fail, run, waiting
from skygcs.cli.options import ComponentTargets, Json, LinkName, MessageName
from skygcs.cli.orders import tell_outcomes
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite, name_or_id, parse_link, parse_pairs
from skygcs.errors import RpcError
from skygcs.rpc.client import Client

messages = typer.Typer(help="Watch, send and look up any message of the dialect.", no_args_is_help=True)
links = typer.Typer(help="List, add, change and remove links.", invoke_without_command=True)


@messages.command("watch")
def watch_messages(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME …]", help="Names or ids; none: all.", autocompletion=completion.messages),
    ] = None,
    targets: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="TARGETS",
            help="Only from these vehicles, all components of each, or from components: 7/191, alpha/191.",
            autocompletion=completion.targets,
        ),
    ] = "all",
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="At most so many of each name and source.", parser=finite),
    ] = None,
    count: Annotated[int, typer.Option("--count", metavar="N", help="End after so many.", min=1)] = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Print messages as they come, until Ctrl-C."""
    wanted = [name_or_id(name) for name in names or ()]

    async def command(gcs: Client) -> None:
        seen = 0
        async for message in gcs.messages(*wanted, targets=targets, rate_hz=rate_hz):
            typer.echo(json.dumps(message) if json_output else render.message_line(message))
            sys.stdout.flush()
            seen += 1
            if seen >= count:
                return

    run(command)


@messages.command("send", cls=NumbersCommand, context_settings=dict(NUMBERS))
def send_message(
    name: MessageName,
    fields: Annotated[list[str] | None, typer.Argument(metavar="[FIELD=VALUE …]", help="Others are 0.")] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="TARGETS",
            help="Vehicles, components (7/191), all; needed if the message has a target field.",
            autocompletion=completion.targets,
        ),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(
            "--link", metavar="LINK", help="On this link only, to all there.", autocompletion=completion.links
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Without the checks of the order that does the same.")] = False,
    json_output: Json = False,
) -> None:
    """Send one message: `message send UTIAS quat=1,0,0,0 pos=0,0,1.5`. Enum names are values, too.

    A message with a target field needs --to TARGETS, --link LINK, or that field (0: everyone).
    """
    values = parse_pairs(fields or [])
    if target is not None and link is not None:
        raise typer.BadParameter("give either --to or --link, not both")

    async def command(gcs: Client) -> int:
        try:
            answer = await gcs.call(
                "messages.send", name=name_or_id(name), fields=values, target=target, link=link, force=force
            )
        except RpcError as error:
            if target is not None or not _lacks_target(error):
                raise
            fail(
                f"{name.upper()} is addressed: give --to TARGETS (--to all: everyone), --link LINK, or its target field"
            )
            return Exit.USAGE
        if json_output:
            typer.echo(json.dumps(answer, indent=2))
        elif answer["sent"]:
            typer.echo(f"sent {answer['message']}" + (f" {answer['sent']} times" if answer["sent"] > 1 else ""))
        else:
            typer.echo(f"{answer['message']} was not sent: the link has nobody to send it to", err=True)
        if answer.get("note") and not json_output:
            fail(answer["note"])
        return Exit.DONE if answer["sent"] else Exit.FAILED

    run(command)


def _lacks_target(error: RpcError) -> bool:
    problems = error.data.get("problems", ()) if isinstance(error.data, dict) else ()
    return any(problem["param"] == "target" for problem in problems)


@messages.command("last")
def last_message(
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET", help="One vehicle, or one component: 7/191, alpha/191.", autocompletion=completion.targets
        ),
    ],
    name: MessageName,
    json_output: Json = False,
) -> None:
    """Show the last message of one name from one vehicle: its autopilot's, else that of another of its components."""

    async def command(gcs: Client) -> int:
        answer = await gcs.call("messages.latest", target=target, name=name_or_id(name))
        if json_output:
            typer.echo(json.dumps(answer, indent=2))
        elif answer is not None:
            typer.echo(
                f"{answer['name']} of {answer['sysid']}/{answer['compid']}, {render.duration(answer['age_s'])} ago"
            )
            for field, value in answer["fields"].items():
                typer.echo(f"  {field:<24} {json.dumps(value)}")
        else:
            typer.echo(f"{target} has not sent {name} yet", err=True)
        return answer is None

    run(command)


@messages.command("request")
def request_message(targets: ComponentTargets, name: MessageName, json_output: Json = False) -> None:
    """Ask for one message once, and show it: `message request all AUTOPILOT_VERSION`."""

    async def command(gcs: Client) -> int:
        asked = name_or_id(name)
        async with waiting(f"message request {targets}"):
            answer = await gcs.call("vehicles.request", targets=targets, message=asked)
        outcomes = answer["outcomes"]
        message_cache = {
            who: await gcs.call("messages.latest", target=who, name=asked) for who, o in outcomes.items() if o["ok"]
        }
        if json_output:
            typer.echo(json.dumps({"outcomes": outcomes, "messages": message_cache}, indent=2))
            return Exit.DONE if all(o["ok"] for o in outcomes.values()) else Exit.FAILED
        code = tell_outcomes(outcomes, False)
        for who, reading in message_cache.items():
            if reading is not None:
                typer.echo(render.message_line({**reading, "source": who}))
        return code

    run(command)


@messages.command("list")
def list_messages(
    part: Annotated[str, typer.Argument(metavar="[PART]", help="Only names with this in them.")] = "",
    json_output: Json = False,
) -> None:
    """List the dialect's messages and their fields."""

    async def command(gcs: Client) -> None:
        found = [m for m in await gcs.call("messages.list") if part.upper() in m["name"].upper()]
        if json_output:
            typer.echo(json.dumps(found, indent=2))
            return
        if not found:
            typer.echo(f"no message of the dialect has {part!r} in its name")
        for message in found:
            fields = ", ".join(f"{f['name']} {f['type']}" for f in message["fields"])
            typer.echo(f"{message['id']:>5} {message['name']}: {fields}")

    run(command)


@links.callback()
def links_default(ctx: typer.Context, json_output: Json = False) -> None:
    """List, add, change and remove links; alone it lists them."""
    if ctx.invoked_subcommand is None:
        _links("links.list", json_output)


@links.command("list")
def list_links(json_output: Json = False) -> None:
    """Show every link and channel with its counters."""
    _links("links.list", json_output)


PAIRS = Annotated[
    list[str],
    typer.Argument(
        metavar="KEY=VALUE …",
        help="As in the fleet file: type=udp_server port=14550 allow_msg_id_in=HEARTBEAT,ATTITUDE.",
    ),
]


@links.command("add")
def add_link(name: LinkName, pairs: PAIRS, json_output: Json = False) -> None:
    """Add a link until the daemon ends: `links add qgc type=udp_client host=10.0.0.5 port=14550`."""
    _links("links.add", json_output, name=name, link=parse_link(pairs))


@links.command("change")
def change_link(name: LinkName, pairs: PAIRS, json_output: Json = False) -> None:
    """Close a link and open it again with these keys changed."""
    _links("links.change", json_output, name=name, link=parse_link(pairs))


@links.command("remove")
def remove_link(name: LinkName, json_output: Json = False) -> None:
    """Close a link and forget it."""
    _links("links.remove", json_output, name=name)


def _links(method: str, json_output: bool, **params: Any) -> NoReturn:
    async def command(gcs: Client) -> None:
        answer = await gcs.call(method, **params)
        if json_output:
            typer.echo(json.dumps(answer, indent=2))
        elif answer:
            screen = render.console()
            screen.print(render.links_table(answer, screen.width))
            for row in answer:
                if row.get("warning") and params.get("name") in (None, row["name"]):
                    typer.echo(f"warning: {row['name']}: {row['warning']}", err=True)
        else:
            typer.echo("no links; add one: skygcs-cli links add NAME type=udp_server port=14550")

    run(command)
