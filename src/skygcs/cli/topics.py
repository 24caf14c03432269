"""The first page of `skygcs-cli`: its commands by topic, on one screen, and the page of one topic."""

from __future__ import annotations

import functools
import textwrap
from collections.abc import Iterator, Mapping

from skygcs.config.extension_tables import installed_points

TOPICS: dict[str, tuple[str, tuple[str, ...]]] = {
    "look": (
        "what the fleet and the daemon do now",
        ("status", "alarms", "watch", "events", "info", "components", "monitor", "track", "message"),
    ),
    "fly": (
        "orders to one, some or all vehicles",
        (*("preflight", "arm", "takeoff", "goto", "hold", "rtl", "land", "stop", "disarm", "mode", "home"), "mission"),
    ),
    "several": ("plans and control in one frame of coordinates", ("origin", "control", "setpoint", "gains")),
    "vehicle": (
        "parameters, fences, sensors and logs of autopilots",
        (
            *("param", "fence", "undo", "calibrate", "reboot", "sysid", "forget"),
            *("interval", "stream", "command", "gate", "log"),
        ),
    ),
    "connect": ("links, radios, signing, corrections, motion capture", ("links", "link", "signing", "corrections")),
    "stations": ("computers on vehicles, and other sites", ()),
    "files": ("recorded flights and the documentation, without a daemon", ("docs",)),
    "program": ("any method of the socket", ("call", "discover")),
}
"""Each topic: what it is about, and its commands in the core. Every command has one topic."""

EXTENSION_COMMANDS = "skygcs.commands"
"""Group of entry points: TOPIC.COMMAND of an extension, and the module whose ``add_to(app)`` adds it. They are looked
up for the first page, and for a command that the core does not have: it takes 5 to 20 ms."""

OF_SKYGCS = (
    *("run", "init", "check", "import-router", "metrics", "service", "completion", "demo", "sim", "sitl"),
    "web",
)
"""The commands of `skygcs` itself in the core, which runs what these ones talk to."""

EXTENSION_PROGRAMS = "skygcs.programs"
"""Group of entry points: a command of `skygcs` that an extension has, and the module whose ``add_to_program(commands)``
adds its parser. They are looked up for help, and for a command that the core does not have."""

WIDTH = 80
INDENT = 12


@functools.cache
def extension_commands() -> Mapping[str, tuple[str, str]]:
    """The commands of installed extensions: their topic ("program" if it is none) and their module."""
    core = {name for _, names in TOPICS.values() for name in names}
    found = {}
    for _, point in sorted(installed_points(EXTENSION_COMMANDS).points.items()):
        topic, _, command = point.name.rpartition(".")
        if command not in core:
            found[command] = (topic if topic in TOPICS else "program", point.value)
    return found


@functools.cache
def extension_programs() -> Mapping[str, str]:
    """The commands of `skygcs` that installed extensions have, and their modules."""
    points = installed_points(EXTENSION_PROGRAMS).points
    return {name: point.value for name, point in sorted(points.items()) if name not in OF_SKYGCS}


def all_topics() -> dict[str, tuple[str, tuple[str, ...]]]:
    """`TOPICS` with the commands of extensions."""
    added = extension_commands()
    return {
        topic: (about, (*names, *(name for name, (of, _) in added.items() if of == topic)))
        for topic, (about, names) in TOPICS.items()
    }


def front_page(version: str) -> str:
    """All commands on one screen of 80 by 24."""
    lines = [
        "Usage: skygcs-cli [--socket PATH] [--token-file FILE] COMMAND … [--json]",
        "",
        "Show and command the vehicles of a running skygcs daemon (skygcs run FILE).",
        "",
        *(line for topic, (_, commands) in all_topics().items() for line in _row(topic, " ".join(commands))),
        "",
        "The first argument of an order is its targets: 1  1,3  2-5  alpha  a group  all",
        "  skygcs-cli takeoff all 10 && skygcs-cli goto alpha --enu 20,-5,15",
        "",
        "skygcs-cli help TOPIC: a line for each command. COMMAND --help: all about one.",
        f"Exit codes: 0 done, 1 refused or failed, 2 usage, 3 no daemon. skygcs {version}",
    ]
    return "\n".join(lines)


def topic_page(topic: str, summaries: dict[str, str]) -> str:
    """The commands of a topic with one line each. ``summaries``: by command. Raises KeyError for another topic."""
    about, commands = all_topics()[topic]
    width = max(map(len, commands)) + 2
    lines = [f"{topic}: {about}", ""]
    for name in commands:
        lines += textwrap.wrap(
            summaries[name], WIDTH, initial_indent=f"  {name:{width}}", subsequent_indent=" " * (width + 2)
        )
    return "\n".join([*lines, "", "skygcs-cli COMMAND --help: options and an example."])


def of_skygcs_cli(command: str) -> bool:
    """True if this is a command of `skygcs-cli`, for a person that gave it to `skygcs`."""
    return any(command in commands for _, commands in all_topics().values())


def of_skygcs(command: str) -> bool:
    """True if this is a command of `skygcs`, for a person that gave it to `skygcs-cli`."""
    return command in OF_SKYGCS or command in extension_programs()


def _row(topic: str, commands: str) -> Iterator[str]:
    first = f"  {topic:{INDENT - 2}}"
    yield from textwrap.wrap(commands, WIDTH, initial_indent=first, subsequent_indent=" " * INDENT)
