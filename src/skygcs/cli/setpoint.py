"""`skygcs-cli setpoint`: stream setpoints to controlled vehicles, one from the options or those of the user's program.

A program writes one setpoint per line, as a JSON object or as a row of CSV:

    {"pos": [1, 2, 5], "yaw_deg": 90}                 also "vel", "acc", "yaw_rate_dps", "vehicle"
    {"vehicle": "bravo", "vel": [0.5, 0, 0]}
    x,y,z,yaw_deg                                     a header names the columns of the rows below it
    1,2,5,90
    1,2,5                                             without a header: x, y, z and, if present, the yaw

Vehicles under `control set raw` are flown by the user's own controller instead, in JSON or by columns of these names:

    {"att": [5, -3, 90], "thrust": 0.5}               roll, pitch, yaw in degrees, or a quaternion w, x, y, z
    {"rates": [10, 0, 0], "thrust": 0.5}              roll, pitch, yaw rate in degrees/s
    {"acc": [0.5, 0, 0]}                              m/s²; also with "yaw_deg"

Every setpoint is valid for a limited time. When the last one expires, the vehicle stays where it then is. So nothing
has to be undone at the end: when the stream stops or its program dies, the vehicles hold their positions.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import typer

from skygcs.cli.connection import Exit, bytes_of, fail, run
from skygcs.cli.options import Json, Targets
from skygcs.cli.parsing import finite, parse_json, parse_unset_number, within
from skygcs.cli.render import plural, print_json, say
from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.rpc.client import Client
from skygcs.rpc.error_codes import INVALID_PARAMS, TARGET_ERROR
from skygcs.spelling import is_number

DEFAULT_HZ = 10.0
LEAST_HZ = 0.2
"""One setpoint in LARGEST_VALID_S."""

LARGEST_HZ = 100.0
"""More than twice the default rate of the control loop: it does not fly what comes faster."""

VALID_S = 0.5
"""How long a setpoint is valid, unless the rate is so low that it would expire before the next one."""

LARGEST_VALID_S = 5.0

Vector = tuple[str, str, str]
Position = Annotated[
    Vector | None,
    typer.Option("--pos", metavar="X Y Z", help="Metres in the fleet's frame; -: not given.", show_default=False),
]
Velocity = Annotated[
    Vector | None,
    typer.Option(
        "--vel", metavar="X Y Z", help="m/s; feed-forward for an axis that has a position.", show_default=False
    ),
]
Yaw = Annotated[
    float | None,
    typer.Option("--yaw", metavar="DEG", help="From the frame's x axis, counter-clockwise.", parser=finite),
]
YawRate = Annotated[
    float | None,
    typer.Option(
        "--yaw-rate",
        metavar="DPS",
        help="Turn, degrees per second, counter-clockwise; without --yaw from where the nose is.",
        parser=finite,
    ),
]
Attitude = Annotated[
    Vector | None,
    typer.Option("--att", metavar="ROLL PITCH YAW", help="Raw: degrees; with --thrust.", show_default=False),
]
QuaternionOption = Annotated[
    tuple[str, str, str, str] | None,
    typer.Option("--quat", metavar="W X Y Z", help="Raw: attitude as a quaternion; with --thrust.", show_default=False),
]
BodyRates = Annotated[
    Vector | None,
    typer.Option("--rates", metavar="ROLL PITCH YAW", help="Raw: degrees/s; with --thrust.", show_default=False),
]
Thrust = Annotated[float | None, typer.Option("--thrust", metavar="0..1", help="Raw: collective.", parser=finite)]
Acceleration = Annotated[
    Vector | None, typer.Option("--acc", metavar="X Y Z", help="m/s²: feed-forward; alone: raw.", show_default=False)
]
Duration = Annotated[
    float | None, typer.Option("--for", metavar="S", help="Stop after S seconds; default: at Ctrl-C.", parser=finite)
]
RateHz = Annotated[
    float | None,
    typer.Option(
        "--rate", metavar="HZ", help="Setpoints per second, default 10. With --stdin: lines per second.", parser=finite
    ),
]
Stdin = Annotated[
    bool,
    typer.Option(
        "--stdin", help="Read setpoints from standard input, JSON lines or CSV; each time the newest is sent."
    ),
]
Valid = Annotated[
    float | None,
    typer.Option(
        "--valid", metavar="S", help="How long each is valid; then the vehicle stays where it is.", parser=finite
    ),
]
TakeOver = Annotated[
    bool, typer.Option("--take-over", help="Although they follow the setpoints of another client, which loses them.")
]


def setpoint(
    targets: Targets,
    position: Position = None,
    velocity: Velocity = None,
    yaw: Yaw = None,
    yaw_rate: YawRate = None,
    attitude: Attitude = None,
    quaternion: QuaternionOption = None,
    rates: BodyRates = None,
    thrust: Thrust = None,
    acceleration: Acceleration = None,
    duration_s: Duration = None,
    rate_hz: RateHz = None,
    stdin: Stdin = False,
    valid_s: Valid = None,
    take_over: TakeOver = False,
    json_output: Json = False,
) -> None:
    """Stream setpoints to vehicles under `control`.

    From your own program: `./my-planner | skygcs-cli setpoint alpha --stdin`, one line each: {"pos": [5, -3, 10]} or
    5,-3,10. Level flight: `--vel 1 0 - --pos - - 10`. When the setpoints end, vehicles stay where they then are.
    Under `control set alpha raw`: `--att 5 0 90 --thrust 0.5`, `--rates 10 0 0 --thrust 0.5`, `--acc 0.5 0 0`.

    Example: skygcs-cli setpoint alpha --pos 5 -3 10 --yaw 90 --for 20
    """
    given = _given(position, velocity, yaw, yaw_rate, acceleration)
    given.update(_given_raw(attitude, quaternion, rates, thrust))
    if stdin and (given or duration_s is not None):  # with --stdin the lines supply the setpoints
        raise typer.BadParameter(
            "--stdin supplies the setpoints: give no --pos, --vel, --yaw, --yaw-rate, --for or raw setpoint with it"
        )
    if not stdin:
        try:
            given = checked(given)
        except LineError as error:
            raise typer.BadParameter(f"{error}: give --pos X Y Z, --vel X Y Z, a raw setpoint, or --stdin") from None
    within("--for", duration_s, 0.0, 86400.0)
    rate, valid_for_s = _pace(rate_hz, valid_s, stdin=stdin)

    async def command(gcs: Client) -> int:
        sender = Sender(gcs, valid_for_s, fail, take_over=take_over)
        if rate is None or stdin:  # from standard input, or one setpoint repeated
            sending = forward(sender, targets, bytes_of(sys.stdin.fileno()), rate)
        else:
            if sys.stderr.isatty():
                say(f"streaming to {targets} at {rate:g} Hz; Ctrl-C stops", err=True)
            sending = repeat(sender, targets, given, rate, duration_s)
        began = asyncio.get_running_loop().time()
        after = f"from {valid_for_s:g} s after the last setpoint on, still under control"
        try:  # send until the source ends
            await sending
        except DaemonUnreachable:
            after = "only if its autopilot's failsafe does so: the daemon, which sent the setpoints, is gone"
            raise
        finally:
            _report_end(sender.tally, asyncio.get_running_loop().time() - began, after, json_output)
        return Exit.DONE if sender.tally.ok else Exit.FAILED

    run(command)


def _pace(rate_hz: float | None, valid_s: float | None, *, stdin: bool) -> tuple[float | None, float]:
    """Setpoints per second (None: as they come) and how long each is valid. Raises BadParameter."""
    within("--rate", rate_hz, LEAST_HZ, LARGEST_HZ)
    within("--valid", valid_s, 0.1, LARGEST_VALID_S)
    rate = DEFAULT_HZ if rate_hz is None and not stdin else rate_hz
    if valid_s is None:
        valid_s = VALID_S if rate is None else min(max(VALID_S, 2.5 / rate), LARGEST_VALID_S)
    if rate is not None and valid_s * rate < 1:
        raise typer.BadParameter(f"--valid {valid_s:g} s: it expires before the next one comes at {rate:g} Hz")
    return rate, valid_s


def _given(
    position: Vector | None,
    velocity: Vector | None,
    yaw: float | None,
    yaw_rate: float | None,
    acceleration: Vector | None,
) -> dict[str, Any]:
    """The options as parameters of control.setpoint. Raises BadParameter."""
    given: dict[str, Any] = {}
    if acceleration is not None:
        given["acc_enu_mps2"] = [finite(value) for value in acceleration]
    for option, parameter, vector in (("--pos", "pos_enu_m", position), ("--vel", "vel_enu_mps", velocity)):
        if vector is not None:
            given[parameter] = [parse_unset_number(value, option) for value in vector]
    for parameter, value in ((YAW, yaw), (YAW_RATE, yaw_rate)):
        if value is not None:
            given[parameter] = value
    return given


def _given_raw(
    attitude: Vector | None, quaternion: tuple[str, str, str, str] | None, rates: Vector | None, thrust: float | None
) -> dict[str, Any]:
    """The options of a raw setpoint as parameters of control.setpoint. Raises BadParameter."""
    given: dict[str, Any] = {}
    if attitude is not None:
        given.update(zip(ANGLES, map(finite, attitude), strict=True))
    if quaternion is not None:
        given["attitude"] = [finite(value) for value in quaternion]
    if rates is not None:
        given["body_rates_deg_s"] = [finite(value) for value in rates]
    return given if thrust is None else {**given, "thrust": thrust}


def _report_end(tally: SetpointTally, elapsed_s: float, after: str, json_output: bool) -> None:
    """Print what was sent and what the vehicles do now; also after Ctrl-C and when the daemon went away."""
    if json_output:
        answer = {
            "sent": tally.sent,
            "refused_by_all": tally.no_taker,
            "skipped": tally.skipped,
            "wrong_lines": tally.wrong_lines,
            "elapsed_s": round(elapsed_s, 3),
            "outcomes": tally.outcomes,
        }
        print_json(answer)
        return
    further = (
        ("refused by all", tally.no_taker),
        ("skipped for newer ones", tally.skipped),
        ("wrong lines", tally.wrong_lines),
    )
    counts = "".join(f", {what}: {count:,}" for what, count in further if count)
    count = tally.sent - tally.no_taker
    say(f"{plural(count, 'setpoint') if count else 'no setpoints'} in {elapsed_s:.1f} s{counts}")
    took = [name for name, outcome in tally.outcomes.items() if outcome["ok"]]
    if took:
        stay = "stays where it is" if len(took) == 1 else "stay where they are"
        say(f"{', '.join(took)} {stay} {after}")


# --- lines ------------------------------------------------------------------------------------------------------------

LARGEST_LINE = 1024
"""Bytes. A setpoint with all its numbers has about 300."""

VECTORS = {
    "pos": ("pos_enu_m", ("x", "y", "z")),
    "vel": ("vel_enu_mps", ("vx", "vy", "vz")),
    "acc": ("acc_enu_mps2", ("ax", "ay", "az")),
}
"""By key in JSON: the parameter of control.setpoint, and the columns in CSV."""

YAW = "yaw_deg"
YAW_RATE = "yaw_rate_dps"
VEHICLE = "vehicle"
THRUST = "thrust"
ANGLES = ("roll_deg", "pitch_deg", YAW)
RATES = ("roll_rate", "pitch_rate", "yaw_rate")
QUATERNION = ("qw", "qx", "qy", "qz")
KEYS = (*VECTORS, YAW, YAW_RATE, "att", "rates", THRUST, VEHICLE)
"""Keys that a JSON line may have."""

COLUMNS = (
    *(column for _, columns in VECTORS.values() for column in columns),
    *(*ANGLES, YAW_RATE, *RATES, *QUATERNION, THRUST, VEHICLE),
)
DEFAULT_COLUMNS = ("x", "y", "z", YAW)


class LineError(Exception):
    """A line that is not a setpoint; the text is the reason."""


class SplitLines:
    """Splits a stream of bytes into numbered lines. A line that is too long is reported and skipped."""

    def __init__(self) -> None:
        self._rest = b""
        self._number = 0
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[tuple[int, str | None]]:
        """Number and text of every line that is complete now; the text of a line that is too long is None."""
        *lines, rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._number += 1
            too_long, self._skipping = self._skipping or len(line) > LARGEST_LINE, False
            yield self._number, None if too_long else line.decode("utf-8", "replace").strip()
        self._skipping = self._skipping or len(rest) > LARGEST_LINE
        self._rest = b"" if self._skipping else rest

    def end(self) -> Iterator[tuple[int, str | None]]:
        """The last line, if it does not end with a newline."""
        if self._rest or self._skipping:
            yield from self.feed(b"\n")


class LineReader:
    """Converts lines to parameters of control.setpoint. Remembers the columns that a header named."""

    def __init__(self) -> None:
        self._columns: tuple[str, ...] | None = None
        self._began = False

    def read(self, line: str) -> tuple[str | None, dict[str, Any]] | None:
        """The target vehicle (None: all targets of the command) and the setpoint; None for a line without a setpoint.

        Raises LineError.
        """
        if not line or line.startswith("#"):
            return None
        if line.startswith("{"):
            return _from_json(line)
        cells = [cell.strip() for cell in line.split(",")]
        first, self._began = not self._began, True
        if first and any(cell in COLUMNS for cell in cells) and not any(_is_text_of_number(cell) for cell in cells):
            self._columns = _header(cells)
            return None
        return _from_cells(line, cells, self._columns)


def _from_json(line: str) -> tuple[str | None, dict[str, Any]]:
    try:
        given = parse_json(line)
    except (ValueError, RecursionError) as error:
        raise LineError(f"not JSON: {error}") from None
    unknown = [key for key in given if key not in KEYS]
    if unknown:
        raise LineError(f"no key {unknown[0][:40]!r}; there are: {', '.join(KEYS)}")
    setpoint: dict[str, Any] = {}
    for key, (parameter, _) in VECTORS.items():
        if key in given:
            value = given[key]
            if not (isinstance(value, list) and len(value) == 3 and all(x is None or is_number(x) for x in value)):
                raise LineError(f"{key}: must be a list of three numbers (null: not given)")
            setpoint[parameter] = [None if x is None else float(x) for x in value]
    for key in (YAW, YAW_RATE):
        if given.get(key) is not None:
            if not is_number(given[key]):
                raise LineError(f"{key}: must be a number")
            setpoint[key] = float(given[key])
    setpoint.update(_raw_from_json(given))
    vehicle = given.get(VEHICLE)
    if vehicle is not None and not isinstance(vehicle, str | int):
        raise LineError(f"{VEHICLE}: must be a name or a system id")
    return (None if vehicle is None else str(vehicle)), checked(setpoint)


def _raw_from_json(given: Mapping[str, Any]) -> dict[str, Any]:
    """The raw part of a JSON line. Raises LineError."""
    raw: dict[str, Any] = {}
    for key, lengths in (("att", (3, 4)), ("rates", (3,))):
        values = given.get(key)
        if values is None:
            continue
        if not (isinstance(values, list) and len(values) in lengths and all(map(is_number, values))):
            raise LineError(f"{key}: must be a list of {' or '.join(map(str, lengths))} numbers")
        numbers = [float(value) for value in values]
        if key == "rates":
            raw["body_rates_deg_s"] = numbers
        elif len(numbers) == 4:
            raw["attitude"] = numbers
        else:
            if given.get(YAW) is not None:
                raise LineError(f"att has the yaw: give no {YAW} beside it")
            raw.update(zip(ANGLES, numbers, strict=True))
    if given.get(THRUST) is not None:
        if not is_number(given[THRUST]):
            raise LineError(f"{THRUST}: must be a number")
        raw[THRUST] = float(given[THRUST])
    return raw


def _header(cells: list[str]) -> tuple[str, ...]:
    unknown = [cell for cell in cells if cell not in COLUMNS]
    if unknown:
        raise LineError(f"no column {unknown[0][:40]!r}; there are: {', '.join(COLUMNS)}")
    if len(set(cells)) != len(cells):
        raise LineError("a column is named twice")
    return tuple(cells)


def _from_cells(line: str, cells: list[str], columns: tuple[str, ...] | None) -> tuple[str | None, dict[str, Any]]:
    if columns is None:
        if len(cells) not in (3, 4):
            raise LineError(f"{line[:40]!r} is neither JSON nor a row x,y,z or x,y,z,yaw_deg")
        columns = DEFAULT_COLUMNS[: len(cells)]
    if len(cells) != len(columns):
        raise LineError(f"{len(cells)} cells; the header has {len(columns)}")
    row = {column: cell for column, cell in zip(columns, cells, strict=True) if cell}
    vehicle = row.pop(VEHICLE, None)
    values = {column: _number(column, cell) for column, cell in row.items()}
    setpoint: dict[str, Any] = {}
    for parameter, names in VECTORS.values():
        if any(name in values for name in names):
            setpoint[parameter] = [values.get(name) for name in names]
    whole: tuple[tuple[str, tuple[str, ...]], ...] = (("body_rates_deg_s", RATES), ("attitude", QUATERNION))
    for parameter, of_raw in whole:
        if any(name in values for name in of_raw):
            if not all(name in values for name in of_raw):
                raise LineError(f"{', '.join(of_raw)}: give all of them or none")
            setpoint[parameter] = [values[name] for name in of_raw]
    setpoint.update({name: values[name] for name in (*ANGLES, YAW_RATE, THRUST) if name in values})
    return vehicle, checked(setpoint)


def checked(setpoint: Mapping[str, Any]) -> dict[str, Any]:
    """The setpoint, if every axis has a position or a velocity, or if it is raw. Raises LineError."""
    raw = [key for key in ("roll_deg", "pitch_deg", "attitude", "body_rates_deg_s", THRUST) if key in setpoint]
    placed = [key for key in ("pos_enu_m", "vel_enu_mps") if any(v is not None for v in setpoint.get(key) or ())]
    if raw and placed:
        raise LineError("attitude, body rates and thrust exclude position and velocity")
    if not placed and (raw or "acc_enu_mps2" in setpoint):
        return _checked_raw(setpoint)
    position = setpoint.get("pos_enu_m") or [None] * 3
    velocity = setpoint.get("vel_enu_mps") or [None] * 3
    if not any(value is not None for value in (*position, *velocity)):
        raise LineError("neither a position nor a velocity")
    if (position[0] is None) != (position[1] is None):
        raise LineError("a position of x without y, or of y without x: give both, or neither")
    for axis, p, v in zip("xyz", position, velocity, strict=True):
        if p is None and v is None:
            raise LineError(f"{axis} has neither a position nor a velocity")
    if None in setpoint.get("acc_enu_mps2", ()):
        raise LineError("an acceleration needs all three axes")
    return dict(setpoint)


def _checked_raw(setpoint: Mapping[str, Any]) -> dict[str, Any]:
    """A raw setpoint, if it is whole; its limits are the daemon's. Raises LineError."""
    angles = [key for key in ANGLES[:2] if key in setpoint]
    kinds = ("attitude" in setpoint, bool(angles), "body_rates_deg_s" in setpoint, "acc_enu_mps2" in setpoint)
    if sum(kinds) != 1:
        raise LineError("a raw setpoint is an attitude, body rates or an acceleration: one of them")
    if angles and not all(key in setpoint for key in ANGLES):
        raise LineError("an attitude by angles needs roll, pitch and yaw")
    if "acc_enu_mps2" in setpoint:
        if None in setpoint["acc_enu_mps2"]:
            raise LineError("an acceleration needs all three axes")
        if THRUST in setpoint:
            raise LineError("an acceleration has no thrust beside it")
    elif THRUST not in setpoint:
        raise LineError("an attitude or body rates need a thrust")
    return dict(setpoint)


def _number(column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise LineError(f"{column}: {cell[:40]!r} is not a number") from None
    if not math.isfinite(value):
        raise LineError(f"{column}: {cell[:40]!r} is not a finite number")
    return value


def _is_text_of_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


# --- stream -----------------------------------------------------------------------------------------------------------

MOST_WAITING = 256
"""Setpoints that wait at the same time, one for each vehicle; there are at most 255 system ids. With --rate, what was
read at once (65,536 bytes) comes on top."""

MOST_REFUSED = 50
"""In a row: 5 s at the default rate. In this time `control set` can be called while the program runs already."""

LINE_ERRORS = (INVALID_PARAMS, TARGET_ERROR)
"""RPC error codes that a wrong line causes: wrong parameters, no such vehicle."""

ERRORS_SHOWN = 10
"""Wrong lines that are reported one by one; a faulty program may write thousands of them."""

Setpoint = Mapping[str, Any]


@dataclass
class SetpointTally:
    """Counts of what was sent, skipped and refused."""

    sent: int = 0
    """Setpoints sent to the daemon, whatever it answered."""
    no_taker: int = 0
    """Setpoints of ``sent`` that every vehicle refused."""
    skipped: int = 0
    """Not sent because a newer one had arrived, or because the daemon took longer than one period to answer."""
    wrong_lines: int = 0
    outcomes: dict[str, dict[str, Any]] = field(default_factory=dict)
    """The last outcome of each vehicle."""
    refused: dict[str, str] = field(default_factory=dict)
    """The first reason of every vehicle that refused a setpoint at any time."""

    @property
    def ok(self) -> bool:
        return self.sent > 0 and not self.refused and not self.wrong_lines


class Sender:
    """Sends setpoints one after the other. ``report(text)`` gets every change: refused, accepted again."""

    def __init__(self, gcs: Client, valid_s: float, report: Callable[[str], None], *, take_over: bool = False) -> None:
        self.tally = SetpointTally()
        self.report = report
        self._gcs = gcs
        self._way: dict[str, Any] = {"valid_s": valid_s, **({"take_over": True} if take_over else {})}
        """Parameters that all of them have."""

    async def send(self, targets: str, setpoint: Setpoint) -> bool:
        """True if any vehicle accepted it. Raises RpcError as `Client.call`."""
        self.tally.sent += 1  # before the answer: an interrupted wait counts as sent, too
        answer = await self._gcs.call("control.setpoint", targets=targets, **setpoint, **self._way)
        outcomes: dict[str, dict[str, Any]] = answer["outcomes"]
        news: dict[str, list[str]] = {}
        for name, outcome in outcomes.items():
            before = self.tally.outcomes.get(name)
            self.tally.outcomes[name] = outcome
            if not outcome["ok"]:
                self.tally.refused.setdefault(name, outcome["message"])
                if before is None or before["ok"] or before["message"] != outcome["message"]:
                    news.setdefault(outcome["message"], []).append(name)
            elif before is not None and not before["ok"]:
                self.report(f"{name} accepts setpoints again")
        for message, names in news.items():
            self.report(f"{', '.join(names)}: {message}")
        taken = any(outcome["ok"] for outcome in outcomes.values())
        self.tally.no_taker += not taken
        return taken


async def repeat(sender: Sender, targets: str, setpoint: Setpoint, rate_hz: float, duration_s: float | None) -> None:
    """Send the same setpoint at a rate, on absolute times; stop early if no vehicle accepts it."""
    clock = asyncio.get_running_loop().time
    began = clock()
    tick = 0
    while duration_s is None or tick < max(1, round(duration_s * rate_hz)):
        if not await sender.send(targets, setpoint):
            return
        late = int((clock() - began) * rate_hz) - tick
        sender.tally.skipped += max(0, late)
        tick += 1 + max(0, late)
        await asyncio.sleep(began + tick / rate_hz - clock())


class SetpointInbox:
    """Setpoints that wait to be sent. ``newest_only``: for each vehicle the newest one."""

    def __init__(self, targets: str, tally: SetpointTally, report: Callable[[str], None], *, newest_only: bool) -> None:
        self._targets = targets
        self._tally = tally
        self._report = report
        self._newest_only = newest_only
        self._lines = SplitLines()
        self._reader = LineReader()
        self._waiting: list[tuple[int, str, Setpoint]] = []
        self._news = asyncio.Event()
        self.room = asyncio.Event()
        """Set while more can be fed without dropping any."""
        self.room.set()
        self._ended = False

    def feed(self, data: bytes) -> None:
        """Take in bytes that were read; b"" is the end."""
        for number, line in self._lines.feed(data) if data else self._lines.end():
            try:
                if line is None:
                    raise LineError("too long for a setpoint")
                found = self._reader.read(line)
            except LineError as error:
                self.wrong(number, str(error))
                continue
            if found is not None:
                self._put(number, found[0] or self._targets, found[1])
        self._ended = self._ended or not data
        self._news.set()
        if len(self._waiting) >= MOST_WAITING:
            self.room.clear()

    async def take(self) -> tuple[int, str, Setpoint] | None:
        """The next setpoint: line number, targets, setpoint. None at the end."""
        while not self._waiting:
            if self._ended:
                return None
            self._news.clear()
            await self._news.wait()
        if len(self._waiting) <= MOST_WAITING:
            self.room.set()
        return self._waiting.pop(0)

    def _put(self, number: int, targets: str, setpoint: Setpoint) -> None:
        if self._newest_only:
            for i, (_, other, _) in enumerate(self._waiting):
                if other == targets:
                    self._waiting[i] = (number, targets, setpoint)
                    self._tally.skipped += 1
                    return
            if len(self._waiting) >= MOST_WAITING:
                self._waiting.pop(0)
                self._tally.skipped += 1
        self._waiting.append((number, targets, setpoint))

    def wrong(self, number: int, reason: str) -> None:
        """Count and report a line that is not a setpoint."""
        self._tally.wrong_lines += 1
        if self._tally.wrong_lines <= ERRORS_SHOWN:
            self._report(f"line {number}: {reason}")
            if self._tally.wrong_lines == ERRORS_SHOWN:
                self._report("further wrong lines are only counted")


async def forward(sender: Sender, targets: str, source: AsyncIterator[bytes], rate_hz: float | None) -> None:
    """Send the setpoints in the lines of ``source`` until it ends.

    Without a rate the source sets the pace: a line is sent when it arrives, only the newest if lines arrive faster than
    the daemon answers. With a rate all are sent one after the other, so many per second, for example from a file.
    """
    # one task reads lines into the inbox
    inbox = SetpointInbox(targets, sender.tally, sender.report, newest_only=rate_hz is None)
    clock = asyncio.get_running_loop().time

    async def fill() -> None:
        try:
            async for data in source:
                inbox.feed(data)
                if rate_hz is not None:
                    await inbox.room.wait()
        finally:
            inbox.feed(b"")

    filling = asyncio.create_task(fill(), name="setpoint lines")
    # this one sends what is in it
    refused = 0
    due = clock()
    try:
        while (found := await inbox.take()) is not None:
            number, addressee, setpoint = found
            try:
                refused = 0 if await sender.send(addressee, setpoint) else refused + 1
            except RpcError as error:
                if error.code not in LINE_ERRORS:
                    raise
                inbox.wrong(number, str(error))
            if refused >= MOST_REFUSED:
                sender.report(f"{refused} setpoints in a row were refused: stopped sending")
                return
            if rate_hz is not None:
                due = max(due + 1 / rate_hz, clock())
                await asyncio.sleep(due - clock())
    finally:
        filling.cancel()
        await asyncio.wait([filling])
    if not filling.cancelled():
        filling.result()  # raises the error that ended the reading


def add_to(app: typer.Typer) -> None:
    app.command()(setpoint)
