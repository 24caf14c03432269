"""`skygcs-cli plan`: make, check and show plans of a fleet. Needs no daemon.

A plan is certified or refused: exit code 0 or 1. Formats and mathematics: docs/explanation/plans.md. What computes with
numpy is imported in functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli import plan_run
from skygcs.cli.connection import Exit, fail, run_offline
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, parse_number, within
from skygcs.cli.render import console, print_json, table
from skygcs.core.geo import Origin
from skygcs.core.plan.certificate import Approach, Certificate
from skygcs.core.plan.file_reading import MAX_FILE_BYTES
from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, Plan, TimedPlan
from skygcs.core.plan.formations import SHAPES, formation
from skygcs.core.plan.margins import GIVEN, MarginRule, Uncertainty
from skygcs.core.plan.plan_files import ReadPlan, read_plan
from skygcs.core.plan.plan_json import write_plan_json
from skygcs.core.trajectory import MotionLimits, Trajectory
from skygcs.core.trajectory.piecewise import Vector
from skygcs.errors import PlanFileError, RefusedError, SkygcsError, TrajectoryError

app = typer.Typer(no_args_is_help=True, help="Make, check and show plans of a fleet, without a daemon; fly them.")
plan_run.add_to(app)


class Kind(StrEnum):
    """Which plans `plan make` looks for."""

    AUTO = "auto"
    TIMED = "timed"
    PHASED = "phased"


Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE…", help=".json, .skyc or .csv; Crazyswarm has a file per vehicle.", show_default=False
    ),
]
OneFile = Annotated[
    Path, typer.Argument(metavar="FILE", help="Starts and goals, or paths: CSV or TOML.", show_default=False)
]
MarginOption = Annotated[
    float | None,
    typer.Option("--margin", metavar="M", help="This margin for each pair, in place of its terms.", parser=finite),
]
Wingspan = Annotated[
    float | None, typer.Option("--wingspan", metavar="M", help="Tip to tip, for the margin.", parser=finite)
]
PositionError = Annotated[
    float | None, typer.Option("--position-error", metavar="M", help="Of a vehicle, for the margin.", parser=finite)
]
TrackingError = Annotated[
    float | None, typer.Option("--tracking-error", metavar="M", help="p99 of it, for the margin.", parser=finite)
]
DelayOption = Annotated[
    float | None, typer.Option("--delay", metavar="S", help="p99 of setpoints, for timed plans.", parser=finite)
]
Downwash = Annotated[
    float,
    typer.Option("--downwash", metavar="RATIO", help="A vertical distance counts 1/RATIO of it.", parser=finite),
]
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
    str | None, typer.Option("--origin", metavar="LAT,LON,ALT", help="For logs by latitude and longitude.")
]
Ceiling = Annotated[
    float | None, typer.Option("--ceiling", metavar="M", help="No vehicle above, less its margin.", parser=finite)
]
Floor = Annotated[float | None, typer.Option("--floor", metavar="M", help="No vehicle below.", parser=finite)]
Fence = Annotated[
    str | None, typer.Option("--fence", metavar="X,Y;X,Y;…", help="Corners of a polygon, which may be concave.")
]
Standing = Annotated[
    list[str] | None,
    typer.Option("--standing", metavar="NAME,X,Y,Z", help="A vehicle that takes no part; may be repeated."),
]


@app.command()
def check(
    files: Files,
    margin: MarginOption = None,
    wingspan: Wingspan = None,
    position_error: PositionError = None,
    tracking_error: TrackingError = None,
    delay: DelayOption = None,
    downwash: Downwash = 2.0,
    limits: Limits = None,
    origin: OriginOption = None,
    ceiling: Ceiling = None,
    floor: Floor = None,
    fence: Fence = None,
    standing: Standing = None,
    json_output: Json = False,
) -> None:
    """Certify a plan or refuse it: the closest pair, when and where, and every term of its margin.

    Exit code 0: certified, 1: refused.
    """
    rule = _rule(margin, downwash, _uncertainty(wingspan, position_error, tracking_error, delay))
    motion, place = _limits(limits), _origin(origin)
    added = _space(ceiling, floor, fence, standing)

    def command() -> int:
        from skygcs.core.plan.certify import certify

        found = _read(files, motion, place)
        certificate = certify(found.plan, rule, _joined(found.space, added), limits=None if limits is None else motion)
        return _answer(certificate, json_output, found.format)

    run_offline(command)


@app.command()
def make(
    file: OneFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=".json, .skyc, or a folder for Crazyswarm CSV files."),
    ] = None,
    exchange: Annotated[bool, typer.Option("--exchange", help="Any vehicle may take any goal.")] = False,
    kind: Annotated[Kind, typer.Option("--kind", help="Only plans of this kind.")] = Kind.AUTO,
    shape: Annotated[
        str | None, typer.Option("--formation", metavar="SHAPE", help=f"The goals: {', '.join(SHAPES)}.")
    ] = None,
    spacing: Annotated[
        float, typer.Option("--spacing", metavar="M", help="Between neighbours of the formation.", parser=finite)
    ] = 5.0,
    at: Annotated[str | None, typer.Option("--at", metavar="X,Y,Z", help="Middle of the formation.")] = None,
    heading: Annotated[
        float, typer.Option("--yaw", metavar="DEG", help="It looks there, counter-clockwise from x.", parser=finite)
    ] = 0.0,
    margin: MarginOption = None,
    wingspan: Wingspan = None,
    position_error: PositionError = None,
    tracking_error: TrackingError = None,
    delay: DelayOption = None,
    downwash: Downwash = 2.0,
    limits: Limits = None,
    ceiling: Ceiling = None,
    floor: Floor = None,
    fence: Fence = None,
    standing: Standing = None,
    json_output: Json = False,
) -> None:
    """Make a certified plan from starts and goals, from a formation, or from paths.

    FILE is a table of initial and final positions, or CSV vehicle,t,x,y,z,yaw: two rows of a vehicle without times are
    its start and its goal (with --formation one is enough), anything else is a path that is kept as it is.
    Exit code 0: certified and written, 1: refused.
    """
    rule = _rule(margin, downwash, _uncertainty(wingspan, position_error, tracking_error, delay))
    motion = _limits(limits)
    space = _space(ceiling, floor, fence, standing)
    middle = None if at is None else _vector("--at", at)
    wanted = None if shape is None else (shape, spacing, middle, heading)
    if shape is not None and middle is None:
        raise typer.BadParameter("--formation needs --at X,Y,Z")

    def command() -> int:
        from skygcs.core.plan.certify import certify

        starts, goals = _ends(file, wanted)
        if goals is None:
            plan = _read([file], motion, None).plan
            certificate = certify(plan, rule, space, limits=None if limits is None else motion)
            written = _write(output, plan, space, certificate, motion) if certificate.certified else ""
            return _answer(certificate, json_output, "paths", written)
        return _search(
            _Question(starts, goals, exchange or shape is not None, kind), rule, motion, space, json_output, output
        )

    run_offline(command)


@app.command()
def show(
    files: Files,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="A picture (.svg) or a page that plays (.html)."),
    ] = None,
    limits: Limits = None,
    origin: OriginOption = None,
    json_output: Json = False,
) -> None:
    """Show the vehicles of a plan: where from, where to, how long, how fast; and draw it."""
    motion, place = _limits(limits), _origin(origin)
    if output is not None and output.suffix.lower() not in (".svg", ".html"):
        raise typer.BadParameter(f"--output: {output.name!r} ends neither in .svg nor in .html")

    def command() -> None:
        found = _read(files, motion, place)
        _show(found, motion, output, json_output)

    run_offline(command)


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="plan", rich_help_panel="Orders")


# --- options ----------------------------------------------------------------------------------------------------------


def _uncertainty(*given: float | None) -> Uncertainty:
    names = ("wingspan_m", "position_error_m", "tracking_error_m", "delay_s")
    values: dict[str, Any] = {name: value for name, value in zip(names, given, strict=True) if value is not None}
    try:
        return Uncertainty(**values, sources=dict.fromkeys(values, GIVEN))
    except RefusedError as error:
        raise typer.BadParameter(str(error)) from None


def _rule(margin: float | None, downwash: float, uncertainty: Uncertainty) -> MarginRule:
    try:
        return MarginRule(uncertainty, downwash_ratio=downwash, fixed_m=margin)
    except RefusedError as error:
        raise typer.BadParameter(str(error)) from None


def _limits(text: str | None) -> MotionLimits:
    if text is None:
        return MotionLimits()
    speed, acceleration, jerk = _numbers("--limits", text, 3)
    try:
        default = MotionLimits()
        return MotionLimits(speed, acceleration, jerk, min(speed, default.climb_mps), min(speed, default.descent_mps))
    except TrajectoryError as error:
        raise typer.BadParameter(f"--limits: {error}") from None


def _origin(text: str | None) -> Origin | None:
    if text is None:
        return None
    lat, lon, alt = _numbers("--origin", text, 3)
    within("--origin", lat, -90, 90)
    within("--origin", lon, -180, 180)
    return Origin(lat, lon, alt)


def _space(
    ceiling: float | None, floor: float | None, fence: str | None, standing: Sequence[str] | None
) -> FlightSpace:
    corners = [_numbers("--fence", corner, 2) for corner in fence.split(";")] if fence else []
    if corners and len(corners) < 3:
        raise typer.BadParameter("--fence: a fence has three corners at least")
    places: dict[str, Vector] = {}
    for text in standing or ():
        name, _, place = text.partition(",")
        if not name or name in places:
            raise typer.BadParameter(f"--standing: {text!r} is not NAME,X,Y,Z of another vehicle")
        places[name] = _vector("--standing", place)
    return FlightSpace(tuple((x, y) for x, y in corners), floor, ceiling, (), places)


def _joined(own: FlightSpace, added: FlightSpace) -> FlightSpace:
    """What the file says, and what the options add or replace."""
    return FlightSpace(
        added.fence or own.fence,
        own.floor_m if added.floor_m is None else added.floor_m,
        own.ceiling_m if added.ceiling_m is None else added.ceiling_m,
        own.boxes,
        {**own.standing, **added.standing},
    )


def _vector(option: str, text: str) -> Vector:
    x, y, z = _numbers(option, text, 3)
    return x, y, z


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) != count:
        raise typer.BadParameter(f"{option}: {text!r} is not {count} numbers with commas")
    numbers = tuple(parse_number(part.strip(), option) for part in parts)
    for number in numbers:
        within(option, number, -1e5, 1e5)
    return numbers


# --- files ------------------------------------------------------------------------------------------------------------


def _bytes(file: Path) -> bytes:
    try:
        with file.open("rb") as opened:
            return opened.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise SkygcsError(f"{file}: {error.strerror or error}") from None


def _read(files: Sequence[Path], limits: MotionLimits, origin: Origin | None) -> ReadPlan:
    """One plan; several files are one timed plan together."""
    found = [read_plan(str(file), _bytes(file), limits, origin) for file in files]
    if len(found) == 1:
        return found[0]
    trajectories: dict[str, Trajectory] = {}
    for file, part in zip(files, found, strict=True):
        if not isinstance(part.plan, TimedPlan) or part.space != FlightSpace():
            raise PlanFileError(str(file), "", "only files of trajectories can be put together")
        if twice := trajectories.keys() & part.plan.trajectories.keys():
            raise PlanFileError(str(file), "", f"vehicle {min(twice)} is in two files")
        trajectories.update(part.plan.trajectories)
    return ReadPlan(TimedPlan(trajectories), FlightSpace(), f"{len(found)} files")


Places = dict[str, Vector]


def _ends(file: Path, wanted: tuple[str, float, Vector | None, float] | None) -> tuple[Places, Places | None]:
    """Starts and goals; no goals where the file holds paths."""
    from math import radians

    if file.suffix.lower() == ".toml" or b"initial_x" in _bytes(file)[:4096]:
        from skygcs.cli.table import read_table, spots

        places = read_table(file)
        starts = {name: spot.position_m for name, spot in spots(places, "initial").items()}
        goals = {name: spot.position_m for name, spot in spots(places, "final").items()}
    else:
        from skygcs.core.plan.trajectory_csv import read_paths

        if file.suffix.lower() != ".csv":
            raise PlanFileError(str(file), "", "starts and goals are in a .csv or .toml")
        paths = read_paths(str(file), _bytes(file))
        starts = {name: path.points[0] for name, path in paths.items()}
        if wanted is None and any(path.times or len(path.points) != 2 for path in paths.values()):
            return starts, None
        goals = {name: path.points[-1] for name, path in paths.items()}
    if wanted is not None:
        shape, spacing, middle, heading = wanted
        placed = formation(shape, len(starts), spacing, middle or (0.0, 0.0, 0.0), radians(heading))
        goals = dict(zip(starts, placed, strict=True))
    return starts, goals


def _write(output: Path | None, plan: Plan, space: FlightSpace, certificate: Certificate, limits: MotionLimits) -> str:
    """Write the plan in the format of the name; what was written, for people."""
    if output is None:
        return ""
    trajectories = plan.trajectories if isinstance(plan, TimedPlan) else plan.trajectories(limits)
    suffix = output.suffix.lower()
    if suffix == ".json":
        output.write_text(write_plan_json(plan, space, certificate.as_dict()))
    elif suffix == ".skyc":
        from skygcs.core.plan.skyc import write_skyc

        output.write_bytes(write_skyc(trajectories))
    elif suffix:
        raise RefusedError(f"{output}: a plan is written as .json, .skyc, or into a folder as Crazyswarm CSV files")
    else:
        from skygcs.core.plan.crazyswarm import write_crazyswarm

        for name in trajectories:
            if "/" in name or "\\" in name or name.startswith("."):
                raise RefusedError(f"{name!r} cannot be the name of a file")
        output.mkdir(exist_ok=True)
        for name, trajectory in trajectories.items():
            (output / f"{name}.csv").write_text(write_crazyswarm(trajectory))
    return f"written to {output}"


# --- answers ----------------------------------------------------------------------------------------------------------


class _Question:
    """What `plan make` is asked for."""

    def __init__(self, starts: Places, goals: Places, exchangeable: bool, kind: Kind) -> None:
        self.starts = starts
        self.goals = goals
        self.exchangeable = exchangeable
        self.kind = kind


def _search(
    question: _Question,
    rule: MarginRule,
    limits: MotionLimits,
    space: FlightSpace,
    json_output: bool,
    output: Path | None,
) -> int:
    from skygcs.core.plan.plan_search import Task, make_plan

    task = Task(question.starts, question.goals, question.exchangeable, question.kind.value)
    found = make_plan(task, rule, limits, space)
    if found.plan is None or found.certificate is None:
        if json_output:
            print_json({"certified": False, "attempts": [a.what for a in found.attempts], "reasons": found.reasons()})
        else:
            fail("refused:\n" + "\n".join(f"  {reason}" for reason in found.reasons()))
        return Exit.FAILED
    written = _write(output, found.plan, space, found.certificate, limits)
    if json_output:
        print_json(found.certificate.as_dict() | {"attempts": [a.what for a in found.attempts], "output": written})
    else:
        typer.echo(f"plan: {found.attempts[-1].what}")
        for reason in found.reasons():
            typer.echo(f"  tried before: {reason}")
        _print_certificate(found.certificate, written)
    return Exit.DONE


def _answer(certificate: Certificate, json_output: bool, what: str, written: str = "") -> int:
    if json_output:
        print_json(certificate.as_dict() | {"format": what, "output": written})
    else:
        _print_certificate(certificate, written)
    return Exit.DONE if certificate.certified else Exit.FAILED


def _print_certificate(certificate: Certificate, written: str) -> None:
    duration = "" if certificate.duration_s is None else f", {certificate.duration_s:.1f} s"
    word = "certified" if certificate.certified else "REFUSED"
    typer.echo(f"{word}: {certificate.vehicles} vehicles, {certificate.kind}{duration}")
    for reason in certificate.reasons():
        typer.echo(f"  {reason}")
    if certificate.closest is not None:
        if certificate.certified:
            typer.echo(f"closest: {certificate.closest.text()}")
        _print_terms(certificate.closest, certificate.downwash_ratio)
    else:
        typer.echo("one vehicle and nothing it could meet")
    if written:
        typer.echo(written)


def _print_terms(approach: Approach, ratio: float) -> None:
    names = list(dict.fromkeys(term for terms in approach.terms.values() for term in terms))
    rows = [
        [name, *(f"{approach.terms[vehicle].get(name, 0.0):.3f}" for vehicle in approach.vehicles)] for name in names
    ]
    rows.append(["sum", *(f"{sum(approach.terms[vehicle].values()):.3f}" for vehicle in approach.vehicles)])
    console().print(table([f"margin, m (height / {ratio:g})", *approach.vehicles], rows, right=approach.vehicles))


def _show(found: ReadPlan, limits: MotionLimits, output: Path | None, json_output: bool) -> None:
    from skygcs.cli.plan_drawing import draw_page, draw_svg
    from skygcs.core.trajectory import motion_peaks

    plan = found.plan
    trajectories = plan.trajectories if isinstance(plan, TimedPlan) else plan.trajectories(limits)
    rows: dict[str, Mapping[str, Any]] = {
        name: {
            "duration_s": round(t.duration_s, 3),
            "pieces": len(t.pieces),
            "start_m": [round(v, 3) for v in t.start_enu_m],
            "end_m": [round(v, 3) for v in t.end_enu_m],
            "speed_mps": round(motion_peaks(t).speed_mps.at_most, 3),
        }
        for name, t in trajectories.items()
    }
    if output is not None:
        text = draw_svg(trajectories) if output.suffix.lower() == ".svg" else draw_page(trajectories)
        output.write_text(text)
    phases = [phase.name for phase in plan.phases] if isinstance(plan, PhasedPlan) else []
    if json_output:
        print_json({"format": found.format, "phases": phases, "vehicles": rows})
        return
    typer.echo(f"{found.format}: {len(rows)} vehicles" + (f", phases {', '.join(phases)}" if phases else ""))
    columns = ("vehicle", "from", "to", "s", "m/s", "pieces")
    cells = [
        [
            name,
            _place(row["start_m"]),
            _place(row["end_m"]),
            f"{row['duration_s']:.1f}",
            f"{row['speed_mps']:.1f}",
            str(row["pieces"]),
        ]
        for name, row in rows.items()
    ]
    console().print(table(columns, cells, right=("s", "m/s", "pieces")))
    if output is not None:
        typer.echo(f"drawn in {output}")


def _place(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)
