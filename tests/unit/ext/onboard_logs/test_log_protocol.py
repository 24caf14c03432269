"""Lists and downloads of onboard logs against both firmwares' rules, over networks that lose, repeat and reorder."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import pytest

from skygcs.core.protocols.base import Chunk, Effect, Send
from skygcs.ext.onboard_logs.log_protocol import (
    BLOCK_BYTES,
    CHUNK_BLOCKS,
    TRIES,
    LogInfo,
    OnboardLogDownload,
    OnboardLogList,
)
from skygcs.sim.onboard_logs import OnboardLog, OnboardLogs
from support.table import each

TICK_S = 0.02


class Wire:
    """Takes what a simulated vehicle sends, as its transmitter."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, dict[str, Any]]] = []

    def send(self, name: str, fields: dict[str, Any], tail: bytes = b"") -> None:
        self.sent.append((name, dict(fields)))

    def say(self, severity: int, text: str) -> None:
        self.sent.append(("STATUSTEXT", {"text": text}))


class Field:
    """A vehicle with logs, a machine, and a bad network between them."""

    def __init__(self, *, px4: bool, loss: float = 0.0, seed: int = 1, sizes: Sequence[int] = (45_000, 93_457, 8)):
        self.wire = Wire()
        wire: Any = self.wire
        self.vehicle = OnboardLogs(wire, 7, px4=px4, unix_s=1_700_000_000)
        self.vehicle.logs = [OnboardLog(random.Random(n).randbytes(size), 1000 + n) for n, size in enumerate(sizes)]
        self.first = 0 if px4 else 1
        self.rng = random.Random(seed)
        self.loss = loss
        self.now = 100.0
        self.requests: list[str] = []
        self.written = bytearray()
        self.silent_after = float("inf")

    def lost(self) -> bool:
        return self.rng.random() < self.loss

    def carry_out(self, effects: tuple[Effect, ...]) -> None:
        for effect in effects:
            if isinstance(effect, Send):
                self.requests.append(effect.message)
                if not self.lost() and len(self.written) < self.silent_after:
                    self.vehicle.hear(effect.message, effect.values, armed=False)
            elif isinstance(effect, Chunk):
                assert effect.offset == len(self.written), "chunks follow each other"
                self.written += effect.data

    def run(self, machine: OnboardLogList | OnboardLogDownload, *, limit_s: float = 3000.0) -> None:
        self.carry_out(machine.start(self.now))
        end = self.now + limit_s
        while not machine.done:
            assert self.now < end, "it ends"
            self.now += TICK_S
            self.vehicle.step(armed=False)
            arrived, self.wire.sent = self.wire.sent, []
            arrived = [m for m in arrived for _ in range(0 if self.lost() else 2 if self.lost() else 1)]
            if self.loss and len(arrived) > 3:
                i = self.rng.randrange(len(arrived) - 1)
                arrived[i], arrived[i + 1] = arrived[i + 1], arrived[i]
            for name, fields in arrived:
                self.deliver(machine, name, fields)
            self.carry_out(machine.on_timer(self.now))

    def deliver(self, machine: OnboardLogList | OnboardLogDownload, name: str, f: dict[str, Any]) -> None:
        if name == "LOG_ENTRY" and isinstance(machine, OnboardLogList):
            self.carry_out(machine.on_entry(LogInfo(f["id"], f["size"], f["time_utc"]), f["num_logs"], self.now))
        elif name == "LOG_DATA" and isinstance(machine, OnboardLogDownload):
            self.carry_out(machine.on_data(f["id"], f["ofs"], bytes(f["data"][: f["count"]]), self.now))

    def listed(self) -> dict[int, LogInfo]:
        machine = OnboardLogList()
        self.run(machine)
        assert machine.outcome is not None and machine.outcome.ok, machine.outcome
        return machine.entries


@each("px4", [True, False])
@each("loss", [0.0, 0.05, 0.3])
def test_lists_and_logs_are_whole_and_exact(px4: bool, loss: float) -> None:
    for seed in range(2):
        field = Field(px4=px4, loss=loss, seed=seed)
        entries = field.listed()
        assert sorted(entries) == [field.first, field.first + 1, field.first + 2]
        for number, info in entries.items():
            field.written.clear()
            machine = OnboardLogDownload(info)
            field.run(machine)
            assert machine.outcome is not None and machine.outcome.ok, machine.outcome
            assert field.written == field.vehicle.logs[number - field.first].data
            assert field.requests[-1] == "LOG_REQUEST_END"


@each(("came", "asked"), [((1, 2), (0, 3)), ((1, 3), (2, 2)), ((0, 2), (1, 1)), ((2,), (0, 3))])
def test_the_first_of_a_px4_and_the_last_of_an_ardupilot_are_asked_for(
    came: tuple[int, ...], asked: tuple[int, int]
) -> None:
    """There are three logs. Until the first or the last has come, they may be numbered from 0 or from 1."""
    machine = OnboardLogList()
    machine.start(0.0)
    for number in came:
        machine.on_entry(LogInfo(number, 1, 1), 3, 0.0)
    (send,) = machine.on_timer(10.0)
    assert isinstance(send, Send) and (send.values["start"], send.values["end"]) == asked


def test_a_good_network_needs_one_request_for_each_chunk() -> None:
    field = Field(px4=False)
    info = field.listed()[2]
    field.requests.clear()
    field.run(OnboardLogDownload(info))
    chunks = -(-info.size_bytes // (CHUNK_BLOCKS * BLOCK_BYTES))
    assert field.requests == ["LOG_REQUEST_DATA"] * chunks + ["LOG_REQUEST_END"]


@each("px4", [True, False])
def test_it_goes_on_where_it_was_broken_off(px4: bool) -> None:
    field = Field(px4=px4)
    info = field.listed()[field.first + 1]
    field.silent_after = CHUNK_BLOCKS * BLOCK_BYTES
    first = OnboardLogDownload(info)
    field.run(first)
    assert first.outcome is not None and first.outcome.result == "timeout"
    assert len(field.written) == CHUNK_BLOCKS * BLOCK_BYTES
    field.silent_after = float("inf")
    again = OnboardLogDownload(info, begin=len(field.written))
    field.run(again)
    assert field.written == field.vehicle.logs[1].data


def test_a_radio_gets_small_chunks_and_half_of_the_time() -> None:
    field = Field(px4=False)
    info = field.listed()[1]
    began = field.now
    field.run(OnboardLogDownload(info))
    quick = field.now - began
    field.written.clear()
    began = field.now
    field.run(OnboardLogDownload(info, shared=True))
    assert field.written == field.vehicle.logs[0].data
    assert field.now - began > 2 * quick


def test_no_logs_is_an_answer_of_ardupilot_and_silence_of_px4() -> None:
    field, machine = Field(px4=False, sizes=()), OnboardLogList()
    field.run(machine)
    assert machine.outcome is not None and machine.outcome.ok and not machine.entries
    field, machine = Field(px4=True, sizes=()), OnboardLogList()
    field.run(machine)
    assert machine.outcome is not None and machine.outcome.result == "timeout"
    assert "no logs" in machine.outcome.message and machine.sent == TRIES + 1


def test_a_log_that_ends_earlier_than_listed_is_whole() -> None:
    field = Field(px4=False)
    info = field.listed()[1]
    machine = OnboardLogDownload(LogInfo(1, info.size_bytes + 500, 0))
    field.run(machine)
    assert machine.outcome is not None and machine.outcome.ok
    assert (machine.size, bytes(field.written)) == (45_000, field.vehicle.logs[0].data)


def test_an_empty_log_needs_no_request() -> None:
    machine = OnboardLogDownload(LogInfo(1, 0, 0))
    machine.start(0.0)
    assert machine.outcome is not None and machine.outcome.ok


def test_what_does_not_belong_to_it_changes_nothing() -> None:
    machine = OnboardLogDownload(LogInfo(3, 10_000, 0))
    machine.start(0.0)
    for log_id, offset, data in (
        (4, 0, b"x" * 90),  # another log
        (3, 1, b"x" * 90),  # between blocks
        (3, 90 * CHUNK_BLOCKS, b"x" * 90),  # behind the chunk
        (3, 10_080, b""),  # behind the end
        (3, 0xFFFFFFFF, b"x" * 90),
        (3, 0, b"x" * 91),
    ):
        assert machine.on_data(log_id, offset, data, 0.1) == ()
    assert machine.received == 0 and not machine.done
    machine.stop(0.2, "cancelled", "c")
    assert machine.stop(0.3, "lost", "l") == () and machine.on_data(3, 0, b"x" * 90, 0.4) == ()
    with pytest.raises(ValueError):
        OnboardLogDownload(LogInfo(1, 1000, 0), begin=91)


def test_entries_without_end_are_not_kept_without_end() -> None:
    machine = OnboardLogList()
    machine.start(0.0)
    for number in range(65_535):
        machine.on_entry(LogInfo(number, 1, 1), 65_535, 0.0)
        if machine.done:
            break
    assert len(machine.entries) <= 2000 and machine.done


def test_a_number_of_logs_that_changes_without_end_ends_the_list() -> None:
    machine, now = OnboardLogList(), 0.0
    machine.start(now)
    while not machine.done:
        now += 0.1
        machine.on_entry(LogInfo(1, 9, 0), 2 + round(now * 10) % 2, now)
        assert now < 60.0
    assert machine.outcome is not None and machine.outcome.result == "incomplete"
    assert "two vehicles" in machine.outcome.message
