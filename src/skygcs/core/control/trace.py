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
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

from skygcs.core.control.cascade import LARGEST_INPUT, Estimate, Memory, Vector, step, velocity_step
from skygcs.core.control.gains import AxisGains, ControlConfig
from skygcs.core.control.trace_row import (
    ATTITUDE,
    COLUMNS,
    COLUMNS_1,
    CONTROL_MODES,
    FIRST_OUTPUT,
    POSITION,
    RAW,
    VELOCITY,
    TraceRow,
    cells,
    decode_row,
    encode,
)
from skygcs.core.control.velocity_loop import record
from skygcs.core.control.velocity_predictor import (
    AutopilotLoop,
    PredictorMemory,
    SentVelocity,
    Timing,
    predicted_setpoint,
)
from skygcs.errors import ConfigError, TraceError

__all__ = [
    "ATTITUDE",
    "COLUMNS",
    "CONTROL_MODES",
    "POSITION",
    "RAW",
    "VELOCITY",
    "Mismatch",
    "PredictionStep",
    "Trace",
    "TraceEntry",
    "TraceHead",
    "TraceRow",
    "TraceWriter",
    "decode",
    "encode",
    "encode_head",
    "rerun",
]

FORMAT = "skygcs control trace 2"
FORMATS = ("skygcs control trace 1", FORMAT)
"""Those that are read. The first has no columns of prediction."""

LARGEST_LINE = 16384
"""Characters. A row has at most 49 cells of 24 and the names of all limits (some 1200), a config remark some 400, and
what a predictor remembers 64 setpoints of 7 numbers (some 10,000)."""


LARGEST_TIME_S = 1e12
"""Largest time of a loop's clock, which counts from any beginning: 30,000 years."""


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
