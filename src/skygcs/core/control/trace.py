"""The control trace of one vehicle: every tick as CSV, exact enough to run the law over it again (control-trace.md).

    # format = "skygcs control trace 2"          lines with # are remarks: a key and its value as JSON
    # vehicle = "alpha"
    # local_origin = {"lat_deg": …, "lon_deg": …, "alt_amsl_m": …}
    t_s,dt_s,control_mode,…                      the columns, once
    # config = {…}                               valid from the next row on; repeated when the gains change
    # memory = {…}                               the next step's memory, if it differs from what the last step returned
    0.0,0.02,attitude,…                          a row per tick; a cell without a value is empty

Floats are written by `repr`, so that reading gives the same bits. Positions are ENU relative to the local origin,
angles in radians, yaw 0 = east and counter-clockwise positive; the rest is as in skygcs.core.control.cascade. A line
ends with a newline: a last line without one was cut by a crash and is ignored.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, TypeVar

from skygcs.core.control.cascade import (
    LARGEST_INPUT,
    Estimate,
    Memory,
    Output,
    Quaternion,
    Reference,
    Saturation,
    Vector,
    step,
    velocity_step,
)
from skygcs.core.control.gains import AxisGains, ControlConfig
from skygcs.core.control.velocity_loop import record
from skygcs.core.control.velocity_predictor import (
    AutopilotLoop,
    PredictedSetpoint,
    PredictorMemory,
    SentVelocity,
    Timing,
    predicted_setpoint,
)
from skygcs.errors import ConfigError, TraceError

FORMAT = "skygcs control trace 2"
FORMATS = ("skygcs control trace 1", FORMAT)
"""Those that are read. The first has no columns of prediction."""

LARGEST_LINE = 16384
"""Characters. A row has at most 49 cells of 24 and the names of all limits (some 1200), a config remark some 400, and
what a predictor remembers 64 setpoints of 7 numbers (some 10,000)."""


LARGEST_TIME_S = 1e12
"""Largest time of a loop's clock, which counts from any beginning: 30,000 years."""


ATTITUDE, VELOCITY, POSITION, RAW = "attitude", "velocity", "position", "raw"
CONTROL_MODES = (ATTITUDE, VELOCITY, POSITION, RAW)
"""Which loops are closed here: all of them; the position loop; none; those of the user's own controller."""

COLUMNS_1 = (
    *("t_s", "dt_s", "control_mode", "following"),
    *("ref_x_m", "ref_y_m", "ref_z_m", "ref_yaw_rad", "ref_vx_mps", "ref_vy_mps", "ref_vz_mps"),
    *("ref_ax_mps2", "ref_ay_mps2", "ref_az_mps2", "vel_only_xy", "vel_only_z"),
    *("x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps", "state_age_s"),
    *("out_w", "out_x", "out_y", "out_z", "thrust", "vel_sp_x_mps", "vel_sp_y_mps", "vel_sp_z_mps"),
    *("int_x", "int_y", "int_z", "saturation"),
)
"""Columns of the first format, whose traces are still read."""

COLUMNS = (
    *COLUMNS_1,
    *("round_trip_s", "hold_s", "acc_sp_x_mps2", "acc_sp_y_mps2", "acc_sp_z_mps2"),
    *("pred_x_m", "pred_y_m", "pred_z_m", "dist_x_mps2", "dist_y_mps2", "dist_z_mps2"),
    *("rate_roll_radps", "rate_pitch_radps", "rate_yaw_radps"),
)
"""The last fourteen are those of velocity control with prediction and of raw setpoints, empty without them."""

FIRST_OUTPUT = COLUMNS.index("out_w")
"""Columns from here on are what the law answered; those before are what it was asked."""

_LIMITS = frozenset(limit.name for limit in fields(Saturation))


@dataclass(frozen=True, slots=True)
class TraceRow:
    """One tick: what the law was given, and what came of it. ``with_output`` fills in the latter."""

    t_s: float
    """Time of the loop's clock, which has no date: only differences mean anything."""
    dt_s: float
    """Measured since the last tick, as handed to `step`: not clamped."""
    control_mode: str | None
    """One of `CONTROL_MODES`; None: nothing was sent in this tick."""
    following: bool
    reference: Reference | None
    estimate: Estimate | None
    state_age_s: float | None
    attitude_ned_frd: Quaternion | None = None
    thrust: float | None = None
    vel_setpoint_enu_mps: Vector | None = None
    integral_enu: Vector | None = None
    """After the step."""
    saturation: tuple[str, ...] = ()
    """Names of `Saturation`."""
    round_trip_s: float | None = None
    """Measured, as velocity control with prediction was given it; None: without prediction."""
    hold_s: float | None = None
    acc_setpoint_enu_mps2: Vector | None = None
    """Acceleration setpoint of velocity control with prediction, or of the user's own controller."""
    predicted_enu_m: Vector | None = None
    """Predicted position at the moment at which the setpoint acts."""
    disturbance_enu_mps2: Vector | None = None
    rates_frd_radps: Vector | None = None
    """Body rates that the user's own controller requested."""

    def with_output(self, output: Output | None, memory: Memory) -> TraceRow:
        """The same tick with what `step` returned."""
        return replace(
            self,
            attitude_ned_frd=None if output is None else output.attitude_ned_frd,
            thrust=None if output is None else output.collective_thrust,
            vel_setpoint_enu_mps=None if output is None else output.vel_setpoint_enu_mps,
            integral_enu=memory.integral_enu,
            saturation=() if output is None else output.saturation.names(),
        )

    def with_velocity(self, vel_setpoint_enu_mps: Vector | None) -> TraceRow:
        """The same tick with what `velocity_step` returned."""
        return replace(self, vel_setpoint_enu_mps=vel_setpoint_enu_mps)

    def with_prediction(self, setpoint: PredictedSetpoint | None) -> TraceRow:
        """The same tick with what `predicted_setpoint` returned."""
        return replace(
            self,
            vel_setpoint_enu_mps=None if setpoint is None else setpoint.vel_enu_mps,
            acc_setpoint_enu_mps2=None if setpoint is None else setpoint.acc_enu_mps2,
            predicted_enu_m=None if setpoint is None else setpoint.pos_enu_m,
            disturbance_enu_mps2=None if setpoint is None else setpoint.disturbance_enu_mps2,
        )


def encode(row: TraceRow) -> str:
    """One row without its newline."""
    return ",".join(cells(row))


def cells(row: TraceRow) -> list[str]:
    """The row's cells, in the order of `COLUMNS`."""
    return [
        _number(row.t_s),
        _number(row.dt_s),
        "" if row.control_mode is None else str(row.control_mode),
        _flag(row.following),
        *_reference_cells(row.reference),
        *_numbers(None if row.estimate is None else (*row.estimate.pos_enu_m, *row.estimate.vel_enu_mps), 6),
        _number(row.state_age_s),
        *_numbers(row.attitude_ned_frd, 4),
        _number(row.thrust),
        *_numbers(row.vel_setpoint_enu_mps, 3),
        *_numbers(row.integral_enu, 3),
        " ".join(row.saturation),
        _number(row.round_trip_s),
        _number(row.hold_s),
        *_numbers(row.acc_setpoint_enu_mps2, 3),
        *_numbers(row.predicted_enu_m, 3),
        *_numbers(row.disturbance_enu_mps2, 3),
        *_numbers(row.rates_frd_radps, 3),
    ]


def _reference_cells(reference: Reference | None) -> list[str]:
    if reference is None:
        return [""] * 12
    r = reference
    numbers = (*r.pos_enu_m, r.yaw_rad, *r.vel_enu_mps, *r.acc_enu_mps2)
    return [*_numbers(numbers, 10), _flag(r.velocity_only_xy), _flag(r.velocity_only_z)]


def _numbers(values: tuple[float, ...] | None, count: int) -> list[str]:
    return [""] * count if values is None else [_number(value) for value in values]


def _number(value: float | None) -> str:
    return "" if value is None else repr(float(value))  # numpy's floats have a repr of their own


def _flag(value: bool) -> str:
    return "1" if value else "0"


def decode_row(number: int, line: str) -> TraceRow:
    """One row, newline removed; of the first format or of this one. Raises TraceError with the line's ``number``."""
    cells = line.split(",")
    if len(cells) not in (len(COLUMNS), len(COLUMNS_1)):
        raise TraceError(number, f"{len(cells)} cells; a row has {len(COLUMNS)}")
    cells += [""] * (len(COLUMNS) - len(cells))
    return _RowReader(number, cells).row()


class _RowReader:
    """Cells of one row, taken from left to right."""

    def __init__(self, number: int, cells: list[str]) -> None:
        self._number = number
        self._cells = cells
        self._next = 0

    def row(self) -> TraceRow:
        return TraceRow(
            t_s=self._float(),
            dt_s=self._float(),
            control_mode=self._word(CONTROL_MODES),
            following=self._flag(),
            reference=self._reference(),
            estimate=self._estimate(),
            state_age_s=self._maybe(),
            attitude_ned_frd=self._quaternion(),
            thrust=self._maybe(),
            vel_setpoint_enu_mps=self._maybe_vector(),
            integral_enu=self._maybe_vector(),
            saturation=self._saturation(),
            round_trip_s=self._maybe(),
            hold_s=self._maybe(),
            acc_setpoint_enu_mps2=self._maybe_vector(),
            predicted_enu_m=self._maybe_vector(),
            disturbance_enu_mps2=self._maybe_vector(),
            rates_frd_radps=self._maybe_vector(),
        )

    def _cell(self) -> str:
        self._next += 1
        return self._cells[self._next - 1]

    def _wrong(self, cell: str, wanted: str) -> TraceError:
        return TraceError(self._number, f"{COLUMNS[self._next - 1]}: {cell[:40]!r} is not {wanted}")

    def _float(self) -> float:
        cell = self._cell()
        try:
            return float(cell)
        except ValueError:
            raise self._wrong(cell, "a number") from None

    def _maybe(self) -> float | None:
        if self._cells[self._next] == "":
            self._next += 1
            return None
        return self._float()

    def _flag(self) -> bool:
        cell = self._cell()
        if cell not in ("0", "1"):
            raise self._wrong(cell, "0 or 1")
        return cell == "1"

    def _word(self, words: tuple[str, ...]) -> str | None:
        cell = self._cell()
        if cell and cell not in words:
            raise self._wrong(cell, f"one of {', '.join(words)}")
        return cell or None

    def _vector(self) -> Vector:
        return self._float(), self._float(), self._float()

    def _empty(self, count: int) -> bool:
        """True if the next ones are all empty; they are taken then."""
        if any(self._cells[self._next : self._next + count]):
            return False
        self._next += count
        return True

    def _maybe_vector(self) -> Vector | None:
        return None if self._empty(3) else self._vector()

    def _quaternion(self) -> Quaternion | None:
        return None if self._empty(4) else (self._float(), *self._vector())

    def _estimate(self) -> Estimate | None:
        return None if self._empty(6) else Estimate(self._vector(), self._vector())

    def _reference(self) -> Reference | None:
        if self._empty(12):
            return None
        return Reference(self._vector(), self._float(), self._vector(), self._vector(), self._flag(), self._flag())

    def _saturation(self) -> tuple[str, ...]:
        cell = self._cell()
        names = tuple(cell.split(" ")) if cell else ()
        if not _LIMITS.issuperset(names):
            raise self._wrong(cell, f"of {', '.join(sorted(_LIMITS))}")
        return names


@record
class PredictionStep:
    """One step: the model, and the memory before and after it."""

    loop: AutopilotLoop
    before: PredictorMemory
    after: PredictorMemory


@dataclass(frozen=True, slots=True)
class TraceHead:
    """Data of the whole trace: the vehicle and its local origin, the position of (0, 0, 0)."""

    vehicle: str
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class TraceEntry:
    """A row as it was read, with what it needs to be run again."""

    line: int
    """Line of the file, 1-based."""
    row: TraceRow
    config: ControlConfig
    memory: Memory | None
    """Memory with which the step began; None: the one that the last step left."""
    loop: AutopilotLoop | None = None
    """The model of the predictor; None: none was recorded so far."""
    predictor: PredictorMemory | None = None
    """Memory of the predictor with which the step began; None: the one that the last step left."""


@dataclass(frozen=True, slots=True)
class Mismatch:
    """One cell that the law answers differently now."""

    line: int
    column: str
    recorded: str
    computed: str


class TraceWriter:
    """Text of a trace, to be written as it comes. Repeats config and memory only where they changed."""

    def __init__(self, head: TraceHead) -> None:
        self._head: TraceHead | None = head
        self._config: ControlConfig | None = None
        self._memory: Memory | None = None
        self._loop: AutopilotLoop | None = None
        self._predictor: PredictorMemory | None = None

    def lines(
        self,
        row: TraceRow,
        config: ControlConfig,
        before: Memory,
        after: Memory,
        prediction: PredictionStep | None = None,
    ) -> str:
        """Everything this tick adds to the file, newlines included.

        ``before``: the memory handed to `step`; ``after``: what it returned. Where no step was made, both are the one
        that is kept.
        """
        # the head, once
        text = ""
        if self._head is not None:
            text, self._head = encode_head(self._head), None
        # what the row needs to be run again, where it has changed
        if config != self._config:
            text += _remark("config", asdict(config))
            self._config = config
        if before != self._memory:
            text += _remark("memory", asdict(before))
        self._memory = after
        if prediction is not None:
            if prediction.loop != self._loop:
                text += _remark("velocity_loop", _encode_loop(prediction.loop))
                self._loop = prediction.loop
            if prediction.before is not self._predictor:
                text += _remark("predictor", _encode_memory(prediction.before))
            self._predictor = prediction.after
        # the row itself
        return text + encode(row) + "\n"


def encode_head(head: TraceHead) -> str:
    """The first remarks and the line of columns."""
    local_origin = {"lat_deg": head.lat_deg, "lon_deg": head.lon_deg, "alt_amsl_m": head.alt_amsl_m}
    remarks = (("format", FORMAT), ("vehicle", head.vehicle), ("local_origin", local_origin))
    return "".join(_remark(key, value) for key, value in remarks) + ",".join(COLUMNS) + "\n"


class Trace:
    """A trace being read: ``head`` is known, iterating gives the entries, once.

    Iterating raises TraceError (line, reason) at the first line that does not belong to a trace.
    """

    def __init__(self, head: TraceHead, numbered: Iterator[tuple[int, str]]) -> None:
        self.head = head
        self.cut_line: int | None = None
        """The last line, if it was never finished; known at the end."""
        self._numbered = numbered

    def __iter__(self) -> Iterator[TraceEntry]:
        config: ControlConfig | None = None
        memory: Memory | None = None
        loop: AutopilotLoop | None = None
        predictor: PredictorMemory | None = None
        for number, line in self._numbered:
            whole = _whole(number, line)
            if whole is None:
                self.cut_line = number
                return
            if not whole:
                continue
            if whole.startswith("#"):
                key, value = _remark_of(number, whole)
                if key == "config":
                    config = _config(number, value)
                elif key == "memory":
                    memory = _memory(number, value)
                elif key == "velocity_loop":
                    loop = _decoded(number, key, value, _decode_loop)
                elif key == "predictor":
                    predictor = _decoded(number, key, value, _decode_memory)
                continue
            if config is None:
                raise TraceError(number, "a row before the remark 'config'")
            yield TraceEntry(number, decode_row(number, whole), config, memory, loop, predictor)
            memory = predictor = None


def decode(lines: Iterable[str]) -> Trace:
    """Read a trace from its lines, newlines kept. Reads the head at once; raises TraceError if it has none."""
    numbered = enumerate(lines, 1)
    remarks: dict[str, Any] = {}
    for number, line in numbered:
        whole = _whole(number, line)
        if whole is None:
            break
        if not whole.startswith("#"):
            if tuple(whole.split(",")) not in (COLUMNS, COLUMNS_1):
                raise TraceError(number, "these are not the columns of a control trace")
            return Trace(_head(number, remarks), numbered)
        key, value = _remark_of(number, whole)
        if len(remarks) >= 16 and key not in remarks:
            raise TraceError(number, "too many remarks before the columns")
        remarks[key] = value
    raise TraceError(1, "no line of columns: not a control trace, or one that was cut before its first row")


def rerun(entries: Iterable[TraceEntry]) -> Iterator[Mismatch]:
    """Run the law over what was recorded; gives every cell that does not come out bit for bit as it was recorded.

    Rows of ``position`` and ``raw``, and those in which nothing was sent, have nothing of ours to compare. After a
    mismatch the law goes on with what it computed itself, so that one wrong cell of the input shows in all that
    followed from it.
    """
    memory, predictor = Memory(), PredictorMemory()
    for entry in entries:
        memory = entry.memory or memory
        predictor = entry.predictor or predictor
        row = entry.row
        if row.estimate is None or row.reference is None or row.control_mode not in (ATTITUDE, VELOCITY):
            continue
        if row.control_mode == ATTITUDE:
            output, memory = step(entry.config, memory, row.estimate, row.reference, row.dt_s, following=row.following)
            again = row.with_output(output, memory)
        elif row.round_trip_s is not None:
            again, predictor = _predicted_again(entry, predictor)
        else:
            velocity, memory = velocity_step(entry.config, memory, row.estimate, row.reference, row.dt_s)
            again = row.with_velocity(velocity)
        recorded, computed = cells(row)[FIRST_OUTPUT:], cells(again)[FIRST_OUTPUT:]
        if recorded != computed:
            for column, was, now in zip(COLUMNS[FIRST_OUTPUT:], recorded, computed, strict=True):
                if was != now:
                    yield Mismatch(entry.line, column, was, now)


def _predicted_again(entry: TraceEntry, memory: PredictorMemory) -> tuple[TraceRow, PredictorMemory]:
    row = entry.row
    assert row.estimate is not None and row.reference is not None and row.round_trip_s is not None
    if entry.loop is None or row.state_age_s is None or row.hold_s is None:
        raise TraceError(
            entry.line, "a row with round_trip_s but without state_age_s, hold_s or remark 'velocity_loop'"
        )
    timing = Timing(row.t_s, row.state_age_s, row.round_trip_s, row.hold_s)
    setpoint, memory = predicted_setpoint(entry.config, entry.loop, memory, row.estimate, row.reference, timing)
    return row.with_prediction(setpoint), memory


# --- writing ---------------------------------------------------------------------------------------------------------


def _remark(key: str, value: object) -> str:
    return f"# {key} = {json.dumps(value)}\n"


# --- reading ---------------------------------------------------------------------------------------------------------


def _whole(number: int, line: str) -> str | None:
    """The line without its newline; None for one without, which was never finished."""
    if len(line) > LARGEST_LINE:
        raise TraceError(number, f"longer than {LARGEST_LINE} characters: no line of a control trace")
    return line.removesuffix("\n").removesuffix("\r") if line.endswith("\n") else None


def _remark_of(number: int, line: str) -> tuple[str, Any]:
    key, equals, text = line[1:].partition("=")
    try:
        if not equals:
            raise ValueError("there is no =")
        return key.strip(), json.loads(text)
    except (ValueError, RecursionError) as error:
        raise TraceError(number, f"a remark that is not '# key = JSON': {error}") from None


def _head(number: int, remarks: dict[str, Any]) -> TraceHead:
    if remarks.get("format") not in FORMATS:
        raise TraceError(number, f"its format is {remarks.get('format')!r}; this skygcs reads {', '.join(FORMATS)}")
    try:
        local_origin = remarks["anchor" if "anchor" in remarks else "local_origin"]  # the former is the old name
        place = (float(local_origin["lat_deg"]), float(local_origin["lon_deg"]), float(local_origin["alt_amsl_m"]))
        return TraceHead(str(remarks["vehicle"]), *place)
    except (KeyError, TypeError, ValueError) as error:
        raise TraceError(number, f"remarks 'vehicle' and 'local_origin' are missing or wrong: {error}") from None


def _config(number: int, value: Any) -> ControlConfig:
    try:
        return ControlConfig(**{**value, "xy": AxisGains(**value["xy"]), "z": AxisGains(**value["z"])})
    except ConfigError as error:
        raise TraceError(number, f"config: {'; '.join(error.problems)}") from None
    except (KeyError, TypeError) as error:
        raise TraceError(number, f"config: {error}") from None


def _memory(number: int, value: Any) -> Memory:
    try:
        error, velocity = value["vel_error_enu_mps"], value.get("vel_setpoint_enu_mps")  # the latter is newer
        return Memory(
            _vector(value["integral_enu"]),
            None if error is None else _vector(error),
            _vector(value["slope_enu_mps2"]),
            None if velocity is None else _vector(velocity),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise TraceError(number, f"memory: {error}") from None


T = TypeVar("T")


def _decoded(number: int, key: str, value: Any, decoder: Callable[[Any], T]) -> T:
    try:
        return decoder(value)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise TraceError(number, f"{key}: {error}") from None


def _vector(value: Any) -> Vector:
    x, y, z = value
    return float(x), float(y), float(z)


def _encode_loop(loop: AutopilotLoop) -> dict[str, float]:
    """Encode the loop for JSON."""
    return asdict(loop)


def _decode_loop(value: Any) -> AutopilotLoop:
    """The inverse. Raises KeyError, TypeError or ValueError."""
    loop = AutopilotLoop(**{str(key): float(number) for key, number in value.items()})
    if not (0.0 < loop.lag_xy_s < LARGEST_INPUT and 0.0 < loop.lag_z_s < LARGEST_INPUT):
        raise ValueError(f"lags of {loop.lag_xy_s:g} and {loop.lag_z_s:g} s")
    return loop


def _encode_memory(memory: PredictorMemory) -> dict[str, Any]:
    """Encode the memory for JSON: what was sent as [at, velocity, acceleration], one after the other."""
    estimate = memory.estimate
    return {
        "sent": [[sent.at, *sent.vel_enu_mps, *sent.acc_enu_mps2] for sent in memory.sent],
        "received_at": memory.received_at,
        "estimate": None if estimate is None else [*estimate.pos_enu_m, *estimate.vel_enu_mps],
        "disturbance_enu_mps2": list(memory.disturbance_enu_mps2),
        "round_trip_s": memory.round_trip_s,
        "ticked_at": memory.ticked_at,
    }


def _decode_memory(value: Any) -> PredictorMemory:
    """The inverse. Raises KeyError, TypeError or ValueError."""
    estimate = None
    if value["estimate"] is not None:
        x, y, z, vx, vy, vz = (float(number) for number in value["estimate"])
        estimate = Estimate((x, y, z), (vx, vy, vz))
    times = [float(sent[0]) for sent in value["sent"]]
    if times != sorted(times) or not all(-LARGEST_TIME_S <= at <= LARGEST_TIME_S for at in times):
        raise ValueError("the times of what was sent do not rise")
    return PredictorMemory(
        tuple(SentVelocity(float(sent[0]), _vector(sent[1:4]), _vector(sent[4:7])) for sent in value["sent"]),
        _maybe(value["received_at"]),
        estimate,
        _vector(value["disturbance_enu_mps2"]),
        _maybe(value["round_trip_s"]),
        _maybe(value["ticked_at"]),
    )


def _maybe(value: Any) -> float | None:
    return None if value is None else float(value)
