"""`skygcs-cli plan`: make, check and show plans of a fleet; without a daemon, or with what it measured (--fleet).

A plan is certified or refused: exit code 0 or 1. Formats and mathematics: docs/explanation/plans.md. Certificates are
computed by a process of their own (`skygcs.ext.plans.planning`).
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import run, run_offline
from skygcs.cli.options import Json, with_groups
from skygcs.cli.plan_reading import read_files
from skygcs.cli.render import console, print_json, say, table
from skygcs.config.files import write_named
from skygcs.core.geo import Origin
from skygcs.core.plan.crazyswarm import write_crazyswarm
from skygcs.core.plan.fleet_plan import FlightSpace, PhasedPlan, TimedPlan
from skygcs.core.plan.margins import MarginRule
from skygcs.core.plan.plan_files import ReadPlan
from skygcs.core.plan.plan_json import plan_content, plan_from_json, space_content
from skygcs.core.plan.skyc import write_skyc
from skygcs.core.trajectory import MotionLimits, motion_peaks
from skygcs.errors import RefusedError
from skygcs.ext.plans.commands import plan_run
from skygcs.ext.plans.commands.plan_certificates import Answer, asked, computed, print_answer, print_refusal
from skygcs.ext.plans.commands.plan_drawing import draw_page, draw_svg
from skygcs.ext.plans.commands.plan_inputs import (
    Files,
    FormationOptions,
    Places,
    origin_of_fleet,
    print_notes,
    starts_and_goals,
    vehicles_of,
)
from skygcs.ext.plans.commands.plan_options import (
    Fleet,
    Limits,
    MarginOptions,
    OriginOption,
    SpaceOptions,
    motion_limits,
    origin_of,
)
from skygcs.ext.plans.planning.request import check_request, make_request
from skygcs.rpc.client import Client

app = typer.Typer(no_args_is_help=True, help="Make, check, show and fly plans of a fleet.")
plan_run.add_to(app)


class Kind(StrEnum):
    """Which plans `plan make` looks for."""

    AUTO = "auto"
    TIMED = "timed"
    PHASED = "phased"


Tasks = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE…",
        help="Starts and goals: CSV or TOML; or paths: CSV, or .plan files, one for each vehicle.",
        show_default=False,
    ),
]


@app.command()
@with_groups
def check(
    files: Files,
    margins: MarginOptions,
    place: SpaceOptions,
    limits: Limits = None,
    origin: OriginOption = None,
    fleet: Fleet = False,
    json_output: Json = False,
) -> None:
    """Certify a plan or refuse it: the closest pair, when and where, and every term of its margin.

    Exit code 0: certified, 1: refused.

    Example: skygcs-cli plan check show.json --fleet
    """
    motion, here, added = motion_limits(limits), origin_of(origin), place.space()
    if fleet:
        params = margins.asked_of_daemon()

        async def by_daemon(gcs: Client) -> int:
            found = await asyncio.to_thread(read_files, files, motion, here or await origin_of_fleet(gcs, files))
            print_notes(found)
            return await _certified_by_daemon(gcs, found, added, motion, params, limits is not None, json_output)

        run(by_daemon)
    rule = margins.rule()

    def command() -> int:
        found = read_files(files, motion, here)
        print_notes(found)
        space = found.space.joined(added)
        request = check_request(found.plan, rule, motion, space, within_limits=limits is not None)
        return print_answer(computed(request, json_output), json_output, found.format)

    run_offline(command)


@app.command()
@with_groups
def make(
    files: Tasks,
    margins: MarginOptions,
    place: SpaceOptions,
    shape: FormationOptions,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=".json, .skyc, or a folder for Crazyswarm CSV files."),
    ] = None,
    exchange: Annotated[bool, typer.Option("--exchange", help="Any vehicle may take any goal.")] = False,
    kind: Annotated[Kind, typer.Option("--kind", help="Only plans of this kind.")] = Kind.AUTO,
    limits: Limits = None,
    origin: OriginOption = None,
    fleet: Fleet = False,
    json_output: Json = False,
) -> None:
    """Make a certified plan from starts and goals, from a formation, or from paths.

    FILE is a table of initial and final positions, or CSV vehicle,t,x,y,z,yaw: two rows of a vehicle without times are
    its start and its goal (with --formation or --fleet one is enough), anything else is a path that is kept as it is,
    as are .plan files of QGroundControl. With --fleet and --formation vehicles may be named instead of a file.
    Exit code 0: certified and written, 1: refused.

    Example: skygcs-cli plan make goals.csv --fleet -o plan.json
    """
    motion, space, here = motion_limits(limits), place.space(), origin_of(origin)
    shape.require_valid()
    question = _Question(tuple(files), shape, exchange, kind, motion, limits is not None, here)
    if fleet:
        params = margins.asked_of_daemon()

        async def by_daemon(gcs: Client) -> int:
            answer = await _made_by_daemon(gcs, question, space, params, json_output)
            return _answered(answer, output, motion, json_output)

        run(by_daemon)
    rule = margins.rule()
    run_offline(lambda: _answered(computed(question.request(rule, space), json_output), output, motion, json_output))


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
    """Show the vehicles of a plan: where from, where to, how long, how fast; and draw it.

    Example: skygcs-cli plan show show.json -o show.html
    """
    motion, place = motion_limits(limits), origin_of(origin)
    if output is not None and output.suffix.lower() not in (".svg", ".html"):
        raise typer.BadParameter(f"--output: {output.name!r} ends neither in .svg nor in .html")

    def command() -> None:
        found = read_files(files, motion, place)
        print_notes(found)
        _show(found, motion, output, json_output)

    run_offline(command)


def add_to(app_: typer.Typer) -> None:
    app_.add_typer(app, name="plan")


# --- questions and answers --------------------------------------------------------------------------------------------


def _write(output: Path | None, content: Mapping[str, Any], limits: MotionLimits) -> str:
    """Write a plan in the format of the name; what was written, for people."""
    if output is None:
        return ""
    suffix = output.suffix.lower()
    if suffix == ".json":
        write_named(output, json.dumps(content) + "\n")
        return f"written to {output}"
    plan, _ = plan_from_json("the plan", content)
    trajectories = plan.trajectories if isinstance(plan, TimedPlan) else plan.trajectories(limits)
    if suffix == ".skyc":
        write_named(output, write_skyc(trajectories))
    elif suffix:
        raise RefusedError(f"{output}: a plan is written as .json, .skyc, or into a folder as Crazyswarm CSV files")
    else:
        for name in trajectories:
            if "/" in name or "\\" in name or name.startswith("."):
                raise RefusedError(f"{name!r} cannot be the name of a file")
        output.mkdir(exist_ok=True)
        for name, trajectory in trajectories.items():
            write_named(output / f"{name}.csv", write_crazyswarm(trajectory))
    return f"written to {output}"


@dataclass(frozen=True)
class _Question:
    """Question that `plan make` is asked."""

    files: tuple[Path, ...]
    shape: FormationOptions
    exchangeable: bool
    kind: Kind
    limits: MotionLimits
    within_limits: bool
    origin: Origin | None

    def given_limits(self) -> dict[str, Any]:
        """Limits for the daemon, which has each vehicle's own where none are given."""
        return {"limits": asdict(self.limits)} if self.within_limits else {}

    def request(self, rule: MarginRule, space: FlightSpace) -> dict[str, Any]:
        """Request for a planning process. Raises SkygcsError."""
        wanted = self.shape.wanted()
        starts, goals = self.ends(one_is_enough=wanted is not None)
        if wanted is not None:
            if not starts:
                raise RefusedError(f"{self.files[0]} names no vehicles and where they start, which a formation takes")
            goals = wanted.places(list(starts), starts)
        if goals is None:
            plan = self.paths(self.origin).plan
            return check_request(plan, rule, self.limits, space, within_limits=self.within_limits, keep=True)
        exchange = self.exchangeable or (wanted is not None and wanted.exchangeable)
        return make_request(starts, goals, rule, self.limits, space, exchangeable=exchange, kind=self.kind.value)

    def ends(self, *, one_is_enough: bool) -> tuple[Places, Places | None]:
        """Starts and goals; several files are paths. Raises SkygcsError."""
        if len(self.files) > 1:
            return {}, None
        return starts_and_goals(self.files[0], one_is_enough=one_is_enough)

    def paths(self, origin: Origin | None) -> ReadPlan:
        """The files as paths. Raises SkygcsError."""
        found = read_files(self.files, self.limits, origin)
        print_notes(found)
        return found


def _answered(answer: Answer, output: Path | None, limits: MotionLimits, json_output: bool) -> int:
    """Write the plan, and print what became of it."""
    if answer["plan"] is None:
        if not answer["attempts"]:
            return print_answer(answer, json_output, "paths")
        return print_refusal(answer, json_output)
    written = _write(output, answer["plan"], limits)
    if not json_output and answer["attempts"]:
        say(f"plan: {answer['attempts'][-1]}")
        for reason in answer["reasons"]:
            say(f"  tried before: {reason}")
    return print_answer(answer, json_output, "paths", written)


async def _made_by_daemon(
    gcs: Client, question: _Question, space: FlightSpace, params: Mapping[str, Any], json_output: bool
) -> Answer:
    """The daemon takes measured positions as starts. Raises SkygcsError."""
    # parameters of both methods
    common = {**params, "space": space_content(space), **question.given_limits()}
    kind: dict[str, Any] = {"exchangeable": question.exchangeable, "kind": question.kind.value}
    # goals by a formation
    wanted = await asyncio.to_thread(question.shape.wanted)
    if wanted is not None:
        if len(question.files) > 1:
            raise RefusedError("a formation takes one file, or targets with commas")
        formation = {
            "vehicles": await vehicles_of(gcs, question.files[0]),
            "shape": wanted.shape,
            "middle_m": wanted.middle_m,
            "spacing_m": wanted.spacing_m,
            "yaw_deg": question.shape.heading,
            "scale": wanted.scale,
            "points_m": wanted.points_m,
        }
        return await asked(gcs, "plan.make", json_output, formation=formation, **kind, **common)
    # goals by name, or paths that are given
    _, goals = await asyncio.to_thread(question.ends, one_is_enough=True)
    if goals is None:
        # certify the given paths
        origin = question.origin or await origin_of_fleet(gcs, question.files)
        found = await asyncio.to_thread(question.paths, origin)
        content = plan_content(found.plan, FlightSpace())
        more = {"within_limits": question.within_limits}
        answer = await asked(gcs, "plan.certify", json_output, plan=content, **more, **common)
        if not answer["certificate"]["certified"]:
            return answer
        certified_in = space_content(space)
        certified_in["standing"] |= answer["standing"]
        return {**answer, "plan": content | {"space": certified_in, "certificate": answer["certificate"]}}
    return await asked(gcs, "plan.make", json_output, goals=goals, **kind, **common)


async def _certified_by_daemon(
    gcs: Client,
    found: ReadPlan,
    added: FlightSpace,
    limits: MotionLimits,
    params: Mapping[str, Any],
    within_limits: bool,
    json_output: bool,
) -> int:
    content = plan_content(found.plan, found.space)
    common = {**params, "space": space_content(added), "within_limits": within_limits}
    common |= {"limits": asdict(limits)} if within_limits else {}
    answer = await asked(gcs, "plan.certify", json_output, plan=content, **common)
    return print_answer(answer, json_output, found.format)


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(found: ReadPlan, limits: MotionLimits, output: Path | None, json_output: bool) -> None:
    # the trajectories, timed where the plan is not
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
    # draw them
    if output is not None:
        text = draw_svg(trajectories) if output.suffix.lower() == ".svg" else draw_page(trajectories)
        write_named(output, text)
    # print the answer
    phases = [phase.name for phase in plan.phases] if isinstance(plan, PhasedPlan) else []
    if json_output:
        print_json({"format": found.format, "phases": phases, "vehicles": rows})
        return
    say(f"{found.format}: {len(rows)} vehicles" + (f", phases {', '.join(phases)}" if phases else ""))
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
        say(f"drawn in {output}")


def _place(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.1f}" for value in values)
