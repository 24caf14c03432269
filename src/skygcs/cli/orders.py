"""Commands that make vehicles do something: one line per vehicle says what became of it."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Mapping
from typing import Annotated, Any, NoReturn

import typer

from skygcs.cli import completion
from skygcs.cli.connection import Exit, client, fail, run, waiting
from skygcs.cli.options import ComponentTargets, Json, Targets
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite, name_or_id, parse_number, parse_unset_number
from skygcs.cli.render import outcome_lines, screen_width
from skygcs.errors import RpcError
from skygcs.rpc.client import Client

REFUSED = -32002
"""JSON-RPC code of what skygcs itself refuses (docs/reference/rpc.md)."""


def order(method: str, targets: str, json_output: bool, **params: Any) -> NoReturn:
    """Send it, wait for every vehicle's outcome, print them, exit 0 if all of them are good."""

    async def command(gcs: Client) -> int:
        async with waiting(f"{method} {targets}"):
            answer = await gcs.call(f"vehicles.{method}", targets=targets, **params)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


def order_confirmed(method: str, targets: str, json_output: bool, confirm: str | None, **params: Any) -> NoReturn:
    """As `order`; what the daemon wants confirmed by a word is asked of the person at the terminal."""

    async def command(gcs: Client) -> int:
        async def ordered(word: str | None, by: Client = gcs) -> int:
            async with waiting(f"{method} {targets}"):
                answer = await by.call(f"vehicles.{method}", targets=targets, confirm=word, **params)
            return tell_outcomes(answer["outcomes"], json_output)

        try:
            return await ordered(confirm)
        except RpcError as error:
            if confirm is not None or error.code != REFUSED or not _somebody_there():
                raise
            fail(str(error))
        word = await asyncio.to_thread(_asked)
        if not word:
            fail("not confirmed; nothing was sent")
            return Exit.FAILED
        async with client() as again:  # a daemon with too many clients answers one request of a connection
            return await ordered(word, again)

    run(command)


def _somebody_there() -> bool:
    """Whether there is a person to ask; a script has to say the word itself."""
    return sys.stdin.isatty()


def _asked() -> str:
    typer.echo("> ", nl=False, err=True)
    return sys.stdin.readline().strip()


def tell_outcomes(outcomes: Mapping[str, Mapping[str, Any]], json_output: bool) -> int:
    """Print what became of an order, one line per vehicle; gives the exit code."""
    if json_output:
        typer.echo(json.dumps({"outcomes": outcomes}, indent=2))
    else:
        for line in outcome_lines(outcomes, screen_width(sys.stdout)):
            typer.echo(line)
    return Exit.DONE if all(o["ok"] for o in outcomes.values()) else Exit.FAILED


Wait = Annotated[float, typer.Option("--wait", metavar="S", help="Keep trying for S seconds.", parser=finite)]


def arm(
    targets: Targets,
    force: Annotated[
        bool, typer.Option("--force", help="Skip the autopilot's own checks, and a required preflight.")
    ] = False,
    wait: Wait = 0.0,
    json_output: Json = False,
) -> None:
    """Arm."""
    order("arm", targets, json_output, force=force, wait_s=wait)


def disarm(
    targets: Targets,
    force: Annotated[bool, typer.Option("--force", help="Also in flight: the vehicle falls.")] = False,
    confirm: Annotated[
        str | None,
        typer.Option(
            "--confirm",
            metavar="WORD",
            help="While two vehicles have one system id: disarm-N. Else it is asked.",
        ),
    ] = None,
    json_output: Json = False,
) -> None:
    """Disarm."""
    order_confirmed("disarm", targets, json_output, confirm, force=force)


def takeoff(
    targets: Targets,
    height: Annotated[
        float | None,
        typer.Argument(metavar="[HEIGHT]", help="Metres above the ground; default: the fleet file's.", parser=finite),
    ] = None,
    arm_first: Annotated[bool, typer.Option("--arm/--no-arm", help="Arm if it is not armed.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Without a required preflight.")] = False,
    wait: Wait = 0.0,
    json_output: Json = False,
) -> None:
    """Take off, arming first."""
    order("takeoff", targets, json_output, height_m=height, arm=arm_first, wait_s=wait, force=force)


def land(targets: Targets, json_output: Json = False) -> None:
    """Land where it is."""
    order("land", targets, json_output)


def rtl(targets: Targets, json_output: Json = False) -> None:
    """Return to launch and land there."""
    order("rtl", targets, json_output)


def hold(targets: Targets, json_output: Json = False) -> None:
    """Stop and hold position."""
    order("hold", targets, json_output)


Place = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[LAT LON [HEIGHT]]", help="Degrees; metres above home, default as it is.", show_default=False
    ),
]


def goto(
    targets: Targets,
    place: Place = None,
    enu: Annotated[
        str | None, typer.Option("--enu", metavar="E,N,U", help="Metres east, north, up of the fleet's origin.")
    ] = None,
    yaw: Annotated[
        float | None, typer.Option("--yaw", metavar="DEG", help="Heading, clockwise from north.", parser=finite)
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Although it is farther than the limit.")] = False,
    same_place: Annotated[
        bool, typer.Option("--same-place", help="Several vehicles: all to the very point; mind their heights.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Fly to a place: `goto alpha 43.78 -79.46 10`, `goto all --enu 5,-3,10`.

    Several vehicles keep their places to each other; the middle of them goes there.
    """
    params: dict[str, Any] = {"yaw_deg": yaw, "force": force, "same_place": same_place}
    numbers = _numbers(place, ("LAT", "LON", "HEIGHT"))
    if enu is not None:
        if numbers:
            raise typer.BadParameter("give either LAT LON [HEIGHT] or --enu, not both")
        parts = enu.split(",")
        if len(parts) != 3:
            raise typer.BadParameter(f"--enu: {enu!r} is not of the form E,N,U")
        params["enu_m"] = [parse_number(part, "--enu") for part in parts]
    elif len(numbers) < 2:
        raise typer.BadParameter("give LAT LON [HEIGHT], or --enu E,N,U")
    params |= dict(zip(("lat_deg", "lon_deg", "height_m"), numbers, strict=False))
    order("goto", targets, json_output, **params)


def _numbers(texts: list[str] | None, labels: tuple[str, ...]) -> list[float]:
    """At most as many numbers as there are labels. Raises BadParameter."""
    given = texts or []
    if len(given) > len(labels):
        raise typer.BadParameter(f"{len(given)} numbers given; there are {' '.join(labels)}")
    return [parse_number(text, label) for text, label in zip(given, labels, strict=False)]


def mode(
    targets: Targets,
    mode_name: Annotated[
        str,
        typer.Argument(
            metavar="MODE", help="AUTO.LOITER (PX4), GUIDED (ArduCopter), …", autocompletion=completion.modes
        ),
    ],
    json_output: Json = False,
) -> None:
    """Set the flight mode by the autopilot's own name."""
    order("mode", targets, json_output, mode=mode_name)


def reboot(
    targets: Targets,
    force: Annotated[bool, typer.Option("--force", help="Although it is armed.")] = False,
    json_output: Json = False,
) -> None:
    """Reboot the autopilot."""
    order("reboot", targets, json_output, force=force)


def forget(
    targets: Targets,
    force: Annotated[
        bool, typer.Option("--force", help="Although it is heard, or was lost armed in the last half hour.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Forget vehicles that are gone: `all` no longer means them. One that is heard again is met anew."""
    order("forget", targets, json_output, force=force)


def sysid(
    target: Annotated[
        str,
        typer.Argument(metavar="TARGET", help="One vehicle.", autocompletion=completion.targets, show_default=False),
    ],
    number: Annotated[int, typer.Argument(metavar="N", help="Its new system id, 1 to 250.", show_default=False)],
    force: Annotated[
        bool, typer.Option("--force", help="Although the fleet file gives N to a vehicle that is not heard.")
    ] = False,
    json_output: Json = False,
) -> None:
    """Give a vehicle another system id: set, restart, find it again, read back. On the ground, disarmed."""

    async def command(gcs: Client) -> int:
        async with waiting(f"sysid {target} {number}"):
            answer = await gcs.call("vehicles.renumber", target=target, sysid=number, force=force)
        return tell_outcomes(answer["outcomes"], json_output)

    run(command)


def home(
    targets: Targets,
    place: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[LAT LON [ALT]]",
            help="Degrees; metres above mean sea level, default as the home it has.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Also in the air, or farther than the limit.")] = False,
    json_output: Json = False,
) -> None:
    """Set home: where it stands, or a place."""
    numbers = _numbers(place, ("LAT", "LON", "ALT"))
    if len(numbers) == 1:
        raise typer.BadParameter("give LAT LON [ALT], or nothing: home is where it stands")
    params = dict(zip(("lat_deg", "lon_deg", "alt_amsl_m"), numbers, strict=False))
    order("set_home", targets, json_output, force=force, **params)


def interval(
    targets: ComponentTargets,
    message: Annotated[str, typer.Argument(metavar="MESSAGE", autocompletion=completion.messages, help="Name or id.")],
    rate: Annotated[str, typer.Argument(metavar="HZ", help="Per second; 0 stops it; default: its own rate.")],
    json_output: Json = False,
) -> None:
    """Ask for one message at a rate: `interval all ATTITUDE 10`, `interval 1 ATTITUDE default`."""
    rate_hz = None if rate == "default" else parse_number(rate, "HZ")
    order("interval", targets, json_output, message=name_or_id(message), rate_hz=rate_hz)


def stream(
    targets: ComponentTargets,
    name: Annotated[str, typer.Argument(metavar="STREAM", help="MAV_DATA_STREAM: POSITION, EXTRA1, … or number.")],
    rate_hz: Annotated[float, typer.Argument(metavar="HZ", help="Per second; 0 stops it.", parser=finite)],
    json_output: Json = False,
) -> None:
    """Ask for a group of messages at a rate (older ArduPilot)."""
    order("stream", targets, json_output, stream=name_or_id(name), rate_hz=rate_hz)


def command(
    targets: ComponentTargets,
    name: Annotated[
        str,
        typer.Argument(
            metavar="COMMAND",
            help="MAV_CMD by name or number: DO_SET_SERVO, 183.",
            autocompletion=completion.commands,
        ),
    ],
    params: Annotated[
        list[str] | None, typer.Argument(metavar="[PARAM1 … PARAM7]", help="Numbers; nan or - is unset.")
    ] = None,
    frame: Annotated[
        str | None, typer.Option("--frame", metavar="MAV_FRAME", help="As COMMAND_INT, with --x, --y, --z.")
    ] = None,
    x: Annotated[int | None, typer.Option("--x", help="As on the wire: latitude * 1e7.")] = None,
    y: Annotated[int | None, typer.Option("--y", help="As on the wire: longitude * 1e7.")] = None,
    z: Annotated[float | None, typer.Option("--z", metavar="Z", help="Metres.", parser=finite)] = None,
    force: Annotated[bool, typer.Option("--force", help="Without the checks of the order that does the same.")] = False,
    json_output: Json = False,
) -> None:
    """Send any MAV_CMD and wait for its acknowledgement."""
    numbers = [parse_unset_number(p, f"PARAM{i}") for i, p in enumerate(params or [], 1)]
    more: dict[str, Any] = {}
    if (x is None) != (y is None):
        raise typer.BadParameter("--x and --y are one place: give both")
    if frame is None and (x is not None or z is not None):
        raise typer.BadParameter("--x, --y and --z are for COMMAND_INT: give --frame, too (GLOBAL_RELATIVE_ALT, …)")
    if frame is not None:
        more = {"int_frame": name_or_id(frame), "x": x, "y": y, "z": z}
    if force:
        more["force"] = True
    order("command", targets, json_output, command=name_or_id(name), params=numbers, **more)


def add_to(app: typer.Typer) -> None:
    """All orders, in the order of a flight."""
    functions: tuple[Callable[..., None], ...] = (arm, takeoff, goto, hold, mode, rtl, land, disarm)
    further: tuple[Callable[..., None], ...] = (reboot, sysid, forget, home, interval, stream, command)
    with_numbers = (takeoff, goto, home, interval, stream, command)
    for function in (*functions, *further):
        if function in with_numbers:
            app.command(rich_help_panel="Orders", cls=NumbersCommand, context_settings=dict(NUMBERS))(function)
        else:
            app.command(rich_help_panel="Orders")(function)
