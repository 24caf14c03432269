"""`skygcs-cli plan run` and what is ordered of a plan in flight. The daemon flies it; this shows it."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skygcs.cli.connection import Exit, fail, run, run_show, show, waiting
from skygcs.cli.options import Json
from skygcs.cli.parsing import finite, within
from skygcs.cli.plan_reading import read_files
from skygcs.cli.render import LiveView, duration, fixed, print_json, print_lines, table
from skygcs.core.plan.plan_json import write_plan_json
from skygcs.core.trajectory import MotionLimits
from skygcs.core.trajectory.trajectory_clock import MAX_SPEED_FACTOR, MIN_SPEED_FACTOR
from skygcs.errors import PlanFileError, RpcError
from skygcs.ext.plans.commands.plan_inputs import origin_of_fleet, print_notes
from skygcs.rpc.client import Client

if TYPE_CHECKING:
    from rich.console import RenderableType

OVER = frozenset({"finished", "aborted", "landed", "loaded", "none"})
GOOD = frozenset({"finished", "landed"})

State = Mapping[str, Any]


class ControlModeName(StrEnum):
    """How the vehicles are controlled."""

    POSITION = "position"
    VELOCITY = "velocity"
    ATTITUDE = "attitude"


class GuidanceName(StrEnum):
    """The way in which the vehicles are guided."""

    AUTO = "auto"
    GOTO = "goto"
    SETPOINTS = "setpoints"
    ONBOARD = "onboard"
    MISSION = "mission"


Force = Annotated[bool, typer.Option("--force", help="Although it is refused by checks that force can override.")]
File = Annotated[
    Path,
    typer.Argument(
        metavar="FILE", help="A plan: .json, .skyc or .csv of several vehicles; .plan of one.", show_default=False
    ),
]
Vehicles = Annotated[
    str | None,
    typer.Argument(
        metavar="TARGETS",
        help="Vehicles, in the order of the plan if they have other names there. [default: those of the plan]",
        show_default=False,
    ),
]


def run_plan(
    file: File,
    targets: Vehicles = None,
    mode: Annotated[ControlModeName, typer.Option("--mode", help="The control mode.")] = ControlModeName.POSITION,
    by: Annotated[
        GuidanceName,
        typer.Option(
            "--by",
            help="goto: one order for each leg; setpoints: a stream; onboard: companions or missions; mission.",
        ),
    ] = GuidanceName.AUTO,
    speed: Annotated[
        float, typer.Option("--speed", metavar="FACTOR", help="Multiple of the planned speed.", parser=finite)
    ] = 1.0,
    margin: Annotated[
        float | None,
        typer.Option("--margin", metavar="M", help="This margin for each pair, in place of its terms.", parser=finite),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only look at everything; nothing moves.")] = False,
    set_return_heights: Annotated[
        bool, typer.Option("--set-return-heights", help="Set return heights that are too near each other.")
    ] = False,
    detach: Annotated[bool, typer.Option("--detach", help="Return as soon as vehicles begin to arm.")] = False,
    force: Force = False,
    json_output: Json = False,
) -> None:
    """Check a plan with the vehicles as they are, and fly it: `plan run plan.json alpha,bravo,charlie`.

    Ctrl-C asks whether to abort; without a terminal it aborts. Exit code 0: all at their goals, 1: refused, stopped or
    aborted, 130: left while it flies on.

    Example: skygcs-cli plan run show.json --set-return-heights
    """
    within("--speed", speed, MIN_SPEED_FACTOR, MAX_SPEED_FACTOR)
    within("--margin", margin, 0.01, 1000.0)

    async def command(gcs: Client) -> int:
        # load the plan and choose its vehicles
        kept = await _load(gcs, file)
        names = await _vehicles(gcs, kept["vehicles"], targets)
        request = {"plan": kept["plan"], "vehicles": names, "mode": mode.value, "speed": speed, "force": force}
        request["by"] = by.value
        request |= {} if margin is None else {"margin_m": margin}
        # check only
        if dry_run:
            async with waiting("checking"):
                report = await gcs.call("plan.check", **request)
            show(report, json_output, report_lines)
            return Exit.DONE if report["ok"] else Exit.FAILED
        # begin, and follow the flight
        answer = await _begin(gcs, request, set_return_heights=set_return_heights)
        if not answer["started"] or detach:
            show(answer, json_output, lambda a: report_lines(a["report"]))
            return Exit.DONE if answer["started"] else Exit.FAILED
        if not json_output:
            print_lines(notes(answer["report"]))
        return await _follow(gcs, json_output)

    run(command)


async def _load(gcs: Client, file: Path) -> dict[str, Any]:
    """Give the file's plan to the daemon. Raises PlanFileError."""
    origin = await origin_of_fleet(gcs, [file])
    found = await asyncio.to_thread(read_files, [file], MotionLimits(), origin)
    print_notes(found)
    text = await asyncio.to_thread(write_plan_json, found.plan, found.space)
    kept: dict[str, Any] = await gcs.call("plan.load", **await gcs.given_plan(text), name=file.stem[:64] or "plan")
    return kept


async def _vehicles(gcs: Client, planned: Sequence[str], targets: str | None) -> dict[str, str] | None:
    """Which vehicle flies what of the plan; None: all by their names. Raises PlanFileError."""
    if targets is None:
        return None
    names: list[str] = []
    for part in targets.split(","):
        names += [state["name"] for state in await gcs.vehicles(part.strip()) if state["name"] not in names]
    if all(name in planned for name in names):
        return {name: name for name in names}
    if len(names) == len(planned) and not any(name in planned for name in names):
        return dict(zip(planned, names, strict=True))
    there = ", ".join(list(planned)[:10])
    raise PlanFileError("plan", "", f"it is for {there}; {targets} names {', '.join(names[:10])}")


async def _begin(gcs: Client, request: Mapping[str, Any], *, set_return_heights: bool) -> dict[str, Any]:
    """Run it; where only return heights are in the way, ask whether to set them."""
    async with waiting("checking"):
        answer: dict[str, Any] = await gcs.call("plan.run", **request, set_return_heights=set_return_heights)
    in_the_way = {f["check"] for f in answer["report"]["findings"] if f["severity"] == "refused"}
    if answer["started"] or set_return_heights or in_the_way != {"return height"} or not sys.stdin.isatty():
        return answer
    print_lines(report_lines(answer["report"]))
    offered = [f"{n} {param} {old:g} m → {new:g} m" for n, (old, new, param) in _changes(answer["report"])]
    if not await asyncio.to_thread(typer.confirm, f"Set {', '.join(offered)}?"):
        return answer
    async with waiting("checking"):
        again: dict[str, Any] = await gcs.call("plan.run", **request, set_return_heights=True)
    return again


def _changes(report: State) -> Iterator[tuple[str, tuple[float, float, str]]]:
    for name, (is_now, offered, param) in report["return_heights"].items():
        if is_now != offered:
            yield name, (is_now, offered, param)


# --- a flight, as it is followed --------------------------------------------------------------------------------------


async def _follow(gcs: Client, json_output: bool) -> int:
    """Show the flight until it is over or stopped."""
    latest: dict[str, Any] = {}
    screen = sys.stdout.isatty() and not json_output
    while True:
        try:
            with LiveView(lambda _: picture(latest), enabled=screen) as view:
                said = ""
                async for status in gcs.plan(rate_hz=4.0):
                    latest.clear()
                    latest.update(status)
                    view.refresh()
                    if json_output:
                        print_json(status)
                    elif not screen and status["reason"] != said:
                        print_lines([f"{status['state']}: {status['reason']}"])
                        said = status["reason"]
                    if status["state"] in OVER or status["state"] == "stopped":
                        break
            return _end(latest, said_already=not screen)
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if task is not None:
                task.uncancel()
            if (code := await _interrupted(gcs)) is not None:
                return code


def _end(status: State, *, said_already: bool) -> int:
    if status["state"] in GOOD:
        return Exit.DONE
    if not said_already:
        fail(status["reason"])
    if status["state"] == "stopped":
        fail("they stay where they are: `skygcs-cli plan resume`, `plan abort` or `plan land`")
    return Exit.FAILED


async def _interrupted(gcs: Client) -> int | None:
    """After Ctrl-C: abort, land or leave; None: go on watching."""
    answer = "a"
    if sys.stdin.isatty():
        text = "\nAbort (stop and hold), land, leave it flying, or go on watching? [a/l/q/c]"
        answer = (await asyncio.to_thread(typer.prompt, text, default="a")).strip().lower()[:1]
    if answer == "c":
        return None
    if answer == "q":
        fail("the plan flies on: `skygcs-cli plan watch`, `plan abort`")
        return Exit.INTERRUPTED
    try:
        done = await gcs.call("plan.land" if answer == "l" else "plan.abort")
        fail(done["message"])
    except RpcError as error:  # it is over already
        fail(str(error))
        return Exit.FAILED
    return None


def picture(status: State) -> RenderableType:
    """The flight as a table: phase, clock, and each vehicle with its error."""
    if not status:
        return ""
    rows = [
        [
            one["vehicle"],
            one["left"] or one["state"],
            fixed(one["error_m"], 2),
            fixed(one["tube_m"], 2),
            ", ".join(fixed(v, 1) for v in one["pos_enu_m"] or ()),
            ", ".join(fixed(v, 1) for v in one["goal_enu_m"] or ()),
        ]
        for one in status["vehicles"]
    ]
    columns = ("vehicle", "state", "error m", "of", "at", "to")
    return table(columns, rows, right=("error m", "of"), wrap=("state",), title=headline(status))


def headline(status: State) -> str:
    """One line: state, phase, clock, and who is waited for."""
    line = f"{status['name']}: {status['state']}"
    if status["phase"] and status["state"] not in OVER:
        line += f", {status['phase']} ({status['step']} of {status['steps']})"
    clock = status["clock"]
    if clock is not None and status["state"] not in OVER:
        line += f", {clock['trajectory_s']:.1f} of {clock['duration_s']:.1f} s at {clock['rate']:g}"
    if status["waits_for"] and status["state"] not in OVER:
        line += f"; waits for {', '.join(status['waits_for'][:5])}"
    return line


def report_lines(report: State) -> Iterator[str]:
    """Return what was found: what is in the way first, then what to know."""
    yield by_line(report)
    order = {"refused": 0, "warning": 1, "note": 2, "ok": 3}
    for finding in sorted(report["findings"], key=lambda f: order.get(f["severity"], 0)):
        word = {"refused": "NO  ", "warning": "warn", "note": "note"}.get(finding["severity"], "ok  ")
        who = f"{finding['vehicle']} " if finding["vehicle"] else ""
        yield f"{word} {who}{finding['check']}: {finding['text']}"
        if finding["severity"] == "refused" and finding["todo"]:
            yield f"       {finding['todo']}"
    for name, terms in report["margins"].items():
        yield f"     {name} margin: " + ", ".join(
            f"{term} {value:g} ({source})" for term, (value, source) in terms.items()
        )
    if report["steps"]:
        steps = ", ".join(f"{step['name']} {duration(step['duration_s'])}" for step in report["steps"])
        yield f"     {duration(report['duration_s'])}: {steps}"


def by_line(report: State) -> str:
    """The way in which it is flown, and why."""
    return f"by {report['by']}: {report['why']}"


def notes(report: State) -> Iterable[str]:
    """Return what passed but should be known."""
    yield by_line(report)
    for finding in report["findings"]:
        if finding["severity"] in ("refused", "warning"):
            yield f"note: {finding['vehicle'] or 'plan'} {finding['check']}: {finding['text']}"


# --- orders -----------------------------------------------------------------------------------------------------------


def watch(json_output: Json = False) -> None:
    """Show the plan in flight until it is over or stopped; Ctrl-C as for `plan run`.

    Example: skygcs-cli plan watch
    """
    run(lambda gcs: _follow(gcs, json_output))


def pause(json_output: Json = False) -> None:
    """Stop all on their ways, smoothly; `plan resume` goes on.

    Example: skygcs-cli plan pause
    """
    _order("plan.pause", json_output)


def resume(
    force: Annotated[
        bool,
        typer.Option("--force", help="With vehicles that are silent or flown by pilots, where they were measured."),
    ] = False,
    json_output: Json = False,
) -> None:
    """Go on after a pause or a stop, by a new certificate: from where they are, back to their ways.

    Example: skygcs-cli plan resume
    """
    _order("plan.resume", json_output, force=force)


def speed_(
    factor: Annotated[float, typer.Argument(metavar="FACTOR", help="Of the planned speed.", parser=finite)],
    json_output: Json = False,
) -> None:
    """Fly faster or slower, at most as fast as the plan was certified for.

    Example: skygcs-cli plan speed 0.5
    """
    within("FACTOR", factor, MIN_SPEED_FACTOR, MAX_SPEED_FACTOR)
    _order("plan.speed", json_output, speed=factor)


def abort(json_output: Json = False) -> None:
    """Stop all for good, and hold.

    Example: skygcs-cli plan abort
    """
    _order("plan.abort", json_output)


def land(
    force: Annotated[bool, typer.Option("--force", help="All at once, without a certificate.")] = False,
    json_output: Json = False,
) -> None:
    """Stop all, and land them where they are: at once, or the lowest first, as it is certified.

    Example: skygcs-cli plan land
    """
    _order("plan.land", json_output, force=force)


def unload(json_output: Json = False) -> None:
    """Forget the plan that is loaded.

    Example: skygcs-cli plan unload
    """
    _order("plan.unload", json_output)


def status(json_output: Json = False) -> None:
    """Show the plan that is loaded, and its flight.

    Example: skygcs-cli plan status
    """
    run_show("plan.status", json_output, status_lines)


def status_lines(answer: State) -> Iterator[str]:
    """A line, and one for each vehicle."""
    if answer["plan"] is None:
        yield "no plan is loaded"
        return
    yield headline(answer)
    if answer["reason"]:
        yield answer["reason"]
    for one in answer["vehicles"]:
        error = "" if one["error_m"] is None else f"  {one['error_m']:.2f} m off, {one['tube_m']:.2f} m are allowed"
        yield f"{one['vehicle']}  {one['left'] or one['state']}{error}"


def _order(method: str, json_output: bool, **params: Any) -> None:
    async def command(gcs: Client) -> int:
        async with waiting(method):
            answer = await gcs.call(method, **params)
        show(answer, json_output, lambda a: [a["message"], *(f"  {why}" for why in a["reasons"][1:])])
        return Exit.DONE if answer["ok"] else Exit.FAILED

    run(command)


def add_to(app: typer.Typer) -> None:
    """Add the commands to `skygcs-cli plan`."""
    app.command("run")(run_plan)
    for name, command in (
        ("watch", watch),
        ("pause", pause),
        ("resume", resume),
        ("speed", speed_),
        ("abort", abort),
        ("land", land),
        ("status", status),
        ("unload", unload),
    ):
        app.command(name)(command)
