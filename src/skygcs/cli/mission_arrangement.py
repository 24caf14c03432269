"""Options of `skygcs-cli mission upload` that make one mission into one for each of several vehicles."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import typer

from skygcs.cli.parsing import finite
from skygcs.core.vehicle.formation import LEAST_STEP_M, SPACING_M


class ArrangementKind(StrEnum):
    """How the missions of several vehicles differ; `core.vehicle.formation`."""

    HEIGHTS = "heights"
    PRESENT = "present"
    LINE = "line"
    COLUMN = "column"


Arrange = Annotated[
    ArrangementKind | None,
    typer.Option(
        "--arrange",
        help="One mission for several: each next vehicle higher, or its path moved by where each is now, or beside, or "
        "behind the one before.",
        show_default=False,
    ),
]
Step = Annotated[
    float | None,
    typer.Option(
        "--step",
        metavar="M",
        parser=finite,
        help=f"Of heights. [default: what the margins need, at least {LEAST_STEP_M:g}]",
    ),
]
Spacing = Annotated[
    float | None,
    typer.Option("--spacing", metavar="M", parser=finite, help=f"Of line and column. [default: {SPACING_M:g}]"),
]
Heading = Annotated[
    float | None,
    typer.Option(
        "--heading", metavar="DEG", parser=finite, help="Of line and column. [default: the course of the first leg]"
    ),
]

OPTIONS: dict[ArrangementKind | None, tuple[str, ...]] = {
    None: (),
    ArrangementKind.HEIGHTS: ("step_m",),
    ArrangementKind.PRESENT: (),
    ArrangementKind.LINE: ("spacing_m", "heading_deg"),
    ArrangementKind.COLUMN: ("spacing_m", "heading_deg"),
}


def arrangement_of(kind: ArrangementKind | None, **lengths: float | None) -> dict[str, Any] | None:
    """The parameter of missions.upload; None: all get the mission as it is. Raises BadParameter for an option that the
    kind does not have."""
    given = {name: value for name, value in lengths.items() if value is not None}
    for name in given:
        if name not in OPTIONS[kind]:
            option = f"--{name.rpartition('_')[0]}"
            raise typer.BadParameter(f"{option}: {'needs --arrange' if kind is None else f'{kind.value} has none'}")
    return None if kind is None else {"kind": kind.value, **given}
