"""Options that the commands of plans share: what makes a margin, and where may be flown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from skygcs.cli.parsing import finite, parse_number, within
from skygcs.core.geo import Origin
from skygcs.core.plan.fleet_plan import FlightSpace
from skygcs.core.plan.margins import GIVEN, MarginRule, Uncertainty
from skygcs.core.separation import DOWNWASH_RATIO
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import RefusedError, TrajectoryError

Limits = Annotated[
    str | None,
    typer.Option(
        "--limits",
        metavar="V,A,J",
        help="Speed, acceleration, jerk: for timing (5,2,4), checked if given.",
        show_default=False,
    ),
]
OriginOption = Annotated[
    str | None,
    typer.Option("--origin", metavar="LAT,LON,ALT", help="For logs and .plan files: by latitude and longitude."),
]
Fleet = Annotated[
    bool,
    typer.Option(
        "--fleet",
        help="Ask the daemon: measured positions and margins, and its other vehicles as obstacles.",
    ),
]


@dataclass(frozen=True)
class MarginOptions:
    """The terms of margins."""

    margin: Annotated[
        float | None,
        typer.Option("--margin", metavar="M", help="This margin for each pair, in place of its terms.", parser=finite),
    ] = None
    wingspan: Annotated[
        float | None, typer.Option("--wingspan", metavar="M", help="Tip to tip, for the margin.", parser=finite)
    ] = None
    position_error: Annotated[
        float | None,
        typer.Option("--position-error", metavar="M", help="Of a vehicle, for the margin.", parser=finite),
    ] = None
    tracking_error: Annotated[
        float | None, typer.Option("--tracking-error", metavar="M", help="p99 of it, for the margin.", parser=finite)
    ] = None
    delay: Annotated[
        float | None,
        typer.Option("--delay", metavar="S", help="p99 of setpoints, for timed plans.", parser=finite),
    ] = None
    downwash: Annotated[
        float | None,
        typer.Option(
            "--downwash", metavar="RATIO", help="A vertical distance counts 1/RATIO of it (2).", parser=finite
        ),
    ] = None

    def rule(self) -> MarginRule:
        """Without a daemon: defaults for what was not given. Raises BadParameter."""
        given = {
            "wingspan_m": self.wingspan,
            "position_error_m": self.position_error,
            "tracking_error_m": self.tracking_error,
            "delay_s": self.delay,
        }
        values: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        ratio = DOWNWASH_RATIO if self.downwash is None else self.downwash
        try:
            uncertainty = Uncertainty(**values, sources=dict.fromkeys(values, GIVEN))
            return MarginRule(uncertainty, downwash_ratio=ratio, fixed_m=self.margin)
        except RefusedError as error:
            raise typer.BadParameter(str(error)) from None

    def asked_of_daemon(self) -> dict[str, float]:
        """The parameters of a request to the daemon, which knows the rest. Raises BadParameter."""
        for option, value in (
            ("--wingspan", self.wingspan),
            ("--position-error", self.position_error),
            ("--tracking-error", self.tracking_error),
            ("--delay", self.delay),
        ):
            if value is not None:
                raise typer.BadParameter(f"{option}: with --fleet it comes from the daemon")
        self.rule()
        given = {"margin_m": self.margin, "downwash_ratio": self.downwash}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class SpaceOptions:
    """Where may be flown."""

    ceiling: Annotated[
        float | None,
        typer.Option("--ceiling", metavar="M", help="No vehicle above, less its margin.", parser=finite),
    ] = None
    floor: Annotated[float | None, typer.Option("--floor", metavar="M", help="No vehicle below.", parser=finite)] = None
    fence: Annotated[
        str | None, typer.Option("--fence", metavar="X,Y;X,Y;…", help="Corners of a polygon, which may be concave.")
    ] = None
    standing: Annotated[
        list[str] | None,
        typer.Option("--standing", metavar="NAME,X,Y,Z", help="A vehicle that takes no part; may be repeated."),
    ] = None

    def space(self) -> FlightSpace:
        """Raises BadParameter."""
        corners = [numbers("--fence", corner, 2) for corner in self.fence.split(";")] if self.fence else []
        if corners and len(corners) < 3:
            raise typer.BadParameter("--fence: a fence has three corners at least")
        places: dict[str, Vector] = {}
        for text in self.standing or ():
            name, _, place = text.partition(",")
            if not name or name in places:
                raise typer.BadParameter(f"--standing: {text!r} is not NAME,X,Y,Z of another vehicle")
            places[name] = vector("--standing", place)
        return FlightSpace(tuple((x, y) for x, y in corners), self.floor, self.ceiling, (), places)


def motion_limits(text: str | None) -> MotionLimits:
    """Parse --limits. Raises BadParameter."""
    if text is None:
        return MotionLimits()
    speed, acceleration, jerk = numbers("--limits", text, 3)
    try:
        default = MotionLimits()
        return MotionLimits(speed, acceleration, jerk, min(speed, default.climb_mps), min(speed, default.descent_mps))
    except TrajectoryError as error:
        raise typer.BadParameter(f"--limits: {error}") from None


def origin_of(text: str | None) -> Origin | None:
    """Parse --origin. Raises BadParameter."""
    if text is None:
        return None
    lat, lon, alt = numbers("--origin", text, 3)
    within("--origin", lat, -90, 90)
    within("--origin", lon, -180, 180)
    return Origin(lat, lon, alt)


def vector(option: str, text: str) -> Vector:
    """Three numbers. Raises BadParameter."""
    x, y, z = numbers(option, text, 3)
    return x, y, z


def numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """So many numbers with commas. Raises BadParameter."""
    parts = text.split(",")
    if len(parts) != count:
        raise typer.BadParameter(f"{option}: {text!r} is not {count} numbers with commas")
    found = tuple(parse_number(part.strip(), option) for part in parts)
    for number in found:
        within(option, number, -1e5, 1e5)
    return found
