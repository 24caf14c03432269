"""`skygcs-cli param`: read, set, save, apply and compare the parameters of vehicles and of parameter files."""

from __future__ import annotations

import asyncio
import contextlib
import fnmatch
import os
import sys
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, clear_spinner, run, run_offline, show
from skygcs.cli.options import Json, OneVehicle, OrderJson, Targets
from skygcs.cli.order_output import JsonForm
from skygcs.cli.parsing import NUMBERS, NumbersCommand, parse_number
from skygcs.cli.render import plural, print_json, print_lines, say
from skygcs.config.files import read_named, write_named
from skygcs.core.mavlink.param_encoding import NAME_CHARS, Param, ParamType, float32, short_float, value_text
from skygcs.core.params.compare import ApplyPlan, Difference, ParamChange, diff, plan
from skygcs.core.params.metadata import ParamMetadata
from skygcs.core.params.names import SORTS, Sort
from skygcs.core.params.param_file import MAX_CHARS, Entry, Kind, ParamFile, Rounding, of_vehicle, parse, write
from skygcs.errors import ConfigError, RefusedError
from skygcs.rpc.client import Client
from skygcs.spelling import enumerated

params = typer.Typer(
    help="Read, set, save, compare and apply parameters; `diff` of two files needs no daemon.", no_args_is_help=True
)

Refresh = Annotated[
    bool, typer.Option("--refresh", help="Read all from the vehicle, although it confirms the values known already.")
]
Burst = Annotated[
    bool, typer.Option("--burst", help="Request all at once: faster on USB or Wi-Fi, but it overloads a shared radio.")
]
Include = Annotated[
    str,
    typer.Option(
        "--include",
        metavar="SORT,…",
        help="Include what belongs to one vehicle only: calibration, statistics, identity, or all.",
    ),
]

STACKS = {"px4": "PX4 Pro", "ardupilot": "ArduPilot"}
"""Names of the firmwares as QGroundControl writes them."""

BAR_CELLS = 30
MAX_NAMED = 10
"""Names listed of the parameters that are left alone."""

WRITERS: Mapping[Rounding, str] = {
    "6 decimals": "rounded to 6 decimals, as MAVProxy writes them",
    "7 digits": "rounded to 7 digits, as Mission Planner writes them",
}
"""The 18 decimals of QGroundControl hide no difference between 32-bit floats."""

OutcomesByVehicle = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""Outcome by vehicle and parameter."""


@dataclass(frozen=True, slots=True)
class HeldParams:
    """All parameters that a vehicle holds."""

    name: str
    sysid: int
    compid: int
    autopilot: str
    params: tuple[Param, ...]


@params.command("get")
def get(
    targets: Targets,
    names: Annotated[list[str], typer.Argument(metavar="NAME …", help="Names of parameters.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Read parameters from vehicles: `param get all NAV_RCL_ACT`.

    Example: skygcs-cli param get all MPC_XY_VEL_MAX
    """

    async def command(gcs: Client) -> int:
        answer = await gcs.call("params.get", targets=targets, names=[n.upper() for n in names])
        return _show_outcomes(answer["outcomes"], json_output)

    run(command)


@params.command("show")
def show_(
    targets: Targets,
    names: Annotated[list[str], typer.Argument(metavar="NAME …", help="Names of parameters.", show_default=False)],
    read: Annotated[
        bool, typer.Option("--read", help="Read the vehicle's own metadata file over a slow link, too (some 70 kB).")
    ] = False,
    json_output: Json = False,
) -> None:
    """Show values with unit, range, meaning and description: `param show all MPC_XY_CRUISE`.

    Example: skygcs-cli param show alpha RTL_RETURN_ALT
    """

    async def command(gcs: Client) -> int:
        wanted = [n.upper() for n in names]
        described = (await gcs.call("params.metadata", targets=targets, names=wanted, read=read))["vehicles"]
        outcomes = (await gcs.call("params.get", targets=targets, names=wanted))["outcomes"]
        answer = {"metadata": described, "outcomes": outcomes}
        show(answer, json_output, lambda _: metadata_lines(described, outcomes))
        return Exit.DONE if all(o["ok"] for by_name in outcomes.values() for o in by_name.values()) else Exit.FAILED

    run(command)


@params.command("set", cls=NumbersCommand, context_settings=dict(NUMBERS))
def set_(
    targets: Targets,
    pairs: Annotated[
        list[str], typer.Argument(metavar="NAME VALUE …", help="One or more, set in this order.", show_default=False)
    ],
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Values outside their range; in the air, or in a flight, what is not listed as harmless."
        ),
    ] = False,
    json_output: OrderJson = None,
) -> None:
    """Set parameters and read them back: `param set 1 NAV_RCL_ACT 1 COM_RC_IN_MODE 4`.

    Example: skygcs-cli param set all RTL_RETURN_ALT 30
    """
    if len(pairs) % 2:
        raise typer.BadParameter(f"{pairs[-1]} is not followed by a value")
    values = {name.upper(): parse_number(text, name) for name, text in zip(pairs[::2], pairs[1::2], strict=True)}

    async def command(gcs: Client) -> int:
        output = _SetOutput(json_output)
        outcomes = await _set(gcs, targets, values, force=force, output=output)
        if json_output is True:
            print_json({"outcomes": outcomes})
        return _exit_code(outcomes)

    run(command)


@params.command("list")
def list_(
    targets: Targets,
    pattern: Annotated[
        str, typer.Argument(metavar="PATTERN", help="Only these: MPC_*, *SYSID*. Quote it for the shell.")
    ] = "*",
    refresh: Refresh = False,
    burst: Burst = False,
    json_output: Json = False,
) -> None:
    """List all parameters of vehicles, or those whose names match a pattern.

    Example: skygcs-cli param list alpha 'MPC_*'
    """

    async def command(gcs: Client) -> int:
        lists = await _lists(gcs, targets, refresh=refresh, burst=burst)
        for entry in lists.values():
            entry["params"] = [p for p in entry["params"] if fnmatch.fnmatchcase(p["name"], pattern.upper())]
        show({"lists": lists}, json_output, lambda _: list_lines(lists))
        return Exit.DONE if all(entry["ok"] for entry in lists.values()) else Exit.FAILED

    run(command)


@params.command("save")
def save(
    target: OneVehicle,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help=".params: format of QGroundControl; .param, .parm: of the other programs."),
    ],
    force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
    refresh: Refresh = False,
    burst: Burst = False,
) -> None:
    """Save all parameters of a vehicle to a file.

    Example: skygcs-cli param save alpha alpha.params
    """
    kind = kind_of(file)
    if file.exists() and not force:
        raise typer.BadParameter(f"{file} exists; --force overwrites it")

    async def command(gcs: Client) -> int:
        held = await _held(gcs, target, refresh=refresh, burst=burst)
        state = await gcs.vehicle(target)
        write_file(file, held, kind, state)
        say(f"{len(held.params)} parameters of {held.name} saved to {file}")
        return Exit.DONE

    run(command)


@params.command("apply")
def apply(
    targets: Targets,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A parameter file of any kind.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only print what would be set.")] = False,
    include: Include = "",
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Although the file seems to belong to another vehicle, or has values outside their ranges."
        ),
    ] = False,
    refresh: Refresh = False,
    burst: Burst = False,
    json_output: Json = False,
) -> None:
    """Set the parameters that differ from the file; read every value back and list what still differs.

    Calibration, statistics and system ids are left alone without --include. Nothing is sent if the file has a value
    that the vehicle cannot hold, or seems to belong to another vehicle.

    Example: skygcs-cli param apply all lab.param --dry-run
    """
    sorts = include_of(include)

    async def command(gcs: Client) -> int:
        contents = read_file(file)
        exit_code = Exit.DONE
        answers: dict[str, Any] = {}
        for entry in (await _lists(gcs, targets, refresh=refresh, burst=burst, confirmed=True)).values():
            # what would be set in this vehicle
            held = held_of(entry)
            made = _planned(contents, held, sorts)
            answers[held.name] = asdict(made)
            if not json_output:
                print_lines(plan_lines(held.name, made))
            if dry_run:
                continue
            # set it, unless the file is wrong for this vehicle
            _refuse(held.name, made, force=force)
            done = await _applied(gcs, contents, held, made, sorts, force=force, quiet=json_output)
            answers[held.name] |= done
            if done["differs"] or not all(o["ok"] for o in done["outcomes"].values()):
                exit_code = Exit.FAILED
        if json_output:
            print_json(answers)
        return exit_code

    run(command)


def _planned(contents: ParamFile, held: HeldParams, sorts: frozenset[Sort]) -> ApplyPlan:
    by_name = {p.name: p for p in held.params}
    return plan(contents, by_name, sysid=held.sysid, compid=held.compid, stack=held.autopilot, include=sorts)


async def _applied(
    gcs: Client,
    contents: ParamFile,
    held: HeldParams,
    made: ApplyPlan,
    sorts: frozenset[Sort],
    *,
    force: bool,
    quiet: bool,
) -> dict[str, Any]:
    """Set the changes of a plan, read the parameters again and report; returns the same for JSON."""

    def report(lines: Iterable[str]) -> None:
        print_lines(() if quiet else lines)

    if not made.changes:
        return {"outcomes": {}, "differs": []}
    wanted = {change.name: change.value for change in made.changes}
    outcomes = (await _set(gcs, str(held.sysid), wanted, force=force))[held.name]
    report(outcome_lines({held.name: outcomes}))
    # read again what the vehicle holds now; after a change of its identity it is another vehicle to the daemon
    left: Sequence[ParamChange] = ()
    problem = "its identity was changed" if any(c.sort == "identity" for c in made.changes) else ""
    if not problem:
        try:
            now = await _held(gcs, str(held.sysid), refresh=False, burst=False)
            left = _planned(contents, now, sorts).changes
        except RefusedError as error:
            problem = str(error)
    if problem:
        report([f"{held.name}: not read again: {problem}"])
        return {"outcomes": outcomes, "differs": None}
    report(after_lines(held.name, left))
    return {"outcomes": outcomes, "differs": [asdict(change) for change in left]}


def _refuse(name: str, made: ApplyPlan, *, force: bool) -> None:
    """Raises RefusedError if nothing of the file must be sent."""
    if made.problems:
        raise RefusedError(f"{name}: nothing was set: {'; '.join(made.problems[:10])}")
    if made.warnings and not force:
        raise RefusedError(f"{name}: nothing was set: {'; '.join(made.warnings)}; --force sets it all the same")


@params.command("diff")
def diff_(
    first: Annotated[str, typer.Argument(metavar="A", help="A file, or a vehicle.", show_default=False)],
    second: Annotated[str, typer.Argument(metavar="B", help="A file, or a vehicle.", show_default=False)],
    include: Include = "all",
    refresh: Refresh = False,
    json_output: Json = False,
) -> None:
    """Show where two sets of parameters differ; exit 1 if they do. Each is a file or a vehicle.

    Values are compared exactly, as the 32-bit floats that vehicles hold. If the program that wrote a file rounds
    (MAVProxy, Mission Planner), a value of it equals all values that round to it.

    Example: skygcs-cli param diff alpha alpha.params
    """
    sorts = include_of(include)
    notes: list[str] = []

    def from_file(name: str) -> tuple[Entry, ...]:
        contents = read_file(Path(name))
        notes.extend(rounding_note(name, contents.rounding))
        return contents.entries

    def compare(left: tuple[Entry, ...], right: tuple[Entry, ...]) -> int:
        found = [d for d in diff(left, right) if d.sort in sorts]
        keys = ("name", "other", "first", "second", "kind", "sort")
        if json_output:
            print_json([{key: getattr(d, key) for key in keys} for d in found])
        else:
            print_lines((*difference_lines(first, second, found), *notes))
        return Exit.FAILED if found else Exit.DONE

    # two files: no daemon is needed
    if all(_is_file(name) for name in (first, second)):
        run_offline(lambda: compare(from_file(first), from_file(second)))

    # at least one vehicle
    async def command(gcs: Client) -> int:
        sides = []
        for name in (first, second):
            if _is_file(name):
                sides.append(from_file(name))
            else:
                held = await _held(gcs, name, refresh=refresh, burst=False)
                sides.append(tuple(Entry(p.name, p.value) for p in held.params))
        return compare(*sides)

    run(command)


@params.command("cancel")
def cancel(targets: Targets) -> None:
    """Stop all reading and setting of parameters, by any program.

    Example: skygcs-cli param cancel all
    """

    async def command(gcs: Client) -> None:
        for name, count in (await gcs.call("params.cancel", targets=targets)).items():
            say(f"{name}: {plural(count, 'request')} stopped")

    run(command)


def _is_file(name: str) -> bool:
    """True for a file that exists or looks like one: no name of a vehicle has a slash or one of these endings."""
    return Path(name).is_file() or os.sep in name or name.endswith((".params", ".param", ".parm"))


def _show_outcomes(outcomes: OutcomesByVehicle, json_output: bool) -> int:
    show({"outcomes": outcomes}, json_output, lambda _: outcome_lines(outcomes))
    return _exit_code(outcomes)


def _exit_code(outcomes: OutcomesByVehicle) -> Exit:
    return Exit.DONE if all(o["ok"] for by_name in outcomes.values() for o in by_name.values()) else Exit.FAILED


# --- vehicles ---------------------------------------------------------------------------------------------------------


class _SetOutput:
    """Prints what was set in each vehicle when it is done; ``form`` True: nothing, one JSON object comes at the end."""

    def __init__(self, form: JsonForm) -> None:
        self._form = form
        self._width = 0

    def begin(self, vehicles: Sequence[str]) -> None:
        self._width = max((len(name) for name in vehicles), default=0)

    def take(self, vehicle: str, outcomes: Mapping[str, Mapping[str, Any]]) -> None:
        if self._form is False:
            print_json({"vehicle": vehicle, "outcome": outcomes}, line=True)
        elif self._form is None:
            clear_spinner()
            print_lines(outcome_lines({vehicle: outcomes}, self._width))
            sys.stdout.flush()


async def _set(
    gcs: Client, targets: str, values: Mapping[str, float], *, force: bool = False, output: _SetOutput | None = None
) -> dict[str, dict[str, dict[str, Any]]]:
    """Set parameters of vehicles; each vehicle's outcomes go to ``output`` when they are there."""
    shown = output or _SetOutput(True)
    async with _progress(gcs, targets):
        return await gcs.order(
            "params.set",
            on_vehicles=shown.begin,
            on_outcome=shown.take,
            targets=targets,
            params=dict(values),
            force=force,
        )


async def _lists(
    gcs: Client, targets: str, *, refresh: bool, burst: bool, confirmed: bool = False
) -> dict[str, dict[str, Any]]:
    """The parameter lists of vehicles, by name. One vehicle after another: all together could exceed one answer.

    ``confirmed``: values from an earlier run are read again unless the vehicle confirms them by more than their number.
    """
    lists: dict[str, dict[str, Any]] = {}
    for state in await gcs.vehicles(targets):
        name = state["name"]
        async with _progress(gcs, name):
            answer = await gcs.call("params.list", targets=name, refresh=refresh, burst=burst)
            if confirmed and answer["lists"][name]["vouched"] == "count":
                answer = await gcs.call("params.list", targets=name, refresh=True, burst=burst)
        lists[name] = answer["lists"][name] | {"name": name}
    if not lists:
        raise RefusedError("no vehicle has been heard yet")
    return lists


async def _held(gcs: Client, target: str, *, refresh: bool, burst: bool) -> HeldParams:
    lists = await _lists(gcs, target, refresh=refresh, burst=burst, confirmed=True)
    if len(lists) != 1:
        raise RefusedError(f"{target} names {len(lists)} vehicles ({', '.join(lists)}); give one")
    return held_of(next(iter(lists.values())))


@contextlib.asynccontextmanager
async def _progress(gcs: Client, targets: str) -> AsyncIterator[None]:
    """Show a progress bar with the time that is left while the body runs; on a terminal only."""
    if not sys.stderr.isatty():
        yield
        return
    drawing = asyncio.create_task(_draw(gcs, targets), name="progress")
    try:
        yield
    finally:
        drawing.cancel()
        await asyncio.wait([drawing])
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


async def _draw(gcs: Client, targets: str) -> None:
    async for event in gcs.events(targets, kinds=["params"]):
        say(bar(event), err=True, nl=False, over=True)


# --- files ------------------------------------------------------------------------------------------------------------


def held_of(entry: Mapping[str, Any]) -> HeldParams:
    """One entry of the answer of params.list. Raises RefusedError if it is not complete."""
    if not entry["ok"]:
        raise RefusedError(f"{entry['name']}: its parameters are not known: {entry['message']}")
    params = tuple(_param(p) for p in entry["params"] if p["value"] is not None)
    return HeldParams(entry["name"], entry["sysid"], entry["compid"], entry["autopilot"], params)


def _param(entry: Mapping[str, Any]) -> Param:
    type_ = ParamType[entry["type"]]
    value = entry["value"]
    return Param(entry["name"], int(value) if type_.integer and value == int(value) else float(value), type_)


def kind_of(path: Path) -> Kind:
    """The format, by the ending of the name. Raises BadParameter."""
    kinds: dict[str, Kind] = {".params": "qgc", ".param": "plain", ".parm": "plain"}
    kind = kinds.get(path.suffix.lower())
    if kind is None:
        raise typer.BadParameter(
            f"{path}: the name must end in .params (QGroundControl), .param or .parm (other programs)"
        )
    return kind


def include_of(text: str) -> frozenset[Sort]:
    """The sorts in "calibration,identity" or "all"; settings are always included. Raises BadParameter."""
    words = [w.strip() for w in text.split(",") if w.strip()]
    if "all" in words:
        return frozenset(SORTS)
    if wrong := [w for w in words if w not in SORTS]:
        raise typer.BadParameter(f"--include: no {', '.join(wrong)}; there are: {', '.join(SORTS)}, all")
    return frozenset(s for s in SORTS if s == "settings" or s in words)


def read_file(path: Path) -> ParamFile:
    """Raises ConfigError with line and reason."""
    try:
        content = read_named(path)
        if len(content) > 4 * MAX_CHARS:
            raise ConfigError(str(path), ["is too long for a parameter file"])
        text = content.decode("utf-8")
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is not UTF-8 text (byte {error.start})"]) from None
    return parse(text, str(path))


def write_file(path: Path, held: HeldParams, kind: Kind, state: Mapping[str, Any]) -> None:
    """Write the file whole. ``state``: of the vehicle, for the header."""
    about = {"Stack": STACKS.get(held.autopilot, held.autopilot), "Vehicle": str(state.get("type", "unknown"))}
    if state.get("firmware"):
        about["Version"] = str(state["firmware"])
    file = of_vehicle(held.params, kind, sysid=held.sysid, compid=held.compid, about=about)
    write_named(path, write(file))


# --- lines ------------------------------------------------------------------------------------------------------------


def outcome_lines(outcomes: OutcomesByVehicle, width: int = 0) -> Iterator[str]:
    """One line per vehicle and parameter; ``width``: of the vehicles' names at least."""
    width = max((width, *(len(name) for name in outcomes)))
    for vehicle, by_name in outcomes.items():
        for asked, outcome in by_name.items():
            name = asked if asked == outcome["name"] else f"{asked} ({outcome['name']})"
            word = "ok  " if outcome["ok"] else "FAIL"
            yield f"{word} {vehicle:<{width}}  {name:<{NAME_CHARS}}  {outcome['message']}"


def metadata_lines(described: Mapping[str, Mapping[str, Any]], outcomes: OutcomesByVehicle) -> Iterator[str]:
    """Each vehicle's parameters with their metadata, below the source of these."""
    for vehicle, found in described.items():
        yield f"{vehicle}: metadata of {found['source'] or 'no source: its firmware is not known'}"
        for asked, outcome in outcomes.get(vehicle, {}).items():
            known = found["parameters"].get(asked)
            if not outcome["ok"]:
                yield f"  {asked:<{NAME_CHARS}}  FAIL {outcome['message']}"
            elif known is None:
                yield f"  {outcome['name']:<{NAME_CHARS}}  {_value(outcome['value'])}  (no metadata)"
            else:
                yield from _described(outcome["name"], outcome["value"], known)


def _described(name: str, value: float | None, known: Mapping[str, Any]) -> Iterator[str]:
    """One parameter: its value with the meaning, its range, its description, and what its values and bits mean."""
    entry = ParamMetadata(
        name,
        known["unit"],
        known["least"],
        known["greatest"],
        known["reboot"],
        {float(v): text for v, text in known["values"].items()},
        {int(bit): text for bit, text in known["bits"].items()},
        known["description"],
    )
    meaning = "" if value is None else entry.meaning(value)
    unit = f" {entry.unit}" if entry.unit else ""
    within = f"  (range {entry.range_text()})" if entry.range_text() else ""
    yield f"  {name:<{NAME_CHARS}}  {_value(value)}{unit}{f' = {meaning}' if meaning else ''}{within}"
    yield f"  {'':<{NAME_CHARS}}  {entry.description}{'; takes effect after a reboot' if entry.reboot else ''}"
    if value is not None and (why := entry.outside(value) or entry.without_meaning(value)):
        yield f"  {'':<{NAME_CHARS}}  WARNING: {why}"
    for title, meanings in (("values", entry.values), ("bits", entry.bits)):
        if meanings:
            listed = ", ".join(f"{value_text(key)} {text}" for key, text in meanings.items())
            yield f"  {'':<{NAME_CHARS}}  {title}: {listed}"


def list_lines(lists: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """All parameters, each vehicle below its heading."""
    for name, entry in lists.items():
        how = "not read again" if entry["source"] == "cache" else f"read in {entry['elapsed_s']:.1f} s"
        if entry["vouched"] == "count":
            how = "from an earlier run, only their number was checked; --refresh reads them"
        yield f"{name}: {entry['message']} ({how})" if entry["ok"] else f"{name}: FAIL {entry['message']}"
        for param in entry["params"]:
            yield f"  {param['name']:<{NAME_CHARS}}  {_value(param['value']):<14} {param['type']}"


def difference_lines(first: str, second: str, found: Sequence[Difference]) -> Iterator[str]:
    if not found:
        yield "no difference"
        return
    yield f"{'':<{NAME_CHARS}}  {first}  ->  {second}"
    for d in found:
        other = f"  (there {d.other})" if d.other else ""
        note = "" if d.sort == "settings" else f"  [{d.sort}]"
        yield f"{d.name:<{NAME_CHARS}}  {_side(d.first)}  ->  {_side(d.second)}{other}{note}"


def rounding_note(name: str, rounding: Rounding) -> Iterator[str]:
    """A note about differences that a comparison with this file cannot show."""
    if rounding in WRITERS:
        yield f"{name}: its values are {WRITERS[rounding]}; smaller difference_lines do not show"


def after_lines(vehicle: str, left: Sequence[ParamChange]) -> Iterator[str]:
    """Return what differs from the file after everything was set and read again."""
    if not left:
        yield f"{vehicle}: read again, nothing differs from the file"
        return
    yield f"{vehicle}: read again, {len(left)} still {'differs' if len(left) == 1 else 'differ'} from the file:"
    for change in left:
        yield f"  {change.name:<{NAME_CHARS}}  {_value(change.before)} instead of {_value(change.value)}"


def plan_lines(vehicle: str, made: ApplyPlan) -> Iterator[str]:
    """Return what applying a file would do."""
    yield f"{vehicle}: {len(made.changes)} to set, {made.same} equal, {len(made.skipped)} left alone"
    for note in rounding_note("the file", made.rounding):
        yield f"  {note}"
    for warning in made.warnings:
        yield f"  WARNING: {warning}"
    for problem in made.problems:
        yield f"  FAIL {problem}"
    for change in made.changes:
        yield f"  {change.name:<{NAME_CHARS}}  {_value(change.before)} -> {_value(change.value)}"
    if made.skipped:
        yield f"  left alone (see --include): {enumerated((name for name, _ in made.skipped), MAX_NAMED)}"
    if made.unknown:
        yield f"  the vehicle has no {enumerated(made.unknown, MAX_NAMED)}"
        yield "  (ArduPilot has some parameters only while their feature is on: switch it on, then apply again)"
    if made.changes:
        yield "  what takes effect only after a reboot is said of each parameter that is set"


def bar(event: Mapping[str, Any]) -> str:
    """A progress bar for a progress event."""
    data = event["data"]
    percent = data.get("percent")
    if percent is None:
        return str(event["text"])
    full = BAR_CELLS * percent // 100
    left = "" if data.get("remaining_s") is None else f"  {data['remaining_s']:.0f} s left"
    counted = f"{data['received']}/{data['count']}"
    return f"{event['vehicle']}  [{'#' * full}{'.' * (BAR_CELLS - full)}] {counted}{left}"


def _side(value: float | None) -> str:
    return "-" if value is None else _value(value)


def _value(value: float | None) -> str:
    if value is None:
        return "?"
    return str(value) if isinstance(value, int) or float32(value) != value else short_float(value)


def add_to(app: typer.Typer) -> None:
    app.add_typer(params, name="param")
