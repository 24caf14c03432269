"""One row of a control trace: its columns, its values, and the two conversions. The file around it is trace.py."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from skygcs.core.control.cascade import Estimate, Memory, Output, Quaternion, Reference, Saturation, Vector
from skygcs.core.control.velocity_predictor import PredictedSetpoint
from skygcs.errors import TraceError

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
