"""Control traces: what is written is what is read, bit for bit, and the law gives it again."""

from __future__ import annotations

import math
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import AxisGains, ControlConfig, Estimate, Memory, Reference, Saturation, step, velocity_step
from skygcs.core.control.trace import (
    COLUMNS,
    COLUMNS_1,
    CONTROL_MODES,
    TraceEntry,
    TraceHead,
    TraceRow,
    TraceWriter,
    decode,
    encode,
    encode_head,
    rerun,
)
from skygcs.errors import TraceError
from support.table import each

HEAD = TraceHead("alpha", 43.7806, -79.4653, 180.0)
CONFIG = ControlConfig()
FASTER = ControlConfig(xy=AxisGains(1.2, 0.1, 0.03, 0.001), hover_thrust=0.5)

numbers = st.floats(allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers)
references = st.builds(Reference, vectors, numbers, vectors, vectors, st.booleans(), st.booleans())
rows = st.builds(
    TraceRow,
    t_s=numbers,
    dt_s=numbers,
    control_mode=st.none() | st.sampled_from(CONTROL_MODES),
    following=st.booleans(),
    reference=st.none() | references,
    estimate=st.none() | st.builds(Estimate, vectors, vectors),
    state_age_s=st.none() | numbers,
    attitude_ned_frd=st.none() | st.tuples(numbers, numbers, numbers, numbers),
    thrust=st.none() | numbers,
    vel_setpoint_enu_mps=st.none() | vectors,
    integral_enu=st.none() | vectors,
    saturation=st.lists(st.sampled_from(["tilt", "thrust_max", "dt"]), unique=True).map(tuple),
)
memories = st.builds(Memory, vectors, st.none() | vectors, vectors)


def flight(steps: int = 60) -> list[str]:
    """A file's lines: attitude, then other gains, then velocity, then attitude anew; nothing sent in between."""
    writer, memory, text = TraceWriter(HEAD), Memory((0.01, -0.02, 0.003)), ""
    position, velocity = [0.0, 0.0, 5.0], [0.0, 0.0, 0.0]
    for n in range(steps):
        config = CONFIG if n < steps // 3 else FASTER
        control_mode = ("attitude", "velocity", None, "attitude")[n * 4 // steps]
        if n == steps * 3 // 4:
            memory = Memory()
        reference = Reference((3.0, -1.0, 6.0), yaw_rad=0.3 + n, acc_enu_mps2=(0.1, 0.0, -0.2))
        estimate = Estimate((position[0], position[1], position[2]), (velocity[0], velocity[1], velocity[2]))
        row = TraceRow(n * 0.02, 0.02 + 1e-4 * (n % 7), control_mode, n != 5, reference, estimate, 0.03)
        after = memory
        if control_mode == "attitude":
            output, after = step(config, memory, estimate, reference, row.dt_s, following=row.following)
            row = row.with_output(output, after)
        elif control_mode == "velocity":
            velocity, after = velocity_step(config, memory, estimate, reference, row.dt_s)
            row = row.with_velocity(velocity)
        text += writer.lines(row, config, memory, after)
        memory = after
        velocity = [0.9 * v + 0.02 * n for v in velocity]
        position = [p + 0.02 * v for p, v in zip(position, velocity, strict=True)]
    return text.splitlines(keepends=True)


def entries(lines: Iterable[str]) -> list[TraceEntry]:
    return list(decode(lines))


def with_cell(line: str, column: str, change: str) -> str:
    cells = line.rstrip("\n").split(",")
    cells[COLUMNS.index(column)] = change
    return ",".join(cells) + "\n"


@given(row=rows, before=memories)
def test_a_row_comes_back_bit_for_bit(row: TraceRow, before: Memory) -> None:
    lines = TraceWriter(HEAD).lines(row, FASTER, before, before).splitlines(keepends=True)
    trace = decode(lines)
    assert trace.head == HEAD
    (entry,) = trace
    assert entry == TraceEntry(len(lines), row, FASTER, entry.memory)
    assert encode(entry.row) == encode(row)  # tells 0.0 from -0.0, too
    assert entry.memory == before


def written(row: TraceRow) -> list[str]:
    """A file of this row alone."""
    return TraceWriter(HEAD).lines(row, CONFIG, Memory(), Memory()).splitlines(keepends=True)


@each("number", [-0.0, 5e-324, 1.7976931348623157e308, math.inf, math.nan, 0.1 + 0.2, 7])
def test_odd_numbers_come_back(number: float) -> None:
    (entry,) = entries(written(TraceRow(number, 0.02, None, True, None, None, number)))
    assert repr(entry.row.t_s) == repr(entry.row.state_age_s) == repr(float(number))


def test_a_flight_runs_again_without_a_difference_and_what_does_not_change_is_written_once() -> None:
    lines = flight()
    modes = [entry.row.control_mode for entry in entries(lines)]
    assert [modes.count(mode) for mode in ("attitude", "velocity", None)] == [30, 15, 15]
    assert list(rerun(entries(lines))) == []
    remarks = [line.split(" ")[1] for line in lines if line.startswith("#")]
    assert remarks == ["format", "vehicle", "local_origin", "config", "memory", "config", "memory"]


def test_without_the_memory_it_began_with_the_law_answers_otherwise() -> None:
    lines = [line for line in flight() if not line.startswith("# memory")]
    assert next(rerun(entries(lines))).column in ("out_w", "out_x")


@each("column", COLUMNS_1[COLUMNS_1.index("out_w") : -1])
def test_one_flipped_bit_of_the_output_is_found(column: str) -> None:
    lines = flight()
    at = 20
    recorded = lines[at].split(",")[COLUMNS.index(column)]
    flipped = repr(math.nextafter(float(recorded), math.inf))
    lines[at] = with_cell(lines[at], column, flipped)
    (mismatch,) = rerun(entries(lines))
    assert (mismatch.line, mismatch.column, mismatch.recorded) == (at + 1, column, flipped)
    assert mismatch.computed == recorded


@each(
    ("column", "change"),
    [("x_m", "0.5"), ("following", "0"), ("dt_s", "0.021"), ("ref_yaw_rad", "0.1"), ("ref_ax_mps2", "1.0")],
)
def test_a_changed_input_is_found_in_what_follows_from_it(column: str, change: str) -> None:
    lines = flight()
    lines[20] = with_cell(lines[20], column, change)
    assert next(rerun(entries(lines))).line == 21


def test_limits_that_were_reached_are_compared_too() -> None:
    lines = flight()
    lines[20] = with_cell(lines[20], "saturation", "velocity_z thrust_min")
    assert [m.column for m in rerun(entries(lines))] == ["saturation"]


def test_a_step_that_gave_no_output_gives_none_again() -> None:
    row = TraceRow(0.0, 0.02, "attitude", True, Reference(), Estimate((math.nan, 0, 0), (0, 0, 0)), 0.0)
    lines = written(row.with_output(None, Memory()))
    assert list(rerun(entries(lines))) == []
    lines[-1] = with_cell(lines[-1], "thrust", "0.4")
    assert [m.column for m in rerun(entries(lines))] == ["thrust"]


@given(cut=st.integers(1, 200))
def test_a_line_that_was_cut_off_is_not_counted(cut: int) -> None:
    lines = flight()
    whole = entries(lines)
    lines[-1] = lines[-1][: -min(cut, len(lines[-1]) - 1)]
    trace = decode(lines)
    assert list(trace) == whole[:-1]
    assert trace.cut_line == len(lines)


def test_line_ends_of_other_systems_are_read() -> None:
    assert entries([line.replace("\n", "\r\n") for line in flight()]) == entries(flight())


@each(
    ("line", "reason"),
    [
        ("garbage\n", "1 cells; a row has 49"),
        ("\x00\xff,\n", "cells"),
        ("# config\n", "there is no ="),
        ("# config = {\n", "not '# key = JSON'"),
        ("# config = [1]\n", "config:"),
        ('# config = {"xy": {}, "z": {}}\n', "config:"),
        ("# memory = 3\n", "memory:"),
        ('# memory = {"integral_enu": [1, 2]}\n', "memory:"),
        ("# " + "[" * 4000 + "\n", "not '# key = JSON'"),
        ("# x = " + "[" * 4000 + "\n", "not '# key = JSON'"),
        ("1" * 20000, "longer than 16384"),
    ],
)
def test_a_line_that_is_none_is_an_error_with_its_number(line: str, reason: str) -> None:
    lines = flight()
    lines.insert(30, line)
    with pytest.raises(TraceError) as error:
        entries(lines)
    assert error.value.line == 31
    assert reason in error.value.reason


@each(
    ("column", "change"),
    [
        *(("t_s", "x"), ("t_s", ""), ("control_mode", "walk"), ("following", "yes"), ("y_m", ""), ("ref_y_m", "")),
        *(("vel_only_z", "2"), ("out_z", ""), ("int_x", "--1"), ("saturation", "tilt wings")),
    ],
)
def test_a_cell_that_is_wrong_is_named(column: str, change: str) -> None:
    lines = flight()
    lines[15] = with_cell(lines[15], column, change)
    with pytest.raises(TraceError, match=r"^line 16: ") as error:
        entries(lines)
    assert column.split("_")[0] in error.value.reason


@given(st.lists(st.text(max_size=60), max_size=8))
def test_anything_at_all_is_a_trace_or_a_trace_error(texts: list[str]) -> None:
    for lines in (texts, [*flight(4), *(f"{text}\n" for text in texts)]):
        try:
            entries(lines)
        except TraceError as error:
            assert 1 <= error.line <= len(lines) + 1


@each(
    ("lines", "reason"),
    [
        ([], "no line of columns"),
        (["# format = 1\n"], "no line of columns"),
        (["a,b\n"], "not the columns"),
        ([",".join(COLUMNS) + "\n"], "format is None"),
        (['# format = "skygcs control trace 1"\n', ",".join(COLUMNS) + "\n"], "'vehicle' and 'local_origin'"),
        ([f"# x{i} = 1\n" for i in range(100)], "too many remarks"),
        ([*encode_head(HEAD).splitlines(keepends=True), flight()[-1]], "before the remark 'config'"),
    ],
)
def test_a_file_that_is_no_trace_is_told_so(lines: list[str], reason: str) -> None:
    with pytest.raises(TraceError, match=reason):
        entries(lines)


def test_the_local_origin_is_read_by_its_old_name_too() -> None:
    lines = encode_head(HEAD).replace("# local_origin =", "# anchor =").splitlines(keepends=True)
    assert lines != encode_head(HEAD).splitlines(keepends=True)
    assert decode(lines).head == HEAD


def test_names_of_limits_are_those_of_the_law() -> None:
    row = TraceRow(0.0, 0.02, "attitude", True, None, None, None, saturation=Saturation(*(True,) * 9).names())
    assert entries(written(row))[0].row == row
