"""`skygcs-cli signing`: keys for MAVLink 2 message signing."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run, run_offline, run_order, run_show
from skygcs.cli.options import Json, OrderJson, Targets
from skygcs.cli.render import say
from skygcs.rpc.client import Client

app = typer.Typer(
    help="Sign messages, so that only programs with the key can command the vehicles.", no_args_is_help=True
)

DROPPED = ("unsigned", "bad_signature", "replayed", "stale", "ahead", "too_many_streams")


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show which links have a key, and what they accepted and dropped.

    Example: skygcs-cli signing status
    """
    run_show("signing.status", json_output, _lines)


@app.command("setup")
def setup(
    targets: Targets,
    key: Annotated[Path, typer.Option("--key", metavar="FILE", help="The key file, mode 0600.")],
    force: Annotated[
        bool, typer.Option("--force", help="Although others can receive the link: the key is sent unencrypted.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Send the key to vehicles and wait until they sign with it; over a cable, disarmed.

    Example: skygcs-cli signing setup alpha --key lab.key
    """
    path = os.path.abspath(os.path.expanduser(key))
    run_order("signing.setup", json_output, targets=targets, key_file=path, force=force)


@app.command("off")
def off(targets: Targets, json_output: OrderJson = None) -> None:
    """Delete the key in vehicles: they accept orders without a signature again.

    Example: skygcs-cli signing off alpha
    """
    run_order("signing.off", json_output, targets=targets)


@app.command("reset-clock")
def reset_clock(
    key_id: Annotated[str, typer.Argument(metavar="KEYID", help="As `signing status` shows it.")],
    force: Annotated[bool, typer.Option("--force", help="Although a vehicle is armed.")] = False,
) -> None:
    """Set the signing clock of a key to this computer's time, after a wrong timestamp moved it far ahead.

    Example: skygcs-cli signing reset-clock 2c6184d5
    """

    async def command(gcs: Client) -> None:
        say((await gcs.call("signing.reset_clock", key_id=key_id, force=force))["message"])

    run(command)


@app.command("key")
def key(file: Annotated[Path, typer.Argument(metavar="NEWFILE", help="A file that does not exist yet.")]) -> None:
    """Create a key file, mode 0600, with 32 random bytes in hexadecimal. Needs no daemon.

    Example: skygcs-cli signing key lab.key
    """

    def command() -> None:
        from skygcs.config.signing import write_new_key
        from skygcs.core.mavlink.signing import key_id

        made = write_new_key(Path(os.path.expanduser(file)))
        say(f"{file}: key {key_id(made)}; keep a copy in a safe place")

    run_offline(command)


def _lines(status: dict[str, Any]) -> Iterator[str]:
    if not status["links"]:
        yield "no link has a key: set links.NAME.signing.key_file in the fleet file"
        return
    for link in status["links"]:
        allowed = ", ".join(map(str, link["accept_unsigned"])) or "none"
        signs = "signs" if link["sign_outgoing"] else "does not sign"
        yield f"{link['link']}: key {link['key_id']}, link id {link['link_id']}, {signs}"
        yield f"  accepted without a signature: {allowed}"
        for channel in link["channels"]:
            dropped = ", ".join(f"{channel[kind]} {kind}" for kind in DROPPED if channel[kind])
            yield (
                f"  {channel['peer']}: {channel['signed']} signed, {channel['unsigned_allowed']} unsigned accepted, "
                f"dropped: {dropped or 'none'}; sent {channel['sent_signed']}"
            )
    for key in status["keys"]:
        yield from _clock_lines(key)


def _clock_lines(key: dict[str, Any]) -> Iterator[str]:
    """The signing clock of one key, and what to do if it is far ahead."""
    shown = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(key["time_unix_s"]))
    ahead_s = key["ahead_s"]
    offset = f"{ahead_s:.0f} s ahead of this computer's clock" if ahead_s >= 1 else "equal to this computer's clock"
    yield f"clock of key {key['key_id']}: {shown}, {offset}"
    if key["pinned"]:
        yield (
            "  a message was signed with a wrong time; if this computer's clock is right: "
            f"skygcs-cli signing reset-clock {key['key_id']}"
        )


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="signing")
