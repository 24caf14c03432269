"""`skygcs-cli signing`: keys for MAVLink 2 message signing."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run, run_offline, waiting
from skygcs.cli.options import Json, Targets
from skygcs.cli.orders import tell_outcomes
from skygcs.rpc.client import Client

app = typer.Typer(help="Sign messages, so that only who has the key can command the vehicles.", no_args_is_help=True)

DROPPED = ("unsigned", "bad_signature", "replayed", "stale", "ahead", "too_many_streams")


@app.command("status")
def status(json_output: Json = False) -> None:
    """Show which links have a key, and what they accepted and dropped."""

    async def command(gcs: Client) -> None:
        answer = await gcs.call("signing.status")
        typer.echo(json.dumps(answer, indent=2) if json_output else "\n".join(_lines(answer)))

    run(command)


@app.command("setup")
def setup(
    targets: Targets,
    key: Annotated[Path, typer.Option("--key", metavar="FILE", help="The key file, mode 0600.")],
    force: Annotated[
        bool, typer.Option("--force", help="Although others can hear the link: the key goes out in clear.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Give vehicles the key and wait until they sign with it; over a cable, disarmed."""

    path = os.path.abspath(os.path.expanduser(key))

    async def command(gcs: Client) -> int:
        async with waiting(f"signing setup {targets}"):
            answer = await gcs.call("signing.setup", targets=targets, key_file=path, force=force)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


@app.command("off")
def off(targets: Targets, json_output: Json = False) -> None:
    """Have vehicles forget their key: they take orders from anybody again."""

    async def command(gcs: Client) -> int:
        async with waiting(f"signing off {targets}"):
            answer = await gcs.call("signing.off", targets=targets)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


@app.command("reset-clock")
def reset_clock(
    key_id: Annotated[str, typer.Argument(metavar="KEYID", help="As signing status shows it.")],
    force: Annotated[bool, typer.Option("--force", help="Although a vehicle is armed.")] = False,
) -> None:
    """Set the clock of a key back to this computer's, after somebody has moved it far ahead."""

    async def command(gcs: Client) -> None:
        typer.echo((await gcs.call("signing.reset_clock", key_id=key_id, force=force))["message"])

    run(command)


@app.command("key")
def key(file: Annotated[Path, typer.Argument(metavar="NEWFILE", help="Must not exist yet.")]) -> None:
    """Make a key file, mode 0600: 32 bytes of chance in hexadecimal. Needs no daemon."""

    def command() -> None:
        from skygcs.config.signing import write_new_key
        from skygcs.core.mavlink.signing import key_id

        made = write_new_key(Path(os.path.expanduser(file)))
        typer.echo(f"{file}: key {key_id(made)}; keep a copy where nobody else can read it")

    run_offline(command)


def _lines(status: dict[str, Any]) -> list[str]:
    if not status["links"]:
        return ["no link has a key: set links.NAME.signing.key_file in the fleet file"]
    lines = []
    for link in status["links"]:
        allowed = ", ".join(map(str, link["accept_unsigned"])) or "none"
        signs = "signs" if link["sign_outgoing"] else "does not sign"
        lines.append(f"{link['link']}: key {link['key_id']}, link id {link['link_id']}, {signs}")
        lines.append(f"  may come unsigned: {allowed}")
        for channel in link["channels"]:
            dropped = ", ".join(f"{channel[kind]} {kind}" for kind in DROPPED if channel[kind])
            lines.append(
                f"  {channel['peer']}: {channel['signed']} signed, {channel['unsigned_allowed']} unsigned let in, "
                f"dropped: {dropped or 'none'}; sent {channel['sent_signed']}"
            )
    return lines + [line for key in status["keys"] for line in _clock_lines(key)]


def _clock_lines(key: dict[str, Any]) -> list[str]:
    """The clock of one key, and what to do if somebody has moved it far ahead."""
    shown = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(key["time_unix_s"]))
    ahead_s = key["ahead_s"]
    offset = f"{ahead_s:.0f} s ahead of this computer's clock" if ahead_s >= 1 else "as this computer's clock"
    lines = [f"clock of key {key['key_id']}: {shown}, {offset}"]
    if key["pinned"]:
        lines.append(
            "  somebody signed with a wrong time; if this computer's clock is right: "
            f"skygcs-cli signing reset-clock {key['key_id']}"
        )
    return lines
