"""The replay link, in virtual time."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Any

import pytest

from skygcs.config import models
from skygcs.errors import LinkError
from skygcs.links.base import LinkSupervisor
from skygcs.links.replay import LOOKS_PER_TURN, ReplayLink
from skygcs.tlog.files import FileWindow
from skygcs.tlog.format import encode_record
from skygcs.tlog.timeline import LONGEST_GAP_S
from support.hosts import RecordingHost, heartbeat, open_descriptors, text

pytestmark = pytest.mark.looptime

START_US = 1_700_000_000_000_000


def tlog(*records: tuple[float, bytes]) -> bytes:
    return b"".join(encode_record(START_US + round(at_s * 1e6), raw) for at_s, raw in records)


class TimedHost(RecordingHost):
    """Also keeps when each frame came, in seconds since the first."""

    def __init__(self) -> None:
        super().__init__()
        self.times: list[float] = []
        self.on_frame = lambda *_: self.times.append(asyncio.get_running_loop().time())

    @property
    def elapsed(self) -> list[float]:
        return [round(at - self.times[0], 3) for at in self.times]


def replay(hub: RecordingHost, path: Path, **keys: Any) -> ReplayLink:
    return ReplayLink(models.ReplayLinkConfig(name="flight", file=path, **keys), hub, asyncio.get_running_loop())


async def play(path: Path, **keys: Any) -> tuple[TimedHost, str]:
    host = TimedHost()
    link = replay(host, path, **keys)
    await link.open()
    reason = await link.failed
    assert link.finished is reason.startswith("finished")
    await link.close()
    assert link.channels == [] and len(host.detached) == 1
    return host, reason


@pytest.mark.parametrize(("speed", "expected"), [(1.0, [0.0, 0.5, 4.5]), (10.0, [0.0, 0.05, 0.45])])
async def test_a_tlog_is_played_at_its_recorded_pace_or_a_factor(
    tmp_path: Path, speed: float, expected: list[float]
) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog((0, heartbeat(1)), (0.5, heartbeat(255, compid=25)), (4.5, heartbeat(1, 1))))
    host, reason = await play(path, speed=speed)
    assert host.elapsed == pytest.approx(expected, abs=0.002)
    assert host.raws == [heartbeat(1), heartbeat(255, compid=25), heartbeat(1, 1)], "both directions, one channel"
    assert len({channel.id for channel, _ in host.heard}) == 1
    assert reason == "finished: the end of the file"


async def test_time_going_back_and_long_pauses_do_not_hold_it_up(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog((0, heartbeat(1)), (3600, heartbeat(1, 1)), (10, heartbeat(1, 2)), (11, heartbeat(1, 3))))
    host, _ = await play(path)
    assert host.elapsed == pytest.approx([0, LONGEST_GAP_S, LONGEST_GAP_S, LONGEST_GAP_S + 1], abs=0.002)


async def test_as_fast_as_possible_still_gives_everybody_a_turn(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    frames = [heartbeat(1 + n // 256, n % 256) for n in range(10_000)]
    path.write_bytes(tlog(*((n * 10.0, frame) for n, frame in enumerate(frames))))
    host = RecordingHost()
    link = replay(host, path, speed=0)
    await link.open()
    most = seen = 0
    while not link.failed.done():
        await asyncio.sleep(0.0002)
        most = max(most, len(host.heard) - seen)
        seen = len(host.heard)
    assert host.raws == frames
    assert 0 < most <= 64
    await link.close()


async def test_a_raw_capture_is_played_at_its_byte_rate(tmp_path: Path) -> None:
    path = tmp_path / "radio.raw"
    frames = [text(n % 250 + 1, n % 256, f"number {n}") for n in range(200)]
    path.write_bytes(b"".join(frames))
    host, _ = await play(path, raw_bytes_per_s=1000.0, speed=2.0)
    assert host.raws == frames
    assert host.elapsed[-1] == pytest.approx(len(b"".join(frames)) / 2000.0, abs=0.1)
    fast, _ = await play(path, speed=0)
    assert fast.raws == frames


async def test_the_last_frames_of_a_raw_capture_are_not_held_back_by_a_false_start(tmp_path: Path) -> None:
    path = tmp_path / "radio.raw"
    path.write_bytes(heartbeat(1) + bytes((0xFD, 200, 0, 0, 0, 1, 1, 0, 0, 0)) + heartbeat(2))
    host, _ = await play(path, speed=0)
    assert host.raws == [heartbeat(1), heartbeat(2)]


@pytest.mark.parametrize("name", ["flight.TLOG", "flight.bin"])
async def test_a_tlog_is_known_by_its_name_or_its_content(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(tlog(*((n, heartbeat(1, n)) for n in range(20))))
    host, _ = await play(path, speed=0)
    assert host.raws == [heartbeat(1, n) for n in range(20)]
    assert host.channels == [] and host.heard[0][0].parser.stats.skipped_bytes == 0


async def test_a_looped_replay_starts_over_and_a_supervised_one_ends_finished(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog((0, heartbeat(1)), (1, heartbeat(1, 1))))
    host = TimedHost()
    link = replay(host, path, loop=True)
    await link.open()
    await asyncio.sleep(4.5)
    assert len(host.heard) == 9 and not link.failed.done()
    await link.close()
    supervisor = LinkSupervisor(replay(host, path), lambda event: None)
    await supervisor.run()
    assert supervisor.state == "finished" and host.channels == []


async def test_an_empty_looped_file_ends_instead_of_spinning(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"")
    host, reason = await play(path, loop=True)
    assert host.heard == [] and reason.startswith("finished")


async def test_nothing_can_be_sent_to_a_replay_and_that_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog((0, heartbeat(1)), (1, heartbeat(1))))
    link = replay(RecordingHost(), path)
    await link.open()
    channel = link.channels[0]
    assert channel.send(heartbeat(255)) is False and channel.tx_dropped == 1
    await link.close()


async def test_files_that_cannot_be_played_say_why_and_leave_nothing_open(tmp_path: Path) -> None:
    (tmp_path / "words.txt").write_text("these are no frames at all, " * 50)
    before = open_descriptors()
    for name, reason in (("none.tlog", "no such file"), (".", "directory"), ("words.txt", "no MAVLink in it")):
        with pytest.raises(LinkError, match=rf"replay .*{reason}"):
            await replay(RecordingHost(), tmp_path / name).open()
    assert open_descriptors() == before


async def test_closed_in_the_middle_it_stops_at_once_and_frees_the_file(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog(*((n, heartbeat(1, n)) for n in range(100))))
    before = open_descriptors()
    host = TimedHost()
    link = replay(host, path)
    await link.open()
    await asyncio.sleep(5.5)
    await link.close()
    await link.close()
    assert open_descriptors() == before
    await asyncio.sleep(10)
    assert len(host.heard) == 6
    link.rearm()
    await link.open()
    await asyncio.sleep(0.5)
    assert len(host.heard) == 7, "from the beginning again"
    await link.close()


def test_a_file_window_reads_as_the_bytes_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "numbers"
    data = bytes(n * 7 % 251 for n in range(200_000))
    path.write_bytes(data)
    with path.open("rb") as file:
        window = FileWindow(file)
        assert len(window) == len(data)
        for at in (0, 5, 65_530, 65_536, 199_999, 70_000, 3):
            assert window[at] == data[at]
            assert window[at : at + 300] == data[at : at + 300]
        assert window[100_000:] == data[100_000:]
        assert window[10:5] == b"" and window[300_000:300_001] == b""
        path.write_bytes(b"")
        assert window[150_000] == 0 and window[150_000:150_010] == b"", "truncated under our hands: nothing, no crash"


async def test_records_out_of_order_and_a_clock_that_was_set_back_take_no_time(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    times = (0.0, 20.0, 19.0, 20.5, 1.0, 2.0)
    path.write_bytes(tlog(*((at_s, heartbeat(n + 1)) for n, at_s in enumerate(times))))
    host, _ = await play(path)
    assert host.elapsed == [0.0, 10.0, 10.0, 10.5, 10.5, 11.5], "a pause is cut to 10 s; nothing else takes time"


async def test_a_pipe_is_no_recording_and_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "pipe.tlog"
    os.mkfifo(path)
    writer = os.open(path, os.O_RDWR)  # so that nobody waits for one
    try:
        with pytest.raises(LinkError, match="not a regular file"):
            await replay(RecordingHost(), path).open()
    finally:
        os.close(writer)


async def test_a_file_of_noise_leaves_the_loop_its_turns(tmp_path: Path) -> None:
    """40 kB of beginnings of frames and no frame: each byte is looked at for a record."""
    path = tmp_path / "noise.tlog"
    path.write_bytes(b"\xfd" * 40_000 + tlog((0, heartbeat(1))))
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    counting = asyncio.create_task(count())
    host, reason = await play(path)
    counting.cancel()
    assert host.raws == [heartbeat(1)]
    assert reason.startswith("finished")
    assert turns > 40_000 / LOOKS_PER_TURN
