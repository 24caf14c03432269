"""`skygcs-cli corrections`: streams its input, reports what was sent, and what is wrong with it."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli import corrections
from skygcs.cli.corrections import (
    PIECE_BYTES,
    CorrectionStream,
    CorrectionTally,
    at_rate,
    forward,
    line_of,
    own_source_lines,
    status_lines,
)
from skygcs.core.radio_link.corrections import Corrections
from skygcs.errors import DaemonUnreachable, RefusedError
from support.controlled import Commanded
from support.rtcm import STANDARD_1005, rtcm_frame
from support.table import each

NOTHING = dict.fromkeys(("messages", "bytes", "refused", "too_long", "bad_crc", "skipped_bytes"), 0)


class FakeClient:
    """Answers what the daemon would; ``answers`` change that of one call after the other."""

    def __init__(self, *answers: dict[str, Any] | Exception) -> None:
        self.pieces: list[dict[str, Any]] = []
        self._answers = list(answers)

    async def call(self, method: str, **params: Any) -> dict[str, Any]:
        assert method == "corrections.send"
        self.pieces.append(params)
        answer = self._answers.pop(0) if self._answers else {}
        if isinstance(answer, Exception):
            raise answer
        return {**NOTHING, "types": {}, "links": 1, **answer}


def stream_of(client: FakeClient) -> tuple[CorrectionStream, list[str]]:
    told: list[str] = []
    return CorrectionStream(client, told.append), told  # type: ignore[arg-type]


async def pieces(*data: bytes, pause_s: float = 0.0) -> AsyncIterator[bytes]:
    for piece in data:
        yield piece
        await asyncio.sleep(pause_s)


async def test_what_went_is_added_up() -> None:
    went = {"messages": 2, "bytes": 60, "types": {"1005": 1, "1077": 1}}
    client = FakeClient(went, {**went, "bad_crc": 1, "skipped_bytes": 7})
    stream, told = stream_of(client)
    for _ in range(2):
        await stream.send(b"\xd3\x00")
    assert [p["data"] for p in client.pieces] == ["0wA="] * 2
    assert len({p["source"] for p in client.pieces}) == 1
    assert stream.tally.as_dict() == {
        **{"read_bytes": 4, "messages": 4, "bytes": 120, "refused": 0, "too_long": 0, "bad_crc": 1},
        **{"skipped_bytes": 7, "types": {"1005": 2, "1077": 2}},
    }
    assert line_of(stream.tally, 60.0) == "4 messages, 120 B, 60 B/s, 1 damaged, 7 bytes skipped  1005:2 1077:2"
    assert told == []


async def test_much_at_once_goes_in_pieces_that_the_daemon_takes() -> None:
    client = FakeClient()
    stream, _ = stream_of(client)
    await stream.send(bytes(2 * PIECE_BYTES + 1))
    assert [len(p["data"]) <= 65536 for p in client.pieces] == [True] * 3
    assert stream.tally.read_bytes == 2 * PIECE_BYTES + 1


async def test_a_problem_that_a_person_can_solve_is_reported_once() -> None:
    down = {"links": 0, "refused": 1}
    client = FakeClient(down, down, {"messages": 1}, {"refused": 1}, {"refused": 1}, {"too_long": 1}, {"too_long": 1})
    stream, told = stream_of(client)
    for _ in range(7):
        await stream.send(b"x")
    assert told == [corrections.NO_LINK, corrections.LINK_AGAIN, corrections.NOT_TAKEN, corrections.TOO_LONG]


async def test_a_stream_of_something_else_is_reported() -> None:
    stream, told = stream_of(FakeClient())
    for _ in range(10):
        await stream.send(b"$GPGGA" * 50)
    assert told == [corrections.NO_RTCM]


async def test_the_end_is_reported_to_the_daemon_even_if_it_is_gone() -> None:
    client = FakeClient({}, DaemonUnreachable("s", "gone"))
    stream, _ = stream_of(client)
    await stream.end()
    await stream.end()
    assert [p["end"] for p in client.pieces] == [True, True]


@pytest.mark.looptime(start=0)
async def test_what_went_is_shown_at_its_times_whether_or_not_anything_comes() -> None:
    stream, _ = stream_of(FakeClient({"bytes": 500}))
    shown: list[tuple[float, float]] = []
    clock = asyncio.get_running_loop().time

    def show(_: CorrectionTally, bytes_per_s: float) -> None:
        shown.append((clock(), bytes_per_s))

    await forward(stream, pieces(b"x", b"", pause_s=2.25), show, 2.0)
    assert shown == [(2.0, 250.0), (4.0, 0.0)]


@pytest.mark.looptime(start=0)
async def test_a_recording_goes_at_its_rate() -> None:
    data = bytes(range(250)) * 8
    clock = asyncio.get_running_loop().time
    out = [(clock(), piece) async for piece in at_rate(pieces(data[:1500], data[1500:]), 1000.0)]
    assert b"".join(piece for _, piece in out) == data
    assert clock() == pytest.approx(2.0)
    for at, piece in out[1:]:
        assert sum(len(p) for t, p in out if t <= at) - len(piece) <= 1000 * at + 1


# --- the command -----------------------------------------------------------------------------------------------------

FAILED, USAGE, INTERRUPTED = 1, 2, 130
TAKEN = {**NOTHING, "messages": 1, "bytes": 25, "types": {"1005": 1}, "links": 1}


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Commanded]:
    with Commanded(tmp_path) as fleet:
        fleet.daemon.corrections.answer = dict(TAKEN)
        yield fleet


def test_a_file_is_sent_and_its_end_reported(fleet: Commanded, tmp_path: Path) -> None:
    (tmp_path / "base.rtcm3").write_bytes(STANDARD_1005)
    text = fleet.run("corrections", "send", str(tmp_path / "base.rtcm3"))
    assert text == "sent 1 message, 25 B  1005:1\n"
    (one, end) = fleet.daemon.corrections
    assert one[1:] == (STANDARD_1005, False)
    assert end[1:] == (b"", True)


def test_a_file_without_corrections_fails_and_says_so(fleet: Commanded, tmp_path: Path) -> None:
    fleet.daemon.corrections.answer |= NOTHING | {"types": {}}
    (tmp_path / "empty").touch()
    assert "no input" in fleet.run("corrections", "send", str(tmp_path / "empty"), code=FAILED)
    (tmp_path / "log.ubx").write_bytes(b"\xb5b" * 1500)
    text = fleet.run("corrections", "send", str(tmp_path / "log.ubx"), "--rate", "1e6", code=FAILED)
    assert "no RTCM 3 message" in text


def test_the_daemons_refusal_is_reported(fleet: Commanded, tmp_path: Path) -> None:
    fleet.daemon.corrections.fails = RefusedError("roof sends corrections already")
    (tmp_path / "base.rtcm3").write_bytes(STANDARD_1005)
    assert "roof sends" in fleet.run("corrections", "send", str(tmp_path / "base.rtcm3"), code=FAILED)


def test_what_cannot_be_read_is_reported(fleet: Commanded, tmp_path: Path) -> None:
    text = fleet.run("corrections", "send", str(tmp_path / "none"), code=FAILED)
    assert f"cannot read {tmp_path}/none: No such file" in text.replace("\n  ", " ")


def test_a_terminal_brings_no_corrections(fleet: Commanded) -> None:
    ours, theirs = os.openpty()
    try:
        text = fleet.run("corrections", "send", os.ttyname(theirs), code=USAGE)
    finally:
        os.close(ours)
        os.close(theirs)
    assert "str2str" in text
    assert fleet.daemon.corrections == []


@each("args", [("--rate", "1"), ("--rate", "nan"), ("--every", "0")])
def test_a_wrong_option_is_a_usage_error_that_names_it(fleet: Commanded, args: tuple[str, ...]) -> None:
    assert args[0] in fleet.run("corrections", "send", "/dev/null", *args, code=USAGE)


@pytest.mark.parametrize("end", ["eof", "ctrl-c"])
def test_a_pipe_is_sent_as_it_comes_until_its_end_or_ctrl_c(fleet: Commanded, end: str) -> None:
    command = [sys.executable, "-c", "from skygcs.cli.main import main; main()"]
    process = subprocess.Popen(
        [*command, "--socket", str(fleet.socket), "corrections", "send", "--json"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdin is not None
    process.stdin.write(STANDARD_1005[:9])
    process.stdin.flush()
    while not fleet.daemon.corrections:
        assert process.poll() is None
        time.sleep(0.01)
    assert fleet.daemon.corrections[0][1:] == (STANDARD_1005[:9], False)
    if end == "ctrl-c":
        process.send_signal(signal.SIGINT)
        process.wait(20)
    out, err = process.communicate(timeout=120)
    assert process.returncode == (INTERRUPTED if end == "ctrl-c" else 0)
    assert json.loads(out.splitlines()[-1])["read_bytes"] == 9
    assert err == b""
    assert fleet.daemon.corrections[-1][1:] == (b"", True)


# --- status ----------------------------------------------------------------------------------------------------------

STATUS = {
    **{"source": "roof", "age_s": 0.4, "bytes_per_s": 1412.0, "messages": 103, "bytes": 14230},
    **{"refused": 0, "too_long": 2, "bad_crc": 0, "skipped_bytes": 0},
    "types": {"1005": {"messages": 3, "bytes": 75, "age_s": 9.0}},
    "radios": [],
    "vehicles": [
        {"name": "alpha", "fix": "rtk_fixed", "satellites": 14},
        {"name": "bravo", "fix": None, "satellites": None},
    ],
}


def test_the_status_shows_what_went_and_the_fixes(fleet: Commanded) -> None:
    fleet.daemon.corrections.told = STATUS
    assert fleet.json("corrections", "status") == STATUS
    assert fleet.run("corrections", "status").splitlines() == [
        "from roof: 103 messages, 14,230 B, 1,412 B/s, the last 0 s ago",
        "  1005        3 messages         75 B, the last 9 s ago",
        "  too long: 2 messages",
        "alpha: rtk_fixed, 14 satellites",
        "bravo: no GPS reported",
    ]


OWN: dict[str, Any] = {
    **{"kind": "ntrip", "name": "caster.example:2101/VRS", "state": "streaming", "text": "", "since_s": 312.4},
    **{"connected": 1, "failures": 0, "bytes": 171000, "bytes_per_s": 569.2, "messages": 1280, "age_s": 0.4},
    **{"types": {"1005": 32, "1074": 1312}, "gga": {"from": "al\x1bpha", "sent": 1, "age_s": 3.0}, "survey": None},
}
SURVEY: dict[str, Any] = {
    **{"state": "surveying", "duration_s": 120, "minimum_s": 300.0, "accuracy_m": 3.2345, "wanted_m": 2.0},
    "observations": 1120,
}
RECEIVER = {**OWN, "kind": "receiver", "name": "/dev/ttyACM0", "gga": None, "types": {}}


def test_the_status_begins_with_the_daemons_own_source() -> None:
    status = {**STATUS, "rtk_fixed": 1, "rtk_float": 0, "own_source": OWN}
    lines = list(status_lines(status))
    assert lines[:3] == [
        "caster.example:2101/VRS: streaming for 312 s, 569 B/s, the last message 0 s ago",
        "  1005:32 1074:1,312",
        "  position of al\\x1bpha sent to it 1 time",
    ]
    assert "1 fixed, 0 float of 2 vehicles" in lines
    nothing = {**status, "age_s": None, "own_source": {**OWN, "state": "down", "text": "connection refused"}}
    lines = list(status_lines(nothing))
    assert lines[0].startswith("caster.example:2101/VRS: down for 312 s, the last") and "B/s" not in lines[0]
    assert lines[1] == "  connection refused" and "nothing was sent yet" in lines


@each(
    ("own", "line"),
    [
        (
            {**OWN, "gga": {"from": None, "sent": 0, "age_s": None}},
            "  no position sent to it yet: no vehicle has a fix",
        ),
        ({**OWN, "state": "down", "gga": {"from": None, "sent": 0, "age_s": None}}, "  no position sent to it yet"),
        (
            {**RECEIVER, "survey": SURVEY},
            "  survey-in running: 120 s of at least 300 s, 3.23 m of 2 m, 1,120 observations",
        ),
        (
            {**RECEIVER, "survey": {**SURVEY, "state": "surveyed", "duration_s": 1301}},
            "  survey-in done: 1,301 s of at least 300 s, 3.23 m of 2 m, 1,120 observations",
        ),
        ({**RECEIVER, "survey": {**SURVEY, "duration_s": None}}, "  survey-in: begun"),
        ({**RECEIVER, "survey": {**SURVEY, "state": "fixed"}}, "  position: from the fleet file"),
        ({**RECEIVER, "survey": {**SURVEY, "state": "setting_up"}}, "  the receiver is being set up"),
    ],
)
def test_how_far_the_source_is(own: dict[str, Any], line: str) -> None:
    assert list(own_source_lines(own))[-1] == line


def test_a_survey_is_refused_without_the_table(fleet: Commanded) -> None:
    fleet.daemon.corrections.told = STATUS
    shown = fleet.run("corrections", "survey", code=1)
    assert "[corrections]" in shown


def test_the_status_shows_what_each_radio_made_of_it() -> None:
    corrections = Corrections(165.0, 0.0)
    corrections.offer(1, bytes([0, 36]) + rtcm_frame(1087, epoch=1), 0.0)
    corrections.offer(1, bytes([0, 36]) + rtcm_frame(1087, epoch=2), 0.0)
    corrections.offer(2, bytes([0, 36]) + rtcm_frame(1087, epoch=2), 0.0)
    corrections.pop(0.0)
    radio = {"link": "air", "peer": "/dev/ttyUSB0", **corrections.status(), "source": "255/25"}
    lines = list(status_lines({**STATUS, "radios": [radio], "vehicles": [], "types": {}, "too_long": 0, "age_s": None}))
    assert lines == [
        "nothing was sent yet through this daemon's socket",
        "air (/dev/ttyUSB0): 165 B/s for corrections, 1 messages of 255/25 sent, 0 fragments waiting, wait p95 0.0 s",
        "  1 replaced, 1 fragments of a second base refused",
    ]
