"""Orders: commands that make vehicles do something. One line per vehicle reports the outcome."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any, NoReturn

import typer

from skygcs.cli.connection import Exit, client, exit_code, fail, give_order, names_other_sites, run, run_order
from skygcs.cli.options import (
    ComponentTargets,
    OrderJson,
    Targets,
    complete_commands,
    complete_messages,
    complete_modes,
    complete_targets,
)
from skygcs.cli.order_output import JsonForm
from skygcs.cli.parsing import NUMBERS, NumbersCommand, finite, name_or_id, parse_number, parse_unset_number
from skygcs.cli.render import say
from skygcs.errors import RpcError
from skygcs.rpc.client import Client
from skygcs.rpc.error_codes import REFUSED

Wait = Annotated[float, typer.Option("--wait", metavar="S", help="Try again for S seconds.", parser=finite)]
Place = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="LAT LON [HEIGHT]", help="Degrees; metres above home, default: its present height.", show_default=False
    ),
]
HomePlace = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="LAT LON [ALT]",
        help="Degrees; metres above mean sea level, default: the altitude of its present home.",
        show_default=False,
    ),
]


class StopAction(StrEnum):
    """Argument of `stop`."""

    HOLD = "hold"
    LAND = "land"
    KILL = "kill"


def _order(name: str, targets: str, json_output: JsonForm, **params: Any) -> NoReturn:
    run_order(f"vehicles.{name}", json_output, targets=targets, **params)


def _order_confirmed(name: str, targets: str, json_output: JsonForm, confirm: str | None, **params: Any) -> NoReturn:
    """Give an order like `_order`; if the daemon requires a word to confirm it, the person at the terminal is asked for
    the word."""

    station = names_other_sites(targets)

    async def command(gcs: Client) -> int:
        async def ordered(word: str | None, daemon: Client = gcs) -> int:
            return exit_code(
                await give_order(daemon, f"vehicles.{name}", json_output, targets=targets, confirm=word, **params)
            )

        # the refusal names the vehicles and the word
        try:
            return await ordered(confirm)
        except RpcError as error:
            if confirm is not None or error.code != REFUSED or not _has_terminal():
                raise
            fail(str(error))
        # ask, and send the order with the word that was typed
        word = await asyncio.to_thread(_ask_word)
        if not word:
            fail("not confirmed; nothing was sent")
            return Exit.FAILED
        async with client(
            station=station
        ) as again:  # a daemon with too many clients answers one request per connection
            return await ordered(word, again)

    run(command, station=station)


def _has_terminal() -> bool:
    """True if there is a person to ask; a script has to give the word itself."""
    return sys.stdin.isatty()


def _ask_word() -> str:
    say("> ", nl=False, err=True)
    return sys.stdin.readline().strip()


def arm(
    targets: Targets,
    force: Annotated[
        bool, typer.Option("--force", help="Skip the autopilot's arming checks, and a required preflight.")
    ] = False,
    wait: Wait = 0.0,
    json_output: OrderJson = None,
) -> None:
    """Arm vehicles.

    Example: skygcs-cli arm all --wait 20
    """
    _order("arm", targets, json_output, force=force, wait_s=wait)


def disarm(
    targets: Targets,
    force: Annotated[bool, typer.Option("--force", help="Also in flight: the vehicle falls.")] = False,
    confirm: Annotated[
        str | None,
        typer.Option(
            "--confirm",
            metavar="WORD",
            help="Needed while two vehicles have one system id: disarm-N. Default: asks for it.",
        ),
    ] = None,
    json_output: OrderJson = None,
) -> None:
    """Disarm vehicles.

    Example: skygcs-cli disarm alpha
    """
    _order_confirmed("disarm", targets, json_output, confirm, force=force)


def takeoff(
    targets: Targets,
    height: Annotated[
        float | None,
        typer.Argument(metavar="HEIGHT", help="Metres above the ground. [default: from the fleet file]", parser=finite),
    ] = None,
    arm_first: Annotated[bool, typer.Option("--arm/--no-arm", help="Arm first if it is not armed.")] = True,
    force: Annotated[
        bool, typer.Option("--force", help="Without a required preflight, or with another vehicle in the way.")
    ] = False,
    wait: Wait = 0.0,
    json_output: OrderJson = None,
) -> None:
    """Take off, arming first.

    Example: skygcs-cli takeoff all 10
    """
    _order("takeoff", targets, json_output, height_m=height, arm=arm_first, wait_s=wait, force=force)


def land(targets: Targets, json_output: OrderJson = None) -> None:
    """Land at the present position.

    Example: skygcs-cli land alpha,bravo
    """
    _order("land", targets, json_output)


def rtl(targets: Targets, json_output: OrderJson = None) -> None:
    """Return to the launch position and land there.

    One whose way home is not clear holds until it is. Ordered again alone, it returns at once.

    Example: skygcs-cli rtl all
    """
    _order("rtl", targets, json_output)


def hold(targets: Targets, json_output: OrderJson = None) -> None:
    """Stop and hold position.

    Example: skygcs-cli hold all
    """
    _order("hold", targets, json_output)


def goto(
    targets: Targets,
    place: Place = None,
    enu: Annotated[
        str | None, typer.Option("--enu", metavar="E,N,U", help="Metres east, north, up from the fleet's origin.")
    ] = None,
    yaw: Annotated[
        float | None, typer.Option("--yaw", metavar="DEG", help="Heading, clockwise from north.", parser=finite)
    ] = None,
    force: Annotated[
        bool,
        typer.Option("--force", help="Although it is beyond the distance limit, or another vehicle is in the way."),
    ] = False,
    same_place: Annotated[
        bool, typer.Option("--same-place", help="Send several vehicles to the same point; their heights must differ.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Fly to a position: LAT LON [HEIGHT], or with --enu in metres from the origin.

    Several vehicles keep their formation; its centre flies to the position.

    Example: skygcs-cli goto alpha --enu 20,-5,15 --yaw 90
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
    _order("goto", targets, json_output, **params)


def _numbers(texts: list[str] | None, labels: tuple[str, ...]) -> list[float]:
    """Numbers, not more than there are labels. Raises BadParameter."""
    given = texts or []
    if len(given) > len(labels):
        raise typer.BadParameter(f"{len(given)} numbers given; expected {' '.join(labels)}")
    return [parse_number(text, label) for text, label in zip(given, labels, strict=False)]


def mode(
    targets: Targets,
    mode_name: Annotated[
        str,
        typer.Argument(metavar="MODE", help="AUTO.LOITER (PX4), GUIDED (ArduCopter), …", autocompletion=complete_modes),
    ],
    force: Annotated[
        bool, typer.Option("--force", help="Into a mode flown by sticks, in the air, although none are seen.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Set the flight mode, by the name that the autopilot uses.

    Example: skygcs-cli mode charlie LOITER
    """
    _order("mode", targets, json_output, mode=mode_name, force=force)


def reboot(
    targets: Targets,
    force: Annotated[bool, typer.Option("--force", help="Although it is armed.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Reboot the autopilot.

    Example: skygcs-cli reboot alpha
    """
    _order("reboot", targets, json_output, force=force)


def forget(
    targets: Targets,
    force: Annotated[
        bool, typer.Option("--force", help="Although it is heard, or was armed when it was lost in the last half hour.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Remove vehicles that are gone, also from `all`. A vehicle that is heard again is added again.

    Example: skygcs-cli forget bravo
    """
    _order("forget", targets, json_output, force=force)


def sysid(
    target: Annotated[
        str, typer.Argument(metavar="TARGET", help="One vehicle.", autocompletion=complete_targets, show_default=False)
    ],
    number: Annotated[int, typer.Argument(metavar="N", help="Its new system id, 1 to 250.", show_default=False)],
    force: Annotated[
        bool, typer.Option("--force", help="Although the fleet file assigns N to a vehicle that is not heard.")
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Change the system id of a vehicle: set it, restart, find the vehicle again, read back. Disarmed only.

    Example: skygcs-cli sysid 1 7
    """

    run_order("vehicles.renumber", json_output, target=target, sysid=number, force=force)


def home(
    targets: Targets,
    place: HomePlace = None,
    force: Annotated[bool, typer.Option("--force", help="Also in the air, or beyond the distance limit.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Set home to the present position of the vehicle, or to a given position.

    Example: skygcs-cli home alpha
    """
    numbers = _numbers(place, ("LAT", "LON", "ALT"))
    if len(numbers) == 1:
        raise typer.BadParameter("give LAT LON [ALT], or nothing for its present position")
    params = dict(zip(("lat_deg", "lon_deg", "alt_amsl_m"), numbers, strict=False))
    _order("set_home", targets, json_output, force=force, **params)


def interval(
    targets: ComponentTargets,
    message: Annotated[str, typer.Argument(metavar="MESSAGE", autocompletion=complete_messages, help="Name or id.")],
    rate: Annotated[
        str, typer.Argument(metavar="HZ", help="Per second; 0 stops it; default: the autopilot's own rate.")
    ],
    json_output: OrderJson = None,
) -> None:
    """Request one message at a rate: `interval all ATTITUDE 10`, `interval 1 ATTITUDE default`.

    Example: skygcs-cli interval alpha ATTITUDE 10
    """
    rate_hz = None if rate == "default" else parse_number(rate, "HZ")
    _order("interval", targets, json_output, message=name_or_id(message), rate_hz=rate_hz)


def stream(
    targets: ComponentTargets,
    name: Annotated[str, typer.Argument(metavar="STREAM", help="MAV_DATA_STREAM: POSITION, EXTRA1, … or number.")],
    rate_hz: Annotated[float, typer.Argument(metavar="HZ", help="Per second; 0 stops it.", parser=finite)],
    json_output: OrderJson = None,
) -> None:
    """Request a group of messages at a rate (older ArduPilot).

    Example: skygcs-cli stream charlie ALL 2
    """
    _order("stream", targets, json_output, stream=name_or_id(name), rate_hz=rate_hz)


def command(
    targets: ComponentTargets,
    name: Annotated[
        str,
        typer.Argument(
            metavar="COMMAND", help="MAV_CMD by name or number: DO_SET_SERVO, 183.", autocompletion=complete_commands
        ),
    ],
    params: Annotated[
        list[str] | None, typer.Argument(metavar="PARAM1 … PARAM7", help="Numbers; nan or -: not set.")
    ] = None,
    frame: Annotated[
        str | None, typer.Option("--frame", metavar="MAV_FRAME", help="Send COMMAND_INT, with --x, --y, --z.")
    ] = None,
    x: Annotated[int | None, typer.Option("--x", help="As in the message: latitude * 1e7.")] = None,
    y: Annotated[int | None, typer.Option("--y", help="As in the message: longitude * 1e7.")] = None,
    z: Annotated[float | None, typer.Option("--z", metavar="Z", help="Metres.", parser=finite)] = None,
    force: Annotated[bool, typer.Option("--force", help="Skip the checks of the order that does the same.")] = False,
    json_output: OrderJson = None,
) -> None:
    """Send any MAV_CMD and wait for its acknowledgement.

    Example: skygcs-cli command charlie DO_SET_MODE 1 4
    """
    numbers = [parse_unset_number(p, f"PARAM{i}") for i, p in enumerate(params or [], 1)]
    more: dict[str, Any] = {}
    if (x is None) != (y is None):
        raise typer.BadParameter("--x and --y make one position: give both")
    if frame is None and (x is not None or z is not None):
        raise typer.BadParameter("--x, --y and --z belong to COMMAND_INT: give --frame, too (GLOBAL_RELATIVE_ALT, …)")
    if frame is not None:
        more = {"int_frame": name_or_id(frame), "x": x, "y": y, "z": z}
    if force:
        more["force"] = True
    _order("command", targets, json_output, command=name_or_id(name), params=numbers, **more)


def stop(
    targets: Targets,
    action: Annotated[
        StopAction, typer.Argument(help="hold the position, land there, or kill: stop the motors, the vehicle falls.")
    ] = StopAction.HOLD,
    confirm: Annotated[
        str | None,
        typer.Option(
            "--confirm", metavar="WORD", help="For kill: kill-N, N is the number of vehicles. Default: asks for it."
        ),
    ] = None,
    json_output: OrderJson = None,
) -> None:
    """Emergency stop: sent over every link, also to lost vehicles, and repeated until the vehicle shows the effect.

    Example: skygcs-cli stop all land
    """
    _order_confirmed("stop", targets, json_output, confirm, action=action.value)


def add_to(app: typer.Typer) -> None:
    """Add all orders, in the order of a flight."""
    functions: tuple[Callable[..., None], ...] = (arm, takeoff, goto, hold, mode, rtl, land, disarm, stop)
    further: tuple[Callable[..., None], ...] = (reboot, sysid, forget, home, interval, stream, command)
    with_numbers = (takeoff, goto, home, interval, stream, command)
    for function in (*functions, *further):
        if function in with_numbers:
            app.command(cls=NumbersCommand, context_settings=dict(NUMBERS))(function)
        else:
            app.command()(function)
