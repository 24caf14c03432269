"""`skygcs-cli message`: watch, send, request and look up any message of the dialect."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, exit_code, fail, print_outcomes, run, show, waiting
from skygcs.cli.options import ComponentTargets, Json, MessageName, complete_links, complete_messages, complete_targets
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite, name_or_id, parse_pairs
from skygcs.cli.render import duration, plain, print_json, say
from skygcs.errors import RpcError
from skygcs.rpc.client import Client

messages = typer.Typer(help="Watch, send and look up any message of the dialect.", no_args_is_help=True)


def message_line(message: Mapping[str, Any]) -> str:
    """Source, name and every field of one message."""
    source = message.get("source") or f"{message.get('sysid')}/{message.get('compid')}"
    fields = " ".join(f"{k}={plain(v)}" for k, v in message["fields"].items())
    lost = f"  [{message['dropped']} lost before this one]" if message.get("dropped") else ""
    return f"{source} {message['name']} {fields}{lost}"


@messages.command("watch")
def watch_messages(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME …", help="Names or ids; without: all.", autocompletion=complete_messages),
    ] = None,
    targets: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="TARGETS",
            help="Only from these vehicles, all components of each, or from components: 7/191, alpha/191.",
            autocompletion=complete_targets,
        ),
    ] = "all",
    rate_hz: Annotated[
        float | None,
        typer.Option("--rate", metavar="HZ", help="Per second, of each name and source, at most.", parser=finite),
    ] = None,
    count: Annotated[
        int, typer.Option("--count", metavar="N", help="End after N messages.", min=1, show_default=False)
    ] = sys.maxsize,
    json_output: Json = False,
) -> None:
    """Print messages as they arrive, until Ctrl-C.

    Example: skygcs-cli message watch ATTITUDE --from alpha --count 3
    """
    wanted = [name_or_id(name) for name in names or ()]

    async def command(gcs: Client) -> None:
        seen = 0
        async for message in gcs.messages(*wanted, targets=targets, rate_hz=rate_hz):
            if json_output:
                print_json(message, line=True)
            else:
                say(message_line(message))
                sys.stdout.flush()
            seen += 1
            if seen >= count:
                return

    run(command)


@messages.command("send", cls=NumbersCommand, context_settings=dict(NUMBERS))
def send_message(
    name: MessageName,
    fields: Annotated[list[str] | None, typer.Argument(metavar="FIELD=VALUE …", help="Fields not given are 0.")] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="TARGETS",
            help="Vehicles, components (7/191), all; required if the message has a target field.",
            autocompletion=complete_targets,
        ),
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(
            "--link", metavar="LINK", help="On this link only, to all behind it.", autocompletion=complete_links
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Skip the checks of the order that does the same.")] = False,
    json_output: Json = False,
) -> None:
    """Send one message: `message send UTIAS quat=1,0,0,0 pos=0,0,1.5`. Values may be enum names.

    A message with a target field needs --to TARGETS, --link LINK, or that field (0: all).

    Example: skygcs-cli message send COMMAND_LONG command=512 param1=148 --to alpha --force
    """
    values = parse_pairs(fields or [])
    if target is not None and link is not None:
        raise typer.BadParameter("give either --to or --link, not both")

    async def command(gcs: Client) -> int:
        # send; the server names a missing target
        try:
            answer = await gcs.call(
                "messages.send", name=name_or_id(name), fields=values, target=target, link=link, force=force
            )
        except RpcError as error:
            if target is not None or not _lacks_target(error):
                raise
            fail(f"{name.upper()} has a target field: give --to TARGETS, --link LINK, or the field itself")
            return Exit.USAGE
        # show the answer
        if json_output:
            print_json(answer)
        elif answer["sent"]:
            say(f"sent {answer['message']}" + (f" {answer['sent']} times" if answer["sent"] > 1 else ""))
        else:
            say(f"{answer['message']} was not sent: nothing is connected to the link", err=True)
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
            metavar="TARGET", help="One vehicle, or one component: 7/191, alpha/191.", autocompletion=complete_targets
        ),
    ],
    name: MessageName,
    json_output: Json = False,
) -> None:
    """Show the last message of one name from a vehicle: of its autopilot, else of another component.

    Example: skygcs-cli message last alpha GPS_RAW_INT
    """

    async def command(gcs: Client) -> int:
        answer = await gcs.call("messages.latest", target=target, name=name_or_id(name))
        if json_output:
            print_json(answer)
        elif answer is not None:
            say(f"{answer['name']} of {answer['sysid']}/{answer['compid']}, {duration(answer['age_s'])} ago")
            for field, value in answer["fields"].items():
                say(f"  {field:<24} {json.dumps(value)}")
        else:
            say(f"{target} has not sent {name} yet", err=True)
        return answer is None

    run(command)


@messages.command("request")
def request_message(targets: ComponentTargets, name: MessageName, json_output: Json = False) -> None:
    """Request one message once, and show it: `message request all AUTOPILOT_VERSION`.

    Example: skygcs-cli message request alpha AUTOPILOT_VERSION
    """

    async def command(gcs: Client) -> int:
        message = name_or_id(name)
        async with waiting(f"message request {targets}"):
            answer = await gcs.call("vehicles.request", targets=targets, message=message)
        outcomes = answer["outcomes"]
        received = {
            target: await gcs.call("messages.latest", target=target, name=message)
            for target, outcome in outcomes.items()
            if outcome["ok"]
        }
        if json_output:
            print_json({"outcomes": outcomes, "messages": received})
            return exit_code(outcomes)
        code = print_outcomes(outcomes, False)
        for target, latest in received.items():
            if latest is not None:
                say(message_line({**latest, "source": target}))
        return code

    run(command)


@messages.command("list")
def list_messages(
    part: Annotated[str, typer.Argument(metavar="PART", help="Only names that contain PART.")] = "",
    json_output: Json = False,
) -> None:
    """List the dialect's messages and their fields.

    Example: skygcs-cli message list ATTITUDE
    """

    def lines(found: list[dict[str, Any]]) -> Iterator[str]:
        if not found:
            yield f"no message of the dialect has {part!r} in its name"
        for message in found:
            fields = ", ".join(f"{f['name']} {f['type']}" for f in message["fields"])
            yield f"{message['id']:>5} {message['name']}: {fields}"

    async def command(gcs: Client) -> None:
        show([m for m in await gcs.call("messages.list") if part.upper() in m["name"].upper()], json_output, lines)

    run(command)


def add_to(app: typer.Typer) -> None:
    app.add_typer(messages, name="message")
