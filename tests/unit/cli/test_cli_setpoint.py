"""`skygcs-cli setpoint`: streams at a rate, forwards lines, and reports what vehicles do afterwards."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.setpoint import (
    LARGEST_LINE,
    MOST_REFUSED,
    MOST_WAITING,
    LineError,
    LineReader,
    Sender,
    SetpointInbox,
    SetpointTally,
    SplitLines,
    bytes_of,
    forward,
    repeat,
)
from skygcs.errors import RpcError
from support.controlled import Commanded
from support.table import each

DONE, FAILED, USAGE = 0, 1, 2
OK = {"ok": True, "message": "followed"}


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as fleet:
        yield fleet


# --- the command -----------------------------------------------------------------------------------------------------


def test_one_setpoint_is_streamed_and_its_end_reported(fleet: Commanded) -> None:
    text = fleet.run("setpoint", "alpha", "--pos", "1", "-2", "5", "--yaw", "90", "--for", "0.2", "--rate", "50")
    expected = {"pos_enu_m": [1.0, -2.0, 5.0], "yaw_deg": 90.0, "valid_s": 0.5, "force": False}
    assert fleet.vehicles["alpha"].setpoints[0] == expected
    assert "setpoints in 0." in text
    assert "alpha stays where it is from 0.5 s after the last setpoint on" in text


def test_axes_may_be_left_to_a_velocity(fleet: Commanded) -> None:
    given = ("--vel", "-1", "0", "-", "--pos", "-", "-", "10", "--for", "0", "--valid", "1")
    fleet.run("setpoint", "alpha", *given)
    fleet.run("setpoint", "alpha", *given, "--take-over")
    sent = {"pos_enu_m": [None, None, 10.0], "vel_enu_mps": [-1.0, 0.0, None], "valid_s": 1.0, "force": False}
    assert fleet.vehicles["alpha"].setpoints == [sent, {**sent, "take_over": True}]


def test_a_slow_rate_makes_each_setpoint_good_until_the_next(fleet: Commanded) -> None:
    fleet.run("setpoint", "alpha", "--vel", "1", "0", "0", "--for", "0", "--rate", "1")
    assert fleet.vehicles["alpha"].setpoints[0]["valid_s"] == 2.5
    fleet.run("setpoint", "alpha", "--vel", "1", "0", "0", "--rate", "1", "--valid", "0.5", code=USAGE)


def test_a_vehicle_that_takes_none_ends_it_with_its_reason(fleet: Commanded) -> None:
    fleet.vehicles["alpha"].refuses = "refused: control is off"
    text = fleet.run("setpoint", "alpha", "--vel", "1", "0", "0", code=FAILED)
    assert "alpha: refused: control is off" in text and "stays" not in text
    assert "no setpoints in " in text and "refused by all: 1" in text
    fleet.vehicles["bravo"].refuses = "refused: control is off"
    answer = fleet.json("setpoint", "1-3", "--vel", "1", "0", "0", "--for", "0.1", code=FAILED)
    assert [o["ok"] for o in answer["outcomes"].values()] == [False, False, True]
    assert answer["refused_by_all"] == 0


def test_what_all_refuse_for_one_reason_is_reported_once(fleet: Commanded) -> None:
    for vehicle in fleet.vehicles.values():
        vehicle.refuses = "refused: control is off"
    text = fleet.run("setpoint", "all", "--vel", "1", "0", "0", code=FAILED)
    assert text.count("control is off") == 1 and "alpha, bravo, carol: refused" in text


def test_when_the_daemon_goes_away_nothing_is_promised(fleet: Commanded) -> None:
    alpha = fleet.vehicles["alpha"]
    alpha.on_setpoint = fleet.stop_soon
    text = fleet.run("setpoint", "alpha", "--vel", "1", "0", "0", code=3)
    assert "autopilot's failsafe" in text and "under control" not in text


@each(
    ("args", "word"),
    [
        ((), "neither a position nor a velocity"),
        (("--pos", "1", "2", "x"), "--pos"),
        (("--pos", "1", "2", "inf"), "--pos"),
        (("--pos", "1", "2", "-"), "z has neither"),
        (("--pos", "1", "-", "3"), "x without y"),
        (("--pos", "1", "2", "3", "--rate", "0.1"), "--rate"),
        (("--pos", "1", "2", "3", "--rate", "1000"), "--rate"),
        (("--pos", "1", "2", "3", "--for", "-1"), "--for"),
        (("--pos", "1", "2", "3", "--valid", "60"), "--valid"),
        (("--pos", "1", "2", "3", "--yaw", "nan"), "--yaw"),
        (("--stdin", "--for", "3"), "--stdin supplies the setpoints"),
    ],
)
def test_a_wrong_option_is_a_usage_error_that_names_it(fleet: Commanded, args: tuple[str, ...], word: str) -> None:
    assert word in fleet.run("setpoint", "alpha", *args, code=USAGE)
    assert not fleet.vehicles["alpha"].setpoints


# --- the stream, in virtual time -------------------------------------------------------------------------------------


class FakeClient:
    """Answers after ``delay_s`` with what ``outcome`` says."""

    def __init__(self, delay_s: float = 0.0) -> None:
        self.delay_s = delay_s
        self.sent: list[tuple[float, str, dict[str, Any]]] = []
        self.outcome: dict[str, Any] | Exception = OK

    async def call(self, method: str, *, targets: str, valid_s: float, **setpoint: Any) -> Any:
        assert method == "control.setpoint"
        self.sent.append((round(asyncio.get_running_loop().time(), 6), targets, setpoint))
        await asyncio.sleep(self.delay_s)
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return {"outcomes": {targets: self.outcome}}


def sender_of(client: FakeClient) -> tuple[Sender, list[str]]:
    reported: list[str] = []
    return Sender(client, 0.5, reported.append), reported  # type: ignore[arg-type]


@pytest.mark.looptime(start=0)
async def test_the_rate_is_kept_on_absolute_times() -> None:
    client = FakeClient(delay_s=0.03)
    sender, _ = sender_of(client)
    await repeat(sender, "alpha", {"vel_enu_mps": [1, 0, 0]}, 10.0, 0.5)
    assert [at for at, _, _ in client.sent] == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert sender.tally.skipped == 0 and sender.tally.ok


@pytest.mark.looptime(start=0)
async def test_a_daemon_that_is_slower_than_the_rate_gets_fewer_and_fresh_ones() -> None:
    client = FakeClient(delay_s=0.25)
    sender, _ = sender_of(client)
    await repeat(sender, "alpha", {"vel_enu_mps": [1, 0, 0]}, 10.0, 1.0)
    assert [at for at, _, _ in client.sent] == [0.0, 0.3, 0.6, 0.9]
    assert sender.tally.sent + sender.tally.skipped >= 10


async def lines_at(*timed: tuple[float, str]) -> AsyncIterator[bytes]:
    for after_s, text in timed:
        await asyncio.sleep(after_s)
        yield text.encode()


@pytest.mark.looptime(start=0)
async def test_lines_are_sent_as_they_come_the_newest_of_each_vehicle() -> None:
    client = FakeClient(delay_s=0.1)
    sender, reported = sender_of(client)
    burst = '1,1,1\n2,2,2\n{"vehicle":"bravo","pos":[7,7,7]}\n3,3,3\n'
    await forward(sender, "alpha", lines_at((0.5, "0,0,0\n"), (0.05, burst), (1.0, "4,4,4")), None)
    expected = [(0.5, "alpha", 0.0), (0.6, "alpha", 3.0), (0.7, "bravo", 7.0), (1.55, "alpha", 4.0)]
    assert [(at, name, s["pos_enu_m"][0]) for at, name, s in client.sent] == expected
    assert (sender.tally.sent, sender.tally.skipped, reported) == (4, 2, [])


@pytest.mark.looptime(start=0)
async def test_with_a_rate_every_line_is_flown_one_after_the_other() -> None:
    client = FakeClient()
    sender, _ = sender_of(client)
    text = "".join(f"{i},0,5\n" for i in range(600))
    await forward(sender, "alpha", lines_at((0.0, text), (0.0, "600,0,5\n")), 10.0)
    assert [s["pos_enu_m"][0] for _, _, s in client.sent] == [float(i) for i in range(601)]
    assert client.sent[-1][0] == pytest.approx(60.0) and sender.tally.skipped == 0


@pytest.mark.looptime(start=0)
async def test_wrong_lines_are_reported_by_number_and_do_not_end_it() -> None:
    client = FakeClient()
    sender, reported = sender_of(client)
    await forward(sender, "alpha", lines_at((0.0, "1,2,3\nnonsense\n" + "x" * 5000 + "\n"), (0.1, "4,5,6\n")), None)
    assert [s["pos_enu_m"][0] for _, _, s in client.sent] == [1.0, 4.0]
    assert [line.split(":")[0] for line in reported] == ["line 2", "line 3"]
    assert sender.tally.wrong_lines == 2 and not sender.tally.ok


@pytest.mark.looptime(start=0)
async def test_wrong_lines_are_reported_up_to_a_limit() -> None:
    sender, reported = sender_of(FakeClient())
    await forward(sender, "alpha", lines_at((0.0, "nonsense\n" * 1000)), None)
    assert len(reported) == 11 and sender.tally.wrong_lines == 1000


@pytest.mark.looptime(start=0)
async def test_what_the_daemon_finds_wrong_in_a_line_is_reported_with_its_number() -> None:
    client = FakeClient()
    client.outcome = RpcError(-32602, "yaw_deg: should be at most 360")
    sender, reported = sender_of(client)
    await forward(sender, "alpha", lines_at((0.0, "\n1,2,3,999\n")), None)
    assert reported == ["line 2: yaw_deg: should be at most 360"]
    client.outcome = RpcError(-32603, "a fault")
    with pytest.raises(RpcError, match="a fault"):
        await forward(sender, "alpha", lines_at((0.0, "1,2,3\n"), (99.0, "never read\n")), None)


@pytest.mark.looptime(start=0)
async def test_a_vehicle_may_be_taken_under_control_while_its_program_runs_already() -> None:
    client = FakeClient()
    client.outcome = {"ok": False, "message": "refused: control is off"}
    sender, reported = sender_of(client)
    steps = [(0.1, f"{i},0,5\n") for i in range(MOST_REFUSED - 1)]

    async def lines() -> AsyncIterator[bytes]:
        async for line in lines_at(*steps):
            yield line
        client.outcome = OK
        yield b"1,1,1\n"

    await forward(sender, "alpha", lines(), None)
    assert reported == ["alpha: refused: control is off", "alpha accepts setpoints again"]


@pytest.mark.looptime(start=0)
async def test_a_vehicle_that_keeps_refusing_ends_it() -> None:
    client = FakeClient()
    client.outcome = {"ok": False, "message": "refused: control is off"}
    sender, reported = sender_of(client)
    await forward(sender, "alpha", lines_at(*[(0.1, "1,2,3\n")] * 1000), None)
    assert len(client.sent) == MOST_REFUSED and "stopped sending" in reported[-1]


def test_of_more_vehicles_than_there_can_be_the_oldest_go() -> None:
    tally = SetpointTally()
    inbox = SetpointInbox("alpha", tally, lambda _: None, newest_only=True)
    for i in range(MOST_WAITING + 5):
        inbox.feed(f'{{"vehicle": "v{i}", "pos": [1, 2, 3]}}\n'.encode())
    assert tally.skipped == 5


async def test_a_pipe_is_read_as_it_is_written_and_to_its_end() -> None:
    there, here = os.pipe()
    os.write(here, b"1,2,3\n")
    source = bytes_of(there)
    assert await anext(source) == b"1,2,3\n"
    os.write(here, b"4,5,6\n")
    assert await anext(source) == b"4,5,6\n"
    os.close(here)
    assert [data async for data in source] == []
    os.close(there)


async def test_a_descriptor_that_cannot_be_read_is_an_error() -> None:
    _, here = os.pipe()
    os.close(_)
    with pytest.raises(OSError):
        await anext(bytes_of(here))
    os.close(here)


# -- Setpoints as lines of text: JSON, CSV with and without a header, and what is neither.


numbers = st.floats(-1e6, 1e6)
vectors = st.tuples(numbers, numbers, numbers).map(list)


def read(*lines: str) -> list[tuple[str | None, dict[str, Any]]]:
    reader = LineReader()
    return [found for line in lines if (found := reader.read(line)) is not None]


@given(pos=vectors, vel=vectors, yaw=numbers, vehicle=st.none() | st.sampled_from(["alpha", "3"]))
def test_json_and_csv_say_the_same(pos: list[float], vel: list[float], yaw: float, vehicle: str | None) -> None:
    wanted = [(vehicle, {"pos_enu_m": pos, "vel_enu_mps": vel, "yaw_deg": yaw})]
    given = {"pos": pos, "vel": vel, "yaw_deg": yaw} | ({} if vehicle is None else {"vehicle": vehicle})
    assert read(json.dumps(given)) == wanted
    row = ",".join([vehicle or "", *(repr(x) for x in (*pos, *vel, yaw))])
    assert read("vehicle, x, y, z, vx, vy, vz, yaw_deg", row) == wanted


def test_without_a_header_a_row_is_a_position_and_perhaps_a_yaw() -> None:
    expected = [(None, {"pos_enu_m": [1.0, 2.0, -3.0]}), (None, {"pos_enu_m": [4.0, 5.0, 6.0], "yaw_deg": 90.0})]
    assert read("1,2,-3", "4, 5, 6, 90") == expected


def test_an_axis_may_have_a_velocity_instead_of_a_position() -> None:
    level = {"pos_enu_m": [None, None, 5.0], "vel_enu_mps": [1.0, 0.0, None]}
    assert read('{"pos": [null, null, 5], "vel": [1, 0, null]}') == [(None, level)]
    assert read("z,vx,vy", "5,1,0") == [(None, level)]
    assert read('{"vel": [1, 0, 0]}') == [(None, {"vel_enu_mps": [1.0, 0.0, 0.0]})]


def test_nothing_and_remarks_are_passed_over_and_a_system_id_is_a_name() -> None:
    assert read("", "# a remark", '{"pos": [1, 2, 3], "vehicle": 7}') == [("7", {"pos_enu_m": [1.0, 2.0, 3.0]})]


@each(
    ("lines", "reason"),
    [
        (["bad"], "neither JSON nor a row"),
        (["1,2"], "neither JSON nor a row"),
        (["1,2,x"], "z: 'x' is not a number"),
        (["1,2,nan"], "z: 'nan' is not a finite number"),
        (["x,y,z", "1,2"], "2 cells; the header has 3"),
        (["x,y,w"], "no column 'w'"),
        (["x,y,z,x"], "twice"),
        (["x,y,z", "1,,3"], "x without y"),
        (["x,y,z", ",,"], "neither a position nor a velocity"),
        (["{"], "not JSON"),
        (["{" + "[" * 900], "not JSON"),
        (['{"pos": [1, 2, 1e999]}'], "not JSON"),
        (['{"pos": [1, 2]}'], "three numbers"),
        (['{"pos": [1, 2, "3"]}'], "three numbers"),
        (['{"pos": [1, 2, true]}'], "three numbers"),
        (['{"pos": [1, 2, %s]}' % ("9" * 400)], "three numbers"),
        (['{"position": [1, 2, 3]}'], "no key 'position'"),
        (['{"pos": [1, 2, null]}'], "z has neither"),
        (['{"pos": [1, 2, 3], "acc": [1, null, 2]}'], "all three axes"),
        (['{"pos": [1, 2, 3], "yaw_deg": "n"}'], "yaw_deg"),
        (['{"pos": [1, 2, 3], "vehicle": [1]}'], "vehicle"),
        (['{"yaw_deg": 3}'], "neither a position nor a velocity"),
    ],
)
def test_a_wrong_line_has_a_reason(lines: list[str], reason: str) -> None:
    with pytest.raises(LineError, match=reason):
        read(*lines)


@given(st.text(max_size=80))
def test_any_text_is_a_setpoint_or_a_line_error(text: str) -> None:
    try:
        read("1,2,3", text)
    except LineError as error:
        assert str(error)


@given(st.binary(max_size=4000), st.lists(st.integers(1, 700), min_size=1, max_size=9))
def test_lines_do_not_depend_on_how_the_bytes_come(data: bytes, sizes: list[int]) -> None:
    whole, parts = SplitLines(), SplitLines()
    wanted = [*whole.feed(data), *whole.end()]
    found = []
    at = 0
    for i in range(len(data) + 1):
        if at >= len(data):
            break
        size = sizes[i % len(sizes)]
        found += parts.feed(data[at : at + size])
        at += size
    assert [*found, *parts.end()] == wanted


def test_a_line_without_end_keeps_no_memory_and_the_next_one_is_read() -> None:
    lines = SplitLines()
    for _ in range(1000):
        assert list(lines.feed(b"x" * 1000)) == []
    assert len(lines._rest) <= LARGEST_LINE
    assert list(lines.feed(b"x\n1,2,3\n")) == [(1, None), (2, "1,2,3")]
    assert list(lines.feed(b"4,5,6")) == [] and list(lines.end()) == [(3, "4,5,6")]


RAW = [
    ('{"att": [5, -3, 90], "thrust": 0.5}', "roll_deg,pitch_deg,yaw_deg,thrust", "5,-3,90,0.5"),
    ('{"att": [1, 0, 0, 0], "thrust": 0.5}', "qw,qx,qy,qz,thrust", "1,0,0,0,0.5"),
    ('{"rates": [10, 0, -5], "thrust": 0.5}', "roll_rate,pitch_rate,yaw_rate,thrust", "10,0,-5,0.5"),
    ('{"acc": [0.5, 0, -1]}', "ax,ay,az", "0.5,0,-1"),
    ('{"acc": [0.5, 0, -1], "yaw_deg": 7}', "ax,ay,az,yaw_deg", "0.5,0,-1,7"),
]
RAW_PARAMS: list[dict[str, Any]] = [
    {"roll_deg": 5.0, "pitch_deg": -3.0, "yaw_deg": 90.0, "thrust": 0.5},
    {"attitude": [1.0, 0.0, 0.0, 0.0], "thrust": 0.5},
    {"body_rates_deg_s": [10.0, 0.0, -5.0], "thrust": 0.5},
    {"acc_enu_mps2": [0.5, 0.0, -1.0]},
    {"acc_enu_mps2": [0.5, 0.0, -1.0], "yaw_deg": 7.0},
]


@each(("lines", "expected"), list(zip(RAW, RAW_PARAMS, strict=True)))
def test_json_and_csv_of_an_own_controller_say_the_same(lines: tuple[str, str, str], expected: dict[str, Any]) -> None:
    as_json, header, row = lines
    assert read(as_json) == [(None, expected)]
    assert read(header, row) == [(None, expected)]


@each(
    ("lines", "reason"),
    [
        (['{"att": [5, -3, 90]}'], "need a thrust"),
        (['{"thrust": 0.5}'], "one of them"),
        (['{"att": [5, 90], "thrust": 0.5}'], "a list of 3 or 4 numbers"),
        (['{"att": [5, null, 90], "thrust": 0.5}'], "a list of 3 or 4 numbers"),
        (['{"att": [5, 0, 90], "thrust": true}'], "thrust: must be a number"),
        (['{"att": [5, 0, 90], "thrust": %s}' % ("9" * 400)], "thrust: must be a number"),
        (['{"att": [5, 0, %s], "thrust": 0.5}' % ("9" * 400)], "a list of 3 or 4 numbers"),
        (['{"att": [5, 0, 90], "yaw_deg": 3, "thrust": 0.5}'], "att has the yaw"),
        (['{"rates": [5, 0, 90], "acc": [0, 0, 0], "thrust": 0.5}'], "one of them"),
        (['{"acc": [0, 0, 0], "thrust": 0.5}'], "no thrust beside"),
        (['{"acc": [0, null, 0]}'], "all three axes"),
        (['{"att": [5, 0, 90], "thrust": 0.5, "pos": [1, 2, 3]}'], "exclude position"),
        (["roll_deg,pitch_deg,thrust", "1,2,0.5"], "needs roll, pitch and yaw"),
        (["roll_rate,yaw_rate,thrust", "1,2,0.5"], "give all of them or none"),
    ],
)
def test_what_is_no_raw_setpoint_is_reported(lines: list[str], reason: str) -> None:
    with pytest.raises(LineError, match=reason):
        read(*lines)
