"""Arguments and options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

from skygcs.cli import completion

Targets = Annotated[
    str,
    typer.Argument(
        metavar="TARGETS",
        help="Vehicles: 1, 1,3, 2-5, a name, a group, all.",
        autocompletion=completion.targets,
        show_default=False,
    ),
]
ComponentTargets = Annotated[
    str,
    typer.Argument(
        metavar="TARGETS",
        help="Vehicles: 1, 1,3, 2-5, a name, a group, all; or components: 7/191, alpha/191, all/100.",
        autocompletion=completion.targets,
        show_default=False,
    ),
]
OptionalTargets = Annotated[
    str,
    typer.Argument(
        metavar="[TARGETS]",
        help="Vehicles: 1, 1,3, 2-5, a name, a group, all.",
        autocompletion=completion.targets,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable output.")]
LinkName = Annotated[
    str, typer.Argument(metavar="NAME", help="The link's name.", autocompletion=completion.links, show_default=False)
]
MessageName = Annotated[
    str,
    typer.Argument(
        metavar="NAME",
        help="A message of the dialect, by name or id.",
        autocompletion=completion.messages,
        show_default=False,
    ),
]
