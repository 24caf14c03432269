"""Traces of velocity control with prediction: run again bit for bit, from any row on; traces of format 1 are read."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from skygcs.core.control.cascade import Estimate, Memory, Reference
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.trace import (
    COLUMNS,
    COLUMNS_1,
    PredictionStep,
    TraceHead,
    TraceRow,
    TraceWriter,
    decode,
    rerun,
)
from skygcs.core.control.velocity_predictor import PX4_LOOP, PredictorMemory, Timing, predicted_setpoint
from skygcs.errors import TraceError
from support.table import each

HEAD = TraceHead("alpha", 43.7806, -79.4653, 180.0)
CONFIG = ControlConfig()


def flight(first: int = 0, steps: int = 60) -> list[str]:
    """Recorded from tick ``first`` on; the predictor began at 0, and anew at 40."""
    writer, memory, text = TraceWriter(HEAD), PredictorMemory(), ""
    for n in range(steps):
        if n == 40:
            memory = PredictorMemory()
        reference = Reference((0.2 * n, math.sin(n), 6.0), 0.3, (2.0, 0.1, 0.0), (0.1, -0.3, 0.0))
        estimate = Estimate((0.19 * (n // 2), 0.1, 5.0), (1.9 + 0.01 * (n // 2), 0.2, 0.0))
        age_s = 0.03 if n % 2 == 0 else 0.13
        row = TraceRow(
            n * 0.1, 0.1, "velocity", True, reference, estimate, age_s, round_trip_s=0.6 + 1e-3 * n, hold_s=0.1
        )
        assert row.round_trip_s is not None and row.hold_s is not None
        timing = Timing(row.t_s, age_s, row.round_trip_s, row.hold_s)
        before = memory
        found, memory = predicted_setpoint(CONFIG, PX4_LOOP, before, estimate, reference, timing)
        if n >= first:
            step = PredictionStep(PX4_LOOP, before, memory)
            text += writer.lines(row.with_prediction(found), CONFIG, Memory(), Memory(), step)
    return text.splitlines(keepends=True)


def remarks(lines: list[str]) -> list[str]:
    return [line.split(" ")[1] for line in lines if line.startswith("#")]


@each("first", [0, 17])
def test_it_runs_again_without_a_difference(first: int) -> None:
    lines = flight(first)
    assert list(rerun(decode(lines))) == []
    assert remarks(lines).count("predictor") == 2, "at the beginning, and where it began anew"
    assert remarks(lines).count("velocity_loop") == 1


@each("column", [c for c in COLUMNS if c.startswith(("acc_sp_", "pred_", "dist_", "vel_sp_"))])
def test_one_flipped_bit_of_the_output_is_found(column: str) -> None:
    lines = flight()
    cells = lines[30].rstrip("\n").split(",")
    at = COLUMNS.index(column)
    recorded, cells[at] = cells[at], repr(math.nextafter(float(cells[at]), math.inf))
    lines[30] = ",".join(cells) + "\n"
    (mismatch,) = rerun(decode(lines))
    assert (mismatch.line, mismatch.column, mismatch.computed) == (31, column, recorded)


@each("column", ["x_m", "vx_mps", "state_age_s", "round_trip_s", "ref_ax_mps2"])
def test_a_changed_input_shows_in_what_follows(column: str) -> None:
    lines = flight()
    cells = lines[30].rstrip("\n").split(",")
    cells[COLUMNS.index(column)] = "0.5"
    lines[30] = ",".join(cells) + "\n"
    assert next(rerun(decode(lines))).line >= 31


def test_without_the_memory_it_began_with_it_answers_otherwise() -> None:
    lines = [line for line in flight(17) if not line.startswith("# predictor")]
    assert next(rerun(decode(lines))).line > 0


def test_a_trace_of_format_1_is_read_and_runs_again() -> None:
    old = []
    row = TraceRow(0.0, 0.1, "position", True, Reference(), Estimate((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)), 0.03)
    for line in TraceWriter(HEAD).lines(row, CONFIG, Memory(), Memory()).splitlines():
        old.append((line if line.startswith("#") else ",".join(line.split(",")[: len(COLUMNS_1)])) + "\n")
    old[0] = '# format = "skygcs control trace 1"\n'
    (entry,) = decode(old)
    assert entry.row == row and entry.loop is None and entry.predictor is None
    assert list(rerun(decode(old))) == []


def memory_remark(**changes: Any) -> str:
    whole = next(line for line in flight(17) if line.startswith("# predictor"))
    return f"# predictor = {json.dumps({**json.loads(whole.partition('=')[2]), **changes})}\n"


@each(
    "line",
    [
        "# predictor = 3\n",
        "# predictor = {}\n",
        memory_remark(sent=[[1.0]]),
        memory_remark(sent=[[2.0, *[0.0] * 6], [1.0, *[0.0] * 6]]),
        memory_remark(sent=[[math.nan, *[0.0] * 6]]),
        memory_remark(estimate=[1, 2]),
        memory_remark(disturbance_enu_mps2=None),
        memory_remark(received_at="soon"),
        "# velocity_loop = []\n",
        "# velocity_loop = {}\n",
        '# velocity_loop = {"lag_xy_s": "x"}\n',
        f"# velocity_loop = {json.dumps({**dict.fromkeys(PX4_LOOP.__dataclass_fields__, 0.0)})}\n",
    ],
)
def test_a_remark_that_is_none_is_an_error_with_its_line(line: str) -> None:
    lines = flight()
    lines.insert(10, line)
    with pytest.raises(TraceError) as caught:
        list(rerun(decode(lines)))
    assert caught.value.line == 11


def test_a_predicted_row_without_its_model_is_an_error() -> None:
    lines = [line for line in flight() if not line.startswith("# velocity_loop")]
    with pytest.raises(TraceError, match="velocity_loop"):
        list(rerun(decode(lines)))
